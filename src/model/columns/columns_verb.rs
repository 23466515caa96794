//! Makes columns as `atomesh columns` does.

use serde_json::{Value, json};

use super::columns_spec::ColumnsSpec;
use super::file::{MapCells, columns_to_file};
use super::given::{GivenHorizon, place_horizons};
use super::torn_map::{TornHorizon, TornMap};
use super::{Columns, Juxtaposed, extend};
use crate::error::cause;
use crate::mesh::poly::PolyMesh;
use crate::mesh_file::Provenance;
use crate::progress::{Progress, Stage};
use crate::store::stored_mesh::read_live;
use crate::store::{AnyMesh, LatticeSpace, MeshFile, StoredMesh};
use crate::{Error, Result};

/// A map, and the horizons between which its cells are extended.
#[derive(Debug, Clone)]
pub struct ColumnsInput<'a> {
    /// The map: Voronoi cells of a 2-D image.
    pub map: AnyMesh,
    /// The name of the map in messages.
    pub name: &'a str,
    /// The SHA-256 of the map's file, which the mesh records; empty if there is no file.
    pub sha256: String,
    /// The horizons from the top down. An image that has no position of its own, and as many samples
    /// as the meshed image, has the position of the map.
    pub horizons: Vec<GivenHorizon>,
}

/// A mesh of columns.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ColumnsOutcome {
    /// The mesh, with the cell arrays `column` and `layer`.
    pub mesh: MeshFile<PolyMesh<3>>,
    /// Number of columns, which is the number of the map's cells.
    pub columns: usize,
    /// Number of layers in each interval.
    pub layer_counts: Vec<usize>,
    /// For each layer, the number of columns in which it is missing.
    pub missing_counts: Vec<usize>,
    /// `true` if z increases upwards, from the last horizon to the first.
    pub is_z_up: bool,
    /// The faces at faults where horizons are offset; `None` if no map was torn.
    pub juxtaposed: Option<Juxtaposed>,
}

/// Extends the Voronoi cells of a map down through layers between horizons, as `atomesh columns`
/// does.
///
/// ```
/// use atomesh::image::{Geometry, Image};
/// use atomesh::model::columns::given::GivenHorizon;
/// use atomesh::model::columns::{ColumnsInput, ColumnsSpec};
/// use atomesh::progress::NoProgress;
/// use atomesh::MeshSpec;
///
/// let disc = |i: usize| f32::from(u8::from((i % 40).abs_diff(20) < 11 && (i / 40).abs_diff(18) < 9));
/// let image = Image::new([40, 36], (0..40 * 36).map(disc).collect(), Geometry::default());
/// let spec: MeshSpec = toml::from_str("cells = 'voronoi'\ndistance = 5")?;
/// let map = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
/// let horizons = [("top", 100.0), ("base", 130.0)];
/// let input = ColumnsInput {
///     map,
///     name: "map",
///     sha256: String::new(),
///     horizons: horizons.map(|(name, z)| GivenHorizon::flat(name, z)).to_vec(),
/// };
/// let spec = ColumnsSpec { layers: Some("3".parse()?), ..ColumnsSpec::default() };
/// let outcome = atomesh::columns(input, &spec, &mut NoProgress)?;
/// assert_eq!(outcome.mesh.mesh.sites.len(), 3 * outcome.columns);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of [`ColumnsSpec::validate`], and [`Error::Mesh`] for a map that is not made
/// of Voronoi cells, or for horizons between which there are no columns.
pub fn columns(
    input: ColumnsInput<'_>,
    spec: &ColumnsSpec,
    progress: &mut dyn Progress,
) -> Result<ColumnsOutcome> {
    spec.validate()?;
    let (map, space, live) = prepare_map(input.map, input.name)?;
    let torn = match spec.throws {
        Some(distance) => TornMap::torn(&map, distance),
        None => TornMap::whole(&map),
    };
    if spec.throws.is_some() && torn.node_count() == map.nodes.len() {
        progress.note("no fault divides the map: --throws has no effect");
    }
    let placed = place_horizons(input.horizons, &space, spec.z_unit.as_deref())?;
    placed.notes.iter().for_each(|note| progress.note(note));
    let (mut names, mut horizons) = (Vec::new(), Vec::new());
    for (name, horizon) in placed.horizons {
        let values = torn.horizon(&horizon, &name)?;
        if values.missing > 0 {
            progress.note(&format!(
                "{name} is not known at {} of the map's {} nodes: extrapolated smoothly there",
                values.missing,
                torn.node_count()
            ));
        }
        names.push(name);
        horizons.push(values);
    }
    let z = uncrossed(horizons);
    progress.stage(Stage::BuildingColumns);
    let built = extend(&torn, &z, &names, &spec.division(), spec.least_thickness)?;
    let provenance = Provenance {
        parameters: format!("columns = {names:?}"),
        input_sha256: input.sha256,
    };
    let Columns {
        layer_counts,
        missing_counts,
        is_z_up,
        ..
    } = built.clone();
    Ok(ColumnsOutcome {
        columns: map.sites.len(),
        layer_counts,
        missing_counts,
        is_z_up,
        juxtaposed: built.juxtaposed,
        mesh: {
            let cells = MapCells {
                regions: &map.region,
                live: live.as_deref(),
            };
            columns_to_file(built, cells, &space, &placed.z_unit, &provenance)
        },
    })
}

