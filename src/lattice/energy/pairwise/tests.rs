//! Tests of the exact evaluator against the definition of the energy.

use super::*;
use crate::geometry::grid_index::{index_at, offset_of};
use crate::image::ScalarField;

/// Cubic convolution from its definition, in `f64` and one axis after the other.
fn interpolate<const D: usize>(field: &ScalarField<D>, x: &[f64; D]) -> f64 {
    let kernel = |s: f64| match s.abs() {
        s if s < 1.0 => 1.5 * s.powi(3) - 2.5 * s * s + 1.0,
        s if s < 2.0 => -0.5 * s.powi(3) + 2.5 * s * s - 4.0 * s + 2.0,
        _ => 0.0,
    };
    let mut sum = 0.0;
    for tap in 0..6usize.pow(D as u32) {
        let (taps, mut weight) = (index_at([6; D], tap), 1.0);
        let sample: [usize; D] = std::array::from_fn(|k| {
            let index = x[k] / field.step[k];
            let sample_index = index.floor() + taps[k] as f64 - 2.0;
            weight *= kernel(index - sample_index);
            sample_index.clamp(0.0, (field.dims[k] - 1) as f64) as usize
        });
        sum += weight * f64::from(field.samples[offset_of(field.dims, sample)]);
    }
    sum
}

/// A case that the tests evaluate.
struct EnergyCase<'a, const D: usize> {
    extent: [f64; D],
    distance: &'a Distance<D>,
    potential: &'a ScalarField<D>,
    beta: Beta<D>,
    stiffness: f32,
    alignment: Alignment,
}

impl<'a, const D: usize> EnergyCase<'a, D> {
    fn new(extent: [f64; D], distance: &'a Distance<D>, potential: &'a ScalarField<D>) -> Self {
        Self {
            extent,
            distance,
            potential,
            beta: Beta::Constant(0.5),
            stiffness: 0.0,
            alignment: Alignment::OnFeatures,
        }
    }

    /// Returns the terms of the energy that involve atom `n`, computed from the definition: those
    /// that it shares with other atoms, and its own.
    fn terms(&self, x: &[[f64; D]], n: usize) -> (f64, f64) {
        let phi = |u: f64| {
            let u = u.min(1.5);
            153.0 / 256.0 - 9.0 / 8.0 * u + 19.0 / 24.0 * u.powi(3) - 5.0 / 16.0 * u.powi(4)
                + f64::from(self.stiffness) / 3.0 * (1.0 - u).max(0.0).powi(3)
        };
        let beta = |x: &[f64; D]| match &self.beta {
            Beta::Constant(beta) => *beta,
            Beta::Field(field) => interpolate(field, x),
        };
        let (centre_d, centre_beta) = (self.distance.value_at(x[n]), beta(&x[n]));
        let (images, sign) = match self.alignment {
            Alignment::OnFeatures => (1, 1.0),
            Alignment::AlongsideFeatures => (3usize.pow(D as u32), -1.0),
        };
        let (mut shared, mut single) =
            (0.0, sign * centre_beta * interpolate(self.potential, &x[n]));
        let cutoff = 1.6 * self.distance.max();
        for (j, other) in x.iter().enumerate() {
            // The atom itself first, then mirrored in near (1) and far (2) sides.
            for image in 0..images {
                let mirrored = |k: usize| match image / 3usize.pow(k as u32) % 3 {
                    0 => other[k],
                    1 => -other[k],
                    _ => 2.0 * self.extent[k] - other[k],
                };
                let r2: f64 = (0..D).map(|k| (x[n][k] - mirrored(k)).powi(2)).sum();
                let r = r2.sqrt();
                if r > cutoff {
                    continue;
                }
                let pair_energy =
                    0.5 * (1.0 - centre_beta) * phi(r / self.distance.value_at(*other));
                if j != n {
                    shared += pair_energy + 0.5 * (1.0 - beta(other)) * phi(r / centre_d);
                } else if image > 0 {
                    single += pair_energy;
                }
            }
        }
        (shared, single)
    }

