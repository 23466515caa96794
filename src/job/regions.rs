//! Regions of a mesh of a label image: the label of each cell, the faces where labels change, and a
//! report on each label's connected parts.

use std::collections::{BTreeMap, BTreeSet};

use crate::parallel::prelude::*;

use super::{AnnotatedMesh, MeshScene, named_faces};
use crate::feature::components::{Components, for_each_sample};
use crate::feature::detectors::labels::absorb_parts_below;
use crate::feature::volume::Volume;
use crate::feature::{FeatureKind, Features, LabelMap, LabelOptions, label_map};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{norm, normal, sorted};
use crate::image::{Image, LabelTable, LabelValue};
use crate::improve::regions::{
    self, InterfaceFit, LabelParts, PartTopology, PinchedMesh, SamplePoints,
};
use crate::improve::{FeatureFit, fit_feature_faces};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::poly::{FaceNeighbour, PolyMesh};
use crate::mesh_file::{CellChoice, KnownRegion};
use crate::progress::CancelToken;
use crate::report::certificate::{CertifiedImage, LabelledCells, certify, dropped_parts};
use crate::report::{
    Certificate, Hole, LostParts, MIN_MISSING_SHARE, RegionReport, RegionSummary, VolumeReference,
    finer_distance,
};

/// Fraction of a part's volume below which the part is lost, if the cells with its label hold less.
const MIN_KEPT_SHARE: f64 = 0.25;

/// Largest distance of a face from the edge on which it lies, in the largest step between samples.
const MAX_FACE_DISTANCE: f64 = 3.0;

/// Number of cells whose sample points one task visits.
const CELLS_PER_TASK: usize = 1 << 12;

/// The neighbours, the names of faces and the given labels of the cells of a mesh.
#[derive(Debug)]
pub(super) struct CellFaces<'a> {
    /// For every cell and face, in order, the cell on the other side, or `NONE`.
    pub neighbours: &'a mut Vec<u32>,
    /// Names of faces, as in [`Outcome::face_names`](super::Outcome::face_names).
    pub names: &'a mut Vec<u32>,
    /// Cells whose label is given, with its index.
    pub pinned: &'a [(usize, u32)],
    /// `true` if cells at pinched nodes may be split, and parts are kept off the sides of the box.
    pub opens_pinches: bool,
}

/// Assigns regions to the cells of simplices, and fits the faces between regions. Returns the label
/// index of each cell; `None` if the features are not labels. The faces on features become those between labels, and those on given surfaces,
/// which have names; these surfaces stay where they are.
pub(super) fn assign_regions<const D: usize, M: Simplices<D>>(
    annotated: &mut AnnotatedMesh<M>,
    faces: CellFaces<'_>,
    scene: &MeshScene<'_, D>,
    min_angle: Option<f64>,
    cancel: &CancelToken<'_>,
) -> Option<Vec<u32>> {
    let CellFaces {
        neighbours: face_neighbours,
        names: face_names,
        pinned,
        opens_pinches,
    } = faces;
    let neighbours = &*face_neighbours;
    let Some(labelled) = scene.features.labels.as_ref() else {
        if let Some(min_angle) = min_angle.filter(|_| has_fitted_faces(scene.features)) {
            fit_to_edges(annotated, neighbours, scene, min_angle, cancel);
        }
        return None;
    };
    let pin = |regions: &mut [u32]| pinned.iter().for_each(|&(c, label)| regions[c] = label);
    let parts = LabelParts::new(labelled);
    let (mut regions, votes) = regions::assign_labels(&annotated.mesh, neighbours, labelled);
    pin(&mut regions);
    let mut cell_parts = parts.assign(&annotated.mesh, neighbours, &regions, labelled);
    let repair = |mesh: &M, cell_parts: &mut [u32], regions: &mut [u32]| {
        let mut topology = PartTopology::new(mesh, neighbours, &parts);
        if !opens_pinches {
            topology = topology.without_sides();
        }
        topology.repair(cell_parts, &votes);
        for (region, &part) in regions.iter_mut().zip(&*cell_parts) {
            if part != NONE {
                *region = parts.label(part);
            }
        }
    };
    repair(&annotated.mesh, &mut cell_parts, &mut regions);
    pin(&mut regions);
    if let Some(min_angle) = min_angle {
        let anchors = named_faces::anchored_nodes(&annotated.mesh, face_names, scene);
        let fitting = InterfaceFit {
            labelled,
            regions: &regions,
            parts: &parts,
            cell_parts: &cell_parts,
            neighbours,
            anchors: anchors.as_ref(),
            kinds: &annotated.node_kinds,
            extent: scene.extent,
            min_angle,
        };
        regions::fit(&mut annotated.mesh, &fitting, cancel);
        regions = regions::remove_spikes(&annotated.mesh, &fitting);
        pin(&mut regions);
        cell_parts = parts.assign(&annotated.mesh, neighbours, &regions, labelled);
        repair(&annotated.mesh, &mut cell_parts, &mut regions);
        pin(&mut regions);
        // Cells with given labels are at sides whose faces match.
        if opens_pinches && pinned.is_empty() {
            let mut pinched = PinchedMesh {
                mesh: &mut annotated.mesh,
                kinds: &mut annotated.node_kinds,
                neighbours: face_neighbours,
                face_names,
                regions: &mut regions,
                cell_parts: &mut cell_parts,
                parts: &parts,
                extent: scene.extent,
            };
            pinched.open(cancel);
        }
        let interfaces = regions::interface_marks::<D>(&regions, face_neighbours);
        annotated.feature_faces = named_faces::with_named(&interfaces, face_names);
    }
    let label_regions = labelled.regions();
    annotated.regions = regions.iter().map(|&n| label_regions[n as usize]).collect();
    Some(regions)
}

