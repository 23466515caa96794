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

use super::candidate::Candidate;
use super::candidate_slab::CandidateSlab;
use super::{FeatureKind, FeaturePoint};
use crate::comm::Comm;
use crate::error::Result;
use crate::geometry::dot;
use crate::parallel::prelude::*;
use crate::progress::{CancelToken, Stage};
use growth::{BLOCKED, FRAGMENT, NARROW, SurfaceGrowth, UNASSIGNED};
use seeds::SeedQueue;
use serde::Serialize;
use std::collections::HashMap;
use std::ops::{AddAssign, Range};

/// Along each axis, whether the image goes on beyond its low and its high side: true for the sides
/// along which a part was cut from a larger image.
pub type OpenSides<const D: usize> = [[bool; 2]; D];

/// What a sheet must be.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceRules<const D: usize> {
    /// A sheet has at least one point as strong as this.
    pub high: f32,
    /// Which points make one sheet.
    pub agreement: Agreement,
    /// Parallel sheets nearer than this (lattice units) exclude one another.
    pub resolution: f64,
    /// A sheet covers at least this area (lattice units squared; in 2-D this length).
    pub min_area: f64,
    /// At least this share of a sheet is as strong as `high`, if it is not [`STRONG_AREA_RATIO`]: what noise makes has a
    /// few strong points, from which weak ones are followed.
    pub min_strong_share: f64,
    /// Parts of a sheet that are narrower than about this (samples) are left out; 0 if any width will do.
    pub min_width: usize,
    /// A sheet that reaches an open side may be larger than what is seen of it, and is not judged by
    /// its area.
    pub open_sides: OpenSides<D>,
}

impl<const D: usize> SurfaceRules<D> {
    /// Whether sheets may reach an open side.
    fn is_open(&self) -> bool {
        self.open_sides.as_flattened().contains(&true)
    }
}

/// Points that were kept, of all ranks or of one of them, and what happened to the others.
#[derive(Debug, Clone)]
pub struct FeatureSurfaces<const D: usize> {
    /// Points of all sheets, in the order of samples.
    pub points: Vec<FeaturePoint<D>>,
    /// For each point the number of its sheet, from 1.
    pub surface: Vec<u32>,
    /// For each point, whether its sheet ends there.
    pub is_rim: Vec<bool>,
    /// Number of sheets, and of the points of all ranks.
    pub surface_count: usize,
    pub total_points: usize,
    /// What became of the other points.
    pub dropped: DroppedPoints,
}

/// Points that were found and are not followed, by the reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct DroppedPoints {
    /// Parallel to a stronger sheet, and nearer to it than the finest spacing resolves.
    pub near_another_surface: usize,
    /// In pieces that are too small.
    pub in_small_pieces: usize,
    /// In parts of sheets that are too narrow.
    pub in_narrow_parts: usize,
    /// Weak, and not followed from anything strong.
    pub weak: usize,
}

impl AddAssign for DroppedPoints {
    fn add_assign(&mut self, other: Self) {
        self.near_another_surface += other.near_another_surface;
        self.in_small_pieces += other.in_small_pieces;
        self.in_narrow_parts += other.in_narrow_parts;
        self.weak += other.weak;
    }
}

