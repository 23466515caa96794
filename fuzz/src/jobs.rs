//! Checks any small image with any options and any verb, as the bytes of the fuzzer select.

use std::fs;
use std::path::Path;

use atomesh::image::{Geometry, Image, formats};

use super::verbs::{run_mesh_verb, run_verb};

/// Choices that bytes make. Without further bytes it is the first one.
struct Choices<'a>(&'a [u8]);

impl Choices<'_> {
    fn byte(&mut self) -> usize {
        match self.0.split_first() {
            Some((&byte, rest)) => {
                self.0 = rest;
                usize::from(byte)
            }
            None => 0,
        }
    }

    fn pick<T: Copy>(&mut self, items: &[T]) -> T {
        items[self.byte() % items.len()]
    }

    /// Returns `true` in one of `n` cases.
    fn one_in(&mut self, n: usize) -> bool {
        self.byte() % n == n - 1
    }

    /// Returns a number in [0, 1).
    fn fraction(&mut self) -> f64 {
        (self.byte() * 256 + self.byte()) as f64 / 65536.0
    }

    /// Returns a point in the box of an image, in one of 16 cases possibly outside.
    fn point(&mut self, image_box: &ImageBox) -> String {
        let scale = if self.one_in(16) { 1.4 } else { 1.0 };
        let point: Vec<f64> = (0..image_box.dims)
            .map(|k| image_box.origin[k] + image_box.size[k] * scale * self.fraction())
            .collect();
        point
            .iter()
            .map(|x| format!("{x}"))
            .collect::<Vec<_>>()
            .join(",")
    }
}

/// The box of an image in physical coordinates.
struct ImageBox {
    dims: usize,
    origin: [f64; 3],
    size: [f64; 3],
}

impl ImageBox {
    fn longest_side(&self) -> f64 {
        self.size.into_iter().fold(0.0, f64::max)
    }
}

/// Writes an image, meshes it, and runs one more verb on the mesh.
///
/// # Panics
/// Panics if a verb breaks a promise of [`run_verb`] or [`run_mesh_verb`].
pub fn check_job(folder: &Path, bytes: &[u8]) {
    clear(folder);
    let choices = &mut Choices(bytes);
    let image = folder.join(choices.pick(&["i.npy", "i.nrrd", "i.vti"]));
    let Some(image_box) = write_image(choices, &image) else {
        return;
    };
    let mesh = folder.join("m.vtu");
    let mut words = vec![
        "mesh".to_string(),
        text(&image),
        "-o".into(),
        text(&mesh),
        "--max-memory".into(),
        "1G".into(),
    ];
    let unit = add_spacing(choices, &image_box, &mut words);
    for _ in 0..choices.byte() % 6 {
        let (option, values) = choices.pick(&MESH_OPTIONS);
        if !words.iter().any(|word| word == option) {
            words.extend([option.to_string(), choices.pick(values).to_string()]);
        }
    }
    add_files(choices, folder, &image_box, unit, &mut words);
    if run_mesh_verb(folder, &words, &mesh) {
        let second = SecondVerb {
            folder,
            image: text(&image),
            mesh: text(&mesh),
            image_box,
        };
        second.run(choices);
    }
}

/// Removes everything in a folder.
fn clear(folder: &Path) {
    for entry in fs::read_dir(folder).expect("the folder").flatten() {
        let path = entry.path();
        let _ = if path.is_dir() {
            fs::remove_dir_all(path)
        } else {
            fs::remove_file(path)
        };
    }
}

fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

/// Options of `mesh` and some of their values.
const MESH_OPTIONS: [(&str, &[&str]); 20] = [
    (
        "--feature",
        &[
            "auto",
            "ridges",
            "valleys",
            "edges",
            "canny",
            "paths",
            "horizons",
            "faults",
            "faults+horizons",
            "labels",
            "potential",
        ],
    ),
    (
        "--distance-from",
        &["gaps", "features", "image", "laplacian"],
    ),
    ("--sigma", &["1", "0.5", "2", "5", "100", "0"]),
    ("--threshold", &["0", "0.01", "0.5", "1e9", "nan"]),
    ("--feature-weights", &["0.5,1", "1,0.1", "0,1"]),
    ("--align", &["on", "alongside"]),
    ("--cells", &["voronoi", "voronoi", "tets"]),
    ("--beta", &["0", "0.3", "0.8", "0.99", "1"]),
    (
        "--seeding",
        &["fcc", "grown", "refine", "canny", "guide", "projection"],
    ),
    ("--max-atoms", &["10", "0", "100", "5"]),
    ("--evaluator", &["pairwise", "sampled"]),
    ("--kappa", &["0.7", "0", "1"]),
    ("--optimizer", &["descent", "lbfgs", "genetic"]),
    ("--rounds", &["1", "4", "0"]),
    ("--coarse-to-fine", &["1", "3"]),
    ("--min-dihedral", &["20", "30", "45", "60", "0", "90"]),
    ("--slivers", &["none", "joe", "exude"]),
    ("--weld", &["0.1", "0.3", "0", "1"]),
    ("--smooth", &["cvt", "odt"]),
    ("--rng-seed", &["2", "3", "18446744073709551615"]),
];

