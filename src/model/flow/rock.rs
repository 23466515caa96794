//! What fluid flows through: permeability, viscosity, and how faults resist.

use crate::error::cause;
use crate::{Error, Result};

/// A symmetric tensor in the order of VTK: xx, yy, zz, xy, yz, xz.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tensor(pub [f64; 6]);

impl Tensor {
    /// The same in all directions.
    pub fn isotropic(k: f64) -> Self {
        Self([k, k, k, 0.0, 0.0, 0.0])
    }

    /// From 1, 3 or 6 numbers: k; or kx, ky, kz; or kxx, kyy, kzz, kxy, kyz, kxz. `None` for
    /// another count, or where the tensor is not positive definite.
    pub fn from_numbers(numbers: &[f64]) -> Option<Self> {
        let tensor = match *numbers {
            [k] => Self::isotropic(k),
            [x, y, z] => Self([x, y, z, 0.0, 0.0, 0.0]),
            _ => Self(numbers.try_into().ok()?),
        };
        let [xx, yy, zz, xy, yz, xz] = tensor.0;
        let minor = xx * yy - xy * xy;
        let determinant = zz * minor - yz * (xx * yz - xy * xz) + xz * (xy * yz - yy * xz);
        let definite = xx > 0.0 && minor > 0.0 && determinant > 0.0;
        (definite && tensor.0.iter().all(|v| v.is_finite())).then_some(tensor)
    }

    /// [`in_plane`](Self::from_plane_numbers) or [`from_numbers`](Self::from_numbers), by the dimension.
    pub fn from_components<const D: usize>(numbers: &[f64]) -> Option<Self> {
        match D {
            2 => Self::from_plane_numbers(numbers),
            _ => Self::from_numbers(numbers),
        }
    }

    /// The tensor times a number.
    pub fn scaled(self, s: f64) -> Self {
        Self(self.0.map(|v| s * v))
    }

    /// In the plane, from 1, 2 or 3 numbers: k; or kx, ky; or kxx, kyy, kxy. Along z it is as along x.
    pub fn from_plane_numbers(numbers: &[f64]) -> Option<Self> {
        match *numbers {
            [k] => Self::from_numbers(&[k]),
            [x, y] => Self::from_numbers(&[x, y, x]),
            [xx, yy, xy] => Self::from_numbers(&[xx, yy, xx, xy, 0.0, 0.0]),
            _ => None,
        }
    }

    /// The tensor times a vector; of a vector of the plane, the part in the plane.
    #[inline]
    pub fn times<const D: usize>(&self, v: [f64; D]) -> [f64; D] {
        let [xx, yy, zz, xy, yz, xz] = self.0;
        let rows = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        std::array::from_fn(|i| (0..D).map(|j| rows[i][j] * v[j]).sum())
    }

    /// `n . K n`: what counts for flow along the unit vector `n` driven along it.
    #[inline]
    pub fn normal_component<const D: usize>(&self, n: [f64; D]) -> f64 {
        let kn = self.times(n);
        (0..D).map(|k| n[k] * kn[k]).sum()
    }
}

/// The mobility, permeability over viscosity, of every cell: m^2 / (Pa s) in SI units.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rock {
    /// The mobilities that occur.
    pub mobilities: Vec<Tensor>,
    /// Which of them a cell has; empty if there is but one.
    pub cell_mobility: Vec<u32>,
}

impl Rock {
    /// The same everywhere.
    pub fn uniform(permeability: Tensor, viscosity: f64) -> Self {
        Self {
            mobilities: vec![permeability.scaled(1.0 / viscosity)],
            cell_mobility: Vec::new(),
        }
    }

