//! Atoms on features, dense where these bend, and few elsewhere (Xu 2016, sections 2.1 and 4.1).
//!
//! 1. *Canny's points*: feature points (Canny edges, or any others), thinned. The spread of the
//!    points in windows around a point determines how many are kept there: few along a line or in a
//!    plane; many at a corner, where a line bends, or at a small detail.
//! 2. In the plane, *halftoning points*: the larger eigenvalue of the image's Hessian, where it
//!    stands out from noise, as dots, by Floyd and Steinberg's error diffusion.
//! 3. *Uniform points*, seven samples apart: in the plane wherever the other points leave space, in
//!    space on the sides of the box only.
//!
//! A point of the second and third kind keeps three samples away from those before it. Nothing is
//! optimised: the density of the atoms determines d(x), not the other way round.

mod atom_distance;

use atom_distance::distance_from_atoms;

use crate::error::{Error, Result, cause};
use crate::feature::FeaturePoint;
use crate::feature::candidate::Candidate;
use crate::feature::volume::Volume;
use crate::feature::voxel_index::CandidateIndex;
use crate::geometry::dot;
use crate::geometry::eigen::{SymmetricMatrix, eigenvalues};
use crate::geometry::grid_index::{block_rows, index_at, offset_of};
use crate::geometry::statistics::upper_quantile;
use crate::image::ScalarField;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::morton::sort_by_curve;
use crate::lattice::seeding::{Alignment, Atoms, fixed_atoms, side_count};
use crate::progress::CancelToken;

/// Returns the smallest distance (samples) between points that are kept: one more than the smallest
/// radius.
pub const fn min_point_distance(dimensions: usize) -> f64 {
    if dimensions == 3 { 3.0 } else { 2.0 }
}

/// Approximate distance between uniform points, in samples.
pub const UNIFORM_SPACING: f64 = 7.0;

/// Halftoning and uniform points have no earlier point within this many samples along each axis (a
/// window of seven by seven).
const WINDOW_HALF_WIDTH: i32 = 3;

/// Returns half the width of the smallest and of the largest window (samples) in which the spread
/// of points is measured. In space K = 5. In the plane the thesis says that K is found for each
/// point, but not how: here windows of 7 to 17 samples are tried, and the one in which the points
/// spread most evenly counts. A window of 7 alone would take a circle of radius 5 for a line.
const fn window_half_widths(dimensions: usize) -> [i32; 2] {
    if dimensions == 3 { [2, 2] } else { [3, 8] }
}

/// Returns the radii (samples) of the points for an anisotropy of their spread of at most 0.3, at
/// most 0.5, and above.
const fn radii(dimensions: usize) -> [i32; 3] {
    if dimensions == 3 {
        [2, 3, 4]
    } else {
        [1, 3, 5]
    }
}

/// Smallest cosine between normals at one place that are not of a corner.
const MIN_NORMAL_COSINE: f32 = 0.97;

/// Feature points nearer than this (samples) to a side of the box are moved onto it.
const SIDE_SNAP_DISTANCE: f64 = 0.75;

/// Fraction of the largest eigenvalue at which a sample becomes a dot.
const DOT_THRESHOLD_RATIO: f32 = 0.3;

/// Distance (samples) at which smoothed noise is independent.
const NOISE_CORRELATION_LENGTH: usize = 8;

/// Thresholds for an eigenvalue to stand out from noise: multiples of the 20 % quantile of the
/// eigenvalues, and of the median difference of Laplacians. In white noise smoothed over one to
/// three samples, one eigenvalue in 40 stands out, and one in ten of these becomes a dot.
const NOISE_FACTORS: [f32; 2] = [3.5, 1.7];

/// Fraction of the largest eigenvalue above which an eigenvalue stands out in any case. This
/// matters where all of the image is textured, so that the differences are not noise.
const SALIENT_RATIO: f32 = 0.5;

/// Bound on the slope of d(x).
const MAX_DISTANCE_SLOPE: f64 = 0.3;

