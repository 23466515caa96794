//! The pillars of a corner-point grid: straight lines from the top of a model to its bottom, over a
//! parallelogram seen from above. Near steep features they stand as the features do, and on them.
//!
//! Where features are too flat, or too near to each other, for that, the pillars stand upright again:
//! no column is ever turned inside out.

use crate::parallel::prelude::*;

use crate::error::cause;
use crate::geometry::{add_scaled, dot, sub};
use crate::mesh::graph::{Connection, Graph};
use crate::{Error, Result};

type Point2 = [f64; 2];

/// Least angle from the vertical, as the normal's share in z, that is too flat for a pillar (60 degrees
/// of dip).
const MAX_PILLAR_NORMAL_Z: f64 = 0.5;
/// Least area of a column in a section, as a share of what it would be without features.
const MIN_COLUMN_AREA_RATIO: f64 = 0.25;

/// Pillars, those along i first.
#[derive(Debug, Clone, PartialEq)]
pub struct Pillars {
    /// Number of columns along i and j; there is one more pillar along each.
    pub columns: [usize; 2],
    /// Where their tops and their bottoms are in z.
    pub z: [f64; 2],
    /// The top and the bottom of each.
    pub ends: Vec<[Point2; 2]>,
    /// Unit vectors along i and j.
    pub axes: [Point2; 2],
}

/// A model seen from above: a parallelogram between four upright sides.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// The corner from which i and j grow.
    origin: Point2,
    /// From there to the next corner along i, and along j.
    pub edges: [Point2; 2],
    /// The highest and the lowest z.
    pub z: [f64; 2],
}

/// The area between two vectors; positive if the second is to the left of the first.
fn signed_area([a, b]: Point2, [c, d]: Point2) -> f64 {
    a * d - b * c
}

impl Outline {
    /// From the sides of the mesh's box; `place` is whose name errors have.
    ///
    /// # Errors
    /// [`Error::Export`] if the mesh has no upright sides.
    pub fn new(graph: &Graph<3>, nodes: &[[f64; 3]], place: &str) -> Result<Self> {
        // Of each side the area vector, and its middle times its area.
        let mut sides = [([0.0; 3], [0.0; 3], 0.0); 6];
        for face in &graph.boundary {
            if let Some(side) = face.side {
                let (normal, middle, area) = &mut sides[side as usize];
                for k in 0..3 {
                    normal[k] += face.area * face.normal[k];
                    middle[k] += face.area * face.point[k];
                }
                *area += face.area;
            }
        }
        let upright = |axis: usize| {
            let pair = [2 * axis, 2 * axis + 1].map(|s| sides[s]);
            pair.iter()
                .all(|(n, _, area)| *area > 0.0 && n[2].abs() < 1e-6 * area)
        };
        let axes: Vec<usize> = (0..3).filter(|&axis| upright(axis)).collect();
        let &[i, j] = &axes[..] else {
            return Err(Error::Export(cause(
                place,
                "needs a mesh with four vertical sides",
                "mesh an image with one vertical axis, and say which way is down",
            )));
        };
        // The line of a side seen from above: normal and distance.
        let line = |side: usize| {
            let (normal, middle, area) = sides[side];
            let normal = [normal[0], normal[1]];
            (normal, dot(normal, [middle[0] / area, middle[1] / area]))
        };
        let corner = |s: usize, t: usize| {
            let ((m, a), (n, b)) = (line(s), line(t));
            let d = signed_area(m, n);
            [(a * n[1] - b * m[1]) / d, (m[0] * b - n[0] * a) / d]
        };
        let origin = corner(2 * i, 2 * j);
        let mut edges = [
            sub(corner(2 * i + 1, 2 * j), origin),
            sub(corner(2 * i, 2 * j + 1), origin),
        ];
        // Seen from above, from i to j is to the left, as simulators have it.
        if signed_area(edges[0], edges[1]) < 0.0 {
            edges.swap(0, 1);
        }
        let z = nodes
            .iter()
            .fold([f64::NEG_INFINITY, f64::INFINITY], |z, p| {
                [z[0].max(p[2]), z[1].min(p[2])]
            });
        Ok(Self { origin, edges, z })
    }

