//! Cells, connections and closed faults as the check of seals sees them, whatever the cells are.

use crate::geometry::{add_scaled, norm, sub};
use crate::mesh::graph::Graph;
use crate::mesh::poly::SIDE_NAMES;
use crate::model::surface::SurfaceKind;

/// Distance between nodes over the cube root of the volume, of regular tetrahedra.
const TET_SPACING_RATIO: f64 = 2.04;

/// Cells, their connections, and the surfaces on these.
#[derive(Debug, Clone)]
pub(crate) struct SealNetwork {
    /// The cells, in metres with z upwards.
    pub graph: Graph<3>,
    /// The number of the surface of each connection, 0 for none. Fragments have none, and the extension of a fault
    /// has the number of the fault.
    pub labels: Vec<u32>,
    /// Kinds of surfaces 1, 2 ...
    pub kinds: Vec<SurfaceKind>,
    /// Names of surfaces 1, 2 ...
    pub names: Vec<String>,
    /// The closed faults that are checked.
    pub faults: Vec<u32>,
    /// `true` for each connection that lets nothing pass.
    pub is_closed: Vec<bool>,
    /// Transmissibility of each connection without the resistance of faults; 0 at inactive cells.
    pub transmissibility: Vec<f64>,
    /// `true` if the cells are tetrahedra.
    pub has_tets: bool,
}

/// A thing at which the continuation of a fault ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum End {
    /// A side of the mesh.
    Side(u8),
    /// Another part of the boundary.
    Boundary,
    /// Inactive cells.
    InactiveCells,
    /// Another fault, by its number.
    Fault(u32),
}

impl SealNetwork {
    /// Returns the label of connections with inactive cells in [`walk_labels`](Self::walk_labels).
    fn inactive_label(&self) -> u32 {
        self.kinds.len() as u32 + 1
    }

    /// Returns the labels of connections for the continuation of faults, and which of them are
    /// barriers to it. Connections with inactive cells have a label of their own.
    pub fn walk_labels(&self) -> (Vec<u32>, Vec<bool>) {
        let inactive = self.inactive_label();
        let labels = self.labels.iter().zip(&self.transmissibility);
        let label = |(label, t): (&u32, &f64)| if *t > 0.0 { *label } else { inactive };
        let mut is_barrier = vec![false];
        is_barrier.extend(self.kinds.iter().map(|kind| *kind == SurfaceKind::Fault));
        is_barrier.push(true);
        (labels.map(label).collect(), is_barrier)
    }

    /// Returns `true` if a surface is a fault, but not `fault`.
    pub fn is_other_fault(&self, surface: u32, fault: u32) -> bool {
        let kind = |surface: u32| self.kinds.get((surface as usize).checked_sub(1)?);
        surface != fault && kind(surface) == Some(&SurfaceKind::Fault)
    }

    /// Returns what a barrier of the walk with this label is.
    pub(super) fn end_at(&self, label: u32) -> End {
        if label == self.inactive_label() {
            End::InactiveCells
        } else {
            End::Fault(label)
        }
    }

    /// Returns the words for the end of a continuation.
    pub(super) fn end_name(&self, end: End) -> String {
        match end {
            End::Side(side) => format!("side {}", SIDE_NAMES[usize::from(side)]),
            End::Boundary => "the boundary".into(),
            End::InactiveCells => "inactive cells".into(),
            End::Fault(fault) => self.name(fault),
        }
    }

    /// Returns the name of a surface.
    pub fn name(&self, surface: u32) -> String {
        let name = self.names.get(surface as usize - 1).cloned();
        name.unwrap_or_else(|| "scraps".into())
    }

    /// Returns the factor of z with which cells are about as high as wide.
    pub fn height_ratio(&self) -> f64 {
        let mut sums = [0.0; 3];
        for c in &self.graph.connections {
            let [a, b] = c.cells.map(|cell| self.graph.site[cell as usize]);
            let offset = sub(b, a);
            let length = norm(offset).max(f64::MIN_POSITIVE);
            // Weighted so that each axis counts the connections along it.
            (0..3).for_each(|k| sums[k] += offset[k].abs().powi(3) / length);
        }
        let count = |k: usize| -> f64 {
            let share = |c: &crate::mesh::graph::Connection<3>| {
                let [a, b] = c.cells.map(|cell| self.graph.site[cell as usize]);
                let offset = sub(b, a);
                offset[k].abs() / norm(offset).max(f64::MIN_POSITIVE)
            };
            self.graph.connections.iter().map(share).sum()
        };
        let mean = |k: usize| (sums[k] / count(k).max(f64::MIN_POSITIVE)).sqrt();
        let (width, height) = (mean(0).max(mean(1)), mean(2));
        if height > 1e-9 * width {
            width / height
        } else {
            1.0
        }
    }

    /// Returns the graph with z multiplied by `ratio`.
    pub fn stretched_graph(&self, ratio: f64) -> Graph<3> {
        let stretch = |[x, y, z]: [f64; 3]| [x, y, ratio * z];
        // Area vectors transform by the cofactors: normals by the inverse of the stretch.
        let area_vector = |normal: [f64; 3], area: f64| {
            let vector = normal.map(|n| n * area * ratio);
            let vector = [vector[0], vector[1], vector[2] / ratio];
            let area = norm(vector);
            (area, vector.map(|v| v / area.max(f64::MIN_POSITIVE)))
        };
        let mut graph = self.graph.clone();
        graph.volume.iter_mut().for_each(|v| *v *= ratio);
        graph.site.iter_mut().for_each(|x| *x = stretch(*x));
        graph.centroid.iter_mut().for_each(|x| *x = stretch(*x));
        for c in &mut graph.connections {
            c.point = stretch(c.point);
            (c.area, c.normal) = area_vector(c.normal, c.area);
        }
        for face in &mut graph.boundary {
            face.point = stretch(face.point);
            (face.area, face.normal) = area_vector(face.normal, face.area);
        }
        graph
    }

    /// Returns the distance between nodes at a cell of a graph of these cells.
    pub fn spacing(&self, graph: &Graph<3>, cell: u32) -> f64 {
        let size = graph.volume[cell as usize].cbrt();
        if self.has_tets {
            TET_SPACING_RATIO * size
        } else {
            size
        }
    }

    /// Returns the mean of positions with weights.
    pub fn mean_position(weighted: impl Iterator<Item = (f64, [f64; 3])>) -> [f64; 3] {
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for (weight, position) in weighted {
            sum = add_scaled(sum, weight, position);
            total += weight;
        }
        sum.map(|c| c / total)
    }
}
