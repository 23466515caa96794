//! Max-min smoothing: moves a node to where the smallest angle around it is largest.

use super::TriImprover;
use crate::geometry::{dot, hypot, to_3d};
use crate::mesh::tri::{SIDES, worst_cotangent};

/// Directions in which a node is moved, as cosine and sine of multiples of 12 degrees. They are
/// literals because the functions of the C library differ among systems in the last digit.
#[rustfmt::skip]
const DIRECTIONS: [[f64; 2]; 30] = [
    [1.0, 0.0],
    [0.9781476007338057, 0.20791169081775931],
    [0.9135454576426009, 0.40673664307580015],
    [0.8090169943749475, 0.5877852522924731],
    [0.6691306063588582, 0.7431448254773941],
    [0.5000000000000001, 0.8660254037844386],
    [0.30901699437494745, 0.9510565162951535],
    [0.10452846326765346, 0.9945218953682733],
    [-0.10452846326765333, 0.9945218953682734],
    [-0.30901699437494734, 0.9510565162951536],
    [-0.4999999999999998, 0.8660254037844387],
    [-0.6691306063588579, 0.7431448254773945],
    [-0.8090169943749473, 0.5877852522924732],
    [-0.913545457642601, 0.40673664307580004],
    [-0.9781476007338057, 0.20791169081775931],
    [-1.0, 5.66553889764798e-16],
    [-0.9781476007338057, -0.20791169081775907],
    [-0.9135454576426009, -0.4067366430758002],
    [-0.8090169943749476, -0.587785252292473],
    [-0.6691306063588585, -0.743144825477394],
    [-0.5000000000000004, -0.8660254037844384],
    [-0.30901699437494756, -0.9510565162951535],
    [-0.10452846326765423, -0.9945218953682733],
    [0.10452846326765299, -0.9945218953682734],
    [0.30901699437494723, -0.9510565162951536],
    [0.5000000000000001, -0.8660254037844386],
    [0.6691306063588585, -0.743144825477394],
    [0.8090169943749473, -0.5877852522924734],
    [0.913545457642601, -0.40673664307580015],
    [0.9781476007338057, -0.20791169081775898],
];

impl TriImprover<'_> {
    /// Moves a node to where the smallest angle around it is largest; a node on a curve moves along
    /// it only. Returns `true` if the node moved.
    pub(super) fn smooth(&mut self, node: u32) -> bool {
        let i = node as usize;
        let mut constraint = self.constraints[i];
        if constraint.fixed_axes == 7 || constraint.surface_count > 1 {
            return false;
        }
        self.gather_star(node);
        let link: Vec<[[f64; 2]; 2]> = self
            .star
            .iter()
            .map(|&t| {
                let triangle = self.triangles[t as usize];
                let k = triangle.iter().position(|&n| n == node).unwrap_or(0);
                SIDES[k].map(|j| self.nodes[triangle[j] as usize])
            })
            .collect();
        let worst = |x: [f64; 2]| {
            let cotangent = |&[u, v]: &[[f64; 2]; 2]| worst_cotangent(&[x, u, v]);
            link.iter().map(cotangent).fold(0.0, f64::max)
        };
        let start = self.nodes[i];
        let (mut x, mut best) = (start, worst(start));
        if best <= self.smoothing_target {
            return false;
        }
        let shortest = link
            .iter()
            .map(|[u, _]| hypot(u[0] - x[0], u[1] - x[1]))
            .fold(f64::INFINITY, f64::min);
        let mut step = 0.25 * shortest;
        while step > 0.004 * shortest {
            let mut moved = false;
            for [cos, sin] in DIRECTIONS {
                let displacement = constraint.freedom().project([step * cos, step * sin, 0.0]);
                // A direction that projection shortens too much is skipped; other directions serve.
                if dot(displacement, displacement) < 0.25 * step * step {
                    continue;
                }
                let mut trial = constraint;
                let target: [f64; 3] = std::array::from_fn(|k| {
                    (to_3d(x)[k] + displacement[k]).clamp(0.0, to_3d(self.extent)[k])
                });
                let Some([u, v, _]) = trial.snap(target, to_3d(self.extent), self.planes) else {
                    continue;
                };
                let value = worst([u, v]);
                if value < best - 1e-3 {
                    (x, best, constraint, moved) = ([u, v], value, trial, true);
                    break;
                }
            }
            if !moved {
                step *= 0.5;
            }
        }
        if x == start {
            return false;
        }
        self.nodes[i] = x;
        self.constraints[i] = constraint;
        self.queue
            .extend(self.star.iter().flat_map(|&t| [(t, 0), (t, 1), (t, 2)]));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::DIRECTIONS;

    #[test]
    fn directions_are_evenly_spaced() {
        for (k, [cos, sin]) in DIRECTIONS.into_iter().enumerate() {
            let angle = (12.0 * k as f64).to_radians();
            assert!((angle.cos() - cos).abs() < 1e-14 && (angle.sin() - sin).abs() < 1e-14);
        }
    }
}
