//! Averages of an image over the cells of a mesh.
//!
//! Each cell is cut into tetrahedra from its site. These are halved until no edge is longer than
//! three samples, and the image is interpolated linearly at the centre of each piece. So volumes
//! are exact, and so are means of linear functions. Samples without data have no weight.

use crate::geometry::grid_index::{for_each_corner, index_at, offset_of};
use crate::parallel::prelude::*;

use crate::error::cause;
use crate::geometry::{add_scaled, distance2, norm, sub, volume6};
use crate::image::Image;
use crate::mesh::poly::{Lists, PolyMesh};
use crate::{Error, Result};

/// Largest edge, in samples, of a piece at whose centre the image is interpolated.
const MAX_PIECE_EDGE_SAMPLES: f64 = 3.0;

/// The kind of mean that gives a cell's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeanKind {
    /// The mean, weighted by volume.
    Arithmetic,
    /// The inverse of the mean inverse: for permeability across layers.
    Harmonic,
    /// The exponential of the mean logarithm: for disordered permeability.
    Geometric,
    /// The sample nearest to the cell's site: for labels.
    Nearest,
}

impl MeanKind {
    /// Returns the mean with this name, or `None` if there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "arithmetic" => Some(Self::Arithmetic),
            "harmonic" => Some(Self::Harmonic),
            "geometric" => Some(Self::Geometric),
            "nearest" => Some(Self::Nearest),
            _ => None,
        }
    }

    #[inline]
    fn transform(self, value: f64) -> f64 {
        match self {
            Self::Arithmetic | Self::Nearest => value,
            Self::Harmonic => 1.0 / value,
            Self::Geometric => value.ln(),
        }
    }

    #[inline]
    fn inverse_transform(self, mean: f64) -> f64 {
        match self {
            Self::Arithmetic | Self::Nearest => mean,
            Self::Harmonic => 1.0 / mean,
            Self::Geometric => mean.exp(),
        }
    }
}

/// The positions of a mesh's nodes and sites in sample indices of an image, x first.
#[derive(Debug, Clone, PartialEq)]
pub struct SamplePositions {
    dims: [usize; 3],
    nodes: Vec<[f64; 3]>,
    sites: Vec<[f64; 3]>,
}

impl SamplePositions {
    /// Computes the positions from an affine map from mesh coordinates to sample indices. `dims`
    /// are the dimensions of the image. Along an axis with one sample, all positions are 0.
    pub fn new(
        mesh: &PolyMesh<3>,
        dims: [usize; 3],
        index_of: impl Fn([f64; 3]) -> [f64; 3] + Sync,
    ) -> Self {
        let position = |&p: &[f64; 3]| {
            let index = index_of(p);
            std::array::from_fn(|k| if dims[k] == 1 { 0.0 } else { index[k] })
        };
        let positions = |points: &[[f64; 3]]| points.par_iter().map(position).collect();
        Self {
            dims,
            nodes: positions(&mesh.nodes),
            sites: positions(&mesh.sites),
        }
    }

    /// Returns the largest distance, in samples, of a node outside the image.
    pub fn max_distance_outside(&self) -> f64 {
        let last = self.dims.map(|n| n as f64 - 1.0);
        let distance =
            |p: &[f64; 3]| (0..3).fold(0.0, |max: f64, k| max.max(-p[k]).max(p[k] - last[k]));
        self.nodes.par_iter().map(distance).reduce(|| 0.0, f64::max)
    }
}

/// The means of an image over the cells of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct CellMeans {
    /// The mean of each cell. A cell without data has the value of the nearest sample with data.
    pub values: Vec<f64>,
    /// `true` for each cell that no sample with data reaches; empty if there is no such cell.
    pub without_data: Vec<bool>,
}

