//! The dihedral angles around a node that moves, in single precision: positions are relative to
//! where the node starts. Eight tetrahedra are processed side by side in SIMD lanes.

use super::smooth::{LANES, LinkGroup, NodeLink, lane};
use crate::geometry::simd::dispatch_simd;
use crate::geometry::vector::Real;
use crate::geometry::{cross, dot, sub};

/// Sine of one dihedral angle of a tetrahedron, and its gradient with respect to node 0.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Angle<T> {
    pub sine: T,
    pub gradient: [T; 3],
}

/// Smallest square of a normal's length, in units of the link's size to the fourth power, that is
/// not taken as this value. It keeps products of inverses finite.
const MIN_NORMAL_SQUARE: f32 = 1e-18;

/// Returns the six sines and their gradients with respect to node 0 of the tetrahedron `(x, p[0],
/// p[1], p[2])`.
#[inline(always)]
fn angles<T: Real + From<f32>>(x: [T; 3], p: &[[T; 3]; 3]) -> [Angle<T>; 6] {
    let (a, b, c) = (sub(p[0], x), sub(p[1], x), sub(p[2], x));
    let (u, v, w) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[2], p[1]));
    let normals = [cross(u, v), cross(b, c), cross(a, c), cross(a, b)];
    let volume = dot(c, normals[3]);
    let (one, floor) = (T::from(1.0), T::from(MIN_NORMAL_SQUARE));
    let inverse = |square: T| one / if square > floor { square } else { floor };
    let mut inverses = [floor; 4];
    for k in 0..4 {
        inverses[k] = inverse(dot(normals[k], normals[k]));
    }
    // Gradients of the logarithm of each normal's length, times the volume; the normal opposite node
    // 0 does not change.
    let turned_normals = [
        [T::default(); 3],
        cross(normals[1], w),
        cross(normals[2], v),
        cross(normals[3], u),
    ];
    let mut growth = [[T::default(); 3]; 4];
    for i in 1..4 {
        let factor = volume * inverses[i];
        for k in 0..3 {
            growth[i][k] = turned_normals[i][k] * factor;
        }
    }
    let mut result = [Angle {
        sine: floor,
        gradient: [floor; 3],
    }; 6];
    // Each edge at node 0, and the two faces that meet at it.
    let inner_edges = [(a, 2, 3), (b, 1, 3), (c, 1, 2)];
    for e in 0..3 {
        let (edge, i, j) = inner_edges[e];
        let square = dot(edge, edge);
        let scale = (square * (inverses[i] * inverses[j])).sqrt();
        let stretch = volume * inverse(square);
        result[e].sine = volume * scale;
        for k in 0..3 {
            let change = edge[k] * stretch + growth[i][k] + growth[j][k] + normals[0][k];
            result[e].gradient[k] = T::default() - scale * change;
        }
    }
    // Each edge opposite node 0, and the face at node 0 that meets the fixed face at it.
    let outer_edges = [(u, 3), (v, 2), (w, 1)];
    for e in 0..3 {
        let (edge, i) = outer_edges[e];
        let scale = (dot(edge, edge) * (inverses[0] * inverses[i])).sqrt();
        result[3 + e].sine = volume * scale;
        for k in 0..3 {
            let change = growth[i][k] + normals[0][k];
            result[3 + e].gradient[k] = T::default() - scale * change;
        }
    }
    result
}

/// Returns the square of the smallest sine, with the sign of the volume.
#[inline(always)]
fn signed_square<T: Real + From<f32>>(x: [T; 3], p: &[[T; 3]; 3]) -> T {
    let (a, b, c) = (sub(p[0], x), sub(p[1], x), sub(p[2], x));
    let (u, v, w) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[2], p[1]));
    let normals = [cross(u, v), cross(b, c), cross(a, c), cross(a, b)];
    let volume = dot(c, normals[3]);
    let (one, floor) = (T::from(1.0), T::from(MIN_NORMAL_SQUARE));
    let mut r = [floor; 4];
    for k in 0..4 {
        let square = dot(normals[k], normals[k]);
        r[k] = one / if square > floor { square } else { floor };
    }
    let min = |a: T, b: T| if b < a { b } else { a };
    let mut smallest = dot(a, a) * (r[2] * r[3]);
    smallest = min(smallest, dot(b, b) * (r[1] * r[3]));
    smallest = min(smallest, dot(c, c) * (r[1] * r[2]));
    smallest = min(smallest, dot(u, u) * (r[0] * r[3]));
    smallest = min(smallest, dot(v, v) * (r[0] * r[2]));
    smallest = min(smallest, dot(w, w) * (r[0] * r[1]));
    let square = smallest * volume * volume;
    if volume > T::default() {
        square
    } else {
        T::default() - square
    }
}

