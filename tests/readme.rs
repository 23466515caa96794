//! Tests of the front page: versions, and the commands of README.md, the tutorials and the gallery.
use std::path::Path;

#[test]
fn all_packages_have_the_version_of_the_program() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let version = env!("CARGO_PKG_VERSION");
    let quoted = format!("version = \"{version}\"");
    for (file, line) in [
        ("crates/mpi/Cargo.toml", &quoted),
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