/// Returns a value for every cell of `mesh`. `positions` are the positions of the mesh in the
/// image; `place` names the image in errors. Outside the image, the values at its sides apply.
///
/// Zeros have no harmonic or geometric mean. A cell in which zeros fill more volume than other
/// values has the mean 0; in other cells, zeros do not count.
///
/// # Errors
/// Returns [`Error::Export`] with the number of a cell whose mean is not finite: because of NaN, or
/// of a value that is not positive where it must be.
pub fn average_cells(
    mesh: &PolyMesh<3>,
    positions: &SamplePositions,
    image: &Image<3>,
    mean: MeanKind,
    place: &str,
) -> Result<CellMeans> {
    let averaging = CellAveraging {
        mesh,
        positions,
        samples: LiveSamples::new(image),
        mean,
        faces: mesh.faces_of_cells(),
    };
    let means: Vec<Option<f64>> = (0..mesh.sites.len())
        .into_par_iter()
        .map(|cell| averaging.cell_mean(cell))
        .collect();
    if let Some(cell) = means.iter().position(|v| v.is_some_and(|v| !v.is_finite())) {
        return Err(Error::Export(cause(
            place,
            format!("has no {mean:?} mean in cell {cell}").to_lowercase(),
            "give an image of finite values, positive ones for harmonic and geometric means",
        )));
    }
    let mut without_data: Vec<bool> = means.iter().map(Option::is_none).collect();
    let nearest = if without_data.contains(&true) {
        nearest_values(image)?
    } else {
        without_data = Vec::new();
        Vec::new()
    };
    let value = |(cell, mean): (usize, Option<f64>)| {
        mean.unwrap_or_else(|| f64::from(nearest[averaging.samples.nearest(positions.sites[cell])]))
    };
    Ok(CellMeans {
        values: means.into_iter().enumerate().map(value).collect(),
        without_data,
    })
}

/// Returns the samples of an image, those without data replaced by the nearest ones with data.
fn nearest_values(image: &Image<3>) -> Result<Vec<f32>> {
    let mut samples = image.as_slice().to_vec();
    if let Some(mask) = image.live_mask()? {
        mask.fill(image.dims(), &mut samples, false);
    }
    Ok(samples)
}

/// The samples of an image, and the flags of those that hold no data.
struct LiveSamples<'a> {
    samples: &'a [f32],
    dims: [usize; 3],
    /// As in [`Image`].
    dead: &'a [bool],
    missing: &'a [bool],
}

impl<'a> LiveSamples<'a> {
    fn new(image: &'a Image<3>) -> Self {
        Self {
            samples: image.as_slice(),
            dims: image.dims(),
            dead: &image.dead,
            missing: &image.missing,
        }
    }

    fn is_live(&self, offset: usize) -> bool {
        let is_set = |flags: &[bool], index: usize| flags.get(index).copied().unwrap_or(false);
        !is_set(self.dead, offset) && !is_set(self.missing, offset / self.dims[0])
    }

    /// Returns the offset of the sample nearest to a point.
    fn nearest(&self, point: [f64; 3]) -> usize {
        let last = self.dims.map(|n| (n - 1) as f64);
        let index = std::array::from_fn(|k| point[k].round().clamp(0.0, last[k]) as usize);
        offset_of(self.dims, index)
    }

    /// Returns the linear interpolation between the samples with data around a point, and their
    /// share of the weight.
    fn interpolate(&self, point: [f64; 3]) -> (f64, f64) {
        if self.dead.is_empty() && self.missing.is_empty() {
            return (interpolate(self.samples, self.dims, point), 1.0);
        }
        let (mut sum, mut share) = (0.0, 0.0);
        for_each_corner(
            self.dims,
            point,
            |t| t,
            |i, weight: f64| {
                if self.is_live(i) {
                    sum += weight * f64::from(self.samples[i]);
                    share += weight;
                }
            },
        );
        (sum / share, share)
    }
}

/// A map from the model's metres to sample indices of an image, x first.
pub type IndexMap = Box<dyn Fn([f64; 3]) -> [f64; 3] + Send + Sync>;

