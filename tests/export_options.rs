//! Tests `atomesh export`: each option changes the files or is refused.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::common::{atomesh, expect_refusal, files_below, planar_fault, run_args, write_npy};
use atomesh::export::{ExportContent, ExportFormat, formats};

const DIMS: [usize; 3] = [28, 24, 20];

/// Options with their values, each option once.
type Options<'a> = BTreeMap<&'a str, &'a str>;

fn arguments(
    format: &ExportFormat,
    mesh: &str,
    folder: &str,
    options: &Options<'_>,
) -> Vec<String> {
    let output = match format.extensions {
        [] => folder.to_string(),
        [ending, ..] => format!("{folder}/case.{ending}"),
    };
    let mut words = vec![
        "export",
        mesh,
        "--quiet",
        "--to",
        format.name,
        "-o",
        &output,
    ];
    for (option, value) in options {
        words.push(option);
        words.extend(value.split_whitespace());
    }
    words.into_iter().map(str::to_string).collect()
}

/// Returns the options that every export of a format has: the rock that the format holds, and the
/// position in depth.
fn base_options(format: &ExportFormat) -> Options<'static> {
    let mut options = Options::from([("--down", "z"), ("--depth-at-top", "1000")]);
    if format.supported_content.contains(&ExportContent::Porosity) {
        options.insert("--porosity", "0.2");
    }
    if format
        .supported_content
        .contains(&ExportContent::Permeability)
    {
        options.extend([("--permeability", "100"), ("--permeability-unit", "mD")]);
    }
    options
}

/// Runs an export and returns its files, or the error. Without names and dates that differ between
/// runs.
fn outputs(folder: &Path, words: &[String]) -> Result<Vec<(PathBuf, Vec<u8>)>, String> {
    let out = folder.join("out");
    std::fs::create_dir_all(&out).unwrap();
    let output = atomesh(folder).args(words).output().unwrap();
    let written = files_below(&out).into_iter();
    let written = written.map(|(path, bytes)| (path.strip_prefix(&out).unwrap().into(), bytes));
    let written = written.collect();
    std::fs::remove_dir_all(&out).unwrap();
    match output.status.code() {
        Some(0) => Ok(written),
        _ => Err(String::from_utf8_lossy(&output.stderr).into_owned()),
    }
}

/// Options of rock and case. The last one of a line is tried; it needs those before it.
const OPTIONS: [&[(&str, &str)]; 33] = [
    &[("--porosity", "0.3")],
    &[("--permeability", "50")],
    &[("--property", "amplitude=sheet.npy")],
    &[("--region", "sheet.npy")],
    &[("--faults", "0.01")],
    &[("--faults", "3")],
    &[("--throw", "1:5"), ("--clay", "0.3")],
    &[("--clay", "0.3"), ("--throw", "1:5")],
    &[("--net-to-gross", "0.5")],
    &[
        ("--property", "amplitude=sheet.npy"),
        ("--cutoff", "amplitude=0.02"),
    ],
    &[("--satnum", "2")],
    &[("--pvtnum", "2")],
    &[("--eqlnum", "2")],
    &[("--fipnum", "2")],
    &[("--faults", "closed"), ("--fault-thickness", "2")],
    &[("--fault-thickness", "2")],
    &[("--fault-multiplier", "1:0.01")],
    &[("--faults", "closed"), ("--barriers", "horizons")],
    &[("--faults", "closed"), ("--fault-multiplier", "1:1")],
    &[("--split", "faults")],
    &[("--quadratic", "")],
    &[("--injector", "12,12,9:100")],
    &[("--producer", "12,12,9:90")],
    &[("--injector", "12,12,9:100"), ("--well-radius", "0.2")],
    &[("--injector", "way.csv:100"), ("--well-radius", "0.2")],
    &[("--well-radius", "0.2")],
    &[("--fluid", "oil-water")],
    &[("--days", "77")],
    &[("--injector", "12,12,9:100"), ("--days", "77")],
    &[("--no-gravity", "")],
    &[("--pressure-at-top", "120")],
    &[("--grid", "3,3,3")],
    &[("--thickness", "2")],
];

