//! Tests with small meshes of other programs, as text and as bytes.

use super::*;
use crate::mesh::{Mesh as _, Simplices as _, TetMesh};
use crate::store::named_sets::NamedSet;

/// Two tetrahedra that share a triangle, which is a surface. Node 9 belongs to no cell.
const MSH_V2_TEXT: &str = "$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
3
2 5 \"fault\"
3 1 \"left lung\"
3 2 \"rest\"
$EndPhysicalNames
$Nodes
6
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1
5 0 0 -1
9 7 7 7
$EndNodes
$Elements
4
1 15 2 0 1 9
2 2 2 5 1 1 2 3
3 4 2 1 1 1 2 3 4
4 4 2 2 2 1 2 3 5
$EndElements
";

const MSH_V4_TEXT: &str = "$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
3
2 5 \"fault\"
3 1 \"left lung\"
3 2 \"rest\"
$EndPhysicalNames
$Entities
1 0 1 2
1 7 7 7 0
1 0 0 0 1 1 0 1 5 0
1 0 0 0 1 1 1 1 1 1 1
2 0 0 -1 1 1 0 1 2 1 1
$EndEntities
$Nodes
2 6 1 9
0 1 0 1
9
7 7 7
3 1 0 5
1
2
3
4
5
0 0 0
1 0 0
0 1 0
0 0 1
0 0 -1
$EndNodes
$Elements
3 3 2 4
2 1 2 1
2 1 2 3
3 1 4 1
3 1 2 3 4
3 2 4 1
4 1 2 3 5
$EndElements
";

fn msh_v2_bytes(swap: bool) -> Vec<u8> {
    let mut bytes = b"$MeshFormat\n2.2 1 8\n".to_vec();
    fn push_number<const N: usize>(bytes: &mut Vec<u8>, mut number: [u8; N], swap: bool) {
        if swap {
            number.reverse();
        }
        bytes.extend(number);
    }
    push_number(&mut bytes, 1i32.to_le_bytes(), swap);
    bytes.extend(b"\n$EndMeshFormat\n$Nodes\n5\n");
    let nodes = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
    ];
    for (number, x) in (1i32..).zip(nodes) {
        push_number(&mut bytes, number.to_le_bytes(), swap);
        let _ = x.map(|c: f64| push_number(&mut bytes, c.to_le_bytes(), swap));
    }
    bytes.extend(b"\n$EndNodes\n$Elements\n3\n");
    #[rustfmt::skip]
    let elements: [i32; 25] = [
        2, 1, 2, 1, 5, 1, 1, 2, 3,
        4, 2, 2, 2, 1, 1, 1, 2, 3, 4, 3, 2, 2, 1, 2, 3,
    ];
    let _ = elements.map(|n| push_number(&mut bytes, n.to_le_bytes(), swap));
    push_number(&mut bytes, 5i32.to_le_bytes(), swap);
    bytes.extend(b"\n$EndElements\n");
    bytes
}

/// Reads a mesh of tetrahedra, and the notes on it.
fn noted_tets(bytes: &[u8]) -> (MeshFile<TetMesh>, Vec<String>) {
    match gmsh::read(bytes).and_then(ForeignMesh::into_mesh) {
        Ok((AnyMesh::Tetrahedra(file), notes)) => (file, notes),
        other => panic!("{other:?}"),
    }
}

fn tets(bytes: &[u8]) -> MeshFile<TetMesh> {
    noted_tets(bytes).0
}

/// Returns the names of sets with their members.
fn members(sets: &[NamedSet]) -> Vec<(&str, &[u32])> {
    sets.iter()
        .map(|s| (s.name.as_str(), &s.members[..]))
        .collect()
}

