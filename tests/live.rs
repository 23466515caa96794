//! Tests ground without data: the array `live`, decks, blocks and outlines of images, and layers
//! that pinch out.

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{
    Survey, atomesh, expect_refusal, numbers, run, run_args, run_simulator, run_validator,
    write_npy, write_npy_2d, write_segy,
};

const DIMS: [usize; 3] = [30, 26, 20];
const ROCK: &str = "--permeability 100 --permeability-unit mD --down z --depth-at-top 2000";

/// Returns `true` for the samples inside an ellipse in map view.
fn is_inside([x, y, _]: [usize; 3]) -> bool {
    ((x as f64 - 14.0) / 13.0).powi(2) + ((y as f64 - 12.0) / 12.0).powi(2) < 1.0
}

/// Returns the sum over samples of the part of the box that is nearest to each, times a value.
fn integral(value: impl Fn([usize; 3]) -> f64) -> f64 {
    let [nx, ny, nz] = DIMS;
    let width = |i: usize, n: usize| if i == 0 || i + 1 == n { 0.5 } else { 1.0 };
    let at = |i: usize| [i % nx, i / nx % ny, i / nx / ny];
    let samples = (0..nx * ny * nz).map(at);
    samples
        .map(|p| (0..3).map(|k| width(p[k], DIMS[k])).product::<f64>() * value(p))
        .sum()
}

/// Writes `ragged.npy`, a bright plane in an image without data outside an ellipse.
fn write_ragged(folder: &Path, null: f32) {
    write_npy(&folder.join("ragged.npy"), DIMS, |p| {
        let distance = p[0] as f32 - 13.0 - 0.2 * p[2] as f32;
        let noise = ((p[0] * 7 + p[1] * 13 + p[2] * 29) % 17) as f32 / 100.0;
        if is_inside(p) {
            (-distance * distance / 4.0).exp() + noise
        } else {
            null
        }
    });
}

/// Returns the numbers of a keyword of a deck.
fn keyword(deck: &str, name: &str) -> Vec<f64> {
    let start = deck
        .find(&format!("\n{name}\n"))
        .unwrap_or_else(|| panic!("no {name}"));
    let words = deck[start + name.len() + 2..].split_whitespace();
    let words = words.take_while(|word| *word != "/");
    words
        .flat_map(|word| match word.split_once('*') {
            Some((count, value)) => vec![value.parse().unwrap(); count.parse().unwrap()],
            None => vec![word.parse().unwrap()],
        })
        .collect()
}

/// Runs an export and returns its standard error.
fn notes(folder: &Path, line: &str) -> String {
    let output = atomesh(folder)
        .args(line.split_whitespace())
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{line}\n{stderr}");
    stderr
}

#[test]
fn decks_have_the_pore_volume_of_the_ground_with_data() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let expected = 0.2 * integral(|p| f64::from(u8::from(is_inside(p))));
    for (null, cells) in [(f32::NAN, "voronoi"), (-999.25, "tets")] {
        write_ragged(folder, null);
        run(
            folder,
            &format!(
                "mesh ragged.npy --unit m --feature ridges --cells {cells} --distance 3 --effort draft --quiet -o m.vtu"
            ),
        );
        let found = notes(
            folder,
            &format!("export m.vtu --to opm -o A.DATA --porosity 0.2 {ROCK}"),
        );
        assert!(found.contains("of the ground holds data"), "{found}");
        let deck = std::fs::read_to_string(folder.join("A.DATA")).unwrap();
        let (pores, active) = (keyword(&deck, "PORV"), keyword(&deck, "ACTNUM"));
        let total: f64 = pores.iter().sum();
        assert!(
            (total / expected - 1.0).abs() < 1e-9,
            "{cells}: {total} {expected}"
        );
        for (pores, active) in pores.iter().zip(&active) {
            assert_eq!(*pores > 0.0, *active == 1.0, "{cells}");
        }
        assert!(active.contains(&0.0) && active.contains(&1.0), "{cells}");
    }
    // The resampled grid has the pore volume of its lines.
    run(
        folder,
        &format!("export m.vtu --to grdecl -o B.GRDECL --porosity 0.2 {ROCK} --quiet"),
    );
    let grid = std::fs::read_to_string(folder.join("B.GRDECL")).unwrap();
    assert!(keyword(&grid, "ACTNUM").contains(&0.0));
    assert!(!grid.contains("PINCH"), "no layer pinches out");
}

