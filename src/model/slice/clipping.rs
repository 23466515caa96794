//! The part of a body that is cut away, and the sections of cells with a plane.

use super::faces::DrawableFaces;
use super::raster::ValuedPoint;
use super::shape::cut_polygon;
use crate::mesh::complex::NONE;

/// The part of a body that is cut away to show the inside: the points that are beyond all of some
/// planes. Positions are fractions of the box.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ClipRegion {
    pub planes: Vec<ClipPlane>,
}

/// A plane that limits the part that is cut away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ClipPlane {
    /// The axis perpendicular to the plane.
    pub axis: usize,
    pub position: f64,
    /// `true` if points above the plane are beyond it.
    pub removes_above: bool,
}

impl ClipRegion {
    /// Returns `true` if a point is cut away.
    pub fn contains(&self, p: [f64; 3]) -> bool {
        self.planes.iter().all(|plane| plane.has_beyond(p))
    }

    /// Returns `true` if a point of plane `i` is on the boundary of the part that is cut away.
    pub fn is_on_rim(&self, i: usize, p: [f64; 3]) -> bool {
        let others = self.planes.iter().enumerate().filter(|(j, _)| *j != i);
        others.into_iter().all(|(_, plane)| plane.has_beyond(p))
    }
}

impl ClipPlane {
    /// Returns `true` if a point is beyond the plane.
    fn has_beyond(&self, p: [f64; 3]) -> bool {
        if self.removes_above {
            p[self.axis] > self.position
        } else {
            p[self.axis] < self.position
        }
    }
}

/// Returns the sections of cells with the plane on which coordinate `axis` is `position`: the
/// number of each cell, and the corners of its convex section in cyclic order with the values
/// there. `value` returns the value of a cell at a node.
pub(super) fn cell_sections(
    faces: &DrawableFaces,
    axis: usize,
    position: f64,
    value: &impl Fn(u32, u32) -> f64,
) -> Vec<(u32, Vec<ValuedPoint>)> {
    let mut section_ends: Vec<(u32, ValuedPoint)> = Vec::new();
    let mut ring = Vec::new();
    for face in 0..faces.len() {
        for &cell in faces.cells[face].iter().filter(|cell| **cell != NONE) {
            ring.clear();
            let corner = |&n: &u32| (faces.nodes[n as usize], value(cell, n));
            ring.extend(faces.rings.get(face).iter().map(corner));
            let ends = cut_polygon(&ring, axis, position);
            section_ends.extend(ends.into_iter().flatten().map(|end| (cell, end)));
        }
    }
    section_ends.sort_by_key(|(cell, _)| *cell);
    let [h, v] = [(axis + 1) % 3, (axis + 2) % 3];
    (section_ends.chunk_by(|a, b| a.0 == b.0))
        .map(|ends| {
            let count = ends.len() as f64;
            let centroid = [h, v].map(|k| ends.iter().map(|(_, (p, _))| p[k]).sum::<f64>() / count);
            let angle = |p: &[f64; 3]| (p[v] - centroid[1]).atan2(p[h] - centroid[0]);
            let mut corners: Vec<ValuedPoint> = ends.iter().map(|&(_, end)| end).collect();
            corners.sort_by(|(p, _), (q, _)| angle(p).total_cmp(&angle(q)));
            // Each corner occurs twice, as an end of the sections of two faces.
            let coincide = |p: &[f64; 3], q: &[f64; 3]| (0..3).all(|k| (p[k] - q[k]).abs() < 1e-9);
            corners.dedup_by(|(p, _), (q, _)| coincide(p, q));
            if corners.len() > 1 && coincide(&corners[0].0, &corners[corners.len() - 1].0) {
                corners.pop();
            }
            (ends[0].0, corners)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::slice::tests::unit_cube;

    #[test]
    fn the_sections_of_cells_fill_the_plane() {
        let faces = unit_cube();
        for axis in 0..3 {
            for position in [0.2, 0.5, 0.9] {
                // The value is the next coordinate, so that every corner must have it.
                let next = (axis + 1) % 3;
                let value = |_, node: u32| faces.nodes[node as usize][next];
                let sections = cell_sections(&faces, axis, position, &value);
                let mut area = 0.0;
                for (_, corners) in &sections {
                    assert!(corners.iter().all(|(p, v)| (p[next] - v).abs() < 1e-12));
                    let corner = |i: usize| corners[i % corners.len()].0;
                    let [h, v] = [(axis + 1) % 3, (axis + 2) % 3];
                    let cross = |i: usize| {
                        corner(i)[h] * corner(i + 1)[v] - corner(i + 1)[h] * corner(i)[v]
                    };
                    area += 0.5 * (0..corners.len()).map(cross).sum::<f64>();
                }
                assert!(
                    (area - 1.0).abs() < 1e-9,
                    "axis {axis} at {position}: {area}"
                );
            }
        }
    }

    #[test]
    fn a_corner_lies_beyond_all_its_planes() {
        let corner = ClipRegion {
            planes: [(0, true), (1, false)]
                .map(|(axis, removes_above)| ClipPlane {
                    axis,
                    position: 0.5,
                    removes_above,
                })
                .to_vec(),
        };
        assert!(corner.contains([0.6, 0.4, 0.0]) && !corner.contains([0.6, 0.6, 0.0]));
        assert!(corner.is_on_rim(0, [0.5, 0.4, 0.9]) && !corner.is_on_rim(0, [0.5, 0.6, 0.9]));
    }
}
