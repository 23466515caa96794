//! Tests decks for history matching: contacts, regions, schedules, aquifers, fault rock.

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{expect_refusal, is_close, numbers, planar_fault, run, run_simulator};
use crate::common::{run_validator, write_npy};

const ROCK: &str = "--porosity 0.25 --permeability 200,200,20 --permeability-unit mD";

/// Writes the schedule: two years of observed rates, then a forecast, ten years in all.
fn write_schedule(folder: &Path) {
    let rows = "date,well,group,type,mode,oil,water,gas,liquid,bhp,skin\n\
        2001-01-01,I1,,water-injector,,,40,,,400,\n\
        2001-01-01,P1,NORTH,producer,history,30,2,0,,,2\n\
        2002-01-01,P1,,,history,25,3,100,,,\n\
        2003-01-01,P1,,,forecast,40,,,60,100,-0.5\n\
        2003-01-01,,NORTH,,,35,,,,,\n\
        2006-07-01,P1,SOUTH,,,,,,,120,\n\
        2011-01-01,,,,,,,,,,\n";
    std::fs::write(folder.join("history.csv"), rows).unwrap();
}

/// Meshes a seismic volume with a fault, 12.5 m x 12.5 m x 6 m per sample, and writes the tables.
fn seismic_model(folder: &Path) {
    run(
        folder,
        "synth amplitude -o amplitude.npy --dims 48,40,36 --count 1 --signal-to-noise 8 --quiet",
    );
    run(
        folder,
        "mesh amplitude.npy --spacing 12.5,12.5,6 --unit m --feature faults --cells voronoi \
         --distance 6 --metric k:200,200,20 --quiet -o cells.vtu",
    );
    write_npy(&folder.join("layers.npy"), [48, 40, 36], |[_, _, z]| {
        if z < 14 { 1.0 } else { 2.0 }
    });
    std::fs::write(folder.join("clay.csv"), "region,clay\n1,0.1\n2,0.5\n").unwrap();
    std::fs::write(folder.join("types.csv"), "region,type\n1,1\n2,2\n").unwrap();
    write_schedule(folder);
}

const STUDY: &str = "--region layers.npy --satnum types.csv --fipnum types.csv --net-to-gross 0.8 \
    --cutoff porosity=0.01 --fluid oil-water-gas --contact gas-oil=2060 --contact oil-water=2140 \
    --capillary-pressure 0.05 --capillary-pressure 2/0.2:1.5 --injector I1=60,60,170:40 \
    --well P1=420,400,80 --schedule history.csv \
    --aquifer zmax:permeability=100,porosity=0.2,thickness=20,radius=300,below=2140";

/// Runs a deck with OPM Flow and returns the balances of its results.
fn simulate(folder: &Path, case: &str) -> serde_json::Value {
    let mut flow = Command::new("flow");
    flow.current_dir(folder);
    flow.args([&format!("{case}.DATA"), "--output-dir=out"]);
    flow.args(["--threads-per-process=1", "--tolerance-mb=1e-8"]);
    flow.args(["--linear-solver=cpr"]);
    run_simulator(&mut flow);
    let arguments = [folder.join("out").into_os_string(), case.into()];
    let arguments = [arguments[0].as_os_str(), OsStr::new(&arguments[1])];
    run_validator("resfo", "history.py", &arguments)
}

