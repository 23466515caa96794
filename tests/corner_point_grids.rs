//! Tests that corner-point grids of simulators (EGRID with INIT, GRDECL) are read as images, surfaces and
//! grids: by small files that are written here from the definition of the formats, and by files of
//! `export` and of other programs.

use std::ffi::OsStr;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;

use atomesh::image::formats::{ReadOptions, read};
use atomesh::surface_file::SurfaceFile;
use atomesh::surface_file::vtp::read_surfaces;
use serde_json::Value;

use crate::common::{expect_refusal, is_close, numbers, run, run_simulator, run_validator};

const DIMS: [usize; 3] = [4, 3, 5];

/// Area of a column and thickness of a cell, so that a cell has a volume of 50,000.
const COLUMN: [f64; 2] = [100.0, 50.0];
const THICKNESS: f64 = 10.0;
const CELL_VOLUME: f64 = 50_000.0;

/// Inclination of the pillars along x: parallel pillars keep volumes.
const LEAN: f64 = 0.5;

/// The throw of the fault between the second and the third column, and the dip of the layers.
const THROW: f64 = 15.0;
const DIP: f64 = 0.2;
const TOP: f64 = 1000.0;

/// A model of 4 x 3 x 5 cells: dipping layers on inclined pillars, with a fault and two inactive cells.
#[derive(Clone, Copy)]
struct Model {
    /// 1, or -1 for axes of the other hand.
    y_sign: f64,
    /// GRIDUNIT and MAPUNITS.
    units: [&'static str; 2],
    map_axes: Option<[f64; 6]>,
}

impl Model {
    const PLAIN: Self = Self {
        y_sign: 1.0,
        units: ["METRES", ""],
        map_axes: None,
    };

    fn coord(&self) -> Vec<f64> {
        let mut numbers = Vec::new();
        for j in 0..=DIMS[1] {
            for i in 0..=DIMS[0] {
                for depth in [TOP, TOP + 200.0] {
                    let x = COLUMN[0] * i as f64 + LEAN * (depth - TOP);
                    numbers.extend([x, self.y_sign * COLUMN[1] * j as f64, depth]);
                }
            }
        }
        numbers
    }

    fn zcorn(&self) -> Vec<f64> {
        let [nx, ny, nz] = DIMS;
        let mut numbers = Vec::new();
        for level in 0..2 * nz {
            let layers = level.div_ceil(2) as f64;
            for row in 0..2 * ny {
                for corner in 0..2 * nx {
                    let [i, j] = [corner, row].map(|n| n.div_ceil(2) as f64);
                    let throw = if corner / 2 >= 2 { THROW } else { 0.0 };
                    let top = TOP + DIP * (COLUMN[0] * i + COLUMN[1] * j) + throw;
                    numbers.push(top + THICKNESS * layers);
                }
            }
        }
        numbers
    }
}

fn cells() -> impl Iterator<Item = [usize; 3]> {
    let [nx, ny, nz] = DIMS;
    (0..nx * ny * nz).map(move |n| [n % nx, n / nx % ny, n / (nx * ny)])
}

fn is_active(cell: [usize; 3]) -> bool {
    cell != [0, 0, 4] && cell != [3, 2, 0]
}

fn region([_, _, k]: [usize; 3]) -> i32 {
    if k < 2 { 1 } else { 2 }
}

fn porosity([i, _, k]: [usize; 3]) -> f64 {
    (0.1f32 + 0.02 * k as f32 + 0.01 * i as f32).into()
}

/// Returns the sums of cells, volume and pore volume over the active cells of a region.
fn expected_region(value: i32) -> (usize, f64, f64) {
    let active = || cells().filter(|cell| is_active(*cell) && region(*cell) == value);
    let pores = active().map(|cell| porosity(cell) * CELL_VOLUME).sum();
    (
        active().count(),
        active().count() as f64 * CELL_VOLUME,
        pores,
    )
}

/// An array file of Eclipse in memory.
#[derive(Default)]
struct ArrayFile(Vec<u8>);

impl ArrayFile {
    fn block(&mut self, bytes: &[u8]) {
        let length = (bytes.len() as u32).to_be_bytes();
        self.0.extend(length);
        self.0.extend(bytes);
        self.0.extend(length);
    }

    /// Adds an array; a block holds at most 1000 numbers or 105 texts.
    fn array<const N: usize>(&mut self, name: &str, kind: &str, elements: &[[u8; N]]) -> &mut Self {
        let mut header = format!("{name:<8}").into_bytes();
        header.extend((elements.len() as i32).to_be_bytes());
        header.extend(kind.as_bytes());
        self.block(&header);
        let per_block = if kind == "CHAR" { 105 } else { 1000 };
        for block in elements.chunks(per_block) {
            self.block(block.as_flattened());
        }
        self
    }

