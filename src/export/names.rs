//! The names of a model's objects in one export. [`ExportNames`] decides them once, by the
//! [`FormatNames`] of the format; writers only look them up.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::meshers::groups::{
    FaceNames, PROGRAM_NAME_COUNT, face_nodes, region_numbers, sorted_regions,
};
use super::values::property_columns;
use crate::Result;
use crate::files::Batch;
use crate::model::reservoir::Model;
use crate::model::surface::SurfaceKind;
use crate::names::{
    NameEntry, NameRules, NameSource, NameTable, WantedName, assign, is_identifier,
};
use crate::store::named_sets::NamedSet;

/// Largest number of regions in a note.
const MAX_LISTED_NUMBERS: usize = 4;

/// The form in which a file holds regions or named faces.
#[derive(Debug, Clone, Copy)]
pub enum Naming {
    /// By names that follow these rules.
    Names(NameRules),
    /// By their numbers.
    Numbers,
    /// Not at all.
    Absent,
}

/// The place of the table of names.
#[derive(Debug, Clone, Copy)]
pub enum TablePlace {
    /// Comments of the file, each of which begins with this text.
    Comments(&'static str),
    /// A file of its own, `NAME.exo.names.csv`, or `names.csv` in the folder of a format without a file.
    Companion,
}

/// The rules of a format for all kinds of names.
#[derive(Debug, Clone, Copy)]
pub struct FormatNames {
    /// Regions of cells, and the elements between the two sides of surfaces.
    pub regions: Naming,
    /// Sides of the box, surfaces, and interfaces of regions.
    pub faces: Naming,
    /// `true` if no region may have the name of a face, by the rules of faces.
    pub is_one_namespace: bool,
    /// `true` if a face may have several names.
    pub faces_overlap: bool,
    /// `true` if there are sets of cells besides regions.
    pub has_cell_sets: bool,
    /// Text before the name of the nodes of faces, if there are sets of nodes.
    pub node_set_prefix: Option<&'static str>,
    /// The largest number of a region in formats that number regions from 1. `None` in formats that
    /// hold region numbers as they are in the mesh, or only names.
    pub max_region_number: Option<i32>,
    /// The name of a region that has none.
    pub default_region: fn(i32) -> String,
    /// Other properties of cells than region and rock.
    pub properties: Option<NameRules>,
    /// `true` if each component of a property has a name of its own.
    pub has_columns: bool,
    /// Wells, and groups of wells.
    pub wells: Option<NameRules>,
    /// Surfaces with multipliers.
    pub multipliers: Option<NameRules>,
    /// The place of the table.
    pub table: TablePlace,
}

impl FormatNames {
    /// Rules of formats without names.
    pub const NONE: Self = Self {
        regions: Naming::Absent,
        faces: Naming::Absent,
        is_one_namespace: false,
        faces_overlap: false,
        has_cell_sets: false,
        node_set_prefix: None,
        max_region_number: None,
        default_region: |region| format!("region{region}"),
        properties: None,
        has_columns: false,
        wells: None,
        multipliers: None,
        table: TablePlace::Companion,
    };

    /// Returns the rules of each kind of objects that have names.
    #[cfg(test)]
    pub fn all_rules(&self) -> Vec<(&'static str, NameRules)> {
        let rules = |naming: Naming| match naming {
            Naming::Names(rules) => Some(rules),
            _ => None,
        };
        let all = [
            ("regions", rules(self.regions)),
            ("faces", rules(self.faces)),
            ("properties", self.properties),
            ("wells", self.wells),
            ("multipliers", self.multipliers),
        ];
        all.into_iter()
            .filter_map(|(kind, rules)| Some((kind, rules?)))
            .collect()
    }

