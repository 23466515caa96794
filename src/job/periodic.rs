//! Meshes that are periodic: opposite sides of the box match node by node and face by face.
//!
//! The image must be periodic, too: its last layer repeats the first. Then
//!
//! 1. the nominal distance is made the same on opposite sides ([`make_distance_periodic`]),
//! 2. the atoms on near sides get images on the far sides, which move with them
//!    ([`tie_lattice`], [`TiedEnergy`](crate::lattice::energy::tied::TiedEnergy)),
//! 3. in space, the atoms on each near side are joined to triangles as those of a 2-D image are, with
//!    the labels of the first layer, and copied to the far side ([`MatchSides`]),
//! 4. the tetrahedra get these triangles on their sides, which do not change any more, and those at a
//!    side have the labels of its triangles.
//!
//! In the plane, step 3 is only that the atoms on sides do not move any more.

use std::collections::BTreeMap;

use super::simplices::make_simplices;
use super::spec::{MeshSpec, NominalDistance, PeriodicAxes};
use super::{LatticeParams, MeshScene, Params, StageRunner};
use crate::comm::Comm;
use crate::error::cause;
use crate::feature::volume::Volume;
use crate::feature::{DetectionOptions, FeatureKind, Features, LabelMap, detect};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, sorted};
use crate::image::{Geometry, Image, ImageSource, ScalarField};
use crate::improve::tets::BoxSide;
use crate::lattice::AtomKind;
use crate::lattice::distance::{Distance, limit_gradient};
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::lattice::seeding::morton;
use crate::lattice::seeding::{Atoms, kind_at};
use crate::mesh::complex::NONE;
use crate::mesh::periodic::{PeriodicCheck, PeriodicNodes};
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::progress::{CancelToken, Progress};
use crate::{Error, Result};

/// Smallest share of the samples of opposite layers that must agree.
const MIN_AGREEMENT: f64 = 0.99;

/// Largest difference of samples that agree, as a share of the range of the image.
const MAX_DIFFERENCE: f64 = 0.01;

/// Number of times that the distance is made the same on opposite sides, and smooth again.
const DISTANCE_ROUNDS: usize = 3;

/// Number of points of an edge on a side at which its label is evaluated.
const EDGE_SAMPLES: usize = 9;

/// Checks that an image is periodic along the axes. Several processes are refused.
///
/// # Errors
/// Returns [`Error::Job`] for axes that the image does not have or along which it is not periodic.
pub(super) fn check_axes<const D: usize>(
    axes: PeriodicAxes,
    source: ImageSource<'_, D>,
    comm: &dyn Comm,
) -> Result<()> {
    let refuse = |problem: String, remedy: &str| {
        Err(Error::Job(cause(
            format!("periodic {axes}"),
            problem,
            remedy,
        )))
    };
    if D == 2 && axes.0[2] {
        return refuse("names z, but the image is 2-D".into(), "give x, y or x,y");
    }
    if comm.size() > 1 {
        let problem = format!("is made by one process, but there are {}", comm.size());
        return refuse(problem, "run it without mpirun");
    }
    let image = source.to_image()?;
    for k in (0..D).filter(|&k| axes.0[k]) {
        let share = agreement(&image, k);
        if share < MIN_AGREEMENT {
            let axis = PeriodicAxes::NAMES[k];
            return refuse(
                format!(
                    "needs an image whose last layer repeats the first, but along {axis} they agree in {:.1} % of their samples only, not in {:.0} %",
                    100.0 * share,
                    100.0 * MIN_AGREEMENT
                ),
                "append a copy of the first layer at the end of each periodic axis (in NumPy: numpy.pad(image, (0, 1), mode=\"wrap\")), or leave out this axis",
            );
        }
    }
    Ok(())
}

