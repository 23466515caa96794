//! A large mesh improved slab by slab, each as a mesh of its own that stays as it is where it was cut out: at the
//! same time, and by processes of which none holds all.
//!
//! First come *bands* round the cuts, which are far from where they end themselves; then slabs, in which what
//! bands left poor at their ends is in the middle. What is on different sides of a cut meets in faces that have
//! been improved before and no longer change.
//!
//! How a mesh is cut depends on its atoms and d alone, so that the result is the same for any number of processes.
//!
//! - `part`: a part of a mesh as one of its own

mod part;
#[cfg(test)]
mod tests;

use std::ops::Range;

use crate::parallel::prelude::*;

use super::{Improver, SINES};
use crate::Result;
use crate::improve::sheets::Sheets;
use crate::improve::{Blocked, Counts, Improved, Target};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::complex::{BEYOND, NONE};
use crate::mesh::piece::Piece;
use crate::mesh::quality::min_sine;
use crate::mesh::{FACES, TetMesh};
use crate::observer::Patience;
use crate::ranks::order::at_ranks;
use crate::ranks::{Group, share_of};
use part::Part;

/// A band reaches so far to either side of its cut, over the largest d ...
const HALF: f64 = 6.0;
/// ... and is improved so far from it: what is mended may change what is some 3 d away.
const CORE: f64 = 3.0;
/// Slabs are at least so thick, over the same ...
const THICK: f64 = 48.0;
/// ... and have at least so many atoms.
const ATOMS: usize = 20_480;
/// There are not more: they and the bands between them are numbered with 16 bits.
const MOST: usize = 1 << 14;

/// Where a mesh is cut: at planes across the longest axis of the box.
#[derive(Debug, Clone, PartialEq)]
pub struct Cuts {
    /// The axis.
    pub axis: usize,
    /// Where, rising.
    at: Vec<f64>,
    half: f64,
}

impl Cuts {
    /// So that slabs have as many atoms each, of which everyone of the group has a share; none if there is but one slab.
    ///
    /// # Errors
    /// Those of the others.
    pub fn new(
        share: &[[f64; 3]],
        extent: [f64; 3],
        distance: &Distance<3>,
        group: &dyn Group,
    ) -> Result<Option<Self>> {
        let Some(axis) = (0..3).max_by(|&k, &l| extent[k].total_cmp(&extent[l])) else {
            return Ok(None);
        };
        let half = HALF * distance.max();
        let atoms: Vec<usize> = group.all("atoms", share.len())?;
        let atoms = atoms.iter().sum();
        let most = Self::most(atoms, extent[axis], distance.max());
        let mut along: Vec<f64> = share.iter().map(|x| x[axis]).collect();
        for count in (2..=most).rev() {
            let ranks: Vec<usize> = (1..count).map(|i| i * atoms / count).collect();
            let at = match group.count() {
                1 => (ranks.iter())
                    .map(|&rank| *along.select_nth_unstable_by(rank, f64::total_cmp).1)
                    .collect(),
                _ => at_ranks(&[along.iter().copied()], &[|_| &ranks], group)?.swap_remove(0),
            };
            let mut ends = vec![0.0];
            ends.extend(&at);
            ends.push(extent[axis]);
            // Between bands there must be something.
            if ends.windows(2).all(|two| two[1] - two[0] > 3.0 * half) {
                return Ok(Some(Self { axis, at, half }));
            }
        }
        Ok(None)
    }

    /// How many slabs there are at most where there are so many atoms, at most `d` apart, in a box so long.
    pub fn most(atoms: usize, longest: f64, d: f64) -> usize {
        let thick = (longest / (THICK * d)) as usize;
        thick.min(atoms / ATOMS).min(MOST)
    }

    /// How many slabs there are.
    pub fn count(&self) -> usize {
        self.at.len() + 1
    }

    /// Where the atoms begin that are the first of tetrahedra of each slab but the first, and of the band after it:
    /// at the end of the band before.
    pub fn ends(&self) -> Vec<f64> {
        self.at.iter().map(|at| at + self.half).collect()
    }

    /// Of a tetrahedron whose first atom is there: twice the number of the slab, and one more in the band after it.
    fn region(&self, x: [f64; 3]) -> u16 {
        let x = x[self.axis];
        let begun = self.at.partition_point(|at| at - self.half <= x);
        match begun.checked_sub(1) {
            Some(band) if x < self.at[band] + self.half => 2 * band as u16 + 1,
            _ => 2 * begun as u16,
        }
    }

    /// Whether a tetrahedron of the band after a slab is on the slab's side of the cut.
    fn before(&self, part: &Part, t: u32, slab: usize) -> bool {
        part.middle(t, self.axis) < 4.0 * self.at[slab]
    }
}

