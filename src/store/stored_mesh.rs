//! Meshes that files hold, whatever their cells are, and the way back to lattice space.

use std::path::Path;

use super::depth::velocity_file;
use super::labels::remove_labels;
use super::named_surfaces::NamedSurfaces;
use super::output::{HORIZON_FACES_ARRAY, UNITS_FIELD, WELD_FIELD};
use super::{FieldValue, MeshFile, face_bits_to_physical, write_cells_vtu, write_vtu};
use crate::error::cause;
use crate::files::vtk::{DataArray, Values};
use crate::image::Geometry;
use crate::job::BOX_TOLERANCE;
use crate::mesh::check;
use crate::mesh::interface::marks_from_bits;
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Mesh, Positions, Simplices, TetMesh};
use crate::{Error, Result};

/// The cell array of regions.
const REGION_ARRAY: &str = "region";

/// A mesh read from a file, in lattice space; where the file has it is kept as positions only.
///
/// ```
/// use atomesh::image::{Geometry, Image};
/// use atomesh::job::{self, Params, Spacing};
/// use atomesh::observer::Unobserved;
/// use atomesh::store::{AnyMesh, StoredMesh, read_any_vtu};
///
/// // A disc, on samples 25 m apart.
/// let from_centre = |i: usize| ((i % 40) as f64 - 20.0).hypot((i / 40) as f64 - 18.0);
/// let disc = (0..40 * 36).map(|i| f32::from(from_centre(i) < 11.0));
/// let geometry = Geometry { axes: [[25.0, 0.0], [0.0, 25.0]], ..Geometry::default() };
/// let image = Image::new([40, 36], disc.collect(), geometry);
/// let params = Params { spacing: Spacing::Constant(5.0), ..Params::default() };
/// let path = std::env::temp_dir().join("atomesh-stored-mesh.vtu");
/// job::run(&image, &params, &mut Unobserved)?.write(&path)?;
///
/// let AnyMesh::Plane(file) = read_any_vtu(&path)? else { unreachable!("an image of the plane") };
/// let stored = StoredMesh::new(file, "the disc")?;
/// assert_eq!(stored.space.extent, [39.0, 35.0]);
/// assert_eq!(stored.space.to_world([39.0, 35.0]), [975.0, 875.0]);
/// assert!(stored.marks().is_some_and(|marks| marks.contains(&true)));
/// # std::fs::remove_file(&path).ok();
/// # Ok::<(), atomesh::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct StoredMesh<const D: usize = 3, M = TetMesh> {
    /// In lattice space, in the box `[0, extent]`.
    pub lattice: M,
    /// Its positions in the file.
    pub world: Positions<D>,
    /// Where lattice space is.
    pub space: LatticeSpace<D>,
    /// For each simplex, bit k: face k of `lattice` lies on a feature, the file says.
    pub feature_faces: Option<Vec<u8>>,
    /// For each number of a face of `lattice` whether it lies on a horizon; empty if none does.
    pub is_horizon_face: Vec<bool>,
    /// Share of the cells' size within which nodes of Voronoi cells are welded, the file says.
    pub weld: f64,
    /// Surfaces that have names in the file.
    pub named_surfaces: NamedSurfaces,
    /// What else the file holds.
    pub arrays: MeshFile<()>,
}

/// Where the lattice space of a mesh is.
#[derive(Debug, Clone, PartialEq)]
pub struct LatticeSpace<const D: usize> {
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis of lattice space.
    pub step: [f64; D],
    /// From samples to physical coordinates.
    pub geometry: Geometry<D>,
    /// Whether the file says it. If not, lattice space is the file's own, moved so that the mesh begins
    /// at the origin.
    pub is_stored: bool,
    /// The file of velocities by which the mesh lies in depth, if it does by one: the image that was meshed
    /// is not the one in its file then.
    pub velocities: Option<String>,
}

/// How a file holds a mesh of some kind of cells.
pub trait Storable<const D: usize>: Mesh<D> {
    /// For each simplex the bits of its faces on features; `mirrored` says that cells will be turned
    /// round. `None` if the file does not say, and for polyhedra and polygons, which know it.
    fn feature_faces(file: &MeshFile<Self>, mirrored: bool) -> Option<Vec<u8>>;

    /// For each number of a face whether it lies on a horizon, likewise; empty if none does.
    fn horizons(file: &MeshFile<Self>, mirrored: bool) -> Vec<bool>;

