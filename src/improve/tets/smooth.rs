//! Moves a node to where the worst dihedral angle around it is best: optimisation-based smoothing
//! of a max-min objective (Freitag & Ollivier-Gooch 1997) on the sines of the dihedral angles.
//!
//! Every angle of every tetrahedron at the node is a smooth function of its position. The ascent
//! direction is the shortest vector in the convex hull of the gradients of the smallest sines: no
//! direction raises all of them faster. Nodes on features and sides of the box move only along
//! them.

use crate::geometry::simd::dispatch_simd;
use crate::geometry::{add_scaled, cross, dot, norm, sub};
use crate::improve::constraint::NodeConstraint;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::plane_cache::PlaneCache;
use crate::mesh::quality::min_sine;

/// Sine of one dihedral angle of a tetrahedron, and its gradient with respect to node 0.
#[derive(Clone, Copy, Default)]
struct Angle {
    sine: f64,
    gradient: [f64; 3],
}

/// Number of tetrahedra that are processed side by side in SIMD lanes.
const LANES: usize = 8;

/// The link of a node x: for each tetrahedron at x the positions of its other three nodes, such
/// that `(x, p0, p1, p2)` is positive.
#[derive(Default)]
pub struct NodeLink {
    /// Coordinates by node, axis and tetrahedron. The last group is filled up with its first
    /// tetrahedron, which changes no minimum.
    groups: Vec<[[[f64; LANES]; 3]; 3]>,
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

    /// Returns the distance from `x` to the nearest of the nodes.
    fn nearest_distance(&self, x: [f64; 3]) -> f64 {
        let mut min_square = f64::INFINITY;
        for node in self.groups.as_flattened() {
            for l in 0..LANES {
                let offset = sub([node[0][l], node[1][l], node[2][l]], x);
                min_square = min_square.min(dot(offset, offset));
            }
        }
        min_square.sqrt()
    }
}

#[inline(always)]
fn lane(group: &[[[f64; LANES]; 3]; 3], l: usize) -> [[f64; 3]; 3] {
    let [p, q, r] = group;
    [
        [p[0][l], p[1][l], p[2][l]],
        [q[0][l], q[1][l], q[2][l]],
        [r[0][l], r[1][l], r[2][l]],
    ]
}

/// Returns the six sines and their gradients with respect to node 0 of the tetrahedron `(x, p[0],
/// p[1], p[2])`, which must be positive.
#[inline(always)]
fn angles(x: [f64; 3], p: &[[f64; 3]; 3]) -> [Angle; 6] {
    let (a, b, c) = (sub(p[0], x), sub(p[1], x), sub(p[2], x));
    let (u, v, w) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[2], p[1]));
    let normals = [cross(u, v), cross(b, c), cross(a, c), cross(a, b)];
    let volume = dot(c, normals[3]);
    let mut inverse = [0.0; 4];
    for k in 0..4 {
        inverse[k] = 1.0 / norm(normals[k]).max(1e-300);
    }
    // Gradients of the logarithm of each normal's length, without a factor; the normal opposite
    // node 0 does not change.
    let turned_normals = [
        [0.0; 3],
        cross(normals[1], w),
        cross(normals[2], v),
        cross(normals[3], u),
    ];
    let mut growth = [[0.0; 3]; 4];
    for i in 1..4 {
        for k in 0..3 {
            growth[i][k] = turned_normals[i][k] * (inverse[i] * inverse[i]);
        }
    }
    // Each edge, whether it is at node 0 (1 or 0), and the two faces that meet at it.
    let edges = [
        (a, 1.0, 2, 3),
        (b, 1.0, 1, 3),
        (c, 1.0, 1, 2),
        (u, 0.0, 0, 3),
        (v, 0.0, 0, 2),
        (w, 0.0, 0, 1),
    ];
    let mut result = [Angle::default(); 6];
    for e in 0..6 {
        let (edge, at_node, i, j) = edges[e];
        let square = dot(edge, edge).max(1e-300);
        let scale = square.sqrt() * (inverse[i] * inverse[j]);
        let sine = volume * scale;
        let inverse_square = at_node / square;
        result[e].sine = sine;
        for k in 0..3 {
            let log_change = -edge[k] * inverse_square - growth[i][k] - growth[j][k];
            result[e].gradient[k] = sine * log_change - scale * normals[0][k];
        }
    }
    result
}

