//! Flow through triangles and tetrahedra against known answers: each test that can be is for both.

use std::f64::consts::PI;

use super::*;
use crate::mesh::TriMesh;
use crate::mesh::boxes::{faces_on, jittered_box};
use crate::model::flow::FaultLaw;
use crate::model::flow::test_meshes::{faulted_box, flow_through};

/// Nodes of the torn mesh in sides of the box, by a predicate of position.
fn nodes_at<const D: usize, M: Simplices<D>>(
    flow: &ElementFlow<D, M>,
    chosen: impl Fn([f64; D]) -> bool,
) -> Vec<u32> {
    let nodes = flow.split_mesh.mesh.nodes();
    (0..nodes.len() as u32)
        .filter(|&i| chosen(nodes[i as usize]))
        .collect()
}

fn full_tensor() -> Tensor {
    Tensor::from_numbers(&[3.0, 1.0, 0.1, 0.5, -0.1, 0.2]).unwrap()
}

/// Pressures at x = 0 and x = length given.
fn end_pressures<const D: usize, M: Simplices<D>>(
    flow: &ElementFlow<D, M>,
    length: f64,
    low: f64,
    high: f64,
) -> Vec<(u32, f64)> {
    let at = |x: f64, p: f64| {
        let nodes = nodes_at(flow, |y| y[0] == x);
        nodes.into_iter().map(move |i| (i, p))
    };
    at(0.0, low).chain(at(length, high)).collect()
}

fn no_rates<const D: usize, M: Simplices<D>>(flow: &ElementFlow<D, M>) -> Vec<f64> {
    vec![0.0; flow.split_mesh.mesh.nodes().len()]
}

/// The first coordinates of a point in space.
fn truncate_point<const D: usize>(x: [f64; 3]) -> [f64; D] {
    std::array::from_fn(|k| x[k])
}

/// Mean of points.
fn middle<const D: usize>(points: &[[f64; D]]) -> [f64; D] {
    std::array::from_fn(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64)
}

/// The net flux out of each node's control volume through the facets between control volumes, from
/// geometry alone: in the plane from an edge's middle to the cell's centre, in space quadrilaterals
/// from an edge's middle over two faces' centres to the cell's.
fn outflow_by_facets<const D: usize, M: Simplices<D>>(mesh: &M, velocity: &[[f64; D]]) -> Vec<f64> {
    let sub = |a: [f64; D], b: [f64; D]| -> [f64; D] { std::array::from_fn(|k| a[k] - b[k]) };
    let mut out = vec![0.0; mesh.nodes().len()];
    for c in 0..mesh.len() {
        let p = &corners(mesh, c)[..=D];
        let centre = middle(p);
        for i in 0..=D {
            for j in 0..i {
                let edge = middle(&[p[i], p[j]]);
                let u = sub(centre, edge);
                let mut area = [0.0; D];
                if D == 2 {
                    (area[0], area[1]) = (u[1], -u[0]);
                } else {
                    let faces: Vec<[f64; D]> = (0..=D)
                        .filter(|&k| k != i && k != j)
                        .map(|k| middle(&[p[i], p[j], p[k]]))
                        .collect();
                    let v = sub(faces[0], faces[1]);
                    area = std::array::from_fn(|k| {
                        let (l, m) = ((k + 1) % D, (k + 2) % D);
                        0.5 * (u[l] * v[m] - u[m] * v[l])
                    });
                }
                if dot(area, sub(p[j], p[i])) < 0.0 {
                    area = area.map(|c| -c);
                }
                let flux = dot(velocity[c], area);
                out[mesh.cell(c)[i] as usize] += flux;
                out[mesh.cell(c)[j] as usize] -= flux;
            }
        }
    }
    out
}