    /// Which faces of a mesh in lattice space lie on features, by number, from what the file says of
    /// them; `None` if it does not.
    fn feature_marks(&self, feature_faces: Option<&[u8]>) -> Option<Vec<bool>>;

    /// Finds the sides of the box, `[0, extent]`, on which faces lie, if they know them.
    fn find_sides(&mut self, extent: [f64; D]);

    /// The region of each cell; `None` if the file does not say.
    fn regions(&self, arrays: &MeshFile<()>) -> Option<Vec<i32>>;

    /// Says which region each cell belongs to.
    fn set_regions(file: &mut MeshFile<Self>, regions: Vec<i32>);

    /// Writes a file.
    ///
    /// # Errors
    /// As [`write_vtu`].
    fn write(path: &Path, file: &MeshFile<Self>) -> Result<()>;
}

impl<const D: usize, M: Simplices<D>> Storable<D> for M {
    fn feature_faces(file: &MeshFile<Self>, mirrored: bool) -> Option<Vec<u8>> {
        bits::<D, M>(file, M::FEATURE_FACES_ARRAY, mirrored)
    }

    fn horizons(file: &MeshFile<Self>, mirrored: bool) -> Vec<bool> {
        let bits = bits::<D, M>(file, HORIZON_FACES_ARRAY, mirrored);
        marks_from_bits::<D>(&bits.unwrap_or_default()).collect()
    }

    fn feature_marks(&self, feature_faces: Option<&[u8]>) -> Option<Vec<bool>> {
        Some(marks_from_bits::<D>(feature_faces?).collect())
    }

    fn find_sides(&mut self, _: [f64; D]) {}

    fn regions(&self, arrays: &MeshFile<()>) -> Option<Vec<i32>> {
        let regions = arrays.cell_array(REGION_ARRAY)?.values.to_i64();
        Some(regions.into_iter().map(|r| r as i32).collect())
    }

    fn set_regions(file: &mut MeshFile<Self>, regions: Vec<i32>) {
        remove_labels(file);
        let array = DataArray::scalars(REGION_ARRAY, regions);
        match file.cell_data.iter_mut().find(|a| a.name == array.name) {
            Some(old) => *old = array,
            None => file.cell_data.push(array),
        }
    }

    fn write(path: &Path, file: &MeshFile<Self>) -> Result<()> {
        write_vtu(path, file)
    }
}

/// Bits for the faces of simplices that a file holds.
fn bits<const D: usize, M>(file: &MeshFile<M>, name: &str, mirrored: bool) -> Option<Vec<u8>> {
    match &file.cell_array(name)?.values {
        Values::U8(bits) => Some(face_bits_to_physical::<D>(bits, mirrored)),
        _ => None,
    }
}

impl<const D: usize> Storable<D> for PolyMesh<D> {
    fn feature_faces(_: &MeshFile<Self>, _: bool) -> Option<Vec<u8>> {
        None
    }

    fn horizons(file: &MeshFile<Self>, _: bool) -> Vec<bool> {
        let Some(FieldValue::Ints(pairs)) = file.field_value(HORIZON_FACES_ARRAY) else {
            return Vec::new();
        };
        // In the order of their cells; then come the faces on sides.
        let face_cells = &file.mesh.face_cells[..file.mesh.inner_face_count()];
        let mut horizons = vec![false; file.mesh.face_cells.len()];
        for pair in pairs.as_chunks::<2>().0 {
            if let Ok(face) = face_cells.binary_search(&pair.map(|cell| cell as u32)) {
                horizons[face] = true;
            }
        }
        horizons
    }

    fn feature_marks(&self, _: Option<&[u8]>) -> Option<Vec<bool>> {
        Some(self.on_feature.clone())
    }

    fn find_sides(&mut self, extent: [f64; D]) {
        self.assign_sides([0.0; D], extent);
    }

    fn regions(&self, _: &MeshFile<()>) -> Option<Vec<i32>> {
        Some(self.region.clone())
    }

    fn set_regions(file: &mut MeshFile<Self>, regions: Vec<i32>) {
        remove_labels(file);
        file.mesh.region = regions;
    }

    fn write(path: &Path, file: &MeshFile<Self>) -> Result<()> {
        write_cells_vtu(path, file)
    }
}

