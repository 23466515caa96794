//! Names the faces of a mesh: each side of the box, each surface, and each interface of two
//! regions.

use std::collections::BTreeMap;

use crate::geometry::sorted_distinct;
use crate::mesh::poly::{FaceNeighbour, Lists};
use crate::model::reservoir::{Model, reserved_names};
use crate::model::surface::SurfaceKind;
use crate::model::surface::names::interface_name;
use crate::model::surface::region_interfaces::region_interfaces;
use crate::names::append_distinct;
use crate::store::named_sets::NamedSet;

/// Number of the faces on the boundary that are on no side of the box.
const BOUNDARY_NUMBER: u32 = 7;
/// Number of the faces on surface fragments, which are too small to be surfaces of their own.
const FRAGMENTS_NUMBER: u32 = 8;
/// Number of names that every mesh has: the sides, `boundary` and `scraps`.
pub const PROGRAM_NAME_COUNT: usize = FRAGMENTS_NUMBER as usize;

/// Names of the faces of a mesh.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FaceNames {
    /// Names by number, from 1: the sides `xmin` ... `zmax`, `boundary`, `scraps`; then the
    /// surfaces with number 8 + their own (`fault1`, `horizon2` ..., or their names in the mesh
    /// file); then interfaces such as `interface_1_2` between regions 1 and 2, for faces on no
    /// surface, or if regions are labels.
    pub names: Vec<String>,
    /// Number of the name of each face; 0 for none.
    pub face_numbers: Vec<u32>,
    /// Number of the first name of a set of faces in the mesh file. These names come last.
    pub first_set_number: u32,
    /// Sets of faces: the number of the name, and the faces. They overlap one another and the faces
    /// above.
    pub sets: Vec<(u32, Vec<u32>)>,
    /// `true` for each face between two cells that is written as the side of its second cell.
    is_of_second_cell: Vec<bool>,
}

/// Faces with the same name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FaceGroup {
    /// Name of the group, one of [`FaceNames::names`].
    pub name: String,
    /// Number of the name, from 1.
    pub number: usize,
    /// Faces of the group.
    pub faces: Vec<u32>,
}

impl FaceNames {
    /// Names the faces of a model.
    pub fn new(model: &Model) -> Self {
        let (mesh, surfaces) = (&model.mesh, &model.surfaces);
        let mut names = reserved_names();
        names.extend(surfaces.all_names().names);

        let regions = |f: usize| {
            let mut pair = mesh.face_cells[f].map(|cell| mesh.region[cell as usize]);
            pair.sort_unstable();
            (pair[0] != pair[1]).then_some(pair)
        };
        // Interfaces of labels are named after the labels, unless their surface has a name of its
        // own.
        let uses_labels = !model.labels.is_empty() && model.split_mesh.is_none();
        let surface_of = |f: usize| {
            let surface = surfaces.connection_surfaces.get(f).copied().unwrap_or(0);
            if uses_labels && surface as usize > surfaces.names.len() {
                0
            } else {
                surface
            }
        };
        let unnamed_faces = (0..mesh.inner_face_count()).filter(|&f| surface_of(f) == 0);
        let pairs = sorted_distinct(unnamed_faces.filter_map(regions));
        let known_count = names.len() as u32;
        let interfaces = pairs.iter().map(|pair| {
            let [a, b] = pair.map(|region| model.region_label(region));
            interface_name([&a, &b])
        });
        append_distinct(&mut names, interfaces);

        let mut is_in_set = vec![false; mesh.face_cells.len()];
        let members = model.sets.faces.iter().flat_map(|set| &set.members);
        members.for_each(|&f| is_in_set[f as usize] = true);
        let number = |f: usize| match mesh.face_neighbour(f) {
            FaceNeighbour::Side(side) => side as u32 + 1,
            // The faces at which cells were left out belong to sets.
            FaceNeighbour::Unknown if is_in_set[f] => 0,
            FaceNeighbour::Unknown => BOUNDARY_NUMBER,
            FaceNeighbour::Cell(_) => match surface_of(f) {
                0 => regions(f).map_or(0, |pair| {
                    known_count + 1 + pairs.partition_point(|known| *known < pair) as u32
                }),
                surface if surface as usize <= surfaces.kept_count => FRAGMENTS_NUMBER + surface,
                _ => FRAGMENTS_NUMBER,
            },
        };
        let mut face_names = Self {
            face_numbers: (0..mesh.face_cells.len()).map(number).collect(),
            first_set_number: names.len() as u32 + 1,
            names,
            sets: Vec::new(),
            is_of_second_cell: sides_of_second_cells(model, surface_of),
        };
        model
            .sets
            .faces
            .iter()
            .for_each(|set| face_names.add_set(set));
        face_names
    }

