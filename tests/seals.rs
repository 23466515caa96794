//! Tests of `export --check-seals` on meshes of given faults with known holes, gaps and free ends, and of
//! faults that `mesh` continues to what they end near.

use std::ffi::OsStr;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::common::{numbers, run, run_simulator, run_validator, write_npy};

const DIMS: [usize; 3] = [64, 44, 30];
/// Distance between nodes, in samples.
const DISTANCE: f64 = 5.0;
const ROCK: &str = "--porosity 0.2 --permeability 100 --permeability-unit mD";

#[derive(Debug, Clone, Copy, PartialEq)]
enum Defect {
    None,
    FreeTip,
    /// A round hole of this diameter.
    Hole(f64),
    /// The fault ends so far from the side ymax.
    GapToSide(f64),
    /// The fault ends so far from another fault.
    GapToFault(f64),
}

/// A plane that dips along x and turns along y, in samples.
struct Plane {
    dip: f64,
    turn: f64,
}

/// Position along y of the other fault.
const WALL: f64 = 31.3;

impl Plane {
    fn point(&self, y: f64, z: f64) -> [f64; 3] {
        let x = 31.7 + self.turn * (y - 22.0) + (z - 15.0) / self.dip.to_radians().tan();
        [x, y, z]
    }

    /// Returns the middle of what is missing.
    fn centre(&self, defect: Defect) -> [f64; 3] {
        match defect {
            Defect::GapToSide(width) => self.point(43.0 - 0.5 * width, 14.5),
            Defect::GapToFault(width) => self.point(WALL - 0.5 * width, 14.5),
            _ => self.point(21.0, 15.0),
        }
    }

    fn has(&self, defect: Defect, y: f64, z: f64) -> bool {
        let x = self.point(y, z);
        let centre = self.centre(defect);
        let distance: f64 = (0..3)
            .map(|k| (x[k] - centre[k]).powi(2))
            .sum::<f64>()
            .sqrt();
        match defect {
            Defect::None => true,
            Defect::FreeTip => y < 14.0,
            Defect::Hole(width) => distance > 0.5 * width,
            Defect::GapToSide(width) => y < 43.0 - width,
            Defect::GapToFault(width) => y < WALL - width,
        }
    }
}

/// Writes the part of a surface x(y, z) (y(x, z) if `is_wall`) for which `has` is true.
fn write_surface(
    path: &Path,
    name: &str,
    point: impl Fn(f64, f64) -> [f64; 3],
    has: impl Fn(f64, f64) -> bool,
) {
    let step = 0.5;
    let (rows, columns) = (128, 160);
    let place = |i: usize| -2.0 + step * i as f64;
    let mut text = format!("GOCAD TSurf 1\nHEADER {{\nname:{name}\n}}\nTFACE\n");
    for row in 0..=rows {
        for column in 0..=columns {
            let [x, y, z] = point(place(column), place(row));
            writeln!(
                text,
                "VRTX {} {x} {y} {z}",
                row * (columns + 1) + column + 1
            )
            .unwrap();
        }
    }
    for row in 0..rows {
        for column in 0..columns {
            if has(place(column) + 0.5 * step, place(row) + 0.5 * step) {
                let a = row * (columns + 1) + column + 1;
                let [b, c, d] = [a + 1, a + columns + 2, a + columns + 1];
                writeln!(text, "TRGL {a} {b} {c}\nTRGL {a} {c} {d}").unwrap();
            }
        }
    }
    std::fs::write(path, text + "END\n").unwrap();
}

/// Makes the mesh of a fault with a defect.
fn make_mesh(folder: &Path, plane: &Plane, defect: Defect, cells: &str, options: &str) -> String {
    write_surface(
        &folder.join("main.ts"),
        "main",
        |y, z| plane.point(y, z),
        |y, z| plane.has(defect, y, z),
    );
    let mut surfaces = "--surface main.ts:main,fault".to_string();
    if matches!(defect, Defect::GapToFault(_)) {
        let wall = |x: f64, z: f64| [x, WALL, z];
        write_surface(&folder.join("wall.ts"), "wall", wall, |_, _| true);
        surfaces += " --surface wall.ts:wall,fault";
    }
    write_npy(&folder.join("image.npy"), DIMS, |_| 0.0);
    run(
        folder,
        &format!(
            "mesh image.npy -o mesh.vtu {surfaces} --feature none --distance {DISTANCE} --cells {cells} {options} --json"
        ),
    )
}

