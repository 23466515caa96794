//! A pseudo-regular lattice for variable d: Hale 2001, Algorithm 2, with exact sides.
//!
//! A queue of atoms grows the lattice: an atom proposes the sites that its neighbours would have in
//! a face-centred cubic lattice of spacing d(x), and a site becomes an atom if no atom is nearer
//! than 0.8 d. Hale marks spheres in a volume of flags; here atoms are kept in a grid of cells.
//!
//! The box comes first, so that it is filled exactly: its corners; atoms along its edges, sqrt 2 d
//! apart as on the edges of a (100) box; atoms in its sides, grown from the edges as centred squares;
//! and only then the volume, grown from fixed atoms and sides inwards. All of it in the orientation
//! of the box's axes, so that where d hardly varies the fronts meet as one lattice.

use std::collections::VecDeque;
use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

use super::{distance2, sides_held};
use crate::distance::Distance;

/// A site is free if no atom is nearer than this, in units of d (Hale 2001: 0.8).
const FREE: f64 = 0.8;
/// Nearest to the sides of what it fills that a site may be, in units of d; 0.71 in a regular
/// lattice.
const MARGIN: f64 = 0.4;

/// Atoms found so far, in a grid of cells.
struct Grown<'a> {
    distance: &'a Distance<3>,
    extent: [f64; 3],
    positions: Vec<[f64; 3]>,
    dims: [usize; 3],
    edge: f64,
    /// The smallest d.
    least: f64,
    /// The last atom put into each cell.
    last: Vec<u32>,
    /// The atom put into the same cell before.
    before: Vec<u32>,
}

/// No atom.
const NONE: u32 = u32::MAX;

impl<'a> Grown<'a> {
    fn new(extent: [f64; 3], distance: &'a Distance<3>) -> Self {
        // A few atoms a cell where d is least; never more than some ten million cells.
        let volume: f64 = extent.iter().product();
        let least = distance.min();
        let edge = (1.6 * FREE * least).max((volume / 1e7).cbrt());
        let dims = extent.map(|l| (l / edge) as usize + 1);
        let last = vec![NONE; dims.iter().product()];
        Self {
            distance,
            extent,
            positions: Vec::new(),
            dims,
            edge,
            least,
            last,
            before: Vec::new(),
        }
    }

    fn cell_along(&self, k: usize, x: f64) -> usize {
        ((x.max(0.0) / self.edge) as usize).min(self.dims[k] - 1)
    }

    fn index(&self, c: [usize; 3]) -> usize {
        (c[2] * self.dims[1] + c[1]) * self.dims[0] + c[0]
    }

    fn add(&mut self, x: [f64; 3]) -> u32 {
        let n = self.positions.len() as u32;
        let cell = self.index(std::array::from_fn(|k| self.cell_along(k, x[k])));
        self.before.push(self.last[cell]);
        self.last[cell] = n;
        self.positions.push(x);
        n
    }

    /// Whether an atom of a cell is nearer to `x` than the square root of `radius2`.
    fn taken(&self, cell: usize, x: &[f64; 3], radius2: f64) -> bool {
        let mut n = self.last[cell];
        while n != NONE {
            if distance2(&self.positions[n as usize], x) < radius2 {
                return true;
            }
            n = self.before[n as usize];
        }
        false
    }

