//! Notes on wells at closed faults: wells that closed faults separate from all others, and wells
//! that cross a closed fault or run along one.

use super::trajectory::{Trajectory, WellSegment, WellTracer};
use super::{Control, Model, Well};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, dot, norm, sub};

/// A well lies on a face if its distance from the face is below this fraction of the distance
/// between the sites on the two sides.
const MAX_FACE_DISTANCE_RATIO: f64 = 0.05;

impl Model {
    /// Returns `true` if fluid can flow through a connection.
    fn is_open(&self, connection: usize) -> bool {
        match &self.permeability {
            Some(permeability) => permeability.transmissibility[connection] > 0.0,
            None => self.fault_factor(connection) > 0.0,
        }
    }

    /// Returns the compartment of each cell: the smallest number of a cell that is connected with
    /// it.
    fn compartments(&self) -> Vec<u32> {
        let mut sets = UnionFind::new(self.len());
        for (index, c) in self.graph.connections.iter().enumerate() {
            if self.is_open(index) {
                sets.unite(c.cells[0], c.cells[1]);
            }
        }
        (0..self.len() as u32).map(|cell| sets.find(cell)).collect()
    }

    /// Returns a note for each well that no injector (or no producer) can reach although the model
    /// has some, and for each well that crosses a closed fault or runs along one.
    pub fn notes_on_wells(&self) -> Vec<String> {
        let wells = &self.case.wells;
        if wells.is_empty() || (0..self.graph.connections.len()).all(|index| self.is_open(index)) {
            return Vec::new();
        }
        let compartments = self.compartments();
        let mut notes = self.notes_on_separated_wells(&compartments);
        let tracer = WellTracer::new(self);
        for well in wells {
            notes.extend(self.crossed_fault(well, &tracer, &compartments));
            notes.extend(self.fault_along_well(well, &tracer));
        }
        notes
    }

