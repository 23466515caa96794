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
use crate::geometry::eigen::{eigenvalues, eigenvector};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, bounding_box, dot, norm, sub, unit};
use crate::mesh::graph::{Connection, Graph};
use crate::model::surface::SurfaceKind;

/// Largest distance of a cell from the continuation of a fault, in units of the cube root of its volume.
const BAND_WIDTH: f64 = 2.5;

/// Smallest radius of the part of a fault to which a plane is fitted, in units of the cube root of the
/// mean volume of cells at the fault. The radius is at least the distance of the continuation from the
/// fault: the farther a plane reaches, the more must it rest on.
const MIN_FIT_RADIUS: f64 = 4.0;

/// Smallest cosine between the normal of a fault and the lines through the faces of a cell, weighted by
/// area, from which these faces tell the side of the cell.
const MIN_COSINE: f64 = 0.25;

/// Largest ratio of the smallest to the second variance of positions on a fault that lie in a plane.
const MAX_FLAT_RATIO: f64 = 0.5;

/// Largest number of sweeps that correct the sides of cells at a fault. A few cells need one or two.
const MAX_SWEEPS: usize = 8;

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
    let mut is_barrier: Vec<bool> = vec![false];
    is_barrier.extend(kinds.iter().map(|kind| *kind != SurfaceKind::Horizon));
    let continuations = Continuations::new(graph);
    let mut found = Vec::new();
    for &surface in faults {
        let next = continuations.of_fault(&labels, &is_barrier, surface, max_distance);
        let Some(continuation) = next.filter(|next| !next.faces.is_empty()) else {
            continue;
        };
        let mut extension = Extension {
            surface,
            fault_area: continuation.fault_area,
            connections: Vec::new(),
            area: 0.0,
        };
        for face in &continuation.faces {
            let c = &graph.connections[face.connection];
            labels[face.connection] = surface;
            extension.connections.push(face.connection);
            extension.area += c.area * dot(c.normal, face.normal).abs();
        }
        found.push(extension);
    }
    found
}

/// A face by which a fault continues, through a hole or beyond its edges.
pub(crate) struct ContinuationFace<const D: usize> {
    /// The connection.
    pub connection: usize,
    /// Unit normal of the plane that fits the nearest part of the fault.
    pub normal: [f64; D],
    /// Distance of the face from the nearest face of the fault.
    pub fault_distance: f64,
}

/// The continuation of a fault.
pub(crate) struct Continuation<const D: usize> {
    /// Area of the fault.
    pub fault_area: f64,
    /// The side of each cell: -1 or 1 for cells near the fault or its continuation, 0 for others.
    pub sides: Vec<i8>,
    /// The faces between the two sides that are on no barrier.
    pub faces: Vec<ContinuationFace<D>>,
    sheet: FaultSheet<D>,
}

impl<const D: usize> Continuation<D> {
    /// Returns the distance of a position from the centre of the nearest face of the fault.
    pub fn fault_distance(&self, x: [f64; D]) -> f64 {
        self.sheet.distance(x)
    }
}

/// Finds the continuations of faults of a graph.
pub(crate) struct Continuations<'a, const D: usize> {
    graph: &'a Graph<D>,
    cell_connections: CellConnections,
}

impl<'a, const D: usize> Continuations<'a, D> {
    pub fn new(graph: &'a Graph<D>) -> Self {
        Self {
            graph,
            cell_connections: CellConnections::new(graph),
        }
    }

    /// Returns the connections of a cell.
    pub fn connections_at(&self, cell: u32) -> &[u32] {
        self.cell_connections.connections_at(cell)
    }

    /// Returns the continuation of a fault, or `None` if no connection has its number. `labels` has
    /// the number of the surface of each connection, 0 for none. A continuation ends at
    /// surfaces for which `is_barrier`, by number, is `true`, and at `max_distance` from the fault.
    pub fn of_fault(
        &self,
        labels: &[u32],
        is_barrier: &[bool],
        surface: u32,
        max_distance: f64,
    ) -> Option<Continuation<D>> {
        let sheet = FaultSheet::new(self.graph, labels, surface)?;
        let spread = Spread {
            graph: self.graph,
            cell_connections: &self.cell_connections,
            labels,
            is_barrier,
            surface,
        };
        let sides = sheet.sides(&spread, max_distance);
        let mut faces = Vec::new();
        for (connection, c) in self.graph.connections.iter().enumerate() {
            let [a, b] = c.cells.map(|cell| sides[cell as usize]);
            if i16::from(a) * i16::from(b) >= 0 || !spread.is_open(connection) {
                continue;
            }
            let plane = sheet.plane_at(c.point);
            faces.push(ContinuationFace {
                connection,
                normal: plane.normal,
                fault_distance: plane.distance,
            });
        }
        Some(Continuation {
            fault_area: sheet.faces.iter().map(|face| face.2).sum(),
            sides,
            faces,
            sheet,
        })
    }
}

