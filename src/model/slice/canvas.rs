//! Pixels: colours, antialiased lines, letters; and the way into a PNG file.

use std::path::Path;

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use png::{BitDepth, ColorType, Compression, Encoder};
use tiny_skia::{Color, Paint, PathBuilder, Pixmap, PremultipliedColorU8, Stroke, Transform};

use crate::Result;
use crate::files::atomic_write;

/// Width and height of a letter.
pub(super) const LETTER_SIZE: [f32; 2] = [
    get_raster_width(FontWeight::Regular, RasterHeight::Size16) as f32,
    16.0,
];

/// Lines in one stroke: long paths cost more than their parts.
const MAX_LINES_PER_STROKE: usize = 256;

/// A picture.
#[derive(Debug, Clone)]
pub struct Canvas(Pixmap);

impl Canvas {
    /// A white picture; `None` if it would be empty or far too large.
    pub fn new(width: u32, height: u32) -> Option<Self> {
        let mut pixels = Pixmap::new(width, height)?;
        pixels.fill(Color::WHITE);
        Some(Self(pixels))
    }

    /// Width and height in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.0.width(), self.0.height()]
    }

    /// The colour of a pixel (red, green, blue); white outside.
    pub fn color(&self, x: u32, y: u32) -> [u8; 3] {
        let pixel = self.0.pixel(x, y);
        pixel.map_or([255; 3], |p| [p.red(), p.green(), p.blue()])
    }

    /// Sets a pixel to an opaque colour; outside nothing happens.
    pub fn set_pixel(&mut self, x: u32, y: u32, [r, g, b, _]: [u8; 4]) {
        let [width, height] = self.size();
        if x < width
            && y < height
            && let Some(color) = PremultipliedColorU8::from_rgba(r, g, b, 255)
        {
            self.0.pixels_mut()[(y * width + x) as usize] = color;
        }
    }

    /// Draws straight lines of one colour.
    pub fn draw_lines(&mut self, ends: &[[[f32; 2]; 2]], [r, g, b, a]: [u8; 4], width: f32) {
        let mut paint = Paint::default();
        paint.set_color_rgba8(r, g, b, a);
        let stroke = Stroke {
            width,
            line_cap: match width > 1.0 {
                true => tiny_skia::LineCap::Round,
                false => tiny_skia::LineCap::Butt,
            },
            ..Stroke::default()
        };
        for batch in ends.chunks(MAX_LINES_PER_STROKE) {
            let mut path = PathBuilder::new();
            for [p, q] in batch {
                path.move_to(p[0], p[1]);
                path.line_to(q[0], q[1]);
            }
            if let Some(path) = path.finish() {
                self.0
                    .stroke_path(&path, &paint, &stroke, Transform::identity(), None);
            }
        }
    }

    /// Writes a line of text; `anchor` is 0 if it begins at `at`, 1 if it ends there, 0.5 if `at` is
    /// the middle. It never leaves the picture to the left.
    pub fn draw_text(&mut self, text: &str, at: [f32; 2], anchor: f32, [r, g, b, _]: [u8; 4]) {
        let width = LETTER_SIZE[0] * text.chars().count() as f32;
        let left = (at[0] - anchor * width).round().max(2.0) as u32;
        let top = at[1].round().max(0.0) as u32;
        for (i, letter) in text.chars().enumerate() {
            let glyph = get_raster(letter, FontWeight::Regular, RasterHeight::Size16)
                .or_else(|| get_raster('?', FontWeight::Regular, RasterHeight::Size16));
            let Some(glyph) = glyph else { continue };
            for (row, line) in glyph.rows().enumerate() {
                for (column, &ink) in line.iter().enumerate().filter(|(_, ink)| **ink > 0) {
                    let x = left + (LETTER_SIZE[0] as usize * i + column) as u32;
                    let y = top + row as u32;
                    let under = self.color(x, y);
                    let t = f32::from(ink) / 255.0;
                    let over = |ink: u8, k: usize| {
                        let below = f32::from(under[k]);
                        (below + t * (f32::from(ink) - below)).round() as u8
                    };
                    self.set_pixel(x, y, [over(r, 0), over(g, 1), over(b, 2), 255]);
                }
            }
        }
    }

    /// Writes the picture as a PNG file, which appears whole or not at all.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if it cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let [width, height] = self.size();
        let opaque = self.0.pixels().iter();
        let bytes: Vec<u8> = opaque
            .flat_map(|p| [p.red(), p.green(), p.blue()])
            .collect();
        atomic_write(path, |out| {
            let mut encoder = Encoder::new(out, width, height);
            encoder.set_color(ColorType::Rgb);
            encoder.set_depth(BitDepth::Eight);
            encoder.set_compression(Compression::Balanced);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&bytes)?;
            Ok(writer.finish()?)
        })
    }
}
