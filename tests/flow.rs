//! `atomesh flow` as a user runs it.

use std::path::Path;

use crate::common::{SharedFiles, write_npy, write_npy_2d, expect_refusal, run, planar_fault, run_args};
use atomesh::files::vtk::VtkFile;
use atomesh::store::{AnyMesh, MeshFile, read_any_vtu, read_vtu};
use serde_json::Value;

const DIMS: [usize; 3] = [40, 36, 32];

/// A folder with a mesh of a sheet across the box, `mesh.vtu`.
fn folder() -> tempfile::TempDir {
    static MADE: SharedFiles = SharedFiles::new();
    MADE.folder(|folder| {
        write_npy(&folder.join("sheet.npy"), DIMS, planar_fault(DIMS));
        run(folder, "mesh sheet.npy -o mesh.vtu --distance 6 --quiet");
    })
}

fn flow(folder: &Path, options: &[&str]) -> Value {
    let all = [
        &["flow", "mesh.vtu", "-o", "flow.vtu", "--quiet", "--json"],
        options,
    ]
    .concat();
    serde_json::from_str(&run_args(folder, &all)).unwrap()
}

fn through(folder: &Path, options: &[&str]) -> f64 {
    let sides = ["--pressure", "xmin=2e5", "--pressure", "xmax=1e5"];
    let said = flow(folder, &[&sides, options].concat());
    assert!(said["solver"]["max_imbalance"].as_f64().unwrap() < 1e-10);
    assert!(said["solver"]["total_imbalance"].as_f64().unwrap() < 1e-10);
    said["solver"]["throughput"].as_f64().unwrap()
}

