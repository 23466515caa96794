//! What the user asks for -> changes of the lattice, checked, in groups whose neighbourhoods do not
//! meet.

use super::{AtomChange, Edit};
use crate::error::cause;
use crate::image::Geometry;
use crate::job::{FixedAtom, lattice_points};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::{Alignment, fixed_atoms, kind_at, side_count};
use crate::{Error, Result};

/// The atoms of a mesh, before any edit.
#[derive(Debug, Clone, Copy)]
pub struct EditLattice<'a, const D: usize> {
    /// The name of the mesh in errors.
    pub place: &'a str,
    /// Where atoms are.
    pub nodes: &'a [[f64; D]],
    /// What each may do.
    pub kinds: &'a [AtomKind],
    /// d at each.
    pub distance: &'a [f32],
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis.
    pub step: [f64; D],
    /// From samples to physical coordinates.
    pub geometry: &'a Geometry<D>,
    /// On features atoms are nodes of a mesh, alongside they have cells.
    pub alignment: Alignment,
}

impl<const D: usize> EditLattice<'_, D> {
    /// The nominal distance at the atom nearest to a position.
    pub fn nominal_distance_at(&self, x: [f64; D]) -> f64 {
        let gaps = self.nodes.iter().map(|&y| squared_distance(x, y));
        let nearest = gaps
            .zip(self.distance)
            .fold((f64::INFINITY, 0.0), |best, (gap, &d)| {
                if gap < best.0 { (gap, d) } else { best }
            });
        f64::from(nearest.1)
    }
}

/// A change of the lattice; positions are of lattice space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action<const D: usize> {
    /// An atom goes.
    Remove {
        /// Its number.
        node: u32,
    },
    /// An atom comes.
    Insert {
        /// Where.
        target: [f64; D],
        /// The number that it shall have, if it comes from elsewhere.
        number: Option<u32>,
    },
    /// An atom goes a little way.
    Shift {
        /// Its number.
        node: u32,
        /// Where to.
        target: [f64; D],
    },
}

/// An action, and where it comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EditStep<const D: usize> {
    /// What shall happen.
    pub action: Action<D>,
    /// The number of the edit.
    pub edit: usize,
    /// What the atom will be that comes or is shifted.
    pub kind: AtomKind,
}

/// Steps near one another.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EditGroup<const D: usize> {
    /// What shall happen.
    pub steps: Vec<EditStep<D>>,
    /// Every position where an atom comes, goes or was, with the d that is there.
    pub edited_places: Vec<([f64; D], f64)>,
}

/// Atoms that go farther than this, in units of d, leave their place and come anew.
const MAX_SHIFT: f64 = 0.7;

/// Beyond this, in units of d, nothing is of interest to an edit: warm atoms are within five d, the
/// cells that they have within 1.7 more, and the atoms that these feel are not farther.
pub const INFLUENCE_RADIUS: f64 = 7.5;

/// Checks edits and sorts them into groups; with `free`, atoms are not fixed where they are put.
///
/// # Errors
/// [`Error::Mesh`] for an atom that does not exist, is edited twice or is a corner of the box;
/// [`Error::Seeding`] for a place outside the box or that of another atom.
pub fn resolve<const D: usize>(
    lattice: &EditLattice<'_, D>,
    edits: &[Edit<D>],
    free: bool,
) -> Result<Vec<EditGroup<D>>> {
    check_atoms(lattice, edits)?;
    let targets = target_positions(lattice, edits)?;
    let mut all = Vec::new();
    for (number, (edit, target)) in edits.iter().zip(targets).enumerate() {
        let step = |action| EditStep {
            action,
            edit: number,
            kind: match target {
                Some(to) if free => kind_at(to, lattice.extent),
                _ => AtomKind::Fixed,
            },
        };
        let at = |node: u32| lattice.nodes[node as usize];
        let one = |action, places: &[[f64; D]]| EditGroup {
            steps: vec![step(action)],
            edited_places: (places.iter())
                .map(|&x| (x, lattice.nominal_distance_at(x)))
                .collect(),
        };
        match (edit.change, target) {
            (AtomChange::Remove(node), _) => all.push(one(Action::Remove { node }, &[at(node)])),
            (AtomChange::Move(node, _), Some(to)) => {
                let from = at(node);
                let far = squared_distance(from, to).sqrt()
                    > MAX_SHIFT * lattice.nominal_distance_at(from);
                if far || box_sides(from, lattice.extent) != box_sides(to, lattice.extent) {
                    let number = Some(node);
                    all.push(one(Action::Remove { node }, &[from]));
                    all.push(one(Action::Insert { target: to, number }, &[to]));
                } else {
                    all.push(one(Action::Shift { node, target: to }, &[from, to]));
                }
            }
            (_, Some(to)) => all.push(one(
                Action::Insert {
                    target: to,
                    number: None,
                },
                &[to],
            )),
            (_, None) => {}
        }
    }
    Ok(merge_groups(all))
}

/// The square of the distance between two positions.
pub fn squared_distance<const D: usize>(x: [f64; D], y: [f64; D]) -> f64 {
    (0..D).map(|k| (x[k] - y[k]).powi(2)).sum()
}

