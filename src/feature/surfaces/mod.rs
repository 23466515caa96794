//! Groups candidates into feature surfaces, by hysteresis; removes surfaces that are too near to
//! stronger ones, fragments, and narrow parts.
//!
//! Surfaces are grown one after the other, each from the strongest candidate that is left, over
//! neighbouring samples whose points lie in each other's tangent planes. A surface blocks
//! candidates that are parallel to it and nearer than the lattice can resolve. So the choice
//! between two close parallel surfaces is made once for a whole surface, and not sample by sample.
//!
//! - `growth`: growth of one surface
//! - `seeds`: order of the seeds, also if ranks share the candidates

mod growth;
mod seeds;

use super::candidate::Candidate;
use super::shared_grid::CandidateSlab;
use super::{FeatureKind, FeaturePoint, SharedGrid, ThresholdMeaning};
use crate::error::Result;
use crate::geometry::unit;
use crate::parallel::prelude::*;
use crate::progress::{CancelToken, Stage};
use growth::{BLOCKED, FRAGMENT, NARROW, SurfaceGrowth, UNASSIGNED};
use seeds::SeedQueue;
use serde::Serialize;
use std::collections::HashMap;
use std::ops::{AddAssign, Range};

/// For each axis, `true` if the image goes on beyond its low and its high side: the sides along
/// which a part was cut from a larger image.
pub type OpenSides<const D: usize> = [[bool; 2]; D];

/// Conditions that a surface must meet.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceRules<const D: usize> {
    /// At least one point of a surface is as strong as this.
    pub high: f32,
    /// Conditions for points to belong to one surface.
    pub agreement: Agreement,
    /// Parallel surfaces nearer than this (lattice units) exclude one another.
    pub resolution: f64,
    /// Smallest area of a surface (square lattice units; in 2-D smallest length).
    pub min_area: f64,
    /// Smallest share of a surface's area that is as strong as `high`. A strong area of
    /// [`STRONG_AREA_RATIO`](growth::STRONG_AREA_RATIO) times `min_area` is always enough. Surfaces
    /// of noise have few strong points, from which weak ones are followed.
    pub min_strong_share: f64,
    /// Parts of a surface that are narrower than about this (samples) are dropped; 0 keeps any
    /// width.
    pub min_width: usize,
    /// Sides beyond which the image goes on. A surface that reaches such a side may be larger than
    /// its visible part, and is kept whatever its area.
    pub open_sides: OpenSides<D>,
}

impl<const D: usize> SurfaceRules<D> {
    /// Returns `true` if the image goes on beyond any of its sides.
    fn is_open(&self) -> bool {
        self.open_sides.as_flattened().contains(&true)
    }
}

/// Points of the surfaces that were kept, of one rank or of all ranks, and numbers of dropped
/// points.
#[derive(Debug, Clone)]
pub struct FeatureSurfaces<'g, const D: usize> {
    /// The grid whose layers have the points; that of one process after [`FeatureSurfaces::gather`].
    pub grid: SharedGrid<'g, D>,
    /// Points of all surfaces, in the order of samples.
    pub points: Vec<FeaturePoint<D>>,
    /// Number of the surface of each point, from 1.
    pub surface: Vec<u32>,
    /// For each point, `true` if its surface ends there.
    pub is_rim: Vec<bool>,
    /// Number of surfaces, and number of points of all ranks.
    pub surface_count: usize,
    pub total_points: usize,
    /// Numbers of the points of all ranks that were dropped.
    pub dropped: DroppedPoints,
}

/// Numbers of points that are dropped, by reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct DroppedPoints {
    /// Points that are parallel to a stronger surface and nearer to it than the finest spacing
    /// resolves.
    pub near_another_surface: usize,
    /// Points in surfaces that are too small.
    pub in_small_pieces: usize,
    /// Points in parts of surfaces that are too narrow.
    pub in_narrow_parts: usize,
    /// Weak points that are not connected to anything strong.
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