/// Returns `true` if the faces on features are fitted to them: the features are sides of objects, whose volumes
/// matter.
pub(super) fn has_fitted_faces<const D: usize>(features: &Features<D>) -> bool {
    let mut kinds = features.resolved.iter().map(|resolved| resolved.kind);
    !features.resolved.is_empty()
        && features.names.is_empty()
        && kinds.all(|kind| kind == FeatureKind::Edges)
}

/// Fits the faces on features to these.
fn fit_to_edges<const D: usize, M: Simplices<D>>(
    annotated: &mut AnnotatedMesh<M>,
    neighbours: &[u32],
    scene: &MeshScene<'_, D>,
    min_angle: f64,
    cancel: &CancelToken<'_>,
) {
    let step = scene.features.potential.step;
    let fit = FeatureFit {
        points: &scene.features.points,
        marks: &annotated.feature_faces,
        neighbours,
        kinds: &annotated.node_kinds,
        extent: scene.extent,
        reach: MAX_FACE_DISTANCE * step.iter().copied().fold(0.0, f64::max),
        min_angle,
    };
    fit_feature_faces(&mut annotated.mesh, &fit, cancel);
}

/// Returns the number of parts into which marked faces divide a mesh of simplices: cells are in one
/// part if a path through other faces connects them.
pub(super) fn part_count(faces_per_cell: usize, neighbours: &[u32], marks: &[u8]) -> usize {
    let mut parts = UnionFind::new(marks.len());
    for (c, &bits) in marks.iter().enumerate() {
        let adjacent = &neighbours[faces_per_cell * c..faces_per_cell * (c + 1)];
        for (k, &n) in adjacent.iter().enumerate().filter(|(_, n)| **n != NONE) {
            if bits >> k & 1 == 0 {
                parts.unite(c as u32, n);
            }
        }
    }
    parts.into_labels().1
}

/// The area over which cells of two labels touch, by the indices of the labels, the smaller first.
pub(super) type Contacts = BTreeMap<[u32; 2], f64>;

/// Returns the contacts of labels in a mesh of simplices.
pub(super) fn contacts_of_simplices<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbours: &[u32],
    label_indices: &[u32],
) -> Contacts {
    let mut contacts = Contacts::new();
    for (c, &label) in label_indices.iter().enumerate() {
        for k in 0..=D {
            let neighbour = neighbours[(D + 1) * c + k];
            if neighbour != NONE && label < label_indices[neighbour as usize] {
                let corners = mesh.face(c, k).map(|n| mesh.nodes()[n as usize]);
                *contacts
                    .entry([label, label_indices[neighbour as usize]])
                    .or_default() += norm(normal(&corners));
            }
        }
    }
    contacts
}

