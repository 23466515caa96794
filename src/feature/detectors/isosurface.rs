//! Isosurfaces: the surfaces (in 2-D the curves) on which an image has a given value, or one of several.
//!
//! The values are the option `threshold`: 300 HU for the surface of bone in a CT image, for example.
//! If none is given, it is Otsu's threshold (Otsu 1979, "A threshold selection method from
//! gray-level histograms"). It divides the samples into two classes so that the variance between
//! the classes is largest.
//!
//! 1. A sample is inside if it is at least as high as the value. The surface passes between a
//!    sample inside and a neighbour outside along an axis.
//! 2. The point is where linear interpolation between the two samples gives the value. It belongs
//!    to the sample that is nearer.
//! 3. The normal is the direction of the gradient, which is interpolated between the two samples in
//!    the same way. Only the axis nearest to the normal counts, so that each column of samples that
//!    the surface passes gets one point.
//!
//! All points have the same strength, the lowest value, so that all are followed. The samples below,
//! between and above the values are regions ([`value_regions`]), so that the surfaces have no holes, end
//! on the sides of the image, and keep the volumes of the regions. Noise makes small parts of regions
//! around single samples, which join the region around them.
//!
//! Scale: the image is not smoothed, unless a scale is given. Smoothing over s samples moves a
//! surface of radius r towards its centre of curvature, by about s^2 (D - 1) / (2 r). Assumption:
//! the image is continuous. A mask of two values has an isosurface of steps, unless it is smoothed.

use super::value_regions::{region_values, value_regions};
use super::{Detector, DetectorInput, DetectorOutput, ThresholdMeaning, Thresholds};
use crate::error::{Error, Result, cause};
use crate::feature::candidate::{Candidate, dominant_axes};
use crate::feature::label_map::missing_label_error;
use crate::feature::volume::Volume;
use crate::feature::windows::{CoveredLayers, LayerWindow, Samples, layer_len};
use crate::feature::{FeatureKind, INTERFACE_RESOLUTION};
use crate::geometry::norm;
use crate::image::LiveMask;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Detector of surfaces on which the image has a given value.
pub struct Isosurface;

impl<const D: usize> Detector<D> for Isosurface {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Isosurface
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        find_in_samples(input, input.samples(1.0)?, notes)
    }

    fn threshold_meaning(&self) -> ThresholdMeaning {
        ThresholdMeaning::Level
    }

    /// Returns the area of a ball (in 2-D the circumference of a disc) whose diameter is the
    /// distance between atoms: the lattice cannot resolve smaller objects.
    fn min_surface_cells(&self) -> f64 {
        std::f64::consts::PI
    }

    /// Returns the distance for interfaces between labels: a thin object needs both of its sides.
    fn resolution(&self) -> f64 {
        INTERFACE_RESOLUTION
    }

    /// Returns `true`: surfaces of one value never cross, and noise scatters their normals.
    fn has_scattered_normals(&self) -> bool {
        true
    }
}

/// Number of layers of the halo of a window: one to the neighbour of a sample, and one for the
/// gradient there.
const HALO_LAYERS: usize = 2;

