//! Tests `atomesh export` for programs that take meshes: they read the files.

use std::ffi::OsStr;
use std::process::Command;

use crate::common::{
    FAULT_DIMS as DIMS, expect_refusal, folder_with_meshes, is_close, numbers, run, run_args,
    run_simulator, run_validator, run_vtk_program, write_npy, write_npy_2d,
};
use atomesh::store::{AnyMesh, read_any_vtu, read_vtu};

/// Volume of the box.
const VOLUME: f64 = 39.0 * 35.0 * 31.0;

#[test]
#[ignore = "needs Gmsh: make test-all"]
fn gmsh_reads_volumes_regions_and_surfaces() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    // Labels define two regions.
    write_npy(&folder.join("labels.npy"), DIMS, |[_, _, z]| {
        if z < 16 { 1.0 } else { 2.0 }
    });
    let tets = read_vtu(&folder.join("tets.vtu")).unwrap().mesh.tets.len();
    // PFLOTRAN's regions are lists of cells.
    run(
        folder,
        "export tets.vtu --to pflotran -o a.uge --region labels.npy --depth-at-top 9 --quiet",
    );
    let lists = [1, 2].map(|r| std::fs::read_to_string(folder.join(format!("a-region{r}.txt"))));
    let mut cells: Vec<usize> = (lists.iter())
        .flat_map(|list| list.as_ref().unwrap().lines().map(|n| n.parse().unwrap()))
        .collect();
    cells.sort_unstable();
    assert!(cells.into_iter().eq(1..=tets));
    for version in ["msh", "msh2"] {
        let line = format!("export tets.vtu --to {version} -o a.msh --region labels.npy --quiet");
        run(folder, &line);
        let path = folder.join("a.msh");
        let result = run_validator("Gmsh", "physical.py", &[path.as_os_str()]);
        assert_eq!(result["tets"], tets);
        assert!(is_close(result["volume"].as_f64().unwrap(), VOLUME, 1e-12));
        let groups = result["groups"].as_array().unwrap();
        let count = |dim: u64, name: &str| {
            let group = groups.iter().find(|g| g[0] == dim && g[1] == name).unwrap();
            group[2].as_u64().unwrap()
        };
        let total = count(3, "region1") + count(3, "region2");
        assert_eq!(total as usize, tets, "{groups:?}");
        for side in ["xmin", "xmax", "ymin", "ymax", "zmin", "zmax", "fault1"] {
            assert!(count(2, side) > 10, "{groups:?}");
        }
        assert!(count(2, "interface_1_2") > 10, "{groups:?}");
        assert_eq!(groups.len(), 10, "{groups:?}");
    }
}

#[test]
#[ignore = "needs meshio: make test-all"]
fn meshio_reads_medit_tetgen_abaqus_and_nastran() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    let mesh = read_vtu(&folder.join("tets.vtu")).unwrap().mesh;
    for (to, file, format) in [
        ("medit", "a.mesh", "medit"),
        ("tetgen", "a.node", "tetgen"),
        ("inp", "a.inp", "abaqus"),
        ("nastran", "a.bdf", "nastran"),
    ] {
        // Coordinates of NASTRAN have 16 characters.
        let tolerance = if to == "nastran" { 1e-12 } else { 1e-14 };
        run(
            folder,
            &format!("export tets.vtu --to {to} -o {file} --quiet"),
        );
        let path = folder.join(file);
        let arguments = [path.as_os_str(), OsStr::new(format)];
        let result = run_validator("meshio", "simplices.py", &arguments);
        let rows = |name: &str| -> Vec<Vec<f64>> {
            result[name]
                .as_array()
                .unwrap()
                .iter()
                .map(numbers)
                .collect()
        };
        let points = rows("points");
        assert_eq!(points.len(), mesh.nodes.len());
        for (point, node) in points.iter().zip(&mesh.nodes) {
            assert!(
                (0..3).all(|k| is_close(point[k], node[k], tolerance)),
                "{to}"
            );
        }
        let tets: Vec<[u32; 4]> = rows("tets")
            .iter()
            .map(|row| [0, 1, 2, 3].map(|k| row[k] as u32))
            .collect();
        assert_eq!(tets, mesh.tets, "{to}");
        if ["medit", "nastran"].contains(&to) {
            assert!(result["triangles"].as_u64().unwrap() > 100);
        }
    }
}

/// Returns the rows of at least `count` numbers that follow a line with `heading`.
fn number_rows(text: &str, heading: &str, count: usize) -> Vec<Vec<f64>> {
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    let lines = lines.skip_while(|line| !line.starts_with(heading)).skip(1);
    let rows = lines.map_while(|line| {
        let words = line.split([' ', ',']).filter(|word| !word.is_empty());
        words
            .map(|word| word.parse().ok())
            .collect::<Option<Vec<f64>>>()
    });
    rows.filter(|row| row.len() >= count).collect()
}

/// Returns the numbers of the lines of a NASTRAN deck that begin with `card`, in fields of `width`
/// characters.
fn nastran_rows(text: &str, card: &str, width: usize) -> Vec<Vec<f64>> {
    let text = text.replace("\n*       ", "");
    let lines = text.lines().filter_map(|line| line.strip_prefix(card));
    let rows = lines.map(|line| {
        let fields = (0..line.len())
            .step_by(width)
            .map(|i| line[i..line.len().min(i + width)].trim());
        let fields = fields.filter(|field| !field.is_empty());
        fields.map(|field| field.parse().unwrap()).collect()
    });
    rows.collect()
}

