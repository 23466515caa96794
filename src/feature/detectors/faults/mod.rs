//! Faults: places where layers of seismic amplitude do not continue.
//!
//! 1. The structure tensor gives the normals of layers ([`NormalField`]).
//! 2. The likelihood of a fault at each sample comes from a convolutional network
//!    (`network`), or from semblance ([`FaultEvidence`]). `semblance` compares the waveforms of a layer
//!    on the two sides of a possible fault (after Marfurt et al. 1998). `scan` smooths numerator and
//!    denominator of the semblance over steep planes through each sample, and takes the plane with the
//!    lowest ratio (Hale 2013). One minus its square is the fault likelihood.
//! 3. Ridges of the likelihood ([`ridges`](super::ridges)) are fault points, except those that run
//!    along the layers, that dip too little, or that stand out too little: the likelihood must be
//!    low on both sides.
//!
//! In surveys whose traces are far apart, all this is done on a finer grid ([`FineGrid`]).
//!
//! Faults that dip less than [`min_dip`](crate::feature::DetectionOptions::min_dip) in the world are
//! left out; the outcome counts them, except where semblance does not scan such planes.
//!
//! Scale of semblance: one sample for derivatives; 12 samples for the tensor's window, so that a throw is not
//! mistaken for a dip. Planes have weights of 6 samples along strike and 12 along dip. A given
//! scale applies to amplitudes, never to the ridges of the likelihood. Assumptions: the throw is
//! about two samples or more (and no multiple of the period of layers); faults dip by 25 degrees or
//! more against layers that lie across one axis, and by 36 degrees or more against the samples; noise is not correlated along layers.

mod fine_grid;
mod network;
pub(crate) mod scan;
pub(crate) mod semblance;

use fine_grid::FineGrid;

use super::ridges::RidgeSearch;
use super::{Detector, DetectorInput, DetectorOutput, layers_search_bytes, sample_count};
use crate::error::Result;
use crate::feature::candidate::Candidate;
use crate::feature::structure_tensor::NormalField;
use crate::feature::windows::{self, MAX_WHOLE_SAMPLES};
use crate::feature::world_dip::WorldDip;
use crate::feature::{FaultEvidence, FeatureKind};
use crate::geometry::dot;
use crate::image::time::DEFAULT_VELOCITY;
use crate::image::{ImageSource, LiveMask};
use crate::progress::ASSUMED;

/// Detector of faults in seismic amplitude.
pub struct Faults;

/// Width (samples) of the structure tensor's window.
const TENSOR_WINDOW: f64 = 12.0;

/// Number of bisections that find the largest slope of the scan.
const SLOPE_BISECTIONS: usize = 20;

/// Memory (bytes) per sample of the likelihood.
const LIKELIHOOD_BYTES_PER_SAMPLE: f64 = 4.0;
/// Memory (bytes) per sample that the network sees in a volume, besides its probability.
const NETWORK_BYTES_PER_SAMPLE: f64 = 8.0;
/// Memory (bytes) per sample that the network sees in a section, with its copy of twice as many traces.
const SECTION_NETWORK_BYTES_PER_SAMPLE: f64 = 44.0;
/// Memory (bytes) of the layers in the network's reach, per sample of one layer.
const NETWORK_BYTES_PER_LAYER_SAMPLE: f64 = 2600.0;
/// Memory (bytes) per sample that is scanned, besides its likelihood.
const SCAN_BYTES_PER_SAMPLE: f64 = 22.0;

/// Size (samples) of the smallest fault, if none is given: the side of a square of its area, in 2-D its
/// length.
pub const MIN_FAULT_SIZE: f64 = 20.0;

/// Largest cosine between the normals of a fault and of the layers; with a larger one, the ridge is
/// a layer.
const MAX_LAYER_COSINE: f32 = 0.92;

/// Smallest strength of a ridge, as a share of the likelihood there. Where layers are continued on
/// both sides, the likelihood is low beside a fault, and the ridge is as strong as it is high. In
/// noise and in chaotic parts the likelihood is high everywhere.
const MIN_HEIGHT_SHARE: f32 = 0.2;

