//! As much XML as VTK files use: elements, attributes, text, comments. No namespaces, no DTD.

use std::ops::Range;

/// Elements within elements, at most: VTK's own files have seven. A tree much deeper could be neither
/// walked nor even dropped without running out of stack.
const DEEPEST: usize = 64;

/// An element and what is in it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Element {
    /// Its name.
    pub name: String,
    /// Attributes in the order of the file, entities resolved.
    pub attributes: Vec<(String, String)>,
    /// Elements within.
    pub children: Vec<Element>,
    /// Where its longest piece of text lies in the file (VTK puts an array's numbers in one).
    pub text: Range<usize>,
}

impl Element {
    /// The value of an attribute.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        let found = self.attributes.iter().find(|(n, _)| n == name);
        found.map(|(_, value)| value.as_str())
    }

    /// The first element of that name within.
    pub fn child(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|c| c.name == name)
    }
}

/// Text as an attribute's value.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            c => escaped.push(c),
        }
    }
    escaped
}

fn unescape(text: &str) -> String {
    text.replace("&lt;", "<")
        .replace("&gt;", ">")
        .replace("&quot;", "\"")
        .replace("&apos;", "'")
        .replace("&amp;", "&")
}

/// Parses a document. The element `AppendedData` ends it: what follows is not XML; its `text`
/// begins there and runs to the end of the file.
///
/// # Errors
/// What is wrong, and at which byte.
pub fn parse(bytes: &[u8]) -> Result<Element, String> {
    let mut open = vec![Element::default()];
    let mut at = 0;
    while let Some(begin) = find(bytes, at, b"<") {
        if let Some(element) = open.last_mut()
            && begin - at > element.text.len()
        {
            element.text = at..begin;
        }
        let rest = &bytes[begin..];
        if rest.starts_with(b"<?") {
            at = past(bytes, begin, b"?>")?;
        } else if rest.starts_with(b"<!--") {
            at = past(bytes, begin, b"-->")?;
        } else if rest.starts_with(b"<!") {
            at = past(bytes, begin, b">")?;
        } else if rest.starts_with(b"</") {
            at = past(bytes, begin, b">")?;
            let name = String::from_utf8_lossy(&bytes[begin + 2..at - 1]);
            match open.pop() {
                Some(element) if element.name == name.trim() && !open.is_empty() => {
                    push(&mut open, element);
                }
                _ => return Err(format!("</{}> at byte {begin} closes nothing", name.trim())),
            }
        } else {
            let (mut element, empty, end) = start_tag(bytes, begin)?;
            at = end;
            if empty {
                push(&mut open, element);
            } else if element.name == "AppendedData" {
                element.text = at..bytes.len();
                push(&mut open, element);
                while open.len() > 1 {
                    if let Some(element) = open.pop() {
                        push(&mut open, element);
                    }
                }
                break;
            } else if open.len() > DEEPEST {
                return Err(format!(
                    "elements are nested more than {DEEPEST} deep at byte {begin}"
                ));
            } else {
                open.push(element);
            }
        }
    }
    match open.pop() {
        Some(unclosed) if !open.is_empty() => Err(format!("<{}> is not closed", unclosed.name)),
        Some(mut document) if document.children.len() == 1 => Ok(document.children.remove(0)),
        _ => Err("it is not one XML element".to_string()),
    }
}

fn push(open: &mut [Element], element: Element) {
    if let Some(parent) = open.last_mut() {
        parent.children.push(element);
    }
}

fn find(bytes: &[u8], from: usize, what: &[u8]) -> Option<usize> {
    let rest = bytes.get(from..)?;
    let first = *what.first()?;
    let mut at = 0;
    loop {
        at += rest[at..].iter().position(|&b| b == first)?;
        if rest[at..].starts_with(what) {
            return Some(from + at);
        }
        at += 1;
    }
}

fn past(bytes: &[u8], from: usize, what: &[u8]) -> Result<usize, String> {
    find(bytes, from, what)
        .map(|at| at + what.len())
        .ok_or_else(|| format!("the tag at byte {from} does not end"))
}

/// The element of the tag at `begin`, whether it is empty (`/>`), and where the tag ends.
fn start_tag(bytes: &[u8], begin: usize) -> Result<(Element, bool, usize), String> {
    let broken = || format!("the tag at byte {begin} is broken");
    let word_end = |at: usize| {
        let ends = |b: &u8| b.is_ascii_whitespace() || matches!(b, b'=' | b'>' | b'/' | b'<');
        bytes[at..]
            .iter()
            .position(ends)
            .map(|n| at + n)
            .ok_or_else(broken)
    };
    let skip_space = |at: usize| {
        let solid = |b: &u8| !b.is_ascii_whitespace();
        bytes[at..]
            .iter()
            .position(solid)
            .map(|n| at + n)
            .ok_or_else(broken)
    };
    let word = |range: Range<usize>| String::from_utf8_lossy(&bytes[range]).into_owned();

    let name_end = word_end(begin + 1)?;
    let mut element = Element {
        name: word(begin + 1..name_end),
        ..Element::default()
    };
    if element.name.is_empty() {
        return Err(broken());
    }
    let mut at = name_end;
    loop {
        at = skip_space(at)?;
        match bytes[at] {
            b'>' => return Ok((element, false, at + 1)),
            b'/' if bytes.get(at + 1) == Some(&b'>') => return Ok((element, true, at + 2)),
            _ => {}
        }
        let name_end = word_end(at)?;
        let equals = skip_space(name_end)?;
        if name_end == at || bytes[equals] != b'=' {
            return Err(broken());
        }
        let quote = skip_space(equals + 1)?;
        if !matches!(bytes[quote], b'"' | b'\'') {
            return Err(broken());
        }
        let close = find(bytes, quote + 1, &bytes[quote..=quote]).ok_or_else(broken)?;
        let value = unescape(&word(quote + 1..close));
        element.attributes.push((word(at..name_end), value));
        at = close + 1;
    }
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
        ] {
            assert!(parse(bad.as_bytes()).is_err(), "{bad}");
        }
    }

    #[test]
    fn escaping_round_trips() {
        let odd = "a<b>&\"c' &lt; ü";
        assert_eq!(unescape(&escape(odd)), odd);
    }
}
