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

use super::{FaceSurfaces, Model};
use crate::geometry::cell_list::CellList;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{add_scaled, bounding_box, dot, norm, sub, unit};
use crate::mesh::graph::Graph;
use crate::model::surface::SurfaceKind;
use crate::model::surface::names::add_names;

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
    /// Area of its faces in m^2.
    pub area: f64,
    /// Name of its extension, which is a surface of its own.
    pub extension: String,
    /// Number of faces of the extension.
    pub faces: usize,
    /// Area of the extension in m^2, projected onto the continuation of the fault.
    pub extension_area: f64,
}

impl ExtendedFault {
    /// Returns a line that describes the extension.
    pub fn note(&self) -> String {
        format!(
            "{} ({:.3e} m^2) is extended by {:.3e} m^2, {} faces: {}",
            self.name, self.area, self.extension_area, self.faces, self.extension
        )
    }
}

/// The faces by which a fault continues.
pub(super) struct Extension {
    /// Number of the fault.
    pub surface: u32,
    /// The connections.
    pub connections: Vec<usize>,
    /// Their area, projected onto the continuation of the fault.
    pub area: f64,
}

/// Returns the extension of each of the `faults` (numbers of surfaces) that has one. No extension is
/// farther than `max_distance` from its fault. An extension ends at those of the faults before.
pub(super) fn extensions(
    graph: &Graph<3>,
    surfaces: &FaceSurfaces,
    faults: &[u32],
    max_distance: f64,
) -> Vec<Extension> {
    let cell_connections = CellConnections::new(graph);
    let mut labels = surfaces.merged_labels();
    let mut is_barrier: Vec<bool> = vec![false];
    is_barrier.extend(
        surfaces
            .kinds
            .iter()
            .map(|kind| *kind != SurfaceKind::Horizon),
    );
    let mut found = Vec::new();
    for &surface in faults {
        let Some(sheet) = FaultSheet::new(graph, &labels, surface) else {
            continue;
        };
        let sides = sheet.sides(graph, &cell_connections, &labels, &is_barrier, max_distance);
        let mut extension = Extension {
            surface,
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
    fn new(graph: &Graph<3>) -> Self {
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

/// A plane near a fault.
struct FittedPlane {
    normal: [f64; 3],
    point: [f64; 3],
    /// Distance of the position from the fault.
    distance: f64,
}

/// The faces of a fault.
struct FaultSheet {
    surface: u32,
    points: CellList<3>,
    /// Centre, normal and area of each face. The normals point to the same side.
    faces: Vec<([f64; 3], [f64; 3], f64)>,
    positions: Vec<[f64; 3]>,
    min_radius: f64,
    size: f64,
}

impl FaultSheet {
    /// Returns the faces of a surface, or `None` if it has none.
    fn new(graph: &Graph<3>, labels: &[u32], surface: u32) -> Option<Self> {
        let pairs = graph.connections.iter().zip(labels);
        let on_fault: Vec<_> = pairs
            .filter(|(_, l)| **l == surface)
            .map(|(c, _)| c)
            .collect();
        let first = on_fault.first()?;
        // The mean normal, up to its sign: each normal is turned to the side of the sum so far.
        let mut mean = first.normal;
        for _ in 0..2 {
            mean = on_fault.iter().fold([0.0; 3], |sum, c| {
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
        let mean_size = (volume / (2 * on_fault.len()) as f64).cbrt();
        let positions: Vec<[f64; 3]> = faces.iter().map(|face| face.0).collect();
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
    fn distance(&self, x: [f64; 3]) -> f64 {
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
    fn plane_at(&self, x: [f64; 3]) -> FittedPlane {
        let distance = self.distance(x);
        let radius = (distance + self.min_radius.max(distance)).min(distance + self.size);
        let (mut normal, mut point, mut total) = ([0.0; 3], [0.0; 3], 0.0);
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
        graph: &Graph<3>,
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
                    && offset.abs() <= BAND_WIDTH * graph.volume[other].cbrt()
                {
                    sides[other] = if offset < 0.0 { -1 } else { 1 };
                    front.push_back(other as u32);
                }
            }
        }
        sides
    }
}

impl Model {
    /// Extends all faults by up to `max_distance` metres. Each extension becomes a fault of its own.
    pub fn extend_faults(&mut self, max_distance: f64) -> Vec<ExtendedFault> {
        let names = self.surfaces.all_names().names;
        let is_fault =
            |surface: &u32| self.surfaces.kinds[*surface as usize - 1] == SurfaceKind::Fault;
        let faults: Vec<u32> = (1..=self.surfaces.kept_count as u32)
            .filter(is_fault)
            .collect();
        let found = extensions(&self.graph, &self.surfaces, &faults, max_distance);
        let mut all_names = [super::reserved_names(), names.clone()].concat();
        let known_count = all_names.len();
        let fault_name = |extension: &Extension| names[extension.surface as usize - 1].clone();
        let new_names = found.iter().map(|e| format!("{}_extension", fault_name(e)));
        add_names(&mut all_names, new_names);
        let new_names = all_names.split_off(known_count);
        let extended = found
            .iter()
            .zip(&new_names)
            .map(|(extension, new_name)| {
                let pairs = self
                    .graph
                    .connections
                    .iter()
                    .zip(&self.surfaces.connection_surfaces);
                let on_fault = pairs.filter(|(_, label)| **label == extension.surface);
                ExtendedFault {
                    name: fault_name(extension),
                    area: on_fault.map(|(c, _)| c.area).sum(),
                    extension: new_name.clone(),
                    faces: extension.connections.len(),
                    extension_area: extension.area,
                }
            })
            .collect();
        let mut extension_of = vec![None; self.graph.connections.len()];
        for (number, extension) in found.iter().enumerate() {
            for &index in &extension.connections {
                extension_of[index] = Some(number);
                // An extension goes on through horizons.
                self.surfaces.connection_surfaces[index] = 0;
            }
        }
        let first = self.surfaces.kept_count as u32 + 1;
        let faults = found.iter().map(|extension| extension.surface);
        self.surfaces.extensions = (first..).zip(faults).collect();
        let kind = SurfaceKind::Fault;
        (self.surfaces).add_surfaces(new_names, kind, |index| extension_of[index]);
        extended
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::voronoi;
    use crate::model::flow::FaultLaw;
    use crate::model::reservoir::SealCheck;
    use crate::progress::CancelToken;

    const EXTENT: [f64; 3] = [12.0, 10.0, 8.0];

    /// Returns a model of jittered cells with a site on each side of the plane x + 0.2 z = 6.4, as far
    /// apart as cells are. `faults` tells which connections that cross the plane are the first fault.
    fn model(faults: impl Fn([f64; 3]) -> bool) -> Model {
        let mut state = 7u64;
        let mut noise = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
        };
        let mut atoms = Vec::new();
        for i in 0..12 * 10 * 8 {
            let index = [i % 12, i / 12 % 10, i / 120];
            let mut x = index.map(|c| c as f64 + 0.5 + 0.2 * noise());
            // Cells lean with the plane.
            x[0] = (x[0] - 0.2 * (x[2] - 4.0)).clamp(0.05, 11.95);
            atoms.push(x);
        }
        let mesh = voronoi::voronoi(&atoms, EXTENT).unwrap();
        let mut model = Model::new(mesh, None);
        let offset = |x: [f64; 3]| x[0] + 0.2 * (x[2] - 4.0) - 6.0;
        let site = &model.graph.site;
        let on_fault = model.graph.connections.iter().map(|c| {
            let [a, b] = c.cells.map(|cell| offset(site[cell as usize]));
            u32::from(a * b < 0.0 && faults(c.point))
        });
        model.surfaces.connection_surfaces = on_fault.collect();
        model.surfaces.kinds = vec![SurfaceKind::Fault];
        model.surfaces.kept_count = 1;
        model
    }

    #[test]
    fn a_fault_is_extended_to_the_sides_and_then_seals() {
        // The fault ends in the middle of the box along y, and below its top.
        let mut model = model(|x| x[1] < 5.0 && x[2] < 5.0);
        let whole = self::model(|_| true);
        let crossing = whole.surfaces.connection_surfaces;
        model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
        let cancel = CancelToken::never();
        let check = SealCheck::new(&model, &cancel).unwrap();
        assert!(check.faults[0].passing_share > 0.3, "{check:?}");
        let covered = check.faults[0].covered_share;
        assert!((0.25..0.4).contains(&covered), "{covered}");
        assert_eq!(check.compartments.len(), 1);

        let extended = model.extend_faults(100.0);
        let [fault] = &extended[..] else {
            panic!("{extended:?}");
        };
        assert_eq!(
            (&*fault.name, &*fault.extension),
            ("fault1", "fault1_extension")
        );
        // The plane through the box, less the fault.
        let area = 80.0 * 1.04f64.sqrt();
        let total = fault.area + fault.extension_area;
        assert!((total / area - 1.0).abs() < 0.1, "{total} {area}");
        let labels = &model.surfaces.connection_surfaces;
        let differing = labels.iter().zip(&crossing);
        let differing = differing.filter(|(a, b)| (**a != 0) != (**b != 0)).count();
        assert!(differing < 30, "{differing}");
        model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
        let check = SealCheck::new(&model, &cancel).unwrap();
        assert_eq!(check.faults.len(), 1, "{check:?}");
        assert!(check.faults[0].passing_share < 1e-9, "{check:?}");
        assert_eq!(check.faults[0].covered_share, 1.0);
        assert_eq!(check.compartments.len(), 2);
    }

    #[test]
    fn an_extension_ends_at_its_distance_and_at_the_next_fault() {
        let mut near = model(|x| x[1] < 3.0);
        let extended = near.extend_faults(2.0);
        let sqrt = 1.04f64.sqrt();
        let expected = 2.0 * 8.0 * sqrt;
        assert!(
            (extended[0].extension_area / expected - 1.0).abs() < 0.3,
            "{extended:?}"
        );
        // Another fault across the box, y = 5.
        let mut between = model(|x| x[1] < 3.0);
        let sites = between.graph.site.clone();
        let pairs = between.graph.connections.iter();
        let labels = between.surfaces.connection_surfaces.clone();
        let labels = pairs.zip(labels).map(|(c, label)| {
            let [a, b] = c.cells.map(|cell| sites[cell as usize][1] - 5.0);
            if a * b < 0.0 { 2 } else { label }
        });
        between.surfaces.connection_surfaces = labels.collect();
        between.surfaces.kinds = vec![SurfaceKind::Fault; 2];
        between.surfaces.kept_count = 2;
        let extended = between.extend_faults(100.0);
        assert_eq!(extended.len(), 1, "{extended:?}");
        let expected = 2.0 * 8.0 * sqrt;
        assert!(
            (extended[0].extension_area / expected - 1.0).abs() < 0.2,
            "{extended:?}"
        );
    }
}
