//! Tests of flow through triangles and tetrahedra against known solutions. Where possible, each
//! test runs in 2-D and 3-D.

use std::f64::consts::PI;

use super::*;
use crate::mesh::TriMesh;
use crate::mesh::boxes::{faces_on, jittered_box};
use crate::model::flow::FaultLaw;
use crate::model::flow::test_meshes::{faulted_box, flow_through};

/// Returns the nodes of the split mesh whose positions fulfil a predicate.
fn nodes_at<const D: usize, M: Simplices<D>>(
    flow: &ElementFlow<D, M>,
    is_selected: impl Fn([f64; D]) -> bool,
) -> Vec<u32> {
    let nodes = flow.split_mesh.mesh.nodes();
    (0..nodes.len() as u32)
        .filter(|&i| is_selected(nodes[i as usize]))
        .collect()
}

fn full_tensor() -> Tensor {
    Tensor::from_numbers(&[3.0, 1.0, 0.1, 0.5, -0.1, 0.2]).unwrap()
}

/// Returns fixed pressures for the nodes at x = 0 and x = `length`.
fn end_pressures<const D: usize, M: Simplices<D>>(
    flow: &ElementFlow<D, M>,
    length: f64,
    low: f64,
    high: f64,
) -> Vec<(u32, f64)> {
    let fixed_at = |x: f64, p: f64| {
        let nodes = nodes_at(flow, |y| y[0] == x);
        nodes.into_iter().map(move |i| (i, p))
    };
    fixed_at(0.0, low).chain(fixed_at(length, high)).collect()
}

fn no_rates<const D: usize, M: Simplices<D>>(flow: &ElementFlow<D, M>) -> Vec<f64> {
    vec![0.0; flow.split_mesh.mesh.nodes().len()]
}

/// Returns the first D coordinates of a point in space.
fn truncate_point<const D: usize>(x: [f64; 3]) -> [f64; D] {
    std::array::from_fn(|k| x[k])
}

/// Returns the mean of points.
fn middle<const D: usize>(points: &[[f64; D]]) -> [f64; D] {
    std::array::from_fn(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64)
}

/// Computes the net flux out of each node's control volume from geometry alone, through the facets
/// between control volumes. In 2-D a facet goes from the midpoint of an edge to the centre of the
/// cell. In 3-D it is a quadrilateral from the midpoint of an edge over the centres of two faces to
/// the centre of the cell.
fn outflow_by_facets<const D: usize, M: Simplices<D>>(mesh: &M, velocity: &[[f64; D]]) -> Vec<f64> {
    let sub = |a: [f64; D], b: [f64; D]| -> [f64; D] { std::array::from_fn(|k| a[k] - b[k]) };
    let mut outflow = vec![0.0; mesh.nodes().len()];
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
                outflow[mesh.cell(c)[i] as usize] += flux;
                outflow[mesh.cell(c)[j] as usize] -= flux;
            }
        }
    }
    outflow
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
        let solution = flow.solve(&no_rates(&flow), &fixed).unwrap();
        for (p, &x) in solution.pressure.iter().zip(mesh.nodes()) {
            assert!((p - exact(x)).abs() < 1e-10, "{p} {}", exact(x));
        }
        let expected = tensor.times(slope).map(|v| -v / 0.5);
        for velocity in flow.velocity(&solution.pressure) {
            assert!(
                (0..D).all(|k| (velocity[k] - expected[k]).abs() < 1e-9),
                "{velocity:?}"
            );
        }
        assert!(solution.stats.total_imbalance < 1e-10 && solution.stats.max_imbalance < 1e-10);
    }
}

#[test]
fn linear_pressure_is_exact_for_any_mesh_and_tensor() {
    check_linear_pressure::<2, TriMesh>();
    check_linear_pressure::<3, TetMesh>();
}

