//! VTK's XML files: the container that `.vti`, `.vtu` and `.vtp` share.
//!
//! What we write: version 1.0, little endian, `header_type="UInt64"`, all arrays appended raw in
//! zlib blocks. What we read: that, and what VTK, ParaView and meshio write: ascii, base64 inline,
//! appended raw or base64, compressed by zlib, LZ4, LZMA or not at all, 32- and 64-bit headers, both
//! byte orders; and legacy files, ascii and binary.
//! Layout: VTK file formats, <https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html>.
//!
//! - `write`: a [`Document`], streamed array by array
//! - `read`: a [`VtkFile`], arrays taken out when asked for
//! - `unpack`: compressed blocks
//! - `legacy`: legacy files as XML ones
//! - `xml`: the XML as a tree

pub(crate) mod legacy;
pub(crate) mod read;
mod unpack;
pub(crate) mod write;
pub(crate) mod xml;

pub use read::VtkFile;
pub use write::{ArrayPacking, ArraySource, Document};

/// One named array of a VTK file, `components` numbers a tuple.
#[derive(Debug, Clone, PartialEq)]
pub struct DataArray {
    /// Its name.
    pub name: String,
    /// Numbers in a tuple: 1 for scalars, 3 for vectors.
    pub components: usize,
    /// The numbers, tuple after tuple.
    pub values: Values,
}

impl DataArray {
    /// A scalar array.
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
    /// Bytes of a number.
    const SIZE: usize;
    /// Appends the number, little endian.
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
            /// How many numbers there are.
            pub fn len(&self) -> usize {
                match self {
                    $(Self::$variant(v) => v.len(),)*
                }
            }

            /// Whether there are none.
            pub fn is_empty(&self) -> bool {
                self.len() == 0
            }

            /// VTK's name of the number type.
            pub fn type_name(&self) -> &'static str {
                match self {
                    $(Self::$variant(_) => $kind,)*
                }
            }

            /// The numbers as `f32`, rounded where they do not fit.
            pub fn to_f32(&self) -> Vec<f32> {
                match self {
                    $(Self::$variant(v) => v.iter().map(|&x| x as f32).collect(),)*
                }
            }

            /// The numbers as `f64`, rounded where 64-bit integers do not fit.
            pub fn to_f64(&self) -> Vec<f64> {
                match self {
                    $(Self::$variant(v) => v.iter().map(|&x| x as f64).collect(),)*
                }
            }

            /// The numbers as `i64`; fractions are cut off.
            pub fn to_i64(&self) -> Vec<i64> {
                match self {
                    $(Self::$variant(v) => v.iter().map(|&x| x as i64).collect(),)*
                }
            }

            /// The numbers, exactly, if they are integers.
            pub fn to_integers(&self) -> Option<Vec<i128>> {
                if matches!(self.type_name(), "Float32" | "Float64") {
                    return None;
                }
                Some(match self {
                    $(Self::$variant(v) => v.iter().map(|&x| x as i128).collect(),)*
                })
            }

            /// The numbers as `u32`; `None` if one is negative or too large. Fractions are cut off.
            pub fn to_u32(&self) -> Option<Vec<u32>> {
                match self {
                    $(Self::$variant(v) => v.iter().map(|&x| u32::try_from(x as i64).ok()).collect(),)*
                }
            }

            /// The tuples with these numbers, `components` numbers each, in this order.
            pub fn select_tuples(&self, which: &[u32], components: usize) -> Self {
                match self {
                    $(Self::$variant(v) => {
                        let tuple = |&i: &u32| i as usize * components..(i as usize + 1) * components;
                        Self::$variant(which.iter().flat_map(|i| &v[tuple(i)]).copied().collect())
                    })*
                }
            }

            /// Puts others of the same type behind these; says whether they are.
            pub fn append(&mut self, others: Self) -> bool {
                match (self, others) {
                    $((Self::$variant(v), Self::$variant(more)) => {
                        v.extend(more);
                        true
                    })*
                    _ => false,
                }
            }

            /// The numbers as a source for a [`Document`].
            pub fn source<'a>(&'a self, name: &str, components: usize) -> ArraySource<'a> {
                match self {
                    $(Self::$variant(v) => ArraySource::slice(name, components, v),)*
                }
            }

            /// Numbers of VTK's type `kind` from their bytes; `None` for a type that is not one.
            /// A rest shorter than a number is ignored.
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

            /// Numbers of VTK's type `kind` from text; `Err` holds the word that is not one.
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

/// Files that VTK wrote, in every variant that is read.
#[cfg(test)]
pub(crate) mod fixtures {
    use std::path::{Path, PathBuf};

    /// How they are coded: format, compressor, bits of the header, byte order.
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

    /// Where such a file is.
    pub fn fixture(name: &str) -> PathBuf {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        root.join("tests/data/vtk").join(name)
    }
}
