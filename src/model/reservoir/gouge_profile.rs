//! The clay of the two walls of a fault as a function of depth, and the clay that slipped past a point.
//!
//! Each face of the fault is divided into pieces that are small beside the faces. A piece belongs to a
//! bin along strike and depth, and gives it the clay of the two cells, or that of an image beside the piece.
//! Sums over depth then give the mean clay of any interval of a wall.

use super::averaging::ImageProbe;
use crate::geometry::{add_scaled, dot, norm};

/// Number of bins over the height of a mean face.
const BINS_PER_FACE: f64 = 16.0;
/// Largest number of times that the edges of a triangle are halved.
const MAX_HALVINGS: u32 = 6;
/// Largest number of bins of a fault.
const MAX_BINS: f64 = 4e6;

/// A small part of a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FacePiece {
    /// Centre in metres, with z upwards.
    pub centre: [f64; 3],
    pub area: f64,
}

/// A face of a fault with its two walls.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FaultFace {
    pub connection: usize,
    /// Horizontal unit vector along strike, or zero.
    pub strike: [f64; 2],
    pub area: f64,
    /// Corners in metres, with z upwards.
    pub corners: Vec<[f64; 3]>,
    /// Clay fraction of the hanging wall and of the footwall.
    pub clay: [f64; 2],
    /// Direction into the hanging wall, along beds that lie flat, over which the distance from the face grows by
    /// 1 m.
    pub across: [f64; 3],
}

/// Distance from a face, in samples, at which an image has the rock of a wall: the nearest sample is on the same side.
const WALL_DISTANCE: f64 = 1.25;

impl FaultFace {
    /// Returns the clay fraction of both walls beside a point of the face as an image has it, and that of a cell
    /// where the image has no data.
    pub fn clay_in(&self, image: &ImageProbe, x: [f64; 3]) -> [f64; 2] {
        let step = WALL_DISTANCE * image.sample_length(x, self.across);
        std::array::from_fn(|wall| {
            let sign = [1.0, -1.0][wall];
            let value = image.value(add_scaled(x, sign * step, self.across));
            value.map_or(self.clay[wall], |clay| clay.clamp(0.0, 1.0))
        })
    }

    /// Returns the height of the face.
    fn height(&self) -> f64 {
        let z = self.corners.iter().map(|corner| corner[2]);
        let high = z.clone().fold(f64::NEG_INFINITY, f64::max);
        high - z.fold(f64::INFINITY, f64::min)
    }

    /// Returns parts of the face that are at most `height` high.
    pub fn pieces(&self, height: f64) -> Vec<FacePiece> {
        let count = self.corners.len() as f64;
        let middle: [f64; 3] =
            std::array::from_fn(|k| self.corners.iter().map(|c| c[k]).sum::<f64>() / count);
        let mut pieces = Vec::new();
        for i in 0..self.corners.len() {
            let next = self.corners[(i + 1) % self.corners.len()];
            divide(
                [middle, self.corners[i], next],
                height,
                MAX_HALVINGS,
                &mut pieces,
            );
        }
        // Faces may be bent, and columns use the area of a projection.
        let total: f64 = pieces.iter().map(|piece| piece.area).sum();
        let factor = self.area / total.max(f64::MIN_POSITIVE);
        pieces.iter_mut().for_each(|piece| piece.area *= factor);
        pieces
    }
}

fn divide(t: [[f64; 3]; 3], height: f64, halvings: u32, pieces: &mut Vec<FacePiece>) {
    let z = t.map(|corner| corner[2]);
    let high = z.into_iter().fold(f64::NEG_INFINITY, f64::max);
    let low = z.into_iter().fold(f64::INFINITY, f64::min);
    if high - low <= height || halvings == 0 {
        let area = 0.5 * norm(crate::geometry::normal(&t));
        let centre = std::array::from_fn(|k| (t[0][k] + t[1][k] + t[2][k]) / 3.0);
        pieces.push(FacePiece { centre, area });
        return;
    }
    let middle =
        |a: usize, b: usize| -> [f64; 3] { std::array::from_fn(|k| 0.5 * (t[a][k] + t[b][k])) };
    let [p, q, r] = [middle(0, 1), middle(1, 2), middle(2, 0)];
    for part in [[t[0], p, r], [p, t[1], q], [r, q, t[2]], [p, q, r]] {
        divide(part, height, halvings - 1, pieces);
    }
}

