//! Extracts surfaces from a mesh as `atomesh surface` does: groups the faces on features and measures
//! the surfaces.

use std::path::Path;

use super::outcome::{InterfaceMeasure, SurfaceOutcome, SurfaceReport};
use super::surface_spec::{GroupBy, SurfaceSpec};
use super::table::doubtful_throw_notes;
use crate::error::cause;
use crate::export::surfaces::survey_grid::SurveyGrid;
use crate::export::surfaces::vtp::read_shapes;
use crate::feature::{self, DetectionOptions};
use crate::files::vtk::DataArray;
use crate::geometry::{norm, normal, unit};
use crate::image::formats;
use crate::image::placing::Frame;
use crate::image::{Geometry, Image};
use crate::mesh::Mesh;
use crate::model::slice::OverlayShape;
use crate::model::surface::amplitude::{AmplitudeMeasures, measure_amplitudes, split_horizons};
use crate::model::surface::earlier_names::{EarlierSurface, match_names};
use crate::model::surface::kind::surface_kinds;
use crate::model::surface::measure::MapAxes;
use crate::model::surface::region_interfaces::{RegionInterface, region_interfaces};
use crate::model::surface::stored_surfaces::{
    group_facets, horizon_facets, named_faces, outer_facets, region_label, tagged_facets,
};
use crate::model::surface::{
    Options, SurfaceKind, SurfaceMeasure, Surfaces, facet_selection, measure,
};
use crate::progress::{Progress, Stage};
use crate::store::input::{ImageInput, MeshInput, mesh_in_depth, read_mesh_image};
use crate::store::with_mesh;
use crate::store::{
    AnyMesh, LabelledRegion, LatticeSpace, MeshFile, Storable, StoredMesh, read_labels,
};
use crate::surface_file::interpretation::{PickedShape, PickedSurface, read_interpretation};
use crate::surface_file::{AnySurfaces, FileOption, SurfaceFile, has_extension};
use crate::{Error, Result};

/// Default depth of the valleys of b(x) from which faces count as lying on features.
const DEFAULT_VALLEY_DEPTH: f64 = 0.6;

/// Smallest cosine of the angle between the normals of a face and of its feature (35 degrees).
const MIN_NORMAL_COSINE: f64 = 0.82;

/// Extracts the surfaces of a mesh, as `atomesh surface` does.
///
/// ```
/// use atomesh::image::synth::{self, SyntheticKind};
/// use atomesh::progress::NoProgress;
/// use atomesh::{MeshSpec, SurfaceSpec};
///
/// let options = synth::Options { dims: [40, 36, 32], ..Default::default() };
/// let image = synth::make(SyntheticKind::Sphere, &options)?.image;
/// let spec = MeshSpec { distance: "6".parse()?, ..MeshSpec::default() };
/// let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
/// let outcome = atomesh::surfaces(mesh, &SurfaceSpec::default(), &mut NoProgress)?;
/// assert!(!outcome.is_empty());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of [`SurfaceSpec::validate`], those of reading the image, and
/// [`Error::Mesh`] for a mesh without faces on features.
pub fn surfaces<'a>(
    mesh: impl Into<MeshInput<'a>>,
    spec: &SurfaceSpec,
    progress: &mut dyn Progress,
) -> Result<SurfaceOutcome> {
    spec.validate()?;
    let input = mesh.into();
    let (name, read_image) = (input.name, input.read_image);
    let extraction = Extraction {
        spec,
        name,
        read_image,
        progress,
    };
    with_mesh!(input.mesh, file => extraction.run(file))
}

/// The options and the progress of an extraction.
struct Extraction<'a> {
    spec: &'a SurfaceSpec,
    /// The name of the mesh in messages.
    name: &'a str,
    read_image: formats::ReadImage<'a>,
    progress: &'a mut dyn Progress,
}

