//! The frame of a model: the map from a mesh's coordinates to metres with z upwards, so that depth
//! is known.

use crate::error::cause;
use crate::image::time::{metres_per_unit, seconds_per_unit};
use crate::model::flow::Tensor;
use crate::{Error, Result};

/// The coordinate that increases (or decreases) with depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DepthAxis {
    /// Number of the coordinate.
    pub axis: usize,
    /// `true` if it increases with depth.
    pub is_downward: bool,
}

impl Default for DepthAxis {
    /// Returns z upwards.
    fn default() -> Self {
        Self {
            axis: 2,
            is_downward: false,
        }
    }
}

/// The map from a mesh's coordinates to metres with z upwards, and its inverse.
///
/// The coordinate that is depth becomes the last one; the other two keep their cyclic order.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelFrame {
    /// Metres in one unit of each coordinate.
    scale: [f64; 3],
    depth_axis: DepthAxis,
    /// Value that is added to z.
    z_shift: f64,
}

impl Default for ModelFrame {
    /// Returns the identity.
    fn default() -> Self {
        Self {
            scale: [1.0; 3],
            depth_axis: DepthAxis::default(),
            z_shift: 0.0,
        }
    }
}

impl ModelFrame {
    /// Makes a frame from the units of the coordinates. One unit of length is `length` metres,
    /// whatever the mesh states; without `length`, the stated unit applies, or else a metre.
    /// Coordinates in two-way time become depth by `velocity` in m/s.
    ///
    /// # Errors
    /// Returns [`Error::Export`] for an unknown unit, for time without a velocity, and for time
    /// along a coordinate that is not depth.
    pub fn new(
        units: &[String; 3],
        length: Option<f64>,
        depth_axis: DepthAxis,
        velocity: Option<f64>,
    ) -> Result<Self> {
        let is_time = |unit: &String| seconds_per_unit(unit).is_some();
        if velocity.is_some() && !units.iter().any(is_time) {
            return Err(Error::Export(cause(
                "velocity",
                "converts two-way time to depth, but no coordinate of the mesh is time",
                "omit it",
            )));
        }
        let mut scale = [length.unwrap_or(1.0); 3];
        for k in 0..3 {
            let unit = units[k].trim();
            let place = || format!("coordinate {} in '{unit}'", ["x", "y", "z"][k]);
            let seconds = match (unit, seconds_per_unit(unit)) {
                ("", _) => continue,
                (_, Some(seconds)) => seconds,
                _ => match length.or(metres_per_unit(unit)) {
                    Some(metres) => {
                        scale[k] = metres;
                        continue;
                    }
                    None => {
                        let problem = "has a unit that is not a length";
                        let remedy = "give the unit of its coordinates";
                        return Err(Error::Export(
                            cause(place(), problem, remedy).with_parameter("length-unit"),
                        ));
                    }
                },
            };
            let refuse = |problem: &str, remedy: &str, parameter| {
                let cause = cause(place(), problem, remedy);
                Err(Error::Export(cause.with_parameter(parameter)))
            };
            if k != depth_axis.axis {
                return refuse(
                    "is two-way time, not depth",
                    "say which way is down: z or -z",
                    "down",
                );
            }
            match velocity {
                None => {
                    return refuse(
                        "is two-way time, not depth",
                        "give a velocity in m/s to turn it into metres",
                        "velocity",
                    );
                }
                Some(v) if !(v > 0.0 && v.is_finite()) => {
                    return Err(Error::Export(cause(
                        format!("velocity {v}"),
                        "is not a positive number",
                        "give m/s: rock has 1500 to 6000",
                    )));
                }
                // The two-way time covers the way down and up.
                Some(v) => scale[k] = 0.5 * v * seconds,
            }
        }
        Ok(Self {
            scale,
            depth_axis,
            z_shift: 0.0,
        })
    }

    /// Returns the frame shifted along z, so that the shallowest of `points` (in the mesh's
    /// coordinates) is at the depth `top` in metres.
    pub fn with_top(self, points: &[[f64; 3]], top: f64) -> Self {
        let z = points.iter().map(|&p| self.to_model(p)[2]);
        let max_z = z.fold(f64::NEG_INFINITY, f64::max);
        Self {
            z_shift: self.z_shift - max_z - top,
            ..self
        }
    }

    /// Returns the mesh coordinates that become x, y and z.
    fn axes(&self) -> [usize; 3] {
        [1, 2, 0].map(|k| (self.depth_axis.axis + k) % 3)
    }

    fn depth_sign(&self) -> f64 {
        if self.depth_axis.is_downward {
            -1.0
        } else {
            1.0
        }
    }

    /// Converts a point from the mesh's coordinates to metres.
    pub fn to_model(&self, point: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = self.axes().map(|k| point[k] * self.scale[k]);
        [x, y, self.depth_sign() * z + self.z_shift]
    }

    /// Converts a point from metres to the mesh's coordinates: the inverse of
    /// [`to_model`](Self::to_model).
    pub fn to_file(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let mut point = [0.0; 3];
        let shifted = [x, y, self.depth_sign() * (z - self.z_shift)];
        for (k, value) in self.axes().into_iter().zip(shifted) {
            point[k] = value / self.scale[k];
        }
        point
    }

