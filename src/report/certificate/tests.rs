use super::distances::{DistanceSum, PartSurfaces, voxel_thickness};
use super::mesh_parts::MeshParts;
use super::voxel_parts::VoxelParts;
use super::*;
use crate::feature::components::for_each_sample;
use crate::mesh::boxes::jittered_box;
use crate::mesh::voronoi::voronoi;
use crate::mesh::{Mesh, SimplexMesh, Simplices, TetMesh, TriMesh};

/// An image of labels in memory.
struct Labels<const D: usize> {
    components: Components<D>,
    indices: Vec<u32>,
    values: Vec<LabelValue>,
    geometry: Geometry<D>,
}

impl<const D: usize> Labels<D> {
    fn new(dims: [usize; D], label: impl Fn([usize; D]) -> u32) -> Self {
        let mut indices = Vec::new();
        for_each_sample(dims, |_, at| indices.push(label(at)));
        let count = indices.iter().max().map_or(0, |max| max + 1);
        Self {
            components: Components::from_labels(dims, &indices),
            indices,
            values: (0..count).map(|n| LabelValue::Whole(n.into())).collect(),
            geometry: Geometry::default(),
        }
    }

    fn voxels(&self) -> VoxelParts<'_, D> {
        VoxelParts::new(&self.components, &self.indices)
    }

    fn certify(&self, cells: &LabelledCells<'_, D>) -> Certificate {
        let image = CertifiedImage {
            components: &self.components,
            indices: &self.indices,
            labels: &self.values,
            names: &[],
            dropped: &[],
            geometry: &self.geometry,
        };
        certify(&image, cells, &CancelToken::never()).unwrap()
    }

    /// Certifies a mesh whose cells have the labels of `label` at their centroids, and whose nodes then
    /// move to where `shift` says.
    fn certify_mesh<M: Simplices<D>>(
        &self,
        mesh: &M,
        label: impl Fn([f64; D]) -> u32,
        shift: impl Fn([f64; D]) -> [f64; D] + Sync + Send,
    ) -> Certificate {
        let labels = labels_of(mesh, label);
        let neighbours = mesh.neighbours().unwrap();
        self.certify(&LabelledCells::from_simplices(
            mesh,
            &neighbours,
            &labels,
            |x| shift(*x),
        ))
    }
}

fn labels_of<const D: usize, M: Simplices<D>>(
    mesh: &M,
    label: impl Fn([f64; D]) -> u32,
) -> Vec<u32> {
    let centre = mesh.centres();
    (0..mesh.len()).map(|c| label(centre(c))).collect()
}

/// Returns a box of cubes that spans an image of `dims` samples.
fn mesh_of<const D: usize>(dims: [usize; D], cubes: [usize; D]) -> SimplexMesh<D>
where
    crate::mesh::Space<D>: crate::mesh::Dimension<D, Mesh: Simplices<D>>,
{
    jittered_box(cubes, dims.map(|n| n as f64 - 1.0), 0.0, |_| false)
}

fn near(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-9, "{a} {b}");
}

#[test]
fn a_mesh_with_faces_on_the_voxels_boundary_is_exact() {
    let dims = [8, 7, 6];
    let labels = Labels::new(dims, |at| u32::from(at[0] > 3));
    let mesh: TetMesh = mesh_of(dims, [2, 3, 3]);
    let certificate = labels.certify_mesh(&mesh, |x| u32::from(x[0] > 3.5), |x| x);
    assert_eq!((certificate.parts, certificate.lost_parts), (2, 0));
    assert_eq!(
        (certificate.changed_samples, certificate.pinch_count),
        (0, 0)
    );
    assert_eq!(certificate.issues, []);
    for part in &certificate.part_reports {
        near(part.volume, 3.5 * 6.0 * 5.0);
        near(part.sample_volume, 3.5 * 6.0 * 5.0);
        near(part.dice, 1.0);
        assert_eq!((part.euler, part.mesh_euler), ([2, 2], Some(2)));
        for distances in [&part.boundary, &part.faces] {
            let distances = distances.as_ref().unwrap();
            near(distances.worst, 0.0);
            near(distances.within_half, 1.0);
        }
    }
}

