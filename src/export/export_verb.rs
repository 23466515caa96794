//! Exports a mesh as `atomesh export` does: fills its cells with rock, adds wells, checks the model
//! and writes it.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::export_spec::{ExportSpec, no_effect_error};
use super::juxtaposition::JuxtapositionMap;
use super::names::ExportNames;
use super::{ExportContent, ExportFormat, corner_point};
use crate::error::cause;
use crate::files::atomic_write;
use crate::image::formats::ReadImage;
use crate::mesh_file::{CellChoice, take_cells, with_mesh};
use crate::model::flow::{FaultResistance, Rock};
use crate::model::reservoir::gouge::{FaceRock, FaultRockRule, RockClay};
use crate::model::reservoir::rock_options::FilledRock;
use crate::model::reservoir::space_options::check_depth;
use crate::model::reservoir::{
    ExtendedFault, MeshPlacement, Model, ModelChecks, PreparedModel, SealCheck, Well,
};
use crate::progress::{CancelToken, Progress, Stage};
use crate::store::AnyMesh;
use crate::store::MeshInput;
use crate::store::stored_mesh::read_live;
use crate::{Error, Result};

/// A model that was written.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ExportOutcome {
    /// The format.
    pub format: &'static ExportFormat,
    /// The file or the folder.
    pub path: PathBuf,
    /// A file with the shapes of the cells, if the format does not hold them.
    pub companion: Option<PathBuf>,
    /// The checks of the model.
    pub checks: ModelChecks,
    /// The unit of the coordinates.
    pub unit: String,
    /// `true` if the export is for flow, so that depth and fluxes matter.
    pub is_for_flow: bool,
    /// The wells.
    pub wells: Vec<Well>,
    /// The check of closed faults, if it was requested.
    pub seals: Option<SealCheck>,
    /// The faults that were extended.
    pub extended: Vec<ExtendedFault>,
}

/// Writes a mesh for a reservoir simulator or another mesher, as `atomesh export` does. All files
/// appear, or none.
///
/// ```
/// use atomesh::export::ExportFormat;
/// use atomesh::image::{Geometry, Image};
/// use atomesh::progress::NoProgress;
/// use atomesh::{ExportSpec, MeshSpec};
///
/// let disc = |i: usize| f32::from(u8::from((i % 40).abs_diff(20) < 11 && (i / 40).abs_diff(18) < 9));
/// let image = Image::new([40, 36], (0..40 * 36).map(disc).collect(), Geometry::default());
/// let spec = MeshSpec { distance: "5".parse()?, ..MeshSpec::default() };
/// let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
///
/// let path = std::env::temp_dir().join("atomesh-export-example.msh");
/// let format = ExportFormat::from_name("msh")?;
/// let outcome = atomesh::export(mesh, format, &path, &ExportSpec::default(), &mut NoProgress)?;
/// assert!(outcome.checks.cells > 50);
/// # std::fs::remove_file(&path).ok();
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of [`ExportSpec::validate`] and [`ExportFormat::write`], those of reading the
/// files that the options name, and [`Error::Export`](crate::Error::Export) for a mesh that the
/// format cannot hold.
pub fn export<'a>(
    mesh: impl Into<MeshInput<'a>>,
    format: &'static ExportFormat,
    path: &Path,
    spec: &ExportSpec,
    progress: &mut dyn Progress,
) -> Result<ExportOutcome> {
    spec.validate(format)?;
    format.check_target(path)?;
    let input = mesh.into();
    let read_image = input.read_image;
    let mut prepared = prepare_model(input, format, spec, progress)?;
    progress.stage(Stage::FillingCells);
    let mut filled = spec.rock.fill(&mut prepared, read_image, progress)?;
    let laws = spec.fault_options.laws(FaultResistance::Open)?;
    let extended = match spec.extend_faults {
        Some(distance) => prepared.model.extend_faults(distance),
        None => Vec::new(),
    };
    extended
        .iter()
        .for_each(|fault| progress.note(&fault.note(3)));
    prepared.model.set_faults(&laws)?;
    let rock = filled.rock.as_ref();
    let face_rocks = set_fault_rock(&mut prepared, rock, spec, read_image, progress)?;
    deactivate(&mut prepared, &mut filled, format, spec, progress)?;
    if let Some(rock) = filled.rock {
        prepared.model.set_permeability(rock)?;
    }
    if spec.case.has_wells() || format.uses_depth {
        prepared.model.case = spec.case.case(&prepared, progress)?;
        let mut notes = prepared.model.idle_producers();
        notes.extend(prepared.model.notes_on_wells());
        notes.iter().for_each(|note| progress.note(note));
    }
    let has_values = format
        .supported_content
        .contains(&ExportContent::Properties);
    if has_values && !format.names.has_cell_sets {
        let model = &mut prepared.model;
        let arrays: Vec<_> = model.sets.cell_arrays(model.len()).collect();
        model.properties.extend(arrays);
    }
    prepared.model.is_quadratic = spec.quadratic;
    note_periodic(&prepared.model, format, progress);
    if let Some(selection) = &spec.split {
        check_not_periodic(&prepared.model)?;
        prepared.model.split_along(selection.clone())?;
    }
    prepared.model.grid = spec.grid.map(|grid| grid.0);
    progress.stage(Stage::Checking);
    let checks = ModelChecks::new(&prepared.model, prepared.box_volume);
    note_checks(&prepared, &checks, format, spec, progress)?;
    let seals = check_seals(&prepared, format, spec)?;
    let juxtaposition = (!spec.juxtaposition.is_empty())
        .then(|| JuxtapositionMap::new(&prepared.model, &face_rocks))
        .transpose()?;
    progress.stage(Stage::Writing);
    write_model(&prepared.model, format, path, progress)?;
    if let Some(map) = &juxtaposition {
        let mut paths = spec.juxtaposition.iter();
        paths.try_for_each(|path| map.write(path, &prepared.frame))?;
    }
    if let (Some(seals), Some(table)) = (&seals, &spec.seal_table) {
        let csv = seals.csv();
        atomic_write(table, |out| out.write_all(csv.as_bytes()))?;
    }
    Ok(ExportOutcome {
        format,
        path: path.to_path_buf(),
        companion: format.companion_path(path),
        checks,
        unit: prepared.unit,
        is_for_flow: spec.is_for_flow(format),
        wells: prepared.model.case.wells,
        seals,
        extended,
    })
}

