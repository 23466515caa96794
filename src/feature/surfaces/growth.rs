//! Grows one surface level by level. First the candidates parallel to the last level are blocked,
//! then all candidates that continue it become the next level. The result does not depend on an
//! order within a level, so that ranks that grow a surface together get the same surface as one
//! rank alone: each rank searches around all members that it sees, takes its own candidates, and
//! sends their indices to the other ranks.

use super::{OpenSides, SurfaceRules};
use crate::error::Result;
use crate::feature::candidate::{Candidate, nearest_sample};
use crate::feature::shared_grid::CandidateSlab;
use crate::feature::voxel_index::CandidateIndex;
use crate::geometry::{dot, norm, sub};
use crate::parallel::prelude::*;
use crate::progress::{CancelToken, Stage};
use std::ops::Range;

/// State of a candidate that belongs to no surface.
pub(super) const UNASSIGNED: u32 = u32::MAX;
/// State of a candidate that is parallel to a surface and too near to it.
pub(super) const BLOCKED: u32 = u32::MAX - 1;
/// State of a candidate in a surface that is too small.
pub(super) const FRAGMENT: u32 = u32::MAX - 2;
/// State of a candidate in a part of a surface that is too narrow. Smaller values are numbers of
/// surfaces.
pub(super) const NARROW: u32 = u32::MAX - 3;

/// Smallest cosine (37 degrees) between the normals of points around a point that belong to its surface.
const GROWTH_COSINE: f32 = 0.8;
/// Distance (samples) below which a parallel point is taken for part of the same surface.
const SAME_SURFACE_DISTANCE: f32 = 1.5;

/// Smallest distance (samples) of a point from the mean of the points around it where its surface
/// ends.
const MIN_RIM_OFFSET: f32 = 0.25;

/// Strong area, in units of the smallest area of a surface, that proves that a surface is not
/// noise.
const STRONG_AREA_RATIO: f64 = 4.0;

/// Distance (samples) to stronger surfaces within which a small surface cannot be told from them:
/// where a surface is cut off sharply, oblique filters respond to its corners.
const SHADOW_RADIUS: f32 = 2.0;
/// Share of a small surface's points near other surfaces above which it is dropped.
const MIN_SHADOW_SHARE: f64 = 0.9;

/// Returns the number of neighbours in its surface that a point needs to pass the surface on.
/// Inside a surface there are eight, along a straight rim five; along a curve there are two, at its
/// end one.
const fn core_neighbour_count(dimensions: usize) -> usize {
    if dimensions == 3 { 4 } else { 1 }
}

/// Share of the columns around a sample that a surface must fill for the sample to be inside it.
/// Along a straight rim half of them are filled; points there are kept because points inside are
/// near.
const MIN_FILL_SHARE: f64 = 0.8;

/// Number of members of a surface that are processed at a time.
const BATCH_SIZE: usize = 64;

/// Sum of the areas of candidates in the columns of each axis, in integers, so that the sum does
/// not depend on the order of addition.
#[derive(Clone, Copy, Default)]
struct AreaSum([u64; 3]);

impl AreaSum {
    /// Area of a surface square to the column's axis in one column, and largest area in one column.
    const UNIT_AREA: f32 = (1 << 24) as f32;
    const MAX_COLUMN_AREA: f32 = 1e6;

    fn add<const D: usize>(&mut self, c: &Candidate<D>) {
        let axis = c.axis as usize;
        self.0[axis] +=
            (Self::UNIT_AREA * (1.0 / c.normal[axis].abs()).min(Self::MAX_COLUMN_AREA)) as u64;
    }

    /// Returns the area in square lattice units.
    fn area<const D: usize>(&self, step: [f32; D]) -> f64 {
        let cell = |axis: usize| -> f32 { (1..D).map(|k| step[(axis + k) % D]).product() };
        let axis_area = |axis| f64::from(cell(axis)) * self.0[axis] as f64;
        (0..D).map(axis_area).sum::<f64>() / f64::from(Self::UNIT_AREA)
    }
}

/// Search for parallel candidates in the columns that a candidate's normal passes.
struct ParallelSearch<const D: usize> {
    /// Lattice units along the normal in lattice space per sample along the normal in sample space.
    unit_length: f32,
    /// Number of samples to either side along the candidate's axis.
    reach: i32,
    /// Samples along each axis per sample along the candidate's axis.
    slope: [f32; D],
}

