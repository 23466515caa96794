//! Any small image, any options, any verb: drawn from bytes.

use std::fs;
use std::path::Path;

use atomesh::image::{Geometry, Image, formats};

use super::verbs::{meshed, performed};

/// Choices, from bytes; without bytes the first one.
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

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.byte() % all.len()]
    }

    /// One in so many.
    fn rarely(&mut self, many: usize) -> bool {
        self.byte() % many == many - 1
    }

    /// In [0, 1).
    fn share(&mut self) -> f64 {
        (self.byte() * 256 + self.byte()) as f64 / 65536.0
    }

    /// A point about the box of an image, rarely outside.
    fn point(&mut self, box_of: &Box) -> String {
        let beyond = if self.rarely(16) { 1.4 } else { 1.0 };
        let at: Vec<f64> = (0..box_of.dims)
            .map(|k| box_of.origin[k] + box_of.size[k] * beyond * self.share())
            .collect();
        at.iter()
            .map(|x| format!("{x}"))
            .collect::<Vec<_>>()
            .join(",")
    }
}

/// Where an image lies.
struct Box {
    dims: usize,
    origin: [f64; 3],
    size: [f64; 3],
}

/// Makes an image, meshes it, and does something with the mesh.
///
/// # Panics
/// If a promise is broken.
pub fn any_job(folder: &Path, bytes: &[u8]) {
    for entry in fs::read_dir(folder).expect("the folder").flatten() {
        let path = entry.path();
        let _ = if path.is_dir() {
            fs::remove_dir_all(path)
        } else {
            fs::remove_file(path)
        };
    }
    let choices = &mut Choices(bytes);
    let image = folder.join(choices.of(&["i.npy", "i.nrrd", "i.vti"]));
    let Some(lies) = write_image(choices, &image) else {
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
    // Small enough that no job takes long.
    let distance = choices.of(&["3", "4", "2.5:4", "6", "2", "5:6", "3:8", "1e9", "0", "1.5"]);
    let scale = choices.of(&[
        "samples", "samples", "samples", "physical", "shape", "1,2,1.5", "1,2",
    ]);
    let physical = scale == "physical";
    let d = |text: &str| -> String {
        let longest = lies.size.iter().fold(0f64, |a, &b| a.max(b));
        let scaled = |d: &str| {
            d.parse::<f64>()
                .map_or(d.to_string(), |d| format!("{}", d * longest / 20.0))
        };
        match physical {
            true => text.split(':').map(scaled).collect::<Vec<_>>().join(":"),
            false => text.to_string(),
        }
    };
    if !choices.rarely(8) {
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
        let (option, values) = choices.of(&table);
        if !words.iter().any(|word| word == option) {
            words.extend([option.to_string(), choices.of(values).to_string()]);
        }
    }
    if choices.rarely(6) {
        words.extend([
            format!("--object={}", choices.point(&lies)),
            format!("--background={}", choices.point(&lies)),
        ]);
    }
    if choices.rarely(4) {
        let well = folder.join("w.csv");
        let radius = 0.02 * lies.size.iter().fold(0f64, |a, &b| a.max(b));
        let lines: Vec<String> = (0..1 + choices.byte() % 4)
            .map(|_| format!("{},{radius}", choices.point(&lies)))
            .collect();
        fs::write(&well, lines.join("\n")).expect("a file");
        words.extend(["--well".into(), path(&well)]);
        if choices.rarely(2) {
            words.extend(["--well-distance".into(), d("1.5")]);
        }
    }
    if choices.rarely(6) {
        let atoms = folder.join("a.csv");
        let lines: Vec<String> = (0..1 + choices.byte() % 5)
            .map(|_| choices.point(&lies))
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
        if choices.rarely(8) {
            words.extend([option.into(), path(&folder.join(name))]);
        }
    }
    if meshed(folder, &words, &mesh) {
        use_mesh(choices, folder, &path(&image), &path(&mesh), &lies);
    }
}

/// One more verb.
fn use_mesh(choices: &mut Choices, folder: &Path, image: &str, mesh: &str, lies: &Box) {
    let out = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let words =
        |list: &[&str]| -> Vec<String> { list.iter().map(|word| word.to_string()).collect() };
    match choices.byte() % 10 {
        0 => {
            performed(folder, &words(&["quality", mesh]));
        }
        1 | 2 => {
            let edited = out("e.vtu");
            let mut line = words(&["edit", mesh, image, "-o", &edited]);
            for _ in 0..1 + choices.byte() % 3 {
                line.push(match choices.byte() % 3 {
                    0 => format!("--add={}", choices.point(lies)),
                    1 => format!("--move={}:{}", choices.byte(), choices.point(lies)),
                    _ => format!("--remove={}", choices.byte()),
                });
            }
            if choices.rarely(3) {
                line.push("--free".into());
            }
            meshed(folder, &line, Path::new(&edited));
        }
        3 => {
            let mut line = words(&["flow", mesh, "-o", &out("f.vtu")]);
            line.extend([
                format!("--source={}", choices.point(lies)),
                format!("--sink={}", choices.point(lies)),
            ]);
            line.extend([
                "--faults".into(),
                choices.of(&["closed", "open", "0.01", "1e-9", "0"]).into(),
            ]);
            if choices.rarely(3) {
                line.extend([
                    "--streamlines".into(),
                    out("s.vtp"),
                    "--lines".into(),
                    "20".into(),
                ]);
            }
            performed(folder, &line);
        }
        4 => {
            let mut line = words(&["surface", mesh, "-o", &out("s.vtp")]);
            for (option, values) in [
                ("--max-bend", &["10", "60", "180"][..]),
                ("--min-area", &["0", "5", "1e9"]),
                ("--up", &["x", "-y", "z"]),
                ("--meets", &[]),
            ] {
                if choices.rarely(2) {
                    line.push(option.into());
                    line.extend(
                        values
                            .get(choices.byte() % values.len().max(1))
                            .map(|value| value.to_string()),
                    );
                }
            }
            performed(folder, &line);
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
            match choices.rarely(2) {
                true => line.push(format!("--seed={}", choices.point(lies))),
                false => line.push("--seed=auto".into()),
            }
            if choices.rarely(3) {
                line.extend(["--level".into(), choices.of(&["2", "0", "100"]).into()]);
            }
            performed(folder, &line);
        }
        6 => {
            let mut line = words(&["segment", image, mesh, "-o", &out("g.vtu")]);
            line.extend([
                format!("--object={}", choices.point(lies)),
                format!("--background={}", choices.point(lies)),
            ]);
            if choices.rarely(2) {
                line.push("--voxels".into());
            }
            if choices.rarely(2) {
                line.extend([
                    "--surface-out".into(),
                    out("s.vtp"),
                    "--labels-out".into(),
                    out("l.npy"),
                ]);
            }
            performed(folder, &line);
        }
        7 => {
            let mut line = words(&["slice", image, mesh, "-o", &out("s.png")]);
            if choices.rarely(2) {
                line.push(format!("--at={}", choices.point(lies)));
            }
            if choices.rarely(2) {
                line.extend(words(&["--view", "3d", "--cut", "z", "--up=-x"]));
            }
            if choices.rarely(2) {
                line.extend(words(&["--color", "region"]));
            }
            performed(folder, &line);
        }
        _ => {
            let format = choices.of(&atomesh::export::formats().collect::<Vec<_>>());
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
                if choices.rarely(4) {
                    line.push(option.into());
                    line.extend((!value.is_empty()).then(|| value.to_string()));
                }
            }
            performed(folder, &line);
        }
    }
}

