//! Checks any bytes as a mesh file with a verb that reads it.

use std::fs;
use std::path::Path;

use super::verbs;

/// Command lines with the mesh. `M`, `I` and `O` stand for the mesh, an image, and the output.
pub const LINES: [&str; 13] = [
    "quality M",
    "validate M",
    "edit M I -o O.vtu --add=5,6,7 --remove=3",
    "edit M I -o O.vtu --move=9:14,12,13 --free",
    "edit M I -o O.vtu --add=5,6 --remove=3",
    "flow M -o O.vtu --source=5,6,7 --sink=12,11,10",
    "flow M -o O.vtu --pressure=xmin=1e6 --pressure=xmax=0 --streamlines=O.vtp --lines=5",
    "surface M -o O.vtp",
    "paint M --seed=5,6,7 -o O.vtu",
    "segment I M --object=5,6,7 --background=1,1,1 -o O.vtu",
    "slice I M -o O.png",
    "export M --to opm -o O.DATA --porosity .2 --permeability 100 --permeability-unit mD --depth-at-top 1000",
    "export M --to msh -o O.msh",
];

/// Runs a verb on the bytes as a mesh file. The first byte selects the verb.
///
/// # Panics
/// Panics if a verb breaks a promise of `run_verb` or `run_mesh_verb`.
pub fn check_mesh(folder: &Path, bytes: &[u8]) {
    let Some((&first, bytes)) = bytes.split_first() else {
        return;
    };
    for entry in fs::read_dir(folder).expect("the folder").flatten() {
        let _ = fs::remove_file(entry.path());
    }
    let [mesh, image, out] = ["mesh.vtu", "image.npy", "out"].map(|name| folder.join(name));
    fs::write(&mesh, bytes).expect("a file");
    fs::write(&image, IMAGE).expect("a file");
    let replace = |word: &str| match word {
        "M" => mesh.to_string_lossy().into_owned(),
        "I" => image.to_string_lossy().into_owned(),
        word => word.replace("O.", &format!("{}.", out.display())),
    };
    let words: Vec<String> = LINES[usize::from(first) % LINES.len()]
        .split(' ')
        .map(replace)
        .collect();
    match words[0].as_str() {
        "edit" => verbs::run_mesh_verb(folder, &words, &out.with_extension("vtu")),
        _ => verbs::run_verb(folder, &words),
    };
}

/// The image that the meshes of the corpus were made from.
const IMAGE: &[u8] = include_bytes!("../image.npy");
