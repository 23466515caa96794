//! Moves a node to where the worst dihedral angle around it is best: optimisation-based smoothing
//! of a max-min objective (Freitag & Ollivier-Gooch 1997) on the sines of the dihedral angles.
//!
//! Every angle of every tetrahedron at the node is a smooth function of its position. The ascent
//! direction is the shortest vector in the convex hull of the gradients of the smallest sines: no
//! direction raises all of them faster. Nodes on features and sides of the box move only along
//! them.

use super::local_link::LocalLink;
use crate::geometry::simd::dispatch_simd;
use crate::geometry::{add_scaled, dot, solve_positive, sub};
use crate::improve::constraint::NodeConstraint;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::plane_cache::PlaneCache;
use crate::mesh::quality::min_sine;

/// Number of tetrahedra that are processed side by side in SIMD lanes.
pub(super) const LANES: usize = 8;

/// Coordinates of the other three nodes of eight tetrahedra, by node, axis and tetrahedron.
pub(super) type LinkGroup<T> = [[[T; LANES]; 3]; 3];

/// The link of a node x: for each tetrahedron at x the positions of its other three nodes, such
/// that `(x, p0, p1, p2)` is positive.
#[derive(Default)]
pub struct NodeLink {
    /// The last group is filled up with its first tetrahedron, which changes no minimum.
    groups: Vec<LinkGroup<f64>>,
    count: usize,
}

impl NodeLink {
    /// Removes all tetrahedra.
    pub fn clear(&mut self) {
        self.groups.clear();
        self.count = 0;
    }

    /// Adds a tetrahedron.
    pub fn push(&mut self, p: [[f64; 3]; 3]) {
        let lane = self.count % LANES;
        self.count += 1;
        if lane == 0 {
            self.groups.push(p.map(|p| p.map(|c| [c; LANES])));
        } else if let Some(group) = self.groups.last_mut() {
            for (slot, c) in group.as_flattened_mut().iter_mut().zip(p.as_flattened()) {
                slot[lane] = *c;
            }
        }
    }

    /// Returns the positions of the nodes.
    pub(super) fn groups(&self) -> &[LinkGroup<f64>] {
        &self.groups
    }
}

/// Returns the positions of the three nodes of one tetrahedron of a group.
#[inline(always)]
pub(super) fn lane<T: Copy>(group: &LinkGroup<T>, l: usize) -> [[T; 3]; 3] {
    let [p, q, r] = group;
    [
        [p[0][l], p[1][l], p[2][l]],
        [q[0][l], q[1][l], q[2][l]],
        [r[0][l], r[1][l], r[2][l]],
    ]
}

/// Returns the smallest sine over the tetrahedra of the link for node 0 at `x`. Stops early when it
/// falls to `cutoff` or below.
pub fn worst_sine(x: [f64; 3], link: &NodeLink, cutoff: f64) -> f64 {
    let mut worst = f64::INFINITY;
    dispatch_simd(
        #[inline(always)]
        || {
            for group in &link.groups {
                let mut sines = [0.0; LANES];
                for l in 0..LANES {
                    let [p, q, r] = lane(group, l);
                    sines[l] = min_sine(&[x, p, q, r]);
                }
                for sine in sines {
                    worst = worst.min(sine);
                }
                if worst <= cutoff {
                    break;
                }
            }
        },
    );
    worst
}

/// Writes the smallest sine of each tetrahedron of the link, for node 0 at `x`, to `sines`.
pub fn link_sines(x: [f64; 3], link: &NodeLink, sines: &mut Vec<f32>) {
    sines.clear();
    dispatch_simd(
        #[inline(always)]
        || {
            for group in &link.groups {
                let mut values = [0.0; LANES];
                for l in 0..LANES {
                    let [p, q, r] = lane(group, l);
                    values[l] = min_sine(&[x, p, q, r]) as f32;
                }
                sines.extend_from_slice(&values);
            }
        },
    );
    sines.truncate(link.count);
}

/// Largest number of vectors of which the shortest vector in the hull is a combination.
const MAX_CORRAL: usize = 4;

/// Returns the shortest vector in the convex hull of `vectors` (Wolfe 1976).
fn shortest_in_hull(vectors: &[[f64; 3]]) -> [f64; 3] {
    let mut g = vectors.iter().copied().fold(vectors[0], |best, v| {
        if dot(v, v) < dot(best, best) { v } else { best }
    });
    // The vectors of which g is a combination, and their weights.
    let (mut corral, mut weights, mut count) = ([g; MAX_CORRAL], [1.0; MAX_CORRAL], 1);
    for _ in 0..20 {
        let (mut lowest, mut min_product) = (0, f64::INFINITY);
        for (i, v) in vectors.iter().enumerate() {
            let product = dot(*v, g);
            lowest = if product < min_product { i } else { lowest };
            min_product = min_product.min(product);
        }
        let gg = dot(g, g);
        if gg - min_product <= 1e-3 * gg || count == MAX_CORRAL {
            break;
        }
        (corral[count], weights[count]) = (vectors[lowest], 0.0);
        count = shorten(&mut corral, &mut weights, count + 1);
        let mut sum = [0.0; 3];
        for i in 0..count {
            sum = add_scaled(sum, weights[i], corral[i]);
        }
        if dot(sum, sum) >= gg {
            break;
        }
        g = sum;
    }
    g
}