/// Returns the contacts of labels in a mesh of polyhedra or polygons.
pub(super) fn contacts_of_cells<const D: usize>(
    mesh: &PolyMesh<D>,
    label_indices: &[u32],
) -> Contacts {
    let mut contacts = Contacts::new();
    for (f, cells) in mesh.face_cells.iter().enumerate() {
        if let FaceNeighbour::Cell(_) = mesh.face_neighbour(f) {
            let mut pair = cells.map(|c| label_indices[c as usize]);
            pair.sort_unstable();
            if pair[0] != pair[1] {
                *contacts.entry(pair).or_default() += norm(mesh.face_shape(f).area_vector);
            }
        }
    }
    contacts
}

/// The labels of samples by which regions are judged.
pub(super) struct JudgedLabels<const D: usize> {
    /// The labels, and for each sample the index of its label.
    pub table: LabelTable,
    /// The connected parts of the labels.
    pub components: Components<D>,
    /// Names of and distances in labels.
    pub options: Vec<LabelOptions>,
    /// Volumes between samples in lattice units, if thresholds make the labels.
    volumes: Option<Vec<f64>>,
}

impl<const D: usize> JudgedLabels<D> {
    /// Returns the labels of the samples of an image. Connected parts of fewer than `min_part` samples have
    /// joined the labels around them. For thresholds, these are the regions between them in `labelled`. Returns
    /// `None` if there are too many labels.
    pub fn new(
        image: &Image<D>,
        labelled: &LabelMap<D>,
        options: &[LabelOptions],
        min_part: usize,
    ) -> Option<Self> {
        if labelled.values.is_none() {
            let (mut table, mut components) = label_map::components(image)?;
            if min_part > 1 {
                absorb_parts_below(image.dims(), &mut table.indices, min_part);
                components = Components::from_labels(image.dims(), &table.indices);
            }
            return Some(Self {
                components,
                table,
                options: options.to_vec(),
                volumes: None,
            });
        }
        let named = |(label, name): (&LabelValue, &Option<String>)| LabelOptions {
            label: *label,
            unit: None,
            name: name.clone(),
            distance: (options.iter().find(|options| options.label == *label))
                .and_then(|options| options.distance),
            merge_into: None,
        };
        Some(Self {
            table: LabelTable {
                values: labelled.labels.clone(),
                indices: labelled.winner.clone(),
            },
            components: Components::from_labels(image.dims(), &labelled.winner),
            options: labelled
                .labels
                .iter()
                .zip(&labelled.names)
                .map(named)
                .collect(),
            volumes: Some(labelled.volumes.clone()),
        })
    }
}

/// Returns the report on the labels of an image, from the sample points, the contacts and the label
/// indices of cells. Returns `None` if `cancel` is cancelled.
pub(super) fn report<const D: usize>(
    image: &Image<D>,
    judged: JudgedLabels<D>,
    sample_points: &SamplePoints<'_, D>,
    contacts: &Contacts,
    label_indices: &[u32],
    step: [f64; D],
    cancel: &CancelToken<'_>,
) -> Option<RegionSummary> {
    if cancel.is_cancelled() {
        return None;
    }
    let volume_reference = match judged.volumes {
        Some(_) => VolumeReference::InterpolatedValues,
        None => VolumeReference::Samples,
    };
    let labelled = LabelledImage {
        image,
        labels: judged.table.values,
        indices: judged.table.indices,
        parts: judged.components,
        options: &judged.options,
        step,
        volumes: judged.volumes,
    };
    let kept_volume = labelled.kept_volumes(sample_points, label_indices);
    let mut regions = labelled.region_reports(&sample_points.volumes, label_indices);
    let [lost, damaged] = labelled.losses(&kept_volume, &mut regions);
    Some(RegionSummary {
        holes: labelled.holes(contacts),
        regions,
        volume_reference,
        lost: lost.0,
        damaged: damaged.0,
    })
}

