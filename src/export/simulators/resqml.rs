//! Writes RESQML 2.0.1: an unstructured grid with its rock properties, in `NAME.epc` and `NAME.h5`.
//!
//! z is elevation, as the reference system says. So orientations need no conversion: seen from
//! outside its first cell, the nodes of a face turn anticlockwise.
//!
//! The surface or side on which a face lies is a categorical property of faces, whose table has the
//! names. For each name, a property of nodes with the same name is 1 for the nodes on it, and 0
//! elsewhere.

use std::path::Path;

use sha2::{Digest, Sha256};

use crate::Result;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::epc::{self, EpcObject, PROXY_KIND, uuid};
use crate::export::containers::hdf5::{self, Hdf5Node};
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::meshers::groups::{FaceNames, face_nodes};
use crate::export::names::{ExportNames, FormatNames, Naming};
use crate::files::Batch;
use crate::files::vtk::Values;
use crate::files::vtk::xml::escape;
use crate::mesh::poly::Lists;
use crate::model::reservoir::{MILLIDARCY, Model};
use crate::names::NameRules;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "resqml",
    description: "RESQML 2.0.1: an unstructured grid with its rock properties, EPC and HDF5",
    extensions: &["epc"],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: true,
    supported_content: &[
        ExportContent::Names,
        ExportContent::Regions,
        ExportContent::Porosity,
        ExportContent::Permeability,
        ExportContent::Properties,
    ],
    deck_path: None,
    names: FormatNames {
        regions: Naming::Numbers,
        faces: Naming::Names(NameRules {
            reserved: FIXED_TITLES,
            ..TITLES
        }),
        properties: Some(NameRules {
            reserved: FIXED_TITLES,
            ..TITLES
        }),
        ..FormatNames::NONE
    },
    write,
};

/// Rules of RESQML for titles.
const TITLES: NameRules = NameRules {
    max_bytes: 256,
    distinct_bytes: 256,
    ..NameRules::TEXT
};
/// Titles of the properties that a grid may have besides those of the user.
const FIXED_TITLES: &[&str] = &[
    "names of faces",
    "none",
    "permeability x",
    "permeability y",
    "permeability z",
];

/// RESQML property of cells, faces or nodes.
struct ResqmlProperty<'a> {
    title: String,
    /// Property kind from RESQML's standard list.
    kind: &'static str,
    unit: &'static str,
    /// Direction of the property, if it has one.
    facet: Option<&'static str>,
    /// Element for which the property has a value: cells, faces or nodes.
    indexable_element: &'static str,
    /// `true` if the values are keys of the names in the table.
    has_value_names: bool,
    numbers: LazyArray<'a>,
}

/// Writes both files. `path` is the package.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if a file cannot be written.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let cell_faces = model.mesh.faces_of_cells();
    let companion = path.with_extension("h5");
    let companion_name = companion.file_name().unwrap_or_default().to_string_lossy();
    let digest = model_digest(model);

    let proxy = EpcObject {
        kind: PROXY_KIND,
        uuid: uuid(&digest, "proxy"),
        title: "arrays".into(),
        body: "<eml:MimeType>application/x-hdf5</eml:MimeType>".into(),
        references: Vec::new(),
        has_arrays: false,
    };
    let crs = EpcObject {
        kind: "LocalDepth3dCrs",
        uuid: uuid(&digest, "crs"),
        title: "metres, z upwards".into(),
        body: CRS_XML.into(),
        references: Vec::new(),
        has_arrays: false,
    };
    let mut grid = EpcObject {
        kind: "UnstructuredGridRepresentation",
        uuid: uuid(&digest, "grid"),
        title: escape(&model.case.title),
        body: String::new(),
        references: vec![1],
        has_arrays: true,
    };
    grid.body = grid_xml(model, &grid.uuid, &proxy, &crs);
    let mut nodes = vec![(grid.uuid.clone(), grid_arrays(model, &cell_faces))];
    let table = EpcObject {
        kind: "StringTableLookup",
        uuid: uuid(&digest, "names"),
        title: "names of faces".into(),
        body: names_xml(&names.faces),
        references: Vec::new(),
        has_arrays: false,
    };
    let mut objects = vec![proxy, crs, grid, table];
    for property in properties(model, names) {
        let id = uuid(
            &digest,
            &format!(
                "property of {} {}",
                property.indexable_element, property.title
            ),
        );
        let (proxy, grid, table) = (&objects[0], &objects[2], &objects[3]);
        let values = format!(
            "<eml:PathInHdfFile>/RESQML/{id}/values_patch0</eml:PathInHdfFile>{}",
            proxy.reference("eml:HdfProxy")
        );
        let body = property.xml(
            &grid.reference("resqml2:SupportingRepresentation"),
            &values,
            &table.reference("resqml2:Lookup"),
        );
        objects.push(EpcObject {
            kind: property.object_type(),
            uuid: id.clone(),
            title: escape(&property.title),
            body,
            references: [2, 3][..1 + usize::from(property.has_value_names)].to_vec(),
            has_arrays: true,
        });
        let values = dataset(property.numbers);
        nodes.push((id, Hdf5Node::Group(vec![("values_patch0".into(), values)])));
    }
    let root = Hdf5Node::Group(vec![("RESQML".into(), Hdf5Node::Group(nodes))]);
    batch.write(&companion, |out| hdf5::write(out, &root))?;
    batch.write(path, |out| epc::write(out, &objects, &companion_name))
}

