//! Lighting for reflectance transformation imaging (`.lp`): one directional light per photo.
//!
//! `I = l₁n₁ + l₂n₂ + l₃n₃ + …` is, in its first three terms, a distant lamp of direction `s = (l₁,
//! l₂, l₃)/|·|`; the format has no place for what the other six terms hold (ambient light, soft
//! lamps), which is left out. The direction is that of the channels' sum.
//!
//! A file is a count, then lines `image x y z`: the direction towards the lamp, x right, y up, z to
//! the viewer.

use crate::error::IoError;
use crate::files::OutputFile;
use crate::names::Names;
use nalgebra::Vector3;
use rilievo_scene::Lighting;
use std::fmt::Write as _;
use std::path::Path;

/// The lamps of photos, by file name, to be written.
///
/// # Errors
/// When a photo's light has no direction, or the format cannot hold its name.
pub fn light_file(path: &Path, photos: &[(String, Lighting)]) -> Result<OutputFile, IoError> {
    let mut lamps = Vec::with_capacity(photos.len());
    for (photo, lighting) in photos {
        let linear = lighting
            .channels
            .iter()
            .map(|h| Vector3::new(h.0[0], h.0[1], h.0[2]));
        let direction = linear
            .sum::<Vector3<f64>>()
            .try_normalize(0.0)
            .ok_or_else(|| {
                IoError::input(path, format!("the light of {photo} has no direction"))
            })?;
        lamps.push((photo.as_str(), direction.into()));
    }
    lp_file(path, lamps.into_iter())
}

/// An `.lp` file of photos and unit directions towards their lamps in camera axes (x right, y down,
/// z forward), to be written.
///
/// # Errors
/// When a photo's name has spaces, which the format takes for the ends of words.
pub fn lp_file<'a>(
    path: &Path,
    lamps: impl ExactSizeIterator<Item = (&'a str, [f64; 3])>,
) -> Result<OutputFile, IoError> {
    let mut text = format!("{}\n", lamps.len());
    for (photo, [x, y, z]) in lamps {
        Names::Word.check(path, "an .lp file", photo)?;
        // Writing into a String cannot fail, hence the ignored result.
        let _ = writeln!(text, "{photo} {x} {} {}", -y, -z);
    }
    Ok(OutputFile::new(path, text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::SphericalHarmonics;

    fn light(scale: f64) -> SphericalHarmonics {
        let mut h = [0.1; 9];
        // From the upper left, behind the camera.
        [h[0], h[1], h[2]] = [-0.3, -0.4, -1.2].map(|l| l * scale);
        SphericalHarmonics(h)
    }

    #[test]
    fn lamps_point_where_the_harmonics_do_in_the_formats_axes() {
        let folder = tempfile::tempdir().unwrap();
        let lighting = Lighting {
            channels: vec![light(1.0), light(0.5), light(0.25)],
        };
        let photos = [("IMG_0001.jpg".to_owned(), lighting)];
        let lp = folder.path().join("lights.lp");
        let write = |file: OutputFile| file.write().unwrap();
        write(light_file(&lp, &photos).unwrap());
        let text = std::fs::read_to_string(&lp).unwrap();
        let words: Vec<&str> = text.split_whitespace().collect();
        assert_eq!(&words[..2], ["1", "IMG_0001.jpg"]);
        let found: Vec<f64> = words[2..].iter().map(|w| w.parse().unwrap()).collect();
        for (found, expected) in found.iter().zip([-0.3 / 1.3, 0.4 / 1.3, 1.2 / 1.3]) {
            assert!((found - expected).abs() < 1e-12, "{text}");
        }
    }

    #[test]
    fn light_from_everywhere_is_refused_by_the_photos_name() {
        let mut ambient = [0.0; 9];
        ambient[3] = 1.0;
        let lighting = Lighting {
            channels: vec![SphericalHarmonics(ambient)],
        };
        let photos = [("dome.jpg".to_owned(), lighting)];
        let error = light_file(Path::new("x.lp"), &photos).unwrap_err();
        assert!(error.to_string().contains("dome.jpg"), "{error}");
    }
}