fn check_linear_pressure<const D: usize, M: Simplices<D>>() {
    let extent: [f64; D] = std::array::from_fn(|k| 5.0 - k as f64);
    let mesh: M = jittered_box(std::array::from_fn(|k| 7 - k), extent, 0.25, |_| true);
    let slope: [f64; D] = truncate_point([0.7, -1.3, 0.4]);
    let exact = |x: [f64; D]| 2.0 + dot(slope, x);
    for tensor in [
        Tensor::isotropic(2.0),
        Tensor::from_numbers(&[1.0, 10.0, 1e-3]).unwrap(),
        full_tensor(),
    ] {
        let flow = flow_through(&mesh, &[], Rock::uniform(tensor, 0.5), FaultLaw::CLOSED);
        let on_box = |x: [f64; D]| (0..D).any(|k| x[k] == 0.0 || x[k] == extent[k]);
        let fixed: Vec<(u32, f64)> = nodes_at(&flow, on_box)
            .into_iter()
            .map(|i| (i, exact(mesh.nodes()[i as usize])))
            .collect();
        let found = flow.solve(&no_rates(&flow), &fixed).unwrap();
        for (p, &x) in found.pressure.iter().zip(mesh.nodes()) {
            assert!((p - exact(x)).abs() < 1e-10, "{p} {}", exact(x));
        }
        let want = tensor.times(slope).map(|v| -v / 0.5);
        for velocity in flow.velocity(&found.pressure) {
            assert!(
                (0..D).all(|k| (velocity[k] - want[k]).abs() < 1e-9),
                "{velocity:?}"
            );
        }
        assert!(found.stats.total_imbalance < 1e-10 && found.stats.max_imbalance < 1e-10);
    }
}

#[test]
fn linear_pressure_is_exact_for_any_mesh_and_tensor() {
    check_linear_pressure::<2, TriMesh>();
    check_linear_pressure::<3, TetMesh>();
}

fn check_second_order<const D: usize, M: Simplices<D>>(sizes: [usize; 3]) {
    // No flow through the sides; the source that makes cos cos cos the pressure.
    let k = [1.0, 2.0, 0.5];
    let tensor = Tensor::from_numbers(&k).unwrap();
    let waves = [PI, 2.0 * PI, PI];
    let exact = |x: [f64; D]| (0..D).map(|c| (waves[c] * x[c]).cos()).product::<f64>();
    let strength: f64 = (0..D).map(|c| k[c] * waves[c] * waves[c]).sum();
    let mut errors = Vec::new();
    for n in sizes {
        let mesh: M = jittered_box([n; D], [1.0; D], 0.15, |_| true);
        let flow = flow_through(&mesh, &[], Rock::uniform(tensor, 1.0), FaultLaw::OPEN);
        let volume = flow.control_volumes();
        let nodes = mesh.nodes().iter().zip(volume);
        let mut rates: Vec<f64> = nodes.map(|(&x, v)| v * strength * exact(x)).collect();
        let mean = rates.iter().sum::<f64>() / volume.iter().sum::<f64>();
        rates
            .iter_mut()
            .zip(volume)
            .for_each(|(rate, v)| *rate -= v * mean);
        let found = flow.solve(&rates, &[]).unwrap();
        let square = |i: usize| volume[i] * (found.pressure[i] - exact(mesh.nodes()[i])).powi(2);
        errors.push((0..volume.len()).map(square).sum::<f64>().sqrt());
    }
    let orders: Vec<f64> = errors.windows(2).map(|e| (e[0] / e[1]).log2()).collect();
    assert!(orders.iter().all(|o| *o > 1.8), "{errors:?} {orders:?}");
}

#[test]
fn the_error_falls_with_the_square_of_the_mesh_size() {
    check_second_order::<2, TriMesh>([16, 32, 64]);
    check_second_order::<3, TetMesh>([8, 16, 32]);
}

