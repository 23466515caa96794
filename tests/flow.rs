//! Tests `atomesh flow` on the command line.

use std::path::Path;

use crate::common::{
    SharedFiles, expect_refusal, planar_fault, run, run_args, write_npy, write_npy_2d,
};
use atomesh::files::vtk::VtkFile;
use atomesh::store::{AnyMesh, MeshFile, read_any_vtu, read_vtu};
use serde_json::Value;

const DIMS: [usize; 3] = [40, 36, 32];

/// Returns a folder with `mesh.vtu`, a mesh of a planar fault across the box.
fn folder() -> tempfile::TempDir {
    static FILES: SharedFiles = SharedFiles::new();
    FILES.folder(|folder| {
        write_npy(&folder.join("sheet.npy"), DIMS, planar_fault(DIMS));
        run(folder, "mesh sheet.npy -o mesh.vtu --distance 6 --quiet");
    })
}

fn flow(folder: &Path, options: &[&str]) -> Value {
    let arguments = [
        &["flow", "mesh.vtu", "-o", "flow.vtu", "--quiet", "--json"],
        options,
    ]
    .concat();
    serde_json::from_str(&run_args(folder, &arguments)).unwrap()
}

fn throughput(folder: &Path, options: &[&str]) -> f64 {
    let sides = ["--pressure", "xmin=2e5", "--pressure", "xmax=1e5"];
    let report = flow(folder, &[&sides, options].concat());
    assert!(report["solver"]["max_imbalance"].as_f64().unwrap() < 1e-10);
    assert!(report["solver"]["total_imbalance"].as_f64().unwrap() < 1e-10);
    report["solver"]["throughput"].as_f64().unwrap()
}

fn array_values(file: &MeshFile, name: &str) -> Vec<f64> {
    let arrays = file.point_data.iter().chain(&file.cell_data);
    arrays
        .into_iter()
        .find(|a| a.name == name)
        .unwrap()
        .values
        .to_f64()
}

#[test]
fn linear_pressure_is_exact_on_an_optimised_mesh() {
    let folder = folder();
    let rate = throughput(
        folder.path(),
        &[
            "--faults",
            "open",
            "--permeability",
            "2e-13,1e-12,3e-15",
            "--viscosity",
            "5e-4",
        ],
    );
    // Darcy: k / viscosity * pressure difference * area / length.
    let expected = 2e-13 / 5e-4 * 1e5 * (35.0 * 31.0) / 39.0;
    assert!((rate / expected - 1.0).abs() < 1e-9, "{rate} {expected}");
    let file = read_vtu(&folder.path().join("flow.vtu")).unwrap();
    for (p, x) in array_values(&file, "pressure").iter().zip(&file.mesh.nodes) {
        let exact = 2e5 - 1e5 * x[0] / 39.0;
        assert!((p / exact - 1.0).abs() < 1e-10, "{p} {exact}");
    }
    let u = expected / (35.0 * 31.0);
    for velocity in array_values(&file, "velocity").chunks(3) {
        assert!((velocity[0] / u - 1.0).abs() < 1e-9);
        assert!(velocity[1].abs() + velocity[2].abs() < 1e-8 * u);
    }
}