    /// Whether no atom is nearer to `x` than `radius`.
    fn is_free(&self, x: &[f64; 3], radius: f64) -> bool {
        let radius2 = radius * radius;
        // Most sites are those of atoms that are there already.
        let own = self.index(std::array::from_fn(|k| self.cell_along(k, x[k])));
        if self.taken(own, x, radius2) {
            return false;
        }
        let low: [usize; 3] = std::array::from_fn(|k| self.cell_along(k, x[k] - radius));
        let high: [usize; 3] = std::array::from_fn(|k| self.cell_along(k, x[k] + radius));
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for c in low[0]..=high[0] {
                    let cell = self.index([c, y, z]);
                    if cell != own && self.taken(cell, x, radius2) {
                        return false;
                    }
                }
            }
        }
        true
    }

    /// Grows a lattice from the atoms in `queue` over the axes in `along`: all three for the volume,
    /// two for a side, on which the third coordinate stays what it is.
    fn grow(&mut self, mut queue: VecDeque<u32>, along: &[usize]) {
        while let Some(n) = queue.pop_front() {
            let from = self.positions[n as usize];
            let half_cell = self.distance.at(from) * FRAC_1_SQRT_2;
            for (place, &first) in along.iter().enumerate() {
                for &second in &along[place + 1..] {
                    for signs in 0..4 {
                        let sign = |bit: usize| if signs >> bit & 1 == 0 { 1.0 } else { -1.0 };
                        let mut site = from;
                        site[first] += sign(0) * half_cell;
                        site[second] += sign(1) * half_cell;
                        let d = self.distance.at(site);
                        let margin = MARGIN * d;
                        let inside = along
                            .iter()
                            .all(|&k| site[k] >= margin && site[k] <= self.extent[k] - margin);
                        if inside && self.is_free(&site, FREE * d) {
                            queue.push_back(self.add(site));
                        }
                    }
                }
            }
        }
    }

    /// Atoms between the ends of the box's edge along `axis` through `corner`, evenly spread in
    /// units of sqrt 2 d.
    fn edge(&self, axis: usize, corner: [f64; 3]) -> Vec<[f64; 3]> {
        let length = self.extent[axis];
        let at = |t: f64| {
            let mut x = corner;
            x[axis] = t;
            x
        };
        // How many spacings from the start to each of many points (midpoint rule).
        let pieces = (8.0 * length / self.least).ceil().max(8.0) as usize;
        let piece = length / pieces as f64;
        let mut spacings = vec![0.0];
        for n in 0..pieces {
            let d = self.distance.at(at((n as f64 + 0.5) * piece));
            spacings.push(spacings[n] + piece / (SQRT_2 * d));
        }
        let count = spacings[pieces].round().max(1.0);
        let scale = spacings[pieces] / count;
        let mut n = 0;
        (1..count as usize)
            .map(|k| {
                let target = k as f64 * scale;
                while n + 1 < pieces && spacings[n + 1] < target {
                    n += 1;
                }
                let share = (target - spacings[n]) / (spacings[n + 1] - spacings[n]);
                at((n as f64 + share) * piece)
            })
            .collect()
    }
}

