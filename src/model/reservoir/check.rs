//! Checks of a model before it is written.

use crate::geometry::union_find::UnionFind;
use serde::Serialize;

use super::Model;
use crate::model::flow::driver::ROUGH_ANGLE_DEGREES;

/// Statistics of a model, as the table and the JSON show them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelChecks {
    /// Number of cells.
    pub cells: usize,
    /// Number of connections.
    pub connections: usize,
    /// Number of connections on features.
    pub feature_connections: usize,
    /// Sum of the cells' volumes in m^3.
    pub volume: f64,
    /// Relative difference between this volume and that of the box.
    pub volume_error: f64,
    /// Volume in m^3 of the ground that holds data, if that is not all ground.
    pub live_volume: Option<f64>,
    /// Pore volume in m^3, if the porosity is known.
    pub pore_volume: Option<f64>,
    /// Smallest and largest depth of a site in metres.
    pub depth: [f64; 2],
    /// Smallest and largest transmissibility in m^3, if the permeability is known.
    pub transmissibility: Option<[f64; 2]>,
    /// Angle in degrees between the lines from site to site and the permeability times the faces'
    /// normals: the mean, weighted by area, and the largest.
    pub angle: [f64; 2],
    /// The two cells of the connection with the largest angle.
    pub worst_connection: Option<[u32; 2]>,
    /// Relative error of a two-point flux where fluid flows as strongly along the face as across
    /// it: the mean tangent of the angle, weighted by area.
    pub two_point_error: f64,
    /// `true` if the cells stand in columns.
    pub is_columnar: bool,
    /// Compartments, between which nothing flows: the smallest cell number and the number of cells
    /// of each, the largest compartment first.
    pub compartments: Vec<(usize, usize)>,
}

impl ModelChecks {
    /// Checks a model that fills a box with the volume `box_volume`, in m^3.
    pub fn new(model: &Model, box_volume: f64) -> Self {
        let graph = &model.graph;
        let cells = graph.volume.len();
        let volume: f64 = graph.volume.iter().sum();
        let angles = model.two_point_angles();
        let (mut area, mut sum, mut tangents, mut worst) = (0.0, 0.0, 0.0, (0.0, None));
        for (c, &angle) in graph.connections.iter().zip(&angles) {
            area += c.area;
            sum += c.area * angle;
            tangents += c.area * angle.min(89.0).to_radians().tan();
            if angle > worst.0 {
                worst = (angle, Some(c.cells));
            }
        }
        let mean = |sum: f64| if area > 0.0 { sum / area } else { 0.0 };
        let transmissibility = model.permeability.as_ref().map(|p| &p.transmissibility);
        let range = |values: &mut dyn Iterator<Item = f64>| {
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| {
                [low.min(v), high.max(v)]
            })
        };
        Self {
            cells,
            connections: graph.connections.len(),
            feature_connections: graph.connections.iter().filter(|c| c.on_feature).count(),
            volume,
            volume_error: (volume / box_volume - 1.0).abs(),
            live_volume: model.live_volume(),
            pore_volume: (0..cells).map(|cell| model.pore_volume(cell)).sum(),
            depth: range(&mut (0..cells).map(|cell| model.depth(cell))),
            transmissibility: transmissibility
                .filter(|t| !t.is_empty())
                .map(|t| range(&mut t.iter().copied())),
            angle: [mean(sum), worst.0],
            worst_connection: worst.1,
            two_point_error: mean(tangents),
            is_columnar: model.mesh.is_columnar(),
            compartments: find_compartments(
                cells,
                |cell| model.is_active(cell),
                graph
                    .connections
                    .iter()
                    .enumerate()
                    .filter(|(i, _)| transmissibility.is_none_or(|t| t[*i] > 0.0))
                    .map(|(_, c)| c.cells),
            ),
        }
    }

    /// Returns the short table. `unit` is the unit of the coordinates. Rows on flow and depth
    /// appear only if `with_flow`.
    pub fn table(&self, unit: &str, with_flow: bool) -> String {
        let mut lines = vec![
            format!(
                "cells          {} with {} connections, {} of them on features",
                self.cells, self.connections, self.feature_connections
            ),
            format!(
                "volume         {:.6e} {unit}^3, {:.1e} off the box",
                self.volume, self.volume_error
            ),
        ];
        if let Some(live) = self.live_volume {
            let percent = 100.0 * live / self.volume;
            lines.push(format!(
                "live volume    {live:.6e} {unit}^3, {percent:.2} % of the volume"
            ));
        }
        if let Some(pores) = self.pore_volume {
            lines.push(format!("pore volume    {pores:.6e} m^3"));
        }
        if with_flow {
            let [low, high] = self.depth;
            lines.push(format!("depth          {low:.2} to {high:.2} m"));
        }
        if let Some([low, high]) = self.transmissibility {
            lines.push(format!("transmiss.     {low:.3e} to {high:.3e} m^3"));
        }
        if with_flow {
            let [mean, worst] = self.angle;
            let mut line =
                format!("two-point      {mean:.2} degrees off on average, {worst:.2} at worst");
            if let Some([a, b]) = self.worst_connection {
                line += &format!(" (cells {a} and {b})");
            }
            lines.push(line);
        }
        lines.push(match self.compartments.len() {
            1 => "connected      all cells".to_string(),
            count => {
                let listed = self.compartments.iter().take(5);
                let names: Vec<String> = listed
                    .map(|(cell, size)| format!("{size} cells with cell {cell}"))
                    .collect();
                let suffix = if count > 5 { ", ..." } else { "" };
                format!("not connected  {count} parts: {}{suffix}", names.join(", "))
            }
        });
        lines.join("\n")
    }

    /// Returns `true` if two-point fluxes are rough: their mean angle error exceeds
    /// one degree.
    pub fn is_rough(&self) -> bool {
        self.angle[0] > ROUGH_ANGLE_DEGREES
    }

    /// Returns notes for the user, one line each.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.is_rough() {
            let remedy = if self.is_columnar {
                "level layers, or cells that are not columns,"
            } else {
                "Voronoi cells made with the metric of the rock"
            };
            notes.push(format!(
                "two-point fluxes are rough: where fluid flows along faces as strongly as across \
                 them, they are off by {:.0} % on average; {remedy} have no such error",
                100.0 * self.two_point_error
            ));
        }
        notes
    }
}

