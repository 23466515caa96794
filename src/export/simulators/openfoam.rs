//! Writes an OpenFOAM case that runs: `constant/polyMesh`, and the values of each cell as fields in
//! `0`.
//!
//! There is a patch for each side of the box, a cell zone for each region, a face zone for each
//! surface and each interface of two regions, and a point zone for the nodes of each of these and
//! of each side. A closed fault is a patch instead of a zone, with two faces back to back for each
//! of its faces.

use std::io::Write;
use std::path::Path;

use crate::error::cause;
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::meshers::groups::{FaceNames, face_nodes, sorted_regions};
use crate::export::names::{ExportNames, FormatNames, Naming, TablePlace};
use crate::files::Batch;
use crate::files::text::{FileWriter, WriteResult, write_items};
use crate::model::reservoir::Model;
use crate::names::{LetterCase, NameRules, is_identifier};
use crate::{Error, Result};

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "openfoam",
    description: "OpenFOAM case with constant/polyMesh",
    extensions: &[],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: false,
    supported_content: &[
        ExportContent::Names,
        ExportContent::Regions,
        ExportContent::Porosity,
        ExportContent::Permeability,
        ExportContent::Properties,
        ExportContent::ClosedFaults,
        ExportContent::FaultsWithoutRock,
    ],
    deck_path: None,
    names: FormatNames {
        node_set_prefix: Some(""),
        regions: Naming::Names(WORDS),
        faces: Naming::Names(NameRules {
            reserved: &["all", "internalMesh", "none"],
            ..WORDS
        }),
        // Fields are files.
        properties: Some(NameRules {
            case: LetterCase::Insensitive,
            reserved: &["T"],
            ..WORDS
        }),
        table: TablePlace::Comments("// "),
        ..FormatNames::NONE
    },
    write,
};

/// Rules of OpenFOAM for words, which are names of patches, zones and fields.
const WORDS: NameRules = NameRules {
    is_allowed: |c| is_identifier(c) || ['-', '.'].contains(&c),
    is_allowed_first: |c| is_identifier(c) && !c.is_ascii_digit(),
    ..NameRules::TEXT
};

/// Writes the case into the folder `path`. Other files in the folder are kept.
///
/// # Errors
/// Returns [`Error::Export`] if a fault is neither open nor closed, and [`Error::Io`] if a file
/// cannot be written.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &model.mesh;
    let face_names = &names.faces;
    let faces = FaceOrder::new(model, face_names)?;
    let folder = path.join("constant/polyMesh");
    batch.create_folder(&folder)?;
    batch.write(&folder.join("points"), |out| {
        write_list(out, "vectorField", "points", mesh.nodes.len(), |text, i| {
            let [x, y, z] = mesh.nodes[i];
            text.word("(")
                .real(x)
                .spaced_real(y)
                .spaced_real(z)
                .word(")")
                .end_line();
        })
    })?;
    let count = faces.faces.len();
    batch.write(&folder.join("faces"), |out| {
        write_list(out, "faceList", "faces", count, |text, i| {
            let OpenFoamFace { face, side, .. } = faces.faces[i];
            let ring = mesh.faces.get(face as usize);
            let last = ring.len() - 1;
            text.int(ring.len()).word("(");
            for k in 0..=last {
                let node = ring[if side == 0 { k } else { last - k }];
                text.word(if k == 0 { "" } else { " " }).int(node);
            }
            text.word(")").end_line();
        })
    })?;
    batch.write(&folder.join("owner"), |out| {
        write_list(out, "labelList", "owner", count, |text, i| {
            let OpenFoamFace { face, side, .. } = faces.faces[i];
            text.int(mesh.face_cells[face as usize][side]).end_line();
        })
    })?;
    batch.write(&folder.join("neighbour"), |out| {
        write_list(
            out,
            "labelList",
            "neighbour",
            faces.inner_count,
            |text, i| {
                text.int(mesh.face_cells[faces.faces[i].face as usize][1])
                    .end_line();
            },
        )
    })?;
    batch.write(&folder.join("boundary"), |out| {
        write_header(out, "polyBoundaryMesh", "boundary")?;
        write!(out, "{}", names.comments())?;
        let patches = || faces.faces[faces.inner_count..].chunk_by(|a, b| a.patch == b.patch);
        writeln!(out, "{}\n(", patches().count())?;
        let mut start = faces.inner_count;
        for patch in patches() {
            let (name, count) = (face_names.name(patch[0].patch), patch.len());
            writeln!(
                out,
                "{name}\n{{\n    type patch;\n    nFaces {count};\n    startFace {start};\n}}"
            )?;
            start += count;
        }
        writeln!(out, ")")
    })?;
    write_zones(model, batch, &folder, names, &faces)?;
    write_point_zones(model, batch, &folder, names)?;
    write_fields(model, names, batch, path)?;
    let has_closed = faces.faces.iter().any(|face| face.side == 1);
    write_case(batch, path, has_closed)
}