/// Returns the JSON of an export that checks seals.
fn check(folder: &Path, format: &str, options: &str) -> Value {
    let name = if format == "grdecl" {
        "CASE.GRDECL"
    } else {
        "CASE.DATA"
    };
    let export = format!("export mesh.vtu --to {format} -o {name} --down z --depth-at-top 1000");
    let line = format!("{export} {ROCK} --faults closed --check-seals {options} --json --quiet");
    serde_json::from_str(&run(folder, &line)).unwrap()
}

fn fault<'a>(report: &'a Value, name: &str) -> &'a Value {
    let faults = report["seals"].as_array().unwrap();
    faults.iter().find(|fault| fault["fault"] == name).unwrap()
}

/// Returns what is wrong with the check of a mesh, if anything is.
fn problem(folder: &Path, plane: &Plane, defect: Defect, format: &str) -> Option<String> {
    let report = check(folder, format, "");
    let main = fault(&report, "main");
    let wrong = |what: &str| Some(format!("{defect:?} {} {format}: {what}: {main}", plane.dip));
    let is_leaky = !matches!(defect, Defect::None | Defect::FreeTip);
    if (main["verdict"] == "leaks") != is_leaky {
        return wrong("verdict");
    }
    if matches!(defect, Defect::GapToFault(_)) && fault(&report, "wall")["verdict"] != "sealed" {
        return wrong("verdict of the other fault");
    }
    if (defect == Defect::FreeTip) != (main["around"].as_f64().unwrap() > 0.02)
        && !matches!(defect, Defect::GapToFault(_))
    {
        return wrong("flow around it");
    }
    if !is_leaky {
        return None;
    }
    let leak = &main["leaks"][0];
    let cause = match defect {
        Defect::Hole(_) => "hole in its faces",
        Defect::GapToSide(_) => "gap to side ymax",
        _ => "gap to wall",
    };
    if leak["cause"] != cause {
        return wrong("cause");
    }
    let at: Vec<f64> = (0..3).map(|k| leak["at"][k].as_f64().unwrap()).collect();
    let centre = plane.centre(defect);
    let distance: f64 = (0..3)
        .map(|k| (at[k] - centre[k]).powi(2))
        .sum::<f64>()
        .sqrt();
    if distance > DISTANCE {
        return wrong(&format!("place, {distance} from {centre:?}"));
    }
    // The remedy closes the leak.
    if format != "grdecl" {
        let remedies = main["leaks"].as_array().unwrap().iter();
        let remedy = remedies.map(|leak| {
            let text = leak["remedy"].as_str().unwrap();
            let distance = text.strip_prefix("--extend-faults ").unwrap();
            distance.parse::<f64>().unwrap()
        });
        let distance = remedy.fold(0.0, f64::max);
        let closed = check(folder, format, &format!("--extend-faults {distance}"));
        let faults = closed["seals"].as_array().unwrap();
        if faults.iter().any(|fault| fault["verdict"] != "sealed") {
            return wrong(&format!("remedy: {faults:?}"));
        }
    }
    None
}

fn problems(cases: &[(f64, f64, Defect)], cells: &[(&str, &[&str])]) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut problems = Vec::new();
    for &(dip, turn, defect) in cases {
        let plane = Plane { dip, turn };
        for &(cells, formats) in cells {
            make_mesh(folder, &plane, defect, cells, "--extend-faults 0 --quiet");
            for format in formats {
                let found = problem(folder, &plane, defect, format);
                problems.extend(found.map(|text| format!("{cells} {text}")));
            }
        }
    }
    problems
}

