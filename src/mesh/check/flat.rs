//! Checks faces of more than three nodes: that they are flat, and that their outlines are simple
//! polygons.

use crate::geometry::dot;
use crate::mesh::poly::PolyMesh;

/// Returns the largest distance from a face's plane that welding can cause: two nodes, each moved
/// by the fraction `weld` of its distance to the site.
pub fn weld_offset<const D: usize>(mesh: &PolyMesh<D>, f: usize, weld: f64) -> f64 {
    let site = mesh.sites[mesh.face_cells[f][0] as usize];
    let distance2 = |&n: &u32| -> f64 {
        let node = mesh.nodes[n as usize];
        (0..D).map(|k| (node[k] - site[k]).powi(2)).sum()
    };
    2.0 * weld
        * mesh
            .faces
            .get(f)
            .iter()
            .map(distance2)
            .fold(0.0, f64::max)
            .sqrt()
}

/// Smallest ratio of a face's area to its length times its width. Below it the area has cancelled:
/// the face's outline crosses itself like a figure of eight, and no plane is the face's own.
const CANCELLATION_RATIO: f64 = 1e-9;

/// Returns the largest distance of a face's nodes from a plane: the plane normal to the area vector
/// or, if that is nearer, a plane through the face's longest axis. (The normal of a face that is as
/// narrow as the rounding error has no meaning.) For a face whose area cancels the result is the
/// face's width.
pub fn warp<const D: usize>(mesh: &PolyMesh<D>, f: usize) -> f64 {
    let shape = mesh.face_shape(f);
    let area = shape.area();
    let nodes = mesh.faces.get(f).iter();
    let offsets = nodes.map(|&n| -> [f64; D] {
        std::array::from_fn(|k| mesh.nodes[n as usize][k] - shape.apex[k])
    });
    let norm2 = |x: &[f64; D]| dot(*x, *x);
    let longest = offsets
        .clone()
        .max_by(|x, y| norm2(x).total_cmp(&norm2(y)))
        .unwrap_or([0.0; D]);
    // A face whose nodes all coincide is flat.
    if norm2(&longest) == 0.0 {
        return 0.0;
    }
    let (mut max_height, mut max_width) = (0.0f64, 0.0f64);
    for x in offsets {
        let along = dot(x, longest) / norm2(&longest);
        let across: [f64; D] = std::array::from_fn(|k| x[k] - along * longest[k]);
        max_height = max_height.max((dot(x, shape.area_vector) / area).abs());
        max_width = max_width.max(norm2(&across).sqrt());
    }
    // This covers an area of 0, for which the height is not a number.
    if area <= CANCELLATION_RATIO * norm2(&longest).sqrt() * max_width {
        return max_width;
    }
    max_height.min(max_width)
}