/// Adds options of the distance between atoms. Returns the unit of distances: the length of a
/// twentieth of the image with a physical metric, else 1.
fn add_spacing(choices: &mut Choices, image_box: &ImageBox, words: &mut Vec<String>) -> f64 {
    // Images are so small that no job takes long.
    let distance = choices.pick(&["3", "4", "2.5:4", "6", "2", "5:6", "3:8", "1e9", "0", "1.5"]);
    let metric = choices.pick(&[
        "samples", "samples", "samples", "physical", "shape", "1,2,1.5", "1,2",
    ]);
    let unit = match metric {
        "physical" => image_box.longest_side() / 20.0,
        _ => 1.0,
    };
    if !choices.one_in(8) {
        let scaled = distance.split(':').map(|d| scale_number(d, unit));
        words.extend(["--distance".into(), scaled.collect::<Vec<_>>().join(":")]);
    }
    if metric != "samples" {
        words.extend(["--metric".into(), metric.into()]);
    }
    unit
}

/// Returns a number times `unit`; as it is written, if the unit is 1.
fn scale_number(number: &str, unit: f64) -> String {
    match number.parse::<f64>() {
        Ok(value) if unit != 1.0 => (value * unit).to_string(),
        _ => number.to_string(),
    }
}

/// Adds points of an object, wells, fixed atoms, and outputs.
fn add_files(
    choices: &mut Choices,
    folder: &Path,
    image_box: &ImageBox,
    unit: f64,
    words: &mut Vec<String>,
) {
    if choices.one_in(6) {
        words.extend([
            format!("--object={}", choices.point(image_box)),
            format!("--background={}", choices.point(image_box)),
        ]);
    }
    if choices.one_in(4) {
        let well = folder.join("w.csv");
        let radius = 0.02 * image_box.longest_side();
        let lines: Vec<String> = (0..1 + choices.byte() % 4)
            .map(|_| format!("{},{radius}", choices.point(image_box)))
            .collect();
        fs::write(&well, lines.join("\n")).expect("a file");
        words.extend(["--well".into(), text(&well)]);
        if choices.one_in(2) {
            words.extend(["--well-distance".into(), scale_number("1.5", unit)]);
        }
    }
    if choices.one_in(6) {
        let atoms = folder.join("a.csv");
        let lines: Vec<String> = (0..1 + choices.byte() % 5)
            .map(|_| choices.point(image_box))
            .collect();
        fs::write(&atoms, lines.join("\n")).expect("a file");
        words.extend(["--atoms-from".into(), text(&atoms)]);
    }
    for (option, name) in [
        ("--lines", "l.vtp"),
        ("--trace", "t.pvd"),
        ("--report", "r.json"),
        ("--potential-out", "p.vti"),
    ] {
        if choices.one_in(8) {
            words.extend([option.into(), text(&folder.join(name))]);
        }
    }
}

/// A verb that reads a mesh.
struct SecondVerb<'a> {
    folder: &'a Path,
    image: String,
    mesh: String,
    image_box: ImageBox,
}

fn words(list: &[&str]) -> Vec<String> {
    list.iter().map(|word| word.to_string()).collect()
}