#[test]
fn a_shifted_interface_is_off_by_the_shift_everywhere() {
    let dims = [8, 7, 6];
    let labels = Labels::new(dims, |at| u32::from(at[0] > 3));
    let mesh: TetMesh = mesh_of(dims, [2, 3, 3]);
    // Samples are of size 1, so that a shift by 0.3 changes none, and one by 1 those of a layer.
    for (shift, dice, changed) in [(0.3, [1.0, 1.0], 0), (1.0, [7.0 / 8.0, 5.0 / 6.0], 42)] {
        let moved = |x: [f64; 3]| [x[0] + if x[0] == 3.5 { shift } else { 0.0 }, x[1], x[2]];
        let certificate = labels.certify_mesh(&mesh, |x| u32::from(x[0] > 3.5), moved);
        assert_eq!(certificate.changed_samples, changed);
        for (side, part) in certificate.part_reports.iter().enumerate() {
            // Parts come by size and then in the order of their samples.
            let sign = [1.0, -1.0][side];
            near(part.volume_error_percent, 100.0 * sign * shift / 3.5);
            near(part.dice, dice[side]);
            for distances in [&part.boundary, &part.faces] {
                let distances = distances.as_ref().unwrap();
                near(distances.mean, shift);
                near(distances.worst, shift);
                assert_eq!(distances.within_half > 0.5, shift < 0.5);
                near(distances.within_one, 1.0);
            }
        }
    }
}

#[test]
fn a_node_between_labels_that_are_apart_is_a_pinch() {
    let dims = [8, 8, 8];
    let labels = Labels::new(dims, |at| [0, 0, 0, 1, 1, 2, 2, 2][at[0]]);
    let mesh: TetMesh = mesh_of(dims, [3, 3, 3]);
    // The wall between the labels 0 and 2 is two samples thick.
    let planes = [0.0, 2.5, 4.5, 7.0];
    let to_planes = |x: [f64; 3]| [planes[(x[0] * 3.0 / 7.0).round() as usize], x[1], x[2]];
    let layer = |x: [f64; 3]| (x[0] * 3.0 / 7.0) as u32;
    let mut numbers = labels_of(&mesh, layer);
    let neighbours = mesh.neighbours().unwrap();
    let certify = |numbers: &[u32]| {
        let cells = LabelledCells::from_simplices(&mesh, &neighbours, numbers, |x| to_planes(*x));
        labels.certify(&cells)
    };
    let whole = certify(&numbers);
    assert_eq!((whole.pinch_count, whole.issues.len()), (0, 0));
    // From the other parts, the way along the normal ends at a side of the box.
    let wall = whole
        .part_reports
        .iter()
        .find(|part| part.label == 1.0)
        .unwrap();
    near(wall.thickness.unwrap(), 2.0);
    near(wall.mesh_thickness.unwrap(), 2.0);
    // A cell of the wall that has three nodes on one side and one inside the other becomes part of
    // that side.
    let is_inside = |x: [f64; 3]| (1..3).all(|k| x[k] > 0.1 && x[k] < 6.9);
    let spike = (0..mesh.tets.len()).find(|&c| {
        let corners = mesh.corners(c).map(to_planes);
        let high: Vec<_> = corners.iter().filter(|x| x[0] == 4.5).collect();
        numbers[c] == 1 && high.len() == 1 && is_inside(*high[0])
    });
    numbers[spike.unwrap()] = 0;
    let broken = certify(&numbers);
    assert_eq!(broken.pinch_count, 1);
    let pinch = &broken.pinches[0];
    assert_eq!(pinch.labels, [LabelValue::Whole(0), LabelValue::Whole(2)]);
    assert!(pinch.are_labels_apart && pinch.at[0] == 4.5, "{pinch:?}");
    assert_eq!(broken.issues[0].kind, PartIssueKind::Pinch);
    assert_eq!(broken.issues[0].at, pinch.at);
}

