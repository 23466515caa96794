//! Outcome of detection for each kind of feature: numbers of points, dropped points, and
//! credibility.

use super::confidence::Confidences;
use super::surfaces::FeatureSurfaces;
use super::world_dip::WorldDip;
use super::{DroppedPoints, FeatureKind, FeaturePoint, SharedGrid};
use crate::error::Result;
use crate::image::Geometry;
use crate::image::time::DEFAULT_VELOCITY;
use serde::Serialize;

/// Smallest dip of a fault, in degrees: faults seldom dip by less, but layers mostly do.
pub const MIN_FAULT_DIP: f64 = 30.0;

/// Outcome for one kind of feature in an image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct KindOutcome {
    /// The kind.
    pub kind: FeatureKind,
    /// Number of points that the mesh follows.
    pub points: usize,
    /// Number of points that the mesh does not follow, by reason.
    pub dropped: DroppedPoints,
    /// Typical strength divided by that of noise; `None` if noise is not measured.
    pub signal_to_noise: Option<f32>,
    /// For faults, the share of the points that dip by less than [`MIN_FAULT_DIP`]. Two-way time is
    /// converted to depth at 2,000 m/s.
    pub gently_dipping: Option<f64>,
    /// Faults that are left out because they dip too little; `None` if there are none.
    pub below_min_dip: Option<FlatFaults>,
    /// Confidences of faults or horizons; `None` for other kinds, and where they cannot be measured.
    pub confidence: Option<Confidences>,
    /// Share of the image that lies in chaotic zones, in which none is searched for; `None` if there are no
    /// such zones, or features are searched for in them.
    pub chaotic: Option<f64>,
}

/// Faults that are left out because they dip less than
/// [`min_dip`](super::DetectionOptions::min_dip).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FlatFaults {
    /// The smallest dip of faults that are followed, in degrees.
    pub min_dip: f64,
    /// Number of faults that are left out.
    pub count: usize,
    /// Area of the largest, in square metres (in 2-D length in metres). Coordinates without a unit
    /// count as metres.
    pub largest_area: f64,
    /// Mean dips of the flattest and of the steepest, in degrees.
    pub dips: [f64; 2],
    /// Velocity in m/s at which two-way time was converted to depth; `None` if no coordinate is time.
    pub assumed_velocity: Option<f64>,
}

impl FlatFaults {
    /// Measures the surfaces of faults that dip too little; `None` if there are none. Normals are in
    /// lattice space, with samples `step` apart.
    pub(super) fn measure<const D: usize>(
        surfaces: &FeatureSurfaces<'_, D>,
        dips: &WorldDip<D>,
        geometry: &Geometry<D>,
        step: [f64; D],
        min_dip: f64,
    ) -> Option<Self> {
        // Area, and area times dip, of each surface.
        let mut sums = vec![[0.0; 2]; surfaces.surface_count];
        for (point, &surface) in surfaces.points.iter().zip(&surfaces.surface) {
            let normal = std::array::from_fn(|k| f64::from(point.normal[k]) * step[k]);
            let area = dips.area_of_column(normal);
            let sum = &mut sums[surface as usize - 1];
            *sum = [sum[0] + area, sum[1] + area * dips.degrees(normal)];
        }
        let means = || sums.iter().map(|[area, dip]| dip / area);
        (!sums.is_empty()).then(|| Self {
            min_dip,
            count: sums.len(),
            largest_area: sums.iter().map(|sum| sum[0]).fold(0.0, f64::max),
            dips: [
                means().fold(f64::INFINITY, f64::min),
                means().fold(0.0, f64::max),
            ],
            assumed_velocity: geometry.time_coordinate().map(|_| DEFAULT_VELOCITY),
        })
    }
}

impl KindOutcome {
    /// Returns the share of the points that are strong enough but dropped: because a stronger
    /// feature is near, or because their surface or a part of it is too small or too narrow.
    pub fn dropped_share(&self) -> f64 {
        let dropped = self.dropped.strong_count();
        dropped as f64 / (dropped + self.points).max(1) as f64
    }
}

impl DroppedPoints {
    /// Returns the number of points that were dropped for another reason than their strength.
    pub fn strong_count(&self) -> usize {
        self.near_another_surface + self.in_small_pieces + self.in_narrow_parts
    }
}

/// Shares of all samples that hold no data.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MissingData {
    /// Share in gaps so small that features are searched for across them.
    pub bridged: f64,
    /// Share in gaps in which no features are searched for.
    pub without_features: f64,
}

/// Returns the share of the points of all ranks at which a surface dips by less than
/// [`MIN_FAULT_DIP`] in world coordinates; `None` if there are no points. Normals are in lattice
/// space, with samples `step` apart.
///
/// # Errors
/// Returns the errors of other ranks.
pub(super) fn gently_dipping_share<const D: usize>(
    grid: SharedGrid<'_, D>,
    points: &[FeaturePoint<D>],
    dips: &WorldDip<D>,
    step: [f64; D],
) -> Result<Option<f64>> {
    let is_gentle = |point: &&FeaturePoint<D>| {
        let slope = std::array::from_fn(|k| f64::from(point.normal[k]) * step[k]);
        dips.degrees(slope) < MIN_FAULT_DIP
    };
    let local = [points.iter().filter(is_gentle).count(), points.len()];
    let [gentle, count] = grid.sum("points that dip gently", local)?;
    Ok((count > 0).then(|| gentle as f64 / count as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_counts_dips_in_world_coordinates() {
        // Inlines along y are 25 m apart, crosslines along x 12.5 m; time in ms increases
        // downwards: 4 ms are 4 m.
        let survey = Geometry {
            axes: [[0.0, 0.0, -4.0], [12.5, 0.0, 0.0], [0.0, 25.0, 0.0]],
            units: ["m".into(), "m".into(), "ms".into()],
            ..Geometry::default()
        };
        let grid = SharedGrid::of_one_process([1; 3]);
        let share = |dip: f64, azimuth: f64| {
            let (dip, azimuth) = (dip.to_radians(), azimuth.to_radians());
            let normal = [
                dip.sin() * azimuth.cos(),
                dip.sin() * azimuth.sin(),
                dip.cos(),
            ];
            // The normal in samples: its dot products with the axes.
            let slope = [-4.0 * normal[2], 12.5 * normal[0], 25.0 * normal[1]];
            let length = slope.iter().map(|c| c * c).sum::<f64>().sqrt();
            let point = FeaturePoint {
                position: [0.0; 3],
                normal: slope.map(|c| (c / length) as f32),
                strength: 1.0,
            };
            gently_dipping_share(grid, &[point], &WorldDip::new(&survey, 0), [1.0; 3]).unwrap()
        };
        for azimuth in [0.0, 50.0, 90.0, 200.0] {
            assert_eq!(share(28.0, azimuth), Some(1.0), "{azimuth}");
            assert_eq!(share(32.0, azimuth), Some(0.0), "{azimuth}");
        }
        assert_eq!(
            gently_dipping_share(grid, &[], &WorldDip::new(&survey, 0), [1.0; 3]).unwrap(),
            None
        );
    }
}
