//! Groups of elements, as finite-element formats have them, become regions, surfaces and sets.
//!
//! An element may be in several groups. Cells that are in the same groups are one region, so regions
//! never overlap. A region has the name of its most specific group, the one with the fewest cells.
//! A group that is not exactly one region is a set of cells, too. Faces are treated likewise: a face
//! inside the mesh is on the surface of its most specific group, and a group that is not exactly one
//! surface is a set of faces.

use std::collections::{BTreeMap, BTreeSet};

use super::{FRAGMENTS_NAME, assign_regions};
use crate::geometry::sorted_distinct;
use crate::mesh::poly::Lists;
use crate::store::named_sets::{FaceSet, NamedSet};

/// A group of elements of one dimension.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// A physical group or a block, by its number.
    Physical(i32),
    /// A side set or a node set, by its number.
    Set(i32),
    /// The geometric entity of elements that are in no group.
    Entity(i32),
}

impl Group {
    fn number(self) -> i32 {
        match self {
            Self::Physical(number) | Self::Set(number) | Self::Entity(number) => number,
        }
    }

    /// Returns `true` if a user made the group.
    fn is_given(self) -> bool {
        !matches!(self, Self::Entity(_))
    }
}

/// The names of groups of one dimension, without those that have none.
pub type GroupNames = BTreeMap<Group, String>;

/// Combinations of groups. Elements store the number of their combination.
#[derive(Debug, Default)]
pub struct Combinations {
    groups: Vec<Vec<Group>>,
    numbers: BTreeMap<Vec<Group>, u32>,
}

impl Combinations {
    /// Returns the number of a combination.
    pub fn number(&mut self, groups: &[Group]) -> u32 {
        if let Some(&number) = self.numbers.get(groups) {
            return number;
        }
        let groups = sorted_distinct(groups.iter().copied());
        let next = self.groups.len() as u32;
        let number = *self.numbers.entry(groups.clone()).or_insert(next);
        if number == next {
            self.groups.push(groups);
        }
        number
    }

    /// Returns the groups of a combination, ascending.
    pub fn groups(&self, number: u32) -> &[Group] {
        &self.groups[number as usize]
    }

    /// Returns the number of the combination of the groups of two combinations.
    pub fn union(&mut self, a: u32, b: u32) -> u32 {
        if a == b {
            return a;
        }
        let all = [self.groups(a), self.groups(b)].concat();
        self.number(&sorted_distinct(all))
    }

    /// Returns the number of elements in each group. `elements` are the combinations of all elements.
    fn group_sizes(&self, elements: impl Iterator<Item = u32>) -> BTreeMap<Group, usize> {
        let mut counts = vec![0; self.groups.len()];
        elements.for_each(|number| counts[number as usize] += 1);
        let mut sizes = BTreeMap::new();
        for (groups, count) in self.groups.iter().zip(counts) {
            for &group in groups.iter().filter(|_| count > 0) {
                *sizes.entry(group).or_insert(0) += count;
            }
        }
        sizes
    }
}

/// Returns the name of a set of elements of this kind that has none.
fn default_name(kind: &str, group: Group) -> String {
    match group {
        Group::Set(number) => format!("set_{number}"),
        _ => format!("{kind}_{}", group.number()),
    }
}

/// Regions and sets of cells.
#[derive(Debug, Default)]
pub struct CellGroups {
    /// The region of each cell.
    pub regions: Vec<i32>,
    /// Names of regions.
    pub names: BTreeMap<i32, String>,
    /// Groups that are not exactly one region.
    pub sets: Vec<NamedSet>,
}

/// The cells of one combination of groups.
struct Region {
    combination: u32,
    /// The most specific group.
    group: Group,
    /// `true` if the region has all cells of the group.
    is_whole: bool,
}