/// The slabs of one of those who share a mesh, improved.
#[derive(Debug)]
pub struct InSlabs {
    /// Its tetrahedra.
    pub piece: Piece,
    /// What each of its nodes may do.
    pub kinds: Vec<AtomKind>,
    /// For each tetrahedron which of its faces lie on a feature: bit k for face k.
    pub feature_faces: Vec<u8>,
    /// What was done, of the whole mesh.
    pub improved: Improved,
}

impl InSlabs {
    /// All pieces as one, on every member of the group.
    ///
    /// # Errors
    /// Those of other members.
    pub fn whole(mut self, group: &dyn Group) -> Result<Self> {
        if group.count() == 1 {
            // In place: they are the largest array of all.
            let around = self.piece.neighbors.as_flattened_mut().par_iter_mut();
            around.filter(|n| **n == BEYOND).for_each(|n| *n = NONE);
            return Ok(self);
        }
        let Self {
            piece,
            kinds,
            feature_faces,
            improved,
        } = self;
        let (first, whole) = (0, piece.whole);
        let part = Part {
            holds: Vec::new(),
            neighbors: piece.neighbors_here(),
            ids: piece.numbers,
            nodes: piece.mesh.nodes,
            kinds,
            tets: piece.mesh.tets,
        };
        let parts: Vec<(Part, Vec<u8>)> = group.all("pieces", (part, feature_faces))?;
        let (parts, marks): (Vec<Part>, Vec<Vec<u8>>) = parts.into_iter().unzip();
        let part = Part::together(parts);
        Ok(Self {
            piece: Piece {
                mesh: TetMesh {
                    nodes: part.nodes,
                    tets: part.tets,
                },
                neighbors: part.neighbors,
                numbers: part.ids,
                first,
                whole,
            },
            kinds: part.kinds,
            feature_faces: marks.concat(),
            improved,
        })
    }
}

/// What slabs are improved for.
#[derive(Debug, Clone, Copy)]
pub struct Aim<'a> {
    /// The far corner of the box.
    pub extent: [f64; 3],
    /// The features.
    pub sheets: &'a Sheets,
    /// d.
    pub distance: &'a Distance<3>,
    /// What is asked for.
    pub target: &'a Target,
}

impl Aim<'_> {
    /// Of the smallest angle asked for.
    fn sine(&self) -> f64 {
        self.target.min_dihedral.to_radians().sin()
    }

    /// Whether a face lies in a side of the box.
    fn in_side(&self, face: [[f64; 3]; 3]) -> bool {
        (0..3).any(|k| {
            let [x, others @ ..] = face.map(|x| x[k]);
            (x == 0.0 || x == self.extent[k]) && others == [x; 2]
        })
    }
}

/// A part that has been improved. The numbers of nodes that came are `NONE`.
struct Done {
    part: Part,
    /// Nodes that came.
    came: usize,
    /// The numbers of those that went.
    gone: Vec<u32>,
    feature_faces: Vec<u8>,
    counts: Counts,
    blocked: Vec<Blocked>,
}

/// Atoms as far as they are known to a member of a group: all that its tetrahedra have.
#[derive(Debug, Clone, Default)]
pub struct KnownAtoms {
    /// The atoms.
    pub atoms: Atoms<3>,
    /// The number of each among all, rising. None where all are known.
    pub numbers: Option<Vec<u32>>,
    /// How many there are in all.
    pub whole: usize,
}

/// Which slabs a member of a group has.
pub fn own_slabs(slabs: usize, group: &dyn Group) -> Range<usize> {
    share_of(slabs, group.rank(), group.count())
}

