//! The shapes of a mesh's cells, in figures: tetrahedra by their dihedral angles, triangles by their
//! angles.

use crate::mesh::quality::{mean_ratio, radius_edge_ratio};
use crate::mesh::{EDGES, Simplices, TetMesh, TriMesh, cross, dot, norm, sub, tri, volume6};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;

/// Bins of the histogram of angles, of 10 degrees each.
pub const BINS: usize = 18;
/// Cells in one task; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1 << 14;
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
    pub kind: &'static str,
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
}

/// The figures of one cell.
pub struct Shape<A> {
    angles: A,
    ratio: f64,
    radius: f64,
    volume: f64,
}

/// A mesh whose cells can be measured.
pub trait Measured<const D: usize>: Simplices<D> {
    /// What a file calls the smallest angle of each cell.
    const MIN_ANGLE: &'static str;
    /// What a file calls the volume of each cell.
    const VOLUME: &'static str;
    /// What a file calls the bits of each cell's faces that lie on features: bit k for the face
    /// opposite node k.
    const FEATURE_FACES: &'static str;
    /// The angles of a cell, in degrees.
    type Angles: IntoIterator<Item = f64>;

    /// Measures cell `c`.
    fn shape(&self, c: usize) -> Shape<Self::Angles>;

    /// The smallest angle of cell `c`, in degrees.
    fn smallest_angle(&self, c: usize) -> f64 {
        let angles = self.shape(c).angles.into_iter();
        angles.fold(f64::INFINITY, f64::min)
    }
}

impl Measured<3> for TetMesh {
    const MIN_ANGLE: &'static str = "min_dihedral";
    const VOLUME: &'static str = "volume";
    const FEATURE_FACES: &'static str = "feature_faces";
    type Angles = [f64; 6];

    fn shape(&self, c: usize) -> Shape<[f64; 6]> {
        let p = self.corners(c);
        Shape {
            angles: angles(&p),
            ratio: mean_ratio(&p),
            radius: radius_edge_ratio(&p),
            volume: volume6(&p) / 6.0,
        }
    }
}

impl Measured<2> for TriMesh {
    const MIN_ANGLE: &'static str = "min_angle";
    const VOLUME: &'static str = "area";
    const FEATURE_FACES: &'static str = "feature_edges";
    type Angles = [f64; 3];

    fn shape(&self, c: usize) -> Shape<[f64; 3]> {
        let p = self.corners(c);
        Shape {
            angles: tri::angles(&p),
            ratio: tri::shape(&p),
            radius: tri::radius_edge_ratio(&p),
            volume: 0.5 * tri::area2(&p),
        }
    }
}

/// What is kept of the cells of one task.
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

