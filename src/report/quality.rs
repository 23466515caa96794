//! The shapes of a mesh's cells, in figures: tetrahedra by their dihedral angles, triangles by their
//! angles.

use super::Angles;
use crate::comm::LocalOrComm;
use crate::comm::selection::order_statistics;
use crate::files::codec::codec_fields;
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use serde::Serialize;
use std::borrow::Cow;

/// Bins of the histogram of angles, of 10 degrees each.
pub const BINS: usize = 18;
/// Cells in one task; fixed, so that sums do not depend on the number of threads.
pub(super) const CELLS_PER_TASK: usize = 1 << 14;
/// How many of the worst cells are listed.
const MAX_LISTED_CELLS: usize = 10;

/// The worst value of all cells, and the values that 0.1, 1 and 50 % of them do not reach or
/// are worse than.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
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
    pub smallest_angle: Quantiles,
    /// Each cell's largest angle; the worst is the largest.
    pub largest_angle: Quantiles,
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
    pub mean_ratio: Quantiles,
    /// Circumradius over shortest edge, 0.612 for the regular tetrahedron, 0.577 for the equilateral
    /// triangle; the worst is the largest.
    pub radius_edge: Quantiles,
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
    let chunks = angles.par_chunks_mut(CELLS_PER_TASK).enumerate();
    chunks.for_each(|(chunk, angles)| {
        let first = chunk * CELLS_PER_TASK;
        let mut places = angles.iter_mut();
        mesh.shapes(first..first + places.len(), |shape| {
            if let Some(angle) = places.next() {
                *angle = max_value(shape.cosines.as_ref()).acos().to_degrees() as f32;
            }
        });
    });
    angles
}

/// What is kept of a cell. Angles are kept as what they need for a cosine of one, which grows with them
/// and tells the smallest apart: no arc cosine for each of millions of cells.
#[derive(Clone, Copy, Default)]
struct CellShape {
    /// 1 - cos of the smallest angle.
    smallest: f32,
    /// 1 + cos of the largest angle, 1 - cos of what it lacks of 180 degrees.
    largest: f32,
    mean_ratio: f32,
    radius_edge: f32,
}

impl CellShape {
    /// What is kept of the angle that is farther from 90 degrees.
    fn worst_versine(&self) -> f32 {
        self.smallest.min(self.largest)
    }
}

/// The sums of the cells of one task.
struct ShapeSums {
    histogram: [u64; BINS],
    ratio_sum: f64,
    volume: f64,
    volume_range: [f64; 2],
}

/// Measures every cell in the space in which the mesh's nodes are given.
pub fn quality<const D: usize, M: Simplices<D>>(mesh: &M) -> Quality {
    quality_with_cancel(mesh, &CancelToken::never())
}

/// The same as long as `patience` lasts; once it is over, the figures are of no use.
pub(crate) fn quality_with_cancel<const D: usize, M: Simplices<D>>(
    mesh: &M,
    patience: &CancelToken<'_>,
) -> Quality {
    let Ok(found) = quality_of_partition(&MeshView::from_mesh(mesh), patience);
    found
}

