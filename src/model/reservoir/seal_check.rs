//! Checks that closed faults seal: the share of the flow across each that still passes, around its
//! ends and through its holes, and the wells in each compartment.

use serde::Serialize;

use super::Model;
use crate::Result;
use crate::geometry::union_find::UnionFind;
use crate::mesh::poly::SIDE_NAMES;
use crate::model::flow::{Barriers, CellFlow, FaultLaw, Rock, Tensor};
use crate::model::surface::fault_extension::extensions;
use crate::progress::CancelToken;

/// Share of the flow that a fault must pass to count as leaking.
const MIN_LEAK: f64 = 1e-6;
/// Number of compartments that the table lists.
const MAX_LISTED: usize = 8;

/// A closed fault, and the flow that passes it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SealedFault {
    /// The name of the fault.
    pub name: String,
    /// Area of its faces in m^2, with those of its extension.
    pub area: f64,
    /// Area of its faces over the area with which it would reach the next fault or the sides of the mesh.
    pub covered_share: f64,
    /// The two sides of the mesh between which fluid flows: those that the fault faces most.
    pub between: [&'static str; 2],
    /// Flow between these sides with this fault closed, over that with all faults open.
    pub passing_share: f64,
}

/// Cells that closed faults separate from all others.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Compartment {
    /// Number of active cells.
    pub cells: usize,
    /// Pore volume in m^3, or the volume if the porosity is not known.
    pub volume: f64,
    /// Names of the wells that are open to cells of the compartment.
    pub wells: Vec<String>,
}

/// The closed faults of a model, and what they separate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SealCheck {
    /// The closed faults.
    pub faults: Vec<SealedFault>,
    /// The compartments, the largest first.
    pub compartments: Vec<Compartment>,
}

impl SealCheck {
    /// Checks the closed faults of a model: one computation of steady flow for each of them, and one
    /// for each axis. Rock whose permeability is not known counts as uniform.
    ///
    /// # Errors
    /// Returns the errors of [`CellFlow`], and [`Error::Interrupted`](crate::Error::Interrupted)
    /// once `cancel` is cancelled.
    pub fn new(model: &Model, cancel: &CancelToken<'_>) -> Result<Self> {
        Ok(Self {
            faults: sealed_faults(model, cancel)?,
            compartments: compartments(model),
        })
    }

    /// Returns the check as lines of a table.
    pub fn table(&self) -> String {
        let mut lines = Vec::new();
        for fault in &self.faults {
            let [from, to] = fault.between;
            let verdict = if fault.passing_share < MIN_LEAK {
                "nothing passes".into()
            } else {
                format!("{:.1} % of the flow passes", 100.0 * fault.passing_share)
            };
            lines.push(format!(
                "closed         {} ({:.3e} m^2, {:.1} % of its way to the next fault or side): \
                 {verdict} from {from} to {to}",
                fault.name,
                fault.area,
                100.0 * fault.covered_share
            ));
        }
        for (number, part) in self.compartments.iter().take(MAX_LISTED).enumerate() {
            let wells = match part.wells.len() {
                0 => "no wells".to_string(),
                _ => format!("wells {}", part.wells.join(", ")),
            };
            lines.push(format!(
                "compartment {:<2} {} cells, {:.3e} m^3, {wells}",
                number + 1,
                part.cells,
                part.volume
            ));
        }
        if self.compartments.len() > MAX_LISTED {
            let count = self.compartments.len() - MAX_LISTED;
            lines.push(format!("               and {count} smaller compartments"));
        }
        lines.join("\n")
    }
}

fn sealed_faults(model: &Model, cancel: &CancelToken<'_>) -> Result<Vec<SealedFault>> {
    let graph = &model.graph;
    let names = model.surfaces.all_names();
    let uniform = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let rock = model.permeability.as_ref().map_or(&uniform, |p| &p.rock);
    let normals = side_normals(model);
    let mut open_rates: [Option<f64>; 3] = [None; 3];
    let mut faults = Vec::new();
    let labels = model.surfaces.merged_labels();
    for surface in 1..=names.kinds.len() as u32 {
        let is_on = |index: usize| labels[index] == surface;
        let is_closed = |index: usize| {
            let label = model.barriers.label(index);
            label.is_some_and(|label| model.barriers.law(label).multiplier() == 0.0)
        };
        let connections = graph.connections.iter().enumerate();
        let on_fault: Vec<_> = connections.filter(|(index, _)| is_on(*index)).collect();
        if on_fault.is_empty() || !on_fault.iter().all(|(index, _)| is_closed(*index)) {
            continue;
        }
        // The axis of the mesh that the fault faces most.
        let mut facing = [0.0; 3];
        for (_, c) in &on_fault {
            for (facing, normal) in facing.iter_mut().zip(&normals) {
                let cosine = normal.map_or(0.0, |n| crate::geometry::dot(n, c.normal));
                *facing += c.area * cosine.powi(2);
            }
        }
        let axis = (0..3).fold(0, |best, k| if facing[k] > facing[best] { k } else { best });
        if normals[axis].is_none() {
            continue;
        }
        let rate = |barriers: &Barriers| -> Result<f64> {
            let flow = CellFlow::with_barriers(graph, rock, barriers)?;
            let sides = [(2 * axis as u8, 1.0), (2 * axis as u8 + 1, 0.0)];
            let cells = graph.volume.len();
            let solution = flow.solve_cancellable(&vec![0.0; cells], &sides, cancel)?;
            Ok(solution.inflow[cells])
        };
        let open = match open_rates[axis] {
            Some(open) => open,
            None => rate(&Barriers::default())?,
        };
        open_rates[axis] = Some(open);
        let on_closed = (0..graph.connections.len()).map(is_on);
        let closed = rate(&Barriers::uniform(on_closed, FaultLaw::CLOSED))?;
        let area = on_fault.iter().map(|(_, c)| c.area).sum();
        let (labels, kinds) = (model.surfaces.merged_labels(), &model.surfaces.kinds);
        let missing = extensions(graph, labels, kinds, &[surface], f64::INFINITY);
        let missing: f64 = missing.iter().map(|extension| extension.area).sum();
        faults.push(SealedFault {
            name: names
                .names
                .get(surface as usize - 1)
                .cloned()
                .unwrap_or_else(|| "scraps".into()),
            area,
            covered_share: area / (area + missing),
            between: [SIDE_NAMES[2 * axis], SIDE_NAMES[2 * axis + 1]],
            passing_share: if open > 0.0 {
                (closed / open).max(0.0)
            } else {
                0.0
            },
        });
    }
    Ok(faults)
}