    /// Returns the relative errors of the evaluator: of its gradient against differences of the
    /// definition (for some atoms, in the Euclidean norm), and of its energy.
    fn errors(&self, x: &[[f64; D]]) -> (f64, f64) {
        let potential = SparseField::from_field(self.potential);
        let mut evaluator = PairwiseEnergy::new(
            self.extent,
            self.distance,
            Some(&potential),
            self.beta.clone(),
        )
        .unwrap();
        evaluator = evaluator
            .with_stiffness(self.stiffness)
            .with_alignment(self.alignment);
        let mut gradient = vec![[0.0; D]; x.len()];
        let energy = evaluator.evaluate(x, &mut gradient).unwrap();
        let mut truth = 0.0;
        for n in 0..x.len() {
            let (shared, single) = self.terms(x, n);
            truth += 0.5 * shared + single;
        }
        let (mut error2, mut size2) = (0.0, 0.0);
        let mut y = x.to_vec();
        for n in (0..x.len()).step_by(x.len() / 40) {
            for k in 0..D {
                let h = 1e-5;
                y[n][k] = x[n][k] + h;
                let up = self.terms(&y, n);
                y[n][k] = x[n][k] - h;
                let down = self.terms(&y, n);
                let slope = (up.0 - down.0 + up.1 - down.1) / (2.0 * h);
                y[n][k] = x[n][k];
                error2 += (slope - gradient[n][k]).powi(2);
                size2 += slope * slope;
            }
        }
        (
            (error2 / size2).sqrt(),
            (energy - truth).abs() / truth.abs(),
        )
    }
}

fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695);
        (state >> 33) as f64 / (1u64 << 31) as f64
    }
}

/// Random atoms that are at least `min_distance` apart.
fn lattice<const D: usize>(extent: [f64; D], min_distance: f64, seed: u64) -> Vec<[f64; D]> {
    let mut random = random(seed);
    let mut atoms: Vec<[f64; D]> = Vec::new();
    for _ in 0..6_000 {
        let x: [f64; D] = std::array::from_fn(|k| random() * extent[k]);
        let is_near = |a: &[f64; D]| {
            (0..D).map(|k| (a[k] - x[k]).powi(2)).sum::<f64>() < min_distance * min_distance
        };
        if !atoms.iter().any(is_near) {
            atoms.push(x);
        }
    }
    atoms
}

/// A slowly varying field between two values.
pub fn smooth<const D: usize>(extent: [f64; D], low: f64, high: f64) -> ScalarField<D> {
    let dims = extent.map(|l| l as usize + 1);
    ScalarField::from_fn(dims, [1.0; D], |x| {
        let wave: f64 = (0..D).map(|k| (0.11 * x[k] + k as f64).sin()).sum::<f64>() / D as f64;
        low + (high - low) * 0.5 * (1.0 + wave)
    })
}

#[test]
fn lattice_gradient_is_exact_for_constant_distance() {
    let extent = [21.0, 18.0, 24.0];
    let x = lattice(extent, 1.8, 3);
    let zero_potential = ScalarField::from_fn([2; 3], [30.0; 3], |_| 0.0);
    let distance = Distance::Constant(3.0);
    let (gradient, energy) = EnergyCase::new(extent, &distance, &zero_potential).errors(&x);
    println!("constant d: gradient {gradient:.1e}, energy {energy:.1e}");
    assert!(gradient < 1e-6 && energy < 1e-6, "{gradient:e} {energy:e}");
}

