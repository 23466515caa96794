//! From candidates to sheets: hysteresis, resolution, no crumbs and no fringes.
//!
//! Sheets are grown one after the other, each from the strongest candidate left, over neighbouring
//! samples whose points lie in one another's planes. A sheet blocks whatever lies parallel to it and
//! nearer than a lattice can resolve, so the choice between two close parallel sheets is made once
//! for a whole sheet and not sample by sample.

use super::by_sample::BySample;
use super::crossing::{Candidate, nearest};
use super::{FeatureKind, FeaturePoint};
use crate::geometry::{dot, sub};
use crate::observer::Patience;
use rayon::prelude::*;
use serde::Serialize;
use std::ops::{AddAssign, Range};

/// No sheet.
const FREE: u32 = u32::MAX;

/// Along each axis, whether the image goes on beyond its low and its high side: true for the sides
/// along which a part was cut from a larger image.
pub type Open<const D: usize> = [[bool; 2]; D];

/// What a sheet must be.
#[derive(Debug, Clone, Copy)]
pub struct Rules<const D: usize> {
    /// A sheet has at least one point as strong as this.
    pub high: f32,
    /// Which points make one sheet.
    pub agreement: Agreement,
    /// Parallel sheets nearer than this (lattice units) exclude one another.
    pub resolution: f64,
    /// A sheet covers at least this area (lattice units squared; in 2-D this length).
    pub min_area: f64,
    /// At least this share of a sheet is as strong as `high`, if it is not [`ENOUGH`]: what noise makes has a
    /// few strong points, from which weak ones are followed.
    pub sure: f64,
    /// Parts of a sheet that are narrower than about this (samples) are left out; 0 if any width will do.
    pub least_width: usize,
    /// A sheet that reaches an open side may be larger than what is seen of it, and is not judged by
    /// its area.
    pub open: Open<D>,
}

/// Points that were kept, and what happened to the others.
#[derive(Debug, Clone)]
pub struct FoundSheets<const D: usize> {
    /// Points of all sheets, in the order of samples.
    pub points: Vec<FeaturePoint<D>>,
    /// For each point the number of its sheet, from 1.
    pub sheet: Vec<u32>,
    /// For each point, whether its sheet ends there.
    pub rim: Vec<bool>,
    /// Number of sheets.
    pub sheets: usize,
    /// What became of the other points.
    pub left_out: LeftOut,
}

/// Points that were found and are not followed, by the reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Parallel to a stronger sheet, and nearer to it than the finest spacing resolves.
    pub near_another_sheet: usize,
    /// In pieces that are too small.
    pub in_small_pieces: usize,
    /// In parts of sheets that are too narrow.
    pub in_narrow_parts: usize,
    /// Weak, and not followed from anything strong.
    pub weak: usize,
}

impl AddAssign for LeftOut {
    fn add_assign(&mut self, other: Self) {
        self.near_another_sheet += other.near_another_sheet;
        self.in_small_pieces += other.in_small_pieces;
        self.in_narrow_parts += other.in_narrow_parts;
        self.weak += other.weak;
    }
}

impl<const D: usize> FoundSheets<D> {
    /// Notes what was kept of features of one kind, and what was not.
    pub fn describe(&self, kind: FeatureKind, rules: &Rules<D>, notes: &mut Vec<String>) {
        let out = &self.left_out;
        let mut note = format!(
            "{} feature points in {} sheets; left out {} nearer than {:.1} to a stronger parallel sheet, {} \
             in pieces smaller than {:.0}",
            self.points.len(),
            self.sheets,
            out.near_another_sheet,
            rules.resolution,
            out.in_small_pieces,
            rules.min_area,
        );
        if rules.least_width > 0 {
            let (count, width) = (out.in_narrow_parts, rules.least_width);
            note += &format!(", {count} in parts narrower than {width} samples");
        }
        notes.push(note + &format!(" and {} weak", out.weak));
        if self.points.is_empty() {
            notes.push(format!(
                "NO FEATURE ({kind}) was found, so the mesh follows none: try another kind of \
                 feature or a lower threshold"
            ));
        }
    }
}