/// Judges cells by the samples of an image of labels. Returns `None` if `cancel` is cancelled.
pub(super) fn certificate<const D: usize>(
    image: &Image<D>,
    judged: &JudgedLabels<D>,
    choice: &CellChoice<'_>,
    cells: &LabelledCells<'_, D>,
    cancel: &CancelToken<'_>,
) -> Option<Certificate> {
    let name_of = |label: &LabelValue| {
        let mut options = judged.options.iter();
        let options = options.find(|options| options.label == *label)?;
        options.name.clone()
    };
    let names: Vec<Option<String>> = judged.table.values.iter().map(name_of).collect();
    let known = KnownRegion::of_labels(&judged.table.values, &names);
    // Names of no label were refused before.
    let kept = choice.kept_regions(&known, "the image");
    let kept = kept.unwrap_or_else(|_| vec![true; known.len()]);
    let dropped = dropped_parts(&judged.components, &kept, choice.keep_largest);
    let certified = CertifiedImage {
        dropped: &dropped,
        components: &judged.components,
        indices: &judged.table.indices,
        labels: &judged.table.values,
        names: &names,
        geometry: &image.geometry,
    };
    certify(&certified, cells, cancel)
}

/// An image of labels and its connected parts.
struct LabelledImage<'a, const D: usize> {
    image: &'a Image<D>,
    /// The labels, and for each sample the index of its label.
    labels: Vec<LabelValue>,
    indices: Vec<u32>,
    parts: Components<D>,
    options: &'a [LabelOptions],
    step: [f64; D],
    /// Volumes of labels in lattice units, if they are not those of samples.
    volumes: Option<Vec<f64>>,
}

