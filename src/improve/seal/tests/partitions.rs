//! A partitioned mesh is sealed like the whole mesh.

use super::*;
use crate::comm::run_threads;
use crate::geometry::bounding_box;
use crate::improve::tets::ImproveContext;
use crate::mesh::Mesh;
use crate::mesh::boxes::kuhn_box;
use crate::mesh::mesh_partition::MeshPartition;

/// Distance, in samples, within which a rank has the feature points.
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
    fn neighbours(&self) -> Vec<[u32; 4]> {
        self.mesh.neighbours().unwrap().as_chunks().0.to_vec()
    }

    /// Returns the report and the marks after the whole mesh is sealed.
    fn seal_whole(&self) -> (SealReport, Vec<u8>) {
        let (mut marks, cancel) = (self.marks.clone(), CancelToken::never());
        let neighbours = self.neighbours();
        let report = seal(
            &MeshView::from_mesh(&self.mesh),
            neighbours.as_flattened(),
            &self.points,
            self.extent,
            self.distance.max(),
            |_| Ok(Cow::Borrowed(&self.distance)),
            &mut marks,
            &cancel,
        );
        (report.unwrap(), marks)
    }

    /// Returns the reports of `count` ranks and the marks of the whole mesh after it is sealed in
    /// partitions.
    fn seal_partitioned(&self, count: usize) -> (Vec<SealReport>, Vec<u8>) {
        self.seal_partitioned_until(count, |_| || true)
    }

    /// Seals in partitions, where each rank continues as long as its `keep_going` returns `true`.
    fn seal_partitioned_until<P: FnMut() -> bool + Send>(
        &self,
        count: usize,
        keep_going: impl Fn(usize) -> P + Sync,
    ) -> (Vec<SealReport>, Vec<u8>) {
        let partitions = MeshPartition::split(&self.mesh, &self.neighbours(), count);
        let results = run_threads(count, |comm| {
            let partition = &partitions[comm.rank()];
            let mut marks =
                self.marks[partition.first_cell..][..partition.mesh.tets.len()].to_vec();
            // A rank has only the feature points near its partition.
            let [low, high] = bounding_box(&partition.mesh.nodes);
            let is_near = |point: &&FeaturePoint<3>| {
                let x = point.position.map(f64::from);
                (0..3).all(|k| (low[k] - FEATURE_REACH..=high[k] + FEATURE_REACH).contains(&x[k]))
            };
            let points: Vec<FeaturePoint<3>> =
                self.points.iter().filter(is_near).copied().collect();
            let report = CancelToken::run(&mut keep_going(comm.rank()), |cancel| {
                seal(
                    &MeshView::from_partition(partition, comm),
                    partition.neighbours.as_flattened(),
                    &points,
                    self.extent,
                    self.distance.max(),
                    |_| Ok(Cow::Borrowed(&self.distance)),
                    &mut marks,
                    cancel,
                )
            });
            (report.unwrap(), marks)
        });
        let (reports, marks): (Vec<SealReport>, Vec<Vec<u8>>) = results.into_iter().unzip();
        (reports, marks.concat())
    }

    /// Returns the number of closed faces that lie on the cut in the middle of the cells.
    fn closed_at_cut(&self, marks: &[u8]) -> usize {
        let half = self.mesh.len() / 2;
        let is_new = |c: usize, k: usize| (marks[c] & !self.marks[c]) >> k & 1 == 1;
        let at_cut = self.neighbours().into_iter().take(half).enumerate();
        let faces = at_cut.flat_map(|(c, around)| (0..4).map(move |k| (c, k, around[k] as usize)));
        let closed = faces.filter(|&(c, k, neighbour)| {
            let crosses_cut = (half..self.mesh.len()).contains(&neighbour);
            crosses_cut && is_new(c, k)
        });
        closed.count()
    }

    /// Returns the mesh with its cells sorted by `key` of their centroids.
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

/// Returns the points of three planes that cross in the middle of the box, one per sample.
fn plane_points() -> Vec<FeaturePoint<3>> {
    let mut random = Random::for_purpose(3, 4);
    let side = SPACING as usize * CELLS_PER_SIDE;
    let mut points = Vec::new();
    for axis in 0..3 {
        for i in 0..=side {
            for j in 0..=side {
                let mut position = [PLANE_X; 3];
                (position[(axis + 1) % 3], position[(axis + 2) % 3]) = (i as f64, j as f64);
                points.push(point(axis, position, &mut random));
            }
        }
    }
    points
}

