//! Tests files of surfaces: their units and depths, formats, conversions and grids.

use crate::common::{Survey, expect_refusal, planar_fault, run_args, write_segy};
use crate::surfaces::{DIMS, folder, json};
use serde_json::Value;

#[test]
fn gocad_files_have_the_units_of_a_survey() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let survey = Survey {
        inlines: 30,
        crosslines: 32,
        samples: 36,
    };
    let value = planar_fault([36, 32, 30]);
    write_segy(&dir.join("survey.sgy"), &survey, value);
    let mesh = "mesh survey.sgy -o mesh.vtu --distance 6 --feature ridges --quiet";
    run_args(dir, &mesh.split(' ').collect::<Vec<_>>());
    run_args(dir, &["surface", "mesh.vtu", "-o", "s.ts", "--quiet"]);
    let text = std::fs::read_to_string(dir.join("s.ts")).unwrap();
    assert!(
        text.contains("AXIS_UNIT \"unitless\" \"unitless\" \"ms\"\n"),
        "{text}"
    );
    // No angle is defined between line numbers and milliseconds.
    let report = json(&run_args(
        dir,
        &["surface", "mesh.vtu", "-o", "s.vtp", "--json"],
    ));
    let surface = &report["surfaces"][0];
    assert!(
        surface["dip"].is_null() && surface["strike"].is_f64(),
        "{report}"
    );
    let output = crate::common::atomesh(dir)
        .args(["surface", "mesh.vtu", "-o", "s.vtp"])
        .output()
        .unwrap();
    let output = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.contains("axes of different units (no unit, no unit, ms): no dip"),
        "{output}"
    );
}

/// Contents of a .vtp file of surfaces.
struct SurfacesOfFile {
    points: Vec<f64>,
    corners: Vec<i64>,
    labels: Vec<i64>,
    horizon: Vec<i64>,
}

impl SurfacesOfFile {
    fn read(path: &std::path::Path) -> Self {
        let file = atomesh::files::vtk::VtkFile::read(path, "PolyData").unwrap();
        let piece = file.piece().unwrap();
        let arrays = |name: &str| {
            let element = piece.child(name).unwrap();
            let arrays = element
                .children
                .iter()
                .map(|array| file.array(array).unwrap());
            arrays.collect::<Vec<_>>()
        };
        let data = arrays("CellData");
        let horizon = data.iter().find(|array| array.name == "horizon").unwrap();
        Self {
            points: arrays("Points")[0].values.to_f64(),
            corners: arrays("Polys")[0].values.to_i64(),
            labels: data[0].values.to_i64(),
            horizon: horizon.values.to_i64(),
        }
    }

    /// Returns the corners of each face of a surface, with `true` if the surface is a horizon.
    fn faces_of(&self, surface: i64) -> impl Iterator<Item = ([[f64; 3]; 3], bool)> {
        let point = |n: i64| std::array::from_fn(|k| self.points[3 * n as usize + k]);
        let faces = self.corners.chunks(3).zip(&self.labels).zip(&self.horizon);
        let faces_of_surface = faces.filter(move |((_, label), _)| **label == surface);
        faces_of_surface
            .map(move |((face, _), horizon)| ([0, 1, 2].map(|k| point(face[k])), *horizon != 0))
    }
}

fn centroid(corners: &[[f64; 3]; 3]) -> [f64; 3] {
    std::array::from_fn(|k| corners.iter().map(|x| x[k]).sum::<f64>() / 3.0)
}

fn area([a, b, c]: &[[f64; 3]; 3]) -> f64 {
    let [u, v] = [b, c].map(|x| [x[0] - a[0], x[1] - a[1], x[2] - a[2]]);
    let normal = [0, 1, 2].map(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        u[i] * v[j] - u[j] * v[i]
    });
    0.5 * normal.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// Tests horizons of layers that two faults displace by 4 to 12 samples. At most 3 % of their area
