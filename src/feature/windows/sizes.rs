//! How many samples windows are for.

use super::layer_buffer::SmoothingStages;
use super::strip::{Strip, split_range};
use super::{Samples, layer_len};
use crate::comm;
use crate::error::Result;
use crate::image::layers::rows_per_layer;
use crate::memory;

/// A volume of at most so many samples is smoothed as a whole ...
pub const MAX_WHOLE_SAMPLES: usize = 1 << 27;
/// ... if there is room for so many bytes a sample ...
pub(super) const WHOLE_BYTES_PER_SAMPLE: f64 = 12.0;
/// ... of others a window's own layers have about so many samples ...
const WINDOW_SAMPLES: usize = 1 << 21;
/// ... and are a multiple of these ...
pub const LAYER_MULTIPLE: usize = 16;
/// ... but have so many layers where halos are wide, for these are moved along with every window ...
pub(super) const MIN_WIDE_HALO_LAYERS: usize = 3 * LAYER_MULTIPLE;
/// ... if there is room for so many.
const MAX_WIDE_HALO_LAYERS: usize = 200;
/// Layers of more samples are looked at in strips where halos are wide, ...
const LARGE_LAYER_SAMPLES: usize = 1 << 20;
/// ... of about so many, ...
const STRIP_SAMPLES: usize = 1 << 19;
/// ... and of at least so many rows.
const MIN_STRIP_ROWS: usize = 6 * LAYER_MULTIPLE;
/// What is changed takes so many bytes a sample of a window and its halo, at most, ...
const MAP_BYTES_PER_SAMPLE: f64 = 24.0;
/// ... and what comes of it.
const RESULT_BYTES_PER_SAMPLE: f64 = 4.0;

/// What is large.
#[derive(Debug, Clone, Copy)]
pub(super) struct WindowLimits {
    /// Most samples that are smoothed as a whole, and samples of a window.
    pub max_whole: usize,
    pub window: usize,
    /// Samples of a layer that is large, and of a strip of it.
    pub large_layer: usize,
    pub strip: usize,
    /// Most samples of a window and its halo.
    pub max_with_halo: usize,
}

