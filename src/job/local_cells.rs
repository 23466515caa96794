//! Counts the tiny faces of Voronoi cells around an atom while it is moved, without cutting all
//! cells again.

use crate::geometry::{add_scaled, cross, distance2, dot, norm, sub, to_3d, unit};
use crate::mesh::poly::{Lists, PolyMesh};

/// Ratio to the largest area of a tiny face below which there is no face: more than four sites lie
/// on one sphere exactly.
const MIN_AREA_RATIO: f64 = 1e-6;

/// Returns the cells next to each cell.
pub(super) fn neighbours<const D: usize>(mesh: &PolyMesh<D>) -> Lists {
    let mut lists = vec![Vec::new(); mesh.sites.len()];
    for &[a, b] in &mesh.face_cells[..mesh.inner_face_count()] {
        lists[a as usize].push(b);
        lists[b as usize].push(a);
    }
    let mut neighbours = Lists::default();
    lists.into_iter().for_each(|list| neighbours.push(list));
    neighbours
}

/// The sites near an atom. In 2-D, cells are prisms of height 1.
pub(super) struct LocalCells {
    /// The atom, its neighbours, and their neighbours.
    sites: Vec<[f64; 3]>,
    /// Number of sites, the first ones, among which moving the atom changes faces.
    changing: usize,
    /// The corners of the box.
    low: [f64; 3],
    high: [f64; 3],
    max_area: f64,
    /// The face of two sites, and the memory for its next state.
    polygon: Vec<[f64; 3]>,
    clipped: Vec<[f64; 3]>,
}

impl LocalCells {
    /// Collects the sites near an atom. Faces are tiny if their area is below `max_area`.
    pub fn new<const D: usize>(
        mesh: &PolyMesh<D>,
        extent: [f64; D],
        atom: usize,
        neighbours: &Lists,
        max_area: f64,
    ) -> Self {
        let mut cells = vec![atom as u32];
        cells.extend(neighbours.get(atom));
        let changing = cells.len();
        let mut others: Vec<u32> = (cells[1..].iter())
            .flat_map(|&c| neighbours.get(c as usize))
            .copied()
            .filter(|c| !cells.contains(c))
            .collect();
        others.sort_unstable();
        others.dedup();
        cells.extend(others);
        let x = to_3d(mesh.sites[atom]);
        let sites = cells.iter().map(|&c| to_3d(mesh.sites[c as usize]));
        let mut sites: Vec<[f64; 3]> = sites.collect();
        let by_distance =
            |a: &[f64; 3], b: &[f64; 3]| distance2(a, &x).total_cmp(&distance2(b, &x));
        sites[1..changing].sort_by(by_distance);
        sites[changing..].sort_by(by_distance);
        let (mut low, mut high) = ([-0.5; 3], [0.5; 3]);
        low[..D].fill(0.0);
        high[..D].copy_from_slice(&extent);
        Self {
            sites,
            changing,
            low,
            high,
            max_area,
            polygon: Vec::new(),
            clipped: Vec::new(),
        }
    }

    /// Returns the number of tiny faces among the atom, if it is at `x`, and its neighbours, or
    /// `enough` if there are as many.
    pub fn count_tiny_faces<const D: usize>(&mut self, x: [f64; D], enough: usize) -> usize {
        self.sites[0] = to_3d(x);
        let mut count = 0;
        for a in 0..self.changing {
            let last = if a == 0 {
                self.sites.len()
            } else {
                self.changing
            };
            for b in a + 1..last {
                let area = self.face_area(a, b);
                if area < self.max_area && area > MIN_AREA_RATIO * self.max_area {
                    count += 1;
                    if count >= enough {
                        return count;
                    }
                }
            }
        }
        count
    }

