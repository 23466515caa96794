//! Certifies a mesh of labels against the image: each connected part of each label, sample by sample.
//!
//! Input: the labels of an image with their connected parts (samples that touch face to face), and the
//! cells of a mesh with a label each, whatever their kind ([`LabelledCells`]). All lengths are in samples.
//!
//! 1. `voxel_parts` collects the faces between samples of different labels (the voxels' boundary, halfway
//!    between samples), the pairs of parts that are neighbours, and Euler numbers.
//! 2. `mesh_parts` decides which cells stand for which part, and collects the facets between parts.
//! 3. `labelled_cells` finds the cell at each sample.
//! 4. `distances` measures the distances between the two boundaries, and how thick parts are.
//! 5. `topology` computes the Euler numbers of the mesh, and finds nodes at which parts touch that are
//!    nowhere neighbours in the image.
//! 6. `lines` formats the result, and `figures` compares it with another.

mod distances;
mod figures;
mod labelled_cells;
pub(super) mod lines;
mod mesh_parts;
mod topology;
mod voxel_parts;

pub use labelled_cells::LabelledCells;

use serde::Serialize;

use crate::feature::components::{Component, Components};
use crate::geometry::NONE;
use crate::geometry::grid_index::index_at;
use crate::image::{Geometry, LabelValue};
use crate::progress::CancelToken;
use distances::{DistanceSum, PartSurfaces, voxel_thickness};
use mesh_parts::MeshParts;
use topology::{PinchedNode, euler_numbers, pinched_nodes};
use voxel_parts::VoxelParts;

/// Number of samples from which a part is large.
const LARGE_SAMPLES: usize = 500;

/// Number of samples from which a part is more than a speck: a cube of three samples.
const SPECK_SAMPLES: usize = 27;

/// Least thickness of a thick part, in samples.
const THICK_SAMPLES: f64 = 3.0;

/// Fraction of a part's volume below which the part is lost.
const MIN_KEPT_SHARE: f64 = 0.25;

/// Number of parts, of pinches and of labels with changed samples that are listed.
const MAX_LISTED: usize = 300;

/// Largest error of the volume of a thick part, in percent.
pub(crate) const MAX_THICK_ERROR_PERCENT: f64 = 1.0;

/// Largest error of the volume of a thin or a small part, in percent.
pub(crate) const MAX_THIN_ERROR_PERCENT: f64 = 5.0;

/// Least share of a part's boundary that lies within one sample of that of the mesh, and the other way
/// round.
pub(crate) const MIN_BOUNDARY_SHARE: f64 = 0.95;

/// Largest error of the volume of a thick part, in percent, in a mesh that is of any use.
const MAX_USABLE_VOLUME_ERROR_PERCENT: f64 = 50.0;
/// Least share of the boundary of a thick part that lies within one sample in a mesh that is of any use.
const MIN_USABLE_BOUNDARY_SHARE: f64 = 0.5;

/// Kind of a part by its size in the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PartClass {
    /// At least 500 samples, and at least three samples thick.
    Thick,
    /// At least 500 samples, and less than three samples thick.
    Thin,
    /// From 27 to 499 samples.
    Small,
    /// Less than 27 samples.
    Speck,
}

impl PartClass {
    const ALL: [Self; 4] = [Self::Thick, Self::Thin, Self::Small, Self::Speck];

    /// Returns the largest error of the volume, in percent, that is no issue. Specks have none.
    fn max_volume_error(self) -> Option<f64> {
        match self {
            Self::Thick => Some(MAX_THICK_ERROR_PERCENT),
            Self::Thin | Self::Small => Some(MAX_THIN_ERROR_PERCENT),
            Self::Speck => None,
        }
    }
}

