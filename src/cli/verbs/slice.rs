//! The verb `slice`: draws pictures of meshes, images, surfaces and lines.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::json;

use super::captions::{cells_caption, crossing_caption, line_ruler, title};
use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::cli::parse;
use crate::error::cause;
use crate::export::surfaces::vtp::read_shapes;
use crate::image::Geometry;
use crate::image::formats::stream::{ImageHeader, OpenedImage, SlabSource};
use crate::image::formats::{AnyImage, InputOptions, LoadedImage};
use crate::mesh::{Mesh, TetMesh, TriMesh};
use crate::model::slice::{
    self, Canvas, Caption, CutMode, Overlay, OverlayShape, Paint, PaintedCells, Sections, Skeleton,
    SolidMesh, SolidView, UpDirection,
};
use crate::store::{AnyMesh, MeshFile, Storable, StoredMesh, image_geometry_in_depth};
use crate::{Error, Result};

/// Arguments of `atomesh slice`.
#[derive(Debug, Args)]
pub struct SliceArgs {
    /// The files to draw: the image that was meshed, its mesh (.vtu), surfaces and lines (.vtp).
    /// With --view 3d each of these may be drawn alone
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// The picture to write
    #[arg(short, long, value_name = "OUT.png")]
    pub output: PathBuf,
    /// The view: sections with three planes, or a view in space of which a part is cut away
    #[arg(long, value_name = "VIEW", default_value = "sections")]
    pub view: View,
    /// Array of the mesh, of cells or of nodes, that colours the cells, such as pressure or region
    /// [default: the image]
    #[arg(long, value_name = "ARRAY")]
    pub color: Option<String>,
    /// The point where the planes meet, in physical coordinates [default: the middle]
    #[arg(long, value_name = "X,Y,Z", allow_negative_numbers = true)]
    pub at: Option<String>,
    /// The part that is cut away in --view 3d: the corner beyond that point, or all in front of the
    /// plane through it across x, y or z [default: corner]
    #[arg(long, value_name = "WHERE")]
    pub cut: Option<Cutaway>,
    /// The direction that is up: x, y, z or -x, -y, -z in physical coordinates [default: as the
    /// image has it; z if unknown]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<String>,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// The view that a picture shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum View {
    /// The whole mesh in 2-D, or its sections with three planes in 3-D
    Sections,
    /// The objects in space, seen from outside (3-D)
    #[value(name = "3d")]
    Solid,
}

/// The part of a body that is cut away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Cutaway {
    /// A corner; of a mesh, whole cells are removed
    Corner,
    /// One half, across x
    X,
    /// One half, across y
    Y,
    /// One half, across z
    Z,
}

/// The files of the command line, by their content.
struct InputFiles<'a> {
    args: &'a SliceArgs,
    image: Option<&'a Path>,
    mesh: Option<&'a Path>,
    shapes: Vec<&'a Path>,
}

/// File endings by which a mesh is recognised if it is the only file.
const MESH_EXTENSIONS: [&str; 5] = ["vtu", "msh", "e", "exo", "ex2"];

impl<'a> InputFiles<'a> {
    /// Classifies the files: surfaces and lines by their ending; of two other files, the first is
    /// the image.
    fn classify(args: &'a SliceArgs) -> Result<Self> {
        let has_ending = |path: &Path, endings: &[&str]| {
            let ending = path.extension().and_then(|ending| ending.to_str());
            ending.is_some_and(|ending| endings.iter().any(|e| ending.eq_ignore_ascii_case(e)))
        };
        let files = args.files.iter().map(PathBuf::as_path);
        let (shapes, others): (Vec<_>, Vec<_>) = files.partition(|path| has_ending(path, &["vtp"]));
        let (image, mesh) = match others[..] {
            [] => (None, None),
            [mesh] if has_ending(mesh, &MESH_EXTENSIONS) => (None, Some(mesh)),
            [image] => (Some(image), None),
            [image, mesh] => (Some(image), Some(mesh)),
            [.., last] => {
                let problem = "is one file too many: there is an image and a mesh already";
                return Err(slice_error(last, problem, "leave it out"));
            }
        };
        Ok(Self {
            args,
            image,
            mesh,
            shapes,
        })
    }