impl<const D: usize> LabelledImage<'_, D> {
    /// Returns the volume of a sample in lattice space.
    fn sample_volume(&self) -> f64 {
        self.step.iter().product()
    }

    /// Returns the options of a label, if there are any.
    fn options_of(&self, n: usize) -> Option<&LabelOptions> {
        let label = self.labels[n];
        self.options.iter().find(|options| options.label == label)
    }

    fn name(&self, n: usize) -> Option<String> {
        self.options_of(n).and_then(|options| options.name.clone())
    }

    /// Returns for each connected part the volume of it that lies in cells of its own label.
    fn kept_volumes(&self, sample_points: &SamplePoints<'_, D>, label_indices: &[u32]) -> Vec<f64> {
        let (step, dims, parts) = (self.step, self.image.dims(), &self.parts);
        let volume = Volume::new(dims, &[]);
        let part_volumes = |cells: &[u32], first: usize| {
            let (mut part_volumes, mut part_counts) = (Vec::new(), Vec::new());
            for (c, &label) in (first..).zip(cells) {
                part_counts.clear();
                let mut count = 0.0f64;
                sample_points.for_each(c, |x| {
                    let at =
                        std::array::from_fn(|k| ((x[k] / step[k] + 0.5) as usize).min(dims[k] - 1));
                    let i = volume.index(at);
                    count += 1.0;
                    if self.indices[i] == label {
                        let part = parts.component_of_sample[i];
                        match part_counts.iter_mut().find(|(known, _)| *known == part) {
                            Some((_, sum)) => *sum += 1.0,
                            None => part_counts.push((part, 1.0)),
                        }
                    }
                });
                let volume_of = |&(part, sum)| (part, sum * sample_points.volumes[c] / count);
                part_volumes.extend(part_counts.iter().map(volume_of));
            }
            part_volumes
        };
        let cell_parts: Vec<Vec<(u32, f64)>> = label_indices
            .par_chunks(CELLS_PER_TASK)
            .enumerate()
            .map(|(task, cells)| part_volumes(cells, task * CELLS_PER_TASK))
            .collect();
        let mut kept_volume = vec![0.0; parts.components.len()];
        for &(part, volume) in cell_parts.iter().flatten() {
            kept_volume[part as usize] += volume;
        }
        kept_volume
    }

    /// Returns the report on each label. Its parts are not counted yet.
    fn region_reports(&self, cell_volumes: &[f64], label_indices: &[u32]) -> Vec<RegionReport> {
        let (labels, dims) = (&self.labels, self.image.dims());
        let world = self.image.geometry.determinant().abs() / self.sample_volume();
        let samples = match &self.volumes {
            Some(volumes) => volumes.clone(),
            None => label_map::volumes(dims, self.step, &self.indices, labels.len()),
        };
        let regions = label_map::regions(labels);
        let mut reports: Vec<RegionReport> = (0..labels.len())
            .map(|n| RegionReport {
                label: labels[n],
                region: regions[n],
                name: self.name(n),
                parts: 0,
                samples: 0,
                cells: 0,
                volume: 0.0,
                sample_volume: samples[n] * world,
                volume_error_percent: 0.0,
                distance: None,
            })
            .collect();
        for (&n, size) in label_indices.iter().zip(cell_volumes) {
            reports[n as usize].cells += 1;
            reports[n as usize].volume += size * world;
        }
        for region in &mut reports {
            region.volume_error_percent = if region.sample_volume > 0.0 {
                100.0 * (region.volume / region.sample_volume - 1.0)
            } else {
                0.0
            };
        }
        reports
    }

    /// Returns the parts that are lost and those that are damaged, and counts the parts of each
    /// region.
    fn losses(&self, kept_volume: &[f64], reports: &mut [RegionReport]) -> [LossList; 2] {
        let (image, parts, sample) = (self.image, &self.parts, self.sample_volume());
        let dims = image.dims();
        let volume = Volume::new(dims, &[]);
        let surface = surface_areas(parts, self.step);
        let (mut lost, mut damaged) = (LossList::default(), LossList::default());
        for (number, (part, kept_volume)) in parts.components.iter().zip(kept_volume).enumerate() {
            let n = part.label as usize;
            reports[n].parts += 1;
            reports[n].samples += part.sample_count;
            let size = part.sample_count as f64 * sample;
            let keeping_distance = finer_distance(
                sufficient_distance::<D>(size, surface[number]),
                self.options_of(n).and_then(|options| options.distance),
            );
            if part.sample_count >= MIN_DAMAGED_SAMPLES {
                let distance = &mut reports[n].distance;
                *distance = match (*distance, keeping_distance) {
                    (Some(a), Some(b)) => Some(a.min(b)),
                    (a, b) => a.or(b),
                };
            }
            let losses = match () {
                () if *kept_volume < MIN_KEPT_SHARE * size => &mut lost,
                () if part.sample_count >= MIN_DAMAGED_SAMPLES
                    && !part.touches_side(dims)
                    && *kept_volume < (1.0 - MIN_MISSING_SHARE) * size =>
                {
                    &mut damaged
                }
                () => continue,
            };
            let at = volume.coordinates(part.first_sample);
            losses.add(LostParts {
                label: self.labels[n],
                name: self.name(n),
                parts: 1,
                is_whole_label: false,
                samples: part.sample_count,
                largest_samples: part.sample_count,
                first_sample: image.geometry.to_physical(at.map(|i| i as f64)).to_vec(),
                distance: keeping_distance,
            });
        }
        for lost in &mut lost.0 {
            let place = reports.partition_point(|region| region.label < lost.label);
            lost.is_whole_label = reports
                .get(place)
                .is_some_and(|region| region.parts == lost.parts);
        }
        [lost, damaged]
    }

    /// Returns the pairs of labels that touch in the mesh but not in the image, the largest contact
    /// first.
    fn holes(&self, contacts: &Contacts) -> Vec<Hole> {
        let sample_side = self.sample_volume().powf((D - 1) as f64 / D as f64);
        let label_of = |part: u32| self.parts.components[part as usize].label;
        let touching: BTreeSet<[u32; 2]> = (self.parts.contacts().into_iter())
            .map(|pair| sorted(pair.map(label_of)))
            .collect();
        let mut holes: Vec<Hole> = (contacts.iter())
            .filter(|(pair, _)| !touching.contains(*pair))
            .map(|(pair, area)| Hole {
                labels: pair.map(|n| self.labels[n as usize]),
                area: area / sample_side,
            })
            .collect();
        holes.sort_by(|a, b| b.area.total_cmp(&a.area));
        holes
    }
}

/// Number of samples from which a part counts as damaged if much of it is missing.
const MIN_DAMAGED_SAMPLES: usize = 50;

/// Lost or damaged parts of labels, merged by label.
#[derive(Default)]
struct LossList(Vec<LostParts>);

impl LossList {
    fn add(&mut self, new: LostParts) {
        match self.0.iter_mut().find(|known| known.label == new.label) {
            Some(known) => {
                known.parts += 1;
                known.samples += new.samples;
                if new.largest_samples > known.largest_samples {
                    (known.largest_samples, known.first_sample, known.distance) =
                        (new.largest_samples, new.first_sample, new.distance);
                }
            }
            None => self.0.push(new),
        }
    }
}

