//! Converts the user's edits into changes of the lattice: checks them, and sorts them into groups
//! whose neighbourhoods do not overlap.

use super::{AtomChange, Edit};
use crate::error::cause;
use crate::geometry::distance2;
use crate::image::Geometry;
use crate::job::{FixedAtom, lattice_points};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::{Alignment, fixed_atoms, kind_at, side_count};
use crate::{Error, Result};

/// The atoms of a mesh before any edit.
#[derive(Debug, Clone, Copy)]
pub struct EditLattice<'a, const D: usize> {
    /// Name of the mesh in error messages.
    pub place: &'a str,
    /// Positions of the atoms in lattice space.
    pub nodes: &'a [[f64; D]],
    /// Kind of each atom: how it may move.
    pub kinds: &'a [AtomKind],
    /// Nominal distance d at each atom.
    pub distance: &'a [f32],
    /// Far corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis.
    pub step: [f64; D],
    /// Map from sample indices to physical coordinates.
    pub geometry: &'a Geometry<D>,
    /// Position of the atoms relative to features: with `OnFeatures` atoms are the nodes of the
    /// mesh, with `AlongsideFeatures` they are the sites of cells.
    pub alignment: Alignment,
}

impl<const D: usize> EditLattice<'_, D> {
    /// Returns the nominal distance at the atom nearest to `x`.
    pub fn nominal_distance_at(&self, x: [f64; D]) -> f64 {
        let distances2 = self.nodes.iter().map(|y| distance2(&x, y));
        let nearest =
            distances2
                .zip(self.distance)
                .fold((f64::INFINITY, 0.0), |best, (square, &d)| {
                    if square < best.0 { (square, d) } else { best }
                });
        f64::from(nearest.1)
    }
}

/// A change of the lattice; positions are in lattice space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action<const D: usize> {
    /// Removes an atom.
    Remove {
        /// Number of the atom.
        node: u32,
    },
    /// Inserts an atom.
    Insert {
        /// Position of the new atom.
        target: [f64; D],
        /// Number that the atom is to have, if it is an existing atom that moves far.
        number: Option<u32>,
    },
    /// Shifts an atom by less than [`MAX_SHIFT`].
    Shift {
        /// Number of the atom.
        node: u32,
        /// New position of the atom.
        target: [f64; D],
    },
}

/// An action, with the edit that it belongs to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EditStep<const D: usize> {
    /// The change of the lattice.
    pub action: Action<D>,
    /// Index of the edit.
    pub edit: usize,
    /// Kind of the inserted or shifted atom.
    pub kind: AtomKind,
}

/// Steps whose neighbourhoods overlap.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EditGroup<const D: usize> {
    /// The steps of the group.
    pub steps: Vec<EditStep<D>>,
    /// All positions where an atom is inserted, removed or moved from or to, each with d there.
    pub edited_places: Vec<([f64; D], f64)>,
}

/// Largest distance, in units of d, over which an atom is shifted. Over larger distances it is
/// removed and inserted again.
const MAX_SHIFT: f64 = 0.7;

/// Radius, in units of d, within which an edit depends on the mesh and the image: warm atoms are
/// within 5 d, their cells within 1.7 d more, and the atoms that interact with warm atoms are not
/// farther.
pub const INFLUENCE_RADIUS: f64 = 7.5;

/// Checks the edits and sorts them into groups. With `free`, inserted and moved atoms are not
/// fixed.
///
/// # Errors
/// Returns [`Error::Mesh`] if an atom does not exist, is edited twice or is a corner of the box;
/// [`Error::Seeding`] if a position is outside the box or that of another atom.
pub fn resolve<const D: usize>(
    lattice: &EditLattice<'_, D>,
    edits: &[Edit<D>],
    free: bool,
) -> Result<Vec<EditGroup<D>>> {
    check_atoms(lattice, edits)?;
    let targets = target_positions(lattice, edits)?;
    let mut groups = Vec::new();
    for (number, (edit, target)) in edits.iter().zip(targets).enumerate() {
        let step = |action| EditStep {
            action,
            edit: number,
            kind: match target {
                Some(position) if free => kind_at(position, lattice.extent),
                _ => AtomKind::Fixed,
            },
        };
        let node_position = |node: u32| lattice.nodes[node as usize];
        let group = |action, places: &[[f64; D]]| EditGroup {
            steps: vec![step(action)],
            edited_places: (places.iter())
                .map(|&x| (x, lattice.nominal_distance_at(x)))
                .collect(),
        };
        match (edit.change, target) {
            (AtomChange::Remove(node), _) => {
                groups.push(group(Action::Remove { node }, &[node_position(node)]))
            }
            (AtomChange::Move(node, _), Some(position)) => {
                let old_position = node_position(node);
                let is_far = distance2(&old_position, &position).sqrt()
                    > MAX_SHIFT * lattice.nominal_distance_at(old_position);
                if is_far
                    || box_sides(old_position, lattice.extent)
                        != box_sides(position, lattice.extent)
                {
                    let number = Some(node);
                    groups.push(group(Action::Remove { node }, &[old_position]));
                    groups.push(group(
                        Action::Insert {
                            target: position,
                            number,
                        },
                        &[position],
                    ));
                } else {
                    groups.push(group(
                        Action::Shift {
                            node,
                            target: position,
                        },
                        &[old_position, position],
                    ));
                }
            }
            (_, Some(position)) => groups.push(group(
                Action::Insert {
                    target: position,
                    number: None,
                },
                &[position],
            )),
            (_, None) => {}
        }
    }
    Ok(merge_groups(groups))
}

