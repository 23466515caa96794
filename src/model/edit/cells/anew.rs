//! Cells made anew while others stay.

use std::collections::{BTreeMap, BTreeSet};

use super::grid::meeting;
use super::kept::{Changed, Kept};
use super::patch::{Face, Fresh, Patch, Put, Scope};
use crate::Result;
use crate::geometry::buckets::Buckets;
use crate::geometry::{add_scaled, distance2};
use crate::job::cells::{even, rest};
use crate::job::horizons::on_horizons;
use crate::job::{Meshing, Space};
use crate::lattice::AtomKind;
use crate::lattice::optimize::temperature::{RANGE, closeness};
use crate::lattice::seeding::Atoms;
use crate::mesh::poly::{Lists, PolyMesh, SIDE_0};
use crate::mesh::voronoi::conform::{Conforming, Facets, Room, Surface};
use crate::model::edit::around::Around;
use crate::model::edit::resolve::REACH;
use crate::observer::{Patience, Patient};

/// New nodes at old ones, to this share of d, are these.
const ONE_NODE: f64 = 1e-7;
/// A free atom that came is the one this near to where it came, in units of d.
const NEAR: f64 = 1.0;
/// An atom nearer than this, in units of d, to where one was has its number.
const SAME: f64 = 0.6;
/// The number of a side of the window where the image goes on.
const OPEN: u32 = u32::MAX;

/// New cells round an edit, with those around them.
pub struct Anew<'a, const D: usize> {
    scope: &'a Scope<'a, D>,
    around: &'a Around<D>,
    surface: &'a Surface<D>,
    changed: &'a Changed<D>,
    kept: &'a Kept,
    /// The cells of the window: of the atoms that stay, of those that are put, of others, of sites.
    mesh: PolyMesh<D>,
    sites: Conforming<D>,
    /// The atoms that stay.
    fixed: Vec<u32>,
    put: Vec<Put<D>>,
    /// Atoms that were put and then moved.
    free: Vec<Put<D>>,
    /// The number of all atoms.
    atoms: usize,
}

