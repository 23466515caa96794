//! Moves a node to where the worst dihedral angle around it is best: optimisation-based smoothing
//! of a max-min objective (Freitag & Ollivier-Gooch 1997) on the sines of the dihedral angles.
//!
//! At a position, every angle of every tetrahedron at the node is a smooth function. The ascent
//! direction is the shortest vector in the convex hull of the gradients of the smallest ones: no
//! direction raises all of them faster. Nodes on features and sides move only along them.

use crate::geometry::simd::dispatch_simd;
use crate::geometry::{add_scaled, cross, dot, norm, sub};
use crate::improve::constraint::NodeConstraint;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::plane_cache::PlaneCache;
use crate::mesh::quality::min_sine;

/// One dihedral angle of a tetrahedron as a function of its node 0.
#[derive(Clone, Copy, Default)]
struct Angle {
    sine: f64,
    gradient: [f64; 3],
}

/// Tetrahedra are worked on side by side, so many at a time.
const LANES: usize = 8;

/// The tetrahedra at a node x: for each the positions of the other three nodes, `(x, p0, p1, p2)`
/// positive.
#[derive(Default)]
pub struct NodeLink {
    /// By node, axis and tetrahedron. The last group is filled up with its first tetrahedron, which
    /// changes no minimum.
    groups: Vec<[[[f64; LANES]; 3]; 3]>,
    count: usize,
}

impl NodeLink {
    /// Forgets all.
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
            for (place, c) in group.as_flattened_mut().iter_mut().zip(p.as_flattened()) {
                place[lane] = *c;
            }
        }
    }

    /// Distance from `x` to the nearest of the nodes.
    fn nearest_distance(&self, x: [f64; 3]) -> f64 {
        let mut least = f64::INFINITY;
        for node in self.groups.as_flattened() {
            for l in 0..LANES {
                let gap = sub([node[0][l], node[1][l], node[2][l]], x);
                least = least.min(dot(gap, gap));
            }
        }
        least.sqrt()
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

/// The six sines and their gradients with respect to node 0, `(x, p[0], p[1], p[2])` positive.
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
    // d ln|n| of the faces; that opposite node 0 stays as it is.
    let turned = [
        [0.0; 3],
        cross(normals[1], w),
        cross(normals[2], v),
        cross(normals[3], u),
    ];
    let mut growth = [[0.0; 3]; 4];
    for i in 1..4 {
        for k in 0..3 {
            growth[i][k] = turned[i][k] * (inverse[i] * inverse[i]);
        }
    }
    // Each edge, whether it is at node 0, and the faces that meet there.
    let edges = [
        (a, 1.0, 2, 3),
        (b, 1.0, 1, 3),
        (c, 1.0, 1, 2),
        (u, 0.0, 0, 3),
        (v, 0.0, 0, 2),
        (w, 0.0, 0, 1),
    ];
    let mut found = [Angle::default(); 6];
    for e in 0..6 {
        let (edge, at_node, i, j) = edges[e];
        let square = dot(edge, edge).max(1e-300);
        let scale = square.sqrt() * (inverse[i] * inverse[j]);
        let sine = volume * scale;
        let along = at_node / square;
        found[e].sine = sine;
        for k in 0..3 {
            let change = -edge[k] * along - growth[i][k] - growth[j][k];
            found[e].gradient[k] = sine * change - scale * normals[0][k];
        }
    }
    found
}

/// Puts the angles at `x` whose sines are below `limit` at the beginning of `found`.
fn angles_below<'a>(
    limit: f64,
    x: [f64; 3],
    star: &NodeLink,
    found: &'a mut Vec<Angle>,
) -> &'a [Angle] {
    // Room for all, so that which are kept needs no branch.
    let room = 6 * LANES * star.groups.len();
    if found.len() < room {
        found.resize(room, Angle::default());
    }
    let mut count = 0;
    dispatch_simd(
        #[inline(always)]
        || {
            for group in &star.groups {
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
                        found[count] = Angle {
                            sine: sines[e][l],
                            gradient: [u[l], v[l], w[l]],
                        };
                        count += usize::from(sines[e][l] < limit);
                    }
                }
            }
        },
    );
    &found[..count]
}

/// The smallest sine over the star for node 0 at `x`; gives up below `enough`.
pub fn worst_sine(x: [f64; 3], star: &NodeLink, enough: f64) -> f64 {
    let mut worst = f64::INFINITY;
    dispatch_simd(
        #[inline(always)]
        || {
            for group in &star.groups {
                let mut sines = [0.0; LANES];
                for l in 0..LANES {
                    let [p, q, r] = lane(group, l);
                    sines[l] = min_sine(&[x, p, q, r]);
                }
                for sine in sines {
                    worst = worst.min(sine);
                }
                if worst <= enough {
                    break;
                }
            }
        },
    );
    worst
}