fn numbers(file: &MeshFile, name: &str) -> Vec<f64> {
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
    let rate = through(
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
    // k / viscosity * pressure difference * area / length.
    let want = 2e-13 / 5e-4 * 1e5 * (35.0 * 31.0) / 39.0;
    assert!((rate / want - 1.0).abs() < 1e-9, "{rate} {want}");
    let file = read_vtu(&folder.path().join("flow.vtu")).unwrap();
    for (p, x) in numbers(&file, "pressure").iter().zip(&file.mesh.nodes) {
        let exact = 2e5 - 1e5 * x[0] / 39.0;
        assert!((p / exact - 1.0).abs() < 1e-10, "{p} {exact}");
    }
    let u = want / (35.0 * 31.0);
    for velocity in numbers(&file, "velocity").chunks(3) {
        assert!((velocity[0] / u - 1.0).abs() < 1e-9);
        assert!(velocity[1].abs() + velocity[2].abs() < 1e-8 * u);
    }
}

#[test]
fn the_more_a_fault_resists_the_less_flows() {
    let folder = folder();
    let rates: Vec<f64> = ["open", "0.9", "0.1", "1e-3", "closed"]
        .map(|faults| through(folder.path(), &["--faults", faults]))
        .into();
    assert!(rates.windows(2).all(|pair| pair[1] < pair[0]), "{rates:?}");
    assert!(rates[3] < 0.2 * rates[0], "{rates:?}");
    // The sheet parts the box: closed, nothing gets across.
    assert!(rates[4] < 1e-9 * rates[0], "{rates:?}");
    let file = read_vtu(&folder.path().join("flow.vtu")).unwrap();
    let nodes = numbers(&file, "node");
    let doubled = nodes
        .iter()
        .enumerate()
        .filter(|(i, node)| **node != *i as f64)
        .count();
    assert!(doubled > 20);
    assert!(numbers(&file, "fault_rate").iter().all(|rate| *rate == 0.0));
    assert_eq!(numbers(&file, "atom_kind").len(), file.mesh.nodes.len());

    // A layer twice as thick resists about twice as much as long as it is what resists most.
    let thin = through(
        folder.path(),
        &["--faults", "1e-4", "--fault-thickness", "0.1"],
    );
    let thick = through(
        folder.path(),
        &["--faults", "1e-4", "--fault-thickness", "0.2"],
    );
    assert!(thick < thin, "{thick} {thin}");
    let file = read_vtu(&folder.path().join("flow.vtu")).unwrap();
    // What one side of a face loses the other one gains.
    let across = numbers(&file, "fault_rate");
    assert!(across.iter().sum::<f64>().abs() < 1e-12 * across.iter().map(|r| r.abs()).sum::<f64>());
}

#[test]
fn two_point_fluxes_are_exact_on_voronoi_cells() {
    let folder = tempfile::tempdir().unwrap();
    write_npy(&folder.path().join("sheet.npy"), DIMS, planar_fault(DIMS));
    let mesh = "mesh sheet.npy -o mesh.vtu --distance 6 --align alongside --cells voronoi --quiet";
    run_args(folder.path(), &mesh.split(' ').collect::<Vec<_>>());
    let lines = ["--streamlines", "lines.vtp", "--lines", "10"];
    let rate = through(folder.path(), &[&["--faults", "open"], &lines[..]].concat());
    // Straight along x, each as far as the box is long.
    let read = VtkFile::read(&folder.path().join("lines.vtp"), "PolyData").unwrap();
    let piece = read.piece().unwrap();
    let points = read
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
    let want = 1e-13 / 1e-3 * 1e5 * (35.0 * 31.0) / 39.0;
    assert!((rate / want - 1.0).abs() < 1e-6, "{rate} {want}");
    let AnyMesh::Polyhedra(file) = read_any_vtu(&folder.path().join("flow.vtu")).unwrap() else {
        panic!("no polyhedra")
    };
    let found = file
        .cell_data
        .iter()
        .find(|a| a.name == "pressure")
        .unwrap();
    for (p, site) in found.values.to_f64().iter().zip(&file.mesh.sites) {
        let exact = 2e5 - 1e5 * site[0] / 39.0;
        assert!((p / exact - 1.0).abs() < 1e-6, "{p} {exact}");
    }
    assert!(file.mesh.on_feature.iter().any(|on| *on));
    let closed = through(folder.path(), &["--faults", "closed"]);
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
    assert!(expect_refusal(folder.path(), &sink).contains("2 coordinates, the mesh 3"));
}

/// Triangles and polygons of the plane by the same code: a line across, tilted as the sheet is.
#[test]
fn in_the_plane_as_in_space() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let line = planar_fault(DIMS);
    write_npy_2d(&at.join("line.npy"), [40, 36], |[x, y]| line([x, y, 0]));
    for cells in ["triangles", "voronoi"] {
        let mesh = format!("mesh line.npy -o mesh.vtu --distance 4 --cells {cells} --quiet");
        run_args(at, &mesh.split(' ').collect::<Vec<_>>());
        let want = 2e-13 / 1e-3 * 1e5 * 35.0 / 39.0;
        if cells == "triangles" {
            // Two-point fluxes are right for isotropic rock only.
            let options = ["--faults", "open", "--permeability", "2e-13,1e-12"];
            let rate = through(at, &options);
            assert!((rate / want - 1.0).abs() < 1e-10, "{rate} {want}");
        }
        let rate = through(at, &["--faults", "open", "--permeability", "2e-13"]);
        assert!((rate / want - 1.0).abs() < 1e-6, "{cells} {rate} {want}");
        let layer = [
            "--faults",
            "0.01",
            "--fault-thickness",
            "0.5",
            "--permeability",
            "2e-13",
        ];
        let less = through(at, &layer);
        // In series, the line being off square by 6 degrees.
        let layered = want * 39.0 / (39.0 + 0.5 * 99.0);
        assert!(
            (less / layered - 1.0).abs() < 0.05,
            "{cells} {less} {layered}"
        );
        assert!(through(at, &["--faults", "closed"]) < 1e-9 * want);
        let side = ["flow", "mesh.vtu", "-o", "x.vtu", "--pressure", "zmin=0"];
        assert!(expect_refusal(at, &side).contains("zmin"));
        let well = [
            "flow", "mesh.vtu", "-o", "x.vtu", "--source", "1,2,3", "--sink", "5,5,5",
        ];
        assert!(expect_refusal(at, &well).contains("3 coordinates, the mesh 2"));
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
        assert!(expect_refusal(at, &k).contains("KXX,KYY,KXY"));
    }
    let mesh = "mesh line.npy -o mesh.vtu --distance 4 --quiet";
    run_args(at, &mesh.split(' ').collect::<Vec<_>>());
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
    let said = flow(at, &wells);
    assert_eq!(said["solver"]["compartments"], 2);
    let lines = VtkFile::read(&at.join("lines.vtp"), "PolyData").unwrap();
    let piece = lines.piece().unwrap();
    assert_eq!(
        lines
            .parse_attribute::<usize>(piece, "NumberOfLines")
            .unwrap(),
        [20]
    );
    let AnyMesh::Triangles(file) = read_any_vtu(&at.join("flow.vtu")).unwrap() else {
        panic!("no triangles")
    };
    let velocity = file
        .cell_data
        .iter()
        .find(|a| a.name == "velocity")
        .unwrap();
    assert_eq!(velocity.components, 3);
}

