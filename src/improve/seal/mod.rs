//! Surfaces without holes: the faces that close what improvement could not.
//!
//! Where the mesh could not follow a sheet, cells straddle it, and its faces leave a hole through which
//! everything flows. But which side of the sheet a cell is on, its centroid tells, and that is one
//! number for each cell and sheet: so the faces between cells on different sides have no rim but where
//! the sheet itself has one. Of these faces those are taken that close a hole: those that hang over a
//! rim (at the tip of a fault; across a hole that the image shows) are taken off again.
//!
//! - `surface`: marked faces, and the rooms between them
//! - `pieces`: the same where nobody holds the whole mesh
//! - `near`: the cells of such a mesh that all look at

mod near;
mod pieces;
mod surface;

use std::collections::{BTreeMap, HashMap};
use std::convert::Infallible;

use crate::parallel::prelude::*;

use super::sheets::{NearSheets, SAME_SHEET, Sheets};
use crate::feature::FeaturePoint;
use crate::geometry::sets::Sets;
use crate::geometry::{dot, in_space, norm, sub};
use crate::lattice::distance::Distance;
use crate::mesh::Simplices;
use crate::mesh::complex::BEYOND;
use crate::observer::Patience;

pub use pieces::seal_pieces;
use surface::{Opened, Ridge, Surface, Way};

/// Radius of the patches that tell on which side a cell is, in units of d; and least and largest. In the plane
/// a patch holds fewer points.
const PATCH: f64 = 0.8;
const PATCH_OF_CURVE: f64 = 1.2;
const RADII: [f64; 2] = [2.5, 6.5];
/// Patches of surfaces wider than this have points enough if every second one is taken.
const DENSE: f64 = 4.5;

/// Two cells see the same sheet if one's plane is this little off at the other, in units of their distance.
const ONE_SHEET: f64 = 0.35;

/// Smaller rooms between faces, in units of d^D, are none.
const POCKET: f64 = 0.5;

/// The radius of patches where the lattice has spacing d.
fn radius_at<const D: usize>(d: f64) -> f64 {
    let patch = if D == 2 { PATCH_OF_CURVE } else { PATCH };
    (patch * d).clamp(RADII[0], RADII[1])
}

/// What was closed.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct Sealed {
    /// Faces added.
    pub faces: usize,
    /// Their area (length in the plane).
    pub area: f64,
    /// Pockets of a few cells between these faces and others that were opened.
    pub pockets: usize,
    /// Rooms into which the faces on features part the mesh: cells between which a way leads through
    /// other faces are in one room.
    pub rooms: usize,
}

/// Adds to the marked faces of a mesh (`marks`: bit k of a cell for its face k) those that close holes
/// in the sheets of `points`, and marks every face on both of its sides.
///
/// `neighbors` has for every cell and face, in order, the cell beyond, or `NONE`.
pub fn seal<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    points: &[FeaturePoint<3>],
    extent: [f64; D],
    distance: &Distance<D>,
    marks: &mut [u8],
    patience: &Patience<'_>,
) -> Sealed {
    let sheets = local_planes(points, extent, distance);
    let surface = Surface {
        mesh,
        neighbors,
        marks,
    };
    let mut sealing = Sealing::new(surface, &sheets, distance);
    sealing.surface.mark_both_sides();
    let over = || Ok::<_, Infallible>(patience.over());
    let Ok(()) = sealing.grow(over, |sealing, cells| Ok(sealing.seen_from(&cells)));
    sealing.peel();
    let (room, volume) = sealing.surface.rooms();
    let rooms = |&face: &u32| {
        let cells = [face / (D as u32 + 1), neighbors[face as usize]];
        cells.map(|c| room[c as usize])
    };
    let beside: Vec<[u32; 2]> = sealing.fresh.iter().map(rooms).collect();
    let opened = sealing.pockets(&volume, &beside);
    sealing.surface.open(&opened, |c| room[c as usize]);
    sealing.sealed(&opened, &beside, volume.len())
}

/// The features as local planes.
fn local_planes<const D: usize>(
    points: &[FeaturePoint<3>],
    extent: [f64; D],
    distance: &Distance<D>,
) -> Sheets {
    let radius = radius_at::<D>(distance.max());
    Sheets::new(points, in_space(extent), radius, radius)
}

