//! Faults: where layers of seismic amplitude do not continue.
//!
//! 1. BlockNormals of layers by the structure tensor ([`BlockNormals`]).
//! 2. Semblance of what the layers show on one side of a fault and on the other (after Marfurt et al. 1998),
//!    its numerator and denominator each smoothed over the steep plane through a sample for which their ratio
//!    is least (Hale 2013): `semblance` and `scan`. One less its square is the likelihood of a fault.
//! 3. Ridges of the likelihood ([`ridges`](super::ridges)), but for those that run along the layers.
//!
//! Scale: one sample for derivatives, twelve for the tensor's window, so that a throw does not pass for a
//! dip; planes are weighted over 6 samples along the strike and 12 along the dip; a given scale is that
//! of amplitudes, never that of the likelihood's ridges. Assumptions: layers are thrown by some two
//! samples or more (by no multiple of their period, where they have one); faults dip by 40 degrees or
//! more against layers that lie across one axis; noise is not alike along layers.

pub(crate) mod scan;
pub(crate) mod semblance;

use super::ridges::RidgeSearch;
use super::{Detector, DetectorInput, DetectorOutput};
use crate::error::Result;
use crate::feature::FeatureKind;
use crate::feature::structure_tensor::NormalField;
use crate::geometry::dot;

/// Finds faults of seismic amplitude.
pub struct Faults;

/// Width (samples) of the structure tensor's window.
const TENSOR_WINDOW: f64 = 12.0;

/// Faults whose normals agree more than this (cosine) with the layers' are layers themselves.
const MAX_LAYER_COSINE: f32 = 0.77;

impl<const D: usize> Detector<D> for Faults {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Faults
    }

    fn find(
        &self,
        scene: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let window = scene.options.smoothing.unwrap_or(TENSOR_WINDOW);
        let samples = scene.smoothed_in_layers()?;
        let (layers, rms) = NormalField::new(&samples, window, scene.live_mask, scene.cancel)?;
        let likelihood =
            semblance::likelihood(&samples, (&layers, rms), scene.live_mask, scene.cancel)?;
        drop(samples);
        notes.push(format!(
            "faults: least semblance along layers over steep planes, at scale {}, normals averaged over \
             {window}",
            scene.scale()
        ));
        let search = RidgeSearch {
            scale: None,
            auto_thresholds: semblance::thresholds,
            // What is weak here is mostly where layers end.
            weak_share: 1.0,
            // Likelihoods vary along a fault much more than those of an image of faults: 0.18 where there
            // is little noise, more where noise lifts the threshold.
            min_strength_share: |thresholds| 0.18 * thresholds.low / semblance::MIN_LIKELIHOODS[0],
            ..RidgeSearch::new(scene)
        };
        let mut found = search.find(likelihood, notes)?;
        let along_layers = |position, normal| dot(normal, layers.normal_at(position)).abs();
        found
            .candidates
            .retain(|c| along_layers(c.position, c.normal) < MAX_LAYER_COSINE);
        Ok(found)
    }

    fn is_streamable(&self) -> bool {
        true
    }

    fn min_surface_cells(&self) -> f64 {
        6.0
    }

    /// Normals averaged over 12 samples, on amplitudes balanced over 6, and a plane of 12.
    fn reach(&self, _scale: f64) -> usize {
        60
    }
}

#[cfg(test)]
mod tests {
    use super::semblance::{HALO_LAYERS, likelihood};
    use super::*;
    use crate::feature::scenes::Noise;
    use crate::feature::volume::Volume;
    use crate::feature::windows::Samples;
    use crate::feature::{DetectionOptions, FeaturePoint, detect};
    use crate::image::{Geometry, Image};
    use crate::progress::CancelToken;

