//! The exact distance to an image's features, as kept in a file.

use crate::error::cause;
use crate::image::formats::npy;
use crate::parallel::prelude::*;
use crate::{Error, Result};
use ndarray::{ArrayD, Axis};
use std::path::Path;

/// Distances are exact below this many samples; a sample farther away holds this value and the
/// direction zero.
pub const MAX_DISTANCE: f32 = 10.0;

/// For every sample: how far the nearest feature is and in which direction, in samples.
///
/// As an array, and so in a `.npy` file: `f32` of shape `(4, nz, ny, nx)`. `[0]` is the unsigned
/// distance; `[1], [2], [3]` are the x, y, z components of the unit vector from the sample to its
/// closest feature point, which is normal to the feature (on the feature itself: either of its
/// normals). In the plane the shape is `(3, ny, nx)`, with one component less. See [`MAX_DISTANCE`].
///
/// Truth of networks and of layers has two more: how far the closest point is from the next feature, and the angle
/// between the two ([`Truth::next_feature`]).
#[derive(Debug, Clone, PartialEq)]
pub struct Truth<const D: usize = 3> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// Distance to the closest feature point, x fastest.
    pub distance: Vec<f32>,
    /// Unit vector towards it; zero where the distance is out of reach or nothing is known.
    pub direction: Vec<[f32; D]>,
    /// Whether the directions are normals of a surface, so that a feature may be taken as flat
    /// about each closest point. Not so for voxels.
    pub is_smooth: bool,
    /// Of networks and layers: for samples within half a sample of a feature, how far the closest point of it is
    /// from the next feature (at most [`MAX_DISTANCE`]), and the angle between the two there, in degrees. The
    /// distance is -1 where the feature tapers out to less than half its strength, or throws layers by less
    /// than two samples: what lies on it there is right, but nobody asks for it.
    pub next_feature: Option<Vec<[f32; 2]>>,
}

impl<const D: usize> Truth<D> {
    /// Reads truth from a `.npy` file in any of the forms that [`Truth::from_array`] takes, with a
    /// line that says what was taken.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read, else as [`Truth::from_array`].
    pub fn read(path: &Path) -> Result<(Self, String)> {
        Self::from_array(&npy::read_array(path)?, &path.display().to_string())
    }

