//! The shape of a tetrahedron, measured by its dihedral angles.

use super::EDGES;
use crate::geometry::simd::dispatch_simd;
use crate::geometry::{cross, dot, sub, volume6};

/// Number of tetrahedra that are measured together.
pub(crate) const BLOCK_SIZE: usize = 64;

/// The corners of up to 64 tetrahedra, stored by node, axis and tetrahedron so that
/// SIMD instructions can measure them.
pub struct CornerBlock([[[f64; BLOCK_SIZE]; 3]; 4]);

impl Default for CornerBlock {
    fn default() -> Self {
        Self([[[0.0; BLOCK_SIZE]; 3]; 4])
    }
}

impl CornerBlock {
    /// Copies the corners of at most 64 tetrahedra. Unused entries keep their old
    /// values.
    pub fn gather(&mut self, nodes: &[[f64; 3]], tets: &[[u32; 4]]) {
        for (i, tet) in tets.iter().enumerate().take(BLOCK_SIZE) {
            for (corner, &node) in self.0.iter_mut().zip(tet) {
                let [x, y, z] = nodes[node as usize];
                (corner[0][i], corner[1][i], corner[2][i]) = (x, y, z);
            }
        }
    }

    #[inline(always)]
    fn get(&self, i: usize) -> [[f64; 3]; 4] {
        let [a, b, c, d] = &self.0;
        [
            [a[0][i], a[1][i], a[2][i]],
            [b[0][i], b[1][i], b[2][i]],
            [c[0][i], c[1][i], c[2][i]],
            [d[0][i], d[1][i], d[2][i]],
        ]
    }

    /// Computes [`min_sine`] of each tetrahedron.
    pub fn min_sines(&self, sines: &mut [f64; BLOCK_SIZE]) {
        dispatch_simd(
            #[inline(always)]
            || {
                for (i, sine) in sines.iter_mut().enumerate() {
                    *sine = min_sine(&self.get(i));
                }
            },
        );
    }
}

/// Returns the six dihedral angles in degrees, in the order of [`EDGES`].
pub fn dihedral_angles(p: &[[f64; 3]; 4]) -> [f64; 6] {
    EDGES.map(|[i, j]| {
        // The two nodes not on the edge. The dihedral angle is the angle between the normals m and
        // n.
        let [k, l] = match (i, j) {
            (0, 1) => [2, 3],
            (0, 2) => [1, 3],
            (0, 3) => [1, 2],
            (1, 2) => [0, 3],
            (1, 3) => [0, 2],
            _ => [0, 1],
        };
        let e = sub(p[j], p[i]);
        let m = cross(e, sub(p[k], p[i]));
        let n = cross(e, sub(p[l], p[i]));
        let sine = crate::geometry::norm(cross(m, n));
        sine.atan2(dot(m, n)).to_degrees()
    })
}

/// Returns the smallest sine of the six dihedral angles; negative for an inverted tetrahedron.
///
/// Improvement maximises this measure: small and large angles count alike, every angle lies in [30,
/// 150] degrees exactly if the sine is at least 1/2, and it needs no trigonometry. The sine at an
/// edge of length l between faces of areas A and B is 3 V l / (2 A B) (Klingner & Shewchuk 2007).
#[inline(always)]
pub fn min_sine(p: &[[f64; 3]; 4]) -> f64 {
    let (a, b, c) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[3], p[0]));
    let (u, v) = (sub(p[2], p[1]), sub(p[3], p[1]));
    let w = sub(p[3], p[2]);
    let n3 = cross(a, b);
    let n2 = cross(a, c);
    let n1 = cross(b, c);
    let n0 = cross(u, v);
    let volume = dot(c, n3);
    let (s0, s1, s2, s3) = (dot(n0, n0), dot(n1, n1), dot(n2, n2), dot(n3, n3));
    // sin^2 = V^2 l^2 / (|n_i|^2 |n_j|^2). The edge between nodes (i, j) borders the faces opposite
    // the other two nodes.
    let m = (dot(a, a) * s0 * s1)
        .min(dot(b, b) * s0 * s2)
        .min(dot(c, c) * s0 * s3)
        .min(dot(u, u) * s1 * s2)
        .min(dot(v, v) * s1 * s3)
        .min(dot(w, w) * s2 * s3);
    let denominator = s0 * s1 * s2 * s3;
    let sine = (m / denominator).sqrt() * volume.abs();
    let signed = if volume > 0.0 { sine } else { -sine };
    if denominator > 0.0 { signed } else { -1.0 }
}