#[test]
fn euler_numbers_of_bodies_in_an_image_are_those_of_their_shapes() {
    let euler_of = |body: &dyn Fn([usize; 3]) -> bool| {
        let labels = Labels::new([13, 12, 11], |at| u32::from(body(at)));
        let voxels = labels.voxels();
        let parts = labels.components.components.iter().zip(&voxels.euler);
        let parts = parts.filter(|(part, _)| part.label == 1);
        parts
            .map(|(_, euler)| (euler.bounds, euler.contacts > 0))
            .collect::<Vec<_>>()
    };
    let square = |at: [usize; 3]| -> f64 {
        (0..3)
            .map(|k| (at[k] as f64 - [6.2, 5.6, 5.1][k]).powi(2))
            .sum()
    };
    // Of the body, which is half of that of its surface: ball 2, shell 4, torus 0.
    assert_eq!(euler_of(&|at| square(at) < 16.0), [([1, 1], false)]);
    assert_eq!(
        euler_of(&|at| (6.0..20.0).contains(&square(at))),
        [([2, 2], false)]
    );
    let ring = |at: [usize; 3]| {
        let from_axis = (at[0] as f64 - 6.2).hypot(at[1] as f64 - 5.6) - 3.5;
        from_axis.powi(2) + (at[2] as f64 - 5.1).powi(2) < 2.3
    };
    assert_eq!(euler_of(&ring), [([0, 0], false)]);
    // Two boxes that touch at an edge are two parts.
    let low = |at: [usize; 3]| at[0] < 4 && at[1] < 4 && at[2] < 9;
    let high = |at: [usize; 3]| (4..8).contains(&at[0]) && (4..8).contains(&at[1]) && at[2] < 9;
    assert_eq!(euler_of(&|at| low(at) || high(at)), [([1, 1], false); 2]);
    // With a bridge at the end of that edge they are one part, and no handle.
    let bridge = |at: [usize; 3]| at[0] < 8 && at[1] < 8 && at[2] == 9;
    assert_eq!(
        euler_of(&|at| low(at) || high(at) || bridge(at)),
        [([1, 1], true)]
    );
}

#[test]
fn a_part_that_touches_itself_may_have_either_euler_number() {
    // A ring of samples in a plane with a gap that is closed at a corner only.
    let ring = [
        [1, 1, 1, 1, 0],
        [1, 0, 0, 1, 0],
        [1, 0, 0, 0, 1],
        [1, 1, 1, 1, 1],
    ];
    let labels = Labels::new([7, 6, 5], |at| {
        let is_inside = (1..6).contains(&at[0]) && (1..5).contains(&at[1]) && at[2] == 2;
        if is_inside {
            ring[at[1] - 1][at[0] - 1]
        } else {
            0
        }
    });
    let voxels = labels.voxels();
    let parts = labels.components.components.iter().zip(&voxels.euler);
    let of_ring: Vec<_> = parts
        .filter(|(part, _)| part.label == 1)
        .map(|(_, e)| *e)
        .collect();
    assert_eq!(of_ring.len(), 1);
    // The edge at which it touches itself has two ends.
    assert_eq!((of_ring[0].bounds, of_ring[0].contacts), ([0, 1], 2));
    // In the plane, the outside of the ring and its inside touch at that corner as well.
    let labels = Labels::new([7, 6], |at| {
        let is_inside = (1..6).contains(&at[0]) && (1..5).contains(&at[1]);
        if is_inside {
            ring[at[1] - 1][at[0] - 1]
        } else {
            0
        }
    });
    let voxels = labels.voxels();
    let bounds: Vec<_> = voxels.euler.iter().map(|euler| euler.bounds).collect();
    assert_eq!(labels.components.components.len(), 3);
    // The outside has a hole.
    assert!(
        bounds.contains(&[0, 1]) && bounds.contains(&[1, 1]),
        "{bounds:?}"
    );
}

