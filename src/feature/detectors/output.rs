//! Output of a detector: candidates, thresholds, and what else it learned about the image.

use std::fmt;
use std::ops::Range;

use super::labels;
use crate::error::Result;
use crate::feature::candidate::Candidate;
use crate::feature::chaos::ChaoticZones;
use crate::feature::label_map::LabelMap;
use crate::feature::{FeatureKind, SharedGrid};
use crate::image::Image;

/// Thresholds of strength for hysteresis (Canny 1986).
#[derive(Debug, Clone, Copy)]
pub struct Thresholds {
    /// Strength down to which a surface is followed.
    pub low: f32,
    /// Strength that a surface must reach somewhere.
    pub high: f32,
    /// Origin of the thresholds, in one or two words.
    pub origin: &'static str,
}

impl fmt::Display for Thresholds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { low, high, origin } = self;
        write!(
            f,
            "threshold {high:.4} ({origin}), down to {low:.4} where they continue"
        )
    }
}

/// Output of a detector.
#[derive(Debug, Clone)]
pub struct DetectorOutput<const D: usize> {
    /// Points that may lie on features, in the order of samples.
    pub candidates: Vec<Candidate<D>>,
    /// Points on possible faults that dip too little, in the order of samples.
    pub flat_candidates: Vec<Candidate<D>>,
    /// Layers of which this rank has all candidates, if ranks share the candidates; `None` if every
    /// rank has all candidates.
    pub layers: Option<Range<usize>>,
    /// Width (samples) of the Gaussian under which they were found.
    pub scale: f64,
    /// Thresholds that decide which candidates form surfaces.
    pub thresholds: Thresholds,
    /// Typical strength of ridges divided by that of noise, if it was measured.
    pub signal_to_noise: Option<f32>,
    /// `true` if normals are known to a few degrees, so that they distinguish surfaces that cross
    /// at shallow angles.
    pub has_sharp_normals: bool,
    /// Axis that is vertical, if no coordinate is time.
    pub vertical_axis: usize,
    /// Value of the thin mask whose medial surface was searched for.
    pub mask_value: Option<f32>,
    /// Values of isosurfaces, in ascending order, if there are several.
    pub levels: Vec<f32>,
    /// For labels: the winning labels, and the distance between atoms in each component.
    pub labels: Option<(LabelMap<D>, labels::LabelSpacing<D>)>,
    /// Share of the image in chaotic zones, whose candidates are dropped; `None` if there are none.
    pub chaotic_share: Option<f64>,
    /// For paths: the share of the paths that pass each sample.
    pub confidence: Option<Vec<f32>>,
}

impl<const D: usize> DetectorOutput<D> {
    /// Creates an output of candidates without further results.
    pub fn new(candidates: Vec<Candidate<D>>, scale: f64, thresholds: Thresholds) -> Self {
        Self {
            candidates,
            flat_candidates: Vec::new(),
            layers: None,
            scale,
            thresholds,
            signal_to_noise: None,
            has_sharp_normals: false,
            vertical_axis: D - 1,
            mask_value: None,
            levels: Vec::new(),
            labels: None,
            chaotic_share: None,
            confidence: None,
        }
    }

    /// Takes the candidates of all ranks. Neither they nor flat candidates are distributed afterwards.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn gather_candidates(&mut self, grid: SharedGrid<'_, D>) -> Result<Vec<Candidate<D>>> {
        let local = std::mem::take(&mut self.candidates);
        if self.layers.take().is_none() {
            return Ok(local);
        }
        let flat = std::mem::take(&mut self.flat_candidates);
        self.flat_candidates = grid.concatenated("flat candidates", flat)?;
        grid.concatenated("candidates", local)
    }

    /// Drops candidates in chaotic zones, unless `keep_chaos` is set. `kind` is what is searched for.
    pub fn drop_chaotic(
        &mut self,
        zones: Option<&ChaoticZones<D>>,
        kind: FeatureKind,
        keep_chaos: bool,
        notes: &mut Vec<String>,
    ) {
        let Some(zones) = zones else { return };
        let share = 100.0 * zones.share;
        if keep_chaos {
            notes.push(format!(
                "{share:.1} % of the image is chaotic (salt, gas, noise): do not trust {kind} there"
            ));
            return;
        }
        for candidates in [&mut self.candidates, &mut self.flat_candidates] {
            candidates.retain(|c| !zones.contains(c.position));
        }
        self.chaotic_share = Some(zones.share);
        notes.push(format!(
            "{share:.1} % of the image is chaotic (salt, gas, noise), and no {kind} are searched for there; --keep-chaos \
                 searches there, too"
        ));
    }

    /// Drops candidates at missing traces, and those so near that smoothing mixes real samples with
    /// filled ones.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn drop_near_missing_data(
        &mut self,
        image: &Image<D>,
        beyond_smoothing: f64,
        notes: &mut Vec<String>,
        grid: SharedGrid<'_, D>,
    ) -> Result<()> {
        let reach = (3.0 * self.scale).ceil() + beyond_smoothing;
        let is_near_missing = image.rows_near_missing(reach);
        if is_near_missing.is_empty() {
            return Ok(());
        }
        let row = |c: &Candidate<D>| c.voxel.index() / image.dims()[0];
        let dropped = self.candidates.iter().map(row);
        let mut dropped = dropped
            .filter(|&r| is_near_missing[r] && !image.missing[r])
            .count();
        if self.layers.is_some() {
            [dropped] = grid.sum("candidates dropped", [dropped])?;
        }
        for candidates in [&mut self.candidates, &mut self.flat_candidates] {
            candidates.retain(|c| !is_near_missing[row(c)]);
        }
        notes.push(format!(
            "{dropped} points are dropped, because they lie within {reach} samples of missing traces"
        ));
        Ok(())
    }
}
