//! Faces of more than three nodes: whether they are flat, and whether their outlines are simple polygons.

use crate::geometry::dot;
use crate::mesh::poly::PolyMesh;

/// How far off a face's plane welding may have put its nodes: each of two by the share of its distance
/// to the site.
pub fn weld_offset<const D: usize>(mesh: &PolyMesh<D>, f: usize, weld: f64) -> f64 {
    let site = mesh.sites[mesh.face_cells[f][0] as usize];
    let square = |&n: &u32| -> f64 {
        let node = mesh.nodes[n as usize];
        (0..D).map(|k| (node[k] - site[k]).powi(2)).sum()
    };
    2.0 * weld
        * mesh
            .faces
            .get(f)
            .iter()
            .map(square)
            .fold(0.0, f64::max)
            .sqrt()
}

/// An area vector this small a share of a face's length times its width has cancelled: the face's
/// outline crosses itself, as an eight does, and no plane is the face's own.
const CANCELLATION_RATIO: f64 = 1e-9;

/// The largest distance of a face's nodes from a plane: that of its area, or, as the normal of a face
/// as narrow as rounding means nothing, one through its long axis if that is nearer. A face whose area
/// cancels is as far from flat as it is wide.
pub fn warp<const D: usize>(mesh: &PolyMesh<D>, f: usize) -> f64 {
    let shape = mesh.face_shape(f);
    let area = shape.area();
    let nodes = mesh.faces.get(f).iter();
    let off = nodes.map(|&n| -> [f64; D] {
        std::array::from_fn(|k| mesh.nodes[n as usize][k] - shape.apex[k])
    });
    let square = |x: &[f64; D]| dot(*x, *x);
    let longest = off
        .clone()
        .max_by(|x, y| square(x).total_cmp(&square(y)))
        .unwrap_or([0.0; D]);
    // Nodes all at one place are flat.
    if square(&longest) == 0.0 {
        return 0.0;
    }
    let (mut height, mut width) = (0.0f64, 0.0f64);
    for x in off {
        let along = dot(x, longest) / square(&longest);
        let aside: [f64; D] = std::array::from_fn(|k| x[k] - along * longest[k]);
        height = height.max((dot(x, shape.area_vector) / area).abs());
        width = width.max(square(&aside).sqrt());
    }
    // Also where the area is 0, and no height is known.
    if area <= CANCELLATION_RATIO * square(&longest).sqrt() * width {
        return width;
    }
    height.min(width)
}