/// A bed of clay in a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ClayBed {
    depths: [f64; 2],
    clay: f64,
}

/// Smallest clay fraction of a bed that is smeared along a fault.
pub(super) const MIN_BED_CLAY: f64 = 0.4;

/// The clay of the walls of a fault.
pub(super) struct ClayProfile {
    /// Mean direction of strike.
    along: [f64; 2],
    low: [f64; 2],
    width: f64,
    /// Height of the bins.
    pub height: f64,
    counts: [usize; 2],
    /// Beds of clay of each bin along strike, for hanging wall and footwall.
    beds: [Vec<Vec<ClayBed>>; 2],
    /// For each bin along strike, sums over depth for hanging wall and footwall: heights with data, and these
    /// times clay.
    sums: [Vec<[f64; 2]>; 2],
}

impl ClayProfile {
    /// Returns the profile of the walls of a fault. An image of the clay resolves more than the cells do.
    pub fn new(faces: &[FaultFace], image: Option<&ImageProbe>) -> Self {
        let mut along = [0.0; 2];
        for face in faces {
            let sign = face.area * dot(face.strike, faces[0].strike).signum();
            (0..2).for_each(|k| along[k] += sign * face.strike[k]);
        }
        let length = norm(along);
        along = if length > 0.0 {
            along.map(|c| c / length)
        } else {
            [1.0, 0.0]
        };
        let area: f64 = faces.iter().map(|face| face.area).sum();
        let mean_height: f64 = faces
            .iter()
            .map(|face| face.area * face.height())
            .sum::<f64>()
            / area;
        let place = |x: [f64; 3]| [dot([x[0], x[1]], along), -x[2]];
        let corners = faces.iter().flat_map(|face| &face.corners);
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in corners.map(|corner| place(*corner)) {
            for k in 0..2 {
                (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
            }
        }
        let mut width = 2.0 * (area / faces.len() as f64).sqrt();
        let mut height = (mean_height / BINS_PER_FACE).max(f64::MIN_POSITIVE);
        let extent: [f64; 2] = std::array::from_fn(|k| high[k] - low[k]);
        let bins = (extent[0] / width + 1.0) * (extent[1] / height + 1.0);
        if bins > MAX_BINS {
            let factor = (bins / MAX_BINS).sqrt();
            (width, height) = (width * factor, height * factor);
        }
        let counts = [extent[0] / width, extent[1] / height].map(|n| n as usize + 1);
        let mut weights = [
            vec![[0.0; 2]; counts[0] * counts[1]],
            vec![[0.0; 2]; counts[0] * counts[1]],
        ];
        for face in faces {
            for piece in face.pieces(0.5 * height) {
                let [s, z] = place(piece.centre);
                let i = (((s - low[0]) / width) as usize).min(counts[0] - 1);
                let j = (((z - low[1]) / height) as usize).min(counts[1] - 1);
                let clay = image.map_or(face.clay, |image| face.clay_in(image, piece.centre));
                for (weights, clay) in weights.iter_mut().zip(clay) {
                    let [sum, clays] = &mut weights[i * counts[1] + j];
                    *sum += piece.area;
                    *clays += piece.area * clay;
                }
            }
        }
        let beds = weights.each_ref().map(|weights| {
            let columns = weights.chunks_exact(counts[1]);
            columns
                .map(|column| clay_beds(column, low[1], height))
                .collect()
        });
        let sums = weights.map(|weights| {
            let mut sums = Vec::with_capacity(counts[0] * (counts[1] + 1));
            for column in weights.chunks_exact(counts[1]) {
                let mut sum = [0.0; 2];
                sums.push(sum);
                for [weight, clay] in column {
                    if *weight > 0.0 {
                        sum = [sum[0] + height, sum[1] + height * clay / weight];
                    }
                    sums.push(sum);
                }
            }
            sums
        });
        Self {
            along,
            low,
            width,
            height,
            counts,
            beds,
            sums,
        }
    }

    /// Returns the height with data and the integral of clay over an interval of depths of a wall.
    fn integral(&self, wall: usize, column: usize, [top, bottom]: [f64; 2]) -> [f64; 2] {
        let rows = self.counts[1];
        let sums = &self.sums[wall][column * (rows + 1)..(column + 1) * (rows + 1)];
        let at = |depth: f64| -> [f64; 2] {
            let position = ((depth - self.low[1]) / self.height).clamp(0.0, rows as f64);
            let row = (position as usize).min(rows - 1);
            let fraction = position - row as f64;
            std::array::from_fn(|k| sums[row][k] + fraction * (sums[row + 1][k] - sums[row][k]))
        };
        let (a, b) = (at(top), at(bottom));
        [b[0] - a[0], b[1] - a[1]]
    }

    fn column(&self, x: [f64; 3]) -> usize {
        let s = dot([x[0], x[1]], self.along);
        (((s - self.low[0]) / self.width).max(0.0) as usize).min(self.counts[0] - 1)
    }

    /// Returns the shale-gouge ratio at a point after this throw; `None` if no wall has data there.
    pub fn gouge_ratio(&self, x: [f64; 3], throw: f64) -> Option<f64> {
        let (depth, column) = (-x[2], self.column(x));
        // Depths of the rock that slipped past, on the hanging wall and on the footwall.
        let intervals = [[depth, depth + throw], [depth - throw, depth]];
        let (mut height, mut clay) = (0.0, 0.0);
        for (wall, [a, b]) in intervals.into_iter().enumerate() {
            let [h, c] = self.integral(wall, column, [a.min(b), a.max(b)]);
            height += h;
            clay += c;
        }
        (height > 1e-6 * throw.abs()).then(|| clay / height)
    }

    /// Returns the clay fraction of a bed that is smeared past a point: one that slipped past it, and
    /// is thicker than the throw over `factor` (Lindsay and others 1993).
    pub fn smear(&self, x: [f64; 3], throw: f64, factor: f64) -> Option<f64> {
        let (depth, column) = (-x[2], self.column(x));
        let intervals = [[depth, depth + throw], [depth - throw, depth]];
        let mut smear: Option<f64> = None;
        for (beds, [a, b]) in self.beds.iter().zip(intervals) {
            let [top, bottom] = [a.min(b), a.max(b)];
            for bed in &beds[column] {
                let passes = bed.depths[0] < bottom && bed.depths[1] > top;
                let is_continuous = throw.abs() < factor * (bed.depths[1] - bed.depths[0]);
                if passes && is_continuous && smear.is_none_or(|clay| clay < bed.clay) {
                    smear = Some(bed.clay);
                }
            }
        }
        smear
    }
}

/// Returns the beds of clay in bins along depth, each with its weight and its weighted clay.
fn clay_beds(column: &[[f64; 2]], top: f64, height: f64) -> Vec<ClayBed> {
    let is_clay = |[weight, clay]: &[f64; 2]| *weight > 0.0 && *clay >= MIN_BED_CLAY * weight;
    let mut beds = Vec::new();
    let mut row = 0;
    for run in column.chunk_by(|a, b| is_clay(a) == is_clay(b)) {
        if is_clay(&run[0]) {
            let sums = run.iter().fold([0.0; 2], |s, b| [s[0] + b[0], s[1] + b[1]]);
            beds.push(ClayBed {
                depths: [row, row + run.len()].map(|row| top + height * row as f64),
                clay: sums[1] / sums[0],
            });
        }
        row += run.len();
    }
    beds
}
