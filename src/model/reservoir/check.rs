//! What is looked at before anything is written.

use crate::geometry::union_find::UnionFind;
use serde::Serialize;

use super::Model;
use crate::model::flow::driver::ROUGH_ANGLE_DEGREES;

/// Figures of a model, as the table and the JSON show them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelChecks {
    /// Number of cells.
    pub cells: usize,
    /// Number of connections.
    pub connections: usize,
    /// Connections on features.
    pub feature_connections: usize,
    /// Sum of the cells' volumes in m^3.
    pub volume: f64,
    /// How far it is from the box's volume, relative to it.
    pub volume_error: f64,
    /// Pore volume in m^3, if the porosity is known.
    pub pore_volume: Option<f64>,
    /// Least and greatest depth of a site in metres.
    pub depth: [f64; 2],
    /// Least and greatest transmissibility, in m^3, if the permeability is known.
    pub transmissibility: Option<[f64; 2]>,
    /// Angle in degrees by which lines between sites miss the permeability times the faces' normals:
    /// mean by area, and the worst.
    pub angle: [f64; 2],
    /// The cells of the connection that has the worst angle.
    pub worst_connection: Option<[u32; 2]>,
    /// What a two-point flux misses where fluid flows along the face as strongly as across it: the
    /// tangent of the angle, mean by area.
    pub two_point_error: f64,
    /// Whether the cells stand in columns.
    pub is_columnar: bool,
    /// Parts between which nothing flows: the least cell and the number of cells of each, the
    /// largest first.
    pub compartments: Vec<(usize, usize)>,
}

impl ModelChecks {
    /// Looks at a model that fills a box of volume `box_volume`, in m^3.
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
        let open = model.permeability.as_ref().map(|p| &p.transmissibility);
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
            pore_volume: model.porosity.as_ref().map(|porosity| {
                let pores = porosity.iter().zip(&graph.volume);
                pores.map(|(p, v)| p * v).sum()
            }),
            depth: range(&mut (0..cells).map(|cell| model.depth(cell))),
            transmissibility: open
                .filter(|t| !t.is_empty())
                .map(|t| range(&mut t.iter().copied())),
            angle: [mean(sum), worst.0],
            worst_connection: worst.1,
            two_point_error: mean(tangents),
            is_columnar: model.mesh.is_columnar(),
            compartments: parts(
                cells,
                |cell| model.is_active(cell),
                graph
                    .connections
                    .iter()
                    .enumerate()
                    .filter(|(i, _)| open.is_none_or(|t| t[*i] > 0.0))
                    .map(|(_, c)| c.cells),
            ),
        }
    }

    /// Returns the short table, of coordinates in `unit`; what concerns flow and depth only if `of_flow`.
    pub fn table(&self, unit: &str, of_flow: bool) -> String {
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
        if let Some(pores) = self.pore_volume {
            lines.push(format!("pore volume    {pores:.6e} m^3"));
        }
        if of_flow {
            let [low, high] = self.depth;
            lines.push(format!("depth          {low:.2} to {high:.2} m"));
        }
        if let Some([low, high]) = self.transmissibility {
            lines.push(format!("transmiss.     {low:.3e} to {high:.3e} m^3"));
        }
        if of_flow {
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
                let few = self.compartments.iter().take(5);
                let named: Vec<String> = few
                    .map(|(cell, size)| format!("{size} cells with cell {cell}"))
                    .collect();
                let more = if count > 5 { ", ..." } else { "" };
                format!("not connected  {count} parts: {}{more}", named.join(", "))
            }
        });
        lines.join("\n")
    }

    /// Whether two-point fluxes are rough.
    pub fn is_rough(&self) -> bool {
        self.angle[0] > ROUGH_ANGLE_DEGREES
    }

    /// What the user should know, if anything: one line each.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.is_rough() {
            let remedy = match self.is_columnar {
                true => "level layers, or cells that are not columns,",
                false => "Voronoi cells made with the metric of the rock",
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

/// The parts that the active cells of a graph form, each with its least cell and its size; the largest first.
fn parts(
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
    let mut parts: Vec<(usize, usize)> = sizes
        .into_iter()
        .enumerate()
        .filter(|(_, size)| *size > 0)
        .collect();
    parts.sort_by_key(|&(cell, size)| (std::cmp::Reverse(size), cell));
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;
    use crate::model::flow::{FaultLaw, Rock, Tensor};

    #[test]
    fn parts_are_named_largest_first() {
        let pairs = [[4, 3], [0, 1], [5, 4]];
        assert_eq!(
            parts(6, |_| true, pairs.into_iter()),
            [(3, 3), (0, 2), (2, 1)]
        );
    }

    #[test]
    fn two_boxes() {
        let mut model = Model::new(two_cells::<3>(0.75), None);
        let rock = || Rock::uniform(Tensor::isotropic(2.0), 1.0);
        model.set_permeability(rock()).unwrap();
        model.porosity = Some(vec![0.5, 0.25]);
        let found = ModelChecks::new(&model, 2.0);
        assert_eq!(
            (found.cells, found.connections, found.feature_connections),
            (2, 1, 1)
        );
        assert!(found.volume_error < 1e-15 && found.angle[1] < 1e-9);
        assert_eq!(found.pore_volume, Some(0.375 + 0.3125));
        assert_eq!(found.compartments, [(0, 2)]);
        assert!(found.notes().is_empty());
        model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
        model.set_permeability(rock()).unwrap();
        let found = ModelChecks::new(&model, 2.0);
        assert_eq!(found.compartments, [(0, 1), (1, 1)]);
        assert!(found.table("m", true).contains("not connected  2 parts"));
    }

    #[test]
    fn sheared_cells_are_rough() {
        let sheared = two_cells::<3>(0.75).mapped(|[x, y, z]| [x, y + x, z], false);
        let found = ModelChecks::new(&Model::new(sheared, None), 2.0);
        assert!((found.angle[1] - 45.0).abs() < 1e-9);
        assert!((found.two_point_error - 1.0).abs() < 1e-9);
        assert_eq!(
            (found.worst_connection, found.notes().len()),
            (Some([0, 1]), 1)
        );
    }
}