impl SecondVerb<'_> {
    /// Runs one of the verbs.
    fn run(&self, choices: &mut Choices) {
        let line = match choices.byte() % 10 {
            0 => words(&["quality", &self.mesh]),
            1 | 2 => {
                let edited = self.out("e.vtu");
                let line = self.edit(choices, &edited);
                run_mesh_verb(self.folder, &line, Path::new(&edited));
                return;
            }
            3 => self.flow(choices),
            4 => self.surface(choices),
            5 => self.paint(choices),
            6 => self.segment(choices),
            7 => self.slice(choices),
            _ => self.export(choices),
        };
        run_verb(self.folder, &line);
    }

    /// Returns the path of an output.
    fn out(&self, name: &str) -> String {
        text(&self.folder.join(name))
    }

    /// Returns the command of an edit of some atoms; its output is `edited`.
    fn edit(&self, choices: &mut Choices, edited: &str) -> Vec<String> {
        let mut line = words(&["edit", &self.mesh, &self.image, "-o", edited]);
        for _ in 0..1 + choices.byte() % 3 {
            line.push(match choices.byte() % 3 {
                0 => format!("--add={}", choices.point(&self.image_box)),
                1 => format!(
                    "--move={}:{}",
                    choices.byte(),
                    choices.point(&self.image_box)
                ),
                _ => format!("--remove={}", choices.byte()),
            });
        }
        if choices.one_in(3) {
            line.push("--free".into());
        }
        line
    }

    /// Returns the command of a flow between two points.
    fn flow(&self, choices: &mut Choices) -> Vec<String> {
        let mut line = words(&["flow", &self.mesh, "-o", &self.out("f.vtu")]);
        line.extend([
            format!("--source={}", choices.point(&self.image_box)),
            format!("--sink={}", choices.point(&self.image_box)),
        ]);
        line.extend([
            "--faults".into(),
            choices
                .pick(&["closed", "open", "0.01", "1e-9", "0"])
                .into(),
        ]);
        if choices.one_in(3) {
            line.extend([
                "--streamlines".into(),
                self.out("s.vtp"),
                "--lines".into(),
                "20".into(),
            ]);
        }
        line
    }

    /// Returns the command that extracts a surface.
    fn surface(&self, choices: &mut Choices) -> Vec<String> {
        let mut line = words(&["surface", &self.mesh, "-o", &self.out("s.vtp")]);
        for (option, values) in [
            ("--max-bend", &["10", "60", "180"][..]),
            ("--min-area", &["0", "5", "1e9"]),
            ("--up", &["x", "-y", "z"]),
            ("--meets", &[]),
        ] {
            if choices.one_in(2) {
                line.push(option.into());
                line.extend(
                    values
                        .get(choices.byte() % values.len().max(1))
                        .map(|value| value.to_string()),
                );
            }
        }
        line
    }

    /// Returns the command that paints a region.
    fn paint(&self, choices: &mut Choices) -> Vec<String> {
        let mut line = words(&[
            "paint",
            &self.mesh,
            "-o",
            &self.out("p.vtu"),
            "--surface-out",
            &self.out("s.vtp"),
        ]);
        line.push(if choices.one_in(2) {
            format!("--seed={}", choices.point(&self.image_box))
        } else {
            "--seed=auto".into()
        });
        if choices.one_in(3) {
            line.extend(["--level".into(), choices.pick(&["2", "0", "100"]).into()]);
        }
        line
    }

    /// Returns the command that segments an object.
    fn segment(&self, choices: &mut Choices) -> Vec<String> {
        let mut line = words(&["segment", &self.image, &self.mesh, "-o", &self.out("g.vtu")]);
        line.extend([
            format!("--object={}", choices.point(&self.image_box)),
            format!("--background={}", choices.point(&self.image_box)),
        ]);
        if choices.one_in(2) {
            line.push("--voxels".into());
        }
        if choices.one_in(2) {
            line.extend([
                "--surface-out".into(),
                self.out("s.vtp"),
                "--labels-out".into(),
                self.out("l.npy"),
            ]);
        }
        line
    }

    /// Returns the command of a picture.
    fn slice(&self, choices: &mut Choices) -> Vec<String> {
        let mut line = words(&["slice", &self.image, &self.mesh, "-o", &self.out("s.png")]);
        if choices.one_in(2) {
            line.push(format!("--at={}", choices.point(&self.image_box)));
        }
        if choices.one_in(2) {
            line.extend(words(&["--view", "3d", "--cut", "z", "--up=-x"]));
        }
        if choices.one_in(2) {
            line.extend(words(&["--color", "region"]));
        }
        line
    }

    /// Returns the command of an export in any format.
    fn export(&self, choices: &mut Choices) -> Vec<String> {
        let format = choices.pick(&atomesh::export::formats().collect::<Vec<_>>());
        let extension = format.extensions.first();
        let name = extension.map_or("case".into(), |extension| format!("case.{extension}"));
        let mut line = words(&[
            "export",
            &self.mesh,
            "--to",
            format.name,
            "-o",
            &self.out(&name),
        ]);
        if !choices.byte().is_multiple_of(4) {
            line.extend(words(&[
                "--porosity",
                "0.2",
                "--permeability",
                "100",
                "--permeability-unit",
                "mD",
            ]));
            line.extend(words(&["--depth-at-top", "1000"]));
        }
        for (option, value) in [
            ("--faults", "0.01"),
            ("--split", "all"),
            ("--quadratic", ""),
            ("--thickness", "10"),
            ("--length-unit", "m"),
        ] {
            if choices.one_in(4) {
                line.push(option.into());
                line.extend((!value.is_empty()).then(|| value.to_string()));
            }
        }
        line
    }
}

