//! Which facets continue each other: across ridges, and across gaps.

use crate::parallel::prelude::*;

use super::facets::{FacetComplex, NONE};
use super::fault_separation::FaultSeparation;
use crate::geometry::cell_list::CellList;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, dot, norm, sub, unit};

/// Normals are averaged over ridges of two sides that bend less: 20 degrees, four times what the noise
/// of a mesh on a smooth feature does.
const MIN_SMOOTH_COSINE: f64 = 0.94;
/// A piece ends where averaged normals differ by more: 7 degrees from facet to facet. Features that
/// cross at 30 degrees and are blurred over four facets where they do come apart so; what comes
/// apart without need is united again by its votes.
const MIN_AVERAGED_COSINE: f64 = 0.9925;
/// Normals are averaged over this many rings of facets.
const NORMAL_RINGS: usize = 3;

/// The surely smooth pieces of a feature, and a normal of each facet that is free of the mesh's noise.
#[derive(Debug)]
pub struct SmoothPieces<const D: usize> {
    /// The piece that each facet belongs to.
    pub piece: Vec<u32>,
    /// Number of pieces.
    pub count: usize,
    /// Unit normal of each facet, averaged over its neighbours in the piece.
    pub normals: Vec<[f64; D]>,
}

impl<const D: usize> SmoothPieces<D> {
    /// Facets that meet two by two with little bend, by themselves and by their averaged normals, and
    /// no fault between them.
    pub fn new(facets: &FacetComplex<D>, walls: Option<&FaultSeparation<D>>) -> Self {
        let count = facets.len();
        let neighbour = |side: usize| match smooth_neighbour(facets, side) {
            g if g != NONE && is_separated(walls, side / D, g as usize) => NONE,
            g => g,
        };
        let smooth: Vec<[u32; D]> = (0..count)
            .into_par_iter()
            .map(|f| std::array::from_fn(|k| neighbour(D * f + k)))
            .collect();
        let area: Vec<[f64; D]> = (0..count)
            .into_par_iter()
            .map(|f| facets.normal(f))
            .collect();
        let mut normals: Vec<[f64; D]> = area.par_iter().map(|&n| unit(n)).collect();
        for _ in 0..NORMAL_RINGS {
            normals = (0..count)
                .into_par_iter()
                .map(|f| {
                    let own = normals[f];
                    let near = smooth[f].iter().filter(|&&g| g != NONE);
                    let sum = near.fold(own.map(|c| c * norm(area[f])), |sum, &g| {
                        let other = normals[g as usize];
                        let weight = norm(area[g as usize]).copysign(dot(own, other));
                        add_scaled(sum, weight, other)
                    });
                    unit(sum)
                })
                .collect();
        }
        let mut sets = UnionFind::new(count);
        for f in 0..count {
            for &g in smooth[f].iter().filter(|&&g| g != NONE && g as usize > f) {
                if dot(normals[f], normals[g as usize]).abs() > MIN_AVERAGED_COSINE {
                    sets.unite(f as u32, g);
                }
            }
        }
        let (piece, count) = sets.into_labels();
        Self {
            piece,
            count,
            normals,
        }
    }

    /// The direction in which the surface of a side's facet goes on beyond the ridge.
    fn outward(&self, facets: &FacetComplex<D>, side: usize) -> [f64; D] {
        let inward = facets.inward(side);
        let normal = self.normals[side / D];
        unit(add_scaled(inward, -dot(inward, normal), normal)).map(|c| -c)
    }
}

/// Whether walls part two facets.
fn is_separated<const D: usize>(walls: Option<&FaultSeparation<D>>, f: usize, g: usize) -> bool {
    walls.is_some_and(|walls| walls.separates(f, g))
}

/// The facet beyond a side, if it is the only one and the bend is small.
pub fn smooth_neighbour<const D: usize>(facets: &FacetComplex<D>, side: usize) -> u32 {
    let ridge = facets.ridges[side / D][side % D] as usize;
    match *facets.sides(ridge) {
        [a, b] => {
            let (a, b) = (a as usize, b as usize);
            let straight = -dot(facets.inward(a), facets.inward(b));
            let other = if a == side { b } else { a };
            if straight > MIN_SMOOTH_COSINE {
                (other / D) as u32
            } else {
                NONE
            }
        }
        _ => NONE,
    }
}

/// What one ridge says of two pieces, the smaller number first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Vote {
    /// The pieces.
    pub pieces: [u32; 2],
    /// [`FULL_WEIGHT`] or less where one continues the other, the more the straighter; 0 otherwise.
    pub weight_for: u32,
    /// [`FULL_WEIGHT`] where they meet and both go on otherwise, or end; 0 otherwise.
    pub weight_against: u32,
}

