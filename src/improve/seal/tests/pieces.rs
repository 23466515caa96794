//! A mesh that is sealed in pieces is as if it had been sealed as a whole.

use super::*;
use crate::comm::run_threads;
use crate::geometry::bounding_box;
use crate::lattice::distance::DistributedDistance;
use crate::mesh::Mesh;
use crate::mesh::boxes::kuhn_box;
use crate::mesh::partition::MeshPartition;

/// From how far features are seen.
const FEATURE_REACH: f64 = PATCH_RADIUS_RANGE[1] + 2.0;

/// A mesh whose surfaces have holes.
struct MarkedMesh {
    mesh: TetMesh,
    marks: Vec<u8>,
    points: Vec<FeaturePoint<3>>,
    extent: [f64; 3],
    distance: Distance<3>,
}

impl MarkedMesh {
    fn neighbors(&self) -> Vec<[u32; 4]> {
        self.mesh.neighbors().unwrap().as_chunks().0.to_vec()
    }

    /// What is closed as a whole, and the marks then.
    fn seal_whole(&self) -> (SealReport, Vec<u8>) {
        let (mut marks, patience) = (self.marks.clone(), CancelToken::never());
        let neighbors = self.neighbors();
        let done = seal(
            &self.mesh,
            neighbors.as_flattened(),
            &self.points,
            self.extent,
            &self.distance,
            &mut marks,
            &patience,
        );
        (done, marks)
    }

    /// What each of so many says is closed, and the marks of all.
    fn seal_partitioned(&self, count: usize) -> (Vec<SealReport>, Vec<u8>) {
        self.seal_partitioned_until(count, |_| || true)
    }

    /// The same as long as each has patience.
    fn seal_partitioned_until<P: FnMut() -> bool + Send>(
        &self,
        count: usize,
        keep_going: impl Fn(usize) -> P + Sync,
    ) -> (Vec<SealReport>, Vec<u8>) {
        let pieces = MeshPartition::split(&self.mesh, &self.neighbors(), count);
        let told = run_threads(count, |group| {
            let piece = &pieces[group.rank()];
            let mut marks = self.marks[piece.first_cell..][..piece.mesh.tets.len()].to_vec();
            // No more is known of features than what is near.
            let [low, high] = bounding_box(&piece.mesh.nodes);
            let is_near = |point: &&FeaturePoint<3>| {
                let x = point.position.map(f64::from);
                (0..3).all(|k| (low[k] - FEATURE_REACH..=high[k] + FEATURE_REACH).contains(&x[k]))
            };
            let points: Vec<FeaturePoint<3>> =
                self.points.iter().filter(is_near).copied().collect();
            let done = CancelToken::run(&mut keep_going(group.rank()), |patience| {
                seal_distributed(
                    piece,
                    &points,
                    self.extent,
                    &DistributedDistance::Global(self.distance.clone()),
                    &mut marks,
                    group,
                    patience,
                )
            });
            (done.unwrap(), marks)
        });
        let (done, marks): (Vec<SealReport>, Vec<Vec<u8>>) = told.into_iter().unzip();
        (done, marks.concat())
    }

    /// How many faces that are closed lie on the cut in the middle.
    fn closed_at_cut(&self, marks: &[u8]) -> usize {
        let half = self.mesh.len() / 2;
        let fresh = |c: usize, k: usize| (marks[c] & !self.marks[c]) >> k & 1 == 1;
        let at_cut = self.neighbors().into_iter().take(half).enumerate();
        let faces = at_cut.flat_map(|(c, around)| (0..4).map(move |k| (c, k, around[k] as usize)));
        let closed = faces.filter(|&(c, k, beyond)| {
            let cut = (half..self.mesh.len()).contains(&beyond);
            cut && fresh(c, k)
        });
        closed.count()
    }

    /// The same with its cells in the order of what `key` has for their centroids.
    fn sorted_by(mut self, key: impl Fn([f64; 3]) -> f64) -> Self {
        let centre = self.mesh.centres();
        let keys: Vec<f64> = (0..self.mesh.len()).map(|c| key(centre(c))).collect();
        drop(centre);
        let mut order: Vec<usize> = (0..keys.len()).collect();
        order.sort_by(|&a, &b| keys[a].total_cmp(&keys[b]));
        self.mesh.tets = order.iter().map(|&c| self.mesh.tets[c]).collect();
        self.marks = order.iter().map(|&c| self.marks[c]).collect();
        self
    }
}

