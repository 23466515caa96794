//! Writes grids of heights as text.

use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

use super::super::extension;
use super::{CPS3_NULL, IRAP_NULL, surfer};
use crate::error::{Error, Result, cause};
use crate::files::atomic_write;
use crate::geometry::{dot, norm, sub, unit};
use crate::image::{Geometry, Image};

/// File endings of grids of heights.
pub(crate) const GRID_EXTENSIONS: [&str; 5] = ["irap", "zmap", "cps3", "grd", "asc"];

/// Null values of formats whose headers name one, the preferred first. Readers of ZMAP+ compare in
/// single precision, which cannot represent 1e30 exactly.
const ZMAP_NULLS: &[&str] = &["-99999.0", "-999999.0", "1.0E+30"];
const CPS3_NULLS: &[&str] = &[CPS3_NULL, "-1.0E+30"];
const ESRI_NULLS: &[&str] = &["-9999", "-99999", "-3.4028235e+38"];

/// Numbers per line in written files.
const NUMBERS_PER_LINE: usize = 5;

/// Largest angle in radians between an axis of an image and that of the grid that is written. Axes of
/// surveys are known to the rounding of coordinates in trace headers.
const MAX_ANGLE: f64 = 1e-4;

/// Movement of a node, in units of the smaller step, that is rounding.
const ROUNDING: f64 = 1e-6;

/// Movement of a node, in units of the smaller step, that users should know.
const NOTABLE_MOVE: f64 = 1e-3;

/// The formats of grids that can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GridFormat {
    /// IRAP classic.
    Irap,
    /// ZMAP+.
    Zmap,
    /// CPS-3.
    Cps3,
    /// A text grid of Surfer.
    Surfer,
    /// ESRI ASCII.
    Esri,
}

impl GridFormat {
    /// Returns the format of a file ending.
    pub fn from_extension(extension: &str) -> Option<Self> {
        let index = GRID_EXTENSIONS
            .iter()
            .position(|known| *known == extension)?;
        let formats = [Self::Irap, Self::Zmap, Self::Cps3, Self::Surfer, Self::Esri];
        Some(formats[index])
    }

    fn name(self) -> &'static str {
        match self {
            Self::Irap => "IRAP classic",
            Self::Zmap => "ZMAP+",
            Self::Cps3 => "CPS-3",
            Self::Surfer => "Surfer",
            Self::Esri => "ESRI ASCII",
        }
    }

    /// Returns `true` if grids may have any direction in the map.
    fn can_rotate(self) -> bool {
        self == Self::Irap
    }

    /// Returns the text of an unknown height, which no height of the image has.
    fn null_text(self, samples: &[f32]) -> &'static str {
        let candidates = match self {
            Self::Irap => return IRAP_NULL,
            Self::Surfer => return surfer::NULL_TEXT,
            Self::Zmap => ZMAP_NULLS,
            Self::Cps3 => CPS3_NULLS,
            Self::Esri => ESRI_NULLS,
        };
        let is_free = |text: &&&str| {
            let null = text.parse::<f32>().unwrap_or(f32::NAN);
            !samples
                .iter()
                .any(|z| (z - null).abs() <= 1e-6 * null.abs())
        };
        candidates.iter().find(is_free).unwrap_or(&candidates[0])
    }
}

/// A grid of heights as its file describes it, and where its nodes are in the image.
#[derive(Debug, Clone, PartialEq)]
struct GridLayout {
    /// Number of columns and rows.
    dims: [usize; 2],
    /// Position of the first node of the first row.
    origin: [f64; 2],
    /// Distance between columns, and between rows.
    step: [f64; 2],
    /// Direction of the rows: a unit vector.
    direction: [f64; 2],
    /// Index in the image of the first node of the first row.
    start: usize,
    /// Difference of indices in the image from a column to the next, and from a row to the next.
    strides: [isize; 2],
    /// Largest distance of a node from its place in the image.
    displacement: f64,
}

