//! Reads Gmsh's `.msh` files, versions 2.2 and 4.1, text and binary.
//!
//! Layout: the chapters "MSH file format" and "Legacy formats" of Gmsh's manual. Sections without
//! mesh data are skipped. Of second-order elements only the corners are used.

use std::collections::BTreeMap;

use super::groups::{Combinations, Group, GroupNames};
use super::{FileProblem, ForeignMesh, ReadResult};
use crate::mesh_file::formats::gmsh::{OTHER_TYPES, SIMPLEX_TYPES};
use crate::names;

/// Returns the dimension, the number of nodes and the number of corners of one of Gmsh's element
/// types. Types that are not simplices give an error.
fn element_type(number: i64) -> ReadResult<(usize, usize, usize)> {
    let mut known = SIMPLEX_TYPES.iter();
    if let Some(simplex) = known.find(|simplex| i64::from(simplex.number) == number) {
        return Ok((simplex.corners - 1, simplex.nodes, simplex.corners));
    }
    let mut others = OTHER_TYPES.iter();
    Err(
        match others.find(|(numbers, _)| numbers.contains(&number)) {
            Some((_, name)) => unsupported_elements(name),
            None => unsupported_elements(&format!("elements of Gmsh's type {number}")),
        },
    )
}

fn unsupported_elements(description: &str) -> FileProblem {
    FileProblem {
        problem: format!("has {description}"),
        remedy: "give a mesh of tetrahedra or triangles, of first or second order",
    }
}

/// Sections without cells, nodes and groups, which no note mentions.
const SECTIONS_WITHOUT_DATA: [&str; 4] = [
    "$Comments",
    "$InterpolationScheme",
    "$Parametrizations",
    "$GhostElements",
];

/// Reads a mesh from the bytes of a file.
pub fn read(bytes: &[u8]) -> ReadResult<ForeignMesh> {
    let mut reader = MshReader {
        bytes,
        position: 0,
        is_binary: false,
        is_byte_swapped: false,
    };
    let mut version = 0.0;
    let mut foreign = ForeignMesh::default();
    let mut entities: Option<Entities> = None;
    let mut nodes = NumberedNodes::default();
    let mut elements = Vec::new();
    let mut unread: Vec<String> = Vec::new();
    while let Some(section) = reader.section() {
        match section.as_str() {
            "$MeshFormat" => version = reader.format()?,
            "$PhysicalNames" => reader.names(&mut foreign.names)?,
            "$Entities" if version >= 4.0 => {
                let known = entities.get_or_insert_default();
                reader.entities(known, &mut foreign.combinations)?;
            }
            "$PartitionedEntities" if version >= 4.0 => {
                let known = entities.get_or_insert_default();
                reader.partitioned_entities(known, &mut foreign.combinations)?;
            }
            "$Nodes" if version < 4.0 => reader.nodes_v2(&mut nodes)?,
            "$Nodes" => reader.nodes_v4(&mut nodes)?,
            "$Elements" if version < 4.0 => {
                reader.elements_v2(&mut foreign.combinations, &mut elements)?;
            }
            "$Elements" => {
                let entities = entities.as_ref().ok_or_else(|| FileProblem {
                    problem: "has no section $Entities, so that no cell has a group".into(),
                    remedy: "write version 2.2 (in meshio file_format=\"gmsh22\"), or .vtu",
                })?;
                reader.elements_v4(entities, &mut foreign.combinations, &mut elements)?;
            }
            known if SECTIONS_WITHOUT_DATA.contains(&known) => {}
            _ if !unread.contains(&section) => unread.push(section.clone()),
            _ => {}
        }
        let end = section.replacen('$', "$End", 1);
        if !reader.skip_past(&end) {
            return Err(FileProblem::damaged(format!("ends within {section}")));
        }
    }
    if !unread.is_empty() {
        let sections = unread.join(", ");
        foreign.notes.push(format!("not read: {sections}"));
    }
    assemble_mesh(nodes, elements, foreign)
}

/// An element: its dimension, the combination of its groups, and the numbers of its corners.
type Element = (usize, u32, [u64; 4]);

/// For each entity, by its dimension and its number, the combination of its physical groups. `None`
/// stands for the boundary of a partition, which is no part of the model.
type Entities = BTreeMap<(usize, i32), Option<u32>>;