#[test]
fn images_of_properties_are_averaged_over_what_exists() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let value = |[x, y, _]: [usize; 3]| 0.1 + 0.002 * x as f32 + 0.001 * y as f32;
    write_npy(&folder.join("full.npy"), DIMS, value);
    let scattered = |p: [usize; 3]| (p[0] * 31 + p[1] * 17 + p[2] * 7).is_multiple_of(50);
    write_npy(&folder.join("null.npy"), DIMS, |p| {
        if scattered(p) { -999.25 } else { value(p) }
    });
    write_npy(&folder.join("edge.npy"), DIMS, |p| {
        if p[0] < 9 { 1e30 } else { value(p) }
    });
    write_ragged(folder, 0.5);
    run(
        folder,
        "mesh ragged.npy --unit m --feature none --cells voronoi --distance 5 --effort draft --quiet -o m.vtu",
    );
    let export = |image: &str| {
        let found = notes(
            folder,
            &format!("export m.vtu --to opm -o A.DATA --porosity {image} {ROCK}"),
        );
        (
            std::fs::read_to_string(folder.join("A.DATA")).unwrap(),
            found,
        )
    };
    let (full, _) = export("full.npy");
    let (null, found) = export("null.npy");
    assert!(found.contains("hold -999.25"), "{found}");
    let [full, null] = [full, null].map(|deck| keyword(&deck, "PORO"));
    for (a, b) in full.iter().zip(&null) {
        assert!((a - b).abs() < 0.002, "{a} {b}");
    }
    let (edge, found) = export("edge.npy");
    assert!(found.contains("holds no data in"), "{found}");
    let (poro, active) = (keyword(&edge, "PORO"), keyword(&edge, "ACTNUM"));
    assert!(active.contains(&0.0));
    for (i, active) in active.iter().enumerate() {
        assert_eq!(*active == 0.0, poro[i] == 0.0);
        assert!(
            poro[i] == 0.0 || (0.1..0.2).contains(&poro[i]),
            "{}",
            poro[i]
        );
    }
    // Other properties count as the porosity does.
    let found = notes(
        folder,
        &format!("export m.vtu --to opm -o A.DATA --porosity 0.2 --property phi=edge.npy {ROCK}"),
    );
    assert!(
        found.contains("--property: edge.npy holds no data in"),
        "{found}"
    );
    let line = format!("export m.vtu --to opm -o A.DATA --porosity null.npy --null none {ROCK}");
    let words: Vec<&str> = line.split_whitespace().collect();
    let error = expect_refusal(folder, &words);
    assert!(error.contains("--porosity"), "{error}");
}

#[test]
fn a_cropped_image_gives_the_mesh_of_a_cut_file() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let value = |[x, y, z]: [usize; 3]| {
        let distance = x as f32 - 17.0 - 0.3 * z as f32 - 0.1 * y as f32;
        (-distance * distance / 4.0).exp()
    };
    write_npy(&folder.join("whole.npy"), DIMS, value);
    write_npy(&folder.join("cut.npy"), [22, 20, 14], |[x, y, z]| {
        value([x + 6, y + 2, z + 4])
    });
    let place = "--spacing 10,20,5 --unit m";
    let rest = "--feature ridges --distance 5 --effort draft --quiet";
    run(
        folder,
        &format!("mesh cut.npy {place} --origin 60,40,20 {rest} -o cut.vtu"),
    );
    run(folder, "export cut.vtu --to msh -o cut.msh --quiet");
    let expected = std::fs::read(folder.join("cut.msh")).unwrap();
    for ranges in [
        "x=60:270,y=40:420,z=20:85",
        "z=85:20,y=35:429,x=51:279",
        "i=6:27,j=2:21,k=4:17",
    ] {
        run(
            folder,
            &format!("mesh whole.npy {place} --crop {ranges} {rest} -o part.vtu"),
        );
        run(folder, "export part.vtu --to msh -o part.msh --quiet");
        assert!(
            std::fs::read(folder.join("part.msh")).unwrap() == expected,
            "{ranges}"
        );
    }
    let arguments = format!("mesh whole.npy {place} --crop x=500:600 -o part.vtu");
    let words: Vec<&str> = arguments.split_whitespace().collect();
    let error = expect_refusal(folder, &words);
    assert!(error.contains("x from 0 to 290"), "{error}");
}

#[test]
fn surveys_are_cropped_by_their_line_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let survey = Survey {
        inlines: 9,
        crosslines: 8,
        samples: 12,
    };
    let value = |[s, x, i]: [usize; 3]| (s + 20 * x + 400 * i) as f32;
    write_segy(&folder.join("s.sgy"), &survey, value);
    run(
        folder,
        "convert s.sgy part.npy --crop inline=102:105,crossline=301:304,time=8:24 --quiet",
    );
    write_npy(&folder.join("cut.npy"), [5, 4, 4], |[s, x, i]| {
        value([s + 2, x + 1, i + 2])
    });
    let [part, cut] = ["part.npy", "cut.npy"].map(|name| std::fs::read(folder.join(name)).unwrap());
    assert!(part == cut);
    // The lines that cover a box in a turned survey keep their places.
    let info = |options: &[&str]| -> serde_json::Value {
        let arguments = [&["info", "s.sgy", "--json"][..], options].concat();
        serde_json::from_str(&run_args(folder, &arguments)).unwrap()
    };
    let [x, y] = survey.position(4, 3);
    let crop = format!("x={}:{},y={}:{}", x - 1.0, x + 1.0, y - 1.0, y + 1.0);
    assert_ne!(info(&["--crop", &crop]), info(&[]));
    let arguments = ["convert", "s.sgy", "a.npy", "--crop", "inline=1:9"];
    let error = expect_refusal(folder, &arguments);
    assert!(error.contains("which has 100"), "{error}");
}

