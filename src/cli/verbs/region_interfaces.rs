//! The option `atomesh surface --by regions`: the interfaces between regions of a mesh.

use serde_json::json;

use super::surface::{ShortNumber, SurfaceArgs, write_file};
use crate::cli::common::output::path_text;
use crate::cli::console::Console;
use crate::error::cause;
use crate::export::SurfaceFile;
use crate::files::vtk::DataArray;
use crate::model::surface::region_interfaces::{RegionInterface, region_interfaces};
use crate::store::{LabelledRegion, Storable, StoredMesh};
use crate::{Error, Result};

/// Writes the interfaces between every two regions of a mesh.
pub(super) fn write_region_interfaces<const D: usize, M: Storable<D>>(
    args: &SurfaceArgs,
    stored: &StoredMesh<D, M>,
    labels: &[LabelledRegion],
    z_up: bool,
    console: &mut Console,
) -> Result<()> {
    let regions = stored.regions().unwrap_or_default();
    if regions.iter().all(|region| *region == regions[0]) {
        return Err(Error::Mesh(cause(
            args.mesh.display(),
            "has only one region",
            "mesh an image of labels, or paint the mesh",
        )));
    }
    if args.image.is_some() || args.min_area.is_some() || args.meets {
        let problem = "is not for surfaces between regions, all of which are written";
        return Err(Error::Job(cause(
            "--by regions",
            problem,
            "omit IMAGE, --min-area and --meets",
        )));
    }
    let nodes = stored.world.nodes.as_slice();
    let mut interfaces = region_interfaces(&stored.lattice, &regions, nodes)?;
    if stored.space.is_mirrored() {
        let facets = interfaces
            .iter_mut()
            .flat_map(|between| &mut between.facets);
        facets.for_each(|facet| facet.swap(0, 1));
    }
    let region_name = |region: i32| {
        let label = labels.iter().find(|label| label.region == region);
        let name = label.and_then(|label| label.name.clone());
        name.unwrap_or_else(|| region.to_string())
    };
    let mut start = vec![0];
    let mut facets = Vec::new();
    for between in &interfaces {
        facets.extend_from_slice(&between.facets);
        start.push(facets.len());
    }
    let mut file = SurfaceFile::new(nodes, &facets, &start, "surface");
    let outer_name = |b: &RegionInterface<D>| b.outer_region.map_or("outside".into(), region_name);
    file.names = interfaces
        .iter()
        .map(|b| format!("{}_{}", region_name(b.inner_region), outer_name(b)))
        .collect();
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
    console.begin_stage("writing");
    write_file(&args.output, file, &stored.space.geometry, z_up, console)?;
    let area = if D == 2 { "length" } else { "area" };
    let mut lines = vec![format!(
        "{:>12} {:>12} {:>9} {:>14}",
        "inside", "outside", "faces", area
    )];
    lines.extend(interfaces.iter().map(|b| {
        let faces = b.facets.len();
        format!(
            "{:>12} {:>12} {faces:>9} {:>14.6}",
            region_name(b.inner_region),
            outer_name(b),
            ShortNumber(b.area)
        )
    }));
    let rows: Vec<_> = (interfaces.iter())
        .map(|b| json!({"inside": b.inner_region, "outside": b.outer_region, "faces": b.facets.len(), area: b.area}))
        .collect();
    lines.push(format!(
        "wrote {}: {} surfaces",
        args.output.display(),
        interfaces.len()
    ));
    console.result(
        lines.join("\n"),
        &json!({"file": path_text(&args.output), "surfaces": rows}),
    );
    Ok(())
}
