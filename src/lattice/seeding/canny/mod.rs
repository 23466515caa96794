//! Atoms on features, dense where these bend, and few elsewhere (Xu 2016, sections 2.1 and 4.1).
//!
//! 1. *Canny's points*: feature points (Canny edges, or any others), thinned. How the points in
//!    windows about one of them spread tells how many to keep there: along a line or in a plane few,
//!    at a corner, where a line bends, or at a small detail many.
//! 2. In the plane, *halftoning points*: the larger eigenvalue of the image's Hessian, as far as it
//!    stands out from noise, as dots, by Floyd and Steinberg's error diffusion.
//! 3. *Uniform points*, seven samples apart: in the plane wherever the others leave room, in space on
//!    the sides of the box only.
//!
//! A point of the second and third kind keeps three samples away from those before it. Nothing is
//! optimised: the atoms' density decides d(x), not the other way round.

use super::morton::sort_by_curve;
use super::{Alignment, Atoms, fixed_atoms, side_count};
use crate::error::{Error, Result, cause};
use crate::feature::FeaturePoint;
use crate::feature::candidate::Candidate;
use crate::feature::eigen::{SymmetricMatrix, eigenvalues};
use crate::feature::volume::Volume;
use crate::feature::voxel_index::CandidateIndex;
use crate::geometry::dot;
use crate::image::ScalarField;
use crate::lattice::AtomKind;
use crate::lattice::distance::{Distance, from_atoms};
use crate::progress::CancelToken;

/// The least distance (samples) between points that are kept: one more than the least radius.
pub const fn min_point_distance(dimensions: usize) -> f64 {
    if dimensions == 3 { 3.0 } else { 2.0 }
}

/// Uniform points are about this far apart (samples).
pub const UNIFORM_SPACING: f64 = 7.0;

/// Halftoning and uniform points have no earlier point within this many samples along each axis
/// (a window of seven by seven).
const WINDOW_HALF_WIDTH: i32 = 3;

/// Half the smallest and the largest window (samples) in which points' spread is looked at. In space
/// K = 5. In the plane the thesis says that K is found for each point, and not how: here that of 7 to
/// 17 counts in which the points spread most evenly. A window of 7 alone takes a circle of radius 5 for
/// a line.
const fn window_half_widths(dimensions: usize) -> [i32; 2] {
    if dimensions == 3 { [2, 2] } else { [3, 8] }
}

/// Radii (samples) of the points by the anisotropy of their spread: at most 0.3, at most 0.5, above.
const fn radii(dimensions: usize) -> [i32; 3] {
    if dimensions == 3 {
        [2, 3, 4]
    } else {
        [1, 3, 5]
    }
}

/// Normals at one place that agree less than this (cosine) are of a corner.
const MIN_NORMAL_COSINE: f32 = 0.97;

/// Feature points nearer than this (samples) to a side of the box are put onto it.
const SIDE_SNAP_DISTANCE: f64 = 0.75;

/// Share of the largest eigenvalue at which a sample becomes a dot.
const DOT_THRESHOLD_RATIO: f32 = 0.3;

/// How far apart (samples) smoothed noise is independent.
const NOISE_CORRELATION_LENGTH: usize = 8;

/// How many times the eigenvalue that a fifth of the image does not reach, or the difference of Laplacians
/// that half of it does not, an eigenvalue must be to stand out: of white noise smoothed over one to three
/// samples, one in 40 does, and one of these in ten becomes a dot.
const NOISE_FACTORS: [f32; 2] = [3.5, 1.7];

/// Share of the largest eigenvalue that stands out in any case, also where all of the image is textured,
/// so that what differs is not noise.
const SALIENT_RATIO: f32 = 0.5;

/// Bound on the slope of d(x).
const MAX_DISTANCE_SLOPE: f64 = 0.3;