/// Returns the XML of the grid with this UUID.
fn grid_xml(model: &Model, uuid: &str, proxy: &EpcObject, crs: &EpcObject) -> String {
    let (mesh, cells) = (&model.mesh, model.len());
    let grid_array = |name: &str| {
        let path = format!("<eml:PathInHdfFile>/RESQML/{uuid}/{name}</eml:PathInHdfFile>");
        path + &proxy.reference("eml:HdfProxy")
    };
    let jagged = |name: &str| {
        let part = |element: &str, file: &str| {
            let path = grid_array(&format!("{name}/{file}"));
            format!(
                "<resqml2:{element} xsi:type=\"resqml2:IntegerHdf5Array\"><resqml2:NullValue>-1\
                 </resqml2:NullValue><resqml2:Values xsi:type=\"eml:Hdf5Dataset\">{path}\
                 </resqml2:Values></resqml2:{element}>"
            )
        };
        let parts = part("Elements", "elements") + &part("CumulativeLength", "cumulativeLength");
        format!("<resqml2:{name} xsi:type=\"resqml2:ResqmlJaggedArray\">{parts}</resqml2:{name}>")
    };
    let shape = match model.tets {
        Some(_) => "tetrahedral",
        None => "polyhedral",
    };
    format!(
        "<resqml2:CellCount>{cells}</resqml2:CellCount>\n<resqml2:Geometry \
         xsi:type=\"resqml2:UnstructuredGridGeometry\">\n{}\n<resqml2:Points \
         xsi:type=\"resqml2:Point3dHdf5Array\"><resqml2:Coordinates xsi:type=\"eml:Hdf5Dataset\">{}\
         </resqml2:Coordinates></resqml2:Points>\n<resqml2:CellShape>{shape}</resqml2:CellShape>\n\
         <resqml2:NodeCount>{}</resqml2:NodeCount>\n<resqml2:FaceCount>{}</resqml2:FaceCount>\n\
         {}\n{}\n<resqml2:CellFaceIsRightHanded xsi:type=\"resqml2:BooleanHdf5Array\">\
         <resqml2:Values xsi:type=\"eml:Hdf5Dataset\">{}</resqml2:Values>\
         </resqml2:CellFaceIsRightHanded>\n</resqml2:Geometry>",
        crs.reference("resqml2:LocalCrs"),
        grid_array("Points"),
        mesh.nodes.len(),
        mesh.face_cells.len(),
        jagged("NodesPerFace"),
        jagged("FacesPerCell"),
        grid_array("CellFaceIsRightHanded")
    )
}

