//! The interfaces between every two regions of a mesh, and between regions and the outside, and the
//! direction in which each of them faces.

use std::collections::BTreeMap;

use crate::Result;
use crate::geometry::{dot, norm, normal, sub};
use crate::mesh::Mesh;

/// The interface between two regions.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionInterface<const D: usize> {
    /// The region behind the facets: the one that the interface encloses, if it is closed, else the
    /// one with the smaller number.
    pub inner_region: i32,
    /// The region in front of the facets, to which they are oriented; `None` at the sides of the
    /// mesh.
    pub outer_region: Option<i32>,
    /// The facets.
    pub facets: Vec<[u32; D]>,
    /// Total area of the facets (length in 2-D).
    pub area: f64,
}

/// Returns the interfaces between every two regions, sorted by the smaller and then by the larger
/// number of their regions. Interfaces with the outside come last. All interfaces of a region
/// together enclose it without a gap. Areas and directions are measured between `nodes`, which are
/// mirrored against those of the mesh if `is_mirrored`.
///
/// # Errors
/// Returns [`Error::Mesh`](crate::Error::Mesh) if three cells share a face.
pub fn region_interfaces<const D: usize, M: Mesh<D>>(
    mesh: &M,
    regions: &[i32],
    nodes: &[[f64; D]],
    is_mirrored: bool,
) -> Result<Vec<RegionInterface<D>>> {
    let mut facets_by_pair: BTreeMap<(bool, i32, i32), Vec<[u32; D]>> = BTreeMap::new();
    for (face, cells) in mesh.cells_of_faces()?.into_iter().enumerate() {
        let [Some(&inner), outer] = cells.map(|c| regions.get(c as usize)) else {
            continue;
        };
        let outer = outer.copied();
        if outer == Some(inner) {
            continue;
        }
        let key = match outer {
            Some(outer) => (false, inner.min(outer), inner.max(outer)),
            None => (true, inner, inner),
        };
        let facets = facets_by_pair.entry(key).or_default();
        mesh.facets(face, |mut facet| {
            if (key.1 != inner) != is_mirrored {
                facet.swap(0, 1);
            }
            facets.push(facet);
        });
    }
    let area = |facet: &[u32; D]| norm(normal(&facet.map(|n| nodes[n as usize])));
    let interfaces = (facets_by_pair.into_iter()).map(|((is_outside, low, high), mut facets)| {
        let encloses_high = !is_outside && is_turned_inwards(nodes, &facets);
        if encloses_high {
            facets.iter_mut().for_each(|facet| facet.swap(0, 1));
        }
        let [inner, outer] = if encloses_high {
            [high, low]
        } else {
            [low, high]
        };
        RegionInterface {
            inner_region: inner,
            outer_region: (!is_outside).then_some(outer),
            area: facets.iter().map(area).sum(),
            facets,
        }
    });
    Ok(interfaces.collect())
}

/// Returns `true` if facets that are oriented consistently form closed surfaces and face the space
/// that these enclose.
pub fn is_turned_inwards<const D: usize>(nodes: &[[f64; D]], facets: &[[u32; D]]) -> bool {
    is_closed(facets) && enclosed_volume(nodes, facets) < 0.0
}

/// Returns `true` if facets that are oriented consistently have no rim: in 3-D, triangles run along
/// each edge as often in one direction as in the other; in 2-D, as many edges begin as end at each
/// node.
fn is_closed<const D: usize>(facets: &[[u32; D]]) -> bool {
    let mut balance: Vec<([u32; 2], i32)> = Vec::with_capacity(D * facets.len());
    for facet in facets {
        if D == 2 {
            balance.extend([([facet[0]; 2], 1), ([facet[1]; 2], -1)]);
        } else {
            balance.extend((0..D).map(|k| {
                let (a, b) = (facet[k], facet[(k + 1) % D]);
                ([a.min(b), a.max(b)], if a < b { 1 } else { -1 })
            }));
        }
    }
    balance.sort_unstable();
    let is_balanced =
        |ridge: &[([u32; 2], i32)]| ridge.iter().map(|entry| entry.1).sum::<i32>() == 0;
    !facets.is_empty() && balance.chunk_by(|a, b| a.0 == b.0).all(is_balanced)
}

