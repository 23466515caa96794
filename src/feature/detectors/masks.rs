//! Masks of sheets, as interpreters and networks paint them: 1 to 5 samples thick, ragged, with holes and
//! stray pieces, crossing. The feature is the sheet in their middle.
//!
//! The distance to a mask's surface, positive inside, is a roof over each sheet: as sharp for a thick
//! part as for a thin one, so that the thick do not outshine the thin, and with one ridge, so that no
//! sheet is found twice. What its ridges are sought in is how sharply it bends down (the negated
//! Laplacian: the medial axis of Blum 1967, blurred by half a sample's stairs). Where sheets meet, this
//! middle bends and forks; lines of sight along the sheets, from both sides, see past it
//! ([`lifted`](mod@crate::feature::oriented_points)).
//!
//! Assumption: a mask is thinner than [`MAX_THICKNESS`] samples on average.

use super::ridges::RidgeSearch;
use super::{Detector, DetectorInput, DetectorOutput};
use crate::error::{Error, Result, cause};
use crate::feature::FeatureKind;
use crate::feature::distance_transform::signed_distance;
use crate::feature::gaussian::smooth;
use crate::feature::volume::Volume;
use crate::feature::windows::Samples;
use crate::image::check::distinct_values;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Masks thinner than this (samples) ...
const MAX_THICKNESS: f64 = 5.5;
/// ... that cover less than this share of the image ...
const MAX_IMAGE_SHARE: f64 = 0.4;
/// ... stand for the sheet in their middle, unless more than this share of their samples ...
const MAX_DEEP_SHARE: f64 = 0.02;
/// ... is deeper than this share of their thickness: half of it in a sheet, 0.63 in a tube, and 0.7 in a
/// ball.
const DEEP_THICKNESS_SHARE: f64 = 0.65;
/// Where sheets cross it bends by more, which says no more.
const MAX_SHARPNESS: f32 = 1.0;
/// Width (samples) of the Gaussian that takes the stairs off the roof.
const ROOF_SIGMA: f64 = 0.7;

/// The mask that a volume of two values is, if its middle is what counts.
pub struct ThinMask {
    /// The value of the samples in the minority.
    pub value: f32,
    /// Their share of all samples.
    pub share: f64,
    /// Mean thickness in samples: four times the mean depth.
    pub thickness: f64,
    /// The number of its samples.
    count: usize,
    /// Distance of each sample to the surface of the mask, positive inside.
    depth: Vec<f32>,
}

impl ThinMask {
    /// Takes the rarer of two values for a mask.
    pub fn from_values<const D: usize>(
        volume: Volume<'_, D>,
        [a, b]: [f32; 2],
        patience: &CancelToken<'_>,
    ) -> Self {
        let s = volume.samples;
        let count = s.iter().filter(|v| **v == b).count();
        let (value, count) = if 2 * count <= s.len() {
            (b, count)
        } else {
            (a, s.len() - count)
        };
        let depth = signed_distance(volume.dims, &value_mask(volume, value), patience);
        // Across a sheet depths go from nothing to half the thickness and back.
        let sum: f64 = depth.iter().map(|&d| f64::from(d.max(0.0))).sum();
        Self {
            value,
            share: count as f64 / s.len().max(1) as f64,
            thickness: 4.0 * sum / count.max(1) as f64,
            count,
            depth,
        }
    }

    /// Returns the mask that a volume of two values is, if it may be one of thin sheets.
    pub fn detect<const D: usize>(
        volume: Volume<'_, D>,
        values: [f32; 2],
        patience: &CancelToken<'_>,
    ) -> Option<Self> {
        let s = volume.samples;
        let count = s.iter().filter(|v| **v == values[1]).count();
        let rarer = count.min(s.len() - count);
        if rarer as f64 / s.len().max(1) as f64 >= MAX_IMAGE_SHARE {
            return None;
        }
        Some(Self::from_values(volume, values, patience)).filter(Self::is_of_thin_sheets)
    }

    fn is_of_thin_sheets(&self) -> bool {
        let deep = (DEEP_THICKNESS_SHARE * self.thickness) as f32;
        let deep = self.depth.iter().filter(|d| **d > deep).count();
        self.share < MAX_IMAGE_SHARE
            && self.thickness < MAX_THICKNESS
            && deep as f64 <= MAX_DEEP_SHARE * self.count as f64
    }

