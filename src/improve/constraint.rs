//! What holds a node: the sides of the box, and the features it lies on.

use super::feature_planes::{FeaturePlanes, NearbyPlanes, SAME_SURFACE_COSINE};
use super::plane_cache::PlaneCache;
use crate::files::codec::codec_fields;
use crate::geometry::{add_scaled, dot, norm};
use crate::lattice::AtomKind;

/// Nodes this close to a sheet lie on it: settling leaves less.
const ON_SURFACE_TOLERANCE: f64 = 0.11;

/// The sheets near a node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SurfaceProximity {
    /// None is close.
    Nothing,
    /// One: its normal, and the node's signed distance from it.
    Single([f32; 3], f32),
    /// Several.
    Multiple,
}

impl SurfaceProximity {
    /// Whether both ends of an edge, between two nodes with these sheets beside them, are surely on the
    /// same side of these. `alone` tells which end is on its only sheet.
    #[inline]
    pub fn is_same_side(self, other: Self, edge: [f64; 3], alone: [bool; 2]) -> bool {
        let edge = edge.map(|c| c as f32);
        let along = |n: [f32; 3]| dot(n, edge);
        match (self, other) {
            (Self::Single(m, r), Self::Single(n, s)) => {
                // Where each end is with respect to the other's sheet: if an end on a sheet is about
                // on the other's, they are one.
                let (p, q) = (s - along(n), r + along(m));
                let from_first = p * s > 0.0 || alone[0] && p.abs() < SAME_SURFACE_OFFSET;
                let from_second = q * r > 0.0 || alone[1] && q.abs() < SAME_SURFACE_OFFSET;
                (alone[1] || from_first) && (alone[0] || from_second)
            }
            (Self::Single(..), Self::Nothing) => alone[0],
            (Self::Nothing, Self::Single(..)) => alone[1],
            _ => false,
        }
    }
}

/// Two planes are of one sheet if a point on one is at most this far off the other.
const SAME_SURFACE_OFFSET: f32 = 1.0;

/// The directions in which a node may move.
#[derive(Debug, Clone, Copy)]
pub struct Freedom {
    fixed_axes: u8,
    /// Directions, at right angles to one another and to the fixed axes, that are taken away.
    removed_directions: [Option<[f64; 3]>; 2],
}

impl Freedom {
    /// The part of `v` along which the node may move.
    #[inline]
    pub fn project(&self, mut v: [f64; 3]) -> [f64; 3] {
        for b in self.removed_directions.iter().flatten() {
            v = add_scaled(v, -dot(v, *b), *b);
        }
        for k in 0..3 {
            if self.fixed_axes >> k & 1 == 1 {
                v[k] = 0.0;
            }
        }
        v
    }
}

/// The constraints of one node.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct NodeConstraint {
    /// Bit k: coordinate k is fixed (the node lies in a side normal to axis k, or is fixed).
    pub fixed_axes: u8,
    /// How many sheets hold the node.
    pub surface_count: u8,
    /// No feature is anywhere near.
    pub is_far: bool,
    /// On one sheet, and no other is near.
    pub is_isolated: bool,
    pub(super) normals: [[f32; 3]; 2],
}

codec_fields! {
    NodeConstraint as NodeConstraint { fixed_axes, surface_count, is_far, is_isolated, normals }
}

impl NodeConstraint {
    /// By the sides of the box `[0, extent]` and by the features on which the node lies.
    ///
    /// Also gives the sheets that are near, of which those that do not hold the node are known only if
    /// they are close.
    pub fn new(
        x: [f64; 3],
        kind: AtomKind,
        extent: [f64; 3],
        sheets: &FeaturePlanes,
    ) -> (Self, SurfaceProximity) {
        let mut hold = Self::from_box(x, kind, extent);
        hold.is_far = sheets.is_far(x);
        if hold.is_far || !sheets.is_close(x) {
            return (hold, SurfaceProximity::Nothing);
        }
        let near = sheets.planes_near(x);
        for sheet in near
            .iter()
            .filter(|s| s.offset.abs() < ON_SURFACE_TOLERANCE)
        {
            hold.add_surface(sheet.normal);
        }
        let mut all = near.iter();
        let beside = match (all.next(), all.next()) {
            (None, _) => SurfaceProximity::Nothing,
            (Some(only), None) => {
                SurfaceProximity::Single(only.normal.map(|c| c as f32), only.offset as f32)
            }
            _ => SurfaceProximity::Multiple,
        };
        hold.is_isolated =
            hold.surface_count == 1 && matches!(beside, SurfaceProximity::Single(..));
        (hold, beside)
    }

    /// By the sides of the box `[0, extent]` alone.
    pub fn from_box(x: [f64; 3], kind: AtomKind, extent: [f64; 3]) -> Self {
        let mut hold = Self::default();
        if kind == AtomKind::Fixed {
            hold.fixed_axes = 7;
        }
        for k in 0..3 {
            if x[k] == 0.0 || x[k] == extent[k] {
                hold.fixed_axes |= 1 << k;
            }
        }
        hold
    }

