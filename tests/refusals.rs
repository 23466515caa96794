//! Tests bad input: each gives one clear error line and exit code 1, and leaves no files.

use std::path::Path;

use crate::common::{
    Survey, atomesh, expect_refusal, planar_fault, run_args, write_npy, write_segy,
};

const DIMS: [usize; 3] = [40, 36, 32];

/// Returns a folder with a valid image, `good.npy`.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_npy(&folder.path().join("good.npy"), DIMS, planar_fault(DIMS));
    folder
}

fn assert_contains(line: &str, words: &[&str]) {
    for word in words {
        assert!(
            line.to_lowercase().contains(&word.to_lowercase()),
            "no '{word}' in: {line}"
        );
    }
}

#[test]
fn samples_that_are_not_finite() {
    let folder = folder();
    for (name, value) in [("nan.npy", f32::NAN), ("infinite.npy", f32::NEG_INFINITY)] {
        let good = planar_fault(DIMS);
        // A single such sample is a gap, so the other samples must differ from it.
        write_npy(&folder.path().join(name), DIMS, |_| value);
        assert_contains(&expect_refusal(folder.path(), &["mesh", name]), &[name]);
        write_npy(&folder.path().join(name), DIMS, |index| {
            if index == [3, 4, 5] {
                value
            } else {
                good(index).round()
            }
        });
        let potential = ["mesh", name, "--feature", "potential"];
        assert_contains(&expect_refusal(folder.path(), &potential), &["[3, 4, 5]"]);
    }
}

#[test]
fn sliver_options_without_tetrahedra() {
    let folder = folder();
    let cells = [
        "mesh",
        "good.npy",
        "--cells",
        "voronoi",
        "--slivers",
        "exude",
    ];
    assert_contains(
        &expect_refusal(folder.path(), &cells),
        &["--slivers", "voronoi"],
    );
    let plane = ["synth", "planes", "--dims", "64,64", "-o", "plane.npy"];
    run_args(folder.path(), &plane);
    let plane = ["mesh", "plane.npy", "--slivers", "exude"];
    assert_contains(
        &expect_refusal(folder.path(), &plane),
        &["--slivers", "2-D"],
    );
}

#[test]
fn a_constant_image() {
    let folder = folder();
    write_npy(&folder.path().join("flat.npy"), DIMS, |_| 7.0);
    assert_contains(
        &expect_refusal(folder.path(), &["mesh", "flat.npy"]),
        &["flat.npy", "7"],
    );
}

#[test]
fn a_side_shorter_than_two_distances() {
    let folder = folder();
    assert_contains(
        &expect_refusal(folder.path(), &["mesh", "good.npy", "--distance", "20"]),
        &["20", "31"],
    );
    write_npy(
        &folder.path().join("thin.npy"),
        [64, 64, 3],
        planar_fault([64, 64, 3]),
    );
    expect_refusal(folder.path(), &["mesh", "thin.npy", "--distance", "3"]);
}

#[test]
fn impossible_distances() {
    let folder = folder();
    for distance in ["0", "-3", "nan", "1e9", "eight", "8:4", "0:4"] {
        let line = expect_refusal(
            folder.path(),
            &[
                "mesh",
                "good.npy",
                &format!("--distance={distance}"),
                "--distance-from",
                "features",
            ],
        );
        assert_contains(&line, &["distance"]);
    }
}

#[test]
fn files_that_are_no_images() {
    let folder = folder();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    let good = std::fs::read(folder.path().join("good.npy")).unwrap();
    write("empty.npy", b"");
    write("empty.sgy", b"");
    write("cut.npy", &good[..good.len() - 5]);
    write("head.npy", &good[..20]);
    write(
        "magic.npy",
        b"this is not a volume, it is a sentence of some length\n",
    );
    write("huge.npy", &{
        let mut bytes = b"\x93NUMPY\x01\x00v\x00".to_vec();
        let header = "{'descr': '<f4', 'fortran_order': False, \
                      'shape': (4294967296, 4294967296, 4294967296), }";
        bytes.extend(format!("{header:<117}\n").bytes());
        bytes
    });
    for name in [
        "empty.npy",
        "empty.sgy",
        "cut.npy",
        "head.npy",
        "magic.npy",
        "huge.npy",
        "absent.npy",
    ] {
        for verb in ["mesh", "info"] {
            assert_contains(&expect_refusal(folder.path(), &[verb, name]), &[name]);
        }
    }
    std::fs::write(folder.path().join("l.vtp"), "not a mesh").unwrap();
    assert_contains(
        &expect_refusal(folder.path(), &["quality", "l.vtp", "--lines", "./l.vtp"]),
        &["--lines", "overwrite"],
    );
    assert_contains(
        &expect_refusal(
            folder.path(),
            &["mesh", "good.npy", "--raw", "40x36x32:f99"],
        ),
        &["f99"],
    );
    write("bare.raw", &[0; 100]);
    expect_refusal(folder.path(), &["mesh", "bare.raw", "--raw", "10x10x10:u8"]);
    expect_refusal(
        folder.path(),
        &[
            "mesh",
            "bare.raw",
            "--raw",
            "99999999999x99999999999x99999999999:u8",
        ],
    );
}