/// A mesh of labels judged by the samples of the image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Certificate {
    /// Number of connected parts of labels in the image.
    pub parts: usize,
    /// Number of parts that are lost: their cells have less than a quarter of their volume.
    pub lost_parts: usize,
    /// Number of samples of lost parts.
    pub lost_samples: usize,
    /// Number of samples of the image.
    pub samples: usize,
    /// Number of samples that lie in a cell of another label.
    pub changed_samples: usize,
    /// Samples that changed sides, by label, the most first.
    pub changed: Vec<ChangedSamples>,
    /// The parts by size.
    pub classes: Vec<ClassReport>,
    /// Distances from the voxels' boundary to the faces between regions.
    pub boundary: Option<BoundaryDistances>,
    /// Distances from the faces between regions to the voxels' boundary.
    pub faces: Option<BoundaryDistances>,
    /// Number of nodes that belong to cells of two parts that are nowhere neighbours in the image, in any
    /// of the 26 directions (8 in 2-D).
    pub pinch_count: usize,
    /// These nodes, at most the first 300.
    pub pinches: Vec<Pinch>,
    /// Number of places at which parts of the image touch themselves at an edge or a corner only, so that
    /// their Euler number is ambiguous.
    pub ambiguous_contacts: usize,
    /// Number of cells without any sample of their label near, and their volume.
    pub stray_cells: usize,
    /// Volume of these cells, in samples.
    pub stray_volume: f64,
    /// The largest parts, at most 300, by the number of samples.
    pub part_reports: Vec<PartReport>,
    /// Number of parts that are not among these.
    pub parts_left_out: usize,
    /// The worst part for each kind of issue, the most important kind first.
    pub issues: Vec<PartIssue>,
}

/// Samples of a label that changed sides.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChangedSamples {
    /// The label.
    pub label: LabelValue,
    /// Number of its samples that lie in cells of other labels.
    pub lost: usize,
    /// Number of samples of other labels that lie in its cells.
    pub gained: usize,
}

/// Parts of one class.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClassReport {
    /// The class.
    pub class: PartClass,
    /// Number of parts.
    pub parts: usize,
    /// Number of parts that are lost.
    pub lost: usize,
    /// Number of parts that are not lost, and whose volume is off by more than the class allows.
    pub off_volume: usize,
    /// Number of parts whose surface in the mesh has another Euler number.
    pub wrong_euler: usize,
    /// Lowest Dice coefficient of parts that are not lost.
    pub min_dice: Option<f64>,
    /// Least share of the boundary of a part that lies within one sample of the other boundary.
    pub min_boundary_share: f64,
    /// The part with the largest volume error among those that are not lost.
    pub worst_volume: Option<PartReport>,
    /// The part with the largest distance between its boundary and that of the mesh.
    pub worst_distance: Option<PartReport>,
}

/// Distances from one boundary to another, in samples.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BoundaryDistances {
    /// Mean over the area.
    pub mean: f64,
    /// Share of the area within half a sample.
    pub within_half: f64,
    /// Share of the area within one sample.
    pub within_one: f64,
    /// Largest distance. From faces to the voxels' boundary, 24 samples stand for all larger ones.
    pub worst: f64,
    /// Place of the largest distance, in the coordinates of the image.
    pub worst_at: Vec<f64>,
}

/// A node at which two parts touch that are nowhere neighbours in the image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pinch {
    /// Labels of the two parts.
    pub labels: [LabelValue; 2],
    /// `true` if these labels are nowhere neighbours, `false` if only the parts are not.
    pub are_labels_apart: bool,
    /// Position of the node, in the coordinates of the image.
    pub at: Vec<f64>,
}