#[test]
fn euler_numbers_of_a_mesh_are_those_of_the_image() {
    let dims = [13, 13, 13];
    let distance = |x: [f64; 3]| (0..3).map(|k| (x[k] - 6.0).abs()).fold(0.0, f64::max);
    // Cubes within each other; their sides lie between samples, where the nodes of the mesh are moved.
    let label = |x: [f64; 3]| match distance(x) {
        d if d < 1.5 => 2,
        d if d < 3.5 => 1,
        _ => 0,
    };
    let labels = Labels::new(dims, |at| label(at.map(|i| i as f64)));
    let mesh: TetMesh = mesh_of(dims, [6, 6, 6]);
    let at = |x: f64| [0.0, 2.5, 4.5, 6.0, 7.5, 9.5, 12.0][(x / 2.0).round() as usize];
    let cube = |x: [f64; 3]| match distance(x) {
        d if d < 2.0 => 2,
        d if d < 4.0 => 1,
        _ => 0,
    };
    let certificate = labels.certify_mesh(&mesh, cube, |x| x.map(at));
    assert_eq!(certificate.issues, []);
    for part in &certificate.part_reports {
        let euler = if part.label == 2.0 { 2 } else { 4 };
        assert_eq!(
            (part.euler, part.mesh_euler),
            ([euler; 2], Some(euler)),
            "{part:?}"
        );
        near(part.volume_error_percent, 0.0);
    }
    // Without a cell between inside and outside, the shell has a hole.
    let neighbours = mesh.neighbours().unwrap();
    let mut numbers = labels_of(&mesh, cube);
    let centre = mesh.centres();
    for c in 0..numbers.len() {
        let x = centre(c);
        if x[0] > 6.0 && (1..3).all(|k| (6.0..8.0).contains(&x[k])) && numbers[c] == 1 {
            numbers[c] = 0;
        }
    }
    let cells = LabelledCells::from_simplices(&mesh, &neighbours, &numbers, |x| x.map(at));
    let holed = labels.certify(&cells);
    let shell = holed
        .part_reports
        .iter()
        .find(|part| part.label == 1.0)
        .unwrap();
    assert_eq!((shell.mesh_euler, shell.has_wrong_euler()), (Some(2), true));
    assert!(holed.pinch_count > 0 && holed.issues.iter().any(|i| i.kind == PartIssueKind::Euler));
}

#[test]
fn a_part_without_cells_is_lost_and_named_with_its_place() {
    let dims = [10, 9, 8];
    let labels = Labels::new(dims, |at| {
        u32::from((0..3).all(|k| (3..6).contains(&at[k])))
    });
    let mesh: TetMesh = mesh_of(dims, [3, 3, 3]);
    let certificate = labels.certify_mesh(&mesh, |_| 0, |x| x);
    assert_eq!(
        (
            certificate.parts,
            certificate.lost_parts,
            certificate.lost_samples
        ),
        (2, 1, 27)
    );
    assert_eq!(certificate.changed_samples, 27);
    let issue = &certificate.issues[0];
    assert_eq!(
        (issue.kind, &*issue.at),
        (PartIssueKind::Lost, &[3.0; 3][..])
    );
    let part = certificate
        .part_reports
        .iter()
        .find(|part| part.label == 1.0)
        .unwrap();
    assert_eq!((part.cells, part.mesh_euler, &part.faces), (0, None, &None));
}

#[test]
fn triangles_are_certified_as_tetrahedra_are() {
    let dims = [8, 7];
    let labels = Labels::new(dims, |at| u32::from(at[0] > 3));
    let mesh: TriMesh = mesh_of(dims, [2, 3]);
    let moved = |x: [f64; 2]| [x[0] + if x[0] == 3.5 { 0.25 } else { 0.0 }, x[1]];
    let certificate = labels.certify_mesh(&mesh, |x| u32::from(x[0] > 3.5), moved);
    for (part, sign) in certificate.part_reports.iter().zip([1.0, -1.0]) {
        near(part.volume_error_percent, 100.0 * sign * 0.25 / 3.5);
        near(part.dice, 1.0);
        assert_eq!((part.euler, part.mesh_euler), ([1, 1], Some(1)));
        near(part.boundary.as_ref().unwrap().mean, 0.25);
        near(part.faces.as_ref().unwrap().mean, 0.25);
    }
}

#[test]
fn thickness_is_measured_along_the_normal() {
    // A wall of three samples that is oblique, at 45 degrees: 3 / sqrt 2 thick, up to a stair of a sample.
    let labels = Labels::new([24, 24, 9], |at| {
        u32::from((0..6).contains(&(at[0] as i64 + at[1] as i64 - 21)))
    });
    let voxels = labels.voxels();
    let thickness = voxel_thickness(&voxels);
    let wall = labels
        .components
        .components
        .iter()
        .position(|part| part.label == 1)
        .unwrap();
    let expected = 6.0 / 2f64.sqrt();
    let found = thickness[wall].unwrap();
    assert!((found - expected).abs() < 0.75, "{found} {expected}");
}

