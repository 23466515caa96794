//! Tests that each option of `mesh` has an effect or is refused, alone and together with each other
//! option, and that a job survives `--print-config` and `--config`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::{atomesh, expect_refusal, files_below, run_args};
use atomesh::store::{AnyMesh, read_any_vtu};
use serde_json::Value;

/// An option with a value that differs from its default.
struct OptionCase {
    /// The image that the option needs, if not `layers.mha`.
    image: Option<&'static str>,
    /// Other options without which it would be refused.
    needs: &'static str,
    /// The option and its value.
    option: &'static str,
}

const fn option(option: &'static str) -> OptionCase {
    option_with("", option)
}

const fn option_with(needs: &'static str, option: &'static str) -> OptionCase {
    OptionCase {
        image: None,
        needs,
        option,
    }
}

const fn option_on_image(
    image: &'static str,
    needs: &'static str,
    option: &'static str,
) -> OptionCase {
    OptionCase {
        image: Some(image),
        needs,
        option,
    }
}

/// All options of `mesh`, some with more than one value.
const CASES: &[OptionCase] = &[
    option("--distance 6"),
    option("--effort draft"),
    option("--effort best"),
    option_with("--distance 5:9", "--distance-from image"),
    option_with("--distance 5:9", "--distance-from features"),
    option_with("--distance 5:9", "--distance-from laplacian"),
    option_with("--distance 5:9", "--distance-from ../in/distances.mha"),
    option("--feature edges"),
    option_on_image("labels.mha", "", "--feature labels"),
    option("--sigma 2.5"),
    option("--threshold 0.08"),
    option_on_image("labels.mha", "", "--threshold 0.9"),
    option_on_image("labels.mha", "", "--label 1:distance=6,name=disc"),
    option_on_image("labels.mha", "", "--label 2:into=1"),
    option_on_image(
        "faulted.mha",
        "--feature faults+horizons",
        "--feature-weights 1,0.3",
    ),
    option_on_image("faulted.mha", "--feature faults", "--min-dip 70"),
    option_on_image(
        "faulted.mha",
        "--feature faults+horizons",
        "--min-fault-size 200",
    ),
    option_on_image("rings.mha", "--feature paths", "--object 72,96"),
    option_on_image(
        "rings.mha",
        "--feature paths --object 72,96",
        "--background 40,96",
    ),
    option("--potential-out b.vti"),
    option("--lines l.vtp"),
    option("--checkpoint kept"),
    option("--align alongside"),
    option("--cells voronoi"),
    option("--beta 0.1"),
    option("--beta ../in/weights.mha"),
    option_with("--distance 8", "--seeding grown"),
    option("--seeding refine"),
    option("--seeding guide"),
    option("--seeding projection"),
    option("--seeding canny"),
    option_with("--seeding guide", "--max-atoms 30"),
    option("--atoms-from ../in/atoms.csv"),
    option("--well ../in/well.csv"),
    option_with("--well ../in/well.csv", "--well-distance 4"),
    option("--evaluator sampled"),
    option("--kappa 0.7"),
    option("--optimizer descent"),
    option("--optimizer genetic"),
    option("--rounds 2"),
    option("--max-evaluations 10"),
    option("--coarse-to-fine 1"),
    option("--min-dihedral 12"),
    option("--slivers none"),
    option("--slivers exude"),
    option_with("--cells voronoi", "--weld 0.1"),
    option("--smooth odt"),
    option("--metric physical"),
    option("--metric 1,1.4"),
    option("--metric samples"),
    option("--velocity 2400"),
    option("--rng-seed 7"),
    option("--report r.json"),
    option("--trace t.pvd"),
    option_on_image("layers.raw", "", "--raw 72x64:f32le"),
    option_on_image("layers.raw", "--raw 72x64:f32le", "--spacing 2,3"),
    option_on_image("nulls.mha", "", "--null 7"),
    option("--inline-byte 9"),
    option("--crossline-byte 21"),
    option("--x-byte 73"),
    option("--y-byte 77"),
    option("--scalar-byte 69"),
    option("--delay-byte 105"),
    option("--interval-byte 119"),
    option("-o other.vtu"),
];

