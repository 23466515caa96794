//! Fault networks as in real surveys: faults cross at small angles, branch off one another, run
//! close and parallel, come in conjugate pairs, flatten with depth and taper out.
//!
//! The first fault is drawn freely. Each later fault is related to an earlier one (see
//! [`Relation`]). A fault is drawn again if it cannot be distinguished from an earlier one: if the
//! two are closer than [`MIN_FAULT_DISTANCE`] samples at an angle of less than
//! [`MIN_CROSSING_ANGLE`] degrees.

use super::exact_distance::exists_at;
use super::surface::{ImplicitSurface, Rim, SurfacePoint, Termination, Wave};
use super::{Options, Result};
use crate::Error;
use crate::error::cause;
use crate::geometry::random::{Random, splitmix64, uniform};
use crate::geometry::{cross, dot, norm, sub, unit};
use crate::parallel::prelude::*;
use std::f64::consts::TAU;

/// Smallest angle, in degrees, at which faults cross.
const MIN_CROSSING_ANGLE: f64 = 14.0;
/// Distance, in samples, from which faults may have any angle to each other.
const MIN_FAULT_DISTANCE: f64 = 2.75;
/// Distance, in samples, over which the strength of a fault tapers out about its rim.
const TAPER_LENGTH: f64 = 12.0;
/// Largest number of faults that are drawn for a network.
const MAX_ATTEMPTS: usize = 400;
/// Distance, in samples, between the points at which faults are compared.
const POINT_SPACING: f64 = 3.0;

/// Relation of a fault to an earlier one.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Relation {
    /// Crosses the other fault at 15 to 80 degrees.
    Crossing,
    /// Branches off the other fault at 15 to 50 degrees, and ends there.
    Splay,
    /// Has the shape of the other fault, 3 to 12 samples away.
    Parallel,
    /// Has the strike of the other fault and dips the opposite way, crossing at 40 to 70 degrees.
    Conjugate,
}

/// Returns the faults of a network: 2 to 6 of them, or `options.count`.
///
/// # Errors
/// Returns an [`Error::Job`] if not enough faults are found.
pub(super) fn faults(options: &Options) -> Result<Vec<ImplicitSurface>> {
    let mut random = Random::for_purpose(options.seed, 0x6e65_7477);
    let drawn = 2 + (5.0 * random.draw()) as usize;
    let count = options.count.unwrap_or(drawn);
    let mut faults: Vec<DrawnFault> = Vec::new();
    for _ in 0..MAX_ATTEMPTS {
        let fault = DrawnFault::draw_next(&mut random, options.dims, &faults);
        let fits = fault.points.len() as f64 * POINT_SPACING * POINT_SPACING
            > min_area(options.dims)
            && (0..faults.len()).all(|k| fault.is_distinct_from(&faults, k));
        if fits {
            faults.push(fault);
        }
        if faults.len() == count {
            return Ok(faults.into_iter().map(|f| f.surface).collect());
        }
    }
    Err(Error::Job(cause(
        format!("synth count {count}"),
        format!(
            "only {} distinguishable faults fit into {:?} samples",
            faults.len(),
            options.dims
        ),
        "give fewer faults, larger dimensions or another seed",
    )))
}

/// Returns the smallest area of a fault (in 2-D, its length times [`POINT_SPACING`]).
fn min_area(dims: [usize; 3]) -> f64 {
    let volume = dims.iter().product::<usize>() as f64;
    match dims[2] {
        1 => 0.3 * volume.sqrt() * POINT_SPACING,
        _ => 0.12 * volume.powf(2.0 / 3.0),
    }
}

/// A fault, the parameters with which it was drawn, and points all over it.
struct DrawnFault {
    surface: ImplicitSurface,
    centre: [f64; 3],
    normal: [f64; 3],
    waves: Vec<Wave>,
    points: Vec<SurfacePoint>,
}