/// Places atoms on and between features.
///
/// `points` are feature points in lattice space; `image`, smoothed as for feature detection, spans
/// the box. Atoms on features come last, and are [`AtomKind::Fixed`], because later steps must not
/// move them. `fixed` are the user's fixed atoms; other atoms too near to them are removed.
///
/// # Errors
/// Returns [`Error::Seeding`] if a fixed atom is outside the box, if two are at one place, or if
/// the image is too small; [`Error::Distance`] if the resulting distance does not suit the box.
pub fn place_atoms<const D: usize>(
    points: &[FeaturePoint<D>],
    image: &ScalarField<D>,
    fixed: &[[f64; D]],
    cancel: &CancelToken<'_>,
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
    let mut occupied = OccupiedSamples::new(dims);
    let on_features = thin_points(points, dims, step, &mut occupied, cancel);
    let mut other_points = Vec::new();
    if D == 2 {
        for i in halftone_dots(image) {
            let sample = occupied.coordinates(i);
            if occupied.is_free(sample, WINDOW_HALF_WIDTH)
                && occupied.is_inside(sample, WINDOW_HALF_WIDTH)
            {
                other_points.push(sample.map(|i| i as f64));
            }
        }
        for x in &other_points {
            occupied.occupy(x.map(|c| c as i32));
        }
    }
    add_uniform_points(&occupied, &mut other_points);
    let to_lattice = |x: &[f64; D]| -> [f64; D] {
        // Coordinates on the sides must be exact.
        std::array::from_fn(|k| match x[k] {
            c if c >= (dims[k] - 1) as f64 => extent[k],
            c => c * step[k],
        })
    };
    let mut on_features: Vec<_> = on_features.iter().map(to_lattice).collect();
    let mut other_points: Vec<_> = other_points.iter().map(to_lattice).collect();
    let cell = 2.0 * UNIFORM_SPACING * step.iter().fold(0.0, |a: f64, &b| a.max(b));
    sort_by_curve(&mut on_features, extent, cell);
    sort_by_curve(&mut other_points, extent, cell);
    let mut atoms = Atoms::from_positions(other_points, extent);
    atoms.positions.extend_from_slice(&on_features);
    atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
    let mut distance = distance_from_atoms(&atoms.positions, extent, MAX_DISTANCE_SLOPE, cancel);
    distance.validate(extent)?;
    if !fixed.is_empty() {
        let fixed = fixed_atoms::validate(fixed, extent, &distance, Alignment::OnFeatures)?;
        fixed_atoms::insert(&mut atoms, &fixed, extent, &distance);
        distance = distance_from_atoms(&atoms.positions, extent, MAX_DISTANCE_SLOPE, cancel);
    }
    Ok((atoms, distance))
}

/// Returns the feature points that are kept, in samples. Points next to a side of the box are moved
/// onto it.
fn thin_points<const D: usize>(
    points: &[FeaturePoint<D>],
    dims: [usize; D],
    step: [f64; D],
    occupied: &mut OccupiedSamples<D>,
    cancel: &CancelToken<'_>,
) -> Vec<[f64; D]> {
    let candidate = |point: &FeaturePoint<D>| {
        let coordinates: [f64; D] = std::array::from_fn(|k| {
            let last = (dims[k] - 1) as f64;
            match f64::from(point.position[k]) / step[k] {
                c if c < SIDE_SNAP_DISTANCE => 0.0,
                c if c > last - SIDE_SNAP_DISTANCE => last,
                c => c,
            }
        });
        let sample = coordinates.map(|c| c.round() as usize);
        let position = coordinates.map(|c| c as f32);
        let normal = point.normal.map(f64::from);
        Candidate {
            position,
            ..Candidate::new(dims, sample, 0, 0.0, normal, point.strength)
        }
    };
    let mut candidates: Vec<Candidate<D>> = points.iter().map(candidate).collect();
    candidates.sort_by_key(|c| c.voxel);
    let grid = CandidateIndex::new(dims, &candidates);
    // A corner has points with the normals of both its sides. Corners come first, so that no point
    // beside them takes their place.
    let is_corner = |c: &&Candidate<D>| {
        let mut is_bent = false;
        grid.for_each_at(grid.coordinates(c), |j| {
            let other = &grid.candidates[j];
            is_bent |= other.position == c.position
                && dot(other.normal, c.normal).abs() < MIN_NORMAL_COSINE;
        });
        is_bent
    };
    let (corners, others): (Vec<_>, Vec<_>) = candidates.iter().partition(is_corner);
    let mut neighbourhood = PointNeighbourhood::default();
    let mut kept = Vec::new();
    for c in corners.into_iter().chain(others) {
        if cancel.is_cancelled() {
            break;
        }
        let sample = grid.coordinates(c);
        if occupied.is_free(sample, neighbourhood.radius(&grid, c)) {
            occupied.occupy(sample);
            kept.push(c.position.map(f64::from));
        }
    }
    // The corners of the box get atoms as uniform points.
    let last = dims.map(|n| (n - 1) as f64);
    kept.retain(|x| side_count(*x, last) < D);
    kept
}

