//! A mesh as a file: physical coordinates, what each node and cell is, and the way back to lattice
//! space.

use rayon::prelude::*;

use super::Outcome;
use crate::error::cause;
use crate::export::{FieldValue, MeshFile, face_bits_to_physical, to_physical};
use crate::image::Geometry;
use crate::io::vtk::{DataArray, Values};
use crate::mesh::quality::dihedral_angles;
use crate::mesh::{TetMesh, volume6};
use crate::{Error, Result};

/// The cell array that says which faces lie on features: bit k for the face opposite node k.
const FEATURE_FACES: &str = "feature_faces";

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
pub fn to_file(outcome: &Outcome, geometry: &Geometry<3>, provenance: &Provenance) -> MeshFile {
    let lattice = &outcome.mesh;
    let nodes = &lattice.nodes;
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
    let cells = 0..lattice.tets.len();
    let smallest = |t: usize| {
        let angles = dihedral_angles(&lattice.corners(t));
        angles.into_iter().fold(f64::INFINITY, f64::min) as f32
    };
    let min_dihedral: Vec<f32> = cells.clone().into_par_iter().map(smallest).collect();
    let volume: Vec<f64> = cells
        .clone()
        .into_par_iter()
        .map(|t| volume6(&mesh.corners(t)) / 6.0)
        .collect();
    let text = |text: &str| FieldValue::Text(text.to_string());
    MeshFile {
        mesh,
        point_data: vec![
            DataArray::scalars("atom_kind", kinds),
            DataArray::scalars("feature", feature),
            DataArray::scalars("distance", distance),
        ],
        cell_data: vec![
            DataArray::scalars("region", vec![0i32; lattice.tets.len()]),
            DataArray::scalars("min_dihedral", min_dihedral),
            DataArray::scalars("volume", volume),
            DataArray::scalars(
                FEATURE_FACES,
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
pub struct Placed {
    /// In lattice space, in the box `[0, extent]`.
    pub lattice: TetMesh,
    /// As in the file.
    pub physical: TetMesh,
    /// The far corner of the box.
    pub extent: [f64; 3],
    /// Length of one sample along each axis of lattice space.
    pub step: [f64; 3],
    /// From samples to physical coordinates.
    pub geometry: Geometry<3>,
    /// For each tetrahedron, bit k: face k of `lattice` lies on a feature, the mesh says.
    pub feature_faces: Option<Vec<u8>>,
    /// Whether the file says where its lattice space is. If not, it is the file's own space, moved
    /// so that the mesh begins at the origin.
    pub by_file: bool,
}

impl Placed {
    /// Finds the way back from a file's coordinates; `place` names the file in errors.
    ///
    /// # Errors
    /// [`Error::Mesh`] for a mesh without tetrahedra, or one whose geometry makes no sense.
    pub fn new(file: MeshFile, place: &str) -> Result<Self> {
        let refuse = |problem: &str| {
            Err(Error::Mesh(cause(
                place,
                problem,
                "give a mesh that atomesh mesh wrote",
            )))
        };
        if file.mesh.tets.is_empty() || file.mesh.nodes.is_empty() {
            return refuse("holds no tetrahedra");
        }
        let array = |name: &str| {
            file.field_data
                .iter()
                .find_map(|(known, value)| match value {
                    FieldValue::F64s(values) if known == name => Some(values.as_slice()),
                    _ => None,
                })
        };
        let (geometry, step, extent, by_file) = match (
            array("origin"),
            array("axes"),
            array("lattice_step"),
            array("lattice_extent"),
        ) {
            (
                Some(&[x, y, z]),
                Some(&[a, b, c, d, e, f, g, h, i]),
                Some(&[s, t, u]),
                Some(&[l, m, n]),
            ) => {
                let axes = [[a, b, c], [d, e, f], [g, h, i]];
                let geometry = Geometry {
                    origin: [x, y, z],
                    axes,
                    ..Geometry::default()
                };
                (geometry, [s, t, u], [l, m, n], true)
            }
            (None, None, None, None) => {
                let (low, high) = bounds(&file.mesh.nodes);
                let geometry = Geometry::with_spacing(low, [1.0; 3]);
                let extent = std::array::from_fn(|k| high[k] - low[k]);
                (geometry, [1.0; 3], extent, false)
            }
            _ => return refuse("says only in part where it lies"),
        };
        let mirrored = geometry.determinant() < 0.0;
        let lattice_position = |&node: &[f64; 3]| {
            let index = geometry.to_index(node)?;
            Some(std::array::from_fn(|k| index[k] * step[k]))
        };
        let Some(nodes) = file.mesh.nodes.par_iter().map(lattice_position).collect() else {
            return refuse("has axes that do not span space");
        };
        let turn = |t: &[u32; 4]| {
            if mirrored {
                [t[0], t[1], t[3], t[2]]
            } else {
                *t
            }
        };
        let tets = file.mesh.tets.iter().map(turn).collect();
        let feature_faces = file
            .cell_data
            .iter()
            .find(|array| array.name == FEATURE_FACES)
            .and_then(|array| match &array.values {
                Values::U8(bits) => Some(face_bits_to_physical(bits, &geometry)),
                _ => None,
            });
        Ok(Self {
            feature_faces,
            lattice: TetMesh { nodes, tets },
            physical: file.mesh,
            extent,
            step,
            geometry,
            by_file,
        })
    }

    /// Checks that an image of these dims fills the mesh's box; `place` names it in errors.
    ///
    /// # Errors
    /// [`Error::Image`] if it does not.
    pub fn check_dims(&self, dims: [usize; 3], place: &str) -> Result<()> {
        let own: [f64; 3] = std::array::from_fn(|k| self.extent[k] / self.step[k] + 1.0);
        if (0..3).any(|k| (dims[k] as f64 - own[k]).abs() > 1e-6) {
            return Err(Error::Image(cause(
                place,
                format!("is of {dims:?} samples, the mesh of {own:?}"),
                "give the image that was meshed, or one of its dims",
            )));
        }
        Ok(())
    }
}

/// The smallest box that holds all points.
pub fn bounds(points: &[[f64; 3]]) -> ([f64; 3], [f64; 3]) {
    points.iter().fold(
        ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]),
        |(low, high), p| {
            (
                std::array::from_fn(|k| low[k].min(p[k])),
                std::array::from_fn(|k| high[k].max(p[k])),
            )
        },
    )
}
