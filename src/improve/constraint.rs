//! Constraints of a node: the sides of the box, and the feature surfaces on which it lies.

use super::feature_planes::{FeaturePlanes, NearbyPlanes, SAME_SURFACE_COSINE};
use super::plane_cache::PlaneCache;
use crate::files::codec::codec_fields;
use crate::geometry::{add_scaled, dot, norm};
use crate::lattice::AtomKind;

/// Largest distance, in samples, of a node from a surface that still counts as lying on it.
/// Snapping leaves a smaller distance.
const ON_SURFACE_TOLERANCE: f64 = 0.11;

/// Feature surfaces close to a node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SurfaceProximity {
    /// No surface is close.
    Nothing,
    /// One surface is close: its normal, and the node's signed distance from it in samples.
    Single([f32; 3], f32),
    /// Several surfaces are close.
    Multiple,
}

impl SurfaceProximity {
    /// Returns `true` if both ends of an edge are surely on the same side of the surfaces close to
    /// them. `is_isolated` is `true` for each end that lies on a surface and has no other surface
    /// near.
    #[inline]
    pub fn is_same_side(self, other: Self, edge: [f64; 3], is_isolated: [bool; 2]) -> bool {
        let edge = edge.map(|c| c as f32);
        let component = |n: [f32; 3]| dot(n, edge);
        match (self, other) {
            (Self::Single(m, r), Self::Single(n, s)) => {
                // Signed distance of each end from the other end's surface. An end that lies on its
                // own surface and close to the other's is on one and the same surface.
                let (p, q) = (s - component(n), r + component(m));
                let is_same_side_of_second =
                    p * s > 0.0 || is_isolated[0] && p.abs() < SAME_SURFACE_OFFSET;
                let is_same_side_of_first =
                    q * r > 0.0 || is_isolated[1] && q.abs() < SAME_SURFACE_OFFSET;
                (is_isolated[1] || is_same_side_of_second)
                    && (is_isolated[0] || is_same_side_of_first)
            }
            (Self::Single(..), Self::Nothing) => is_isolated[0],
            (Self::Nothing, Self::Single(..)) => is_isolated[1],
            _ => false,
        }
    }
}

/// Largest distance, in samples, of a point of one plane from another plane of the same surface.
const SAME_SURFACE_OFFSET: f32 = 1.0;

/// Largest ratio of such a distance to that between the points, where it is more than
/// [`SAME_SURFACE_OFFSET`].
const SAME_SURFACE_SLOPE: f64 = 0.25;

/// Directions in which a node may move.
#[derive(Debug, Clone, Copy)]
pub struct Freedom {
    fixed_axes: u8,
    /// Forbidden directions: orthogonal to one another and to the fixed axes.
    removed_directions: [Option<[f64; 3]>; 2],
}

impl Freedom {
    /// Returns the component of `v` along which the node may move.
    #[inline]
    pub fn project(&self, mut v: [f64; 3]) -> [f64; 3] {
        for b in self.removed_directions.iter().flatten() {
            v = add_scaled(v, -dot(v, *b), *b);
        }
        without_axes(v, self.fixed_axes)
    }
}

/// Returns `v` with the components along these axes set to 0: bit k stands for axis k.
#[inline]
fn without_axes(v: [f64; 3], axes: u8) -> [f64; 3] {
    std::array::from_fn(|k| if axes >> k & 1 == 1 { 0.0 } else { v[k] })
}

/// Returns the sides of the box `[0, extent]` in which all of the points lie: bit k for a side
/// normal to axis k.
pub fn common_sides<const D: usize>(
    points: impl Iterator<Item = [f64; D]> + Clone,
    extent: [f64; D],
) -> u8 {
    let is_common = |&k: &usize| {
        let mut coordinates = points.clone().map(|x| x[k]);
        let first = coordinates.next().unwrap_or(f64::NAN);
        (first == 0.0 || first == extent[k]) && coordinates.all(|x| x == first)
    };
    (0..D).filter(is_common).fold(0, |bits, k| bits | 1 << k)
}

/// Constraints of one node.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct NodeConstraint {
    /// Bit k is set if coordinate k is fixed: the node lies in a side of the box normal to axis k,
    /// or is fixed.
    pub fixed_axes: u8,
    /// Number of feature surfaces that hold the node.
    pub surface_count: u8,
    /// `true` if no feature lies within the search reach of the node.
    pub is_far: bool,
    /// `true` if the node lies on one surface and no other surface is near.
    pub is_isolated: bool,
    pub(super) normals: [[f32; 3]; 2],
}

codec_fields! {
    NodeConstraint as NodeConstraint { fixed_axes, surface_count, is_far, is_isolated, normals }
}