    fn integers(&mut self, name: &str, values: impl IntoIterator<Item = i32>) -> &mut Self {
        let values: Vec<[u8; 4]> = values.into_iter().map(i32::to_be_bytes).collect();
        self.array(name, "INTE", &values)
    }

    /// Adds an array of 100 integers of which these are not 0.
    fn head(&mut self, name: &str, values: &[(usize, usize)]) -> &mut Self {
        let mut head = [0; 100];
        values
            .iter()
            .for_each(|&(at, value)| head[at] = value as i32);
        self.integers(name, head)
    }

    fn reals(&mut self, name: &str, values: impl IntoIterator<Item = f64>) -> &mut Self {
        let values = values.into_iter().map(|x| (x as f32).to_be_bytes());
        self.array(name, "REAL", &values.collect::<Vec<_>>())
    }

    fn texts(&mut self, name: &str, words: &[&str]) -> &mut Self {
        let words = words.iter().map(|word| {
            let text = format!("{word:<8}");
            <[u8; 8]>::try_from(text.as_bytes()).unwrap()
        });
        self.array(name, "CHAR", &words.collect::<Vec<_>>())
    }
}

/// Returns an EGRID. `porosity_kind` is the entry of FILEHEAD: 0 for single porosity.
fn egrid(model: &Model, porosity_kind: usize) -> Vec<u8> {
    let mut file = ArrayFile::default();
    file.head("FILEHEAD", &[(0, 3), (1, 2007), (5, porosity_kind), (6, 1)]);
    let [grid_unit, map_unit] = model.units;
    if !map_unit.is_empty() {
        file.texts("MAPUNITS", &[map_unit]);
    }
    if let Some(axes) = model.map_axes {
        file.reals("MAPAXES", axes);
    }
    let words: Vec<&str> = grid_unit.split(' ').collect();
    file.texts("GRIDUNIT", &[words[0], words.get(1).unwrap_or(&"")]);
    let [nx, ny, nz] = DIMS;
    file.head("GRIDHEAD", &[(0, 1), (1, nx), (2, ny), (3, nz), (24, 1)]);
    file.reals("COORD", model.coord());
    file.reals("ZCORN", model.zcorn());
    file.integers("ACTNUM", cells().map(|cell| i32::from(is_active(cell))));
    file.integers("ENDGRID", []);
    file.0
}

/// Returns an INIT file: properties of the active cells.
fn init() -> Vec<u8> {
    let mut file = ArrayFile::default();
    let active = || cells().filter(|cell| is_active(*cell));
    let [nx, ny, nz] = DIMS;
    file.head(
        "INTEHEAD",
        &[(2, 1), (8, nx), (9, ny), (10, nz), (11, active().count())],
    );
    // Some arrays hold all cells.
    file.reals(
        "PORV",
        cells().map(|cell| f64::from(u8::from(is_active(cell))) * 5000.0),
    );
    file.reals("PORO", active().map(porosity));
    file.integers("FIPNUM", active().map(region));
    file.0
}

/// Returns the model as text, with repeat counts, comments and named faults.
fn grdecl(model: &Model) -> String {
    let mut text = String::from("-- A grid\nPINCH\n 0.001 GAP 1* TOPBOT TOP / the end\n");
    let [nx, ny, nz] = DIMS;
    writeln!(text, "GRIDUNIT\n {} /", model.units[0]).unwrap();
    if let Some(axes) = model.map_axes {
        writeln!(text, "MAPUNITS\n '{}' /", model.units[1]).unwrap();
        writeln!(
            text,
            "MAPAXES\n {} /",
            axes.map(|x| x.to_string()).join(" ")
        )
        .unwrap();
    }
    writeln!(text, "SPECGRID\n {nx} {ny} {nz} 1 F /").unwrap();
    let mut array = |name: &str, numbers: Vec<f64>| {
        writeln!(text, "\n{name} -- numbers").unwrap();
        for line in numbers.chunk_by(|a, b| a == b) {
            match line {
                [number] => writeln!(text, " {number:E}").unwrap(),
                _ => writeln!(text, " {}*{}", line.len(), line[0]).unwrap(),
            }
        }
        writeln!(text, "/").unwrap();
    };
    array("COORD", model.coord());
    array("ZCORN", model.zcorn());
    array(
        "ACTNUM",
        cells()
            .map(|cell| f64::from(u8::from(is_active(cell))))
            .collect(),
    );
    array("PORO", cells().map(porosity).collect());
    text += "INCLUDE\n 'parts/regions.inc' /\n";
    text += "FAULTS\n 'East' 2 2 1 3 1 5 I /\n/\nMULTFLT\n 'East' 0 /\n/\n";
    text
}

fn write_model(folder: &Path, model: &Model) {
    std::fs::write(folder.join("MODEL.EGRID"), egrid(model, 0)).unwrap();
    std::fs::write(folder.join("MODEL.INIT"), init()).unwrap();
    std::fs::create_dir_all(folder.join("parts")).unwrap();
    let mut regions = String::from("FIPNUM\n");
    for cell in cells() {
        writeln!(regions, " {}", region(cell)).unwrap();
    }
    std::fs::write(folder.join("parts/regions.inc"), regions + "/\n").unwrap();
    std::fs::write(folder.join("TEXT.GRDECL"), grdecl(model)).unwrap();
}

fn folder(model: &Model) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_model(folder.path(), model);
    folder
}

