//! Converts legacy VTK files (`.vtk`) to the XML format that the other modules here read.
//!
//! Every number type and every attribute that VTK writes is read, as text and as binary. Values of
//! 8-bit arrays, which VTK writes to text files as shares of 255 (`COLOR_SCALARS`), become integers
//! again. Texts among the field data are kept as the bytes of their UTF-8, one text a line; texts on
//! points or cells are left out. Layout:
//! <https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html>, and VTK's class
//! `vtkDataReader` for what that page leaves out.

use super::xml_content::{CellLists, Owner, XmlContent};
use super::{DataArray, Values};

/// The first bytes of every legacy file.
pub const MAGIC: &[u8] = b"# vtk DataFile";

/// Converts a legacy file to the bytes of an XML file with the same content.
///
/// # Errors
/// Returns a text that says what is wrong with the file.
pub fn to_xml(bytes: &[u8]) -> Result<Vec<u8>, String> {
    let (kind, content) = Reader::new(bytes)?.read()?;
    content.to_xml(kind).map_err(|error| error.to_string())
}

/// A position in a legacy file.
struct Reader<'a> {
    bytes: &'a [u8],
    position: usize,
    is_binary: bool,
}

/// Returns the error for a file that ends too early.
fn cut_off() -> String {
    "is damaged or cut off".into()
}

impl<'a> Reader<'a> {
    /// Reads the three lines at the head of a file.
    fn new(bytes: &'a [u8]) -> Result<Self, String> {
        let mut reader = Self {
            bytes,
            position: 0,
            is_binary: false,
        };
        reader.line();
        reader.line();
        let encoding = reader.word()?.to_ascii_uppercase();
        reader.is_binary = match encoding.as_str() {
            "ASCII" => false,
            "BINARY" => true,
            _ => return Err(format!("is neither ASCII nor BINARY, but '{encoding}'")),
        };
        Ok(reader)
    }

    /// Reads the data set, and returns VTK's name of its kind and its content.
    fn read(mut self) -> Result<(&'static str, XmlContent), String> {
        let mut content = XmlContent::default();
        let mut kind = None;
        let mut owner = (Owner::Whole, 0);
        while let Some(keyword) = self.keyword() {
            match keyword.as_str() {
                "DATASET" => {
                    kind = Some(match self.word()?.to_ascii_uppercase().as_str() {
                        "STRUCTURED_POINTS" => "ImageData",
                        "UNSTRUCTURED_GRID" => "UnstructuredGrid",
                        "POLYDATA" => "PolyData",
                        "RECTILINEAR_GRID" => "RectilinearGrid",
                        "STRUCTURED_GRID" => "StructuredGrid",
                        other => {
                            return Err(format!("holds {other}, and no grid or poly data"));
                        }
                    });
                }
                "POINT_DATA" => owner = (Owner::Points, self.count()?),
                "CELL_DATA" => owner = (Owner::Cells, self.count()?),
                "METADATA" => self.skip_metadata(),
                "FIELD" => self.field(&mut content, owner.0)?,
                _ if owner.0 == Owner::Whole => self.geometry(&keyword, &mut content)?,
                _ => self.attribute(&keyword, &mut content, owner.0, owner.1)?,
            }
        }
        let kind = kind.ok_or("is a VTK file without a data set")?;
        let is_complete = match kind {
            "ImageData" => content.attributes.iter().any(|a| a.0 == "WholeExtent"),
            "UnstructuredGrid" => content.points.is_some() && !content.cells.is_empty(),
            "RectilinearGrid" => content.coordinates.len() == 3,
            _ => content.points.is_some(),
        };
        if !is_complete {
            return Err("is damaged or cut off: it has no points or no cells".into());
        }
        Ok((kind, content))
    }