/// A connected part of a label, in the image and in the mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartReport {
    /// Value of its samples.
    pub label: LabelValue,
    /// Name of the label.
    pub name: Option<String>,
    /// Kind of the part by its size.
    pub class: PartClass,
    /// Number of samples.
    pub samples: usize,
    /// Position of the first sample, in the coordinates of the image.
    pub first_sample: Vec<f64>,
    /// `true` if it is lost.
    pub is_lost: bool,
    /// Number of cells.
    pub cells: usize,
    /// Volume (in 2-D area) of its cells, in the units of the image.
    pub volume: f64,
    /// Volume of its samples inside the box through the outermost samples.
    pub sample_volume: f64,
    /// Difference of the volume from that of the samples, in percent.
    pub volume_error_percent: f64,
    /// Dice coefficient of its samples and the samples in its cells.
    pub dice: f64,
    /// Distances from its boundary in the image to the faces of its label.
    pub boundary: Option<BoundaryDistances>,
    /// Distances from the faces of its cells to the boundary of its label in the image.
    pub faces: Option<BoundaryDistances>,
    /// Thickness in the image, in samples: along the normal, and at 95 % of the boundary at least. At
    /// most 16.
    pub thickness: Option<f64>,
    /// Thickness in the mesh.
    pub mesh_thickness: Option<f64>,
    /// Smallest and largest Euler number of its surface in the image (in 2-D of the part): they differ
    /// where it touches itself at an edge or a corner only.
    pub euler: [i64; 2],
    /// Number of samples' corners where it touches itself so.
    pub ambiguous_contacts: usize,
    /// Euler number of its surface in the mesh (in 2-D of the part).
    pub mesh_euler: Option<i64>,
}

impl PartReport {
    /// Returns `true` if the Euler number in the mesh is not among those in the image.
    pub fn has_wrong_euler(&self) -> bool {
        let [low, high] = self.euler;
        self.mesh_euler
            .is_some_and(|euler| !(low..=high).contains(&euler))
    }

    /// Returns `true` if the volume is off by more than the part's class allows.
    fn is_off_volume(&self) -> bool {
        let max = self.class.max_volume_error();
        max.is_some_and(|max| self.volume_error_percent.abs() > max)
    }

    /// Returns the least share of the boundary within one sample, in either direction.
    fn boundary_share(&self) -> f64 {
        let both = [&self.boundary, &self.faces].into_iter().flatten();
        both.fold(1.0, |least, distances| distances.within_one.min(least))
    }

    /// Returns the largest distance in either direction, and its place.
    fn worst_distance(&self) -> Option<(f64, &[f64])> {
        let both = [&self.boundary, &self.faces].into_iter().flatten();
        let distances = both.map(|distances| (distances.worst, &*distances.worst_at));
        distances.reduce(|best, next| if next.0 > best.0 { next } else { best })
    }
}

/// Kind of an issue of parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PartIssueKind {
    /// Parts that are nowhere neighbours touch at nodes.
    Pinch,
    /// Parts are lost.
    Lost,
    /// Volumes are off.
    Volume,
    /// Surfaces have another Euler number.
    Euler,
    /// Much of the boundary is more than a sample away.
    Boundary,
}

/// An issue of parts: how many have it, and the worst of them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartIssue {
    /// The kind.
    pub kind: PartIssueKind,
    /// Number of parts (of nodes for pinches).
    pub count: usize,
    /// Label of the worst part.
    pub label: LabelValue,
    /// Number of samples of the worst part.
    pub samples: usize,
    /// Class of the worst part; `None` for pinches.
    pub class: Option<PartClass>,
    /// The figure: error in percent, Euler number, or share of the boundary; the largest number of
    /// samples of lost parts.
    pub value: f64,
    /// Description of the worst part.
    pub message: String,
    /// Place of the issue, in the coordinates of the image.
    pub at: Vec<f64>,
}

/// The image of a certificate.
pub struct CertifiedImage<'a, const D: usize> {
    /// The connected parts of its labels.
    pub components: &'a Components<D>,
    /// Index of the label of each sample.
    pub indices: &'a [u32],
    /// Values of the labels.
    pub labels: &'a [LabelValue],
    /// Names of the labels; may be empty.
    pub names: &'a [Option<String>],
    /// `true` for each part that the mesh leaves out on request, and that is not judged; may be empty.
    pub dropped: &'a [bool],
    /// The geometry of the image.
    pub geometry: &'a Geometry<D>,
}

