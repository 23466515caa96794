//! No option of `mesh` is accepted and then ignored: alone and with every other it changes what comes
//! out, or is refused. And a job survives `--print-config` and `--config`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::{atomesh, files_below, expect_refusal, run_args};
use atomesh::store::{AnyMesh, read_any_vtu};
use serde_json::Value;

/// An option with a value that is none by default.
struct OptionCase {
    /// The image that it needs; `layers.mha` does for the others.
    image: Option<&'static str>,
    /// Options without which it would be refused.
    needs: &'static str,
    /// The option and its value.
    says: &'static str,
}

const fn any(says: &'static str) -> OptionCase {
    with("", says)
}

const fn with(needs: &'static str, says: &'static str) -> OptionCase {
    OptionCase {
        image: None,
        needs,
        says,
    }
}

const fn of(image: &'static str, needs: &'static str, says: &'static str) -> OptionCase {
    OptionCase {
        image: Some(image),
        needs,
        says,
    }
}

/// Every option of `mesh`, some with more than one value.
const CHOICES: &[OptionCase] = &[
    any("--distance 6"),
    with("--distance 5:9", "--distance-from image"),
    with("--distance 5:9", "--distance-from features"),
    with("--distance 5:9", "--distance-from laplacian"),
    with("--distance 5:9", "--distance-from ../in/distances.mha"),
    any("--feature edges"),
    of("labels.mha", "", "--feature labels"),
    any("--sigma 2.5"),
    any("--threshold 0.08"),
    of("labels.mha", "", "--threshold 0.9"),
    of("labels.mha", "", "--label 1:distance=6,name=disc"),
    of("labels.mha", "", "--label 2:into=1"),
    of(
        "faulted.mha",
        "--feature faults+horizons",
        "--feature-weights 1,0.3",
    ),
    of("rings.mha", "--feature paths", "--object 72,96"),
    of(
        "rings.mha",
        "--feature paths --object 72,96",
        "--background 40,96",
    ),
    any("--potential-out b.vti"),
    any("--lines l.vtp"),
    any("--checkpoint kept"),
    any("--align alongside"),
    any("--cells voronoi"),
    any("--beta 0.1"),
    any("--beta ../in/weights.mha"),
    with("--distance 8", "--seeding grown"),
    any("--seeding refine"),
    any("--seeding guide"),
    any("--seeding projection"),
    any("--seeding canny"),
    with("--seeding guide", "--max-atoms 30"),
    any("--atoms-from ../in/atoms.csv"),
    any("--well ../in/well.csv"),
    with("--well ../in/well.csv", "--well-distance 4"),
    any("--evaluator sampled"),
    any("--kappa 0.7"),
    any("--optimizer descent"),
    any("--optimizer genetic"),
    any("--rounds 2"),
    any("--coarse-to-fine 1"),
    any("--min-dihedral 12"),
    any("--slivers none"),
    any("--slivers exude"),
    with("--cells voronoi", "--weld 0.1"),
    any("--smooth odt"),
    any("--metric physical"),
    any("--metric 1,1.4"),
    any("--metric shape"),
    any("--velocity 2400"),
    any("--rng-seed 7"),
    any("--report r.json"),
    any("--trace t.pvd"),
    of("layers.raw", "", "--raw 72x64:f32le"),
    of("layers.raw", "--raw 72x64:f32le", "--spacing 2,3"),
    of("nulls.mha", "", "--null 7"),
    any("--inline-byte 9"),
    any("--crossline-byte 21"),
    any("--x-byte 73"),
    any("--y-byte 77"),
    any("--scalar-byte 69"),
    any("--delay-byte 105"),
    any("--interval-byte 119"),
    any("-o other.vtu"),
];

/// Options of which, one given, the other says what is so anyhow: alongside is where atoms of Voronoi
/// cells stand; a lattice whose distance varies, be it for wells, is always grown, as the help says of
/// fcc; bare samples are 1 apart, in metres as in samples; labels for which something is wanted are followed.
const TWINS: [[&str; 2]; 7] = [
    ["--feature labels", "--label 1:distance"],
    ["--seeding grown", "--label 1:distance"],
    ["--align alongside", "--cells voronoi"],
    ["--seeding grown", "--distance-from"],
    ["--seeding grown", "--well-distance"],
    ["--metric physical", "--raw"],
    ["--metric shape", "--raw"],
];

/// What came of a run: exit code, what was said, figures, and the files with what is in them.
#[derive(Debug, Clone, PartialEq)]
struct RunResult {
    code: Option<i32>,
    said: String,
    files: BTreeMap<String, Vec<u8>>,
}

