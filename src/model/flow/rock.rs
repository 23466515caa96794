//! Rock properties for flow: permeability, viscosity, and the resistance of faults.

use crate::error::cause;
use crate::{Error, Result};

/// A symmetric tensor, with components in the order of VTK: xx, yy, zz, xy, yz, xz.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tensor(pub [f64; 6]);

impl Tensor {
    /// Returns an isotropic tensor with the value `k` along all directions.
    pub fn isotropic(k: f64) -> Self {
        Self([k, k, k, 0.0, 0.0, 0.0])
    }

    /// Returns a tensor from 1, 3 or 6 numbers: k; or kx, ky, kz; or kxx, kyy, kzz, kxy, kyz, kxz.
    /// Returns `None` for another count, or if the tensor is not positive definite.
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

    /// Calls [`from_plane_numbers`](Self::from_plane_numbers) in 2-D and
    /// [`from_numbers`](Self::from_numbers) in 3-D.
    pub fn from_components<const D: usize>(numbers: &[f64]) -> Option<Self> {
        match D {
            2 => Self::from_plane_numbers(numbers),
            _ => Self::from_numbers(numbers),
        }
    }

    /// Returns the tensor times a number.
    pub fn scaled(self, s: f64) -> Self {
        Self(self.0.map(|v| s * v))
    }

    /// Returns a tensor of the plane from 1, 2 or 3 numbers: k; or kx, ky; or kxx, kyy, kxy. The
    /// value along z is that along x.
    pub fn from_plane_numbers(numbers: &[f64]) -> Option<Self> {
        match *numbers {
            [k] => Self::from_numbers(&[k]),
            [x, y] => Self::from_numbers(&[x, y, x]),
            [xx, yy, xy] => Self::from_numbers(&[xx, yy, xx, xy, 0.0, 0.0]),
            _ => None,
        }
    }

    /// Returns the tensor times a vector. For a vector of the plane, this is the part in the plane.
    #[inline]
    pub fn times<const D: usize>(&self, v: [f64; D]) -> [f64; D] {
        let [xx, yy, zz, xy, yz, xz] = self.0;
        let rows = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        std::array::from_fn(|i| (0..D).map(|j| rows[i][j] * v[j]).sum())
    }

    /// Returns `n . K n`, the permeability for flow along the unit vector `n` that a gradient along
    /// `n` drives.
    #[inline]
    pub fn normal_component<const D: usize>(&self, n: [f64; D]) -> f64 {
        let kn = self.times(n);
        (0..D).map(|k| n[k] * kn[k]).sum()
    }
}

/// The mobility (permeability over viscosity) of every cell: m^2 / (Pa s) in SI units.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rock {
    /// The different mobilities.
    pub mobilities: Vec<Tensor>,
    /// The index of each cell's mobility in `mobilities`. It is empty if all cells have the first
    /// one.
    pub cell_mobility: Vec<u32>,
}

impl Rock {
    /// Returns rock with one permeability everywhere.
    pub fn uniform(permeability: Tensor, viscosity: f64) -> Self {
        Self {
            mobilities: vec![permeability.scaled(1.0 / viscosity)],
            cell_mobility: Vec::new(),
        }
    }

    /// Returns rock with one permeability for each region. `permeability` holds pairs of a region
    /// and its permeability.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] with the number of the region if a region has no permeability.
    pub fn by_region(
        regions: &[i32],
        permeability: &[(i32, Tensor)],
        viscosity: f64,
    ) -> Result<Self> {
        let mobility_index = |region: &i32| {
            let index = permeability.iter().position(|(known, _)| known == region);
            index.map(|index| index as u32).ok_or_else(|| {
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
            cell_mobility: regions.iter().map(mobility_index).collect::<Result<_>>()?,
        })
    }

    /// Returns rock with one permeability for each cell. `values` holds `components` numbers for
    /// each cell, as [`Tensor::from_components`] takes them.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] with the number of the cell if its numbers are not a valid
    /// permeability.
    pub fn by_cell<const D: usize>(
        values: &[f64],
        components: usize,
        viscosity: f64,
    ) -> Result<Self> {
        let mobility_of_cell = |(cell, numbers): (usize, &[f64])| {
            let tensor = Tensor::from_components::<D>(numbers);
            tensor.map(|k| k.scaled(1.0 / viscosity)).ok_or_else(|| {
                Error::Flow(cause(
                    format!("permeability of cell {cell}"),
                    format!("is given as {numbers:?}, which is not a permeability"),
                    "give positive definite numbers for each cell",
                ))
            })
        };
        let mobilities: Vec<Tensor> = values
            .chunks(components)
            .enumerate()
            .map(mobility_of_cell)
            .collect::<Result<_>>()?;
        Ok(Self {
            cell_mobility: (0..mobilities.len() as u32).collect(),
            mobilities,
        })
    }

    /// Returns the rock with the mobility of the selected cells multiplied by a factor. There is a flag
    /// for each cell.
    pub fn scaled_where(&self, is_selected: &[bool], factor: f64) -> Self {
        let scaled = self.mobilities.iter().map(|tensor| tensor.scaled(factor));
        let index = |(cell, &is_selected): (usize, &bool)| {
            let index = self.cell_mobility.get(cell).copied().unwrap_or(0);
            if is_selected {
                index + self.mobilities.len() as u32
            } else {
                index
            }
        };
        Self {
            cell_mobility: is_selected.iter().enumerate().map(index).collect(),
            mobilities: self.mobilities.iter().copied().chain(scaled).collect(),
        }
    }

    /// Returns the mobility of a cell.
    #[inline]
    pub fn mobility(&self, cell: usize) -> &Tensor {
        match self.cell_mobility.get(cell) {
            Some(&index) => &self.mobilities[index as usize],
            None => &self.mobilities[0],
        }
    }
}

/// The resistance of faults to flow across them. A fault is a thin layer of rock, whose
/// permeability is `multiplier` times that of the rock that it replaces. Or the layer has a
/// permeability of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultLaw {
    multiplier: f64,
    thickness: Option<f64>,
    /// Mobility of the layer. If it is known, `multiplier` has no effect.
    layer_mobility: Option<f64>,
}

