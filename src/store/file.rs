//! A mesh as a file: physical coordinates, what each node and cell is, and the way back to lattice
//! space.

use std::path::Path;

use rayon::prelude::*;

use super::cells::cells_to_file;
use super::{write_cells_vtu, write_vtu};

use crate::error::cause;
use crate::feature::Settled;
use crate::files::vtk::{DataArray, Values};
use crate::image::Geometry;
pub use crate::job::Provenance;
use crate::job::horizons::horizon_bits;
use crate::job::{Made, Marked, Meshing, Outcome, Space};
use crate::mesh::TetMesh;
use crate::mesh::faceted::marks_of_bits;
use crate::mesh::poly::PolyMesh;
use crate::report::Measured;
use crate::store::{FieldValue, MeshFile, face_bits_to_physical, to_physical, turned};
use crate::{Error, Result};

/// The outcome of a job where the image lies in the world, with all that is known of each node and
/// cell.
pub fn to_file<const D: usize, M: Measured<D>>(
    outcome: &Outcome<D>,
    made: &Marked<M>,
) -> MeshFile<M>
where
    Space<D>: Meshing<D, Mesh = M>,
{
    let geometry = &outcome.geometry;
    let lattice = &made.mesh;
    let nodes = lattice.nodes();
    let mesh = to_physical(lattice, outcome.step, geometry);
    let kinds: Vec<u8> = made.kinds.iter().map(|&kind| kind as u8).collect();
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
    let smallest = lattice.smallest_angles();
    let volume: Vec<f32> = cells().map(|c| mesh.volume(c) as f32).collect();
    let horizons = horizon_bits(lattice, &made.feature_faces, &outcome.features);
    let mut file = MeshFile {
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
                face_bits_to_physical(&made.feature_faces, geometry),
            ),
        ],
        field_data: {
            let mut fields =
                common_fields(geometry, outcome.step, outcome.extent, &outcome.provenance);
            fields.extend(settled_field(&outcome.features.settled));
            fields
        },
    };
    if !horizons.is_empty() {
        let bits = face_bits_to_physical(&horizons, geometry);
        file.cell_data.push(DataArray::scalars(HORIZON_FACES, bits));
    }
    file
}

impl<const D: usize> Outcome<D>
where
    Space<D>: Meshing<D>,
{
    /// Writes the mesh with all that is known of it, where the image lies in the world, as a VTU file:
    /// wholly or not at all.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        match &self.made {
            Made::Simplices(made) => write_vtu(path, &to_file(self, made)),
            Made::Voronoi { mesh, weld } => {
                write_cells_vtu(path, &cells_to_file(self, mesh, *weld))
            }
        }
    }
}

/// The array that says which faces on features lie on horizons, which are no barriers to flow: bits
/// of cells as in `feature_faces`, or for polyhedra and polygons pairs of cells.
pub(crate) const HORIZON_FACES: &str = "horizon_faces";
/// Field data of welded Voronoi cells: the share of their size within which nodes are one.
pub(crate) const WELD: &str = "weld";
/// The field of units of the coordinates, commas between them.
const UNITS: &str = "units";
/// The name under which a file keeps what feature detection settled on.
const SETTLED: &str = "features";

/// What feature detection settled on, so that a part of the mesh can be made again alike.
pub fn settled_field(settled: &[Settled]) -> Option<(String, FieldValue)> {
    let text = serde_json::to_string(settled).ok()?;
    Some((SETTLED.into(), FieldValue::Text(text)))
}

/// The same, of a file; `None` if it does not say.
pub fn settled_of<M>(file: &MeshFile<M>) -> Option<Vec<Settled>> {
    let mut fields = file.field_data.iter();
    fields.find_map(|(name, value)| match value {
        FieldValue::Text(text) if name == SETTLED => serde_json::from_str(text.trim()).ok(),
        _ => None,
    })
}