/// Face of the case.
#[derive(Debug, Clone, Copy)]
struct OpenFoamFace {
    /// Number of the face in the mesh.
    face: u32,
    /// Index of the cell that owns the face. It is 1 for the second side of a closed fault.
    side: usize,
    /// Number of the name of its patch; 0 for inner faces.
    patch: u32,
}

/// Faces in the order of OpenFOAM: first the inner faces, then patch after patch.
struct FaceOrder {
    faces: Vec<OpenFoamFace>,
    /// Number of inner faces.
    inner_count: usize,
}

impl FaceOrder {
    fn new(model: &Model, names: &FaceNames) -> Result<Self> {
        let mesh = &model.mesh;
        let mut order = Vec::with_capacity(mesh.face_cells.len());
        let mut outer = Vec::new();
        for f in 0..mesh.face_cells.len() {
            let face = |side, patch| OpenFoamFace {
                face: f as u32,
                side,
                patch,
            };
            if f >= mesh.inner_face_count() {
                outer.push(face(0, names.face_numbers[f]));
                continue;
            }
            match model.fault_factor(f) {
                0.0 => outer.extend([0, 1].map(|side| face(side, names.face_numbers[f]))),
                1.0 => order.push(face(0, 0)),
                factor => {
                    return Err(Error::Export(cause(
                        "an OpenFOAM case",
                        format!("cannot have faults with a multiplier of {factor}"),
                        "close the faults, or leave them open",
                    )));
                }
            }
        }
        let owner = |f: &OpenFoamFace| mesh.face_cells[f.face as usize][f.side];
        outer.sort_by_key(|f| (f.patch, owner(f)));
        let inner = order.len();
        order.extend(outer);
        Ok(Self {
            faces: order,
            inner_count: inner,
        })
    }
}

fn write_header(out: FileWriter, class: &str, object: &str) -> WriteResult {
    writeln!(
        out,
        "FoamFile\n{{\n    version 2.0;\n    format ascii;\n    class {class};\n    object {object};\n}}\n"
    )
}

/// Writes a file with a single list.
fn write_list(
    out: FileWriter,
    class: &str,
    object: &str,
    count: usize,
    format_item: impl Fn(&mut crate::files::text::TextBuilder, usize) + Sync,
) -> WriteResult {
    write_header(out, class, object)?;
    writeln!(out, "{count}\n(")?;
    write_items(out, count, format_item)?;
    writeln!(out, ")")
}