fn check_second_order<const D: usize, M: Simplices<D>>(sizes: [usize; 3]) {
    // No flow through the sides; the source for which the pressure is a product of cosines.
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
        let solution = flow.solve(&rates, &[]).unwrap();
        let square = |i: usize| volume[i] * (solution.pressure[i] - exact(mesh.nodes()[i])).powi(2);
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

/// Checks a box of length 4 with a layer of fault rock at x = 2: the layer and the rock outside it
/// are resistances in series.
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
    let solution = flow.solve(&no_rates(&flow), &fixed).unwrap();
    let resistance = viscosity * ((4.0 - thickness) / k + thickness / (multiplier * k));
    let u = 6.0 / resistance;
    let jump = 6.0 - u * viscosity * 4.0 / k;
    for c in 0..mesh.len() {
        let split = &flow.split_mesh.mesh;
        let step = if middle(&corners(split, c)[..=D])[0] > 2.0 {
            jump
        } else {
            0.0
        };
        for &i in split.cell(c) {
            let (p, x) = (solution.pressure[i as usize], split.nodes()[i as usize]);
            let exact = 10.0 - u * viscosity / k * x[0] - step;
            assert!((p - exact).abs() < 1e-9, "{p} {exact} at {x:?}");
        }
    }
    let section: f64 = extent[1..].iter().product();
    let fault_rate: f64 = flow.fault_rates(&solution.pressure).iter().sum();
    assert!((fault_rate - section * u).abs() < 1e-9);
    assert!((solution.stats.throughput - section * u).abs() < 1e-9);
}

#[test]
fn a_layer_of_fault_rock_causes_the_exact_pressure_jump() {
    check_fault_layer::<2, TriMesh>();
    check_fault_layer::<3, TetMesh>();
}

/// Checks a box of length 8 with three faults across it, each with its own law: they are
/// resistances in series.
fn check_fault_laws<const D: usize, M: Simplices<D>>() {
    let mut extent = [2.0; D];
    extent[0] = 8.0;
    let fault_positions = [2.0, 4.0, 6.0];
    let mesh: M = jittered_box(extent.map(|x| x as usize), extent, 0.2, |x| {
        !fault_positions.contains(&x[0])
    });
    let mut label = vec![0; (D + 1) * mesh.len()];
    for (x, number) in fault_positions.into_iter().zip(1..) {
        let marks: Vec<bool> =
            crate::mesh::interface::marks_from_bits::<D>(&faces_on(&mesh, |y| y[0] == x)).collect();
        (0..marks.len())
            .filter(|&f| marks[f])
            .for_each(|f| label[f] = number);
    }
    let law = |multiplier| FaultLaw::new(multiplier, Some(0.1)).unwrap();
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    // The second fault is open, so the mesh is not split there.
    let barriers = Barriers::new(label.clone(), vec![law(0.1), FaultLaw::OPEN, law(0.02)]).unwrap();
    let flow = ElementFlow::new(&mesh, &barriers, rock.clone()).unwrap();
    let labels: Vec<u32> = flow
        .split_mesh
        .faces
        .iter()
        .map(|face| face.label)
        .collect();
    assert!(labels.contains(&1) && !labels.contains(&2) && labels.contains(&3));
    let solution = flow
        .solve(&no_rates(&flow), &end_pressures(&flow, 8.0, 1.0, 0.0))
        .unwrap();
    let resistance = 8.0 + 0.1 * (1.0 / 0.1 - 1.0) + 0.1 * (1.0 / 0.02 - 1.0);
    let section: f64 = extent[1..].iter().product();
    assert!((solution.stats.throughput * resistance / section - 1.0).abs() < 1e-10);
    // With one fault closed, nothing flows.
    let laws = vec![law(0.1), FaultLaw::CLOSED, law(0.02)];
    let flow = ElementFlow::new(&mesh, &Barriers::new(label, laws).unwrap(), rock).unwrap();
    let solution = flow
        .solve(&no_rates(&flow), &end_pressures(&flow, 8.0, 1.0, 0.0))
        .unwrap();
    assert!(solution.stats.throughput < 1e-12 && solution.stats.compartments == 2);
}

#[test]
fn every_fault_has_its_own_multiplier() {
    check_fault_laws::<2, TriMesh>();
    check_fault_laws::<3, TetMesh>();
}

