//! Paints a mesh as `atomesh paint` does.

use serde::Serialize;
use serde_json::{Value, json};

use super::paint_graph::{PaintCache, PaintGraph};
use super::paint_spec::{PaintSeed, PaintSpec, Seeds};
use super::{contrast_factors, grow};
use crate::error::cause;
use crate::files::output::path_text;
use crate::image::ScalarField;
use crate::image::formats::ReadImage;
use crate::mesh::Mesh;
use crate::model::geodesics::GeodesicSource;
use crate::model::surface::adjacency::{CellAdjacency, enclosing_facets};
use crate::model::surface::kind::surface_kinds;
use crate::model::surface::stored_surfaces::{group_facets, horizon_facets, tagged_facets};
use crate::model::surface::{AnySurfaces, SurfaceFile, SurfaceKind};
use crate::progress::{Progress, Stage};
use crate::store::input::{MeshInput, read_mesh_image};
use crate::store::with_mesh;
use crate::store::{AnyMesh, LatticeSpace, MeshFile, Storable, StoredMesh};
use crate::{Error, Result};

/// A painted mesh.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PaintOutcome {
    /// The mesh, with the painted regions as cell data `region` (0: not painted).
    pub mesh: AnyMesh,
    /// The regions that have cells.
    pub regions: Vec<PaintedRegion>,
    /// The number of blocks between surfaces.
    pub blocks: usize,
    /// The surfaces around the painted regions, if the options ask for them.
    pub surfaces: Option<AnySurfaces>,
}

/// One painted region.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PaintedRegion {
    /// The number of the region, from 1.
    pub region: u32,
    /// The number of its cells.
    pub cells: usize,
    /// Their volume, in the plane their area.
    pub volume: f64,
    /// The fraction of the volume of the mesh.
    pub share: f64,
}

impl PaintOutcome {
    /// Writes the files beside the mesh that the options name: the surfaces around the regions.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if a file cannot be written.
    pub fn write_others(&self, spec: &PaintSpec) -> Result<()> {
        match (&spec.surface_out, &self.surfaces) {
            (Some(path), Some(surfaces)) => surfaces.write(path),
            _ => Ok(()),
        }
    }

    /// Returns the regions, the number of blocks and the names of the files as JSON.
    pub fn to_json(&self, spec: &PaintSpec) -> Value {
        json!({
            "surface": spec.surface_out.as_deref().map(path_text),
            "blocks": self.blocks,
            "regions": self.regions,
        })
    }

    /// Returns the regions as a table.
    pub fn table(&self) -> String {
        let volume = match self.mesh {
            AnyMesh::Triangles(_) | AnyMesh::Polygons(_) => "area",
            AnyMesh::Tetrahedra(_) | AnyMesh::Polyhedra(_) => "volume",
        };
        let (region, cells, share) = ("region", "cells", "share");
        let mut lines = vec![format!("{region:>6} {cells:>9} {volume:>13} {share:>7}")];
        lines.extend(self.regions.iter().map(|r| {
            let share = 100.0 * r.share;
            format!(
                "{:>6} {:>9} {:>13.6e} {share:>6.2}%",
                r.region, r.cells, r.volume
            )
        }));
        lines.join("\n")
    }
}

/// Paints cells from seeds, within layers but not across surfaces, as `atomesh paint` does.
///
/// ```
/// use atomesh::image::synth::{self, SyntheticKind};
/// use atomesh::progress::NoProgress;
/// use atomesh::{MeshSpec, PaintSpec};
///
/// let options = synth::Options { dims: [40, 36, 32], ..Default::default() };
/// let image = synth::make(SyntheticKind::Sphere, &options)?.image;
/// let spec = MeshSpec { distance: "6".parse()?, ..MeshSpec::default() };
/// let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
/// let outcome = atomesh::paint(mesh, &PaintSpec::default(), &mut NoProgress)?;
/// let painted: f64 = outcome.regions.iter().map(|region| region.share).sum();
/// assert!((painted - 1.0).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of [`PaintSpec::validate`], those of reading the image, and [`Error::Job`] for
/// a seed outside the mesh.
pub fn paint<'a>(
    mesh: impl Into<MeshInput<'a>>,
    spec: &PaintSpec,
    progress: &mut dyn Progress,
) -> Result<PaintOutcome> {
    paint_with_cache(mesh, spec, None, progress)
}

/// Paints cells as [`paint`] does. With a cache, the graph of the cells stays in memory until another
/// mesh is painted.
///
/// # Errors
/// Returns the errors of [`paint`].
pub fn paint_with_cache<'a>(
    mesh: impl Into<MeshInput<'a>>,
    spec: &PaintSpec,
    cache: Option<&PaintCache>,
    progress: &mut dyn Progress,
) -> Result<PaintOutcome> {
    spec.validate()?;
    let MeshInput {
        mesh,
        name,
        read_image,
    } = mesh.into();
    let run = PaintRun {
        spec,
        name,
        read_image,
        cache,
        progress,
    };
    with_mesh!(mesh, file => run.paint(file))
}

/// The options and the progress of a computation.
struct PaintRun<'a> {
    spec: &'a PaintSpec,
    /// The name of the mesh in messages.
    name: &'a str,
    read_image: ReadImage<'a>,
    cache: Option<&'a PaintCache>,
    progress: &'a mut dyn Progress,
}

