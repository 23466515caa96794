//! Random atoms with the image as their density, features first (Fernandes & Gattass 2009).
//!
//! The image, as grey levels S, is an image of probabilities. Gamma correction, S^(1/gamma),
//! changes it: small gammas leave only the strongest features, large gammas make all positions
//! nearly equally likely. For each of 41 gammas, in ascending order, positions are drawn by a guide
//! table and become atoms where no atom is nearer than 0.8 d(x). After 1024 failures in a row the
//! next gamma follows. So features get their atoms first, and then the rest of the box.
//!
//! Samples of one grey level are equally likely. So a table is over the 256 levels, and a draw
//! takes one of the samples of its level: the result is that of a table over all samples, without
//! the cost of building 41 of them. Level 0 gets the weight of one level, because zero stays zero
//! under any gamma, and the box would not be filled.
//!
//! So that the box is filled exactly, its corners come first, then its edges, evenly divided; then
//! in 3-D its sides, drawn from their samples; then the inside. With
//! [`Alignment::AlongsideFeatures`] there are no atoms on the sides, and positions are the likelier
//! the farther they are from features.

use crate::geometry::grid_index::{index_at, offset_of};
use crate::lattice::seeding::grow::faces;
mod table;

pub use table::GuideTable;

use crate::error::{Error, Result, cause};
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::geometry::random::Random;
use crate::image::ScalarField;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::refine::graded_positions;
use crate::lattice::seeding::{Alignment, MIN_SITE_DISTANCE, SIDE_MARGIN, empty_grid};
use crate::progress::CancelToken;

/// Failures in a row after which the next table is used (Fernandes & Gattass 2009, table 1).
const MAX_FAILURES: usize = 1024;
/// Count of grey levels.
const GREY_LEVEL_COUNT: usize = 256;

/// Returns the gamma corrections, ascending: 1/i for i > 1 and |i| + 1 for i <= 1, i from -20 to 20
/// (Fernandes & Gattass 2009; as printed, 2 comes twice, from i = 1 and i = -1).
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
        let unsorted: Vec<u32> = levels.map(|(sample, _)| sample).collect();
        let samples = order.iter().map(|&n| unsorted[n as usize]).collect();
        Self {
            samples,
            level_starts,
        }
    }

    /// Returns the table of levels under a gamma correction; `None` if there are no samples.
    fn table(&self, gamma: f64) -> Option<GuideTable> {
        let weight = |level: usize| {
            let signal = (level + 1) as f64 / GREY_LEVEL_COUNT as f64;
            f64::from(self.level_starts[level + 1] - self.level_starts[level])
                * signal.powf(1.0 / gamma)
        };
        GuideTable::new(&(0..GREY_LEVEL_COUNT).map(weight).collect::<Vec<_>>())
    }

    /// Draws a sample.
    fn draw(&self, table: &GuideTable, random: &mut Random) -> usize {
        let level = table.draw(random.draw());
        let [start, end] = [0, 1].map(|k| self.level_starts[level + k] as usize);
        let offset = (random.draw() * (end - start) as f64) as usize;
        self.samples[start + offset] as usize
    }
}

/// Returns the sequence of random numbers of a seed.
fn random_sequence(seed: u64) -> Random {
    let mut random = Random::new(seed);
    // The first number is not used.
    random.draw();
    random
}

/// Options of [`draw_lattice`].
#[derive(Debug, Clone, Copy)]
pub struct GuideOptions {
    /// Where atoms end up.
    pub alignment: Alignment,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Number of atoms at which drawing stops, without fixed atoms.
    pub max_atoms: usize,
}