/// Contents of an image.
struct Scene {
    /// Direction of planes, and the middle of the scene.
    direction: [f64; 3],
    middle: [f64; 3],
    period: f64,
    radius: f64,
    kind: usize,
}

impl Scene {
    fn pick(choices: &mut Choices, dims: [usize; 3]) -> Self {
        Self {
            direction: std::array::from_fn(|_| 2.0 * choices.fraction() - 1.0),
            middle: dims.map(|n| choices.fraction() * n as f64),
            period: 2.0 + 6.0 * choices.fraction(),
            radius: 1.0 + choices.fraction() * dims[0].max(dims[1]) as f64 / 2.0,
            kind: choices.byte() % 9,
        }
    }

    /// Returns the value at a sample.
    fn value(&self, at: [usize; 3]) -> f64 {
        let [x, y, z] = std::array::from_fn(|k| at[k] as f64 - self.middle[k]);
        let ([a, b, c], period) = (self.direction, self.period);
        let distance = a * x + b * y + c * z;
        let second_distance = b * x - a * y + 0.3 * z;
        let middle_distance = x.hypot(y).hypot(z);
        let ridge = |distance: f64| (-0.5 * distance * distance).exp();
        let wave = |distance: f64| (std::f64::consts::TAU * distance / period).sin();
        match self.kind {
            0 => 0.0,
            1 => ridge(distance),
            2 => ridge(distance).max(ridge(second_distance)),
            3 => f64::from(middle_distance < self.radius),
            4 => wave(middle_distance),
            5 => {
                let squares: f64 = [x, y, z].iter().map(|x| (x / period).floor()).sum();
                squares.rem_euclid(2.0)
            }
            6 if second_distance > 0.0 => wave(distance + 0.4 * period),
            6 => wave(distance),
            7 => (3.0 * (distance / period)).round(),
            _ => distance,
        }
    }
}

/// Writes an image of a random kind. Returns `None` if it cannot be written, for example without
/// samples.
fn write_image(choices: &mut Choices, path: &Path) -> Option<ImageBox> {
    let flat = choices.one_in(2);
    let dims: [usize; 3] = if flat {
        [2 + choices.byte() % 40, 2 + choices.byte() % 40, 1]
    } else {
        std::array::from_fn(|_| 2 + choices.byte() % 16)
    };
    let spacing: [f64; 3] = match choices.byte() % 6 {
        0 => [25.0, 12.5, 4.0],
        1 => [1e-3; 3],
        2 => [1e6, 1e6, 5e5],
        _ => [1.0; 3],
    };
    let origin = match choices.byte() % 4 {
        0 => [430_000.0, 6_700_000.0, -1500.0],
        _ => [0.0; 3],
    };
    // A file without a geometry lies position the origin, in samples.
    let plain = path.extension().is_some_and(|ending| ending == "npy");
    let (spacing, origin) = if plain {
        ([1.0; 3], [0.0; 3])
    } else {
        (spacing, origin)
    };
    let scene = Scene::pick(choices, dims);
    let noise = choices.pick(&[0.0, 0.0, 0.05, 0.3, 1.0, 5.0]);
    let scale = choices.pick(&[1.0, 255.0, 1e-6, 1e6, 1e30, -1.0]);
    let mut state = choices.byte() as u64 + 1;
    let mut random = || {
        // SplitMix64.
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z >> 40) as f64 / (1u64 << 24) as f64 - 0.5
    };
    let mut samples = Vec::with_capacity(dims.iter().product());
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let value = scene.value([x, y, z]);
                samples.push((scale * (value + noise * random())) as f32);
            }
        }
    }
    if choices.one_in(24) {
        let index = choices.byte() % samples.len();
        samples[index] = choices.pick(&[f32::NAN, f32::INFINITY, f32::MAX]);
    }
    let mut axes = [[0.0; 3]; 3];
    (0..3).for_each(|k| axes[k][k] = spacing[k]);
    let geometry = Geometry {
        origin,
        axes,
        ..Geometry::default()
    };
    let image = Image::new(dims, samples, geometry);
    let written = match dims[2] {
        1 => formats::write(path, &image.flatten()),
        _ => formats::write(path, &image),
    };
    written.ok()?;
    Some(ImageBox {
        dims: if dims[2] == 1 { 2 } else { 3 },
        origin,
        size: std::array::from_fn(|k| spacing[k] * (dims[k] - 1) as f64),
    })
}