/// The same of a mesh in parts, on all who hold one.
///
/// # Errors
/// Those of the other holders.
pub(crate) fn quality_of_partition<const D: usize, M: Simplices<D>, H: LocalOrComm + ?Sized>(
    part: &MeshView<'_, D, M, H>,
    patience: &CancelToken<'_>,
) -> Result<Quality, H::Error> {
    let mesh = part.mesh;
    let mut of_cells = vec![CellShape::default(); mesh.len()];
    let sums: Vec<ShapeSums> = (of_cells.par_chunks_mut(CELLS_PER_TASK).enumerate())
        .take_any_while(|_| !patience.is_cancelled())
        .map(|(chunk, of_cells)| measure_shapes(mesh, chunk * CELLS_PER_TASK, of_cells))
        .collect();
    let all = (part.comm).try_all_gather("shapes", LocalQuality::new(part, &of_cells, &sums))?;
    let series: [ShapeMeasure; 4] = [
        |c| c.smallest,
        |c| c.largest,
        |c| c.mean_ratio,
        |c| c.radius_edge,
    ];
    let series = series.map(|of| of_cells.iter().map(of));
    let [smallest, largest, mean_ratio, radius_edge] = quantiles(
        series,
        [BadEnd::Small, BadEnd::Small, BadEnd::Small, BadEnd::Large],
        part.comm,
    )?;
    let count = |k: usize| all.iter().map(|own| own.counts[k]).sum::<u64>();
    let [below_20, below_30, above_120, above_150, above_160] =
        [0, 1, 2, 3, 4].map(|k| count(k) as usize);
    let sum = |k: usize| all.iter().map(|own| own.sums[k]).sum::<f64>();
    let mut worst: Vec<(f32, Worst)> = all.iter().flat_map(|own| own.worst.clone()).collect();
    worst.sort_by_key(|(_, worst)| worst.cell);
    Ok(Quality {
        nodes: part.global_counts[0],
        cells: part.global_counts[1],
        kind: M::CELLS_NAME.into(),
        smallest_angle: smallest.map(angle_from_versine),
        largest_angle: largest.map(|v| 180.0 - angle_from_versine(v)),
        below_20,
        below_30,
        above_120,
        above_150,
        above_160,
        histogram: std::array::from_fn(|bin| count(ANGLE_LIMITS.len() + bin)),
        worst: worst_cells(worst)
            .into_iter()
            .map(|(_, worst)| worst)
            .collect(),
        angles: None,
        mean_ratio,
        radius_edge,
        mean_ratio_mean: sum(0) / part.global_counts[1] as f64,
        volume: sum(1),
        smallest_volume: (all.iter().map(|own| own.volume_range[0])).fold(f64::NAN, f64::min),
        largest_volume: (all.iter().map(|own| own.volume_range[1])).fold(f64::NAN, f64::max),
    })
}

/// A figure of a cell.
type ShapeMeasure = fn(&CellShape) -> f32;

/// What is counted: cells with the smallest angle, or with what the largest lacks of 180 degrees, below a limit.
const ANGLE_LIMITS: [(ShapeMeasure, f64); 5] = [
    (|c| c.smallest, 20.0),
    (|c| c.smallest, 30.0),
    (|c| c.largest, 60.0),
    (|c| c.largest, 30.0),
    (|c| c.largest, 20.0),
];

/// What is told of the cells of a part.
struct LocalQuality {
    /// Of [`ANGLE_LIMITS`], then the bins of the histogram.
    counts: Vec<u64>,
    /// Of mean ratios, and of volumes.
    sums: [f64; 2],
    /// The smallest volume and the largest.
    volume_range: [f64; 2],
    /// The cells whose angles are farthest from 90 degrees, with their [`CellShape::worst_versine`].
    worst: Vec<(f32, Worst)>,
}

codec_fields! { LocalQuality as LocalQuality { counts, sums, volume_range, worst } }

impl LocalQuality {
    fn new<const D: usize, M: Simplices<D>, H: LocalOrComm + ?Sized>(
        part: &MeshView<'_, D, M, H>,
        of_cells: &[CellShape],
        sums: &[ShapeSums],
    ) -> Self {
        let below = |(of, angle): (ShapeMeasure, f64)| {
            let limit = 1.0 - angle.to_radians().cos();
            let values = of_cells.par_iter().map(of);
            values.filter(|&v| f64::from(v) < limit).count() as u64
        };
        let mut counts = ANGLE_LIMITS.map(below).to_vec();
        counts.extend((0..BINS).map(|bin| sums.iter().map(|s| s.histogram[bin]).sum::<u64>()));
        let worst = worst_cells(of_cells.iter().map(CellShape::worst_versine).zip(0..));
        let listed = |(worse, c): (f32, usize)| {
            let cell = &of_cells[c];
            let worst = Worst {
                cell: part.first_cell + c,
                centroid: centroid(part.mesh, c),
                smallest: angle_from_versine(cell.smallest.into()),
                largest: 180.0 - angle_from_versine(cell.largest.into()),
            };
            (worse, worst)
        };
        Self {
            counts,
            sums: [
                sums.iter().map(|s| s.ratio_sum).sum(),
                sums.iter().map(|s| s.volume).sum(),
            ],
            volume_range: [
                (sums.iter().map(|s| s.volume_range[0])).fold(f64::NAN, f64::min),
                (sums.iter().map(|s| s.volume_range[1])).fold(f64::NAN, f64::max),
            ],
            worst: worst.into_iter().map(listed).collect(),
        }
    }
}