fn words(text: &str) -> Vec<&str> {
    text.split_whitespace().collect()
}

/// The names of options among words.
fn names(text: &str) -> BTreeSet<&str> {
    words(text)
        .into_iter()
        .filter(|w| w.starts_with('-'))
        .collect()
}

/// The words of several choices, each option once.
fn joined(parts: &[&str]) -> String {
    let mut all: Vec<String> = Vec::new();
    for part in parts {
        let mut option = Vec::new();
        for word in words(part).into_iter().chain(["-"]) {
            if word.starts_with('-') && !option.is_empty() {
                let text = option.join(" ");
                if !all.contains(&text) {
                    all.push(text);
                }
                option.clear();
            }
            option.push(word);
        }
    }
    all.sort();
    all.join(" ")
}

/// Whether options occur twice with different values.
fn contradict(text: &str) -> bool {
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
    let mut said = String::from_utf8_lossy(&output.stderr).into_owned();
    if let Ok(mut report) = serde_json::from_slice::<Value>(&output.stdout) {
        // What was asked for, and how long it took, are no results.
        for key in ["parameters", "verdict", "stages"] {
            report.as_object_mut().unwrap().remove(key);
        }
        said += &report.to_string();
    }
    let content = |path: &Path, bytes: Vec<u8>| match path.extension().and_then(|e| e.to_str()) {
        Some("vtu") => mesh(path).into_bytes(),
        Some("json") => Vec::new(),
        _ => bytes,
    };
    let named = |(path, bytes): (std::path::PathBuf, Vec<u8>)| {
        let name = path.strip_prefix(folder).unwrap().display().to_string();
        (name, content(&path, bytes))
    };
    let files = files_below(folder).into_iter().map(named).collect();
    std::fs::remove_dir_all(folder).unwrap();
    RunResult {
        code: output.status.code(),
        said,
        files,
    }
}

/// All that a mesh's file holds but how it was made.
fn mesh(path: &Path) -> String {
    // The points of a lattice's rounds are no mesh.
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

/// Writes a MetaImage of float32 whose samples are 2 and 3 apart.
fn mha(path: &Path, value: impl Fn(f64, f64) -> f64) {
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
    let at = |i: usize| value((i % nx) as f64, (i / nx) as f64) as f32;
    (0..nx * ny).flat_map(|i| at(i).to_le_bytes()).collect()
}

/// Something between -1 and 1 for each sample.
fn noise(x: f64, y: f64) -> f64 {
    (12.9898 * x + 78.233 * y).sin() * 43758.547 % 1.0
}

/// Layers that a fault breaks.
fn layers(x: f64, y: f64) -> f64 {
    let throw = if x > 36.0 + 0.2 * y { 5.0 } else { 0.0 };
    let depth = y + throw + 2.0 * (x / 20.0).sin();
    (depth / 4.0).sin() * (1.0 + 0.3 * (x / 9.0).cos()) + 0.1 * noise(x, y)
}

fn inputs(folder: &Path) {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    mha(&folder.join("layers.mha"), layers);
    std::fs::write(folder.join("layers.raw"), samples(layers)).unwrap();
    mha(&folder.join("faulted.mha"), layers);
    mha(&folder.join("nulls.mha"), |x, y| {
        if x > 66.0 { 7.0 } else { layers(x, y) }
    });
    // Background between the rings, or beyond both.
    let disc = |x: f64, y: f64, r| f64::from((x - 36.0).hypot(y - 32.0) < r);
    mha(&folder.join("rings.mha"), |x, y| {
        3.0 * (disc(x, y, 11.0) + disc(x, y, 23.0)) + 0.1 * noise(x, y)
    });
    mha(&folder.join("labels.mha"), |x, y| {
        disc(x, y, 15.0) + f64::from(x + y > 90.0)
    });
    mha(&folder.join("distances.mha"), |x, _| 5.0 + x / 20.0);
    mha(&folder.join("weights.mha"), |x, _| 0.2 + x / 200.0);
    write("atoms.csv", "x,y\n61.5,80\n");
    write("well.csv", "x,y,radius\n40,60,0.1\n70,110,0.1\n");
}

/// The results of all runs, by what was asked.
fn all(folder: &Path, asked: BTreeSet<RunInput>) -> BTreeMap<RunInput, RunResult> {
    let asked: Vec<RunInput> = asked.into_iter().collect();
    let (next, came) = (AtomicUsize::new(0), Mutex::new(BTreeMap::new()));
    let workers = std::thread::available_parallelism().map_or(2, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    let Some(one) = asked.get(number) else { break };
                    let result = run(&folder.join(number.to_string()), one);
                    came.lock().unwrap().insert(one.clone(), result);
                }
            });
        }
    });
    came.into_inner().unwrap()
}