#[test]
fn flow_decreases_with_the_resistance_of_the_fault() {
    let folder = folder();
    let rates: Vec<f64> = ["open", "0.9", "0.1", "1e-3", "closed"]
        .map(|faults| throughput(folder.path(), &["--faults", faults]))
        .into();
    assert!(rates.windows(2).all(|pair| pair[1] < pair[0]), "{rates:?}");
    assert!(rates[3] < 0.2 * rates[0], "{rates:?}");
    // The fault separates the box: if it is closed, there is no flow.
    assert!(rates[4] < 1e-9 * rates[0], "{rates:?}");
    let file = read_vtu(&folder.path().join("flow.vtu")).unwrap();
    let nodes = array_values(&file, "node");
    let doubled = nodes
        .iter()
        .enumerate()
        .filter(|(i, node)| **node != *i as f64)
        .count();
    assert!(doubled > 20);
    assert!(
        array_values(&file, "fault_rate")
            .iter()
            .all(|rate| *rate == 0.0)
    );
    assert_eq!(
        array_values(&file, "atom_kind").len(),
        file.mesh.nodes.len()
    );

    // A layer of twice the thickness has about twice the resistance as long as the layer dominates.
    let thin = throughput(
        folder.path(),
        &["--faults", "1e-4", "--fault-thickness", "0.1"],
    );
    let thick = throughput(
        folder.path(),
        &["--faults", "1e-4", "--fault-thickness", "0.2"],
    );
    assert!(thick < thin, "{thick} {thin}");
    let file = read_vtu(&folder.path().join("flow.vtu")).unwrap();
    // The two sides of a face have opposite rates.
    let fault_rates = array_values(&file, "fault_rate");
    assert!(
        fault_rates.iter().sum::<f64>().abs()
            < 1e-12 * fault_rates.iter().map(|r| r.abs()).sum::<f64>()
    );
}

#[test]
fn two_point_fluxes_are_exact_on_voronoi_cells() {
    let folder = tempfile::tempdir().unwrap();
    write_npy(&folder.path().join("sheet.npy"), DIMS, planar_fault(DIMS));
    let mesh = "mesh sheet.npy -o mesh.vtu --distance 6 --align alongside --cells voronoi --quiet";
    run_args(folder.path(), &mesh.split(' ').collect::<Vec<_>>());
    let lines = ["--streamlines", "lines.vtp", "--lines", "10"];
    let rate = throughput(folder.path(), &[&["--faults", "open"], &lines[..]].concat());
    // Streamlines are straight along x, and as long as the box.
    let file = VtkFile::read(&folder.path().join("lines.vtp"), "PolyData").unwrap();
    let piece = file.piece().unwrap();
    let points = file
        .array(&piece.child("Points").unwrap().children[0])
        .unwrap();
    let points = points.values.to_f64();
    let (mut ends, mut steps) = (0, 0);
    for pair in points.chunks_exact(3).collect::<Vec<_>>().windows(2) {
        if pair[0][0] < 39.0 - 1e-6 {
            assert!(
                (1..3).all(|k| (pair[0][k] - pair[1][k]).abs() < 1e-3),
                "{pair:?}"
            );
            assert!(pair[1][0] >= pair[0][0], "{pair:?}");
            steps += 1;
        } else {
            ends += 1;
        }
    }
    assert!(ends == 9 && steps > 100, "{ends} {steps}");
    let expected = 1e-13 / 1e-3 * 1e5 * (35.0 * 31.0) / 39.0;
    assert!((rate / expected - 1.0).abs() < 1e-6, "{rate} {expected}");
    let AnyMesh::Polyhedra(file) = read_any_vtu(&folder.path().join("flow.vtu")).unwrap() else {
        panic!("no polyhedra")
    };
    let pressure = file
        .cell_data
        .iter()
        .find(|a| a.name == "pressure")
        .unwrap();
    for (p, site) in pressure.values.to_f64().iter().zip(&file.mesh.sites) {
        let exact = 2e5 - 1e5 * site[0] / 39.0;
        assert!((p / exact - 1.0).abs() < 1e-6, "{p} {exact}");
    }
    assert!(file.mesh.on_feature.iter().any(|on| *on));
    let closed = throughput(folder.path(), &["--faults", "closed"]);
    assert!(closed < 0.9 * rate, "{closed} {rate}");
    // The third coordinate is missing.
    let sink = [
        "flow",
        "mesh.vtu",
        "-o",
        "out.vtu",
        "--sink",
        "3,4",
        "--pressure",
        "xmin=0",
    ];
    assert!(
        expect_refusal(folder.path(), &sink).contains("2 coordinates, but the mesh has 3 axes")
    );
}

