use super::*;
use crate::feature::gradient_magnitude::gradient_magnitude;
use crate::feature::volume::Volume;
use crate::lattice::AtomKind;
use crate::lattice::seeding::Atoms;
use crate::mesh::check::check;
use crate::mesh::tri::shape_quality;

const EXTENT: [f64; 2] = [60.0, 54.0];

/// Returns random points in the box, `count` inside of it, and points on the corners and sides.
fn random_points(count: usize) -> Atoms<2> {
    let mut state = 7u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24)
    };
    let mut points: Vec<[f64; 2]> = (0..count)
        .map(|_| [0, 1].map(|k| EXTENT[k] * (0.02 + 0.96 * random())))
        .collect();
    for i in 0..10 {
        let [x, y] = EXTENT.map(|e| e * f64::from(i) / 10.0);
        points.extend([
            [x, 0.0],
            [EXTENT[0], y],
            [EXTENT[0] - x, EXTENT[1]],
            [0.0, EXTENT[1] - y],
        ]);
    }
    Atoms::from_positions(points, EXTENT)
}

fn field(f: impl FnMut([f64; 2]) -> f64) -> ScalarField<2> {
    ScalarField::from_fn([61, 55], [1.0; 2], f)
}

/// Returns the weight of the image of a disc of value 100 on a background of 0.
fn weight_of_a_disc() -> ScalarField<2> {
    let image = field(|[x, y]| 100.0 * (0.5 - (x - 28.3).hypot(y - 26.1) + 15.0).clamp(0.0, 1.0));
    let volume = Volume {
        dims: image.dims,
        samples: &image.samples,
    };
    weight(ScalarField {
        samples: gradient_magnitude(volume, &CancelToken::never()),
        ..image
    })
}

#[test]
fn steps_are_those_of_the_formulas() {
    // One node among six others. The weights of the triangles differ.
    let ring = [
        [4.0, 0.3],
        [2.2, 3.1],
        [-2.0, 4.0],
        [-4.2, 0.2],
        [-1.0, -3.0],
        [2.6, -3.4],
    ];
    let shift = |[x, y]: [f64; 2]| [x + 30.0, y + 27.0];
    let x0 = shift([0.4, -0.2]);
    let mut nodes = vec![x0];
    nodes.extend(ring.map(shift));
    let triangles: Vec<[u32; 3]> = (0..6).map(|i| [0, 1 + i, 1 + (i + 1) % 6]).collect();
    let mesh = TriMesh { nodes, triangles };
    let star: Vec<u32> = (0..6).collect();
    for scheme in [Scheme::Cvt, Scheme::Odt] {
        let relaxation = Relaxation {
            scheme,
            weight: field(|[x, y]| 3.0 + 0.01 * x + 0.02 * y),
            rounds: 1,
        };
        let areas = |t: usize| 0.5 * double_area(&mesh.corners(t));
        let g = |t: usize| relaxation.triangle_weight(&mesh.corners(t));
        let expected: [f64; 2] = [0, 1].map(|k| match scheme {
            Scheme::Cvt => {
                let centroid = |t: usize| mesh.corners(t).iter().map(|p| p[k]).sum::<f64>() / 3.0;
                let sum: f64 = (0..6).map(|t| areas(t) * centroid(t) * g(t)).sum();
                sum / (0..6).map(|t| areas(t) * g(t)).sum::<f64>()
            }
            Scheme::Odt => {
                // Edge x0 xk has triangle k - 1 on its right and triangle k on its left.
                let sides = |n: usize| {
                    let (left, right) = (n, (n + 5) % 6);
                    areas(left) * g(left) + areas(right) * g(right)
                };
                let sum: f64 = (0..6)
                    .map(|n| sides(n) * (x0[k] - mesh.nodes[n + 1][k]))
                    .sum();
                x0[k] - sum / (0..6).map(sides).sum::<f64>()
            }
        });
        let mut moved = mesh.clone();
        assert!(relaxation.move_node(&mut moved, 0, &star, [1.0; 2]));
        for k in 0..2 {
            assert!((moved.nodes[0][k] - expected[k]).abs() < 1e-9, "{scheme:?}");
        }
    }
}