    /// The normals of the sheets that hold the node.
    pub fn normals(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        self.normals[..usize::from(self.surface_count)]
            .iter()
            .map(|n| n.map(f64::from))
    }

    /// Whether a sheet of this normal holds the node.
    pub fn is_on_surface(&self, normal: [f64; 3]) -> bool {
        self.normals()
            .any(|n| dot(n, normal).abs() > SAME_SURFACE_COSINE)
    }

    /// Adds a sheet if there is room.
    pub fn add_surface(&mut self, normal: [f64; 3]) {
        if usize::from(self.surface_count) < self.normals.len() && !self.is_on_surface(normal) {
            self.normals[usize::from(self.surface_count)] = normal.map(|c| c as f32);
            self.surface_count += 1;
        }
    }

    /// Forgets the sheets.
    pub fn clear_surfaces(&mut self) {
        self.surface_count = 0;
        self.is_isolated = false;
    }

    /// Without the sheets.
    pub fn without_surfaces(&self) -> Self {
        Self {
            fixed_axes: self.fixed_axes,
            ..Self::default()
        }
    }

    /// The directions in which the node may move.
    pub fn freedom(&self) -> Freedom {
        Freedom {
            fixed_axes: self.fixed_axes,
            removed_directions: self.removed_directions(),
        }
    }

    /// Orthonormal directions in the box-allowed space that the sheets take away.
    fn removed_directions(&self) -> [Option<[f64; 3]>; 2] {
        let mut basis: [Option<[f64; 3]>; 2] = [None; 2];
        for (i, mut n) in self.normals().enumerate() {
            for k in 0..3 {
                if self.fixed_axes >> k & 1 == 1 {
                    n[k] = 0.0;
                }
            }
            if let Some(b) = basis[0].filter(|_| i == 1) {
                n = add_scaled(n, -dot(n, b), b);
            }
            let length = norm(n);
            if length > 0.2 {
                basis[i] = Some(n.map(|c| c / length));
            }
        }
        basis
    }

    /// Whether this node may take the other's place: everything that holds it holds the other.
    pub fn is_subset_of(&self, other: &NodeConstraint) -> bool {
        self.fixed_axes & !other.fixed_axes == 0 && self.normals().all(|n| other.is_on_surface(n))
    }

    /// Puts `x` back onto the sheets that hold it (a few Newton steps), never off the box's sides.
    /// Returns None if the sheets are no longer there.
    pub fn snap(
        &mut self,
        x: [f64; 3],
        extent: [f64; 3],
        sheets: &FeaturePlanes,
    ) -> Option<[f64; 3]> {
        self.newton_steps(x, extent, [0.0, 0.01], |x| sheets.planes_near(x))
    }

    /// The same by planes that are [remembered](PlaneCache), and no nearer to the sheets than `stray`.
    pub fn snap_within(
        &mut self,
        stray: f64,
        x: [f64; 3],
        extent: [f64; 3],
        sheets: &FeaturePlanes,
        lookup: &mut PlaneCache,
    ) -> Option<[f64; 3]> {
        // One step goes to a plane; how far off those of the next cell are is no matter.
        self.newton_steps(x, extent, [stray, 0.1], |x| lookup.planes_near(sheets, x))
    }

    /// Steps until the node is at most `stray` off all sheets, or was by no more than `close` farther
    /// off before the last.
    fn newton_steps(
        &mut self,
        mut x: [f64; 3],
        extent: [f64; 3],
        [stray, close]: [f64; 2],
        mut near: impl FnMut([f64; 3]) -> NearbyPlanes,
    ) -> Option<[f64; 3]> {
        if self.surface_count == 0 {
            return Some(x);
        }
        let beyond = |offset: f64| offset - offset.clamp(-stray, stray);
        for _ in 0..3 {
            let here = near(x);
            let mut worst = 0.0f64;
            for i in 0..usize::from(self.surface_count) {
                let held = self.normals[i].map(f64::from);
                let sheet = here
                    .iter()
                    .max_by(|a, b| {
                        dot(a.normal, held)
                            .abs()
                            .total_cmp(&dot(b.normal, held).abs())
                    })
                    .filter(|s| dot(s.normal, held).abs() > 0.7)?;
                self.normals[i] = sheet.normal.map(|c| c as f32);
                worst = worst.max(beyond(sheet.offset).abs());
            }
            let step = self.newton_step(&here, beyond)?;
            x = add_scaled(x, 1.0, step);
            for k in 0..3 {
                x[k] = x[k].clamp(0.0, extent[k]);
            }
            if worst < close {
                return Some(x);
            }
        }
        let here = near(x);
        let close = self.normals().all(|held| {
            here.iter()
                .any(|s| dot(s.normal, held).abs() > 0.7 && beyond(s.offset).abs() < 0.1)
        });
        close.then_some(x)
    }

