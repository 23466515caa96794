//! Cells that stand in columns, one above another: what they are known by, and what is under a point.

use super::poly::PolyMesh;

impl<const D: usize> PolyMesh<D> {
    /// Whether the cells are columns (or prisms): every face between two cells is upright, on two
    /// vertical lines, or lies between sites that are exactly above one another. Never in 2-D.
    pub fn is_columnar(&self) -> bool {
        D == 3
            && (0..self.inner_face_count()).all(|f| {
                let [a, b] = self.face_cells[f].map(|cell| &self.sites[cell as usize]);
                a[..2] == b[..2] || self.is_upright(f)
            })
    }

    /// Whether all nodes of a face are on two vertical lines.
    pub fn is_upright(&self, f: usize) -> bool {
        let on = |n: u32| &self.nodes[n as usize][..2];
        let ring = self.faces.get(f);
        let first = on(ring[0]);
        let other = ring.iter().map(|&n| on(n)).find(|x| *x != first);
        D == 3 && other.is_some_and(|other| ring.iter().all(|&n| on(n) == first || on(n) == other))
    }

    /// The point of face `f`, as the fan that it is, above or below `x`; `None` in 2-D and for upright
    /// faces. Beyond the face's rim its nearest triangle goes on.
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
            let all = area(apex, p, q);
            let shares = [area(x, p, q), area(apex, x, q), area(apex, p, x)].map(|a| a / all);
            let least = shares[0].min(shares[1]).min(shares[2]);
            if least > best.0 {
                let height = shares[0] * apex[2] + shares[1] * p[2] + shares[2] * q[2];
                best = (
                    least,
                    std::array::from_fn(|k| if k == 2 { height } else { x[k] }),
                );
            }
        }
        (best.0 > f64::NEG_INFINITY).then_some(best.1)
    }

    /// The volume (area in 2-D) that the faces on the boundary enclose.
    pub fn enclosed_volume(&self) -> f64 {
        let last = D - 1;
        let mut volume = 0.0;
        // The flux of (0, 0, z) out of it, from below and from the lowest node.
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
