//! Maps of what lies against what on the two sides of faults (Allan 1989): as a table, as surfaces, and as a
//! picture.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use crate::error::cause;
use crate::files::atomic_write;
use crate::files::vtk::DataArray;
use crate::geometry::{bounding_box, dot, norm};
use crate::model::reservoir::gouge::FaceRock;
use crate::model::reservoir::{Model, ModelFrame};
use crate::model::slice::Canvas;
use crate::model::surface::SurfaceKind;
use crate::surface_file::vtp::write_vtp;
use crate::surface_file::{SurfaceFile, has_extension};
use crate::{Error, Result};

/// Width of a picture in pixels, and height of the map of one fault.
const PICTURE_WIDTH: u32 = 1000;
const MAP_HEIGHT: f32 = 320.0;
/// Margin round maps, and height of a line of text, in pixels.
const MARGIN: f32 = 30.0;
const LINE_HEIGHT: f32 = 20.0;
/// Largest number of pairs of zones that a picture names.
const MAX_NAMED: usize = 12;
const BLACK: [u8; 4] = [0, 0, 0, 255];

/// A face of a fault.
#[derive(Debug, Clone, PartialEq)]
struct Contact {
    connection: usize,
    /// Number of the fault.
    fault: u32,
    /// Zones of the hanging wall and the footwall.
    zones: [i32; 2],
    /// Throw in metres and shale-gouge ratio, if the fault has fault rock.
    throw: f64,
    gouge_ratio: f64,
    multiplier: f64,
    /// Transmissibility in m^3; not a number if the permeability is not known.
    transmissibility: f64,
}

/// The zones that lie against one another on the faults of a model.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct JuxtapositionMap<'a> {
    model: &'a Model,
    names: Vec<String>,
    contacts: Vec<Contact>,
}

impl<'a> JuxtapositionMap<'a> {
    /// Returns the map of all faults. An extension counts as its fault.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if the model has no faults.
    pub fn new(model: &'a Model, rocks: &[FaceRock]) -> Result<Self> {
        let surfaces = &model.surfaces;
        let merged = surfaces.merged_numbers();
        let is_upper = model.second_cell_is_upper();
        let rocks: BTreeMap<usize, &FaceRock> =
            rocks.iter().map(|rock| (rock.connection, rock)).collect();
        let transmissibility = model.permeability.as_ref().map(|p| &p.transmissibility);
        let mut contacts = Vec::new();
        for (connection, c) in model.graph.connections.iter().enumerate() {
            let surface = surfaces.connection_surfaces[connection];
            let is_named = surface > 0 && surface as usize <= surfaces.kept_count;
            if !is_named || surfaces.kinds[surface as usize - 1] != SurfaceKind::Fault {
                continue;
            }
            let zones = c.cells.map(|cell| model.graph.region[cell as usize]);
            let rock = rocks.get(&connection);
            contacts.push(Contact {
                connection,
                fault: merged[surface as usize],
                zones: if is_upper[connection] {
                    [zones[1], zones[0]]
                } else {
                    zones
                },
                throw: rock.map_or(f64::NAN, |rock| rock.throw),
                gouge_ratio: rock.map_or(f64::NAN, |rock| rock.gouge_ratio),
                multiplier: model.fault_factor(connection),
                transmissibility: transmissibility.map_or(f64::NAN, |t| t[connection]),
            });
        }
        if contacts.is_empty() {
            return Err(Error::Export(cause(
                "juxtaposition",
                "shows what lies against what on faults, but the mesh has no faults",
                "omit it",
            )));
        }
        contacts.sort_by_key(|contact| contact.fault);
        Ok(Self {
            model,
            names: surfaces.all_names().names,
            contacts,
        })
    }

    fn area(&self, contact: &Contact) -> f64 {
        self.model.graph.connections[contact.connection].area
    }

    /// Writes the map: a table (.csv), surfaces (.vtp) or a picture (.png).
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file cannot be written, and [`Error::Export`] for a picture that would be far
    /// too large.
    pub fn write(&self, path: &Path, frame: &ModelFrame) -> Result<()> {
        if has_extension(path, &["csv"]) {
            let table = self.table();
            atomic_write(path, |out| out.write_all(table.as_bytes()))
        } else if has_extension(path, &["vtp"]) {
            write_vtp(path, &self.surfaces(frame))
        } else {
            self.picture()?.write(path)
        }
    }