impl Vote {
    /// The same between what the pieces have become part of, unless that is one.
    pub fn remap(&self, united: &[u32]) -> Option<Self> {
        let [a, b] = self.pieces.map(|piece| united[piece as usize]);
        vote(a, b, self.weight_for, self.weight_against)
    }
}

/// The weight of a ridge across which nothing bends, or at which surfaces part.
pub const FULL_WEIGHT: u32 = 64;

/// Votes of all ridges between pieces, and the sides that nothing continues there.
///
/// At a ridge, the two sides that bend least are a pair, then the next two of those left, as far as
/// `straight`, the cosine of the largest bend, allows. Ties go to the sides that come first, so the
/// pairing is the same whatever the order in which it is looked at.
pub fn ridge_votes<const D: usize>(
    facets: &FacetComplex<D>,
    cores: &SmoothPieces<D>,
    walls: Option<&FaultSeparation<D>>,
    straight: f64,
) -> (Vec<Vote>, Vec<u32>) {
    let mut votes = Vec::new();
    let mut rim = Vec::new();
    let mut bends: Vec<(f64, u32, u32)> = Vec::new();
    let mut left: Vec<u32> = Vec::new();
    for ridge in 0..facets.ridge_count() {
        let sides = facets.sides(ridge);
        let core = |side: u32| cores.piece[side as usize / D];
        if let &[a, b] = sides
            && core(a) == core(b)
        {
            continue;
        }
        bends.clear();
        for (i, &a) in sides.iter().enumerate() {
            for &b in &sides[i + 1..] {
                // Seen by the averaged normals, or by the two facets alone: noise may spoil either.
                let averaged = -dot(
                    cores.outward(facets, a as usize),
                    cores.outward(facets, b as usize),
                );
                let plain = -dot(facets.inward(a as usize), facets.inward(b as usize));
                let parallel = dot(cores.normals[a as usize / D], cores.normals[b as usize / D]);
                if averaged.max(plain) > straight
                    && parallel.abs() > straight
                    && !is_separated(walls, a as usize / D, b as usize / D)
                {
                    bends.push((averaged + plain, a, b));
                }
            }
        }
        bends.sort_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        left.clear();
        left.extend_from_slice(sides);
        for &(_, a, b) in &bends {
            if left.contains(&a) && left.contains(&b) {
                left.retain(|&s| s != a && s != b);
                votes.extend(vote(
                    core(a),
                    core(b),
                    continuation_weight(cores, a, b, straight),
                    0,
                ));
            }
        }
        rim.extend_from_slice(&left);
        for (i, &a) in left.iter().enumerate() {
            for &b in sides.iter().filter(|b| !left[..=i].contains(b)) {
                votes.extend(vote(core(a), core(b), 0, FULL_WEIGHT));
            }
        }
    }
    (votes, rim)
}

fn vote(a: u32, b: u32, favour: u32, against: u32) -> Option<Vote> {
    (a != b).then_some(Vote {
        pieces: [a.min(b), a.max(b)],
        weight_for: favour,
        weight_against: against,
    })
}

/// The weight by which two sides that continue each other speak for one surface: it falls from full
/// to next to nothing with the cosine between their averaged normals, down to `straight`.
fn continuation_weight<const D: usize>(
    cores: &SmoothPieces<D>,
    a: u32,
    b: u32,
    straight: f64,
) -> u32 {
    let [m, n] = [a, b].map(|side| cores.normals[side as usize / D]);
    let share = (dot(m, n).abs() - straight) / (1.0 - straight);
    1 + (share.clamp(0.0, 1.0) * f64::from(FULL_WEIGHT - 1)) as u32
}

