//! Tests `--velocity FILE` on the command line: a survey in two-way time, and interval velocities
//! on a coarser grid.

use std::path::Path;

use crate::common::{Survey, expect_refusal, run, write_npy, write_npy_2d, write_segy};
use atomesh::mesh::TetMesh;
use atomesh::store::{MeshFile, read_vtu};
use serde_json::Value;

const SURVEY: Survey = Survey {
    inlines: 24,
    crosslines: 40,
    samples: 100,
};

/// Returns the coordinate of a map position along the axis of crosslines.
fn crossline_distance([x, y]: [f64; 2]) -> f64 {
    0.8 * (x - 600_000.0) + 0.6 * (y - 6_000_000.0)
}

/// Returns the velocity in m/s at a map position and a two-way time in ms.
fn velocity(position: [f64; 2], t: f64) -> f64 {
    1800.0 + 0.8 * crossline_distance(position) + 1.5 * t
}

/// Returns the depth in m: the integral of half the velocity over the time.
fn depth(position: [f64; 2], t: f64) -> f64 {
    let t = 1e-3 * t;
    velocity(position, 0.0) * t / 2.0 + 1500.0 * t * t / 4.0
}

/// Slope of the plane in the survey.
const SLOPE: f64 = 0.4;

/// Returns a folder with `s.sgy`, the image in time of a plane in depth, and its velocities
/// `v.vti`.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_segy(
        &dir.join("s.sgy"),
        &SURVEY,
        |[sample, crossline, inline]| {
            let position = SURVEY.position(inline, crossline);
            let distance = depth(position, 4.0 * sample as f64)
                - 200.0
                - SLOPE * (crossline_distance(position) - 250.0);
            (-0.5 * (distance / 6.0).powi(2)).exp() as f32
        },
    );
    write_velocities(dir, "v", velocity);
    folder
}