    /// Returns what is high in the into_medial_response of the mask: see [`into_medial_response`].
    fn into_medial_response<const D: usize>(
        self,
        volume: Volume<'_, D>,
        patience: &CancelToken<'_>,
    ) -> Vec<f32> {
        let inside = value_mask(volume, self.value);
        medial_response(volume.dims, &inside, self.depth, patience)
    }
}

/// Finds the middle of a mask of thin sheets.
pub struct Masks;

impl<const D: usize> Detector<D> for Masks {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Mask
    }

    fn find(
        &self,
        scene: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        if let Some(value) = scene.resolved.and_then(|settled| settled.mask) {
            return find_again(scene, value, notes);
        }
        let volume = scene.volume()?;
        let Some(&[a, b]) = distinct_values(volume.samples, 2).as_deref() else {
            return Err(Error::Feature(cause(
                "feature 'mask'",
                "the image has more than two different values",
                "choose labels, ridges or edges",
            )));
        };
        let mask = ThinMask::from_values(volume, [a, b], scene.cancel);
        notes.push(format!(
            "a mask {:.1} samples thick, {:.1} % of the volume: its middle is the feature",
            mask.thickness,
            100.0 * mask.share
        ));
        let value = mask.value;
        medial_surface(
            value,
            mask.into_medial_response(volume, scene.cancel),
            scene,
            notes,
        )
    }
}

/// Finds the middle of a mask that was found in the whole image before.
///
/// # Errors
/// Those of [`DetectorInput::image_energy`].
pub fn find_again<const D: usize>(
    scene: &DetectorInput<'_, D>,
    value: f32,
    notes: &mut Vec<String>,
) -> Result<DetectorOutput<D>> {
    let middle = value_medial_response(scene.volume()?, value, scene.cancel);
    medial_surface(value, middle, scene, notes)
}

/// The sheets in the middle of the mask of one value.
fn medial_surface<const D: usize>(
    value: f32,
    middle: Vec<f32>,
    scene: &DetectorInput<'_, D>,
    notes: &mut Vec<String>,
) -> Result<DetectorOutput<D>> {
    let search = RidgeSearch {
        min_scale: MEDIAL_SCALE,
        max_ambiguous_share: f64::INFINITY,
        min_strength_share: |_| MIN_STRENGTH_SHARE,
        ..RidgeSearch::new(scene)
    };
    Ok(DetectorOutput {
        mask_value: Some(value),
        ..search.find(Samples::in_memory(scene.dims(), middle), notes)?
    })
}

/// The scale (samples) at which the middle of a mask is sought: it is narrow, and noise has no part in it.
const MEDIAL_SCALE: f64 = 1.0;
/// Points at all angles are kept down to this share of the strong ones: without noise, more than usual.
const MIN_STRENGTH_SHARE: f32 = 0.4;

/// How sharply the roof over the mask of samples of a value bends: about 1 in the middle of a sheet.
pub fn value_medial_response<const D: usize>(
    volume: Volume<'_, D>,
    value: f32,
    patience: &CancelToken<'_>,
) -> Vec<f32> {
    let inside = value_mask(volume, value);
    let depth = signed_distance(volume.dims, &inside, patience);
    medial_response(volume.dims, &inside, depth, patience)
}

fn medial_response<const D: usize>(
    dims: [usize; D],
    inside: &[bool],
    mut roof: Vec<f32>,
    patience: &CancelToken<'_>,
) -> Vec<f32> {
    smooth(dims, &mut roof, [ROOF_SIGMA; D], patience);
    let volume = Volume::new(dims, &roof);
    let bend = |(i, &inside): (usize, &bool)| {
        if !inside {
            return 0.0;
        }
        let laplacian = volume.laplacian(volume.coordinates(i));
        (-laplacian).clamp(0.0, MAX_SHARPNESS)
    };
    inside.par_iter().enumerate().map(bend).collect()
}

