//! The mesh of a job as a mesh file: physical coordinates, and the data of each node and cell.
//!
//! - `cells`: Voronoi cells
//! - `padding`: cells beyond the image
//! - `lines`: acute lines, and lines where features meet or end, as VTK poly data
//! - `points`: feature points as a table or as VTK poly data

pub(crate) mod cells;
pub(crate) mod lines;
mod padding;
pub(crate) mod points;

use std::path::Path;

use crate::parallel::prelude::*;

use super::horizons::horizon_bits;
use super::live::shares_of_cells;
use super::{AnnotatedMesh, MeshResult, Outcome, scaled_mesh};
use crate::comm::{Comm, SelfComm};
use crate::error::cause;
use crate::feature::{LabelMap, ResolvedOptions};
use crate::files::vtk::DataArray;
use crate::geometry::{add_scaled, bounding_box, sub};
use crate::image::{Geometry, Image, ImageSource, LiveVolume};
use crate::mesh::complex::NONE;
use crate::mesh::poly::PolyMesh;
use crate::mesh::view::MeshView;
use crate::mesh::{Mesh, Simplices};
use crate::mesh_file::array_names::{
    ANGLES_ARRAY, ATOM_KIND_ARRAY, DISTANCE_ARRAY, FAR_AXES_ARRAY, FEATURES_FIELD,
    HORIZON_FACES_ARRAY, IMAGE_ARRAY, LIVE_ARRAY, PERIODIC_NODE_ARRAY, REGION_ARRAY,
};
use crate::mesh_file::labels::regions_field;
use crate::mesh_file::lattice_space::common_fields;
use crate::mesh_file::named_surfaces::NamedSurfaces;
use crate::mesh_file::pvtu::{extract_partition, is_pvtu, with_global_nodes, write_partition};
use crate::mesh_file::{
    AnyMesh, FieldValue, LabelledRegion, LatticeSpace, MeshFile, TakeCells, face_bits_to_physical,
    take_cells, to_physical, write_cells_vtu, write_vtu,
};
use crate::progress::CancelToken;
use crate::report::smallest_angles;
use crate::report::{BodySize, Quality, quality, quality_of_partition};
use crate::{Error, Result};
use cells::cell_mesh_file;
use lines::write_lines;
use padding::with_padding;