#[test]
fn random_points_become_centroids_of_their_triangles() {
    let atoms = random_points(120);
    let mobility = atoms.mobility(EXTENT);
    for scheme in [Scheme::Cvt, Scheme::Odt] {
        let relaxation = Relaxation {
            scheme,
            weight: weight(field(|_| 0.0)),
            rounds: 200,
        };
        let (mesh, rounds) = relax(
            atoms.positions.clone(),
            &[],
            &mobility,
            &relaxation,
            &CancelToken::never(),
        )
        .unwrap();
        // Moves lower the energy, and so do the flips between them.
        for round in &rounds {
            assert!(round.energy_after < round.energy_before || round.moved_count == 0);
        }
        for pair in rounds.windows(2) {
            assert!(pair[1].energy_before <= pair[0].energy_after * (1.0 + 1e-12));
        }
        let stars = NodeTriangles::new(&mesh);
        let mut squares = 0.0;
        let (mut regular, mut inside) = (0, 0);
        for (n, kind) in atoms.kinds.iter().enumerate() {
            if *kind != AtomKind::Interior {
                continue;
            }
            let star = stars.get(n);
            let (mut area, mut moment) = (0.0, [0.0; 2]);
            for &t in star {
                let p = mesh.corners(t as usize);
                area += double_area(&p);
                for k in 0..2 {
                    moment[k] += double_area(&p) * (p[0][k] + p[1][k] + p[2][k]) / 3.0;
                }
            }
            let x = mesh.nodes[n];
            squares += (moment[0] / area - x[0]).powi(2) + (moment[1] / area - x[1]).powi(2);
            inside += 1;
            regular += usize::from((5..=7).contains(&star.len()));
        }
        // The spacing of the points is about five.
        let rms = (squares / inside as f64).sqrt();
        assert!(rms < 0.1, "{scheme:?} {rms}");
        assert!(
            regular * 10 >= inside * 9,
            "{regular} of {inside} have five to seven neighbours"
        );
        let mean_quality = |mesh: &TriMesh| {
            let all = (0..mesh.triangles.len()).map(|t| shape_quality(&mesh.corners(t)));
            all.sum::<f64>() / mesh.triangles.len() as f64
        };
        let before = delaunay_plane(&atoms.positions).unwrap();
        assert!(
            mean_quality(&mesh) > 0.9 && mean_quality(&before) < 0.8,
            "{} {}",
            mean_quality(&before),
            mean_quality(&mesh)
        );
    }
}

#[test]
fn with_an_image_the_energy_falls_and_the_mesh_stays_valid() {
    let mut atoms = random_points(250);
    // Every fifth point inside stays where it is, as points on features do.
    for kind in atoms.kinds[..250].iter_mut().step_by(5) {
        *kind = AtomKind::Fixed;
    }
    let mobility = atoms.mobility(EXTENT);
    for scheme in [Scheme::Cvt, Scheme::Odt] {
        let relaxation = Relaxation {
            scheme,
            weight: weight_of_a_disc(),
            rounds: DEFAULT_ROUNDS,
        };
        let (mesh, rounds) = relax(
            atoms.positions.clone(),
            &[],
            &mobility,
            &relaxation,
            &CancelToken::never(),
        )
        .unwrap();
        assert_eq!(rounds.len(), DEFAULT_ROUNDS);
        for round in &rounds {
            assert!(
                round.energy_after < round.energy_before && round.moved_count > 100,
                "{round:?}"
            );
        }
        let last = rounds[DEFAULT_ROUNDS - 1].energy_after;
        assert!(last < 0.8 * rounds[0].energy_before, "{rounds:?}");
        let checked = check(&mesh, [0.0; 2], EXTENT, 1e-12);
        assert!(checked.passed(), "{:?}", checked.problems);
        for (n, kind) in atoms.kinds.iter().enumerate() {
            let (x, y) = (atoms.positions[n], mesh.nodes[n]);
            match kind {
                AtomKind::Fixed | AtomKind::Corner => assert_eq!(x, y),
                AtomKind::Edge => {
                    assert!((0..2).any(|k| x[k] == y[k] && (x[k] == 0.0 || x[k] == EXTENT[k])))
                }
                _ => {}
            }
        }
    }
}

#[test]
fn kept_edges_stay() {
    let mut atoms = random_points(250);
    for kind in atoms.kinds[..250].iter_mut().step_by(3) {
        *kind = AtomKind::Fixed;
    }
    let edges = |mesh: &TriMesh| -> Vec<[u32; 2]> {
        let sides = |t: &[u32; 3]| SIDES.map(|side| side.map(|i| t[i]));
        let mut edges: Vec<[u32; 2]> = mesh.triangles.iter().flat_map(sides).collect();
        edges.retain(|e| e[0] < e[1]);
        edges.sort_unstable();
        edges
    };
    let fixed = |n: u32| atoms.kinds[n as usize] == AtomKind::Fixed;
    let mut kept_edges = edges(&delaunay_plane(&atoms.positions).unwrap());
    kept_edges.retain(|e| e.iter().all(|&n| fixed(n)));
    let mobility = atoms.mobility(EXTENT);
    let relaxation = Relaxation {
        scheme: Scheme::Odt,
        weight: weight_of_a_disc(),
        rounds: DEFAULT_ROUNDS,
    };
    let count_left = |constrained: &[[u32; 2]]| {
        let points = atoms.positions.clone();
        let cancel = CancelToken::never();
        let (mesh, rounds) = relax(points, constrained, &mobility, &relaxation, &cancel).unwrap();
        assert!(
            rounds
                .iter()
                .all(|round| round.energy_after < round.energy_before)
        );
        assert!(check(&mesh, [0.0; 2], EXTENT, 1e-12).passed());
        let found_edges = edges(&mesh);
        let is_found = |e: &&[u32; 2]| found_edges.binary_search(e).is_ok();
        kept_edges.iter().filter(is_found).count()
    };
    assert!(kept_edges.len() > 60);
    assert_eq!(count_left(&kept_edges), kept_edges.len());
    // Without the constraint, smoothing loses more than one in ten of the edges.
    assert!(count_left(&[]) * 10 < kept_edges.len() * 9);
}
