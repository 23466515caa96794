//! Draws a mesh, an image, surfaces and lines, as `atomesh slice` does.

use std::path::{Path, PathBuf};

use super::captions::{cells_caption, crossing_caption, line_ruler, title};
use super::slice_spec::{SliceSpec, View};
use super::{
    Canvas, Caption, Overlay, OverlayShape, Paint, PaintedCells, Sections, Skeleton, SolidMesh,
    SolidView, draw_plane, draw_sections,
};
use crate::error::cause;
use crate::image::Geometry;
use crate::image::formats::stream::{ImageHeader, OpenedImage, SlabSource};
use crate::image::formats::{AnyImage, LoadedImage};
use crate::mesh::{Mesh, TetMesh, TriMesh};
use crate::option_text::SignedAxis;
use crate::progress::{Progress, Stage};
use crate::store::{AnyMesh, MeshFile, Storable, StoredMesh, image_geometry_in_depth};
use crate::surface_file::has_extension;
use crate::{Error, Result};

/// The objects that a picture shows.
#[derive(Default)]
pub struct SliceInput {
    /// The image. For sections it may still be in its file.
    pub image: Option<OpenedImage>,
    /// The mesh of the image.
    pub mesh: Option<AnyMesh>,
    /// Surfaces and lines, in physical coordinates.
    pub shapes: Vec<OverlayShape>,
    /// The names of all these in messages and in the title.
    pub names: InputNames,
}

/// The names of the objects that a picture shows, such as the paths of their files.
#[derive(Debug, Clone, Default)]
pub struct InputNames {
    /// The name of the image.
    pub image: Option<PathBuf>,
    /// The name of the mesh.
    pub mesh: Option<PathBuf>,
    /// The names of files with surfaces and lines.
    pub shapes: Vec<PathBuf>,
}

/// File endings by which a mesh is recognised if it is the only file.
const MESH_EXTENSIONS: [&str; 5] = ["vtu", "msh", "e", "exo", "ex2"];

impl InputNames {
    /// Classifies files: surfaces and lines by their ending; of two other files, the first is the
    /// image.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if there are more.
    pub fn classify(files: &[PathBuf]) -> Result<Self> {
        let files = files.iter().cloned();
        let (shapes, others): (Vec<_>, _) = files.partition(|path| has_extension(path, &["vtp"]));
        let others: Vec<PathBuf> = others;
        let (image, mesh) = match &others[..] {
            [] => (None, None),
            [mesh] if has_extension(mesh, &MESH_EXTENSIONS) => (None, Some(mesh.clone())),
            [image] => (Some(image.clone()), None),
            [image, mesh] => (Some(image.clone()), Some(mesh.clone())),
            [.., last] => {
                let problem = "is one file too many: there is an image and a mesh already";
                return Err(Error::Job(cause(last.display(), problem, "omit it")));
            }
        };
        Ok(Self {
            image,
            mesh,
            shapes,
        })
    }

    fn image(&self) -> &Path {
        self.image.as_deref().unwrap_or(Path::new("the image"))
    }

    fn mesh(&self) -> &Path {
        self.mesh.as_deref().unwrap_or(Path::new("the mesh"))
    }
}

/// Draws a mesh over its image, a part of it in space, surfaces and lines, as `atomesh slice` does.
///
/// ```
/// use atomesh::image::formats::{AnyImage, OpenedImage};
/// use atomesh::image::synth::{self, SyntheticKind};
/// use atomesh::model::slice::{SliceInput, SliceSpec};
/// use atomesh::progress::NoProgress;
///
/// let options = synth::Options { dims: [40, 36, 32], ..Default::default() };
/// let image = synth::make(SyntheticKind::Sphere, &options)?.image;
/// let image = OpenedImage::InMemory(AnyImage::Space(image.into()));
/// let input = SliceInput { image: Some(image), ..SliceInput::default() };
/// let picture = atomesh::slice(input, &SliceSpec::default(), &mut NoProgress)?;
/// assert!(picture.size()[0] > 500);
/// # Ok::<(), atomesh::Error>(())
/// ```
///
/// # Errors
/// Returns the errors of [`SliceSpec::validate`] and of reading the image, and [`Error::Job`] for
/// objects that cannot be drawn together.
pub fn slice(input: SliceInput, spec: &SliceSpec, progress: &mut dyn Progress) -> Result<Canvas> {
    spec.validate(input.image.is_some(), input.mesh.is_some())?;
    let SliceInput {
        image,
        mesh,
        shapes,
        names,
    } = input;
    // A view in space needs the image at any point, not only on planes.
    let load = |image: OpenedImage| match spec.view {
        View::Sections => Ok(image),
        View::Solid => image.load(names.image()).map(OpenedImage::InMemory),
    };
    let image = image.map(load).transpose()?;
    progress.stage(Stage::Drawing);
    let drawing = Drawing {
        spec,
        names: &names,
        shapes,
    };
    drawing.draw(image, mesh)
}