/// Returns the mesh of a job in world coordinates, with the data of each node and cell.
pub fn simplex_mesh_file<const D: usize, M: Simplices<D>>(
    outcome: &Outcome<D, M>,
    annotated: &AnnotatedMesh<M>,
) -> MeshFile<M> {
    let geometry = &outcome.geometry;
    let lattice = &annotated.mesh;
    let nodes = lattice.nodes();
    let mesh = to_physical(lattice, outcome.step, geometry);
    let kinds: Vec<u8> = (annotated.node_kinds.iter().map(|&kind| kind as u8)).collect();
    let potential = &outcome.features.potential;
    let in_features = |&x: &[f64; D]| add_scaled(x, 1.0, outcome.feature_offset);
    let feature: Vec<f32> = nodes
        .par_iter()
        .map(|x| potential.value(in_features(x)) as f32)
        .collect();
    let distance: Vec<f32> = nodes
        .par_iter()
        .map(|x| outcome.distance.value_at(in_features(x)) as f32)
        .collect();
    let cells = || (0..lattice.len()).into_par_iter();
    let smallest = smallest_angles(lattice);
    let volume: Vec<f32> = cells().map(|c| mesh.volume(c) as f32).collect();
    let horizons = horizon_bits(
        lattice,
        &annotated.feature_faces,
        &outcome.face_names,
        &outcome.features,
    );
    let mirrored = geometry.determinant() < 0.0;
    let physical_angles = physical_angles(&mesh, geometry, outcome.step);
    let mut file = MeshFile {
        mesh,
        point_data: vec![
            DataArray::scalars(ATOM_KIND_ARRAY, kinds),
            DataArray::scalars("feature", feature),
            DataArray::scalars(DISTANCE_ARRAY, distance),
        ],
        cell_data: vec![
            DataArray::scalars(
                REGION_ARRAY,
                if annotated.regions.is_empty() {
                    vec![0i32; lattice.len()]
                } else {
                    annotated.regions.clone()
                },
            ),
            DataArray::scalars(M::MIN_ANGLE_ARRAY, smallest),
            DataArray::scalars(M::VOLUME_NAME, volume),
            DataArray::scalars(
                M::FEATURE_FACES_ARRAY,
                face_bits_to_physical::<D>(&annotated.feature_faces, mirrored),
            ),
            DataArray::scalars(
                ANGLES_ARRAY,
                annotated.angle_assessment.cell_classes.clone(),
            ),
        ],
        field_data: {
            let mut fields =
                common_fields(geometry, outcome.step, outcome.extent, &outcome.provenance);
            fields.extend(resolved_options_field(&outcome.features.resolved));
            fields.extend(outcome.features.labels.as_ref().and_then(labels_field));
            fields
        },
    };
    if let Some(periodic) = &outcome.periodic_nodes {
        let base = DataArray::scalars(PERIODIC_NODE_ARRAY, periodic.base.clone());
        let axes = DataArray::scalars(FAR_AXES_ARRAY, periodic.far_axes.clone());
        file.point_data.extend([base, axes]);
    }
    file.cell_data.extend(live_array(outcome));
    file.cell_data.extend(physical_angles);
    if !outcome.face_names.is_empty()
        && let Ok(neighbours) = lattice.neighbours()
    {
        let faces = (outcome.face_names.iter().enumerate()).filter_map(|(face, &name)| {
            let (cell, other) = ((face / (D + 1)) as u32, neighbours[face]);
            (name != NONE && other != NONE).then(|| ([cell.min(other), cell.max(other)], name))
        });
        let fields = NamedSurfaces::new(&feature_names(outcome), faces.collect()).into_fields();
        file.field_data.extend(fields);
    }
    // The rank without cells also needs the arrays that the other ranks have.
    if outcome.features.point_counts().on_horizon > 0 {
        let bits = face_bits_to_physical::<D>(&horizons, mirrored);
        file.cell_data
            .push(DataArray::scalars(HORIZON_FACES_ARRAY, bits));
    }
    file
}

/// Returns the array with the share of each cell that holds data, unless all cells are full of data.
pub(super) fn live_array<const D: usize, M>(outcome: &Outcome<D, M>) -> Option<DataArray> {
    let shares = outcome.live.as_ref()?;
    Some(DataArray::scalars(LIVE_ARRAY, shares.clone()))
}

/// Returns the names of the surfaces that have one.
pub(super) fn feature_names<const D: usize, M>(outcome: &Outcome<D, M>) -> Vec<String> {
    let names = outcome.features.names.iter();
    names.map(|name| name.name.clone()).collect()
}

impl<const D: usize, M> Outcome<D, M> {
    /// Returns a file of the mesh without the cells that are left out.
    ///
    /// # Errors
    /// Returns the errors of [`take_cells`].
    pub(crate) fn with_kept_cells<C: TakeCells<D>>(
        &self,
        file: MeshFile<C>,
    ) -> Result<MeshFile<C>> {
        match &self.kept_cells {
            Some(cells) => take_cells(file, cells),
            None => Ok(file),
        }
    }
}

