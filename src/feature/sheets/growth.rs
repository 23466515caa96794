//! One sheet, grown level by level: all that the last level is beside is blocked, and then all that continues it
//! is the next. Nothing depends on an order within a level, so that ranks grow a sheet together as one would alone:
//! each looks round every member that it sees, takes its own candidates, and tells the others which.

use super::{Open, Rules};
use crate::error::Result;
use crate::feature::by_sample::BySample;
use crate::feature::crossing::{Candidate, nearest};
use crate::feature::slab::Slab;
use crate::geometry::{dot, sub};
use crate::observer::{Patience, Stage};
use crate::parallel::prelude::*;
use std::ops::Range;

/// Of no sheet ...
pub(super) const FREE: u32 = u32::MAX;
/// ... and never of one, since it is parallel to a sheet and too near it, ...
pub(super) const BLOCKED: u32 = u32::MAX - 1;
/// ... in a piece that is too small, ...
pub(super) const CRUMB: u32 = u32::MAX - 2;
/// ... or in a part that is too narrow. What is less is the number of a sheet.
pub(super) const NARROW: u32 = u32::MAX - 3;

/// Round a point, those of its own sheet agree with its normal at least this much (cosine).
const SAME_NORMAL: f32 = 0.8;
/// Nearer than this (samples), a parallel point is taken for part of the same sheet.
const TOGETHER: f32 = 1.5;

/// The mean of the points round a point is this far off (samples) where a sheet ends.
const LOPSIDED: f32 = 0.25;

/// As many times the least area of a sheet, as strong as can be wished, are no noise.
const ENOUGH: f64 = 4.0;

/// A small sheet that lies within this of others (samples) cannot be told from them: where a sheet is cut off
/// sharply, filters that stand askew there see its corners.
const SHADOW: f32 = 2.0;
/// ... with this share of its points.
const SHADED: f64 = 0.9;

/// A point passes its sheet on if it has this many neighbours in it: inside a sheet there are eight,
/// along its straight rim five; along a curve there are two, at its end one.
const fn core(dimensions: usize) -> usize {
    if dimensions == 3 { 4 } else { 1 }
}

/// A place is inside a sheet that fills this share of the columns round it. Along a straight rim half
/// are filled: it is kept for what is inside beside it.
const FILLED: f64 = 0.8;

/// So many members of a sheet are looked at at a time.
const SOME: usize = 64;

/// How wide candidates are in the columns of each axis: added up in whole numbers, whose sum does not depend
/// on their order.
#[derive(Clone, Copy, Default)]
struct Spread([u64; 3]);

impl Spread {
    /// What a level sheet has in one column is one, and what any has is at most so much.
    const ONE: f32 = (1 << 24) as f32;
    const MOST: f32 = 1e6;

    fn add<const D: usize>(&mut self, c: &Candidate<D>) {
        let axis = c.axis as usize;
        self.0[axis] += (Self::ONE * (1.0 / c.normal[axis].abs()).min(Self::MOST)) as u64;
    }

    /// The area in square lattice units.
    fn area<const D: usize>(&self, step: [f32; D]) -> f64 {
        let cell = |axis: usize| -> f32 { (1..D).map(|k| step[(axis + k) % D]).product() };
        let of_axis = |axis| f64::from(cell(axis)) * self.0[axis] as f64;
        (0..D).map(of_axis).sum::<f64>() / f64::from(Self::ONE)
    }
}

/// Where what is parallel to a candidate may be: in the columns that its normal passes.
struct Beside<const D: usize> {
    /// Lattice units along the lattice's own normal that one sample along the samples' is.
    unit: f32,
    /// Samples to either side along the candidate's axis.
    reach: i32,
    /// Samples along each axis for one along the candidate's.
    slope: [f32; D],
}

impl<const D: usize> Beside<D> {
    fn of(c: &Candidate<D>, step: [f32; D], resolution: f32) -> Self {
        let axis = c.axis as usize;
        // Samples passed along each axis per lattice unit along the lattice-space normal.
        let scaled: [f32; D] = std::array::from_fn(|k| c.normal[k] / step[k]);
        let unit = 1.0 / dot(scaled, scaled).sqrt();
        let speed: [f32; D] = std::array::from_fn(|k| scaled[k] * unit / step[k]);
        Self {
            unit,
            reach: (resolution * speed[axis].abs()).ceil() as i32,
            slope: speed.map(|s| s / speed[axis]),
        }
    }
}

