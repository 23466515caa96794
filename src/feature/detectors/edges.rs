//! Edges: steps between low and high values, found as ridges of the gradient magnitude.
//!
//! The gradient magnitude is Prewitt's ([`prewitt`]), as Hale (2001) uses it for a medical image,
//! of the image under a Gaussian of one sample. Its ridges are found as those of any image
//! ([`ridges`](super::ridges)), so that it is smoothed once more.
//!
//! Scale: one sample, for the gradient and its ridges. Where noise hides the ridges, larger scales
//! are used. Assumption: the radius of curvature of an edge is large compared with the smoothing.
//!
//! Smoothing moves an edge towards its centre of curvature. Under a Gaussian, a level set moves as by
//! diffusion over the time s^2 / 2: a sphere of radius R shrinks to r, where R^2 = r^2 + (D - 1) s^2. The
//! points are moved back by this much, with the curvature that the level sets of the smoothed image have
//! there. Measured: balls of radius 7 to 20 have their radius within 0.02 samples.

use super::ridges::RidgeSearch;
use super::{Detector, DetectorInput, DetectorOutput};
use crate::error::Result;
use crate::feature::FeatureKind;
use crate::feature::candidate::Candidate;
use crate::feature::corners::{self, sharpen_corners};
use crate::feature::gradient_magnitude::prewitt;
use crate::feature::volume::Volume;
use crate::feature::windows::{LayerStack, LayerWindow};
use crate::geometry::{dot, hypot, norm};
use crate::parallel::prelude::*;
use std::ops::Range;

/// Detector of steps between low and high values.
pub struct Edges;

impl<const D: usize> Detector<D> for Edges {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Edges
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let dims = input.dims();
        let smoothed = input.smoothed_in_layers()?;
        let magnitude =
            smoothed.map_windows(1, input.cancel, |stack| prewitt(stack.volume, input.cancel))?;
        drop(smoothed);
        let search = RidgeSearch {
            min_scale: 1.0,
            uses_oriented_filters: false,
            ..RidgeSearch::new(input)
        };
        let mut output = search.find(magnitude, notes)?;
        // The image is smoothed before the gradient is taken, and the gradient magnitude before its
        // ridges are.
        let width = hypot(input.scale(), output.scale);
        if let Some(layers) = output.layers.clone() {
            move_to_edges(input, &mut output.candidates, &layers, width)?;
        }
        let min_strength = output.thresholds.high;
        if D == 2 {
            let candidates = output.gather_candidates(input.grid)?;
            output.candidates =
                sharpen_corners(dims, candidates, width, min_strength, input.cancel);
        }
        Ok(output)
    }

    fn is_streamable(&self) -> bool {
        true
    }

    fn has_scattered_normals(&self) -> bool {
        true
    }

    /// Returns the reach of detection, which includes that of corners along their arms.
    fn reach(&self, scale: f64) -> usize {
        (3.0 * scale).ceil() as usize + 3 + corners::corner_reach(hypot(scale, scale))
    }
}

/// Variance, in square samples, of the smoothing along an edge by Prewitt's average over three samples.
const PREWITT_VARIANCE: f64 = 2.0 / 3.0;
/// Number of samples to either side that second derivatives need.
const DERIVATIVE_REACH: usize = 2;
/// Smallest radius of curvature, in widths of the smoothing, of an edge that is moved back: a smaller one is
/// that of a smoothed corner.
const MIN_RADIUS_RATIO: f64 = 3.0;
/// Largest move of a point, in widths of the smoothing: near corners and noise, curvatures mean nothing.
const MAX_MOVE_RATIO: f64 = 0.5;
/// Smallest component of the normal along the axis of a point, along which it moves.
const MIN_AXIS_COMPONENT: f64 = 0.5;

/// Moves points of edges to where they were before the image was smoothed over `width` samples. The points are
/// all those of `layers`, in the order of samples. They stay in their columns of samples.
fn move_to_edges<const D: usize>(
    input: &DetectorInput<'_, D>,
    candidates: &mut [Candidate<D>],
    layers: &Range<usize>,
    width: f64,
) -> Result<()> {
    let mut samples = input.samples(1.0)?;
    samples.smooth(width, input.cancel);
    let volume = Volume::new(input.dims(), &[]);
    let variance = width * width + PREWITT_VARIANCE;
    let mut correct = |window: &LayerWindow<'_, D>| {
        let range = &window.interior.layers;
        let layer = |c: &Candidate<D>| volume.coordinates(c.voxel.index())[D - 1];
        let [first, end] =
            [range.start, range.end].map(|end| candidates.partition_point(|c| layer(c) < end));
        candidates[first..end].par_iter_mut().for_each(|candidate| {
            if let Some(offset) = edge_offset(window.smoothed, candidate, input.dims(), variance) {
                let axis = usize::from(candidate.axis);
                let last = (input.dims()[axis] - 1) as f32;
                let moved = candidate.position[axis] + offset;
                candidate.position[axis] = moved.clamp(0.0, last);
            }
        });
    };
    samples.for_each_window_in(
        layers,
        DERIVATIVE_REACH + 1,
        None,
        &|_| 1,
        input.cancel,
        &mut correct,
    )
}