fn info(folder: &Path, file: &str) -> Value {
    serde_json::from_str(&run(folder, &format!("info {file} --json --quiet"))).unwrap()
}

/// Checks counts and volumes in a description. `unit` is the cube of the unit, in cubic metres.
fn assert_volumes(grid: &Value, unit: f64) {
    let number = |value: &Value| value.as_f64().unwrap();
    assert_eq!(numbers(&grid["dims"]), DIMS.map(|n| n as f64));
    let mut totals = (0, 0.0, 0.0);
    for (at, value) in [1, 2].into_iter().enumerate() {
        let (count, volume, pores) = expected_region(value);
        let found = &grid["regions"][at];
        assert_eq!(
            [&found["value"], &found["cells"]],
            [&Value::from(value), &count.into()]
        );
        assert!(
            is_close(number(&found["volume"]), volume / unit, 1e-6),
            "{found}"
        );
        assert!(
            is_close(number(&found["pore_volume"]), pores / unit, 1e-6),
            "{found}"
        );
        totals = (totals.0 + count, totals.1 + volume, totals.2 + pores);
    }
    assert_eq!(grid["active"], totals.0);
    assert!(
        is_close(number(&grid["volume"]), totals.1 / unit, 1e-6),
        "{grid}"
    );
    assert!(
        is_close(number(&grid["pore_volume"]), totals.2 / unit, 1e-6),
        "{grid}"
    );
    assert_eq!(grid["inverted"], 0);
}

#[test]
fn cells_have_the_volumes_of_geometry_in_both_formats_and_in_any_unit() {
    let foot: f64 = 0.3048;
    let axes = [0.0, 100.0, 0.0, 0.0, 100.0, 0.0];
    let plain = Model::PLAIN;
    for (model, symbol, size) in [
        (plain, "m", 1.0),
        (
            Model {
                y_sign: -1.0,
                ..plain
            },
            "m",
            1.0,
        ),
        // Numbers in the file are in feet, and the map is in metres.
        (
            Model {
                units: ["FEET", "METRES"],
                map_axes: Some(axes),
                ..plain
            },
            "m",
            1.0 / foot,
        ),
        (
            Model {
                units: ["METRES", "FEET"],
                map_axes: Some(axes),
                ..plain
            },
            "ft",
            foot,
        ),
        (
            Model {
                units: ["CM", ""],
                ..plain
            },
            "cm",
            1.0,
        ),
        // Relative to the map: nothing is converted.
        (
            Model {
                units: ["FEET MAP", "METRES"],
                map_axes: Some(axes),
                ..plain
            },
            "ft",
            1.0,
        ),
    ] {
        let folder = folder(&model);
        for file in ["MODEL.EGRID", "TEXT.GRDECL", "TEXT.GRDECL:FIPNUM"] {
            let info = info(folder.path(), file);
            let grid = &info["grid"];
            assert_volumes(grid, f64::powi(size, 3));
            assert_eq!([&grid["unit"], &grid["property"]], [symbol, "FIPNUM"]);
            assert_eq!(grid["is_left_handed"], model.y_sign > 0.0);
        }
    }
}

/// Returns the cell in which a point lies.
fn cell_at(model: &Model, [x, y, z]: [f64; 3]) -> Option<[usize; 3]> {
    let depth = -z;
    let (u, v) = (x - LEAN * (depth - TOP), y * model.y_sign);
    let index = |position: f64, count: usize| {
        (position >= 0.0 && position < count as f64).then_some(position as usize)
    };
    let [i, j] = [
        index(u / COLUMN[0], DIMS[0])?,
        index(v / COLUMN[1], DIMS[1])?,
    ];
    let throw = if i >= 2 { THROW } else { 0.0 };
    let top = TOP + DIP * (u + v) + throw;
    Some([i, j, index((depth - top) / THICKNESS, DIMS[2])?])
}

