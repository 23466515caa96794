//! The shapes of a mesh's cells, in figures: tetrahedra by their dihedral angles, triangles by their
//! angles.

use super::Angles;
use crate::files::kept::fields;
use crate::mesh::Simplices;
use crate::mesh::part::Part;
use crate::observer::Patience;
use crate::parallel::prelude::*;
use crate::ranks::Holders;
use crate::ranks::order::at_ranks;
use serde::Serialize;
use std::borrow::Cow;

/// Bins of the histogram of angles, of 10 degrees each.
pub const BINS: usize = 18;
/// Cells in one task; fixed, so that sums do not depend on the number of threads.
pub(super) const CHUNK: usize = 1 << 14;
/// How many of the worst cells are listed.
const LISTED: usize = 10;

/// The worst value of all cells, and the values that 0.1, 1 and 50 % of them do not reach or
/// are worse than.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Points {
    /// The worst of all.
    pub worst: f64,
    /// Only one in a thousand is worse.
    pub permille: f64,
    /// Only one in a hundred is worse.
    pub percent: f64,
    /// Half are worse.
    pub median: f64,
}

/// One of the worst cells.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Worst {
    /// Its number in the mesh.
    pub cell: usize,
    /// Its centroid, in the space that was measured.
    pub centroid: Vec<f64>,
    /// Its smallest angle, in degrees.
    pub smallest: f64,
    /// Its largest angle, in degrees.
    pub largest: f64,
}

/// The shapes of all cells: tetrahedra or triangles. Angles are in degrees, and dihedral in
/// tetrahedra. Of an empty mesh, figures without a value are NaN (null in JSON).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quality {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of cells.
    pub cells: usize,
    /// What they are: `tetrahedra` or `triangles`.
    pub kind: Cow<'static, str>,
    /// Each cell's smallest angle; the worst is the smallest.
    pub smallest_angle: Points,
    /// Each cell's largest angle; the worst is the largest.
    pub largest_angle: Points,
    /// Cells with an angle below 20 degrees.
    pub below_20: usize,
    /// Cells with an angle below 30 degrees.
    pub below_30: usize,
    /// Cells with an angle above 120 degrees, which only a triangle below 30 has.
    pub above_120: usize,
    /// Cells with an angle above 150 degrees.
    pub above_150: usize,
    /// Cells with an angle above 160 degrees.
    pub above_160: usize,
    /// Number of angles (six a tetrahedron, three a triangle) in each bin of 10 degrees.
    pub histogram: [u64; BINS],
    /// Mean ratio, 1 for the regular cell, 0 for a flat one; in the plane this is
    /// Q = 4 sqrt(3) A / (l1^2 + l2^2 + l3^2).
    pub mean_ratio: Points,
    /// Circumradius over shortest edge, 0.612 for the regular tetrahedron, 0.577 for the equilateral
    /// triangle; the worst is the largest.
    pub radius_edge: Points,
    /// Mean of all mean ratios.
    pub mean_ratio_mean: f64,
    /// Sum of the (signed) volumes; areas in the plane.
    pub volume: f64,
    /// The smallest (signed) volume.
    pub smallest_volume: f64,
    /// The largest volume.
    pub largest_volume: f64,
    /// The cells whose angles are farthest from 90 degrees, worst first.
    pub worst: Vec<Worst>,
    /// Which angles beyond [30, 150] the features explain, where that was asked.
    pub angles: Option<Angles>,
}

/// The smallest angle of every cell, in degrees.
pub fn smallest_angles<const D: usize, M: Simplices<D>>(mesh: &M) -> Vec<f32> {
    let mut angles = vec![0.0f32; mesh.len()];
    let chunks = angles.par_chunks_mut(CHUNK).enumerate();
    chunks.for_each(|(chunk, angles)| {
        let first = chunk * CHUNK;
        let mut places = angles.iter_mut();
        mesh.shapes(first..first + places.len(), |shape| {
            if let Some(angle) = places.next() {
                *angle = largest(shape.cosines.as_ref()).acos().to_degrees() as f32;
            }
        });
    });
    angles
}

/// What is kept of a cell. Angles are kept as what they need for a cosine of one, which grows with them
/// and tells the smallest apart: no arc cosine for each of millions of cells.
#[derive(Clone, Copy, Default)]
struct OfCell {
    /// 1 - cos of the smallest angle.
    smallest: f32,
    /// 1 + cos of the largest angle, 1 - cos of what it lacks of 180 degrees.
    largest: f32,
    ratio: f32,
    radius: f32,
}

impl OfCell {
    /// What is kept of the angle that is farther from 90 degrees.
    fn worse(&self) -> f32 {
        self.smallest.min(self.largest)
    }
}

/// The sums of the cells of one task.
struct Sums {
    histogram: [u64; BINS],
    ratio_sum: f64,
    volume: f64,
    volume_range: [f64; 2],
}

/// Measures every cell in the space in which the mesh's nodes are given.
pub fn quality<const D: usize, M: Simplices<D>>(mesh: &M) -> Quality {
    quality_while(mesh, &Patience::endless())
}