/// Finds the isosurface of `samples`, which are those of the input, possibly in windows.
fn find_in_samples<const D: usize>(
    input: &DetectorInput<'_, D>,
    mut samples: Samples<'_, D>,
    notes: &mut Vec<String>,
) -> Result<DetectorOutput<D>> {
    let (live, cancel) = (input.live_mask, input.cancel);
    let resolved_scale = input.resolved.map(|resolved| resolved.scale);
    let scale = resolved_scale.or(input.options.scale).unwrap_or(0.0);
    if scale > 0.0 {
        samples.smooth(scale, cancel);
    }
    let (levels, origin) = match input.thresholds() {
        Some(thresholds) => (levels(input, thresholds.high), thresholds.origin),
        None => (
            vec![otsu_threshold(&samples, live, cancel)?],
            "Otsu's threshold",
        ),
    };
    notes.push(levels_note(&levels, origin, scale));
    let (mut candidates, mut layers) = (Vec::new(), CoveredLayers::default());
    let mut values: Vec<f32> = Vec::new();
    let is_in_memory = input.image().is_ok();
    let mut collect = |window: &LayerWindow<'_, D>| {
        layers.add(&window.interior);
        if is_in_memory {
            let volume = window.smoothed.volume;
            values.extend(
                window.map_rows(cancel, |first, (): &mut (), row: &mut Vec<f32>| {
                    let start = volume.index(first);
                    row.extend_from_slice(&volume.samples[start..start + volume.dims[0]]);
                }),
            );
        }
        candidates.extend(crossings(window, &levels, cancel));
    };
    samples.for_each_window(
        HALO_LAYERS,
        None,
        &|_| 1,
        cancel,
        &mut collect,
        &mut |()| {},
    )?;
    let has_points = (input.grid).any("points of value", !candidates.is_empty())?;
    // A part of an image need not have the value.
    if input.resolved.is_none() && (levels.len() > 1 || !has_points) {
        let [min, max] = value_range(&samples, live, cancel)?;
        let mut absent = levels
            .iter()
            .filter(|level| **level <= min || **level > max);
        if let Some(level) = absent.next().or((!has_points).then_some(&levels[0])) {
            return Err(Error::Feature(cause(
                format!("threshold {level}"),
                format!(
                    "is a value that no surface has: values of the image are from {min} to {max}"
                ),
                "give a value between them",
            )));
        }
    }
    let thresholds = Thresholds {
        low: levels[0],
        high: levels[0],
        origin,
    };
    let regions = region_values(levels.len());
    if let Some(options) = (input.options.labels.iter()).find(|o| !regions.contains(&o.label)) {
        return Err(missing_label_error(options, &regions));
    }
    if is_in_memory {
        values = input.grid.concatenated("smoothed values", values)?;
    }
    let is_complete = values.len() == input.dims().iter().product::<usize>();
    let regions = is_complete.then(|| value_regions(input, values, &levels, notes));
    let labels = regions.flatten();
    if let Some((label_map, _)) = &labels {
        // Surfaces around parts that joined the other region are no interfaces.
        candidates.retain(|candidate| label_map.is_at_interface(candidate.voxel.index()));
    }
    Ok(DetectorOutput {
        layers: Some(layers.0),
        labels,
        levels: if levels.len() > 1 { levels } else { Vec::new() },
        ..DetectorOutput::new(candidates, scale, thresholds)
    })
}

/// Returns the values of the isosurfaces, in ascending order: those of the whole image if this is a part of one,
/// or else the first one and those that are given beside it.
fn levels<const D: usize>(input: &DetectorInput<'_, D>, first: f32) -> Vec<f32> {
    match input.resolved {
        Some(resolved) if !resolved.levels.is_empty() => resolved.levels.clone(),
        Some(_) => vec![first],
        None => {
            let mut levels = vec![first];
            levels.extend(&input.options.further_levels);
            levels.sort_by(f32::total_cmp);
            levels.dedup();
            levels
        }
    }
}

/// Returns the note on the values of isosurfaces, and on the smoothing over `scale` samples before.
fn levels_note(levels: &[f32], origin: &str, scale: f64) -> String {
    let smoothing = if scale > 0.0 {
        format!(" after smoothing over {scale} samples")
    } else {
        String::new()
    };
    match levels {
        [level] => format!("isosurface of the value {level} ({origin}){smoothing}"),
        _ => {
            let levels: Vec<String> = levels.iter().map(f32::to_string).collect();
            let levels = levels.join(", ");
            format!("isosurfaces of the values {levels} ({origin}){smoothing}")
        }
    }
}

