//! Tests that VTK reads the files that atomesh writes.

use std::path::Path;

use atomesh::files::vtk::{DataArray, VtkFile};
use atomesh::image::formats::vti;
use atomesh::image::{Geometry, Image};
use atomesh::mesh::TetMesh;
use atomesh::store::{FieldValue, MeshFile, PvdSeries, to_physical, write_vtu};

/// Returns the description of files that VTK's readers give, one item a line.
fn inspect_with_vtk(files: &[&Path]) -> String {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/vtk/judge.py");
    let mut arguments = vec![script.as_os_str()];
    arguments.extend(files.iter().map(|f| f.as_os_str()));
    crate::common::run_python("VTK", &arguments)
}

/// Returns a cube of six tetrahedra around its diagonal, with the geometry of a reflected, rotated
/// survey.
fn cube() -> MeshFile {
    let nodes = (0..8)
        .map(|i| std::array::from_fn(|k| f64::from((i >> k) & 1)))
        .collect();
    let tets = vec![
        [0, 1, 3, 7],
        [0, 3, 2, 7],
        [0, 2, 6, 7],
        [0, 6, 4, 7],
        [0, 4, 5, 7],
        [0, 5, 1, 7],
    ];
    let geometry = Geometry {
        origin: [6e5, 7e6, 100.0],
        axes: [[3.0, 4.0, 0.0], [-4.0, 3.0, 0.0], [0.0, 0.0, -2.0]],
        ..Geometry::default()
    };
    MeshFile {
        mesh: to_physical(&TetMesh { nodes, tets }, [1.0; 3], &geometry),
        point_data: vec![DataArray::scalars("atom_kind", vec![3u8; 8])],
        cell_data: vec![
            DataArray::scalars("region", (1..=6).collect::<Vec<i32>>()),
            DataArray {
                name: "vector".into(),
                components: 3,
                values: vec![0.25f64; 18].into(),
            },
        ],
        field_data: vec![
            ("version".into(), FieldValue::Text("a < b, grün".into())),
            ("none".into(), FieldValue::F64s(vec![])),
            ("seed".into(), FieldValue::Ints(vec![-7])),
        ],
    }
}

