//! Helpers of the integration tests: small input files, and runs of the program and of other
//! programs.
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// Returns a command that runs the program under test in `folder`.
pub fn atomesh(folder: &Path) -> Command {
    let mut command = Command::new(crate::PROGRAM);
    command.current_dir(folder);
    command
}

/// Runs the program, asserts exit code 0 and returns the standard output.
pub fn run_args(folder: &Path, arguments: &[&str]) -> String {
    let output = atomesh(folder).args(arguments).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(
        output.status.code(),
        Some(0),
        "atomesh {}\n{stderr}",
        arguments.join(" ")
    );
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a job that must be refused and returns the error line.
///
/// Asserts exit code 1, one line on standard error with place, problem and remedy, no standard
/// output, and that no file was written or changed.
pub fn expect_refusal(folder: &Path, arguments: &[&str]) -> String {
    let before = files_below(folder);
    let output = atomesh(folder)
        .args(arguments)
        .arg("--quiet")
        .output()
        .unwrap();
    let stderr = lines(&output);
    let context = format!("atomesh {}\n{}", arguments.join(" "), stderr.join("\n"));
    assert_eq!(output.status.code(), Some(1), "{context}");
    assert_eq!(stderr.len(), 1, "{context}");
    let parts = stderr[0].strip_prefix("error: ").expect(&context);
    assert!(
        parts.contains(": ") && parts.contains("; "),
        "no place, problem, remedy: {context}"
    );
    assert!(output.stdout.is_empty(), "{context}");
    assert_eq!(
        files_below(folder),
        before,
        "something was left behind: {context}"
    );
    stderr[0].clone()
}

fn lines(output: &Output) -> Vec<String> {
    String::from_utf8_lossy(&output.stderr)
        .lines()
        .map(str::to_string)
        .collect()
}

/// Returns every file below a folder with its bytes, sorted.
pub fn files_below(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut list = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            list.extend(files_below(&path));
        } else {
            let bytes = std::fs::read(&path).unwrap();
            list.push((path, bytes));
        }
    }
    list.sort();
    list
}

/// Writes a NumPy file of float32, shape `(nz, ny, nx)`.
pub fn write_npy(path: &Path, dims: [usize; 3], mut value: impl FnMut([usize; 3]) -> f32) {
    let [nx, ny, nz] = dims;
    let samples = (0..nx * ny * nz).map(|i| value([i % nx, i / nx % ny, i / (nx * ny)]));
    write_npy_samples(path, &format!("{nz}, {ny}, {nx}"), samples);
}

/// Writes a NumPy file of float32, shape `(ny, nx)`.
pub fn write_npy_2d(path: &Path, [nx, ny]: [usize; 2], mut value: impl FnMut([usize; 2]) -> f32) {
    let samples = (0..nx * ny).map(|i| value([i % nx, i / nx]));
    write_npy_samples(path, &format!("{ny}, {nx}"), samples);
}

/// Writes a NumPy file of unsigned 64-bit integers, shape `(nz, ny, nx)`.
pub fn write_npy_u64(path: &Path, dims: [usize; 3], mut value: impl FnMut([usize; 3]) -> u64) {
    let [nx, ny, nz] = dims;
    let values = (0..nx * ny * nz).map(|i| value([i % nx, i / nx % ny, i / (nx * ny)]));
    let samples = values.flat_map(u64::to_le_bytes);
    write_npy_bytes(path, "<u8", &format!("{nz}, {ny}, {nx}"), samples);
}

fn write_npy_samples(path: &Path, shape: &str, samples: impl Iterator<Item = f32>) {
    write_npy_bytes(path, "<f4", shape, samples.flat_map(f32::to_le_bytes));
}

fn write_npy_bytes(path: &Path, kind: &str, shape: &str, samples: impl Iterator<Item = u8>) {
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(samples);
    std::fs::write(path, bytes).unwrap();
}