/// Returns for each connected part whether a mesh leaves it out: if its label is not kept, or if it is not the
/// largest part of its label and `keeps_largest`.
pub fn dropped_parts<const D: usize>(
    components: &Components<D>,
    is_label_kept: &[bool],
    keeps_largest: bool,
) -> Vec<bool> {
    let parts = &components.components;
    let mut largest = vec![0; is_label_kept.len()];
    for part in parts {
        let largest = &mut largest[part.label as usize];
        *largest = part.sample_count.max(*largest);
    }
    let is_dropped = |part: &Component<D>| {
        let label = part.label as usize;
        !is_label_kept[label] || keeps_largest && part.sample_count < largest[label]
    };
    parts.iter().map(is_dropped).collect()
}

/// Judges the cells of a mesh by the samples of an image. Returns `None` if `cancel` is cancelled.
pub fn certify<const D: usize>(
    image: &CertifiedImage<'_, D>,
    cells: &LabelledCells<'_, D>,
    cancel: &CancelToken<'_>,
) -> Option<Certificate> {
    let voxels = &VoxelParts::new(image.components, image.indices);
    let mesh = &MeshParts::new(cells, voxels);
    if cancel.is_cancelled() {
        return None;
    }
    let overlap = Overlap::new(cells, mesh, voxels, image.labels.len());
    let surfaces = PartSurfaces::new(cells, mesh, voxels);
    if cancel.is_cancelled() {
        return None;
    }
    let from_voxels = surfaces.distances_from_voxels();
    if cancel.is_cancelled() {
        return None;
    }
    let to_voxels = surfaces.distances_to_voxels();
    let part_count = image.components.components.len();
    let judged = JudgedParts {
        image,
        voxels,
        overlap,
        boundaries: [from_voxels, to_voxels],
        thickness: [voxel_thickness(voxels), surfaces.mesh_thickness()],
        mesh_euler: euler_numbers(cells, mesh, part_count),
    };
    let mut pinched = pinched_nodes(mesh, voxels);
    pinched.retain(|node| {
        node.parts
            .iter()
            .any(|&part| judged.is_judged(part as usize))
    });
    let pinches = |nodes: &[PinchedNode]| judged.pinches(nodes, cells);
    Some(judged.certificate(&pinched, pinches))
}

/// Volumes and samples of parts in the mesh.
struct Overlap {
    /// Volume of the cells of each part, in samples, and their number.
    volumes: Vec<f64>,
    cell_counts: Vec<usize>,
    /// Weight of the samples in cells of each part, and of those that are its own.
    in_cells: Vec<f64>,
    kept: Vec<f64>,
    /// Numbers of samples of each label that are lost and gained.
    changed: Vec<[usize; 2]>,
    stray_cells: usize,
    stray_volume: f64,
}

impl Overlap {
    fn new<const D: usize>(
        cells: &LabelledCells<'_, D>,
        mesh: &MeshParts<D>,
        voxels: &VoxelParts<'_, D>,
        label_count: usize,
    ) -> Self {
        let components = voxels.components;
        let part_count = components.components.len();
        let mut overlap = Self {
            volumes: vec![0.0; part_count],
            cell_counts: vec![0; part_count],
            in_cells: vec![0.0; part_count],
            kept: vec![0.0; part_count],
            changed: vec![[0; 2]; label_count],
            stray_cells: 0,
            stray_volume: 0.0,
        };
        for (&part, volume) in mesh.part_of_cell.iter().zip(&cells.volumes) {
            if part == NONE {
                overlap.stray_cells += 1;
                overlap.stray_volume += volume;
            } else {
                overlap.volumes[part as usize] += volume;
                overlap.cell_counts[part as usize] += 1;
            }
        }
        let dims = components.dims;
        let cell_of_sample = cells.cells_at_samples(dims, voxels.labels);
        for (sample, &cell) in cell_of_sample.iter().enumerate() {
            if cell == NONE {
                continue;
            }
            let at = index_at(dims, sample);
            let sides = (0..D)
                .filter(|&k| at[k] == 0 || at[k] + 1 == dims[k])
                .count();
            let weight = 0.5f64.powi(sides as i32);
            let (part, cell_part) = (voxels.part_at(sample), mesh.part_of_cell[cell as usize]);
            if cell_part != NONE {
                overlap.in_cells[cell_part as usize] += weight;
            }
            if cell_part == part {
                overlap.kept[part as usize] += weight;
            }
            let [label, cell_label] = [voxels.labels[sample], cells.labels[cell as usize]];
            if label != cell_label {
                overlap.changed[label as usize][0] += 1;
                overlap.changed[cell_label as usize][1] += 1;
            }
        }
        overlap
    }
}