    /// Returns a line for each fault and each pair of zones: sums of areas and transmissibilities, and means by
    /// area.
    fn table(&self) -> String {
        let mut text = String::from(
            "fault,hanging_wall,footwall,faces,area,throw,gouge_ratio,multiplier,transmissibility\n",
        );
        let mut pairs: BTreeMap<(u32, [i32; 2]), Vec<&Contact>> = BTreeMap::new();
        for contact in &self.contacts {
            pairs
                .entry((contact.fault, contact.zones))
                .or_default()
                .push(contact);
        }
        for ((fault, zones), contacts) in pairs {
            let area: f64 = contacts.iter().map(|contact| self.area(contact)).sum();
            let mean = |value: fn(&Contact) -> f64| {
                let known = contacts.iter().filter(|contact| value(contact).is_finite());
                let sums = known.fold([0.0; 2], |sums, contact| {
                    let area = self.area(contact);
                    [sums[0] + area, sums[1] + area * value(contact)]
                });
                if sums[0] > 0.0 {
                    number_text(sums[1] / sums[0])
                } else {
                    String::new()
                }
            };
            let transmissibility: f64 = contacts.iter().map(|c| c.transmissibility).sum();
            let transmissibility = if transmissibility.is_finite() {
                number_text(transmissibility)
            } else {
                String::new()
            };
            let [hanging, foot] = zones.map(|zone| self.model.region_label(zone));
            let name = &self.names[fault as usize - 1];
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "{name},{hanging},{foot},{},{},{},{},{},{transmissibility}",
                contacts.len(),
                number_text(area),
                mean(|c| c.throw),
                mean(|c| c.gouge_ratio),
                mean(|c| c.multiplier)
            );
        }
        text
    }

    /// Returns the faces as triangles with arrays, in the coordinates of the mesh.
    fn surfaces(&self, frame: &ModelFrame) -> SurfaceFile<3> {
        let nodes: Vec<[f64; 3]> = (self.model.mesh.nodes.iter())
            .map(|node| frame.to_file(*node))
            .collect();
        let (mut facets, mut starts, mut names) = (Vec::new(), vec![0], Vec::new());
        let mut arrays: [Vec<f64>; 6] = Default::default();
        for contacts in self.contacts.chunk_by(|a, b| a.fault == b.fault) {
            for contact in contacts {
                let face = self.model.graph.connections[contact.connection].face;
                let ring = self.model.mesh.faces.get(face as usize);
                let values = [
                    f64::from(contact.zones[0]),
                    f64::from(contact.zones[1]),
                    contact.throw,
                    contact.gouge_ratio,
                    contact.multiplier,
                    contact.transmissibility,
                ];
                for i in 2..ring.len() {
                    facets.push([ring[0], ring[i - 1], ring[i]]);
                    arrays
                        .iter_mut()
                        .zip(values)
                        .for_each(|(array, value)| array.push(value));
                }
            }
            starts.push(facets.len());
            names.push(self.names[contacts[0].fault as usize - 1].clone());
        }
        let mut file = SurfaceFile::new(&nodes, &facets, &starts, "fault");
        file.names = names;
        let array_names = [
            "hanging_wall",
            "footwall",
            "throw",
            "gouge_ratio",
            "multiplier",
            "transmissibility",
        ];
        file.cell_data = (array_names.into_iter().zip(arrays))
            .map(|(name, values)| DataArray::scalars(name, values))
            .collect();
        file
    }

    /// Draws the faults one below another: along strike to the right, depth downwards, and a colour for each
    /// pair of zones.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if the picture would be far too large.
    fn picture(&self) -> Result<Canvas> {
        let mut pairs: Vec<[i32; 2]> = self.contacts.iter().map(|c| c.zones).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let faults: Vec<&[Contact]> = self.contacts.chunk_by(|a, b| a.fault == b.fault).collect();
        let named = pairs.len().min(MAX_NAMED);
        let legend = LINE_HEIGHT * (named + 2) as f32;
        let map = MAP_HEIGHT + 2.0 * MARGIN;
        let height = legend + map * faults.len() as f32;
        let mut canvas = Canvas::new(PICTURE_WIDTH, height as u32).ok_or_else(|| {
            Error::Export(cause(
                "juxtaposition",
                format!("a picture of {} faults is too large", faults.len()),
                "write a table (.csv) or surfaces (.vtp)",
            ))
        })?;
        for (number, pair) in pairs.iter().take(named).enumerate() {
            let y = 0.5 * LINE_HEIGHT + LINE_HEIGHT * number as f32;
            let corners = [
                [MARGIN, y],
                [MARGIN + 24.0, y],
                [MARGIN + 24.0, y + 14.0],
                [MARGIN, y + 14.0],
            ];
            canvas.fill_polygon(&corners, color(number, pairs.len()));
            let [hanging, foot] = pair.map(|zone| self.model.region_label(zone));
            let text = format!("hanging wall {hanging}, footwall {foot}");
            canvas.draw_text(&text, [MARGIN + 34.0, y], 0.0, BLACK);
        }
        if pairs.len() > named {
            let text = format!("and {} other pairs", pairs.len() - named);
            let y = LINE_HEIGHT * (named as f32 + 0.5);
            canvas.draw_text(&text, [MARGIN + 34.0, y], 0.0, BLACK);
        }
        for (number, contacts) in faults.iter().enumerate() {
            self.draw_fault(&mut canvas, contacts, &pairs, legend + map * number as f32);
        }
        Ok(canvas)
    }

    fn draw_fault(&self, canvas: &mut Canvas, contacts: &[Contact], pairs: &[[i32; 2]], top: f32) {
        let graph = &self.model.graph;
        let mut along = [0.0; 2];
        for contact in contacts {
            let c = &graph.connections[contact.connection];
            let strike = [-c.normal[1], c.normal[0]];
            let sign = if dot(strike, along) < 0.0 {
                -c.area
            } else {
                c.area
            };
            (0..2).for_each(|k| along[k] += sign * strike[k]);
        }
        let length = norm(along);
        along = if length > 0.0 {
            along.map(|c| c / length)
        } else {
            [1.0, 0.0]
        };
        let corners = |contact: &Contact| -> Vec<[f64; 2]> {
            let face = graph.connections[contact.connection].face as usize;
            let nodes = self.model.mesh.faces.get(face).iter();
            let nodes = nodes.map(|&n| self.model.mesh.nodes[n as usize]);
            nodes.map(|[x, y, z]| [dot([x, y], along), -z]).collect()
        };
        let [low, high] = bounding_box(contacts.iter().flat_map(corners));
        let extent: [f64; 2] = std::array::from_fn(|k| (high[k] - low[k]).max(f64::MIN_POSITIVE));
        let width = f64::from(PICTURE_WIDTH) - 2.0 * f64::from(MARGIN);
        let scale = [width / extent[0], f64::from(MAP_HEIGHT) / extent[1]];
        let top = f64::from(top + MARGIN);
        let pixel = |p: [f64; 2]| {
            let x = f64::from(MARGIN) + scale[0] * (p[0] - low[0]);
            [x as f32, (top + scale[1] * (p[1] - low[1])) as f32]
        };
        for contact in contacts {
            let number = pairs.partition_point(|pair| *pair < contact.zones);
            let corners: Vec<[f32; 2]> = corners(contact).into_iter().map(pixel).collect();
            canvas.fill_polygon(&corners, color(number, pairs.len()));
        }
        let name = &self.names[contacts[0].fault as usize - 1];
        let title = format!(
            "{name}: {:.0} m along strike, depth {:.0} to {:.0} m",
            extent[0], low[1], high[1]
        );
        canvas.draw_text(&title, [MARGIN, top as f32 - LINE_HEIGHT], 0.0, BLACK);
    }
}

/// Returns a number with nine digits.
fn number_text(value: f64) -> String {
    let text = format!("{value:.8e}");
    match text.parse::<f64>() {
        Ok(rounded) if rounded == 0.0 || (1e-4..1e9).contains(&rounded.abs()) => {
            rounded.to_string()
        }
        Ok(rounded) => format!("{rounded:e}"),
        Err(_) => text,
    }
}

/// Returns the colour of one of `count` pairs of zones: hues that differ, dark and light in turn.
fn color(number: usize, count: usize) -> [u8; 4] {
    let hue = 6.0 * number as f64 / count.max(1) as f64;
    let light = [0.55, 0.85][number % 2];
    let channel = |shift: f64| {
        let distance = ((hue + shift) % 6.0 - 3.0).abs() - 1.0;
        (255.0 * light * (0.35 + 0.65 * distance.clamp(0.0, 1.0))) as u8
    };
    [channel(0.0), channel(4.0), channel(2.0), 255]
}
