//! Finds the leaks of a closed fault: the open faces by which the surface of the fault would go on
//! through its holes, and beyond its edges to a side or a fault nearby.
//!
//! The continuation of the fault divides the cells near it into those on its one and its other side.
//! Its open faces form connected parts. A part that the fault surrounds is a hole. Another part
//! reaches sides of the mesh or other faults: where the way from there back to the fault is short, it
//! is a gap. The rest is where fluid flows around a tip, which is no leak of the fault.

use std::collections::BTreeMap;

use super::network::{End, SealNetwork};
use crate::geometry::cell_list::CellList;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, dot, norm, sub};
use crate::mesh::graph::Graph;
use crate::model::surface::fault_extension::{Continuation, ContinuationFace, Continuations};

/// Widest gap between the edge of a fault and what it ends near, in distances between nodes. A
/// wider one is a free end of the fault.
const MAX_GAP: f64 = 4.0;
/// Largest distance between neighbouring faces of a leak, in distances between nodes.
const NEIGHBOUR_DISTANCE: f64 = 1.6;
/// Longest distance from a rim to the fault across a gap, over the shortest one.
const MAX_OBLIQUE_RATIO: f64 = 1.5;
/// Distance within which a line meets a fault, in distances between nodes.
const HIT_DISTANCE: f64 = 0.75;
/// Distance along a rim over which it is decided whether there is a gap, in distances between nodes.
const RIM_RADIUS: f64 = 2.5;
/// Largest area of the corner of a gap, or of the ragged end of a tip, over that of what it belongs to.
const MAX_CORNER_SHARE: f64 = 0.25;
/// Smallest part of an outward direction in the fault. Below it, the fault runs along what it ends at.
const MIN_TANGENT: f64 = 0.2;
/// Smallest share of the rim nearby from which the fault is near, in a gap.
const MIN_GAP_SHARE: f64 = 0.6;

/// Largest number of distances that are tried to close a leak, each larger than the one before by this factor.
const MAX_TRIALS: usize = 8;
const TRIAL_FACTOR: f64 = 1.4;

/// The reason of a leak.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Cause {
    /// Faces are missing inside the fault.
    Hole,
    /// The fault ends near something.
    Gap(End),
    /// The connection crosses the fault, but lets fluid pass.
    LostConnection,
}

/// The faces of a leak.
#[derive(Debug, Clone)]
pub(super) struct LeakFaces {
    pub cause: Cause,
    /// Indices of the connections, and 1 or -1 as they lead from the lower to the upper side of the fault
    /// or back.
    pub connections: Vec<(usize, f64)>,
    /// Area in m^2, projected onto the fault.
    pub area: f64,
    /// Centre in metres.
    pub centre: [f64; 3],
    /// Distance in metres between the fault and the farthest cell at the leak.
    pub farthest: f64,
}

/// A fault and its continuation.
pub(super) struct FaultLeaks {
    pub leaks: Vec<LeakFaces>,
    /// The side of each cell near the fault and its continuation: -1, 1, or 0 for other cells.
    pub sides: Vec<i8>,
    /// Area of the fault's faces in m^2.
    pub area: f64,
    /// Area in m^2 by which the fault would reach other faults and the sides of the mesh.
    pub missing_area: f64,
}

/// A point at which the continuation of a fault ends.
struct RimPoint {
    point: [f64; 3],
    end: End,
    /// The distance to the fault, if the fault is near, seen from here.
    width: Option<f64>,
}

/// Finds the leaks of faults.
pub(super) struct LeakFinder<'a> {
    network: &'a SealNetwork,
    /// The cells, stretched along z so that they are about as high as wide.
    stretched: &'a Graph<3>,
    ratio: f64,
    labels: Vec<u32>,
    is_barrier: Vec<bool>,
    continuations: Continuations<'a, 3>,
    /// Boundary faces of each cell that has any.
    boundary: BTreeMap<u32, Vec<usize>>,
}

