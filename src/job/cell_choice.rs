//! Labels that are left out of the mesh: which cells are kept, and large cells where none are.

use super::spec::MeshSpec;
use super::{AnnotatedMesh, MeshResult, Params};
use crate::Result;
use crate::error::{Error, cause};
use crate::feature::{
    self, FeatureKind, Features, LabelMap, LabelOptions, region_names, region_values,
};
use crate::image::{Image, ImageSource, LabelTable, LabelValue};
use crate::lattice::distance::Distance;
use crate::mesh::Simplices;
use crate::mesh_file::{ChosenCells, KnownRegion, TakeCells};
use crate::report::{self, Quality, RegionSummary, Report};

/// Distance between atoms in a label that is left out, in units of the largest distance elsewhere. Cells
/// grow towards it away from the labels that stay.
const COARSE_RATIO: f64 = 4.0;
/// Largest distance between atoms, as a share of the shortest side of the box.
const MAX_SHARE_OF_SIDE: f64 = 0.5;
/// Name of the label of samples outside the outline of `--inside`.
const OUTSIDE: &str = "outside";
/// Name of the image in errors.
const PLACE: &str = "the image";

/// Returns the same parameters with large distances between atoms in the labels that are left out, and
/// for which the options give none; `None` if no label is left out. The box has the sides `box_extent`, in
/// the unit of distances.
///
/// # Errors
/// Returns the errors of loading the image, and of options that name no label.
pub(super) fn with_coarse_cells<const D: usize>(
    params: &Params<D>,
    source: ImageSource<'_, D>,
    box_extent: [f64; D],
) -> Result<Option<Params<D>>> {
    let choice = params.spec.cell_choice();
    if choice.drop.is_none() && choice.keep.is_none() {
        return Ok(None);
    }
    let (labels, names) = match params.spec.feature {
        FeatureKind::Isosurface => {
            let (first, further) = params.spec.threshold_levels();
            // Without a threshold, the job chooses one.
            let levels: Vec<f32> = [first.unwrap_or_default()]
                .into_iter()
                .chain(further)
                .collect();
            (region_values(levels.len()), region_names(&levels))
        }
        FeatureKind::Labels => match LabelTable::from_image(&*source.to_image()?) {
            Some(table) => (table.values, Vec::new()),
            None => return Ok(None),
        },
        _ => return Ok(None),
    };
    let options = &params.spec.label;
    let name_of = |(number, label): (usize, &LabelValue)| {
        let given = options.iter().find(|options| options.label == *label);
        given
            .and_then(|options| options.name.clone())
            .or_else(|| names.get(number).cloned())
    };
    let names: Vec<Option<String>> = labels.iter().enumerate().map(name_of).collect();
    let regions = KnownRegion::of_labels(&labels, &names);
    let kept = choice.kept_regions(&regions, PLACE)?;
    let max = params.spacing().max();
    let shortest = box_extent.into_iter().fold(f64::INFINITY, f64::min);
    let coarse = (COARSE_RATIO * max).min(MAX_SHARE_OF_SIDE * shortest);
    if coarse <= max {
        return Ok(None);
    }
    let mut params = params.clone();
    let dropped = labels.iter().zip(&kept).filter(|(_, kept)| !**kept);
    for (&label, _) in dropped {
        match params.spec.label.iter_mut().find(|o| o.label == label) {
            Some(options) => options.distance = options.distance.or(Some(coarse)),
            None => params.spec.label.push(LabelOptions {
                label,
                distance: Some(coarse),
                unit: None,
                name: None,
                merge_into: None,
            }),
        }
    }
    Ok(Some(params))
}

/// Returns the options of the label of samples outside the outline of `--inside`.
pub(crate) fn outside_options(label: LabelValue) -> LabelOptions {
    LabelOptions {
        label,
        distance: None,
        unit: None,
        name: Some(OUTSIDE.into()),
        merge_into: None,
    }
}

/// Returns an image of labels whose samples outside the outline of `--inside` have a label of their own, with
/// parameters that leave this label out; `None` if there is no outline, or the features are no labels.
///
/// # Errors
/// Returns the errors of loading the image.
pub(super) fn without_outside<const D: usize>(
    params: &Params<D>,
    source: ImageSource<'_, D>,
) -> Result<Option<(Image<D>, Params<D>)>> {
    let spec = &params.spec;
    let may_be_labels = matches!(spec.feature, FeatureKind::Labels | FeatureKind::Auto);
    if spec.input.inside.is_none() || !may_be_labels {
        return Ok(None);
    }
    let image = source.to_image()?;
    if feature::fills_gaps(&image, spec.feature, params.modality) {
        return Ok(None);
    }
    let Some((image, outside)) = image.with_outside_label() else {
        return Ok(None);
    };
    let mut params = params.clone();
    params.spec.label.push(outside_options(outside));
    if params.spec.keep.is_none() {
        let drop = params.spec.drop.get_or_insert_default();
        drop.0.push(outside.to_string());
    }
    params.spec = params.spec.resolved();
    params.spec.validate()?;
    Ok(Some((image, params)))
}