/// Two sheets across the box, the second smaller: each with its own multiplier, by number.
#[test]
fn faults_by_number() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_npy(&at.join("two.npy"), DIMS, |[x, y, z]| {
        let ridge = |off: f32| (-0.5 * (off / 1.5).powi(2)).exp();
        let ends = if y < 26 { 1.0 } else { 0.0 };
        ridge(x as f32 - 12.0 - 0.2 * z as f32).max(ends * ridge(x as f32 - 30.0))
    });
    for cells in ["tets", "voronoi"] {
        let mesh = format!(
            "mesh two.npy -o mesh.vtu --distance 5 --feature ridges --cells {cells} --quiet"
        );
        run_args(at, &mesh.split(' ').collect::<Vec<_>>());
        let said = run_args(
            at,
            &["surface", "mesh.vtu", "-o", "s.vtp", "--json", "--quiet"],
        );
        let said: Value = serde_json::from_str(&said).unwrap();
        let surfaces = said["surfaces"].as_array().unwrap();
        assert_eq!(surfaces.len(), 2, "{cells} {said}");
        // The first crosses the whole box, the second ends within it.
        assert!(surfaces[0]["area"].as_f64() > surfaces[1]["area"].as_f64());
        assert!(surfaces.iter().all(|s| s["kind"] == "fault"));
        let open = through(at, &["--faults", "open"]);
        let first = through(at, &["--faults", "open", "--fault-multiplier", "1:0"]);
        assert!(first < 1e-9 * open, "{cells} {first} {open}");
        let second = through(at, &["--faults", "open", "--fault-multiplier", "2:0"]);
        assert!(
            second > 0.2 * open && second < 0.9 * open,
            "{cells} {second} {open}"
        );
        // The same said in other ways.
        let same = |options: &[&str]| {
            let rate = through(at, options);
            assert!((rate / second - 1.0).abs() < 1e-9, "{cells} {options:?}");
        };
        same(&["--barriers", "2"]);
        std::fs::write(
            at.join("m.csv"),
            "surface,factor,thickness\n1,1,0.1\n2,0,0.1\n",
        )
        .unwrap();
        same(&["--fault-multiplier", "m.csv"]);
        same(&["--fault-multiplier", "1:1"]);
        let both = flow(
            at,
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
        let by_fault = both["by_fault"].as_array().unwrap();
        let said: Vec<(u64, f64)> = by_fault
            .iter()
            .map(|f| {
                (
                    f["surface"].as_u64().unwrap(),
                    f["multiplier"].as_f64().unwrap(),
                )
            })
            .collect();
        assert_eq!(said, [(1, 0.5), (2, 0.25)]);
        // All that flows crosses the first.
        let (across, all) = (&by_fault[0]["total_rate_across"], &both["solver"]["throughput"]);
        let share = across.as_f64().unwrap() / all.as_f64().unwrap();
        assert!((share - 1.0).abs() < 1e-6, "{cells} {share}");
    }
}

