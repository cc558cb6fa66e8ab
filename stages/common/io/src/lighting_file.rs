//! Lighting: `lighting.json`, long and short.
//!
//! ```text
//! long   {"basis": "n1 n2 n3 1 n1n2 n1n3 n2n3 n1^2-n2^2 3n3^2-1", "frame": "camera",
//!         "includes_albedo": true, "views": {"IMG_0003": [[9 numbers], ... one row per channel]}}
//! short  {"L1": [[9 numbers], ...], "L2": ...}      one lighting for every view, picked by name
//! ```
//! Coefficients in each view's own camera frame, for linear intensities, times the mean albedo.

use crate::cameras::{last_part, stem};
use crate::error::IoError;
use crate::json::{self, Node};
use rilievo_scene::{Lighting, LightingCalibration, PosedViews, SphericalHarmonics};
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// Lighting from a file.
#[derive(Clone, Debug, PartialEq)]
pub enum LightingFile {
    /// One lighting per view, by the photo's name without ending.
    PerView(Vec<(String, Lighting)>),
    /// One lighting, in each view's own camera frame, for every view.
    ForAll(Lighting),
}

impl LightingFile {
    /// The lighting of a view, by its name with or without ending.
    pub fn for_view(&self, name: &str) -> Option<&Lighting> {
        match self {
            Self::ForAll(lighting) => Some(lighting),
            Self::PerView(views) => views
                .iter()
                .find(|(known, _)| known == name)
                .or_else(|| views.iter().find(|(known, _)| known == last_part(name)))
                .or_else(|| {
                    views
                        .iter()
                        .find(|(known, _)| known == stem(name) || stem(known) == last_part(name))
                })
                .map(|(_, lighting)| lighting),
        }
    }
}

/// Splits `FILE` or `FILE:NAME`: at the last colon, unless the whole is an existing file or the
/// colon belongs to a folder or a drive.
pub fn split_lighting_spec(spec: &str) -> (PathBuf, Option<String>) {
    let whole = PathBuf::from(spec);
    if whole.is_file() {
        return (whole, None);
    }
    match spec.rsplit_once(':') {
        Some((file, name))
            if !file.is_empty() && !name.is_empty() && !name.contains(['/', '\\']) =>
        {
            (PathBuf::from(file), Some(name.to_owned()))
        }
        _ => (whole, None),
    }
}

/// Reads `lighting.json` in its long form, or the short form (a name → rows), of which `name`
/// picks one; with a name, an entry of the long form serves every view.
///
/// # Errors
/// When the file cannot be read, a row has not nine numbers, or the name is missing or unknown.
pub fn read_lighting(path: &Path, name: Option<&str>) -> Result<LightingFile, IoError> {
    let value = json::read(path)?;
    let root = Node::root(path, &value);
    let long = root.opt("views")?.filter(|node| node.value.is_object());
    if long.is_some() {
        check_header(&root)?;
    }
    let list = long.as_ref().unwrap_or(&root);
    let mut entries = Vec::new();
    for (name, node) in list.members()? {
        entries.push((name.to_owned(), rows(&node)?));
    }
    if entries.is_empty() {
        return Err(list.refuse("holds no lighting"));
    }
    let names = || {
        let names: Vec<&str> = entries.iter().map(|(name, _)| name.as_str()).collect();
        names.join(", ")
    };
    match (name, long.is_some()) {
        (Some(name), _) => match entries.iter().find(|(known, _)| known == name) {
            Some((_, lighting)) => Ok(LightingFile::ForAll(lighting.clone())),
            None => Err(IoError::input(
                path,
                format!("has no lighting named \"{name}\"; it has {}", names()),
            )),
        },
        (None, true) => Ok(LightingFile::PerView(entries)),
        (None, false) if entries.len() == 1 => Ok(LightingFile::ForAll(entries.swap_remove(0).1)),
        (None, false) => Err(
            IoError::input(path, format!("holds several lightings: {}", names()))
                .with_hint(format!("say {}:NAME to pick one", path.display())),
        ),
    }
}

/// The long form must mean what we mean.
fn check_header(root: &Node<'_>) -> Result<(), IoError> {
    let expected = SphericalHarmonics::BASIS;
    if let Some(basis) = root.opt("basis")?
        && !basis
            .text()?
            .split_whitespace()
            .eq(expected.split_whitespace())
    {
        return Err(basis.refuse(format!("is another basis than \"{expected}\"")));
    }
    if let Some(frame) = root.opt("frame")?
        && frame.text()? != "camera"
    {
        return Err(frame.refuse("is not \"camera\", the only frame of this file"));
    }
    if let Some(flag) = root.opt("includes_albedo")?
        && flag.value != &Value::Bool(true)
    {
        return Err(flag.refuse("is not true: coefficients must include the mean albedo"));
    }
    Ok(())
}

fn rows(node: &Node<'_>) -> Result<Lighting, IoError> {
    let channels = node
        .array()?
        .iter()
        .map(|row| row.numbers().map(SphericalHarmonics))
        .collect::<Result<Vec<_>, _>>()?;
    match channels.len() {
        1 | 3 => Ok(Lighting { channels }),
        n => Err(node.refuse(format!("has {n} rows; 1 (grey) or 3 (R G B) are needed"))),
    }
}