impl<const D: usize> ParallelSearch<D> {
    fn new(c: &Candidate<D>, step: [f32; D], resolution: f32) -> Self {
        let axis = c.axis as usize;
        // Samples passed along each axis per lattice unit along the normal in lattice space.
        let scaled: [f32; D] = std::array::from_fn(|k| c.normal[k] / step[k]);
        let unit_length = 1.0 / norm(scaled);
        let speed: [f32; D] = std::array::from_fn(|k| scaled[k] * unit_length / step[k]);
        Self {
            unit_length,
            reach: (resolution * speed[axis].abs()).ceil() as i32,
            slope: speed.map(|s| s / speed[axis]),
        }
    }
}

/// Returns the number of layers to either side that growth needs.
pub(super) fn halo_layers<const D: usize>(
    candidates: &[Candidate<D>],
    step: [f64; D],
    rules: &SurfaceRules<D>,
) -> usize {
    let step = step.map(|h| h as f32);
    let layers_crossed = |c: &Candidate<D>| {
        let search = ParallelSearch::new(c, step, rules.resolution as f32);
        (search.reach as f32 * search.slope[D - 1].abs()).round() as usize
    };
    let search_reach = candidates.par_iter().map(layers_crossed).max().unwrap_or(0);
    // A member in the halo takes a neighbour only if enough of that neighbour's neighbours are not
    // blocked.
    (search_reach + 3).max(rules.min_width / 2)
}

/// State of the growth of surfaces.
pub(super) struct SurfaceGrowth<'a, const D: usize> {
    pub slab: &'a CandidateSlab<'a, D>,
    grid: CandidateIndex<'a, D>,
    step: [f32; D],
    rules: &'a SurfaceRules<D>,
    cancel: &'a CancelToken<'a>,
    /// State of each candidate: [`UNASSIGNED`], [`BLOCKED`], [`FRAGMENT`], [`NARROW`], or the
    /// number of its surface.
    pub state: Vec<u32>,
    /// Members of the current surface: those of this rank and those that other ranks sent.
    members: Vec<usize>,
    /// Members that were removed from the current surface as too narrow, and candidates that it
    /// blocked.
    narrow_members: Vec<usize>,
    blocked_candidates: Vec<usize>,
    /// `true` if all ranks grow the current surface together.
    is_collective: bool,
    /// For each candidate, `true` if it is inside its surface; only used while a surface is
    /// trimmed.
    is_inside: Vec<bool>,
}

impl<'a, const D: usize> SurfaceGrowth<'a, D> {
    pub fn new(
        slab: &'a CandidateSlab<'a, D>,
        step: [f64; D],
        rules: &'a SurfaceRules<D>,
        cancel: &'a CancelToken<'a>,
    ) -> Self {
        let count = slab.candidates.len();
        Self {
            slab,
            grid: CandidateIndex::new(slab.grid.dims, &slab.candidates),
            step: step.map(|h| h as f32),
            rules,
            cancel,
            state: vec![UNASSIGNED; count],
            members: Vec::new(),
            narrow_members: Vec::new(),
            blocked_candidates: Vec::new(),
            is_collective: false,
            is_inside: match rules.min_width {
                0 => Vec::new(),
                _ => vec![false; count],
            },
        }
    }

    /// Grows the surface of a seed by this rank alone. Returns `true` if the surface is accepted,
    /// and `false` if its candidates are fragments. Returns `None`, with the state unchanged, if
    /// other ranks see the surface.
    pub fn grow_locally(&mut self, seed: usize, surface: u32) -> Result<Option<bool>> {
        self.is_collective = false;
        if self.is_isolated(seed) {
            self.reset();
            self.members.push(seed);
            self.state[seed] = FRAGMENT;
            return Ok(Some(false));
        }
        match self.grow(Some(seed), surface)? {
            Some(areas) => Ok(Some(self.accept_or_discard(surface, areas)?)),
            None => {
                self.discard(UNASSIGNED);
                Ok(None)
            }
        }
    }

    /// Clears the lists for the next surface.
    fn reset(&mut self) {
        let lists = [
            &mut self.members,
            &mut self.narrow_members,
            &mut self.blocked_candidates,
        ];
        lists.into_iter().for_each(Vec::clear);
    }

    /// Grows a surface by all ranks, of which one owns the seed. Returns `true` if the surface is
    /// accepted.
    pub fn grow_collectively(&mut self, seed: Option<usize>, surface: u32) -> Result<bool> {
        self.is_collective = true;
        match self.grow(seed, surface)? {
            Some(areas) => self.accept_or_discard(surface, areas),
            None => Ok(false),
        }
    }