/// Writes velocities every 100 m and 100 ms as `name.npy` and, with a geometry, as `name.vti`. Here
/// time grows downwards, while it decreases in SEG-Y.
fn write_velocities(dir: &Path, name: &str, v: impl Fn([f64; 2], f64) -> f64) {
    write_npy(&dir.join(format!("{name}.npy")), [9, 10, 5], |[x, y, t]| {
        let position = [599_600.0 + 100.0 * x as f64, 5_999_900.0 + 100.0 * y as f64];
        v(position, 100.0 * t as f64) as f32
    });
    let geometry = "--spacing 100,100,100 --origin 599600,5999900,0 --unit m,m,ms";
    run(
        dir,
        &format!("convert {name}.npy {name}.vti {geometry} --quiet"),
    );
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

/// Returns the dip and the strike in degrees and the area in square metres of the largest surface
/// of a report.
fn dip_strike_area(stdout: &str) -> [f64; 3] {
    let report = json(stdout);
    ["dip", "strike", "area"].map(|name| report["surfaces"][0][name].as_f64().unwrap())
}

/// Checks that the nodes on the feature lie on the plane.
fn assert_nodes_on_plane(file: &MeshFile<TetMesh>) {
    let feature = file
        .point_data
        .iter()
        .find(|a| a.name == "feature")
        .unwrap();
    let (mut count, mut squares) = (0.0, 0.0f64);
    for (x, b) in file.mesh.nodes.iter().zip(feature.values.to_f64()) {
        if b < -0.95 {
            let plane_depth = 200.0 + SLOPE * (crossline_distance([x[0], x[1]]) - 250.0);
            (count, squares) = (count + 1.0, squares + (-x[2] - plane_depth).powi(2));
        }
    }
    // A sample is 3.6 m.
    assert!(
        count > 100.0 && (squares / count).sqrt() < 0.7,
        "{count} {}",
        (squares / count).sqrt()
    );
}

#[test]
fn a_velocity_file_converts_time_to_true_depth() {
    let folder = folder();
    let dir = folder.path();
    let mesh = "mesh s.sgy --distance 6 --feature ridges --quiet";
    run(dir, &format!("{mesh} -o time.vtu"));
    let report = json(&run(
        dir,
        &format!("{mesh} --metric shape -o depth.vtu --velocity v.vti --json"),
    ));
    let note = report["notes"].to_string();
    assert!(
        note.contains("converted to depth with v.vti: 0.0 to 4"),
        "{note}"
    );
    assert!(note.contains("% of the image is cut off"), "{note}");
    // The report has the dimensions of the input, not those after the conversion.
    assert_eq!(report["input"]["dims"], serde_json::json!([100, 40, 24]));

    let dip = SLOPE.atan().to_degrees();
    let area = 39.0 * 12.5 * 23.0 * 25.0 / SLOPE.atan().cos();
    for job in [
        "surface depth.vtu -o s.vtp --json",
        "surface time.vtu --velocity v.vti -o s.vtp --json",
    ] {
        let actual = dip_strike_area(&run(dir, job));
        assert!((actual[0] - dip).abs() < 0.5, "{job} {actual:?} {dip}");
        // The plane dips towards the end of the crosslines.
        assert!((actual[1] - 323.13).abs() < 1.0, "{job} {actual:?}");
        assert!(
            (actual[2] / area - 1.0).abs() < 0.03,
            "{job} {actual:?} {area}"
        );
    }
    // A bare array with the dimensions of the image has the geometry of the image.
    let samples = |[sample, crossline, inline]: [usize; 3]| {
        velocity(SURVEY.position(inline, crossline), 4.0 * sample as f64) as f32
    };
    write_npy(&dir.join("own.npy"), [100, 40, 24], samples);
    write_segy(&dir.join("own.sgy"), &SURVEY, samples);
    for file in ["own.npy", "own.sgy"] {
        let job = format!("surface time.vtu --velocity {file} -o s.vtp --json");
        let actual = dip_strike_area(&run(dir, &job));
        assert!((actual[0] - dip).abs() < 0.5, "{file} {actual:?}");
    }
    // One velocity for the whole volume gives another dip.
    let actual = dip_strike_area(&run(
        dir,
        "surface time.vtu --velocity 2200 -o s.vtp --json",
    ));
    assert!((actual[0] - dip).abs() > 3.0, "{actual:?}");

    let file = read_vtu(&dir.join("depth.vtu")).unwrap();
    assert_nodes_on_plane(&file);

    // A mesh of the converted image is the same, and so is a mesh from the configuration.
    run(dir, "convert s.sgy depth.vti --velocity v.vti --quiet");
    let again = "mesh depth.vti --distance 6 --feature ridges --metric shape --quiet -o";
    run(dir, &format!("{again} again.vtu"));
    let config = run(
        dir,
        &format!("{mesh} --metric shape --velocity v.vti --print-config"),
    );
    assert!(config.contains("velocity = \"v.vti\""), "{config}");
    std::fs::write(dir.join("job.toml"), config).unwrap();
    run(dir, "mesh s.sgy --config job.toml --quiet -o config.vtu");
    for other in ["again.vtu", "config.vtu"] {
        let other = read_vtu(&dir.join(other)).unwrap();
        assert_eq!(other.mesh.tets.len(), file.mesh.tets.len());
        for (a, b) in other.mesh.nodes.iter().zip(&file.mesh.nodes) {
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-6), "{a:?} {b:?}");
        }
    }
}