#[test]
fn gmsh_meshes_keep_regions_names_and_surfaces() {
    let files = [
        MSH_V2_TEXT.as_bytes().to_vec(),
        MSH_V4_TEXT.as_bytes().to_vec(),
        msh_v2_bytes(false),
        msh_v2_bytes(true),
    ];
    for (number, bytes) in files.iter().enumerate() {
        let file = tets(bytes);
        assert_eq!(file.mesh.nodes.len(), 5, "{number}");
        assert_eq!(file.mesh.len(), 2, "{number}");
        assert!((0..2).all(|c| file.mesh.volume(c) > 0.16), "{number}");
        let array = |name: &str| file.cell_array(name).unwrap().values.to_i64();
        assert_eq!(array("region"), [1, 2], "{number}");
        for (c, bits) in array("feature_faces").into_iter().enumerate() {
            let k = bits.trailing_zeros() as usize;
            assert_eq!(bits.count_ones(), 1, "{number}");
            let apex = file.mesh.nodes[file.mesh.tets[c][k] as usize];
            assert_eq!(apex[2].abs(), 1.0, "{number}");
        }
        let names: Vec<_> = crate::store::read_labels(&file)
            .into_iter()
            .map(|l| l.name)
            .collect();
        let named = NamedSurfaces::from_file(&file);
        if number < 2 {
            assert_eq!(names, [Some("left lung".into()), Some("rest".into())]);
            assert_eq!(named.names, ["fault"]);
            assert_eq!(named.faces, [([0, 1], 1)]);
        } else {
            assert!(named.names.is_empty());
        }
    }
    let horizon = MSH_V2_TEXT.replace("\"fault\"", "\"Horizon B\"");
    let file = tets(horizon.as_bytes());
    assert_eq!(NamedSurfaces::from_file(&file).names, ["Horizon B"]);
    assert_eq!(
        file.cell_array("horizon_faces").map(|a| &a.values),
        file.cell_array("feature_faces").map(|a| &a.values)
    );
    // The group that our exports call `scraps` is no surface.
    let scraps = MSH_V2_TEXT.replace("\"fault\"", "\"scraps\"");
    assert!(
        NamedSurfaces::from_file(&tets(scraps.as_bytes()))
            .names
            .is_empty()
    );
}

#[test]
fn invalid_named_surfaces_are_ignored() {
    let field = |name: &str, numbers: Vec<i64>| {
        let file = MeshFile {
            field_data: vec![
                ("surface_names".into(), FieldValue::Text(name.into())),
                ("surface_faces".into(), FieldValue::Ints(numbers)),
            ],
            ..MeshFile::<()>::default()
        };
        NamedSurfaces::from_file(&file)
    };
    let surfaces = field("a\nb", vec![2, 0, 1, 2, 1, 5]);
    assert_eq!(
        (surfaces.names.len(), surfaces.surface_between([5, 1])),
        (1, Some(1))
    );
    for numbers in [
        vec![0, 0, 1],
        vec![3, 0, 1],
        vec![1, -1, 1],
        vec![1, 0],
        vec![i64::MAX, 0, 1],
    ] {
        assert_eq!(field("a\nb", numbers), NamedSurfaces::default());
    }
}

#[test]
fn plane_triangles_are_a_mesh_and_others_are_refused() {
    let text = |elements: &str| {
        format!(
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n5\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n5 0 0 1\n\
             $EndNodes\n$Elements\n{elements}$EndElements\n"
        )
    };
    let read =
        |elements: &str| gmsh::read(text(elements).as_bytes()).and_then(ForeignMesh::into_mesh);
    let Ok((AnyMesh::Triangles(file), _)) =
        read("3\n1 1 2 9 1 1 3\n2 2 2 4 1 1 3 2\n3 2 2 6 1 1 3 4\n")
    else {
        panic!("no mesh of the plane");
    };
    assert!((0..2).all(|c| file.mesh.volume(c) == 0.5));
    let edges = file.cell_array("feature_edges").unwrap().values.to_i64();
    assert!(edges.iter().all(|bits| bits.count_ones() == 1), "{edges:?}");
    for (elements, word) in [
        ("1\n1 5 2 1 1 1 2 3 4 1 2 3 4\n", "hexahedra"),
        ("1\n1 2 2 1 1 1 2 5\n", "off the plane"),
        ("1\n1 2 2 1 1 1 2 8\n", "node 8"),
        ("1\n1 1 2 1 1 1 2\n", "neither"),
        ("2\n1 2 2 1 1 1 2 3\n", "where a number should be"),
        ("1\n1 77 2 1 1 1 2 3\n", "type 77"),
        (
            "3\n1 2 2 1 1 1 2 3\n2 2 2 1 1 1 2 3\n3 2 2 1 1 1 2 3\n",
            "share the face",
        ),
    ] {
        let fault = read(elements).unwrap_err();
        assert!(
            fault.problem.contains(word),
            "{elements}: {}",
            fault.problem
        );
    }
    let old = MSH_V4_TEXT.replace("4.1", "4.0");
    assert!(
        gmsh::read(old.as_bytes())
            .unwrap_err()
            .remedy
            .contains("4.1")
    );
}

/// Returns the names of the regions of a mesh, by their numbers.
fn region_names(file: &MeshFile<TetMesh>) -> Vec<(i32, Option<String>)> {
    let labels = crate::store::read_labels(file).into_iter();
    labels.map(|label| (label.region, label.name)).collect()
}