/// Measures every cell in the space in which the mesh's nodes are given.
pub fn quality<const D: usize, M: Measured<D>>(mesh: &M) -> Quality {
    let cells = mesh.len();
    let parts: Vec<Shapes> = (0..cells.div_ceil(CHUNK))
        .into_par_iter()
        .map(|part| shapes(mesh, part * CHUNK..cells.min((part + 1) * CHUNK)))
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
    Quality {
        nodes: mesh.nodes().len(),
        cells,
        kind: M::CELLS,
        below_20: count(&smallest, |a| a < 20.0),
        below_30: count(&smallest, |a| a < 30.0),
        above_120: count(&largest, |a| a > 120.0),
        above_150: count(&largest, |a| a > 150.0),
        above_160: count(&largest, |a| a > 160.0),
        histogram,
        worst: worst(mesh, &smallest, &largest),
        smallest_angle: points(&mut smallest, Bad::Small),
        largest_angle: points(&mut largest, Bad::Large),
        mean_ratio: points(&mut gather(|p| &p.ratio), Bad::Small),
        radius_edge: points(&mut gather(|p| &p.radius), Bad::Large),
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

fn shapes<const D: usize>(mesh: &impl Measured<D>, cells: Range<usize>) -> Shapes {
    let mut found = Shapes {
        smallest: Vec::with_capacity(cells.len()),
        largest: Vec::with_capacity(cells.len()),
        ratio: Vec::with_capacity(cells.len()),
        radius: Vec::with_capacity(cells.len()),
        histogram: [0; BINS],
        ratio_sum: 0.0,
        volume: 0.0,
        volume_range: [f64::INFINITY, f64::NEG_INFINITY],
    };
    for c in cells {
        let shape = mesh.shape(c);
        let (mut least, mut most) = (180f64, 0f64);
        for angle in shape.angles {
            least = least.min(angle);
            most = most.max(angle);
            found.histogram[((angle / 10.0) as usize).min(BINS - 1)] += 1;
        }
        found.smallest.push(least as f32);
        found.largest.push(most as f32);
        found.ratio.push(shape.ratio as f32);
        found.radius.push(shape.radius as f32);
        found.ratio_sum += shape.ratio;
        found.volume += shape.volume;
        found.volume_range = [
            found.volume_range[0].min(shape.volume),
            found.volume_range[1].max(shape.volume),
        ];
    }
    found
}

/// The dihedral angles in degrees, in the order of [`EDGES`], from the four faces' normals: half
/// the cost of `mesh::quality::dihedral_angles`, and good to 1e-6 degrees near 0 and 180. An angle
/// at a face without area is called 0.
fn angles(p: &[[f64; 3]; 4]) -> [f64; 6] {
    let (a, b, c) = (sub(p[1], p[0]), sub(p[2], p[0]), sub(p[3], p[0]));
    // Of the faces opposite each node, all outward (or all inward).
    let normals = [
        cross(sub(p[2], p[1]), sub(p[3], p[1])),
        cross(c, b),
        cross(a, c),
        cross(b, a),
    ];
    let lengths = normals.map(norm);
    std::array::from_fn(|e| {
        // Edge e lies between the faces opposite the two nodes of the opposite edge.
        let [k, l] = EDGES[5 - e];
        let area = lengths[k] * lengths[l];
        if area > 0.0 {
            (-dot(normals[k], normals[l]) / area)
                .clamp(-1.0, 1.0)
                .acos()
                .to_degrees()
        } else {
            0.0
        }
    })
}

/// Which end of a range is bad.
enum Bad {
    Small,
    Large,
}

fn points(values: &mut [f32], bad: Bad) -> Points {
    let mut at = |share: f64| {
        let Some(last) = values.len().checked_sub(1) else {
            return f64::NAN;
        };
        let rank = (share * last as f64) as usize;
        let rank = match bad {
            Bad::Small => rank,
            Bad::Large => last - rank,
        };
        f64::from(*values.select_nth_unstable_by(rank, f32::total_cmp).1)
    };
    Points {
        worst: at(0.0),
        permille: at(0.001),
        percent: at(0.01),
        median: at(0.5),
    }
}

fn worst<const D: usize>(
    mesh: &impl Simplices<D>,
    smallest: &[f32],
    largest: &[f32],
) -> Vec<Worst> {
    let badness = |c: usize| (90.0 - smallest[c]).max(largest[c] - 90.0);
    let mut found: Vec<usize> = Vec::with_capacity(LISTED + 1);
    for c in 0..mesh.len() {
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
    let centroid = |c: usize| {
        let corners = mesh.cell(c);
        let sum = |k: usize| -> f64 { corners.iter().map(|&n| mesh.nodes()[n as usize][k]).sum() };
        (0..D).map(|k| sum(k) / corners.len() as f64).collect()
    };
    found
        .into_iter()
        .map(|c| Worst {
            cell: c,
            centroid: centroid(c),
            smallest: smallest[c].into(),
            largest: largest[c].into(),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::test_mesh::kuhn_box;
    use super::*;
    use crate::mesh::quality::dihedral_angles;

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
        assert_eq!((found.cells, found.kind), (1, "triangles"));
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
    fn angles_are_those_of_the_mesh_module() {
        let mut state = 3u64;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        for _ in 0..500 {
            let p: [[f64; 3]; 4] = std::array::from_fn(|_| std::array::from_fn(|_| next()));
            for (fast, exact) in angles(&p).into_iter().zip(dihedral_angles(&p)) {
                assert!((fast - exact).abs() < 1e-5, "{fast} {exact}");
            }
        }
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
