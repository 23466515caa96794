//! Gmsh's `.msh`, versions 2.2 and 4.1, text and binary.
//!
//! Layout: the chapters "MSH file format" and "Legacy formats" of Gmsh's manual. Sections that hold no mesh
//! are passed over. Of second-order elements the corners are taken.

use std::collections::BTreeMap;

use super::{Fault, Foreign, Found, settle};

/// Dimension, number of nodes and number of corners of Gmsh's element types; those of no simplices have no
/// corners.
fn kind(number: i64) -> Found<(usize, usize, usize)> {
    Ok(match number {
        15 => (0, 1, 1),
        1 => (1, 2, 2),
        8 => (1, 3, 2),
        2 => (2, 3, 3),
        9 => (2, 6, 3),
        4 => (3, 4, 4),
        11 => (3, 10, 4),
        3 | 16 | 10 => return Err(others("quadrilaterals")),
        5 | 17 | 12 => return Err(others("hexahedra")),
        6 | 18 | 13 => return Err(others("prisms")),
        7 | 19 | 14 => return Err(others("pyramids")),
        other => return Err(others(&format!("elements of Gmsh's type {other}"))),
    })
}

fn others(what: &str) -> Fault {
    Fault {
        problem: format!("holds {what}"),
        remedy: "give a mesh of tetrahedra or triangles, of first or second order",
    }
}

/// Reads a file.
pub fn read(bytes: &[u8]) -> Found<Foreign> {
    let mut at = Cursor {
        bytes,
        place: 0,
        binary: false,
        swapped: false,
    };
    let mut version = 0.0;
    let mut groups = BTreeMap::new();
    let mut entities = BTreeMap::new();
    let mut nodes = Nodes::default();
    let mut elements = Vec::new();
    while let Some(section) = at.section() {
        match section.as_str() {
            "$MeshFormat" => version = at.format()?,
            "$PhysicalNames" => groups = at.names()?,
            "$Entities" if version >= 4.0 => entities = at.entities()?,
            "$Nodes" if version < 4.0 => at.nodes_2(&mut nodes)?,
            "$Nodes" => at.nodes_4(&mut nodes)?,
            "$Elements" if version < 4.0 => at.elements_2(&mut elements)?,
            "$Elements" => at.elements_4(&entities, &mut elements)?,
            _ => {}
        }
        let end = section.replacen('$', "$End", 1);
        if !at.skip_past(&end) {
            return Err(Fault::damaged(format!("ends within {section}")));
        }
    }
    assembled(nodes, elements, &groups)
}

/// A group of elements: its dimension, and the number of the physical group, or else of the entity.
type Group = (usize, i32);

