//! Formats a whole report for one screen; `summary` has what everybody needs to know.

use super::quality::{Quality, Quantiles};
use super::{
    Angles, FaceMatch, Fidelity, Improvement, LatticeReport, PaddingReport, Report, TracedLattice,
    Verdict, Voronoi,
};
use crate::improve::SealReport;

/// Maximum width of a line of prose, in characters, beside its heading.
const PROSE_WIDTH: usize = 88;
/// Maximum number of groups of blocked tetrahedra that are shown.
const MAX_SHOWN_GROUPS: usize = 4;
/// Maximum number of lattices of a trace that are shown, evenly chosen from the first to the last.
const MAX_SHOWN_LATTICES: usize = 10;

/// Adds the cells beyond the image.
pub(super) fn add_padding(line: &mut impl FnMut(&str, String), padding: &PaddingReport) {
    let regions = padding.regions.iter();
    let counts = regions.map(|region| format!("{} {}", group_digits(region.cells), region.name));
    let counts = counts.collect::<Vec<_>>().join(", ");
    line("beyond", format!("cells beyond the image: {counts}"));
    let (smallest, largest) = (padding.smallest_angle, padding.largest_angle);
    line(
        "",
        format!(
            "angles from {:.1} to {:.1} degrees, 99 % of cells from {:.1} to {:.1}",
            smallest.worst, largest.worst, smallest.percent, largest.percent
        ),
    );
    if let Some(deviation) = padding.topography_deviation {
        let text = format!("the top is at most {deviation:.4} from the topography");
        line("", text);
    }
}

impl Report {
    /// Returns the whole report as a table of plain lines, about 80 columns wide. Sections without
    /// measures are omitted.
    pub fn table(&self) -> String {
        let mut lines = Vec::new();
        let mut line = |name: &str, text: String| lines.push(format!("{name:<12}{text}"));
        self.add_verdict_and_size(&mut line);
        if let Some(voronoi) = &self.voronoi {
            add_cells(&mut line, voronoi);
        }
        if let Some(lattice) = &self.lattice {
            add_lattice(&mut line, lattice, !self.trace.is_empty());
        }
        add_trace(&mut line, &self.trace);
        for (space, quality) in [
            ("lattice", &self.quality),
            ("physical", &self.quality_physical),
        ] {
            if let Some(quality) = quality {
                let name = if self.quality_physical.is_some() {
                    space
                } else {
                    ""
                };
                add_shapes(&mut line, name, quality);
            }
        }
        self.add_dropped_points(&mut line);
        if let Some(fidelity) = &self.fidelity {
            add_matches(&mut line, fidelity);
        }
        if let Some(regions) = &self.regions {
            for (number, text) in regions.lines().into_iter().enumerate() {
                line(if number == 0 { "regions" } else { "" }, text);
            }
        }
        if let Some(certificate) = &self.certificate {
            for (number, text) in certificate.lines().into_iter().enumerate() {
                line(if number == 0 { "image" } else { "" }, text);
            }
        }
        if let Some(padding) = &self.padding {
            add_padding(&mut line, padding);
        }
        if let Some(improvement) = &self.improvement {
            add_improvement(&mut line, improvement);
        }
        if let Some(baseline) = &self.baseline {
            line("", baseline.to_string());
        }
        self.add_costs(&mut line);
        for note in &self.notes {
            line("note", note.clone());
        }
        lines
            .iter()
            .map(|line| format!("{}\n", line.trim_end()))
            .collect()
    }

    /// Adds the verdict, the input, and what the mesh consists of.
    fn add_verdict_and_size(&self, line: &mut impl FnMut(&str, String)) {
        if let Some(verdict) = Verdict::from_report(self) {
            for (name, text) in verdict.lines() {
                for (number, text) in wrap_text(&text, PROSE_WIDTH).into_iter().enumerate() {
                    line(if number == 0 { name } else { "" }, text);
                }
            }
        }
        if let Some(input) = &self.input {
            let dims = input.dims.iter().map(usize::to_string);
            let dims = dims.collect::<Vec<_>>().join(" x ");
            line("input", format!("{}, {dims} samples", input.file));
            line("", input.hash.clone());
        }
        if let Some(text) = self.body_line() {
            line("body", text);
        }
        if let Some(quality) = &self.quality {
            let (nodes, cells) = (group_digits(quality.nodes), group_digits(quality.cells));
            line("size", format!("{nodes} nodes, {cells} {}", quality.kind));
        }
        if let Some(filling) = &self.box_check {
            let state = if filling.passed() {
                "valid, fills its box".into()
            } else {
                filling.problems.join("; ")
            };
            let errors = (filling.volume_error, filling.flatness_error);
            line(
                "box",
                format!(
                    "{state}; volume off by {:.0e}, sides by {:.0e}",
                    errors.0, errors.1
                ),
            );
        }
    }

