//! Cells of a mesh and the faces between them, of whatever shape: what paint and blocks need.

use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{dot, norm, normal, sub};
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;

/// Facets narrower than this share of the largest face's size are not asked on which side a point is.
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
    /// Whether the face lies on no surface.
    pub is_open: bool,
}

/// Cells as a graph.
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
    /// The cells of a mesh; facets in `closed` (nodes ascending, sorted) lie on surfaces, and so do
    /// the faces that they are part of. `cells` are those of [`Mesh::cells_of_faces`].
    pub fn new<F: Mesh<D>>(mesh: &F, cells: &[[u32; 2]], closed: &[[u32; D]]) -> Self {
        let nodes = mesh.nodes();
        let (volumes, centres): (Vec<f64>, Vec<[f64; D]>) = mesh.cell_volumes().into_iter().unzip();
        let mut links = Vec::new();
        for (face, &cells) in cells.iter().enumerate() {
            if cells[1] == NONE {
                continue;
            }
            let (mut area, mut open) = (0.0, true);
            mesh.facets(face, |mut facet| {
                area += norm(normal(&facet.map(|n| nodes[n as usize])));
                facet.sort_unstable();
                open &= closed.binary_search(&facet).is_err();
            });
            let [a, b] = cells.map(|c| centres[c as usize]);
            links.push(Link {
                cells,
                area,
                distance: norm(sub(a, b)),
                is_open: open,
            });
        }
        let ends = links.iter().flat_map(|link| link.cells.map(|c| c as usize));
        let (start, around) = sort_by_group(volumes.len(), ends);
        let cell_links = around.into_iter().map(|end| end / 2).collect();
        Self {
            volumes,
            centres,
            links,
            start,
            cell_links,
        }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.volumes.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.volumes.is_empty()
    }

    /// The links of a cell: number, link, and the cell beyond.
    pub fn links_of(&self, cell: u32) -> impl Iterator<Item = (usize, &Link, u32)> {
        let range = self.start[cell as usize] as usize..self.start[cell as usize + 1] as usize;
        self.cell_links[range].iter().map(move |&l| {
            let link = &self.links[l as usize];
            let [a, b] = link.cells;
            (l as usize, link, if a == cell { b } else { a })
        })
    }
}

/// The cell that holds a point, cells being convex; of several that touch it the first. `cells` are
/// those of [`Mesh::cells_of_faces`].
pub fn find_cell<const D: usize, F: Mesh<D>>(
    mesh: &F,
    cells: &[[u32; 2]],
    p: [f64; D],
) -> Option<u32> {
    let nodes = mesh.nodes();
    let mut size = 0.0f64;
    for face in 0..cells.len() {
        mesh.facets(face, |facet| {
            size = size.max(norm(normal(&facet.map(|n| nodes[n as usize]))));
        });
    }
    let size = size.powf(1.0 / (D as f64 - 1.0));
    // How far the point is beyond the outermost of each cell's faces.
    let mut outside: Vec<f64> = Vec::new();
    for (face, cells) in cells.iter().enumerate() {
        mesh.facets(face, |facet| {
            let corners = facet.map(|n| nodes[n as usize]);
            let n = normal(&corners);
            let area = norm(n);
            let off = dot(sub(p, corners[0]), n) / area;
            let longest = (corners
                .iter()
                .flat_map(|a| corners.iter().map(|b| norm(sub(*a, *b)))))
            .fold(0.0, f64::max);
            // Of narrow facets rounding leaves no direction; the cell hardly grows without them.
            let is_wide = area > MIN_FACET_WIDTH_RATIO * size * longest.powi(D as i32 - 2);
            for (&cell, off) in cells.iter().zip([off, -off]) {
                if cell != NONE && is_wide {
                    let cell = cell as usize;
                    outside.resize(outside.len().max(cell + 1), f64::NEG_INFINITY);
                    outside[cell] = outside[cell].max(off);
                }
            }
        });
    }
    let slack = 1e-9 * size;
    let found = outside.iter().position(|&off| off <= slack);
    found.map(|cell| cell as u32)
}

/// The facets that enclose all cells of `region`, turned outwards. `cells` are those of
/// [`Mesh::cells_of_faces`].
pub fn enclosing_facets<const D: usize, F: Mesh<D>>(
    mesh: &F,
    cells: &[[u32; 2]],
    regions: &[u32],
    region: u32,
) -> Vec<[u32; D]> {
    let mut skin = Vec::new();
    for (face, cells) in cells.iter().enumerate() {
        let inside = cells.map(|c| regions.get(c as usize) == Some(&region));
        if inside[0] != inside[1] {
            mesh.facets(face, |mut facet| {
                if inside[1] {
                    facet.swap(0, 1);
                }
                skin.push(facet);
            });
        }
    }
    skin
}
