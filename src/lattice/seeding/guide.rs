//! Atoms drawn by chance, where the image is strong first (Fernandes & Gattass 2009).
//!
//! The image, as grey levels, is an image of probabilities. Under a gamma correction, S^(1/gamma), it
//! becomes another: small gammas leave only the strongest features, large ones make all places nearly
//! as likely as one another. For each of 41 gammas, in rising order, places are drawn by a guide table
//! and become atoms where no atom is nearer than 0.8 d(x); after 1024 failures in a row comes the next
//! gamma. So features get their atoms first, and then the rest of the box its own.
//!
//! Samples of one grey level are equally likely. So a table is over the 256 levels, and a draw takes
//! one of the samples of its level: what a table over all samples gives, without making 41 of them.
//! Level 0 counts as one level's worth, for under any gamma nought stays nought, and the box would not
//! be filled.
//!
//! So that the box is filled exactly, its corners come first, then its edges, evenly divided; then in
//! 3-D its sides, drawn from their samples; then the inside. Alongside, there is nothing on the sides,
//! and places are the likelier the farther they are from features.

use super::grow::faces;
use super::refine::spread;
use super::{Alignment, FREE, MARGIN, scatter, varies};
use crate::error::Result;
use crate::geometry::groups::grouped;
use crate::geometry::random::Random;
use crate::geometry::scatter::Scatter;
use crate::image::Field;
use crate::lattice::distance::Distance;

/// Failures in a row after which the next table is used (Fernandes & Gattass 2009, table 1).
const FAILURES: usize = 1024;
/// Grey levels.
const LEVELS: usize = 256;

/// The gamma corrections, rising: 1/i for i > 1 and |i| + 1 for i <= 1, i from -20 to 20 (Fernandes &
/// Gattass 2009; as printed, 2 comes twice, from i = 1 and i = -1).
pub fn gammas() -> impl Iterator<Item = f64> {
    let small = (2..=20).rev().map(|i| 1.0 / f64::from(i));
    let large = [1.0, 2.0].into_iter().chain((2..=21).map(f64::from));
    small.chain(large)
}

/// A table by which numbers are drawn with given probabilities in expected constant time, however many
/// there are (Chen & Asau 1974; Devroye 1986, chapter III.2.4): the interval [0, 1) is cut into as many
/// equal parts as there are numbers, and each knows where the search through cumulative probabilities
/// starts.
#[derive(Debug, Clone)]
pub struct GuideTable {
    /// Probability of a number or any before it.
    cumulative: Vec<f64>,
    /// The least number whose cumulative probability is above the start of each part.
    guide: Vec<u32>,
}

impl GuideTable {
    /// A table of the numbers from 0 on, as likely as their weights say; `None` unless the weights are
    /// finite, not negative, fewer than 2^32, and some are positive.
    pub fn new(weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        let sound = weights.iter().all(|&w| w >= 0.0) && u32::try_from(weights.len()).is_ok();
        if !(sound && total > 0.0 && total.is_finite()) {
            return None;
        }
        let last = weights.iter().rposition(|&w| w > 0.0)?;
        let mut sum = 0.0;
        let cumulative: Vec<f64> = weights
            .iter()
            .enumerate()
            .map(|(n, w)| {
                sum += w;
                // Not a rounding error below 1.
                if n >= last { 1.0 } else { sum / total }
            })
            .collect();
        let mut n = 0;
        let guide = (0..weights.len())
            .map(|part| {
                let start = part as f64 / weights.len() as f64;
                while cumulative[n] <= start {
                    n += 1;
                }
                n as u32
            })
            .collect();
        Some(Self { cumulative, guide })
    }

    /// The number that belongs to `chance`, which is even in [0, 1).
    #[inline]
    pub fn draw(&self, chance: f64) -> usize {
        self.search(chance).0
    }

    /// The number, and how many cumulative probabilities were looked at: less than 2 on average.
    fn search(&self, chance: f64) -> (usize, usize) {
        let first = self.guide[(chance * self.guide.len() as f64) as usize] as usize;
        let mut n = first;
        while self.cumulative[n] <= chance {
            n += 1;
        }
        (n, n - first + 1)
    }
}

