//! Tests of grown lattices: their regularity, and equality for any number of ranks.

use super::*;
use crate::comm::run_threads;
use crate::geometry::statistics::lower_quantile;
use crate::image::ScalarField;
use crate::lattice::AtomKind;
use crate::lattice::seeding::{Atoms, Seeding, fcc, seed_on_features};

/// d from 4 in the middle to 9 at the far corners.
pub fn varying_distance<const D: usize>(extent: [f64; D]) -> Distance<D> {
    let dims = extent.map(|l| (l / 2.0) as usize + 1);
    let step = std::array::from_fn(|k| extent[k] / (dims[k] - 1) as f64);
    Distance::Field(ScalarField::from_fn(dims, step, |x| {
        let r2: f64 = (0..D).map(|k| (x[k] - 0.5 * extent[k]).powi(2)).sum();
        (4.0 + 0.1 * (r2.sqrt() - 8.0).max(0.0)).min(9.0)
    }))
}

/// Nearest-neighbour distance over d at 0, 1, 50, 99 and 100 %.
pub fn spacing_quantiles<const D: usize>(atoms: &Atoms<D>, distance: &Distance<D>) -> [f64; 5] {
    let mut nearest: Vec<f64> = atoms
        .positions
        .iter()
        .enumerate()
        .map(|(n, x)| {
            let others = atoms.positions.iter().enumerate().filter(|(m, _)| *m != n);
            let nearest2 = others
                .map(|(_, y)| distance2(x, y))
                .fold(f64::INFINITY, f64::min);
            nearest2.sqrt() / distance.value_at(*x)
        })
        .collect();
    [0.0, 0.01, 0.5, 0.99, 1.0].map(|share| lower_quantile(&mut nearest, share).unwrap())
}

#[test]
fn fills_the_box_with_atoms_about_d_apart() {
    let extent = [70.0, 63.0, 55.0];
    let distance = varying_distance(extent);
    let atoms = fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
    let corners = atoms
        .kinds
        .iter()
        .filter(|&&k| k == AtomKind::Corner)
        .count();
    assert_eq!(corners, 8);
    let spacing = spacing_quantiles(&atoms, &distance);
    println!("{} atoms, nearest / d {spacing:.3?}", atoms.len());
    assert!(spacing[0] > 0.7 && spacing[4] < 1.5, "{spacing:?}");
    assert!(spacing[2] > 0.8 && spacing[2] < 1.05, "{spacing:?}");
    // As many atoms as d asks for: sqrt 2 / d^3 a unit of volume, if somewhat less dense.
    let mut expected = 0.0;
    for n in 0..70 * 63 * 55 {
        let x = [n % 70, n / 70 % 63, n / 70 / 63].map(|c| c as f64 + 0.5);
        expected += SQRT_2 / distance.value_at(x).powi(3);
    }
    let share = atoms.len() as f64 / expected;
    println!("{share:.3} of the atoms of a perfect lattice");
    assert!(share > 0.8 && share < 1.5, "{share}");
    // No large holes: every point has an atom within about d.
    let mut widest = 0.0f64;
    for n in 0..3000u32 {
        let t = |k: u32| f64::from((n * 7919 + 13) * (k + 3) % 9973) / 9973.0;
        let x = [extent[0] * t(0), extent[1] * t(5), extent[2] * t(11)];
        let nearest2 = atoms
            .positions
            .iter()
            .map(|y| distance2(&x, y))
            .fold(f64::MAX, f64::min);
        widest = widest.max(nearest2.sqrt() / distance.value_at(x));
    }
    println!("widest hole {widest:.3} d");
    assert!(widest < 1.1, "{widest}");
}

