//! Where an image's samples lie in the world.

/// Maps sample indices (x first) to physical coordinates: `origin + sum_k index[k] * axes[k]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry<const D: usize> {
    /// Physical position of sample `[0, 0, ..]`.
    pub origin: [f64; D],
    /// `axes[k]` is the physical step from one sample to the next along axis `k` (x first).
    pub axes: [[f64; D]; D],
    /// What each *image axis* is, e.g. `["sample", "crossline", "inline"]`.
    pub names: [String; D],
    /// The unit of each *physical coordinate*, e.g. `["m", "m", "ms"]`; empty if unknown.
    pub units: [String; D],
}

impl<const D: usize> Default for Geometry<D> {
    /// Unit spacing, origin zero: physical coordinates are sample indices.
    fn default() -> Self {
        let names = ["x", "y", "z"];
        Self {
            origin: [0.0; D],
            axes: std::array::from_fn(|k| std::array::from_fn(|c| f64::from(u8::from(k == c)))),
            names: std::array::from_fn(|k| names.get(k).copied().unwrap_or("w").to_string()),
            units: std::array::from_fn(|_| String::new()),
        }
    }
}

impl<const D: usize> Geometry<D> {
    /// Axis-aligned geometry with the given spacing.
    pub fn with_spacing(origin: [f64; D], spacing: [f64; D]) -> Self {
        let mut geometry = Self {
            origin,
            ..Self::default()
        };
        for k in 0..D {
            geometry.axes[k][k] = spacing[k];
        }
        geometry
    }

    /// Distance between neighbouring samples along each axis.
    pub fn spacing(&self) -> [f64; D] {
        std::array::from_fn(|k| self.axes[k].iter().map(|a| a * a).sum::<f64>().sqrt())
    }

    /// Physical coordinates of a (fractional) sample index.
    pub fn to_physical(&self, index: [f64; D]) -> [f64; D] {
        let mut p = self.origin;
        for k in 0..D {
            for c in 0..D {
                p[c] += index[k] * self.axes[k][c];
            }
        }
        p
    }
}