/// Returns the arrays of the grid; `cell_faces` are the faces of each cell.
fn grid_arrays<'a>(model: &'a Model, cell_faces: &'a Lists) -> Hdf5Node<'a> {
    let mesh = &model.mesh;
    // A face is right-handed for its owner, the first of its two cells.
    let cell_of =
        move |item: usize| cell_faces.offsets.partition_point(|&o| o as usize <= item) - 1;
    let right_handedness = move |range: std::ops::Range<usize>, bytes: &mut Vec<u8>| {
        let mut cell = cell_of(range.start);
        for i in range {
            while cell_faces.offsets[cell + 1] as usize <= i {
                cell += 1;
            }
            let owner = mesh.face_cells[cell_faces.items[i] as usize][0];
            bytes.push(u8::from(owner as usize == cell));
        }
    };
    let coordinates = mesh.nodes.as_flattened();
    Hdf5Node::Group(vec![
        (
            "Points".into(),
            Hdf5Node::Dataset(
                vec![mesh.nodes.len() as u64, 3],
                LazyArray::from_slice(coordinates),
            ),
        ),
        ("NodesPerFace".into(), list_group(&mesh.faces)),
        ("FacesPerCell".into(), list_group(cell_faces)),
        (
            "CellFaceIsRightHanded".into(),
            dataset(LazyArray::from_fill::<u8>(
                cell_faces.items.len(),
                right_handedness,
            )),
        ),
    ])
}

/// Returns the XML of the names of faces, by number. Number 0 stands for no name.
fn names_xml(names: &FaceNames) -> String {
    let entry = |(number, name): (u32, &String)| {
        format!(
            "<resqml2:Value xsi:type=\"resqml2:StringLookup\"><resqml2:Key>{number}</resqml2:Key>\
             <resqml2:Value>{}</resqml2:Value></resqml2:Value>\n",
            escape(name)
        )
    };
    let no_name = "none".to_string();
    (0..)
        .zip([&no_name].into_iter().chain(&names.names))
        .map(entry)
        .collect()
}

/// Coordinate reference system: metres east, north and up from an unspecified origin.
const CRS_XML: &str = "<resqml2:XOffset>0</resqml2:XOffset><resqml2:YOffset>0</resqml2:YOffset>\
<resqml2:ZOffset>0</resqml2:ZOffset><resqml2:ArealRotation uom=\"rad\">0</resqml2:ArealRotation>\
<resqml2:ProjectedAxisOrder>easting northing</resqml2:ProjectedAxisOrder>\
<resqml2:ProjectedUom>m</resqml2:ProjectedUom><resqml2:VerticalUom>m</resqml2:VerticalUom>\
<resqml2:ZIncreasingDownward>false</resqml2:ZIncreasingDownward>\
<resqml2:VerticalCrs xsi:type=\"eml:VerticalUnknownCrs\"><eml:Unknown>Unknown</eml:Unknown>\
</resqml2:VerticalCrs><resqml2:ProjectedCrs xsi:type=\"eml:ProjectedUnknownCrs\"><eml:Unknown>Unknown\
</eml:Unknown></resqml2:ProjectedCrs>";

/// Returns a digest of the version, sites and nodes, which differs for different models.
fn model_digest(model: &Model) -> Sha256 {
    let mut digest = Sha256::new();
    digest.update(env!("CARGO_PKG_VERSION"));
    for point in model.graph.site.iter().chain(&model.mesh.nodes) {
        point.iter().for_each(|x| digest.update(x.to_le_bytes()));
    }
    digest
}

fn dataset(numbers: LazyArray<'_>) -> Hdf5Node<'_> {
    Hdf5Node::Dataset(vec![numbers.len as u64], numbers)
}

/// Returns lists as their elements and the end of each list.
fn list_group(lists: &Lists) -> Hdf5Node<'_> {
    Hdf5Node::Group(vec![
        (
            "elements".into(),
            dataset(LazyArray::from_slice(&lists.items)),
        ),
        (
            "cumulativeLength".into(),
            dataset(LazyArray::from_slice(&lists.offsets[1..])),
        ),
    ])
}

