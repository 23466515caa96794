//! Horizons as functions z(x, y), and their values at the nodes of a map.

use crate::error::cause;
use crate::geometry::grid_index::for_each_corner;
use crate::image::{Geometry, Image};
use crate::mesh::poly::PolyMesh;
use crate::{Error, Result};

/// Distance, in samples, by which a grid extends beyond its outermost samples, because coordinates
/// are rounded.
const GRID_MARGIN: f64 = 0.5;
/// Number of sweeps that smooth the filled values.
const SMOOTHING_SWEEPS: usize = 300;

/// A horizon: z as a function of x and y, in the map's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub enum Horizon {
    /// A constant z.
    Flat(f64),
    /// Samples of z with bilinear interpolation. Samples that are not finite are unknown.
    Grid(Image<2>),
    /// A surface of triangles.
    Surface(TriangleIndex),
}

/// Triangles, sorted into bins of the x-y plane, so that those at a point are found fast.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangleIndex {
    corners: Vec<[[f64; 3]; 3]>,
    low: [f64; 2],
    bin_width: f64,
    dims: [usize; 2],
    /// For each bin, the index in `bin_triangles` at which its triangles begin; the last entry is
    /// the end.
    bin_start: Vec<u32>,
    bin_triangles: Vec<u32>,
}

impl TriangleIndex {
    /// Creates the index of the triangles with these corners.
    pub fn new(corners: Vec<[[f64; 3]; 3]>) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in corners.iter().flatten() {
            low = [0, 1].map(|k| low[k].min(p[k]));
            high = [0, 1].map(|k| high[k].max(p[k]));
        }
        let area = (high[0] - low[0]) * (high[1] - low[1]);
        let width = (area / corners.len().max(1) as f64)
            .sqrt()
            .max(f64::MIN_POSITIVE);
        let dims = [0, 1].map(|k| (((high[k] - low[k]) / width) as usize + 1).min(1 << 15));
        let mut index = Self {
            corners,
            low,
            bin_width: width,
            dims,
            bin_start: Vec::new(),
            bin_triangles: Vec::new(),
        };
        let bins_of = |t: &[[f64; 3]; 3]| {
            let range = |k: usize| {
                let low = t.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
                let high = t.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max);
                index.bin_index(low, k)..=index.bin_index(high, k)
            };
            let (x, nx) = (range(0), index.dims[0]);
            range(1).flat_map(move |j| x.clone().map(move |i| j * nx + i))
        };
        let mut pairs: Vec<(usize, u32)> = Vec::new();
        for (t, triangle) in (0..).zip(&index.corners) {
            pairs.extend(bins_of(triangle).map(|b| (b, t)));
        }
        pairs.sort_unstable();
        let start = |b: usize| pairs.partition_point(|p| p.0 < b) as u32;
        let start = (0..=index.dims[0] * index.dims[1]).map(start).collect();
        index.bin_triangles = pairs.iter().map(|p| p.1).collect();
        index.bin_start = start;
        index
    }

    fn bin_index(&self, x: f64, k: usize) -> usize {
        (((x - self.low[k]) / self.bin_width).max(0.0) as usize).min(self.dims[k] - 1)
    }

    fn z_at(&self, x: [f64; 2]) -> Option<f64> {
        let b = self.bin_index(x[1], 1) * self.dims[0] + self.bin_index(x[0], 0);
        let candidates =
            &self.bin_triangles[self.bin_start[b] as usize..self.bin_start[b + 1] as usize];
        candidates
            .iter()
            .find_map(|&t| triangle_z(&self.corners[t as usize], x))
    }
}

/// Returns z of a triangle at `x`, or `None` if `x` is outside the triangle.
fn triangle_z(t: &[[f64; 3]; 3], x: [f64; 2]) -> Option<f64> {
    let area = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let [a, b, c] = t.map(|p| [p[0], p[1]]);
    let total = area(a, b, c);
    let weights = [area(x, b, c), area(a, x, c), area(a, b, x)].map(|s| s / total);
    let is_inside = weights.iter().all(|s| *s >= -1e-9);
    is_inside.then(|| (0..3).map(|k| weights[k] * t[k][2]).sum())
}

impl Horizon {
    /// Returns z at `x`, or `None` where it is not known.
    pub fn z_at(&self, x: [f64; 2]) -> Option<f64> {
        match self {
            Self::Flat(z) => Some(*z),
            Self::Grid(image) => bilinear_value(image, &image.geometry, x),
            Self::Surface(triangles) => triangles.z_at(x),
        }
    }

    /// Returns z at every node of a map, and the number of nodes at which it is not known; there z
    /// is extrapolated smoothly. `place` names the horizon in errors.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if z is known at no node.
    pub fn z_at_nodes(&self, map: &PolyMesh<2>, place: &str) -> Result<(Vec<f64>, usize)> {
        let known: Vec<Option<f64>> = map.nodes.iter().map(|&x| self.z_at(x)).collect();
        let missing = known.iter().filter(|z| z.is_none()).count();
        if missing == known.len() {
            return Err(Error::Image(cause(
                place,
                "covers no node of the map",
                "give a horizon in the map's coordinates (`atomesh info` shows the map's extent)",
            )));
        }
        Ok((fill_missing(map, &known), missing))
    }
}

/// Interpolates the samples of an image bilinearly at `x`. Returns `None` outside the image or next
/// to a sample that is not finite.
fn bilinear_value(image: &Image<2>, geometry: &Geometry<2>, x: [f64; 2]) -> Option<f64> {
    let dims = image.dims();
    let index = geometry.to_index(x)?;
    let is_on_grid = |k: usize| {
        let last = (dims[k] - 1) as f64;
        index[k] >= -GRID_MARGIN && index[k] <= last + GRID_MARGIN
    };
    if !(0..2).all(is_on_grid) {
        return None;
    }
    let mut sum = 0.0;
    for_each_corner(
        dims,
        index,
        |t| t,
        |i, weight: f64| {
            sum += weight * f64::from(image.as_slice()[i]);
        },
    );
    sum.is_finite().then_some(sum)
}

/// Returns the known values, and smooth ones in between and beyond: each is the mean of its
/// neighbours' values along the edges of the map.
fn fill_missing(map: &PolyMesh<2>, known: &[Option<f64>]) -> Vec<f64> {
    let mut value = known.to_vec();
    let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); known.len()];
    for f in 0..map.face_cells.len() {
        if let [p, q] = *map.faces.get(f) {
            neighbours[p as usize].push(q);
            neighbours[q as usize].push(p);
        }
    }
    let unknown: Vec<usize> = (0..known.len()).filter(|&n| known[n].is_none()).collect();
    // The front of known values advances by one edge at a time.
    while value.iter().any(Option::is_none) {
        let previous = value.clone();
        let mut is_unchanged = true;
        for &n in unknown.iter().filter(|&&n| previous[n].is_none()) {
            let known_neighbours = neighbours[n].iter().filter_map(|&m| previous[m as usize]);
            let count = known_neighbours.clone().count();
            if count > 0 {
                value[n] = Some(known_neighbours.sum::<f64>() / count as f64);
                is_unchanged = false;
            }
        }
        if is_unchanged {
            break;
        }
    }
    let mut value: Vec<f64> = value.into_iter().map(|z| z.unwrap_or(0.0)).collect();
    for _ in 0..SMOOTHING_SWEEPS {
        for &n in &unknown {
            let sum: f64 = neighbours[n].iter().map(|&m| value[m as usize]).sum();
            value[n] = sum / neighbours[n].len() as f64;
        }
    }
    value
}