impl<const D: usize> FeatureSurfaces<'_, D> {
    /// Gathers the points of all ranks on every rank.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn gather(self) -> Result<Self> {
        if !self.grid.is_shared() {
            return Ok(self);
        }
        let marks = self.surface.into_iter().zip(self.is_rim);
        let local = self.points.into_iter().zip(marks).collect();
        let gathered = (self.grid).concatenated("points of surfaces", local)?;
        let (points, marks): (_, Vec<_>) = gathered.into_iter().unzip();
        let (surface, is_rim) = marks.into_iter().unzip();
        Ok(Self {
            points,
            surface,
            is_rim,
            grid: SharedGrid::of_one_process(self.grid.dims),
            ..self
        })
    }

    /// Keeps the surfaces for which `stays` is `true`, and numbers them again. `all` has the points of all
    /// ranks.
    pub fn keep(&mut self, stays: &[bool], all: &Self) {
        let mut count = 0;
        let new_number = |stays: &bool| {
            count += u32::from(*stays);
            stays.then_some(count)
        };
        let new_numbers: Vec<Option<u32>> = stays.iter().map(new_number).collect();
        let number_of = |surface: u32| new_numbers[surface as usize - 1];
        let is_kept: Vec<bool> = (self.surface.iter())
            .map(|&surface| number_of(surface).is_some())
            .collect();
        let mut kept = is_kept.iter().copied();
        self.points.retain(|_| kept.next().unwrap_or(true));
        let mut kept = is_kept.iter().copied();
        self.is_rim.retain(|_| kept.next().unwrap_or(true));
        self.surface = (self.surface.iter())
            .filter_map(|&s| number_of(s))
            .collect();
        self.surface_count = count as usize;
        let all = all.surface.iter();
        self.total_points = all.filter(|&&s| number_of(s).is_some()).count();
    }

    /// Adds notes on the points of one kind of feature that were kept and dropped.
    pub fn describe(&self, kind: FeatureKind, rules: &SurfaceRules<D>, notes: &mut Vec<String>) {
        let dropped = &self.dropped;
        let (noun, small) = match D {
            2 => (
                "curves",
                format!("shorter than {:.0} samples", rules.min_area),
            ),
            _ => (
                "surfaces",
                format!("smaller than {:.0} square samples", rules.min_area),
            ),
        };
        let mut note = format!(
            "{kind} followed: {} points on {} {noun}; dropped: {} points nearer than {:.1} samples to stronger \
             parallel {noun}, {} on {noun} {small}",
            self.total_points,
            self.surface_count,
            dropped.near_another_surface,
            rules.resolution,
            dropped.in_small_pieces,
        );
        if rules.min_width > 0 {
            let (count, width) = (dropped.in_narrow_parts, rules.min_width);
            note += &format!(", {count} in parts narrower than {width} samples");
        }
        notes.push(note + &format!(", {} too weak", dropped.weak));
        if self.total_points == 0 {
            let remedy = match kind.threshold_meaning() {
                ThresholdMeaning::MinStrength => "another --feature or a lower --threshold",
                _ => "another --feature or other options",
            };
            notes.push(format!(
                "NO FEATURE ({kind}) was found, so the mesh follows none: try {remedy}"
            ));
        }
    }
}

/// Conditions for points to belong to one surface, and for surfaces to be parallel.
#[derive(Debug, Clone, Copy)]
pub struct Agreement {
    /// Smallest cosine between the normals of neighbours in one surface.
    min_normal_cosine: f32,
    /// Largest distance (samples) of each of two neighbours from the other's tangent plane.
    max_plane_distance: f32,
    /// Smallest cosine between the normals of parallel surfaces; others cross.
    min_parallel_cosine: f32,
}

/// Conditions where normals have errors of more than ten degrees in places.
pub const BLUNT_NORMALS: Agreement = Agreement {
    min_normal_cosine: 0.8,
    max_plane_distance: 1.0,
    min_parallel_cosine: 0.9,
};
/// Conditions where normals are known to a few degrees, so that surfaces may cross at 15 degrees.
pub const SHARP_NORMALS: Agreement = Agreement {
    min_normal_cosine: 0.97,
    max_plane_distance: 0.6,
    min_parallel_cosine: 0.985,
};

