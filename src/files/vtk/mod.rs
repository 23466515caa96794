//! VTK's XML files: the container that `.vti`, `.vtu` and `.vtp` files share.
//!
//! This module writes version 1.0, little endian, `header_type="UInt64"`, all arrays appended raw
//! in zlib blocks. It reads the same, and what VTK, ParaView and meshio write: ASCII, base64
//! inline, appended raw or base64, compressed by zlib, LZ4, LZMA or not at all, 32- and 64-bit
//! headers, both byte orders; and legacy files, ASCII and binary.
//! Layout: VTK file formats,
//! <https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html>.
//!
//! - `write`: a [`Document`], written array by array
//! - `poly_data`: vertices, lines and polygons
//! - `read`: a [`VtkFile`], whose arrays are decoded on demand
//! - `pieces`: points, integers and whole values that meshes and surfaces share
//! - `unpack`: decompression of blocks
//! - `legacy`: conversion of legacy files to XML
//! - `xml_content`: what a legacy file holds, as XML
//! - `xml`: the XML as a tree

pub(crate) mod legacy;
pub(crate) mod pieces;
mod poly_data;
pub(crate) mod read;
mod unpack;
pub(crate) mod write;
pub(crate) mod xml;
mod xml_content;

pub use poly_data::PolyData;
pub use read::VtkFile;
pub use write::{ArrayPacking, ArraySource, Document};

/// One named array of a VTK file, with `components` numbers per tuple.
#[derive(Debug, Clone, PartialEq)]
pub struct DataArray {
    /// Its name.
    pub name: String,
    /// Count of numbers per tuple: 1 for scalars, 3 for vectors.
    pub components: usize,
    /// The numbers, tuple after tuple.
    pub values: Values,
}

impl DataArray {
    /// Creates an array of scalars.
    pub fn scalars(name: impl Into<String>, values: impl Into<Values>) -> Self {
        Self {
            name: name.into(),
            components: 1,
            values: values.into(),
        }
    }
}

/// A number type that VTK files can hold.
pub trait VtkScalar: Copy + Send + Sync + 'static {
    /// VTK's name of the type.
    const TYPE_NAME: &'static str;
    /// Size of a number in bytes.
    const SIZE: usize;
    /// Appends the bytes of the number, little endian.
    fn append_bytes(self, bytes: &mut Vec<u8>);
}

