//! A mesh as those see it who measure it: all of it, or some cells, of which others hold the rest. So what is
//! measured is written once.

use super::piece::Piece;
use super::{Simplices, TetMesh};
use crate::files::kept::Kept;
use crate::ranks::{Alone, Group, Holders};

/// Some of a mesh's cells, one after the other, or all; and who holds the others.
pub struct Part<'a, const D: usize, M, H: ?Sized> {
    /// The cells, and their nodes.
    pub mesh: &'a M,
    /// The whole's number of each node, rising; `None` if this is the whole.
    numbers: Option<&'a [u32]>,
    /// The nodes that others may have too, rising.
    shared: Vec<u32>,
    /// The whole's number of the first cell.
    pub first: usize,
    /// Nodes and cells of the whole.
    pub whole: [usize; 2],
    /// Who holds the parts.
    pub holders: &'a H,
}

impl<'a, const D: usize, M: Simplices<D>> Part<'a, D, M, Alone> {
    /// All of a mesh.
    pub fn all(mesh: &'a M) -> Self {
        Self {
            mesh,
            numbers: None,
            shared: Vec::new(),
            first: 0,
            whole: [mesh.nodes().len(), mesh.len()],
            holders: &Alone,
        }
    }
}

impl<'a> Part<'a, 3, TetMesh, dyn Group + 'a> {
    /// A piece of a mesh of which the group holds one each.
    pub fn of(piece: &'a Piece, group: &'a (dyn Group + 'a)) -> Self {
        Self {
            mesh: &piece.mesh,
            numbers: Some(&piece.numbers),
            shared: piece.shared_nodes(),
            first: piece.first,
            whole: piece.whole,
            holders: group,
        }
    }
}

impl<'a, const D: usize, M: Simplices<D>> Part<'a, D, M, dyn Group + 'a> {
    /// The cells that one of a group has, of which the `first` has this number in the whole: for what is measured cell
    /// by cell. There are so many nodes and cells in the `whole`.
    pub fn of_cells(
        mesh: &'a M,
        first: usize,
        whole: [usize; 2],
        group: &'a (dyn Group + 'a),
    ) -> Self {
        Self {
            mesh,
            numbers: None,
            shared: Vec::new(),
            first,
            whole,
            holders: group,
        }
    }
}

impl<'a, const D: usize, M: Simplices<D>, H: Holders + ?Sized> Part<'a, D, M, H> {
    /// The same cells with nodes elsewhere.
    pub fn with_mesh(self, mesh: &'a M) -> Self {
        Self { mesh, ..self }
    }

    /// The whole's number of a node.
    #[inline]
    pub fn number(&self, node: u32) -> u32 {
        self.numbers.map_or(node, |numbers| numbers[node as usize])
    }

    /// The node here that has this number in the whole.
    pub fn here(&self, number: u32) -> Option<u32> {
        match self.numbers {
            None => Some(number),
            Some(numbers) => numbers.binary_search(&number).ok().map(|n| n as u32),
        }
    }

    /// Whether others may have a node, for each.
    pub fn is_shared(&self) -> Vec<bool> {
        let mut is_shared = vec![false; self.mesh.nodes().len()];
        for &node in &self.shared {
            is_shared[node as usize] = true;
        }
        is_shared
    }

    /// Marks the nodes here that are marked in any part.
    ///
    /// # Errors
    /// Those of the others.
    pub fn any_of_shared(&self, what: &str, marks: &mut [bool]) -> Result<(), H::Error> {
        let owner = |node: u32| self.holders.owner(self.number(node), self.whole[0]);
        let mut to = vec![Vec::new(); self.holders.count()];
        for &node in &self.shared {
            to[owner(node)].push((self.number(node), marks[node as usize]));
        }
        let mut told = self.holders.passed(what, to)?;
        let marked = told.iter().flatten().filter(|(_, marked)| *marked);
        let mut marked: Vec<u32> = marked.map(|(number, _)| *number).collect();
        marked.sort_unstable();
        for (number, is_marked) in told.iter_mut().flatten() {
            *is_marked = marked.binary_search(number).is_ok();
        }
        for (number, is_marked) in self.holders.passed(what, told)?.into_iter().flatten() {
            if let Some(node) = self.here(number) {
                marks[node as usize] |= is_marked;
            }
        }
        Ok(())
    }

    /// What each part that has a node says of it, of the nodes that parts share: at one of them for each node, by
    /// the whole's numbers, rising.
    ///
    /// # Errors
    /// Those of the others.
    pub fn said_of_shared<T: Kept>(
        &self,
        what: &str,
        of: impl Fn(u32) -> T,
    ) -> Result<Vec<(u32, T)>, H::Error> {
        let mut to: Vec<Vec<(u32, T)>> = (0..self.holders.count()).map(|_| Vec::new()).collect();
        for &node in &self.shared {
            let number = self.number(node);
            to[self.holders.owner(number, self.whole[0])].push((number, of(node)));
        }
        let from = self.holders.passed(what, to)?;
        let mut said: Vec<(u32, T)> = from.into_iter().flatten().collect();
        said.sort_by_key(|(number, _)| *number);
        Ok(said)
    }
}