/// How wide the part of a face is that its outline ties off where it crosses itself, as an eight does
/// (the smaller of the two parts, its area over the face's length); 0 for a simple polygon, and for a
/// face without area, whose plane is not known.
///
/// Where rounding makes the edges of a narrow face cross, that is as little as the face is narrow.
pub fn self_crossing_width<const D: usize>(mesh: &PolyMesh<D>, f: usize) -> f64 {
    let ring = mesh.faces.get(f);
    let count = ring.len();
    let shape = mesh.face_shape(f);
    let area = shape.area();
    if D != 3 || count < 4 || area == 0.0 {
        return 0.0;
    }
    // As seen along the axis that is nearest to the normal.
    let steep = |&i: &usize, &j: &usize| {
        let [i, j] = [i, j].map(|k| shape.area_vector[k].abs());
        i.total_cmp(&j)
    };
    let axis = (0..3).max_by(steep).unwrap_or(0);
    let seen: Vec<[f64; 2]> = ring
        .iter()
        .map(|&n| {
            [1, 2].map(|k| mesh.nodes[n as usize][(axis + k) % 3] - shape.apex[(axis + k) % 3])
        })
        .collect();
    let shorter = shape.area_vector[axis].abs() / area;
    let turn = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let at = |i: usize| seen[i % count];
    let whole: f64 = (1..count - 1).map(|i| turn(at(0), at(i), at(i + 1))).sum();
    let mut most = 0.0f64;
    for i in 0..count {
        for j in i + 2..count.min(count - 1 + i) {
            let ([a, b], [c, d]) = ([at(i), at(i + 1)], [at(j), at(j + 1)]);
            let (of_a, of_b) = (turn(c, d, a), turn(c, d, b));
            // A node on the other edge counts as on its left.
            let apart = (of_a >= 0.0) != (of_b >= 0.0);
            if !apart || (turn(a, b, c) >= 0.0) == (turn(a, b, d) >= 0.0) {
                continue;
            }
            let share = of_a / (of_a - of_b);
            let crossing = [0, 1].map(|k| a[k] + share * (b[k] - a[k]));
            let part: f64 = (i + 1..j).map(|k| turn(crossing, at(k), at(k + 1))).sum();
            most = most.max(part.abs().min((whole - part).abs()));
        }
    }
    let longest = ring.iter().map(|&n| {
        let off: [f64; D] = std::array::from_fn(|k| mesh.nodes[n as usize][k] - shape.apex[k]);
        dot(off, off)
    });
    // Half of twice the area, and length from the middle: half of the face's.
    0.25 * most / shorter / longest.fold(0.0, f64::max).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrow_faces_are_as_flat_as_they_are_narrow() {
        // A face of length 1 and width 1e-11, oblique: its area vector is mostly rounding.
        let along = [0.48, 0.6, 0.64];
        let aside = [0.8e-11, -0.64e-11, 0.0];
        let place = |u: f64, v: f64| std::array::from_fn(|k| 0.3 + u * along[k] + v * aside[k]);
        let mut mesh = PolyMesh::<3> {
            nodes: vec![
                place(0.0, 0.0),
                place(1.0, 0.2),
                place(0.7, 1.0),
                place(0.2, 0.9),
            ],
            ..PolyMesh::default()
        };
        mesh.faces.push([0, 1, 2, 3]);
        assert!(warp(&mesh, 0) < 2e-11, "{}", warp(&mesh, 0));
        // As wide as long, it is what its plane says.
        mesh.nodes[2][2] += 0.5;
        mesh.nodes[3][0] -= 0.3;
        assert!(warp(&mesh, 0) > 0.01);
    }

    #[test]
    fn a_face_like_an_eight_is_not_flat() {
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
        // All nodes at one place, or in one line: no area, and nothing that is not flat.
        let mut none = eight(0.0);
        none.nodes.fill([0.3; 3]);
        assert_eq!(warp(&none, 0), 0.0);
        none.nodes = vec![[0.0; 3], [0.5; 3], [1.0; 3], [0.25; 3]];
        assert!(warp(&none, 0) < 1e-15);
    }

    #[test]
    fn an_eight_of_unequal_parts_crosses_itself() {
        // Through (0.8, 0.8): a triangle of area 0.8, and one of 0.05.
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
            // Its area does not vanish, and it is flat.
            assert!(crossed.face_shape(0).area() > 0.1);
            assert!(warp(&crossed, 0) < 1e-12);
            assert!(
                self_crossing_width(&crossed, 0) > 0.003,
                "{}",
                self_crossing_width(&crossed, 0)
            );
            // The same nodes in an order that is a simple polygon, though not a convex one.
            let simple = eight([[0.0, 0.0], [1.0, 0.75], [1.0, 1.0], [0.0, 1.75]], tilt);
            assert_eq!(self_crossing_width(&simple, 0), 0.0);
            let dented = eight([[0.0, 0.0], [1.0, 0.0], [0.2, 0.3], [0.0, 1.0]], tilt);
            assert_eq!(self_crossing_width(&dented, 0), 0.0);
        }
        // Through a node: it lies on the edge from the first node to the second, and the outline goes on
        // beyond.
        let mut through = eight([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 0.0]], 0.0);
        through.nodes.push([0.5, -0.5, 0.0]);
        through.faces = Default::default();
        through.faces.push([0, 1, 2, 3, 4]);
        assert!(self_crossing_width(&through, 0) > 0.05);
    }
}