/// Returns the volume (area in 2-D) that closed surfaces enclose, times the number of dimensions;
/// it is negative if their facets face it. Positions are relative to the first node, because those
/// of maps are large.
fn enclosed_volume<const D: usize>(nodes: &[[f64; D]], facets: &[[u32; D]]) -> f64 {
    let origin = facets
        .first()
        .map_or([0.0; D], |facet| nodes[facet[0] as usize]);
    let cone = |facet: &[u32; D]| {
        let corners = facet.map(|n| nodes[n as usize]);
        dot(sub(corners[0], origin), normal(&corners))
    };
    facets.iter().map(cone).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn the_interfaces_of_a_region_enclose_it() {
        let mut mesh = two_cells::<3>(0.75);
        mesh.region = vec![4, -3];
        let interfaces = region_interfaces(&mesh, &mesh.region, &mesh.nodes, false).unwrap();
        let pairs: Vec<_> = interfaces
            .iter()
            .map(|b| (b.inner_region, b.outer_region))
            .collect();
        assert_eq!(pairs, [(-3, Some(4)), (-3, None), (4, None)]);
        for region in [4, -3] {
            let mut edges = Vec::new();
            for b in &interfaces {
                let is_reversed = b.outer_region == Some(region);
                if b.inner_region != region && !is_reversed {
                    continue;
                }
                for f in &b.facets {
                    for k in 0..3 {
                        let edge = [f[k], f[(k + 1) % 3]];
                        edges.push(if is_reversed {
                            [edge[1], edge[0]]
                        } else {
                            edge
                        });
                    }
                }
            }
            // Every edge occurs once in each direction.
            let opposite_count =
                |e: &[u32; 2]| edges.iter().filter(|o| **o == [e[1], e[0]]).count();
            assert!(
                !edges.is_empty() && edges.iter().all(|e| opposite_count(e) == 1),
                "{edges:?}"
            );
        }
    }

    /// Returns a grid of 7 x 7 x 7 unit cubes, with a region for each cube by its distance (the
    /// largest of the three) from the cube in the middle.
    fn nested_cubes(region: [i32; 4]) -> (crate::mesh::TetMesh, Vec<i32>) {
        let tets = crate::mesh::boxes::kuhn_box([7, 7, 7], 1.0);
        let centre = |tet: &[u32; 4]| {
            let corners = tet.map(|n| tets.nodes[n as usize]);
            [0, 1, 2].map(|k| corners.iter().map(|x| x[k]).sum::<f64>() / 4.0)
        };
        let shell = |tet: &[u32; 4]| {
            let distance = centre(tet).map(|x| (x - 3.5).abs());
            region[(distance.into_iter().fold(0.0, f64::max) + 0.5) as usize]
        };
        let regions = tets.tets.iter().map(shell).collect();
        (tets, regions)
    }

    #[test]
    fn closed_interfaces_face_outwards_from_the_region_that_they_enclose() {
        // Cubes of edges 1, 3 and 5, one in the other, in a box: all pairs of numbers, and a shell
        // on both of whose sides is one region.
        for (region, expected) in [
            ([4, 3, 2, 1], vec![(2, 1, 125.0), (3, 2, 27.0), (4, 3, 1.0)]),
            ([1, 2, 3, 4], vec![(1, 2, 1.0), (2, 3, 27.0), (3, 4, 125.0)]),
            ([0, 0, 7, 0], vec![(7, 0, 125.0 - 27.0)]),
            (
                [i32::MAX, -1, -1, i32::MIN],
                vec![(-1, i32::MIN, 125.0), (i32::MAX, -1, 1.0)],
            ),
        ] {
            let (tets, regions) = nested_cubes(region);
            let mirrored: Vec<[f64; 3]> = tets.nodes.iter().map(|[x, y, z]| [*x, *y, -z]).collect();
            for (nodes, is_mirrored) in [(&tets.nodes, false), (&mirrored, true)] {
                let interfaces = region_interfaces(&tets, &regions, nodes, is_mirrored).unwrap();
                let between = interfaces.iter().filter_map(|b| {
                    let volume = enclosed_volume(nodes, &b.facets) / 3.0;
                    Some((
                        b.inner_region,
                        b.outer_region?,
                        (1e9 * volume).round() / 1e9,
                    ))
                });
                assert_eq!(between.collect::<Vec<_>>(), expected);
            }
        }
    }

    #[test]
    fn open_interfaces_face_the_larger_number() {
        for region in [[4, -3], [-3, 4]] {
            let mut mesh = two_cells::<3>(0.75);
            mesh.region = region.to_vec();
            let interfaces = region_interfaces(&mesh, &mesh.region, &mesh.nodes, false).unwrap();
            let first = &interfaces[0];
            assert_eq!((first.inner_region, first.outer_region), (-3, Some(4)));
            let normal = normal(&first.facets[0].map(|n| mesh.nodes[n as usize]));
            let to_second = mesh.sites[1][0] - mesh.sites[0][0];
            assert!(normal[0] * to_second * f64::from(region[1] - region[0]) > 0.0);
        }
    }
}