/// An image that is looked up at places in the model's metres.
pub struct ImageProbe {
    image: Image<3>,
    index_of: IndexMap,
}

impl ImageProbe {
    /// Creates a probe of an image.
    pub fn new(image: Image<3>, index_of: IndexMap) -> Self {
        Self { image, index_of }
    }

    /// Returns the sample nearest to a place; `None` if it holds no data. Outside the image, the samples at its
    /// sides apply.
    pub fn value(&self, x: [f64; 3]) -> Option<f64> {
        let samples = LiveSamples::new(&self.image);
        let index = (self.index_of)(x);
        let nearest = samples.nearest(index);
        let has_value = index.iter().all(|i| i.is_finite()) && samples.is_live(nearest);
        has_value.then(|| f64::from(samples.samples[nearest]))
    }

    /// Returns the distance between samples in metres at a place, along a direction.
    pub fn sample_length(&self, x: [f64; 3], direction: [f64; 3]) -> f64 {
        let [a, b] = [x, add_scaled(x, 1.0, direction)].map(|x| (self.index_of)(x));
        norm(direction) / norm(sub(b, a))
    }
}

/// The averaging of an image over the cells of a mesh.
struct CellAveraging<'a> {
    mesh: &'a PolyMesh<3>,
    positions: &'a SamplePositions,
    samples: LiveSamples<'a>,
    mean: MeanKind,
    faces: Lists,
}

impl CellAveraging<'_> {
    /// Returns the value of a cell; `None` if no sample with data reaches it.
    fn cell_mean(&self, cell: usize) -> Option<f64> {
        if self.mean == MeanKind::Nearest {
            return self.nearest_in_cell(cell);
        }
        let (mut sum, mut weight, mut zero_volume) = (0.0, 0.0, 0.0);
        self.for_each_piece_of_cell(cell, |volume, point| {
            let (value, share) = self.samples.interpolate(point);
            if share == 0.0 {
                return;
            }
            let volume = volume * share;
            if value == 0.0 && self.mean != MeanKind::Arithmetic {
                zero_volume += volume;
            } else {
                sum += volume * self.mean.transform(value);
                weight += volume;
            }
        });
        if weight + zero_volume == 0.0 {
            return None;
        }
        if zero_volume > weight {
            return Some(0.0);
        }
        Some(self.mean.inverse_transform(sum / weight))
    }

    /// Returns the value of the sample nearest to a cell's site. If it holds no data, returns that of
    /// the nearest sample with data among those that reach the cell.
    fn nearest_in_cell(&self, cell: usize) -> Option<f64> {
        let LiveSamples { samples, dims, .. } = self.samples;
        let site = self.positions.sites[cell];
        let nearest = self.samples.nearest(site);
        if self.samples.is_live(nearest) {
            return Some(f64::from(samples[nearest]));
        }
        let mut best: Option<(f64, usize)> = None;
        self.for_each_piece_of_cell(cell, |_, point| {
            for_each_corner(
                dims,
                point,
                |t| t,
                |i, _: f64| {
                    let distance = distance2(&index_at(dims, i).map(|x| x as f64), &site);
                    let is_nearer = best.is_none_or(|best| (distance, i) < best);
                    if is_nearer && self.samples.is_live(i) {
                        best = Some((distance, i));
                    }
                },
            );
        });
        best.map(|(_, i)| f64::from(samples[i]))
    }

    /// Calls `add` with the volume and the centre (a sample index) of each piece of a cell.
    fn for_each_piece_of_cell(&self, cell: usize, mut add: impl FnMut(f64, [f64; 3])) {
        for_each_piece_of_cell(
            self.mesh,
            self.positions,
            self.faces.get(cell),
            cell,
            MAX_PIECE_EDGE_SAMPLES,
            &mut add,
        );
    }
}

