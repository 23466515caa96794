//! Ridges where sheets cross, branch or run close: orientation as a coordinate of its own.
//!
//! Seen through an isotropic Gaussian, two sheets that meet at a shallow angle or run a few samples
//! apart are one ridge. A filter that is long along a sheet and narrow across it tells them apart.
//! Two sheets through one place share the line in which they meet, so that only the angle about this
//! line has to be sought: the image is smoothed along the line, and in the plane square to it filters
//! at 24 angles give the second derivative across, C, and the first, D. *Every* maximum of C
//! over the angle is a point of a sheet, D / C samples off: one sample may hold several (orientation
//! scores: Janssen and others 2018; surface voting: Wu & Fomel 2018).
//!
//! This is done only where it matters: see [`AmbiguityMask`]. Elsewhere ridges are as
//! [`ridges`](mod@super::ridges) finds them, at a tenth of the cost.
//!
//! - `zone`: where
//! - `spread`: how normals vary beyond what one sheet would have
//! - `block`: the lines of a block of samples
//! - `filters`: filters at all angles about a line
//! - `sums`: weighted sums of neighbours, of which these are made

mod ambiguity;
mod block;
mod filters;
mod normal_dispersion;
mod stencil;

use super::candidate::{Candidate, Voxel, nearest_sample};
use super::candidate_slab::{CandidateSlab, select_nth};
use super::quadric::Quadric;
use super::volume::Volume;
use super::voxel_index::CandidateIndex;
use super::windows::{LayerWindow, Samples, WindowInterior};
use crate::error::Result;
use crate::geometry::{dot, sub};
use crate::progress::CancelToken;
use block::{BLOCK_SIZE, BlockContext, BlockNormals, BlockScratch, blocks};
use filters::CROSSING_SHAPE;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::Relaxed;

use crate::parallel::prelude::*;

pub use ambiguity::AmbiguityMask;
pub use filters::FILTER_HALO_LAYERS;

/// What is in a rank's own layers depends on no candidates farther off than this many layers: normals of cells of four
/// samples tell three cells off where it is ambiguous, and points four samples apart smooth one another.
pub const CANDIDATE_HALO_LAYERS: usize = BLOCK_SIZE;

/// Nearer than this (samples) in one column ...
const DUPLICATE_DISTANCE: f32 = 0.75;
/// ... points whose normals agree this much (cosine: 18 degrees) are one.
const DUPLICATE_COSINE: f32 = 0.95;

/// Points of one column with normals nearer than this (cosine: 10 degrees) are of one sheet.
const SAME_SURFACE_COSINE: f32 = 0.985;
/// Points within this many samples along each axis smooth one another.
const SMOOTHING_RADIUS: i32 = 4;
/// Mean square (samples) of the places along a sheet that a filter sees, for both directions alike.
const FILTER_VARIANCE: f64 = 28.0;
/// Share of all points that are at least as strong as a strong one.
const STRONG_SHARE: f64 = 0.03;
/// Points at all angles are believed where they are beside this share of the usual ones in a block.
const MIN_EXPLAINED_SHARE: f64 = 0.4;

/// What is sought in an image.
pub struct OrientedSearch<'a, const D: usize> {
    /// The image, smoothed as ridges were sought in it.
    pub image: &'a Samples<'a, D>,
    /// What the image is where there is nothing: its median.
    pub background: f32,
    /// The height of the smoothed image below which there is nothing to find.
    pub noise_floor: f32,
    /// Where.
    pub ambiguity: &'a AmbiguityMask<D>,
    /// Ridge points from whose normals the lines are guessed: of this rank's layers, in which it searches, and of a
    /// halo of [`SAME_PLACE_RADIUS`] layers.
    pub slab: &'a CandidateSlab<'a, D>,
    /// Directions are sought among candidates of at least this strength.
    pub min_clear_strength: f32,
    /// Points are stronger than this share of the strong ones, of which there are [`STRONG_SHARE`].
    pub min_strength_share: f32,
    /// Strength that the strong ones are given.
    pub typical_strength: f32,
    /// Asked at each block.
    pub cancel: &'a CancelToken<'a>,
}

