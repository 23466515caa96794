//! Flow through tetrahedra against known answers.

use std::f64::consts::PI;

use super::*;
use crate::flow::rock::Tensor;
use crate::flow::test_meshes::{faces_on, jittered_box};

/// Nodes of the torn mesh in sides of the box, by a predicate of position.
fn nodes_at(flow: &TetFlow, chosen: impl Fn([f64; 3]) -> bool) -> Vec<u32> {
    let nodes = &flow.split.mesh.nodes;
    (0..nodes.len() as u32)
        .filter(|&i| chosen(nodes[i as usize]))
        .collect()
}

fn on_box(x: [f64; 3], extent: [f64; 3]) -> bool {
    (0..3).any(|k| x[k] == 0.0 || x[k] == extent[k])
}

fn full_tensor() -> Tensor {
    Tensor::from_numbers(&[3.0, 1.0, 0.1, 0.5, -0.1, 0.2]).unwrap()
}

/// Pressures at x = 0 and x = extent given, by predicate of the abscissa.
fn ends(flow: &TetFlow, length: f64, low: f64, high: f64) -> Vec<(u32, f64)> {
    let mut fixed: Vec<(u32, f64)> = nodes_at(flow, |x| x[0] == 0.0)
        .into_iter()
        .map(|i| (i, low))
        .collect();
    fixed.extend(
        nodes_at(flow, |x| x[0] == length)
            .into_iter()
            .map(|i| (i, high)),
    );
    fixed
}

fn largest_error(flow: &TetFlow, pressure: &[f64], exact: impl Fn([f64; 3]) -> f64) -> f64 {
    let nodes = &flow.split.mesh.nodes;
    pressure
        .iter()
        .zip(nodes)
        .map(|(p, &x)| (p - exact(x)).abs())
        .fold(0.0, f64::max)
}

/// The net flux out of each node's control volume through the facets between control volumes, from
/// geometry alone: quadrilaterals from an edge's middle over two faces' centres to the tetrahedron's.
fn outflow_by_facets(mesh: &TetMesh, velocity: &[[f64; 3]]) -> Vec<f64> {
    let middle = |points: &[[f64; 3]]| -> [f64; 3] {
        std::array::from_fn(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64)
    };
    let mut out = vec![0.0; mesh.nodes.len()];
    for t in 0..mesh.tets.len() {
        let p = mesh.corners(t);
        let centre = middle(&p);
        for [i, j] in crate::mesh::EDGES {
            let [k, l] = [0, 1, 2, 3]
                .into_iter()
                .filter(|&c| c != i && c != j)
                .collect::<Vec<_>>()[..]
            else {
                unreachable!()
            };
            let edge = middle(&[p[i], p[j]]);
            let (f, g) = (middle(&[p[i], p[j], p[k]]), middle(&[p[i], p[j], p[l]]));
            let mut area = cross(sub(centre, edge), sub(f, g)).map(|c| 0.5 * c);
            if dot(area, sub(p[j], p[i])) < 0.0 {
                area = area.map(|c| -c);
            }
            let flux = dot(velocity[t], area);
            out[mesh.tets[t][i] as usize] += flux;
            out[mesh.tets[t][j] as usize] -= flux;
        }
    }
    out
}