impl DrawnFault {
    /// Draws a fault that is related to an earlier one, if there is one.
    fn draw_next(random: &mut Random, dims: [usize; 3], earlier: &[DrawnFault]) -> Self {
        let extent = dims.map(|n| (n - 1) as f64);
        let is_2d = dims[2] == 1;
        let middle: [f64; 3] = std::array::from_fn(|k| extent[k] * random.range(0.25, 0.75));
        let free_normal = random_normal(random, is_2d);
        if earlier.is_empty() {
            let waves = draw_waves(random, extent, is_2d);
            return Self::new(random, dims, earlier, middle, free_normal, waves, None);
        }
        let parent = &earlier[(random.draw() * earlier.len() as f64) as usize % earlier.len()];
        let meeting_point = parent.points[(random.draw() * parent.points.len() as f64) as usize];
        let relation = match random.draw() {
            x if x < 0.35 => Relation::Crossing,
            x if x < 0.6 => Relation::Splay,
            x if x < 0.8 => Relation::Parallel,
            _ => Relation::Conjugate,
        };
        let rotate_normal = |angle: f64, axis: [f64; 3]| {
            let across = cross(axis, meeting_point.normal);
            let (sin, cos) = angle.to_radians().sin_cos();
            std::array::from_fn(|k| cos * meeting_point.normal[k] + sin * across[k])
        };
        let sign = if random.draw() < 0.5 { -1.0 } else { 1.0 };
        // Direction of the line in which both faults meet: perpendicular to the plane in 2-D, else
        // any direction in the tangent plane of the parent.
        let intersection = {
            let horizontal = horizontal_direction(meeting_point.normal);
            let dip_direction = cross(meeting_point.normal, horizontal);
            let (sin, cos) = random.range(0.0, TAU).sin_cos();
            if is_2d {
                [0.0, 0.0, 1.0]
            } else {
                std::array::from_fn(|k| cos * horizontal[k] + sin * dip_direction[k])
            }
        };
        match relation {
            Relation::Parallel => {
                let gap = sign * random.range(3.0, 12.0);
                let n = parent.normal;
                let centre = std::array::from_fn(|k| parent.centre[k] + gap * n[k]);
                Self::new(random, dims, earlier, centre, n, parent.waves.clone(), None)
            }
            Relation::Crossing | Relation::Splay => {
                let max_angle = if relation == Relation::Splay {
                    50.0
                } else {
                    80.0
                };
                let normal = rotate_normal(sign * random.range(16.0, max_angle), intersection);
                let waves = draw_waves(random, extent, is_2d);
                let end = (relation == Relation::Splay).then(|| Termination {
                    surface: index_of(earlier, parent),
                    side: if random.draw() < 0.5 { -1.0 } else { 1.0 },
                });
                Self::new(
                    random,
                    dims,
                    earlier,
                    meeting_point.point,
                    normal,
                    waves,
                    end,
                )
            }
            Relation::Conjugate => {
                let axis = if is_2d {
                    [0.0, 0.0, 1.0]
                } else {
                    horizontal_direction(meeting_point.normal)
                };
                let normal = rotate_normal(sign * random.range(40.0, 70.0), axis);
                let waves = draw_waves(random, extent, is_2d);
                Self::new(
                    random,
                    dims,
                    earlier,
                    meeting_point.point,
                    normal,
                    waves,
                    None,
                )
            }
        }
    }

    fn new(
        random: &mut Random,
        dims: [usize; 3],
        earlier: &[DrawnFault],
        centre: [f64; 3],
        normal: [f64; 3],
        waves: Vec<Wave>,
        end: Option<Termination>,
    ) -> Self {
        let mut surface = ImplicitSurface::sheet(centre, normal, waves.clone());
        surface.end = end;
        let size = dims.iter().filter(|&&n| n > 1).map(|&n| n as f64);
        let size = size.clone().sum::<f64>() / size.count() as f64;
        if random.draw() < 0.4 {
            surface.rim = Some(Rim {
                radii: [0, 1].map(|_| size * random.range(0.28, 0.5)),
                taper: TAPER_LENGTH,
            });
        }
        let points = surface_points(&surface, dims, earlier);
        Self {
            surface,
            centre,
            normal,
            waves,
            points,
        }
    }