/// Pairs of options of which the second has no effect beside the first.
///
/// Atoms of Voronoi cells lie alongside features. A lattice with a varying distance, also for
/// wells, is always grown. Bare samples are 1 apart in metres as in samples. Options for a label
/// imply that labels are the features.
const REDUNDANT_PAIRS: [[&str; 2]; 7] = [
    ["--feature labels", "--label 1:distance"],
    ["--seeding grown", "--label 1:distance"],
    ["--align alongside", "--cells voronoi"],
    ["--seeding grown", "--distance-from"],
    ["--seeding grown", "--well-distance"],
    ["--metric physical", "--raw"],
    ["--metric samples", "--raw"],
];

/// Pairs of options of which the second has no effect beside the first on this image alone.
///
/// With this stiffness the atoms come to rest before more evaluations matter. Atoms of Canny's edges do
/// not depend on the distance, and only its unit makes the physical metric differ from the default.
const PAIRS_WITHOUT_EFFECT_HERE: [[&str; 2]; 2] = [
    ["--kappa 0.7", "--effort best"],
    ["--seeding canny", "--metric physical"],
];

/// Returns `true` if an option of a pair is known to have no effect on this image.
fn has_no_effect_here(row: &Row, i: usize) -> bool {
    let has = |option: &str| row.iter().any(|&k| CASES[k].option == option);
    let mut pairs = PAIRS_WITHOUT_EFFECT_HERE.iter();
    row.len() == 2 && pairs.any(|[a, b]| CASES[i].option == *b && has(a))
}

/// Result of a run: exit code, messages with figures, and files with their contents.
#[derive(Debug, Clone, PartialEq)]
struct RunResult {
    code: Option<i32>,
    messages: String,
    files: BTreeMap<String, Vec<u8>>,
}

fn words(text: &str) -> Vec<&str> {
    text.split_whitespace().collect()
}

/// Returns the names of the options among words.
fn names(text: &str) -> BTreeSet<&str> {
    words(text)
        .into_iter()
        .filter(|w| w.starts_with('-'))
        .collect()
}

/// Returns the words of several options, each option once.
fn merge_options(parts: &[&str]) -> String {
    let mut options: Vec<String> = Vec::new();
    for part in parts {
        let mut option = Vec::new();
        for word in words(part).into_iter().chain(["-"]) {
            if word.starts_with('-') && !option.is_empty() {
                let text = option.join(" ");
                if !options.contains(&text) {
                    options.push(text);
                }
                option.clear();
            }
            option.push(word);
        }
    }
    options.sort();
    options.join(" ")
}

/// Returns `true` if an option occurs twice with different values.
fn is_contradictory(text: &str) -> bool {
    let options = words(text).into_iter().filter(|w| w.starts_with('-'));
    options.count() > names(text).len()
}

/// The image and the options of a run.
type RunInput = (String, String);

fn run(folder: &Path, (image, options): &RunInput) -> RunResult {
    std::fs::create_dir(folder).unwrap();
    let image = format!("../in/{image}");
    let output = atomesh(folder)
        .args(["mesh", &image, "--json", "--quiet", "--threads", "1"])
        .args(words(options))
        .output()
        .unwrap();
    let mut messages = String::from_utf8_lossy(&output.stderr).into_owned();
    if let Ok(mut report) = serde_json::from_slice::<Value>(&output.stdout) {
        // Parameters and run times are no results.
        for key in ["parameters", "verdict", "stages"] {
            report.as_object_mut().unwrap().remove(key);
        }
        messages += &report.to_string();
    }
    let comparable_content =
        |path: &Path, bytes: Vec<u8>| match path.extension().and_then(|e| e.to_str()) {
            Some("vtu") => mesh_content(path).into_bytes(),
            Some("json") => Vec::new(),
            _ => bytes,
        };
    let named = |(path, bytes): (std::path::PathBuf, Vec<u8>)| {
        let name = path.strip_prefix(folder).unwrap().display().to_string();
        (name, comparable_content(&path, bytes))
    };
    let files = files_below(folder).into_iter().map(named).collect();
    std::fs::remove_dir_all(folder).unwrap();
    RunResult {
        code: output.status.code(),
        messages,
        files,
    }
}