/// Calls `add` with six times the volume and the centre (a sample index) of each piece of a cell with
/// these faces. No edge of a piece is longer than `max_edge` samples.
pub(super) fn for_each_piece_of_cell(
    mesh: &PolyMesh<3>,
    positions: &SamplePositions,
    faces: &[u32],
    cell: usize,
    max_edge: f64,
    add: &mut impl FnMut(f64, [f64; 3]),
) {
    for &f in faces {
        let ring = mesh.faces.get(f as usize);
        let position_pair = |n: u32| [mesh.nodes[n as usize], positions.nodes[n as usize]];
        let middle = |index: usize| -> [f64; 3] {
            let sum = |k: usize| {
                ring.iter()
                    .map(|&n| position_pair(n)[index][k])
                    .sum::<f64>()
            };
            std::array::from_fn(|k| sum(k) / ring.len() as f64)
        };
        // The centre of a triangle is not needed.
        let (apex, edges) = match ring.len() {
            3 => (position_pair(ring[0]), 1..2),
            n => ([middle(0), middle(1)], 0..n),
        };
        for i in edges {
            let [p, q] = [ring[i], ring[(i + 1) % ring.len()]].map(position_pair);
            let volume = volume6(&[mesh.sites[cell], apex[0], p[0], q[0]]).abs();
            let piece = [positions.sites[cell], apex[1], p[1], q[1]];
            for_each_piece(piece, volume, max_edge, add);
        }
    }
}

/// Halves a tetrahedron until no edge is longer than `max_edge`, and calls `add` with the volume and the centre of each
/// piece.
fn for_each_piece(
    p: [[f64; 3]; 4],
    volume: f64,
    max_edge: f64,
    add: &mut impl FnMut(f64, [f64; 3]),
) {
    let mut longest = (max_edge * max_edge, 0, 0);
    for i in 0..4 {
        for j in 0..i {
            let length = distance2(&p[i], &p[j]);
            if length > longest.0 {
                longest = (length, i, j);
            }
        }
    }
    let (_, i, j) = longest;
    if i == j {
        let middle = |k: usize| 0.25 * (p[0][k] + p[1][k] + p[2][k] + p[3][k]);
        return add(volume, std::array::from_fn(middle));
    }
    let midpoint = std::array::from_fn(|k| 0.5 * (p[i][k] + p[j][k]));
    for end in [i, j] {
        let mut half = p;
        half[end] = midpoint;
        for_each_piece(half, 0.5 * volume, max_edge, add);
    }
}

