//! An OpenFOAM case: `constant/polyMesh`, what is known of each cell as fields in `0`, and as much
//! of `system` as its utilities ask for.
//!
//! A patch for each side of the box, a cell zone for each region, and a face zone `features`.

use std::io::Write;
use std::path::Path;

use crate::Result;
use crate::export::containers::text::write_items;
use crate::export::meshers::groups::{region_name, regions};
use crate::files::Batch;
use crate::mesh::poly::{Beyond, SIDES};
use crate::model::reservoir::Model;

/// Writes the case into the folder `path`; what else is there stays.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if a file cannot be written.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &model.mesh;
    let inner = mesh.inner_faces();
    // Faces of the boundary patch after patch.
    let patch = |f: usize| match mesh.beyond(f) {
        Beyond::Side(side) => side,
        _ => SIDES.len(),
    };
    let mut order: Vec<u32> = (0..mesh.face_cells.len() as u32).collect();
    order[inner..].sort_by_key(|&f| (patch(f as usize), mesh.face_cells[f as usize][0]));

    let folder = path.join("constant/polyMesh");
    batch.folder(&folder)?;
    batch.write(&folder.join("points"), |out| {
        list(out, "vectorField", "points", mesh.nodes.len(), |text, i| {
            let [x, y, z] = mesh.nodes[i];
            text.word("(")
                .real(x)
                .and_real(y)
                .and_real(z)
                .word(")")
                .end();
        })
    })?;
    batch.write(&folder.join("faces"), |out| {
        list(out, "faceList", "faces", order.len(), |text, i| {
            let ring = mesh.faces.get(order[i] as usize);
            text.int(ring.len()).word("(").int(ring[0]);
            ring[1..].iter().for_each(|&n| {
                text.and_int(n);
            });
            text.word(")").end();
        })
    })?;
    batch.write(&folder.join("owner"), |out| {
        list(out, "labelList", "owner", order.len(), |text, i| {
            text.int(mesh.face_cells[order[i] as usize][0]).end();
        })
    })?;
    batch.write(&folder.join("neighbour"), |out| {
        list(out, "labelList", "neighbour", inner, |text, i| {
            text.int(mesh.face_cells[i][1]).end();
        })
    })?;
    let mut patches: Vec<(&str, usize, usize)> = Vec::new();
    for (i, &f) in order.iter().enumerate().skip(inner) {
        let name = SIDES.get(patch(f as usize)).copied().unwrap_or("boundary");
        match patches.last_mut() {
            Some(last) if last.0 == name => last.2 += 1,
            _ => patches.push((name, i, 1)),
        }
    }
    batch.write(&folder.join("boundary"), |out| {
        header(out, "polyBoundaryMesh", "boundary")?;
        writeln!(out, "{}\n(", patches.len())?;
        for (name, start, count) in &patches {
            writeln!(
                out,
                "{name}\n{{\n    type patch;\n    nFaces {count};\n    startFace {start};\n}}"
            )?;
        }
        writeln!(out, ")")
    })?;
    zones(model, batch, &folder, &order)?;
    fields(model, batch, path)?;
    system(batch, path)
}

type Out<'a> = &'a mut std::io::BufWriter<std::fs::File>;
type Done = std::io::Result<()>;

fn header(out: Out, class: &str, object: &str) -> Done {
    writeln!(
        out,
        "FoamFile\n{{\n    version 2.0;\n    format ascii;\n    class {class};\n    object {object};\n}}\n"
    )
}

/// A file that is one list.
fn list(
    out: Out,
    class: &str,
    object: &str,
    count: usize,
    put: impl Fn(&mut crate::export::containers::text::Text, usize) + Sync,
) -> Done {
    header(out, class, object)?;
    writeln!(out, "{count}\n(")?;
    write_items(out, count, put)?;
    writeln!(out, ")")
}