/// may lie more than two samples off the reflector on which most of the horizon lies.
#[test]
#[ignore = "slow: make test-all"]
fn horizons_stay_on_their_reflector_across_faults() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let synth = "synth amplitude -o image.vti --layers depth.npy --dims 96,120,80 --count 2 \
                 --signal-to-noise 8 --quiet";
    run_args(dir, &synth.split_whitespace().collect::<Vec<_>>());
    let mesh = "mesh image.vti -o mesh.vtu --distance 5 --feature faults+horizons --quiet";
    run_args(dir, &mesh.split(' ').collect::<Vec<_>>());
    let surface = "surface mesh.vtu -o s.vtp --up x --json";
    let report = json(&run_args(dir, &surface.split(' ').collect::<Vec<_>>()));
    let file = SurfacesOfFile::read(&dir.join("s.vtp"));
    let read = atomesh::image::formats::read_any(&dir.join("depth.npy"), &Default::default());
    let depth = read.unwrap().into_image::<3>().unwrap();
    // Depth grows with x along x.
    let depth = |p: [f64; 3]| {
        let nearest: [usize; 3] = std::array::from_fn(|k| p[k].round() as usize);
        let [nx, ny, _] = depth.dims();
        let sample = depth.as_slice()[nearest[0] + nx * (nearest[1] + ny * nearest[2])];
        f64::from(sample) + p[0] - nearest[0] as f64
    };
    let (mut total_area, mut stray_area) = (0.0, 0.0);
    for surface in 1..=report["surfaces"].as_array().unwrap().len() as i64 {
        let faces = file.faces_of(surface).filter(|face| face.1);
        let mut faces: Vec<[f64; 2]> = faces
            .map(|(x, _)| [depth(centroid(&x)), area(&x)])
            .collect();
        faces.sort_by(|a, b| a[0].total_cmp(&b[0]));
        // Area within four samples of depth from a start on. The reflector is where this area is
        // largest.
        let within = |start: f64| -> f64 {
            let faces = faces.iter().skip_while(|face| face[0] < start);
            faces
                .take_while(|face| face[0] <= start + 4.0)
                .map(|face| face[1])
                .sum()
        };
        let area_of_surface: f64 = faces.iter().map(|face| face[1]).sum();
        total_area += area_of_surface;
        stray_area +=
            area_of_surface - faces.iter().map(|face| within(face[0])).fold(0.0, f64::max);
    }
    assert!(
        stray_area <= 0.03 * total_area,
        "{stray_area} of {total_area}"
    );
    assert!(total_area > 40_000.0, "{total_area}");
}

/// Tests a volume in metres and two-way time with one velocity: the dips are true, both for a mesh
/// made in depth and for surfaces of a mesh made in time.
#[test]
fn one_velocity_converts_time_to_depth() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let mut image = b"NRRD0004\ntype: float\ndimension: 3\nspace dimension: 3\nsizes: 44 36 32\n\
        space directions: (25,0,0) (0,25,0) (0,0,12)\nspace origin: (0,0,1000)\n\
        space units: \"m\" \"m\" \"ms\"\nendian: little\nencoding: raw\n\n"
        .to_vec();
    let value = planar_fault(DIMS);
    for z in 0..DIMS[2] {
        for y in 0..DIMS[1] {
            for x in 0..DIMS[0] {
                image.extend(value([x, y, z]).to_le_bytes());
            }
        }
    }
    std::fs::write(dir.join("time.nrrd"), image).unwrap();
    let run = |job: &str| run_args(dir, &job.split_whitespace().collect::<Vec<_>>());
    let mesh = "mesh time.nrrd --distance 6 --feature ridges --quiet -o";
    run(&format!("{mesh} time.vtu"));
    run(&format!("{mesh} depth.vtu --velocity 1500"));
    // The fault is x = 22 + 0.1 y - 0.1 z in samples of 25 m by 25 m by 9 m.
    let normal = [1.0 / 25.0, -0.1 / 25.0, 0.1 / 9.0];
    let length = normal.iter().map(|c| c * c).sum::<f64>().sqrt();
    let dip = (normal[2] / length).acos().to_degrees();
    // The fault spans the height and the width along y of the box.
    let area = 35.0 * 25.0 * 31.0 * 9.0 * length / normal[0];
    for job in [
        "surface depth.vtu -o s.vtp --json",
        "surface time.vtu --velocity 1500 -o s.vtp --json",
    ] {
        let report = json(&run(job));
        let surface = &report["surfaces"][0];
        let actual = ["dip", "area"].map(|name| surface[name].as_f64().unwrap());
        assert!((actual[0] - dip).abs() < 0.6, "{job} {dip} {report}");
        assert!(
            (actual[1] / area - 1.0).abs() < 0.03,
            "{job} {area} {report}"
        );
        // Samples have times from 1000 to 1372 ms.
        let depth = ["min_corner", "max_corner"].map(|end| surface[end][2].as_f64().unwrap());
        assert!(depth[0] > 749.0 && depth[1] < 1030.0, "{report}");
    }
    let report = json(&run("surface time.vtu -o s.vtp --json"));
    assert!(report["surfaces"][0]["dip"].is_null(), "{report}");
    let output = crate::common::atomesh(dir)
        .args(["mesh", "time.nrrd", "-o", "x.vtu", "--distance", "9"])
        .output()
        .unwrap();
    let output = String::from_utf8(output.stderr).unwrap();
    assert!(output.contains("WARNING: z is time (ms)"), "{output}");
    for (job, expected) in [
        (
            "surface depth.vtu -o s.vtp --velocity 1500",
            "no coordinate is in s",
        ),
        ("surface time.vtu -o s.vtp --velocity -3", "--velocity"),
        (
            "mesh time.nrrd -o x.vtu --velocity 0",
            "--velocity 0: is not positive",
        ),
    ] {
        let line = expect_refusal(dir, &job.split_whitespace().collect::<Vec<_>>());
        assert!(line.contains(expected), "{expected}: {line}");
    }
}

