//! The nominal distance around an edit, interpolated from the nodes of the mesh. It is not computed
//! again from its definition, because that may depend on the whole image.

use crate::geometry::grid_index::{index_at, offset_of};
use crate::image::ScalarField;
use crate::lattice::distance::Distance;
use crate::mesh::Simplices;

/// Number of samples of the field d(x) per smallest d. Few are enough because d(x) is smooth.
const SAMPLES_PER_DISTANCE: f64 = 3.0;

/// Returns d(x) in the box `[0, extent]` of a part of a mesh, from the values `d` at its nodes. It
/// is linear within each cell; outside the cells it takes the value of a nearby cell.
pub fn distance_from_nodes<const D: usize>(
    part: &impl Simplices<D>,
    d: &[f64],
    extent: [f64; D],
) -> Distance<D> {
    let min = d.iter().copied().fold(f64::INFINITY, f64::min);
    let max = d.iter().copied().fold(0.0, f64::max);
    if max <= min * (1.0 + 1e-6) {
        return Distance::Constant(min);
    }
    let dims = extent.map(|e| (e * SAMPLES_PER_DISTANCE / min).ceil().max(1.0) as usize + 1);
    let step: [f64; D] = std::array::from_fn(|k| extent[k] / (dims[k] - 1) as f64);
    let mut field = ScalarField {
        dims,
        step,
        samples: vec![f32::NAN; dims.iter().product()],
    };
    for c in 0..part.len() {
        fill_cell(&mut field, part, c, d);
    }
    fill_gaps(&mut field);
    Distance::Field(field)
}

/// Interpolates the samples inside cell `c`.
fn fill_cell<const D: usize>(
    field: &mut ScalarField<D>,
    part: &impl Simplices<D>,
    c: usize,
    d: &[f64],
) {
    let cell = part.cell(c);
    let corner = |i: usize| part.nodes()[cell[i] as usize];
    let (mut low, mut high) = (field.dims, [0usize; D]);
    for i in 0..=D {
        for k in 0..D {
            let coordinate = corner(i)[k] / field.step[k];
            low[k] = low[k].min(coordinate.floor().max(0.0) as usize);
            high[k] = high[k].max((coordinate.ceil() as usize).min(field.dims[k] - 1));
        }
    }
    // Barycentric weights of all corners but the first, by Cramer's rule on the edges from the
    // first.
    let edges: [[f64; D]; D] =
        std::array::from_fn(|i| std::array::from_fn(|k| corner(i + 1)[k] - corner(0)[k]));
    let volume = determinant(edges);
    let span: [usize; D] = std::array::from_fn(|k| (high[k] + 1).saturating_sub(low[k]));
    for number in 0..span.iter().product() {
        let in_block = index_at(span, number);
        let index: [usize; D] = std::array::from_fn(|k| low[k] + in_block[k]);
        let offset: [f64; D] =
            std::array::from_fn(|k| index[k] as f64 * field.step[k] - corner(0)[k]);
        let weight = |i: usize| {
            let mut edges = edges;
            edges[i] = offset;
            determinant(edges) / volume
        };
        let weights: [f64; D] = std::array::from_fn(weight);
        let first = 1.0 - weights.iter().sum::<f64>();
        if first >= -1e-9 && weights.iter().all(|w| *w >= -1e-9) {
            let value = |i: usize| d[cell[i] as usize];
            let others: f64 = (0..D).map(|i| weights[i] * value(i + 1)).sum();
            field.samples[offset_of(field.dims, index)] = (first * value(0) + others) as f32;
        }
    }
}

/// Returns the determinant of a 2 x 2 or 3 x 3 matrix.
fn determinant<const D: usize>(m: [[f64; D]; D]) -> f64 {
    match D {
        2 => m[0][0] * m[1][1] - m[0][1] * m[1][0],
        _ => {
            let row = |i: usize| [m[i][0], m[i][1], m[i][2]];
            crate::geometry::dot(row(0), crate::geometry::cross(row(1), row(2)))
        }
    }
}

/// Copies values of neighbours to samples without a value, along one axis after another, forwards
/// and backwards.
fn fill_gaps<const D: usize>(field: &mut ScalarField<D>) {
    let mut stride = 1;
    for k in 0..D {
        let n = field.dims[k];
        let count = field.samples.len();
        let on_line = move |i: usize| (i / stride) % n;
        for i in 0..count {
            if on_line(i) > 0 && field.samples[i].is_nan() {
                field.samples[i] = field.samples[i - stride];
            }
        }
        for i in (0..count).rev() {
            if on_line(i) + 1 < n && field.samples[i].is_nan() {
                field.samples[i] = field.samples[i + stride];
            }
        }
        stride *= n;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{TetMesh, TriMesh};

    #[test]
    fn interpolates_linearly_in_cells_and_detects_constants() {
        let nodes: Vec<[f64; 2]> = vec![[2.0, 2.0], [14.0, 2.0], [14.0, 12.0], [2.0, 12.0]];
        let mesh = TriMesh {
            nodes: nodes.clone(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let linear = |x: [f64; 2]| 3.0 + 0.2 * x[0] - 0.1 * x[1];
        let d: Vec<f64> = nodes.iter().map(|&x| linear(x)).collect();
        let distance = distance_from_nodes(&mesh, &d, [16.0, 15.0]);
        for x in [[4.0, 4.0], [9.0, 5.5], [13.0, 11.0], [3.0, 10.0]] {
            assert!((distance.value_at(x) - linear(x)).abs() < 1e-5, "{x:?}");
        }
        assert!(distance.value_at([0.0, 0.0]).is_finite() && distance.value_at([16.0, 15.0]) > 0.0);
        assert_eq!(
            distance_from_nodes(&mesh, &[3.0; 4], [16.0, 15.0]),
            Distance::Constant(3.0)
        );
    }

    #[test]
    fn interpolates_linearly_in_tetrahedra() {
        let nodes = vec![[1.0; 3], [9.0, 1.0, 1.0], [1.0, 9.0, 1.0], [1.0, 1.0, 9.0]];
        let mesh = TetMesh {
            nodes: nodes.clone(),
            tets: vec![[0, 1, 2, 3]],
        };
        let linear = |x: [f64; 3]| 2.0 + 0.1 * x[0] + 0.2 * x[1] - 0.05 * x[2];
        let d: Vec<f64> = nodes.iter().map(|&x| linear(x)).collect();
        let distance = distance_from_nodes(&mesh, &d, [10.0; 3]);
        let x = [3.0, 3.0, 3.0];
        assert!((distance.value_at(x) - linear(x)).abs() < 1e-5);
    }
}
