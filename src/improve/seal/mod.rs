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

mod distributed;
mod gathered_cells;
mod surface;

use std::collections::{BTreeMap, HashMap};
use std::convert::Infallible;

use crate::parallel::prelude::*;

use super::feature_planes::{FeaturePlanes, NearbyPlanes, SAME_SURFACE_COSINE};
use crate::feature::FeaturePoint;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{dot, norm, sub, to_3d};
use crate::lattice::distance::Distance;
use crate::mesh::Simplices;
use crate::mesh::complex::NOT_LOCAL;
use crate::progress::CancelToken;

pub use distributed::seal_distributed;
use surface::{CompartmentPairs, MarkedSurface, Ridge, RidgeFan};

/// Radius of the patches that tell on which side a cell is, in units of d; and least and largest. In the plane
/// a patch holds fewer points.
const PATCH_RADIUS: f64 = 0.8;
const CURVE_PATCH_RADIUS: f64 = 1.2;
const PATCH_RADIUS_RANGE: [f64; 2] = [2.5, 6.5];
/// Patches of surfaces wider than this have points enough if every second one is taken.
const MIN_DENSE_RADIUS: f64 = 4.5;

/// Two cells see the same sheet if one's plane is this little off at the other, in units of their distance.
const SAME_SURFACE_SLOPE: f64 = 0.35;

/// Smaller rooms between faces, in units of d^D, are none.
const MIN_COMPARTMENT_VOLUME: f64 = 0.5;

/// The radius of patches where the lattice has spacing d.
fn radius_at<const D: usize>(d: f64) -> f64 {
    let patch = if D == 2 {
        CURVE_PATCH_RADIUS
    } else {
        PATCH_RADIUS
    };
    (patch * d).clamp(PATCH_RADIUS_RANGE[0], PATCH_RADIUS_RANGE[1])
}

/// What was closed.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct SealReport {
    /// Faces added.
    pub faces: usize,
    /// Their area (length in the plane).
    pub area: f64,
    /// Pockets of a few cells between these faces and others that were opened.
    pub pockets: usize,
    /// Rooms into which the faces on features part the mesh: cells between which a way leads through
    /// other faces are in one room.
    pub compartments: usize,
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
    patience: &CancelToken<'_>,
) -> SealReport {
    let sheets = local_planes(points, extent, distance);
    let surface = MarkedSurface {
        mesh,
        neighbors,
        marks,
    };
    let mut sealing = Sealer::new(surface, &sheets, distance);
    sealing.surface.mark_both_sides();
    let over = || Ok::<_, Infallible>(patience.is_cancelled());
    let Ok(()) = sealing.grow(over, |sealing, cells| Ok(sealing.planes_near_cells(&cells)));
    sealing.remove_overhangs();
    let (room, volume) = sealing.surface.compartments();
    let rooms = |&face: &u32| {
        let cells = [face / (D as u32 + 1), neighbors[face as usize]];
        cells.map(|c| room[c as usize])
    };
    let beside: Vec<[u32; 2]> = sealing.new_faces.iter().map(rooms).collect();
    let opened = sealing.find_pockets(&volume, &beside);
    sealing
        .surface
        .unmark_between(&opened, |c| room[c as usize]);
    sealing.report(&opened, &beside, volume.len())
}

/// The features as local planes.
fn local_planes<const D: usize>(
    points: &[FeaturePoint<3>],
    extent: [f64; D],
    distance: &Distance<D>,
) -> FeaturePlanes {
    let radius = radius_at::<D>(distance.max());
    FeaturePlanes::new(points, to_3d(extent), radius, radius)
}

/// What closes holes in a mesh, or in a part of one: what of it is needed but not here is noted.
struct Sealer<'a, const D: usize, M> {
    surface: MarkedSurface<'a, D, M>,
    planes: &'a FeaturePlanes,
    distance: &'a Distance<D>,
    /// The sheets near the centroids of cells, as far as they have been looked at.
    cell_planes: HashMap<u32, NearbyPlanes>,
    /// Faces that may close holes, by the smaller of their two numbers.
    new_faces: Vec<u32>,
    /// How many faces, marked or fresh, meet at the ridges of those.
    faces_at_ridge: HashMap<Ridge, u32>,
    /// Nodes of ridges of fresh faces round which some cells are not here.
    incomplete_nodes: Vec<u32>,
}