impl NodeConstraint {
    /// Returns the constraints by the sides of the box `[0, extent]` and by the features on which
    /// the node lies.
    ///
    /// Also returns the surfaces close to the node. Surfaces that do not hold the node are known
    /// only if a feature point is close (see [`FeaturePlanes::is_close`]).
    pub fn new(
        x: [f64; 3],
        kind: AtomKind,
        extent: [f64; 3],
        planes: &FeaturePlanes,
    ) -> (Self, SurfaceProximity) {
        let mut constraint = Self::from_box(x, kind, extent);
        constraint.is_far = planes.is_far(x);
        if constraint.is_far || !planes.is_close(x) {
            return (constraint, SurfaceProximity::Nothing);
        }
        let nearby = planes.planes_near(x);
        for plane in nearby
            .iter()
            .filter(|s| s.offset.abs() < ON_SURFACE_TOLERANCE)
        {
            constraint.add_surface(plane.normal);
        }
        let mut nearest = nearby.iter();
        let proximity = match (nearest.next(), nearest.next()) {
            (None, _) => SurfaceProximity::Nothing,
            (Some(only), None) => {
                SurfaceProximity::Single(only.normal.map(|c| c as f32), only.offset as f32)
            }
            _ => SurfaceProximity::Multiple,
        };
        constraint.is_isolated =
            constraint.surface_count == 1 && matches!(proximity, SurfaceProximity::Single(..));
        (constraint, proximity)
    }

    /// Returns the constraints by the sides of the box `[0, extent]` alone.
    pub fn from_box(x: [f64; 3], kind: AtomKind, extent: [f64; 3]) -> Self {
        let mut constraint = Self::default();
        if kind == AtomKind::Fixed {
            constraint.fixed_axes = 7;
        }
        for k in 0..3 {
            if x[k] == 0.0 || x[k] == extent[k] {
                constraint.fixed_axes |= 1 << k;
            }
        }
        constraint
    }

    /// Returns the normals of the surfaces that hold the node.
    pub fn normals(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        self.normals[..usize::from(self.surface_count)]
            .iter()
            .map(|n| n.map(f64::from))
    }

    /// Returns `true` if a surface with this normal holds the node.
    pub fn is_on_surface(&self, normal: [f64; 3]) -> bool {
        self.normals()
            .any(|n| dot(n, normal).abs() > SAME_SURFACE_COSINE)
    }

    /// Returns `true` if a surface that holds the node passes through the point at `displacement`
    /// from the node, where its normal is `normal`. Of two parallel surfaces, such as the sides of a
    /// thin layer, a node lies on one only.
    pub fn shares_surface(&self, normal: [f64; 3], displacement: [f64; 3]) -> bool {
        // The mean of two normals of a curved surface is perpendicular to the chord, but for terms
        // of third order. Between parallel surfaces, it measures their distance.
        let max_offset =
            f64::from(SAME_SURFACE_OFFSET).max(SAME_SURFACE_SLOPE * norm(displacement));
        self.normals().any(|own| {
            let cosine = dot(own, normal);
            let sum = add_scaled(own, cosine.signum(), normal);
            cosine.abs() > SAME_SURFACE_COSINE && 0.5 * dot(sum, displacement).abs() < max_offset
        })
    }

    /// Adds a surface, unless one with this normal is there already or two surfaces hold the node.
    pub fn add_surface(&mut self, normal: [f64; 3]) {
        if usize::from(self.surface_count) < self.normals.len() && !self.is_on_surface(normal) {
            self.normals[usize::from(self.surface_count)] = normal.map(|c| c as f32);
            self.surface_count += 1;
        }
    }

    /// Returns `true` if the sides of the box allow the node to move between two positions.
    pub fn allows_move<const D: usize>(&self, from: [f64; D], to: [f64; D]) -> bool {
        (0..D).all(|k| self.fixed_axes >> k & 1 == 0 || from[k] == to[k])
    }

    /// Removes all surfaces.
    pub fn clear_surfaces(&mut self) {
        self.surface_count = 0;
        self.is_isolated = false;
    }

    /// Returns a copy without the surfaces.
    pub fn without_surfaces(&self) -> Self {
        Self {
            fixed_axes: self.fixed_axes,
            ..Self::default()
        }
    }

    /// Returns the directions in which the node may move.
    pub fn freedom(&self) -> Freedom {
        Freedom {
            fixed_axes: self.fixed_axes,
            removed_directions: self.removed_directions(),
        }
    }