/// The connections through which the division of cells into two sides spreads.
struct Spread<'a, const D: usize> {
    graph: &'a Graph<D>,
    cell_connections: &'a CellConnections,
    labels: &'a [u32],
    is_barrier: &'a [bool],
    surface: u32,
}

impl<const D: usize> Spread<'_, D> {
    /// Returns `true` if a connection lies neither on the fault nor on a barrier.
    fn is_open(&self, connection: usize) -> bool {
        let label = self.labels[connection];
        label == 0 || label != self.surface && !self.is_barrier[label as usize]
    }

    /// Returns the cells beside a cell beyond its open connections, with these connections.
    fn neighbours(&self, cell: u32) -> impl Iterator<Item = (u32, usize)> + '_ {
        let connections = self.cell_connections.connections_at(cell).iter();
        let open = connections.filter(|index| self.is_open(**index as usize));
        open.map(move |&index| {
            let [a, b] = self.graph.connections[index as usize].cells;
            (if a == cell { b } else { a }, index as usize)
        })
    }
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
    /// Centre, normal and area of each face. The normals point to the same side of the fault.
    faces: Vec<([f64; D], [f64; D], f64)>,
    positions: Vec<[f64; D]>,
    /// Cosine between the line across each face, from its first to its second cell, and the normal of the
    /// part of the fault nearby.
    cosines: Vec<f64>,
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
        // The line between two sites leads from one side of the fault to the other, also where faces
        // are rough and their normals are not.
        let line = |c: &Connection<D>| {
            let [a, b] = c.cells.map(|cell| graph.site[cell as usize]);
            sub(b, a)
        };
        let sign = |c: &Connection<D>, mean: [f64; D]| {
            if dot(line(c), mean) < 0.0 { -1.0 } else { 1.0 }
        };
        let volumes = on_fault.iter().flat_map(|c| c.cells);
        let volume: f64 = volumes.map(|cell| graph.volume[cell as usize]).sum();
        let mean_size = cell_size::<D>(volume / (2 * on_fault.len()) as f64);
        let min_radius = MIN_FIT_RADIUS * mean_size;
        let positions: Vec<[f64; D]> = on_fault.iter().map(|c| c.point).collect();
        let points = CellList::new(&positions, 2.0 * mean_size);
        // The positions of faces tell which way each face of a staircase points, and its normal does not.
        let mut mean = flat_normal(positions.iter().copied()).unwrap_or_else(|| line(first));
        for _ in 0..2 {
            mean = on_fault.iter().fold([0.0; D], |sum, c| {
                add_scaled(sum, sign(c, mean) * c.area, c.normal)
            });
        }
        let normal_at = |x: [f64; D]| {
            let mut nearby = Vec::new();
            points.visit_within(x, min_radius, |i| nearby.push(positions[i]));
            let normal = flat_normal(nearby.into_iter()).unwrap_or(mean);
            if dot(normal, mean) < 0.0 {
                normal.map(|n| -n)
            } else {
                normal
            }
        };
        let normals: Vec<[f64; D]> = positions.iter().map(|x| normal_at(*x)).collect();
        let pairs = on_fault.iter().zip(&normals);
        let cosines = pairs.map(|(c, normal)| dot(unit(line(c)), unit(*normal)));
        let cosines: Vec<f64> = cosines.collect();
        let faces = on_fault.iter().zip(&normals).map(|(c, normal)| {
            let sign = sign(c, *normal);
            (c.point, c.normal.map(|n| sign * n), c.area)
        });
        let faces: Vec<_> = faces.collect();
        let [low, high] = bounding_box(positions.iter().copied());
        Some(Self {
            surface,
            points,
            faces,
            positions,
            cosines,
            min_radius,
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

    /// Returns the side of a position relative to the plane that fits the nearest part of the fault.
    fn side_of_plane(&self, x: [f64; D]) -> i8 {
        let plane = self.plane_at(x);
        if dot(sub(x, plane.point), plane.normal) < 0.0 {
            -1
        } else {
            1
        }
    }

    /// Returns the side of each cell: -1 or 1 for cells near the fault or its continuation, 0 for others.
    fn sides(&self, spread: &Spread<'_, D>, max_distance: f64) -> Vec<i8> {
        let graph = spread.graph;
        let cells = graph.volume.len();
        let mut sides = vec![0i8; cells];
        // Area of the faces of each cell on the fault, and this times the cosine of the line across.
        let mut sums = vec![[0.0f64; 2]; cells];
        let mut front = VecDeque::new();
        let on_fault = graph.connections.iter().zip(spread.labels);
        let on_fault = on_fault.filter(|(_, label)| **label == self.surface);
        for ((c, _), along) in on_fault.zip(&self.cosines) {
            for (cell, sign) in c.cells.into_iter().zip([-1.0, 1.0]) {
                let [area, across] = &mut sums[cell as usize];
                *area += c.area;
                *across += sign * along * c.area;
            }
            front.extend(c.cells);
        }
        // The side of a cell whose faces run across the fault follows from its neighbours.
        let is_certain = |[area, across]: [f64; 2]| across.abs() > MIN_COSINE * area;
        let touches: Vec<bool> = sums.iter().map(|sum| is_certain(*sum)).collect();
        let mut is_tested = vec![false; cells];
        for &cell in &front {
            let cell = cell as usize;
            is_tested[cell] = true;
            sides[cell] = if touches[cell] {
                if sums[cell][1] < 0.0 { -1 } else { 1 }
            } else {
                self.side_of_plane(graph.site[cell])
            };
        }
        while let Some(cell) = front.pop_front() {
            for (other, _) in spread.neighbours(cell) {
                if std::mem::replace(&mut is_tested[other as usize], true) {
                    continue;
                }
                let site = graph.site[other as usize];
                let plane = self.plane_at(site);
                let offset = dot(sub(site, plane.point), plane.normal);
                let band = BAND_WIDTH * cell_size::<D>(graph.volume[other as usize]);
                if plane.distance <= max_distance && offset.abs() <= band {
                    sides[other as usize] = if offset < 0.0 { -1 } else { 1 };
                    front.push_back(other);
                }
            }
        }
        correct_sides(spread, &mut sides, sums.iter().map(|[area, _]| *area > 0.0));
        flip_islands(spread, &mut sides, &touches);
        sides
    }
}

/// Returns the normal of the plane near which positions lie, up to its sign, or `None` if they lie near none.
fn flat_normal<const D: usize>(
    positions: impl Iterator<Item = [f64; D]> + Clone,
) -> Option<[f64; D]> {
    let (sum, count) = (positions.clone()).fold(([0.0; D], 0.0), |(sum, count), x| {
        (add_scaled(sum, 1.0, x), count + 1.0)
    });
    let centre = sum.map(|c| c / count);
    let mut covariance = [[0.0; D]; D];
    for x in positions {
        let offset = sub(x, centre);
        for (row, c) in covariance.iter_mut().zip(offset) {
            *row = add_scaled(*row, c, offset);
        }
    }
    let values = eigenvalues(&covariance);
    let is_flat = values[0] < MAX_FLAT_RATIO * values[1];
    is_flat.then(|| eigenvector(&covariance, values[0]))
}

/// Gives cells at a fault the side on which the fault passes between them and the other side. A line across a rough
/// face may lead backwards. Such a cell meets its own side beyond the fault, and the other side where
/// there is no fault: on the other side it does so over a smaller area.
fn correct_sides<const D: usize>(
    spread: &Spread<'_, D>,
    sides: &mut [i8],
    is_at_fault: impl Iterator<Item = bool>,
) {
    let numbered = (0u32..).zip(is_at_fault);
    let cells: Vec<u32> = numbered
        .filter_map(|(cell, is_at_fault)| is_at_fault.then_some(cell))
        .collect();
    for _ in 0..MAX_SWEEPS {
        let mut is_corrected = false;
        for &cell in &cells {
            // Area of the faces that contradict the side of the cell, less that of the others.
            let mut excess = 0.0;
            for &index in spread.cell_connections.connections_at(cell) {
                let index = index as usize;
                let is_on_fault = spread.labels[index] == spread.surface;
                if !is_on_fault && !spread.is_open(index) {
                    continue;
                }
                let c = &spread.graph.connections[index];
                let other = c.cells[usize::from(c.cells[0] == cell)];
                let product = sides[cell as usize] * sides[other as usize];
                let agreement = if is_on_fault { -product } else { product };
                excess -= f64::from(agreement) * c.area;
            }
            // Faces of equal areas on both sides leave a cell as it is.
            if excess > 1e-9 * spread.graph.volume[cell as usize].powf((D as f64 - 1.0) / D as f64)
            {
                sides[cell as usize] = -sides[cell as usize];
                is_corrected = true;
            }
        }
        if !is_corrected {
            return;
        }
    }
}

/// Gives cells the other side if no path through cells of their own side leads from them to a cell of which the
/// fault tells the side. They lie across a plane, but not across the fault.
fn flip_islands<const D: usize>(spread: &Spread<'_, D>, sides: &mut [i8], touches: &[bool]) {
    let connections = &spread.graph.connections;
    // An island may lie in an island, but not many times.
    for _ in 0..3 {
        let mut sets = UnionFind::new(sides.len());
        for (index, c) in connections.iter().enumerate() {
            let [a, b] = c.cells.map(|cell| sides[cell as usize]);
            if a != 0 && a == b && spread.is_open(index) {
                sets.unite(c.cells[0], c.cells[1]);
            }
        }
        let mut has_fault = vec![false; sides.len()];
        for cell in (0..sides.len()).filter(|cell| touches[*cell]) {
            has_fault[sets.find(cell as u32) as usize] = true;
        }
        let mut is_flipped = false;
        for cell in 0..sides.len() {
            if sides[cell] != 0 && !has_fault[sets.find(cell as u32) as usize] {
                sides[cell] = -sides[cell];
                is_flipped = true;
            }
        }
        if !is_flipped {
            return;
        }
    }
}