/// What every file says of itself: what made it, and where its lattice space is.
pub(crate) fn common_fields<const D: usize>(
    geometry: &Geometry<D>,
    step: [f64; D],
    extent: [f64; D],
    provenance: &Provenance,
) -> Vec<(String, FieldValue)> {
    let text = |text: &str| FieldValue::Text(text.to_string());
    vec![
        (UNITS.into(), text(&geometry.units.join(","))),
        ("atomesh_version".into(), text(env!("CARGO_PKG_VERSION"))),
        ("parameters".into(), text(&provenance.parameters)),
        ("input_sha256".into(), text(&provenance.input_sha256)),
        ("origin".into(), FieldValue::F64s(geometry.origin.to_vec())),
        ("axes".into(), FieldValue::F64s(geometry.axes.concat())),
        ("lattice_step".into(), FieldValue::F64s(step.to_vec())),
        ("lattice_extent".into(), FieldValue::F64s(extent.to_vec())),
    ]
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
    /// For each number of a face of `lattice`, and of `physical` for polyhedra and polygons, whether
    /// it lies on a horizon; empty if none does.
    pub horizons: Vec<bool>,
    /// Share of the cells' size within which nodes of Voronoi cells are welded, the file says.
    pub weld: f64,
    /// Whether the file says where its lattice space is. If not, it is the file's own space, moved
    /// so that the mesh begins at the origin.
    pub by_file: bool,
}

/// Where a file's lattice space is: the geometry, the step, the extent, and whether the file says so.
type Place<const D: usize> = (Geometry<D>, [f64; D], [f64; D], bool);

/// Finds it; `None` if the file says it only in part.
fn place<const D: usize, M>(file: &MeshFile<M>, nodes: &[[f64; D]]) -> Option<Place<D>> {
    let array = |name: &str| {
        let mut arrays = file.field_data.iter();
        arrays.find_map(|(known, value)| match value {
            FieldValue::F64s(values) if known == name => Some(values.as_slice()),
            _ => None,
        })
    };
    let vector = |name: &str| <[f64; D]>::try_from(array(name)?).ok();
    let known =
        ["origin", "axes", "lattice_step", "lattice_extent"].map(|name| array(name).is_some());
    if known == [false; 4] {
        let (low, high) = bounds(nodes);
        let extent = std::array::from_fn(|k| high[k] - low[k]);
        return Some((
            Geometry::with_spacing(low, [1.0; D]),
            [1.0; D],
            extent,
            false,
        ));
    }
    let axes = array("axes").filter(|axes| axes.len() == D * D)?;
    let text = |name: &str| {
        let mut fields = file.field_data.iter();
        fields.find_map(|(known, value)| match value {
            FieldValue::Text(text) if known == name => Some(text.as_str()),
            _ => None,
        })
    };
    let mut units = text(UNITS).unwrap_or_default().split(',');
    let geometry = Geometry {
        origin: vector("origin")?,
        axes: std::array::from_fn(|k| std::array::from_fn(|c| axes[D * k + c])),
        units: std::array::from_fn(|_| units.next().unwrap_or_default().to_string()),
        ..Geometry::default()
    };
    Some((
        geometry,
        vector("lattice_step")?,
        vector("lattice_extent")?,
        true,
    ))
}

/// Positions in lattice space; `None` if the axes do not span space.
fn to_lattice<const D: usize>(
    points: &[[f64; D]],
    geometry: &Geometry<D>,
    step: [f64; D],
) -> Option<Vec<[f64; D]>> {
    let lattice_position = |&point: &[f64; D]| {
        let index = geometry.to_index(point)?;
        Some(std::array::from_fn(|k| index[k] * step[k]))
    };
    points.par_iter().map(lattice_position).collect()
}

fn refuse<T>(place: &str, problem: &str) -> Result<T> {
    Err(Error::Mesh(cause(
        place,
        problem,
        "give a mesh that atomesh mesh wrote",
    )))
}

const IN_PART: &str = "says only in part where it lies";
const NO_SPACE: &str = "has axes that do not span space";