#[test]
fn an_open_fault_has_no_effect() {
    let mesh = jittered_box::<3, TetMesh>([4, 3, 3], [4.0, 3.0, 3.0], 0.2, |x| x[0] != 2.0);
    let bits = faces_on(&mesh, |x| x[0] == 2.0);
    let rock = || Rock::uniform(full_tensor(), 1.0);
    let open = flow_through(&mesh, &bits, rock(), FaultLaw::OPEN);
    assert!(open.split_mesh.faces.is_empty());
    assert_eq!(open.split_mesh.mesh, mesh);
    let almost_open = flow_through(
        &mesh,
        &bits,
        rock(),
        FaultLaw::new(1.0 - 1e-6, None).unwrap(),
    );
    let pressure = |flow: &ElementFlow| {
        let solution = flow.solve(&no_rates(flow), &end_pressures(flow, 4.0, 1.0, 0.0));
        solution.unwrap().pressure
    };
    let (a, b) = (pressure(&open), pressure(&almost_open));
    for (p, &original) in b.iter().zip(&almost_open.split_mesh.original_node) {
        assert!((p - a[original as usize]).abs() < 1e-5);
    }
}

#[test]
fn a_closed_fault_separates_pressures_and_compartments() {
    let mesh = jittered_box::<3, TetMesh>([6, 4, 4], [6.0, 4.0, 4.0], 0.2, |x| x[0] != 3.0);
    let bits = faces_on(&mesh, |x| x[0] == 3.0);
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = flow_through(&mesh, &bits, rock, FaultLaw::CLOSED);
    let rates = vec![0.0; flow.split_mesh.mesh.nodes.len()];
    let solution = flow
        .solve(&rates, &end_pressures(&flow, 6.0, 7.0, -2.0))
        .unwrap();
    assert_eq!(solution.stats.compartments, 2);
    for (t, tet) in flow.split_mesh.mesh.tets.iter().enumerate() {
        let x = mesh.corners(t).iter().map(|p| p[0]).sum::<f64>() / 4.0;
        let expected = if x < 3.0 { 7.0 } else { -2.0 };
        assert!(
            tet.iter()
                .all(|&i| (solution.pressure[i as usize] - expected).abs() < 1e-10)
        );
    }

    // A source on one side and a sink on the other side cannot balance.
    let well = |x: f64, rate: f64| PointWell {
        name: format!("well at {x}"),
        position: [x, 1.9, 2.2],
        rate,
    };
    let unbalanced = flow.locate(&[well(1.0, 1.0), well(5.0, -1.0)]).unwrap();
    let error = flow
        .solve(&flow.rates(&unbalanced), &[])
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("closed faults") && error.contains("balance"),
        "{error}"
    );
    // On the same side they can; the other side has pressure zero.
    let balanced = flow.locate(&[well(1.0, 1.0), well(2.6, -1.0)]).unwrap();
    let solution = flow.solve(&flow.rates(&balanced), &[]).unwrap();
    assert!(solution.stats.max_imbalance < 1e-10 && solution.stats.total_imbalance < 1e-10);
    let mean: f64 = solution
        .pressure
        .iter()
        .zip(flow.control_volumes())
        .map(|(p, v)| p * v)
        .sum();
    assert!(mean.abs() < 1e-9);
    // If pressure is fixed on one side only, the other side must still balance.
    let fixed: Vec<(u32, f64)> = nodes_at(&flow, |x| x[0] == 0.0)
        .into_iter()
        .map(|i| (i, 0.0))
        .collect();
    assert!(flow.solve(&flow.rates(&unbalanced), &fixed).is_err());
    assert!(flow.solve(&flow.rates(&balanced), &fixed).is_ok());
}

#[test]
fn pressure_is_continuous_around_the_tip_of_a_fault() {
    // The fault ends in the middle, and fluid flows around its tip.
    let mesh = jittered_box::<3, TetMesh>([6, 6, 2], [6.0, 6.0, 2.0], 0.0, |_| false);
    let bits = faces_on(&mesh, |x| x[0] == 3.0 && x[1] <= 3.0);
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = flow_through(&mesh, &bits, rock, FaultLaw::CLOSED);
    // Nodes at y = 0, 1, 2 are doubled; those at the tip (y = 3) are not.
    assert_eq!(flow.split_mesh.mesh.nodes.len(), mesh.nodes.len() + 3 * 3);
    let rates = vec![0.0; flow.split_mesh.mesh.nodes.len()];
    let solution = flow
        .solve(&rates, &end_pressures(&flow, 6.0, 1.0, 0.0))
        .unwrap();
    assert_eq!(solution.stats.compartments, 1);
    let throughput = solution.stats.throughput;
    assert!(
        throughput < 0.9 * 2.0 && throughput > 0.5 * 2.0,
        "{throughput}"
    );
    // Pressure jumps across the fault.
    let doubled = flow.split_mesh.original_node.len() - mesh.nodes.len();
    let jumps: Vec<f64> = (mesh.nodes.len()..flow.split_mesh.original_node.len())
        .map(|i| {
            (solution.pressure[i] - solution.pressure[flow.split_mesh.original_node[i] as usize])
                .abs()
        })
        .collect();
    assert_eq!(jumps.len(), doubled);
    assert!(jumps.iter().all(|j| *j > 0.1 && *j < 1.0), "{jumps:?}");
}

