//! The part of an image round an edit.

use crate::feature::surfaces::OpenSides;
use crate::image::{Geometry, Image, ScalarField};

/// A block of an image's samples, and the lattice space that it spans.
///
/// Its own lattice space begins at its first sample; where it ends with the image, its side is the
/// side of the box, exactly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EditWindow<const D: usize> {
    /// The first sample.
    pub first: [usize; D],
    /// The number of samples along each axis.
    pub dims: [usize; D],
    /// Along each axis, whether the image goes on beyond the low and the high side.
    pub open_sides: OpenSides<D>,
    step: [f64; D],
    /// The far corner of the whole box.
    global_extent: [f64; D],
}

impl<const D: usize> EditWindow<D> {
    /// The block that holds the positions from `low` to `high` in a box of samples `step` apart, and
    /// `margin` samples beyond.
    pub fn from_bounds(
        low: [f64; D],
        high: [f64; D],
        margin: usize,
        dims: [usize; D],
        step: [f64; D],
        global_extent: [f64; D],
    ) -> Self {
        let first: [usize; D] = std::array::from_fn(|k| {
            // Casts cut off at zero.
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

    /// The far corner.
    pub fn extent(&self) -> [f64; D] {
        std::array::from_fn(|k| (self.dims[k] - 1) as f64 * self.step[k])
    }

    fn origin(&self, k: usize) -> f64 {
        self.first[k] as f64 * self.step[k]
    }

    /// A position of the whole box in the window's own lattice space.
    pub fn to_local(self, x: [f64; D]) -> [f64; D] {
        std::array::from_fn(|k| {
            if x[k] == self.global_extent[k] && !self.open_sides[k][1] {
                self.extent()[k]
            } else {
                x[k] - self.origin(k)
            }
        })
    }

    /// And back.
    pub fn to_global(self, x: [f64; D]) -> [f64; D] {
        std::array::from_fn(|k| {
            if x[k] == self.extent()[k] && !self.open_sides[k][1] {
                self.global_extent[k]
            } else {
                x[k] + self.origin(k)
            }
        })
    }

    /// The block's samples of an image; where they lie in the world does not matter any more.
    pub fn crop(&self, image: &Image<D>) -> Image<D> {
        let samples = self.crop_samples(image.dims(), image.as_slice());
        let rows = self
            .row_starts(image.dims())
            .map(|start| start / image.dims()[0]);
        let missing = rows.filter_map(|row| image.missing.get(row).copied());
        let cut = Image::new(self.dims, samples, Geometry::default());
        if image.dead.is_empty() {
            return cut.with_missing(missing.collect());
        }
        let rows = self.row_starts(image.dims());
        let dead = rows.flat_map(|start| &image.dead[start..start + self.dims[0]]);
        cut.with_dead(dead.copied().collect())
    }

    /// The same of a field.
    pub fn crop_field(&self, field: &ScalarField<D>) -> ScalarField<D> {
        ScalarField {
            dims: self.dims,
            step: field.step,
            samples: self.crop_samples(field.dims, &field.samples),
        }
    }

    fn crop_samples(&self, dims: [usize; D], samples: &[f32]) -> Vec<f32> {
        let mut block = Vec::with_capacity(self.dims.iter().product());
        for start in self.row_starts(dims) {
            block.extend_from_slice(&samples[start..start + self.dims[0]]);
        }
        block
    }

    /// Where the block's rows along x begin in the memory of an image of these dims.
    fn row_starts(&self, dims: [usize; D]) -> impl Iterator<Item = usize> {
        let rows: usize = self.dims[1..].iter().product();
        (0..rows).map(move |mut rest| {
            let (mut start, mut stride) = (self.first[0], dims[0]);
            for k in 1..D {
                start += (self.first[k] + rest % self.dims[k]) * stride;
                rest /= self.dims[k];
                stride *= dims[k];
            }
            start
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_holds_its_samples_and_the_sides_of_the_box() {
        let (dims, step) = ([7, 6, 5], [0.1, 1.0, 3.0]);
        let whole: [f64; 3] = std::array::from_fn(|k| (dims[k] - 1) as f64 * step[k]);
        let samples = (0..210).map(|i| i as f32).collect();
        let image = Image::new(dims, samples, Geometry::default());
        let window =
            EditWindow::from_bounds([0.31, 2.5, 0.0], [0.39, 2.6, 4.0], 1, dims, step, whole);
        assert_eq!((window.first, window.dims), ([2, 1, 0], [4, 4, 4]));
        assert_eq!(
            window.open_sides,
            [[true, true], [true, true], [false, true]]
        );
        let part = window.crop(&image);
        assert_eq!(part.as_slice()[0], 9.0);
        // Sample (1, 2, 3) of the part is sample (3, 3, 3) of the whole.
        assert_eq!(
            part.as_slice()[(3 * 4 + 2) * 4 + 1],
            ((3 * 6 + 3) * 7 + 3) as f32
        );

        let to_the_end = EditWindow::from_bounds([0.4; 3], [0.6, 5.0, 12.0], 1, dims, step, whole);
        let local = to_the_end.to_local([whole[0], 2.0, whole[2]]);
        assert_eq!(local[0], to_the_end.extent()[0]);
        assert_eq!(to_the_end.to_global(local), [whole[0], 2.0, whole[2]]);
    }
}