    /// Adds a set of faces. Faces with its name are part of it, if it has all of them.
    fn add_set(&mut self, set: &NamedSet) {
        let known = self.names.iter().position(|name| *name == set.name);
        let number = known.map_or(0, |index| index as u32 + 1);
        let numbered = (0..).zip(&self.face_numbers);
        let mut faces = numbered.filter(|(_, n)| **n == number).map(|(f, _)| f);
        let is_part = |face: u32| set.members.binary_search(&face).is_ok();
        let is_own_set = number >= self.first_set_number;
        if number > 0 && !is_own_set && faces.all(is_part) {
            self.sets.push((number, set.members.clone()));
            return;
        }
        append_distinct(&mut self.names, std::iter::once(set.name.clone()));
        self.sets
            .push((self.names.len() as u32, set.members.clone()));
    }

    /// Gives each face to one name, for formats in which a face has only one. Sets take faces from the
    /// sides of the box and from interfaces, and small sets take faces from large ones. Returns the
    /// names that lose faces.
    pub fn separate(&mut self, surface_count: usize) -> Vec<String> {
        let mut sets = std::mem::take(&mut self.sets);
        sets.sort_by_key(|(number, faces)| (std::cmp::Reverse(faces.len()), *number));
        let surfaces = FRAGMENTS_NUMBER + 1..=FRAGMENTS_NUMBER + surface_count as u32;
        let mut losers = Vec::new();
        for (number, faces) in sets {
            for face in faces {
                let owner = &mut self.face_numbers[face as usize];
                if *owner == number {
                    continue;
                }
                let loser = if surfaces.contains(owner) {
                    number
                } else {
                    std::mem::replace(owner, number)
                };
                losers.push(loser);
            }
        }
        let losers = sorted_distinct(losers.into_iter().filter(|&number| number > 0));
        losers
            .into_iter()
            .map(|n| self.name(n).to_string())
            .collect()
    }

    /// Returns `true` if a face between two cells is written as the side of its second cell, so that
    /// its nodes are in reverse order.
    pub fn is_of_second_cell(&self, face: u32) -> bool {
        let flag = self.is_of_second_cell.get(face as usize);
        flag.copied().unwrap_or(false)
    }

    /// Returns a face as the side of one of its cells: the cell, and the nodes, anticlockwise seen
    /// from outside the cell. All faces of a name are sides of the same side of its surface: of the
    /// region that an interface encloses, or else of the region with the smaller number; of the cells
    /// below a fault or a horizon, or inside it if it is closed; and of the cell at the boundary.
    pub fn side(&self, model: &Model, face: u32) -> (u32, Vec<u32>) {
        let mesh = &model.mesh;
        let mut ring = mesh.faces.get(face as usize).to_vec();
        let is_reversed = self.is_of_second_cell(face);
        if is_reversed {
            ring.reverse();
        }
        (
            mesh.face_cells[face as usize][usize::from(is_reversed)],
            ring,
        )
    }

    /// Returns the number of the name of a surface. Surfaces are numbered as in
    /// [`FaceSurfaces`](crate::model::reservoir::FaceSurfaces).
    pub fn surface_number(&self, model: &Model, surface: u32) -> u32 {
        if surface as usize <= model.surfaces.kept_count {
            FRAGMENTS_NUMBER + surface
        } else {
            FRAGMENTS_NUMBER
        }
    }

    /// Returns the numbers of the names of the surfaces along which a model is split, ascending by
    /// surface.
    pub fn split_numbers(&self, model: &Model) -> Vec<u32> {
        let faces = model.split_mesh.iter().flat_map(|split| &split.faces);
        let mut numbers: Vec<u32> = sorted_distinct(faces.map(|face| face.label))
            .into_iter()
            .map(|label| self.surface_number(model, label))
            .collect();
        numbers.dedup();
        numbers
    }

    /// Returns the name with the given number, from 1.
    pub fn name(&self, number: u32) -> &str {
        &self.names[number as usize - 1]
    }

    /// Returns the groups that have faces.
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
        for (number, set) in &self.sets {
            let faces = &mut faces[*number as usize - 1];
            faces.extend(set);
            *faces = sorted_distinct(std::mem::take(faces));
        }
        let numbered = (1..).zip(&self.names).zip(faces);
        numbered
            .filter(|(_, faces)| !faces.is_empty())
            .map(|((number, name), faces)| FaceGroup {
                name: name.clone(),
                number,
                faces,
            })
            .collect()
    }
}

/// Sides of cells that have a name.
pub struct NamedSides {
    /// Name in the file.
    pub name: String,
    /// Number of the name, from 1, which is unique.
    pub number: usize,
    /// Nodes of each side, anticlockwise seen from outside its cell.
    pub sides: Lists,
    /// Cell of each side, as [`FaceNames::side`] chooses it.
    pub cells: Vec<u32>,
}

impl NamedSides {
    /// Creates a group without sides.
    pub fn new(name: String, number: usize) -> Self {
        Self {
            name,
            number,
            sides: Lists::default(),
            cells: Vec::new(),
        }
    }

    /// Returns the named sides of a model, for its cells of any shape.
    pub fn from_model(model: &Model, names: &FaceNames) -> Vec<Self> {
        let to_sides = |group: FaceGroup| {
            let mut result = Self::new(group.name, group.number);
            for f in group.faces {
                let (cell, ring) = names.side(model, f);
                result.sides.push(ring);
                result.cells.push(cell);
            }
            result
        };
        names.groups().into_iter().map(to_sides).collect()
    }
}

