//! Atoms placed so far, in a grid of cells that says whether a place is still free.

use super::distance2;

/// A site is free if no atom is nearer than this, in units of d (Hale 2001: 0.8).
pub(super) const FREE: f64 = 0.8;
/// Nearest to the sides of what it fills that a site may be, in units of d; 0.71 in a regular
/// lattice.
pub(super) const MARGIN: f64 = 0.4;

/// No atom.
const NONE: u32 = u32::MAX;

/// Atoms in the box `[0, extent]`, in the order in which they were placed.
pub(super) struct Placed<const D: usize> {
    positions: Vec<[f64; D]>,
    dims: [usize; D],
    edge: f64,
    /// The last atom put into each cell.
    last: Vec<u32>,
    /// The atom put into the same cell before.
    before: Vec<u32>,
}

impl<const D: usize> Placed<D> {
    /// None yet; `apart` is about how near to each other the nearest will be.
    pub fn new(extent: [f64; D], apart: f64) -> Self {
        // A few atoms a cell where they are dense; never more than some ten million cells.
        let volume: f64 = extent.iter().product();
        let edge = (1.6 * apart).max((volume / 1e7).powf(1.0 / D as f64));
        let dims = extent.map(|l| (l / edge) as usize + 1);
        Self {
            positions: Vec::new(),
            dims,
            edge,
            last: vec![NONE; dims.iter().product()],
            before: Vec::new(),
        }
    }

    /// All of them.
    pub fn positions(&self) -> &[[f64; D]] {
        &self.positions
    }

    /// Places one and returns its number.
    pub fn add(&mut self, x: [f64; D]) -> u32 {
        let n = self.positions.len() as u32;
        let cell = self.index(self.cell(&x, 0.0));
        self.before.push(self.last[cell]);
        self.last[cell] = n;
        self.positions.push(x);
        n
    }

    /// Whether no atom is nearer to `x` than `radius`.
    pub fn is_free(&self, x: &[f64; D], radius: f64) -> bool {
        let radius2 = radius * radius;
        // Most sites are those of atoms that are there already.
        let own = self.index(self.cell(x, 0.0));
        if self.taken(own, x, radius2) {
            return false;
        }
        let (low, high) = (self.cell(x, -radius), self.cell(x, radius));
        let mut cell = low;
        loop {
            let index = self.index(cell);
            if index != own && self.taken(index, x, radius2) {
                return false;
            }
            // The next cell of the block, x fastest.
            let Some(k) = (0..D).find(|&k| cell[k] < high[k]) else {
                return true;
            };
            cell[k] += 1;
            cell[..k].copy_from_slice(&low[..k]);
        }
    }

    /// Whether an atom of a cell is nearer to `x` than the square root of `radius2`.
    fn taken(&self, cell: usize, x: &[f64; D], radius2: f64) -> bool {
        let mut n = self.last[cell];
        while n != NONE {
            if distance2(&self.positions[n as usize], x) < radius2 {
                return true;
            }
            n = self.before[n as usize];
        }
        false
    }

    /// The index of the cell `x + shift` along each axis.
    fn cell(&self, x: &[f64; D], shift: f64) -> [usize; D] {
        std::array::from_fn(|k| {
            (((x[k] + shift).max(0.0) / self.edge) as usize).min(self.dims[k] - 1)
        })
    }

    fn index(&self, cell: [usize; D]) -> usize {
        (0..D)
            .rev()
            .fold(0, |index, k| index * self.dims[k] + cell[k])
    }
}
