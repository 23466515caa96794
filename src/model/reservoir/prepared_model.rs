//! Builds a reservoir model from a mesh file: cells in metres with depth, the sides of the box, and
//! the map from images to cells.

use crate::error::cause;
use crate::files::vtk::DataArray;
use crate::geometry::{sub, unit};
use crate::image::formats::same_place::{
    ROUNDING, RelativePlace, extent_text, relative_place, unit_factors,
};
use crate::image::placing::Frame;
use crate::image::placing::ranges;
use crate::image::time::metres_per_unit;
use crate::image::{Geometry, Image, Modality};
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Mesh, Positions, Simplices, TetMesh};
use crate::model::columns::{COLUMN, LAYER};
use crate::model::flow::anisotropy::AxisRatios;
use crate::model::reservoir::averaging::{ImageProbe, IndexMap};
use crate::model::reservoir::periodic_pairs::PeriodicImages;
use crate::model::reservoir::region_shares::RegionShares;
use crate::model::reservoir::{
    CellMeans, DepthAxis, FaceSurfaces, MeanKind, Model, ModelFrame, ModelSets, SamplePositions,
    averaging,
};
use crate::model::surface::facet_selection::labels_of_faces;
use crate::model::surface::stored_surfaces::numbered_surfaces;
use crate::progress::CancelToken;
use crate::store::{
    AnyMesh, LabelledRegion, MeshFile, NamedRegion, Storable, StoredMesh, read_labels,
    read_named_regions,
};
use crate::{Error, Result};

/// Largest distance, in samples, of a mesh outside an image that covers it: half a sample, because
/// coordinates of a survey are rounded.
const MAX_DISTANCE_OUTSIDE: f64 = 0.5 + 1e-6;

/// Units and depth of a mesh's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshPlacement {
    /// Metres in one unit of the coordinates that are lengths. If `None`, the unit that the mesh
    /// states applies.
    pub length: Option<f64>,
    /// `true` if the coordinates of a scan stay in the unit that the mesh states, unless `length`
    /// is given.
    pub keeps_unit: bool,
    /// The coordinate that is depth.
    pub depth_axis: DepthAxis,
    /// Velocity in m/s, for depth in two-way time.
    pub velocity: Option<f64>,
    /// Depth in metres of the mesh's shallowest point. If `None`, depth follows from the
    /// coordinates.
    pub top: Option<f64>,
    /// Thickness of a 2-D mesh, in its own unit.
    pub thickness: f64,
}

impl Default for MeshPlacement {
    /// Returns metres with z upwards.
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

/// A model with geometry but without rock properties.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedModel {
    /// The model.
    pub model: Model,
    /// The map from the mesh's coordinates to the model's.
    pub frame: ModelFrame,
    /// Volume that the cells should fill, in the model's coordinates: that of the mesh's box, or the volume within the
    /// outer faces if a side of the box is bent.
    pub box_volume: f64,
    /// Unit of the model's coordinates: metres, or that of a scan.
    pub unit: String,
    /// Cell arrays of the file.
    pub cell_data: Vec<DataArray>,
    /// `true` if the mesh marks the faces that lie on features.
    pub has_feature_faces: bool,
    /// The map from samples of the meshed image to the mesh's coordinates.
    geometry: Geometry<3>,
    /// Length of one sample along each axis of lattice space.
    step: [f64; 3],
    /// Number of samples of the meshed image along each axis.
    dims: [f64; 3],
}

/// The parts of a model that are the same for all kinds of cells.
struct ModelParts {
    surfaces: Option<FaceSurfaces>,
    mesh: PolyMesh<3>,
    tets: Option<TetMesh>,
    triangles: Option<Vec<[u32; 3]>>,
    geometry: Geometry<3>,
    step: [f64; 3],
    dims: [f64; 3],
    box_volume: f64,
    /// `true` if the cells do not fill the box, because one of its sides is bent.
    is_bent: bool,
    has_feature_faces: bool,
    cell_data: Vec<DataArray>,
    labels: Vec<LabelledRegion>,
    named_regions: Vec<NamedRegion>,
    sets: ModelSets,
    periodic: PeriodicImages,
}

/// Returns the error for a mesh from which no model can be built.
fn mesh_error(place: &str, problem: String) -> Error {
    let remedy = "give a mesh that passes the checker: mesh the image again";
    Error::Mesh(cause(place, problem, remedy))
}

/// The cells of a mesh: polyhedra or polygons in the file's coordinates, with their box sides; the
/// original simplices, if there are any; the surface number of each face; and the other data of the
/// file.
type ModelCells<const D: usize, M> = (PolyMesh<D>, Option<M>, Vec<u32>, MeshFile<()>);