impl<const D: usize> LatticeSpace<D> {
    /// Of a mesh with these nodes; `None` if the file says it only in part.
    pub(super) fn from_file<M>(file: &MeshFile<M>, nodes: &[[f64; D]]) -> Option<Self> {
        let array = |name: &str| match file.field_value(name) {
            Some(FieldValue::F64s(values)) => Some(values.as_slice()),
            _ => None,
        };
        let vector = |name: &str| <[f64; D]>::try_from(array(name)?).ok();
        let known =
            ["origin", "axes", "lattice_step", "lattice_extent"].map(|name| array(name).is_some());
        if known == [false; 4] {
            let (low, high) = bounding_box(nodes);
            return Some(Self {
                extent: std::array::from_fn(|k| high[k] - low[k]),
                step: [1.0; D],
                geometry: Geometry::with_spacing(low, [1.0; D]),
                is_stored: false,
                velocities: velocity_file(file),
            });
        }
        let axes = array("axes").filter(|axes| axes.len() == D * D)?;
        let mut units = match file.field_value(UNITS_FIELD) {
            Some(FieldValue::Text(text)) => text.as_str(),
            _ => "",
        }
        .split(',');
        Some(Self {
            extent: vector("lattice_extent")?,
            step: vector("lattice_step")?,
            geometry: Geometry {
                origin: vector("origin")?,
                axes: std::array::from_fn(|k| std::array::from_fn(|c| axes[D * k + c])),
                units: std::array::from_fn(|_| units.next().unwrap_or_default().to_string()),
                ..Geometry::default()
            },
            is_stored: true,
            velocities: velocity_file(file),
        })
    }

    /// A position of lattice space in the world.
    pub fn to_world(&self, x: [f64; D]) -> [f64; D] {
        let index = std::array::from_fn(|k| x[k] / self.step[k]);
        self.geometry.to_physical(index)
    }

    /// A position of the world in lattice space; `None` if the axes do not span space.
    pub fn to_lattice(&self, point: [f64; D]) -> Option<[f64; D]> {
        let index = self.geometry.to_index(point)?;
        Some(std::array::from_fn(|k| index[k] * self.step[k]))
    }

    /// How exactly the mesh fills its box, relative to it: as exactly as one is made, but no more than a
    /// file can say, whose coordinates may be large against the cells (metres of a national grid).
    pub fn tolerance(&self) -> f64 {
        let corner = |c: usize| -> [f64; D] {
            std::array::from_fn(|k| if c >> k & 1 == 1 { self.extent[k] } else { 0.0 })
        };
        let corners = (0..1 << D).flat_map(|c| self.to_world(corner(c)));
        let rounding = f64::EPSILON * corners.fold(0.0, |most, x| x.abs().max(most));
        let here = Geometry {
            origin: [0.0; D],
            ..self.geometry.clone()
        };
        let of_axis =
            |c: usize| here.to_index(std::array::from_fn(|k| f64::from(u8::from(k == c))));
        let columns: Option<Vec<[f64; D]>> = (0..D).map(of_axis).collect();
        let moved = |k: usize| -> f64 {
            let columns = columns.iter().flatten();
            columns.map(|column| column[k].abs()).sum::<f64>() * self.step[k] * rounding
        };
        let off: f64 = (0..D).map(|k| moved(k) / self.extent[k]).sum();
        (4.0 * off).clamp(BOX_TOLERANCE, 1e-3)
    }

    /// Number of samples along each axis of the image that was meshed, if it was one.
    pub fn dims(&self) -> [f64; D] {
        std::array::from_fn(|k| self.extent[k] / self.step[k] + 1.0)
    }

    /// Whether the world is a mirror image of it.
    pub fn is_mirrored(&self) -> bool {
        self.geometry.determinant() < 0.0
    }

    /// Whether an image of these dims fills the box.
    pub fn fits_dims(&self, dims: [usize; D]) -> bool {
        let own = self.dims();
        (0..D).all(|k| (dims[k] as f64 - own[k]).abs() <= 1e-6)
    }

    /// Checks that an image of these dims fills the box; `place` names it in errors.
    ///
    /// # Errors
    /// [`Error::Image`] if it does not.
    pub fn check_dims(&self, dims: [usize; D], place: &str) -> Result<()> {
        if self.fits_dims(dims) {
            return Ok(());
        }
        Err(Error::Image(cause(
            place,
            format!("is of {dims:?} samples, the mesh of {:?}", self.dims()),
            "give the image that was meshed, or one of the same dimensions",
        )))
    }
}

