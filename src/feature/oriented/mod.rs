//! Ridges where surfaces cross, branch or run close to each other, with orientation as an
//! additional coordinate.
//!
//! After smoothing by an isotropic Gaussian, two surfaces that meet at a shallow angle or run a few
//! samples apart form one ridge. A filter that is long along a surface and narrow across it
//! separates them. Two surfaces through one place share the line in which they meet, so that only
//! the angle about this line must be searched. The image is smoothed along the line. In the plane
//! square to it, filters at 24 angles give the negated second derivative across, C, and the first
//! derivative, D. *Every* maximum of C over the angle is a point of a surface, D / C samples away:
//! one sample may have several (orientation scores: Janssen and others 2018; surface voting: Wu and
//! Fomel 2018).
//!
//! The filters are used only at ambiguous samples: see [`AmbiguityMask`]. Elsewhere, ridges are
//! those of [`ridges`](mod@super::ridges), at a tenth of the cost.
//!
//! - `ambiguity`: mask of the ambiguous samples
//! - `normal_dispersion`: variation of normals beyond that of a single surface
//! - `block`: the lines of a block of samples
//! - `filters`: filters at all angles about a line
//! - `row_ranges`: the needed samples of each row of a block
//! - `stencil`: weighted sums of neighbours, of which the filters consist

mod ambiguity;
mod block;
mod filters;
mod normal_dispersion;
mod row_ranges;
mod stencil;

use super::candidate::{Candidate, Voxel, nearest_sample};
use super::quadric::Quadric;
use super::shared_grid::CandidateSlab;
use super::volume::Volume;
use super::voxel_index::CandidateIndex;
use super::windows::{LayerWindow, Samples, WindowInterior};
use crate::error::Result;
use crate::geometry::{dot, norm, sub, unit};
use crate::progress::CancelToken;
use block::{BLOCK_SIZE, BlockContext, BlockNormals, BlockScratch, blocks};
use filters::CROSSING_SHAPE;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::Relaxed;

use crate::parallel::prelude::*;

pub use ambiguity::AmbiguityMask;
pub use filters::FILTER_HALO_LAYERS;

/// Number of layers beyond a rank's own layers on whose candidates the result depends: normals of
/// cells of four samples are used three cells away at ambiguous samples, and points up to four
/// samples apart smooth each other.
pub const CANDIDATE_HALO_LAYERS: usize = BLOCK_SIZE;

/// Distance (samples) in one column below which two points may be duplicates.
const DUPLICATE_DISTANCE: f32 = 0.75;
/// Smallest cosine (18 degrees) between the normals of duplicates.
const DUPLICATE_COSINE: f32 = 0.95;

/// Smallest cosine (10 degrees) between the normals of points of one surface in one column.
const SAME_COLUMN_COSINE: f32 = 0.985;
/// Distance (samples, along each axis) within which points smooth each other.
const SMOOTHING_RADIUS: i32 = 4;
/// Mean square distance (samples squared) along a surface of the places that a filter averages, for
/// both directions together.
const FILTER_VARIANCE: f64 = 28.0;
/// Share of all points that count as strong.
const STRONG_SHARE: f64 = 0.03;
/// Smallest share of the isotropic points of a block that must have an oriented point near them,
/// for the oriented points to be used.
const MIN_EXPLAINED_SHARE: f64 = 0.4;

/// A search for ridges at all orientations.
pub struct OrientedSearch<'a, const D: usize> {
    /// The image, smoothed as for isotropic ridges.
    pub image: &'a Samples<'a, D>,
    /// Background value of the image: its median.
    pub background: f32,
    /// Height of the smoothed image below which no features are searched for.
    pub noise_floor: f32,
    /// Mask of the samples at which the search is made.
    pub ambiguity: &'a AmbiguityMask<D>,
    /// Isotropic ridge points, whose normals give the lines: those of the layers that this rank
    /// owns, in which it searches, and of a halo of [`CANDIDATE_HALO_LAYERS`] layers.
    pub slab: &'a CandidateSlab<'a, D>,
    /// Smallest strength of candidates whose normals are used.
    pub min_clear_strength: f32,
    /// Smallest strength of points, as a share of that of strong ones; the share of strong points
    /// is [`STRONG_SHARE`].
    pub min_strength_share: f32,
    /// Strength to which that of strong points is scaled.
    pub typical_strength: f32,
    /// Cancels the search; checked at each block.
    pub cancel: &'a CancelToken<'a>,
}