/// Returns the width of the part of a face that its outline cuts off where it crosses itself, like
/// a figure of eight. Of the two parts the smaller counts, and its width is its area over the
/// face's length. The result is 0 for a simple polygon, and for a face without area, which has no
/// plane.
///
/// Where rounding makes the edges of a narrow face cross, the result is not larger than the face's
/// width.
pub fn self_crossing_width<const D: usize>(mesh: &PolyMesh<D>, f: usize) -> f64 {
    let ring = mesh.faces.get(f);
    let count = ring.len();
    let shape = mesh.face_shape(f);
    let area = shape.area();
    if D != 3 || count < 4 || area == 0.0 {
        return 0.0;
    }
    // The face is projected along the axis that is nearest to its normal.
    let by_component = |&i: &usize, &j: &usize| {
        let [i, j] = [i, j].map(|k| shape.area_vector[k].abs());
        i.total_cmp(&j)
    };
    let axis = (0..3).max_by(by_component).unwrap_or(0);
    let projected: Vec<[f64; 2]> = ring
        .iter()
        .map(|&n| {
            [1, 2].map(|k| mesh.nodes[n as usize][(axis + k) % 3] - shape.apex[(axis + k) % 3])
        })
        .collect();
    let foreshortening = shape.area_vector[axis].abs() / area;
    let turn = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let at = |i: usize| projected[i % count];
    let total: f64 = (1..count - 1).map(|i| turn(at(0), at(i), at(i + 1))).sum();
    let mut max_part = 0.0f64;
    for i in 0..count {
        for j in i + 2..count.min(count - 1 + i) {
            let ([a, b], [c, d]) = ([at(i), at(i + 1)], [at(j), at(j + 1)]);
            let (side_a, side_b) = (turn(c, d, a), turn(c, d, b));
            // A node exactly on the other edge counts as being on its left.
            let crosses_line = (side_a >= 0.0) != (side_b >= 0.0);
            if !crosses_line || (turn(a, b, c) >= 0.0) == (turn(a, b, d) >= 0.0) {
                continue;
            }
            let fraction = side_a / (side_a - side_b);
            let crossing = [0, 1].map(|k| a[k] + fraction * (b[k] - a[k]));
            let part: f64 = (i + 1..j).map(|k| turn(crossing, at(k), at(k + 1))).sum();
            max_part = max_part.max(part.abs().min((total - part).abs()));
        }
    }
    let longest = ring.iter().map(|&n| {
        let offset: [f64; D] = std::array::from_fn(|k| mesh.nodes[n as usize][k] - shape.apex[k]);
        dot(offset, offset)
    });
    // `max_part` is twice an area, and `longest` reaches from the face's middle, so it is half of
    // the length: together a factor of 1/4.
    0.25 * max_part / foreshortening / longest.fold(0.0, f64::max).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrow_faces_are_as_flat_as_they_are_narrow() {
        // A face of length 1 and width 1e-11, oblique: its area vector is mostly rounding error.
        let along = [0.48, 0.6, 0.64];
        let across = [0.8e-11, -0.64e-11, 0.0];
        let point = |u: f64, v: f64| std::array::from_fn(|k| 0.3 + u * along[k] + v * across[k]);
        let mut mesh = PolyMesh::<3> {
            nodes: vec![
                point(0.0, 0.0),
                point(1.0, 0.2),
                point(0.7, 1.0),
                point(0.2, 0.9),
            ],
            ..PolyMesh::default()
        };
        mesh.faces.push([0, 1, 2, 3]);
        assert!(warp(&mesh, 0) < 2e-11, "{}", warp(&mesh, 0));
        // Now the face is as wide as it is long, and the distance from its plane counts.
        mesh.nodes[2][2] += 0.5;
        mesh.nodes[3][0] -= 0.3;
        assert!(warp(&mesh, 0) > 0.01);
    }

    #[test]
    fn a_figure_of_eight_is_not_flat() {
        let eight = |bend: f64| {
            let mut mesh = PolyMesh::<3> {
                nodes: vec![
                    [0.0, 0.0, 0.0],
                    [1.0, 1.0, bend],
                    [1.0, 0.0, 0.0],
                    [0.0, 1.0, 0.0],
                ],
                ..PolyMesh::default()
            };
            mesh.faces.push([0, 1, 2, 3]);
            mesh
        };
        assert_eq!(eight(0.0).face_shape(0).area(), 0.0);
        for bend in [0.0, 1e-15, 0.1] {
            let warp = warp(&eight(bend), 0);
            assert!(warp > 0.4, "{bend}: {warp}");
        }
        // Nodes that coincide, or lie on one line: the area is 0, and the face is flat.
        let mut none = eight(0.0);
        none.nodes.fill([0.3; 3]);
        assert_eq!(warp(&none, 0), 0.0);
        none.nodes = vec![[0.0; 3], [0.5; 3], [1.0; 3], [0.25; 3]];
        assert!(warp(&none, 0) < 1e-15);
    }

    #[test]
    fn a_figure_of_eight_of_unequal_parts_crosses_itself() {
        // The outline crosses itself at (0.8, 0.8): it has a triangle of area 0.8 and one of 0.05.
        let eight = |nodes: [[f64; 2]; 4], tilt: f64| {
            let mut mesh = PolyMesh::<3> {
                nodes: nodes.map(|[x, y]| [x, y, tilt * x]).to_vec(),
                ..PolyMesh::default()
            };
            mesh.faces.push([0, 1, 2, 3]);
            mesh
        };
        for tilt in [0.0, 0.3, 3.0] {
            let crossed = eight([[0.0, 0.0], [1.0, 1.0], [1.0, 0.75], [0.0, 1.75]], tilt);
            // The area of this face is not 0, and the face is flat.
            assert!(crossed.face_shape(0).area() > 0.1);
            assert!(warp(&crossed, 0) < 1e-12);
            assert!(
                self_crossing_width(&crossed, 0) > 0.003,
                "{}",
                self_crossing_width(&crossed, 0)
            );
            // The same nodes in an order that makes a simple polygon, though not a convex one.
            let simple = eight([[0.0, 0.0], [1.0, 0.75], [1.0, 1.0], [0.0, 1.75]], tilt);
            assert_eq!(self_crossing_width(&simple, 0), 0.0);
            let dented = eight([[0.0, 0.0], [1.0, 0.0], [0.2, 0.3], [0.0, 1.0]], tilt);
            assert_eq!(self_crossing_width(&dented, 0), 0.0);
        }
        // The outline crosses itself at a node, which lies on the edge from the first node to the
        // second.
        let mut through = eight([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 0.0]], 0.0);
        through.nodes.push([0.5, -0.5, 0.0]);
        through.faces = Default::default();
        through.faces.push([0, 1, 2, 3, 4]);
        assert!(self_crossing_width(&through, 0) > 0.05);
    }
}