#[test]
fn samples_have_the_values_of_their_cells() {
    for y_sign in [1.0, -1.0] {
        let model = Model {
            y_sign,
            ..Model::PLAIN
        };
        let folder = folder(&model);
        let folder = folder.path();
        for file in ["MODEL.EGRID", "TEXT.GRDECL"] {
            let spacing = "--spacing 7.3,4.7,1.3 --quiet";
            run(folder, &format!("convert {file} labels.vti {spacing}"));
            run(
                folder,
                &format!("convert {file}:PORO porosity.vti {spacing}"),
            );
            run(folder, &format!("convert {file}:K layers.vti {spacing}"));
            let image = |name: &str| {
                let loaded = read(&folder.join(name), &ReadOptions::default());
                loaded.unwrap().image
            };
            let images = ["labels.vti", "porosity.vti", "layers.vti"].map(image);
            let geometry = &images[0].geometry;
            assert_eq!(geometry.units, ["m", "m", "m"]);
            let [nx, ny, _] = images[0].dims();
            let mut counts = [0; 3];
            for (n, &label) in images[0].as_slice().iter().enumerate() {
                let index = [n % nx, n / nx % ny, n / (nx * ny)].map(|i| i as f64);
                let position = geometry.to_physical(index);
                let cell = cell_at(&model, position).filter(|cell| is_active(*cell));
                assert_eq!(
                    label,
                    cell.map_or(0.0, |cell| region(cell) as f32),
                    "{position:?}"
                );
                let layer = images[2].as_slice()[n];
                assert_eq!(layer, cell.map_or(0.0, |[_, _, k]| k as f32 + 1.0));
                let found = images[1].as_slice()[n];
                match cell {
                    Some(cell) => assert_eq!(f64::from(found), porosity(cell)),
                    None => assert!(found.is_nan()),
                }
                counts[label as usize] += 1;
            }
            // The lattice reaches beyond the cells on all sides, and its samples have equal volumes.
            let volume = 7.3 * 4.7 * 1.3;
            for value in [1, 2] {
                let found = f64::from(counts[value as usize]) * volume;
                assert!(
                    is_close(found, expected_region(value).1, 0.02),
                    "{value}: {found}"
                );
            }
        }
    }
}

#[test]
fn the_lattice_follows_the_axes_of_the_map() {
    // The grid is turned by 30 degrees.
    let (cos, sin) = (0.75f64.sqrt(), 0.5);
    let origin = [450_000.0, 6_500_000.0];
    let [x0, y0] = origin;
    let axes = [
        x0 - 100.0 * sin,
        y0 + 100.0 * cos,
        x0,
        y0,
        x0 + 100.0 * cos,
        y0 + 100.0 * sin,
    ];
    let model = Model {
        units: ["METRES", "METRES"],
        map_axes: Some(axes),
        ..Model::PLAIN
    };
    let folder = folder(&model);
    run(
        folder.path(),
        "convert TEXT.GRDECL labels.vti --spacing 20,10,5 --quiet",
    );
    let image = read(&folder.path().join("labels.vti"), &ReadOptions::default());
    let image = image.unwrap().image;
    let step = image.geometry.axes[0];
    assert!(
        is_close(step[0], 20.0 * cos, 1e-6) && is_close(step[1], 20.0 * sin, 1e-6),
        "{step:?}"
    );
    let [nx, ny, _] = image.dims();
    for (n, &label) in image.as_slice().iter().enumerate() {
        let index = [n % nx, n / nx % ny, n / (nx * ny)].map(|i| i as f64);
        let [x, y, z] = image.geometry.to_physical(index);
        let [dx, dy] = [x - origin[0], y - origin[1]];
        let position = [cos * dx + sin * dy, cos * dy - sin * dx, z];
        // Samples on a face between two cells may be in either.
        let labels = [-1e-5, 1e-5].map(|shift| {
            let cell = cell_at(&model, position.map(|c| c + shift));
            cell.filter(|cell| is_active(*cell))
                .map_or(0.0, |cell| region(cell) as f32)
        });
        assert!(labels.contains(&label), "{position:?} {label}");
    }
}

fn triangle_area(file: &SurfaceFile<3>, facet: [u32; 3]) -> f64 {
    let [a, b, c] = facet.map(|node| file.nodes[node as usize]);
    let [u, v]: [[f64; 3]; 2] = [b, c].map(|p| std::array::from_fn(|k| p[k] - a[k]));
    let cross = |k: usize, l: usize| u[k] * v[l] - u[l] * v[k];
    0.5 * (cross(1, 2).powi(2) + cross(2, 0).powi(2) + cross(0, 1).powi(2)).sqrt()
}

