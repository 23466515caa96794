//! Measures the CPU time of Voronoi cells against that of the Delaunay triangulation of the same
//! atoms, on one thread: `cargo bench --bench voronoi`. The target is a factor of two in total.

use atomesh::mesh::{delaunay, voronoi};
use atomesh::report::cost::cpu_seconds;

/// Half cells of the face-centred lattice along each side of the box.
const HALF_CELLS: usize = 90;
/// Number of rounds, of which the shortest counts.
const ROUNDS: usize = 3;

fn main() {
    // CPU time is compared, so there is one thread. An error means that a pool exists already.
    let _ = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build_global();
    let mut atoms = Vec::new();
    let mut state = 1u64;
    let mut shift = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        0.14 * ((state >> 11) as f64 / (1u64 << 53) as f64 - 0.5)
    };
    for i in 0..HALF_CELLS.pow(3) {
        let site = [
            i % HALF_CELLS,
            i / HALF_CELLS % HALF_CELLS,
            i / HALF_CELLS.pow(2),
        ];
        if site.iter().sum::<usize>() % 2 == 0 {
            atoms.push(site.map(|c| c as f64 + 0.5 + shift()));
        }
    }
    let extent = [HALF_CELLS as f64; 3];
    let seconds = |work: &mut dyn FnMut()| {
        let rounds = (0..ROUNDS).map(|_| {
            let start = cpu_seconds();
            work();
            cpu_seconds() - start
        });
        rounds.fold(f64::INFINITY, f64::min)
    };
    let mut failed = None;
    let triangulation = seconds(&mut || failed = delaunay::delaunay(&atoms).err());
    let cells = seconds(&mut || failed = voronoi::voronoi(&atoms, extent).err());
    if let Some(error) = failed {
        println!("{error}");
        return;
    }
    println!(
        "{} atoms: Delaunay {triangulation:.2} s, Voronoi {cells:.2} s, {:.2} times as long",
        atoms.len(),
        cells / triangulation
    );
}