    /// Returns `true` if no candidate continues a seed, here or on another rank, and the seed alone
    /// is too small to be a surface.
    fn is_isolated(&self, seed: usize) -> bool {
        let c = &self.grid.candidates[seed];
        let mut area = AreaSum::default();
        area.add(c);
        if area.area(self.step) >= self.rules.min_area || self.rules.is_open() {
            return false;
        }
        let mut continuations = Vec::new();
        self.add_continuations(seed, UNASSIGNED, &mut continuations);
        continuations.is_empty() && self.slab.owns_neighbours(seed)
    }

    /// Returns the candidates that the last surface took or blocked.
    pub fn changed_candidates(&self) -> impl Iterator<Item = usize> {
        let lists = [
            &self.members,
            &self.narrow_members,
            &self.blocked_candidates,
        ];
        lists.into_iter().flatten().copied()
    }

    /// Sends this rank's fragments that other ranks see to these ranks, and marks the fragments
    /// that they send.
    pub fn exchange_fragments(&mut self, owned: &[usize]) -> Result<()> {
        let received = self.slab.exchange_marks("fragments", owned)?;
        for i in received.into_iter().flatten() {
            self.state[i] = FRAGMENT;
        }
        Ok(())
    }

    /// Returns `true` if the last surface meets the rules. If not, its members become fragments,
    /// and the candidates that it blocked are unassigned again.
    fn accept_or_discard(
        &mut self,
        surface: u32,
        [mut area, strong_area]: [f64; 2],
    ) -> Result<bool> {
        let rules = self.rules;
        let large_area = STRONG_AREA_RATIO * rules.min_area;
        let is_uncertain = strong_area < (rules.min_strong_share * area).min(large_area)
            || area < large_area && self.is_shadowed(surface)?;
        if rules.min_width > 0 && area >= rules.min_area {
            area = self.trim(surface, rules.min_width as i32 / 2)?;
        }
        let is_surface = (area >= rules.min_area && !is_uncertain)
            || self.reaches_open_side(&rules.open_sides)?;
        if !is_surface {
            self.discard(FRAGMENT);
        }
        Ok(is_surface)
    }

    /// Sets the state of the last surface's members; the candidates that it blocked are unassigned
    /// again.
    fn discard(&mut self, state: u32) {
        for &i in &self.members {
            self.state[i] = state;
        }
        for &i in &self.blocked_candidates {
            self.state[i] = UNASSIGNED;
        }
        self.blocked_candidates.clear();
    }

    /// Grows a surface. Returns its area in square lattice units and its strong area, or `None` if
    /// one rank grows it alone and other ranks see it.
    fn grow(&mut self, seed: Option<usize>, surface: u32) -> Result<Option<[f64; 2]>> {
        self.reset();
        let [mut total, mut strong] = [AreaSum::default(); 2];
        let mut next: Vec<usize> = seed.into_iter().collect();
        next.iter().for_each(|&i| self.state[i] = surface);
        loop {
            self.cancel.check(Stage::Features)?;
            let first = self.members.len();
            self.members.extend(&next);
            if !self.is_collective && next.iter().any(|&i| !self.slab.is_inner(i)) {
                return Ok(None);
            }
            for &i in &next {
                let c = &self.grid.candidates[i];
                total.add(c);
                if c.strength >= self.rules.high {
                    strong.add(c);
                }
            }
            let received = if self.is_collective {
                self.slab.exchange_marks("members of a surface", &next)?
            } else {
                (!next.is_empty()).then(Vec::new)
            };
            let Some(received) = received else { break };
            received.iter().for_each(|&i| self.state[i] = surface);
            self.members.extend(received);
            let level = first..self.members.len();
            let parallel =
                self.map_members(level.clone(), |i, parallel| self.add_parallel(i, parallel));
            self.block(parallel);
            let continuations = self.map_members(level, |i, continuations| {
                self.add_continuations(i, surface, continuations)
            });
            next.clear();
            for j in continuations.into_iter().map(|j| j as usize) {
                if self.state[j] == UNASSIGNED {
                    self.state[j] = surface;
                    next.push(j);
                }
            }
        }
        let [total, strong] =
            [self.reduce_sums(total.0)?, self.reduce_sums(strong.0)?].map(AreaSum);
        Ok(Some([total, strong].map(|sums| sums.area(self.step))))
    }