/// Returns the contents of a mesh file without the record of how it was made.
fn mesh_content(path: &Path) -> String {
    // Files with the points of a lattice's rounds are no meshes.
    let Ok(mut mesh) = read_any_vtu(path) else {
        return String::from_utf8_lossy(&std::fs::read(path).unwrap()).into_owned();
    };
    match &mut mesh {
        AnyMesh::Triangles(file) => file.field_data.clear(),
        AnyMesh::Tetrahedra(file) => file.field_data.clear(),
        AnyMesh::Polygons(file) => file.field_data.clear(),
        AnyMesh::Polyhedra(file) => file.field_data.clear(),
    }
    format!("{mesh:?}")
}

const DIMS: [usize; 2] = [72, 64];

/// Writes a MetaImage of float32 with a spacing of 2 and 3.
fn write_mha(path: &Path, value: impl Fn(f64, f64) -> f64) {
    let [nx, ny] = DIMS;
    let mut bytes = format!(
        "ObjectType = Image\nNDims = 2\nDimSize = {nx} {ny}\nElementSpacing = 2 3\n\
         BinaryData = True\nBinaryDataByteOrderMSB = False\nElementType = MET_FLOAT\n\
         ElementDataFile = LOCAL\n"
    )
    .into_bytes();
    bytes.extend(samples(value));
    std::fs::write(path, bytes).unwrap();
}

fn samples(value: impl Fn(f64, f64) -> f64) -> Vec<u8> {
    let [nx, ny] = DIMS;
    let value_at = |i: usize| value((i % nx) as f64, (i / nx) as f64) as f32;
    (0..nx * ny)
        .flat_map(|i| value_at(i).to_le_bytes())
        .collect()
}

/// Returns a pseudo-random number between -1 and 1 for each sample.
fn noise(x: f64, y: f64) -> f64 {
    (12.9898 * x + 78.233 * y).sin() * 43758.547 % 1.0
}

/// Returns the value of layers that a fault displaces.
fn layers(x: f64, y: f64) -> f64 {
    let throw = if x > 36.0 + 0.2 * y { 5.0 } else { 0.0 };
    let depth = y + throw + 2.0 * (x / 20.0).sin();
    (depth / 4.0).sin() * (1.0 + 0.3 * (x / 9.0).cos()) + 0.1 * noise(x, y)
}

fn write_inputs(folder: &Path) {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write_mha(&folder.join("layers.mha"), layers);
    std::fs::write(folder.join("layers.raw"), samples(layers)).unwrap();
    write_mha(&folder.join("faulted.mha"), layers);
    write_mha(&folder.join("nulls.mha"), |x, y| {
        if x > 66.0 { 7.0 } else { layers(x, y) }
    });
    // The background is the area between the rings, or that beyond both.
    let disc = |x: f64, y: f64, r| f64::from((x - 36.0).hypot(y - 32.0) < r);
    write_mha(&folder.join("rings.mha"), |x, y| {
        3.0 * (disc(x, y, 11.0) + disc(x, y, 23.0)) + 0.1 * noise(x, y)
    });
    write_mha(&folder.join("labels.mha"), |x, y| {
        disc(x, y, 15.0) + f64::from(x + y > 90.0)
    });
    write_mha(&folder.join("distances.mha"), |x, _| 5.0 + x / 20.0);
    write_mha(&folder.join("weights.mha"), |x, _| 0.2 + x / 200.0);
    write("atoms.csv", "x,y\n61.5,80\n");
    write("well.csv", "x,y,radius\n40,60,0.1\n70,110,0.1\n");
}

/// Runs all inputs in parallel, and returns their results.
fn run_all(folder: &Path, inputs: BTreeSet<RunInput>) -> BTreeMap<RunInput, RunResult> {
    let inputs: Vec<RunInput> = inputs.into_iter().collect();
    let (next, results) = (AtomicUsize::new(0), Mutex::new(BTreeMap::new()));
    let workers = std::thread::available_parallelism().map_or(2, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    let Some(input) = inputs.get(number) else {
                        break;
                    };
                    let result = run(&folder.join(number.to_string()), input);
                    results.lock().unwrap().insert(input.clone(), result);
                }
            });
        }
    });
    results.into_inner().unwrap()
}

