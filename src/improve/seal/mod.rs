//! Surfaces without holes: the faces that close what improvement could not.
//!
//! Where the mesh could not follow a sheet, cells straddle it, and its faces leave a hole through which
//! everything flows. But which side of the sheet a cell is on, its centroid tells, and that is one
//! number for each cell and sheet: so the faces between cells on different sides have no rim but where
//! the sheet itself has one. Of these faces those are taken that close a hole: those that hang over a
//! rim (at the tip of a fault; across a hole that the image shows) are taken off again.

use std::collections::{BTreeMap, HashMap};

use rayon::prelude::*;

use super::sheets::{NearSheets, SAME_SHEET, Sheets};
use crate::feature::FeaturePoint;
use crate::geometry::sets::Sets;
use crate::geometry::{dot, in_space, norm, sub};
use crate::lattice::distance::Distance;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::observer::Patience;

/// Radius of the patches that tell on which side a cell is, in units of d; and least and largest. In the plane
/// a patch holds fewer points.
const PATCH: f64 = 0.8;
const PATCH_OF_CURVE: f64 = 1.2;
const RADII: [f64; 2] = [2.5, 6.5];
/// Patches of surfaces wider than this have points enough if every second one is taken.
const DENSE: f64 = 4.5;

/// Two cells see the same sheet if one's plane is this little off at the other, in units of their distance.
const ONE_SHEET: f64 = 0.35;

/// Cells of which volumes are reckoned in one go.
const TOGETHER: usize = 1 << 20;

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
    let radius = radius_at::<D>(distance.max());
    let sheets = Sheets::new(points, in_space(extent), radius, radius);
    let mut sealing = Sealing {
        mesh,
        neighbors,
        sheets: &sheets,
        distance,
        marks,
        sides: HashMap::new(),
        fresh: Vec::new(),
        on: HashMap::new(),
    };
    sealing.mark_both_sides();
    sealing.grow(patience);
    sealing.peel();
    let (pockets, rooms) = sealing.open_pockets();
    sealing.finish(pockets, rooms)
}

/// The nodes of a ridge, in rising order; the last is `NONE` in the plane.
type Ridge = [u32; 2];

struct Sealing<'a, const D: usize, M> {
    mesh: &'a M,
    neighbors: &'a [u32],
    sheets: &'a Sheets,
    distance: &'a Distance<D>,
    marks: &'a mut [u8],
    /// The sheets near the centroids of cells, as far as they have been looked at.
    sides: HashMap<u32, NearSheets>,
    /// Faces that may close holes, by the smaller of their two numbers.
    fresh: Vec<u32>,
    /// How many faces, marked or fresh, meet at the ridges of those.
    on: HashMap<Ridge, u32>,
}

