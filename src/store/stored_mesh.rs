//! Meshes from files, whatever their cells are, and the conversion back to lattice space.

use std::path::Path;

use super::named_sets::NamedSets;
use super::{
    FieldValue, LatticeSpace, MeshFile, face_bits_to_physical, write_cells_vtu, write_vtu,
};
use crate::error::cause;
use crate::files::vtk::{DataArray, Values};
use crate::mesh::check::{self, CheckHints, OuterBoundary};
use crate::mesh::interface::marks_from_bits;
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Positions, Simplices, TetMesh};
use crate::mesh_file::array_names::{
    HORIZON_FACES_ARRAY, LIVE_ARRAY, REGION_ARRAY, THROWS_FIELD, WELD_FIELD,
};
use crate::mesh_file::labels::remove_labels;
use crate::mesh_file::named_surfaces::NamedSurfaces;
use crate::mesh_file::{CUT_NAME, TakeCells, read_outer_boundary};
use crate::{Error, Result};

/// A mesh read from a file. The mesh is in lattice space; of the file's coordinates only the positions
/// are kept.
///
/// ```
/// use atomesh::image::{Geometry, Image};
/// use atomesh::MeshSpec;
/// use atomesh::progress::NoProgress;
/// use atomesh::store::{AnyMesh, StoredMesh, read_any_vtu};
///
/// // A disc, on samples 25 m apart.
/// let from_centre = |i: usize| ((i % 40) as f64 - 20.0).hypot((i / 40) as f64 - 18.0);
/// let disc = (0..40 * 36).map(|i| f32::from(from_centre(i) < 11.0));
/// let geometry = Geometry { axes: [[25.0, 0.0], [0.0, 25.0]], ..Geometry::default() };
/// let image = Image::new([40, 36], disc.collect(), geometry);
/// let spec = MeshSpec { distance: "5".parse()?, ..MeshSpec::default() };
/// let path = std::env::temp_dir().join("atomesh-stored-mesh.vtu");
/// atomesh::mesh(&image, &spec, &mut NoProgress)?.write(&path)?;
///
/// let AnyMesh::Triangles(file) = read_any_vtu(&path)? else { unreachable!("the image is 2-D") };
/// let stored = StoredMesh::new(file, "the disc")?;
/// assert_eq!(stored.space.extent, [39.0, 35.0]);
/// assert_eq!(stored.space.to_world([39.0, 35.0]), [975.0, 875.0]);
/// assert!(stored.feature_marks().is_some_and(|marks| marks.contains(&true)));
/// # std::fs::remove_file(&path).ok();
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct StoredMesh<const D: usize = 3, M = TetMesh> {
    /// The mesh in lattice space, in the box `[0, extent]`.
    pub lattice: M,
    /// The positions in the file.
    pub world: Positions<D>,
    /// The position of lattice space in the world.
    pub space: LatticeSpace<D>,
    /// For each simplex, bit k is set if face k of `lattice` lies on a feature according to the
    /// file.
    pub feature_faces: Option<Vec<u8>>,
    /// For each face number of `lattice`, `true` if the face lies on a horizon; empty if none does.
    pub is_horizon_face: Vec<bool>,
    /// Fraction of the cells' size within which nodes of Voronoi cells are welded, according to the
    /// file.
    pub weld: f64,
    /// Surfaces that have names in the file.
    pub named_surfaces: NamedSurfaces,
    /// Sets of cells, faces and nodes that have names in the file.
    pub named_sets: NamedSets,
    /// The boundary at which cells were left out, if the mesh does not fill its box.
    pub outer: Option<OuterBoundary>,
    /// The other data of the file.
    pub arrays: MeshFile<()>,
}

/// A mesh type that files can store.
pub trait Storable<const D: usize>: TakeCells<D> {
    /// Returns for each simplex the bits of its faces on features. `mirrored` says that cells will
    /// be reversed. Returns `None` if the file does not have the bits, and for polyhedra and
    /// polygons, which store the marks themselves.
    fn feature_faces(file: &MeshFile<Self>, mirrored: bool) -> Option<Vec<u8>>;

    /// Returns for each face number whether the face lies on a horizon; empty if none does.
    /// `mirrored` says that cells will be reversed.
    fn horizons(file: &MeshFile<Self>, mirrored: bool) -> Vec<bool>;

    /// Returns for each face number whether the face lies on a feature, from the bits in the file;
    /// `None` if the file does not have them. The mesh is in lattice space.
    fn feature_marks(&self, feature_faces: Option<&[u8]>) -> Option<Vec<bool>>;

    /// Assigns boundary faces to the sides of the box `[0, extent]`, for meshes that store sides. In
    /// columns with throws, upright faces that lie in no side get none.
    fn find_sides(&mut self, extent: [f64; D], has_throws: bool);

    /// Takes the side from the boundary faces where cells were left out, for meshes that store sides.
    fn release_outer_faces(&mut self, outer: &OuterBoundary);

    /// Returns the region of each cell; `None` if the file does not have regions. `cell_data` are
    /// the arrays of the cells.
    fn regions(&self, cell_data: &[DataArray]) -> Option<Vec<i32>>;