#[test]
fn verbs_refuse_an_image_in_time_with_a_mesh_in_depth() {
    let folder = folder();
    let dir = folder.path();
    let mesh = "mesh s.sgy --distance 6 --feature ridges --quiet --metric shape";
    run(dir, &format!("{mesh} -o depth.vtu --velocity v.vti"));
    run(dir, "convert s.sgy depth.vti --velocity v.vti --quiet");
    // Only `edit` converts it, since the mesh
    // records how.
    for job in [
        "slice s.sgy depth.vtu -o s.png",
        "report s.sgy depth.vtu -o p.html",
        "surface depth.vtu s.sgy -o x.vtp",
        "paint depth.vtu --image s.sgy --seed 600000,6000200,-60 -o x.vtu",
    ] {
        let error = expect_refusal(dir, &job.split_whitespace().collect::<Vec<_>>());
        assert!(
            error.contains("s.sgy: is in two-way time"),
            "{job}: {error}"
        );
        assert!(
            error.contains("convert --velocity v.vti s.sgy"),
            "{job}: {error}"
        );
    }
    run(dir, "slice depth.vti depth.vtu -o s.png --quiet");
    run(
        dir,
        "edit depth.vtu s.sgy -o e.vtu --add 600000,6000200,-60 --quiet",
    );
    run(
        dir,
        "edit depth.vtu depth.vti -o f.vtu --add 600000,6000200,-60 --quiet",
    );
    let [e, f] = ["e.vtu", "f.vtu"].map(|name| read_vtu(&dir.join(name)).unwrap());
    assert_eq!(e.mesh.nodes.len(), f.mesh.nodes.len());
}

#[test]
fn one_trace_of_velocities_converts_a_flow_model_to_metres() {
    let folder = folder();
    let dir = folder.path();
    write_npy(&dir.join("one.npy"), [1, 1, 5], |[_, _, t]| {
        1800.0 + 150.0 * t as f32
    });
    run(
        dir,
        "convert one.npy one.vti --spacing 1,1,100 --unit m,m,ms --quiet",
    );
    run(
        dir,
        "mesh s.sgy --distance 9 --feature ridges --quiet -o time.vtu",
    );
    let flow = "--pressure ymin=2e5 --pressure ymax=1e5 --faults open -o flow.vtu --json";
    let report = json(&run(
        dir,
        &format!("flow time.vtu --velocity one.vti {flow}"),
    ));
    // Darcy: k / viscosity times pressure difference over length, times the width and the depth of
    // 396 ms.
    let max_depth = 900.0 * 0.396 + 375.0 * 0.396 * 0.396;
    let expected = 1e-13 / 1e-3 * 1e5 / (39.0 * 12.5) * (23.0 * 25.0) * max_depth;
    let rate = report["solver"]["throughput"].as_f64().unwrap();
    assert!((rate / expected - 1.0).abs() < 1e-4, "{rate} {expected}");
    let file = read_vtu(&dir.join("flow.vtu")).unwrap();
    let low = file.mesh.nodes.iter().fold(0.0f64, |low, x| low.min(x[2]));
    assert!((low + max_depth).abs() < 1e-3, "{low} {max_depth}");
    let volume = file.cell_array("volume").unwrap().values.to_f64();
    let box_volume = 39.0 * 12.5 * 23.0 * 25.0 * max_depth;
    assert!((volume.iter().sum::<f64>() / box_volume - 1.0).abs() < 1e-4);
    let error = expect_refusal(dir, &["slice", "s.sgy", "flow.vtu", "-o", "s.png"]);
    assert!(error.contains("in depth by one.vti"), "{error}");

    // A uniform volume of velocities has the effect of one number. Distances from a file are on the
    // grid in time.
    write_velocities(dir, "same", |_, _| 2000.0);
    write_npy(&dir.join("d.npy"), [100, 40, 24], |[t, _, _]| {
        8.0 + t as f32 / 25.0
    });
    let mesh = "mesh s.sgy --distance 8:12 --distance-from d.npy --feature ridges --metric shape --quiet -o";
    run(dir, &format!("{mesh} a.vtu --velocity 2000"));
    run(dir, &format!("{mesh} b.vtu --velocity same.vti"));
    let [a, b] = ["a.vtu", "b.vtu"].map(|name| read_vtu(&dir.join(name)).unwrap());
    assert_eq!(a.mesh.nodes.len(), b.mesh.nodes.len());
    for (a, b) in a.mesh.nodes.iter().zip(&b.mesh.nodes) {
        // A sample is 4 m.
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 0.05), "{a:?} {b:?}");
    }
}

