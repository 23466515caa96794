//! The interfaces between every two regions of a mesh, and between regions and the outside.

use std::collections::BTreeMap;

use crate::Result;
use crate::geometry::{norm, normal};
use crate::mesh::Mesh;

/// The interface between two regions.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionInterface<const D: usize> {
    /// The region behind the facets.
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
/// together enclose it without a gap. Areas are measured between `nodes`.
///
/// # Errors
/// Returns [`Error::Mesh`](crate::Error::Mesh) if three cells share a face.
pub fn region_interfaces<const D: usize, M: Mesh<D>>(
    mesh: &M,
    regions: &[i32],
    nodes: &[[f64; D]],
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
            if key.1 != inner {
                facet.swap(0, 1);
            }
            facets.push(facet);
        });
    }
    let area = |facet: &[u32; D]| norm(normal(&facet.map(|n| nodes[n as usize])));
    let interfaces = facets_by_pair
        .into_iter()
        .map(|((is_outside, inside, outside), facets)| RegionInterface {
            inner_region: inside,
            outer_region: (!is_outside).then_some(outside),
            area: facets.iter().map(area).sum(),
            facets,
        });
    Ok(interfaces.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn the_interfaces_of_a_region_enclose_it() {
        let mut mesh = two_cells::<3>(0.75);
        mesh.region = vec![4, -3];
        let interfaces = region_interfaces(&mesh, &mesh.region, &mesh.nodes).unwrap();
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
}