fn properties<'a>(model: &'a Model, names: &'a ExportNames) -> Vec<ResqmlProperty<'a>> {
    let property = |title: &str, kind, unit, facet, numbers| ResqmlProperty {
        title: title.into(),
        kind,
        unit,
        facet,
        indexable_element: "cells",
        has_value_names: false,
        numbers,
    };
    let region = LazyArray::from_slice(&model.graph.region);
    let mut properties = vec![property("region", "index", "", None, region)];
    if let Some(porosity) = &model.porosity {
        let numbers = LazyArray::from_slice(porosity);
        properties.push(property("porosity", "porosity", "m3/m3", None, numbers));
    }
    if let Some(permeability) = &model.permeability {
        let rock = &permeability.rock;
        for (k, (title, facet)) in [
            ("permeability x", "I"),
            ("permeability y", "J"),
            ("permeability z", "K"),
        ]
        .into_iter()
        .enumerate()
        {
            let value = move |c: usize| rock.mobility(c).0[k] / MILLIDARCY;
            let numbers = LazyArray::from_fn(model.len(), value);
            let kind = "permeability rock";
            properties.push(property(title, kind, "mD", Some(facet), numbers));
        }
    }
    for (array, name) in model.properties.iter().zip(&names.properties) {
        if array.components != 1 {
            continue;
        }
        let numbers = match &array.values {
            Values::F64(values) => LazyArray::from_slice(values),
            values => {
                let values = values.to_f64();
                LazyArray::from_fn(values.len(), move |i| values[i])
            }
        };
        properties.push(property(name, "continuous", "Euc", None, numbers));
    }
    let numbers = LazyArray::from_slice(&names.faces.face_numbers);
    properties.push(ResqmlProperty {
        indexable_element: "faces",
        has_value_names: true,
        ..property("names of faces", "categorical", "", None, numbers)
    });
    for group in names.faces.groups() {
        let mut membership = vec![0u8; model.mesh.nodes.len()];
        let nodes = face_nodes(model, &group.faces);
        nodes.iter().for_each(|&n| membership[n as usize] = 1);
        let numbers = LazyArray::from_fn(membership.len(), move |n| membership[n]);
        properties.push(ResqmlProperty {
            indexable_element: "nodes",
            ..property(&group.name, "index", "", None, numbers)
        });
    }
    properties
}

impl ResqmlProperty<'_> {
    fn is_integer(&self) -> bool {
        self.kind == "index" || self.has_value_names
    }

    fn object_type(&self) -> &'static str {
        match (self.has_value_names, self.is_integer()) {
            (true, _) => "CategoricalProperty",
            (_, true) => "DiscreteProperty",
            _ => "ContinuousProperty",
        }
    }

    /// Returns the content of the object. `values` refers to its numbers, and `table` to the table
    /// of names.
    fn xml(&self, grid: &str, values: &str, table: &str) -> String {
        let dataset =
            format!("<resqml2:Values xsi:type=\"eml:Hdf5Dataset\">{values}</resqml2:Values>");
        let values = if self.is_integer() {
            format!(
                "<resqml2:Values xsi:type=\"resqml2:IntegerHdf5Array\"><resqml2:NullValue>-2147483648\
                 </resqml2:NullValue>{dataset}</resqml2:Values>"
            )
        } else {
            format!(
                "<resqml2:Values xsi:type=\"resqml2:DoubleHdf5Array\">{dataset}</resqml2:Values>"
            )
        };
        let facet = self.facet.map_or(String::new(), |facet| {
            format!(
                "<resqml2:Facet><resqml2:Facet>direction</resqml2:Facet><resqml2:Value>{facet}\
                 </resqml2:Value></resqml2:Facet>\n"
            )
        });
        let unit = match (self.has_value_names, self.is_integer()) {
            (true, _) => format!("\n{table}"),
            (_, true) => String::new(),
            _ => format!("\n<resqml2:UOM>{}</resqml2:UOM>", self.unit),
        };
        format!(
            "<resqml2:Count>1</resqml2:Count><resqml2:IndexableElement>{}\
             </resqml2:IndexableElement>\n{grid}\n<resqml2:PropertyKind \
             xsi:type=\"resqml2:StandardPropertyKind\"><resqml2:Kind>{}</resqml2:Kind>\
             </resqml2:PropertyKind>\n<resqml2:PatchOfValues><resqml2:RepresentationPatchIndex>0\
             </resqml2:RepresentationPatchIndex>{values}</resqml2:PatchOfValues>\n{facet}{unit}",
            self.indexable_element, self.kind
        )
    }
}
