//! Continues faults beyond their edges, through layers in which an image shows no evidence of them, up to
//! the next fault, the sides of the mesh, or a given distance.
//!
//! Cells near a fault are divided into those on its one and its other side. Next to the fault its faces
//! tell the side. From there the division spreads from cell to cell, and the side of a cell is that of the
//! plane that fits the nearest part of the fault. It spreads neither through other faults nor far from
//! that plane. The connections between the two sides that are on no surface are the extension: its faces
//! are those of cells, so that they are not plane, but without holes.

use std::collections::VecDeque;

use serde::Serialize;

use crate::geometry::cell_list::CellList;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{add_scaled, bounding_box, dot, norm, sub, unit};
use crate::mesh::graph::Graph;
use crate::model::surface::SurfaceKind;

/// Largest distance of a cell from the continuation of a fault, in units of the cube root of its volume.
const BAND_WIDTH: f64 = 2.5;

/// Smallest radius of the part of a fault to which a plane is fitted, in units of the cube root of the
/// mean volume of cells at the fault. The radius is at least the distance of the continuation from the
/// fault: the farther a plane reaches, the more must it rest on.
const MIN_FIT_RADIUS: f64 = 4.0;

/// A fault that was extended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExtendedFault {
    /// Name of the fault.
    pub name: String,
    /// Area of its faces in m^2 (length in m in the plane).
    pub area: f64,
    /// Name of its extension, which is a surface of its own.
    pub extension: String,
    /// Number of faces of the extension.
    pub faces: usize,
    /// Area of the extension in m^2, projected onto the continuation of the fault.
    pub extension_area: f64,
}

impl ExtendedFault {
    /// Returns a line that describes the extension in a mesh of this dimension.
    pub fn note(&self, dimension: usize) -> String {
        let unit = if dimension == 2 { "m" } else { "m^2" };
        format!(
            "{} ({:.3e} {unit}) is extended by {:.3e} {unit}, {} faces: {}",
            self.name, self.area, self.extension_area, self.faces, self.extension
        )
    }
}

/// The faces by which a fault continues.
pub(crate) struct Extension {
    /// Number of the fault.
    pub surface: u32,
    /// Area of the fault.
    pub fault_area: f64,
    /// The connections.
    pub connections: Vec<usize>,
    /// Their area, projected onto the continuation of the fault.
    pub area: f64,
}

impl Extension {
    /// Describes the extension of a fault.
    pub fn extended_fault(&self, fault: &str, name: &str) -> ExtendedFault {
        ExtendedFault {
            name: fault.into(),
            area: self.fault_area,
            extension: name.into(),
            faces: self.connections.len(),
            extension_area: self.area,
        }
    }
}

/// Returns the extension of each of the `faults` (numbers of surfaces) that has one. `labels` has the
/// number of the surface of each connection, 0 for none, and `kinds` the kinds of surfaces 1, 2 ...
/// No extension is farther than `max_distance` from its fault. An extension ends at those of the faults
/// before.
pub(crate) fn extensions<const D: usize>(
    graph: &Graph<D>,
    mut labels: Vec<u32>,
    kinds: &[SurfaceKind],
    faults: &[u32],
    max_distance: f64,
) -> Vec<Extension> {
    let cell_connections = CellConnections::new(graph);
    let mut is_barrier: Vec<bool> = vec![false];
    is_barrier.extend(kinds.iter().map(|kind| *kind != SurfaceKind::Horizon));
    let mut found = Vec::new();
    for &surface in faults {
        let Some(sheet) = FaultSheet::new(graph, &labels, surface) else {
            continue;
        };
        let sides = sheet.sides(graph, &cell_connections, &labels, &is_barrier, max_distance);
        let mut extension = Extension {
            surface,
            fault_area: sheet.faces.iter().map(|face| face.2).sum(),
            connections: Vec::new(),
            area: 0.0,
        };
        for (index, c) in graph.connections.iter().enumerate() {
            let [a, b] = c.cells.map(|cell| sides[cell as usize]);
            let is_horizon = !is_barrier[labels[index] as usize];
            if i16::from(a) * i16::from(b) < 0 && (labels[index] == 0 || is_horizon) {
                extension.connections.push(index);
                extension.area += c.area * dot(c.normal, sheet.plane_at(c.point).normal).abs();
            }
        }
        if extension.connections.is_empty() {
            continue;
        }
        for &index in &extension.connections {
            labels[index] = surface;
        }
        found.push(extension);
    }
    found
}

/// The connections of each cell.
struct CellConnections {
    starts: Vec<u32>,
    connections: Vec<u32>,
}

impl CellConnections {
    fn new<const D: usize>(graph: &Graph<D>) -> Self {
        let cells = graph.connections.iter().flat_map(|c| c.cells);
        let (starts, sides) = sort_by_group(graph.volume.len(), cells.map(|cell| cell as usize));
        // Each connection has two sides.
        let connections = sides.into_iter().map(|side| side / 2).collect();
        Self {
            starts,
            connections,
        }
    }

    /// Returns the connections of a cell.
    fn connections_at(&self, cell: u32) -> &[u32] {
        let range = self.starts[cell as usize]..self.starts[cell as usize + 1];
        &self.connections[range.start as usize..range.end as usize]
    }
}

/// Returns the edge of a cube (in the plane a square) of this volume.
fn cell_size<const D: usize>(volume: f64) -> f64 {
    match D {
        2 => volume.sqrt(),
        _ => volume.cbrt(),
    }
}

