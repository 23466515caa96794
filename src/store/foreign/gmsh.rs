//! Gmsh's `.msh`, versions 2.2 and 4.1, text and binary.
//!
//! Layout: the chapters "MSH file format" and "Legacy formats" of Gmsh's manual. Sections that hold no mesh
//! are passed over. Of second-order elements the corners are taken.

use std::collections::BTreeMap;

use super::{FileProblem, ForeignMesh, ReadResult, assign_regions};

/// Dimension, number of nodes and number of corners of Gmsh's element types; those of no simplices have no
/// corners.
fn element_type(number: i64) -> ReadResult<(usize, usize, usize)> {
    Ok(match number {
        15 => (0, 1, 1),
        1 => (1, 2, 2),
        8 => (1, 3, 2),
        2 => (2, 3, 3),
        9 => (2, 6, 3),
        4 => (3, 4, 4),
        11 => (3, 10, 4),
        3 | 16 | 10 => return Err(unsupported_elements("quadrilaterals")),
        5 | 17 | 12 => return Err(unsupported_elements("hexahedra")),
        6 | 18 | 13 => return Err(unsupported_elements("prisms")),
        7 | 19 | 14 => return Err(unsupported_elements("pyramids")),
        other => {
            return Err(unsupported_elements(&format!(
                "elements of Gmsh's type {other}"
            )));
        }
    })
}

fn unsupported_elements(what: &str) -> FileProblem {
    FileProblem {
        problem: format!("holds {what}"),
        remedy: "give a mesh of tetrahedra or triangles, of first or second order",
    }
}

/// Reads a file.
pub fn read(bytes: &[u8]) -> ReadResult<ForeignMesh> {
    let mut at = MshReader {
        bytes,
        position: 0,
        is_binary: false,
        is_byte_swapped: false,
    };
    let mut version = 0.0;
    let mut groups = BTreeMap::new();
    let mut entities = BTreeMap::new();
    let mut nodes = NumberedNodes::default();
    let mut elements = Vec::new();
    while let Some(section) = at.section() {
        match section.as_str() {
            "$MeshFormat" => version = at.format()?,
            "$PhysicalNames" => groups = at.names()?,
            "$Entities" if version >= 4.0 => entities = at.entities()?,
            "$Nodes" if version < 4.0 => at.nodes_v2(&mut nodes)?,
            "$Nodes" => at.nodes_v4(&mut nodes)?,
            "$Elements" if version < 4.0 => at.elements_v2(&mut elements)?,
            "$Elements" => at.elements_v4(&entities, &mut elements)?,
            _ => {}
        }
        let end = section.replacen('$', "$End", 1);
        if !at.skip_past(&end) {
            return Err(FileProblem::damaged(format!("ends within {section}")));
        }
    }
    assemble_mesh(nodes, elements, &groups)
}

/// A group of elements: its dimension, and the number of the physical group, or else of the entity.
type GroupKey = (usize, i32);

