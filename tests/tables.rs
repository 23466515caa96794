//! Tests that tables of wells, atoms, points and sticks are read as their names of columns say, whatever
//! program wrote them.

use std::fmt::Write;
use std::path::Path;

use crate::common::{expect_refusal, run, write_npy};
use atomesh::store::{AnyMesh, read_any_vtu};

/// Position of the first sample, and distance of samples along each axis.
const ORIGIN: [f64; 3] = [1000.0, 2000.0, -200.0];
const MESH: &str =
    "mesh image.npy --origin 1000,2000,-200 --spacing 10 --unit m --feature none --quiet";

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_npy(
        &folder.path().join("image.npy"),
        [24, 22, 20],
        |[x, y, z]| (x + y + z) as f32,
    );
    folder
}

/// Returns the nodes of a mesh of tetrahedra.
fn nodes(path: &Path) -> Vec<[f64; 3]> {
    match read_any_vtu(path).unwrap() {
        AnyMesh::Tetrahedra(file) => file.mesh.nodes,
        _ => panic!("no tetrahedra"),
    }
}

/// The well of these tests: x, y, z and radius.
const WELL: [[f64; 4]; 3] = [
    [1040.0, 2100.0, -40.0, 0.2],
    [1060.0, 2110.0, -90.0, 0.2],
    [1120.0, 2150.0, -170.0, 0.2],
];

/// Returns the largest distance of the well's points from the nodes of a mesh.
fn distance_from_well(folder: &Path, text: &str, option: &str) -> f64 {
    std::fs::write(folder.join("well.csv"), text).unwrap();
    run(
        folder,
        &format!("{MESH} --distance 5 {option} well.csv -o m.vtu"),
    );
    let nodes = nodes(&folder.join("m.vtu"));
    let nearest = |p: &[f64; 4]| {
        let distances = nodes
            .iter()
            .map(|n| (0..3).map(|k| (n[k] - p[k]).powi(2)).sum::<f64>());
        distances.fold(f64::INFINITY, f64::min).sqrt()
    };
    // Ends lie on atoms, and atoms are half a distance apart from the point in the middle at most.
    [&WELL[0], &WELL[2]]
        .map(nearest)
        .into_iter()
        .fold(0.0, f64::max)
}

#[test]
fn wells_and_atoms_lie_where_the_names_of_columns_say() {
    let folder = folder();
    let table = |header: &str, row: &dyn Fn([f64; 4]) -> String| {
        let rows: Vec<String> = WELL.iter().map(|point| row(*point)).collect();
        format!("{header}\n{}\n", rows.join("\n"))
    };
    let texts =
        [
            table("x,y,z,radius", &|[x, y, z, r]| format!("{x},{y},{z},{r}")),
            table("y,x,z,radius", &|[x, y, z, r]| format!("{y},{x},{z},{r}")),
            table("Northing;Easting;Elevation;Diameter", &|[x, y, z, r]| {
                format!("{y};{x};{z};{}", 2.0 * r)
            }),
            table("# z r y x", &|[x, y, z, r]| format!("{z} {r} {y} {x}")),
            table(
                "Well\tMD\tUTM X (m)\tUTM Y (m)\tZ\tRadius",
                &|[x, y, z, r]| format!("Well A 1\t0\t{x}\t{y}\t{z}\t{r}"),
            ),
            table(
                "x (m, UTM 31N);y (m);Z (ftMSL);radius (m)",
                &|[x, y, z, r]| format!("{x};{y};{};{r}", z / 0.3048),
            ),
            table("", &|[x, y, z, r]| format!("{x},{y},{z},{r}")),
        ];
    for text in &texts {
        let distance = distance_from_well(folder.path(), text, "--well");
        assert!(distance < 1e-3, "{distance} {text}");
    }
    for text in [
        table("point,northing,easting,z", &|[x, y, z, _]| {
            format!("A,{y},{x},{z}")
        }),
        table("Elev;X;Y", &|[x, y, z, _]| {
            format!("{z};{x};{y}").replace('.', ",")
        }),
    ] {
        let distance = distance_from_well(folder.path(), &text, "--atoms-from");
        assert!(distance < 1e-3, "{distance} {text}");
    }
}

