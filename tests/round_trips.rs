//! Tests `atomesh export` by our own readers: every format that we read has the mesh that was exported.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::common::{SharedFiles, run, run_args, write_npy, write_npy_2d};
use atomesh::mesh::{Mesh, Simplices};
use atomesh::store::{FieldValue, MeshFile, Storable, read_any_mesh, read_labels};
use atomesh::with_mesh;

/// Names of the sides of the box, in the order of axes.
const SIDES: [&str; 6] = ["xmin", "xmax", "ymin", "ymax", "zmin", "zmax"];

/// Sorted numbers of nodes: a cell or a face.
type Nodes = BTreeSet<u32>;
type Named<T> = BTreeMap<String, BTreeSet<T>>;

/// A mesh, whatever the order of its cells.
struct Content {
    nodes: Vec<Vec<f64>>,
    /// The cells of each region.
    regions: Named<Nodes>,
    /// The faces of all cells, each with the region of its cell.
    faces_of_cells: Vec<(Nodes, String)>,
    /// The faces of each surface within the mesh, and of each set on its boundary.
    faces: Named<Nodes>,
    /// Arrays of nodes that are 0 or 1: the nodes that are 1.
    node_sets: Named<u32>,
}

impl Content {
    fn read(path: &Path) -> Self {
        with_mesh!(read_any_mesh(path).unwrap(),
            simplices file => {
                let nodes = Simplices::connectivity(&file.mesh);
                let cells = nodes.chunks(file.mesh.nodes()[0].len() + 1);
                let without = |cell: &[u32], apex| cell.iter().copied().filter(|n| *n != apex).collect();
                let faces = cells.map(|cell| cell.iter().map(|&apex| without(cell, apex)).collect());
                Self::new(&file, faces.collect())
            },
            cells file => {
                let (faces, of_cells) = (&file.mesh.faces, file.mesh.faces_of_cells());
                let face = |&f: &u32| faces.get(f as usize).iter().copied().collect();
                let faces = (0..of_cells.len()).map(|c| of_cells.get(c).iter().map(face).collect());
                Self::new(&file, faces.collect())
            }
        )
    }

    fn new<const D: usize, M: Storable<D>>(file: &MeshFile<M>, faces: Vec<Vec<Nodes>>) -> Self {
        let nodes_of = |faces: &Vec<Nodes>| faces.iter().flatten().copied().collect();
        let cells: Vec<Nodes> = faces.iter().map(nodes_of).collect();
        let labels = read_labels(file);
        let name = |number: i32| {
            let label = labels.iter().find(|label| label.region == number);
            label.and_then(|label| label.name.clone())
        };
        let (mut regions, mut faces_of_cells) = (Named::new(), Vec::new());
        let numbers = file.mesh.regions(&file.cell_data).unwrap();
        for ((cell, faces), number) in cells.iter().zip(faces).zip(numbers) {
            let name = name(number).unwrap_or_else(|| number.to_string());
            faces_of_cells.extend(faces.into_iter().map(|face| (face, name.clone())));
            regions.entry(name).or_default().insert(cell.clone());
        }
        let names = |field: &str| match file.field_value(field) {
            Some(FieldValue::Text(text)) => text.lines().map(String::from).collect(),
            _ => Vec::new(),
        };
        let numbers = |field: &str| match file.field_value(field) {
            Some(FieldValue::Ints(numbers)) => numbers.iter().map(|&n| n as usize).collect(),
            _ => Vec::new(),
        };
        let mut faces = Named::new();
        let surfaces = names("surface_names");
        for face in numbers("surface_faces").chunks(3) {
            let nodes = cells[face[1]].intersection(&cells[face[2]]).copied();
            let surface = faces.entry(surfaces[face[0] - 1].clone()).or_default();
            surface.insert(nodes.collect());
        }
        let (sets, face_sets) = (names("face_set_names"), numbers("face_sets"));
        let mut rest = &face_sets[..];
        while let [set, count, nodes @ ..] = rest {
            let (face, following) = nodes.split_at(*count);
            let nodes = face.iter().map(|&n| n as u32).collect();
            faces
                .entry(sets[set - 1].clone())
                .or_default()
                .insert(nodes);
            rest = following;
        }
        let node_sets = file.point_data.iter().map(|array| {
            let values = array.values.to_i64().into_iter();
            let members = (0..).zip(values).filter(|(_, value)| *value == 1);
            (array.name.clone(), members.map(|(n, _)| n).collect())
        });
        Self {
            nodes: file.mesh.nodes().iter().map(|x| x.to_vec()).collect(),
            regions,
            faces_of_cells,
            faces,
            node_sets: node_sets.collect(),
        }
    }

