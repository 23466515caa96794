//! Cells more alike: atoms come where there is room for one, go where there is none, and move to the
//! middles of their cells.

use std::collections::BTreeMap;

use crate::geometry::incremental_grid::IncrementalGrid;
use crate::geometry::{add_scaled, distance2, sub};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::poly::PolyMesh;
use crate::mesh::voronoi::conform::ConformingSites;

/// How far an atom moves towards the middle of its cell.
const CENTRING_STEP: f64 = 0.8;
/// An atom goes if a neighbour's cell is so many times as large, ...
const MAX_VOLUME_RATIO: f64 = 4.0;
/// ... and at last, a site goes.
const MAX_SITE_VOLUME_RATIO: f64 = 5.8;
/// Of two atoms nearer than this, in units of d, one goes.
const MIN_ATOM_DISTANCE: f64 = 0.5;
/// Where all atoms are farther than this, in units of d, there is room for one more ...
const MIN_GAP_RADIUS: f64 = 0.85;
/// ... not nearer than this to another that comes, ...
const MIN_INSERTED_DISTANCE: f64 = 0.8;
/// ... nor than this to a side of the box.
const MIN_SIDE_DISTANCE: f64 = 0.25;
/// Faces smaller than this share of their mean area are tiny.
const TINY_FACE_RATIO: f64 = 1.5e-3;
/// Atoms whose cells touch in a tiny face move, all in all, by this share of their distance.
const FACE_OPENING_SHIFT: f64 = 0.04;

/// Atoms whose cells were cut, together with sites that stay; their cells come first.
pub(super) struct CellEqualiser<'a, const D: usize> {
    pub atoms: &'a mut Atoms<D>,
    pub sites: &'a mut ConformingSites<D>,
    pub mesh: &'a PolyMesh<D>,
    pub distance: &'a Distance<D>,
    pub extent: [f64; D],
}

