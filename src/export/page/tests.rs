use super::*;
use crate::files::vtk::DataArray;
use crate::image::Geometry;
use crate::image::synth::{self, SyntheticKind};
use crate::mesh::complex::NONE;
use crate::mesh::poly::samples::two_cells;
use crate::mesh::{Mesh, TriMesh};
use crate::store::MeshFile;
use std::collections::BTreeMap;
use std::io::Read;

/// Contents of a page, unpacked as unpack.js does it.
struct Unpacked {
    metadata: Value,
    streams: BTreeMap<String, (usize, Vec<u8>)>,
}

impl Unpacked {
    fn from_html(html: &str) -> Self {
        let element_text = |start: &str| {
            let begin = html.find(start).unwrap() + start.len();
            &html[begin..begin + html[begin..].find("</script>").unwrap()]
        };
        let metadata: Value = serde_json::from_str(element_text("id=\"facts\">")).unwrap();
        let letters = element_text("id=\"data\">").trim();
        let value = |letter: u8| match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => 0,
        };
        let mut packed = Vec::new();
        for chunk in letters.as_bytes().chunks(4) {
            let word = (chunk.iter()).fold(0u32, |word, &l| word << 6 | u32::from(value(l)));
            let bytes = word.to_be_bytes();
            let padding = chunk.iter().filter(|&&l| l == b'=').count();
            packed.extend_from_slice(&bytes[1..4 - padding]);
        }
        let mut decompressed = Vec::new();
        let mut decoder = flate2::read::ZlibDecoder::new(&packed[..]);
        decoder.read_to_end(&mut decompressed).unwrap();
        let mut streams = BTreeMap::new();
        let mut start = 0;
        for stream in metadata["streams"].as_array().unwrap() {
            let number = |k: usize| stream[k].as_u64().unwrap() as usize;
            let bytes = decompressed[start..start + number(2)].to_vec();
            start += number(2);
            streams.insert(stream[0].as_str().unwrap().to_string(), (number(1), bytes));
        }
        assert_eq!(start, decompressed.len());
        Self { metadata, streams }
    }

    fn numbers(&self, name: &str) -> Vec<u32> {
        let (count, bytes) = &self.streams[name];
        let mut numbers = Vec::new();
        let (mut number, mut shift) = (0u32, 0);
        for &byte in bytes {
            number |= u32::from(byte & 127) << shift;
            shift += 7;
            if byte < 128 {
                numbers.push(number);
                (number, shift) = (0, 0);
            }
        }
        assert_eq!(numbers.len(), *count);
        numbers
    }

    /// Returns each face as the coordinates of its nodes, the numbers of its cells in the mesh, and
    /// its surface.
    fn faces(&self) -> Vec<(Vec<[u16; 3]>, [u32; 2], u32)> {
        let signed = |n: u32| (n >> 1) as i64 ^ -i64::from(n & 1);
        let mut position = [0i64; 3];
        let nodes: Vec<[u16; 3]> = (self.numbers("nodes").chunks(3))
            .map(|step| {
                position = std::array::from_fn(|k| position[k] + signed(step[k]));
                position.map(|c| u16::try_from(c).unwrap())
            })
            .collect();
        let mut newest = 0;
        let corners: Vec<u32> = (self.numbers("corners").into_iter())
            .map(|offset| {
                let node = newest - offset;
                newest += u32::from(offset == 0);
                node
            })
            .collect();
        let mut cell = 0;
        let numbers: Vec<u32> = (self.numbers("numbers").into_iter())
            .map(|step| {
                cell += signed(step);
                cell as u32
            })
            .collect();
        let (mut start, mut owner) = (0, 0);
        let sizes = self.numbers("sizes").into_iter();
        let sides = (self.numbers("owners").into_iter())
            .zip(self.numbers("beyond"))
            .zip(self.numbers("surfaces"));
        sizes
            .zip(sides)
            .map(|(size, ((step, beyond), surface))| {
                let ring = &corners[start..start + size as usize];
                start += size as usize;
                owner += step;
                let neighbour = match beyond {
                    0 => NONE,
                    step => numbers[(owner + step) as usize],
                };
                let positions = ring.iter().map(|&n| nodes[n as usize]).collect();
                (positions, [numbers[owner as usize], neighbour], surface)
            })
            .collect()
    }
}

fn stored<const D: usize, M: Storable<D>>(mesh: M, cell_data: Vec<DataArray>) -> StoredMesh<D, M> {
    let file = MeshFile {
        mesh,
        point_data: Vec::new(),
        cell_data,
        field_data: Vec::new(),
    };
    StoredMesh::new(file, "mesh").unwrap()
}

