//! Tests of the front page: versions, and the commands of README.md, the tutorials and the gallery.
use std::path::Path;
use std::process::Command;

use crate::common::{run_args, run_simulator, write_npy};

#[test]
fn all_packages_have_the_version_of_the_program() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let version = env!("CARGO_PKG_VERSION");
    let quoted = format!("version = \"{version}\"");
    for (file, line) in [
        ("crates/mpi/Cargo.toml", &quoted),
        ("crates/page/Cargo.toml", &quoted),
        ("python/Cargo.toml", &quoted),
        ("tetgen-sys/Cargo.toml", &quoted),
        ("CITATION.cff", &format!("version: {version}")),
    ] {
        let text = std::fs::read_to_string(root.join(file)).unwrap();
        assert!(
            text.lines().any(|l| l == line),
            "{file} has another version than Cargo.toml, {version}"
        );
    }
    let changelog = std::fs::read_to_string(root.join("CHANGELOG.md")).unwrap();
    let latest = changelog.lines().find(|l| l.starts_with("## ")).unwrap();
    assert!(latest.starts_with(&format!("## {version} - ")), "{latest}");
}

/// A line of a page to run, or a file that the page writes by a here-document.
enum Step {
    Command(Vec<String>),
    File(String, String),
}

/// Returns the commands and files of the shell code of a page, in their order.
fn steps(page: &Path) -> Vec<Step> {
    let text = std::fs::read_to_string(page).unwrap().replace("\\\n", " ");
    let mut steps = Vec::new();
    for block in text.split("```sh\n").skip(1) {
        let mut lines = block.lines().take_while(|line| !line.starts_with("```"));
        while let Some(line) = lines.next() {
            let line = line.split(" #").next().unwrap().trim();
            if let Some(name) = line.strip_prefix("cat > ") {
                let name = name.strip_suffix(" <<'END'").expect(line);
                let content: Vec<&str> = lines.by_ref().take_while(|l| *l != "END").collect();
                steps.push(Step::File(name.into(), content.join("\n") + "\n"));
            } else if !line.is_empty() {
                let words = line.split_whitespace().map(str::to_string);
                steps.push(Step::Command(words.collect()));
            }
        }
    }
    steps
}

/// Writes a small image for each name that stands for one of the reader's own.
fn write_own_images(folder: &Path) {
    for (kind, dims, name) in [
        ("amplitude", "48,44,40", "survey.sgy"),
        ("blocks", "40,36,32", "labels.nii.gz"),
    ] {
        let options = ["synth", kind, "--dims", dims, "--count", "1", "-o", name];
        run_args(
            folder,
            &[&options[..], &["--signal-to-noise", "8"]].concat(),
        );
    }
    // Soft tissue with a bone of up to 1000 HU.
    write_npy(&folder.join("scan.npy"), [40, 36, 32], |index| {
        let centre = [20.0, 18.0, 16.0];
        let squares = index
            .iter()
            .zip(centre)
            .map(|(&i, c)| (i as f32 - c).powi(2));
        (1600.0 - 100.0 * squares.sum::<f32>().sqrt()).clamp(0.0, 1000.0)
    });
    run_args(folder, &["convert", "scan.npy", "scan.nii.gz"]);
}

/// Runs every `atomesh` command of a page in `folder`, and returns the other programs that the page
/// runs, each once. Commands on files that these would write are left out.
fn run_page(folder: &Path, page: &str) -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    std::fs::create_dir(folder.join("data")).unwrap();
    std::fs::copy(root.join("data/faults.vti"), folder.join("data/faults.vti")).unwrap();
    let mut others: Vec<String> = Vec::new();
    for step in steps(&root.join(page)) {
        match step {
            Step::File(name, content) => std::fs::write(folder.join(name), content).unwrap(),
            Step::Command(words) if words[0] == "atomesh" => {
                let is_result = |word: &String| word == "simulated.vtu" || word == "pressure.vtu";
                if !words.iter().any(is_result) {
                    let arguments: Vec<&str> = words[1..].iter().map(String::as_str).collect();
                    run_args(folder, &arguments);
                }
            }
            Step::Command(words) if others.contains(&words[0]) => {}
            Step::Command(words) => others.extend(words.into_iter().next()),
        }
    }
    others
}

#[test]
fn the_commands_of_the_readme_run() {
    let folder = tempfile::tempdir().unwrap();
    write_own_images(folder.path());
    assert_eq!(run_page(folder.path(), "README.md"), ["make"]);
}

#[test]
#[ignore = "slow: make test-all"]
fn the_commands_of_the_gallery_and_of_the_tutorials_on_seismic_volumes_run() {
    for (page, others) in [
        ("docs/tutorials/survey.md", &[][..]),
        ("docs/tutorials/reservoir.md", &["flow", ".venv/bin/python"]),
        ("docs/gallery.md", &["flow", ".venv/bin/python"]),
    ] {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(run_page(folder.path(), page), others, "{page}");
    }
}

/// The stiffness of a block of tissues is what the tutorial says.
#[test]
#[ignore = "needs CalculiX: make test-all"]
fn the_tutorial_on_scans_compresses_a_block_of_tissues() {
    let folder = tempfile::tempdir().unwrap();
    let page = "docs/tutorials/scan.md";
    assert_eq!(run_page(folder.path(), page), ["ccx", "cat"]);
    run_simulator(
        Command::new("ccx")
            .current_dir(folder.path())
            .arg("compress"),
    );
    let result = std::fs::read_to_string(folder.path().join("compress.dat")).unwrap();
    let printed = result.lines().last().unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join(page)).unwrap();
    assert!(text.contains(printed), "{result}");
}