/// Choices that are tried together: with all of them, and without each of them in turn.
type Row = Vec<usize>;

/// The image, if one has it, on which these choices can be tried together, unless they contradict or
/// presuppose one another.
fn image(row: &[usize]) -> Option<&'static str> {
    let mut images = row.iter().filter_map(|&i| CHOICES[i].image);
    let image = images.next().unwrap_or("layers.mha");
    let all = options(row);
    let twins = |twins: &[&str; 2]| twins.iter().all(|twin| all.contains(twin));
    // Where another choice needs an option, nothing is to be learned of it.
    let each_matters = || row.iter().all(|&i| without(row, i) != all);
    (images.all(|other| other == image)
        && !contradict(&all)
        && !TWINS.iter().any(twins)
        && each_matters())
    .then_some(image)
}

/// What the choices of a row say, and what they need.
fn options(row: &[usize]) -> String {
    let parts: Vec<&str> = row
        .iter()
        .flat_map(|&i| [CHOICES[i].needs, CHOICES[i].says])
        .collect();
    joined(&parts)
}

/// The options of a row without what one of its choices says.
fn without(row: &[usize], left_out: usize) -> String {
    let says = |i: usize| if i == left_out { "" } else { CHOICES[i].says };
    let parts: Vec<&str> = row
        .iter()
        .flat_map(|&i| [CHOICES[i].needs, says(i)])
        .collect();
    joined(&parts)
}

/// Rows of at most `LONGEST` choices, so that each of the pairs is in one (a covering array of strength two):
/// whichever choice makes most new pairs is added, as long as it can stand beside all others of its row.
fn covering_rows(pairs: &BTreeSet<[usize; 2]>) -> Vec<Row> {
    const LONGEST: usize = 12;
    let pair = |a: usize, b: usize| [a.min(b), a.max(b)];
    let (mut open, mut rows) = (pairs.clone(), Vec::new());
    while let Some(&first) = open.iter().next() {
        let mut row = first.to_vec();
        while row.len() < LONGEST {
            let gain = |&next: &usize| {
                row.iter()
                    .filter(|&&i| open.contains(&pair(i, next)))
                    .count()
            };
            let fits = |&next: &usize| {
                let beside = |&i: &usize| i != next && pairs.contains(&pair(i, next));
                row.iter().all(beside) && image(&[&row[..], &[next]].concat()).is_some()
            };
            let next = (0..CHOICES.len())
                .filter(fits)
                .max_by_key(|next| (gain(next), CHOICES.len() - next));
            match next.filter(|next| gain(next) > 0) {
                Some(next) => row.push(next),
                None => break,
            }
        }
        for (k, &a) in row.iter().enumerate() {
            for &b in &row[..k] {
                open.remove(&pair(a, b));
            }
        }
        rows.push(row);
    }
    rows
}

/// Runs of rows, with all of their choices and without each.
fn runs(rows: &[Row]) -> BTreeSet<RunInput> {
    let of_row = |row: &Row| {
        let image = image(row).unwrap().to_string();
        let fewer = row.iter().map(|&i| without(row, i));
        let all = fewer.chain([options(row)]);
        all.map(|options| (image.clone(), options))
            .collect::<Vec<_>>()
    };
    rows.iter().flat_map(of_row).collect()
}

/// Whether each choice of a row changes anything beside the others; `None` where it cannot be told, because
/// the row is refused without the choice, too.
fn changes(row: &Row, came: &BTreeMap<RunInput, RunResult>) -> Vec<(usize, Option<bool>)> {
    let image = image(row).unwrap().to_string();
    let with = &came[&(image.clone(), options(row))];
    let change = |&i: &usize| {
        let without = &came[&(image.clone(), without(row, i))];
        (i, (without.code == Some(0)).then_some(with != without))
    };
    row.iter().map(change).collect()
}

/// A folder in which rows of choices can be run.
fn folder_with_inputs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let put = folder.path().join("in");
    std::fs::create_dir(&put).unwrap();
    inputs(&put);
    folder
}