    /// Lengths along i, j and z.
    pub fn lengths(&self) -> [f64; 3] {
        let [i, j] = self.edges.map(|e| dot(e, e).sqrt());
        [i, j, self.z[0] - self.z[1]]
    }
}

/// A steep feature face: where it is, how far it goes sideways a unit of z, and its area.
struct SteepFace {
    point: Point2,
    z: f64,
    /// Unit normal in the plane.
    normal: Point2,
    slope: Point2,
    area: f64,
}

/// Whether a pillar can stand in a face with this normal.
pub fn is_steep(normal: [f64; 3]) -> bool {
    normal[2].abs() < MAX_PILLAR_NORMAL_Z
}

impl SteepFace {
    fn new(c: &Connection<3>) -> Option<Self> {
        let [x, y, z] = c.normal;
        let level = x.hypot(y);
        (c.on_feature && is_steep(c.normal)).then(|| {
            let normal = [x / level, y / level];
            Self {
                point: [c.point[0], c.point[1]],
                z: c.point[2],
                normal,
                slope: normal.map(|n| -n * z / level),
                area: c.area,
            }
        })
    }
}

impl Pillars {
    /// Pillars for so many columns along i and j.
    pub fn new(outline: &Outline, columns: [usize; 2], graph: &Graph<3>) -> Self {
        let [n, m] = columns;
        let lengths = outline.lengths();
        let axes = [0, 1].map(|k| outline.edges[k].map(|e| e / lengths[k]));
        let mut pillars = Self {
            columns,
            z: outline.z,
            ends: Vec::new(),
            axes,
        };
        let upright = |p: usize| {
            let share = [
                (p % (n + 1)) as f64 / n as f64,
                (p / (n + 1)) as f64 / m as f64,
            ];
            add_scaled(
                add_scaled(outline.origin, share[0], outline.edges[0]),
                share[1],
                outline.edges[1],
            )
        };
        let count = (n + 1) * (m + 1);
        let middle: Vec<Point2> = (0..count).map(upright).collect();
        let steep: Vec<SteepFace> = graph
            .connections
            .iter()
            .filter_map(SteepFace::new)
            .collect();
        let spacing = [lengths[0] / n as f64, lengths[1] / m as f64];
        let leaning = |p: usize| pillars.pillar_adjustment(p, middle[p], &steep, spacing, lengths);
        // How far the middle of each pillar is moved, and how it leans.
        let mut moves: Vec<[Point2; 2]> = if steep.is_empty() {
            vec![[[0.0; 2]; 2]; count]
        } else {
            (0..count).into_par_iter().map(leaning).collect()
        };
        let half = 0.5 * (outline.z[0] - outline.z[1]);
        let ends = |moves: &[[Point2; 2]]| -> Vec<[Point2; 2]> {
            let both = |(p, [shift, slope]): (&Point2, &[Point2; 2])| {
                [half, -half].map(|z| add_scaled(add_scaled(*p, 1.0, *shift), z, *slope))
            };
            middle.iter().zip(moves).map(both).collect()
        };
        pillars.ends = ends(&moves);
        let whole = signed_area(outline.edges[0], outline.edges[1]) / (n * m) as f64;
        // Where a column would become too narrow, its pillars give way.
        loop {
            let narrow = pillars.narrow_pillars(MIN_COLUMN_AREA_RATIO * whole);
            if narrow.is_empty() {
                return pillars;
            }
            for p in narrow {
                let calm = |v: f64| if v.abs() < 1e-3 * half { 0.0 } else { 0.5 * v };
                moves[p] = [
                    moves[p][0].map(calm),
                    moves[p][1].map(|v| calm(v * half) / half),
                ];
            }
            pillars.ends = ends(&moves);
        }
    }

    /// The four pillars of a column: (0, 0), (1, 0), (0, 1), (1, 1) along (i, j).
    pub fn column_pillars(&self, column: usize) -> [usize; 4] {
        let (i, j) = (column % self.columns[0], column / self.columns[0]);
        let row = self.columns[0] + 1;
        let first = j * row + i;
        [first, first + 1, first + row, first + row + 1]
    }