/// Returns the mean ratio 12 (3 V)^(2/3) / (sum of squared edge lengths): 1 for the regular
/// tetrahedron, 0 for a flat or inverted one (Liu & Joe 1994).
pub fn mean_ratio(p: &[[f64; 3]; 4]) -> f64 {
    let lengths: f64 = EDGES
        .iter()
        .map(|&[i, j]| {
            let e = sub(p[j], p[i]);
            dot(e, e)
        })
        .sum();
    let volume = volume6(p) / 6.0;
    if volume <= 0.0 || lengths <= 0.0 {
        return 0.0;
    }
    12.0 * (3.0 * volume).powf(2.0 / 3.0) / lengths
}

/// Returns the radius of the circumscribed sphere over the length of the shortest edge: 0.612 for
/// the regular tetrahedron.
pub fn radius_edge_ratio(p: &[[f64; 3]; 4]) -> f64 {
    let shortest = EDGES
        .iter()
        .map(|&[i, j]| {
            let e = sub(p[j], p[i]);
            dot(e, e)
        })
        .fold(f64::INFINITY, f64::min)
        .sqrt();
    let (a, b, c) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[3], p[0]));
    let (bc, ca, ab) = (cross(b, c), cross(c, a), cross(a, b));
    let (aa, bb, cc) = (dot(a, a), dot(b, b), dot(c, c));
    let top: [f64; 3] = std::array::from_fn(|k| aa * bc[k] + bb * ca[k] + cc * ab[k]);
    crate::geometry::norm(top) / (2.0 * volume6(p).abs()) / shortest
}

/// All shape measures of one simplex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimplexShape<C = [f64; 6]> {
    /// Cosines of the angles; for a tetrahedron of the dihedral angles, in the order of [`EDGES`],
    /// accurate to 1e-6 degrees near 0 and 180. The angle at a face without area is taken as 0.
    pub cosines: C,
    /// See [`mean_ratio`] and `tri::shape_quality`.
    pub mean_ratio: f64,
    /// See [`radius_edge_ratio`] and `tri::radius_edge_ratio`.
    pub radius_edge: f64,
    /// Signed volume (area in 2-D).
    pub volume: f64,
}

/// All measures together share subexpressions and cost a quarter of the single functions.
impl SimplexShape {
    /// Measures the tetrahedron with corners `p`.
    #[inline]
    pub fn from_corners(p: &[[f64; 3]; 4]) -> Self {
        Self::measure(p)
    }

    /// Measures the tetrahedron with corners `p`; always inlined. It is written for vectorised
    /// loops: with loops instead of maps of arrays, and without branches.
    #[inline(always)]
    fn measure(p: &[[f64; 3]; 4]) -> Self {
        let (a, b, c) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[3], p[0]));
        let (u, v, w) = (sub(p[2], p[1]), sub(p[3], p[1]), sub(p[3], p[2]));
        // Normals of the faces opposite each node, all outward (or all inward).
        let normals = [cross(u, v), cross(c, b), cross(a, c), cross(b, a)];
        let mut inverses = [0.0; 4];
        for k in 0..4 {
            let square = dot(normals[k], normals[k]);
            let inverse = 1.0 / square.sqrt();
            inverses[k] = if square > 0.0 { inverse } else { 0.0 };
        }
        let mut cosines = [0.0; 6];
        for e in 0..6 {
            // Edge e lies between the faces opposite the two nodes of the opposite edge.
            let [k, l] = EDGES[5 - e];
            let inverse = inverses[k] * inverses[l];
            let cosine = (-dot(normals[k], normals[l]) * inverse).clamp(-1.0, 1.0);
            cosines[e] = if inverse > 0.0 { cosine } else { 1.0 };
        }
        let squares = [
            dot(a, a),
            dot(b, b),
            dot(c, c),
            dot(u, u),
            dot(v, v),
            dot(w, w),
        ];
        let [aa, bb, cc, uu, vv, ww] = squares;
        let sum = aa + bb + cc + uu + vv + ww;
        let shortest = aa.min(bb).min(cc).min(uu).min(vv).min(ww);
        // Six times the volume, with the sign of `volume6`.
        let volume6 = -dot(c, normals[3]);
        let ratio = 12.0 * cube_root(0.25 * volume6 * volume6) / sum;
        let mean_ratio = if volume6 > 0.0 { ratio } else { 0.0 };
        let mut top = [0.0; 3];
        for k in 0..3 {
            top[k] = -(aa * normals[1][k] + bb * normals[2][k] + cc * normals[3][k]);
        }
        let radius_edge = (dot(top, top) / shortest).sqrt() / (2.0 * volume6.abs());
        Self {
            cosines,
            mean_ratio,
            radius_edge,
            volume: volume6 / 6.0,
        }
    }

    /// Returns the smallest dihedral angle, in degrees.
    #[inline]
    pub fn smallest_angle(&self) -> f64 {
        let max_cosine = self.cosines.iter().copied().fold(-1.0, f64::max);
        max_cosine.acos().to_degrees()
    }

    /// Returns the largest dihedral angle, in degrees.
    #[inline]
    pub fn largest_angle(&self) -> f64 {
        let min_cosine = self.cosines.iter().copied().fold(1.0, f64::min);
        min_cosine.acos().to_degrees()
    }
}

