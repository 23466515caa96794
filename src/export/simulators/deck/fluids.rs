//! The fluids of a deck: tables of their properties, and their state in equilibrium.

use std::io::Write;

use crate::files::text::{FileWriter, WriteResult};
use crate::model::reservoir::{
    BAR, CapillaryOption, Fluid, GAS_DENSITY, Model, OIL_DENSITY, SURFACE_PRESSURE, SimulationCase,
    WATER_DENSITY,
};

/// Saturation of immobile water in rock full of oil.
pub(crate) const CONNATE_WATER_SATURATION: f64 = 0.2;
/// Number of steps of the table of relative permeabilities, up to the residual oil saturation.
const TABLE_STEPS: usize = 12;
/// Smallest saturation of mobile water over the largest one for which capillary pressure is
/// computed. It would be infinite at 0.
const MIN_CAPILLARY_SATURATION: f64 = 0.005;
/// Ratio of the saturations of mobile water in two rows of a table with capillary pressure: linear
/// interpolation between them is off by half a percent of the saturation.
const CAPILLARY_STEP_RATIO: f64 = 1.2;
/// Pressures in bar in the table of the volume of gas.
const GAS_PRESSURES: [f64; 8] = [20.0, 50.0, 100.0, 150.0, 200.0, 300.0, 400.0, 600.0];
/// Deviation of the volume of gas from that of an ideal gas.
const GAS_DEVIATION: f64 = 0.9;
/// Temperature in the reservoir, 353 K, over that at the surface, 288 K.
const GAS_EXPANSION: f64 = 353.0 / 288.0;

/// Writes PROPS: for each number of a table the same typical fluids, and for each table of relative
/// permeability its capillary pressure.
pub(crate) fn write_props(out: FileWriter, model: &Model) -> WriteResult {
    let case = &model.case;
    let [saturation_tables, pressure_tables, ..] = model.deck_regions.counts();
    let reference = case.top_pressure / BAR;
    let repeated = |line: String| vec![line; pressure_tables].join("\n");
    let gas_density = match case.fluid {
        Fluid::OilWaterGas => GAS_DENSITY,
        _ => 1.0,
    };
    writeln!(
        out,
        "PROPS\n\nPVTW\n{}\nROCK\n{}\nDENSITY\n{}",
        repeated(format!(" {reference} 1.0 4.5E-5 1.0 0 /")),
        repeated(format!(" {reference} 4.5E-5 /")),
        repeated(format!(" {OIL_DENSITY} {WATER_DENSITY} {gas_density} /"))
    )?;
    if case.fluid == Fluid::Water {
        return writeln!(out);
    }
    let oil = repeated(format!(" {reference} 1.1 1.0E-4 2.0 0 /"));
    writeln!(out, "PVCDO\n{oil}\nSWOF")?;
    for table in 1..=saturation_tables {
        let capillary = CapillaryOption::for_table(&case.capillary_pressures, table as u32);
        write_water_table(out, capillary)?;
    }
    if case.fluid == Fluid::OilWaterGas {
        writeln!(out, "SGOF")?;
        for _ in 1..=saturation_tables {
            write_gas_table(out)?;
        }
        writeln!(out, "PVDG")?;
        for _ in 1..=pressure_tables {
            for pressure in GAS_PRESSURES {
                let volume = GAS_DEVIATION * SURFACE_PRESSURE / BAR / pressure * GAS_EXPANSION;
                writeln!(
                    out,
                    " {pressure} {volume:.6e} {:.4}",
                    0.012 + 2e-5 * pressure
                )?;
            }
            writeln!(out, " /")?;
        }
    }
    writeln!(out)
}

/// Writes Corey functions with exponents of 2, 20 % immobile water and 20 % residual oil.
fn write_water_table(out: FileWriter, capillary: Option<CapillaryOption>) -> WriteResult {
    let connate = CONNATE_WATER_SATURATION;
    let pressure = |water: f64| {
        let mobile = ((water - connate) / (1.0 - connate)).max(MIN_CAPILLARY_SATURATION);
        capillary.map_or(0.0, |curve| curve.pressure(mobile))
    };
    let rows: Vec<f64> = if capillary.is_some() {
        // Steps of equal ratio follow the curve, which is steep near immobile water. Residual oil
        // has a row of its own.
        let next = |s: &f64| Some(s * CAPILLARY_STEP_RATIO);
        let mobile = std::iter::successors(Some(MIN_CAPILLARY_SATURATION), next);
        let mobile = mobile.take_while(|s| *s < 1.0).chain([0.0, 0.75]);
        let mut rows: Vec<f64> = mobile.map(|s| connate + (1.0 - connate) * s).collect();
        rows.sort_by(f64::total_cmp);
        rows
    } else {
        let step = |step| connate + 0.6 * step as f64 / TABLE_STEPS as f64;
        (0..=TABLE_STEPS).map(step).collect()
    };
    for water in rows {
        let [water_mobility, oil_mobility] =
            [(water - connate) / 0.8, ((0.8 - water) / 0.6).max(0.0)];
        let (water_mobility, oil_mobility) = (water_mobility.powi(2), oil_mobility.powi(2));
        if capillary.is_some() {
            writeln!(
                out,
                " {water:.6} {water_mobility:.6} {oil_mobility:.6} {:.6}",
                pressure(water)
            )?;
        } else {
            writeln!(out, " {water:.3} {water_mobility:.6} {oil_mobility:.6} 0")?;
        }
    }
    if capillary.is_some() {
        return writeln!(out, " 1 1 0 {:.6} /", pressure(1.0));
    }
    writeln!(out, " 1 1 0 0 /")
}

/// Writes Corey functions with exponents of 2, 5 % immobile gas and 20 % residual oil, where there
/// is immobile water.
fn write_gas_table(out: FileWriter) -> WriteResult {
    let highest = 1.0 - CONNATE_WATER_SATURATION;
    writeln!(out, " 0 0 1 0")?;
    for step in 0..=TABLE_STEPS {
        let gas = 0.05 + (highest - 0.25) * step as f64 / TABLE_STEPS as f64;
        let gas_mobility = 0.8 * ((gas - 0.05) / (highest - 0.05)).powi(2);
        let oil_mobility = ((highest - 0.2 - gas) / (highest - 0.2)).max(0.0).powi(2);
        writeln!(out, " {gas:.4} {gas_mobility:.6} {oil_mobility:.6} 0")?;
    }
    writeln!(out, " {highest} 0.8 0 0 /")
}

/// Writes the state of fluids in equilibrium, if there is one. Returns `true` if there is.
pub(crate) fn write_equilibrium(out: FileWriter, case: &SimulationCase) -> std::io::Result<bool> {
    if case.equilibria.is_empty() {
        return Ok(false);
    }
    // The initial state is in the restart file, too.
    writeln!(out, "RPTRST\n BASIC=2 /\n\nEQUIL")?;
    for e in &case.equilibria {
        writeln!(
            out,
            " {} {} {} {} {} {} 1 0 0 /",
            e.datum,
            e.pressure / BAR,
            e.oil_water,
            e.oil_water_capillary / BAR,
            e.gas_oil,
            e.gas_oil_capillary / BAR
        )?;
    }
    writeln!(out)?;
    Ok(true)
}
