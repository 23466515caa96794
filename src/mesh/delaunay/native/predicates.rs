//! Signs of two determinants of points, without rounding errors.
//!
//! [`orientation`] says on which side of a plane a point lies, [`in_sphere`] on which side of a
//! sphere. Each is computed in three steps, and each step only if the one before cannot tell:
//!
//! 1. with `f64`, and an error bound from the largest differences of coordinates (Devillers & Pion
//!    2003, "Efficient exact geometric predicates for Delaunay triangulations");
//! 2. with integers of 64 to 384 bits, if the coordinates are multiples of a common power of two
//!    and less than 2^60 times it. This is so for every lattice, and for most points whose density
//!    does not vary extremely;
//! 3. with integers of any length.

use num_bigint::BigInt;

use super::wide::Wide;
use crate::geometry::sub;

/// Error bound of the `f64` determinant of [`orientation`], relative to the product of the largest
/// differences along the three axes. The exact bound is below 5.2e-15.
const ORIENTATION_ERROR: f64 = 5.2e-15;
/// Error bound of the `f64` determinant of [`in_sphere`], relative to the product of the largest
/// differences along the three axes and the largest lift. The exact bound is below 1.3e-13.
const IN_SPHERE_ERROR: f64 = 1.3e-13;
/// Products of smaller differences may underflow.
const MIN_DIFFERENCE: f64 = 1e-50;
/// Integer coordinates are smaller, so that no sum overflows: 2^60.
const MAX_COORDINATE: f64 = (1u64 << 60) as f64;
/// Integer weights are smaller: 2^122.
const MAX_WEIGHT: f64 = (1u128 << 122) as f64;
/// For integer differences below this number, 128 bits are enough.
const SMALL: i64 = 1 << 23;

/// A point with a weight. In a Delaunay triangulation all weights are 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeightedPoint {
    /// Coordinates.
    pub x: [f64; 3],
    /// Square of the radius of the sphere around the point.
    pub weight: f64,
}

/// The grid of which all coordinates of a set of points are multiples, if there is one that is not
/// too fine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// The inverse of the distance between the grid's planes, which is a power of two; or 0.
    scale: f64,
}

impl Grid {
    /// Returns the coarsest grid of `points`.
    pub fn from_points<'a>(points: impl Iterator<Item = &'a [f64; 3]> + Clone) -> Self {
        let unit = common_unit(points.clone().flatten().copied());
        let largest = points.flatten().fold(0.0f64, |m, x| m.max(x.abs()));
        let scale = scale_of(unit).filter(|scale| largest * scale < MAX_COORDINATE);
        Self {
            scale: scale.unwrap_or(0.0),
        }
    }

    /// Adds a point. If it is not on the grid, there is no grid any more.
    pub fn include(&mut self, point: [f64; 3]) {
        let is_on_grid = |x: f64| {
            let x = x * self.scale;
            x.abs() < MAX_COORDINATE && x.trunc() == x
        };
        if self.scale != 0.0 && !point.into_iter().all(is_on_grid) {
            self.scale = 0.0;
        }
    }
}

/// Returns the sign of the volume of the tetrahedron: 1 if it is positively oriented, that is if
/// (b - a) x (c - a) . (d - a) > 0; 0 if the points lie in one plane.
#[inline]
pub fn orientation([a, b, c, d]: [[f64; 3]; 4]) -> i32 {
    let [u, v, w] = [b, c, d].map(|p| sub(p, a));
    orientation_filter(u, v, w).unwrap_or_else(|| exact_orientation([a, b, c, d]))
}

/// Returns the sign of u . (v x w) for rounded differences of points, if rounding cannot change it.
#[inline]
pub fn orientation_filter(u: [f64; 3], v: [f64; 3], w: [f64; 3]) -> Option<i32> {
    let determinant = determinant3(u, v, w);
    let largest = |k: usize| u[k].abs().max(v[k].abs()).max(w[k].abs());
    let [x, y, z] = [largest(0), largest(1), largest(2)];
    let bound = ORIENTATION_ERROR * x * y * z;
    if determinant.abs() > bound && x.min(y).min(z) > MIN_DIFFERENCE {
        Some(if determinant > 0.0 { 1 } else { -1 })
    } else if x == 0.0 || y == 0.0 || z == 0.0 {
        Some(0)
    } else {
        None
    }
}