/// Returns the names of surfaces with their areas.
fn areas(folder: &Path, name: &str) -> Vec<(String, f64)> {
    let file = read_surfaces(&folder.join(name)).unwrap();
    let area = |surface: usize| {
        let facets = file.surface_facets(surface).iter();
        facets.map(|facet| triangle_area(&file, *facet)).sum()
    };
    (0..file.names.len())
        .map(|s| (file.names[s].clone(), area(s)))
        .collect()
}

#[test]
fn faults_and_horizons_become_surfaces() {
    let folder = folder(&Model::PLAIN);
    let folder = folder.path();
    // The fault reaches from the top of one side to the base of the other. Its edges are (lean, 0, 1) along
    // the pillars and (lean dip, 1, dip) along y.
    let height = THICKNESS * DIMS[2] as f64 + THROW;
    let width = COLUMN[1] * DIMS[1] as f64;
    let fault_area = height * width * (1.0 + LEAN * LEAN).sqrt();
    // A horizon's edges are (1 + lean dip, 0, dip) and (lean dip, 1, dip).
    let part: f64 = LEAN * DIP;
    let normal = [-DIP, -DIP * (1.0 + part) + DIP * part, 1.0 + part];
    let stretch = normal.iter().map(|c| c * c).sum::<f64>().sqrt();
    let horizon_area = 12.0 * COLUMN[0] * COLUMN[1] * stretch;
    for (file, fault) in [("MODEL.EGRID", "fault1"), ("TEXT.GRDECL", "East")] {
        run(folder, &format!("convert {file} all.vtp --quiet"));
        run(folder, &format!("convert {file}:FAULTS faults.vtp --quiet"));
        run(folder, &format!("convert {file}:K layers.vtp --quiet"));
        let all = areas(folder, "all.vtp");
        let expected = [
            (fault, fault_area),
            ("horizon_top", horizon_area),
            ("horizon_1_2", horizon_area),
            ("horizon_base", horizon_area),
        ];
        assert_eq!(all.len(), expected.len(), "{all:?}");
        for ((name, area), (expected_name, expected_area)) in all.iter().zip(expected) {
            assert_eq!(name, expected_name);
            assert!(
                is_close(*area, expected_area, 1e-5),
                "{name}: {area} {expected_area}"
            );
        }
        assert_eq!(areas(folder, "faults.vtp").len(), 1);
        let layers = areas(folder, "layers.vtp");
        let names: Vec<&str> = layers.iter().map(|layer| layer.0.as_str()).collect();
        let between = ["horizon_1_2", "horizon_2_3", "horizon_3_4", "horizon_4_5"];
        assert_eq!(names[0], "horizon_top");
        assert_eq!(names[1..5], between);
    }
    let error = expect_refusal(folder, &["convert", "MODEL.EGRID:PORO", "a.vtp"]);
    assert!(error.contains("PORO has no whole numbers"), "{error}");
    let options = ["convert", "MODEL.EGRID", "a.vtp", "--spacing", "5"];
    let error = expect_refusal(folder, &options);
    assert!(error.contains("--spacing"), "{error}");
}

#[test]
fn crossing_faults_are_two() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut text = String::from("SPECGRID\n 4 4 2 1 F /\nCOORD\n");
    for pillar in 0..25 {
        let (x, y) = (pillar % 5 * 10, pillar / 5 * 10);
        writeln!(text, "{x} {y} 0 {x} {y} 100").unwrap();
    }
    text += "/\nZCORN\n";
    for level in 0..4 {
        for row in 0..8 {
            for corner in 0..8 {
                // Two throws that cross in the middle of the grid.
                let throws = 4 * (corner / 4) + 3 * (row / 4);
                writeln!(text, "{}", 50 + 10 * ((level + 1) / 2) + throws).unwrap();
            }
        }
    }
    std::fs::write(folder.join("a.grdecl"), text + "/\n").unwrap();
    run(folder, "convert a.grdecl:FAULTS a.vtp --quiet");
    let found = areas(folder, "a.vtp");
    let names: Vec<&str> = found.iter().map(|surface| surface.0.as_str()).collect();
    assert_eq!(names, ["fault1", "fault2"]);
    // The pillar in the middle has four corners, so that each fault is a little higher there.
    for (area, throw) in [(found[0].1, 4.0), (found[1].1, 3.0)] {
        assert!(
            (40.0 * (20.0 + throw)..40.0 * 27.0).contains(&area),
            "{area}"
        );
    }
}