/// Places atoms on and between features.
///
/// `points` are feature points in lattice space; `image`, smoothed as features were sought, spans the
/// box. Atoms on features come last, and are [`AtomKind::Fixed`]: what follows must not move them.
/// `others` are the user's fixed atoms; atoms near them make room.
///
/// # Errors
/// [`Error::Seeding`] for fixed atoms outside the box or at one place; [`Error::Distance`] for a box
/// too small to have atoms in it.
pub fn place_atoms<const D: usize>(
    points: &[FeaturePoint<D>],
    image: &ScalarField<D>,
    others: &[[f64; D]],
    patience: &CancelToken<'_>,
) -> Result<(Atoms<D>, Distance<D>)> {
    let (dims, step, extent) = (image.dims, image.step, image.extent());
    if let Some(k) = (0..D).find(|&k| (dims[k] as f64 - 1.0) < 2.0 * UNIFORM_SPACING) {
        return Err(Error::Seeding(cause(
            "Canny's points",
            format!("the image has {} samples along axis {k}", dims[k]),
            format!(
                "give at least {}, or another seeding",
                2.0 * UNIFORM_SPACING + 1.0
            ),
        )));
    }
    let mut held = OccupiedSamples::new(dims);
    let on_features = thin_points(points, dims, step, &mut held, patience);
    let mut rest = Vec::new();
    if D == 2 {
        for i in halftone_dots(image) {
            let at = held.coordinates(i);
            if held.is_free(at, WINDOW_HALF_WIDTH) && held.is_inside(at, WINDOW_HALF_WIDTH) {
                rest.push(at.map(|i| i as f64));
            }
        }
        for x in &rest {
            held.occupy(x.map(|c| c as i32));
        }
    }
    add_uniform_points(&held, &mut rest);
    let lattice = |x: &[f64; D]| -> [f64; D] {
        // Exactly on the sides.
        std::array::from_fn(|k| match x[k] {
            c if c >= (dims[k] - 1) as f64 => extent[k],
            c => c * step[k],
        })
    };
    let mut on_features: Vec<_> = on_features.iter().map(lattice).collect();
    let mut rest: Vec<_> = rest.iter().map(lattice).collect();
    let cube = 2.0 * UNIFORM_SPACING * step.iter().fold(0.0, |a: f64, &b| a.max(b));
    sort_by_curve(&mut on_features, extent, cube);
    sort_by_curve(&mut rest, extent, cube);
    let mut atoms = Atoms::from_positions(rest, extent);
    atoms.positions.extend_from_slice(&on_features);
    atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
    let mut distance = from_atoms(&atoms.positions, extent, MAX_DISTANCE_SLOPE, patience);
    distance.validate(extent)?;
    if !others.is_empty() {
        let others = fixed_atoms::validate(others, extent, &distance, Alignment::OnFeatures)?;
        fixed_atoms::insert(&mut atoms, &others, extent, &distance);
        distance = from_atoms(&atoms.positions, extent, MAX_DISTANCE_SLOPE, patience);
    }
    Ok((atoms, distance))
}

/// The feature points that are kept, in samples; those next to a side of the box are put onto it.
fn thin_points<const D: usize>(
    points: &[FeaturePoint<D>],
    dims: [usize; D],
    step: [f64; D],
    held: &mut OccupiedSamples<D>,
    patience: &CancelToken<'_>,
) -> Vec<[f64; D]> {
    let candidate = |point: &FeaturePoint<D>| {
        let at: [f64; D] = std::array::from_fn(|k| {
            let last = (dims[k] - 1) as f64;
            match f64::from(point.position[k]) / step[k] {
                c if c < SIDE_SNAP_DISTANCE => 0.0,
                c if c > last - SIDE_SNAP_DISTANCE => last,
                c => c,
            }
        });
        let sample = at.map(|c| c.round() as usize);
        let position = at.map(|c| c as f32);
        let normal = point.normal.map(f64::from);
        Candidate {
            position,
            ..Candidate::new(dims, sample, 0, 0.0, normal, point.strength)
        }
    };
    let mut candidates: Vec<Candidate<D>> = points.iter().map(candidate).collect();
    candidates.sort_by_key(|c| c.voxel);
    let grid = CandidateIndex::new(dims, &candidates);
    // A corner has the normals of both its sides: it comes first, so that none beside it takes its place.
    let is_corner = |c: &&Candidate<D>| {
        let mut turns = false;
        grid.for_each_at(grid.coordinates(c), |j| {
            let other = &grid.candidates[j];
            turns |= other.position == c.position
                && dot(other.normal, c.normal).abs() < MIN_NORMAL_COSINE;
        });
        turns
    };
    let (corners, rest): (Vec<_>, Vec<_>) = candidates.iter().partition(is_corner);
    let mut around = PointNeighbourhood::default();
    let mut kept = Vec::new();
    for c in corners.into_iter().chain(rest) {
        if patience.is_cancelled() {
            break;
        }
        let at = grid.coordinates(c);
        if held.is_free(at, around.radius(&grid, c)) {
            held.occupy(at);
            kept.push(c.position.map(f64::from));
        }
    }
    // Where the corners of the box are, atoms are anyhow.
    let last = dims.map(|n| (n - 1) as f64);
    kept.retain(|x| side_count(*x, last) < D);
    kept
}

