//! Makes Voronoi cells more equal in size: atoms are added where there is room, removed where there
//! is none, and moved to the centroids of their cells.

use super::local_cells::{LocalCells, neighbours};
use super::skew_faces::SkewFaces;
use crate::geometry::cell_list::CellList;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::geometry::{add_scaled, distance2, norm, sorted_distinct, sub};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::complex::NONE;
use crate::mesh::poly::{Lists, PolyMesh};
use crate::mesh::voronoi::conform::ConformingSites;
use crate::mesh::{Dimension, Space};
use crate::parallel::prelude::*;

/// Fraction of the distance to the centroid of its cell by which an atom moves.
const CENTRING_STEP: f64 = 0.8;
/// Ratio of a neighbour cell's volume to its own from which an atom is removed.
const MAX_VOLUME_RATIO: f64 = 4.0;
/// Ratio of a neighbour cell's volume to its own from which a site is removed in the final rounds, and an
/// atom at a skew face is not placed.
pub(super) const MAX_SITE_VOLUME_RATIO: f64 = 5.8;
/// Ratio of a cell's volume to that of a site next to it from which an atom is added in the cell.
const MAX_UNSPLIT_VOLUME_RATIO: f64 = 4.5;
/// Smallest distance of such an atom from others, in units of d.
const MIN_SPLIT_DISTANCE: f64 = 0.5;
/// Distance of two atoms, in units of d, below which one of them is removed.
const MIN_ATOM_DISTANCE: f64 = 0.5;
/// Distance to all atoms, in units of d, from which there is room for a new atom.
const MIN_GAP_RADIUS: f64 = 0.85;
/// Smallest distance between two new atoms, in units of d.
const MIN_INSERTED_DISTANCE: f64 = 0.8;
/// Smallest distance of a new atom from a side of the box, in units of d.
const MIN_SIDE_DISTANCE: f64 = 0.25;
/// Ratio of a face's area to the mean area of faces below which the face is tiny.
const TINY_FACE_RATIO: f64 = 1.5e-3;
/// Distance, in units of d, from sites and fixed atoms that an atom needs on the sphere of a surface's
/// node.
const MIN_SITE_DISTANCE: f64 = 0.3;
/// Distance, in units of d, up to which such an atom takes the place of another one.
const MAX_REPLACED_DISTANCE: f64 = 0.7;
/// Distances by which atoms at tiny faces may move, in units of d.
const OPENING_SHIFTS: [f64; 2] = [0.04, 0.08];
/// Distances, in units of d, of other positions from the centre of a skew face or from an atom near it.
const SKEW_FACE_SHIFTS: [f64; 4] = [0.03, 0.06, 0.12, 0.2];

/// Atoms and sites whose cells were cut. Sites do not move; the cells of atoms come first.
pub(super) struct CellEqualiser<'a, const D: usize> {
    pub atoms: &'a mut Atoms<D>,
    pub sites: &'a mut ConformingSites<D>,
    pub mesh: &'a PolyMesh<D>,
    pub distance: &'a Distance<D>,
    pub extent: [f64; D],
}