/// Returns u . (v x w).
#[inline]
fn determinant3(u: [f64; 3], v: [f64; 3], w: [f64; 3]) -> f64 {
    u[0] * (v[1] * w[2] - v[2] * w[1])
        + u[1] * (v[2] * w[0] - v[0] * w[2])
        + u[2] * (v[0] * w[1] - v[1] * w[0])
}

#[cold]
fn exact_orientation(points: [[f64; 3]; 4]) -> i32 {
    let [a, b, c, d] = points;
    let unit = common_unit(points.iter().flatten().copied());
    if let Some(rows) = scale_of(unit).and_then(|scale| integer_differences([b, c, d, a], scale)) {
        return integer_determinant3(rows).signum();
    }
    let [u, v, w] = big_differences([b, c, d, a]).0;
    sign(&big_determinant3([&u, &v, &w]))
}

/// Returns the position of `e` relative to the sphere through the corners of a positively oriented
/// tetrahedron: 1 outside, -1 inside. If all weights are 0, this is the circumsphere; otherwise
/// the sphere that is orthogonal to the spheres around the corners, and 1 means that the power of
/// `e` is larger than its weight.
///
/// Never returns 0: if `e` lies on the sphere, the answer is that for weights that differ by
/// infinitely small amounts ("simulation of simplicity"). `numbers` decides: the weight of the
/// point with the lowest number is changed most. TetGen does the same (`insphere_s`).
#[inline]
pub fn in_sphere(tet: [WeightedPoint; 4], e: WeightedPoint, numbers: [u32; 5], grid: Grid) -> i32 {
    let rows = tet.map(|p| sub(p.x, e.x));
    let lifts: [f64; 4] = std::array::from_fn(|i| {
        let [x, y, z] = rows[i];
        x * x + y * y + z * z - (tet[i].weight - e.weight)
    });
    let largest = |k: usize| rows.iter().fold(0.0f64, |m, row| m.max(row[k].abs()));
    let [x, y, z] = [largest(0), largest(1), largest(2)];
    let weight = tet
        .iter()
        .fold(0.0f64, |m, p| m.max((p.weight - e.weight).abs()));
    let length = x.max(y).max(z);
    let bound = IN_SPHERE_ERROR * x * y * z * (length * length + weight);
    let determinant = determinant4(rows, lifts);
    if (determinant > bound || -determinant > bound) && x.min(y).min(z) > MIN_DIFFERENCE {
        return if determinant > 0.0 { 1 } else { -1 };
    }
    exact_in_sphere(tet, e, numbers, grid)
}

/// Returns the determinant of the rows (x, y, z, lift).
#[inline]
fn determinant4([a, b, c, d]: [[f64; 3]; 4], lifts: [f64; 4]) -> f64 {
    let minor = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
    let [ab, bc, cd, da, ac, bd] = [
        minor(a, b),
        minor(b, c),
        minor(c, d),
        minor(d, a),
        minor(a, c),
        minor(b, d),
    ];
    let abc = a[2] * bc - b[2] * ac + c[2] * ab;
    let bcd = b[2] * cd - c[2] * bd + d[2] * bc;
    let cda = c[2] * da + d[2] * ac + a[2] * cd;
    let dab = d[2] * ab + a[2] * bd + b[2] * da;
    (lifts[3] * abc - lifts[2] * dab) + (lifts[1] * cda - lifts[0] * bcd)
}

#[cold]
fn exact_in_sphere(
    tet: [WeightedPoint; 4],
    e: WeightedPoint,
    numbers: [u32; 5],
    grid: Grid,
) -> i32 {
    let [a, b, c, d] = tet;
    let all = [a, b, c, d, e];
    let sign = integer_in_sphere(all, grid).unwrap_or_else(|| big_in_sphere(all));
    if sign == 0 {
        perturbed(all.map(|p| p.x), numbers)
    } else {
        sign
    }
}

/// Returns the sign of [`in_sphere`] for a point on the sphere.
fn perturbed(points: [[f64; 3]; 5], numbers: [u32; 5]) -> i32 {
    let mut order = [0, 1, 2, 3, 4];
    let mut parity = 1;
    for end in (1..5).rev() {
        for i in 0..end {
            if numbers[order[i]] > numbers[order[i + 1]] {
                order.swap(i, i + 1);
                parity = -parity;
            }
        }
    }
    // The cofactors of the lifts, the lowest number first.
    for dropped in 0..5 {
        let others = std::array::from_fn(|i| order[i + usize::from(i >= dropped)]);
        let cofactor = orientation(others.map(|i: usize| points[i]));
        if cofactor != 0 {
            return if dropped % 2 == 0 {
                -parity * cofactor
            } else {
                parity * cofactor
            };
        }
    }
    1
}

