//! The shapes of a mesh's tetrahedra, in figures.

use crate::mesh::TetMesh;
use crate::mesh::quality::Shape;
use rayon::prelude::*;
use serde::Serialize;

/// Bins of the histogram of dihedral angles, of 10 degrees each.
pub const BINS: usize = 18;
/// Tetrahedra in one task; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1 << 14;
/// How many of the worst tetrahedra are listed.
const LISTED: usize = 10;

/// The worst value of all tetrahedra, and the values that 0.1, 1 and 50 % of them do not reach or
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

/// One of the worst tetrahedra.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Worst {
    /// Its number in the mesh.
    pub tet: usize,
    /// Its centroid, in the space that was measured.
    pub centroid: [f64; 3],
    /// Its smallest dihedral angle, in degrees.
    pub smallest: f64,
    /// Its largest dihedral angle, in degrees.
    pub largest: f64,
}

/// The shapes of all tetrahedra. Angles are dihedral and in degrees. Of an empty mesh, figures
/// without a value are NaN (null in JSON).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quality {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of tetrahedra.
    pub tets: usize,
    /// Each tetrahedron's smallest angle; the worst is the smallest.
    pub smallest_angle: Points,
    /// Each tetrahedron's largest angle; the worst is the largest.
    pub largest_angle: Points,
    /// Tetrahedra with an angle below 20 degrees.
    pub below_20: usize,
    /// Tetrahedra with an angle below 30 degrees.
    pub below_30: usize,
    /// Tetrahedra with an angle above 150 degrees.
    pub above_150: usize,
    /// Tetrahedra with an angle above 160 degrees.
    pub above_160: usize,
    /// Number of angles (six a tetrahedron) in each bin of 10 degrees.
    pub histogram: [u64; BINS],
    /// Mean ratio, 1 for the regular tetrahedron, 0 for a flat one.
    pub mean_ratio: Points,
    /// Circumradius over shortest edge, 0.612 for the regular tetrahedron; the worst is the
    /// largest.
    pub radius_edge: Points,
    /// Mean of all mean ratios.
    pub mean_ratio_mean: f64,
    /// Sum of the (signed) volumes.
    pub volume: f64,
    /// The smallest (signed) volume.
    pub smallest_volume: f64,
    /// The largest volume.
    pub largest_volume: f64,
    /// The tetrahedra whose angles are farthest from 90 degrees, worst first.
    pub worst: Vec<Worst>,
}

/// What is kept of each tetrahedron.
struct Shapes {
    smallest: Vec<f32>,
    largest: Vec<f32>,
    ratio: Vec<f32>,
    radius: Vec<f32>,
    histogram: [u64; BINS],
    ratio_sum: f64,
    volume: f64,
    volume_range: [f64; 2],
}