/// A box 4 long with a layer of fault rock across it at x = 2: rock outside the layer and the layer
/// in series.
fn check_fault_layer<const D: usize, M: Simplices<D>>() {
    let mut extent = [2.0; D];
    extent[0] = 4.0;
    let mesh: M = jittered_box(extent.map(|x| 2 * x as usize), extent, 0.2, |x| x[0] != 2.0);
    let bits = faces_on(&mesh, |x| x[0] == 2.0);
    let (k, viscosity, multiplier, thickness) = (3.0, 0.5, 0.05, 0.2);
    let rock = Rock::uniform(Tensor::isotropic(k), viscosity);
    let faults = FaultLaw::new(multiplier, Some(thickness)).unwrap();
    let flow = flow_through(&mesh, &bits, rock, faults);
    let (faces, doubled) = if D == 2 { (4, 5) } else { (2 * 4 * 4, 25) };
    assert_eq!(flow.split_mesh.faces.len(), faces);
    assert_eq!(
        flow.split_mesh.mesh.nodes().len(),
        mesh.nodes().len() + doubled
    );
    let fixed = end_pressures(&flow, 4.0, 10.0, 4.0);
    let found = flow.solve(&no_rates(&flow), &fixed).unwrap();
    let resistance = viscosity * ((4.0 - thickness) / k + thickness / (multiplier * k));
    let u = 6.0 / resistance;
    let jump = 6.0 - u * viscosity * 4.0 / k;
    for c in 0..mesh.len() {
        let torn = &flow.split_mesh.mesh;
        let step = if middle(&corners(torn, c)[..=D])[0] > 2.0 {
            jump
        } else {
            0.0
        };
        for &i in torn.cell(c) {
            let (p, x) = (found.pressure[i as usize], torn.nodes()[i as usize]);
            let exact = 10.0 - u * viscosity / k * x[0] - step;
            assert!((p - exact).abs() < 1e-9, "{p} {exact} at {x:?}");
        }
    }
    let section: f64 = extent[1..].iter().product();
    let across: f64 = flow.fault_rates(&found.pressure).iter().sum();
    assert!((across - section * u).abs() < 1e-9);
    assert!((found.stats.throughput - section * u).abs() < 1e-9);
}

#[test]
fn a_layer_of_fault_rock_makes_the_jump_that_it_must() {
    check_fault_layer::<2, TriMesh>();
    check_fault_layer::<3, TetMesh>();
}

/// Three faults across a box 8 long, each with its own law; in series.
fn check_fault_laws<const D: usize, M: Simplices<D>>() {
    let mut extent = [2.0; D];
    extent[0] = 8.0;
    let at = [2.0, 4.0, 6.0];
    let mesh: M = jittered_box(extent.map(|x| x as usize), extent, 0.2, |x| {
        !at.contains(&x[0])
    });
    let mut label = vec![0; (D + 1) * mesh.len()];
    for (x, number) in at.into_iter().zip(1..) {
        let marks: Vec<bool> =
            crate::mesh::interface::marks_from_bits::<D>(&faces_on(&mesh, |y| y[0] == x)).collect();
        (0..marks.len())
            .filter(|&f| marks[f])
            .for_each(|f| label[f] = number);
    }
    let law = |multiplier| FaultLaw::new(multiplier, Some(0.1)).unwrap();
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    // The second is open, so the mesh is not torn there.
    let barriers = Barriers::new(label.clone(), vec![law(0.1), FaultLaw::OPEN, law(0.02)]).unwrap();
    let flow = ElementFlow::new(&mesh, &barriers, rock.clone()).unwrap();
    let labels: Vec<u32> = flow
        .split_mesh
        .faces
        .iter()
        .map(|face| face.label)
        .collect();
    assert!(labels.contains(&1) && !labels.contains(&2) && labels.contains(&3));
    let found = flow
        .solve(&no_rates(&flow), &end_pressures(&flow, 8.0, 1.0, 0.0))
        .unwrap();
    let resistance = 8.0 + 0.1 * (1.0 / 0.1 - 1.0) + 0.1 * (1.0 / 0.02 - 1.0);
    let section: f64 = extent[1..].iter().product();
    assert!((found.stats.throughput * resistance / section - 1.0).abs() < 1e-10);
    // One of them closed: nothing gets through.
    let laws = vec![law(0.1), FaultLaw::CLOSED, law(0.02)];
    let flow = ElementFlow::new(&mesh, &Barriers::new(label, laws).unwrap(), rock).unwrap();
    let found = flow
        .solve(&no_rates(&flow), &end_pressures(&flow, 8.0, 1.0, 0.0))
        .unwrap();
    assert!(found.stats.throughput < 1e-12 && found.stats.compartments == 2);
}

#[test]
fn every_fault_has_its_own_multiplier() {
    check_fault_laws::<2, TriMesh>();
    check_fault_laws::<3, TetMesh>();
}