/// Options that are tried together: all of them, and all without each of them in turn.
type Row = Vec<usize>;

/// Returns the image on which the options of a row can be tried together, unless the options
/// contradict or imply one another.
fn common_image(row: &[usize]) -> Option<&'static str> {
    let mut images = row.iter().filter_map(|&i| CASES[i].image);
    let image = images.next().unwrap_or("layers.mha");
    let all_options = row_options(row);
    let redundant = |pair: &[&str; 2]| pair.iter().all(|option| all_options.contains(option));
    // If another option requires this one, leaving it out has no effect.
    let each_matters = || row.iter().all(|&i| without(row, i) != all_options);
    (images.all(|other| other == image)
        && !is_contradictory(&all_options)
        && !REDUNDANT_PAIRS.iter().any(redundant)
        && each_matters())
    .then_some(image)
}

/// Returns the options of a row and those that they require.
fn row_options(row: &[usize]) -> String {
    let parts: Vec<&str> = row
        .iter()
        .flat_map(|&i| [CASES[i].needs, CASES[i].option])
        .collect();
    merge_options(&parts)
}

/// Returns the options of a row without one of them.
fn without(row: &[usize], excluded: usize) -> String {
    let option_of = |i: usize| if i == excluded { "" } else { CASES[i].option };
    let parts: Vec<&str> = row
        .iter()
        .flat_map(|&i| [CASES[i].needs, option_of(i)])
        .collect();
    merge_options(&parts)
}

/// Returns rows of at most `LONGEST` options such that each pair is in one row (a covering array of
/// strength two). In each step the option that covers most new pairs is added, if it is compatible
/// with all others of the row.
fn covering_rows(pairs: &BTreeSet<[usize; 2]>) -> Vec<Row> {
    const LONGEST: usize = 12;
    let pair = |a: usize, b: usize| [a.min(b), a.max(b)];
    let (mut uncovered, mut rows) = (pairs.clone(), Vec::new());
    while let Some(&first) = uncovered.iter().next() {
        let mut row = first.to_vec();
        while row.len() < LONGEST {
            let gain = |&next: &usize| {
                row.iter()
                    .filter(|&&i| uncovered.contains(&pair(i, next)))
                    .count()
            };
            let fits = |&next: &usize| {
                let is_compatible = |&i: &usize| i != next && pairs.contains(&pair(i, next));
                row.iter().all(is_compatible)
                    && common_image(&[&row[..], &[next]].concat()).is_some()
            };
            let next = (0..CASES.len())
                .filter(fits)
                .max_by_key(|next| (gain(next), CASES.len() - next));
            match next.filter(|next| gain(next) > 0) {
                Some(next) => row.push(next),
                None => break,
            }
        }
        for (k, &a) in row.iter().enumerate() {
            for &b in &row[..k] {
                uncovered.remove(&pair(a, b));
            }
        }
        rows.push(row);
    }
    rows
}

/// Returns the runs of rows: with all options and without each of them.
fn runs(rows: &[Row]) -> BTreeSet<RunInput> {
    let runs_of_row = |row: &Row| {
        let image = common_image(row).unwrap().to_string();
        let reduced = row.iter().map(|&i| without(row, i));
        let all_runs = reduced.chain([row_options(row)]);
        all_runs
            .map(|options| (image.clone(), options))
            .collect::<Vec<_>>()
    };
    rows.iter().flat_map(runs_of_row).collect()
}

/// Returns for each option of a row whether it changes the result beside the others. The value is
/// `None` if the row is refused also without the option, so that nothing can be said.
fn changes(row: &Row, results: &BTreeMap<RunInput, RunResult>) -> Vec<(usize, Option<bool>)> {
    let image = common_image(row).unwrap().to_string();
    let full = &results[&(image.clone(), row_options(row))];
    let change = |&i: &usize| {
        let reduced = &results[&(image.clone(), without(row, i))];
        (i, (reduced.code == Some(0)).then_some(full != reduced))
    };
    row.iter().map(change).collect()
}