/// Writes a cell zone for each region if there are several, and a face zone for each name of inner
/// faces. All faces of a zone have the same orientation, as [`FaceNames::side`] says.
fn write_zones(
    model: &Model,
    batch: &mut Batch,
    folder: &Path,
    export_names: &ExportNames,
    faces: &FaceOrder,
) -> Result<()> {
    let (mesh, names) = (&model.mesh, &export_names.faces);
    let regions = sorted_regions(model);
    if regions.len() > 1 {
        batch.write(&folder.join("cellZones"), |out| {
            write_header(out, "regIOobject", "cellZones")?;
            writeln!(out, "{}\n(", regions.len())?;
            for &region in &regions {
                let is_in_region = |c: &u32| mesh.region[*c as usize] == region;
                let cells: Vec<u32> = (0..model.len() as u32).filter(is_in_region).collect();
                let name = export_names.region(region);
                writeln!(
                    out,
                    "{name}\n{{\n    type cellZone;\n    cellLabels List<label>"
                )?;
                writeln!(out, "{}\n(", cells.len())?;
                write_items(out, cells.len(), |text, i| text.int(cells[i]).end_line())?;
                writeln!(out, ");\n}}")?;
            }
            writeln!(out, ")")
        })?;
    }
    let mut zones: Vec<Vec<u32>> = vec![Vec::new(); names.names.len() + 1];
    for (i, face) in faces.faces[..faces.inner_count].iter().enumerate() {
        zones[names.face_numbers[face.face as usize] as usize].push(i as u32);
    }
    let zones: Vec<(u32, &Vec<u32>)> = (1..)
        .zip(&zones[1..])
        .filter(|(_, faces)| !faces.is_empty())
        .collect();
    if zones.is_empty() {
        return Ok(());
    }
    batch.write(&folder.join("faceZones"), |out| {
        write_header(out, "regIOobject", "faceZones")?;
        writeln!(out, "{}\n(", zones.len())?;
        for (name, zone_faces) in &zones {
            let (name, count) = (names.name(*name), zone_faces.len());
            writeln!(
                out,
                "{name}\n{{\n    type faceZone;\n    faceLabels List<label>\n{count}\n("
            )?;
            write_items(out, count, |text, i| text.int(zone_faces[i]).end_line())?;
            writeln!(out, ");\n    flipMap List<bool>\n{count}\n(")?;
            write_items(out, count, |text, i| {
                let face = faces.faces[zone_faces[i] as usize].face;
                text.int(u8::from(names.is_of_second_cell(face))).end_line();
            })?;
            writeln!(out, ");\n}}")?;
        }
        writeln!(out, ")")
    })
}

/// Writes a point zone for the nodes of each name of faces, and for each set of nodes.
fn write_point_zones(
    model: &Model,
    batch: &mut Batch,
    folder: &Path,
    names: &ExportNames,
) -> Result<()> {
    let groups = names.faces.groups().into_iter();
    let groups = groups.map(|group| (group.name, face_nodes(model, &group.faces)));
    let others = names.node_sets.iter();
    let others = others.map(|set| (set.name.clone(), set.members.clone()));
    let zones: Vec<(String, Vec<u32>)> = groups.chain(others).collect();
    batch.write(&folder.join("pointZones"), |out| {
        write_header(out, "regIOobject", "pointZones")?;
        writeln!(out, "{}\n(", zones.len())?;
        for (name, nodes) in &zones {
            let count = nodes.len();
            writeln!(
                out,
                "{name}\n{{\n    type pointZone;\n    pointLabels List<label>\n{count}\n("
            )?;
            write_items(out, count, |text, i| text.int(nodes[i]).end_line())?;
            writeln!(out, ");\n}}")?;
        }
        writeln!(out, ")")
    })
}