    /// Permeability by region: a cell of region r has that of the pair (r, K).
    ///
    /// # Errors
    /// [`Error::Flow`] names a region without permeability.
    pub fn by_region(
        regions: &[i32],
        permeability: &[(i32, Tensor)],
        viscosity: f64,
    ) -> Result<Self> {
        let kind = |region: &i32| {
            let at = permeability.iter().position(|(known, _)| known == region);
            at.map(|at| at as u32).ok_or_else(|| {
                let known: Vec<String> = permeability
                    .iter()
                    .map(|(known, _)| known.to_string())
                    .collect();
                Error::Flow(cause(
                    format!("region {region}"),
                    format!(
                        "has no permeability (there is one for {})",
                        known.join(", ")
                    ),
                    "give one for every region of the mesh",
                ))
            })
        };
        Ok(Self {
            mobilities: permeability
                .iter()
                .map(|(_, k)| k.scaled(1.0 / viscosity))
                .collect(),
            cell_mobility: regions.iter().map(kind).collect::<Result<_>>()?,
        })
    }

    /// Permeability cell by cell: `components` numbers for each, as [`Tensor::from_components`] takes
    /// them.
    ///
    /// # Errors
    /// [`Error::Flow`] names a cell whose numbers are no permeability.
    pub fn by_cell<const D: usize>(
        values: &[f64],
        components: usize,
        viscosity: f64,
    ) -> Result<Self> {
        let cell = |(cell, numbers): (usize, &[f64])| {
            let tensor = Tensor::from_components::<D>(numbers);
            tensor.map(|k| k.scaled(1.0 / viscosity)).ok_or_else(|| {
                Error::Flow(cause(
                    format!("permeability of cell {cell}"),
                    format!("is given as {numbers:?}, which is not a permeability"),
                    "give positive definite numbers for each cell",
                ))
            })
        };
        let kinds: Vec<Tensor> = values
            .chunks(components)
            .enumerate()
            .map(cell)
            .collect::<Result<_>>()?;
        Ok(Self {
            cell_mobility: (0..kinds.len() as u32).collect(),
            mobilities: kinds,
        })
    }

    /// The mobility of a cell.
    #[inline]
    pub fn mobility(&self, cell: usize) -> &Tensor {
        match self.cell_mobility.get(cell) {
            Some(&kind) => &self.mobilities[kind as usize],
            None => &self.mobilities[0],
        }
    }
}

/// How faults resist flow across them: as a thin layer of rock whose permeability is `multiplier`
/// times that of the rock in whose place it stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultLaw {
    multiplier: f64,
    thickness: Option<f64>,
}

impl FaultLaw {
    /// Faults that do not resist.
    pub const OPEN: Self = Self {
        multiplier: 1.0,
        thickness: None,
    };
    /// Faults that nothing crosses.
    pub const CLOSED: Self = Self {
        multiplier: 0.0,
        thickness: None,
    };

    /// Without a `thickness` the layer is as thick as the distance between the two cells' centres
    /// square to the face, so that `multiplier` is what reservoir simulators mean by it: a factor of
    /// the transmissibility from cell to cell (which depends on the mesh).
    ///
    /// # Errors
    /// [`Error::Flow`] for a multiplier outside [0, 1] or a thickness that is not positive.
    pub fn new(multiplier: f64, thickness: Option<f64>) -> Result<Self> {
        let refuse = |place: String, problem: &str, remedy: &str| {
            Err(Error::Flow(cause(place, problem, remedy)))
        };
        if !(0.0..=1.0).contains(&multiplier) {
            let place = format!("fault multiplier {multiplier}");
            return refuse(place, "is not from 0 to 1", "0 is closed, 1 is open");
        }
        match thickness {
            Some(w) if !(w > 0.0 && w.is_finite()) => {
                let place = format!("fault thickness {w}");
                refuse(
                    place,
                    "is not positive",
                    "give the thickness of the fault's layer",
                )
            }
            _ => Ok(Self {
                multiplier,
                thickness,
            }),
        }
    }

    /// The factor of permeability: 0 is closed, 1 is open.
    pub fn multiplier(&self) -> f64 {
        self.multiplier
    }

    /// Whether faults do not resist at all.
    pub fn is_open(&self) -> bool {
        self.multiplier == 1.0
    }

