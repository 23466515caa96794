//! The nominal distance round an edit, as the mesh knows it at its nodes: what it was made from may
//! depend on the whole image.

use crate::image::ScalarField;
use crate::lattice::distance::Distance;
use crate::mesh::Simplices;

/// Samples of d per d: it is smooth.
const SAMPLES_PER_DISTANCE: f64 = 3.0;

/// d(x) in the box `[0, extent]` of a part of a mesh, from d at its nodes: linear within each cell,
/// the nearest cell's beyond.
pub fn distance_from_nodes<const D: usize>(
    part: &impl Simplices<D>,
    d: &[f64],
    extent: [f64; D],
) -> Distance<D> {
    let least = d.iter().copied().fold(f64::INFINITY, f64::min);
    let most = d.iter().copied().fold(0.0, f64::max);
    if most <= least * (1.0 + 1e-6) {
        return Distance::Constant(least);
    }
    let dims = extent.map(|e| (e * SAMPLES_PER_DISTANCE / least).ceil().max(1.0) as usize + 1);
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

/// Writes the samples inside cell `c`.
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
            let at = corner(i)[k] / field.step[k];
            low[k] = low[k].min(at.floor().max(0.0) as usize);
            high[k] = high[k].max((at.ceil() as usize).min(field.dims[k] - 1));
        }
    }
    // Weights of the corners but the first, by Cramer's rule on the edges from it.
    let edges: [[f64; D]; D] =
        std::array::from_fn(|i| std::array::from_fn(|k| corner(i + 1)[k] - corner(0)[k]));
    let whole = determinant(edges);
    let span: [usize; D] = std::array::from_fn(|k| (high[k] + 1).saturating_sub(low[k]));
    for number in 0..span.iter().product() {
        let (mut rest, mut index, mut stride): (usize, usize, usize) = (number, 0, 1);
        let mut from_first = [0.0; D];
        for k in 0..D {
            let i = low[k] + rest % span[k];
            rest /= span[k];
            index += i * stride;
            stride *= field.dims[k];
            from_first[k] = i as f64 * field.step[k] - corner(0)[k];
        }
        let weight = |i: usize| {
            let mut edges = edges;
            edges[i] = from_first;
            determinant(edges) / whole
        };
        let weights: [f64; D] = std::array::from_fn(weight);
        let first = 1.0 - weights.iter().sum::<f64>();
        if first >= -1e-9 && weights.iter().all(|w| *w >= -1e-9) {
            let value = |i: usize| d[cell[i] as usize];
            let rest: f64 = (0..D).map(|i| weights[i] * value(i + 1)).sum();
            field.samples[index] = (first * value(0) + rest) as f32;
        }
    }
}

/// Of a 2 x 2 or 3 x 3 matrix.
fn determinant<const D: usize>(m: [[f64; D]; D]) -> f64 {
    match D {
        2 => m[0][0] * m[1][1] - m[0][1] * m[1][0],
        _ => {
            let row = |i: usize| [m[i][0], m[i][1], m[i][2]];
            crate::geometry::dot(row(0), crate::geometry::cross(row(1), row(2)))
        }
    }
}

/// Gives samples that have no value that of a neighbour, axis after axis, there and back.
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
    fn linear_in_cells_and_constant_where_it_is() {
        let nodes: Vec<[f64; 2]> = vec![[2.0, 2.0], [14.0, 2.0], [14.0, 12.0], [2.0, 12.0]];
        let mesh = TriMesh {
            nodes: nodes.clone(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let linear = |x: [f64; 2]| 3.0 + 0.2 * x[0] - 0.1 * x[1];
        let d: Vec<f64> = nodes.iter().map(|&x| linear(x)).collect();
        let found = distance_from_nodes(&mesh, &d, [16.0, 15.0]);
        for x in [[4.0, 4.0], [9.0, 5.5], [13.0, 11.0], [3.0, 10.0]] {
            assert!((found.value_at(x) - linear(x)).abs() < 1e-5, "{x:?}");
        }
        assert!(found.value_at([0.0, 0.0]).is_finite() && found.value_at([16.0, 15.0]) > 0.0);
        assert_eq!(
            distance_from_nodes(&mesh, &[3.0; 4], [16.0, 15.0]),
            Distance::Constant(3.0)
        );
    }

    #[test]
    fn in_space_too() {
        let nodes = vec![[1.0; 3], [9.0, 1.0, 1.0], [1.0, 9.0, 1.0], [1.0, 1.0, 9.0]];
        let mesh = TetMesh {
            nodes: nodes.clone(),
            tets: vec![[0, 1, 2, 3]],
        };
        let linear = |x: [f64; 3]| 2.0 + 0.1 * x[0] + 0.2 * x[1] - 0.05 * x[2];
        let d: Vec<f64> = nodes.iter().map(|&x| linear(x)).collect();
        let found = distance_from_nodes(&mesh, &d, [10.0; 3]);
        let x = [3.0, 3.0, 3.0];
        assert!((found.value_at(x) - linear(x)).abs() < 1e-5);
    }
}
