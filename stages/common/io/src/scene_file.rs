//! Scenes for shading alone: several views solved together (eq. 17 of the paper).
//!
//! ```text
//! {"views": [{"name": "view1", "image": "view1/image.exr", "mask": "view1/mask.png",
//!             "camera": "view1/camera.json", "lighting": "lighting.json:L3",
//!             "init": "view1/depth_flat.exr"}, ...],
//!  "matches": [{"views": ["view1", "view2"], "file": "matches.csv"}]}
//! ```
//! Paths are relative to the scene file. `init` may also be `plane` or `anchors`; `mask`,
//! `lighting`, `init` and `prior` may be left out.

use crate::cameras::stem;
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::json::{self, Node};
use crate::lighting_file::split_lighting_spec;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// One view of a scene; every path has the scene file's folder before it.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneView {
    /// Its name: names the results.
    pub name: String,
    /// The image.
    pub image: PathBuf,
    /// The mask; the whole frame where absent.
    pub mask: Option<PathBuf>,
    /// The camera.
    pub camera: PathBuf,
    /// The lighting file and the name within it.
    pub lighting: Option<(PathBuf, Option<String>)>,
    /// Initial depth: a file, or the words `plane` or `anchors`.
    pub init: Option<String>,
    /// Depth prior.
    pub prior: Option<PathBuf>,
}

/// Matches of two views.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneMatches {
    /// Names of the two views.
    pub views: [String; 2],
    /// A file of rows `x1,y1,x2,y2`.
    pub file: PathBuf,
}

/// A scene for shading alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneFile {
    /// The views.
    pub views: Vec<SceneView>,
    /// Matches between them.
    pub matches: Vec<SceneMatches>,
}

/// Reads a scene; the files that it names are not opened.
///
/// # Errors
/// When the file cannot be read or a key or value is wrong; names it.
pub fn read_scene(path: &Path) -> Result<SceneFile, IoError> {
    let value = json::read(path)?;
    let root = Node::root(path, &value);
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut scene = SceneFile::default();
    let mut known = HashSet::new();
    for node in root.get("views")?.array()? {
        let view = view(&node, folder)?;
        if view.name.is_empty() || view.name.contains(['/', '\\']) || view.name.starts_with('.') {
            return Err(node.get("name")?.refuse("cannot name a result file"));
        }
        if !known.insert(view.name.clone()) {
            return Err(node.refuse(format!("repeats the name \"{}\"", view.name)));
        }
        scene.views.push(view);
    }
    if scene.views.is_empty() {
        return Err(IoError::input(path, "views: [] holds no view"));
    }
    for node in root.list("matches")? {
        let names = node.get("views")?;
        let list = names.array()?;
        let [first, second] = &list[..] else {
            return Err(names.refuse("does not name two views"));
        };
        let views = [first.text()?, second.text()?].map(str::to_owned);
        if views[0] == views[1] || !views.iter().all(|name| known.contains(name)) {
            return Err(names.refuse("does not name two of the scene's views"));
        }
        scene.matches.push(SceneMatches {
            views,
            file: folder.join(node.get("file")?.text()?),
        });
    }
    Ok(scene)
}

fn view(node: &Node<'_>, folder: &Path) -> Result<SceneView, IoError> {
    let file = |key: &str| node.opt_as(key, |value| Ok(folder.join(value.text()?)));
    let image = folder.join(node.get("image")?.text()?);
    let name = match node.opt("name")? {
        Some(name) => name.text()?.to_owned(),
        None => stem(&image.to_string_lossy()).to_owned(),
    };
    let lighting = file("lighting")?.map(|spec| split_lighting_spec(&spec.to_string_lossy()));
    let init = node.opt_as("init", |init| {
        Ok(match init.text()? {
            word @ ("plane" | "anchors") => word.to_owned(),
            file => folder.join(file).to_string_lossy().into_owned(),
        })
    })?;
    Ok(SceneView {
        name,
        image,
        mask: file("mask")?,
        camera: folder.join(node.get("camera")?.text()?),
        lighting,
        init,
        prior: file("prior")?,
    })
}

