//! `atomesh slice`: pictures of meshes, images, surfaces and lines.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::json;

use super::captions::{cells, lines, met, title};
use crate::cli::common::output::{check_output, shown};
use crate::cli::console::Console;
use crate::cli::parse;
use crate::error::cause;
use crate::export::surfaces::vtp::read_shapes;
use crate::image::Geometry;
use crate::image::formats::stream::{Head, Opened, Slabs};
use crate::image::formats::{AnyLoaded, InputOptions, Loaded};
use crate::mesh::{Mesh, TetMesh, TriMesh};
use crate::model::slice::{
    self, Body, Canvas, Caption, Cut, Overlay, Paint, Painted, Sections, Shape, Skeleton, Solid,
    Upward,
};
use crate::store::{AnyMesh, MeshFile, Stored, StoredMesh, in_depth_of};
use crate::{Error, Result};

/// `atomesh slice`.
#[derive(Debug, Args)]
pub struct SliceArgs {
    /// What to draw: the image that was meshed, its mesh (.vtu), surfaces and lines (.vtp). With --view 3d
    /// any of these alone
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// The picture to write
    #[arg(short, long, value_name = "OUT.png")]
    pub output: PathBuf,
    /// Sections with the planes of samples, or what there is in space, a part of it taken away
    #[arg(long, value_name = "VIEW", default_value = "sections")]
    pub view: View,
    /// Paint cells with this array of the mesh, of cells or of nodes, such as pressure or region [default: the
    /// image]
    #[arg(long, value_name = "ARRAY")]
    pub color: Option<String>,
    /// The point where the planes meet, in physical coordinates [default: the middle]
    #[arg(long, value_name = "X,Y,Z", allow_negative_numbers = true)]
    pub at: Option<String>,
    /// What is taken away in --view 3d: the corner beyond that point, or all in front of the plane through it
    /// across x, y or z [default: corner]
    #[arg(long, value_name = "WHERE")]
    pub cut: Option<Taken>,
    /// Which way is up: x, y, z or -x, -y, -z in physical coordinates [default: as the image has it; z where
    /// none is known]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<String>,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// What a picture shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum View {
    /// In 2-D the whole mesh, in 3-D its sections with three planes
    Sections,
    /// What there is in space, seen from outside (3-D)
    #[value(name = "3d")]
    Solid,
}

/// What is taken away of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Taken {
    /// A corner; of a mesh whole cells
    Corner,
    /// Half of it, across x
    X,
    /// Half of it, across y
    Y,
    /// Half of it, across z
    Z,
}

/// What the files are.
struct Files<'a> {
    args: &'a SliceArgs,
    image: Option<&'a Path>,
    mesh: Option<&'a Path>,
    shapes: Vec<&'a Path>,
}

/// Endings of meshes, if it is not the place among the files that tells.
const MESHES: [&str; 5] = ["vtu", "msh", "e", "exo", "ex2"];

impl<'a> Files<'a> {
    /// Surfaces and lines are told by their ending; of two others the first is the image.
    fn of(args: &'a SliceArgs) -> Result<Self> {
        let ends = |path: &Path, endings: &[&str]| {
            let ending = path.extension().and_then(|ending| ending.to_str());
            ending.is_some_and(|ending| endings.iter().any(|e| ending.eq_ignore_ascii_case(e)))
        };
        let files = args.files.iter().map(PathBuf::as_path);
        let (shapes, others): (Vec<_>, Vec<_>) = files.partition(|path| ends(path, &["vtp"]));
        let (image, mesh) = match others[..] {
            [] => (None, None),
            [mesh] if ends(mesh, &MESHES) => (None, Some(mesh)),
            [image] => (Some(image), None),
            [image, mesh] => (Some(image), Some(mesh)),
            [.., last] => {
                let problem = "is one file too many: there is an image and a mesh already";
                return Err(refuse(last, problem, "leave it out"));
            }
        };
        Ok(Self {
            args,
            image,
            mesh,
            shapes,
        })
    }