impl GridLayout {
    /// Returns the grid of an image. Its columns and rows are those of the image, in an order and
    /// direction that the format supports.
    ///
    /// # Errors
    /// Returns the problem and the remedy if no grid of the format has the nodes of the image.
    fn new(
        dims: [usize; 2],
        geometry: &Geometry<2>,
        format: GridFormat,
    ) -> std::result::Result<Self, (String, &'static str)> {
        let mut axes = geometry.axes;
        let mut dims = dims;
        let mut strides = [1, dims[0] as isize];
        if !format.can_rotate() && axes[0][0].abs() < axes[0][1].abs() {
            axes.swap(0, 1);
            dims.swap(0, 1);
            strides.swap(0, 1);
        }
        let is_left_handed = axes[0][0] * axes[1][1] < axes[0][1] * axes[1][0];
        let is_flipped = if format.can_rotate() {
            [
                is_left_handed && axes[0][0] < 0.0,
                is_left_handed && axes[0][0] >= 0.0,
            ]
        } else {
            [axes[0][0] < 0.0, axes[1][1] < 0.0]
        };
        let (mut start, mut origin) = (0, geometry.origin);
        for k in 0..2 {
            if is_flipped[k] {
                let last = dims[k] - 1;
                start += last * strides[k].unsigned_abs();
                strides[k] = -strides[k];
                origin = [0, 1].map(|c| origin[c] + last as f64 * axes[k][c]);
                axes[k] = axes[k].map(|c| -c);
            }
        }
        let directions = [unit(axes[0]), unit([axes[1][1], -axes[1][0]])];
        let angle = |a: [f64; 2], b: [f64; 2]| (a[0] * b[1] - a[1] * b[0]).abs();
        let is_perpendicular = angle(directions[0], directions[1]) <= MAX_ANGLE
            && dot(directions[0], directions[1]) > 0.0;
        let direction = if !format.can_rotate() {
            [1.0, 0.0]
        } else if directions[0] == directions[1] {
            directions[0]
        } else {
            unit([0, 1].map(|c| directions[0][c] + directions[1][c]))
        };
        if !is_perpendicular {
            let problem = "its axes are not perpendicular, as those of a grid must be";
            return Err((problem.into(), "write it as .vti or .npy"));
        }
        if directions
            .iter()
            .any(|axis| angle(*axis, direction) > MAX_ANGLE)
        {
            let rotation = directions[0][1].atan2(directions[0][0]).to_degrees();
            let problem = format!(
                "{} grids cannot be rotated, but this image is rotated by {rotation:.2} degrees",
                format.name()
            );
            return Err((problem, "write it as .irap, or a horizon as points (.xyz)"));
        }
        let mut layout = Self {
            dims,
            origin,
            step: axes.map(norm),
            direction,
            start,
            strides,
            displacement: 0.0,
        };
        layout.fit(origin, axes);
        Ok(layout)
    }

    /// Places the grid so that its nodes lie as near as possible to those at `origin` and along `axes`.
    fn fit(&mut self, origin: [f64; 2], axes: [[f64; 2]; 2]) {
        let last = self.dims.map(|n| (n - 1) as f64);
        let place = |origin: [f64; 2], axes: [[f64; 2]; 2], [i, j]: [f64; 2]| {
            [0, 1].map(|c| origin[c] + i * axes[0][c] + j * axes[1][c])
        };
        let [u, v] = self.direction;
        let fitted = [
            [u, v].map(|c| c * self.step[0]),
            [-v, u].map(|c| c * self.step[1]),
        ];
        let corners = [[0.0, 0.0], [last[0], 0.0], [0.0, last[1]], last];
        let distance = |start: [f64; 2]| {
            let moved = |index| norm(sub(place(start, fitted, index), place(origin, axes, index)));
            corners.into_iter().map(moved).fold(0.0, f64::max)
        };
        if distance(origin) > ROUNDING * self.step[0].min(self.step[1]) {
            let half = last.map(|n| 0.5 * n);
            let middle = place(origin, axes, half);
            self.origin = place(middle, fitted, half.map(|n| -n));
        }
        self.displacement = distance(self.origin);
    }

    /// Returns the position of the last node along x and y, as if the grid was not rotated.
    fn last(&self) -> [f64; 2] {
        [0, 1].map(|k| self.origin[k] + (self.dims[k] - 1) as f64 * self.step[k])
    }

    /// Returns the index in the image of a node.
    fn index(&self, [column, row]: [usize; 2]) -> usize {
        let [dx, dy] = self.strides;
        self.start
            .wrapping_add_signed(column as isize * dx + row as isize * dy)
    }
}

/// Returns a note if the nodes of the grid at `path` do not lie exactly where those of the image do.
pub(crate) fn displacement_note<const D: usize>(
    path: &Path,
    dims: [usize; D],
    geometry: &Geometry<D>,
) -> Option<String> {
    let format = GridFormat::from_extension(&extension(path))?;
    let layout = GridLayout::new([dims[0], dims[1]], &in_map(geometry), format).ok()?;
    let step = layout.step[0].min(layout.step[1]);
    (layout.displacement > NOTABLE_MOVE * step).then(|| {
        format!(
            "{}: the axes are not exactly perpendicular, or not along x and y as {} needs it: nodes are moved by up to {:.3}{}{}",
            path.display(),
            format.name(),
            layout.displacement,
            if geometry.units[0].is_empty() { "" } else { " " },
            geometry.units[0],
        )
    })
}