/// Returns the area of the sides that each part shares with others, in lattice units.
fn surface_areas<const D: usize>(parts: &Components<D>, step: [f64; D]) -> Vec<f64> {
    let mut areas = vec![0.0; parts.components.len()];
    let strides = Volume::new(parts.dims, &[]).strides();
    let sample: f64 = step.iter().product();
    for_each_sample(parts.dims, |i, at| {
        for k in 0..D {
            if at[k] == 0 {
                continue;
            }
            let [a, b] = [i - strides[k], i].map(|i| parts.component_of_sample[i]);
            if a != b {
                areas[a as usize] += sample / step[k];
                areas[b as usize] += sample / step[k];
            }
        }
    });
    areas
}

/// Returns a distance between atoms, in two digits, at which a part of this volume and surface is
/// kept: about half the width of a compact part, and 0.6 of the thickness of a thin one.
fn sufficient_distance<const D: usize>(volume: f64, surface: f64) -> f64 {
    let volume_distance = 0.55 * volume.powf(1.0 / D as f64);
    // 2 V / S is the thickness of a plate. The sides of samples have about 1.5 times (in the plane
    // 1.27 times) the area of a ball.
    let thickness = 2.0 * volume / surface.max(1e-12);
    let ball_thickness = match D {
        2 => 0.79 * (volume / std::f64::consts::PI).sqrt(),
        _ => 0.44 * (volume * 0.75 / std::f64::consts::PI).cbrt(),
    };
    let compact = (thickness / ball_thickness).min(1.0).powi(4);
    // Walls of one sample become half as thick again before faces are fitted.
    let wall_ratio = if thickness < 1.5 { 0.8 } else { 0.6 };
    let ratio = wall_ratio + compact * (volume_distance / ball_thickness - wall_ratio);
    let d = volume_distance.min(ratio * thickness);
    let tenths = 10f64.powf(1.0 - d.log10().floor());
    (d * tenths).floor() / tenths
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::image_of;
    use crate::image::LabelValue;
    use crate::job::spec::{MeshSpec, NominalDistance};
    use crate::job::{CellKind, Outcome, Params, run};
    use crate::mesh::boxes::kuhn_box;
    use crate::progress::NoProgress;

    /// Returns an image of balls of different sizes in two layers that a dyke cuts. It differs
    /// somewhat for each seed.
    fn test_image(seed: f64) -> Image<3> {
        let balls = [(9.0, 3.0), (4.0, 5.0), (2.0, 7.0)];
        let centre = |k: usize| {
            [
                [16.0 + seed, 18.0, 20.0],
                [37.0, 13.0 + seed, 12.0],
                [38.0, 33.0, 30.0],
            ][k]
        };
        image_of([52, 46, 42], |p| {
            for (k, (radius, label)) in balls.into_iter().enumerate() {
                let distance2 = (0..3).map(|i| (p[i] - centre(k)[i]).powi(2)).sum::<f64>();
                if distance2 < radius * radius {
                    return label;
                }
            }
            let dyke = (p[0] - 27.0) + 0.3 * (p[1] - 20.0) + 0.2 * seed * (p[2] - 20.0);
            if dyke.abs() < 2.6 {
                9.0
            } else {
                1.0 + f64::from(u8::from(
                    p[2] > 24.0 + 0.15 * p[0] + 2.0 * (p[1] / 9.0 + seed).sin(),
                ))
            }
        })
    }

    #[test]
    fn labels_that_touch_only_in_the_mesh_are_reported_with_the_area() {
        // A wall of one sample between two labels, with a gap at high y where these touch.
        let walls = |gap: f64| {
            image_of([5, 5, 5], |p| match p[0] {
                x if x < 2.0 => 1.0,
                x if x > 2.0 || p[1] > gap => 3.0,
                _ => 2.0,
            })
        };
        let mesh = kuhn_box([4, 4, 4], 1.0);
        let neighbours = mesh.neighbours().unwrap();
        // A mesh without the wall.
        let number = |c: usize| {
            let x: f64 = mesh
                .cell(c)
                .iter()
                .map(|&n| mesh.nodes[n as usize][0] / 4.0)
                .sum();
            if x < 2.0 { 0 } else { 2 }
        };
        let numbers: Vec<u32> = (0..mesh.tets.len()).map(number).collect();
        let contacts = contacts_of_simplices(&mesh, &neighbours, &numbers);
        assert_eq!(contacts.keys().collect::<Vec<_>>(), [&[0, 2]]);
        assert!((contacts[&[0, 2]] - 16.0).abs() < 1e-12, "{contacts:?}");
        let holes_of = |image: &Image<3>| {
            let sample_points = SamplePoints::from_simplices(&mesh);
            let (table, components) = label_map::components(image).unwrap();
            let judged = JudgedLabels {
                table,
                components,
                options: Vec::new(),
                volumes: None,
            };
            let summary = report(
                image,
                judged,
                &sample_points,
                &contacts,
                &numbers,
                [1.0; 3],
                &CancelToken::never(),
            );
            summary.unwrap().holes
        };
        let holes = holes_of(&walls(9.0));
        assert_eq!(holes.len(), 1);
        assert_eq!(
            holes[0].labels,
            [LabelValue::Whole(1), LabelValue::Whole(3)]
        );
        assert!((holes[0].area - 16.0).abs() < 1e-9, "{holes:?}");
        assert_eq!(holes_of(&walls(3.5)), []);
    }

    fn mesh_image(image: &Image<3>, params: &Params<3>) -> Outcome<3> {
        run(image, params, &mut NoProgress).unwrap()
    }

    #[test]
    fn regions_have_the_volumes_of_their_samples_and_faces_where_labels_change() {
        for seed in [0.0, 1.0, 2.0] {
            let outcome = mesh_image(&test_image(seed), &Params::default());
            let regions = outcome.report.regions.as_ref().unwrap();
            // There are single samples where the stairs of two interfaces meet.
            assert!(
                regions.lost.iter().all(|lost| lost.largest_samples < 3),
                "{regions:?}"
            );
            let labels: Vec<i32> = regions.regions.iter().map(|r| r.region).collect();
            assert_eq!(labels, [1, 2, 3, 5, 7, 9]);
            for region in &regions.regions {
                // A ball of 33 samples consists of only five small cells.
                let max_error = if region.label == 7.0 { 25.0 } else { 0.5 };
                assert!(
                    region.volume_error_percent.abs() < max_error,
                    "{seed}: {region:?}"
                );
            }
            let annotated = outcome.simplices().unwrap();
            let neighbours = annotated.mesh.neighbours().unwrap();
            for (face, &n) in neighbours.iter().enumerate() {
                let (c, k) = (face / 4, face % 4);
                let is_interface =
                    n != NONE && annotated.regions[c] != annotated.regions[n as usize];
                assert_eq!(annotated.feature_faces[c] >> k & 1 == 1, is_interface);
            }
            let angles = outcome.report.quality.as_ref().unwrap();
            assert!(
                angles.smallest_angle.worst > 20.0,
                "{}",
                angles.smallest_angle.worst
            );
            // The report counts compartments and cells below the target in the final mesh.
            let improvement = outcome.report.improvement.as_ref().unwrap();
            assert!(improvement.sealed.compartments >= labels.len());
            let outside = [angles.below_30, angles.above_150];
            let count = improvement.below_target_after;
            // Both counts round angles in their own way.
            let fewest = 9 * outside[0].max(outside[1]) / 10;
            assert!(
                (fewest..=outside[0] + outside[1]).contains(&count),
                "{count} {outside:?}"
            );
            let fidelity = outcome.report.fidelity.as_ref().unwrap();
            let faces = fidelity.tagged_faces.as_ref().unwrap();
            assert!(
                faces.coverage_half > 0.98 && faces.precision > 0.98,
                "{faces:?}"
            );
        }
    }

    #[test]
    fn lost_parts_are_reported_with_an_option_that_keeps_them() {
        let params = Params::new(MeshSpec {
            distance: NominalDistance::Constant(7.0),
            ..MeshSpec::default()
        })
        .unwrap();
        let image = test_image(1.0);
        let outcome = mesh_image(&image, &params);
        let lost = &outcome.report.regions.as_ref().unwrap().lost;
        let large: Vec<&LostParts> = lost
            .iter()
            .filter(|lost| lost.largest_samples > 2)
            .collect();
        let [ball] = large[..] else {
            panic!("{lost:?}");
        };
        assert!(ball.label == 7.0);
        assert_eq!((ball.parts, ball.is_whole_label), (1, true));
        assert!(
            ball.largest_samples > 25 && ball.largest_samples < 40,
            "{ball:?}"
        );
        assert!(ball.message().contains("label 7"));
        let option = ball.remedy().unwrap();
        let option = LabelOptions::parse(option.strip_prefix("--label ").unwrap()).unwrap();
        let params_with_label = Params::new(MeshSpec {
            label: vec![option],
            feature: FeatureKind::Labels,
            ..params.spec
        })
        .unwrap();
        let outcome = mesh_image(&image, &params_with_label);
        let regions = outcome.report.regions.as_ref().unwrap();
        assert!(
            regions.lost.iter().all(|lost| lost.largest_samples < 3),
            "{:?}",
            regions.lost
        );
        let small = regions.regions.iter().find(|r| r.label == 7.0).unwrap();
        // The ball has 27 samples.
        assert!(small.volume_error_percent.abs() < 10.0, "{small:?}");
    }

    #[test]
    fn a_label_has_its_own_distance_and_name_or_becomes_part_of_another() {
        let label_options = ["3:distance=2.5,name=core", "5:into=1", "9:distance=12"];
        let label_options = label_options.map(|text| LabelOptions::parse(text).unwrap());
        let params = Params::new(MeshSpec {
            distance: NominalDistance::Constant(7.0),
            feature: FeatureKind::Labels,
            label: label_options.to_vec(),
            ..MeshSpec::default()
        })
        .unwrap();
        let outcome = mesh_image(&test_image(0.0), &params);
        let regions = &outcome.report.regions.as_ref().unwrap().regions;
        assert!(regions.iter().all(|region| region.label != 5.0));
        let core = regions.iter().find(|region| region.label == 3.0).unwrap();
        assert_eq!(core.name.as_deref(), Some("core"));
        // The cell of an atom in the densest lattice has a volume of d^3 / (6 sqrt 2).
        let expected = core.volume / (2.5f64.powi(3) / 8.485);
        let cells = core.cells as f64;
        assert!(
            cells > 0.5 * expected && cells < 2.0 * expected,
            "{cells} {expected}"
        );
        assert!(outcome.distance.value_at([16.0, 18.0, 20.0]) < 2.6);
        assert!(outcome.distance.value_at([46.0, 40.0, 8.0]) < 7.1);
    }

    #[test]
    fn voronoi_cells_and_triangles_have_regions_too() {
        let params = Params::new(MeshSpec {
            cells: Some(CellKind::Voronoi),
            distance: NominalDistance::Constant(5.0),
            ..MeshSpec::default()
        })
        .unwrap();
        let outcome = mesh_image(&test_image(0.0), &params);
        let cells = outcome.voronoi().unwrap();
        assert!(cells.region.contains(&3) && cells.region.contains(&9));
        for region in &outcome.report.regions.as_ref().unwrap().regions {
            let large = [1.0, 2.0, 3.0].contains(&region.label.as_f64());
            assert!(
                !large || region.volume_error_percent.abs() < 3.0,
                "{region:?}"
            );
        }
        let disc = |x: f64, y: f64| f64::from(u8::from((x - 22.0).hypot(y - 19.0) < 11.0));
        let samples = (0..48 * 40).map(|i| disc((i % 48) as f64, (i / 48) as f64) as f32);
        let image = Image::new([48, 40], samples.collect(), Default::default());
        let outcome = run(&image, &Params::<2>::default(), &mut NoProgress).unwrap();
        let regions = &outcome.report.regions.as_ref().unwrap().regions;
        assert!(
            regions
                .iter()
                .all(|region| region.volume_error_percent.abs() < 0.5),
            "{regions:?}"
        );
    }

    #[test]
    fn labels_that_are_not_integers_are_numbered() {
        let regions_of = |labels: &[&str]| -> Vec<i32> {
            let labels = labels.iter().map(|text| LabelValue::parse(text).unwrap());
            let labels: Vec<LabelValue> = labels.collect();
            label_map::regions(&labels)
        };
        assert_eq!(regions_of(&["-1", "0", "300"]), [-1, 0, 300]);
        assert_eq!(regions_of(&["0.25", "1"]), [0, 1]);
        assert_eq!(
            regions_of(&["16777216", "2147483647"]),
            [16_777_216, i32::MAX]
        );
        assert_eq!(regions_of(&["5", "2147483648"]), [0, 1]);
    }
}
