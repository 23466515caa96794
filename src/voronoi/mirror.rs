//! Mirror images of the atoms near a side, outside the box.
//!
//! The plane half-way between an atom and its image in a side *is* that side. The image of another
//! atom cuts nothing off inside the box (every point inside is nearer to the atom itself). So with
//! the images of all atoms, in all sides, the Voronoi cells of the atoms are the Voronoi cells of
//! the atoms alone, cut by the box; and an image that its own atom does not touch may be left out.
//! Which ones are needed is not known before; some are guessed, and [`Mirrored::add`] gives more
//! where a cell comes out larger than the box.

/// Atoms and their images.
#[derive(Debug, Clone)]
pub struct Mirrored<const D: usize> {
    /// The atoms, and behind them the images.
    pub points: Vec<[f64; D]>,
    /// Number of atoms.
    pub atoms: usize,
    /// For each image, its atom and the side: 2 axis for the lower one, 2 axis + 1 for the upper.
    pub images: Vec<(u32, u8)>,
    /// For each atom, bit s: it has an image in side s.
    done: Vec<u8>,
    extent: [f64; D],
}

/// Coordinates rounded so that images in both sides are exact: to multiples of the last digit of
/// twice the extent (about 1e-16 of it). Symmetric points then give exactly symmetric results, which
/// TetGen's exact predicates need to see that an atom, its neighbour and their images lie on a
/// circle.
pub fn rounded<const D: usize>(atoms: &[[f64; D]], extent: [f64; D]) -> Vec<[f64; D]> {
    let unit = extent.map(|e| (2.0 * e).next_up() - 2.0 * e);
    atoms
        .iter()
        .map(|x| std::array::from_fn(|k| (x[k] / unit[k]).round() * unit[k]))
        .collect()
}

impl<const D: usize> Mirrored<D> {
    /// Atoms, already [`rounded`], with the images that they will most likely need: of those that
    /// are no farther from a side than the side's own points are from atoms.
    pub fn new(atoms: Vec<[f64; D]>, extent: [f64; D]) -> Self {
        let mut mirrored = Self {
            atoms: atoms.len(),
            done: vec![0; atoms.len()],
            images: Vec::new(),
            points: atoms,
            extent,
        };
        for side in 0..2 * D {
            let near = Depths::new(&mirrored.points[..mirrored.atoms], extent, side);
            for atom in 0..mirrored.atoms {
                let x = mirrored.points[atom];
                if near.height(x) <= near.depth[near.bin(x)] {
                    mirrored.add(atom, side);
                }
            }
        }
        mirrored
    }

    /// Adds the image of an atom in a side; says whether it was new.
    pub fn add(&mut self, atom: usize, side: usize) -> bool {
        let bit = 1 << side;
        if self.done[atom] & bit != 0 {
            return false;
        }
        self.done[atom] |= bit;
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

/// For bins of a side, a bound on the distance from any of the bin's points to the nearest atom.
struct Depths<const D: usize> {
    axis: usize,
    plane: f64,
    size: [f64; D],
    dims: [usize; D],
    depth: Vec<f64>,
}

impl<const D: usize> Depths<D> {
    fn new(atoms: &[[f64; D]], extent: [f64; D], side: usize) -> Self {
        let axis = side / 2;
        let volume: f64 = extent.iter().product();
        let spacing = (volume / atoms.len().max(1) as f64).powf(1.0 / D as f64);
        let dims: [usize; D] = std::array::from_fn(|k| {
            if k == axis {
                1
            } else {
                ((2.0 * extent[k] / spacing) as usize).clamp(1, 1024)
            }
        });
        let size: [f64; D] = std::array::from_fn(|k| extent[k] / dims[k] as f64);
        let mut depths = Self {
            axis,
            plane: if side % 2 == 0 { 0.0 } else { extent[axis] },
            size,
            dims,
            depth: vec![f64::INFINITY; dims.iter().product()],
        };
        let diagonal = (0..D)
            .filter(|&k| k != axis)
            .map(|k| size[k] * size[k])
            .sum::<f64>();
        for &x in atoms {
            let (bin, depth) = (depths.bin(x), (depths.height(x).powi(2) + diagonal).sqrt());
            depths.depth[bin] = depths.depth[bin].min(depth);
        }
        // A step to the next bin adds at most the step.
        for k in (0..D).filter(|&k| k != axis) {
            let stride: usize = dims[..k].iter().product();
            let row = |i: usize| (i / stride) % dims[k];
            for i in 0..depths.depth.len() {
                if row(i) > 0 {
                    depths.depth[i] = depths.depth[i].min(depths.depth[i - stride] + size[k]);
                }
            }
            for i in (0..depths.depth.len()).rev() {
                if row(i) + 1 < dims[k] {
                    depths.depth[i] = depths.depth[i].min(depths.depth[i + stride] + size[k]);
                }
            }
        }
        depths
    }

    /// Distance of a position from the side.
    fn height(&self, x: [f64; D]) -> f64 {
        (x[self.axis] - self.plane).abs()
    }

    /// The bin below a position.
    fn bin(&self, x: [f64; D]) -> usize {
        (0..D).rev().fold(0, |index, k| {
            let i = if k == self.axis {
                0
            } else {
                ((x[k] / self.size[k]) as usize).min(self.dims[k] - 1)
            };
            index * self.dims[k] + i
        })
    }
}