impl<const D: usize> CellEqualiser<'_, D> {
    /// Moves atoms towards the centroids of their cells, removes atoms in small cells, and adds
    /// atoms in gaps.
    pub fn relax(&mut self) {
        let shapes = self.mesh.cell_shapes();
        let atom_count = self.atoms.len();
        let mut is_removed = vec![false; shapes.len()];
        for cells in &self.mesh.face_cells[..self.mesh.inner_face_count()] {
            let [a, b] = cells.map(|c| c as usize);
            let (small, large) = if shapes[a].0 < shapes[b].0 {
                (a, b)
            } else {
                (b, a)
            };
            is_removed[small] |= shapes[large].0 > MAX_VOLUME_RATIO * shapes[small].0;
            let [x, y] = [a, b].map(|c| self.mesh.sites[c]);
            let min_distance = MIN_ATOM_DISTANCE * self.distance.value_at(x);
            // Sites are never too close to each other; if one of the two is an atom, the first is.
            if distance2(&x, &y) < min_distance * min_distance && !is_removed[a] && !is_removed[b] {
                let candidate = if self.is_movable(a) { a } else { b };
                is_removed[candidate] |= self.is_movable(candidate);
            }
        }
        let new_atoms = self.find_new_atoms();
        for (i, shape) in shapes[..atom_count].iter().enumerate() {
            let x = self.atoms.positions[i];
            let target = add_scaled(x, CENTRING_STEP, sub(shape.1, x));
            if self.is_movable(i) && self.sites.is_free(target) {
                self.atoms.positions[i] = target;
            }
        }
        let is_kept = |i: &usize| !is_removed[*i] || !self.is_movable(*i);
        let kept: Vec<usize> = (0..atom_count).filter(is_kept).collect();
        let Atoms { positions, kinds } = &self.atoms;
        let mut atoms = Atoms {
            positions: kept.iter().map(|&i| positions[i]).collect(),
            kinds: kept.iter().map(|&i| kinds[i]).collect(),
        };
        atoms.positions.extend(new_atoms);
        atoms
            .kinds
            .resize(atoms.positions.len(), AtomKind::Interior);
        *self.atoms = atoms;
    }

    /// Adds atoms in cells that are much larger than the cell of a site next to them: at the node of
    /// the cell that is farthest from its atom.
    pub fn split_large_cells(&mut self) {
        let mesh = self.mesh;
        let (shapes, atom_count) = (mesh.cell_shapes(), self.atoms.len());
        let mut is_large = vec![false; shapes.len()];
        for &[a, b] in &mesh.face_cells[..mesh.inner_face_count()] {
            for [small, large] in [[a, b], [b, a]].map(|cells| cells.map(|c| c as usize)) {
                is_large[large] |= small >= atom_count
                    && shapes[large].0 > MAX_UNSPLIT_VOLUME_RATIO * shapes[small].0;
            }
        }
        let mut farthest = vec![(MIN_SPLIT_DISTANCE, NONE); shapes.len()];
        for (f, cells) in mesh.face_cells.iter().enumerate() {
            let cells = cells.map(|c| c as usize);
            for cell in cells
                .into_iter()
                .filter(|&c| is_large.get(c) == Some(&true))
            {
                for &n in mesh.faces.get(f) {
                    let gap = self.gap_at(n as usize, cell);
                    if let Some(gap) = gap.filter(|&gap| (gap, n) > farthest[cell]) {
                        farthest[cell] = (gap, n);
                    }
                }
            }
        }
        let candidates = farthest.into_iter().filter(|&(_, n)| n != NONE);
        let new_atoms = self.spaced_nodes(candidates.collect(), MIN_SPLIT_DISTANCE);
        self.atoms.positions.extend(new_atoms);
        let count = self.atoms.positions.len();
        self.atoms.kinds.resize(count, AtomKind::Interior);
    }

    /// Removes sites whose cells are still much smaller than a neighbour's. Returns `true` if there
    /// are any.
    pub fn remove_small_sites(&mut self) -> bool {
        let mesh = self.mesh;
        let (shapes, atom_count) = (mesh.cell_shapes(), self.atoms.len());
        let mut small = vec![false; shapes.len()];
        for cells in &mesh.face_cells[..mesh.inner_face_count()] {
            let [v, w] = cells.map(|c| shapes[c as usize].0);
            small[cells[0] as usize] |= w > MAX_SITE_VOLUME_RATIO * v;
            small[cells[1] as usize] |= v > MAX_SITE_VOLUME_RATIO * w;
        }
        self.sites.remove_unfit(|i| small[atom_count + i])
    }

    /// Moves the atoms whose cells touch in tiny faces, so that these faces vanish or grow. Each atom
    /// tries some positions and takes the one with the fewest tiny faces around it. Atoms that are
    /// close to one another move in different rounds.
    pub fn open_tiny_faces(&mut self) {
        let mesh = self.mesh;
        let areas = self.face_areas();
        let max_area = self.max_tiny_area(&areas);
        let tiny: Vec<usize> = (0..areas.len()).filter(|&f| areas[f] < max_area).collect();
        let neighbours = neighbours(mesh);
        let movers: Vec<usize> = self.atoms_at(&tiny);
        let moves: Vec<Option<[f64; D]>> = (movers.par_iter())
            .map(|&atom| self.best_move(atom, &neighbours, max_area))
            .collect();
        let mut is_near_move = vec![false; mesh.sites.len()];
        for (&atom, target) in movers.iter().zip(moves) {
            let Some(target) = target else { continue };
            let near = || neighbours.get(atom).iter().map(|&c| c as usize);
            if near().chain([atom]).any(|c| is_near_move[c]) {
                continue;
            }
            near().chain([atom]).for_each(|c| is_near_move[c] = true);
            self.atoms.positions[atom] = target;
        }
    }

    /// Adds or moves atoms where faces are skew, so that fewer are; if there is no room for that, removes
    /// the sites of the faces. Returns `false` if nothing changed.
    pub fn remove_skew_faces(&mut self) -> bool
    where
        Space<D>: Dimension<D>,
    {
        let Some(found) = SkewFaces::find(self).map(|faces| faces.changes()) else {
            return false;
        };
        let count = self.atoms.len();
        for change in &found.changes {
            match change.atom {
                Some(atom) => self.atoms.positions[atom] = change.position,
                None => {
                    self.atoms.positions.push(change.position);
                    self.atoms.kinds.push(AtomKind::Interior);
                }
            }
        }
        if !found.changes.is_empty() {
            return true;
        }
        let unfit = common_cells(found.unchanged, count);
        self.sites.remove_unfit(|i| unfit.contains(&(count + i)))
    }

    /// Places atoms on the spheres of surface nodes at which two sites touch in a tiny face: the
    /// nearest atom moves there, or a new one is added. Its cell reaches the node and
    /// separates the two. These atoms do not move any more.
    pub fn separate_sites(&mut self) {
        let (mesh, areas) = (self.mesh, self.face_areas());
        let max_area = self.max_tiny_area(&areas);
        let count = self.atoms.len();
        let cells = CellList::new(&mesh.sites, self.distance.min());
        let mut placed = self.empty_grid();
        for f in (0..areas.len()).filter(|&f| areas[f] < max_area) {
            if (mesh.face_cells[f][0] as usize) < count {
                continue;
            }
            let towards = mesh.face_shape(f).apex;
            let mut nodes = mesh.faces.get(f).iter().map(|&n| mesh.nodes[n as usize]);
            let Some(x) = nodes.find_map(|x| self.sites.sphere_point(x, towards)) else {
                continue;
            };
            let d = self.distance.value_at(x);
            let is_inside = (0..D).all(|k| x[k].min(self.extent[k] - x[k]) > MIN_SIDE_DISTANCE * d);
            if !is_inside || !placed.is_free(&x, MIN_ATOM_DISTANCE * d) {
                continue;
            }
            // The nearest atom that may move, and whether a site or an atom that may not is too near.
            let (mut nearest, mut is_taken) = (None, false);
            cells.visit_within(x, MAX_REPLACED_DISTANCE * d, |i| {
                let distance = distance2(&mesh.sites[i], &x).sqrt() / d;
                if !self.is_movable(i) {
                    is_taken |= distance < MIN_SITE_DISTANCE;
                } else if distance < MAX_REPLACED_DISTANCE
                    && nearest.is_none_or(|best| (distance, i) < best)
                {
                    nearest = Some((distance, i));
                }
            });
            if !is_taken {
                self.place_fixed(x, nearest.map(|(_, i)| i));
                placed.add(x);
            }
        }
    }

    /// Moves an atom to `x`, or adds one there. It does not move any more.
    fn place_fixed(&mut self, x: [f64; D], atom: Option<usize>) {
        match atom {
            Some(i) => {
                self.atoms.positions[i] = x;
                self.atoms.kinds[i] = AtomKind::Fixed;
            }
            None => {
                self.atoms.positions.push(x);
                self.atoms.kinds.push(AtomKind::Fixed);
            }
        }
    }

    /// Returns the areas of the faces between cells.
    fn face_areas(&self) -> Vec<f64> {
        let inner = self.mesh.inner_face_count();
        (0..inner)
            .into_par_iter()
            .map(|f| self.mesh.face_shape(f).area())
            .collect()
    }

    /// Returns the area below which a face is tiny.
    fn max_tiny_area(&self, areas: &[f64]) -> f64 {
        TINY_FACE_RATIO * areas.iter().sum::<f64>() / areas.len().max(1) as f64
    }

    /// Returns the movable atoms of the cells that touch in some of the faces, ascending.
    fn atoms_at(&self, faces: &[usize]) -> Vec<usize> {
        let cells = faces.iter().flat_map(|&f| self.mesh.face_cells[f]);
        sorted_distinct(cells.map(|c| c as usize).filter(|&c| self.is_movable(c)))
    }

    /// Returns the position near an atom where it has the fewest tiny faces around it, if there is
    /// one with fewer than now.
    fn best_move(&self, atom: usize, neighbours: &Lists, max_area: f64) -> Option<[f64; D]> {
        let mut local = LocalCells::new(self.mesh, self.extent, atom, neighbours, max_area);
        let x = self.mesh.sites[atom];
        let d = self.distance.value_at(x);
        let (mut fewest, mut best) = (local.count_tiny_faces(x, usize::MAX), None);
        for target in positions_around(x, d, &OPENING_SHIFTS) {
            if fewest > 0 && self.may_move_to(x, target) {
                let count = local.count_tiny_faces(target, fewest);
                if count < fewest {
                    (fewest, best) = (count, Some(target));
                }
            }
        }
        best
    }

    /// Returns the distance of a position from the nearest side of the box, or the smallest distance
    /// of a new atom if that is less.
    fn side_distance(&self, x: &[f64; D]) -> f64 {
        let distances = (0..D).map(|k| x[k].min(self.extent[k] - x[k]));
        distances.fold(MIN_SIDE_DISTANCE * self.distance.value_at(*x), f64::min)
    }

    /// Returns `true` if an atom at `x` may move to `target`.
    fn may_move_to(&self, x: [f64; D], target: [f64; D]) -> bool {
        self.side_distance(&target) >= self.side_distance(&x) && self.sites.is_free(target)
    }

    /// Returns the positions near a skew face to which an atom may move; `None` for a cell whose site may
    /// not move.
    pub(super) fn targets_of(&self, cell: usize) -> Option<impl Iterator<Item = [f64; D]>> {
        let x = self.mesh.sites[cell];
        let d = self.is_movable(cell).then(|| self.distance.value_at(x))?;
        let targets = positions_around(x, d, &SKEW_FACE_SHIFTS);
        Some(targets.filter(move |&target| self.may_move_to(x, target)))
    }

    /// Returns positions for a new atom at the centre of a skew face or near it. Where a ball covers one,
    /// the nearest position on its sphere is returned, from which a cell reaches the surface's node.
    pub(super) fn new_positions(&self, centre: [f64; D]) -> Vec<[f64; D]> {
        let d = self.distance.value_at(centre);
        let on_sphere = self.sites.nearest_sphere_point(centre);
        let starts = [Some(centre), on_sphere].into_iter().flatten();
        let others = positions_around(centre, d, &SKEW_FACE_SHIFTS)
            .map(|x| self.sites.nearest_sphere_point(x).unwrap_or(x));
        let is_inside = |x: &[f64; D]| self.side_distance(x) >= MIN_SIDE_DISTANCE * d;
        let all = starts.chain(others);
        all.filter(|x| is_inside(x) && self.sites.is_free(*x))
            .collect()
    }

    /// Returns `true` if an atom may move.
    fn is_movable(&self, atom: usize) -> bool {
        self.atoms
            .kinds
            .get(atom)
            .is_some_and(|&kind| kind != AtomKind::Fixed)
    }

    /// Returns positions for new atoms: nodes of cells far from their atoms, the farthest first.
    fn find_new_atoms(&self) -> Vec<[f64; D]> {
        let mesh = self.mesh;
        let mut atom = vec![0; mesh.nodes.len()];
        for (f, cells) in mesh.face_cells.iter().enumerate() {
            let nodes = mesh.faces.get(f).iter();
            nodes.for_each(|&n| atom[n as usize] = cells[0] as usize);
        }
        let candidate = |n: usize| {
            let gap = self
                .gap_at(n, atom[n])
                .filter(|gap| *gap > MIN_GAP_RADIUS)?;
            Some((gap, n as u32))
        };
        let candidates = (0..mesh.nodes.len()).filter_map(candidate).collect();
        self.spaced_nodes(candidates, MIN_INSERTED_DISTANCE)
    }

    /// Returns the distance of a node from the site of one of its cells, in units of d; `None` if an
    /// atom cannot be there.
    fn gap_at(&self, node: usize, cell: usize) -> Option<f64> {
        let x = self.mesh.nodes[node];
        let d = self.distance.value_at(x);
        let gap = distance2(&x, &self.mesh.sites[cell]).sqrt() / d;
        let margin = MIN_SIDE_DISTANCE * d;
        let is_inside = (0..D).all(|k| x[k] > margin && x[k] < self.extent[k] - margin);
        (is_inside && self.sites.is_free(x)).then_some(gap)
    }

    /// Returns the positions of nodes, those with the largest gap first, without those that are nearer
    /// to another one than `min_distance`, in units of d.
    fn spaced_nodes(&self, mut gaps: Vec<(f64, u32)>, min_distance: f64) -> Vec<[f64; D]> {
        gaps.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut grid = self.empty_grid();
        for x in gaps.into_iter().map(|(_, n)| self.mesh.nodes[n as usize]) {
            if grid.is_free(&x, min_distance * self.distance.value_at(x)) {
                grid.add(x);
            }
        }
        grid.positions().to_vec()
    }

    /// Returns a grid for positions of new atoms, with at most ten million cells.
    fn empty_grid(&self) -> IncrementalGrid<D> {
        let volume: f64 = self.extent.iter().product();
        let edge = (1.6 * self.distance.min()).max((volume / 1e7).powf(1.0 / D as f64));
        IncrementalGrid::new([0.0; D], self.extent, edge)
    }
}