/// Draws the positions of a lattice of spacing d(x) that fills the box `[0, extent]`, for `D` of 2
/// or 3, with the image `potential` as their density. The potential spans the box: -1 on features,
/// 0 elsewhere. Atoms on sides have coordinates of exactly `0.0` or `extent[k]`; all others lie on
/// samples. None is nearer than 0.8 d to `fixed` atoms, which are in the box and not in the result.
///
/// # Errors
/// Returns [`Error::Seeding`] if the potential is the same everywhere, does
/// not span the box or has 2^32 samples or more.
pub fn draw_lattice<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    potential: &ScalarField<D>,
    fixed: &[[f64; D]],
    options: GuideOptions,
    cancel: &CancelToken<'_>,
) -> Result<Vec<[f64; D]>> {
    let [low, high] = potential_range(potential, extent, "guide")?;
    let level = |b: f32| {
        let share = match options.alignment {
            Alignment::OnFeatures => (high - b) / (high - low),
            Alignment::AlongsideFeatures => (b - low) / (high - low),
        };
        (share * (GREY_LEVEL_COUNT - 1) as f32).round() as u8
    };
    let mut grid = empty_grid([0.0; D], extent, MIN_SITE_DISTANCE * distance.min());
    for &x in fixed {
        grid.add(x);
    }
    let mut lattice = GuidedLattice {
        extent,
        distance,
        grid,
        random: random_sequence(options.seed),
        max_atoms: options.max_atoms.saturating_add(fixed.len()),
        cancel,
    };
    let max_rank = match options.alignment {
        Alignment::OnFeatures => D,
        Alignment::AlongsideFeatures => 0,
    };
    for rank in (0..=max_rank).rev() {
        for sides in faces::<D>(rank) {
            let corner: [f64; D] = std::array::from_fn(|k| match sides >> (D + k) & 1 {
                1 => extent[k],
                _ => 0.0,
            });
            let axes: Vec<usize> = (0..D)
                .filter(|&k| (sides | sides >> D) >> k & 1 == 0)
                .collect();
            if rank == D {
                lattice.add_if_free(corner, 1e-3 * distance.min());
            } else if let [axis] = axes[..] {
                lattice.divide_edge(corner, axis);
            } else {
                let face = FieldFace::new(potential, corner, &axes);
                let levels = (0..face.len()).map(|n| {
                    let sample = face.sample(n);
                    (sample, level(potential.samples[sample as usize]))
                });
                lattice.draw_atoms(&GreyLevels::new(levels), &face, &axes);
            }
        }
    }
    Ok(lattice.grid.positions()[fixed.len()..].to_vec())
}

/// A lattice that is being drawn.
struct GuidedLattice<'a, const D: usize> {
    extent: [f64; D],
    distance: &'a Distance<D>,
    /// Fixed atoms, and the atoms so far.
    grid: IncrementalGrid<D>,
    random: Random,
    /// Number of atoms at which drawing stops, with fixed atoms.
    max_atoms: usize,
    cancel: &'a CancelToken<'a>,
}

impl<const D: usize> GuidedLattice<'_, D> {
    /// Adds an atom if no other is nearer than `min_distance`. Returns `true` if it is added.
    fn add_if_free(&mut self, x: [f64; D], min_distance: f64) -> bool {
        let is_free = self.grid.is_free(&x, min_distance);
        if is_free {
            self.grid.add(x);
        }
        is_free
    }

    /// Adds atoms at nearly even distances on the edge of the box through `corner` along `axis`.
    fn divide_edge(&mut self, corner: [f64; D], axis: usize) {
        let distance = self.distance;
        let point_at = |t: f64| {
            let mut x = corner;
            x[axis] = t;
            x
        };
        let distance_at = |t: f64| distance.value_at(point_at(t));
        for t in graded_positions(self.extent[axis], distance.min(), distance_at) {
            self.add_if_free(point_at(t), MIN_SITE_DISTANCE * distance_at(t));
        }
    }

    /// Draws atoms from samples of `face` until all tables have failed, or there are enough atoms.
    fn draw_atoms(&mut self, levels: &GreyLevels, face: &FieldFace<'_, D>, axes: &[usize]) {
        for table in gammas().map_while(|gamma| levels.table(gamma)) {
            let mut failures = 0;
            while failures <= MAX_FAILURES
                && self.grid.positions().len() < self.max_atoms
                && !self.cancel.is_cancelled()
            {
                let x = face.position(levels.draw(&table, &mut self.random));
                let d = self.distance.value_at(x);
                let is_clear = |&k: &usize| x[k].min(self.extent[k] - x[k]) >= SIDE_MARGIN * d;
                if axes.iter().all(is_clear) && self.add_if_free(x, MIN_SITE_DISTANCE * d) {
                    failures = 0;
                } else {
                    failures += 1;
                }
            }
        }
    }
}