#[test]
fn cells_in_the_same_groups_are_a_region_and_other_groups_are_sets() {
    // Both tetrahedra are in "all", which comes first or last, in one entity or in two elements.
    let v4 = MSH_V4_TEXT
        .replace("$PhysicalNames\n3\n", "$PhysicalNames\n4\n3 7 \"all\"\n")
        .replace("1 0 0 0 1 1 1 1 1 1 1\n", "1 0 0 0 1 1 1 2 7 1 1 1\n")
        .replace("2 0 0 -1 1 1 0 1 2 1 1\n", "2 0 0 -1 1 1 0 2 2 7 1 1\n");
    let v2 = MSH_V2_TEXT
        .replace("$PhysicalNames\n3\n", "$PhysicalNames\n4\n3 7 \"all\"\n")
        .replace(
            "$Elements\n4\n",
            "$Elements\n6\n5 4 2 7 1 1 2 3 4\n6 4 2 7 2 1 2 3 5\n",
        );
    for text in [v4, v2] {
        let (file, notes) = noted_tets(text.as_bytes());
        assert_eq!(file.mesh.len(), 2, "{text}");
        assert_eq!(
            region_names(&file),
            [(1, Some("left lung".into())), (2, Some("rest".into()))]
        );
        let sets = NamedSets::from_file(&file);
        assert_eq!(members(&sets.cells), [("all", &[0, 1][..])]);
        assert!(
            notes
                .iter()
                .any(|note| note.contains("'all' is a set of cells")),
            "{notes:?}"
        );
    }
    // A group that shares one of its two cells is a set, and the region of the other cell is named
    // after it.
    let partial = MSH_V2_TEXT
        .replace("\"rest\"", "\"all\"")
        .replace("$Elements\n4\n", "$Elements\n5\n5 4 2 2 1 1 2 3 4\n");
    let file = tets(partial.as_bytes());
    assert_eq!(
        region_names(&file),
        [(1, Some("left lung".into())), (2, Some("all_1".into()))]
    );
    assert_eq!(
        members(&NamedSets::from_file(&file).cells),
        [("all", &[0, 1][..])]
    );
}

#[test]
fn sets_on_the_boundary_and_of_nodes_are_kept() {
    // A triangle on the boundary, a group of both triangles, an edge and a node.
    let text = MSH_V2_TEXT
        .replace(
            "$PhysicalNames\n3\n",
            "$PhysicalNames\n7\n2 6 \"outer wall\"\n2 8 \"both\"\n1 3 \"edge\"\n0 4 \"tip\"\n",
        )
        .replace(
            "$Elements\n4\n1 15 2 0 1 9\n",
            "$Elements\n9\n1 15 2 4 1 5\n5 2 2 6 2 4 2 1\n6 2 2 8 1 1 2 3\n7 2 2 8 2 1 2 4\n\
             8 1 2 3 1 1 2\n9 2 2 9 3 1 3 5\n",
        );
    let file = tets(text.as_bytes());
    assert_eq!(NamedSurfaces::from_file(&file).names, ["fault"]);
    let sets = NamedSets::from_file(&file);
    assert_eq!(members(&sets.nodes), [("tip", &[4][..]), ("edge", &[0, 1])]);
    let faces: Vec<(&str, usize, &[u32])> = (sets.faces.iter())
        .map(|set| (set.name.as_str(), set.faces.len(), set.faces.get(0)))
        .collect();
    let expected: [(&str, usize, &[u32]); 3] = [
        ("outer wall", 1, &[0, 1, 3]),
        ("both", 2, &[0, 1, 2]),
        ("surface_9", 1, &[0, 2, 4]),
    ];
    assert_eq!(faces, expected);
}

#[test]
fn sections_that_are_not_read_are_named_and_entities_are_needed() {
    let text = MSH_V4_TEXT.to_string() + "$NodeData\n1\n$EndNodeData\n$Periodic\n0\n$EndPeriodic\n";
    let (_, notes) = noted_tets(text.as_bytes());
    assert_eq!(notes, ["not read: $NodeData, $Periodic"]);
    let start = MSH_V4_TEXT.find("$Entities").unwrap();
    let end = MSH_V4_TEXT.find("$Nodes").unwrap();
    let without = [&MSH_V4_TEXT[..start], &MSH_V4_TEXT[end..]].concat();
    let fault = gmsh::read(without.as_bytes()).unwrap_err();
    assert!(
        fault.problem.contains("no section $Entities"),
        "{}",
        fault.problem
    );
}

#[test]
fn cut_files_are_refused_wherever_they_end() {
    let mut all = vec![
        MSH_V2_TEXT.as_bytes().to_vec(),
        MSH_V4_TEXT.as_bytes().to_vec(),
        msh_v2_bytes(false),
    ];
    for bytes in &mut all {
        let length = bytes.len() - b"$EndElements\n".len();
        for end in 12..length {
            let mesh = gmsh::read(&bytes[..end]).and_then(ForeignMesh::into_mesh);
            assert!(mesh.is_err(), "{end} of {length}");
        }
    }
}