/// Returns by how much a point of an edge moves along its axis, if smoothing of this `variance` moved it.
/// `None` at the sides of the image, where derivatives are uncertain.
fn edge_offset<const D: usize>(
    smoothed: LayerStack<'_, D>,
    candidate: &Candidate<D>,
    dims: [usize; D],
    variance: f64,
) -> Option<f32> {
    let axis = usize::from(candidate.axis);
    let at: [usize; D] = Volume::new(dims, &[]).coordinates(candidate.voxel.index());
    let offset = candidate.position[axis] - at[axis] as f32;
    let mut next = at;
    next[axis] = if offset < 0.0 {
        at[axis].checked_sub(1)?
    } else {
        at[axis] + 1
    };
    let is_inside = |at: [usize; D]| {
        (0..D).all(|k| at[k] >= DERIVATIVE_REACH && at[k] + DERIVATIVE_REACH < dims[k])
    };
    if !is_inside(at) || !is_inside(next) {
        return None;
    }
    let [(normal, here), (_, there)] = [at, next].map(|at| {
        let at = smoothed.to_stack(at);
        let gradient = smoothed.volume.gradient(at).map(f64::from);
        level_set_curvature(gradient, &smoothed.volume.second_derivatives(at))
    });
    let share = f64::from(offset.abs()).min(1.0);
    let curvature = (1.0 - share) * here + share * there;
    if curvature == 0.0 || normal[axis].abs() < MIN_AXIS_COMPONENT {
        return None;
    }
    let radius = (D - 1) as f64 / curvature;
    if radius.abs() < MIN_RADIUS_RATIO * variance.sqrt() {
        return None;
    }
    let distance = radius * ((1.0 + (D - 1) as f64 * variance / (radius * radius)).sqrt() - 1.0);
    let max_move = MAX_MOVE_RATIO * variance.sqrt();
    Some((distance.clamp(-max_move, max_move) / normal[axis]) as f32)
}

/// Returns the direction of the gradient and its divergence: the sum of the curvatures of a level set, positive
/// where the gradient points away from the centre of curvature. Both are zero where there is no gradient.
fn level_set_curvature<const D: usize>(
    gradient: [f64; D],
    hessian: &[[f64; D]; D],
) -> ([f64; D], f64) {
    let length = norm(gradient);
    if length <= 0.0 {
        return ([0.0; D], 0.0);
    }
    let normal = gradient.map(|g| g / length);
    let laplacian: f64 = (0..D).map(|k| hessian[k][k]).sum();
    let along_normal = dot(normal, hessian.map(|row| dot(row, normal)));
    (normal, (laplacian - along_normal) / length)
}

#[cfg(test)]
mod tests {
    use super::level_set_curvature;
    use crate::feature::scenes::{ExactSurface, Noise, image_of, measure_fit};
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::geometry::{norm, sub};

    /// Checks that the mean distance of edge points from a centre is the radius, in an image that falls from 100
    /// to 0 over an edge of this width.
    fn check_radius<const D: usize>(radius: f64, width: f64, shift: f64, sign: f64) {
        let side = (2.0 * radius) as usize + 20;
        let centre: [f64; D] =
            std::array::from_fn(|k| (side / 2) as f64 + shift * (1.0 - 0.4 * k as f64));
        let distance = |p: [f64; D]| norm(sub(p, centre)) - radius;
        let image = image_of([side; D], |p| {
            sign * 50.0 * (1.0 - (distance(p) / width).tanh())
        });
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Edges, 3.0),
        )
        .unwrap();
        let errors = features
            .points
            .iter()
            .map(|point| distance(point.position.map(f64::from)));
        let mean = errors.sum::<f64>() / features.points.len() as f64;
        assert!(features.points.len() > 30);
        assert!(
            mean.abs() < 0.035,
            "{D} {radius} {width} {shift} {sign}: {mean}"
        );
    }

    #[test]
    fn round_edges_have_their_radius_at_any_blur() {
        for radius in [7.0, 10.0, 12.3] {
            for (width, shift, sign) in [(0.9, 0.3, 1.0), (1.5, 0.5, -1.0), (2.5, 0.1, 1.0)] {
                check_radius::<2>(radius, width, shift, sign);
                check_radius::<3>(radius, width, shift, sign);
            }
        }
    }

    #[test]
    fn the_curvature_of_level_sets_is_that_of_spheres_and_cylinders() {
        // f = |p|^2 / 2 at distance 5 has gradient p and the unit matrix as its second derivatives.
        let [x, y, z] = [0.0, 3.0, 4.0];
        let sphere = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let (normal, curvature) = level_set_curvature([x, y, z], &sphere);
        assert!((curvature - 0.4).abs() < 1e-12 && (normal[2] - 0.8).abs() < 1e-12);
        let cylinder = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!((level_set_curvature([x, y, z], &cylinder).1 - 0.2).abs() < 1e-12);
    }

    #[test]
    fn edges_of_a_ball() {
        let (dims, ball) = ([60, 56, 52], ExactSurface::Sphere([30.0, 28.0, 26.0], 19.0));
        let mut noise = Noise::new(3);
        let image = image_of(dims, |p| {
            100.0 / (1.0 + ball.distance(p).exp()) + 5.0 * noise.normal()
        });
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Edges, 5.0),
        )
        .unwrap();
        let fit = measure_fit(dims, &[ball], &features.points);
        assert!(
            fit.coverage > 0.98 && fit.precision > 0.98 && fit.rms < 0.15,
            "{fit:?}"
        );
    }

    #[test]
    fn straight_edges_lie_where_they_are() {
        let (dims, wall) = (
            [48, 44, 40],
            [ExactSurface::plane([1.0, 0.45, -0.3], [24.0, 22.0, 20.0])],
        );
        let mut noise = Noise::new(4);
        let image = image_of(dims, |p| {
            100.0 / (1.0 + wall[0].distance(p).exp()) + 5.0 * noise.normal()
        });
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Edges, 5.0),
        )
        .unwrap();
        let fit = measure_fit(dims, &wall, &features.points);
        assert!(
            fit.coverage > 0.99 && fit.precision > 0.99 && fit.rms < 0.08 && fit.angle < 2.0,
            "{fit:?}"
        );
    }
}
