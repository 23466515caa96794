//! What stages give, as bytes: every number exactly as it is in memory.

use std::io::{self, Write};

use crate::feature::{FeatureKind, FeaturePoint, Features, Labelled, LeftOut, Settled};
use crate::image::{Field, Sparse};
use crate::improve::{Blocked, Counts, Sealed};
use crate::job::{Joined, Marked};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::energy::{self, Terms};
use crate::lattice::optimize::{Rest, Stop};
use crate::lattice::seeding::Atoms;
use crate::mesh::delaunay::Delaunay;
use crate::mesh::{TetMesh, TriMesh};
use crate::report::{Blocker, Improvement, Judged};

/// What can be written and read again.
pub trait Kept: Sized {
    /// Writes it.
    ///
    /// # Errors
    /// What the operating system reports.
    fn put(&self, out: &mut dyn Write) -> io::Result<()>;

    /// Takes it off the beginning of `from`; `None` if it is not there.
    fn take(from: &mut &[u8]) -> Option<Self>;
}

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
        }
    )+};
}

numbers!(u8, i32, u32, u64, f32, f64);

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
        self.iter().try_for_each(|value| value.put(out))
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let length = usize::take(from)?;
        // Nothing takes less than a byte.
        if length > from.len() {
            return None;
        }
        (0..length).map(|_| T::take(from)).collect()
    }
}

impl<T: Kept, const N: usize> Kept for [T; N] {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.iter().try_for_each(|value| value.put(out))
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let all: Option<Vec<T>> = (0..N).map(|_| T::take(from)).collect();
        all?.try_into().ok()
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
        impl $(<$($generic)+>)? Kept for $name {
            fn put(&self, out: &mut dyn Write) -> io::Result<()> {
                let $pattern { $($field),+ } = self;
                $($field.put(out)?;)+
                Ok(())
            }

            fn take(from: &mut &[u8]) -> Option<Self> {
                $(let $field = Kept::take(from)?;)+
                Some($pattern { $($field),+ })
            }
        }
    )+};
}

fields! {
    @(const D: usize) FeaturePoint<D> as FeaturePoint { position, normal, strength }
    @(const D: usize) Field<D> as Field { dims, step, samples }
    @(const D: usize) Sparse<D> as Sparse { dims, step, slots, masks, samples }
    LeftOut as LeftOut { near_another_sheet, in_small_pieces, in_narrow_parts, weak }
    Settled as Settled { kind, scale, low, high, min_area, mask }
    @(const D: usize) Labelled<D> as Labelled { dims, step, labels, names, winner, lead, volumes }
    @(const D: usize) Features<D> as Features {
        points, sheet, on_horizon, potential, spacing, sigma, left_out, notes, settled, labels, confidence,
    }
    @(const D: usize) Atoms<D> as Atoms { positions, kinds }
    energy::Parts as EnergyParts { lattice, image }
    Terms as Terms { published, energy, stiffening, smoothing }
    Rest as Rest { stop, rounds, iterations, evaluations, energy_before, energy_after, terms }
    TetMesh as TetMesh { nodes, tets }
    TriMesh as TriMesh { nodes, triangles }
    Delaunay as Delaunay { mesh, neighbors }
    Counts as Counts {
        flips, moves, pierced_before, pierced_flipped, pierced_snapped, pierced_split, pierced_left,
        collapses, insertions, released,
    }
    Sealed as Sealed { faces, area, pockets, rooms }
    Blocked as Blocked {
        centroid, smallest, largest, nodes_on_sides, nodes_on_features, nodes_on_crossings,
    }
    Blocker as Blocker {
        tets, nodes_on_sides, nodes_on_features, nodes_on_crossings, smallest, largest,
    }
    Improvement as Improvement { poor_before, poor_after, counts, sealed, blockers, worst }
    @(M: Kept) Joined<M> as Joined { made, neighbors, improvement, rival }
}

use energy::Parts as EnergyParts;

impl<M: Kept> Kept for Marked<M> {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self {
            mesh,
            kinds,
            feature_faces,
            regions,
            // Judged when it is measured.
            judged: _,
        } = self;
        mesh.put(out)?;
        kinds.put(out)?;
        feature_faces.put(out)?;
        regions.put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        Some(Self {
            mesh: M::take(from)?,
            kinds: Kept::take(from)?,
            feature_faces: Kept::take(from)?,
            regions: Kept::take(from)?,
            judged: Judged::default(),
        })
    }
}

impl<const D: usize> Kept for Distance<D> {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        match self {
            Self::Constant(d) => (0u8, *d).put(out),
            Self::Field(field) => {
                1u8.put(out)?;
                field.put(out)
            }
        }
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        match u8::take(from)? {
            0 => Some(Self::Constant(Kept::take(from)?)),
            1 => Some(Self::Field(Kept::take(from)?)),
            _ => None,
        }
    }
}

/// What has few values, by their number.
macro_rules! numbered {
    ($($name:ident { $($value:ident),+ })+) => {$(
        impl Kept for $name {
            fn put(&self, out: &mut dyn Write) -> io::Result<()> {
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

numbered! {
    AtomKind { Interior, Side, Edge, Corner, Fixed }
    Stop { Converged, MaxIterations, Interrupted }
    FeatureKind {
        Auto, Ridges, Valleys, Edges, Canny, Paths, Horizons, Faults, FaultsAndHorizons, Labels, Potential
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_put_is_taken_again_bit_by_bit() {
        type Both = (Vec<[f64; 3]>, (Option<String>, Vec<Stop>));
        let mut bytes = Vec::new();
        let value: Both = (
            vec![[0.1f64, -0.0, f64::NAN], [f64::MIN_POSITIVE, 1e300, 3.0]],
            (Some("é".to_string()), vec![Stop::Interrupted]),
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