    /// Returns the volume in m^3 of a unit of the mesh's volume.
    pub fn volume_of_unit(&self) -> f64 {
        self.scale.iter().product()
    }

    /// Returns the metres in one unit of the horizontal coordinates (of the first of them).
    pub fn horizontal_scale(&self) -> f64 {
        self.scale[self.axes()[0]]
    }

    /// Returns the metres in one unit of the coordinate that is depth.
    pub fn vertical_scale(&self) -> f64 {
        self.scale[self.depth_axis.axis]
    }

    /// Returns `true` if the map is a reflection.
    pub fn is_mirrored(&self) -> bool {
        self.depth_axis.is_downward
    }

    /// Transforms a tensor from the axes of the mesh to x, y and z of the model.
    pub fn transform_tensor(&self, tensor: Tensor) -> Tensor {
        let axes = self.axes();
        // Two sign changes cancel.
        let sign = |i: usize| if i == 2 { self.depth_sign() } else { 1.0 };
        let component = |i: usize, j: usize| {
            const COMPONENT_INDEX: [[usize; 3]; 3] = [[0, 3, 5], [3, 1, 4], [5, 4, 2]];
            sign(i) * sign(j) * tensor.0[COMPONENT_INDEX[axes[i]][axes[j]]]
        };
        Tensor([
            component(0, 0),
            component(1, 1),
            component(2, 2),
            component(0, 1),
            component(1, 2),
            component(0, 2),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn units(words: [&str; 3]) -> [String; 3] {
        words.map(str::to_string)
    }

    #[test]
    fn to_file_inverts_to_model_for_every_axis() {
        let point = [3.0, -5.0, 7.0];
        for axis in 0..3 {
            for is_downward in [false, true] {
                let depth_axis = DepthAxis { axis, is_downward };
                let frame = ModelFrame::new(&units([""; 3]), Some(0.5), depth_axis, None)
                    .unwrap()
                    .with_top(&[point, [0.0; 3]], 100.0);
                let model_point = frame.to_model(point);
                let file_point = frame.to_file(model_point);
                assert!((0..3).all(|k| (file_point[k] - point[k]).abs() < 1e-12));
                let depth = 0.5
                    * if is_downward {
                        point[axis]
                    } else {
                        -point[axis]
                    };
                assert!((-model_point[2] - 100.0 - (depth - depth.min(0.0))).abs() < 1e-12);
            }
        }
        assert_eq!(ModelFrame::default().to_model(point), point);
    }

    #[test]
    fn time_becomes_depth() {
        let depth_axis = DepthAxis::default();
        let frame =
            ModelFrame::new(&units(["ft", "m", "ms"]), None, depth_axis, Some(3000.0)).unwrap();
        assert_eq!(frame.to_model([10.0, 2.0, -1000.0]), [3.048, 2.0, -1500.0]);
        for (words, depth_axis, velocity, expected) in [
            (["m", "m", "ms"], depth_axis, None, "a velocity in m/s"),
            (["m", "m", "ms"], depth_axis, Some(0.0), "not a positive"),
            (["m", "ms", "m"], depth_axis, Some(2e3), "not depth"),
            (
                ["m", "furlong", "m"],
                depth_axis,
                None,
                "the unit of its coordinates",
            ),
        ] {
            let error = ModelFrame::new(&units(words), None, depth_axis, velocity).unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
        }
    }

    #[test]
    fn a_given_unit_overrides_a_stated_one() {
        let depth_axis = DepthAxis::default();
        for stated in ["mm", "ft", "furlong", ""] {
            let frame = ModelFrame::new(&units([stated; 3]), Some(1e-6), depth_axis, None).unwrap();
            assert_eq!(frame.to_model([2.0, 3.0, 4.0]), [2e-6, 3e-6, 4e-6]);
        }
        let frame = ModelFrame::new(&units(["mm"; 3]), None, depth_axis, None).unwrap();
        assert_eq!(frame.to_model([2.0, 3.0, 4.0]), [2e-3, 3e-3, 4e-3]);
        // A coordinate in time is not affected by the unit of length.
        let frame =
            ModelFrame::new(&units(["ft", "ft", "ms"]), Some(1.0), depth_axis, Some(2e3)).unwrap();
        assert_eq!(frame.to_model([2.0, 3.0, 4.0]), [2.0, 3.0, 4.0]);
    }

    #[test]
    fn tensors_rotate_with_the_axes() {
        let tensor = Tensor([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]);
        assert_eq!(ModelFrame::default().transform_tensor(tensor), tensor);
        let normal = [0.6, 0.0, 0.8];
        for axis in 0..3 {
            let depth_axis = DepthAxis {
                axis,
                is_downward: true,
            };
            let frame = ModelFrame::new(&units([""; 3]), None, depth_axis, None).unwrap();
            let transformed = frame
                .transform_tensor(tensor)
                .normal_component(frame.to_model(normal));
            assert!((transformed - tensor.normal_component(normal)).abs() < 1e-12);
        }
    }
}
