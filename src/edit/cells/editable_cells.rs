//! Voronoi cells as a file stores them, prepared for edits.

use crate::edit::editable_mesh::left_out_error;
use crate::edit::resolve::EditLattice;
use crate::edit::unknown_arrays;
use crate::error::cause;
use crate::geometry::NONE;
use crate::geometry::{add_scaled, distance2, dot, sub};
use crate::job::{LatticeParams, Params, lattice_points, lattice_well_paths};
use crate::lattice::AtomKind;
use crate::lattice::seeding::Alignment;
use crate::mesh::Positions;
use crate::mesh::check::{CheckHints, check_with_hints};
use crate::mesh::poly::{Lists, PolyMesh};
use crate::mesh_file::array_names::{DISTANCE_ARRAY, HORIZON_FACES_ARRAY, IMAGE_ARRAY, LIVE_ARRAY};
use crate::store::{FieldValue, LatticeSpace, MeshFile, StoredMesh, read_labels};
use crate::{Error, Result};

/// Name of the array with the kind of each cell's atom. Only edited files have it.
pub(crate) const ATOM_KIND: &str = "atom_kind";
/// Name of the array that flags cells with a face on a feature.
pub(super) const ON_FEATURE: &str = "on_feature";

/// Returns the name of the array of cell volumes.
pub(super) fn volume_name<const D: usize>() -> &'static str {
    if D == 2 { "area" } else { "volume" }
}

/// Distance, in units of d, within which an atom counts as lying at a fixed position.
const SITE_MATCH_RADIUS: f64 = 1e-6;

/// Voronoi cells and the data of each cell.
#[derive(Debug, Clone)]
pub struct EditableCells<const D: usize> {
    pub place: String,
    /// The cells in lattice space.
    pub mesh: PolyMesh<D>,
    /// Their nodes and sites in physical coordinates.
    pub world: Positions<D>,
    pub space: LatticeSpace<D>,
    pub weld: f64,
    pub fields: Vec<(String, FieldValue)>,
    pub volume: Vec<f64>,
    /// Nominal distance d at each site.
    pub distance: Vec<f32>,
    /// Kind of each atom: how it may move.
    pub kinds: Vec<AtomKind>,
    /// `true` if regions are labels; features are then the faces between different regions.
    pub has_labels: bool,
    /// For each face, `true` if it lies on a horizon.
    pub on_horizon: Vec<bool>,
    /// For each node, the cells and sides of the box that meet in it, ascending.
    pub cells_of_nodes: Lists,
}

impl<const D: usize> EditableCells<D> {
    /// Creates editable cells from a file, which `place` names in errors. Node and cell arrays that
    /// [`job::run`](crate::job::run()) does not write are dropped. Fixed atoms are those that the
    /// file records, or else those that `params` gives.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if the file does not record its lattice space, or the mesh is not
    /// valid.
    pub fn new(file: MeshFile<PolyMesh<D>>, place: &str, params: &Params<D>) -> Result<Self> {
        let StoredMesh {
            lattice: mesh,
            world,
            space,
            is_horizon_face: horizons,
            weld,
            arrays,
            outer,
            ..
        } = StoredMesh::new(file, place)?;
        let refuse = |problem: String| {
            Error::Mesh(cause(place, problem, "give a mesh that atomesh mesh wrote"))
        };
        if !space.is_stored {
            return Err(refuse("does not record where its lattice lies".into()));
        }
        if outer.is_some() {
            return Err(left_out_error(place));
        }
        let hints = CheckHints {
            weld,
            ..CheckHints::default()
        };
        let validity = check_with_hints(&mesh, hints, [0.0; D], space.extent, space.tolerance());
        if let Some(problem) = validity.problems.first() {
            return Err(refuse(format!("is not valid: {problem}")));
        }
        let cells = mesh.sites.len();
        let array = |name: &str| {
            let array = arrays.cell_array(name)?;
            let matches = array.components == 1 && array.values.len() == cells;
            matches.then(|| array.values.to_f64())
        };
        let distance = array(DISTANCE_ARRAY).filter(|d| d.iter().all(|d| *d > 0.0));
        let distance = distance.ok_or_else(|| {
            refuse(format!(
                "has no cell array {DISTANCE_ARRAY}, or values in it that are not positive"
            ))
        })?;
        let distance: Vec<f32> = distance.into_iter().map(|d| d as f32).collect();
        let is_fixed_site = fixed_site_test(params, &space)?;
        let kinds: Vec<AtomKind> = match array(ATOM_KIND) {
            Some(kinds) => {
                let is_fixed = |kind: f64| kind == f64::from(AtomKind::Fixed as u8);
                kinds
                    .into_iter()
                    .map(|kind| kind_of(is_fixed(kind)))
                    .collect()
            }
            None => (mesh.sites.iter().zip(&distance))
                .map(|(&x, &d)| kind_of(is_fixed_site(x, f64::from(d))))
                .collect(),
        };
        Ok(Self {
            place: place.to_string(),
            volume: array(volume_name::<D>())
                .unwrap_or_else(|| mesh.cell_shapes().into_iter().map(|s| s.0).collect()),
            cells_of_nodes: cells_of_nodes(&mesh),
            on_horizon: if horizons.is_empty() {
                vec![false; mesh.face_cells.len()]
            } else {
                horizons
            },
            has_labels: !read_labels(&arrays).is_empty(),
            fields: arrays.field_data,
            mesh,
            world,
            space,
            weld,
            distance,
            kinds,
        })
    }