/// All figures of all parts.
struct JudgedParts<'a, const D: usize> {
    image: &'a CertifiedImage<'a, D>,
    voxels: &'a VoxelParts<'a, D>,
    overlap: Overlap,
    /// Distances from the voxels' boundary, and to it.
    boundaries: [Vec<DistanceSum<D>>; 2],
    /// Thickness in the image and in the mesh.
    thickness: [Vec<Option<f64>>; 2],
    mesh_euler: Vec<Option<i64>>,
}

impl<const D: usize> JudgedParts<'_, D> {
    fn is_judged(&self, part: usize) -> bool {
        !self.image.dropped.get(part).is_some_and(|dropped| *dropped)
    }

    fn place(&self, x: [f64; D]) -> Vec<f64> {
        self.image.geometry.to_physical(x).to_vec()
    }

    fn distances(&self, sum: &DistanceSum<D>) -> Option<BoundaryDistances> {
        (sum.area > 0.0).then(|| BoundaryDistances {
            mean: sum.integral / sum.area,
            within_half: sum.within[0] / sum.area,
            within_one: sum.within[1] / sum.area,
            worst: sum.worst,
            worst_at: self.place(sum.worst_at),
        })
    }

    fn class(&self, part: usize) -> PartClass {
        match self.image.components.components[part].sample_count {
            count if count < SPECK_SAMPLES => PartClass::Speck,
            count if count < LARGE_SAMPLES => PartClass::Small,
            // Without an end in the part, the thickness is that of the image.
            _ if self.thickness[0][part].is_none_or(|t| t >= THICK_SAMPLES) => PartClass::Thick,
            _ => PartClass::Thin,
        }
    }

    fn is_lost(&self, part: usize) -> bool {
        self.overlap.volumes[part] < MIN_KEPT_SHARE * self.voxels.volumes[part]
    }

    /// Returns `true` if another part of the same label touches a part at an edge or a corner.
    fn parts_in_touch(&self) -> Vec<bool> {
        let components = &self.image.components.components;
        let mut touch = vec![false; components.len()];
        for &[a, b] in self.voxels.neighbours() {
            if components[a as usize].label == components[b as usize].label {
                touch[a as usize] = true;
                touch[b as usize] = true;
            }
        }
        touch
    }

    fn report(&self, part: usize) -> PartReport {
        let component = &self.image.components.components[part];
        let (label, overlap) = (component.label as usize, &self.overlap);
        let [volume, sample_volume] = [overlap.volumes[part], self.voxels.volumes[part]];
        let world = self.image.geometry.determinant().abs();
        let euler = self.voxels.euler[part];
        // The surface of a body has twice the Euler number of the body.
        let factor = if D == 2 { 1 } else { 2 };
        PartReport {
            label: self.image.labels[label],
            name: self.image.names.get(label).cloned().flatten(),
            class: self.class(part),
            samples: component.sample_count,
            first_sample: self.place(
                index_at(self.image.components.dims, component.first_sample).map(|i| i as f64),
            ),
            is_lost: self.is_lost(part),
            cells: overlap.cell_counts[part],
            volume: volume * world,
            sample_volume: sample_volume * world,
            volume_error_percent: 100.0 * (volume / sample_volume - 1.0),
            dice: 2.0 * overlap.kept[part] / (sample_volume + overlap.in_cells[part]),
            boundary: self.distances(&self.boundaries[0][part]),
            faces: self.distances(&self.boundaries[1][part]),
            thickness: self.thickness[0][part],
            mesh_thickness: self.thickness[1][part],
            euler: euler.bounds.map(|bound| factor * bound),
            ambiguous_contacts: euler.contacts,
            mesh_euler: self.mesh_euler[part],
        }
    }

    fn pinches(&self, nodes: &[PinchedNode], cells: &LabelledCells<'_, D>) -> Vec<Pinch> {
        let mut neighbours: Vec<[u32; 2]> = (self.voxels.neighbours().iter())
            .map(|pair| crate::geometry::sorted(pair.map(|part| self.voxels.label_of(part))))
            .collect();
        neighbours.sort_unstable();
        neighbours.dedup();
        let pinch = |node: &PinchedNode| {
            let labels = crate::geometry::sorted(node.parts.map(|part| self.voxels.label_of(part)));
            Pinch {
                labels: labels.map(|n| self.image.labels[n as usize]),
                are_labels_apart: labels[0] != labels[1]
                    && neighbours.binary_search(&labels).is_err(),
                at: self.place(cells.position(node.node)),
            }
        };
        nodes.iter().take(MAX_LISTED).map(pinch).collect()
    }

    fn certificate(
        &self,
        pinched: &[PinchedNode],
        pinches: impl Fn(&[PinchedNode]) -> Vec<Pinch>,
    ) -> Certificate {
        let part_count = self.image.components.components.len();
        let touch = self.parts_in_touch();
        let mut counter = Counter::default();
        let mut order: Vec<usize> = (0..part_count)
            .filter(|&part| self.is_judged(part))
            .collect();
        let part_count = order.len();
        let size = |part: usize| self.image.components.components[part].sample_count;
        order.sort_by_key(|&part| (std::cmp::Reverse(size(part)), part));
        let mut part_reports = Vec::new();
        for &part in &order {
            let report = self.report(part);
            counter.add(&report, touch[part]);
            if part_reports.len() < MAX_LISTED {
                part_reports.push(report);
            }
        }
        let total = |sums: &[DistanceSum<D>]| {
            let mut total = DistanceSum::default();
            let judged = (0..sums.len()).filter(|&part| self.is_judged(part));
            judged.for_each(|part| total.merge(&sums[part]));
            self.distances(&total)
        };
        let pinches = pinches(pinched);
        let mut issues = counter.issues;
        if let (Some(pinch), Some(node)) = (pinches.first(), pinched.first()) {
            let samples = node.parts.map(|part| size(part as usize));
            issues.push(lines::pinch_issue(pinch, pinched.len(), samples));
        }
        issues.sort_by_key(|issue| issue.kind);
        Certificate {
            parts: part_count,
            lost_parts: counter.lost_parts,
            lost_samples: counter.lost_samples,
            samples: self.voxels.labels.len(),
            changed_samples: self.overlap.changed.iter().map(|[lost, _]| lost).sum(),
            changed: self.changed_samples(),
            classes: counter.classes,
            boundary: total(&self.boundaries[0]),
            faces: total(&self.boundaries[1]),
            pinch_count: pinched.len(),
            pinches,
            ambiguous_contacts: self.voxels.euler.iter().map(|euler| euler.contacts).sum(),
            stray_cells: self.overlap.stray_cells,
            stray_volume: self.overlap.stray_volume,
            parts_left_out: part_count - part_reports.len(),
            part_reports,
            issues,
        }
    }

    fn changed_samples(&self) -> Vec<ChangedSamples> {
        let changed = self.overlap.changed.iter().zip(self.image.labels);
        let mut changed: Vec<ChangedSamples> = changed
            .filter(|([lost, gained], _)| lost + gained > 0)
            .map(|(&[lost, gained], &label)| ChangedSamples {
                label,
                lost,
                gained,
            })
            .collect();
        changed.sort_by_key(|changed| std::cmp::Reverse(changed.lost + changed.gained));
        changed.truncate(MAX_LISTED);
        changed
    }
}