#[test]
fn texts_for_meshers_have_the_nodes_tetrahedra_and_sides_of_the_mesh() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    let mesh = read_vtu(&folder.join("tets.vtu")).unwrap().mesh;
    for (to, file) in [
        ("inp", "a.inp"),
        ("medit", "a.mesh"),
        ("tetgen", "a.node"),
        ("nastran", "a.bdf"),
    ] {
        run(
            folder,
            &format!("export tets.vtu --to {to} -o {file} --quiet"),
        );
        let read = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
        let text = read(file);
        // Rows of nodes, tetrahedra and triangles, with the column of the first coordinate, of the first
        // node, and of the first node and the group.
        let (nodes, tets, triangles) = match to {
            "inp" => (
                (number_rows(&text, "*NODE", 4), 1),
                (number_rows(&text, "*ELEMENT", 5), 1),
                (Vec::new(), [0; 2]),
            ),
            "medit" => (
                (number_rows(&text, "Vertices", 4), 0),
                (number_rows(&text, "Tetrahedra", 5), 0),
                (number_rows(&text, "Triangles", 4), [0, 3]),
            ),
            "tetgen" => (
                (number_rows(&text, "", 4), 1),
                (number_rows(&read("a.ele"), "", 5), 1),
                (number_rows(&read("a.face"), "", 5), [1, 4]),
            ),
            _ => (
                (nastran_rows(&text, "GRID*   ", 16), 1),
                (nastran_rows(&text, "CTETRA  ", 8), 2),
                (nastran_rows(&text, "CTRIA3  ", 8), [2, 1]),
            ),
        };
        let (rows, first) = nodes;
        let nodes: Vec<[f64; 3]> = (rows.iter())
            .map(|row| [0, 1, 2].map(|k| row[first + k]))
            .collect();
        assert_eq!(nodes.len(), mesh.nodes.len(), "{to}");
        // Coordinates of NASTRAN have 16 characters.
        let tolerance = if to == "nastran" { 1e-12 } else { 0.0 };
        for (node, expected) in nodes.as_flattened().iter().zip(mesh.nodes.as_flattened()) {
            assert!(
                is_close(*node, *expected, tolerance),
                "{to}: {node} {expected}"
            );
        }
        let (rows, first) = tets;
        let tets: Vec<[u32; 4]> = (rows.iter())
            .map(|row| [0, 1, 2, 3].map(|k| row[first + k] as u32 - 1))
            .collect();
        assert!(tets == mesh.tets, "{to}");
        let (rows, [first, group]) = triangles;
        let mut areas = [0.0; 6];
        for row in rows.iter().filter(|row| row[group] <= 6.0) {
            let [a, b, c] = [0, 1, 2].map(|k| nodes[row[first + k] as usize - 1]);
            let side = row[group] as usize - 1;
            let (k, l) = ((side / 2 + 1) % 3, (side / 2 + 2) % 3);
            let area = (b[k] - a[k]) * (c[l] - a[l]) - (b[l] - a[l]) * (c[k] - a[k]);
            // Triangles point outwards.
            let sign = if side.is_multiple_of(2) { -0.5 } else { 0.5 };
            areas[side] += sign * area;
        }
        let [x, y, z] = [39.0, 35.0, 31.0];
        let expected = [y * z, y * z, z * x, z * x, x * y, x * y];
        for (area, expected) in areas.iter().zip(expected).filter(|_| to != "inp") {
            assert!(is_close(*area, expected, 1e-9), "{to}: {areas:?}");
        }
    }
}

#[test]
#[ignore = "needs meshio: make test-all"]
fn meshio_reads_regions_sides_and_quadratic_elements_of_nastran() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    write_npy(&folder.join("labels.npy"), DIMS, |[_, _, z]| {
        if z < 16 { 1.0 } else { 2.0 }
    });
    let mesh = read_vtu(&folder.join("tets.vtu")).unwrap().mesh;
    let export = "export tets.vtu --to nastran -o a.bdf --region labels.npy --quiet";
    for (option, kinds) in [
        ("", ["tetra", "triangle"]),
        ("--quadratic", ["tetra10", "triangle6"]),
    ] {
        run(folder, format!("{export} {option}").trim());
        let result = run_validator("meshio", "nastran.py", &[folder.join("a.bdf").as_os_str()]);
        let properties = result["properties"].as_object().unwrap();
        assert_eq!(properties.len(), 10, "{result}");
        let number = |name: &str, key: &str| properties[name][key].as_f64().unwrap();
        let regions = ["region1", "region2"];
        let total = |key: &str| number(regions[0], key) + number(regions[1], key);
        assert_eq!(total("cells") as usize, mesh.tets.len());
        assert!(is_close(total("size"), VOLUME, 1e-12), "{result}");
        for region in regions {
            assert!(number(region, "min") > 0.0, "{result}");
            assert_eq!(properties[region]["kind"], kinds[0]);
        }
        let areas = [35.0 * 31.0, 39.0 * 31.0, 39.0 * 35.0];
        // Triangles on the sides of the box face outward.
        let sides = ["xmin", "xmax", "ymin", "ymax", "zmin", "zmax"];
        for (i, side) in sides.into_iter().enumerate() {
            let sign = if i % 2 == 0 { -1.0 } else { 1.0 };
            let vector = numbers(&properties[side]["vector"]);
            assert!(
                is_close(vector[i / 2], sign * areas[i / 2], 1e-12),
                "{side}: {result}"
            );
            assert_eq!(properties[side]["kind"], kinds[1]);
        }
        for name in ["fault1", "interface_1_2"] {
            assert!(number(name, "cells") > 10.0, "{result}");
        }
        assert!(result["distance"].as_f64().unwrap() < 1e-12, "{result}");
        assert_eq!(result["nodes"] == mesh.nodes.len(), option.is_empty());
    }
}