/// Returns the share of samples of the first and the last layer along an axis that agree.
fn agreement<const D: usize>(image: &Image<D>, axis: usize) -> f64 {
    let (dims, samples) = (image.dims(), image.as_slice());
    let stride = dims[..axis].iter().product::<usize>();
    let finite = samples.iter().filter(|s| s.is_finite());
    let [low, high] = finite.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], &s| {
        [low.min(s), high.max(s)]
    });
    let tolerance = f64::from(high - low) * MAX_DIFFERENCE;
    // Labels differ or not; a difference of neighbouring numbers may be small in their range.
    let tolerance = if samples.iter().all(|s| s.fract() == 0.0) {
        0.0
    } else {
        tolerance
    };
    let offset = (dims[axis] - 1) * stride;
    let (mut agreeing, mut count) = (0usize, 0usize);
    for (i, &near) in samples.iter().enumerate() {
        if i / stride % dims[axis] != 0 {
            continue;
        }
        let far = samples[i + offset];
        let difference = f64::from(near) - f64::from(far);
        count += 1;
        let is_missing = near.is_nan() && far.is_nan();
        agreeing += usize::from(is_missing || difference.abs() <= tolerance);
    }
    agreeing as f64 / count.max(1) as f64
}

/// Makes a nominal distance the same on opposite sides: the smaller of both, with a limited gradient.
pub(super) fn make_distance_periodic<const D: usize>(
    distance: &mut Distance<D>,
    axes: [bool; D],
    growth: f64,
    cancel: &CancelToken<'_>,
) {
    let Distance::Field(field) = distance else {
        return;
    };
    for _ in 0..DISTANCE_ROUNDS {
        for k in (0..D).filter(|&k| axes[k]) {
            let stride = field.dims[..k].iter().product::<usize>();
            let offset = (field.dims[k] - 1) * stride;
            for i in 0..field.samples.len() {
                if i / stride % field.dims[k] == 0 {
                    let d = field.samples[i].min(field.samples[i + offset]);
                    (field.samples[i], field.samples[i + offset]) = (d, d);
                }
            }
        }
        limit_gradient(field, growth, cancel);
    }
}

/// Replaces the atoms on far sides by images of those on near sides.
///
/// # Errors
/// Returns [`Error::Seeding`] if an atom on a side has no image.
pub(super) fn tie_lattice<const D: usize>(
    atoms: &mut OwnedAtoms<D>,
    extent: [f64; D],
    min_distance: f64,
    axes: [bool; D],
) -> Result<()> {
    let mut positions = std::mem::take(&mut atoms.atoms.positions);
    for k in (0..D).filter(|&k| axes[k]) {
        positions.retain(|x| x[k] != extent[k]);
        let near: Vec<[f64; D]> = positions.iter().copied().filter(|x| x[k] == 0.0).collect();
        positions.extend(near.into_iter().map(|mut x| {
            x[k] = extent[k];
            x
        }));
    }
    morton::sort_by_curve(&mut positions, extent, 2.0 * min_distance);
    atoms.atoms = Atoms::from_positions(positions, extent);
    atoms.global_count = atoms.atoms.len();
    tied_nodes(&atoms.atoms.positions, extent, axes).map(|_| ())
}

/// Returns the images among atoms.
///
/// # Errors
/// Returns [`Error::Seeding`] if an atom on a side has no image.
pub(super) fn tied_nodes<const D: usize>(
    positions: &[[f64; D]],
    extent: [f64; D],
    axes: [bool; D],
) -> Result<PeriodicNodes> {
    let nodes = PeriodicNodes::new(positions, extent, axes);
    if nodes.unmatched > 0 {
        let problem = format!("has {} atoms on sides without an image", nodes.unmatched);
        return Err(Error::Seeding(cause(
            "the periodic lattice",
            problem,
            "choose another distance or seeding, and please report it: this is an error in atomesh",
        )));
    }
    Ok(nodes)
}

/// A face of the mesh on a periodic side.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SideFace<const D: usize> {
    /// Its nodes.
    pub nodes: [u32; D],
    /// The side.
    pub side: BoxSide,
    /// Index of the label of its cell, if the image has labels.
    pub label: Option<u32>,
}