#[test]
fn cancelled_work_stops_at_any_check() {
    let mesh = jittered_box::<3, TetMesh>([8, 7, 6], [8.0, 7.0, 6.0], 0.2, |_| false);
    let bits = vec![0; mesh.tets.len()];
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let flow = flow_through(&mesh, &bits, rock, FaultLaw::CLOSED);
    let (sources, fixed) = (no_rates(&flow), end_pressures(&flow, 8.0, 1.0, 0.0));
    // Returns the result of `work` and the number of checks of the token, if it is cancelled after
    // `max_checks` checks.
    let run_with_limit = |max_checks: usize, work: &dyn Fn(&CancelToken<'_>) -> Result<()>| {
        let mut checks = 0;
        let mut keep_going = || {
            checks += 1;
            checks <= max_checks
        };
        let result = CancelToken::run(&mut keep_going, work);
        (result, checks)
    };
    let pressure = flow.solve(&sources, &fixed).unwrap().pressure;
    let solve =
        |cancel: &CancelToken<'_>| flow.solve_cancellable(&sources, &fixed, cancel).map(|_| ());
    let rates = |cancel: &CancelToken<'_>| {
        let face_rates = flow.face_rates(&pressure, &[], &fixed, cancel);
        face_rates.map(|_| ())
    };
    for work in [&solve as &dyn Fn(&CancelToken<'_>) -> Result<()>, &rates] {
        let (result, total_checks) = run_with_limit(usize::MAX, work);
        assert!(
            result.is_ok() && total_checks > 4,
            "checked {total_checks} times"
        );
        for limit in [0, 1, total_checks / 2, total_checks - 1] {
            let (result, checks) = run_with_limit(limit, work);
            let error = result.unwrap_err();
            assert_eq!(error.kind(), crate::ErrorKind::Interrupted, "{error}");
            assert_eq!(checks, limit + 1, "of {total_checks}");
        }
    }
}

/// Returns the pressure of a source and a sink with rate 1 and mobility 1, without flow through the
/// sides of the unit cube (or square), up to a constant: cosines across, and the one-dimensional
/// Green's function along the last axis. The series converges fast where that coordinate differs
/// from those of the wells.
fn two_well_pressure<const D: usize>(source: [f64; D], sink: [f64; D], x: [f64; D]) -> f64 {
    const MODES: usize = 60;
    let last = D - 1;
    let mut sum = 0.5 * ((x[last] - sink[last]).abs() - (x[last] - source[last]).abs());
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
            // Equals cosh(k low) cosh(k (1 - high)) / (k sinh k), without overflow.
            let e = |t: f64| (-k * t).exp();
            0.5 * e(high - low) * (1.0 + e(2.0 * low)) * (1.0 + e(2.0 * (1.0 - high)))
                / (k * (1.0 - e(2.0)))
        };
        sum += weight
            * shape(x)
            * (shape(source) * green(source[last]) - shape(sink) * green(sink[last]));
    }
    sum
}