macro_rules! scalars {
    ($($variant:ident $type:ty, $kind:literal;)*) => {
        /// Numbers of any type that VTK files can hold.
        #[derive(Debug, Clone, PartialEq)]
        #[allow(missing_docs)]
        pub enum Values {
            $($variant(Vec<$type>),)*
        }

        $(
            impl VtkScalar for $type {
                const TYPE_NAME: &'static str = $kind;
                const SIZE: usize = size_of::<$type>();
                #[inline]
                fn append_bytes(self, bytes: &mut Vec<u8>) {
                    bytes.extend_from_slice(&self.to_le_bytes());
                }
            }

            impl From<Vec<$type>> for Values {
                fn from(values: Vec<$type>) -> Self {
                    Self::$variant(values)
                }
            }
        )*

        impl Values {
            /// Returns the count of numbers.
            pub fn len(&self) -> usize {
                match self {
                    $(Self::$variant(v) => v.len(),)*
                }
            }

            /// Returns `true` if there are no numbers.
            pub fn is_empty(&self) -> bool {
                self.len() == 0
            }

            /// Returns VTK's name of the number type.
            pub fn type_name(&self) -> &'static str {
                match self {
                    $(Self::$variant(_) => $kind,)*
                }
            }

            /// Returns the numbers as `f32`, rounded where they do not fit.
            pub fn to_f32(&self) -> Vec<f32> {
                match self {
                    $(Self::$variant(v) => v.iter().map(|&x| x as f32).collect(),)*
                }
            }

            /// Returns the numbers as `f64`, rounded where 64-bit integers do not fit.
            pub fn to_f64(&self) -> Vec<f64> {
                match self {
                    $(Self::$variant(v) => v.iter().map(|&x| x as f64).collect(),)*
                }
            }

            /// Returns the numbers as `i64`; fractions are cut off.
            pub fn to_i64(&self) -> Vec<i64> {
                match self {
                    $(Self::$variant(v) => v.iter().map(|&x| x as i64).collect(),)*
                }
            }

            /// Returns the numbers exactly, or `None` if their type is not an integer type.
            pub fn to_integers(&self) -> Option<Vec<i128>> {
                if matches!(self.type_name(), "Float32" | "Float64") {
                    return None;
                }
                Some(match self {
                    $(Self::$variant(v) => v.iter().map(|&x| x as i128).collect(),)*
                })
            }

            /// Returns the numbers as `u32`, or `None` if one is negative or too large. Fractions
            /// are cut off.
            pub fn to_u32(&self) -> Option<Vec<u32>> {
                match self {
                    $(Self::$variant(v) => v.iter().map(|&x| u32::try_from(x as i64).ok()).collect(),)*
                }
            }

            /// Returns the tuples of the given indices, in the order of the indices.
            pub fn select_tuples(&self, indices: &[u32], components: usize) -> Self {
                match self {
                    $(Self::$variant(v) => {
                        let tuple = |&i: &u32| i as usize * components..(i as usize + 1) * components;
                        Self::$variant(indices.iter().flat_map(|i| &v[tuple(i)]).copied().collect())
                    })*
                }
            }

            /// Appends numbers, converted to the type of the others.
            pub fn extend_from_f64(&mut self, others: impl Iterator<Item = f64>) {
                match self {
                    $(Self::$variant(v) => v.extend(others.map(|x| x as $type)),)*
                }
            }

            /// Appends numbers of the same type. Returns `false`, and appends nothing, if the types
            /// differ.
            pub fn append(&mut self, others: Self) -> bool {
                match (self, others) {
                    $((Self::$variant(v), Self::$variant(more)) => {
                        v.extend(more);
                        true
                    })*
                    _ => false,
                }
            }

            /// Returns the numbers as a source for a [`Document`].
            pub fn source<'a>(&'a self, name: &str, components: usize) -> ArraySource<'a> {
                match self {
                    $(Self::$variant(v) => ArraySource::slice(name, components, v),)*
                }
            }

            /// Decodes numbers of VTK's type `kind` from bytes. Returns `None` if there is no such
            /// type. Bytes at the end that are fewer than a number are ignored.
            pub(crate) fn from_bytes(kind: &str, bytes: &[u8], big_endian: bool) -> Option<Self> {
                match kind {
                    $($kind => {
                        let (numbers, _) = bytes.as_chunks();
                        Some(Self::$variant(if big_endian {
                            numbers.iter().map(|&b| <$type>::from_be_bytes(b)).collect()
                        } else {
                            numbers.iter().map(|&b| <$type>::from_le_bytes(b)).collect()
                        }))
                    })*
                    _ => None,
                }
            }

            /// Parses numbers of VTK's type `kind` from text. Returns `None` if there is no such
            /// type; `Err` holds the word that is not a number.
            pub(crate) fn from_text<'a>(kind: &str, text: &'a str) -> Option<Result<Self, &'a str>> {
                match kind {
                    $($kind => Some(
                        text.split_ascii_whitespace()
                            .map(|word| word.parse::<$type>().map_err(|_| word))
                            .collect::<Result<Vec<_>, _>>()
                            .map(Self::$variant),
                    ),)*
                    _ => None,
                }
            }
        }
    };
}

scalars! {
    I8 i8, "Int8";
    U8 u8, "UInt8";
    I16 i16, "Int16";
    U16 u16, "UInt16";
    I32 i32, "Int32";
    U32 u32, "UInt32";
    I64 i64, "Int64";
    U64 u64, "UInt64";
    F32 f32, "Float32";
    F64 f64, "Float64";
}

/// Test files that VTK has written, in every variant that is read.
#[cfg(test)]
pub(crate) mod fixtures {
    use std::path::{Path, PathBuf};

    /// Variants of encoding: format, compressor, bits of the header, byte order.
    pub const VARIANTS: [&str; 13] = [
        "ascii_none_32_le",
        "inline_none_32_be",
        "inline_none_64_le",
        "inline_zlib_32_le",
        "base64_none_32_le",
        "base64_zlib_64_be",
        "raw_none_32_be",
        "raw_none_64_le",
        "raw_zlib_32_le",
        "raw_zlib_64_le",
        "raw_lz4_64_le",
        "inline_lz4_32_be",
        "base64_lzma_64_le",
    ];

    /// Returns the path of a test file.
    pub fn fixture(name: &str) -> PathBuf {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        root.join("tests/data/vtk").join(name)
    }
}
