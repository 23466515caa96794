//! RESQML 2.0.1: an unstructured grid with its rock, `NAME.epc` and `NAME.h5`.
//!
//! z is elevation (the reference system says so), so that what is right-handed needs no second
//! thought: seen from outside its first cell, a face's nodes turn anticlockwise.
//!
//! Which surface or side a face lies on is a categorical property of faces, whose table has the names; which
//! nodes lie on it is a property of nodes with the same name, 1 or 0.

use std::path::Path;

use sha2::{Digest, Sha256};

use crate::Result;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::epc::{self, EpcObject, PROXY_KIND, uuid};
use crate::export::containers::hdf5::{self, Hdf5Node};
use crate::export::meshers::groups::{FaceNames, face_nodes};
use crate::files::Batch;
use crate::files::vtk::Values;
use crate::files::vtk::xml::escape;
use crate::mesh::poly::Lists;
use crate::model::reservoir::{MILLIDARCY, Model};

/// A property of the cells as RESQML has it.
struct ResqmlProperty<'a> {
    title: String,
    /// One of RESQML's own kinds.
    kind: &'static str,
    unit: &'static str,
    /// The direction that it is for.
    facet: Option<&'static str>,
    /// What there is a number for.
    indexable_element: &'static str,
    /// Whether its numbers stand for the names in the table.
    has_value_names: bool,
    numbers: LazyArray<'a>,
}

/// Writes both files; `path` is the package.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if a file cannot be written.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let (mesh, cells) = (&model.mesh, model.len());
    let names = FaceNames::new(model);
    let of_cells = mesh.faces_of_cells();
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
    let at = |uuid: &str, name: &str| {
        let path = format!("<eml:PathInHdfFile>/RESQML/{uuid}/{name}</eml:PathInHdfFile>");
        path + &proxy.reference("eml:HdfProxy")
    };
    let own = |name: &str| at(&grid.uuid, name);
    let jagged = |name: &str| {
        let part = |element: &str, file: &str| {
            let path = own(&format!("{name}/{file}"));
            format!(
                "<resqml2:{element} xsi:type=\"resqml2:IntegerHdf5Array\"><resqml2:NullValue>-1\
                 </resqml2:NullValue><resqml2:Values xsi:type=\"eml:Hdf5Dataset\">{path}\
                 </resqml2:Values></resqml2:{element}>"
            )
        };
        let both = part("Elements", "elements") + &part("CumulativeLength", "cumulativeLength");
        format!("<resqml2:{name} xsi:type=\"resqml2:ResqmlJaggedArray\">{both}</resqml2:{name}>")
    };
    let shape = match model.tets {
        Some(_) => "tetrahedral",
        None => "polyhedral",
    };
    grid.body = format!(
        "<resqml2:CellCount>{cells}</resqml2:CellCount>\n<resqml2:Geometry \
         xsi:type=\"resqml2:UnstructuredGridGeometry\">\n{}\n<resqml2:Points \
         xsi:type=\"resqml2:Point3dHdf5Array\"><resqml2:Coordinates xsi:type=\"eml:Hdf5Dataset\">{}\
         </resqml2:Coordinates></resqml2:Points>\n<resqml2:CellShape>{shape}</resqml2:CellShape>\n\
         <resqml2:NodeCount>{}</resqml2:NodeCount>\n<resqml2:FaceCount>{}</resqml2:FaceCount>\n\
         {}\n{}\n<resqml2:CellFaceIsRightHanded xsi:type=\"resqml2:BooleanHdf5Array\">\
         <resqml2:Values xsi:type=\"eml:Hdf5Dataset\">{}</resqml2:Values>\
         </resqml2:CellFaceIsRightHanded>\n</resqml2:Geometry>",
        crs.reference("resqml2:LocalCrs"),
        own("Points"),
        mesh.nodes.len(),
        mesh.face_cells.len(),
        jagged("NodesPerFace"),
        jagged("FacesPerCell"),
        own("CellFaceIsRightHanded")
    );

    // A face is right-handed for its owner, whose cells have it first.
    let cell_of = |item: usize| of_cells.offsets.partition_point(|&o| o as usize <= item) - 1;
    let right = |range: std::ops::Range<usize>, bytes: &mut Vec<u8>| {
        let mut cell = cell_of(range.start);
        for i in range {
            while of_cells.offsets[cell + 1] as usize <= i {
                cell += 1;
            }
            let owner = mesh.face_cells[of_cells.items[i] as usize][0];
            bytes.push(u8::from(owner as usize == cell));
        }
    };
    let coordinates = mesh.nodes.as_flattened();
    let grid_node = Hdf5Node::Group(vec![
        (
            "Points".into(),
            Hdf5Node::Dataset(
                vec![mesh.nodes.len() as u64, 3],
                LazyArray::from_slice(coordinates),
            ),
        ),
        ("NodesPerFace".into(), list_group(&mesh.faces)),
        ("FacesPerCell".into(), list_group(&of_cells)),
        (
            "CellFaceIsRightHanded".into(),
            dataset(LazyArray::from_fill::<u8>(of_cells.items.len(), right)),
        ),
    ]);
    let mut nodes = vec![(grid.uuid.clone(), grid_node)];
    let entry = |(number, name): (u32, &String)| {
        format!(
            "<resqml2:Value xsi:type=\"resqml2:StringLookup\"><resqml2:Key>{number}</resqml2:Key>\
             <resqml2:Value>{name}</resqml2:Value></resqml2:Value>\n"
        )
    };
    let none = "none".to_string();
    let table = EpcObject {
        kind: "StringTableLookup",
        uuid: uuid(&digest, "names"),
        title: "names of faces".into(),
        body: (0..)
            .zip([&none].into_iter().chain(&names.names))
            .map(entry)
            .collect(),
        references: Vec::new(),
        has_arrays: false,
    };
    let mut objects = vec![proxy, crs, grid, table];
    for property in properties(model, &names) {
        let id = uuid(&digest, &format!("property {}", property.title));
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
            references: if property.has_value_names {
                vec![2, 3]
            } else {
                vec![2]
            },
            has_arrays: true,
        });
        let values = dataset(property.numbers);
        nodes.push((id, Hdf5Node::Group(vec![("values_patch0".into(), values)])));
    }
    let root = Hdf5Node::Group(vec![("RESQML".into(), Hdf5Node::Group(nodes))]);
    batch.write(&companion, |out| hdf5::write(out, &root))?;
    batch.write(path, |out| epc::write(out, &objects, &companion_name))
}