/// The feature points in the largest window around one of them.
#[derive(Default)]
struct PointNeighbourhood<const D: usize> {
    points: Vec<PointOffset<D>>,
    /// Connected points whose neighbours have not been visited yet.
    frontier: Vec<usize>,
}

/// The offset of a feature point from the centre of the window.
#[derive(Clone, Copy)]
struct PointOffset<const D: usize> {
    /// Offset between the samples.
    sample_offset: [i32; D],
    /// Offset between the positions.
    position_offset: [f64; D],
    /// `true` if the point is connected to the centre within the window.
    is_connected: bool,
}

impl<const D: usize> PointOffset<D> {
    /// Returns half the width of the smallest window that contains the point.
    fn half_width(&self) -> i32 {
        self.sample_offset.iter().fold(0, |max, s| max.max(s.abs()))
    }
}

impl<const D: usize> PointNeighbourhood<D> {
    /// Returns the radius around a feature point, in samples, within which other points are
    /// removed: formulas 1, 2, 22 and 23.
    fn radius(&mut self, grid: &CandidateIndex<'_, D>, centre: &Candidate<D>) -> i32 {
        let [min_width, max_width] = window_half_widths(D);
        self.scan_window(grid, centre, max_width);
        let mut anisotropy = f64::INFINITY;
        for half in min_width..=max_width {
            let mut spread: SymmetricMatrix<D> = [[0.0; D]; D];
            let is_within = |p: &&PointOffset<D>| p.is_connected && p.half_width() <= half;
            for PointOffset {
                position_offset: offset,
                ..
            } in self.points.iter().filter(is_within)
            {
                for k in 0..D {
                    for l in 0..D {
                        spread[k][l] += offset[k] * offset[l];
                    }
                }
            }
            let values = eigenvalues(&spread);
            let (low, high) = (values[0], values[D - 1]);
            // A single point is a small detail.
            let window_anisotropy = match (high - low) / (high + low) {
                a if a.is_nan() => 0.0,
                a => a,
            };
            anisotropy = anisotropy.min(window_anisotropy);
        }
        // A feature that ends within a wide window is a small detail, too.
        let ends_inside = |p: &PointOffset<D>| !p.is_connected || p.half_width() < max_width;
        if max_width > min_width && self.points.iter().all(ends_inside) {
            anisotropy = 0.0;
        }
        let [fine, middle, coarse] = radii(D);
        match anisotropy {
            a if a > 0.5 => coarse,
            a if a > 0.3 => middle,
            _ => fine,
        }
    }

