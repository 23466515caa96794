//! Pillars of a corner-point grid: straight lines from the top of a model to its bottom, over a
//! parallelogram in map view. Near steep features, pillars have the dip of the features and lie on
//! them.
//!
//! Pillars are made vertical again where features are too flat or too close to each other. So no
//! column is turned inside out.

use crate::parallel::prelude::*;

use crate::error::cause;
use crate::geometry::simd::dispatch_simd;
use crate::geometry::{add_scaled, dot, hypot, sorted_distinct, sub};
use crate::mesh::graph::{Connection, Graph};
use crate::{Error, Result};

type Point2 = [f64; 2];

/// Normals with a larger z component are too flat for a pillar. The value means 60 degrees of dip.
const MAX_PILLAR_NORMAL_Z: f64 = 0.5;
/// Minimum area of a column in a horizontal section, relative to its area without features.
const MIN_COLUMN_AREA_RATIO: f64 = 0.25;
/// Number of pillars that are compared with the steep faces at a time, in vector registers.
const BLOCK_SIZE: usize = 8;

/// Pillars of a grid, ordered along i first.
#[derive(Debug, Clone, PartialEq)]
pub struct Pillars {
    /// Number of columns along i and j. There is one more pillar along each.
    pub columns: [usize; 2],
    /// z of the tops and of the bottoms.
    pub z: [f64; 2],
    /// Top and bottom of each pillar in map view.
    pub ends: Vec<[Point2; 2]>,
    /// Unit vectors along i and j.
    pub axes: [Point2; 2],
}

/// Outline of a model in map view: a parallelogram between four vertical sides.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// Corner at which i and j begin.
    origin: Point2,
    /// Vectors from the origin to the next corner along i and along j.
    pub edges: [Point2; 2],
    /// Largest and smallest z.
    pub z: [f64; 2],
}

/// Returns the area of the parallelogram of two vectors. It is positive if the second vector is to
/// the left of the first.
fn signed_area([a, b]: Point2, [c, d]: Point2) -> f64 {
    a * d - b * c
}

impl Outline {
    /// Finds the outline from the sides of the box of the mesh. `place` begins error messages.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if the mesh does not have four vertical sides.
    pub fn new(graph: &Graph<3>, nodes: &[[f64; 3]], place: &str) -> Result<Self> {
        // Area vector, area-weighted centre and area of each side.
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
                "mesh an image with one vertical axis, and say which way is down (--down)",
            )));
        };
        // Line of a side in map view: normal and distance.
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
        // In map view, the turn from i to j is to the left, as simulators expect.
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

    /// Returns the lengths along i, j and z.
    pub fn lengths(&self) -> [f64; 3] {
        let [i, j] = self.edges.map(|e| dot(e, e).sqrt());
        [i, j, self.z[0] - self.z[1]]
    }
}

/// Steep face on a feature.
struct SteepFace {
    point: Point2,
    /// z, relative to the middle of the grid.
    z: f64,
    /// Unit normal in map view.
    normal: Point2,
    slope: Point2,
    area: f64,
    /// Place in map view at which the plane of the face, continued along the slope, has the z of the
    /// middle.
    middle: Point2,
    /// The axis that is more nearly along the normal.
    axis: usize,
    /// Spacing of the pillars along that axis, measured along the normal.
    reach: f64,
    /// Distance across that axis within which a pillar may lie in the face.
    width: f64,
}

/// Returns `true` if a pillar can lie in a face with this normal.
pub fn is_steep(normal: [f64; 3]) -> bool {
    normal[2].abs() < MAX_PILLAR_NORMAL_Z
}

impl SteepFace {
    /// Creates the face of a connection, for pillars at this spacing along the axes.
    fn new(c: &Connection<3>, middle_z: f64, axes: [Point2; 2], spacing: Point2) -> Option<Self> {
        let [x, y, z] = c.normal;
        let horizontal = hypot(x, y);
        (c.on_feature && is_steep(c.normal)).then(|| {
            let normal = [x / horizontal, y / horizontal];
            let slope = normal.map(|n| -n * z / horizontal);
            let point = [c.point[0], c.point[1]];
            let reach = [0, 1].map(|k| dot(normal, axes[k]) * spacing[k]);
            let axis = usize::from(reach[1].abs() > reach[0].abs());
            Self {
                point,
                z: c.point[2] - middle_z,
                normal,
                slope,
                area: c.area,
                middle: add_scaled(point, middle_z - c.point[2], slope),
                axis,
                reach: reach[axis],
                width: spacing[1 - axis].max(c.area.sqrt()),
            }
        })
    }
}