/// Returns the mean unit normal of the upper side of the mesh along each axis, if both sides have faces.
fn side_normals(model: &Model) -> [Option<[f64; 3]>; 3] {
    let mut sums = [[0.0; 3]; 6];
    for face in &model.graph.boundary {
        if let Some(side) = face.side {
            let sum = &mut sums[usize::from(side)];
            *sum = crate::geometry::add_scaled(*sum, face.area, face.normal);
        }
    }
    std::array::from_fn(|axis| {
        let lengths = [0, 1].map(|end| crate::geometry::norm(sums[2 * axis + end]));
        let has_both = lengths.iter().all(|length| *length > 0.0);
        has_both.then(|| sums[2 * axis + 1].map(|n| n / lengths[1]))
    })
}

fn compartments(model: &Model) -> Vec<Compartment> {
    let graph = &model.graph;
    let cells = model.len();
    let mut sets = UnionFind::new(cells);
    for (index, _) in model.open_connections() {
        let [a, b] = graph.connections[index as usize].cells;
        let transmissibility = model.permeability.as_ref();
        if transmissibility.is_none_or(|p| p.transmissibility[index as usize] > 0.0) {
            sets.unite(a, b);
        }
    }
    let mut parts: Vec<Option<Compartment>> = vec![None; cells];
    for cell in (0..cells).filter(|&cell| model.is_active(cell)) {
        let part = parts[sets.find(cell as u32) as usize].get_or_insert(Compartment {
            cells: 0,
            volume: 0.0,
            wells: Vec::new(),
        });
        part.cells += 1;
        part.volume += model.pore_volume(cell).unwrap_or(graph.volume[cell]);
    }
    for well in &model.case.wells {
        for (cell, _) in &well.cells {
            if let Some(part) = &mut parts[sets.find(*cell) as usize]
                && !part.wells.contains(&well.name)
            {
                part.wells.push(well.name.clone());
            }
        }
    }
    let mut parts: Vec<Compartment> = parts.into_iter().flatten().collect();
    parts.sort_by_key(|part| std::cmp::Reverse(part.cells));
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn a_closed_fault_that_divides_the_mesh_passes_nothing() {
        let mut mesh = two_cells::<3>(0.75);
        mesh.assign_sides([0.0; 3], [2.0, 1.0, 1.0]);
        let mut model = Model::new(mesh, None);
        let cancel = CancelToken::never();
        assert!(SealCheck::new(&model, &cancel).unwrap().faults.is_empty());
        model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
        let check = SealCheck::new(&model, &cancel).unwrap();
        let [fault] = &check.faults[..] else {
            panic!("{check:?}")
        };
        assert_eq!((fault.between, fault.area), (["xmin", "xmax"], 1.0));
        assert_eq!(fault.covered_share, 1.0);
        assert_eq!(fault.passing_share, 0.0);
        assert_eq!(check.compartments.len(), 2);
        assert!(check.table().contains("nothing passes from xmin to xmax"));
        // A partial multiplier is no closed fault.
        let partial = FaultLaw::new(0.5, None).unwrap();
        model.set_faults(&partial.into()).unwrap();
        let check = SealCheck::new(&model, &cancel).unwrap();
        assert!(check.faults.is_empty() && check.compartments.len() == 1);
    }

    #[test]
    fn half_a_fault_passes_half_of_the_flow() {
        use crate::mesh::voronoi;
        // A channel of 2 x 1 x 2 cells, in which the fault closes one of the two ways.
        let atoms = [
            [0.5, 0.5, 0.5],
            [1.5, 0.5, 0.5],
            [0.5, 0.5, 1.5],
            [1.5, 0.5, 1.5],
        ];
        let mesh = voronoi::voronoi(&atoms, [2.0, 1.0, 2.0]).unwrap();
        let mut model = Model::new(mesh, None);
        let on_fault: Vec<u32> = (model.graph.connections.iter())
            .map(|c| u32::from(c.normal[0].abs() > 0.9 && c.point[2] < 1.0))
            .collect();
        assert_eq!(on_fault.iter().sum::<u32>(), 1);
        model.surfaces.kinds = vec![crate::model::surface::SurfaceKind::Fault];
        model.surfaces.kept_count = 1;
        model.surfaces.connection_surfaces = on_fault;
        model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
        let check = SealCheck::new(&model, &CancelToken::never()).unwrap();
        // The network of conductances, 2 to the sides and 1 between cells, gives 4/7.
        let share = check.faults[0].passing_share;
        assert!((share - 4.0 / 7.0).abs() < 1e-9, "{share}");
        assert_eq!(check.faults[0].covered_share, 0.5);
    }
}
