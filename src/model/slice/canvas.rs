//! A canvas of pixels with antialiased lines and letters, which can be written as a PNG file.

use std::path::Path;

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use png::{BitDepth, ColorType, Compression, Encoder};
use tiny_skia::{Color, Paint, PathBuilder, Pixmap, PremultipliedColorU8, Stroke, Transform};

use crate::Result;
use crate::files::atomic_write;

/// Width and height of a letter, in pixels.
pub(super) const LETTER_SIZE: [f32; 2] = [
    get_raster_width(FontWeight::Regular, RasterHeight::Size16) as f32,
    16.0,
];

/// Maximum number of lines per stroke. One long path takes more time than several short ones.
const MAX_LINES_PER_STROKE: usize = 256;

/// A picture.
#[derive(Debug, Clone)]
pub struct Canvas(Pixmap);

impl Canvas {
    /// Creates a white picture. Returns `None` if it would be empty or far too large.
    pub fn new(width: u32, height: u32) -> Option<Self> {
        let mut pixels = Pixmap::new(width, height)?;
        pixels.fill(Color::WHITE);
        Some(Self(pixels))
    }

    /// Returns the width and height in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.0.width(), self.0.height()]
    }

    /// Returns the colour of a pixel (red, green, blue), or white outside the picture.
    pub fn color(&self, x: u32, y: u32) -> [u8; 3] {
        let pixel = self.0.pixel(x, y);
        pixel.map_or([255; 3], |p| [p.red(), p.green(), p.blue()])
    }

    /// Sets a pixel to an opaque colour. Pixels outside the picture are ignored.
    pub fn set_pixel(&mut self, x: u32, y: u32, [r, g, b, _]: [u8; 4]) {
        let [width, height] = self.size();
        if x < width
            && y < height
            && let Some(color) = PremultipliedColorU8::from_rgba(r, g, b, 255)
        {
            self.0.pixels_mut()[(y * width + x) as usize] = color;
        }
    }

    /// Fills a polygon with one colour.
    pub fn fill_polygon(&mut self, corners: &[[f32; 2]], [r, g, b, a]: [u8; 4]) {
        let mut path = PathBuilder::new();
        for (i, p) in corners.iter().enumerate() {
            if i == 0 {
                path.move_to(p[0], p[1]);
            } else {
                path.line_to(p[0], p[1]);
            }
        }
        path.close();
        let mut paint = Paint::default();
        paint.set_color_rgba8(r, g, b, a);
        // Without gaps between neighbours.
        paint.anti_alias = false;
        if let Some(path) = path.finish() {
            let rule = tiny_skia::FillRule::Winding;
            self.0
                .fill_path(&path, &paint, rule, Transform::identity(), None);
        }
    }

    /// Draws straight lines of one colour; `width` is in pixels.
    pub fn draw_lines(&mut self, segments: &[[[f32; 2]; 2]], [r, g, b, a]: [u8; 4], width: f32) {
        let mut paint = Paint::default();
        paint.set_color_rgba8(r, g, b, a);
        let stroke = Stroke {
            width,
            line_cap: if width > 1.0 {
                tiny_skia::LineCap::Round
            } else {
                tiny_skia::LineCap::Butt
            },
            ..Stroke::default()
        };
        for batch in segments.chunks(MAX_LINES_PER_STROKE) {
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

    /// Writes a line of text. With `anchor` 0 it begins at `position`, with 1 it ends there, and
    /// with 0.5 it is centred there. It never extends beyond the left side of the picture.
    pub fn draw_text(
        &mut self,
        text: &str,
        position: [f32; 2],
        anchor: f32,
        [r, g, b, _]: [u8; 4],
    ) {
        let width = LETTER_SIZE[0] * text.chars().count() as f32;
        let left = (position[0] - anchor * width).round().max(2.0) as u32;
        let top = position[1].round().max(0.0) as u32;
        for (i, letter) in text.chars().enumerate() {
            let glyph = get_raster(letter, FontWeight::Regular, RasterHeight::Size16)
                .or_else(|| get_raster('?', FontWeight::Regular, RasterHeight::Size16));
            let Some(glyph) = glyph else { continue };
            for (row, line) in glyph.rows().enumerate() {
                for (column, &ink) in line.iter().enumerate().filter(|(_, ink)| **ink > 0) {
                    let x = left + (LETTER_SIZE[0] as usize * i + column) as u32;
                    let y = top + row as u32;
                    let background = self.color(x, y);
                    let t = f32::from(ink) / 255.0;
                    let blend = |ink: u8, k: usize| {
                        let base = f32::from(background[k]);
                        (base + t * (f32::from(ink) - base)).round() as u8
                    };
                    self.set_pixel(x, y, [blend(r, 0), blend(g, 1), blend(b, 2), 255]);
                }
            }
        }
    }

    /// Writes the picture as a PNG file. The file is either complete or absent.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let [width, height] = self.size();
        let pixels = self.0.pixels().iter();
        let bytes: Vec<u8> = pixels
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
