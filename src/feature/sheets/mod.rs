//! From candidates to sheets: hysteresis, resolution, no crumbs and no fringes.
//!
//! Sheets are grown one after the other, each from the strongest candidate left, over neighbouring
//! samples whose points lie in one another's planes. A sheet blocks whatever lies parallel to it and
//! nearer than a lattice can resolve, so the choice between two close parallel sheets is made once
//! for a whole sheet and not sample by sample.

//!
//! - `growth`: one sheet
//! - `seeds`: which is next, where ranks share the candidates

mod growth;
mod seeds;

use super::crossing::Candidate;
use super::slab::Slab;
use super::{FeatureKind, FeaturePoint};
use crate::error::Result;
use crate::geometry::dot;
use crate::observer::{Patience, Stage};
use crate::parallel::prelude::*;
use crate::ranks::Group;
use growth::{BLOCKED, CRUMB, FREE, Growth, NARROW};
use seeds::Seeds;
use serde::Serialize;
use std::collections::HashMap;
use std::ops::{AddAssign, Range};

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

impl<const D: usize> Rules<D> {
    /// Whether sheets may reach an open side.
    fn is_open(&self) -> bool {
        self.open.as_flattened().contains(&true)
    }
}

/// Points that were kept, of all ranks or of one of them, and what happened to the others.
#[derive(Debug, Clone)]
pub struct FoundSheets<const D: usize> {
    /// Points of all sheets, in the order of samples.
    pub points: Vec<FeaturePoint<D>>,
    /// For each point the number of its sheet, from 1.
    pub sheet: Vec<u32>,
    /// For each point, whether its sheet ends there.
    pub rim: Vec<bool>,
    /// Number of sheets, and of the points of all ranks.
    pub sheets: usize,
    pub whole: usize,
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
    /// What all ranks have, each of which has its own.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn gathered(self, group: &dyn Group) -> Result<Self> {
        if group.count() == 1 {
            return Ok(self);
        }
        let mut all = Self {
            points: Vec::with_capacity(self.whole),
            sheet: Vec::with_capacity(self.whole),
            rim: Vec::with_capacity(self.whole),
            ..self
        };
        let own = (self.points, (self.sheet, self.rim));
        for (points, (sheet, rim)) in group.all("points of sheets", own)? {
            all.points.extend(points);
            all.sheet.extend(sheet);
            all.rim.extend(rim);
        }
        Ok(all)
    }

    /// Notes what was kept of features of one kind, and what was not.
    pub fn describe(&self, kind: FeatureKind, rules: &Rules<D>, notes: &mut Vec<String>) {
        let out = &self.left_out;
        let mut note = format!(
            "{} feature points in {} sheets; left out {} nearer than {:.1} to a stronger parallel sheet, {} \
             in pieces smaller than {:.0}",
            self.whole,
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
        if self.whole == 0 {
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

/// Groups candidates (in the order of samples) into sheets that keep the rules. Ranks that share them have, if they
/// are all of some layers, `layers` of their own; each has the points that are found there.
///
/// # Errors
/// That of patience, and those of other ranks.
pub fn sheets<const D: usize>(
    dims: [usize; D],
    candidates: Vec<Candidate<D>>,
    layers: Option<Range<usize>>,
    step: [f64; D],
    rules: &Rules<D>,
    (group, patience): (&dyn Group, &Patience<'_>),
) -> Result<FoundSheets<D>> {
    let sees = growth::sees(&candidates, step, rules);
    let sees = group.all("what sheets see", sees)?;
    let halo = sees.into_iter().max().unwrap_or(0);
    let slab = Slab::new(dims, candidates, layers, halo, group)?;
    let mut growth = Growth::new(&slab, step, rules, patience);
    let kept = Seeds::new(&mut growth, rules.high).grow()?;
    let mut all: Vec<(u64, u32)> = group.all("sheets", kept)?.concat();
    all.sort_unstable();
    let number: HashMap<u32, u32> = (1..).zip(&all).map(|(to, &(_, from))| (from, to)).collect();
    let mut states = [0; 5];
    for state in &growth.state[slab.own.clone()] {
        states[match *state {
            CRUMB => 0,
            NARROW => 1,
            BLOCKED => 2,
            FREE => 3,
            _ => 4,
        }] += 1;
    }
    let states = slab.sums("points of sheets", states)?;
    let [
        in_small_pieces,
        in_narrow_parts,
        near_another_sheet,
        weak,
        whole,
    ] = states.map(|n| n as usize);
    let kept = slab.own.clone().into_par_iter();
    let kept: Vec<usize> = kept.filter(|&i| growth.state[i] < NARROW).collect();
    let kept = || kept.par_iter().map(|&i| (i, &slab.candidates[i]));
    let ends = |c: &Candidate<D>| !patience.over() && growth.ends_at(c);
    let own = FoundSheets {
        whole,
        points: kept().map(|(_, c)| lattice_point(c, step)).collect(),
        sheet: kept().map(|(i, _)| number[&growth.state[i]]).collect(),
        rim: kept().map(|(_, c)| ends(c)).collect(),
        sheets: all.len(),
        left_out: LeftOut {
            near_another_sheet,
            in_small_pieces,
            in_narrow_parts,
            weak,
        },
    };
    patience.lasts(Stage::Features)?;
    Ok(own)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::volume::Volume;
    use crate::geometry::random::Random;
    use crate::geometry::unit;
    use crate::ranks::{Alone, share_of, shared};

    fn alone(
        dims: [usize; 3],
        step: [f64; 3],
        candidates: Vec<Candidate<3>>,
        rules: &Rules<3>,
    ) -> FoundSheets<3> {
        let among = (&Alone as &dyn Group, &Patience::endless());
        sheets(dims, candidates, None, step, rules, among).unwrap()
    }

    /// Sheets that cross, run close and bend, the more of them the more seeds there are, and noise.
    fn network(dims: [usize; 3], seed: u64) -> Vec<Candidate<3>> {
        let mut random = Random::new(seed);
        let mut all = Vec::new();
        let space = Volume::new(dims, &[]);
        let mut planes = Vec::new();
        for _ in 0..6 {
            let normal = unit([1.0, random.range(-0.6, 0.6), random.range(-0.6, 0.6)]);
            let middle = dims.map(|n| random.range(0.2, 0.8) * n as f64);
            let (strength, wave) = (random.range(0.6, 1.4), random.range(0.0, 2.0));
            planes.push((normal, middle, strength, wave));
            let beside = [middle[0] + 2.4, middle[1], middle[2]];
            planes.push((normal, beside, random.range(0.8, 1.1) * strength, wave));
        }
        for (normal, middle, strength, wave) in planes {
            for i in 0..dims[1] * dims[2] {
                let at = [0, i % dims[1], i / dims[1]];
                let away = [1, 2].map(|k| normal[k] * (at[k] as f64 - middle[k]));
                let bend = wave * (at[2] as f64 / 7.0).sin();
                let x = middle[0] + bend - (away[0] + away[1]) / normal[0];
                if x > 0.0 && x < dims[0] as f64 - 1.0 && random.range(0.0, 1.0) > 0.07 {
                    let at = [x.round() as usize, at[1], at[2]];
                    let strength = (strength * random.range(0.7, 1.0)) as f32;
                    let off = (x - x.round()) as f32;
                    all.push(Candidate::new(dims, at, 0, off, normal, strength));
                }
            }
        }
        for _ in 0..space.dims.iter().product::<usize>() / 40 {
            let at = dims.map(|n| random.range(0.0, n as f64) as usize);
            let normal = unit([1.0, random.range(-0.5, 0.5), random.range(-0.5, 0.5)]);
            let strength = random.range(0.3, 1.2) as f32;
            all.push(Candidate::new(dims, at, 0, 0.0, normal, strength));
        }
        all.sort_by_key(|c| c.voxel);
        all
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn ranks_that_share_candidates_find_the_sheets_of_one() {
        let dims = [30, 26, 64];
        let (mut number, mut left_out) = (0, LeftOut::default());
        for (seed, min_area, least_width, open) in [
            (1, 40.0, 0, false),
            (2, 12.0, 4, false),
            (3, 0.0, 0, false),
            (4, 30.0, 6, true),
        ] {
            let candidates = network(dims, seed);
            let rules = Rules {
                high: 0.7,
                agreement: if seed == 2 { BLUNT } else { SHARP },
                resolution: 3.0,
                min_area,
                sure: 0.2,
                least_width,
                open: [[open; 2], [false; 2], [false; 2]],
            };
            let step = [1.0, 1.2, 0.8];
            let one = alone(dims, step, candidates.clone(), &rules);
            number += one.sheets;
            left_out += one.left_out;
            for count in [2, 3, 5] {
                let found = shared(count, |group| {
                    let own = share_of(dims[2], group.rank(), count);
                    let layer = |c: &Candidate<3>| c.voxel.index() / (dims[0] * dims[1]);
                    let given = candidates.iter().copied();
                    let (given, own) = match seed % 2 {
                        0 => (
                            given.filter(|c| own.contains(&layer(c))).collect(),
                            Some(own),
                        ),
                        _ => (given.collect(), None),
                    };
                    let among = (group, &Patience::endless());
                    let found = sheets(dims, given, own, step, &rules, among).unwrap();
                    assert_eq!(found.whole, one.points.len());
                    found.gathered(group).unwrap()
                });
                for found in found {
                    assert_eq!((found.sheets, found.left_out), (one.sheets, one.left_out));
                    assert!(found.points == one.points && found.sheet == one.sheet);
                    assert!(found.rim == one.rim, "{seed} {count}");
                }
            }
        }
        // There is something of everything.
        let LeftOut {
            near_another_sheet,
            in_small_pieces,
            in_narrow_parts,
            weak,
        } = left_out;
        let figures = [
            (number, 30),
            (near_another_sheet, 1000),
            (in_small_pieces, 1000),
            (in_narrow_parts, 30),
            (weak, 1000),
        ];
        assert!(figures.iter().all(|(is, least)| is >= least), "{figures:?}");
    }

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
            alone(dims, [1.0; 3], candidates.clone(), &rules)
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
            let found = alone(dims, [1.0; 3], candidates.clone(), &rules);
            (found.sheets, found.left_out.in_small_pieces)
        };
        let (sheets, crumbs) = found(1.7);
        assert_eq!(sheets, 1);
        assert!(crumbs > 60, "{crumbs}");
        assert_eq!(found(4.0).0, 2);
    }
}