impl<'a> LeakFinder<'a> {
    /// Creates a finder. `stretched` is the graph of the network with z multiplied by `ratio`.
    pub fn new(network: &'a SealNetwork, stretched: &'a Graph<3>, ratio: f64) -> Self {
        let (labels, is_barrier) = network.walk_labels();
        let mut boundary: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (index, face) in stretched.boundary.iter().enumerate() {
            boundary.entry(face.cell).or_default().push(index);
        }
        Self {
            network,
            stretched,
            ratio,
            labels,
            is_barrier,
            continuations: Continuations::new(stretched),
            boundary,
        }
    }

    /// Returns `true` if a connection is on a surface to which continuations go.
    pub fn is_barrier(&self, connection: usize) -> bool {
        self.is_barrier[self.labels[connection] as usize]
    }

    /// Returns the connections of a cell.
    pub fn connections_at(&self, cell: u32) -> &[u32] {
        self.continuations.connections_at(cell)
    }

    /// Returns the leaks of a fault, or `None` if it has no faces.
    pub fn leaks(&self, fault: u32) -> Option<FaultLeaks> {
        let (labels, is_barrier) = (&self.labels, &self.is_barrier);
        let continuations = &self.continuations;
        let mut continuation = continuations.of_fault(labels, is_barrier, fault, f64::INFINITY)?;
        let is_open = |connection: usize| !self.network.is_closed[connection];
        continuation.faces.retain(|face| is_open(face.connection));
        let mut leaks = self.missing_faces(&continuation, fault);
        let graph = &self.network.graph;
        let on_fault = (0..labels.len()).filter(|index| labels[*index] == fault);
        let lost: Vec<usize> = on_fault.clone().filter(|index| is_open(*index)).collect();
        leaks.extend(self.lost_connections(&lost, &continuation, fault));
        let missing = continuation.faces.iter();
        Some(FaultLeaks {
            leaks,
            area: on_fault.map(|index| graph.connections[index].area).sum(),
            missing_area: missing
                .map(|face| self.area(face.connection, face.normal))
                .sum(),
            sides: continuation.sides,
        })
    }

    /// Returns the distance in metres, rounded up, by which a fault must be extended to close a leak.
    pub fn closing_distance(&self, fault: u32, leak: &LeakFaces) -> f64 {
        // Faults are extended in space as it is, where some faces of the continuation may be others.
        let continuations = Continuations::new(&self.network.graph);
        let connections = |distance: f64| -> Vec<usize> {
            let (labels, is_barrier) = (&self.labels, &self.is_barrier);
            let next = continuations.of_fault(labels, is_barrier, fault, distance);
            let faces = next.map_or_else(Vec::new, |next| next.faces);
            faces.iter().map(|face| face.connection).collect()
        };
        // Connections are in ascending order.
        let all = connections(f64::INFINITY);
        let leaking = leak.connections.iter().map(|(index, _)| *index);
        let needed: Vec<usize> = leaking
            .filter(|index| all.binary_search(index).is_ok())
            .collect();
        let closes = |distance: f64| {
            let closed = connections(distance);
            needed
                .iter()
                .all(|index| closed.binary_search(index).is_ok())
        };
        let mut distance = rounded_up(leak.farthest);
        for _ in 1..MAX_TRIALS {
            if closes(distance) {
                break;
            }
            distance = rounded_up(TRIAL_FACTOR * distance);
        }
        distance
    }

    /// Returns the area of a connection in m^2, projected onto the fault with this normal in
    /// stretched space.
    fn area(&self, connection: usize, [x, y, z]: [f64; 3]) -> f64 {
        let normal = [x, y, self.ratio * z];
        let c = &self.network.graph.connections[connection];
        c.area * dot(c.normal, normal).abs() / norm(normal)
    }

    fn spacing_at(&self, connection: usize) -> f64 {
        let cells = self.stretched.connections[connection].cells;
        let [a, b] = cells.map(|cell| self.network.spacing(self.stretched, cell));
        a.max(b)
    }

    fn point(&self, connection: usize) -> [f64; 3] {
        self.stretched.connections[connection].point
    }