/// Returns the distance of a point from the fault, in samples along x.
fn distance_from_fault([x, y, z]: [f64; 3]) -> f64 {
    (x - 22.0 - 0.1 * y + 0.1 * z).abs()
}

#[test]
fn a_surface_survives_conversions_to_sticks() {
    let folder = folder();
    let dir = folder.path();
    let convert = |from: &str, to: &str| json(&run_args(dir, &["convert", from, to, "--json"]));
    run_args(dir, &["surface", "mesh.vtu", "-o", "a.vtp", "--quiet"]);
    assert_eq!(convert("a.vtp", "a.ts")["surfaces"], 1);
    assert_eq!(convert("a.ts", "b.vtp")["surfaces"], 1);

    // Sticks lie on the surface, and so do the triangles between them.
    run_args(
        dir,
        &[
            "surface", "mesh.vtu", "-o", "a.csv", "--step", "3", "--quiet",
        ],
    );
    for to in ["c.ts", "c.pl", "c.vtp"] {
        assert_eq!(convert("a.csv", to)["surfaces"], 1, "{to}");
    }
    convert("c.pl", "b.csv");
    let sticks = |name: &str| std::fs::read_to_string(dir.join(name)).unwrap();
    let points = |name: &str| -> Vec<[f64; 3]> {
        let line = |line: &str| {
            let fields: Vec<f64> = line
                .split(',')
                .skip(2)
                .map(|f| f.parse().unwrap())
                .collect();
            fields.try_into().unwrap()
        };
        sticks(name).lines().skip(1).map(line).collect()
    };
    assert_eq!(points("a.csv"), points("b.csv"));

    for (arguments, expected) in [
        (
            &["surface", "mesh.vtu", "-o", "b.vtp", "--step", "2"][..],
            "applies to sticks",
        ),
        (
            &["surface", "mesh.vtu", "-o", "b.irap", "--number", "9"],
            "there is no surface 9",
        ),
        (
            &["surface", "mesh.vtu", "-o", "b.csv", "--step", "-2"],
            "is not a distance",
        ),
        (&["convert", "a.ts", "b.pl"], "holds lines"),
        (&["convert", "a.ts", "b.vti"], "does not end in"),
        (
            &["convert", "a.ts", "b.vtp", "--spacing", "2"],
            "surfaces are read",
        ),
    ] {
        let error = expect_refusal(dir, arguments);
        assert!(error.contains(expected), "{arguments:?}: {error}");
    }
    let sticks = points("a.csv");
    assert!(sticks.len() >= 60, "{}", sticks.len());
    for point in sticks {
        assert!(distance_from_fault(point) < 1.0, "{point:?}");
    }
}

/// Tests what an interpreter takes away: attributes, horizons in files of their own, and blocks.
#[test]
fn the_grid_of_a_surface_is_written_in_three_formats() {
    let folder = folder();
    let dir = folder.path();
    let convert = |from: &str, to: &str| json(&run_args(dir, &["convert", from, to, "--json"]));
    let error = expect_refusal(dir, &["surface", "mesh.vtu", "-o", "a.irap"]);
    assert!(error.contains("there is no horizon"), "{error}");
    let grid = [
        "surface", "mesh.vtu", "-o", "a.zmap", "--number", "1", "--step", "2", "--quiet",
    ];
    run_args(dir, &grid);
    convert("a.zmap", "a.irap");
    convert("a.irap", "a.cps3");
    convert("a.cps3", "a.npy");
    let [first, last] = ["a.zmap", "a.cps3"].map(|name| {
        let info = json(&run_args(dir, &["info", name, "--json"]));
        assert_eq!(info["image"]["axes"][0]["spacing"], 2.0);
        (info["image"]["min"].clone(), info["image"]["max"].clone())
    });
    assert_eq!(first, last);
    // Nodes of the grid lie on the fault.
    let text = std::fs::read_to_string(dir.join("a.irap")).unwrap();
    let words: Vec<f64> = text
        .split_whitespace()
        .map(|w| w.parse().unwrap())
        .collect();
    let (ny, nx, [x0, y0]) = (words[1] as usize, words[8] as usize, [words[10], words[11]]);
    let nodes = (0..nx * ny).map(|i| {
        let (x, y) = (x0 + 2.0 * (i % nx) as f64, y0 + 2.0 * (i / nx) as f64);
        [x, y, words[19 + i]]
    });
    let grid_nodes: Vec<[f64; 3]> = nodes.filter(|node| node[2] < 1e6).collect();
    assert!(grid_nodes.len() >= 16, "{}", grid_nodes.len());
    for point in grid_nodes {
        assert!(distance_from_fault(point) < 1.0, "{point:?}");
    }
}