    /// Returns `true` if this fault keeps its distance from fault `k` of the earlier ones, or
    /// crosses it steeply enough.
    fn is_distinct_from(&self, earlier: &[DrawnFault], k: usize) -> bool {
        let other = &earlier[k];
        let ends_there = self.surface.end.is_some_and(|end| end.surface == k);
        self.points.par_iter().all(|p| {
            if other.surface.level(p.point).abs() > MIN_FAULT_DISTANCE * other.surface.max_gradient
            {
                return true;
            }
            let foot = other.surface.closest_point_in_rim(p.point);
            let gap = sub(foot.point, p.point);
            let is_shallow =
                dot(foot.normal, p.normal).abs() > MIN_CROSSING_ANGLE.to_radians().cos();
            let exists = ends_there || other.surface.exists_at(|i| &earlier[i].surface, foot.point);
            !exists || !is_shallow || dot(gap, gap) > MIN_FAULT_DISTANCE * MIN_FAULT_DISTANCE
        })
    }
}

fn index_of(faults: &[DrawnFault], fault: &DrawnFault) -> usize {
    faults
        .iter()
        .position(|f| std::ptr::eq(f, fault))
        .unwrap_or(0)
}

/// Returns a horizontal direction in a surface with this normal; y if the surface itself is
/// horizontal.
fn horizontal_direction(normal: [f64; 3]) -> [f64; 3] {
    let direction = cross(normal, [1.0, 0.0, 0.0]);
    if norm(direction) > 1e-9 {
        unit(direction)
    } else {
        [0.0, 1.0, 0.0]
    }
}

/// Returns the normal of a steep fault with a random strike.
fn random_normal(random: &mut Random, is_2d: bool) -> [f64; 3] {
    let dip = random.range(50.0, 88.0).to_radians();
    let strike = random.range(0.0, TAU);
    fault_normal(dip, strike, is_2d)
}

/// Returns the normal of a fault. A 2-D fault is a curve, represented by a surface perpendicular to
/// the plane.
pub(super) fn fault_normal(dip: f64, strike: f64, is_2d: bool) -> [f64; 3] {
    if is_2d {
        [strike.cos(), strike.sin(), 0.0]
    } else {
        [
            dip.cos(),
            dip.sin() * strike.cos(),
            dip.sin() * strike.sin(),
        ]
    }
}

/// Draws two gentle waves (radius of curvature at least 80 samples), or the one long bend of a
/// listric fault.
fn draw_waves(random: &mut Random, extent: [f64; 3], is_2d: bool) -> Vec<Wave> {
    let size = extent.iter().sum::<f64>() / if is_2d { 2.0 } else { 3.0 };
    let listric = random.draw() < 0.25;
    let count = if listric { 1 } else { 2 };
    let radius = random.range(80.0, 200.0) * count as f64;
    (0..count)
        .map(|_| {
            let length = if listric { 3.0 } else { random.range(0.8, 1.8) } * size;
            let k = TAU / length;
            let azimuth = if is_2d { 0.0 } else { random.range(0.0, TAU) };
            let (sin, cos) = azimuth.sin_cos();
            Wave {
                // The slope stays below 0.35, so that crossing angles are close to those that were
                // drawn.
                amplitude: (1.0 / (radius * k * k)).min(0.35 / (k * count as f64)),
                wave: [k * cos, k * sin],
                phase: random.range(0.0, TAU),
            }
        })
        .collect()
}

