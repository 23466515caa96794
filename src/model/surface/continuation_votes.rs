//! Votes on which pieces of a feature continue each other, across ridges and across gaps.

use crate::mesh::complex::NONE;
use crate::parallel::prelude::*;

use super::facets::FacetComplex;
use super::fault_separation::FaultSeparation;
use super::size_classes::SizeClasses;
use crate::geometry::cell_list::CellList;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, dot, norm, sub, unit};

/// Smallest cosine of the bend at a ridge of two sides over which normals are averaged: 20 degrees,
/// four times the noise of a mesh on a smooth feature.
const MIN_SMOOTH_COSINE: f64 = 0.94;
/// Smallest cosine between averaged normals of neighbouring facets in a piece: 7 degrees. Features
/// that cross at 30 degrees and are blurred over four facets are separated by it. Pieces that it
/// separates without need are united again by their votes.
const MIN_AVERAGED_COSINE: f64 = 0.9925;
/// Number of rings of facets over which normals are averaged.
const NORMAL_RINGS: usize = 3;

/// The smooth pieces of a feature, and a normal of each facet without the noise of the mesh.
#[derive(Debug)]
pub struct SmoothPieces<const D: usize> {
    /// The piece of each facet.
    pub piece: Vec<u32>,
    /// Number of pieces.
    pub count: usize,
    /// Unit normal of each facet, averaged over its neighbours in the piece.
    pub normals: Vec<[f64; D]>,
}