/// Gives faults the rock that follows from clay and throw, if these are given, and returns that of each face.
fn set_fault_rock(
    prepared: &mut PreparedModel,
    rock: Option<&Rock>,
    spec: &ExportSpec,
    read_image: ReadImage<'_>,
    progress: &mut dyn Progress,
) -> Result<Vec<FaceRock>> {
    let Some(clay) = &spec.gouge.clay else {
        return Ok(Vec::new());
    };
    let cells = (spec.rock).cell_values("clay", clay, prepared, read_image, progress)?;
    let image = spec.rock.probe(clay, prepared, read_image)?;
    let clay = RockClay {
        cells: &cells,
        image: image.as_ref(),
    };
    let throws = spec.gouge.throws(&prepared.frame)?;
    let rule = FaultRockRule {
        law: spec.gouge.fault_rock.unwrap_or_default(),
        smear: spec.gouge.clay_smear,
        rock,
    };
    let (fault_rocks, face_rocks) = prepared.model.set_fault_rock(clay, &throws, rule)?;
    fault_rocks
        .iter()
        .for_each(|rock| progress.note(&rock.note()));
    Ok(face_rocks)
}

/// Checks the closed faults of the model, or of the grid on which the format resamples it.
fn check_seals(
    prepared: &PreparedModel,
    format: &ExportFormat,
    spec: &ExportSpec,
) -> Result<Option<SealCheck>> {
    if !spec.check_seals {
        return Ok(None);
    }
    let (model, cancel) = (&prepared.model, CancelToken::never());
    let is_resampled = format.supported_content.contains(&ExportContent::Grid);
    let check = if is_resampled {
        let names = ExportNames::new(model, &format.names);
        let network = corner_point::grdecl::seal_network(model, &names)?;
        SealCheck::of_network(model, &network, &prepared.frame, &cancel)?
    } else {
        SealCheck::new(model, &prepared.frame, &cancel)?
    };
    Ok(Some(check))
}

