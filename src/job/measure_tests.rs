use super::*;
use crate::comm::{SelfComm, run_threads};
use crate::feature::{DetectionOptions, FeaturePoint};
use crate::geometry::random::Random;
use crate::lattice::distance::{self, Distance};
use crate::mesh::boxes::{faces_on, kuhn_box};
use crate::mesh::complex::neighbours;
use crate::mesh::mesh_partition::MeshPartition;
use crate::mesh::{TetMesh, check};
use crate::report::AcutePair;

/// Number of cubes along x and y, number of cubes along z, and the side of a cube.
const CUBES_XY: usize = 12;
const CUBES_Z: usize = 4;
const CUBE_SIDE: f64 = 4.0;
/// Distance between samples along each axis.
const SAMPLE_STEP: [f64; 3] = [0.5, 1.0, 2.0];

/// Two planes that meet at 20 degrees, detected with some errors, in a mesh with some badly placed
/// nodes.
struct TestCase {
    extent: [f64; 3],
    features: Features<3>,
    distance: Distance<3>,
    mesh: TetMesh,
    feature_faces: Vec<u8>,
    tagged_faces: Vec<u8>,
}

/// Returns the width of cubes along x: their diagonals are at 20 degrees to the planes x = const.
fn cube_width() -> f64 {
    20f64.to_radians().tan()
}

/// Returns the distances along x from a point to the planes x = const and x = width * y.
fn plane_offsets([x, y, _]: [f64; 3]) -> [f64; 2] {
    let middle = 0.5 * CUBES_XY as f64 * CUBE_SIDE * cube_width();
    [(x - middle).abs(), (x - cube_width() * y).abs()]
}

impl TestCase {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut mesh = kuhn_box([CUBES_XY, CUBES_XY, CUBES_Z], CUBE_SIDE);
        mesh.nodes.iter_mut().for_each(|x| x[0] *= cube_width());
        let extent = [
            CUBES_XY as f64 * cube_width(),
            CUBES_XY as f64,
            CUBES_Z as f64,
        ]
        .map(|n| n * CUBE_SIDE);
        let is_on_plane = |x: [f64; 3]| plane_offsets(x).iter().any(|&off| off < 1e-9);
        let feature_faces = faces_on(&mesh, is_on_plane);
        for x in &mut mesh.nodes {
            let is_inside = (0..3).all(|k| x[k] > 0.1 && x[k] < extent[k] - 0.1);
            if is_inside && !is_on_plane(*x) {
                x.iter_mut().for_each(|x| *x += random.range(-0.6, 0.6));
            }
        }
        // Neighbours, and cells of one partition, have numbers far apart.
        let mut order: Vec<usize> = (0..mesh.tets.len()).collect();
        if seed > 1 {
            order.sort_by_key(|&t| (t / 6 % 5, crate::geometry::random::splitmix64(t as u64)));
        }
        mesh.tets = order.iter().map(|&t| mesh.tets[t]).collect();
        let feature_faces: Vec<u8> = order.iter().map(|&t| feature_faces[t]).collect();
        // Some faces are tagged on one side only, and some tags are wrong.
        let tag = |&bits: &u8| match random.draw() {
            r if r < 0.3 => 0,
            r if r > 0.98 => bits | 4,
            _ => bits,
        };
        let tagged_faces = feature_faces.iter().map(tag).collect();
        let dims = std::array::from_fn(|k| (extent[k] / SAMPLE_STEP[k]).round() as usize + 1);
        let options = DetectionOptions {
            step: SAMPLE_STEP,
            ..DetectionOptions::default()
        };
        let mut features = Features::empty(dims, &options);
        for i in 0..6000 {
            let [s, z] = [extent[1], extent[2]].map(|e| random.range(0.0, e));
            let (x, normal) = match i % 2 {
                0 => (0.5 * extent[0], [1.0, 0.0, 0.0]),
                _ => (cube_width() * s, [0.94, -0.342, 0.0]),
            };
            let x = x + random.range(-0.2, 0.2);
            features.points.push(FeaturePoint {
                position: [x, s, z].map(|c| c as f32),
                normal,
                strength: 1.0,
            });
            features.surface.push(1 + i % 2);
            features.on_horizon.push(false);
        }
        let mut field = distance::coarse_field(extent, 3.0, 3.0);
        let draw = |d: &mut f32| *d += random.draw() as f32;
        field.samples.iter_mut().for_each(draw);
        Self {
            extent,
            features,
            distance: Distance::Field(field),
            mesh,
            feature_faces,
            tagged_faces,
        }
    }

    fn scene(&self) -> MeshScene<'_, 3> {
        MeshScene {
            extent: self.extent,
            features: &self.features,
            distance: &self.distance,
        }
    }

    fn global_figures(&self, with_tags: bool) -> MeshFigures {
        let neighbours = self.neighbours();
        let measured = MeasuredMesh {
            view: MeshView::from_mesh(&self.mesh),
            neighbours: Some(neighbours.as_flattened()),
            tagged_faces: with_tags.then_some(&*self.tagged_faces),
            feature_faces: Some(&self.feature_faces),
            scene: &self.scene(),
            near_points: &self.features.points,
        };
        measured.figures(&SelfComm, &CancelToken::never()).unwrap()
    }

    fn neighbours(&self) -> Vec<[u32; 4]> {
        neighbours(self.mesh.nodes.len(), &self.mesh.tets).unwrap()
    }

    /// Returns the figures that each of `count` ranks measures; one rank may be cancelled.
    fn partition_figures(
        &self,
        count: usize,
        with_tags: bool,
        cancelled_rank: Option<usize>,
    ) -> Vec<MeshFigures> {
        let partitions = MeshPartition::split(&self.mesh, &self.neighbours(), count);
        run_threads(count, |comm| {
            let partition = &partitions[comm.rank()];
            let range = partition.first_cell..partition.first_cell + partition.mesh.tets.len();
            let tagged_faces = with_tags.then_some(&self.tagged_faces[range.clone()]);
            let feature_faces = &self.feature_faces[range];
            let mut keep_going = || cancelled_rank != Some(comm.rank());
            let mut features = self.features.clone();
            features.keep_share(comm);
            let scene = MeshScene {
                features: &features,
                ..self.scene()
            };
            let near_points = features.points_near(&partition.mesh.nodes, 20.0, comm);
            let near_points = near_points.unwrap().points;
            let measured = MeasuredMesh {
                view: MeshView::from_partition(partition, comm),
                neighbours: Some(partition.neighbours.as_flattened()),
                tagged_faces,
                feature_faces: Some(feature_faces),
                scene: &scene,
                near_points: &near_points,
            };
            let measure = |cancel: &CancelToken<'_>| measured.figures(comm, cancel);
            CancelToken::run(&mut keep_going, measure).unwrap()
        })
    }
}