impl Extraction<'_> {
    fn run<const D: usize, M: Storable<D>>(mut self, file: MeshFile<M>) -> Result<SurfaceOutcome>
    where
        MeshFile<M>: Into<AnyMesh>,
        SurfaceFile<D>: Into<AnySurfaces>,
    {
        let spec = self.spec;
        let options = spec.grouping.options(spec.min_area)?;
        let up = spec.grouping.up_direction::<D>()?;
        let distance = min_distance(&file);
        let labels = read_labels(&file);
        let velocity = spec.velocity.as_ref();
        let original = spec.mesh_out.is_some().then(|| file.clone());
        let mut stored = mesh_in_depth(file, velocity, self.name, self.read_image, self.progress)?;
        let z_up = spec.grouping.is_z_up(&stored.space.geometry);
        if spec.by == GroupBy::Regions {
            let (file, measures) = extract_interfaces(&stored, &labels, self.name)?;
            return Ok(SurfaceOutcome {
                surfaces: file.with_space(&stored.space.geometry, z_up).into(),
                report: SurfaceReport::Regions(measures),
                survey: None,
                mesh: None,
            });
        }
        // All other arrays are no longer needed, except for regions that are labels.
        if labels.is_empty() {
            stored.arrays = MeshFile::default();
        }
        let facets = match &spec.image {
            None => tagged_facets(&stored, self.name)?,
            Some(path) => self.facets_on_image(path, &stored, distance)?,
        };
        self.progress.stage(Stage::GroupingFaces);
        let geometry = &stored.space.geometry;
        let up = up.with_units(&geometry.units);
        if !up.has_dip {
            let note = mixed_units_note(geometry, &up);
            self.progress.note(&note);
        }
        let (survey_grid, image) = self.survey(&stored.space)?.unzip();
        let image = image.as_ref();
        let survey = image.map(|image| Survey {
            image,
            min_confidence: spec.min_confidence,
        });
        let groups = measured_groups(&stored, facets, &options, &up, z_up, survey);
        if let Some(note) = &groups.doubtful {
            self.progress.note(note);
        }
        let (surfaces, mut measures, mut file) = (groups.surfaces, groups.measures, groups.file);
        if let Some(image) = image {
            if are_horizons_upright(&measures, &up.up) {
                self.progress
                    .note("the horizons stand upright, so that throws make no sense: --up names another axis");
            }
            let kinds: Vec<SurfaceKind> = measures.iter().map(|m| m.kind).collect();
            let nodes = nodes_in_samples(&stored);
            let amplitudes = measure_amplitudes(&surfaces, &kinds, &nodes, image, geometry, up.up);
            file.cell_data.extend(amplitude_arrays(&amplitudes));
            for (measure, amplitudes) in measures.iter_mut().zip(amplitudes.surfaces) {
                measure.amplitudes = Some(amplitudes);
            }
        }
        if let Some(earlier) = &spec.names_from {
            let nodes = nodes_in_samples(&stored);
            self.names_from(earlier, &surfaces, &mut measures, &nodes, &stored.space)?;
            file.names = measures.iter().map(surface_name).collect();
        }
        for note in doubtful_throw_notes(&measures) {
            self.progress.note(&note);
        }
        let mesh = original.map(|mut original| {
            let named = named_faces(&stored, &surfaces, &file.names);
            named.replace_in(&mut original.field_data);
            original.into()
        });
        Ok(SurfaceOutcome {
            surfaces: file.into(),
            report: SurfaceReport::Bends {
                measures,
                dropped_count: surfaces.dropped_count,
                dropped_area: surfaces.dropped_area,
                dropped_share: surfaces.dropped_share(stored.lattice.nodes()),
            },
            survey: survey_grid.flatten(),
            mesh,
        })
    }

    /// Reads the image of amplitudes, if the options name one. Returns the grid of its lines, and the image.
    fn survey<const D: usize>(
        &mut self,
        space: &LatticeSpace<D>,
    ) -> Result<Option<(Option<SurveyGrid>, Image<D>)>> {
        let Some(path) = &self.spec.survey else {
            return Ok(None);
        };
        let input = ImageInput {
            image: (self.read_image)(path, &self.spec.input)?,
            name: &path.display().to_string(),
            sha256: None,
        };
        let grid = SurveyGrid::new(&input.image);
        Ok(Some((grid, input.fitting(space)?)))
    }

    /// Names surfaces by those of an earlier interpretation.
    fn names_from<const D: usize>(
        &mut self,
        file: &FileOption,
        surfaces: &Surfaces<D>,
        measures: &mut [SurfaceMeasure],
        nodes: &[[f64; D]],
        space: &LatticeSpace<D>,
    ) -> Result<()> {
        let dims = space.dims().map(|n| n.round() as usize);
        let (earlier, notes) = read_earlier_surfaces(file, &space.geometry, dims)?;
        notes.iter().for_each(|note| self.progress.note(note));
        let kinds: Vec<SurfaceKind> = measures.iter().map(|m| m.kind).collect();
        let matched = match_names(surfaces, &kinds, nodes, &surfaces.names, &earlier);
        let place = file.path.display();
        if matched.matched_count == 0 && surfaces.len() > surfaces.names.len() {
            self.progress.note(&format!(
                "names-from {place}: none of its surfaces lies near one of this mesh; check that both \
                 have the same coordinates, and the same sign of z"
            ));
        } else {
            self.progress.note(&format!(
                "names-from {place}: {} of {} surfaces have a name of its {}",
                matched.matched_count,
                surfaces.len() - surfaces.names.len(),
                earlier.len()
            ));
        }
        for (measure, name) in measures.iter_mut().zip(matched.names) {
            measure.name = Some(name);
        }
        Ok(())
    }

    /// Returns the facets on the features of the image at `path`.
    fn facets_on_image<const D: usize, M: Mesh<D>>(
        &mut self,
        path: &Path,
        stored: &StoredMesh<D, M>,
        distance: Option<f64>,
    ) -> Result<Vec<[u32; D]>> {
        self.progress.stage(Stage::Features);
        let spec = self.spec;
        let image = read_mesh_image(path, &spec.input, &stored.space, self.read_image)?;
        let options = DetectionOptions {
            d_min: distance.unwrap_or_else(|| mean_spacing(&stored.lattice)),
            ..spec.detection().detection_options(stored.space.step)?
        };
        let features = feature::detect(&image, &options)?;
        features
            .notes
            .iter()
            .for_each(|note| self.progress.note(note));
        let (b, sigma) = (&features.potential, features.sigma);
        let depth = spec.depth.unwrap_or(DEFAULT_VALLEY_DEPTH);
        let facets =
            facet_selection::valley_facets(&stored.lattice, b, sigma, depth, MIN_NORMAL_COSINE);
        if facets.is_empty() {
            let cause = cause(
                self.name,
                format!("has no face on a feature of {}", path.display()),
                "give the image that was meshed, or a smaller depth of valleys",
            );
            return Err(Error::Mesh(cause.with_parameter("depth")));
        }
        Ok(facets)
    }
}