/// Returns a mesh with three crossing planes, whose surfaces have bumps around some adjacent cells,
/// and holes. Many faces are marked on one side only.
fn bumps_and_holes(seed: u64) -> MarkedMesh {
    let mut random = Random::for_purpose(seed, 5);
    let extent = [SPACING * CELLS_PER_SIDE as f64; 3];
    let mesh: TetMesh = jittered_box([CELLS_PER_SIDE; 3], extent, 0.2, |x| !x.contains(&PLANE_X));
    let neighbours = mesh.neighbours().unwrap();
    let centre = mesh.centres();
    // Sides of the planes on which each cell is. Some cells at a plane are assigned to its other
    // side.
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
            let mut centre: [f64; 3] = std::array::from_fn(|_| random.range(4.0, 36.0));
            centre[i % 3] = PLANE_X;
            (centre, random.range(0.6, 3.0) * SPACING)
        })
        .collect();
    let mut marks = vec![0; mesh.len()];
    for c in 0..mesh.len() {
        for k in 0..4 {
            let neighbour = neighbours[4 * c + k] as usize;
            if neighbour >= mesh.len() || sides[neighbour] == sides[c] {
                continue;
            }
            let nodes = mesh.face(c, k).map(|n| mesh.nodes[n as usize]);
            let middle = std::array::from_fn(|k| nodes.iter().map(|x| x[k] / 3.0).sum());
            let in_hole = |(centre, radius): &([f64; 3], f64)| norm(sub(middle, *centre)) < *radius;
            let hides = neighbour < c && random.draw() < 0.5;
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

/// Returns the improved mesh of an image of a network of faults.
fn improved_fault_network(seed: u64) -> MarkedMesh {
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::image::synth::{self, SyntheticKind};
    use crate::improve::{Target, snap_to_features, tets};
    use crate::lattice::seeding::{self, Alignment};
    use crate::mesh::delaunay::delaunay_with_neighbours;

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
    let planes = FeaturePlanes::new(&points, extent, 0.8 * SPACING, 0.85 * SPACING + 1.5);
    let mut atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
    snap_to_features(
        &mut atoms.positions,
        &atoms.kinds,
        extent,
        &planes,
        0.35 * SPACING,
    );
    let mut delaunay = delaunay_with_neighbours(&atoms.positions).unwrap();
    let (_, marks) = tets::improve(
        &mut delaunay.mesh,
        &mut delaunay.neighbours,
        &mut atoms.kinds,
        ImproveContext {
            extent,
            planes: &planes,
            distance: &distance,
            target: Target::default(),
        },
        tets::SharedWork::alone(),
        &CancelToken::never(),
    )
    .unwrap();
    MarkedMesh {
        mesh: delaunay.mesh,
        marks,
        points,
        extent,
        distance,
    }
}

/// Checks that the whole mesh and its partitions are sealed alike. Returns the report, and the
/// number of closed faces on a cut.
fn assert_same(scene: &MarkedMesh, name: &str) -> (SealReport, usize) {
    let (report, marks) = scene.seal_whole();
    for count in [1, 2, 3, 7] {
        let (reports, partitioned_marks) = scene.seal_partitioned(count);
        for partitioned in &reports {
            let numbers = |sealed: &SealReport| (sealed.faces, sealed.pockets, sealed.compartments);
            assert_eq!(
                numbers(partitioned),
                numbers(&report),
                "{name}, {count} partitions"
            );
            assert!((partitioned.area - report.area).abs() <= 1e-12 * report.area);
            assert_eq!(partitioned, &reports[0]);
        }
        assert!(partitioned_marks == marks, "{name}, {count} partitions");
    }
    (report, scene.closed_at_cut(&marks))
}

#[test]
fn partitions_are_sealed_like_the_whole() {
    for seed in 0..4 {
        let sideways = |x: [f64; 3]| x[0] + 0.3 * x[1];
        let scattered = |x: [f64; 3]| (1e4 * (x[0] + 7.0 * x[1] + 13.0 * x[2])).sin();
        let scenes = [
            ("layers", bumps_and_holes(seed)),
            ("sideways", bumps_and_holes(seed).sorted_by(sideways)),
            ("scattered", bumps_and_holes(seed).sorted_by(scattered)),
        ];
        for (name, scene) in scenes {
            let (report, at_cut) = assert_same(&scene, &format!("{name} {seed}"));
            assert!(
                report.faces > 100 && report.pockets > 0 && report.compartments >= 8,
                "{name} {seed}: {report:?}"
            );
            assert!(at_cut > 0, "{name} {seed}");
        }
    }
}

#[test]
fn holes_in_one_partition_are_sealed_like_the_whole() {
    let mut scene = bumps_and_holes(1);
    scene.points.retain(|point| point.normal[0] == 1.0);
    scene.marks = faces_on(&scene.mesh, |x: [f64; 3]| x[0] == PLANE_X);
    let (report, _) = assert_same(&scene, "without holes");
    assert_eq!((report.faces, report.compartments), (0, 2));
    let torn = |x: [f64; 3]| {
        x[0] == PLANE_X && (x[2] < 6.0 || x[2] > 14.0 || (x[1] - PLANE_X).abs() > SPACING)
    };
    scene.marks = faces_on(&scene.mesh, torn);
    let (report, at_cut) = assert_same(&scene, "one hole");
    assert!(
        report.faces > 0 && report.compartments == 2 && at_cut == 0,
        "{report:?}"
    );
    scene.marks.fill(0);
    let (report, _) = assert_same(&scene, "without surfaces");
    assert_eq!((report.faces, report.compartments), (0, 1));
    // Fewer cells than partitions.
    scene.mesh = kuhn_box([1; 3], SPACING);
    scene.marks = vec![1; scene.mesh.len()];
    assert_same(&scene, "one cube");
}

#[test]
fn a_rank_that_cancels_stops_all() {
    let scene = bumps_and_holes(2);
    let (report, _) = scene.seal_whole();
    let stopped = |calls_before: usize| {
        let (reports, _) = scene.seal_partitioned_until(3, |rank| {
            let mut calls = 0;
            move || {
                calls += 1;
                rank != 1 || calls <= calls_before
            }
        });
        assert!(reports.iter().all(|report| *report == reports[0]));
        reports[0].faces
    };
    assert_eq!(stopped(0), 0);
    assert!(stopped(1) < report.faces);
    assert_eq!(stopped(1000), report.faces);
}

#[test]
fn partitions_of_improved_meshes_are_sealed_like_the_whole() {
    let (mut max, mut faces_at_cuts) = (SealReport::default(), 0);
    for seed in 1..5 {
        let scene = improved_fault_network(seed);
        let (report, at_cut) = assert_same(&scene, &format!("network {seed}"));
        faces_at_cuts += at_cut;
        max.faces = max.faces.max(report.faces);
        max.pockets = max.pockets.max(report.pockets);
    }
    assert!(
        max.faces > 0 && max.pockets > 0 && faces_at_cuts > 0,
        "{max:?}"
    );
}