#[test]
fn a_fault_that_is_open_is_not_there() {
    let mesh = jittered_box::<3, TetMesh>([4, 3, 3], [4.0, 3.0, 3.0], 0.2, |x| x[0] != 2.0);
    let bits = faces_on(&mesh, |x| x[0] == 2.0);
    let rock = || Rock::uniform(full_tensor(), 1.0);
    let open = flow_through(&mesh, &bits, rock(), FaultLaw::OPEN);
    assert!(open.split_mesh.faces.is_empty());
    assert_eq!(open.split_mesh.mesh, mesh);
    let nearly = flow_through(
        &mesh,
        &bits,
        rock(),
        FaultLaw::new(1.0 - 1e-6, None).unwrap(),
    );
    let pressure = |flow: &ElementFlow| {
        let found = flow.solve(&no_rates(flow), &end_pressures(flow, 4.0, 1.0, 0.0));
        found.unwrap().pressure
    };
    let (a, b) = (pressure(&open), pressure(&nearly));
    for (p, &from) in b.iter().zip(&nearly.split_mesh.original_node) {
        assert!((p - a[from as usize]).abs() < 1e-5);
    }
}

#[test]
fn a_closed_fault_parts_pressures_and_compartments() {
    let mesh = jittered_box::<3, TetMesh>([6, 4, 4], [6.0, 4.0, 4.0], 0.2, |x| x[0] != 3.0);
    let bits = faces_on(&mesh, |x| x[0] == 3.0);
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = flow_through(&mesh, &bits, rock, FaultLaw::CLOSED);
    let none = vec![0.0; flow.split_mesh.mesh.nodes.len()];
    let found = flow
        .solve(&none, &end_pressures(&flow, 6.0, 7.0, -2.0))
        .unwrap();
    assert_eq!(found.stats.compartments, 2);
    for (t, tet) in flow.split_mesh.mesh.tets.iter().enumerate() {
        let x = mesh.corners(t).iter().map(|p| p[0]).sum::<f64>() / 4.0;
        let want = if x < 3.0 { 7.0 } else { -2.0 };
        assert!(
            tet.iter()
                .all(|&i| (found.pressure[i as usize] - want).abs() < 1e-10)
        );
    }

    // A source on one side and a sink on the other cannot balance.
    let well = |x: f64, rate: f64| PointWell {
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
    assert!(found.stats.max_imbalance < 1e-10 && found.stats.total_imbalance < 1e-10);
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
    let mesh = jittered_box::<3, TetMesh>([6, 6, 2], [6.0, 6.0, 2.0], 0.0, |_| false);
    let bits = faces_on(&mesh, |x| x[0] == 3.0 && x[1] <= 3.0);
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = flow_through(&mesh, &bits, rock, FaultLaw::CLOSED);
    // Nodes at y = 0, 1, 2 are doubled, those of the tip (y = 3) are not.
    assert_eq!(flow.split_mesh.mesh.nodes.len(), mesh.nodes.len() + 3 * 3);
    let none = vec![0.0; flow.split_mesh.mesh.nodes.len()];
    let found = flow
        .solve(&none, &end_pressures(&flow, 6.0, 1.0, 0.0))
        .unwrap();
    assert_eq!(found.stats.compartments, 1);
    let through = found.stats.throughput;
    assert!(through < 0.9 * 2.0 && through > 0.5 * 2.0, "{through}");
    // The mesh of faults has jumps, and by symmetry the two sides mirror each other there.
    let doubled = flow.split_mesh.original_node.len() - mesh.nodes.len();
    let jumps: Vec<f64> = (mesh.nodes.len()..flow.split_mesh.original_node.len())
        .map(|i| {
            (found.pressure[i] - found.pressure[flow.split_mesh.original_node[i] as usize]).abs()
        })
        .collect();
    assert_eq!(jumps.len(), doubled);
    assert!(jumps.iter().all(|j| *j > 0.1 && *j < 1.0), "{jumps:?}");
}

#[test]
fn what_runs_out_of_patience_stops_wherever_it_is() {
    let mesh = jittered_box::<3, TetMesh>([8, 7, 6], [8.0, 7.0, 6.0], 0.2, |_| false);
    let bits = vec![0; mesh.tets.len()];
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = flow_through(&mesh, &bits, rock, FaultLaw::CLOSED);
    let (none, fixed) = (no_rates(&flow), end_pressures(&flow, 8.0, 1.0, 0.0));
    // What it gives, and how often it was asked before that.
    let ask = |questions: usize, of: &dyn Fn(&CancelToken<'_>) -> Result<()>| {
        let mut asked = 0;
        let mut keep_going = || {
            asked += 1;
            asked <= questions
        };
        let done = CancelToken::run(&mut keep_going, of);
        (done, asked)
    };
    let pressure = flow.solve(&none, &fixed).unwrap().pressure;
    let solve =
        |patience: &CancelToken<'_>| flow.solve_cancellable(&none, &fixed, patience).map(|_| ());
    let rates = |patience: &CancelToken<'_>| {
        let rates = flow.face_rates(&pressure, &[], &fixed, patience);
        rates.map(|_| ())
    };
    for work in [&solve as &dyn Fn(&CancelToken<'_>) -> Result<()>, &rates] {
        let (done, all) = ask(usize::MAX, work);
        assert!(done.is_ok() && all > 4, "asked {all} times");
        for questions in [0, 1, all / 2, all - 1] {
            let (stopped, asked) = ask(questions, work);
            let error = stopped.unwrap_err();
            assert_eq!(error.kind(), crate::ErrorKind::Interrupted, "{error}");
            assert_eq!(asked, questions + 1, "of {all}");
        }
    }
}

/// Pressure of a source at `from` and a sink at `to`, rate 1 and mobility 1, no flow through the
/// sides of the unit cube (or square), up to a constant: cosines across, the one-dimensional Green's
/// function along the last axis. Converges fast where that coordinate differs from the wells'.
fn two_well_pressure<const D: usize>(from: [f64; D], to: [f64; D], x: [f64; D]) -> f64 {
    const MODES: usize = 60;
    let last = D - 1;
    let mut sum = 0.5 * ((x[last] - to[last]).abs() - (x[last] - from[last]).abs());
    for mode in 1..MODES.pow(last as u32) {
        let waves = [mode % MODES, mode / MODES].map(|m| m as f64);
        let k = PI * (waves[0] * waves[0] + waves[1] * waves[1]).sqrt();
        let weight: f64 = waves
            .map(|m| if m == 0.0 { 1.0 } else { 2.0 })
            .iter()
            .product();
        let shape =
            |y: [f64; D]| -> f64 { (0..last).map(|c| (PI * waves[c] * y[c]).cos()).product() };
        let green = |z: f64| {
            let (low, high) = (x[last].min(z), x[last].max(z));
            // cosh(k low) cosh(k (1 - high)) / (k sinh k), without overflow.
            let e = |t: f64| (-k * t).exp();
            0.5 * e(high - low) * (1.0 + e(2.0 * low)) * (1.0 + e(2.0 * (1.0 - high)))
                / (k * (1.0 - e(2.0)))
        };
        sum += weight * shape(x) * (shape(from) * green(from[last]) - shape(to) * green(to[last]));
    }
    sum
}

fn check_well_to_well<const D: usize, M: Simplices<D>>(n: usize) {
    let (mut from, mut to): ([f64; D], [f64; D]) = (
        truncate_point([0.27, 0.31, 0.0]),
        truncate_point([0.71, 0.64, 0.0]),
    );
    (from[D - 1], to[D - 1]) = (0.23, 0.28);
    let mesh: M = jittered_box([n; D], [1.0; D], 0.15, |_| true);
    let (k, viscosity, rate) = (2.0, 0.3, 5.0);
    let rock = Rock::uniform(Tensor::isotropic(k), viscosity);
    let flow = flow_through(&mesh, &[], rock, FaultLaw::OPEN);
    let well = |position, rate| PointWell {
        name: "well".into(),
        position,
        rate,
    };
    let wells = flow.locate(&[well(from, rate), well(to, -rate)]).unwrap();
    let found = flow.solve(&flow.rates(&wells), &[]).unwrap();
    assert!(found.stats.max_imbalance < 1e-10 && found.stats.total_imbalance < 1e-10);
    let far: Vec<usize> = (0..mesh.nodes().len())
        .filter(|&i| mesh.nodes()[i][D - 1] > 0.55)
        .step_by(97)
        .collect();
    assert!(far.len() > 10);
    let exact: Vec<f64> = far
        .iter()
        .map(|&i| rate * viscosity / k * two_well_pressure(from, to, mesh.nodes()[i]))
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
fn well_to_well_in_a_box_agrees_with_the_series() {
    check_well_to_well::<2, TriMesh>(64);
    check_well_to_well::<3, TetMesh>(24);
}

fn check_conservation<const D: usize, M: Simplices<D>>() {
    let (mesh, bits) = faulted_box::<D, M>();
    let regions: Vec<i32> = (0..mesh.len()).map(|c| (c / 30 % 2) as i32).collect();
    let kinds = [(0, full_tensor()), (1, Tensor::isotropic(1e-3))];
    let rock = Rock::by_region(&regions, &kinds, 1e-3).unwrap();
    let flow = flow_through(&mesh, &bits, rock, FaultLaw::new(0.01, None).unwrap());
    let well = |x: f64, rate| PointWell {
        name: "well".into(),
        position: truncate_point([x, 1.1, 1.3]),
        rate,
    };
    let wells = flow.locate(&[well(0.4, 2.0), well(2.5, -2.0)]).unwrap();
    let rates = flow.rates(&wells);
    let found = flow.solve(&rates, &[]).unwrap();
    let mut out = outflow_by_facets(&flow.split_mesh.mesh, &flow.velocity(&found.pressure));
    for (face, t) in flow.split_mesh.faces.iter().zip(&flow.transmissibility) {
        for (&a, &b) in face.nodes[0].iter().zip(&face.nodes[1]) {
            let flux = t / D as f64 * (found.pressure[a as usize] - found.pressure[b as usize]);
            out[a as usize] += flux;
            out[b as usize] -= flux;
        }
    }
    for (out, rate) in out.iter().zip(&rates) {
        assert!((out - rate).abs() < 1e-10 * 2.0, "{out} {rate}");
    }
}

#[test]
fn fluid_is_conserved_on_control_volumes_measured_by_geometry() {
    check_conservation::<2, TriMesh>();
    check_conservation::<3, TetMesh>();
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
            let mesh = jittered_box::<3, TetMesh>([n; 3], [1.0; 3], 0.15, |_| true);
            let regions: Vec<i32> = (0..mesh.tets.len())
                .map(|t| layered(mesh.corners(t)[0].map(|c| c * 0.999)))
                .collect();
            let rock = Rock::by_region(&regions, &kinds, 1.0).unwrap();
            let flow = flow_through(&mesh, &[], rock, FaultLaw::OPEN);
            let well = |x: f64, rate| PointWell {
                name: "well".into(),
                position: [x; 3],
                rate,
            };
            let wells = flow.locate(&[well(0.1, 1.0), well(0.9, -1.0)]).unwrap();
            let found = flow.solve(&flow.rates(&wells), &[]).unwrap();
            iterations.push(found.stats.iterations);
        }
        assert!(iterations.iter().all(|&i| i <= 25), "{iterations:?}");
    }
}