    /// Adds the numbers of points that the mesh does not follow, with the reasons.
    pub(super) fn add_dropped_points(&self, line: &mut impl FnMut(&str, String)) {
        for outcome in &self.outcomes {
            let dropped = outcome.dropped;
            let parts = [
                (dropped.near_another_surface, "too near another surface"),
                (dropped.in_small_pieces, "in small pieces"),
                (dropped.in_narrow_parts, "in narrow parts"),
                (dropped.weak, "too weak"),
            ];
            if parts.iter().all(|&(count, _)| count == 0) {
                continue;
            }
            let reasons: Vec<String> = (parts.iter().filter(|(count, _)| *count > 0))
                .map(|(count, why)| format!("{} {why}", group_digits(*count)))
                .collect();
            let kind = outcome.kind;
            line(
                "dropped",
                format!(
                    "points on {kind} that the mesh does not follow: {}",
                    reasons.join(", ")
                ),
            );
        }
    }

    fn add_costs(&self, line: &mut impl FnMut(&str, String)) {
        if self.stages.is_empty() {
            return;
        }
        line(
            "cost",
            format!("{:<28}{:>9} {:>9} {:>9}", "", "seconds", "cpu s", "peak MB"),
        );
        let row = |name: &dyn std::fmt::Display, seconds: f64, cpu: f64, peak: f64| {
            format!("{name:<28}{seconds:>9.2} {cpu:>9.2} {peak:>9.0}")
        };
        for stage in &self.stages {
            line(
                "",
                row(
                    &stage.stage,
                    stage.seconds,
                    stage.cpu_seconds,
                    stage.peak_mb,
                ),
            );
        }
        let seconds: f64 = self.stages.iter().map(|s| s.seconds).sum();
        let cpu: f64 = self.stages.iter().map(|s| s.cpu_seconds).sum();
        let peak = self.stages.iter().map(|s| s.peak_mb).fold(0.0, f64::max);
        line("", row(&"total", seconds, cpu, peak));
        if let (Some(quality), true) = (&self.quality, seconds > 0.0 && cpu > 0.0) {
            let rate = |count: usize, time: f64| group_digits((count as f64 / time) as usize);
            line(
                "",
                format!(
                    "{} atoms/s, {} {}/s; {} and {} per CPU second",
                    rate(quality.nodes, seconds),
                    rate(quality.cells, seconds),
                    quality.kind,
                    rate(quality.nodes, cpu),
                    rate(quality.cells, cpu)
                ),
            );
        }
    }
}

/// Adds the spacing of the lattice, and its energy if `shows_energy`.
fn add_lattice(line: &mut impl FnMut(&str, String), lattice: &LatticeReport, shows_energy: bool) {
    let [low, middle, high] = lattice.spacing;
    line(
        "lattice",
        format!("nearest neighbour over d: {low:.2} (1 %) {middle:.2} (50 %) {high:.2} (99 %)"),
    );
    if let Some(o) = &lattice.optimisation {
        if shows_energy {
            line(
                "",
                format!(
                    "energy per atom, as published: P {:.4}, of atoms A {:.4}, in the image B {:.4}",
                    o.energy, o.energy_lattice, o.energy_image
                ),
            );
            let laplacian = match o.added_by_laplacian {
                0.0 => String::new(),
                added => format!(" + {added:.4} Laplacian coordinates"),
            };
            line(
                "",
                format!(
                    "minimised {:.4} = P + {:.4} stiffening{laplacian}",
                    o.minimised, o.added_by_stiffening
                ),
            );
        }
        line("", format!("{} evaluations, {}", o.evaluations, o.stop));
    }
}

/// Adds the slivers that remain, and the sealing.
fn add_improvement(line: &mut impl FnMut(&str, String), improvement: &Improvement) {
    line(
        "slivers",
        format!(
            "{} below target, {} before improvement",
            group_digits(improvement.below_target_after),
            group_digits(improvement.below_target_before)
        ),
    );
    for group in improvement.blockers.iter().take(MAX_SHOWN_GROUPS) {
        line(
            "",
            format!(
                "{:>7} with {} nodes on sides, {} on features, {} on crossings: {:.1} to {:.1}",
                group_digits(group.tets),
                group.nodes_on_sides,
                group.nodes_on_features,
                group.nodes_on_crossings,
                group.smallest,
                group.largest
            ),
        );
    }
    let SealReport {
        faces,
        area,
        compartments,
        ..
    } = improvement.sealed;
    line(
        "sealing",
        format!(
            "{} compartments between the faces on features; {} faces (area {area:.0}) close holes",
            group_digits(compartments),
            group_digits(faces)
        ),
    );
}