#[test]
fn no_option_is_ignored_alone() {
    let folder = folder_with_inputs();
    let rows: Vec<Row> = (0..CHOICES.len()).map(|i| vec![i]).collect();
    let came = all(folder.path(), runs(&rows));
    for row in &rows {
        let [(i, change)] = changes(row, &came)[..] else {
            panic!("{row:?}");
        };
        assert_ne!(change, Some(false), "{} is ignored", CHOICES[i].says);
    }
}

#[test]
#[ignore = "slow: make test-all"]
fn no_option_is_accepted_and_then_ignored() {
    let folder = folder_with_inputs();
    let says = |row: &[usize]| {
        row.iter()
            .map(|&i| CHOICES[i].says)
            .collect::<Vec<_>>()
            .join("' beside '")
    };

    // What is refused alone, or as a pair without running the job, is refused as a pair when it is run; unless the
    // other choice is what it needs.
    let asked = |row: &Row, more: &str| (image(row).unwrap().to_string(), options(row) + more);
    let alone: Vec<Row> = (0..CHOICES.len()).map(|i| vec![i]).collect();
    let pairs = (0..CHOICES.len()).flat_map(|b| (0..b).map(move |a| vec![a, b]));
    let pairs: Vec<Row> = pairs.filter(|pair| image(pair).is_some()).collect();
    let run_alone = alone.iter().map(|row| asked(row, ""));
    let printing = pairs.iter().map(|pair| asked(pair, " --print-config"));
    let tried = all(folder.path(), run_alone.chain(printing).collect());
    let is_taken = |pair: &Row| {
        let is_refused = |&i: &usize| tried[&asked(&alone[i], "")].code != Some(0);
        !pair.iter().any(is_refused) && tried[&asked(pair, " --print-config")].code == Some(0)
    };
    let (taken, refused): (Vec<Row>, Vec<Row>) = pairs.into_iter().partition(is_taken);
    let came = all(
        folder.path(),
        refused.iter().map(|pair| asked(pair, "")).collect(),
    );
    let (refused, helped): (Vec<Row>, Vec<Row>) =
        (refused.into_iter()).partition(|pair| came[&asked(pair, "")].code == Some(1));

    // Of the others, each choice changes something beside each other and alone.
    let rows = covering_rows(&taken.iter().map(|pair| [pair[0], pair[1]]).collect());
    let rows: Vec<Row> = rows.into_iter().chain(alone).collect();
    let mut came = all(folder.path(), runs(&rows));
    let mut shown = BTreeSet::new();
    for row in &rows {
        for (i, change) in changes(row, &came) {
            if change == Some(true) {
                shown.extend(row.iter().map(|&other| (i, other)));
            }
        }
    }
    // Where a third choice hides what one does, or the whole row is refused, the pair is tried by itself.
    let doubtful =
        |pair: &Row| !shown.contains(&(pair[0], pair[1])) || !shown.contains(&(pair[1], pair[0]));
    let again = taken.iter().filter(|pair| doubtful(pair)).chain(&helped);
    let again: Vec<Row> = again.cloned().collect();
    let more: BTreeSet<RunInput> = runs(&again)
        .into_iter()
        .filter(|asked| !came.contains_key(asked))
        .collect();
    println!(
        "{} pairs are refused, {} are in {} rows, {} are tried by themselves; {} runs",
        refused.len(),
        taken.len(),
        rows.len(),
        again.len(),
        came.len() + more.len()
    );
    came.extend(all(folder.path(), more));
    let mut ignored = Vec::new();
    let mut learned: BTreeSet<usize> = shown.iter().map(|&(i, _)| i).collect();
    for row in rows.iter().filter(|row| row.len() == 1).chain(&again) {
        for (i, change) in changes(row, &came) {
            match change {
                Some(true) => drop(learned.insert(i)),
                Some(false) => ignored.push(format!("'{}' in '{}'", CHOICES[i].says, says(row))),
                None => (),
            }
        }
    }
    let listed = ignored.join("\n");
    assert!(
        ignored.is_empty(),
        "{} are ignored:\n{listed}",
        ignored.len()
    );
    // These, and what a range of distances follows, are refused, and so tested, where they are absent.
    let needed = ["--object 72,96", "--raw 72x64:f32le"];
    for (i, choice) in CHOICES.iter().enumerate() {
        let tried = learned.contains(&i)
            || needed.contains(&choice.says)
            || choice.says.starts_with("--distance-from");
        assert!(tried, "{} was never tried", choice.says);
    }
}