fn assert_close(actual: f64, expected: f64) {
    let error = (actual - expected).abs();
    assert!(
        error <= 1e-12 * expected.abs().max(1.0),
        "{actual} {expected}"
    );
}

/// Sums may be rounded differently; everything else is equal.
fn assert_alike(actual: &MeshFigures, expected: &MeshFigures) {
    let (quality, expected_quality) = (
        actual.quality.clone().unwrap(),
        expected.quality.clone().unwrap(),
    );
    assert_close(quality.mean_ratio_mean, expected_quality.mean_ratio_mean);
    assert_close(quality.volume, expected_quality.volume);
    let quality = Quality {
        mean_ratio_mean: expected_quality.mean_ratio_mean,
        volume: expected_quality.volume,
        ..quality
    };
    assert_eq!(quality, expected_quality);
    let checks = [actual, expected].map(|figures| figures.box_check.clone().unwrap());
    check::partition_tests::assert_same_check(&checks[0], &checks[1]);
    assert_eq!(actual.lattice, expected.lattice);
    assert_eq!(actual.fidelity, expected.fidelity);
    let angles = |figures: &MeshFigures| figures.angle_assessment.clone().unwrap().angles;
    assert_eq!(angles(actual), angles(expected));
}

#[test]
fn figures_of_partitions_equal_those_of_the_whole_mesh() {
    for seed in [1, 2] {
        let case = TestCase::new(seed);
        for with_tags in [true, false] {
            let expected = case.global_figures(with_tags);
            let assessment = expected.angle_assessment.as_ref().unwrap();
            // The test is only meaningful if all these figures are present.
            let angles = &assessment.angles;
            let pairs = angles.acute_lines.iter().map(|line| line.pair);
            assert!(pairs.clone().any(|pair| pair == AcutePair::Features));
            assert!(angles.near_acute_line > 50 && angles.unexplained > 50);
            assert!(expected.box_check.as_ref().unwrap().passed());
            let fidelity = expected.fidelity.as_ref().unwrap();
            assert!(fidelity.on_feature.faces > 100 && fidelity.on_feature.precision > 0.9);
            assert_eq!(fidelity.tagged_faces.is_some(), with_tags);
            for count in [1, 2, 3, 7] {
                let actual = case.partition_figures(count, with_tags, None);
                actual
                    .iter()
                    .for_each(|actual| assert_alike(actual, &expected));
                let cells = actual
                    .iter()
                    .flat_map(|f| f.angle_assessment.clone().unwrap().cell_classes);
                assert!(cells.eq(assessment.cell_classes.iter().copied()), "{count}");
            }
        }
    }
}

#[test]
fn an_invalid_mesh_is_equally_invalid_in_partitions() {
    let mut case = TestCase::new(2);
    case.mesh.tets[1000].swap(1, 2);
    // A node off its side, a node far away from all others, and a node of no tetrahedron.
    case.mesh.nodes[3][2] = 0.7;
    case.mesh.nodes[300] = [40.0, -3.0, 5.0];
    case.mesh.nodes.push([1.0; 3]);
    let expected = case.global_figures(true);
    assert!(expected.box_check.as_ref().unwrap().problems.len() > 3);
    for count in [1, 2, 7] {
        let actual = case.partition_figures(count, true, None);
        actual
            .iter()
            .for_each(|actual| assert_alike(actual, &expected));
    }
}

#[test]
fn if_one_rank_is_cancelled_no_rank_measures() {
    let case = TestCase::new(1);
    for figures in case.partition_figures(3, true, Some(1)) {
        assert!(figures.angle_assessment.is_some() && figures.lattice.is_some());
        assert!(
            figures.quality.is_none() && figures.box_check.is_none() && figures.fidelity.is_none()
        );
    }
    let without_features = TestCase {
        features: Features::empty([9; 3], &DetectionOptions::default()),
        ..case
    };
    assert!(
        without_features.partition_figures(2, true, None)[0]
            .fidelity
            .is_none()
    );
}
