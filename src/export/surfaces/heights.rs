//! Samples a surface on a grid of heights, for programs that store horizons as grids.

use std::io::Write;
use std::path::Path;

use super::SurfaceFile;
use super::survey_grid::SurveyGrid;
use crate::error::{Error, Result, cause};
use crate::files::atomic_write;
use crate::geometry::{norm, sorted_distinct, sub};
use crate::image::{Geometry, Image};
use crate::model::columns::horizon::{Horizon, TriangleIndex};

/// Maximum number of nodes of a grid.
const MAX_NODES: f64 = 1e8;

/// Returns the heights of a surface at the bins of a survey, NaN outside the surface.
pub fn bin_heights(file: &SurfaceFile<3>, surface: usize, survey: &SurveyGrid) -> Image<2> {
    let horizon = Horizon::Surface(TriangleIndex::new(triangles_of(file, surface)));
    Image::from_fn(survey.dims, survey.geometry.clone(), |x| {
        horizon.z_at(x).unwrap_or(f64::NAN)
    })
}

/// Writes the heights at the bins of a survey as points, a line for each: inline, crossline, x, y, z.
/// Survey and heights must have line numbers. Without a survey, the points are the nodes of the
/// surface: x, y, z.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be written.
pub fn write_points(
    path: &Path,
    file: &SurfaceFile<3>,
    surface: usize,
    survey: Option<&SurveyGrid>,
) -> Result<()> {
    let Some(survey) = survey else {
        let corners = file.surface_facets(surface).as_flattened();
        let nodes = sorted_distinct(corners.iter().copied());
        return atomic_write(path, |out| {
            writeln!(out, "# x y z")?;
            for [x, y, z] in nodes.iter().map(|&n| file.nodes[n as usize]) {
                writeln!(out, "{x} {y} {z}")?;
            }
            Ok(())
        });
    };
    let horizon = Horizon::Surface(TriangleIndex::new(triangles_of(file, surface)));
    atomic_write(path, |out| {
        writeln!(out, "# inline crossline x y z")?;
        for j in 0..survey.dims[1] {
            for i in 0..survey.dims[0] {
                let position @ [x, y] = survey.geometry.to_physical([i as f64, j as f64]);
                let lines = survey.lines_at(position);
                if let (Some([inline, crossline]), Some(z)) = (lines, horizon.z_at(position)) {
                    writeln!(out, "{inline} {crossline} {x:.3} {y:.3} {z:.3}")?;
                }
            }
        }
        Ok(())
    })
}

/// Returns the triangles of a surface.
fn triangles_of(file: &SurfaceFile<3>, surface: usize) -> Vec<[[f64; 3]; 3]> {
    let facets = file.surface_facets(surface).iter();
    facets
        .map(|facet| facet.map(|n| file.nodes[n as usize]))
        .collect()
}

/// Returns the heights of a surface on a grid along x and y. Grid nodes are at integer multiples of
/// `step`, which is about the length of the surface's edges if `None`. Heights are NaN outside the
/// surface.
///
/// # Errors
/// Returns [`Error::Job`] if the step is not positive or makes too many nodes.
pub fn height_grid(file: &SurfaceFile<3>, surface: usize, step: Option<f64>) -> Result<Image<2>> {
    let triangles = triangles_of(file, surface);
    let horizontal = |[x, y, _]: [f64; 3]| [x, y];
    let edges = triangles
        .iter()
        .map(|&[a, b, _]| norm(sub(horizontal(b), horizontal(a))));
    let mean = edges.sum::<f64>() / triangles.len().max(1) as f64;
    let step = step.unwrap_or(mean);
    let refuse = |problem: String| {
        let place = format!("{} at a step of {step}", file.names[surface]);
        Err(Error::Job(cause(place, problem, "give another step")))
    };
    if !(step.is_finite() && step > 0.0) {
        return refuse("is not a grid, which needs a positive step".into());
    }
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in triangles.as_flattened() {
        low = [0, 1].map(|k| low[k].min(p[k]));
        high = [0, 1].map(|k| high[k].max(p[k]));
    }
    // The nodes inside, at least one per axis.
    let first = low.map(|low| (low / step).ceil());
    let counts = [0, 1].map(|k| ((high[k] / step).floor() - first[k] + 1.0).max(1.0));
    let [columns, rows] = counts;
    if columns * rows > MAX_NODES {
        return refuse(format!("makes {columns} x {rows} nodes"));
    }
    let dims = counts.map(|count| count as usize);
    let geometry = Geometry::with_spacing(first.map(|first| first * step), [step; 2]);
    let horizon = Horizon::Surface(TriangleIndex::new(triangles));
    Ok(Image::from_fn(dims, geometry, |x| {
        horizon.z_at(x).unwrap_or(f64::NAN)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_sampled_exactly_inside_its_triangles() {
        let height = |x: f64, y: f64| 100.0 + 0.5 * x - 0.25 * y;
        let node = |x: f64, y: f64| [x, y, height(x, y)];
        let nodes = [node(-1.0, 0.0), node(21.0, 0.0), node(21.0, 13.0)];
        let file = SurfaceFile::new(&nodes, &[[0, 1, 2]], &[0, 1], "horizon");
        let image = height_grid(&file, 0, Some(4.0)).unwrap();
        assert_eq!((image.dims(), image.geometry.origin), ([6, 4], [0.0, 0.0]));
        for (i, &z) in image.as_slice().iter().enumerate() {
            let (x, y) = (4.0 * (i % 6) as f64, 4.0 * (i / 6) as f64);
            let inside = y <= 13.0 / 22.0 * (x + 1.0);
            assert_eq!(z.is_finite(), inside, "({x}, {y})");
            assert!(!inside || (f64::from(z) - height(x, y)).abs() < 1e-5);
        }
        // The default step is about the length of the edges.
        assert_eq!(
            height_grid(&file, 0, None).unwrap().geometry.axes[0][0],
            22.0
        );
        for wrong in [0.0, f64::NAN, 1e-6] {
            assert!(height_grid(&file, 0, Some(wrong)).is_err());
        }
    }
}