/// Returns the points at which the image has one of the values `levels`, in the interior of a window with a
/// halo of [`HALO_LAYERS`], in the order of samples.
fn crossings<const D: usize>(
    window: &LayerWindow<'_, D>,
    levels: &[f32],
    cancel: &CancelToken<'_>,
) -> Vec<Candidate<D>> {
    let stack = window.smoothed;
    let volume = stack.volume;
    window.map_rows(cancel, |first, (): &mut (), found| {
        let start = volume.index(first);
        for x in 0..volume.dims[0] {
            let (mut at, i) = (first, start + x);
            at[0] = x;
            let (before, after) = volume.neighbour_offsets(at);
            for axis in 0..D {
                let neighbours = [i + after[axis], i - before[axis]];
                for &level in levels {
                    let is_inside = |i: usize| volume.samples[i] >= level;
                    if neighbours.iter().all(|&n| is_inside(n) == is_inside(i)) {
                        continue;
                    }
                    let crossing = Crossing::near(volume, at, axis, level)
                        .filter(|crossing| dominant_axes(crossing.normal).any(|a| a == axis));
                    if let Some(Crossing { offset, normal }) = crossing {
                        let at = stack.to_volume(at);
                        // All points are equally strong, so that all are followed.
                        let strength = levels[0];
                        let candidate =
                            Candidate::new(window.dims, at, axis, offset, normal, strength);
                        found.push(candidate);
                    }
                }
            }
        }
    })
}

/// A point at which a line of samples along an axis has a value.
struct Crossing<const D: usize> {
    /// Distance from a sample along the axis, in samples.
    offset: f32,
    /// Unit normal of the isosurface.
    normal: [f64; D],
}

impl<const D: usize> Crossing<D> {
    /// Returns the crossing along `axis` that is at most half a sample from sample `at`. If there
    /// are two, it is the one ahead: the lattice cannot resolve both.
    fn near(volume: Volume<'_, D>, at: [usize; D], axis: usize, level: f32) -> Option<Self> {
        // Both samples of a pair decide alike to which of them the crossing belongs.
        let ahead = Self::above(volume, at, axis, level).filter(|(fraction, _)| *fraction <= 0.5);
        let behind = || {
            let mut lower = at;
            lower[axis] = lower[axis].checked_sub(1)?;
            Self::above(volume, lower, axis, level)
                .filter(|(fraction, _)| *fraction > 0.5)
                .map(|(fraction, normal)| (fraction - 1.0, normal))
        };
        let (offset, normal) = ahead.or_else(behind)?;
        Some(Self {
            offset: offset as f32,
            normal,
        })
    }

    /// Returns the crossing between sample `lower` and the next one along `axis`: its distance from
    /// `lower`, from 0 to 1, and its normal.
    fn above(
        volume: Volume<'_, D>,
        lower: [usize; D],
        axis: usize,
        level: f32,
    ) -> Option<(f64, [f64; D])> {
        let mut upper = lower;
        upper[axis] += 1;
        if upper[axis] >= volume.dims[axis] {
            return None;
        }
        let [a, b] = [lower, upper].map(|at| volume.samples[volume.index(at)]);
        if (a >= level) == (b >= level) {
            return None;
        }
        let [a, b, level] = [a, b, level].map(f64::from);
        let fraction = (level - a) / (b - a);
        let [from, to] = [lower, upper].map(|at| gradient(volume, at));
        let gradient: [f64; D] =
            std::array::from_fn(|k| (1.0 - fraction) * from[k] + fraction * to[k]);
        let length = norm(gradient);
        let normal = if length > 0.0 {
            gradient.map(|g| g / length)
        } else {
            std::array::from_fn(|k| f64::from(u8::from(k == axis)))
        };
        Some((fraction, normal))
    }
}

/// Returns the gradient by central differences, on the sides of the volume by one-sided ones.
fn gradient<const D: usize>(volume: Volume<'_, D>, at: [usize; D]) -> [f64; D] {
    let (before, after) = volume.neighbour_offsets(at);
    let i = volume.index(at);
    std::array::from_fn(|k| {
        let steps = u8::from(before[k] > 0) + u8::from(after[k] > 0);
        let [low, high] = [i - before[k], i + after[k]].map(|i| f64::from(volume.samples[i]));
        (high - low) / f64::from(steps.max(1))
    })
}

/// Number of bins of the histogram of values.
const BIN_COUNT: usize = 4096;
/// Number of samples that one thread counts at a time.
const CHUNK_SAMPLES: usize = 1 << 18;
/// Range of no values.
const EMPTY_RANGE: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

