//! Tests wells along trajectories: the cells that they cross, their well indices, and their results
//! in OPM Flow.

use std::f64::consts::{PI, TAU};
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{
    expect_refusal, planar_fault, run_args, run_simulator, run_validator, write_npy,
};
use atomesh::mesh::voronoi::{voronoi, voronoi_plane};
use atomesh::model::flow::{CellFlow, FaultLaw, Rock, Tensor};
use atomesh::model::reservoir::{Completion, Model, Trajectory, WellTracer};
use serde_json::Value;

/// Returns a model of prisms of height 4 on the Voronoi cells of atoms.
fn prisms(atoms: &[[f64; 2]], extent: [f64; 2], k: &[f64]) -> Model {
    let mesh = voronoi_plane(atoms, extent).unwrap().extrude(4.0);
    with_rock(Model::new(mesh, None), k)
}

fn with_rock(mut model: Model, k: &[f64]) -> Model {
    let rock = Rock::uniform(Tensor::from_numbers(k).unwrap(), 1.0);
    model.set_permeability(rock).unwrap();
    model
}

/// Returns the atoms of a square lattice of `n` by `n` cells of width `d`.
fn square(n: usize, d: f64) -> Vec<[f64; 2]> {
    let coordinate = |i: usize| (i as f64 + 0.5) * d;
    (0..n * n)
        .map(|i| [coordinate(i % n), coordinate(i / n)])
        .collect()
}

fn trajectory(points: &[[f64; 3]], radius: f64) -> Trajectory {
    Trajectory {
        name: "W".into(),
        points: points.to_vec(),
        radii: vec![radius; points.len()],
    }
}

/// Returns a vertical well through a model of prisms.
fn vertical_well(x: f64, y: f64) -> Trajectory {
    trajectory(&[[x, y, 0.0], [x, y, 4.0]], 0.1)
}

fn complete(model: &Model, well: &Trajectory) -> Vec<Completion> {
    WellTracer::new(model).complete(well).unwrap()
}

#[test]
fn equivalent_radii_of_squares_and_hexagons_are_those_of_peaceman_and_of_palagi_and_aziz() {
    let d = 10.0;
    let model = prisms(&square(9, d), [9.0 * d; 2], &[2.0]);
    let [c] = complete(&model, &vertical_well(45.0, 45.0))[..] else {
        panic!("one cell")
    };
    assert!((c.equivalent_radius / (d * (-0.5 * PI).exp()) - 1.0).abs() < 1e-9);
    let expected = TAU * 2.0 * 4.0 / (c.equivalent_radius / 0.1).ln();
    assert!((c.length - 4.0).abs() < 1e-9 && (c.index / expected - 1.0).abs() < 1e-9);
    // A well at a point has the same index.
    let tracer = WellTracer::new(&model);
    let cell = tracer.complete_cell("W", c.cell as usize, 0.1).unwrap();
    assert!((cell[0].index / c.index - 1.0).abs() < 1e-9 && cell.len() == 1);

    // The lattice is triangular with distance d: faces of length b = d / sqrt 3, six neighbours.
    let height = d * 0.75f64.sqrt();
    let row = |j: usize| {
        (0..9).map(move |i| {
            [
                d * (i as f64 + 0.25 + 0.5 * (j % 2) as f64),
                height * (j as f64 + 0.5),
            ]
        })
    };
    let atoms: Vec<[f64; 2]> = (0..9).flat_map(row).collect();
    let model = prisms(&atoms, [9.0 * d, 9.0 * height], &[2.0]);
    let middle = atoms[4 * 9 + 4];
    let [c] = complete(&model, &vertical_well(middle[0], middle[1]))[..] else {
        panic!("one cell")
    };
    let expected = d * (-TAU / (6.0 / 3f64.sqrt())).exp();
    assert!((c.equivalent_radius / expected - 1.0).abs() < 1e-9, "{c:?}");
}

#[test]
fn wells_in_anisotropic_rock_have_the_index_of_peaceman_1983() {
    let [d, kx, ky] = [10.0, 9.0, 1.0];
    let model = prisms(&square(9, d), [9.0 * d; 2], &[kx, ky, 0.1]);
    let c = complete(&model, &vertical_well(45.0, 45.0))[0];
    let ratio = (kx / ky).sqrt();
    let radius = 0.28 * d * (1.0 / ratio + ratio).sqrt() / (ratio.sqrt() + 1.0 / ratio.sqrt());
    let expected = TAU * (kx * ky).sqrt() * 4.0 / (radius / 0.1).ln();
    assert!(
        (c.index / expected - 1.0).abs() < 0.05,
        "{} {expected}",
        c.index
    );
    // The index is the same after the axes are exchanged.
    let exchanged = prisms(&square(9, d), [9.0 * d; 2], &[ky, kx, 0.1]);
    let other = complete(&exchanged, &vertical_well(45.0, 45.0))[0];
    assert!((c.index / other.index - 1.0).abs() < 1e-9);
}