#[test]
#[ignore = "needs CalculiX: make test-all"]
fn calculix_solves_a_linear_displacement_exactly_and_conserves_the_volume() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    run(folder, "export tets.vtu --to inp -o mesh.inp --quiet");
    // The displacement of one side gives a linear displacement, which linear tetrahedra represent
    // exactly.
    let job = "*INCLUDE, INPUT=mesh.inp\n*MATERIAL, NAME=ROCK\n*ELASTIC\n1E9, 0.0\n\
               *SOLID SECTION, ELSET=EALL, MATERIAL=ROCK\n*STEP\n*STATIC\n*BOUNDARY\n\
               NXMIN, 1, 1, 0.0\nNYMIN, 2, 2, 0.0\nNZMIN, 3, 3, 0.0\nNXMAX, 1, 1, 0.39\n\
               *NODE PRINT, NSET=NALL\nU\n*EL PRINT, ELSET=EALL, TOTALS=ONLY\nEVOL\n*END STEP\n";
    std::fs::write(folder.join("job.inp"), job).unwrap();
    let mut ccx = Command::new("ccx");
    ccx.current_dir(folder).arg("job");
    run_simulator(&mut ccx);
    let nodes = read_vtu(&folder.join("tets.vtu")).unwrap().mesh.nodes;
    let displacements = std::fs::read_to_string(folder.join("job.dat")).unwrap();
    let mut displaced = 0;
    for line in displacements.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        if let [node, x, _, _] = words[..]
            && let (Ok(node), Ok(x)) = (node.parse::<usize>(), x.parse::<f64>())
        {
            assert!((x - 0.01 * nodes[node - 1][0]).abs() < 1e-6, "{line}");
            displaced += 1;
        }
    }
    assert_eq!(displaced, nodes.len());
    let volume = displacements
        .lines()
        .last()
        .unwrap()
        .trim()
        .parse::<f64>()
        .unwrap();
    assert!(is_close(volume, VOLUME, 1e-5), "{volume}");
}

#[test]
#[ignore = "needs CalculiX: make test-all"]
fn calculix_reads_coordinates_of_any_length() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    let export = "export tets.vtu --to inp -o mesh.inp --length-unit um --quiet";
    run(folder, export);
    let job = "*INCLUDE, INPUT=mesh.inp\n*MATERIAL, NAME=ROCK\n*ELASTIC\n1E9, 0.0\n\
               *SOLID SECTION, ELSET=EALL, MATERIAL=ROCK\n*STEP\n*STATIC\n*BOUNDARY\n\
               NXMIN, 1, 3, 0.0\n*EL PRINT, ELSET=EALL, TOTALS=ONLY\nEVOL\n*END STEP\n";
    std::fs::write(folder.join("job.inp"), job).unwrap();
    let mut ccx = Command::new("ccx");
    ccx.current_dir(folder).arg("job");
    run_simulator(&mut ccx);
    let displacements = std::fs::read_to_string(folder.join("job.dat")).unwrap();
    let volume = displacements
        .lines()
        .last()
        .unwrap()
        .trim()
        .parse::<f64>()
        .unwrap();
    assert!(is_close(volume, 1e-18 * VOLUME, 1e-5), "{volume}");
}

#[test]
#[ignore = "needs Gmsh and CalculiX: make test-all"]
fn quadratic_elements_are_valid_in_gmsh_and_exact_in_calculix() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    for version in ["msh", "msh2"] {
        run(
            folder,
            &format!("export tets.vtu --to {version} -o a.msh --quadratic --quiet"),
        );
        let path = folder.join("a.msh");
        let result = run_validator("Gmsh", "quadratic.py", &[path.as_os_str()]);
        // In straight elements the Jacobians at all Gauss points equal those at the corners, but
        // only if every mid-edge node is at the position that its place in the list of nodes
        // requires.
        assert!(is_close(result["volume"].as_f64().unwrap(), VOLUME, 1e-9));
        assert!(result["spread"].as_f64().unwrap() < 1e-9, "{result}");
        assert!(result["triangles"].as_u64().unwrap() > 100);
    }
    run(
        folder,
        "export tets.vtu --to inp -o mesh.inp --quadratic --quiet",
    );
    // A body force of 2 along x with the side x = 0 fixed has the solution u = x (39 - x / 2) 2 /
    // E.
    let job = "*INCLUDE, INPUT=mesh.inp\n*MATERIAL, NAME=ROCK\n*ELASTIC\n2.0, 0.0\n*DENSITY\n1.0\n\
               *SOLID SECTION, ELSET=EALL, MATERIAL=ROCK\n*STEP\n*STATIC\n*BOUNDARY\n\
               NXMIN, 1, 1, 0.0\nNYMIN, 2, 2, 0.0\nNZMIN, 3, 3, 0.0\n*DLOAD\nEALL, GRAV, 2.0, 1., 0., 0.\n\
               *NODE PRINT, NSET=NALL\nU\n*END STEP\n";
    std::fs::write(folder.join("job.inp"), job).unwrap();
    let mut ccx = Command::new("ccx");
    ccx.current_dir(folder).arg("job");
    run_simulator(&mut ccx);
    let text = std::fs::read_to_string(folder.join("mesh.inp")).unwrap();
    let nodes = text
        .lines()
        .skip(1)
        .take_while(|line| !line.starts_with('*'));
    let x: Vec<f64> = nodes
        .map(|line| line.split(", ").nth(1).unwrap().parse().unwrap())
        .collect();
    let displacements = std::fs::read_to_string(folder.join("job.dat")).unwrap();
    let mut displaced = 0;
    for line in displacements.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        if let [node, u, _, _] = words[..]
            && let (Ok(node), Ok(u)) = (node.parse::<usize>(), u.parse::<f64>())
        {
            let x = x[node - 1];
            let expected = x * (39.0 - 0.5 * x);
            assert!((u - expected).abs() < 1e-3, "{line}: {expected}");
            displaced += 1;
        }
    }
    assert_eq!(displaced, x.len());
}