/// Reads the surfaces of an earlier interpretation, in samples of an image of `dims` samples. Also
/// returns notes on their coordinates.
fn read_earlier_surfaces<const D: usize>(
    file: &FileOption,
    geometry: &Geometry<D>,
    dims: [usize; D],
) -> Result<(Vec<EarlierSurface<D>>, Vec<String>)> {
    let path = &file.path;
    let mut notes = Vec::new();
    let surfaces: Vec<(String, Vec<Vec<[f64; 3]>>)> = if D == 2 && has_extension(path, &["vtp"]) {
        let of_shape = |shape: OverlayShape| {
            let lines = shape.lines.iter().flat_map(|line| line.windows(2));
            (shape.name, lines.map(<[_]>::to_vec).collect())
        };
        read_shapes(path)?.into_iter().map(of_shape).collect()
    } else {
        let frame = Frame::new(geometry, dims);
        let place = format!("names-from {}", path.display());
        let mut of_picks = |surface: PickedSurface| {
            let placed = surface.placed(&frame, &place, &file.coordinates)?;
            notes.push(format!(
                "{place}: {}: {}",
                surface.name,
                placed.notes.join(", ")
            ));
            let simplices = match placed.shape {
                PickedShape::Triangles(triangles) => {
                    triangles.iter().map(|triangle| triangle.to_vec()).collect()
                }
                shape => shape.points().map(|x| vec![x]).collect(),
            };
            Ok((surface.name, simplices))
        };
        let is_meant =
            |surface: &PickedSurface| (file.name.as_ref()).is_none_or(|name| *name == surface.name);
        let read = read_interpretation(path)?.into_iter().filter(is_meant);
        read.map(&mut of_picks).collect::<Result<_>>()?
    };
    let in_samples = |x: &[f64; 3]| geometry.to_index(std::array::from_fn(|k| x[k]));
    let is_finite = |simplex: &Vec<[f64; D]>| simplex.as_flattened().iter().all(|c| c.is_finite());
    let of_surface = |(name, simplices): (String, Vec<Vec<[f64; 3]>>)| EarlierSurface {
        name,
        simplices: (simplices.iter())
            .filter_map(|simplex| simplex.iter().map(in_samples).collect())
            .filter(is_finite)
            .collect(),
    };
    Ok((surfaces.into_iter().map(of_surface).collect(), notes))
}