/// Positions of a pseudo-regular lattice of spacing d(x) that fills the box `[0, extent]`; atoms on
/// its sides have coordinates of exactly `0.0` or `extent[k]`. Keeps its distance from `fixed` atoms
/// (which are in the box, and not in the result) and grows from them.
pub fn grown(extent: [f64; 3], distance: &Distance<3>, fixed: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let mut lattice = Grown::new(extent, distance);
    let mut fixed_of_rank: [Vec<u32>; 4] = Default::default();
    let mut is_fixed = Vec::new();
    let corner = |n: usize| std::array::from_fn(|k| if n >> k & 1 == 0 { 0.0 } else { extent[k] });

    // From corners to the volume, each time the fixed atoms that lie there first.
    for rank in (0..4).rev() {
        for &x in fixed.iter().filter(|&&x| sides_held(x, extent) == rank) {
            fixed_of_rank[rank].push(lattice.add(x));
        }
        is_fixed.resize(lattice.positions.len(), true);
        match rank {
            3 => {
                for x in (0..8).map(corner) {
                    if lattice.is_free(&x, 1e-3 * lattice.least) {
                        lattice.add(x);
                    }
                }
            }
            2 => {
                for axis in 0..3 {
                    for x in (0..8).filter(|n| n >> axis & 1 == 0).map(corner) {
                        for atom in lattice.edge(axis, x) {
                            if lattice.is_free(&atom, FREE * distance.at(atom)) {
                                lattice.add(atom);
                            }
                        }
                    }
                }
            }
            1 => {
                for axis in 0..3 {
                    let along: Vec<usize> = (0..3).filter(|&k| k != axis).collect();
                    for level in [0.0, extent[axis]] {
                        let on = |n: &u32| lattice.positions[*n as usize][axis] == level;
                        let queue = (0..lattice.positions.len() as u32).filter(on).collect();
                        lattice.grow(queue, &along);
                    }
                }
            }
            _ => {
                let inner = fixed_of_rank[0].iter().copied();
                let queue = inner.chain(0..lattice.positions.len() as u32).collect();
                lattice.grow(queue, &[0, 1, 2]);
            }
        }
        is_fixed.resize(lattice.positions.len(), false);
    }
    let atoms = lattice.positions.iter().zip(&is_fixed);
    atoms
        .filter(|(_, fixed)| !**fixed)
        .map(|(x, _)| *x)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Field;
    use crate::mesh::AtomKind;
    use crate::seeding::{Atoms, fcc};

    /// d from 4 in the middle to 9 at the far corners.
    fn varying(extent: [f64; 3]) -> Distance<3> {
        let dims = extent.map(|l| (l / 2.0) as usize + 1);
        let step = std::array::from_fn(|k| extent[k] / (dims[k] - 1) as f64);
        Distance::Field(Field::from_fn(dims, step, |x| {
            let r2: f64 = (0..3).map(|k| (x[k] - 0.5 * extent[k]).powi(2)).sum();
            (4.0 + 0.1 * (r2.sqrt() - 8.0).max(0.0)).min(9.0)
        }))
    }

    /// Nearest-neighbour distance over d at 0, 1, 50, 99 and 100 %.
    fn spacing(atoms: &Atoms<3>, distance: &Distance<3>) -> [f64; 5] {
        let mut nearest: Vec<f64> = atoms
            .positions
            .iter()
            .enumerate()
            .map(|(n, x)| {
                let others = atoms.positions.iter().enumerate().filter(|(m, _)| *m != n);
                let least = others
                    .map(|(_, y)| distance2(x, y))
                    .fold(f64::INFINITY, f64::min);
                least.sqrt() / distance.at(*x)
            })
            .collect();
        nearest.sort_by(f64::total_cmp);
        [0.0, 0.01, 0.5, 0.99, 1.0].map(|p| nearest[((nearest.len() - 1) as f64 * p) as usize])
    }

    #[test]
    fn fills_the_box_with_atoms_about_d_apart() {
        let extent = [70.0, 63.0, 55.0];
        let distance = varying(extent);
        let atoms = fcc(extent, &distance, &[]).unwrap();
        let corners = atoms
            .kinds
            .iter()
            .filter(|&&k| k == AtomKind::Corner)
            .count();
        assert_eq!(corners, 8);
        let spacing = spacing(&atoms, &distance);
        println!("{} atoms, nearest / d {spacing:.3?}", atoms.len());
        assert!(spacing[0] > 0.7 && spacing[4] < 1.5, "{spacing:?}");
        assert!(spacing[2] > 0.8 && spacing[2] < 1.05, "{spacing:?}");
        // As many atoms as d asks for: sqrt 2 / d^3 a unit of volume, if somewhat less dense.
        let mut expected = 0.0;
        for n in 0..70 * 63 * 55 {
            let x = [n % 70, n / 70 % 63, n / 70 / 63].map(|c| c as f64 + 0.5);
            expected += SQRT_2 / distance.at(x).powi(3);
        }
        let share = atoms.len() as f64 / expected;
        println!("{share:.3} of the atoms of a perfect lattice");
        assert!(share > 0.8 && share < 1.5, "{share}");
        // No large holes: every point has an atom within d.
        let mut widest = 0.0f64;
        for n in 0..3000u32 {
            let t = |k: u32| f64::from((n * 7919 + 13) * (k + 3) % 9973) / 9973.0;
            let x = [extent[0] * t(0), extent[1] * t(5), extent[2] * t(11)];
            let near = atoms
                .positions
                .iter()
                .map(|y| distance2(&x, y))
                .fold(f64::MAX, f64::min);
            widest = widest.max(near.sqrt() / distance.at(x));
        }
        println!("widest hole {widest:.3} d");
        assert!(widest < 1.1, "{widest}");
    }

    #[test]
    fn edges_carry_evenly_spread_atoms() {
        let extent = [60.0, 30.0, 30.0];
        let distance = varying(extent);
        let lattice = Grown::new(extent, &distance);
        let mut along: Vec<f64> = lattice.edge(0, [0.0; 3]).iter().map(|x| x[0]).collect();
        along.insert(0, 0.0);
        along.push(60.0);
        for pair in along.windows(2) {
            let d = distance.at([0.5 * (pair[0] + pair[1]), 0.0, 0.0]);
            let spacing = (pair[1] - pair[0]) / (SQRT_2 * d);
            assert!((0.85..1.15).contains(&spacing), "{along:?}");
        }
    }

    #[test]
    fn fixed_atoms_keep_their_places_and_their_room() {
        let extent = [40.0, 40.0, 40.0];
        let distance = varying(extent);
        let fixed = [
            [20.3, 19.1, 20.7],
            [0.0, 13.3, 12.2],
            [0.0, 17.0, 40.0],
            [0.0; 3],
        ];
        let atoms = fcc(extent, &distance, &fixed).unwrap();
        let count = atoms.len();
        assert_eq!(&atoms.positions[count - 4..], &fixed);
        assert!(
            atoms.kinds[count - 4..]
                .iter()
                .all(|&k| k == AtomKind::Fixed)
        );
        assert!(spacing(&atoms, &distance)[0] > 0.6);
        let corners = atoms
            .kinds
            .iter()
            .filter(|&&k| k == AtomKind::Corner)
            .count();
        assert_eq!(corners, 7);
    }
}
