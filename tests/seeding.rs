//! Other ways to place atoms and to move them, as a user would ask for them.

use std::path::Path;

use crate::common::{write_npy_2d, expect_refusal, run_args};
use serde_json::Value;

fn json(folder: &Path, arguments: &[&str]) -> Value {
    let said = run_args(folder, &[arguments, &["--json", "--quiet"]].concat());
    serde_json::from_str(&said).unwrap()
}

/// A folder with a time slice and a volume of faults, `plane.npy` and `space.npy`.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, dims) in [("plane.npy", "128,112"), ("space.npy", "48,44,40")] {
        let synth = [
            "synth",
            "faults",
            "-o",
            name,
            "--dims",
            dims,
            "--signal-to-noise",
            "10",
        ];
        run_args(folder.path(), &synth);
    }
    folder
}

/// Meshes and has the mesh checked; gives the report.
fn valid(at: &Path, image: &str, more: &[&str]) -> Value {
    let mesh = ["mesh", image, "-o", "mesh.vtu", "--distance", "6"];
    let report = json(at, &[&mesh[..], more].concat());
    assert_eq!(
        json(at, &["validate", "mesh.vtu"])["valid"],
        true,
        "{more:?}"
    );
    report
}

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn every_seeding_makes_a_valid_mesh_that_follows_the_faults() {
    let folder = folder();
    let at = folder.path();
    for image in ["plane.npy", "space.npy"] {
        let coverage = |report: &Value| number(&report["fidelity"]["tagged_faces"]["coverage_one"]);
        let regular = valid(at, image, &[]);
        let atoms = number(&regular["lattice"]["atoms"]);
        for seeding in ["guide", "projection"] {
            let report = valid(at, image, &["--seeding", seeding]);
            assert!(report["box"]["problems"].as_array().unwrap().is_empty());
            let share = number(&report["lattice"]["atoms"]) / atoms;
            println!(
                "{image}, {seeding}: {share:.2} times as many atoms, coverage {:.3} for {:.3}",
                coverage(&report),
                coverage(&regular)
            );
            assert!((0.75..1.25).contains(&share), "{share}");
            assert!(coverage(&report) > coverage(&regular) - 0.05);
        }
    }
}

#[test]
fn every_optimizer_makes_a_valid_mesh_and_comes_near_the_least_energy() {
    let folder = folder();
    let at = folder.path();
    for image in ["plane.npy", "space.npy"] {
        let energy = |more: &[&str]| {
            let guide = ["--seeding", "guide", "--slivers", "none"];
            let report = valid(at, image, &[&guide[..], more].concat());
            number(&report["lattice"]["optimisation"]["minimised"])
        };
        let lbfgs = energy(&[]);
        let [descent, genetic] = ["descent", "genetic"].map(|o| energy(&["--optimizer", o]));
        println!("{image}: lbfgs {lbfgs:.4}, descent {descent:.4}, genetic {genetic:.4}");
        // L-BFGS finds the least; the others, measured, 95.7 to 98.1 % of it.
        assert!(lbfgs < -0.14 && lbfgs < genetic.min(descent));
        assert!(genetic.max(descent) < 0.95 * lbfgs);
        for optimizer in ["lbfgs", "descent", "genetic"] {
            valid(at, image, &["--kappa", "0.7", "--optimizer", optimizer]);
        }
    }
}

#[test]
#[ignore = "slow: make test-all"]
fn a_trace_has_a_frame_for_each_generation_with_energy_and_quality() {
    let folder = folder();
    let at = folder.path();
    for image in ["plane.npy", "space.npy"] {
        let more = "--seeding guide --optimizer genetic --slivers none --trace t.pvd";
        let more: Vec<&str> = more.split(' ').collect();
        let report = valid(at, image, &more);
        let trace = report["trace"].as_array().unwrap();
        let pvd = std::fs::read_to_string(at.join("t.pvd")).unwrap();
        assert_eq!(pvd.matches("<DataSet").count(), trace.len());
        // Nine evaluations a generation, one of the lattice as it was seeded, one of it perturbed.
        let optimisation = &report["lattice"]["optimisation"];
        let evaluations = optimisation["evaluations"].as_u64().unwrap() as usize;
        assert_eq!(evaluations, 2 + 9 * (trace.len() - 1));
        assert!(trace.len() > 20, "{}", trace.len());
        // What is said of the last is said of the mesh, too.
        let (first, last) = (&trace[0], trace.last().unwrap());
        let atoms = report["lattice"]["atoms"].as_u64().unwrap() as f64;
        let energy = number(&last["energy"]) / atoms;
        assert!((energy - number(&optimisation["energy"])).abs() < 1e-6);
        let (mean, mesh) = (number(&last["mean_quality"]), &report["quality"]);
        assert!(
            (mean - number(&mesh["mean_ratio_mean"])).abs() < 1e-3,
            "{mean} {mesh}"
        );
        // As in the paper's table 3.
        assert!(number(&last["energy"]) < number(&first["energy"]));
        assert!(mean > number(&first["mean_quality"]));
    }
}