#[test]
fn a_grid_is_written_again_as_it_was_read() {
    let model = Model {
        units: ["METRES", "METRES"],
        map_axes: Some([0.0, 100.0, 0.0, 0.0, 100.0, 0.0]),
        ..Model::PLAIN
    };
    let folder = folder(&model);
    let folder = folder.path();
    run(folder, "convert MODEL.EGRID out.GRDECL --quiet");
    run(folder, "convert out.GRDECL again.EGRID --quiet");
    run(folder, "convert TEXT.GRDECL text.GRDECL --quiet");
    assert_eq!(
        std::fs::read(folder.join("again.EGRID")).unwrap().len(),
        egrid(&model, 0).len()
    );
    for file in ["out.GRDECL", "text.GRDECL"] {
        assert_volumes(&info(folder, file)["grid"], 1.0);
    }
    let text = std::fs::read_to_string(folder.join("text.GRDECL")).unwrap();
    assert!(
        text.contains("FAULTS\n 'East' 2 2 1 3 1 5 I /\n/"),
        "{text}"
    );
    // Nothing is lost: the images and the second copies are the same to the byte.
    run(folder, "convert text.GRDECL twice.GRDECL --quiet");
    assert_eq!(
        text,
        std::fs::read_to_string(folder.join("twice.GRDECL")).unwrap()
    );
    run(folder, "convert again.EGRID again.GRDECL --quiet");
    let geometry = |name: &str| {
        let text = std::fs::read_to_string(folder.join(name)).unwrap();
        let end = text.find("PORV").unwrap_or(text.len());
        text[..end].to_string()
    };
    assert_eq!(geometry("again.GRDECL"), geometry("out.GRDECL"));
}

#[test]
fn an_exported_grid_is_read_back() {
    let folder = crate::simulators::folder();
    let folder = folder.path();
    run(
        folder,
        &format!(
            "export cells.vtu --to grdecl -o GRID.GRDECL {} --region labels.npy --depth-at-top 1000",
            crate::simulators::ROCK
        ),
    );
    // The deck includes the grid and the regions.
    let info = info(folder, "GRID.DATA:FIPNUM");
    let grid = &info["grid"];
    let volume = grid["volume"].as_f64().unwrap();
    assert!(
        is_close(volume, crate::simulators::VOLUME, 1e-6),
        "{volume}"
    );
    let regions = grid["regions"].as_array().unwrap();
    assert_eq!(regions.len(), 2, "{grid}");
    let sum: f64 = regions
        .iter()
        .map(|region| region["volume"].as_f64().unwrap())
        .sum();
    assert!(is_close(sum, volume, 1e-12));
    // The file alone has no regions.
    let alone = self::info(folder, "GRID.GRDECL");
    assert_eq!(
        [&alone["grid"]["property"], &alone["grid"]["volume"]],
        [&Value::from("K"), &grid["volume"]]
    );
}

#[test]
fn a_model_is_meshed_again() {
    let folder = folder(&Model::PLAIN);
    let folder = folder.path();
    run(folder, "convert MODEL.EGRID:FAULTS faults.vtp --quiet");
    let line = "mesh MODEL.EGRID --spacing 10,5,1 --distance 6 --drop 0 --surface faults.vtp,fault -o new.vtu";
    let report: Value =
        serde_json::from_str(&run(folder, &format!("{line} --json --quiet"))).unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    let regions = report["regions"]["regions"].as_array().unwrap();
    assert_eq!(regions.len(), 2);
    for (region, value) in regions.iter().zip([1, 2]) {
        let (volume, expected) = (number(&region["volume"]), expected_region(value).1);
        assert!(
            is_close(volume, expected, 0.02),
            "{value}: {volume}, not {expected}"
        );
    }
    // The fault of the old model is followed.
    let surfaces = report["given_surfaces"].as_array().unwrap();
    let cover: f64 = surfaces
        .iter()
        .map(|s| number(&s["coverage"]))
        .fold(1.0, f64::min);
    assert!(cover > 0.9, "{report}");
    let deck = "export new.vtu --to opm -o NEW.DATA --porosity MODEL.EGRID:PORO --permeability 100 --permeability-unit mD --json --quiet";
    let model: Value = serde_json::from_str(&run(folder, deck)).unwrap();
    let pores = number(&model["checks"]["pore_volume"]);
    let expected = expected_region(1).2 + expected_region(2).2;
    assert!(is_close(pores, expected, 0.02), "{pores}, not {expected}");
}

