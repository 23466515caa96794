//! Mean values of an image over the cells of a mesh: superpixels in 2-D, supervoxels in 3-D.

use super::raster::cells_of_samples;
use crate::image::Image;
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;
use crate::model::surface::adjacency::CellAdjacency;

/// The cells of a mesh as parts of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Superpixels {
    /// Mean of the samples in each cell. A cell without samples takes the sample nearest to its
    /// centre.
    pub means: Vec<f32>,
    /// For each sample (x fastest), the cell that contains it; the first of several, and `NONE`
    /// outside all cells.
    pub cell_of_sample: Vec<u32>,
}

impl Superpixels {
    /// Computes the means over the cells of a mesh in lattice space, for samples that are `step`
    /// apart. `cells` is the adjacency of the mesh, and `face_cells` the result of
    /// [`Mesh::cells_of_faces`].
    pub fn new<const D: usize, F: Mesh<D>>(
        mesh: &F,
        cells: &CellAdjacency<D>,
        face_cells: &[[u32; 2]],
        image: &Image<D>,
        step: [f64; D],
    ) -> Self {
        let (dims, samples) = (image.dims(), image.as_slice());
        let cell_of_sample = cells_of_samples(mesh, face_cells, dims, step);
        // The order is fixed, so that the sums are the same with any number of threads.
        let mut sums = vec![(0.0f64, 0u32); cells.len()];
        for (&cell, &value) in cell_of_sample.iter().zip(samples) {
            if cell != NONE {
                let (sum, count) = &mut sums[cell as usize];
                *sum += f64::from(value);
                *count += 1;
            }
        }
        let nearest = |centre: &[f64; D]| {
            let flat_index = |offset, k: usize| {
                let index = (centre[k] / step[k]).round();
                offset * dims[k] + index.clamp(0.0, (dims[k] - 1) as f64) as usize
            };
            samples[(0..D).rev().fold(0, flat_index)]
        };
        let means = sums.iter().zip(&cells.centres);
        Self {
            means: means
                .map(|(&(sum, count), centre)| match count {
                    0 => nearest(centre),
                    _ => (sum / f64::from(count)) as f32,
                })
                .collect(),
            cell_of_sample,
        }
    }

    /// Returns the label of each sample's cell, or 0 for samples outside all cells.
    pub fn sample_labels(&self, labels: &[u8]) -> Vec<u8> {
        let label = |&cell: &u32| labels.get(cell as usize).copied().unwrap_or(0);
        self.cell_of_sample.iter().map(label).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;
    use crate::mesh::TriMesh;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::poly::PolyMesh;
    use crate::mesh::poly::samples::two_cells;
    use crate::model::reservoir::averaging::{MeanKind, SamplePositions, average_cells};

    /// Returns the image of a function of the sample index.
    fn image<const D: usize>(dims: [usize; D], f: impl Fn([f64; D]) -> f64) -> Image<D> {
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

    fn superpixels<const D: usize, F: Mesh<D>>(
        mesh: &F,
        image: &Image<D>,
        step: [f64; D],
    ) -> Superpixels {
        let face_cells = mesh.cells_of_faces().unwrap();
        let cells = CellAdjacency::new(mesh, &face_cells, &[]);
        Superpixels::new(mesh, &cells, &face_cells, image, step)
    }

    #[test]
    fn means_of_boxes_are_those_of_their_samples() {
        // The division is at sample 15 of 41, which belongs to the first cell.
        let plane = image([41, 21], |[x, y]| x - 3.0 * y);
        let result = superpixels(&two_cells::<2>(0.75), &plane, [0.05; 2]);
        assert_eq!(result.means, [7.5 - 30.0, 28.0 - 30.0]);
        let space = image([41, 21, 21], |[x, y, z]| x - 3.0 * y + z);
        let result = superpixels(&two_cells::<3>(0.75), &space, [0.05; 3]);
        assert_eq!(result.means, [7.5 - 20.0, 28.0 - 20.0]);
        let labels = result.sample_labels(&[1, 0]);
        assert_eq!(
            labels.iter().map(|&l| u32::from(l)).sum::<u32>(),
            16 * 21 * 21
        );
    }

    #[test]
    fn means_of_tetrahedra_agree_with_exact_volumes() {
        // A cube of six tetrahedra around its diagonal, with 40 samples per side.
        let mesh = kuhn_box([1; 3], 40.0);
        let image = image([41; 3], |[x, y, z]| x * x + 20.0 * y - z * y);
        let result = superpixels(&mesh, &image, [1.0; 3]);
        let cells = PolyMesh::from_simplices(&mesh, &[], &[]).unwrap();
        let positions = SamplePositions::new(&cells, image.dims(), |p| p);
        let exact = average_cells(&cells, &positions, &image, MeanKind::Arithmetic, "image")
            .unwrap()
            .values;
        // Samples on faces belong to only one cell, which changes means by a few percent of the
        // range of 1600.
        for (mean, exact) in result.means.iter().zip(exact) {
            assert!((f64::from(*mean) - exact).abs() < 40.0, "{mean} {exact}");
        }
    }

    #[test]
    fn a_cell_without_a_sample_takes_the_nearest() {
        let mesh = TriMesh {
            nodes: vec![[0.1, 0.1], [0.4, 0.2], [0.2, 0.4], [3.0, 3.0]],
            triangles: vec![[0, 1, 2], [1, 3, 2]],
        };
        let result = superpixels(&mesh, &image([4, 4], |[x, y]| 5.0 + x + 10.0 * y), [1.0; 2]);
        assert_eq!(result.means[0], 5.0);
        assert!(result.means[1] > 15.0);
    }
}