impl<const D: usize, M: Measured<D>> Placed<D, M> {
    /// Finds the way back from a file's coordinates; `place_name` names the file in errors.
    ///
    /// # Errors
    /// [`Error::Mesh`] for a mesh without cells, or one whose geometry makes no sense.
    pub fn new(file: MeshFile<M>, place_name: &str) -> Result<Self> {
        let nodes = file.mesh.nodes();
        if file.mesh.is_empty() || nodes.is_empty() {
            return refuse(place_name, &format!("holds no {}", M::CELLS));
        }
        let Some((geometry, step, extent, by_file)) = place(&file, nodes) else {
            return refuse(place_name, IN_PART);
        };
        let Some(nodes) = to_lattice(nodes, &geometry, step) else {
            return refuse(place_name, NO_SPACE);
        };
        let bits = |name: &str| {
            let array = file.cell_data.iter().find(|array| array.name == name);
            array.and_then(|array| match &array.values {
                Values::U8(bits) => Some(face_bits_to_physical(bits, &geometry)),
                _ => None,
            })
        };
        Ok(Self {
            feature_faces: bits(M::FEATURE_FACES),
            horizons: (bits(HORIZON_FACES).iter())
                .flat_map(|bits| marks_of_bits::<D>(bits))
                .collect(),
            lattice: turned(&file.mesh, nodes, &geometry),
            physical: file.mesh,
            extent,
            step,
            geometry,
            weld: 0.0,
            by_file,
        })
    }
}

impl<const D: usize, M> Placed<D, M> {
    /// Checks that an image of these dims fills the mesh's box; `place` names it in errors.
    ///
    /// # Errors
    /// [`Error::Image`] if it does not.
    pub fn check_dims(&self, dims: [usize; D], place: &str) -> Result<()> {
        let own: [f64; D] = std::array::from_fn(|k| self.extent[k] / self.step[k] + 1.0);
        if (0..D).any(|k| (dims[k] as f64 - own[k]).abs() > 1e-6) {
            return Err(Error::Image(cause(
                place,
                format!("is of {dims:?} samples, the mesh of {own:?}"),
                "give the image that was meshed, or one of its dims",
            )));
        }
        Ok(())
    }
}

impl<const D: usize> Placed<D, PolyMesh<D>> {
    /// The same for polyhedra or polygons. Their faces on the boundary are assigned to the sides of
    /// the box that they are nearest to.
    ///
    /// # Errors
    /// As [`Placed::new`].
    pub fn cells(file: MeshFile<PolyMesh<D>>, place_name: &str) -> Result<Self> {
        if file.mesh.sites.is_empty() {
            return refuse(place_name, "holds no cells");
        }
        let Some((geometry, step, extent, by_file)) = place(&file, &file.mesh.nodes) else {
            return refuse(place_name, IN_PART);
        };
        let nodes = to_lattice(&file.mesh.nodes, &geometry, step);
        let sites = to_lattice(&file.mesh.sites, &geometry, step);
        let (Some(nodes), Some(sites)) = (nodes, sites) else {
            return refuse(place_name, NO_SPACE);
        };
        let pairs = (file.field_data.iter()).find_map(|(name, value)| match value {
            FieldValue::Ints(pairs) if name == HORIZON_FACES => Some(pairs.as_chunks::<2>().0),
            _ => None,
        });
        let weld = (file.field_data.iter()).find_map(|(name, value)| match value {
            FieldValue::F64s(weld) if name == WELD => weld.first().copied(),
            _ => None,
        });
        let mut physical = file.mesh;
        let mut horizons = Vec::new();
        if let Some(pairs) = pairs {
            horizons.resize(physical.face_cells.len(), false);
            for pair in pairs {
                // Faces are in the order of their cells.
                let pair = pair.map(|cell| cell as u32);
                if let Ok(face) = physical.face_cells.binary_search(&pair) {
                    horizons[face] = true;
                }
            }
        }
        let mut lattice = physical.mapped(|x| x, geometry.determinant() < 0.0);
        (lattice.nodes, lattice.sites) = (nodes, sites);
        lattice.assign_sides([0.0; D], extent);
        physical.face_cells.clone_from(&lattice.face_cells);
        Ok(Self {
            lattice,
            physical,
            extent,
            step,
            geometry,
            feature_faces: None,
            horizons,
            weld: weld.unwrap_or(0.0),
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