fn slice_error(place: &Path, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(place.display(), problem, remedy))
}

/// The objects to draw, besides the image and the mesh.
struct Drawing<'a> {
    spec: &'a SliceSpec,
    names: &'a InputNames,
    shapes: Vec<OverlayShape>,
}

impl Drawing<'_> {
    fn draw(self, image: Option<OpenedImage>, mesh: Option<AnyMesh>) -> Result<Canvas> {
        let dimension_error = |mesh: u8, image: u8| {
            let problem = format!("is a {mesh}-D mesh, but the image is {image}-D");
            slice_error(self.names.mesh(), &problem, "give the mesh of the image")
        };
        let is_solid = self.spec.view == View::Solid;
        let flat_error = |object: &str| {
            let problem = format!("shows objects in space, but {object} is 2-D");
            Error::Job(cause("view 3d", problem, "omit it"))
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
            return Err(Error::Job(cause("slice", problem, "omit it")));
        }
        let loaded = self.place_image(loaded, file.as_ref())?;
        let caption = self.caption(file.as_ref(), Some(&loaded.header()));
        let image = &loaded.image;
        let overlay = self.overlay(file, &image.geometry, image.dims())?;
        draw_plane(image, &overlay, &caption)
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
                if self.spec.view == View::Solid {
                    return self.draw_solid(Some(loaded), file);
                }
                (loaded.header(), &loaded.image)
            }
            _ => return self.draw_solid(None, file),
        };
        if let Some(lines) = self.shapes.iter().find(|shape| shape.triangles.is_empty()) {
            let problem = format!("does not show lines in space: {}", lines.name);
            return Err(Error::Job(cause(
                "view sections",
                problem,
                "give --view 3d",
            )));
        }
        let at = self.spec.crossing_index(&head.geometry, Some(&head))?;
        let at = at.unwrap_or_else(|| head.dims.map(|n| (n / 2) as f64));
        let mut caption = self.caption(file.as_ref(), Some(&head));
        caption.subtitle += &crossing_caption(&head, at, &caption);
        let sections = Sections::new(self.names.image(), head.dims, slabs, at)?;
        let overlay = self.overlay(file, &head.geometry, head.dims)?;
        draw_sections(&sections, &head.geometry, &overlay, &caption)
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
        let at = self.spec.crossing_index(&space.geometry, head.as_ref())?;
        // For surfaces, and for meshes that do not record the position of their image, z is up.
        let has_orientation =
            loaded.is_some() || stored.as_ref().is_some_and(|s| s.space.is_stored);
        let upwards = SignedAxis {
            axis: 2,
            is_positive: true,
        };
        let up = self.spec.up_direction::<3>()?;
        let up = up.or((!has_orientation).then_some(upwards));
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
            cut: self.spec.cut.unwrap_or_default(),
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
        let up = self.spec.up_direction::<D>()?;
        let Some(file) = file else {
            return Ok(Overlay {
                shapes: self.shapes,
                up_direction: up,
                ..Overlay::default()
            });
        };
        let mesh = Skeleton::new(&file, geometry).ok_or_else(|| self.degenerate_axes_error())?;
        let mut painted = None;
        if self.spec.color.is_some() {
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
        StoredMesh::new(file, &self.names.mesh().display().to_string())
    }

    fn paint<const D: usize, M: Storable<D>>(
        &self,
        stored: &StoredMesh<D, M>,
    ) -> Result<Option<Paint>> {
        let place = self.names.mesh().display().to_string();
        let color = self.spec.color.as_deref();
        color
            .map(|name| Paint::from_array(stored, name, &place))
            .transpose()
    }

    fn image_name(&self) -> String {
        self.names.image().display().to_string()
    }

    fn degenerate_axes_error(&self) -> Error {
        let problem = "the image's axes are linearly dependent";
        let place = self.names.mesh.as_deref().unwrap_or(self.names.image());
        slice_error(place, problem, "correct its geometry")
    }

    /// Returns the caption: the files, the number of cells, and the nominal distance of atoms.
    fn caption<const D: usize, M: Mesh<D>>(
        &self,
        file: Option<&MeshFile<M>>,
        head: Option<&ImageHeader<D>>,
    ) -> Caption {
        let names = self.names;
        let foreground: Vec<&Path> = names
            .mesh
            .iter()
            .chain(&names.shapes)
            .map(PathBuf::as_path)
            .collect();
        let rulers = std::array::from_fn(|k| (k < D).then(|| line_ruler(head?, k)).flatten());
        Caption {
            title: title(&foreground, names.image.as_deref()),
            subtitle: file.map(cells_caption).unwrap_or_default(),
            value_label: String::new(),
            rulers,
        }
    }
}