/// When points are of one sheet, and when sheets are parallel.
#[derive(Debug, Clone, Copy)]
pub struct Agreement {
    /// Neighbours belong to one sheet if their normals agree at least this much (cosine) ...
    normal: f32,
    /// ... and each is off the other's plane by less than this (samples).
    plane: f32,
    /// Sheets whose normals agree at least this much (cosine) are parallel; others cross.
    parallel: f32,
}

/// Where normals are off by more than ten degrees here and there.
pub const BLUNT: Agreement = Agreement {
    normal: 0.8,
    plane: 1.0,
    parallel: 0.9,
};
/// Where normals are known to a few degrees: sheets may cross at 15 degrees.
pub const SHARP: Agreement = Agreement {
    normal: 0.97,
    plane: 0.6,
    parallel: 0.985,
};

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

/// So many members look round together ...
const ROUND: usize = 1 << 12;
/// ... so many at a time.
const SOME: usize = 64;

/// In a piece that is too small ...
const CRUMB: u32 = u32::MAX - 1;
/// ... and in a part that is too narrow.
const NARROW: u32 = u32::MAX - 2;
/// A place is inside a sheet that fills this share of the columns round it. Along a straight rim half
/// are filled: it is kept for what is inside beside it.
const FILLED: f64 = 0.8;

/// Groups candidates (in the order of samples) into sheets that keep the rules.
pub fn sheets<const D: usize>(
    dims: [usize; D],
    candidates: &[Candidate<D>],
    step: [f64; D],
    rules: &Rules<D>,
    patience: &Patience<'_>,
) -> FoundSheets<D> {
    let grid = BySample::new(dims, candidates);
    let mut growth = Growth {
        grid: &grid,
        step: step.map(|h| h as f32),
        agreement: rules.agreement,
        resolution: rules.resolution as f32,
        owner: vec![FREE; candidates.len()],
        blocker: vec![FREE; candidates.len()],
        members: Vec::new(),
        blocked: Vec::new(),
        looks: Vec::new(),
        inside: match rules.least_width {
            0 => Vec::new(),
            _ => vec![false; candidates.len()],
        },
    };
    let mut sheets = 0;
    for seed in by_strength(candidates) {
        if candidates[seed].strength < rules.high || patience.over() {
            break;
        }
        if growth.owner[seed] == FREE && growth.blocker[seed] == FREE {
            let [mut area, sure] = growth.grow(seed, sheets as u32, rules.high, patience);
            let large = ENOUGH * rules.min_area;
            let unsure = sure < (rules.sure * area).min(large)
                || area < large && growth.shaded(sheets as u32, patience);
            if rules.least_width > 0 && area >= rules.min_area {
                area = growth.trim(sheets as u32, rules.least_width as i32 / 2, patience);
            }
            if (area < rules.min_area || unsure) && !growth.reaches(&rules.open) {
                growth.give_up();
            } else {
                sheets += 1;
            }
        }
    }
    let (mut left_out, mut kept) = (LeftOut::default(), Vec::new());
    for (i, owner) in growth.owner.iter().enumerate() {
        match *owner {
            CRUMB => left_out.in_small_pieces += 1,
            NARROW => left_out.in_narrow_parts += 1,
            FREE if growth.blocker[i] != FREE => left_out.near_another_sheet += 1,
            FREE => left_out.weak += 1,
            _ => kept.push(i),
        }
    }
    let kept = || kept.par_iter().map(|&i| (i, &candidates[i]));
    FoundSheets {
        points: kept().map(|(_, c)| lattice_point(c, step)).collect(),
        sheet: kept().map(|(i, _)| growth.owner[i] + 1).collect(),
        rim: kept()
            .map(|(_, c)| !patience.over() && growth.ends_at(c))
            .collect(),
        sheets,
        left_out,
    }
}

