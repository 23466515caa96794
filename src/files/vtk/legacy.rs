//! Converts legacy VTK files (`.vtk`), which `vtkio` reads, to the XML format that the other
//! modules here read.
//!
//! Two things that `vtkio` does not know are replaced before it sees the file: the names of number
//! types that VTK writes since version 9, and field data in front of a data set. `vtkio` reads
//! origins and spacings in single precision, so they are taken from the text instead. Layout:
//! <https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html>.

use std::io::Cursor;

use vtkio::model::{
    Attribute, Attributes, CellType, Cells, DataSet, ElementType, Extent, FieldArray, IOBuffer,
    Piece, VertexNumbers, Vtk,
};

use super::{ArrayPacking, DataArray, Document, Values};

/// The first bytes of every legacy file.
pub const MAGIC: &[u8] = b"# vtk DataFile";

/// Upper bound of the length of a file's head in bytes: three lines, the line of the data set, and
/// three more for images.
const MAX_HEADER_BYTES: usize = 2048;

/// Converts a legacy file to the bytes of an XML file with the same content.
///
/// # Errors
/// Returns a text that says what is wrong with the file.
pub fn to_xml(bytes: &[u8]) -> Result<Vec<u8>, String> {
    let bytes = &replace_type_names(bytes);
    let begin = data_set_line_end(bytes).ok_or("is a VTK file without a data set")?;
    let (fields, bytes) = split_field_data(bytes, begin)?;
    let data = parse(&bytes)?;
    let kind = match &data {
        DataSet::ImageData { .. } => "ImageData",
        DataSet::UnstructuredGrid { .. } => "UnstructuredGrid",
        DataSet::PolyData { .. } => "PolyData",
        DataSet::RectilinearGrid { .. } => "RectilinearGrid",
        DataSet::StructuredGrid { .. } => "StructuredGrid",
        _ => return Err("holds no grid and no poly data".into()),
    };
    let mut content = XmlContent {
        fields: fields
            .into_iter()
            .map(field_array)
            .collect::<Result<_, _>>()?,
        ..XmlContent::default()
    };
    match data {
        DataSet::ImageData { extent, pieces, .. } => {
            content.take_extent(&extent)?;
            for (word, attribute) in [
                ("ORIGIN", "Origin"),
                ("SPACING", "Spacing"),
                ("ASPECT_RATIO", "Spacing"),
            ] {
                let value = find_line_value(&bytes[begin..], word);
                content
                    .attributes
                    .extend(value.map(|text| (attribute, text)));
            }
            content.take_attributes(single_piece(pieces)?.data)?;
        }
        DataSet::RectilinearGrid { pieces, .. } => {
            let piece = single_piece(pieces)?;
            content.take_extent(&piece.extent)?;
            let coordinates = [piece.coords.x, piece.coords.y, piece.coords.z];
            for (axis, values) in ["x", "y", "z"].into_iter().zip(coordinates) {
                let array = DataArray::scalars(axis, to_values(values)?);
                content.coordinates.push(array);
            }
            content.take_attributes(piece.data)?;
        }
        DataSet::StructuredGrid { pieces, .. } => {
            let piece = single_piece(pieces)?;
            content.take_extent(&piece.extent)?;
            content.points = Some(to_values(piece.points)?);
            content.take_attributes(piece.data)?;
        }
        DataSet::UnstructuredGrid { pieces, .. } => {
            let piece = single_piece(pieces)?;
            let points = to_values(piece.points)?;
            let count = points.len() / 3;
            content.piece.push(("NumberOfPoints", count.to_string()));
            content.points = Some(points);
            content.take_cells(piece.cells)?;
            content.take_attributes(piece.data)?;
        }
        DataSet::PolyData { pieces, .. } => {
            let piece = single_piece(pieces)?;
            let points = to_values(piece.points)?;
            let count = points.len() / 3;
            content.piece.push(("NumberOfPoints", count.to_string()));
            content.points = Some(points);
            for (element, cells) in [
                ("Verts", piece.verts),
                ("Lines", piece.lines),
                ("Strips", piece.strips),
                ("Polys", piece.polys),
            ] {
                content.take_polygons(element, cells)?;
            }
            content.take_attributes(piece.data)?;
        }
        DataSet::Field { .. } => {}
    }
    content.to_xml(kind).map_err(|error| error.to_string())
}