/// Approximate shares of the search for ridges that are done before and after the blocks are
/// filtered.
const PROGRESS_BEFORE: f64 = 0.2;
const PROGRESS_AFTER: f64 = 0.8;

impl<const D: usize> OrientedSearch<'_, D> {
    /// Returns the ridge points at ambiguous samples of the layers that this rank owns and of the
    /// layers next to them, in the order of samples.
    ///
    /// # Errors
    /// Returns the errors of reading, and those of other ranks.
    pub fn points(&self) -> Result<Vec<Candidate<D>>> {
        let grid = self.slab.grid;
        let mut points = self.filter_points()?;
        let strengths = points.iter().map(|c| f64::from(c.strength)).collect();
        let strong_index = |count: usize| ((1.0 - STRONG_SHARE) * count as f64) as usize;
        let Some(strong) =
            grid.select_nth("strengths of oriented points", strengths, strong_index)?
        else {
            return Ok(points);
        };
        let strong = strong as f32;
        let min_strength = self.min_strength_share * strong;
        points.retain(|c| c.strength > min_strength);
        for c in &mut points {
            c.strength *= self.typical_strength / strong;
        }
        points.par_sort_by_key(|c| c.voxel);
        let layers = Some(self.slab.owned_layers().clone());
        let slab = CandidateSlab::new(grid, points, layers, CANDIDATE_HALO_LAYERS)?;
        Ok(self.refine_points(&slab.candidates))
    }

    /// Returns the points of the filters in the layers that this rank owns.
    fn filter_points(&self) -> Result<Vec<Candidate<D>>> {
        let dims = self.image.dims();
        let blocks = blocks(dims);
        let count: usize = blocks.dims.iter().product();
        let normals = BlockNormals::new(&self.slab.candidates, dims, self.min_clear_strength);
        let mut points: Vec<Candidate<D>> = Vec::new();
        let done = AtomicUsize::new(0);
        let layers = self.slab.owned_layers();
        let owned_blocks = (count * layers.len()).div_ceil(dims[D - 1].max(1));
        let work_of = |interior: &WindowInterior| self.ambiguity.count_within(interior);
        let mut search = |window: &LayerWindow<'_, D>| {
            let context = BlockContext {
                blocks,
                normals: &normals,
                search: self,
                window,
            };
            let ranges = window
                .interior
                .in_cells(BLOCK_SIZE)
                .layer_index_ranges(blocks.dims);
            let block_indices: Vec<usize> = ranges.flatten().collect();
            let block_points: Vec<Vec<Candidate<D>>> = block_indices
                .into_par_iter()
                .map_init(BlockScratch::default, |scratch, block| {
                    if self.cancel.is_cancelled() {
                        return Vec::new();
                    }
                    let points = context
                        .find_points(blocks.coordinates(block).map(|i| i * BLOCK_SIZE), scratch);
                    let done = (1 + done.fetch_add(1, Relaxed)) as f64 / owned_blocks as f64;
                    self.cancel
                        .set_fraction(PROGRESS_BEFORE + (PROGRESS_AFTER - PROGRESS_BEFORE) * done);
                    points
                })
                .collect();
            block_points.iter().for_each(|list| points.extend(list));
        };
        let blur = Some((CROSSING_SHAPE.blur, FILTER_HALO_LAYERS));
        (self.image).for_each_window_in(layers, 0, blur, &work_of, self.cancel, &mut search)?;
        Ok(points)
    }

    /// Moves points onto the quadratic surface through the points around them, and corrects the
    /// shift of a curved surface by a long filter.
    fn refine_points(&self, points: &[Candidate<D>]) -> Vec<Candidate<D>> {
        let grid = CandidateIndex::new(self.image.dims(), points);
        type Neighbourhood<const D: usize> = (Vec<[f32; D]>, Vec<f64>);
        let refine = |(neighbours, weights): &mut Neighbourhood<D>, c: &Candidate<D>| {
            let axis = c.axis as usize;
            neighbours.clear();
            grid.for_each_around(grid.coordinates(c), SMOOTHING_RADIUS, |j| {
                let other = &points[j];
                let offset = sub(other.position, c.position);
                if dot(other.normal, c.normal).abs() >= SAME_COLUMN_COSINE
                    && dot(offset, c.normal).abs() <= 0.4 + 0.08 * norm(offset)
                {
                    neighbours.push(offset);
                }
            });
            if neighbours.len() <= 2 * Quadric::<D>::TERM_COUNT {
                return *c;
            }
            let mut surface = Quadric::<D>::new(2 * SMOOTHING_RADIUS);
            surface.add_all(neighbours, axis, weights);
            let solved = surface.solve();
            let Some(terms) = solved else { return *c };
            // A filter sees the mean height of a curved surface.
            let (mut shift, mut term) = (0.0, D);
            for k in 1..D {
                for l in k..D {
                    if k == l {
                        shift += FILTER_VARIANCE * terms[term];
                    }
                    term += 1;
                }
            }
            let height = (terms[0] - shift) as f32;
            let mut normal = [0.0f32; D];
            normal[axis] = 1.0;
            for k in 1..D {
                normal[(axis + k) % D] = -terms[k] as f32;
            }
            let normal = unit(normal);
            if height.abs() > 0.75 || dot(normal, c.normal).abs() < SAME_COLUMN_COSINE {
                return *c;
            }
            let mut moved = *c;
            let last = (self.image.dims()[axis] - 1) as f32;
            moved.position[axis] = (c.position[axis] + height).clamp(0.0, last);
            moved.normal = normal;
            let at = moved.position.map(|x| nearest_sample(x).max(0) as usize);
            moved.voxel = Voxel::new(self.image.dims(), at);
            moved
        };
        let moved = points.par_iter().map_init(Neighbourhood::default, refine);
        let mut moved: Vec<Candidate<D>> = moved.collect();
        moved.par_sort_by_key(|c| c.voxel);
        self.remove_duplicates(&moved)
    }

    /// Removes points that have a stronger duplicate in their column.
    fn remove_duplicates(&self, points: &[Candidate<D>]) -> Vec<Candidate<D>> {
        let grid = CandidateIndex::new(self.image.dims(), points);
        let is_strongest = |i: usize| {
            let c = &points[i];
            let axis = c.axis as usize;
            let mut at = grid.coordinates(c);
            at[axis] -= 1;
            let mut is_strongest = true;
            grid.for_each_in_column(at, axis, 3, |j| {
                let other = &points[j];
                let is_duplicate = other.axis == c.axis
                    && (other.position[axis] - c.position[axis]).abs() < DUPLICATE_DISTANCE
                    && dot(other.normal, c.normal).abs() > DUPLICATE_COSINE;
                if j != i && is_duplicate {
                    is_strongest &= (c.strength, i) > (other.strength, j);
                }
            });
            is_strongest
        };
        let kept = (0..points.len())
            .into_par_iter()
            .filter(|&i| is_strongest(i));
        kept.map(|i| points[i]).collect()
    }
}