impl PaintRun<'_> {
    fn paint<const D: usize, M>(self, file: MeshFile<M>) -> Result<PaintOutcome>
    where
        M: Storable<D> + Clone + PartialEq + Send + Sync + 'static,
        MeshFile<M>: Into<AnyMesh>,
        SurfaceFile<D>: Into<AnySurfaces>,
    {
        let spec = self.spec;
        let seeds = spec.seeds::<D>()?;
        let options = spec.grouping.options(Some(0.0))?;
        spec.grouping.up_direction::<D>()?;
        let stored = StoredMesh::new(file, self.name)?;
        let z_up = spec.grouping.is_z_up(&stored.space.geometry);
        let tagged = tagged_facets(&stored, self.name)?;
        let surfaces = group_facets(&stored, tagged, &options);
        let mut closed = if spec.seed.contains(&PaintSeed::Blocks) {
            let horizons = horizon_facets(&stored);
            let kinds = surface_kinds(&surfaces, stored.lattice.nodes(), &horizons);
            let faults = (0..surfaces.len()).filter(|&s| kinds[s] != SurfaceKind::Horizon);
            faults
                .flat_map(|s| surfaces.facets_of(s).to_vec())
                .collect()
        } else {
            surfaces.facets
        };
        closed.iter_mut().for_each(|facet| facet.sort_unstable());
        closed.sort_unstable();

        self.progress.stage(Stage::Painting);
        let graph = &*PaintGraph::get(&stored.lattice, closed, spec.neck, self.cache)?;
        let space = stored.space.clone();
        let regions: Vec<u32> = match seeds {
            None => graph.block.iter().map(|b| b + 1).collect(),
            Some(seeds) => {
                let sources = self.sources(&seeds, &stored, graph)?;
                let geodesics = &graph.geodesics;
                let contrast = self.contrast(&space, geodesics.cells())?;
                let level = spec.level.unwrap_or(f64::INFINITY);
                let painted = grow(
                    geodesics,
                    &graph.block,
                    contrast.as_deref(),
                    &sources,
                    level,
                );
                let label = |label: Option<u32>| label.unwrap_or(0);
                painted.label.into_iter().map(label).collect()
            }
        };
        let mut file = stored.into_file();
        M::set_regions(&mut file, regions.iter().map(|&r| r as i32).collect());
        let painted = totals(&file.mesh, &regions);
        let surfaces = match &spec.surface_out {
            Some(_) => Some(enclosing_surfaces(&file.mesh, &regions, &painted)?),
            None => None,
        };
        Ok(PaintOutcome {
            mesh: file.into(),
            regions: painted,
            blocks: graph.block_count,
            surfaces: surfaces.map(|s| s.with_space(&space.geometry, z_up).into()),
        })
    }

    /// Returns the seeds as sources in cells of the mesh.
    fn sources<const D: usize, M: Storable<D>>(
        &self,
        seeds: &Seeds<D>,
        stored: &StoredMesh<D, M>,
        graph: &PaintGraph<D, M>,
    ) -> Result<Vec<GeodesicSource<D>>> {
        (seeds.iter().zip(&self.spec.seed))
            .map(|(&(p, label), seed)| {
                let position = stored.space.to_lattice(p);
                let located = position.and_then(|position| {
                    let (mesh, faces) = (&stored.lattice, &graph.face_cells);
                    Some((position, graph.locator.find(mesh, faces, position)?))
                });
                let (position, cell) = located.ok_or_else(|| {
                    let remedy = "give physical coordinates; atomesh info shows their range";
                    let place = format!("seed {seed}");
                    Error::Job(cause(place, "lies outside the mesh", remedy))
                })?;
                Ok(GeodesicSource {
                    position,
                    cell,
                    label,
                })
            })
            .collect()
    }

    /// Returns for each link the factor by which the image slows paint, if an image is given.
    fn contrast<const D: usize>(
        &self,
        space: &LatticeSpace<D>,
        cells: &CellAdjacency<D>,
    ) -> Result<Option<Vec<f64>>> {
        let Some(path) = &self.spec.image else {
            return Ok(None);
        };
        let image = read_mesh_image(path, &self.spec.input, space, self.read_image)?;
        let field = ScalarField {
            dims: image.dims(),
            step: space.step,
            samples: image.as_slice().to_vec(),
        };
        let values: Vec<f64> = cells.centres.iter().map(|&x| field.value(x)).collect();
        Ok(Some(contrast_factors(cells, &values)))
    }
}

/// Returns the surfaces around the painted regions of a mesh in physical coordinates.
fn enclosing_surfaces<const D: usize, M: Mesh<D>>(
    mesh: &M,
    regions: &[u32],
    painted: &[PaintedRegion],
) -> Result<SurfaceFile<D>> {
    // If the geometry mirrors the lattice, faces have other numbers in physical coordinates.
    let face_cells = mesh.cells_of_faces()?;
    let (mut facets, mut start) = (Vec::new(), vec![0]);
    for painted in painted {
        facets.extend(enclosing_facets(mesh, &face_cells, regions, painted.region));
        start.push(facets.len());
    }
    let mut surfaces = SurfaceFile::new(mesh.nodes(), &facets, &start, "region");
    surfaces.names = (painted.iter().map(|r| format!("region{}", r.region))).collect();
    Ok(surfaces)
}

/// Returns the number of cells, the volume and the fraction of the total volume of each region that
/// has cells, except for region 0, which is unpainted.
fn totals<const D: usize, M: Mesh<D>>(mesh: &M, regions: &[u32]) -> Vec<PaintedRegion> {
    let max_region = regions.iter().copied().max().unwrap_or(0) as usize;
    let mut sums = vec![(0, 0.0); max_region + 1];
    let mut total = 0.0;
    for (volume, &region) in mesh.volumes().iter().zip(regions) {
        sums[region as usize].0 += 1;
        sums[region as usize].1 += volume;
        total += volume;
    }
    let numbered = (0..).zip(sums).skip(1).filter(|(_, sum)| sum.0 > 0);
    numbered
        .map(|(region, (cells, volume))| PaintedRegion {
            region,
            cells,
            volume,
            share: volume / total,
        })
        .collect()
}