/// Tests triangles and polygons of the plane with a line across, tilted as the fault is.
#[test]
fn flow_in_the_plane() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let line = planar_fault(DIMS);
    write_npy_2d(&dir.join("line.npy"), [40, 36], |[x, y]| line([x, y, 0]));
    for cells in ["triangles", "voronoi"] {
        let mesh = format!("mesh line.npy -o mesh.vtu --distance 4 --cells {cells} --quiet");
        run_args(dir, &mesh.split(' ').collect::<Vec<_>>());
        let expected = 2e-13 / 1e-3 * 1e5 * 35.0 / 39.0;
        if cells == "triangles" {
            // Two-point fluxes are exact for isotropic rock only.
            let options = ["--faults", "open", "--permeability", "2e-13,1e-12"];
            let rate = throughput(dir, &options);
            assert!((rate / expected - 1.0).abs() < 1e-10, "{rate} {expected}");
        }
        let rate = throughput(dir, &["--faults", "open", "--permeability", "2e-13"]);
        assert!(
            (rate / expected - 1.0).abs() < 1e-6,
            "{cells} {rate} {expected}"
        );
        let layer = [
            "--faults",
            "0.01",
            "--fault-thickness",
            "0.5",
            "--permeability",
            "2e-13",
        ];
        let rate_with_layer = throughput(dir, &layer);
        // The resistances are in series. The line is 6 degrees off the perpendicular.
        let expected_with_layer = expected * 39.0 / (39.0 + 0.5 * 99.0);
        assert!(
            (rate_with_layer / expected_with_layer - 1.0).abs() < 0.05,
            "{cells} {rate_with_layer} {expected_with_layer}"
        );
        assert!(throughput(dir, &["--faults", "closed"]) < 1e-9 * expected);
        let side = ["flow", "mesh.vtu", "-o", "x.vtu", "--pressure", "zmin=0"];
        assert!(expect_refusal(dir, &side).contains("zmin"));
        let well = [
            "flow", "mesh.vtu", "-o", "x.vtu", "--source", "1,2,3", "--sink", "5,5,5",
        ];
        assert!(expect_refusal(dir, &well).contains("3 coordinates, but the mesh has 2 axes"));
        let k = [
            "flow",
            "mesh.vtu",
            "-o",
            "x.vtu",
            "--pressure",
            "xmin=0",
            "--permeability",
            "1,1,2",
        ];
        assert!(expect_refusal(dir, &k).contains("KXX,KYY,KXY"));
    }
}

#[test]
fn streamlines_in_the_plane() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let line = planar_fault(DIMS);
    write_npy_2d(&dir.join("line.npy"), [40, 36], |[x, y]| line([x, y, 0]));
    let mesh = "mesh line.npy -o mesh.vtu --distance 4 --quiet";
    run_args(dir, &mesh.split(' ').collect::<Vec<_>>());
    let wells = [
        "--source",
        "8,10",
        "--sink",
        "14,30",
        "--streamlines",
        "lines.vtp",
        "--lines",
        "20",
    ];
    let report = flow(dir, &wells);
    assert_eq!(report["solver"]["compartments"], 2);
    let lines = VtkFile::read(&dir.join("lines.vtp"), "PolyData").unwrap();
    let piece = lines.piece().unwrap();
    assert_eq!(
        lines
            .parse_attribute::<usize>(piece, "NumberOfLines")
            .unwrap(),
        [20]
    );
    let AnyMesh::Triangles(file) = read_any_vtu(&dir.join("flow.vtu")).unwrap() else {
        panic!("no triangles")
    };
    let velocity = file
        .cell_data
        .iter()
        .find(|a| a.name == "velocity")
        .unwrap();
    assert_eq!(velocity.components, 3);
}