impl<const D: usize, M: Simplices<D>> Sealing<'_, D, M> {
    /// The other number of a face, if it is inside the mesh.
    fn twin(&self, face: u32) -> Option<u32> {
        let n = D as u32 + 1;
        let beyond = self.neighbors[face as usize];
        let back = |k: &u32| self.neighbors[(n * beyond + k) as usize] == face / n;
        (beyond != NONE).then(|| n * beyond + (0..n).find(back).unwrap_or(0))
    }

    fn marked(&self, face: u32) -> bool {
        let n = D as u32 + 1;
        self.marks[(face / n) as usize] >> (face % n) & 1 == 1
    }

    fn mark(&mut self, face: u32, on: bool) {
        let n = D as u32 + 1;
        for face in [Some(face), self.twin(face)].into_iter().flatten() {
            let bits = &mut self.marks[(face / n) as usize];
            *bits = *bits & !(1 << (face % n)) | u8::from(on) << (face % n);
        }
    }

    fn mark_both_sides(&mut self) {
        for face in self.all_marked() {
            self.mark(face, true);
        }
    }

    /// The faces that are marked, from both sides.
    fn all_marked(&self) -> Vec<u32> {
        let n = D as u32 + 1;
        let of_cell = |(c, &bits): (usize, &u8)| {
            let marked = (0..n).filter(move |k| bits >> k & 1 == 1);
            marked.map(move |k| n * c as u32 + k)
        };
        let some = self
            .marks
            .par_iter()
            .enumerate()
            .filter(|(_, bits)| **bits != 0);
        some.flat_map_iter(of_cell).collect()
    }

    /// The ridge of face k of cell c that is opposite node j too.
    fn ridge(&self, c: u32, k: usize, j: usize) -> Ridge {
        let mut ridge = [NONE; 2];
        let nodes = self.mesh.cell(c as usize).iter().enumerate();
        let kept = nodes.filter(|(i, _)| *i != k && *i != j).map(|(_, &n)| n);
        ridge.iter_mut().zip(kept).for_each(|(to, n)| *to = n);
        ridge.sort_unstable();
        ridge
    }

    /// The ridges of a face.
    fn ridges(&self, face: u32) -> impl Iterator<Item = Ridge> + '_ {
        let (c, k) = (face / (D as u32 + 1), face as usize % (D + 1));
        (0..=D)
            .filter(move |&j| j != k)
            .map(move |j| self.ridge(c, k, j))
    }

    /// Runs `visit` on the cells round a ridge of cell c; whether the way round closes, as it does but
    /// on the outside of the mesh.
    fn round(&self, c: u32, ridge: Ridge, mut visit: impl FnMut(u32)) -> bool {
        let beyond = |c: u32, k: usize| self.neighbors[(D + 1) * c as usize + k];
        let beside = |c: u32| {
            let nodes = self.mesh.cell(c as usize).iter().enumerate();
            nodes
                .filter(move |(_, n)| !ridge.contains(n))
                .map(|(k, _)| k)
        };
        visit(c);
        for first in beside(c) {
            let (mut last, mut at) = (c, beyond(c, first));
            while at != NONE && at != c {
                visit(at);
                let onward = beside(at).map(|k| beyond(at, k)).find(|&n| n != last);
                (last, at) = (at, onward.unwrap_or(NONE));
            }
            if at == c {
                return true;
            }
        }
        false
    }

    /// Whether a surface may end at a ridge of cell c: on the outside of the mesh.
    fn may_end(&self, c: u32, ridge: Ridge) -> bool {
        !self.round(c, ridge, |_| ())
    }

    fn centroid(&self, c: u32) -> [f64; 3] {
        let nodes = self
            .mesh
            .cell(c as usize)
            .iter()
            .map(|&n| self.mesh.nodes()[n as usize]);
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

    /// The faces that part cells on different sides of a sheet, from the rims of what is marked on.
    fn grow(&mut self, patience: &Patience<'_>) {
        let mut count: HashMap<Ridge, u32> = HashMap::new();
        let once = |face: &u32| self.twin(*face).is_none_or(|twin| *face < twin);
        let marked: Vec<u32> = self.all_marked().into_iter().filter(once).collect();
        for &face in &marked {
            for ridge in self.ridges(face) {
                *count.entry(ridge).or_default() += 1;
            }
        }
        let mut look = Vec::new();
        for &face in &marked {
            for ridge in self.ridges(face) {
                if count[&ridge] == 1 {
                    let before = look.len();
                    // Where it does not close, the surface ends in a side.
                    if !self.round(face / (D as u32 + 1), ridge, |c| look.push(c)) {
                        look.truncate(before);
                    }
                }
            }
        }
        self.on = count;
        let mut known = vec![false; self.mesh.len()];
        while !look.is_empty() && !patience.over() {
            look.sort_unstable();
            look.dedup();
            look.retain(|&c| !std::mem::replace(&mut known[c as usize], true));
            let sides: Vec<NearSheets> = look.par_iter().map(|&c| self.near(c)).collect();
            self.sides.extend(look.iter().copied().zip(sides));
            let mut next = Vec::new();
            for &c in &look {
                for k in 0..=D as u32 {
                    let face = (D as u32 + 1) * c + k;
                    let beyond = self.neighbors[face as usize];
                    // Of two that are new, the second sees the first.
                    let seen = beyond != NONE && known[beyond as usize];
                    let twice = seen && beyond > c && look.binary_search(&beyond).is_ok();
                    if !seen || twice || self.marked(face) || !self.parted(c, beyond) {
                        continue;
                    }
                    let twin = self.twin(face).unwrap_or(face);
                    self.fresh.push(face.min(twin));
                    let ridges: Vec<Ridge> = self.ridges(face).collect();
                    for ridge in ridges {
                        *self.on.entry(ridge).or_default() += 1;
                        self.round(c, ridge, |c| next.push(c));
                    }
                }
            }
            look = next;
        }
        self.fresh.sort_unstable();
    }

    /// Takes off fresh faces that hang over a rim.
    fn peel(&mut self) {
        let mut at: HashMap<Ridge, Vec<u32>> = HashMap::new();
        for &face in &self.fresh {
            for ridge in self.ridges(face) {
                at.entry(ridge).or_default().push(face);
            }
        }
        let mut gone = vec![false; self.fresh.len()];
        let mut queue = self.fresh.clone();
        while let Some(face) = queue.pop() {
            let Ok(place) = self.fresh.binary_search(&face) else {
                continue;
            };
            let ridges: Vec<Ridge> = self.ridges(face).collect();
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
            self.mark(self.fresh[i], true);
        }
    }

    /// Opens pockets that fresh faces have made, each towards the room with which it shares most of
    /// their area. Gives the number of pockets, and of rooms that are left.
    fn open_pockets(&mut self) -> (usize, usize) {
        let n = D as u32 + 1;
        let mut rooms = Sets::new(self.mesh.len());
        let (neighbors, marks) = (self.neighbors, &*self.marks);
        rooms.unite_with(|c| {
            let beyond = &neighbors[(n * c) as usize..(n * (c + 1)) as usize];
            let open = move |(k, cell): (usize, &u32)| {
                let open = *cell != NONE && *cell > c && marks[c as usize] >> k & 1 == 0;
                open.then_some(*cell)
            };
            beyond.iter().enumerate().filter_map(open)
        });
        let (room, count) = rooms.numbered();
        let mut volume = vec![0.0; count];
        for first in (0..self.mesh.len()).step_by(TOGETHER) {
            let some = (first..self.mesh.len().min(first + TOGETHER)).into_par_iter();
            let volumes: Vec<f64> = some.map(|c| self.mesh.volume(c)).collect();
            for (of_cell, &room) in volumes.iter().zip(&room[first..]) {
                volume[room as usize] += of_cell;
            }
        }
        // For each pocket and room beside it, the area of the fresh faces between them.
        let mut between: BTreeMap<u32, BTreeMap<u32, f64>> = BTreeMap::new();
        for &face in &self.fresh {
            let cells = [face / n, self.neighbors[face as usize]];
            let [r, s] = cells.map(|c| room[c as usize]);
            let d = self.spacing(cells[0]);
            for (own, other) in [(r, s), (s, r)] {
                if r != s && volume[own as usize] < POCKET * d.powi(D as i32) {
                    let areas = between.entry(own).or_default();
                    *areas.entry(other).or_default() += self.area(face);
                }
            }
        }
        let mut joined = Sets::new(count);
        let mut opened = Vec::new();
        for (pocket, areas) in between {
            let larger = |best: (u32, f64), (&other, &area): (&u32, &f64)| {
                if area > best.1 { (other, area) } else { best }
            };
            let (other, _) = areas.iter().fold((pocket, 0.0), larger);
            if joined.find(pocket) != joined.find(other) {
                joined.unite(pocket, other);
                opened.push((pocket.min(other), pocket.max(other)));
            }
        }
        opened.sort_unstable();
        if !opened.is_empty() {
            for face in self.all_marked() {
                let beyond = self.neighbors[face as usize];
                if beyond != NONE && beyond > face / n {
                    let [r, s] = [face / n, beyond].map(|c| room[c as usize]);
                    if opened.binary_search(&(r.min(s), r.max(s))).is_ok() {
                        self.mark(face, false);
                    }
                }
            }
        }
        (opened.len(), count - opened.len())
    }

    /// The lattice's spacing at a cell.
    fn spacing(&self, c: u32) -> f64 {
        self.distance
            .at(self.mesh.nodes()[self.mesh.cell(c as usize)[0] as usize])
    }

    fn area(&self, face: u32) -> f64 {
        let nodes = self
            .mesh
            .face(face as usize / (D + 1), face as usize % (D + 1));
        M::face_area(&nodes.map(|n| self.mesh.nodes()[n as usize]))
    }

    fn finish(&self, pockets: usize, rooms: usize) -> Sealed {
        let left = || self.fresh.iter().filter(|&&face| self.marked(face));
        Sealed {
            faces: left().count(),
            area: left().map(|&face| self.area(face)).sum(),
            pockets,
            rooms,
        }
    }
}

#[cfg(test)]
mod tests;