/// Moves the weights of the first `count` vectors to those of the shortest vector in their hull, and
/// removes vectors without weight. Returns how many remain.
fn shorten(
    corral: &mut [[f64; 3]; MAX_CORRAL],
    weights: &mut [f64; MAX_CORRAL],
    mut count: usize,
) -> usize {
    while count > 1 {
        let target = affine_weights(&corral[..count]);
        // The share of the change on which all weights stay positive.
        let mut share = 1.0f64;
        for i in 0..count {
            if target[i] <= 0.0 {
                let decrease = weights[i] - target[i];
                share = share.min(if decrease > 0.0 {
                    weights[i] / decrease
                } else {
                    0.0
                });
            }
        }
        let mut kept = 0;
        for i in 0..count {
            let weight = weights[i] + share * (target[i] - weights[i]);
            if target[i] > 0.0 || weight > 1e-12 {
                (corral[kept], weights[kept]) = (corral[i], weight);
                kept += 1;
            }
        }
        if kept == count || kept == 0 {
            return count;
        }
        count = kept;
    }
    weights[0] = 1.0;
    1
}

/// Returns the weights, whose sum is 1, of the shortest vector in the affine hull of two to four
/// vectors.
fn affine_weights(vectors: &[[f64; 3]]) -> [f64; MAX_CORRAL] {
    let first = vectors[0];
    let edges: [[f64; 3]; 3] =
        std::array::from_fn(|i| vectors.get(i + 1).map_or([0.0; 3], |v| sub(*v, first)));
    let product = |i: usize, j: usize| dot(edges[i], edges[j]);
    let side = |i: usize| -dot(edges[i], first);
    let rest = match vectors.len() {
        2 => [solve_positive([[product(0, 0)]], [side(0)])[0], 0.0, 0.0],
        3 => {
            let matrix = std::array::from_fn(|i| std::array::from_fn(|j| product(i, j)));
            let [s, t] = solve_positive::<2>(matrix, [side(0), side(1)]);
            [s, t, 0.0]
        }
        _ => {
            let matrix = std::array::from_fn(|i| std::array::from_fn(|j| product(i, j)));
            solve_positive::<3>(matrix, [side(0), side(1), side(2)])
        }
    };
    [1.0 - rest[0] - rest[1] - rest[2], rest[0], rest[1], rest[2]]
}

/// Smallest gain in sine of a move.
const MIN_SINE_GAIN: f64 = 1e-3;

/// Scratch space of [`best_position`].
#[derive(Default)]
pub struct SmoothScratch {
    link: LocalLink,
    active: Vec<[f64; 3]>,
    plane_cache: PlaneCache,
}

/// Limits within which nodes are smoothed.
#[derive(Clone, Copy)]
pub struct SmoothingLimits<'a> {
    /// Far corner of the box.
    pub extent: [f64; 3],
    /// Local planes of the features.
    pub planes: &'a FeaturePlanes,
    /// Largest distance, in samples, of a node from the surfaces that hold it.
    pub max_deviation: f64,
    /// Sine at which smoothing of a node stops.
    pub target_sine: f64,
    /// Smallest gain in sine of one step, as a share of what is missing to 1 at the start.
    pub min_step_gain: f64,
}