/// Groups candidates (in the order of samples) into surfaces that meet the rules, and returns the
/// points in this rank's layers. If ranks share the candidates, `layers` are the layers of which
/// this rank passes all candidates; `None` if every rank passes all candidates.
///
/// # Errors
/// Returns an [`Error::Interrupted`](crate::Error::Interrupted) if the search is cancelled, and the
/// errors of other ranks.
pub fn extract_surfaces<'g, const D: usize>(
    grid: SharedGrid<'g, D>,
    candidates: Vec<Candidate<D>>,
    layers: Option<Range<usize>>,
    step: [f64; D],
    rules: &SurfaceRules<D>,
    cancel: &CancelToken<'_>,
) -> Result<FeatureSurfaces<'g, D>> {
    let halo = growth::halo_layers(&candidates, step, rules);
    let halo = grid.max("halo of surfaces", halo)?;
    let slab = CandidateSlab::new(grid, candidates, layers, halo)?;
    let mut growth = SurfaceGrowth::new(&slab, step, rules, cancel);
    let kept_surfaces = SeedQueue::new(&mut growth, rules.high).grow_all()?;
    let mut all_kept = grid.concatenated("surfaces", kept_surfaces)?;
    all_kept.sort_unstable();
    let number_of: HashMap<u32, u32> = (1..)
        .zip(&all_kept)
        .map(|(number, &(_, provisional))| (provisional, number))
        .collect();
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
    let [
        in_small_pieces,
        in_narrow_parts,
        near_another_surface,
        weak,
        total_points,
    ] = grid.sum("points of surfaces", states)?;
    let owned = slab.owned.clone().into_par_iter();
    let kept_indices: Vec<usize> = owned.filter(|&i| growth.state[i] < NARROW).collect();
    let kept_candidates = || kept_indices.par_iter().map(|&i| (i, &slab.candidates[i]));
    let is_rim = |c: &Candidate<D>| !cancel.is_cancelled() && growth.is_rim_at(c);
    let local = FeatureSurfaces {
        grid,
        total_points,
        points: kept_candidates()
            .map(|(_, c)| to_lattice_space(c, step))
            .collect(),
        surface: kept_candidates()
            .map(|(i, _)| number_of[&growth.state[i]])
            .collect(),
        is_rim: kept_candidates().map(|(_, c)| is_rim(c)).collect(),
        surface_count: all_kept.len(),
        dropped: DroppedPoints {
            near_another_surface,
            in_small_pieces,
            in_narrow_parts,
            weak,
        },
    };
    cancel.check(Stage::Features)?;
    Ok(local)
}

