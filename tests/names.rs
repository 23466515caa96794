//! Tests of names in exports: difficult names of regions, surfaces, wells and properties are legal and
//! distinct in every format, and a table says what became of them.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use crate::common::{
    expect_refusal, is_close, run, run_args, run_python, run_simulator, write_npy,
};

/// Writes a Gmsh file of cubes in a row along x. Each is a physical volume with one of the names, and
/// the face behind it, except for the last, is a physical surface with the same name.
fn write_row_of_cubes(path: &Path, names: &[&str]) {
    let node = |[i, j, k]: [usize; 3]| 4 * i + 2 * j + k + 1;
    let mut text = String::from("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n");
    writeln!(text, "{}", 2 * names.len() - 1).unwrap();
    for (at, name) in names.iter().enumerate() {
        writeln!(text, "3 {} \"{name}\"", at + 1).unwrap();
        if at + 1 < names.len() {
            writeln!(text, "2 {} \"{name}\"", 1000 + at).unwrap();
        }
    }
    let count = 4 * (names.len() + 1);
    writeln!(text, "$EndPhysicalNames\n$Nodes\n{count}").unwrap();
    for n in 0..count {
        writeln!(text, "{} {} {} {}", n + 1, n / 4, n / 2 % 2, n % 2).unwrap();
    }
    let mut elements = Vec::new();
    for i in 0..names.len() {
        for axes in [
            [0, 1, 2],
            [0, 2, 1],
            [1, 0, 2],
            [1, 2, 0],
            [2, 0, 1],
            [2, 1, 0],
        ] {
            let mut corner = [i, 0, 0];
            let mut nodes = vec![node(corner)];
            for axis in axes {
                corner[axis] += 1;
                nodes.push(node(corner));
            }
            elements.push((4, i + 1, nodes));
        }
        if i + 1 < names.len() {
            for middle in [[i + 1, 1, 0], [i + 1, 0, 1]] {
                let nodes = [[i + 1, 0, 0], middle, [i + 1, 1, 1]].map(node).to_vec();
                elements.push((2, 1000 + i, nodes));
            }
        }
    }
    writeln!(text, "$EndNodes\n$Elements\n{}", elements.len()).unwrap();
    for (number, (kind, group, nodes)) in elements.iter().enumerate() {
        let nodes: Vec<String> = nodes.iter().map(usize::to_string).collect();
        let nodes = nodes.join(" ");
        writeln!(text, "{} {kind} 2 {group} {group} {nodes}", number + 1).unwrap();
    }
    text += "$EndElements\n";
    std::fs::write(path, text).unwrap();
}

/// Sets of difficult names.
const NAME_SETS: [&[&str]; 4] = [
    &["Bone", "bone", "rib 1.5", "rib 1-5", "rib_1_5", "eall"],
    &["Unit-1", "Unit_1", "1", "region1", "Größe", "Grösse"],
    &[
        "region2",
        "x",
        "xmin",
        "all",
        "scraps",
        "the_same_first_32_characters_of_a_name_a",
    ],
    &[
        "the_same_first_32_characters_of_a_name_b",
        "x/y",
        "x;y",
        "x,y",
        "interface_1_2",
        "end",
    ],
];

/// Returns the parts of the lines of a text that follow `start`.
fn after<'a>(text: &'a str, start: &str) -> Vec<&'a str> {
    text.lines()
        .filter_map(|line| line.strip_prefix(start))
        .collect()
}

/// Returns the names of regions in an export, as its readers compare them.
fn region_names(folder: &Path, format: &str, file: &str) -> Vec<String> {
    let read = |path: &str| std::fs::read_to_string(folder.join(path)).unwrap();
    let owned = |names: Vec<&str>| names.iter().map(|name| name.to_string()).collect();
    let quoted = |lines: Vec<&str>| {
        let names = lines.iter().filter_map(|line| line.split('"').nth(1));
        names.map(str::to_string).collect()
    };
    match format {
        "inp" => {
            let text = read(file);
            let names = after(&text, "*ELSET, ELSET=");
            assert!(names.iter().all(|name| **name == name.to_uppercase()));
            owned(names)
        }
        "msh" | "msh2" => quoted(after(&read(file), "3 ")),
        "nastran" => quoted(after(&read(file), "$HMNAME COMP")),
        "openfoam" => {
            let text = read(&format!("{file}/constant/polyMesh/cellZones"));
            let lines: Vec<&str> = text.lines().collect();
            let is_zone = |pair: &&[&str]| pair[1] == "{" && pair[0] != "FoamFile";
            lines
                .windows(2)
                .filter(is_zone)
                .map(|pair| pair[0].to_string())
                .collect()
        }
        "pflotran" => {
            let files = std::fs::read_dir(folder).unwrap();
            let names = files.map(|f| f.unwrap().file_name().to_string_lossy().to_lowercase());
            names
                .filter(|name| name.starts_with("e-") && name.ends_with(".txt"))
                .collect()
        }
        _ => {
            let text = read(file);
            let elements = text.split("\n\n").next().unwrap().lines().skip(1);
            let rocks: BTreeSet<String> = elements.map(|line| line[15..20].to_string()).collect();
            rocks.into_iter().collect()
        }
    }
}

