//! Surfaces and lines that are drawn with a mesh, with an image, or alone.

use super::paint::CATEGORY_COLORS;
use crate::model::surface::SurfaceKind;

/// A surface of triangles, or lines, in physical coordinates.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OverlayShape {
    /// Name in the legend.
    pub name: String,
    /// Kind of the surface, if known.
    pub kind: Option<SurfaceKind>,
    /// Triangles of the surface.
    pub triangles: Vec<[[f64; 3]; 3]>,
    /// Polylines.
    pub lines: Vec<Vec<[f64; 3]>>,
}

const FAULT_COLORS: [[u8; 3]; 6] = [
    [205, 85, 60],
    [236, 160, 75],
    [150, 60, 95],
    [228, 200, 105],
    [135, 80, 60],
    [220, 125, 145],
];
const HORIZON_COLORS: [[u8; 3]; 6] = [
    [60, 155, 140],
    [80, 125, 195],
    [130, 185, 95],
    [75, 105, 130],
    [150, 135, 200],
    [115, 190, 210],
];
/// Colour of lines that are not on surfaces, such as streamlines.
const LINE_COLOR: [u8; 3] = [30, 110, 50];

impl OverlayShape {
    /// Returns all points of the shape.
    pub fn points(&self) -> impl Iterator<Item = [f64; 3]> {
        let triangles = self.triangles.as_flattened().iter();
        triangles.chain(self.lines.iter().flatten()).copied()
    }

    /// Returns the segments of its lines.
    pub(super) fn segments(&self) -> impl Iterator<Item = [[f64; 3]; 2]> {
        self.lines
            .iter()
            .flat_map(|line| line.windows(2).map(|ends| [ends[0], ends[1]]))
    }

    /// Returns the sections of its triangles with the plane on which coordinate `axis` is
    /// `position`, after `map` has transformed their corners.
    pub(super) fn section(
        &self,
        axis: usize,
        position: f64,
        map: impl Fn([f64; 3]) -> [f64; 3],
    ) -> impl Iterator<Item = [[f64; 3]; 2]> {
        self.triangles.iter().filter_map(move |triangle| {
            let ring = triangle.map(|x| (map(x), 0.0));
            Some(cut_polygon(&ring, axis, position)?.map(|(p, _)| p))
        })
    }
}

/// Returns a colour for each shape. Faults and horizons have families of colours of their own, in
/// which neighbours differ.
pub(super) fn shape_colors(shapes: &[OverlayShape]) -> Vec<[u8; 3]> {
    let mut used = [0; 3];
    let color = |shape: &OverlayShape| {
        let (family, counter): (&[[u8; 3]], usize) = match shape.kind {
            Some(SurfaceKind::Fault | SurfaceKind::Interface) => (&FAULT_COLORS, 0),
            Some(SurfaceKind::Horizon) => (&HORIZON_COLORS, 1),
            None if shape.triangles.is_empty() => return LINE_COLOR,
            None => (&CATEGORY_COLORS, 2),
        };
        let number = used[counter];
        used[counter] += 1;
        // Each repetition of the family is darker.
        let brightness = 1.0 - 0.2 * (number / family.len() % 3) as f64;
        family[number % family.len()].map(|c| (brightness * f64::from(c)) as u8)
    };
    shapes.iter().map(color).collect()
}

/// Returns the ends of the section of a convex polygon with the plane on which coordinate `axis` is
/// `position`, with the values there; `None` if there is no section. A corner exactly on the plane
/// counts as above it, so that the sections of neighbours fit.
pub(super) fn cut_polygon(
    ring: &[([f64; 3], f64)],
    axis: usize,
    position: f64,
) -> Option<[([f64; 3], f64); 2]> {
    let corner = |i: usize| {
        let ([x, y, z], value) = ring[i];
        [x, y, z, value]
    };
    let ends = cut_ring(ring.len(), corner, axis, position)?;
    Some(ends.map(|[x, y, z, value]| ([x, y, z], value)))
}

/// Returns the ends of the section of a convex polygon as [`cut_polygon`] does; `corner` returns
/// the coordinates of its corners, and any values to be interpolated after them.
pub(super) fn cut_ring<const N: usize>(
    corner_count: usize,
    corner: impl Fn(usize) -> [f64; N],
    axis: usize,
    position: f64,
) -> Option<[[f64; N]; 2]> {
    let mut ends = [[0.0; N]; 2];
    let mut count = 0;
    for i in 0..corner_count {
        let [p, q] = [i, (i + 1) % corner_count].map(&corner);
        let (u, v) = (p[axis] - position, q[axis] - position);
        if (u < 0.0) == (v < 0.0) || count == 2 {
            continue;
        }
        let t = u / (u - v);
        ends[count] = std::array::from_fn(|k| p[k] + t * (q[k] - p[k]));
        count += 1;
    }
    (count == 2).then_some(ends)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_warm_and_horizons_are_cool_and_no_two_are_alike() {
        let shape_of_kind = |kind: Option<SurfaceKind>| OverlayShape {
            kind,
            triangles: vec![[[0.0; 3]; 3]],
            ..OverlayShape::default()
        };
        let shapes: Vec<OverlayShape> = (0..14)
            .map(|i| {
                shape_of_kind(Some(if i < 7 {
                    SurfaceKind::Fault
                } else {
                    SurfaceKind::Horizon
                }))
            })
            .collect();
        let mut colors = shape_colors(&shapes);
        assert!(colors[..7].iter().all(|[r, _, b]| r > b));
        assert!(colors[7..].iter().all(|[r, g, b]| r < g || r < b));
        colors.sort_unstable();
        colors.dedup();
        assert_eq!(colors.len(), 14);
    }

    #[test]
    fn values_are_interpolated_where_a_polygon_is_cut() {
        let ring = [
            ([0.0; 3], 0.0),
            ([4.0, 0.0, 0.0], 8.0),
            ([4.0, 0.0, 4.0], 0.0),
        ];
        let [(p, value_p), (q, value_q)] = cut_polygon(&ring, 0, 1.0).unwrap();
        assert_eq!((p, value_p), ([1.0, 0.0, 0.0], 2.0));
        assert_eq!((q, value_q), ([1.0, 0.0, 1.0], 0.0));
        assert_eq!(cut_polygon(&ring, 0, 5.0), None);
    }
}
