//! Mirror images outside the box of the atoms near a side.
//!
//! The plane half-way between an atom and its image in a side is that side. The image of another
//! atom cuts nothing off inside the box, because every point inside is nearer to the atom itself.
//! So with the images of all atoms in all sides, the Voronoi cells of the atoms are the Voronoi
//! cells of the atoms alone, cut by the box. The image of an atom whose cell does not touch the
//! side can be omitted. If a needed image is missing, a cell extends beyond the box; the caller
//! checks that and calls [`MirroredAtoms::add`].

use crate::geometry::distance2;
use crate::geometry::grid_index::{index_at, strides};

/// Atoms and their images.
#[derive(Debug, Clone)]
pub struct MirroredAtoms<const D: usize> {
    /// The atoms, followed by the images.
    pub points: Vec<[f64; D]>,
    /// Number of atoms.
    pub atom_count: usize,
    /// For each image, its atom and the side: 2 axis for the lower one, 2 axis + 1 for the upper.
    pub images: Vec<(u32, u8)>,
    /// For each atom, bit s is set if it has an image in side s.
    image_sides: Vec<u8>,
    extent: [f64; D],
}

/// Rounds coordinates so that the images in both sides are exact: to multiples of the last digit of
/// twice the extent (about 1e-16 of it). Then symmetric points give exactly symmetric results, and
/// the exact predicates of the Delaunay kernels recognise that an atom, its neighbour and their
/// images lie on a circle.
pub fn round_coordinates<const D: usize>(atoms: &[[f64; D]], extent: [f64; D]) -> Vec<[f64; D]> {
    let unit = extent.map(|e| (2.0 * e).next_up() - 2.0 * e);
    atoms
        .iter()
        .map(|x| std::array::from_fn(|k| (x[k] / unit[k]).round() * unit[k]))
        .collect()
}

impl<const D: usize> MirroredAtoms<D> {
    /// Returns the atom of a point, which is the atom itself or one of its images.
    pub fn owner(&self, point: u32) -> usize {
        match (point as usize).checked_sub(self.atom_count) {
            None => point as usize,
            Some(image) => self.images[image].0 as usize,
        }
    }

    /// Creates the images that the cells of `atoms` need, and a few more. The coordinates are
    /// rounded by [`round_coordinates`].
    pub fn new(atoms: Vec<[f64; D]>, extent: [f64; D]) -> Self {
        let mut mirrored = Self {
            atom_count: atoms.len(),
            image_sides: vec![0; atoms.len()],
            images: Vec::new(),
            points: atoms,
            extent,
        };
        for side in 0..2 * D {
            let atoms = &mirrored.points[..mirrored.atom_count];
            let bins = NearestAtomBins::new(atoms, extent, side);
            let touching: Vec<usize> = (0..atoms.len())
                .filter(|&atom| bins.may_touch(atoms[atom]))
                .collect();
            for atom in touching {
                mirrored.add(atom, side);
            }
        }
        mirrored
    }

    /// Adds the image of an atom in a side. Returns `true` if it is new.
    pub fn add(&mut self, atom: usize, side: usize) -> bool {
        let bit = 1 << side;
        if self.image_sides[atom] & bit != 0 {
            return false;
        }
        self.image_sides[atom] |= bit;
        self.images.push((atom as u32, side as u8));
        let mut image = self.points[atom];
        let axis = side / 2;
        image[axis] = match side % 2 {
            0 => -image[axis],
            _ => 2.0 * self.extent[axis] - image[axis],
        };
        self.points.push(image);
        true
    }
}

/// A nearby atom for every bin of a side: the atom nearest to the bin's centre, or one slightly
/// farther where atoms are sparse.
struct NearestAtomBins<'a, const D: usize> {
    atoms: &'a [[f64; D]],
    axis: usize,
    plane: f64,
    size: [f64; D],
    dims: [usize; D],
    nearest: Vec<u32>,
    /// Largest distance from a bin's centre to its atom.
    max_distance: f64,
}

impl<'a, const D: usize> NearestAtomBins<'a, D> {
    /// Size of bins, relative to the mean distance between atoms.
    const BIN_SIZE_RATIO: f64 = 0.3;
    /// Largest number of bins to either side that are searched for one atom.
    const MAX_BIN_RADIUS: f64 = 32.0;

    fn new(atoms: &'a [[f64; D]], extent: [f64; D], side: usize) -> Self {
        let axis = side / 2;
        let volume: f64 = extent.iter().product();
        let spacing = (volume / atoms.len() as f64).powf(1.0 / D as f64);
        let mut dims =
            extent.map(|e| ((e / (Self::BIN_SIZE_RATIO * spacing)) as usize).clamp(1, 1024));
        dims[axis] = 1;
        let mut bins = Self {
            atoms,
            axis,
            plane: if side.is_multiple_of(2) {
                0.0
            } else {
                extent[axis]
            },
            size: std::array::from_fn(|k| extent[k] / dims[k] as f64),
            dims,
            nearest: Vec::new(),
            max_distance: 0.0,
        };
        let mut nearest = vec![(f64::INFINITY, 0u32); dims.iter().product()];
        for (atom, &x) in atoms.iter().enumerate() {
            let radius = if bins.height(x) < spacing {
                spacing
            } else {
                0.0
            };
            bins.visit_bins(x, radius, |bin, _, squared_distance| {
                if squared_distance < nearest[bin].0 {
                    nearest[bin] = (squared_distance, atom as u32);
                }
                false
            });
        }
        bins.propagate_nearest(&mut nearest);
        let max_square = nearest.iter().fold(0.0, |max: f64, f| max.max(f.0));
        bins.max_distance = max_square.sqrt();
        bins.nearest = nearest.into_iter().map(|f| f.1).collect();
        bins
    }