#[test]
fn seg_y_without_a_volume_in_it() {
    let folder = folder();
    let survey = Survey {
        inlines: 3,
        crosslines: 3,
        samples: 40,
    };
    let path = folder.path().join("survey.sgy");
    write_segy(&path, &survey, |_| 1.0);
    let bytes = std::fs::read(&path).unwrap();
    let trace = 240 + 4 * survey.samples;
    for (name, length) in [
        ("none.sgy", 3600),
        ("one.sgy", 3600 + trace),
        ("cut.sgy", 3600 + 5 * trace / 2),
    ] {
        std::fs::write(folder.path().join(name), &bytes[..length]).unwrap();
        assert_contains(&expect_refusal(folder.path(), &["mesh", name]), &[name]);
    }
    // The command line calls the option --inline-byte, not by the name of the library.
    let bytes = ["--inline-byte", "13", "--crossline-byte", "17"];
    let line = expect_refusal(
        folder.path(),
        &[&["mesh", "survey.sgy"][..], &bytes].concat(),
    );
    assert_contains(&line, &["inline and crossline numbers", "--inline-byte"]);
    assert!(!line.contains("--segy-bytes"), "{line}");
    // The file has no trace headers.
    for byte in ["--inline-byte", "--delay-byte"] {
        let line = expect_refusal(folder.path(), &["mesh", "good.npy", byte, "9"]);
        assert_contains(&line, &[byte, "SEG-Y", "good.npy"]);
    }
}

#[test]
fn outputs_that_overwrite_inputs_of_other_options() {
    let folder = folder();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("job.vtu", "sigma = 2\n");
    let config = ["mesh", "good.npy", "--config", "job.vtu", "-o", "./job.vtu"];
    assert_contains(
        &expect_refusal(folder.path(), &config),
        &["job.vtu", "overwrite"],
    );
    write_npy(&folder.path().join("d.vtu"), DIMS, |_| 6.0);
    let mesh = ["mesh", "good.npy", "--distance", "4:8"];
    let from = ["--distance-from", "d.vtu", "-o", "./d.vtu"];
    let line = expect_refusal(folder.path(), &[&mesh[..], &from].concat());
    assert_contains(&line, &["d.vtu", "overwrite"]);
}

#[test]
fn options_without_an_effect() {
    let folder = folder();
    let mesh = |extra: &str| {
        let extra: Vec<&str> = extra.split_whitespace().collect();
        expect_refusal(folder.path(), &[&["mesh", "good.npy"][..], &extra].concat())
    };
    for (extra, name) in [
        ("--seeding canny --beta 0.2", "--beta 0.2"),
        ("--seeding canny --potential sampled", "--evaluator sampled"),
        ("--feature labels --threshold 0.5", "--threshold 0.5"),
        ("--object 1,2,3", "--object"),
        ("--feature-weights 1,0.5", "--feature-weights 1,0.5"),
        ("--min-dihedral 20 --slivers none", "--min-dihedral 20"),
        (
            "--effort draft --seeding canny --slivers none",
            "--effort draft",
        ),
    ] {
        assert_contains(&mesh(extra), &[name]);
    }
    // A configuration file is checked as the command line is, and the error names the file.
    std::fs::write(folder.path().join("job.toml"), "kappa = 0.7\n").unwrap();
    let line = mesh("--config job.toml --seeding canny");
    assert_contains(&line, &["job.toml: kappa 0.7"]);
    assert_contains(
        &mesh("--config job.toml --seeding canny --kappa 0.6"),
        &["--kappa 0.6"],
    );
}

