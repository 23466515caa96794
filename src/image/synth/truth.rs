//! The exact distance to the features of an image, and its file format.

use crate::error::cause;
use crate::geometry::grid_index::{index_at, offset_of, strides};
use crate::geometry::norm;
use crate::image::formats::npy;
use crate::parallel::prelude::*;
use crate::{Error, Result};
use ndarray::{ArrayD, Axis};
use std::path::Path;

/// Largest exact distance, in samples. A sample farther away has this distance and the direction
/// zero.
pub const MAX_DISTANCE: f32 = 10.0;

/// Distance and direction from every sample to the nearest feature, in samples.
///
/// As an array, and so in a `.npy` file, it is `f32` of shape `(4, nz, ny, nx)`. `[0]` is the
/// unsigned distance; `[1], [2], [3]` are the x, y, z components of the unit vector from the sample
/// to its closest feature point, which is normal to the feature (on the feature itself: either of
/// its normals). In 2-D the shape is `(3, ny, nx)`, with one component less. See [`MAX_DISTANCE`].
///
/// Truth of networks and of layers has two more components: the distance from the closest point to
/// the next feature, and the angle between the two features ([`Truth::next_feature`]).
#[derive(Debug, Clone, PartialEq)]
pub struct Truth<const D: usize = 3> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// Distance to the closest feature point, x fastest.
    pub distance: Vec<f32>,
    /// Unit vector towards the closest feature point; zero where it is out of reach or unknown.
    pub direction: Vec<[f32; D]>,
    /// `true` if the directions are normals of a surface, so that a feature may be approximated by
    /// a plane about each closest point. It is `false` for voxels.
    pub is_smooth: bool,
    /// Next feature, known for networks and layers. For samples within half a sample of a feature
    /// it is the distance from the closest point to the next feature (at most [`MAX_DISTANCE`]),
    /// and the angle between the two there, in degrees. The distance is -1 where the feature tapers
    /// out to less than half its strength, or displaces layers by less than two samples: a mesh may
    /// follow the feature there, but need not.
    pub next_feature: Option<Vec<[f32; 2]>>,
}

impl<const D: usize> Truth<D> {
    /// Reads truth from a `.npy` file in any form that [`Truth::from_array`] accepts. Also returns
    /// a line that names the form.
    ///
    /// # Errors
    /// Returns an [`Error::Io`] if the file cannot be read, and the errors of
    /// [`Truth::from_array`].
    pub fn read(path: &Path) -> Result<(Self, String)> {
        Self::from_array(&npy::read_array(path)?, &path.display().to_string())
    }