/// Converts a candidate to lattice space: the position is multiplied by the step, the normal
/// divided by it.
fn to_lattice_space<const D: usize>(c: &Candidate<D>, step: [f64; D]) -> FeaturePoint<D> {
    let position = std::array::from_fn(|k| c.position[k] * step[k] as f32);
    let normal: [f32; D] = std::array::from_fn(|k| c.normal[k] / step[k] as f32);
    FeaturePoint {
        position,
        normal: unit(normal),
        strength: c.strength,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{partition_range, run_threads};
    use crate::feature::volume::Volume;
    use crate::geometry::random::Random;
    use crate::geometry::unit;

    fn extract_on_one_rank(
        dims: [usize; 3],
        step: [f64; 3],
        candidates: Vec<Candidate<3>>,
        rules: &SurfaceRules<3>,
    ) -> FeatureSurfaces<'static, 3> {
        let cancel = CancelToken::never();
        let grid = SharedGrid::of_one_process(dims);
        extract_surfaces(grid, candidates, None, step, rules, &cancel).unwrap()
    }

    /// Returns points of curved surfaces that cross and run close to each other, with gaps, and of
    /// noise.
    fn surface_network(dims: [usize; 3], seed: u64) -> Vec<Candidate<3>> {
        let mut random = Random::new(seed);
        let mut candidates = Vec::new();
        let space = Volume::new(dims, &[]);
        let mut planes = Vec::new();
        for _ in 0..6 {
            let normal = unit([1.0, random.range(-0.6, 0.6), random.range(-0.6, 0.6)]);
            let middle = dims.map(|n| random.range(0.2, 0.8) * n as f64);
            let (strength, wave) = (random.range(0.6, 1.4), random.range(0.0, 2.0));
            planes.push((normal, middle, strength, wave));
            let adjacent = [middle[0] + 2.4, middle[1], middle[2]];
            planes.push((normal, adjacent, random.range(0.8, 1.1) * strength, wave));
        }
        for (normal, middle, strength, wave) in planes {
            for i in 0..dims[1] * dims[2] {
                let at = [0, i % dims[1], i / dims[1]];
                let shift = [1, 2].map(|k| normal[k] * (at[k] as f64 - middle[k]));
                let bend = wave * (at[2] as f64 / 7.0).sin();
                let x = middle[0] + bend - (shift[0] + shift[1]) / normal[0];
                if x > 0.0 && x < dims[0] as f64 - 1.0 && random.range(0.0, 1.0) > 0.07 {
                    let at = [x.round() as usize, at[1], at[2]];
                    let strength = (strength * random.range(0.7, 1.0)) as f32;
                    let offset = (x - x.round()) as f32;
                    candidates.push(Candidate::new(dims, at, 0, offset, normal, strength));
                }
            }
        }
        for _ in 0..space.dims.iter().product::<usize>() / 40 {
            let at = dims.map(|n| random.range(0.0, n as f64) as usize);
            let normal = unit([1.0, random.range(-0.5, 0.5), random.range(-0.5, 0.5)]);
            let strength = random.range(0.3, 1.2) as f32;
            candidates.push(Candidate::new(dims, at, 0, 0.0, normal, strength));
        }
        candidates.sort_by_key(|c| c.voxel);
        candidates
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn distributed_extraction_matches_one_rank() {
        let dims = [30, 26, 64];
        let (mut surface_count, mut dropped) = (0, DroppedPoints::default());
        for (seed, min_area, min_width, is_open) in [
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
                min_width,
                open_sides: [[is_open; 2], [false; 2], [false; 2]],
            };
            let step = [1.0, 1.2, 0.8];
            let reference = extract_on_one_rank(dims, step, candidates.clone(), &rules);
            surface_count += reference.surface_count;
            dropped += reference.dropped;
            for count in [2, 3, 5] {
                run_threads(count, |comm| {
                    let mut local_candidates = candidates.clone();
                    let mut layers = None;
                    if seed % 2 == 0 {
                        let owned = partition_range(dims[2], comm.rank(), count);
                        let layer = |c: &Candidate<3>| c.voxel.index() / (dims[0] * dims[1]);
                        local_candidates.retain(|c| owned.contains(&layer(c)));
                        layers = Some(owned);
                    }
                    let (grid, cancel) = (SharedGrid::new(dims, comm), CancelToken::never());
                    let surfaces =
                        extract_surfaces(grid, local_candidates, layers, step, &rules, &cancel);
                    let surfaces = surfaces.unwrap();
                    assert_eq!(surfaces.total_points, reference.points.len());
                    let surfaces = surfaces.gather().unwrap();
                    assert_eq!(
                        (surfaces.surface_count, surfaces.dropped),
                        (reference.surface_count, reference.dropped)
                    );
                    assert!(
                        surfaces.points == reference.points
                            && surfaces.surface == reference.surface
                    );
                    assert!(surfaces.is_rim == reference.is_rim, "{seed} {count}");
                });
            }
        }
        // Every reason for dropping points occurs often.
        let DroppedPoints {
            near_another_surface,
            in_small_pieces,
            in_narrow_parts,
            weak,
        } = dropped;
        let figures = [
            (surface_count, 30),
            (near_another_surface, 1000),
            (in_small_pieces, 1000),
            (in_narrow_parts, 30),
            (weak, 1000),
        ];
        assert!(
            figures.iter().all(|(value, min)| value >= min),
            "{figures:?}"
        );
    }

    #[test]
    fn dropped_points_are_counted_by_reason() {
        let dims = [30, 50, 40];
        // A square at x = 15 with a strip two samples wide, a weaker square two samples from it,
        // and, far away, a small surface and a weak point.
        let mut points: Vec<([usize; 3], f32)> = Vec::new();
        for z in 5..35 {
            for y in 0..50 {
                let in_square = y < 30;
                let in_strip = (19..21).contains(&z);
                if in_square || in_strip {
                    points.push(([15, y, z], 1.0));
                }
                if in_square {
                    points.push(([17, y, z], 0.8));
                }
                if (8..12).contains(&z) && (40..44).contains(&y) {
                    points.push(([3, y, z], 0.9));
                }
            }
        }
        points.push(([27, 40, 30], 0.2));
        // The first surface starts inside the square.
        for (at, strength) in &mut points {
            if *at == [15, 15, 20] {
                *strength = 1.5;
            }
        }
        points.sort_by_key(|(at, _)| (at[2], at[1], at[0]));
        let candidates: Vec<Candidate<3>> = points
            .iter()
            .map(|&(at, strength)| Candidate::new(dims, at, 0, 0.0, [1.0, 0.0, 0.0], strength))
            .collect();
        let extract = |min_width| {
            let rules = SurfaceRules {
                high: 0.5,
                agreement: BLUNT_NORMALS,
                resolution: 3.0,
                min_area: 50.0,
                min_strong_share: 0.0,
                min_width,
                open_sides: [[false; 2]; 3],
            };
            extract_on_one_rank(dims, [1.0; 3], candidates.clone(), &rules)
        };
        let dropped = DroppedPoints {
            near_another_surface: 900,
            in_small_pieces: 16,
            in_narrow_parts: 0,
            weak: 1,
        };
        let any_width = extract(0);
        assert_eq!(
            (any_width.points.len(), any_width.dropped),
            (900 + 40, dropped)
        );
        // Points within four samples of the square's interior are kept.
        let trimmed = extract(8);
        let narrow = trimmed.dropped.in_narrow_parts;
        assert!((30..=40).contains(&narrow), "{narrow}");
        assert_eq!(trimmed.points.len(), 900 + 40 - narrow);
    }

    #[test]
    fn a_small_surface_shadowed_by_a_stronger_one_is_dropped() {
        let dims = [30, 40, 40];
        // A square at x = 15, and across its rim a surface turned by 22 degrees, up to `max_offset`
        // samples away.
        let extract = |max_offset: f64| {
            let mut points: Vec<([usize; 3], f32, [f64; 3], f32)> = Vec::new();
            let (sin, cos) = 22.0f64.to_radians().sin_cos();
            for z in 5..35 {
                for y in 5..35 {
                    points.push(([15, y, z], 0.0, [1.0, 0.0, 0.0], 1.0));
                    let offset = (y as f64 - 24.0) * sin / cos;
                    if y >= 20 && offset <= max_offset && offset.abs() > 0.6 {
                        let x = 15.0 + offset;
                        let at = [x.round() as usize, y, z];
                        points.push((at, (x - x.round()) as f32, [cos, -sin, 0.0], 0.9));
                    }
                }
            }
            points.sort_by_key(|p| (p.0[2], p.0[1], p.0[0]));
            let candidates: Vec<Candidate<3>> = points
                .iter()
                .map(|&(at, offset, normal, strength)| {
                    Candidate::new(dims, at, 0, offset, normal, strength)
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
            let surfaces = extract_on_one_rank(dims, [1.0; 3], candidates.clone(), &rules);
            (surfaces.surface_count, surfaces.dropped.in_small_pieces)
        };
        let (surface_count, fragments) = extract(1.7);
        assert_eq!(surface_count, 1);
        assert!(fragments > 60, "{fragments}");
        assert_eq!(extract(4.0).0, 2);
    }
}