/// Returns a coordinate as `mantissa` times 2^`exponent`, with an odd mantissa, or `None` for 0.
fn decompose(x: f64) -> Option<(i64, i32)> {
    if x == 0.0 {
        return None;
    }
    let bits = x.to_bits();
    let biased = ((bits >> 52) & 0x7ff) as i32;
    let fraction = (bits & ((1 << 52) - 1)) as i64;
    let mantissa = if biased == 0 {
        fraction
    } else {
        fraction | 1 << 52
    };
    let zeros = mantissa.trailing_zeros();
    let mantissa = mantissa >> zeros;
    let exponent = biased.max(1) - 1075 + zeros as i32;
    Some((if x < 0.0 { -mantissa } else { mantissa }, exponent))
}

/// Returns the exponent of the largest power of two of which all `values` are multiples.
fn common_unit(values: impl Iterator<Item = f64>) -> i32 {
    let exponents = values.filter_map(|x| decompose(x).map(|(_, exponent)| exponent));
    exponents.min().unwrap_or(0)
}

/// Returns 2 to the power of `-unit`, if it is a normal number.
fn scale_of(unit: i32) -> Option<f64> {
    (-1000..1000)
        .contains(&unit)
        .then(|| f64::from_bits(((1023 - unit) as u64) << 52))
}

/// Returns the differences of the first points from the last one in units of which all coordinates
/// are multiples, if they are small enough. `scale` is the inverse of the unit.
#[inline]
fn integer_differences<const N: usize, const M: usize>(
    points: [[f64; 3]; N],
    scale: f64,
) -> Option<[[i64; 3]; M]> {
    let mut largest = 0.0f64;
    let mut differences = [[0; 3]; M];
    for k in 0..3 {
        let origin = points[N - 1][k] * scale;
        largest = largest.max(origin.abs());
        for (row, point) in differences.iter_mut().zip(&points) {
            let coordinate = point[k] * scale;
            largest = largest.max(coordinate.abs());
            row[k] = coordinate as i64 - origin as i64;
        }
    }
    (largest < MAX_COORDINATE).then_some(differences)
}

/// Returns u . (v x w).
fn integer_determinant3([u, v, w]: [[i64; 3]; 3]) -> Wide {
    let minor = |p: [i64; 3], q: [i64; 3]| {
        i128::from(p[0]) * i128::from(q[1]) - i128::from(p[1]) * i128::from(q[0])
    };
    Wide::product(minor(v, w), u[2]) - Wide::product(minor(u, w), v[2])
        + Wide::product(minor(u, v), w[2])
}

/// Returns the sign of the determinant of [`in_sphere`], if integers of fixed length can hold it.
fn integer_in_sphere(points: [WeightedPoint; 5], grid: Grid) -> Option<i32> {
    let is_weighted = points.iter().any(|p| p.weight != 0.0);
    let scale = if grid.scale != 0.0 && !is_weighted {
        grid.scale
    } else {
        let mut unit = common_unit(points.iter().flat_map(|p| p.x));
        if is_weighted {
            // Weights are in units of 2^(2 unit).
            unit = unit.min(common_unit(points.iter().map(|p| p.weight)).div_euclid(2));
        }
        scale_of(unit)?
    };
    let rows: [[i64; 3]; 4] = integer_differences(points.map(|p| p.x), scale)?;
    if !is_weighted && rows.iter().flatten().all(|x| x.abs() < SMALL) {
        return Some(small_in_sphere(rows));
    }
    let mut lifts = rows.map(|[x, y, z]| {
        let square = |x: i64| i128::from(x) * i128::from(x);
        square(x) + square(y) + square(z)
    });
    if is_weighted {
        let weights = points.map(|p| p.weight * scale * scale);
        if weights.iter().any(|weight| weight.abs() > MAX_WEIGHT) {
            return None;
        }
        for (lift, weight) in lifts.iter_mut().zip(weights) {
            *lift -= weight as i128 - weights[4] as i128;
        }
    }
    // As in `determinant4`.
    let [a, b, c, d] = rows;
    let minor = |p: [i64; 3], q: [i64; 3]| {
        i128::from(p[0]) * i128::from(q[1]) - i128::from(p[1]) * i128::from(q[0])
    };
    let [ab, bc, cd, da, ac, bd] = [
        minor(a, b),
        minor(b, c),
        minor(c, d),
        minor(d, a),
        minor(a, c),
        minor(b, d),
    ];
    let product = Wide::product;
    let abc = product(bc, a[2]) - product(ac, b[2]) + product(ab, c[2]);
    let bcd = product(cd, b[2]) - product(bd, c[2]) + product(bc, d[2]);
    let cda = product(da, c[2]) + product(ac, d[2]) + product(cd, a[2]);
    let dab = product(ab, d[2]) + product(bd, a[2]) + product(da, b[2]);
    let sum =
        (abc.times(lifts[3]) - dab.times(lifts[2])) + (cda.times(lifts[1]) - bcd.times(lifts[0]));
    Some(sum.signum())
}