/// What closes holes in a mesh, or in a part of one: what of it is needed but not here is noted.
struct Sealing<'a, const D: usize, M> {
    surface: Surface<'a, D, M>,
    sheets: &'a Sheets,
    distance: &'a Distance<D>,
    /// The sheets near the centroids of cells, as far as they have been looked at.
    sides: HashMap<u32, NearSheets>,
    /// Faces that may close holes, by the smaller of their two numbers.
    fresh: Vec<u32>,
    /// How many faces, marked or fresh, meet at the ridges of those.
    on: HashMap<Ridge, u32>,
    /// Nodes of ridges of fresh faces round which some cells are not here.
    missed: Vec<u32>,
}

impl<'a, const D: usize, M: Simplices<D>> Sealing<'a, D, M> {
    fn new(surface: Surface<'a, D, M>, sheets: &'a Sheets, distance: &'a Distance<D>) -> Self {
        Self {
            surface,
            sheets,
            distance,
            sides: HashMap::new(),
            fresh: Vec::new(),
            on: HashMap::new(),
            missed: Vec::new(),
        }
    }

    /// Whether a surface may end at a ridge of cell c: on the outside of the mesh.
    fn may_end(&self, c: u32, ridge: Ridge) -> bool {
        self.surface.round(c, ridge, |_| ()) != Way::Closes
    }

    fn centroid(&self, c: u32) -> [f64; 3] {
        let mesh = self.surface.mesh;
        let nodes = mesh
            .cell(c as usize)
            .iter()
            .map(|&n| mesh.nodes()[n as usize]);
        in_space(nodes.fold([0.0; D], |sum, x| {
            std::array::from_fn(|k| sum[k] + x[k] / (D + 1) as f64)
        }))
    }

    /// The sheets near the centroid of a cell.
    fn near(&self, c: u32) -> NearSheets {
        let radius = radius_at::<D>(self.spacing(c));
        let every_second = D == 3 && radius > DENSE;
        self.sheets
            .near_within(self.centroid(c), radius, every_second)
    }

    /// The same of some cells.
    fn seen_from(&self, cells: &[u32]) -> Vec<(u32, NearSheets)> {
        cells.par_iter().map(|&c| (c, self.near(c))).collect()
    }

    /// Whether a sheet passes between two cells.
    fn parted(&self, a: u32, b: u32) -> bool {
        let (Some(near_a), Some(near_b)) = (self.sides.get(&a), self.sides.get(&b)) else {
            return false;
        };
        let way = sub(self.centroid(b), self.centroid(a));
        let far = norm(way);
        near_a.iter().any(|here| {
            near_b.iter().any(|there| {
                let same = dot(here.normal, there.normal);
                // How far b is off the sheet, as it is known there, and as a's plane has it.
                let off = there.offset * same.signum();
                let foreseen = here.offset + dot(way, here.normal);
                same.abs() > SAME_SHEET
                    && (here.offset < 0.0) != (off < 0.0)
                    && (foreseen - off).abs() < ONE_SHEET * far
            })
        })
    }

    /// The faces that part cells on different sides of a sheet, from the rims of what is marked on,
    /// until it is `over`; `look` tells which sheets are near some cells.
    fn grow<E>(
        &mut self,
        over: impl Fn() -> std::result::Result<bool, E>,
        look: impl Fn(&Self, Vec<u32>) -> std::result::Result<Vec<(u32, NearSheets)>, E>,
    ) -> std::result::Result<(), E> {
        let n = D as u32 + 1;
        let mut count: HashMap<Ridge, u32> = HashMap::new();
        let marked = self.surface.marked_once();
        for &face in &marked {
            for ridge in self.surface.ridges(face) {
                *count.entry(ridge).or_default() += 1;
            }
        }
        let mut next = Vec::new();
        for &face in &marked {
            for ridge in self.surface.ridges(face) {
                if count[&ridge] == 1 {
                    let before = next.len();
                    // Where it does not close, the surface ends in a side; or there is no rim: all that
                    // is round rims is here.
                    let way = self.surface.round(face / n, ridge, |c| next.push(c));
                    if way != Way::Closes {
                        next.truncate(before);
                    }
                }
            }
        }
        self.on = count;
        let mut known = vec![false; self.surface.mesh.len()];
        while !next.is_empty() && !over()? {
            let mut cells = std::mem::take(&mut next);
            cells.sort_unstable();
            cells.dedup();
            cells.retain(|&c| !std::mem::replace(&mut known[c as usize], true));
            let unseen = cells.iter().filter(|c| !self.sides.contains_key(*c));
            self.sides.extend(look(self, unseen.copied().collect())?);
            for &c in &cells {
                for face in n * c..n * (c + 1) {
                    let beyond = self.surface.neighbors[face as usize];
                    // Of two that are new, the second sees the first.
                    let seen = beyond < BEYOND && known[beyond as usize];
                    let twice = seen && beyond > c && cells.binary_search(&beyond).is_ok();
                    if !seen || twice || self.surface.marked(face) || !self.parted(c, beyond) {
                        continue;
                    }
                    let twin = self.surface.twin(face).unwrap_or(face);
                    self.fresh.push(face.min(twin));
                    for ridge in self.surface.ridges(face) {
                        *self.on.entry(ridge).or_default() += 1;
                        if self.surface.round(c, ridge, |c| next.push(c)) == Way::Leaves {
                            self.missed.extend(ridge);
                        }
                    }
                }
            }
        }
        self.fresh.sort_unstable();
        Ok(())
    }