/// Parses the data set. Returns an error if any of the file is not understood.
fn parse(bytes: &[u8]) -> Result<DataSet, String> {
    let damaged = "is damaged, cut off, or holds more than numbers";
    let (rest, Vtk { data, .. }) = vtkio::parser::parse_be(bytes).map_err(|_| damaged)?;
    if rest.iter().all(u8::is_ascii_whitespace) {
        Ok(data)
    } else {
        Err(damaged.into())
    }
}

/// Returns the only piece: legacy files have exactly one.
fn single_piece<P>(pieces: Vec<Piece<P>>) -> Result<P, String> {
    match pieces.into_iter().next() {
        Some(Piece::Inline(piece)) => Ok(*piece),
        _ => Err("holds nothing".into()),
    }
}

/// Replaces VTK's new names of number types by the old ones.
fn replace_type_names(bytes: &[u8]) -> Vec<u8> {
    let mut converted = Vec::with_capacity(bytes.len());
    for line in bytes.split_inclusive(|&b| b == b'\n') {
        let names = [
            (" vtktypeint64\n", " long\n"),
            (" vtktypeuint64\n", " unsigned_long\n"),
        ];
        let is_cells = line.starts_with(b"OFFSETS") || line.starts_with(b"CONNECTIVITY");
        let renamed = names.iter().find(|(new, _)| line.ends_with(new.as_bytes()));
        match renamed {
            Some((new, old)) if !is_cells => {
                converted.extend(&line[..line.len() - new.len()]);
                converted.extend(old.as_bytes());
            }
            _ => converted.extend(line),
        }
    }
    converted
}

/// Returns the position after the line that names the data set.
fn data_set_line_end(bytes: &[u8]) -> Option<usize> {
    let mut end = 0;
    for line in bytes[..bytes.len().min(MAX_HEADER_BYTES)].split_inclusive(|&b| b == b'\n') {
        end += line.len();
        if line.len() > 7 && line[..7].eq_ignore_ascii_case(b"DATASET") {
            return Some(end);
        }
    }
    None
}

/// Separates the field data that stands in front of the data set. Returns the field data and the
/// file without it.
fn split_field_data(bytes: &[u8], begin: usize) -> Result<(Vec<FieldArray>, Vec<u8>), String> {
    let rest = bytes[begin..].trim_ascii_start();
    if !rest.starts_with(b"FIELD") {
        return Ok((Vec::new(), bytes.to_vec()));
    }
    let header = bytes[..begin].trim_ascii_end();
    let line_break = header.iter().rposition(|&b| b == b'\n').unwrap_or(0);
    // For `vtkio` field data is a data set of its own.
    let field_file = [&bytes[..=line_break], rest].concat();
    match vtkio::parser::parse_be(&field_file) {
        Ok((
            remaining,
            Vtk {
                data: DataSet::Field { data_array, .. },
                ..
            },
        )) => Ok((data_array, [&bytes[..begin], remaining].concat())),
        _ => Err("has field data other than numbers".into()),
    }
}

/// Returns the words after `keyword` on the first line that begins with it.
fn find_line_value(bytes: &[u8], keyword: &str) -> Option<String> {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(MAX_HEADER_BYTES)]);
    let mut lines = head.lines();
    lines.find_map(|line| {
        let mut words = line.split_ascii_whitespace();
        let first = words.next()?;
        let rest: Vec<&str> = words.collect();
        first.eq_ignore_ascii_case(keyword).then(|| rest.join(" "))
    })
}

