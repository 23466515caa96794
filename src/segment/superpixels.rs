//! Mean values of an image over the cells of a mesh: superpixels, or supervoxels.

use std::any::Any;
use std::borrow::Cow;

use crate::Result;
use crate::image::Image;
use crate::mesh::poly::PolyMesh;
use crate::reservoir::sample::{Mean, Places, sample};

/// The mean over each cell of a mesh in lattice space, `step` apart samples: by supersampling, as
/// [`sample`] says, exact for linear functions. A polygon is a prism for this. `place` names the image
/// in errors.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) names a cell whose mean is not a number.
pub fn means<const D: usize>(
    mesh: &PolyMesh<D>,
    image: &Image<D>,
    step: [f64; D],
    place: &str,
) -> Result<Vec<f32>> {
    let image = image.in_space();
    let index_of = |p: [f64; 3]| std::array::from_fn(|k| p[k] / step.get(k).unwrap_or(&1.0));
    let mesh = in_space(mesh);
    let places = Places::new(&mesh, image.dims(), index_of);
    let means = sample(&mesh, &places, &image, Mean::Arithmetic, place)?;
    Ok(means.into_iter().map(|mean| mean as f32).collect())
}

/// A mesh of the plane as a layer of thickness 1.
fn in_space<const D: usize>(mesh: &PolyMesh<D>) -> Cow<'_, PolyMesh<3>> {
    let mesh = mesh as &dyn Any;
    match (mesh.downcast_ref(), mesh.downcast_ref::<PolyMesh<2>>()) {
        (Some(space), _) => Cow::Borrowed(space),
        (None, plane) => Cow::Owned(plane.map(|m| m.extruded(1.0)).unwrap_or_default()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;
    use crate::mesh::TriMesh;
    use crate::mesh::poly::samples::two_cells;

    /// The image of a function over the box of `two_cells`, so many samples a unit.
    fn image<const D: usize>(n: usize, f: impl Fn([f64; D]) -> f64) -> Image<D> {
        let dims: [usize; D] = std::array::from_fn(|k| if k == 0 { 2 * n + 1 } else { n + 1 });
        let samples = (0..dims.iter().product()).map(|mut i| {
            let index = dims.map(|m| {
                let c = i % m;
                i /= m;
                c as f64
            });
            f(index) as f32
        });
        Image::new(dims, samples.collect(), Geometry::default())
    }

    #[test]
    fn means_over_polyhedra_and_polygons_are_exact_for_linear_images() {
        let space = means(
            &two_cells::<3>(0.75),
            &image::<3>(20, |[x, y, z]| x - 3.0 * y + z),
            [0.05; 3],
            "image",
        );
        let plane = means(
            &two_cells::<2>(0.75),
            &image::<2>(20, |[x, y]| x - 3.0 * y),
            [0.05; 2],
            "image",
        );
        for (found, off) in [(space.unwrap(), -20.0), (plane.unwrap(), -30.0)] {
            for (mean, x) in found.iter().zip([7.5, 27.5]) {
                assert!((mean - (x + off)).abs() < 1e-3, "{mean} {x} {off}");
            }
        }
    }

    #[test]
    fn means_over_triangles_of_a_parabola() {
        let mesh = TriMesh {
            nodes: vec![[0.0, 0.0], [20.0, 0.0], [0.0, 20.0], [20.0, 20.0]],
            triangles: vec![[0, 1, 2], [1, 3, 2]],
        };
        let cells = PolyMesh::from_simplices(&mesh, &[], &[]).unwrap();
        let found = means(&cells, &image::<2>(20, |[x, _]| x * x), [1.0; 2], "image").unwrap();
        // The mean of x^2 over each: 20^2 / 6 and 20^2 / 2.
        for (mean, exact) in found.iter().zip([400.0 / 6.0, 200.0]) {
            assert!((mean - exact).abs() < 0.02 * exact, "{mean} {exact}");
        }
    }
}