#[test]
fn impossible_outputs() {
    let folder = folder();
    let mesh =
        |extra: &[&str]| expect_refusal(folder.path(), &[&["mesh", "good.npy"], extra].concat());
    assert_contains(&mesh(&["-o", "absent/m.vtu"]), &["absent"]);
    assert_contains(&mesh(&["--report", "absent/r.json"]), &["absent"]);
    assert_contains(&mesh(&["--potential-out", "absent/b.vti"]), &["absent"]);
    assert_contains(&mesh(&["--trace", "absent/t.pvd"]), &["absent"]);
    assert_contains(&mesh(&["--lines", "absent/l.vtp"]), &["absent"]);
    assert_contains(&mesh(&["--lines", "l.vtu"]), &["--lines", ".vtp"]);
    assert_contains(
        &mesh(&["--lines", "l.vtp", "--cells", "voronoi"]),
        &["--lines", "Voronoi cells"],
    );
    assert_contains(&mesh(&["-o", "m.stl"]), &["m.stl", ".vtu"]);
    assert_contains(&mesh(&["-o", "."]), &["."]);
    assert_contains(
        &mesh(&["--report", "same.vtu", "-o", "same.vtu"]),
        &["same.vtu"],
    );
    // The output is the input file under another path.
    std::fs::rename(
        folder.path().join("good.npy"),
        folder.path().join("good.vtu"),
    )
    .unwrap();
    assert_contains(
        &expect_refusal(folder.path(), &["mesh", "good.vtu"]),
        &["good.vtu"],
    );
    assert_contains(
        &expect_refusal(folder.path(), &["mesh", "good.vtu", "-o", "./good.vtu"]),
        &["good.vtu"],
    );
}

#[test]
fn impossible_parameters() {
    let folder = folder();
    for (option, value) in [
        ("--beta", "1.5"),
        ("--beta", "nan"),
        ("--beta", "absent.npy"),
        ("--min-dihedral", "80"),
        ("--min-dihedral", "-1"),
        ("--metric", "1,1"),
        ("--metric", "1,0,1"),
        ("--metric", "feet"),
        ("--sigma", "0"),
        ("--sigma", "nan"),
        ("--threshold", "inf"),
        ("--threads", "0"),
        ("--coarse-to-fine", "99"),
        ("--config", "absent.toml"),
        ("--inline-byte", "0"),
        ("--inline-byte", "241"),
    ] {
        let line = expect_refusal(
            folder.path(),
            &["mesh", "good.npy", &format!("{option}={value}")],
        );
        assert_contains(&line, &[value]);
    }
}

#[test]
fn impossible_weights_of_features() {
    let folder = folder();
    for weights in [
        "1", "1,0", "0,1", "1,2", "1,-0.5", "1,nan", "1,1,1", "one,two", "",
    ] {
        let option = format!("--feature-weights={weights}");
        let job: [&[&str]; 2] = [
            &["mesh", "good.npy"],
            &["feature", "good.npy", "-o", "b.vti"],
        ];
        for job in job {
            let line = expect_refusal(
                folder.path(),
                &[job, &["--feature", "faults+horizons", &option]].concat(),
            );
            assert_contains(&line, &["--feature-weights", weights, "1,0.5"]);
        }
    }
}

#[test]
fn unusable_distance_files() {
    let folder = folder();
    std::fs::write(folder.path().join("text.npy"), "no distances").unwrap();
    write_npy(&folder.path().join("nan.npy"), DIMS, |_| f32::NAN);
    write_npy(&folder.path().join("zero.npy"), DIMS, |_| 0.0);
    let fewer = DIMS.map(|n| n - 1);
    write_npy(&folder.path().join("fewer.npy"), fewer, |_| 5.0);
    for (distance, from, words) in [
        ("4:8", "absent.npy", ["absent.npy", "--distance-from"]),
        ("4:8", "picture", ["picture", "--distance-from"]),
        ("4", "features", ["4", "MIN:MAX"]),
        ("8:4", "features", ["8:4", "--distance"]),
        ("4:8", "text.npy", ["text.npy", ""]),
        ("4:8", "nan.npy", ["nan", "distance"]),
        ("4:8", "zero.npy", ["0", "positive"]),
        (
            "4:8",
            "fewer.npy",
            ["samples, but the image has", "one distance per sample"],
        ),
    ] {
        let options = ["--distance", distance, "--distance-from", from];
        let line = expect_refusal(
            folder.path(),
            &[&["mesh", "good.npy"][..], &options].concat(),
        );
        assert_contains(&line, &words);
    }
}

#[test]
fn faulty_configuration_files() {
    let folder = folder();
    for (text, word) in [
        ("distanse = 8", "distanse"),
        ("distance = true", "a text, a number or a list"),
        ("distance = [8, 9, 10]", "not a finite number"),
        ("feature = \"everything\"", "everything"),
        ("distance = ", "1"),
    ] {
        std::fs::write(folder.path().join("job.toml"), text).unwrap();
        let line = expect_refusal(folder.path(), &["mesh", "good.npy", "--config", "job.toml"]);
        assert_contains(&line, &["job.toml", word]);
    }
}