/// The feature points in the largest window around one of them.
#[derive(Default)]
struct PointNeighbourhood<const D: usize> {
    points: Vec<PointOffset<D>>,
    /// Those that have been reached and not yet been gone on from.
    frontier: Vec<usize>,
}

/// A feature point as seen from another.
#[derive(Clone, Copy)]
struct PointOffset<const D: usize> {
    /// From sample to sample.
    sample_offset: [i32; D],
    /// From position to position.
    position_offset: [f64; D],
    /// Whether it is connected to the other within the window.
    is_connected: bool,
}

impl<const D: usize> PointOffset<D> {
    /// The half width of the smallest window that it is in.
    fn half_width(&self) -> i32 {
        self.sample_offset
            .iter()
            .fold(0, |most, s| most.max(s.abs()))
    }
}

impl<const D: usize> PointNeighbourhood<D> {
    /// How far from a feature point others are left out, in samples: formulas 1, 2, 22 and 23.
    fn radius(&mut self, grid: &CandidateIndex<'_, D>, centre: &Candidate<D>) -> i32 {
        let [least, most] = window_half_widths(D);
        self.scan_window(grid, centre, most);
        let mut anisotropy = f64::INFINITY;
        for half in least..=most {
            let mut spread: SymmetricMatrix<D> = [[0.0; D]; D];
            let within = |p: &&PointOffset<D>| p.is_connected && p.half_width() <= half;
            for PointOffset {
                position_offset: exact,
                ..
            } in self.points.iter().filter(within)
            {
                for k in 0..D {
                    for l in 0..D {
                        spread[k][l] += exact[k] * exact[l];
                    }
                }
            }
            let values = eigenvalues(&spread);
            let (low, high) = (values[0], values[D - 1]);
            // A point alone is a small detail.
            let here = match (high - low) / (high + low) {
                a if a.is_nan() => 0.0,
                a => a,
            };
            anisotropy = anisotropy.min(here);
        }
        // So is what ends within a wide window.
        let ends = |p: &PointOffset<D>| !p.is_connected || p.half_width() < most;
        if most > least && self.points.iter().all(ends) {
            anisotropy = 0.0;
        }
        let [fine, middle, coarse] = radii(D);
        match anisotropy {
            a if a > 0.5 => coarse,
            a if a > 0.3 => middle,
            _ => fine,
        }
    }

