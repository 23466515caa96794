//! Writes HDF5 files of groups, which may have attributes, and contiguous datasets, without chunks
//! and compression. Every HDF5 library since 1.8 reads them.
//!
//! The superblock has version 0, and the object headers have version 1. Groups list their links in
//! their headers. Source: "HDF5 File Format Specification", version 3.0, sections II.A, IV.A.1.a
//! and IV.A.2.

use std::io::{self, Write};

use super::binary::LazyArray;
use super::padded;

/// Group or dataset.
pub enum Hdf5Node<'a> {
    /// Group of named nodes. Names have less than 256 bytes.
    Group(Vec<(String, Hdf5Node<'a>)>),
    /// Group of named nodes with attributes.
    GroupWithAttributes(Vec<(String, Hdf5Attribute)>, Vec<(String, Hdf5Node<'a>)>),
    /// Dataset: lengths along all axes, the slowest first, and the values.
    Dataset(Vec<u64>, LazyArray<'a>),
}

/// Value of an attribute of a group.
pub enum Hdf5Attribute {
    /// Text and its length in bytes. Shorter text is filled with zeros.
    Text(String, usize),
    /// Integers.
    Ints(Vec<i32>),
}

/// Named items.
type NamedList<T> = [(String, T)];

impl Hdf5Node<'_> {
    /// Returns the attributes and the nodes of a group, or `None` for a dataset.
    fn as_group(&self) -> Option<(&NamedList<Hdf5Attribute>, &NamedList<Self>)> {
        match self {
            Self::Group(links) => Some((&[], links)),
            Self::GroupWithAttributes(attributes, links) => Some((attributes, links)),
            Self::Dataset(..) => None,
        }
    }
}

const SUPERBLOCK_SIZE: u64 = 96;
const UNDEFINED_ADDRESS: [u8; 8] = [0xff; 8];
/// Types of header messages.
const DATASPACE: u16 = 1;
const LINK_INFO: u16 = 2;
const DATATYPE: u16 = 3;
const FILL_VALUE: u16 = 5;
const LINK: u16 = 6;
const LAYOUT: u16 = 8;
const GROUP_INFO: u16 = 10;
const ATTRIBUTE: u16 = 12;

/// Header message: type and content.
type Message = (u16, Vec<u8>);

/// Writes the file with the given root group.
///
/// # Errors
/// Returns an error if `out` cannot be written.
pub fn write(out: &mut impl Write, root: &Hdf5Node) -> io::Result<()> {
    // All headers come before the data, so that all addresses are known.
    let mut headers = SUPERBLOCK_SIZE;
    count_headers(root, &mut headers);
    let mut data = headers;
    let (mut bytes, mut next) = (Vec::new(), SUPERBLOCK_SIZE);
    append_headers(root, &mut next, &mut data, &mut bytes);

    let mut head = b"\x89HDF\r\n\x1a\n".to_vec();
    // Versions; 8 bytes for offsets and for lengths; sizes of trees that are not used.
    head.extend([0, 0, 0, 0, 0, 8, 8, 0, 4, 0, 16, 0, 0, 0, 0, 0]);
    head.extend(0u64.to_le_bytes());
    head.extend(UNDEFINED_ADDRESS);
    head.extend(data.to_le_bytes());
    head.extend(UNDEFINED_ADDRESS);
    head.extend(0u64.to_le_bytes());
    head.extend(SUPERBLOCK_SIZE.to_le_bytes());
    head.resize(SUPERBLOCK_SIZE as usize, 0);
    out.write_all(&head)?;
    out.write_all(&bytes)?;
    write_data(root, out)
}

fn header_size(messages: &[Message]) -> u64 {
    let size = |(_, content): &Message| 8 + padded(content.len() as u64);
    16 + messages.iter().map(size).sum::<u64>()
}

fn count_headers(node: &Hdf5Node, end: &mut u64) {
    if let Some((attributes, links)) = node.as_group() {
        let names = links.iter().map(|(name, _)| (name.as_str(), 0));
        *end += header_size(&group_messages(attributes, names));
        links.iter().for_each(|(_, node)| count_headers(node, end));
    }
    if let Hdf5Node::Dataset(dims, numbers) = node {
        *end += header_size(&dataset_messages(dims, numbers, 0));
    }
}

/// Appends the headers of a node and of the nodes below it. `next` is the address of the next
/// header, and `data` the address of the next values. Both are advanced.
fn append_headers(node: &Hdf5Node, next: &mut u64, data: &mut u64, bytes: &mut Vec<u8>) {
    let append_header = |messages: &[Message], bytes: &mut Vec<u8>| {
        let size = header_size(messages) - 16;
        bytes.extend([1, 0]);
        bytes.extend((messages.len() as u16).to_le_bytes());
        bytes.extend(1u32.to_le_bytes());
        bytes.extend((size as u32).to_le_bytes());
        bytes.extend([0; 4]);
        for (kind, content) in messages {
            let size = padded(content.len() as u64);
            bytes.extend(kind.to_le_bytes());
            bytes.extend((size as u16).to_le_bytes());
            bytes.extend([0; 4]);
            bytes.extend(content);
            bytes.resize(bytes.len() + size as usize - content.len(), 0);
        }
    };
    if let Some((attributes, links)) = node.as_group() {
        let names = links.iter().map(|(name, _)| (name.as_str(), 0));
        *next += header_size(&group_messages(attributes, names));
        let (mut addresses, mut children) = (Vec::new(), Vec::new());
        for (name, node) in links {
            addresses.push((name.as_str(), *next));
            append_headers(node, next, data, &mut children);
        }
        append_header(&group_messages(attributes, addresses.into_iter()), bytes);
        bytes.extend(children);
    }
    if let Hdf5Node::Dataset(dims, numbers) = node {
        let messages = dataset_messages(dims, numbers, *data);
        *next += header_size(&messages);
        *data += padded(numbers.byte_len());
        append_header(&messages, bytes);
    }
}

fn write_data(node: &Hdf5Node, out: &mut impl Write) -> io::Result<()> {
    if let Some((_, links)) = node.as_group() {
        links
            .iter()
            .try_for_each(|(_, node)| write_data(node, out))?;
    }
    if let Hdf5Node::Dataset(_, numbers) = node {
        numbers.write(out)?;
        let bytes = numbers.byte_len();
        out.write_all(&[0; 8][..(padded(bytes) - bytes) as usize])?;
    }
    Ok(())
}

/// Returns the messages of a group with the given attributes and links. Links have a creation
/// order, which some readers need.
fn group_messages<'a>(
    attributes: &[(String, Hdf5Attribute)],
    links: impl Iterator<Item = (&'a str, u64)>,
) -> Vec<Message> {
    // Links are in the header, not in a heap with a tree.
    let (mut messages, mut count) = (vec![(GROUP_INFO, vec![0, 0])], 0u64);
    messages.extend(links.map(|(name, address)| {
        let mut link = vec![1, 4];
        link.extend(count.to_le_bytes());
        link.push(name.len() as u8);
        link.extend(name.as_bytes());
        link.extend(address.to_le_bytes());
        count += 1;
        (LINK, link)
    }));
    let info = [
        &[0, 1][..],
        &count.to_le_bytes(),
        &UNDEFINED_ADDRESS,
        &UNDEFINED_ADDRESS,
    ]
    .concat();
    messages.insert(0, (LINK_INFO, info));
    messages.extend(
        attributes
            .iter()
            .map(|(name, value)| (ATTRIBUTE, attribute_message(name, value))),
    );
    messages
}

/// Returns the content of an attribute message.
fn attribute_message(name: &str, value: &Hdf5Attribute) -> Vec<u8> {
    let (kind, space, bytes) = match value {
        Hdf5Attribute::Text(text, size) => {
            let mut bytes = text.as_bytes().to_vec();
            bytes.resize(*size, 0);
            // The text ends with a zero and is ASCII.
            let mut kind = vec![0x13, 0, 0, 0];
            kind.extend((*size as u32).to_le_bytes());
            (kind, vec![1, 0, 0, 0, 0, 0, 0, 0], bytes)
        }
        Hdf5Attribute::Ints(values) => {
            let mut space = vec![1, 1, 0, 0, 0, 0, 0, 0];
            space.extend((values.len() as u64).to_le_bytes());
            let bytes = values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect();
            (datatype("Int32"), space, bytes)
        }
    };
    let mut content = vec![1, 0];
    for size in [name.len() + 1, kind.len(), space.len()] {
        content.extend((size as u16).to_le_bytes());
    }
    let name = [name.as_bytes(), &[0]].concat();
    for part in [name, kind, space] {
        content.extend(&part);
        content.resize(
            content.len() + padded(part.len() as u64) as usize - part.len(),
            0,
        );
    }
    content.extend(bytes);
    content
}

/// Returns the messages of a dataset whose values are at `address`.
fn dataset_messages(dims: &[u64], numbers: &LazyArray, address: u64) -> Vec<Message> {
    let mut space = vec![1, dims.len() as u8, 0, 0, 0, 0, 0, 0];
    dims.iter().for_each(|n| space.extend(n.to_le_bytes()));
    let mut layout = vec![3, 1];
    layout.extend(address.to_le_bytes());
    layout.extend(numbers.byte_len().to_le_bytes());
    vec![
        (DATASPACE, space),
        (DATATYPE, datatype(numbers.vtk_type)),
        // Version 2; space is allocated early; no fill value is defined.
        (FILL_VALUE, vec![2, 1, 2, 0]),
        (LAYOUT, layout),
    ]
}

/// Returns the little-endian HDF5 datatype for the VTK type `kind`.
fn datatype(kind: &str) -> Vec<u8> {
    let integer = |bytes: u8, signed: bool| {
        let mut content = vec![0x10, if signed { 8 } else { 0 }, 0, 0, bytes, 0, 0, 0];
        content.extend([0, 0, 8 * bytes, 0]);
        content
    };
    match kind {
        "Int8" => integer(1, true),
        "UInt8" => integer(1, false),
        "Int16" => integer(2, true),
        "UInt16" => integer(2, false),
        "Int32" => integer(4, true),
        "UInt32" => integer(4, false),
        "Int64" => integer(8, true),
        "UInt64" => integer(8, false),
        // IEEE: position of the sign; number of bits; exponent, mantissa; bias.
        "Float32" => vec![
            0x11, 0x20, 31, 0, 4, 0, 0, 0, 0, 0, 32, 0, 23, 8, 0, 23, 127, 0, 0, 0,
        ],
        _ => vec![
            0x11, 0x20, 63, 0, 8, 0, 0, 0, 0, 0, 64, 0, 52, 11, 0, 52, 255, 3, 0, 0,
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_is_at_the_addresses_in_the_headers() {
        let numbers = [1.5, -2.0, 3.0];
        let data = Hdf5Node::Dataset(vec![3], LazyArray::from_slice(&numbers));
        let bytes = Hdf5Node::Dataset(vec![5], LazyArray::from_fn(5, |i| i as u8));
        let inner = Hdf5Node::Group(vec![("numbers".into(), data)]);
        let attributes = vec![("Version".into(), Hdf5Attribute::Ints(vec![2, 3]))];
        let root = Hdf5Node::GroupWithAttributes(
            attributes,
            vec![("inner".into(), inner), ("bytes".into(), bytes)],
        );
        let mut file = Vec::new();
        write(&mut file, &root).unwrap();
        // The end-of-file address is the length of the file, and the data is at the end.
        assert_eq!(file[40..48], (file.len() as u64).to_le_bytes());
        assert_eq!(file[file.len() - 8..], [0, 1, 2, 3, 4, 0, 0, 0]);
        let position = file.len() - 32;
        assert_eq!(file[position..position + 8], 1.5f64.to_le_bytes());
        let address = (position as u64).to_le_bytes();
        assert_eq!(file.windows(8).filter(|w| *w == address).count(), 1);
    }
}