fn assembled(
    nodes: Nodes,
    elements: Vec<(Group, [u64; 4])>,
    groups: &BTreeMap<Group, String>,
) -> Found<Foreign> {
    let by_number: BTreeMap<u64, u32> = match nodes.in_order() {
        true => BTreeMap::new(),
        false => nodes.numbers.iter().copied().zip(0..).collect(),
    };
    let place = |number: u64| -> Found<u32> {
        let found = match by_number.is_empty() {
            true => number.checked_sub(1).and_then(|n| u32::try_from(n).ok()),
            false => by_number.get(&number).copied(),
        };
        let found = found.filter(|&n| (n as usize) < nodes.positions.len());
        found.ok_or_else(|| {
            Fault::damaged(format!("an element has node {number}, which is not there"))
        })
    };
    let cells = elements.iter().map(|((dim, _), _)| *dim).max().unwrap_or(0);
    let of_cells = groups.iter().filter(|((dim, _), _)| *dim == cells);
    let of_cells = of_cells.map(|((_, number), name)| (*number, name.clone()));
    let (numbers, names) = settle(of_cells.collect());
    let of_faces = groups.iter().filter(|((dim, _), _)| dim + 1 == cells);
    let mut foreign = Foreign {
        names,
        face_names: of_faces
            .map(|((_, number), name)| (*number, name.clone()))
            .collect(),
        ..Foreign::default()
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
struct Nodes {
    numbers: Vec<u64>,
    positions: Vec<[f64; 3]>,
}

impl Nodes {
    /// Whether nodes have the numbers 1, 2, 3 ...
    fn in_order(&self) -> bool {
        self.numbers
            .iter()
            .zip(1..)
            .all(|(number, place)| *number == place)
    }
}

/// Where in a file we are; numbers are words of text or binary, as the file is.
struct Cursor<'a> {
    bytes: &'a [u8],
    place: usize,
    binary: bool,
    swapped: bool,
}

impl Cursor<'_> {
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
            .get(self.place..)
            .filter(|rest| !rest.is_empty())?;
        let end = rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
        self.place += (end + 1).min(rest.len());
        Some(String::from_utf8_lossy(&rest[..end]).trim().to_string())
    }

    /// Goes behind the line that is `word`; false if there is none.
    fn skip_past(&mut self, word: &str) -> bool {
        let rest = &self.bytes[self.place.min(self.bytes.len())..];
        let found = rest.windows(word.len()).position(|w| w == word.as_bytes());
        if let Some(at) = found {
            self.place += at + word.len();
            self.line();
        }
        found.is_some()
    }

    fn word(&mut self) -> Found<&str> {
        let rest = &self.bytes[self.place.min(self.bytes.len())..];
        let begin = rest
            .iter()
            .position(|b| !b.is_ascii_whitespace())
            .unwrap_or(rest.len());
        let length = rest[begin..].iter().position(|b| b.is_ascii_whitespace());
        let word = &rest[begin..begin + length.unwrap_or(rest.len() - begin)];
        self.place += begin + word.len();
        match std::str::from_utf8(word) {
            Ok(word) if !word.is_empty() => Ok(word),
            _ => Err(Fault::damaged("ends where a number should be")),
        }
    }

    fn parsed<T: std::str::FromStr>(&mut self) -> Found<T> {
        let word = self.word()?;
        let fault = || Fault::damaged(format!("has '{word}' where a number should be"));
        word.parse().map_err(|_| fault())
    }

    fn raw<const N: usize>(&mut self) -> Found<[u8; N]> {
        let bytes = self.bytes.get(self.place..self.place + N);
        let mut bytes: [u8; N] = bytes
            .and_then(|bytes| bytes.try_into().ok())
            .ok_or_else(|| Fault::damaged("is cut off"))?;
        self.place += N;
        if self.swapped {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn int(&mut self) -> Found<i64> {
        match self.binary {
            true => Ok(i64::from(i32::from_le_bytes(self.raw()?))),
            false => self.parsed(),
        }
    }

    fn size(&mut self) -> Found<u64> {
        match self.binary {
            true => Ok(u64::from_le_bytes(self.raw()?)),
            false => self.parsed(),
        }
    }

    fn real(&mut self) -> Found<f64> {
        match self.binary {
            true => Ok(f64::from_le_bytes(self.raw()?)),
            false => self.parsed(),
        }
    }

    fn point(&mut self) -> Found<[f64; 3]> {
        Ok([self.real()?, self.real()?, self.real()?])
    }

    /// A physical tag or an entity's, as a group's number.
    fn tag(&mut self) -> Found<i32> {
        let tag = self.int()?;
        i32::try_from(tag).map_err(|_| Fault::damaged(format!("has the tag {tag}")))
    }

    fn format(&mut self) -> Found<f64> {
        let version: f64 = self.parsed()?;
        let (binary, width): (u8, u8) = (self.parsed()?, self.parsed()?);
        self.line();
        if !(version == 4.1 || (2.0..3.0).contains(&version)) || width != 8 {
            return Err(Fault {
                problem: format!("is of version {version} with numbers of {width} bytes"),
                remedy: "write version 2.2 or 4.1 (gmsh -format msh41)",
            });
        }
        if binary == 1 {
            let one: [u8; 4] = self.raw()?;
            self.swapped = match one {
                [1, 0, 0, 0] => false,
                [0, 0, 0, 1] => true,
                _ => return Err(Fault::damaged("does not say its order of bytes")),
            };
        }
        self.binary = binary == 1;
        Ok(version)
    }

    fn names(&mut self) -> Found<BTreeMap<Group, String>> {
        let count: usize = self.parsed()?;
        let mut names = BTreeMap::new();
        for _ in 0..count {
            let group = (self.parsed()?, self.parsed()?);
            let line = self.line().unwrap_or_default();
            names.insert(group, line.trim_matches('"').to_string());
        }
        Ok(names)
    }

    /// The physical group of each entity that has one.
    fn entities(&mut self) -> Found<BTreeMap<Group, i32>> {
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

    fn nodes_2(&mut self, nodes: &mut Nodes) -> Found<()> {
        let count: u64 = self.parsed()?;
        self.line();
        for _ in 0..count {
            let number = self.int()?;
            nodes.numbers.push(number as u64);
            nodes.positions.push(self.point()?);
        }
        Ok(())
    }

    fn nodes_4(&mut self, nodes: &mut Nodes) -> Found<()> {
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

    fn elements_2(&mut self, elements: &mut Vec<(Group, [u64; 4])>) -> Found<()> {
        let count: u64 = self.parsed()?;
        self.line();
        let mut left = count;
        while left > 0 {
            // Text has a type for each element, binary for a row of them.
            let (number, kind_number, row, tags) = match self.binary {
                true => (None, self.int()?, self.int()?, self.int()?),
                false => {
                    let number = self.int()?;
                    (Some(number), self.int()?, 1, self.int()?)
                }
            };
            let (dim, nodes, corners) = kind(kind_number)?;
            let row = u64::try_from(row).unwrap_or(0).min(left);
            if row == 0 {
                return Err(Fault::damaged("has a row of no elements"));
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

    fn elements_4(
        &mut self,
        entities: &BTreeMap<Group, i32>,
        elements: &mut Vec<(Group, [u64; 4])>,
    ) -> Found<()> {
        let [blocks, _, _, _] = [self.size()?, self.size()?, self.size()?, self.size()?];
        for _ in 0..blocks {
            self.int()?;
            let entity = self.tag()?;
            let (dim, nodes, corners) = kind(self.int()?)?;
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