    /// Adds the names that an export adds: the sides of the box, and the faces between regions. The
    /// faces of a side are found by the positions of nodes, those between regions by the regions of
    /// the two cells with a face.
    fn with_exported_names(mut self) -> Self {
        let mut regions_of_face: BTreeMap<&Nodes, Vec<&String>> = BTreeMap::new();
        for (face, region) in &self.faces_of_cells {
            regions_of_face.entry(face).or_default().push(region);
        }
        for (face, mut regions) in regions_of_face {
            regions.sort();
            let name = match regions[..] {
                [a, b] if a != b => format!("interface_{a}_{b}"),
                [_] => self.side_of(face).to_string(),
                _ => continue,
            };
            self.faces.entry(name).or_default().insert(face.clone());
        }
        self
    }

    /// Returns the side of the box on which a face of the boundary lies.
    fn side_of(&self, face: &Nodes) -> &'static str {
        let nodes = &self.nodes;
        let is_on = |side: &usize| {
            let coordinates = nodes.iter().map(|x| x[side / 2]);
            let end = match side % 2 {
                0 => coordinates.fold(f64::INFINITY, f64::min),
                _ => coordinates.fold(f64::NEG_INFINITY, f64::max),
            };
            face.iter().all(|&n| nodes[n as usize][side / 2] == end)
        };
        SIDES[(0..2 * nodes[0].len()).find(is_on).unwrap()]
    }
}

/// Returns a folder with meshes of two layers, whose labels have names with blanks: tetrahedra and
/// Voronoi cells with a given fault across them, and triangles.
fn folder_with_all_meshes() -> tempfile::TempDir {
    static FILES: SharedFiles = SharedFiles::new();
    FILES.folder(|folder| {
        let label = |is_low: bool| if is_low { 1.0 } else { 2.0 };
        write_npy(&folder.join("space.npy"), [17, 15, 13], |[_, _, z]| label(z < 6));
        write_npy_2d(&folder.join("plane.npy"), [28, 24], |[x, _]| label(x < 13));
        let fault = "GOCAD TSurf 1\nHEADER {\nname:Main fault\n}\nTFACE\nVRTX 1 100080 0 0\nVRTX 2 100080 140 0\n\
            VRTX 3 100080 140 120\nVRTX 4 100080 0 120\nTRGL 1 2 3\nTRGL 1 3 4\nEND\n";
        std::fs::write(folder.join("fault.ts"), fault).unwrap();
        let mesh = |options: &str| {
            let line = format!("mesh {options} --unit m --feature labels --distance 4 --quiet");
            let mut arguments: Vec<&str> = line.split_whitespace().collect();
            arguments.extend(["--label", "1:name=Base ment", "--label", "2:name=Cover"]);
            run_args(folder, &arguments);
        };
        let space = "space.npy --spacing 10,10,10 --origin 100000,0,0 --surface fault.ts";
        mesh(&format!("{space} -o tets.vtu"));
        mesh(&format!("{space} -o cells.vtu --cells voronoi"));
        mesh("plane.npy --spacing 10,10 -o plane.vtu");
    })
}

/// A format, and what a file of it holds of a mesh.
struct Format {
    name: &'static str,
    ending: &'static str,
    meshes: &'static [&'static str],
    /// `true` if regions and faces have names. Otherwise regions have numbers.
    has_names: bool,
    /// The text before the name of each set of nodes, if there are any.
    node_set_prefix: Option<&'static str>,
    /// `true` if the corners of second-order elements are read.
    has_quadratic: bool,
}