    /// Reads a part of the geometry of a data set.
    fn geometry(&mut self, keyword: &str, content: &mut XmlContent) -> Result<(), String> {
        match keyword {
            "DIMENSIONS" => {
                let dims = [self.count()?, self.count()?, self.count()?];
                let extent = dims.map(|n| format!("0 {}", n as i64 - 1)).join(" ");
                content.attributes.push(("WholeExtent", extent.clone()));
                content.piece.push(("Extent", extent));
            }
            "ORIGIN" | "SPACING" | "ASPECT_RATIO" => {
                let name = if keyword == "ORIGIN" {
                    "Origin"
                } else {
                    "Spacing"
                };
                let vector = [self.word()?, self.word()?, self.word()?].join(" ");
                content.attributes.push((name, vector));
            }
            "X_COORDINATES" | "Y_COORDINATES" | "Z_COORDINATES" => {
                let count = self.count()?;
                let name = keyword[..1].to_ascii_lowercase();
                let values = self.values_of_type(count, 1)?;
                content.coordinates.push(DataArray::scalars(name, values));
            }
            "POINTS" => {
                let count = self.count()?;
                let values = self.values_of_type(count, 3)?;
                content.piece.push(("NumberOfPoints", count.to_string()));
                content.points = Some(values);
            }
            "CELLS" => content.cell_lists = self.cell_lists()?,
            "CELL_TYPES" => {
                let count = self.count()?;
                self.end_line();
                let types = self.values("int", count)?.to_i64();
                content.take_cells(types)?;
            }
            "VERTICES" => content.take_polygons("Verts", self.cell_lists()?),
            "LINES" => content.take_polygons("Lines", self.cell_lists()?),
            "TRIANGLE_STRIPS" => content.take_polygons("Strips", self.cell_lists()?),
            "POLYGONS" => content.take_polygons("Polys", self.cell_lists()?),
            _ => return Err(format!("is damaged: '{keyword}' is no keyword of VTK")),
        }
        Ok(())
    }

    /// Reads the nodes of cells. Files of version 5 have offsets and nodes, older ones the number of
    /// nodes in front of the nodes of each cell.
    fn cell_lists(&mut self) -> Result<CellLists, String> {
        let (count, size) = (self.count()?, self.count()?);
        let before = self.position;
        if self.keyword().as_deref() != Some("OFFSETS") {
            self.position = before;
            self.end_line();
            let lists = self.values("int", size)?.to_i64();
            return split_cells(&lists, count).ok_or_else(|| "has broken cells".into());
        }
        let mut ends = self.values_of_type(count, 1)?.to_i64();
        // These are the start of each cell, and the end of the last.
        if !ends.is_empty() {
            ends.remove(0);
        }
        if self.keyword().as_deref() != Some("CONNECTIVITY") {
            return Err("is damaged: its cells have no CONNECTIVITY".into());
        }
        let nodes = self.values_of_type(size, 1)?.to_i64();
        let are_valid = ends.is_sorted()
            && ends.first().is_none_or(|&end| end >= 0)
            && ends.last().is_none_or(|&end| end as usize == nodes.len());
        if !are_valid {
            return Err("has broken cells".into());
        }
        Ok(CellLists { nodes, ends })
    }

    /// Reads values that belong to points or to cells.
    fn attribute(
        &mut self,
        keyword: &str,
        content: &mut XmlContent,
        owner: Owner,
        count: usize,
    ) -> Result<(), String> {
        let name = decode_name(&self.word()?);
        let array = |components, values| DataArray {
            name: name.clone(),
            components,
            values,
        };
        let array = match keyword {
            "SCALARS" => {
                let kind = self.word()?;
                let components = match self.line().trim() {
                    "" => 1,
                    text => text.parse().map_err(|_| cut_off())?,
                };
                let before = self.position;
                if self.keyword().as_deref() == Some("LOOKUP_TABLE") {
                    self.line();
                } else {
                    self.position = before;
                }
                array(components, self.values(&kind, product(count, components)?)?)
            }
            "COLOR_SCALARS" => {
                let components = self.count()?;
                self.end_line();
                let values = self.colors(product(count, components)?)?;
                array(components, values)
            }
            "LOOKUP_TABLE" => {
                let size = self.count()?;
                self.end_line();
                self.colors(product(size, 4)?)?;
                return Ok(());
            }
            "TEXTURE_COORDINATES" => {
                let components = self.count()?;
                array(components, self.values_of_type(count, components)?)
            }
            "VECTORS" | "NORMALS" => array(3, self.values_of_type(count, 3)?),
            "TENSORS" => array(9, self.values_of_type(count, 9)?),
            "TENSORS6" => array(6, self.values_of_type(count, 6)?),
            "GLOBAL_IDS" | "PEDIGREE_IDS" | "EDGE_FLAGS" => {
                array(1, self.values_of_type(count, 1)?)
            }
            _ => return Err(format!("is damaged: '{keyword}' is no keyword of VTK")),
        };
        let is_active = ["SCALARS", "COLOR_SCALARS"].contains(&keyword);
        if is_active && owner == Owner::Points && content.scalars.is_none() {
            content.scalars = Some(array.name.clone());
        }
        content.arrays_of(owner).push(array);
        Ok(())
    }

