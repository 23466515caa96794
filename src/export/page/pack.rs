//! Numbers as bytes, and bytes as text.
//!
//! Numbers become small by differences, and small numbers become few bytes: seven bits each, the
//! highest says that more follow. Deflate does the rest, and Base64 makes text of it that an HTML
//! file can hold.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde_json::{Value, json};

use super::culling::PageMesh;
use super::texture::Texture;
use crate::mesh::complex::NONE;
use crate::model::slice::DrawableFaces;

/// The largest number of a coordinate.
const MAX_COORDINATE: f64 = 65535.0;

/// Streams of bytes with their names, one after the other.
#[derive(Debug, Default)]
pub(super) struct ByteStreams {
    bytes: Vec<u8>,
    /// The name of each, how many numbers it holds, and its bytes.
    layout: Vec<(String, usize, usize)>,
}

/// All streams as text.
#[derive(Debug)]
pub(super) struct PackedStreams {
    /// The bytes of all streams, compressed by zlib, in Base64.
    pub base64: String,
    /// Name, count of numbers and bytes of each stream.
    pub layout: Value,
}

impl ByteStreams {
    /// Adds a stream of bytes that stand for `count` numbers.
    pub(super) fn add(&mut self, name: &str, count: usize, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        self.layout.push((name.to_string(), count, bytes.len()));
    }

    /// Adds numbers, the small ones in few bytes.
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

    /// Adds 16-bit numbers, the low bytes of all before the high ones.
    pub(super) fn add_u16s(&mut self, name: &str, words: &[u16]) {
        let low = words.iter().map(|&word| word as u8);
        let high = words.iter().map(|&word| (word >> 8) as u8);
        let bytes: Vec<u8> = low.chain(high).collect();
        self.add(name, words.len(), &bytes);
    }

    /// Adds the texture, each byte less the one before it in its row.
    pub(super) fn add_image(&mut self, texture: &Texture) {
        let mut bytes = texture.bytes.clone();
        for row in bytes.chunks_mut(texture.dims[0]) {
            let mut before = 0;
            for byte in row {
                (*byte, before) = (byte.wrapping_sub(before), *byte);
            }
        }
        self.add("image", bytes.len(), &bytes);
    }

    /// Adds the faces and cells that a page keeps. Nodes are numbered as they are first used, so that
    /// a face names most of its nodes by how far they lie behind the newest.
    pub(super) fn add_faces(&mut self, faces: &DrawableFaces, kept: &PageMesh) {
        let mut number = vec![NONE; faces.nodes.len()];
        let mut nodes: Vec<u32> = Vec::new();
        let mut corners = Vec::new();
        let mut behind = |node: u32, corners: &mut Vec<u32>| {
            let newest = nodes.len() as u32;
            if number[node as usize] == NONE {
                number[node as usize] = newest;
                nodes.push(node);
            }
            corners.push(newest - number[node as usize]);
        };
        for &face in &kept.faces {
            for &node in faces.rings.get(face as usize) {
                behind(node, &mut corners);
            }
        }
        let mut ends = Vec::new();
        for (line, _) in &faces.feature_edges {
            for &node in line {
                behind(node, &mut ends);
            }
        }

        let mut last = [0; 3];
        let places: Vec<u32> = (nodes.iter())
            .flat_map(|&node| {
                let place = faces.nodes[node as usize].map(|x| (x * MAX_COORDINATE).round() as i64);
                let step = std::array::from_fn::<_, 3, _>(|k| zigzag(place[k] - last[k]));
                last = place;
                step
            })
            .collect();
        self.add_numbers("nodes", places);
        let size = |&face: &u32| faces.rings.get(face as usize).len() as u32;
        self.add_numbers("sizes", kept.faces.iter().map(size));
        self.add_numbers("corners", corners);
        let mut before = 0;
        let owners = kept.sides.iter().map(|sides| {
            let step = sides[0] - before;
            before = sides[0];
            step
        });
        self.add_numbers("owners", owners);
        let beyond = kept.sides.iter().map(|sides| match sides[1] {
            NONE => 0,
            cell => cell - sides[0],
        });
        self.add_numbers("beyond", beyond);
        let surfaces = kept.faces.iter().map(|&f| faces.surfaces[f as usize]);
        self.add_numbers("surfaces", surfaces);
        self.add_numbers("ends", ends);
        self.add_numbers("lines", faces.feature_edges.iter().map(|line| line.1));

        let mut before = 0;
        let numbers = kept.cells.iter().map(|&cell| {
            let step = zigzag(i64::from(cell) - before);
            before = i64::from(cell);
            step
        });
        self.add_numbers("numbers", numbers);
        self.add("bins", kept.bins.len(), kept.bins.as_flattened());
    }

    /// All streams as text.
    pub(super) fn pack(self) -> PackedStreams {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(7));
        // Writing into memory does not fail.
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

/// Numbers of either sign as numbers without, small ones small.
fn zigzag(number: i64) -> u32 {
    ((number << 1) ^ (number >> 63)) as u32
}

/// Bytes in Base64 (RFC 4648).
pub(super) fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let byte = |k: usize| u32::from(three.get(k).copied().unwrap_or(0));
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for k in 0..4 {
            text.push(match k <= three.len() {
                true => ALPHABET[(word >> (18 - 6 * k) & 63) as usize] as char,
                false => '=',
            });
        }
    }
    text
}