/// Returns the first two axes of a geometry, and their first two coordinates.
fn in_map<const D: usize>(geometry: &Geometry<D>) -> Geometry<2> {
    Geometry {
        origin: [0, 1].map(|c| geometry.origin[c]),
        axes: [0, 1].map(|k| [0, 1].map(|c| geometry.axes[k][c])),
        ..Geometry::default()
    }
}

/// Writes heights as a grid.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be written, or if grids of the format cannot have
/// the geometry of the image.
pub fn write<const D: usize>(path: &Path, image: &Image<D>, format: GridFormat) -> Result<()> {
    let dims = [0, 1].map(|k| image.dims()[k]);
    let layout = GridLayout::new(dims, &in_map(&image.geometry), format)
        .map_err(|(problem, remedy)| Error::Io(cause(path.display(), problem, remedy)))?;
    let samples = image.as_slice();
    let null_text = format.null_text(samples);
    let header = header(&layout, format, null_text, image);
    let [nx, ny] = layout.dims;
    let line = if matches!(format, GridFormat::Zmap | GridFormat::Cps3) {
        ny
    } else {
        nx
    };
    atomic_write(path, |out| {
        out.write_all(header.as_bytes())?;
        for i in 0..nx * ny {
            let node = match format {
                GridFormat::Irap | GridFormat::Surfer => [i % nx, i / nx],
                GridFormat::Esri => [i % nx, ny - 1 - i / nx],
                GridFormat::Zmap | GridFormat::Cps3 => [i / ny, ny - 1 - i % ny],
            };
            // A row of an ESRI grid is one line.
            let is_full = format != GridFormat::Esri && (i % line + 1) % NUMBERS_PER_LINE == 0;
            let separator = if is_full || i % line + 1 == line {
                "\n"
            } else {
                " "
            };
            match samples[layout.index(node)] {
                z if z.is_finite() => write!(out, "{z}{separator}")?,
                _ => write!(out, "{null_text}{separator}")?,
            }
        }
        Ok(())
    })
}

/// Returns the header of a grid.
fn header<const D: usize>(
    layout: &GridLayout,
    format: GridFormat,
    null_text: &str,
    image: &Image<D>,
) -> String {
    let ([nx, ny], [dx, dy], [x0, y0], [x1, y1]) =
        (layout.dims, layout.step, layout.origin, layout.last());
    let stats = image.stats();
    let range = [stats.min, stats.max].map(|z| if z.is_finite() { z } else { 0.0 });
    match format {
        GridFormat::Irap => {
            let [u, v] = layout.direction;
            let rotation = v.atan2(u).to_degrees();
            format!(
                "-996 {ny} {dx} {dy}\n{x0} {x1} {y0} {y1}\n{nx} {rotation} {x0} {y0}\n0 0 0 0 0 0 0\n"
            )
        }
        GridFormat::Zmap => format!(
            "! written by atomesh\n@GRID HEADER, GRID, {NUMBERS_PER_LINE}\n20, {null_text}, , 4, 1\n\
             {ny}, {nx}, {x0}, {x1}, {y0}, {y1}\n0.0, 0.0, 0.0\n@\n"
        ),
        GridFormat::Cps3 => {
            format!(
                "FSASCI 0 1 \"Computed\" 0 {null_text}\nFSATTR 0 0\n\
                 FSLIMI {x0} {x1} {y0} {y1} {} {}\nFSNROW {ny} {nx}\nFSXINC {dx} {dy}\n",
                range[0], range[1]
            )
        }
        GridFormat::Surfer => {
            format!(
                "DSAA\n{nx} {ny}\n{x0} {x1}\n{y0} {y1}\n{} {}\n",
                range[0], range[1]
            )
        }
        GridFormat::Esri => {
            let mut header = format!(
                "ncols {nx}\nnrows {ny}\nxllcorner {}\nyllcorner {}\n",
                x0 - 0.5 * dx,
                y0 - 0.5 * dy
            );
            // Few programs other than GDAL read cells that are not square.
            let sizes = if (dx - dy).abs() * nx.max(ny) as f64 <= 1e-4 * dx.min(dy) {
                format!("cellsize {dx}\n")
            } else {
                format!("dx {dx}\ndy {dy}\n")
            };
            // Writing to a String cannot fail.
            let _ = writeln!(header, "{sizes}NODATA_value {null_text}");
            header
        }
    }
}