/// Returns the fraction of atoms, farther than 2 d from all sides, that have as many others within
/// 1.25 d as in the densest lattice.
fn regular_share<const D: usize>(
    seeding: Seeding,
    extent: [f64; D],
    distance: &Distance<D>,
) -> f64 {
    let atoms = seed_on_features(seeding, extent, distance, &[]).unwrap();
    // The sides are exact and have their own lattice.
    let count = |kind| atoms.kinds.iter().filter(|&&k| k == kind).count();
    assert_eq!(count(AtomKind::Corner), 1 << D);
    assert!(count(AtomKind::Edge) > 6 * D && (D == 2 || count(AtomKind::Side) > 100));
    let neighbour_count = if D == 2 { 6 } else { 12 };
    let (mut inner_count, mut regular_count) = (0, 0);
    for x in &atoms.positions {
        let d = distance.value_at(*x);
        if (0..D).any(|k| x[k].min(extent[k] - x[k]) < 2.0 * d) {
            continue;
        }
        let is_near = |y: &&[f64; D]| distance2(x, y) < (1.25 * d).powi(2);
        inner_count += 1;
        regular_count +=
            usize::from(atoms.positions.iter().filter(is_near).count() - 1 == neighbour_count);
    }
    assert!(inner_count > 50, "{inner_count}");
    f64::from(regular_count as u32) / f64::from(inner_count)
}

/// d rises along the diagonal by `slope`, or in waves whose slope is at most that.
fn sloping_distance<const D: usize>(extent: [f64; D], slope: f64, waves: bool) -> Distance<D> {
    let dims = extent.map(|l| l as usize + 1);
    let step = std::array::from_fn(|k| extent[k] / (dims[k] - 1) as f64);
    Distance::Field(ScalarField::from_fn(dims, step, |x| {
        if waves {
            let steepest = slope * (D as f64).sqrt();
            let wave = |k: usize| (x[k] * steepest / 1.5 + k as f64).sin();
            6.0 + 1.5 * (0..D).map(wave).sum::<f64>() / D as f64
        } else {
            4.0 + slope * x.iter().sum::<f64>() / (D as f64).sqrt()
        }
    }))
}

#[test]
fn a_variable_lattice_is_regular_inside() {
    for (slope, waves) in [(0.05, false), (0.08, false), (0.05, true), (0.08, true)] {
        let extent = [120.0, 91.0];
        let share = regular_share(
            Seeding::Fcc,
            extent,
            &sloping_distance(extent, slope, waves),
        );
        println!("2-D, slope {slope}, waves {waves}: {share:.3}");
        assert!(share >= 0.75, "{slope} {waves}: {share}");
    }
    for (slope, waves) in [(0.03, false), (0.05, false), (0.08, false), (0.05, true)] {
        let extent = [70.0, 63.0, 55.0];
        let share = regular_share(
            Seeding::Fcc,
            extent,
            &sloping_distance(extent, slope, waves),
        );
        println!("3-D, slope {slope}, waves {waves}: {share:.3}");
        assert!(share >= 0.95, "{slope} {waves}: {share}");
    }
}

#[test]
fn a_lattice_grown_at_constant_distance_is_regular_inside() {
    for d in [5.0, 6.0] {
        let distance = Distance::Constant(d);
        assert!(regular_share(Seeding::Grown, [120.0, 91.0], &distance) >= 0.95);
        let distance = Distance::Constant(d);
        assert!(regular_share(Seeding::Grown, [70.0, 63.0, 55.0], &distance) >= 0.95);
    }
}

#[test]
fn edges_carry_evenly_spread_atoms() {
    let extent = [60.0, 30.0, 30.0];
    let distance = varying_distance(extent);
    let shared_box = SharedBox::of_one_process(extent);
    let lattice = GrowingLattice::new(shared_box, &distance, Alignment::OnFeatures);
    let mut positions: Vec<f64> = lattice.edge_atoms(0, 0b110).iter().map(|x| x[0]).collect();
    positions.insert(0, 0.0);
    positions.push(60.0);
    for pair in positions.windows(2) {
        let d = distance.value_at([0.5 * (pair[0] + pair[1]), 0.0, 0.0]);
        let spacing = (pair[1] - pair[0]) / (SQRT_2 * d);
        assert!((0.85..1.15).contains(&spacing), "{positions:?}");
    }
}