    /// Returns the area of the face between two sites; 0 if there is none.
    fn face_area(&mut self, a: usize, b: usize) -> f64 {
        let [x, y] = [a, b].map(|i| self.sites[i]);
        let middle = add_scaled(x, 0.5, sub(y, x));
        let normal = unit(sub(y, x));
        let smallest = (0..3).min_by(|&i, &j| normal[i].abs().total_cmp(&normal[j].abs()));
        let mut axis = [0.0; 3];
        axis[smallest.unwrap_or(0)] = 1.0;
        let u = unit(cross(normal, axis));
        let v = cross(normal, u);
        // A square beyond the box becomes the face.
        let half = norm(sub(self.high, self.low));
        let corner = |s: f64, t: f64| add_scaled(add_scaled(middle, s * half, u), t * half, v);
        self.polygon.clear();
        self.polygon.extend([
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ]);
        for k in 0..3 {
            let mut outward = [0.0; 3];
            outward[k] = 1.0;
            if !(self.clip(self.high, outward) && self.clip(self.low, outward.map(|c: f64| -c))) {
                return 0.0;
            }
        }
        for i in (0..self.sites.len()).filter(|&i| i != a && i != b) {
            let direction = sub(self.sites[i], x);
            if !self.clip(add_scaled(x, 0.5, direction), direction) {
                return 0.0;
            }
        }
        let first = self.polygon[0];
        let mut area = [0.0; 3];
        for pair in self.polygon.windows(2) {
            area = add_scaled(area, 0.5, cross(sub(pair[0], first), sub(pair[1], first)));
        }
        norm(area)
    }

    /// Cuts off the part of the polygon beyond a plane. Returns `false` if nothing is left.
    fn clip(&mut self, point: [f64; 3], outward: [f64; 3]) -> bool {
        let height = |x: &[f64; 3]| dot(sub(*x, point), outward);
        if self.polygon.iter().all(|x| height(x) <= 0.0) {
            return !self.polygon.is_empty();
        }
        self.clipped.clear();
        let count = self.polygon.len();
        for i in 0..count {
            let (x, y) = (self.polygon[i], self.polygon[(i + 1) % count]);
            let (p, q) = (height(&x), height(&y));
            if p <= 0.0 {
                self.clipped.push(x);
            }
            if (p <= 0.0) != (q <= 0.0) {
                self.clipped.push(add_scaled(x, p / (p - q), sub(y, x)));
            }
        }
        std::mem::swap(&mut self.polygon, &mut self.clipped);
        !self.polygon.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::mesh::voronoi::{voronoi, voronoi_plane};

    /// Asserts that the counts for every atom are those of the mesh.
    fn assert_counts<const D: usize>(mesh: &PolyMesh<D>, extent: [f64; D], max_area: f64) {
        let neighbours = neighbours(mesh);
        let mut total = 0;
        for atom in 0..mesh.sites.len() {
            let is_near = |c: u32| c as usize == atom || neighbours.get(atom).contains(&c);
            let is_tiny = |f: &usize| {
                let area = mesh.face_shape(*f).area();
                mesh.face_cells[*f].into_iter().all(is_near)
                    && area < max_area
                    && area > MIN_AREA_RATIO * max_area
            };
            let expected = (0..mesh.inner_face_count()).filter(is_tiny).count();
            let mut local = LocalCells::new(mesh, extent, atom, &neighbours, max_area);
            let count = local.count_tiny_faces(mesh.sites[atom], usize::MAX);
            assert_eq!(count, expected, "atom {atom}");
            total += count;
        }
        assert!(total > 50);
    }

    #[test]
    fn counts_are_those_of_the_whole_mesh() {
        let mut random = Random::new(5);
        let atoms: Vec<[f64; 3]> = (0..150)
            .map(|_| std::array::from_fn(|_| 5.0 * random.draw() + 1e-3))
            .collect();
        let mesh = voronoi(&atoms, [5.1; 3]).unwrap();
        assert_counts(&mesh, [5.1; 3], 0.05);
        let atoms: Vec<[f64; 2]> = (0..150)
            .map(|_| std::array::from_fn(|_| 10.0 * random.draw() + 1e-3))
            .collect();
        let mesh = voronoi_plane(&atoms, [10.1; 2]).unwrap();
        assert_counts(&mesh, [10.1; 2], 0.3);
    }
}
