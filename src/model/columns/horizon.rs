//! Horizons as functions of x and y, and their values at the nodes of a map.

use crate::error::cause;
use crate::image::{Geometry, Image};
use crate::mesh::poly::PolyMesh;
use crate::{Error, Result};

/// How far, in samples, a grid goes on beyond its outermost samples: coordinates are rounded.
const GRID_MARGIN: f64 = 0.5;
/// Sweeps that smooth what was filled in.
const SMOOTHING_SWEEPS: usize = 300;

/// A horizon: z over the plane, in the map's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub enum Horizon {
    /// z is the same everywhere.
    Flat(f64),
    /// Samples of z, between which it is bilinear; not finite where it is not known.
    Grid(Image<2>),
    /// Triangles.
    Surface(TriangleIndex),
}

/// Triangles in boxes, so that those at a point are found fast.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangleIndex {
    corners: Vec<[[f64; 3]; 3]>,
    low: [f64; 2],
    bin_width: f64,
    dims: [usize; 2],
    /// The triangles of each box begin here, and the end.
    bin_start: Vec<u32>,
    bin_triangles: Vec<u32>,
}

impl TriangleIndex {
    /// Those of a surface.
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
        let mut found = Self {
            corners,
            low,
            bin_width: width,
            dims,
            bin_start: Vec::new(),
            bin_triangles: Vec::new(),
        };
        let boxes = |t: &[[f64; 3]; 3]| {
            let range = |k: usize| {
                let low = t.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
                let high = t.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max);
                found.bin_index(low, k)..=found.bin_index(high, k)
            };
            let (x, nx) = (range(0), found.dims[0]);
            range(1).flat_map(move |j| x.clone().map(move |i| j * nx + i))
        };
        let mut pairs: Vec<(usize, u32)> = Vec::new();
        for (t, triangle) in (0..).zip(&found.corners) {
            pairs.extend(boxes(triangle).map(|b| (b, t)));
        }
        pairs.sort_unstable();
        let start = |b: usize| pairs.partition_point(|p| p.0 < b) as u32;
        let start = (0..=found.dims[0] * found.dims[1]).map(start).collect();
        found.bin_triangles = pairs.iter().map(|p| p.1).collect();
        found.bin_start = start;
        found
    }

    fn bin_index(&self, x: f64, k: usize) -> usize {
        (((x - self.low[k]) / self.bin_width).max(0.0) as usize).min(self.dims[k] - 1)
    }

    fn z_at(&self, x: [f64; 2]) -> Option<f64> {
        let b = self.bin_index(x[1], 1) * self.dims[0] + self.bin_index(x[0], 0);
        let own = &self.bin_triangles[self.bin_start[b] as usize..self.bin_start[b + 1] as usize];
        own.iter()
            .find_map(|&t| triangle_z(&self.corners[t as usize], x))
    }
}

/// z of a triangle at x, if it is there.
fn triangle_z(t: &[[f64; 3]; 3], x: [f64; 2]) -> Option<f64> {
    let area = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let [a, b, c] = t.map(|p| [p[0], p[1]]);
    let all = area(a, b, c);
    let shares = [area(x, b, c), area(a, x, c), area(a, b, x)].map(|s| s / all);
    let inside = shares.iter().all(|s| *s >= -1e-9);
    inside.then(|| (0..3).map(|k| shares[k] * t[k][2]).sum())
}

impl Horizon {
    /// z at x; `None` where it is not known.
    pub fn z_at(&self, x: [f64; 2]) -> Option<f64> {
        match self {
            Self::Flat(z) => Some(*z),
            Self::Grid(image) => bilinear_value(image, &image.geometry, x),
            Self::Surface(triangles) => triangles.z_at(x),
        }
    }

    /// z at every node of a map, and at how many of them it was not known: there it is continued
    /// smoothly from where it is. `place` names the horizon in errors.
    ///
    /// # Errors
    /// [`Error::Image`] if it is known at none.
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

/// Samples of an image, between which it is bilinear.
fn bilinear_value(image: &Image<2>, geometry: &Geometry<2>, x: [f64; 2]) -> Option<f64> {
    let dims = image.dims();
    let index = geometry.to_index(x)?;
    let (mut cell, mut share) = ([0; 2], [0.0; 2]);
    for k in 0..2 {
        let last = (dims[k] - 1) as f64;
        if !(index[k] >= -GRID_MARGIN && index[k] <= last + GRID_MARGIN) {
            return None;
        }
        let at = index[k].clamp(0.0, last);
        cell[k] = (at as usize).min(dims[k].saturating_sub(2));
        share[k] = at - cell[k] as f64;
    }
    let mut sum = 0.0;
    for corner in 0..4 {
        let off = [corner & 1, corner >> 1];
        let weight = |k: usize| {
            if off[k] == 1 {
                share[k]
            } else {
                1.0 - share[k]
            }
        };
        let weight = weight(0) * weight(1);
        if weight > 0.0 {
            let [i, j] = [0, 1].map(|k| (cell[k] + off[k]).min(dims[k] - 1));
            sum += weight * f64::from(image.as_slice()[j * dims[0] + i]);
        }
    }
    sum.is_finite().then_some(sum)
}

/// Known values, and between and beyond them smooth ones: each the mean of its neighbours' along the
/// edges of the map.
fn fill_missing(map: &PolyMesh<2>, known: &[Option<f64>]) -> Vec<f64> {
    let mut value = known.to_vec();
    let mut around: Vec<Vec<u32>> = vec![Vec::new(); known.len()];
    for f in 0..map.face_cells.len() {
        if let [p, q] = *map.faces.get(f) {
            around[p as usize].push(q);
            around[q as usize].push(p);
        }
    }
    let unknown: Vec<usize> = (0..known.len()).filter(|&n| known[n].is_none()).collect();
    // From front to front until all have a value.
    while value.iter().any(Option::is_none) {
        let before = value.clone();
        let mut settled = true;
        for &n in unknown.iter().filter(|&&n| before[n].is_none()) {
            let near = around[n].iter().filter_map(|&m| before[m as usize]);
            let count = near.clone().count();
            if count > 0 {
                value[n] = Some(near.sum::<f64>() / count as f64);
                settled = false;
            }
        }
        if settled {
            break;
        }
    }
    let mut value: Vec<f64> = value.into_iter().map(|z| z.unwrap_or(0.0)).collect();
    for _ in 0..SMOOTHING_SWEEPS {
        for &n in &unknown {
            let sum: f64 = around[n].iter().map(|&m| value[m as usize]).sum();
            value[n] = sum / around[n].len() as f64;
        }
    }
    value
}