/// Returns the range that contains both ranges.
fn joined_range(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Returns the smallest and the largest of the samples where features may lie, of all ranks.
fn value_range<const D: usize>(
    samples: &Samples<'_, D>,
    live: Option<&LiveMask<D>>,
    cancel: &CancelToken<'_>,
) -> Result<[f32; 2]> {
    let mut range = EMPTY_RANGE;
    let mut measure = |window: &LayerWindow<'_, D>| {
        let ranges = map_chunks(window, live, |values| {
            values.fold(EMPTY_RANGE, |range, value| joined_range(range, [value; 2]))
        });
        ranges.into_iter().fold(EMPTY_RANGE, joined_range)
    };
    let mut take = |window_range: [f32; 2]| range = joined_range(range, window_range);
    samples.for_each_window(0, None, &|_| 1, cancel, &mut measure, &mut take)?;
    Ok(range)
}

/// Returns Otsu's threshold of the samples where features may lie, of all ranks.
fn otsu_threshold<const D: usize>(
    samples: &Samples<'_, D>,
    live: Option<&LiveMask<D>>,
    cancel: &CancelToken<'_>,
) -> Result<f32> {
    let [min, max] = value_range(samples, live, cancel)?.map(f64::from);
    let bin = |value: f32| {
        let bin = (f64::from(value) - min) / (max - min) * BIN_COUNT as f64;
        (bin as usize).min(BIN_COUNT - 1)
    };
    let mut counts = vec![0u64; BIN_COUNT];
    let add = |counts: &mut Vec<u64>, more: Vec<u64>| {
        (counts.iter_mut().zip(more)).for_each(|(count, more)| *count += more);
    };
    let mut measure = |window: &LayerWindow<'_, D>| {
        let parts = map_chunks(window, live, |values| {
            let mut counts = vec![0u64; BIN_COUNT];
            values.for_each(|value| counts[bin(value)] += 1);
            counts
        });
        let mut counts = vec![0u64; BIN_COUNT];
        parts.into_iter().for_each(|part| add(&mut counts, part));
        counts
    };
    let mut take = |window_counts: Vec<u64>| add(&mut counts, window_counts);
    samples.for_each_window(0, None, &|_| 1, cancel, &mut measure, &mut take)?;
    Ok((min + otsu_cut(&counts) / BIN_COUNT as f64 * (max - min)) as f32)
}

/// Returns the number of bins of a histogram below Otsu's threshold. Between two classes that are
/// apart, every threshold is equally good; the middle one is returned.
fn otsu_cut(counts: &[u64]) -> f64 {
    let total = counts.iter().sum::<u64>() as f64;
    let moment = |(bin, &count): (usize, &u64)| bin as f64 * count as f64;
    let total_moment: f64 = counts.iter().enumerate().map(moment).sum();
    let (mut below, mut below_moment) = (0.0, 0.0);
    let (mut best_variance, mut best) = (0.0, 0..=0);
    for (bin, count) in counts.iter().enumerate() {
        below += *count as f64;
        below_moment += moment((bin, count));
        let above = total - below;
        if below == 0.0 || above == 0.0 {
            continue;
        }
        let difference = below_moment / below - (total_moment - below_moment) / above;
        let variance = below * above * difference * difference;
        let cut = bin + 1;
        if variance > best_variance {
            (best_variance, best) = (variance, cut..=cut);
        } else if *count == 0 && *best.end() == bin {
            best = *best.start()..=cut;
        }
    }
    0.5 * (best.start() + best.end()) as f64
}