#[test]
fn several_wells_stand_in_one_file() {
    let folder = folder();
    let mut text = "well,x,y,z,radius\n".to_string();
    for [x, y, z, r] in WELL {
        writeln!(text, "A 1,{x},{y},{z},{r}\nB,{},{y},{z},{r}", x + 50.0).unwrap();
    }
    let distance = distance_from_well(folder.path(), &text, "--well");
    assert!(distance < 1e-3, "{distance}");
    let nodes = nodes(&folder.path().join("m.vtu"));
    let has_node = |p: [f64; 3]| {
        nodes
            .iter()
            .any(|n| (0..3).all(|k| (n[k] - p[k]).abs() < 1e-3))
    };
    assert!(has_node([1090.0, 2100.0, -40.0]) && has_node([1170.0, 2150.0, -170.0]));
}

#[test]
fn tables_that_name_no_place_are_refused() {
    let folder = folder();
    let cases = [
        (
            "--well",
            "right,high,z,radius\n1,2,3,0.1\n2,3,4,0.1\n",
            "well.csv:1: has no column x: its columns are right, high, z, radius; name a column one of x, easting",
        ),
        (
            "--well",
            "x,y,z,radius\n450,334.5,2,3,1\n2,3,4,1\n",
            "well.csv:2: has 5 fields, but the table 4 columns",
        ),
        (
            "--well",
            "md,inc,azi\n0,0,0\n9,0,0\n",
            "does not say where the well begins",
        ),
        (
            "--atoms-from",
            "x,utm_x,y,z\n1,2,3,4\n",
            "well.csv:1: the columns 'x' and 'utm_x' both mean x",
        ),
        (
            "--surface",
            "x;y;z\n1,5;2,5;1.234,5\n2,5;1,5;1\n3;4;5\n",
            "is not a number; write decimal points and no separators of thousands",
        ),
        (
            "--well",
            "x,y,z (fathoms),radius\n1,2,3,1\n2,3,4,1\n",
            "well.csv:1: column z has 'fathoms', which is not known as a unit",
        ),
        (
            "--well",
            "md,inc (grad),azi\n0,0,0\n9,0,0\n",
            "well.csv:1: column inc has angles in 'grad'; give angles in degrees",
        ),
        (
            "--well",
            "ncols 3\nnrows 2\nxllcorner -5.0\nyllcorner -5.0\ncellsize 10.0\n1 2 3\n4 5 6\n",
            "well.csv: is an ESRI ASCII grid of heights, not a table; give it as a surface",
        ),
        (
            "--surface",
            "1 2 3 4 5\n2 3 5 4 5\n3 4 7 4 5\n",
            "surface well.csv,columns=_,_,x,y,z",
        ),
    ];
    for (option, text, expected) in cases {
        std::fs::write(folder.path().join("well.csv"), text).unwrap();
        let arguments =
            format!("{MESH} --distance 5 {option} well.csv -o m.vtu").replace(" --quiet", "");
        let arguments: Vec<&str> = arguments.split(' ').collect();
        let message = expect_refusal(folder.path(), &arguments);
        assert!(message.contains(expected), "{message}");
    }
}

/// Returns z of the horizon.
fn horizon(x: f64, y: f64) -> f64 {
    -120.0 + 0.2 * (x - 1000.0) - 0.1 * (y - 2000.0)
}

/// Asserts that the faces of a mesh on its only surface lie on the horizon.
fn expect_horizon(folder: &Path, file: &str) {
    run(
        folder,
        &format!("{MESH} --distance 4 --surface {file} -o m.vtu"),
    );
    run(folder, "surface m.vtu -o s.obj --quiet");
    let text = std::fs::read_to_string(folder.join("s.obj")).unwrap();
    let mut count = 0;
    for line in text.lines().filter_map(|line| line.strip_prefix("v ")) {
        let p: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
        let distance = (p[2] - horizon(p[0], p[1])).abs();
        assert!(distance < 1.0, "{file}: {p:?} is {distance} m off");
        count += 1;
    }
    assert!(count > 25, "{file}: {count} nodes");
}