#[test]
fn impossible_fixed_atoms() {
    let folder = folder();
    for (text, word) in [
        ("5,5,5\n6,6,6\n5,5,5\n", "3"),
        ("500,5,5\n", "outside"),
        ("5,5\n", "2 columns"),
        ("x,y,z\n5,5,deep\n", "deep"),
    ] {
        std::fs::write(folder.path().join("wells.csv"), text).unwrap();
        let line = expect_refusal(
            folder.path(),
            &["mesh", "good.npy", "--atoms-from", "wells.csv"],
        );
        assert_contains(&line, &["wells.csv", word]);
    }
}

#[test]
fn files_that_are_no_meshes() {
    let folder = folder();
    std::fs::write(folder.path().join("text.vtu"), "not a mesh").unwrap();
    std::fs::write(folder.path().join("empty.vtu"), "").unwrap();
    for name in ["text.vtu", "empty.vtu", "absent.vtu", "good.npy"] {
        for verb in ["quality", "validate"] {
            assert_contains(&expect_refusal(folder.path(), &[verb, name]), &[name]);
        }
    }
}

/// Writes a cube of six tetrahedra around its diagonal, or several copies of it, after `spoil` has
/// changed its points and tetrahedra.
fn cube(path: &Path, size: f64, copies: u32, spoil: impl Fn(&mut Vec<f64>, &mut Vec<[u32; 4]>)) {
    let corner = |i: u32| (0..3).map(move |k| size * f64::from(i >> k & 1));
    let mut points: Vec<f64> = (0..8 * copies).flat_map(|i| corner(i % 8)).collect();
    let cycle = [1, 3, 2, 6, 4, 5, 1];
    let tets =
        |copy: u32| (cycle.windows(2)).map(move |w| [0, w[0], w[1], 7].map(|n| n + 8 * copy));
    let mut tets: Vec<[u32; 4]> = (0..copies).flat_map(tets).collect();
    spoil(&mut points, &mut tets);
    let array = |kind: &str, name: &str, parts: usize, values: Vec<String>| {
        format!(
            "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{parts}\" \
             format=\"ascii\">{}</DataArray>",
            values.join(" ")
        )
    };
    let text = format!(
        "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid><Piece NumberOfPoints=\"{}\" \
         NumberOfCells=\"{}\"><Points>{}</Points><Cells>{}{}{}</Cells></Piece>\
         </UnstructuredGrid></VTKFile>",
        points.len() / 3,
        tets.len(),
        array(
            "Float64",
            "Points",
            3,
            points.iter().map(f64::to_string).collect()
        ),
        array(
            "Int32",
            "connectivity",
            1,
            tets.iter().flatten().map(u32::to_string).collect()
        ),
        array(
            "Int32",
            "offsets",
            1,
            (1..=tets.len()).map(|c| (4 * c).to_string()).collect()
        ),
        array("UInt8", "types", 1, vec!["10".into(); tets.len()]),
    );
    std::fs::write(path, text).unwrap();
}

#[test]
fn invalid_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    cube(&dir.join("good.vtu"), 4.0, 1, |_, _| {});
    run_args(dir, &["validate", "good.vtu"]);
    run_args(
        dir,
        &["export", "good.vtu", "--to", "msh", "-o", "good.msh"],
    );
    cube(&dir.join("nan.vtu"), 4.0, 1, |points, _| {
        points[4] = f64::NAN
    });
    cube(&dir.join("turned.vtu"), 4.0, 1, |_, tets| {
        tets[2].swap(0, 1)
    });
    cube(&dir.join("twice.vtu"), 4.0, 2, |_, _| {});
    cube(&dir.join("holed.vtu"), 4.0, 1, |_, tets| tets.truncate(5));
    // The volumes exceed the range of floating-point numbers.
    cube(&dir.join("huge.vtu"), 1e150, 1, |_, _| {});
    cube(&dir.join("flat.vtu"), 4.0, 1, |points, _| {
        points.iter_mut().skip(2).step_by(3).for_each(|z| *z = 1.0);
    });
    for (name, checked, exported) in [
        ("nan.vtu", "node 1 is not finite", "node 1 is not finite"),
        (
            "turned.vtu",
            "1 tetrahedra are flat or inverted",
            "number 2 of its tetrahedra",
        ),
        ("twice.vtu", "instead of the box's 64", "overlap"),
        ("holed.vtu", "instead of the box's 64", "cells are missing"),
        ("huge.vtu", "fill inf", "has the volume"),
        ("flat.vtu", "flat or inverted", "flat or inverted"),
    ] {
        assert_contains(&expect_refusal(dir, &["validate", name]), &[name, checked]);
        let export = ["export", name, "--to", "msh", "-o", "x.msh"];
        assert_contains(&expect_refusal(dir, &export), &[name, exported]);
    }
    // Flow is refused also for meshes that a simulator would accept.
    let flow = |name| {
        let pressures = ["--pressure", "xmin=1e5", "--pressure", "xmax=0"];
        [&["flow", name, "-o", "flow.vtu"][..], &pressures].concat()
    };
    run_args(dir, &flow("good.vtu"));
    for (name, problem) in [("twice.vtu", "overlap"), ("holed.vtu", "cells are missing")] {
        assert_contains(&expect_refusal(dir, &flow(name)), &[name, problem]);
    }
}