    /// Shares of the true faults within two samples of a point, and of the points within two samples of a
    /// true fault.
    fn recall_and_precision<const D: usize>(
        dims: [usize; D],
        distance: &[f32],
        points: &[FeaturePoint<D>],
    ) -> [f64; 2] {
        let space = Volume { dims, samples: &[] };
        let mut near = vec![false; distance.len()];
        let mut good = 0;
        for point in points {
            let at: [usize; D] = point.position.map(|c| c.round() as usize);
            good += usize::from(distance[space.index(at)].abs() < 2.0);
            for number in 0..5usize.pow(D as u32) {
                let (mut rest, mut to, mut square) = (number, at, 0);
                for k in 0..D {
                    let offset = rest % 5;
                    square += offset.abs_diff(2).pow(2);
                    to[k] = (at[k] + offset).saturating_sub(2).min(dims[k] - 1);
                    rest /= 5;
                }
                if square <= 4 {
                    near[space.index(to)] = true;
                }
            }
        }
        let on = |(d, near): (&f32, &bool)| (d.abs() < 0.5).then_some(*near);
        let on: Vec<bool> = distance.iter().zip(&near).filter_map(on).collect();
        let found = on.iter().filter(|near| **near).count();
        [
            found as f64 / on.len() as f64,
            good as f64 / points.len().max(1) as f64,
        ]
    }

    #[test]
    fn faults_of_amplitude_are_found_where_layers_are_thrown() {
        for (seed, signal_to_noise, recall, precision) in [
            (1, 4.0, 0.95, 0.88),
            (2, 4.0, 0.95, 0.94),
            (1, 2.0, 0.8, 0.9),
        ] {
            let made = crate::image::synth::make(
                crate::image::synth::SyntheticKind::Amplitude,
                &crate::image::synth::Options {
                    dims: [96, 80, 72],
                    count: Some(2),
                    seed,
                    signal_to_noise,
                    ..Default::default()
                },
            )
            .unwrap();
            let features = detect(
                &made.image,
                &DetectionOptions::with_kind(FeatureKind::Faults, 8.0),
            )
            .unwrap();
            let dims = made.image.dims();
            let found = recall_and_precision(dims, &made.truth.distance, &features.points);
            assert!(
                found[0] > recall && found[1] > precision,
                "{seed} {signal_to_noise} {found:?} {:?}",
                features.notes
            );
        }
    }