/// Metres east, north and up from nowhere in particular.
const CRS_XML: &str = "<resqml2:XOffset>0</resqml2:XOffset><resqml2:YOffset>0</resqml2:YOffset>\
<resqml2:ZOffset>0</resqml2:ZOffset><resqml2:ArealRotation uom=\"rad\">0</resqml2:ArealRotation>\
<resqml2:ProjectedAxisOrder>easting northing</resqml2:ProjectedAxisOrder>\
<resqml2:ProjectedUom>m</resqml2:ProjectedUom><resqml2:VerticalUom>m</resqml2:VerticalUom>\
<resqml2:ZIncreasingDownward>false</resqml2:ZIncreasingDownward>\
<resqml2:VerticalCrs xsi:type=\"eml:VerticalUnknownCrs\"><eml:Unknown>Unknown</eml:Unknown>\
</resqml2:VerticalCrs><resqml2:ProjectedCrs xsi:type=\"eml:ProjectedUnknownCrs\"><eml:Unknown>Unknown\
</eml:Unknown></resqml2:ProjectedCrs>";

/// A digest of what makes a model different from others.
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

/// Lists as elements and where each list ends.
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

fn properties<'a>(model: &'a Model, names: &'a FaceNames) -> Vec<ResqmlProperty<'a>> {
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
    let mut all = vec![property("region", "index", "", None, region)];
    if let Some(porosity) = &model.porosity {
        let numbers = LazyArray::from_slice(porosity);
        all.push(property("porosity", "porosity", "m3/m3", None, numbers));
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
            all.push(property(title, kind, "mD", Some(facet), numbers));
        }
    }
    for array in model.properties.iter().filter(|p| p.components == 1) {
        let numbers = match &array.values {
            Values::F64(values) => LazyArray::from_slice(values),
            values => {
                let values = values.to_f64();
                LazyArray::from_fn(values.len(), move |i| values[i])
            }
        };
        all.push(property(&array.name, "continuous", "Euc", None, numbers));
    }
    let numbers = LazyArray::from_slice(&names.face_numbers);
    all.push(ResqmlProperty {
        indexable_element: "faces",
        has_value_names: true,
        ..property("names of faces", "categorical", "", None, numbers)
    });
    for group in names.groups() {
        let mut within = vec![0u8; model.mesh.nodes.len()];
        let nodes = face_nodes(model, &group.faces);
        nodes.iter().for_each(|&n| within[n as usize] = 1);
        let numbers = LazyArray::from_fn(within.len(), move |n| within[n]);
        all.push(ResqmlProperty {
            indexable_element: "nodes",
            ..property(&group.name, "index", "", None, numbers)
        });
    }
    all
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

    /// What is in the object; `values` says where its numbers are, `table` where their names are.
    fn xml(&self, grid: &str, values: &str, table: &str) -> String {
        let dataset =
            format!("<resqml2:Values xsi:type=\"eml:Hdf5Dataset\">{values}</resqml2:Values>");
        let values = match self.is_integer() {
            true => format!(
                "<resqml2:Values xsi:type=\"resqml2:IntegerHdf5Array\"><resqml2:NullValue>-2147483648\
                 </resqml2:NullValue>{dataset}</resqml2:Values>"
            ),
            false => format!(
                "<resqml2:Values xsi:type=\"resqml2:DoubleHdf5Array\">{dataset}</resqml2:Values>"
            ),
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