/// Layers are no barriers unless they are asked for.
#[test]
fn horizons_are_no_faults() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_npy(&at.join("layers.npy"), DIMS, |[x, y, _]| {
        let ricker = |off: f32| {
            let t = (off / 2.5).powi(2);
            (1.0 - 2.0 * t) * (-t).exp()
        };
        ricker(x as f32 - 12.0 - 0.05 * y as f32) - ricker(x as f32 - 27.0)
    });
    let mesh = "mesh layers.npy -o mesh.vtu --distance 5 --feature horizons --quiet";
    run_args(at, &mesh.split(' ').collect::<Vec<_>>());
    let said = run_args(
        at,
        &[
            "surface", "mesh.vtu", "-o", "s.ts", "--up", "x", "--json", "--quiet",
        ],
    );
    let said: Value = serde_json::from_str(&said).unwrap();
    let surfaces = said["surfaces"].as_array().unwrap();
    assert!(
        !surfaces.is_empty() && surfaces.iter().all(|s| s["kind"] == "horizon"),
        "{said}"
    );
    let text = std::fs::read_to_string(at.join("s.ts")).unwrap();
    assert!(text.contains("name:horizon1\n") && text.contains("AXIS_UNIT \"unitless\""));
    let open = through(at, &["--faults", "open"]);
    let closed = through(at, &["--faults", "closed"]);
    assert!((closed / open - 1.0).abs() < 1e-9, "{closed} {open}");
    for which in ["all", "horizons"] {
        assert!(through(at, &["--barriers", which]) < 1e-9 * open);
    }
}

#[test]
fn wells_streamlines_and_the_same_bytes_for_any_number_of_threads() {
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
        let more = [
            "--faults",
            "0.01",
            "--streamlines",
            "lines.vtp",
            "--lines",
            "60",
            "--threads",
            threads,
        ];
        let said = flow(folder.path(), &[&wells[..], &more].concat());
        let files =
            ["flow.vtu", "lines.vtp"].map(|f| std::fs::read(folder.path().join(f)).unwrap());
        (said, files)
    };
    let (said, files) = run("1");
    assert!(run("3").1 == files);
    let rates: Vec<f64> = said["exchange"]
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
fn permeability_by_region_and_by_cell() {
    let folder = folder();
    let through =
        |options: &[&str]| through(folder.path(), &[&["--faults", "0.1"], options].concat());
    let plain = through(&["--permeability", "3e-13"]);
    std::fs::write(
        folder.path().join("k.csv"),
        "region,k\n# all of it\n0,3e-13\n7,1\n",
    )
    .unwrap();
    assert_eq!(plain, through(&["--permeability", "k.csv"]));
    // Any cell array may be the permeability, here the cells' volumes.
    let by_volume = through(&["--permeability", "volume"]);
    assert!(by_volume > 0.0 && by_volume.is_finite());
}

