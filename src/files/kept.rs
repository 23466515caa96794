//! Values as bytes: every number exactly as it is in memory. For checkpoints, and for what ranks tell one another.

use std::borrow::Cow;
use std::io::{self, Write};

use sha2::{Digest, Sha256};

/// Bytes of a check sum.
pub const SUM: usize = 32;

/// What can be written and read again.
pub trait Kept: Sized {
    /// Writes it.
    ///
    /// # Errors
    /// What the operating system reports.
    fn put(&self, out: &mut dyn Write) -> io::Result<()>;

    /// Takes it off the beginning of `from`; `None` if it is not there.
    fn take(from: &mut &[u8]) -> Option<Self>;

    /// Writes some, one after the other.
    ///
    /// # Errors
    /// As [`Kept::put`].
    fn put_each(all: &[Self], out: &mut dyn Write) -> io::Result<()> {
        all.iter().try_for_each(|value| value.put(out))
    }

    /// Takes so many of them.
    fn take_each(count: usize, from: &mut &[u8]) -> Option<Vec<Self>> {
        (0..count).map(|_| Self::take(from)).collect()
    }
}

/// A value's bytes, in memory.
pub fn bytes(value: &impl Kept) -> Vec<u8> {
    let mut count = Counting(0);
    // Neither counting nor writing to memory can fail. What grows as it is written needs three times the room.
    value.put(&mut count).unwrap_or_default();
    let mut bytes = Vec::with_capacity(count.0);
    value.put(&mut bytes).unwrap_or_default();
    bytes
}

/// Only counts what is written.
struct Counting(usize);

impl Write for Counting {
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
pub fn sum(value: &impl Kept) -> io::Result<[u8; SUM]> {
    let mut sum = Summing(Sha256::new());
    value.put(&mut sum)?;
    Ok(sum.0.finalize().into())
}

/// Only sums up what is written.
struct Summing(Sha256);

impl Write for Summing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// So many numbers are written at once.
const AT_ONCE: usize = 1 << 10;

/// Numbers, least significant byte first.
macro_rules! numbers {
    ($($number:ty),+) => {$(
        impl Kept for $number {
            fn put(&self, out: &mut dyn Write) -> io::Result<()> {
                out.write_all(&self.to_le_bytes())
            }

            fn take(from: &mut &[u8]) -> Option<Self> {
                let (raw, rest) = from.split_first_chunk()?;
                *from = rest;
                Some(Self::from_le_bytes(*raw))
            }

            fn put_each(all: &[Self], out: &mut dyn Write) -> io::Result<()> {
                const SIZE: usize = size_of::<$number>();
                let mut bytes = [0; AT_ONCE * SIZE];
                all.chunks(AT_ONCE).try_for_each(|some| {
                    let to = bytes.as_chunks_mut::<SIZE>().0;
                    to.iter_mut().zip(some).for_each(|(to, one)| *to = one.to_le_bytes());
                    out.write_all(&bytes[..some.len() * SIZE])
                })
            }

            fn take_each(count: usize, from: &mut &[u8]) -> Option<Vec<Self>> {
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

impl Kept for usize {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        (*self as u64).put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        u64::take(from)?.try_into().ok()
    }
}

impl Kept for bool {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        u8::from(*self).put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        Some(u8::take(from)? != 0)
    }
}

impl Kept for String {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().put(out)?;
        out.write_all(self.as_bytes())
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let length = usize::take(from)?;
        let (text, rest) = from.split_at_checked(length)?;
        *from = rest;
        String::from_utf8(text.to_vec()).ok()
    }
}

impl Kept for Cow<'static, str> {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().put(out)?;
        out.write_all(self.as_bytes())
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        String::take(from).map(Cow::Owned)
    }
}

impl<T: Kept> Kept for Option<T> {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.is_some().put(out)?;
        self.as_ref().map_or(Ok(()), |value| value.put(out))
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        match bool::take(from)? {
            true => Some(Some(T::take(from)?)),
            false => Some(None),
        }
    }
}

impl<T: Kept> Kept for Vec<T> {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.len().put(out)?;
        T::put_each(self, out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let length = usize::take(from)?;
        // Nothing takes less than a byte.
        if length > from.len() {
            return None;
        }
        T::take_each(length, from)
    }
}

impl<T: Kept, const N: usize> Kept for [T; N] {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.iter().try_for_each(|value| value.put(out))
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let all: [Option<T>; N] = std::array::from_fn(|_| T::take(from));
        let there = all.iter().all(Option::is_some);
        there.then(|| all.map(|one| one.unwrap_or_else(|| unreachable!("it is there"))))
    }

    fn put_each(all: &[Self], out: &mut dyn Write) -> io::Result<()> {
        T::put_each(all.as_flattened(), out)
    }
}

impl Kept for () {
    fn put(&self, _: &mut dyn Write) -> io::Result<()> {
        Ok(())
    }

    fn take(_: &mut &[u8]) -> Option<Self> {
        Some(())
    }
}

impl<A: Kept, B: Kept> Kept for (A, B) {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.0.put(out)?;
        self.1.put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        Some((A::take(from)?, B::take(from)?))
    }
}

/// Structures, field by field: one that is forgotten does not compile.
macro_rules! fields {
    ($($(@ ($($generic:tt)+))? $name:ty as $pattern:ident { $($field:ident),+ $(,)? })+) => {$(
        impl $(<$($generic)+>)? $crate::files::kept::Kept for $name {
            fn put(&self, out: &mut dyn std::io::Write) -> std::io::Result<()> {
                let $pattern { $($field),+ } = self;
                $($field.put(out)?;)+
                Ok(())
            }

            fn take(from: &mut &[u8]) -> Option<Self> {
                $(let $field = $crate::files::kept::Kept::take(from)?;)+
                Some($pattern { $($field),+ })
            }
        }
    )+};
}

pub(crate) use fields;

/// What has few values, by their number.
macro_rules! numbered {
    ($($name:ident { $($value:ident),+ })+) => {$(
        impl $crate::files::kept::Kept for $name {
            fn put(&self, out: &mut dyn std::io::Write) -> std::io::Result<()> {
                // Every value has its place: one that is forgotten does not compile.
                let number = match self { $(Self::$value => Self::$value as u8),+ };
                number.put(out)
            }

            fn take(from: &mut &[u8]) -> Option<Self> {
                let number = u8::take(from)?;
                [$(Self::$value),+].into_iter().find(|value| *value as u8 == number)
            }
        }
    )+};
}

pub(crate) use numbered;

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
        value.put(&mut bytes).unwrap();
        let rest = &mut &bytes[..];
        let taken = Both::take(rest).unwrap();
        assert!(rest.is_empty());
        let bits = |all: &[[f64; 3]]| all.concat().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&taken.0), bits(&value.0));
        assert_eq!(taken.1, value.1);
        for cut in 0..bytes.len() {
            assert!(Both::take(&mut &bytes[..cut]).is_none());
        }
    }
}