#[test]
fn lattice_gradient_is_exact_far_from_the_origin() {
    let extent = [900.0, 900.0, 900.0];
    let mut x = lattice([21.0; 3], 1.8, 5);
    for atom in &mut x {
        *atom = atom.map(|c| c + 870.0);
    }
    let zero_potential = ScalarField::from_fn([2; 3], [900.0; 3], |_| 0.0);
    let distance = Distance::Constant(3.0);
    let (gradient, _) = EnergyCase::new(extent, &distance, &zero_potential).errors(&x);
    // Positions are resolved to 2^-20 of a sample here, 3e-7 of d.
    assert!(gradient < 3e-6, "{gradient:e}");
}

#[test]
fn gradient_includes_the_derivatives_of_distance_image_and_beta() {
    let extent = [24.0, 20.0, 22.0];
    let x = lattice(extent, 1.8, 4);
    let distance = Distance::Field(smooth(extent, 2.0, 4.5));
    let potential = smooth(extent, -1.0, 0.0);
    for beta in [Beta::Constant(0.4), Beta::Field(smooth(extent, 0.2, 0.8))] {
        let (gradient, energy) = EnergyCase {
            beta,
            stiffness: 40.0,
            ..EnergyCase::new(extent, &distance, &potential)
        }
        .errors(&x);
        println!("variable d: gradient {gradient:.1e}, energy {energy:.1e}");
        assert!(gradient < 1e-6 && energy < 1e-6, "{gradient:e} {energy:e}");
    }
    let constant = Distance::Constant(3.0);
    let (gradient, _) = EnergyCase {
        beta: Beta::Constant(0.4),
        stiffness: 40.0,
        ..EnergyCase::new(extent, &constant, &potential)
    }
    .errors(&x);
    assert!(gradient < 1e-6, "{gradient:e}");
}

#[test]
fn gradient_is_exact_in_two_dimensions() {
    let extent = [30.0, 40.0];
    let x = lattice(extent, 1.8, 6);
    let distance = Distance::Field(smooth(extent, 2.0, 4.0));
    let potential = smooth(extent, -1.0, 0.0);
    let (gradient, energy) = EnergyCase::new(extent, &distance, &potential).errors(&x);
    assert!(gradient < 1e-6 && energy < 1e-6, "{gradient:e} {energy:e}");
}

#[test]
fn gradient_is_exact_with_mirror_images() {
    fn check<const D: usize>(extent: [f64; D], seed: u64) {
        let inset = |x: [f64; D]| x.map(|c| 0.4 + c);
        let x = lattice(extent.map(|l| l - 0.8), 1.8, seed);
        let x: Vec<[f64; D]> = x.into_iter().map(inset).collect();
        let potential = smooth(extent, -1.0, 0.0);
        let varying = Distance::Field(smooth(extent, 2.0, 4.0));
        for distance in [Distance::Constant(3.0), varying] {
            for beta in [Beta::Constant(0.4), Beta::Field(smooth(extent, 0.2, 0.8))] {
                let (gradient, energy) = EnergyCase {
                    beta,
                    stiffness: 15.0,
                    alignment: Alignment::AlongsideFeatures,
                    ..EnergyCase::new(extent, &distance, &potential)
                }
                .errors(&x);
                println!("{D}-D: gradient {gradient:.1e}, energy {energy:.1e}");
                assert!(gradient < 1e-6 && energy < 1e-6, "{gradient:e} {energy:e}");
            }
        }
    }
    check([30.0, 40.0], 6);
    // So thin that atoms feel images in both sides.
    check([9.0, 22.0, 24.0], 7);
}