impl Pillars {
    /// Creates pillars for the given number of columns along i and j.
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
            let fractions = [
                (p % (n + 1)) as f64 / n as f64,
                (p / (n + 1)) as f64 / m as f64,
            ];
            add_scaled(
                add_scaled(outline.origin, fractions[0], outline.edges[0]),
                fractions[1],
                outline.edges[1],
            )
        };
        let count = (n + 1) * (m + 1);
        let middle: Vec<Point2> = (0..count).map(upright).collect();
        let spacing = [lengths[0] / n as f64, lengths[1] / m as f64];
        let middle_z = 0.5 * (outline.z[0] + outline.z[1]);
        let steep: Vec<SteepFace> = (graph.connections.iter())
            .filter_map(|c| SteepFace::new(c, middle_z, axes, spacing))
            .collect();
        let adjustments = |block: usize| {
            pillars.adjustments(block * BLOCK_SIZE, &middle, &steep, spacing, lengths)
        };
        // Shift of the centre of each pillar, and its slope.
        let mut moves: Vec<[Point2; 2]> = if steep.is_empty() {
            vec![[[0.0; 2]; 2]; count]
        } else {
            let blocks = (0..count.div_ceil(BLOCK_SIZE)).into_par_iter();
            blocks.flat_map_iter(adjustments).collect()
        };
        let half_height = 0.5 * (outline.z[0] - outline.z[1]);
        let ends = |moves: &[[Point2; 2]]| -> Vec<[Point2; 2]> {
            let pillar_ends = |(p, [shift, slope]): (&Point2, &[Point2; 2])| {
                [half_height, -half_height]
                    .map(|z| add_scaled(add_scaled(*p, 1.0, *shift), z, *slope))
            };
            middle.iter().zip(moves).map(pillar_ends).collect()
        };
        pillars.ends = ends(&moves);
        let column_area = signed_area(outline.edges[0], outline.edges[1]) / (n * m) as f64;
        // If a column becomes too narrow, the shifts and slopes of its pillars are halved until it
        // is wide enough.
        loop {
            let narrow = pillars.narrow_pillars(MIN_COLUMN_AREA_RATIO * column_area);
            if narrow.is_empty() {
                return pillars;
            }
            for p in narrow {
                let halve = |v: f64| {
                    if v.abs() < 1e-3 * half_height {
                        0.0
                    } else {
                        0.5 * v
                    }
                };
                moves[p] = [
                    moves[p][0].map(halve),
                    moves[p][1].map(|v| halve(v * half_height) / half_height),
                ];
            }
            pillars.ends = ends(&moves);
        }
    }

    /// Returns the four pillars of a column: (0, 0), (1, 0), (0, 1), (1, 1) along (i, j).
    pub fn column_pillars(&self, column: usize) -> [usize; 4] {
        let (i, j) = (column % self.columns[0], column / self.columns[0]);
        let row = self.columns[0] + 1;
        let first = j * row + i;
        [first, first + 1, first + row, first + row + 1]
    }

    /// Returns the top and the bottom of the line through a column at the fractions (u, v) along i
    /// and j.
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

    /// Returns the pillars of all narrow columns. In such a column, the parallelogram at one of the
    /// corners, at top or bottom, has less than `min_area`.
    fn narrow_pillars(&self, min_area: f64) -> Vec<usize> {
        let mut narrow = Vec::new();
        for column in 0..self.columns[0] * self.columns[1] {
            let [a, b, c, d] = self.column_pillars(column);
            let is_narrow = (0..2).any(|end| {
                let ring = [a, b, d, c].map(|p| self.ends[p][end]);
                (0..4).any(|k| {
                    let [previous, corner, next] = [k + 3, k, k + 1].map(|k| ring[k % 4]);
                    signed_area(sub(next, corner), sub(previous, corner)) < min_area
                })
            });
            if is_narrow {
                narrow.extend([a, b, c, d]);
            }
        }
        sorted_distinct(narrow)
    }

    /// Returns the shift of the centre of each pillar of a block that begins at `first`, and its
    /// slope, for the steep features around it.
    fn adjustments(
        &self,
        first: usize,
        positions: &[Point2],
        steep: &[SteepFace],
        spacing: Point2,
        lengths: [f64; 3],
    ) -> Vec<[Point2; 2]> {
        let row = self.columns[0] + 1;
        let softening = spacing[0] * spacing[1];
        let count = BLOCK_SIZE.min(positions.len() - first);
        let mut x = [[0.0; BLOCK_SIZE]; 2];
        for i in 0..BLOCK_SIZE {
            let position = positions[first + i.min(count - 1)];
            (0..2).for_each(|k| x[k][i] = position[k]);
        }
        // The slope is the mean slope of all steep faces, with weights that decrease with distance.
        let (mut slopes, mut weights) = ([[0.0; BLOCK_SIZE]; 2], [0.0; BLOCK_SIZE]);
        dispatch_simd(
            #[inline(always)]
            || {
                for face in steep {
                    for i in 0..BLOCK_SIZE {
                        let offset = [face.middle[0] - x[0][i], face.middle[1] - x[1][i]];
                        let square = offset[0] * offset[0] + offset[1] * offset[1] + softening;
                        let w = face.area / (square * square);
                        slopes[0][i] += w * face.slope[0];
                        slopes[1][i] += w * face.slope[1];
                        weights[i] += w;
                    }
                }
            },
        );
        for i in 0..BLOCK_SIZE {
            let pillar = first + i.min(count - 1);
            let slope = [0, 1].map(|k| slopes[k][i] / weights[i]);
            let slope = self.slope_inside([pillar % row, pillar / row], slope, spacing, lengths[2]);
            (0..2).for_each(|k| slopes[k][i] = slope[k]);
        }
        let sums = self.line_sums(x, slopes, steep);
        let adjustment = |i: usize| {
            let slope = [slopes[0][i], slopes[1][i]];
            let index = [(first + i) % row, (first + i) / row];
            self.fitted_line(index, slope, &sums[i], spacing, lengths[2])
        };
        (0..count).map(adjustment).collect()
    }

    /// Returns the slope of a pillar, reduced towards the sides of the grid, which are vertical.
    fn slope_inside(
        &self,
        index: [usize; 2],
        slope: Point2,
        spacing: Point2,
        height: f64,
    ) -> Point2 {
        let mut components = [0, 1].map(|k| {
            let other = self.axes[1 - k];
            signed_area(slope, other) / signed_area(self.axes[k], other)
        });
        for k in 0..2 {
            let distance = index[k].min(self.columns[k] - index[k]) as f64 * spacing[k];
            let required = 0.75 * components[k].abs() * height;
            components[k] *= if distance < required {
                distance / required
            } else {
                1.0
            };
        }
        add_scaled(
            self.axes[0].map(|a| a * components[0]),
            components[1],
            self.axes[1],
        )
    }

    /// Returns the sums by which a line is fitted to the faces near each pillar of a block, along
    /// each axis. A face is near if the pillar is the nearest of its row, or the next.
    fn line_sums(
        &self,
        x: [[f64; BLOCK_SIZE]; 2],
        slopes: [[f64; BLOCK_SIZE]; 2],
        steep: &[SteepFace],
    ) -> [[[f64; 5]; 2]; BLOCK_SIZE] {
        let mut sums = [[[0.0; 5]; 2]; BLOCK_SIZE];
        dispatch_simd(
            #[inline(always)]
            || {
                let mut fractions = [0.0; BLOCK_SIZE];
                let mut is_near = [false; BLOCK_SIZE];
                for face in steep {
                    let across = self.axes[1 - face.axis];
                    for i in 0..BLOCK_SIZE {
                        let offset: Point2 = std::array::from_fn(|k| {
                            face.point[k] - (x[k][i] + face.z * slopes[k][i])
                        });
                        let fraction = dot(face.normal, offset) / face.reach;
                        fractions[i] = fraction;
                        is_near[i] =
                            (fraction.abs() <= 1.0) & (dot(offset, across).abs() < face.width);
                    }
                    if is_near == [false; BLOCK_SIZE] {
                        continue;
                    }
                    let z = face.z;
                    for i in (0..BLOCK_SIZE).filter(|&i| is_near[i]) {
                        let terms = [1.0, z, z * z, fractions[i], fractions[i] * z];
                        (0..5).for_each(|t| sums[i][face.axis][t] += face.area * terms[t]);
                    }
                }
            },
        );
        sums
    }

    /// Returns the shift of a pillar onto the feature nearest to it, and its slope there: of the line
    /// that [`line_sums`](Self::line_sums) fit.
    fn fitted_line(
        &self,
        index: [usize; 2],
        slope: Point2,
        sums: &[[f64; 5]; 2],
        spacing: Point2,
        height: f64,
    ) -> [Point2; 2] {
        let k = usize::from(sums[1][0] > sums[0][0]);
        let [w, z, zz, s, sz] = sums[k];
        if w == 0.0 || index[k] == 0 || index[k] == self.columns[k] {
            return [[0.0; 2], slope];
        }
        let variance = zz / w - (z / w).powi(2);
        let lean = if variance > (height / 6.0).powi(2) {
            (sz / w - s * z / (w * w)) / variance
        } else {
            0.0
        };
        let fraction = s / w - lean * z / w;
        if fraction.abs() > 0.5 {
            return [[0.0; 2], slope];
        }
        [
            self.axes[k].map(|a| a * fraction * spacing[k]),
            add_scaled(slope, lean * spacing[k], self.axes[k]),
        ]
    }
}
