//! Reads Gmsh's `.msh` files, versions 2.2 and 4.1, text and binary.
//!
//! Layout: the chapters "MSH file format" and "Legacy formats" of Gmsh's manual. Sections without
//! mesh data are skipped. Of second-order elements only the corners are used.

use std::collections::BTreeMap;

use super::{FileProblem, ForeignMesh, ReadResult, assign_regions};

/// Returns the dimension, the number of nodes and the number of corners of one of Gmsh's element
/// types. Types that are not simplices give an error.
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
        unknown => {
            return Err(unsupported_elements(&format!(
                "elements of Gmsh's type {unknown}"
            )));
        }
    })
}

fn unsupported_elements(description: &str) -> FileProblem {
    FileProblem {
        problem: format!("has {description}"),
        remedy: "give a mesh of tetrahedra or triangles, of first or second order",
    }
}

/// Reads a mesh from the bytes of a file.
pub fn read(bytes: &[u8]) -> ReadResult<ForeignMesh> {
    let mut reader = MshReader {
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
    while let Some(section) = reader.section() {
        match section.as_str() {
            "$MeshFormat" => version = reader.format()?,
            "$PhysicalNames" => groups = reader.names()?,
            "$Entities" if version >= 4.0 => entities = reader.entities()?,
            "$Nodes" if version < 4.0 => reader.nodes_v2(&mut nodes)?,
            "$Nodes" => reader.nodes_v4(&mut nodes)?,
            "$Elements" if version < 4.0 => reader.elements_v2(&mut elements)?,
            "$Elements" => reader.elements_v4(&entities, &mut elements)?,
            _ => {}
        }
        let end = section.replacen('$', "$End", 1);
        if !reader.skip_past(&end) {
            return Err(FileProblem::damaged(format!("ends within {section}")));
        }
    }
    assemble_mesh(nodes, elements, &groups)
}

/// A group of elements: its dimension, and the number of the physical group or, without one, of the
/// entity.
type GroupKey = (usize, i32);

fn assemble_mesh(
    nodes: NumberedNodes,
    elements: Vec<(GroupKey, [u64; 4])>,
    groups: &BTreeMap<GroupKey, String>,
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
    let cell_dim = elements.iter().map(|((dim, _), _)| *dim).max().unwrap_or(0);
    let cell_groups = groups.iter().filter(|((dim, _), _)| *dim == cell_dim);
    let cell_groups = cell_groups.map(|((_, number), name)| (*number, name.clone()));
    let (numbers, names) = assign_regions(cell_groups.collect());
    let face_groups = groups.iter().filter(|((dim, _), _)| dim + 1 == cell_dim);
    let mut foreign = ForeignMesh {
        names,
        face_names: face_groups
            .map(|((_, number), name)| (*number, name.clone()))
            .collect(),
        ..ForeignMesh::default()
    };
    for ((dim, group), corners) in elements {
        let region = if dim == cell_dim {
            numbers.get(&group).copied().unwrap_or(group)
        } else {
            group
        };
        let [a, b, c, d] = corners;
        match dim {
            3 => {
                let tet = [
                    node_index(a)?,
                    node_index(b)?,
                    node_index(c)?,
                    node_index(d)?,
                ];
                foreign.tets.push((tet, region));
            }
            2 => foreign
                .triangles
                .push(([node_index(a)?, node_index(b)?, node_index(c)?], region)),
            1 => foreign
                .edges
                .push(([node_index(a)?, node_index(b)?], group)),
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

    /// Reads the physical group of each entity that has one.
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
                let mut group = 0;
                for i in 0..tags {
                    let tag = self.tag()?;
                    // The first tag is the physical group, the second the entity.
                    if i == 0 || (i == 1 && group == 0) {
                        group = tag;
                    }
                }
                let mut element = [0; 4];
                for i in 0..nodes {
                    let node = self.int()? as u64;
                    if i < corners {
                        element[i] = node;
                    }
                }
                elements.push(((dim, group), element));
            }
            remaining -= count_in_row;
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
                let mut element = [0; 4];
                for i in 0..nodes {
                    let node = self.size()?;
                    if i < corners {
                        element[i] = node;
                    }
                }
                elements.push(((dim, group), element));
            }
        }
        Ok(())
    }
}