/// Returns what `measure` returns for the samples where features may lie, chunk by chunk, of the
/// interior of a window.
fn map_chunks<const D: usize, T: Send>(
    window: &LayerWindow<'_, D>,
    live: Option<&LiveMask<D>>,
    measure: impl Fn(&mut dyn Iterator<Item = f32>) -> T + Sync,
) -> Vec<T> {
    let (volume, layers) = (Volume::new(window.dims, &[]), &window.interior.layers);
    let first = layers.start * layer_len(window.dims);
    let chunks = window.smoothed.layers(layers).par_chunks(CHUNK_SAMPLES);
    let chunks = chunks.enumerate().map(|(number, chunk)| {
        let start = first + number * CHUNK_SAMPLES;
        let is_usable =
            |i: usize| live.is_none_or(|live| live.is_usable(volume.coordinates(start + i)));
        let mut values = (chunk.iter().enumerate())
            .filter(|(i, _)| is_usable(*i))
            .map(|(_, &value)| value);
        measure(&mut values)
    });
    chunks.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::run_threads;
    use crate::feature::scenes::Noise;
    use crate::feature::windows::tests::LayeredImage;
    use crate::feature::{DetectionOptions, Features, SharedGrid, detect, detect_part};
    use crate::geometry::{dot, sub};
    use crate::image::{Geometry, Image, ImageSource};

    /// Returns an image of a function of the sample coordinates.
    fn image_of<const D: usize>(
        dims: [usize; D],
        mut value: impl FnMut([f64; D]) -> f64,
    ) -> Image<D> {
        let volume = Volume::new(dims, &[]);
        let position = |i: usize| volume.coordinates(i).map(|c| c as f64);
        let samples = (0..dims.iter().product()).map(|i| value(position(i)) as f32);
        Image::new(dims, samples.collect(), Geometry::default())
    }

    fn options<const D: usize>(threshold: Option<f32>) -> DetectionOptions<D> {
        DetectionOptions {
            threshold,
            ..DetectionOptions::with_kind(FeatureKind::Isosurface, 4.0)
        }
    }

    fn candidates_of<const D: usize>(
        image: &Image<D>,
        options: &DetectionOptions<D>,
    ) -> Vec<Candidate<D>> {
        let cancel = CancelToken::never();
        let input = DetectorInput::new(ImageSource::InMemory(image), options, &cancel);
        let output = Isosurface.find(&input, &mut Vec::new()).unwrap();
        output.candidates
    }

    fn distance_from<const D: usize>(centre: [f64; D], p: [f64; D]) -> f64 {
        norm(sub(p, centre))
    }

    /// Finds isosurfaces of a ball (a disc in 2-D) with a soft edge, which are spheres.
    fn check_ball<const D: usize>(dims: [usize; D], centre: [f64; D], radius: f64) {
        const EDGE_WIDTH: f64 = 1.5;
        let image = image_of(dims, |p| {
            100.0 * ((radius - distance_from(centre, p)) / EDGE_WIDTH).tanh()
        });
        for level in [-30.0f32, 0.0, 30.0] {
            let radius = radius - EDGE_WIDTH * f64::from(level / 100.0).atanh();
            let features = detect(&image, &options(Some(level))).unwrap();
            let (mut squares, mut worst) = (0.0, 0.0f64);
            for point in &features.points {
                let p = point.position.map(f64::from);
                let error = distance_from(centre, p) - radius;
                squares += error * error;
                worst = worst.max(error.abs());
                let radial: [f64; D] = std::array::from_fn(|k| (p[k] - centre[k]) / radius);
                let cosine = dot(radial, point.normal.map(f64::from)).abs();
                assert!(cosine > 0.995, "{cosine}");
            }
            let rms = (squares / features.points.len() as f64).sqrt();
            assert!(rms < 0.05 && worst < 0.1, "{level}: {rms} {worst}");
            assert_no_holes(dims, &features, |p| distance_from(centre, p) - radius);
        }
    }

    /// Checks that each sample within half a sample of the surface has a point at most 1.3 samples
    /// away.
    fn assert_no_holes<const D: usize>(
        dims: [usize; D],
        features: &Features<D>,
        distance: impl Fn([f64; D]) -> f64,
    ) {
        let volume = Volume::new(dims, &[]);
        for i in 0..dims.iter().product() {
            let p = volume.coordinates(i).map(|c| c as f64);
            let is_near = |q: [f32; D]| distance_from(p, q.map(f64::from)) < 1.3;
            let has_point = || features.points.iter().any(|point| is_near(point.position));
            assert!(distance(p).abs() > 0.5 || has_point(), "{p:?}");
        }
    }

    #[test]
    fn discs_and_balls_have_the_exact_radius() {
        check_ball([70, 66], [34.3, 32.6], 22.4);
        check_ball([44, 42, 40], [21.3, 20.7, 19.5], 13.6);
    }

    /// Finds an isosurface of a linear image: a plane through the middle.
    fn check_plane<const D: usize>(dims: [usize; D], normal: [f64; D]) {
        let middle = dims.map(|n| 0.5 * n as f64 - 0.37);
        let height = |p: [f64; D]| -> f64 { (0..D).map(|k| normal[k] * (p[k] - middle[k])).sum() };
        let image = image_of(dims, |p| height(p) + 3.0);
        let candidates = candidates_of(&image, &options(Some(3.0)));
        for c in &candidates {
            let error = height(c.position.map(f64::from)).abs();
            assert!(error < 1e-5, "{normal:?}: {error} at {:?}", c.position);
            for k in 0..D {
                let error = (f64::from(c.normal[k]) - normal[k]).abs();
                assert!(error < 1e-5, "{normal:?}: {:?}", c.normal);
            }
        }
        // Each column along the axis nearest to the normal has one point.
        let size = |k: usize| normal[k].abs();
        let axis = (1..D).fold(0, |a, k| if size(k) > size(a) { k } else { a });
        let mut expected = 0;
        for i in 0..dims.iter().product() {
            let mut p = Volume::new(dims, &[]).coordinates(i).map(|c| c as f64);
            if p[axis] == 0.0 {
                p[axis] -= height(p) / normal[axis];
                expected += usize::from(p[axis] >= 0.0 && p[axis] <= dims[axis] as f64 - 1.0);
            }
        }
        let columns = candidates.iter().filter(|c| usize::from(c.axis) == axis);
        assert_eq!(columns.count(), expected, "{normal:?}");
    }

    #[test]
    fn planes_of_a_linear_image_are_exact_at_every_dip() {
        for dip in (0..180).step_by(7) {
            let (sin, cos) = f64::from(dip).to_radians().sin_cos();
            check_plane([31, 27], [cos, sin]);
            for azimuth in (0..360).step_by(50) {
                let (y, z) = f64::from(azimuth).to_radians().sin_cos();
                check_plane([17, 19, 16], [cos, sin * y, sin * z]);
            }
        }
    }

    #[test]
    fn otsu_separates_two_classes() {
        // A disc of 90 on a background of 10: every value between them is equally good.
        let mut random = Noise::new(3);
        let is_disc = |p: [f64; 2]| distance_from([30.0, 25.0], p) < 15.0;
        let image = image_of([60, 50], |p| if is_disc(p) { 90.0 } else { 10.0 });
        let features = detect(&image, &options(None)).unwrap();
        let note = features.notes[0].as_str();
        assert_eq!(note, "isosurface of the value 50 (Otsu's threshold)");
        assert_eq!(
            [features.resolved[0].low, features.resolved[0].high],
            [50.0; 2]
        );
        // In noise, the threshold is between the means.
        let image = image_of([60, 50], |p| {
            (if is_disc(p) { 90.0 } else { 10.0 }) + 12.0 * random.normal()
        });
        let features = detect(&image, &options(None)).unwrap();
        let level = features.resolved[0].high;
        assert!((level - 50.0).abs() < 4.0, "{level}");
        let is_on_edge = |p: [f32; 2]| {
            let distance = distance_from([30.0, 25.0], p.map(f64::from)) - 15.0;
            distance.abs() < 1.5
        };
        assert!(features.points.len() > 80);
        assert!(features.points.iter().all(|p| is_on_edge(p.position)));
        // Three of ten samples in a second class, as by hand.
        assert_eq!(otsu_cut(&[4, 3, 0, 0, 1, 2]), 3.0);
    }

    #[test]
    fn a_value_that_the_image_never_has_is_refused() {
        let image = image_of([20, 18, 16], |p| p[0] + p[1]);
        for level in [-1.0, 36.5] {
            let error = detect(&image, &options(Some(level))).unwrap_err();
            let error = error.to_string();
            assert!(
                error.starts_with(&format!("threshold {level}: "))
                    && error.contains("from 0 to 36; "),
                "{error}"
            );
        }
        // A part of the image need not have it.
        let features = detect(&image, &options(Some(18.0))).unwrap();
        let part = image_of([5, 5, 16], |p| p[0] + p[1]);
        let open_sides = [[true; 2]; 3];
        let cancel = CancelToken::never();
        let resolved = &features.resolved;
        let features = detect_part(&part, &options(None), resolved, &open_sides, &cancel).unwrap();
        assert!(features.points.is_empty());
    }

    #[test]
    fn a_part_has_the_level_and_the_scale_of_the_whole() {
        let mut random = Noise::new(8);
        let image = image_of([60, 50], |p| {
            50.0 * (p[0] / 7.0).sin() + 2.0 * p[1] + random.normal()
        });
        let mut options = options(None);
        options.scale = Some(0.8);
        let whole = detect(&image, &options).unwrap();
        let samples = image.as_slice().chunks(60).flat_map(|row| &row[..40]);
        let part = Image::new([40, 50], samples.copied().collect(), Geometry::default());
        options.scale = None;
        let mut open_sides = [[false; 2]; 2];
        open_sides[0][1] = true;
        let cancel = CancelToken::never();
        let part = detect_part(&part, &options, &whole.resolved, &open_sides, &cancel).unwrap();
        let inner = |features: &Features<2>| -> Vec<[f32; 2]> {
            let positions = features.points.iter().map(|point| point.position);
            positions.filter(|p| p[0] < 34.0).collect()
        };
        assert!(inner(&whole).len() > 30);
        assert_eq!(inner(&part), inner(&whole));
    }

    #[test]
    fn nothing_is_found_where_there_are_no_data() {
        let image = image_of([50, 40], |p| {
            let has_data = distance_from([25.0, 20.0], p) > 9.0;
            if has_data {
                p[1] + 0.2 * p[0]
            } else {
                f64::NAN
            }
        });
        let features = detect(&image, &options(Some(25.0))).unwrap();
        let distance = |p: [f32; 2]| distance_from([25.0, 20.0], p.map(f64::from));
        let positions = || features.points.iter().map(|point| point.position);
        assert!(positions().all(|p| distance(p) > 8.0));
        assert!(positions().filter(|p| p[0] < 12.0).count() >= 10);
    }

    /// Checks that windows of layers, and ranks, find what the whole image gives.
    fn check_windows_match_whole<const D: usize>(dims: [usize; D], scale: Option<f64>) {
        let mut random = Noise::new(5);
        let image = image_of(dims, |p| {
            let wave: f64 = (0..D).map(|k| (0.15 * (k + 1) as f64 * p[k]).sin()).sum();
            100.0 * wave + 8.0 * random.normal()
        });
        let options = DetectionOptions {
            scale,
            ..options(None)
        };
        let cancel = CancelToken::never();
        let input = DetectorInput::new(ImageSource::InMemory(&image), &options, &cancel);
        let [mut notes, mut other_notes] = [Vec::new(), Vec::new()];
        let whole = Isosurface.find(&input, &mut notes).unwrap();
        let same = |candidates: &[Candidate<D>]| {
            let key = |c: &Candidate<D>| (c.voxel, c.axis, c.position, c.normal, c.strength);
            candidates.len() == whole.candidates.len()
                && (candidates.iter().zip(&whole.candidates)).all(|(a, b)| key(a) == key(b))
        };
        assert!(whole.candidates.len() > dims[0]);
        assert!(whole.candidates.is_sorted_by_key(|c| c.voxel));
        let by_layers = LayeredImage(&image);
        let samples = Samples::from_layers(&by_layers, 1.0).with_limits([0, 1]);
        let windowed = find_in_samples(&input, samples, &mut other_notes).unwrap();
        assert_eq!(notes, other_notes);
        assert!(same(&windowed.candidates));
        for ranks in [2, 3] {
            run_threads(ranks, |comm| {
                let input = DetectorInput {
                    grid: SharedGrid::new(dims, comm),
                    ..DetectorInput::new(ImageSource::InMemory(&image), &options, &cancel)
                };
                let mut shared = Isosurface.find(&input, &mut Vec::new()).unwrap();
                assert!(same(&shared.gather_candidates(input.grid).unwrap()));
            });
        }
    }

    #[test]
    fn windows_find_what_the_whole_finds() {
        for scale in [None, Some(1.3)] {
            check_windows_match_whole([52, 150], scale);
            check_windows_match_whole([32, 28, 90], scale);
        }
    }
}