/// The shortest vector in the convex hull of `vectors` (Gilbert's algorithm).
fn shortest_in_hull(vectors: &[[f64; 3]]) -> [f64; 3] {
    let mut g = vectors.iter().copied().fold(vectors[0], |best, v| {
        if dot(v, v) < dot(best, best) { v } else { best }
    });
    for _ in 0..40 {
        let (mut lowest, mut least) = (0, f64::INFINITY);
        for (i, v) in vectors.iter().enumerate() {
            let along = dot(*v, g);
            lowest = if along < least { i } else { lowest };
            least = least.min(along);
        }
        let lowest = vectors[lowest];
        let gap = dot(g, g) - least;
        if gap <= 1e-3 * dot(g, g) {
            break;
        }
        let step = sub(lowest, g);
        let t = (-dot(g, step) / dot(step, step)).clamp(0.0, 1.0);
        g = add_scaled(g, t, step);
    }
    g
}

/// A move must raise the smallest sine by this much.
const MIN_SINE_GAIN: f64 = 1e-3;

/// Scratch space of [`best_position`].
#[derive(Default)]
pub struct SmoothScratch {
    angles: Vec<Angle>,
    active: Vec<[f64; 3]>,
    plane_cache: PlaneCache,
}

/// Climbs from `x` to a position where the smallest sine around the node is larger, keeping to what
/// holds the node. Stops at a sine of `enough`. Returns the position and its smallest sine if that
/// rose worthwhile.
pub fn best_position(
    start: [f64; 3],
    star: &NodeLink,
    hold: &mut NodeConstraint,
    extent: [f64; 3],
    sheets: &FeaturePlanes,
    stray: f64,
    enough: f64,
    scratch: &mut SmoothScratch,
) -> Option<([f64; 3], f64)> {
    let first = worst_sine(start, star, f64::NEG_INFINITY);
    let (mut x, mut best) = (start, first);
    let size = star.nearest_distance(start);
    for _ in 0..12 {
        if best >= enough {
            break;
        }
        let angles = angles_below(best + 0.35, x, star, &mut scratch.angles);
        let freedom = match stray > 0.0 {
            true => hold.without_surfaces().freedom(),
            false => hold.freedom(),
        };
        let mut band = 0.02;
        let mut moved = false;
        // A wider band of active angles if the narrow one gives no step.
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
            if gg * size * size < 1e-6 {
                break;
            }
            // The step after which another angle becomes the smallest, by the linear model.
            let mut step = 0.5 * size / gg.sqrt();
            for a in angles {
                let rate = dot(a.gradient, g);
                if a.sine > best + band && rate < gg {
                    step = step.min((a.sine - best) / (gg - rate));
                }
            }
            let mut trial_step = step.max(0.01 * size / gg.sqrt());
            for _ in 0..5 {
                let mut trial = add_scaled(x, trial_step, g);
                for k in 0..3 {
                    if hold.fixed_axes >> k & 1 == 0 {
                        trial[k] = trial[k].clamp(0.0, extent[k]);
                    }
                }
                // Off the sheets first, along which it has gone straight: what is no better there is not
                // worth putting onto them.
                let least = best + 1e-3 * (1.0 - first).max(0.1);
                let worthwhile = hold.surface_count == 0 || worst_sine(trial, star, least) > least;
                let mut trial_hold = *hold;
                if worthwhile
                    && let Some(trial) = trial_hold.snap_within(
                        stray,
                        trial,
                        extent,
                        sheets,
                        &mut scratch.plane_cache,
                    )
                {
                    let value = worst_sine(trial, star, least);
                    if value > least {
                        (x, best, *hold) = (trial, value, trial_hold);
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
    (best > first + MIN_SINE_GAIN).then_some((x, best))
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
            let at = angles(x, &p);
            let smallest = at.iter().map(|a| a.sine).fold(f64::INFINITY, f64::min);
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
                    prop_assert!((numeric - at[e].gradient[k]).abs() < 1e-5 * (1.0 + numeric.abs()));
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
        // The star lies round the origin: move it into the box.
        let shift = |p: [f64; 3]| p.map(|c| c + 4.0);
        let mut star = NodeLink::default();
        for i in 0..4 {
            let (a, b) = (tips[i], tips[(i + 1) % 4]);
            // (x, p0, p1, p2) positive with x near the middle.
            star.push([a, b, [0.0, 0.0, 1.0]].map(shift));
            star.push([b, a, [0.0, 0.0, -1.0]].map(shift));
        }
        let sheets = FeaturePlanes::new(&[], [9.0; 3], 1.0, 1.0);
        let mut hold = NodeConstraint::default();
        let off = [0.4, 0.2, -0.2];
        assert!(worst_sine(shift(off), &star, f64::NEG_INFINITY) > 0.0);
        let (x, value) = best_position(
            shift(off),
            &star,
            &mut hold,
            [9.0; 3],
            &sheets,
            0.0,
            1.0,
            &mut SmoothScratch::default(),
        )
        .unwrap();
        let middle = worst_sine([4.0; 3], &star, f64::NEG_INFINITY);
        assert!(value > middle - 0.02, "{value} of {middle} at {x:?}");
    }
}
