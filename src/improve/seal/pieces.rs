//! Closing holes in a mesh that is in pieces. What there is to do is near the rims of surfaces: the cells there
//! are told to all, who do the same to them; which sheets are near one, whoever has it says. Rooms are united across
//! pieces.

use super::near::Near;
use super::surface::{Surface, Way};
use super::{Sealed, Sealing, local_planes};
use crate::error::cause;
use crate::feature::FeaturePoint;
use crate::files::kept::Kept;
use crate::geometry::sets::Sets;
use crate::lattice::distance::Shared;
use crate::mesh::TetMesh;
use crate::mesh::complex::{BEYOND, NONE};
use crate::mesh::piece::Piece;
use crate::observer::Patience;
use crate::ranks::{Group, joined};
use crate::{Error, Result};

/// Where surfaces grow out of what all look at, so many more rings of cells are taken in, at most.
const RINGS: usize = 4;

/// [`seal`](super::seal) of a mesh that is in pieces, which follow one another as the members of the group do;
/// `marks` are those of this piece's tetrahedra, and `points` at least those near it. What is marked, and what was
/// closed, are as in the whole mesh.
///
/// # Errors
/// [`Error::Mesh`] if the pieces do not fit one another; those of the others.
pub fn seal_pieces(
    piece: &Piece,
    points: &[FeaturePoint<3>],
    extent: [f64; 3],
    distance: &Shared<3>,
    marks: &mut [u8],
    group: &dyn Group,
    patience: &Patience<'_>,
) -> Result<Sealed> {
    let sheets = local_planes(points, extent, &distance.outline());
    let surface = Surface {
        mesh: &piece.mesh,
        neighbors: piece.neighbors.as_flattened(),
        marks,
    };
    let mut own = Own {
        piece,
        surface,
        group,
    };
    own.mark_both_sides()?;
    let mut near = Near::default();
    let mut more = own.rims()?;
    let mut rings = 1;
    let mut seen = Vec::new();
    loop {
        for _ in 0..rings {
            more = near.take(&more, piece, own.surface.marks, group)?;
        }
        let (mesh, neighbors) = near.mesh()?;
        let mut marks = near.marks();
        let surface = Surface {
            mesh: &mesh,
            neighbors: neighbors.as_flattened(),
            marks: &mut marks,
        };
        // All look at these cells, wherever they are.
        let distance = distance.near(&mesh.nodes, 0.0, group)?;
        let mut sealing = Sealing::new(surface, &sheets, &distance);
        let here = |(number, sides)| (near.place(number), sides);
        sealing.sides = seen.into_iter().map(here).collect();
        let over = || {
            let over = group.all("patience", patience.over())?;
            Ok::<_, Error>(over.contains(&true))
        };
        sealing.grow(over, |sealing, cells| {
            let own = cells.into_iter().filter(|&c| own.has(near.cell(c)));
            let own: Vec<u32> = own.collect();
            Ok(joined(
                group.all("sheets near cells", sealing.seen_from(&own))?,
            ))
        })?;
        if sealing.missed.is_empty() {
            sealing.peel();
            return own.close(&sealing, &near);
        }
        // Once more, with what was missed. What cells see is known.
        more = sealing.missed.iter().map(|&n| near.node(n)).collect();
        more.sort_unstable();
        more.dedup();
        let sides = sealing.sides.into_iter();
        seen = sides.map(|(c, sides)| (near.cell(c), sides)).collect();
        rings = RINGS.min(2 * rings);
    }
}

/// A piece, its marked faces, and those who hold the others.
struct Own<'a> {
    piece: &'a Piece,
    surface: Surface<'a, 3, TetMesh>,
    group: &'a dyn Group,
}