    /// Takes off fresh faces that hang over a rim.
    fn peel(&mut self) {
        let mut at: HashMap<Ridge, Vec<u32>> = HashMap::new();
        for &face in &self.fresh {
            for ridge in self.surface.ridges(face) {
                at.entry(ridge).or_default().push(face);
            }
        }
        let mut gone = vec![false; self.fresh.len()];
        let mut queue = self.fresh.clone();
        while let Some(face) = queue.pop() {
            let Ok(place) = self.fresh.binary_search(&face) else {
                continue;
            };
            let ridges: Vec<Ridge> = self.surface.ridges(face).collect();
            let cell = face / (D as u32 + 1);
            let hangs = |ridge: &Ridge| self.on[ridge] == 1 && !self.may_end(cell, *ridge);
            if gone[place] || !ridges.iter().any(hangs) {
                continue;
            }
            gone[place] = true;
            for ridge in ridges {
                if let Some(on) = self.on.get_mut(&ridge) {
                    *on -= 1;
                }
                queue.extend(at[&ridge].iter().filter(|&&f| f != face));
            }
        }
        let mut left = gone.iter();
        self.fresh
            .retain(|_| !left.next().is_some_and(|gone| *gone));
        for i in 0..self.fresh.len() {
            self.surface.mark(self.fresh[i], true);
        }
    }

    /// Pockets that fresh faces have made, each with the room with which it shares most of their area: they
    /// are to be opened. `volume` is that of each room, and `beside` has the rooms on both sides of each
    /// fresh face.
    fn pockets(&self, volume: &[f64], beside: &[[u32; 2]]) -> Opened {
        // For each pocket and room beside it, the area of the fresh faces between them.
        let mut between: BTreeMap<u32, BTreeMap<u32, f64>> = BTreeMap::new();
        for (&face, &[r, s]) in self.fresh.iter().zip(beside) {
            let d = self.spacing(face / (D as u32 + 1));
            for (own, other) in [(r, s), (s, r)] {
                if r != s && volume[own as usize] < POCKET * d.powi(D as i32) {
                    let areas = between.entry(own).or_default();
                    *areas.entry(other).or_default() += self.surface.area(face);
                }
            }
        }
        let mut joined = Sets::new(volume.len());
        let mut opened = Vec::new();
        for (pocket, areas) in between {
            let larger = |best: (u32, f64), (&other, &area): (&u32, &f64)| {
                if area > best.1 { (other, area) } else { best }
            };
            let (other, _) = areas.iter().fold((pocket, 0.0), larger);
            if joined.find(pocket) != joined.find(other) {
                joined.unite(pocket, other);
                opened.push([pocket, other]);
            }
        }
        Opened::new(opened)
    }

    /// The lattice's spacing at a cell.
    fn spacing(&self, c: u32) -> f64 {
        let mesh = self.surface.mesh;
        self.distance
            .at(mesh.nodes()[mesh.cell(c as usize)[0] as usize])
    }

    /// What is closed once pockets are opened; `beside` has the rooms on both sides of each fresh face, and
    /// there were so many.
    fn sealed(&self, opened: &Opened, beside: &[[u32; 2]], rooms: usize) -> Sealed {
        let fresh = self.fresh.iter().zip(beside);
        let left = fresh.filter(|(_, beside)| !opened.between(**beside));
        Sealed {
            faces: left.clone().count(),
            area: left.map(|(&face, _)| self.surface.area(face)).sum(),
            pockets: opened.count(),
            rooms: rooms - opened.count(),
        }
    }
}

#[cfg(test)]
mod tests;
