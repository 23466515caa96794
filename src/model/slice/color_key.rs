//! What colours mean: of features, and in the bar and the legend that stand round a picture.

use super::canvas::Canvas;
use super::color_map::ColorMap;
use super::decorations::Caption;
use super::paint::Paint;
use super::shape::OverlayShape;
use crate::model::surface::SurfaceKind;

/// Edges of cells that are not painted with the image.
const EDGE_COLOR: [u8; 4] = [40, 45, 52, 110];
/// Features where they meet a plane that is painted from blue to red.
const TRACE_COLORS: [[u8; 3]; 2] = [[22, 22, 24], [105, 105, 110]];
/// Features where there is no image from which they have to stand out.
const FEATURE_COLORS: [[u8; 3]; 2] = [[255, 120, 0], [0, 190, 160]];

/// The place of a kind's colours: all that is no horizon looks like a fault.
fn color_index(kind: SurfaceKind) -> usize {
    usize::from(kind == SurfaceKind::Horizon)
}

/// The colours of a picture, and which of them there are.
pub(super) struct ColorKey<'a> {
    pub color_map: Option<ColorMap>,
    pub paint: Option<&'a Paint>,
    /// Whether there is a mesh, and what lies on its features.
    has_mesh: bool,
    kind_colors: [Option<[u8; 3]>; 2],
    shape_colors: Vec<(String, [u8; 3])>,
}

impl<'a> ColorKey<'a> {
    /// For a picture of an image, of painted cells, or of both.
    pub fn new(color_map: Option<ColorMap>, paint: Option<&'a Paint>) -> Self {
        Self {
            color_map,
            paint,
            has_mesh: false,
            kind_colors: [None; 2],
            shape_colors: Vec::new(),
        }
    }

    /// The colour of edges of cells.
    pub fn edge_color(&self) -> [u8; 4] {
        match (&self.color_map, self.paint) {
            (Some(shades), None) => shades.mesh_color(),
            _ => EDGE_COLOR,
        }
    }

    /// The colour of faces on features.
    pub fn feature_color(&self, kind: SurfaceKind) -> [u8; 3] {
        let [r, g, b, _] = match (&self.color_map, kind) {
            (None, kind) => return FEATURE_COLORS[color_index(kind)],
            (Some(shades), SurfaceKind::Fault | SurfaceKind::Interface) => shades.feature_color(),
            (Some(shades), SurfaceKind::Horizon) => shades.horizon_color(),
        };
        [r, g, b]
    }

    /// The colour of features where they meet a plane: dark if it is painted from blue to red.
    pub fn trace_color(&self, kind: SurfaceKind) -> [u8; 3] {
        match self.paint.and_then(Paint::range) {
            Some(_) => TRACE_COLORS[color_index(kind)],
            None => self.feature_color(kind),
        }
    }

    /// There is a mesh.
    pub fn add_mesh(&mut self) {
        self.has_mesh = true;
    }

    /// There is a feature, in this colour.
    pub fn add_kind(&mut self, kind: SurfaceKind, color: [u8; 3]) {
        self.kind_colors[color_index(kind)] = Some(color);
    }

    /// There is a mesh, if it has any faces, on features of these kinds.
    pub fn add_kinds(&mut self, kinds: &[Option<SurfaceKind>]) {
        self.has_mesh |= !kinds.is_empty();
        for kind in [SurfaceKind::Fault, SurfaceKind::Horizon] {
            if kinds.contains(&Some(kind)) {
                self.add_kind(kind, self.trace_color(kind));
            }
        }
    }

    /// There is a surface, or lines.
    pub fn add_shape(&mut self, shape: &OverlayShape, color: [u8; 3]) {
        self.shape_colors.push((shape.name.clone(), color));
    }

    /// Title, bar of colours, and a legend of what there is.
    pub fn draw_decorations(self, canvas: &mut Canvas, caption: &Caption) {
        canvas.draw_caption(caption);
        let scale = self.paint.and_then(|paint| Some((paint, paint.range()?)));
        match (scale, &self.color_map) {
            (Some((paint, range)), _) => {
                let color = |value| paint.color(value).unwrap_or_default();
                canvas.draw_color_bar(&paint.title, range, color);
            }
            (None, Some(shades)) => {
                let name = match caption.value_label.as_str() {
                    "" => "image",
                    name => name,
                };
                let color = |value| {
                    let [r, g, b, _] = shades.color(value as f32);
                    [r, g, b]
                };
                canvas.draw_color_bar(name, shades.range().map(f64::from), color);
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
