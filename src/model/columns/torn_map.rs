//! A map whose nodes are torn apart at its faults, so that a horizon may have another z on either
//! side.
//!
//! A node of the map has one *torn node* for each of the parts into which faults divide the cells
//! around it. At the end of a fault inside the map there is only one part: horizons are whole there.

use std::collections::{BTreeSet, VecDeque};

use super::horizon::{Horizon, fill_missing};
use crate::error::cause;
use crate::geometry::box_tree::BoxTree;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, distance2, dot, solve_positive, sorted_distinct, sub};
use crate::mesh::poly::{FIRST_SIDE, Lists, PolyMesh};
use crate::parallel::prelude::*;
use crate::{Error, Result};

/// Number of known values from which a plane is fitted to continue a horizon to a fault.
const MIN_FIT_POINTS: usize = 8;
/// Largest number of steps from cell to cell over which values are collected.
const MAX_FIT_STEPS: usize = 60;
/// Smallest variance of the positions across their main direction, relative to that along it, for
/// which a plane is fitted.
const MIN_VARIANCE_RATIO: f64 = 0.05;

/// A map with torn nodes.
#[derive(Debug, Clone)]
pub struct TornMap<'a> {
    /// The map.
    pub map: &'a PolyMesh<2>,
    /// The node of the map at which each torn node is.
    pub nodes: Vec<u32>,
    /// The torn nodes of each column's polygon, anticlockwise.
    pub rings: Lists,
    /// The torn nodes at the ends of each face of the map: those of its first cell, and those of
    /// the cell beyond (of the first cell again on a side).
    pub edges: Vec<[[u32; 2]; 2]>,
    /// The places to which horizons are continued, if the map is torn.
    zone: Option<FaultZone>,
}

/// The z of a horizon at torn nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct TornHorizon {
    /// z at each torn node.
    pub z: Vec<f64>,
    /// `true` for the nodes to which z was continued from the same side of a fault.
    pub is_continued: Vec<bool>,
    /// Number of other nodes at which the horizon is not known.
    pub missing: usize,
}

impl<'a> TornMap<'a> {
    /// Creates the map without tears: every node is one torn node.
    pub fn whole(map: &'a PolyMesh<2>) -> Self {
        let rings = rings_of(map);
        let edges = (0..map.face_cells.len()).map(|f| {
            let nodes = map.faces.get(f);
            [[nodes[0], nodes[1]]; 2]
        });
        Self {
            nodes: (0..map.nodes.len() as u32).collect(),
            edges: edges.collect(),
            rings,
            map,
            zone: None,
        }
    }

    /// Creates the map torn at its faults. Closer than `zone` to a fault, horizons are continued from
    /// their own side.
    pub fn torn(map: &'a PolyMesh<2>, zone: f64) -> Self {
        let rings = rings_of(map);
        // A corner is a place in the ring of a cell.
        let corner = |cell: u32, node: u32| {
            let start = rings.offsets[cell as usize];
            let place = rings.get(cell as usize).iter().position(|&n| n == node);
            start + place.unwrap_or(0) as u32
        };
        let mut parts = UnionFind::new(rings.items.len());
        for (f, &[a, b]) in map.face_cells.iter().enumerate() {
            if b < FIRST_SIDE && !map.on_feature[f] {
                for &n in map.faces.get(f) {
                    parts.unite(corner(a, n), corner(b, n));
                }
            }
        }
        let part_of_corner: Vec<(u32, u32)> = (rings.items.iter().zip(0..))
            .map(|(&node, corner)| (node, parts.find(corner)))
            .collect();
        let order = sorted_distinct(part_of_corner.iter().copied());
        let nodes = order.iter().map(|part| part.0).collect();
        let number = |part: &(u32, u32)| order.binary_search(part).unwrap_or(0) as u32;
        let numbers: Vec<u32> = part_of_corner.iter().map(number).collect();
        let edges = map.face_cells.iter().enumerate().map(|(f, &[a, b])| {
            let other = if b < FIRST_SIDE { b } else { a };
            [a, other]
                .map(|cell| [0, 1].map(|i| numbers[corner(cell, map.faces.get(f)[i]) as usize]))
        });
        let edges = edges.collect();
        Self {
            map,
            nodes,
            edges,
            rings: Lists {
                items: numbers,
                ..rings
            },
            zone: Some(FaultZone::new(map, zone)),
        }
    }

