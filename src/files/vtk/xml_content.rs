//! The content of a legacy VTK file, and its conversion to XML.

use std::io::Cursor;

use super::{ArrayPacking, DataArray, Document, Values};

/// VTK's type of polyhedra.
const POLYHEDRON: i64 = 42;

/// The part of a data set that the values of an attribute belong to.
#[derive(Clone, Copy, PartialEq)]
pub enum Owner {
    Whole,
    Points,
    Cells,
}

/// The nodes of cells, one cell after the other, and the end of each cell among them.
#[derive(Default)]
pub struct CellLists {
    pub nodes: Vec<i64>,
    pub ends: Vec<i64>,
}

impl CellLists {
    fn iter(&self) -> impl Iterator<Item = &[i64]> {
        let begins = std::iter::once(&0).chain(&self.ends);
        begins
            .zip(&self.ends)
            .map(|(&begin, &end)| &self.nodes[begin as usize..end as usize])
    }
}

/// The content of the XML file.
#[derive(Default)]
pub struct XmlContent {
    /// Attributes of the data set.
    pub attributes: Vec<(&'static str, String)>,
    /// Attributes of the only piece.
    pub piece: Vec<(&'static str, String)>,
    pub fields: Vec<DataArray>,
    /// The name of the active scalars on points.
    pub scalars: Option<String>,
    pub point_arrays: Vec<DataArray>,
    pub cell_arrays: Vec<DataArray>,
    pub points: Option<Values>,
    /// The coordinates of a rectilinear grid along each axis.
    pub coordinates: Vec<DataArray>,
    /// The nodes of cells whose types follow.
    pub cell_lists: CellLists,
    /// Elements of cells, each with its arrays.
    pub cells: Vec<(&'static str, Vec<DataArray>)>,
}

impl XmlContent {
    pub fn arrays_of(&mut self, owner: Owner) -> &mut Vec<DataArray> {
        match owner {
            Owner::Whole => &mut self.fields,
            Owner::Points => &mut self.point_arrays,
            Owner::Cells => &mut self.cell_arrays,
        }
    }

    /// Adds the cells of an unstructured grid. The list of a polyhedron holds its faces.
    pub fn take_cells(&mut self, types: Vec<i64>) -> Result<(), String> {
        let lists = std::mem::take(&mut self.cell_lists);
        let count = types.len();
        if lists.ends.len() != count {
            return Err(format!(
                "has {} cells, but {count} types of cells",
                lists.ends.len()
            ));
        }
        let mut arrays = Vec::new();
        if types.contains(&POLYHEDRON) {
            let (mut nodes, mut ends) = (Vec::new(), Vec::new());
            let (mut faces, mut face_ends) = (Vec::new(), Vec::new());
            for (list, &kind) in lists.iter().zip(&types) {
                if kind == POLYHEDRON {
                    faces.extend_from_slice(list);
                    let corners = nodes_of_faces(list).ok_or("has broken cells")?;
                    nodes.extend(crate::geometry::sorted_distinct(corners));
                    face_ends.push(faces.len() as i64);
                } else {
                    nodes.extend_from_slice(list);
                    face_ends.push(-1);
                }
                ends.push(nodes.len() as i64);
            }
            arrays.push(DataArray::scalars("connectivity", nodes));
            arrays.push(DataArray::scalars("offsets", ends));
            arrays.push(DataArray::scalars("faces", faces));
            arrays.push(DataArray::scalars("faceoffsets", face_ends));
        } else {
            arrays.push(DataArray::scalars("connectivity", lists.nodes));
            arrays.push(DataArray::scalars("offsets", lists.ends));
        }
        arrays.push(DataArray::scalars("types", types));
        self.cells.push(("Cells", arrays));
        self.piece.push(("NumberOfCells", count.to_string()));
        Ok(())
    }

    /// Adds the polygons, lines or points of poly data.
    pub fn take_polygons(&mut self, element: &'static str, cells: CellLists) {
        let arrays = vec![
            DataArray::scalars("connectivity", cells.nodes),
            DataArray::scalars("offsets", cells.ends),
        ];
        self.cells.push((element, arrays));
    }

    pub fn to_xml(&self, kind: &'static str) -> std::io::Result<Vec<u8>> {
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

/// Returns the nodes of a polyhedron's faces. Its list has the number of faces, and for each face the
/// number of nodes followed by the nodes.
fn nodes_of_faces(list: &[i64]) -> Option<Vec<i64>> {
    let (count, mut rest) = list.split_first()?;
    let mut nodes = Vec::new();
    for _ in 0..*count {
        let (&size, after) = rest.split_first()?;
        let (ring, next) = after.split_at_checked(usize::try_from(size).ok()?)?;
        nodes.extend_from_slice(ring);
        rest = next;
    }
    rest.is_empty().then_some(nodes)
}
