//! Options in units of length, which become numbers of samples of the image.

use super::{MeshSpec, NominalDistance};
use crate::error::cause;
use crate::image::Geometry;
use crate::image::time::metres_per_unit;
use crate::units::Unit;
use crate::{Error, Result};

/// Largest relative difference between the lengths of a unit of distance along the axes.
const MAX_RATIO_ERROR: f64 = 1e-6;

impl MeshSpec {
    /// Returns the name, the value and the unit of the first option that has a unit of length.
    pub(in crate::job) fn unit_of_lengths(&self) -> Option<(&'static str, String, Unit)> {
        let distance = self.distance.unit();
        let distance = distance.map(|unit| ("distance", self.distance.to_string(), unit));
        let label = || {
            let mut labels = self.label.iter();
            labels.find_map(|label| Some(("label", label.to_string(), label.unit?)))
        };
        let well = || {
            let length = self.well_distance?;
            Some(("well-distance", length.to_string(), length.unit?))
        };
        let extension = || {
            let length = self.extend_faults?;
            Some(("extend-faults", length.to_string(), length.unit?))
        };
        distance.or_else(label).or_else(well).or_else(extension)
    }

    /// Returns the options with all distances in the unit of the metric, which is known, for an image
    /// with this geometry.
    ///
    /// # Errors
    /// Returns [`Error::Distance`] if an option has a unit of length and the image has none, or if the
    /// cells are regular in another space.
    pub fn with_lengths_in<const D: usize>(&self, geometry: &Geometry<D>) -> Result<Self> {
        let Some((option, value, unit)) = self.unit_of_lengths() else {
            return Ok(self.clone());
        };
        let refuse = |problem: String, remedy: String| {
            Error::Distance(cause(format!("{option} {value}"), problem, remedy))
        };
        let symbol = unit.symbol;
        let spacing = metres_between_samples(geometry).ok_or_else(|| {
            if geometry.time_coordinate().is_some() {
                let problem = "is a length, but one coordinate of the image is time";
                let remedy = "convert it to depth (--velocity), or give a number of samples";
                return refuse(problem.into(), remedy.into());
            }
            let remedy = if *geometry == Geometry::default() {
                let ones = vec!["1"; D].join(",");
                format!("give them, such as --spacing {ones} --unit {symbol}, or give a number of samples")
            } else {
                format!("give it, such as --unit {symbol}, or give a number of samples")
            };
            let problem = "is a length, but the image does not say in which unit its samples lie";
            refuse(problem.into(), remedy)
        })?;
        let lengths = self.metric.lengths(geometry);
        let ratios: [f64; D] = std::array::from_fn(|k| lengths[k] / spacing[k]);
        let per_metre = ratios[0];
        if ratios
            .iter()
            .any(|r| (r / per_metre - 1.0).abs() > MAX_RATIO_ERROR)
        {
            let problem = format!(
                "is a length, but with --metric {} cells are not regular in space",
                self.metric
            );
            let remedy = "omit --metric, or give a number of samples";
            return Err(refuse(problem, remedy.into()));
        }
        let mut spec = self.clone();
        if let NominalDistance::InUnit { min, max, unit } = spec.distance {
            let [min, max] = [min, max].map(|d| d * unit.size * per_metre);
            spec.distance = if min == max {
                NominalDistance::Constant(max)
            } else {
                NominalDistance::Range { min, max }
            };
        }
        for label in &mut spec.label {
            if let (Some(d), Some(unit)) = (&mut label.distance, label.unit.take()) {
                *d *= unit.size * per_metre;
            }
        }
        let others = [&mut spec.well_distance, &mut spec.extend_faults];
        for length in others.into_iter().flatten() {
            if let Some(unit) = length.unit.take() {
                length.value *= unit.size * per_metre;
            }
        }
        Ok(spec)
    }
}