impl<'a, const D: usize, M: Simplices<D>> Sealer<'a, D, M> {
    fn new(
        surface: MarkedSurface<'a, D, M>,
        planes: &'a FeaturePlanes,
        distance: &'a Distance<D>,
    ) -> Self {
        Self {
            surface,
            planes,
            distance,
            cell_planes: HashMap::new(),
            new_faces: Vec::new(),
            faces_at_ridge: HashMap::new(),
            incomplete_nodes: Vec::new(),
        }
    }

    /// Whether a surface may end at a ridge of cell c: on the outside of the mesh.
    fn may_end(&self, c: u32, ridge: Ridge) -> bool {
        self.surface.visit_ridge_cells(c, ridge, |_| ()) != RidgeFan::Closed
    }

    fn centroid(&self, c: u32) -> [f64; 3] {
        let mesh = self.surface.mesh;
        let nodes = mesh
            .cell(c as usize)
            .iter()
            .map(|&n| mesh.nodes()[n as usize]);
        to_3d(nodes.fold([0.0; D], |sum, x| {
            std::array::from_fn(|k| sum[k] + x[k] / (D + 1) as f64)
        }))
    }

    /// The sheets near the centroid of a cell.
    fn planes_near(&self, c: u32) -> NearbyPlanes {
        let radius = radius_at::<D>(self.spacing(c));
        let every_second = D == 3 && radius > MIN_DENSE_RADIUS;
        self.planes
            .planes_within(self.centroid(c), radius, every_second)
    }

    /// The same of some cells.
    fn planes_near_cells(&self, cells: &[u32]) -> Vec<(u32, NearbyPlanes)> {
        cells
            .par_iter()
            .map(|&c| (c, self.planes_near(c)))
            .collect()
    }