impl<const D: usize, M: Storable<D>> StoredMesh<D, M> {
    /// Finds the way back from a file's coordinates; `place` names the file in errors. Faces of
    /// polyhedra and polygons on the boundary are assigned to the sides of the box that they are
    /// nearest to.
    ///
    /// # Errors
    /// [`Error::Mesh`] for a mesh without cells, or one whose geometry makes no sense.
    pub fn new(file: MeshFile<M>, place: &str) -> Result<Self> {
        let refuse = |problem: &str| {
            let remedy = "give a mesh that atomesh mesh wrote";
            Err(Error::Mesh(cause(place, problem, remedy)))
        };
        if file.mesh.is_empty() || file.mesh.nodes().is_empty() {
            return refuse(&format!("holds no {}", M::CELLS_NAME));
        }
        let Some(space) = LatticeSpace::from_file(&file, file.mesh.nodes()) else {
            return refuse("records only part of its position");
        };
        let Some(mut positions) = file.mesh.mapped_positions(|&x| space.to_lattice(x)) else {
            return refuse("has linearly dependent axes");
        };
        let mirrored = space.is_mirrored();
        let weld = match file.field_value(WELD_FIELD) {
            Some(FieldValue::F64s(weld)) => weld.first().copied(),
            _ => None,
        };
        let feature_faces = M::feature_faces(&file, mirrored);
        let horizons = M::horizons(&file, mirrored);
        let named = NamedSurfaces::from_file(&file);
        let (mut lattice, arrays) = file.into_parts();
        lattice.swap_positions(&mut positions, mirrored);
        lattice.find_sides(space.extent);
        Ok(Self {
            lattice,
            world: positions,
            space,
            feature_faces,
            is_horizon_face: horizons,
            weld: weld.unwrap_or(0.0),
            named_surfaces: named,
            arrays,
        })
    }

    /// Refuses cells that overlap, and those that leave a hole in their box: a simulator would take it
    /// for a wall and say nothing. `place` names the file in errors.
    ///
    /// # Errors
    /// [`Error::Mesh`] for either. Cells without a positive volume are not looked for.
    pub fn check_filled(&self, place: &str) -> Result<()> {
        let share = check::filled_share(&self.lattice, self.space.extent);
        let problem = match share {
            Some(share) if share > 1.0 + VOLUME_TOLERANCE => {
                format!("some of its cells overlap: they fill {share:.4} times their box")
            }
            Some(share) if share < 1.0 - VOLUME_TOLERANCE => {
                format!(
                    "cells are missing: they fill {share:.4} of their box, and fluid would flow around the rest"
                )
            }
            _ => return Ok(()),
        };
        let remedy = "give a mesh that passes the checker: mesh the image again";
        Err(Error::Mesh(cause(place, problem, remedy)))
    }

    /// Which faces of `lattice` lie on features, by number; `None` if the file does not say.
    pub fn feature_marks(&self) -> Option<Vec<bool>> {
        self.lattice.feature_marks(self.feature_faces.as_deref())
    }

    /// The region of each cell; `None` if the file does not say.
    pub fn regions(&self) -> Option<Vec<i32>> {
        self.lattice.regions(&self.arrays)
    }

    /// What `look` finds in the mesh where the file has it. Faces of simplices have other numbers there
    /// if the world mirrors the lattice.
    pub fn with_world_mesh<T>(&mut self, look: impl FnOnce(&M) -> T) -> T {
        let mirrored = self.space.is_mirrored();
        self.lattice.swap_positions(&mut self.world, mirrored);
        let found = look(&self.lattice);
        self.lattice.swap_positions(&mut self.world, mirrored);
        found
    }

    /// The file again.
    pub fn into_file(mut self) -> MeshFile<M> {
        let mirrored = self.space.is_mirrored();
        self.lattice.swap_positions(&mut self.world, mirrored);
        self.arrays.with_mesh(self.lattice)
    }
}

/// Cells may fill this much less or more than their box.
const VOLUME_TOLERANCE: f64 = 1e-6;