#[test]
fn linear_pressure_is_exact_for_any_mesh_and_tensor() {
    let extent = [5.0, 4.0, 3.0];
    let mesh = jittered_box([7, 6, 5], extent, 0.25, |_| true);
    let exact = |x: [f64; 3]| 2.0 + 0.7 * x[0] - 1.3 * x[1] + 0.4 * x[2];
    for tensor in [
        Tensor::isotropic(2.0),
        Tensor::from_numbers(&[1.0, 10.0, 1e-3]).unwrap(),
        full_tensor(),
    ] {
        let rock = Rock::uniform(tensor, 0.5);
        let flow = TetFlow::new(&mesh, &[], rock, Faults::CLOSED).unwrap();
        let fixed: Vec<(u32, f64)> = nodes_at(&flow, |x| on_box(x, extent))
            .into_iter()
            .map(|i| (i, exact(mesh.nodes[i as usize])))
            .collect();
        let found = flow.solve(&vec![0.0; mesh.nodes.len()], &fixed).unwrap();
        let error = largest_error(&flow, &found.pressure, exact);
        assert!(error < 1e-10, "{error}");
        let want = tensor.times([0.7, -1.3, 0.4]).map(|v| -v / 0.5);
        for velocity in flow.velocity(&found.pressure) {
            assert!(
                (0..3).all(|k| (velocity[k] - want[k]).abs() < 1e-9),
                "{velocity:?}"
            );
        }
        assert!(found.figures.total_balance < 1e-10 && found.figures.worst_balance < 1e-10);
    }
}

#[test]
fn the_error_falls_with_the_square_of_the_mesh_size() {
    // No flow through the sides; the source that makes cos cos cos the pressure.
    let tensor = Tensor::from_numbers(&[1.0, 2.0, 0.5]).unwrap();
    let exact = |x: [f64; 3]| (PI * x[0]).cos() * (2.0 * PI * x[1]).cos() * (PI * x[2]).cos();
    let source = |x: [f64; 3]| PI * PI * (1.0 + 4.0 * 2.0 + 0.5) * exact(x);
    let mut errors = Vec::new();
    for n in [8, 16, 32] {
        let mesh = jittered_box([n; 3], [1.0; 3], 0.15, |_| true);
        let flow = TetFlow::new(&mesh, &[], Rock::uniform(tensor, 1.0), Faults::OPEN).unwrap();
        let volume = flow.control_volumes();
        let mut rates: Vec<f64> = mesh
            .nodes
            .iter()
            .zip(volume)
            .map(|(&x, v)| v * source(x))
            .collect();
        let mean = rates.iter().sum::<f64>() / volume.iter().sum::<f64>();
        rates
            .iter_mut()
            .zip(volume)
            .for_each(|(rate, v)| *rate -= v * mean);
        let found = flow.solve(&rates, &[]).unwrap();
        let square = |i: usize| volume[i] * (found.pressure[i] - exact(mesh.nodes[i])).powi(2);
        errors.push((0..volume.len()).map(square).sum::<f64>().sqrt());
    }
    let orders: Vec<f64> = errors.windows(2).map(|e| (e[0] / e[1]).log2()).collect();
    assert!(orders.iter().all(|o| *o > 1.8), "{errors:?} {orders:?}");
}

#[test]
fn a_layer_of_fault_rock_makes_the_jump_that_it_must() {
    let extent = [4.0, 2.0, 2.0];
    let mesh = jittered_box([8, 4, 4], extent, 0.2, |x| x[0] != 2.0);
    let bits = faces_on(&mesh, |x| x[0] == 2.0);
    let (k, viscosity, multiplier, thickness) = (3.0, 0.5, 0.05, 0.2);
    let rock = Rock::uniform(Tensor::isotropic(k), viscosity);
    let faults = Faults::new(multiplier, Some(thickness)).unwrap();
    let flow = TetFlow::new(&mesh, &bits, rock, faults).unwrap();
    assert_eq!(flow.split.faces.len(), 2 * 4 * 4);
    assert_eq!(flow.split.mesh.nodes.len(), mesh.nodes.len() + 25);
    let fixed = ends(&flow, 4.0, 10.0, 4.0);
    let found = flow
        .solve(&vec![0.0; flow.split.mesh.nodes.len()], &fixed)
        .unwrap();
    // In series: rock outside the layer, the layer.
    let resistance = viscosity * ((4.0 - thickness) / k + thickness / (multiplier * k));
    let u = 6.0 / resistance;
    let jump = 6.0 - u * viscosity * 4.0 / k;
    let centre = |t: usize| flow.split.mesh.corners(t).iter().map(|p| p[0]).sum::<f64>() / 4.0;
    for t in 0..mesh.tets.len() {
        for (p, x) in flow.split.mesh.tets[t].map(|i| {
            (
                found.pressure[i as usize],
                flow.split.mesh.nodes[i as usize],
            )
        }) {
            let step = if centre(t) > 2.0 { jump } else { 0.0 };
            let exact = 10.0 - u * viscosity / k * x[0] - step;
            assert!((p - exact).abs() < 1e-9, "{p} {exact} at {x:?}");
        }
    }
    let across: f64 = flow.fault_rates(&found.pressure).iter().sum();
    assert!((across - 4.0 * u).abs() < 1e-9);
    assert!((found.figures.throughput - 4.0 * u).abs() < 1e-9);
}

