//! The lattice after each round as a ParaView time series: a `.pvd` collection and one `.vtp` file
//! of vertices a round, beside it.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::error::Result;
use crate::files::atomic_write;
use crate::files::vtk::xml::escape;
use crate::files::vtk::{DataArray, Document, Source};

/// Writes a trace; after every [`add`](Self::add) the files on disk are complete and consistent.
#[derive(Debug, Clone)]
pub struct Trace {
    path: PathBuf,
    /// Time and file name of each round so far.
    rounds: Vec<(f64, String)>,
}

impl Trace {
    /// Begins a trace with an empty collection at `path`.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if it cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let trace = Self {
            path: path.to_path_buf(),
            rounds: Vec::new(),
        };
        trace.write_collection()?;
        Ok(trace)
    }

    /// Adds a round: atoms in physical coordinates, and arrays with a tuple for each.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if a file cannot be written.
    pub fn add(&mut self, time: f64, atoms: &[[f64; 3]], data: &[DataArray]) -> Result<()> {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        let name = format!("{stem}_{:04}.vtp", self.rounds.len());
        write_vertices(&self.path.with_file_name(&name), atoms, data)?;
        self.rounds.push((time, name));
        self.write_collection()
    }

    fn write_collection(&self) -> Result<()> {
        atomic_write(&self.path, |out| {
            writeln!(
                out,
                "<?xml version=\"1.0\"?>\n\
                 <VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n  \
                 <Collection>"
            )?;
            for (time, name) in &self.rounds {
                let file = escape(name);
                writeln!(
                    out,
                    "    <DataSet timestep=\"{time:?}\" part=\"0\" file=\"{file}\"/>"
                )?;
            }
            writeln!(out, "  </Collection>\n</VTKFile>")
        })
    }
}

/// Points as VTK poly data, each a vertex.
fn write_vertices(path: &Path, points: &[[f64; 3]], data: &[DataArray]) -> Result<()> {
    let count = points.len();
    let none = ["NumberOfLines", "NumberOfStrips", "NumberOfPolys"].map(|n| (n, "0".to_string()));
    let some = ["NumberOfPoints", "NumberOfVerts"].map(|n| (n, count.to_string()));
    let mut document = Document::new("PolyData", &[]);
    document.open("Piece", &[&some[..], &none[..]].concat());
    document.open("PointData", &[]);
    for array in data {
        document.array(array.values.source(&array.name, array.components));
    }
    document.close();
    document.open("Points", &[]);
    document.array(Source::slice("Points", 3, points.as_flattened()));
    document.close();
    document.open("Verts", &[]);
    document.array(Source::computed("connectivity", 1, count, |i| i as i64));
    document.array(Source::computed("offsets", 1, count, |i| i as i64 + 1));
    document.close();
    atomic_write(path, |out| document.write(out))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::vtk::VtkFile;

    #[test]
    fn every_round_is_listed_and_readable() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run & co.pvd");
        let mut trace = Trace::create(&path).unwrap();
        for round in 0..3 {
            let atoms = [[f64::from(round), 0.25, -1.0], [4.0, 5.0, 6.0]];
            let data = [DataArray::scalars("energy", vec![round as f32, 2.0])];
            trace.add(f64::from(round), &atoms, &data).unwrap();
            let text = std::fs::read_to_string(&path).unwrap();
            let root = crate::files::vtk::xml::parse(text.as_bytes()).unwrap();
            let sets = &root.child("Collection").unwrap().children;
            assert_eq!(sets.len(), round as usize + 1);
            let name = sets[round as usize].attribute("file").unwrap();
            assert_eq!(name, format!("run & co_000{round}.vtp"));
            let file = VtkFile::read(&folder.path().join(name), "PolyData").unwrap();
            let piece = file.piece().unwrap();
            assert_eq!(piece.attribute("NumberOfVerts"), Some("2"));
            let points = file
                .array(&piece.child("Points").unwrap().children[0])
                .unwrap();
            assert_eq!(points.values, atoms.as_flattened().to_vec().into());
            let energy = file
                .array(&piece.child("PointData").unwrap().children[0])
                .unwrap();
            assert_eq!(energy, data[0]);
        }
        let missing = folder.path().join("nowhere/run.pvd");
        assert!(Trace::create(&missing).is_err());
    }
}
