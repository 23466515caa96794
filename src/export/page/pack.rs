//! Packs numbers as bytes, and bytes as text.
//!
//! Differences make numbers small, and small numbers take few bytes: seven bits per byte, and the
//! highest bit says that another byte follows. The bytes are compressed by zlib and written as
//! Base64 text, which an HTML file can hold.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde_json::{Value, json};

use super::culling::PageMesh;
use super::texture::Texture;
use crate::mesh::complex::NONE;
use crate::model::slice::DrawableFaces;

/// Largest integer value of a coordinate.
const MAX_COORDINATE: f64 = 65535.0;

/// Named streams of bytes, one after the other.
#[derive(Debug, Default)]
pub(super) struct ByteStreams {
    bytes: Vec<u8>,
    /// Name of each stream, its count of numbers, and its count of bytes.
    layout: Vec<(String, usize, usize)>,
}

/// All streams as text.
#[derive(Debug)]
pub(super) struct PackedStreams {
    /// Bytes of all streams, compressed by zlib, in Base64.
    pub base64: String,
    /// Name, count of numbers and count of bytes of each stream.
    pub layout: Value,
}

impl ByteStreams {
    /// Adds a stream of bytes that represents `count` numbers.
    pub(super) fn add(&mut self, name: &str, count: usize, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        self.layout.push((name.to_string(), count, bytes.len()));
    }

    /// Adds numbers in a variable-length code, in which small numbers take few bytes.
    fn add_numbers(&mut self, name: &str, numbers: impl IntoIterator<Item = u32>) {
        let mut bytes = Vec::new();
        let mut count = 0;
        for mut number in numbers {
            count += 1;
            while number >= 128 {
                bytes.push(number as u8 | 128);
                number >>= 7;
            }
            bytes.push(number as u8);
        }
        self.add(name, count, &bytes);
    }

    /// Adds 16-bit numbers: first all low bytes, then all high bytes.
    pub(super) fn add_u16s(&mut self, name: &str, words: &[u16]) {
        let low = words.iter().map(|&word| word as u8);
        let high = words.iter().map(|&word| (word >> 8) as u8);
        let bytes: Vec<u8> = low.chain(high).collect();
        self.add(name, words.len(), &bytes);
    }

    /// Adds the texture. Each byte is stored as the difference from the previous byte of its row.
    pub(super) fn add_image(&mut self, texture: &Texture) {
        let mut bytes = texture.bytes.clone();
        for row in bytes.chunks_mut(texture.dims[0]) {
            let mut previous = 0;
            for byte in row {
                (*byte, previous) = (byte.wrapping_sub(previous), *byte);
            }
        }
        self.add("image", bytes.len(), &bytes);
    }

    /// Adds the faces and cells that a page keeps. Nodes are numbered in the order of their first
    /// use, and a face refers to a node by how many nodes are newer. Most of these numbers are
    /// small.
    pub(super) fn add_faces(&mut self, faces: &DrawableFaces, kept: &PageMesh) {
        let mut node_number = vec![NONE; faces.nodes.len()];
        let mut nodes: Vec<u32> = Vec::new();
        let mut corners = Vec::new();
        let mut push_node = |node: u32, corners: &mut Vec<u32>| {
            let newest = nodes.len() as u32;
            if node_number[node as usize] == NONE {
                node_number[node as usize] = newest;
                nodes.push(node);
            }
            corners.push(newest - node_number[node as usize]);
        };
        for &face in &kept.faces {
            for &node in faces.rings.get(face as usize) {
                push_node(node, &mut corners);
            }
        }
        let mut edge_nodes = Vec::new();
        for (line, _) in &faces.feature_edges {
            for &node in line {
                push_node(node, &mut edge_nodes);
            }
        }

        let mut previous = [0; 3];
        let differences: Vec<u32> = (nodes.iter())
            .flat_map(|&node| {
                let coordinates =
                    faces.nodes[node as usize].map(|x| (x * MAX_COORDINATE).round() as i64);
                let step = std::array::from_fn::<_, 3, _>(|k| zigzag(coordinates[k] - previous[k]));
                previous = coordinates;
                step
            })
            .collect();
        self.add_numbers("nodes", differences);
        let size = |&face: &u32| faces.rings.get(face as usize).len() as u32;
        self.add_numbers("sizes", kept.faces.iter().map(size));
        self.add_numbers("corners", corners);
        let mut previous = 0;
        let owners = kept.sides.iter().map(|sides| {
            let step = sides[0] - previous;
            previous = sides[0];
            step
        });
        self.add_numbers("owners", owners);
        let neighbours = kept.sides.iter().map(|sides| match sides[1] {
            NONE => 0,
            cell => cell - sides[0],
        });
        self.add_numbers("beyond", neighbours);
        let surfaces = kept.faces.iter().map(|&f| faces.surfaces[f as usize]);
        self.add_numbers("surfaces", surfaces);
        self.add_numbers("ends", edge_nodes);
        self.add_numbers("lines", faces.feature_edges.iter().map(|line| line.1));

        let mut previous = 0;
        let numbers = kept.cells.iter().map(|&cell| {
            let step = zigzag(i64::from(cell) - previous);
            previous = i64::from(cell);
            step
        });
        self.add_numbers("numbers", numbers);
        self.add("bins", kept.bins.len(), kept.bins.as_flattened());
    }

    /// Returns all streams as text.
    pub(super) fn pack(self) -> PackedStreams {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(7));
        // Writing to memory does not fail.
        let packed = match encoder.write_all(&self.bytes) {
            Ok(()) => encoder.finish().unwrap_or_default(),
            Err(_) => Vec::new(),
        };
        PackedStreams {
            base64: base64(&packed),
            layout: json!(self.layout),
        }
    }
}

/// Maps signed numbers to unsigned ones, so that numbers near zero stay small.
fn zigzag(number: i64) -> u32 {
    ((number << 1) ^ (number >> 63)) as u32
}

/// Returns bytes in Base64 (RFC 4648).
pub(super) fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |k: usize| u32::from(chunk.get(k).copied().unwrap_or(0));
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for k in 0..4 {
            text.push(if k <= chunk.len() {
                ALPHABET[(word >> (18 - 6 * k) & 63) as usize] as char
            } else {
                '='
            });
        }
    }
    text
}