/// The points of three planes that cross in the middle of the box, one a sample.
fn plane_points() -> Vec<FeaturePoint<3>> {
    let mut random = Random::for_purpose(3, 4);
    let side = SPACING as usize * CELLS_PER_SIDE;
    let mut points = Vec::new();
    for axis in 0..3 {
        for i in 0..=side {
            for j in 0..=side {
                let mut at = [PLANE_X; 3];
                (at[(axis + 1) % 3], at[(axis + 2) % 3]) = (i as f64, j as f64);
                points.push(point(axis, at, &mut random));
            }
        }
    }
    points
}

/// Three planes that cross: surfaces have bumps round some cells beside them, and holes; of many faces only
/// one side is marked.
fn bumps_and_holes(seed: u64) -> MarkedMesh {
    let mut random = Random::for_purpose(seed, 5);
    let extent = [SPACING * CELLS_PER_SIDE as f64; 3];
    let mesh: TetMesh = jittered_box([CELLS_PER_SIDE; 3], extent, 0.2, |x| !x.contains(&PLANE_X));
    let neighbors = mesh.neighbors().unwrap();
    let centre = mesh.centres();
    // On which sides of the planes each cell is; some beside a plane are counted with the other side.
    let sides = |c: usize| -> usize {
        let mut sides = (0..3)
            .map(|k| usize::from(centre(c)[k] > PLANE_X) << k)
            .sum();
        for axis in 0..3 {
            let on = |n: &&u32| mesh.nodes[**n as usize][axis] == PLANE_X;
            if mesh.tets[c].iter().filter(on).count() == 3 && random.draw() < 0.06 {
                sides ^= 1 << axis;
            }
        }
        sides
    };
    let sides: Vec<usize> = (0..mesh.len()).map(sides).collect();
    let holes: Vec<([f64; 3], f64)> = (0..8)
        .map(|i| {
            let mut at: [f64; 3] = std::array::from_fn(|_| random.range(4.0, 36.0));
            at[i % 3] = PLANE_X;
            (at, random.range(0.6, 3.0) * SPACING)
        })
        .collect();
    let mut marks = vec![0; mesh.len()];
    for c in 0..mesh.len() {
        for k in 0..4 {
            let beyond = neighbors[4 * c + k] as usize;
            if beyond >= mesh.len() || sides[beyond] == sides[c] {
                continue;
            }
            let nodes = mesh.face(c, k).map(|n| mesh.nodes[n as usize]);
            let middle = std::array::from_fn(|k| nodes.iter().map(|x| x[k] / 3.0).sum());
            let in_hole = |(at, radius): &([f64; 3], f64)| norm(sub(middle, *at)) < *radius;
            let hides = beyond < c && random.draw() < 0.5;
            if !hides && !holes.iter().any(in_hole) {
                marks[c] |= 1 << k;
            }
        }
    }
    drop(centre);
    MarkedMesh {
        mesh,
        marks,
        points: plane_points(),
        extent,
        distance: Distance::Constant(SPACING),
    }
}

/// What improvement makes of an image of a network of faults.
#[cfg(feature = "tetgen")]
fn network(seed: u64) -> MarkedMesh {
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::image::synth::{self, SyntheticKind};
    use crate::improve::{Target, snap_to_features, tets};
    use crate::lattice::seeding::{self, Alignment};
    use crate::mesh::delaunay::delaunay_with_neighbors;

    let dims = [52, 48, 44];
    let options = synth::Options {
        dims,
        seed,
        count: Some(3),
        ..synth::Options::default()
    };
    let image = synth::make(SyntheticKind::Network, &options).unwrap().image;
    let points = detect(
        &image,
        &DetectionOptions::with_kind(FeatureKind::Ridges, SPACING),
    )
    .unwrap();
    let points = points.points;
    let (extent, distance) = (dims.map(|n| (n - 1) as f64), Distance::Constant(SPACING));
    let sheets = FeaturePlanes::new(&points, extent, 0.8 * SPACING, 0.85 * SPACING + 1.5);
    let mut atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
    snap_to_features(
        &mut atoms.positions,
        &atoms.kinds,
        extent,
        &sheets,
        0.35 * SPACING,
    );
    let mut joined = delaunay_with_neighbors(&atoms.positions).unwrap();
    let (_, marks) = tets::improve(
        &mut joined.mesh,
        &mut joined.neighbors,
        &mut atoms.kinds,
        extent,
        &sheets,
        &distance,
        &Target::default(),
        &CancelToken::never(),
    )
    .unwrap();
    MarkedMesh {
        mesh: joined.mesh,
        marks,
        points,
        extent,
        distance,
    }
}