/// Tests two faults across the box, the second one smaller, with a multiplier for each by number.
#[test]
fn multipliers_for_faults_by_number() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_npy(&dir.join("two.npy"), DIMS, |[x, y, z]| {
        let ridge = |distance: f32| (-0.5 * (distance / 1.5).powi(2)).exp();
        let amplitude = if y < 26 { 1.0 } else { 0.0 };
        ridge(x as f32 - 12.0 - 0.2 * z as f32).max(amplitude * ridge(x as f32 - 30.0))
    });
    for cells in ["tets", "voronoi"] {
        let mesh = format!(
            "mesh two.npy -o mesh.vtu --distance 5 --feature ridges --cells {cells} --quiet"
        );
        run_args(dir, &mesh.split(' ').collect::<Vec<_>>());
        let stdout = run_args(
            dir,
            &["surface", "mesh.vtu", "-o", "s.vtp", "--json", "--quiet"],
        );
        let report: Value = serde_json::from_str(&stdout).unwrap();
        let surfaces = report["surfaces"].as_array().unwrap();
        assert_eq!(surfaces.len(), 2, "{cells} {report}");
        // The first fault crosses the whole box. The second one ends inside.
        assert!(surfaces[0]["area"].as_f64() > surfaces[1]["area"].as_f64());
        assert!(surfaces.iter().all(|s| s["kind"] == "fault"));
        let open = throughput(dir, &["--faults", "open"]);
        let first = throughput(dir, &["--faults", "open", "--fault-multiplier", "1:0"]);
        assert!(first < 1e-9 * open, "{cells} {first} {open}");
        let second = throughput(dir, &["--faults", "open", "--fault-multiplier", "2:0"]);
        assert!(
            second > 0.2 * open && second < 0.9 * open,
            "{cells} {second} {open}"
        );
        // Extended to the sides of the box, the second fault lets nothing pass either.
        let extended = [
            "--faults",
            "open",
            "--fault-multiplier",
            "2:0",
            "--extend-faults",
            "100",
        ];
        let extended = throughput(dir, &extended);
        assert!(extended < 1e-9 * open, "{cells} {extended} {open}");
        // Other options with the same meaning give the same rate.
        let assert_same_rate = |options: &[&str]| {
            let rate = throughput(dir, options);
            assert!((rate / second - 1.0).abs() < 1e-9, "{cells} {options:?}");
        };
        assert_same_rate(&["--barriers", "2"]);
        std::fs::write(
            dir.join("m.csv"),
            "surface,factor,thickness\n1,1,0.1\n2,0,0.1\n",
        )
        .unwrap();
        assert_same_rate(&["--fault-multiplier", "m.csv"]);
        assert_same_rate(&["--fault-multiplier", "1:1"]);
        let report = flow(
            dir,
            &[
                "--pressure",
                "xmin=2e5",
                "--pressure",
                "xmax=1e5",
                "--faults",
                "0.5",
                "--fault-multiplier",
                "2:0.25",
            ],
        );
        let by_fault = report["by_fault"].as_array().unwrap();
        for (fault, (surface, multiplier)) in by_fault.iter().zip([(1, 0.5), (2, 0.25)]) {
            assert_eq!(fault["surface"], surface);
            assert_eq!(fault["multiplier"], multiplier);
        }
        assert_eq!(by_fault.len(), 2);
        // The whole flow crosses the first fault.
        let (through_first, total) = (
            &by_fault[0]["total_rate_across"],
            &report["solver"]["throughput"],
        );
        let ratio = through_first.as_f64().unwrap() / total.as_f64().unwrap();
        assert!((ratio - 1.0).abs() < 1e-6, "{cells} {ratio}");
    }
}

/// Tests that horizons are no barriers by default.
#[test]
fn horizons_are_open_by_default() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_npy(&dir.join("layers.npy"), DIMS, |[x, y, _]| {
        let ricker = |distance: f32| {
            let t = (distance / 2.5).powi(2);
            (1.0 - 2.0 * t) * (-t).exp()
        };
        ricker(x as f32 - 12.0 - 0.05 * y as f32) - ricker(x as f32 - 27.0)
    });
    let mesh = "mesh layers.npy -o mesh.vtu --distance 5 --feature horizons --quiet";
    run_args(dir, &mesh.split(' ').collect::<Vec<_>>());
    let stdout = run_args(
        dir,
        &[
            "surface", "mesh.vtu", "-o", "s.ts", "--up", "x", "--json", "--quiet",
        ],
    );
    let report: Value = serde_json::from_str(&stdout).unwrap();
    let surfaces = report["surfaces"].as_array().unwrap();
    assert!(
        !surfaces.is_empty() && surfaces.iter().all(|s| s["kind"] == "horizon"),
        "{report}"
    );
    let text = std::fs::read_to_string(dir.join("s.ts")).unwrap();
    assert!(text.contains("name:horizon1\n") && text.contains("AXIS_UNIT \"unitless\""));
    let open = throughput(dir, &["--faults", "open"]);
    let closed = throughput(dir, &["--faults", "closed"]);
    assert!((closed / open - 1.0).abs() < 1e-9, "{closed} {open}");
    for barriers in ["all", "horizons"] {
        assert!(throughput(dir, &["--barriers", barriers]) < 1e-9 * open);
    }
}

