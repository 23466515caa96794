//! Closing holes in a mesh that is in pieces. What there is to do is near the rims of surfaces: the cells there
//! are told to all, who do the same to them; which sheets are near one, whoever has it says. Rooms are united across
//! pieces.

use super::gathered_cells::GatheredCells;
use super::surface::{MarkedSurface, RidgeFan};
use super::{SealReport, Sealer, local_planes};
use crate::comm::{Comm, concatenate};
use crate::error::cause;
use crate::feature::FeaturePoint;
use crate::files::codec::Codec;
use crate::geometry::union_find::UnionFind;
use crate::lattice::distance::DistributedDistance;
use crate::mesh::TetMesh;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::partition::MeshPartition;
use crate::progress::CancelToken;
use crate::{Error, Result};

/// Where surfaces grow out of what all look at, so many more rings of cells are taken in, at most.
const MAX_RINGS: usize = 4;

/// [`seal`](super::seal) of a mesh that is in pieces, which follow one another as the members of the group do;
/// `marks` are those of this piece's tetrahedra, and `points` at least those near it. What is marked, and what was
/// closed, are as in the whole mesh.
///
/// # Errors
/// [`Error::Mesh`] if the pieces do not fit one another; those of the others.
pub fn seal_distributed(
    piece: &MeshPartition,
    points: &[FeaturePoint<3>],
    extent: [f64; 3],
    distance: &DistributedDistance<3>,
    marks: &mut [u8],
    group: &dyn Comm,
    patience: &CancelToken<'_>,
) -> Result<SealReport> {
    let sheets = local_planes(points, extent, &distance.outline());
    let surface = MarkedSurface {
        mesh: &piece.mesh,
        neighbors: piece.neighbors.as_flattened(),
        marks,
    };
    let mut own = LocalSurface {
        partition: piece,
        surface,
        comm: group,
    };
    own.mark_both_sides()?;
    let mut near = GatheredCells::default();
    let mut more = own.rim_nodes()?;
    let mut rings = 1;
    let mut seen = Vec::new();
    loop {
        for _ in 0..rings {
            more = near.gather(&more, piece, own.surface.marks, group)?;
        }
        let (mesh, neighbors) = near.local_mesh()?;
        let mut marks = near.local_marks();
        let surface = MarkedSurface {
            mesh: &mesh,
            neighbors: neighbors.as_flattened(),
            marks: &mut marks,
        };
        // All look at these cells, wherever they are.
        let distance = distance.fetch_near(&mesh.nodes, 0.0, group)?;
        let mut sealing = Sealer::new(surface, &sheets, &distance);
        let here = |(number, sides)| (near.local_cell(number), sides);
        sealing.cell_planes = seen.into_iter().map(here).collect();
        let over = || {
            let over = group.all_gather("patience", patience.is_cancelled())?;
            Ok::<_, Error>(over.contains(&true))
        };
        sealing.grow(over, |sealing, cells| {
            let own = cells
                .into_iter()
                .filter(|&c| own.has_cell(near.global_cell(c)));
            let own: Vec<u32> = own.collect();
            Ok(concatenate(group.all_gather(
                "sheets near cells",
                sealing.planes_near_cells(&own),
            )?))
        })?;
        if sealing.incomplete_nodes.is_empty() {
            sealing.remove_overhangs();
            return own.close_holes(&sealing, &near);
        }
        // Once more, with what was missed. What cells see is known.
        more = sealing
            .incomplete_nodes
            .iter()
            .map(|&n| near.global_node(n))
            .collect();
        more.sort_unstable();
        more.dedup();
        let sides = sealing.cell_planes.into_iter();
        seen = sides
            .map(|(c, sides)| (near.global_cell(c), sides))
            .collect();
        rings = MAX_RINGS.min(2 * rings);
    }
}

/// A piece, its marked faces, and those who hold the others.
struct LocalSurface<'a> {
    partition: &'a MeshPartition,
    surface: MarkedSurface<'a, 3, TetMesh>,
    comm: &'a dyn Comm,
}

