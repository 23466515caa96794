//! Measures the quality and the fidelity of a mesh, as `atomesh quality` does.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::cause;
use crate::feature::FeatureKind;
use crate::feature::components::Components;
use crate::feature::detectors::labels::absorb_parts_below;
use crate::feature::label_map::{self, LabelOptions, merge_labels};
use crate::files::output::check_output;
use crate::image::formats::{InputOptions, ReadImage};
use crate::image::synth::Truth;
use crate::image::{Geometry, Image, LabelTable, LabelValue};
use crate::job::cell_choice::outside_options;
use crate::job::cover::{self, Cover};
use crate::job::output::geometry_of_other_shapes;
use crate::job::simplices::cell_neighbours;
use crate::job::{cells, scaled_mesh, write_lines};
use crate::mesh::Simplices;
use crate::mesh::check::check_with_hints;
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;
use crate::mesh_file::array_names::DISTANCE_ARRAY;
use crate::mesh_file::{CellChoice, KnownRegion, RegionNames};
use crate::progress::{CancelToken, Progress, Stage};
use crate::report::angles::mean_edge_lengths;
use crate::report::certificate::{CertifiedImage, LabelledCells, certify, dropped_parts};
use crate::report::{self, AngleAssessment, Certificate, Quality, Reference, Report};
use crate::store::MeshInput;
use crate::store::input::{ImageInput, image_part, read_mesh_image};
use crate::store::{FieldValue, LatticeSpace, MeshFile, Storable, StoredMesh, with_mesh};
use crate::{Error, Result};

/// Options of `atomesh quality`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct QualitySpec {
    /// The exact distance to the features, as `synth --truth` writes it
    #[arg(long, value_name = "DIST.npy")]
    pub truth: Option<PathBuf>,
    /// The image of labels that was meshed: also compare the mesh with each connected part of its labels,
    /// sample by sample
    #[arg(long, value_name = "IMAGE")]
    pub labels: Option<PathBuf>,
    /// Also write the lines where features, or a feature and a side of the box, meet at less than
    /// 30 degrees, with their angles
    #[arg(long, value_name = "LINES.vtp")]
    pub lines: Option<PathBuf>,
    /// Options for reading the image of labels; those that are not given are those of the mesh.
    #[command(flatten, next_help_heading = "Reading the image of --labels")]
    pub input: InputOptions,
}

impl QualitySpec {
    /// Checks that the output replaces no input.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option.
    pub fn check_files(&self, mesh: &Path) -> Result<()> {
        let mut inputs = vec![mesh];
        inputs.extend(self.truth.as_deref());
        inputs.extend(self.labels.as_deref());
        match &self.lines {
            Some(path) => check_output(path, "--lines", &["vtp"], &inputs),
            None => Ok(()),
        }
    }
}

/// Measures the quality of a mesh, and with the option `truth` its fidelity, as `atomesh quality`
/// does. Also writes the lines of the option `lines`.
///
/// ```
/// use atomesh::image::{Geometry, Image};
/// use atomesh::progress::NoProgress;
/// use atomesh::{MeshSpec, QualitySpec};
///
/// let disc = |i: usize| f32::from(u8::from((i % 40).abs_diff(20) < 11 && (i / 40).abs_diff(18) < 9));
/// let image = Image::new([40, 36], (0..40 * 36).map(disc).collect(), Geometry::default());
/// let spec = MeshSpec { distance: "5".parse()?, ..MeshSpec::default() };
/// let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
/// let report = atomesh::quality(mesh, &QualitySpec::default(), &mut NoProgress)?;
/// assert!(report.quality.is_some_and(|quality| quality.smallest_angle.worst > 10.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns [`Error::Mesh`] for a mesh or a truth that cannot be used, and [`Error::Job`] for lines of
/// Voronoi cells.
pub fn quality<'a>(
    mesh: impl Into<MeshInput<'a>>,
    spec: &QualitySpec,
    progress: &mut dyn Progress,
) -> Result<Report> {
    let MeshInput {
        mesh,
        name,
        read_image,
    } = mesh.into();
    with_mesh!(mesh,
        simplices file => {
            let file = match spec.labels {
                Some(_) => image_part(file, &mut *progress),
                None => file,
            };
            let mut stored = StoredMesh::new(file, name)?;
            let labels = spec.read_labels(&stored, name, read_image)?;
            let truth = spec.read_truth(&stored.space)?;
            progress.stage(Stage::Measuring);
            let mut report = measure_simplices(&mut stored, truth)?;
            if let Some(labels) = labels {
                let neighbours = cell_neighbours(&stored.lattice)?;
                report.certificate = labels.certify_simplices(&stored, &neighbours);
            }
            if let Some(path) = &spec.lines {
                let place = |n: u32| stored.world.nodes[n as usize];
                let angles = report.quality.as_ref().and_then(|q| q.angles.as_ref());
                write_lines(path, angles.map_or(&[], |a| &a.acute_lines), place)?;
            }
            Ok(with_note_on_space(report, &stored.space))
        },
        cells file => {
            spec.refuse_lines_of_cells(name)?;
            let mut stored = StoredMesh::new(file, name)?;
            let labels = spec.read_labels(&stored, name, read_image)?;
            let truth = spec.read_truth(&stored.space)?;
            progress.stage(Stage::Measuring);
            let mut report = measure_cells(&mut stored, truth);
            report.certificate = labels.and_then(|labels| labels.certify_cells(&stored));
            Ok(with_note_on_space(report, &stored.space))
        }
    )
}

