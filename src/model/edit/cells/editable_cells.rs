//! Voronoi cells as a file holds them.

use crate::error::cause;
use crate::geometry::{add_scaled, distance2, dot, sub};
use crate::job::{Params, lattice_points, lattice_well_paths};
use crate::lattice::AtomKind;
use crate::lattice::seeding::Alignment;
use crate::mesh::Positions;
use crate::mesh::check::{CheckHints, check_with_hints};
use crate::mesh::poly::{Lists, NO_CELL, PolyMesh};
use crate::model::edit::resolve::EditLattice;
use crate::model::edit::unknown_arrays;
use crate::store::output::{DISTANCE_ARRAY, HORIZON_FACES_ARRAY, IMAGE_ARRAY};
use crate::store::{FieldValue, LatticeSpace, MeshFile, StoredMesh, read_labels};
use crate::{Error, Result};

/// The array that says of each cell what its atom may do, once cells have been edited.
pub(crate) const ATOM_KIND: &str = "atom_kind";
/// The array that says which cells have a face on a feature.
pub(super) const ON_FEATURE: &str = "on_feature";

/// The name of the cells' volumes.
pub(super) fn volume_name<const D: usize>() -> &'static str {
    if D == 2 { "area" } else { "volume" }
}

/// An atom this near to a given place, in units of d, is the one given.
const SITE_MATCH_RADIUS: f64 = 1e-6;

/// Voronoi cells, and what is known of each.
#[derive(Debug, Clone)]
pub struct EditableCells<const D: usize> {
    pub place: String,
    /// In lattice space.
    pub mesh: PolyMesh<D>,
    /// The same nodes and sites in the world.
    pub world: Positions<D>,
    pub space: LatticeSpace<D>,
    pub weld: f64,
    pub fields: Vec<(String, FieldValue)>,
    pub volume: Vec<f64>,
    /// d at each site.
    pub distance: Vec<f32>,
    /// What each atom may do.
    pub kinds: Vec<AtomKind>,
    /// Whether regions are labels: then features are where they meet.
    pub has_labels: bool,
    /// Which faces lie on horizons.
    pub on_horizon: Vec<bool>,
    /// The cells and sides of the box that meet in each node, ascending.
    pub cells_of_nodes: Lists,
}

impl<const D: usize> EditableCells<D> {
    /// Of a file, which `place` names in errors. What is stored for each node or cell besides what
    /// [`job::run`](crate::job::run) stores is dropped. Atoms that never move are those that the file says,
    /// or else those that the parameters give.
    ///
    /// # Errors
    /// [`Error::Mesh`] if the file does not record its lattice space, or the mesh is not valid.
    pub fn new(file: MeshFile<PolyMesh<D>>, place: &str, params: &Params<D>) -> Result<Self> {
        let StoredMesh {
            lattice: mesh,
            world,
            space,
            is_horizon_face: horizons,
            weld,
            arrays,
            ..
        } = StoredMesh::new(file, place)?;
        let refuse = |problem: String| {
            Error::Mesh(cause(place, problem, "give a mesh that atomesh mesh wrote"))
        };
        if !space.is_stored {
            return Err(refuse("does not record its lattice space".into()));
        }
        let known = CheckHints {
            weld,
            ..CheckHints::default()
        };
        let found = check_with_hints(&mesh, known, [0.0; D], space.extent, space.tolerance());
        if let Some(problem) = found.problems.first() {
            return Err(refuse(format!("is not valid: {problem}")));
        }
        let cells = mesh.sites.len();
        let array = |name: &str| {
            let array = arrays.cell_array(name)?;
            let right = array.components == 1 && array.values.len() == cells;
            right.then(|| array.values.to_f64())
        };
        let distance = array(DISTANCE_ARRAY).filter(|d| d.iter().all(|d| *d > 0.0));
        let distance = distance.ok_or_else(|| {
            refuse(format!(
                "lacks the cell data {DISTANCE_ARRAY}, or not all are positive"
            ))
        })?;
        let distance: Vec<f32> = distance.into_iter().map(|d| d as f32).collect();
        let is_given = fixed_site_test(params, &space)?;
        let kinds: Vec<AtomKind> = match array(ATOM_KIND) {
            Some(kinds) => {
                let fixed = |kind: f64| kind == f64::from(AtomKind::Fixed as u8);
                kinds.into_iter().map(|kind| kind_of(fixed(kind))).collect()
            }
            None => (mesh.sites.iter().zip(&distance))
                .map(|(&x, &d)| kind_of(is_given(x, f64::from(d))))
                .collect(),
        };
        Ok(Self {
            place: place.to_string(),
            volume: array(volume_name::<D>())
                .unwrap_or_else(|| mesh.cell_shapes().into_iter().map(|s| s.0).collect()),
            cells_of_nodes: cells_of_nodes(&mesh),
            on_horizon: match horizons.is_empty() {
                true => vec![false; mesh.face_cells.len()],
                false => horizons,
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

    /// The atoms as edits see them.
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
    match is_fixed {
        true => AtomKind::Fixed,
        false => AtomKind::Interior,
    }
}

/// Tells of a position, and d there, whether the parameters give an atom there: one of its own, or one on
/// the way of a well.
fn fixed_site_test<const D: usize>(
    params: &Params<D>,
    space: &LatticeSpace<D>,
) -> Result<impl Fn([f64; D], f64) -> bool + use<D>> {
    let (geometry, step, extent) = (&space.geometry, space.step, space.extent);
    let points = lattice_points(&params.fixed_atoms, geometry, step, extent)?;
    let ways = lattice_well_paths(params, geometry, step, extent)?;
    Ok(move |x: [f64; D], d: f64| {
        let near = |to: f64| to <= (SITE_MATCH_RADIUS * d).powi(2);
        let on_leg = |leg: &[[f64; D]]| {
            let (from, along) = (leg[0], sub(leg[leg.len() - 1], leg[0]));
            let share = dot(sub(x, from), along) / dot(along, along).max(f64::MIN_POSITIVE);
            near(distance2(
                &add_scaled(from, share.clamp(0.0, 1.0), along),
                &x,
            ))
        };
        points.iter().any(|y| near(distance2(y, &x)))
            || ways.iter().any(|way| way.points.windows(2).any(on_leg))
    })
}

/// The cells and sides of the box that meet in each node, ascending.
pub fn cells_of_nodes<const D: usize>(mesh: &PolyMesh<D>) -> Lists {
    let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(2 * mesh.faces.items.len());
    for (f, cells) in mesh.face_cells.iter().enumerate() {
        for &n in mesh.faces.get(f) {
            pairs.extend(cells.iter().filter(|&&c| c != NO_CELL).map(|&c| (n, c)));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    let mut lists = Lists::default();
    let mut at = pairs.as_slice();
    for n in 0..mesh.nodes.len() as u32 {
        let (own, rest) = at.split_at(at.partition_point(|pair| pair.0 <= n));
        lists.push(own.iter().map(|pair| pair.1));
        at = rest;
    }
    lists
}

/// Names of arrays that an edit cannot carry over.
pub fn dropped_arrays<const D: usize>(file: &MeshFile<PolyMesh<D>>) -> Vec<String> {
    let known = [
        ATOM_KIND,
        ON_FEATURE,
        DISTANCE_ARRAY,
        volume_name::<D>(),
        HORIZON_FACES_ARRAY,
        IMAGE_ARRAY,
    ];
    unknown_arrays(file, &known)
}