    /// The smallest allowed move that cancels the offsets from the held sheets.
    fn newton_step(&self, near: &NearbyPlanes, beyond: impl Fn(f64) -> f64) -> Option<[f64; 3]> {
        let free = |mut n: [f64; 3]| {
            for k in 0..3 {
                if self.fixed_axes >> k & 1 == 1 {
                    n[k] = 0.0;
                }
            }
            n
        };
        let offset = |held: [f64; 3]| {
            near.iter()
                .find(|s| dot(s.normal, held).abs() > 0.99)
                .map(|s| (s.normal, beyond(s.offset)))
        };
        let mut normals = self.normals();
        let (n, s) = offset(normals.next()?)?;
        let a = free(n);
        let aa = dot(a, a);
        if aa < 0.05 {
            return None;
        }
        let Some(second) = normals.next() else {
            return Some(a.map(|c| -c * s / aa));
        };
        let (m, u) = offset(second)?;
        let b = free(m);
        let (ab, bb) = (dot(a, b), dot(b, b));
        let determinant = aa * bb - ab * ab;
        if determinant < 0.02 {
            return None;
        }
        let (p, q) = (
            (-s * bb + u * ab) / determinant,
            (-u * aa + s * ab) / determinant,
        );
        Some(add_scaled(a.map(|c| c * p), q, b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_on_one_side_of_the_sheets_they_see() {
        // Two parallel sheets, x = 0 and x = 3.6; what a node at x sees of one, by either normal.
        let beside = |x: f32, sheet: f32, sign: f32| {
            SurfaceProximity::Single([sign, 0.0, 0.0], sign * (x - sheet))
        };
        let safe = |p: (f32, SurfaceProximity), q: (f32, SurfaceProximity), alone: [bool; 2]| {
            let edge = [f64::from(q.0 - p.0), 2.0, 0.0];
            let there = p.1.is_same_side(q.1, edge, alone);
            let back =
                q.1.is_same_side(p.1, edge.map(|c| -c), [alone[1], alone[0]]);
            assert_eq!(there, back);
            there
        };
        for sign in [1.0, -1.0] {
            let see = |x: f32, sheet: f32| (x, beside(x, sheet, sign));
            let first = |x: f32| (x, beside(x, 0.0, 1.0));
            // Neither end on a sheet.
            assert!(safe(first(1.0), see(2.5, 0.0), [false; 2]));
            assert!(!safe(first(-1.0), see(2.5, 0.0), [false; 2]));
            assert!(safe(first(1.0), see(3.0, 3.6), [false; 2]));
            assert!(!safe(first(1.0), see(4.0, 3.6), [false; 2]));
            // One on its only sheet.
            assert!(safe(first(0.0), see(2.5, 0.0), [true, false]));
            assert!(safe(first(0.1), see(-2.5, 0.0), [true, false]));
            assert!(safe(first(0.0), see(3.0, 3.6), [true, false]));
            assert!(!safe(first(0.0), see(4.0, 3.6), [true, false]));
        }
        let (on, nothing) = (
            (0.0, beside(0.0, 0.0, 1.0)),
            (3.0, SurfaceProximity::Nothing),
        );
        assert!(safe(on, nothing, [true, false]));
        assert!(!safe((1.0, beside(1.0, 0.0, 1.0)), nothing, [false; 2]));
        assert!(!safe(on, (3.0, SurfaceProximity::Multiple), [true, false]));
    }

    #[test]
    fn a_node_may_stray_from_its_sheet_so_far_and_no_farther() {
        let mut points = Vec::new();
        for k in 0..=12 {
            for j in 0..=12 {
                points.push(crate::feature::FeaturePoint {
                    position: [6.0, j as f32, k as f32],
                    normal: [1.0, 0.0, 0.0],
                    strength: 1.0,
                });
            }
        }
        let extent = [12.0; 3];
        let sheets = FeaturePlanes::new(&points, extent, 3.0, 6.0);
        let mut lookup = PlaneCache::default();
        for (from, exact, loose) in [(6.2, 6.0, 6.2), (6.9, 6.0, 6.25), (5.1, 6.0, 5.75)] {
            let mut hold = NodeConstraint::default();
            hold.add_surface([1.0, 0.0, 0.0]);
            let x = [from, 6.0, 6.0];
            let on = hold.snap(x, extent, &sheets).unwrap();
            let near = hold
                .snap_within(0.25, x, extent, &sheets, &mut lookup)
                .unwrap();
            assert!((on[0] - exact).abs() < 1e-6, "{on:?}");
            assert!((near[0] - loose).abs() < 1e-6, "{near:?}");
            assert_eq!((on[1], on[2], near[1], near[2]), (6.0, 6.0, 6.0, 6.0));
        }
    }
}
