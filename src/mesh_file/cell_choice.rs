//! The cells that users keep of a mesh: those of some regions, and of each region the largest connected
//! part.

use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

use super::array_names::REGION_ARRAY;
use super::{MeshFile, TakeCells, read_labels, read_named_regions};
use crate::error::cause;
use crate::geometry::sorted_distinct;
use crate::geometry::union_find::UnionFind;
use crate::image::LabelValue;
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;
use crate::mesh::poly::FIRST_SIDE;
use crate::option_text::{InvalidValue, serde_as_text};
use crate::{Error, Result};

/// Largest number of regions that an error lists.
const MAX_LISTED_REGIONS: usize = 12;

/// Labels or regions, by their values or names.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RegionNames(pub Vec<String>);

/// A region of a mesh: a label of its image, or a region with a number alone.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownRegion {
    /// Region number of its cells.
    pub region: i32,
    /// The value of its label.
    pub label: Option<LabelValue>,
    /// Its name.
    pub name: Option<String>,
}

/// The cells that are kept of a mesh.
#[derive(Debug, Clone, Copy, Default)]
pub struct CellChoice<'a> {
    /// Regions that are left out.
    pub drop: Option<&'a RegionNames>,
    /// Regions that are kept; `None` for all that are not left out.
    pub keep: Option<&'a RegionNames>,
    /// `true` if only the largest connected part of each region is kept.
    pub keep_largest: bool,
}

impl FromStr for RegionNames {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let names = text.split(',').map(|name| name.trim().to_string());
        let names: Vec<String> = names.collect();
        if names.iter().any(String::is_empty) {
            let remedy = "give values or names of labels with commas between them, such as 0,bone";
            return Err(InvalidValue::new("has an empty name", remedy));
        }
        Ok(Self(names))
    }
}

impl Display for RegionNames {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join(","))
    }
}

serde_as_text!(RegionNames: [","; 2]);

impl KnownRegion {
    /// Returns the regions of a file that are labels or have names. Other regions have only numbers.
    pub fn of_file<M>(file: &MeshFile<M>) -> Vec<Self> {
        let labels = read_labels(file).into_iter().map(|label| Self {
            region: label.region,
            label: Some(label.label),
            name: label.name,
        });
        let named = read_named_regions(file).into_iter().map(|named| Self {
            region: named.region,
            label: None,
            name: Some(named.name),
        });
        labels.chain(named).collect()
    }

    /// Returns the regions of labels that have these names or none, numbered in their order.
    pub fn of_labels(labels: &[LabelValue], names: &[Option<String>]) -> Vec<Self> {
        let named = labels.iter().zip(names);
        let numbered = named.zip(0..).map(|((&label, name), region)| Self {
            region,
            label: Some(label),
            name: name.clone(),
        });
        numbered.collect()
    }

    /// Returns the name of a region, or else the value of its label or its number.
    pub fn label_of(known: &[Self], region: i32) -> String {
        match known.iter().find(|known| known.region == region) {
            Some(Self {
                name: Some(name), ..
            }) => name.clone(),
            Some(Self {
                label: Some(label), ..
            }) => label.to_string(),
            _ => region.to_string(),
        }
    }

    /// Returns `true` if a user means this region by a text: its name, or the value of its label.
    fn is_meant_by(&self, text: &str) -> bool {
        let value = || self.label.or(Some(LabelValue::Whole(self.region.into())));
        self.name.as_deref() == Some(text)
            || LabelValue::parse(text).is_some_and(|given| Some(given) == value())
    }

    /// Returns the region as an error lists it.
    fn description(&self) -> String {
        let value = self.label.map(|label| label.to_string());
        let value = value.unwrap_or_else(|| self.region.to_string());
        match &self.name {
            Some(name) => format!("{value} ({name})"),
            None => value,
        }
    }
}