fn to_values(buffer: IOBuffer) -> Result<Values, String> {
    Ok(match buffer {
        IOBuffer::Bit(_) => return Err("has an array of bits, which is not read".into()),
        IOBuffer::U8(v) => v.into(),
        IOBuffer::I8(v) => v.into(),
        IOBuffer::U16(v) => v.into(),
        IOBuffer::I16(v) => v.into(),
        IOBuffer::U32(v) => v.into(),
        IOBuffer::I32(v) => v.into(),
        IOBuffer::U64(v) => v.into(),
        IOBuffer::I64(v) => v.into(),
        IOBuffer::F32(v) => v.into(),
        IOBuffer::F64(v) => v.into(),
    })
}

fn field_array(array: FieldArray) -> Result<DataArray, String> {
    Ok(DataArray {
        name: decode_name(&array.name),
        components: array.elem as usize,
        values: to_values(array.data)?,
    })
}

/// Decodes the name of an array: characters such as spaces stand in it as `%20`.
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

/// The content of the XML file.
#[derive(Default)]
struct XmlContent {
    /// Attributes of the data set.
    attributes: Vec<(&'static str, String)>,
    /// Attributes of the only piece.
    piece: Vec<(&'static str, String)>,
    fields: Vec<DataArray>,
    /// The name of the active scalars on points.
    scalars: Option<String>,
    point_arrays: Vec<DataArray>,
    cell_arrays: Vec<DataArray>,
    points: Option<Values>,
    /// The coordinates of a rectilinear grid along each axis.
    coordinates: Vec<DataArray>,
    /// Elements of cells, each with its arrays.
    cells: Vec<(&'static str, Vec<DataArray>)>,
}

impl XmlContent {
    /// Sets the extent of a grid, whose points count from 0.
    fn take_extent(&mut self, extent: &Extent) -> Result<(), String> {
        let Extent::Dims(dims) = extent else {
            return Err("has no numbers of points".into());
        };
        let extent = dims.map(|n| format!("0 {}", i64::from(n) - 1)).join(" ");
        self.attributes.push(("WholeExtent", extent.clone()));
        self.piece.push(("Extent", extent));
        Ok(())
    }

    fn take_attributes(&mut self, data: Attributes) -> Result<(), String> {
        let is_scalars = |attribute: &&Attribute| {
            matches!(attribute, Attribute::DataArray(array)
                if matches!(array.elem, ElementType::Scalars { .. }))
        };
        let active = data.point.iter().find(is_scalars);
        self.scalars = active.map(|attribute| decode_name(attribute.name()));
        for (attributes, arrays) in [
            (data.point, &mut self.point_arrays),
            (data.cell, &mut self.cell_arrays),
        ] {
            for attribute in attributes {
                match attribute {
                    Attribute::DataArray(array) if array.elem == ElementType::LookupTable => {}
                    Attribute::DataArray(array) => arrays.push(DataArray {
                        name: decode_name(&array.name),
                        components: array.elem.num_comp() as usize,
                        values: to_values(array.data)?,
                    }),
                    Attribute::Field { data_array, .. } => {
                        for array in data_array {
                            arrays.push(field_array(array)?);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    fn take_cells(&mut self, cells: Cells) -> Result<(), String> {
        let count = cells.types.len();
        let (connectivity, ends) = match cells.cell_verts {
            VertexNumbers::Legacy { vertices, .. } => {
                split_cells(&vertices).ok_or("has broken cells")?
            }
            VertexNumbers::XML {
                connectivity,
                offsets,
            } => {
                // VTK writes the start of each cell and the end of the last; XML files need the
                // ends only.
                let begins = offsets.len() == count + 1;
                (
                    connectivity,
                    offsets
                        .get(usize::from(begins)..)
                        .unwrap_or_default()
                        .to_vec(),
                )
            }
        };
        let types: Vec<u8> = cells.types.iter().map(|&kind| kind as u8).collect();
        let polyhedra = cells.types.iter().all(|&kind| kind == CellType::Polyhedron);
        // The points of a polyhedron are listed by its faces.
        let names = if polyhedra && count > 0 {
            ["faces", "faceoffsets"]
        } else {
            ["connectivity", "offsets"]
        };
        let arrays = vec![
            DataArray::scalars(names[0], connectivity),
            DataArray::scalars(names[1], ends),
            DataArray::scalars("types", types),
        ];
        self.cells.push(("Cells", arrays));
        self.piece.push(("NumberOfCells", count.to_string()));
        Ok(())
    }

    /// Adds the polygons, lines or points of poly data.
    fn take_polygons(
        &mut self,
        element: &'static str,
        cells: Option<VertexNumbers>,
    ) -> Result<(), String> {
        let (connectivity, ends) = match cells {
            None => return Ok(()),
            Some(VertexNumbers::Legacy { vertices, .. }) => {
                split_cells(&vertices).ok_or("has broken cells")?
            }
            Some(VertexNumbers::XML {
                connectivity,
                offsets,
            }) => {
                let begins = usize::from(offsets.first() == Some(&0));
                (connectivity, offsets[begins..].to_vec())
            }
        };
        let arrays = vec![
            DataArray::scalars("connectivity", connectivity),
            DataArray::scalars("offsets", ends),
        ];
        self.cells.push((element, arrays));
        Ok(())
    }

    fn to_xml(&self, kind: &'static str) -> std::io::Result<Vec<u8>> {
        let mut document = Document::with_packing(kind, &self.attributes, ArrayPacking::None);
        open_with_arrays(&mut document, "FieldData", &[], &self.fields);
        document.close();
        document.open("Piece", &self.piece);
        let scalars = self.scalars.iter();
        let active: Vec<_> = scalars.map(|name| ("Scalars", name.clone())).collect();
        open_with_arrays(&mut document, "PointData", &active, &self.point_arrays);
        document.close();
        open_with_arrays(&mut document, "CellData", &[], &self.cell_arrays);
        document.close();
        if !self.coordinates.is_empty() {
            open_with_arrays(&mut document, "Coordinates", &[], &self.coordinates);
            document.close();
        }
        if let Some(points) = &self.points {
            document.open("Points", &[]);
            document.add_array(points.source("Points", 3));
            document.close();
            for (element, arrays) in &self.cells {
                open_with_arrays(&mut document, element, &[], arrays);
                document.close();
            }
        }
        let mut bytes = Cursor::new(Vec::new());
        document.write(&mut bytes)?;
        Ok(bytes.into_inner())
    }
}

/// Opens an element and adds arrays to it.
fn open_with_arrays<'a>(
    document: &mut Document<'a>,
    element: &'static str,
    attributes: &[(&str, String)],
    arrays: &'a [DataArray],
) {
    document.open(element, attributes);
    for array in arrays {
        document.add_array(array.values.source(&array.name, array.components));
    }
}

/// Splits a list in which each cell begins with the count of its nodes. Returns the nodes of all
/// cells, and the end of each cell in that list.
fn split_cells(cells: &[u32]) -> Option<(Vec<u64>, Vec<u64>)> {
    let (mut nodes, mut ends) = (Vec::new(), Vec::new());
    let mut rest = cells;
    while let [size, after @ ..] = rest {
        let (cell_nodes, next) = after.split_at_checked(*size as usize)?;
        nodes.extend(cell_nodes.iter().map(|&n| u64::from(n)));
        ends.push(nodes.len() as u64);
        rest = next;
    }
    Some((nodes, ends))
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
        assert!(error_after("region int", "region string").contains("damaged"));
        assert!(error_after("4 0 1 2 3", "9 0 1 2 3").contains("broken cells"));
        assert!(error_after("UNSTRUCTURED_GRID", "NOTHING").contains("damaged"));
        assert!(error_after("DATASET", "SET").contains("without a data set"));
    }
}
