//! Mirror images of the atoms near a side, outside the box.
//!
//! The plane half-way between an atom and its image in a side *is* that side. The image of another
//! atom cuts nothing off inside the box (every point inside is nearer to the atom itself). So with
//! the images of all atoms, in all sides, the Voronoi cells of the atoms are the Voronoi cells of
//! the atoms alone, cut by the box; and the image of an atom whose cell does not touch the side may
//! be left out. Should one be missing, a cell comes out larger than the box: that is checked, and
//! [`MirroredAtoms::add_cells`] helps.

/// Atoms and their images.
#[derive(Debug, Clone)]
pub struct MirroredAtoms<const D: usize> {
    /// The atoms, and behind them the images.
    pub points: Vec<[f64; D]>,
    /// Number of atoms.
    pub atom_count: usize,
    /// For each image, its atom and the side: 2 axis for the lower one, 2 axis + 1 for the upper.
    pub images: Vec<(u32, u8)>,
    /// For each atom, bit s: it has an image in side s.
    image_sides: Vec<u8>,
    extent: [f64; D],
}

/// Coordinates rounded so that images in both sides are exact: to multiples of the last digit of
/// twice the extent (about 1e-16 of it). Symmetric points then give exactly symmetric results, which
/// TetGen's exact predicates need to see that an atom, its neighbour and their images lie on a
/// circle.
pub fn round_coordinates<const D: usize>(atoms: &[[f64; D]], extent: [f64; D]) -> Vec<[f64; D]> {
    let unit = extent.map(|e| (2.0 * e).next_up() - 2.0 * e);
    atoms
        .iter()
        .map(|x| std::array::from_fn(|k| (x[k] / unit[k]).round() * unit[k]))
        .collect()
}

impl<const D: usize> MirroredAtoms<D> {
    /// The atom that a point is, or is an image of.
    pub fn owner(&self, point: u32) -> usize {
        match (point as usize).checked_sub(self.atom_count) {
            None => point as usize,
            Some(image) => self.images[image].0 as usize,
        }
    }

    /// Atoms, already [`round_coordinates`], with the images that they need and a few more.
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
            let beneath = NearestAtomBins::new(atoms, extent, side);
            let touching: Vec<usize> = (0..atoms.len())
                .filter(|&atom| beneath.may_touch(atoms[atom]))
                .collect();
            for atom in touching {
                mirrored.add(atom, side);
            }
        }
        mirrored
    }

    /// Adds the image of an atom in a side; says whether it was new.
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

/// For every bin of a side, an atom near to it: the nearest to the bin's centre, or one not much
/// farther where atoms are sparse.
struct NearestAtomBins<'a, const D: usize> {
    atoms: &'a [[f64; D]],
    axis: usize,
    plane: f64,
    size: [f64; D],
    dims: [usize; D],
    nearest: Vec<u32>,
    /// The largest distance from a bin's centre to its atom.
    max_distance: f64,
}

impl<'a, const D: usize> NearestAtomBins<'a, D> {
    /// Size of bins over the mean distance between atoms.
    const BIN_SIZE_RATIO: f64 = 0.3;
    /// Most bins to either side that are looked at for one atom.
    const MAX_BIN_RADIUS: f64 = 32.0;

