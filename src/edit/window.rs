//! The part of an image around an edit.

use crate::feature::surfaces::OpenSides;
use crate::geometry::grid_index::block_rows;
use crate::image::{Geometry, Image, ScalarField};

/// A block of an image's samples, and the lattice space that it spans.
///
/// The window's own lattice space begins at its first sample. Where the window ends at a side of
/// the image, its side coincides exactly with the side of the box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EditWindow<const D: usize> {
    /// Index of the first sample along each axis.
    pub first: [usize; D],
    /// Number of samples along each axis.
    pub dims: [usize; D],
    /// For each axis, `true` if the image continues beyond the low and the high side of the window.
    pub open_sides: OpenSides<D>,
    step: [f64; D],
    /// Far corner of the box of the whole image.
    global_extent: [f64; D],
}

impl<const D: usize> EditWindow<D> {
    /// Returns the block that contains the positions from `low` to `high`, and `margin` samples
    /// beyond, in an image of `dims` samples that are `step` apart.
    pub fn from_bounds(
        low: [f64; D],
        high: [f64; D],
        margin: usize,
        dims: [usize; D],
        step: [f64; D],
        global_extent: [f64; D],
    ) -> Self {
        let first: [usize; D] = std::array::from_fn(|k| {
            // The cast turns negative values into zero.
            ((low[k] / step[k]).floor() as usize)
                .saturating_sub(margin)
                .min(dims[k] - 1)
        });
        let last: [usize; D] = std::array::from_fn(|k| {
            ((high[k] / step[k]).ceil() as usize + margin).min(dims[k] - 1)
        });
        Self {
            first,
            dims: std::array::from_fn(|k| last[k] + 1 - first[k]),
            open_sides: std::array::from_fn(|k| [first[k] > 0, last[k] + 1 < dims[k]]),
            step,
            global_extent,
        }
    }

    /// Returns the far corner of the window in its own lattice space.
    pub fn extent(&self) -> [f64; D] {
        std::array::from_fn(|k| (self.dims[k] - 1) as f64 * self.step[k])
    }

    fn origin(&self, k: usize) -> f64 {
        self.first[k] as f64 * self.step[k]
    }

    /// Converts a position in the whole box to the window's own lattice space.
    pub fn to_local(self, x: [f64; D]) -> [f64; D] {
        std::array::from_fn(|k| {
            if x[k] == self.global_extent[k] && !self.open_sides[k][1] {
                self.extent()[k]
            } else {
                x[k] - self.origin(k)
            }
        })
    }

    /// Converts a position in the window's lattice space to the whole box.
    pub fn to_global(self, x: [f64; D]) -> [f64; D] {
        std::array::from_fn(|k| {
            if x[k] == self.extent()[k] && !self.open_sides[k][1] {
                self.global_extent[k]
            } else {
                x[k] + self.origin(k)
            }
        })
    }

    /// Returns the window's samples of an image, with the default geometry: physical positions are
    /// not needed here.
    pub fn crop(&self, image: &Image<D>) -> Image<D> {
        let samples = self.crop_samples(image.dims(), image.as_slice());
        let starts = || block_rows(image.dims(), self.first, self.dims);
        let rows = starts().map(|start| start / image.dims()[0]);
        let missing = rows.filter_map(|row| image.missing.get(row).copied());
        let cropped = Image::new(self.dims, samples, Geometry::default());
        if image.dead.is_empty() {
            return cropped.with_missing(missing.collect());
        }
        let dead = starts().flat_map(|start| &image.dead[start..start + self.dims[0]]);
        cropped.with_dead(dead.copied().collect())
    }

    /// Returns the window's samples of a field.
    pub fn crop_field(&self, field: &ScalarField<D>) -> ScalarField<D> {
        ScalarField {
            dims: self.dims,
            step: field.step,
            samples: self.crop_samples(field.dims, &field.samples),
        }
    }

    fn crop_samples(&self, dims: [usize; D], samples: &[f32]) -> Vec<f32> {
        let mut block = Vec::with_capacity(self.dims.iter().product());
        for start in block_rows(dims, self.first, self.dims) {
            block.extend_from_slice(&samples[start..start + self.dims[0]]);
        }
        block
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_contains_its_samples_and_keeps_the_sides_of_the_box() {
        let (dims, step) = ([7, 6, 5], [0.1, 1.0, 3.0]);
        let global_extent: [f64; 3] = std::array::from_fn(|k| (dims[k] - 1) as f64 * step[k]);
        let samples = (0..210).map(|i| i as f32).collect();
        let image = Image::new(dims, samples, Geometry::default());
        let window = EditWindow::from_bounds(
            [0.31, 2.5, 0.0],
            [0.39, 2.6, 4.0],
            1,
            dims,
            step,
            global_extent,
        );
        assert_eq!((window.first, window.dims), ([2, 1, 0], [4, 4, 4]));
        assert_eq!(
            window.open_sides,
            [[true, true], [true, true], [false, true]]
        );
        let part = window.crop(&image);
        assert_eq!(part.as_slice()[0], 9.0);
        // Sample (1, 2, 3) of the cropped image is sample (3, 3, 3) of the whole image.
        assert_eq!(
            part.as_slice()[(3 * 4 + 2) * 4 + 1],
            ((3 * 6 + 3) * 7 + 3) as f32
        );

        let at_high_side =
            EditWindow::from_bounds([0.4; 3], [0.6, 5.0, 12.0], 1, dims, step, global_extent);
        let local = at_high_side.to_local([global_extent[0], 2.0, global_extent[2]]);
        assert_eq!(local[0], at_high_side.extent()[0]);
        assert_eq!(
            at_high_side.to_global(local),
            [global_extent[0], 2.0, global_extent[2]]
        );
    }
}