/// The commands of each page of the documentation, in their order.
fn pages() -> Vec<Vec<String>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let entries = std::fs::read_dir(root.join("docs")).unwrap();
    let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|e| e == "md"));
    paths.push(root.join("README.md"));
    paths.sort();
    let command = |line: &str| {
        let line = line.trim().trim_start_matches("$ ");
        let line = line.split(" #").next().unwrap_or_default().trim();
        // The text beside them is no part of examples within a sentence.
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

/// The commands of the documentation that mesh an image, without `mesh` itself.
fn examples() -> BTreeSet<String> {
    let commands = pages().into_iter().flatten();
    commands
        .filter_map(|c| c.strip_prefix("mesh ").map(str::to_string))
        .collect()
}

#[test]
fn every_example_survives_its_own_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir(at.join("data")).unwrap();
    let examples = examples();
    assert!(examples.len() > 20, "{examples:#?}");
    for example in &examples {
        let printed = run_args(
            at,
            &[&["mesh"], &words(example)[..], &["--print-config"]].concat(),
        );
        std::fs::write(at.join("job.toml"), &printed).unwrap();
        let again = run_args(at, &["mesh", "--config", "job.toml", "--print-config"]);
        assert_eq!(again, printed, "{example}");
    }
}

#[test]
fn a_printed_configuration_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    inputs(at);
    for options in [
        "--distance 5:9 --distance-from features --kappa 0.7 --feature edges",
        "--cells voronoi --weld 0.05 --well well.csv --well-distance 5",
        "--seeding canny --smooth odt",
    ] {
        let mesh = [&["mesh", "layers.mha", "-o", "m.vtu"], &words(options)[..]].concat();
        run_args(at, &[&mesh[..], &["--quiet"]].concat());
        let bytes = std::fs::read(at.join("m.vtu")).unwrap();
        let printed = run_args(at, &[&mesh[..], &["--print-config"]].concat());
        std::fs::write(at.join("job.toml"), printed).unwrap();
        run_args(
            at,
            &["mesh", "layers.mha", "--config", "job.toml", "--quiet"],
        );
        assert!(
            std::fs::read(at.join("m.vtu")).unwrap() == bytes,
            "{options}"
        );
    }
}

/// Every example whose image is in the repository or made by a command above it.
#[test]
#[ignore = "slow: make test-all"]
#[cfg(feature = "tetgen")]
fn examples_give_the_same_bytes_from_their_configurations() {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/faults.vti");
    let (mut seen, mut without_image) = (BTreeSet::new(), Vec::new());
    for commands in pages() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        std::fs::create_dir(at.join("data")).unwrap();
        std::fs::copy(&sample, at.join("data/faults.vti")).unwrap();
        for command in commands {
            let command = words(&command);
            let there = |word: &&str| at.join(word).exists();
            match command[..] {
                ["synth", ..] => drop(run_args(at, &[&command[..], &["--quiet"]].concat())),
                ["mesh", image, ..] if there(&image) => {
                    let mut typed = command.clone();
                    if let Some(o) = typed.iter().position(|word| *word == "-o") {
                        typed.drain(o..o + 2);
                    }
                    // Pages repeat one another.
                    let samples = std::fs::read(at.join(image)).unwrap();
                    if !seen.insert((samples, typed[2..].join(" "))) {
                        continue;
                    }
                    let mesh = |more: &[&str]| {
                        run_args(at, &[more, &["-o", "m.vtu", "--quiet"]].concat());
                        std::fs::read(at.join("m.vtu")).unwrap()
                    };
                    let bytes = mesh(&typed);
                    let printed = run_args(at, &[&typed[..], &["--print-config"]].concat());
                    std::fs::write(at.join("job.toml"), printed).unwrap();
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
fn an_installation_says_what_it_is_and_how_it_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (shell, word) in [
        ("bash", "complete"),
        ("zsh", "#compdef"),
        ("fish", "complete -c"),
    ] {
        let text = run_args(at, &["completions", shell]);
        assert!(text.contains(word) && text.contains("columns"), "{shell}");
    }
    run_args(at, &["man", "-o", "."]);
    let page = std::fs::read_to_string(at.join("atomesh-mesh.1")).unwrap();
    assert!(page.contains(".TH") && page.contains("distance"));
    assert!(at.join("atomesh.1").exists());
    let said: serde_json::Value =
        serde_json::from_str(&run_args(at, &["doctor", "--json"])).unwrap();
    assert_eq!(said["atomesh"], env!("CARGO_PKG_VERSION"));
    assert_eq!(said["TetGen"], "built in (AGPL-3.0)");
    let error = expect_refusal(at, &["man", "-o", "absent"]);
    assert!(error.contains("is no folder"), "{error}");
}