/// Returns a cell of each face, from number `first` on: those that most faces have in common.
fn common_cells(mut faces: Vec<Vec<usize>>, first: usize) -> Vec<usize> {
    let mut common = Vec::new();
    loop {
        let count = |cell: usize| faces.iter().filter(|cells| cells.contains(&cell)).count();
        let cells = faces
            .iter()
            .flatten()
            .copied()
            .filter(|&cell| cell >= first);
        let Some(cell) = cells.max_by_key(|&cell| (count(cell), cell)) else {
            return common;
        };
        faces.retain(|cells| !cells.contains(&cell));
        common.push(cell);
    }
}

/// Returns positions at some distances from `x`, in units of d, along -1, 0 or 1 of each axis; the nearest
/// come first.
fn positions_around<const D: usize>(
    x: [f64; D],
    d: f64,
    distances: &[f64],
) -> impl Iterator<Item = [f64; D]> {
    let directions = 3usize.pow(D as u32);
    distances.iter().flat_map(move |distance| {
        let others = (0..directions).filter(move |&i| 2 * i + 1 != directions);
        others.map(move |i| {
            let step = std::array::from_fn(|k| (i / 3usize.pow(k as u32) % 3) as f64 - 1.0);
            add_scaled(x, distance * d / norm(step), step)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::mesh::voronoi::conform::FacetSurface;
    use crate::mesh::voronoi::voronoi;

    /// Returns the number of faces with a skewness above 4.
    fn skew_faces(mesh: &PolyMesh<3>) -> usize {
        let shapes = mesh.cell_shapes();
        let is_skew = |&f: &usize| mesh.face_skewness(f, |cell| shapes[cell].1) > 4.0;
        (0..mesh.face_cells.len()).filter(is_skew).count()
    }

    #[test]
    fn skew_faces_of_a_shaken_lattice_vanish() {
        const COUNT: usize = 16;
        let extent = [COUNT as f64; 3];
        let (mut before, mut after) = (0, 0);
        for seed in 0..4 {
            let mut random = Random::new(seed);
            let sites = (0..COUNT.pow(3)).map(|i| [i, i / COUNT, i / COUNT.pow(2)]);
            let mut shaken = |i: usize| {
                let x = (i % COUNT) as f64 - 0.5 + 2.0 * random.draw();
                x.clamp(0.05, extent[0] - 0.05)
            };
            let positions: Vec<[f64; 3]> = sites.map(|x| x.map(&mut shaken)).collect();
            let mut atoms = Atoms {
                kinds: vec![AtomKind::Interior; positions.len()],
                positions,
            };
            let mut mesh = voronoi(&atoms.positions, extent).unwrap();
            before += skew_faces(&mesh);
            let mut sites = ConformingSites::new(FacetSurface::default(), extent, &[]);
            let distance = Distance::Constant(1.0);
            let mut equalise = |mesh: &PolyMesh<3>| {
                let mut equaliser = CellEqualiser {
                    atoms: &mut atoms,
                    sites: &mut sites,
                    mesh,
                    distance: &distance,
                    extent,
                };
                equaliser.remove_skew_faces();
                voronoi(&equaliser.atoms.positions, extent)
            };
            for _ in 0..8 {
                mesh = equalise(&mesh).unwrap();
            }
            after += skew_faces(&mesh);
        }
        assert!(before >= 4, "{before}");
        assert_eq!(after, 0, "of {before}");
    }

    #[test]
    fn cells_of_most_faces_come_first() {
        let faces = vec![vec![7, 9], vec![3, 7], vec![8], vec![1, 2]];
        assert_eq!(common_cells(faces, 3), [7, 8]);
    }
}
