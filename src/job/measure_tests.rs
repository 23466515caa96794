use super::*;
use crate::comm::run_threads;
use crate::feature::{DetectionOptions, FeaturePoint};
use crate::geometry::random::Random;
use crate::lattice::distance::{self, Distance};
use crate::mesh::boxes::{faces_on, kuhn_box};
use crate::mesh::complex::neighbors;
use crate::mesh::{TetMesh, check};
use crate::report::AcutePair;

/// Cubes along x and y, and along z; the side of one.
const CUBES_XY: usize = 12;
const CUBES_Z: usize = 4;
const CUBE_SIDE: f64 = 4.0;
/// Between samples.
const SAMPLE_STEP: [f64; 3] = [0.5, 1.0, 2.0];

/// Two planes that meet at 20 degrees, found with some errors, in a mesh of which some nodes stand badly.
struct TestCase {
    extent: [f64; 3],
    features: Features<3>,
    distance: Distance<3>,
    mesh: TetMesh,
    feature_faces: Vec<u8>,
    tagged_faces: Vec<u8>,
}

/// Along x, cubes are so narrow that their diagonals are at 20 degrees to the planes x = const.
fn cube_width() -> f64 {
    20f64.to_radians().tan()
}

/// How far off the two planes x = const and x = narrow y a place is along x.
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
        let on = |x: [f64; 3]| plane_offsets(x).iter().any(|&off| off < 1e-9);
        let feature_faces = faces_on(&mesh, on);
        for x in &mut mesh.nodes {
            let inside = (0..3).all(|k| x[k] > 0.1 && x[k] < extent[k] - 0.1);
            if inside && !on(*x) {
                x.iter_mut().for_each(|x| *x += random.range(-0.6, 0.6));
            }
        }
        // Cells of one piece, and neighbours, have numbers far apart.
        let mut order: Vec<usize> = (0..mesh.tets.len()).collect();
        if seed > 1 {
            order.sort_by_key(|&t| (t / 6 % 5, crate::geometry::random::splitmix64(t as u64)));
        }
        mesh.tets = order.iter().map(|&t| mesh.tets[t]).collect();
        let feature_faces: Vec<u8> = order.iter().map(|&t| feature_faces[t]).collect();
        // Some claims are made by one side only, and some are wrong.
        let claim = |&bits: &u8| match random.draw() {
            r if r < 0.3 => 0,
            r if r > 0.98 => bits | 4,
            _ => bits,
        };
        let tagged_faces = feature_faces.iter().map(claim).collect();
        let dims = std::array::from_fn(|k| (extent[k] / SAMPLE_STEP[k]).round() as usize + 1);
        let asked = DetectionOptions {
            step: SAMPLE_STEP,
            ..DetectionOptions::default()
        };
        let mut features = Features::empty(dims, &asked);
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

    fn global_figures(&self, claims: bool) -> MeshFigures {
        let neighbors = self.neighbors();
        let measured = MeasuredMesh {
            mesh: &self.mesh,
            neighbors: Some(neighbors.as_flattened()),
            tagged_faces: claims.then_some(&*self.tagged_faces),
            feature_faces: Some(&self.feature_faces),
            scene: &self.scene(),
        };
        measured.figures(&CancelToken::never()).unwrap()
    }

    fn neighbors(&self) -> Vec<[u32; 4]> {
        neighbors(self.mesh.nodes.len(), &self.mesh.tets).unwrap()
    }

    /// What each of those who hold so many pieces finds; one of them may have no patience.
    fn partition_figures(
        &self,
        count: usize,
        claims: bool,
        impatient: Option<usize>,
    ) -> Vec<MeshFigures> {
        let pieces = MeshPartition::split(&self.mesh, &self.neighbors(), count);
        run_threads(count, |group| {
            let piece = &pieces[group.rank()];
            let own = piece.first_cell..piece.first_cell + piece.mesh.tets.len();
            let claimed = claims.then_some(&self.tagged_faces[own.clone()]);
            let feature_faces = &self.feature_faces[own];
            let mut keep_going = || impatient != Some(group.rank());
            let mut features = self.features.clone();
            features.keep_share(group);
            let scene = MeshScene {
                features: &features,
                ..self.scene()
            };
            let near = features.points_near(&piece.mesh.nodes, 20.0, group);
            let near = near.unwrap().points;
            let measure = |patience: &CancelToken<'_>| {
                figures_of_partition(
                    piece,
                    claimed,
                    feature_faces,
                    &scene,
                    &near,
                    group,
                    patience,
                )
            };
            CancelToken::run(&mut keep_going, measure).unwrap()
        })
    }
}