/// Returns for each face between two cells whether it is written as the side of its second cell. An
/// interface between regions is directed by its regions, as [`region_interfaces`] decides it; any
/// other surface by its upper side. `surface_of` returns the number of the surface of a face, 0 for
/// none.
fn sides_of_second_cells(model: &Model, surface_of: impl Fn(usize) -> u32) -> Vec<bool> {
    let mesh = &model.mesh;
    let regions = |f: usize| mesh.face_cells[f].map(|cell| mesh.region[cell as usize]);
    let is_interface = |f: usize| {
        let [first, second] = regions(f);
        let kind = (surface_of(f) as usize).checked_sub(1);
        let kind = kind.and_then(|index| model.surfaces.kinds.get(index));
        first != second && kind.is_none_or(|kind| *kind == SurfaceKind::Interface)
    };
    let inner_faces = 0..mesh.inner_face_count();
    let mut inner_regions = BTreeMap::new();
    if inner_faces.clone().any(is_interface) {
        // A mesh with a face of three cells is refused elsewhere.
        let interfaces = region_interfaces(mesh, &mesh.region, &mesh.nodes, false);
        for interface in interfaces.unwrap_or_default() {
            if let Some(outer) = interface.outer_region {
                let inner = interface.inner_region;
                inner_regions.insert([inner.min(outer), inner.max(outer)], inner);
            }
        }
    }
    let second_is_upper = model.second_cell_is_upper();
    let is_of_second = |f: usize| {
        if is_interface(f) {
            let [first, second] = regions(f);
            let pair = [first.min(second), first.max(second)];
            inner_regions.get(&pair) == Some(&second)
        } else {
            !second_is_upper.get(f).is_none_or(|is_upper| *is_upper)
        }
    };
    inner_faces.map(is_of_second).collect()
}

/// Returns the regions of a model, ascending.
pub fn sorted_regions(model: &Model) -> Vec<i32> {
    sorted_distinct(model.mesh.region.iter().copied())
}

/// Returns the number of each region in formats where numbers begin with 1 and are at most `limit`.
/// Regions keep their numbers if they can. Otherwise all numbers are moved up so that the lowest is 1,
/// or, if the largest is then above `limit`, regions are numbered 1, 2, 3 ... in ascending order.
pub fn region_numbers(model: &Model, limit: i32) -> BTreeMap<i32, i32> {
    let regions = sorted_regions(model);
    let [Some(&lowest), Some(&largest)] = [regions.first(), regions.last()] else {
        return BTreeMap::new();
    };
    let shift = (1 - i64::from(lowest)).max(0);
    let can_be_moved = i64::from(largest) + shift <= i64::from(limit);
    let number = |(at, region): (i32, i32)| {
        let moved = (i64::from(region) + shift) as i32;
        (region, if can_be_moved { moved } else { at })
    };
    (1..).zip(regions).map(number).collect()
}

/// Returns the nodes of faces, ascending, without duplicates.
pub fn face_nodes(model: &Model, faces: &[u32]) -> Vec<u32> {
    let rings = faces.iter().flat_map(|&f| model.mesh.faces.get(f as usize));
    sorted_distinct(rings.copied())
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
        let summaries = |model: &Model| {
            let groups = FaceNames::new(model).groups();
            let groups: Vec<(String, usize, usize)> = groups
                .into_iter()
                .map(|g| (g.name, g.number, g.faces.len()))
                .collect();
            groups
        };
        let fault = summaries(&model);
        let sides = SIDE_NAMES.iter().zip([1, 1, 2, 2, 2, 2]);
        for ((side, faces), (index, actual)) in sides.zip(fault.iter().enumerate()) {
            assert_eq!(actual, &(side.to_string(), index + 1, faces));
        }
        assert_eq!(fault[6], ("fault1".into(), 9, 1));
        model.surfaces.kinds = vec![SurfaceKind::Horizon];
        assert_eq!(summaries(&model)[6], ("horizon1".into(), 9, 1));
        model.surfaces.kept_count = 0;
        assert_eq!(summaries(&model)[6], ("scraps".into(), 8, 1));
        model.surfaces.connection_surfaces = vec![0];
        assert_eq!(summaries(&model)[6], ("interface_0_1".into(), 9, 1));
        model.mesh.region = vec![4, -3];
        assert_eq!(summaries(&model)[6], ("interface_-3_4".into(), 9, 1));
        model.mesh.region = vec![4, 4];
        assert_eq!(summaries(&model).len(), 6);
        // Surfaces keep names of their own, changed only where other faces have the same name.
        model.surfaces.connection_surfaces = vec![1];
        model.surfaces.kept_count = 1;
        for (stored_name, name) in [("Main-fault", "Main-fault"), ("xmin", "xmin_2")] {
            model.surfaces.names = vec![stored_name.into()];
            assert_eq!(summaries(&model)[6], (name.into(), 9, 1));
        }
    }
}
