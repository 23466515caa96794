//! Adds the cells beyond the image to the mesh file of a job.

use super::physical_angles;
use crate::files::vtk::DataArray;
use crate::image::Geometry;
use crate::job::PaddingCells;
use crate::mesh::Simplices;
use crate::mesh_file::array_names::{
    ANGLES_ARRAY, ATOM_KIND_ARRAY, BENT_SIDE_FIELD, DISTANCE_ARRAY, IMAGE_ARRAY, LABELS_FIELD,
    LATTICE_EXTENT_FIELD, LIVE_ARRAY, ORIGIN_FIELD, REGION_ARRAY, REGIONS_FIELD,
};
use crate::mesh_file::{Burden, FieldValue, MeshFile, NamedRegion, to_physical};
use crate::report::angles::MIN_ANGLE;
use crate::report::smallest_angles;

/// Name of the region of the image, if its regions are no labels.
const IMAGE_REGION_NAME: &str = "image";

/// Returns the region numbers of the parts beyond the image: those after the image's regions.
fn burden_regions(image_regions: &[i32]) -> [i32; Burden::ALL.len()] {
    let last = image_regions.iter().max().copied().unwrap_or(0);
    let mut unused = (last.max(0)..i32::MAX)
        .skip(1)
        .chain((1..).filter(|region| !image_regions.contains(region)));
    Burden::ALL.map(|_| unused.next().unwrap_or(-1))
}

/// Returns an array with more values.
fn extend(mut array: DataArray, values: impl Iterator<Item = f64>) -> DataArray {
    array.values.extend_from_f64(values);
    array
}

/// Returns 2 for each cell with an angle out of range, and 0 for the others.
fn angle_classes<const D: usize, M: Simplices<D>>(mesh: &M) -> Vec<f64> {
    let is_out_of_range = |c: usize| {
        let shape = mesh.shape(c);
        let mut cosines = shape.cosines.as_ref().iter();
        cosines.any(|cosine| cosine.abs() > MIN_ANGLE.to_radians().cos())
    };
    (0..mesh.len())
        .map(|c| if is_out_of_range(c) { 2.0 } else { 0.0 })
        .collect()
}

