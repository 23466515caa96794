//! Parts that files of meshes and of surfaces share: the points and the integers of a piece, and
//! values that belong to the whole file.

use std::path::Path;

use super::xml::Element;
use super::{DataArray, Values, VtkFile};
use crate::error::Result;

/// A value that belongs to the whole file.
#[derive(Debug, Clone, PartialEq)]
pub enum FieldValue {
    /// Text, stored as the bytes of its UTF-8, because some readers (meshio) cannot read VTK's own
    /// strings.
    Text(String),
    /// Real numbers.
    F64s(Vec<f64>),
    /// Integers.
    Ints(Vec<i64>),
}

/// Reads a count from an attribute of a piece.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if it is not one number.
pub(crate) fn read_count(file: &VtkFile, piece: &Element, name: &str) -> Result<usize> {
    match file.parse_attribute(piece, name)?[..] {
        [n] => Ok(n),
        _ => Err(file.error(
            format!("{name} is not one number"),
            crate::files::REWRITE_DAMAGED,
        )),
    }
}

/// Reads the positions of a piece's points. In the plane, z must be 0.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the array is damaged.
pub(crate) fn read_nodes<const D: usize>(
    file: &VtkFile,
    element: &Element,
    points: usize,
) -> Result<Vec<[f64; D]>> {
    let array = file.array(file.child(element, "DataArray")?)?;
    let numbers = match array.values {
        Values::F64(v) => v,
        v => v.to_f64(),
    };
    if numbers.len() != points.saturating_mul(3) {
        let problem = format!("has {} coordinates for {points} points", numbers.len());
        return Err(file.error(problem, crate::files::REWRITE_DAMAGED));
    }
    let (nodes, _) = numbers.as_chunks::<3>();
    if let Some(node) = nodes.iter().position(|x| x.iter().any(|c| !c.is_finite())) {
        let problem = format!("node {node} is not finite");
        return Err(file.error(problem, crate::files::REWRITE_DAMAGED));
    }
    if let Some(coordinate) = nodes.iter().flat_map(|x| &x[D..]).find(|c| **c != 0.0) {
        let problem = format!("has cells off the plane z = 0 (at z = {coordinate})");
        return Err(file.error(problem, "give a 3-D mesh, or one in that plane"));
    }
    let node = |x: &[f64; 3]| std::array::from_fn(|k| x[k]);
    Ok(nodes.iter().map(node).collect())
}

/// Reads an integer array of the cells' description.
pub(crate) fn read_cell_integers(file: &VtkFile, cells: &Element, name: &str) -> Result<Vec<i64>> {
    Ok(read_cell_values(file, cells, name)?.to_i64())
}

/// Reads an array of the cells' description, with the type in which it is stored.
pub(crate) fn read_cell_values(file: &VtkFile, cells: &Element, name: &str) -> Result<Values> {
    let mut arrays = cells.children.iter();
    let element = arrays
        .find(|a| a.attribute("Name") == Some(name))
        .ok_or_else(|| {
            file.error(
                format!("its cells have no array '{name}'"),
                crate::files::REWRITE_DAMAGED,
            )
        })?;
    Ok(file.array(element)?.values)
}

/// Checks that each array has one tuple for each of `tuples` nodes or cells.
///
/// # Errors
/// Returns [`Error::Mesh`](crate::Error::Mesh) if one has not.
pub(crate) fn check_lengths(
    path: &Path,
    arrays: &[DataArray],
    tuples: usize,
    owner: &str,
) -> Result<()> {
    let has_wrong_length = |a: &&DataArray| a.values.len() != tuples * a.components;
    match arrays.iter().find(has_wrong_length) {
        None => Ok(()),
        Some(a) => Err(crate::Error::Mesh(crate::error::cause(
            path.display(),
            format!(
                "array '{}' has {} numbers for {tuples} {owner} with {} each",
                a.name,
                a.values.len(),
                a.components
            ),
            "give one tuple for each",
        ))),
    }
}