impl<const D: usize> SmoothPieces<D> {
    /// Finds the pieces. Two facets are in one piece if they meet at a ridge of two sides with a
    /// small bend, both by their own normals and by averaged ones, and no fault separates them.
    pub fn new(facets: &FacetComplex<D>, separation: Option<&FaultSeparation<D>>) -> Self {
        let count = facets.len();
        let neighbour = |side: usize| match smooth_neighbour(facets, side) {
            g if g != NONE && is_separated(separation, side / D, g as usize) => NONE,
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
                    let normal = normals[f];
                    let neighbours = smooth[f].iter().filter(|&&g| g != NONE);
                    let sum = neighbours.fold(normal.map(|c| c * norm(area[f])), |sum, &g| {
                        let other = normals[g as usize];
                        let weight = norm(area[g as usize]).copysign(dot(normal, other));
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

    /// Returns the direction in which the surface of a side's facet would continue beyond the
    /// ridge.
    fn outward(&self, facets: &FacetComplex<D>, side: usize) -> [f64; D] {
        let inward = facets.inward(side);
        let normal = self.normals[side / D];
        unit(add_scaled(inward, -dot(inward, normal), normal)).map(|c| -c)
    }
}

/// Returns `true` if a fault separates two facets.
fn is_separated<const D: usize>(
    separation: Option<&FaultSeparation<D>>,
    f: usize,
    g: usize,
) -> bool {
    separation.is_some_and(|separation| separation.separates(f, g))
}

/// Returns the facet on the other side of a ridge, if it is the only one and the bend is small;
/// otherwise [`NONE`].
pub fn smooth_neighbour<const D: usize>(facets: &FacetComplex<D>, side: usize) -> u32 {
    let ridge = facets.ridges[side / D][side % D] as usize;
    match *facets.sides(ridge) {
        [a, b] => {
            let (a, b) = (a as usize, b as usize);
            let cosine = -dot(facets.inward(a), facets.inward(b));
            let other = if a == side { b } else { a };
            if cosine > MIN_SMOOTH_COSINE {
                (other / D) as u32
            } else {
                NONE
            }
        }
        _ => NONE,
    }
}

/// The vote of one ridge (or gap) on two pieces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Vote {
    /// The pieces, the smaller number first.
    pub pieces: [u32; 2],
    /// Weight for one surface: up to [`FULL_WEIGHT`] where one piece continues the other, more if
    /// straighter; otherwise 0.
    pub weight_for: u32,
    /// Weight against one surface: [`FULL_WEIGHT`] where the pieces meet and both end or continue
    /// elsewhere; otherwise 0.
    pub weight_against: u32,
}

impl Vote {
    /// Returns the vote between the surfaces into which the pieces were merged, or `None` if they
    /// are the same.
    pub fn remap(&self, merged_into: &[u32]) -> Option<Self> {
        let [a, b] = self.pieces.map(|piece| merged_into[piece as usize]);
        vote(a, b, self.weight_for, self.weight_against)
    }
}

/// The weight of a ridge without a bend, or of a ridge at which surfaces separate.
pub const FULL_WEIGHT: u32 = 64;

/// Returns the votes of all ridges between pieces, and the sides that no other side continues.
///
/// At a ridge, the two sides with the smallest bend form a pair, then the next two of the remaining
/// sides, as long as the cosine of the bend is above `min_cosine`. If bends are equal, the sides
/// with smaller codes come first, so that the pairing does not depend on the order of processing.
pub fn ridge_votes<const D: usize>(
    facets: &FacetComplex<D>,
    pieces: &SmoothPieces<D>,
    separation: Option<&FaultSeparation<D>>,
    min_cosine: f64,
) -> (Vec<Vote>, Vec<u32>) {
    let mut votes = Vec::new();
    let mut rim = Vec::new();
    let mut bends: Vec<(f64, u32, u32)> = Vec::new();
    let mut unpaired: Vec<u32> = Vec::new();
    for ridge in 0..facets.ridge_count() {
        let sides = facets.sides(ridge);
        let piece_of = |side: u32| pieces.piece[side as usize / D];
        if let &[a, b] = sides
            && piece_of(a) == piece_of(b)
        {
            continue;
        }
        bends.clear();
        for (i, &a) in sides.iter().enumerate() {
            for &b in &sides[i + 1..] {
                // The bend by averaged normals, or by the two facets alone: noise may spoil either.
                let averaged = -dot(
                    pieces.outward(facets, a as usize),
                    pieces.outward(facets, b as usize),
                );
                let direct = -dot(facets.inward(a as usize), facets.inward(b as usize));
                let parallel = dot(
                    pieces.normals[a as usize / D],
                    pieces.normals[b as usize / D],
                );
                if averaged.max(direct) > min_cosine
                    && parallel.abs() > min_cosine
                    && !is_separated(separation, a as usize / D, b as usize / D)
                {
                    bends.push((averaged + direct, a, b));
                }
            }
        }
        bends.sort_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        unpaired.clear();
        unpaired.extend_from_slice(sides);
        for &(_, a, b) in &bends {
            if unpaired.contains(&a) && unpaired.contains(&b) {
                unpaired.retain(|&s| s != a && s != b);
                votes.extend(vote(
                    piece_of(a),
                    piece_of(b),
                    continuation_weight(pieces, a, b, min_cosine),
                    0,
                ));
            }
        }
        rim.extend_from_slice(&unpaired);
        for (i, &a) in unpaired.iter().enumerate() {
            for &b in sides.iter().filter(|b| !unpaired[..=i].contains(b)) {
                votes.extend(vote(piece_of(a), piece_of(b), 0, FULL_WEIGHT));
            }
        }
    }
    (votes, rim)
}

fn vote(a: u32, b: u32, weight_for: u32, weight_against: u32) -> Option<Vote> {
    (a != b).then_some(Vote {
        pieces: [a.min(b), a.max(b)],
        weight_for,
        weight_against,
    })
}

/// Returns the weight of two sides that continue each other. It falls from full weight to 1 with
/// the cosine between their averaged normals, down to `min_cosine`.
fn continuation_weight<const D: usize>(
    pieces: &SmoothPieces<D>,
    a: u32,
    b: u32,
    min_cosine: f64,
) -> u32 {
    let [m, n] = [a, b].map(|side| pieces.normals[side as usize / D]);
    let fraction = (dot(m, n).abs() - min_cosine) / (1.0 - min_cosine);
    1 + (fraction.clamp(0.0, 1.0) * f64::from(FULL_WEIGHT - 1)) as u32
}

/// Returns votes across gaps. Each side at the rim of a piece votes for the nearest side of another
/// piece that is within `max_gap` facet sizes, faces it, and lies in its plane. `min_cosine` is the
/// cosine of the largest bend.
pub fn gap_votes<const D: usize>(
    facets: &FacetComplex<D>,
    pieces: &SmoothPieces<D>,
    separation: Option<&FaultSeparation<D>>,
    rim: &[u32],
    max_gap: f64,
    min_cosine: f64,
) -> Vec<Vote> {
    let ridge_centres: Vec<[f64; D]> = rim
        .iter()
        .map(|&s| facets.ridge_centre(s as usize))
        .collect();
    let outward: Vec<[f64; D]> = rim
        .iter()
        .map(|&s| pieces.outward(facets, s as usize))
        .collect();
    let sizes: Vec<f64> = rim.iter().map(|&s| facets.size(s as usize / D)).collect();
    let classes = SizeClasses::new(&ridge_centres, &sizes, max_gap);
    let max_sine = (1.0 - min_cosine * min_cosine).sqrt();
    let votes: Vec<Option<Vote>> = (0..rim.len())
        .into_par_iter()
        .map(|i| {
            let f = rim[i] as usize / D;
            let normal = pieces.normals[f];
            let mut best: Option<(f64, usize)> = None;
            classes.visit(ridge_centres[i], sizes[i], |j| {
                let g = rim[j] as usize / D;
                let offset = sub(ridge_centres[j], ridge_centres[i]);
                let distance = norm(offset);
                let size = 0.5 * (sizes[i] + sizes[j]);
                let is_nearest = best.is_none_or(|(best_distance, other)| {
                    distance < best_distance
                        || distance == best_distance && classes.precedes(&ridge_centres, j, other)
                });
                if distance >= max_gap * size || !is_nearest || pieces.piece[f] == pieces.piece[g] {
                    return;
                }
                let is_in_plane = |n: [f64; D]| dot(offset, n).abs() < max_sine * distance;
                // Between the larger faces of Voronoi cells there are tiny ones with arbitrary
                // orientation.
                let is_continuation = if distance < MIN_GAP_RATIO * size {
                    distance > 0.0 && -dot(outward[i], outward[j]) > min_cosine
                } else {
                    dot(offset, outward[i]) >= 0.5 * distance
                        && -dot(offset, outward[j]) >= 0.5 * distance
                        && is_in_plane(normal)
                        && is_in_plane(pieces.normals[g])
                };
                if dot(normal, pieces.normals[g]).abs() > min_cosine
                    && is_continuation
                    && !is_separated(separation, f, g)
                {
                    best = Some((distance, j));
                }
            });
            let (_, j) = best?;
            let [a, b] = [rim[i], rim[j]];
            vote(
                pieces.piece[f],
                pieces.piece[b as usize / D],
                continuation_weight(pieces, a, b, min_cosine),
                0,
            )
        })
        .collect();
    votes.into_iter().flatten().collect()
}

/// Smallest gap with a reliable direction, as a fraction of the facets' size.
const MIN_GAP_RATIO: f64 = 0.5;

/// Largest width of a wide gap, in facet sizes.
const MAX_GAP_RATIO: f64 = 4.0;
/// Smallest cosine between the planes on both sides of a wide gap: 10 degrees.
const MIN_PLANE_COSINE: f64 = 0.985;
/// Largest offset between these planes, as a fraction of the distance between their centres.
const MAX_PLANE_OFFSET_RATIO: f64 = 0.15;
/// Largest offset between these planes in facet sizes, if that is more: nearer features could not
/// be told apart.
const MAX_PLANE_OFFSET_FACETS: f64 = 0.8;

/// The plane fitted to a surface near a side at its rim.
struct RimPlane<const D: usize> {
    centre: [f64; D],
    normal: [f64; D],
    /// The direction in which the surface would continue.
    outward: [f64; D],
}

/// Returns votes across wide gaps, for surfaces found so far. Where surfaces cross at a low angle,
/// facets of one are blurred into the other, so that a strip of one surface is missing. Each side
/// at the rim of a surface votes for the nearest side of another surface that faces it, if both lie
/// in the same plane. The planes are fitted to the facets within the gap width.
pub fn crossing_votes<const D: usize>(
    facets: &FacetComplex<D>,
    surface: &[u32],
    normals: &[[f64; D]],
    separation: Option<&FaultSeparation<D>>,
) -> Vec<Vote> {
    let count = facets.len();
    let size = (0..count).map(|f| facets.size(f)).sum::<f64>() / count.max(1) as f64;
    let max_gap = MAX_GAP_RATIO * size;
    let is_rim = |&side: &usize| {
        let sides = facets.sides(facets.ridges[side / D][side % D] as usize);
        let own_surface = surface[side / D];
        let same = |o: &&u32| surface[**o as usize / D] == own_surface;
        sides.iter().filter(same).count() == 1
    };
    let rim: Vec<usize> = (0..D * count).filter(is_rim).collect();
    let rim_centres: Vec<[f64; D]> = rim.iter().map(|&s| facets.ridge_centre(s)).collect();
    let centroids = facets.centroids();
    let areas: Vec<f64> = (0..count).map(|f| norm(facets.normal(f))).collect();
    // Facets near a crossing are tilted, so planes are fitted to a wider neighbourhood.
    let fit_radius = 2.0 * max_gap;
    let grid = CellList::new(&centroids, fit_radius);
    let planes: Vec<RimPlane<D>> = (rim.par_iter().zip(&rim_centres))
        .map(|(&side, &rim_centre)| {
            let f = side / D;
            let (mut centre, mut normal, mut area) = ([0.0; D], [0.0; D], 0.0);
            grid.visit_within(rim_centre, fit_radius, |g| {
                if surface[g] == surface[f] && norm(sub(centroids[g], rim_centre)) < fit_radius {
                    let weight = areas[g];
                    area += weight;
                    centre = add_scaled(centre, weight, centroids[g]);
                    let signed_weight = weight.copysign(dot(normals[g], normals[f]));
                    normal = add_scaled(normal, signed_weight, normals[g]);
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
    let grid = CellList::new(&rim_centres, max_gap);
    let votes: Vec<Option<Vote>> = (0..rim.len())
        .into_par_iter()
        .map(|i| {
            let (own_surface, plane) = (surface[rim[i] / D], &planes[i]);
            let mut best: Option<(f64, usize)> = None;
            grid.visit_within(rim_centres[i], max_gap, |j| {
                let offset = sub(rim_centres[j], rim_centres[i]);
                let distance = norm(offset);
                if surface[rim[j] / D] == own_surface
                    || distance >= max_gap
                    || best.is_some_and(|(best_distance, _)| distance >= best_distance)
                {
                    return;
                }
                let other_plane = &planes[j];
                let centre_offset = sub(other_plane.centre, plane.centre);
                let max_offset = (MAX_PLANE_OFFSET_RATIO * norm(centre_offset))
                    .max(MAX_PLANE_OFFSET_FACETS * size);
                if dot(offset, plane.outward) >= 0.5 * distance
                    && -dot(offset, other_plane.outward) >= 0.5 * distance
                    && dot(plane.normal, other_plane.normal).abs() > MIN_PLANE_COSINE
                    && dot(centre_offset, plane.normal).abs() < max_offset
                    && dot(centre_offset, other_plane.normal).abs() < max_offset
                    && !is_separated(separation, rim[i] / D, rim[j] / D)
                {
                    best = Some((distance, j));
                }
            });
            let (_, j) = best?;
            vote(own_surface, surface[rim[j] / D], FULL_WEIGHT, 0)
        })
        .collect();
    votes.into_iter().flatten().collect()
}

/// Returns the rim length of each of `count` pieces, in ridges.
pub fn rim_lengths<const D: usize>(
    facets: &FacetComplex<D>,
    piece: &[u32],
    count: usize,
) -> Vec<u32> {
    let mut lengths = vec![0; count];
    for side in 0..D * facets.len() {
        let own_piece = piece[side / D];
        let sides = facets.sides(facets.ridges[side / D][side % D] as usize);
        let is_same_piece = |&&s: &&u32| piece[s as usize / D] == own_piece;
        lengths[own_piece as usize] += u32::from(sides.iter().filter(is_same_piece).count() == 1);
    }
    lengths
}