#[test]
fn a_fault_that_is_open_is_not_there() {
    let mesh = jittered_box([4, 3, 3], [4.0, 3.0, 3.0], 0.2, |x| x[0] != 2.0);
    let bits = faces_on(&mesh, |x| x[0] == 2.0);
    let rock = || Rock::uniform(full_tensor(), 1.0);
    let open = TetFlow::new(&mesh, &bits, rock(), Faults::OPEN).unwrap();
    assert!(open.split.faces.is_empty());
    assert_eq!(open.split.mesh, mesh);
    let nearly =
        TetFlow::new(&mesh, &bits, rock(), Faults::new(1.0 - 1e-6, None).unwrap()).unwrap();
    let pressure = |flow: &TetFlow| {
        let rates = vec![0.0; flow.split.mesh.nodes.len()];
        flow.solve(&rates, &ends(flow, 4.0, 1.0, 0.0))
            .unwrap()
            .pressure
    };
    let (a, b) = (pressure(&open), pressure(&nearly));
    for (p, &from) in b.iter().zip(&nearly.split.original) {
        assert!((p - a[from as usize]).abs() < 1e-5);
    }
}

#[test]
fn a_closed_fault_parts_pressures_and_compartments() {
    let mesh = jittered_box([6, 4, 4], [6.0, 4.0, 4.0], 0.2, |x| x[0] != 3.0);
    let bits = faces_on(&mesh, |x| x[0] == 3.0);
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = TetFlow::new(&mesh, &bits, rock, Faults::CLOSED).unwrap();
    let none = vec![0.0; flow.split.mesh.nodes.len()];
    let found = flow.solve(&none, &ends(&flow, 6.0, 7.0, -2.0)).unwrap();
    assert_eq!(found.figures.compartments, 2);
    for (t, tet) in flow.split.mesh.tets.iter().enumerate() {
        let x = mesh.corners(t).iter().map(|p| p[0]).sum::<f64>() / 4.0;
        let want = if x < 3.0 { 7.0 } else { -2.0 };
        assert!(
            tet.iter()
                .all(|&i| (found.pressure[i as usize] - want).abs() < 1e-10)
        );
    }

    // A source on one side and a sink on the other cannot balance.
    let well = |x: f64, rate: f64| Well {
        name: format!("well at {x}"),
        position: [x, 1.9, 2.2],
        rate,
    };
    let apart = flow.locate(&[well(1.0, 1.0), well(5.0, -1.0)]).unwrap();
    let error = flow
        .solve(&flow.rates(&apart), &[])
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("closed faults") && error.contains("balance"),
        "{error}"
    );
    // On one side they can; the other side has pressure zero.
    let together = flow.locate(&[well(1.0, 1.0), well(2.6, -1.0)]).unwrap();
    let found = flow.solve(&flow.rates(&together), &[]).unwrap();
    assert!(found.figures.worst_balance < 1e-10 && found.figures.total_balance < 1e-10);
    let mean: f64 = found
        .pressure
        .iter()
        .zip(flow.control_volumes())
        .map(|(p, v)| p * v)
        .sum();
    assert!(mean.abs() < 1e-9);
    // With pressure given on one side only, the other must still balance.
    let fixed: Vec<(u32, f64)> = nodes_at(&flow, |x| x[0] == 0.0)
        .into_iter()
        .map(|i| (i, 0.0))
        .collect();
    assert!(flow.solve(&flow.rates(&apart), &fixed).is_err());
    assert!(flow.solve(&flow.rates(&together), &fixed).is_ok());
}