    /// Returns orthonormal directions, within those that the box allows, that the surfaces forbid.
    fn removed_directions(&self) -> [Option<[f64; 3]>; 2] {
        let mut basis: [Option<[f64; 3]>; 2] = [None; 2];
        for (i, n) in self.normals().enumerate() {
            let mut n = without_axes(n, self.fixed_axes);
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

    /// Returns `true` if every constraint of this node holds for `other`, too, which is at
    /// `displacement` from it, so that this node may be merged into the other.
    pub fn is_subset_of(&self, other: &NodeConstraint, displacement: [f64; 3]) -> bool {
        self.fixed_axes & !other.fixed_axes == 0
            && (self.normals()).all(|n| other.shares_surface(n, displacement))
    }

    /// Returns `x` moved back onto the surfaces that hold the node, by a few Newton steps within
    /// the box; `None` if the surfaces are no longer near.
    pub fn snap(
        &mut self,
        x: [f64; 3],
        extent: [f64; 3],
        planes: &FeaturePlanes,
    ) -> Option<[f64; 3]> {
        self.newton_steps(x, extent, [0.0, 0.01], |x| planes.planes_near(x))
    }

    /// Snaps as [`snap`](Self::snap) does, but uses [cached](PlaneCache) planes and leaves a
    /// distance of up to `max_deviation` from the surfaces.
    pub fn snap_within(
        &mut self,
        max_deviation: f64,
        x: [f64; 3],
        extent: [f64; 3],
        planes: &FeaturePlanes,
        cache: &mut PlaneCache,
    ) -> Option<[f64; 3]> {
        // One step reaches a plane. The planes of the next cache cell may differ a little, hence
        // the loose tolerance.
        self.newton_steps(x, extent, [max_deviation, 0.1], |x| {
            cache.planes_near(planes, x)
        })
    }

    /// Steps until the node is at most `max_deviation` from all surfaces, or was at most
    /// `tolerance` farther away before the last step.
    fn newton_steps(
        &mut self,
        mut x: [f64; 3],
        extent: [f64; 3],
        [max_deviation, tolerance]: [f64; 2],
        mut planes_at: impl FnMut([f64; 3]) -> NearbyPlanes,
    ) -> Option<[f64; 3]> {
        if self.surface_count == 0 {
            return Some(x);
        }
        let excess = |offset: f64| offset - offset.clamp(-max_deviation, max_deviation);
        for _ in 0..3 {
            let nearby = planes_at(x);
            let mut max_excess = 0.0f64;
            for i in 0..usize::from(self.surface_count) {
                let old_normal = self.normals[i].map(f64::from);
                let plane = nearby
                    .iter()
                    .max_by(|a, b| {
                        dot(a.normal, old_normal)
                            .abs()
                            .total_cmp(&dot(b.normal, old_normal).abs())
                    })
                    .filter(|s| dot(s.normal, old_normal).abs() > 0.7)?;
                self.normals[i] = plane.normal.map(|c| c as f32);
                max_excess = max_excess.max(excess(plane.offset).abs());
            }
            let step = self.newton_step(&nearby, excess)?;
            x = add_scaled(x, 1.0, step);
            for k in 0..3 {
                x[k] = x[k].clamp(0.0, extent[k]);
            }
            if max_excess < tolerance {
                return Some(x);
            }
        }
        let nearby = planes_at(x);
        let is_close = self.normals().all(|normal| {
            nearby
                .iter()
                .any(|s| dot(s.normal, normal).abs() > 0.7 && excess(s.offset).abs() < 0.1)
        });
        is_close.then_some(x)
    }

    /// Returns the smallest allowed step that cancels the offsets from the surfaces that hold the
    /// node.
    fn newton_step(&self, nearby: &NearbyPlanes, excess: impl Fn(f64) -> f64) -> Option<[f64; 3]> {
        let project = |n: [f64; 3]| without_axes(n, self.fixed_axes);
        let matching_plane = |normal: [f64; 3]| {
            nearby
                .iter()
                .find(|s| dot(s.normal, normal).abs() > 0.99)
                .map(|s| (s.normal, excess(s.offset)))
        };
        let mut normals = self.normals();
        let (n, s) = matching_plane(normals.next()?)?;
        let a = project(n);
        let aa = dot(a, a);
        if aa < 0.05 {
            return None;
        }
        let Some(second) = normals.next() else {
            return Some(a.map(|c| -c * s / aa));
        };
        let (m, u) = matching_plane(second)?;
        let b = project(m);
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
    use crate::geometry::sub;

    #[test]
    fn same_side_is_sure_only_where_no_surface_lies_between() {
        // Two parallel surfaces, x = 0 and x = 3.6. A node at x knows the plane of one of them,
        // with either sign of the normal.
        let proximity = |x: f32, plane_x: f32, sign: f32| {
            SurfaceProximity::Single([sign, 0.0, 0.0], sign * (x - plane_x))
        };
        let is_same_side =
            |p: (f32, SurfaceProximity), q: (f32, SurfaceProximity), is_isolated: [bool; 2]| {
                let edge = [f64::from(q.0 - p.0), 2.0, 0.0];
                let forward = p.1.is_same_side(q.1, edge, is_isolated);
                let backward =
                    q.1.is_same_side(p.1, edge.map(|c| -c), [is_isolated[1], is_isolated[0]]);
                assert_eq!(forward, backward);
                forward
            };
        for sign in [1.0, -1.0] {
            let near_plane = |x: f32, plane_x: f32| (x, proximity(x, plane_x, sign));
            let near_first_plane = |x: f32| (x, proximity(x, 0.0, 1.0));
            // Neither end lies on a surface.
            assert!(is_same_side(
                near_first_plane(1.0),
                near_plane(2.5, 0.0),
                [false; 2]
            ));
            assert!(!is_same_side(
                near_first_plane(-1.0),
                near_plane(2.5, 0.0),
                [false; 2]
            ));
            assert!(is_same_side(
                near_first_plane(1.0),
                near_plane(3.0, 3.6),
                [false; 2]
            ));
            assert!(!is_same_side(
                near_first_plane(1.0),
                near_plane(4.0, 3.6),
                [false; 2]
            ));
            // The first end lies on its only surface.
            assert!(is_same_side(
                near_first_plane(0.0),
                near_plane(2.5, 0.0),
                [true, false]
            ));
            assert!(is_same_side(
                near_first_plane(0.1),
                near_plane(-2.5, 0.0),
                [true, false]
            ));
            assert!(is_same_side(
                near_first_plane(0.0),
                near_plane(3.0, 3.6),
                [true, false]
            ));
            assert!(!is_same_side(
                near_first_plane(0.0),
                near_plane(4.0, 3.6),
                [true, false]
            ));
        }
        let (on_plane, nothing) = (
            (0.0, proximity(0.0, 0.0, 1.0)),
            (3.0, SurfaceProximity::Nothing),
        );
        assert!(is_same_side(on_plane, nothing, [true, false]));
        assert!(!is_same_side(
            (1.0, proximity(1.0, 0.0, 1.0)),
            nothing,
            [false; 2]
        ));
        assert!(!is_same_side(
            on_plane,
            (3.0, SurfaceProximity::Multiple),
            [true, false]
        ));
    }

    #[test]
    fn a_node_shares_its_curved_surface_but_not_a_parallel_one() {
        let on_sphere = |radius: f64, angle: f64| {
            let normal = [angle.cos(), angle.sin(), 0.0];
            (normal.map(|c| radius * c), normal)
        };
        let (x, normal) = on_sphere(11.0, 0.0);
        let mut constraint = NodeConstraint::default();
        constraint.add_surface(normal);
        for degrees in [0.0, 5.0, 15.0, 25.0, 30.0f64] {
            for (radius, sign, is_shared) in
                [(11.0, 1.0, true), (11.0, -1.0, true), (14.0, 1.0, false)]
            {
                let (y, other_normal) = on_sphere(radius, degrees.to_radians());
                let displacement = sub(y, x);
                for displacement in [displacement, displacement.map(|c| -c)] {
                    assert_eq!(
                        constraint.shares_surface(other_normal.map(|c| sign * c), displacement),
                        is_shared,
                        "{degrees} {radius} {sign}"
                    );
                }
            }
        }
        assert!(!constraint.shares_surface([0.0, 1.0, 0.0], [0.0; 3]));
    }

    #[test]
    fn snap_within_leaves_at_most_the_allowed_deviation() {
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
        let planes = FeaturePlanes::new(&points, extent, 3.0, 6.0);
        let mut cache = PlaneCache::default();
        for (start, exact, loose) in [(6.2, 6.0, 6.2), (6.9, 6.0, 6.25), (5.1, 6.0, 5.75)] {
            let mut constraint = NodeConstraint::default();
            constraint.add_surface([1.0, 0.0, 0.0]);
            let x = [start, 6.0, 6.0];
            let snapped = constraint.snap(x, extent, &planes).unwrap();
            let snapped_within = constraint
                .snap_within(0.25, x, extent, &planes, &mut cache)
                .unwrap();
            assert!((snapped[0] - exact).abs() < 1e-6, "{snapped:?}");
            assert!(
                (snapped_within[0] - loose).abs() < 1e-6,
                "{snapped_within:?}"
            );
            assert_eq!(
                (snapped[1], snapped[2], snapped_within[1], snapped_within[2]),
                (6.0, 6.0, 6.0, 6.0)
            );
        }
    }
}
