//! `--velocity FILE` as a user gives it: a survey in two-way time, and interval velocities on a coarser grid.

use std::path::Path;

use crate::common::{Survey, expect_refusal, run, write_npy, write_npy_2d, write_segy};
use atomesh::store::read_vtu;
use serde_json::Value;

const SURVEY: Survey = Survey {
    inlines: 24,
    crosslines: 40,
    samples: 100,
};

/// How far a place lies along the crosslines' axis.
fn along([x, y]: [f64; 2]) -> f64 {
    0.8 * (x - 600_000.0) + 0.6 * (y - 6_000_000.0)
}

/// Metres a second there, at a time in ms.
fn velocity(at: [f64; 2], t: f64) -> f64 {
    1800.0 + 0.8 * along(at) + 1.5 * t
}

/// The integral of half of it.
fn depth(at: [f64; 2], t: f64) -> f64 {
    let t = 1e-3 * t;
    velocity(at, 0.0) * t / 2.0 + 1500.0 * t * t / 4.0
}

/// Of the plane that the survey shows.
const SLOPE: f64 = 0.4;

/// A folder with `s.sgy`, which shows a plane in depth as it looks in time, and its velocities `v.vti`.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_segy(&at.join("s.sgy"), &SURVEY, |[sample, crossline, inline]| {
        let place = SURVEY.position(inline, crossline);
        let off = depth(place, 4.0 * sample as f64) - 200.0 - SLOPE * (along(place) - 250.0);
        (-0.5 * (off / 6.0).powi(2)).exp() as f32
    });
    grid(at, "v", velocity);
    folder
}

/// Velocities every 100 m and 100 ms, as `name.npy` and placed as `name.vti`; time grows downwards, while
/// that of SEG-Y falls.
fn grid(at: &Path, name: &str, v: impl Fn([f64; 2], f64) -> f64) {
    write_npy(&at.join(format!("{name}.npy")), [9, 10, 5], |[x, y, t]| {
        let place = [599_600.0 + 100.0 * x as f64, 5_999_900.0 + 100.0 * y as f64];
        v(place, 100.0 * t as f64) as f32
    });
    let placed = "--spacing 100,100,100 --origin 599600,5999900,0 --unit m,m,ms";
    run(
        at,
        &format!("convert {name}.npy {name}.vti {placed} --quiet"),
    );
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

/// The largest surface: dip and strike in degrees, area in square metres.
fn plane(said: &str) -> [f64; 3] {
    let said = json(said);
    ["dip", "strike", "area"].map(|name| said["surfaces"][0][name].as_f64().unwrap())
}

#[test]
fn a_file_of_velocities_makes_true_depth() {
    let folder = folder();
    let at = folder.path();
    let mesh = "mesh s.sgy --distance 6 --feature ridges --quiet";
    run(at, &format!("{mesh} -o time.vtu"));
    let said = json(&run(
        at,
        &format!("{mesh} --metric shape -o depth.vtu --velocity v.vti --json"),
    ));
    let note = said["notes"].to_string();
    assert!(
        note.contains("converted to depth with v.vti: 0.0 to 4"),
        "{note}"
    );
    assert!(note.contains("% of the image is cut off"), "{note}");
    // What was read, not what it became.
    assert_eq!(said["input"]["dims"], serde_json::json!([100, 40, 24]));

    let dip = SLOPE.atan().to_degrees();
    let area = 39.0 * 12.5 * 23.0 * 25.0 / SLOPE.atan().cos();
    for job in [
        "surface depth.vtu -o s.vtp --json",
        "surface time.vtu --velocity v.vti -o s.vtp --json",
    ] {
        let found = plane(&run(at, job));
        assert!((found[0] - dip).abs() < 0.5, "{job} {found:?} {dip}");
        // It dips towards the end of the crosslines.
        assert!((found[1] - 323.13).abs() < 1.0, "{job} {found:?}");
        assert!(
            (found[2] / area - 1.0).abs() < 0.03,
            "{job} {found:?} {area}"
        );
    }
    // On the image's own grid: a bare array of as many samples lies where the image does.
    let own = |[sample, crossline, inline]: [usize; 3]| {
        velocity(SURVEY.position(inline, crossline), 4.0 * sample as f64) as f32
    };
    write_npy(&at.join("own.npy"), [100, 40, 24], own);
    write_segy(&at.join("own.sgy"), &SURVEY, own);
    for own in ["own.npy", "own.sgy"] {
        let job = format!("surface time.vtu --velocity {own} -o s.vtp --json");
        let found = plane(&run(at, &job));
        assert!((found[0] - dip).abs() < 0.5, "{own} {found:?}");
    }
    // One velocity for all makes another dip of it.
    let found = plane(&run(at, "surface time.vtu --velocity 2200 -o s.vtp --json"));
    assert!((found[0] - dip).abs() > 3.0, "{found:?}");

    // Each node on the plane lies there.
    let file = read_vtu(&at.join("depth.vtu")).unwrap();
    let feature = file
        .point_data
        .iter()
        .find(|a| a.name == "feature")
        .unwrap();
    let (mut on, mut off) = (0.0, 0.0f64);
    for (x, b) in file.mesh.nodes.iter().zip(feature.values.to_f64()) {
        if b < -0.95 {
            let plane = 200.0 + SLOPE * (along([x[0], x[1]]) - 250.0);
            (on, off) = (on + 1.0, off + (-x[2] - plane).powi(2));
        }
    }
    // A sample is 3.6 m.
    assert!(
        on > 100.0 && (off / on).sqrt() < 0.7,
        "{on} {}",
        (off / on).sqrt()
    );

    // The depth image itself is what was meshed; and a mesh may be made again from its configuration.
    run(at, "convert s.sgy depth.vti --velocity v.vti --quiet");
    let again = "mesh depth.vti --distance 6 --feature ridges --metric shape --quiet -o";
    run(at, &format!("{again} again.vtu"));
    let config = run(
        at,
        &format!("{mesh} --metric shape --velocity v.vti --print-config"),
    );
    assert!(config.contains("velocity = \"v.vti\""), "{config}");
    std::fs::write(at.join("job.toml"), config).unwrap();
    run(at, "mesh s.sgy --config job.toml --quiet -o config.vtu");
    for other in ["again.vtu", "config.vtu"] {
        let other = read_vtu(&at.join(other)).unwrap();
        assert_eq!(other.mesh.tets.len(), file.mesh.tets.len());
        for (a, b) in other.mesh.nodes.iter().zip(&file.mesh.nodes) {
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-6), "{a:?} {b:?}");
        }
    }

    // Beside the mesh an image in time is of no use, but for an edit, which knows what was done with it.
    for job in [
        "slice s.sgy depth.vtu -o s.png",
        "report s.sgy depth.vtu -o p.html",
        "surface depth.vtu s.sgy -o x.vtp",
        "paint depth.vtu --image s.sgy --seed 600000,6000200,-60 -o x.vtu",
    ] {
        let said = expect_refusal(at, &job.split_whitespace().collect::<Vec<_>>());
        assert!(said.contains("s.sgy: is in two-way time"), "{job}: {said}");
        assert!(
            said.contains("convert --velocity v.vti s.sgy"),
            "{job}: {said}"
        );
    }
    run(at, "slice depth.vti depth.vtu -o s.png --quiet");
    run(
        at,
        "edit depth.vtu s.sgy -o e.vtu --add 600000,6000200,-60 --quiet",
    );
    run(
        at,
        "edit depth.vtu depth.vti -o f.vtu --add 600000,6000200,-60 --quiet",
    );
    let [e, f] = ["e.vtu", "f.vtu"].map(|name| read_vtu(&at.join(name)).unwrap());
    assert_eq!(e.mesh.nodes.len(), f.mesh.nodes.len());
}