    /// Checks that no option is typed that has no effect with the files or the other options.
    fn check_options(&self) -> Result<()> {
        let args = self.args;
        let refuse = |place: &str, problem: &str, remedy: &str| {
            Err(Error::Job(cause(place, problem, remedy)))
        };
        if self.image.is_none() {
            args.input.refuse_unused("no image is given")?;
        }
        match (args.view, self.image) {
            (View::Sections, None) => {
                let problem = "needs an image, but none is given";
                return refuse("--view sections", problem, "give the image, or --view 3d");
            }
            (View::Sections, _) if args.cut.is_some() => {
                let problem = "applies to --view 3d only";
                return refuse("--cut", problem, "give --view 3d, or omit it");
            }
            _ => {}
        }
        if args.color.is_some() && self.mesh.is_none() {
            let problem = "colours the cells of a mesh, but none is given";
            return refuse("--color", problem, "give the mesh, or omit it");
        }
        if self.image.is_none() && self.mesh.is_none() {
            let typed = [("--at", args.at.is_some()), ("--cut", args.cut.is_some())];
            if let Some((option, _)) = typed.iter().find(|(_, typed)| *typed) {
                let problem = "cuts an image or a mesh, but none is given";
                return refuse(option, problem, "omit it");
            }
        }
        Ok(())
    }
}

/// Runs the verb.
pub fn slice(args: &SliceArgs, console: &mut Console) -> Result<()> {
    let inputs: Vec<&Path> = args.files.iter().map(PathBuf::as_path).collect();
    check_output(&args.output, "--output", &["png"], &inputs)?;
    let files = InputFiles::classify(args)?;
    files.check_options()?;
    let at = args
        .at
        .as_deref()
        .map(|text| parse::point("--at", text, "give a point such as 1500,2000,300"))
        .transpose()?;
    console.begin_stage("reading");
    let open = |path: &Path| {
        let image = console.open_image(path, &args.input)?;
        match args.view {
            View::Sections => Ok(image),
            // A view in space needs the image at any point, not only on planes.
            View::Solid => image.load(path).map(OpenedImage::InMemory),
        }
    };
    let image = files.image.map(open).transpose()?;
    let mesh = files.mesh.map(|path| console.read_mesh(path)).transpose()?;
    let mut shapes = Vec::new();
    for path in &files.shapes {
        shapes.extend(read_shapes(path)?);
    }
    console.begin_stage("drawing");
    let drawing = Drawing {
        files,
        shapes,
        crossing_point: at,
    };
    let picture = drawing.draw(image, mesh)?;
    picture.write(&args.output)?;
    let [width, height] = picture.size();
    console.result(
        format_args!("wrote {}: {width} x {height} pixels", args.output.display()),
        &json!({ "file": path_text(&args.output), "size": [width, height] }),
    );
    Ok(())
}

fn slice_error(place: &Path, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(place.display(), problem, remedy))
}

/// The objects to draw, besides the image and the mesh.
struct Drawing<'a> {
    files: InputFiles<'a>,
    shapes: Vec<OverlayShape>,
    crossing_point: Option<[f64; 3]>,
}