impl<const D: usize, M: Simplices<D>> Outcome<D, M> {
    /// Returns the mesh with all its data in world coordinates, as [`Self::write_with_image`]
    /// writes it.
    ///
    /// # Errors
    /// Returns the error of reading the image.
    pub fn mesh_file<'a>(&self, image: impl Into<ImageSource<'a, D>>) -> Result<AnyMesh>
    where
        MeshFile<M>: Into<AnyMesh>,
        MeshFile<PolyMesh<D>>: Into<AnyMesh>,
    {
        let image = image.into();
        Ok(match &self.mesh {
            MeshResult::Simplices(annotated) => self.simplex_file(annotated, Some(image))?.into(),
            MeshResult::Voronoi { mesh, weld } => {
                let file = with_image(cell_mesh_file(self, mesh, *weld), image)?;
                self.with_kept_cells(file)?.into()
            }
        })
    }

    /// Writes the mesh with all its data in world coordinates as a VTU file. The file is written
    /// completely or not at all. If `path` ends in `.pvtu`, the tetrahedra or triangles are written
    /// as one part.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file cannot be written, and [`Error::Job`] for distributed
    /// Voronoi cells.
    pub fn write(&self, path: &Path) -> Result<()> {
        self.write_file(path, None, &SelfComm)
    }

    /// Writes the mesh as [`write`](Self::write) does, and the image's value at each node and at
    /// each cell's centroid as arrays `image`.
    ///
    /// # Errors
    /// Returns the errors of [`write`](Self::write) and of reading the image.
    pub fn write_with_image(&self, path: &Path, image: ImageSource<'_, D>) -> Result<()> {
        self.write_file(path, Some(image), &SelfComm)
    }

    /// Writes the mesh as [`write_with_image`](Self::write_with_image) does, if several ranks made
    /// it. If `path` ends in `.pvtu`, each rank writes its part of the tetrahedra or triangles; a
    /// distributed mesh can be written only so.
    ///
    /// # Errors
    /// Returns the errors of [`write_with_image`](Self::write_with_image).
    pub(crate) fn write_distributed(
        &self,
        path: &Path,
        image: ImageSource<'_, D>,
        comm: &dyn Comm,
    ) -> Result<()> {
        self.write_file(path, Some(image), comm)
    }

    /// Returns tetrahedra or triangles in world coordinates, with those beyond the image if there are any,
    /// and with the image's values if it is given.
    pub(crate) fn simplex_file(
        &self,
        annotated: &AnnotatedMesh<M>,
        image: Option<ImageSource<'_, D>>,
    ) -> Result<MeshFile<M>> {
        let file = with_optional_image(simplex_mesh_file(self, annotated), image)?;
        let file = self.with_kept_cells(file)?;
        Ok(match &self.padding {
            Some(padding) => {
                with_padding(file, &annotated.mesh, padding, &self.geometry, self.step)
            }
            None => file,
        })
    }

    fn write_file(
        &self,
        path: &Path,
        image: Option<ImageSource<'_, D>>,
        comm: &dyn Comm,
    ) -> Result<()> {
        let in_parts = is_pvtu(path);
        match &self.mesh {
            MeshResult::Simplices(annotated) if in_parts => {
                let (part, count) = (comm.rank(), comm.size());
                let file = match &self.share {
                    Some(share) => {
                        let file =
                            with_global_nodes(simplex_mesh_file(self, annotated), &share.nodes);
                        with_optional_image(file, image)?
                    }
                    None => extract_partition(self.simplex_file(annotated, image)?, part, count),
                };
                write_partition(path, &file, part, count)
            }
            MeshResult::Simplices(annotated) => {
                write_vtu(path, &self.simplex_file(annotated, image)?)
            }
            MeshResult::Voronoi { .. } if in_parts => Err(no_partitions_error(path)),
            MeshResult::Voronoi { mesh, weld } => {
                let file = cell_mesh_file(self, mesh, *weld);
                let file = self.with_kept_cells(with_optional_image(file, image)?)?;
                write_cells_vtu(path, &file)
            }
        }
    }

    /// Returns the size of the box around the cells, along the axes of the image; `None` for a bare array,
    /// whose samples lie nowhere.
    pub(crate) fn body_size(&self) -> Option<BodySize> {
        let geometry = &self.geometry;
        if *geometry == Geometry::default() {
            return None;
        }
        let mut lengths = self.extent;
        if let Some(cells) = &self.kept_cells {
            let nodes = match &self.mesh {
                MeshResult::Simplices(annotated) => {
                    annotated.mesh.with_cells(cells).0.nodes().to_vec()
                }
                MeshResult::Voronoi { mesh, .. } => mesh.with_cells(cells).0.nodes,
            };
            let [low, high] = bounding_box(nodes);
            lengths = sub(high, low);
        }
        let spacing = geometry.spacing();
        // Units are those of coordinates, and axes may be turned.
        let units = geometry.axes.map(|axis| {
            let longest = (0..D).max_by(|&a, &b| axis[a].abs().total_cmp(&axis[b].abs()));
            geometry.units[longest.unwrap_or(0)].clone()
        });
        Some(BodySize {
            lengths: (0..D)
                .map(|k| lengths[k] / self.step[k] * spacing[k])
                .collect(),
            units: units.to_vec(),
        })
    }

    /// Returns the quality of tetrahedra or triangles in world coordinates, if it differs from that
    /// in lattice space. If the mesh is distributed, all ranks must call this.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub(crate) fn quality_in_world(&self, comm: &dyn Comm) -> Result<Option<Quality>> {
        let Some(annotated) = self.simplices() else {
            return Ok(None);
        };
        let Some(geometry) = geometry_of_other_shapes(&self.geometry, self.step) else {
            return Ok(None);
        };
        let mut mesh = to_physical(&annotated.mesh, self.step, &geometry);
        if let Some(cells) = &self.kept_cells {
            mesh = mesh.with_cells(cells).0;
        }
        Ok(Some(match &self.share {
            None => quality(&mesh),
            Some(share) => quality_of_partition(
                &MeshView::from_cells(&mesh, share.first_cell, share.global_counts, comm),
                &CancelToken::never(),
            )?,
        }))
    }

    /// Writes the acute lines of tetrahedra or triangles in world coordinates, as [`write_lines`]
    /// does. Voronoi cells have none.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn write_lines(&self, path: &Path) -> Result<()> {
        let no_lines = Vec::new();
        let (lines, nodes) = match self.simplices() {
            Some(annotated) => (
                &annotated.angle_assessment.angles.acute_lines,
                annotated.mesh.nodes(),
            ),
            None => (&no_lines, &[][..]),
        };
        write_lines(path, lines, |n| {
            let x = nodes[n as usize];
            let index = std::array::from_fn(|k| x[k] / self.step[k]);
            self.geometry.to_physical(index)
        })
    }
}