/// A cell zone for each region, if there are several, and a face zone of what is on features.
fn zones(model: &Model, batch: &mut Batch, folder: &Path, order: &[u32]) -> Result<()> {
    let mesh = &model.mesh;
    let regions = regions(mesh);
    if regions.len() > 1 {
        batch.write(&folder.join("cellZones"), |out| {
            header(out, "regIOobject", "cellZones")?;
            writeln!(out, "{}\n(", regions.len())?;
            for &region in &regions {
                let of = |c: &u32| mesh.region[*c as usize] == region;
                let cells: Vec<u32> = (0..model.len() as u32).filter(of).collect();
                let name = region_name(region);
                writeln!(
                    out,
                    "{name}\n{{\n    type cellZone;\n    cellLabels List<label>"
                )?;
                writeln!(out, "{}\n(", cells.len())?;
                write_items(out, cells.len(), |text, i| text.int(cells[i]).end())?;
                writeln!(out, ");\n}}")?;
            }
            writeln!(out, ")")
        })?;
    }
    let on_feature = |i: &u32| mesh.on_feature[order[*i as usize] as usize];
    let faces: Vec<u32> = (0..order.len() as u32).filter(on_feature).collect();
    if faces.is_empty() {
        return Ok(());
    }
    batch.write(&folder.join("faceZones"), |out| {
        header(out, "regIOobject", "faceZones")?;
        let count = faces.len();
        writeln!(
            out,
            "1\n(\nfeatures\n{{\n    type faceZone;\n    faceLabels List<label>"
        )?;
        writeln!(out, "{count}\n(")?;
        write_items(out, count, |text, i| text.int(faces[i]).end())?;
        writeln!(out, ");\n    flipMap List<bool> {count}{{0}};\n}}\n)")
    })
}

/// What is known of each cell.
fn fields(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let cells = model.len();
    let folder = path.join("0");
    let mut scalar = |name: &str, dimensions: &str, value: &(dyn Fn(usize) -> f64 + Sync)| {
        batch.folder(&folder)?;
        batch.write(&folder.join(name), |out| {
            header(out, "volScalarField", name)?;
            writeln!(
                out,
                "dimensions {dimensions};\ninternalField nonuniform List<scalar>"
            )?;
            writeln!(out, "{cells}\n(")?;
            write_items(out, cells, |text, c| text.real(value(c)).end())?;
            writeln!(
                out,
                ");\nboundaryField\n{{\n    \".*\" {{ type zeroGradient; }}\n}}"
            )
        })
    };
    if let Some(porosity) = &model.porosity {
        scalar("porosity", "[0 0 0 0 0 0 0]", &|c| porosity[c])?;
    }
    for property in model.properties.iter().filter(|p| p.components == 1) {
        let values = property.values.to_f64();
        scalar(&property.name, "[0 0 0 0 0 0 0]", &|c| values[c])?;
    }
    if let Some(permeability) = &model.permeability {
        batch.folder(&folder)?;
        batch.write(&folder.join("permeability"), |out| {
            header(out, "volSymmTensorField", "permeability")?;
            writeln!(
                out,
                "dimensions [0 2 0 0 0 0 0];\ninternalField nonuniform List<symmTensor>"
            )?;
            writeln!(out, "{cells}\n(")?;
            write_items(out, cells, |text, c| {
                let [xx, yy, zz, xy, yz, xz] = permeability.rock.mobility(c).0;
                text.word("(").real(xx);
                [xy, xz, yy, yz, zz].into_iter().for_each(|k| {
                    text.and_real(k);
                });
                text.word(")").end();
            })?;
            writeln!(
                out,
                ");\nboundaryField\n{{\n    \".*\" {{ type zeroGradient; }}\n}}"
            )
        })?;
    }
    Ok(())
}

/// What no utility starts without; kept if it is there.
fn system(batch: &mut Batch, path: &Path) -> Result<()> {
    let folder = path.join("system");
    batch.folder(&folder)?;
    let files = [
        (
            "controlDict",
            "application laplacianFoam;\nstartFrom startTime;\nstartTime 0;\nstopAt endTime;\n\
             endTime 1;\ndeltaT 1;\nwriteControl timeStep;\nwriteInterval 1;\nwritePrecision 15;",
        ),
        (
            "fvSchemes",
            "ddtSchemes { default steadyState; }\ngradSchemes { default leastSquares; }\n\
             divSchemes { default none; }\nlaplacianSchemes { default Gauss linear corrected; }\n\
             interpolationSchemes { default linear; }\nsnGradSchemes { default corrected; }",
        ),
        (
            "fvSolution",
            "solvers\n{\n    \".*\"\n    {\n        solver PCG;\n        preconditioner DIC;\n        \
             tolerance 1e-14;\n        relTol 0;\n    }\n}\nSIMPLE { nNonOrthogonalCorrectors 30; }",
        ),
    ];
    for (name, content) in files {
        let file = folder.join(name);
        if !file.exists() {
            batch.write(&file, |out| {
                header(out, "dictionary", name)?;
                writeln!(out, "{content}")
            })?;
        }
    }
    Ok(())
}
