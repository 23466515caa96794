//! The faces of a mesh that have names: each side of the box, each surface, and what parts two regions.

use crate::mesh::poly::{Beyond, Lists};
use crate::model::reservoir::{Model, reserved};
use crate::model::surface::names::{add_names, interface_name};
use crate::model::surface::stored::region_text;

/// The number of what is on the boundary, but on no side of the box.
const BOUNDARY: u32 = 7;
/// The number of what lies on features, but is too small for a surface.
const SCRAPS: u32 = 8;

/// The names of a mesh's faces.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Names {
    /// By number, from 1 on: the sides `xmin` ... `zmax`, `boundary`, `scraps`; then the surfaces `fault1`,
    /// `horizon2` ..., or as the mesh's file calls them, number 8 + theirs; then `interface_1_2` between regions 1 and 2, where that is on no
    /// surface, or where regions are labels.
    pub names: Vec<String>,
    /// The number of each face's name; 0 for none.
    pub of_face: Vec<u32>,
}

/// Faces of one name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// As in [`Names::names`].
    pub name: String,
    /// Number of the name, from 1 on.
    pub number: usize,
    /// The faces.
    pub faces: Vec<u32>,
}

impl Names {
    /// The names of a model's faces.
    pub fn new(model: &Model) -> Self {
        let (mesh, surfaces) = (&model.mesh, &model.surfaces);
        let mut names = reserved();
        names.extend(surfaces.all_names().names);

        let regions = |f: usize| {
            let mut pair = mesh.face_cells[f].map(|cell| mesh.region[cell as usize]);
            pair.sort_unstable();
            (pair[0] != pair[1]).then_some(pair)
        };
        // What parts labels has their names, unless it has one of its own.
        let labelled = !model.labels.is_empty() && model.torn.is_none();
        let surface_of = |f: usize| {
            let surface = surfaces.of_connection.get(f).copied().unwrap_or(0);
            match labelled && surface as usize > surfaces.names.len() {
                true => 0,
                false => surface,
            }
        };
        let bare = (0..mesh.inner_faces()).filter(|&f| surface_of(f) == 0);
        let mut pairs: Vec<[i32; 2]> = bare.filter_map(regions).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let before = names.len() as u32;
        let interfaces = pairs.iter().map(|pair| {
            let [a, b] = pair.map(|region| region_text(&model.labels, region));
            interface_name([&a, &b])
        });
        add_names(&mut names, interfaces);

        let number = |f: usize| match mesh.beyond(f) {
            Beyond::Side(side) => side as u32 + 1,
            Beyond::Nothing => BOUNDARY,
            Beyond::Cell(_) => match surface_of(f) {
                0 => regions(f).map_or(0, |pair| {
                    before + 1 + pairs.partition_point(|known| *known < pair) as u32
                }),
                surface if surface as usize <= surfaces.kept => SCRAPS + surface,
                _ => SCRAPS,
            },
        };
        Self {
            of_face: (0..mesh.face_cells.len()).map(number).collect(),
            names,
        }
    }

    /// The number of a surface's name, as [`FaceSurfaces`](crate::model::reservoir::FaceSurfaces) counts
    /// surfaces.
    pub fn of_surface(&self, model: &Model, surface: u32) -> u32 {
        match surface as usize <= model.surfaces.kept {
            true => SCRAPS + surface,
            false => SCRAPS,
        }
    }

    /// The name of a number, from 1 on.
    pub fn name(&self, number: u32) -> &str {
        &self.names[number as usize - 1]
    }

    /// The groups that have faces.
    pub fn groups(&self) -> Vec<Group> {
        let mut faces: Vec<Vec<u32>> = vec![Vec::new(); self.names.len()];
        for (f, &number) in self.of_face.iter().enumerate().filter(|(_, n)| **n > 0) {
            faces[number as usize - 1].push(f as u32);
        }
        let named = (1..).zip(&self.names).zip(faces);
        named
            .filter(|(_, faces)| !faces.is_empty())
            .map(|((number, name), faces)| Group {
                name: name.clone(),
                number,
                faces,
            })
            .collect()
    }
}

/// The groups of a model that have faces.
pub fn groups(model: &Model) -> Vec<Group> {
    Names::new(model).groups()
}