/// The angles of eight tetrahedra, by edge.
#[derive(Debug, Clone, Copy)]
struct AngleGroup {
    sines: [[f32; LANES]; 6],
    gradients: [[[f32; LANES]; 3]; 6],
}

/// The link of a node, relative to a position and in units of its size there.
#[derive(Debug, Default)]
pub(super) struct LocalLink {
    origin: [f64; 3],
    /// Distance from the origin to the farthest node.
    size: f64,
    groups: Vec<LinkGroup<f32>>,
    angle_groups: Vec<AngleGroup>,
}

impl LocalLink {
    /// Replaces the link. Returns the distance from `origin` to the nearest node.
    pub fn set(&mut self, origin: [f64; 3], link: &NodeLink) -> f64 {
        let (mut min_squares, mut max_squares) = ([f64::INFINITY; LANES], [0.0f64; LANES]);
        let groups = &mut self.groups;
        groups.resize(link.groups().len(), LinkGroup::default());
        dispatch_simd(
            #[inline(always)]
            || {
                for node in link.groups().as_flattened() {
                    for l in 0..LANES {
                        let offset = sub([node[0][l], node[1][l], node[2][l]], origin);
                        let square = dot(offset, offset);
                        min_squares[l] = min_squares[l].min(square);
                        max_squares[l] = max_squares[l].max(square);
                    }
                }
                let max_square = max_squares.iter().fold(1e-300, |m, s| s.max(m));
                let scale = 1.0 / max_square.sqrt();
                let nodes = link.groups().as_flattened();
                for (to, from) in groups.as_flattened_mut().iter_mut().zip(nodes) {
                    for k in 0..3 {
                        for l in 0..LANES {
                            to[k][l] = ((from[k][l] - origin[k]) * scale) as f32;
                        }
                    }
                }
            },
        );
        self.origin = origin;
        self.size = max_squares.iter().fold(1e-300, |m, s| s.max(m)).sqrt();
        min_squares
            .iter()
            .fold(f64::INFINITY, |m, s| s.min(m))
            .sqrt()
    }

    /// Returns a position relative to the origin.
    fn local(&self, x: [f64; 3]) -> [f32; 3] {
        sub(x, self.origin).map(|c| (c / self.size) as f32)
    }

    /// Returns the smallest sine over the tetrahedra for node 0 at `x`. Stops early when it falls to
    /// `cutoff` or below.
    pub fn worst_sine(&self, x: [f64; 3], cutoff: f64) -> f64 {
        let y = self.local(x);
        let cutoff = (cutoff * cutoff.abs()) as f32;
        let mut worst = f32::INFINITY;
        dispatch_simd(
            #[inline(always)]
            || {
                for group in &self.groups {
                    let mut squares = [0.0; LANES];
                    for l in 0..LANES {
                        squares[l] = signed_square(y, &lane(group, l));
                    }
                    for square in squares {
                        worst = if square < worst { square } else { worst };
                    }
                    if worst <= cutoff {
                        break;
                    }
                }
            },
        );
        let worst = f64::from(worst);
        worst.signum() * worst.abs().sqrt()
    }

    /// Computes all angles for node 0 at `x`.
    pub fn compute_angles(&mut self, x: [f64; 3]) {
        let y = self.local(x);
        let Self {
            groups,
            angle_groups,
            ..
        } = self;
        let empty = AngleGroup {
            sines: [[0.0; LANES]; 6],
            gradients: [[[0.0; LANES]; 3]; 6],
        };
        angle_groups.resize(groups.len(), empty);
        dispatch_simd(
            #[inline(always)]
            || {
                for (group, result) in groups.iter().zip(&mut *angle_groups) {
                    for l in 0..LANES {
                        let angles = angles(y, &lane(group, l));
                        for e in 0..6 {
                            result.sines[e][l] = angles[e].sine;
                            for k in 0..3 {
                                result.gradients[e][k][l] = angles[e].gradient[k];
                            }
                        }
                    }
                }
            },
        );
    }

