//! Parses the XML of VTK files to a tree of elements, each with the position of its text in the
//! file.

use std::fmt::Display;
use std::ops::Range;

use quick_xml::Reader;
use quick_xml::escape::unescape;
use quick_xml::events::attributes::{AttrError, Attribute};
use quick_xml::events::{BytesStart, Event};

/// An element with its children.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Element {
    /// Its name.
    pub name: String,
    /// Attributes in the order of the file, entities resolved.
    pub attributes: Vec<(String, String)>,
    /// Child elements.
    pub children: Vec<Element>,
    /// Position of its longest piece of text in the file (VTK writes an array's numbers in one
    /// piece).
    pub text: Range<usize>,
}

impl Element {
    /// Returns the value of an attribute.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        let attribute = self.attributes.iter().find(|(n, _)| n == name);
        attribute.map(|(_, value)| value.as_str())
    }

    /// Returns the first child element of that name.
    pub fn child(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|c| c.name == name)
    }
}

/// Most levels of nested elements. VTK's own files have six.
const MAX_DEPTH: usize = 64;

/// Escapes text for an attribute's value or for text between tags.
pub fn escape(text: &str) -> String {
    quick_xml::escape::escape(text).into_owned()
}

/// Parses a document. The element `AppendedData` ends it, because what follows is not XML; its
/// `text` runs from there to the end of the file.
///
/// # Errors
/// Returns a text that says what is wrong and at which byte.
pub fn parse(bytes: &[u8]) -> Result<Element, String> {
    // Appended data may be any bytes; only what stands before it must be text.
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => text,
        Err(error) => std::str::from_utf8(&bytes[..error.valid_up_to()]).unwrap_or_default(),
    };
    let mut reader = Reader::from_str(text);
    // The document itself is an element, too.
    let mut open = vec![Element::default()];
    loop {
        let position = reader.buffer_position();
        let event = reader
            .read_event()
            .map_err(|error| format!("{error}, at byte {}", reader.error_position()))?;
        match event {
            Event::Start(tag) => {
                let mut element = element(&tag, position)?;
                if element.name == "AppendedData" {
                    element.text = reader.buffer_position() as usize..bytes.len();
                    push(&mut open, element);
                    while open.len() > 1 {
                        close(&mut open);
                    }
                    break;
                }
                if open.len() > MAX_DEPTH {
                    return Err(format!(
                        "there are more than {MAX_DEPTH} elements within each other at byte {position}"
                    ));
                }
                open.push(element);
            }
            Event::Empty(tag) => push(&mut open, element(&tag, position)?),
            // The reader has checked that the tag closes the open element.
            Event::End(_) => close(&mut open),
            Event::Text(content) => {
                if let Some(element) = open.last_mut()
                    && content.len() > element.text.len()
                {
                    element.text = position as usize..position as usize + content.len();
                }
            }
            Event::Eof if text.len() < bytes.len() => {
                return Err(format!("byte {} is not text", text.len()));
            }
            Event::Eof => break,
            _ => {}
        }
    }
    match open.pop() {
        Some(unclosed) if !open.is_empty() => Err(format!("<{}> is not closed", unclosed.name)),
        Some(mut document) if document.children.len() == 1 => Ok(document.children.remove(0)),
        _ => Err("it is not a single XML element".to_string()),
    }
}

fn push(open: &mut [Element], element: Element) {
    if let Some(parent) = open.last_mut() {
        parent.children.push(element);
    }
}

fn close(open: &mut Vec<Element>) {
    if let Some(element) = open.pop() {
        push(open, element);
    }
}

/// Returns the element that a tag begins.
fn element(tag: &BytesStart, position: u64) -> Result<Element, String> {
    let broken = |why: &dyn Display| format!("the tag at byte {position} is broken: {why}");
    let name = tag.name().0;
    if name.is_empty() || name.contains(['/', '<', '"', '\'', '=']) {
        return Err(broken(&"it has no name"));
    }
    let attribute = |attribute: Result<Attribute, AttrError>| {
        let attribute = attribute.map_err(|error| broken(&error))?;
        let value = unescape(&attribute.value).map_err(|error| broken(&error))?;
        Ok((attribute.key.0.to_string(), value.into_owned()))
    };
    Ok(Element {
        name: name.to_string(),
        attributes: tag
            .attributes()
            .map(attribute)
            .collect::<Result<_, String>>()?,
        ..Element::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_document_comes_back_as_a_tree() {
        let text = br#"<?xml version="1.0"?>
<!-- <not> an element -->
<VTKFile type = 'A' note="a &lt; b &amp;&quot;c&quot;">
  <Piece><Empty a="1"/><DataArray Name="x"> 1 2 3 <Key/> </DataArray></Piece>
</VTKFile>
"#;
        let root = parse(text).unwrap();
        assert_eq!(root.name, "VTKFile");
        assert_eq!(root.attribute("type"), Some("A"));
        assert_eq!(root.attribute("note"), Some("a < b &\"c\""));
        assert_eq!(root.attribute("none"), None);
        let piece = root.child("Piece").unwrap();
        assert_eq!(piece.children.len(), 2);
        let array = piece.child("DataArray").unwrap();
        assert_eq!(&text[array.text.clone()], b" 1 2 3 ");
        assert_eq!(array.children[0].name, "Key");
    }

    #[test]
    fn appended_data_is_not_parsed() {
        let text = b"<V><A/><AppendedData encoding=\"raw\">_<<<\xff</AppendedData></V>";
        let root = parse(text).unwrap();
        let data = root.child("AppendedData").unwrap();
        assert!(text[data.text.clone()].starts_with(b"_<<<\xff"));
    }

    #[test]
    fn what_is_not_xml_is_refused() {
        for bad in [
            "",
            "hello",
            "<a>",
            "<a><b></a></b>",
            "</a>",
            "<a",
            "<a b>",
            "<a b=c/>",
            "<a b=\"c/>",
            "<a/><b/>",
            "<!-- ",
            "<>",
            "< a/>",
            "<a/b/>",
            "<a b='1' b='2'/>",
            "<a>\u{fffd}&</a><",
        ] {
            assert!(parse(bad.as_bytes()).is_err(), "{bad}");
        }
    }

    #[test]
    fn escaping_round_trips() {
        let odd = "a<b>&\"c' &lt; ü";
        assert_eq!(unescape(&escape(odd)).unwrap(), odd);
    }

    #[test]
    fn deep_nesting_is_refused_whether_it_closes_or_not() {
        let deep = |depth: usize| "<a>".repeat(depth) + &"</a>".repeat(depth);
        assert!(parse(deep(MAX_DEPTH).as_bytes()).is_ok());
        for text in [
            deep(MAX_DEPTH + 1),
            deep(1_000_000),
            "<a>".repeat(1_000_000),
        ] {
            let error = parse(text.as_bytes()).unwrap_err();
            assert!(error.contains("more than 64 elements"), "{error}");
        }
    }

    #[test]
    fn bytes_that_are_no_text_are_refused_before_the_data_only() {
        let error = parse(b"<V><A note=\"\xff\"/></V>").unwrap_err();
        assert!(error.contains("byte"), "{error}");
    }
}