/// Returns the geometry in which angles are those of physical space, if they have a meaning there and
/// differ from those in a lattice space in which samples are `step` apart.
pub(crate) fn geometry_of_other_shapes<const D: usize>(
    geometry: &Geometry<D>,
    step: [f64; D],
) -> Option<Geometry<D>> {
    let geometry = geometry.in_one_unit().ok()?;
    (!geometry.preserves_shapes(step)).then_some(geometry)
}

/// Returns the array with the smallest angle of each cell in physical space, if this differs from lattice
/// space and angles have a meaning there. `mesh` is in physical coordinates.
pub(crate) fn physical_angles<const D: usize, M: Simplices<D>>(
    mesh: &M,
    geometry: &Geometry<D>,
    step: [f64; D],
) -> Option<DataArray> {
    geometry_of_other_shapes(geometry, step)?;
    let mesh = scaled_mesh(mesh, geometry.length_scales().ok()?);
    let angles = smallest_angles(&*mesh);
    Some(DataArray::scalars(M::PHYSICAL_ANGLE_ARRAY, angles))
}

/// Returns the error for Voronoi cells, which cannot be written in parts.
pub(crate) fn no_partitions_error(path: &Path) -> Error {
    let problem = "is for tetrahedra and triangles: Voronoi cells are not written in parts";
    Error::Job(cause(
        path.display(),
        problem,
        "give a name that ends in .vtu",
    ))
}

