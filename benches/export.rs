//! Measures user CPU time, wall-clock time and memory of writing a model in every format with its
//! companion file: `cargo bench --bench export`.
//!
//! The model has a million Voronoi cells, or a million tetrahedra for formats that hold nothing
//! else. The targets are at most 2 s and as much memory again as the model takes.

use std::path::Path;
use std::time::Instant;

use atomesh::Result;
use atomesh::export::formats;
use atomesh::mesh::poly::PolyMesh;
use atomesh::mesh::{delaunay, voronoi};
use atomesh::model::flow::{Rock, Tensor};
use atomesh::model::reservoir::Model;
use atomesh::report::cost::{cpu_seconds, peak_mb};

/// Half cells of the face-centred lattice along each side of the box: for Voronoi cells and for
/// tetrahedra.
const HALF_CELLS: [usize; 2] = [126, 70];

fn main() {
    if let Err(error) = run() {
        println!("{error}");
    }
}

/// Returns a slightly disturbed lattice, so that no five atoms are on one sphere.
fn atoms(half_cells: usize) -> Vec<[f64; 3]> {
    let mut state = 1u64;
    let mut shift = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        0.14 * ((state >> 11) as f64 / (1u64 << 53) as f64 - 0.5)
    };
    let sites = (0..half_cells.pow(3)).map(|i| {
        [
            i % half_cells,
            i / half_cells % half_cells,
            i / half_cells.pow(2),
        ]
    });
    sites
        .filter(|site| site.iter().sum::<usize>() % 2 == 0)
        .map(|site| site.map(|c| c as f64 + 0.5 + shift()))
        .collect()
}

fn run() -> Result<()> {
    let folder = std::env::temp_dir().join(format!("atomesh-export-{}", std::process::id()));
    let cells = voronoi::voronoi(&atoms(HALF_CELLS[0]), [HALF_CELLS[0] as f64; 3])?;
    measure(Model::new(cells, None), false, &folder)?;
    let tets = delaunay::delaunay(&atoms(HALF_CELLS[1]))?;
    let cells = PolyMesh::from_simplices(&tets, &[], &[])?;
    measure(Model::new(cells, Some(tets)), true, &folder)
}

/// Writes a model in every format, or with `tets_only` in the formats that hold tetrahedra only.
fn measure(mut model: Model, tets_only: bool, folder: &Path) -> Result<()> {
    let rock = Rock::uniform(Tensor::isotropic(1e-13), 1.0);
    model.set_permeability(rock)?;
    model.porosity = Some(vec![0.2; model.len()]);
    println!("{} cells", model.len());
    for format in formats() {
        // Columns need cells of another kind than this lattice.
        if tets_only == format.holds_any_cells || format.name == "disv" {
            continue;
        }
        let _ = std::fs::create_dir_all(folder);
        let name = format
            .extensions
            .first()
            .map_or("case".into(), |e| format!("a.{e}"));
        // Reset the peak memory of the process.
        let _ = std::fs::write("/proc/self/clear_refs", "5");
        let before = peak_mb();
        let (start, cpu) = (Instant::now(), cpu_seconds());
        let written = format.write(&model, &folder.join(name));
        let (wall, cpu) = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu);
        let (extra_memory, size) = (peak_mb() - before, size(folder));
        let _ = std::fs::remove_dir_all(folder);
        written?;
        println!(
            "{:10} {cpu:5.2} s of user CPU, {wall:5.2} s by the clock, {size:5.0} MB; {extra_memory:4.0} MB of memory beside the model's {before:.0}",
            format.name
        );
    }
    Ok(())
}

/// Returns the total size of all files in a folder, in MB.
fn size(folder: &Path) -> f64 {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let size_of = |entry: std::fs::DirEntry| match entry.metadata() {
        Ok(data) if data.is_dir() => size(&entry.path()),
        Ok(data) => data.len() as f64 / 1e6,
        Err(_) => 0.0,
    };
    entries.map(size_of).sum()
}