#[test]
fn what_lies_outside_an_outline_holds_no_data() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy_2d(&folder.join("map.npy"), [40, 36], |[x, y]| {
        let distance = x as f32 - 19.0 - 0.2 * y as f32;
        (-distance * distance / 4.0).exp()
    });
    write_npy_2d(&folder.join("mask.npy"), [40, 36], |[x, y]| {
        f32::from(u8::from((5..=30).contains(&x) && (4..=28).contains(&y)))
    });
    std::fs::write(
        folder.join("p.csv"),
        "x,y\n4.5,3.5\n30.5,3.5\n30.5,28.5\n4.5,28.5\n",
    )
    .unwrap();
    let mesh = |options: &str, name: &str| {
        run(
            folder,
            &format!(
                "mesh map.npy --unit m --feature ridges --distance 5 --quiet {options} -o {name}.vtu"
            ),
        );
        run(
            folder,
            &format!("export {name}.vtu --to msh -o {name}.msh --quiet"),
        );
        std::fs::read(folder.join(format!("{name}.msh"))).unwrap()
    };
    let polygon = mesh("--inside p.csv", "a");
    assert!(polygon == mesh("--inside mask.npy", "b"));
    assert!(polygon != mesh("", "c"));
    let found = notes(
        folder,
        "export a.vtu --to opm -o A.DATA --porosity 0.2 --permeability 1 --permeability-unit mD --depth-at-top 100",
    );
    let deck = std::fs::read_to_string(folder.join("A.DATA")).unwrap();
    let total: f64 = keyword(&deck, "PORV").iter().sum();
    assert!((total - 0.2 * 26.0 * 25.0).abs() < 1e-6, "{total}\n{found}");
    std::fs::write(folder.join("far.csv"), "100,100\n110,100\n110,110\n").unwrap();
    let error = expect_refusal(
        folder,
        &["mesh", "map.npy", "--inside", "far.csv", "-o", "d.vtu"],
    );
    assert!(error.contains("holds no sample"), "{error}");
}

/// Writes `beds.npy`: a bed that thins out between two others, or at the top or the base, or two
/// that thin out towards each other.
fn write_beds(folder: &Path, kind: &str) {
    let thickness = |x: usize| (8.0 - 0.5 * x as f32).max(0.0);
    write_npy(&folder.join("beds.npy"), [32, 12, 24], |[x, _, z]| {
        let z = z as f32;
        let label = match kind {
            "middle" => 1 + u8::from(z >= 8.0) + u8::from(z >= 8.0 + thickness(x)),
            "top" => 1 + u8::from(z >= thickness(x)),
            "base" => 1 + u8::from(z < 24.0 - thickness(x)),
            _ => {
                let first = 8.0 + thickness(x);
                let second = first + thickness(31 - x);
                1 + u8::from(z >= 8.0) + u8::from(z >= first) + u8::from(z >= second)
            }
        };
        f32::from(label)
    });
}

#[test]
fn layers_that_pinch_out_are_written_with_pinch() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_beds(folder, "middle");
    run(
        folder,
        "mesh beds.npy -o m.vtu --feature labels --spacing 50,50,5 --unit m --effort draft --quiet",
    );
    run(
        folder,
        &format!("export m.vtu --to grdecl -o M.GRDECL --porosity 0.2 {ROCK} --quiet"),
    );
    let grid = std::fs::read_to_string(folder.join("M.GRDECL")).unwrap();
    let record = grid
        .split("PINCH\n")
        .nth(1)
        .unwrap()
        .lines()
        .next()
        .unwrap();
    let words: Vec<&str> = record.split_whitespace().collect();
    assert_eq!(words[1..], ["GAP", "1*", "TOPBOT", "TOP", "/"]);
    assert!(words[0].parse::<f64>().unwrap() <= 1e-3, "{record}");
}

#[test]
#[ignore = "needs OPM Flow and resfo: make test-all"]
fn opm_flow_connects_every_column_through_layers_that_pinch_out() {
    for kind in ["middle", "top", "base", "two"] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        write_beds(folder, kind);
        run(
            folder,
            "mesh beds.npy -o m.vtu --feature labels --spacing 50,50,5 --unit m --quiet",
        );
        run(
            folder,
            &format!("export m.vtu --to grdecl -o M.GRDECL --porosity 0.2 {ROCK} --quiet"),
        );
        let mut flow = Command::new("flow");
        flow.current_dir(folder).args([
            "M.DATA",
            "--enable-dry-run=true",
            "--output-dir=out",
            "--threads-per-process=1",
        ]);
        run_simulator(&mut flow);
        let out = folder.join("out");
        let arguments = [out.as_os_str(), OsStr::new("M")];
        let result = run_validator("resfo", "columns_connected.py", &arguments);
        let [columns, connected, pinched] =
            ["columns", "connected", "pinched"].map(|key| numbers(&result[key])[0]);
        assert_eq!(columns, connected, "{kind}: {result}");
        assert!(pinched >= 20.0, "{kind}: {result}");
    }
}
