//! What colours mean: of features, and in the bar and the legend that stand round a picture.

use super::canvas::Canvas;
use super::furniture::Caption;
use super::paint::Paint;
use super::shades::Shades;
use super::shape::Shape;
use crate::model::surface::Kind;

/// Edges of cells that are not painted with the image.
const EDGES: [u8; 4] = [40, 45, 52, 110];
/// Features where they meet a plane that is painted from blue to red.
const TRACES: [[u8; 3]; 2] = [[22, 22, 24], [105, 105, 110]];
/// Features where there is no image from which they have to stand out.
const FEATURES: [[u8; 3]; 2] = [[255, 120, 0], [0, 190, 160]];

/// The place of a kind's colours: all that is no horizon looks like a fault.
fn place(kind: Kind) -> usize {
    usize::from(kind == Kind::Horizon)
}

/// The colours of a picture, and which of them there are.
pub(super) struct Marks<'a> {
    pub shades: Option<Shades>,
    pub paint: Option<&'a Paint>,
    /// Whether there is a mesh, and what lies on its features.
    mesh: bool,
    kinds: [Option<[u8; 3]>; 2],
    shapes: Vec<(String, [u8; 3])>,
}

impl<'a> Marks<'a> {
    /// For a picture of an image, of painted cells, or of both.
    pub fn new(shades: Option<Shades>, paint: Option<&'a Paint>) -> Self {
        Self {
            shades,
            paint,
            mesh: false,
            kinds: [None; 2],
            shapes: Vec::new(),
        }
    }

    /// The colour of edges of cells.
    pub fn edges(&self) -> [u8; 4] {
        match (&self.shades, self.paint) {
            (Some(shades), None) => shades.mesh(),
            _ => EDGES,
        }
    }

    /// The colour of faces on features.
    pub fn feature(&self, kind: Kind) -> [u8; 3] {
        let [r, g, b, _] = match (&self.shades, kind) {
            (None, kind) => return FEATURES[place(kind)],
            (Some(shades), Kind::Fault | Kind::Interface) => shades.feature(),
            (Some(shades), Kind::Horizon) => shades.horizon(),
        };
        [r, g, b]
    }

    /// The colour of features where they meet a plane: dark if it is painted from blue to red.
    pub fn trace(&self, kind: Kind) -> [u8; 3] {
        match self.paint.and_then(Paint::range) {
            Some(_) => TRACES[place(kind)],
            None => self.feature(kind),
        }
    }

    /// There is a mesh.
    pub fn saw_mesh(&mut self) {
        self.mesh = true;
    }

    /// There is a feature, in this colour.
    pub fn saw(&mut self, kind: Kind, color: [u8; 3]) {
        self.kinds[place(kind)] = Some(color);
    }

    /// There is a mesh, if it has any faces, on features of these kinds.
    pub fn saw_all(&mut self, kinds: &[Option<Kind>]) {
        self.mesh |= !kinds.is_empty();
        for kind in [Kind::Fault, Kind::Horizon] {
            if kinds.contains(&Some(kind)) {
                self.saw(kind, self.trace(kind));
            }
        }
    }

    /// There is a surface, or lines.
    pub fn saw_shape(&mut self, shape: &Shape, color: [u8; 3]) {
        self.shapes.push((shape.name.clone(), color));
    }

    /// Title, bar of colours, and a legend of what there is.
    pub fn put_on(self, canvas: &mut Canvas, caption: &Caption) {
        canvas.caption(caption);
        let scale = self.paint.and_then(|paint| Some((paint, paint.range()?)));
        match (scale, &self.shades) {
            (Some((paint, range)), _) => {
                let color = |value| paint.color(value).unwrap_or_default();
                canvas.color_bar(&paint.title, range, color);
            }
            (None, Some(shades)) => {
                let name = match caption.values.as_str() {
                    "" => "image",
                    name => name,
                };
                let color = |value| {
                    let [r, g, b, _] = shades.color(value as f32);
                    [r, g, b]
                };
                canvas.color_bar(name, shades.range().map(f64::from), color);
            }
            (None, None) => {}
        }
        let mut entries = Vec::new();
        if self.mesh {
            let [r, g, b, _] = self.edges();
            entries.push(("mesh".to_string(), [r, g, b]));
        }
        let [fault, horizon] = self.kinds;
        let name = match horizon {
            Some(_) => "fault",
            None => "feature",
        };
        entries.extend(fault.map(|color| (name.to_string(), color)));
        entries.extend(horizon.map(|color| ("horizon".to_string(), color)));
        entries.extend(self.paint.map(Paint::legend).unwrap_or_default());
        entries.extend(self.shapes);
        canvas.legend(&entries);
    }
}
