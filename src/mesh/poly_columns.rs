//! Cells that stand in columns, one above another: how to recognise them, and the points of their
//! faces above or below a site.

use super::poly::PolyMesh;
use crate::geometry::{distance2, dot, sub};

impl<const D: usize> PolyMesh<D> {
    /// Returns `true` if the cells form columns (or prisms): every face between two cells is
    /// upright, on two vertical lines, or lies between two sites exactly above one another. Always
    /// `false` in 2-D.
    pub fn is_columnar(&self) -> bool {
        D == 3
            && (0..self.inner_face_count()).all(|f| {
                let [a, b] = self.face_cells[f].map(|cell| &self.sites[cell as usize]);
                a[..2] == b[..2] || self.is_upright(f)
            })
    }

    /// Returns `true` if all nodes of a face lie on two vertical lines, or between them in their
    /// plane.
    pub fn is_upright(&self, f: usize) -> bool {
        let horizontal = |n: &u32| {
            let node = &self.nodes[*n as usize];
            [node[0], node[1]]
        };
        let ring = self.faces.get(f);
        let first = horizontal(&ring[0]);
        let Some(other) = ring.iter().map(horizontal).find(|x| *x != first) else {
            return false;
        };
        D == 3
            && (ring
                .iter()
                .map(horizontal)
                .all(|x| x == first || x == other)
                || is_on_line(ring.iter().map(horizontal)))
    }

    /// Returns the point of face `f`, taken as a fan of triangles, directly above or below `x`.
    /// Outside the face its nearest triangle is extrapolated. Returns `None` in 2-D and for upright
    /// faces.
    pub fn vertical_projection(&self, f: usize, x: [f64; D]) -> Option<[f64; D]> {
        let nodes = self.faces.get(f);
        let apex = self.face_shape(f).apex;
        let area = |a: [f64; D], b: [f64; D], c: [f64; D]| {
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        let mut best = (f64::NEG_INFINITY, x);
        for i in 0..if D == 3 { nodes.len() } else { 0 } {
            let (p, q) = (nodes[i], nodes[(i + 1) % nodes.len()]);
            let [p, q] = [p, q].map(|n| self.nodes[n as usize]);
            let total = area(apex, p, q);
            let weights = [area(x, p, q), area(apex, x, q), area(apex, p, x)].map(|a| a / total);
            let min_weight = weights[0].min(weights[1]).min(weights[2]);
            if min_weight > best.0 {
                let height = weights[0] * apex[2] + weights[1] * p[2] + weights[2] * q[2];
                best = (
                    min_weight,
                    std::array::from_fn(|k| if k == 2 { height } else { x[k] }),
                );
            }
        }
        (best.0 > f64::NEG_INFINITY).then_some(best.1)
    }

    /// Returns the volume (area in 2-D) that the faces on the boundary enclose.
    pub fn enclosed_volume(&self) -> f64 {
        let last = D - 1;
        let mut volume = 0.0;
        // By the divergence theorem, the volume is the flux of (0, 0, z - base) through the
        // boundary.
        let base = self
            .nodes
            .iter()
            .map(|p| p[last])
            .fold(f64::INFINITY, f64::min);
        for f in self.inner_face_count()..self.face_cells.len() {
            let nodes = self.faces.get(f);
            let apex = self.face_shape(f).apex;
            let triangles = if D == 2 { 1 } else { nodes.len() };
            for i in 0..triangles {
                let (p, q) = (nodes[i], nodes[(i + 1) % nodes.len()]);
                let [u, v] = [p, q].map(|n| self.nodes[n as usize][last]);
                let mean = if D == 2 {
                    0.5 * (u + v)
                } else {
                    (u + v + apex[last]) / 3.0
                };
                volume += self.fan_area(apex, p, q)[last] * (mean - base);
            }
        }
        volume
    }
}

/// Returns `true` if points of the plane lie on a line, within a billionth of their distance.
fn is_on_line(points: impl Iterator<Item = [f64; 2]> + Clone) -> bool {
    let farthest = |from: [f64; 2]| {
        let mut points = points.clone();
        let first = points.next().unwrap_or(from);
        points.fold(first, |far, x| {
            if distance2(&x, &from) > distance2(&far, &from) {
                x
            } else {
                far
            }
        })
    };
    let start = farthest(farthest([0.0; 2]));
    let along = sub(farthest(start), start);
    let square = dot(along, along);
    points.clone().all(|x| {
        let offset = sub(x, start);
        (along[0] * offset[1] - along[1] * offset[0]).abs() <= 1e-9 * square
    })
}
