//! Tests of draws against their probabilities, and of lattices that are drawn.

use super::*;
use crate::lattice::seeding::grow::tests::{spacing_quantiles, varying_distance};
use crate::lattice::seeding::{Atoms, seed_with};

/// Returns a lattice of the box without fixed atoms.
pub fn seed_guided<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    potential: &ScalarField<D>,
    options: GuideOptions,
) -> Result<Atoms<D>> {
    let cancel = &CancelToken::never();
    let draw =
        |fixed: &[[f64; D]]| draw_lattice(extent, distance, potential, fixed, options, cancel);
    seed_with(extent, distance, &[], options.alignment, draw)
}

fn uniform_numbers(seed: u64, count: usize) -> impl Iterator<Item = f64> {
    let mut random = random_sequence(seed);
    (0..count).map(move |_| random.draw())
}

/// Returns chi-square over its degrees of freedom, in standard deviations from the expected value.
fn chi_square(drawn: &[usize], weights: &[f64]) -> f64 {
    let count = drawn.iter().sum::<usize>() as f64;
    let total: f64 = weights.iter().sum();
    let (mut sum, mut freedom) = (0.0, -1.0);
    for (&drawn, weight) in drawn.iter().zip(weights) {
        let expected = count * weight / total;
        if expected == 0.0 {
            assert_eq!(drawn, 0, "drawn, though impossible");
            continue;
        }
        assert!(expected > 5.0, "too few draws for a chi-square test");
        sum += (drawn as f64 - expected).powi(2) / expected;
        freedom += 1.0;
    }
    (sum - freedom) / (2.0f64 * freedom).sqrt()
}

#[test]
fn numbers_are_drawn_with_their_probabilities() {
    let uneven: Vec<f64> = (0..300)
        .map(|n| {
            if n % 7 == 3 {
                0.0
            } else {
                1.0 + f64::from(n * n % 113)
            }
        })
        .collect();
    for weights in [uneven, vec![1.0; 64], vec![0.0, 0.0, 3.0, 1.0, 0.0]] {
        let table = GuideTable::new(&weights).unwrap();
        let mut drawn = vec![0; weights.len()];
        for chance in uniform_numbers(7, 400_000) {
            drawn[table.draw(chance)] += 1;
        }
        let deviation = chi_square(&drawn, &weights);
        println!("chi-square {deviation:.2} standard deviations off");
        assert!(deviation.abs() < 4.0, "{deviation}");
        // The test detects a table of other weights.
        let mut wrong = weights.clone();
        wrong[2] += 0.1 * weights.iter().sum::<f64>();
        wrong[3] += 1.0;
        assert!(chi_square(&drawn, &wrong).abs() > 20.0);
    }
    let table = GuideTable::new(&[0.0, 1.0, 0.0]).unwrap();
    for chance in [0.0, 0.5, 1.0 - f64::EPSILON / 2.0] {
        assert_eq!(table.draw(chance), 1);
    }
    for weights in [
        vec![],
        vec![0.0; 3],
        vec![1.0, -1.0, 3.0],
        vec![f64::NAN],
        vec![f64::INFINITY],
    ] {
        assert!(GuideTable::new(&weights).is_none(), "{weights:?}");
    }
}

#[test]
fn a_draw_costs_the_same_however_many_numbers_there_are() {
    for count in [10, 1_000, 100_000, 3_000_000] {
        // Most of the weight is in few numbers, as in an image of features.
        let weight = |n: usize| if n.is_multiple_of(50) { 1.0 } else { 1e-4 };
        let weights: Vec<f64> = (0..count).map(weight).collect();
        let table = GuideTable::new(&weights).unwrap();
        let inspected: usize = uniform_numbers(3, 100_000).map(|c| table.search(c).1).sum();
        let mean = inspected as f64 / 1e5;
        println!("{count} numbers: {mean:.3} inspected per draw");
        // Devroye: at most 1 + numbers / parts.
        assert!(mean <= 2.0, "{mean}");
    }
}

#[test]
fn samples_are_drawn_as_their_grey_levels_say() {
    let levels: Vec<u8> = (0..500u32).map(|n| (64 + n * n % 192) as u8).collect();
    let sorted = GreyLevels::new((0..500).map(|n| (n, levels[n as usize])));
    for gamma in [0.5, 1.0, 4.0] {
        let table = sorted.table(gamma).unwrap();
        let mut random = random_sequence(5);
        let mut drawn = vec![0; 500];
        for _ in 0..2_000_000 {
            drawn[sorted.draw(&table, &mut random)] += 1;
        }
        let signal = |&level: &u8| (f64::from(level) + 1.0) / 256.0;
        let weights: Vec<f64> = levels.iter().map(|l| signal(l).powf(1.0 / gamma)).collect();
        let deviation = chi_square(&drawn, &weights);
        println!("gamma {gamma}: chi-square {deviation:.2} standard deviations off");
        assert!(deviation.abs() < 4.0, "{deviation}");
    }
}