/// Returns the smallest nominal distance between nodes, if the mesh records it.
fn min_distance<M>(file: &MeshFile<M>) -> Option<f64> {
    let mut arrays = file.point_data.iter().chain(&file.cell_data);
    let array = arrays.find(|a| a.name == "distance")?;
    let distances = array.values.to_f64().into_iter();
    let min = distances.fold(f64::INFINITY, f64::min);
    (min.is_finite() && min > 0.0).then_some(min)
}

/// Returns the mean spacing of nodes: the D-th root of the volume per node.
fn mean_spacing<const D: usize, M: Mesh<D>>(mesh: &M) -> f64 {
    let volume: f64 = mesh.volumes().iter().sum();
    (volume / mesh.nodes().len() as f64).powf(1.0 / D as f64)
}

/// The image of amplitudes in which surfaces are measured.
#[derive(Clone, Copy)]
struct Survey<'a, const D: usize> {
    image: &'a Image<D>,
    /// Confidence below which surfaces are dropped.
    min_confidence: Option<f64>,
}

/// The surfaces of a mesh, with their measures and as a file.
struct SurfaceGroups<const D: usize> {
    surfaces: Surfaces<D>,
    measures: Vec<SurfaceMeasure>,
    file: SurfaceFile<D>,
    /// Note on the surfaces that were dropped because of their confidence.
    doubtful: Option<String>,
}

/// Groups facets of a mesh into surfaces and measures them. `up` is the direction that is up; `z_up`
/// is `true` if z grows upwards. With the `survey`, horizons stay on their reflectors.
fn measured_groups<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    facets: Vec<[u32; D]>,
    options: &Options,
    up: &MapAxes<D>,
    z_up: bool,
    survey: Option<Survey<'_, D>>,
) -> SurfaceGroups<D> {
    let mut surfaces = group_facets(stored, facets, options);
    let nodes = stored.world.nodes.as_slice();
    let geometry = &stored.space.geometry;
    let (mut doubtful, horizons) = (None, horizon_facets(stored));
    if let Some(Survey { image, .. }) = survey {
        let kinds = surface_kinds(&surfaces, nodes, &horizons);
        let samples = nodes_in_samples(stored);
        split_horizons(&mut surfaces, &kinds, &samples, image, geometry, up.up);
    }
    surfaces.orient(nodes, up.up);
    orient_interfaces(stored, &mut surfaces);
    if let Some((Survey { image, .. }, min)) = survey.and_then(|s| s.min_confidence.map(|c| (s, c)))
    {
        let kinds = surface_kinds(&surfaces, nodes, &horizons);
        let samples = nodes_in_samples(stored);
        let amplitudes = measure_amplitudes(&surfaces, &kinds, &samples, image, geometry, up.up);
        let confidences = amplitudes.surfaces.iter().map(|m| m.confidence);
        doubtful = drop_doubtful(&mut surfaces, &kinds, &confidences.collect::<Vec<_>>(), min);
    }
    let up = &up.with_geometry(geometry);
    let measures = measure(&surfaces, nodes, up, &horizons);
    let mut file = SurfaceFile::new(nodes, &surfaces.facets, &surfaces.start, "surface");
    file.names = measures.iter().map(surface_name).collect();
    file.cell_data = cell_data(&surfaces, &measures, nodes);
    SurfaceGroups {
        surfaces,
        measures,
        file: file.with_space(geometry, z_up),
        doubtful,
    }
}