const SIMPLICES: &[&str] = &["tets", "plane"];
const ALL_MESHES: &[&str] = &["tets", "plane", "cells"];

#[rustfmt::skip]
const FORMATS: [Format; 5] = [
    Format { name: "msh", ending: "msh", meshes: SIMPLICES, has_names: true, node_set_prefix: None, has_quadratic: true },
    Format { name: "msh2", ending: "msh", meshes: SIMPLICES, has_names: true, node_set_prefix: None, has_quadratic: true },
    Format { name: "exodus", ending: "exo", meshes: ALL_MESHES, has_names: true, node_set_prefix: Some("node_set:"), has_quadratic: true },
    Format { name: "vtkhdf", ending: "vtkhdf", meshes: ALL_MESHES, has_names: false, node_set_prefix: Some(""), has_quadratic: false },
    Format { name: "geos", ending: "vtu", meshes: &["tets", "cells"], has_names: false, node_set_prefix: Some(""), has_quadratic: false },
];

#[test]
fn every_format_that_is_read_has_the_exported_mesh() {
    let folder = folder_with_all_meshes();
    let folder = folder.path();
    for mesh in ALL_MESHES {
        let original = Content::read(&folder.join(format!("{mesh}.vtu")));
        let given_faces = original
            .faces
            .get("Main fault")
            .cloned()
            .unwrap_or_default();
        assert_eq!(given_faces.is_empty(), *mesh == "plane");
        let expected = original.with_exported_names();
        assert_eq!(expected.regions.len(), 2);
        for format in FORMATS.iter().filter(|format| format.meshes.contains(mesh)) {
            let variants: &[&str] = if format.has_quadratic && *mesh != "cells" {
                &["", "--quadratic"]
            } else {
                &[""]
            };
            for quadratic in variants {
                let file = format!("export.{}", format.ending);
                let context = format!("{mesh} {} {quadratic}", format.name);
                let export = format!("export {mesh}.vtu --to {} -o {file}", format.name);
                run(folder, &format!("{export} {quadratic} --quiet"));
                let read = Content::read(&folder.join(file));
                assert_eq!(read.nodes, expected.nodes, "{context}");
                format.assert_same_groups(&read, &expected, &given_faces, &context);
            }
        }
    }
}

impl Format {
    /// Checks regions, faces and sets of nodes. A face that is in two groups is in the first.
    fn assert_same_groups(
        &self,
        read: &Content,
        expected: &Content,
        given_faces: &BTreeSet<Nodes>,
        context: &str,
    ) {
        if self.has_names {
            assert!(read.regions == expected.regions, "{context}");
            let mut faces = expected.faces.clone();
            for (name, faces) in &mut faces {
                faces.retain(|face| name == "Main fault" || !given_faces.contains(face));
            }
            let names = |faces: &Named<Nodes>| faces.keys().cloned().collect::<Vec<_>>();
            assert_eq!(names(&read.faces), names(&faces), "{context}");
            for (name, faces) in &faces {
                assert_eq!(&read.faces[name], faces, "{context}: {name}");
            }
        } else {
            let numbers: Vec<&str> = read.regions.keys().map(String::as_str).collect();
            assert_eq!(numbers, ["1", "2"], "{context}");
            assert!(
                read.regions.values().eq(expected.regions.values()),
                "{context}"
            );
        }
        let Some(prefix) = self.node_set_prefix else {
            return;
        };
        for (name, faces) in &expected.faces {
            let name = if self.name == "geos" {
                name.replace(' ', "_")
            } else {
                name.clone()
            };
            let nodes: BTreeSet<u32> = faces.iter().flatten().copied().collect();
            assert_eq!(
                read.node_sets[&format!("{prefix}{name}")],
                nodes,
                "{context}: {name}"
            );
        }
    }
}