/// Adds the traced lattices, in the form of table 3 of Fernandes & Gattass (2009).
fn add_trace(line: &mut impl FnMut(&str, String), trace: &[TracedLattice]) {
    let Some(last) = trace.len().checked_sub(1) else {
        return;
    };
    line("trace", "  step   worst Q    mean Q   energy P".into());
    let shown = MAX_SHOWN_LATTICES.min(last + 1);
    for row in 0..shown {
        let lattice = &trace[row * last / (shown - 1).max(1)];
        let TracedLattice {
            step,
            worst_quality,
            mean_quality,
            energy,
            ..
        } = lattice;
        let text = format!("{step:6} {worst_quality:9.3} {mean_quality:9.3} {energy:10.3}");
        line("", text);
    }
}

fn add_cells(line: &mut impl FnMut(&str, String), voronoi: &Voronoi) {
    let check = &voronoi.check;
    let [faces, count] = [
        check.cell_check.as_ref().map_or(0, |c| c.faces),
        check.cells,
    ]
    .map(group_digits);
    line("size", format!("{count} {}, {faces} faces", voronoi.kind));
    let state = if check.passed() {
        "valid, fills its box".into()
    } else {
        check.problems.join("; ")
    };
    line(
        "box",
        format!(
            "{state}; volume off by {:.0e}, sides by {:.0e}",
            check.volume_error, check.flatness_error
        ),
    );
    let [smallest, largest] = voronoi.volumes;
    line(
        "cells",
        format!(
            "smallest {smallest:.2}, largest {largest:.2} of the mean volume; neighbours up to \
             {:.1} times as large, one in a thousand more than {:.1}",
            voronoi.volume_ratio[0], voronoi.volume_ratio[1]
        ),
    );
    if let (Some(cells), Some(share)) = (voronoi.cells_per_cube, voronoi.conforming) {
        let share = 100.0 * share;
        line(
            "",
            format!("{cells:.2} for each d cubed; {share:.1} % of surfaces are faces exactly"),
        );
    }
    line(
        "faces",
        format!(
            "{} between cells, {} on features; {} with a transmissibility that is not positive",
            group_digits(voronoi.connections),
            group_digits(voronoi.on_feature),
            group_digits(voronoi.non_positive_connections)
        ),
    );
    let [a, b, c, d] = voronoi.tiny_faces.map(|share| 100.0 * share);
    line(
        "",
        format!(
            "shortest connection {:.2} of the mean; smallest face {:.0e} of the mean area, below 1e-6 {a:.2} %, 1e-4 {b:.2} %, 1e-3 {c:.2} %, \
             1e-2 {d:.1} %",
            voronoi.shortest_connection, voronoi.smallest_face
        ),
    );
    let angle = |[worst, mean]: [f64; 2]| format!("worst {worst:.1e}, mean {mean:.1e}");
    let mut angles = format!("off their connections (degrees): {}", angle(voronoi.angle));
    if let Some(physical) = voronoi.angle_physical {
        angles += &format!("; in physical space {}", angle(physical));
    }
    line("", angles);
}

fn add_shapes(line: &mut impl FnMut(&str, String), space: &str, quality: &Quality) {
    let row = |p: &Quantiles, digits: usize| {
        let number = |v: f64| format!("{v:>8.digits$}");
        [p.worst, p.permille, p.percent, p.median]
            .map(number)
            .join(" ")
    };
    line(
        "quality",
        format!(
            "{space:<25}{:>8} {:>8} {:>8} {:>8}",
            "worst", "0.1 %", "1 %", "50 %"
        ),
    );
    let is_planar = quality.kind == "triangles";
    let angle = if is_planar { "angle" } else { "dihedral angle" };
    for (end, points) in [
        ("smallest", &quality.smallest_angle),
        ("largest", &quality.largest_angle),
    ] {
        line(
            "",
            format!("{:<25}{}", format!("{end} {angle}"), row(points, 1)),
        );
    }
    line(
        "",
        format!("{:<25}{}", "mean ratio", row(&quality.mean_ratio, 3)),
    );
    line(
        "",
        format!("{:<25}{}", "radius over edge", row(&quality.radius_edge, 3)),
    );
    let mut counts = format!(
        "{} below 20: {}, below 30: {}",
        quality.kind,
        group_digits(quality.below_20),
        group_digits(quality.below_30)
    );
    if is_planar {
        counts += &format!(", above 120: {}", group_digits(quality.above_120));
    }
    counts += &format!(
        ", above 150: {}, above 160: {}",
        group_digits(quality.above_150),
        group_digits(quality.above_160)
    );
    line("", counts);
    if let Some(angles) = &quality.angles {
        add_angles(line, angles);
    }
    line(
        "",
        format!("angles 0 |{}| 180", bar_chart(&quality.histogram)),
    );
}