/// Directs the interfaces between two labels as [`region_interfaces`] does: outwards from the region
/// that they enclose, or else from the region with the smaller number.
fn orient_interfaces<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    surfaces: &mut Surfaces<D>,
) {
    let Some(regions) = stored.regions().filter(|_| !surfaces.interfaces.is_empty()) else {
        return;
    };
    let (nodes, is_mirrored) = (stored.world.nodes.as_slice(), stored.space.is_mirrored());
    // A mesh with a face of three cells is refused elsewhere.
    let interfaces = region_interfaces(&stored.lattice, &regions, nodes, is_mirrored);
    let sorted = |mut facet: [u32; D]| {
        facet.sort_unstable();
        facet
    };
    let facets = interfaces.unwrap_or_default().into_iter();
    let mut directed: Vec<([u32; D], [u32; D])> = (facets.flat_map(|between| between.facets))
        .map(|facet| (sorted(facet), facet))
        .collect();
    directed.sort_unstable();
    for s in surfaces.interfaces.clone() {
        for facet in &mut surfaces.facets[surfaces.start[s]..surfaces.start[s + 1]] {
            let key = sorted(*facet);
            if let Ok(index) = directed.binary_search_by(|entry| entry.0.cmp(&key)) {
                *facet = directed[index].1;
            }
        }
    }
}

/// Drops the surfaces whose confidence is below `min`; those without one stay. Returns a note on them.
fn drop_doubtful<const D: usize>(
    surfaces: &mut Surfaces<D>,
    kinds: &[SurfaceKind],
    confidences: &[Option<f64>],
    min: f64,
) -> Option<String> {
    let is_doubtful: Vec<bool> = (confidences.iter())
        .map(|confidence| confidence.is_some_and(|c| c < min))
        .collect();
    let doubtful = (0..surfaces.len()).filter(|&s| is_doubtful[s]);
    let dropped: Vec<String> = doubtful
        .map(|s| {
            let kind = kinds[s].name();
            let name = surfaces.names.get(s).map_or(kind, String::as_str);
            format!("{name} ({:.1})", confidences[s].unwrap_or_default())
        })
        .collect();
    if dropped.is_empty() {
        return None;
    }
    surfaces.remove(&is_doubtful);
    Some(format!(
        "{} of {} surfaces have a confidence below {min} and are omitted: {}",
        dropped.len(),
        kinds.len(),
        dropped.join(", ")
    ))
}

/// Returns the surfaces of the faces on features with default options. A mesh without features has
/// none.
///
/// # Errors
/// Returns no error with default options.
pub(crate) fn default_surfaces<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
) -> Result<SurfaceFile<D>> {
    let grouping = crate::model::surface::GroupingOptions::default();
    let up = grouping.up_direction::<D>()?;
    let z_up = grouping.is_z_up(&stored.space.geometry);
    let up = up.with_units(&stored.space.geometry.units);
    let marks = stored.feature_marks().unwrap_or_default();
    let facets = if marks.is_empty() {
        Vec::new()
    } else {
        facet_selection::marked_facets(&stored.lattice, &marks)
    };
    let options = grouping.options(None)?;
    Ok(measured_groups(stored, facets, &options, &up, z_up, None).file)
}

