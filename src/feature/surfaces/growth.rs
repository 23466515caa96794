//! One sheet, grown level by level: all that the last level is beside is blocked, and then all that continues it
//! is the next. Nothing depends on an order within a level, so that ranks grow a sheet together as one would alone:
//! each looks round every member that it sees, takes its own candidates, and tells the others which.

use super::{OpenSides, SurfaceRules};
use crate::error::Result;
use crate::feature::candidate::{Candidate, nearest_sample};
use crate::feature::candidate_slab::CandidateSlab;
use crate::feature::voxel_index::CandidateIndex;
use crate::geometry::{dot, sub};
use crate::parallel::prelude::*;
use crate::progress::{CancelToken, Stage};
use std::ops::Range;

/// Of no sheet ...
pub(super) const UNASSIGNED: u32 = u32::MAX;
/// ... and never of one, since it is parallel to a sheet and too near it, ...
pub(super) const BLOCKED: u32 = u32::MAX - 1;
/// ... in a piece that is too small, ...
pub(super) const FRAGMENT: u32 = u32::MAX - 2;
/// ... or in a part that is too narrow. What is less is the number of a sheet.
pub(super) const NARROW: u32 = u32::MAX - 3;

/// Round a point, those of its own sheet agree with its normal at least this much (cosine).
const SAME_SURFACE_COSINE: f32 = 0.8;
/// Nearer than this (samples), a parallel point is taken for part of the same sheet.
const SAME_SURFACE_DISTANCE: f32 = 1.5;

/// The mean of the points round a point is this far off (samples) where a sheet ends.
const MIN_RIM_OFFSET: f32 = 0.25;

/// As many times the least area of a sheet, as strong as can be wished, are no noise.
const STRONG_AREA_RATIO: f64 = 4.0;

/// A small sheet that lies within this of others (samples) cannot be told from them: where a sheet is cut off
/// sharply, filters that stand askew there see its corners.
const SHADOW_RADIUS: f32 = 2.0;
/// ... with this share of its points.
const MIN_SHADOW_SHARE: f64 = 0.9;

/// A point passes its sheet on if it has this many neighbours in it: inside a sheet there are eight,
/// along its straight rim five; along a curve there are two, at its end one.
const fn core_neighbour_count(dimensions: usize) -> usize {
    if dimensions == 3 { 4 } else { 1 }
}

/// A place is inside a sheet that fills this share of the columns round it. Along a straight rim half
/// are filled: it is kept for what is inside beside it.
const MIN_FILL_SHARE: f64 = 0.8;

/// So many members of a sheet are looked at at a time.
const BATCH_SIZE: usize = 64;

/// How wide candidates are in the columns of each axis: added up in whole numbers, whose sum does not depend
/// on their order.
#[derive(Clone, Copy, Default)]
struct AreaSum([u64; 3]);

impl AreaSum {
    /// What a level sheet has in one column is one, and what any has is at most so much.
    const UNIT_AREA: f32 = (1 << 24) as f32;
    const MAX_COLUMN_AREA: f32 = 1e6;

    fn add<const D: usize>(&mut self, c: &Candidate<D>) {
        let axis = c.axis as usize;
        self.0[axis] +=
            (Self::UNIT_AREA * (1.0 / c.normal[axis].abs()).min(Self::MAX_COLUMN_AREA)) as u64;
    }

    /// The area in square lattice units.
    fn area<const D: usize>(&self, step: [f32; D]) -> f64 {
        let cell = |axis: usize| -> f32 { (1..D).map(|k| step[(axis + k) % D]).product() };
        let of_axis = |axis| f64::from(cell(axis)) * self.0[axis] as f64;
        (0..D).map(of_axis).sum::<f64>() / f64::from(Self::UNIT_AREA)
    }
}

/// Where what is parallel to a candidate may be: in the columns that its normal passes.
struct ParallelSearch<const D: usize> {
    /// Lattice units along the lattice's own normal that one sample along the samples' is.
    unit_length: f32,
    /// Samples to either side along the candidate's axis.
    reach: i32,
    /// Samples along each axis for one along the candidate's.
    slope: [f32; D],
}