impl<'a, const D: usize> Anew<'a, D>
where
    Space<D>: Meshing<D>,
{
    /// Brings atoms to rest round what stays and the parts of the surface that have changed, and cuts
    /// their cells; also tells how often the energy was evaluated.
    ///
    /// # Errors
    /// Those of optimiser and triangulation.
    #[expect(
        clippy::too_many_arguments,
        reason = "all that is known of the neighbourhood"
    )]
    pub fn new(
        scope: &'a Scope<'a, D>,
        around: &'a Around<D>,
        (surface, changed): (&'a Surface<D>, &'a Changed<D>),
        (kept, range): (&'a Kept, f64),
        gone: &[bool],
        puts: &[Put<D>],
        seed: u64,
        patience: &Patience<'_>,
    ) -> Result<(Self, usize)> {
        let (grid, extent) = (scope.grid, scope.window.extent());
        let cells = || scope.cells.iter().map(|&c| c as usize).zip(&scope.sites);
        let stay = cells().filter(|&(c, _)| kept.fixed[c]);
        let (fixed, mut positions): (Vec<u32>, Vec<[f64; D]>) =
            stay.map(|(c, x)| (c as u32, *x)).unzip();
        let warm = || cells().filter(|&(c, _)| !kept.fixed[c] && !gone[c]);
        // Wells stay where they are, whatever their cells become.
        let wells = warm().filter(|&(c, _)| grid.kinds[c] == AtomKind::Fixed);
        let mut put: Vec<Put<D>> = wells
            .map(|(c, &at)| Put {
                at,
                kind: AtomKind::Fixed,
                world: Some(grid.world.sites[c]),
                number: Some(c as u32),
                edit: None,
            })
            .collect();
        let (stays, free): (Vec<Put<D>>, Vec<Put<D>>) =
            puts.iter().partition(|put| put.kind == AtomKind::Fixed);
        put.extend(stays);
        positions.extend(put.iter().map(|put| put.at));
        let mut kinds = vec![AtomKind::Fixed; positions.len()];

        let balls = (0..kept.nodes.len())
            .filter(|&n| kept.nodes[n])
            .filter_map(|n| {
                let x = scope.window.to_local(grid.mesh.nodes[n]);
                let within = closeness(&x, &scope.edited) < REACH;
                let cell = *grid.meeting.get(n).first()?;
                let site = scope.window.to_local(grid.mesh.sites[cell as usize]);
                within.then(|| (x, distance2(&x, &site).sqrt()))
            });
        let open = scope.edited.iter().map(|&(x, d)| (x, range * d));
        let room = Room::new(open.collect(), balls.collect());
        let part = surface.part(|f| {
            let corners = surface.corners(f);
            let share = 1.0 / D as f64;
            let middle = corners
                .iter()
                .fold([0.0; D], |sum, &x| add_scaled(sum, share, x));
            changed.anew(&middle)
        });
        let mut sites = Conforming::within(part, extent, &positions, room);

        let others = warm().filter(|&(c, _)| grid.kinds[c] != AtomKind::Fixed);
        positions.extend(others.map(|(_, x)| *x));
        positions.extend(free.iter().map(|put| put.at));
        kinds.resize(positions.len(), AtomKind::Interior);
        let mut atoms = Atoms { positions, kinds };
        let (distance, observer) = (&around.distance, &mut Patient(patience));
        let rested = rest(
            &mut atoms,
            &sites,
            &scope.edited,
            distance,
            extent,
            seed,
            observer,
        )?;
        let mesh = even(
            &mut atoms,
            &mut sites,
            distance,
            extent,
            grid.weld,
            &mut || !patience.over(),
        )?;
        let anew = Self {
            scope,
            around,
            surface,
            changed,
            kept,
            mesh,
            sites,
            fixed,
            put,
            free,
            atoms: atoms.positions.len(),
        };
        Ok((anew, rested.evaluations))
    }

    /// What is new; `None` if it does not fit the rest.
    pub fn patch(&self) -> Option<Patch<D>> {
        let Self {
            scope, kept, mesh, ..
        } = self;
        let flagged = |flags: &[bool], cells: &[u32]| -> Vec<u32> {
            cells
                .iter()
                .copied()
                .filter(|&c| flags[c as usize])
                .collect()
        };
        let border = flagged(&kept.border, &scope.cells);
        // All that changes has to be in the window.
        if border.len() != kept.border.iter().filter(|b| **b).count() {
            return None;
        }
        let gone: Vec<bool> = kept.fixed.iter().map(|fixed| !fixed).collect();
        let mut patch = Patch {
            dead: (0..kept.nodes.len() as u32)
                .filter(|&n| !kept.nodes[n as usize])
                .collect(),
            gone: flagged(&gone, &scope.cells),
            border,
            ..Patch::default()
        };
        if patch.gone.len() != gone.iter().filter(|g| **g).count() {
            return None;
        }
        patch.fresh = self.fresh(&mut patch.atoms);
        self.number(&mut patch);
        let mut fitting = Fitting::new(self);
        let marks = self.marks(&patch);
        let horizons = on_horizons(mesh, &marks, &self.around.features);
        for f in 0..mesh.face_cells.len() {
            let Some(cells) = self.cells_of(f)? else {
                continue;
            };
            if fitting.whole.contains(&cells) {
                continue;
            }
            let ring = fitting.ring(f, &mut patch.nodes)?;
            if ring.len() >= D {
                patch.faces.push(Face {
                    ring,
                    cells,
                    on_feature: marks[f],
                    on_horizon: horizons.get(f).copied().unwrap_or(false),
                });
            }
        }
        fitting.is_complete().then_some(patch)
    }

    /// The number of a cell of the window: its own if it stays, else behind all of the mesh; or that of a
    /// side of the box.
    fn cell(&self, c: u32) -> u32 {
        if c >= SIDE_0 {
            let side = (c - SIDE_0) as usize;
            return match self.scope.window.open[side / 2][side % 2] {
                true => OPEN,
                false => c,
            };
        }
        match self.fixed.get(c as usize) {
            Some(&cell) => cell,
            None => (self.scope.grid.mesh.sites.len() + c as usize - self.fixed.len()) as u32,
        }
    }

    /// The cells of a face if both are new or have new faces; none at all if the window ends too soon.
    fn cells_of(&self, face: usize) -> Option<Option<[u32; 2]>> {
        let cells = self.mesh.face_cells[face].map(|c| self.cell(c));
        let count = self.scope.grid.mesh.sites.len();
        let wanted = cells.map(|c| match c {
            OPEN => false,
            side if side >= SIDE_0 => true,
            c => self
                .kept
                .border
                .get(c as usize)
                .copied()
                .unwrap_or(c as usize >= count),
        });
        match wanted {
            [true, true] => Some(Some(cells)),
            [true, false] if cells[1] == OPEN => None,
            _ => Some(None),
        }
    }

    /// The new cells.
    fn fresh(&self, atoms: &mut Vec<(usize, usize)>) -> Vec<Fresh<D>> {
        let Self { scope, mesh, .. } = self;
        let (grid, first) = (scope.grid, self.fixed.len());
        let fresh = |c: usize| {
            let at = mesh.sites[c];
            let put = self.put.get(c - first);
            let gaps = scope
                .sites
                .iter()
                .map(|x| distance2(x, &at))
                .zip(&scope.cells);
            let nearest = gaps.min_by(|a, b| a.0.total_cmp(&b.0));
            Fresh {
                site: scope.window.to_whole(at),
                world: put.and_then(|put| put.world),
                kind: put.map_or(AtomKind::Interior, |put| put.kind),
                region: nearest.map_or(0, |(_, &c)| grid.mesh.region[c as usize]),
                distance: self.around.distance.at(at) as f32,
                number: put.and_then(|put| put.number),
            }
        };
        let mut all: Vec<Fresh<D>> = (first..mesh.sites.len()).map(fresh).collect();
        let edits = self.put.iter().enumerate();
        atoms.extend(edits.filter_map(|(i, put)| put.edit.map(|edit| (edit, i))));
        for put in &self.free {
            let gap = |i: &usize| distance2(&mesh.sites[first + i], &put.at);
            let nearest = (self.put.len()..all.len()).min_by(|i, j| gap(i).total_cmp(&gap(j)));
            let reach = NEAR * self.around.distance.at(put.at);
            let Some(i) = nearest.filter(|i| gap(i) < reach * reach) else {
                continue;
            };
            all[i].number = put.number;
            atoms.extend(put.edit.map(|edit| (edit, i)));
        }
        all
    }

    /// Atoms that are nearest to where one was that has moved, as this is to them, have its number.
    fn number(&self, patch: &mut Patch<D>) {
        let taken: BTreeSet<u32> = patch.fresh.iter().filter_map(|f| f.number).collect();
        let nameless: Vec<usize> = (0..patch.fresh.len())
            .filter(|&i| patch.fresh[i].number.is_none())
            .collect();
        let free: Vec<u32> = patch
            .gone
            .iter()
            .copied()
            .filter(|c| !taken.contains(c))
            .collect();
        let old = &self.scope.grid.mesh.sites;
        let gap = |i: usize, c: u32| distance2(&patch.fresh[i].site, &old[c as usize]);
        let heir = |c: u32| {
            let heirs = nameless.iter().copied();
            heirs.min_by(|&i, &j| gap(i, c).total_cmp(&gap(j, c)))
        };
        let pairs = free.iter().filter_map(|&c| {
            let i = heir(c)?;
            let back = free.iter().copied();
            let back = back.min_by(|&a, &b| gap(i, a).total_cmp(&gap(i, b)));
            let reach = SAME * f64::from(patch.fresh[i].distance);
            (back == Some(c) && gap(i, c) < reach * reach).then_some((i, c))
        });
        let pairs: Vec<(usize, u32)> = pairs.collect();
        for (i, c) in pairs {
            patch.fresh[i].number = Some(c);
        }
    }

    /// Which faces of the window lie on features: those on surfaces, and of those between cells that stay
    /// also those that were, where features have not changed.
    fn marks(&self, patch: &Patch<D>) -> Vec<bool> {
        let Self { scope, mesh, .. } = self;
        let grid = scope.grid;
        let count = grid.mesh.sites.len();
        let region = |c: u32| match patch.fresh.get((c as usize).wrapping_sub(count)) {
            Some(fresh) => fresh.region,
            None => grid.mesh.region[c as usize],
        };
        let mut marks = self.sites.faces(mesh, self.atoms);
        let facets = Facets::new(self.surface);
        for (f, mark) in marks.iter_mut().enumerate() {
            let [a, b] = mesh.face_cells[f];
            if b >= SIDE_0 {
                continue;
            }
            let cells = [a, b].map(|c| self.cell(c));
            let inner = &grid.mesh.face_cells[..grid.mesh.inner_faces()];
            let [x, y] = [a, b].map(|c| mesh.sites[c as usize]);
            *mark = match inner.binary_search(&cells) {
                _ if grid.labelled => region(cells[0]) != region(cells[1]),
                Ok(old) if !self.changed.anew(&mesh.face_shape(f).centroid) => {
                    grid.mesh.on_feature[old]
                }
                _ => *mark || facets.part(x, y),
            };
        }
        marks
    }
}