/// Counts parts by class, and finds the worst.
#[derive(Default)]
struct Counter {
    classes: Vec<ClassReport>,
    lost_parts: usize,
    lost_samples: usize,
    issues: Vec<PartIssue>,
}

impl Counter {
    /// Adds a part; `touches` is `true` if it touches another part of its label at an edge or a corner.
    fn add(&mut self, part: &PartReport, touches: bool) {
        if self.classes.is_empty() {
            self.classes = PartClass::ALL.map(ClassReport::new).to_vec();
        }
        self.classes[part.class as usize].add(part);
        if part.is_lost {
            self.lost_parts += 1;
            self.lost_samples += part.samples;
            // A few samples that touch others of their label are no part of their own.
            if !touches || part.class != PartClass::Speck {
                self.add_issue(part, PartIssueKind::Lost, part.samples as f64);
            }
            return;
        }
        if part.is_off_volume() {
            self.add_issue(part, PartIssueKind::Volume, part.volume_error_percent);
        }
        if part.class == PartClass::Speck {
            return;
        }
        if part.has_wrong_euler() {
            let euler = part.mesh_euler.unwrap_or_default();
            self.add_issue(part, PartIssueKind::Euler, euler as f64);
        }
        if part.boundary_share() < MIN_BOUNDARY_SHARE {
            self.add_issue(part, PartIssueKind::Boundary, part.boundary_share());
        }
    }