/// An image of labels, and the index of the label of each cell of a mesh.
struct LabelsOfMesh<const D: usize> {
    geometry: Geometry<D>,
    /// The numbers of samples of the image that was padded, if the mesh covers its voxels.
    voxels: Option<[usize; D]>,
    table: LabelTable,
    components: Components<D>,
    names: Vec<Option<String>>,
    /// `true` for each connected part that the mesh leaves out on request.
    dropped: Vec<bool>,
    cells: Vec<u32>,
}

impl<const D: usize> LabelsOfMesh<D> {
    fn certify(&self, cells: &LabelledCells<'_, D>) -> Option<Certificate> {
        let image = CertifiedImage {
            components: &self.components,
            indices: &self.table.indices,
            labels: &self.table.values,
            names: &self.names,
            dropped: &self.dropped,
            geometry: &self.geometry,
        };
        certify(&image, cells, &CancelToken::never())
    }

    fn certify_simplices<M: Simplices<D>>(
        &self,
        stored: &StoredMesh<D, M>,
        neighbours: &[u32],
    ) -> Option<Certificate> {
        let to_index = |x: &[f64; D]| self.index_of(&stored.space, x);
        let (mesh, labels) = (&stored.lattice, &self.cells);
        self.certify(&LabelledCells::from_simplices(
            mesh, neighbours, labels, to_index,
        ))
    }

    fn certify_cells(&self, stored: &StoredMesh<D, PolyMesh<D>>) -> Option<Certificate> {
        let to_index = |x: &[f64; D]| self.index_of(&stored.space, x);
        self.certify(&LabelledCells::from_cells(
            &stored.lattice,
            &self.cells,
            to_index,
        ))
    }

    /// Returns the position in the image of a position in lattice space.
    fn index_of(&self, space: &LatticeSpace<D>, x: &[f64; D]) -> [f64; D] {
        let index = self.geometry.to_index(space.to_world(*x));
        let index = index.unwrap_or_else(|| std::array::from_fn(|k| x[k] / space.step[k]));
        match self.voxels {
            // The padded image starts a sample before the image.
            Some(dims) => cover::padded_index(index.map(|i| i - 1.0), dims),
            None => index,
        }
    }
}

/// The options with which a mesh of labels was made, as it records them.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "kebab-case")]
struct RecordedOptions {
    label: Vec<String>,
    drop: Option<RegionNames>,
    keep: Option<RegionNames>,
    keep_largest: bool,
    min_part: usize,
    cover: Cover,
    feature: Option<FeatureKind>,
    input: InputOptions,
}

impl RecordedOptions {
    /// Returns the options that a mesh records; none if it has no record.
    fn of_file<M>(file: &MeshFile<M>) -> Self {
        let Some(FieldValue::Text(text)) = file.field_value("parameters") else {
            return Self::default();
        };
        toml::from_str(text.trim_end_matches('\0')).unwrap_or_default()
    }

    /// Returns the options of labels.
    fn labels(&self) -> Vec<LabelOptions> {
        let labels = self.label.iter();
        labels
            .filter_map(|text| LabelOptions::parse(text).ok())
            .collect()
    }

    /// Returns the image in which samples outside the outline that the mesh keeps have a label of their own, and
    /// this label.
    fn with_outside_label<const D: usize>(
        &self,
        image: &Image<D>,
    ) -> Option<(Image<D>, LabelValue)> {
        let keeps_outline =
            self.input.inside.is_some() && self.feature != Some(FeatureKind::Isosurface);
        keeps_outline.then(|| image.with_outside_label()).flatten()
    }