/// Returns points all over a fault, inside the box, its rim and the side on which it exists.
fn surface_points(
    surface: &ImplicitSurface,
    dims: [usize; 3],
    earlier: &[DrawnFault],
) -> Vec<SurfacePoint> {
    let extent = dims.map(|n| (n - 1) as f64);
    let reach = (norm(extent) / POINT_SPACING) as i32;
    let lines = if dims[2] == 1 { 0..=0 } else { -reach..=reach };
    let mut points = Vec::new();
    for j in lines {
        for i in -reach..=reach {
            // In 2-D the surface is perpendicular to the plane: its second or third axis is z.
            let mut coordinates = [f64::from(i) * POINT_SPACING, f64::from(j) * POINT_SPACING];
            if dims[2] == 1 && surface.point_at([1.0, 0.0]).point[2].abs() > 0.5 {
                coordinates.swap(0, 1);
            }
            let foot = surface.point_at(coordinates);
            let is_inside =
                (0..3).all(|k| (0.0..=extent[k]).contains(&foot.point[k]) || extent[k] == 0.0);
            let exists = surface.exists_at(|i| &earlier[i].surface, foot.point);
            if is_inside && exists && surface.strength(foot.point) >= 0.5 {
                points.push(foot);
            }
        }
    }
    points
}

/// Returns the fault likelihood: Gaussian ridges of standard deviation `options.width`. Each has
/// its own height of 0.7 to 1, which varies along the fault, and tapers out about its rim. Where
/// ridges overlap, the largest value is used.
pub(super) fn likelihood(faults: &[ImplicitSurface], options: &Options) -> Vec<f32> {
    max_over_faults(faults, options, 4.0 * options.width, |k, foot, distance| {
        let height = 0.85 + 0.15 * slow_variation(options.seed, k as u64, foot.point, options.dims);
        height * (-0.5 * (distance / options.width).powi(2)).exp() * faults[k].strength(foot.point)
    })
}

/// Returns a mask as an interpreter might paint it: 1 on faults, 1 to 5 samples thick, with holes,
/// and on stray pieces away from them; 0 elsewhere.
pub(super) fn mask(faults: &[ImplicitSurface], options: &Options) -> Vec<f32> {
    // There are twelve holes per fault and twelve stray pieces in 128^3 samples, and the same
    // density in other volumes.
    let size = options.dims.map(|n| n as f64 / 128.0);
    let size = size.iter().product::<f64>().cbrt();
    let count_for = |power| (12.0 * size.powi(power)).ceil() as u64;
    let holes: Vec<Vec<([f64; 3], f64)>> = (0..faults.len())
        .map(|k| blobs(options, 0x401e + k as u64, count_for(2), [2.0, 6.0]))
        .collect();
    let mut samples = max_over_faults(faults, options, 3.0, |k, foot, distance| {
        let thickness =
            3.0 + 2.0 * slow_variation(options.seed, 0x7c + k as u64, foot.point, options.dims);
        // Holes are cut out of the surface by balls about the closest points of random positions.
        let is_hole = holes[k].iter().any(|&(c, r)| {
            let gap = sub(faults[k].closest_point(c).point, foot.point);
            dot(gap, gap) < r * r
        });
        f64::from(!is_hole && distance <= 0.5 * thickness && faults[k].strength(foot.point) >= 0.5)
    });
    let [nx, ny, _] = options.dims;
    let spurious_blobs = blobs(options, 0x57aa, count_for(3), [1.0, 3.0]);
    samples
        .par_chunks_mut(nx * ny)
        .enumerate()
        .for_each(|(z, plane)| {
            for (i, sample) in plane.iter_mut().enumerate() {
                let p = [(i % nx) as f64, (i / nx) as f64, z as f64];
                let is_inside = |&(c, r): &([f64; 3], f64)| {
                    let gap = sub(p, c);
                    dot(gap, gap) < r * r
                };
                if spurious_blobs.iter().any(is_inside) {
                    *sample = 1.0;
                }
            }
        });
    samples
}

/// Returns random balls in the box.
fn blobs(options: &Options, purpose: u64, count: u64, radii: [f64; 2]) -> Vec<([f64; 3], f64)> {
    let key = splitmix64(options.seed ^ splitmix64(purpose));
    (0..count)
        .map(|i| {
            let draw = |n: u64| uniform(key, 4 * i + n);
            let centre = std::array::from_fn(|k| draw(k as u64) * (options.dims[k] - 1) as f64);
            (centre, radii[0] + draw(3) * (radii[1] - radii[0]))
        })
        .collect()
}