impl<const D: usize> FeatureSurfaces<D> {
    /// What all ranks have, each of which has its own.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn gather(self, group: &dyn Comm) -> Result<Self> {
        if group.size() == 1 {
            return Ok(self);
        }
        let mut all = Self {
            points: Vec::with_capacity(self.total_points),
            surface: Vec::with_capacity(self.total_points),
            is_rim: Vec::with_capacity(self.total_points),
            ..self
        };
        let own = (self.points, (self.surface, self.is_rim));
        for (points, (sheet, rim)) in group.all_gather("points of sheets", own)? {
            all.points.extend(points);
            all.surface.extend(sheet);
            all.is_rim.extend(rim);
        }
        Ok(all)
    }

    /// Notes what was kept of features of one kind, and what was not.
    pub fn describe(&self, kind: FeatureKind, rules: &SurfaceRules<D>, notes: &mut Vec<String>) {
        let out = &self.dropped;
        let mut note = format!(
            "{} feature points in {} sheets; left out {} nearer than {:.1} to a stronger parallel sheet, {} \
             in pieces smaller than {:.0}",
            self.total_points,
            self.surface_count,
            out.near_another_surface,
            rules.resolution,
            out.in_small_pieces,
            rules.min_area,
        );
        if rules.min_width > 0 {
            let (count, width) = (out.in_narrow_parts, rules.min_width);
            note += &format!(", {count} in parts narrower than {width} samples");
        }
        notes.push(note + &format!(" and {} weak", out.weak));
        if self.total_points == 0 {
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
    min_normal_cosine: f32,
    /// ... and each is off the other's plane by less than this (samples).
    max_plane_distance: f32,
    /// Sheets whose normals agree at least this much (cosine) are parallel; others cross.
    min_parallel_cosine: f32,
}

/// Where normals are off by more than ten degrees here and there.
pub const BLUNT_NORMALS: Agreement = Agreement {
    min_normal_cosine: 0.8,
    max_plane_distance: 1.0,
    min_parallel_cosine: 0.9,
};
/// Where normals are known to a few degrees: sheets may cross at 15 degrees.
pub const SHARP_NORMALS: Agreement = Agreement {
    min_normal_cosine: 0.97,
    max_plane_distance: 0.6,
    min_parallel_cosine: 0.985,
};

/// Groups candidates (in the order of samples) into sheets that keep the rules. Ranks that share them have, if they
/// are all of some layers, `layers` of their own; each has the points that are found there.
///
/// # Errors
/// That of patience, and those of other ranks.
pub fn extract_surfaces<const D: usize>(
    dims: [usize; D],
    candidates: Vec<Candidate<D>>,
    layers: Option<Range<usize>>,
    step: [f64; D],
    rules: &SurfaceRules<D>,
    (group, patience): (&dyn Comm, &CancelToken<'_>),
) -> Result<FeatureSurfaces<D>> {
    let sees = growth::halo_layers(&candidates, step, rules);
    let sees = group.all_gather("what sheets see", sees)?;
    let halo = sees.into_iter().max().unwrap_or(0);
    let slab = CandidateSlab::new(dims, candidates, layers, halo, group)?;
    let mut growth = SurfaceGrowth::new(&slab, step, rules, patience);
    let kept = SeedQueue::new(&mut growth, rules.high).grow_all()?;
    let mut all: Vec<(u64, u32)> = group.all_gather("sheets", kept)?.concat();
    all.sort_unstable();
    let number: HashMap<u32, u32> = (1..).zip(&all).map(|(to, &(_, from))| (from, to)).collect();
    let mut states = [0; 5];
    for state in &growth.state[slab.owned.clone()] {
        states[match *state {
            FRAGMENT => 0,
            NARROW => 1,
            BLOCKED => 2,
            UNASSIGNED => 3,
            _ => 4,
        }] += 1;
    }
    let states = slab.global_sums("points of sheets", states)?;
    let [
        in_small_pieces,
        in_narrow_parts,
        near_another_sheet,
        weak,
        whole,
    ] = states.map(|n| n as usize);
    let kept = slab.owned.clone().into_par_iter();
    let kept: Vec<usize> = kept.filter(|&i| growth.state[i] < NARROW).collect();
    let kept = || kept.par_iter().map(|&i| (i, &slab.candidates[i]));
    let ends = |c: &Candidate<D>| !patience.is_cancelled() && growth.is_rim_at(c);
    let own = FeatureSurfaces {
        total_points: whole,
        points: kept().map(|(_, c)| to_lattice_space(c, step)).collect(),
        surface: kept().map(|(i, _)| number[&growth.state[i]]).collect(),
        is_rim: kept().map(|(_, c)| ends(c)).collect(),
        surface_count: all.len(),
        dropped: DroppedPoints {
            near_another_surface: near_another_sheet,
            in_small_pieces,
            in_narrow_parts,
            weak,
        },
    };
    patience.check(Stage::Features)?;
    Ok(own)
}

/// A candidate in lattice space: positions scale with the step, normals against it.
fn to_lattice_space<const D: usize>(c: &Candidate<D>, step: [f64; D]) -> FeaturePoint<D> {
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
    use crate::comm::{SelfComm, partition_range, run_threads};
    use crate::feature::volume::Volume;
    use crate::geometry::random::Random;
    use crate::geometry::unit;

    fn extract_on_one_rank(
        dims: [usize; 3],
        step: [f64; 3],
        candidates: Vec<Candidate<3>>,
        rules: &SurfaceRules<3>,
    ) -> FeatureSurfaces<3> {
        let among = (&SelfComm as &dyn Comm, &CancelToken::never());
        extract_surfaces(dims, candidates, None, step, rules, among).unwrap()
    }

    /// Sheets that cross, run close and bend, the more of them the more seeds there are, and noise.
    fn surface_network(dims: [usize; 3], seed: u64) -> Vec<Candidate<3>> {
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
        let (mut number, mut left_out) = (0, DroppedPoints::default());
        for (seed, min_area, least_width, open) in [
            (1, 40.0, 0, false),
            (2, 12.0, 4, false),
            (3, 0.0, 0, false),
            (4, 30.0, 6, true),
        ] {
            let candidates = surface_network(dims, seed);
            let rules = SurfaceRules {
                high: 0.7,
                agreement: if seed == 2 {
                    BLUNT_NORMALS
                } else {
                    SHARP_NORMALS
                },
                resolution: 3.0,
                min_area,
                min_strong_share: 0.2,
                min_width: least_width,
                open_sides: [[open; 2], [false; 2], [false; 2]],
            };
            let step = [1.0, 1.2, 0.8];
            let one = extract_on_one_rank(dims, step, candidates.clone(), &rules);
            number += one.surface_count;
            left_out += one.dropped;
            for count in [2, 3, 5] {
                let found = run_threads(count, |group| {
                    let own = partition_range(dims[2], group.rank(), count);
                    let layer = |c: &Candidate<3>| c.voxel.index() / (dims[0] * dims[1]);
                    let given = candidates.iter().copied();
                    let (given, own) = match seed % 2 {
                        0 => (
                            given.filter(|c| own.contains(&layer(c))).collect(),
                            Some(own),
                        ),
                        _ => (given.collect(), None),
                    };
                    let among = (group, &CancelToken::never());
                    let found = extract_surfaces(dims, given, own, step, &rules, among).unwrap();
                    assert_eq!(found.total_points, one.points.len());
                    found.gather(group).unwrap()
                });
                for found in found {
                    assert_eq!(
                        (found.surface_count, found.dropped),
                        (one.surface_count, one.dropped)
                    );
                    assert!(found.points == one.points && found.surface == one.surface);
                    assert!(found.is_rim == one.is_rim, "{seed} {count}");
                }
            }
        }
        // There is something of everything.
        let DroppedPoints {
            near_another_surface: near_another_sheet,
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
            let rules = SurfaceRules {
                high: 0.5,
                agreement: BLUNT_NORMALS,
                resolution: 3.0,
                min_area: 50.0,
                min_strong_share: 0.0,
                min_width: least_width,
                open_sides: [[false; 2]; 3],
            };
            extract_on_one_rank(dims, [1.0; 3], candidates.clone(), &rules)
        };
        let out = DroppedPoints {
            near_another_surface: 900,
            in_small_pieces: 16,
            in_narrow_parts: 0,
            weak: 1,
        };
        let any_width = found(0);
        assert_eq!((any_width.points.len(), any_width.dropped), (900 + 40, out));
        // What is within four samples of the square's inside is kept.
        let trimmed = found(8);
        let narrow = trimmed.dropped.in_narrow_parts;
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
            let rules = SurfaceRules {
                high: 0.5,
                agreement: SHARP_NORMALS,
                resolution: 3.0,
                min_area: 60.0,
                min_strong_share: 0.0,
                min_width: 0,
                open_sides: [[false; 2]; 3],
            };
            let found = extract_on_one_rank(dims, [1.0; 3], candidates.clone(), &rules);
            (found.surface_count, found.dropped.in_small_pieces)
        };
        let (sheets, crumbs) = found(1.7);
        assert_eq!(sheets, 1);
        assert!(crumbs > 60, "{crumbs}");
        assert_eq!(found(4.0).0, 2);
    }
}