impl CellChoice<'_> {
    /// Returns `true` if all cells are kept.
    pub fn keeps_all(&self) -> bool {
        self.drop.is_none() && self.keep.is_none() && !self.keep_largest
    }

    /// Checks that the options make sense together.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if labels are both kept and left out.
    pub fn validate(&self) -> Result<()> {
        match (self.drop, self.keep) {
            (Some(drop), Some(_)) => Err(Error::Job(cause(
                format!("drop {drop}"),
                "leaves out labels, but --keep names those that stay",
                "give one of the two",
            ))),
            _ => Ok(()),
        }
    }

    /// Returns for each region whether it is kept. `place` names the image or the mesh in errors.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a name of no region, and if no region is kept.
    pub fn kept_regions(&self, regions: &[KnownRegion], place: &str) -> Result<Vec<bool>> {
        let given = [("drop", self.drop), ("keep", self.keep)];
        for (option, names) in given {
            for name in names.iter().flat_map(|names| &names.0) {
                if !regions.iter().any(|region| region.is_meant_by(name)) {
                    let shown = regions.iter().take(MAX_LISTED_REGIONS);
                    let mut list: Vec<String> = shown.map(KnownRegion::description).collect();
                    if regions.len() > MAX_LISTED_REGIONS {
                        list.push("...".into());
                    }
                    return Err(Error::Job(cause(
                        format!("{option} {name}"),
                        format!("is no label of {place}, which has {}", list.join(", ")),
                        "give the value or the name of one of these",
                    )));
                }
            }
        }
        let is_named = |names: &RegionNames, region: &KnownRegion| {
            names.0.iter().any(|name| region.is_meant_by(name))
        };
        let is_kept = |region: &KnownRegion| {
            self.keep.is_none_or(|keep| is_named(keep, region))
                && !self.drop.is_some_and(|drop| is_named(drop, region))
        };
        let kept: Vec<bool> = regions.iter().map(is_kept).collect();
        match self.drop {
            Some(drop) if !kept.contains(&true) => Err(Error::Job(cause(
                format!("drop {drop}"),
                format!("leaves out all labels of {place}"),
                "keep at least one",
            ))),
            _ => Ok(kept),
        }
    }

    /// Returns the numbers of the cells of a file that are kept, ascending, and a note on those that are
    /// left out; `None` if all are kept. `place` names the mesh in errors.
    ///
    /// # Errors
    /// Returns the errors of [`kept_regions`](Self::kept_regions), and [`Error::Mesh`] if more than two
    /// cells share a face.
    pub fn cells_of_file<const D: usize, M: TakeCells<D>>(
        &self,
        file: &MeshFile<M>,
        place: &str,
    ) -> Result<Option<ChosenCells>> {
        let regions = file.mesh.cell_regions(&file.cell_data);
        self.cells(&file.mesh, &regions, &KnownRegion::of_file(file), place)
    }

    /// Returns the cells that are kept as [`cells_of_file`](Self::cells_of_file) does, from the region of
    /// each cell, and the regions that are labels or have names.
    ///
    /// # Errors
    /// Returns the errors of [`cells_of_file`](Self::cells_of_file).
    pub fn cells<const D: usize, M: Mesh<D>>(
        &self,
        mesh: &M,
        region_of_cell: &[i32],
        known: &[KnownRegion],
        place: &str,
    ) -> Result<Option<ChosenCells>> {
        self.validate()?;
        if self.keeps_all() {
            return Ok(None);
        }
        if region_of_cell.is_empty() {
            return Err(Error::Job(cause(
                place,
                format!("has no regions (cell array {REGION_ARRAY})"),
                "mesh an image of labels, or paint the mesh",
            )));
        }
        let regions: Vec<KnownRegion> = sorted_distinct(region_of_cell.iter().copied())
            .into_iter()
            .map(|region| {
                let found = known.iter().find(|known| known.region == region);
                found.cloned().unwrap_or(KnownRegion {
                    region,
                    label: None,
                    name: None,
                })
            })
            .collect();
        let kept = self.kept_regions(&regions, place)?;
        let region_index = |region: i32| regions.partition_point(|known| known.region < region);
        let mut is_kept: Vec<bool> = (region_of_cell.iter())
            .map(|&region| kept[region_index(region)])
            .collect();
        let volumes = mesh.volumes();
        let mut dropped_parts = 0;
        if self.keep_largest {
            dropped_parts = drop_small_parts(mesh, region_of_cell, &volumes, &mut is_kept)?;
        }
        let cells: Vec<u32> = (0..)
            .zip(&is_kept)
            .filter(|(_, kept)| **kept)
            .map(|(c, _)| c)
            .collect();
        let total: f64 = volumes.iter().sum();
        let left: f64 = cells.iter().map(|&c| volumes[c as usize]).sum();
        let dropped = regions.iter().zip(&kept).filter(|(_, kept)| !**kept);
        let dropped: Vec<String> = dropped.map(|(region, _)| region.description()).collect();
        let what = match (dropped.len(), dropped_parts) {
            (0, 0) => "nothing: every label is in one part".to_string(),
            (0, parts) => format!("{parts} parts of labels that are not the largest"),
            (_, 0) => format!("label {}", dropped.join(", ")),
            (_, parts) => format!(
                "label {}, and {parts} parts of labels that are not the largest",
                dropped.join(", ")
            ),
        };
        Ok(Some(ChosenCells {
            note: format!(
                "left out: {what} ({} of {} cells, {:.1} % of the {})",
                volumes.len() - cells.len(),
                volumes.len(),
                100.0 * (1.0 - left / total),
                M::VOLUME_NAME
            ),
            cells,
        }))
    }
}

/// The cells that are kept of a mesh.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChosenCells {
    /// Their numbers, ascending.
    pub cells: Vec<u32>,
    /// A line that says what is left out.
    pub note: String,
}

/// Leaves out the cells of each kept region that are not in its largest part. Cells of a region that
/// share a face are in one part. Returns the number of parts that are left out.
fn drop_small_parts<const D: usize, M: Mesh<D>>(
    mesh: &M,
    region: &[i32],
    volumes: &[f64],
    is_kept: &mut [bool],
) -> Result<usize> {
    let mut parts = UnionFind::new(region.len());
    for [a, b] in mesh.cells_of_faces()? {
        if a != NONE && b < FIRST_SIDE && region[a as usize] == region[b as usize] {
            parts.unite(a, b);
        }
    }
    let (part, count) = parts.into_labels();
    let mut part_volume = vec![0.0; count];
    let mut part_region = vec![0; count];
    for (cell, &number) in part.iter().enumerate() {
        part_volume[number as usize] += volumes[cell];
        part_region[number as usize] = region[cell];
    }
    // Of parts with equal volumes the first is kept.
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| {
        let by_volume = part_volume[b].total_cmp(&part_volume[a]);
        part_region[a]
            .cmp(&part_region[b])
            .then(by_volume)
            .then(a.cmp(&b))
    });
    let mut is_largest = vec![false; count];
    for of_region in order.chunk_by(|&a, &b| part_region[a] == part_region[b]) {
        is_largest[of_region[0]] = true;
    }
    let mut is_dropped = vec![false; count];
    for (cell, kept) in is_kept.iter_mut().enumerate() {
        let number = part[cell] as usize;
        is_dropped[number] |= *kept && !is_largest[number];
        *kept &= is_largest[number];
    }
    Ok(is_dropped.into_iter().filter(|dropped| *dropped).count())
}