/// Returns the sides of the box on which a position lies, as two bits per axis (low and high side).
pub fn box_sides<const D: usize>(x: [f64; D], extent: [f64; D]) -> u32 {
    let bits = |k: usize| u32::from(x[k] <= 0.0) | u32::from(x[k] >= extent[k]) << 1;
    (0..D).fold(0, |sides, k| sides | bits(k) << (2 * k))
}

/// Checks that the edited atoms exist, are not corners of the box, and are edited only once.
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
                    "{} has no atom {node}: its atoms are numbered 0 to {}",
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

/// Returns, for each edit, the position in lattice space where its atom is put; `None` for
/// removals. Checks that the positions are in the box and not at the place of an atom that stays,
/// and moves those near a side exactly onto it.
fn target_positions<const D: usize>(
    lattice: &EditLattice<'_, D>,
    edits: &[Edit<D>],
) -> Result<Vec<Option<[f64; D]>>> {
    let requested_position = |edit: &Edit<D>| match edit.change {
        AtomChange::Add(position) | AtomChange::Move(_, position) => Some(position),
        AtomChange::Remove(_) => None,
    };
    let placed: Vec<(usize, FixedAtom<D>)> = (edits.iter().enumerate())
        .filter_map(|(n, edit)| {
            let name = edit.name.clone();
            requested_position(edit).map(|position| (n, FixedAtom { name, position }))
        })
        .collect();
    let points: Vec<FixedAtom<D>> = placed.iter().map(|(_, point)| point.clone()).collect();
    let points = lattice_points(&points, lattice.geometry, lattice.step, lattice.extent)?;
    let min_distance = lattice
        .distance
        .iter()
        .copied()
        .fold(f32::INFINITY, f32::min);
    let min_distance = Distance::Constant(f64::from(min_distance));
    let points = fixed_atoms::validate(&points, lattice.extent, &min_distance, lattice.alignment)?;
    let is_vacated = |node: usize| {
        let concerns_node = |edit: &Edit<D>| match edit.change {
            AtomChange::Move(n, _) | AtomChange::Remove(n) => n as usize == node,
            AtomChange::Add(_) => false,
        };
        edits.iter().any(concerns_node)
    };
    let mut targets = vec![None; edits.len()];
    for ((number, point), position) in placed.iter().zip(points) {
        let tolerance = 1e-6 * lattice.nominal_distance_at(position);
        for (node, &x) in lattice.nodes.iter().enumerate() {
            let is_immovable =
                lattice.kinds[node] == AtomKind::Fixed || side_count(x, lattice.extent) == D;
            if is_immovable
                && distance2(&x, &position) <= tolerance * tolerance
                && !is_vacated(node)
            {
                return Err(Error::Seeding(cause(
                    &point.name,
                    format!("is at the place of atom {node}, which stays where it is"),
                    "give another place, or move or remove that atom",
                )));
            }
        }
        targets[*number] = Some(position);
    }
    Ok(targets)
}

/// Merges groups whose neighbourhoods may overlap.
fn merge_groups<const D: usize>(mut pending: Vec<EditGroup<D>>) -> Vec<EditGroup<D>> {
    let meet = |a: &EditGroup<D>, b: &EditGroup<D>| {
        let is_close = |(x, d): &([f64; D], f64)| {
            let reach = |e: f64| INFLUENCE_RADIUS * (d + e);
            b.edited_places
                .iter()
                .any(|(y, e)| distance2(x, y) < reach(*e).powi(2))
        };
        a.edited_places.iter().any(is_close)
    };
    let mut groups: Vec<EditGroup<D>> = Vec::new();
    while let Some(mut group) = (!pending.is_empty()).then(|| pending.remove(0)) {
        // The merged group may overlap groups that did not overlap the first one.
        while let Some(other) = pending.iter().position(|other| meet(&group, other)) {
            let other = pending.remove(other);
            group.steps.extend(other.steps);
            group.edited_places.extend(other.edited_places);
        }
        groups.push(group);
    }
    groups
}