/// How many layers to either side growth looks.
pub(super) fn sees<const D: usize>(
    candidates: &[Candidate<D>],
    step: [f64; D],
    rules: &Rules<D>,
) -> usize {
    let step = step.map(|h| h as f32);
    let of_one = |c: &Candidate<D>| {
        let beside = Beside::of(c, step, rules.resolution as f32);
        (beside.reach as f32 * beside.slope[D - 1].abs()).round() as usize
    };
    let beside = candidates.par_iter().map(of_one).max().unwrap_or(0);
    // A member of the halo takes what is beside it if enough of what is beside that is not blocked.
    (beside + 3).max(rules.least_width / 2)
}

/// Sheets, as they grow.
pub(super) struct Growth<'a, const D: usize> {
    pub slab: &'a Slab<'a, D>,
    grid: BySample<'a, D>,
    step: [f32; D],
    rules: &'a Rules<D>,
    patience: &'a Patience<'a>,
    /// What became of each candidate.
    pub state: Vec<u32>,
    /// Of the last sheet: its members, this rank's own and those that others told of, ...
    members: Vec<usize>,
    /// ... what was taken from it as too narrow, and what it blocked.
    narrow: Vec<usize>,
    blocked: Vec<usize>,
    /// Whether all ranks grow it.
    together: bool,
    /// For each candidate, while its sheet is trimmed, whether it is inside.
    inside: Vec<bool>,
}

impl<'a, const D: usize> Growth<'a, D> {
    pub fn new(
        slab: &'a Slab<'a, D>,
        step: [f64; D],
        rules: &'a Rules<D>,
        patience: &'a Patience<'a>,
    ) -> Self {
        let count = slab.candidates.len();
        Self {
            slab,
            grid: BySample::new(slab.dims, &slab.candidates),
            step: step.map(|h| h as f32),
            rules,
            patience,
            state: vec![FREE; count],
            members: Vec::new(),
            narrow: Vec::new(),
            blocked: Vec::new(),
            together: false,
            inside: match rules.least_width {
                0 => Vec::new(),
                _ => vec![false; count],
            },
        }
    }

    /// Grows the sheet of a seed by this rank alone; whether it is one, and `None`, and all as it was before, if it
    /// comes where others see it.
    pub fn alone(&mut self, seed: usize, sheet: u32) -> Result<Option<bool>> {
        self.together = false;
        if self.is_lone(seed) {
            self.begin();
            self.members.push(seed);
            self.state[seed] = CRUMB;
            return Ok(Some(false));
        }
        match self.grow(Some(seed), sheet)? {
            Some(areas) => Ok(Some(self.is_sheet(sheet, areas)?)),
            None => {
                self.give_up(FREE);
                Ok(None)
            }
        }
    }

    /// Begins with another sheet.
    fn begin(&mut self) {
        let all = [&mut self.members, &mut self.narrow, &mut self.blocked];
        all.into_iter().for_each(Vec::clear);
    }

    /// Grows a sheet by all ranks, of which one has the seed; whether it is one.
    pub fn together(&mut self, seed: Option<usize>, sheet: u32) -> Result<bool> {
        self.together = true;
        match self.grow(seed, sheet)? {
            Some(areas) => self.is_sheet(sheet, areas),
            None => Ok(false),
        }
    }

    /// Whether nothing continues a seed, which alone is no sheet; and no other rank has anything that might.
    fn is_lone(&self, seed: usize) -> bool {
        let c = &self.grid.candidates[seed];
        let mut area = Spread::default();
        area.add(c);
        if area.area(self.step) >= self.rules.min_area || self.rules.is_open() {
            return false;
        }
        let mut joined = Vec::new();
        self.joined_to(seed, FREE, &mut joined);
        joined.is_empty() && self.slab.has_beside(seed)
    }

    /// What is not free any more after the last sheet was grown.
    pub fn marked(&self) -> impl Iterator<Item = usize> {
        let all = [&self.members, &self.narrow, &self.blocked];
        all.into_iter().flatten().copied()
    }

    /// Tells others of own crumbs that they see, and hears of theirs.
    pub fn hear_of_crumbs(&mut self, own: &[usize]) -> Result<()> {
        let told = self.slab.tell("crumbs", own)?;
        for i in told.into_iter().flatten() {
            self.state[i] = CRUMB;
        }
        Ok(())
    }

    /// Whether the last sheet keeps the rules; if not, its members are crumbs and what it blocked is free again.
    fn is_sheet(&mut self, sheet: u32, [mut area, sure]: [f64; 2]) -> Result<bool> {
        let rules = self.rules;
        let large = ENOUGH * rules.min_area;
        let unsure =
            sure < (rules.sure * area).min(large) || area < large && self.is_shaded(sheet)?;
        if rules.least_width > 0 && area >= rules.min_area {
            area = self.trim(sheet, rules.least_width as i32 / 2)?;
        }
        let is_sheet = (area >= rules.min_area && !unsure) || self.reaches(&rules.open)?;
        if !is_sheet {
            self.give_up(CRUMB);
        }
        Ok(is_sheet)
    }