/// A plane near a fault.
struct FittedPlane<const D: usize> {
    normal: [f64; D],
    point: [f64; D],
    /// Distance of the position from the fault.
    distance: f64,
}

/// The faces of a fault.
struct FaultSheet<const D: usize> {
    surface: u32,
    points: CellList<D>,
    /// Centre, normal and area of each face. The normals point to the same side.
    faces: Vec<([f64; D], [f64; D], f64)>,
    positions: Vec<[f64; D]>,
    min_radius: f64,
    size: f64,
}

impl<const D: usize> FaultSheet<D> {
    /// Returns the faces of a surface, or `None` if it has none.
    fn new(graph: &Graph<D>, labels: &[u32], surface: u32) -> Option<Self> {
        let pairs = graph.connections.iter().zip(labels);
        let on_fault: Vec<_> = pairs
            .filter(|(_, l)| **l == surface)
            .map(|(c, _)| c)
            .collect();
        let first = on_fault.first()?;
        // The mean normal, up to its sign: each normal is turned to the side of the sum so far.
        let mut mean = first.normal;
        for _ in 0..2 {
            mean = on_fault.iter().fold([0.0; D], |sum, c| {
                let sign = dot(c.normal, mean).signum();
                add_scaled(sum, sign * c.area, c.normal)
            });
        }
        let faces: Vec<_> = on_fault
            .iter()
            .map(|c| {
                let sign = if dot(c.normal, mean) < 0.0 { -1.0 } else { 1.0 };
                (c.point, c.normal.map(|n| sign * n), c.area)
            })
            .collect();
        let volumes = on_fault.iter().flat_map(|c| c.cells);
        let volume: f64 = volumes.map(|cell| graph.volume[cell as usize]).sum();
        let mean_size = cell_size::<D>(volume / (2 * on_fault.len()) as f64);
        let positions: Vec<[f64; D]> = faces.iter().map(|face| face.0).collect();
        let [low, high] = bounding_box(positions.iter().copied());
        Some(Self {
            surface,
            points: CellList::new(&positions, 2.0 * mean_size),
            faces,
            positions,
            min_radius: MIN_FIT_RADIUS * mean_size,
            size: norm(sub(high, low)).max(mean_size),
        })
    }

    /// Returns the distance of a position from the nearest face.
    fn distance(&self, x: [f64; D]) -> f64 {
        let mut radius = self.min_radius;
        loop {
            let mut nearest = f64::INFINITY;
            self.points.visit_within(x, radius, |i| {
                nearest = nearest.min(norm(sub(self.positions[i], x)));
            });
            if nearest <= radius {
                return nearest;
            }
            radius *= 2.0;
        }
    }

    /// Returns the plane that fits the part of the fault that is nearest to a position.
    fn plane_at(&self, x: [f64; D]) -> FittedPlane<D> {
        let distance = self.distance(x);
        let radius = (distance + self.min_radius.max(distance)).min(distance + self.size);
        let (mut normal, mut point, mut total) = ([0.0; D], [0.0; D], 0.0);
        self.points.visit_within(x, radius, |i| {
            let (centre, n, area) = self.faces[i];
            // The nearest faces count most, and those at the radius not at all.
            let share = (norm(sub(centre, x)) - distance) / (radius - distance);
            let weight = area * (1.0 - share.min(1.0) * share.min(1.0));
            normal = add_scaled(normal, weight, n);
            point = add_scaled(point, weight, centre);
            total += weight;
        });
        FittedPlane {
            normal: unit(normal),
            point: point.map(|c| c / total),
            distance,
        }
    }

    /// Returns the side of each cell: -1 or 1 for cells near the fault or its continuation, 0 for others.
    fn sides(
        &self,
        graph: &Graph<D>,
        cell_connections: &CellConnections,
        labels: &[u32],
        is_barrier: &[bool],
        max_distance: f64,
    ) -> Vec<i8> {
        let mut sides = vec![0i8; graph.volume.len()];
        let mut sums = vec![0.0f64; graph.volume.len()];
        let mut front = VecDeque::new();
        let on_fault = graph.connections.iter().zip(labels);
        let on_fault = on_fault.filter(|(_, label)| **label == self.surface);
        for ((c, _), (_, normal, _)) in on_fault.zip(&self.faces) {
            let sign = dot(c.normal, *normal).signum();
            sums[c.cells[0] as usize] -= sign * c.area;
            sums[c.cells[1] as usize] += sign * c.area;
            front.extend(c.cells);
        }
        for &cell in &front {
            sides[cell as usize] = if sums[cell as usize] < 0.0 { -1 } else { 1 };
        }
        while let Some(cell) = front.pop_front() {
            for &index in cell_connections.connections_at(cell) {
                let label = labels[index as usize];
                if label != 0 && label != self.surface && is_barrier[label as usize] {
                    continue;
                }
                let [a, b] = graph.connections[index as usize].cells;
                let other = (if a == cell { b } else { a }) as usize;
                if sides[other] != 0 {
                    continue;
                }
                let site = graph.site[other];
                let plane = self.plane_at(site);
                let offset = dot(sub(site, plane.point), plane.normal);
                if plane.distance <= max_distance
                    && offset.abs() <= BAND_WIDTH * cell_size::<D>(graph.volume[other])
                {
                    sides[other] = if offset < 0.0 { -1 } else { 1 };
                    front.push_back(other as u32);
                }
            }
        }
        sides
    }
}
