//! Measures the CPU time of one evaluation of the lattice energy, `pairwise` against `sampled`, on
//! one thread: `cargo bench --bench evaluator`. The target at d = 8 is a factor of ten.

use atomesh::image::{ScalarField, SparseField};
use atomesh::lattice::distance::Distance;
use atomesh::lattice::energy::{Beta, Energy, PairwiseEnergy};
use atomesh::lattice::seeding::{self, Alignment};
use atomesh::published::SampledEnergy;
use divan::Bencher;

fn main() {
    // CPU time is compared, so there is one thread. An error means that a pool exists already.
    let _ = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build_global();
    divan::main();
}

/// Samples along each side of the volume.
const SIDE: usize = 160;

/// Returns a lattice of spacing d, slightly disordered as during an optimisation, its distance, and
/// the potential of a curved valley through the volume.
fn case(d: f64) -> (Vec<[f64; 3]>, Distance<3>, ScalarField<3>) {
    let extent = [(SIDE - 1) as f64; 3];
    let distance = Distance::Constant(d);
    let field = ScalarField::from_fn([SIDE; 3], [1.0; 3], |x| {
        let u = (x[0] + 0.2 * x[1] + 6.0 * (x[2] / 25.0).sin() - 90.0) / (0.25 * d);
        if u.abs() < 4.0 {
            -(-0.5 * u * u).exp()
        } else {
            0.0
        }
    });
    let mut atoms = seeding::densest_lattice::fit_lattice(extent, d, Alignment::OnFeatures);
    seeding::morton::sort_by_curve(&mut atoms, extent, 2.0 * d);
    for (n, atom) in atoms.iter_mut().enumerate() {
        let shift = 0.05 * d * (n as f64 * 0.618).sin();
        *atom = atom.map(|c| (c + shift).clamp(0.0, extent[0]));
    }
    (atoms, distance, field)
}

fn evaluate(bencher: Bencher, energy: &mut dyn Energy<3>, atoms: &[[f64; 3]]) {
    let mut gradient = vec![[0.0; 3]; atoms.len()];
    bencher.bench_local(|| energy.evaluate(divan::black_box(atoms), &mut gradient));
}

#[divan::bench(args = [4, 8, 12], sample_count = 7, sample_size = 1)]
fn pairwise(bencher: Bencher, d: u32) {
    let (atoms, distance, field) = case(f64::from(d));
    let extent = field.extent();
    let potential = SparseField::from_field(&field);
    if let Ok(mut energy) =
        PairwiseEnergy::new(extent, &distance, Some(&potential), Beta::Constant(0.5))
    {
        evaluate(bencher, &mut energy, &atoms);
    }
}

#[divan::bench(args = [4, 8, 12], sample_count = 7, sample_size = 1)]
fn sampled(bencher: Bencher, d: u32) {
    let (atoms, distance, field) = case(f64::from(d));
    let mut energy = SampledEnergy::new(&distance, field, Beta::Constant(0.5));
    evaluate(bencher, &mut energy, &atoms);
}