/// Returns the pressure at `x` in units of rate / (2 pi k H) for a source at `a` and a sink at `b`
/// in a closed box, computed with their mirror images.
fn closed_box_pressure(x: [f64; 2], a: [f64; 2], b: [f64; 2], extent: [f64; 2]) -> f64 {
    const N: i32 = 60;
    let mut sum = 0.0;
    for m in -N..=N {
        for n in -N..=N {
            for (sx, sy) in [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)] {
                let image = |p: [f64; 2]| {
                    let u = sx * p[0] + 2.0 * f64::from(m) * extent[0] - x[0];
                    let v = sy * p[1] + 2.0 * f64::from(n) * extent[1] - x[1];
                    (u * u + v * v).max(1e-300)
                };
                sum += 0.5 * (image(b).ln() - image(a).ln());
            }
        }
    }
    sum
}

/// Returns the pressure difference between two wells with the rates 1 and -1: the one from the
/// cells and well indices, and the analytic one.
fn well_pressure_difference(
    model: &Model,
    extent: [f64; 2],
    a: [f64; 2],
    b: [f64; 2],
) -> (f64, f64) {
    let (k, height, radius) = (2.0, 4.0, 0.1);
    let rock = Rock::uniform(Tensor::isotropic(k), 1.0);
    let flow = CellFlow::new(&model.graph, &rock, FaultLaw::OPEN).unwrap();
    let mut rates = vec![0.0; model.len()];
    let mut drop = 0.0;
    let wells = [(a, 1.0), (b, -1.0)].map(|(position, rate)| {
        let completions = complete(model, &vertical_well(position[0], position[1]));
        assert_eq!(completions.len(), 1);
        rates[completions[0].cell as usize] += rate;
        drop += 1.0 / completions[0].index;
        completions[0].cell as usize
    });
    let pressure = flow.solve(&rates, &[]).unwrap().pressure;
    let numerical = pressure[wells[0]] - pressure[wells[1]] + drop;
    let at_well_radius = |p: [f64; 2]| [p[0] + radius, p[1]];
    let analytic = closed_box_pressure(at_well_radius(a), a, b, extent)
        - closed_box_pressure(at_well_radius(b), a, b, extent);
    (numerical, analytic / (TAU * k * height))
}

/// Returns pseudo-random numbers from 0 to 1.
fn noise(i: usize) -> f64 {
    let x = (i as f64 * 12.9898).sin() * 43_758.545_3;
    x - x.floor()
}

#[test]
fn pressures_in_wells_match_the_analytic_solution() {
    let (n, d) = (21, 10.0);
    let extent = [n as f64 * d; 2];
    let model = prisms(&square(n, d), extent, &[2.0]);
    let (numerical, expected) =
        well_pressure_difference(&model, extent, [55.0, 65.0], [155.0, 125.0]);
    println!("squares: {numerical} {expected}");
    assert!((numerical / expected - 1.0).abs() < 0.01);

    // Cells are irregular. The wells are at atoms, and then away from them.
    let mut atoms = square(n, d);
    for (i, atom) in atoms.iter_mut().enumerate() {
        *atom = [0, 1].map(|k| atom[k] + 0.6 * d * (noise(2 * i + k) - 0.5));
    }
    let (a, b) = (atoms[6 * n + 5], atoms[12 * n + 15]);
    let model = prisms(&atoms, extent, &[2.0]);
    for offset in [0.0, 1.0, 2.0] {
        let moved = |p: [f64; 2]| [p[0] + offset, p[1] - 0.5 * offset];
        let (numerical, expected) = well_pressure_difference(&model, extent, moved(a), moved(b));
        println!("irregular, {offset} off: {numerical} {expected}");
        assert!(
            (numerical / expected - 1.0).abs() < 0.003,
            "{numerical} {expected}"
        );
    }
    // The well is near a closed side, and on it.
    let model = prisms(&square(n, d), extent, &[2.0]);
    for x in [5.0, 3.0] {
        let (numerical, expected) =
            well_pressure_difference(&model, extent, [x, 105.0], [205.0, 105.0]);
        println!("near the side at {x}: {numerical} {expected}");
        assert!((numerical / expected - 1.0).abs() < 0.005);
    }
    let inside = complete(&model, &vertical_well(105.0, 105.0))[0];
    let on_side = complete(&model, &vertical_well(0.0, 105.0))[0];
    assert!(on_side.index < 0.75 * inside.index && on_side.index > 0.3 * inside.index);
}