    /// Returns the atoms in the form that [`resolve`](crate::edit::resolve) needs.
    pub fn lattice(&self) -> EditLattice<'_, D> {
        EditLattice {
            place: &self.place,
            nodes: &self.mesh.sites,
            kinds: &self.kinds,
            distance: &self.distance,
            extent: self.space.extent,
            step: self.space.step,
            geometry: &self.space.geometry,
            alignment: Alignment::AlongsideFeatures,
        }
    }
}

fn kind_of(is_fixed: bool) -> AtomKind {
    if is_fixed {
        AtomKind::Fixed
    } else {
        AtomKind::Interior
    }
}

/// Returns a function that tests if `params` defines a fixed atom at a position, given d there: an
/// atom of its own, or a point on the path of a well.
fn fixed_site_test<const D: usize>(
    params: &Params<D>,
    space: &LatticeSpace<D>,
) -> Result<impl Fn([f64; D], f64) -> bool + use<D>> {
    let (geometry, step, extent) = (&space.geometry, space.step, space.extent);
    let points = lattice_points(&params.fixed_atoms, geometry, step, extent)?;
    let lattice_params = LatticeParams::for_step(params, geometry, step);
    let well_paths = lattice_well_paths(&lattice_params, geometry, step, extent)?;
    Ok(move |x: [f64; D], d: f64| {
        let is_match = |squared_distance: f64| squared_distance <= (SITE_MATCH_RADIUS * d).powi(2);
        let is_on_segment = |segment: &[[f64; D]]| {
            let (start, direction) = (segment[0], sub(segment[segment.len() - 1], segment[0]));
            let fraction =
                dot(sub(x, start), direction) / dot(direction, direction).max(f64::MIN_POSITIVE);
            is_match(distance2(
                &add_scaled(start, fraction.clamp(0.0, 1.0), direction),
                &x,
            ))
        };
        points.iter().any(|y| is_match(distance2(y, &x)))
            || well_paths
                .iter()
                .any(|path| path.points.windows(2).any(is_on_segment))
    })
}

/// Returns, for each node, the cells and sides of the box that meet in it, ascending.
pub fn cells_of_nodes<const D: usize>(mesh: &PolyMesh<D>) -> Lists {
    let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(2 * mesh.faces.items.len());
    for (f, cells) in mesh.face_cells.iter().enumerate() {
        for &n in mesh.faces.get(f) {
            pairs.extend(cells.iter().filter(|&&c| c != NONE).map(|&c| (n, c)));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    let mut lists = Lists::default();
    let mut pairs_left = pairs.as_slice();
    for n in 0..mesh.nodes.len() as u32 {
        let (node_pairs, later_pairs) =
            pairs_left.split_at(pairs_left.partition_point(|pair| pair.0 <= n));
        lists.push(node_pairs.iter().map(|pair| pair.1));
        pairs_left = later_pairs;
    }
    lists
}

/// Returns the names of arrays that an edit cannot keep.
pub fn dropped_arrays<const D: usize>(file: &MeshFile<PolyMesh<D>>) -> Vec<String> {
    let known = [
        ATOM_KIND,
        ON_FEATURE,
        DISTANCE_ARRAY,
        volume_name::<D>(),
        HORIZON_FACES_ARRAY,
        IMAGE_ARRAY,
        LIVE_ARRAY,
    ];
    unknown_arrays(file, &known)
}