/// Writes the values of each cell as fields.
fn write_fields(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let cells = model.len();
    let folder = path.join("0");
    let mut scalar = |name: &str, dimensions: &str, value: &(dyn Fn(usize) -> f64 + Sync)| {
        batch.create_folder(&folder)?;
        batch.write(&folder.join(name), |out| {
            write_header(out, "volScalarField", name)?;
            writeln!(
                out,
                "dimensions {dimensions};\ninternalField nonuniform List<scalar>"
            )?;
            writeln!(out, "{cells}\n(")?;
            write_items(out, cells, |text, c| text.real(value(c)).end_line())?;
            writeln!(
                out,
                ");\nboundaryField\n{{\n    \".*\" {{ type zeroGradient; }}\n}}"
            )
        })
    };
    if let Some(porosity) = &model.porosity {
        scalar("porosity", "[0 0 0 0 0 0 0]", &|c| porosity[c])?;
    }
    for (property, name) in model.properties.iter().zip(&names.properties) {
        if property.components != 1 {
            continue;
        }
        let values = property.values.to_f64();
        scalar(name, "[0 0 0 0 0 0 0]", &|c| values[c])?;
    }
    if let Some(permeability) = &model.permeability {
        batch.create_folder(&folder)?;
        batch.write(&folder.join("permeability"), |out| {
            write_header(out, "volSymmTensorField", "permeability")?;
            writeln!(
                out,
                "dimensions [0 2 0 0 0 0 0];\ninternalField nonuniform List<symmTensor>"
            )?;
            writeln!(out, "{cells}\n(")?;
            write_items(out, cells, |text, c| {
                let [xx, yy, zz, xy, yz, xz] = permeability.rock.mobility(c).0;
                text.word("(").real(xx);
                [xy, xz, yy, yz, zz].into_iter().for_each(|k| {
                    text.spaced_real(k);
                });
                text.word(")").end_line();
            })?;
            writeln!(
                out,
                ");\nboundaryField\n{{\n    \".*\" {{ type zeroGradient; }}\n}}"
            )
        })?;
    }
    Ok(())
}

/// Writes the rest of a case that `laplacianFoam` can run, unless the folder is a case already:
/// `system`, a field T that falls from `xmin` to `xmax`, and its diffusivity. Closed faults may
/// enclose cells where no boundary condition determines T. With a time derivative and a very long
/// time step, T keeps its initial value there.
fn write_case(batch: &mut Batch, path: &Path, has_closed: bool) -> Result<()> {
    if path.join("system/controlDict").exists() {
        return Ok(());
    }
    let (scheme, time) = if has_closed {
        ("Euler", "1e12")
    } else {
        ("steadyState", "1")
    };
    let control = format!(
        "application laplacianFoam;\nstartFrom startTime;\nstartTime 0;\nstopAt endTime;\nendTime {time};\n\
         deltaT {time};\nwriteControl timeStep;\nwriteInterval 1;\nwritePrecision 15;"
    );
    let schemes = format!(
        "ddtSchemes {{ default {scheme}; }}\ngradSchemes {{ default leastSquares; }}\n\
         divSchemes {{ default none; }}\nlaplacianSchemes {{ default Gauss linear corrected; }}\n\
         interpolationSchemes {{ default linear; }}\nsnGradSchemes {{ default corrected; }}"
    );
    let files = [
        ("system", "controlDict", "dictionary", control.as_str()),
        ("system", "fvSchemes", "dictionary", schemes.as_str()),
        (
            "system",
            "fvSolution",
            "dictionary",
            "solvers\n{\n    \".*\"\n    {\n        solver PCG;\n        preconditioner DIC;\n        \
             tolerance 1e-14;\n        relTol 0;\n    }\n}\nSIMPLE { nNonOrthogonalCorrectors 30; }",
        ),
        (
            "constant",
            "transportProperties",
            "dictionary",
            "DT DT [0 2 -1 0 0 0 0] 1;",
        ),
        (
            "0",
            "T",
            "volScalarField",
            "dimensions [0 0 0 1 0 0 0];\ninternalField uniform 0;\nboundaryField\n{\n    \
             \".*\" { type zeroGradient; }\n    xmin { type fixedValue; value uniform 1; }\n    \
             xmax { type fixedValue; value uniform 0; }\n}",
        ),
    ];
    for (folder, name, class, content) in files {
        let folder = path.join(folder);
        batch.create_folder(&folder)?;
        batch.write(&folder.join(name), |out| {
            write_header(out, class, name)?;
            writeln!(out, "{content}")
        })?;
    }
    Ok(())
}