    /// Finds the points in a window around one of them. Of a wide window only those count that are
    /// connected to it there, from sample to neighbouring sample: beside a line another one may run.
    fn scan_window(&mut self, grid: &CandidateIndex<'_, D>, centre: &Candidate<D>, half: i32) {
        let at = grid.coordinates(centre);
        let wide = half > window_half_widths(D)[0];
        let (points, front) = (&mut self.points, &mut self.frontier);
        points.clear();
        grid.for_each_around(at, half, |i| {
            let other = &grid.candidates[i];
            let sample = grid.coordinates(other);
            let samples = std::array::from_fn(|k| sample[k] - at[k]);
            if samples == [0; D] {
                front.push(points.len());
            }
            points.push(PointOffset {
                sample_offset: samples,
                position_offset: std::array::from_fn(|k| {
                    f64::from(other.position[k] - centre.position[k])
                }),
                is_connected: !wide || samples == [0; D],
            });
        });
        while let Some(from) = front.pop() {
            let here = points[from].sample_offset;
            for (i, point) in points.iter_mut().enumerate() {
                let beside = |k: usize| (point.sample_offset[k] - here[k]).abs() <= 1;
                if !point.is_connected && (0..D).all(beside) {
                    point.is_connected = true;
                    front.push(i);
                }
            }
        }
    }
}

/// Samples that error diffusion makes dots of, in the order of samples: the larger magnitude of the
/// Hessian's eigenvalues over its largest value anywhere (formulas 4 to 8, with gamma = 1), a dot
/// where it reaches q = 0.3; what a dot of weight 2 q is too much or too little goes to the samples
/// after it. The Hessian is that of the image smoothed as for features, by second differences of
/// neighbouring samples (the mixed one by the four diagonal ones). What does not stand out from noise
/// counts for nothing, or error diffusion would gather it to dots all over the image.
fn halftone_dots<const D: usize>(image: &ScalarField<D>) -> Vec<usize> {
    let volume = Volume {
        dims: image.dims,
        samples: &image.samples,
    };
    let bend = |i: usize| {
        let at = volume.coordinates(i);
        // Beyond the sides samples repeat, which looks like a bend.
        if (0..D).any(|k| at[k] == 0 || at[k] + 1 == image.dims[k]) {
            return 0.0;
        }
        let values = eigenvalues(&volume.hessian(at));
        values[0].abs().max(values[D - 1].abs()) as f32
    };
    let mut map: Vec<f32> = (0..image.samples.len()).map(bend).collect();
    let largest = map.iter().fold(0.0f32, |a, &b| a.max(b));
    if largest == 0.0 {
        return Vec::new();
    }
    let least = noise_level(volume, &map).min(SALIENT_RATIO * largest);
    for s in &mut map {
        *s = if *s < least { 0.0 } else { *s / largest };
    }
    let nx = image.dims[0];
    let mut dots = Vec::new();
    for i in 0..map.len() {
        let dot = map[i] >= DOT_THRESHOLD_RATIO;
        let error = map[i] - if dot { 2.0 * DOT_THRESHOLD_RATIO } else { 0.0 };
        if dot {
            dots.push(i);
        }
        let x = i % nx;
        let mut pass = |to: usize, weight: f32| {
            if let Some(s) = map.get_mut(to) {
                *s += weight / 16.0 * error;
            }
        };
        if x + 1 < nx {
            pass(i + 1, 7.0);
            pass(i + nx + 1, 1.0);
        }
        if x > 0 {
            pass(i + nx - 1, 3.0);
        }
        pass(i + nx, 5.0);
    }
    dots
}

/// The eigenvalue (of those in `bends`) up to which noise may have made it. The quietest fifth of the image
/// shows how strong that is, for the rest may be textured; but less where Laplacians so far apart that noise
/// makes them independent are alike, for then the image bends evenly.
fn noise_level<const D: usize>(image: Volume<'_, D>, bends: &[f32]) -> f32 {
    let count = image.samples.len();
    let laplacian: Vec<f32> = (0..count)
        .map(|i| image.laplacian(image.coordinates(i)))
        .collect();
    let differing = |k: usize| {
        let apart = NOISE_CORRELATION_LENGTH * image.strides()[k];
        let inside =
            |i: &usize| image.coordinates(*i)[k] + NOISE_CORRELATION_LENGTH < image.dims[k];
        let gaps = (0..count).filter(inside);
        let gaps = gaps.map(|i| (laplacian[i + apart] - laplacian[i]).abs());
        quantile(gaps.collect(), 0.5)
    };
    let differing = (0..D).map(differing).fold(f32::INFINITY, f32::min);
    let quiet = quantile(bends.to_vec(), 0.2);
    (NOISE_FACTORS[0] * quiet).min(NOISE_FACTORS[1] * differing)
}

