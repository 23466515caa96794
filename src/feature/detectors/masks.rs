//! Masks of thin surfaces, as interpreters and networks paint them: 1 to 5 samples thick, ragged,
//! crossing, with holes and stray fragments. The feature is the medial surface of the mask.
//!
//! The distance to a mask's surface, positive inside, has the shape of a roof over each surface. It
//! is as sharp for a thick part as for a thin one, so that thick parts do not dominate, and it has
//! a single ridge, so that no surface is found twice. Ridges are searched for in the negated Laplacian of
//! this distance (the medial axis of Blum 1967, blurred because samples are steps of half a
//! sample). Where surfaces meet, the medial surface bends and branches; oriented filters along the
//! surfaces ([`oriented`](mod@crate::feature::oriented)) continue it from both sides.
//!
//! Assumption: a mask is thinner than [`MAX_THICKNESS`] samples on average.

use super::ridges::RidgeSearch;
use super::{Detector, DetectorInput, DetectorOutput, ThresholdMeaning};
use crate::error::{Error, Result, cause};
use crate::feature::FeatureKind;
use crate::feature::distance_transform::signed_distance;
use crate::feature::gaussian::smooth;
use crate::feature::volume::Volume;
use crate::feature::windows::Samples;
use crate::image::check::distinct_values;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Largest mean thickness (samples) of a thin mask.
const MAX_THICKNESS: f64 = 5.5;
/// Largest share of the image that a thin mask covers.
const MAX_IMAGE_SHARE: f64 = 0.4;
/// Largest share of a thin mask's samples that are deep.
const MAX_DEEP_SHARE: f64 = 0.02;
/// Depth of a deep sample, as a share of the mean thickness. The largest depth is 0.5 of it in a
/// thin surface, 0.63 in a tube, and 0.7 in a ball.
const DEEP_THICKNESS_SHARE: f64 = 0.65;
/// Largest value of the negated Laplacian: it is larger only where surfaces cross, which carries no
/// information.
const MAX_SHARPNESS: f32 = 1.0;
/// Width (samples) of the Gaussian that smooths the steps of the distance.
const ROOF_SIGMA: f64 = 0.7;

/// A mask of one of the two values of a volume.
pub struct ThinMask {
    /// Value of the samples in the minority.
    pub value: f32,
    /// Share of the mask in all samples.
    pub share: f64,
    /// Mean thickness in samples: four times the mean depth.
    pub thickness: f64,
    /// Number of samples of the mask.
    count: usize,
    /// Distance of each sample to the surface of the mask, positive inside.
    depth: Vec<f32>,
}

impl ThinMask {
    /// Takes the rarer of two values for the mask.
    pub fn from_values<const D: usize>(
        volume: Volume<'_, D>,
        [a, b]: [f32; 2],
        cancel: &CancelToken<'_>,
    ) -> Self {
        let s = volume.samples;
        let count = s.iter().filter(|v| **v == b).count();
        let (value, count) = if 2 * count <= s.len() {
            (b, count)
        } else {
            (a, s.len() - count)
        };
        let depth = signed_distance(volume.dims, &value_mask(volume, value), cancel);
        // Across a surface, depths rise from 0 to half the thickness and fall again.
        let sum: f64 = depth.iter().map(|&d| f64::from(d.max(0.0))).sum();
        Self {
            value,
            share: count as f64 / s.len().max(1) as f64,
            thickness: 4.0 * sum / count.max(1) as f64,
            count,
            depth,
        }
    }

    /// Returns the mask of a volume of two values if it may be a mask of thin surfaces.
    pub fn detect<const D: usize>(
        volume: Volume<'_, D>,
        values: [f32; 2],
        cancel: &CancelToken<'_>,
    ) -> Option<Self> {
        let s = volume.samples;
        let count = s.iter().filter(|v| **v == values[1]).count();
        let rarer = count.min(s.len() - count);
        if rarer as f64 / s.len().max(1) as f64 >= MAX_IMAGE_SHARE {
            return None;
        }
        Some(Self::from_values(volume, values, cancel)).filter(Self::is_of_thin_surfaces)
    }