#[test]
fn holes_and_gaps_have_places_and_remedies() {
    let cases = [
        (70.0, 0.1, Defect::None),
        (60.0, 0.2, Defect::Hole(12.0)),
        (80.0, -0.1, Defect::GapToSide(8.0)),
    ];
    let cells: [(&str, &[&str]); 2] = [("tets", &["opm"]), ("voronoi", &["opm", "grdecl"])];
    let problems = problems(&cases, &cells);
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
#[ignore = "slow: make test-all"]
fn the_certificate_is_right_on_all_kinds_of_cells() {
    let mut cases = Vec::new();
    for (index, dip) in [90.0, 77.0, 63.0, 52.0, 40.0].into_iter().enumerate() {
        let turn = [0.0, 0.1, -0.15, 0.05, 0.2][index];
        let width: f64 = [5.0, 7.5, 10.0, 12.5, 15.0][index];
        cases.extend([
            (dip, turn, Defect::None),
            (dip, turn, Defect::FreeTip),
            // The mesher closes holes of two distances between nodes.
            (dip, turn, Defect::Hole(width.max(12.5))),
            (dip, turn, Defect::GapToSide(width)),
            (dip, turn, Defect::GapToFault(width)),
        ]);
    }
    let cells: [(&str, &[&str]); 2] = [("tets", &["opm"]), ("voronoi", &["opm", "grdecl"])];
    let problems = problems(&cases, &cells);
    assert!(
        problems.is_empty(),
        "{} of 75 wrong\n{}",
        problems.len(),
        problems.join("\n")
    );
}

#[test]
fn the_table_of_leaks_has_a_line_for_each() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let plane = Plane {
        dip: 75.0,
        turn: 0.0,
    };
    let defect = Defect::GapToSide(8.0);
    make_mesh(
        folder,
        &plane,
        defect,
        "voronoi",
        "--extend-faults 0 --quiet",
    );
    let report = check(folder, "opm", "--seal-table leaks.csv");
    let table = std::fs::read_to_string(folder.join("leaks.csv")).unwrap();
    let lines: Vec<&str> = table.lines().collect();
    let leaks = fault(&report, "main")["leaks"].as_array().unwrap().len();
    assert_eq!(lines.len(), 1 + leaks, "{table}");
    assert!(
        lines[0].starts_with("fault,verdict,through,around,"),
        "{table}"
    );
    assert!(
        lines[1].starts_with("main,leaks,") && lines[1].contains("gap to side ymax"),
        "{table}"
    );
}

#[test]
fn a_fault_that_ends_near_a_side_or_a_fault_is_continued_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let plane = Plane {
        dip: 70.0,
        turn: 0.1,
    };
    let cases = [
        (Defect::GapToSide(1.0), "side ymax"),
        (Defect::GapToSide(4.0), "side ymax"),
        (Defect::GapToFault(3.0), "wall"),
    ];
    for (defect, target) in cases {
        for cells in ["tets", "voronoi"] {
            let report = make_mesh(folder, &plane, defect, cells, "");
            let report: Value = serde_json::from_str(&report).unwrap();
            let notes = report["notes"].to_string();
            assert!(
                notes.contains("surface main ends up to") && notes.contains(target),
                "{cells} {defect:?} {notes}"
            );
            let seals = check(folder, "opm", "");
            let main = fault(&seals, "main");
            assert_eq!(main["verdict"], "sealed", "{cells} {defect:?} {main}");
            let count = seals["compartments"].as_array().unwrap().len();
            let expected = if target == "wall" { 3 } else { 2 };
            assert_eq!(count, expected, "{cells} {defect:?} {main}");
        }
    }
    // As it is, and where nothing is near.
    for (defect, options) in [
        (Defect::GapToSide(4.0), "--extend-faults 0"),
        (Defect::GapToSide(12.0), ""),
    ] {
        let report = make_mesh(folder, &plane, defect, "voronoi", options);
        let report: Value = serde_json::from_str(&report).unwrap();
        let notes = report["notes"].to_string();
        assert!(!notes.contains("is continued to"), "{notes}");
        assert_eq!(fault(&check(folder, "opm", ""), "main")["verdict"], "leaks");
    }
}

/// Depth of burial of the beds' clay fraction, before the fault moved.
fn clay(depth: f64) -> f64 {
    0.3 + 0.25 * (std::f64::consts::TAU * depth / 30.0).sin()
}