    /// Rules of formats in which regions and faces have names by the same rules, distinct from one
    /// another.
    pub const fn one_namespace(rules: NameRules, table: TablePlace) -> Self {
        Self {
            regions: Naming::Names(rules),
            faces: Naming::Names(rules),
            is_one_namespace: true,
            table,
            ..Self::NONE
        }
    }
}

/// The names of a surface along which the mesh is split.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SplitNames {
    /// The number of the surface's name among those of faces.
    pub number: u32,
    /// The name of the elements between the two sides.
    pub elements: String,
    /// The names of the lower and of the upper side.
    pub sides: [String; 2],
}

/// The names of a model's objects in a file.
#[derive(Debug, Clone)]
pub struct ExportNames {
    /// The names of faces.
    pub faces: FaceNames,
    /// The sets of cells that are written, with their names in the file.
    pub cell_sets: Vec<NamedSet>,
    /// The sets of nodes that are written, with their names in the file. Those of faces are not among
    /// them.
    pub node_sets: Vec<NamedSet>,
    /// Names that have fewer faces than in the mesh.
    pub incomplete: Vec<String>,
    /// The names of the surfaces along which the mesh is split, by the number of the surface.
    pub split: Vec<SplitNames>,
    /// The names of the other properties of cells; if each component has a name of its own, those of
    /// all columns.
    pub properties: Vec<String>,
    /// The names of the wells.
    pub wells: Vec<String>,
    /// The name of the fragments, and those of the surfaces with multipliers.
    pub multipliers: Vec<String>,
    regions: BTreeMap<i32, String>,
    /// The number of each region in the file, if the format numbers regions from 1.
    region_numbers: BTreeMap<i32, i32>,
    groups: BTreeMap<String, String>,
    rules: FormatNames,
    /// The table of all names.
    pub table: NameTable,
}

impl ExportNames {
    /// Decides the names of a model's objects.
    pub fn new(model: &Model, rules: &FormatNames) -> Self {
        let mut names = Self {
            faces: FaceNames::new(model),
            cell_sets: Vec::new(),
            node_sets: Vec::new(),
            incomplete: Vec::new(),
            split: Vec::new(),
            properties: Vec::new(),
            wells: Vec::new(),
            multipliers: Vec::new(),
            regions: BTreeMap::new(),
            region_numbers: (rules.max_region_number)
                .map_or_else(BTreeMap::new, |limit| region_numbers(model, limit)),
            groups: BTreeMap::new(),
            rules: *rules,
            table: NameTable::default(),
        };
        if !rules.faces_overlap {
            let surfaces = model.surfaces.kept_count;
            names.incomplete = names.faces.separate(surfaces);
        }
        names.name_regions_and_faces(model);
        names.name_node_sets(model);
        names.name_properties(model);
        names.name_wells(model);
        names.name_multipliers(model);
        names
    }

