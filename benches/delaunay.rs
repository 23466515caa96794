//! Times and memory of the Delaunay kernels: processor time of each, its ratio to TetGen's, and bytes
//! of memory for each point.
//!
//! `cargo bench --bench delaunay [-- MILLIONS]`: millions of points of the large sets, 1 by default.
//! Each case runs in a process of its own, which is this program with the case as arguments.

use std::process::Command;
use std::time::Instant;

use atomesh::mesh::delaunay::{DelaunayKernel, delaunay_with_neighbours};
use atomesh::report::cost::{cpu_seconds, peak_mb};

/// Sets of points, and how many of them per million points of the largest.
const SETS: [(&str, f64); 4] = [
    ("jittered lattice", 1.0),
    ("perfect lattice", 1.0),
    ("jittered lattice", 0.1),
    ("sphere", 0.1),
];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [set, count, kernel] = &arguments[..]
        && let Ok(count) = count.parse()
    {
        return run_case(&points(set, count), kernel);
    }
    let millions = arguments.iter().find_map(|word| word.parse().ok());
    let millions: f64 = millions.unwrap_or(1.0);
    println!("processor seconds, seconds by the clock, and bytes per point");
    for (set, share) in SETS {
        let count = (millions * share * 1e6) as usize;
        println!("{set}, {} points", points(set, count).len());
        let mut tetgen = f64::NAN;
        for (kernel, threads) in [
            ("tetgen", "1"),
            ("native", "1"),
            ("whole, 1 thread", "1"),
            ("whole, 2 threads", "2"),
        ] {
            let figures = case(set, count, kernel, threads);
            if kernel == "tetgen" {
                tetgen = figures[0];
            }
            let [cpu, clock, bytes] = figures;
            println!(
                "  {kernel:16} {cpu:6.2} s ({:4.2} of TetGen)  {clock:6.2} s  {bytes:5.0}",
                cpu / tetgen
            );
        }
    }
}

/// Runs a case in a process of its own. Returns what [`run_case`] prints.
fn case(set: &str, count: usize, kernel: &str, threads: &str) -> [f64; 3] {
    let program = std::env::current_exe().expect("the path of this program");
    let output = Command::new(program)
        .args([set, &count.to_string(), kernel])
        .env("RAYON_NUM_THREADS", threads)
        .output()
        .expect("this program starts");
    let text = String::from_utf8_lossy(&output.stdout);
    let mut figures = text.split_whitespace().filter_map(|word| word.parse().ok());
    [(); 3].map(|()| figures.next().unwrap_or(f64::NAN))
}

/// Triangulates points and prints processor seconds, seconds and bytes of memory per point. A
/// kernel returns only the tetrahedra; `whole` also neighbours, in canonical order.
fn run_case(points: &[[f64; 3]], kernel: &str) {
    let (cpu, clock, memory) = (cpu_seconds(), Instant::now(), peak_mb());
    let kernel = match kernel {
        "tetgen" => Some(DelaunayKernel::Tetgen),
        "native" => Some(DelaunayKernel::Native),
        _ => None,
    };
    let tets = match kernel {
        Some(kernel) => {
            (kernel.kernel(points.len()).triangulate(points, false)).map(|all| all.tets)
        }
        None => delaunay_with_neighbours(points).map(|all| all.mesh.tets),
    };
    let clock = clock.elapsed().as_secs_f64();
    let bytes = (peak_mb() - memory) * 1e6 / points.len() as f64;
    assert!(tets.expect("the points span a volume").len() > points.len());
    println!("{} {clock} {bytes}", cpu_seconds() - cpu);
}

/// Returns about `count` points of a set: a lattice with the density of a face-centred one in a cube
/// with flat sides, or points on a sphere.
fn points(set: &str, count: usize) -> Vec<[f64; 3]> {
    let mut state = 7u64;
    let mut draw = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    if set == "sphere" {
        let mut on_sphere = || loop {
            let p = [(); 3].map(|()| 2.0 * draw() - 1.0);
            let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
            if (0.1..1.0).contains(&length) {
                return p.map(|x| x / length);
            }
        };
        return (0..count).map(|_| on_sphere()).collect();
    }
    let jitter = if set == "perfect lattice" { 0.0 } else { 0.5 };
    let n = ((2 * count) as f64).cbrt() as usize - 1;
    let mut points = Vec::new();
    for index in
        (0..(n + 1).pow(3)).map(|i| [i % (n + 1), i / (n + 1) % (n + 1), i / (n + 1).pow(2)])
    {
        if index.iter().sum::<usize>() % 2 == 0 {
            points.push(index.map(|i| {
                let offset = jitter * (draw() - 0.5);
                i as f64 + if i > 0 && i < n { offset } else { 0.0 }
            }));
        }
    }
    points
}