    /// Layers across x thrown along x by `throw` on one side of a plane with this unit normal through the
    /// middle: rms distance (samples) of fault points from the plane, rms angle (degrees) between their
    /// normals and its, and points per column of samples that the plane crosses; all away from the sides.
    fn straight_fault<const D: usize>(dims: [usize; D], normal: [f64; D], throw: f64) -> [f64; 3] {
        let middle = dims.map(|n| 0.5 * (n as f64 - 1.0));
        let off = |p: [f64; D]| -> f64 { (0..D).map(|k| normal[k] * (p[k] - middle[k])).sum() };
        let mut noise = Noise::new(17);
        let space = Volume { dims, samples: &[] };
        let samples = (0..dims.iter().product())
            .map(|i| {
                let p = space.coordinates(i).map(|c| c as f64);
                let depth = p[0] + if off(p) > 0.0 { throw } else { 0.0 };
                // Three periods that are no multiples of one another.
                let waves = [(0.52, 1.0), (0.71, 0.8), (0.33, 0.7)];
                let wave = |(k, height): (f64, f64)| height * (k * depth).sin();
                (waves.map(wave).iter().sum::<f64>() + 0.25 * noise.normal()) as f32
            })
            .collect();
        let image = Image::new(dims, samples, Geometry::default());
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Faults, 6.0),
        )
        .unwrap();
        let inner = |p: &[f64; D]| (0..D).all(|k| p[k] > 6.0 && p[k] < dims[k] as f64 - 7.0);
        let (mut squares, mut angles, mut count) = (0.0, 0.0, 0.0);
        for point in &features.points {
            let p = point.position.map(f64::from);
            if inner(&p) {
                squares += off(p).powi(2);
                let c: f64 = (0..D).map(|k| normal[k] * f64::from(point.normal[k])).sum();
                angles += c.abs().min(1.0).acos().to_degrees().powi(2);
                count += 1.0;
            }
        }
        let axis = (1..D).fold(0, |a, k| {
            if normal[k].abs() > normal[a].abs() {
                k
            } else {
                a
            }
        });
        let columns = (0..dims.iter().product()).filter(|i| {
            let p = space.coordinates(*i).map(|c| c as f64);
            let s = off(p) / normal[axis];
            s > -0.5 && s <= 0.5 && inner(&p)
        });
        [
            f64::sqrt(squares / count),
            f64::sqrt(angles / count),
            count / columns.count() as f64,
        ]
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn straight_faults_lie_where_they_are_at_every_dip_and_throw() {
        let good = |[off, angle, covered]: [f64; 3]| off < 0.5 && angle < 5.5 && covered > 0.98;
        for throw in [2.5, 4.0, 7.0] {
            for dip in (50..=130).step_by(10) {
                let (sin, cos) = f64::from(dip).to_radians().sin_cos();
                let fit = straight_fault([96, 80], [cos, sin], throw);
                assert!(good(fit), "2-D {throw} {dip} {fit:?}");
            }
            for (dip, azimuth) in [
                (90, 0),
                (75, 20),
                (60, 45),
                (110, 70),
                (65, 100),
                (120, 150),
            ] {
                let (dip, azimuth) = (f64::from(dip).to_radians(), f64::from(azimuth).to_radians());
                let normal = [
                    dip.cos(),
                    dip.sin() * azimuth.cos(),
                    dip.sin() * azimuth.sin(),
                ];
                let fit = straight_fault([64, 56, 48], normal, throw);
                assert!(good(fit), "3-D {throw} {dip} {azimuth} {fit:?}");
            }
        }
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn some_layers_at_a_time_show_what_all_show() {
        // Layers across the first and across the last axis, thrown by a slanting fault, in noise.
        for (dims, vertical) in [([46, 30, 330], 0), ([30, 38, 324], 2), ([20, 330, 36], 0)] {
            let mut noise = Noise::new(3);
            let space = Volume { dims, samples: &[] };
            let samples: Vec<f32> = (0..dims.iter().product())
                .map(|i| {
                    let p = space.coordinates(i).map(|c| c as f64);
                    let across = 2 - vertical;
                    let off = p[across] - 0.5 * dims[across] as f64 + 0.4 * (p[vertical] - 20.0);
                    let depth = p[vertical] + 0.1 * p[1] + if off > 0.0 { 3.0 } else { 0.0 };
                    (0.5 * depth).sin() as f32 + 0.3 * noise.normal() as f32
                })
                .collect();
            let patience = &CancelToken::never();
            let seen = |limits: [usize; 2], most: usize| {
                let samples = Samples::in_memory(dims, &samples[..]).with_limits(limits);
                let mut samples = samples.with_strips(1, most);
                samples.smooth(1.0, patience);
                let (normals, rms) = NormalField::new(&samples, 12.0, None, patience).unwrap();
                assert_eq!(normals.main_axis(), vertical);
                let likelihood = likelihood(&samples, (&normals, rms), None, patience).unwrap();
                let at = normals.normal_at([20.3, 17.7, 155.5]);
                (likelihood.as_slice().to_vec(), rms, at)
            };
            let whole = seen([usize::MAX, 1], usize::MAX);
            assert!(whole.0.iter().any(|&l| l > 0.5), "there is a fault");
            // Three windows, of which the last is shorter, or two strips.
            const { assert!(2 * HALO_LAYERS < 324 / 2) };
            let most = dims[0] * dims[2] * (330 / 2 + 2 * 80);
            for most in [usize::MAX, most] {
                assert!(seen([0, 1], most) == whole, "{dims:?} {most}");
            }
        }
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn amplitudes_in_layers_have_the_features_of_those_in_memory() {
        use crate::feature::windows::tests::LayeredImage;
        use crate::image::ImageSource;
        use crate::image::synth::{Options, SyntheticKind, make};

        let options = Options {
            dims: [72, 60, 64],
            seed: 2,
            ..Options::default()
        };
        let image = make(SyntheticKind::Amplitude, &options).unwrap().image;
        let by_layers = LayeredImage(&image);
        for kind in [
            FeatureKind::Faults,
            FeatureKind::Horizons,
            FeatureKind::FaultsAndHorizons,
            FeatureKind::Edges,
            FeatureKind::Auto,
        ] {
            let asked = DetectionOptions::with_kind(kind, 6.0);
            let [held, in_layers] = [
                ImageSource::InMemory(&image),
                ImageSource::Layered(&by_layers),
            ]
            .map(|source| {
                let patience = &CancelToken::never();
                crate::feature::detect_with_cancel(source, &asked, patience).unwrap()
            });
            assert!(held.points.len() > 1000, "{kind}");
            assert!(held.points == in_layers.points, "{kind}");
            assert!(held.potential.to_dense() == in_layers.potential.to_dense());
        }
    }
}