/// A kind of cells from which models can be built.
trait ToModelCells<const D: usize>: Storable<D> {
    /// Converts a mesh. `facets` are those of
    /// [`NumberedSurfaces`](crate::model::surface::stored_surfaces::NumberedSurfaces). Each face of
    /// the result has the number of the surface of its facets.
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
        let has_volume = |&c: &usize| stored.lattice.volume(c) > 0.0;
        if let Some(cell) = cells.clone().find(|c| !has_volume(c)) {
            let problem = format!("number {cell} of its {} is flat or inverted", M::CELLS_NAME);
            return Err(mesh_error(place, problem));
        }
        let bits = stored.feature_faces.as_deref().unwrap_or(&[]);
        let region = stored.regions().unwrap_or_default();
        let mut mesh = PolyMesh::from_simplices(&stored.lattice, bits, &region)?;
        mesh.assign_sides([0.0; D], stored.space.extent);
        if let Some(side) = stored.space.bent_side {
            mesh.assign_bent_side(side, [0.0; D], stored.space.extent);
        }
        if let Some(outer) = &stored.outer {
            mesh.release_outer_faces(outer);
        }
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
        for (label, on_feature) in surface.iter_mut().zip(&mesh.on_feature) {
            if !on_feature {
                *label = 0;
            }
        }
        Ok((mesh, None, surface, arrays))
    }
}

impl ModelParts {
    /// Returns the parts, and the simplices if the cells are simplices. `to_solid` converts 2-D
    /// polygons to polyhedra with the height `thickness`. Surfaces are found only if
    /// `with_surfaces`.
    fn from_file<const D: usize, M: ToModelCells<D>>(
        file: MeshFile<M>,
        place: &str,
        thickness: f64,
        with_surfaces: bool,
        to_solid: impl FnOnce(PolyMesh<D>) -> PolyMesh<3>,
    ) -> Result<(Self, Option<M>)> {
        let mut stored = StoredMesh::new(file, place)?;
        let sets = std::mem::take(&mut stored.named_sets);
        stored.check_filled(place)?;
        let space = stored.space.clone();
        let filled_share = (stored.outer.as_ref()).map_or(1.0, |outer| outer.filled_share);
        let marks = stored.feature_marks();
        let has_feature_faces = marks.is_some();
        let marks = marks.filter(|_| with_surfaces);
        let numbered = marks.map(|marks| numbered_surfaces(&stored, &marks));
        let facets = numbered
            .as_ref()
            .map_or(&[][..], |numbered| &numbered.facets);
        let (mesh, simplices, mut surface, arrays) = M::model_cells(stored, facets, place)?;
        // Prism faces on edges have the numbers of the edges.
        surface.truncate(mesh.inner_face_count());
        let surfaces = numbered.map(|numbered| FaceSurfaces {
            kinds: numbered.kinds,
            names: numbered.names,
            kept_count: numbered.kept_count,
            connection_surfaces: surface,
            extensions: Vec::new(),
        });
        let samples: [f64; D] = std::array::from_fn(|k| space.extent[k] / space.step[k]);
        let volume = samples.iter().product::<f64>() * space.geometry.determinant().abs();
        let dim = |k: usize| samples.get(k).map_or(1.0, |n| n + 1.0);
        let mesh = to_solid(mesh);
        let parts = Self {
            surfaces,
            sets: ModelSets::new(sets, &mesh, D == 2),
            mesh,
            tets: None,
            triangles: None,
            geometry: space.geometry.to_3d(),
            step: std::array::from_fn(|k| space.step.get(k).copied().unwrap_or(1.0)),
            dims: std::array::from_fn(dim),
            box_volume: filled_share * volume * if D == 2 { thickness } else { 1.0 },
            is_bent: space.bent_side.is_some() || arrays.cell_array(COLUMN).is_some(),
            has_feature_faces,
            labels: read_labels(&arrays),
            periodic: PeriodicImages::from_file(&arrays),
            named_regions: read_named_regions(&arrays),
            cell_data: arrays.cell_data,
        };
        Ok((parts, simplices))
    }