/// The samples of a field in the interior of one of its sides, or in the interior of the field.
struct FieldFace<'a, const D: usize> {
    field: &'a ScalarField<D>,
    corner: [f64; D],
    /// Count of samples along each axis.
    dims: [usize; D],
    /// Index of the first sample along each axis.
    first_index: [usize; D],
}

impl<'a, const D: usize> FieldFace<'a, D> {
    /// Selects the samples along `axes`, through a corner of the field.
    fn new(field: &'a ScalarField<D>, corner: [f64; D], axes: &[usize]) -> Self {
        let is_along = |k: usize| axes.contains(&k);
        Self {
            field,
            corner,
            dims: std::array::from_fn(|k| {
                if is_along(k) {
                    field.dims[k].saturating_sub(2)
                } else {
                    1
                }
            }),
            first_index: std::array::from_fn(|k| match (is_along(k), corner[k] > 0.0) {
                (true, _) => 1,
                (false, true) => field.dims[k] - 1,
                (false, false) => 0,
            }),
        }
    }

    fn len(&self) -> usize {
        self.dims.iter().product()
    }

    /// Returns the index in the field of sample `n`.
    fn sample(&self, n: usize) -> u32 {
        let index = index_at(self.dims, n);
        let in_field = std::array::from_fn(|k| index[k] + self.first_index[k]);
        offset_of(self.field.dims, in_field) as u32
    }

    /// Returns the position of a sample of the field; exact on sides.
    fn position(&self, sample: usize) -> [f64; D] {
        let index = index_at(self.field.dims, sample);
        std::array::from_fn(|k| {
            if index[k] == 0 || index[k] + 1 == self.field.dims[k] {
                self.corner[k]
            } else {
                index[k] as f64 * self.field.step[k]
            }
        })
    }
}

/// Returns the smallest and the largest sample of a potential from which atoms are placed in the
/// box `[0, extent]`. Returns an error if the potential does not span the box, is not finite or is
/// constant.
pub(super) fn potential_range<const D: usize>(
    potential: &ScalarField<D>,
    extent: [f64; D],
    name: &str,
) -> Result<[f32; 2]> {
    let refuse = |problem: String, remedy: &str| {
        let place = format!("seeding {name}: image potential");
        Err(Error::Seeding(cause(place, problem, remedy)))
    };
    let count: usize = potential.dims.iter().product();
    let spans = (0..D).all(|k| (potential.extent()[k] - extent[k]).abs() <= 1e-6 * extent[k]);
    if !spans || potential.samples.len() != count || u32::try_from(count).is_err() {
        let problem = format!(
            "its {count} samples span {:?}, the box {extent:?}",
            potential.extent()
        );
        return refuse(
            problem,
            "give one that spans the box, of fewer than 2^32 samples",
        );
    }
    if !potential.samples.iter().all(|b| b.is_finite()) {
        return refuse(
            "is not a number everywhere".into(),
            "give one without NaN and infinities",
        );
    }
    let fold = |f: fn(f32, f32) -> f32, start| potential.samples.iter().copied().fold(start, f);
    let [low, high] = [
        fold(f32::min, f32::INFINITY),
        fold(f32::max, f32::NEG_INFINITY),
    ];
    if low < high {
        Ok([low, high])
    } else {
        let problem = format!("is {low} everywhere: no place is more likely than another");
        refuse(problem, "follow other features, or use another seeding")
    }
}

#[cfg(test)]
pub(super) mod tests;