#[test]
fn wells_through_irregular_cells_match_the_analytic_pressure() {
    let (n, d, k, radius) = ([15, 15, 4], 10.0, 2.0, 0.1);
    let extent = n.map(|n| n as f64 * d);
    let atoms: Vec<[f64; 3]> = (0..n[0] * n[1] * n[2])
        .map(|i| {
            let index = [i % n[0], i / n[0] % n[1], i / (n[0] * n[1])];
            [0, 1, 2].map(|k| d * (index[k] as f64 + 0.5 + 0.6 * (noise(3 * i + k) - 0.5)))
        })
        .collect();
    let model = with_rock(Model::new(voronoi(&atoms, extent).unwrap(), None), &[k]);
    let rock = Rock::uniform(Tensor::isotropic(k), 1.0);
    let flow = CellFlow::new(&model.graph, &rock, FaultLaw::OPEN).unwrap();
    let height = extent[2];
    let (a, b) = ([42.0, 45.5], [111.0, 98.0]);
    let wells = [(a, 1.0), (b, -1.0)].map(|([x, y], rate)| {
        let well = trajectory(&[[x, y, 0.0], [x, y, height]], radius);
        (complete(&model, &well), rate)
    });
    // Each metre of the well has the same rate.
    let mut rates = vec![0.0; model.len()];
    for (completions, rate) in &wells {
        for c in completions {
            rates[c.cell as usize] += rate * c.length / height;
        }
    }
    let pressure = flow.solve(&rates, &[]).unwrap().pressure;
    let in_wells = wells.map(|(completions, rate)| {
        let in_well = |c: &Completion| {
            let drop = rate * c.length / height / c.index;
            (c.length / height, pressure[c.cell as usize] + drop)
        };
        let pressures: Vec<(f64, f64)> = completions.iter().map(in_well).collect();
        (
            pressures.iter().map(|(share, p)| share * p).sum::<f64>(),
            pressures,
        )
    });
    let numerical = in_wells[0].0 - in_wells[1].0;
    let plane = [extent[0], extent[1]];
    let at_well_radius = |p: [f64; 2]| [p[0] + radius, p[1]];
    let analytic = closed_box_pressure(at_well_radius(a), a, b, plane)
        - closed_box_pressure(at_well_radius(b), a, b, plane);
    let expected = analytic / (TAU * k * height);
    println!("in space: {numerical} {expected}");
    assert!(
        (numerical / expected - 1.0).abs() < 0.006,
        "{numerical} {expected}"
    );
    // The pressure is uniform along the well, except in cells that the well hardly touches.
    for (mean, pressures) in in_wells {
        let deviation: f64 = pressures
            .iter()
            .map(|(share, p)| share * (p - mean).abs())
            .sum();
        println!("along a well: {} of {numerical}", deviation / numerical);
        assert!(
            deviation < 0.02 * numerical,
            "{deviation} {numerical} {pressures:?}"
        );
    }
}

/// Returns Voronoi cells that are cubes of width `d`.
fn cubes(n: usize, d: f64) -> Model {
    let coordinate = |i: usize| (i as f64 + 0.5) * d;
    let atoms: Vec<[f64; 3]> = (0..n * n * n)
        .map(|i| {
            [
                coordinate(i % n),
                coordinate(i / n % n),
                coordinate(i / (n * n)),
            ]
        })
        .collect();
    Model::new(voronoi(&atoms, [n as f64 * d; 3]).unwrap(), None)
}