/// Atoms whose opposite sides match, and the faces on these sides.
#[derive(Debug, Clone, Default)]
pub struct MatchedSides<const D: usize> {
    /// All atoms. Those on periodic sides come first, and are fixed.
    pub atoms: Atoms<D>,
    /// Number of atoms on periodic sides.
    pub side_count: usize,
    /// The faces on periodic sides. In the plane, only those whose label is known.
    pub faces: Vec<SideFace<D>>,
}

impl<const D: usize> MatchedSides<D> {
    /// Returns the cells at periodic sides with the index of their label. A cell at an edge of the box
    /// has several faces on sides: these, and those opposite them, get the label of most of them.
    pub(super) fn pinned_labels<M: Simplices<D>>(
        &self,
        mesh: &M,
        neighbours: &[u32],
    ) -> Vec<(usize, u32)> {
        let numbered = (0..).zip(self.faces.iter());
        let numbers: BTreeMap<[u32; D], u32> =
            numbered.map(|(i, face)| (sorted(face.nodes), i)).collect();
        let outer = neighbours.iter().enumerate().filter(|(_, n)| **n == NONE);
        let faces_of_cells = outer.filter_map(|(face, _)| {
            let (c, k) = (face / (D + 1), face % (D + 1));
            Some((c, *numbers.get(&sorted(mesh.face(c, k)))?))
        });
        let faces_of_cells: Vec<(usize, u32)> = faces_of_cells.collect();
        let mut groups = UnionFind::new(self.faces.len());
        for pair in faces_of_cells
            .windows(2)
            .filter(|pair| pair[0].0 == pair[1].0)
        {
            groups.unite(pair[0].1, pair[1].1);
        }
        for (i, opposite) in self.opposite_faces() {
            groups.unite(i, opposite);
        }
        let (group_of_face, count) = groups.into_labels();
        let mut votes: Vec<BTreeMap<u32, usize>> = vec![BTreeMap::new(); count];
        for (face, group) in self.faces.iter().zip(&group_of_face) {
            if let Some(label) = face.label {
                *votes[*group as usize].entry(label).or_default() += 1;
            }
        }
        let pinned = faces_of_cells.into_iter().filter_map(|(c, face)| {
            let votes = &votes[group_of_face[face as usize] as usize];
            let most = votes
                .iter()
                .max_by_key(|(label, n)| (**n, std::cmp::Reverse(**label)));
            Some((c, *most?.0))
        });
        pinned.collect()
    }

    /// Returns the pairs of opposite faces. Those of a far side come after those of its near side, in
    /// the same order.
    fn opposite_faces(&self) -> Vec<(u32, u32)> {
        let numbers = |axis: usize, is_high: bool| {
            let side = BoxSide { axis, is_high };
            let faces = (0..).zip(&self.faces);
            faces
                .filter(move |(_, face)| face.side == side)
                .map(|(i, _)| i)
        };
        let pairs = (0..D).flat_map(|k| numbers(k, false).zip(numbers(k, true)));
        pairs.collect()
    }

    /// Gives the nodes on periodic sides, which improvement must not move, the kinds that they have.
    pub(super) fn release(&self, kinds: &mut [AtomKind], nodes: &[[f64; D]], extent: [f64; D]) {
        let nodes = nodes[..self.side_count].iter();
        for (kind, x) in kinds.iter_mut().zip(nodes) {
            *kind = kind_at(*x, extent);
        }
    }

    /// Returns the triangles on each side.
    pub(super) fn by_side(&self) -> Vec<(BoxSide, Vec<[u32; D]>)> {
        let mut sides: Vec<(BoxSide, Vec<[u32; D]>)> = Vec::new();
        for face in &self.faces {
            match sides.iter_mut().find(|(side, _)| *side == face.side) {
                Some((_, faces)) => faces.push(face.nodes),
                None => sides.push((face.side, vec![face.nodes])),
            }
        }
        sides
    }
}