/// Returns the compartments of the active cells of a graph: the smallest cell number and the size
/// of each, the largest compartment first.
fn find_compartments(
    cells: usize,
    is_active: impl Fn(usize) -> bool,
    pairs: impl Iterator<Item = [u32; 2]>,
) -> Vec<(usize, usize)> {
    let mut sets = UnionFind::new(cells);
    for [a, b] in pairs {
        sets.unite(a, b);
    }
    let mut sizes = vec![0; cells];
    for cell in (0..cells as u32).filter(|&cell| is_active(cell as usize)) {
        sizes[sets.find(cell) as usize] += 1;
    }
    let mut compartments: Vec<(usize, usize)> = sizes
        .into_iter()
        .enumerate()
        .filter(|(_, size)| *size > 0)
        .collect();
    compartments.sort_by_key(|&(cell, size)| (std::cmp::Reverse(size), cell));
    compartments
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;
    use crate::model::flow::{FaultLaw, Rock, Tensor};

    #[test]
    fn compartments_are_sorted_largest_first() {
        let pairs = [[4, 3], [0, 1], [5, 4]];
        assert_eq!(
            find_compartments(6, |_| true, pairs.into_iter()),
            [(3, 3), (0, 2), (2, 1)]
        );
    }

    #[test]
    fn checks_of_two_boxes() {
        let mut model = Model::new(two_cells::<3>(0.75), None);
        let rock = || Rock::uniform(Tensor::isotropic(2.0), 1.0);
        model.set_permeability(rock()).unwrap();
        model.porosity = Some(vec![0.5, 0.25]);
        let checks = ModelChecks::new(&model, 2.0);
        assert_eq!(
            (checks.cells, checks.connections, checks.feature_connections),
            (2, 1, 1)
        );
        assert!(checks.volume_error < 1e-15 && checks.angle[1] < 1e-9);
        assert_eq!(checks.pore_volume, Some(0.375 + 0.3125));
        assert_eq!(checks.compartments, [(0, 2)]);
        assert!(checks.notes().is_empty());
        model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
        model.set_permeability(rock()).unwrap();
        let checks = ModelChecks::new(&model, 2.0);
        assert_eq!(checks.compartments, [(0, 1), (1, 1)]);
        assert!(checks.table("m", true).contains("not connected  2 parts"));
    }

    #[test]
    fn sheared_cells_are_rough() {
        let sheared = two_cells::<3>(0.75).mapped(|[x, y, z]| [x, y + x, z], false);
        let checks = ModelChecks::new(&Model::new(sheared, None), 2.0);
        assert!((checks.angle[1] - 45.0).abs() < 1e-9);
        assert!((checks.two_point_error - 1.0).abs() < 1e-9);
        assert_eq!(
            (checks.worst_connection, checks.notes().len()),
            (Some([0, 1]), 1)
        );
    }
}