fn assemble_mesh(
    nodes: NumberedNodes,
    elements: Vec<Element>,
    mut foreign: ForeignMesh,
) -> ReadResult<ForeignMesh> {
    let by_number: BTreeMap<u64, u32> = if nodes.is_consecutive() {
        BTreeMap::new()
    } else {
        nodes.numbers.iter().copied().zip(0..).collect()
    };
    let node_index = |number: u64| -> ReadResult<u32> {
        let index = if by_number.is_empty() {
            number.checked_sub(1).and_then(|n| u32::try_from(n).ok())
        } else {
            by_number.get(&number).copied()
        };
        let index = index.filter(|&n| (n as usize) < nodes.positions.len());
        index.ok_or_else(|| {
            FileProblem::damaged(format!(
                "an element has node {number}, which does not exist"
            ))
        })
    };
    for (dim, groups, corners) in elements {
        let mut indices = [0; 4];
        for (index, number) in indices.iter_mut().zip(corners).take(dim + 1) {
            *index = node_index(number)?;
        }
        let [a, b, c, _] = indices;
        match dim {
            3 => foreign.tets.push((indices, groups)),
            2 => foreign.triangles.push(([a, b, c], groups)),
            1 => foreign.edges.push(([a, b], groups)),
            _ => foreign.points.push(([a], groups)),
        }
    }
    foreign.nodes = nodes.positions;
    Ok(foreign)
}

#[derive(Default)]
struct NumberedNodes {
    numbers: Vec<u64>,
    positions: Vec<[f64; 3]>,
}

impl NumberedNodes {
    /// Returns `true` if nodes have the numbers 1, 2, 3 and so on.
    fn is_consecutive(&self) -> bool {
        self.numbers
            .iter()
            .zip(1..)
            .all(|(number, expected)| *number == expected)
    }
}

/// A position in a file. Numbers are words of text or binary, depending on the file.
struct MshReader<'a> {
    bytes: &'a [u8],
    position: usize,
    is_binary: bool,
    is_byte_swapped: bool,
}

