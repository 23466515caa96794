//! Measures which share of a simplex holds data.
//!
//! A sample stands for all points that are nearer to it than to any other sample: a box around the
//! sample. A simplex is cut along the planes between these boxes until every piece lies in boxes
//! that all hold data, or in boxes that all hold none. Shares are therefore exact, except for the
//! rounding of floating-point numbers. Sums over blocks of samples tell at once whether a block is
//! of one kind, so that only the simplices on the edge of the data are cut.

use super::Image;
use crate::error::Result;
use crate::geometry::grid_index::{index_at, offset_of};
use crate::memory;

/// Distance in samples by which a simplex may reach into the box of a sample without being cut.
const OVERLAP_TOLERANCE: f64 = 1e-9;

/// The part of an image that holds data, as a body whose overlap with simplices can be measured.
#[derive(Debug, Clone)]
pub(crate) struct LiveVolume<const D: usize> {
    /// Number of cells along each axis: one cell for each sample, and a single cell along the axis
    /// along which all samples are alike.
    dims: [usize; D],
    uniform_axis: Option<usize>,
    /// Number of dead cells before each cell along every axis; one more entry than cells along each
    /// axis. Differences are correct although sums may wrap.
    dead_before: Vec<u32>,
}

impl<const D: usize> LiveVolume<D> {
    /// Returns the part of an image that holds data, or `None` if all samples do.
    ///
    /// # Errors
    /// Returns an [`Error::Job`](crate::Error::Job) if there is not enough memory.
    pub fn new(image: &Image<D>) -> Result<Option<Self>> {
        let Some(gaps) = image.gaps() else {
            return Ok(None);
        };
        let entries = gaps.dims.map(|n| n + 1);
        let count: usize = entries.iter().product();
        memory::ensure_available(
            "the image",
            4.0 * count as f64,
            format!("sums over {count} samples, some of which hold no data"),
            "give a part of the image",
        )?;
        let mut dead_before = vec![0u32; count];
        for (offset, _) in gaps.flags.iter().enumerate().filter(|(_, dead)| **dead) {
            let index = index_at(gaps.dims, offset).map(|i| i + 1);
            dead_before[offset_of(entries, index)] = 1;
        }
        let mut stride = 1;
        for n in entries {
            for offset in stride..count {
                if offset / stride % n > 0 {
                    dead_before[offset] =
                        dead_before[offset].wrapping_add(dead_before[offset - stride]);
                }
            }
            stride *= n;
        }
        Ok(Some(Self {
            dims: gaps.dims,
            uniform_axis: gaps.uniform_axis,
            dead_before,
        }))
    }

    /// Returns the share, from 0 to 1, of a simplex that holds data. Its `D + 1` corners are sample
    /// indices. Outside the image the nearest sample counts.
    pub fn live_share(&self, corners: &[[f64; D]]) -> f64 {
        let mut simplex = [[0.0; D]; 4];
        simplex[..=D].copy_from_slice(corners);
        self.share(simplex)
    }

    fn share(&self, simplex: [[f64; D]; 4]) -> f64 {
        let corners = &simplex[..=D];
        let (mut low, mut high) = ([0; D], [0; D]);
        for k in (0..D).filter(|k| self.uniform_axis != Some(*k)) {
            let last = (self.dims[k] - 1) as f64;
            let min = corners.iter().map(|c| c[k]).fold(f64::INFINITY, f64::min);
            let max = corners
                .iter()
                .map(|c| c[k])
                .fold(f64::NEG_INFINITY, f64::max);
            let first = (min + 0.5 + OVERLAP_TOLERANCE).floor().clamp(0.0, last);
            low[k] = first as usize;
            high[k] = (max - 0.5 - OVERLAP_TOLERANCE).ceil().clamp(first, last) as usize;
        }
        let cells: usize = (0..D).map(|k| high[k] + 1 - low[k]).product();
        match self.dead_count(low, high) {
            0 => return 1.0,
            dead if dead as usize == cells => return 0.0,
            _ => {}
        }
        let axis = (1..D).fold(0, |widest, k| {
            if high[k] - low[k] > high[widest] - low[widest] {
                k
            } else {
                widest
            }
        });
        let plane = (low[axis] + (high[axis] - low[axis]) / 2) as f64 + 0.5;
        let farthest = |sign: f64| {
            (1..=D).fold(0, |far, i| {
                if sign * corners[i][axis] > sign * corners[far][axis] {
                    i
                } else {
                    far
                }
            })
        };
        let [below, above] = [farthest(-1.0), farthest(1.0)];
        let [a, b] = [simplex[below], simplex[above]];
        let t = (plane - a[axis]) / (b[axis] - a[axis]);
        let mut cut: [f64; D] = std::array::from_fn(|k| a[k] + t * (b[k] - a[k]));
        cut[axis] = plane;
        let with_corner = |corner: usize| {
            let mut part = simplex;
            part[corner] = cut;
            self.share(part)
        };
        let share = t * with_corner(above) + (1.0 - t) * with_corner(below);
        share.clamp(0.0, 1.0)
    }