    /// Finds the points in a window around one of them. In a wide window only those count that are
    /// connected to the centre, from sample to adjacent sample, because another line may run beside
    /// it.
    fn scan_window(&mut self, grid: &CandidateIndex<'_, D>, centre: &Candidate<D>, half: i32) {
        let centre_sample = grid.coordinates(centre);
        let is_wide = half > window_half_widths(D)[0];
        let (points, frontier) = (&mut self.points, &mut self.frontier);
        points.clear();
        grid.for_each_around(centre_sample, half, |i| {
            let other = &grid.candidates[i];
            let sample = grid.coordinates(other);
            let sample_offset = std::array::from_fn(|k| sample[k] - centre_sample[k]);
            if sample_offset == [0; D] {
                frontier.push(points.len());
            }
            points.push(PointOffset {
                sample_offset,
                position_offset: std::array::from_fn(|k| {
                    f64::from(other.position[k] - centre.position[k])
                }),
                is_connected: !is_wide || sample_offset == [0; D],
            });
        });
        while let Some(index) = frontier.pop() {
            let origin = points[index].sample_offset;
            for (i, point) in points.iter_mut().enumerate() {
                let is_adjacent = |k: usize| (point.sample_offset[k] - origin[k]).abs() <= 1;
                if !point.is_connected && (0..D).all(is_adjacent) {
                    point.is_connected = true;
                    frontier.push(i);
                }
            }
        }
    }
}

/// Returns the samples that error diffusion makes dots of, in the order of samples. The map is the
/// larger magnitude of the Hessian's eigenvalues over its largest value anywhere (formulas 4 to 8,
/// with gamma = 1). A sample becomes a dot where the map reaches q = 0.3; the difference to the
/// dot's weight of 2 q is passed to the samples after it. The Hessian is that of the image smoothed
/// as for features, by second differences of adjacent samples (the mixed one by the four diagonal
/// ones). Values that do not stand out from noise are set to zero, or error diffusion would gather
/// them to dots all over the image.
fn halftone_dots<const D: usize>(image: &ScalarField<D>) -> Vec<usize> {
    let volume = Volume {
        dims: image.dims,
        samples: &image.samples,
    };
    let curvature = |i: usize| {
        let sample = volume.coordinates(i);
        // Beyond the sides samples are repeated, which would look like a bend.
        if (0..D).any(|k| sample[k] == 0 || sample[k] + 1 == image.dims[k]) {
            return 0.0;
        }
        let values = eigenvalues(&volume.hessian(sample));
        values[0].abs().max(values[D - 1].abs()) as f32
    };
    let mut map: Vec<f32> = (0..image.samples.len()).map(curvature).collect();
    let largest = map.iter().fold(0.0f32, |a, &b| a.max(b));
    if largest == 0.0 {
        return Vec::new();
    }
    let threshold = noise_level(volume, &map).min(SALIENT_RATIO * largest);
    for s in &mut map {
        *s = if *s < threshold { 0.0 } else { *s / largest };
    }
    let nx = image.dims[0];
    let mut dots = Vec::new();
    for i in 0..map.len() {
        let is_dot = map[i] >= DOT_THRESHOLD_RATIO;
        let error = map[i]
            - if is_dot {
                2.0 * DOT_THRESHOLD_RATIO
            } else {
                0.0
            };
        if is_dot {
            dots.push(i);
        }
        let x = i % nx;
        let mut diffuse = |target: usize, weight: f32| {
            if let Some(s) = map.get_mut(target) {
                *s += weight / 16.0 * error;
            }
        };
        if x + 1 < nx {
            diffuse(i + 1, 7.0);
            diffuse(i + nx + 1, 1.0);
        }
        if x > 0 {
            diffuse(i + nx - 1, 3.0);
        }
        diffuse(i + nx, 5.0);
    }
    dots
}