    /// Builds the parts from a mesh with any kind of cells. 2-D cells become prisms.
    fn from_any_mesh(
        file: AnyMesh,
        place: &str,
        thickness: f64,
        with_surfaces: bool,
    ) -> Result<Self> {
        let prisms = |mesh: PolyMesh<2>| mesh.extrude(thickness);
        // Formats for simplices only need the original simplices, so each kind of cells has its own
        // case.
        Ok(match file {
            AnyMesh::Tetrahedra(file) => {
                let (parts, tets) =
                    Self::from_file(file, place, thickness, with_surfaces, |mesh| mesh)?;
                Self { tets, ..parts }
            }
            AnyMesh::Triangles(file) => {
                let (parts, mesh) = Self::from_file(file, place, thickness, with_surfaces, prisms)?;
                let triangles = mesh.map(|mesh| mesh.triangles);
                Self { triangles, ..parts }
            }
            AnyMesh::Polyhedra(file) => {
                Self::from_file(file, place, thickness, with_surfaces, |mesh| mesh)?.0
            }
            AnyMesh::Polygons(file) => {
                Self::from_file(file, place, thickness, with_surfaces, prisms)?.0
            }
        })
    }
}

impl PreparedModel {
    /// Returns the frame of the meshed image, into which the positions that the user gives are brought.
    pub(super) fn image_frame(&self) -> Frame<3> {
        Frame::new(&self.geometry, self.dims.map(|n| n.round() as usize))
    }

    /// Builds a model from a mesh with any kind of cells; `place` names the mesh in errors.
    /// Triangles and polygons become prisms.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] for an invalid mesh, and [`Error::Export`] for invalid units.
    pub fn new(file: AnyMesh, place: &str, placement: &MeshPlacement) -> Result<Self> {
        Self::build(file, place, placement, true)
    }

    /// Builds a model without searching for surfaces, which takes time: all faces on features form
    /// one fault.
    ///
    /// # Errors
    /// Returns the errors of [`new`](Self::new).
    pub fn without_surfaces(file: AnyMesh, place: &str, placement: &MeshPlacement) -> Result<Self> {
        Self::build(file, place, placement, false)
    }

