//! How many samples windows are for.

use super::held::Stages;
use super::strip::{Strip, ranges};
use super::{Samples, layer};
use crate::error::Result;
use crate::image::layers::rows;
use crate::memory;
use crate::ranks;

/// A volume of at most so many samples is smoothed as a whole ...
pub const WHOLE: usize = 1 << 27;
/// ... if there is room for so many bytes a sample ...
pub(super) const HELD: f64 = 12.0;
/// ... of others a window's own layers have about so many samples ...
const WINDOW: usize = 1 << 21;
/// ... and are a multiple of these ...
pub const MULTIPLE: usize = 16;
/// ... but have so many layers where halos are wide, for these are moved along with every window ...
pub(super) const WIDE: usize = 3 * MULTIPLE;
/// ... if there is room for so many.
const LAYERS: usize = 200;
/// Layers of more samples are looked at in strips where halos are wide, ...
const LARGE: usize = 1 << 20;
/// ... of about so many, ...
const STRIP: usize = 1 << 19;
/// ... and of at least so many rows.
const ROWS: usize = 6 * MULTIPLE;
/// What is changed takes so many bytes a sample of a window and its halo, at most, ...
const CHANGED: f64 = 24.0;
/// ... and what comes of it.
const KEPT: f64 = 4.0;

/// What is large.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Most samples that are smoothed as a whole, and samples of a window.
    pub whole: usize,
    pub window: usize,
    /// Samples of a layer that is large, and of a strip of it.
    pub layer: usize,
    pub strip: usize,
    /// Most samples of a window and its halo.
    pub seen: usize,
}

impl Limits {
    /// About as many rows as a strip has where halos are wide: all, unless layers are large.
    fn rows_of_strip<const D: usize>(&self, dims: [usize; D]) -> usize {
        match layer(dims) <= self.layer {
            true => rows(dims),
            false => (self.strip / dims[0].max(1)).max(ROWS),
        }
    }
}

pub(super) const USUAL: Limits = Limits {
    whole: WHOLE,
    window: WINDOW,
    layer: LARGE,
    strip: STRIP,
    seen: usize::MAX,
};

/// Samples of a layer that are looked at together where filters see so far, in an image that is not small.
pub fn looked_at<const D: usize>(dims: [usize; D], sees: usize) -> usize {
    let seen = (USUAL.rows_of_strip(dims) + 2 * sees).min(rows(dims));
    seen * dims[0]
}

/// The least number of samples that are [changed](Samples::changed) together where filters see so far.
pub fn changed_together<const D: usize>(dims: [usize; D], sees: usize) -> usize {
    let seen = 3 * sees.next_multiple_of(MULTIPLE);
    seen.min(rows(dims)) * seen.min(dims[D - 1]) * dims[0]
}

/// Whether there is so much memory.
pub(super) fn has_room(bytes: f64) -> bool {
    memory::afford("features", bytes, "samples", "look at fewer layers").is_ok()
}

/// How far windows look: so many layers to either side under the Gaussians; and as they are, and under a Gaussian of a
/// width of their own, as many as that says.
#[derive(Clone, Copy)]
pub(super) struct Looks {
    pub halo: usize,
    pub blur: Option<(f64, usize)>,
}

impl Looks {
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
    fn beside(&self, looks: Looks) -> usize {
        let smoothed = looks.halo + Stages::new(self.scales_left()).reach();
        let blurred = looks.blurred_halo() + Stages::new(&looks.blurs()).reach();
        smoothed.max(blurred).next_multiple_of(MULTIPLE)
    }

    /// The strips that windows with wide halos go along: but one, unless layers are large.
    pub(super) fn strips(&self, looks: Looks) -> Vec<Strip<D>> {
        let about = match looks.blur.is_none() || self.is_small() {
            true => rows(self.dims),
            false => self.limits.rows_of_strip(self.dims),
        };
        self.strips_of(about, looks)
    }

    /// Strips of about so many rows.
    pub(super) fn strips_of(&self, about: usize, looks: Looks) -> Vec<Strip<D>> {
        let beside = self.beside(looks);
        let strip = |own| Strip::new(self.dims, own, beside);
        let strips = ranges(rows(self.dims), about, MULTIPLE);
        strips.into_iter().map(strip).collect()
    }

    /// A window's own layers, with so many samples each, its halo's among them: at least so many if there is room
    /// for them.
    pub(super) fn own_layers(&self, least: usize, layer: usize) -> Result<usize> {
        // Ranks share out windows that are not that wide better without.
        let wide = least > MULTIPLE && ranks::count() == 1;
        let ask = || Ok(has_room(HELD * (LAYERS * layer) as f64));
        let least = match wide && ranks::of_first("room for layers", ask)? {
            true => least,
            false => MULTIPLE,
        };
        Ok(self.about_window(layer).max(least))
    }

    /// As many layers as a window has samples, if these are of so many.
    fn about_window(&self, layer: usize) -> usize {
        let some = match self.is_small() {
            // Every rank has a share.
            true => self.limits.window.min(self.count() / ranks::count()),
            false => self.limits.window,
        };
        (some / layer.max(1)).next_multiple_of(MULTIPLE)
    }

    /// The own rows and layers of a window whose samples are changed. Those to either side are changed in vain, half of
    /// all where as many are the window's own: it has fewer only if there is no room.
    pub(super) fn own_of_changed(&self, looks: Looks) -> Result<[usize; 2]> {
        let (rows, count) = (rows(self.dims), self.dims[D - 1]);
        if self.is_small() && ranks::count() == 1 {
            return Ok([rows, count]);
        }
        let sees = looks.halo.next_multiple_of(MULTIPLE);
        let wide_layers = self.about_window(layer(self.dims)).max(2 * sees);
        let halves = std::iter::successors(Some(rows), |rows| Some(rows / 2));
        let halves = halves.take_while(|&half| half == rows || half >= 2 * sees);
        let mut shapes: Vec<[usize; 2]> = halves.map(|rows| [rows, wide_layers]).collect();
        shapes.extend([[2 * sees; 2], [sees; 2]]);
        if self.is_small() {
            // What was smoothed as a whole is not in strips.
            shapes = vec![[rows, wide_layers], [rows, MULTIPLE]];
        }
        let least = shapes[shapes.len() - 1];
        let beside = 2 * self.beside(looks);
        let kept = KEPT * (self.count() / ranks::count()) as f64;
        let fits = |&[own_rows, own_layers]: &[usize; 2]| {
            let seen = [(own_rows, rows), (own_layers, count)];
            let [rows, layers] = seen.map(|(own, all)| (own + beside).min(all));
            let samples = rows * layers * self.dims[0];
            let bytes = CHANGED * samples as f64 + kept;
            samples <= self.limits.seen && has_room(bytes)
        };
        ranks::of_first("room for layers", || {
            Ok(shapes.into_iter().find(fits).unwrap_or(least))
        })
    }
}