    /// Returns the holes and gaps among the open faces of a continuation.
    fn missing_faces(&self, continuation: &Continuation<3>, fault: u32) -> Vec<LeakFaces> {
        let faces = &continuation.faces;
        if faces.is_empty() {
            return Vec::new();
        }
        let rim = self.rim(continuation, fault);
        let has_rim: Vec<bool> = faces
            .iter()
            .map(|face| {
                let cells = self.stretched.connections[face.connection].cells;
                cells.iter().any(|cell| !self.ends(*cell, fault).is_empty())
            })
            .collect();
        let mut causes = vec![None; faces.len()];
        for part in self.parts(faces, |_| Some(())) {
            if part.iter().any(|index| has_rim[*index]) {
                part.iter()
                    .for_each(|&index| causes[index] = self.gap(&faces[index], &rim));
            } else {
                part.iter()
                    .for_each(|&index| causes[index] = Some(Cause::Hole));
            }
        }
        let mut parts = self.joined_parts(faces, &mut causes);
        self.remove_ragged_tips(faces, &causes, &mut parts);
        parts
            .into_iter()
            .map(|part| {
                let cause = causes[part[0]].unwrap_or(Cause::Hole);
                let faces: Vec<_> = part.iter().map(|index| &faces[*index]).collect();
                self.leak(cause, &faces, continuation, fault)
            })
            .collect()
    }

    /// Returns the connected parts of the faces with causes, one cause for each. A part at the corner of a gap,
    /// where the gap meets other sides, belongs to the gap.
    fn joined_parts(
        &self,
        faces: &[ContinuationFace<3>],
        causes: &mut [Option<Cause>],
    ) -> Vec<Vec<usize>> {
        let area = |part: &[usize]| self.total_area(faces, part);
        for connected in self.parts(faces, |index| causes[index].map(|_| ())) {
            let mut by_cause: BTreeMap<Cause, Vec<usize>> = BTreeMap::new();
            for index in connected {
                if let Some(cause) = causes[index] {
                    by_cause.entry(cause).or_default().push(index);
                }
            }
            let areas = by_cause.iter().map(|(cause, part)| (*cause, area(part)));
            let largest = areas.max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((main, main_area)) = largest else {
                continue;
            };
            for part in by_cause
                .values()
                .filter(|part| area(part) < MAX_CORNER_SHARE * main_area)
            {
                part.iter().for_each(|index| causes[*index] = Some(main));
            }
        }
        self.parts(faces, |index| causes[index])
    }

    /// Returns the area of some of the faces in m^2, projected onto the fault.
    fn total_area(&self, faces: &[ContinuationFace<3>], part: &[usize]) -> f64 {
        let faces = part.iter().map(|index| &faces[*index]);
        let areas = faces.map(|face| self.area(face.connection, face.normal));
        areas.sum()
    }

    /// Removes the gaps that are no longer along the rim than [`RIM_RADIUS`] and are parts of a much larger free end
    /// of the fault. The edge of a tip is ragged, so that single faces of it may be near a side.
    fn remove_ragged_tips(
        &self,
        faces: &[ContinuationFace<3>],
        causes: &[Option<Cause>],
        parts: &mut Vec<Vec<usize>>,
    ) {
        // The area of the free end to which each face belongs.
        let mut free_areas = vec![0.0; faces.len()];
        for connected in self.parts(faces, |_| Some(())) {
            let free = connected.iter().copied();
            let free: Vec<usize> = free.filter(|index| causes[*index].is_none()).collect();
            let area = self.total_area(faces, &free);
            connected.iter().for_each(|&index| free_areas[index] = area);
        }
        parts.retain(|part| {
            let points = || {
                part.iter()
                    .map(|index| self.point(faces[*index].connection))
            };
            let radius = RIM_RADIUS * self.spacing_at(faces[part[0]].connection);
            let is_short = points().all(|a| points().all(|b| norm(sub(a, b)) <= radius));
            let free_area = free_areas[part[0]];
            !is_short || self.total_area(faces, part) >= MAX_CORNER_SHARE * free_area
        });
    }