    /// Passes atoms from bin to bin, forwards and backwards along each direction, if they are
    /// nearer than the bin's current atom.
    fn propagate_nearest(&self, nearest: &mut [(f64, u32)]) {
        for k in (0..D).filter(|&k| k != self.axis) {
            let stride = strides(self.dims)[k];
            let mut propagate = |source: usize, target: usize| {
                if nearest[source].0 < f64::INFINITY && nearest[source].1 != nearest[target].1 {
                    let square = self.squared_distance(self.centre(target), nearest[source].1);
                    if square < nearest[target].0 {
                        nearest[target] = (square, nearest[source].1);
                    }
                }
            };
            let count = self.dims.iter().product::<usize>();
            let position = |i: usize| (i / stride) % self.dims[k];
            (0..count)
                .filter(|&i| position(i) > 0)
                .for_each(|i| propagate(i - stride, i));
            (0..count)
                .rev()
                .filter(|&i| position(i) + 1 < self.dims[k])
                .for_each(|i| propagate(i + stride, i));
        }
    }

    /// Returns `true` if the cell of an atom at x may touch the side. There may be false positives,
    /// but no false negatives.
    ///
    /// Where x is nearer than another atom n, `|p - x|^2 - |p - n|^2` is negative. It is linear in
    /// p, so its smallest value in a bin is known.
    fn may_touch(&self, x: [f64; D]) -> bool {
        let half_size = |k: usize| {
            if k == self.axis {
                0.0
            } else {
                0.5 * self.size[k]
            }
        };
        let half_diagonal = (0..D).map(|k| half_size(k).powi(2)).sum::<f64>().sqrt();
        // No point of the side is farther than this from its nearest atom.
        let max_distance = self.max_distance + half_diagonal;
        let height = self.height(x);
        if height > max_distance {
            return false;
        }
        let radius = (max_distance * max_distance - height * height).sqrt();
        let max_radius =
            self.size.iter().copied().fold(f64::INFINITY, f64::min) * Self::MAX_BIN_RADIUS;
        radius > max_radius
            || self.visit_bins(x, radius, |bin, centre, square| {
                let other_atom = self.nearest[bin];
                let n = &self.atoms[other_atom as usize];
                let max_change: f64 = (0..D)
                    .map(|k| 2.0 * half_size(k) * (n[k] - x[k]).abs())
                    .sum();
                square - max_change <= self.squared_distance(centre, other_atom)
            })
    }

    /// Returns the centre of a bin.
    fn centre(&self, bin: usize) -> [f64; D] {
        let index = index_at(self.dims, bin);
        std::array::from_fn(|k| {
            if k == self.axis {
                self.plane
            } else {
                (index[k] as f64 + 0.5) * self.size[k]
            }
        })
    }

    /// Returns the squared distance from a position to an atom.
    fn squared_distance(&self, x: [f64; D], atom: u32) -> f64 {
        distance2(&x, &self.atoms[atom as usize])
    }

    /// Calls `visit(bin, its centre, squared distance from x)` for the bins within `radius` along
    /// the side, including the bin below x, until it returns `true`. Returns `true` if it did.
    fn visit_bins(
        &self,
        x: [f64; D],
        radius: f64,
        mut visit: impl FnMut(usize, [f64; D], f64) -> bool,
    ) -> bool {
        let bin = |k: usize, c: f64| ((c / self.size[k]) as usize).min(self.dims[k] - 1);
        let low: [usize; D] = std::array::from_fn(|k| bin(k, x[k] - radius));
        let high: [usize; D] = std::array::from_fn(|k| bin(k, x[k] + radius));
        let mut index = low;
        loop {
            let mut flat_index = 0;
            let mut centre = [self.plane; D];
            let mut square = 0.0;
            for k in (0..D).rev() {
                flat_index = flat_index * self.dims[k] + index[k];
                if k != self.axis {
                    centre[k] = (index[k] as f64 + 0.5) * self.size[k];
                }
                square += (centre[k] - x[k]) * (centre[k] - x[k]);
            }
            if visit(flat_index, centre, square) {
                return true;
            }
            let Some(k) = (0..D).find(|&k| index[k] < high[k]) else {
                return false;
            };
            index[k] += 1;
            index[..k].copy_from_slice(&low[..k]);
        }
    }

    /// Returns the distance of a position from the side.
    fn height(&self, x: [f64; D]) -> f64 {
        (x[self.axis] - self.plane).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_exact_and_few() {
        // The first layer of a lattice touches the side, the second layer does not.
        let extent = [12.3, 12.3, 12.3];
        let mut atoms = Vec::new();
        for k in 0..10 {
            for j in 0..10 {
                for i in 0..10 {
                    atoms.push([i, j, k].map(|c| (f64::from(c) + 0.45) * 1.23));
                }
            }
        }
        let atoms = round_coordinates(&atoms, extent);
        let mirrored = MirroredAtoms::new(atoms, extent);
        assert_eq!(mirrored.images.len(), 600);
        for (image, &(atom, side)) in mirrored.points[1000..].iter().zip(&mirrored.images) {
            let (axis, plane) = (usize::from(side) / 2, f64::from(side % 2) * 12.3);
            let x = mirrored.points[atom as usize];
            assert_eq!(image[axis] - plane, plane - x[axis]);
            assert_eq!(0.5 * (image[axis] + x[axis]), plane);
        }
    }
}