    fn add_issue(&mut self, part: &PartReport, kind: PartIssueKind, value: f64) {
        // Parts come by size, the largest first.
        let is_worse = |known: f64| match kind {
            PartIssueKind::Volume => value.abs() > known.abs(),
            PartIssueKind::Boundary => value < known,
            PartIssueKind::Pinch | PartIssueKind::Lost | PartIssueKind::Euler => false,
        };
        let issue = |count: usize| lines::part_issue(part, kind, count, value);
        match self.issues.iter_mut().find(|issue| issue.kind == kind) {
            Some(known) if is_worse(known.value) => *known = issue(known.count + 1),
            Some(known) => known.count += 1,
            None => self.issues.push(issue(1)),
        }
    }
}

impl ClassReport {
    fn new(class: PartClass) -> Self {
        Self {
            class,
            parts: 0,
            lost: 0,
            off_volume: 0,
            wrong_euler: 0,
            min_dice: None,
            min_boundary_share: 1.0,
            worst_volume: None,
            worst_distance: None,
        }
    }

    fn add(&mut self, part: &PartReport) {
        self.parts += 1;
        if part.is_lost {
            self.lost += 1;
            return;
        }
        self.off_volume += usize::from(part.is_off_volume());
        self.wrong_euler += usize::from(part.has_wrong_euler());
        self.min_dice = Some(self.min_dice.map_or(part.dice, |dice| dice.min(part.dice)));
        self.min_boundary_share = self.min_boundary_share.min(part.boundary_share());
        let error = |part: &PartReport| part.volume_error_percent.abs();
        if self
            .worst_volume
            .as_ref()
            .is_none_or(|worst| error(part) > error(worst))
        {
            self.worst_volume = Some(part.clone());
        }
        let distance = |part: &PartReport| part.worst_distance().map_or(0.0, |(d, _)| d);
        if self
            .worst_distance
            .as_ref()
            .is_none_or(|worst| distance(part) > distance(worst))
        {
            self.worst_distance = Some(part.clone());
        }
    }
}

#[cfg(test)]
mod tests;