/// Merges isotropic ridge points with oriented ones. At ambiguous samples, oriented points replace
/// the isotropic ones where they explain these. Isotropic points are kept elsewhere, and where
/// surfaces bend too much for long filters. Returns the points of the layers that this rank owns,
/// in the order of samples, and the number of oriented points among them.
pub fn merge_points<const D: usize>(
    slab: &CandidateSlab<'_, D>,
    ambiguity: &AmbiguityMask<D>,
    oriented: &[Candidate<D>],
    strong_threshold: f32,
) -> (Vec<Candidate<D>>, usize) {
    let (dims, isotropic) = (slab.grid.dims, &slab.candidates[slab.owned.clone()]);
    let samples = Volume { dims, samples: &[] };
    let blocks = blocks(dims);
    let coordinates = |c: &Candidate<D>| samples.coordinates(c.voxel.index());
    let block_of = |c: &Candidate<D>| blocks.index(coordinates(c).map(|i| i / BLOCK_SIZE));
    let grid = CandidateIndex::new(dims, oriented);
    // For each block, the number of strong isotropic points, and of those with an oriented point
    // near them.
    let counters = || -> Vec<AtomicUsize> {
        let blocks = 0..blocks.dims.iter().product();
        blocks.map(|_| AtomicUsize::new(0)).collect()
    };
    let (sure_counts, explained_counts) = (counters(), counters());
    let count_explained = |c: &Candidate<D>| {
        let mut is_explained = false;
        grid.for_each_around(grid.coordinates(c), 2, |_| is_explained = true);
        let block = block_of(c);
        sure_counts[block].fetch_add(1, Relaxed);
        explained_counts[block].fetch_add(usize::from(is_explained), Relaxed);
    };
    (isotropic.par_iter())
        .filter(|c| c.strength >= strong_threshold && ambiguity.is_ambiguous(coordinates(c)))
        .for_each(count_explained);
    let is_explained: Vec<bool> = (sure_counts.iter().zip(&explained_counts))
        .map(|(sure, explained)| {
            explained.load(Relaxed) as f64 >= MIN_EXPLAINED_SHARE * sure.load(Relaxed) as f64
        })
        .collect();
    let is_replaced =
        |c: &Candidate<D>| ambiguity.is_ambiguous(coordinates(c)) && is_explained[block_of(c)];
    let owned = oriented.par_iter().copied();
    let owned = owned.filter(|c| slab.owned_layers().contains(&coordinates(c)[D - 1]));
    let mut merged = Vec::with_capacity(oriented.len() + isotropic.len());
    merged.par_extend(owned.filter(|c| is_explained[block_of(c)]));
    let count = merged.len();
    merged.par_extend(isotropic.par_iter().copied().filter(|c| !is_replaced(c)));
    merged.par_sort_by_key(|c| c.voxel);
    (merged, count)
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::geometry::{dot, sub, unit};

    /// Returns the share of the places on plane `a`, from `min_gap` to `max_gap` samples from plane
    /// `b`, that have a point within half a sample whose normal is within 10 degrees of that of the
    /// plane; and the number of places. A plane is given by a normal and a point.
    fn check_planes(
        [a, b]: [([f64; 3], [f64; 3]); 2],
        [min_gap, max_gap]: [f64; 2],
        noise: f64,
    ) -> (f64, usize) {
        let dims = [64, 72, 48];
        let planes = [a, b].map(|(normal, through)| ExactSurface::plane(normal, through));
        let image = ridge_image(dims, &planes, 1.5, noise);
        let options = DetectionOptions {
            gap_d_max: Some(8.0),
            ..DetectionOptions::with_kind(FeatureKind::Ridges, 8.0 / 3.0)
        };
        let points = detect(&image, &options).unwrap().points;
        let n = unit(a.0);
        let (mut places, mut hits) = (0, 0);
        for z in (6..dims[2] - 6).step_by(3) {
            for y in (6..dims[1] - 6).step_by(2) {
                let (y, z) = (y as f64, z as f64);
                let x = a.1[0] - (n[1] * (y - a.1[1]) + n[2] * (z - a.1[2])) / n[0];
                let p = [x, y, z];
                let gap = planes[1].distance(p).abs();
                if !(6.0..dims[0] as f64 - 6.0).contains(&x) || gap < min_gap || gap >= max_gap {
                    continue;
                }
                places += 1;
                hits += usize::from(points.iter().any(|q| {
                    let offset = sub(q.position.map(f64::from), p);
                    let normal_offset = dot(offset, n);
                    let is_same = dot(q.normal.map(f64::from), n).abs() > 0.985;
                    normal_offset.abs() <= 0.5
                        && dot(offset, offset) - normal_offset * normal_offset < 1.5
                        && is_same
                }));
            }
        }
        (hits as f64 / f64::from(places.max(1)), places as usize)
    }

    #[test]
    fn both_surfaces_are_found_near_a_crossing_at_twenty_degrees() {
        let middle = [32.0, 36.0, 24.0];
        for turn in [0.0, 0.5] {
            let (sin, cos) = 20f64.to_radians().sin_cos();
            let first = [1.0, 0.2, turn];
            // The second plane is turned about a line in the first plane.
            let n = unit(first);
            let line = unit([-n[2], 0.0, n[0]]);
            let side = crate::geometry::cross(line, n);
            let second = std::array::from_fn(|k| cos * n[k] + sin * side[k]);
            let planes = [(first, middle), (second, middle)];
            for pair in [planes, [planes[1], planes[0]]] {
                let (share, places) = check_planes(pair, [2.0, 6.0], 0.15);
                assert!(share > 0.95 && places > 50, "{turn}: {share} of {places}");
            }
        }
    }

    #[test]
    fn most_of_two_parallel_surfaces_four_samples_apart_is_found() {
        let normal = [1.0, 0.3, 0.2];
        let n = unit(normal);
        let middle = [32.0, 36.0, 24.0];
        let adjacent = std::array::from_fn(|k| middle[k] + 4.0 * n[k]);
        let planes = [(normal, middle), (normal, adjacent)];
        for pair in [planes, [planes[1], planes[0]]] {
            let (share, places) = check_planes(pair, [3.0, 5.0], 0.15);
            assert!(share > 0.8 && places > 50, "{share} of {places}");
        }
    }
}
