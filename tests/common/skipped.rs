//! Checks that cannot be made where they are run: said, counted, or not suffered.

use std::io::Write;

/// A program that judges our files is not installed. `make validators` installs all of them, and where
/// that has been done (`ATOMESH_REQUIRE_VALIDATORS` is set) it is a failure.
pub fn no_validator(what: &str) {
    assert!(
        std::env::var_os("ATOMESH_REQUIRE_VALIDATORS").is_none(),
        "{what} is absent, but required: run `make validators`"
    );
    count(what, "run `make validators` first");
}

/// Data that is too large, or not ours to be kept here, is not at hand.
pub fn no_data(what: &str) {
    count(what, "get it, and set ATOMESH_DATA to its folder");
}

/// Says it to whoever runs this test alone, and adds a line to the file from which `make test` takes
/// their number.
fn count(what: &str, remedy: &str) {
    println!("not checked: {what} is absent: {remedy}");
    if let Some(path) = std::env::var_os("ATOMESH_SKIPPED") {
        let file = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(path);
        // One call writes the whole line: tests run at the same time.
        file.unwrap()
            .write_all(format!("{what}\n").as_bytes())
            .unwrap();
    }
}