/// Samples in the order of their grey levels.
struct Levels {
    samples: Vec<u32>,
    /// Where each level starts, and one more at the end.
    starts: Vec<u32>,
}

impl Levels {
    /// Sorts samples, given with their levels.
    fn new(levels: impl Iterator<Item = (u32, u8)> + Clone) -> Self {
        let (starts, order) = grouped(LEVELS, levels.clone().map(|(_, level)| level.into()));
        let given: Vec<u32> = levels.map(|(sample, _)| sample).collect();
        let samples = order.iter().map(|&n| given[n as usize]).collect();
        Self { samples, starts }
    }

    /// The table of levels under a gamma correction; `None` if there are no samples.
    fn table(&self, gamma: f64) -> Option<GuideTable> {
        let weight = |level: usize| {
            let signal = (level + 1) as f64 / LEVELS as f64;
            f64::from(self.starts[level + 1] - self.starts[level]) * signal.powf(1.0 / gamma)
        };
        GuideTable::new(&(0..LEVELS).map(weight).collect::<Vec<_>>())
    }

    /// A sample.
    fn draw(&self, table: &GuideTable, random: &mut Random) -> usize {
        let level = table.draw(random.draw());
        let [start, end] = [0, 1].map(|k| self.starts[level + k] as usize);
        let place = (random.draw() * (end - start) as f64) as usize;
        self.samples[start + place] as usize
    }
}

/// The sequence of chance.
fn chances(seed: u64) -> Random {
    let mut random = Random::new(seed);
    // The first number is not used.
    random.draw();
    random
}

/// Positions of a lattice of spacing d(x) that fills the box `[0, extent]`, for `D` of 2 or 3, drawn
/// by chance under the image `potential`, which spans the box: -1 on features, 0 elsewhere. Atoms on
/// sides have coordinates of exactly `0.0` or `extent[k]`; all others lie on samples. None is nearer
/// than 0.8 d to `fixed` atoms, which are in the box and not in the result. No atoms are drawn beyond
/// `most` in all.
///
/// # Errors
/// [`Error::Seeding`](crate::Error::Seeding) if the potential is the same everywhere, does not span
/// the box or has 2^32 samples or more.
pub fn drawn<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    potential: &Field<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    seed: u64,
    most: usize,
) -> Result<Vec<[f64; D]>> {
    let [low, high] = varies(potential, extent, "guide")?;
    let level = |b: f32| {
        let share = match alignment {
            Alignment::On => (high - b) / (high - low),
            Alignment::Alongside => (b - low) / (high - low),
        };
        (share * (LEVELS - 1) as f32).round() as u8
    };
    let mut placed = scatter(extent, FREE * distance.min());
    for &x in fixed {
        placed.add(x);
    }
    let mut random = chances(seed);
    let first = match alignment {
        Alignment::On => D,
        Alignment::Alongside => 0,
    };
    for rank in (0..=first).rev() {
        for sides in faces::<D>(rank) {
            let corner: [f64; D] = std::array::from_fn(|k| match sides >> (D + k) & 1 {
                1 => extent[k],
                _ => 0.0,
            });
            let axes: Vec<usize> = (0..D)
                .filter(|&k| (sides | sides >> D) >> k & 1 == 0)
                .collect();
            if rank == D {
                if placed.is_free(&corner, 1e-3 * distance.min()) {
                    placed.add(corner);
                }
            } else if let [axis] = axes[..] {
                let at = |t: f64| {
                    let mut x = corner;
                    x[axis] = t;
                    x
                };
                for t in spread(extent[axis], distance.min(), |t| distance.at(at(t))) {
                    if placed.is_free(&at(t), FREE * distance.at(at(t))) {
                        placed.add(at(t));
                    }
                }
            } else {
                let face = Face::new(potential, corner, &axes);
                let levels = (0..face.len()).map(|n| {
                    let sample = face.sample(n);
                    (sample, level(potential.samples[sample as usize]))
                });
                fill(
                    &mut placed,
                    &Levels::new(levels),
                    |sample| face.position(sample),
                    &axes,
                    extent,
                    distance,
                    &mut random,
                    most.saturating_add(fixed.len()),
                );
            }
        }
    }
    Ok(placed.positions()[fixed.len()..].to_vec())
}