    /// Reads arrays that each state their own size.
    fn field(&mut self, content: &mut XmlContent, owner: Owner) -> Result<(), String> {
        self.word()?;
        let count = self.count()?;
        let mut read = 0;
        while read < count {
            let word = self.word()?;
            if word == "METADATA" {
                self.skip_metadata();
                continue;
            }
            read += 1;
            let name = decode_name(&word);
            let (components, tuples) = (self.count()?, self.count()?);
            let kind = self.word()?;
            let total = product(components, tuples)?;
            let values = if ["string", "utf8_string"].contains(&kind.as_str()) {
                let text = self.texts(total)?.join("\n");
                if owner != Owner::Whole {
                    continue;
                }
                text.into_bytes().into()
            } else {
                self.end_line();
                self.values(&kind, total)?
            };
            let components = if values.len() == total { components } else { 1 };
            content.arrays_of(owner).push(DataArray {
                name,
                components: components.max(1),
                values,
            });
        }
        Ok(())
    }

    /// Reads the name of a number type, and in the next line as many tuples of that type.
    fn values_of_type(&mut self, tuples: usize, components: usize) -> Result<Values, String> {
        let kind = self.word()?;
        self.end_line();
        self.values(&kind, product(tuples, components)?)
    }

    /// Reads numbers of a type, at the beginning of a line.
    fn values(&mut self, kind: &str, count: usize) -> Result<Values, String> {
        let kind = kind.to_ascii_lowercase();
        if kind == "bit" {
            return self.bits(count);
        }
        let (name, size) = match kind.as_str() {
            "char" | "signed_char" => ("Int8", 1),
            "unsigned_char" => ("UInt8", 1),
            "short" => ("Int16", 2),
            "unsigned_short" => ("UInt16", 2),
            // VTK converts its own numbers of points and cells to 32 bits.
            "int" | "vtkidtype" => ("Int32", 4),
            "unsigned_int" => ("UInt32", 4),
            "long" | "long_long" | "vtktypeint64" => ("Int64", 8),
            "unsigned_long" | "unsigned_long_long" | "vtktypeuint64" => ("UInt64", 8),
            "float" => ("Float32", 4),
            "double" => ("Float64", 8),
            _ => {
                return Err(format!(
                    "has numbers of the type '{kind}', which is not read"
                ));
            }
        };
        if self.is_binary {
            let bytes = self.take(product(count, size)?)?;
            return Values::from_bytes(name, bytes, true).ok_or_else(cut_off);
        }
        let text = self.words(count)?;
        match Values::from_text(name, text) {
            Some(Ok(values)) => Ok(values),
            Some(Err(word)) => Err(format!("holds '{word}', which is not of type {kind}")),
            None => Err(cut_off()),
        }
    }

    /// Reads bits, which binary files pack from the highest bit of each byte.
    fn bits(&mut self, count: usize) -> Result<Values, String> {
        if !self.is_binary {
            return self.values("unsigned_char", count);
        }
        let bytes = self.take(count.div_ceil(8))?;
        let bit = |i: usize| bytes[i / 8] >> (7 - i % 8) & 1;
        Ok((0..count).map(bit).collect::<Vec<u8>>().into())
    }

    /// Reads 8-bit values, which text files hold as shares of 255.
    fn colors(&mut self, count: usize) -> Result<Values, String> {
        if self.is_binary {
            return self.values("unsigned_char", count);
        }
        let shares = self.values("double", count)?.to_f64();
        if let Some(share) = shares.iter().find(|share| !(0.0..=1.0).contains(*share)) {
            return Err(format!(
                "holds {share} in COLOR_SCALARS, which are shares from 0 to 1"
            ));
        }
        let value = |share: &f64| (share * 255.0).round() as u8;
        Ok(shares.iter().map(value).collect::<Vec<u8>>().into())
    }