fn value_mask<const D: usize>(volume: Volume<'_, D>, value: f32) -> Vec<bool> {
    volume.samples.iter().map(|s| *s == value).collect()
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{ExactSurface, Noise, image_of, measure_fit};
    use crate::feature::{DetectionOptions, FeatureKind, detect};

    fn gap_options() -> DetectionOptions<3> {
        DetectionOptions {
            gap_d_max: Some(8.0),
            ..DetectionOptions::with_kind(FeatureKind::Mask, 2.7)
        }
    }

    #[test]
    fn sheets_five_samples_thick_that_cross_have_one_middle_each() {
        let dims = [72, 64, 56];
        let (sin, cos) = 35f64.to_radians().sin_cos();
        let middle = [36.0, 32.0, 28.0];
        let sheets = [
            ExactSurface::plane([1.0, 0.1, 0.2], middle),
            ExactSurface::plane([cos, sin, 0.1], middle),
        ];
        // Frayed by noise, with a hole through one sheet and stray pieces.
        let mut noise = Noise::new(3);
        let strays: Vec<[f64; 3]> = (0..12)
            .map(|_| dims.map(|n| n as f64 * noise.uniform()))
            .collect();
        let image = image_of(dims, |p| {
            let near = |c: [f64; 3]| (0..3).map(|k| (p[k] - c[k]).powi(2)).sum::<f64>().sqrt();
            let off = |s: &ExactSurface| s.distance(p).abs();
            let thick = 2.5 + 0.2 * noise.normal();
            let painted = near([33.0, 10.0, 48.0]) > 4.0 && sheets.iter().any(|s| off(s) < thick);
            f64::from(u8::from(painted || strays.iter().any(|&c| near(c) < 1.7)))
        });
        let features = detect(&image, &gap_options()).unwrap();
        assert!(
            features.notes[0].contains("its middle"),
            "{:?}",
            features.notes
        );
        let fit = measure_fit(dims, &sheets, &features.points);
        assert!(fit.coverage > 0.92, "{fit:?}");
        assert!(fit.precision > 0.97 && fit.rms < 0.3, "{fit:?}");
    }

    #[test]
    fn many_sheets_in_a_third_of_the_volume_have_their_middles() {
        let dims = [60, 60, 48];
        let sheets: Vec<ExactSurface> = (0..7)
            .map(|i| {
                let turn = if i % 2 == 0 { 0.15 } else { -0.4 };
                ExactSurface::plane([1.0, turn, 0.1], [4.0 + 8.5 * f64::from(i), 30.0, 24.0])
            })
            .collect();
        let image = image_of(dims, |p| {
            f64::from(u8::from(sheets.iter().any(|s| s.distance(p).abs() < 1.5)))
        });
        let features = detect(&image, &gap_options()).unwrap();
        let fit = measure_fit(dims, &sheets, &features.points);
        assert!(fit.coverage > 0.93 && fit.precision > 0.97, "{fit:?}");
    }

    #[test]
    fn a_ball_is_no_thin_mask() {
        let dims = [40, 40, 40];
        let ball = [ExactSurface::Sphere([20.0; 3], 5.0)];
        let image = image_of(dims, |p| f64::from(u8::from(ball[0].distance(p) < 0.0)));
        let asked = DetectionOptions::with_kind(FeatureKind::Labels, 2.0);
        let features = detect(&image, &asked).unwrap();
        let fit = measure_fit(dims, &ball, &features.points);
        assert!(fit.coverage > 0.95 && fit.precision > 0.95, "{fit:?}");
    }

    #[test]
    fn a_thin_mask_is_one_sheet_and_not_two() {
        let (dims, sheets) = (
            [64, 60, 56],
            [ExactSurface::plane([1.0, 0.35, 0.2], [32.0, 30.0, 28.0])],
        );
        for half in [0.6, 1.5] {
            let image = image_of(dims, |p| {
                255.0 * f64::from(u8::from(sheets[0].distance(p).abs() < half))
            });
            let features =
                detect(&image, &DetectionOptions::with_kind(FeatureKind::Mask, 8.0)).unwrap();
            let fit = measure_fit(dims, &sheets, &features.points);
            assert!(
                fit.coverage > 0.99 && fit.precision > 0.99 && fit.rms < 0.25,
                "{half} {fit:?}"
            );
        }
    }
}