#[test]
fn points_are_read_by_names_or_as_they_fit_the_image() {
    let folder = folder();
    let write = |name: &str, header: &str, row: &dyn Fn(usize, [f64; 2], f64) -> String| {
        let mut text = header.to_string();
        for i in 0..24 * 22 {
            let index = [i % 24, i / 24];
            let [x, y] = [0, 1].map(|k| ORIGIN[k] + 10.0 * index[k] as f64);
            writeln!(text, "{}", row(i, [x, y], horizon(x, y))).unwrap();
        }
        std::fs::write(folder.path().join(name), text).unwrap();
        expect_horizon(folder.path(), name);
    };
    write("attributes.xyz", "", &|i, [x, y], z| {
        format!("{x} {y} {z} {} 3", i % 7)
    });
    write(
        "swapped.xyz",
        "Northing,Easting,Elevation\n",
        &|_, [x, y], z| format!("{y},{x},{z}"),
    );
    write("numbered.txt", "", &|i, [x, y], z| {
        format!("{i} {x} {y} {z}")
    });
    write("lines.dat", "", &|i, [x, y], z| {
        format!("{} {} {x} {y} {z}", 100 + i / 24, 300 + i % 24)
    });
    let petrel = "# Petrel Points with attributes\nVERSION 1\nBEGIN HEADER\nX\nY\nZ\nINT,Quality\nEND HEADER\n";
    write("petrel", petrel, &|i, [x, y], z| format!("{x} {y} {z} {i}"));
    write("commas.csv", "\u{feff}Z;Y;X\r\n", &|_, [x, y], z| {
        format!("{z:.2};{y:.1};{x:.1}\r").replace('.', ",")
    });
}

#[test]
fn names_in_a_column_without_a_name_give_surfaces() {
    let folder = folder();
    let text = |names: [&str; 2]| {
        let mut text = String::new();
        for (name, depth) in names.into_iter().zip([0.0, 45.0]) {
            for i in 0..24 * 22 {
                let index = [i % 24, i / 24];
                let [x, y] = [0, 1].map(|k| ORIGIN[k] + 10.0 * f64::from(index[k]));
                writeln!(text, "{name}\t{x}\t{y}\t{}", horizon(x, y) - depth).unwrap();
            }
        }
        text
    };
    let path = folder.path().join("tops.txt");
    std::fs::write(&path, text(["\"Top_A\"", "\"Base_B\""])).unwrap();
    let mesh = format!("{MESH} --distance 5 --surface tops.txt -o m.vtu");
    run(folder.path(), &mesh);
    let table = run(folder.path(), "surface m.vtu -o s.obj");
    assert!(
        table.contains("Top_A") && table.contains("Base_B"),
        "{table}"
    );
    std::fs::write(&path, text(["1", "2"])).unwrap();
    let mesh = mesh.replace("tops.txt", "tops.txt,columns=_,x,y,z");
    let mesh = mesh.replace(" --quiet", "");
    let message = expect_refusal(folder.path(), &mesh.split(' ').collect::<Vec<_>>());
    assert!(
        message.contains("seems to hold several surfaces"),
        "{message}"
    );
}

#[test]
fn sticks_are_read_with_any_separator_and_order_of_columns() {
    let folder = folder();
    let point = |k: usize, j: usize| {
        [
            1060.0 + 40.0 * j as f64,
            2000.0 + 50.0 * k as f64,
            -10.0 - 60.0 * j as f64,
        ]
    };
    let mut surfaces = Vec::new();
    for (name, header, order, separator) in [
        ("a.csv", "fault,stick,x,y,z", [0, 1, 2, 3, 4], ","),
        ("b.csv", "fault;stick;x;y;z", [0, 1, 2, 3, 4], ";"),
        (
            "c.txt",
            "Y\tZ\tX\tStick ID\tFault Name",
            [3, 4, 2, 1, 0],
            "\t",
        ),
        (
            "d.txt",
            "! Fault Stick_ID Easting Northing Elevation",
            [0, 1, 2, 3, 4],
            " ",
        ),
    ] {
        let mut text = format!("{header}\n");
        for fault in 0..2usize {
            for k in 0..5 {
                for j in 0..4 {
                    let [x, y, z] = point(k, j);
                    let x = x + 60.0 * fault as f64;
                    let fields = [
                        format!("Fault_{fault}"),
                        k.to_string(),
                        x.to_string(),
                        y.to_string(),
                        z.to_string(),
                    ];
                    text += &order.map(|k| fields[k].clone()).join(separator);
                    text += "\n";
                }
            }
        }
        std::fs::write(folder.path().join(name), text).unwrap();
        run(
            folder.path(),
            &format!("{MESH} --distance 5 --surface {name} -o m.vtu"),
        );
        let table = run(folder.path(), "surface m.vtu -o s.obj");
        assert!(
            table.contains("Fault_0") && table.contains("Fault_1"),
            "{table}"
        );
        surfaces.push(std::fs::read_to_string(folder.path().join("s.obj")).unwrap());
    }
    assert!(surfaces.iter().all(|surface| *surface == surfaces[0]));
}
