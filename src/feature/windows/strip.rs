//! Rows and layers of windows; volumes with large layers are divided into *strips* of rows.

use super::layer_buffer::widen;
use super::layer_len;
use crate::image::layers::rows_per_layer;
use std::ops::Range;

/// The part of a volume that is processed in one window, without its halo.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WindowInterior {
    /// Range of rows along x, numbered within a layer.
    pub rows: Range<usize>,
    /// Range of layers along the last axis.
    pub layers: Range<usize>,
}

impl WindowInterior {
    /// Returns the range of cells, with `edge` samples along each edge, that this part intersects.
    pub fn in_cells(&self, edge: usize) -> Self {
        let cells = |range: &Range<usize>| range.start / edge..range.end.div_ceil(edge);
        Self {
            rows: cells(&self.rows),
            layers: cells(&self.layers),
        }
    }

    /// Returns the range of indices in memory of each layer of this part, in a volume (or a grid of
    /// cells) of `dims` samples.
    pub fn layer_index_ranges<const D: usize>(
        &self,
        dims: [usize; D],
    ) -> impl Iterator<Item = Range<usize>> + use<D> {
        let (nx, rows_in_layer, rows) = (dims[0], rows_per_layer(dims), self.rows.clone());
        let range = move |layer: usize| {
            let first = layer * rows_in_layer;
            (first + rows.start) * nx..(first + rows.end) * nx
        };
        self.layers.clone().map(range)
    }
}

/// Range of layers covered by successive windows.
#[derive(Debug, Default)]
pub struct CoveredLayers(pub Range<usize>);

impl CoveredLayers {
    /// Adds the layers of the next window.
    pub fn add(&mut self, interior: &WindowInterior) {
        let next = &interior.layers;
        if self.0.is_empty() {
            self.0 = next.clone();
        } else {
            self.0.end = next.end;
        }
    }
}

/// Divides `count` into successive ranges of about `target_len`; the lengths of all but the last
/// are a multiple of `multiple`.
pub(super) fn split_range(count: usize, target_len: usize, multiple: usize) -> Vec<Range<usize>> {
    let part_count = count.div_ceil(target_len.max(1)).max(1);
    let part_len = count.div_ceil(part_count).next_multiple_of(multiple).max(1);
    let firsts = (0..count).step_by(part_len);
    firsts
        .map(|first| first..(first + part_len).min(count))
        .collect()
}

/// Divides all layers into windows.
pub(super) fn split_layers(count: usize, layers_per_window: usize) -> Vec<Range<usize>> {
    let firsts = (0..count).step_by(layers_per_window.max(1));
    let window = |first: usize| first..(first + layers_per_window.max(1)).min(count);
    firsts.map(window).collect()
}

/// Returns the windows along a strip.
pub(super) fn strip_windows(
    rows: &Range<usize>,
    layers: Vec<Range<usize>>,
) -> impl Iterator<Item = WindowInterior> {
    let rows = rows.clone();
    layers.into_iter().map(move |layers| WindowInterior {
        rows: rows.clone(),
        layers,
    })
}

/// Returns the range from the first of some successive windows to the last.
pub(super) fn hull(windows: &[Range<usize>]) -> Range<usize> {
    match windows {
        [first, .., last] => first.start..last.end,
        [single] => single.clone(),
        [] => 0..0,
    }
}

/// A range of rows, in all layers of a volume.
pub(super) struct Strip<const D: usize> {
    /// Number of samples of the whole volume along each axis.
    volume_dims: [usize; D],
    /// Rows that are processed in this strip.
    pub interior_rows: Range<usize>,
    /// These rows and their halo.
    pub visible_rows: Range<usize>,
}

impl<const D: usize> Strip<D> {
    /// Creates the strip of these rows, with a halo of `halo_rows` rows.
    pub fn new(volume_dims: [usize; D], interior_rows: Range<usize>, halo_rows: usize) -> Self {
        let visible_rows = widen(&interior_rows, halo_rows, rows_per_layer(volume_dims));
        Self {
            volume_dims,
            interior_rows,
            visible_rows,
        }
    }

    /// Returns `true` if the strip has all rows of the volume.
    pub fn is_entire(&self) -> bool {
        self.visible_rows == (0..rows_per_layer(self.volume_dims))
    }

    /// Returns the number of samples of the strip along each axis.
    pub fn dims(&self) -> [usize; D] {
        let mut dims = self.volume_dims;
        if !self.is_entire() {
            dims[D - 2] = self.visible_rows.len();
        }
        dims
    }

    /// Returns the number of the strip's samples in a layer.
    pub fn layer_len(&self) -> usize {
        layer_len(self.dims())
    }

    /// Returns the number of all samples in a layer.
    pub fn volume_layer_len(&self) -> usize {
        layer_len(self.volume_dims)
    }

    /// Returns the strip's part of each of these whole layers.
    pub fn strip_rows<'s>(
        &self,
        layers: &'s [f32],
    ) -> impl Iterator<Item = &'s [f32]> + use<'s, D> {
        let nx = self.volume_dims[0];
        let visible = self.visible_rows.start * nx..self.visible_rows.end * nx;
        let whole_layers = layers.chunks_exact(self.volume_layer_len().max(1));
        whole_layers.map(move |layer| &layer[visible.clone()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_have_the_requested_size_and_cover_all() {
        assert_eq!(split_range(100, 30, 16), [0..32, 32..64, 64..96, 96..100]);
        assert_eq!(split_range(96, 48, 16), [0..48, 48..96]);
        assert_eq!(split_range(7, 100, 16), vec![0..7]);
        assert!(split_range(0, 5, 16).is_empty());
    }

    #[test]
    fn interior_in_samples_and_in_cells() {
        let interior = WindowInterior {
            rows: 4..9,
            layers: 8..10,
        };
        let ranges: Vec<Range<usize>> = interior.layer_index_ranges([2, 10, 20]).collect();
        assert_eq!(ranges, [168..178, 188..198]);
        let cells = interior.in_cells(4);
        assert_eq!((&cells.rows, &cells.layers), (&(1..3), &(2..3)));
        // In the plane a layer is one row, and a layer of cells is one row of cells.
        let plane = WindowInterior {
            rows: 0..1,
            layers: 8..13,
        };
        let ranges: Vec<Range<usize>> = plane.in_cells(4).layer_index_ranges([3, 5]).collect();
        assert_eq!(ranges, [6..9, 9..12]);
    }

    #[test]
    fn a_strip_has_its_rows_of_each_layer() {
        let samples: Vec<f32> = (0..2 * 10 * 3).map(|i| i as f32).collect();
        let strip = Strip::new([2, 10, 3], 4..6, 2);
        assert_eq!(
            (strip.visible_rows.clone(), strip.dims()),
            (2..8, [2, 6, 3])
        );
        let firsts: Vec<f32> = strip.strip_rows(&samples).map(|rows| rows[0]).collect();
        assert_eq!(firsts, [4.0, 24.0, 44.0]);
        // In a plane image a layer is one row.
        let plane = Strip::new([5, 7], 0..1, 3);
        assert!(plane.is_entire() && plane.dims() == [5, 7] && plane.layer_len() == 5);
    }
}
