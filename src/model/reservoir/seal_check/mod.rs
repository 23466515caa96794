//! Checks that closed faults seal, and says where they leak.
//!
//! With one fault closed and all others open, the flow between its two sides has two parts: through
//! leaks of the fault (holes in its faces, gaps between its edge and a side or a fault nearby,
//! connections that a format cannot close), and around its ends, which is no leak.
//!
//! - `network`: cells and connections of any kind
//! - `leaks`: places of the leaks
//! - `shares`: flow through each leak

mod leaks;
mod network;
mod shares;

#[cfg(test)]
mod tests;

use serde::Serialize;

use super::{Model, ModelFrame};
use crate::Result;
use crate::geometry::union_find::UnionFind;
use crate::model::flow::{Barriers, CellFlow, Rock, Tensor};
use crate::progress::CancelToken;
use leaks::{Cause, LeakFinder};
pub(crate) use network::SealNetwork;

/// Share of the flow between the two sides of a fault that a leak must pass to count.
const MIN_LEAK: f64 = 1e-6;
/// Number of compartments and of leaks of a fault that the table lists.
const MAX_LISTED: usize = 8;

/// The verdict on a closed fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SealVerdict {
    /// Nothing passes through the fault.
    Sealed,
    /// Fluid passes through the fault.
    Leaks,
}

/// A place at which fluid passes a closed fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Leak {
    /// Its centre, in the coordinates of the mesh.
    pub at: [f64; 3],
    /// Its area in m^2, projected onto the fault.
    pub area: f64,
    /// The flow through it over the flow between the two sides of the fault while the fault is open.
    pub share: f64,
    /// The reason.
    pub cause: String,
    /// The option of the command that closes it.
    pub remedy: String,
}

/// A closed fault, and the flow that passes it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SealedFault {
    /// The name of the fault.
    pub fault: String,
    /// The verdict.
    pub verdict: SealVerdict,
    /// Flow through the closed fault over the flow between its two sides while it is open.
    pub through: f64,
    /// Flow around the ends of the closed fault, over the same.
    pub around: f64,
    /// Area of its faces in m^2, with those of its extension.
    pub area: f64,
    /// Area of its faces over the area with which it would reach the next fault or the sides of the mesh.
    pub covered_share: f64,
    /// The leaks, the largest flow first.
    pub leaks: Vec<Leak>,
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
#[derive(Debug, Clone, PartialEq)]
pub struct SealCheck {
    /// The closed faults.
    pub faults: Vec<SealedFault>,
    /// The compartments, the largest first.
    pub compartments: Vec<Compartment>,
}

impl SealCheck {
    /// Checks the closed faults of a model: two computations of steady flow for each of them. Rock whose
    /// permeability is not known counts as uniform. Places are in the coordinates before `frame`.
    ///
    /// # Errors
    /// Returns the errors of [`CellFlow`], and [`Error::Interrupted`](crate::Error::Interrupted)
    /// once `cancel` is cancelled.
    pub fn new(model: &Model, frame: &ModelFrame, cancel: &CancelToken<'_>) -> Result<Self> {
        Self::of_network(model, &model.seal_network()?, frame, cancel)
    }

    /// Checks the closed faults in the cells that a format makes of a model.
    ///
    /// # Errors
    /// Returns the errors of [`new`](Self::new).
    pub(crate) fn of_network(
        model: &Model,
        network: &SealNetwork,
        frame: &ModelFrame,
        cancel: &CancelToken<'_>,
    ) -> Result<Self> {
        Ok(Self {
            faults: sealed_faults(network, frame, cancel)?,
            compartments: compartments(model),
        })
    }