#[test]
fn each_part_of_a_well_is_in_exactly_one_cell() {
    let model = with_rock(cubes(6, 10.0), &[1.0]);
    let tracer = WellTracer::new(&model);
    // Trajectories are oblique, bent, and in the common faces and edges of cells.
    for points in [
        &[[3.0, 4.0, 1.0], [52.0, 47.0, 58.0]][..],
        &[
            [5.0, 5.0, 60.0],
            [5.0, 5.0, 21.0],
            [33.0, 28.0, 9.0],
            [59.0, 31.0, 8.0],
        ],
        &[[20.0, 15.0, 0.0], [20.0, 15.0, 60.0]],
        &[[20.0, 30.0, 0.0], [20.0, 30.0, 60.0]],
        &[[0.0, 30.0, 60.0], [60.0, 30.0, 60.0]],
    ] {
        let well = trajectory(points, 0.1);
        let completions = tracer.complete(&well).unwrap();
        let length: f64 = completions.iter().map(|c| c.length).sum();
        assert!(
            (length - well.length()).abs() < 1e-6,
            "{points:?}: {length}"
        );
        assert!(completions.iter().all(|c| c.index > 0.0), "{completions:?}");
    }
    // Wells along different axes have the same radii. A well from the surface is open only in the
    // cells.
    let straight = |a, b| tracer.complete(&trajectory(&[a, b], 0.1)).unwrap();
    let vertical = straight([25.0, 25.0, 900.0], [25.0, 25.0, 0.0]);
    let horizontal = straight([0.0, 25.0, 25.0], [60.0, 25.0, 25.0]);
    assert_eq!((vertical.len(), horizontal.len()), (6, 6));
    for c in vertical.iter().chain(&horizontal) {
        assert!((c.equivalent_radius / (10.0 * (-0.5 * PI).exp()) - 1.0).abs() < 1e-6);
    }
    // The index per length of an oblique well is between those of its directions.
    let oblique = straight([5.0, 25.0, 5.0], [55.0, 25.0, 55.0]);
    let sum = |c: &[Completion]| c.iter().map(|c| c.index).sum::<f64>();
    let length: f64 = oblique.iter().map(|c| c.length).sum();
    let ratio = (sum(&oblique) / length) / (sum(&vertical) / 60.0);
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
    for (points, radius, expected) in [
        (
            [[70.0, 5.0, 5.0], [70.0, 5.0, 50.0]],
            0.1,
            "outside the mesh",
        ),
        (
            [[25.0, 25.0, 0.0], [25.0, 25.0, 60.0]],
            3.0,
            "equivalent radius is 2.07",
        ),
    ] {
        let error = tracer
            .complete(&trajectory(&points, radius))
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("W: ") && error.contains(expected),
            "{error}"
        );
    }
    assert!(
        WellTracer::new(&cubes(3, 10.0))
            .complete(&vertical_well(5.0, 5.0))
            .is_err()
    );
}

fn run(folder: &Path, line: &str) -> String {
    run_args(folder, &line.split_whitespace().collect::<Vec<_>>())
}

const ROCK: &str = "--porosity 0.2 --permeability 100 --permeability-unit mD --quiet";

#[test]
#[ignore = "needs OPM Flow and resfo: make test-all"]
fn opm_flow_runs_wells_along_trajectories() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(
        &folder.join("sheet.npy"),
        [40, 36, 32],
        planar_fault([40, 36, 32]),
    );
    run(
        folder,
        "mesh sheet.npy --distance 6 --quiet -o cells.vtu --cells voronoi",
    );
    std::fs::write(
        folder.join("INJ.csv"),
        "x,y,z,radius\n6,6,60,0.1\n7,6,20,0.1\n30,7,10,0.1\n",
    )
    .unwrap();
    std::fs::write(folder.join("PROD.csv"), "33,30,31,0.1\n33,30,0,0.1\n").unwrap();
    let wells = "--injector INJ.csv:5 --producer P=PROD.csv:200 --pressure-at-top 200 --days 3650";
    let stdout = run(
        folder,
        &format!(
            "export cells.vtu --to opm -o CASE.DATA --depth-at-top 2000 --no-gravity --json {ROCK} {wells}"
        ),
    );
    let report: Value = serde_json::from_str(&stdout).unwrap();
    let wells = report["wells"].as_array().unwrap();
    assert_eq!(
        (&wells[0]["name"], &wells[1]["name"]),
        (&"INJ".into(), &"P".into())
    );
    let sum = |well: &Value| -> f64 {
        let lengths = well["lengths"].as_array().unwrap().iter();
        lengths.map(|l| l.as_f64().unwrap()).sum()
    };
    // The well enters the box at z = 31.
    let length_in_box = 11.0 / 40.0 * 1601f64.sqrt() + (23.0f64.powi(2) + 101.0).sqrt();
    assert!((sum(&wells[0]) - length_in_box).abs() < 1e-6 && (sum(&wells[1]) - 31.0).abs() < 1e-6);
    assert!(wells[0]["cells"].as_array().unwrap().len() > 4);

    // In a steady state the injected rate is produced, at the pressures that the well indices
    // imply.
    let mut command = Command::new("flow");
    command
        .current_dir(folder)
        .args(["CASE.DATA", "--output-dir=out", "--threads-per-process=1"]);
    run_simulator(&mut command);
    let out = folder.join("out");
    let result = run_validator("resfo", "opm.py", &[out.as_os_str(), OsStr::new("CASE")]);
    let pressure: Vec<f64> = (result["pressure"].as_array().unwrap().iter())
        .map(|p| p.as_f64().unwrap())
        .collect();
    let factor = atomesh::export::simulators::opm::TRANSMISSIBILITY_UNIT;
    let produced: f64 = (wells[1]["cells"].as_array().unwrap().iter())
        .map(|c| {
            let cell = c[0].as_u64().unwrap() as usize;
            factor * c[1].as_f64().unwrap() * (pressure[cell] - 200.0)
        })
        .sum();
    // OPM Flow stores pressures in single precision.
    println!("{produced} m^3 a day");
    assert!((produced / 5.0 - 1.0).abs() < 5e-3, "{produced}");
}