/// Reads matches, rows `x1,y1,x2,y2` of pixels in two views, with or without a header; lines that
/// begin with `#` are comments, and further columns are ignored.
///
/// # Errors
/// When the file cannot be read or a row has not four finite numbers; names the line.
pub fn read_matches_csv(path: &Path) -> Result<Vec<[f64; 4]>, IoError> {
    let text = read_regular_text(path)?;
    let mut matches = Vec::new();
    let mut first = true;
    for (i, line) in text.lines().enumerate() {
        let line = line.trim_start_matches('\u{feff}').trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let numbers: Vec<Option<f64>> = line
            .split([',', ';', '\t'])
            .map(|word| word.trim().parse().ok().filter(|v: &f64| v.is_finite()))
            .take(4)
            .collect();
        let row = match numbers[..] {
            [Some(x1), Some(y1), Some(x2), Some(y2)] => Some([x1, y1, x2, y2]),
            _ => None,
        };
        match row {
            Some(row) => matches.push(row),
            // A header: no number at all in the first line.
            None if first && numbers.iter().all(Option::is_none) => {}
            None => {
                return Err(IoError::input(
                    path,
                    format!("line {}: \"{line}\" is not x1,y1,x2,y2", i + 1),
                ));
            }
        }
        first = false;
    }
    Ok(matches)
}

/// Writes matches `[x1, y1, x2, y2]` as [`read_matches_csv`] reads them.
pub fn write_matches_csv(path: &Path, matches: &[[f64; 4]]) -> Result<(), IoError> {
    let rows = matches
        .iter()
        .map(|[x1, y1, x2, y2]| format!("{x1:.6},{y1:.6},{x2:.6},{y2:.6}\n"));
    let header = std::iter::once("x1,y1,x2,y2\n".to_owned());
    let text: String = header.chain(rows).collect();
    OutputFile::new(path, text).write()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(text: &str) -> Result<SceneFile, IoError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.json");
        std::fs::write(&path, text).unwrap();
        read_scene(&path)
    }

    #[test]
    fn a_scene_is_read_with_paths_beside_it() {
        let found = scene(
            r#"{"views": [
                {"name": "a", "image": "a/i.exr", "mask": "a/m.png", "camera": "a/c.json",
                 "lighting": "l.json:L3", "init": "plane"},
                {"image": "b.exr", "camera": "c.json", "init": "z.exr", "prior": null}],
               "matches": [{"views": ["a", "b"], "file": "m.csv"}]}"#,
        )
        .unwrap();
        let [a, b] = &found.views[..] else {
            panic!("{found:?}");
        };
        assert!(a.image.is_absolute() && a.image.ends_with("a/i.exr"));
        let (file, name) = a.lighting.as_ref().unwrap();
        assert!(file.ends_with("l.json") && name.as_deref() == Some("L3"));
        assert_eq!(a.init.as_deref(), Some("plane"));
        assert_eq!((b.name.as_str(), &b.mask, &b.prior), ("b", &None, &None));
        assert!(b.init.as_ref().is_some_and(|init| init.ends_with("/z.exr")));
        assert!(found.matches[0].file.ends_with("m.csv"));
    }

    #[test]
    fn wrong_scenes_are_refused_with_their_key() {
        let view = r#"{"name": "a", "image": "i", "camera": "c"}"#;
        for (text, expected) in [
            ("{}".to_owned(), "\"views\" is missing"),
            (r#"{"views": []}"#.to_owned(), "no view"),
            (
                r#"{"views": [{"image": "i"}]}"#.to_owned(),
                "\"camera\" is missing in views[0]",
            ),
            (
                format!(r#"{{"views": [{view}, {view}]}}"#),
                "repeats the name",
            ),
            (
                format!(r#"{{"views": [{view}], "matches": [{{"views": ["a", "b"]}}]}}"#),
                "matches[0].views",
            ),
            (
                r#"{"views": [{"name": "../a", "image": "i", "camera": "c"}]}"#.to_owned(),
                "cannot name a result",
            ),
        ] {
            let message = scene(&text).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn matches_are_read_with_and_without_header() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_matches_csv(&path)
        };
        let rows = vec![[1.0, 2.0, 3.5, -4.0], [5.0, 6.0, 7.0, 8.0]];
        assert_eq!(read("x1,y1,x2,y2\n1,2,3.5,-4\n5, 6, 7, 8\n").unwrap(), rows);
        assert_eq!(read("# c\r\n1;2;3.5;-4\r\n\r\n5;6;7;8;0.9").unwrap(), rows);
        assert_eq!(read("").unwrap(), Vec::<[f64; 4]>::new());
        let message = read("1,2,3,4\n1,2,x,4\n").unwrap_err().to_string();
        assert!(
            message.contains("line 2") && message.contains("1,2,x,4"),
            "{message}"
        );
        assert!(read("1,2,3\n").is_err());
        assert!(read("1,2,3,inf\n").is_err());
    }
}