    /// Writes [`Truth::to_array`] as a `.npy` file.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        npy::write_array(path, &self.to_array())
    }

    /// The index of sample `i`, x first.
    pub(crate) fn index_of(&self, mut i: usize) -> [usize; D] {
        self.dims.map(|n| {
            let index = i % n;
            i /= n;
            index
        })
    }

    /// Where the sample of an index is.
    pub(crate) fn sample_index(&self, index: [usize; D]) -> usize {
        (0..D).rev().fold(0, |at, k| at * self.dims[k] + index[k])
    }

    /// The array of shape `(4, nz, ny, nx)`; with what is known of the next feature `(6, nz, ny, nx)`.
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

    /// Reads any of the three forms in which truth is given, in C order; `place` names it in
    /// errors. Also returns a line that says what was taken.
    ///
    /// - shape `(4, nz, ny, nx)` or `(6, nz, ny, nx)`: as [`Truth::to_array`] writes it;
    /// - shape `(nz, ny, nx)` of zeros and ones: a mask. Distances are to the centres of its
    ///   voxels, exact as such, but up to 0.87 sample off the feature that the mask stands for;
    /// - shape `(nz, ny, nx)` of other values: the (absolute) distance. Its gradient is taken by
    ///   one-sided differences that lead away from the kink at the feature.
    ///
    /// # Errors
    /// [`Error::Image`] for other shapes, values that are not finite, and a mask without a voxel.
    pub fn from_array(array: &ArrayD<f32>, place: &str) -> Result<(Self, String)> {
        let bad = |problem: String, remedy: &str| Err(Error::Image(cause(place, problem, remedy)));
        let shape = array.shape().to_vec();
        let full = shape.len() == D + 1 && (shape[0] == D + 1 || shape[0] == D + 3);
        if !full && shape.len() != D {
            return bad(
                format!("truth has the shape {shape:?}"),
                match D {
                    2 => "give (3, ny, nx) or (ny, nx)",
                    _ => "give (4, nz, ny, nx) or (nz, ny, nx)",
                },
            );
        }
        let dims: [usize; D] = std::array::from_fn(|k| shape[shape.len() - 1 - k]);
        if dims.iter().any(|&n| n < 2) {
            return bad(
                format!("truth has the shape {shape:?}"),
                "each axis needs two samples",
            );
        }
        if let Some(value) = array.iter().find(|v| !v.is_finite()) {
            return bad(format!("truth holds {value}"), "give finite distances");
        }
        if full {
            let part = |k: usize| {
                array
                    .index_axis(Axis(0), k)
                    .iter()
                    .copied()
                    .collect::<Vec<_>>()
            };
            let distance = part(0);
            let along: [Vec<f32>; D] = std::array::from_fn(|k| part(k + 1));
            let mut direction = Vec::with_capacity(distance.len());
            for i in 0..distance.len() {
                let unit: [f32; D] = std::array::from_fn(|k| along[k][i]);
                let length = unit.iter().fold(0f32, |sum, c| sum.hypot(*c));
                if length != 0.0 && (length - 1.0).abs() > 1e-3 {
                    return bad(
                        format!("a direction of length {length} at sample {i}"),
                        "directions must be unit vectors, or zero where unknown",
                    );
                }
                direction.push(unit);
            }
            let next = (shape[0] == D + 3).then(|| {
                let [gap, angle] = [D + 1, D + 2].map(part);
                gap.into_iter().zip(angle).map(|(g, a)| [g, a]).collect()
            });
            let truth = Self {
                dims,
                distance,
                direction,
                is_smooth: true,
                next_feature: next,
            };
            return Ok((truth, "exact distances and directions".to_string()));
        }
        let values: Vec<f32> = array.iter().map(|v| v.abs()).collect();
        if values.iter().all(|&v| v == 0.0 || v == 1.0) {
            if values.iter().all(|&v| v == 0.0) {
                return bad("the mask has no voxel".into(), "mark the features by 1");
            }
            let note = "a mask: distances to voxel centres, up to 0.87 sample off the feature";
            return Ok((Self::from_mask(dims, &values), note.to_string()));
        }
        let note = "distances, with directions from their differences";
        Ok((Self::from_distance(dims, values), note.to_string()))
    }

    /// Directions from an unsigned distance: down the gradient, each component differenced towards
    /// the larger neighbour, which lies on the sample's own side of the feature.
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
                let here = distance[i];
                let gradient: [f32; D] = std::array::from_fn(|k| {
                    let before = (index[k] > 0).then(|| distance[i - strides[k]]);
                    let after = (index[k] + 1 < dims[k]).then(|| distance[i + strides[k]]);
                    match (before, after) {
                        (Some(b), Some(a)) if b > a => here - b,
                        (_, Some(a)) => a - here,
                        (Some(b), None) => here - b,
                        (None, None) => 0.0,
                    }
                });
                let length = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
                if length < 0.1 {
                    [0.0; D]
                } else {
                    gradient.map(|g| -g / length)
                }
            })
            .collect();
        truth
    }

    /// Exact Euclidean distances to the voxels' centres: three passes of lower envelopes of
    /// parabolas (Felzenszwalb and Huttenlocher 2012), keeping which voxel is closest.
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
                    let mut from = f64::NEG_INFINITY;
                    while let Some(&(p, since)) = hull.last() {
                        let (fp, fq) = (p as f64, q as f64);
                        from = ((line[q].0 + fq * fq) - (line[p].0 + fp * fp)) / (2.0 * (fq - fp));
                        if from > since {
                            break;
                        }
                        hull.pop();
                        from = f64::NEG_INFINITY;
                    }
                    hull.push((q, from));
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
                let (from, to) = (truth.index_of(i), truth.index_of(closest[i] as usize));
                let d = (square[i].sqrt() as f32).max(f32::MIN_POSITIVE);
                std::array::from_fn(|k| (to[k] as f32 - from[k] as f32) / d)
            })
            .collect();
        truth
    }
}

/// How far apart in memory neighbours along each axis are.
fn strides<const D: usize>(dims: [usize; D]) -> [usize; D] {
    std::array::from_fn(|k| dims[..k].iter().product())
}
