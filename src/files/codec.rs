//! Binary encoding of values that keeps every number exactly, for checkpoints and for messages
//! between ranks.

use std::borrow::Cow;
use std::io::{self, Write};

use sha2::{Digest, Sha256};

/// Length of a checksum in bytes (SHA-256).
pub const CHECKSUM_BYTES: usize = 32;

/// A type whose values can be encoded as bytes and decoded again.
pub trait Codec: Sized {
    /// Writes the bytes of this value.
    ///
    /// # Errors
    /// Returns the error of `out` if writing fails.
    fn encode(&self, out: &mut dyn Write) -> io::Result<()>;

    /// Decodes a value from the beginning of `bytes` and advances `bytes` past it. Returns `None`
    /// if the bytes are not a value of this type.
    fn decode(bytes: &mut &[u8]) -> Option<Self>;

    /// Writes the values one after the other, without their number.
    ///
    /// # Errors
    /// Returns the error of `out` if writing fails.
    fn encode_slice(values: &[Self], out: &mut dyn Write) -> io::Result<()> {
        values.iter().try_for_each(|value| value.encode(out))
    }

    /// Decodes `count` values from the beginning of `bytes` and advances `bytes` past them.
    fn decode_vec(count: usize, bytes: &mut &[u8]) -> Option<Vec<Self>> {
        (0..count).map(|_| Self::decode(bytes)).collect()
    }
}

/// Returns the bytes of a value.
pub fn encode_to_vec(value: &impl Codec) -> Vec<u8> {
    let mut counter = ByteCounter(0);
    // Neither counting nor writing to memory can fail. The length is counted first, because a
    // vector that grows while it is written needs up to three times the memory.
    value.encode(&mut counter).unwrap_or_default();
    let mut bytes = Vec::with_capacity(counter.0);
    value.encode(&mut bytes).unwrap_or_default();
    bytes
}

/// A writer that only counts the bytes written to it.
struct ByteCounter(usize);

impl Write for ByteCounter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns the SHA-256 checksum of the bytes of a value.
///
/// # Errors
/// Never returns an error in practice, because the bytes are only hashed and not written.
pub fn checksum(value: &impl Codec) -> io::Result<[u8; CHECKSUM_BYTES]> {
    let mut hasher = HashWriter(Sha256::new());
    value.encode(&mut hasher)?;
    Ok(hasher.0.finalize().into())
}

/// A writer that only hashes the bytes written to it.
struct HashWriter(Sha256);

impl Write for HashWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Count of numbers that are converted before each write.
const NUMBERS_PER_WRITE: usize = 1 << 10;

/// Implements [`Codec`] for number types: the bytes of each number, least significant byte first.
macro_rules! numbers {
    ($($number:ty),+) => {$(
        impl Codec for $number {
            fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
                out.write_all(&self.to_le_bytes())
            }

            fn decode(bytes: &mut &[u8]) -> Option<Self> {
                let (raw, rest) = bytes.split_first_chunk()?;
                *bytes = rest;
                Some(Self::from_le_bytes(*raw))
            }

            fn encode_slice(values: &[Self], out: &mut dyn Write) -> io::Result<()> {
                const SIZE: usize = size_of::<$number>();
                let mut bytes = [0; NUMBERS_PER_WRITE * SIZE];
                values.chunks(NUMBERS_PER_WRITE).try_for_each(|values| {
                    let raw = bytes.as_chunks_mut::<SIZE>().0;
                    raw.iter_mut().zip(values).for_each(|(raw, value)| *raw = value.to_le_bytes());
                    out.write_all(&bytes[..values.len() * SIZE])
                })
            }

            fn decode_vec(count: usize, bytes: &mut &[u8]) -> Option<Vec<Self>> {
                const SIZE: usize = size_of::<$number>();
                let (raw, rest) = bytes.split_at_checked(count.checked_mul(SIZE)?)?;
                *bytes = rest;
                let chunks = raw.as_chunks::<SIZE>().0.iter();
                Some(chunks.map(|raw| Self::from_le_bytes(*raw)).collect())
            }
        }
    )+};
}

numbers!(u8, i32, u32, i64, u64, f32, f64);

impl Codec for usize {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        (*self as u64).encode(out)
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        u64::decode(bytes)?.try_into().ok()
    }
}

impl Codec for bool {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        u8::from(*self).encode(out)
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        Some(u8::decode(bytes)? != 0)
    }
}