    fn name_regions_and_faces(&mut self, model: &Model) {
        let regions = sorted_regions(model);
        let mut wanted_regions: Vec<WantedName> = (regions.iter())
            .map(|&region| {
                let default = || (self.rules.default_region)(region);
                let label = || Some(format!("region{}", model.label_beyond_region(region)?));
                let name = model.region_name(region).map(String::from).or_else(label);
                WantedName::given_or(name.as_deref(), default)
            })
            .collect();
        if self.rules.has_cell_sets {
            let names = model
                .sets
                .cells
                .iter()
                .map(|set| WantedName::given(&set.name));
            wanted_regions.extend(names);
        }
        let given = PROGRAM_NAME_COUNT + model.surfaces.names.len().min(model.surfaces.kept_count);
        let first_set = self.faces.first_set_number as usize - 1;
        let face_source = |index: usize| match index {
            _ if index < PROGRAM_NAME_COUNT => NameSource::Program,
            _ if index < given || index >= first_set => NameSource::Given,
            _ => NameSource::Default,
        };
        let model_names = self.faces.names.clone();
        let mut wanted_faces: Vec<WantedName> = (model_names.iter().enumerate())
            .map(|(index, name)| WantedName {
                name: name.clone(),
                source: face_source(index),
            })
            .collect();
        let split = self.faces.split_numbers(model);
        let split_name = |number: &u32| &model_names[*number as usize - 1];
        wanted_faces.extend(split.iter().flat_map(|number| {
            ["a", "b"].map(|letter| WantedName {
                name: format!("{}_{letter}", split_name(number)),
                source: NameSource::Default,
            })
        }));
        let (mut written_regions, elements, written_faces) =
            self.assign_spaces(&wanted_regions, &wanted_faces, &split);
        let written_sets = written_regions.split_off(regions.len());
        self.add_cell_sets(model, written_sets);
        self.list_regions(model, &regions, &wanted_regions, &written_regions);
        let own_names = model.surfaces.names.iter().take(model.surfaces.kept_count);
        let mut names_in_mesh = model_names.clone();
        for (name, own_name) in names_in_mesh[PROGRAM_NAME_COUNT..]
            .iter_mut()
            .zip(own_names)
        {
            name.clone_from(own_name);
        }
        self.list_faces(&names_in_mesh, &written_faces, face_source);
        let sides = &written_faces[model_names.len()..];
        let pairs = split.iter().zip(elements).zip(sides.as_chunks::<2>().0);
        self.split = (pairs)
            .map(|((&number, elements), sides)| SplitNames {
                number,
                elements,
                sides: sides.clone(),
            })
            .collect();
        for surface in &self.split {
            self.table.entries.push(NameEntry {
                kind: "elements",
                number: i64::from(surface.number),
                name: model_names[surface.number as usize - 1].clone(),
                written: surface.elements.clone(),
                is_numbered: false,
                is_given: face_source(surface.number as usize - 1) == NameSource::Given,
            });
        }
        self.faces.names = written_faces[..model_names.len()].to_vec();
        self.regions = regions.into_iter().zip(written_regions).collect();
    }

    /// Adds the sets of cells with their names in the file.
    fn add_cell_sets(&mut self, model: &Model, written_names: Vec<String>) {
        for (set, written) in model.sets.cells.iter().zip(written_names) {
            let number = self.cell_sets.len() as i64 + 1;
            self.add_given("cells", number, &set.name, &written);
            self.cell_sets.push(NamedSet {
                name: written,
                members: set.members.clone(),
            });
        }
    }

    /// Assigns names to regions, to the elements between split sides, and to faces.
    fn assign_spaces(
        &self,
        regions: &[WantedName],
        faces: &[WantedName],
        split: &[u32],
    ) -> (Vec<String>, Vec<String>, Vec<String>) {
        let rules = |naming: Naming| match naming {
            Naming::Names(rules) => rules,
            _ => NameRules::TEXT,
        };
        let (region_rules, face_rules) = (rules(self.rules.regions), rules(self.rules.faces));
        if self.rules.is_one_namespace {
            let mut names = assign(&face_rules, &[regions, faces].concat());
            let face_names = names.split_off(regions.len());
            let elements = split.iter().map(|&n| face_names[n as usize - 1].clone());
            return (names, elements.collect(), face_names);
        }
        let elements = split.iter().map(|&n| faces[n as usize - 1].clone());
        let wanted: Vec<WantedName> = regions.iter().cloned().chain(elements).collect();
        let mut names = assign(&region_rules, &wanted);
        let elements = names.split_off(regions.len());
        (names, elements, assign(&face_rules, faces))
    }

    /// Adds the regions to the table. Regions that the file numbers are listed if they have a name or
    /// another number in the file.
    fn list_regions(
        &mut self,
        model: &Model,
        regions: &[i32],
        wanted: &[WantedName],
        written: &[String],
    ) {
        if matches!(self.rules.regions, Naming::Absent) {
            return;
        }
        let has_names = matches!(self.rules.regions, Naming::Names(_));
        let mut blocks = Vec::new();
        for ((&region, wanted), written) in regions.iter().zip(wanted).zip(written) {
            let is_given = wanted.source == NameSource::Given;
            let number = self.region_number(region);
            let entry = |kind, written: String, is_numbered| NameEntry {
                kind,
                number: i64::from(region),
                name: wanted.name.clone(),
                written,
                is_numbered,
                is_given,
            };
            if has_names {
                self.table
                    .entries
                    .push(entry("region", written.clone(), false));
                if number != region {
                    blocks.push(entry("block", number.to_string(), true));
                }
            } else if (is_given || number != region) && !model.has_own_reports() {
                self.table
                    .entries
                    .push(entry("region", number.to_string(), true));
            }
        }
        self.table.entries.extend(blocks);
    }