/// Returns a number in [-1, 1] that varies slowly over the box.
fn slow_variation(seed: u64, stream: u64, p: [f64; 3], dims: [usize; 3]) -> f64 {
    let key = splitmix64(seed ^ splitmix64(0x510e ^ stream));
    let waves = (0..3).map(|k| {
        let turns = 0.7 + 0.8 * uniform(key, k as u64);
        (TAU * (turns * p[k] / dims[k] as f64 + uniform(key, 3 + k as u64))).sin()
    });
    waves.sum::<f64>() / 3.0
}

/// Returns for each sample the largest `value` of the faults within `reach`. The arguments of
/// `value` are the index of the fault, its closest point, and the distance.
fn max_over_faults(
    faults: &[ImplicitSurface],
    options: &Options,
    reach: f64,
    value: impl Fn(usize, &SurfacePoint, f64) -> f64 + Sync,
) -> Vec<f32> {
    let [nx, ny, nz] = options.dims;
    let mut samples = vec![0f32; nx * ny * nz];
    samples
        .par_chunks_mut(nx)
        .enumerate()
        .for_each(|(row, samples)| {
            for (x, sample) in samples.iter_mut().enumerate() {
                let p = [x as f64, (row % ny) as f64, (row / ny) as f64];
                for (k, fault) in faults.iter().enumerate() {
                    if fault.level(p).abs() > reach * fault.max_gradient {
                        continue;
                    }
                    let foot = fault.closest_point(p);
                    let distance = norm(sub(foot.point, p));
                    if distance <= reach && exists_at(faults, k, foot.point) {
                        *sample = sample.max(value(k, &foot, distance) as f32);
                    }
                }
            }
        });
    samples
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::synth::truth::MAX_DISTANCE;
    use crate::image::synth::{SyntheticKind, make, make_2d};

    fn network_options(seed: u64) -> Options {
        Options {
            dims: [64, 60, 56],
            seed,
            signal_to_noise: f64::INFINITY,
            ..Options::default()
        }
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn every_seed_gives_two_to_six_faults_and_all_relations_occur() {
        let (mut counts, mut ends, mut rims, mut close, mut shallow) = ([0; 7], 0, 0, 0, 0);
        for seed in 1..=20 {
            let faults = faults(&Options {
                dims: [128; 3],
                ..network_options(seed)
            })
            .unwrap();
            counts[faults.len()] += 1;
            ends += faults.iter().filter(|f| f.end.is_some()).count();
            rims += faults.iter().filter(|f| f.rim.is_some()).count();
            let synthetic = make(SyntheticKind::Network, &network_options(seed)).unwrap();
            for [gap, angle] in synthetic.truth.next_feature.unwrap() {
                close += usize::from(gap < 12.0 && angle < 5.0);
                shallow += usize::from(gap < 2.0 && angle < 30.0);
                // Faults that are closer cannot be distinguished; the points here may be one step
                // away from those that were compared.
                assert!(
                    gap > 1.0 || angle > 12.0,
                    "seed {seed}: {gap} apart at {angle} degrees"
                );
            }
        }
        assert!(
            counts[2..].iter().all(|&n| n > 0) && counts[0] + counts[1] == 0,
            "{counts:?}"
        );
        assert!(
            ends > 5 && rims > 10 && close > 1000 && shallow > 1000,
            "{ends} {rims} {close} {shallow}"
        );
    }

    #[test]
    fn distances_are_those_to_points_all_over_the_faults() {
        for seed in [3, 8] {
            let options = network_options(seed);
            let surfaces = faults(&options).unwrap();
            let truth = make(SyntheticKind::Network, &options).unwrap().truth;
            // Points on the existing part of each fault, 0.3 samples apart.
            let mut points = Vec::new();
            for (k, surface) in surfaces.iter().enumerate() {
                for i in -250..250 {
                    for j in -250..250 {
                        let coordinates = [0.3 * f64::from(i), 0.3 * f64::from(j)];
                        let p = surface.point_at(coordinates).point;
                        let exists = exists_at(&surfaces, k, p)
                            && surface
                                .rim
                                .is_none_or(|rim| rim.strength(coordinates) >= 0.104);
                        if exists && (0..3).all(|k| p[k] > -12.0 && p[k] < 76.0) {
                            points.push(p);
                        }
                    }
                }
            }
            // The grid of points is up to 0.21 samples away sideways, which counts in full next to
            // a rim.
            let slack = if surfaces.iter().any(|s| s.rim.is_some()) {
                0.3
            } else {
                0.02
            };
            for i in (0..truth.distance.len()).step_by(4799) {
                let p = truth.index_of(i).map(|c| c as f64);
                let square = |q: &[f64; 3]| dot(sub(*q, p), sub(*q, p));
                let nearest = points
                    .iter()
                    .map(square)
                    .fold(f64::INFINITY, f64::min)
                    .sqrt();
                let exact = f64::from(truth.distance[i]);
                let upper_bound = if exact < f64::from(MAX_DISTANCE) {
                    exact.hypot(0.23) + slack
                } else {
                    f64::INFINITY
                };
                assert!(
                    exact <= nearest + 1e-3 && nearest <= upper_bound,
                    "{seed} {p:?}: {exact} {nearest}"
                );
            }
        }
    }

    #[test]
    fn ridges_stand_on_faults_and_taper_out() {
        let (mut strong, mut weak) = (0, 0);
        for seed in 1..8 {
            let synthetic = make(SyntheticKind::Network, &network_options(seed)).unwrap();
            for (sample, distance) in synthetic
                .image
                .as_slice()
                .iter()
                .zip(&synthetic.truth.distance)
            {
                // The height is 0.7 to 1 inside the rim, and a tenth of that at the rim.
                if *distance < 0.2 {
                    assert!((0.06..=1.0).contains(sample), "{seed} {sample}");
                    strong += usize::from(*sample > 0.65);
                    weak += usize::from(*sample < 0.6);
                }
                if *distance >= 9.9 {
                    assert!(*sample < 0.1, "{seed} {sample}");
                }
            }
        }
        assert!(strong > 50 * weak / 10 && weak > 100, "{strong} {weak}");
    }

    #[test]
    fn masks_are_one_to_five_samples_thick_with_holes_and_strays() {
        for seed in 1..5 {
            let synthetic = make(SyntheticKind::NetworkMask, &network_options(seed)).unwrap();
            let (mut on, mut holes, mut spurious_blobs) = (0, 0, 0);
            let next = synthetic.truth.next_feature.unwrap();
            let samples = synthetic
                .image
                .as_slice()
                .iter()
                .zip(&synthetic.truth.distance);
            // No mask is painted where a fault tapers out.
            for ((sample, &distance), _) in samples.zip(&next).filter(|s| s.1[0] >= 0.0) {
                assert!(*sample == 0.0 || *sample == 1.0);
                on += usize::from(distance < 0.45 && *sample == 1.0);
                holes += usize::from(distance < 0.45 && *sample == 0.0);
                spurious_blobs += usize::from(distance > 2.6 && *sample == 1.0);
            }
            assert!(
                holes > 10 && spurious_blobs > 5 && on > 8 * holes,
                "{seed}: {on} {holes} {spurious_blobs}"
            );
        }
    }

    #[test]
    fn throws_taper_out_and_planes_have_networks_too() {
        let synthetic = make(SyntheticKind::NetworkAmplitude, &network_options(2)).unwrap();
        let rms = synthetic
            .image
            .as_slice()
            .iter()
            .map(|s| s * s)
            .sum::<f32>()
            / (64.0 * 60.0 * 56.0);
        assert!((rms - 1.0).abs() < 1e-3);
        for seed in 1..6 {
            let flat = Options {
                dims: [160, 120, 1],
                ..network_options(seed)
            };
            let synthetic = make_2d(SyntheticKind::Network, &flat).unwrap();
            let on_fault = synthetic
                .truth
                .distance
                .iter()
                .filter(|d| **d < 0.5)
                .count();
            assert!(
                on_fault > 150 && synthetic.truth.next_feature.is_some(),
                "{seed}: {on_fault}"
            );
        }
    }
}