#[test]
fn a_legacy_file_of_vtkio_is_read() {
    use vtkio::model::{
        Attribute, Attributes, ByteOrder, CellType, Cells, DataSet, UnstructuredGridPiece, Version,
        VertexNumbers, Vtk,
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tetrahedron.vtk");
    let corners: Vec<f64> = vec![
        6e5,
        7e6,
        0.5,
        6e5,
        7e6,
        1.0,
        6e5,
        7e6 + 1.0,
        0.0,
        6e5 + 1.0,
        7e6,
        0.0,
    ];
    for is_text in [true, false] {
        let piece = UnstructuredGridPiece {
            points: corners.clone().into(),
            cells: Cells {
                cell_verts: VertexNumbers::Legacy {
                    num_cells: 1,
                    vertices: vec![4, 0, 1, 2, 3],
                },
                types: vec![CellType::Tetra],
            },
            data: Attributes {
                point: Vec::new(),
                cell: vec![Attribute::scalars("region", 1).with_data(vec![7i32])],
            },
        };
        let vtk = Vtk {
            version: Version::new_legacy(4, 2),
            title: "a tetrahedron".into(),
            byte_order: ByteOrder::BigEndian,
            file_path: None,
            data: DataSet::inline(piece),
        };
        let written = if is_text {
            vtk.export_ascii(&path)
        } else {
            vtk.export_be(&path)
        };
        written.unwrap();
        let file = VtkFile::read(&path, "UnstructuredGrid").unwrap();
        let piece = file.piece().unwrap();
        let values = |element: &str| {
            let array = &piece.child(element).unwrap().children[0];
            file.array(array).unwrap().values.to_f64()
        };
        assert_eq!(values("Points"), corners);
        assert_eq!(values("CellData"), [7.0]);
        assert_eq!(values("Cells"), [0.0, 1.0, 2.0, 3.0]);
    }
}

#[test]
#[ignore = "needs VTK: make test-all"]
fn vtk_reads_meshes_images_and_traces() {
    let folder = tempfile::tempdir().unwrap();
    let in_folder = |name: &str| folder.path().join(name);
    write_vtu(&in_folder("a.vtu"), &cube()).unwrap();
    write_vtu(&in_folder("empty.vtu"), &MeshFile::<TetMesh>::default()).unwrap();

    let geometry = Geometry {
        origin: [612345.678, 0.5, 3.0],
        axes: [[0.0, 12.5, 0.0], [-25.0, 0.0, 0.0], [0.0, 0.0, -4.0]],
        ..Geometry::default()
    };
    let samples = (0..60).map(|i| i as f32).collect();
    vti::write(
        &in_folder("a.vti"),
        &Image::new([5, 4, 3], samples, geometry),
        "amplitude",
    )
    .unwrap();

    let mut trace = PvdSeries::create(&in_folder("t.pvd")).unwrap();
    let frame = MeshFile {
        mesh: TetMesh {
            nodes: vec![[0.0; 3], [6.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            tets: vec![[0, 1, 2, 3]],
        },
        point_data: Vec::new(),
        cell_data: Vec::new(),
        field_data: vec![("energy".into(), FieldValue::F64s(vec![-0.5]))],
    };
    trace.add(0.0, &frame).unwrap();

    let files = [
        in_folder("a.vtu"),
        in_folder("empty.vtu"),
        in_folder("a.vti"),
        in_folder("t_0000.vtu"),
    ];
    let files: Vec<&Path> = files.iter().map(|f| f.as_path()).collect();
    let stdout = inspect_with_vtk(&files);
    let expected = "\
points 8 cells 6
field version 'a < b, grün'
field none double 0 0
field seed long long 1 -7
point atom_kind unsigned char 8 24
cell region int 6 21
cell vector double 18 4.5
volume 50 positive True
invalid cells 0
points 0 cells 0
volume 0 positive True
invalid cells 0
points 60 cells 24
point amplitude float 60 1770
direction 0 -1 0 1 0 0 0 0 -1
at 2 1 1 612320.678 25.5 -1
points 4 cells 1
field energy double 1 -0.5
volume 1 positive True
invalid cells 0
";
    let plain = stdout.replace("long long", "long");
    assert_eq!(plain, expected.replace("long long", "long"));
}

/// Tests that meshio reads meshes of tetrahedra and of triangles with all their field data.
#[test]
#[ignore = "needs meshio: make test-all"]
fn meshio_reads_meshes_with_their_text() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let dims = [28, 24, 20];
    crate::common::write_npy(
        &folder.join("tetra.npy"),
        dims,
        crate::common::planar_fault(dims),
    );
    crate::common::write_npy_2d(&folder.join("triangle.npy"), [60, 50], |[x, _]| {
        (-0.5 * ((x as f32 - 30.0) / 1.5).powi(2)).exp()
    });
    let program = "\
import json, sys
import meshio
mesh = meshio.read(sys.argv[1])
text = lambda name: bytes(mesh.field_data[name].astype('u1')).decode()
print(json.dumps({
    'points': len(mesh.points), 'cells': sum(len(block.data) for block in mesh.cells),
    'kinds': sorted({block.type.rstrip('0123456789') for block in mesh.cells}),
    'regions': sum(len(part) for part in mesh.cell_data['region']),
    'parameters': text('parameters'), 'sha': len(text('input_sha256')), 'units': text('units')}))";
    for kind in ["tetra", "triangle"] {
        let [image, file] = ["npy", "vtu"].map(|ending| format!("{kind}.{ending}"));
        let mesh = ["mesh", &image, "--distance", "8", "--quiet", "-o", &file];
        crate::common::run_args(folder, &mesh);
        let path = folder.join(&file);
        let result = crate::common::run_vtk_program(program, &[&path]);
        assert_eq!(result["kinds"], serde_json::json!([kind]));
        assert_eq!(result["cells"], result["regions"]);
        assert!(result["points"].as_u64().unwrap() > 40 && result["cells"].as_u64().unwrap() > 20);
        let parameters = result["parameters"].as_str().unwrap();
        assert!(parameters.contains("distance = \"8\""), "{parameters}");
        let units = if kind == "tetra" { ",," } else { "," };
        assert_eq!(
            (&result["sha"], &result["units"]),
            (&64.into(), &units.into())
        );
    }
}