    /// Returns the connected parts of the faces for which `group` is not `None`, among faces of equal
    /// groups.
    fn parts<G: PartialEq>(
        &self,
        faces: &[ContinuationFace<3>],
        group: impl Fn(usize) -> Option<G>,
    ) -> Vec<Vec<usize>> {
        let points: Vec<[f64; 3]> = faces.iter().map(|f| self.point(f.connection)).collect();
        let radii: Vec<f64> = (faces.iter())
            .map(|face| NEIGHBOUR_DISTANCE * self.spacing_at(face.connection))
            .collect();
        let mean_radius = radii.iter().sum::<f64>() / radii.len() as f64;
        let list = CellList::new(&points, mean_radius);
        let mut sets = UnionFind::new(faces.len());
        for (index, radius) in radii.iter().enumerate() {
            let own = group(index);
            list.visit_within(points[index], *radius, |other| {
                let is_near = norm(sub(points[other], points[index])) <= *radius;
                if is_near && own.is_some() && group(other) == own {
                    sets.unite(index as u32, other as u32);
                }
            });
        }
        let mut parts: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for index in (0..faces.len()).filter(|index| group(*index).is_some()) {
            parts
                .entry(sets.find(index as u32))
                .or_default()
                .push(index);
        }
        parts.into_values().collect()
    }

    /// Returns what a cell at a face of the continuation touches: the directions out of the cell, and what
    /// is there.
    fn ends(&self, cell: u32, fault: u32) -> Vec<([f64; 3], End)> {
        let graph = self.stretched;
        let mut ends = Vec::new();
        for &index in self.boundary.get(&cell).into_iter().flatten() {
            let boundary = &graph.boundary[index];
            let end = boundary.side.map_or(End::Boundary, End::Side);
            ends.push((boundary.normal, end));
        }
        for &index in self.continuations.connections_at(cell) {
            let other = self.labels[index as usize];
            if other != fault && self.is_barrier[other as usize] {
                let c = &graph.connections[index as usize];
                let sign = if c.cells[0] == cell { 1.0 } else { -1.0 };
                let normal = c.normal.map(|n| sign * n);
                ends.push((normal, self.network.end_at(other)));
            }
        }
        ends
    }

    /// Returns the points at which the open faces of a continuation end, and from which the fault is near.
    fn rim(&self, continuation: &Continuation<3>, fault: u32) -> Vec<RimPoint> {
        let mut rim = Vec::new();
        let mut radii = Vec::new();
        for face in &continuation.faces {
            let c = &self.stretched.connections[face.connection];
            let spacing = self.spacing_at(face.connection);
            for cell in c.cells {
                for (normal, end) in self.ends(cell, fault) {
                    // Directions in the surface.
                    let along = add_scaled(normal, -dot(normal, face.normal), face.normal);
                    let length = norm(along);
                    if length < MIN_TANGENT {
                        continue;
                    }
                    let inwards = along.map(|c| -c / length);
                    // Where the edge of the fault and what it ends at meet at a large angle, there is no
                    // gap: the fault is much nearer in another direction.
                    let tolerance = HIT_DISTANCE * spacing;
                    let longest =
                        MAX_OBLIQUE_RATIO * continuation.fault_distance(c.point) + tolerance;
                    // Faces at the end are half a distance from it.
                    let longest = longest.min((MAX_GAP - 0.5) * spacing);
                    let distances = (0..).map(|step| 0.5 * f64::from(step) * spacing);
                    let mut distances = distances.take_while(|distance| *distance <= longest);
                    let width = distances.find(|distance| {
                        let position = add_scaled(c.point, *distance, inwards);
                        continuation.fault_distance(position) <= tolerance
                    });
                    rim.push(RimPoint {
                        point: c.point,
                        end,
                        width,
                    });
                    radii.push(RIM_RADIUS * spacing);
                }
            }
        }
        if rim.is_empty() {
            return rim;
        }
        let points: Vec<[f64; 3]> = rim.iter().map(|r| r.point).collect();
        let mean_radius = radii.iter().sum::<f64>() / radii.len() as f64;
        let list = CellList::new(&points, mean_radius);
        let is_gap: Vec<bool> = (0..rim.len())
            .map(|index| {
                let (mut near, mut gaps) = (0usize, 0usize);
                list.visit_within(points[index], radii[index], |other| {
                    let is_near = norm(sub(points[other], points[index])) <= radii[index];
                    if is_near && rim[other].end == rim[index].end {
                        near += 1;
                        gaps += usize::from(rim[other].width.is_some());
                    }
                });
                gaps as f64 >= MIN_GAP_SHARE * near as f64
            })
            .collect();
        let mut is_gap = is_gap.into_iter();
        rim.retain(|r| is_gap.next() == Some(true) && r.width.is_some());
        rim
    }

