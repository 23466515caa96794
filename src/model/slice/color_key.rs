//! The meaning of colours: of features, and in the colour bar and the legend of a picture.

use super::canvas::Canvas;
use super::color_map::ColorMap;
use super::decorations::Caption;
use super::paint::Paint;
use super::shape::OverlayShape;
use crate::model::surface::SurfaceKind;

/// Colour of cell edges where cells are not coloured by the image.
const EDGE_COLOR: [u8; 4] = [40, 45, 52, 110];
/// Colours of the traces of faults and horizons on a plane with a scale from blue to red.
const TRACE_COLORS: [[u8; 3]; 2] = [[22, 22, 24], [105, 105, 110]];
/// Colours of faults and horizons in a picture without an image.
const FEATURE_COLORS: [[u8; 3]; 2] = [[255, 120, 0], [0, 190, 160]];

/// Returns the index of a kind's colours. Every kind other than horizons has the colours of faults.
fn color_index(kind: SurfaceKind) -> usize {
    usize::from(kind == SurfaceKind::Horizon)
}

/// The colours that occur in a picture.
pub(super) struct ColorKey<'a> {
    pub color_map: Option<ColorMap>,
    pub paint: Option<&'a Paint>,
    /// `true` if the picture contains a mesh.
    has_mesh: bool,
    kind_colors: [Option<[u8; 3]>; 2],
    shape_colors: Vec<(String, [u8; 3])>,
}

impl<'a> ColorKey<'a> {
    /// Creates the key of a picture of an image, of painted cells, or of both.
    pub fn new(color_map: Option<ColorMap>, paint: Option<&'a Paint>) -> Self {
        Self {
            color_map,
            paint,
            has_mesh: false,
            kind_colors: [None; 2],
            shape_colors: Vec::new(),
        }
    }

    /// Returns the colour of cell edges.
    pub fn edge_color(&self) -> [u8; 4] {
        match (&self.color_map, self.paint) {
            (Some(color_map), None) => color_map.mesh_color(),
            _ => EDGE_COLOR,
        }
    }

    /// Returns the colour of faces on features.
    pub fn feature_color(&self, kind: SurfaceKind) -> [u8; 3] {
        let [r, g, b, _] = match (&self.color_map, kind) {
            (None, kind) => return FEATURE_COLORS[color_index(kind)],
            (Some(color_map), SurfaceKind::Fault | SurfaceKind::Interface) => {
                color_map.feature_color()
            }
            (Some(color_map), SurfaceKind::Horizon) => color_map.horizon_color(),
        };
        [r, g, b]
    }

    /// Returns the colour of the traces of features on a plane: dark if the plane is painted from
    /// blue to red.
    pub fn trace_color(&self, kind: SurfaceKind) -> [u8; 3] {
        match self.paint.and_then(Paint::range) {
            Some(_) => TRACE_COLORS[color_index(kind)],
            None => self.feature_color(kind),
        }
    }

    /// Adds a mesh to the key.
    pub fn add_mesh(&mut self) {
        self.has_mesh = true;
    }

    /// Adds a kind of feature with its colour to the key.
    pub fn add_kind(&mut self, kind: SurfaceKind, color: [u8; 3]) {
        self.kind_colors[color_index(kind)] = Some(color);
    }

    /// Adds a mesh whose faces lie on features of these kinds, with the colours of their traces. A
    /// mesh without faces is not added.
    pub fn add_kinds(&mut self, kinds: &[Option<SurfaceKind>]) {
        self.has_mesh |= !kinds.is_empty();
        for kind in [SurfaceKind::Fault, SurfaceKind::Horizon] {
            if kinds.contains(&Some(kind)) {
                self.add_kind(kind, self.trace_color(kind));
            }
        }
    }

    /// Adds a surface or lines to the key.
    pub fn add_shape(&mut self, shape: &OverlayShape, color: [u8; 3]) {
        self.shape_colors.push((shape.name.clone(), color));
    }

    /// Draws the title, the colour bar and the legend.
    pub fn draw_decorations(self, canvas: &mut Canvas, caption: &Caption) {
        canvas.draw_caption(caption);
        let scale = self.paint.and_then(|paint| Some((paint, paint.range()?)));
        match (scale, &self.color_map) {
            (Some((paint, range)), _) => {
                let color = |value| paint.color(value).unwrap_or_default();
                canvas.draw_color_bar(&paint.title, range, color);
            }
            (None, Some(color_map)) => {
                let name = match caption.value_label.as_str() {
                    "" => "image",
                    name => name,
                };
                let color = |value| {
                    let [r, g, b, _] = color_map.color(value as f32);
                    [r, g, b]
                };
                canvas.draw_color_bar(name, color_map.range().map(f64::from), color);
            }
            (None, None) => {}
        }
        let mut entries = Vec::new();
        if self.has_mesh {
            let [r, g, b, _] = self.edge_color();
            entries.push(("mesh".to_string(), [r, g, b]));
        }
        let [fault, horizon] = self.kind_colors;
        let name = match horizon {
            Some(_) => "fault",
            None => "feature",
        };
        entries.extend(fault.map(|color| (name.to_string(), color)));
        entries.extend(horizon.map(|color| ("horizon".to_string(), color)));
        entries.extend(self.paint.map(Paint::legend).unwrap_or_default());
        entries.extend(self.shape_colors);
        canvas.draw_legend(&entries);
    }
}