impl CellGroups {
    /// Divides cells into regions. `cells` has the combination of groups of each cell.
    pub fn new(cells: &[u32], combinations: &Combinations, names: &GroupNames) -> Self {
        let sizes = combinations.group_sizes(cells.iter().copied());
        let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
        (cells.iter()).for_each(|&combination| *counts.entry(combination).or_default() += 1);
        let region = |(&combination, &count): (&u32, &usize)| {
            let groups = combinations.groups(combination).iter();
            let group = *groups.min_by_key(|&group| (sizes[group], !names.contains_key(group)))?;
            Some(Region {
                combination,
                group,
                is_whole: sizes[&group] == count,
            })
        };
        let mut regions: Vec<Region> = counts.iter().filter_map(region).collect();
        // Groups that are a region keep their number and their name.
        regions.sort_by_key(|r| (!r.is_whole, r.group, r.combination));
        let mut free = (1..).filter(|number| !sizes.keys().any(|group| group.number() == *number));
        let mut used = BTreeSet::new();
        let mut parts: BTreeMap<Group, usize> = BTreeMap::new();
        let (mut numbers, mut region_names) = (BTreeMap::new(), BTreeMap::new());
        for region in &regions {
            let own = region.group.number();
            let number = if used.insert(own) {
                own
            } else {
                free.next().unwrap_or(own)
            };
            numbers.insert(region.combination, number);
            let Some(name) = names.get(&region.group) else {
                continue;
            };
            let name = if region.is_whole {
                name.clone()
            } else {
                let part = parts.entry(region.group).or_default();
                *part += 1;
                format!("{name}_{part}")
            };
            region_names.insert(number, name);
        }
        let (renumbered, region_names) = assign_regions(region_names);
        let region = |combination: &u32| {
            let number = numbers.get(combination).copied().unwrap_or_default();
            renumbered.get(&number).copied().unwrap_or(number)
        };
        let whole: BTreeSet<Group> = regions
            .iter()
            .filter_map(|r| r.is_whole.then_some(r.group))
            .collect();
        let sets = sizes.keys().filter(|g| g.is_given() && !whole.contains(g));
        let set = |group: &Group| {
            let is_member = |c: &u32| combinations.groups(cells[*c as usize]).contains(group);
            let name = names.get(group).cloned();
            NamedSet {
                name: name.unwrap_or_else(|| default_name("cells", *group)),
                members: (0..cells.len() as u32).filter(is_member).collect(),
            }
        };
        Self {
            regions: cells.iter().map(region).collect(),
            names: region_names,
            sets: sets.map(set).collect(),
        }
    }
}

/// The place of a face of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FacePlace {
    /// On no cell.
    Nowhere,
    Boundary,
    Inside,
}

/// The faces that are in groups. Each face has its nodes, ascending.
pub struct GroupedFaces<'a, F> {
    /// The different faces, ascending, with the combination of their groups.
    faces: Vec<(F, u32)>,
    places: Vec<FacePlace>,
    sizes: BTreeMap<Group, usize>,
    combinations: &'a Combinations,
    names: &'a GroupNames,
}

impl<'a, F: Ord + AsRef<[u32]>> GroupedFaces<'a, F> {
    /// Sorts faces, each with the combination of its groups. A face that is there several times is in
    /// the groups of all of them.
    pub fn new(
        mut faces: Vec<(F, u32)>,
        combinations: &'a mut Combinations,
        names: &'a GroupNames,
    ) -> Self {
        faces.sort_unstable();
        faces.dedup_by(|next, first| {
            let is_same = next.0 == first.0;
            if is_same {
                first.1 = combinations.union(first.1, next.1);
            }
            is_same
        });
        Self {
            places: vec![FacePlace::Nowhere; faces.len()],
            sizes: combinations.group_sizes(faces.iter().map(|face| face.1)),
            faces,
            combinations,
            names,
        }
    }

    /// Returns the index of a face, which belongs to a cell.
    pub fn find(&mut self, nodes: &[u32], is_inside: bool) -> Option<usize> {
        let index = self
            .faces
            .binary_search_by(|face| face.0.as_ref().cmp(nodes));
        let index = index.ok()?;
        self.places[index] = if is_inside {
            FacePlace::Inside
        } else {
            FacePlace::Boundary
        };
        Some(index)
    }