/// Writes the angles at `x` whose sines are below `limit` to the beginning of `buffer`, and returns
/// them.
fn angles_below<'a>(
    limit: f64,
    x: [f64; 3],
    link: &NodeLink,
    buffer: &'a mut Vec<Angle>,
) -> &'a [Angle] {
    // The buffer has room for all angles, so that the selection needs no branch.
    let capacity = 6 * LANES * link.groups.len();
    if buffer.len() < capacity {
        buffer.resize(capacity, Angle::default());
    }
    let mut count = 0;
    dispatch_simd(
        #[inline(always)]
        || {
            for group in &link.groups {
                let mut sines = [[0.0; LANES]; 6];
                let mut gradients = [[[0.0; LANES]; 3]; 6];
                for l in 0..LANES {
                    let angles = angles(x, &lane(group, l));
                    for e in 0..6 {
                        sines[e][l] = angles[e].sine;
                        for k in 0..3 {
                            gradients[e][k][l] = angles[e].gradient[k];
                        }
                    }
                }
                for l in 0..LANES {
                    for e in 0..6 {
                        let [u, v, w] = &gradients[e];
                        buffer[count] = Angle {
                            sine: sines[e][l],
                            gradient: [u[l], v[l], w[l]],
                        };
                        count += usize::from(sines[e][l] < limit);
                    }
                }
            }
        },
    );
    &buffer[..count]
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

/// Returns the shortest vector in the convex hull of `vectors` (Gilbert's algorithm).
fn shortest_in_hull(vectors: &[[f64; 3]]) -> [f64; 3] {
    let mut g = vectors.iter().copied().fold(vectors[0], |best, v| {
        if dot(v, v) < dot(best, best) { v } else { best }
    });
    for _ in 0..40 {
        let (mut lowest, mut min_product) = (0, f64::INFINITY);
        for (i, v) in vectors.iter().enumerate() {
            let product = dot(*v, g);
            lowest = if product < min_product { i } else { lowest };
            min_product = min_product.min(product);
        }
        let lowest = vectors[lowest];
        let gap = dot(g, g) - min_product;
        if gap <= 1e-3 * dot(g, g) {
            break;
        }
        let step = sub(lowest, g);
        let t = (-dot(g, step) / dot(step, step)).clamp(0.0, 1.0);
        g = add_scaled(g, t, step);
    }
    g
}

/// Smallest gain in sine of a move.
const MIN_SINE_GAIN: f64 = 1e-3;

/// Scratch space of [`best_position`].
#[derive(Default)]
pub struct SmoothScratch {
    angles: Vec<Angle>,
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
    let start_sine = worst_sine(start, link, f64::NEG_INFINITY);
    let (mut x, mut best) = (start, start_sine);
    let min_distance = link.nearest_distance(start);
    for _ in 0..12 {
        if best >= limits.target_sine {
            break;
        }
        let angles = angles_below(best + 0.35, x, link, &mut scratch.angles);
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
            for a in angles.iter().filter(|a| a.sine <= best + band) {
                scratch.active.push(freedom.project(a.gradient));
            }
            if scratch.active.is_empty() {
                break;
            }
            let g = shortest_in_hull(&scratch.active);
            let gg = dot(g, g);
            if gg * min_distance * min_distance < 1e-6 {
                break;
            }
            // The step after which another angle becomes the smallest, by the linear model.
            let mut step = 0.5 * min_distance / gg.sqrt();
            for a in angles {
                let rate = dot(a.gradient, g);
                if a.sine > best + band && rate < gg {
                    step = step.min((a.sine - best) / (gg - rate));
                }
            }
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
                let worthwhile =
                    constraint.surface_count == 0 || worst_sine(trial, link, required) > required;
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
                    let value = worst_sine(trial, link, required);
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
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn gradients_agree_with_finite_differences(
            c in proptest::array::uniform12(-1.0f64..1.0)
        ) {
            let x = [c[0], c[1], c[2]];
            let p = [[c[3], c[4], c[5]], [c[6], c[7], c[8]], [c[9], c[10], c[11]]];
            let volume = crate::geometry::volume6(&[x, p[0], p[1], p[2]]);
            prop_assume!(volume.abs() > 0.05);
            let computed = angles(x, &p);
            let smallest = computed.iter().map(|a| a.sine).fold(f64::INFINITY, f64::min);
            let direct = crate::mesh::quality::min_sine(&[x, p[0], p[1], p[2]]);
            if volume > 0.0 {
                prop_assert!((smallest - direct).abs() < 1e-12);
            }
            let h = 1e-6;
            for k in 0..3 {
                let (mut low, mut high) = (x, x);
                low[k] -= h;
                high[k] += h;
                let (low, high) = (angles(low, &p), angles(high, &p));
                for e in 0..6 {
                    let numeric = (high[e].sine - low[e].sine) / (2.0 * h);
                    prop_assert!((numeric - computed[e].gradient[k]).abs() < 1e-5 * (1.0 + numeric.abs()));
                }
            }
        }
    }

    #[test]
    fn shortest_vector_of_a_square() {
        let square = [
            [1.0, 1.0, 0.5],
            [1.0, -1.0, 0.5],
            [2.0, 0.0, 0.5],
            [1.5, 0.3, 0.5],
        ];
        let g = shortest_in_hull(&square);
        assert!(norm(sub(g, [1.0, 0.0, 0.5])) < 0.05, "{g:?}");
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