    /// Calls `visit` with the gradient of each computed sine of at most `limit`.
    pub fn visit_gradients_below(&self, limit: f64, mut visit: impl FnMut([f64; 3])) {
        let limit = limit as f32;
        let inverse = 1.0 / self.size;
        for group in &self.angle_groups {
            for (sines, gradients) in group.sines.iter().zip(&group.gradients) {
                let mut bits = 0u32;
                for l in 0..LANES {
                    bits |= u32::from(sines[l] <= limit) << l;
                }
                while bits != 0 {
                    let l = bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    visit(std::array::from_fn(|k| {
                        f64::from(gradients[k][l]) * inverse
                    }));
                }
            }
        }
    }

    /// Returns the smallest step along `direction` after which, by the linear model, the sine of
    /// another angle is as small as those of the active angles: `best` at the beginning, and rising
    /// by `rate`. The others are those above `limit`. Returns at most `max_step`.
    pub fn step_to_next_angle(
        &self,
        direction: [f64; 3],
        [best, limit]: [f64; 2],
        rate: f64,
        max_step: f64,
    ) -> f64 {
        let direction = direction.map(|c| (c / self.size) as f32);
        let (best, limit, rate) = (best as f32, limit as f32, rate as f32);
        let mut steps = [max_step as f32; LANES];
        dispatch_simd(
            #[inline(always)]
            || {
                for group in &self.angle_groups {
                    for e in 0..6 {
                        let (sines, gradients) = (&group.sines[e], &group.gradients[e]);
                        for l in 0..LANES {
                            let gradient = [gradients[0][l], gradients[1][l], gradients[2][l]];
                            let approach = rate - dot(gradient, direction);
                            let step = (sines[l] - best) / approach;
                            let is_limit =
                                (sines[l] > limit) & (approach > 0.0) & (step < steps[l]);
                            steps[l] = if is_limit { step } else { steps[l] };
                        }
                    }
                }
            },
        );
        f64::from(steps.iter().fold(f32::INFINITY, |m, s| s.min(m)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::quality::min_sine;
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
            let direct = min_sine(&[x, p[0], p[1], p[2]]);
            let square = signed_square(x, &p);
            prop_assert!((square - direct * direct.abs()).abs() < 1e-12);
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
            let single = |p: [f64; 3]| p.map(|c| c as f32);
            for (a, b) in computed.iter().zip(angles(single(x), &p.map(single))) {
                let length = crate::geometry::norm(a.gradient);
                prop_assert!((a.sine - f64::from(b.sine)).abs() < 1e-4);
                for k in 0..3 {
                    prop_assert!((a.gradient[k] - f64::from(b.gradient[k])).abs() < 1e-3 * (1.0 + length));
                }
            }
        }
    }

    #[test]
    fn a_local_link_measures_as_the_link_does() {
        let mut random = crate::geometry::random::Random::new(5);
        let origin = [4000.0, 70.0, 300.0];
        let mut link = NodeLink::default();
        for _ in 0..21 {
            // The corner of a cube, turned and distorted.
            let axes = [[9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 9.0]];
            link.push(
                axes.map(|axis| axis.map(|c: f64| c + random.range(-1.0, 1.0)))
                    .map(|p| std::array::from_fn(|k| origin[k] + p[k])),
            );
        }
        let mut local = LocalLink::default();
        let min_distance = local.set(origin, &link);
        assert!(min_distance > 8.0 && min_distance < 10.0, "{min_distance}");
        for _ in 0..50 {
            let x: [f64; 3] = std::array::from_fn(|k| origin[k] + random.range(-2.0, 2.0));
            let exact = super::super::smooth::worst_sine(x, &link, f64::NEG_INFINITY);
            let worst = local.worst_sine(x, f64::NEG_INFINITY);
            assert!((exact - worst).abs() < 1e-5, "{exact} {worst}");
            local.compute_angles(x);
            let (mut count, mut total) = (0, 0);
            local.visit_gradients_below(worst + 1e-5, |_| count += 1);
            local.visit_gradients_below(2.0, |_| total += 1);
            assert!(count >= 1 && total == 6 * 3 * LANES, "{count} {total}");
        }
    }
}