    /// Returns the check as lines of a table.
    pub fn table(&self) -> String {
        let mut lines = Vec::new();
        for fault in &self.faults {
            let verdict = match fault.verdict {
                SealVerdict::Sealed => "sealed".into(),
                SealVerdict::Leaks => format!("leaks {:.2} % of the flow", 100.0 * fault.through),
            };
            let around = if fault.around < MIN_LEAK {
                "nothing flows around it".into()
            } else {
                format!("{:.1} % flows around its ends", 100.0 * fault.around)
            };
            lines.push(format!(
                "closed         {} ({:.3e} m^2, {:.1} % of its way to the next fault or side): {verdict}; {around}",
                fault.fault,
                fault.area,
                100.0 * fault.covered_share
            ));
            for leak in fault.leaks.iter().take(MAX_LISTED) {
                let [x, y, z] = leak.at;
                lines.push(format!(
                    "  leak         {} at ({x:.2}, {y:.2}, {z:.2}), {:.3e} m^2, {:.2} %: {}",
                    leak.cause,
                    leak.area,
                    100.0 * leak.share,
                    leak.remedy
                ));
            }
            if fault.leaks.len() > MAX_LISTED {
                let count = fault.leaks.len() - MAX_LISTED;
                lines.push(format!("               and {count} smaller leaks"));
            }
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

    /// Returns the check of the faults as a table of comma-separated values: a line for each leak, and one
    /// for each fault without leaks.
    pub fn csv(&self) -> String {
        let mut text =
            String::from("fault,verdict,through,around,fault_area,x,y,z,area,share,cause,remedy\n");
        for fault in &self.faults {
            let verdict = match fault.verdict {
                SealVerdict::Sealed => "sealed",
                SealVerdict::Leaks => "leaks",
            };
            let start = format!(
                "{},{verdict},{},{},{}",
                fault.fault, fault.through, fault.around, fault.area
            );
            if fault.leaks.is_empty() {
                text += &format!("{start},,,,,,,\n");
            }
            for leak in &fault.leaks {
                let [x, y, z] = leak.at;
                text += &format!(
                    "{start},{x},{y},{z},{},{},{},{}\n",
                    leak.area, leak.share, leak.cause, leak.remedy
                );
            }
        }
        text
    }
}

impl Model {
    /// Returns `true` for each connection that lets nothing pass because of a surface.
    fn closed_connections(&self) -> Vec<bool> {
        let is_closed = |index: usize| {
            let label = self.barriers.label(index);
            label.is_some_and(|label| self.barriers.law(label).multiplier() == 0.0)
        };
        (0..self.graph.connections.len()).map(is_closed).collect()
    }

    /// Returns the number of the surface of each connection. The extension of a fault has the number of
    /// the fault, and fragments have none: closed ones fill holes of faults, but need no certificate.
    fn certified_labels(&self) -> Vec<u32> {
        let kept_count = self.surfaces.kept_count as u32;
        let labels = self.surfaces.merged_labels().into_iter();
        labels
            .map(|label| if label > kept_count { 0 } else { label })
            .collect()
    }

    /// Returns the numbers of the surfaces that are closed all over.
    pub(crate) fn closed_faults(&self) -> Vec<u32> {
        let surfaces = self.surfaces.kept_count + 1;
        let mut is_closed: Vec<Option<bool>> = vec![None; surfaces];
        let closed_connections = self.closed_connections();
        for (label, closed) in self.certified_labels().iter().zip(closed_connections) {
            *is_closed[*label as usize].get_or_insert(true) &= closed;
        }
        let numbers = 1..surfaces as u32;
        numbers
            .filter(|number| is_closed[*number as usize] == Some(true))
            .collect()
    }

    /// Returns the cells and connections of the model for the check of its closed faults.
    fn seal_network(&self) -> Result<SealNetwork> {
        let uniform = Rock::uniform(Tensor::isotropic(1.0), 1.0);
        let rock = self.permeability.as_ref().map_or(&uniform, |p| &p.rock);
        let flow = CellFlow::with_barriers(&self.graph, rock, &Barriers::default())?;
        let mut transmissibility = flow.transmissibility;
        for (index, t) in transmissibility.iter_mut().enumerate() {
            if !self.joins_active_cells(index) {
                *t = 0.0;
            }
        }
        Ok(SealNetwork {
            graph: self.graph.clone(),
            labels: self.certified_labels(),
            kinds: self.surfaces.kinds.clone(),
            names: self.surfaces.all_names().names,
            faults: self.closed_faults(),
            is_closed: self.closed_connections(),
            transmissibility,
            has_tets: self.tets.is_some(),
        })
    }
}

fn sealed_faults(
    network: &SealNetwork,
    frame: &ModelFrame,
    cancel: &CancelToken<'_>,
) -> Result<Vec<SealedFault>> {
    let ratio = network.height_ratio();
    let stretched = network.stretched_graph(ratio);
    let finder = LeakFinder::new(network, &stretched, ratio);
    let mut faults = Vec::new();
    for &fault in &network.faults {
        let Some(found) = finder.leaks(fault) else {
            continue;
        };
        let shares = shares::shares(network, &finder, fault, &found, cancel)?;
        let mut leaks: Vec<Leak> = (found.leaks.iter().zip(&shares.leaks))
            .filter(|(_, share)| **share >= MIN_LEAK)
            .map(|(leak, share)| Leak {
                at: frame.to_file(leak.centre),
                area: leak.area,
                share: *share,
                cause: match leak.cause {
                    Cause::Hole => "hole in its faces".into(),
                    Cause::Gap(end) => format!("gap to {}", network.end_name(end)),
                    Cause::LostConnection => "connections that the format leaves open".into(),
                },
                remedy: match leak.cause {
                    Cause::LostConnection => "--to opm".into(),
                    _ => format!("--extend-faults {}", finder.closing_distance(fault, leak)),
                },
            })
            .collect();
        leaks.sort_by(|a, b| b.share.total_cmp(&a.share));
        // The sum of nothing is -0.
        let through = leaks.iter().fold(0.0, |sum, leak| sum + leak.share);
        faults.push(SealedFault {
            fault: network.name(fault),
            verdict: if leaks.is_empty() {
                SealVerdict::Sealed
            } else {
                SealVerdict::Leaks
            },
            through,
            around: shares.around,
            area: found.area,
            covered_share: found.area / (found.area + found.missing_area),
            leaks,
        });
    }
    Ok(faults)
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