/// Adds the causes of bad angles.
fn add_angles(line: &mut impl FnMut(&str, String), angles: &Angles) {
    let [ok, near_line, unexplained] =
        [angles.ok, angles.near_acute_line, angles.unexplained].map(group_digits);
    let mut counts =
        format!("in [30, 150]: {ok}, near an acute line: {near_line}, unexplained: {unexplained}");
    if let Some(worst) = &angles.worst_unexplained {
        counts += &format!(" ({:.1} to {:.1})", worst.smallest, worst.largest);
    }
    line("", counts);
    let lines = &angles.acute_lines;
    if lines.is_empty() {
        return;
    }
    let length: f64 = lines.iter().map(|line| line.length).sum();
    let min_angles = lines.iter().map(|line| line.min_angle);
    let min_angle = min_angles.fold(f64::INFINITY, f64::min);
    let text = if length > 0.0 {
        format!(
            "acute lines: {}, {length:.0} long in all",
            group_digits(lines.len())
        )
    } else {
        format!("acute corners: {}", group_digits(lines.len()))
    };
    line("", format!("{text}; smallest angle {min_angle:.1}"));
}

fn add_matches(line: &mut impl FnMut(&str, String), fidelity: &Fidelity) {
    line(
        "fidelity",
        format!(
            "to {} ({} points) {:>9} {:>7} {:>9} {:>7} {:>7}",
            fidelity.reference,
            group_digits(fidelity.feature_points),
            "cover 0.5",
            "cover 1",
            "precision",
            "H 95 %",
            "H"
        ),
    );
    let width = format!(
        "to {} ({} points)",
        fidelity.reference,
        group_digits(fidelity.feature_points)
    )
    .len();
    let mut row = |name: &str, m: &FaceMatch| {
        let faces = format!("{name}, {} faces", group_digits(m.faces));
        line(
            "",
            format!(
                "{faces:<width$} {:>9} {:>7} {:>9} {:>7} {:>7}",
                format_share(m.coverage_half),
                format_share(m.coverage_one),
                format_share(m.precision),
                format_samples(m.hausdorff_95),
                format_samples(m.hausdorff)
            ),
        );
    };
    row("coincident", &fidelity.on_feature);
    if let Some(tagged) = &fidelity.tagged_faces {
        row("tagged", tagged);
    }
}

fn format_share(value: f64) -> String {
    if value.is_finite() {
        format!("{value:.3}")
    } else {
        "-".into()
    }
}

fn format_samples(value: f64) -> String {
    if value.is_finite() {
        format!("{value:.2}")
    } else {
        "-".into()
    }
}

/// Returns the text in lines of at most `width` characters, broken between words.
pub(super) fn wrap_text(text: &str, width: usize) -> Vec<String> {
    if text.starts_with(' ') {
        // A row of a table.
        return vec![text.to_owned()];
    }
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                *line += " ";
                line.push_str(word);
            }
            _ => lines.push(word.to_string()),
        }
    }
    lines
}