#[test]
fn exported_surfaces_of_any_cells_enclose_the_box() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    for mesh in ["cells", "tets"] {
        run(
            folder,
            &format!("export {mesh}.vtu --to stl -o {mesh}.stl --quiet"),
        );
        let text = std::fs::read_to_string(folder.join(format!("{mesh}.stl"))).unwrap();
        let (mut volume, mut corners, mut inside) = (0.0, Vec::new(), true);
        for line in text.lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            match words[..] {
                // Faces on the sides point outwards, so that the volumes of their pyramids add up
                // to that of the box.
                ["solid", name] => inside = ["fault1", "scraps"].contains(&name),
                ["vertex", x, y, z] => corners.push([x, y, z].map(|c| c.parse::<f64>().unwrap())),
                ["endfacet"] => {
                    if !inside {
                        let [a, b, c] = corners[..] else {
                            panic!("{line}")
                        };
                        volume += origin_tet_volume(a, b, c);
                    }
                    corners.clear();
                }
                _ => {}
            }
        }
        assert!(is_close(volume, VOLUME, 1e-12), "{volume}");
        assert!(text.contains("solid fault1"));
        run(
            folder,
            &format!("export {mesh}.vtu --to obj -o {mesh}.obj --quiet"),
        );
        let text = std::fs::read_to_string(folder.join(format!("{mesh}.obj"))).unwrap();
        assert_eq!(text.lines().filter(|l| l.starts_with("g ")).count(), 7);
    }
}

/// Formats of the model that [`consumers_of_all_formats_read_the_same_model`] writes, and its files.
const CONSUMER_FORMATS: [(&str, &str); 13] = [
    ("msh", "m4.msh"),
    ("msh2", "m2.msh"),
    ("inp", "m.inp"),
    ("xdmf", "m.xdmf"),
    ("medit", "m.mesh"),
    ("vtkhdf", "m.vtkhdf"),
    ("geos", "m-geos.vtu"),
    ("exodus", "m.exo"),
    ("cgns", "m.cgns"),
    ("openfoam", "foam"),
    ("nastran", "m.bdf"),
    ("stl", "m.stl"),
    ("obj", "m.obj"),
];

/// Writes a model at UTM coordinates in all formats: a body in a host rock above a basement, with names,
/// in samples of 10 x 12 x 8 m, and a given fault.
fn write_consumer_model(folder: &std::path::Path) {
    write_npy(&folder.join("labels.npy"), [31, 27, 25], |[x, y, z]| {
        let [u, v, w] = [x, y, z].map(|i| i as f64);
        let body = (u - 19.0).powi(2) / 49.0 + (v - 11.0).powi(2) / 49.0;
        match () {
            () if body + (w - 15.0).powi(2) / 36.0 < 1.0 => 2.0,
            () if z < 7 => 3.0,
            () => 1.0,
        }
    });
    let mut fault = String::from("GOCAD TSurf 1\nHEADER {\nname:Main fault\n}\nTFACE\n");
    let corners = [[0.0, 9.0], [26.0, 9.0], [26.0, 24.0], [0.0, 24.0]];
    for (i, [v, w]) in (1..).zip(corners) {
        let (x, y, z) = (50.0 + 2.0 * w, 12.0 * v, 8.0 * w - 2000.0);
        fault += &format!("VRTX {i} {} {} {z}\n", 450_000.0 + x, 6_780_000.0 + y);
    }
    fault += "TRGL 1 2 3\nTRGL 1 3 4\nEND\n";
    std::fs::write(folder.join("fault.ts"), fault).unwrap();
    let mut arguments: Vec<&str> =
        "mesh labels.npy --spacing 10,12,8 --origin 450000,6780000,-2000 --unit m \
         --feature labels --surface fault.ts --distance 4 -o m.vtu --quiet"
            .split_whitespace()
            .collect();
    for label in ["1:name=Host rock", "2:name=Ore body", "3:name=Basement"] {
        arguments.extend(["--label", label]);
    }
    run_args(folder, &arguments);
    for (format, file) in CONSUMER_FORMATS {
        run(
            folder,
            &format!("export m.vtu --to {format} -o {file} --quiet"),
        );
    }
}

/// Readers are those of `scripts/validators.sh`, and others whose modules are in the same environment.
#[test]
#[ignore = "needs Gmsh, meshio, VTK, toughio, CalculiX and OpenFOAM: make test-all"]
fn consumers_of_all_formats_read_the_same_model() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_consumer_model(folder);
    let results = run_validator("meshio", "consumers.py", &[folder.as_os_str()]);
    let results = results.as_object().unwrap();
    let plain = |name: &str| name.to_lowercase().replace(' ', "_");
    let sizes = |result: &serde_json::Value, key: &str, size: fn(&serde_json::Value) -> f64| {
        let items = result[key].as_object().into_iter().flatten();
        let items = items.map(|(name, value)| (plain(name), size(value)));
        items.collect::<std::collections::BTreeMap<String, f64>>()
    };
    let volumes = |result| sizes(result, "regions", |v| v.as_f64().unwrap());
    let areas = |result| sizes(result, "surfaces", |v| v["area"].as_f64().unwrap());
    let enclosed = |result| sizes(result, "surfaces", |v| v["volume"].as_f64().unwrap());
    let expected = &results["Gmsh, msh"];
    let (regions, faces) = (volumes(expected), areas(expected));
    assert_eq!(regions.len(), 3, "{expected}");
    let total = 300.0 * 312.0 * 192.0;
    assert!(is_close(regions.values().sum(), total, 1e-9), "{expected}");
    assert!(is_close(faces["xmin"], 312.0 * 192.0, 1e-9), "{expected}");
    let body = enclosed(expected)["interface_host_rock_ore_body"];
    assert!(is_close(body, regions["ore_body"], 1e-6), "{expected}");
    let mut right = Vec::new();
    for (reader, result) in results {
        assert!(result["error"].is_null(), "{reader}: {result}");
        // VTK reads these with single precision, netgen cuts names off at blanks, facets of scikit-fem
        // have no direction, and an OBJ is one surface for PyMeshLab.
        let tolerance = if ["VTK, exodus", "VTK, stl"].contains(&reader.as_str()) {
            1e-3
        } else {
            1e-6
        };
        if reader.starts_with("Netgen") || reader.starts_with("PyMeshLab") {
            continue;
        }
        let check = |found: std::collections::BTreeMap<String, f64>,
                     expected: &std::collections::BTreeMap<String, f64>| {
            for (name, value) in &found {
                let is_right = expected
                    .get(name)
                    .is_some_and(|e| is_close(*e, *value, tolerance));
                assert!(is_right, "{reader}: {name} {value}: {expected:?}");
            }
            assert!(
                found.is_empty() || found.len() == expected.len(),
                "{reader}: {found:?}"
            );
            found.len()
        };
        let mut count = check(volumes(result), &regions) + check(areas(result), &faces);
        if !reader.starts_with("scikit-fem") {
            count += check(enclosed(result), &enclosed(expected));
        }
        assert!(count > 0, "{reader}: {result}");
        right.push(reader);
    }
    assert!(right.len() >= 12, "{right:?}");
}