/// The smallest box that holds all points.
pub fn bounding_box<const D: usize>(points: &[[f64; D]]) -> ([f64; D], [f64; D]) {
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

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::mesh::TriMesh;
    use crate::mesh::poly::samples::two_cells;

    /// A file of a mesh in lattice space, in a world that mirrors it or does not.
    pub fn file<const D: usize, M: Storable<D>>(
        mesh: M,
        down: f64,
    ) -> (MeshFile<M>, LatticeSpace<D>) {
        let mut spacing = [2.0; D];
        spacing[D - 1] = down;
        let geometry = Geometry::with_spacing([10.0; D], spacing);
        let space = LatticeSpace {
            extent: [2.0; D],
            step: [0.5; D],
            geometry,
            is_stored: true,
            velocities: None,
        };
        let mut positions = mesh.mapped_positions(|&x| Some(space.to_world(x))).unwrap();
        let mut mesh = mesh;
        mesh.swap_positions(&mut positions, space.is_mirrored());
        let numbers = |name: &str, values: &[f64]| (name.into(), FieldValue::F64s(values.to_vec()));
        let arrays = MeshFile {
            field_data: vec![
                numbers("origin", &space.geometry.origin),
                numbers("axes", space.geometry.axes.as_flattened()),
                numbers("lattice_step", &space.step),
                numbers("lattice_extent", &space.extent),
            ],
            ..MeshFile::default()
        };
        (arrays.with_mesh(mesh), space)
    }

    /// Reads a file back, looks at the mesh in both spaces, and gives the file again.
    fn check_round_trip<const D: usize, M: Storable<D> + PartialEq>(lattice: M) {
        for down in [3.0, -3.0] {
            let (file, space) = file(lattice.clone(), down);
            let mut stored = StoredMesh::new(file.clone(), "mesh").unwrap();
            assert_eq!(stored.space, space);
            assert_eq!(stored.world.nodes, file.mesh.nodes());
            assert_eq!(stored.lattice.nodes(), lattice.nodes());
            let positive = |mesh: &M| mesh.volumes().iter().all(|v| *v > 0.0);
            assert!(positive(&stored.lattice), "{down}");
            assert!(stored.with_world_mesh(positive), "{down}");
            let lattice_again = stored.lattice.clone();
            assert!(stored.with_world_mesh(|mesh| mesh.nodes() == file.mesh.nodes()));
            assert_eq!(stored.lattice, lattice_again);
            let again = stored.into_file();
            assert_eq!(again.mesh.nodes(), file.mesh.nodes());
            assert_eq!(again.field_data, file.field_data);
            let facets = |mesh: &M| {
                let mut facets = Vec::new();
                (0..mesh.face_count()).for_each(|f| mesh.facets(f, |facet| facets.push(facet)));
                facets
            };
            assert_eq!(facets(&again.mesh), facets(&file.mesh), "{down}");
        }
    }

    #[test]
    fn a_mesh_goes_to_lattice_space_and_back_to_its_file() {
        check_round_trip(TriMesh {
            nodes: vec![[0.0; 2], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]],
            triangles: vec![[0, 1, 2], [2, 1, 3]],
        });
        check_round_trip(TetMesh {
            nodes: vec![[0.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]],
            tets: vec![[0, 1, 2, 3]],
        });
        check_round_trip(two_cells::<2>(0.75));
        check_round_trip(two_cells::<3>(0.75));
    }

    #[test]
    fn faces_on_horizons_are_found_among_faces_on_sides() {
        // A row of 40 boxes, each neighbour's face on a horizon: more faces lie on sides.
        let mut row = two_cells::<3>(1.0);
        let side = row.face_cells[1];
        row.face_cells = (0..39).map(|c| [c, c + 1]).collect();
        row.face_cells.extend((0..40).map(|c| [c, side[1]]));
        let pairs = row.face_cells[..39].iter().flat_map(|c| c.map(i64::from));
        let pairs = FieldValue::Ints(pairs.collect());
        let mut file = MeshFile::<()>::default().with_mesh(row);
        file.field_data.push((HORIZON_FACES_ARRAY.into(), pairs));
        let found = PolyMesh::<3>::horizons(&file, false);
        assert_eq!(found, [[true; 39].as_slice(), &[false; 40]].concat());
    }

    #[test]
    fn files_that_say_half_of_where_they_lie_are_refused() {
        let mesh = two_cells::<3>(0.75);
        let (mut file, _) = file(mesh, 1.0);
        file.field_data.remove(0);
        let error = StoredMesh::new(file, "a.vtu").unwrap_err().to_string();
        assert!(
            error.contains("a.vtu: records only part of its position"),
            "{error}"
        );
        let none = MeshFile::<PolyMesh<3>>::default();
        let error = StoredMesh::new(none, "a.vtu").unwrap_err().to_string();
        assert!(error.contains("holds no polyhedra"), "{error}");
    }
}
