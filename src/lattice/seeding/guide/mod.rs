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
mod table;

pub use table::GuideTable;

use super::refine::graded_positions;
use super::{Alignment, MIN_SITE_DISTANCE, SIDE_MARGIN, empty_grid, potential_range};
use crate::error::Result;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::geometry::random::Random;
use crate::image::ScalarField;
use crate::lattice::distance::Distance;
use crate::progress::CancelToken;

/// Failures in a row after which the next table is used (Fernandes & Gattass 2009, table 1).
const MAX_FAILURES: usize = 1024;
/// Grey levels.
const GREY_LEVEL_COUNT: usize = 256;

/// The gamma corrections, rising: 1/i for i > 1 and |i| + 1 for i <= 1, i from -20 to 20 (Fernandes &
/// Gattass 2009; as printed, 2 comes twice, from i = 1 and i = -1).
pub fn gammas() -> impl Iterator<Item = f64> {
    let small = (2..=20).rev().map(|i| 1.0 / f64::from(i));
    let large = [1.0, 2.0].into_iter().chain((2..=21).map(f64::from));
    small.chain(large)
}

/// Samples in the order of their grey levels.
struct GreyLevels {
    samples: Vec<u32>,
    /// Where each level starts, and one more at the end.
    level_starts: Vec<u32>,
}

impl GreyLevels {
    /// Sorts samples, given with their levels.
    fn new(levels: impl Iterator<Item = (u32, u8)> + Clone) -> Self {
        let (level_starts, order) = sort_by_group(
            GREY_LEVEL_COUNT,
            levels.clone().map(|(_, level)| level.into()),
        );
        let given: Vec<u32> = levels.map(|(sample, _)| sample).collect();
        let samples = order.iter().map(|&n| given[n as usize]).collect();
        Self {
            samples,
            level_starts,
        }
    }

    /// The table of levels under a gamma correction; `None` if there are no samples.
    fn table(&self, gamma: f64) -> Option<GuideTable> {
        let weight = |level: usize| {
            let signal = (level + 1) as f64 / GREY_LEVEL_COUNT as f64;
            f64::from(self.level_starts[level + 1] - self.level_starts[level])
                * signal.powf(1.0 / gamma)
        };
        GuideTable::new(&(0..GREY_LEVEL_COUNT).map(weight).collect::<Vec<_>>())
    }

    /// A sample.
    fn draw(&self, table: &GuideTable, random: &mut Random) -> usize {
        let level = table.draw(random.draw());
        let [start, end] = [0, 1].map(|k| self.level_starts[level + k] as usize);
        let place = (random.draw() * (end - start) as f64) as usize;
        self.samples[start + place] as usize
    }
}

/// The sequence of chance.
fn random_sequence(seed: u64) -> Random {
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
pub fn draw_lattice<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    potential: &ScalarField<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    seed: u64,
    most: usize,
    patience: &CancelToken<'_>,
) -> Result<Vec<[f64; D]>> {
    let [low, high] = potential_range(potential, extent, "guide")?;
    let level = |b: f32| {
        let share = match alignment {
            Alignment::OnFeatures => (high - b) / (high - low),
            Alignment::AlongsideFeatures => (b - low) / (high - low),
        };
        (share * (GREY_LEVEL_COUNT - 1) as f32).round() as u8
    };
    let mut placed = empty_grid([0.0; D], extent, MIN_SITE_DISTANCE * distance.min());
    for &x in fixed {
        placed.add(x);
    }
    let mut random = random_sequence(seed);
    let first = match alignment {
        Alignment::OnFeatures => D,
        Alignment::AlongsideFeatures => 0,
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
                for t in
                    graded_positions(extent[axis], distance.min(), |t| distance.value_at(at(t)))
                {
                    if placed.is_free(&at(t), MIN_SITE_DISTANCE * distance.value_at(at(t))) {
                        placed.add(at(t));
                    }
                }
            } else {
                let face = FieldFace::new(potential, corner, &axes);
                let levels = (0..face.len()).map(|n| {
                    let sample = face.sample(n);
                    (sample, level(potential.samples[sample as usize]))
                });
                draw_atoms(
                    &mut placed,
                    &GreyLevels::new(levels),
                    |sample| face.position(sample),
                    &axes,
                    extent,
                    distance,
                    &mut random,
                    most.saturating_add(fixed.len()),
                    patience,
                );
            }
        }
    }
    Ok(placed.positions()[fixed.len()..].to_vec())
}

/// Draws until all tables have failed, or there are `most` atoms.
fn draw_atoms<const D: usize>(
    placed: &mut IncrementalGrid<D>,
    levels: &GreyLevels,
    position: impl Fn(usize) -> [f64; D],
    axes: &[usize],
    extent: [f64; D],
    distance: &Distance<D>,
    random: &mut Random,
    most: usize,
    patience: &CancelToken<'_>,
) {
    for table in gammas().map_while(|gamma| levels.table(gamma)) {
        let mut failures = 0;
        while failures <= MAX_FAILURES
            && placed.positions().len() < most
            && !patience.is_cancelled()
        {
            let x = position(levels.draw(&table, random));
            let d = distance.value_at(x);
            let inside = |&k: &usize| x[k].min(extent[k] - x[k]) >= SIDE_MARGIN * d;
            if axes.iter().all(inside) && placed.is_free(&x, MIN_SITE_DISTANCE * d) {
                placed.add(x);
                failures = 0;
            } else {
                failures += 1;
            }
        }
    }
}

/// The samples of a field inside one of its sides, or inside the whole of it.
struct FieldFace<'a, const D: usize> {
    field: &'a ScalarField<D>,
    corner: [f64; D],
    /// Number of samples along each axis.
    dims: [usize; D],
    /// Index of the first along each axis.
    first_index: [usize; D],
}

impl<'a, const D: usize> FieldFace<'a, D> {
    /// Along `axes`, through a corner of the field.
    fn new(field: &'a ScalarField<D>, corner: [f64; D], axes: &[usize]) -> Self {
        let along = |k: usize| axes.contains(&k);
        Self {
            field,
            corner,
            dims: std::array::from_fn(|k| match along(k) {
                true => field.dims[k].saturating_sub(2),
                false => 1,
            }),
            first_index: std::array::from_fn(|k| match (along(k), corner[k] > 0.0) {
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
            sample += (rest % self.dims[k] + self.first_index[k]) * stride;
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
pub(super) mod tests;