/// Returns a folder in which rows of options can be run.
fn folder_with_inputs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let input_folder = folder.path().join("in");
    std::fs::create_dir(&input_folder).unwrap();
    write_inputs(&input_folder);
    folder
}

#[test]
fn no_single_option_is_ignored() {
    let folder = folder_with_inputs();
    let rows: Vec<Row> = (0..CASES.len()).map(|i| vec![i]).collect();
    let results = run_all(folder.path(), runs(&rows));
    for row in &rows {
        let [(i, change)] = changes(row, &results)[..] else {
            panic!("{row:?}");
        };
        assert_ne!(change, Some(false), "{} is ignored", CASES[i].option);
    }
}

/// Returns the pairs of options of which the first changes something beside the second, or, if both
/// are the same, alone.
fn effective_pairs(
    rows: &[Row],
    results: &BTreeMap<RunInput, RunResult>,
) -> BTreeSet<(usize, usize)> {
    let mut pairs = BTreeSet::new();
    for row in rows {
        for (i, change) in changes(row, results) {
            if change == Some(true) {
                pairs.extend(row.iter().map(|&other| (i, other)));
            }
        }
    }
    pairs
}

#[test]
#[ignore = "slow: make test-all"]
fn no_pair_of_options_is_accepted_and_then_ignored() {
    let folder = folder_with_inputs();
    let describe = |row: &[usize]| {
        row.iter()
            .map(|&i| CASES[i].option)
            .collect::<Vec<_>>()
            .join("' beside '")
    };

    // A pair that is refused, because one option alone is refused or by `--print-config`, must be
    // refused also when it is run, unless one option is what the other one needs.
    let input = |row: &Row, more_options: &str| {
        (
            common_image(row).unwrap().to_string(),
            row_options(row) + more_options,
        )
    };
    let alone: Vec<Row> = (0..CASES.len()).map(|i| vec![i]).collect();
    let pairs = (0..CASES.len()).flat_map(|b| (0..b).map(move |a| vec![a, b]));
    let pairs: Vec<Row> = pairs.filter(|pair| common_image(pair).is_some()).collect();
    let run_alone = alone.iter().map(|row| input(row, ""));
    let printing = pairs.iter().map(|pair| input(pair, " --print-config"));
    let trials = run_all(folder.path(), run_alone.chain(printing).collect());
    let is_accepted = |pair: &Row| {
        let is_refused = |&i: &usize| trials[&input(&alone[i], "")].code != Some(0);
        !pair.iter().any(is_refused) && trials[&input(pair, " --print-config")].code == Some(0)
    };
    let (accepted, refused): (Vec<Row>, Vec<Row>) = pairs.into_iter().partition(is_accepted);
    let results = run_all(
        folder.path(),
        refused.iter().map(|pair| input(pair, "")).collect(),
    );
    let (refused, completed): (Vec<Row>, Vec<Row>) =
        (refused.into_iter()).partition(|pair| results[&input(pair, "")].code == Some(1));

    // In the accepted pairs each option changes something beside each other option and alone.
    let rows = covering_rows(&accepted.iter().map(|pair| [pair[0], pair[1]]).collect());
    let rows: Vec<Row> = rows.into_iter().chain(alone).collect();
    let mut results = run_all(folder.path(), runs(&rows));
    let proven = effective_pairs(&rows, &results);
    // If a third option hides an effect, or the whole row is refused, the pair is tried by itself.
    let doubtful =
        |pair: &Row| !proven.contains(&(pair[0], pair[1])) || !proven.contains(&(pair[1], pair[0]));
    let again = accepted
        .iter()
        .filter(|pair| doubtful(pair))
        .chain(&completed);
    let again: Vec<Row> = again.cloned().collect();
    let remaining_runs: BTreeSet<RunInput> = runs(&again)
        .into_iter()
        .filter(|input| !results.contains_key(input))
        .collect();
    println!(
        "{} pairs are refused, {} are in {} rows, {} are tried by themselves; {} runs",
        refused.len(),
        accepted.len(),
        rows.len(),
        again.len(),
        results.len() + remaining_runs.len()
    );
    results.extend(run_all(folder.path(), remaining_runs));
    let mut ignored = Vec::new();
    let mut tested: BTreeSet<usize> = proven.iter().map(|&(i, _)| i).collect();
    for row in rows.iter().filter(|row| row.len() == 1).chain(&again) {
        for (i, change) in changes(row, &results) {
            match change {
                Some(true) => drop(tested.insert(i)),
                Some(false) if !has_no_effect_here(row, i) => {
                    ignored.push(format!("'{}' in '{}'", CASES[i].option, describe(row)))
                }
                _ => (),
            }
        }
    }
    let listed = ignored.join("\n");
    assert!(
        ignored.is_empty(),
        "{} are ignored:\n{listed}",
        ignored.len()
    );
    // These options, and `--distance-from` with a range of distances, are tested by the refusal of
    // jobs without them.
    let needed = ["--object 72,96", "--raw 72x64:f32le"];
    for (i, case) in CASES.iter().enumerate() {
        let is_tested = tested.contains(&i)
            || needed.contains(&case.option)
            || case.option.starts_with("--distance-from");
        assert!(is_tested, "{} was never tried", case.option);
    }
}