    /// Adds the names that have faces to the table.
    fn list_faces(
        &mut self,
        names: &[String],
        written: &[String],
        source: impl Fn(usize) -> NameSource,
    ) {
        if matches!(self.rules.faces, Naming::Absent) {
            return;
        }
        let is_numbered = !matches!(self.rules.faces, Naming::Names(_));
        let mut is_used = vec![false; names.len() + 1];
        (self.faces.face_numbers.iter()).for_each(|&number| is_used[number as usize] = true);
        let numbered = (1..).zip(names.iter().zip(written));
        (self.faces.sets.iter()).for_each(|(number, _)| is_used[*number as usize] = true);
        for (number, (name, written)) in numbered.filter(|(number, _)| is_used[*number]) {
            self.table.entries.push(NameEntry {
                kind: "face",
                number: number as i64,
                name: name.clone(),
                written: if is_numbered {
                    number.to_string()
                } else {
                    written.clone()
                },
                is_numbered,
                is_given: source(number - 1) == NameSource::Given,
            });
        }
    }

    /// Names the sets of nodes. The nodes of faces have the names of the faces. A set with such a name
    /// and the same nodes is there already.
    fn name_node_sets(&mut self, model: &Model) {
        let (Some(prefix), Naming::Names(rules)) = (self.rules.node_set_prefix, self.rules.faces)
        else {
            return;
        };
        let groups = self.faces.groups();
        let is_known = |set: &&NamedSet| {
            let mut same = groups.iter().filter(|group| group.name == set.name);
            same.any(|group| face_nodes(model, &group.faces) == set.members)
        };
        let sets: Vec<&NamedSet> = model.sets.nodes.iter().filter(|s| !is_known(s)).collect();
        let of_faces = self
            .faces
            .names
            .iter()
            .map(|name| format!("{prefix}{name}"));
        let all_nodes = rules.reserved.iter().map(|name| format!("{prefix}{name}"));
        // Where regions and faces have one list of names, sets of nodes are in it, too.
        let sets_of_cells = self.cell_sets.iter().map(|set| set.name.clone());
        let of_cells = self.regions.values().cloned().chain(sets_of_cells);
        let of_cells = of_cells.filter(|_| self.rules.is_one_namespace);
        let mut wanted: Vec<WantedName> = of_faces
            .chain(all_nodes)
            .chain(of_cells)
            .map(WantedName::program)
            .collect();
        let first = wanted.len();
        wanted.extend(sets.iter().map(|set| WantedName::given(&set.name)));
        let written = assign(&rules, &wanted).split_off(first);
        for (set, written) in sets.into_iter().zip(written) {
            self.add_given(
                "nodes",
                self.node_sets.len() as i64 + 1,
                &set.name,
                &written,
            );
            self.node_sets.push(NamedSet {
                name: written,
                members: set.members.clone(),
            });
        }
    }

    /// Returns a sentence about the sets of a model that `format` does not hold, if there are any.
    pub fn note_on_sets(&self, model: &Model, format: &str, has_values: bool) -> Option<String> {
        let mut missing: Vec<&str> = Vec::new();
        let mut add = |sets: &'_ [NamedSet], kind: &'static str, is_held: bool| {
            if !sets.is_empty() && !is_held {
                missing.push(kind);
            }
        };
        let sets = &model.sets;
        add(&sets.cells, "cells", self.rules.has_cell_sets || has_values);
        add(&sets.nodes, "nodes", self.rules.node_set_prefix.is_some());
        let has_faces = !matches!(self.rules.faces, Naming::Absent);
        add(&sets.faces, "faces", has_faces);
        let mut sentences = Vec::new();
        if !missing.is_empty() {
            let kinds = missing.join(" and of ");
            sentences.push(format!(
                "{format} has no place for the sets of {kinds}: left out"
            ));
        }
        if has_faces && !self.incomplete.is_empty() {
            let names = self.incomplete.join(", ");
            sentences.push(format!(
                "a face has one name in {format}: faces that are in smaller sets, too, are missing in {names}"
            ));
        }
        (!sentences.is_empty()).then(|| sentences.join("; "))
    }