#[test]
fn wells_and_streamlines_are_the_same_for_any_number_of_threads() {
    let folder = folder();
    let wells = [
        "--source",
        "8,10,12:0.002",
        "--sink",
        "30,20,15",
        "--sink",
        "8,30,28:0.0005",
    ];
    let run = |threads: &str| {
        let options = [
            "--faults",
            "0.01",
            "--streamlines",
            "lines.vtp",
            "--lines",
            "60",
            "--threads",
            threads,
        ];
        let report = flow(folder.path(), &[&wells[..], &options].concat());
        let files =
            ["flow.vtu", "lines.vtp"].map(|f| std::fs::read(folder.path().join(f)).unwrap());
        (report, files)
    };
    let (report, files) = run("1");
    assert!(run("3").1 == files);
    let rates: Vec<f64> = report["exchange"]
        .as_array()
        .unwrap()
        .iter()
        .map(|e| e["rate"].as_f64().unwrap())
        .collect();
    assert_eq!(rates, [0.002, -0.0015, -0.0005]);
    let lines = VtkFile::read(&folder.path().join("lines.vtp"), "PolyData").unwrap();
    let piece = lines.piece().unwrap();
    assert_eq!(
        lines
            .parse_attribute::<usize>(piece, "NumberOfLines")
            .unwrap(),
        [60]
    );
}

#[test]
fn permeability_by_region_and_by_cell_array() {
    let folder = folder();
    let throughput =
        |options: &[&str]| throughput(folder.path(), &[&["--faults", "0.1"], options].concat());
    let plain = throughput(&["--permeability", "3e-13"]);
    std::fs::write(
        folder.path().join("k.csv"),
        "region,k\n# all of it\n0,3e-13\n7,1\n",
    )
    .unwrap();
    assert_eq!(plain, throughput(&["--permeability", "k.csv"]));
    // Any cell array may be the permeability, for example the volume of the cells.
    let by_volume = throughput(&["--permeability", "volume"]);
    assert!(by_volume > 0.0 && by_volume.is_finite());
}