    /// Returns the number of torn nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// Returns the position of a torn node.
    pub fn position(&self, torn_node: usize) -> [f64; 2] {
        self.map.nodes[self.nodes[torn_node] as usize]
    }

    /// Returns the distinct edges between torn nodes.
    pub fn node_edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.edges.iter().flat_map(|&[first, second]| {
            let second = (second != first).then_some(second);
            [first].into_iter().chain(second)
        })
    }

    /// Returns z of a horizon at every torn node. In the zone of faults z is continued from the same
    /// side, by a plane through the values nearby. Where it is not known, it is extrapolated
    /// smoothly. `place` names the horizon in errors.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if z is known at no node, or at none of a part of the map between
    /// faults.
    pub fn horizon(&self, horizon: &Horizon, place: &str) -> Result<TornHorizon> {
        let is_near = |x: [f64; 2]| self.zone.as_ref().is_some_and(|zone| zone.contains(x));
        let at = |x: [f64; 2]| horizon.z_at(x).filter(|_| !is_near(x));
        let positions = || (0..self.node_count()).map(|n| self.position(n));
        let mut is_continued: Vec<bool> = positions().map(is_near).collect();
        let mut known: Vec<Option<f64>> = positions().map(at).collect();
        if known.iter().all(Option::is_none) {
            return Err(Error::Image(cause(
                place,
                "lies beside the map",
                "give a horizon in the map's coordinates (`atomesh info` shows the map's extent)",
            )));
        }
        let unknown = known.iter().zip(&is_continued);
        let missing = unknown
            .filter(|(z, continued)| z.is_none() && !**continued)
            .count();
        if self.zone.is_some() {
            let sites: Vec<Option<f64>> = self.map.sites.iter().map(|&x| at(x)).collect();
            let fit = SideFit {
                torn: self,
                nodes: &known,
                sites: &sites,
                cells_of_nodes: self.cells_of_nodes(),
            };
            let near = (0..self.node_count())
                .into_par_iter()
                .filter(|&n| is_continued[n]);
            let continued: Vec<(usize, Option<f64>)> = near.map(|n| (n, fit.value_at(n))).collect();
            for (n, z) in continued {
                known[n] = z;
                is_continued[n] = z.is_some();
            }
        }
        let Some(z) = fill_missing(known.len(), self.node_edges(), &known) else {
            let unknown = known.iter().position(Option::is_none).unwrap_or(0);
            let [x, y] = self.position(unknown);
            return Err(Error::Image(cause(
                place,
                format!("is not known anywhere between the faults around x = {x:.6}, y = {y:.6}"),
                "give a horizon that covers every part of the map, or a smaller --throws",
            )));
        };
        Ok(TornHorizon {
            z,
            is_continued,
            missing,
        })
    }

    /// Returns the cells at each torn node.
    fn cells_of_nodes(&self) -> Vec<Vec<u32>> {
        let mut cells = vec![Vec::new(); self.node_count()];
        for cell in 0..self.rings.len() {
            for &n in self.rings.get(cell) {
                cells[n as usize].push(cell as u32);
            }
        }
        cells
    }
}

/// Returns the nodes of each cell's polygon, anticlockwise.
fn rings_of(map: &PolyMesh<2>) -> Lists {
    let (faces, mut rings, mut ring) = (map.faces_of_cells(), Lists::default(), Vec::new());
    for cell in 0..map.sites.len() {
        ring.clear();
        map.append_ring(cell, faces.get(cell), &mut ring);
        rings.push(ring.iter().copied());
    }
    rings
}

/// The places closer to a fault than a distance.
#[derive(Debug, Clone)]
struct FaultZone {
    edges: Vec<[[f64; 2]; 2]>,
    tree: BoxTree<'static, 2>,
    width: f64,
}