/// Makes the cells inactive that hold no data, or whose rock is below a cut-off or conducts nothing.
/// The porosity of cells of which a part holds data is reduced.
fn deactivate(
    prepared: &mut PreparedModel,
    filled: &mut FilledRock,
    format: &ExportFormat,
    spec: &ExportSpec,
    progress: &mut dyn Progress,
) -> Result<()> {
    let cells = prepared.model.len();
    let mut excluded = spec.rock.cut_off(&prepared.model, filled.rock.as_ref())?;
    let has_cut_off = excluded.contains(&true);
    let mut without_data = std::mem::take(&mut filled.without_data);
    let live = read_live(&prepared.cell_data, cells).filter(|_| spec.is_for_flow(format));
    if let Some(live) = live {
        let dead = prepared.model.take_live(live);
        without_data.resize(cells, false);
        let flags = without_data.iter_mut().zip(dead);
        flags.for_each(|(flag, dead)| *flag |= dead);
        let total: f64 = prepared.model.graph.volume.iter().sum();
        if let Some(volume) = prepared.model.live_volume() {
            progress.note(&format!(
                "{:.2} % of the ground holds data ({volume:.6e} of {total:.6e} m^3; cell array live): cells without data are inactive, and porosity is multiplied by the share of each cell",
                100.0 * volume / total
            ));
        }
    }
    if without_data.contains(&true) {
        let porosity = prepared.model.porosity.iter_mut().flatten();
        let dead = porosity.zip(&without_data).filter(|(_, dead)| **dead);
        dead.for_each(|(porosity, _)| *porosity = 0.0);
        let rock = filled.rock.as_ref();
        filled.rock = rock.map(|rock| rock.scaled_where(&without_data, 0.0));
        excluded.resize(cells, false);
        let flags = excluded.iter_mut().zip(&without_data);
        flags.for_each(|(flag, dead)| *flag |= dead);
    }
    let inactive = (prepared.model).find_inactive(filled.rock.as_ref(), &excluded)?;
    if inactive > 0 {
        let mut reasons = vec!["their porosity or permeability is 0"];
        reasons.extend(has_cut_off.then_some("it is below a cut-off"));
        reasons.extend(without_data.contains(&true).then_some("they hold no data"));
        progress.note(&format!(
            "{inactive} of {cells} cells are inactive: {}",
            reasons.join(", or ")
        ));
    }
    Ok(())
}

/// Returns the mesh of the cells that are exported.
fn with_chosen_cells(
    mesh: AnyMesh,
    choice: &CellChoice<'_>,
    name: &str,
    progress: &mut dyn Progress,
) -> Result<AnyMesh> {
    if choice.keeps_all() {
        return Ok(mesh);
    }
    with_mesh!(mesh, file => {
        let chosen = choice.cells_of_file(&file, name)?;
        Ok(match chosen {
            Some(chosen) => {
                progress.note(&chosen.note);
                take_cells(file, &chosen.cells)?.into()
            }
            None => file.into(),
        })
    })
}

/// Notes that a format has no place for the pairs of nodes on opposite sides of a periodic mesh.
fn note_periodic(model: &Model, format: &ExportFormat, progress: &mut dyn Progress) {
    let content = ExportContent::PeriodicPairs;
    if !model.periodic.is_empty() && !format.supported_content.contains(&content) {
        progress.note(&format!(
            "{} has no place for the {content} of the periodic mesh: left out",
            format.name
        ));
    }
}

/// Checks that a mesh that is to be split is not periodic.
fn check_not_periodic(model: &Model) -> Result<()> {
    if model.periodic.is_empty() {
        return Ok(());
    }
    Err(Error::Export(cause(
        "split",
        "doubles nodes on sides, but the mesh is periodic, and each node has one counterpart",
        "omit it, or split a mesh that is made without --periodic",
    )))
}

/// Returns the model of a mesh, with its surfaces if the format or an option needs them.
fn prepare_model(
    input: MeshInput<'_>,
    format: &ExportFormat,
    spec: &ExportSpec,
    progress: &mut dyn Progress,
) -> Result<PreparedModel> {
    let MeshInput { mesh, name, .. } = input;
    let mesh = with_chosen_cells(mesh, &spec.cell_choice(), name, progress)?;
    let is_3d = matches!(mesh, AnyMesh::Tetrahedra(_) | AnyMesh::Polyhedra(_));
    if spec.space.thickness.is_some() && is_3d {
        let problem = "is for 2-D meshes, but the mesh is 3-D";
        return Err(no_effect_error("thickness", problem));
    }
    let placement = MeshPlacement {
        keeps_unit: !spec.is_for_flow(format),
        ..spec.space.placement()?
    };
    let needs_surfaces = format.supported_content.contains(&ExportContent::Names)
        || spec.split.is_some()
        || spec.extend_faults.is_some()
        || !spec.juxtaposition.is_empty()
        || spec.fault_options.given_option().is_some()
        || spec.gouge.given_option().is_some();
    let prepared = if needs_surfaces {
        PreparedModel::new(mesh, name, &placement)?
    } else {
        PreparedModel::without_surfaces(mesh, name, &placement)?
    };
    if format.uses_depth {
        check_depth(&prepared.model, &spec.space)?;
    }
    if !prepared.has_feature_faces {
        progress.note(&format!(
            "{name} does not say which faces lie on features, so that the model has no faults"
        ));
    }
    Ok(prepared)
}