/// Measures every tetrahedron in the space in which the mesh's nodes are given.
pub fn quality(mesh: &TetMesh) -> Quality {
    let parts: Vec<Shapes> = mesh
        .tets
        .par_chunks(CHUNK)
        .map(|tets| shapes(mesh, tets))
        .collect();
    let gather = |part: fn(&Shapes) -> &Vec<f32>| -> Vec<f32> {
        parts.iter().flat_map(part).copied().collect()
    };
    let mut smallest = gather(|p| &p.smallest);
    let mut largest = gather(|p| &p.largest);
    let count =
        |values: &[f32], wanted: fn(f32) -> bool| values.iter().filter(|&&v| wanted(v)).count();
    let mut histogram = [0; BINS];
    for part in &parts {
        for (sum, bin) in histogram.iter_mut().zip(part.histogram) {
            *sum += bin;
        }
    }
    let tets = mesh.tets.len();
    Quality {
        nodes: mesh.nodes.len(),
        tets,
        below_20: count(&smallest, |a| a < 20.0),
        below_30: count(&smallest, |a| a < 30.0),
        above_150: count(&largest, |a| a > 150.0),
        above_160: count(&largest, |a| a > 160.0),
        histogram,
        worst: worst(mesh, &smallest, &largest),
        smallest_angle: points(&mut smallest, Bad::Small),
        largest_angle: points(&mut largest, Bad::Large),
        mean_ratio: points(&mut gather(|p| &p.ratio), Bad::Small),
        radius_edge: points(&mut gather(|p| &p.radius), Bad::Large),
        mean_ratio_mean: parts.iter().map(|p| p.ratio_sum).sum::<f64>() / tets as f64,
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

fn shapes(mesh: &TetMesh, tets: &[[u32; 4]]) -> Shapes {
    let mut found = Shapes {
        smallest: Vec::with_capacity(tets.len()),
        largest: Vec::with_capacity(tets.len()),
        ratio: Vec::with_capacity(tets.len()),
        radius: Vec::with_capacity(tets.len()),
        histogram: [0; BINS],
        ratio_sum: 0.0,
        volume: 0.0,
        volume_range: [f64::INFINITY, f64::NEG_INFINITY],
    };
    let bins = Bins::new();
    for tet in tets {
        let shape = Shape::of(&tet.map(|n| mesh.nodes[n as usize]));
        for cosine in shape.cosines {
            found.histogram[bins.of(cosine)] += 1;
        }
        found.smallest.push(shape.smallest_angle() as f32);
        found.largest.push(shape.largest_angle() as f32);
        found.ratio.push(shape.mean_ratio as f32);
        found.radius.push(shape.radius_edge as f32);
        found.ratio_sum += shape.mean_ratio;
        found.volume += shape.volume;
        found.volume_range = [
            found.volume_range[0].min(shape.volume),
            found.volume_range[1].max(shape.volume),
        ];
    }
    found
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

fn points(values: &mut [f32], bad: Bad) -> Points {
    let Some(last) = values.len().checked_sub(1) else {
        let none = f64::NAN;
        return Points {
            worst: none,
            permille: none,
            percent: none,
            median: none,
        };
    };
    // The bad ones come first, and each search is among what the one before has put aside.
    if let Bad::Large = bad {
        values.iter_mut().for_each(|v| *v = -*v);
    }
    let [worst, permille, percent, median] =
        [0.0, 0.001, 0.01, 0.5].map(|s| (s * last as f64) as usize);
    let mut below = values;
    let mut found = [median, percent, permille, worst].map(|rank| {
        let whole = std::mem::take(&mut below);
        let value = *whole.select_nth_unstable_by(rank, f32::total_cmp).1;
        below = &mut whole[..=rank];
        f64::from(value)
    });
    if let Bad::Large = bad {
        found = found.map(|v| -v);
    }
    let [median, percent, permille, worst] = found;
    Points {
        worst,
        permille,
        percent,
        median,
    }
}

fn worst(mesh: &TetMesh, smallest: &[f32], largest: &[f32]) -> Vec<Worst> {
    let badness = |t: usize| (90.0 - smallest[t]).max(largest[t] - 90.0);
    let mut found: Vec<usize> = Vec::with_capacity(LISTED + 1);
    for t in 0..mesh.tets.len() {
        let full = found.len() == LISTED;
        if full
            && found
                .last()
                .is_some_and(|&last| badness(t) <= badness(last))
        {
            continue;
        }
        let place = found.partition_point(|&other| badness(other) >= badness(t));
        found.insert(place, t);
        found.truncate(LISTED);
    }
    found
        .into_iter()
        .map(|t| {
            let p = mesh.corners(t);
            Worst {
                tet: t,
                centroid: std::array::from_fn(|k| 0.25 * p.iter().map(|c| c[k]).sum::<f64>()),
                smallest: smallest[t].into(),
                largest: largest[t].into(),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::test_mesh::kuhn_box;
    use super::*;

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
    fn a_box_of_cut_cubes() {
        let mesh = kuhn_box([5, 4, 3], 2.0);
        let found = quality(&mesh);
        assert_eq!((found.nodes, found.tets), (6 * 5 * 4, 6 * 60));
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
        let listed: Vec<usize> = found.worst.iter().map(|w| w.tet).collect();
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
        let low = points(&mut values.clone(), Bad::Small);
        assert_eq!(
            (low.worst, low.permille, low.percent, low.median),
            (0.0, 1.0, 10.0, 500.0)
        );
        let high = points(&mut values.clone(), Bad::Large);
        let found = (high.worst, high.permille, high.percent, high.median);
        assert_eq!(found, (1000.0, 999.0, 990.0, 500.0));
    }
}