/// Options of space.
const PLACEMENT_OPTIONS: [&[(&str, &str)]; 4] = [
    &[("--velocity", "2000")],
    &[("--length-unit", "ft")],
    &[("--depth-at-top", "1500")],
    &[("--down", "x")],
];

/// Tries each option of rock, space and case with each format except that for columns, which needs
/// other meshes: the files change, or the error names the option.
#[test]
fn every_option_changes_the_files_or_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("sheet.npy"), DIMS, planar_fault(DIMS));
    run_args(
        folder,
        &[
            "mesh",
            "sheet.npy",
            "--distance",
            "8",
            "--quiet",
            "-o",
            "tets.vtu",
        ],
    );
    std::fs::write(folder.join("way.csv"), "12,12,2,0.1\n12,12,17,0.1\n").unwrap();
    let mut ignored = Vec::new();
    for format in formats().filter(|format| format.name != "disv") {
        let usual = base_options(format);
        let reference = outputs(folder, &arguments(format, "tets.vtu", "out", &usual)).unwrap();
        assert!(!reference.is_empty());
        for added_options in OPTIONS.iter().chain(&PLACEMENT_OPTIONS) {
            // The last option is under test. It needs those before it.
            let ((option, _), required) = added_options.split_last().unwrap();
            let without = match required {
                [] => Ok(reference.clone()),
                _ => {
                    let mut without = usual.clone();
                    without.extend(required.iter().copied());
                    outputs(folder, &arguments(format, "tets.vtu", "out", &without))
                }
            };
            let mut combined = usual.clone();
            combined.extend(added_options.iter().copied());
            match (
                outputs(folder, &arguments(format, "tets.vtu", "out", &combined)),
                without,
            ) {
                (Ok(with), Ok(without)) if with == without => {
                    ignored.push(format!("{}: {added_options:?}", format.name));
                }
                (Err(error), Ok(_)) => {
                    let named = error.contains(option) || error.contains(&option[2..]);
                    assert!(
                        named || *option == "--length-unit" && error.contains("unit of length"),
                        "{}: {added_options:?} is refused, but not by name: {error}",
                        format.name
                    );
                }
                _ => {}
            }
        }
    }
    assert!(ignored.is_empty(), "ignored:\n{}", ignored.join("\n"));
}

#[test]
fn options_of_other_formats_are_refused_with_the_names_of_these_formats() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("sheet.npy"), DIMS, planar_fault(DIMS));
    let mesh = [
        "mesh",
        "sheet.npy",
        "--distance",
        "8",
        "--quiet",
        "-o",
        "tets.vtu",
    ];
    run_args(folder, &mesh);
    let export = |words: &str| {
        let words = format!("export tets.vtu {words}");
        expect_refusal(folder, &words.split_whitespace().collect::<Vec<_>>())
    };
    let rock = "--permeability 100 --permeability-unit mD";
    let error = export(&format!("--to resqml -o a.epc --faults 0.1 {rock}"));
    assert!(
        error.contains("--faults") && error.contains("opm, pflotran, tough2, disv, mrst"),
        "{error}"
    );
    let error = export(&format!("--to resqml -o a.epc --injector 9,9,9:10 {rock}"));
    assert!(
        error.contains("--injector") && error.contains("opm, disv, mrst, darts, grdecl"),
        "{error}"
    );
    let error = export(&format!(
        "--to grdecl -o a.GRDECL --injector 9,9,9:10 {rock}"
    ));
    assert!(
        error.contains("--injector") && error.contains("--porosity"),
        "{error}"
    );
    let error = export(&format!("--to mrst -o a.mat --barriers all {rock}"));
    assert!(
        error.contains("--barriers") && error.contains("open"),
        "{error}"
    );
    let error = export(&format!("--to mrst -o a.mat --grid 3,3,3 {rock}"));
    assert!(
        error.contains("--grid") && error.contains("grdecl"),
        "{error}"
    );
    let error = export("--to msh -o a.msh --days 10");
    assert!(error.contains("--days") && error.contains("msh"), "{error}");
    let error = export("--to mrst -o a.mat --faults 0.1");
    assert!(
        error.contains("--faults") && error.contains("permeability"),
        "{error}"
    );
}