/// Returns the sample values of an image with one bright, slightly tilted plane across the middle
/// of the box: a fault.
pub fn planar_fault(dims: [usize; 3]) -> impl Fn([usize; 3]) -> f32 {
    let middle = dims[0] as f32 / 2.0;
    move |[x, y, z]| {
        let distance = x as f32 - middle - 0.1 * y as f32 + 0.1 * z as f32;
        (-0.5 * (distance / 1.5).powi(2)).exp()
    }
}

/// A rotated survey for [`write_segy`] with a sample interval of 4 ms and a spacing of 25 m between inlines and
/// of 12.5 m between crosslines.
pub struct Survey {
    pub inlines: usize,
    pub crosslines: usize,
    pub samples: usize,
}

impl Survey {
    /// Returns the physical position of a trace in metres. The headers of [`write_segy`] hold it,
    /// rounded to centimetres.
    pub fn position(&self, inline: usize, crossline: usize) -> [f64; 2] {
        let (along, across) = (12.5 * crossline as f64, 25.0 * inline as f64);
        let (cos, sin) = (0.8, 0.6);
        [
            600_000.0 + cos * along - sin * across,
            6_000_000.0 + sin * along + cos * across,
        ]
    }
}

/// Writes a SEG-Y file: revision 1, IEEE floats, sorted by inline. `value` takes sample, crossline
/// and inline.
pub fn write_segy(path: &Path, survey: &Survey, value: impl FnMut([usize; 3]) -> f32) {
    write_segy_without(path, survey, |_, _| false, value);
}

/// Writes a SEG-Y file as [`write_segy`] does, without the traces for which `is_missing` is true at
/// a crossline and an inline.
pub fn write_segy_without(
    path: &Path,
    survey: &Survey,
    is_missing: impl Fn(usize, usize) -> bool,
    mut value: impl FnMut([usize; 3]) -> f32,
) {
    let mut bytes = vec![0x40u8; 3200];
    let mut header = [0u8; 400];
    header[16..18].copy_from_slice(&4000u16.to_be_bytes());
    header[20..22].copy_from_slice(&(survey.samples as u16).to_be_bytes());
    header[24..26].copy_from_slice(&5u16.to_be_bytes());
    header[300..302].copy_from_slice(&0x0100u16.to_be_bytes());
    header[302..304].copy_from_slice(&1u16.to_be_bytes());
    bytes.extend(header);
    for inline in 0..survey.inlines {
        for crossline in 0..survey.crosslines {
            if is_missing(crossline, inline) {
                continue;
            }
            let [x, y] = survey
                .position(inline, crossline)
                .map(|c| (c * 100.0).round() as i32);
            let mut trace = [0u8; 240];
            let mut write_field = |byte: usize, value: &[u8]| {
                trace[byte - 1..byte - 1 + value.len()].copy_from_slice(value);
            };
            write_field(29, &1i16.to_be_bytes());
            write_field(71, &(-100i16).to_be_bytes());
            write_field(115, &(survey.samples as u16).to_be_bytes());
            write_field(117, &4000u16.to_be_bytes());
            write_field(181, &x.to_be_bytes());
            write_field(185, &y.to_be_bytes());
            write_field(189, &(100 + inline as i32).to_be_bytes());
            write_field(193, &(300 + crossline as i32).to_be_bytes());
            bytes.extend(trace);
            for sample in 0..survey.samples {
                bytes.extend(value([sample, crossline, inline]).to_be_bytes());
            }
        }
    }
    std::fs::write(path, bytes).unwrap();
}

/// Runs a Python program that uses VTK on files, and returns the JSON that it prints.
pub fn run_vtk_program(program: &str, arguments: &[&Path]) -> serde_json::Value {
    let mut python_arguments: Vec<&OsStr> = vec!["-c".as_ref(), program.as_ref()];
    python_arguments.extend(arguments.iter().map(|path| path.as_os_str()));
    serde_json::from_str(&run_python("VTK", &python_arguments)).unwrap()
}