    /// Members take this state, and what the sheet blocked is free again.
    fn give_up(&mut self, state: u32) {
        for &i in &self.members {
            self.state[i] = state;
        }
        for &i in &self.blocked {
            self.state[i] = FREE;
        }
        self.blocked.clear();
    }

    /// Grows a sheet; its area in square lattice units, and that of what is strong of it. `None` if but one rank
    /// grows it and it comes where others see it.
    fn grow(&mut self, seed: Option<usize>, sheet: u32) -> Result<Option<[f64; 2]>> {
        self.begin();
        let [mut all, mut strong] = [Spread::default(); 2];
        let mut next: Vec<usize> = seed.into_iter().collect();
        next.iter().for_each(|&i| self.state[i] = sheet);
        loop {
            self.patience.lasts(Stage::Features)?;
            let first = self.members.len();
            self.members.extend(&next);
            if !self.together && next.iter().any(|&i| !self.slab.is_inner(i)) {
                return Ok(None);
            }
            for &i in &next {
                let c = &self.grid.candidates[i];
                all.add(c);
                if c.strength >= self.rules.high {
                    strong.add(c);
                }
            }
            let told = match self.together {
                true => self.slab.tell("members of a sheet", &next)?,
                false => (!next.is_empty()).then(Vec::new),
            };
            let Some(told) = told else { break };
            told.iter().for_each(|&i| self.state[i] = sheet);
            self.members.extend(told);
            let level = first..self.members.len();
            let beside = self.of_each(level.clone(), |i, beside| self.parallel_to(i, beside));
            self.block(beside);
            let joined = self.of_each(level, |i, joined| self.joined_to(i, sheet, joined));
            next.clear();
            for j in joined.into_iter().map(|j| j as usize) {
                if self.state[j] == FREE {
                    self.state[j] = sheet;
                    next.push(j);
                }
            }
        }
        let [all, strong] = [self.sums(all.0)?, self.sums(strong.0)?].map(Spread);
        Ok(Some([all, strong].map(|spread| spread.area(self.step))))
    }

    /// Sums over those who grow the sheet.
    fn sums<const N: usize>(&self, own: [u64; N]) -> Result<[u64; N]> {
        match self.together {
            true => self.slab.sums("figures of a sheet", own),
            false => Ok(own),
        }
    }