/// The value that a share of all does not reach; 0 of none.
fn quantile(mut values: Vec<f32>, share: f64) -> f32 {
    let rank = (share * values.len() as f64) as usize;
    match values.is_empty() {
        true => 0.0,
        false => *values.select_nth_unstable_by(rank, f32::total_cmp).1,
    }
}

/// Points of a regular grid fitted to the box: its corners, those on its sides, and in the plane
/// those inside that are free. On a side, only atoms on that side make a point superfluous.
fn add_uniform_points<const D: usize>(held: &OccupiedSamples<D>, rest: &mut Vec<[f64; D]>) {
    let last = held.dims.map(|n| (n - 1) as f64);
    let cells = last.map(|l| (l / UNIFORM_SPACING).round().max(1.0) as usize);
    for number in 0..cells.iter().map(|c| c + 1).product() {
        let mut left: usize = number;
        let x: [f64; D] = std::array::from_fn(|k| {
            let i = left % (cells[k] + 1);
            left /= cells[k] + 1;
            last[k] * i as f64 / cells[k] as f64
        });
        let sides = side_count(x, last);
        let at = x.map(|c| c.round() as i32);
        let wanted = match sides {
            0 => D == 2 && held.is_free(at, WINDOW_HALF_WIDTH),
            _ => sides == D || held.is_free_on_sides(at, WINDOW_HALF_WIDTH),
        };
        if wanted {
            rest.push(x);
        }
    }
}

/// The samples at which atoms are.
struct OccupiedSamples<const D: usize> {
    dims: [usize; D],
    is_occupied: Vec<bool>,
}

impl<const D: usize> OccupiedSamples<D> {
    fn new(dims: [usize; D]) -> Self {
        let is_occupied = vec![false; dims.iter().product()];
        Self { dims, is_occupied }
    }

    fn coordinates(&self, index: usize) -> [i32; D] {
        let volume = Volume {
            dims: self.dims,
            samples: &[],
        };
        volume.coordinates(index).map(|i| i as i32)
    }

    fn occupy(&mut self, at: [i32; D]) {
        let index = (0..D)
            .rev()
            .fold(0, |i, k| i * self.dims[k] + at[k] as usize);
        self.is_occupied[index] = true;
    }

    /// Whether a sample is at least so far from the sides of the box.
    fn is_inside(&self, at: [i32; D], reach: i32) -> bool {
        (0..D).all(|k| at[k] >= reach && at[k] + reach < self.dims[k] as i32)
    }

    /// Whether no atom is within `reach` samples along each axis.
    fn is_free(&self, at: [i32; D], reach: i32) -> bool {
        self.is_window_free(at, [reach; D])
    }

    /// The same among the atoms on the sides of the box on which the sample is.
    fn is_free_on_sides(&self, at: [i32; D], reach: i32) -> bool {
        let along = |k: usize| at[k] > 0 && at[k] + 1 < self.dims[k] as i32;
        self.is_window_free(
            at,
            std::array::from_fn(|k| if along(k) { reach } else { 0 }),
        )
    }

    fn is_window_free(&self, at: [i32; D], reach: [i32; D]) -> bool {
        let low: [usize; D] = std::array::from_fn(|k| (at[k] - reach[k]).max(0) as usize);
        let span: [usize; D] = std::array::from_fn(|k| {
            ((at[k] + reach[k]) as usize).min(self.dims[k] - 1) + 1 - low[k]
        });
        (0..span[1..].iter().product()).all(|row: usize| {
            let (mut left, mut start, mut stride) = (row, low[0], self.dims[0]);
            for k in 1..D {
                start += (low[k] + left % span[k]) * stride;
                left /= span[k];
                stride *= self.dims[k];
            }
            self.is_occupied[start..start + span[0]].iter().all(|h| !h)
        })
    }
}

#[cfg(test)]
mod tests;
