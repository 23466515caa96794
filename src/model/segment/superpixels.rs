//! Mean values of an image over the cells of a mesh: superpixels, or supervoxels.

use super::raster::cells_of_samples;
use crate::image::Image;
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;
use crate::model::surface::adjacency::CellAdjacency;

/// The cells of a mesh as parts of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Superpixels {
    /// The mean of the samples in each cell; of a cell that holds none, the sample nearest to its
    /// centre.
    pub means: Vec<f32>,
    /// The cell that each sample (x fastest) lies in, of several the first; `NONE` outside all.
    pub cell_of_sample: Vec<u32>,
}

impl Superpixels {
    /// Of a mesh in lattice space, samples being `step` apart; `cells` are its own, and `across`
    /// those of [`Mesh::cells_of_faces`].
    pub fn new<const D: usize, F: Mesh<D>>(
        mesh: &F,
        cells: &CellAdjacency<D>,
        across: &[[u32; 2]],
        image: &Image<D>,
        step: [f64; D],
    ) -> Self {
        let (dims, samples) = (image.dims(), image.as_slice());
        let cell_of_sample = cells_of_samples(mesh, across, dims, step);
        // In order, so that the sums are the same with any number of threads.
        let mut sums = vec![(0.0f64, 0u32); cells.len()];
        for (&cell, &value) in cell_of_sample.iter().zip(samples) {
            if cell != NONE {
                let (sum, count) = &mut sums[cell as usize];
                *sum += f64::from(value);
                *count += 1;
            }
        }
        let nearest = |centre: &[f64; D]| {
            let at = |at, k: usize| {
                let index = (centre[k] / step[k]).round();
                at * dims[k] + index.clamp(0.0, (dims[k] - 1) as f64) as usize
            };
            samples[(0..D).rev().fold(0, at)]
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

    /// For each sample the label of its cell, 0 outside all.
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

    /// The image of a function of the index.
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
        let across = mesh.cells_of_faces().unwrap();
        let cells = CellAdjacency::new(mesh, &across, &[]);
        Superpixels::new(mesh, &cells, &across, image, step)
    }

    #[test]
    fn means_of_boxes_are_those_of_their_samples() {
        // Cut at sample 15 of 41, which the first cell takes.
        let plane = image([41, 21], |[x, y]| x - 3.0 * y);
        let found = superpixels(&two_cells::<2>(0.75), &plane, [0.05; 2]);
        assert_eq!(found.means, [7.5 - 30.0, 28.0 - 30.0]);
        let space = image([41, 21, 21], |[x, y, z]| x - 3.0 * y + z);
        let found = superpixels(&two_cells::<3>(0.75), &space, [0.05; 3]);
        assert_eq!(found.means, [7.5 - 20.0, 28.0 - 20.0]);
        let labels = found.sample_labels(&[1, 0]);
        assert_eq!(
            labels.iter().map(|&l| u32::from(l)).sum::<u32>(),
            16 * 21 * 21
        );
    }

    #[test]
    fn means_of_tetrahedra_agree_with_exact_volumes() {
        // A cube of six tetrahedra round its diagonal, 40 samples a side.
        let mesh = kuhn_box([1; 3], 40.0);
        let image = image([41; 3], |[x, y, z]| x * x + 20.0 * y - z * y);
        let found = superpixels(&mesh, &image, [1.0; 3]);
        let cells = PolyMesh::from_simplices(&mesh, &[], &[]).unwrap();
        let places = SamplePositions::new(&cells, image.dims(), |p| p);
        let exact = average_cells(&cells, &places, &image, MeanKind::Arithmetic, "image").unwrap();
        // Samples on faces belong to one cell alone: a few percent of the range of 1600.
        for (mean, exact) in found.means.iter().zip(exact) {
            assert!((f64::from(*mean) - exact).abs() < 40.0, "{mean} {exact}");
        }
    }

    #[test]
    fn a_cell_without_a_sample_takes_the_nearest() {
        let mesh = TriMesh {
            nodes: vec![[0.1, 0.1], [0.4, 0.2], [0.2, 0.4], [3.0, 3.0]],
            triangles: vec![[0, 1, 2], [1, 3, 2]],
        };
        let found = superpixels(&mesh, &image([4, 4], |[x, y]| 5.0 + x + 10.0 * y), [1.0; 2]);
        assert_eq!(found.means[0], 5.0);
        assert!(found.means[1] > 15.0);
    }
}