    fn is_of_thin_surfaces(&self) -> bool {
        let deep = (DEEP_THICKNESS_SHARE * self.thickness) as f32;
        let deep = self.depth.iter().filter(|d| **d > deep).count();
        self.share < MAX_IMAGE_SHARE
            && self.thickness < MAX_THICKNESS
            && deep as f64 <= MAX_DEEP_SHARE * self.count as f64
    }

    /// Returns an image whose ridges are the medial surface of the mask; see [`medial_response`].
    fn into_medial_response<const D: usize>(
        self,
        volume: Volume<'_, D>,
        cancel: &CancelToken<'_>,
    ) -> Vec<f32> {
        let inside = value_mask(volume, self.value);
        medial_response(volume.dims, &inside, self.depth, cancel)
    }
}

/// Detector of the medial surface of a mask of thin surfaces.
pub struct Masks;

impl<const D: usize> Detector<D> for Masks {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Mask
    }

    /// Returns `false`: between the two values of a mask, no value makes sense.
    fn fills_gaps(&self) -> bool {
        false
    }

    fn threshold_meaning(&self) -> ThresholdMeaning {
        ThresholdMeaning::Unused
    }

    fn suggestion_in_doubt(&self) -> &'static str {
        "follows the middle of painted lines; --feature labels confirms solid objects"
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        if let Some(value) = input.resolved.and_then(|resolved| resolved.mask) {
            return find_again(input, value, notes);
        }
        let volume = input.volume()?;
        let Some(&[a, b]) = distinct_values(volume.samples, 2).as_deref() else {
            return Err(Error::Feature(cause(
                "feature 'mask'",
                "the image has more than two different values",
                "choose --feature labels, ridges or edges",
            )));
        };
        let mask = ThinMask::from_values(volume, [a, b], input.cancel);
        notes.push(format!(
            "the image has two values; the rarer one is painted {:.1} samples thick, on {:.1} % of the samples, and the \
             mesh follows the middle of this paint",
            mask.thickness,
            100.0 * mask.share
        ));
        let value = mask.value;
        medial_surface(
            value,
            mask.into_medial_response(volume, input.cancel),
            input,
            notes,
        )
    }
}

/// Finds the medial surface of a mask in a part of an image, whose whole had a mask of this value.
///
/// # Errors
/// Returns the errors of [`DetectorInput::image`].
pub fn find_again<const D: usize>(
    input: &DetectorInput<'_, D>,
    value: f32,
    notes: &mut Vec<String>,
) -> Result<DetectorOutput<D>> {
    let response = value_medial_response(input.volume()?, value, input.cancel);
    medial_surface(value, response, input, notes)
}

/// Finds the ridges of `response`, the medial surface of the mask of one value.
fn medial_surface<const D: usize>(
    value: f32,
    response: Vec<f32>,
    input: &DetectorInput<'_, D>,
    notes: &mut Vec<String>,
) -> Result<DetectorOutput<D>> {
    let search = RidgeSearch {
        min_scale: MEDIAL_SCALE,
        max_ambiguous_share: f64::INFINITY,
        min_strength_share: |_| MIN_STRENGTH_SHARE,
        ..RidgeSearch::new(input)
    };
    let samples = Samples::in_memory(input.dims(), response).with_grid(input.grid);
    Ok(DetectorOutput {
        mask_value: Some(value),
        ..search.find(samples, notes)?
    })
}

/// Scale (samples) at which the medial surface is searched for: it is narrow, and there is no noise.
const MEDIAL_SCALE: f64 = 1.0;
/// Strength, as a share of that of strong points, down to which points of oriented filters are
/// kept: lower than usual, because there is no noise.
const MIN_STRENGTH_SHARE: f32 = 0.4;

/// Returns how sharply the distance to the surface of a mask bends: about 1 on the medial surface.
/// The mask is that of the samples of one value.
pub fn value_medial_response<const D: usize>(
    volume: Volume<'_, D>,
    value: f32,
    cancel: &CancelToken<'_>,
) -> Vec<f32> {
    let inside = value_mask(volume, value);
    let depth = signed_distance(volume.dims, &inside, cancel);
    medial_response(volume.dims, &inside, depth, cancel)
}