/// The same as long as `patience` lasts; once it is over, the figures are of no use.
pub(crate) fn quality_while<const D: usize, M: Simplices<D>>(
    mesh: &M,
    patience: &Patience<'_>,
) -> Quality {
    let Ok(found) = quality_of_part(&Part::all(mesh), patience);
    found
}

/// The same of a mesh in parts, on all who hold one.
///
/// # Errors
/// Those of the other holders.
pub(crate) fn quality_of_part<const D: usize, M: Simplices<D>, H: Holders + ?Sized>(
    part: &Part<'_, D, M, H>,
    patience: &Patience<'_>,
) -> Result<Quality, H::Error> {
    let mesh = part.mesh;
    let mut of_cells = vec![OfCell::default(); mesh.len()];
    let sums: Vec<Sums> = (of_cells.par_chunks_mut(CHUNK).enumerate())
        .take_any_while(|_| !patience.over())
        .map(|(chunk, of_cells)| shapes(mesh, chunk * CHUNK, of_cells))
        .collect();
    let all = (part.holders).told("shapes", Own::new(part, &of_cells, &sums))?;
    let series: [Figure; 4] = [|c| c.smallest, |c| c.largest, |c| c.ratio, |c| c.radius];
    let series = series.map(|of| of_cells.iter().map(of));
    let [smallest, largest, mean_ratio, radius_edge] = points(
        series,
        [Bad::Small, Bad::Small, Bad::Small, Bad::Large],
        part.holders,
    )?;
    let count = |k: usize| all.iter().map(|own| own.counts[k]).sum::<u64>();
    let [below_20, below_30, above_120, above_150, above_160] =
        [0, 1, 2, 3, 4].map(|k| count(k) as usize);
    let sum = |k: usize| all.iter().map(|own| own.sums[k]).sum::<f64>();
    let mut worst: Vec<(f32, Worst)> = all.iter().flat_map(|own| own.worst.clone()).collect();
    worst.sort_by_key(|(_, worst)| worst.cell);
    Ok(Quality {
        nodes: part.whole[0],
        cells: part.whole[1],
        kind: M::CELLS.into(),
        smallest_angle: smallest.map(angle),
        largest_angle: largest.map(|v| 180.0 - angle(v)),
        below_20,
        below_30,
        above_120,
        above_150,
        above_160,
        histogram: std::array::from_fn(|bin| count(LIMITS.len() + bin)),
        worst: farthest(worst)
            .into_iter()
            .map(|(_, worst)| worst)
            .collect(),
        angles: None,
        mean_ratio,
        radius_edge,
        mean_ratio_mean: sum(0) / part.whole[1] as f64,
        volume: sum(1),
        smallest_volume: (all.iter().map(|own| own.range[0])).fold(f64::NAN, f64::min),
        largest_volume: (all.iter().map(|own| own.range[1])).fold(f64::NAN, f64::max),
    })
}

/// A figure of a cell.
type Figure = fn(&OfCell) -> f32;

/// What is counted: cells with the smallest angle, or with what the largest lacks of 180 degrees, below a limit.
const LIMITS: [(Figure, f64); 5] = [
    (|c| c.smallest, 20.0),
    (|c| c.smallest, 30.0),
    (|c| c.largest, 60.0),
    (|c| c.largest, 30.0),
    (|c| c.largest, 20.0),
];

/// What is told of the cells of a part.
struct Own {
    /// Of [`LIMITS`], then the bins of the histogram.
    counts: Vec<u64>,
    /// Of mean ratios, and of volumes.
    sums: [f64; 2],
    /// The smallest volume and the largest.
    range: [f64; 2],
    /// The cells whose angles are farthest from 90 degrees, with their [`OfCell::worse`].
    worst: Vec<(f32, Worst)>,
}

fields! { Own as Own { counts, sums, range, worst } }

impl Own {
    fn new<const D: usize, M: Simplices<D>, H: Holders + ?Sized>(
        part: &Part<'_, D, M, H>,
        of_cells: &[OfCell],
        sums: &[Sums],
    ) -> Self {
        let below = |(of, angle): (Figure, f64)| {
            let limit = 1.0 - angle.to_radians().cos();
            let values = of_cells.par_iter().map(of);
            values.filter(|&v| f64::from(v) < limit).count() as u64
        };
        let mut counts = LIMITS.map(below).to_vec();
        counts.extend((0..BINS).map(|bin| sums.iter().map(|s| s.histogram[bin]).sum::<u64>()));
        let worst = farthest(of_cells.iter().map(OfCell::worse).zip(0..));
        let listed = |(worse, c): (f32, usize)| {
            let cell = &of_cells[c];
            let worst = Worst {
                cell: part.first + c,
                centroid: centroid(part.mesh, c),
                smallest: angle(cell.smallest.into()),
                largest: 180.0 - angle(cell.largest.into()),
            };
            (worse, worst)
        };
        Self {
            counts,
            sums: [
                sums.iter().map(|s| s.ratio_sum).sum(),
                sums.iter().map(|s| s.volume).sum(),
            ],
            range: [
                (sums.iter().map(|s| s.volume_range[0])).fold(f64::NAN, f64::min),
                (sums.iter().map(|s| s.volume_range[1])).fold(f64::NAN, f64::max),
            ],
            worst: worst.into_iter().map(listed).collect(),
        }
    }
}