/// Returns the cube root of a positive number to a relative error of 1e-13, in steps that can be
/// vectorised.
#[inline(always)]
fn cube_root(x: f64) -> f64 {
    // A third of the exponent gives five correct bits (as in FreeBSD's `cbrt`). Each step of
    // Halley's method triples their number.
    let high = (x.to_bits() >> 32) as u32 / 3 + 0x2A9F_7893;
    let mut y = f64::from_bits(u64::from(high) << 32);
    for _ in 0..2 {
        let cube = y * y * y;
        y *= (cube + 2.0 * x) / (2.0 * cube + x);
    }
    y
}

/// Shape measures of up to 64 tetrahedra, stored as arrays; see [`SimplexShape`].
pub struct SimplexShapeBlock {
    cosines: [[f64; BLOCK_SIZE]; 6],
    mean_ratio: [f64; BLOCK_SIZE],
    radius_edge: [f64; BLOCK_SIZE],
    volume: [f64; BLOCK_SIZE],
}

impl Default for SimplexShapeBlock {
    fn default() -> Self {
        Self {
            cosines: [[0.0; BLOCK_SIZE]; 6],
            mean_ratio: [0.0; BLOCK_SIZE],
            radius_edge: [0.0; BLOCK_SIZE],
            volume: [0.0; BLOCK_SIZE],
        }
    }
}

impl SimplexShapeBlock {
    /// Measures every tetrahedron of a block.
    pub fn measure(&mut self, corners: &CornerBlock) {
        dispatch_simd(
            #[inline(always)]
            || {
                for i in 0..BLOCK_SIZE {
                    let shape = SimplexShape::measure(&corners.get(i));
                    for e in 0..6 {
                        self.cosines[e][i] = shape.cosines[e];
                    }
                    self.mean_ratio[i] = shape.mean_ratio;
                    self.radius_edge[i] = shape.radius_edge;
                    self.volume[i] = shape.volume;
                }
            },
        );
    }