#[test]
fn the_distance_to_the_voxels_boundary_is_that_of_a_scan() {
    let labels = Labels::new([9, 8, 7], |at| {
        ((at[0] * 7 + at[1] * 5 + at[2] * 3) / 11 % 3) as u32
    });
    let voxels = labels.voxels();
    let mut random = crate::geometry::random::Random::new(3);
    for label in 0..3 {
        for _ in 0..200 {
            let x: [f64; 3] = std::array::from_fn(|k| random.draw() * [8.0, 7.0, 6.0][k]);
            let mut scanned = f64::INFINITY;
            for face in &voxels.faces {
                if voxels.labels[face.sample as usize] == label {
                    let centre = voxels.centre(*face);
                    let gap = |k: usize| {
                        let gap = (x[k] - centre[k]).abs();
                        if k == face.axis as usize {
                            gap
                        } else {
                            (gap - 0.5).max(0.0)
                        }
                    };
                    scanned = scanned.min((0..3).map(|k| gap(k).powi(2)).sum::<f64>().sqrt());
                }
            }
            near(voxels.boundary_distance(x, label), scanned);
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let dims = [20, 19, 18];
    let labels = Labels::new(dims, |at| (at[0] / 5 + at[1] / 6 + at[2] / 7) as u32 % 4);
    let mesh: TetMesh = jittered_box([7, 7, 7], dims.map(|n| n as f64 - 1.0), 0.3, |_| true);
    let label = |x: [f64; 3]| {
        let at = x.map(|c| c.round() as usize);
        (at[0] / 5 + at[1] / 6 + at[2] / 7) as u32 % 4
    };
    let texts = [1, 4].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let certificate = pool.install(|| labels.certify_mesh(&mesh, label, |x| x));
        serde_json::to_string(&certificate).unwrap()
    });
    assert_eq!(texts[0], texts[1]);
    let sums = DistanceSum::<3>::default();
    assert_eq!(sums.area, 0.0);
    let numbers = labels_of(&mesh, label);
    let neighbours = mesh.neighbours().unwrap();
    let cells = LabelledCells::from_simplices(&mesh, &neighbours, &numbers, |x| *x);
    let voxels = labels.voxels();
    let parts = MeshParts::new(&cells, &voxels);
    assert!(
        PartSurfaces::new(&cells, &parts, &voxels)
            .mesh_thickness()
            .iter()
            .any(Option::is_some)
    );
}

#[test]
fn a_voronoi_cell_has_the_samples_that_are_nearest_to_its_site() {
    let dims = [19, 18, 17];
    let extent = dims.map(|n| n as f64 - 1.0);
    for seed in 1..6 {
        let mut random = crate::geometry::random::Random::new(seed);
        let mut sites = vec![extent.map(|x| 0.5 * x)];
        sites.extend((0..80).map(|_| -> [f64; 3] {
            std::array::from_fn(|k| extent[k] * (0.02 + 0.96 * random.draw()))
        }));
        let nearest = |x: [f64; 3]| {
            let square = |site: &[f64; 3]| crate::geometry::distance2(site, &x);
            let closer = |best: usize, next: usize| {
                if square(&sites[next]) < square(&sites[best]) {
                    next
                } else {
                    best
                }
            };
            (0..sites.len()).fold(0, closer)
        };
        let labels = Labels::new(dims, |at| u32::from(nearest(at.map(|i| i as f64)) == 0));
        let mesh = voronoi(&sites, extent).unwrap();
        let numbers: Vec<u32> = (0..sites.len()).map(|c| u32::from(c == 0)).collect();
        let cells = LabelledCells::from_cells(&mesh, &numbers, |x| *x);
        let certificate = labels.certify(&cells);
        assert_eq!(certificate.changed_samples, 0);
        let volume: f64 = certificate
            .part_reports
            .iter()
            .map(|part| part.volume)
            .sum();
        near(volume / extent.iter().product::<f64>(), 1.0);
        // A ball, and a box with a hollow.
        for (label, euler) in [(0.0, 4), (1.0, 2)] {
            let mut parts = certificate.part_reports.iter();
            let part = parts.find(|part| part.label == label).unwrap();
            near(part.dice, 1.0);
            assert_eq!(part.mesh_euler, Some(euler), "{seed}: {part:?}");
        }
    }
}
