//! Values as bytes: every number exactly as it is in memory. For checkpoints, and for what ranks tell one another.

use std::borrow::Cow;
use std::io::{self, Write};

use sha2::{Digest, Sha256};

/// Bytes of a check sum.
pub const CHECKSUM_BYTES: usize = 32;

/// What can be written and read again.
pub trait Codec: Sized {
    /// Writes it.
    ///
    /// # Errors
    /// What the operating system reports.
    fn encode(&self, out: &mut dyn Write) -> io::Result<()>;

    /// Takes it off the beginning of `from`; `None` if it is not there.
    fn decode(from: &mut &[u8]) -> Option<Self>;

    /// Writes some, one after the other.
    ///
    /// # Errors
    /// As [`Codec::encode`].
    fn encode_slice(all: &[Self], out: &mut dyn Write) -> io::Result<()> {
        all.iter().try_for_each(|value| value.encode(out))
    }

    /// Takes so many of them.
    fn decode_vec(count: usize, from: &mut &[u8]) -> Option<Vec<Self>> {
        (0..count).map(|_| Self::decode(from)).collect()
    }
}

/// A value's bytes, in memory.
pub fn encode_to_vec(value: &impl Codec) -> Vec<u8> {
    let mut count = ByteCounter(0);
    // Neither counting nor writing to memory can fail. What grows as it is written needs three times the room.
    value.encode(&mut count).unwrap_or_default();
    let mut bytes = Vec::with_capacity(count.0);
    value.encode(&mut bytes).unwrap_or_default();
    bytes
}

/// Only counts what is written.
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

/// The check sum of a value's bytes.
///
/// # Errors
/// None: they go nowhere.
pub fn checksum(value: &impl Codec) -> io::Result<[u8; CHECKSUM_BYTES]> {
    let mut sum = HashWriter(Sha256::new());
    value.encode(&mut sum)?;
    Ok(sum.0.finalize().into())
}

/// Only sums up what is written.
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

/// So many numbers are written at once.
const NUMBERS_PER_WRITE: usize = 1 << 10;

/// Numbers, least significant byte first.
macro_rules! numbers {
    ($($number:ty),+) => {$(
        impl Codec for $number {
            fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
                out.write_all(&self.to_le_bytes())
            }

            fn decode(from: &mut &[u8]) -> Option<Self> {
                let (raw, rest) = from.split_first_chunk()?;
                *from = rest;
                Some(Self::from_le_bytes(*raw))
            }

            fn encode_slice(all: &[Self], out: &mut dyn Write) -> io::Result<()> {
                const SIZE: usize = size_of::<$number>();
                let mut bytes = [0; NUMBERS_PER_WRITE * SIZE];
                all.chunks(NUMBERS_PER_WRITE).try_for_each(|some| {
                    let to = bytes.as_chunks_mut::<SIZE>().0;
                    to.iter_mut().zip(some).for_each(|(to, one)| *to = one.to_le_bytes());
                    out.write_all(&bytes[..some.len() * SIZE])
                })
            }

            fn decode_vec(count: usize, from: &mut &[u8]) -> Option<Vec<Self>> {
                const SIZE: usize = size_of::<$number>();
                let (raw, rest) = from.split_at_checked(count.checked_mul(SIZE)?)?;
                *from = rest;
                let all = raw.as_chunks::<SIZE>().0.iter();
                Some(all.map(|raw| Self::from_le_bytes(*raw)).collect())
            }
        }
    )+};
}

numbers!(u8, i32, u32, i64, u64, f32, f64);

impl Codec for usize {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        (*self as u64).encode(out)
    }

    fn decode(from: &mut &[u8]) -> Option<Self> {
        u64::decode(from)?.try_into().ok()
    }
}

impl Codec for bool {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        u8::from(*self).encode(out)
    }

    fn decode(from: &mut &[u8]) -> Option<Self> {
        Some(u8::decode(from)? != 0)
    }
}

