//! Lighting for other programs: one directional light per photo, the linear part of its harmonics.
//!
//! `I = l₁n₁ + l₂n₂ + l₃n₃ + …` is, in its first three terms, a distant lamp of direction
//! `s = (l₁, l₂, l₃)/|·|` and strength `|(l₁, l₂, l₃)|`; what the other six terms say (ambient light,
//! soft lamps) those formats cannot hold, so that it is left out, not approximated. The direction is
//! that of the channels' sum, the strength each channel's own share along it.
//!
//! | format | file | axes of the direction, towards the lamp |
//! |---|---|---|
//! | `.lp` of RTI programs | count, then `image x y z` | x right, y up, z to the viewer |
//! | AliceVision | `lights.json` | camera: x right, y down, z forward |

use crate::error::IoError;
use crate::files::OutputFile;
use crate::json;
use crate::names::Names;
use nalgebra::Vector3;
use rilievo_scene::Lighting;
use serde_json::json;
use std::fmt::Write as _;
use std::path::Path;

/// A format of light files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightFormat {
    /// `.lp` of programs for reflectance transformation imaging.
    Lp,
    /// AliceVision's light file.
    AliceVision,
}

impl LightFormat {
    /// All formats.
    pub const ALL: [Self; 2] = [Self::Lp, Self::AliceVision];

    /// Name, as on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lp => "lp",
            Self::AliceVision => "alicevision-lights",
        }
    }
}

/// Direction towards the lamp, camera frame, and its strength per channel; `None` for light without
/// a direction.
fn lamp(lighting: &Lighting) -> Option<(Vector3<f64>, Vec<f64>)> {
    let linear = |h: &rilievo_scene::SphericalHarmonics| Vector3::new(h.0[0], h.0[1], h.0[2]);
    let sum: Vector3<f64> = lighting.channels.iter().map(linear).sum();
    let direction = sum.try_normalize(0.0)?;
    let strengths = lighting.channels.iter().map(|h| linear(h).dot(&direction));
    Some((direction, strengths.collect()))
}

/// The lamps of photos, by file name, to be written.
///
/// # Errors
/// When a photo's light has no direction, or the format cannot hold its name.
pub fn light_file(
    path: &Path,
    format: LightFormat,
    photos: &[(String, Lighting)],
) -> Result<OutputFile, IoError> {
    let mut lamps = Vec::with_capacity(photos.len());
    for (photo, lighting) in photos {
        let lamp = lamp(lighting).ok_or_else(|| {
            IoError::input(path, format!("the light of {photo} has no direction"))
        })?;
        lamps.push((photo, lamp));
    }
    match format {
        LightFormat::Lp => {
            let lamps = lamps
                .into_iter()
                .map(|(photo, (s, _))| (photo.as_str(), s.into()));
            lp_file(path, lamps)
        }
        LightFormat::AliceVision => {
            let lights: Vec<_> = (1..)
                .zip(lamps)
                .map(|(id, (photo, (s, strengths)))| {
                    // Grey light has the strength of its one channel in all three.
                    let strength = |c: usize| strengths[c.min(strengths.len() - 1)].to_string();
                    json!({
                        "lightId": id.to_string(), "viewId": id.to_string(), "image": photo,
                        "type": "directional",
                        "direction": [s.x.to_string(), s.y.to_string(), s.z.to_string()],
                        "intensity": [strength(0), strength(1), strength(2)],
                    })
                })
                .collect();
            json::file(path, &json!({ "lights": lights }))
        }
    }
}

/// An `.lp` file of photos and unit directions towards their lamps in camera axes (x right, y down, z
/// forward), to be written.
///
/// # Errors
/// When a photo's name has spaces, between which the format parts its words.
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
    fn lamps_point_where_the_harmonics_do_in_each_formats_axes() {
        let folder = tempfile::tempdir().unwrap();
        let lighting = Lighting {
            channels: vec![light(1.0), light(0.5), light(0.25)],
        };
        let photos = [("IMG_0001.jpg".to_owned(), lighting)];
        let lp = folder.path().join("lights.lp");
        let write = |file: OutputFile| file.write().unwrap();
        write(light_file(&lp, LightFormat::Lp, &photos).unwrap());
        let text = std::fs::read_to_string(&lp).unwrap();
        let words: Vec<&str> = text.split_whitespace().collect();
        assert_eq!(&words[..2], ["1", "IMG_0001.jpg"]);
        let found: Vec<f64> = words[2..].iter().map(|w| w.parse().unwrap()).collect();
        for (found, expected) in found.iter().zip([-0.3 / 1.3, 0.4 / 1.3, 1.2 / 1.3]) {
            assert!((found - expected).abs() < 1e-12, "{text}");
        }
        let path = folder.path().join("lights.json");
        write(light_file(&path, LightFormat::AliceVision, &photos).unwrap());
        let value = json::read(&path).unwrap();
        let number = |value: &serde_json::Value| value.as_str().unwrap().parse::<f64>().unwrap();
        let lamp = &value["lights"][0];
        assert!(
            (number(&lamp["direction"][2]) + 1.2 / 1.3).abs() < 1e-12,
            "{lamp}"
        );
        assert!(
            (number(&lamp["intensity"][1]) - 0.65).abs() < 1e-12,
            "{lamp}"
        );
    }

    #[test]
    fn light_from_everywhere_is_refused_by_the_photos_name() {
        let mut ambient = [0.0; 9];
        ambient[3] = 1.0;
        let lighting = Lighting {
            channels: vec![SphericalHarmonics(ambient)],
        };
        let photos = [("dome.jpg".to_owned(), lighting)];
        let error = light_file(Path::new("x.lp"), LightFormat::Lp, &photos).unwrap_err();
        assert!(error.to_string().contains("dome.jpg"), "{error}");
    }
}
