//! The narrowest wedge between the faces and sides around a ridge.

use super::line::AcutePair;
use crate::files::codec::codec_fields;
use crate::geometry::{add_scaled, cross, dot, sub, to_3d, unit};

/// Maximum angle of a single edge of a line, in degrees. On a rough surface, single edges may be
/// wider than the mean.
const MAX_EDGE_ANGLE: f64 = 35.0;
/// Maximum distance of a node from a side of the box that contains it, relative to the length of
/// the box. It allows for rounding.
const SIDE_TOLERANCE: f64 = 1e-7;
/// Minimum size of a patch at an acute line: area over d^2, or in 2-D length over d.
const MIN_PATCH_SIZE: f64 = 2.0;

/// Half-plane that ends at a ridge.
struct Ray {
    /// Angle around the ridge, in radians.
    angle: f64,
    /// Face on a feature (`Ok`), or side of the box (`Err`).
    source: Result<u32, u8>,
}

/// Wedge between two rays.
#[derive(Debug, Clone, Copy)]
pub struct Wedge<const D: usize> {
    /// Global numbers of the ends of the ridge, their positions, and d there.
    pub ridge: [u32; 2],
    pub ends: [[f64; D]; 2],
    pub distance: [f64; 2],
    pub angle: f64,
    pub pair: AcutePair,
    /// Global numbers of the faces on features.
    pub faces: [Option<u32>; 2],
}

codec_fields! {
    @(const D: usize) Wedge<D> as Wedge { ridge, ends, distance, angle, pair, faces }
}

impl<const D: usize> Wedge<D> {
    /// Returns the minimum area of a patch at this wedge.
    pub fn min_patch_area(&self) -> f64 {
        let d = 0.5 * self.distance.iter().sum::<f64>();
        MIN_PATCH_SIZE * d.powi(D as i32 - 1)
    }
}

/// Returns the sides of the box that contain all of these positions.
pub fn common_sides<const D: usize>(
    positions: &[[f64; D]],
    extent: [f64; D],
) -> impl Iterator<Item = u8> {
    (0..2 * D as u8).filter(move |side| {
        let axis = usize::from(side / 2);
        let plane = if side.is_multiple_of(2) {
            0.0
        } else {
            extent[axis]
        };
        let distance = |x: &[f64; D]| (x[axis] - plane).abs();
        positions
            .iter()
            .all(|x| distance(x) <= SIDE_TOLERANCE * extent[axis])
    })
}

/// Returns the narrowest wedge at a ridge, if it is narrow enough for a line. `faces` has the
/// position of the node off the ridge, and the number, of each face at the ridge.
pub fn narrowest_wedge<const D: usize>(
    ridge: [u32; 2],
    ends: [[f64; D]; 2],
    distance: [f64; 2],
    faces: &mut dyn Iterator<Item = ([f64; D], u32)>,
    extent: [f64; D],
) -> Option<Wedge<D>> {
    let [a, b] = ends.map(to_3d);
    let axis = if D == 2 {
        [0.0, 0.0, 1.0]
    } else {
        unit(sub(b, a))
    };
    let perpendicular = |v: [f64; 3]| unit(add_scaled(v, -dot(v, axis), axis));
    let mut directions: Vec<([f64; 3], Result<u32, u8>)> = faces
        .map(|(apex, face)| (perpendicular(sub(to_3d(apex), a)), Ok(face)))
        .collect();
    let sides: Vec<u8> = common_sides(&ends, extent).collect();
    if directions.len() + sides.len() < 2 {
        return None;
    }
    // Component of a direction that points out of a side.
    let outward_component = |v: [f64; 3], side: u8| {
        let c = v[usize::from(side / 2)];
        if side.is_multiple_of(2) { -c } else { c }
    };
    for &side in &sides {
        let mut normal = [0.0; 3];
        normal[usize::from(side / 2)] = 1.0;
        let in_plane = unit(cross(axis, normal));
        let candidates = [in_plane, in_plane.map(|c| -c)].into_iter();
        let inward = candidates.filter(|&v| {
            sides
                .iter()
                .all(|&other| outward_component(v, other) <= SIDE_TOLERANCE)
        });
        directions.extend(inward.map(|v| (v, Err(side))));
    }
    let x = directions[0].0;
    let y = cross(axis, x);
    let mut rays: Vec<Ray> = (directions.iter())
        .map(|&(v, source)| Ray {
            angle: dot(v, y).atan2(dot(v, x)),
            source,
        })
        .collect();
    // Faces are in the order of their nodes, before sides, so that the stable sort is
    // deterministic.
    rays.sort_by(|a, b| a.angle.total_cmp(&b.angle));
    let wedge = |i: usize| {
        let (this, next) = (&rays[i], &rays[(i + 1) % rays.len()]);
        let angle = (next.angle - this.angle).rem_euclid(std::f64::consts::TAU);
        let pair = match (this.source, next.source) {
            (Ok(_), Ok(_)) => AcutePair::Features,
            (Ok(_), Err(side)) | (Err(side), Ok(_)) => AcutePair::Side(side),
            (Err(_), Err(_)) => return None,
        };
        let angle = angle.to_degrees();
        (angle < MAX_EDGE_ANGLE).then_some(Wedge {
            ridge,
            ends,
            distance,
            angle,
            pair,
            faces: [this.source.ok(), next.source.ok()],
        })
    };
    let wedges = (0..rays.len()).filter_map(wedge);
    wedges.min_by(|a, b| a.angle.total_cmp(&b.angle))
}