#[test]
fn fixed_atoms_keep_their_places_and_their_room() {
    let extent = [40.0, 40.0, 40.0];
    let distance = varying_distance(extent);
    let fixed = [
        [20.3, 19.1, 20.7],
        [0.0, 13.3, 12.2],
        [0.0, 17.0, 40.0],
        [0.0; 3],
    ];
    let atoms = fcc(extent, &distance, &fixed, Alignment::OnFeatures).unwrap();
    let count = atoms.len();
    assert_eq!(&atoms.positions[count - 4..], &fixed);
    assert!(
        atoms.kinds[count - 4..]
            .iter()
            .all(|&k| k == AtomKind::Fixed)
    );
    assert!(spacing_quantiles(&atoms, &distance)[0] > 0.6);
    let corners = atoms
        .kinds
        .iter()
        .filter(|&&k| k == AtomKind::Corner)
        .count();
    assert_eq!(corners, 7);
}

#[test]
fn fills_a_rectangle() {
    let extent = [120.0, 91.0];
    let distance = varying_distance(extent);
    let atoms = fcc(extent, &distance, &[[30.0, 40.5]], Alignment::OnFeatures).unwrap();
    let count_kind = |kind| atoms.kinds.iter().filter(|&&k| k == kind).count();
    assert_eq!(
        (count_kind(AtomKind::Corner), count_kind(AtomKind::Fixed)),
        (4, 1)
    );
    // As many atoms along the edges as d asks for.
    let step = |n: u32| 0.5 + f64::from(n);
    let along_x = |n: u32| 1.0 / distance.value_at([step(n), 0.0]);
    let along_y = |n: u32| 1.0 / distance.value_at([0.0, step(n)]);
    let expected = 2.0 * ((0..120).map(along_x).sum::<f64>() + (0..91).map(along_y).sum::<f64>());
    let on_edges = (count_kind(AtomKind::Edge) + 4) as f64;
    assert!((on_edges - expected).abs() < 3.0, "{on_edges} {expected}");
    let spacing = spacing_quantiles(&atoms, &distance);
    println!("{} atoms, nearest / d {spacing:.3?}", atoms.len());
    assert!(spacing[0] > 0.7 && spacing[4] < 1.5, "{spacing:?}");
    assert!(spacing[2] > 0.8 && spacing[2] < 1.05, "{spacing:?}");
}

/// Checks that the outermost atoms are about half a d from the nearest side, so that their mirror
/// images are about d away.
fn assert_alongside<const D: usize>(atoms: &Atoms<D>, extent: [f64; D], distance: &Distance<D>) {
    assert!(atoms.kinds.iter().all(|&k| k == AtomKind::Interior));
    let mut outermost_count = 0;
    for x in &atoms.positions {
        let d = distance.value_at(*x);
        for k in 0..D {
            let depth = x[k].min(extent[k] - x[k]) / d;
            assert!(depth > 0.39, "{x:?} {depth}");
            outermost_count += usize::from(depth < 0.6);
        }
    }
    assert!(outermost_count > 40, "{outermost_count}");
    let spacing = spacing_quantiles(atoms, distance);
    println!("{} atoms, nearest / d {spacing:.3?}", atoms.len());
    assert!(spacing[0] > 0.7 && spacing[4] < 1.5, "{spacing:?}");
}

fn assert_inset<const D: usize>(extent: [f64; D], is_varying: bool) {
    let distance = if is_varying {
        varying_distance(extent)
    } else {
        Distance::Constant(6.0)
    };
    let atoms = fcc(extent, &distance, &[], Alignment::AlongsideFeatures).unwrap();
    assert_alongside(&atoms, extent, &distance);
}