    /// Returns the measures of tetrahedron `i` of the block.
    #[inline]
    pub fn get(&self, i: usize) -> SimplexShape {
        SimplexShape {
            cosines: std::array::from_fn(|e| self.cosines[e][i]),
            mean_ratio: self.mean_ratio[i],
            radius_edge: self.radius_edge[i],
            volume: self.volume[i],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const REGULAR_CORNERS: [[f64; 3]; 4] = [
        [1.0, 1.0, 1.0],
        [-1.0, 1.0, -1.0],
        [1.0, -1.0, -1.0],
        [-1.0, -1.0, 1.0],
    ];

    #[test]
    fn regular_tetrahedron() {
        assert!(volume6(&REGULAR_CORNERS) > 0.0);
        for angle in dihedral_angles(&REGULAR_CORNERS) {
            assert!((angle - (1.0f64 / 3.0).acos().to_degrees()).abs() < 1e-12);
        }
        assert!((min_sine(&REGULAR_CORNERS) - 8f64.sqrt() / 3.0).abs() < 1e-14);
        assert!((mean_ratio(&REGULAR_CORNERS) - 1.0).abs() < 1e-14);
        assert!((radius_edge_ratio(&REGULAR_CORNERS) - 6f64.sqrt() / 4.0).abs() < 1e-14);
    }

    #[test]
    fn corner_of_the_cube() {
        let p = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let mut angles = dihedral_angles(&p);
        angles.sort_by(f64::total_cmp);
        for (got, want) in angles
            .iter()
            .zip([54.7356, 54.7356, 54.7356, 90.0, 90.0, 90.0])
        {
            assert!((got - want).abs() < 1e-4);
        }
    }

    #[test]
    fn cube_roots() {
        for i in -300..300 {
            let x = 10f64.powf(0.1 * f64::from(i));
            assert!((cube_root(x) / x.cbrt() - 1.0).abs() < 1e-13, "{x}");
        }
    }

    proptest! {
        #[test]
        fn blocks_are_measured_like_single_tetrahedra(
            c in proptest::collection::vec(-1.0f64..1.0, 3 * 40),
            picks in proptest::collection::vec(0u32..40, 4 * 50)
        ) {
            let (nodes, tets) = (c.as_chunks::<3>().0, picks.as_chunks::<4>().0);
            let (mut corners, mut shapes) = (CornerBlock::default(), SimplexShapeBlock::default());
            corners.gather(nodes, tets);
            shapes.measure(&corners);
            let mut sines = [0.0; BLOCK_SIZE];
            corners.min_sines(&mut sines);
            for (i, tet) in tets.iter().enumerate() {
                let p = tet.map(|n| nodes[n as usize]);
                prop_assert_eq!(sines[i].to_bits(), min_sine(&p).to_bits());
                let (single, block) = (SimplexShape::from_corners(&p), shapes.get(i));
                prop_assert_eq!(single.cosines, block.cosines);
                prop_assert_eq!(single.mean_ratio.to_bits(), block.mean_ratio.to_bits());
                prop_assert_eq!(single.volume.to_bits(), block.volume.to_bits());
            }
        }

        #[test]
        fn shapes_have_the_values_of_single_functions(c in proptest::array::uniform12(-1.0f64..1.0)) {
            let p = [[c[0], c[1], c[2]], [c[3], c[4], c[5]], [c[6], c[7], c[8]], [c[9], c[10], c[11]]];
            prop_assume!(volume6(&p).abs() > 1e-4);
            let shape = SimplexShape::from_corners(&p);
            let angles = dihedral_angles(&p);
            for (cosine, exact) in shape.cosines.into_iter().zip(angles) {
                prop_assert!((cosine.acos().to_degrees() - exact).abs() < 1e-5);
            }
            let min = angles.into_iter().fold(f64::INFINITY, f64::min);
            let max = angles.into_iter().fold(0.0, f64::max);
            prop_assert!((shape.smallest_angle() - min).abs() < 1e-5);
            prop_assert!((shape.largest_angle() - max).abs() < 1e-5);
            let close = |a: f64, b: f64| (a - b).abs() <= 1e-8 * b.abs();
            prop_assert!(close(shape.volume, volume6(&p) / 6.0));
            prop_assert!(close(shape.mean_ratio, mean_ratio(&p)));
            prop_assert!(close(shape.radius_edge, radius_edge_ratio(&p)));
        }

        #[test]
        fn min_sine_is_the_smallest_sine_of_the_angles(
            c in proptest::array::uniform12(-1.0f64..1.0)
        ) {
            let p = [[c[0], c[1], c[2]], [c[3], c[4], c[5]], [c[6], c[7], c[8]], [c[9], c[10], c[11]]];
            let v = volume6(&p);
            prop_assume!(v.abs() > 1e-4);
            let expected = dihedral_angles(&p)
                .iter()
                .map(|a| a.to_radians().sin())
                .fold(f64::INFINITY, f64::min);
            let got = min_sine(&p);
            prop_assert!(got.signum() == v.signum());
            prop_assert!((got.abs() - expected).abs() < 1e-9);
        }
    }
}
