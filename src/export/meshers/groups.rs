//! The faces of a mesh that have names: each side of the box, and what lies on features.

use crate::mesh::poly::{Beyond, PolyMesh, SIDES};

/// Faces of one name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// `xmin`, `xmax` ... `boundary`, or `features`.
    pub name: &'static str,
    /// Number of the name, from 1 on: the sides 1 to 6, `boundary` 7, `features` 8.
    pub number: usize,
    /// The faces.
    pub faces: Vec<u32>,
}

/// All names.
const NAMES: [&str; 8] = [
    SIDES[0], SIDES[1], SIDES[2], SIDES[3], SIDES[4], SIDES[5], "boundary", "features",
];

/// The groups that have faces.
pub fn groups(mesh: &PolyMesh<3>) -> Vec<Group> {
    let mut faces: [Vec<u32>; 8] = Default::default();
    for f in 0..mesh.face_cells.len() {
        let group = match mesh.beyond(f) {
            Beyond::Side(side) => Some(side),
            Beyond::Nothing => Some(6),
            Beyond::Cell(_) => mesh.on_feature[f].then_some(7),
        };
        if let Some(group) = group {
            faces[group].push(f as u32);
        }
    }
    let named = NAMES.iter().zip(1..).zip(faces);
    named
        .filter(|(_, faces)| !faces.is_empty())
        .map(|((&name, number), faces)| Group {
            name,
            number,
            faces,
        })
        .collect()
}

/// The regions of a mesh, ascending.
pub fn regions(mesh: &PolyMesh<3>) -> Vec<i32> {
    let mut regions = mesh.region.clone();
    regions.sort_unstable();
    regions.dedup();
    regions
}

/// A name of a region for formats that take letters, digits and _ only.
pub fn region_name(region: i32) -> String {
    format!("region{region}").replace('-', "_")
}
