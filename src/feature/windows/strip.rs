//! Which samples a window is for: some layers, of a volume with large ones in *strips* of their rows.

use super::layer_buffer::widen;
use super::layer_len;
use crate::image::layers::rows_per_layer;
use std::ops::Range;

/// A window's own part of a volume.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WindowInterior {
    /// Rows along x, numbered in a layer.
    pub rows: Range<usize>,
    /// Layers along the last axis.
    pub layers: Range<usize>,
}

impl WindowInterior {
    /// The cells that it meets, of cells with so many samples along an edge.
    pub fn in_cells(&self, edge: usize) -> Self {
        let met = |range: &Range<usize>| range.start / edge..range.end.div_ceil(edge);
        Self {
            rows: met(&self.rows),
            layers: met(&self.layers),
        }
    }

    /// The indices in memory of its samples of each layer, where the volume (or the grid of cells) has so many.
    pub fn layer_index_ranges<const D: usize>(
        &self,
        dims: [usize; D],
    ) -> impl Iterator<Item = Range<usize>> + use<D> {
        let (nx, of_layer, own) = (dims[0], rows_per_layer(dims), self.rows.clone());
        let range = move |layer: usize| {
            let first = layer * of_layer;
            (first + own.start) * nx..(first + own.end) * nx
        };
        self.layers.clone().map(range)
    }
}

/// The layers of windows, one above the other, that were looked at.
#[derive(Debug, Default)]
pub struct CoveredLayers(pub Range<usize>);

impl CoveredLayers {
    /// Adds those of the next window.
    pub fn add(&mut self, own: &WindowInterior) {
        let next = &own.layers;
        match self.0.is_empty() {
            true => self.0 = next.clone(),
            false => self.0.end = next.end,
        }
    }
}

/// Ranges of about so many, one after the other: all but the last have a multiple of `multiple`.
pub(super) fn split_range(count: usize, about: usize, multiple: usize) -> Vec<Range<usize>> {
    let some = count.div_ceil(about.max(1)).max(1);
    let each = count.div_ceil(some).next_multiple_of(multiple).max(1);
    let firsts = (0..count).step_by(each);
    firsts
        .map(|first| first..(first + each).min(count))
        .collect()
}

/// All layers, so many at a time.
pub(super) fn split_layers(count: usize, own: usize) -> Vec<Range<usize>> {
    let firsts = (0..count).step_by(own.max(1));
    let part = |first: usize| first..(first + own.max(1)).min(count);
    firsts.map(part).collect()
}

/// Windows along a strip.
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

/// From the first of some windows, one after the other, to the last.
pub(super) fn hull(windows: &[Range<usize>]) -> Range<usize> {
    match windows {
        [first, .., last] => first.start..last.end,
        [one] => one.clone(),
        [] => 0..0,
    }
}

/// Rows of all layers of a volume.
pub(super) struct Strip<const D: usize> {
    /// Samples of the whole volume along each axis.
    volume_dims: [usize; D],
    /// Those in which windows are.
    pub interior_rows: Range<usize>,
    /// Those and others to either side.
    pub visible_rows: Range<usize>,
}

impl<const D: usize> Strip<D> {
    /// These rows, and so many to either side.
    pub fn new(volume_dims: [usize; D], interior_rows: Range<usize>, beside: usize) -> Self {
        let visible_rows = widen(&interior_rows, beside, rows_per_layer(volume_dims));
        Self {
            volume_dims,
            interior_rows,
            visible_rows,
        }
    }

    /// Whether it is all there is.
    pub fn is_entire(&self) -> bool {
        self.visible_rows == (0..rows_per_layer(self.volume_dims))
    }

    /// Its samples along each axis.
    pub fn dims(&self) -> [usize; D] {
        let mut dims = self.volume_dims;
        if !self.is_entire() {
            dims[D - 2] = self.visible_rows.len();
        }
        dims
    }

    /// Its samples of a layer.
    pub fn layer_len(&self) -> usize {
        layer_len(self.dims())
    }

    /// All samples of a layer.
    pub fn volume_layer_len(&self) -> usize {
        layer_len(self.volume_dims)
    }

    /// What it has of each of these whole layers.
    pub fn strip_rows<'s>(
        &self,
        layers: &'s [f32],
    ) -> impl Iterator<Item = &'s [f32]> + use<'s, D> {
        let nx = self.volume_dims[0];
        let own = self.visible_rows.start * nx..self.visible_rows.end * nx;
        let each = layers.chunks_exact(self.volume_layer_len().max(1));
        each.map(move |layer| &layer[own.clone()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_as_many_as_asked_for_and_cover_all() {
        assert_eq!(split_range(100, 30, 16), [0..32, 32..64, 64..96, 96..100]);
        assert_eq!(split_range(96, 48, 16), [0..48, 48..96]);
        assert_eq!(split_range(7, 100, 16), vec![0..7]);
        assert!(split_range(0, 5, 16).is_empty());
    }

    #[test]
    fn what_is_a_windows_own_in_samples_and_in_cells() {
        let own = WindowInterior {
            rows: 4..9,
            layers: 8..10,
        };
        let of_layers: Vec<Range<usize>> = own.layer_index_ranges([2, 10, 20]).collect();
        assert_eq!(of_layers, [168..178, 188..198]);
        let cells = own.in_cells(4);
        assert_eq!((&cells.rows, &cells.layers), (&(1..3), &(2..3)));
        // In the plane a layer is one row, and so is one of cells.
        let plane = WindowInterior {
            rows: 0..1,
            layers: 8..13,
        };
        let of_layers: Vec<Range<usize>> = plane.in_cells(4).layer_index_ranges([3, 5]).collect();
        assert_eq!(of_layers, [6..9, 9..12]);
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
        // Of a plane image a layer is one row.
        let plane = Strip::new([5, 7], 0..1, 3);
        assert!(plane.is_entire() && plane.dims() == [5, 7] && plane.layer_len() == 5);
    }
}