/// Writes `lighting.json` of stage 4, with what is known of its origin beside the coefficients.
pub fn write_lighting(
    path: &Path,
    calibration: &LightingCalibration,
    views: &PosedViews,
) -> Result<(), IoError> {
    let rows = |lighting: &Lighting| -> Vec<[f64; 9]> {
        lighting.channels.iter().map(|row| row.0).collect()
    };
    let mut entries = Map::new();
    let mut details = Map::new();
    for entry in &calibration.views {
        let Some(view) = views.views.get(entry.view.0) else {
            return Err(IoError::write(
                path,
                format!("there is no view {} for its lighting", entry.view),
            ));
        };
        entries.insert(view.name.clone(), json!(rows(&entry.lighting)));
        details.insert(
            view.name.clone(),
            json!({"residual": entry.residual, "gain": entry.gain}),
        );
    }
    let environment = calibration.environment_in_world.as_ref().map(rows);
    let root = json!({
        "basis": SphericalHarmonics::BASIS,
        "frame": "camera",
        "includes_albedo": true,
        "views": entries,
        "source": calibration.source,
        "light": calibration.kind,
        "environment_in_world": environment,
        "details": details,
    });
    json::file(path, &root)?.write()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::{
        Intrinsics, LightKind, LightSource, PhotoIdx, PosedView, RigidTransform, ViewIdx,
        ViewLighting,
    };

    fn lighting(seed: f64, channels: usize) -> Lighting {
        let row = |c: usize| {
            SphericalHarmonics(std::array::from_fn(|i| {
                (seed + 3.7 * i as f64 + c as f64).sin() / 3.0
            }))
        };
        Lighting {
            channels: (0..channels).map(row).collect(),
        }
    }

    fn read(text: &str, name: Option<&str>) -> Result<LightingFile, IoError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lighting.json");
        std::fs::write(&path, text).unwrap();
        read_lighting(&path, name)
    }

    #[test]
    fn a_calibration_survives_the_disk_bit_for_bit() {
        let mut views = PosedViews::default();
        for i in 0..2 {
            views.views.push(PosedView {
                photo: PhotoIdx(i),
                name: format!("IMG_{i}"),
                file_name: format!("IMG_{i}.jpg"),
                intrinsics: Intrinsics::pinhole(4, 3, 5.0, 1.5, 1.0),
                cam_from_world: RigidTransform::identity(),
            });
        }
        let calibration = LightingCalibration {
            source: LightSource::Sphere,
            kind: LightKind::World,
            environment_in_world: Some(lighting(0.5, 3)),
            views: (0..2)
                .map(|i| ViewLighting {
                    view: ViewIdx(i),
                    lighting: lighting(i as f64, 3),
                    residual: Some(0.03),
                    gain: vec![1.0; 3],
                })
                .collect(),
            spheres: Vec::new(),
            samples: Vec::new(),
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lighting.json");
        write_lighting(&path, &calibration, &views).unwrap();
        let file = read_lighting(&path, None).unwrap();
        assert_eq!(file.for_view("IMG_1"), Some(&lighting(1.0, 3)));
        assert_eq!(file.for_view("IMG_1.jpg"), Some(&lighting(1.0, 3)));
        assert_eq!(file.for_view("IMG_10"), None);
        let one = read_lighting(&path, Some("IMG_0")).unwrap();
        assert_eq!(one.for_view("anything"), Some(&lighting(0.0, 3)));
    }

    #[test]
    fn the_short_form_needs_a_name_where_it_has_several() {
        let text = r#"{"L1": [[1,2,3,4,5,6,7,8,9]], "L2": [[0,0,-1,0,0,0,0,0,0]]}"#;
        let file = read(text, Some("L2")).unwrap();
        let row = file.for_view("view1").unwrap().channels[0];
        assert_eq!(row.0[2], -1.0);
        let message = read(text, None).unwrap_err().to_string();
        assert!(
            message.contains("L1, L2") && message.contains(":NAME"),
            "{message}"
        );
        let message = read(text, Some("L3")).unwrap_err().to_string();
        assert!(message.contains("\"L3\""), "{message}");
    }

    #[test]
    fn wrong_values_are_refused_with_their_key() {
        for (text, expected) in [
            ("{}", "no lighting"),
            (
                r#"{"L1": [[1,2,3]]}"#,
                "L1[0]: [1,2,3] has 3 numbers, not 9",
            ),
            (r#"{"L1": []}"#, "0 rows"),
            (r#"{"L1": 3}"#, "L1: 3 is not a list"),
            (r#"{"basis": "1 x y z", "views": {}}"#, "another basis"),
            (r#"{"frame": "world", "views": {}}"#, "frame: \"world\""),
            (
                r#"{"includes_albedo": false, "views": {}}"#,
                "includes_albedo: false",
            ),
        ] {
            let message = read(text, None).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn file_and_name_are_told_apart() {
        let split = |spec: &str| {
            let (file, name) = split_lighting_spec(spec);
            (file.display().to_string(), name)
        };
        assert_eq!(split("a/l.json"), ("a/l.json".to_owned(), None));
        assert_eq!(
            split("a/l.json:L3"),
            ("a/l.json".to_owned(), Some("L3".to_owned()))
        );
        assert_eq!(split("C:/l.json"), ("C:/l.json".to_owned(), None));
    }
}