fn check_well_to_well<const D: usize, M: Simplices<D>>(n: usize) {
    let (mut source, mut sink): ([f64; D], [f64; D]) = (
        truncate_point([0.27, 0.31, 0.0]),
        truncate_point([0.71, 0.64, 0.0]),
    );
    (source[D - 1], sink[D - 1]) = (0.23, 0.28);
    let mesh: M = jittered_box([n; D], [1.0; D], 0.15, |_| true);
    let (k, viscosity, rate) = (2.0, 0.3, 5.0);
    let rock = Rock::uniform(Tensor::isotropic(k), viscosity);
    let flow = flow_through(&mesh, &[], rock, FaultLaw::OPEN);
    let well = |position, rate| PointWell {
        name: "well".into(),
        position,
        rate,
    };
    let wells = flow
        .locate(&[well(source, rate), well(sink, -rate)])
        .unwrap();
    let solution = flow.solve(&flow.rates(&wells), &[]).unwrap();
    assert!(solution.stats.max_imbalance < 1e-10 && solution.stats.total_imbalance < 1e-10);
    let sample_nodes: Vec<usize> = (0..mesh.nodes().len())
        .filter(|&i| mesh.nodes()[i][D - 1] > 0.55)
        .step_by(97)
        .collect();
    assert!(sample_nodes.len() > 10);
    let exact: Vec<f64> = sample_nodes
        .iter()
        .map(|&i| rate * viscosity / k * two_well_pressure(source, sink, mesh.nodes()[i]))
        .collect();
    let mean = |values: &dyn Fn(usize) -> f64| {
        (0..sample_nodes.len()).map(values).sum::<f64>() / sample_nodes.len() as f64
    };
    let shift = mean(&|n| solution.pressure[sample_nodes[n]] - exact[n]);
    let max_exact = exact.iter().fold(0.0, |s: f64, e| s.max(e.abs()));
    for (n, &i) in sample_nodes.iter().enumerate() {
        let error = (solution.pressure[i] - shift - exact[n]).abs();
        assert!(error < 0.005 * max_exact, "{error} of {max_exact}");
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
    let solution = flow.solve(&rates, &[]).unwrap();
    let mut outflow = outflow_by_facets(&flow.split_mesh.mesh, &flow.velocity(&solution.pressure));
    for (face, t) in flow.split_mesh.faces.iter().zip(&flow.transmissibility) {
        for (&a, &b) in face.nodes[0].iter().zip(&face.nodes[1]) {
            let flux =
                t / D as f64 * (solution.pressure[a as usize] - solution.pressure[b as usize]);
            outflow[a as usize] += flux;
            outflow[b as usize] -= flux;
        }
    }
    for (node_outflow, rate) in outflow.iter().zip(&rates) {
        assert!(
            (node_outflow - rate).abs() < 1e-10 * 2.0,
            "{node_outflow} {rate}"
        );
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
            let solution = flow.solve(&flow.rates(&wells), &[]).unwrap();
            iterations.push(solution.stats.iterations);
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
    let infinite_rate = PointWell {
        position: [1.0; 3],
        rate: f64::INFINITY,
        ..well.clone()
    };
    assert!(flow.locate(&[infinite_rate]).is_err());
    // Points on a node, an edge, a face or a corner of the box are inside.
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
    let located = flow
        .locate(&[PointWell {
            position: [1.1; 3],
            ..well
        }])
        .unwrap();
    let error = flow
        .solve(&flow.rates(&located), &[])
        .unwrap_err()
        .to_string();
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
fn two_point_fluxes_between_tetrahedra_are_wrong() {
    use crate::mesh::graph::Graph;
    use crate::model::flow::CellFlow;
    let mesh = jittered_box::<3, TetMesh>([8; 3], [1.0; 3], 0.15, |_| true);
    let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
    let mut graph = Graph::from_tets(&mesh, &[], &[]).unwrap();
    for face in &mut graph.boundary {
        face.side = (face.normal[0].abs() > 0.5).then_some(u8::from(face.normal[0] > 0.0));
    }
    let cells = CellFlow::new(&graph, &rock, FaultLaw::OPEN).unwrap();
    let solution = cells
        .solve(&vec![0.0; mesh.tets.len()], &[(0, 1.0), (1, 0.0)])
        .unwrap();
    let two_point = (solution.stats.throughput - 1.0).abs();
    let flow = flow_through(&mesh, &[], rock, FaultLaw::OPEN);
    let fixed = end_pressures(&flow, 1.0, 1.0, 0.0);
    let solution = flow.solve(&no_rates(&flow), &fixed).unwrap();
    assert!((solution.stats.throughput - 1.0).abs() < 1e-10);
    // The error does not fall with refinement.
    assert!(two_point > 0.05, "{two_point}");
}
