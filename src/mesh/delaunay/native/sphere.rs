//! Spheres of cells as rounded numbers with an error bound. For nearly all points they are enough to
//! tell on which side of a sphere a point lies, in a fifth of the time of a determinant.

use crate::geometry::{cross, dot, sub};

/// The sphere of a cell: its centre relative to an origin that all cells share, and its squared
/// radius. For a ghost cell the outward unit normal of its face, and the product of the normal with
/// a corner of the face. The last bit of the last number is 1 for ghost cells.
///
/// With weights, the radius is that of the sphere that is orthogonal to the spheres around the
/// corners.
#[derive(Debug, Clone, Copy)]
pub struct Sphere([f32; 4]);

/// A vertex of a cell, relative to another one.
#[derive(Debug, Clone, Copy)]
pub struct LinkVertex {
    difference: [f64; 3],
    /// Square of the distance minus the weight relative to that of the other vertex.
    lift: f64,
    /// The larger of the square of the distance and the absolute value of `lift`.
    size2: f64,
}

impl LinkVertex {
    /// Returns the vertex with these differences of positions and weights.
    #[inline(always)]
    pub fn new(difference: [f64; 3], weight: f64) -> Self {
        let distance2 = dot(difference, difference);
        let lift = distance2 - weight;
        Self {
            difference,
            lift,
            size2: distance2.max(lift.abs()),
        }
    }
}

impl Sphere {
    /// The last number of the mark of cells in the cavity; a NaN.
    const CAVITY_BITS: u32 = 0x7fc0_0002;
    /// Marks a cell of the cavity.
    pub const IN_CAVITY: Self = Self([0.0, 0.0, 0.0, f32::from_bits(Self::CAVITY_BITS)]);
    /// A sphere that decides nothing.
    pub const UNKNOWN: Self = Self([0.0, 0.0, 0.0, f32::from_bits(0x7fc0_0004)]);
    /// A half-space that decides nothing.
    pub const UNKNOWN_GHOST: Self = Self([0.0, 0.0, 0.0, f32::from_bits(0x7fc0_0005)]);
    /// Bound of the relative error of each number: half a unit in the last place by rounding, one by
    /// the bit that marks ghosts, and the error of the computation.
    const ERROR: f64 = 2e-7;
    /// Square of the error bound of [`contains`](Self::contains), relative to its sum of four
    /// products.
    const POWER_ERROR2: f64 = 8.0 * Self::ERROR * Self::ERROR;

    /// Returns the sphere through a vertex at `x` relative to the origin, with this weight, and
    /// three others.
    #[inline(always)]
    pub fn through(x: [f64; 3], weight: f64, [b, c, d]: [LinkVertex; 3]) -> Self {
        let normals = [
            cross(c.difference, d.difference),
            cross(d.difference, b.difference),
            cross(b.difference, c.difference),
        ];
        let volume = dot(b.difference, normals[0]);
        let size2 = b.size2.max(c.size2).max(d.size2);
        // With L the largest square and u the unit roundoff, the error of the volume is 16 u
        // L^(3/2), that of the numerator below 40 u L^2. Both are negligible unless the cell is
        // extremely flat.
        if volume * volume < 1e-11 * size2 * size2 * size2 {
            return Self::UNKNOWN;
        }
        let factor = 0.5 / volume;
        let centre: [f64; 3] = std::array::from_fn(|k| {
            (b.lift * normals[0][k] + c.lift * normals[1][k] + d.lift * normals[2][k]) * factor
        });
        let radius2 = (dot(centre, centre) - weight) as f32;
        let [x, y, z] = std::array::from_fn(|k| (x[k] + centre[k]) as f32);
        Self([x, y, z, f32::from_bits(radius2.to_bits() & !1)])
    }

    /// Returns the half-space beyond the plane through a vertex at `x` relative to the origin and
    /// two others, in the direction of their vector product.
    pub fn half_space(x: [f64; 3], b: LinkVertex, c: LinkVertex) -> Self {
        let [b, c] = [b.difference, c.difference];
        let normal = cross(b, c);
        let length2 = dot(normal, normal);
        if !(length2 > 1e-14 * dot(b, b) * dot(c, c) && length2.is_normal()) {
            return Self::UNKNOWN_GHOST;
        }
        let normal = normal.map(|n| n / length2.sqrt());
        let offset = dot(normal, x) as f32;
        let [nx, ny, nz] = normal.map(|n| n as f32);
        Self([nx, ny, nz, f32::from_bits(offset.to_bits() | 1)])
    }

    /// Returns `true` if the cell is marked as one of the cavity.
    #[inline(always)]
    pub fn is_in_cavity(self) -> bool {
        self.0[3].to_bits() == Self::CAVITY_BITS
    }

    /// Returns `true` for the half-space of a ghost cell.
    #[inline(always)]
    pub fn is_ghost(self) -> bool {
        self.0[3].to_bits() & 1 == 1
    }

    /// Returns whether the sphere contains a point with this weight at `x` relative to the origin, or
    /// `None` if rounding could change the answer. No coordinate of `x` is larger than `extent`.
    #[inline(always)]
    pub fn contains(self, x: [f64; 3], weight: f64, extent: f64) -> Option<bool> {
        let [a, b, c, last] = self.0;
        let [a, b, c, last] = [f64::from(a), f64::from(b), f64::from(c), f64::from(last)];
        if self.is_ghost() {
            let height = a * x[0] + b * x[1] + c * x[2] - last;
            return (height.abs() > 4.0 * Self::ERROR * extent).then_some(height > 0.0);
        }
        let difference = sub(x, [a, b, c]);
        let distance2 = dot(difference, difference);
        let power = distance2 - weight - last;
        // The error of the distance is that of the centre, whose coordinates are at most the
        // distance larger than those of x.
        let size4 =
            extent * extent * distance2 + distance2 * distance2 + last * last + weight * weight;
        (power * power > Self::POWER_ERROR2 * size4).then_some(power < 0.0)
    }
}