    fn groups(&self, face: usize) -> &[Group] {
        self.combinations.groups(self.faces[face].1)
    }

    /// Returns the name of a group that can be a surface.
    fn name(&self, group: Group) -> Option<&str> {
        let name = self.names.get(&group).map(String::as_str);
        name.filter(|&name| name != FRAGMENTS_NAME)
    }

    /// Returns the group of the surface on which a face lies, if one of its groups has a name: the one
    /// with the fewest faces.
    fn surface(&self, face: usize) -> Option<Group> {
        let groups = self.groups(face).iter().copied();
        let named = groups.filter(|&group| self.name(group).is_some());
        named.min_by_key(|group| self.sizes[group])
    }

    /// Returns the names of surfaces.
    pub fn surface_names(&self) -> Vec<String> {
        let groups = self.sizes.keys();
        let names = groups.filter_map(|&group| self.name(group));
        names.map(String::from).collect()
    }

    /// Returns the index in [`surface_names`](Self::surface_names) of the surface of a face.
    pub fn surface_index(&self, face: usize) -> Option<u32> {
        let surface = self.surface(face)?;
        let named = self
            .sizes
            .keys()
            .filter(|&&group| self.name(group).is_some());
        let index = named.into_iter().position(|&group| group == surface);
        index.map(|i| i as u32)
    }

    /// Returns `true` if the name of a group of a face marks it as a horizon.
    pub fn is_on_horizon(&self, face: usize) -> bool {
        let mut groups = self.groups(face).iter();
        groups.any(|&group| {
            let name = self.name(group).unwrap_or_default();
            name.to_ascii_lowercase().starts_with("horizon")
        })
    }

    /// Returns the sets: groups that are not exactly one surface. `kind` begins the names of groups
    /// without a name. Returns also the number of faces that lie on no cell.
    pub fn into_sets(self, kind: &str) -> (Vec<FaceSet>, usize) {
        let mut sets = Vec::new();
        for &group in self.sizes.keys() {
            let is_fragments = self.names.get(&group).is_some_and(|n| n == FRAGMENTS_NAME);
            if !group.is_given() || is_fragments {
                continue;
            }
            let faces = (0..self.faces.len()).filter(|&face| {
                self.places[face] != FacePlace::Nowhere && self.groups(face).contains(&group)
            });
            let faces: Vec<usize> = faces.collect();
            let name = self.name(group);
            let is_surface = faces.iter().all(|&face| {
                let is_surface = name.is_none() || self.surface(face) == Some(group);
                self.places[face] == FacePlace::Inside && is_surface
            });
            if is_surface {
                continue;
            }
            let mut lists = Lists::default();
            (faces.iter()).for_each(|&face| {
                lists.push(self.faces[face].0.as_ref().iter().copied());
            });
            sets.push(FaceSet {
                name: name.map_or_else(|| default_name(kind, group), String::from),
                faces: lists,
            });
        }
        let given =
            (0..self.faces.len()).filter(|&face| self.groups(face).iter().any(|g| g.is_given()));
        let lost = given.filter(|&face| self.places[face] == FacePlace::Nowhere);
        (sets, lost.count())
    }
}

/// Returns the nodes of elements as sets, one for each group. `elements` have their nodes and the
/// combination of their groups; `kind` begins the names of groups without a name.
pub fn node_sets<'e>(
    elements: impl Iterator<Item = (&'e [u32], u32)>,
    combinations: &Combinations,
    names: &GroupNames,
    kind: &str,
) -> Vec<NamedSet> {
    let mut members: BTreeMap<Group, Vec<u32>> = BTreeMap::new();
    for (nodes, combination) in elements {
        let groups = combinations.groups(combination).iter();
        for &group in groups.filter(|group| group.is_given()) {
            members.entry(group).or_default().extend(nodes);
        }
    }
    let set = |(group, nodes)| NamedSet {
        name: (names.get(&group).cloned()).unwrap_or_else(|| default_name(kind, group)),
        members: sorted_distinct::<u32>(nodes),
    };
    members.into_iter().map(set).collect()
}