/// Draws until all tables have failed, or there are `most` atoms.
fn fill<const D: usize>(
    placed: &mut Scatter<D>,
    levels: &Levels,
    position: impl Fn(usize) -> [f64; D],
    axes: &[usize],
    extent: [f64; D],
    distance: &Distance<D>,
    random: &mut Random,
    most: usize,
) {
    for table in gammas().map_while(|gamma| levels.table(gamma)) {
        let mut failures = 0;
        while failures <= FAILURES && placed.positions().len() < most {
            let x = position(levels.draw(&table, random));
            let d = distance.at(x);
            let inside = |&k: &usize| x[k].min(extent[k] - x[k]) >= MARGIN * d;
            if axes.iter().all(inside) && placed.is_free(&x, FREE * d) {
                placed.add(x);
                failures = 0;
            } else {
                failures += 1;
            }
        }
    }
}

/// The samples of a field inside one of its sides, or inside the whole of it.
struct Face<'a, const D: usize> {
    field: &'a Field<D>,
    corner: [f64; D],
    /// Number of samples along each axis.
    dims: [usize; D],
    /// Index of the first along each axis.
    first: [usize; D],
}

impl<'a, const D: usize> Face<'a, D> {
    /// Along `axes`, through a corner of the field.
    fn new(field: &'a Field<D>, corner: [f64; D], axes: &[usize]) -> Self {
        let along = |k: usize| axes.contains(&k);
        Self {
            field,
            corner,
            dims: std::array::from_fn(|k| match along(k) {
                true => field.dims[k].saturating_sub(2),
                false => 1,
            }),
            first: std::array::from_fn(|k| match (along(k), corner[k] > 0.0) {
                (true, _) => 1,
                (false, true) => field.dims[k] - 1,
                (false, false) => 0,
            }),
        }
    }

    fn len(&self) -> usize {
        self.dims.iter().product()
    }

    /// The index in the field of the `n`th.
    fn sample(&self, n: usize) -> u32 {
        let (mut rest, mut stride, mut sample) = (n, 1, 0);
        for k in 0..D {
            sample += (rest % self.dims[k] + self.first[k]) * stride;
            rest /= self.dims[k];
            stride *= self.field.dims[k];
        }
        sample as u32
    }