#[test]
#[ignore = "needs OPM Flow and resfo: make test-all"]
fn ten_years_of_three_fluids_conserve_mass() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    seismic_model(folder);
    let options = format!("{ROCK} {STUDY} --down z --depth-at-top 2000 --quiet");
    let fault = "--clay clay.csv --throw fault1:20";
    let surfaces = run(folder, "surface cells.vtu -o surfaces.vtp --json");
    assert!(surfaces.contains("\"kind\": \"fault\""), "{surfaces}");
    for (format, file, case) in [
        ("opm", "CASE.DATA", "CASE"),
        ("grdecl", "GRID.GRDECL", "GRID"),
    ] {
        run(
            folder,
            &format!("export cells.vtu --to {format} -o {file} {options} {fault}"),
        );
        let result = simulate(folder, case);
        let number = |name: &str| result[name].as_f64().unwrap();
        println!("{case}: {} {}", result["errors"], result["influx"]);
        assert!(is_close(number("days"), 3652.0, 1e-9));
        for (fluid, error) in result["errors"].as_object().unwrap() {
            assert!(error.as_f64().unwrap() < 1e-6, "{case} {fluid}: {error}");
        }
        let [observed, simulated] = numbers(&result["observed"])[..] else {
            panic!("{result}")
        };
        assert_eq!(observed, 30.0);
        assert!(is_close(simulated, 30.0, 1e-3), "{simulated}");
        let oil = numbers(&result["oil"]);
        assert!(oil[0] > 1e4 && oil[1] > 1e4, "{oil:?}");
        assert!(number("influx") > 0.0);
        let water = numbers(&result["swat"]);
        let tables = numbers(&result["tables"]);
        let cells = numbers(&result["depth"]);
        let gas = numbers(&result["sgas"]);
        let mut transition = 0;
        for ((depth, table), (water, gas)) in cells.iter().zip(&tables).zip(water.iter().zip(&gas))
        {
            let (entry, exponent) = if *table == 1.0 {
                (0.05, 2.0)
            } else {
                (0.2, 1.5)
            };
            // The fluids' densities in the reservoir are 1000 and 850 / 1.1 kg/m^3.
            let capillary = (1000.0 - 850.0 / 1.1) * 9.80665e-5 * (2140.0 - depth);
            let expected = if capillary <= entry {
                1.0
            } else {
                0.2 + 0.8 * (entry / capillary).powf(exponent)
            };
            // The table of the deck is linear between its rows.
            if *depth > 2062.0 {
                let tolerance = if capillary > entry { 0.01 } else { 1e-4 };
                assert!(
                    (water - expected).abs() < tolerance,
                    "{case}: depth {depth}, table {table}: {water}, not {expected}"
                );
                transition += usize::from((0.25..0.95).contains(water));
            } else if *depth < 2050.0 {
                assert!(*gas > 0.5, "{case}: depth {depth}: {gas}");
            }
        }
        assert!(transition > 20, "{transition}");
    }
}

#[test]
fn schedules_regions_and_net_to_gross_are_in_the_deck() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(
        &folder.join("sheet.npy"),
        [28, 24, 20],
        planar_fault([28, 24, 20]),
    );
    run(
        folder,
        "mesh sheet.npy --cells voronoi --distance 6 --quiet -o cells.vtu",
    );
    write_schedule(folder);
    let export = "export cells.vtu --to opm -o CASE.DATA --down z --depth-at-top 1000";
    let wells = "--fluid oil-water-gas --contact oil-water=1012 --contact gas-oil=1004 \
        --injector I1=5,5,12:40 --well P1=22,20,8 --well-radius 0.01 --schedule history.csv";
    run(
        folder,
        &format!("{export} {ROCK} {wells} --net-to-gross 0.5 --satnum 2 --eqlnum 1"),
    );
    let deck = std::fs::read_to_string(folder.join("CASE.DATA")).unwrap();
    for expected in [
        "START\n 1 JAN 2001 /",
        "TABDIMS\n 2 1 50 50 1 /",
        "EQUIL\n 1012 ",
        "WELSPECS\n I1 G ",
        "\n P1 NORTH ",
        "WCONINJE\n I1 WATER OPEN RATE 40 1* 400 /",
        "WCONHIST\n P1 OPEN ORAT 30 2 0 3* 1* /",
        "WCONPROD\n P1 OPEN ORAT 40 1* 1* 60 1* 100 /",
        "GCONPROD\n NORTH ORAT 35 1* 1* 1* RATE /",
        "DATES\n 1 JUL 2006 /",
        "\n P1 SOUTH ",
        "WCONPROD\n P1 OPEN BHP 1* 1* 1* 1* 1* 120 /",
        "SATNUM\n",
        "NTG\n",
    ] {
        assert!(deck.contains(expected), "{expected}\n{deck}");
    }
    assert_eq!(
        deck.matches(" 1 1 0 0 /").count(),
        2,
        "tables of two rock types"
    );
    // The connection factors with the skins 2 and -0.5 have equal differences of resistance.
    let factors = deck
        .lines()
        .filter(|line| line.starts_with(" P1 ") && line.contains("OPEN 1* "));
    let factors: Vec<f64> = factors
        .map(|line| line.split_whitespace().nth(7).unwrap().parse().unwrap())
        .collect();
    let [none, two, half] = factors[..] else {
        panic!("{factors:?}")
    };
    let unit = (1.0 / two - 1.0 / none) / 2.0;
    assert!(is_close(1.0 / half - 1.0 / none, -0.5 * unit, 1e-9));

    let refuse = |line: &str| {
        let line = format!("{export} {ROCK} {line}");
        expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>())
    };
    for (line, expected) in [
        ("--fluid oil-water-gas", "contact"),
        ("--contact oil-water=1012", "--contact"),
        ("--fluid oil-water --contact gas-oil=1004", "gas-oil"),
        ("--well P1=22,20,8", "a schedule"),
        ("--schedule history.csv", "--schedule"),
        (
            "--fluid oil-water --contact oil-water=1012 --no-gravity",
            "gravity",
        ),
        ("--throw 1:20", "--clay"),
        ("--cutoff amplitude=3", "amplitude"),
        ("--satnum 0", "--satnum 0"),
        (
            "--aquifer xmin:volume=1e6,productivity=1,below=9999",
            "--aquifer",
        ),
        ("--fluid oil-water --contact 3/oil-water=1012", "region 3"),
    ] {
        let error = refuse(line);
        assert!(error.contains(expected), "{line}: {error}");
    }
}