#[test]
fn a_section_is_converted_to_depth() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    // The velocity is 2000 + x with x in m and times in ms. The line is straight in depth:
    // z = 400 + 0.25 x.
    let v = |x: f64| 2000.0 + x;
    write_npy_2d(&dir.join("line.npy"), [60, 120], |[i, j]| {
        let (x, t) = (10.0 * i as f64, 5.0 * j as f64);
        let distance = v(x) * t / 2000.0 - 400.0 - 0.25 * x;
        (-0.5 * (distance / 8.0).powi(2)).exp() as f32
    });
    write_npy_2d(&dir.join("v.npy"), [4, 2], |[i, _]| {
        v(200.0 * i as f64) as f32
    });
    run(
        dir,
        "convert line.npy line.vti --spacing 10,5 --unit m,ms --quiet",
    );
    run(
        dir,
        "convert v.npy v.vti --spacing 200,600 --unit m,ms --quiet",
    );
    let mesh = "mesh line.vti --distance 6 --feature ridges --quiet -o";
    run(dir, &format!("{mesh} time.vtu"));
    run(dir, &format!("{mesh} depth.vtu --velocity v.vti"));
    for job in ["depth.vtu", "time.vtu --velocity v.vti"] {
        let report = json(&run(dir, &format!("surface {job} -o s.vtp --json")));
        let dip = report["surfaces"][0]["dip"].as_f64().unwrap();
        assert!(
            (dip - 0.25f64.atan().to_degrees()).abs() < 0.3,
            "{job} {dip}"
        );
    }
}

#[test]
fn unusable_velocities_are_refused() {
    let folder = folder();
    let dir = folder.path();
    write_npy_2d(&dir.join("flat.npy"), [9, 10], |_| 2000.0);
    write_npy(&dir.join("d.npy"), [100, 40, 23], |_| 8.0);
    run(
        dir,
        "convert v.npy far.vti --spacing 100,100,100 --unit m,m,ms --quiet",
    );
    run(
        dir,
        "convert v.npy deep.vti --spacing 100,100,100 --unit m --quiet",
    );
    for (velocity, expected) in [
        ("absent.sgy", "absent.sgy: "),
        (
            "v.npy",
            "v.npy: does not say where its velocities lie in two-way time",
        ),
        ("flat.npy", "--velocity flat.npy: is not a 3-D image"),
        ("far.vti", "far.vti: lies elsewhere"),
        (
            "deep.vti",
            "deep.vti: does not say where its velocities lie in two-way time",
        ),
        ("s.sgy", "s.sgy: "),
    ] {
        for job in ["mesh s.sgy -o x.vtu", "convert s.sgy x.vti"] {
            let job = format!("{job} --velocity {velocity}");
            let error = expect_refusal(dir, &job.split_whitespace().collect::<Vec<_>>());
            assert!(error.contains(expected), "{expected}: {error}");
        }
    }
    for (job, expected) in [
        (
            "mesh v.npy --velocity v.vti -o x.vtu",
            "--velocity v.vti: converts two-way time to depth, but no",
        ),
        (
            "convert s.sgy v.vti --velocity v.vti",
            "would overwrite an input",
        ),
        (
            "mesh s.sgy --velocity v.vti --distance 8:12 --distance-from d.npy -o x.vtu",
            "--distance-from: has [100, 40, 23] samples",
        ),
    ] {
        let error = expect_refusal(dir, &job.split_whitespace().collect::<Vec<_>>());
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[test]
fn angles_are_not_measured_in_mixed_units() {
    let folder = folder();
    let dir = folder.path();
    let mesh = "mesh s.sgy --distance 9 --feature ridges --json -o m.vtu";
    let time = json(&run(dir, mesh));
    assert_eq!(time["quality_physical"], Value::Null);
    assert!(time["quality"]["smallest_angle"]["worst"].is_number());
    let depth = json(&run(dir, &format!("{mesh} --velocity 2000")));
    assert!(depth["quality_physical"]["smallest_angle"]["worst"].is_number());
    let mesh = format!("{mesh} --cells voronoi");
    let time = json(&run(dir, &mesh));
    assert_eq!(time["voronoi"]["angle_physical"], Value::Null);
    let depth = json(&run(dir, &format!("{mesh} --velocity 2000")));
    assert!(depth["voronoi"]["angle_physical"][0].is_number());
}
