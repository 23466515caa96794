//! Dips of surfaces in the world, in degrees from the horizontal.

use crate::geometry::norm;
use crate::image::Geometry;
use crate::image::time::default_metres_per_unit;

/// Converts normals of surfaces in samples to dips in world coordinates. Two-way time counts as depth
/// at 2,000 m/s.
pub(in crate::feature) struct WorldDip<const D: usize> {
    /// Geometry whose axes are the transposed axes of the image: it solves for a world normal.
    slopes: Geometry<D>,
    /// The world coordinate that is vertical.
    vertical: usize,
}

impl<const D: usize> WorldDip<D> {
    /// Creates the conversion for an image. The vertical coordinate is time, or else the one along
    /// the image axis `vertical_axis`, which layers lie across.
    pub fn new(geometry: &Geometry<D>, vertical_axis: usize) -> Self {
        let scale = geometry
            .units
            .each_ref()
            .map(|unit| default_metres_per_unit(unit));
        let along = geometry.axes[vertical_axis].map(f64::abs);
        let nearest = (1..D).fold(0, |a, c| if along[c] > along[a] { c } else { a });
        Self {
            // The dot product of a world normal with each axis is the slope along that axis of the
            // image.
            slopes: Geometry {
                axes: std::array::from_fn(|c| {
                    std::array::from_fn(|k| geometry.axes[k][c] * scale[c])
                }),
                ..Geometry::default()
            },
            vertical: geometry.time_coordinate().unwrap_or(nearest),
        }
    }

    /// Returns the area (in 2-D the length), in square metres, of the part of a surface with this
    /// normal in samples that one column of samples crosses. The column is along the axis nearest to
    /// the normal.
    pub fn area_of_column(&self, normal: [f64; D]) -> f64 {
        let steepest = normal.iter().fold(0.0, |max: f64, n| max.max(n.abs()));
        let world: Option<[f64; D]> = self.slopes.to_index(normal);
        world.map_or(0.0, |world| {
            self.slopes.determinant().abs() * norm(world) / steepest.max(f64::MIN_POSITIVE)
        })
    }

    /// Returns the dip, in degrees, of a surface with this normal in samples. Where the axes of the
    /// image span no space, every surface is vertical.
    pub fn degrees(&self, normal: [f64; D]) -> f64 {
        let Some(normal): Option<[f64; D]> = self.slopes.to_index(normal) else {
            return 90.0;
        };
        let cosine = normal[self.vertical].abs() / norm(normal);
        cosine.clamp(0.0, 1.0).acos().to_degrees()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dips_are_in_world_coordinates() {
        // Inlines along y are 25 m apart, crosslines along x 12.5 m; time in ms increases
        // downwards: 4 ms are 4 m.
        let survey = Geometry {
            axes: [[0.0, 0.0, -4.0], [12.5, 0.0, 0.0], [0.0, 25.0, 0.0]],
            units: ["m".into(), "m".into(), "ms".into()],
            ..Geometry::default()
        };
        // Without units, the axis that layers lie across is vertical.
        let samples = Geometry::default();
        for azimuth in [0.0f64, 50.0, 90.0, 200.0] {
            for dip in [5.0f64, 28.0, 60.0, 90.0] {
                let (azimuth, angle) = (azimuth.to_radians(), dip.to_radians());
                let normal = [
                    angle.sin() * azimuth.cos(),
                    angle.sin() * azimuth.sin(),
                    angle.cos(),
                ];
                // The normal in samples: its dot products with the axes.
                let slope = [-4.0 * normal[2], 12.5 * normal[0], 25.0 * normal[1]];
                let measured = WorldDip::new(&survey, 0).degrees(slope);
                assert!((measured - dip).abs() < 1e-6, "{azimuth} {dip} {measured}");
                // A column of samples of 12.5 m x 25 m crosses this area of a surface that dips.
                if dip < 10.0 {
                    let area = WorldDip::new(&survey, 0).area_of_column(slope);
                    let expected = 12.5 * 25.0 / angle.cos();
                    assert!((area / expected - 1.0).abs() < 1e-9, "{area} {expected}");
                }
                let feet = Geometry {
                    units: ["ft".into(), "ft".into(), "ms".into()],
                    ..survey.clone()
                };
                let slope = [
                    -4.0 * normal[2],
                    0.3048 * 12.5 * normal[0],
                    0.3048 * 25.0 * normal[1],
                ];
                let measured = WorldDip::new(&feet, 0).degrees(slope);
                assert!((measured - dip).abs() < 1e-6, "{azimuth} {dip} {measured}");
                let slope = [normal[2], normal[0], normal[1]];
                let measured = WorldDip::new(&samples, 0).degrees(slope);
                assert!((measured - dip).abs() < 1e-6, "{azimuth} {dip} {measured}");
            }
        }
    }
}