/// Returns the volume of a tetrahedron whose first corner is the origin.
fn origin_tet_volume(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> f64 {
    let cross = |k: usize| {
        let (l, m) = ((k + 1) % 3, (k + 2) % 3);
        b[l] * c[m] - b[m] * c[l]
    };
    (0..3).map(|k| a[k] * cross(k)).sum::<f64>() / 6.0
}

/// Writes meshes, and an image of two labels.
fn folder_with_labels() -> tempfile::TempDir {
    let folder = folder_with_meshes();
    write_npy(&folder.path().join("labels.npy"), DIMS, |[_, _, z]| {
        if z < 16 { 1.0 } else { 2.0 }
    });
    folder
}

/// Formats and meshes, with the names that VTK gives to the cells and to the sets of faces.
const NAMES_IN_VTK: [(&str, &str, &str, &str); 7] = [
    (
        "exodus:exo",
        "tets",
        "/Element Blocks/region",
        "/Side Sets/",
    ),
    // VTK does not read side sets of polyhedra.
    (
        "exodus:exo",
        "cells",
        "/Element Blocks/region",
        "/Node Sets/",
    ),
    (
        "cgns:cgns",
        "tets",
        "/Base/Zone/Internal",
        "/Base/Zone/Patches/",
    ),
    (
        "cgns:cgns",
        "cells",
        "/Base/Zone/Internal",
        "/Base/Zone/Patches/",
    ),
    ("xdmf:xdmf", "tets", "/cells/Data", "/"),
    ("vtkhdf:vtkhdf", "tets", "", ""),
    ("vtkhdf:vtkhdf", "cells", "", ""),
];

#[test]
#[ignore = "needs VTK: make test-all"]
fn vtk_reads_exodus_vtkhdf_xdmf_and_cgns_with_names_and_regions() {
    let folder = folder_with_labels();
    let folder = folder.path();
    let count = read_vtu(&folder.join("tets.vtu")).unwrap().mesh.tets.len();
    for (to, mesh, cells, side) in NAMES_IN_VTK {
        let (format, ending) = to.split_once(':').unwrap();
        let file = format!("a.{ending}");
        let rock = "--region labels.npy --quiet";
        run(
            folder,
            &format!("export {mesh}.vtu --to {format} -o {file} {rock}"),
        );
        let path = folder.join(if format == "xdmf" {
            "a_names.xdmf"
        } else {
            &file
        });
        let result = run_validator("VTK", "sets.py", &[path.as_os_str()]);
        let result = result.as_array().unwrap();
        let named = |start: &str| -> Vec<&serde_json::Value> {
            let matches =
                |part: &&serde_json::Value| part["name"].as_str().unwrap().starts_with(start);
            result.iter().filter(matches).collect()
        };
        let sum = |parts: &[&serde_json::Value], key: &str| -> f64 {
            parts.iter().map(|part| part[key].as_f64().unwrap()).sum()
        };
        let cell_blocks = named(cells);
        assert_eq!(
            cell_blocks.len(),
            if format == "exodus" { 2 } else { 1 },
            "{to}"
        );
        // VTK's volumes of polyhedra with slightly warped faces are less accurate.
        let tolerance = if mesh == "tets" { 1e-12 } else { 1e-7 };
        assert!(
            is_close(sum(&cell_blocks, "volume"), VOLUME, tolerance),
            "{to} {mesh}"
        );
        if mesh == "tets" {
            assert_eq!(sum(&cell_blocks, "cells") as usize, count, "{to}");
        }
        let regions: f64 = cell_blocks
            .iter()
            .map(|part| part["values"]["region"].as_f64().unwrap())
            .sum();
        let mean = regions / sum(&cell_blocks, "cells");
        assert!(mean > 1.3 && mean < 1.7, "{to} {mesh}: {mean}");
        let names = ["xmin", "ymax", "fault1", "interface_1_2"];
        for name in names {
            if format == "vtkhdf" {
                let members = cell_blocks[0]["sets"][name].as_u64().unwrap_or(0);
                assert!(members > 10, "{to} {mesh} {name}");
                continue;
            }
            let part = named(&format!("{side}{name}"));
            assert_eq!(part.len(), 1, "{to} {mesh} {name}");
            if name == "xmin" && !side.contains("Node") {
                assert!(
                    is_close(sum(&part, "area"), 35.0 * 31.0, 1e-9),
                    "{to} {mesh}"
                );
            }
            assert!(
                part[0]["cells"].as_u64().unwrap() > 10,
                "{to} {mesh} {name}"
            );
        }
    }
}

#[test]
#[ignore = "needs SciPy: make test-all"]
fn scipy_reads_exodus_files_of_polyhedra() {
    let folder = folder_with_labels();
    let folder = folder.path();
    let path = folder.join("a.exo");
    run(
        folder,
        "export cells.vtu --to exodus -o a.exo --region labels.npy --quiet",
    );
    let result = run_validator("SciPy", "exodus.py", &[path.as_os_str()]);
    let AnyMesh::Polyhedra(cells) = read_any_vtu(&folder.join("cells.vtu")).unwrap() else {
        panic!("no polyhedra")
    };
    let mesh = cells.mesh;
    assert_eq!(result["blocks"], serde_json::json!(["region1", "region2"]));
    assert_eq!(result["numbers"], serde_json::json!([1, 2]));
    assert_eq!(result["cells"], mesh.sites.len());
    assert_eq!(result["faces"], mesh.face_cells.len());
    assert_eq!(result["owners"], serde_json::json!([1, 2]));
    assert_eq!(result["map"], true);
    let sets = result["sets"].as_object().unwrap();
    assert!(sets.values().all(|set| set["same"] == true), "{result}");
    for (name, area) in [
        ("xmin", 35.0 * 31.0),
        ("ymax", 39.0 * 31.0),
        ("zmin", 39.0 * 35.0),
    ] {
        assert!(
            is_close(sets[name]["area"].as_f64().unwrap(), area, 1e-9),
            "{name}"
        );
    }
    let feature_faces = mesh
        .on_feature
        .iter()
        .filter(|feature_faces| **feature_faces)
        .count() as u64;
    let named = |name: &str| {
        sets.get(name)
            .map_or(0, |set| set["faces"].as_u64().unwrap())
    };
    assert_eq!(named("fault1") + named("scraps"), feature_faces);
    assert!(
        named("fault1") > 50 && named("interface_1_2") > 10,
        "{result}"
    );
}

#[test]
#[ignore = "needs pyfebio: make test-all"]
fn pyfebio_reads_parts_surfaces_and_quadratic_elements() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("labels.npy"), DIMS, |[_, _, z]| {
        if z < 16 { 1.0 } else { 2.0 }
    });
    // pyfebio is slow, so that the mesh is coarse.
    run(
        folder,
        "mesh labels.npy --feature labels --distance 10 -o tets.vtu --quiet",
    );
    let count = read_vtu(&folder.join("tets.vtu")).unwrap().mesh.nodes.len();
    for (options, kind) in [
        ("", "tet4"),
        ("--quadratic", "tet10"),
        ("--quadratic --split all", "tet10"),
    ] {
        let export = "export tets.vtu --to febio -o a.feb --quiet";
        run(folder, &format!("{export} {options}"));
        let path = folder.join("a.feb");
        let result = run_validator("pyfebio", "febio.py", &[path.as_os_str()]);
        let parts = result["parts"].as_object().unwrap();
        assert_eq!(parts.len(), 2, "{result}");
        let mut volume = 0.0;
        for (name, part) in parts {
            assert_eq!(part["type"], kind);
            assert!(part["least"].as_f64().unwrap() > 0.0, "{name}: {part}");
            assert!(part["middle"].as_f64().unwrap() < 1e-9, "{name}: {part}");
            volume += part["volume"].as_f64().unwrap();
        }
        assert!(is_close(volume, VOLUME, 1e-9), "{volume}");
        let names: Vec<&String> = parts.keys().collect();
        for key in ["domains", "materials"] {
            let list = result[key].as_array().unwrap();
            assert!(names.iter().all(|name| list.iter().any(|n| n == *name)));
        }
        let surfaces = result["surfaces"].as_object().unwrap();
        let [x, y, z] = [39.0, 35.0, 31.0];
        for (side, area) in [("xmin", y * z), ("ymax", z * x), ("zmin", x * y)] {
            assert!(is_close(
                surfaces[side]["area"].as_f64().unwrap(),
                area,
                1e-9
            ));
            let out = numbers(&surfaces[side]["vector"]);
            let axis = "xyz".find(&side[..1]).unwrap();
            let sign = if side.ends_with("min") { -1.0 } else { 1.0 };
            assert!(is_close(out[axis], sign * area, 1e-9), "{side}: {out:?}");
            let set = format!("nodes_{side}");
            assert!(result["node_sets"][&set].as_u64().unwrap() > 8, "{result}");
        }
        let nodes = result["nodes"].as_u64().unwrap() as usize;
        assert_eq!(nodes > count, !options.is_empty());
        if options.contains("split") {
            let sides = ["interface_1_2_a", "interface_1_2_b"];
            let [a, b] = sides.map(|name| numbers(&surfaces[name]["vector"]));
            // The two sides look at each other.
            assert!((0..3).all(|k| (a[k] + b[k]).abs() < 1e-9), "{a:?} {b:?}");
        } else {
            assert!(surfaces.contains_key("interface_1_2"), "{result}");
        }
    }
}