#[test]
fn regions_have_distinct_names_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for names in NAME_SETS {
        write_row_of_cubes(&folder.join("row.msh"), names);
        for (format, file) in [
            ("inp", "e.inp"),
            ("msh", "e.msh"),
            ("msh2", "e.msh"),
            ("nastran", "e.bdf"),
            ("openfoam", "case"),
            ("pflotran", "e.uge"),
            ("tough2", "MESH"),
        ] {
            let depth = match format {
                "pflotran" | "tough2" => " --depth-at-top 100",
                _ => "",
            };
            run(
                folder,
                &format!("export row.msh --to {format} -o {file} --quiet{depth}"),
            );
            let written = region_names(folder, format, file);
            let distinct: BTreeSet<&String> = written.iter().collect();
            assert_eq!(distinct.len(), written.len(), "{format}: {written:?}");
            assert!(written.len() >= names.len(), "{format}: {written:?}");
        }
        let text = std::fs::read_to_string(folder.join("e.msh")).unwrap();
        for name in names
            .iter()
            .filter(|name| **name != "xmin" && **name != "scraps")
        {
            assert!(
                text.contains(&format!("\"{name}\"")),
                "{name}: {}",
                &text[..900]
            );
        }
        for file in std::fs::read_dir(folder).unwrap() {
            let path = file.unwrap().path();
            if path.is_file() {
                std::fs::remove_file(path).unwrap();
            }
        }
    }
}

#[test]
fn all_formats_take_difficult_names_of_regions_and_properties() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_row_of_cubes(&folder.join("row.msh"), NAME_SETS[3]);
    for format in atomesh::export::formats().filter(|format| format.name != "disv") {
        let extension = format.extensions.first();
        let file = match extension {
            Some(&"MESH") => "MESH".to_string(),
            Some(extension) => format!("all.{extension}"),
            None => "all".to_string(),
        };
        let mut arguments = vec![
            "export",
            "row.msh",
            "--to",
            format.name,
            "-o",
            file.as_str(),
            "--quiet",
        ];
        if format.uses_depth {
            arguments.extend(["--depth-at-top", "100"]);
        }
        let holds = |content| format.supported_content.contains(&content);
        if holds(atomesh::export::ExportContent::Permeability) {
            arguments.extend(["--porosity", "0.2", "--permeability", "100"]);
            arguments.extend(["--permeability-unit", "mD"]);
        }
        if holds(atomesh::export::ExportContent::Properties) {
            arguments.extend(["--property", "a b/c=1", "--property", "a_b_c=2"]);
        }
        run_args(folder, &arguments);
    }
    // A table is beside files without comments.
    let table = std::fs::read_to_string(folder.join("all.exo.names.csv")).unwrap();
    assert!(table.starts_with("kind,number,name,written\n"), "{table}");
}

#[test]
fn an_export_has_the_table_of_names_that_changed_and_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_row_of_cubes(&folder.join("row.msh"), &["Bone", "bone", "skin"]);
    let head = |file: &str| {
        let text = std::fs::read_to_string(folder.join(file)).unwrap();
        after(&text, "** ").join("\n")
    };
    run(folder, "export row.msh --to inp -o a.inp --quiet");
    let table = head("a.inp");
    assert!(table.contains("region 1 'Bone' is BONE\n"), "{table}");
    assert!(table.contains("region 2 'bone' is BONE_2\n"), "{table}");
    run(folder, "export row.msh --to exodus -o a.exo --quiet");
    assert!(
        folder.join("a.exo.names.csv").is_file(),
        "regions and faces share names"
    );
    write_row_of_cubes(&folder.join("plain.msh"), &["bone", "skin"]);
    run(folder, "export plain.msh --to inp -o b.inp --quiet");
    assert_eq!(head("b.inp"), "");
}