#[test]
fn impossible_synthetic_volumes() {
    let folder = folder();
    for dims in ["0,5,5", "9", "99999999999,99999999999,99999999999", "a,b,c"] {
        assert_contains(
            &expect_refusal(
                folder.path(),
                &["synth", "faults", "-o", "s.npy", "--dims", dims],
            ),
            &[],
        );
    }
    expect_refusal(
        folder.path(),
        &["synth", "faults", "-o", "s.npy", "--signal-to-noise", "0"],
    );
    expect_refusal(folder.path(), &["synth", "faults", "-o", "absent/s.npy"]);
}

#[test]
fn wrong_usage_is_exit_code_2() {
    let folder = folder();
    for arguments in [
        &["mesh"][..],
        &["mash"],
        &["mesh", "good.npy", "--feature", "nose"],
        &["mesh", "--what"],
    ] {
        let output = atomesh(folder.path()).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!output.stderr.is_empty());
    }
}

/// Tests small memory limits, also those that hardly suffice to load the program, or with which its
/// stack cannot grow.
#[test]
#[cfg(target_os = "linux")]
fn small_memory_limits() {
    let folder = folder();
    let run_with_limit = |kilobytes: usize| {
        let line = format!(
            "ulimit -v {kilobytes}; exec \"$0\" synth planes -o p.npy --dims 99,99 --quiet"
        );
        let mut shell = std::process::Command::new("sh");
        shell.args(["-c", &line, crate::PROGRAM]);
        shell.current_dir(&folder).output().unwrap()
    };
    // There is no exit code if the system has no memory for the program, and the code is 127 if the
    // loader has none.
    let loads =
        |kilobytes: &usize| !matches!(run_with_limit(*kilobytes).status.code(), None | Some(127));
    let first = (10_000..).step_by(250).find(loads).unwrap();
    let mut error_count = 0;
    for kilobytes in (first..first + 6_000).step_by(60) {
        let output = run_with_limit(kilobytes);
        let stderr = String::from_utf8(output.stderr).unwrap();
        match output.status.code() {
            Some(0 | 127) => (),
            Some(1) => {
                error_count += 1;
                assert_eq!(stderr.lines().count(), 1, "{kilobytes}: {stderr}");
                assert!(stderr.starts_with("error: "), "{kilobytes}: {stderr}");
            }
            // Before `main` the runtime may find no memory for its signal stack.
            _ if stderr.contains("failed to allocate an alternative stack") => (),
            other => panic!("{kilobytes} kB: {other:?}, {stderr}"),
        }
    }
    assert!(error_count > 10, "{error_count}");
}

/// Surveys of other projects.
mod real_data {
    use super::*;

    /// Reads the broken and unusual SEG-Y files of other projects: each is read or refused in one
    /// line.
    #[test]
    #[ignore = "needs images made by others: make test-all DATA=folder"]
    fn seg_y_files_of_other_projects() {
        let formats = crate::common::data_path("formats_segy");
        let folder = tempfile::tempdir().unwrap();
        let mut tried = 0;
        for (path, _) in crate::common::files_below(&formats) {
            let output = atomesh(folder.path())
                .arg("info")
                .arg(&path)
                .arg("--quiet")
                .output()
                .unwrap();
            let stderr = String::from_utf8_lossy(&output.stderr);
            let code = output.status.code();
            assert!(
                code == Some(0) || code == Some(1),
                "{}: {code:?} {stderr}",
                path.display()
            );
            assert_eq!(
                stderr.lines().count(),
                usize::from(code == Some(1)),
                "{}: {stderr}",
                path.display()
            );
            tried += 1;
        }
        assert!(tried > 50, "only {tried} files in {}", formats.display());
    }
}