impl Codec for String {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().encode(out)?;
        out.write_all(self.as_bytes())
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        let length = usize::decode(bytes)?;
        let (text, rest) = bytes.split_at_checked(length)?;
        *bytes = rest;
        String::from_utf8(text.to_vec()).ok()
    }
}

impl Codec for Cow<'static, str> {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().encode(out)?;
        out.write_all(self.as_bytes())
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        String::decode(bytes).map(Cow::Owned)
    }
}

impl<T: Codec> Codec for Option<T> {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.is_some().encode(out)?;
        self.as_ref().map_or(Ok(()), |value| value.encode(out))
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        if bool::decode(bytes)? {
            Some(Some(T::decode(bytes)?))
        } else {
            Some(None)
        }
    }
}

impl<T: Codec> Codec for Vec<T> {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().encode(out)?;
        T::encode_slice(self, out)
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        let length = usize::decode(bytes)?;
        // Every value takes at least one byte, so a larger length comes from damaged data.
        if length > bytes.len() {
            return None;
        }
        T::decode_vec(length, bytes)
    }
}

impl<T: Codec, const N: usize> Codec for [T; N] {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.iter().try_for_each(|value| value.encode(out))
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        let decoded: [Option<T>; N] = std::array::from_fn(|_| T::decode(bytes));
        let is_complete = decoded.iter().all(Option::is_some);
        is_complete.then(|| {
            decoded.map(|value| value.unwrap_or_else(|| unreachable!("all values are decoded")))
        })
    }

    fn encode_slice(values: &[Self], out: &mut dyn Write) -> io::Result<()> {
        T::encode_slice(values.as_flattened(), out)
    }
}

impl Codec for () {
    fn encode(&self, _: &mut dyn Write) -> io::Result<()> {
        Ok(())
    }

    fn decode(_: &mut &[u8]) -> Option<Self> {
        Some(())
    }
}

impl<A: Codec, B: Codec> Codec for (A, B) {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.0.encode(out)?;
        self.1.encode(out)
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        Some((A::decode(bytes)?, B::decode(bytes)?))
    }
}

/// Implements [`Codec`] for structures, field by field. A field that is missing from the list is a
/// compile error.
macro_rules! codec_fields {
    ($($(@ ($($generic:tt)+))? $name:ty as $pattern:ident { $($field:ident),+ $(,)? })+) => {$(
        impl $(<$($generic)+>)? $crate::files::codec::Codec for $name {
            fn encode(&self, out: &mut dyn std::io::Write) -> std::io::Result<()> {
                let $pattern { $($field),+ } = self;
                $($field.encode(out)?;)+
                Ok(())
            }

            fn decode(bytes: &mut &[u8]) -> Option<Self> {
                $(let $field = $crate::files::codec::Codec::decode(bytes)?;)+
                Some($pattern { $($field),+ })
            }
        }
    )+};
}

pub(crate) use codec_fields;

/// Implements [`Codec`] for enums without data: one byte, the number of the variant.
macro_rules! codec_variants {
    ($($name:ident { $($value:ident),+ })+) => {$(
        impl $crate::files::codec::Codec for $name {
            fn encode(&self, out: &mut dyn std::io::Write) -> std::io::Result<()> {
                // The match is exhaustive, so a variant that is missing from the list is a compile
                // error.
                let number = match self { $(Self::$value => Self::$value as u8),+ };
                number.encode(out)
            }

            fn decode(bytes: &mut &[u8]) -> Option<Self> {
                let number = u8::decode(bytes)?;
                [$(Self::$value),+].into_iter().find(|value| *value as u8 == number)
            }
        }
    )+};
}

pub(crate) use codec_variants;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decoding_restores_every_bit() {
        type Nested = (Vec<[f64; 3]>, (Option<String>, Vec<bool>));
        let mut bytes = Vec::new();
        let value: Nested = (
            vec![[0.1f64, -0.0, f64::NAN], [f64::MIN_POSITIVE, 1e300, 3.0]],
            (Some("é".to_string()), vec![true]),
        );
        value.encode(&mut bytes).unwrap();
        let rest = &mut &bytes[..];
        let decoded = Nested::decode(rest).unwrap();
        assert!(rest.is_empty());
        let bits = |vectors: &[[f64; 3]]| {
            vectors
                .concat()
                .iter()
                .map(|v| v.to_bits())
                .collect::<Vec<_>>()
        };
        assert_eq!(bits(&decoded.0), bits(&value.0));
        assert_eq!(decoded.1, value.1);
        for cut in 0..bytes.len() {
            assert!(Nested::decode(&mut &bytes[..cut]).is_none());
        }
    }
}