/// How new faces fit the nodes that stay.
struct Fitting<'a, 'b, const D: usize> {
    anew: &'a Anew<'b, D>,
    /// The cells and sides that meet in each node of the window, by their numbers in the mesh.
    meeting: Vec<Vec<u32>>,
    /// Nodes that stay, by what meets there, and by where they are.
    staying: BTreeMap<&'a [u32], Vec<u32>>,
    places: Buckets<D>,
    /// The numbers of those.
    at: Vec<u32>,
    /// The cells of faces of which all nodes stay.
    whole: BTreeSet<[u32; 2]>,
    /// Nodes that stay and have to be met: others of a face of theirs do not.
    needed: BTreeSet<u32>,
    met: BTreeSet<u32>,
    /// Numbers of nodes of the window in the mesh, or behind all of it.
    number: Vec<Option<u32>>,
}

impl<'a, 'b, const D: usize> Fitting<'a, 'b, D>
where
    Space<D>: Meshing<D>,
{
    fn new(anew: &'a Anew<'b, D>) -> Self {
        let (grid, kept) = (anew.scope.grid, anew.kept);
        let own: Lists = meeting(&anew.mesh);
        let numbers = |n: usize| {
            let mut cells: Vec<u32> = own.get(n).iter().map(|&c| anew.cell(c)).collect();
            cells.sort_unstable();
            cells
        };
        let (mut staying, mut whole, mut needed) =
            (BTreeMap::new(), BTreeSet::new(), BTreeSet::new());
        for (f, cells) in grid.mesh.face_cells.iter().enumerate() {
            let is_border = |c: u32| kept.border.get(c as usize).copied().unwrap_or(c >= SIDE_0);
            if !cells.iter().all(|&c| is_border(c)) {
                continue;
            }
            let ring = grid.mesh.faces.get(f).iter().copied();
            let stay: Vec<u32> = ring.filter(|&n| kept.nodes[n as usize]).collect();
            if stay.len() == grid.mesh.faces.get(f).len() {
                whole.insert(*cells);
            } else {
                needed.extend(stay);
            }
        }
        let (mut at, mut positions) = (Vec::new(), Vec::new());
        for n in (0..grid.mesh.nodes.len()).filter(|&n| kept.nodes[n]) {
            let cells = grid.meeting.get(n);
            let at_border = |&c: &u32| kept.border.get(c as usize).copied().unwrap_or(false);
            if cells.iter().any(at_border) {
                staying.entry(cells).or_insert_with(Vec::new).push(n as u32);
                at.push(n as u32);
                positions.push(anew.scope.window.to_local(grid.mesh.nodes[n]));
            }
        }
        Self {
            meeting: (0..anew.mesh.nodes.len()).map(numbers).collect(),
            number: vec![None; anew.mesh.nodes.len()],
            met: BTreeSet::new(),
            places: Buckets::new(&positions, ONE_NODE * anew.around.distance.max()),
            at,
            anew,
            staying,
            whole,
            needed,
        }
    }

    /// The nodes of a face of the window; `None` if one is too far from every edit.
    fn ring(&mut self, face: usize, nodes: &mut Vec<[f64; D]>) -> Option<Vec<u32>> {
        let anew = self.anew;
        let own = anew.mesh.faces.get(face);
        let mut ring: Vec<u32> = Vec::with_capacity(own.len());
        for &n in own {
            let number = match self.number[n as usize] {
                Some(number) => number,
                None => self.find(n as usize, nodes)?,
            };
            self.number[n as usize] = Some(number);
            if ring.last() != Some(&number) {
                ring.push(number);
            }
        }
        while ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
        }
        Some(ring)
    }

    /// The node that stays where the window has one, or else a new one.
    fn find(&mut self, n: usize, nodes: &mut Vec<[f64; D]>) -> Option<u32> {
        let Anew { scope, mesh, .. } = self.anew;
        let x = mesh.nodes[n];
        let gap = |&m: &u32| {
            let old = scope.window.to_local(scope.grid.mesh.nodes[m as usize]);
            distance2(&old, &x)
        };
        let cells = self.meeting[n].as_slice();
        let mut near: Vec<u32> = self.staying.get(cells).cloned().unwrap_or_default();
        if near.is_empty() {
            let reach = ONE_NODE * self.anew.around.distance.at(x);
            self.places
                .visit_within(x, reach, |i| near.push(self.at[i]));
            near.retain(|m| gap(m) < reach * reach);
        }
        let found = near.into_iter().min_by(|a, b| gap(a).total_cmp(&gap(b)));
        if let Some(m) = found {
            self.met.insert(m);
            return Some(m);
        }
        // Whatever is as near as its own atoms has to be within reach.
        let own = cells.iter().filter(|&&c| c < SIDE_0).map(|&c| self.site(c));
        let own = own.map(|y| distance2(&y, &x).sqrt());
        let radius = own.fold(f64::INFINITY, f64::min);
        let mut edited = scope.edited.iter();
        let is_known = edited.any(|(y, d)| distance2(y, &x).sqrt() + radius < REACH * d);
        if !is_known || closeness(&x, &scope.edited) > RANGE {
            return None;
        }
        nodes.push(scope.window.to_whole(x));
        Some((scope.grid.mesh.nodes.len() + nodes.len() - 1) as u32)
    }

    /// Where the atom of a cell is in the window.
    fn site(&self, cell: u32) -> [f64; D] {
        let Anew {
            scope, mesh, fixed, ..
        } = self.anew;
        let old = &scope.grid.mesh.sites;
        match old.get(cell as usize) {
            Some(&x) => scope.window.to_local(x),
            None => mesh.sites[cell as usize - old.len() + fixed.len()],
        }
    }

    /// Whether all nodes that stay have been met.
    fn is_complete(&self) -> bool {
        self.needed.is_subset(&self.met)
    }
}
