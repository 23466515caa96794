//! Writes the lattice after each round as a ParaView time series: a `.pvd` collection, and in the
//! same folder one `.vtu` file per round.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::error::Result;
use crate::files::atomic_write;
use crate::files::vtk::xml::escape;
use crate::mesh::Simplices;
use crate::store::{MeshFile, write_vtu};

/// Writes a time series. After every [`add`](Self::add) the files on disk are complete and
/// consistent.
#[derive(Debug, Clone)]
pub struct PvdSeries {
    path: PathBuf,
    /// Time and file name of each round so far.
    rounds: Vec<(f64, String)>,
}

impl PvdSeries {
    /// Starts a series with an empty collection at `path`.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let series = Self {
            path: path.to_path_buf(),
            rounds: Vec::new(),
        };
        series.write_collection()?;
        Ok(series)
    }

    /// Adds a round: the lattice's cells in physical coordinates, with their data.
    ///
    /// # Errors
    /// Returns the errors of [`write_vtu`].
    pub fn add<const D: usize, M: Simplices<D>>(
        &mut self,
        time: f64,
        lattice: &MeshFile<M>,
    ) -> Result<()> {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        let name = format!("{stem}_{:04}.vtu", self.rounds.len());
        write_vtu(&self.path.with_file_name(&name), lattice)?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;
    use crate::store::{FieldValue, read_vtu};

    #[test]
    fn every_round_is_listed_and_readable() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run & co.pvd");
        let mut series = PvdSeries::create(&path).unwrap();
        for round in 0..3u8 {
            let lattice = MeshFile {
                mesh: TetMesh {
                    nodes: vec![
                        [f64::from(round), 0.25, 0.0],
                        [4.0, 5.0, 0.0],
                        [0.0, 7.0, 0.0],
                        [1.0; 3],
                    ],
                    tets: vec![[0, 1, 2, 3]],
                },
                point_data: Vec::new(),
                cell_data: Vec::new(),
                field_data: vec![("energy".into(), FieldValue::F64s(vec![-0.5]))],
            };
            series.add(f64::from(round), &lattice).unwrap();
            let text = std::fs::read_to_string(&path).unwrap();
            let root = crate::files::vtk::xml::parse(text.as_bytes()).unwrap();
            let sets = &root.child("Collection").unwrap().children;
            assert_eq!(sets.len(), usize::from(round) + 1);
            let name = sets[usize::from(round)].attribute("file").unwrap();
            assert_eq!(name, format!("run & co_000{round}.vtu"));
            let read = read_vtu(&folder.path().join(name)).unwrap();
            assert_eq!(
                (read.mesh, read.field_data),
                (lattice.mesh, lattice.field_data)
            );
        }
        let missing = folder.path().join("nowhere/run.pvd");
        assert!(PvdSeries::create(&missing).is_err());
    }
}
