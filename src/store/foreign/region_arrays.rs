//! Regions from the cell arrays of VTK files. Programs store them under many names and in every number
//! type.

use crate::files::vtk::{DataArray, Values};
use crate::geometry::sorted_distinct;
use crate::image::LabelValue;
use crate::mesh_file::array_names::{LABELS_FIELD, REGION_ARRAY};
use crate::mesh_file::labels::regions_field;
use crate::store::{FieldValue, LabelledRegion};

/// Names of cell arrays of regions, the most specific first, in lower case without marks. They are
/// those of our files, VTK and VMTK, Gmsh, Medit, TetGen (through meshio and mmgpy), GEOS and MFEM,
/// OpenGeoSys, DOLFINx, ParaView's blocks, and label images.
const REGION_NAMES: [&str; 30] = [
    "region",
    "regions",
    "regionid",
    "regionids",
    "cellentityids",
    "gmshphysical",
    "physical",
    "meditref",
    "tetgenref",
    "refs",
    "ref",
    "attribute",
    "attributes",
    "materialids",
    "materialid",
    "material",
    "materials",
    "matid",
    "mat",
    "celltags",
    "cellmarkers",
    "markers",
    "marker",
    "subdomain",
    "domain",
    "blockid",
    "blocks",
    "labels",
    "label",
    "gmshgeometrical",
];

/// The region of each cell of a file.
pub struct ArrayRegions {
    /// Name of the array.
    pub name: String,
    /// The regions.
    pub regions: Vec<i32>,
    /// The values of the array, if they do not fit into the numbers of regions.
    pub labels: Vec<LabelledRegion>,
}

/// Returns the name in lower case without marks.
fn folded(name: &str) -> String {
    let letters = name.chars().filter(|c| c.is_ascii_alphanumeric());
    letters.map(|c| c.to_ascii_lowercase()).collect()
}

/// Returns whole numbers exactly; `None` if a number has a fraction.
fn whole_numbers(values: &Values) -> Option<Vec<i128>> {
    values.to_integers().or_else(|| {
        let whole = |x: f64| (x.trunc() == x && x.abs() < 1e18).then_some(x as i128);
        values.to_f64().into_iter().map(whole).collect()
    })
}

/// Finds the regions of cells among their arrays: the first scalar array of whole numbers that has one
/// of the known names. Numbers beyond 32 bits become labels of regions 1, 2 and so on.
pub fn find(arrays: &[DataArray]) -> Option<ArrayRegions> {
    let named = |known: &&str| {
        let mut arrays = arrays.iter();
        arrays.find_map(|array| {
            let is_known = array.components == 1 && folded(&array.name) == **known;
            let numbers = is_known.then(|| whole_numbers(&array.values))??;
            Some((array, numbers))
        })
    };
    let (array, numbers) = REGION_NAMES.iter().find_map(named)?;
    let name = array.name.clone();
    if let Some(regions) = numbers.iter().map(|&n| i32::try_from(n).ok()).collect() {
        return Some(ArrayRegions {
            name,
            regions,
            labels: Vec::new(),
        });
    }
    let values = sorted_distinct(numbers.iter().copied());
    let region = |n: &i128| values.partition_point(|value| value < n) as i32 + 1;
    let label = |&value: &i128| LabelledRegion {
        region: region(&value),
        label: LabelValue::Whole(value),
        name: None,
    };
    Some(ArrayRegions {
        name,
        regions: numbers.iter().map(region).collect(),
        labels: values.iter().map(label).collect(),
    })
}

/// Gives a file the array of regions that the other modules read. Files of ours have it, if they have
/// regions. Returns a note if another array has the regions.
pub fn adopt(
    cell_data: &mut Vec<DataArray>,
    field_data: &mut Vec<(String, FieldValue)>,
) -> Option<String> {
    let is_known = |array: &&DataArray| array.name == REGION_ARRAY && array.components == 1;
    let known = cell_data.iter().find(is_known);
    let is_ours = field_data.iter().any(|(name, _)| name == "lattice_extent");
    if is_ours || known.is_some_and(|array| matches!(array.values, Values::I32(_))) {
        return None;
    }
    let found = find(cell_data)?;
    cell_data.retain(|array| array.name != REGION_ARRAY);
    cell_data.insert(0, DataArray::scalars(REGION_ARRAY, found.regions));
    if !found.labels.is_empty() {
        field_data.retain(|(name, _)| name != LABELS_FIELD);
        field_data.extend(regions_field(&found.labels));
    }
    array_note(&found.name)
}

/// Returns the note that an array has the regions, unless it is the usual one.
pub fn array_note(name: &str) -> Option<String> {
    (name != REGION_ARRAY).then(|| format!("regions are the values of the cell array '{name}'"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_are_found_under_many_names_and_in_every_number_type() {
        let types: [Values; 10] = [
            vec![1i8, 2].into(),
            vec![1u8, 2].into(),
            vec![1i16, 2].into(),
            vec![1u16, 2].into(),
            vec![1i32, 2].into(),
            vec![1u32, 2].into(),
            vec![1i64, 2].into(),
            vec![1u64, 2].into(),
            vec![1f32, 2.0].into(),
            vec![1f64, 2.0].into(),
        ];
        for name in ["region", "Material Id", "gmsh:physical", "CellEntityIds"] {
            for values in &types {
                let mut arrays = vec![DataArray::scalars(name, values.clone())];
                let note = adopt(&mut arrays, &mut Vec::new());
                assert_eq!(note.is_some(), name != "region");
                assert_eq!(arrays[0], DataArray::scalars("region", vec![1i32, 2]));
            }
        }
    }

    #[test]
    fn fractions_are_no_regions_and_large_numbers_become_labels() {
        let mut arrays = vec![
            DataArray::scalars("material", vec![0.5, 1.0]),
            DataArray::scalars("labels", vec![u64::MAX, 7]),
        ];
        let mut fields = Vec::new();
        let note = adopt(&mut arrays, &mut fields).unwrap();
        assert!(note.contains("'labels'"), "{note}");
        assert_eq!(arrays[0], DataArray::scalars("region", vec![2i32, 1]));
        let text = format!("{fields:?}");
        assert!(text.contains("18446744073709551615"), "{text}");
        assert_eq!(adopt(&mut arrays[1..2].to_vec(), &mut Vec::new()), None);
    }
}
