//! Zarr version 2: the metadata in `.zarray`, `.zgroup` and `.zattrs`, as those of version 3.
//!
//! Specification: <https://zarr-specs.readthedocs.io/en/latest/v2/v2.0.html>. Chunks have the same
//! bytes in both versions; only their names and the metadata differ.

use std::path::Path;

use serde_json::{Map, Value, json};

/// Name of the file of an array.
pub const ARRAY_FILE: &str = ".zarray";

/// Name of the file of a group.
pub const GROUP_FILE: &str = ".zgroup";

/// Name of the file of attributes.
pub const ATTRIBUTES_FILE: &str = ".zattrs";

/// Returns `true` if a folder is a node of Zarr version 2.
pub fn is_node(folder: &Path) -> bool {
    let files = [ARRAY_FILE, GROUP_FILE, ATTRIBUTES_FILE];
    files.iter().any(|name| folder.join(name).is_file())
}

/// Returns the metadata of an array in the form of version 3.
///
/// # Errors
/// Returns a message if the metadata are invalid or not supported.
pub fn array_metadata(array: &Value, attributes: &Map<String, Value>) -> Result<Value, String> {
    let dtype = &array["dtype"];
    let text = dtype.as_str().ok_or("holds records, not plain numbers")?;
    let (order, kind) = text.split_at_checked(1).unwrap_or(("", text));
    let data_type = match kind {
        "b1" => "bool",
        "i1" => "int8",
        "u1" => "uint8",
        "i2" => "int16",
        "u2" => "uint16",
        "i4" => "int32",
        "u4" => "uint32",
        "i8" => "int64",
        "u8" => "uint64",
        "f2" => "float16",
        "f4" => "float32",
        "f8" => "float64",
        _ => return Err(format!("has the data type {text}, no real number")),
    };
    if array["filters"].as_array().is_some_and(|f| !f.is_empty()) {
        return Err("has filters, which are not read".into());
    }
    let mut codecs = Vec::new();
    let axes = array["shape"].as_array().map_or(0, Vec::len);
    if array["order"] == "F" {
        let reversed: Vec<usize> = (0..axes).rev().collect();
        codecs.push(json!({"name": "transpose", "configuration": {"order": reversed}}));
    }
    let endian = if order == ">" { "big" } else { "little" };
    codecs.push(json!({"name": "bytes", "configuration": {"endian": endian}}));
    match array["compressor"]["id"].as_str() {
        Some("lz4") => codecs.push(json!({"name": "numcodecs.lz4"})),
        Some(name) => codecs.push(json!({"name": name})),
        None => (),
    }
    let separator = array["dimension_separator"].as_str().unwrap_or(".");
    let fill_value = match &array["fill_value"] {
        Value::Null => json!(0),
        value => value.clone(),
    };
    Ok(json!({
        "shape": array["shape"],
        "data_type": data_type,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": array["chunks"]}},
        "chunk_key_encoding": {"name": "v2", "configuration": {"separator": separator}},
        "fill_value": fill_value,
        "codecs": codecs,
        "dimension_names": attributes.get("_ARRAY_DIMENSIONS"),
    }))
}
