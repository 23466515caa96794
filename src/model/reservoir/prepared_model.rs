//! A mesh from a file as a reservoir model: in metres with depth, its sides known, and the way from
//! images to its cells.

use crate::error::cause;
use crate::files::vtk::DataArray;
use crate::image::{Geometry, Image, Modality};
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Mesh, Positions, Simplices, TetMesh};
use crate::model::columns::{COLUMN, LAYER};
use crate::model::flow::anisotropy::AxisRatios;
use crate::model::reservoir::{
    DepthAxis, FaceSurfaces, MeanKind, Model, ModelFrame, SamplePositions, averaging,
};
use crate::model::surface::facet_selection::labels_of_faces;
use crate::model::surface::stored_surfaces::numbered_surfaces;
use crate::progress::CancelToken;
use crate::store::{AnyMesh, LabelledRegion, MeshFile, Storable, StoredMesh, read_labels};
use crate::{Error, Result};

/// Where a mesh's coordinates are in metres and depth.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshPlacement {
    /// Metres in a unit of the coordinates that are lengths; as the mesh states it if `None`.
    pub length: Option<f64>,
    /// The coordinates of a scan stay in the unit that the mesh states, if no other is given.
    pub keeps_unit: bool,
    /// The coordinate that is depth.
    pub depth_axis: DepthAxis,
    /// Velocity in m/s, for depth in two-way time.
    pub velocity: Option<f64>,
    /// Depth in metres of the mesh's shallowest point; as its coordinates have it if `None`.
    pub top: Option<f64>,
    /// Thickness of a mesh of the plane, in its own unit.
    pub thickness: f64,
}

impl Default for MeshPlacement {
    /// Metres, z upwards.
    fn default() -> Self {
        Self {
            length: None,
            keeps_unit: false,
            depth_axis: DepthAxis::default(),
            velocity: None,
            top: None,
            thickness: 1.0,
        }
    }
}

/// A model whose cells are still to be filled.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedModel {
    /// The model.
    pub model: Model,
    /// From the mesh's coordinates to the model's.
    pub frame: ModelFrame,
    /// Volume of the mesh's box, in the model's coordinates.
    pub box_volume: f64,
    /// Unit of the model's coordinates: metres, or that of a scan.
    pub unit: String,
    /// What the file knows of each cell.
    pub cell_data: Vec<DataArray>,
    /// Whether the mesh says which faces lie on features.
    pub has_feature_faces: bool,
    /// From samples of the image that was meshed to the mesh's coordinates.
    geometry: Geometry<3>,
    /// Length of one sample along each axis of lattice space.
    step: [f64; 3],
    /// Number of samples of that image along each axis, if the mesh is of one.
    dims: [f64; 3],
}

/// The parts of a mesh that are the same for all kinds of cells.
struct ModelParts {
    surfaces: Option<FaceSurfaces>,
    mesh: PolyMesh<3>,
    tets: Option<TetMesh>,
    triangles: Option<Vec<[u32; 3]>>,
    geometry: Geometry<3>,
    step: [f64; 3],
    dims: [f64; 3],
    box_volume: f64,
    has_feature_faces: bool,
    cell_data: Vec<DataArray>,
    labels: Vec<LabelledRegion>,
}

/// A mesh that no model can be made of.
fn mesh_error(place: &str, problem: String) -> Error {
    let remedy = "give a mesh that passes the checker: mesh the image again";
    Error::Mesh(cause(place, problem, remedy))
}

/// A mesh as polyhedra or polygons in the file's coordinates, their sides known; the simplices that it is
/// of, if it is; the number of each face's surface; and what else the file holds.
type ModelCells<const D: usize, M> = (PolyMesh<D>, Option<M>, Vec<u32>, MeshFile<()>);

/// A kind of cells that models are made of.
trait ToModelCells<const D: usize>: Storable<D> {
    /// `facets` are those of [`Numbered`](crate::model::mesh_faces::stored_surfaces::NumberedSurfaces); each face of the cells gets the number of its first.
    fn model_cells(
        stored: StoredMesh<D, Self>,
        facets: &[([u32; D], u32)],
        place: &str,
    ) -> Result<ModelCells<D, Self>>;
}

impl<const D: usize, M: Simplices<D>> ToModelCells<D> for M {
    fn model_cells(
        stored: StoredMesh<D, M>,
        facets: &[([u32; D], u32)],
        place: &str,
    ) -> Result<ModelCells<D, M>> {
        let cells = 0..stored.lattice.len();
        let sound = |&c: &usize| stored.lattice.volume(c) > 0.0;
        if let Some(cell) = cells.clone().find(|c| !sound(c)) {
            let problem = format!("number {cell} of its {} is flat or inverted", M::CELLS_NAME);
            return Err(mesh_error(place, problem));
        }
        let bits = stored.feature_faces.as_deref().unwrap_or(&[]);
        let region = stored.regions().unwrap_or_default();
        let mut mesh = PolyMesh::from_simplices(&stored.lattice, bits, &region)?;
        mesh.assign_sides([0.0; D], stored.space.extent);
        let surface = labels_of_faces(&mesh, facets);
        let sites = mesh.sites.iter().map(|&x| stored.space.to_world(x));
        let mut world = Positions {
            nodes: stored.world.nodes.clone(),
            sites: sites.collect(),
        };
        mesh.swap_positions(&mut world, stored.space.is_mirrored());
        let (simplices, arrays) = stored.into_file().into_parts();
        Ok((mesh, Some(simplices), surface, arrays))
    }
}