/// Makes the slabs of each member of a group follow the features and frees them of slivers, as [`improve`] does a mesh
/// as a whole.
///
/// `tets` are Delaunay tetrahedra of the atoms that are known, at least those of the [own](own_slabs) slabs, with
/// neighbours among them; of each the first node is the least.
///
/// # Errors
/// Those of other members.
///
/// [`improve`]: super::improve
pub fn improve_in_slabs(
    known: KnownAtoms,
    joined: (Vec<[u32; 4]>, Vec<[u32; 4]>),
    cuts: &Cuts,
    aim: Aim<'_>,
    group: &dyn Group,
    patience: &Patience<'_>,
) -> Result<InSlabs> {
    let (slabs, bands) = (cuts.count(), cuts.at.len());
    let own = own_slabs(slabs, group);
    let whole = known.whole;
    let (raw, poor_before) = regions(joined, cuts, &own, known, aim.sine());
    let (mut inner, mut between) = (Vec::new(), Vec::new());
    for (i, part) in raw.into_iter().enumerate() {
        [&mut inner, &mut between][i % 2].push(part);
    }
    // Bands: numbers for the nodes that came, and what is beyond the cut to the next slab, which may be another's.
    let own_bands = own.start..own.end.min(bands);
    let mut done: Vec<Done> = (own_bands.into_par_iter().zip(between).with_max_len(1))
        .map(|(band, part)| {
            let core = CORE / HALF * cuts.half;
            let between = [cuts.at[band] - core, cuts.at[band] + core];
            improve_part(part, Some((cuts.axis, between)), aim, patience)
        })
        .collect::<Result<Vec<Done>>>()?;
    let mut end = number_all(&mut done, whole as u32, group)?;
    let (mut counts, mut gone) = (Counts::default(), Vec::new());
    let mut parts: Vec<Vec<Part>> = own.clone().map(|_| Vec::new()).collect();
    let mut to: Vec<Vec<Part>> = vec![Vec::new(); group.count()];
    for ((slab, parts), band) in own.clone().zip(&mut parts).zip(done) {
        let side = |before: bool| (band.part).pick(|t| cuts.before(&band.part, t, slab) == before);
        let (before, after) = rayon::join(|| side(true), || side(false));
        parts.push(before);
        to[owner(slab + 1, slabs, group.count())].push(after);
        // What it left is tried again, and counted then.
        counts += Counts {
            pierced_left: 0,
            ..band.counts
        };
        gone.extend(band.gone);
    }
    let beyond = group.pass("bands", to)?.concat();
    let first = usize::from(own.start == 0);
    for (parts, part) in parts.iter_mut().skip(first).zip(beyond) {
        parts.push(part);
    }
    let mut done: Vec<Done> = (inner.into_par_iter().zip(parts).with_max_len(1))
        .map(|(inner, mut parts)| {
            parts.push(inner);
            improve_part(Part::together(parts), None, aim, patience)
        })
        .collect::<Result<Vec<Done>>>()?;
    end = number_all(&mut done, end, group)?;
    let mut blocked = Vec::new();
    for slab in &mut done {
        counts += slab.counts;
        gone.append(&mut slab.gone);
        blocked.append(&mut slab.blocked);
    }
    let gone: Vec<Vec<u32>> = group.all("nodes that went", gone)?;
    let mut gone = gone.concat();
    gone.sort_unstable();
    let all: Vec<(usize, (Counts, Vec<Blocked>))> =
        group.all("improvement", (poor_before, (counts, blocked)))?;
    let (mut poor_before, mut counts, mut blocked) = (0, Counts::default(), Vec::new());
    for (poor, (some, of_some)) in all {
        poor_before += poor;
        counts += some;
        blocked.extend(of_some);
    }
    let worse = |of: &Blocked| of.smallest.min(180.0 - of.largest);
    blocked.sort_by(|a, b| worse(a).total_cmp(&worse(b)));
    let improved = Improved {
        poor_before,
        poor_after: blocked.len(),
        counts,
        blocked,
    };
    let (parts, marks): (Vec<Part>, Vec<Vec<u8>>) = (done.into_iter())
        .map(|slab| (slab.part, slab.feature_faces))
        .unzip();
    let mut part = Part::together(parts);
    lead_beyond_cuts(&mut part, aim);
    let number = |id: u32| id - gone.partition_point(|&gone| gone < id) as u32;
    let tets: Vec<usize> = group.all("tetrahedra", part.tets.len())?;
    let piece = Piece {
        numbers: part.ids.iter().map(|&id| number(id)).collect(),
        first: tets[..group.rank()].iter().sum(),
        whole: [end as usize - gone.len(), tets.iter().sum()],
        neighbors: part.neighbors,
        mesh: TetMesh {
            nodes: part.nodes,
            tets: part.tets,
        },
    };
    Ok(InSlabs {
        piece,
        kinds: part.kinds,
        feature_faces: marks.concat(),
        improved,
    })
}

/// Who has a slab.
fn owner(slab: usize, slabs: usize, count: usize) -> usize {
    let has = |rank: &usize| share_of(slabs, *rank, count).contains(&slab);
    (0..count).find(has).unwrap_or(0)
}

/// The regions of some slabs and of the bands after them, each as a part, and how many of their tetrahedra are poorer than
/// a sine.
fn regions(
    (tets, neighbors): (Vec<[u32; 4]>, Vec<[u32; 4]>),
    cuts: &Cuts,
    own: &Range<usize>,
    known: KnownAtoms,
    sine: f64,
) -> (Vec<Part>, usize) {
    let Atoms { positions, kinds } = &known.atoms;
    let own = 2 * own.start..(2 * own.end).min(2 * cuts.count() - 1);
    let least = |tet: &[u32; 4]| tet.iter().fold(NONE, |a, &b| a.min(b)) as usize;
    let region: Vec<u16> = (tets.par_iter())
        .map(|tet| cuts.region(positions[least(tet)]))
        .collect();
    let part = |region_here: usize| {
        let chosen: Vec<u32> = (region.par_iter().enumerate())
            .filter(|(_, region)| usize::from(**region) == region_here)
            .map(|(t, _)| t as u32)
            .collect();
        let mut part = Part::of(&tets, &neighbors, &chosen, |n| {
            let n = n as usize;
            (positions[n], kinds[n], None)
        });
        if let Some(numbers) = &known.numbers {
            part.ids
                .iter_mut()
                .for_each(|id| *id = numbers[*id as usize]);
        }
        part
    };
    let parts: Vec<Part> = own.into_par_iter().with_max_len(1).map(part).collect();
    let poor = |part: &Part| {
        let tets = part.tets.par_iter().with_min_len(SINES);
        let corners = |tet: &[u32; 4]| tet.map(|n| part.nodes[n as usize]);
        tets.filter(|tet| min_sine(&corners(tet)) < sine).count()
    };
    let poor = parts.iter().map(poor).sum();
    (parts, poor)
}