    /// Sums over the ranks that grow the surface.
    fn reduce_sums<const N: usize>(&self, local: [u64; N]) -> Result<[u64; N]> {
        if self.is_collective {
            self.slab.grid.sum("sums over a surface", local)
        } else {
            Ok(local)
        }
    }

    /// Returns the results of `find` for each of these members, computed in parallel.
    fn map_members(
        &self,
        members: Range<usize>,
        find: impl Fn(usize, &mut Vec<u32>) + Sync,
    ) -> Vec<u32> {
        let members = &self.members[members];
        let find_all = |members: &[usize]| {
            let mut found = Vec::new();
            members.iter().for_each(|&i| find(i, &mut found));
            found
        };
        match members.len() {
            ..=BATCH_SIZE => find_all(members),
            _ => {
                let parts: Vec<Vec<u32>> = members.par_chunks(BATCH_SIZE).map(find_all).collect();
                parts.concat()
            }
        }
    }

    /// Blocks those candidates that are unassigned.
    fn block(&mut self, candidates: Vec<u32>) {
        for o in candidates.into_iter().map(|o| o as usize) {
            if self.state[o] == UNASSIGNED {
                self.state[o] = BLOCKED;
                self.blocked_candidates.push(o);
            }
        }
    }

    /// Adds this rank's unassigned candidates in the 26 neighbouring samples that continue the
    /// surface. Nothing is added if the neighbours that belong to the surface or continue it are
    /// too few: a surface does not spread over bridges one or two samples wide.
    fn add_continuations(&self, i: usize, surface: u32, continuations: &mut Vec<u32>) {
        let (grid, agreement) = (&self.grid, self.rules.agreement);
        let c = &grid.candidates[i];
        let (len_before, mut count) = (continuations.len(), 0);
        grid.for_each_around(grid.coordinates(c), 1, |j| {
            let state = self.state[j];
            if j == i || !(state == UNASSIGNED || state == surface) {
                return;
            }
            let other = &grid.candidates[j];
            let offset = sub(other.position, c.position);
            let continues = dot(other.normal, c.normal).abs() >= agreement.min_normal_cosine
                && dot(offset, c.normal).abs() < agreement.max_plane_distance
                && dot(offset, other.normal).abs() < agreement.max_plane_distance;
            if continues {
                count += 1;
                if state == UNASSIGNED && self.slab.owned.contains(&j) {
                    continuations.push(j as u32);
                }
            }
        });
        if count < core_neighbour_count(D) {
            continuations.truncate(len_before);
        }
    }

    /// Adds the unassigned candidates parallel to candidate `i` on either side of it, along its
    /// normal.
    fn add_parallel(&self, i: usize, parallel: &mut Vec<u32>) {
        let (grid, rules) = (&self.grid, self.rules);
        let resolution = rules.resolution as f32;
        let c = &grid.candidates[i];
        let at = grid.coordinates(c);
        let ParallelSearch {
            unit_length,
            reach,
            slope,
        } = ParallelSearch::new(c, self.step, resolution);
        for j in (-reach..=reach).filter(|j| j.abs() > 1) {
            let column = std::array::from_fn(|k| at[k] + nearest_sample(j as f32 * slope[k]));
            grid.for_each_at(column, |o| {
                if self.state[o] != UNASSIGNED {
                    return;
                }
                let other = &grid.candidates[o];
                let distance = dot(sub(other.position, c.position), c.normal).abs();
                if dot(other.normal, c.normal).abs() >= rules.agreement.min_parallel_cosine
                    && distance > SAME_SURFACE_DISTANCE
                    && distance * unit_length < resolution
                {
                    parallel.push(o as u32);
                }
            });
        }
    }

    /// Returns the members that this rank owns.
    fn owned_members(&self) -> impl Parallel<Item = usize> {
        let owned = &self.slab.owned;
        let members = self.members.par_iter().copied();
        members.filter(|i| owned.contains(i))
    }