    /// No option is typed that the files or another option leave without effect.
    fn check(&self) -> Result<()> {
        let args = self.args;
        let refuse = |place: &str, problem: &str, remedy: &str| {
            Err(Error::Job(cause(place, problem, remedy)))
        };
        if self.image.is_none() {
            args.input.refuse_unused("no image is given")?;
        }
        match (args.view, self.image) {
            (View::Sections, None) => {
                let problem = "draws over an image, and none is given";
                return refuse("--view sections", problem, "give the image, or --view 3d");
            }
            (View::Sections, _) if args.cut.is_some() => {
                let problem = "opens what is seen from outside";
                return refuse("--cut", problem, "give --view 3d, or omit it");
            }
            _ => {}
        }
        if args.color.is_some() && self.mesh.is_none() {
            let problem = "paints the cells of a mesh, and none is given";
            return refuse("--color", problem, "give the mesh, or omit it");
        }
        if self.image.is_none() && self.mesh.is_none() {
            let typed = [("--at", args.at.is_some()), ("--cut", args.cut.is_some())];
            if let Some((option, _)) = typed.iter().find(|(_, typed)| *typed) {
                let problem = "cuts an image or a mesh, and none is given";
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
    let files = Files::of(args)?;
    files.check()?;
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
            // Painted at any point, not only on planes.
            View::Solid => image.load(path).map(Opened::Held),
        }
    };
    let image = files.image.map(open).transpose()?;
    let mesh = files.mesh.map(|path| console.read_mesh(path)).transpose()?;
    let mut shapes = Vec::new();
    for path in &files.shapes {
        shapes.extend(read_shapes(path)?);
    }
    console.begin_stage("drawing");
    let drawing = Drawing { files, shapes, at };
    let picture = drawing.picture(image, mesh)?;
    picture.write(&args.output)?;
    let [width, height] = picture.size();
    console.result(
        format_args!("wrote {}: {width} x {height} pixels", args.output.display()),
        &json!({ "file": shown(&args.output), "size": [width, height] }),
    );
    Ok(())
}

fn refuse(place: &Path, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(place.display(), problem, remedy))
}

/// What is drawn, besides the image and the mesh.
struct Drawing<'a> {
    files: Files<'a>,
    shapes: Vec<Shape>,
    at: Option<[f64; 3]>,
}