    /// Returns which labels the mesh keeps. If the record uses names that are not known here, these are the
    /// labels that have cells. `cells` has the index of the label of each cell.
    fn kept_labels(
        &self,
        labels: &[LabelValue],
        names: &[Option<String>],
        cells: &[u32],
    ) -> Vec<bool> {
        let choice = CellChoice {
            drop: self.drop.as_ref(),
            keep: self.keep.as_ref(),
            keep_largest: self.keep_largest,
        };
        let known = KnownRegion::of_labels(labels, names);
        choice
            .kept_regions(&known, "the image")
            .unwrap_or_else(|_| {
                let mut has_cells = vec![false; labels.len()];
                cells
                    .iter()
                    .for_each(|&label| has_cells[label as usize] = true);
                has_cells
            })
    }
}

impl QualitySpec {
    /// Reads the image of a mesh with the options that the mesh records, unless others are given. For a mesh of
    /// voxels, the image is padded, and its own numbers of samples are returned.
    fn read_image<const D: usize>(
        &self,
        path: &Path,
        recorded: &RecordedOptions,
        space: &LatticeSpace<D>,
        read_image: ReadImage<'_>,
    ) -> Result<(Image<D>, Option<[usize; D]>)> {
        let input = self.input.with_fallback(&recorded.input);
        if recorded.cover == Cover::Samples {
            return Ok((read_mesh_image(path, &input, space, read_image)?, None));
        }
        let name = &path.display().to_string();
        let image = ImageInput {
            image: read_image(path, &input)?,
            name,
            sha256: None,
        };
        let image: Image<D> = image.checked()?;
        space.check_image(&image.geometry, image.dims().map(|n| n + 1), name)?;
        Ok((cover::padded(&image), Some(image.dims())))
    }

    /// Reads the image of labels of a mesh, if it is given.
    fn read_labels<const D: usize, M: Storable<D>>(
        &self,
        stored: &StoredMesh<D, M>,
        name: &str,
        read_image: ReadImage<'_>,
    ) -> Result<Option<LabelsOfMesh<D>>> {
        let Some(path) = &self.labels else {
            return Ok(None);
        };
        let refuse = |problem: String, remedy: &str| {
            Err(Error::Mesh(cause(path.display(), problem, remedy)))
        };
        let Some(regions) = stored.regions() else {
            let problem = format!("has nothing to be compared with: {name} has no regions");
            return refuse(problem, "give a mesh of labels");
        };
        let recorded = RecordedOptions::of_file(&stored.arrays);
        let mut options = recorded.labels();
        // The mesh was made of this image: labels merged, small parts absorbed, and samples without data filled in.
        let (mut image, voxels) = self.read_image(path, &recorded, &stored.space, read_image)?;
        let outside = recorded.with_outside_label(&image).map(|(filled, label)| {
            options.push(outside_options(label));
            image = filled;
            label
        });
        let image = merge_labels(&image, &options)?.unwrap_or(image);
        let image = match image.mark_dead(false)? {
            Some(marked) => marked.image.filled_from_nearest(),
            None => image,
        };
        let Some((mut table, mut components)) = label_map::components(&image) else {
            let problem = "has too many different values to be labels".to_string();
            return refuse(problem, "give the image of labels that was meshed");
        };
        if recorded.min_part > 1 {
            absorb_parts_below(image.dims(), &mut table.indices, recorded.min_part);
            components = Components::from_labels(image.dims(), &table.indices);
        }
        let region_of_label = label_map::regions(&table.values);
        let mut label_of_region: Vec<(i32, u32)> = region_of_label.into_iter().zip(0..).collect();
        label_of_region.sort_unstable();
        let mut cells = Vec::with_capacity(regions.len());
        for region in regions {
            let place = label_of_region.binary_search_by_key(&region, |(known, _)| *known);
            let Ok(place) = place else {
                let problem = format!("has no label {region}, which is a region of {name}");
                return refuse(problem, "give the image of labels that was meshed");
            };
            cells.push(label_of_region[place].1);
        }
        let name_of = |label: &LabelValue| {
            let mut options = options.iter();
            options
                .find(|options| options.label == *label)?
                .name
                .clone()
        };
        let names: Vec<Option<String>> = table.values.iter().map(name_of).collect();
        let mut kept = recorded.kept_labels(&table.values, &names, &cells);
        let labels = table.values.iter().zip(&mut kept);
        labels
            .filter(|(label, _)| Some(**label) == outside)
            .for_each(|(_, kept)| *kept = false);
        Ok(Some(LabelsOfMesh {
            geometry: image.geometry.clone(),
            voxels,
            dropped: dropped_parts(&components, &kept, recorded.keep_largest),
            names,
            table,
            components,
            cells,
        }))
    }