#[test]
fn pressure_is_continuous_round_the_tip_of_a_fault() {
    // The fault ends in the middle: fluid goes round it.
    let mesh = jittered_box([6, 6, 2], [6.0, 6.0, 2.0], 0.0, |_| false);
    let bits = faces_on(&mesh, |x| x[0] == 3.0 && x[1] <= 3.0);
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = TetFlow::new(&mesh, &bits, rock, Faults::CLOSED).unwrap();
    // Nodes at y = 0, 1, 2 are doubled, those of the tip (y = 3) are not.
    assert_eq!(flow.split.mesh.nodes.len(), mesh.nodes.len() + 3 * 3);
    let none = vec![0.0; flow.split.mesh.nodes.len()];
    let found = flow.solve(&none, &ends(&flow, 6.0, 1.0, 0.0)).unwrap();
    assert_eq!(found.figures.compartments, 1);
    let through = found.figures.throughput;
    assert!(through < 0.9 * 2.0 && through > 0.5 * 2.0, "{through}");
    // The mesh of faults has jumps, and by symmetry the two sides mirror each other there.
    let doubled = flow.split.original.len() - mesh.nodes.len();
    let jumps: Vec<f64> = (mesh.nodes.len()..flow.split.original.len())
        .map(|i| (found.pressure[i] - found.pressure[flow.split.original[i] as usize]).abs())
        .collect();
    assert_eq!(jumps.len(), doubled);
    assert!(jumps.iter().all(|j| *j > 0.1 && *j < 1.0), "{jumps:?}");
}

/// Pressure of a source at `from` and a sink at `to`, rate 1 and mobility 1, no flow through the
/// sides of the unit cube, up to a constant: cosines across, the one-dimensional Green's function
/// along z. Converges fast where z differs from the wells'.
fn between_wells(from: [f64; 3], to: [f64; 3], x: [f64; 3]) -> f64 {
    let mut sum = 0.5 * ((x[2] - to[2]).abs() - (x[2] - from[2]).abs());
    for m in 0..60 {
        for n in 0..60 {
            if m + n == 0 {
                continue;
            }
            let k = PI * ((m * m + n * n) as f64).sqrt();
            let weight = if m == 0 || n == 0 { 2.0 } else { 4.0 };
            let mode = |y: [f64; 3]| (PI * m as f64 * y[0]).cos() * (PI * n as f64 * y[1]).cos();
            let green = |z: f64| {
                let (low, high) = (x[2].min(z), x[2].max(z));
                // cosh(k low) cosh(k (1 - high)) / (k sinh k), without overflow.
                let e = |t: f64| (-k * t).exp();
                0.5 * e(high - low) * (1.0 + e(2.0 * low)) * (1.0 + e(2.0 * (1.0 - high)))
                    / (k * (1.0 - e(2.0)))
            };
            sum += weight * mode(x) * (mode(from) * green(from[2]) - mode(to) * green(to[2]));
        }
    }
    sum
}

