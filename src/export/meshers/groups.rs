//! The faces of a mesh that have names: each side of the box, each surface, and what parts two regions.

use crate::mesh::poly::{FaceNeighbour, Lists};
use crate::model::reservoir::{Model, reserved_names};
use crate::model::surface::names::{add_names, interface_name};
use crate::model::surface::stored_surfaces::region_label;

/// The number of what is on the boundary, but on no side of the box.
const BOUNDARY_NUMBER: u32 = 7;
/// The number of what lies on features, but is too small for a surface.
const SCRAPS_NUMBER: u32 = 8;

/// The names of a mesh's faces.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FaceNames {
    /// By number, from 1 on: the sides `xmin` ... `zmax`, `boundary`, `scraps`; then the surfaces `fault1`,
    /// `horizon2` ..., or as the mesh's file calls them, number 8 + theirs; then `interface_1_2` between regions 1 and 2, where that is on no
    /// surface, or where regions are labels.
    pub names: Vec<String>,
    /// The number of each face's name; 0 for none.
    pub face_numbers: Vec<u32>,
}

/// Faces of one name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FaceGroup {
    /// As in [`FaceNames::surface_names`].
    pub name: String,
    /// Number of the name, from 1 on.
    pub number: usize,
    /// The faces.
    pub faces: Vec<u32>,
}

impl FaceNames {
    /// The names of a model's faces.
    pub fn new(model: &Model) -> Self {
        let (mesh, surfaces) = (&model.mesh, &model.surfaces);
        let mut names = reserved_names();
        names.extend(surfaces.all_names().names);

        let regions = |f: usize| {
            let mut pair = mesh.face_cells[f].map(|cell| mesh.region[cell as usize]);
            pair.sort_unstable();
            (pair[0] != pair[1]).then_some(pair)
        };
        // What parts labels has their names, unless it has one of its own.
        let labelled = !model.labels.is_empty() && model.split_mesh.is_none();
        let surface_of = |f: usize| {
            let surface = surfaces.connection_surfaces.get(f).copied().unwrap_or(0);
            match labelled && surface as usize > surfaces.names.len() {
                true => 0,
                false => surface,
            }
        };
        let bare = (0..mesh.inner_face_count()).filter(|&f| surface_of(f) == 0);
        let mut pairs: Vec<[i32; 2]> = bare.filter_map(regions).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let before = names.len() as u32;
        let interfaces = pairs.iter().map(|pair| {
            let [a, b] = pair.map(|region| region_label(&model.labels, region));
            interface_name([&a, &b])
        });
        add_names(&mut names, interfaces);

        let number = |f: usize| match mesh.face_neighbour(f) {
            FaceNeighbour::Side(side) => side as u32 + 1,
            FaceNeighbour::Unknown => BOUNDARY_NUMBER,
            FaceNeighbour::Cell(_) => match surface_of(f) {
                0 => regions(f).map_or(0, |pair| {
                    before + 1 + pairs.partition_point(|known| *known < pair) as u32
                }),
                surface if surface as usize <= surfaces.kept_count => SCRAPS_NUMBER + surface,
                _ => SCRAPS_NUMBER,
            },
        };
        Self {
            face_numbers: (0..mesh.face_cells.len()).map(number).collect(),
            names,
        }
    }

    /// The number of a surface's name, as [`FaceSurfaces`](crate::model::reservoir::FaceSurfaces) counts
    /// surfaces.
    pub fn surface_number(&self, model: &Model, surface: u32) -> u32 {
        match surface as usize <= model.surfaces.kept_count {
            true => SCRAPS_NUMBER + surface,
            false => SCRAPS_NUMBER,
        }
    }

    /// The name of a number, from 1 on.
    pub fn name(&self, number: u32) -> &str {
        &self.names[number as usize - 1]
    }

    /// The groups that have faces.
    pub fn groups(&self) -> Vec<FaceGroup> {
        let mut faces: Vec<Vec<u32>> = vec![Vec::new(); self.names.len()];
        for (f, &number) in self
            .face_numbers
            .iter()
            .enumerate()
            .filter(|(_, n)| **n > 0)
        {
            faces[number as usize - 1].push(f as u32);
        }
        let named = (1..).zip(&self.names).zip(faces);
        named
            .filter(|(_, faces)| !faces.is_empty())
            .map(|((number, name), faces)| FaceGroup {
                name: name.clone(),
                number,
                faces,
            })
            .collect()
    }
}

/// The groups of a model that have faces.
pub fn face_groups(model: &Model) -> Vec<FaceGroup> {
    FaceNames::new(model).groups()
}