/// Writes the model. Notes if a deck is there already, beside which the new one gets another name.
fn write_model(
    model: &Model,
    format: &ExportFormat,
    path: &Path,
    progress: &mut dyn Progress,
) -> Result<()> {
    let deck = format.deck_path(path);
    let names = ExportNames::new(model, &format.names);
    format.write_with_names(model, &names, path)?;
    let has_values = format
        .supported_content
        .contains(&ExportContent::Properties);
    let set_note = names.note_on_sets(model, format.name, has_values);
    let notes = names.notes(path, format.is_folder());
    notes
        .iter()
        .chain(&set_note)
        .for_each(|note| progress.note(note));
    let has_polyhedra = model.tets.is_none() && model.triangles.is_none();
    if let Some(readers) = format.needed_reader(has_polyhedra) {
        progress.note(&format!("{} needs {readers}", path.display()));
    }
    let default_deck = path.with_extension("DATA");
    let has_deck = model.porosity.is_some() && model.permeability.is_some();
    if let Some(deck) = deck.filter(|deck| has_deck && *deck != default_deck) {
        progress.note(&format!(
            "{} is there already and stays as it is: the corner-point grid's deck is {}",
            default_deck.display(),
            deck.display()
        ));
    }
    Ok(())
}

/// Smallest share of off-diagonal terms of a permeability in the diagonal ones that is reported.
const MIN_NOTED_OFF_DIAGONAL: f64 = 0.01;

/// Notes that a format does not hold the off-diagonal terms of the permeability.
fn note_permeability(prepared: &PreparedModel, format: &ExportFormat, progress: &mut dyn Progress) {
    let Some(effect) = format.diagonal_only() else {
        return;
    };
    // A resampled grid has the axes of the image.
    let (axes, names) = if format.supported_content.contains(&ExportContent::Grid) {
        (prepared.image_axes(), "the grid's axes")
    } else {
        (
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "x, y and z",
        )
    };
    let share = prepared.model.off_diagonal_share(&axes);
    if share > MIN_NOTED_OFF_DIAGONAL {
        progress.note(&format!(
            "the permeability has off-diagonal terms along {names}, up to {:.0} % of its diagonal: {effect}",
            100.0 * share
        ));
    }
}

/// Reports what the checks of a model found.
fn note_checks(
    prepared: &PreparedModel,
    checks: &ModelChecks,
    format: &ExportFormat,
    spec: &ExportSpec,
    progress: &mut dyn Progress,
) -> Result<()> {
    note_permeability(prepared, format, progress);
    // A resampled grid has other cells than the mesh.
    let is_resampled = format.supported_content.contains(&ExportContent::Grid);
    if !spec.is_for_flow(format) {
        if prepared.unit != "m" {
            let unit = &prepared.unit;
            progress.note(&format!(
                "coordinates are in {unit}, as in the image; --length-unit {unit} writes metres"
            ));
        }
    } else if !is_resampled {
        checks.notes().iter().for_each(|note| progress.note(note));
        if checks.is_rough() {
            let ratios = prepared.axis_ratios()?;
            let note = ratios.and_then(|ratios| ratios.note());
            note.iter().for_each(|note| progress.note(note));
        }
    }
    Ok(())
}

impl ExportOutcome {
    /// Returns the checks, the wells and the written files as a table.
    pub fn table(&self) -> String {
        let mut table = self.checks.table(&self.unit, self.is_for_flow);
        if let Some(seals) = &self.seals {
            table += &format!("\n{}", seals.table());
        }
        for well in &self.wells {
            let index: f64 = well.cells.iter().map(|c| c.1).sum();
            let place = match well.cells[..] {
                [(cell, _)] => format!("in cell {cell}"),
                _ => {
                    let length: f64 = well.lengths.iter().sum();
                    format!("{length:.2} m in {} cells", well.cells.len())
                }
            };
            table += &format!("\nwell {:<9} {place}, index {index:.3e} m^3", well.name);
        }
        let description = self.format.description;
        table += &format!("\nwrote {}: {description}", self.path.display());
        if let Some(companion) = &self.companion {
            table += &format!(
                "\nwrote {}: the same cells with their shapes",
                companion.display()
            );
        }
        table
    }

    /// Returns the checks, the wells and the written files as JSON.
    pub fn to_json(&self) -> Value {
        let path_text = |path: &Path| path.display().to_string();
        json!({
            "format": self.format.name,
            "file": path_text(&self.path),
            "twin": self.companion.as_deref().map(path_text),
            "checks": self.checks,
            "seals": self.seals.as_ref().map(|seals| &seals.faults),
            "compartments": self.seals.as_ref().map(|seals| &seals.compartments),
            "wells": self.wells.iter().map(|well| {
                json!({ "name": well.name, "cells": well.cells, "lengths": well.lengths })
            }).collect::<Vec<_>>(),
        })
    }
}