fn medial_response<const D: usize>(
    dims: [usize; D],
    inside: &[bool],
    mut roof: Vec<f32>,
    cancel: &CancelToken<'_>,
) -> Vec<f32> {
    smooth(dims, &mut roof, [ROOF_SIGMA; D], cancel);
    let volume = Volume::new(dims, &roof);
    let sharpness = |(i, &inside): (usize, &bool)| {
        if !inside {
            return 0.0;
        }
        let laplacian = volume.laplacian(volume.coordinates(i));
        (-laplacian).clamp(0.0, MAX_SHARPNESS)
    };
    inside.par_iter().enumerate().map(sharpness).collect()
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
    fn thick_surfaces_that_cross_have_one_medial_surface_each() {
        let dims = [72, 64, 56];
        let (sin, cos) = 35f64.to_radians().sin_cos();
        let middle = [36.0, 32.0, 28.0];
        let surfaces = [
            ExactSurface::plane([1.0, 0.1, 0.2], middle),
            ExactSurface::plane([cos, sin, 0.1], middle),
        ];
        // Ragged by noise, with a hole through one surface and stray fragments.
        let mut noise = Noise::new(3);
        let specks: Vec<[f64; 3]> = (0..12)
            .map(|_| dims.map(|n| n as f64 * noise.uniform()))
            .collect();
        let image = image_of(dims, |p| {
            let distance_to =
                |c: [f64; 3]| (0..3).map(|k| (p[k] - c[k]).powi(2)).sum::<f64>().sqrt();
            let distance = |s: &ExactSurface| s.distance(p).abs();
            let thick = 2.5 + 0.2 * noise.normal();
            let painted = distance_to([33.0, 10.0, 48.0]) > 4.0
                && surfaces.iter().any(|s| distance(s) < thick);
            f64::from(u8::from(
                painted || specks.iter().any(|&c| distance_to(c) < 1.7),
            ))
        });
        let features = detect(&image, &gap_options()).unwrap();
        assert!(
            features.notes[0].contains("the middle of this paint"),
            "{:?}",
            features.notes
        );
        let fit = measure_fit(dims, &surfaces, &features.points);
        assert!(fit.coverage > 0.92, "{fit:?}");
        assert!(fit.precision > 0.97 && fit.rms < 0.3, "{fit:?}");
    }

    #[test]
    fn many_surfaces_in_a_third_of_the_volume_are_found() {
        let dims = [60, 60, 48];
        let surfaces: Vec<ExactSurface> = (0..7)
            .map(|i| {
                let turn = if i % 2 == 0 { 0.15 } else { -0.4 };
                ExactSurface::plane([1.0, turn, 0.1], [4.0 + 8.5 * f64::from(i), 30.0, 24.0])
            })
            .collect();
        let image = image_of(dims, |p| {
            f64::from(u8::from(surfaces.iter().any(|s| s.distance(p).abs() < 1.5)))
        });
        let features = detect(&image, &gap_options()).unwrap();
        let fit = measure_fit(dims, &surfaces, &features.points);
        assert!(fit.coverage > 0.93 && fit.precision > 0.97, "{fit:?}");
    }

    #[test]
    fn a_ball_is_no_thin_mask() {
        let dims = [40, 40, 40];
        let ball = [ExactSurface::Sphere([20.0; 3], 5.0)];
        let image = image_of(dims, |p| f64::from(u8::from(ball[0].distance(p) < 0.0)));
        let options = DetectionOptions::with_kind(FeatureKind::Labels, 2.0);
        let features = detect(&image, &options).unwrap();
        let fit = measure_fit(dims, &ball, &features.points);
        assert!(fit.coverage > 0.95 && fit.precision > 0.95, "{fit:?}");
    }

    #[test]
    fn a_thin_mask_is_one_surface_and_not_two() {
        let (dims, surfaces) = (
            [64, 60, 56],
            [ExactSurface::plane([1.0, 0.35, 0.2], [32.0, 30.0, 28.0])],
        );
        for half in [0.6, 1.5] {
            let image = image_of(dims, |p| {
                255.0 * f64::from(u8::from(surfaces[0].distance(p).abs() < half))
            });
            let features =
                detect(&image, &DetectionOptions::with_kind(FeatureKind::Mask, 8.0)).unwrap();
            let fit = measure_fit(dims, &surfaces, &features.points);
            assert!(
                fit.coverage > 0.99 && fit.precision > 0.99 && fit.rms < 0.25,
                "{half} {fit:?}"
            );
        }
    }
}