/// Sides of cells that have a name.
pub struct NamedSides {
    /// As [`FaceNames`] has it; the two sides of a surface along which the mesh is torn end in `_a` (the lower
    /// one) and `_b`.
    pub name: String,
    /// Its number, from 1 on; no other name has it.
    pub number: usize,
    /// The nodes of each side, turning anticlockwise seen from outside its cell.
    pub sides: Lists,
    /// The cell that each is seen from: of a surface the one below it.
    pub cells: Vec<u32>,
}

impl NamedSides {
    /// A name that has nothing yet.
    pub fn new(name: String, number: usize) -> Self {
        Self {
            name,
            number,
            sides: Lists::default(),
            cells: Vec::new(),
        }
    }

    /// All that have a name in a model, as its cells of any shape have them.
    pub fn from_model(model: &Model) -> Vec<Self> {
        let rises = model.second_cell_is_upper();
        let named = |group: FaceGroup| {
            let mut named = Self::new(group.name, group.number);
            for f in group.faces {
                let (cell, ring) = face_from_below(model, &rises, f);
                named.sides.push(ring);
                named.cells.push(cell);
            }
            named
        };
        face_groups(model).into_iter().map(named).collect()
    }
}

/// A face as one of its cells has it, anticlockwise seen from outside that: of a surface the cell below it,
/// else the first. `rises` are those of [`Model::second_cell_is_upper`].
pub fn face_from_below(model: &Model, rises: &[bool], face: u32) -> (u32, Vec<u32>) {
    let mesh = &model.mesh;
    let mut ring = mesh.faces.get(face as usize).to_vec();
    let above = rises.get(face as usize).is_some_and(|rises| !rises);
    if above {
        ring.reverse();
    }
    (mesh.face_cells[face as usize][usize::from(above)], ring)
}

/// The regions of a model, ascending.
pub fn sorted_regions(model: &Model) -> Vec<i32> {
    let mut regions = model.mesh.region.clone();
    regions.sort_unstable();
    regions.dedup();
    regions
}

/// What is added to regions where numbers begin with 1: nothing if they do.
pub fn region_shift(model: &Model) -> i64 {
    let least = model.mesh.region.iter().min().copied().unwrap_or(1);
    (1 - i64::from(least)).max(0)
}

/// A name of a region for formats that take letters, digits and _ only.
pub fn region_name(model: &Model, region: i32) -> String {
    let name = label_name(model, region).map(String::from);
    name.unwrap_or_else(|| format!("region{region}"))
        .replace('-', "_")
}

/// What the label that a region is is called.
fn label_name(model: &Model, region: i32) -> Option<&str> {
    let label = model.labels.iter().find(|label| label.region == region);
    label.and_then(|label| label.name.as_deref())
}

/// The nodes of faces, ascending, each once.
pub fn face_nodes(model: &Model, faces: &[u32]) -> Vec<u32> {
    let rings = faces.iter().flat_map(|&f| model.mesh.faces.get(f as usize));
    let mut nodes: Vec<u32> = rings.copied().collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::SIDE_NAMES;
    use crate::mesh::poly::samples::two_cells;
    use crate::model::surface::SurfaceKind;

    #[test]
    fn every_face_between_regions_and_on_the_box_has_a_name() {
        let mut model = Model::new(two_cells::<3>(0.75), None);
        let named = |model: &Model| {
            let groups = face_groups(model);
            let named: Vec<(String, usize, usize)> = groups
                .into_iter()
                .map(|g| (g.name, g.number, g.faces.len()))
                .collect();
            named
        };
        let fault = named(&model);
        let sides = SIDE_NAMES.iter().zip([1, 1, 2, 2, 2, 2]);
        for ((side, faces), (at, found)) in sides.zip(fault.iter().enumerate()) {
            assert_eq!(found, &(side.to_string(), at + 1, faces));
        }
        assert_eq!(fault[6], ("fault1".into(), 9, 1));
        model.surfaces.kinds = vec![SurfaceKind::Horizon];
        assert_eq!(named(&model)[6], ("horizon1".into(), 9, 1));
        model.surfaces.kept_count = 0;
        assert_eq!(named(&model)[6], ("scraps".into(), 8, 1));
        model.surfaces.connection_surfaces = vec![0];
        assert_eq!(named(&model)[6], ("interface_0_1".into(), 9, 1));
        model.mesh.region = vec![4, -3];
        assert_eq!(named(&model)[6], ("interface__3_4".into(), 9, 1));
        model.mesh.region = vec![4, 4];
        assert_eq!(named(&model).len(), 6);
        // Surfaces that have names of their own keep them, but for those of others.
        model.surfaces.connection_surfaces = vec![1];
        model.surfaces.kept_count = 1;
        for (own, name) in [("Main-fault", "Main_fault"), ("xmin", "xmin_")] {
            model.surfaces.names = vec![own.into()];
            assert_eq!(named(&model)[6], (name.into(), 9, 1));
        }
    }
}
