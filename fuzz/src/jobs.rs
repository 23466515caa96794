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

/// Writes an image, meshes it, and runs one more verb on the mesh.
///
/// # Panics
/// Panics if a verb breaks a promise of [`run_verb`] or [`run_mesh_verb`].
pub fn check_job(folder: &Path, bytes: &[u8]) {
    for entry in fs::read_dir(folder).expect("the folder").flatten() {
        let path = entry.path();
        let _ = if path.is_dir() {
            fs::remove_dir_all(path)
        } else {
            fs::remove_file(path)
        };
    }
    let choices = &mut Choices(bytes);
    let image = folder.join(choices.pick(&["i.npy", "i.nrrd", "i.vti"]));
    let Some(image_box) = write_image(choices, &image) else {
        return;
    };
    let mesh = folder.join("m.vtu");
    let path = |path: &Path| path.to_string_lossy().into_owned();
    let mut words = vec![
        "mesh".to_string(),
        path(&image),
        "-o".into(),
        path(&mesh),
        "--max-memory".into(),
        "1G".into(),
    ];
    // Images are so small that no job takes long.
    let distance = choices.pick(&["3", "4", "2.5:4", "6", "2", "5:6", "3:8", "1e9", "0", "1.5"]);
    let scale = choices.pick(&[
        "samples", "samples", "samples", "physical", "shape", "1,2,1.5", "1,2",
    ]);
    let physical = scale == "physical";
    let d = |text: &str| -> String {
        let longest = image_box.size.iter().fold(0f64, |a, &b| a.max(b));
        let scaled = |d: &str| {
            d.parse::<f64>()
                .map_or(d.to_string(), |d| format!("{}", d * longest / 20.0))
        };
        if physical {
            text.split(':').map(scaled).collect::<Vec<_>>().join(":")
        } else {
            text.to_string()
        }
    };
    if !choices.one_in(8) {
        words.extend(["--distance".into(), d(distance)]);
    }
    if scale != "samples" {
        words.extend(["--metric".into(), scale.into()]);
    }
    let table: [(&str, &[&str]); 20] = [
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
    for _ in 0..choices.byte() % 6 {
        let (option, values) = choices.pick(&table);
        if !words.iter().any(|word| word == option) {
            words.extend([option.to_string(), choices.pick(values).to_string()]);
        }
    }
    if choices.one_in(6) {
        words.extend([
            format!("--object={}", choices.point(&image_box)),
            format!("--background={}", choices.point(&image_box)),
        ]);
    }
    if choices.one_in(4) {
        let well = folder.join("w.csv");
        let radius = 0.02 * image_box.size.iter().fold(0f64, |a, &b| a.max(b));
        let lines: Vec<String> = (0..1 + choices.byte() % 4)
            .map(|_| format!("{},{radius}", choices.point(&image_box)))
            .collect();
        fs::write(&well, lines.join("\n")).expect("a file");
        words.extend(["--well".into(), path(&well)]);
        if choices.one_in(2) {
            words.extend(["--well-distance".into(), d("1.5")]);
        }
    }
    if choices.one_in(6) {
        let atoms = folder.join("a.csv");
        let lines: Vec<String> = (0..1 + choices.byte() % 5)
            .map(|_| choices.point(&image_box))
            .collect();
        fs::write(&atoms, lines.join("\n")).expect("a file");
        words.extend(["--atoms-from".into(), path(&atoms)]);
    }
    for (option, name) in [
        ("--lines", "l.vtp"),
        ("--trace", "t.pvd"),
        ("--report", "r.json"),
        ("--potential-out", "p.vti"),
    ] {
        if choices.one_in(8) {
            words.extend([option.into(), path(&folder.join(name))]);
        }
    }
    if run_mesh_verb(folder, &words, &mesh) {
        run_second_verb(choices, folder, &path(&image), &path(&mesh), &image_box);
    }
}

/// Runs one of the verbs that read a mesh.
fn run_second_verb(
    choices: &mut Choices,
    folder: &Path,
    image: &str,
    mesh: &str,
    image_box: &ImageBox,
) {
    let out = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let words =
        |list: &[&str]| -> Vec<String> { list.iter().map(|word| word.to_string()).collect() };
    match choices.byte() % 10 {
        0 => {
            run_verb(folder, &words(&["quality", mesh]));
        }
        1 | 2 => {
            let edited = out("e.vtu");
            let mut line = words(&["edit", mesh, image, "-o", &edited]);
            for _ in 0..1 + choices.byte() % 3 {
                line.push(match choices.byte() % 3 {
                    0 => format!("--add={}", choices.point(image_box)),
                    1 => format!("--move={}:{}", choices.byte(), choices.point(image_box)),
                    _ => format!("--remove={}", choices.byte()),
                });
            }
            if choices.one_in(3) {
                line.push("--free".into());
            }
            run_mesh_verb(folder, &line, Path::new(&edited));
        }
        3 => {
            let mut line = words(&["flow", mesh, "-o", &out("f.vtu")]);
            line.extend([
                format!("--source={}", choices.point(image_box)),
                format!("--sink={}", choices.point(image_box)),
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
                    out("s.vtp"),
                    "--lines".into(),
                    "20".into(),
                ]);
            }
            run_verb(folder, &line);
        }
        4 => {
            let mut line = words(&["surface", mesh, "-o", &out("s.vtp")]);
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
            run_verb(folder, &line);
        }
        5 => {
            let mut line = words(&[
                "paint",
                mesh,
                "-o",
                &out("p.vtu"),
                "--surface-out",
                &out("s.vtp"),
            ]);
            line.push(if choices.one_in(2) {
                format!("--seed={}", choices.point(image_box))
            } else {
                "--seed=auto".into()
            });
            if choices.one_in(3) {
                line.extend(["--level".into(), choices.pick(&["2", "0", "100"]).into()]);
            }
            run_verb(folder, &line);
        }
        6 => {
            let mut line = words(&["segment", image, mesh, "-o", &out("g.vtu")]);
            line.extend([
                format!("--object={}", choices.point(image_box)),
                format!("--background={}", choices.point(image_box)),
            ]);
            if choices.one_in(2) {
                line.push("--voxels".into());
            }
            if choices.one_in(2) {
                line.extend([
                    "--surface-out".into(),
                    out("s.vtp"),
                    "--labels-out".into(),
                    out("l.npy"),
                ]);
            }
            run_verb(folder, &line);
        }
        7 => {
            let mut line = words(&["slice", image, mesh, "-o", &out("s.png")]);
            if choices.one_in(2) {
                line.push(format!("--at={}", choices.point(image_box)));
            }
            if choices.one_in(2) {
                line.extend(words(&["--view", "3d", "--cut", "z", "--up=-x"]));
            }
            if choices.one_in(2) {
                line.extend(words(&["--color", "region"]));
            }
            run_verb(folder, &line);
        }
        _ => {
            let format = choices.pick(&atomesh::export::formats().collect::<Vec<_>>());
            let extension = format.extensions.first();
            let name = extension.map_or("case".into(), |extension| format!("case.{extension}"));
            let mut line = words(&["export", mesh, "--to", format.name, "-o", &out(&name)]);
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
            run_verb(folder, &line);
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
    let [a, b, c] =
        [choices.fraction(), choices.fraction(), choices.fraction()].map(|s| 2.0 * s - 1.0);
    let middle = dims.map(|n| choices.fraction() * n as f64);
    let period = 2.0 + 6.0 * choices.fraction();
    let radius = 1.0 + choices.fraction() * dims[0].max(dims[1]) as f64 / 2.0;
    let kind = choices.byte() % 9;
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
                let position = [
                    x as f64 - middle[0],
                    y as f64 - middle[1],
                    z as f64 - middle[2],
                ];
                let distance = a * position[0] + b * position[1] + c * position[2];
                let second_distance = b * position[0] - a * position[1] + 0.3 * position[2];
                let middle_distance = position[0].hypot(position[1]).hypot(position[2]);
                let value = match kind {
                    0 => 0.0,
                    1 => (-0.5 * distance * distance).exp(),
                    2 => (-0.5 * distance * distance)
                        .exp()
                        .max((-0.5 * second_distance * second_distance).exp()),
                    3 => f64::from(middle_distance < radius),
                    4 => (std::f64::consts::TAU * middle_distance / period).sin(),
                    5 => {
                        let squares: f64 = position.iter().map(|x| (x / period).floor()).sum();
                        squares.rem_euclid(2.0)
                    }
                    6 => (std::f64::consts::TAU
                        * (distance
                            + if second_distance > 0.0 {
                                0.4 * period
                            } else {
                                0.0
                            })
                        / period)
                        .sin(),
                    7 => (3.0 * (distance / period)).round(),
                    _ => distance,
                };
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