#[test]
fn impossible_wells_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(
        &folder.join("sheet.npy"),
        [40, 36, 32],
        planar_fault([40, 36, 32]),
    );
    run(
        folder,
        "mesh sheet.npy --distance 8 --quiet -o cells.vtu --cells voronoi",
    );
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write("good.csv", "6,6,3,0.1\n7,6,20,0.1\n");
    write("outside.csv", "6,6,50,0.1\n7,6,60,0.1\n");
    write("bare.csv", "6,6\n7,6\n");
    write("wide.csv", "6,6,3,5\n7,6,20,5\n");
    write("bad.csv", "x,y,z,radius\n6,6,3,0.1\n6,six,3,0.1\n");
    for (well, expected) in [
        ("outside.csv:5", "outside the mesh"),
        ("bare.csv:5", "bare.csv: has 2 columns without names"),
        ("wide.csv:5", "radius of 5 m"),
        ("bad.csv:5", "bad.csv:3: "),
        ("none.csv:5", "none.csv"),
        ("good.csv", "has no ':'"),
        ("A=good.csv:5 --injector A=good.csv:5", "another well"),
    ] {
        let line = format!(
            "export cells.vtu --to opm -o A.DATA --depth-at-top 100 {} --injector {well}",
            ROCK.replace(" --quiet", "")
        );
        let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
        assert!(error.contains(expected), "{line}\n{error}");
    }
}

/// A well that enters the box from above. Its coordinates are those of the image, samples.
const WELL: &str = "x,y,z,radius\n10,12,60,0.1\n10,12,20,0.1\n12,30,10,0.1\n";

/// Returns the distance of a point from this well.
fn distance_from_well(x: &[f64; 3]) -> f64 {
    let distance_from_segment = |a: [f64; 3], b: [f64; 3]| {
        let d = [0, 1, 2].map(|k| b[k] - a[k]);
        let offset = [0, 1, 2].map(|k| x[k] - a[k]);
        let dot = |u: [f64; 3], v: [f64; 3]| (0..3).map(|k| u[k] * v[k]).sum::<f64>();
        let share = (dot(offset, d) / dot(d, d)).clamp(0.0, 1.0);
        (0..3)
            .map(|k| (offset[k] - share * d[k]).powi(2))
            .sum::<f64>()
            .sqrt()
    };
    distance_from_segment([10.0, 12.0, 39.0], [10.0, 12.0, 20.0]).min(distance_from_segment(
        [10.0, 12.0, 20.0],
        [12.0, 30.0, 10.0],
    ))
}