    fn build(
        file: AnyMesh,
        place: &str,
        placement: &MeshPlacement,
        with_surfaces: bool,
    ) -> Result<Self> {
        let parts = ModelParts::from_any_mesh(file, place, placement.thickness, with_surfaces)?;
        let cell_data = parts.cell_data;
        let MeshPlacement {
            length,
            keeps_unit,
            depth_axis,
            velocity,
            top,
            ..
        } = *placement;
        let units = &parts.geometry.units;
        let same_units = units.iter().all(|unit| *unit == units[0]);
        let is_scan = parts.geometry.modality() == Modality::Scan;
        let (length, unit) = if keeps_unit && length.is_none() && same_units && is_scan {
            (Some(1.0), units[0].clone())
        } else {
            (length, "m".to_string())
        };
        let mut frame = ModelFrame::new(units, length, depth_axis, velocity)?;
        if let Some(top) = top {
            frame = frame.with_top(&parts.mesh.nodes, top);
        }
        let box_volume = if parts.is_bent {
            parts.mesh.enclosed_volume()
        } else {
            parts.box_volume
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
        model.sets = parts.sets;
        model.periodic = parts.periodic;
        model.named_regions = parts.named_regions;
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

    /// Returns the errors of two-point fluxes along each axis, if the cells are 3-D Voronoi cells
    /// and the permeability is known; otherwise `None`.
    ///
    /// # Errors
    /// Returns the errors of [`CellFlow`](crate::model::flow::CellFlow).
    pub(crate) fn axis_ratios(&self) -> Result<Option<AxisRatios<3>>> {
        let model = &self.model;
        let is_voronoi = model.tets.is_none() && !model.mesh.is_columnar();
        let Some(permeability) = model.permeability.as_ref().filter(|_| is_voronoi) else {
            return Ok(None);
        };
        let (axes, cancel) = (self.axis_vectors(), CancelToken::never());
        AxisRatios::new(&model.graph, &permeability.rock, &axes, self.step, &cancel).map(Some)
    }

    /// Returns the vectors from sample to sample along the image's axes, in the model's metres.
    fn axis_vectors(&self) -> [[f64; 3]; 3] {
        let origin = self.frame.to_model([0.0; 3]);
        (self.geometry.axes).map(|axis| sub(self.frame.to_model(axis), origin))
    }

    /// Returns the directions of the image's axes in the model, as unit vectors.
    pub(crate) fn image_axes(&self) -> [[f64; 3]; 3] {
        self.axis_vectors().map(unit)
    }

    /// Returns a value for each cell from an image. The image must have a position such that it covers
    /// the mesh, or no position and the dimensions of the meshed image. `place` names it in errors.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if the image has neither, and the errors of
    /// `averaging::average_cells`.
    pub fn average(&self, image: &Image<3>, mean: MeanKind, place: &str) -> Result<CellMeans> {
        let (positions, _) = self.positions_in(image, place)?;
        averaging::average_cells(&self.model.mesh, &positions, image, mean, place)
    }

    /// Returns the regions of the cells from an image of labels, which is placed as for
    /// [`average`](Self::average).
    ///
    /// # Errors
    /// Returns [`Error::Image`] as [`average`](Self::average) does.
    pub fn region_shares(&self, image: &Image<3>, place: &str) -> Result<RegionShares> {
        let (positions, _) = self.positions_in(image, place)?;
        Ok(RegionShares::new(&self.model.mesh, &positions, image))
    }

    /// Returns a probe of an image, which is placed as for [`average`](Self::average).
    ///
    /// # Errors
    /// Returns [`Error::Image`] as [`average`](Self::average) does.
    pub fn probe(&self, image: Image<3>, place: &str) -> Result<ImageProbe> {
        let (_, index_of) = self.positions_in(&image, place)?;
        Ok(ImageProbe::new(image, index_of))
    }

    /// Returns the positions of the mesh in an image, and the map to them: by the coordinates of the image, or, if
    /// it has as many samples as the meshed image and no position that can be compared with the mesh's, by
    /// the indices of its samples. The sign of z is the one with which the image covers the mesh.
    fn positions_in(&self, image: &Image<3>, place: &str) -> Result<(SamplePositions, IndexMap)> {
        let dims = image.dims();
        let has_same_dims = (0..3).all(|k| (dims[k] as f64 - self.dims[k]).abs() < 1e-6);
        let relative = relative_place(&self.geometry, &image.geometry, dims, ROUNDING);
        let is_same = matches!(relative, RelativePlace::Unknown)
            || relative == RelativePlace::Same([false; 3]);
        let mesh = &self.model.mesh;
        if has_same_dims && is_same {
            let (geometry, frame) = (self.geometry.clone(), self.frame.clone());
            let index_of: IndexMap = Box::new(move |point| {
                let index = geometry.to_index(frame.to_file(point));
                index.unwrap_or([f64::NAN; 3])
            });
            return Ok((SamplePositions::new(mesh, dims, &index_of), index_of));
        }
        let time_axis = image.geometry.time_coordinate();
        if time_axis.is_some_and(|c| metres_per_unit(&self.geometry.units[c]).is_some()) {
            let problem = "is in two-way time, the mesh in depth";
            let remedy = "give the image in depth, which atomesh convert --velocity makes";
            return Err(Error::Image(cause(place, problem, remedy)));
        }
        let factors = unit_factors(&self.geometry, &image.geometry);
        let signs: &[f64] = if factors.is_some() {
            &[1.0, -1.0]
        } else {
            &[1.0]
        };
        for &sign in signs {
            let (geometry, frame) = (image.geometry.clone(), self.frame.clone());
            let [fx, fy, fz] = factors.unwrap_or([1.0; 3]);
            let index_of: IndexMap = Box::new(move |point| {
                let point = frame.to_file(point);
                let position = [point[0] * fx, point[1] * fy, point[2] * fz * sign];
                geometry.to_index(position).unwrap_or([f64::NAN; 3])
            });
            let positions = SamplePositions::new(mesh, dims, &index_of);
            let is_located = image.geometry.determinant() != 0.0;
            if is_located && positions.max_distance_outside() <= MAX_DISTANCE_OUTSIDE {
                return Ok((positions, index_of));
            }
        }
        Err(self.place_error(image, has_same_dims, place))
    }

    /// Returns the error for an image that does not cover the mesh.
    fn place_error(&self, image: &Image<3>, has_same_dims: bool, place: &str) -> Error {
        let dims = image.dims();
        let nodes = self.model.mesh.nodes.iter();
        let points = nodes.map(|&node| self.frame.to_file(node));
        let extents = format!(
            "lies at {}, the mesh at {}",
            extent_text(&image.geometry, dims),
            ranges(points, &self.geometry.units)
        );
        if has_same_dims {
            let problem = format!("does not cover the mesh: it {extents}");
            let remedy = "give an image whose position covers the mesh, or one without a position, such as .npy, with the samples of the meshed image";
            return Error::Image(cause(place, problem, remedy));
        }
        let problem = format!(
            "is of {dims:?} samples, the image that was meshed of {:?}, and does not cover the mesh: it {extents}",
            self.dims
        );
        let remedy =
            "give an image of the same dimensions, or one with a position that covers the mesh";
        Error::Image(cause(place, problem, remedy))
    }
}