    fn new(atoms: &'a [[f64; D]], extent: [f64; D], side: usize) -> Self {
        let axis = side / 2;
        let volume: f64 = extent.iter().product();
        let spacing = (volume / atoms.len() as f64).powf(1.0 / D as f64);
        let mut dims =
            extent.map(|e| ((e / (Self::BIN_SIZE_RATIO * spacing)) as usize).clamp(1, 1024));
        dims[axis] = 1;
        let mut beneath = Self {
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
        let mut found = vec![(f64::INFINITY, 0u32); dims.iter().product()];
        for (atom, &x) in atoms.iter().enumerate() {
            let reach = if beneath.height(x) < spacing {
                spacing
            } else {
                0.0
            };
            beneath.visit_bins(x, reach, |bin, _, square| {
                if square < found[bin].0 {
                    found[bin] = (square, atom as u32);
                }
                false
            });
        }
        beneath.propagate_nearest(&mut found);
        let square = found.iter().fold(0.0, |most: f64, f| most.max(f.0));
        beneath.max_distance = square.sqrt();
        beneath.nearest = found.into_iter().map(|f| f.1).collect();
        beneath
    }

    /// Hands atoms on from bin to bin where they are nearer than what a bin has, there and back
    /// along each direction.
    fn propagate_nearest(&self, found: &mut [(f64, u32)]) {
        for k in (0..D).filter(|&k| k != self.axis) {
            let stride: usize = self.dims[..k].iter().product();
            let mut hand_on = |from: usize, to: usize| {
                if found[from].0 < f64::INFINITY && found[from].1 != found[to].1 {
                    let square = self.squared_distance(self.centre(to), found[from].1);
                    if square < found[to].0 {
                        found[to] = (square, found[from].1);
                    }
                }
            };
            let count = self.dims.iter().product::<usize>();
            let row = |i: usize| (i / stride) % self.dims[k];
            (0..count)
                .filter(|&i| row(i) > 0)
                .for_each(|i| hand_on(i - stride, i));
            (0..count)
                .rev()
                .filter(|&i| row(i) + 1 < self.dims[k])
                .for_each(|i| hand_on(i + stride, i));
        }
    }

    /// Whether the cell of an atom at x may touch the side: surely if it does.
    ///
    /// Where x is nearer than another atom n, `|p - x|^2 - |p - n|^2` is negative; it is linear in
    /// p, so its smallest value in a bin is known.
    fn may_touch(&self, x: [f64; D]) -> bool {
        let half = |k: usize| {
            if k == self.axis {
                0.0
            } else {
                0.5 * self.size[k]
            }
        };
        let slack = (0..D).map(|k| half(k).powi(2)).sum::<f64>().sqrt();
        // From a point of the side to the atom nearest to it.
        let farthest = self.max_distance + slack;
        let height = self.height(x);
        if height > farthest {
            return false;
        }
        let reach = (farthest * farthest - height * height).sqrt();
        let widest = self.size.iter().copied().fold(f64::INFINITY, f64::min) * Self::MAX_BIN_RADIUS;
        reach > widest
            || self.visit_bins(x, reach, |bin, centre, square| {
                let other = self.nearest[bin];
                let n = &self.atoms[other as usize];
                let least: f64 = (0..D).map(|k| 2.0 * half(k) * (n[k] - x[k]).abs()).sum();
                square - least <= self.squared_distance(centre, other)
            })
    }

    /// The centre of a bin.
    fn centre(&self, mut bin: usize) -> [f64; D] {
        std::array::from_fn(|k| {
            let i = bin % self.dims[k];
            bin /= self.dims[k];
            if k == self.axis {
                self.plane
            } else {
                (i as f64 + 0.5) * self.size[k]
            }
        })
    }

    /// The square of the distance from a position to an atom.
    fn squared_distance(&self, x: [f64; D], atom: u32) -> f64 {
        let n = &self.atoms[atom as usize];
        (0..D).map(|k| (x[k] - n[k]).powi(2)).sum()
    }

    /// Runs `found(bin, its centre, square of the distance from x)` on the bins within `reach` along
    /// the side, and on the one below x, until it returns true; says whether it did.
    fn visit_bins(
        &self,
        x: [f64; D],
        reach: f64,
        mut found: impl FnMut(usize, [f64; D], f64) -> bool,
    ) -> bool {
        let bin = |k: usize, c: f64| ((c / self.size[k]) as usize).min(self.dims[k] - 1);
        let low: [usize; D] = std::array::from_fn(|k| bin(k, x[k] - reach));
        let high: [usize; D] = std::array::from_fn(|k| bin(k, x[k] + reach));
        let mut at = low;
        loop {
            let mut index = 0;
            let mut centre = [self.plane; D];
            let mut square = 0.0;
            for k in (0..D).rev() {
                index = index * self.dims[k] + at[k];
                if k != self.axis {
                    centre[k] = (at[k] as f64 + 0.5) * self.size[k];
                }
                square += (centre[k] - x[k]) * (centre[k] - x[k]);
            }
            if found(index, centre, square) {
                return true;
            }
            let Some(k) = (0..D).find(|&k| at[k] < high[k]) else {
                return false;
            };
            at[k] += 1;
            at[..k].copy_from_slice(&low[..k]);
        }
    }

    /// Distance of a position from the side.
    fn height(&self, x: [f64; D]) -> f64 {
        (x[self.axis] - self.plane).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_exact_and_few() {
        // The first layer of a lattice touches the side, the second does not.
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
