//! The surfaces of a model as faces between the cells of a corner-point grid: FAULTS with MULTFLT, and
//! where the factor is not the same all over a surface, MULTX, MULTY and MULTZ.
//!
//! A face between neighbours is on a surface if the line between their centres crosses it. Two cells on
//! two sides of a surface without holes are thus never joined past it.

use std::io::Write;

use crate::parallel::prelude::*;

use super::corners::Corners;
use super::walk::Walk;
use crate::export::containers::text::write_numbers;
use crate::export::simulators::deck::{Done, Out};
use crate::geometry::sub;
use crate::model::reservoir::Model;
use crate::model::surface::Kind;

/// Factors that are nearer to each other are the same.
const SAME: f64 = 1e-9;

/// A face of a cell, towards the next one along an axis, that is on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Crossed {
    axis: usize,
    cell: [usize; 3],
    surface: u32,
    factor: f64,
}

/// Writes what surfaces there are, and how they resist flow.
pub fn write(out: Out, model: &Model, walk: &Walk, grid: &Corners) -> Done {
    let crossed = crossed(model, walk, grid);
    if crossed.is_empty() {
        return Ok(());
    }
    writeln!(out, "FAULTS")?;
    for faces in crossed.chunk_by(|a, b| a.surface == b.surface) {
        let name = name(model, faces[0].surface);
        for run in faces.chunk_by(continues) {
            let ([i, j, k], last) = (run[0].cell.map(|n| n + 1), run[run.len() - 1].cell[2] + 1);
            let side = ["X", "Y", "Z"][run[0].axis];
            writeln!(out, " '{name}' {i} {i} {j} {j} {k} {last} '{side}' /")?;
        }
    }
    writeln!(out, "/\n")?;
    let (mut alike, mut others) = (Vec::new(), Vec::new());
    for faces in crossed.chunk_by(|a, b| a.surface == b.surface) {
        let factor = faces[0].factor;
        if faces.iter().any(|f| (f.factor - factor).abs() > SAME) {
            others.extend_from_slice(faces);
        } else if factor < 1.0 - SAME {
            alike.push((name(model, faces[0].surface), factor));
        }
    }
    if !alike.is_empty() {
        writeln!(out, "MULTFLT")?;
        for (name, factor) in alike {
            writeln!(out, " '{name}' {factor} /")?;
        }
        writeln!(out, "/\n")?;
    }
    if others.is_empty() {
        return Ok(());
    }
    for (axis, keyword) in ["MULTX", "MULTY", "MULTZ"].into_iter().enumerate() {
        let mut all = vec![1.0; grid.dims().iter().product()];
        for face in others.iter().filter(|face| face.axis == axis) {
            all[grid.at(face.cell)] = face.factor;
        }
        writeln!(out, "{keyword}")?;
        write_numbers(out, all.len(), |at| all[at])?;
        writeln!(out, "/\n")?;
    }
    Ok(())
}

/// Whether two faces are those of a cell and of the one below it.
fn continues(a: &Crossed, b: &Crossed) -> bool {
    let [i, j, k] = a.cell;
    a.axis == b.axis && b.cell == [i, j, k + 1]
}

/// Eight letters at most; what is no more than a scrap has the number 0.
fn name(model: &Model, surface: u32) -> String {
    let kind = (surface as usize).checked_sub(1);
    match kind.and_then(|at| model.surfaces.kinds.get(at)) {
        Some(Kind::Fault) => format!("FAULT{surface}"),
        Some(Kind::Horizon) => format!("HORIZ{surface}"),
        None => "SCRAPS".into(),
    }
}

/// All faces on surfaces, surface by surface, then axis by axis, down the columns.
fn crossed(model: &Model, walk: &Walk, grid: &Corners) -> Vec<Crossed> {
    let surfaces = &model.surfaces;
    if surfaces.of_connection.iter().all(|&surface| surface == 0) {
        return Vec::new();
    }
    let dims = grid.dims();
    let of_row = |row: usize| {
        let (axis, row) = (row / (dims[1] * dims[2]), row % (dims[1] * dims[2]));
        let mut from = 0;
        let mut found = Vec::new();
        for i in 0..dims[0] {
            let cell = [i, row % dims[1], row / dims[1]];
            let mut next = cell;
            next[axis] += 1;
            if next[axis] == dims[axis] {
                continue;
            }
            let [p, q] = [cell, next].map(|cell| grid.point(cell, [0.5; 3]));
            from = walk.cell_at(p, from);
            let line = walk.line(p, sub(q, p), from);
            let between = line.iter().filter(|piece| (0.0..1.0).contains(&piece.end));
            // A rough face is crossed more than once: the tightest counts.
            let on = between.filter_map(|piece| {
                let connection = piece.leaves_by? as usize;
                match surfaces.of_connection[connection] {
                    0 => None,
                    surface => Some((model.fault_factor(connection), surface)),
                }
            });
            if let Some((factor, surface)) = on.min_by(|a, b| a.0.total_cmp(&b.0)) {
                let scrap = surface as usize > surfaces.kept;
                found.push(Crossed {
                    axis,
                    cell,
                    surface: if scrap { 0 } else { surface },
                    factor,
                });
            }
        }
        found
    };
    let rows = 3 * dims[1] * dims[2];
    let mut all: Vec<Crossed> = (0..rows).into_par_iter().flat_map_iter(of_row).collect();
    // Scraps last.
    all.sort_by_key(|f| (f.surface.wrapping_sub(1), f.axis, f.cell));
    all
}