    /// Removes the parts of the last surface that are farther than `reach` samples from all of its
    /// interior points (a morphological opening). Returns the remaining area.
    fn trim(&mut self, surface: u32, reach: i32) -> Result<f64> {
        let (grid, state, cancel) = (&self.grid, &self.state, self.cancel);
        let dims = grid.dims.map(|n| n as i32);
        let is_inside = |&i: &usize| {
            let c = &grid.candidates[i];
            let at = grid.coordinates(c);
            let columns: i32 = (1..D)
                .map(|k| (c.axis as usize + k) % D)
                .map(|k| (at[k] + reach).min(dims[k] - 1) - (at[k] - reach).max(0) + 1)
                .product();
            let mut filled = 0;
            grid.for_each_around(at, reach, |j| filled += i32::from(state[j] == surface));
            !cancel.is_cancelled() && f64::from(filled) >= MIN_FILL_SHARE * f64::from(columns)
        };
        let mut inside: Vec<usize> = self.owned_members().filter(is_inside).collect();
        inside.extend(self.exchange_members(&inside)?);
        inside.iter().for_each(|&i| self.is_inside[i] = true);
        let (grid, is_inside) = (&self.grid, &self.is_inside);
        let is_narrow = |&i: &usize| {
            let mut is_near_inside = is_inside[i];
            if !is_near_inside && !cancel.is_cancelled() {
                let at = grid.coordinates(&grid.candidates[i]);
                grid.for_each_around(at, reach, |j| is_near_inside |= is_inside[j]);
            }
            !is_near_inside
        };
        let mut narrow: Vec<usize> = self.owned_members().filter(is_narrow).collect();
        // Only the marks of this surface are reset: there are many surfaces, and clearing all marks
        // would be slow.
        inside.iter().for_each(|&i| self.is_inside[i] = false);
        narrow.extend(self.exchange_members(&narrow)?);
        narrow.iter().for_each(|&i| self.state[i] = NARROW);
        self.narrow_members = narrow;
        let state = &self.state;
        self.members.retain(|&i| state[i] == surface);
        let mut remaining = AreaSum::default();
        for &i in self.members.iter().filter(|i| self.slab.owned.contains(i)) {
            remaining.add(&self.grid.candidates[i]);
        }
        Ok(AreaSum(self.reduce_sums(remaining.0)?).area(self.step))
    }

    /// Sends this rank's members to the other ranks, and returns those of the halo that they sent.
    fn exchange_members(&self, owned: &[usize]) -> Result<Vec<usize>> {
        if self.is_collective {
            Ok(self
                .slab
                .exchange_marks("parts of a surface", owned)?
                .unwrap_or_default())
        } else {
            Ok(Vec::new())
        }
    }

    /// Returns `true` if nearly all points of the last surface are near points of earlier surfaces.
    fn is_shadowed(&self, surface: u32) -> Result<bool> {
        let grid = &self.grid;
        let is_near_another = |&i: &usize| {
            let c = &grid.candidates[i];
            let mut is_near = false;
            grid.for_each_around(grid.coordinates(c), SHADOW_RADIUS as i32, |j| {
                let offset = sub(grid.candidates[j].position, c.position);
                let is_other = self.state[j] < NARROW && self.state[j] != surface;
                is_near |= is_other && dot(offset, offset) < SHADOW_RADIUS * SHADOW_RADIUS;
            });
            !self.cancel.is_cancelled() && is_near
        };
        let shadowed = self.owned_members().filter(is_near_another).count() as u64;
        let [shadowed, total] =
            self.reduce_sums([shadowed, self.owned_members().count() as u64])?;
        Ok(shadowed as f64 >= MIN_SHADOW_SHARE * total as f64)
    }

    /// Returns `true` if the last surface reaches an open side.
    fn reaches_open_side(&self, open_sides: &OpenSides<D>) -> Result<bool> {
        let at_side = |i: usize| {
            let at = self.grid.coordinates(&self.grid.candidates[i]);
            (0..D).any(|k| {
                let last = self.grid.dims[k] as i32 - 1;
                open_sides[k][0] && at[k] <= 1 || open_sides[k][1] && at[k] >= last - 1
            })
        };
        if !self.rules.is_open() {
            return Ok(false);
        }
        let reaches = self.owned_members().any(at_side);
        Ok(self.reduce_sums([u64::from(reaches)])? != [0])
    }

    /// Returns `true` if the surface points around a point lie mostly to one side of it.
    pub fn is_rim_at(&self, c: &Candidate<D>) -> bool {
        let (mut sum, mut count) = ([0.0f32; D], 0);
        self.grid.for_each_around(self.grid.coordinates(c), 1, |j| {
            let other = &self.grid.candidates[j];
            if self.state[j] < NARROW && dot(other.normal, c.normal).abs() >= GROWTH_COSINE {
                count += 1;
                for k in 0..D {
                    sum[k] += other.position[k] - c.position[k];
                }
            }
        });
        // Full neighbourhoods balance; along a straight rim the mean is a third of a sample off.
        count < 1 << (D - 1) || norm(sum) > MIN_RIM_OFFSET * count as f32
    }
}
