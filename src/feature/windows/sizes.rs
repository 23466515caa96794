//! Sizes of windows and strips.

use super::layer_buffer::SmoothingStages;
use super::strip::{Strip, split_range};
use super::{Samples, layer_len};
use crate::error::Result;
use crate::image::layers::rows_per_layer;
use crate::memory;

/// Largest number of samples of a volume that is smoothed as a whole.
pub const MAX_WHOLE_SAMPLES: usize = 1 << 27;
/// Memory per sample (bytes) that must be available to smooth a volume as a whole.
pub(super) const WHOLE_BYTES_PER_SAMPLE: f64 = 12.0;
/// Approximate number of samples in the interior layers of a window of a large volume.
const WINDOW_SAMPLES: usize = 1 << 21;
/// The number of interior layers is a multiple of this.
pub const LAYER_MULTIPLE: usize = 16;
/// Smallest number of interior layers if halos are wide, because the halo is moved with every
/// window.
pub(super) const MIN_WIDE_HALO_LAYERS: usize = 3 * LAYER_MULTIPLE;
/// Number of layers for which there must be memory if halos are wide.
const MAX_WIDE_HALO_LAYERS: usize = 200;
/// Number of samples of a layer above which it is divided into strips, if halos are wide.
const LARGE_LAYER_SAMPLES: usize = 1 << 20;
/// Approximate number of samples of a strip in a layer.
const STRIP_SAMPLES: usize = 1 << 19;
/// Smallest number of rows of a strip.
const MIN_STRIP_ROWS: usize = 6 * LAYER_MULTIPLE;
/// Largest memory (bytes) per sample of a window and its halo while samples are mapped.
const MAP_BYTES_PER_SAMPLE: f64 = 24.0;
/// Memory (bytes) per sample of the mapped result.
const RESULT_BYTES_PER_SAMPLE: f64 = 4.0;

/// Limits that decide on the sizes of windows and strips.
#[derive(Debug, Clone, Copy)]
pub(super) struct WindowLimits {
    /// Largest number of samples that are smoothed as a whole, and number of samples of a window.
    pub max_whole: usize,
    pub window: usize,
    /// Number of samples above which a layer is large, and number of samples of a strip in a layer.
    pub large_layer: usize,
    pub strip: usize,
    /// Largest number of samples of a window with its halo.
    pub max_with_halo: usize,
}

impl WindowLimits {
    /// Returns the approximate number of rows of a strip if halos are wide: all rows, unless layers
    /// are large.
    fn strip_rows<const D: usize>(&self, dims: [usize; D]) -> usize {
        if layer_len(dims) <= self.large_layer {
            rows_per_layer(dims)
        } else {
            (self.strip / dims[0].max(1)).max(MIN_STRIP_ROWS)
        }
    }
}

pub(super) const DEFAULT_LIMITS: WindowLimits = WindowLimits {
    max_whole: MAX_WHOLE_SAMPLES,
    window: WINDOW_SAMPLES,
    large_layer: LARGE_LAYER_SAMPLES,
    strip: STRIP_SAMPLES,
    max_with_halo: usize::MAX,
};

/// Returns the number of samples of a layer that are in memory together if filters look `reach`
/// samples far and the image is not small.
pub fn strip_layer_samples<const D: usize>(dims: [usize; D], reach: usize) -> usize {
    let visible_rows = (DEFAULT_LIMITS.strip_rows(dims) + 2 * reach).min(rows_per_layer(dims));
    visible_rows * dims[0]
}

/// Returns the smallest number of samples that are [mapped](Samples::map_windows) together if
/// filters look `reach` samples far.
pub fn min_mapped_samples<const D: usize>(dims: [usize; D], reach: usize) -> usize {
    let edge = 3 * reach.next_multiple_of(LAYER_MULTIPLE);
    edge.min(rows_per_layer(dims)) * edge.min(dims[D - 1]) * dims[0]
}

/// Returns `true` if this much memory is available.
pub(super) fn has_memory(bytes: f64) -> bool {
    memory::ensure_available("features", bytes, "samples", "look at fewer layers").is_ok()
}

/// Widths of halos: `halo` layers of smoothed samples; and, if `blur` is (width, reach), `reach`
/// layers of unsmoothed samples and of samples under a Gaussian of this width.
#[derive(Clone, Copy)]
pub(super) struct WindowHalo {
    pub halo: usize,
    pub blur: Option<(f64, usize)>,
}

impl WindowHalo {
    pub fn blurs(&self) -> Vec<f64> {
        self.blur.iter().map(|blur| blur.0).collect()
    }

    pub fn blurred_halo(&self) -> usize {
        self.blur.map_or(self.halo, |blur| blur.1)
    }
}

