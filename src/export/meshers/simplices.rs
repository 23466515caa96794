//! Meshes of simplices for those formats that hold nothing else: tetrahedra with triangles on what has a
//! name, or, of the plane, triangles with edges.

use std::io::Write;
use std::path::Path;

use crate::parallel::prelude::*;

use super::groups::{FaceNames, NamedSides, face_from_below};
use crate::Result;
use crate::export::containers::text::write_items;
use crate::files::Batch;
use crate::mesh::FACES;
use crate::model::reservoir::Model;

/// The edges of a tetrahedron in whose middle its further nodes are, in Abaqus' order; of a triangle the
/// first three.
pub const MIDPOINT_EDGES: [[usize; 2]; 6] = [[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]];

/// A mesh of tetrahedra or triangles.
pub struct SimplexMesh<'a> {
    /// Positions.
    pub nodes: &'a [[f64; 3]],
    /// Of a quadratic mesh the edges, ascending, each with a node in its middle, which follow the others.
    edges: Vec<[u32; 2]>,
    /// The nodes of each, one after the other.
    corners: &'a [u32],
    /// Number of nodes of each: 4, or 3.
    pub corner_count: usize,
    /// The region of each.
    pub region: &'a [i32],
    /// What has a name.
    pub named_sides: Vec<NamedSides>,
    /// The surfaces along which the mesh is torn.
    pub torn_surfaces: Vec<TornSurface>,
}

/// A surface along which a mesh is torn.
pub struct TornSurface {
    /// The surface's name, for the elements between its two sides.
    pub name: String,
    /// Its number, which no other name has.
    pub number: usize,
    /// Each face as its lower cell has it, anticlockwise seen from above, and as its upper cell has it, in
    /// the same order. At a tip nodes are the same.
    pub face_pairs: Vec<[[u32; 3]; 2]>,
    /// The lower cell and the upper one.
    pub cells: Vec<[u32; 2]>,
}

