//! Cells of a mesh and the faces between them, of whatever shape: what paint and blocks need.

use rayon::prelude::*;

use crate::error::cause;
use crate::mesh::complex::neighbors;
use crate::mesh::{FACES, TetMesh, cross, norm, sub, volume6};
use crate::{Error, Result};

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
    pub open: bool,
}

/// Cells as a graph.
#[derive(Debug, Clone, Default)]
pub struct Cells {
    /// Volume of each cell.
    pub volumes: Vec<f64>,
    /// The faces between cells.
    pub links: Vec<Link>,
    start: Vec<u32>,
    around: Vec<u32>,
}

impl Cells {
    /// From volumes and links.
    pub fn new(volumes: Vec<f64>, links: Vec<Link>) -> Self {
        let mut start = vec![0; volumes.len() + 1];
        for link in &links {
            for c in link.cells {
                start[c as usize + 1] += 1;
            }
        }
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let mut next = start.clone();
        let mut around = vec![0; 2 * links.len()];
        for (l, link) in links.iter().enumerate() {
            for c in link.cells {
                around[next[c as usize] as usize] = l as u32;
                next[c as usize] += 1;
            }
        }
        Self {
            volumes,
            links,
            start,
            around,
        }
    }

    /// The tetrahedra of a mesh; faces in `closed` (nodes ascending, sorted) lie on surfaces.
    ///
    /// # Errors
    /// [`Error::Mesh`] if more than two tetrahedra share a face.
    pub fn of_tets(mesh: &TetMesh, closed: &[[u32; 3]]) -> Result<Self> {
        let across = neighbors(mesh.nodes.len(), &mesh.tets).map_err(|face| {
            Error::Mesh(cause(
                "mesh",
                format!("more than two tetrahedra share the face {face:?}"),
                "run atomesh validate",
            ))
        })?;
        let count = mesh.tets.len();
        let volumes = (0..count)
            .into_par_iter()
            .map(|t| volume6(&mesh.corners(t)) / 6.0);
        let centres: Vec<[f64; 3]> = (0..count)
            .into_par_iter()
            .map(|t| centre(mesh, t))
            .collect();
        let links = (0..count)
            .into_par_iter()
            .flat_map_iter(|t| {
                let (across, centres) = (&across, &centres);
                // Each face once: from the tetrahedron that comes first. NONE comes last.
                let later = (0..4).filter(move |&k| {
                    let n = across[t][k];
                    n as usize > t && (n as usize) < count
                });
                later.map(move |k| {
                    let mut face = FACES[k].map(|i| mesh.tets[t][i]);
                    let [a, b, c] = face.map(|n| mesh.nodes[n as usize]);
                    face.sort_unstable();
                    let other = across[t][k];
                    Link {
                        cells: [t as u32, other],
                        area: 0.5 * norm(cross(sub(b, a), sub(c, a))),
                        distance: norm(sub(centres[t], centres[other as usize])),
                        open: closed.binary_search(&face).is_err(),
                    }
                })
            })
            .collect();
        Ok(Self::new(volumes.collect(), links))
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
    pub fn around(&self, cell: u32) -> impl Iterator<Item = (usize, &Link, u32)> {
        let range = self.start[cell as usize] as usize..self.start[cell as usize + 1] as usize;
        self.around[range].iter().map(move |&l| {
            let link = &self.links[l as usize];
            let [a, b] = link.cells;
            (l as usize, link, if a == cell { b } else { a })
        })
    }

    /// How hard it is for paint to flow through a link: the distance, and more of it where the face
    /// is small for its cells (a narrow door is no shortcut).
    pub fn resistance(&self, link: &Link) -> f64 {
        let [a, b] = link.cells.map(|c| self.volumes[c as usize]);
        // 1 for a brick's faces, 1.5 for a regular tetrahedron's.
        let width = 2.0 * link.area * link.distance / (a + b);
        link.distance / width.clamp(1e-6, 1.0)
    }
}

/// Centroid of a tetrahedron.
pub fn centre(mesh: &TetMesh, t: usize) -> [f64; 3] {
    let x = mesh.corners(t);
    std::array::from_fn(|k| 0.25 * (x[0][k] + x[1][k] + x[2][k] + x[3][k]))
}

/// The tetrahedron that holds a point; of several that touch it the first.
pub fn holding(mesh: &TetMesh, p: [f64; 3]) -> Option<u32> {
    let holds = |t: &usize| {
        let x = mesh.corners(*t);
        let slack = 1e-9 * volume6(&x).abs();
        (0..4).all(|k| {
            let mut part = x;
            part[k] = p;
            volume6(&part) >= -slack
        })
    };
    let found = (0..mesh.tets.len()).into_par_iter().find_first(holds);
    found.map(|t| t as u32)
}

/// The faces that enclose all cells of `region`, turned outwards.
pub fn skin(mesh: &TetMesh, across: &[[u32; 4]], regions: &[u32], region: u32) -> Vec<[u32; 3]> {
    (0..mesh.tets.len())
        .filter(|&t| regions[t] == region)
        .flat_map(|t| {
            let outer =
                (0..4).filter(move |&k| regions.get(across[t][k] as usize) != Some(&region));
            outer.map(move |k| {
                let [a, b, c] = FACES[k].map(|i| mesh.tets[t][i]);
                [a, c, b]
            })
        })
        .collect()
}