/// Returns the transmissibility in m^3 of a fault between depths 0 and `height` and `0..length` along y: the law of
/// Manzocchi and others integrated over it.
fn integrated_transmissibility(plane: &Plane, throw: f64, [length, height]: [f64; 2]) -> f64 {
    let mean_clay = |low: f64, high: f64| {
        let n = 400;
        let depths = (0..n).map(|i| low + (high - low) * (f64::from(i) + 0.5) / f64::from(n));
        depths.map(clay).sum::<f64>() / f64::from(n)
    };
    let steps = 4000;
    let dz = height / f64::from(steps);
    let slope = 1.0 / plane.dip.to_radians().tan();
    let area_per_height = length * (1.0 + slope.powi(2) + plane.turn.powi(2)).sqrt();
    let mut sum = 0.0;
    for i in 0..steps {
        let z = dz * (f64::from(i) + 0.5);
        // The rock that slipped past is in the hanging wall from z to z + throw, moved down by the throw, and in the
        // footwall from z - throw to z. In the mesh are depths from 0 to `height`.
        let [hanging, foot] = [(height - z).min(throw), z.min(throw)];
        let ratio = (hanging * mean_clay(z - throw, z - throw + hanging)
            + foot * mean_clay(z - foot, z))
            / (hanging + foot);
        let log_k = -4.0 * ratio - 0.25 * throw.log10() * (1.0 - ratio).powi(5);
        sum += 9.869_233e-16 * 10f64.powf(log_k) * dz;
    }
    sum * area_per_height / (throw / 66.0)
}

#[test]
fn the_transmissibility_of_a_fault_is_the_law_integrated_over_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (dims, throw) = ([72, 61, 61], 20.0);
    let plane = Plane {
        dip: 70.0,
        turn: 0.05,
    };
    let point = |y: f64, z: f64| plane.point(y, z);
    write_surface(&folder.join("main.ts"), "main", point, |_, _| true);
    write_npy(&folder.join("image.npy"), dims, |_| 0.0);
    write_npy(&folder.join("clay.npy"), dims, |x| {
        let [x, y, z] = x.map(|c| c as f64);
        let is_hanging = x > plane.point(y, z)[0];
        clay(if is_hanging { z - throw } else { z }) as f32
    });
    let exact = integrated_transmissibility(&plane, throw, [60.0, 60.0]);
    let mut wrong = Vec::new();
    for cells in ["voronoi", "tets"] {
        for distance in [6, 12] {
            run(
                folder,
                &format!(
                    "mesh image.npy -o mesh.vtu --surface main.ts:main,fault --feature none \
                     --distance {distance} --cells {cells} --quiet"
                ),
            );
            run(
                folder,
                "export mesh.vtu --to opm -o CASE.DATA --down z --depth-at-top 1000 --porosity 0.2 \
                 --permeability 1e7 --permeability-unit mD --faults closed --throw main:20 \
                 --clay clay.npy --juxtaposition allan.csv --quiet",
            );
            let table = std::fs::read_to_string(folder.join("allan.csv")).unwrap();
            let rows = table.lines().skip(1);
            let rows: Vec<&str> = rows.filter(|row| row.starts_with("main,")).collect();
            let values = rows.iter().map(|row| row.rsplit_once(',').unwrap().1);
            let sum: f64 = values.map(|t| t.parse::<f64>().unwrap()).sum();
            if (sum / exact - 1.0).abs() > 0.02 {
                wrong.push(format!("{cells} {distance}: {}", sum / exact));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
#[ignore = "needs OPM Flow, resfo and SciPy: make test-all"]
fn opm_flow_has_two_compartments_if_a_fault_is_sealed_and_one_if_it_leaks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let plane = Plane {
        dip: 65.0,
        turn: 0.1,
    };
    let defects = [
        Defect::None,
        Defect::FreeTip,
        Defect::Hole(12.0),
        Defect::GapToSide(8.0),
    ];
    for defect in defects {
        for cells in ["tets", "voronoi"] {
            make_mesh(folder, &plane, defect, cells, "--extend-faults 0 --quiet");
            for format in ["opm", "grdecl"] {
                if (cells, format) == ("tets", "grdecl") {
                    continue;
                }
                let report = check(folder, format, "");
                let main = fault(&report, "main");
                let is_closed = main["verdict"] == "sealed" && main["around"] == 0.0;
                let mut flow = Command::new("flow");
                flow.current_dir(folder).args([
                    "CASE.DATA",
                    "--output-dir=out",
                    "--threads-per-process=1",
                ]);
                run_simulator(&mut flow);
                let out = folder.join("out");
                let arguments = [out.as_os_str(), OsStr::new("CASE")];
                let result = run_validator("resfo and SciPy", "compartments.py", &arguments);
                let volumes = numbers(&result["porv"]);
                let total: f64 = volumes.iter().sum();
                let count = volumes.iter().filter(|v| **v > 0.01 * total).count();
                let expected = if is_closed { 2 } else { 1 };
                assert_eq!(count, expected, "{cells} {format} {defect:?}: {main}");
            }
        }
    }
}