/// Returns the sentence of the report about a periodic mesh.
pub(super) fn note(axes: PeriodicAxes, check: &PeriodicCheck) -> String {
    let PeriodicCheck {
        node_pairs,
        face_pairs,
        different_regions,
    } = check;
    let regions = match different_regions {
        0 => String::new(),
        count => format!("; at {count} of these faces the regions differ"),
    };
    format!(
        "periodic along {axes}: {node_pairs} nodes and {face_pairs} faces on sides match those opposite exactly{regions}"
    )
}

/// Simplices whose opposite sides can match.
pub trait MatchSides<const D: usize>: Sized {
    /// Snaps atoms onto features, and returns them with the faces on periodic sides. Atoms on far
    /// sides are images of others.
    ///
    /// # Errors
    /// Returns the errors of the triangulation.
    fn match_sides(
        atoms: Atoms<D>,
        scene: &MeshScene<'_, D>,
        params: &LatticeParams<'_, D>,
        axes: [bool; D],
        stages: &mut StageRunner<'_>,
    ) -> Result<MatchedSides<D>>;
}

/// Snaps atoms onto features. Images stay opposite their bases.
fn snap_tied<const D: usize>(
    atoms: &mut Atoms<D>,
    scene: &MeshScene<'_, D>,
    axes: [bool; D],
) -> Result<()> {
    let nodes = tied_nodes(&atoms.positions, scene.extent, axes)?;
    let before = atoms.positions.clone();
    scene.snap(&mut atoms.positions, &atoms.kinds);
    // A feature beside a side must not draw further atoms into the side.
    for (x, old) in atoms.positions.iter_mut().zip(before) {
        let is_at_end = |c: f64, k: usize| c == 0.0 || c == scene.extent[k];
        if (0..D).any(|k| axes[k] && is_at_end(x[k], k) && !is_at_end(old[k], k)) {
            *x = old;
        }
    }
    nodes.follow_bases(&mut atoms.positions, scene.extent);
    Ok(())
}

/// Returns `true` if a point lies on a periodic side.
fn is_on_side<const D: usize>(x: &[f64; D], extent: [f64; D], axes: [bool; D]) -> bool {
    (0..D).any(|k| axes[k] && (x[k] == 0.0 || x[k] == extent[k]))
}

/// Returns the atoms with those on periodic sides, which come first, fixed.
fn with_fixed_sides<const D: usize>(
    on_sides: Vec<[f64; D]>,
    others: &Atoms<D>,
    extent: [f64; D],
    axes: [bool; D],
) -> Atoms<D> {
    let mut atoms = Atoms {
        kinds: vec![AtomKind::Fixed; on_sides.len()],
        positions: on_sides,
    };
    for (x, kind) in others.positions.iter().zip(&others.kinds) {
        if !is_on_side(x, extent, axes) {
            atoms.positions.push(*x);
            atoms.kinds.push(*kind);
        }
    }
    atoms
}

impl MatchSides<2> for TriMesh {
    fn match_sides(
        mut atoms: Atoms<2>,
        scene: &MeshScene<'_, 2>,
        _: &LatticeParams<'_, 2>,
        axes: [bool; 2],
        _: &mut StageRunner<'_>,
    ) -> Result<MatchedSides<2>> {
        snap_tied(&mut atoms, scene, axes)?;
        let extent = scene.extent;
        let on_sides = atoms.positions.iter().copied();
        let on_sides: Vec<[f64; 2]> = on_sides.filter(|x| is_on_side(x, extent, axes)).collect();
        let atoms = with_fixed_sides(on_sides, &atoms, extent, axes);
        let mut faces = Vec::new();
        for axis in (0..2).filter(|&k| axes[k]) {
            for is_high in [false, true] {
                let plane = if is_high { extent[axis] } else { 0.0 };
                let mut nodes: Vec<u32> = (0..)
                    .zip(&atoms.positions)
                    .filter(|(_, x)| x[axis] == plane)
                    .map(|(n, _)| n)
                    .collect();
                let along = |n: &u32| atoms.positions[*n as usize][1 - axis];
                nodes.sort_by(|a, b| along(a).total_cmp(&along(b)));
                faces.extend(nodes.windows(2).map(|pair| {
                    let ends = [pair[0], pair[1]].map(|n| {
                        // The labels are those of the near side.
                        let mut x = atoms.positions[n as usize];
                        x[axis] = 0.0;
                        x
                    });
                    let labels = scene.features.labels.as_ref();
                    SideFace {
                        nodes: [pair[0], pair[1]],
                        side: BoxSide { axis, is_high },
                        label: labels.map(|labels| label_of_edge(labels, ends)),
                    }
                }));
            }
        }
        Ok(MatchedSides {
            side_count: atoms
                .kinds
                .iter()
                .filter(|k| **k == AtomKind::Fixed)
                .count(),
            atoms,
            faces,
        })
    }
}