/// Returns the eigenvalue (of those in `curvatures`) up to which noise may have caused it. The
/// quietest fifth of the image shows the strength of the noise, because the rest may be textured.
/// The level is lower where Laplacians that are far enough apart for noise to be independent are
/// alike, because there the image bends evenly.
fn noise_level<const D: usize>(image: Volume<'_, D>, curvatures: &[f32]) -> f32 {
    let count = image.samples.len();
    let laplacian: Vec<f32> = (0..count)
        .map(|i| image.laplacian(image.coordinates(i)))
        .collect();
    let laplacian_change = |k: usize| {
        let offset = NOISE_CORRELATION_LENGTH * image.strides()[k];
        let is_inside =
            |i: &usize| image.coordinates(*i)[k] + NOISE_CORRELATION_LENGTH < image.dims[k];
        let pairs = (0..count).filter(is_inside);
        let changes = pairs.map(|i| (laplacian[i + offset] - laplacian[i]).abs());
        quantile(changes.collect(), 0.5)
    };
    let laplacian_change = (0..D).map(laplacian_change).fold(f32::INFINITY, f32::min);
    let quiet_level = quantile(curvatures.to_vec(), 0.2);
    (NOISE_FACTORS[0] * quiet_level).min(NOISE_FACTORS[1] * laplacian_change)
}

/// Returns the value below which the given share of all values lies; 0 if there are no values.
fn quantile(mut values: Vec<f32>, share: f64) -> f32 {
    upper_quantile(&mut values, share).unwrap_or(0.0)
}

/// Adds points of a regular grid fitted to the box: its corners, those on its sides, and in the
/// plane those inside that are free. A point on a side is left out only because of atoms on that
/// side.
fn add_uniform_points<const D: usize>(occupied: &OccupiedSamples<D>, points: &mut Vec<[f64; D]>) {
    let last = occupied.dims.map(|n| (n - 1) as f64);
    let cells = last.map(|l| (l / UNIFORM_SPACING).round().max(1.0) as usize);
    let grid = cells.map(|c| c + 1);
    for number in 0..grid.iter().product() {
        let index = index_at(grid, number);
        let x: [f64; D] = std::array::from_fn(|k| last[k] * index[k] as f64 / cells[k] as f64);
        let sides = side_count(x, last);
        let sample = x.map(|c| c.round() as i32);
        let is_wanted = match sides {
            0 => D == 2 && occupied.is_free(sample, WINDOW_HALF_WIDTH),
            _ => sides == D || occupied.is_free_on_sides(sample, WINDOW_HALF_WIDTH),
        };
        if is_wanted {
            points.push(x);
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
        index_at(self.dims, index).map(|i| i as i32)
    }

    fn occupy(&mut self, sample: [i32; D]) {
        self.is_occupied[offset_of(self.dims, sample.map(|i| i as usize))] = true;
    }

    /// Returns `true` if a sample is at least `radius` samples from the sides of the box.
    fn is_inside(&self, sample: [i32; D], radius: i32) -> bool {
        (0..D).all(|k| sample[k] >= radius && sample[k] + radius < self.dims[k] as i32)
    }

    /// Returns `true` if no atom is within `radius` samples along each axis.
    fn is_free(&self, sample: [i32; D], radius: i32) -> bool {
        self.is_window_free(sample, [radius; D])
    }

    /// Returns `true` if no atom is within `radius` samples on the sides of the box on which the
    /// sample lies.
    fn is_free_on_sides(&self, sample: [i32; D], radius: i32) -> bool {
        let is_within_side = |k: usize| sample[k] > 0 && sample[k] + 1 < self.dims[k] as i32;
        self.is_window_free(
            sample,
            std::array::from_fn(|k| if is_within_side(k) { radius } else { 0 }),
        )
    }

    fn is_window_free(&self, sample: [i32; D], radius: [i32; D]) -> bool {
        let low: [usize; D] = std::array::from_fn(|k| (sample[k] - radius[k]).max(0) as usize);
        let span: [usize; D] = std::array::from_fn(|k| {
            ((sample[k] + radius[k]) as usize).min(self.dims[k] - 1) + 1 - low[k]
        });
        block_rows(self.dims, low, span)
            .all(|start| self.is_occupied[start..start + span[0]].iter().all(|h| !h))
    }
}

#[cfg(test)]
mod tests;
