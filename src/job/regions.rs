//! The regions of a mesh of labels: which cells have which label, faces where labels change, and what
//! became of each connected part.

use std::collections::{BTreeMap, BTreeSet};

use crate::parallel::prelude::*;

use super::{AnnotatedMesh, MeshScene};
use crate::feature::components::{Components, for_each_sample};
use crate::feature::label_map::{LabelMap, components};
use crate::feature::volume::Volume;
use crate::feature::{LabelOptions, label_map};
use crate::geometry::{norm, normal};
use crate::image::{Image, LabelTable};
use crate::improve::regions::{self, InterfaceFit, SamplePoints};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::poly::{FaceNeighbour, PolyMesh};
use crate::progress::CancelToken;
use crate::report::{Hole, LostParts, MIN_MISSING_SHARE, RegionReport, RegionSummary};

/// A part of a label of which the cells with its label hold less than this share is lost.
const MIN_KEPT_SHARE: f64 = 0.25;

/// Gives the cells of simplices their regions, and fits the faces between them; gives the number of each
/// cell's label.
pub(super) fn assign_regions<const D: usize, M: Simplices<D>>(
    made: &mut AnnotatedMesh<M>,
    neighbors: &[u32],
    scene: &MeshScene<'_, D>,
    labelled: &LabelMap<D>,
    min_angle: Option<f64>,
    patience: &CancelToken<'_>,
) -> Vec<u32> {
    let mut regions = regions::assign_labels(&made.mesh, neighbors, labelled);
    if let Some(min_angle) = min_angle {
        let fitting = InterfaceFit {
            labelled,
            regions: &regions,
            neighbors,
            kinds: &made.node_kinds,
            extent: scene.extent,
            min_angle,
        };
        regions::fit(&mut made.mesh, &fitting, patience);
        regions = regions::remove_spikes(&made.mesh, &fitting);
        made.feature_faces = regions::interface_marks::<D>(&regions, neighbors);
    }
    let of_label = labelled.regions();
    made.regions = regions.iter().map(|&n| of_label[n as usize]).collect();
    regions
}

/// The area over which cells of two labels touch, by their numbers, the smaller first.
pub(super) type Contacts = BTreeMap<[u32; 2], f64>;

/// Returns the contacts of labels in a mesh of simplices.
pub(super) fn contacts_of_simplices<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    numbers: &[u32],
) -> Contacts {
    let mut contacts = Contacts::new();
    for (c, &here) in numbers.iter().enumerate() {
        for k in 0..=D {
            let beyond = neighbors[(D + 1) * c + k];
            if beyond != NONE && here < numbers[beyond as usize] {
                let corners = mesh.face(c, k).map(|n| mesh.nodes()[n as usize]);
                *contacts
                    .entry([here, numbers[beyond as usize]])
                    .or_default() += norm(normal(&corners));
            }
        }
    }
    contacts
}

/// Returns the contacts of labels in a mesh of polyhedra or polygons.
pub(super) fn contacts_of_cells<const D: usize>(mesh: &PolyMesh<D>, numbers: &[u32]) -> Contacts {
    let mut contacts = Contacts::new();
    for (f, cells) in mesh.face_cells.iter().enumerate() {
        if let FaceNeighbour::Cell(_) = mesh.face_neighbour(f) {
            let mut pair = cells.map(|c| numbers[c as usize]);
            pair.sort_unstable();
            if pair[0] != pair[1] {
                *contacts.entry(pair).or_default() += norm(mesh.face_shape(f).area_vector);
            }
        }
    }
    contacts
}