    /// Refuses to write lines of Voronoi cells. `name` is that of the mesh in messages.
    fn refuse_lines_of_cells(&self, name: &str) -> Result<()> {
        let Some(path) = &self.lines else {
            return Ok(());
        };
        let place = format!("lines {}", path.display());
        let problem = format!("{name} holds Voronoi cells, which have no such angles");
        let remedy = "give a mesh of tetrahedra or triangles, or omit it";
        Err(Error::Job(cause(place, problem, remedy)))
    }

    /// Reads the truth about a mesh's features, if it is given.
    fn read_truth<const D: usize>(
        &self,
        space: &LatticeSpace<D>,
    ) -> Result<Option<DescribedTruth<D>>> {
        self.truth
            .as_deref()
            .map(|path| read_truth(path, space))
            .transpose()
    }
}

/// The truth about the features of a mesh, with a line that describes it.
type DescribedTruth<const D: usize> = (Truth<D>, String);

fn read_truth<const D: usize>(path: &Path, space: &LatticeSpace<D>) -> Result<DescribedTruth<D>> {
    let (truth, note) = Truth::read(path)?;
    if !space.fits_dims(truth.dims) {
        let problem = format!(
            "has dimensions {:?}, the mesh {:?}",
            truth.dims,
            space.dims()
        );
        let remedy = match &space.velocities {
            None => "give the truth of the image that was meshed".to_string(),
            Some(velocities) => format!(
                "give the truth in depth, as the mesh is: atomesh convert --velocity {velocities} --geometry-from IMAGE {0} depth.npy",
                path.display()
            ),
        };
        return Err(Error::Mesh(cause(path.display(), problem, remedy)));
    }
    Ok((truth, format!("{}: {note}", path.display())))
}

/// Adds a note if the mesh does not record its lattice space.
fn with_note_on_space<const D: usize>(mut report: Report, space: &LatticeSpace<D>) -> Report {
    if !space.is_stored {
        let note = "the file does not record its lattice space: measured in physical space";
        report.notes.push(note.into());
        if let Some(quality) = &mut report.quality {
            quality.space = "physical".into();
        }
    }
    report
}

/// Returns the figures of tetrahedra or triangles, compared with the truth if it is known.
pub(crate) fn measure_simplices<const D: usize, M: Simplices<D>>(
    stored: &mut StoredMesh<D, M>,
    truth: Option<DescribedTruth<D>>,
) -> Result<Report> {
    let (mesh, space) = (&stored.lattice, &stored.space);
    let assessment = explained_angles(stored);
    let hints = stored.check_hints();
    let (low, high, tolerance) = ([0.0; D], space.extent, space.tolerance());
    let mut report = Report {
        quality: Some(Quality {
            angles: Some(assessment.angles),
            ..report::quality(mesh)
        }),
        box_check: Some(check_with_hints(mesh, hints, low, high, tolerance)),
        ..Report::default()
    };
    if let Some((truth, note)) = &truth {
        let in_samples = scaled_mesh(mesh, space.step.map(|s| 1.0 / s));
        let reference = Reference::from_truth(truth);
        report.fidelity = Some(report::fidelity(
            &*in_samples,
            &reference,
            stored.feature_faces.as_deref(),
        )?);
        report.notes.push(note.clone());
    }
    report.set_angle_space(&space.geometry);
    if geometry_of_other_shapes(&space.geometry, space.step).is_some()
        && let Ok(scales) = space.geometry.length_scales()
    {
        let in_one_unit = |mesh: &M| report::quality(&*scaled_mesh(mesh, scales));
        report.set_physical_quality(stored.with_world_mesh(in_one_unit));
    }
    Ok(report)
}