impl<'a> SimplexMesh<'a> {
    /// The simplices of a model, torn if it is.
    ///
    /// # Errors
    /// [`Error::Export`](crate::Error::Export) if the cells are others; `needs` says who asks.
    pub fn new(model: &'a Model, needs: &str) -> Result<Self> {
        let mesh = &model.mesh;
        let (corners, size, nodes) = match (&model.triangles, &model.split_mesh) {
            (Some(triangles), _) => {
                let nodes = &mesh.nodes[..mesh.nodes.len() / 2];
                (triangles.as_flattened(), 3, nodes)
            }
            (None, Some(torn)) => (torn.mesh.tets.as_flattened(), 4, &torn.mesh.nodes[..]),
            (None, None) => {
                let tets = &model.need_tets(needs)?.tets;
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
        };
        let names = FaceNames::new(model);
        let rises = model.second_cell_is_upper();
        simplices.find_torn_surfaces(model, &names, &rises);
        let is_torn = |name: &str| simplices.torn_surfaces.iter().any(|torn| torn.name == name);
        for group in names.groups() {
            if is_torn(&group.name) {
                continue;
            }
            let mut named = NamedSides::new(group.name, group.number);
            for f in group.faces {
                let (cell, ring) = face_from_below(model, &rises, f);
                if let Some(ring) = side(model, &simplices, cell, ring) {
                    named.sides.push(ring);
                    named.cells.push(cell);
                }
            }
            if !named.cells.is_empty() {
                simplices.named_sides.push(named);
            }
        }
        // What is torn comes last, both of its sides, and then what is between them.
        let mut next = names.names.len() + 1;
        let mut sides = Vec::new();
        for torn in &mut simplices.torn_surfaces {
            for (side, letter) in ["a", "b"].into_iter().enumerate() {
                let mut named = NamedSides::new(format!("{}_{letter}", torn.name), next);
                next += 1;
                for (pair, cells) in torn.face_pairs.iter().zip(&torn.cells) {
                    let [p, q, r] = pair[side];
                    named
                        .sides
                        .push(if side == 0 { [p, q, r] } else { [q, p, r] });
                    named.cells.push(cells[side]);
                }
                sides.push(named);
            }
        }
        for torn in &mut simplices.torn_surfaces {
            torn.number = next;
            next += 1;
        }
        simplices.named_sides.extend(sides);
        if model.is_quadratic {
            simplices.find_edges();
        }
        Ok(simplices)
    }

    fn find_edges(&mut self) {
        let middles = &MIDPOINT_EDGES[..self.edges_per_simplex()];
        let of = |t: usize| {
            let corners = self.get(t);
            middles
                .iter()
                .map(move |edge| sorted_edge(edge.map(|k| corners[k])))
        };
        let mut edges: Vec<[u32; 2]> = (0..self.len()).flat_map(of).collect();
        edges.par_sort_unstable();
        edges.dedup();
        self.edges = edges;
    }

    /// Number of edges of each simplex.
    fn edges_per_simplex(&self) -> usize {
        self.corner_count * (self.corner_count - 1) / 2
    }

    /// Whether there are nodes in the middle of edges.
    pub fn is_quadratic(&self) -> bool {
        !self.edges.is_empty()
    }

    /// Number of nodes, those in the middle of edges among them.
    pub fn node_count(&self) -> usize {
        self.nodes.len() + self.edges.len()
    }

    /// The position of a node.
    pub fn point(&self, node: usize) -> [f64; 3] {
        match node.checked_sub(self.nodes.len()) {
            None => self.nodes[node],
            Some(edge) => {
                let [a, b] = self.edges[edge].map(|n| self.nodes[n as usize]);
                std::array::from_fn(|k| 0.5 * (a[k] + b[k]))
            }
        }
    }

    /// Visits the nodes of a simplex, or of a side of one, with these corners: they, and if the mesh is
    /// quadratic those in the middle of its edges, in the order of [`MIDPOINT_EDGES`].
    pub fn visit_nodes(&self, corners: &[u32], mut visit: impl FnMut(u32)) {
        corners.iter().for_each(|&n| visit(n));
        if self.is_quadratic() {
            let count = corners.len() * (corners.len() - 1) / 2;
            for edge in &MIDPOINT_EDGES[..count] {
                let edge = sorted_edge(edge.map(|k| corners[k]));
                let at = self.edges.partition_point(|known| *known < edge);
                visit((self.nodes.len() + at) as u32);
            }
        }
    }

    /// Finds the surfaces along which a model is torn.
    fn find_torn_surfaces(&mut self, model: &Model, names: &FaceNames, rises: &[bool]) {
        let Some(split) = &model.split_mesh else {
            return;
        };
        let face_cells = &model.mesh.face_cells;
        let mut faces: Vec<_> = split.faces.iter().collect();
        faces.sort_by_key(|face| (face.label, face.cells));
        for own in faces.chunk_by(|a, b| a.label == b.label) {
            let number = names.surface_number(model, own[0].label);
            let mut torn = TornSurface {
                name: names.name(number).to_string(),
                number: 0,
                face_pairs: Vec::with_capacity(own.len()),
                cells: Vec::with_capacity(own.len()),
            };
            for face in own {
                let f = face_cells[..model.mesh.inner_face_count()].binary_search(&face.cells);
                let lower = usize::from(!f.is_ok_and(|f| rises[f]));
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

    /// Whether three nodes of a tetrahedron turn anticlockwise seen from outside.
    fn is_outward(&self, cell: usize, face: [u32; 3]) -> bool {
        let corners = self.get(cell);
        let at = face.map(|n| corners.iter().position(|&m| m == n).unwrap_or(0));
        let same = |ring: &[usize; 3]| (0..3).any(|k| [0, 1, 2].map(|i| ring[(i + k) % 3]) == at);
        !FACES.iter().any(same)
    }

    /// Number of simplices.
    pub fn len(&self) -> usize {
        self.corners.len() / self.corner_count
    }

    /// The nodes of one.
    pub fn get(&self, i: usize) -> &[u32] {
        &self.corners[i * self.corner_count..][..self.corner_count]
    }

    /// Number of sides that have a name.
    pub fn named_side_count(&self) -> usize {
        self.named_sides.iter().map(|named| named.cells.len()).sum()
    }

    /// The first number that no name has.
    pub fn next_number(&self) -> usize {
        let named = self.named_sides.iter().map(|named| named.number);
        let torn = self.torn_surfaces.iter().map(|torn| torn.number);
        named.chain(torn).max().unwrap_or(0) + 1
    }

    /// Writes the twin faces of a torn mesh to `NAME-twins.csv` beside the file: surface, cells and nodes of
    /// the lower side and the upper one. Numbers begin with `first`.
    pub fn write_face_pairs(&self, batch: &mut Batch, path: &Path, first: u32) -> Result<()> {
        if self.torn_surfaces.is_empty() {
            return Ok(());
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        batch.write(&path.with_file_name(format!("{stem}-twins.csv")), |out| {
            writeln!(out, "surface,cell_a,cell_b,a1,a2,a3,b1,b2,b3")?;
            for torn in &self.torn_surfaces {
                write_items(out, torn.face_pairs.len(), |text, i| {
                    text.word(&torn.name);
                    for n in torn.cells[i]
                        .iter()
                        .chain(torn.face_pairs[i].as_flattened())
                    {
                        text.word(",").int(n + first);
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

/// The side of a cell that is one of a model's faces, as its own simplices have it; `None` of a layer's
/// faces that are not upright.
fn side(model: &Model, simplices: &SimplexMesh, cell: u32, mut ring: Vec<u32>) -> Option<Vec<u32>> {
    if simplices.corner_count == 3 {
        // Of a layer's upright faces the lower edge.
        ring.retain(|&n| (n as usize) < simplices.nodes.len());
        return (ring.len() == 2).then_some(ring);
    }
    if let (Some(torn), Some(tets)) = (&model.split_mesh, &model.tets) {
        let (before, after) = (&tets.tets[cell as usize], &torn.mesh.tets[cell as usize]);
        for n in &mut ring {
            let at = before.iter().position(|m| m == n);
            *n = after[at.unwrap_or(0)];
        }
    }
    Some(ring)
}