    /// What `find` finds for each of these members, by all threads.
    fn of_each(
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
            ..=SOME => of_some(members),
            _ => {
                let parts: Vec<Vec<u32>> = members.par_chunks(SOME).map(of_some).collect();
                parts.concat()
            }
        }
    }

    /// Blocks those candidates that are free.
    fn block(&mut self, beside: Vec<u32>) {
        for o in beside.into_iter().map(|o| o as usize) {
            if self.state[o] == FREE {
                self.state[o] = BLOCKED;
                self.blocked.push(o);
            }
        }
    }

    /// Adds this rank's own free candidates of the 26 neighbouring samples that continue the sheet, if with those
    /// of its own there are enough: a sheet does not spread over bridges a sample or two wide.
    fn joined_to(&self, i: usize, sheet: u32, joined: &mut Vec<u32>) {
        let (grid, agreement) = (&self.grid, self.rules.agreement);
        let c = &grid.candidates[i];
        let (before, mut count) = (joined.len(), 0);
        grid.each_around(grid.coordinates(c), 1, |j| {
            let state = self.state[j];
            if j == i || !(state == FREE || state == sheet) {
                return;
            }
            let other = &grid.candidates[j];
            let apart = sub(other.position, c.position);
            let continues = dot(other.normal, c.normal).abs() >= agreement.normal
                && dot(apart, c.normal).abs() < agreement.plane
                && dot(apart, other.normal).abs() < agreement.plane;
            if continues {
                count += 1;
                if state == FREE && self.slab.own.contains(&j) {
                    joined.push(j as u32);
                }
            }
        });
        if count < core(D) {
            joined.truncate(before);
        }
    }

    /// Adds the free candidates parallel to candidate `i` on either side of it, along its normal.
    fn parallel_to(&self, i: usize, beside: &mut Vec<u32>) {
        let (grid, rules) = (&self.grid, self.rules);
        let resolution = rules.resolution as f32;
        let c = &grid.candidates[i];
        let at = grid.coordinates(c);
        let Beside { unit, reach, slope } = Beside::of(c, self.step, resolution);
        for j in (-reach..=reach).filter(|j| j.abs() > 1) {
            let column = std::array::from_fn(|k| at[k] + nearest(j as f32 * slope[k]));
            grid.each(column, |o| {
                if self.state[o] != FREE {
                    return;
                }
                let other = &grid.candidates[o];
                let across = dot(sub(other.position, c.position), c.normal).abs();
                if dot(other.normal, c.normal).abs() >= rules.agreement.parallel
                    && across > TOGETHER
                    && across * unit < resolution
                {
                    beside.push(o as u32);
                }
            });
        }
    }

    /// Members that are this rank's own.
    fn own_members(&self) -> impl Parallel<Item = usize> {
        let own = &self.slab.own;
        let members = self.members.par_iter().copied();
        members.filter(|i| own.contains(i))
    }

    /// Takes from the last sheet what is farther than `reach` samples from all places that are inside it
    /// (an opening, in the terms of morphology); returns the area that is left.
    fn trim(&mut self, sheet: u32, reach: i32) -> Result<f64> {
        let (grid, state, patience) = (&self.grid, &self.state, self.patience);
        let dims = grid.dims.map(|n| n as i32);
        let is_inside = |&i: &usize| {
            let c = &grid.candidates[i];
            let at = grid.coordinates(c);
            let columns: i32 = (1..D)
                .map(|k| (c.axis as usize + k) % D)
                .map(|k| (at[k] + reach).min(dims[k] - 1) - (at[k] - reach).max(0) + 1)
                .product();
            let mut own = 0;
            grid.each_around(at, reach, |j| own += i32::from(state[j] == sheet));
            !patience.over() && f64::from(own) >= FILLED * f64::from(columns)
        };
        let mut inside: Vec<usize> = self.own_members().filter(is_inside).collect();
        inside.extend(self.told(&inside)?);
        inside.iter().for_each(|&i| self.inside[i] = true);
        let (grid, inner) = (&self.grid, &self.inside);
        let is_narrow = |&i: &usize| {
            let mut near = inner[i];
            if !near && !patience.over() {
                let at = grid.coordinates(&grid.candidates[i]);
                grid.each_around(at, reach, |j| near |= inner[j]);
            }
            !near
        };
        let mut narrow: Vec<usize> = self.own_members().filter(is_narrow).collect();
        // None is marked afterwards: sheets are many, and candidates of all of them more.
        inside.iter().for_each(|&i| self.inside[i] = false);
        narrow.extend(self.told(&narrow)?);
        narrow.iter().for_each(|&i| self.state[i] = NARROW);
        self.narrow = narrow;
        let state = &self.state;
        self.members.retain(|&i| state[i] == sheet);
        let mut left = Spread::default();
        for &i in self.members.iter().filter(|i| self.slab.own.contains(i)) {
            left.add(&self.grid.candidates[i]);
        }
        Ok(Spread(self.sums(left.0)?).area(self.step))
    }

    /// Those of the halo that other ranks mean, of whom each tells of its own.
    fn told(&self, own: &[usize]) -> Result<Vec<usize>> {
        match self.together {
            true => Ok(self.slab.tell("parts of a sheet", own)?.unwrap_or_default()),
            false => Ok(Vec::new()),
        }
    }

    /// Whether the last sheet lies in the shadow of those before it.
    fn is_shaded(&self, sheet: u32) -> Result<bool> {
        let grid = &self.grid;
        let of_another = |&i: &usize| {
            let c = &grid.candidates[i];
            let mut near = false;
            grid.each_around(grid.coordinates(c), SHADOW as i32, |j| {
                let apart = sub(grid.candidates[j].position, c.position);
                let other = self.state[j] < NARROW && self.state[j] != sheet;
                near |= other && dot(apart, apart) < SHADOW * SHADOW;
            });
            !self.patience.over() && near
        };
        let shaded = self.own_members().filter(of_another).count() as u64;
        let [shaded, all] = self.sums([shaded, self.own_members().count() as u64])?;
        Ok(shaded as f64 >= SHADED * all as f64)
    }

    /// Whether the last sheet reaches an open side.
    fn reaches(&self, open: &Open<D>) -> Result<bool> {
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
        let reaches = self.own_members().any(at_side);
        Ok(self.sums([u64::from(reaches)])? != [0])
    }

    /// Whether the sheets' points round a point lie mostly to one side of it.
    pub fn ends_at(&self, c: &Candidate<D>) -> bool {
        let (mut sum, mut count) = ([0.0f32; D], 0);
        self.grid.each_around(self.grid.coordinates(c), 1, |j| {
            let other = &self.grid.candidates[j];
            if self.state[j] < NARROW && dot(other.normal, c.normal).abs() >= SAME_NORMAL {
                count += 1;
                for k in 0..D {
                    sum[k] += other.position[k] - c.position[k];
                }
            }
        });
        // Whole neighbourhoods balance; along a straight rim the mean is a third of a sample off.
        count < 1 << (D - 1) || dot(sum, sum).sqrt() > LOPSIDED * count as f32
    }
}
