//! The bins of a survey in the map, and the line numbers of positions.

use crate::geometry::norm;
use crate::image::Geometry;
use crate::image::formats::{AnyImage, LineNumbers};

/// The bins of a survey: a grid in the map, along its inlines and crosslines.
#[derive(Debug, Clone, PartialEq)]
pub struct SurveyGrid {
    /// Number of bins along both axes.
    pub dims: [usize; 2],
    /// Positions of the bins.
    pub geometry: Geometry<2>,
    /// Inline and crossline numbers, each with the axis along which it counts.
    lines: Option<[(usize, LineNumbers); 2]>,
}

impl SurveyGrid {
    /// Returns the bins of an image whose third coordinate is vertical; `None` for a plane, and for an
    /// image without a vertical axis.
    pub fn new(image: &AnyImage) -> Option<Self> {
        let AnyImage::Space(loaded) = image else {
            return None;
        };
        let (geometry, dims) = (&loaded.image.geometry, loaded.image.dims());
        let vertical = geometry.axis_along(2)?;
        let mut axes: Vec<usize> = (0..3).filter(|&k| k != vertical).collect();
        let step = |k: usize| [geometry.axes[k][0], geometry.axes[k][1]];
        // The first axis is that nearest to x, as in all formats of grids.
        let slope = |k: usize| (step(k)[0] / norm(step(k))).abs();
        if slope(axes[1]) > slope(axes[0]) {
            axes.swap(0, 1);
        }
        let mut origin = [geometry.origin[0], geometry.origin[1]];
        let mut grid = Geometry::<2>::default();
        for (k, &axis) in axes.iter().enumerate() {
            grid.axes[k] = step(axis);
            grid.names[k].clone_from(&geometry.names[axis]);
            if step(axis)[k] < 0.0 {
                // Against the axis of the survey, from its last bin.
                let last = (dims[axis] - 1) as f64;
                origin = [0, 1].map(|c| origin[c] + last * step(axis)[c]);
                grid.axes[k] = step(axis).map(|c| -c);
            }
        }
        grid.origin = origin;
        grid.units = [0, 1].map(|c| geometry.units[c].clone());
        let axis_of = |name: &str| grid.names.iter().position(|axis| axis == name);
        let lines = loaded.line_numbers.and_then(|[inlines, crosslines]| {
            Some([
                (axis_of("inline")?, inlines),
                (axis_of("crossline")?, crosslines),
            ])
        });
        let is_reversed = |k: usize| step(axes[k])[k] < 0.0;
        let reversed = |(k, numbers): (usize, LineNumbers)| {
            let numbers = if is_reversed(k) {
                LineNumbers {
                    first: numbers.last(),
                    step: -numbers.step,
                    ..numbers
                }
            } else {
                numbers
            };
            (k, numbers)
        };
        Some(Self {
            dims: [dims[axes[0]], dims[axes[1]]],
            lines: lines.map(|lines| lines.map(reversed)),
            geometry: grid,
        })
    }

    /// Returns the nearest inline and crossline of a position; `None` if the survey has no line
    /// numbers.
    pub fn lines_at(&self, position: [f64; 2]) -> Option<[i64; 2]> {
        let index = self.geometry.to_index(position)?;
        let number = |(k, numbers): (usize, LineNumbers)| {
            numbers.first + numbers.step * index[k].round() as i64
        };
        self.lines.map(|lines| lines.map(number))
    }

    /// Returns `true` if the survey has line numbers.
    pub fn has_lines(&self) -> bool {
        self.lines.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Image;
    use crate::image::formats::LoadedImage;

    #[test]
    fn bins_and_line_numbers_of_a_rotated_survey() {
        // Samples downwards, then crosslines, then inlines; inlines count against x.
        let (sin, cos) = 20f64.to_radians().sin_cos();
        let geometry = Geometry {
            origin: [1000.0, 2000.0, -500.0],
            axes: [
                [0.0, 0.0, -4.0],
                [-12.5 * sin, 12.5 * cos, 0.0],
                [-25.0 * cos, -25.0 * sin, 0.0],
            ],
            names: ["sample", "crossline", "inline"].map(String::from),
            units: ["m", "m", "ms"].map(String::from),
        };
        let image = Image::new([3, 5, 4], vec![0.0; 60], geometry.clone());
        let numbers = |first, step, count| LineNumbers { first, step, count };
        let loaded = LoadedImage {
            line_numbers: Some([numbers(100, 2, 4), numbers(7, 1, 5)]),
            ..LoadedImage::from(image)
        };
        let grid = SurveyGrid::new(&AnyImage::Space(loaded)).unwrap();
        assert_eq!(grid.dims, [4, 5]);
        // The first axis is nearest to x, and both are right-handed.
        assert!((grid.geometry.axes[0][0] - 25.0 * cos).abs() < 1e-9);
        assert!(grid.geometry.determinant() > 0.0);
        for (inline, crossline) in [(0, 0), (3, 0), (2, 4)] {
            let [x, y, _] = geometry.to_physical([1.0, crossline as f64, inline as f64]);
            let lines = [100 + 2 * inline, 7 + crossline];
            assert_eq!(grid.lines_at([x, y]), Some(lines));
        }
        let plane = Image::new([2, 2], vec![0.0; 4], Geometry::default());
        assert_eq!(SurveyGrid::new(&AnyImage::Plane(plane.into())), None);
    }
}