    /// Returns the gap to which a face belongs, if it belongs to one.
    fn gap(&self, face: &ContinuationFace<3>, rim: &[RimPoint]) -> Option<Cause> {
        let x = self.point(face.connection);
        let distances = rim.iter().map(|r| (norm(sub(r.point, x)), r));
        let (distance, nearest) = distances.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let width = nearest.width? + 2.0 * self.spacing_at(face.connection);
        (face.fault_distance + distance <= width).then_some(Cause::Gap(nearest.end))
    }

    /// Returns the leaks of connections that lie on a fault but are open.
    fn lost_connections(
        &self,
        lost: &[usize],
        continuation: &Continuation<3>,
        fault: u32,
    ) -> Vec<LeakFaces> {
        let faces: Vec<ContinuationFace<3>> = (lost.iter())
            .map(|&connection| ContinuationFace {
                connection,
                normal: self.stretched.connections[connection].normal,
                fault_distance: 0.0,
            })
            .collect();
        if faces.is_empty() {
            return Vec::new();
        }
        let parts = self.parts(&faces, |_| Some(()));
        parts
            .iter()
            .map(|part| {
                let faces: Vec<_> = part.iter().map(|index| &faces[*index]).collect();
                self.leak(Cause::LostConnection, &faces, continuation, fault)
            })
            .collect()
    }

    fn leak(
        &self,
        cause: Cause,
        faces: &[&ContinuationFace<3>],
        continuation: &Continuation<3>,
        fault: u32,
    ) -> LeakFaces {
        let graph = &self.network.graph;
        let on_fault = graph.connections.iter().zip(&self.labels);
        let on_fault: Vec<[f64; 3]> = on_fault
            .filter(|(_, label)| **label == fault)
            .map(|(c, _)| c.point)
            .collect();
        let fault_distance = |cell: u32| {
            let site = graph.site[cell as usize];
            let distances = on_fault.iter().map(|point| norm(sub(*point, site)));
            distances.fold(f64::INFINITY, f64::min)
        };
        let areas = faces
            .iter()
            .map(|face| self.area(face.connection, face.normal));
        let areas: Vec<f64> = areas.collect();
        let points = faces
            .iter()
            .map(|face| graph.connections[face.connection].point);
        let connections = faces.iter().map(|face| {
            let [a, b] = graph.connections[face.connection].cells;
            let [a, b] = [a, b].map(|cell| f64::from(continuation.sides[cell as usize]));
            (face.connection, (b - a).signum())
        });
        let cells = faces
            .iter()
            .flat_map(|face| graph.connections[face.connection].cells);
        let distances = cells.map(fault_distance);
        LeakFaces {
            cause,
            connections: connections.collect(),
            area: areas.iter().sum(),
            centre: SealNetwork::mean_position(areas.iter().copied().zip(points)),
            farthest: distances.fold(0.0, f64::max),
        }
    }
}

/// Returns a positive distance rounded up to two digits.
fn rounded_up(distance: f64) -> f64 {
    let exponent = distance.max(f64::MIN_POSITIVE).log10().floor() as i32 - 1;
    // A power of ten with a negative exponent is not exact, so that its inverse is used.
    let digits = if exponent < 0 {
        (distance * 10f64.powi(-exponent)).floor() + 1.0
    } else {
        (distance / 10f64.powi(exponent)).floor() + 1.0
    };
    if exponent < 0 {
        digits / 10f64.powi(-exponent)
    } else {
        digits * 10f64.powi(exponent)
    }
}