#[test]
fn wells_outside_and_flat_tetrahedra_are_refused() {
    let mut mesh = jittered_box::<3, TetMesh>([3; 3], [3.0; 3], 0.2, |_| true);
    let rock = || Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = flow_through(&mesh, &[], rock(), FaultLaw::OPEN);
    let well = PointWell {
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
    let nowhere = PointWell {
        position: [f64::NAN; 3],
        ..well.clone()
    };
    assert!(flow.locate(&[nowhere]).is_err());
    let endless = PointWell {
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
        let inside = PointWell {
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
        .locate(&[PointWell {
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
    let error = ElementFlow::new(&mesh, &Barriers::default(), rock())
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("cell 5 of the tetrahedra: "), "{error}");
}

#[test]
fn two_point_fluxes_between_tetrahedra_would_be_wrong() {
    use crate::mesh::graph::Graph;
    use crate::model::flow::CellFlow;
    let mesh = jittered_box::<3, TetMesh>([8; 3], [1.0; 3], 0.15, |_| true);
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let mut graph = Graph::from_tets(&mesh, &[], &[]).unwrap();
    for face in &mut graph.boundary {
        face.side = (face.normal[0].abs() > 0.5).then_some(u8::from(face.normal[0] > 0.0));
    }
    let cells = CellFlow::new(&graph, &rock, FaultLaw::OPEN).unwrap();
    let found = cells
        .solve(&vec![0.0; mesh.tets.len()], &[(0, 1.0), (1, 0.0)])
        .unwrap();
    let two_point = (found.stats.throughput - 1.0).abs();
    let flow = flow_through(&mesh, &[], rock, FaultLaw::OPEN);
    let fixed = end_pressures(&flow, 1.0, 1.0, 0.0);
    let found = flow.solve(&no_rates(&flow), &fixed).unwrap();
    assert!((found.stats.throughput - 1.0).abs() < 1e-10);
    // However fine the mesh.
    assert!(two_point > 0.05, "{two_point}");
}