#[test]
fn quadratic_meshes_are_split_with_the_nodes_in_the_middle_of_edges() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    run(
        folder,
        "export tets.vtu --to inp -o a.inp --split faults --quadratic --quiet",
    );
    assert!(!folder.join("a-cohesive.inp").exists());
    let text = std::fs::read_to_string(folder.join("a.inp")).unwrap();
    let nodes: Vec<[f64; 3]> = (number_rows(&text, "*NODE", 4).iter())
        .map(|row| [row[1], row[2], row[3]])
        .collect();
    let cells = number_rows(&text, "*ELEMENT", 11);
    // Each node is one of a cell, and each face has two cells, or lies on the box or on the fault.
    let mut faces = std::collections::BTreeMap::<Vec<usize>, usize>::new();
    let mut is_used = vec![false; nodes.len()];
    for cell in &cells {
        let cell: Vec<usize> = cell[1..].iter().map(|&n| n as usize - 1).collect();
        cell.iter().for_each(|&n| is_used[n] = true);
        // Corners, and the nodes in the middle of their edges.
        for face in [
            [0, 1, 2, 4, 5, 6],
            [0, 1, 3, 4, 8, 7],
            [1, 2, 3, 5, 9, 8],
            [0, 2, 3, 6, 9, 7],
        ] {
            let mut face = face.map(|k| cell[k]).to_vec();
            face.sort_unstable();
            *faces.entry(face).or_default() += 1;
        }
    }
    assert!(is_used.iter().all(|&is_used| is_used));
    let on_box = |face: &Vec<usize>| {
        [39.0, 35.0, 31.0].iter().enumerate().any(|(k, &high)| {
            [0.0, high]
                .iter()
                .any(|plane| face.iter().all(|&n| (nodes[n][k] - plane).abs() < 1e-9))
        })
    };
    let open: Vec<&Vec<usize>> = faces
        .iter()
        .filter(|(_, n)| **n == 1)
        .map(|(f, _)| f)
        .collect();
    let torn = open.iter().filter(|face| !on_box(face)).count();
    let table = std::fs::read_to_string(folder.join("a-twins.csv")).unwrap();
    assert!(table.starts_with("surface,cell_a,cell_b,a1,a2,a3,a4,a5,a6,b1,b2,b3,b4,b5,b6\n"));
    let mut split_faces = 0;
    for line in table.lines().skip(1) {
        let numbers: Vec<usize> = line
            .split(',')
            .skip(3)
            .map(|n| n.parse().unwrap())
            .collect();
        for (a, b) in numbers[..6].iter().zip(&numbers[6..]) {
            assert_eq!(nodes[a - 1], nodes[b - 1], "{line}");
        }
        split_faces += usize::from(numbers[..6] != numbers[6..]);
    }
    assert!(split_faces > 50);
    // A face with a shared node in each place is not open.
    assert_eq!(torn, 2 * split_faces);
}