impl WindowLimits {
    /// About as many rows as a strip has where halos are wide: all, unless layers are large.
    fn strip_rows<const D: usize>(&self, dims: [usize; D]) -> usize {
        match layer_len(dims) <= self.large_layer {
            true => rows_per_layer(dims),
            false => (self.strip / dims[0].max(1)).max(MIN_STRIP_ROWS),
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

/// Samples of a layer that are looked at together where filters see so far, in an image that is not small.
pub fn strip_layer_samples<const D: usize>(dims: [usize; D], sees: usize) -> usize {
    let seen = (DEFAULT_LIMITS.strip_rows(dims) + 2 * sees).min(rows_per_layer(dims));
    seen * dims[0]
}

/// The least number of samples that are [changed](Samples::map_windows) together where filters see so far.
pub fn min_mapped_samples<const D: usize>(dims: [usize; D], sees: usize) -> usize {
    let seen = 3 * sees.next_multiple_of(LAYER_MULTIPLE);
    seen.min(rows_per_layer(dims)) * seen.min(dims[D - 1]) * dims[0]
}

/// Whether there is so much memory.
pub(super) fn has_memory(bytes: f64) -> bool {
    memory::ensure_available("features", bytes, "samples", "look at fewer layers").is_ok()
}

/// How far windows look: so many layers to either side under the Gaussians; and as they are, and under a Gaussian of a
/// width of their own, as many as that says.
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
    /// How many rows to either side a strip must have; a multiple, so that what goes by twos and fours of rows goes by the
    /// same ones in all strips.
    fn side_rows(&self, looks: WindowHalo) -> usize {
        let smoothed = looks.halo + SmoothingStages::new(self.pending_scales()).reach();
        let blurred = looks.blurred_halo() + SmoothingStages::new(&looks.blurs()).reach();
        smoothed.max(blurred).next_multiple_of(LAYER_MULTIPLE)
    }

    /// The strips that windows with wide halos go along: but one, unless layers are large.
    pub(super) fn strips(&self, looks: WindowHalo) -> Vec<Strip<D>> {
        let about = match looks.blur.is_none() || self.is_small() {
            true => rows_per_layer(self.dims),
            false => self.limits.strip_rows(self.dims),
        };
        self.strips_with_rows(about, looks)
    }

    /// Strips of about so many rows.
    pub(super) fn strips_with_rows(&self, about: usize, looks: WindowHalo) -> Vec<Strip<D>> {
        let beside = self.side_rows(looks);
        let strip = |own| Strip::new(self.dims, own, beside);
        let strips = split_range(rows_per_layer(self.dims), about, LAYER_MULTIPLE);
        strips.into_iter().map(strip).collect()
    }

    /// A window's own layers, with so many samples each, its halo's among them: at least so many if there is room
    /// for them.
    pub(super) fn interior_layers(&self, least: usize, layer: usize) -> Result<usize> {
        // Ranks share out windows that are not that wide better without.
        let wide = least > LAYER_MULTIPLE && comm::size() == 1;
        let ask = || {
            Ok(has_memory(
                WHOLE_BYTES_PER_SAMPLE * (MAX_WIDE_HALO_LAYERS * layer) as f64,
            ))
        };
        let least = match wide && comm::broadcast_from_root("room for layers", ask)? {
            true => least,
            false => LAYER_MULTIPLE,
        };
        Ok(self.layers_per_window(layer).max(least))
    }

    /// As many layers as a window has samples, if these are of so many.
    fn layers_per_window(&self, layer: usize) -> usize {
        let some = match self.is_small() {
            // Every rank has a share.
            true => self.limits.window.min(self.count() / comm::size()),
            false => self.limits.window,
        };
        (some / layer.max(1)).next_multiple_of(LAYER_MULTIPLE)
    }

    /// The own rows and layers of a window whose samples are changed. Those to either side are changed in vain, half of
    /// all where as many are the window's own: it has fewer only if there is no room.
    pub(super) fn mapped_interior(&self, looks: WindowHalo) -> Result<[usize; 2]> {
        let (rows, count) = (rows_per_layer(self.dims), self.dims[D - 1]);
        if self.is_small() && comm::size() == 1 {
            return Ok([rows, count]);
        }
        let sees = looks.halo.next_multiple_of(LAYER_MULTIPLE);
        let wide_layers = self.layers_per_window(layer_len(self.dims)).max(2 * sees);
        let halves = std::iter::successors(Some(rows), |rows| Some(rows / 2));
        let halves = halves.take_while(|&half| half == rows || half >= 2 * sees);
        let mut shapes: Vec<[usize; 2]> = halves.map(|rows| [rows, wide_layers]).collect();
        shapes.extend([[2 * sees; 2], [sees; 2]]);
        if self.is_small() {
            // What was smoothed as a whole is not in strips.
            shapes = vec![[rows, wide_layers], [rows, LAYER_MULTIPLE]];
        }
        let least = shapes[shapes.len() - 1];
        let beside = 2 * self.side_rows(looks);
        let kept = RESULT_BYTES_PER_SAMPLE * (self.count() / comm::size()) as f64;
        let fits = |&[own_rows, own_layers]: &[usize; 2]| {
            let seen = [(own_rows, rows), (own_layers, count)];
            let [rows, layers] = seen.map(|(own, all)| (own + beside).min(all));
            let samples = rows * layers * self.dims[0];
            let bytes = MAP_BYTES_PER_SAMPLE * samples as f64 + kept;
            samples <= self.limits.max_with_halo && has_memory(bytes)
        };
        comm::broadcast_from_root("room for layers", || {
            Ok(shapes.into_iter().find(fits).unwrap_or(least))
        })
    }
}