    /// Sets the region of each cell, and removes the labels.
    fn set_regions(file: &mut MeshFile<Self>, regions: Vec<i32>);

    /// Writes a file.
    ///
    /// # Errors
    /// Returns the errors of [`write_vtu`].
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

    fn find_sides(&mut self, _: [f64; D], _: bool) {}

    fn release_outer_faces(&mut self, _: &OuterBoundary) {}

    fn regions(&self, cell_data: &[DataArray]) -> Option<Vec<i32>> {
        let array = cell_data.iter().find(|array| array.name == REGION_ARRAY)?;
        let regions = array.values.to_i64();
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

/// Returns the bits of simplices' faces that a file stores.
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
        // Inner faces come first, in the order of their cells; the faces on sides follow.
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

    fn find_sides(&mut self, extent: [f64; D], has_throws: bool) {
        self.assign_sides([0.0; D], extent);
        if has_throws {
            self.release_fault_sides([0.0; D], extent);
        }
    }

    fn release_outer_faces(&mut self, outer: &OuterBoundary) {
        // The file does not mark the faces of the boundary that lie on features: these are interfaces.
        let is_interface = |set: u32| {
            outer
                .names
                .get(set as usize)
                .is_some_and(|name| name != CUT_NAME)
        };
        self.release_sides(|nodes| outer.set_of(nodes).map(is_interface));
    }

    fn regions(&self, _: &[DataArray]) -> Option<Vec<i32>> {
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

impl<const D: usize, M: Storable<D>> StoredMesh<D, M> {
    /// Converts a file to lattice space. `place` names the file in errors. Boundary faces of
    /// polyhedra and polygons are assigned to the nearest sides of the box.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] for a mesh without cells, or with an invalid geometry.
    pub fn new(file: MeshFile<M>, place: &str) -> Result<Self> {
        let refuse = |problem: &str| {
            let remedy = "give a mesh that atomesh mesh wrote";
            Err(Error::Mesh(cause(place, problem, remedy)))
        };
        if file.mesh.is_empty() || file.mesh.nodes().is_empty() {
            return refuse(&format!("holds no {}", M::CELLS_NAME));
        }
        let Some(space) = LatticeSpace::from_file(&file, file.mesh.nodes()) else {
            return refuse("records only a part of where its lattice lies");
        };
        let Some(mut positions) = file.mesh.mapped_positions(|&x| space.to_lattice(x)) else {
            return refuse("has linearly dependent axes");
        };
        let mirrored = space.is_mirrored();
        let weld = match file.field_value(WELD_FIELD) {
            Some(FieldValue::F64s(weld)) => weld.first().copied(),
            _ => None,
        };
        let has_throws = file.field_value(THROWS_FIELD).is_some();
        let feature_faces = M::feature_faces(&file, mirrored);
        let horizons = M::horizons(&file, mirrored);
        let named = NamedSurfaces::from_file(&file);
        let named_sets = NamedSets::from_file(&file);
        let outer = read_outer_boundary(&file);
        let (mut lattice, arrays) = file.into_parts();
        lattice.swap_positions(&mut positions, mirrored);
        lattice.find_sides(space.extent, has_throws);
        if let Some(outer) = &outer {
            lattice.release_outer_faces(outer);
        }
        Ok(Self {
            lattice,
            world: positions,
            space,
            feature_faces,
            is_horizon_face: horizons,
            weld: weld.unwrap_or(0.0),
            named_surfaces: named,
            named_sets,
            outer,
            arrays,
        })
    }

    /// Returns what a check needs to know about the mesh.
    pub fn check_hints(&self) -> CheckHints<'_> {
        CheckHints {
            weld: self.weld,
            bent_side: self.space.bent_side,
            outer: self.outer.as_ref(),
            ..CheckHints::default()
        }
    }

    /// Checks that cells neither overlap nor leave a hole in their box: a simulator would take a
    /// hole for a wall, without a message. `place` names the file in errors.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] for overlaps and holes. Flat or inverted cells are not reported.
    pub fn check_filled(&self, place: &str) -> Result<()> {
        let fraction = check::filled_share(&self.lattice, self.space.extent, self.check_hints());
        let problem = match fraction {
            Some(fraction) if fraction > 1.0 + VOLUME_TOLERANCE => {
                format!("some of its cells overlap: they fill {fraction:.4} times their box")
            }
            Some(fraction) if fraction < 1.0 - VOLUME_TOLERANCE => {
                format!(
                    "cells are missing: they fill {fraction:.4} of their box, and fluid would flow around the hole"
                )
            }
            _ => return Ok(()),
        };
        let remedy = "give a mesh that passes the checker: mesh the image again";
        Err(Error::Mesh(cause(place, problem, remedy)))
    }

    /// Returns for each face number of `lattice` whether the face lies on a feature; `None` if the
    /// file does not have the marks.
    pub fn feature_marks(&self) -> Option<Vec<bool>> {
        self.lattice.feature_marks(self.feature_faces.as_deref())
    }

    /// Returns the region of each cell; `None` if the file does not have regions.
    pub fn regions(&self) -> Option<Vec<i32>> {
        self.lattice.regions(&self.arrays.cell_data)
    }

    /// Calls `f` with the mesh in the positions of the file, and returns its result. If the world
    /// mirrors lattice space, faces of simplices have other numbers there.
    pub fn with_world_mesh<T>(&mut self, f: impl FnOnce(&M) -> T) -> T {
        let mirrored = self.space.is_mirrored();
        self.lattice.swap_positions(&mut self.world, mirrored);
        let result = f(&self.lattice);
        self.lattice.swap_positions(&mut self.world, mirrored);
        result
    }

    /// Converts back to a file.
    pub fn into_file(mut self) -> MeshFile<M> {
        let mirrored = self.space.is_mirrored();
        self.lattice.swap_positions(&mut self.world, mirrored);
        self.arrays.with_mesh(self.lattice)
    }
}

/// Largest relative difference between the volume of the cells and that of their box.
const VOLUME_TOLERANCE: f64 = 1e-6;

/// Returns the share of each cell that holds data, if a mesh file has the array: one number from 0 to
/// 1 for each of `cells` cells.
pub(crate) fn read_live(cell_data: &[DataArray], cells: usize) -> Option<Vec<f64>> {
    let array = cell_data.iter().find(|array| array.name == LIVE_ARRAY)?;
    let shares = array.values.to_f64();
    let is_share = |share: &f64| (0.0..=1.0).contains(share);
    (array.components == 1 && shares.len() == cells && shares.iter().all(is_share))
        .then_some(shares)
}
#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::image::Geometry;
    use crate::mesh::TriMesh;
    use crate::mesh::poly::samples::two_cells;

    /// Returns a file of a mesh in lattice space. With a negative `sample_interval` the world
    /// mirrors lattice space.
    pub fn file<const D: usize, M: Storable<D>>(
        mesh: M,
        sample_interval: f64,
    ) -> (MeshFile<M>, LatticeSpace<D>) {
        let mut spacing = [2.0; D];
        spacing[D - 1] = sample_interval;
        let geometry = Geometry::with_spacing([10.0; D], spacing);
        let space = LatticeSpace {
            extent: [2.0; D],
            step: [0.5; D],
            geometry,
            bent_side: None,
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

    /// Reads a file, compares the mesh in both spaces, and converts it back to a file.
    fn check_round_trip<const D: usize, M: Storable<D> + PartialEq>(lattice: M) {
        for sample_interval in [3.0, -3.0] {
            let (file, space) = file(lattice.clone(), sample_interval);
            let mut stored = StoredMesh::new(file.clone(), "mesh").unwrap();
            assert_eq!(stored.space, space);
            assert_eq!(stored.world.nodes, file.mesh.nodes());
            assert_eq!(stored.lattice.nodes(), lattice.nodes());
            let all_positive = |mesh: &M| mesh.volumes().iter().all(|v| *v > 0.0);
            assert!(all_positive(&stored.lattice), "{sample_interval}");
            assert!(stored.with_world_mesh(all_positive), "{sample_interval}");
            let lattice_again = stored.lattice.clone();
            assert!(stored.with_world_mesh(|mesh| mesh.nodes() == file.mesh.nodes()));
            assert_eq!(stored.lattice, lattice_again);
            let written = stored.into_file();
            assert_eq!(written.mesh.nodes(), file.mesh.nodes());
            assert_eq!(written.field_data, file.field_data);
            let facets = |mesh: &M| {
                let mut facets = Vec::new();
                (0..mesh.face_count()).for_each(|f| mesh.facets(f, |facet| facets.push(facet)));
                facets
            };
            assert_eq!(
                facets(&written.mesh),
                facets(&file.mesh),
                "{sample_interval}"
            );
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
        // A row of 40 boxes, where every inner face is on a horizon: there are more faces on sides.
        let mut row = two_cells::<3>(1.0);
        let side = row.face_cells[1];
        row.face_cells = (0..39).map(|c| [c, c + 1]).collect();
        row.face_cells.extend((0..40).map(|c| [c, side[1]]));
        let pairs = row.face_cells[..39].iter().flat_map(|c| c.map(i64::from));
        let pairs = FieldValue::Ints(pairs.collect());
        let mut file = MeshFile::<()>::default().with_mesh(row);
        file.field_data.push((HORIZON_FACES_ARRAY.into(), pairs));
        let horizons = PolyMesh::<3>::horizons(&file, false);
        assert_eq!(horizons, [[true; 39].as_slice(), &[false; 40]].concat());
    }

    #[test]
    fn files_with_only_a_part_of_their_position_are_refused() {
        let mesh = two_cells::<3>(0.75);
        let (mut file, _) = file(mesh, 1.0);
        file.field_data.remove(0);
        let error = StoredMesh::new(file, "a.vtu").unwrap_err().to_string();
        assert!(
            error.contains("a.vtu: records only a part of where its lattice lies"),
            "{error}"
        );
        let none = MeshFile::<PolyMesh<3>>::default();
        let error = StoredMesh::new(none, "a.vtu").unwrap_err().to_string();
        assert!(error.contains("holds no polyhedra"), "{error}");
    }
}
