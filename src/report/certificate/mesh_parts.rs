//! The parts of a mesh: which cells stand for which connected part of the image.

use super::labelled_cells::LabelledCells;
use super::voxel_parts::VoxelParts;
use crate::geometry::NONE;
use crate::parallel::prelude::*;

/// Number of cells or faces in one task.
const ITEMS_PER_TASK: usize = 1 << 12;

/// The part of each cell, and the facets between parts.
pub struct MeshParts<const D: usize> {
    /// Index of the part of each cell: that of most of its volume among the parts of its label, or that
    /// of adjacent cells; `NONE` if no sample of the label is near.
    pub part_of_cell: Vec<u32>,
    /// Facets between cells of different parts, and those on the boundary of the mesh.
    pub facets: Vec<PartFacet<D>>,
}

/// A facet on the boundary of a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PartFacet<const D: usize> {
    /// Number of its face.
    pub face: u32,
    /// Its nodes; the normal points out of the first cell.
    pub nodes: [u32; D],
    /// Parts on its two sides; `NONE` outside the mesh, and for cells without a part.
    pub parts: [u32; 2],
    /// Labels on its two sides; `NONE` beyond a side of the box, and [`DROPPED`] where cells were left out.
    pub labels: [u32; 2],
}

/// Stands for the labels of cells that were left out.
const DROPPED: u32 = NONE - 1;

/// Distance from a side of the box within which a node lies on it, in samples: positions in files are rounded.
const SIDE_TOLERANCE: f64 = 1e-3;

impl<const D: usize> PartFacet<D> {
    /// Returns `true` if the facet lies between cells of different labels, or where cells were left out.
    pub fn is_interface(&self) -> bool {
        self.labels[1] != NONE && self.labels[0] != self.labels[1]
    }
}

impl<const D: usize> MeshParts<D> {
    /// Finds the parts of a mesh.
    pub fn new(cells: &LabelledCells<'_, D>, voxels: &VoxelParts<'_, D>) -> Self {
        let part_of_cell = parts_of_cells(cells, voxels);
        let facets = facets_between(cells, &part_of_cell, voxels.components.dims);
        Self {
            part_of_cell,
            facets,
        }
    }
}

/// Calls `visit` with each face between two cells, or on the boundary, in tasks; returns what it found
/// in the order of faces.
fn map_faces<const D: usize, T: Send>(
    cells: &LabelledCells<'_, D>,
    visit: impl Fn(usize, [u32; 2], &mut Vec<T>) + Sync,
) -> Vec<T> {
    let tasks = (0..cells.face_count.div_ceil(ITEMS_PER_TASK)).into_par_iter();
    let found: Vec<Vec<T>> = tasks
        .map(|task| {
            let mut found = Vec::new();
            let end = cells.face_count.min((task + 1) * ITEMS_PER_TASK);
            for face in task * ITEMS_PER_TASK..end {
                let pair = cells.cells_of_face(face);
                if pair[0] != NONE {
                    visit(face, pair, &mut found);
                }
            }
            found
        })
        .collect();
    found.into_iter().flatten().collect()
}

fn parts_of_cells<const D: usize>(
    cells: &LabelledCells<'_, D>,
    voxels: &VoxelParts<'_, D>,
) -> Vec<u32> {
    let components = &voxels.components.components;
    let label_count = cells.labels.iter().chain(voxels.labels).max();
    let mut only_part = vec![Some(NONE); label_count.map_or(0, |max| *max as usize + 1)];
    for (number, part) in components.iter().enumerate() {
        let only = &mut only_part[part.label as usize];
        *only = only.filter(|known| *known == NONE).map(|_| number as u32);
    }
    let part_of = |cell: usize| {
        let label = cells.labels[cell];
        if let Some(part) = only_part[label as usize] {
            return part;
        }
        let mut votes: Vec<(u32, f64)> = Vec::new();
        cells.for_each_point(cell, |x, volume| {
            let Some(sample) = voxels.sample_at(x) else {
                return;
            };
            if voxels.labels[sample] != label {
                return;
            }
            let part = voxels.part_at(sample);
            match votes.iter_mut().find(|(known, _)| *known == part) {
                Some((_, sum)) => *sum += volume,
                None => votes.push((part, volume)),
            }
        });
        let larger = |best: (u32, f64), next: (u32, f64)| if next.1 > best.1 { next } else { best };
        votes.into_iter().fold((NONE, 0.0), larger).0
    };
    let mut parts: Vec<u32> = (0..cells.labels.len())
        .into_par_iter()
        .map(part_of)
        .collect();
    // Cells without a sample of their label follow adjacent cells of this label.
    let open = map_faces(cells, |_, [a, b], open: &mut Vec<[u32; 2]>| {
        if b != NONE && cells.labels[a as usize] == cells.labels[b as usize] {
            let [p, q] = [a, b].map(|c| parts[c as usize]);
            if p == NONE || q == NONE {
                open.push([a, b]);
            }
        }
    });
    loop {
        let mut next: Vec<(u32, u32)> = Vec::new();
        for pair in &open {
            for [cell, other] in [*pair, [pair[1], pair[0]]] {
                if parts[cell as usize] == NONE && parts[other as usize] != NONE {
                    next.push((cell, parts[other as usize]));
                }
            }
        }
        if next.is_empty() {
            break;
        }
        next.sort_unstable();
        next.dedup_by_key(|(cell, _)| *cell);
        for (cell, part) in next {
            parts[cell as usize] = part;
        }
    }
    parts
}

/// Returns the facets between parts and on the boundary of the mesh, in a box with these numbers of samples.
fn facets_between<const D: usize>(
    cells: &LabelledCells<'_, D>,
    part_of_cell: &[u32],
    dims: [usize; D],
) -> Vec<PartFacet<D>> {
    let is_on_side = |nodes: [u32; D]| {
        (0..D).any(|k| {
            [0.0, dims[k] as f64 - 1.0].into_iter().any(|side| {
                let is_near = |node: u32| (cells.position(node)[k] - side).abs() < SIDE_TOLERANCE;
                nodes.into_iter().all(is_near)
            })
        })
    };
    map_faces(cells, |face, pair, facets| {
        let of_side = |values: &[u32]| {
            pair.map(|cell| {
                if cell == NONE {
                    NONE
                } else {
                    values[cell as usize]
                }
            })
        };
        let (parts, labels) = (of_side(part_of_cell), of_side(cells.labels));
        if pair[1] == NONE || parts[0] != parts[1] || labels[0] != labels[1] {
            cells.for_each_facet(face, |nodes| {
                let is_cut = pair[1] == NONE && !is_on_side(nodes);
                facets.push(PartFacet {
                    face: face as u32,
                    nodes,
                    parts,
                    labels: [labels[0], if is_cut { DROPPED } else { labels[1] }],
                });
            });
        }
    })
}