impl Own<'_> {
    /// For each face beyond which another piece goes on, what `value` is there.
    fn across(&self, what: &str, value: impl Fn(u32) -> u32) -> Result<Vec<(u32, u32)>> {
        // Some member hears of a face from both sides: which one, a node tells.
        let count = self.group.count();
        let mut faces = vec![Vec::new(); count];
        let mut told = vec![Vec::new(); count];
        for (face, &beyond) in (0..).zip(self.surface.neighbors) {
            if beyond == BEYOND {
                let mut name = self.surface.face(face).map(|n| self.number(n));
                name.sort_unstable();
                let to = name[0] as usize % count;
                faces[to].push(face);
                told[to].push((name, value(face)));
            }
        }
        let told = self.group.pass(what, told)?;
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
        let answers = self.group.pass(what, answers)?;
        let mut across = Vec::new();
        for (faces, answers) in faces.into_iter().zip(answers) {
            for (face, other) in faces.into_iter().zip(answers) {
                across.push((face, other.ok_or_else(|| self.alone(face))?));
            }
        }
        Ok(across)
    }

    /// A face beyond which nothing goes on, or too much.
    fn alone(&self, face: u32) -> Error {
        let nodes = self.surface.face(face).map(|n| self.number(n));
        Error::Mesh(cause(
            format!("face {nodes:?}"),
            "does not belong to two pieces of the mesh",
            "mesh the image again",
        ))
    }

    /// The whole's number of a node.
    fn number(&self, n: u32) -> u32 {
        self.piece.numbers[n as usize]
    }

    fn mark_both_sides(&mut self) -> Result<()> {
        self.surface.mark_both_sides();
        let marked = self.across("marked faces", |face| u32::from(self.surface.marked(face)))?;
        for (face, _) in marked.into_iter().filter(|(_, marked)| *marked == 1) {
            self.surface.mark(face, true);
        }
        Ok(())
    }

    /// The whole's numbers of the nodes of all rims in the mesh, rising; some on its outside may be among them.
    fn rims(&self) -> Result<Vec<u32>> {
        // Each ridge with a node of a marked face that is not on it: by both, faces are known everywhere.
        let mut met = Vec::new();
        for face in self.surface.marked_once() {
            let ridges = self.surface.ridges(face).zip(self.surface.face(face));
            met.extend(ridges.map(|(ridge, node)| (ridge, node, face)));
        }
        met.sort_unstable();
        let mut shared = vec![false; self.piece.numbers.len()];
        for n in self.piece.shared_nodes() {
            shared[n as usize] = true;
        }
        let at_cut = met
            .iter()
            .filter(|(ridge, ..)| ridge.iter().all(|&n| shared[n as usize]));
        let at_cut: Vec<[u32; 3]> = at_cut
            .map(|&([a, b], node, _)| [a, b, node].map(|n| self.number(n)))
            .collect();
        let at_cuts = self.all_sorted("ridges at cuts", at_cut)?;
        let mut rims = Vec::new();
        for faces in met.chunk_by(|a, b| a.0 == b.0) {
            let &[(ridge, _, face)] = faces else { continue };
            let nodes = ridge.map(|n| self.number(n));
            let first = at_cuts.partition_point(|told| told[..2] < nodes[..]);
            let there = at_cuts[first..].iter().take(2);
            let alone = there.filter(|told| told[..2] == nodes[..]).count() < 2;
            if alone && self.surface.round(face / 4, ridge, |_| ()) != Way::Ends {
                rims.extend(nodes);
            }
        }
        self.all_sorted("rims", rims)
    }

    /// What all have, rising, each once.
    fn all_sorted<T: Ord + Kept>(&self, what: &str, own: Vec<T>) -> Result<Vec<T>> {
        let all = self.group.all(what, own)?.into_iter();
        let mut all: Vec<T> = all.flatten().collect();
        all.sort_unstable();
        all.dedup();
        Ok(all)
    }

    /// Whether this piece has a cell of the whole mesh.
    fn has(&self, cell: usize) -> bool {
        let first = self.piece.first;
        (first..first + self.piece.mesh.tets.len()).contains(&cell)
    }

    /// This piece's number of a face of the whole mesh, if it has that.
    fn here(&self, cell: usize, k: u32) -> Option<u32> {
        (self.has(cell)).then(|| 4 * (cell - self.piece.first) as u32 + k)
    }

    /// Marks the fresh faces, which all members have found, and opens the pockets that they make.
    fn close(&mut self, sealing: &Sealing<'_, 3, TetMesh>, near: &Near) -> Result<Sealed> {
        // This piece's faces among the sides of the fresh ones.
        let mut sides = Vec::new();
        for (i, &face) in (0..).zip(&sealing.fresh) {
            let twin = sealing.surface.twin(face).unwrap_or(face);
            for (side, face) in (2 * i..).zip([face, twin]) {
                if let Some(face) = self.here(near.cell(face / 4), face % 4) {
                    self.surface.mark(face, true);
                    sides.push((side, face));
                }
            }
        }
        let (room, volume) = self.surface.rooms();
        let volumes = self.group.all("rooms", volume)?;
        let before: usize = volumes[..self.group.rank()].iter().map(Vec::len).sum();
        // Rooms of pieces are numbered as their first cells are in the whole: so are those that are united.
        let volumes = volumes.concat();
        let room_at = |face: u32| before as u32 + room[(face / 4) as usize];
        let across = self.across("rooms at cuts", room_at)?;
        let open = across
            .iter()
            .filter(|(face, _)| !self.surface.marked(*face));
        let mut pairs: Vec<[u32; 2]> = open.map(|&(face, other)| [room_at(face), other]).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut rooms = Sets::new(volumes.len());
        for [r, s] in self.all_sorted("rooms that are one", pairs)? {
            rooms.unite(r, s);
        }
        let (number, count) = rooms.numbered();
        let mut volume = vec![0.0; count];
        for (of_part, &room) in volumes.iter().zip(&number) {
            volume[room as usize] += of_part;
        }
        let room_at = |face: u32| number[room_at(face) as usize];
        let sides: Vec<(u32, u32)> = (sides.into_iter())
            .map(|(side, face)| (side, room_at(face)))
            .collect();
        let mut beside = vec![[NONE; 2]; sealing.fresh.len()];
        for (side, room) in self.all_sorted("rooms beside faces", sides)? {
            beside.as_flattened_mut()[side as usize] = room;
        }
        let opened = sealing.pockets(&volume, &beside);
        self.surface.open(&opened, |c| room_at(4 * c));
        for (face, other) in across {
            if opened.between([room_at(face), number[other as usize]]) {
                self.surface.mark(face, false);
            }
        }
        Ok(sealing.sealed(&opened, &beside, count))
    }
}