    fn name_properties(&mut self, model: &Model) {
        let fixed = ["region", "porosity", "permeability"];
        let Some(rules) = self.rules.properties else {
            self.properties = model.properties.iter().map(|p| p.name.clone()).collect();
            return;
        };
        let (wanted, skipped): (Vec<WantedName>, usize) = if self.rules.has_columns {
            let columns = property_columns(model).into_iter();
            let columns = columns.map(|column| {
                if column.is_fixed {
                    WantedName::program(column.name)
                } else {
                    WantedName::given(&column.name)
                }
            });
            (columns.collect(), 0)
        } else {
            let properties = model.properties.iter().map(|p| WantedName::given(&p.name));
            let wanted = fixed.map(WantedName::program).into_iter();
            (wanted.chain(properties).collect(), fixed.len())
        };
        let written = assign(&rules, &wanted);
        let pairs = wanted.iter().zip(&written).skip(skipped);
        let given_pairs = pairs.filter(|(wanted, _)| wanted.source == NameSource::Given);
        for (number, (wanted, written)) in (1..).zip(given_pairs) {
            self.add_given("property", number, &wanted.name, written);
        }
        self.properties = written[skipped..].to_vec();
    }

    fn name_wells(&mut self, model: &Model) {
        let wells = &model.case.wells;
        let schedule = model.case.schedule.as_ref();
        let groups = schedule.map_or_else(Vec::new, |schedule| schedule.groups());
        let Some(rules) = self.rules.wells else {
            self.wells = wells.iter().map(|well| well.name.clone()).collect();
            return;
        };
        let wanted: Vec<WantedName> = wells
            .iter()
            .map(|well| WantedName::given(&well.name))
            .collect();
        self.wells = assign(&rules, &wanted);
        for (number, (well, written)) in (1..).zip(wells.iter().zip(self.wells.clone())) {
            self.add_given("well", number, &well.name, &written);
        }
        let wanted: Vec<WantedName> = groups.iter().map(|name| WantedName::given(*name)).collect();
        let written = assign(&rules, &wanted);
        for (number, (name, written)) in (1..).zip(groups.iter().zip(&written)) {
            self.add_given("group", number, name, written);
        }
        self.groups = groups.into_iter().map(String::from).zip(written).collect();
    }

    /// Names the surfaces with multipliers. Surfaces without names of their own are `FAULT1`,
    /// `HORIZ2`, or `INTER3`; an interface of regions 1 and 11 is `I1_11`.
    fn name_multipliers(&mut self, model: &Model) {
        let Some(rules) = self.rules.multipliers else {
            return;
        };
        let surfaces = &model.surfaces;
        let default = |at: usize, kind: SurfaceKind| match kind {
            SurfaceKind::Fault => format!("FAULT{}", at + 1),
            SurfaceKind::Horizon => format!("HORIZ{}", at + 1),
            SurfaceKind::Interface => format!("INTER{}", at + 1),
        };
        let wanted = surfaces.kinds.iter().enumerate().map(|(at, &kind)| {
            let own_name = surfaces.names.get(at);
            let is_default = |name: &&String| **name == format!("{}{}", kind.name(), at + 1);
            let short = |name: &String| match name.strip_prefix("interface_") {
                Some(regions) => {
                    let short = format!("I{}", regions.to_uppercase());
                    let is_short = short.len() <= rules.max_bytes;
                    (is_short && short.chars().all(is_identifier)).then_some(short)
                }
                None => Some(name.clone()),
            };
            let name = own_name.filter(|name| !is_default(name)).and_then(short);
            WantedName::given_or(name.as_deref(), || default(at, kind))
        });
        let fragments = std::iter::once(WantedName::program("SCRAPS"));
        let wanted: Vec<WantedName> = fragments.chain(wanted).collect();
        self.multipliers = assign(&rules, &wanted);
        let all_names = surfaces.all_names().names;
        let named = self.multipliers.clone().into_iter().skip(1);
        for (number, (name, written)) in (1..).zip(all_names.iter().zip(named)) {
            self.table.entries.push(NameEntry {
                kind: "surface",
                number,
                name: name.clone(),
                written,
                is_numbered: false,
                is_given: wanted[number as usize].source == NameSource::Given
                    && !name.starts_with("interface_"),
            });
        }
    }

