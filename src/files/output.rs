//! Checks of output files, and reports on them.

use std::path::Path;

use serde_json::{Value, json};

use crate::error::cause;
use crate::{Error, Result};

/// Checks that a verb may write `path`: its ending, its folder, and that it is none of `inputs`.
///
/// # Errors
/// Returns [`Error::Job`] or [`Error::Io`] that names the option or the path.
pub fn check_output(path: &Path, option: &str, endings: &[&str], inputs: &[&Path]) -> Result<()> {
    let ending = path
        .extension()
        .and_then(|e| e.to_str())
        .map(str::to_ascii_lowercase);
    match ending.as_deref() {
        // A Zarr image is a folder.
        Some("zarr") if endings.contains(&"zarr") => crate::files::check_tree(path, "zarr.json")?,
        _ => crate::files::check_target(path)?,
    }
    let place = format!("{option} {}", path.display());
    if !ending.is_some_and(|ending| endings.contains(&ending.as_str())) {
        let known: Vec<String> = endings.iter().map(|ending| format!(".{ending}")).collect();
        return Err(Error::Job(cause(
            place,
            format!("does not end in {}", known.join(" or ")),
            "give the output one of these endings: it chooses the format",
        )));
    }
    if inputs.iter().any(|input| same_file(input, path)) {
        return Err(Error::Job(cause(
            place,
            "would overwrite an input",
            "give the output another name with -o",
        )));
    }
    Ok(())
}

/// Returns `true` if two paths name the same file, which need not exist yet.
pub fn same_file(a: &Path, b: &Path) -> bool {
    let resolve = |path: &Path| {
        path.canonicalize().ok().or_else(|| {
            let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
            let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
            Some(folder.join(path.file_name()?))
        })
    };
    a == b || resolve(a).is_some_and(|a| Some(a) == resolve(b))
}

/// Returns the report on a file that was written, with these fields.
pub fn file_report(path: &Path, fields: Value) -> Value {
    let mut report = json!({ "file": path_text(path) });
    if let (Some(report), Value::Object(fields)) = (report.as_object_mut(), fields) {
        report.extend(fields);
    }
    report
}

/// Returns a path as text for JSON, which cannot hold names that are not UTF-8.
pub fn path_text(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn different_paths_of_one_file_are_recognised() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.vtu");
        let same_path = folder.path().join(".").join("a.vtu");
        assert!(same_file(&path, &same_path));
        std::fs::write(&path, "").unwrap();
        assert!(same_file(&path, &same_path));
        assert!(!same_file(&path, &folder.path().join("b.vtu")));
    }
}