#[test]
#[expect(
    clippy::too_many_lines,
    reason = "a table of damages and their messages"
)]
fn damaged_and_odd_grids_are_refused_in_one_line() {
    let folder = folder(&Model::PLAIN);
    let folder = folder.path();
    let refusal = |bytes: &[u8], name: &str, expected: &str| {
        std::fs::write(folder.join(name), bytes).unwrap();
        let error = expect_refusal(folder, &["convert", name, "out.npy"]);
        assert!(error.contains(expected), "{error} (expected: {expected})");
    };
    let good = egrid(&Model::PLAIN, 0);
    refusal(&egrid(&Model::PLAIN, 1), "a.EGRID", "dual porosity");
    refusal(&egrid(&Model::PLAIN, 2), "a.EGRID", "dual permeability");
    refusal(&good[..good.len() / 2], "a.EGRID", "the file holds");
    refusal(
        &good[..600],
        "a.EGRID",
        "GRIDHEAD at byte 480: claims 100 elements",
    );
    refusal(&init(), "a.EGRID", "give the EGRID beside it");
    let at = |name: &[u8]| good.windows(name.len()).position(|w| w == name).unwrap();
    let mut changed = good.clone();
    changed[at(b"ZCORN") + 8..][..4].copy_from_slice(&2_000_000_000i32.to_be_bytes());
    refusal(&changed, "a.EGRID", "ZCORN at byte");
    let mut changed = good.clone();
    let head = at(b"GRIDHEAD") + 24;
    changed[head + 12..head + 16].copy_from_slice(&6i32.to_be_bytes());
    refusal(&changed, "a.EGRID", "ZCORN at byte");
    changed[head + 4..head + 16].copy_from_slice(&[0x7f; 12]);
    refusal(&changed, "a.EGRID", "claims a grid of");
    let mut changed = good.clone();
    changed[at(b"COORD") + 20] ^= 0x40;
    refusal(&changed, "a.EGRID", "COORD at byte");
    let mut changed = good.clone();
    let nan = at(b"ZCORN") + 28;
    changed[nan..nan + 4].copy_from_slice(&f32::NAN.to_be_bytes());
    refusal(
        &changed,
        "a.EGRID",
        "ZCORN holds a number that is not finite",
    );

    // An INIT of another run.
    std::fs::write(folder.join("b.EGRID"), &good).unwrap();
    let other = init();
    let at = other.windows(8).position(|w| w == b"INTEHEAD").unwrap() + 24 + 4 * 8;
    let mut changed = other.clone();
    changed[at + 3] = 9;
    std::fs::write(folder.join("b.INIT"), &changed).unwrap();
    let error = expect_refusal(folder, &["convert", "b.EGRID", "out.npy"]);
    assert!(error.contains("belongs to a grid of"), "{error}");

    let text = grdecl(&Model::PLAIN);
    let with = |from: &str, to: &str| text.replacen(from, to, 1).into_bytes();
    for (bytes, expected) in [
        (
            with("SPECGRID\n 4 3 5", "SPECGRID\n 4 3 6"),
            "ZCORN holds 480 numbers, but 4 x 3 x 6 cells need 576",
        ),
        (with("SPECGRID\n 4 3 5", "SPECGRID\n 4 3 4"), "ZCORN holds"),
        (
            with("SPECGRID\n 4 3 5", "SPECGRID\n 9999999 9999999 5"),
            "claims a grid of",
        ),
        (
            with("SPECGRID\n 4 3 5", "SPECGRID\n 4 3 x"),
            "three numbers of cells",
        ),
        (with("SPECGRID\n 4 3 5 1 F /", ""), "COORD comes before"),
        (
            with("ZCORN -- numbers\n", "ZCORN\n 4000000000000*1\n"),
            "ZCORN holds",
        ),
        (
            with("ZCORN -- numbers\n", "ZCORN\n 1.5 abc\n"),
            "ZCORN holds 'abc', which is not a number",
        ),
        (with("ZCORN -- numbers\n", "ZCORN\n 3*\n"), "ZCORN holds"),
        (
            with("GRIDUNIT\n METRES", "GRIDUNIT\n FURLONGS"),
            "the unit 'FURLONGS'",
        ),
        (with("'East' 2 2", "'East' 2 9"), "FAULTS has the record"),
        (with("PINCH", "DUALPORO\nPINCH"), "dual porosity"),
        (with("parts/regions.inc", "none.inc"), "includes none.inc"),
        (
            with("FAULTS\n", "EQUALS\n ZCORN 0 /\n/\nFAULTS\n"),
            "changes ZCORN",
        ),
        (
            text.as_bytes()[..text.len() / 2].to_vec(),
            "has no slash at its end",
        ),
        (
            b"SPECGRID\n 2 2 2 /\nDX\n 8*1 /\nDY\n 8*1 /\n".to_vec(),
            "one of blocks",
        ),
        (
            b"INCLUDE\n 'self.GRDECL' /\nSPECGRID\n".to_vec(),
            "too many other files",
        ),
    ] {
        let name = if bytes.starts_with(b"INCLUDE") {
            "self.GRDECL"
        } else {
            "t.GRDECL"
        };
        refusal(&bytes, name, expected);
    }
    std::fs::write(
        folder.join("t.GRDECL"),
        with("PORO -- numbers\n", "PORO\n 0.1 x\n"),
    )
    .unwrap();
    let error = expect_refusal(folder, &["convert", "t.GRDECL:PORO", "out.npy"]);
    assert!(
        error.contains("t.GRDECL:") && error.contains("'x', which is not a number"),
        "{error}"
    );
    std::fs::write(
        folder.join("t.GRDECL"),
        with("FAULTS\n", "EQUALS\n PORO .3 /\n/\nFAULTS\n"),
    )
    .unwrap();
    let error = expect_refusal(folder, &["convert", "t.GRDECL:PORO", "out.npy"]);
    assert!(
        error.contains("changes PORO") && error.contains("NOSIM"),
        "{error}"
    );
    let error = expect_refusal(folder, &["convert", "MODEL.EGRID:SWAT", "out.npy"]);
    assert!(
        error.contains("has no property SWAT") && error.contains("PORO"),
        "{error}"
    );
    for spacing in ["0", "1,2", "1e-9"] {
        let options = ["convert", "MODEL.EGRID", "out.npy", "--spacing", spacing];
        assert!(expect_refusal(folder, &options).contains("spacing"));
    }
}