    /// Returns the number of dead cells in a block, from its first to its last cell.
    fn dead_count(&self, low: [usize; D], high: [usize; D]) -> u32 {
        let entries = self.dims.map(|n| n + 1);
        (0..1usize << D).fold(0u32, |count, corner| {
            let is_low = |k: usize| corner >> k & 1 == 0;
            let index = std::array::from_fn(|k| if is_low(k) { low[k] } else { high[k] + 1 });
            let sum = self.dead_before[offset_of(entries, index)];
            let low_sides = (0..D).filter(|&k| is_low(k)).count();
            if low_sides % 2 == 0 {
                count.wrapping_add(sum)
            } else {
                count.wrapping_sub(sum)
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::uniform;
    use crate::geometry::volume6;
    use crate::image::Geometry;

    /// Returns an image whose samples are dead where `is_dead` says so.
    fn image<const D: usize>(dims: [usize; D], is_dead: impl Fn([usize; D]) -> bool) -> Image<D> {
        let count = dims.iter().product();
        let flags = (0..count).map(|i| is_dead(index_at(dims, i))).collect();
        Image::new(dims, vec![0.0; count], Geometry::default()).with_dead(flags)
    }

    /// Returns the share of a tetrahedron with `x[axis] < plane`, by the divided differences of the
    /// cubed distances of its corners.
    fn share_below(corners: &[[f64; 3]; 4], axis: usize, plane: f64) -> f64 {
        let x = corners.map(|c| c[axis]);
        (0..4)
            .filter(|&i| x[i] < plane)
            .map(|i| {
                let others = (0..4).filter(|j| *j != i);
                (plane - x[i]).powi(3) / others.map(|j| x[j] - x[i]).product::<f64>()
            })
            .sum()
    }

    #[test]
    fn half_spaces_are_measured_exactly() {
        for axis in 0..3 {
            let image = image([11, 12, 13], |at| at[axis] >= 6);
            let live = LiveVolume::new(&image).unwrap().unwrap();
            for seed in 0..200 {
                let corner = |i: u64| {
                    std::array::from_fn(|k| 10.0 * uniform(1, 12 * seed + 3 * i + k as u64))
                };
                let corners: [[f64; 3]; 4] = std::array::from_fn(|i| corner(i as u64));
                let expected = share_below(&corners, axis, 5.5);
                let share = live.live_share(&corners);
                assert!((share - expected).abs() < 1e-6, "{share} {expected}");
            }
        }
    }

    #[test]
    fn scattered_samples_are_measured_by_their_boxes() {
        let dims = [6, 5, 4];
        let dead = |at: [usize; 3]| uniform(2, offset_of(dims, at) as u64) < 0.3;
        let image = image(dims, dead);
        let live = LiveVolume::new(&image).unwrap().unwrap();
        // The six tetrahedra of the box of all samples, half a sample less at each side.
        let [nx, ny, nz] = dims.map(|n| n as f64 - 1.0);
        let mut share = 0.0;
        for [a, b] in [[0, 1], [0, 2], [1, 0], [1, 2], [2, 0], [2, 1]] {
            let mut corner = [0.0; 3];
            let mut corners = [corner; 4];
            for (i, k) in [a, b, 3 - a - b].into_iter().enumerate() {
                corner[k] = [nx, ny, nz][k];
                corners[i + 1] = corner;
            }
            assert!((volume6(&corners).abs() - nx * ny * nz).abs() < 1e-9);
            share += live.live_share(&corners) / 6.0;
        }
        let weight = |at: [usize; 3]| -> f64 {
            let is_end = |k: usize| at[k] == 0 || at[k] + 1 == dims[k];
            (0..3).map(|k| if is_end(k) { 0.5 } else { 1.0 }).product()
        };
        let live_samples = (0..120).map(|i| index_at(dims, i)).filter(|at| !dead(*at));
        let expected = live_samples.map(weight).sum::<f64>() / (nx * ny * nz);
        assert!((share - expected).abs() < 1e-12, "{share} {expected}");
    }

    #[test]
    fn missing_rows_and_plane_images_are_measured() {
        let rows = Image::new([9, 8, 7], vec![0.0; 504], Geometry::default());
        let rows = rows.with_missing((0..56).map(|row| row % 8 < 2).collect());
        let live = LiveVolume::new(&rows).unwrap().unwrap();
        // Half of the height of the tetrahedron above its base at y = 0.5 is live: an eighth of it.
        let share = live.live_share(&[
            [1.0, 0.5, 2.0],
            [7.0, 0.5, 2.0],
            [3.0, 2.5, 2.0],
            [3.0, 0.5, 5.0],
        ]);
        assert!((share - 0.125).abs() < 1e-12, "{share}");

        let plane = image([8, 8], |[x, _]| x < 4);
        let live = LiveVolume::new(&plane).unwrap().unwrap();
        let share = live.live_share(&[[3.5, 1.0], [5.5, 1.0], [1.5, 6.0]]);
        assert!((share - 0.5).abs() < 1e-12, "{share}");
        assert!(
            LiveVolume::new(&image([8, 8], |_| false))
                .unwrap()
                .is_none()
        );
    }
}