    /// Rate across a fault, per area and per jump of pressure, where the two cells have these
    /// distances from centre to face and these mobilities: 0 if closed, infinite if open. What the
    /// layer resists beyond the rock in whose place it is counts:
    /// `1 / c = (1 / multiplier - 1) (d_1 / k_1 + d_2 / k_2)`.
    pub fn conductance(&self, distance: [f64; 2], mobility: [f64; 2]) -> f64 {
        let [d, e] = self.thickness.map_or(distance, |w| [0.5 * w; 2]);
        let rock = d / mobility[0] + e / mobility[1];
        self.multiplier / ((1.0 - self.multiplier) * rock)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_are_positive_definite_or_refused() {
        assert_eq!(Tensor::from_numbers(&[2.0]), Some(Tensor::isotropic(2.0)));
        let full = Tensor::from_numbers(&[3.0, 2.0, 1.0, 0.5, 0.1, -0.2]).unwrap();
        assert_eq!(full.times([1.0, 0.0, 0.0]), [3.0, 0.5, -0.2]);
        assert_eq!(full.normal_component([0.0, 1.0, 0.0]), 2.0);
        let flat = Tensor::from_plane_numbers(&[3.0, 2.0, 0.5]).unwrap();
        assert_eq!(flat.times([1.0, 2.0]), [4.0, 4.5]);
        assert_eq!(
            Tensor::from_plane_numbers(&[3.0, 2.0])
                .unwrap()
                .normal_component([0.0, 1.0]),
            2.0
        );
        assert_eq!(Tensor::from_plane_numbers(&[1.0, 1.0, 1.0]), None);
        assert_eq!(Tensor::from_plane_numbers(&[1.0; 6]), None);
        for wrong in [
            &[0.0][..],
            &[-1.0],
            &[f64::NAN],
            &[f64::INFINITY],
            &[1.0, 2.0],
            &[1.0, 1.0, 0.0],
            &[1.0, 1.0, 1.0, 1.0, 0.0, 0.0],
            &[1.0, 1.0, 1.0, 0.9, 0.9, -0.9],
        ] {
            assert_eq!(Tensor::from_numbers(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn a_multiplier_is_a_factor_of_the_transmissibility_from_cell_to_cell() {
        let (distance, mobility) = ([0.3, 0.7], [2.0, 5.0]);
        let rock = 0.3 / 2.0 + 0.7 / 5.0;
        for multiplier in [1e-6, 0.01, 0.5, 0.999] {
            let faults = FaultLaw::new(multiplier, None).unwrap();
            let whole = 1.0 / (rock + 1.0 / faults.conductance(distance, mobility));
            assert!((whole * rock / multiplier - 1.0).abs() < 1e-9);
        }
        assert_eq!(FaultLaw::CLOSED.conductance(distance, mobility), 0.0);
        assert_eq!(
            FaultLaw::OPEN.conductance(distance, mobility),
            f64::INFINITY
        );
        // A layer 0.2 thick, a tenth as permeable as the rock (4) in whose place it stands.
        let layer = FaultLaw::new(0.1, Some(0.2)).unwrap();
        let resistance = 1.0 / layer.conductance([1.0; 2], [4.0; 2]);
        assert!((resistance - (0.2 / 0.4 - 0.2 / 4.0)).abs() < 1e-12);
    }

    #[test]
    fn regions_without_permeability_and_wrong_multipliers_are_named() {
        let k = [(1, Tensor::isotropic(1.0)), (4, Tensor::isotropic(2.0))];
        let rock = Rock::by_region(&[4, 1, 4], &k, 0.5).unwrap();
        assert_eq!(rock.mobility(0), &Tensor::isotropic(4.0));
        let error = Rock::by_region(&[1, 7], &k, 1.0).unwrap_err().to_string();
        assert!(
            error.contains("region 7") && error.contains("1, 4"),
            "{error}"
        );
        for (multiplier, thickness) in [
            (-0.1, None),
            (1.5, None),
            (f64::NAN, None),
            (0.5, Some(0.0)),
            (0.5, Some(f64::NAN)),
        ] {
            assert!(FaultLaw::new(multiplier, thickness).is_err());
        }
    }
}