/// Options of impossible jobs, and parts of the errors; `ENDS` stands for pressures at two sides.
const REFUSED_JOBS: [(&str, &[&str]); 30] = [
    ("", &["a source", "pressure"]),
    (
        "--source 800,10,12 --sink 30,20,15",
        &["--source 800,10,12", "outside"],
    ),
    ("--source 8,10 --pressure xmin=0", &["2 coordinates"]),
    ("--source 8,10,x", &["not a number"]),
    ("--source 8,10,12:-1", &["not positive"]),
    (
        "--source 8,10,12",
        &["balance", "pressure of one of its sides"],
    ),
    ("--sink 30,20,15", &["--sink 30,20,15", "no rate"]),
    ("--source 8,10,12 --sink 30,20,15:5", &["balance"]),
    ("--pressure top=1", &["not a side", "xmin"]),
    ("--pressure xmin", &["xmin=1e7"]),
    ("--pressure xmin=1 --pressure xmin=2", &["twice"]),
    ("ENDS --faults 2", &["multiplier 2", "0 to 1"]),
    ("ENDS --faults ajar", &["--faults ajar", "closed"]),
    ("ENDS --faults 0.1 --fault-thickness 0", &["thickness 0"]),
    ("ENDS --barriers layers", &["--barriers layers", "horizons"]),
    (
        "ENDS --barriers 9",
        &["--barriers 9", "the mesh has fault1"],
    ),
    (
        "ENDS --fault-multiplier 2:0.1",
        &["--fault-multiplier 2", "atomesh surface"],
    ),
    (
        "ENDS --fault-multiplier 0:0.1",
        &["--fault-multiplier 0:0.1"],
    ),
    ("ENDS --fault-multiplier 1:3", &["multiplier 3", "0 to 1"]),
    (
        "ENDS --fault-multiplier gone.csv",
        &["gone.csv", "not a file"],
    ),
    ("ENDS --fault-multiplier laws.csv", &["laws.csv:2", "half"]),
    (
        "ENDS --fault-multiplier 1:0.1 --fault-multiplier 1:0.2",
        &["fault 1", "second factor"],
    ),
    ("ENDS --permeability -1", &["--permeability -1"]),
    ("ENDS --permeability 1,2", &["--permeability 1,2"]),
    ("ENDS --permeability gone", &["gone", "min_dihedral"]),
    ("ENDS --permeability five.csv", &["region 0", "for 5"]),
    (
        "ENDS --permeability twice.csv",
        &["twice.csv:2", "given twice"],
    ),
    ("ENDS --permeability words.csv", &["words.csv:2", "sand"]),
    ("ENDS --viscosity 0", &["--viscosity 0"]),
    ("ENDS --streamlines no/such/lines.vtp", &["no/such"]),
];

#[test]
fn impossible_flow_jobs_are_refused_in_one_line() {
    let folder = folder();
    let path = folder.path();
    std::fs::write(path.join("five.csv"), "5,1e-13\n").unwrap();
    std::fs::write(path.join("twice.csv"), "0,1e-13\n0,1e-12\n").unwrap();
    std::fs::write(path.join("words.csv"), "0,1e-13\nsand,1e-12\n").unwrap();
    std::fs::write(path.join("laws.csv"), "surface,factor\n1;half\n").unwrap();
    let ends = "--pressure xmin=1 --pressure xmax=0";
    for (options, words) in REFUSED_JOBS {
        let job = format!("flow mesh.vtu -o out.vtu {}", options.replace("ENDS", ends));
        let line = expect_refusal(path, &job.split_whitespace().collect::<Vec<_>>());
        for word in words {
            assert!(line.contains(word), "no '{word}' in: {line}");
        }
    }
    let line = expect_refusal(
        path,
        &format!("flow sheet.npy -o out.vtu {ends}")
            .split(' ')
            .collect::<Vec<_>>(),
    );
    assert!(line.contains("sheet.npy"), "{line}");
}

#[test]
fn no_input_is_overwritten_and_no_option_is_ignored() {
    let folder = folder();
    let path = folder.path();
    std::fs::write(path.join("factors.vtu"), "1,0.5\n").unwrap();
    let line = "flow mesh.vtu --pressure xmin=2e5 --pressure xmax=1e5";
    let cases = [
        ("-o mesh.vtu", "would overwrite an input"),
        ("-o ./mesh.vtu", "would overwrite an input"),
        (
            "-o factors.vtu --fault-multiplier factors.vtu",
            "would overwrite an input",
        ),
        ("-o out.vtu --streamlines out.vtu", "--streamlines"),
        ("-o out.vtu --lines 5", "--lines"),
        ("-o out.vtu --faults open --barriers all", "--barriers"),
        ("-o out.vtu --fault-thickness 1", "--fault-thickness"),
    ];
    for (options, words) in cases {
        let line = format!("{line} {options}");
        let error = expect_refusal(path, &line.split_whitespace().collect::<Vec<_>>());
        assert!(error.contains(words), "no '{words}' in: {error}");
    }
    // A raw sample type has no meaning if no image is read.
    let surface = ["surface", "mesh.vtu", "-o", "s.vtp", "--raw", "4x4x4:f32"];
    assert!(expect_refusal(path, &surface).contains("no image"));
}