/// Returns the pairs of labels that touch somewhere in an image, at a side, an edge or a corner of samples.
fn touching_labels<const D: usize>(dims: [usize; D], labels: &[u32]) -> BTreeSet<[u32; 2]> {
    let mut pairs = BTreeSet::new();
    let strides = Volume::new(dims, &[]).strides();
    // Half of the samples round one: the others see this one.
    let count = 3usize.pow(D as u32);
    for_each_sample(dims, |i, at| {
        for number in count / 2 + 1..count {
            let step = |k: usize| number / 3usize.pow(k as u32) % 3;
            let inside = (0..D).all(|k| at[k] + step(k) > 0 && at[k] + step(k) <= dims[k]);
            if !inside {
                continue;
            }
            let there = (0..D).fold(i, |there, k| there + step(k) * strides[k] - strides[k]);
            let [a, b] = [labels[i], labels[there]];
            if a != b {
                pairs.insert([a.min(b), a.max(b)]);
            }
        }
    });
    pairs
}

/// Returns what became of the labels of an image, from the places and contacts of cells whose labels have these
/// `numbers`; `None` if there are too many labels, or if `patience` does not last.
pub(super) fn report<const D: usize>(
    image: &Image<D>,
    wishes: &[LabelOptions],
    (places, contacts): (&SamplePoints<'_, D>, &Contacts),
    numbers: &[u32],
    step: [f64; D],
    patience: &CancelToken<'_>,
) -> Option<RegionSummary> {
    let (table, parts) = components(image)?;
    let LabelTable {
        values: labels,
        indices: of_sample,
    } = table;
    if patience.is_cancelled() {
        return None;
    }
    let dims = image.dims();
    let volume = Volume::new(dims, &[]);
    let world = image.geometry.determinant().abs() / step.iter().product::<f64>();
    // Of each cell, how many of its places lie in which part of its own label.
    let held: Vec<Vec<(u32, f64)>> = (0..numbers.len())
        .into_par_iter()
        .map(|c| {
            let (mut found, mut count) = (Vec::new(), 0.0f64);
            places.for_each(c, |x| {
                let at = std::array::from_fn(|k| {
                    ((x[k] / step[k]).round().max(0.0) as usize).min(dims[k] - 1)
                });
                let i = volume.index(at);
                count += 1.0;
                if of_sample[i] == numbers[c] {
                    let part = parts.component_of_sample[i];
                    match found.iter_mut().find(|(known, _)| *known == part) {
                        Some((_, sum)) => *sum += 1.0,
                        None => found.push((part, 1.0)),
                    }
                }
            });
            found
                .iter_mut()
                .for_each(|(_, sum)| *sum *= places.volumes[c] / count);
            found
        })
        .collect();
    let mut inside = vec![0.0; parts.components.len()];
    for &(part, volume) in held.iter().flatten() {
        inside[part as usize] += volume;
    }
    let sample: f64 = step.iter().product();
    let samples = label_map::volumes(dims, step, &of_sample, labels.len());
    let name = |n: usize| {
        let wish = wishes.iter().find(|wish| wish.label == labels[n]);
        wish.and_then(|wish| wish.name.clone())
    };
    let regions = label_map::regions(&labels);
    let mut all: Vec<RegionReport> = (0..labels.len())
        .map(|n| RegionReport {
            label: labels[n],
            region: regions[n],
            name: name(n),
            parts: 0,
            samples: 0,
            cells: 0,
            volume: 0.0,
            sample_volume: samples[n] * world,
            volume_error_percent: 0.0,
            distance: None,
        })
        .collect();
    for (&n, size) in numbers.iter().zip(&places.volumes) {
        all[n as usize].cells += 1;
        all[n as usize].volume += size * world;
    }
    for region in &mut all {
        region.volume_error_percent = 100.0 * (region.volume / region.sample_volume - 1.0);
    }
    let given = |n: usize| {
        let wish = wishes.iter().find(|wish| wish.label == labels[n]);
        wish.and_then(|wish| wish.distance)
    };
    let surface = surface_areas(&parts, step);
    let (mut lost, mut damaged) = (LossList::default(), LossList::default());
    for (number, (part, inside)) in parts.components.iter().zip(&inside).enumerate() {
        let n = part.label as usize;
        all[n].parts += 1;
        all[n].samples += part.sample_count;
        let size = part.sample_count as f64 * sample;
        let keeping = finer_distance(sufficient_distance::<D>(size, surface[number]), given(n));
        if part.sample_count >= MIN_DAMAGED_SAMPLES {
            let distance = &mut all[n].distance;
            *distance = match (*distance, keeping) {
                (Some(a), Some(b)) => Some(a.min(b)),
                (a, b) => a.or(b),
            };
        }
        let losses = match () {
            () if *inside < MIN_KEPT_SHARE * size => &mut lost,
            () if part.sample_count >= MIN_DAMAGED_SAMPLES
                && !part.touches_side(dims)
                && *inside < (1.0 - MIN_MISSING_SHARE) * size =>
            {
                &mut damaged
            }
            () => continue,
        };
        let at = volume.coordinates(part.first_sample);
        losses.add(LostParts {
            label: labels[n],
            name: name(n),
            parts: 1,
            is_whole_label: false,
            samples: part.sample_count,
            largest_samples: part.sample_count,
            first_sample: image.geometry.to_physical(at.map(|i| i as f64)).to_vec(),
            distance: keeping,
        });
    }
    for lost in &mut lost.0 {
        let place = all.partition_point(|region| region.label < lost.label);
        lost.is_whole_label = all
            .get(place)
            .is_some_and(|region| region.parts == lost.parts);
    }
    let sample_side = sample.powf((D - 1) as f64 / D as f64);
    let touching = touching_labels(dims, &of_sample);
    let mut holes: Vec<Hole> = (contacts.iter())
        .filter(|(pair, _)| !touching.contains(*pair))
        .map(|(pair, area)| Hole {
            labels: pair.map(|n| labels[n as usize]),
            area: area / sample_side,
        })
        .collect();
    holes.sort_by(|a, b| b.area.total_cmp(&a.area));
    Some(RegionSummary {
        holes,
        regions: all,
        lost: lost.0,
        damaged: damaged.0,
    })
}

/// Parts of so many samples count as damaged where much of them is missing.
const MIN_DAMAGED_SAMPLES: usize = 50;

/// Parts of labels of which something is to be said, by label.
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

/// The area of the sides that each part shares with others, in lattice units.
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

/// Returns a distance between atoms at which a part of this volume and surface is kept, in two digits: about half
/// the width of what is as wide as long, and 0.6 of the thickness of what is thin.
fn sufficient_distance<const D: usize>(volume: f64, surface: f64) -> f64 {
    let by_volume = 0.55 * volume.powf(1.0 / D as f64);
    // Of a plate that is its thickness; the sides of samples are about 1.5 times (in the plane 1.27 times) those of a ball.
    let thickness = 2.0 * volume / surface.max(1e-12);
    let of_ball = match D {
        2 => 0.79 * (volume / std::f64::consts::PI).sqrt(),
        _ => 0.44 * (volume * 0.75 / std::f64::consts::PI).cbrt(),
    };
    let compact = (thickness / of_ball).min(1.0).powi(4);
    // Walls of a sample are raised to half as much again until they are fitted.
    let of_wall = if thickness < 1.5 { 0.8 } else { 0.6 };
    let of_thickness = of_wall + compact * (by_volume / of_ball - of_wall);
    let d = by_volume.min(of_thickness * thickness);
    let tenths = 10f64.powf(1.0 - d.log10().floor());
    (d * tenths).floor() / tenths
}

/// Atoms are not nearer together than this, in lattice units.
const MIN_ATOM_DISTANCE: f64 = 0.25;

/// Returns a distance that is less than the one that was `given`; `None` if that is as small as can be.
fn finer_distance(distance: f64, given: Option<f64>) -> Option<f64> {
    match given {
        Some(given) if distance >= given => {
            let less = (70.0 * given).floor() / 100.0;
            (less >= MIN_ATOM_DISTANCE).then_some(less)
        }
        _ => Some(distance.max(MIN_ATOM_DISTANCE)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::FeatureKind;
    use crate::feature::scenes::image_of;
    use crate::image::LabelValue;
    use crate::job::spec::{MeshSpec, NominalDistance};
    use crate::job::{CellKind, Outcome, Params, run};
    use crate::mesh::boxes::kuhn_box;
    use crate::progress::NoProgress;

    /// Balls of different sizes in two layers that a dyke cuts, somewhat different for each seed.
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
                let off = (0..3).map(|i| (p[i] - centre(k)[i]).powi(2)).sum::<f64>();
                if off < radius * radius {
                    return label;
                }
            }
            let dyke = (p[0] - 27.0) + 0.3 * (p[1] - 20.0) + 0.2 * seed * (p[2] - 20.0);
            match dyke.abs() < 2.6 {
                true => 9.0,
                false => {
                    1.0 + f64::from(u8::from(
                        p[2] > 24.0 + 0.15 * p[0] + 2.0 * (p[1] / 9.0 + seed).sin(),
                    ))
                }
            }
        })
    }

    #[test]
    fn labels_that_touch_only_in_the_mesh_are_told_with_the_area() {
        // A wall of one sample between two labels, but for a gap at high y where these touch.
        let walls = |gap: f64| {
            image_of([5, 5, 5], |p| match p[0] {
                x if x < 2.0 => 1.0,
                x if x > 2.0 || p[1] > gap => 3.0,
                _ => 2.0,
            })
        };
        let mesh = kuhn_box([4, 4, 4], 1.0);
        let neighbors = mesh.neighbors().unwrap();
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
        let contacts = contacts_of_simplices(&mesh, &neighbors, &numbers);
        assert_eq!(contacts.keys().collect::<Vec<_>>(), [&[0, 2]]);
        assert!((contacts[&[0, 2]] - 16.0).abs() < 1e-12, "{contacts:?}");
        let of = |image: &Image<3>| {
            let places = SamplePoints::from_simplices(&mesh);
            let held = (&places, &contacts);
            let found = report(image, &[], held, &numbers, [1.0; 3], &CancelToken::never());
            found.unwrap().holes
        };
        let holes = of(&walls(9.0));
        assert_eq!(holes.len(), 1);
        assert_eq!(
            holes[0].labels,
            [LabelValue::Whole(1), LabelValue::Whole(3)]
        );
        assert!((holes[0].area - 16.0).abs() < 1e-9, "{holes:?}");
        assert_eq!(of(&walls(3.5)), []);
    }

    fn mesh_image(image: &Image<3>, params: &Params<3>) -> Outcome<3> {
        run(image, params, &mut NoProgress).unwrap()
    }

    #[test]
    fn regions_have_the_volumes_of_their_samples_and_faces_where_labels_change() {
        for seed in [0.0, 1.0, 2.0] {
            let outcome = mesh_image(&test_image(seed), &Params::default());
            let regions = outcome.report.regions.as_ref().unwrap();
            // Where stairs of two interfaces meet there are single samples.
            assert!(
                regions.lost.iter().all(|lost| lost.largest_samples < 3),
                "{regions:?}"
            );
            let labels: Vec<i32> = regions.regions.iter().map(|r| r.region).collect();
            assert_eq!(labels, [1, 2, 3, 5, 7, 9]);
            for region in &regions.regions {
                // A ball of 33 samples is all of five small cells.
                let most = if region.label == 7.0 { 25.0 } else { 0.5 };
                assert!(
                    region.volume_error_percent.abs() < most,
                    "{seed}: {region:?}"
                );
            }
            let made = outcome.simplices().unwrap();
            let neighbors = made.mesh.neighbors().unwrap();
            for (face, &n) in neighbors.iter().enumerate() {
                let (c, k) = (face / 4, face % 4);
                let parts = n != NONE && made.regions[c] != made.regions[n as usize];
                assert_eq!(made.feature_faces[c] >> k & 1 == 1, parts);
            }
            let angles = outcome.report.quality.as_ref().unwrap();
            assert!(
                angles.smallest_angle.worst > 20.0,
                "{}",
                angles.smallest_angle.worst
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
    fn what_is_lost_is_named_and_kept_by_the_option_that_is_named() {
        let params = Params::new(MeshSpec {
            distance: NominalDistance::Constant(7.0),
            ..MeshSpec::default()
        })
        .unwrap();
        let image = test_image(1.0);
        let outcome = mesh_image(&image, &params);
        let lost = &outcome.report.regions.as_ref().unwrap().lost;
        let whole: Vec<&LostParts> = lost
            .iter()
            .filter(|lost| lost.largest_samples > 2)
            .collect();
        let [one] = whole[..] else {
            panic!("{lost:?}");
        };
        assert!(one.label == 7.0);
        assert_eq!((one.parts, one.is_whole_label), (1, true));
        assert!(
            one.largest_samples > 25 && one.largest_samples < 40,
            "{one:?}"
        );
        assert!(one.message().contains("label 7") && one.message().contains("keeps it"));
        let wish = one.remedy().unwrap();
        let wish = LabelOptions::parse(wish.strip_prefix("--label ").unwrap()).unwrap();
        let kept = Params::new(MeshSpec {
            label: vec![wish],
            feature: FeatureKind::Labels,
            ..params.spec
        })
        .unwrap();
        let outcome = mesh_image(&image, &kept);
        let regions = outcome.report.regions.as_ref().unwrap();
        assert!(
            regions.lost.iter().all(|lost| lost.largest_samples < 3),
            "{:?}",
            regions.lost
        );
        let small = regions.regions.iter().find(|r| r.label == 7.0).unwrap();
        // It has 27 samples.
        assert!(small.volume_error_percent.abs() < 10.0, "{small:?}");
    }

    #[test]
    fn a_label_has_its_own_distance_and_name_or_becomes_part_of_another() {
        let wishes = ["3:distance=2.5,name=core", "5:into=1", "9:distance=12"];
        let wishes = wishes.map(|text| LabelOptions::parse(text).unwrap());
        let params = Params::new(MeshSpec {
            distance: NominalDistance::Constant(7.0),
            feature: FeatureKind::Labels,
            label: wishes.to_vec(),
            ..MeshSpec::default()
        })
        .unwrap();
        let outcome = mesh_image(&test_image(0.0), &params);
        let regions = &outcome.report.regions.as_ref().unwrap().regions;
        assert!(regions.iter().all(|region| region.label != 5.0));
        let core = regions.iter().find(|region| region.label == 3.0).unwrap();
        assert_eq!(core.name.as_deref(), Some("core"));
        // A cell of the densest lattice has d^3 / (6 sqrt 2).
        let about = core.volume / (2.5f64.powi(3) / 8.485);
        let cells = core.cells as f64;
        assert!(
            cells > 0.5 * about && cells < 2.0 * about,
            "{cells} {about}"
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
    fn labels_that_are_no_whole_numbers_are_numbered() {
        let of = |labels: &[&str]| -> Vec<i32> {
            let labels = labels.iter().map(|text| LabelValue::parse(text).unwrap());
            let labels: Vec<LabelValue> = labels.collect();
            label_map::regions(&labels)
        };
        assert_eq!(of(&["-1", "0", "300"]), [-1, 0, 300]);
        assert_eq!(of(&["0.25", "1"]), [0, 1]);
        assert_eq!(of(&["16777216", "2147483647"]), [16_777_216, i32::MAX]);
        assert_eq!(of(&["5", "2147483648"]), [0, 1]);
    }
}