/// Volumes of other projects.
mod real_data {
    use super::*;
    use crate::common::data_path;

    /// Tests a volume with three fractures that meet and are 6.5 samples thick. Their middles are
    /// two surfaces, as two of them merge, and their walls are one interface between the two
    /// labels.
    #[test]
    #[ignore = "needs images made by others: make test-all DATA=folder"]
    fn fractures_of_a_public_volume_have_middle_surfaces_and_one_interface() {
        let image = data_path("planar3d/3_fractures_100x100x100_u8.raw");
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let surfaces = |kind: &str| {
            let image = image.to_str().unwrap();
            let job = format!(
                "mesh {image} --raw 100x100x100:u8 --feature {kind} --distance 5 -o mesh.vtu --quiet"
            );
            run_args(dir, &job.split(" ").collect::<Vec<_>>());
            let report = json(&run_args(
                dir,
                &["surface", "mesh.vtu", "-o", "walls.vtp", "--json"],
            ));
            assert!(report["dropped_area"].as_f64().unwrap() < 100.0, "{report}");
            report["surfaces"].as_array().unwrap().clone()
        };
        let middles = surfaces("mask");
        assert_eq!(middles.len(), 2, "{middles:?}");
        for centroid in &middles {
            assert_eq!(centroid["components"], 1, "{centroid}");
            assert!(centroid["area"].as_f64().unwrap() > 4000.0, "{centroid}");
        }
        let walls = surfaces("labels");
        assert_eq!(walls.len(), 1, "{walls:?}");
        assert_eq!(walls[0]["name"], "interface_0_255");
        // Each middle has two walls, except where fractures meet.
        let area = |surfaces: &[Value]| -> f64 {
            surfaces.iter().map(|s| s["area"].as_f64().unwrap()).sum()
        };
        let ratio = area(&walls) / area(&middles);
        assert!((1.8..2.0).contains(&ratio), "{ratio}");
    }

    /// Tests a volume of seven faults that cross and displace one another, in which the dip and
    /// strike of each sample are known. The seven largest surfaces are the seven faults, each with
    /// seven tenths of its faces on its fault.
    #[test]
    #[ignore = "needs images made by others: make test-all DATA=folder"]
    fn the_seven_faults_of_a_public_volume_are_the_seven_largest_surfaces() {
        let mask = data_path("synthetic_faults3d_lanl/train_0_fsem.bin");
        let numbers = |kind: &str| -> Vec<f32> {
            let path = mask.with_file_name(format!("train_0_{kind}.bin"));
            let bytes = std::fs::read(path).unwrap();
            let (numbers, _) = bytes.as_chunks::<4>();
            numbers.iter().map(|&b| f32::from_le_bytes(b)).collect()
        };
        let [inside, dip, strike] = ["fsem", "fdip", "fstrike"].map(numbers);
        // The orientation is uniform over a fault, so that it identifies the fault.
        let fault = |i: usize| {
            let orientation = [dip[i], strike[i]].map(|a| (2000.0 * a).round() as i64);
            (inside[i] > 0.5).then_some(orientation)
        };
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let job = [
            "mesh",
            mask.to_str().unwrap(),
            "--raw",
            "64x64x64:f32le",
            "--feature",
            "ridges",
            "--distance",
            "5",
            "-o",
            "mesh.vtu",
            "--quiet",
        ];
        run_args(dir, &job);
        run_args(dir, &["surface", "mesh.vtu", "-o", "s.vtp", "--quiet"]);
        let file = SurfacesOfFile::read(&dir.join("s.vtp"));
        let mut faults_found = Vec::new();
        for surface in 1..=7 {
            let mut faces: std::collections::BTreeMap<[i64; 2], usize> = Default::default();
            for (corners, _) in file.faces_of(surface) {
                let [x, y, z] = centroid(&corners).map(|c| c.round() as usize);
                if let Some(fault) = fault(x + 64 * (y + 64 * z)) {
                    *faces.entry(fault).or_default() += 1;
                }
            }
            let total: usize = faces.values().sum();
            let (fault, max_count) = faces.into_iter().max_by_key(|(_, count)| *count).unwrap();
            assert!(
                max_count * 10 >= total * 7,
                "surface {surface}: {max_count} of {total}"
            );
            faults_found.push(fault);
        }
        faults_found.sort_unstable();
        faults_found.dedup();
        assert_eq!(faults_found.len(), 7, "{faults_found:?}");
    }
}