/// Returns z of horizons at torn nodes. Horizons that cross because they were continued to a fault end
/// at the one above.
fn uncrossed(horizons: Vec<TornHorizon>) -> Vec<Vec<f64>> {
    let total = |horizon: &TornHorizon| horizon.z.iter().sum::<f64>();
    let [first, last] = [horizons.first(), horizons.last()].map(|horizon| horizon.map(total));
    let is_z_up = first > last;
    let mut z: Vec<Vec<f64>> = Vec::new();
    for horizon in horizons {
        let mut values = horizon.z;
        if let Some(above) = z.last() {
            let continued = horizon.is_continued.iter().zip(above);
            for (value, (_, &above)) in values.iter_mut().zip(continued).filter(|v| *v.1.0) {
                *value = if is_z_up {
                    value.min(above)
                } else {
                    value.max(above)
                };
            }
        }
        z.push(values);
    }
    z
}

/// The cells of a map, its lattice space, and the share of each cell that holds data.
type PreparedMap = (PolyMesh<2>, LatticeSpace<2>, Option<Vec<f64>>);

/// Returns the cells of a map, its lattice space, and the share of each cell that holds data.
fn prepare_map(map: AnyMesh, name: &str) -> Result<PreparedMap> {
    let problem = match map {
        AnyMesh::Polygons(file) => {
            let live = read_live(&file.cell_data, file.mesh.sites.len());
            let stored = StoredMesh::new(file, name)?;
            let space = stored.space.clone();
            return Ok((stored.into_file().mesh, space, live));
        }
        AnyMesh::Triangles(_) => "has triangles, which make poor columns for flow",
        AnyMesh::Tetrahedra(_) | AnyMesh::Polyhedra(_) => "is not a map but a 3-D mesh",
    };
    let remedy = "mesh a 2-D image of the map with --cells voronoi";
    Err(Error::Mesh(cause(name, problem, remedy)))
}

impl ColumnsOutcome {
    /// Returns the number of cells, columns and layers as a table.
    pub fn table(&self) -> String {
        let layers: Vec<String> = self.layer_counts.iter().map(usize::to_string).collect();
        let direction = if self.is_z_up {
            "upwards"
        } else {
            "downwards: export it with --down z"
        };
        let mut lines = vec![
            format!(
                "cells          {} in {} columns",
                self.mesh.mesh.sites.len(),
                self.columns
            ),
            format!(
                "layers         {} in the intervals, from the top",
                layers.join(", ")
            ),
            format!("z              grows {direction}"),
        ];
        if let Some(faces) = &self.juxtaposed {
            lines.push(format!(
                "at faults      {} faces between cells of one layer, {} between those of two; area {:.6}, \
                 {:.6} beside no cell",
                faces.same_layer, faces.other_layer, faces.area, faces.exposed_area
            ));
        }
        let missing = self.missing_counts.iter().enumerate().filter(|m| *m.1 > 0);
        let missing: Vec<String> = missing
            .map(|(layer, count)| format!("layer {layer} in {count} columns"))
            .collect();
        if !missing.is_empty() {
            lines.push(format!("pinched out    {}", missing.join(", ")));
        }
        lines.join("\n")
    }

    /// Returns these numbers as JSON.
    pub fn to_json(&self) -> Value {
        json!({
            "cells": self.mesh.mesh.sites.len(),
            "columns": self.columns,
            "layers": self.layer_counts,
            "missing": self.missing_counts,
            "z_grows": if self.is_z_up { "upwards" } else { "downwards" },
            "juxtaposed": self.juxtaposed,
        })
    }
}