    /// Where a sample of the field is; on sides exactly.
    fn position(&self, sample: usize) -> [f64; D] {
        let mut rest = sample;
        std::array::from_fn(|k| {
            let index = rest % self.field.dims[k];
            rest /= self.field.dims[k];
            match index == 0 || index + 1 == self.field.dims[k] {
                true => self.corner[k],
                false => index as f64 * self.field.step[k],
            }
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::lattice::seeding::grow::tests::{spacing, varying};
    use crate::lattice::seeding::{Seeding, seed};

    fn many(seed: u64, count: usize) -> impl Iterator<Item = f64> {
        let mut random = chances(seed);
        (0..count).map(move |_| random.draw())
    }

    /// Chi-square over its degrees of freedom, in standard deviations from what is expected.
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
    fn numbers_are_drawn_as_likely_as_they_shall_be() {
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
            for chance in many(7, 400_000) {
                drawn[table.draw(chance)] += 1;
            }
            let off = chi_square(&drawn, &weights);
            println!("chi-square {off:.2} standard deviations off");
            assert!(off.abs() < 4.0, "{off}");
            // A table of other weights is found out.
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
            // Most of the weight in few numbers, as in an image of features.
            let weight = |n: usize| if n.is_multiple_of(50) { 1.0 } else { 1e-4 };
            let weights: Vec<f64> = (0..count).map(weight).collect();
            let table = GuideTable::new(&weights).unwrap();
            let looked: usize = many(3, 100_000).map(|c| table.search(c).1).sum();
            let mean = looked as f64 / 1e5;
            println!("{count} numbers: {mean:.3} looked at a draw");
            // Devroye: at most 1 + numbers / parts.
            assert!(mean <= 2.0, "{mean}");
        }
    }

    #[test]
    fn samples_are_drawn_as_their_grey_levels_say() {
        let levels: Vec<u8> = (0..500u32).map(|n| (64 + n * n % 192) as u8).collect();
        let sorted = Levels::new((0..500).map(|n| (n, levels[n as usize])));
        for gamma in [0.5, 1.0, 4.0] {
            let table = sorted.table(gamma).unwrap();
            let mut random = chances(5);
            let mut drawn = vec![0; 500];
            for _ in 0..2_000_000 {
                drawn[sorted.draw(&table, &mut random)] += 1;
            }
            let signal = |&level: &u8| (f64::from(level) + 1.0) / 256.0;
            let weights: Vec<f64> = levels.iter().map(|l| signal(l).powf(1.0 / gamma)).collect();
            let off = chi_square(&drawn, &weights);
            println!("gamma {gamma}: chi-square {off:.2} standard deviations off");
            assert!(off.abs() < 4.0, "{off}");
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

    /// A valley across the box, where x + y / 4 is half of it.
    pub fn valley<const D: usize>(extent: [f64; D]) -> Field<D> {
        let dims = extent.map(|l| l as usize + 1);
        Field::from_fn(dims, [1.0; D], |x| {
            let off = (x[0] + 0.25 * x[1] - 0.6 * extent[0]) / 1.5;
            if off.abs() < 4.0 {
                -(-0.5 * off * off).exp()
            } else {
                0.0
            }
        })
    }

    fn check<const D: usize>(extent: [f64; D], distance: &Distance<D>, densest: f64) {
        let potential = valley(extent);
        let how = |seed, most| Seeding::Guide { seed, most };
        let place =
            |how, alignment| seed(how, extent, distance, &[], alignment, Some(&potential)).unwrap();
        let atoms = place(how(1, usize::MAX), Alignment::On);
        let spacing = spacing(&atoms, distance);
        let [least, _, median, _, widest] = spacing;
        let on = |x: &[f64; D]| (x[0] + 0.25 * x[1] - 0.6 * extent[0]).abs() < 1.0;
        let on = atoms.positions.iter().filter(|x| on(x)).count();
        println!(
            "{D}-D: {} atoms, {on} on the feature; nearest / d {spacing:.3?}",
            atoms.len()
        );
        // d may be less at the other end.
        assert!(least > 0.72 && widest < 1.5 && median < 1.05);
        // As many on the feature as random places could hold there, nearly (Renyi: 0.75 a length in
        // the plane; 0.547 of the area in space).
        let length = extent[1] * 17.0f64.sqrt() / 4.0;
        let area: f64 = (2..D).map(|k| extent[k]).product::<f64>() * length;
        assert!(
            on as f64 > densest * area / (FREE * distance.max()).powi(D as i32 - 1),
            "{on}"
        );
        assert_eq!(atoms, place(how(1, usize::MAX), Alignment::On));
        assert_ne!(atoms, place(how(2, usize::MAX), Alignment::On));
        let few = place(how(1, atoms.len() - 20), Alignment::On);
        assert_eq!(few.len(), atoms.len() - 20);

        let beside = place(how(1, usize::MAX), Alignment::Alongside);
        let margin = MARGIN * distance.min() - 1e-9;
        let clear = |x: &[f64; D]| (0..D).all(|k| x[k] > margin && x[k] < extent[k] - margin);
        assert!(beside.positions.iter().all(clear));
    }

    #[test]
    fn a_rectangle_is_filled_features_first() {
        let extent = [120.0, 91.0];
        check(extent, &Distance::Constant(5.0), 0.6);
        check(extent, &varying(extent), 0.6);
    }

    #[test]
    fn a_box_is_filled_features_first() {
        let extent = [60.0, 53.0, 48.0];
        check(extent, &Distance::Constant(5.0), 0.5);
        check(extent, &varying(extent), 0.5);
    }

    #[test]
    fn a_potential_without_features_is_refused() {
        let extent = [40.0, 30.0];
        let distance = Distance::Constant(5.0);
        let mut field = valley(extent);
        let how = Seeding::Guide {
            seed: 1,
            most: usize::MAX,
        };
        let message = |field: Option<&Field<2>>| {
            seed(how, extent, &distance, &[], Alignment::On, field)
                .unwrap_err()
                .to_string()
        };
        assert!(message(None).contains("image"));
        field.samples.fill(-0.25);
        assert!(message(Some(&field)).contains("same everywhere"));
        field.samples[3] = f32::NAN;
        assert!(message(Some(&field)).contains("not a number"));
    }
}