#[test]
fn one_trace_of_velocities_makes_metres_of_a_flow() {
    let folder = folder();
    let at = folder.path();
    write_npy(&at.join("one.npy"), [1, 1, 5], |[_, _, t]| {
        1800.0 + 150.0 * t as f32
    });
    run(
        at,
        "convert one.npy one.vti --spacing 1,1,100 --unit m,m,ms --quiet",
    );
    run(
        at,
        "mesh s.sgy --distance 9 --feature ridges --quiet -o time.vtu",
    );
    let flow = "--pressure ymin=2e5 --pressure ymax=1e5 --faults open -o flow.vtu --json";
    let said = json(&run(
        at,
        &format!("flow time.vtu --velocity one.vti {flow}"),
    ));
    // K / viscosity times pressure over length, times width and the depth of 396 ms.
    let deep = 900.0 * 0.396 + 375.0 * 0.396 * 0.396;
    let want = 1e-13 / 1e-3 * 1e5 / (39.0 * 12.5) * (23.0 * 25.0) * deep;
    let rate = said["solver"]["throughput"].as_f64().unwrap();
    assert!((rate / want - 1.0).abs() < 1e-4, "{rate} {want}");
    let file = read_vtu(&at.join("flow.vtu")).unwrap();
    let low = file.mesh.nodes.iter().fold(0.0f64, |low, x| low.min(x[2]));
    assert!((low + deep).abs() < 1e-3, "{low} {deep}");
    let volume = file.cell_array("volume").unwrap().values.to_f64();
    let whole = 39.0 * 12.5 * 23.0 * 25.0 * deep;
    assert!((volume.iter().sum::<f64>() / whole - 1.0).abs() < 1e-4);
    let said = expect_refusal(at, &["slice", "s.sgy", "flow.vtu", "-o", "s.png"]);
    assert!(said.contains("in depth by one.vti"), "{said}");

    // A volume that is the same everywhere does what the number does; distances lie on the grid in time.
    grid(at, "same", |_, _| 2000.0);
    write_npy(&at.join("d.npy"), [100, 40, 24], |[t, _, _]| {
        8.0 + t as f32 / 25.0
    });
    let mesh = "mesh s.sgy --distance 8:12 --distance-from d.npy --feature ridges --metric shape --quiet -o";
    run(at, &format!("{mesh} a.vtu --velocity 2000"));
    run(at, &format!("{mesh} b.vtu --velocity same.vti"));
    let [a, b] = ["a.vtu", "b.vtu"].map(|name| read_vtu(&at.join(name)).unwrap());
    assert_eq!(a.mesh.nodes.len(), b.mesh.nodes.len());
    for (a, b) in a.mesh.nodes.iter().zip(&b.mesh.nodes) {
        // A sample is 4 m.
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 0.05), "{a:?} {b:?}");
    }
}