/// Formats a number with commas: 1234567 as 1,234,567.
pub(super) fn group_digits(count: usize) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Returns a bar for each bin, with a height relative to the largest bin. Every non-empty bin is
/// visible.
fn bar_chart(bins: &[u64]) -> String {
    const BARS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let max = bins.iter().copied().max().unwrap_or(0).max(1);
    bins.iter()
        .map(|&n| BARS[(n * 8).div_ceil(max) as usize])
        .collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::*;
    use super::*;
    use crate::lattice::optimise::StopReason;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::check::check;
    use crate::progress::Stage;

    pub(crate) fn full_report() -> Report {
        let mesh = kuhn_box([8, 8, 8], 2.0);
        let truth = crate::image::synth::make(
            crate::image::synth::SyntheticKind::Sphere,
            &crate::image::synth::Options {
                dims: [17; 3],
                ..Default::default()
            },
        )
        .unwrap()
        .truth;
        let tags = vec![0u8; mesh.tets.len()];
        let blocked = improve::BlockedCell {
            centroid: [1.0; 3],
            min_angle: 12.0,
            max_angle: 150.0,
            nodes_on_sides: 1,
            nodes_on_features: 3,
            nodes_on_crossings: 0,
        };
        let on_sides = improve::BlockedCell {
            nodes_on_sides: 4,
            ..blocked.clone()
        };
        let outcome = improve::ImproveReport {
            below_target_before: 5000,
            counts: improve::OperationCounts::default(),
            blocked: vec![
                on_sides,
                blocked.clone(),
                improve::BlockedCell {
                    min_angle: 9.0,
                    ..blocked
                },
            ],
        };
        let view = crate::mesh::view::MeshView::from_mesh(&mesh);
        let mut lattice = lattice::lattice_of_partition(&view, |_| 2.0).unwrap();
        lattice.optimisation = Some(Optimisation {
            energy_lattice: -0.3,
            energy_image: -0.1,
            energy: -0.2,
            added_by_stiffening: 0.03,
            added_by_laplacian: 0.005,
            minimised: -0.165,
            evaluations: 120,
            stop: StopReason::Converged,
        });
        Report {
            input: Some(Input {
                file: "a.npy".into(),
                dims: vec![17; 3],
                hash: "sha256:00".into(),
            }),
            parameters: serde_json::json!({ "distance": 2.0, "seed": 1 }),
            stages: vec![
                StageCost {
                    stage: Stage::Triangulating,
                    seconds: 1.0,
                    cpu_seconds: 2.0,
                    peak_mb: 90.0,
                },
                StageCost {
                    stage: Stage::Measuring,
                    seconds: 0.5,
                    cpu_seconds: 0.5,
                    peak_mb: 80.0,
                },
            ],
            lattice: Some(lattice),
            quality: Some(quality(&mesh)),
            quality_physical: Some(quality(&mesh)),
            fidelity: Some(fidelity(&mesh, &Reference::from_truth(&truth), Some(&tags)).unwrap()),
            box_check: Some(check(&mesh, [0.0; 3], [16.0; 3], 1e-9)),
            improvement: Some(outcome.into()),
            notes: vec!["threshold 0.4 from the image".into()],
            ..Report::default()
        }
    }

    #[test]
    fn the_table_fits_a_screen_and_shows_every_section() {
        let text = full_report().table();
        assert!(text.lines().count() <= 48, "{text}");
        for l in text.lines() {
            assert!(l.chars().count() <= 100, "{l}");
        }
        for section in [
            "input", "mesh", "box", "lattice", "quality", "fidelity", "slivers", "cost", "note",
        ] {
            assert!(
                text.lines().any(|l| l.starts_with(section)),
                "{section} is missing:\n{text}"
            );
        }
        assert!(text.contains("729 nodes, 3,072 tetrahedra"), "{text}");
        assert!(
            text.contains("2 with 1 nodes on sides, 3 on features"),
            "{text}"
        );
        // 1.5 s in total: 486 atoms per second, and the largest peak.
        assert!(
            text.contains("486 atoms/s") && text.contains("90"),
            "{text}"
        );
        assert_eq!(Report::default().table(), "");
    }

    #[test]
    fn json_has_every_section_and_null_for_what_has_no_value() {
        let json = serde_json::to_value(full_report()).unwrap();
        assert_eq!(json["quality"]["cells"], 3072);
        assert_eq!(json["parameters"]["seed"], 1);
        assert_eq!(json["box"]["problems"].as_array().unwrap().len(), 0);
        assert_eq!(json["fidelity"]["tagged_faces"]["faces"], 0);
        assert!(json["fidelity"]["tagged_faces"]["precision"].is_null());
        assert_eq!(json["improvement"]["blockers"][0]["smallest"], 9.0);
        assert_eq!(json["stages"][0]["seconds"], 1.0);
        assert_eq!(json["version"], env!("CARGO_PKG_VERSION"));
    }

    #[test]
    fn numbers_and_bars() {
        assert_eq!(group_digits(0), "0");
        assert_eq!(group_digits(999), "999");
        assert_eq!(group_digits(1_234_567), "1,234,567");
        assert_eq!(bar_chart(&[0, 1, 50, 100]), " ▁▄█");
    }
}
