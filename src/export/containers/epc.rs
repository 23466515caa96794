//! Writes the package of a RESQML model (EPC: a zip archive of XML parts that refer to each other).
//! Its arrays are in a companion HDF5 file.

use std::fmt::Write as _;
use std::io::{self, Seek, Write};

use sha2::{Digest, Sha256};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Object of the model.
pub struct EpcObject {
    /// RESQML type of the object, without `obj_`.
    pub kind: &'static str,
    /// UUID of the object.
    pub uuid: String,
    /// Title of the object.
    pub title: String,
    /// XML content after the citation.
    pub body: String,
    /// Indices of the objects to which this object refers.
    pub references: Vec<usize>,
    /// `true` if the object has arrays in the HDF5 file.
    pub has_arrays: bool,
}

/// Type of the object that represents the HDF5 file.
pub const PROXY_KIND: &str = "EpcExternalPartReference";
const EML_NAMESPACE: &str = "http://www.energistics.org/energyml/data/commonv2";
const RESQML_NAMESPACE: &str = "http://www.energistics.org/energyml/data/resqmlv2";
const RELATIONSHIP_NAMESPACE: &str = "http://schemas.energistics.org/package/2012/relationships/";
/// Fixed creation time, so that the same model gives the same bytes.
const CREATION_TIME: &str = "2000-01-01T00:00:00Z";

/// Returns a UUID that is computed from a digest and a name, like a version 5 UUID. Equal input
/// gives equal UUIDs.
pub fn uuid(digest: &Sha256, name: &str) -> String {
    let hash = digest.clone().chain_update(name).finalize();
    let mut bytes = [0u8; 16];
    bytes.copy_from_slice(&hash[..16]);
    uuid::Builder::from_bytes(bytes)
        .with_version(uuid::Version::Sha1)
        .with_variant(uuid::Variant::RFC4122)
        .into_uuid()
        .to_string()
}

impl EpcObject {
    fn namespace(&self) -> (&'static str, &'static str) {
        if self.kind == PROXY_KIND {
            ("eml", "application/x-eml+xml;version=2.0;type=obj_")
        } else {
            ("resqml2", "application/x-resqml+xml;version=2.0;type=obj_")
        }
    }

    fn content_type(&self) -> String {
        format!("{}{}", self.namespace().1, self.kind)
    }

    fn part_name(&self) -> String {
        format!("obj_{}_{}.xml", self.kind, self.uuid)
    }

    /// Returns the element `name` by which another object refers to this one.
    pub fn reference(&self, name: &str) -> String {
        format!(
            "<{name} xsi:type=\"eml:DataObjectReference\"><eml:ContentType>{}</eml:ContentType>\
             <eml:Title>{}</eml:Title><eml:UUID>{}</eml:UUID></{name}>",
            self.content_type(),
            self.title,
            self.uuid
        )
    }

    fn xml(&self) -> String {
        let (space, kind) = (self.namespace().0, self.kind);
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<{space}:{kind} xmlns:eml=\"{EML_NAMESPACE}\" \
             xmlns:resqml2=\"{RESQML_NAMESPACE}\" xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" \
             schemaVersion=\"2.0\" uuid=\"{}\" xsi:type=\"{space}:obj_{kind}\">\n\
             <eml:Citation xsi:type=\"eml:Citation\"><eml:Title>{}</eml:Title>\
             <eml:Originator>atomesh</eml:Originator><eml:Creation>{CREATION_TIME}</eml:Creation>\
             <eml:Format>atomesh:{}</eml:Format></eml:Citation>\n{}\n</{space}:{kind}>\n",
            self.uuid,
            self.title,
            env!("CARGO_PKG_VERSION"),
            self.body
        )
    }
}