#[test]
fn keeps_off_the_sides_alongside() {
    for is_varying in [false, true] {
        assert_inset([120.0, 91.0], is_varying);
        assert_inset([50.0, 43.0, 55.0], is_varying);
    }
    let refused = fcc(
        [50.0; 2],
        &Distance::Constant(6.0),
        &[[0.0, 20.0]],
        Alignment::AlongsideFeatures,
    );
    assert!(refused.unwrap_err().to_string().contains("on a side"));
}

#[test]
fn wells_are_seeds_of_the_lattice() {
    // Count of the twelve neighbours that each well has in the lattice, for both wells, that are
    // where they should be.
    let extent = [61.0, 57.0, 63.0];
    let distance = Distance::Constant(5.0);
    let wells = [[22.3, 31.1, 17.7], [40.9, 20.2, 44.4]];
    let neighbours = |seeding: Seeding| {
        let atoms = seed_on_features(seeding, extent, &distance, &wells).unwrap();
        assert_eq!(atoms.positions[atoms.len() - 2..], wells);
        let sites = wells.iter().flat_map(|well| {
            let step = |step: [f64; 3]| std::array::from_fn(|k| well[k] + 5.0 * step[k]);
            neighbour_steps::<3>(&[0, 1, 2]).into_iter().map(step)
        });
        let is_taken = |site: &[f64; 3]| {
            let mut atoms = atoms.positions.iter();
            atoms.any(|x| distance2(x, site) < 1e-12)
        };
        sites.filter(is_taken).count()
    };
    assert_eq!(neighbours(Seeding::Grown), 24);
    assert!(neighbours(Seeding::Fcc) < 4);
    // In the plane there are six.
    let (well, extent) = ([22.3, 31.1], [61.0, 57.0]);
    let atoms = seed_on_features(Seeding::Grown, extent, &Distance::Constant(5.0), &[well]);
    let atoms = atoms.unwrap().positions;
    let is_taken = |step: [f64; 2]| {
        let site = [well[0] + 5.0 * step[0], well[1] + 5.0 * step[1]];
        atoms.iter().any(|x| distance2(x, &site) < 1e-12)
    };
    assert!(neighbour_steps::<2>(&[0, 1]).into_iter().all(is_taken));
}

/// Grows a lattice with `count` ranks. Returns its atoms in the order in which they were added.
fn grow_in_threads<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    count: usize,
) -> Vec<([f64; D], u32)> {
    let (alignment, cancel) = (Alignment::OnFeatures, &CancelToken::never());
    let parts = run_threads(count, |comm| {
        let shared_box = SharedBox::new(extent, comm);
        grow_lattice(shared_box, distance, fixed, alignment, cancel).unwrap()
    });
    assert!(count > 9 || parts.iter().all(|part| !part.is_empty()));
    let mut atoms = parts.concat();
    atoms.sort_by_key(|(_, index)| *index);
    atoms
}

#[test]
fn slabs_grow_the_same_atoms_in_the_same_order() {
    let fixed = [[20.3, 19.1, 20.7], [0.0, 13.3, 12.2], [40.0, 0.0, 61.0]];
    for fixed in [&fixed[..], &[]] {
        let extent = [40.0, 30.0, 121.0];
        let distance = varying_distance(extent);
        let expected = grow_in_threads(extent, &distance, fixed, 1);
        assert!(expected.len() > 800, "{}", expected.len());
        for count in [2, 3, 7, 13] {
            let slabs = grow_in_threads(extent, &distance, fixed, count);
            assert!(slabs == expected, "{count}");
        }
    }
    let (extent, waves) = ([70.0, 260.0], sloping_distance([70.0, 260.0], 0.05, true));
    let expected = grow_in_threads(extent, &waves, &[], 1);
    assert!(grow_in_threads(extent, &waves, &[], 4) == expected);
}