/// Writes a page and unpacks it.
fn write_page<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    image: Option<&Image<D>>,
    max_bytes: usize,
) -> Result<(PageStats, Unpacked, String)> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("page.html");
    let info = PageInfo {
        title: "<b> & </script>".to_string(),
        report: json!({ "note": "</script><script>alert(1)</script>" }),
        ..PageInfo::default()
    };
    let stats = write(&path, image, stored, &info, max_bytes)?;
    let html = std::fs::read_to_string(&path).unwrap();
    assert_eq!(html.len(), stats.bytes);
    Ok((stats, Unpacked::from_html(&html), html))
}

/// Returns a box of cubes, each cut into six tetrahedra.
fn cubes(count: usize) -> crate::mesh::TetMesh {
    let side = count + 1;
    let node = |x: usize, y: usize, z: usize| ((z * side + y) * side + x) as u32;
    let nodes = (0..side.pow(3))
        .map(|i| [i % side, i / side % side, i / (side * side)].map(|c| c as f64))
        .collect();
    let mut tets = Vec::new();
    for i in 0..count.pow(3) {
        let [x, y, z] = [i % count, i / count % count, i / (count * count)];
        let corner = |c: usize| node(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2));
        for [a, b] in [[1, 3], [5, 1], [3, 2], [2, 6], [4, 5], [6, 4]] {
            tets.push([0, a, b, 7].map(corner));
        }
    }
    crate::mesh::TetMesh { nodes, tets }
}

#[test]
fn faces_cells_and_values_are_recovered() {
    let mesh = cubes(4);
    let count = mesh.tets.len();
    let values: Vec<f32> = (0..count).map(|c| (c as f32 * 0.7).sin()).collect();
    let labels: Vec<i32> = (0..count).map(|c| c as i32 / 7 - 3).collect();
    let mut bits = vec![0u8; count];
    bits[5] = 0b0100;
    let stored = stored(
        mesh,
        vec![
            DataArray::scalars("min_dihedral", values.clone()),
            DataArray::scalars("label", labels.clone()),
            DataArray::scalars("feature_faces", bits),
        ],
    );
    let (stats, page, html) = write_page(&stored, None, MAX_PAGE_BYTES).unwrap();
    // With 256 steps, the cutting plane separates the centres of all cells that share a face.
    let (sides, inside) = (6 * 4 * 4 * 2, (4 * count - 6 * 4 * 4 * 2) / 2);
    assert_eq!(
        (stats.faces, stats.total_faces),
        (sides + inside, sides + inside)
    );
    assert!(!stats.is_thinned && stats.cut_steps == 256);

    let faces = page.faces();
    let mut face_counts = vec![0; count];
    for (positions, cells, _) in &faces {
        assert_eq!(positions.len(), 3);
        for &cell in cells.iter().filter(|&&c| c != NONE) {
            face_counts[cell as usize] += 1;
            // All nodes of the face are nodes of its cells, at the same position up to 1/65535 of
            // the box.
            let corners = stored.lattice.corners(cell as usize);
            let is_close = |p: &[u16; 3], q: &[f64; 3]| {
                (0..3).all(|k| (f64::from(p[k]) / 65535.0 * 4.0 - q[k]).abs() < 1e-4)
            };
            assert!(
                positions
                    .iter()
                    .all(|p| corners.iter().any(|q| is_close(p, q)))
            );
        }
    }
    assert!(face_counts.iter().all(|&faces| faces == 4));
    assert_eq!(faces.iter().filter(|face| face.2 > 0).count(), 1);

    // Values are in the order of the cells in the page.
    let numbers: Vec<u32> = {
        let mut cell = 0i64;
        let steps = page.numbers("numbers").into_iter();
        steps
            .map(|n| {
                cell += (n >> 1) as i64 ^ -i64::from(n & 1);
                cell as u32
            })
            .collect()
    };
    let arrays = page.metadata["arrays"].as_array().unwrap();
    let read = |name: &str| -> Vec<f64> {
        let array = arrays.iter().find(|a| a["name"] == name).unwrap();
        let (low, step) = (
            array["low"].as_f64().unwrap(),
            array["step"].as_f64().unwrap(),
        );
        let (count, bytes) = &page.streams[&format!("array {name}")];
        let words = (0..*count).map(|i| u16::from_le_bytes([bytes[i], bytes[count + i]]));
        words.map(|word| low + step * f64::from(word)).collect()
    };
    for (index, &cell) in numbers.iter().enumerate() {
        let cell = cell as usize;
        assert!((read("min_dihedral")[index] - f64::from(values[cell])).abs() < 2.0 / 65534.0);
        assert_eq!(read("label")[index], f64::from(labels[cell]));
    }
    assert!(!arrays.iter().any(|array| array["name"] == "feature_faces"));
    assert_eq!(arrays[0]["unit"], "degrees");

    // Text of the user cannot end its element in the page.
    assert_eq!(html.matches("</script>").count(), 3);
    assert!(html.contains("<title>&lt;b&gt; &amp; &lt;/script&gt;</title>"));
    assert!(!html.contains("{{") && !html.contains("://"));
}