impl<const D: usize> Samples<'_, D> {
    /// Returns the number of rows to either side that a strip needs. It is a multiple, so that
    /// algorithms that combine rows in twos and fours combine the same ones in all strips.
    fn side_rows(&self, window_halo: WindowHalo) -> usize {
        let smoothed = window_halo.halo + SmoothingStages::new(self.pending_scales()).reach();
        let blurred =
            window_halo.blurred_halo() + SmoothingStages::new(&window_halo.blurs()).reach();
        smoothed.max(blurred).next_multiple_of(LAYER_MULTIPLE)
    }

    /// Returns the strips for windows with wide halos: a single one, unless layers are large.
    pub(super) fn strips(&self, window_halo: WindowHalo) -> Vec<Strip<D>> {
        let rows_per_strip = if window_halo.blur.is_none() || self.is_small() {
            rows_per_layer(self.grid.dims)
        } else {
            self.limits.strip_rows(self.grid.dims)
        };
        self.strips_with_rows(rows_per_strip, window_halo)
    }

    /// Returns strips of about `rows_per_strip` rows.
    pub(super) fn strips_with_rows(
        &self,
        rows_per_strip: usize,
        window_halo: WindowHalo,
    ) -> Vec<Strip<D>> {
        let side_rows = self.side_rows(window_halo);
        let strip = |interior_rows| Strip::new(self.grid.dims, interior_rows, side_rows);
        let strips = split_range(
            rows_per_layer(self.grid.dims),
            rows_per_strip,
            LAYER_MULTIPLE,
        );
        strips.into_iter().map(strip).collect()
    }

    /// Returns the number of interior layers of a window, if a layer has `layer_samples` samples,
    /// those of the halo included: at least `min_layers` if there is memory for them.
    pub(super) fn interior_layers(&self, min_layers: usize, layer_samples: usize) -> Result<usize> {
        // With several ranks, windows of fewer layers are distributed more evenly.
        let has_wide_halo = min_layers > LAYER_MULTIPLE && !self.grid.is_shared();
        let has_room =
            || has_memory(WHOLE_BYTES_PER_SAMPLE * (MAX_WIDE_HALO_LAYERS * layer_samples) as f64);
        let min_layers = if has_wide_halo && self.grid.chosen("room for layers", has_room)? {
            min_layers
        } else {
            LAYER_MULTIPLE
        };
        Ok(self.layers_per_window(layer_samples).max(min_layers))
    }

    /// Returns the number of interior layers of a window, if a layer has `layer_samples` samples.
    fn layers_per_window(&self, layer_samples: usize) -> usize {
        let window_samples = if self.is_small() {
            // Every rank has a share.
            self.limits.window.min(self.grid.samples_per_rank())
        } else {
            self.limits.window
        };
        (window_samples / layer_samples.max(1)).next_multiple_of(LAYER_MULTIPLE)
    }

    /// Returns the interior rows and layers of a window in which samples are mapped. The samples of
    /// the halo are mapped and then discarded: half of all, if the halo is half as wide as the interior. The
    /// interior is smaller only if memory is short.
    pub(super) fn mapped_interior(&self, window_halo: WindowHalo) -> Result<[usize; 2]> {
        let (rows, count) = (rows_per_layer(self.grid.dims), self.grid.dims[D - 1]);
        if self.is_small() && !self.grid.is_shared() {
            return Ok([rows, count]);
        }
        let reach = window_halo.halo.next_multiple_of(LAYER_MULTIPLE);
        let wide_layers = self
            .layers_per_window(layer_len(self.grid.dims))
            .max(2 * reach);
        let halves = std::iter::successors(Some(rows), |rows| Some(rows / 2));
        let halves = halves.take_while(|&half| half == rows || half >= 2 * reach);
        let mut shapes: Vec<[usize; 2]> = halves.map(|rows| [rows, wide_layers]).collect();
        shapes.extend([[2 * reach; 2], [reach; 2]]);
        if self.is_small() {
            // A volume that was smoothed as a whole is not divided into strips.
            shapes = vec![[rows, wide_layers], [rows, LAYER_MULTIPLE]];
        }
        let smallest = shapes[shapes.len() - 1];
        let halo_rows = 2 * self.side_rows(window_halo);
        let result_bytes = RESULT_BYTES_PER_SAMPLE * self.grid.samples_per_rank() as f64;
        let fits = |&[own_rows, own_layers]: &[usize; 2]| {
            let extents = [(own_rows, rows), (own_layers, count)];
            let [rows, layers] = extents.map(|(interior, total)| (interior + halo_rows).min(total));
            let samples = rows * layers * self.grid.dims[0];
            let bytes = MAP_BYTES_PER_SAMPLE * samples as f64 + result_bytes;
            samples <= self.limits.max_with_halo && has_memory(bytes)
        };
        let choose = || shapes.into_iter().find(fits).unwrap_or(smallest);
        self.grid.chosen("room for layers", choose)
    }
}