#[test]
fn refinements_and_connections_are_said() {
    let folder = folder(&Model::PLAIN);
    let folder = folder.path();
    let mut file = ArrayFile(egrid(&Model::PLAIN, 0));
    file.texts("LGR", &["NEAR1"]);
    file.head("GRIDHEAD", &[(0, 1), (1, 1), (2, 1), (3, 1), (4, 1)]);
    file.reals("COORD", [0.0; 24]);
    file.integers("ENDGRID", []).integers("ENDLGR", []);
    file.head("NNCHEAD", &[(0, 7)]);
    file.integers("NNC1", 1..8).integers("NNC2", 11..18);
    std::fs::write(folder.join("MODEL.EGRID"), &file.0).unwrap();
    let info = info(folder, "MODEL.EGRID");
    assert_volumes(&info["grid"], 1.0);
    let notes = info["notes"].to_string();
    assert!(
        notes.contains("local refinements (NEAR1) are left out"),
        "{notes}"
    );
    assert!(
        notes.contains("7 connections of cells that are not neighbours (NNC)"),
        "{notes}"
    );
}

/// Runs `OPM Flow` on a deck without a simulation.
fn run_flow(folder: &Path, case: &str) {
    let arguments = [format!("{case}.DATA"), format!("--output-dir={case}")];
    run_simulator(Command::new("flow").current_dir(folder).args(arguments));
}

#[test]
#[ignore = "needs xtgeo, OPM Flow and resfo: make test-all"]
fn an_egrid_of_xtgeo_comes_out_as_it_went_in() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let path = folder.as_os_str();
    let script = "corner_points.py";
    let made = run_validator("xtgeo", script, &[OsStr::new("make"), path]);
    let volume = made["volume"].as_f64().unwrap();
    run(folder, "convert XTGEO.EGRID COPY.GRDECL --quiet");
    run(folder, "convert COPY.GRDECL COPY.EGRID --quiet");
    for file in ["XTGEO.EGRID", "XTGEO.GRDECL", "COPY.GRDECL", "COPY.EGRID"] {
        let info = info(folder, file);
        let grid = &info["grid"];
        assert_eq!(
            [&grid["active"], &grid["dims"]],
            [&made["active"], &made["dims"]],
            "{file}"
        );
        let found = grid["volume"].as_f64().unwrap();
        println!("{file}: {found} {volume}");
        // xtgeo cuts cells into tetrahedra, whose faces are not bilinear.
        assert!(is_close(found, volume, 1e-5), "{file}: {found} {volume}");
    }
    for case in ["XTGEO", "COPY"] {
        run_flow(folder, case);
    }
    let compared = run_validator("xtgeo", script, &[OsStr::new("compare"), path]);
    println!("{compared}");
    for (name, difference) in compared.as_object().unwrap() {
        let difference = difference.as_f64().unwrap();
        assert!(difference <= 1e-6, "{name}: {difference}");
    }
    // The sum of what OPM Flow reports as pore volumes is that of our volumes and porosities.
    let opm = info(folder, "XTGEO/XTGEO.EGRID");
    let pores = opm["grid"]["pore_volume"].as_f64().unwrap();
    let expected = run_validator("resfo", script, &[OsStr::new("pores"), path]);
    assert!(
        is_close(pores, expected["porv"].as_f64().unwrap(), 1e-6),
        "{pores} {expected}"
    );
}