/// Returns the regions that labels become.
fn known_regions<const D: usize>(labels: &LabelMap<D>) -> Vec<KnownRegion> {
    let mut known = KnownRegion::of_labels(&labels.labels, &labels.names);
    for (known, region) in known.iter_mut().zip(labels.regions()) {
        known.region = region;
    }
    known
}

/// Checks, before the mesh is made, that the options name labels that the image has.
///
/// # Errors
/// Returns [`Error::Job`] if they do not, or if the features are no labels.
pub(super) fn check_choice<const D: usize>(
    params: &Params<D>,
    features: &Features<D>,
) -> Result<()> {
    let choice = params.spec.cell_choice();
    if choice.keeps_all() {
        return Ok(());
    }
    let labels = require_labels(&params.spec, features)?;
    choice.kept_regions(&known_regions(labels), PLACE)?;
    Ok(())
}

/// Returns the labels of the image.
fn require_labels<'a, const D: usize>(
    spec: &MeshSpec,
    features: &'a Features<D>,
) -> Result<&'a LabelMap<D>> {
    features.labels.as_ref().ok_or_else(|| {
        Error::Job(cause(
            "drop, keep, keep-largest",
            format!("are about labels, but {} are followed", spec.feature),
            "omit them, or follow labels (--feature labels)",
        ))
    })
}

/// Returns the cells that files of the mesh contain; `None` for all of them. The report then has the
/// figures of these cells, and says what is left out.
///
/// # Errors
/// Returns the errors of [`CellChoice::cells`](crate::mesh_file::CellChoice::cells).
pub(super) fn choose_cells<const D: usize, M: Simplices<D>>(
    params: &Params<D>,
    mesh: &MeshResult<D, M>,
    features: &Features<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    report: &mut Report,
) -> Result<Option<Vec<u32>>> {
    let choice = params.spec.cell_choice();
    if choice.keeps_all() {
        return Ok(None);
    }
    let known = known_regions(require_labels(&params.spec, features)?);
    let kept = choice.kept_regions(&known, PLACE)?;
    let chosen = match mesh {
        MeshResult::Simplices(annotated) => {
            let regions = &annotated.regions;
            choice.cells(&annotated.mesh, regions, &known, PLACE)?
        }
        MeshResult::Voronoi { mesh, .. } => choice.cells(mesh, &mesh.region, &known, PLACE)?,
    };
    let Some(ChosenCells { cells, note }) = chosen else {
        return Ok(None);
    };
    if let (MeshResult::Simplices(annotated), Some(_)) = (mesh, &report.quality) {
        let distance_at = |x| distance.value_at(x);
        report.quality = Some(quality_of_kept(
            annotated,
            Some(&cells),
            extent,
            &distance_at,
        ));
    }
    let dropped = known.iter().zip(&kept).filter(|(_, kept)| !**kept);
    let dropped: Vec<LabelValue> = dropped.filter_map(|(region, _)| region.label).collect();
    if let Some(regions) = &mut report.regions {
        forget_labels(regions, &dropped);
    }
    report.notes.push(note);
    Ok(Some(cells))
}

/// Returns the shapes of the cells that are kept, all if `kept` is `None`, in the box `[0, extent]`.
/// `distance_at` returns the nominal distance at a position.
pub(super) fn quality_of_kept<const D: usize, M: Simplices<D>>(
    annotated: &AnnotatedMesh<M>,
    kept: Option<&[u32]>,
    extent: [f64; D],
    distance_at: &dyn Fn([f64; D]) -> f64,
) -> Quality {
    let quality_of = |mesh: &M, faces: &[u8]| {
        let at_node = |n: u32| distance_at(mesh.nodes()[n as usize]);
        Quality {
            angles: Some(report::assess_angles(mesh, faces, extent, at_node).angles),
            ..report::quality(mesh)
        }
    };
    let Some(kept) = kept else {
        return quality_of(&annotated.mesh, &annotated.feature_faces);
    };
    let faces = kept
        .iter()
        .filter_map(|&c| annotated.feature_faces.get(c as usize));
    let faces: Vec<u8> = faces.copied().collect();
    quality_of(&annotated.mesh.with_cells(kept).0, &faces)
}

/// Removes labels from the report on regions.
fn forget_labels(regions: &mut RegionSummary, dropped: &[LabelValue]) {
    let is_kept = |label: &LabelValue| !dropped.contains(label);
    regions.regions.retain(|region| is_kept(&region.label));
    regions.lost.retain(|lost| is_kept(&lost.label));
    regions.damaged.retain(|damaged| is_kept(&damaged.label));
    regions.holes.retain(|hole| hole.labels.iter().any(is_kept));
}