#[test]
fn well_to_well_in_a_box_agrees_with_the_series() {
    let (from, to) = ([0.27, 0.31, 0.23], [0.71, 0.64, 0.28]);
    let mesh = jittered_box([24; 3], [1.0; 3], 0.15, |_| true);
    let (k, viscosity, rate) = (2.0, 0.3, 5.0);
    let flow = TetFlow::new(
        &mesh,
        &[],
        Rock::uniform(Tensor::isotropic(k), viscosity),
        Faults::OPEN,
    )
    .unwrap();
    let well = |position, rate| Well {
        name: "well".into(),
        position,
        rate,
    };
    let wells = flow.locate(&[well(from, rate), well(to, -rate)]).unwrap();
    let found = flow.solve(&flow.rates(&wells), &[]).unwrap();
    assert!(found.figures.worst_balance < 1e-10 && found.figures.total_balance < 1e-10);
    let far: Vec<usize> = (0..mesh.nodes.len())
        .filter(|&i| mesh.nodes[i][2] > 0.55)
        .step_by(97)
        .collect();
    let exact: Vec<f64> = far
        .iter()
        .map(|&i| rate * viscosity / k * between_wells(from, to, mesh.nodes[i]))
        .collect();
    let mean =
        |values: &dyn Fn(usize) -> f64| (0..far.len()).map(values).sum::<f64>() / far.len() as f64;
    let shift = mean(&|n| found.pressure[far[n]] - exact[n]);
    let spread = exact.iter().fold(0.0, |s: f64, e| s.max(e.abs()));
    for (n, &i) in far.iter().enumerate() {
        let error = (found.pressure[i] - shift - exact[n]).abs();
        assert!(error < 0.005 * spread, "{error} of {spread}");
    }
}

#[test]
fn fluid_is_conserved_on_control_volumes_measured_by_geometry() {
    let mesh = jittered_box([6; 3], [3.0; 3], 0.25, |x| x[0] != 1.5);
    let bits = faces_on(&mesh, |x| x[0] == 1.5 && x[2] <= 2.0);
    let regions: Vec<i32> = (0..mesh.tets.len()).map(|t| (t / 300 % 2) as i32).collect();
    let kinds = [(0, full_tensor()), (1, Tensor::isotropic(1e-3))];
    let rock = Rock::by_region(&regions, &kinds, 1e-3).unwrap();
    let flow = TetFlow::new(&mesh, &bits, rock, Faults::new(0.01, None).unwrap()).unwrap();
    let well = |x: f64, rate| Well {
        name: "well".into(),
        position: [x, 1.1, 1.3],
        rate,
    };
    let wells = flow.locate(&[well(0.4, 2.0), well(2.5, -2.0)]).unwrap();
    let rates = flow.rates(&wells);
    let found = flow.solve(&rates, &[]).unwrap();
    let mut out = outflow_by_facets(&flow.split.mesh, &flow.velocity(&found.pressure));
    for (face, t) in flow.split.faces.iter().zip(&flow.transmissibility) {
        for (&a, &b) in face.nodes[0].iter().zip(&face.nodes[1]) {
            let flux = t / 3.0 * (found.pressure[a as usize] - found.pressure[b as usize]);
            out[a as usize] += flux;
            out[b as usize] -= flux;
        }
    }
    for (out, rate) in out.iter().zip(&rates) {
        assert!((out - rate).abs() < 1e-10 * 2.0, "{out} {rate}");
    }
}

#[test]
fn iterations_do_not_grow_with_the_mesh() {
    let layered = |x: [f64; 3]| i32::from((4.0 * x[2]) as usize % 2 == 1);
    for kinds in [
        [(0, Tensor::isotropic(1.0)), (1, Tensor::isotropic(1e-5))],
        [
            (0, Tensor::from_numbers(&[1.0, 1.0, 0.1]).unwrap()),
            (1, Tensor::from_numbers(&[2.0, 2.0, 0.02]).unwrap()),
        ],
    ] {
        let mut iterations = Vec::new();
        for n in [8, 16, 32] {
            let mesh = jittered_box([n; 3], [1.0; 3], 0.15, |_| true);
            let regions: Vec<i32> = (0..mesh.tets.len())
                .map(|t| layered(mesh.corners(t)[0].map(|c| c * 0.999)))
                .collect();
            let rock = Rock::by_region(&regions, &kinds, 1.0).unwrap();
            let flow = TetFlow::new(&mesh, &[], rock, Faults::OPEN).unwrap();
            let well = |x: f64, rate| Well {
                name: "well".into(),
                position: [x; 3],
                rate,
            };
            let wells = flow.locate(&[well(0.1, 1.0), well(0.9, -1.0)]).unwrap();
            let found = flow.solve(&flow.rates(&wells), &[]).unwrap();
            iterations.push(found.figures.iterations);
        }
        assert!(iterations.iter().all(|&i| i <= 25), "{iterations:?}");
    }
}