/// The sides of the box on which a position lies: two bits an axis.
pub fn box_sides<const D: usize>(x: [f64; D], extent: [f64; D]) -> u32 {
    let bits = |k: usize| u32::from(x[k] <= 0.0) | u32::from(x[k] >= extent[k]) << 1;
    (0..D).fold(0, |all, k| all | bits(k) << (2 * k))
}

/// Atoms must exist, be no corners, and be edited once.
fn check_atoms<const D: usize>(lattice: &EditLattice<'_, D>, edits: &[Edit<D>]) -> Result<()> {
    let mut seen: Vec<(u32, &str)> = Vec::new();
    for edit in edits {
        let (AtomChange::Move(node, _) | AtomChange::Remove(node)) = edit.change else {
            continue;
        };
        let refuse =
            |problem: String, remedy: &str| Err(Error::Mesh(cause(&edit.name, problem, remedy)));
        let count = lattice.nodes.len();
        if node as usize >= count {
            return refuse(
                format!(
                    "{} has no atom {node}: they are 0 to {}",
                    lattice.place,
                    count - 1
                ),
                match lattice.alignment {
                    Alignment::OnFeatures => {
                        "give the number of a point of the mesh, as ParaView shows it"
                    }
                    Alignment::AlongsideFeatures => {
                        "give the number of a cell of the mesh, as ParaView shows it"
                    }
                },
            );
        }
        if side_count(lattice.nodes[node as usize], lattice.extent) == D {
            return refuse(
                format!("atom {node} is a corner of the box, which the mesh must fill"),
                "give another atom",
            );
        }
        if let Some((_, other)) = seen.iter().find(|(other, _)| *other == node) {
            return refuse(
                format!("atom {node} is also edited by {other}"),
                "keep one of the two",
            );
        }
        seen.push((node, &edit.name));
    }
    Ok(())
}

/// Where atoms come or are moved to, in lattice space: in the box, on its sides exactly, and not at the
/// place of another atom that stays.
fn target_positions<const D: usize>(
    lattice: &EditLattice<'_, D>,
    edits: &[Edit<D>],
) -> Result<Vec<Option<[f64; D]>>> {
    let target = |edit: &Edit<D>| match edit.change {
        AtomChange::Add(position) | AtomChange::Move(_, position) => Some(position),
        AtomChange::Remove(_) => None,
    };
    let placed: Vec<(usize, FixedAtom<D>)> = (edits.iter().enumerate())
        .filter_map(|(n, edit)| {
            let name = edit.name.clone();
            target(edit).map(|position| (n, FixedAtom { name, position }))
        })
        .collect();
    let points: Vec<FixedAtom<D>> = placed.iter().map(|(_, point)| point.clone()).collect();
    let points = lattice_points(&points, lattice.geometry, lattice.step, lattice.extent)?;
    let least = lattice
        .distance
        .iter()
        .copied()
        .fold(f32::INFINITY, f32::min);
    let least = Distance::Constant(f64::from(least));
    let points = fixed_atoms::validate(&points, lattice.extent, &least, lattice.alignment)?;
    let leaves = |node: usize| {
        let of = |edit: &Edit<D>| match edit.change {
            AtomChange::Move(n, _) | AtomChange::Remove(n) => n as usize == node,
            AtomChange::Add(_) => false,
        };
        edits.iter().any(of)
    };
    let mut targets = vec![None; edits.len()];
    for ((number, point), to) in placed.iter().zip(points) {
        let same = 1e-6 * lattice.nominal_distance_at(to);
        for (node, &x) in lattice.nodes.iter().enumerate() {
            let stays =
                lattice.kinds[node] == AtomKind::Fixed || side_count(x, lattice.extent) == D;
            if stays && squared_distance(x, to) <= same * same && !leaves(node) {
                return Err(Error::Seeding(cause(
                    &point.name,
                    format!("is at the place of atom {node}, which stays where it is"),
                    "give another place, or move or remove that atom",
                )));
            }
        }
        targets[*number] = Some(to);
    }
    Ok(targets)
}

/// Unites groups whose neighbourhoods may meet.
fn merge_groups<const D: usize>(mut all: Vec<EditGroup<D>>) -> Vec<EditGroup<D>> {
    let meet = |a: &EditGroup<D>, b: &EditGroup<D>| {
        let near = |(x, d): &([f64; D], f64)| {
            let reach = |e: f64| INFLUENCE_RADIUS * (d + e);
            b.edited_places
                .iter()
                .any(|&(y, e)| squared_distance(*x, y) < reach(e).powi(2))
        };
        a.edited_places.iter().any(near)
    };
    let mut groups: Vec<EditGroup<D>> = Vec::new();
    while let Some(mut group) = (!all.is_empty()).then(|| all.remove(0)) {
        // Whatever meets what has been united may meet another, too.
        while let Some(other) = all.iter().position(|other| meet(&group, other)) {
            let other = all.remove(other);
            group.steps.extend(other.steps);
            group.edited_places.extend(other.edited_places);
        }
        groups.push(group);
    }
    groups
}