impl FaultLaw {
    /// The law of faults without resistance.
    pub const OPEN: Self = Self {
        multiplier: 1.0,
        thickness: None,
        layer_mobility: None,
    };
    /// The law of faults that no fluid crosses.
    pub const CLOSED: Self = Self {
        multiplier: 0.0,
        thickness: None,
        layer_mobility: None,
    };

    /// Makes a law. A multiplier above 1 makes a fault conduct better than the rock, as a zone of
    /// damaged rock does. Without `thickness` the layer is as thick as the distance between the centres
    /// of the two cells, measured normal to the face. Then `multiplier` means the same as in
    /// reservoir simulators: a factor of the transmissibility from cell to cell (which depends on
    /// the mesh).
    ///
    /// # Errors
    /// Returns [`Error::Flow`] if the multiplier is negative or not finite, or if the thickness is
    /// not positive.
    pub fn new(multiplier: f64, thickness: Option<f64>) -> Result<Self> {
        let refuse = |place: String, problem: &str, remedy: &str| {
            Err(Error::Flow(cause(place, problem, remedy)))
        };
        if !(multiplier >= 0.0 && multiplier.is_finite()) {
            let place = format!("fault multiplier {multiplier}");
            return refuse(place, "is not 0 or more", "0 is closed, 1 is open");
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
                layer_mobility: None,
            }),
        }
    }

    /// Makes the law of a layer with this mobility (permeability over viscosity) and thickness,
    /// which replaces rock of both cells alike.
    pub fn layer(mobility: f64, thickness: f64) -> Self {
        Self {
            multiplier: 1.0,
            thickness: Some(thickness),
            layer_mobility: Some(mobility),
        }
    }

    /// Returns the factor of permeability: 0 is closed, 1 is open.
    pub fn multiplier(&self) -> f64 {
        self.multiplier
    }

    /// Returns `true` if faults with this law have no resistance.
    pub fn is_open(&self) -> bool {
        self.multiplier == 1.0 && self.layer_mobility.is_none()
    }

    /// Returns `true` if faults with this law conduct better than the rock that they replace.
    pub fn is_conduit(&self) -> bool {
        self.multiplier > 1.0
    }

    /// Returns the rate across a fault per area and per pressure jump. `distance` holds the
    /// distances from the centres of the two cells to the face, and `mobility` their mobilities.
    /// The result c is 0 for a closed fault and infinite for an open one. Only the resistance of
    /// the layer beyond that of the rock that it replaces counts: `1 / c = (1 / multiplier - 1)
    /// (d_1 / k_1 + d_2 / k_2)`. The result is negative for a layer that conducts better than the
    /// rock.
    pub fn conductance(&self, distance: [f64; 2], mobility: [f64; 2]) -> f64 {
        let [d, e] = self.thickness.map_or(distance, |w| [0.5 * w; 2]);
        let resistance = d / mobility[0] + e / mobility[1];
        if let Some(layer_mobility) = self.layer_mobility {
            return 1.0 / ((d + e) / layer_mobility - resistance);
        }
        self.multiplier / ((1.0 - self.multiplier) * resistance)
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
        for invalid in [
            &[0.0][..],
            &[-1.0],
            &[f64::NAN],
            &[f64::INFINITY],
            &[1.0, 2.0],
            &[1.0, 1.0, 0.0],
            &[1.0, 1.0, 1.0, 1.0, 0.0, 0.0],
            &[1.0, 1.0, 1.0, 0.9, 0.9, -0.9],
        ] {
            assert_eq!(Tensor::from_numbers(invalid), None, "{invalid:?}");
        }
    }

    #[test]
    fn a_multiplier_is_a_factor_of_the_transmissibility_from_cell_to_cell() {
        let (distance, mobility) = ([0.3, 0.7], [2.0, 5.0]);
        let resistance = 0.3 / 2.0 + 0.7 / 5.0;
        for multiplier in [1e-6, 0.01, 0.5, 0.999] {
            let faults = FaultLaw::new(multiplier, None).unwrap();
            let transmissibility =
                1.0 / (resistance + 1.0 / faults.conductance(distance, mobility));
            assert!((transmissibility * resistance / multiplier - 1.0).abs() < 1e-9);
        }
        assert_eq!(FaultLaw::CLOSED.conductance(distance, mobility), 0.0);
        assert_eq!(
            FaultLaw::OPEN.conductance(distance, mobility),
            f64::INFINITY
        );
        // A layer of thickness 0.2 with a tenth of the permeability (4) of the rock that it
        // replaces.
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
            (f64::INFINITY, None),
            (f64::NAN, None),
            (0.5, Some(0.0)),
            (0.5, Some(f64::NAN)),
        ] {
            assert!(FaultLaw::new(multiplier, thickness).is_err());
        }
    }
}