#[test]
fn wells_outside_and_flat_tetrahedra_are_refused() {
    let mut mesh = jittered_box([3; 3], [3.0; 3], 0.2, |_| true);
    let rock = || Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = TetFlow::new(&mesh, &[], rock(), Faults::OPEN).unwrap();
    let well = Well {
        name: "--source 9,1,1".into(),
        position: [9.0, 1.0, 1.0],
        rate: 1.0,
    };
    let error = flow
        .locate(std::slice::from_ref(&well))
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("--source 9,1,1: ") && error.contains("outside"),
        "{error}"
    );
    let nowhere = Well {
        position: [f64::NAN; 3],
        ..well.clone()
    };
    assert!(flow.locate(&[nowhere]).is_err());
    let endless = Well {
        position: [1.0; 3],
        rate: f64::INFINITY,
        ..well.clone()
    };
    assert!(flow.locate(&[endless]).is_err());
    // On a node, an edge, a face, a corner of the box: inside.
    for position in [
        mesh.nodes[21],
        [0.0; 3],
        [3.0; 3],
        [1.5, 0.0, 0.0],
        [3.0, 1.2, 0.7],
    ] {
        let inside = Well {
            position,
            ..well.clone()
        };
        let located = flow.locate(&[inside]).unwrap()[0];
        let corners = mesh.corners(located.cell as usize);
        for k in 0..3 {
            let x: f64 = (0..4).map(|c| located.shares[c] * corners[c][k]).sum();
            assert!((x - position[k]).abs() < 1e-12);
        }
    }
    let one = flow
        .locate(&[Well {
            position: [1.1; 3],
            ..well
        }])
        .unwrap();
    let error = flow.solve(&flow.rates(&one), &[]).unwrap_err().to_string();
    assert!(
        error.contains("1.0") && error.contains("no pressure is given"),
        "{error}"
    );

    mesh.tets[5].swap(0, 1);
    let error = TetFlow::new(&mesh, &[], rock(), Faults::OPEN)
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("tetrahedron 5: "), "{error}");
}

#[test]
fn two_point_fluxes_between_tetrahedra_would_be_wrong() {
    use crate::flow::CellFlow;
    use crate::mesh::graph::Graph;
    let mesh = jittered_box([8; 3], [1.0; 3], 0.15, |_| true);
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let mut graph = Graph::from_tets(&mesh, &[], &[]).unwrap();
    for face in &mut graph.boundary {
        face.side = (face.normal[0].abs() > 0.5).then_some(u8::from(face.normal[0] > 0.0));
    }
    let cells = CellFlow::new(&graph, &rock, Faults::OPEN).unwrap();
    let found = cells
        .solve(&vec![0.0; mesh.tets.len()], &[(0, 1.0), (1, 0.0)])
        .unwrap();
    let two_point = (found.figures.throughput - 1.0).abs();
    let flow = TetFlow::new(&mesh, &[], rock, Faults::OPEN).unwrap();
    let fixed = ends(&flow, 1.0, 1.0, 0.0);
    let found = flow.solve(&vec![0.0; mesh.nodes.len()], &fixed).unwrap();
    assert!((found.figures.throughput - 1.0).abs() < 1e-10);
    // However fine the mesh.
    assert!(two_point > 0.05, "{two_point}");
}