/// Returns the index of the most frequent label along an edge.
fn label_of_edge(labels: &LabelMap<2>, [a, b]: [[f64; 2]; 2]) -> u32 {
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    for i in 0..EDGE_SAMPLES {
        let share = (i as f64 + 0.5) / EDGE_SAMPLES as f64;
        let x = add_scaled(a.map(|c| c * (1.0 - share)), share, b);
        *counts.entry(labels.label_at(x)).or_default() += 1;
    }
    let most = counts
        .iter()
        .max_by_key(|(label, count)| (**count, std::cmp::Reverse(**label)));
    most.map_or(0, |(label, _)| *label)
}

impl MatchSides<3> for TetMesh {
    fn match_sides(
        mut atoms: Atoms<3>,
        scene: &MeshScene<'_, 3>,
        params: &LatticeParams<'_, 3>,
        axes: [bool; 3],
        stages: &mut StageRunner<'_>,
    ) -> Result<MatchedSides<3>> {
        snap_tied(&mut atoms, scene, axes)?;
        let extent = scene.extent;
        let mut numbers: BTreeMap<[u64; 3], u32> = BTreeMap::new();
        let (mut on_sides, mut faces) = (Vec::new(), Vec::new());
        for axis in (0..3).filter(|&k| axes[k]) {
            let layer = SideLayer::new(axis, scene);
            let mesh = layer.mesh(&atoms, params, stages)?;
            for is_high in [false, true] {
                let plane = if is_high { extent[axis] } else { 0.0 };
                let nodes: Vec<u32> = (mesh.nodes.iter())
                    .map(|&[u, v]| {
                        let mut x = [plane; 3];
                        (x[layer.others[0]], x[layer.others[1]]) = (u, v);
                        let key = x.map(|c| (c + 0.0).to_bits());
                        *numbers.entry(key).or_insert_with(|| {
                            on_sides.push(x);
                            on_sides.len() as u32 - 1
                        })
                    })
                    .collect();
                let triangles = mesh.triangles.iter().zip(&mesh.labels);
                faces.extend(triangles.map(|(triangle, &label)| SideFace {
                    nodes: triangle.map(|n| nodes[n as usize]),
                    side: BoxSide { axis, is_high },
                    label,
                }));
            }
        }
        Ok(MatchedSides {
            side_count: on_sides.len(),
            atoms: with_fixed_sides(on_sides, &atoms, extent, axes),
            faces,
        })
    }
}

/// A near side of a box in space, as a box in the plane.
struct SideLayer<'a> {
    axis: usize,
    /// The other axes.
    others: [usize; 2],
    extent: [f64; 2],
    scene: &'a MeshScene<'a, 3>,
}

/// The triangles of a side.
struct SideMesh {
    nodes: Vec<[f64; 2]>,
    triangles: Vec<[u32; 3]>,
    /// Index of the label of each triangle, if the image has labels.
    labels: Vec<Option<u32>>,
}

impl<'a> SideLayer<'a> {
    fn new(axis: usize, scene: &'a MeshScene<'a, 3>) -> Self {
        let others = [usize::from(axis == 0), 2 - usize::from(axis == 2)];
        Self {
            axis,
            others,
            extent: others.map(|k| scene.extent[k]),
            scene,
        }
    }

