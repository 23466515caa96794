//! Meshes of simplices for formats that hold nothing else: tetrahedra with named triangles, or in
//! 2-D triangles with named edges.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use crate::parallel::prelude::*;

use super::groups::{FaceGroup, NamedSides};
use crate::Result;
use crate::export::names::ExportNames;
use crate::files::Batch;
use crate::files::text::write_items;
use crate::geometry::sorted_distinct;
use crate::mesh::FACES;
use crate::model::reservoir::{Model, PeriodicPair};
use crate::names::csv_field;
use crate::store::named_sets::NamedSet;

/// Edges of a tetrahedron that have a node in their middle if it is quadratic, in the order of
/// Abaqus. For a triangle the first three.
pub const MIDPOINT_EDGES: [[usize; 2]; 6] = [[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]];

/// Mesh of tetrahedra or triangles.
pub struct SimplexMesh<'a> {
    /// Node positions.
    pub nodes: &'a [[f64; 3]],
    /// Edges of a quadratic mesh, ascending. The nodes in their middle follow the other nodes.
    edges: Vec<[u32; 2]>,
    /// Nodes of each simplex, one after the other.
    corners: &'a [u32],
    /// Number of nodes of each simplex: 4 or 3.
    pub corner_count: usize,
    /// Region of each simplex.
    pub region: &'a [i32],
    /// Named sides of simplices.
    pub named_sides: Vec<NamedSides>,
    /// Surfaces along which the mesh is split.
    pub torn_surfaces: Vec<TornSurface>,
    /// Sets of nodes, besides those of sides.
    pub node_sets: Vec<NamedSet>,
    /// Nodes on far sides of a periodic mesh, also those in the middle of edges.
    pub periodic_pairs: Vec<PeriodicPair>,
}

/// Surface along which a mesh is split.
pub struct TornSurface {
    /// Name of the surface, for the elements between its two sides.
    pub name: String,
    /// Number of the surface, which no other name has.
    pub number: usize,
    /// Each face as its lower cell has it, anticlockwise seen from above, and as its upper cell has
    /// it, with corresponding nodes in the same order. At the tip of the surface the two nodes are
    /// equal.
    pub face_pairs: Vec<[[u32; 3]; 2]>,
    /// Lower cell and upper cell of each face.
    pub cells: Vec<[u32; 2]>,
}

impl<'a> SimplexMesh<'a> {
    /// Creates the simplex mesh of a model, split if the model is. `format` is the name of the file
    /// format for error messages.
    ///
    /// # Errors
    /// Returns [`Error::Export`](crate::Error::Export) if the cells are not simplices.
    pub fn new(model: &'a Model, names: &ExportNames, format: &str) -> Result<Self> {
        let mesh = &model.mesh;
        let (corners, size, nodes) = match (&model.triangles, &model.split_mesh) {
            (Some(triangles), _) => {
                let nodes = &mesh.nodes[..mesh.nodes.len() / 2];
                (triangles.as_flattened(), 3, nodes)
            }
            (None, Some(split)) => (split.mesh.tets.as_flattened(), 4, &split.mesh.nodes[..]),
            (None, None) => {
                let tets = &model.need_tets(format)?.tets;
                (tets.as_flattened(), 4, &mesh.nodes[..])
            }
        };
        let mut simplices = Self {
            nodes,
            edges: Vec::new(),
            corners,
            corner_count: size,
            region: &mesh.region,
            named_sides: Vec::new(),
            torn_surfaces: Vec::new(),
            node_sets: Vec::new(),
            periodic_pairs: model.periodic.node_pairs(),
        };
        let sets = names.node_sets.iter();
        simplices.node_sets = sets.map(|set| simplices.node_set(model, set)).collect();
        simplices.find_torn_surfaces(model, names);
        let is_torn =
            |group: &FaceGroup| (names.split.iter()).any(|s| s.number as usize == group.number);
        for group in names.faces.groups() {
            if is_torn(&group) {
                continue;
            }
            let mut group_sides = NamedSides::new(group.name, group.number);
            for f in group.faces {
                let (cell, ring) = names.faces.side(model, f);
                if let Some(ring) = side(model, &simplices, cell, ring) {
                    group_sides.sides.push(ring);
                    group_sides.cells.push(cell);
                }
            }
            if !group_sides.cells.is_empty() {
                simplices.named_sides.push(group_sides);
            }
        }
        // The two sides of split surfaces come last, and then the elements between them.
        let mut next = names.faces.names.len() + 1;
        let mut sides = Vec::new();
        for (torn, split) in simplices.torn_surfaces.iter().zip(&names.split) {
            for (side, name) in split.sides.iter().enumerate() {
                let mut group_sides = NamedSides::new(name.clone(), next);
                next += 1;
                for (pair, cells) in torn.face_pairs.iter().zip(&torn.cells) {
                    let [p, q, r] = pair[side];
                    group_sides
                        .sides
                        .push(if side == 0 { [p, q, r] } else { [q, p, r] });
                    group_sides.cells.push(cells[side]);
                }
                sides.push(group_sides);
            }
        }
        for torn in &mut simplices.torn_surfaces {
            torn.number = next;
            next += 1;
        }
        simplices.named_sides.extend(sides);
        if model.is_quadratic {
            simplices.find_edges();
            simplices.pair_edges(model);
        }
        Ok(simplices)
    }