/// Returns the linear interpolation between the eight samples around a point.
fn interpolate(samples: &[f32], dims: [usize; 3], point: [f64; 3]) -> f64 {
    let mut value = 0.0;
    for_each_corner(
        dims,
        point,
        |t| t,
        |i, weight: f64| {
            value += weight * f64::from(samples[i]);
        },
    );
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;
    use crate::mesh::poly::samples::two_cells;

    /// Returns the means of the cells of the box [0, 2] x [0, 1]^2, which is cut at x = 0.75. The
    /// image has 41 x 21 x 21 samples, so that the cut is at sample 15.
    fn means(mean: MeanKind, f: impl Fn([f64; 3]) -> f64) -> Vec<f64> {
        let mesh = two_cells::<3>(0.75);
        let image = Image::from_fn([41, 21, 21], Geometry::default(), f);
        let positions = SamplePositions::new(&mesh, image.dims(), |p| p.map(|c| 20.0 * c));
        assert!(positions.max_distance_outside() < 1e-12);
        average_cells(&mesh, &positions, &image, mean, "image")
            .unwrap()
            .values
    }

    #[test]
    fn means_of_linear_functions_are_exact() {
        let values = means(MeanKind::Arithmetic, |[x, y, z]| x + 2.0 * y - 0.5 * z);
        for (value, x) in values.iter().zip([7.5, 27.5]) {
            assert!((value - (x + 20.0 - 5.0)).abs() < 1e-9, "{value}");
        }
    }

    #[test]
    fn layers_have_their_harmonic_and_geometric_means() {
        // 1 for x < 8, 100 above; in between the image is interpolated.
        let layers = |[x, _, _]: [f64; 3]| if x < 8.0 { 1.0 } else { 100.0 };
        let ramp = |f: &dyn Fn(f64) -> f64| {
            let steps = 10_000;
            let value = |i: usize| f(1.0 + 99.0 * (i as f64 + 0.5) / steps as f64);
            (0..steps).map(value).sum::<f64>() / steps as f64
        };
        let mean = |f: &dyn Fn(f64) -> f64| (7.0 * f(1.0) + ramp(f) + 7.0 * f(100.0)) / 15.0;
        let harmonic = means(MeanKind::Harmonic, layers)[0];
        let expected = 1.0 / mean(&|k| 1.0 / k);
        assert!(
            (harmonic / expected - 1.0).abs() < 0.02,
            "{harmonic} {expected}"
        );
        let geometric = means(MeanKind::Geometric, layers)[0];
        let expected = mean(&f64::ln).exp();
        assert!(
            (geometric / expected - 1.0).abs() < 0.02,
            "{geometric} {expected}"
        );
        assert_eq!(means(MeanKind::Nearest, layers), [1.0, 100.0]);
    }

    #[test]
    fn samples_without_data_have_no_weight() {
        let mesh = two_cells::<3>(0.75);
        let f = |[x, y, z]: [f64; 3]| x + 2.0 * y - 0.5 * z;
        let image = Image::from_fn([41, 21, 21], Geometry::default(), f);
        let positions = SamplePositions::new(&mesh, image.dims(), |p| p.map(|c| 20.0 * c));
        let means = |is_dead: &dyn Fn([usize; 3]) -> bool, mean| {
            let flags = (0..image.as_slice().len()).map(|i| is_dead(index_at(image.dims(), i)));
            let flags: Vec<bool> = flags.collect();
            let mut gappy = image.clone();
            let samples = gappy.samples.iter_mut().zip(&flags);
            samples.for_each(|(s, dead)| *s = if *dead { -999.25 } else { *s });
            average_cells(&mesh, &positions, &gappy.with_dead(flags), mean, "image").unwrap()
        };
        // The samples that exist lie evenly around the centre of the second cell.
        let scattered =
            |[x, y, z]: [usize; 3]| (x, y, z) == (28, 10, 10) || (x, y, z) == (27, 10, 10);
        let found = means(&scattered, MeanKind::Arithmetic);
        assert!(
            (found.values[1] - 42.5).abs() < 1e-3 && found.without_data.is_empty(),
            "{found:?}"
        );
        // Nothing of the first cell exists: it has the values of the nearest samples.
        let edge = means(&|[x, ..]| x <= 15, MeanKind::Arithmetic);
        assert_eq!(edge.without_data, [true, false]);
        assert!((edge.values[1] - 42.75).abs() < 0.3, "{edge:?}");
        let label = means(
            &|[x, y, z]| (x, y, z) == (7, 10, 10) || (x, y, z) == (8, 10, 10),
            MeanKind::Nearest,
        );
        assert!(
            label.without_data.is_empty() && label.values[0] > 0.0,
            "{label:?}"
        );
    }

    #[test]
    fn values_without_a_mean_are_refused() {
        let mesh = two_cells::<3>(0.75);
        let image = Image::from_fn([41, 21, 21], Geometry::default(), |[x, ..]| x - 20.0);
        let positions = SamplePositions::new(&mesh, image.dims(), |p| p.map(|c| 20.0 * c));
        let error =
            average_cells(&mesh, &positions, &image, MeanKind::Geometric, "k.npy").unwrap_err();
        assert!(error.to_string().contains("cell 0"), "{error}");
    }
}