/// Makes a periodic mesh of two layers normal to z, of 9 and 15 of 24 samples.
fn write_periodic_laminate(folder: &std::path::Path) {
    write_npy(&folder.join("layers.npy"), [17, 15, 25], |[_, _, z]| {
        f32::from(u8::from((7..16).contains(&(z % 24)))) + 1.0
    });
    run(
        folder,
        "mesh layers.npy --feature labels --periodic x,y,z --distance 4 -o cell.vtu --quiet",
    );
}

#[test]
#[ignore = "needs Gmsh: make test-all"]
fn gmsh_reads_the_periodic_sides_of_a_cell() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_periodic_laminate(folder);
    // Gmsh ignores the pairs in files of version 2.2, also in its own.
    for options in ["--to msh", "--to msh --quadratic"] {
        run(
            folder,
            &format!("export cell.vtu {options} -o a.msh --quiet"),
        );
        let path = folder.join("a.msh");
        let sides = run_validator("Gmsh", "periodic.py", &[path.as_os_str()]);
        let sides = sides.as_array().unwrap();
        assert_eq!(sides.len(), 3, "{options}: {sides:?}");
        let periods = [("x", 16.0), ("y", 14.0), ("z", 24.0)];
        for (side, (k, (axis, period))) in sides.iter().zip(periods.iter().enumerate()) {
            assert_eq!(side["side"], format!("{axis}max"));
            assert_eq!(side["master"], format!("{axis}min"));
            assert_eq!(side["pairs"], side["nodes"], "{options}: {side}");
            assert!(side["gap"].as_f64().unwrap() < 1e-12, "{side}");
            assert_eq!(numbers(&side["shift"])[k], *period, "{side}");
        }
    }
}

#[test]
#[ignore = "needs CalculiX: make test-all"]
fn calculix_homogenises_a_periodic_laminate() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_periodic_laminate(folder);
    for (options, tolerance) in [("", 5e-3), ("--quadratic", 5e-3)] {
        run(
            folder,
            &format!("export cell.vtu --to inp -o cell.inp {options} --quiet"),
        );
        let text = std::fs::read_to_string(folder.join("cell.inp")).unwrap();
        let nodes = number_rows(&text, "*NODE", 4);
        let origin = nodes.iter().find(|row| row[1..4] == [0.0; 3]).unwrap()[0];
        // Young's moduli 1 and 10 without lateral contraction: the means along the layers are
        // arithmetic, and harmonic across them.
        let (thin, thick) = (9.0 / 24.0, 15.0 / 24.0);
        let along = 10.0 * thin + thick;
        let across = 1.0 / (thin / 10.0 + thick);
        let sides = [
            ("X", 16.0, along, 14.0 * 24.0),
            ("Z", 24.0, across, 16.0 * 14.0),
        ];
        for (axis, period, expected, area) in sides {
            let component = if axis == "X" { 1 } else { 3 };
            let mut job =
                String::from("*INCLUDE, INPUT=cell.inp\n*INCLUDE, INPUT=cell-periodic.inp\n");
            for (region, modulus) in [(1, 1.0), (2, 10.0)] {
                job += &format!(
                    "*MATERIAL, NAME=M{region}\n*ELASTIC\n{modulus}, 0.0\n*SOLID SECTION, ELSET=REGION{region}, MATERIAL=M{region}\n"
                );
            }
            job += &format!("*STEP\n*STATIC\n*BOUNDARY\n{origin}, 1, 3, 0.0\n");
            for name in ["X", "Y", "Z"] {
                for k in 1..=3 {
                    let value = if name == axis && k == component {
                        0.01 * period
                    } else {
                        0.0
                    };
                    job += &format!("NPERIODIC_{name}, {k}, {k}, {value}\n");
                }
            }
            job += &format!("*NODE PRINT, NSET=N{axis}MAX, TOTALS=ONLY\nRF\n*END STEP\n");
            std::fs::write(folder.join("job.inp"), job).unwrap();
            let mut ccx = Command::new("ccx");
            ccx.current_dir(folder).arg("job");
            run_simulator(&mut ccx);
            let data = std::fs::read_to_string(folder.join("job.dat")).unwrap();
            let line = data.lines().rfind(|line| !line.trim().is_empty()).unwrap();
            let forces: Vec<f64> = line
                .split_whitespace()
                .map(|w| w.parse().unwrap())
                .collect();
            let modulus = forces[component - 1] / (0.01 * area);
            assert!(
                is_close(modulus, expected, tolerance),
                "{axis} {options}: {modulus} {expected}"
            );
        }
    }
}