    /// Returns the position in space of a point of the side.
    fn position(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        let mut x = [0.0; 3];
        (x[self.others[0]], x[self.others[1]]) = (u, v);
        x
    }

    /// Returns the labels of the layer of samples in the side, by their index, as an image.
    fn label_image(&self, labels: &LabelMap<3>) -> Image<2> {
        let volume = Volume::new(labels.dims, &[]);
        let dims = self.others.map(|k| labels.dims[k]);
        let sample = |i: usize| {
            let mut at = [0; 3];
            (at[self.others[0]], at[self.others[1]]) = (i % dims[0], i / dims[0]);
            labels.winner[volume.index(at)] as f32
        };
        let samples = (0..dims[0] * dims[1]).map(sample).collect();
        Image::new(dims, samples, Geometry::default())
    }

    /// Returns the nominal distance in the side.
    fn distance(&self) -> Distance<2> {
        match self.scene.distance {
            Distance::Constant(d) => Distance::Constant(*d),
            Distance::Field(_) | Distance::Bricks(_) => {
                let step = 0.5 * self.scene.distance.min();
                let dims = self
                    .extent
                    .map(|length| (length / step).ceil() as usize + 1);
                let steps: [f64; 2] =
                    std::array::from_fn(|k| self.extent[k] / (dims[k] - 1).max(1) as f64);
                Distance::Field(ScalarField::from_fn(dims, steps, |x| {
                    self.scene.distance.value_at(self.position(x))
                }))
            }
        }
    }

    /// Joins the atoms on the side to triangles. Those on its edges do not move.
    fn mesh(
        &self,
        atoms: &Atoms<3>,
        params: &LatticeParams<'_, 3>,
        stages: &mut StageRunner<'_>,
    ) -> Result<SideMesh> {
        let on_side = atoms.positions.iter().filter(|x| x[self.axis] == 0.0);
        let positions: Vec<[f64; 2]> = on_side.map(|x| self.others.map(|k| x[k])).collect();
        let kinds = positions.iter().map(|&x| match kind_at(x, self.extent) {
            AtomKind::Interior => AtomKind::Interior,
            _ => AtomKind::Fixed,
        });
        let atoms = Atoms {
            kinds: kinds.collect(),
            positions,
        };
        let step = self.others.map(|k| self.scene.features.potential.step[k]);
        let labels = self.scene.features.labels.as_ref();
        let image = labels.map(|labels| self.label_image(labels));
        let first = image.as_ref().map_or(0.0, |image| image.as_slice()[0]);
        let options = DetectionOptions {
            kind: FeatureKind::Labels,
            d_min: self.scene.distance.min(),
            step,
            ..DetectionOptions::default()
        };
        let is_varied = |image: &&Image<2>| image.as_slice().iter().any(|s| *s != first);
        let features = match image.as_ref().filter(is_varied) {
            Some(image) => detect(image, &options)?,
            None => {
                let dims = self.others.map(|k| self.scene.features.potential.dims[k]);
                Features::empty(dims, &options)
            }
        };
        let distance = self.distance();
        let scene = MeshScene {
            extent: self.extent,
            features: &features,
            distance: &distance,
        };
        let spec = MeshSpec {
            distance: NominalDistance::Constant(self.scene.distance.max()),
            min_dihedral: Some(params.spec().min_angle()),
            effort: params.spec().effort,
            ..MeshSpec::default()
        };
        let params = &Params::new(spec)?;
        let params = &LatticeParams::new(params, 1.0);
        let blank = Image::new([2; 2], vec![0.0; 4], Geometry::default());
        let source = ImageSource::InMemory(image.as_ref().unwrap_or(&blank));
        let mut quiet = QuietProgress(stages.progress);
        let mut own_stages = StageRunner::new(&mut quiet).with_kernel(stages.kernel);
        let made =
            make_simplices::<2, TriMesh>(atoms, &scene, source, params, None, &mut own_stages)?;
        let TriMesh { nodes, triangles } = made.annotated.mesh;
        let regions = made.annotated.regions;
        let label = |t: usize| match (&image, features.labels.is_some()) {
            (Some(_), true) => regions.get(t).map(|&label| label as u32),
            (Some(_), false) => Some(first as u32),
            (None, _) => None,
        };
        Ok(SideMesh {
            labels: (0..triangles.len()).map(label).collect(),
            nodes,
            triangles,
        })
    }
}