impl Drawing<'_> {
    fn picture(self, image: Option<Opened>, mesh: Option<AnyMesh>) -> Result<Canvas> {
        let other = |mesh: u8, image: u8| {
            let problem = format!("is a {mesh}-D mesh, but the image is {image}-D");
            let place = self.files.mesh.unwrap_or(Path::new("the mesh"));
            refuse(place, &problem, "give the mesh of the image")
        };
        let solid = self.files.args.view == View::Solid;
        let flat = |what: &str| {
            let problem = format!("shows what is in space, but {what} is 2-D");
            Error::Job(cause("--view 3d", problem, "omit it"))
        };
        match (image, mesh) {
            (Some(Opened::Held(AnyLoaded::Plane(_))), _) if solid => Err(flat("the image")),
            (None, Some(AnyMesh::Plane(_) | AnyMesh::PlaneCells(_))) => Err(flat("the mesh")),
            (Some(Opened::Held(AnyLoaded::Plane(loaded))), mesh) => match mesh {
                None => self.plane::<TriMesh>(loaded, None),
                Some(AnyMesh::Plane(file)) => self.plane(loaded, Some(file)),
                Some(AnyMesh::PlaneCells(file)) => self.plane(loaded, Some(file)),
                _ => Err(other(3, 2)),
            },
            (image, None) => self.space::<TetMesh>(image, None),
            (image, Some(AnyMesh::Space(file))) => self.space(image, Some(file)),
            (image, Some(AnyMesh::SpaceCells(file))) => self.space(image, Some(file)),
            _ => Err(other(2, 3)),
        }
    }

    /// Where the image lies, in depth if its mesh does.
    fn placed<const D: usize, M: Mesh<D>>(
        &self,
        geometry: &Geometry<D>,
        dims: [usize; D],
        file: Option<&MeshFile<M>>,
    ) -> Result<Geometry<D>> {
        let depth = |file| in_depth_of(file, geometry, dims, &self.image_place());
        let depth = file.map(depth).transpose()?.flatten();
        Ok(depth.unwrap_or_else(|| geometry.clone()))
    }

    /// The image, where [`Self::placed`] says.
    fn below<const D: usize, M: Mesh<D>>(
        &self,
        mut loaded: Loaded<D>,
        file: Option<&MeshFile<M>>,
    ) -> Result<Loaded<D>> {
        let image = &mut loaded.image;
        image.geometry = self.placed(&image.geometry, image.dims(), file)?;
        Ok(loaded)
    }

    fn plane<M: Stored<2>>(self, loaded: Loaded<2>, file: Option<MeshFile<M>>) -> Result<Canvas> {
        if let Some(shape) = self.shapes.iter().find(|shape| !shape.triangles.is_empty()) {
            let problem = format!(
                "is a surface in space, but the image is 2-D: {}",
                shape.name
            );
            return Err(Error::Job(cause("slice", problem, "leave it out")));
        }
        let loaded = self.below(loaded, file.as_ref())?;
        let caption = self.caption(file.as_ref(), Some(&loaded.head()));
        let image = &loaded.image;
        let over = self.overlay(file, &image.geometry, image.dims())?;
        slice::plane(image, &over, &caption)
    }

    fn space<M: Stored<3>>(
        self,
        image: Option<Opened>,
        file: Option<MeshFile<M>>,
    ) -> Result<Canvas> {
        let image = match image {
            Some(Opened::Held(AnyLoaded::Space(loaded))) => {
                let loaded = self.below(loaded, file.as_ref())?;
                Some(Opened::Held(AnyLoaded::Space(loaded)))
            }
            other => other,
        };
        let (head, slabs): (Head<3>, &dyn Slabs) = match &image {
            Some(Opened::Stream(stream)) => {
                let mut head = stream.head.clone();
                head.geometry = self.placed(&head.geometry, head.dims, file.as_ref())?;
                (head, stream)
            }
            Some(Opened::Held(AnyLoaded::Space(loaded))) => {
                if self.files.args.view == View::Solid {
                    return self.solid(Some(loaded), file);
                }
                (loaded.head(), &loaded.image)
            }
            _ => return self.solid(None, file),
        };
        if let Some(lines) = self.shapes.iter().find(|shape| shape.triangles.is_empty()) {
            let problem = format!("does not show lines in space: {}", lines.name);
            return Err(Error::Job(cause(
                "--view sections",
                problem,
                "give --view 3d",
            )));
        }
        let at = match self.at {
            Some(at) => head.geometry.to_index(at).ok_or_else(|| self.flat())?,
            None => head.dims.map(|n| (n / 2) as f64),
        };
        let mut caption = self.caption(file.as_ref(), Some(&head));
        caption.subtitle += &met(&head, at, &caption);
        let place = self.files.image.unwrap_or(Path::new("the image"));
        let sections = Sections::of(place, head.dims, slabs, at)?;
        let over = self.overlay(file, &head.geometry, head.dims)?;
        slice::space(&sections, &head.geometry, &over, &caption)
    }

    fn solid<M: Stored<3>>(
        self,
        loaded: Option<&Loaded<3>>,
        file: Option<MeshFile<M>>,
    ) -> Result<Canvas> {
        let head = loaded.map(Loaded::head);
        let caption = self.caption(file.as_ref(), head.as_ref());
        let stored = file.map(|file| self.stored(file)).transpose()?;
        let space = match (&stored, loaded) {
            (Some(stored), loaded) => {
                if let Some(loaded) = loaded {
                    let dims = loaded.image.dims();
                    stored.space.check_dims(dims, &self.image_place())?;
                }
                stored.space.clone()
            }
            (None, Some(loaded)) => Solid::space_of(loaded.image.dims(), &loaded.image.geometry),
            (None, None) => Solid::space_around(&self.shapes),
        };
        let index = |at| space.geometry.to_index(at).ok_or_else(|| self.flat());
        let at = self.at.map(index).transpose()?;
        // Surfaces, and meshes that do not say where their image lies, have z up.
        let said = loaded.is_some() || stored.as_ref().is_some_and(|s| s.space.by_file);
        let up = self.up::<3>()?.or((!said).then_some(Upward {
            coordinate: 2,
            down: false,
        }));
        let drawn = Solid {
            space,
            image: loaded.map(|loaded| &loaded.image),
            mesh: stored.as_ref().map(Body::of).transpose()?,
            paint: stored
                .as_ref()
                .map(|s| self.paint(s))
                .transpose()?
                .flatten(),
            shapes: self.shapes,
            up,
            cut: match self.files.args.cut.unwrap_or(Taken::Corner) {
                Taken::Corner => Cut::Corner,
                Taken::X => Cut::Plane(0),
                Taken::Y => Cut::Plane(1),
                Taken::Z => Cut::Plane(2),
            },
            at,
        };
        drawn.draw(&caption)
    }

    /// What is drawn over an image of these dims.
    fn overlay<const D: usize, M: Stored<D>>(
        self,
        file: Option<MeshFile<M>>,
        geometry: &Geometry<D>,
        dims: [usize; D],
    ) -> Result<Overlay<D>> {
        let up = self.up::<D>()?;
        let Some(file) = file else {
            return Ok(Overlay {
                shapes: self.shapes,
                up,
                ..Overlay::default()
            });
        };
        let mesh = Skeleton::new(&file, geometry).ok_or_else(|| self.flat())?;
        let mut painted = None;
        if self.files.args.color.is_some() {
            let stored = self.stored(file)?;
            stored.space.check_dims(dims, &self.image_place())?;
            let paint = self.paint(&stored)?;
            painted = paint.map(|p| Painted::new(&stored, p)).transpose()?;
        }
        Ok(Overlay {
            mesh,
            painted,
            shapes: self.shapes,
            up,
        })
    }

    fn stored<const D: usize, M: Stored<D>>(&self, file: MeshFile<M>) -> Result<StoredMesh<D, M>> {
        let place = self.files.mesh.map(shown).unwrap_or_default();
        StoredMesh::new(file, &place)
    }

    fn paint<const D: usize, M: Stored<D>>(
        &self,
        stored: &StoredMesh<D, M>,
    ) -> Result<Option<Paint>> {
        let place = self.files.mesh.map(shown).unwrap_or_default();
        let color = self.files.args.color.as_deref();
        color
            .map(|name| Paint::of(stored, name, &place))
            .transpose()
    }

    fn up<const D: usize>(&self) -> Result<Option<Upward>> {
        let Some(text) = &self.files.args.up else {
            return Ok(None);
        };
        let (coordinate, positive) = parse::axis::<D>("--up", text)?;
        Ok(Some(Upward {
            coordinate,
            down: !positive,
        }))
    }

    fn image_place(&self) -> String {
        self.files.image.map(shown).unwrap_or_default()
    }

    fn flat(&self) -> Error {
        let problem = "the image's axes are linearly dependent";
        let place = self.files.mesh.or(self.files.image);
        refuse(
            place.unwrap_or(Path::new("slice")),
            problem,
            "correct its geometry",
        )
    }

    /// The files, how many cells there are, and how far apart atoms were asked to be.
    fn caption<const D: usize, M: Mesh<D>>(
        &self,
        file: Option<&MeshFile<M>>,
        head: Option<&Head<D>>,
    ) -> Caption {
        let files = &self.files;
        let above: Vec<&Path> = files.mesh.into_iter().chain(files.shapes.clone()).collect();
        let rulers = std::array::from_fn(|k| (k < D).then(|| lines(head?, k)).flatten());
        Caption {
            title: title(&above, files.image),
            subtitle: file.map(cells).unwrap_or_default(),
            values: String::new(),
            rulers,
        }
    }
}