/// Measures the cells from one on.
fn measure_shapes<const D: usize>(
    mesh: &impl Simplices<D>,
    first: usize,
    of_cells: &mut [CellShape],
) -> ShapeSums {
    let cells = first..first + of_cells.len();
    let mut places = of_cells.iter_mut();
    let mut found = ShapeSums {
        histogram: [0; BINS],
        ratio_sum: 0.0,
        volume: 0.0,
        volume_range: [f64::INFINITY, f64::NEG_INFINITY],
    };
    let bins = AngleBins::new();
    mesh.shapes(cells, |shape| {
        let cosines = shape.cosines.as_ref();
        for &cosine in cosines {
            found.histogram[bins.bin_index(cosine)] += 1;
        }
        if let Some(cell) = places.next() {
            *cell = CellShape {
                smallest: (1.0 - max_value(cosines)) as f32,
                largest: (1.0 + min_value(cosines)) as f32,
                mean_ratio: shape.mean_ratio as f32,
                radius_edge: shape.radius_edge as f32,
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
pub(super) fn angle_from_versine(versine: f64) -> f64 {
    (1.0 - versine).acos().to_degrees()
}

pub(super) fn max_value(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

pub(super) fn min_value(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// The bins of the histogram, for cosines: no arc cosine for each of millions of angles.
struct AngleBins {
    /// Cosines of the bins' upper ends; the last is never reached.
    upper_ends: [f64; BINS],
    /// The bin of the largest cosine in each of the equal parts of [-1, 1], none of which holds
    /// more than one end.
    bin_of_interval: [u8; COSINE_INTERVALS + 1],
}

const COSINE_INTERVALS: usize = 512;

impl AngleBins {
    fn new() -> Self {
        let width = std::f64::consts::PI / BINS as f64;
        let mut upper_ends: [f64; BINS] =
            std::array::from_fn(|bin| ((bin + 1) as f64 * width).cos());
        upper_ends[BINS - 1] = -2.0;
        let bin_of_interval = std::array::from_fn(|part| {
            let top = 2.0 * (part + 1) as f64 / COSINE_INTERVALS as f64 - 1.0;
            upper_ends.iter().filter(|&&end| top <= end).count() as u8
        });
        Self {
            upper_ends,
            bin_of_interval,
        }
    }

    /// The bin of an angle with that cosine: the number of ends that it has reached.
    #[inline]
    fn bin_index(&self, cosine: f64) -> usize {
        let part = ((cosine + 1.0) * (0.5 * COSINE_INTERVALS as f64)) as usize;
        let bin = usize::from(self.bin_of_interval[part.min(COSINE_INTERVALS)]);
        bin + usize::from(cosine <= self.upper_ends[bin])
    }
}

/// Which end of a range is bad.
#[derive(Clone, Copy)]
enum BadEnd {
    Small,
    Large,
}

impl Quantiles {
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
fn quantiles<const N: usize, H: LocalOrComm + ?Sized>(
    series: [impl Iterator<Item = f32> + Clone + Sync; N],
    bad: [BadEnd; N],
    holders: &H,
) -> Result<[Quantiles; N], H::Error> {
    let ranks = bad.map(|bad| {
        move |total: usize| {
            let last = total - 1;
            let ranks = [0.0, 0.001, 0.01, 0.5].map(|share| (share * last as f64) as usize);
            match bad {
                BadEnd::Small => ranks,
                BadEnd::Large => ranks.map(|rank| last - rank),
            }
        }
    });
    let found = order_statistics(&series, &ranks, holders)?;
    Ok(std::array::from_fn(|i| {
        let [worst, permille, percent, median] = std::array::from_fn(|of| found[i][of]);
        Quantiles {
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
/// with its [`CellShape::worst_versine`].
fn worst_cells<T>(cells: impl IntoIterator<Item = (f32, T)>) -> Vec<(f32, T)> {
    let mut found: Vec<(f32, T)> = Vec::with_capacity(MAX_LISTED_CELLS + 1);
    for (worse, cell) in cells {
        if found.len() == MAX_LISTED_CELLS && found.last().is_some_and(|last| worse >= last.0) {
            continue;
        }
        let place = found.partition_point(|other| other.0 <= worse);
        found.insert(place, (worse, cell));
        found.truncate(MAX_LISTED_CELLS);
    }
    found
}

#[cfg(test)]
#[path = "quality_tests.rs"]
mod tests;