    /// Returns a set of nodes of a model, with all copies of a node that is split.
    fn node_set(&self, model: &Model, set: &NamedSet) -> NamedSet {
        let is_member = |n: u32| set.members.binary_search(&n).is_ok();
        let members = match (&model.split_mesh, &model.tets) {
            (Some(split), Some(tets)) => {
                let corners = tets.tets.as_flattened().iter();
                let copies = corners.zip(split.mesh.tets.as_flattened());
                sorted_distinct(copies.filter(|(n, _)| is_member(**n)).map(|(_, &m)| m))
            }
            _ => {
                let members = set.members.iter().copied();
                members
                    .filter(|&n| (n as usize) < self.nodes.len())
                    .collect()
            }
        };
        NamedSet {
            name: set.name.clone(),
            members,
        }
    }

    fn find_edges(&mut self) {
        let local_edges = &MIDPOINT_EDGES[..self.edges_per_simplex()];
        let simplex_edges = |t: usize| {
            let corners = self.get(t);
            local_edges
                .iter()
                .map(move |edge| sorted_edge(edge.map(|k| corners[k])))
        };
        let mut edges: Vec<[u32; 2]> = (0..self.len()).flat_map(simplex_edges).collect();
        edges.par_sort_unstable();
        edges.dedup();
        self.edges = edges;
    }

    /// Adds the pairs of nodes in the middle of edges of a periodic mesh.
    fn pair_edges(&mut self, model: &Model) {
        let first = self.nodes.len();
        let pair = |(i, edge): (usize, &[u32; 2])| {
            let (base, axes) = model.periodic.base_edge(*edge)?;
            let base = self.edges.binary_search(&sorted_edge(base)).ok()?;
            Some(PeriodicPair {
                node: (first + i) as u32,
                base: (first + base) as u32,
                axes,
            })
        };
        let pairs: Vec<PeriodicPair> = self.edges.iter().enumerate().filter_map(pair).collect();
        self.periodic_pairs.extend(pairs);
    }

    /// Returns the period of a periodic mesh along an axis of the image, as a vector; `None` if it is
    /// not periodic along that axis.
    pub fn period(&self, axis: usize) -> Option<[f64; 3]> {
        let mut pairs = self.periodic_pairs.iter();
        let pair = pairs.find(|pair| pair.axes == 1 << axis)?;
        let [x, y] = [pair.node, pair.base].map(|n| self.point(n as usize));
        Some(std::array::from_fn(|k| x[k] - y[k]))
    }