/// Returns the sign of the determinant of [`in_sphere`] for differences below [`SMALL`] and no
/// weights.
fn small_in_sphere([a, b, c, d]: [[i64; 3]; 4]) -> i32 {
    let minor = |p: [i64; 3], q: [i64; 3]| p[0] * q[1] - p[1] * q[0];
    let [ab, bc, cd, da, ac, bd] = [
        minor(a, b),
        minor(b, c),
        minor(c, d),
        minor(d, a),
        minor(a, c),
        minor(b, d),
    ];
    let product = |a: i64, b: i64| i128::from(a) * i128::from(b);
    let abc = product(bc, a[2]) - product(ac, b[2]) + product(ab, c[2]);
    let bcd = product(cd, b[2]) - product(bd, c[2]) + product(bc, d[2]);
    let cda = product(da, c[2]) + product(ac, d[2]) + product(cd, a[2]);
    let dab = product(ab, d[2]) + product(bd, a[2]) + product(da, b[2]);
    let lift = |[x, y, z]: [i64; 3]| i128::from(x * x + y * y + z * z);
    let sum = (lift(d) * abc - lift(c) * dab) + (lift(b) * cda - lift(a) * bcd);
    sum.signum() as i32
}

/// Returns the differences of the first points from the last one, in a common unit, and the unit.
fn big_differences<const N: usize, const M: usize>(
    points: [[f64; 3]; N],
) -> ([[BigInt; 3]; M], i32) {
    let unit = common_unit(points.iter().flatten().copied());
    let differences = std::array::from_fn(|i| {
        std::array::from_fn(|k| {
            big_in_units(points[i][k], unit) - big_in_units(points[N - 1][k], unit)
        })
    });
    (differences, unit)
}

fn big_in_units(x: f64, unit: i32) -> BigInt {
    match decompose(x) {
        Some((mantissa, exponent)) => BigInt::from(mantissa) << (exponent - unit) as u32,
        None => BigInt::ZERO,
    }
}

fn sign(x: &BigInt) -> i32 {
    match x.sign() {
        num_bigint::Sign::Minus => -1,
        num_bigint::Sign::NoSign => 0,
        num_bigint::Sign::Plus => 1,
    }
}

/// Returns u . (v x w).
fn big_determinant3([u, v, w]: [&[BigInt; 3]; 3]) -> BigInt {
    let minor = |p: &[BigInt; 3], q: &[BigInt; 3]| &p[0] * &q[1] - &p[1] * &q[0];
    minor(v, w) * &u[2] - minor(u, w) * &v[2] + minor(u, v) * &w[2]
}

/// Returns the sign of the determinant of [`in_sphere`].
fn big_in_sphere(points: [WeightedPoint; 5]) -> i32 {
    let (rows, unit): ([[BigInt; 3]; 4], i32) = big_differences(points.map(|p| p.x));
    let weights = points.map(|p| p.weight);
    // All lifts in units of 2^lift_unit.
    let lift_unit = common_unit(weights.iter().copied()).min(2 * unit);
    let lifts: [BigInt; 4] = std::array::from_fn(|i| {
        let square: BigInt = rows[i].iter().map(|x| x * x).sum();
        (square << (2 * unit - lift_unit) as u32)
            - (big_in_units(weights[i], lift_unit) - big_in_units(weights[4], lift_unit))
    });
    let [a, b, c, d] = &rows;
    let sum = big_determinant3([a, b, c]) * &lifts[3] - big_determinant3([a, b, d]) * &lifts[2]
        + big_determinant3([a, c, d]) * &lifts[1]
        - big_determinant3([b, c, d]) * &lifts[0];
    sign(&sum)
}