/// Returns a mesh file with the cells beyond the image. The lattice space of the file becomes that of the
/// whole box. The image has no value there (NaN), but the cells count as live.
pub fn with_padding<const D: usize, M: Simplices<D>>(
    file: MeshFile<M>,
    lattice: &M,
    padding: &PaddingCells<D>,
    geometry: &Geometry<D>,
    step: [f64; D],
) -> MeshFile<M> {
    let MeshFile {
        mesh,
        point_data,
        cell_data,
        mut field_data,
    } = file;
    let image_regions = cell_data.iter().find(|array| array.name == REGION_ARRAY);
    let image_regions = image_regions.map_or(Vec::new(), |array| array.values.to_i64());
    let image_regions: Vec<i32> = image_regions.into_iter().map(|r| r as i32).collect();
    let regions = burden_regions(&image_regions);
    let is_unlabelled = !(field_data.iter()).any(|(name, _)| name == LABELS_FIELD);

    // The cells beyond the image alone, with all nodes.
    let nodes = [lattice.nodes(), &padding.nodes].concat();
    let beyond = M::from_parts(nodes, padding.connectivity.clone());
    let smallest = smallest_angles(&beyond);
    // No feature explains an angle out of range there.
    let angle_classes = angle_classes(&beyond);
    let beyond = to_physical(&beyond, step, geometry);
    let cell_count = beyond.len();
    let added_points = |array: DataArray| match array.name.as_str() {
        ATOM_KIND_ARRAY => extend(array, padding.kinds.iter().map(|&kind| kind as u8 as f64)),
        DISTANCE_ARRAY => extend(array, padding.distances.iter().map(|&d| d.into())),
        IMAGE_ARRAY => extend(array, padding.nodes.iter().map(|_| f64::NAN)),
        _ => extend(array, padding.nodes.iter().map(|_| 0.0)),
    };
    let added_cells = |array: DataArray| match array.name.as_str() {
        REGION_ARRAY => {
            let region = |burden: &Burden| f64::from(regions[*burden as usize]);
            extend(array, padding.burdens.iter().map(region))
        }
        IMAGE_ARRAY => extend(array, (0..cell_count).map(|_| f64::NAN)),
        // The user requested ground beyond the image.
        LIVE_ARRAY => extend(array, (0..cell_count).map(|_| 1.0)),
        name if name == M::MIN_ANGLE_ARRAY => extend(array, smallest.iter().map(|&a| a.into())),
        name if name == M::PHYSICAL_ANGLE_ARRAY => {
            let values =
                physical_angles(&beyond, geometry, step).map(|array| array.values.to_f64());
            extend(array, values.unwrap_or_default().into_iter())
        }
        name if name == M::VOLUME_NAME => extend(array, (0..cell_count).map(|c| beyond.volume(c))),
        ANGLES_ARRAY => extend(array, angle_classes.iter().copied()),
        _ => extend(array, (0..cell_count).map(|_| 0.0)),
    };
    let point_data = point_data.into_iter().map(added_points).collect();
    let cell_data = cell_data.into_iter().map(added_cells).collect();

    let low_index = std::array::from_fn(|k| padding.low[k] / step[k]);
    let extent: Vec<f64> = (0..D).map(|k| padding.high[k] - padding.low[k]).collect();
    for (name, value) in &mut field_data {
        match name.as_str() {
            ORIGIN_FIELD => *value = FieldValue::F64s(geometry.to_physical(low_index).to_vec()),
            LATTICE_EXTENT_FIELD => *value = FieldValue::F64s(extent.clone()),
            _ => {}
        }
    }
    let named = |region, name: &str| NamedRegion {
        region,
        name: name.into(),
    };
    let mut names: Vec<NamedRegion> = Burden::ALL
        .into_iter()
        .filter(|burden| padding.burdens.contains(burden))
        .map(|burden| named(regions[burden as usize], burden.name()))
        .collect();
    if is_unlabelled {
        names.insert(0, named(0, IMAGE_REGION_NAME));
    }
    if let Ok(text) = serde_json::to_string(&names) {
        field_data.push((REGIONS_FIELD.into(), FieldValue::Text(text)));
    }
    if let Some(side) = padding.bent_side {
        field_data.push((BENT_SIDE_FIELD.into(), FieldValue::Ints(vec![side as i64])));
    }
    let connectivity = [mesh.connectivity(), beyond.connectivity()].concat();
    MeshFile {
        mesh: M::from_parts(beyond.nodes().to_vec(), connectivity),
        point_data,
        cell_data,
        field_data,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::job::spec::NominalDistance;
    use crate::job::{BOX_TOLERANCE, MeshSpec, Outcome, Params, run};
    use crate::mesh::check::check;
    use crate::mesh_file::read_named_regions;
    use crate::progress::NoProgress;
    use crate::store::StoredMesh;

    /// Meshes an image with one inclined feature.
    fn outcome(padding: Option<&str>) -> Outcome {
        let surfaces = [ExactSurface::plane([1.0, 0.4, 0.2], [16.0; 3])];
        let image = ridge_image([36, 34, 32], &surfaces, 1.5, 0.1);
        let spec = MeshSpec {
            distance: NominalDistance::Range { min: 4.0, max: 7.0 },
            pad: padding.map(|text| text.parse().unwrap()),
            ..MeshSpec::default()
        };
        run(&image, &Params::new(spec).unwrap(), &mut NoProgress).unwrap()
    }

    #[test]
    fn the_mesh_of_the_image_stays_as_it_is_and_the_file_names_the_regions() {
        let plain = outcome(None);
        let padded = outcome(Some("above=50"));
        let [plain, padded] = [plain, padded].map(|outcome| {
            let file = outcome
                .simplex_file(outcome.simplices().unwrap(), None)
                .unwrap();
            (outcome.extent, file)
        });
        let (extent, plain) = plain;
        let (_, padded) = padded;
        let (nodes, cells) = (plain.mesh.nodes.len(), plain.mesh.tets.len());
        assert_eq!(padded.mesh.nodes[..nodes], plain.mesh.nodes);
        assert_eq!(padded.mesh.tets[..cells], plain.mesh.tets);
        for (array, expected) in padded.cell_data.iter().zip(&plain.cell_data) {
            let kept = array
                .values
                .select_tuples(&(0..cells as u32).collect::<Vec<_>>(), 1);
            assert_eq!(kept, expected.values, "{}", array.name);
            assert_eq!(array.values.len(), padded.mesh.tets.len(), "{}", array.name);
        }
        // Samples without units: z increases downwards.
        assert!(padded.mesh.nodes[nodes..].iter().all(|x| x[2] < 0.0));
        let names = read_named_regions(&padded);
        let names: Vec<_> = names.iter().map(|r| (r.region, r.name.as_str())).collect();
        assert_eq!(names, [(0, "image"), (1, "overburden")]);
        let regions = padded.cell_array("region").unwrap().values.to_i64();
        assert!(
            regions
                .iter()
                .enumerate()
                .all(|(c, &r)| r == i64::from(c >= cells))
        );
        assert_eq!(
            padded.field_value("origin"),
            Some(&FieldValue::F64s(vec![0.0, 0.0, -50.0]))
        );
        let stored = StoredMesh::new(padded, "padded").unwrap();
        assert_eq!(
            stored.space.extent,
            [extent[0], extent[1], extent[2] + 50.0]
        );
        let check = check(
            &stored.lattice,
            [0.0; 3],
            stored.space.extent,
            BOX_TOLERANCE,
        );
        assert!(check.passed(), "{check:?}");
    }

    #[test]
    fn regions_beyond_the_image_get_numbers_that_are_not_in_use() {
        assert_eq!(burden_regions(&[0, 0]), [1, 2, 3]);
        assert_eq!(burden_regions(&[-4, -2]), [1, 2, 3]);
        assert_eq!(burden_regions(&[1, 7]), [8, 9, 10]);
        assert_eq!(burden_regions(&[2, i32::MAX]), [1, 3, 4]);
    }
}