#[test]
fn there_are_41_rising_gammas() {
    let gammas: Vec<f64> = gammas().collect();
    assert_eq!((gammas.len(), gammas[0], gammas[40]), (41, 0.05, 21.0));
    assert!(gammas.is_sorted());
    let mut printed: Vec<f64> = (-20..=20)
        .map(|i| {
            if i > 1 {
                1.0 / f64::from(i)
            } else {
                f64::from(i32::abs(i)) + 1.0
            }
        })
        .collect();
    printed.sort_by(f64::total_cmp);
    assert_eq!(gammas, printed);
}

/// A valley across the box, where x + y / 4 is 0.6 times the extent along x.
pub fn valley<const D: usize>(extent: [f64; D]) -> ScalarField<D> {
    let dims = extent.map(|l| l as usize + 1);
    ScalarField::from_fn(dims, [1.0; D], |x| {
        let offset = (x[0] + 0.25 * x[1] - 0.6 * extent[0]) / 1.5;
        if offset.abs() < 4.0 {
            -(-0.5 * offset * offset).exp()
        } else {
            0.0
        }
    })
}

/// Checks the spacing of atoms that were placed in the [`valley`] first. There must be more atoms on
/// the feature than `densest` times the number that fits there side by side.
pub fn check_atoms_in_valley<const D: usize>(
    atoms: &Atoms<D>,
    extent: [f64; D],
    distance: &Distance<D>,
    densest: f64,
) {
    let spacing = spacing_quantiles(atoms, distance);
    let [min, _, median, _, max] = spacing;
    let is_on_feature = |x: &[f64; D]| (x[0] + 0.25 * x[1] - 0.6 * extent[0]).abs() < 1.0;
    let on_feature = atoms.positions.iter().filter(|x| is_on_feature(x)).count();
    println!(
        "{D}-D: {} atoms, {on_feature} on the feature; nearest / d {spacing:.3?}",
        atoms.len()
    );
    // d may be smaller at the other end.
    assert!(min > 0.72 && max < 1.5 && median < 1.05);
    let length = extent[1] * 17.0f64.sqrt() / 4.0;
    let area: f64 = (2..D).map(|k| extent[k]).product::<f64>() * length;
    assert!(
        on_feature as f64
            > densest * area / (MIN_SITE_DISTANCE * distance.max()).powi(D as i32 - 1),
        "{on_feature}"
    );
}

fn check<const D: usize>(extent: [f64; D], distance: &Distance<D>, densest: f64) {
    let potential = valley(extent);
    let place_atoms = |seed, max_atoms, alignment| {
        let options = GuideOptions {
            alignment,
            seed,
            max_atoms,
        };
        seed_guided(extent, distance, &potential, options).unwrap()
    };
    let atoms = place_atoms(1, usize::MAX, Alignment::OnFeatures);
    // Nearly as many atoms on the feature as random positions could fill there (Renyi: 0.75 of the
    // length in the plane; 0.547 of the area in space).
    check_atoms_in_valley(&atoms, extent, distance, densest);
    assert_eq!(atoms, place_atoms(1, usize::MAX, Alignment::OnFeatures));
    assert_ne!(atoms, place_atoms(2, usize::MAX, Alignment::OnFeatures));
    let few = place_atoms(1, atoms.len() - 20, Alignment::OnFeatures);
    assert_eq!(few.len(), atoms.len() - 20);

    let alongside = place_atoms(1, usize::MAX, Alignment::AlongsideFeatures);
    let margin = SIDE_MARGIN * distance.min() - 1e-9;
    let is_clear = |x: &[f64; D]| (0..D).all(|k| x[k] > margin && x[k] < extent[k] - margin);
    assert!(alongside.positions.iter().all(is_clear));
}

#[test]
fn a_rectangle_is_filled_features_first() {
    let extent = [120.0, 91.0];
    check(extent, &Distance::Constant(5.0), 0.6);
    check(extent, &varying_distance(extent), 0.6);
}

#[test]
fn a_box_is_filled_features_first() {
    let extent = [60.0, 53.0, 48.0];
    check(extent, &Distance::Constant(5.0), 0.5);
    check(extent, &varying_distance(extent), 0.5);
}

#[test]
fn a_potential_without_features_is_refused() {
    let extent = [40.0, 30.0];
    let distance = Distance::Constant(5.0);
    let mut field = valley(extent);
    let options = GuideOptions {
        alignment: Alignment::OnFeatures,
        seed: 1,
        max_atoms: usize::MAX,
    };
    let message = |field: &ScalarField<2>| {
        let seeded = seed_guided(extent, &distance, field, options);
        seeded.unwrap_err().to_string()
    };
    field.samples.fill(-0.25);
    assert!(message(&field).contains("everywhere: no place"));
    field.samples[3] = f32::NAN;
    assert!(message(&field).contains("not a number"));
}
