//! Moves a node to where the worst dihedral angle around it is best: optimisation-based smoothing
//! of a max-min objective (Freitag & Ollivier-Gooch 1997) on the sines of the dihedral angles.
//!
//! At a position, every angle of every tetrahedron at the node is a smooth function. The ascent
//! direction is the shortest vector in the convex hull of the gradients of the smallest ones: no
//! direction raises all of them faster. Nodes on features and sides move only along them.

use super::hold::Hold;
use super::sheets::Sheets;
use crate::mesh::{add_scaled, cross, dot, norm, sub};

/// One dihedral angle of a tetrahedron as a function of its node 0.
#[derive(Clone, Copy, Default)]
struct Angle {
    sine: f64,
    gradient: [f64; 3],
}

/// The six sines and their gradients with respect to node 0, `(x, p[0], p[1], p[2])` positive.
#[inline]
fn angles(x: [f64; 3], p: &[[f64; 3]; 3]) -> [Angle; 6] {
    let (a, b, c) = (sub(p[0], x), sub(p[1], x), sub(p[2], x));
    let (u, v, w) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[2], p[1]));
    let n3 = cross(a, b);
    let n2 = cross(a, c);
    let n1 = cross(b, c);
    let n0 = cross(u, v);
    let volume = dot(c, n3);
    let size = [norm(n0), norm(n1), norm(n2), norm(n3)].map(|s| s.max(1e-300));
    // d ln|n| for the three faces at node 0.
    let g1 = cross(n1, w).map(|t| t / (size[1] * size[1]));
    let g2 = cross(n2, v).map(|t| t / (size[2] * size[2]));
    let g3 = cross(n3, u).map(|t| t / (size[3] * size[3]));
    let none = [0.0; 3];
    let make = |edge: [f64; 3], at_node: bool, i: usize, j: usize, gi: [f64; 3], gj: [f64; 3]| {
        let l2 = dot(edge, edge).max(1e-300);
        let scale = l2.sqrt() / (size[i] * size[j]);
        let sine = volume * scale;
        let gradient = std::array::from_fn(|k| {
            let along = if at_node { -edge[k] / l2 } else { 0.0 };
            -scale * n0[k] + sine * (along - gi[k] - gj[k])
        });
        Angle { sine, gradient }
    };
    [
        make(a, true, 2, 3, g2, g3),
        make(b, true, 1, 3, g1, g3),
        make(c, true, 1, 2, g1, g2),
        make(u, false, 0, 3, none, g3),
        make(v, false, 0, 2, none, g2),
        make(w, false, 0, 1, none, g1),
    ]
}

/// The smallest sine over the star for node 0 at `x`; gives up below `enough`.
#[inline]
pub fn worst(x: [f64; 3], star: &[[[f64; 3]; 3]], enough: f64) -> f64 {
    let mut worst = f64::INFINITY;
    for p in star {
        worst = worst.min(crate::mesh::quality::min_sine(&[x, p[0], p[1], p[2]]));
        if worst <= enough {
            break;
        }
    }
    worst
}

/// The shortest vector in the convex hull of `vectors` (Gilbert's algorithm).
fn shortest_in_hull(vectors: &[[f64; 3]]) -> [f64; 3] {
    let mut g = vectors.iter().copied().fold(vectors[0], |best, v| {
        if dot(v, v) < dot(best, best) { v } else { best }
    });
    for _ in 0..40 {
        let lowest = vectors.iter().copied().fold(vectors[0], |best, v| {
            if dot(v, g) < dot(best, g) { v } else { best }
        });
        let gap = dot(g, g) - dot(lowest, g);
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
const GAIN: f64 = 1e-3;

/// Scratch space of [`best_position`].
#[derive(Default)]
pub struct Scratch {
    angles: Vec<Angle>,
    active: Vec<[f64; 3]>,
}

/// Climbs from `x` to a position where the smallest sine around the node is larger, keeping to what
/// holds the node. `star` has the other three nodes of each tetrahedron, oriented as in
/// `(x, p0, p1, p2)` positive. Stops at a sine of `enough`. Returns the position and its smallest
/// sine if that rose worthwhile.
pub fn best_position(
    start: [f64; 3],
    star: &[[[f64; 3]; 3]],
    hold: &mut Hold,
    extent: [f64; 3],
    sheets: &Sheets,
    enough: f64,
    scratch: &mut Scratch,
) -> Option<([f64; 3], f64)> {
    let first = worst(start, star, f64::NEG_INFINITY);
    let (mut x, mut best) = (start, first);
    let size = star
        .iter()
        .flatten()
        .map(|p| norm(sub(*p, start)))
        .fold(f64::INFINITY, f64::min);
    for _ in 0..12 {
        if best >= enough {
            break;
        }
        scratch.angles.clear();
        for p in star {
            scratch
                .angles
                .extend(angles(x, p).iter().filter(|a| a.sine < best + 0.35));
        }
        let mut band = 0.02;
        let mut moved = false;
        // A wider band of active angles if the narrow one gives no step.
        for _ in 0..2 {
            scratch.active.clear();
            for a in scratch.angles.iter().filter(|a| a.sine <= best + band) {
                scratch.active.push(hold.project(a.gradient));
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
            for a in &scratch.angles {
                let rate = dot(a.gradient, g);
                if a.sine > best + band && rate < gg {
                    step = step.min((a.sine - best) / (gg - rate));
                }
            }
            let mut trial_step = step.max(0.01 * size / gg.sqrt());
            for _ in 0..5 {
                let mut trial = add_scaled(x, trial_step, g);
                for k in 0..3 {
                    if hold.axes >> k & 1 == 0 {
                        trial[k] = trial[k].clamp(0.0, extent[k]);
                    }
                }
                let mut trial_hold = *hold;
                if let Some(trial) = trial_hold.settle(trial, extent, sheets) {
                    let value = worst(trial, star, best);
                    if value > best + 1e-3 * (1.0 - first).max(0.1) {
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
    (best > first + GAIN).then_some((x, best))
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
            let volume = crate::mesh::volume6(&[x, p[0], p[1], p[2]]);
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
        let mut star = Vec::new();
        for i in 0..4 {
            let (a, b) = (tips[i], tips[(i + 1) % 4]);
            // (x, p0, p1, p2) positive with x near the middle.
            star.push([a, b, [0.0, 0.0, 1.0]]);
            star.push([b, a, [0.0, 0.0, -1.0]]);
        }
        let sheets = Sheets::new(&[], [9.0; 3], 1.0, 1.0);
        let mut hold = Hold::default();
        let off = [0.4, 0.2, -0.2];
        // The star lies round the origin: allow negative positions by shifting it into the box.
        let shift = |p: [f64; 3]| p.map(|c| c + 4.0);
        let star: Vec<_> = star.iter().map(|t| t.map(shift)).collect();
        assert!(worst(shift(off), &star, f64::NEG_INFINITY) > 0.0);
        let (x, value) = best_position(
            shift(off),
            &star,
            &mut hold,
            [9.0; 3],
            &sheets,
            1.0,
            &mut Scratch::default(),
        )
        .unwrap();
        let middle = worst([4.0; 3], &star, f64::NEG_INFINITY);
        assert!(value > middle - 0.02, "{value} of {middle} at {x:?}");
    }
}
