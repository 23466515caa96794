//! Searches among the facets of a mesh whose sizes differ much.

use crate::geometry::cell_list::CellList;

/// Points of facets in classes by the size of their facets. A search visits few points that are out
/// of range for their size, although the largest facet of a Voronoi mesh is many times larger than
/// most.
pub struct SizeClasses<const D: usize> {
    reach: f64,
    /// For each class its largest size, its points, and their indices.
    classes: Vec<(f64, CellList<D>, Vec<usize>)>,
    /// Cells as wide as the reach of the largest facet. Among points at equal distance, the first
    /// one in the order of these cells is taken.
    coarse_cells: CellList<D>,
}

impl<const D: usize> SizeClasses<D> {
    /// Sorts points of facets with these sizes. A facet reaches as far as `reach` times its size.
    pub fn new(points: &[[f64; D]], sizes: &[f64], reach: f64) -> Self {
        let largest = sizes.iter().copied().fold(0.0, f64::max);
        let mean = sizes.iter().sum::<f64>() / sizes.len().max(1) as f64;
        // The first class has sizes up to the mean, the next ones up to twice the mean, four times,
        // and so on.
        let class = |size: f64| (size / mean).log2().ceil().max(0.0) as usize;
        let mut members: Vec<Vec<usize>> = Vec::new();
        for (i, &size) in sizes.iter().enumerate() {
            let class = class(size);
            members.resize_with(members.len().max(class + 1), Vec::new);
            members[class].push(i);
        }
        let classes = members.into_iter().filter(|members| !members.is_empty());
        let classes = classes.map(|members| {
            let max_size = members.iter().map(|&i| sizes[i]).fold(0.0, f64::max);
            let positions: Vec<[f64; D]> = members.iter().map(|&i| points[i]).collect();
            (
                max_size,
                CellList::new(&positions, reach * max_size),
                members,
            )
        });
        Self {
            reach,
            classes: classes.collect(),
            coarse_cells: CellList::new(points, reach * largest),
        }
    }

    /// Visits every point that is nearer to `point`, which belongs to a facet of this size, than
    /// `reach` times the mean of the two facets' sizes, and some points farther away.
    pub fn visit(&self, point: [f64; D], size: f64, mut visit: impl FnMut(usize)) {
        for (max_size, grid, members) in &self.classes {
            let radius = self.reach * 0.5 * (size + max_size);
            grid.visit_within(point, radius, |n| visit(members[n]));
        }
    }

    /// Returns `true` if point i comes before point j; it decides between points at equal distance.
    pub fn precedes(&self, points: &[[f64; D]], i: usize, j: usize) -> bool {
        let position = |i: usize| (self.coarse_cells.offset_of(points[i]), i);
        position(i) < position(j)
    }
}
