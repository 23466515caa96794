//! The surfaces between every two regions of a mesh, and between regions and what is outside.

use std::collections::BTreeMap;

use crate::Result;
use crate::geometry::{norm, normal};
use crate::mesh::Mesh;

/// What two regions share.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionInterface<const D: usize> {
    /// The region that its facets turn their backs on.
    pub inner_region: i32,
    /// The region that they face; `None` at the sides of the mesh.
    pub outer_region: Option<i32>,
    /// Its facets.
    pub facets: Vec<[u32; D]>,
    /// Their area (in 2-D length).
    pub area: f64,
}

/// What every two regions share, by the smaller and then by the larger number; what regions share with the
/// outside comes last. All that is of one region encloses it without a gap. `nodes` are those by which
/// areas are measured.
///
/// # Errors
/// [`Error::Mesh`](crate::Error::Mesh) if three cells share a face.
pub fn region_interfaces<const D: usize, M: Mesh<D>>(
    mesh: &M,
    regions: &[i32],
    nodes: &[[f64; D]],
) -> Result<Vec<RegionInterface<D>>> {
    let mut found: BTreeMap<(bool, i32, i32), Vec<[u32; D]>> = BTreeMap::new();
    for (face, cells) in mesh.cells_of_faces()?.into_iter().enumerate() {
        let [Some(&own), beyond] = cells.map(|c| regions.get(c as usize)) else {
            continue;
        };
        let beyond = beyond.copied();
        if beyond == Some(own) {
            continue;
        }
        let key = match beyond {
            Some(beyond) => (false, own.min(beyond), own.max(beyond)),
            None => (true, own, own),
        };
        let facets = found.entry(key).or_default();
        mesh.facets(face, |mut facet| {
            if key.1 != own {
                facet.swap(0, 1);
            }
            facets.push(facet);
        });
    }
    let area = |facet: &[u32; D]| norm(normal(&facet.map(|n| nodes[n as usize])));
    let made = found
        .into_iter()
        .map(|((open, inside, outside), facets)| RegionInterface {
            inner_region: inside,
            outer_region: (!open).then_some(outside),
            area: facets.iter().map(area).sum(),
            facets,
        });
    Ok(made.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn the_surfaces_of_a_region_enclose_it() {
        let mut mesh = two_cells::<3>(0.75);
        mesh.region = vec![4, -3];
        let found = region_interfaces(&mesh, &mesh.region, &mesh.nodes).unwrap();
        let pairs: Vec<_> = found
            .iter()
            .map(|b| (b.inner_region, b.outer_region))
            .collect();
        assert_eq!(pairs, [(-3, Some(4)), (-3, None), (4, None)]);
        for region in [4, -3] {
            let mut edges = Vec::new();
            for b in &found {
                let turned = b.outer_region == Some(region);
                if b.inner_region != region && !turned {
                    continue;
                }
                for f in &b.facets {
                    for k in 0..3 {
                        let edge = [f[k], f[(k + 1) % 3]];
                        edges.push(if turned { [edge[1], edge[0]] } else { edge });
                    }
                }
            }
            // Every edge is passed once in each direction.
            let back = |e: &[u32; 2]| edges.iter().filter(|o| **o == [e[1], e[0]]).count();
            assert!(
                !edges.is_empty() && edges.iter().all(|e| back(e) == 1),
                "{edges:?}"
            );
        }
    }
}