/// Sides of cells that have a name.
pub struct Named {
    /// As [`Names`] has it; the two sides of a surface along which the mesh is torn end in `_a` (the lower
    /// one) and `_b`.
    pub name: String,
    /// Its number, from 1 on; no other name has it.
    pub number: usize,
    /// The nodes of each side, turning anticlockwise seen from outside its cell.
    pub sides: Lists,
    /// The cell that each is seen from: of a surface the one below it.
    pub cells: Vec<u32>,
}

impl Named {
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
    pub fn of(model: &Model) -> Vec<Self> {
        let rises = model.rises();
        let named = |group: Group| {
            let mut named = Self::new(group.name, group.number);
            for f in group.faces {
                let (cell, ring) = seen_from_below(model, &rises, f);
                named.sides.push(ring);
                named.cells.push(cell);
            }
            named
        };
        groups(model).into_iter().map(named).collect()
    }
}

/// A face as one of its cells has it, anticlockwise seen from outside that: of a surface the cell below it,
/// else the first. `rises` are those of [`Model::rises`].
pub fn seen_from_below(model: &Model, rises: &[bool], face: u32) -> (u32, Vec<u32>) {
    let mesh = &model.mesh;
    let mut ring = mesh.faces.get(face as usize).to_vec();
    let above = rises.get(face as usize).is_some_and(|rises| !rises);
    if above {
        ring.reverse();
    }
    (mesh.face_cells[face as usize][usize::from(above)], ring)
}

/// The regions of a model, ascending.
pub fn regions(model: &Model) -> Vec<i32> {
    let mut regions = model.mesh.region.clone();
    regions.sort_unstable();
    regions.dedup();
    regions
}

/// What is added to regions where numbers begin with 1: nothing if they do.
pub fn shift_of_regions(model: &Model) -> i64 {
    let least = model.mesh.region.iter().min().copied().unwrap_or(1);
    (1 - i64::from(least)).max(0)
}

/// A name of a region for formats that take letters, digits and _ only.
pub fn region_name(model: &Model, region: i32) -> String {
    let name = name_of(model, region).map(String::from);
    name.unwrap_or_else(|| format!("region{region}"))
        .replace('-', "_")
}

/// What the label that a region is is called.
fn name_of(model: &Model, region: i32) -> Option<&str> {
    let label = model.labels.iter().find(|label| label.region == region);
    label.and_then(|label| label.name.as_deref())
}

/// The nodes of faces, ascending, each once.
pub fn nodes_of(model: &Model, faces: &[u32]) -> Vec<u32> {
    let rings = faces.iter().flat_map(|&f| model.mesh.faces.get(f as usize));
    let mut nodes: Vec<u32> = rings.copied().collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::SIDES;
    use crate::mesh::poly::samples::two_cells;
    use crate::model::surface::Kind;

    #[test]
    fn every_face_between_regions_and_on_the_box_has_a_name() {
        let mut model = Model::new(two_cells::<3>(0.75), None);
        let named = |model: &Model| {
            let groups = groups(model);
            let named: Vec<(String, usize, usize)> = groups
                .into_iter()
                .map(|g| (g.name, g.number, g.faces.len()))
                .collect();
            named
        };
        let fault = named(&model);
        let sides = SIDES.iter().zip([1, 1, 2, 2, 2, 2]);
        for ((side, faces), (at, found)) in sides.zip(fault.iter().enumerate()) {
            assert_eq!(found, &(side.to_string(), at + 1, faces));
        }
        assert_eq!(fault[6], ("fault1".into(), 9, 1));
        model.surfaces.kinds = vec![Kind::Horizon];
        assert_eq!(named(&model)[6], ("horizon1".into(), 9, 1));
        model.surfaces.kept = 0;
        assert_eq!(named(&model)[6], ("scraps".into(), 8, 1));
        model.surfaces.of_connection = vec![0];
        assert_eq!(named(&model)[6], ("interface_0_1".into(), 9, 1));
        model.mesh.region = vec![4, -3];
        assert_eq!(named(&model)[6], ("interface__3_4".into(), 9, 1));
        model.mesh.region = vec![4, 4];
        assert_eq!(named(&model).len(), 6);
        // Surfaces that have names of their own keep them, but for those of others.
        model.surfaces.of_connection = vec![1];
        model.surfaces.kept = 1;
        for (own, name) in [("Main-fault", "Main_fault"), ("xmin", "xmin_")] {
            model.surfaces.names = vec![own.into()];
            assert_eq!(named(&model)[6], (name.into(), 9, 1));
        }
    }
}