impl<const D: usize> ParallelSearch<D> {
    fn new(c: &Candidate<D>, step: [f32; D], resolution: f32) -> Self {
        let axis = c.axis as usize;
        // Samples passed along each axis per lattice unit along the lattice-space normal.
        let scaled: [f32; D] = std::array::from_fn(|k| c.normal[k] / step[k]);
        let unit_length = 1.0 / dot(scaled, scaled).sqrt();
        let speed: [f32; D] = std::array::from_fn(|k| scaled[k] * unit_length / step[k]);
        Self {
            unit_length,
            reach: (resolution * speed[axis].abs()).ceil() as i32,
            slope: speed.map(|s| s / speed[axis]),
        }
    }
}

/// How many layers to either side growth looks.
pub(super) fn halo_layers<const D: usize>(
    candidates: &[Candidate<D>],
    step: [f64; D],
    rules: &SurfaceRules<D>,
) -> usize {
    let step = step.map(|h| h as f32);
    let of_one = |c: &Candidate<D>| {
        let beside = ParallelSearch::new(c, step, rules.resolution as f32);
        (beside.reach as f32 * beside.slope[D - 1].abs()).round() as usize
    };
    let beside = candidates.par_iter().map(of_one).max().unwrap_or(0);
    // A member of the halo takes what is beside it if enough of what is beside that is not blocked.
    (beside + 3).max(rules.min_width / 2)
}