impl FaultZone {
    fn new(map: &PolyMesh<2>, width: f64) -> Self {
        let is_fault = |f: &usize| map.on_feature[*f] && map.face_cells[*f][1] < FIRST_SIDE;
        let edge = |f: usize| [0, 1].map(|i| map.nodes[map.faces.get(f)[i] as usize]);
        let edges: Vec<_> = (0..map.face_cells.len())
            .filter(is_fault)
            .map(edge)
            .collect();
        let bounds = |[p, q]: &[[f64; 2]; 2]| {
            [0, 1].map(|end| {
                std::array::from_fn(|k| match end {
                    0 => p[k].min(q[k]) - width,
                    _ => p[k].max(q[k]) + width,
                })
            })
        };
        let boxes: Vec<[[f64; 2]; 2]> = edges.iter().map(bounds).collect();
        Self {
            tree: BoxTree::new(boxes, vec![0; edges.len()]),
            edges,
            width,
        }
    }

    /// Returns `true` for a place on a fault, or closer to one than the width.
    fn contains(&self, x: [f64; 2]) -> bool {
        let mut is_near = false;
        self.tree.visit_at(x, |edge| {
            let [p, q] = self.edges[edge];
            let along = sub(q, p);
            let fraction = (dot(sub(x, p), along) / dot(along, along)).clamp(0.0, 1.0);
            let distance2 = distance2(&x, &add_scaled(p, fraction, along));
            is_near |= distance2 <= self.width * self.width;
        });
        is_near
    }
}

/// Continues the known values of a horizon within the parts of a map.
struct SideFit<'a> {
    torn: &'a TornMap<'a>,
    /// Known values at torn nodes and at the sites of cells.
    nodes: &'a [Option<f64>],
    sites: &'a [Option<f64>],
    cells_of_nodes: Vec<Vec<u32>>,
}

impl SideFit<'_> {
    /// Returns z at a torn node: that of a plane fitted to the nearest known values that paths from
    /// cell to cell reach without crossing a fault, or their mean if these lie on a line. `None` if
    /// there are none.
    fn value_at(&self, node: usize) -> Option<f64> {
        let x = self.torn.position(node);
        let mut points: Vec<([f64; 2], f64)> = Vec::new();
        let (mut nodes, mut cells) = (BTreeSet::from([node as u32]), BTreeSet::new());
        let mut front = VecDeque::from([node as u32]);
        for _ in 0..MAX_FIT_STEPS {
            let mut next = VecDeque::new();
            for n in front {
                for &cell in &self.cells_of_nodes[n as usize] {
                    if !cells.insert(cell) {
                        continue;
                    }
                    let site = self.torn.map.sites[cell as usize];
                    points.extend(self.sites[cell as usize].map(|z| (site, z)));
                    for &m in self.torn.rings.get(cell as usize) {
                        if nodes.insert(m) {
                            next.push_back(m);
                            let z = self.nodes[m as usize];
                            points.extend(z.map(|z| (self.torn.position(m as usize), z)));
                        }
                    }
                }
            }
            let fitted = (points.len() >= MIN_FIT_POINTS).then(|| plane_at(x, &points));
            if let Some(z) = fitted.flatten() {
                return Some(z);
            }
            if next.is_empty() {
                break;
            }
            front = next;
        }
        let mean = || points.iter().map(|p| p.1).sum::<f64>() / points.len() as f64;
        plane_at(x, &points).or_else(|| (!points.is_empty()).then(mean))
    }
}

