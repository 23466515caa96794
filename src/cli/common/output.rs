//! Messages about images that were written.

use std::path::Path;

use serde_json::json;

use crate::cli::console::Console;
use crate::files::output::file_report;

/// Reports the name and the number of samples of an image that was written.
pub fn report_written_image(console: &mut Console, path: &Path, dims: &[usize]) {
    console.result(
        format_args!("wrote {}: {} samples", path.display(), format_dims(dims)),
        &file_report(path, json!({ "dims": dims.to_vec() })),
    );
}

/// Formats dimensions as `3 x 4 x 5`.
pub fn format_dims(dims: &[usize]) -> String {
    let words: Vec<String> = dims.iter().map(usize::to_string).collect();
    words.join(" x ")
}