impl Drawing<'_> {
    fn draw(self, image: Option<OpenedImage>, mesh: Option<AnyMesh>) -> Result<Canvas> {
        let dimension_error = |mesh: u8, image: u8| {
            let problem = format!("is a {mesh}-D mesh, but the image is {image}-D");
            let place = self.files.mesh.unwrap_or(Path::new("the mesh"));
            slice_error(place, &problem, "give the mesh of the image")
        };
        let is_solid = self.files.args.view == View::Solid;
        let flat_error = |object: &str| {
            let problem = format!("shows objects in space, but {object} is 2-D");
            Error::Job(cause("--view 3d", problem, "omit it"))
        };
        match (image, mesh) {
            (Some(OpenedImage::InMemory(AnyImage::Plane(_))), _) if is_solid => {
                Err(flat_error("the image"))
            }
            (None, Some(AnyMesh::Triangles(_) | AnyMesh::Polygons(_))) => {
                Err(flat_error("the mesh"))
            }
            (Some(OpenedImage::InMemory(AnyImage::Plane(loaded))), mesh) => match mesh {
                None => self.draw_plane::<TriMesh>(loaded, None),
                Some(AnyMesh::Triangles(file)) => self.draw_plane(loaded, Some(file)),
                Some(AnyMesh::Polygons(file)) => self.draw_plane(loaded, Some(file)),
                _ => Err(dimension_error(3, 2)),
            },
            (image, None) => self.draw_space::<TetMesh>(image, None),
            (image, Some(AnyMesh::Tetrahedra(file))) => self.draw_space(image, Some(file)),
            (image, Some(AnyMesh::Polyhedra(file))) => self.draw_space(image, Some(file)),
            _ => Err(dimension_error(2, 3)),
        }
    }

    /// Returns the geometry of the image, in depth if its mesh is in depth.
    fn image_geometry<const D: usize, M: Mesh<D>>(
        &self,
        geometry: &Geometry<D>,
        dims: [usize; D],
        file: Option<&MeshFile<M>>,
    ) -> Result<Geometry<D>> {
        let depth = |file| image_geometry_in_depth(file, geometry, dims, &self.image_name());
        let depth = file.map(depth).transpose()?.flatten();
        Ok(depth.unwrap_or_else(|| geometry.clone()))
    }

    /// Sets the geometry of the image to that of [`Self::image_geometry`].
    fn place_image<const D: usize, M: Mesh<D>>(
        &self,
        mut loaded: LoadedImage<D>,
        file: Option<&MeshFile<M>>,
    ) -> Result<LoadedImage<D>> {
        let image = &mut loaded.image;
        image.geometry = self.image_geometry(&image.geometry, image.dims(), file)?;
        Ok(loaded)
    }

    fn draw_plane<M: Storable<2>>(
        self,
        loaded: LoadedImage<2>,
        file: Option<MeshFile<M>>,
    ) -> Result<Canvas> {
        if let Some(shape) = self.shapes.iter().find(|shape| !shape.triangles.is_empty()) {
            let problem = format!(
                "is a surface in space, but the image is 2-D: {}",
                shape.name
            );
            return Err(Error::Job(cause("slice", problem, "leave it out")));
        }
        let loaded = self.place_image(loaded, file.as_ref())?;
        let caption = self.caption(file.as_ref(), Some(&loaded.header()));
        let image = &loaded.image;
        let overlay = self.overlay(file, &image.geometry, image.dims())?;
        slice::draw_plane(image, &overlay, &caption)
    }

    fn draw_space<M: Storable<3>>(
        self,
        image: Option<OpenedImage>,
        file: Option<MeshFile<M>>,
    ) -> Result<Canvas> {
        let image = match image {
            Some(OpenedImage::InMemory(AnyImage::Space(loaded))) => {
                let loaded = self.place_image(loaded, file.as_ref())?;
                Some(OpenedImage::InMemory(AnyImage::Space(loaded)))
            }
            other => other,
        };
        let (head, slabs): (ImageHeader<3>, &dyn SlabSource) = match &image {
            Some(OpenedImage::Stream(stream)) => {
                let mut head = stream.header.clone();
                head.geometry = self.image_geometry(&head.geometry, head.dims, file.as_ref())?;
                (head, stream)
            }
            Some(OpenedImage::InMemory(AnyImage::Space(loaded))) => {
                if self.files.args.view == View::Solid {
                    return self.draw_solid(Some(loaded), file);
                }
                (loaded.header(), &loaded.image)
            }
            _ => return self.draw_solid(None, file),
        };
        if let Some(lines) = self.shapes.iter().find(|shape| shape.triangles.is_empty()) {
            let problem = format!("does not show lines in space: {}", lines.name);
            return Err(Error::Job(cause(
                "--view sections",
                problem,
                "give --view 3d",
            )));
        }
        let at = match self.crossing_point {
            Some(at) => head
                .geometry
                .to_index(at)
                .ok_or_else(|| self.degenerate_axes_error())?,
            None => head.dims.map(|n| (n / 2) as f64),
        };
        let mut caption = self.caption(file.as_ref(), Some(&head));
        caption.subtitle += &crossing_caption(&head, at, &caption);
        let place = self.files.image.unwrap_or(Path::new("the image"));
        let sections = Sections::new(place, head.dims, slabs, at)?;
        let overlay = self.overlay(file, &head.geometry, head.dims)?;
        slice::draw_sections(&sections, &head.geometry, &overlay, &caption)
    }

    fn draw_solid<M: Storable<3>>(
        self,
        loaded: Option<&LoadedImage<3>>,
        file: Option<MeshFile<M>>,
    ) -> Result<Canvas> {
        let head = loaded.map(LoadedImage::header);
        let caption = self.caption(file.as_ref(), head.as_ref());
        let stored = file.map(|file| self.to_stored(file)).transpose()?;
        let space = match (&stored, loaded) {
            (Some(stored), loaded) => {
                if let Some(loaded) = loaded {
                    let dims = loaded.image.dims();
                    stored.space.check_dims(dims, &self.image_name())?;
                }
                stored.space.clone()
            }
            (None, Some(loaded)) => {
                SolidView::image_space(loaded.image.dims(), &loaded.image.geometry)
            }
            (None, None) => SolidView::bounding_space(&self.shapes),
        };
        let index = |at| {
            space
                .geometry
                .to_index(at)
                .ok_or_else(|| self.degenerate_axes_error())
        };
        let at = self.crossing_point.map(index).transpose()?;
        // For surfaces, and for meshes that do not record the position of their image, z is up.
        let has_orientation =
            loaded.is_some() || stored.as_ref().is_some_and(|s| s.space.is_stored);
        let up = self
            .up_direction::<3>()?
            .or((!has_orientation).then_some(UpDirection {
                coordinate: 2,
                points_down: false,
            }));
        let view = SolidView {
            space,
            image: loaded.map(|loaded| &loaded.image),
            mesh: stored.as_ref().map(SolidMesh::from_stored).transpose()?,
            paint: stored
                .as_ref()
                .map(|s| self.paint(s))
                .transpose()?
                .flatten(),
            shapes: self.shapes,
            up_direction: up,
            cut: match self.files.args.cut.unwrap_or(Cutaway::Corner) {
                Cutaway::Corner => CutMode::Corner,
                Cutaway::X => CutMode::Plane(0),
                Cutaway::Y => CutMode::Plane(1),
                Cutaway::Z => CutMode::Plane(2),
            },
            cut_point: at,
        };
        view.draw(&caption)
    }

    /// Returns the overlay of an image of these dimensions.
    fn overlay<const D: usize, M: Storable<D>>(
        self,
        file: Option<MeshFile<M>>,
        geometry: &Geometry<D>,
        dims: [usize; D],
    ) -> Result<Overlay<D>> {
        let up = self.up_direction::<D>()?;
        let Some(file) = file else {
            return Ok(Overlay {
                shapes: self.shapes,
                up_direction: up,
                ..Overlay::default()
            });
        };
        let mesh = Skeleton::new(&file, geometry).ok_or_else(|| self.degenerate_axes_error())?;
        let mut painted = None;
        if self.files.args.color.is_some() {
            let stored = self.to_stored(file)?;
            stored.space.check_dims(dims, &self.image_name())?;
            let paint = self.paint(&stored)?;
            painted = paint.map(|p| PaintedCells::new(&stored, p)).transpose()?;
        }
        Ok(Overlay {
            mesh,
            painted_cells: painted,
            shapes: self.shapes,
            up_direction: up,
        })
    }

    fn to_stored<const D: usize, M: Storable<D>>(
        &self,
        file: MeshFile<M>,
    ) -> Result<StoredMesh<D, M>> {
        let place = self.files.mesh.map(path_text).unwrap_or_default();
        StoredMesh::new(file, &place)
    }

    fn paint<const D: usize, M: Storable<D>>(
        &self,
        stored: &StoredMesh<D, M>,
    ) -> Result<Option<Paint>> {
        let place = self.files.mesh.map(path_text).unwrap_or_default();
        let color = self.files.args.color.as_deref();
        color
            .map(|name| Paint::from_array(stored, name, &place))
            .transpose()
    }

    fn up_direction<const D: usize>(&self) -> Result<Option<UpDirection>> {
        let Some(text) = &self.files.args.up else {
            return Ok(None);
        };
        let (coordinate, positive) = parse::axis::<D>("--up", text)?;
        Ok(Some(UpDirection {
            coordinate,
            points_down: !positive,
        }))
    }

    fn image_name(&self) -> String {
        self.files.image.map(path_text).unwrap_or_default()
    }

    fn degenerate_axes_error(&self) -> Error {
        let problem = "the image's axes are linearly dependent";
        let place = self.files.mesh.or(self.files.image);
        slice_error(
            place.unwrap_or(Path::new("slice")),
            problem,
            "correct its geometry",
        )
    }

    /// Returns the caption: the files, the number of cells, and the nominal distance of atoms.
    fn caption<const D: usize, M: Mesh<D>>(
        &self,
        file: Option<&MeshFile<M>>,
        head: Option<&ImageHeader<D>>,
    ) -> Caption {
        let files = &self.files;
        let foreground: Vec<&Path> = files.mesh.into_iter().chain(files.shapes.clone()).collect();
        let rulers = std::array::from_fn(|k| (k < D).then(|| line_ruler(head?, k)).flatten());
        Caption {
            title: title(&foreground, files.image),
            subtitle: file.map(cells_caption).unwrap_or_default(),
            value_label: String::new(),
            rulers,
        }
    }
}