    /// Returns the nodes on the far side of a periodic mesh along an axis of the image, each with the
    /// node opposite it.
    pub fn opposite_nodes(&self, axis: usize) -> Vec<[u32; 2]> {
        // Nodes that are far along several axes have bases that are near along all of them.
        let pairs = self.periodic_pairs.iter();
        let places = pairs
            .clone()
            .map(|pair| ((pair.base, pair.axes), pair.node));
        let nodes: BTreeMap<(u32, u8), u32> = places.collect();
        let opposite = |pair: &PeriodicPair| {
            let axes = pair.axes & !(1 << axis);
            let base = match axes {
                0 => Some(pair.base),
                _ => nodes.get(&(pair.base, axes)).copied(),
            };
            (pair.axes >> axis & 1 == 1).then_some([pair.node, base?])
        };
        pairs.filter_map(opposite).collect()
    }

    /// Returns the surfaces with elements between their two sides. Between quadratic elements there
    /// are none, as no program has them.
    pub fn elements_between(&self) -> &[TornSurface] {
        if self.is_quadratic() {
            &[]
        } else {
            &self.torn_surfaces
        }
    }

    /// Returns the number of edges of each simplex.
    fn edges_per_simplex(&self) -> usize {
        self.corner_count * (self.corner_count - 1) / 2
    }

    /// Returns `true` if edges have nodes in their middle.
    pub fn is_quadratic(&self) -> bool {
        !self.edges.is_empty()
    }

    /// Returns the number of nodes, including those in the middle of edges.
    pub fn node_count(&self) -> usize {
        self.nodes.len() + self.edges.len()
    }

    /// Returns the position of a node.
    pub fn point(&self, node: usize) -> [f64; 3] {
        match node.checked_sub(self.nodes.len()) {
            None => self.nodes[node],
            Some(edge) => {
                let [a, b] = self.edges[edge].map(|n| self.nodes[n as usize]);
                std::array::from_fn(|k| 0.5 * (a[k] + b[k]))
            }
        }
    }

    /// Visits the nodes of a simplex, or of a side of one, with the given corners: first the
    /// corners, then in a quadratic mesh the nodes in the middle of its edges, in the order of
    /// [`MIDPOINT_EDGES`].
    pub fn visit_nodes(&self, corners: &[u32], mut visit: impl FnMut(u32)) {
        corners.iter().for_each(|&n| visit(n));
        if self.is_quadratic() {
            let count = corners.len() * (corners.len() - 1) / 2;
            for edge in &MIDPOINT_EDGES[..count] {
                let edge = sorted_edge(edge.map(|k| corners[k]));
                let index = self.edges.partition_point(|known| *known < edge);
                visit((self.nodes.len() + index) as u32);
            }
        }
    }

    /// Returns the nodes of all sides of a group, one side after the other.
    pub fn side_nodes(&self, group: &NamedSides) -> Vec<u32> {
        let mut nodes = Vec::new();
        (0..group.sides.len())
            .for_each(|i| self.visit_nodes(group.sides.get(i), |n| nodes.push(n)));
        nodes
    }

    /// Finds the surfaces along which a model is split.
    fn find_torn_surfaces(&mut self, model: &Model, names: &ExportNames) {
        let Some(split) = &model.split_mesh else {
            return;
        };
        let face_cells = &model.mesh.face_cells;
        let mut faces: Vec<_> = split.faces.iter().collect();
        faces.sort_by_key(|face| (face.label, face.cells));
        let number = |label: u32| names.faces.surface_number(model, label);
        let surfaces = faces.chunk_by(|a, b| number(a.label) == number(b.label));
        for (surface_faces, split_names) in surfaces.zip(&names.split) {
            let mut torn = TornSurface {
                name: split_names.elements.clone(),
                number: 0,
                face_pairs: Vec::with_capacity(surface_faces.len()),
                cells: Vec::with_capacity(surface_faces.len()),
            };
            for face in surface_faces {
                let f = face_cells[..model.mesh.inner_face_count()].binary_search(&face.cells);
                let lower = f.map_or(1, |f| usize::from(names.faces.is_of_second_cell(f as u32)));
                let mut pair = [face.nodes[lower], face.nodes[1 - lower]];
                let cell = face.cells[lower];
                if !self.is_outward(cell as usize, pair[0]) {
                    pair.iter_mut().for_each(|nodes| nodes.swap(0, 1));
                }
                torn.face_pairs.push(pair);
                torn.cells.push([cell, face.cells[1 - lower]]);
            }
            self.torn_surfaces.push(torn);
        }
    }