/// A progress that only asks whether to continue.
struct QuietProgress<'a>(&'a mut dyn Progress);

impl Progress for QuietProgress<'_> {
    fn keep_going(&mut self) -> bool {
        self.0.keep_going()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::image_of;
    use crate::job::{MeshImage, Metric, Outcome, run};
    use crate::mesh::periodic::check_periodic;
    use crate::mesh::{Mesh, Space};
    use crate::progress::NoProgress;

    /// Returns grains around random points, with periods of `dims` less one sample.
    fn grains<const D: usize>(dims: [usize; D], count: usize, seed: u64) -> Image<D> {
        let mut state = seed;
        let mut random = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        let period = dims.map(|n| (n - 1) as f64);
        let centres: Vec<[f64; D]> = (0..count)
            .map(|_| std::array::from_fn(|k| random() * period[k]))
            .collect();
        let volume = Volume::new(dims, &[]);
        let label = |i: usize| {
            let x = volume.coordinates(i).map(|c| c as f64);
            let distance = |centre: &[f64; D]| {
                let axes = (0..D).map(|k| {
                    let gap = (x[k] - centre[k]).rem_euclid(period[k]);
                    gap.min(period[k] - gap).powi(2)
                });
                axes.sum::<f64>()
            };
            let nearest =
                (0..count).min_by(|&a, &b| distance(&centres[a]).total_cmp(&distance(&centres[b])));
            nearest.unwrap_or(0) as f32
        };
        let samples = (0..dims.iter().product()).map(label).collect();
        Image::new(dims, samples, Geometry::default())
    }

    fn spec(axes: &str, distance: f64) -> MeshSpec {
        MeshSpec {
            distance: NominalDistance::Constant(distance),
            feature: FeatureKind::Labels,
            periodic: Some(axes.parse().unwrap()),
            ..MeshSpec::default()
        }
    }

    /// Meshes an image, and checks that its sides match and the rest of it is sound.
    fn mesh_periodic<const D: usize>(
        image: &Image<D>,
        spec: MeshSpec,
    ) -> (Outcome<D>, PeriodicCheck)
    where
        Space<D>: MeshImage<D>,
    {
        let axes = spec.periodic.unwrap();
        let outcome = run(image, &Params::new(spec).unwrap(), &mut NoProgress).unwrap();
        let annotated = outcome.simplices().unwrap();
        let neighbours = annotated.mesh.neighbours().unwrap();
        let flags = std::array::from_fn(|k| axes.0[k]);
        let (nodes, check) = check_periodic(
            &annotated.mesh,
            &neighbours,
            &annotated.regions,
            outcome.extent,
            flags,
        )
        .unwrap();
        assert_eq!(outcome.periodic_nodes, Some(nodes));
        assert!(check.node_pairs > 0 && check.face_pairs > 0, "{check:?}");
        let note = note(axes, &check);
        assert!(
            outcome.report.notes.contains(&note),
            "{:?}",
            outcome.report.notes
        );
        let kinds = annotated.node_kinds.iter().zip(annotated.mesh.nodes());
        for (kind, x) in kinds.filter(|(_, x)| is_on_side(x, outcome.extent, flags)) {
            assert_eq!(*kind, kind_at(*x, outcome.extent));
        }
        (outcome, check)
    }

    #[test]
    fn grains_match_on_opposite_sides_along_each_axis_alone_and_all() {
        for (axes, seed) in [("x", 1), ("y", 2), ("z", 3), ("z,x", 4), ("x,y,z", 5)] {
            let image = grains([27, 23, 25], 12, seed);
            let (outcome, check) = mesh_periodic(&image, spec(axes, 4.0));
            assert_eq!(check.different_regions, 0, "{axes}: {check:?}");
            let quality = outcome.report.quality.as_ref().unwrap();
            assert!(quality.smallest_angle.worst > 10.0, "{axes}: {quality:?}");
        }
    }

    #[test]
    fn grains_of_the_plane_match_on_opposite_sides_for_several_seeds() {
        for (axes, seed) in [("x", 1), ("y", 2), ("x,y", 3), ("y,x", 4)] {
            let image = grains([51, 43], 14, seed);
            let (outcome, check) = mesh_periodic(&image, spec(axes, 4.0));
            assert_eq!(check.different_regions, 0, "{axes}");
            let quality = outcome.report.quality.as_ref().unwrap();
            assert!(quality.smallest_angle.worst > 15.0, "{axes}: {quality:?}");
        }
    }

    #[test]
    fn distances_and_samples_may_vary_and_axes_be_scaled() {
        let image = grains([25, 27, 23], 10, 7);
        for (distance, metric) in [
            (
                NominalDistance::Range { min: 2.7, max: 5.0 },
                Metric::Samples,
            ),
            (
                NominalDistance::Constant(4.0),
                Metric::Scales(vec![1.0, 0.7, 1.4]),
            ),
        ] {
            let spec = MeshSpec {
                distance,
                metric,
                ..spec("x,y,z", 4.0)
            };
            mesh_periodic(&image, spec);
        }
    }

    #[test]
    fn the_layers_of_a_laminate_are_exact() {
        // Layers along each axis in turn, of 9 and 15 of 24 samples.
        for normal in 0..3 {
            let dims: [usize; 3] = std::array::from_fn(|k| if k == normal { 25 } else { 19 });
            let image = image_of(dims, |p| {
                let c = p[normal] % 24.0;
                f64::from(u8::from((6.5..15.5).contains(&c)))
            });
            let (outcome, check) = mesh_periodic(&image, spec("x,y,z", 4.0));
            assert_eq!(check.different_regions, 0);
            let regions = &outcome.report.regions.as_ref().unwrap().regions;
            for (region, thickness) in regions.iter().zip([15.0, 9.0]) {
                let expected = thickness * 18.0 * 18.0;
                let error = region.volume / expected - 1.0;
                assert!(error.abs() < 2e-3, "{normal}: {region:?}");
            }
        }
    }

    #[test]
    fn a_plain_box_is_periodic_too() {
        let image = image_of([20, 22, 24], |p| p[0] % 19.0);
        let spec = MeshSpec {
            feature: FeatureKind::NoFeatures,
            ..spec("x,y,z", 5.0)
        };
        mesh_periodic(&image, spec);
    }

    #[test]
    fn images_that_do_not_repeat_are_refused_with_the_share_that_agrees() {
        let image = image_of([20, 20, 20], |p| f64::from(u8::from(p[0] > 9.0)));
        let params = Params::new(spec("y,x", 4.0)).unwrap();
        let message = run(&image, &params, &mut NoProgress)
            .unwrap_err()
            .to_string();
        assert!(
            message.starts_with("periodic x,y: needs an image whose last layer repeats the first, but along x they agree in 0.0 %"),
            "{message}"
        );
        let plane = grains([31, 31], 5, 1);
        let params = Params::<2>::new(spec("z", 4.0)).unwrap();
        let message = run(&plane, &params, &mut NoProgress)
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("names z, but the image is 2-D"),
            "{message}"
        );
        // Labels that differ by 1 of 50 do not agree.
        let labels = image_of([9, 9, 9], |p| 40.0 + p[0].min(7.0) + p[1]);
        assert!(agreement(&labels, 0) < 0.01 && agreement(&labels, 2) == 1.0);
        let grey = image_of([9, 9, 9], |p| 0.001 * p[0] + p[1] + 0.5);
        assert!(agreement(&grey, 0) == 1.0 && agreement(&grey, 1) == 0.0);
    }
}