    /// Whether a sheet passes between two cells.
    fn are_separated(&self, a: u32, b: u32) -> bool {
        let (Some(near_a), Some(near_b)) = (self.cell_planes.get(&a), self.cell_planes.get(&b))
        else {
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
                same.abs() > SAME_SURFACE_COSINE
                    && (here.offset < 0.0) != (off < 0.0)
                    && (foreseen - off).abs() < SAME_SURFACE_SLOPE * far
            })
        })
    }

    /// The faces that part cells on different sides of a sheet, from the rims of what is marked on,
    /// until it is `over`; `look` tells which sheets are near some cells.
    fn grow<E>(
        &mut self,
        over: impl Fn() -> std::result::Result<bool, E>,
        look: impl Fn(&Self, Vec<u32>) -> std::result::Result<Vec<(u32, NearbyPlanes)>, E>,
    ) -> std::result::Result<(), E> {
        let n = D as u32 + 1;
        let mut count: HashMap<Ridge, u32> = HashMap::new();
        let marked = self.surface.unique_marked_faces();
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
                    let way = self
                        .surface
                        .visit_ridge_cells(face / n, ridge, |c| next.push(c));
                    if way != RidgeFan::Closed {
                        next.truncate(before);
                    }
                }
            }
        }
        self.faces_at_ridge = count;
        let mut known = vec![false; self.surface.mesh.len()];
        while !next.is_empty() && !over()? {
            let mut cells = std::mem::take(&mut next);
            cells.sort_unstable();
            cells.dedup();
            cells.retain(|&c| !std::mem::replace(&mut known[c as usize], true));
            let unseen = cells.iter().filter(|c| !self.cell_planes.contains_key(*c));
            self.cell_planes
                .extend(look(self, unseen.copied().collect())?);
            for &c in &cells {
                for face in n * c..n * (c + 1) {
                    let beyond = self.surface.neighbors[face as usize];
                    // Of two that are new, the second sees the first.
                    let seen = beyond < NOT_LOCAL && known[beyond as usize];
                    let twice = seen && beyond > c && cells.binary_search(&beyond).is_ok();
                    if !seen
                        || twice
                        || self.surface.is_marked(face)
                        || !self.are_separated(c, beyond)
                    {
                        continue;
                    }
                    let twin = self.surface.twin(face).unwrap_or(face);
                    self.new_faces.push(face.min(twin));
                    for ridge in self.surface.ridges(face) {
                        *self.faces_at_ridge.entry(ridge).or_default() += 1;
                        if self.surface.visit_ridge_cells(c, ridge, |c| next.push(c))
                            == RidgeFan::NotLocal
                        {
                            self.incomplete_nodes.extend(ridge);
                        }
                    }
                }
            }
        }
        self.new_faces.sort_unstable();
        Ok(())
    }

    /// Takes off fresh faces that hang over a rim.
    fn remove_overhangs(&mut self) {
        let mut at: HashMap<Ridge, Vec<u32>> = HashMap::new();
        for &face in &self.new_faces {
            for ridge in self.surface.ridges(face) {
                at.entry(ridge).or_default().push(face);
            }
        }
        let mut gone = vec![false; self.new_faces.len()];
        let mut queue = self.new_faces.clone();
        while let Some(face) = queue.pop() {
            let Ok(place) = self.new_faces.binary_search(&face) else {
                continue;
            };
            let ridges: Vec<Ridge> = self.surface.ridges(face).collect();
            let cell = face / (D as u32 + 1);
            let hangs =
                |ridge: &Ridge| self.faces_at_ridge[ridge] == 1 && !self.may_end(cell, *ridge);
            if gone[place] || !ridges.iter().any(hangs) {
                continue;
            }
            gone[place] = true;
            for ridge in ridges {
                if let Some(on) = self.faces_at_ridge.get_mut(&ridge) {
                    *on -= 1;
                }
                queue.extend(at[&ridge].iter().filter(|&&f| f != face));
            }
        }
        let mut left = gone.iter();
        self.new_faces
            .retain(|_| !left.next().is_some_and(|gone| *gone));
        for i in 0..self.new_faces.len() {
            self.surface.set_mark(self.new_faces[i], true);
        }
    }

    /// Pockets that fresh faces have made, each with the room with which it shares most of their area: they
    /// are to be opened. `volume` is that of each room, and `beside` has the rooms on both sides of each
    /// fresh face.
    fn find_pockets(&self, volume: &[f64], beside: &[[u32; 2]]) -> CompartmentPairs {
        // For each pocket and room beside it, the area of the fresh faces between them.
        let mut between: BTreeMap<u32, BTreeMap<u32, f64>> = BTreeMap::new();
        for (&face, &[r, s]) in self.new_faces.iter().zip(beside) {
            let d = self.spacing(face / (D as u32 + 1));
            for (own, other) in [(r, s), (s, r)] {
                if r != s && volume[own as usize] < MIN_COMPARTMENT_VOLUME * d.powi(D as i32) {
                    let areas = between.entry(own).or_default();
                    *areas.entry(other).or_default() += self.surface.face_area(face);
                }
            }
        }
        let mut joined = UnionFind::new(volume.len());
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
        CompartmentPairs::new(opened)
    }

    /// The lattice's spacing at a cell.
    fn spacing(&self, c: u32) -> f64 {
        let mesh = self.surface.mesh;
        self.distance
            .value_at(mesh.nodes()[mesh.cell(c as usize)[0] as usize])
    }

    /// What is closed once pockets are opened; `beside` has the rooms on both sides of each fresh face, and
    /// there were so many.
    fn report(&self, opened: &CompartmentPairs, beside: &[[u32; 2]], rooms: usize) -> SealReport {
        let fresh = self.new_faces.iter().zip(beside);
        let left = fresh.filter(|(_, beside)| !opened.contains(**beside));
        SealReport {
            faces: left.clone().count(),
            area: left.map(|(&face, _)| self.surface.face_area(face)).sum(),
            pockets: opened.count(),
            compartments: rooms - opened.count(),
        }
    }
}

#[cfg(test)]
mod tests;
