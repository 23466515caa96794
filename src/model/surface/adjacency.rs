//! The cells of a mesh and the faces between them, for cells of any shape. Painting and the search
//! for blocks work on this graph.

use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{dot, norm, normal, sub};
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;

/// Facets narrower than this fraction of the largest face's size are ignored when a point is
/// located.
const MIN_FACET_WIDTH_RATIO: f64 = 1e-5;

/// A face between two cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// The two cells.
    pub cells: [u32; 2],
    /// Area of the face.
    pub area: f64,
    /// Distance between the cells' centres.
    pub distance: f64,
    /// `true` if the face lies on no surface.
    pub is_open: bool,
}

/// The cells of a mesh as a graph.
#[derive(Debug, Clone, Default)]
pub struct CellAdjacency<const D: usize> {
    /// Volume of each cell.
    pub volumes: Vec<f64>,
    /// Centre of each cell.
    pub centres: Vec<[f64; D]>,
    /// The faces between cells.
    pub links: Vec<Link>,
    start: Vec<u32>,
    cell_links: Vec<u32>,
}

impl<const D: usize> CellAdjacency<D> {
    /// Builds the graph of a mesh. Facets in `closed` (nodes ascending, sorted) lie on surfaces,
    /// and so do the faces that contain them. `face_cells` is the result of
    /// [`Mesh::cells_of_faces`].
    pub fn new<F: Mesh<D>>(mesh: &F, face_cells: &[[u32; 2]], closed: &[[u32; D]]) -> Self {
        let nodes = mesh.nodes();
        let (volumes, centres): (Vec<f64>, Vec<[f64; D]>) = mesh.cell_volumes().into_iter().unzip();
        let mut links = Vec::new();
        for (face, &cells) in face_cells.iter().enumerate() {
            if cells[1] == NONE {
                continue;
            }
            let (mut area, mut is_open) = (0.0, true);
            mesh.facets(face, |mut facet| {
                area += norm(normal(&facet.map(|n| nodes[n as usize])));
                facet.sort_unstable();
                is_open &= closed.binary_search(&facet).is_err();
            });
            let [a, b] = cells.map(|c| centres[c as usize]);
            links.push(Link {
                cells,
                area,
                distance: norm(sub(a, b)),
                is_open,
            });
        }
        let ends = links.iter().flat_map(|link| link.cells.map(|c| c as usize));
        let (start, sorted_ends) = sort_by_group(volumes.len(), ends);
        let cell_links = sorted_ends.into_iter().map(|end| end / 2).collect();
        Self {
            volumes,
            centres,
            links,
            start,
            cell_links,
        }
    }

    /// Returns the number of cells.
    pub fn len(&self) -> usize {
        self.volumes.len()
    }

    /// Returns `true` if there are no cells.
    pub fn is_empty(&self) -> bool {
        self.volumes.is_empty()
    }

    /// Returns the links of a cell: index, link, and the cell on the other side.
    pub fn links_of(&self, cell: u32) -> impl Iterator<Item = (usize, &Link, u32)> {
        let range = self.start[cell as usize] as usize..self.start[cell as usize + 1] as usize;
        self.cell_links[range].iter().map(move |&l| {
            let link = &self.links[l as usize];
            let [a, b] = link.cells;
            (l as usize, link, if a == cell { b } else { a })
        })
    }
}

/// Finds the cells of a mesh that contain points; cells are convex.
#[derive(Debug)]
pub struct CellLocator<const D: usize> {
    /// Size of the largest face.
    face_size: f64,
    /// Lowest and highest coordinates of each cell.
    boxes: Vec<[[f64; D]; 2]>,
}