/// Indices of candidates, strongest first, in 4096 logarithmic classes; ties in the order of samples.
fn by_strength<const D: usize>(candidates: &[Candidate<D>]) -> Vec<usize> {
    // The bits of a positive float sort like the float; the upper ones are class enough.
    let class = |c: &Candidate<D>| (c.strength.max(0.0).to_bits() >> 19) as usize;
    let top = 4095;
    let mut start = vec![0usize; top + 1];
    for c in candidates {
        start[top - class(c)] += 1;
    }
    let mut sum = 0;
    for s in &mut start {
        (*s, sum) = (sum, sum + *s);
    }
    let mut order = vec![0; candidates.len()];
    for (i, c) in candidates.iter().enumerate() {
        let slot = &mut start[top - class(c)];
        order[*slot] = i;
        *slot += 1;
    }
    order
}

/// A candidate in lattice space: positions scale with the step, normals against it.
fn lattice_point<const D: usize>(c: &Candidate<D>, step: [f64; D]) -> FeaturePoint<D> {
    let position = std::array::from_fn(|k| c.position[k] * step[k] as f32);
    let normal: [f32; D] = std::array::from_fn(|k| c.normal[k] / step[k] as f32);
    let length = dot(normal, normal).sqrt();
    FeaturePoint {
        position,
        normal: normal.map(|n| n / length),
        strength: c.strength,
    }
}

/// One sheet after the other.
struct Growth<'a, const D: usize> {
    grid: &'a BySample<'a, D>,
    step: [f32; D],
    agreement: Agreement,
    resolution: f32,
    owner: Vec<u32>,
    blocker: Vec<u32>,
    members: Vec<usize>,
    blocked: Vec<usize>,
    /// Scratch.
    looks: Vec<Look>,
    /// For each candidate, while its sheet is trimmed, whether it is inside.
    inside: Vec<bool>,
}

/// What [`SOME`] members of a sheet, one after the other, may block and take.
#[derive(Default)]
struct Look {
    beside: Vec<u32>,
    joined: Vec<u32>,
    /// Where what is of each member ends.
    ends: Vec<[usize; 2]>,
}

impl Look {
    fn clear(&mut self) {
        self.beside.clear();
        self.joined.clear();
        self.ends.clear();
    }

    /// What is beside each member, and what is joined to it.
    fn each(&self) -> impl Iterator<Item = (&[u32], &[u32])> {
        let starts = std::iter::once([0; 2]).chain(self.ends.iter().copied());
        let ranges = starts.zip(&self.ends);
        ranges.map(|(start, end)| {
            let (beside, joined) = (start[0]..end[0], start[1]..end[1]);
            (&self.beside[beside], &self.joined[joined])
        })
    }
}

