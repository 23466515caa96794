//! Tests of files with simplices and other cells, ours and those of other programs.

use super::*;
use crate::files::vtk::fixtures::{VARIANTS, fixture};
use crate::mesh::TetMesh;
use crate::store::write_vtu;

fn two_tets() -> MeshFile {
    let nodes = vec![
        [0.1, 612345.678, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0 / 3.0, 0.0],
        [0.0, 0.0, 1e-300],
        [1.0, 1.0, 1.0],
    ];
    MeshFile {
        mesh: TetMesh {
            nodes,
            tets: vec![[0, 1, 2, 3], [1, 2, 3, 4]],
        },
        point_data: vec![
            DataArray::scalars("atom_kind", vec![0u8, 1, 2, 3, 4]),
            DataArray {
                name: "normal".to_string(),
                components: 3,
                values: vec![0.5f32; 15].into(),
            },
        ],
        cell_data: vec![DataArray::scalars(
            "min \"dihedral\"",
            vec![f64::NAN.abs().min(0.1), 2.0],
        )],
        field_data: vec![
            (
                "version".to_string(),
                FieldValue::Text("1 < 2 & ü\n".to_string()),
            ),
            ("empty".to_string(), FieldValue::Text(String::new())),
            ("sigma".to_string(), FieldValue::F64s(vec![0.1, 1e300])),
            ("dims".to_string(), FieldValue::Ints(vec![-1, i64::MAX])),
        ],
    }
}

fn read_error(path: &Path) -> String {
    read_vtu(path).unwrap_err().to_string()
}

#[test]
fn write_then_read_gives_the_same_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vtu");
    for file in [two_tets(), MeshFile::default()] {
        write_vtu(&path, &file).unwrap();
        assert_eq!(read_vtu(&path).unwrap(), file);
        assert_eq!(read_any_vtu(&path).unwrap(), AnyMesh::Tetrahedra(file));
    }
}

#[test]
fn triangles_lie_in_the_plane() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vtu");
    let file = MeshFile {
        mesh: TriMesh {
            nodes: vec![[0.0, 0.1], [1.0, 0.0], [0.0, 1e6], [3.0, 4.0]],
            triangles: vec![[0, 1, 2], [2, 1, 3]],
        },
        point_data: vec![DataArray::scalars("atom_kind", vec![3u8, 3, 3, 3])],
        cell_data: vec![DataArray::scalars("area", vec![0.5f64, 2.0])],
        field_data: Vec::new(),
    };
    write_vtu(&path, &file).unwrap();
    assert_eq!(read_any_vtu(&path).unwrap(), AnyMesh::Triangles(file));
    assert!(read_error(&path).contains("cell 0 is of VTK's type 5"));
}

#[test]
fn every_variant_that_vtk_writes_is_read() {
    for variant in VARIANTS {
        let file = read_vtu(&fixture(&format!("{variant}.vtu"))).unwrap();
        assert_eq!(file.mesh.tets, [[0, 1, 2, 3], [1, 2, 3, 4]], "{variant}");
        assert_eq!(file.mesh.nodes[4], [1.0; 3], "{variant}");
        assert_eq!(file.mesh.nodes[1], [1.0, 0.0, 0.0], "{variant}");
        assert_eq!(
            file.cell_data,
            [DataArray::scalars("quality", vec![0.5f32, -2.0])]
        );
        let note = FieldValue::Text("made by <VTK>".to_string());
        assert_eq!(file.field_data, [("note".to_string(), note)], "{variant}");
    }
    assert!(read_error(&fixture("ascii_none_32_le.vti")).contains("holds ImageData"));
    assert!(read_error(&fixture("legacy_ascii.vtk")).contains("holds ImageData"));
}

/// Legacy files, and polyhedra as VTK stores them since version 9.4.
#[test]
fn cells_of_other_programs_are_read_from_every_kind_of_file() {
    let [x0, x1] = [612345.678, 612346.678];
    for name in ["legacy_tets_ascii.vtk", "legacy_tets_binary.vtk"] {
        let AnyMesh::Tetrahedra(file) = read_any_vtu(&fixture(name)).unwrap() else {
            panic!("{name} holds tetrahedra");
        };
        assert_eq!(file.mesh.tets, [[0, 1, 2, 3], [1, 2, 3, 4]], "{name}");
        assert_eq!(file.mesh.nodes[4], [x1, 1.0, 1.0], "{name}");
        assert_eq!(file.field_data[0].0, "TimeValue", "{name}");
        check_arrays(name, &file);
    }
    for kind in ["polyhedra", "polygons"] {
        for name in [
            format!("{kind}.vtu"),
            format!("legacy_{kind}_ascii.vtk"),
            format!("legacy_{kind}_binary.vtk"),
        ] {
            // Two cells that share a face.
            match read_any_vtu(&fixture(&name)).unwrap() {
                AnyMesh::Polyhedra(file) => {
                    assert_eq!((kind, file.mesh.face_cells.len()), ("polyhedra", 7));
                    assert_eq!(file.mesh.nodes[0], [x0, 0.0, 0.0], "{name}");
                    check_two_cells(&name, &file);
                }
                AnyMesh::Polygons(file) => {
                    assert_eq!((kind, file.mesh.face_cells.len()), ("polygons", 6));
                    assert_eq!(file.mesh.nodes[2], [x1, 1.0], "{name}");
                    check_two_cells(&name, &file);
                }
                _ => panic!("{name} holds {kind}"),
            }
        }
    }
}