/// An image of any kind; `None` if it cannot be written, such as one without samples.
fn write_image(choices: &mut Choices, path: &Path) -> Option<Box> {
    let flat = choices.rarely(2);
    let dims: [usize; 3] = match flat {
        true => [2 + choices.byte() % 40, 2 + choices.byte() % 40, 1],
        false => std::array::from_fn(|_| 2 + choices.byte() % 16),
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
    // A file without geometry lies at the origin, in samples.
    let plain = path.extension().is_some_and(|ending| ending == "npy");
    let (spacing, origin) = if plain {
        ([1.0; 3], [0.0; 3])
    } else {
        (spacing, origin)
    };
    let [a, b, c] = [choices.share(), choices.share(), choices.share()].map(|s| 2.0 * s - 1.0);
    let middle = dims.map(|n| choices.share() * n as f64);
    let period = 2.0 + 6.0 * choices.share();
    let radius = 1.0 + choices.share() * dims[0].max(dims[1]) as f64 / 2.0;
    let kind = choices.byte() % 9;
    let noise = choices.of(&[0.0, 0.0, 0.05, 0.3, 1.0, 5.0]);
    let scale = choices.of(&[1.0, 255.0, 1e-6, 1e6, 1e30, -1.0]);
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
                let at = [
                    x as f64 - middle[0],
                    y as f64 - middle[1],
                    z as f64 - middle[2],
                ];
                let off = a * at[0] + b * at[1] + c * at[2];
                let other = b * at[0] - a * at[1] + 0.3 * at[2];
                let from = at[0].hypot(at[1]).hypot(at[2]);
                let value = match kind {
                    0 => 0.0,
                    1 => (-0.5 * off * off).exp(),
                    2 => (-0.5 * off * off).exp().max((-0.5 * other * other).exp()),
                    3 => f64::from(from < radius),
                    4 => (std::f64::consts::TAU * from / period).sin(),
                    5 => {
                        let squares: f64 = at.iter().map(|x| (x / period).floor()).sum();
                        squares.rem_euclid(2.0)
                    }
                    6 => (std::f64::consts::TAU
                        * (off + if other > 0.0 { 0.4 * period } else { 0.0 })
                        / period)
                        .sin(),
                    7 => (3.0 * (off / period)).round(),
                    _ => off,
                };
                samples.push((scale * (value + noise * random())) as f32);
            }
        }
    }
    if choices.rarely(24) {
        let at = choices.byte() % samples.len();
        samples[at] = choices.of(&[f32::NAN, f32::INFINITY, f32::MAX]);
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
    Some(Box {
        dims: if dims[2] == 1 { 2 } else { 3 },
        origin,
        size: std::array::from_fn(|k| spacing[k] * (dims[k] - 1) as f64),
    })
}