impl LocalSurface<'_> {
    /// For each face beyond which another piece goes on, what `value` is there.
    fn values_across(&self, what: &str, value: impl Fn(u32) -> u32) -> Result<Vec<(u32, u32)>> {
        // Some member hears of a face from both sides: which one, a node tells.
        let count = self.comm.size();
        let mut faces = vec![Vec::new(); count];
        let mut told = vec![Vec::new(); count];
        for (face, &beyond) in (0..).zip(self.surface.neighbors) {
            if beyond == NOT_LOCAL {
                let mut name = self.surface.face_nodes(face).map(|n| self.global_node(n));
                name.sort_unstable();
                let to = name[0] as usize % count;
                faces[to].push(face);
                told[to].push((name, value(face)));
            }
        }
        let told = self.comm.all_to_all(what, told)?;
        let mut both = Vec::new();
        for (from, told) in told.iter().enumerate() {
            let told = told.iter().enumerate();
            both.extend(told.map(|(place, &(name, value))| (name, from, place, value)));
        }
        both.sort_unstable();
        let mut answers: Vec<Vec<Option<u32>>> =
            told.iter().map(|told| vec![None; told.len()]).collect();
        for sides in both.chunk_by(|a, b| a.0 == b.0) {
            if let &[(_, from, place, value), (_, to, there, other)] = sides {
                answers[from][place] = Some(other);
                answers[to][there] = Some(value);
            }
        }
        let answers = self.comm.all_to_all(what, answers)?;
        let mut across = Vec::new();
        for (faces, answers) in faces.into_iter().zip(answers) {
            for (face, other) in faces.into_iter().zip(answers) {
                across.push((face, other.ok_or_else(|| self.unmatched_face_error(face))?));
            }
        }
        Ok(across)
    }

    /// A face beyond which nothing goes on, or too much.
    fn unmatched_face_error(&self, face: u32) -> Error {
        let nodes = self.surface.face_nodes(face).map(|n| self.global_node(n));
        Error::Mesh(cause(
            format!("face {nodes:?}"),
            "does not belong to two pieces of the mesh",
            "mesh the image again",
        ))
    }

    /// The whole's number of a node.
    fn global_node(&self, n: u32) -> u32 {
        self.partition.global_ids[n as usize]
    }

    fn mark_both_sides(&mut self) -> Result<()> {
        self.surface.mark_both_sides();
        let marked = self.values_across("marked faces", |face| {
            u32::from(self.surface.is_marked(face))
        })?;
        for (face, _) in marked.into_iter().filter(|(_, marked)| *marked == 1) {
            self.surface.set_mark(face, true);
        }
        Ok(())
    }

    /// The whole's numbers of the nodes of all rims in the mesh, rising; some on its outside may be among them.
    fn rim_nodes(&self) -> Result<Vec<u32>> {
        // Each ridge with a node of a marked face that is not on it: by both, faces are known everywhere.
        let mut met = Vec::new();
        for face in self.surface.unique_marked_faces() {
            let ridges = self.surface.ridges(face).zip(self.surface.face_nodes(face));
            met.extend(ridges.map(|(ridge, node)| (ridge, node, face)));
        }
        met.sort_unstable();
        let mut shared = vec![false; self.partition.global_ids.len()];
        for n in self.partition.shared_nodes() {
            shared[n as usize] = true;
        }
        let at_cut = met
            .iter()
            .filter(|(ridge, ..)| ridge.iter().all(|&n| shared[n as usize]));
        let at_cut: Vec<[u32; 3]> = at_cut
            .map(|&([a, b], node, _)| [a, b, node].map(|n| self.global_node(n)))
            .collect();
        let at_cuts = self.all_gather_sorted("ridges at cuts", at_cut)?;
        let mut rims = Vec::new();
        for faces in met.chunk_by(|a, b| a.0 == b.0) {
            let &[(ridge, _, face)] = faces else { continue };
            let nodes = ridge.map(|n| self.global_node(n));
            let first = at_cuts.partition_point(|told| told[..2] < nodes[..]);
            let there = at_cuts[first..].iter().take(2);
            let alone = there.filter(|told| told[..2] == nodes[..]).count() < 2;
            if alone
                && self.surface.visit_ridge_cells(face / 4, ridge, |_| ()) != RidgeFan::AtBoundary
            {
                rims.extend(nodes);
            }
        }
        self.all_gather_sorted("rims", rims)
    }

    /// What all have, rising, each once.
    fn all_gather_sorted<T: Ord + Codec>(&self, what: &str, own: Vec<T>) -> Result<Vec<T>> {
        let all = self.comm.all_gather(what, own)?.into_iter();
        let mut all: Vec<T> = all.flatten().collect();
        all.sort_unstable();
        all.dedup();
        Ok(all)
    }

    /// Whether this piece has a cell of the whole mesh.
    fn has_cell(&self, cell: usize) -> bool {
        let first = self.partition.first_cell;
        (first..first + self.partition.mesh.tets.len()).contains(&cell)
    }

    /// This piece's number of a face of the whole mesh, if it has that.
    fn local_face(&self, cell: usize, k: u32) -> Option<u32> {
        (self.has_cell(cell)).then(|| 4 * (cell - self.partition.first_cell) as u32 + k)
    }

    /// Marks the fresh faces, which all members have found, and opens the pockets that they make.
    fn close_holes(
        &mut self,
        sealing: &Sealer<'_, 3, TetMesh>,
        near: &GatheredCells,
    ) -> Result<SealReport> {
        // This piece's faces among the sides of the fresh ones.
        let mut sides = Vec::new();
        for (i, &face) in (0..).zip(&sealing.new_faces) {
            let twin = sealing.surface.twin(face).unwrap_or(face);
            for (side, face) in (2 * i..).zip([face, twin]) {
                if let Some(face) = self.local_face(near.global_cell(face / 4), face % 4) {
                    self.surface.set_mark(face, true);
                    sides.push((side, face));
                }
            }
        }
        let (room, volume) = self.surface.compartments();
        let volumes = self.comm.all_gather("rooms", volume)?;
        let before: usize = volumes[..self.comm.rank()].iter().map(Vec::len).sum();
        // Rooms of pieces are numbered as their first cells are in the whole: so are those that are united.
        let volumes = volumes.concat();
        let room_at = |face: u32| before as u32 + room[(face / 4) as usize];
        let across = self.values_across("rooms at cuts", room_at)?;
        let open = across
            .iter()
            .filter(|(face, _)| !self.surface.is_marked(*face));
        let mut pairs: Vec<[u32; 2]> = open.map(|&(face, other)| [room_at(face), other]).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut rooms = UnionFind::new(volumes.len());
        for [r, s] in self.all_gather_sorted("rooms that are one", pairs)? {
            rooms.unite(r, s);
        }
        let (number, count) = rooms.into_labels();
        let mut volume = vec![0.0; count];
        for (of_part, &room) in volumes.iter().zip(&number) {
            volume[room as usize] += of_part;
        }
        let room_at = |face: u32| number[room_at(face) as usize];
        let sides: Vec<(u32, u32)> = (sides.into_iter())
            .map(|(side, face)| (side, room_at(face)))
            .collect();
        let mut beside = vec![[NONE; 2]; sealing.new_faces.len()];
        for (side, room) in self.all_gather_sorted("rooms beside faces", sides)? {
            beside.as_flattened_mut()[side as usize] = room;
        }
        let opened = sealing.find_pockets(&volume, &beside);
        self.surface.unmark_between(&opened, |c| room_at(4 * c));
        for (face, other) in across {
            if opened.contains([room_at(face), number[other as usize]]) {
                self.surface.set_mark(face, false);
            }
        }
        Ok(sealing.report(&opened, &beside, count))
    }
}