/// Width (samples) of the Gaussian under which ridges of the network's probability are searched for: faults
/// are marked by ridges that are as wide (`RIDGE_SIGMA` in `scripts/train_fault_network.py`).
const PROBABILITY_SCALE: f64 = 0.75;
/// Strength of a ridge of the probability down to which a fault is followed, and the one that it must
/// reach somewhere, in sections and in volumes. Measured with `scripts/fault_trials.py`, seeds 101 to 106.
/// In sections the network is less certain.
const PROBABILITY_THRESHOLDS: [(f32, f32); 2] = [(0.04, 0.1), (0.08, 0.2)];

/// Smallest share of a small surface that must be strong.
const MIN_STRONG_SHARE: f64 = 0.15;

/// Returns the largest slope of scanned planes, whose horizontal normal is `normal` and which are sheared
/// along the axis `crossed_axis`, at which the fault still dips by `min_dip` degrees.
fn max_scan_slope<const D: usize>(
    dips: &WorldDip<D>,
    vertical: usize,
    min_dip: f64,
    normal: [f64; D],
    crossed_axis: usize,
) -> f64 {
    let is_steep = |slope: f64| {
        [slope, -slope].into_iter().any(|slope| {
            let mut sheared = normal;
            sheared[vertical] = -slope * normal[crossed_axis];
            dips.degrees(sheared) >= min_dip
        })
    };
    let (mut low, mut high) = (0.0, scan::MAX_DIP_SLOPE);
    if is_steep(high) {
        return high;
    }
    for _ in 0..SLOPE_BISECTIONS {
        let middle = 0.5 * (low + high);
        if is_steep(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// Finds fault points on the grid of `input`. `auto_evidence` is the evidence if the options leave it open.
fn find_on_grid<const D: usize>(
    input: &DetectorInput<'_, D>,
    auto_evidence: FaultEvidence,
    notes: &mut Vec<String>,
) -> Result<DetectorOutput<D>> {
    let (live, cancel) = (input.live_mask, input.cancel);
    let window = input.options.smoothing.unwrap_or(TENSOR_WINDOW);
    let samples = input.smoothed_in_layers()?;
    let (layers, rms) = NormalField::new(&samples, window, live, cancel)?;
    let vertical = layers.main_axis();
    let dips = WorldDip::new(input.source.geometry(), vertical);
    let min_dip = input.options.min_dip;
    let evidence = match input.options.fault_evidence {
        FaultEvidence::Auto => auto_evidence,
        given => given,
    };
    let likelihood = match evidence {
        FaultEvidence::Auto | FaultEvidence::Network => {
            // A given scale applies to the amplitudes; the network needs none.
            let (amplitude, rms) = match input.options.scale {
                Some(_) => (samples, rms.smoothed),
                None => (input.samples(1.0)?, rms.unsmoothed),
            };
            network::likelihood(&amplitude, vertical, rms, cancel)?
        }
        FaultEvidence::Semblance => {
            let max_slope = |normal, crossed_axis| {
                max_scan_slope(&dips, vertical, min_dip, normal, crossed_axis)
            };
            semblance::likelihood(&samples, &layers, rms.smoothed, live, max_slope, cancel)?
        }
    };
    notes.push(format!(
        "faults that dip by {min_dip} degrees or more, by {}; dips of layers are averaged over {window} samples",
        match evidence {
            FaultEvidence::Auto | FaultEvidence::Network => {
                "the probability that a neural network gives".to_owned()
            }
            FaultEvidence::Semblance => format!(
                "the planes across which layers are least alike (semblance), after smoothing over {} samples",
                input.scale()
            ),
        },
    ));
    if input.source.geometry().time_coordinate().is_some() {
        notes.push(format!(
            "{ASSUMED}for dips, two-way time is depth at {DEFAULT_VELOCITY} m/s (--velocity sets another)"
        ));
    }
    let search = RidgeSearch {
        scale: match evidence {
            FaultEvidence::Auto | FaultEvidence::Network => Some(PROBABILITY_SCALE),
            FaultEvidence::Semblance => None,
        },
        auto_thresholds: match evidence {
            FaultEvidence::Auto | FaultEvidence::Network => |_| PROBABILITY_THRESHOLDS[D - 2],
            FaultEvidence::Semblance => semblance::thresholds,
        },
        // Weak ridges of the likelihood are mostly ends of layers.
        weak_share: 1.0,
        // The likelihood varies along a fault much more than the values of a fault image: the
        // share is about 0.1 if there is little noise, and larger if noise raises the threshold.
        min_strength_share: |thresholds| 3.0 * thresholds.low,
        min_height_share: MIN_HEIGHT_SHARE,
        ..RidgeSearch::new(input)
    };
    let mut output = search.find(likelihood, notes)?;
    let layer_cosine = |position, normal| dot(normal, layers.normal_at(position)).abs();
    output
        .candidates
        .retain(|c| layer_cosine(c.position, c.normal) < MAX_LAYER_COSINE);
    let is_steep = |c: &Candidate<D>| dips.degrees(c.normal.map(f64::from)) >= min_dip;
    (output.candidates, output.flat_candidates) = output.candidates.into_iter().partition(is_steep);
    let keep_chaos = input.options.keep_chaos;
    output.drop_chaotic(
        layers.chaotic_zones(),
        FeatureKind::Faults,
        keep_chaos,
        notes,
    );
    output.vertical_axis = vertical;
    Ok(output)
}

impl<const D: usize> Detector<D> for Faults {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Faults
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let Some(grid) = FineGrid::for_survey(input, notes)? else {
            return find_on_grid(input, FaultEvidence::Network, notes);
        };
        let live: Option<LiveMask<D>> =
            (input.live_mask).map(|live| live.refined(grid.dims, grid.factors));
        let fine = DetectorInput {
            source: ImageSource::Layered(&grid),
            live_mask: live.as_ref(),
            grid: input.grid.with_dims(grid.dims),
            ..*input
        };
        let mut output = find_on_grid(&fine, FaultEvidence::Semblance, notes)?;
        let candidates = output.gather_candidates(fine.grid)?;
        output.flat_candidates = grid.to_survey(&output.flat_candidates);
        output.candidates = grid.to_survey(&candidates);
        Ok(output)
    }

    fn is_streamable(&self) -> bool {
        true
    }

    fn is_fault(&self) -> bool {
        true
    }

    /// Returns the memory for the likelihood of this rank's samples, and for a window of samples
    /// that are scanned together or ridges of some layers, whichever is more.
    fn search_bytes(&self, source: ImageSource<'_, D>, ranks: usize) -> f64 {
        let (dims, samples) = (source.dims(), sample_count(source.dims()));
        let is_whole =
            matches!(source, ImageSource::InMemory(_)) && samples <= MAX_WHOLE_SAMPLES as f64;
        let scanned = if is_whole {
            samples
        } else {
            windows::min_mapped_samples(dims, network::HALO_LAYERS) as f64
        };
        let layer = samples / dims[D - 1].max(1) as f64;
        let network_bytes = if D == 2 {
            SECTION_NETWORK_BYTES_PER_SAMPLE
        } else {
            NETWORK_BYTES_PER_SAMPLE
        };
        let evidence = (SCAN_BYTES_PER_SAMPLE * scanned)
            .max(network_bytes * scanned + NETWORK_BYTES_PER_LAYER_SAMPLE * layer);
        // Each rank has its share, and that of its windows.
        let share = (2.0 / ranks as f64).min(1.0);
        share * LIKELIHOOD_BYTES_PER_SAMPLE * samples + evidence.max(layers_search_bytes(dims))
    }

    fn min_strong_share(&self) -> f64 {
        MIN_STRONG_SHARE
    }

    /// Returns the reach of normals averaged over 12 samples, amplitudes balanced over 6, planes of 12
    /// samples, and the network.
    fn reach(&self, _scale: f64) -> usize {
        80
    }
}

#[cfg(test)]
mod tests {
    use super::semblance::{HALO_LAYERS, likelihood};
    use super::*;
    use crate::feature::scenes::Noise;
    use crate::feature::volume::Volume;
    use crate::feature::windows::Samples;
    use crate::feature::{DetectionOptions, FeaturePoint, SharedGrid, detect};
    use crate::geometry::grid_index::index_at;
    use crate::image::{Geometry, Image};
    use crate::progress::CancelToken;

    /// Returns the share of the true faults within two samples of a point, and the share of the
    /// points within two samples of a true fault.
    fn recall_and_precision<const D: usize>(
        dims: [usize; D],
        distance: &[f32],
        points: &[FeaturePoint<D>],
    ) -> [f64; 2] {
        let volume = Volume { dims, samples: &[] };
        let mut is_near = vec![false; distance.len()];
        let mut precise = 0;
        for point in points {
            let at: [usize; D] = point.position.map(|c| c.round() as usize);
            precise += usize::from(distance[volume.index(at)].abs() < 2.0);
            for number in 0..5usize.pow(D as u32) {
                let offset = index_at([5; D], number);
                let neighbour: [usize; D] =
                    std::array::from_fn(|k| (at[k] + offset[k]).saturating_sub(2).min(dims[k] - 1));
                if offset.map(|o| o.abs_diff(2).pow(2)).iter().sum::<usize>() <= 4 {
                    is_near[volume.index(neighbour)] = true;
                }
            }
        }
        let on_fault = |(d, near): (&f32, &bool)| (d.abs() < 0.5).then_some(*near);
        let on_fault: Vec<bool> = distance.iter().zip(&is_near).filter_map(on_fault).collect();
        let recalled = on_fault.iter().filter(|near| **near).count();
        [
            recalled as f64 / on_fault.len() as f64,
            precise as f64 / points.len().max(1) as f64,
        ]
    }

    #[test]
    fn faults_of_amplitude_are_found_where_layers_are_thrown() {
        for (seed, signal_to_noise, recall, precision) in [
            (1, 4.0, 0.95, 0.88),
            (2, 4.0, 0.95, 0.94),
            (1, 2.0, 0.8, 0.9),
        ] {
            let synthetic = crate::image::synth::make(
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
            for fault_evidence in [FaultEvidence::Network, FaultEvidence::Semblance] {
                let options = DetectionOptions {
                    fault_evidence,
                    ..DetectionOptions::with_kind(FeatureKind::Faults, 8.0)
                };
                let features = detect(&synthetic.image, &options).unwrap();
                let dims = synthetic.image.dims();
                let scores =
                    recall_and_precision(dims, &synthetic.truth.distance, &features.points);
                assert!(
                    scores[0] > recall && scores[1] > precision,
                    "{fault_evidence:?} {seed} {signal_to_noise} {scores:?} {:?}",
                    features.notes
                );
            }
        }
    }

    /// Measures a straight fault: layers across x, displaced along x by `throw` on one side of a
    /// plane with this unit normal through the middle. Returns the root mean square distance
    /// (samples) of fault points from the plane, the root mean square angle (degrees) between their
    /// normals and that of the plane, and the number of points per column of samples that the plane
    /// crosses; all away from the sides.
    fn straight_fault<const D: usize>(dims: [usize; D], normal: [f64; D], throw: f64) -> [f64; 3] {
        let middle = dims.map(|n| 0.5 * (n as f64 - 1.0));
        let distance =
            |p: [f64; D]| -> f64 { (0..D).map(|k| normal[k] * (p[k] - middle[k])).sum() };
        let mut noise = Noise::new(17);
        let volume = Volume { dims, samples: &[] };
        let samples = (0..dims.iter().product())
            .map(|i| {
                let p = volume.coordinates(i).map(|c| c as f64);
                let depth = p[0] + if distance(p) > 0.0 { throw } else { 0.0 };
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
        let is_inner = |p: &[f64; D]| (0..D).all(|k| p[k] > 6.0 && p[k] < dims[k] as f64 - 7.0);
        let (mut squares, mut angles, mut count) = (0.0, 0.0, 0.0);
        for point in &features.points {
            let p = point.position.map(f64::from);
            if is_inner(&p) {
                squares += distance(p).powi(2);
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
            let p = volume.coordinates(*i).map(|c| c as f64);
            let s = distance(p) / normal[axis];
            s > -0.5 && s <= 0.5 && is_inner(&p)
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
        let is_good =
            |[distance, angle, covered]: [f64; 3]| distance < 0.5 && angle < 5.5 && covered > 0.98;
        for throw in [2.5, 4.0, 7.0] {
            for dip in (50..=130).step_by(10) {
                let (sin, cos) = f64::from(dip).to_radians().sin_cos();
                let fit = straight_fault([96, 80], [cos, sin], throw);
                assert!(is_good(fit), "2-D {throw} {dip} {fit:?}");
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
                assert!(is_good(fit), "3-D {throw} {dip} {azimuth} {fit:?}");
            }
        }
    }

    /// Returns a survey of layers that dip by 5 degrees and are thrown by 30 m across a fault, and the distance
    /// of places (samples) from the fault, in metres along the line across it. Traces of 4 m a sample are `spacing`
    /// apart along both axes; the fault dips by 60 degrees. `with_fault` tells whether there is one.
    fn coarse_survey(spacing: [f64; 2], with_fault: bool) -> (Image<3>, impl Fn([f64; 3]) -> f64) {
        let dims = [
            96,
            (1200.0 / spacing[0]) as usize,
            (1200.0 / spacing[1]) as usize,
        ];
        let steps = [4.0, spacing[0], spacing[1]];
        let middle = dims.map(|n| 0.5 * (n as f64 - 1.0));
        let azimuth = 35f64.to_radians();
        let distance = move |p: [f64; 3]| -> f64 {
            let [z, x, y] = std::array::from_fn(|k| steps[k] * (p[k] - middle[k]));
            x * azimuth.cos() + y * azimuth.sin() - z / 60f64.to_radians().tan()
        };
        let mut noise = Noise::new(5);
        let volume = Volume { dims, samples: &[] };
        let samples = (0..dims.iter().product()).map(|i| {
            let p = volume.coordinates(i).map(|c| c as f64);
            let throw = if with_fault && distance(p) > 0.0 {
                30.0
            } else {
                0.0
            };
            let slope = 5f64.to_radians().tan();
            let depth = 4.0 * p[0] - throw - slope * steps[1] * p[1];
            // Wavelengths around 50 m that are no multiples of one another.
            let waves = [(50.0, 1.0), (67.0, 0.8), (41.0, 0.7)];
            let wave = |(length, height): (f64, f64)| {
                height * (std::f64::consts::TAU * depth / length).sin()
            };
            (waves.map(wave).iter().sum::<f64>() + 0.25 * noise.normal()) as f32
        });
        let geometry = Geometry {
            axes: [
                [0.0, 0.0, -4.0],
                [spacing[0], 0.0, 0.0],
                [0.0, spacing[1], 0.0],
            ],
            units: ["m".into(), "m".into(), "m".into()],
            ..Geometry::default()
        };
        (Image::new(dims, samples.collect(), geometry), distance)
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn faults_of_coarse_surveys_lie_within_a_trace_of_where_they_are() {
        for spacing in [[50.0, 50.0], [100.0, 25.0]] {
            let (image, distance) = coarse_survey(spacing, true);
            let options = DetectionOptions::with_kind(FeatureKind::Faults, 6.0);
            let features = detect(&image, &options).unwrap();
            let distances = features
                .points
                .iter()
                .map(|p| distance(p.position.map(f64::from)));
            let distances: Vec<f64> = distances.map(|d| d / spacing[0]).collect();
            let near = distances.iter().filter(|d| d.abs() < 1.0).count();
            let share = near as f64 / distances.len() as f64;
            let mean = distances.iter().sum::<f64>() / distances.len() as f64;
            assert!(
                share > 0.97 && mean.abs() < 0.2,
                "{spacing:?} {share} {mean}"
            );
            // Columns along the first lateral axis that the fault crosses inside the survey.
            let dims = image.dims();
            let crossing = |z: usize, y: usize| {
                let at = |x: f64| distance([z as f64, x, y as f64]);
                let x = -at(0.0) / (at(1.0) - at(0.0));
                (x > 1.0 && x < dims[1] as f64 - 2.0).then_some(x)
            };
            let (mut crossed, mut found) = (0, 0);
            for (z, y) in (0..dims[0]).flat_map(|z| (0..dims[2]).map(move |y| (z, y))) {
                let Some(x) = crossing(z, y) else { continue };
                let place = [z as f64, x, y as f64];
                let is_near = |p: &FeaturePoint<3>| {
                    (0..3).all(|k| (f64::from(p.position[k]) - place[k]).abs() <= 1.5)
                };
                crossed += 1;
                found += usize::from(features.points.iter().any(is_near));
            }
            let recall = f64::from(found as u32) / f64::from(crossed);
            assert!(recall > 0.85, "{spacing:?} {recall} {:?}", features.notes);
        }
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn coarse_surveys_without_faults_have_none() {
        let (image, _) = coarse_survey([100.0, 50.0], false);
        let options = DetectionOptions::with_kind(FeatureKind::Faults, 6.0);
        let features = detect(&image, &options).unwrap();
        assert!(features.points.is_empty(), "{:?}", features.notes);
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn windows_find_what_the_whole_finds() {
        // Layers across the first and across the last axis, displaced by an inclined fault, with
        // noise.
        for (dims, vertical) in [([46, 30, 330], 0), ([30, 38, 324], 2), ([20, 330, 36], 0)] {
            let mut noise = Noise::new(3);
            let volume = Volume { dims, samples: &[] };
            let samples: Vec<f32> = (0..dims.iter().product())
                .map(|i| {
                    let p = volume.coordinates(i).map(|c| c as f64);
                    let across = 2 - vertical;
                    let distance =
                        p[across] - 0.5 * dims[across] as f64 + 0.4 * (p[vertical] - 20.0);
                    let depth = p[vertical] + 0.1 * p[1] + if distance > 0.0 { 3.0 } else { 0.0 };
                    (0.5 * depth).sin() as f32 + 0.3 * noise.normal() as f32
                })
                .collect();
            let cancel = &CancelToken::never();
            let measure = |limits: [usize; 2], max_with_halo: usize| {
                let samples = Samples::in_memory(dims, &samples[..]).with_limits(limits);
                let mut samples = samples.with_strips(1, max_with_halo);
                samples.smooth(1.0, cancel);
                let (normals, rms) = NormalField::new(&samples, 12.0, None, cancel).unwrap();
                assert_eq!(normals.main_axis(), vertical);
                let max_slope = |_, _| super::scan::MAX_DIP_SLOPE;
                let likelihood =
                    likelihood(&samples, &normals, rms.smoothed, None, max_slope, cancel).unwrap();
                let at = normals.normal_at([20.3, 17.7, 155.5]);
                (likelihood.as_slice().to_vec(), rms, at)
            };
            let reference = measure([usize::MAX, 1], usize::MAX);
            assert!(reference.0.iter().any(|&l| l > 0.5), "there is a fault");
            // Three windows, of which the last one is shorter, or two strips.
            const { assert!(2 * HALO_LAYERS < 324 / 2) };
            let two_strips = dims[0] * dims[2] * (330 / 2 + 2 * 80);
            for max_with_halo in [usize::MAX, two_strips] {
                assert!(
                    measure([0, 1], max_with_halo) == reference,
                    "{dims:?} {max_with_halo}"
                );
            }
        }
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn layered_amplitudes_have_the_features_of_those_in_memory() {
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
            let options = DetectionOptions::with_kind(kind, 6.0);
            let [in_memory, in_layers] = [
                ImageSource::InMemory(&image),
                ImageSource::Layered(&by_layers),
            ]
            .map(|source| {
                let cancel = &CancelToken::never();
                let grid = SharedGrid::of_one_process(source.dims());
                crate::feature::detect_with_cancel(source, &options, grid, cancel).unwrap()
            });
            assert!(in_memory.points.len() > 1000, "{kind}");
            assert!(in_memory.points == in_layers.points, "{kind}");
            assert!(in_memory.potential.to_dense() == in_layers.potential.to_dense());
        }
    }
}