/// Adds the image's values as [`with_image`] does, if there is an image.
fn with_optional_image<const D: usize, M: Mesh<D>>(
    file: MeshFile<M>,
    image: Option<ImageSource<'_, D>>,
) -> Result<MeshFile<M>> {
    match image {
        Some(image) => with_image(file, image),
        None => Ok(file),
    }
}

/// Adds the share of each cell that holds data, unless all cells are full of data. The samples of the
/// image must be marked already. A mesh that has the array gets new values.
///
/// # Errors
/// Returns an [`Error::Job`] if there is not enough memory.
pub fn with_live<const D: usize, M: Mesh<D>>(
    mut file: MeshFile<M>,
    image: &Image<D>,
) -> Result<MeshFile<M>> {
    file.cell_data.retain(|array| array.name != LIVE_ARRAY);
    let Some(live) = LiveVolume::new(image)? else {
        return Ok(file);
    };
    let space = LatticeSpace::from_file(&file, file.mesh.nodes()).filter(|space| space.is_stored);
    let geometry = space.map_or_else(|| image.geometry.clone(), |space| space.geometry);
    let shares = shares_of_cells(&file.mesh, &live, |x| {
        geometry.to_index(x).unwrap_or([f64::NAN; D])
    });
    if shares.iter().any(|share| *share < 1.0) {
        file.cell_data.push(DataArray::scalars(LIVE_ARRAY, shares));
    }
    Ok(file)
}

/// Adds the image's value at each node and at each cell's centroid, interpolated linearly, as
/// arrays `image`.
///
/// # Errors
/// Returns the error of reading the image.
pub fn with_image<const D: usize, M: Mesh<D>>(
    mut file: MeshFile<M>,
    image: ImageSource<'_, D>,
) -> Result<MeshFile<M>> {
    let space = LatticeSpace::from_file(&file, file.mesh.nodes()).filter(|space| space.is_stored);
    // A mesh that covers voxels begins half a sample before its image.
    let space = space.filter(|space| !space.covers_voxels_of(image.dims()));
    let geometry = space.map_or_else(|| image.geometry().clone(), |space| space.geometry);
    let (nodes, centre) = (file.mesh.nodes(), file.mesh.centres());
    let node_values = image.interpolate_linear(nodes.len(), |n| geometry.to_index(nodes[n]))?;
    let cell_values =
        image.interpolate_linear(file.mesh.len(), |c| geometry.to_index(centre(c)))?;
    drop(centre);
    let arrays = &mut file.point_data;
    arrays.push(DataArray::scalars(IMAGE_ARRAY, node_values));
    let arrays = &mut file.cell_data;
    arrays.push(DataArray::scalars(IMAGE_ARRAY, cell_values));
    Ok(file)
}

/// Returns the field with the options that feature detection used, so that a part of the mesh can
/// be rebuilt in the same way.
pub fn resolved_options_field(options: &[ResolvedOptions]) -> Option<(String, FieldValue)> {
    let text = serde_json::to_string(options).ok()?;
    Some((FEATURES_FIELD.into(), FieldValue::Text(text)))
}

/// Reads the options that feature detection used from a file; `None` if it does not have them.
pub fn resolved_options<M>(file: &MeshFile<M>) -> Option<Vec<ResolvedOptions>> {
    let mut fields = file.field_data.iter();
    fields.find_map(|(name, value)| match value {
        FieldValue::Text(text) if name == FEATURES_FIELD => serde_json::from_str(text.trim()).ok(),
        _ => None,
    })
}

/// Returns the field that stores the labels of an image.
fn labels_field<const D: usize>(label_map: &LabelMap<D>) -> Option<(String, FieldValue)> {
    let regions: Vec<LabelledRegion> = (label_map.labels.iter().zip(&label_map.names))
        .zip(label_map.regions())
        .map(|((&label, name), region)| LabelledRegion {
            region,
            label,
            name: name.clone(),
        })
        .collect();
    regions_field(&regions)
}