#[test]
fn meshes_have_atoms_along_wells_and_smaller_cells_near_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(
        &folder.join("sheet.npy"),
        [48, 44, 40],
        planar_fault([48, 44, 40]),
    );
    std::fs::write(folder.join("W.csv"), WELL).unwrap();
    let length = 19.0 + (4.0f64 + 324.0 + 100.0).sqrt();
    for (cells, d) in [
        ("tets", 7.0),
        ("voronoi", 7.0),
        ("tets", 3.0),
        ("voronoi", 3.0),
    ] {
        let mesh =
            format!("mesh sheet.npy --distance 7 --cells {cells} --well W.csv -o m.vtu --quiet");
        let finer = if d < 7.0 { "--well-distance 3" } else { "" };
        run(folder, &format!("{mesh} {finer}"));
        run(folder, "validate m.vtu --quiet");
        let atoms = match atomesh::store::read_any_vtu(&folder.join("m.vtu")).unwrap() {
            atomesh::store::AnyMesh::Tetrahedra(file) => file.mesh.nodes,
            atomesh::store::AnyMesh::Polyhedra(file) => file.mesh.sites,
            _ => panic!("not in space"),
        };
        let on_well = atoms
            .iter()
            .filter(|x| distance_from_well(x) < 1e-3)
            .count() as f64;
        assert!((on_well - length / d).abs() < 2.1, "{cells} {d}: {on_well}");
        // Cells are smaller near the well.
        let near_well = atoms.iter().filter(|x| distance_from_well(x) < 7.0).count();
        let total = atoms.len();
        println!("{cells} {d}: {on_well} on the well, {near_well} near it, {total} in all");
        if d < 7.0 {
            assert!(near_well > 150, "{near_well}");
        }
    }
    // An export completes wells in the cells of a width of 3 at their atoms.
    let wells = "--injector W.csv:5 --depth-at-top 100 --json";
    let stdout = run(
        folder,
        &format!("export m.vtu --to opm -o A.DATA {ROCK} {wells}"),
    );
    let report: Value = serde_json::from_str(&stdout).unwrap();
    let cells = report["wells"][0]["cells"].as_array().unwrap().len();
    assert!((12..22).contains(&cells), "{cells}");
}

#[test]
fn wells_in_the_plane_are_points_or_polylines() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    crate::common::write_npy_2d(&folder.join("line.npy"), [60, 50], |[x, y]| {
        (-0.5 * ((0.6 * x as f32 - 0.8 * y as f32 + 3.0) / 1.5).powi(2)).exp()
    });
    std::fs::write(folder.join("P.csv"), "20,33,0.1\n").unwrap();
    std::fs::write(folder.join("Q.csv"), "40,5,0.1\n50,30,0.1\n").unwrap();
    for cells in ["triangles", "voronoi"] {
        let mesh = format!("mesh line.npy --distance 6 --cells {cells} -o p.vtu --quiet");
        run(
            folder,
            &format!("{mesh} --well P.csv --well Q.csv --well-distance 2"),
        );
        run(folder, "validate p.vtu --quiet");
        let atoms = match atomesh::store::read_any_vtu(&folder.join("p.vtu")).unwrap() {
            atomesh::store::AnyMesh::Triangles(file) => file.mesh.nodes,
            atomesh::store::AnyMesh::Polygons(file) => file.mesh.sites,
            _ => panic!("not in the plane"),
        };
        let has_atom = |x: f64, y: f64| atoms.iter().any(|a| (a[0] - x).hypot(a[1] - y) < 1e-3);
        assert!(
            has_atom(20.0, 33.0) && has_atom(40.0, 5.0) && has_atom(50.0, 30.0),
            "{cells}"
        );
    }
}

#[test]
fn impossible_wells_of_meshes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let dims = [48, 44, 40];
    write_npy(&folder.join("sheet.npy"), dims, planar_fault(dims));
    std::fs::write(folder.join("W.csv"), WELL).unwrap();
    std::fs::write(folder.join("P.csv"), "20,33,0.1\n").unwrap();
    std::fs::write(folder.join("far.csv"), "100,5,5,0.1\n100,5,9,0.1\n").unwrap();
    std::fs::write(folder.join("wide.csv"), "10,12,5,2\n10,12,30,2\n").unwrap();
    std::fs::write(folder.join("near.csv"), "11,12,35,0.1\n11,12,30,0.1\n").unwrap();
    for (options, expected) in [
        ("--well far.csv", "far.csv: lies outside the image"),
        ("--well wide.csv", "wide.csv: has a radius of 2"),
        (
            "--well W.csv --well near.csv",
            "wells W.csv and near.csv: are nearer",
        ),
        ("--well P.csv", "P.csv: has 1 points"),
        ("--well-distance 3", "without a well"),
        ("--well W.csv --well-distance 9", "9 is not above 0"),
        ("--well none.csv", "none.csv"),
    ] {
        let line = format!("mesh sheet.npy --distance 7 -o n.vtu {options}");
        let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
        assert!(error.contains(expected), "{line}\n{error}");
    }
}