    /// Returns `true` if three nodes of a tetrahedron turn anticlockwise seen from outside.
    fn is_outward(&self, cell: usize, face: [u32; 3]) -> bool {
        let corners = self.get(cell);
        let corner_indices = face.map(|n| corners.iter().position(|&m| m == n).unwrap_or(0));
        let is_same_ring = |ring: &[usize; 3]| {
            (0..3).any(|k| [0, 1, 2].map(|i| ring[(i + k) % 3]) == corner_indices)
        };
        !FACES.iter().any(is_same_ring)
    }

    /// Returns the number of simplices.
    pub fn len(&self) -> usize {
        self.corners.len() / self.corner_count
    }

    /// Returns the nodes of a simplex.
    pub fn get(&self, i: usize) -> &[u32] {
        &self.corners[i * self.corner_count..][..self.corner_count]
    }

    /// Returns the number of named sides.
    pub fn named_side_count(&self) -> usize {
        self.named_sides.iter().map(|group| group.cells.len()).sum()
    }

    /// Returns the first number that no name has.
    pub fn next_number(&self) -> usize {
        let side_numbers = self.named_sides.iter().map(|named| named.number);
        let torn_numbers = self.torn_surfaces.iter().map(|torn| torn.number);
        side_numbers.chain(torn_numbers).max().unwrap_or(0) + 1
    }

    /// Writes the face pairs of a split mesh to `NAME-twins.csv` beside the file: surface, cells,
    /// and nodes of the lower and of the upper side, in a quadratic mesh six each. Numbers begin with
    /// `first`.
    pub fn write_face_pairs(&self, batch: &mut Batch, path: &Path, first: u32) -> Result<()> {
        if self.torn_surfaces.is_empty() {
            return Ok(());
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        batch.write(&path.with_file_name(format!("{stem}-twins.csv")), |out| {
            let count = if self.is_quadratic() { 6 } else { 3 };
            write!(out, "surface,cell_a,cell_b")?;
            for side in ["a", "b"] {
                (1..=count).try_for_each(|n| write!(out, ",{side}{n}"))?;
            }
            writeln!(out)?;
            for torn in &self.torn_surfaces {
                write_items(out, torn.face_pairs.len(), |text, i| {
                    text.word(&csv_field(&torn.name));
                    for n in torn.cells[i] {
                        text.word(",").int(n + first);
                    }
                    for face in &torn.face_pairs[i] {
                        self.visit_nodes(face, |n| {
                            text.word(",").int(n + first);
                        });
                    }
                    text.end_line();
                })?;
            }
            Ok(())
        })
    }
}

fn sorted_edge([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Returns the side of a cell that is a face of the model, with the nodes of the simplex mesh.
/// Returns `None` if the model is one layer (from a 2-D mesh) and the face is not vertical.
fn side(model: &Model, simplices: &SimplexMesh, cell: u32, mut ring: Vec<u32>) -> Option<Vec<u32>> {
    if simplices.corner_count == 3 {
        // In a layer, the edge of the 2-D mesh is the lower edge of the vertical face.
        ring.retain(|&n| (n as usize) < simplices.nodes.len());
        return (ring.len() == 2).then_some(ring);
    }
    if let (Some(split), Some(tets)) = (&model.split_mesh, &model.tets) {
        let (original_corners, split_corners) =
            (&tets.tets[cell as usize], &split.mesh.tets[cell as usize]);
        for n in &mut ring {
            let index = original_corners.iter().position(|m| m == n);
            *n = split_corners[index.unwrap_or(0)];
        }
    }
    Some(ring)
}