fn assemble_mesh(
    nodes: NumberedNodes,
    elements: Vec<(GroupKey, [u64; 4])>,
    groups: &BTreeMap<GroupKey, String>,
) -> ReadResult<ForeignMesh> {
    let by_number: BTreeMap<u64, u32> = match nodes.is_consecutive() {
        true => BTreeMap::new(),
        false => nodes.numbers.iter().copied().zip(0..).collect(),
    };
    let place = |number: u64| -> ReadResult<u32> {
        let found = match by_number.is_empty() {
            true => number.checked_sub(1).and_then(|n| u32::try_from(n).ok()),
            false => by_number.get(&number).copied(),
        };
        let found = found.filter(|&n| (n as usize) < nodes.positions.len());
        found.ok_or_else(|| {
            FileProblem::damaged(format!("an element has node {number}, which is not there"))
        })
    };
    let cells = elements.iter().map(|((dim, _), _)| *dim).max().unwrap_or(0);
    let of_cells = groups.iter().filter(|((dim, _), _)| *dim == cells);
    let of_cells = of_cells.map(|((_, number), name)| (*number, name.clone()));
    let (numbers, names) = assign_regions(of_cells.collect());
    let of_faces = groups.iter().filter(|((dim, _), _)| dim + 1 == cells);
    let mut foreign = ForeignMesh {
        names,
        face_names: of_faces
            .map(|((_, number), name)| (*number, name.clone()))
            .collect(),
        ..ForeignMesh::default()
    };
    for ((dim, group), corners) in elements {
        let region = match dim == cells {
            true => numbers.get(&group).copied().unwrap_or(group),
            false => group,
        };
        let [a, b, c, d] = corners;
        match dim {
            3 => {
                let tet = [place(a)?, place(b)?, place(c)?, place(d)?];
                foreign.tets.push((tet, region));
            }
            2 => foreign
                .triangles
                .push(([place(a)?, place(b)?, place(c)?], region)),
            1 => foreign.edges.push(([place(a)?, place(b)?], group)),
            _ => {}
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
    /// Whether nodes have the numbers 1, 2, 3 ...
    fn is_consecutive(&self) -> bool {
        self.numbers
            .iter()
            .zip(1..)
            .all(|(number, place)| *number == place)
    }
}

/// Where in a file we are; numbers are words of text or binary, as the file is.
struct MshReader<'a> {
    bytes: &'a [u8],
    position: usize,
    is_binary: bool,
    is_byte_swapped: bool,
}

impl MshReader<'_> {
    /// The next line that begins with `$`, trimmed.
    fn section(&mut self) -> Option<String> {
        loop {
            let line = self.line()?;
            if line.starts_with('$') {
                return Some(line);
            }
        }
    }

    /// The rest of the line, trimmed; `None` at the end.
    fn line(&mut self) -> Option<String> {
        let rest = self
            .bytes
            .get(self.position..)
            .filter(|rest| !rest.is_empty())?;
        let end = rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
        self.position += (end + 1).min(rest.len());
        Some(String::from_utf8_lossy(&rest[..end]).trim().to_string())
    }

    /// Goes behind the line that is `word`; false if there is none.
    fn skip_past(&mut self, word: &str) -> bool {
        let rest = &self.bytes[self.position.min(self.bytes.len())..];
        let found = rest.windows(word.len()).position(|w| w == word.as_bytes());
        if let Some(at) = found {
            self.position += at + word.len();
            self.line();
        }
        found.is_some()
    }

    fn word(&mut self) -> ReadResult<&str> {
        let rest = &self.bytes[self.position.min(self.bytes.len())..];
        let begin = rest
            .iter()
            .position(|b| !b.is_ascii_whitespace())
            .unwrap_or(rest.len());
        let length = rest[begin..].iter().position(|b| b.is_ascii_whitespace());
        let word = &rest[begin..begin + length.unwrap_or(rest.len() - begin)];
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
        match self.is_binary {
            true => Ok(i64::from(i32::from_le_bytes(self.raw_bytes()?))),
            false => self.parse_word(),
        }
    }

    fn size(&mut self) -> ReadResult<u64> {
        match self.is_binary {
            true => Ok(u64::from_le_bytes(self.raw_bytes()?)),
            false => self.parse_word(),
        }
    }

    fn real(&mut self) -> ReadResult<f64> {
        match self.is_binary {
            true => Ok(f64::from_le_bytes(self.raw_bytes()?)),
            false => self.parse_word(),
        }
    }

    fn point(&mut self) -> ReadResult<[f64; 3]> {
        Ok([self.real()?, self.real()?, self.real()?])
    }

    /// A physical tag or an entity's, as a group's number.
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
                problem: format!("is of version {version} with numbers of {width} bytes"),
                remedy: "write version 2.2 or 4.1 (gmsh -format msh41)",
            });
        }
        if binary == 1 {
            let one: [u8; 4] = self.raw_bytes()?;
            self.is_byte_swapped = match one {
                [1, 0, 0, 0] => false,
                [0, 0, 0, 1] => true,
                _ => return Err(FileProblem::damaged("does not say its order of bytes")),
            };
        }
        self.is_binary = binary == 1;
        Ok(version)
    }

    fn names(&mut self) -> ReadResult<BTreeMap<GroupKey, String>> {
        let count: usize = self.parse_word()?;
        let mut names = BTreeMap::new();
        for _ in 0..count {
            let group = (self.parse_word()?, self.parse_word()?);
            let line = self.line().unwrap_or_default();
            names.insert(group, line.trim_matches('"').to_string());
        }
        Ok(names)
    }

    /// The physical group of each entity that has one.
    fn entities(&mut self) -> ReadResult<BTreeMap<GroupKey, i32>> {
        let mut groups = BTreeMap::new();
        let counts = [self.size()?, self.size()?, self.size()?, self.size()?];
        for (dim, count) in counts.into_iter().enumerate() {
            for _ in 0..count {
                let tag = self.tag()?;
                self.point()?;
                if dim > 0 {
                    self.point()?;
                }
                for number in 0..self.size()? {
                    let physical = self.tag()?;
                    if number == 0 {
                        groups.insert((dim, tag), physical.abs());
                    }
                }
                for _ in 0..if dim > 0 { self.size()? } else { 0 } {
                    self.int()?;
                }
            }
        }
        Ok(groups)
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

    fn elements_v2(&mut self, elements: &mut Vec<(GroupKey, [u64; 4])>) -> ReadResult<()> {
        let count: u64 = self.parse_word()?;
        self.line();
        let mut left = count;
        while left > 0 {
            // Text has a type for each element, binary for a row of them.
            let (number, kind_number, row, tags) = match self.is_binary {
                true => (None, self.int()?, self.int()?, self.int()?),
                false => {
                    let number = self.int()?;
                    (Some(number), self.int()?, 1, self.int()?)
                }
            };
            let (dim, nodes, corners) = element_type(kind_number)?;
            let row = u64::try_from(row).unwrap_or(0).min(left);
            if row == 0 {
                return Err(FileProblem::damaged("has a row of no elements"));
            }
            for _ in 0..row {
                if number.is_none() {
                    self.int()?;
                }
                let mut group = 0;
                for place in 0..tags {
                    let tag = self.tag()?;
                    // The first is the physical group, the second the entity.
                    if place == 0 || (place == 1 && group == 0) {
                        group = tag;
                    }
                }
                let mut all = [0; 4];
                for place in 0..nodes {
                    let node = self.int()? as u64;
                    if place < corners {
                        all[place] = node;
                    }
                }
                elements.push(((dim, group), all));
            }
            left -= row;
        }
        Ok(())
    }

    fn elements_v4(
        &mut self,
        entities: &BTreeMap<GroupKey, i32>,
        elements: &mut Vec<(GroupKey, [u64; 4])>,
    ) -> ReadResult<()> {
        let [blocks, _, _, _] = [self.size()?, self.size()?, self.size()?, self.size()?];
        for _ in 0..blocks {
            self.int()?;
            let entity = self.tag()?;
            let (dim, nodes, corners) = element_type(self.int()?)?;
            let group = entities.get(&(dim, entity)).copied().unwrap_or(entity);
            for _ in 0..self.size()? {
                self.size()?;
                let mut all = [0; 4];
                for place in 0..nodes {
                    let node = self.size()?;
                    if place < corners {
                        all[place] = node;
                    }
                }
                elements.push(((dim, group), all));
            }
        }
        Ok(())
    }
}