fn assert_close(found: f64, whole: f64) {
    let error = (found - whole).abs();
    assert!(error <= 1e-12 * whole.abs().max(1.0), "{found} {whole}");
}

/// What is summed up may be rounded otherwise; all else is the same.
fn assert_alike(found: &MeshFigures, whole: &MeshFigures) {
    let (quality, of_whole) = (
        found.quality.clone().unwrap(),
        whole.quality.clone().unwrap(),
    );
    assert_close(quality.mean_ratio_mean, of_whole.mean_ratio_mean);
    assert_close(quality.volume, of_whole.volume);
    let quality = Quality {
        mean_ratio_mean: of_whole.mean_ratio_mean,
        volume: of_whole.volume,
        ..quality
    };
    assert_eq!(quality, of_whole);
    let fillings = [found, whole].map(|figures| figures.box_check.clone().unwrap());
    check::assert_same_check(&fillings[0], &fillings[1]);
    assert_eq!(found.lattice, whole.lattice);
    assert_eq!(found.fidelity, whole.fidelity);
    let angles = |figures: &MeshFigures| figures.angle_assessment.clone().unwrap().angles;
    assert_eq!(angles(found), angles(whole));
}

#[test]
fn figures_of_pieces_are_those_of_the_whole() {
    for seed in [1, 2] {
        let case = TestCase::new(seed);
        for claims in [true, false] {
            let whole = case.global_figures(claims);
            let judged = whole.angle_assessment.as_ref().unwrap();
            // There is something to be compared.
            let angles = &judged.angles;
            let pairs = angles.acute_lines.iter().map(|line| line.pair);
            assert!(pairs.clone().any(|pair| pair == AcutePair::Features));
            assert!(angles.near_acute_line > 50 && angles.unexplained > 50);
            assert!(whole.box_check.as_ref().unwrap().passed());
            let fidelity = whole.fidelity.as_ref().unwrap();
            assert!(fidelity.on_feature.faces > 100 && fidelity.on_feature.precision > 0.9);
            assert_eq!(fidelity.tagged_faces.is_some(), claims);
            for count in [1, 2, 3, 7] {
                let found = case.partition_figures(count, claims, None);
                found.iter().for_each(|found| assert_alike(found, &whole));
                let cells = found
                    .iter()
                    .flat_map(|f| f.angle_assessment.clone().unwrap().cell_classes);
                assert!(cells.eq(judged.cell_classes.iter().copied()), "{count}");
            }
        }
    }
}

#[test]
fn an_invalid_mesh_is_as_invalid_in_pieces() {
    let mut case = TestCase::new(2);
    case.mesh.tets[1000].swap(1, 2);
    // A node off its side, one far away from all, and one of no tetrahedron.
    case.mesh.nodes[3][2] = 0.7;
    case.mesh.nodes[300] = [40.0, -3.0, 5.0];
    case.mesh.nodes.push([1.0; 3]);
    let whole = case.global_figures(true);
    assert!(whole.box_check.as_ref().unwrap().problems.len() > 3);
    for count in [1, 2, 7] {
        let found = case.partition_figures(count, true, None);
        found.iter().for_each(|found| assert_alike(found, &whole));
    }
}

#[test]
fn where_one_has_no_patience_nobody_measures_on() {
    let case = TestCase::new(1);
    for found in case.partition_figures(3, true, Some(1)) {
        assert!(found.angle_assessment.is_some() && found.lattice.is_some());
        assert!(found.quality.is_none() && found.box_check.is_none() && found.fidelity.is_none());
    }
    let none = TestCase {
        features: Features::empty([9; 3], &DetectionOptions::default()),
        ..case
    };
    assert!(none.partition_figures(2, true, None)[0].fidelity.is_none());
}