/// Returns the name of a surface in files.
pub(super) fn surface_name(measure: &SurfaceMeasure) -> String {
    let name = measure.name.clone();
    name.unwrap_or_else(|| format!("{}{}", measure.kind.name(), measure.surface))
}

/// Returns the note that says why dips are missing.
fn mixed_units_note<const D: usize>(geometry: &Geometry<D>, up: &MapAxes<D>) -> String {
    let unit_name = |unit: &String| match unit.as_str() {
        "" => "no unit".to_string(),
        unit => unit.to_string(),
    };
    let missing = if up.has_strike {
        "no dip"
    } else {
        "neither dip nor strike"
    };
    format!(
        "axes of different units ({}): {missing}; area, off plane and rim mix them{}",
        (geometry.units.iter().map(unit_name))
            .collect::<Vec<_>>()
            .join(", "),
        if geometry.time_coordinate().is_some() {
            "; --velocity converts time to depth"
        } else {
            ""
        }
    )
}

/// Returns arrays with the normal of each face, and with the measures of the surface that it
/// belongs to.
fn cell_data<const D: usize>(
    surfaces: &Surfaces<D>,
    measures: &[SurfaceMeasure],
    nodes: &[[f64; D]],
) -> Vec<DataArray> {
    let labels = surfaces.labels();
    let per_face = |value: &dyn Fn(&SurfaceMeasure) -> f64| -> Vec<f32> {
        labels
            .iter()
            .map(|&s| value(&measures[s as usize]) as f32)
            .collect()
    };
    let normal = |facet: &[u32; D]| {
        let n = unit(normal(&facet.map(|i| nodes[i as usize])));
        [0, 1, 2].map(|k| n.get(k).copied().unwrap_or(0.0) as f32)
    };
    let horizon = |&s: &u32| u8::from(measures[s as usize].kind == SurfaceKind::Horizon);
    vec![
        DataArray {
            name: "normal".into(),
            components: 3,
            values: surfaces
                .facets
                .iter()
                .flat_map(normal)
                .collect::<Vec<f32>>()
                .into(),
        },
        DataArray::scalars("dip", per_face(&|m| m.dip.unwrap_or(f64::NAN))),
        DataArray::scalars("strike", per_face(&|m| m.strike.unwrap_or(f64::NAN))),
        DataArray::scalars(
            if D == 2 { "length" } else { "area" },
            per_face(&|m| m.area),
        ),
        DataArray::scalars("horizon", labels.iter().map(horizon).collect::<Vec<u8>>()),
    ]
}

/// Returns the nodes of a mesh in samples.
fn nodes_in_samples<const D: usize, M: Mesh<D>>(stored: &StoredMesh<D, M>) -> Vec<[f64; D]> {
    let step = stored.space.step;
    let in_samples = |x: &[f64; D]| std::array::from_fn(|k| x[k] / step[k]);
    stored.lattice.nodes().iter().map(in_samples).collect()
}

/// Returns `true` if horizons dip by more than 60 degrees on average.
fn are_horizons_upright(measures: &[SurfaceMeasure], up: &[f64]) -> bool {
    let horizons = (measures.iter()).filter(|m| m.kind == SurfaceKind::Horizon);
    let cosine = |m: &SurfaceMeasure| m.normal.iter().zip(up).map(|(n, u)| n * u).sum::<f64>();
    let (sum, area) = horizons.fold((0.0, 0.0), |(sum, area), m| {
        (sum + m.area * cosine(m).abs(), area + m.area)
    });
    area > 0.0 && sum < 0.5 * area
}

/// Returns arrays with the measures of each face in an image of amplitudes.
fn amplitude_arrays(measures: &AmplitudeMeasures) -> [DataArray; 5] {
    [
        DataArray::scalars("throw", measures.throws.clone()),
        DataArray::scalars("throw_by_horizons", measures.horizon_throws.clone()),
        DataArray::scalars("throw_correlation", measures.correlations.clone()),
        DataArray::scalars("amplitude", measures.amplitudes.clone()),
        DataArray::scalars("confidence", measures.confidences.clone()),
    ]
}

