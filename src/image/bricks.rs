//! Bricks: small blocks of samples, of which each rank has those that it needs.
//!
//! A brick has [`BRICK_CELLS`] cells along each axis, and all samples that interpolation in these cells needs.

use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use crate::files::codec::Codec;

/// Cells along an edge of a brick.
pub const BRICK_CELLS: usize = 8;

/// Returns the number of bricks along each axis of a grid of samples.
pub fn brick_counts<const D: usize>(dims: [usize; D]) -> [usize; D] {
    dims.map(|n| n.saturating_sub(1).max(1).div_ceil(BRICK_CELLS))
}

/// Flag that records an access to a missing brick. It is not a part of the function: clones start
/// unset, and comparisons ignore it.
#[derive(Debug, Default)]
pub(crate) struct MissFlag(AtomicBool);

impl MissFlag {
    /// Sets the flag.
    pub(crate) fn set(&self) {
        self.0.store(true, Relaxed);
    }

    /// Returns `true` if the flag is set.
    pub(crate) fn is_set(&self) -> bool {
        self.0.load(Relaxed)
    }
}

impl Clone for MissFlag {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl PartialEq for MissFlag {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Codec for MissFlag {
    fn encode(&self, _: &mut dyn Write) -> io::Result<()> {
        Ok(())
    }

    fn decode(_: &mut &[u8]) -> Option<Self> {
        Some(Self::default())
    }
}