/// Returns which angles the features explain. If the mesh does not record its nominal distance, its
/// mean edge lengths replace it.
fn explained_angles<const D: usize, M: Simplices<D>>(stored: &StoredMesh<D, M>) -> AngleAssessment {
    let (mesh, space) = (&stored.lattice, &stored.space);
    let arrays = &stored.arrays.point_data;
    let array = arrays.iter().find(|array| array.name == DISTANCE_ARRAY);
    let values = array.map(|array| array.values.to_f64());
    let distance = values
        .filter(|d| d.len() == mesh.nodes().len() && d.iter().all(|d| *d > 0.0))
        .unwrap_or_else(|| mean_edge_lengths(mesh));
    let faces = stored.feature_faces.as_deref().unwrap_or_default();
    report::assess_angles(mesh, faces, space.extent, |n| distance[n as usize])
}

/// Returns the figures of polyhedra or polygons, compared with the truth if it is known.
pub(crate) fn measure_cells<const D: usize>(
    stored: &mut StoredMesh<D, PolyMesh<D>>,
    truth: Option<DescribedTruth<D>>,
) -> Report {
    let (mesh, space) = (&stored.lattice, &stored.space);
    let hints = stored.check_hints();
    let cell_check = check_with_hints(mesh, hints, [0.0; D], space.extent, space.tolerance());
    let graph = Graph::from_poly(mesh);
    let mut report = Report::default();
    if let Some((truth, note)) = &truth {
        let reference = Reference::from_truth(truth);
        report.fidelity = Some(cells::cell_fidelity(
            mesh,
            space.step,
            &reference,
            &CancelToken::never(),
        ));
        report.notes.push(note.clone());
    }
    report.set_angle_space(&space.geometry);
    let scales = space.geometry.length_scales();
    let has_angles = scales.is_ok();
    let scales = scales.unwrap_or([1.0; D]);
    let scale = |x: &[f64; D]| std::array::from_fn(|k| x[k] * scales[k]);
    let in_one_unit = |mesh: &PolyMesh<D>| Graph::from_poly(&mesh.mapped(|x| scale(&x), false));
    let physical = stored.with_world_mesh(in_one_unit);
    let measured = report::measure_voronoi(cell_check, &graph, &physical);
    report.voronoi = Some(report::Voronoi {
        angle_physical: measured.angle_physical.filter(|_| has_angles),
        ..measured
    });
    report
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::MeshSpec;
    use crate::progress::NoProgress;
    use crate::store::AnyMesh;

    fn mesh(spec: &MeshSpec) -> AnyMesh {
        let disc = |i: usize| f32::from(u8::from((i % 40).abs_diff(20) < 11));
        let image = Image::new(
            [40, 36],
            (0..40 * 36).map(disc).collect(),
            Geometry::default(),
        );
        let outcome = crate::mesh(&image, spec, &mut NoProgress).unwrap();
        outcome.mesh_file(&image).unwrap()
    }

    #[test]
    fn lines_are_written_for_simplices_alone() {
        let folder = tempfile::tempdir().unwrap();
        let spec = QualitySpec {
            lines: Some(folder.path().join("lines.vtp")),
            ..QualitySpec::default()
        };
        let mut mesh_spec = MeshSpec {
            distance: "5".parse().unwrap(),
            ..MeshSpec::default()
        };
        let report = quality(mesh(&mesh_spec), &spec, &mut NoProgress).unwrap();
        assert!(report.box_check.unwrap().passed());
        assert!(spec.lines.as_ref().unwrap().exists());
        mesh_spec.cells = Some(crate::job::spec::CellKind::Voronoi);
        let error = quality(mesh(&mesh_spec), &spec, &mut NoProgress).unwrap_err();
        assert!(error.to_string().starts_with("lines "), "{error}");
    }

    #[test]
    fn a_truth_of_another_size_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.npy");
        let mesh_spec = MeshSpec {
            distance: "5".parse().unwrap(),
            ..MeshSpec::default()
        };
        let truth = |dims: [usize; 2]| Truth::<2> {
            dims,
            distance: vec![1.0; dims[0] * dims[1]],
            direction: vec![[1.0, 0.0]; dims[0] * dims[1]],
            is_smooth: true,
            next_feature: None,
        };
        let spec = QualitySpec {
            truth: Some(path.clone()),
            ..QualitySpec::default()
        };
        truth([40, 36]).write(&path).unwrap();
        let report = quality(mesh(&mesh_spec), &spec, &mut NoProgress).unwrap();
        assert!(report.fidelity.is_some());
        truth([40, 35]).write(&path).unwrap();
        let error = quality(mesh(&mesh_spec), &spec, &mut NoProgress).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("has dimensions [40, 35], the mesh"),
            "{error}"
        );
    }
}