/// Votes across gaps: each side at the rim of a piece and the nearest one of another piece within
/// `reach` facet sizes that faces it and lies in its plane, by `straight`, the cosine of the largest
/// bend.
pub fn gap_votes<const D: usize>(
    facets: &FacetComplex<D>,
    cores: &SmoothPieces<D>,
    walls: Option<&FaultSeparation<D>>,
    rim: &[u32],
    reach: f64,
    straight: f64,
) -> Vec<Vote> {
    let middles: Vec<[f64; D]> = rim
        .iter()
        .map(|&s| facets.ridge_centre(s as usize))
        .collect();
    let outward: Vec<[f64; D]> = rim
        .iter()
        .map(|&s| cores.outward(facets, s as usize))
        .collect();
    let sizes: Vec<f64> = rim.iter().map(|&s| facets.size(s as usize / D)).collect();
    let classes = SizeClasses::new(&middles, &sizes, reach);
    let bent = (1.0 - straight * straight).sqrt();
    let found: Vec<Option<Vote>> = (0..rim.len())
        .into_par_iter()
        .map(|i| {
            let f = rim[i] as usize / D;
            let normal = cores.normals[f];
            let mut best: Option<(f64, usize)> = None;
            classes.visit(middles[i], sizes[i], |j| {
                let g = rim[j] as usize / D;
                let to = sub(middles[j], middles[i]);
                let far = norm(to);
                let size = 0.5 * (sizes[i] + sizes[j]);
                let nearest = best.is_none_or(|(least, other)| {
                    far < least || far == least && classes.precedes(&middles, j, other)
                });
                if far >= reach * size || !nearest || cores.piece[f] == cores.piece[g] {
                    return;
                }
                let flat = |n: [f64; D]| dot(to, n).abs() < bent * far;
                // Between the larger faces of Voronoi cells there are tiny ones, turned anyhow.
                let onward = if far < MIN_GAP_RATIO * size {
                    far > 0.0 && -dot(outward[i], outward[j]) > straight
                } else {
                    dot(to, outward[i]) >= 0.5 * far
                        && -dot(to, outward[j]) >= 0.5 * far
                        && flat(normal)
                        && flat(cores.normals[g])
                };
                if dot(normal, cores.normals[g]).abs() > straight
                    && onward
                    && !is_separated(walls, f, g)
                {
                    best = Some((far, j));
                }
            });
            let (_, j) = best?;
            let [a, b] = [rim[i], rim[j]];
            vote(
                cores.piece[f],
                cores.piece[b as usize / D],
                continuation_weight(cores, a, b, straight),
                0,
            )
        })
        .collect();
    found.into_iter().flatten().collect()
}

/// Points of sides by the sizes of their facets, so that few are looked at which are too far for theirs:
/// the largest facet of a mesh of Voronoi cells is many times as large as most.
struct SizeClasses<const D: usize> {
    reach: f64,
    /// Of each class the largest size, its points, and their numbers.
    classes: Vec<(f64, CellList<D>, Vec<usize>)>,
    /// Cells as wide as the widest gap: of points equally far, the one that comes first in their order
    /// is taken.
    coarse_cells: CellList<D>,
}

impl<const D: usize> SizeClasses<D> {
    fn new(points: &[[f64; D]], sizes: &[f64], reach: f64) -> Self {
        let cell = |size: f64| (reach * size).max(f64::MIN_POSITIVE);
        let largest = sizes.iter().copied().fold(0.0, f64::max);
        let mean = sizes.iter().sum::<f64>() / sizes.len().max(1) as f64;
        // The mean size and those up to twice as large, four times, and so on.
        let class = |size: f64| (size / mean).log2().ceil().max(0.0) as usize;
        let mut members: Vec<Vec<usize>> = Vec::new();
        for (i, &size) in sizes.iter().enumerate() {
            let class = class(size);
            members.resize_with(members.len().max(class + 1), Vec::new);
            members[class].push(i);
        }
        let classes = members.into_iter().filter(|members| !members.is_empty());
        let classes = classes.map(|members| {
            let most = members.iter().map(|&i| sizes[i]).fold(0.0, f64::max);
            let own: Vec<[f64; D]> = members.iter().map(|&i| points[i]).collect();
            (most, CellList::new(&own, cell(most)), members)
        });
        Self {
            reach,
            classes: classes.collect(),
            coarse_cells: CellList::new(points, cell(largest)),
        }
    }

    /// Every point within reach of one that belongs to a facet of this size, and some that are not.
    fn visit(&self, at: [f64; D], size: f64, mut visit: impl FnMut(usize)) {
        for (most, grid, members) in &self.classes {
            let radius = self.reach * 0.5 * (size + most);
            grid.visit_within(at, radius, |n| visit(members[n]));
        }
    }

    /// Whether of two points as far the first is to be taken.
    fn precedes(&self, points: &[[f64; D]], i: usize, j: usize) -> bool {
        (self.coarse_cells.cell_of(points[i]), i) < (self.coarse_cells.cell_of(points[j]), j)
    }
}

/// A gap narrower than this part of a facet's size has no direction.
const MIN_GAP_RATIO: f64 = 0.5;

/// Wide gaps are at most this many facets wide.
const MAX_GAP_RATIO: f64 = 4.0;
/// Across wide gaps planes differ by at most 10 degrees,
const MIN_PLANE_COSINE: f64 = 0.985;
/// and are off one another by at most this part of the distance between their centres,
const MAX_PLANE_OFFSET_RATIO: f64 = 0.15;
/// or this part of a facet's size: nearer features could not be told apart.
const MAX_PLANE_OFFSET_FACETS: f64 = 0.8;