impl<const D: usize> ToModelCells<D> for PolyMesh<D> {
    fn model_cells(
        stored: StoredMesh<D, Self>,
        facets: &[([u32; D], u32)],
        _: &str,
    ) -> Result<ModelCells<D, Self>> {
        let (mesh, arrays) = stored.into_file().into_parts();
        let mut surface = labels_of_faces(&mesh, facets);
        for (number, on_feature) in surface.iter_mut().zip(&mesh.on_feature) {
            if !on_feature {
                *number = 0;
            }
        }
        Ok((mesh, None, surface, arrays))
    }
}

impl ModelParts {
    /// The parts that all kinds of cells have, and the simplices if they are such; `solid` makes
    /// polyhedra of the plane's polygons, `thickness` high. Surfaces are found if `grouped`.
    fn from_file<const D: usize, M: ToModelCells<D>>(
        file: MeshFile<M>,
        place: &str,
        thickness: f64,
        grouped: bool,
        solid: impl FnOnce(PolyMesh<D>) -> PolyMesh<3>,
    ) -> Result<(Self, Option<M>)> {
        let stored = StoredMesh::new(file, place)?;
        stored.check_filled(place)?;
        let space = stored.space.clone();
        let marks = stored.feature_marks();
        let features_known = marks.is_some();
        let marks = marks.filter(|_| grouped);
        let numbered = marks.map(|marks| numbered_surfaces(&stored, &marks));
        let facets = numbered.as_ref().map_or(&[][..], |found| &found.facets);
        let (mesh, simplices, mut surface, arrays) = M::model_cells(stored, facets, place)?;
        // Those of prisms on edges have the edges' numbers.
        surface.truncate(mesh.inner_face_count());
        let surfaces = numbered.map(|found| FaceSurfaces {
            kinds: found.kinds,
            names: found.names,
            kept_count: found.kept_count,
            connection_surfaces: surface,
        });
        let samples: [f64; D] = std::array::from_fn(|k| space.extent[k] / space.step[k]);
        let volume = samples.iter().product::<f64>() * space.geometry.determinant().abs();
        let dim = |k: usize| samples.get(k).map_or(1.0, |n| n + 1.0);
        let parts = Self {
            surfaces,
            mesh: solid(mesh),
            tets: None,
            triangles: None,
            geometry: space.geometry.to_3d(),
            step: std::array::from_fn(|k| space.step.get(k).copied().unwrap_or(1.0)),
            dims: std::array::from_fn(dim),
            box_volume: volume * if D == 2 { thickness } else { 1.0 },
            has_feature_faces: features_known,
            labels: read_labels(&arrays),
            cell_data: arrays.cell_data,
        };
        Ok((parts, simplices))
    }

    /// Of a mesh of any kind of cells; those of the plane become prisms.
    fn from_any_mesh(file: AnyMesh, place: &str, thickness: f64, grouped: bool) -> Result<Self> {
        let prisms = |mesh: PolyMesh<2>| mesh.extrude(thickness);
        // Formats that hold simplices only get these as they are, so that the kinds part here.
        Ok(match file {
            AnyMesh::Tetrahedra(file) => {
                let (parts, tets) = Self::from_file(file, place, thickness, grouped, |mesh| mesh)?;
                Self { tets, ..parts }
            }
            AnyMesh::Triangles(file) => {
                let (parts, mesh) = Self::from_file(file, place, thickness, grouped, prisms)?;
                let triangles = mesh.map(|mesh| mesh.triangles);
                Self { triangles, ..parts }
            }
            AnyMesh::Polyhedra(file) => {
                Self::from_file(file, place, thickness, grouped, |mesh| mesh)?.0
            }
            AnyMesh::Polygons(file) => Self::from_file(file, place, thickness, grouped, prisms)?.0,
        })
    }
}

impl PreparedModel {
    /// A mesh of any kind of cells; `place` names it in errors. Triangles and polygons become prisms.
    ///
    /// # Errors
    /// [`Error::Mesh`] for a mesh that makes no sense, [`Error::Export`] for units that do not.
    pub fn new(file: AnyMesh, place: &str, placement: &MeshPlacement) -> Result<Self> {
        Self::build(file, place, placement, true)
    }