/// Seals it as a whole and in pieces; gives what was closed, and how much of that at a cut.
fn assert_same(scene: &MarkedMesh, name: &str) -> (SealReport, usize) {
    let (whole, marks) = scene.seal_whole();
    for count in [1, 2, 3, 7] {
        let (told, there) = scene.seal_partitioned(count);
        for done in &told {
            let numbers = |sealed: &SealReport| (sealed.faces, sealed.pockets, sealed.compartments);
            assert_eq!(numbers(done), numbers(&whole), "{name}, {count} pieces");
            assert!((done.area - whole.area).abs() <= 1e-12 * whole.area);
            assert_eq!(done, &told[0]);
        }
        assert!(there == marks, "{name}, {count} pieces");
    }
    (whole, scene.closed_at_cut(&marks))
}

#[test]
fn pieces_are_sealed_as_the_whole() {
    for seed in 0..4 {
        let sideways = |x: [f64; 3]| x[0] + 0.3 * x[1];
        let scattered = |x: [f64; 3]| (1e4 * (x[0] + 7.0 * x[1] + 13.0 * x[2])).sin();
        let scenes = [
            ("layers", bumps_and_holes(seed)),
            ("sideways", bumps_and_holes(seed).sorted_by(sideways)),
            ("scattered", bumps_and_holes(seed).sorted_by(scattered)),
        ];
        for (name, scene) in scenes {
            let (done, at_cut) = assert_same(&scene, &format!("{name} {seed}"));
            assert!(
                done.faces > 100 && done.pockets > 0 && done.compartments >= 8,
                "{name} {seed}: {done:?}"
            );
            assert!(at_cut > 0, "{name} {seed}");
        }
    }
}

#[test]
fn holes_that_lie_in_one_piece_and_none_at_all_are_as_in_the_whole() {
    let mut scene = bumps_and_holes(1);
    scene.points.retain(|point| point.normal[0] == 1.0);
    scene.marks = faces_on(&scene.mesh, |x: [f64; 3]| x[0] == PLANE_X);
    let (none, _) = assert_same(&scene, "without holes");
    assert_eq!((none.faces, none.compartments), (0, 2));
    let torn = |x: [f64; 3]| {
        x[0] == PLANE_X && (x[2] < 6.0 || x[2] > 14.0 || (x[1] - PLANE_X).abs() > SPACING)
    };
    scene.marks = faces_on(&scene.mesh, torn);
    let (one, at_cut) = assert_same(&scene, "one hole");
    assert!(
        one.faces > 0 && one.compartments == 2 && at_cut == 0,
        "{one:?}"
    );
    scene.marks.fill(0);
    let (open, _) = assert_same(&scene, "without surfaces");
    assert_eq!((open.faces, open.compartments), (0, 1));
    // Fewer cells than there are pieces.
    scene.mesh = kuhn_box([1; 3], SPACING);
    scene.marks = vec![1; scene.mesh.len()];
    assert_same(&scene, "one cube");
}

#[test]
fn one_without_patience_stops_all() {
    let scene = bumps_and_holes(2);
    let (whole, _) = scene.seal_whole();
    let stopped = |asked_before: usize| {
        let (told, _) = scene.seal_partitioned_until(3, |rank| {
            let mut asked = 0;
            move || {
                asked += 1;
                rank != 1 || asked <= asked_before
            }
        });
        assert!(told.iter().all(|done| *done == told[0]));
        told[0].faces
    };
    assert_eq!(stopped(0), 0);
    assert!(stopped(1) < whole.faces);
    assert_eq!(stopped(1000), whole.faces);
}

#[test]
#[cfg(feature = "tetgen")]
fn pieces_of_improved_meshes_are_sealed_as_the_whole() {
    let mut most = SealReport::default();
    for seed in 1..5 {
        let scene = network(seed);
        let (done, at_cut) = assert_same(&scene, &format!("network {seed}"));
        assert!(done.faces == 0 || at_cut > 0, "network {seed}: {done:?}");
        most.faces = most.faces.max(done.faces);
        most.pockets = most.pockets.max(done.pockets);
    }
    assert!(most.faces > 0 && most.pockets > 0, "{most:?}");
}