/// Checks a file of two cells that share a face, with the arrays that all these files have.
fn check_two_cells<const D: usize>(name: &str, file: &MeshFile<PolyMesh<D>>) {
    assert_eq!(
        (file.mesh.sites.len(), file.mesh.inner_face_count()),
        (2, 1),
        "{name}"
    );
    check_arrays(name, file);
}

/// Checks the arrays that all files of other programs have here.
fn check_arrays<M>(name: &str, file: &MeshFile<M>) {
    let rock = DataArray::scalars("rock type", vec![5i64, -7]);
    assert!(file.cell_data.contains(&rock), "{name}");
    let height = vec![0.0f32, 0.25, 0.5, 0.75, 1.0];
    assert_eq!(
        file.point_data,
        [DataArray::scalars("height", height)],
        "{name}"
    );
    assert_eq!(
        file.field_data[0].1,
        FieldValue::F64s(vec![2.5, 3.5]),
        "{name}"
    );
}

#[test]
fn wrong_and_damaged_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vtu");
    write_vtu(&path, &two_tets()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let data_end = bytes.len() - "\n  </AppendedData>\n</VTKFile>\n".len();
    for end in (0..data_end).step_by(11).chain([data_end - 1]) {
        std::fs::write(&path, &bytes[..end]).unwrap();
        assert!(read_vtu(&path).is_err(), "cut at {end}");
    }
    std::fs::write(&path, "hello").unwrap();
    assert!(read_error(&path).contains("not a VTK XML file"));

    let ascii = |points: &str, cells: &str, connectivity: &str, offsets: &str, types: &str| {
        let text = format!(
            "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>\
             <Piece NumberOfPoints=\"4\" NumberOfCells=\"{cells}\"><Points>\
             <DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">{points}\
             </DataArray></Points><Cells>\
             <DataArray type=\"Int32\" Name=\"connectivity\" format=\"ascii\">{connectivity}</DataArray>\
             <DataArray type=\"Int32\" Name=\"offsets\" format=\"ascii\">{offsets}</DataArray>\
             <DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">{types}</DataArray>\
             </Cells></Piece></UnstructuredGrid></VTKFile>"
        );
        std::fs::write(&path, text).unwrap();
        read_vtu(&path).map_err(|e| e.to_string())
    };
    let xyz = "0 0 0 1 0 0 0 1 0 0 0 1";
    assert_eq!(
        ascii(xyz, "1", "0 1 2 3", "4", "10").unwrap().mesh.tets,
        [[0, 1, 2, 3]]
    );
    for (result, expected) in [
        (
            ascii(xyz, "2", "0 1 2 3 0 1 2", "4 7", "10 5"),
            "cell 1 is of VTK's type 5",
        ),
        (
            ascii(xyz, "1", "0 1 2 4", "4", "10"),
            "node 4, but there are 4 points",
        ),
        (ascii(xyz, "1", "0 1 2 -1", "4", "10"), "node -1"),
        (ascii(xyz, "2", "0 1 2 3", "4", "10"), "has 2 cells"),
        (ascii(xyz, "1", "0 1 2 3", "3", "10"), "1 offsets"),
        (ascii(xyz, "many", "0 1 2 3", "4", "10"), "NumberOfCells"),
        (
            ascii("0 0 0", "1", "0 1 2 3", "4", "10"),
            "3 coordinates for 4 points",
        ),
        (
            ascii("0 0", "1", "0 1 2 3", "4", "10"),
            "2 numbers in tuples of 3",
        ),
        (ascii("0 0 zero", "1", "0 1 2 3", "4", "10"), "'zero'"),
    ] {
        let error = result.unwrap_err();
        assert!(
            error.contains(expected) && error.contains("a.vtu"),
            "{error}"
        );
    }
}

#[test]
fn arrays_of_wrong_length_are_refused_before_writing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vtu");
    let mut file = two_tets();
    file.cell_data.push(DataArray::scalars("short", vec![1u8]));
    let error = write_vtu(&path, &file).unwrap_err().to_string();
    assert!(
        error.contains("'short' has 1 numbers for 2 tetrahedra"),
        "{error}"
    );
    assert!(!path.exists());
}