    /// The same without its surfaces, which take time to find: all faces on features are one fault.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn without_surfaces(file: AnyMesh, place: &str, placement: &MeshPlacement) -> Result<Self> {
        Self::build(file, place, placement, false)
    }

    fn build(file: AnyMesh, place: &str, placement: &MeshPlacement, grouped: bool) -> Result<Self> {
        let parts = ModelParts::from_any_mesh(file, place, placement.thickness, grouped)?;
        let cell_data = parts.cell_data;
        let MeshPlacement {
            length,
            keeps_unit: keep_unit,
            depth_axis: down,
            velocity,
            top,
            ..
        } = *placement;
        let units = &parts.geometry.units;
        let alike = units.iter().all(|unit| *unit == units[0]);
        let is_scan = parts.geometry.modality() == Modality::Scan;
        let (length, unit) = if keep_unit && length.is_none() && alike && is_scan {
            (Some(1.0), units[0].clone())
        } else {
            (length, "m".to_string())
        };
        let mut frame = ModelFrame::new(units, length, down, velocity)?;
        if let Some(top) = top {
            frame = frame.with_top(&parts.mesh.nodes, top);
        }
        let box_volume = match cell_data.iter().any(|array| array.name == COLUMN) {
            true => parts.mesh.enclosed_volume(),
            false => parts.box_volume,
        };
        let mesh = (parts.mesh).mapped(|p| frame.to_model(p), frame.is_mirrored());
        let tets = parts.tets.map(|mut tets| {
            tets.nodes.clone_from(&mesh.nodes);
            if frame.is_mirrored() {
                tets.tets.iter_mut().for_each(|tet| tet.swap(2, 3));
            }
            tets
        });
        let mut model = Model::new(mesh, tets);
        model.labels = parts.labels;
        if let Some(surfaces) = parts.surfaces {
            model.surfaces = surfaces;
        }
        model.triangles = parts.triangles.map(|mut triangles| {
            if frame.is_mirrored() {
                triangles
                    .iter_mut()
                    .for_each(|triangle| triangle.swap(1, 2));
            }
            triangles
        });
        let columns = cell_data.iter();
        let columns = columns.filter(|a| [COLUMN, LAYER].contains(&a.name.as_str()));
        model.properties.extend(columns.cloned());
        let box_volume = box_volume * frame.volume_of_unit();
        for (cell, &volume) in model.graph.volume.iter().enumerate() {
            if !(volume > 0.0 && volume.is_finite()) {
                let problem = format!("cell {cell} has the volume {volume:e} m^3");
                return Err(mesh_error(place, problem));
            }
        }
        Ok(Self {
            unit,
            model,
            box_volume,
            frame,
            cell_data,
            has_feature_faces: parts.has_feature_faces,
            geometry: parts.geometry,
            step: parts.step,
            dims: parts.dims,
        })
    }

    /// What two-point fluxes make of flow along each axis, in Voronoi cells of space whose permeability is
    /// known; `None` for others.
    ///
    /// # Errors
    /// Those of [`AxisRatios`].
    pub fn axis_ratios(&self) -> Result<Option<AxisRatios<3>>> {
        let model = &self.model;
        let is_voronoi = model.tets.is_none() && !model.mesh.is_columnar();
        let Some(known) = model.permeability.as_ref().filter(|_| is_voronoi) else {
            return Ok(None);
        };
        let origin = self.frame.to_model([0.0; 3]);
        let axes = self.geometry.axes.map(|axis| {
            let end = self.frame.to_model(axis);
            std::array::from_fn(|k| end[k] - origin[k])
        });
        let patience = CancelToken::never();
        AxisRatios::new(&model.graph, &known.rock, &axes, self.step, &patience).map(Some)
    }

    /// A value for each cell from an image: one of the dims of the image that was meshed, or one that
    /// says where it lies and covers the mesh. `place` names it in errors.
    ///
    /// # Errors
    /// [`Error::Image`] if it is neither, [`Error::Export`] as `sample::sample`.
    pub fn average(&self, image: &Image<3>, mean: MeanKind, place: &str) -> Result<Vec<f64>> {
        let dims = image.dims();
        let same = (0..3).all(|k| (dims[k] as f64 - self.dims[k]).abs() < 1e-6);
        let geometry = if same {
            &self.geometry
        } else {
            &image.geometry
        };
        let time = image.geometry.time_coordinate();
        if !same && time.is_some_and(|c| self.geometry.units[c] == "m") {
            let problem = "is in two-way time, the mesh in depth";
            let remedy = "give the image in depth, which atomesh convert --velocity makes";
            return Err(Error::Image(cause(place, problem, remedy)));
        }
        let index_of = |point: [f64; 3]| {
            let index = geometry.to_index(self.frame.to_file(point));
            index.unwrap_or([f64::NAN; 3])
        };
        let places = SamplePositions::new(&self.model.mesh, dims, index_of);
        // Coordinates of a survey are rounded.
        let spans = geometry.determinant() != 0.0;
        if !same && (!spans || places.max_distance_outside() > 0.5) {
            return Err(Error::Image(cause(
                place,
                format!(
                    "is of {dims:?} samples, the image that was meshed of {:?}, and does not cover the mesh",
                    self.dims
                ),
                "give an image of the same dimensions, or one with a position that covers the mesh",
            )));
        }
        averaging::average_cells(&self.model.mesh, &places, image, mean, place)
    }
}