    fn notes_on_separated_wells(&self, compartments: &[u32]) -> Vec<String> {
        let wells = &self.case.wells;
        let injects = |well: &Well| matches!(well.control, Control::Inject(_));
        let share_compartment = |a: &Well, b: &Well| {
            let compartments_of = |well: &'_ Well| -> Vec<u32> {
                let cells = well.cells.iter();
                cells.map(|c| compartments[c.0 as usize]).collect()
            };
            let second = compartments_of(b);
            compartments_of(a)
                .iter()
                .any(|compartment| second.contains(compartment))
        };
        let mut separated = Vec::new();
        for well in wells.iter().filter(|well| injects(well)) {
            let producers: Vec<&Well> = wells.iter().filter(|other| !injects(other)).collect();
            if !producers.is_empty()
                && !producers.iter().any(|other| share_compartment(well, other))
            {
                separated.push(well);
            }
        }
        let line = |well: &Well, kind: &str, others: &str| {
            let compartment = well.cells.first().map_or(0, |c| compartments[c.0 as usize]);
            let cells = compartments.iter().filter(|c| **c == compartment).count();
            format!(
                "{kind} {}: closed faults separate its compartment, of {cells} cells, from every {others}",
                well.name
            )
        };
        let injectors: Vec<&Well> = wells.iter().filter(|well| injects(well)).collect();
        let mut notes: Vec<String> = (separated.iter())
            .map(|well| line(well, "injector", "producer"))
            .collect();
        // If no injector reaches any producer, the notes on injectors say so already.
        if separated.len() < injectors.len() {
            let is_unreached = |well: &&Well| {
                !injects(well)
                    && !injectors
                        .iter()
                        .any(|injector| share_compartment(well, injector))
            };
            let unreached = wells.iter().filter(is_unreached);
            notes.extend(unreached.map(|well| line(well, "producer", "injector")));
        }
        notes
    }

    /// Returns the trajectory of a well and its segments. A well that is open to a single cell at
    /// one point has no segments.
    fn well_segments(well: &Well, tracer: &WellTracer) -> (Trajectory, Vec<WellSegment>) {
        let trajectory = Trajectory {
            name: well.name.clone(),
            points: well.path.clone(),
            radii: vec![well.radius; well.path.len()],
        };
        let segments = match trajectory.leg_count() {
            0 => Vec::new(),
            _ => tracer.segments(&trajectory),
        };
        (trajectory, segments)
    }

    /// Returns the name of the closed fault between two cells, if there is one.
    fn closed_fault_between(&self, cells: [u32; 2]) -> Option<String> {
        let sorted = [cells[0].min(cells[1]), cells[0].max(cells[1])];
        let mut connections = self.graph.connections.iter().enumerate();
        let (index, _) = connections.find(|(_, c)| {
            let [a, b] = c.cells;
            [a.min(b), a.max(b)] == sorted
        })?;
        self.closed_fault_name(index)
    }

    /// Returns the name of the closed fault on which a connection lies, if it lies on one.
    fn closed_fault_name(&self, connection: usize) -> Option<String> {
        let label = self.barriers.label(connection)?;
        let is_closed = self.barriers.law(label).multiplier() == 0.0;
        let names = self.surfaces.all_names().names;
        let surface = self.surfaces.connection_surfaces[connection] as usize;
        let name = names.get(surface.checked_sub(1)?).cloned();
        is_closed.then(|| name.unwrap_or_else(|| "fault".into()))
    }

    fn crossed_fault(
        &self,
        well: &Well,
        tracer: &WellTracer,
        compartments: &[u32],
    ) -> Option<String> {
        let (_, segments) = Self::well_segments(well, tracer);
        let pairs = segments.windows(2).map(|pair| [pair[0].cell, pair[1].cell]);
        let is_separated = |pair: &[u32; 2]| {
            compartments[pair[0] as usize] != compartments[pair[1] as usize]
                || self.closed_fault_between(*pair).is_some()
        };
        let crossed_pairs: Vec<[u32; 2]> = pairs
            .filter(|pair| pair[0] != pair[1])
            .filter(is_separated)
            .collect();
        let first = crossed_pairs.first()?;
        let fault_name = crossed_pairs
            .iter()
            .find_map(|pair| self.closed_fault_between(*pair));
        Some(format!(
            "well {}: crosses the closed {} between cells {} and {}, and connects its two sides; give it as two wells if the bore is not open there",
            well.name,
            fault_name.unwrap_or_else(|| "faults".into()),
            first[0],
            first[1]
        ))
    }

    fn fault_along_well(&self, well: &Well, tracer: &WellTracer) -> Option<String> {
        let (trajectory, segments) = Self::well_segments(well, tracer);
        let end_points = |segment: &WellSegment| {
            let (a, d) = trajectory.leg(segment.leg as usize);
            segment.span.map(|fraction| add_scaled(a, fraction, d))
        };
        let cell_spans: Vec<(u32, [[f64; 3]; 2])> = match (&well.path[..], &well.cells[..]) {
            ([point], [(cell, _)]) => vec![(*cell, [*point; 2])],
            _ => segments
                .iter()
                .map(|segment| (segment.cell, end_points(segment)))
                .collect(),
        };
        for (cell, ends) in cell_spans {
            for &face in tracer.faces(cell as usize) {
                let Some(c) = self.graph.connections.get(face as usize) else {
                    continue;
                };
                let tolerance =
                    MAX_FACE_DISTANCE_RATIO * (c.distance[0] + c.distance[1]) + well.radius;
                let is_along = ends.iter().all(|p| {
                    let offset = sub(*p, c.point);
                    dot(offset, c.normal).abs() <= tolerance
                        && norm(offset) <= c.area.sqrt() + tolerance
                });
                if is_along && let Some(name) = self.closed_fault_name(face as usize) {
                    return Some(format!(
                        "well {}: lies on the closed {name}, and is open to one side of it only, in cell {cell}",
                        well.name
                    ));
                }
            }
        }
        None
    }
}