impl<const D: usize> CellLocator<D> {
    /// Measures the cells of a mesh. `face_cells` is the result of [`Mesh::cells_of_faces`].
    pub fn new<F: Mesh<D>>(mesh: &F, face_cells: &[[u32; 2]]) -> Self {
        let nodes = mesh.nodes();
        let mut size = 0.0f64;
        let mut boxes = vec![[[f64::INFINITY; D], [f64::NEG_INFINITY; D]]; mesh.len()];
        for (face, cells) in face_cells.iter().enumerate() {
            mesh.facets(face, |facet| {
                let corners = facet.map(|n| nodes[n as usize]);
                size = size.max(norm(normal(&corners)));
                for &cell in cells.iter().filter(|&&cell| cell != NONE) {
                    let [low, high] = &mut boxes[cell as usize];
                    for corner in &corners {
                        for k in 0..D {
                            low[k] = low[k].min(corner[k]);
                            high[k] = high[k].max(corner[k]);
                        }
                    }
                }
            });
        }
        Self {
            face_size: size.powf(1.0 / (D as f64 - 1.0)),
            boxes,
        }
    }

    /// Returns the cell that contains a point. If several cells touch the point, it is the first of
    /// them. The arguments are those of [`new`](Self::new).
    pub fn find<F: Mesh<D>>(&self, mesh: &F, face_cells: &[[u32; 2]], p: [f64; D]) -> Option<u32> {
        let (nodes, size) = (mesh.nodes(), self.face_size);
        // Rounding moves no cell by as much as the size of a face.
        let is_near = |[low, high]: &[[f64; D]; 2]| {
            (0..D).all(|k| low[k] - size <= p[k] && p[k] <= high[k] + size)
        };
        let near: Vec<bool> = self.boxes.iter().map(is_near).collect();
        // For each cell near the point the largest signed distance of the point beyond one of its
        // faces.
        let mut outside: Vec<f64> = (near.iter())
            .map(|&is_near| {
                if is_near {
                    f64::NEG_INFINITY
                } else {
                    f64::INFINITY
                }
            })
            .collect();
        for (face, cells) in face_cells.iter().enumerate() {
            if !(cells.iter()).any(|&cell| cell != NONE && near[cell as usize]) {
                continue;
            }
            mesh.facets(face, |facet| {
                let corners = facet.map(|n| nodes[n as usize]);
                let n = normal(&corners);
                let area = norm(n);
                let distance = dot(sub(p, corners[0]), n) / area;
                let longest = (corners
                    .iter()
                    .flat_map(|a| corners.iter().map(|b| norm(sub(*a, *b)))))
                .fold(0.0, f64::max);
                // Rounding spoils the normals of narrow facets; without them the cell is hardly larger.
                let is_wide = area > MIN_FACET_WIDTH_RATIO * size * longest.powi(D as i32 - 2);
                for (&cell, distance) in cells.iter().zip([distance, -distance]) {
                    if cell != NONE && is_wide {
                        let largest = &mut outside[cell as usize];
                        *largest = largest.max(distance);
                    }
                }
            });
        }
        let tolerance = 1e-9 * size;
        let cell = outside.iter().position(|&distance| distance <= tolerance);
        cell.map(|cell| cell as u32)
    }
}

/// Returns the cell that contains a point, as [`CellLocator::find`] does.
pub fn find_cell<const D: usize, F: Mesh<D>>(
    mesh: &F,
    face_cells: &[[u32; 2]],
    p: [f64; D],
) -> Option<u32> {
    CellLocator::new(mesh, face_cells).find(mesh, face_cells, p)
}

/// Returns the facets that enclose all cells of `region`, oriented outwards. `face_cells` is the
/// result of [`Mesh::cells_of_faces`].
pub fn enclosing_facets<const D: usize, F: Mesh<D>>(
    mesh: &F,
    face_cells: &[[u32; 2]],
    regions: &[u32],
    region: u32,
) -> Vec<[u32; D]> {
    let mut facets = Vec::new();
    for (face, cells) in face_cells.iter().enumerate() {
        let is_inside = cells.map(|c| regions.get(c as usize) == Some(&region));
        if is_inside[0] != is_inside[1] {
            mesh.facets(face, |mut facet| {
                if is_inside[1] {
                    facet.swap(0, 1);
                }
                facets.push(facet);
            });
        }
    }
    facets
}