#[test]
fn rounds_end_when_one_gains_nothing() {
    let folder = folder();
    let at = folder.path();
    let optimised = |rounds: &[&str]| {
        let report = valid(
            at,
            "plane.npy",
            &[&["--seeding", "guide"][..], rounds].concat(),
        );
        report["lattice"]["optimisation"].clone()
    };
    let (one, many) = (optimised(&[]), optimised(&["--rounds", "50"]));
    assert_eq!(one, optimised(&["--rounds", "1"]));
    let evaluations = |of: &Value| of["evaluations"].as_u64().unwrap();
    assert!(number(&many["minimised"]) < number(&one["minimised"]));
    assert!(evaluations(&many) > evaluations(&one));
    assert!(
        evaluations(&many) < 50 * 40 && many["stop"] == "converged",
        "{many}"
    );
}

#[test]
fn variable_distance_wells_and_few_atoms() {
    let folder = folder();
    let at = folder.path();
    std::fs::write(at.join("wells.csv"), "40.5,31\n90,70.25\n").unwrap();
    for seeding in ["guide", "projection"] {
        let mesh = ["mesh", "plane.npy", "-o", "mesh.vtu", "--distance", "4:9"];
        let more = [
            "--distance-from",
            "features",
            "--atoms-from",
            "wells.csv",
            "--kappa",
            "0.7",
        ];
        let report = json(at, &[&mesh[..], &more, &["--seeding", seeding]].concat());
        assert!(report["box"]["problems"].as_array().unwrap().is_empty());
        assert_eq!(json(at, &["validate", "mesh.vtu"])["valid"], true);
    }
    let few = [
        "--seeding",
        "guide",
        "--max-atoms",
        "150",
        "--slivers",
        "none",
    ];
    assert_eq!(
        number(&valid(at, "plane.npy", &few)["lattice"]["atoms"]),
        150.0
    );
}

#[test]
fn voronoi_cells_of_drawn_atoms() {
    let folder = folder();
    let at = folder.path();
    for image in ["plane.npy", "space.npy"] {
        for optimizer in ["lbfgs", "genetic"] {
            let more = [
                "--cells",
                "voronoi",
                "--seeding",
                "guide",
                "--optimizer",
                optimizer,
            ];
            let report = valid(at, image, &more);
            assert!(number(&report["voronoi"]["check"]["volume_error"]) < 1e-12);
        }
    }
}

#[test]
fn the_same_bytes_for_any_number_of_threads_and_from_a_configuration() {
    let folder = folder();
    let at = folder.path();
    let options =
        "--distance 6 --seeding guide --optimizer genetic --kappa 0.7 --rng-seed 3 --max-atoms 400";
    let options: Vec<&str> = options.split(' ').collect();
    let mesh = |more: &[&str]| {
        let arguments = ["mesh", "plane.npy", "-o", "mesh.vtu", "--quiet"];
        run_args(at, &[&arguments[..], more].concat());
        std::fs::read(at.join("mesh.vtu")).unwrap()
    };
    let one = mesh(&[&options[..], &["--threads", "1"]].concat());
    assert!(one == mesh(&[&options[..], &["--threads", "3"]].concat()));
    let print = [&["mesh", "plane.npy", "--print-config"], &options[..]].concat();
    let config = run_args(at, &print);
    for line in [
        "seeding = \"guide\"",
        "optimizer = \"genetic\"",
        "kappa = 0.7",
        "max-atoms = 400",
    ] {
        assert!(config.contains(line), "no {line} in\n{config}");
    }
    std::fs::write(at.join("job.toml"), config).unwrap();
    assert!(one == mesh(&["--config", "job.toml"]));
    assert!(one != mesh(&["--config", "job.toml", "--rng-seed", "4"]));
}

#[test]
fn what_does_not_go_is_refused_in_one_line() {
    let folder = folder();
    let at = folder.path();
    write_npy_2d(&at.join("constant.npy"), [64, 60], |_| 0.0);
    let says = |arguments: &[&str], words: &[&str]| {
        let line = expect_refusal(at, &[&["mesh"], arguments].concat());
        for word in words {
            assert!(line.contains(word), "no '{word}' in: {line}");
        }
    };
    for kappa in ["1.5", "-0.1", "NaN"] {
        let option = format!("--kappa={kappa}");
        says(&["plane.npy", &option], &["--kappa", kappa]);
    }
    says(
        &["plane.npy", "--kappa", "0.7", "--cells", "voronoi"],
        &["--kappa", "Voronoi"],
    );
    says(
        &["plane.npy", "--kappa", "0.7", "--potential", "sampled"],
        &["--kappa", "sampled"],
    );
    says(
        &["plane.npy", "--max-atoms", "100"],
        &["--max-atoms", "guide"],
    );
    says(
        &["plane.npy", "--seeding", "projection", "--cells", "voronoi"],
        &["projection", "Voronoi"],
    );
    says(&["constant.npy", "--seeding", "guide"], &["constant.npy"]);
}