#[test]
fn polyhedra_triangles_and_polygons_are_written() {
    let (_, page_of_cells, _) =
        write_page(&stored(two_cells::<3>(0.75), vec![]), None, MAX_PAGE_BYTES).unwrap();
    let faces = page_of_cells.faces();
    assert_eq!(
        faces
            .iter()
            .filter(|(_, cells, _)| cells[1] != NONE)
            .count(),
        1
    );
    assert!(faces.iter().all(|(places, _, _)| places.len() == 4));

    let square = TriMesh {
        nodes: vec![[0.0; 2], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]],
        triangles: vec![[0, 1, 2], [2, 1, 3]],
    };
    let edge_flags = vec![DataArray::scalars("feature_edges", vec![1u8, 0])];
    let image = Image::new([3, 3], vec![0.5; 9], Geometry::default());
    let (_, flat, _) =
        write_page(&stored(square, edge_flags), Some(&image), MAX_PAGE_BYTES).unwrap();
    assert_eq!(flat.faces().len(), 2);
    assert_eq!(flat.numbers("lines"), [1]);
    assert_eq!(flat.numbers("ends").len(), 2);
    let (_, cells, _) =
        write_page(&stored(two_cells::<2>(0.75), vec![]), None, MAX_PAGE_BYTES).unwrap();
    let mut sizes: Vec<usize> = cells.faces().iter().map(|face| face.0.len()).collect();
    sizes.sort_unstable();
    assert_eq!(sizes, [4, 4]);
}

/// A page omits exactly the faces whose cells are not separated by any position of the cutting
/// plane.
#[test]
fn fewer_cut_positions_keep_fewer_faces() {
    let mut mesh = cubes(12);
    // The nodes are moved off the positions of the cutting plane, where comparisons would be ties.
    for node in &mut mesh.nodes {
        *node = node.map(|c| c + 0.013 * (c * (12.0 - c)) / 36.0);
    }
    let stored = stored(mesh, vec![]);
    let faces = DrawableFaces::from_mesh(&stored, &[]).unwrap();
    let mut previous = faces.len();
    for steps in [8, 4, 2] {
        let kept = PageMesh::new(&faces, steps);
        assert!(kept.faces.len() < previous);
        previous = kept.faces.len();
        let kept: std::collections::BTreeSet<u32> = kept.faces.into_iter().collect();
        for (face, &[a, b]) in faces.cells.iter().enumerate() {
            let is_separated = b == NONE
                || (1..steps).any(|place| {
                    let position = place as f64 / steps as f64;
                    let [p, q] = [a, b].map(|c| faces.cell_centres[c as usize]);
                    (0..3).any(|k| (p[k] < position) != (q[k] < position))
                });
            assert_eq!(
                kept.contains(&(face as u32)),
                is_separated,
                "{steps} {face}"
            );
        }
    }
    for steps in [CUT_STEPS[0], 8, 4, 2] {
        let kept = PageMesh::new(&faces, steps);
        let counted = culling::count(&faces, steps);
        assert_eq!(counted, (kept.faces.len(), kept.cells.len()));
    }
    let (full, _, _) = write_page(&stored, None, MAX_PAGE_BYTES).unwrap();
    let (thinned, unpacked, _) = write_page(&stored, None, full.bytes - 40_000).unwrap();
    assert!(thinned.is_thinned && thinned.bytes <= full.bytes - 40_000);
    assert!(thinned.faces < full.faces && unpacked.faces().len() == thinned.faces);
    assert_eq!(unpacked.metadata["thinned"], true);
}

#[test]
fn too_large_page_is_an_error() {
    let error = write_page(&stored(cubes(12), vec![]), None, 60_000)
        .err()
        .unwrap();
    let message = error.to_string();
    assert!(
        message.contains("would have 0.") && message.contains("the limit is 0.1 MB"),
        "{message}"
    );
}

#[test]
fn a_page_is_the_same_every_time() {
    let options = synth::Options {
        dims: [20, 18, 16],
        ..Default::default()
    };
    let image = synth::make(SyntheticKind::Sphere, &options).unwrap().image;
    let mut mesh = cubes(4);
    for node in &mut mesh.nodes {
        *node = std::array::from_fn(|k| node[k] * [19.0, 17.0, 15.0][k] / 4.0);
    }
    let stored = stored(mesh, vec![]);
    let (stats, unpacked, first) = write_page(&stored, Some(&image), MAX_PAGE_BYTES).unwrap();
    assert_eq!(
        first,
        write_page(&stored, Some(&image), MAX_PAGE_BYTES).unwrap().2
    );
    assert!(stats.bytes < 200_000);
    assert_eq!(unpacked.metadata["image"]["dims"], json!([20, 18, 16]));
    assert_eq!(unpacked.streams["image"].0, 20 * 18 * 16);
    let names: Vec<&Value> = (unpacked.metadata["arrays"].as_array().unwrap().iter())
        .map(|array| &array["name"])
        .collect();
    assert_eq!(names, ["image"]);
    assert_eq!(stored.lattice.len(), 384);
}
