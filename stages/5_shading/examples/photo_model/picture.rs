//! Errors as pictures.

use rilievo_scene::{DepthMap, NormalMap, Raster};
use std::error::Error;
use std::path::Path;

/// Normal error (0 to 30° from black to white) beside the normals and the relative depth error.
pub fn save(
    out: &Path,
    name: &str,
    error: &Raster<f32>,
    normal: &NormalMap,
    depth: &DepthMap,
    truth: &DepthMap,
) -> Result<(), Box<dyn Error>> {
    let (w, h) = (error.width, error.height);
    let mut rgb = image::RgbImage::new(3 * w as u32, h as u32);
    for y in 0..h {
        for x in 0..w {
            let e = *error.at(x, y);
            let grey = if e < 0.0 {
                90
            } else {
                (e * 8.5).min(255.0) as u8
            };
            rgb.put_pixel(
                x as u32,
                y as u32,
                image::Rgb([grey, grey, if e < 0.0 { 140 } else { grey }]),
            );
            let n = *normal.at(x, y);
            let colour = [n[0], -n[1], -n[2]].map(|v| ((v * 0.5 + 0.5) * 255.0) as u8);
            rgb.put_pixel((x + w) as u32, y as u32, image::Rgb(colour));
            let d = if *truth.at(x, y) > 0.0 {
                (128.0 + 2e4 * (*depth.at(x, y) / *truth.at(x, y) - 1.0)).clamp(0.0, 255.0) as u8
            } else {
                0
            };
            rgb.put_pixel((x + 2 * w) as u32, y as u32, image::Rgb([d; 3]));
        }
    }
    rgb.save(out.join(format!("{name}.png")))?;
    Ok(())
}