impl<const D: usize> CellEqualiser<'_, D> {
    /// Moves atoms towards the middles of their cells; some come and some go.
    pub fn relax(&mut self) {
        let shapes = self.mesh.cell_shapes();
        let first = self.atoms.len();
        let mut goes = vec![false; shapes.len()];
        for cells in &self.mesh.face_cells[..self.mesh.inner_face_count()] {
            let [a, b] = cells.map(|c| c as usize);
            let (small, large) = match shapes[a].0 < shapes[b].0 {
                true => (a, b),
                false => (b, a),
            };
            goes[small] |= shapes[large].0 > MAX_VOLUME_RATIO * shapes[small].0;
            let [x, y] = [a, b].map(|c| self.mesh.sites[c]);
            let near = MIN_ATOM_DISTANCE * self.distance.value_at(x);
            // Of two sites neither is too near to the other; the first is an atom if any is.
            if distance2(&x, &y) < near * near && !goes[a] && !goes[b] {
                let first = if self.is_movable(a) { a } else { b };
                goes[first] |= self.is_movable(first);
            }
        }
        let fresh = self.find_new_atoms();
        for (i, shape) in shapes[..first].iter().enumerate() {
            let x = self.atoms.positions[i];
            let to = add_scaled(x, CENTRING_STEP, sub(shape.1, x));
            if self.is_movable(i) && self.sites.is_free(to) {
                self.atoms.positions[i] = to;
            }
        }
        let stays = |i: &usize| !goes[*i] || !self.is_movable(*i);
        let staying: Vec<usize> = (0..first).filter(stays).collect();
        let Atoms { positions, kinds } = &self.atoms;
        let mut atoms = Atoms {
            positions: staying.iter().map(|&i| positions[i]).collect(),
            kinds: staying.iter().map(|&i| kinds[i]).collect(),
        };
        atoms.positions.extend(fresh);
        atoms
            .kinds
            .resize(atoms.positions.len(), AtomKind::Interior);
        *self.atoms = atoms;
    }

    /// Takes sites away whose cells are still much smaller than a neighbour's; whether there are any.
    pub fn remove_small_sites(&mut self) -> bool {
        let mesh = self.mesh;
        let (shapes, first) = (mesh.cell_shapes(), self.atoms.len());
        let mut small = vec![false; shapes.len()];
        for cells in &mesh.face_cells[..mesh.inner_face_count()] {
            let [v, w] = cells.map(|c| shapes[c as usize].0);
            small[cells[0] as usize] |= w > MAX_SITE_VOLUME_RATIO * v;
            small[cells[1] as usize] |= v > MAX_SITE_VOLUME_RATIO * w;
        }
        self.sites.remove_unfit(|i| small[first + i])
    }

    /// Moves atoms at tiny faces: those whose cells would hardly part, apart, so that the face is gone; those that a
    /// ring of four and more others keeps apart, nearer to each other, so that it grows. Where neither may move,
    /// atoms of the ring do, with the same effect.
    pub fn open_tiny_faces(&mut self) {
        let mesh = self.mesh;
        let inner = mesh.inner_face_count();
        let areas: Vec<f64> = (0..inner).map(|f| mesh.face_shape(f).area()).collect();
        let tiny = TINY_FACE_RATIO * areas.iter().sum::<f64>() / inner.max(1) as f64;
        let tiny: Vec<usize> = (0..inner).filter(|&f| areas[f] < tiny).collect();
        let cells = self.cells_at(&tiny);
        let mut steps = vec![[0.0; D]; self.atoms.len()];
        for f in tiny {
            let pair = mesh.face_cells[f].map(|c| c as usize);
            let [x, y] = pair.map(|c| mesh.sites[c]);
            let apart = if mesh.faces.get(f).len() > D {
                -FACE_OPENING_SHIFT
            } else {
                FACE_OPENING_SHIFT
            };
            let mut move_by = |movers: &[usize], target: &dyn Fn(usize) -> [f64; D], by: f64| {
                for &i in movers {
                    let away = sub(mesh.sites[i], target(i));
                    steps[i] = add_scaled(steps[i], by / movers.len() as f64, away);
                }
            };
            let ends: Vec<usize> = pair.into_iter().filter(|&c| self.is_movable(c)).collect();
            if ends.is_empty() {
                let middle = add_scaled(x, 0.5, sub(y, x));
                let (ring, fixed) = self.face_ring(f, &cells);
                move_by(
                    &ring,
                    &|_| middle,
                    if fixed { FACE_OPENING_SHIFT } else { -apart },
                );
            } else {
                move_by(&ends, &|i| if i == pair[0] { y } else { x }, apart);
            }
        }
        for (i, step) in steps.iter().enumerate() {
            let to = add_scaled(self.atoms.positions[i], 1.0, *step);
            if self.is_movable(i) && self.sites.is_free(to) {
                self.atoms.positions[i] = to;
            }
        }
    }

    /// The cells at the nodes of some faces.
    fn cells_at(&self, faces: &[usize]) -> BTreeMap<u32, Vec<u32>> {
        let mesh = self.mesh;
        let nodes = faces.iter().flat_map(|&f| mesh.faces.get(f));
        let mut at: BTreeMap<u32, Vec<u32>> = nodes.map(|&n| (n, Vec::new())).collect();
        let mut asked = vec![false; mesh.nodes.len()];
        at.keys().for_each(|&n| asked[n as usize] = true);
        for f in 0..mesh.inner_face_count() {
            for n in mesh.faces.get(f).iter().filter(|&&n| asked[n as usize]) {
                let cells = mesh.face_cells[f].iter();
                at.entry(*n).or_default().extend(cells);
            }
        }
        for cells in at.values_mut() {
            cells.sort_unstable();
            cells.dedup();
        }
        at
    }

    /// The atoms round a face that may move: of cells along its edges. And whether more cells than need be meet at
    /// a node of it, as at nodes of surfaces: then the face stays, and can but grow.
    fn face_ring(&self, face: usize, cells_at: &BTreeMap<u32, Vec<u32>>) -> (Vec<usize>, bool) {
        let nodes = self.mesh.faces.get(face).iter();
        let at: Vec<&Vec<u32>> = nodes.filter_map(|n| cells_at.get(n)).collect();
        let stays = at.iter().any(|cells| cells.len() > D + 1);
        let mut ring: Vec<u32> = at.into_iter().flatten().copied().collect();
        ring.sort_unstable();
        let pair = self.mesh.face_cells[face];
        let along_edge = ring.chunk_by(|a, b| a == b).filter(|same| same.len() > 1);
        let others = along_edge.map(|same| same[0]).filter(|c| !pair.contains(c));
        let free = others.map(|c| c as usize).filter(|&c| self.is_movable(c));
        (free.collect(), stays)
    }

    /// Whether an atom may move.
    fn is_movable(&self, atom: usize) -> bool {
        self.atoms
            .kinds
            .get(atom)
            .is_some_and(|&kind| kind != AtomKind::Fixed)
    }

    /// Places for more atoms: where cells meet far from their atoms, the farthest first.
    fn find_new_atoms(&self) -> Vec<[f64; D]> {
        let mesh = self.mesh;
        let mut atom = vec![0; mesh.nodes.len()];
        for (f, cells) in mesh.face_cells.iter().enumerate() {
            let nodes = mesh.faces.get(f).iter();
            nodes.for_each(|&n| atom[n as usize] = cells[0] as usize);
        }
        let far = |n: usize| {
            let (x, at) = (mesh.nodes[n], mesh.sites[atom[n]]);
            let d = self.distance.value_at(x);
            let far = distance2(&x, &at).sqrt() / d;
            let room = MIN_SIDE_DISTANCE * d;
            let inside = (0..D).all(|k| x[k] > room && x[k] < self.extent[k] - room);
            (far > MIN_GAP_RADIUS && inside && self.sites.is_free(x)).then_some((far, n))
        };
        let mut places: Vec<(f64, usize)> = (0..mesh.nodes.len()).filter_map(far).collect();
        places.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        // Never more than ten million cells.
        let volume: f64 = self.extent.iter().product();
        let edge = (1.6 * self.distance.min()).max((volume / 1e7).powf(1.0 / D as f64));
        let mut fresh = IncrementalGrid::new([0.0; D], self.extent, edge);
        for x in places.into_iter().map(|(_, n)| mesh.nodes[n]) {
            if fresh.is_free(&x, MIN_INSERTED_DISTANCE * self.distance.value_at(x)) {
                fresh.add(x);
            }
        }
        fresh.positions().to_vec()
    }
}
