//! Horizons as functions z(x, y), and their values at the nodes of a map.

use crate::geometry::box_tree::BoxTree;
use crate::geometry::grid_index::for_each_corner;
use crate::geometry::{bounding_box, norm, sub};
use crate::image::{Geometry, Image};

/// Distance, in samples, by which a grid extends beyond its outermost samples, because coordinates
/// are rounded.
const GRID_MARGIN: f64 = 0.5;
/// Margin of the boxes of triangles, relative to their diagonals, because points on edges count as
/// inside.
const BOX_MARGIN: f64 = 1e-6;
/// Number of sweeps that smooth the filled values.
const SMOOTHING_SWEEPS: usize = 300;

/// A horizon: z as a function of x and y, in the map's coordinates.
// There are only as many values as horizons.
#[allow(clippy::large_enum_variant)]
#[derive(Debug, Clone, PartialEq)]
pub enum Horizon {
    /// A constant z.
    Flat(f64),
    /// Samples of z with bilinear interpolation. Samples that are not finite are unknown.
    Grid(Image<2>),
    /// A surface of triangles.
    Surface(TriangleIndex),
}

/// Triangles with a tree of their boxes in the x-y plane, so that those at a point are found fast.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangleIndex {
    corners: Vec<[[f64; 3]; 3]>,
    tree: BoxTree<'static, 2>,
}

impl TriangleIndex {
    /// Creates the index of the triangles with these corners.
    pub fn new(corners: Vec<[[f64; 3]; 3]>) -> Self {
        let bounds = |t: &[[f64; 3]; 3]| {
            let [low, high] = bounding_box(t.map(|[x, y, _]| [x, y]));
            let margin = BOX_MARGIN * norm(sub(high, low));
            [low.map(|c| c - margin), high.map(|c| c + margin)]
        };
        let boxes: Vec<_> = corners.iter().map(bounds).collect();
        Self {
            tree: BoxTree::new(boxes, vec![0; corners.len()]),
            corners,
        }
    }

    /// Returns the corners of all triangles.
    pub(super) fn corners(&self) -> impl Iterator<Item = [f64; 3]> {
        self.corners.as_flattened().iter().copied()
    }

    /// Turns the sign of z.
    pub(super) fn turn(&mut self) {
        for corner in self.corners.as_flattened_mut() {
            corner[2] = -corner[2];
        }
    }

    /// Returns z of the first triangle at a point.
    fn z_at(&self, x: [f64; 2]) -> Option<f64> {
        let mut first: Option<(usize, f64)> = None;
        self.tree.visit_at(x, |t| {
            if first.is_none_or(|(other, _)| t < other) {
                first = triangle_z(&self.corners[t], x).map(|z| (t, z)).or(first);
            }
        });
        first.map(|(_, z)| z)
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

/// Returns the known values at `count` nodes, and smooth ones in between and beyond: each is the mean
/// of its neighbours' values along the edges. `None` if no path leads from a node to a known value.
pub(super) fn fill_missing(
    count: usize,
    edges: impl Iterator<Item = [u32; 2]>,
    known: &[Option<f64>],
) -> Option<Vec<f64>> {
    let mut value = known.to_vec();
    let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); count];
    for [p, q] in edges {
        neighbours[p as usize].push(q);
        neighbours[q as usize].push(p);
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
            return None;
        }
    }
    let mut value: Vec<f64> = value.into_iter().collect::<Option<_>>()?;
    for _ in 0..SMOOTHING_SWEEPS {
        for &n in &unknown {
            let sum: f64 = neighbours[n].iter().map(|&m| value[m as usize]).sum();
            value[n] = sum / neighbours[n].len() as f64;
        }
    }
    Some(value)
}
