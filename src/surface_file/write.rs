//! The choice of the format of labelled surfaces, and of their names in it.

use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

use super::obj::write_obj;
use super::tsurf::write_tsurf;
use super::vtp::write_vtp;
use super::{SurfaceFile, has_extension};
use crate::Result;
use crate::files::atomic_write;
use crate::names::{NameEntry, NameRules, NameTable, WantedName, assign};

/// Surfaces with their names in a file.
pub(crate) struct WrittenSurfaces<'a, const D: usize> {
    /// The surfaces with these names.
    pub file: Cow<'a, SurfaceFile<D>>,
    /// The table of names.
    pub table: NameTable,
}

impl<const D: usize> WrittenSurfaces<'_, D> {
    /// Writes the table beside the file at `path`, if a name changed.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn write_table(&self, path: &Path) -> Result<()> {
        if !self.table.is_needed() {
            return Ok(());
        }
        atomic_write(&NameTable::path_beside(path), |out| {
            out.write_all(self.table.csv().as_bytes())
        })
    }
}

impl<const D: usize> SurfaceFile<D> {
    /// Returns the surfaces with names by the rules of a format.
    pub(crate) fn written_names(&self, rules: &NameRules) -> WrittenSurfaces<'_, D> {
        let wanted = (1..).zip(&self.names).map(|(number, name): (usize, _)| {
            WantedName::given_or(Some(name), || format!("surface{number}"))
        });
        let names = assign(rules, &wanted.collect::<Vec<_>>());
        let pairs = (1..).zip(self.names.iter().zip(&names));
        let entries = pairs.map(|(number, (name, written))| NameEntry {
            kind: "surface",
            number,
            name: name.clone(),
            written: written.clone(),
            is_numbered: false,
            is_given: true,
        });
        let table = NameTable {
            entries: entries.collect(),
        };
        let file = if names == self.names {
            Cow::Borrowed(self)
        } else {
            Cow::Owned(Self {
                names,
                ..self.clone()
            })
        };
        WrittenSurfaces { file, table }
    }

    /// Writes the surfaces in the format of the file's ending: `.obj`, GOCAD's `.ts` and `.pl`, or VTK's
    /// `.vtp` for all others.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        if has_extension(path, &["obj"]) {
            return write_obj(path, self);
        }
        let written = self.written_names(&NameRules::TEXT);
        if has_extension(path, &["ts", "pl"]) {
            write_tsurf(path, &written.file)?;
        } else {
            write_vtp(path, &written.file)?;
        }
        written.write_table(path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::vtk::{DataArray, Values, VtkFile};
    use crate::surface_file::tsurf::{Gocad, read_gocad};
    use crate::surface_file::vtp::read_surfaces;
    use std::collections::BTreeMap;
    use std::path::Path;

    /// Returns a square of two triangles and a distant triangle, from a mesh with unused nodes.
    fn two_surfaces() -> SurfaceFile<3> {
        let nodes = [
            [9.0, 9.0, 9.0],
            [612_345.678, 6_123_456.789, -1e-3],
            [612_346.0, 6_123_456.0, 0.1],
            [612_345.0, 6_123_457.0, 1.0 / 3.0],
            [612_346.0, 6_123_457.0, -7.5],
            [8.0, 8.0, 8.0],
            [1e-7, -2.0, 3e20],
        ];
        let facets = [[1, 2, 4], [1, 4, 3], [6, 4, 2]];
        SurfaceFile::new(&nodes, &facets, &[0, 2, 3], "fault")
    }

    #[test]
    fn only_nodes_in_use_are_kept() {
        let file = two_surfaces();
        assert_eq!((file.nodes.len(), &file.labels()[..]), (5, &[1, 1, 2][..]));
        assert_eq!(file.nodes[0], [612_345.678, 6_123_456.789, -1e-3]);
        assert_eq!(file.facets, [[0, 1, 3], [0, 3, 2], [4, 3, 1]]);
        assert_eq!(file.names, ["fault1", "fault2"]);
    }

    #[test]
    fn vtp_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.vtp");
        let mut file = two_surfaces();
        file.cell_data = vec![DataArray::scalars("dip", vec![10f32, 10.0, 80.0])];
        write_vtp(&path, &file).unwrap();
        let read = VtkFile::read(&path, "PolyData").unwrap();
        let piece = read.piece().unwrap();
        assert_eq!(piece.attribute("NumberOfPolys"), Some("3"));
        let array = |group: &str, i: usize| {
            read.array(&piece.child(group).unwrap().children[i])
                .unwrap()
        };
        assert_eq!(
            array("Points", 0).values,
            file.nodes.as_flattened().to_vec().into()
        );
        assert_eq!(
            array("Polys", 0).values,
            vec![0i64, 1, 3, 0, 3, 2, 4, 3, 1].into()
        );
        assert_eq!(array("Polys", 1).values, vec![3i64, 6, 9].into());
        assert_eq!(
            array("CellData", 0),
            DataArray::scalars("surface", vec![1, 1, 2])
        );
        assert_eq!(array("CellData", 1), file.cell_data[0]);
        let fields = read.data_set().child("FieldData").unwrap();
        assert_eq!(read.text(&fields.children[0]).unwrap(), "fault1\nfault2");

        let reread = read_surfaces(&path).unwrap();
        assert_eq!(
            (&reread.names, &reread.surface_starts),
            (&file.names, &file.surface_starts)
        );
        for (facet, expected) in reread.facets.iter().zip(&file.facets) {
            let [actual, expected] = [(&reread, facet), (&file, expected)]
                .map(|(file, facet)| facet.map(|n| file.nodes[n as usize]));
            assert_eq!(actual, expected);
        }

        file.cell_data[0].values = Values::U8(vec![1]);
        let error = write_vtp(&path, &file).unwrap_err().to_string();
        assert!(
            error.contains("'dip' has 1 numbers for 3 facets"),
            "{error}"
        );

        let lines = SurfaceFile::new(
            &[[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]],
            &[[0, 1], [1, 2]],
            &[0, 2],
            "line",
        );
        write_vtp(&path, &lines).unwrap();
        let read = VtkFile::read(&path, "PolyData").unwrap();
        let piece = read.piece().unwrap();
        assert_eq!(piece.attribute("NumberOfLines"), Some("2"));
        let points = read
            .array(&piece.child("Points").unwrap().children[0])
            .unwrap();
        assert_eq!(
            points.values,
            vec![0.0, 1.0, 0.0, 2.0, 3.0, 0.0, 4.0, 5.0, 0.0].into()
        );
    }

    #[test]
    fn obj_has_a_group_for_each_surface() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.obj");
        let file = two_surfaces();
        write_obj(&path, &file).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines = |prefix: &str| -> Vec<&str> {
            text.lines().filter(|l| l.starts_with(prefix)).collect()
        };
        let nodes: Vec<[f64; 3]> = (lines("v ").iter())
            .map(|l| {
                let words: Vec<f64> = l[2..].split(' ').map(|w| w.parse().unwrap()).collect();
                words.try_into().unwrap()
            })
            .collect();
        assert_eq!(nodes, file.nodes);
        assert_eq!(lines("g"), ["g fault1", "g fault2"]);
        assert_eq!(lines("f"), ["f 1 2 4", "f 1 4 3", "f 5 4 2"]);
        assert!(text.find("g fault2").unwrap() > text.find("f 1 4 3").unwrap());
    }

    /// GOCAD object as a strict reader sees it: name, whether z is up, triangles.
    type GocadObject = (String, bool, Vec<[[f64; 3]; 3]>);

    /// Reads TSurf objects. Panics at any line that the format does not allow at that position.
    fn read_tsurf(path: &Path) -> Vec<GocadObject> {
        let text = std::fs::read_to_string(path).unwrap();
        let mut lines = text.lines();
        let mut objects = Vec::new();
        while let Some(first) = lines.next() {
            let mut expect = |expected: &str| assert_eq!(lines.next(), Some(expected));
            assert_eq!(first, "GOCAD TSurf 1");
            expect("HEADER {");
            let name = lines
                .next()
                .unwrap()
                .strip_prefix("name:")
                .unwrap()
                .to_string();
            let mut expect = |expected: &str| assert_eq!(lines.next(), Some(expected));
            expect("}");
            expect("GOCAD_ORIGINAL_COORDINATE_SYSTEM");
            expect("NAME Default");
            expect("AXIS_NAME \"X\" \"Y\" \"Z\"");
            expect("AXIS_UNIT \"m\" \"ft\" \"ms\"");
            let z_up = match lines.next().unwrap() {
                "ZPOSITIVE Elevation" => true,
                "ZPOSITIVE Depth" => false,
                other => panic!("{other}"),
            };
            let mut expect = |expected: &str| assert_eq!(lines.next(), Some(expected));
            expect("END_ORIGINAL_COORDINATE_SYSTEM");
            expect("TFACE");
            let mut nodes = BTreeMap::new();
            let mut triangles = Vec::new();
            loop {
                let words: Vec<&str> = lines.next().unwrap().split(' ').collect();
                match words[..] {
                    ["VRTX", id, x, y, z] => {
                        assert!(triangles.is_empty(), "vertices come first");
                        let id: u32 = id.parse().unwrap();
                        let x = [x, y, z].map(|w| w.parse::<f64>().unwrap());
                        assert_eq!(nodes.insert(id, x), None);
                    }
                    ["TRGL", a, b, c] => {
                        triangles.push([a, b, c].map(|w| nodes[&w.parse::<u32>().unwrap()]));
                    }
                    ["END"] => break,
                    _ => panic!("{words:?}"),
                }
            }
            assert!(nodes.keys().copied().eq(1..=nodes.len() as u32));
            objects.push((name, z_up, triangles));
        }
        objects
    }

    #[test]
    fn tsurf_has_an_object_for_each_surface() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ts");
        let mut file = two_surfaces();
        file.units = ["m", "ft", "ms"].map(String::from);
        for z_up in [true, false] {
            file.z_up = z_up;
            write_tsurf(&path, &file).unwrap();
            let objects = read_tsurf(&path);
            assert_eq!(objects.len(), 2);
            for (s, (name, up, triangles)) in objects.iter().enumerate() {
                assert_eq!((name, *up), (&file.names[s], z_up));
                let expected = file
                    .surface_facets(s)
                    .iter()
                    .map(|f| f.map(|n| file.nodes[n as usize]));
                assert!(triangles.iter().copied().eq(expected));
            }
            let Gocad::Surfaces(reread) = read_gocad(&path).unwrap() else {
                panic!("no surfaces")
            };
            assert_eq!(
                (&reread.names, &reread.units, reread.z_up),
                (&file.names, &file.units, z_up)
            );
            assert_eq!(reread.surface_starts, file.surface_starts);
            for (facet, expected) in reread.facets.iter().zip(&file.facets) {
                let [actual, expected] = [(&reread, facet), (&file, expected)]
                    .map(|(file, facet)| facet.map(|n| file.nodes[n as usize]));
                assert_eq!(actual, expected);
            }
        }
        let lines = SurfaceFile::new(&[[0.5, 1.0], [2.0, 3.0]], &[[0, 1]], &[0, 1], "line");
        write_tsurf(&path, &lines).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("GOCAD PLine 1\n") && text.contains("ILINE\nVRTX 1 0.5 1 0\n"));
        assert!(text.contains("AXIS_UNIT \"unitless\" \"unitless\" \"unitless\"\n"));
        assert!(text.ends_with("SEG 1 2\nEND\n"), "{text}");
        let Gocad::Lines(reread) = read_gocad(&path).unwrap() else {
            panic!("no lines")
        };
        assert_eq!((reread.nodes, reread.facets), (lines.nodes, lines.facets));
    }

    #[test]
    fn foreign_gocad_files_are_read_and_errors_name_the_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ts");
        let text = "GOCAD Well 1\nVRTX 1 bad\nEND\nGOCAD TSurf 1\nHEADER {\n*name: x\nname: Top Etive \n}\n\
                    TFACE\nPVRTX 10 1 2 3 0.5\nVRTX 11 2 2 3 CNXYZ\nVRTX 12 2 3 3\nPATOM 13 10 7\n\
                    TRGL 10 11 12\nTRGL 13 12 11\nBSTONE 10\nEND\n";
        std::fs::write(&path, text).unwrap();
        let Gocad::Surfaces(file) = read_gocad(&path).unwrap() else {
            panic!("no surfaces")
        };
        assert_eq!(
            (file.names, file.facets),
            (vec!["Top Etive".into()], vec![[0, 1, 2], [0, 2, 1]])
        );
        for (old, new, line) in [
            ("TRGL 13 12 11", "TRGL 13 12 99", 15),
            ("VRTX 12 2 3 3", "VRTX 12 2 x 3", 12),
        ] {
            std::fs::write(&path, text.replace(old, new)).unwrap();
            let message = read_gocad(&path).unwrap_err().to_string();
            assert!(message.contains(&format!("a.ts:{line}: ")), "{message}");
        }
        std::fs::write(&path, "GOCAD Voxet 1\nEND\n").unwrap();
        assert!(read_gocad(&path).is_err());
    }
}
