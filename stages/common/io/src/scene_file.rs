//! Scenes.
use crate::error::IoError;
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

/// Reads a scene.
///
/// # Errors
/// When the file cannot be read or a key or value is wrong; names it.
pub fn read_scene(path: &Path) -> Result<SceneFile, IoError> {
    Err(IoError::input(path, "not yet"))
}

/// Reads matches, rows `x1,y1,x2,y2` of pixels in two views, with or without a header.
///
/// # Errors
/// When the file cannot be read or a row has not four numbers; names the line.
pub fn read_matches_csv(path: &Path) -> Result<Vec<[f64; 4]>, IoError> {
    Err(IoError::input(path, "not yet"))
}
