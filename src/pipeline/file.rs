//! A mesh as a file: physical coordinates, what each node and cell is, and the way back to lattice
//! space.

use rayon::prelude::*;

use super::{Meshing, Outcome, Space};
use crate::error::cause;
use crate::export::{FieldValue, MeshFile, face_bits_to_physical, to_physical, turned};
use crate::image::Geometry;
use crate::io::vtk::{DataArray, Values};
use crate::mesh::TetMesh;
use crate::report::Measured;
use crate::{Error, Result};

/// What a result can be made again from.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Provenance {
    /// All parameters, as the configuration file has them.
    pub parameters: String,
    /// SHA-256 of the input.
    pub input_sha256: String,
}

/// The outcome of a job where the image lies in the world, with all that is known of each node and
/// cell.
pub fn to_file<const D: usize, M: Measured<D>>(
    outcome: &Outcome<D>,
    geometry: &Geometry<D>,
    provenance: &Provenance,
) -> MeshFile<M>
where
    Space<D>: Meshing<D, Mesh = M>,
{
    let lattice = &outcome.mesh;
    let nodes = lattice.nodes();
    let mesh = to_physical(lattice, outcome.step, geometry);
    let kinds: Vec<u8> = outcome.kinds.iter().map(|&kind| kind as u8).collect();
    let potential = &outcome.features.potential;
    let feature: Vec<f32> = nodes
        .par_iter()
        .map(|&x| potential.value(x) as f32)
        .collect();
    let distance: Vec<f32> = nodes
        .par_iter()
        .map(|&x| outcome.distance.at(x) as f32)
        .collect();
    let cells = || (0..lattice.len()).into_par_iter();
    let smallest: Vec<f32> = cells().map(|c| lattice.smallest_angle(c) as f32).collect();
    let volume: Vec<f32> = cells().map(|c| mesh.volume(c) as f32).collect();
    let text = |text: &str| FieldValue::Text(text.to_string());
    MeshFile {
        mesh,
        point_data: vec![
            DataArray::scalars("atom_kind", kinds),
            DataArray::scalars("feature", feature),
            DataArray::scalars("distance", distance),
        ],
        cell_data: vec![
            DataArray::scalars("region", vec![0i32; lattice.len()]),
            DataArray::scalars(M::MIN_ANGLE, smallest),
            DataArray::scalars(M::VOLUME, volume),
            DataArray::scalars(
                M::FEATURE_FACES,
                face_bits_to_physical(&outcome.feature_faces, geometry),
            ),
        ],
        field_data: vec![
            ("atomesh_version".into(), text(env!("CARGO_PKG_VERSION"))),
            ("parameters".into(), text(&provenance.parameters)),
            ("input_sha256".into(), text(&provenance.input_sha256)),
            ("origin".into(), FieldValue::F64s(geometry.origin.to_vec())),
            ("axes".into(), FieldValue::F64s(geometry.axes.concat())),
            (
                "lattice_step".into(),
                FieldValue::F64s(outcome.step.to_vec()),
            ),
            (
                "lattice_extent".into(),
                FieldValue::F64s(outcome.extent.to_vec()),
            ),
        ],
    }
}

/// A mesh read from a file, in lattice space and in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed<const D: usize = 3, M = TetMesh> {
    /// In lattice space, in the box `[0, extent]`.
    pub lattice: M,
    /// As in the file.
    pub physical: M,
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis of lattice space.
    pub step: [f64; D],
    /// From samples to physical coordinates.
    pub geometry: Geometry<D>,
    /// For each cell, bit k: face k of `lattice` lies on a feature, the mesh says.
    pub feature_faces: Option<Vec<u8>>,
    /// Whether the file says where its lattice space is. If not, it is the file's own space, moved
    /// so that the mesh begins at the origin.
    pub by_file: bool,
}

impl<const D: usize, M: Measured<D>> Placed<D, M> {
    /// Finds the way back from a file's coordinates; `place` names the file in errors.
    ///
    /// # Errors
    /// [`Error::Mesh`] for a mesh without cells, or one whose geometry makes no sense.
    pub fn new(file: MeshFile<M>, place: &str) -> Result<Self> {
        let refuse = |problem: &str| {
            Err(Error::Mesh(cause(
                place,
                problem,
                "give a mesh that atomesh mesh wrote",
            )))
        };
        let nodes = file.mesh.nodes();
        if file.mesh.is_empty() || nodes.is_empty() {
            return refuse(&format!("holds no {}", M::CELLS));
        }
        let array = |name: &str| {
            let mut arrays = file.field_data.iter();
            arrays.find_map(|(known, value)| match value {
                FieldValue::F64s(values) if known == name => Some(values.as_slice()),
                _ => None,
            })
        };
        let vector = |name: &str| <[f64; D]>::try_from(array(name)?).ok();
        let axes = array("axes").filter(|axes| axes.len() == D * D);
        let axes =
            axes.map(|axes| std::array::from_fn(|k| std::array::from_fn(|c| axes[D * k + c])));
        let known =
            ["origin", "axes", "lattice_step", "lattice_extent"].map(|name| array(name).is_some());
        let stored = (
            vector("origin"),
            axes,
            vector("lattice_step"),
            vector("lattice_extent"),
        );
        let (geometry, step, extent, by_file) = match stored {
            (Some(origin), Some(axes), Some(step), Some(extent)) => {
                let geometry = Geometry {
                    origin,
                    axes,
                    ..Geometry::default()
                };
                (geometry, step, extent, true)
            }
            _ if known == [false; 4] => {
                let (low, high) = bounds(nodes);
                let geometry = Geometry::with_spacing(low, [1.0; D]);
                let extent = std::array::from_fn(|k| high[k] - low[k]);
                (geometry, [1.0; D], extent, false)
            }
            _ => return refuse("says only in part where it lies"),
        };
        let lattice_position = |&node: &[f64; D]| {
            let index = geometry.to_index(node)?;
            Some(std::array::from_fn(|k| index[k] * step[k]))
        };
        let Some(nodes) = nodes.par_iter().map(lattice_position).collect() else {
            return refuse("has axes that do not span space");
        };
        let feature_faces = file
            .cell_data
            .iter()
            .find(|array| array.name == M::FEATURE_FACES)
            .and_then(|array| match &array.values {
                Values::U8(bits) => Some(face_bits_to_physical(bits, &geometry)),
                _ => None,
            });
        Ok(Self {
            feature_faces,
            lattice: turned(&file.mesh, nodes, &geometry),
            physical: file.mesh,
            extent,
            step,
            geometry,
            by_file,
        })
    }
}

/// The smallest box that holds all points.
pub fn bounds<const D: usize>(points: &[[f64; D]]) -> ([f64; D], [f64; D]) {
    points.iter().fold(
        ([f64::INFINITY; D], [f64::NEG_INFINITY; D]),
        |(low, high), p| {
            (
                std::array::from_fn(|k| low[k].min(p[k])),
                std::array::from_fn(|k| high[k].max(p[k])),
            )
        },
    )
}