#[test]
#[ignore = "needs VTK: make test-all"]
fn vtk_reads_split_and_quadratic_meshes() {
    let folder = folder_with_meshes();
    let folder = folder.path();
    let count = read_vtu(&folder.join("tets.vtu")).unwrap().mesh.tets.len();
    // Split meshes have wedges between the two sides, and quadratic ones have nodes in the middle
    // of edges.
    run(
        folder,
        "export tets.vtu --to exodus -o b.exo --split 1 --quiet",
    );
    run(
        folder,
        "export tets.vtu --to vtkhdf -o c.vtkhdf --quadratic --quiet",
    );
    let read = |file: &str| run_validator("VTK", "sets.py", &[folder.join(file).as_os_str()]);
    let split = read("b.exo");
    let part = |name: &str| {
        split
            .as_array()
            .unwrap()
            .iter()
            .find(|part| part["name"] == name)
            .unwrap()
    };
    let wedges = &part("/Element Blocks/fault1");
    assert!(wedges["volume"].as_f64().unwrap() < 1e-12);
    for side in ["/Side Sets/fault1_a", "/Side Sets/fault1_b"] {
        assert_eq!(part(side)["cells"], wedges["cells"]);
    }
    let quadratic = &read("c.vtkhdf")[0];
    assert!(is_close(
        quadratic["volume"].as_f64().unwrap(),
        VOLUME,
        1e-9
    ));
    assert!(quadratic["nodes"].as_u64().unwrap() as usize > count);
}

#[test]
fn a_mesh_beyond_its_image_names_its_regions_in_exports_and_is_not_edited() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let image = concat!(env!("CARGO_MANIFEST_DIR"), "/data/faults.vti");
    let mesh = "--distance 9 --pad above=70,below=30 -o padded.vtu --report r.json --quiet";
    run(folder, &format!("mesh {image} {mesh}"));
    let report = std::fs::read(folder.join("r.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let regions = report["padding"]["regions"].as_array().unwrap();
    assert_eq!(regions.len(), 2);
    let file = read_vtu(&folder.join("padded.vtu")).unwrap();
    let cells = file.cell_array("region").unwrap().values.to_i64();
    for (region, number) in regions.iter().zip(1..) {
        let count = cells.iter().filter(|r| **r == number).count();
        assert_eq!(region["cells"], count);
    }
    assert!(run(folder, "validate padded.vtu").contains("passed"));
    run(
        folder,
        "export padded.vtu --to inp -o a.inp --down z --quiet",
    );
    let inp = std::fs::read_to_string(folder.join("a.inp")).unwrap();
    for name in [
        "*ELSET, ELSET=OVERBURDEN",
        "NAME=SINTERFACE_IMAGE_OVERBURDEN",
    ] {
        assert!(inp.contains(name), "{name}");
    }
    run(
        folder,
        "export padded.vtu --to exodus -o a.exo --down z --quiet",
    );
    let exo = std::fs::read(folder.join("a.exo")).unwrap();
    assert!(exo.windows(11).any(|bytes| bytes == b"underburden"));
    let arguments = [
        "edit",
        "padded.vtu",
        image,
        "--remove",
        "100",
        "-o",
        "e.vtu",
    ];
    let error = expect_refusal(folder, &arguments);
    assert!(error.contains("without --pad"), "{error}");
    // Verbs that compare the mesh with its image see the part inside the image.
    run(
        folder,
        &format!("mesh {image} --distance 9 -o plain.vtu --quiet"),
    );
    let [plain, padded] = ["plain", "padded"].map(|mesh| {
        let seeds = "--object 20,20,20 --background 60,60,60 --quiet --json";
        let stdout = run(
            folder,
            &format!("segment {image} {mesh}.vtu {seeds} -o s-{mesh}.vtu"),
        );
        let report: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        run(
            folder,
            &format!("report {image} {mesh}.vtu -o {mesh}.html --quiet"),
        );
        assert!(folder.join(format!("{mesh}.html")).exists());
        let file = read_vtu(&folder.join(format!("s-{mesh}.vtu"))).unwrap();
        let labels = file.cell_array("label").unwrap().values.to_i64();
        (report["cells"]["object"].clone(), file.mesh.tets, labels)
    });
    assert!(plain == padded);
    let plane = ["mesh", "plane.npy", "--pad", "above=10", "-o", "p.vtu"];
    write_npy_2d(&folder.join("plane.npy"), [40, 40], |[x, _]| {
        (x > 20) as u8 as f32
    });
    let error = expect_refusal(folder, &plane);
    assert!(error.contains("the image is 2-D; omit it"), "{error}");
}

#[test]
#[ignore = "needs VTK: make test-all"]
fn geos_gets_the_regions_beyond_an_image_as_attribute() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let image = concat!(env!("CARGO_MANIFEST_DIR"), "/data/faults.vti");
    let mesh = "--distance 9 --pad above=70,below=30 -o padded.vtu --quiet";
    run(folder, &format!("mesh {image} {mesh}"));
    run(
        folder,
        "export padded.vtu --to geos -o g.vtu --down z --quiet",
    );
    let program = "\
import json, sys
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader
from vtkmodules.util.numpy_support import vtk_to_numpy
def array(path, name):
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(path)
    reader.Update()
    grid = reader.GetOutput()
    is_tet = [grid.GetCellType(c) == 10 for c in range(grid.GetNumberOfCells())]
    return vtk_to_numpy(grid.GetCellData().GetArray(name))[is_tet].tolist()
print(json.dumps([array(sys.argv[1], 'attribute'), array(sys.argv[2], 'region')]))";
    let paths = [folder.join("g.vtu"), folder.join("padded.vtu")];
    let arrays = run_vtk_program(program, &[&paths[0], &paths[1]]);
    let [attribute, region] = [0, 1].map(|i| numbers(&arrays[i]));
    assert!(region.contains(&0.0) && region.contains(&1.0) && region.contains(&2.0));
    let expected: Vec<f64> = region.iter().map(|r| r + 1.0).collect();
    assert_eq!(attribute, expected);
}