/// Returns the commands of each page of the documentation, in their order.
fn pages() -> Vec<Vec<String>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut folders, mut paths) = (vec![root.join("docs")], vec![root.join("README.md")]);
    while let Some(folder) = folders.pop() {
        let entries = std::fs::read_dir(folder).unwrap();
        for path in entries.map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "md") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    let command = |line: &str| {
        let line = line.trim().trim_start_matches("$ ");
        let line = line.split(" #").next().unwrap_or_default().trim();
        // Examples within a sentence have other text beside them.
        let command = line.strip_prefix("atomesh ");
        command.filter(|c| !c.contains('`')).map(str::to_string)
    };
    let commands = |path: &std::path::PathBuf| {
        let text = std::fs::read_to_string(path).unwrap();
        let text = text.replace("\\\n", " ");
        text.lines().filter_map(command).collect()
    };
    paths.iter().map(commands).collect()
}

/// Returns the commands of the documentation that mesh an image, without `mesh` itself.
fn examples() -> BTreeSet<String> {
    let commands = pages().into_iter().flatten();
    commands
        .filter_map(|c| c.strip_prefix("mesh ").map(str::to_string))
        .collect()
}

#[test]
fn the_configuration_of_every_example_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    std::fs::create_dir(dir.join("data")).unwrap();
    let examples = examples();
    assert!(examples.len() > 20, "{examples:#?}");
    for example in &examples {
        let printed = run_args(
            dir,
            &[&["mesh"], &words(example)[..], &["--print-config"]].concat(),
        );
        std::fs::write(dir.join("job.toml"), &printed).unwrap();
        let again = run_args(dir, &["mesh", "--config", "job.toml", "--print-config"]);
        assert_eq!(again, printed, "{example}");
    }
}

#[test]
fn a_printed_configuration_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_inputs(dir);
    for options in [
        "--distance 5:9 --distance-from features --kappa 0.7 --feature edges",
        "--cells voronoi --weld 0.05 --well well.csv --well-distance 5",
        "--seeding canny --smooth odt",
    ] {
        let mesh_content = [&["mesh", "layers.mha", "-o", "m.vtu"], &words(options)[..]].concat();
        run_args(dir, &[&mesh_content[..], &["--quiet"]].concat());
        let bytes = std::fs::read(dir.join("m.vtu")).unwrap();
        let printed = run_args(dir, &[&mesh_content[..], &["--print-config"]].concat());
        std::fs::write(dir.join("job.toml"), printed).unwrap();
        run_args(
            dir,
            &["mesh", "layers.mha", "--config", "job.toml", "--quiet"],
        );
        assert!(
            std::fs::read(dir.join("m.vtu")).unwrap() == bytes,
            "{options}"
        );
    }
}

