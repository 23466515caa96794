//! Formats what everybody needs to know of a mesh for a small terminal.

use super::table::{add_padding, group_digits, wrap_text};
use super::{Report, Verdict};

/// Maximum width of a line of the summary beside its heading, and maximum number of its lines: a small
/// terminal.
const SUMMARY_WIDTH: usize = 68;
const SUMMARY_LINES: usize = 38;
impl Report {
    /// Returns what everybody needs to know of a mesh: at most 38 lines of 80 columns, without a line
    /// break at the end.
    pub fn summary(&self) -> String {
        let mut lines = Vec::new();
        let mut add = |name: &str, text: String| {
            for (number, text) in wrap_text(&text, SUMMARY_WIDTH).into_iter().enumerate() {
                let heading = if number == 0 { name } else { "" };
                lines.push(format!("{heading:<12}{text}").trim_end().to_owned());
            }
        };
        for (name, text) in Verdict::from_report(self).iter().flat_map(Verdict::lines) {
            add(name, text);
        }
        if let Some(input) = &self.input {
            let dims = input.dims.iter().map(usize::to_string);
            let dims = dims.collect::<Vec<_>>().join(" x ");
            add("input", format!("{}, {dims} samples", input.file));
        }
        if let Some(text) = self.body_line() {
            add("body", text);
        }
        if let Some(quality) = &self.quality {
            let (nodes, cells) = (group_digits(quality.nodes), group_digits(quality.cells));
            add("size", format!("{nodes} nodes, {cells} {}", quality.kind));
        }
        if let Some(voronoi) = &self.voronoi {
            let count = group_digits(voronoi.check.cells);
            let conforming = voronoi.conforming.map_or(String::new(), |share| {
                format!(
                    "; {:.1} % of the area of surfaces lies exactly on faces of cells",
                    100.0 * share
                )
            });
            add("size", format!("{count} {}{conforming}", voronoi.kind));
        }
        self.add_angles_and_faces(&mut add);
        if let Some(improvement) = &self.improvement {
            let text = match improvement.sealed.compartments {
                1 => "the faces on features do not divide the mesh".to_string(),
                count => format!(
                    "the faces on features divide the mesh into {} compartments",
                    group_digits(count)
                ),
            };
            add("blocks", text);
        }
        self.add_dropped_points(&mut add);
        for (number, text) in self.regions.iter().flat_map(|r| r.lines()).enumerate() {
            add(if number == 0 { "regions" } else { "" }, text);
        }
        if let Some(padding) = &self.padding {
            add_padding(&mut add, padding);
        }
        if !self.stages.is_empty() {
            let seconds: f64 = self.stages.iter().map(|s| s.seconds).sum();
            let cpu: f64 = self.stages.iter().map(|s| s.cpu_seconds).sum();
            let peak = self.stages.iter().map(|s| s.peak_mb).fold(0.0, f64::max);
            add(
                "cost",
                format!("{seconds:.1} s, {cpu:.1} s of processor time, {peak:.0} MB of memory"),
            );
        }
        for note in &self.notes {
            add("note", note.clone());
        }
        if lines.len() > SUMMARY_LINES {
            let hidden = lines.len() - SUMMARY_LINES + 1;
            lines.truncate(SUMMARY_LINES - 1);
            lines.push(format!("{:<12}{hidden} more lines: --details", "..."));
        }
        lines.join("\n")
    }

    /// Adds the extreme angles, and how much of the features the tagged faces cover.
    fn add_angles_and_faces(&self, line: &mut impl FnMut(&str, String)) {
        if let Some(quality) = self.judged_quality() {
            let (smallest, largest) = (quality.smallest_angle, quality.largest_angle);
            let space = match (&self.quality_physical, self.no_physical_angles()) {
                (Some(_), _) => " in physical space",
                (None, Some(_)) => " counted in samples",
                (None, None) => "",
            };
            line(
                "angles",
                format!(
                    "from {:.1} to {:.1} degrees{space}; in 99 % of the {} from {:.1} to {:.1}",
                    smallest.worst, largest.worst, quality.kind, smallest.percent, largest.percent
                ),
            );
        }
        if let Some(faces) = self.fidelity.as_ref().and_then(|f| f.tagged_faces.as_ref()) {
            if faces.faces == 0 {
                line("faces", "no face is marked as lying on a feature".into());
                return;
            }
            line(
                "faces",
                format!(
                    "{} faces are marked as lying on features: {:.1} % of the features have a face within half \
                     a sample, {:.1} % within one; {:.1} % of the area of these faces lies within one \
                     sample of a feature",
                    group_digits(faces.faces),
                    100.0 * faces.coverage_half,
                    100.0 * faces.coverage_one,
                    100.0 * faces.precision
                ),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::report::Report;
    use crate::report::table::tests::full_report;

    #[test]
    fn the_summary_fits_a_small_terminal() {
        let mut report = full_report();
        report.notes = vec!["one of many words ".repeat(20).trim().to_owned(); 12];
        let text = report.summary();
        assert_eq!(text.lines().count(), 38, "{text}");
        for line in text.lines() {
            assert!(line.chars().count() <= 80, "{line}");
        }
        for section in [
            "mesh", "input", "size", "angles", "faces", "cost", "note", "...",
        ] {
            assert!(
                text.lines().any(|l| l.starts_with(section)),
                "{section}:\n{text}"
            );
        }
        assert!(text.contains("729 nodes, 3,072 tetrahedra"), "{text}");
        assert_eq!(Report::default().summary(), "");
    }
}