/// The plane of a surface near a side at its rim.
struct RimPlane<const D: usize> {
    centre: [f64; D],
    normal: [f64; D],
    /// Where the surface would go on.
    outward: [f64; D],
}

/// Votes across wide gaps, for surfaces found so far: a crossing at a low angle blurs facets of the one
/// into the other, so that of the one a strip is missing. Each side at the rim of a surface and the
/// nearest one of another surface that faces it, where the planes of both, fitted to what lies within
/// the width of the gap, are the same.
pub fn crossing_votes<const D: usize>(
    facets: &FacetComplex<D>,
    surface: &[u32],
    normals: &[[f64; D]],
    walls: Option<&FaultSeparation<D>>,
) -> Vec<Vote> {
    let count = facets.len();
    let size = (0..count).map(|f| facets.size(f)).sum::<f64>() / count.max(1) as f64;
    let reach = (MAX_GAP_RATIO * size).max(f64::MIN_POSITIVE);
    let alone = |&side: &usize| {
        let sides = facets.sides(facets.ridges[side / D][side % D] as usize);
        let own = surface[side / D];
        let same = |o: &&u32| surface[**o as usize / D] == own;
        sides.iter().filter(same).count() == 1
    };
    let rim: Vec<usize> = (0..D * count).filter(alone).collect();
    let ends: Vec<[f64; D]> = rim.iter().map(|&s| facets.ridge_centre(s)).collect();
    let middles: Vec<[f64; D]> = (0..count)
        .map(|f| {
            let corners = facets.corners(f).into_iter();
            corners.fold([0.0; D], |sum, x| add_scaled(sum, 1.0 / D as f64, x))
        })
        .collect();
    // Near a crossing facets lie askew: planes are fitted to more than those.
    let wide = 2.0 * reach;
    let grid = CellList::labelled(&middles, |f| surface[f], wide);
    let patches: Vec<RimPlane<D>> = (rim.par_iter().zip(&ends))
        .map(|(&side, &end)| {
            let f = side / D;
            let (mut centre, mut normal, mut area) = ([0.0; D], [0.0; D], 0.0);
            grid.visit_labelled(end, surface[f], |g| {
                if norm(sub(middles[g], end)) < wide {
                    let own = norm(facets.normal(g));
                    area += own;
                    centre = add_scaled(centre, own, middles[g]);
                    let turned = own.copysign(dot(normals[g], normals[f]));
                    normal = add_scaled(normal, turned, normals[g]);
                }
            });
            let normal = unit(normal);
            let inward = facets.inward(side);
            let inward = unit(add_scaled(inward, -dot(inward, normal), normal));
            RimPlane {
                centre: centre.map(|c| c / area),
                normal,
                outward: inward.map(|c| -c),
            }
        })
        .collect();
    let grid = CellList::new(&ends, reach);
    let found: Vec<Option<Vote>> = (0..rim.len())
        .into_par_iter()
        .map(|i| {
            let (own, here) = (surface[rim[i] / D], &patches[i]);
            let mut best: Option<(f64, usize)> = None;
            grid.visit(ends[i], |j| {
                let to = sub(ends[j], ends[i]);
                let far = norm(to);
                if surface[rim[j] / D] == own
                    || far >= reach
                    || best.is_some_and(|(least, _)| far >= least)
                {
                    return;
                }
                let there = &patches[j];
                let across = sub(there.centre, here.centre);
                let off =
                    (MAX_PLANE_OFFSET_RATIO * norm(across)).max(MAX_PLANE_OFFSET_FACETS * size);
                if dot(to, here.outward) >= 0.5 * far
                    && -dot(to, there.outward) >= 0.5 * far
                    && dot(here.normal, there.normal).abs() > MIN_PLANE_COSINE
                    && dot(across, here.normal).abs() < off
                    && dot(across, there.normal).abs() < off
                    && !is_separated(walls, rim[i] / D, rim[j] / D)
                {
                    best = Some((far, j));
                }
            });
            let (_, j) = best?;
            vote(own, surface[rim[j] / D], FULL_WEIGHT, 0)
        })
        .collect();
    found.into_iter().flatten().collect()
}

/// Length of the rim of each of `count` pieces, in ridges.
pub fn rim_lengths<const D: usize>(
    facets: &FacetComplex<D>,
    piece: &[u32],
    count: usize,
) -> Vec<u32> {
    let mut rims = vec![0; count];
    for side in 0..D * facets.len() {
        let own = piece[side / D];
        let sides = facets.sides(facets.ridges[side / D][side % D] as usize);
        let inside = |&&s: &&u32| piece[s as usize / D] == own;
        rims[own as usize] += u32::from(sides.iter().filter(inside).count() == 1);
    }
    rims
}
