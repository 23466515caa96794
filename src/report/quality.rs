//! The shapes of a mesh's cells, in figures: tetrahedra by their dihedral angles, triangles by their
//! angles.

use super::Angles;
use crate::mesh::Simplices;
use crate::observer::Patience;
use rayon::prelude::*;
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
    let cells = mesh.len();
    let mut of_cells = vec![OfCell::default(); cells];
    let parts: Vec<Sums> = (of_cells.par_chunks_mut(CHUNK).enumerate())
        .take_any_while(|_| !patience.over())
        .map(|(part, of_cells)| shapes(mesh, part * CHUNK, of_cells))
        .collect();
    let below = |of: fn(&OfCell) -> f32, angle: f64| {
        let limit = 1.0 - angle.to_radians().cos();
        let values = of_cells.par_iter().map(of);
        values.filter(|&v| f64::from(v) < limit).count()
    };
    let (smallest, largest) = (|c: &OfCell| c.smallest, |c: &OfCell| c.largest);
    let ranked = |of: fn(&OfCell) -> f32, bad: Bad| points(of_cells.iter().map(of), bad);
    let ((smallest_angle, largest_angle), (mean_ratio, radius_edge)) = rayon::join(
        || {
            rayon::join(
                || ranked(smallest, Bad::Small).map(angle),
                || ranked(largest, Bad::Small).map(|v| 180.0 - angle(v)),
            )
        },
        || {
            rayon::join(
                || ranked(|c| c.ratio, Bad::Small),
                || ranked(|c| c.radius, Bad::Large),
            )
        },
    );
    let mut histogram = [0; BINS];
    for part in &parts {
        for (sum, bin) in histogram.iter_mut().zip(part.histogram) {
            *sum += bin;
        }
    }
    Quality {
        nodes: mesh.nodes().len(),
        cells,
        kind: M::CELLS.into(),
        below_20: below(smallest, 20.0),
        below_30: below(smallest, 30.0),
        above_120: below(largest, 60.0),
        above_150: below(largest, 30.0),
        above_160: below(largest, 20.0),
        histogram,
        worst: worst(mesh, &of_cells),
        angles: None,
        smallest_angle,
        largest_angle,
        mean_ratio,
        radius_edge,
        mean_ratio_mean: parts.iter().map(|p| p.ratio_sum).sum::<f64>() / cells as f64,
        volume: parts.iter().map(|p| p.volume).sum(),
        smallest_volume: parts
            .iter()
            .map(|p| p.volume_range[0])
            .fold(f64::NAN, f64::min),
        largest_volume: parts
            .iter()
            .map(|p| p.volume_range[1])
            .fold(f64::NAN, f64::max),
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

fn points(values: impl ExactSizeIterator<Item = f32> + Clone, bad: Bad) -> Points {
    let Some(last) = values.len().checked_sub(1) else {
        let none = f64::NAN;
        return Points {
            worst: none,
            permille: none,
            percent: none,
            median: none,
        };
    };
    let ranks = [0.0, 0.001, 0.01, 0.5].map(|share| (share * last as f64) as usize);
    let [worst, permille, percent, median] = match bad {
        Bad::Small => at_ranks(values, ranks),
        Bad::Large => at_ranks(values, ranks.map(|rank| last - rank)),
    };
    Points {
        worst,
        permille,
        percent,
        median,
    }
}

/// The values of which so many are smaller. Counts how many values begin with each 16 bits, and sorts
/// only among those that begin as the wanted ones do.
fn at_ranks<const N: usize>(
    values: impl Iterator<Item = f32> + Clone,
    ranks: [usize; N],
) -> [f64; N] {
    // Whole numbers that are ordered as the values are.
    let order = |v: f32| match v.to_bits() {
        bits if bits >> 31 == 1 => !bits,
        bits => bits | 1 << 31,
    };
    let mut counts = vec![0usize; 1 << 16];
    for v in values.clone() {
        counts[(order(v) >> 16) as usize] += 1;
    }
    // Where each rank is: its beginning, and how many of the same beginning are before it.
    let places = ranks.map(|rank| {
        let mut before = 0;
        let bin = counts.iter().position(|&count| {
            before += count;
            before > rank
        });
        let bin = bin.unwrap_or_default();
        (bin as u32, rank + counts[bin] - before)
    });
    let mut alike: [Vec<f32>; N] = std::array::from_fn(|_| Vec::new());
    for v in values {
        let bin = order(v) >> 16;
        for (alike, place) in alike.iter_mut().zip(&places) {
            if place.0 == bin {
                alike.push(v);
            }
        }
    }
    let mut found = [f64::NAN; N];
    for ((found, alike), (_, rank)) in found.iter_mut().zip(&mut alike).zip(places) {
        if rank < alike.len() {
            *found = f64::from(*alike.select_nth_unstable_by(rank, f32::total_cmp).1);
        }
    }
    found
}

/// The mean of a cell's corners.
pub(super) fn centroid<const D: usize>(mesh: &impl Simplices<D>, c: usize) -> Vec<f64> {
    let corners = mesh.cell(c);
    let sum = |k: usize| -> f64 { corners.iter().map(|&n| mesh.nodes()[n as usize][k]).sum() };
    (0..D).map(|k| sum(k) / corners.len() as f64).collect()
}

fn worst<const D: usize>(mesh: &impl Simplices<D>, of_cells: &[OfCell]) -> Vec<Worst> {
    let badness = |c: usize| -of_cells[c].smallest.min(of_cells[c].largest);
    let mut found: Vec<usize> = Vec::with_capacity(LISTED + 1);
    for c in 0..of_cells.len() {
        let full = found.len() == LISTED;
        if full
            && found
                .last()
                .is_some_and(|&last| badness(c) <= badness(last))
        {
            continue;
        }
        let place = found.partition_point(|&other| badness(other) >= badness(c));
        found.insert(place, c);
        found.truncate(LISTED);
    }
    found
        .into_iter()
        .map(|c| Worst {
            cell: c,
            centroid: centroid(mesh, c),
            smallest: angle(of_cells[c].smallest.into()),
            largest: 180.0 - angle(of_cells[c].largest.into()),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::{TetMesh, TriMesh};

    #[test]
    fn the_regular_tetrahedron() {
        let nodes = vec![
            [1.0, 1.0, 1.0],
            [-1.0, 1.0, -1.0],
            [1.0, -1.0, -1.0],
            [-1.0, -1.0, 1.0],
        ];
        let found = quality(&TetMesh {
            nodes,
            tets: vec![[0, 1, 2, 3]],
        });
        let regular = (1f64 / 3.0).acos().to_degrees();
        assert!((regular - 70.53).abs() < 0.01);
        assert!((found.smallest_angle.worst - regular).abs() < 1e-5);
        assert!((found.largest_angle.median - regular).abs() < 1e-5);
        assert_eq!(found.histogram.iter().sum::<u64>(), 6);
        assert_eq!(found.histogram[7], 6);
        assert!((found.mean_ratio.worst - 1.0).abs() < 1e-6);
        assert!((found.radius_edge.worst - 0.6124).abs() < 1e-4);
        assert!((found.volume - 8.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn the_equilateral_triangle_and_half_a_square() {
        let nodes = vec![[0.0, 0.0], [2.0, 0.0], [1.0, 3f64.sqrt()]];
        let mut mesh = TriMesh {
            nodes,
            triangles: vec![[0, 1, 2]],
        };
        let found = quality(&mesh);
        assert_eq!((found.cells, &*found.kind), (1, "triangles"));
        assert!((found.smallest_angle.worst - 60.0).abs() < 1e-5);
        assert_eq!(found.histogram[5] + found.histogram[6], 3);
        assert!((found.mean_ratio_mean - 1.0).abs() < 1e-12);
        assert!((found.volume - 3f64.sqrt()).abs() < 1e-12);
        mesh.nodes[2] = [0.0, 2.0];
        let found = quality(&mesh);
        assert!((found.smallest_angle.worst - 45.0).abs() < 1e-5);
        assert!((found.mean_ratio.worst - 0.75f64.sqrt()).abs() < 1e-6);
        assert_eq!(found.worst[0].centroid, [2.0 / 3.0; 2]);
        // 10, 10 and 160 degrees.
        mesh.nodes[2] = [1.0, 10f64.to_radians().tan()];
        let found = quality(&mesh);
        assert_eq!(
            (found.below_20, found.above_120, found.above_150),
            (1, 1, 1)
        );
    }

    #[test]
    fn a_box_of_cut_cubes() {
        let mesh = kuhn_box([5, 4, 3], 2.0);
        let found = quality(&mesh);
        assert_eq!((found.nodes, found.cells), (6 * 5 * 4, 6 * 60));
        // Kuhn's tetrahedron has the angles 45 (twice), 60 and 90 (three times).
        assert!((found.smallest_angle.worst - 45.0).abs() < 1e-5);
        assert!((found.largest_angle.worst - 90.0).abs() < 1e-5);
        assert_eq!(
            found.histogram[4] + found.histogram[6] + found.histogram[5],
            360 * 3
        );
        assert_eq!(found.histogram[8] + found.histogram[9], 360 * 3);
        assert!((found.volume - 480.0).abs() < 1e-9);
        assert!((found.smallest_volume - 8.0 / 6.0).abs() < 1e-12);
        let counts = (
            found.below_20,
            found.below_30,
            found.above_150,
            found.above_160,
        );
        assert_eq!(counts, (0, 0, 0, 0));
        assert_eq!(found.worst.len(), 10);
    }

    #[test]
    fn flat_tetrahedra_are_counted_listed_and_do_not_break_the_figures() {
        let mut mesh = kuhn_box([4, 4, 4], 1.0);
        let t = 100;
        let [a, b, c, _] = mesh.corners(t);
        // Almost in the middle of its own face: angles near 0 and 180.
        let middle: [f64; 3] = std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0 + 1e-3);
        mesh.nodes.push(middle);
        mesh.tets[t][3] = mesh.nodes.len() as u32 - 1;
        // And one without any volume or area.
        mesh.tets.push([0, 0, 1, 1]);
        let found = quality(&mesh);
        assert_eq!(found.worst.len(), 10);
        let listed: Vec<usize> = found.worst.iter().map(|w| w.cell).collect();
        assert!(listed[..2].contains(&t) && listed[..2].contains(&(mesh.tets.len() - 1)));
        assert_eq!((found.below_20, found.above_160), (2, 1));
        assert_eq!(found.smallest_angle.worst, 0.0);
        assert_eq!(found.mean_ratio.worst, 0.0);
        assert_eq!(
            found.histogram.iter().sum::<u64>(),
            6 * mesh.tets.len() as u64
        );

        let empty = quality(&TetMesh::default());
        assert!(empty.smallest_angle.worst.is_nan() && empty.mean_ratio_mean.is_nan());
    }

    #[test]
    fn bins_are_those_of_the_angles() {
        let bins = Bins::new();
        for i in 1..18_000 {
            let angle = f64::from(i) / 100.0 - 0.005;
            assert_eq!(bins.of(angle.to_radians().cos()), (angle / 10.0) as usize);
        }
        assert_eq!((bins.of(1.0), bins.of(-1.0)), (0, BINS - 1));
    }

    #[test]
    fn points_are_the_ranks_of_the_sorted_values() {
        let values: Vec<f32> = (0..1001).map(|i| ((i * 617) % 1001) as f32).collect();
        let low = points(values.iter().copied(), Bad::Small);
        assert_eq!(
            (low.worst, low.permille, low.percent, low.median),
            (0.0, 1.0, 10.0, 500.0)
        );
        let high = points(values.iter().copied(), Bad::Large);
        let found = (high.worst, high.permille, high.percent, high.median);
        assert_eq!(found, (1000.0, 999.0, 990.0, 500.0));
    }
}
