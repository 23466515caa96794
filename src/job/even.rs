//! Cells more alike: atoms come where there is room for one, go where there is none, and move to the
//! middles of their cells.

use crate::geometry::scatter::Scatter;
use crate::geometry::{add_scaled, distance2, sub};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::poly::PolyMesh;
use crate::mesh::voronoi::conform::Conforming;

/// How far an atom moves towards the middle of its cell.
const CENTRE: f64 = 0.8;
/// An atom goes if a neighbour's cell is so many times as large, ...
const SMALL: f64 = 4.0;
/// ... and at last, a facet gives up its two sites.
const SMALL_SITE: f64 = 6.0;
/// Of two atoms nearer than this, in units of d, one goes.
const NEAR: f64 = 0.5;
/// Where all atoms are farther than this, in units of d, there is room for one more ...
const ROOM: f64 = 0.85;
/// ... not nearer than this to another that comes, ...
const FREE: f64 = 0.8;
/// ... nor than this to a side of the box.
const INSET: f64 = 0.25;
/// Faces smaller than this share of their mean area are tiny.
const TINY: f64 = 1.5e-3;
/// Atoms whose cells touch in a tiny face move by this share of their distance.
const OPEN: f64 = 0.02;

/// Atoms whose cells were cut, together with sites that stay; their cells come first.
pub(super) struct Even<'a, const D: usize> {
    pub atoms: &'a mut Atoms<D>,
    pub sites: &'a mut Conforming<D>,
    pub mesh: &'a PolyMesh<D>,
    pub distance: &'a Distance<D>,
    pub extent: [f64; D],
}

impl<const D: usize> Even<'_, D> {
    /// Moves atoms towards the middles of their cells; some come and some go.
    pub fn out(&mut self) {
        let shapes = self.mesh.cell_shapes();
        let first = self.atoms.len();
        let mut goes = vec![false; shapes.len()];
        for cells in &self.mesh.face_cells[..self.mesh.inner_faces()] {
            let [a, b] = cells.map(|c| c as usize);
            let (small, large) = match shapes[a].0 < shapes[b].0 {
                true => (a, b),
                false => (b, a),
            };
            goes[small] |= shapes[large].0 > SMALL * shapes[small].0;
            let [x, y] = [a, b].map(|c| self.mesh.sites[c]);
            let near = NEAR * self.distance.at(x);
            // Of two sites neither is too near to the other; the first is an atom if any is.
            if distance2(&x, &y) < near * near && !goes[a] && !goes[b] {
                let first = if self.is_free(a) { a } else { b };
                goes[first] |= self.is_free(first);
            }
        }
        let fresh = self.fresh();
        for (i, shape) in shapes[..first].iter().enumerate() {
            let x = self.atoms.positions[i];
            let to = add_scaled(x, CENTRE, sub(shape.1, x));
            if self.is_free(i) && self.sites.is_free(to) {
                self.atoms.positions[i] = to;
            }
        }
        let stays = |i: &usize| !goes[*i] || !self.is_free(*i);
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

    /// Moves atoms whose cells touch in a tiny face: those that would hardly part, apart, so that it is gone;
    /// those that a ring of four and more others keeps apart, nearer to each other, so that it grows. Facets
    /// whose cells are still much smaller than others give up their sites.
    pub fn open(&mut self) {
        let mesh = self.mesh;
        let inner = mesh.inner_faces();
        let (shapes, first) = (mesh.cell_shapes(), self.atoms.len());
        let mut small = vec![false; shapes.len()];
        for cells in &mesh.face_cells[..inner] {
            let [v, w] = cells.map(|c| shapes[c as usize].0);
            small[cells[0] as usize] |= w > SMALL_SITE * v;
            small[cells[1] as usize] |= v > SMALL_SITE * w;
        }
        self.sites
            .give_up(|i| small[first + 2 * i] || small[first + 2 * i + 1]);
        let areas: Vec<f64> = (0..inner).map(|f| mesh.face_shape(f).area()).collect();
        let tiny = TINY * areas.iter().sum::<f64>() / inner.max(1) as f64;
        let mut steps = vec![[0.0; D]; mesh.sites.len()];
        for f in (0..inner).filter(|&f| areas[f] < tiny) {
            let [a, b] = mesh.face_cells[f].map(|c| c as usize);
            let by = if mesh.faces.get(f).len() > D {
                OPEN
            } else {
                -OPEN
            };
            let line = sub(mesh.sites[b], mesh.sites[a]);
            steps[a] = add_scaled(steps[a], by, line);
            steps[b] = add_scaled(steps[b], -by, line);
        }
        for (i, step) in steps[..self.atoms.len()].iter().enumerate() {
            let to = add_scaled(self.atoms.positions[i], 1.0, *step);
            if self.is_free(i) && self.sites.is_free(to) {
                self.atoms.positions[i] = to;
            }
        }
    }

    /// Whether an atom may move.
    fn is_free(&self, atom: usize) -> bool {
        self.atoms
            .kinds
            .get(atom)
            .is_some_and(|&kind| kind != AtomKind::Fixed)
    }

    /// Places for more atoms: where cells meet far from their atoms, the farthest first.
    fn fresh(&self) -> Vec<[f64; D]> {
        let mesh = self.mesh;
        let mut atom = vec![0; mesh.nodes.len()];
        for (f, cells) in mesh.face_cells.iter().enumerate() {
            let nodes = mesh.faces.get(f).iter();
            nodes.for_each(|&n| atom[n as usize] = cells[0] as usize);
        }
        let far = |n: usize| {
            let (x, at) = (mesh.nodes[n], mesh.sites[atom[n]]);
            let d = self.distance.at(x);
            let far = distance2(&x, &at).sqrt() / d;
            let room = INSET * d;
            let inside = (0..D).all(|k| x[k] > room && x[k] < self.extent[k] - room);
            (far > ROOM && inside && self.sites.is_free(x)).then_some((far, n))
        };
        let mut places: Vec<(f64, usize)> = (0..mesh.nodes.len()).filter_map(far).collect();
        places.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        // Never more than ten million cells.
        let volume: f64 = self.extent.iter().product();
        let edge = (1.6 * self.distance.min()).max((volume / 1e7).powf(1.0 / D as f64));
        let mut fresh = Scatter::new([0.0; D], self.extent, edge);
        for x in places.into_iter().map(|(_, n)| mesh.nodes[n]) {
            if fresh.is_free(&x, FREE * self.distance.at(x)) {
                fresh.add(x);
            }
        }
        fresh.positions().to_vec()
    }
}