/// Climbs from `start` to a position where the smallest sine around the node is larger, within the
/// constraints of the node and the limits. Returns the position and its smallest sine if the gain is
/// large enough.
pub fn best_position(
    start: [f64; 3],
    link: &NodeLink,
    constraint: &mut NodeConstraint,
    limits: SmoothingLimits<'_>,
    scratch: &mut SmoothScratch,
) -> Option<([f64; 3], f64)> {
    let (extent, max_deviation) = (limits.extent, limits.max_deviation);
    let min_distance = scratch.link.set(start, link);
    let start_sine = scratch.link.worst_sine(start, f64::NEG_INFINITY);
    let (mut x, mut best) = (start, start_sine);
    for _ in 0..12 {
        if best >= limits.target_sine {
            break;
        }
        scratch.link.compute_angles(x);
        let freedom = if max_deviation > 0.0 {
            constraint.without_surfaces().freedom()
        } else {
            constraint.freedom()
        };
        let mut band = 0.02;
        let mut moved = false;
        // Take a wider band of active angles if the narrow one gives no step.
        for _ in 0..2 {
            scratch.active.clear();
            let active = &mut scratch.active;
            (scratch.link).visit_gradients_below(best + band, |g| active.push(freedom.project(g)));
            if scratch.active.is_empty() {
                break;
            }
            let g = shortest_in_hull(&scratch.active);
            let gg = dot(g, g);
            if gg * min_distance * min_distance < 1e-6 {
                break;
            }
            // The step after which another angle becomes the smallest, by the linear model.
            let max_step = 0.5 * min_distance / gg.sqrt();
            let step = (scratch.link).step_to_next_angle(g, [best, best + band], gg, max_step);
            let mut trial_step = step.max(0.01 * min_distance / gg.sqrt());
            for _ in 0..5 {
                let mut trial = add_scaled(x, trial_step, g);
                for k in 0..3 {
                    if constraint.fixed_axes >> k & 1 == 0 {
                        trial[k] = trial[k].clamp(0.0, extent[k]);
                    }
                }
                // Test the straight step first: a position that is not better there is not worth
                // snapping onto the surfaces.
                let required = best + limits.min_step_gain * (1.0 - start_sine).max(0.1);
                let worthwhile = constraint.surface_count == 0
                    || scratch.link.worst_sine(trial, required) > required;
                let mut trial_constraint = *constraint;
                if worthwhile
                    && let Some(trial) = trial_constraint.snap_within(
                        max_deviation,
                        trial,
                        extent,
                        limits.planes,
                        &mut scratch.plane_cache,
                    )
                {
                    let value = scratch.link.worst_sine(trial, required);
                    if value > required {
                        (x, best, *constraint) = (trial, value, trial_constraint);
                        moved = true;
                        break;
                    }
                }
                trial_step *= 0.4;
            }
            if moved {
                break;
            }
            band *= 4.0;
        }
        if !moved {
            break;
        }
    }
    (best > start_sine + MIN_SINE_GAIN).then_some((x, best))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::norm;

    #[test]
    fn shortest_vector_of_a_square() {
        let square = [
            [1.0, 1.0, 0.5],
            [1.0, -1.0, 0.5],
            [2.0, 0.0, 0.5],
            [1.5, 0.3, 0.5],
        ];
        let g = shortest_in_hull(&square);
        assert!(norm(sub(g, [1.0, 0.0, 0.5])) < 1e-12, "{g:?}");
    }

    #[test]
    fn the_shortest_vector_is_in_the_hull_and_no_vector_is_behind_it() {
        let mut random = crate::geometry::random::Random::new(3);
        for case in 0..20_000 {
            let count = 1 + case % 9;
            // Vectors in space, in a plane, and along a line, some of them equal.
            let axes = 1 + case % 3;
            let shift = random.range(-1.0, 1.0);
            let mut vectors = Vec::new();
            for i in 0..count {
                let mut v = [0.0; 3];
                (0..axes).for_each(|k| v[k] = shift + random.range(-1.0, 1.0));
                vectors.push(if i == 3 { vectors[0] } else { v });
            }
            let g = shortest_in_hull(&vectors);
            let gg = dot(g, g);
            let min_product = vectors
                .iter()
                .map(|v| dot(*v, g))
                .fold(f64::INFINITY, f64::min);
            assert!(gg - min_product <= 1e-3 * gg + 1e-9, "{vectors:?} {g:?}");
            // g is in the hull: it lies behind no plane that has all vectors before it.
            for _ in 0..20 {
                let n: [f64; 3] = std::array::from_fn(|_| random.range(-1.0, 1.0));
                let least = vectors
                    .iter()
                    .map(|v| dot(*v, n))
                    .fold(f64::INFINITY, f64::min);
                assert!(dot(g, n) >= least - 1e-9, "{vectors:?} {g:?}");
            }
        }
    }

    #[test]
    fn a_node_in_an_octahedron_finds_the_middle() {
        let tips = [
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [-1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
        ];
        // The link is around the origin. Move it into the box.
        let shift = |p: [f64; 3]| p.map(|c| c + 4.0);
        let mut link = NodeLink::default();
        for i in 0..4 {
            let (a, b) = (tips[i], tips[(i + 1) % 4]);
            // (x, p0, p1, p2) is positive for x near the middle.
            link.push([a, b, [0.0, 0.0, 1.0]].map(shift));
            link.push([b, a, [0.0, 0.0, -1.0]].map(shift));
        }
        let planes = FeaturePlanes::new(&[], [9.0; 3], 1.0, 1.0);
        let mut constraint = NodeConstraint::default();
        let offset = [0.4, 0.2, -0.2];
        assert!(worst_sine(shift(offset), &link, f64::NEG_INFINITY) > 0.0);
        let (x, value) = best_position(
            shift(offset),
            &link,
            &mut constraint,
            SmoothingLimits {
                extent: [9.0; 3],
                planes: &planes,
                max_deviation: 0.0,
                target_sine: 1.0,
                min_step_gain: 1e-3,
            },
            &mut SmoothScratch::default(),
        )
        .unwrap();
        let middle = worst_sine([4.0; 3], &link, f64::NEG_INFINITY);
        assert!(value > middle - 0.02, "{value} of {middle} at {x:?}");
    }
}