impl Codec for String {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().encode(out)?;
        out.write_all(self.as_bytes())
    }

    fn decode(from: &mut &[u8]) -> Option<Self> {
        let length = usize::decode(from)?;
        let (text, rest) = from.split_at_checked(length)?;
        *from = rest;
        String::from_utf8(text.to_vec()).ok()
    }
}

impl Codec for Cow<'static, str> {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().encode(out)?;
        out.write_all(self.as_bytes())
    }

    fn decode(from: &mut &[u8]) -> Option<Self> {
        String::decode(from).map(Cow::Owned)
    }
}

impl<T: Codec> Codec for Option<T> {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.is_some().encode(out)?;
        self.as_ref().map_or(Ok(()), |value| value.encode(out))
    }

    fn decode(from: &mut &[u8]) -> Option<Self> {
        match bool::decode(from)? {
            true => Some(Some(T::decode(from)?)),
            false => Some(None),
        }
    }
}

impl<T: Codec> Codec for Vec<T> {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().encode(out)?;
        T::encode_slice(self, out)
    }

    fn decode(from: &mut &[u8]) -> Option<Self> {
        let length = usize::decode(from)?;
        // Nothing takes less than a byte.
        if length > from.len() {
            return None;
        }
        T::decode_vec(length, from)
    }
}

impl<T: Codec, const N: usize> Codec for [T; N] {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.iter().try_for_each(|value| value.encode(out))
    }

    fn decode(from: &mut &[u8]) -> Option<Self> {
        let all: [Option<T>; N] = std::array::from_fn(|_| T::decode(from));
        let there = all.iter().all(Option::is_some);
        there.then(|| all.map(|one| one.unwrap_or_else(|| unreachable!("it is there"))))
    }

    fn encode_slice(all: &[Self], out: &mut dyn Write) -> io::Result<()> {
        T::encode_slice(all.as_flattened(), out)
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

    fn decode(from: &mut &[u8]) -> Option<Self> {
        Some((A::decode(from)?, B::decode(from)?))
    }
}

/// Structures, field by field: one that is forgotten does not compile.
macro_rules! codec_fields {
    ($($(@ ($($generic:tt)+))? $name:ty as $pattern:ident { $($field:ident),+ $(,)? })+) => {$(
        impl $(<$($generic)+>)? $crate::files::codec::Codec for $name {
            fn encode(&self, out: &mut dyn std::io::Write) -> std::io::Result<()> {
                let $pattern { $($field),+ } = self;
                $($field.encode(out)?;)+
                Ok(())
            }

            fn decode(from: &mut &[u8]) -> Option<Self> {
                $(let $field = $crate::files::codec::Codec::decode(from)?;)+
                Some($pattern { $($field),+ })
            }
        }
    )+};
}

pub(crate) use codec_fields;

/// What has few values, by their number.
macro_rules! codec_variants {
    ($($name:ident { $($value:ident),+ })+) => {$(
        impl $crate::files::codec::Codec for $name {
            fn encode(&self, out: &mut dyn std::io::Write) -> std::io::Result<()> {
                // Every value has its place: one that is forgotten does not compile.
                let number = match self { $(Self::$value => Self::$value as u8),+ };
                number.encode(out)
            }

            fn decode(from: &mut &[u8]) -> Option<Self> {
                let number = u8::decode(from)?;
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
    fn what_is_put_is_taken_again_bit_by_bit() {
        type Both = (Vec<[f64; 3]>, (Option<String>, Vec<bool>));
        let mut bytes = Vec::new();
        let value: Both = (
            vec![[0.1f64, -0.0, f64::NAN], [f64::MIN_POSITIVE, 1e300, 3.0]],
            (Some("é".to_string()), vec![true]),
        );
        value.encode(&mut bytes).unwrap();
        let rest = &mut &bytes[..];
        let taken = Both::decode(rest).unwrap();
        assert!(rest.is_empty());
        let bits = |all: &[[f64; 3]]| all.concat().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&taken.0), bits(&value.0));
        assert_eq!(taken.1, value.1);
        for cut in 0..bytes.len() {
            assert!(Both::decode(&mut &bytes[..cut]).is_none());
        }
    }
}