/// Separates the boundaries at which regions were left out from the sides of the mesh. Also returns the
/// names of these boundaries.
fn split_at_boundaries<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    interfaces: Vec<RegionInterface<D>>,
) -> (Vec<RegionInterface<D>>, Vec<Option<String>>) {
    let names = stored.outer.as_ref().map_or(&[][..], |outer| &outer.names);
    let known = outer_facets(stored);
    let nodes = stored.world.nodes.as_slice();
    let area = |facet: &[u32; D]| norm(normal(&facet.map(|n| nodes[n as usize])));
    let set_of = |facet: &[u32; D]| {
        let mut sorted = *facet;
        sorted.sort_unstable();
        let found = known.binary_search_by(|entry| entry.0.cmp(&sorted));
        found.ok().map(|index| known[index].1)
    };
    let (mut split, mut boundaries) = (Vec::new(), Vec::new());
    for interface in interfaces {
        if interface.outer_region.is_some() || known.is_empty() {
            split.push(interface);
            boundaries.push(None);
            continue;
        }
        let mut facets: Vec<(Option<u32>, [u32; D])> = (interface.facets.iter())
            .map(|facet| (set_of(facet), *facet))
            .collect();
        facets.sort_by_key(|(set, _)| *set);
        for same_set in facets.chunk_by(|a, b| a.0 == b.0) {
            let facets: Vec<[u32; D]> = same_set.iter().map(|entry| entry.1).collect();
            boundaries.push(same_set[0].0.map(|set| names[set as usize].clone()));
            split.push(RegionInterface {
                area: facets.iter().map(area).sum(),
                facets,
                ..interface
            });
        }
    }
    (split, boundaries)
}

/// Returns the interfaces between every two regions of a mesh, and their measures.
fn extract_interfaces<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    labels: &[LabelledRegion],
    place: &str,
) -> Result<(SurfaceFile<D>, Vec<InterfaceMeasure>)> {
    let regions = stored.regions().unwrap_or_default();
    let is_part = stored.outer.is_some();
    if !is_part && regions.iter().all(|region| *region == regions[0]) {
        return Err(Error::Mesh(cause(
            place,
            "has only one region",
            "mesh an image of labels, or paint the mesh",
        )));
    }
    let nodes = stored.world.nodes.as_slice();
    let is_mirrored = stored.space.is_mirrored();
    let interfaces = region_interfaces(&stored.lattice, &regions, nodes, is_mirrored)?;
    let (interfaces, boundaries) = split_at_boundaries(stored, interfaces);
    let named = |region: i32| (region, region_label(labels, region));
    let measures: Vec<InterfaceMeasure> = interfaces
        .iter()
        .zip(boundaries)
        .map(|(between, boundary)| InterfaceMeasure {
            inner: named(between.inner_region),
            outer: between.outer_region.map(named),
            boundary,
            faces: between.facets.len(),
            area: between.area,
        })
        .collect();
    let mut start = vec![0];
    let mut facets = Vec::new();
    for between in &interfaces {
        facets.extend_from_slice(&between.facets);
        start.push(facets.len());
    }
    let mut file = SurfaceFile::new(nodes, &facets, &start, "surface");
    file.names = measures.iter().map(InterfaceMeasure::file_name).collect();
    let per_facet = |value: &dyn Fn(&RegionInterface<D>) -> i32| -> Vec<i32> {
        let faces = interfaces.iter();
        faces
            .flat_map(|b| std::iter::repeat_n(value(b), b.facets.len()))
            .collect()
    };
    let on_side = per_facet(&|b| i32::from(b.outer_region.is_none()));
    file.cell_data = vec![
        DataArray::scalars("inside", per_facet(&|b| b.inner_region)),
        DataArray::scalars(
            "outside",
            per_facet(&|b| b.outer_region.unwrap_or(b.inner_region)),
        ),
        DataArray::scalars(
            "on_side",
            on_side.iter().map(|&o| o as u8).collect::<Vec<u8>>(),
        ),
    ];
    Ok((file, measures))
}