/// Returns the distance between samples along each axis in metres; `None` if a coordinate has no unit of
/// length.
fn metres_between_samples<const D: usize>(geometry: &Geometry<D>) -> Option<[f64; D]> {
    let metres = geometry.units.each_ref().map(|unit| metres_per_unit(unit));
    let metres: Vec<f64> = metres.into_iter().collect::<Option<_>>()?;
    let length = |axis: [f64; D]| {
        let squares = axis.iter().zip(&metres).map(|(x, size)| (x * size).powi(2));
        squares.sum::<f64>().sqrt()
    };
    Some(geometry.axes.map(length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Metric;
    use crate::option_text::Length;

    /// Returns options with a metric and distances, of which a label has one of its own.
    fn spec(metric: Metric, distance: &str) -> MeshSpec {
        MeshSpec {
            metric,
            distance: distance.parse().unwrap(),
            label: vec!["3:distance=50um".parse().unwrap()],
            well_distance: Some("0.1 cm".parse().unwrap()),
            ..MeshSpec::default()
        }
    }

    /// Returns a geometry with these distances between samples.
    fn geometry(spacing: [f64; 3], unit: &str) -> Geometry<3> {
        Geometry {
            units: [unit; 3].map(String::from),
            ..Geometry::with_spacing([0.0; 3], spacing)
        }
    }

    #[test]
    fn lengths_become_samples_whose_cube_has_the_volume_of_a_sample() {
        // A unit of distance is the cube root of 0.5 x 0.5 x 4 mm.
        let flat =
            spec(Metric::Shape, "2mm:0.8cm").with_lengths_in(&geometry([0.5, 0.5, 4.0], "mm"));
        let flat = flat.unwrap();
        let [min, max] = flat.distance.limits();
        assert!(
            (min - 2.0).abs() < 1e-12 && (max - 8.0).abs() < 1e-12,
            "{min} {max}"
        );
        assert_eq!(flat.distance.unit(), None);
        assert!((flat.label[0].distance.unwrap() - 0.05).abs() < 1e-12);
        assert!((flat.well_distance.unwrap().value - 1.0).abs() < 1e-12);
        // In physical units of the image the length is a length in its unit.
        let physical =
            spec(Metric::Physical, "3mm").with_lengths_in(&geometry([0.5, 0.5, 4.0], "um"));
        let [min, max] = physical.unwrap().distance.limits();
        assert!((min - 3000.0).abs() < 1e-9 && min == max, "{min}");
        // Samples that are cubes are as good as space.
        let cubes = spec(Metric::Samples, "3mm")
            .with_lengths_in(&geometry([1.5; 3], "mm"))
            .unwrap();
        assert!((cubes.distance.limits()[0] - 2.0).abs() < 1e-12);
        let plain = MeshSpec {
            well_distance: Some(Length::samples(3.0)),
            ..MeshSpec::default()
        };
        assert_eq!(
            plain.with_lengths_in(&Geometry::<3>::default()).unwrap(),
            plain
        );
    }

    #[test]
    fn lengths_are_refused_where_no_space_is_known() {
        let message = |metric, geometry: &Geometry<3>| {
            let error = spec(metric, "3mm").with_lengths_in(geometry).unwrap_err();
            error.to_string()
        };
        let bare = message(Metric::Samples, &Geometry::default());
        assert!(
            bare.contains("distance 3mm") && bare.contains("--spacing 1,1,1 --unit mm"),
            "{bare}"
        );
        let unknown = message(Metric::Shape, &geometry([1.0, 1.0, 2.0], ""));
        assert!(unknown.contains("such as --unit mm"), "{unknown}");
        let flat = message(Metric::Samples, &geometry([1.0, 1.0, 2.0], "mm"));
        assert!(flat.contains("omit --metric"), "{flat}");
        let mut time = geometry([1.0, 1.0, 2.0], "m");
        time.units[2] = "ms".into();
        assert!(message(Metric::Shape, &time).contains("--velocity"));
    }
}