    /// Top and bottom of the line through a column at the shares (u, v) along i and j.
    pub fn line_ends(&self, column: usize, [u, v]: Point2) -> [[f64; 3]; 2] {
        let pillars = self.column_pillars(column);
        let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        [0, 1].map(|end| {
            let mut point = [0.0, 0.0];
            for (p, w) in pillars.iter().zip(weights) {
                point = add_scaled(point, w, self.ends[*p][end]);
            }
            [point[0], point[1], self.z[end]]
        })
    }

    /// The pillars of columns one of whose corners, at top or bottom, spans a parallelogram of less
    /// than this area.
    fn narrow_pillars(&self, least: f64) -> Vec<usize> {
        let mut narrow = Vec::new();
        for column in 0..self.columns[0] * self.columns[1] {
            let [a, b, c, d] = self.column_pillars(column);
            let bad = (0..2).any(|end| {
                let ring = [a, b, d, c].map(|p| self.ends[p][end]);
                (0..4).any(|k| {
                    let [before, at, after] = [k + 3, k, k + 1].map(|k| ring[k % 4]);
                    signed_area(sub(after, at), sub(before, at)) < least
                })
            });
            if bad {
                narrow.extend([a, b, c, d]);
            }
        }
        narrow.sort_unstable();
        narrow.dedup();
        narrow
    }

    /// How far the middle of a pillar is to be moved, and how it is to lean, for steep features.
    fn pillar_adjustment(
        &self,
        pillar: usize,
        at: Point2,
        steep: &[SteepFace],
        spacing: Point2,
        lengths: [f64; 3],
    ) -> [Point2; 2] {
        let row = self.columns[0] + 1;
        let index = [pillar % row, pillar / row];
        let middle = 0.5 * (self.z[0] + self.z[1]);
        let near = spacing[0] * spacing[1];
        // As the features round it do, the nearer the more.
        let (mut slope, mut weight) = ([0.0; 2], 0.0);
        for face in steep {
            let off = sub(add_scaled(face.point, middle - face.z, face.slope), at);
            let w = face.area / (dot(off, off) + near).powi(2);
            slope = add_scaled(slope, w, face.slope);
            weight += w;
        }
        slope = slope.map(|s| s / weight);
        // Less towards the sides, which are upright.
        let mut along = [0, 1].map(|k| {
            let other = self.axes[1 - k];
            signed_area(slope, other) / signed_area(self.axes[k], other)
        });
        for k in 0..2 {
            let off = index[k].min(self.columns[k] - index[k]) as f64 * spacing[k];
            let room = 0.75 * along[k].abs() * lengths[2];
            along[k] *= if off < room { off / room } else { 1.0 };
        }
        let slope = add_scaled(self.axes[0].map(|a| a * along[0]), along[1], self.axes[1]);
        // Onto the feature, if it is the nearest pillar of its row: a line through where faces are.
        let mut sums = [[0.0; 5]; 2];
        for face in steep {
            let off = sub(face.point, add_scaled(at, face.z - middle, slope));
            let reach = [0, 1].map(|k| dot(face.normal, self.axes[k]) * spacing[k]);
            let k = usize::from(reach[1].abs() > reach[0].abs());
            let share = dot(face.normal, off) / reach[k];
            let aside = dot(off, self.axes[1 - k]).abs();
            if share.abs() <= 1.0 && aside < spacing[1 - k].max(face.area.sqrt()) {
                let z = face.z - middle;
                let add = [1.0, z, z * z, share, share * z];
                (0..5).for_each(|i| sums[k][i] += face.area * add[i]);
            }
        }
        let k = usize::from(sums[1][0] > sums[0][0]);
        let [w, z, zz, s, sz] = sums[k];
        if w == 0.0 || index[k] == 0 || index[k] == self.columns[k] {
            return [[0.0; 2], slope];
        }
        let spread = zz / w - (z / w).powi(2);
        let lean = if spread > (lengths[2] / 6.0).powi(2) {
            (sz / w - s * z / (w * w)) / spread
        } else {
            0.0
        };
        let share = s / w - lean * z / w;
        if share.abs() > 0.5 {
            return [[0.0; 2], slope];
        }
        [
            self.axes[k].map(|a| a * share * spacing[k]),
            add_scaled(slope, lean * spacing[k], self.axes[k]),
        ]
    }
}