    fn add_given(&mut self, kind: &'static str, number: i64, name: &str, written: &str) {
        self.table.entries.push(NameEntry {
            kind,
            number,
            name: name.into(),
            written: written.into(),
            is_numbered: false,
            is_given: true,
        });
    }

    /// Returns the name of a region in the file.
    pub fn region(&self, region: i32) -> &str {
        self.regions.get(&region).map_or("", String::as_str)
    }

    /// Returns the number of a region in the file.
    pub fn region_number(&self, region: i32) -> i32 {
        self.region_numbers.get(&region).copied().unwrap_or(region)
    }

    /// Returns the largest number of a region in a file that numbers regions from 1.
    pub fn largest_region_number(&self) -> usize {
        let largest = self.region_numbers.values().max();
        largest.map_or(1, |&number| number as usize)
    }

    /// Returns a sentence about regions that have another number in the file than in the mesh.
    fn number_note(&self, place: &str) -> Option<String> {
        let changed = self.region_numbers.iter().filter(|(a, b)| a != b);
        let changed: Vec<String> = changed.map(|(a, b)| format!("{a} is {b}")).collect();
        let listed = &changed[..changed.len().min(MAX_LISTED_NUMBERS)];
        let more = if changed.len() > listed.len() {
            ", ..."
        } else {
            ""
        };
        (!changed.is_empty()).then(|| {
            format!(
                "numbers of regions begin with 1 in this format: {}{more} (all: {place})",
                listed.join(", ")
            )
        })
    }

    /// Returns the name of a group of wells in the file.
    pub fn group<'a>(&'a self, name: &'a str) -> &'a str {
        self.groups.get(name).map_or(name, String::as_str)
    }

    /// Returns the table as comments of the file; empty if no reader needs it, or if it is a file of
    /// its own.
    pub fn comments(&self) -> String {
        match self.rules.table {
            TablePlace::Comments(prefix) => self.table.comments(prefix),
            TablePlace::Companion => String::new(),
        }
    }

    /// Returns the path of the table if it is a file of its own.
    fn table_path(&self, path: &Path, is_folder: bool) -> Option<PathBuf> {
        match self.rules.table {
            TablePlace::Companion if is_folder => Some(path.join("names.csv")),
            TablePlace::Companion => Some(NameTable::path_beside(path)),
            TablePlace::Comments(_) => None,
        }
    }

    /// Adds the table to the files of an export if it is a file of its own and a reader needs it.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn add_table(&self, batch: &mut Batch, path: &Path, is_folder: bool) -> Result<()> {
        match self.table_path(path, is_folder) {
            Some(path) if self.table.is_needed() => batch.write(&path, |out| {
                std::io::Write::write_all(out, self.table.csv().as_bytes())
            }),
            _ => Ok(()),
        }
    }

    /// Returns a sentence each about the names and about the numbers of regions that changed, if any
    /// did.
    pub fn notes(&self, path: &Path, is_folder: bool) -> Vec<String> {
        let place = match self.table_path(path, is_folder) {
            Some(path) => path.display().to_string(),
            None => format!("comments of {}", path.display()),
        };
        let notes = [self.table.note(&place), self.number_note(&place)];
        notes.into_iter().flatten().collect()
    }
}