impl MshReader<'_> {
    /// Returns the next line that begins with `$`, trimmed.
    fn section(&mut self) -> Option<String> {
        loop {
            let line = self.line()?;
            if line.starts_with('$') {
                return Some(line);
            }
        }
    }

    /// Returns the remainder of the line, trimmed; `None` at the end of the file.
    fn line(&mut self) -> Option<String> {
        let remaining = self
            .bytes
            .get(self.position..)
            .filter(|remaining| !remaining.is_empty())?;
        let end = remaining
            .iter()
            .position(|b| *b == b'\n')
            .unwrap_or(remaining.len());
        self.position += (end + 1).min(remaining.len());
        Some(
            String::from_utf8_lossy(&remaining[..end])
                .trim()
                .to_string(),
        )
    }

    /// Moves behind the line `word`. Returns `false` if there is no such line.
    fn skip_past(&mut self, word: &str) -> bool {
        let remaining = &self.bytes[self.position.min(self.bytes.len())..];
        let offset = remaining
            .windows(word.len())
            .position(|w| w == word.as_bytes());
        if let Some(at) = offset {
            self.position += at + word.len();
            self.line();
        }
        offset.is_some()
    }

    fn word(&mut self) -> ReadResult<&str> {
        let remaining = &self.bytes[self.position.min(self.bytes.len())..];
        let begin = remaining
            .iter()
            .position(|b| !b.is_ascii_whitespace())
            .unwrap_or(remaining.len());
        let length = remaining[begin..]
            .iter()
            .position(|b| b.is_ascii_whitespace());
        let word = &remaining[begin..begin + length.unwrap_or(remaining.len() - begin)];
        self.position += begin + word.len();
        match std::str::from_utf8(word) {
            Ok(word) if !word.is_empty() => Ok(word),
            _ => Err(FileProblem::damaged("ends where a number should be")),
        }
    }

    fn parse_word<T: std::str::FromStr>(&mut self) -> ReadResult<T> {
        let word = self.word()?;
        let fault = || FileProblem::damaged(format!("has '{word}' where a number should be"));
        word.parse().map_err(|_| fault())
    }

    fn raw_bytes<const N: usize>(&mut self) -> ReadResult<[u8; N]> {
        let bytes = self.bytes.get(self.position..self.position + N);
        let mut bytes: [u8; N] = bytes
            .and_then(|bytes| bytes.try_into().ok())
            .ok_or_else(|| FileProblem::damaged("is cut off"))?;
        self.position += N;
        if self.is_byte_swapped {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn int(&mut self) -> ReadResult<i64> {
        if self.is_binary {
            Ok(i64::from(i32::from_le_bytes(self.raw_bytes()?)))
        } else {
            self.parse_word()
        }
    }

    fn size(&mut self) -> ReadResult<u64> {
        if self.is_binary {
            Ok(u64::from_le_bytes(self.raw_bytes()?))
        } else {
            self.parse_word()
        }
    }

    fn real(&mut self) -> ReadResult<f64> {
        if self.is_binary {
            Ok(f64::from_le_bytes(self.raw_bytes()?))
        } else {
            self.parse_word()
        }
    }

    fn point(&mut self) -> ReadResult<[f64; 3]> {
        Ok([self.real()?, self.real()?, self.real()?])
    }

    /// Reads the tag of a physical group or an entity, which is used as the number of a group.
    fn tag(&mut self) -> ReadResult<i32> {
        let tag = self.int()?;
        i32::try_from(tag).map_err(|_| FileProblem::damaged(format!("has the tag {tag}")))
    }

    fn format(&mut self) -> ReadResult<f64> {
        let version: f64 = self.parse_word()?;
        let (binary, width): (u8, u8) = (self.parse_word()?, self.parse_word()?);
        self.line();
        if !(version == 4.1 || (2.0..3.0).contains(&version)) || width != 8 {
            return Err(FileProblem {
                problem: format!("has version {version} with numbers of {width} bytes"),
                remedy: "write version 2.2 or 4.1 (gmsh -format msh41)",
            });
        }
        if binary == 1 {
            let byte_order_mark: [u8; 4] = self.raw_bytes()?;
            self.is_byte_swapped = match byte_order_mark {
                [1, 0, 0, 0] => false,
                [0, 0, 0, 1] => true,
                _ => return Err(FileProblem::damaged("does not mark its byte order")),
            };
        }
        self.is_binary = binary == 1;
        Ok(version)
    }

    fn names(&mut self, names: &mut [GroupNames; 4]) -> ReadResult<()> {
        let count: usize = self.parse_word()?;
        for _ in 0..count {
            let (dim, number): (usize, i32) = (self.parse_word()?, self.parse_word()?);
            let line = self.line().unwrap_or_default();
            let name = names::from_file(line.trim_matches('"'));
            if let Some(names) = names.get_mut(dim).filter(|_| !name.is_empty()) {
                names.insert(Group::Physical(number), name);
            }
        }
        Ok(())
    }

    /// Reads the physical groups of each entity.
    fn entities(
        &mut self,
        entities: &mut Entities,
        combinations: &mut Combinations,
    ) -> ReadResult<()> {
        let counts = [self.size()?, self.size()?, self.size()?, self.size()?];
        for (dim, count) in counts.into_iter().enumerate() {
            for _ in 0..count {
                let tag = self.tag()?;
                let groups = self.entity_groups(dim, tag)?;
                entities.insert((dim, tag), Some(combinations.number(&groups)));
            }
        }
        Ok(())
    }

    /// Reads the extent of an entity, its physical groups and its boundary, and returns the groups.
    fn entity_groups(&mut self, dim: usize, tag: i32) -> ReadResult<Vec<Group>> {
        self.point()?;
        if dim > 0 {
            self.point()?;
        }
        let mut groups = Vec::new();
        for _ in 0..self.size()? {
            // The sign is the orientation of the entity in the group.
            groups.push(Group::Physical(self.tag()?.saturating_abs()));
        }
        for _ in 0..if dim > 0 { self.size()? } else { 0 } {
            self.int()?;
        }
        if groups.is_empty() {
            groups.push(Group::Entity(tag));
        }
        Ok(groups)
    }

    /// Reads the physical groups of the entities of a mesh that is divided into partitions.
    fn partitioned_entities(
        &mut self,
        entities: &mut Entities,
        combinations: &mut Combinations,
    ) -> ReadResult<()> {
        self.size()?;
        for _ in 0..self.size()? {
            self.tag()?;
            self.tag()?;
        }
        let counts = [self.size()?, self.size()?, self.size()?, self.size()?];
        for (dim, count) in counts.into_iter().enumerate() {
            for _ in 0..count {
                let (tag, parent_dim, parent) = (self.tag()?, self.tag()?, self.tag()?);
                for _ in 0..self.size()? {
                    self.tag()?;
                }
                let groups = self.entity_groups(dim, parent)?;
                let is_part = usize::try_from(parent_dim) == Ok(dim);
                let combination = is_part.then(|| combinations.number(&groups));
                entities.insert((dim, tag), combination);
            }
        }
        Ok(())
    }

    fn nodes_v2(&mut self, nodes: &mut NumberedNodes) -> ReadResult<()> {
        let count: u64 = self.parse_word()?;
        self.line();
        for _ in 0..count {
            let number = self.int()?;
            nodes.numbers.push(number as u64);
            nodes.positions.push(self.point()?);
        }
        Ok(())
    }

    fn nodes_v4(&mut self, nodes: &mut NumberedNodes) -> ReadResult<()> {
        let [blocks, _, _, _] = [self.size()?, self.size()?, self.size()?, self.size()?];
        for _ in 0..blocks {
            let [dim, _, parametric] = [self.int()?, self.int()?, self.int()?];
            let count = self.size()?;
            for _ in 0..count {
                nodes.numbers.push(self.size()?);
            }
            for _ in 0..count {
                nodes.positions.push(self.point()?);
                for _ in 0..if parametric == 0 { 0 } else { dim } {
                    self.real()?;
                }
            }
        }
        Ok(())
    }

    fn elements_v2(
        &mut self,
        combinations: &mut Combinations,
        elements: &mut Vec<Element>,
    ) -> ReadResult<()> {
        let count: u64 = self.parse_word()?;
        self.line();
        let mut remaining = count;
        while remaining > 0 {
            // A text file gives the type of each element; a binary file gives the type of a row of
            // elements.
            let (number, kind_number, count_in_row, tags) = if self.is_binary {
                (None, self.int()?, self.int()?, self.int()?)
            } else {
                let number = self.int()?;
                (Some(number), self.int()?, 1, self.int()?)
            };
            let (dim, nodes, corners) = element_type(kind_number)?;
            let count_in_row = u64::try_from(count_in_row).unwrap_or(0).min(remaining);
            if count_in_row == 0 {
                return Err(FileProblem::damaged("has a row of no elements"));
            }
            for _ in 0..count_in_row {
                if number.is_none() {
                    self.int()?;
                }
                let (mut physical, mut entity) = (0, 0);
                for i in 0..tags {
                    let tag = self.tag()?;
                    match i {
                        0 => physical = tag.saturating_abs(),
                        1 => entity = tag,
                        _ => {}
                    }
                }
                let group = match physical {
                    0 => Group::Entity(entity),
                    number => Group::Physical(number),
                };
                let mut element = [0; 4];
                for i in 0..nodes {
                    let node = self.int()? as u64;
                    if i < corners {
                        element[i] = node;
                    }
                }
                elements.push((dim, combinations.number(&[group]), element));
            }
            remaining -= count_in_row;
        }
        Ok(())
    }

    fn elements_v4(
        &mut self,
        entities: &Entities,
        combinations: &mut Combinations,
        elements: &mut Vec<Element>,
    ) -> ReadResult<()> {
        let [blocks, _, _, _] = [self.size()?, self.size()?, self.size()?, self.size()?];
        for _ in 0..blocks {
            self.int()?;
            let entity = self.tag()?;
            let (dim, nodes, corners) = element_type(self.int()?)?;
            let groups = match entities.get(&(dim, entity)) {
                Some(groups) => *groups,
                None => Some(combinations.number(&[Group::Entity(entity)])),
            };
            for _ in 0..self.size()? {
                self.size()?;
                let mut element = [0; 4];
                for i in 0..nodes {
                    let node = self.size()?;
                    if i < corners {
                        element[i] = node;
                    }
                }
                elements.extend(groups.map(|groups| (dim, groups, element)));
            }
        }
        Ok(())
    }
}