/// Runs a script of tests/data/export and returns the JSON that it prints. `needs` names the Python
/// modules that the script imports, for the error message.
pub fn run_validator(needs: &str, script: &str, arguments: &[&OsStr]) -> serde_json::Value {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/export");
    let script = folder.join(script);
    let python_arguments = [&[script.as_os_str()], arguments].concat();
    serde_json::from_str(&run_python(needs, &python_arguments)).unwrap()
}

/// Runs Python from the environment that `make validators` makes, and returns its standard output.
/// `needs` names the modules that the program imports.
pub fn run_python(needs: &str, arguments: &[&OsStr]) -> String {
    let python = Path::new(env!("CARGO_MANIFEST_DIR")).join(".venv/bin/python");
    let output = Command::new(python).args(arguments).output();
    let output =
        output.unwrap_or_else(|error| panic!("{needs}: {error}; run `make validators` first"));
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a simulator that `make validators` installs, asserts exit code 0 and returns its standard
/// output.
pub fn run_simulator(command: &mut Command) -> String {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command.output();
    let output =
        output.unwrap_or_else(|error| panic!("{name}: {error}; run `make validators` first"));
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{name}\n{stdout}\n{stderr}");
    stdout
}

/// Returns the path of an image of another project, or of a folder of such images.
///
/// These images are not in the repository. They are looked for in the folder that the variable
/// `ATOMESH_DATA` names, else in `../shared/data`. Tests that use them are ignored by default.
pub fn data_path(name: &str) -> PathBuf {
    let root = std::env::var_os("ATOMESH_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let path = root.join(name);
    assert!(
        path.exists(),
        "{}: no such file; set ATOMESH_DATA to the folder of images",
        path.display()
    );
    path
}

/// Runs the program with the words of `line` as arguments, asserts exit code 0 and returns the
/// standard output.
pub fn run(folder: &Path, line: &str) -> String {
    run_args(folder, &line.split_whitespace().collect::<Vec<_>>())
}

/// Dimensions of the image in [`folder_with_meshes`].
pub const FAULT_DIMS: [usize; 3] = [40, 36, 32];

/// Input files of several tests, which are made once and copied for each test.
pub struct SharedFiles(OnceLock<Vec<(PathBuf, Vec<u8>)>>);

impl SharedFiles {
    pub const fn new() -> Self {
        Self(OnceLock::new())
    }

    /// Returns a new folder with a copy of the files that `make` writes to a folder.
    pub fn folder(&self, make: impl FnOnce(&Path)) -> tempfile::TempDir {
        let files = self.0.get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            make(folder.path());
            let name = |path: PathBuf| path.strip_prefix(folder.path()).unwrap().to_path_buf();
            let entries = files_below(folder.path()).into_iter();
            entries.map(|(path, bytes)| (name(path), bytes)).collect()
        });
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in files {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        folder
    }
}

/// Returns a folder with meshes of a planar fault across the box: `cells.vtu` of Voronoi cells and
/// `tets.vtu` of tetrahedra.
pub fn folder_with_meshes() -> tempfile::TempDir {
    static FILES: SharedFiles = SharedFiles::new();
    FILES.folder(|folder| {
        write_npy(
            &folder.join("sheet.npy"),
            FAULT_DIMS,
            planar_fault(FAULT_DIMS),
        );
        let mesh = "mesh sheet.npy --distance 6 --quiet -o";
        run(folder, &format!("{mesh} cells.vtu --cells voronoi"));
        run(folder, &format!("{mesh} tets.vtu"));
    })
}

/// Copies all files of a folder to another one.
pub fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy_folder(&path, &target);
        } else {
            std::fs::copy(&path, &target).unwrap();
        }
    }
}

/// Returns the numbers of a JSON array.
pub fn numbers(value: &serde_json::Value) -> Vec<f64> {
    let items = value.as_array().unwrap().iter();
    items.map(|v| v.as_f64().unwrap()).collect()
}

/// Returns `true` if the relative difference of two numbers is at most `tolerance`.
pub fn is_close(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance * a.abs().max(b.abs())
}