/// Sheets, as they grow.
pub(super) struct SurfaceGrowth<'a, const D: usize> {
    pub slab: &'a CandidateSlab<'a, D>,
    grid: CandidateIndex<'a, D>,
    step: [f32; D],
    rules: &'a SurfaceRules<D>,
    cancel: &'a CancelToken<'a>,
    /// What became of each candidate.
    pub state: Vec<u32>,
    /// Of the last sheet: its members, this rank's own and those that others told of, ...
    members: Vec<usize>,
    /// ... what was taken from it as too narrow, and what it blocked.
    narrow_members: Vec<usize>,
    blocked_candidates: Vec<usize>,
    /// Whether all ranks grow it.
    is_collective: bool,
    /// For each candidate, while its sheet is trimmed, whether it is inside.
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
            grid: CandidateIndex::new(slab.dims, &slab.candidates),
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

    /// Grows the sheet of a seed by this rank alone; whether it is one, and `None`, and all as it was before, if it
    /// comes where others see it.
    pub fn grow_locally(&mut self, seed: usize, sheet: u32) -> Result<Option<bool>> {
        self.is_collective = false;
        if self.is_isolated(seed) {
            self.reset();
            self.members.push(seed);
            self.state[seed] = FRAGMENT;
            return Ok(Some(false));
        }
        match self.grow(Some(seed), sheet)? {
            Some(areas) => Ok(Some(self.accept_or_discard(sheet, areas)?)),
            None => {
                self.discard(UNASSIGNED);
                Ok(None)
            }
        }
    }

    /// Begins with another sheet.
    fn reset(&mut self) {
        let all = [
            &mut self.members,
            &mut self.narrow_members,
            &mut self.blocked_candidates,
        ];
        all.into_iter().for_each(Vec::clear);
    }

    /// Grows a sheet by all ranks, of which one has the seed; whether it is one.
    pub fn grow_collectively(&mut self, seed: Option<usize>, sheet: u32) -> Result<bool> {
        self.is_collective = true;
        match self.grow(seed, sheet)? {
            Some(areas) => self.accept_or_discard(sheet, areas),
            None => Ok(false),
        }
    }

    /// Whether nothing continues a seed, which alone is no sheet; and no other rank has anything that might.
    fn is_isolated(&self, seed: usize) -> bool {
        let c = &self.grid.candidates[seed];
        let mut area = AreaSum::default();
        area.add(c);
        if area.area(self.step) >= self.rules.min_area || self.rules.is_open() {
            return false;
        }
        let mut joined = Vec::new();
        self.add_continuations(seed, UNASSIGNED, &mut joined);
        joined.is_empty() && self.slab.owns_neighbours(seed)
    }

    /// What is not free any more after the last sheet was grown.
    pub fn changed_candidates(&self) -> impl Iterator<Item = usize> {
        let all = [
            &self.members,
            &self.narrow_members,
            &self.blocked_candidates,
        ];
        all.into_iter().flatten().copied()
    }

    /// Tells others of own crumbs that they see, and hears of theirs.
    pub fn exchange_fragments(&mut self, own: &[usize]) -> Result<()> {
        let told = self.slab.exchange_marks("crumbs", own)?;
        for i in told.into_iter().flatten() {
            self.state[i] = FRAGMENT;
        }
        Ok(())
    }

    /// Whether the last sheet keeps the rules; if not, its members are crumbs and what it blocked is free again.
    fn accept_or_discard(&mut self, sheet: u32, [mut area, sure]: [f64; 2]) -> Result<bool> {
        let rules = self.rules;
        let large = STRONG_AREA_RATIO * rules.min_area;
        let unsure = sure < (rules.min_strong_share * area).min(large)
            || area < large && self.is_shadowed(sheet)?;
        if rules.min_width > 0 && area >= rules.min_area {
            area = self.trim(sheet, rules.min_width as i32 / 2)?;
        }
        let is_sheet =
            (area >= rules.min_area && !unsure) || self.reaches_open_side(&rules.open_sides)?;
        if !is_sheet {
            self.discard(FRAGMENT);
        }
        Ok(is_sheet)
    }

    /// Members take this state, and what the sheet blocked is free again.
    fn discard(&mut self, state: u32) {
        for &i in &self.members {
            self.state[i] = state;
        }
        for &i in &self.blocked_candidates {
            self.state[i] = UNASSIGNED;
        }
        self.blocked_candidates.clear();
    }

    /// Grows a sheet; its area in square lattice units, and that of what is strong of it. `None` if but one rank
    /// grows it and it comes where others see it.
    fn grow(&mut self, seed: Option<usize>, sheet: u32) -> Result<Option<[f64; 2]>> {
        self.reset();
        let [mut all, mut strong] = [AreaSum::default(); 2];
        let mut next: Vec<usize> = seed.into_iter().collect();
        next.iter().for_each(|&i| self.state[i] = sheet);
        loop {
            self.cancel.check(Stage::Features)?;
            let first = self.members.len();
            self.members.extend(&next);
            if !self.is_collective && next.iter().any(|&i| !self.slab.is_inner(i)) {
                return Ok(None);
            }
            for &i in &next {
                let c = &self.grid.candidates[i];
                all.add(c);
                if c.strength >= self.rules.high {
                    strong.add(c);
                }
            }
            let told = match self.is_collective {
                true => self.slab.exchange_marks("members of a sheet", &next)?,
                false => (!next.is_empty()).then(Vec::new),
            };
            let Some(told) = told else { break };
            told.iter().for_each(|&i| self.state[i] = sheet);
            self.members.extend(told);
            let level = first..self.members.len();
            let beside = self.map_members(level.clone(), |i, beside| self.add_parallel(i, beside));
            self.block(beside);
            let joined =
                self.map_members(level, |i, joined| self.add_continuations(i, sheet, joined));
            next.clear();
            for j in joined.into_iter().map(|j| j as usize) {
                if self.state[j] == UNASSIGNED {
                    self.state[j] = sheet;
                    next.push(j);
                }
            }
        }
        let [all, strong] = [self.reduce_sums(all.0)?, self.reduce_sums(strong.0)?].map(AreaSum);
        Ok(Some([all, strong].map(|spread| spread.area(self.step))))
    }

    /// Sums over those who grow the sheet.
    fn reduce_sums<const N: usize>(&self, own: [u64; N]) -> Result<[u64; N]> {
        match self.is_collective {
            true => self.slab.global_sums("figures of a sheet", own),
            false => Ok(own),
        }
    }

    /// What `find` finds for each of these members, by all threads.
    fn map_members(
        &self,
        members: Range<usize>,
        find: impl Fn(usize, &mut Vec<u32>) + Sync,
    ) -> Vec<u32> {
        let members = &self.members[members];
        let of_some = |members: &[usize]| {
            let mut found = Vec::new();
            members.iter().for_each(|&i| find(i, &mut found));
            found
        };
        match members.len() {
            ..=BATCH_SIZE => of_some(members),
            _ => {
                let parts: Vec<Vec<u32>> = members.par_chunks(BATCH_SIZE).map(of_some).collect();
                parts.concat()
            }
        }
    }

    /// Blocks those candidates that are free.
    fn block(&mut self, beside: Vec<u32>) {
        for o in beside.into_iter().map(|o| o as usize) {
            if self.state[o] == UNASSIGNED {
                self.state[o] = BLOCKED;
                self.blocked_candidates.push(o);
            }
        }
    }

    /// Adds this rank's own free candidates of the 26 neighbouring samples that continue the sheet, if with those
    /// of its own there are enough: a sheet does not spread over bridges a sample or two wide.
    fn add_continuations(&self, i: usize, sheet: u32, joined: &mut Vec<u32>) {
        let (grid, agreement) = (&self.grid, self.rules.agreement);
        let c = &grid.candidates[i];
        let (before, mut count) = (joined.len(), 0);
        grid.for_each_around(grid.coordinates(c), 1, |j| {
            let state = self.state[j];
            if j == i || !(state == UNASSIGNED || state == sheet) {
                return;
            }
            let other = &grid.candidates[j];
            let apart = sub(other.position, c.position);
            let continues = dot(other.normal, c.normal).abs() >= agreement.min_normal_cosine
                && dot(apart, c.normal).abs() < agreement.max_plane_distance
                && dot(apart, other.normal).abs() < agreement.max_plane_distance;
            if continues {
                count += 1;
                if state == UNASSIGNED && self.slab.owned.contains(&j) {
                    joined.push(j as u32);
                }
            }
        });
        if count < core_neighbour_count(D) {
            joined.truncate(before);
        }
    }

    /// Adds the free candidates parallel to candidate `i` on either side of it, along its normal.
    fn add_parallel(&self, i: usize, beside: &mut Vec<u32>) {
        let (grid, rules) = (&self.grid, self.rules);
        let resolution = rules.resolution as f32;
        let c = &grid.candidates[i];
        let at = grid.coordinates(c);
        let ParallelSearch {
            unit_length: unit,
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
                let across = dot(sub(other.position, c.position), c.normal).abs();
                if dot(other.normal, c.normal).abs() >= rules.agreement.min_parallel_cosine
                    && across > SAME_SURFACE_DISTANCE
                    && across * unit < resolution
                {
                    beside.push(o as u32);
                }
            });
        }
    }

    /// Members that are this rank's own.
    fn owned_members(&self) -> impl Parallel<Item = usize> {
        let own = &self.slab.owned;
        let members = self.members.par_iter().copied();
        members.filter(|i| own.contains(i))
    }

    /// Takes from the last sheet what is farther than `reach` samples from all places that are inside it
    /// (an opening, in the terms of morphology); returns the area that is left.
    fn trim(&mut self, sheet: u32, reach: i32) -> Result<f64> {
        let (grid, state, patience) = (&self.grid, &self.state, self.cancel);
        let dims = grid.dims.map(|n| n as i32);
        let is_inside = |&i: &usize| {
            let c = &grid.candidates[i];
            let at = grid.coordinates(c);
            let columns: i32 = (1..D)
                .map(|k| (c.axis as usize + k) % D)
                .map(|k| (at[k] + reach).min(dims[k] - 1) - (at[k] - reach).max(0) + 1)
                .product();
            let mut own = 0;
            grid.for_each_around(at, reach, |j| own += i32::from(state[j] == sheet));
            !patience.is_cancelled() && f64::from(own) >= MIN_FILL_SHARE * f64::from(columns)
        };
        let mut inside: Vec<usize> = self.owned_members().filter(is_inside).collect();
        inside.extend(self.exchange_members(&inside)?);
        inside.iter().for_each(|&i| self.is_inside[i] = true);
        let (grid, inner) = (&self.grid, &self.is_inside);
        let is_narrow = |&i: &usize| {
            let mut near = inner[i];
            if !near && !patience.is_cancelled() {
                let at = grid.coordinates(&grid.candidates[i]);
                grid.for_each_around(at, reach, |j| near |= inner[j]);
            }
            !near
        };
        let mut narrow: Vec<usize> = self.owned_members().filter(is_narrow).collect();
        // None is marked afterwards: sheets are many, and candidates of all of them more.
        inside.iter().for_each(|&i| self.is_inside[i] = false);
        narrow.extend(self.exchange_members(&narrow)?);
        narrow.iter().for_each(|&i| self.state[i] = NARROW);
        self.narrow_members = narrow;
        let state = &self.state;
        self.members.retain(|&i| state[i] == sheet);
        let mut left = AreaSum::default();
        for &i in self.members.iter().filter(|i| self.slab.owned.contains(i)) {
            left.add(&self.grid.candidates[i]);
        }
        Ok(AreaSum(self.reduce_sums(left.0)?).area(self.step))
    }

    /// Those of the halo that other ranks mean, of whom each tells of its own.
    fn exchange_members(&self, own: &[usize]) -> Result<Vec<usize>> {
        match self.is_collective {
            true => Ok(self
                .slab
                .exchange_marks("parts of a sheet", own)?
                .unwrap_or_default()),
            false => Ok(Vec::new()),
        }
    }

    /// Whether the last sheet lies in the shadow of those before it.
    fn is_shadowed(&self, sheet: u32) -> Result<bool> {
        let grid = &self.grid;
        let of_another = |&i: &usize| {
            let c = &grid.candidates[i];
            let mut near = false;
            grid.for_each_around(grid.coordinates(c), SHADOW_RADIUS as i32, |j| {
                let apart = sub(grid.candidates[j].position, c.position);
                let other = self.state[j] < NARROW && self.state[j] != sheet;
                near |= other && dot(apart, apart) < SHADOW_RADIUS * SHADOW_RADIUS;
            });
            !self.cancel.is_cancelled() && near
        };
        let shaded = self.owned_members().filter(of_another).count() as u64;
        let [shaded, all] = self.reduce_sums([shaded, self.owned_members().count() as u64])?;
        Ok(shaded as f64 >= MIN_SHADOW_SHARE * all as f64)
    }

    /// Whether the last sheet reaches an open side.
    fn reaches_open_side(&self, open: &OpenSides<D>) -> Result<bool> {
        let at_side = |i: usize| {
            let at = self.grid.coordinates(&self.grid.candidates[i]);
            (0..D).any(|k| {
                let last = self.grid.dims[k] as i32 - 1;
                open[k][0] && at[k] <= 1 || open[k][1] && at[k] >= last - 1
            })
        };
        if !self.rules.is_open() {
            return Ok(false);
        }
        let reaches = self.owned_members().any(at_side);
        Ok(self.reduce_sums([u64::from(reaches)])? != [0])
    }

    /// Whether the sheets' points round a point lie mostly to one side of it.
    pub fn is_rim_at(&self, c: &Candidate<D>) -> bool {
        let (mut sum, mut count) = ([0.0f32; D], 0);
        self.grid.for_each_around(self.grid.coordinates(c), 1, |j| {
            let other = &self.grid.candidates[j];
            if self.state[j] < NARROW && dot(other.normal, c.normal).abs() >= SAME_SURFACE_COSINE {
                count += 1;
                for k in 0..D {
                    sum[k] += other.position[k] - c.position[k];
                }
            }
        });
        // Whole neighbourhoods balance; along a straight rim the mean is a third of a sample off.
        count < 1 << (D - 1) || dot(sum, sum).sqrt() > MIN_RIM_OFFSET * count as f32
    }
}