    /// Reads texts: one a line, or in a binary file each behind its length.
    fn texts(&mut self, count: usize) -> Result<Vec<String>, String> {
        self.end_line();
        let mut texts = Vec::new();
        for _ in 0..count {
            if !self.is_binary {
                if self.position >= self.bytes.len() {
                    return Err(cut_off());
                }
                texts.push(decode_name(self.line().trim_end()));
                continue;
            }
            // The two highest bits of the length are the number of its bytes.
            let first = *self.bytes.get(self.position).ok_or_else(cut_off)?;
            let width = [8, 4, 2, 1][usize::from(first >> 6)];
            let length = self
                .take(width)?
                .iter()
                .fold(0u64, |n, &b| n << 8 | u64::from(b));
            let length = length & (u64::MAX >> (64 - 8 * width as u32 + 2));
            let bytes = self.take(usize::try_from(length).map_err(|_| cut_off())?)?;
            texts.push(String::from_utf8_lossy(bytes).into_owned());
        }
        Ok(texts)
    }

    /// Moves behind the next empty line.
    fn skip_metadata(&mut self) {
        self.end_line();
        while self.position < self.bytes.len() && !self.line().trim().is_empty() {}
    }

    /// Returns the next word in upper case; `None` at the end of the file.
    fn keyword(&mut self) -> Option<String> {
        Some(self.word().ok()?.to_ascii_uppercase())
    }

    fn word(&mut self) -> Result<String, String> {
        let text = self.words(1)?.trim_ascii();
        Ok(text.to_string())
    }

    fn count(&mut self) -> Result<usize, String> {
        let word = self.word()?;
        let problem = || format!("is damaged: '{word}' stands where a count should be");
        word.parse().map_err(|_| problem())
    }

    /// Returns the text of the next `count` words, and moves behind it.
    fn words(&mut self, count: usize) -> Result<&'a str, String> {
        let begin = self.position;
        let mut end = begin;
        for _ in 0..count {
            let rest = self.bytes.get(end..).unwrap_or_default();
            let blank = rest.iter().take_while(|b| b.is_ascii_whitespace()).count();
            let word = rest[blank..]
                .iter()
                .take_while(|b| !b.is_ascii_whitespace())
                .count();
            if word == 0 {
                return Err(cut_off());
            }
            end += blank + word;
        }
        self.position = end;
        std::str::from_utf8(&self.bytes[begin..end])
            .map_err(|_| "is damaged: it holds bytes where text should be".into())
    }

    /// Returns the remainder of the line, and moves behind it.
    fn line(&mut self) -> String {
        let rest = self.bytes.get(self.position..).unwrap_or_default();
        let length = rest.iter().take_while(|&&b| b != b'\n').count();
        self.position += (length + 1).min(rest.len());
        String::from_utf8_lossy(&rest[..length]).into_owned()
    }

    /// Moves to the next line if only blanks are left in this one.
    fn end_line(&mut self) {
        let rest = self.bytes.get(self.position..).unwrap_or_default();
        let blanks = rest
            .iter()
            .take_while(|b| [b' ', b'\t', b'\r'].contains(b))
            .count();
        if rest.get(blanks) == Some(&b'\n') {
            self.position += blanks + 1;
        }
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let end = self.position.checked_add(count);
        let bytes = end.and_then(|end| self.bytes.get(self.position..end));
        let bytes = bytes.ok_or_else(cut_off)?;
        self.position += count;
        Ok(bytes)
    }
}

fn product(a: usize, b: usize) -> Result<usize, String> {
    a.checked_mul(b).ok_or_else(cut_off)
}

/// Splits a list in which each cell begins with the count of its nodes.
fn split_cells(lists: &[i64], count: usize) -> Option<CellLists> {
    let mut cells = CellLists::default();
    let mut rest = lists;
    while let [size, after @ ..] = rest {
        let (nodes, next) = after.split_at_checked(usize::try_from(*size).ok()?)?;
        cells.nodes.extend(nodes);
        cells.ends.push(cells.nodes.len() as i64);
        rest = next;
    }
    (cells.ends.len() == count).then_some(cells)
}