#[test]
fn a_section_comes_to_lie_in_depth() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // v = 2000 + x, in m and ms; the line is straight in depth: z = 400 + 0.25 x.
    let v = |x: f64| 2000.0 + x;
    write_npy_2d(&at.join("line.npy"), [60, 120], |[i, j]| {
        let (x, t) = (10.0 * i as f64, 5.0 * j as f64);
        let off = v(x) * t / 2000.0 - 400.0 - 0.25 * x;
        (-0.5 * (off / 8.0).powi(2)).exp() as f32
    });
    write_npy_2d(&at.join("v.npy"), [4, 2], |[i, _]| {
        v(200.0 * i as f64) as f32
    });
    run(
        at,
        "convert line.npy line.vti --spacing 10,5 --unit m,ms --quiet",
    );
    run(
        at,
        "convert v.npy v.vti --spacing 200,600 --unit m,ms --quiet",
    );
    let mesh = "mesh line.vti --distance 6 --feature ridges --quiet -o";
    run(at, &format!("{mesh} time.vtu"));
    run(at, &format!("{mesh} depth.vtu --velocity v.vti"));
    for job in ["depth.vtu", "time.vtu --velocity v.vti"] {
        let said = json(&run(at, &format!("surface {job} -o s.vtp --json")));
        let dip = said["surfaces"][0]["dip"].as_f64().unwrap();
        assert!(
            (dip - 0.25f64.atan().to_degrees()).abs() < 0.3,
            "{job} {dip}"
        );
    }
}

#[test]
fn velocities_that_make_no_depth_are_refused() {
    let folder = folder();
    let at = folder.path();
    write_npy_2d(&at.join("flat.npy"), [9, 10], |_| 2000.0);
    write_npy(&at.join("d.npy"), [100, 40, 23], |_| 8.0);
    run(
        at,
        "convert v.npy far.vti --spacing 100,100,100 --unit m,m,ms --quiet",
    );
    run(
        at,
        "convert v.npy deep.vti --spacing 100,100,100 --unit m --quiet",
    );
    for (velocity, words) in [
        ("absent.sgy", "absent.sgy: "),
        (
            "v.npy",
            "v.npy: does not say where its velocities lie in two-way time",
        ),
        ("flat.npy", "--velocity flat.npy: is no 3-D image"),
        ("far.vti", "far.vti: lies elsewhere"),
        (
            "deep.vti",
            "deep.vti: does not say where its velocities lie in two-way time",
        ),
        ("s.sgy", "s.sgy: "),
    ] {
        for job in ["mesh s.sgy -o x.vtu", "convert s.sgy x.vti"] {
            let job = format!("{job} --velocity {velocity}");
            let said = expect_refusal(at, &job.split_whitespace().collect::<Vec<_>>());
            assert!(said.contains(words), "{words}: {said}");
        }
    }
    for (job, words) in [
        (
            "mesh v.npy --velocity v.vti -o x.vtu",
            "--velocity v.vti: converts two-way time to depth in metres, but no",
        ),
        (
            "convert s.sgy v.vti --velocity v.vti",
            "would overwrite an input",
        ),
        (
            "mesh s.sgy --velocity v.vti --distance 8:12 --distance-from d.npy -o x.vtu",
            "--distance-from: is of [100, 40, 23] samples",
        ),
    ] {
        let said = expect_refusal(at, &job.split_whitespace().collect::<Vec<_>>());
        assert!(said.contains(words), "{words}: {said}");
    }
}

#[test]
fn angles_are_measured_in_no_space_that_mixes_metres_and_milliseconds() {
    let folder = folder();
    let at = folder.path();
    let mesh = "mesh s.sgy --distance 9 --feature ridges --json -o m.vtu";
    let time = json(&run(at, mesh));
    assert_eq!(time["quality_physical"], Value::Null);
    assert!(time["quality"]["smallest_angle"]["worst"].is_number());
    let depth = json(&run(at, &format!("{mesh} --velocity 2000")));
    assert!(depth["quality_physical"]["smallest_angle"]["worst"].is_number());
    let mesh = format!("{mesh} --cells voronoi");
    let time = json(&run(at, &mesh));
    assert_eq!(time["voronoi"]["angle_physical"], Value::Null);
    let depth = json(&run(at, &format!("{mesh} --velocity 2000")));
    assert!(depth["voronoi"]["angle_physical"][0].is_number());
}