/// Writes the package. The first object is the proxy of the HDF5 file `companion`.
///
/// # Errors
/// Returns an error if `out` cannot be written.
pub fn write(
    out: &mut (impl Write + Seek),
    objects: &[EpcObject],
    companion: &str,
) -> io::Result<()> {
    let mut types = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"yes\"?>\n<Types \
         xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\n<Default \
         Extension=\"rels\" ContentType=\"application/vnd.openxmlformats-package.relationships+xml\"/>\n\
         <Override PartName=\"/docProps/core.xml\" \
         ContentType=\"application/vnd.openxmlformats-package.core-properties+xml\"/>\n",
    );
    let mut parts = Vec::new();
    for (i, object) in objects.iter().enumerate() {
        let (part, kind) = (object.part_name(), object.content_type());
        let _ = writeln!(
            types,
            "<Override PartName=\"/{part}\" ContentType=\"{kind}\"/>"
        );
        let mut relationships = String::new();
        let mut add_relationship = |id: &str, kind: &str, target: &str, mode: &str| {
            let _ = writeln!(
                relationships,
                "<Relationship Id=\"{id}\" Type=\"{RELATIONSHIP_NAMESPACE}{kind}\" Target=\"{target}\"{mode}/>"
            );
        };
        if i == 0 {
            add_relationship(
                "Hdf5File",
                "externalResource",
                companion,
                " TargetMode=\"External\"",
            );
        }
        for (j, target) in objects.iter().enumerate() {
            let mut add_target = |kind: &str| {
                add_relationship(&format!("_{}", target.uuid), kind, &target.part_name(), "")
            };
            if object.references.contains(&j) {
                add_target("destinationObject");
            } else if target.references.contains(&i) {
                add_target("sourceObject");
            } else if i == 0 && target.has_arrays {
                add_target("externalPartProxyToMl");
            } else if j == 0 && object.has_arrays {
                add_target("mlToExternalPartProxy");
            }
        }
        parts.push((part.clone(), object.xml()));
        parts.push((
            format!("_rels/{part}.rels"),
            relationships_xml(&relationships),
        ));
    }
    types.push_str("</Types>\n");
    let core = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"yes\"?>\n<cp:coreProperties \
         xmlns:cp=\"http://schemas.openxmlformats.org/package/2006/metadata/core-properties\" \
         xmlns:dc=\"http://purl.org/dc/elements/1.1/\" xmlns:dcterms=\"http://purl.org/dc/terms/\" \
         xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\"><dcterms:created \
         xsi:type=\"dcterms:W3CDTF\">{CREATION_TIME}</dcterms:created><dc:creator>atomesh</dc:creator>\
         <cp:version>1.0</cp:version></cp:coreProperties>\n"
    );
    let root = relationships_xml(
        "<Relationship Id=\"CoreProperties\" Type=\"http://schemas.openxmlformats.org/package/2006/\
         relationships/metadata/core-properties\" Target=\"docProps/core.xml\"/>\n",
    );
    parts.push(("docProps/core.xml".into(), core));
    parts.push(("_rels/.rels".into(), root));
    parts.insert(0, ("[Content_Types].xml".into(), types));
    zip(out, &parts)
}

fn relationships_xml(lines: &str) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"yes\"?>\n<Relationships \
         xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">\n{lines}</Relationships>\n"
    )
}

/// Writes a zip archive of texts without compression.
fn zip(out: &mut (impl Write + Seek), parts: &[(String, String)]) -> io::Result<()> {
    let options = SimpleFileOptions::DEFAULT
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::DEFAULT);
    let mut archive = ZipWriter::new(out);
    for (name, text) in parts {
        archive.start_file(name, options)?;
        archive.write_all(text.as_bytes())?;
    }
    archive.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_names_have_equal_uuids() {
        let digest = Sha256::new();
        let name = uuid(&digest, "grid");
        assert_eq!(name, uuid(&digest, "grid"));
        assert_ne!(name, uuid(&digest, "crs"));
        assert_eq!((name.len(), &name[14..15]), (36, "5"));
    }
}