    /// Writes [`Truth::to_array`] as a `.npy` file.
    ///
    /// # Errors
    /// Returns an [`Error::Io`] if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        npy::write_array(path, &self.to_array())
    }

    /// Returns the index of sample `i`, x first.
    pub(crate) fn index_of(&self, i: usize) -> [usize; D] {
        index_at(self.dims, i)
    }

    /// Returns the number of the sample at an index.
    pub(crate) fn sample_index(&self, index: [usize; D]) -> usize {
        offset_of(self.dims, index)
    }

    /// Returns the array of shape `(4, nz, ny, nx)`, or `(6, nz, ny, nx)` if the next feature is
    /// known.
    pub fn to_array(&self) -> ArrayD<f32> {
        let mut data = self.distance.clone();
        for k in 0..D {
            data.extend(self.direction.iter().map(|d| d[k]));
        }
        if let Some(next) = &self.next_feature {
            for k in 0..2 {
                data.extend(next.iter().map(|n| n[k]));
            }
        }
        let shape: Vec<usize> = [data.len() / self.distance.len().max(1)]
            .into_iter()
            .chain(self.dims.into_iter().rev())
            .collect();
        #[allow(clippy::expect_used)]
        ArrayD::from_shape_vec(shape, data).expect("a distance and a direction for each sample")
    }

    /// Reads truth in any of three forms, in C order; `place` names it in errors. Also returns a
    /// line that names the form.
    ///
    /// - shape `(4, nz, ny, nx)` or `(6, nz, ny, nx)`: as [`Truth::to_array`] writes it;
    /// - shape `(nz, ny, nx)` of zeros and ones: a mask. Distances are to the centres of its
    ///   voxels, exact as such, but up to 0.87 samples off the feature that the mask represents;
    /// - shape `(nz, ny, nx)` of other values: the (absolute) distance. Its gradient is taken by
    ///   one-sided differences that lead away from the kink at the feature.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] for other shapes, values that are not finite, and a mask without
    /// a voxel.
    pub fn from_array(array: &ArrayD<f32>, place: &str) -> Result<(Self, String)> {
        let refuse =
            |problem: String, remedy: &str| Err(Error::Image(cause(place, problem, remedy)));
        let shape = array.shape().to_vec();
        let has_directions = shape.len() == D + 1 && (shape[0] == D + 1 || shape[0] == D + 3);
        if !has_directions && shape.len() != D {
            return refuse(
                format!("truth has the shape {shape:?}"),
                match D {
                    2 => "give (3, ny, nx) or (ny, nx)",
                    _ => "give (4, nz, ny, nx) or (nz, ny, nx)",
                },
            );
        }
        let dims: [usize; D] = std::array::from_fn(|k| shape[shape.len() - 1 - k]);
        if dims.iter().any(|&n| n < 2) {
            return refuse(
                format!("truth has the shape {shape:?}"),
                "each axis needs two samples",
            );
        }
        if let Some(value) = array.iter().find(|v| !v.is_finite()) {
            return refuse(format!("truth holds {value}"), "give finite distances");
        }
        if has_directions {
            let component = |k: usize| {
                array
                    .index_axis(Axis(0), k)
                    .iter()
                    .copied()
                    .collect::<Vec<_>>()
            };
            let distance = component(0);
            let components: [Vec<f32>; D] = std::array::from_fn(|k| component(k + 1));
            let mut direction = Vec::with_capacity(distance.len());
            for i in 0..distance.len() {
                let unit: [f32; D] = std::array::from_fn(|k| components[k][i]);
                let length = unit.iter().fold(0f32, |sum, c| sum.hypot(*c));
                if length != 0.0 && (length - 1.0).abs() > 1e-3 {
                    return refuse(
                        format!("a direction of length {length} at sample {i}"),
                        "directions must be unit vectors, or zero where unknown",
                    );
                }
                direction.push(unit);
            }
            let next_feature = (shape[0] == D + 3).then(|| {
                let [gap, angle] = [D + 1, D + 2].map(component);
                gap.into_iter().zip(angle).map(|(g, a)| [g, a]).collect()
            });
            let truth = Self {
                dims,
                distance,
                direction,
                is_smooth: true,
                next_feature,
            };
            return Ok((truth, "exact distances and directions".to_string()));
        }
        let values: Vec<f32> = array.iter().map(|v| v.abs()).collect();
        if values.iter().all(|&v| v == 0.0 || v == 1.0) {
            if values.iter().all(|&v| v == 0.0) {
                return refuse("the mask has no voxel".into(), "mark the features by 1");
            }
            let note = "a mask: distances to voxel centres, up to 0.87 sample off the feature";
            return Ok((Self::from_mask(dims, &values), note.to_string()));
        }
        let note = "distances, with directions from their differences";
        Ok((Self::from_distance(dims, values), note.to_string()))
    }

    /// Returns truth with directions from an unsigned distance: down the gradient. Each component
    /// is differenced towards the larger neighbour, which lies on the same side of the feature as
    /// the sample.
    fn from_distance(dims: [usize; D], distance: Vec<f32>) -> Self {
        let mut truth = Self {
            dims,
            distance,
            direction: Vec::new(),
            is_smooth: true,
            next_feature: None,
        };
        let distance = &truth.distance;
        let strides = strides(dims);
        truth.direction = (0..distance.len())
            .into_par_iter()
            .map(|i| {
                let index = truth.index_of(i);
                let value = distance[i];
                let gradient: [f32; D] = std::array::from_fn(|k| {
                    let before = (index[k] > 0).then(|| distance[i - strides[k]]);
                    let after = (index[k] + 1 < dims[k]).then(|| distance[i + strides[k]]);
                    match (before, after) {
                        (Some(b), Some(a)) if b > a => value - b,
                        (_, Some(a)) => a - value,
                        (Some(b), None) => value - b,
                        (None, None) => 0.0,
                    }
                });
                let length = norm(gradient);
                if length < 0.1 {
                    [0.0; D]
                } else {
                    gradient.map(|g| -g / length)
                }
            })
            .collect();
        truth
    }

    /// Returns truth with exact Euclidean distances to the centres of voxels, by three passes of
    /// lower envelopes of parabolas (Felzenszwalb and Huttenlocher 2012) that also keep the closest
    /// voxel.
    fn from_mask(dims: [usize; D], mask: &[f32]) -> Self {
        const UNREACHED: f64 = 1e20;
        let count = mask.len();
        let mut square: Vec<f64> = mask
            .iter()
            .map(|&m| if m == 1.0 { 0.0 } else { UNREACHED })
            .collect();
        let mut closest: Vec<u32> = (0..count as u32).collect();
        let strides = strides(dims);
        for axis in 0..D {
            let (n, stride) = (dims[axis], strides[axis]);
            let mut line = vec![(0f64, 0u32); n];
            let mut hull: Vec<(usize, f64)> = Vec::with_capacity(n);
            for start in (0..count).filter(|i| i / stride % n == 0) {
                for (q, item) in line.iter_mut().enumerate() {
                    *item = (square[start + q * stride], closest[start + q * stride]);
                }
                hull.clear();
                for q in (0..n).filter(|&q| line[q].0 < UNREACHED) {
                    let mut boundary = f64::NEG_INFINITY;
                    while let Some(&(p, start)) = hull.last() {
                        let (fp, fq) = (p as f64, q as f64);
                        boundary =
                            ((line[q].0 + fq * fq) - (line[p].0 + fp * fp)) / (2.0 * (fq - fp));
                        if boundary > start {
                            break;
                        }
                        hull.pop();
                        boundary = f64::NEG_INFINITY;
                    }
                    hull.push((q, boundary));
                }
                let mut k = 0;
                for q in 0..n {
                    while k + 1 < hull.len() && hull[k + 1].1 <= q as f64 {
                        k += 1;
                    }
                    if let Some(&(p, _)) = hull.get(k) {
                        let gap = q as f64 - p as f64;
                        square[start + q * stride] = line[p].0 + gap * gap;
                        closest[start + q * stride] = line[p].1;
                    }
                }
            }
        }
        let mut truth = Self {
            dims,
            distance: square.iter().map(|s| s.sqrt() as f32).collect(),
            direction: Vec::new(),
            is_smooth: false,
            next_feature: None,
        };
        truth.direction = (0..count)
            .into_par_iter()
            .map(|i| {
                let (index, target) = (truth.index_of(i), truth.index_of(closest[i] as usize));
                let d = (square[i].sqrt() as f32).max(f32::MIN_POSITIVE);
                std::array::from_fn(|k| (target[k] as f32 - index[k] as f32) / d)
            })
            .collect();
        truth
    }
}