impl<const D: usize> Growth<'_, D> {
    /// Grows the sheet of `seed`; returns its area in square lattice units, and the area of what is as strong
    /// as `high` of it.
    fn grow(&mut self, seed: usize, sheet: u32, high: f32, patience: &Patience<'_>) -> [f64; 2] {
        self.members.clear();
        self.blocked.clear();
        self.members.push(seed);
        self.owner[seed] = sheet;
        let (mut area, mut sure) = (0.0, 0.0);
        let mut next = 0;
        while next < self.members.len() && !patience.over() {
            let end = self.members.len().min(next + ROUND);
            let looks = self.look_round(next..end, sheet);
            let seen = looks.iter().flat_map(Look::each);
            for (n, (beside, joined)) in (next..end).zip(seen) {
                let c = &self.grid.candidates[self.members[n]];
                area += self.area_of(c);
                if c.strength >= high {
                    sure += self.area_of(c);
                }
                self.block(beside, sheet);
                self.take(joined, sheet);
            }
            self.looks = looks;
            next = end;
        }
        [area, sure]
    }

    /// The area, in square lattice units, of what a sheet has in one column.
    fn area_of(&self, c: &Candidate<D>) -> f64 {
        let axis = c.axis as usize;
        let cell: f32 = (1..D).map(|k| self.step[(axis + k) % D]).product();
        f64::from(cell / c.normal[axis].abs())
    }

    /// Takes from the last sheet what is farther than `reach` samples from all places that are inside it
    /// (an opening, in the terms of morphology); returns the area that is left.
    fn trim(&mut self, sheet: u32, reach: i32, patience: &Patience<'_>) -> f64 {
        let grid = self.grid;
        let (dims, owner) = (grid.dims.map(|n| n as i32), &self.owner);
        let is_inside = |&i: &usize| {
            let c = &grid.candidates[i];
            let at = grid.coordinates(c);
            let columns: i32 = (1..D)
                .map(|k| (c.axis as usize + k) % D)
                .map(|k| (at[k] + reach).min(dims[k] - 1) - (at[k] - reach).max(0) + 1)
                .product();
            let mut own = 0;
            grid.each_around(at, reach, |j| own += i32::from(owner[j] == sheet));
            !patience.over() && f64::from(own) >= FILLED * f64::from(columns)
        };
        let inside: Vec<bool> = self.members.par_iter().map(is_inside).collect();
        for (&i, inside) in self.members.iter().zip(inside) {
            self.inside[i] = inside;
        }
        let is_wide = |&i: &usize| {
            let mut near = self.inside[i];
            if !near && !patience.over() {
                let at = grid.coordinates(&grid.candidates[i]);
                grid.each_around(at, reach, |j| near |= self.inside[j]);
            }
            near
        };
        let members = self.members.par_iter().copied();
        let (left, narrow): (Vec<usize>, Vec<usize>) = members.partition(is_wide);
        // None is marked afterwards: sheets are many, and candidates of all of them more.
        self.members.iter().for_each(|&i| self.inside[i] = false);
        for i in narrow {
            self.owner[i] = NARROW;
        }
        self.members = left;
        self.members
            .iter()
            .map(|&i| self.area_of(&grid.candidates[i]))
            .sum()
    }

    /// Whether the last sheet lies in the shadow of those before it.
    fn shaded(&self, sheet: u32, patience: &Patience<'_>) -> bool {
        let of_another = |&i: &usize| {
            let c = &self.grid.candidates[i];
            let mut near = false;
            self.grid
                .each_around(self.grid.coordinates(c), SHADOW as i32, |j| {
                    let apart = sub(self.grid.candidates[j].position, c.position);
                    near |= self.owner[j] < sheet && dot(apart, apart) < SHADOW * SHADOW;
                });
            !patience.over() && near
        };
        let shaded = self.members.par_iter().filter(|i| of_another(i)).count();
        shaded as f64 >= SHADED * self.members.len() as f64
    }

    /// Whether the last sheet reaches an open side.
    fn reaches(&self, open: &Open<D>) -> bool {
        self.members.iter().any(|&i| {
            let at = self.grid.coordinates(&self.grid.candidates[i]);
            (0..D).any(|k| {
                let last = self.grid.dims[k] as i32 - 1;
                open[k][0] && at[k] <= 1 || open[k][1] && at[k] >= last - 1
            })
        })
    }

    /// What some members of the sheet may block and take as things are, found by all threads: what is not free
    /// meanwhile does not become free again while the sheet grows.
    fn look_round(&mut self, members: Range<usize>, sheet: u32) -> Vec<Look> {
        let mut looks = std::mem::take(&mut self.looks);
        looks.resize_with(members.len().div_ceil(SOME), Look::default);
        let members = &self.members[members];
        let fill = |(look, members): (&mut Look, &[usize])| {
            look.clear();
            for &i in members {
                self.parallel_to(i, &mut look.beside);
                self.joined_to(i, sheet, &mut look.joined);
                look.ends.push([look.beside.len(), look.joined.len()]);
            }
        };
        match members.len() {
            ..=SOME => looks.iter_mut().zip(members.chunks(SOME)).for_each(fill),
            _ => (looks.par_iter_mut().zip(members.par_chunks(SOME))).for_each(fill),
        }
        looks
    }

    /// Whether a candidate is of no sheet and not blocked.
    fn is_free(&self, i: usize) -> bool {
        self.owner[i] == FREE && self.blocker[i] == FREE
    }

    /// Takes those free candidates that continue the sheet, if there are enough: a sheet does not spread over
    /// bridges a sample or two wide.
    fn take(&mut self, joined: &[u32], sheet: u32) {
        let joined = || joined.iter().map(|&j| j as usize);
        let ours = joined().filter(|&j| self.owner[j] == sheet || self.is_free(j));
        if ours.count() < core(D) {
            return;
        }
        for j in joined() {
            if self.is_free(j) {
                self.owner[j] = sheet;
                self.members.push(j);
            }
        }
    }

    /// Blocks those free candidates.
    fn block(&mut self, beside: &[u32], sheet: u32) {
        for o in beside.iter().map(|&o| o as usize) {
            if self.is_free(o) {
                self.blocker[o] = sheet;
                self.blocked.push(o);
            }
        }
    }

    /// Adds the candidates of the 26 neighbouring samples that continue the sheet.
    fn joined_to(&self, i: usize, sheet: u32, joined: &mut Vec<u32>) {
        let grid = self.grid;
        let c = &grid.candidates[i];
        grid.each_around(grid.coordinates(c), 1, |j| {
            if j == i || !(self.is_free(j) || self.owner[j] == sheet) {
                return;
            }
            let other = &grid.candidates[j];
            let apart = sub(other.position, c.position);
            let continues = dot(other.normal, c.normal).abs() >= self.agreement.normal
                && dot(apart, c.normal).abs() < self.agreement.plane
                && dot(apart, other.normal).abs() < self.agreement.plane;
            if continues {
                joined.push(j as u32);
            }
        });
    }

    /// Adds the free candidates parallel to candidate `i` on either side of it, along its normal.
    fn parallel_to(&self, i: usize, beside: &mut Vec<u32>) {
        let grid = self.grid;
        let c = &grid.candidates[i];
        let at = grid.coordinates(c);
        let axis = c.axis as usize;
        // Samples passed along each axis per lattice unit along the lattice-space normal.
        let scaled: [f32; D] = std::array::from_fn(|k| c.normal[k] / self.step[k]);
        let unit = 1.0 / dot(scaled, scaled).sqrt();
        let speed: [f32; D] = std::array::from_fn(|k| scaled[k] * unit / self.step[k]);
        let slope = speed.map(|s| s / speed[axis]);
        let reach = (self.resolution * speed[axis].abs()).ceil() as i32;
        for j in (-reach..=reach).filter(|j| j.abs() > 1) {
            let column = std::array::from_fn(|k| at[k] + nearest(j as f32 * slope[k]));
            grid.each(column, |o| {
                if !self.is_free(o) {
                    return;
                }
                let other = &grid.candidates[o];
                let across = dot(sub(other.position, c.position), c.normal).abs();
                if dot(other.normal, c.normal).abs() >= self.agreement.parallel
                    && across > TOGETHER
                    && across * unit < self.resolution
                {
                    beside.push(o as u32);
                }
            });
        }
    }

    /// Whether the sheets' points round a point lie mostly to one side of it.
    fn ends_at(&self, c: &Candidate<D>) -> bool {
        let (mut sum, mut count) = ([0.0f32; D], 0);
        self.grid.each_around(self.grid.coordinates(c), 1, |j| {
            let other = &self.grid.candidates[j];
            if self.owner[j] < NARROW && dot(other.normal, c.normal).abs() >= SAME_NORMAL {
                count += 1;
                for k in 0..D {
                    sum[k] += other.position[k] - c.position[k];
                }
            }
        });
        // Whole neighbourhoods balance; along a straight rim the mean is a third of a sample off.
        count < 1 << (D - 1) || dot(sum, sum).sqrt() > LOPSIDED * count as f32
    }

    /// Undoes the last sheet: its points are crumbs, and what it blocked is free again.
    fn give_up(&mut self) {
        for &i in &self.members {
            self.owner[i] = CRUMB;
        }
        for &i in &self.blocked {
            self.blocker[i] = FREE;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_out_is_counted_by_the_reason() {
        let dims = [30, 50, 40];
        // At x = 15 a square with a strip two samples wide; a weaker square two samples beside it; far
        // off a small piece and a weak point.
        let mut places: Vec<([usize; 3], f32)> = Vec::new();
        for z in 5..35 {
            for y in 0..50 {
                let of_square = y < 30;
                let of_strip = (19..21).contains(&z);
                if of_square || of_strip {
                    places.push(([15, y, z], 1.0));
                }
                if of_square {
                    places.push(([17, y, z], 0.8));
                }
                if (8..12).contains(&z) && (40..44).contains(&y) {
                    places.push(([3, y, z], 0.9));
                }
            }
        }
        places.push(([27, 40, 30], 0.2));
        // The first sheet starts inside.
        for (at, strength) in &mut places {
            if *at == [15, 15, 20] {
                *strength = 1.5;
            }
        }
        places.sort_by_key(|(at, _)| (at[2], at[1], at[0]));
        let candidates: Vec<Candidate<3>> = places
            .iter()
            .map(|&(at, strength)| Candidate::new(dims, at, 0, 0.0, [1.0, 0.0, 0.0], strength))
            .collect();
        let found = |least_width| {
            let rules = Rules {
                high: 0.5,
                agreement: BLUNT,
                resolution: 3.0,
                min_area: 50.0,
                sure: 0.0,
                least_width,
                open: [[false; 2]; 3],
            };
            sheets(dims, &candidates, [1.0; 3], &rules, &Patience::endless())
        };
        let out = LeftOut {
            near_another_sheet: 900,
            in_small_pieces: 16,
            in_narrow_parts: 0,
            weak: 1,
        };
        let any_width = found(0);
        assert_eq!(
            (any_width.points.len(), any_width.left_out),
            (900 + 40, out)
        );
        // What is within four samples of the square's inside is kept.
        let trimmed = found(8);
        let narrow = trimmed.left_out.in_narrow_parts;
        assert!((30..=40).contains(&narrow), "{narrow}");
        assert_eq!(trimmed.points.len(), 900 + 40 - narrow);
    }

    #[test]
    fn a_small_sheet_in_the_shadow_of_a_stronger_one_is_none() {
        let dims = [30, 40, 40];
        // At x = 15 a square; across its rim a piece that is turned by 22 degrees, up to `far` samples off it.
        let found = |far: f64| {
            let mut places: Vec<([usize; 3], f32, [f64; 3], f32)> = Vec::new();
            let (sin, cos) = 22.0f64.to_radians().sin_cos();
            for z in 5..35 {
                for y in 5..35 {
                    places.push(([15, y, z], 0.0, [1.0, 0.0, 0.0], 1.0));
                    let off = (y as f64 - 24.0) * sin / cos;
                    if y >= 20 && off <= far && off.abs() > 0.6 {
                        let x = 15.0 + off;
                        let at = [x.round() as usize, y, z];
                        places.push((at, (x - x.round()) as f32, [cos, -sin, 0.0], 0.9));
                    }
                }
            }
            places.sort_by_key(|p| (p.0[2], p.0[1], p.0[0]));
            let candidates: Vec<Candidate<3>> = places
                .iter()
                .map(|&(at, off, normal, strength)| {
                    Candidate::new(dims, at, 0, off, normal, strength)
                })
                .collect();
            let rules = Rules {
                high: 0.5,
                agreement: SHARP,
                resolution: 3.0,
                min_area: 60.0,
                sure: 0.0,
                least_width: 0,
                open: [[false; 2]; 3],
            };
            let found = sheets(dims, &candidates, [1.0; 3], &rules, &Patience::endless());
            (found.sheets, found.left_out.in_small_pieces)
        };
        let (sheets, crumbs) = found(1.7);
        assert_eq!(sheets, 1);
        assert!(crumbs > 60, "{crumbs}");
        assert_eq!(found(4.0).0, 2);
    }
}