/// The shares of the search for ridges that are done before and after it is at work on blocks, roughly.
const PROGRESS_BEFORE: f64 = 0.2;
const PROGRESS_AFTER: f64 = 0.8;

impl<const D: usize> OrientedSearch<'_, D> {
    /// Ridge points of the ambiguous samples of this rank's own layers and of those next to them, in the order of
    /// samples.
    ///
    /// # Errors
    /// That of reading, and those of other ranks.
    pub fn points(&self) -> Result<Vec<Candidate<D>>> {
        let (dims, group) = (self.image.dims(), self.slab.comm());
        let mut found = self.filter_points()?;
        let strengths = found.iter().map(|c| f64::from(c.strength)).collect();
        let rank = |count: usize| ((1.0 - STRONG_SHARE) * count as f64) as usize;
        let Some(strong) = select_nth("strengths at all angles", strengths, rank, group)? else {
            return Ok(found);
        };
        let strong = strong as f32;
        let least = self.min_strength_share * strong;
        found.retain(|c| c.strength > least);
        for c in &mut found {
            c.strength *= self.typical_strength / strong;
        }
        found.par_sort_by_key(|c| c.voxel);
        let layers = Some(self.slab.owned_layers().clone());
        let slab = CandidateSlab::new(dims, found, layers, CANDIDATE_HALO_LAYERS, group)?;
        Ok(self.refine_points(&slab.candidates))
    }

    /// Those of the own layers, as filters find them.
    fn filter_points(&self) -> Result<Vec<Candidate<D>>> {
        let dims = self.image.dims();
        let blocks = blocks(dims);
        let count: usize = blocks.dims.iter().product();
        let normals = BlockNormals::new(&self.slab.candidates, dims, self.min_clear_strength);
        let mut found: Vec<Candidate<D>> = Vec::new();
        let done = AtomicUsize::new(0);
        let layers = self.slab.owned_layers();
        let own_blocks = (count * layers.len()).div_ceil(dims[D - 1].max(1));
        let much = |own: &WindowInterior| self.ambiguity.count_within(own);
        let mut look = |window: &LayerWindow<'_, D>| {
            let job = BlockContext {
                blocks,
                normals: &normals,
                search: self,
                window,
            };
            let own = window
                .interior
                .in_cells(BLOCK_SIZE)
                .layer_index_ranges(blocks.dims);
            let own: Vec<usize> = own.flatten().collect();
            let some: Vec<Vec<Candidate<D>>> = own
                .into_par_iter()
                .map_init(BlockScratch::default, |scratch, block| {
                    if self.cancel.is_cancelled() {
                        return Vec::new();
                    }
                    let found =
                        job.find_points(blocks.coordinates(block).map(|i| i * BLOCK_SIZE), scratch);
                    let done = (1 + done.fetch_add(1, Relaxed)) as f64 / own_blocks as f64;
                    self.cancel
                        .set_fraction(PROGRESS_BEFORE + (PROGRESS_AFTER - PROGRESS_BEFORE) * done);
                    found
                })
                .collect();
            some.iter().for_each(|some| found.extend(some));
        };
        let blur = Some((CROSSING_SHAPE.blur, FILTER_HALO_LAYERS));
        (self.image).for_each_window_in(layers, 0, blur, &much, self.cancel, &mut look)?;
        Ok(found)
    }

    /// Points moved onto the quadratic surface through those round them, and back by what a long filter
    /// shifts a sheet that bends.
    fn refine_points(&self, points: &[Candidate<D>]) -> Vec<Candidate<D>> {
        let grid = CandidateIndex::new(self.image.dims(), points);
        type Neighbourhood<const D: usize> = (Vec<[f32; D]>, Vec<f64>);
        let polish = |(near, weights): &mut Neighbourhood<D>, c: &Candidate<D>| {
            let axis = c.axis as usize;
            near.clear();
            grid.for_each_around(grid.coordinates(c), SMOOTHING_RADIUS, |j| {
                let other = &points[j];
                let away = sub(other.position, c.position);
                let length = dot(away, away).sqrt();
                if dot(other.normal, c.normal).abs() >= SAME_SURFACE_COSINE
                    && dot(away, c.normal).abs() <= 0.4 + 0.08 * length
                {
                    near.push(away);
                }
            });
            if near.len() <= 2 * Quadric::<D>::TERM_COUNT {
                return *c;
            }
            let mut surface = Quadric::<D>::new(2 * SMOOTHING_RADIUS);
            surface.add_all(near, axis, weights);
            let solved = surface.solve();
            let Some(terms) = solved else { return *c };
            // What a filter sees of a bent sheet is its mean height.
            let (mut shift, mut bend) = (0.0, D);
            for k in 1..D {
                for l in k..D {
                    if k == l {
                        shift += FILTER_VARIANCE * terms[bend];
                    }
                    bend += 1;
                }
            }
            let height = (terms[0] - shift) as f32;
            let mut normal = [0.0f32; D];
            normal[axis] = 1.0;
            for k in 1..D {
                normal[(axis + k) % D] = -terms[k] as f32;
            }
            let length = dot(normal, normal).sqrt();
            let normal = normal.map(|n| n / length);
            if height.abs() > 0.75 || dot(normal, c.normal).abs() < SAME_SURFACE_COSINE {
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
        let moved = points.par_iter().map_init(Neighbourhood::default, polish);
        let mut moved: Vec<Candidate<D>> = moved.collect();
        moved.par_sort_by_key(|c| c.voxel);
        self.remove_duplicates(&moved)
    }

    /// Points without those that a stronger one of the same sheet stands beside in its column.
    fn remove_duplicates(&self, points: &[Candidate<D>]) -> Vec<Candidate<D>> {
        let grid = CandidateIndex::new(self.image.dims(), points);
        let alone = |i: usize| {
            let c = &points[i];
            let axis = c.axis as usize;
            let mut at = grid.coordinates(c);
            at[axis] -= 1;
            let mut alone = true;
            grid.for_each_in_column(at, axis, 3, |j| {
                let other = &points[j];
                let beside = other.axis == c.axis
                    && (other.position[axis] - c.position[axis]).abs() < DUPLICATE_DISTANCE
                    && dot(other.normal, c.normal).abs() > DUPLICATE_COSINE;
                if j != i && beside {
                    alone &= (c.strength, i) > (other.strength, j);
                }
            });
            alone
        };
        let kept = (0..points.len()).into_par_iter().filter(|&i| alone(i));
        kept.map(|i| points[i]).collect()
    }
}

/// Ridge points of a volume that is ambiguous here and there: those at all angles where these explain
/// the `usual` ones, which are kept elsewhere and where sheets bend too much for long filters. In the
/// order of samples; and the number of points at all angles among them. All of this rank's own layers.
pub fn merge_points<const D: usize>(
    slab: &CandidateSlab<'_, D>,
    zone: &AmbiguityMask<D>,
    lifted: &[Candidate<D>],
    strong: f32,
) -> (Vec<Candidate<D>>, usize) {
    let (dims, usual) = (slab.dims, &slab.candidates[slab.owned.clone()]);
    let samples = Volume { dims, samples: &[] };
    let blocks = blocks(dims);
    let at = |c: &Candidate<D>| samples.coordinates(c.voxel.index());
    let block = |c: &Candidate<D>| blocks.index(at(c).map(|i| i / BLOCK_SIZE));
    let grid = CandidateIndex::new(dims, lifted);
    // Of each block: the sure usual points, and those with a point at some angle beside them.
    let count = || -> Vec<AtomicUsize> {
        let blocks = 0..blocks.dims.iter().product();
        blocks.map(|_| AtomicUsize::new(0)).collect()
    };
    let (sure, explained) = (count(), count());
    let judge = |c: &Candidate<D>| {
        let mut beside = false;
        grid.for_each_around(grid.coordinates(c), 2, |_| beside = true);
        let block = block(c);
        sure[block].fetch_add(1, Relaxed);
        explained[block].fetch_add(usize::from(beside), Relaxed);
    };
    (usual.par_iter())
        .filter(|c| c.strength >= strong && zone.is_ambiguous(at(c)))
        .for_each(judge);
    let explained: Vec<bool> = (sure.iter().zip(&explained))
        .map(|(all, beside)| {
            beside.load(Relaxed) as f64 >= MIN_EXPLAINED_SHARE * all.load(Relaxed) as f64
        })
        .collect();
    let by_lifted = |c: &Candidate<D>| zone.is_ambiguous(at(c)) && explained[block(c)];
    let own = lifted.par_iter().copied();
    let own = own.filter(|c| slab.owned_layers().contains(&at(c)[D - 1]));
    let mut all = Vec::with_capacity(lifted.len() + usual.len());
    all.par_extend(own.filter(|c| explained[block(c)]));
    let count = all.len();
    all.par_extend(usual.par_iter().copied().filter(|c| !by_lifted(c)));
    all.par_sort_by_key(|c| c.voxel);
    (all, count)
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::geometry::{dot, sub, unit};

    /// Of the places on plane `a` that are `from` to `to` samples from plane `b`, the share at which a
    /// point of its own normal (within 10 degrees) lies within half a sample; a plane is a normal and a
    /// place.
    fn check_planes(
        [a, b]: [([f64; 3], [f64; 3]); 2],
        [from, to]: [f64; 2],
        noise: f64,
    ) -> (f64, usize) {
        let dims = [64, 72, 48];
        let planes = [a, b].map(|(normal, through)| ExactSurface::plane(normal, through));
        let image = ridge_image(dims, &planes, 1.5, noise);
        let asked = DetectionOptions {
            gap_d_max: Some(8.0),
            ..DetectionOptions::with_kind(FeatureKind::Ridges, 8.0 / 3.0)
        };
        let points = detect(&image, &asked).unwrap().points;
        let n = unit(a.0);
        let (mut places, mut good) = (0, 0);
        for z in (6..dims[2] - 6).step_by(3) {
            for y in (6..dims[1] - 6).step_by(2) {
                let (y, z) = (y as f64, z as f64);
                let x = a.1[0] - (n[1] * (y - a.1[1]) + n[2] * (z - a.1[2])) / n[0];
                let p = [x, y, z];
                let gap = planes[1].distance(p).abs();
                if !(6.0..dims[0] as f64 - 6.0).contains(&x) || gap < from || gap >= to {
                    continue;
                }
                places += 1;
                good += usize::from(points.iter().any(|q| {
                    let away = sub(q.position.map(f64::from), p);
                    let across = dot(away, n);
                    let same = dot(q.normal.map(f64::from), n).abs() > 0.985;
                    across.abs() <= 0.5 && dot(away, away) - across * across < 1.5 && same
                }));
            }
        }
        (good as f64 / f64::from(places.max(1)), places as usize)
    }

    #[test]
    fn both_of_two_sheets_that_cross_at_twenty_degrees_are_found_near_the_crossing() {
        let middle = [32.0, 36.0, 24.0];
        for turn in [0.0, 0.5] {
            let (sin, cos) = 20f64.to_radians().sin_cos();
            let first = [1.0, 0.2, turn];
            // Turned about a line that is square to it.
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
    fn four_fifths_of_both_of_two_parallel_sheets_four_samples_apart_are_found() {
        let normal = [1.0, 0.3, 0.2];
        let n = unit(normal);
        let middle = [32.0, 36.0, 24.0];
        let beside = std::array::from_fn(|k| middle[k] + 4.0 * n[k]);
        let planes = [(normal, middle), (normal, beside)];
        for pair in [planes, [planes[1], planes[0]]] {
            let (share, places) = check_planes(pair, [3.0, 5.0], 0.15);
            assert!(share > 0.8 && places > 50, "{share} of {places}");
        }
    }
}