/// Returns the value at `x` of the plane that fits values at points best, near ones most. `None` if
/// the points nearly lie on a line.
fn plane_at(x: [f64; 2], points: &[([f64; 2], f64)]) -> Option<f64> {
    let squares = points.iter().map(|(p, _)| distance2(p, &x));
    let nearest = squares.fold(f64::INFINITY, f64::min);
    let weights = points
        .iter()
        .map(|(p, _)| 1.0 / (distance2(p, &x) + nearest));
    let weights: Vec<f64> = weights.collect();
    let total: f64 = weights.iter().sum();
    let mean = |value: &dyn Fn(usize) -> f64| {
        weights
            .iter()
            .enumerate()
            .map(|(i, w)| w * value(i))
            .sum::<f64>()
            / total
    };
    let centre = [0, 1].map(|k| mean(&|i| points[i].0[k]));
    let z = mean(&|i| points[i].1);
    let offset = |i: usize, k: usize| points[i].0[k] - centre[k];
    let [xx, xy, yy] =
        [(0, 0), (0, 1), (1, 1)].map(|(k, l)| mean(&|i| offset(i, k) * offset(i, l)));
    let [half_trace, half_difference] = [0.5 * (xx + yy), 0.5 * (xx - yy)];
    let spread = (half_difference * half_difference + xy * xy).sqrt();
    let is_wide = half_trace - spread > MIN_VARIANCE_RATIO * (half_trace + spread);
    if !is_wide {
        return None;
    }
    let right = [0, 1].map(|k| mean(&|i| offset(i, k) * (points[i].1 - z)));
    let slope = solve_positive([[xx, xy], [xy, yy]], right);
    Some(z + dot(slope, sub(x, centre)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::voronoi::voronoi_plane;

    /// Returns 6 x 4 squares with a fault along x = 3 from y = 0 up to `end`.
    fn map(end: f64) -> PolyMesh<2> {
        let row = |n: u32| (0..n).map(|i| 0.5 + f64::from(i));
        let sites: Vec<[f64; 2]> = row(4).flat_map(|y| row(6).map(move |x| [x, y])).collect();
        let mut map = voronoi_plane(&sites, [6.0, 4.0]).unwrap();
        for f in 0..map.inner_face_count() {
            let ends = [0, 1].map(|i| map.nodes[map.faces.get(f)[i] as usize]);
            map.on_feature[f] = ends
                .iter()
                .all(|p| (p[0] - 3.0).abs() < 1e-9 && p[1] < end + 1e-9);
        }
        map
    }

    #[test]
    fn nodes_are_torn_along_a_fault_but_not_at_its_end() {
        let map = map(2.0);
        let torn = TornMap::torn(&map, 0.7);
        // The nodes at y = 0 and y = 1 have two sides; that at y = 2 is the end.
        assert_eq!(torn.node_count(), map.nodes.len() + 2);
        let (whole, torn_whole) = (TornMap::whole(&map), map.clone());
        assert_eq!(whole.node_count(), torn_whole.nodes.len());
        let mut healed = torn_whole;
        healed.on_feature.fill(false);
        let healed = TornMap::torn(&healed, 0.7);
        assert_eq!((&healed.rings, &healed.edges), (&whole.rings, &whole.edges));
    }

    #[test]
    fn planes_are_continued_exactly_on_both_sides() {
        let map = map(4.0);
        let torn = TornMap::torn(&map, 0.7);
        let triangles = |low: f64, high: f64, z: &dyn Fn(f64, f64) -> f64| {
            let corner = |x: f64, y: f64| [x, y, z(x, y)];
            let [a, b, c, d] =
                [(low, -1.0), (high, -1.0), (high, 5.0), (low, 5.0)].map(|(x, y)| corner(x, y));
            [[a, b, c], [a, c, d]]
        };
        let left = |x: f64, y: f64| 100.0 + 0.5 * x - 0.25 * y;
        let right = |x: f64, y: f64| 120.0 - 0.125 * x + y;
        // The tear is beside the fault, and a gap is beside the tear, as at a fault that dips.
        let mut corners = triangles(-1.0, 2.7, &left).to_vec();
        corners.extend(triangles(3.6, 7.0, &right));
        let horizon = Horizon::Surface(super::super::horizon::TriangleIndex::new(corners));
        let torn_horizon = torn.horizon(&horizon, "h").unwrap();
        assert_eq!(torn_horizon.missing, 0);
        for f in 0..map.inner_face_count() {
            if map.on_feature[f] {
                for (side, plane) in [&left as &dyn Fn(f64, f64) -> f64, &right]
                    .iter()
                    .enumerate()
                {
                    for n in torn.edges[f][side] {
                        let [x, y] = torn.position(n as usize);
                        let z = torn_horizon.z[n as usize];
                        assert!(
                            (z - plane(x, y)).abs() < 1e-9,
                            "{side}: {z} {}",
                            plane(x, y)
                        );
                        assert!(torn_horizon.is_continued[n as usize]);
                    }
                }
            }
        }
        // A part of the map without values is named.
        let half = Horizon::Surface(super::super::horizon::TriangleIndex::new(
            triangles(-1.0, 2.7, &left).to_vec(),
        ));
        let error = torn.horizon(&half, "h").unwrap_err().to_string();
        assert!(error.contains("between the faults"), "{error}");
    }
}