/// Returns points `x y z` of a gentle hill above the sample volume and around it.
fn ground() -> String {
    let places = (0..=40).flat_map(|i| (0..=40).map(move |j| [i, j].map(|k| 7 * k - 80)));
    let height = |x: i32, y: i32| 50.0 + 0.1 * f64::from(x) + (0.03 * f64::from(y)).sin();
    places
        .map(|[x, y]| format!("{x} {y} {}\n", -height(x, y)))
        .collect()
}

/// Compares the meshes of every example whose image is in the repository or made by an earlier
/// command of its page.
#[test]
#[ignore = "slow: make test-all"]
fn examples_have_the_same_bytes_from_their_configurations() {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/faults.vti");
    let (mut seen, mut without_image) = (BTreeSet::new(), Vec::new());
    for commands in pages() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        std::fs::create_dir(dir.join("data")).unwrap();
        std::fs::copy(&sample, dir.join("data/faults.vti")).unwrap();
        std::fs::write(dir.join("ground.xyz"), ground()).unwrap();
        for command in commands {
            let command = words(&command);
            let exists = |word: &&str| dir.join(word).exists();
            match command[..] {
                ["synth", ..] => drop(run_args(dir, &[&command[..], &["--quiet"]].concat())),
                ["mesh", image, ..] if exists(&image) => {
                    let mut typed = command.clone();
                    if let Some(o) = typed.iter().position(|word| *word == "-o") {
                        typed.drain(o..o + 2);
                    }
                    // Pages repeat some commands.
                    let samples = std::fs::read(dir.join(image)).unwrap();
                    if !seen.insert((samples, typed[2..].join(" "))) {
                        continue;
                    }
                    let mesh = |arguments: &[&str]| {
                        run_args(dir, &[arguments, &["-o", "m.vtu", "--quiet"]].concat());
                        std::fs::read(dir.join("m.vtu")).unwrap()
                    };
                    let bytes = mesh(&typed);
                    let printed = run_args(dir, &[&typed[..], &["--print-config"]].concat());
                    std::fs::write(dir.join("job.toml"), printed).unwrap();
                    let again = mesh(&["mesh", image, "--config", "job.toml"]);
                    assert!(again == bytes, "{}", command.join(" "));
                }
                ["mesh", ..] => without_image.push(command.join(" ")),
                _ => {}
            }
        }
    }
    let same = seen.len();
    println!("{same} examples; without an image {without_image:#?}");
    assert!(same >= 10, "{same}");
    assert!(without_image.len() <= 25, "{without_image:#?}");
}

#[test]
fn an_installation_has_completions_manual_pages_and_a_self_test() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    for (shell, word) in [
        ("bash", "complete"),
        ("zsh", "#compdef"),
        ("fish", "complete -c"),
    ] {
        let text = run_args(dir, &["completions", shell]);
        assert!(text.contains(word) && text.contains("columns"), "{shell}");
    }
    run_args(dir, &["man", "-o", "."]);
    let page = std::fs::read_to_string(dir.join("atomesh-mesh.1")).unwrap();
    assert!(page.contains(".TH") && page.contains("distance"));
    assert!(dir.join("atomesh.1").exists());
    let messages: serde_json::Value =
        serde_json::from_str(&run_args(dir, &["doctor", "--json"])).unwrap();
    assert_eq!(messages["atomesh"], env!("CARGO_PKG_VERSION"));
    let starts_with = |key: &str, text: &str| messages[key].as_str().unwrap().starts_with(text);
    let (licence, tetgen) = match (cfg!(feature = "tetgen"), cfg!(feature = "cgal")) {
        (true, _) => ("AGPL-3.0 as a whole", "built in (AGPL-3.0)"),
        (false, true) => ("GPL-3.0 as a whole", "not built in"),
        (false, false) => ("MIT OR Apache-2.0", "not built in"),
    };
    assert!(starts_with("licence", licence) && starts_with("TetGen", tetgen));
    let error = expect_refusal(dir, &["man", "-o", "absent"]);
    assert!(error.contains("is not a folder"), "{error}");
}