impl Done {
    /// Gives the nodes that came their numbers, and tells the next.
    fn number(&mut self, next: &mut u32) {
        let came = self.part.ids.len() - self.came;
        for id in &mut self.part.ids[came..] {
            *id = *next;
            *next += 1;
        }
    }
}

/// Gives all nodes that came their numbers, in the order of parts, from `first` on; tells where they end.
fn number_all(done: &mut [Done], first: u32, group: &dyn Group) -> Result<u32> {
    let came: u32 = done.iter().map(|part| part.came as u32).sum();
    let came: Vec<u32> = group.all("nodes that came", came)?;
    let mut next = first + came[..group.rank()].iter().sum::<u32>();
    done.iter_mut().for_each(|part| part.number(&mut next));
    Ok(first + came.iter().sum::<u32>())
}

/// Improves a part, or what is between two places along an axis, as a mesh of its own: the nodes where it was cut out
/// stay, and so do the faces there.
fn improve_part(
    part: Part,
    between: Option<(usize, [f64; 2])>,
    aim: Aim<'_>,
    patience: &Patience<'_>,
) -> Result<Done> {
    let Part {
        ids,
        nodes,
        kinds,
        holds,
        tets,
        neighbors,
    } = part;
    let mut stays = vec![false; nodes.len()];
    for (tet, around) in tets.iter().zip(&neighbors) {
        for k in (0..4).filter(|&k| around[k] == NONE) {
            let face = FACES[k].map(|i| tet[i] as usize);
            if !aim.in_side(face.map(|n| nodes[n])) {
                face.iter().for_each(|&n| stays[n] = true);
            }
        }
    }
    let mut improver = Improver::new(
        TetMesh { nodes, tets },
        neighbors,
        &kinds,
        aim.extent,
        aim.sheets,
        aim.distance,
        aim.sine(),
        patience,
    );
    (improver.alone, improver.between) = (true, between);
    for (hold, held) in improver.holds.iter_mut().zip(holds) {
        *hold = held.unwrap_or(*hold);
    }
    let mut sides = Vec::new();
    for (n, hold) in improver.holds.iter_mut().enumerate() {
        if stays[n] {
            sides.push((n, hold.axes));
            hold.axes = 7;
        }
    }
    let Improved { counts, .. } = improver.improve(patience)?;
    for (n, axes) in sides {
        improver.holds[n].axes = axes;
    }
    let blocked = improver.blocked();
    let finished = improver.finish(&kinds);
    let before = finished.kept.partition_point(|&n| (n as usize) < ids.len());
    let mut gone = Vec::with_capacity(ids.len() - before);
    let mut left = finished.kept[..before].iter().peekable();
    for (n, &id) in ids.iter().enumerate() {
        if left.next_if(|&&kept| kept as usize == n).is_none() {
            gone.push(id);
        }
    }
    let came = finished.kept.len() - before;
    let kept = finished.kept[..before].iter().map(|&n| ids[n as usize]);
    Ok(Done {
        came,
        gone,
        feature_faces: finished.feature_faces,
        counts,
        blocked,
        part: Part {
            ids: kept.chain((0..came).map(|_| NONE)).collect(),
            nodes: finished.mesh.nodes,
            kinds: finished.kinds,
            // Of slabs nothing is improved again.
            holds: match between {
                Some(_) => finished.holds.into_iter().map(Some).collect(),
                None => Vec::new(),
            },
            tets: finished.mesh.tets,
            neighbors: finished.neighbors,
        },
    })
}

/// From now on faces that are not in a side of the box lead to another piece.
fn lead_beyond_cuts(part: &mut Part, aim: Aim<'_>) {
    let tets = part.neighbors.par_iter_mut().zip(&part.tets);
    tets.for_each(|(around, tet)| {
        for (face, n) in FACES.iter().zip(around).filter(|of| *of.1 == NONE) {
            if !aim.in_side(face.map(|i| part.nodes[tet[i] as usize])) {
                *n = BEYOND;
            }
        }
    });
}
