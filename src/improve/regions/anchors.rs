//! Keeps nodes on given surfaces while faces are fitted to the interfaces between labels.

use crate::geometry::{add_scaled, dot, norm, to_3d, unit};
use crate::improve::feature_planes::{FeaturePlanes, MAX_FACE_OFFSET};

/// Smallest length of the part of a unit normal that is perpendicular to other normals, from which it
/// counts as another direction.
const MIN_INDEPENDENT_LENGTH: f64 = 0.1;

/// Nodes that stay on surfaces.
#[derive(Debug)]
pub struct AnchoredNodes {
    /// The surfaces.
    pub planes: FeaturePlanes,
    /// For each node, `true` if it stays on the surfaces that pass through it.
    pub is_anchored: Vec<bool>,
}

impl AnchoredNodes {
    /// Returns the part of a move of node `n`, which is at `x`, that leads along the surfaces. The
    /// move has no part along the axes that are fixed.
    pub(super) fn along_surfaces<const D: usize>(
        &self,
        n: u32,
        x: [f64; D],
        displacement: [f64; D],
        is_fixed: [bool; D],
    ) -> [f64; D] {
        if !self.is_anchored[n as usize] {
            return displacement;
        }
        let mut rest = displacement;
        let mut normals: Vec<[f64; D]> = Vec::new();
        for plane in self.planes.planes_near(to_3d(x)).iter() {
            let mut normal =
                std::array::from_fn(|k| if is_fixed[k] { 0.0 } else { plane.normal[k] });
            for other in &normals {
                normal = add_scaled(normal, -dot(normal, *other), *other);
            }
            if plane.offset.abs() < MAX_FACE_OFFSET && norm(normal) > MIN_INDEPENDENT_LENGTH {
                let normal = unit(normal);
                rest = add_scaled(rest, -dot(rest, normal), normal);
                normals.push(normal);
            }
        }
        rest
    }
}
