//! What closed faults do to wells: which wells they part, and which run through them.

use super::trajectory::{Trajectory, WellSegment, WellTracer};
use super::{Control, Model, Well};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, dot, norm, sub};

/// A well that is nearer to a face than this share of the distance between the sites on its two sides lies
/// on the face.
const MAX_FACE_DISTANCE_RATIO: f64 = 0.05;

impl Model {
    /// Whether something flows through a connection.
    fn is_open(&self, connection: usize) -> bool {
        match &self.permeability {
            Some(known) => known.transmissibility[connection] > 0.0,
            None => self.fault_factor(connection) > 0.0,
        }
    }

    /// The compartment of each cell: the least of the cells that it is connected with.
    fn compartments(&self) -> Vec<u32> {
        let mut sets = UnionFind::new(self.len());
        for (at, c) in self.graph.connections.iter().enumerate() {
            if self.is_open(at) {
                sets.unite(c.cells[0], c.cells[1]);
            }
        }
        (0..self.len() as u32).map(|cell| sets.find(cell)).collect()
    }

    /// A line for each well that no injector, or no producer, can reach, though there are some, and for each
    /// that runs through a closed fault or along one.
    pub fn notes_on_wells(&self) -> Vec<String> {
        let wells = &self.case.wells;
        if wells.is_empty() || (0..self.graph.connections.len()).all(|at| self.is_open(at)) {
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
        let meet = |a: &Well, b: &Well| {
            let of = |well: &'_ Well| -> Vec<u32> {
                let cells = well.cells.iter();
                cells.map(|c| compartments[c.0 as usize]).collect()
            };
            let other = of(b);
            of(a).iter().any(|compartment| other.contains(compartment))
        };
        let mut lonely = Vec::new();
        for well in wells.iter().filter(|well| injects(well)) {
            let producers: Vec<&Well> = wells.iter().filter(|other| !injects(other)).collect();
            if !producers.is_empty() && !producers.iter().any(|other| meet(well, other)) {
                lonely.push(well);
            }
        }
        let line = |well: &Well, kind: &str, others: &str| {
            let compartment = well.cells.first().map_or(0, |c| compartments[c.0 as usize]);
            let cells = compartments.iter().filter(|c| **c == compartment).count();
            format!(
                "{kind} {}: closed faults part its compartment, of {cells} cells, from every {others}",
                well.name
            )
        };
        let injectors: Vec<&Well> = wells.iter().filter(|well| injects(well)).collect();
        let mut notes: Vec<String> = (lonely.iter())
            .map(|well| line(well, "injector", "producer"))
            .collect();
        // Where no injector reaches any producer, that is said already.
        if lonely.len() < injectors.len() {
            let unreached = |well: &&Well| {
                !injects(well) && !injectors.iter().any(|injector| meet(well, injector))
            };
            let unreached = wells.iter().filter(unreached);
            notes.extend(unreached.map(|well| line(well, "producer", "injector")));
        }
        notes
    }

    /// The pieces of a well's way; none of a well that is open to the cell of one point.
    fn well_segments(well: &Well, tracer: &WellTracer) -> (Trajectory, Vec<WellSegment>) {
        let way = Trajectory {
            name: well.name.clone(),
            points: well.path.clone(),
            radii: vec![well.radius; well.path.len()],
        };
        let pieces = match way.leg_count() {
            0 => Vec::new(),
            _ => tracer.segments(&way),
        };
        (way, pieces)
    }

    /// The name of the closed fault between two cells.
    fn closed_fault_between(&self, cells: [u32; 2]) -> Option<String> {
        let sorted = [cells[0].min(cells[1]), cells[0].max(cells[1])];
        let mut all = self.graph.connections.iter().enumerate();
        let (at, _) = all.find(|(_, c)| {
            let [a, b] = c.cells;
            [a.min(b), a.max(b)] == sorted
        })?;
        self.closed_fault_name(at)
    }

    /// The name of the closed fault on which a connection lies.
    fn closed_fault_name(&self, connection: usize) -> Option<String> {
        let label = self.barriers.label(connection)?;
        let closed = self.barriers.law(label).multiplier() == 0.0;
        let names = self.surfaces.all_names().names;
        let name = names.get(label as usize - 1).cloned();
        closed.then(|| name.unwrap_or_else(|| "fault".into()))
    }

    fn crossed_fault(
        &self,
        well: &Well,
        tracer: &WellTracer,
        compartments: &[u32],
    ) -> Option<String> {
        let (_, pieces) = Self::well_segments(well, tracer);
        let pairs = pieces.windows(2).map(|pair| [pair[0].cell, pair[1].cell]);
        let parted = |pair: &[u32; 2]| {
            compartments[pair[0] as usize] != compartments[pair[1] as usize]
                || self.closed_fault_between(*pair).is_some()
        };
        let crossed: Vec<[u32; 2]> = pairs
            .filter(|pair| pair[0] != pair[1])
            .filter(parted)
            .collect();
        let first = crossed.first()?;
        let named = crossed
            .iter()
            .find_map(|pair| self.closed_fault_between(*pair));
        Some(format!(
            "well {}: runs through the closed {} between cells {} and {}, and joins what that parts; give it as two wells if the bore is not open there",
            well.name,
            named.unwrap_or_else(|| "faults".into()),
            first[0],
            first[1]
        ))
    }

    fn fault_along_well(&self, well: &Well, tracer: &WellTracer) -> Option<String> {
        let (way, pieces) = Self::well_segments(well, tracer);
        let ends = |piece: &WellSegment| {
            let (a, d) = way.leg(piece.leg as usize);
            piece.span.map(|share| add_scaled(a, share, d))
        };
        let parts: Vec<(u32, [[f64; 3]; 2])> = match (&well.path[..], &well.cells[..]) {
            ([point], [(cell, _)]) => vec![(*cell, [*point; 2])],
            _ => pieces
                .iter()
                .map(|piece| (piece.cell, ends(piece)))
                .collect(),
        };
        for (cell, ends) in parts {
            for &face in tracer.faces(cell as usize) {
                let Some(c) = self.graph.connections.get(face as usize) else {
                    continue;
                };
                let near = MAX_FACE_DISTANCE_RATIO * (c.distance[0] + c.distance[1]) + well.radius;
                let beside = ends.iter().all(|p| {
                    let off = sub(*p, c.point);
                    dot(off, c.normal).abs() <= near && norm(off) <= c.area.sqrt() + near
                });
                if beside && let Some(name) = self.closed_fault_name(face as usize) {
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