#[test]
fn the_check_of_seals_measures_what_passes_a_closed_fault() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let dims = [28, 24, 20];
    write_npy(&folder.join("whole.npy"), dims, planar_fault(dims));
    // The fault ends in the middle of the box.
    write_npy(&folder.join("half.npy"), dims, |[x, y, z]| {
        if y < 12 {
            planar_fault(dims)([x, y, z])
        } else {
            0.0
        }
    });
    let mut shares = Vec::new();
    for name in ["whole", "half"] {
        let mesh = "--feature ridges --cells voronoi --distance 5 --quiet -o";
        run(folder, &format!("mesh {name}.npy {mesh} {name}.vtu"));
        let export = format!(
            "export {name}.vtu --to opm -o CASE.DATA --down z --depth-at-top 1000 {ROCK} --faults closed \
             --injector I1=4,5,9:10 --producer P1=24,5,9:50 --well-radius 0.01"
        );
        let report = run(folder, &format!("{export} --check-seals --json --quiet"));
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        let fault = &report["seals"][0];
        assert_eq!(fault["fault"], "fault1");
        let passing = |fault: &serde_json::Value| {
            fault["through"].as_f64().unwrap() + fault["around"].as_f64().unwrap()
        };
        shares.push(passing(fault));
        if name == "whole" {
            assert_eq!(fault["verdict"], "sealed");
            assert_eq!(fault["leaks"], serde_json::json!([]));
        } else {
            // The side is nearer than four distances between nodes.
            assert_eq!(fault["verdict"], "leaks");
            assert_eq!(fault["leaks"][0]["cause"], "gap to side ymax");
        }
        let parts = report["compartments"].as_array().unwrap();
        let wells: Vec<String> = parts.iter().map(|part| part["wells"].to_string()).collect();
        if name == "whole" {
            assert_eq!(parts.len(), 2);
            assert!(wells.contains(&"[\"I1\"]".into()), "{wells:?}");
        } else {
            assert_eq!(wells, ["[\"I1\",\"P1\"]"]);
            let covered = fault["covered_share"].as_f64().unwrap();
            assert!((0.3..0.7).contains(&covered), "{covered}");
            let extended = format!("{export} --extend-faults 50 --check-seals --json --quiet");
            let report: serde_json::Value = serde_json::from_str(&run(folder, &extended)).unwrap();
            let fault = &report["seals"][0];
            assert_eq!(fault["verdict"], "sealed");
            let share = passing(fault);
            assert!(share < 1e-9, "{share}");
            assert_eq!(fault["covered_share"], 1.0);
            assert_eq!(report["compartments"].as_array().unwrap().len(), 2);
        }
    }
    assert!(shares[0] < 1e-9, "{shares:?}");
    assert!((0.3..0.9).contains(&shares[1]), "{shares:?}");
    let export =
        format!("export whole.vtu --to opm -o CASE.DATA --down z --depth-at-top 1000 {ROCK}");
    let line = format!("{export} --check-seals");
    let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
    assert!(error.contains("--check-seals"), "{error}");
}