#[test]
fn wells_have_distinct_names_in_decks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_row_of_cubes(&folder.join("row.msh"), &["a", "b", "c"]);
    let line = "export row.msh --to opm -o W.DATA --porosity 0.2 --permeability 100 \
                --permeability-unit mD --depth-at-top 1000 --quiet --injector 1a=0.5,0.3,0.4:1 \
                --producer producer-1=1.5,0.3,0.4:50 --producer producer-2=2.5,0.3,0.4:50";
    run(folder, line);
    let deck = std::fs::read_to_string(folder.join("W.DATA")).unwrap();
    let wells = deck.split("WELSPECS\n").nth(1).unwrap();
    let names: Vec<&str> = (wells.lines().take(3))
        .map(|line| line.split_whitespace().next().unwrap())
        .collect();
    assert_eq!(names, ["W1a", "producer", "produc_2"]);
    assert!(deck.contains("-- well 3 'producer-2' is produc_2\n"));
}

#[test]
fn a_name_that_is_given_twice_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("l.npy"), [12, 12, 12], |[_, _, z]| {
        if z < 6 { 1.0 } else { 2.0 }
    });
    let line = "mesh l.npy -o m.vtu --label 1:name=x --label 2:name=x";
    let error = expect_refusal(folder, &line.split_whitespace().collect::<Vec<_>>());
    assert!(
        error.contains("--label 2:name=x: gives a name that another label has; "),
        "{error}"
    );
}

#[test]
#[ignore = "needs CalculiX: make test-all"]
fn regions_whose_names_differ_in_case_keep_their_own_material_in_calculix() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Two cubes in a row along x, of which the first is a thousand times as soft.
    write_row_of_cubes(&folder.join("row.msh"), &["Bone", "bone"]);
    run(folder, "export row.msh --to inp -o mesh.inp --quiet");
    let job = "*INCLUDE, INPUT=mesh.inp\n*MATERIAL, NAME=SOFT\n*ELASTIC\n1E3, 0.0\n\
               *MATERIAL, NAME=HARD\n*ELASTIC\n1E6, 0.0\n\
               *SOLID SECTION, ELSET=BONE, MATERIAL=SOFT\n\
               *SOLID SECTION, ELSET=BONE_2, MATERIAL=HARD\n*STEP\n*STATIC\n*BOUNDARY\n\
               NALL, 2, 3, 0.0\nNXMIN, 1, 1, 0.0\nNXMAX, 1, 1, 0.01\n\
               *NODE PRINT, NSET=NXMAX, TOTALS=ONLY\nRF\n*END STEP\n";
    std::fs::write(folder.join("job.inp"), job).unwrap();
    let mut ccx = Command::new("ccx");
    ccx.current_dir(folder).arg("job");
    run_simulator(&mut ccx);
    let totals = std::fs::read_to_string(folder.join("job.dat")).unwrap();
    let last = totals
        .lines()
        .rfind(|line| !line.trim().is_empty())
        .unwrap();
    let force: f64 = last.split_whitespace().next().unwrap().parse().unwrap();
    // Two springs in series.
    let expected = 0.01 / (1.0 / 1e3 + 1.0 / 1e6);
    assert!(is_close(force, expected, 1e-4), "{force} {expected}");
}

#[test]
#[ignore = "needs meshio and VTK: make test-all"]
fn meshio_and_vtk_read_all_names() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let program = "import sys, json, meshio
from vtkmodules.vtkIOExodus import vtkExodusIIReader
groups = meshio.read(sys.argv[1]).field_data
reader = vtkExodusIIReader()
reader.SetFileName(sys.argv[2])
reader.UpdateInformation()
kinds = [reader.ELEM_BLOCK, reader.SIDE_SET]
names = [reader.GetObjectName(k, i) for k in kinds for i in range(reader.GetNumberOfObjects(k))]
print(json.dumps({'groups': list(groups), 'names': names}))";
    for names in NAME_SETS {
        write_row_of_cubes(&folder.join("row.msh"), names);
        run(folder, "export row.msh --to msh2 -o a.msh --quiet");
        run(folder, "export row.msh --to exodus -o a.exo --quiet");
        let [mesh, exodus] = ["a.msh", "a.exo"].map(|file| folder.join(file));
        let arguments = [
            "-c".as_ref(),
            program.as_ref(),
            mesh.as_os_str(),
            exodus.as_os_str(),
        ];
        let output = run_python("meshio and VTK", &arguments);
        let read: serde_json::Value = serde_json::from_str(output.trim()).unwrap();
        // Regions, surfaces between them, and the sides of the box.
        let expected = names.len() + names.len() - 1 + 6;
        for list in ["groups", "names"] {
            let read: Vec<&str> = read[list]
                .as_array()
                .unwrap()
                .iter()
                .map(|name| name.as_str().unwrap())
                .collect();
            let starts: BTreeSet<&str> = (read.iter())
                .map(|name| name.get(..32).filter(|_| list == "names").unwrap_or(name))
                .collect();
            assert_eq!(starts.len(), expected, "{list}: {read:?}");
        }
    }
}
