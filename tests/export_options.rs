//! `atomesh export`: no option is accepted and then ignored.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::common::{atomesh, files_below, write_npy, expect_refusal, planar_fault, run_args};
use atomesh::export::{ExportContent, ExportFormat, formats};

const DIMS: [usize; 3] = [28, 24, 20];

/// Options by name, each once.
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

/// What every format is given: the rock that it holds, and where depth is.
fn usual(format: &ExportFormat) -> Options<'static> {
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

/// The files of an export; unique names and dates in them would make every two differ.
fn outputs(folder: &Path, words: &[String]) -> Result<Vec<(PathBuf, Vec<u8>)>, String> {
    let out = folder.join("out");
    std::fs::create_dir_all(&out).unwrap();
    let output = atomesh(folder).args(words).output().unwrap();
    let made = files_below(&out).into_iter();
    let made = made.map(|(path, bytes)| (path.strip_prefix(&out).unwrap().into(), bytes));
    let made = made.collect();
    std::fs::remove_dir_all(&out).unwrap();
    match output.status.code() {
        Some(0) => Ok(made),
        _ => Err(String::from_utf8_lossy(&output.stderr).into_owned()),
    }
}

/// Every option of rock, space and case with every format but that for columns, which takes other
/// meshes: files change, or the option is refused by name.
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
    let options: [&[(&str, &str)]; 24] = [
        &[("--porosity", "0.3")],
        &[("--permeability", "50")],
        &[("--property", "amplitude=sheet.npy")],
        &[("--region", "sheet.npy")],
        &[("--faults", "0.01")],
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
    let more: [&[(&str, &str)]; 4] = [
        &[("--velocity", "2000")],
        &[("--length-unit", "ft")],
        &[("--depth-at-top", "1500")],
        &[("--down", "x")],
    ];
    let mut ignored = Vec::new();
    for format in formats().filter(|format| format.name != "disv") {
        let usual = usual(format);
        let base = outputs(folder, &arguments(format, "tets.vtu", "out", &usual)).unwrap();
        assert!(!base.is_empty());
        for added in options.iter().chain(&more) {
            // The last is tried; those before it are what it needs.
            let ((option, _), needed) = added.split_last().unwrap();
            let before = match needed {
                [] => Ok(base.clone()),
                _ => {
                    let mut before = usual.clone();
                    before.extend(needed.iter().copied());
                    outputs(folder, &arguments(format, "tets.vtu", "out", &before))
                }
            };
            let mut all = usual.clone();
            all.extend(added.iter().copied());
            match (
                outputs(folder, &arguments(format, "tets.vtu", "out", &all)),
                before,
            ) {
                (Ok(made), Ok(before)) if made == before => {
                    ignored.push(format!("{}: {added:?}", format.name));
                }
                (Err(said), Ok(_)) => {
                    let named = said.contains(option) || said.contains(&option[2..]);
                    assert!(
                        named || *option == "--length-unit" && said.contains("unit of length"),
                        "{}: {added:?} is refused, but not by name: {said}",
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
fn what_a_format_cannot_hold_is_refused_with_those_that_can() {
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
    let said = export(&format!("--to resqml -o a.epc --faults 0.1 {rock}"));
    assert!(
        said.contains("--faults") && said.contains("opm, pflotran, tough2, disv, mrst"),
        "{said}"
    );
    let said = export(&format!("--to resqml -o a.epc --injector 9,9,9:10 {rock}"));
    assert!(
        said.contains("--injector") && said.contains("opm, disv, mrst, darts, grdecl"),
        "{said}"
    );
    let said = export(&format!(
        "--to grdecl -o a.GRDECL --injector 9,9,9:10 {rock}"
    ));
    assert!(
        said.contains("--injector") && said.contains("--porosity"),
        "{said}"
    );
    let said = export(&format!("--to mrst -o a.mat --barriers all {rock}"));
    assert!(
        said.contains("--barriers") && said.contains("open"),
        "{said}"
    );
    let said = export(&format!("--to mrst -o a.mat --grid 3,3,3 {rock}"));
    assert!(said.contains("--grid") && said.contains("grdecl"), "{said}");
    let said = export("--to msh -o a.msh --days 10");
    assert!(said.contains("--days") && said.contains("msh"), "{said}");
    let said = export("--to mrst -o a.mat --faults 0.1");
    assert!(
        said.contains("--faults") && said.contains("permeability"),
        "{said}"
    );
}