/// Measures the cells from one on.
fn shapes<const D: usize>(mesh: &impl Simplices<D>, first: usize, of_cells: &mut [OfCell]) -> Sums {
    let cells = first..first + of_cells.len();
    let mut places = of_cells.iter_mut();
    let mut found = Sums {
        histogram: [0; BINS],
        ratio_sum: 0.0,
        volume: 0.0,
        volume_range: [f64::INFINITY, f64::NEG_INFINITY],
    };
    let bins = Bins::new();
    mesh.shapes(cells, |shape| {
        let cosines = shape.cosines.as_ref();
        for &cosine in cosines {
            found.histogram[bins.of(cosine)] += 1;
        }
        if let Some(cell) = places.next() {
            *cell = OfCell {
                smallest: (1.0 - largest(cosines)) as f32,
                largest: (1.0 + smallest(cosines)) as f32,
                ratio: shape.mean_ratio as f32,
                radius: shape.radius_edge as f32,
            };
        }
        found.ratio_sum += shape.mean_ratio;
        found.volume += shape.volume;
        found.volume_range = [
            found.volume_range[0].min(shape.volume),
            found.volume_range[1].max(shape.volume),
        ];
    });
    found
}

/// The angle, in degrees, whose cosine is that much below one.
pub(super) fn angle(versine: f64) -> f64 {
    (1.0 - versine).acos().to_degrees()
}

pub(super) fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

pub(super) fn smallest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// The bins of the histogram, for cosines: no arc cosine for each of millions of angles.
struct Bins {
    /// Cosines of the bins' upper ends; the last is never reached.
    ends: [f64; BINS],
    /// The bin of the largest cosine in each of the equal parts of [-1, 1], none of which holds
    /// more than one end.
    of_part: [u8; PARTS + 1],
}

const PARTS: usize = 512;

impl Bins {
    fn new() -> Self {
        let width = std::f64::consts::PI / BINS as f64;
        let mut ends: [f64; BINS] = std::array::from_fn(|bin| ((bin + 1) as f64 * width).cos());
        ends[BINS - 1] = -2.0;
        let of_part = std::array::from_fn(|part| {
            let top = 2.0 * (part + 1) as f64 / PARTS as f64 - 1.0;
            ends.iter().filter(|&&end| top <= end).count() as u8
        });
        Self { ends, of_part }
    }

    /// The bin of an angle with that cosine: the number of ends that it has reached.
    #[inline]
    fn of(&self, cosine: f64) -> usize {
        let part = ((cosine + 1.0) * (0.5 * PARTS as f64)) as usize;
        let bin = usize::from(self.of_part[part.min(PARTS)]);
        bin + usize::from(cosine <= self.ends[bin])
    }
}

/// Which end of a range is bad.
#[derive(Clone, Copy)]
enum Bad {
    Small,
    Large,
}

impl Points {
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self {
            worst: f(self.worst),
            permille: f(self.permille),
            percent: f(self.percent),
            median: f(self.median),
        }
    }
}

/// Of each series of values these of all holders.
fn points<const N: usize, H: Holders + ?Sized>(
    series: [impl Iterator<Item = f32> + Clone + Sync; N],
    bad: [Bad; N],
    holders: &H,
) -> Result<[Points; N], H::Error> {
    let ranks = bad.map(|bad| {
        move |total: usize| {
            let last = total - 1;
            let ranks = [0.0, 0.001, 0.01, 0.5].map(|share| (share * last as f64) as usize);
            match bad {
                Bad::Small => ranks,
                Bad::Large => ranks.map(|rank| last - rank),
            }
        }
    });
    let found = at_ranks(&series, &ranks, holders)?;
    Ok(std::array::from_fn(|i| {
        let [worst, permille, percent, median] = std::array::from_fn(|of| found[i][of]);
        Points {
            worst,
            permille,
            percent,
            median,
        }
    }))
}

/// The mean of a cell's corners.
pub(super) fn centroid<const D: usize>(mesh: &impl Simplices<D>, c: usize) -> Vec<f64> {
    let corners = mesh.cell(c);
    let sum = |k: usize| -> f64 { corners.iter().map(|&n| mesh.nodes()[n as usize][k]).sum() };
    (0..D).map(|k| sum(k) / corners.len() as f64).collect()
}

/// The few cells whose angles are farthest from 90 degrees, worst first, of all in the order of their numbers: each
/// with its [`OfCell::worse`].
fn farthest<T>(cells: impl IntoIterator<Item = (f32, T)>) -> Vec<(f32, T)> {
    let mut found: Vec<(f32, T)> = Vec::with_capacity(LISTED + 1);
    for (worse, cell) in cells {
        if found.len() == LISTED && found.last().is_some_and(|last| worse >= last.0) {
            continue;
        }
        let place = found.partition_point(|other| other.0 <= worse);
        found.insert(place, (worse, cell));
        found.truncate(LISTED);
    }
    found
}

#[cfg(test)]
#[path = "quality_tests.rs"]
mod tests;