#[test]
fn what_cannot_be_computed_is_refused_in_one_line() {
    let folder = folder();
    let path = folder.path();
    std::fs::write(path.join("five.csv"), "5,1e-13\n").unwrap();
    std::fs::write(path.join("twice.csv"), "0,1e-13\n0,1e-12\n").unwrap();
    std::fs::write(path.join("words.csv"), "0,1e-13\nsand,1e-12\n").unwrap();
    std::fs::write(path.join("laws.csv"), "surface,factor\n1;half\n").unwrap();
    let ends = ["--pressure", "xmin=1", "--pressure", "xmax=0"];
    let [source, sink] = [["--source", "8,10,12"], ["--sink", "30,20,15"]];
    let cases: &[(&[&str], &[&str])] = &[
        (&[], &["--source", "--pressure"]),
        (
            &["--source", "800,10,12", "--sink", "30,20,15"],
            &["--source 800,10,12", "outside"],
        ),
        (
            &["--source", "8,10", "--pressure", "xmin=0"],
            &["2 coordinates"],
        ),
        (&["--source", "8,10,x"], &["not a number"]),
        (&["--source", "8,10,12:-1"], &["not positive"]),
        (&source, &["balance", "pressure of a side"]),
        (&sink, &["--sink 30,20,15", "no rate"]),
        (
            &[&source[..], &["--sink", "30,20,15:5"]].concat(),
            &["balance"],
        ),
        (&["--pressure", "top=1"], &["not a side", "xmin"]),
        (&["--pressure", "xmin"], &["xmin=1e7"]),
        (
            &["--pressure", "xmin=1", "--pressure", "xmin=2"],
            &["twice"],
        ),
        (
            &[&ends[..], &["--faults", "2"]].concat(),
            &["multiplier 2", "0 to 1"],
        ),
        (
            &[&ends[..], &["--faults", "ajar"]].concat(),
            &["--faults ajar", "closed"],
        ),
        (
            &[&ends[..], &["--faults", "0.1", "--fault-thickness", "0"]].concat(),
            &["thickness 0"],
        ),
        (
            &[&ends[..], &["--barriers", "layers"]].concat(),
            &["--barriers layers", "horizons"],
        ),
        (
            &[&ends[..], &["--barriers", "9"]].concat(),
            &["--barriers 9", "the mesh has fault1"],
        ),
        (
            &[&ends[..], &["--fault-multiplier", "2:0.1"]].concat(),
            &["--fault-multiplier 2", "atomesh surface"],
        ),
        (
            &[&ends[..], &["--fault-multiplier", "0:0.1"]].concat(),
            &["--fault-multiplier 0:0.1"],
        ),
        (
            &[&ends[..], &["--fault-multiplier", "1:3"]].concat(),
            &["multiplier 3", "0 to 1"],
        ),
        (
            &[&ends[..], &["--fault-multiplier", "gone.csv"]].concat(),
            &["gone.csv", "not a file"],
        ),
        (
            &[&ends[..], &["--fault-multiplier", "laws.csv"]].concat(),
            &["laws.csv:2", "1;half"],
        ),
        (
            &[
                &ends[..],
                &["--fault-multiplier", "1:0.1", "--fault-multiplier", "1:0.2"],
            ]
            .concat(),
            &["fault 1", "second factor"],
        ),
        (
            &[&ends[..], &["--permeability", "-1"]].concat(),
            &["--permeability -1"],
        ),
        (
            &[&ends[..], &["--permeability", "1,2"]].concat(),
            &["--permeability 1,2"],
        ),
        (
            &[&ends[..], &["--permeability", "gone"]].concat(),
            &["gone", "min_dihedral"],
        ),
        (
            &[&ends[..], &["--permeability", "five.csv"]].concat(),
            &["region 0", "for 5"],
        ),
        (
            &[&ends[..], &["--permeability", "twice.csv"]].concat(),
            &["twice.csv:2", "given twice"],
        ),
        (
            &[&ends[..], &["--permeability", "words.csv"]].concat(),
            &["words.csv:2", "sand"],
        ),
        (
            &[&ends[..], &["--viscosity", "0"]].concat(),
            &["--viscosity 0"],
        ),
        (
            &[&ends[..], &["--streamlines", "no/such/lines.vtp"]].concat(),
            &["no/such"],
        ),
    ];
    for (options, words) in cases {
        let line = expect_refusal(
            path,
            &[&["flow", "mesh.vtu", "-o", "out.vtu"], *options].concat(),
        );
        for word in *words {
            assert!(line.contains(word), "no '{word}' in: {line}");
        }
    }
    let line = expect_refusal(
        path,
        &[&["flow", "sheet.npy", "-o", "out.vtu"], &ends[..]].concat(),
    );
    assert!(line.contains("sheet.npy"), "{line}");
}

#[test]
fn no_input_is_replaced_and_no_option_ignored() {
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
        let said = expect_refusal(path, &line.split_whitespace().collect::<Vec<_>>());
        assert!(said.contains(words), "no '{words}' in: {said}");
    }
    // A raw sample type says nothing where no image is read.
    let surface = ["surface", "mesh.vtu", "-o", "s.vtp", "--raw", "4x4x4:f32"];
    assert!(expect_refusal(path, &surface).contains("no image"));
}