/// Decodes a text in which characters such as spaces stand as `%20`.
fn decode_name(name: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = name.as_bytes();
    while let [first, after @ ..] = rest {
        let code = after
            .get(..2)
            .and_then(|code| std::str::from_utf8(code).ok());
        match code.and_then(|code| u8::from_str_radix(code, 16).ok()) {
            Some(byte) if *first == b'%' => {
                bytes.push(byte);
                rest = &after[2..];
            }
            _ => {
                bytes.push(*first);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_decoded() {
        assert_eq!(decode_name("two%20words"), "two words");
        assert_eq!(decode_name("100%"), "100%");
        assert_eq!(decode_name("%zz%c3%bc"), "%zzü");
    }

    /// A file that is cut off at any position is refused and never causes a panic.
    #[test]
    fn damaged_files_are_refused() {
        let text = "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\n\
                    POINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\nCELLS 1 5\n4 0 1 2 3\n\
                    CELL_TYPES 1\n10\nCELL_DATA 1\nSCALARS region int 1\nLOOKUP_TABLE default\n7\n";
        assert!(to_xml(text.as_bytes()).is_ok());
        // The line break at the end of the file may be missing.
        for end in 0..text.find("CELL_TYPES").unwrap() {
            assert!(to_xml(&text.as_bytes()[..end]).is_err(), "cut at {end}");
        }
        let error_after =
            |old: &str, new: &str| to_xml(text.replace(old, new).as_bytes()).unwrap_err();
        assert!(error_after("CELL_DATA 1", "CELL_DATA 2").contains("damaged"));
        assert!(error_after("region int", "region string").contains("type 'string'"));
        assert!(error_after("4 0 1 2 3", "9 0 1 2 3").contains("broken cells"));
        assert!(error_after("UNSTRUCTURED_GRID", "NOTHING").contains("holds NOTHING"));
        assert!(error_after("DATASET", "SET").contains("no keyword of VTK"));
        assert!(error_after("ASCII", "EBCDIC").contains("neither ASCII nor BINARY"));
    }

    #[test]
    fn arrays_of_all_number_types_are_read_from_text_and_from_binary() {
        let types: [(&str, &[u8]); 13] = [
            ("bit", &[0b0100_0000]),
            ("char", &[0, 10]),
            ("signed_char", &[0, 10]),
            ("unsigned_char", &[0, 10]),
            ("short", &[0, 0, 0, 10]),
            ("unsigned_short", &[0, 0, 0, 10]),
            ("int", &[0, 0, 0, 0, 0, 0, 0, 10]),
            ("unsigned_int", &[0, 0, 0, 0, 0, 0, 0, 10]),
            ("vtkIdType", &[0, 0, 0, 0, 0, 0, 0, 10]),
            ("long", &[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 10]),
            (
                "vtktypeint64",
                &[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 10],
            ),
            (
                "vtktypeuint64",
                &[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 10],
            ),
            ("float", &[0, 0, 0, 0, 0x41, 0x20, 0, 0]),
        ];
        for (kind, bytes) in types {
            // A space before the end of the line, as VTK writes it, and the number of components,
            // as others do.
            for components in [" ", " 1"] {
                let head = |encoding: &str| {
                    format!(
                        "# vtk DataFile Version 5.1\ntitle\n{encoding}\nDATASET STRUCTURED_POINTS\n                         DIMENSIONS 2 1 1\nSPACING 1 1 1\nORIGIN 0 0 0\nPOINT_DATA 2\n                         SCALARS s {kind}{components}\nLOOKUP_TABLE default\n"
                    )
                };
                let last = if kind == "bit" { 1 } else { 10 };
                let text = head("ASCII") + &format!("0 {last} \nMETADATA\nINFORMATION 0\n\n");
                let binary = [head("BINARY").as_bytes(), bytes, b"\nMETADATA\n\n"].concat();
                for file in [text.as_bytes(), &binary] {
                    let (_, content) = Reader::new(file).and_then(Reader::read).unwrap();
                    assert_eq!(content.scalars.as_deref(), Some("s"), "{kind}");
                    assert_eq!(content.point_arrays[0].values.to_i64(), [0, last], "{kind}");
                }
            }
        }
    }

    #[test]
    fn values_of_eight_bits_are_read_from_shares_of_255() {
        let file = "# vtk DataFile Version 5.1\n\nASCII\nDATASET STRUCTURED_POINTS\n                    DIMENSIONS 2 1 1\nPOINT_DATA 2\nCOLOR_SCALARS s 1\n0.0392157 0.783";
        let read = |text: &str| Reader::new(text.as_bytes()).and_then(Reader::read);
        let (_, content) = read(file).unwrap();
        assert_eq!(content.point_arrays[0].values, Values::U8(vec![10, 200]));
        assert!(read(&file.replace("0.783", "7")).is_err_and(|e| e.contains("from 0 to 1")));
    }
}