#[test]
fn the_perfect_lattice_of_the_plane_is_a_minimum() {
    // Atoms inside, which have all six neighbours, feel no force, and any change costs energy.
    let (d, extent) = (2.0, [20.0, 16.0 * 0.75f64.sqrt()]);
    let x = crate::lattice::seeding::densest_lattice::fit_lattice(extent, d, Alignment::OnFeatures);
    let distance = Distance::Constant(d);
    let mut energy = PairwiseEnergy::new(extent, &distance, None, Beta::Constant(0.0)).unwrap();
    let mut gradient = vec![[0.0; 2]; x.len()];
    let lowest = energy.evaluate(&x, &mut gradient).unwrap();
    let is_inner = |x: &[f64; 2]| (0..2).all(|k| x[k] > 1.6 * d && x[k] < extent[k] - 1.6 * d);
    let inner_atoms = x.iter().zip(&gradient).filter(|(x, _)| is_inner(x));
    assert!(inner_atoms.clone().count() > 20);
    for (_, g) in inner_atoms {
        assert!(g.iter().all(|g| g.abs() < 1e-6), "{g:?}");
    }
    let mut random = random(11);
    for _ in 0..20 {
        let perturb = |x: &[f64; 2]| {
            if is_inner(x) {
                x.map(|c| c + 0.05 * d * (random() - 0.5))
            } else {
                *x
            }
        };
        let moved: Vec<[f64; 2]> = x.iter().map(perturb).collect();
        assert!(energy.evaluate(&moved, &mut gradient).unwrap() > lowest);
    }
}

#[test]
fn an_updated_list_gives_the_energy_of_a_new_one() {
    check_incremental_update(Alignment::OnFeatures);
    check_incremental_update(Alignment::AlongsideFeatures);
}

fn check_incremental_update(alignment: Alignment) {
    let extent = [24.0, 20.0, 22.0];
    let mut x = lattice(extent, 1.8, 8);
    let distance = Distance::Field(smooth(extent, 2.0, 4.5));
    let mut random = random(9);
    let new_evaluator = || {
        let evaluator = PairwiseEnergy::new(extent, &distance, None, Beta::Constant(0.0));
        evaluator.unwrap().with_alignment(alignment)
    };
    let mut incremental = new_evaluator();
    let mut gradient = vec![[0.0; 3]; x.len()];
    for pass in 0..40 {
        // All atoms move a little in even passes; a few of them move far in odd ones.
        let (fraction, size) = if pass % 2 == 0 {
            (1.0, 0.12)
        } else {
            (0.02, 1.5)
        };
        for atom in &mut x {
            if random() < fraction {
                *atom = std::array::from_fn(|k| {
                    (atom[k] + size * (random() - 0.5)).clamp(0.0, extent[k])
                });
            }
        }
        let energy = incremental.evaluate(&x, &mut gradient).unwrap();
        let mut expected_gradient = vec![[0.0; 3]; x.len()];
        let expected = new_evaluator()
            .evaluate(&x, &mut expected_gradient)
            .unwrap();
        assert!((energy - expected).abs() < 1e-6 * expected.abs());
        for (a, b) in gradient
            .iter()
            .flatten()
            .zip(expected_gradient.iter().flatten())
        {
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
    }
    let listings = incremental.relisted_count() as f64 / x.len() as f64;
    println!("{listings:.1} listings an atom");
    assert!(listings > 1.0 && listings < 50.0, "{listings}");
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let extent = [60.0; 3];
    let d = 3.0;
    let x = crate::lattice::seeding::densest_lattice::fit_lattice(
        extent,
        d,
        crate::lattice::seeding::Alignment::OnFeatures,
    );
    let distance = Distance::Constant(d);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut evaluator =
                PairwiseEnergy::new(extent, &distance, None, Beta::Constant(0.5)).unwrap();
            let mut gradient = vec![[0.0; 3]; x.len()];
            (
                evaluator.evaluate(&x, &mut gradient).unwrap().to_bits(),
                gradient,
            )
        })
    };
    assert!(x.len() > 3 * CHUNK_ATOMS);
    assert_eq!(run(1), run(3));
}

#[test]
fn beta_outside_its_range_is_refused() {
    let distance = Distance::Constant(2.0);
    for beta in [-0.1, 1.1, f64::NAN] {
        assert!(PairwiseEnergy::new([9.0; 3], &distance, None, Beta::Constant(beta)).is_err());
    }
}
