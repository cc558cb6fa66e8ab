//! What the user asked for: everything but how to work. Stored in `run.json`, so that `status`,
//! `why` and `run` need only the run directory.

use crate::cli::{ReconstructArgs, SphereArgs};
use crate::config::{StageOptions, take_over};
use crate::exit::Failure;
use crate::paths;
use rilievo_features::PairChoice;
use rilievo_io::split_lighting_spec;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Where the reference sphere is to be had from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SphereInput {
    None,
    /// It is to be found in the photos.
    Auto {
        /// Its radius, metres.
        radius: f64,
    },
    /// A sphere file; a radius beside it replaces the file's.
    File {
        /// The file.
        #[serde(with = "paths::one")]
        path: PathBuf,
        /// Radius from the command line, metres.
        radius: Option<f64>,
    },
}

impl SphereInput {
    /// What a command line says of the sphere.
    ///
    /// # Errors
    /// A radius that no sphere has, one without a sphere, and a file that does not exist.
    pub fn from_args(args: &SphereArgs) -> Result<Self, Failure> {
        if let Some(radius) = args.sphere_radius
            && !rilievo_io::SPHERE_RADII.contains(&radius)
        {
            let usable = rilievo_io::SPHERE_RADII;
            return Err(Failure::Usage(if radius.is_finite() && radius > 0.0 {
                format!(
                    "--sphere-radius {radius:e} is no sphere's radius in metres: {:e} to {:e} can be meant",
                    usable.start(),
                    usable.end()
                )
            } else {
                format!("--sphere-radius {radius} must be a positive length in metres")
            }));
        }
        let (sphere, radius) = (args.sphere.as_path(), args.sphere_radius);
        match (sphere.to_str(), radius) {
            (Some("none"), None) => Ok(Self::None),
            (Some("none"), Some(_)) => Err(Failure::Usage(
                "--sphere-radius needs --sphere auto or --sphere FILE".to_owned(),
            )),
            (Some("auto"), Some(radius)) => Ok(Self::Auto { radius }),
            (Some("auto"), None) => Err(Failure::Usage(
                "--sphere auto needs --sphere-radius METRES".to_owned(),
            )),
            _ => Ok(Self::File {
                path: existing(sphere, "--sphere")?,
                radius,
            }),
        }
    }
}

/// Where the lighting is to be had from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightingInput {
    /// From the sphere where there is one, else from the program's own rough shape.
    Found,
    /// A lighting file, and the name to pick from it.
    File {
        /// The file.
        #[serde(with = "paths::one")]
        path: PathBuf,
        /// Which of its lightings.
        name: Option<String>,
    },
    /// Fitted on depth maps `NAME_depth.exr` in this folder.
    Shape {
        /// The folder.
        #[serde(with = "paths::one")]
        folder: PathBuf,
    },
}

/// Where masks come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskOrigin {
    /// The user made them.
    #[default]
    Given,
    /// The run proposed them for itself, but for photos that had no pose, and nobody said that they are right.
    Proposed,
    /// The same, and the user said so.
    Accepted,
    /// The user said that there are none: the whole frame is meant, whatever it looks like.
    None,
}

/// A reconstruction, as asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// Folders and files, absolute.
    #[serde(with = "paths::list")]
    pub photos: Vec<PathBuf>,
    /// Whether folders inside them are searched too.
    #[serde(default)]
    pub recursive: bool,
    /// Folder of masks.
    #[serde(with = "paths::optional")]
    pub masks: Option<PathBuf>,
    /// Where these masks come from.
    #[serde(default)]
    pub masks_from: MaskOrigin,
    /// Camera file or COLMAP folder.
    #[serde(with = "paths::optional")]
    pub cameras: Option<PathBuf>,
    /// Run or cameras whose frame the world is to have.
    #[serde(default, with = "paths::optional")]
    pub frame_of: Option<PathBuf>,
    pub sphere: SphereInput,
    pub lighting: LightingInput,
    /// Options of the stages.
    pub options: StageOptions,
}

impl Request {
    /// A request of photos alone: no masks, no cameras, no sphere.
    pub fn of_photos(photos: Vec<PathBuf>, options: StageOptions) -> Self {
        Self {
            photos,
            recursive: false,
            masks: None,
            masks_from: MaskOrigin::Given,
            cameras: None,
            frame_of: None,
            sphere: SphereInput::None,
            lighting: LightingInput::Found,
            options,
        }
    }

    /// Whether a photo without a mask is an error and not a choice.
    pub fn needs_masks(&self) -> bool {
        self.masks.is_some() && self.masks_from == MaskOrigin::Given
    }

    /// The request for a run directory that was moved together with its photos and files: paths that
    /// lead from its new place to something are taken from there, as they did from the old one.
    #[must_use]
    pub fn moved(mut self, from: &Path, to: &Path) -> Self {
        let relocate = |path: &mut PathBuf| {
            if let Some(found) = relocated(path, from, to).filter(|path| path.exists()) {
                *path = found;
            }
        };
        self.photos.iter_mut().for_each(relocate);
        self.masks.iter_mut().for_each(relocate);
        self.cameras.iter_mut().for_each(relocate);
        self.frame_of.iter_mut().for_each(relocate);
        if let SphereInput::File { path, .. } = &mut self.sphere {
            relocate(path);
        }
        match &mut self.lighting {
            LightingInput::File { path, .. } => relocate(path),
            LightingInput::Shape { folder } => relocate(folder),
            LightingInput::Found => {}
        }
        self
    }

    /// The request of a command line.
    ///
    /// # Errors
    /// Contradictory or invalid options, and paths that do not exist.
    pub fn from_args(args: &ReconstructArgs) -> Result<Self, Failure> {
        let mut options = StageOptions::read(args.config.config.as_deref())?;
        take_over(&mut options.shading.model, args.model);
        take_over(&mut options.photos.encoding, args.input.encoding.encoding);
        if let Some(pairs) = &args.pairs {
            options.features.pairs = pair_choice(pairs)?;
        }
        options.shading.photo.trust_lighting |= args.trust_lighting;
        if let Some(known) = &args.known_distance {
            options.poses.known_distance = Some(known.clone());
        }
        args.surface.apply(&mut options.fusion);
        args.work.bound(&mut options.fusion);
        options.validate()?;
        let lighting = match (&args.lighting, &args.lighting_shape) {
            (Some(spec), _) => {
                let (path, name) = split_lighting_spec(spec);
                LightingInput::File {
                    path: existing(&path, "--lighting")?,
                    name,
                }
            }
            (None, Some(folder)) => LightingInput::Shape {
                folder: existing(folder, "--lighting-shape")?,
            },
            (None, None) => LightingInput::Found,
        };
        Ok(Self {
            photos: args
                .input
                .photos
                .iter()
                .map(|path| existing(path, "photos"))
                .collect::<Result<_, _>>()?,
            recursive: args.input.recursive,
            masks: match &args.masks {
                Some(word) if word.to_str() == Some("none") => None,
                folder => optional(folder.as_deref(), "--masks")?,
            },
            masks_from: match &args.masks {
                Some(word) if word.to_str() == Some("none") => MaskOrigin::None,
                _ => MaskOrigin::Given,
            },
            cameras: optional(args.input.cameras.as_deref(), "--cameras")?,
            frame_of: frame_of(args)?,
            sphere: SphereInput::from_args(&args.sphere)?,
            lighting,
            options,
        })
    }
}

/// `all`, `auto`, `sequential`, or the pairs of a file.
fn pair_choice(word_or_file: &Path) -> Result<PairChoice, Failure> {
    match word_or_file.to_str() {
        Some("all") => return Ok(PairChoice::All),
        Some("auto") => return Ok(PairChoice::Auto),
        Some("sequential") => return Ok(PairChoice::Sequential),
        _ => {}
    }
    let path = existing(
        word_or_file,
        "--pairs takes all, auto, sequential or a file",
    )?;
    let text = std::fs::read_to_string(&path)
        .map_err(|e| Failure::input(&path, format!("is no text to read pairs from: {e}")))?;
    listed_pairs(&text).map_err(|reason| Failure::input(&path, reason))
}

/// Two file names a line; lines that are empty or begin with `#` say nothing.
fn listed_pairs(text: &str) -> Result<PairChoice, String> {
    let mut pairs = Vec::new();
    // Some editors begin a file with a byte order mark.
    for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let names: Vec<&str> = if line.contains(',') {
            line.split(',').map(str::trim).collect()
        } else {
            line.split_whitespace().collect()
        };
        let pair = <[&str; 2]>::try_from(names).ok();
        let Some([first, second]) = pair.filter(|names| names.iter().all(|name| !name.is_empty()))
        else {
            return Err(format!(
                "line {number} is no pair: two file names, separated by a comma (where names hold spaces) or white space"
            ));
        };
        pairs.push([first.to_owned(), second.to_owned()]);
    }
    if pairs.is_empty() {
        return Err("lists no pair: two file names a line".to_owned());
    }
    Ok(PairChoice::Listed(pairs))
}

/// The run or cameras whose frame is asked for.
fn frame_of(args: &ReconstructArgs) -> Result<Option<PathBuf>, Failure> {
    let found = optional(args.frame_of.as_deref(), "--frame-of")?;
    let is_own = |path: &PathBuf| {
        let [own, other] = [&args.output, path].map(std::fs::canonicalize);
        own.is_ok_and(|own| other.is_ok_and(|other| own == other))
    };
    match found {
        Some(path) if is_own(&path) => Err(Failure::input(
            &path,
            "is this run itself, which keeps its frame where its cameras agree: leave --frame-of out",
        )),
        found => Ok(found),
    }
}

fn optional(path: Option<&Path>, option: &str) -> Result<Option<PathBuf>, Failure> {
    path.map(|path| existing(path, option)).transpose()
}

/// Where a path leads when its first part moved: what `path` and `from` share is replaced by what
/// remains of `to` without as many names as `from` has beyond it.
fn relocated(path: &Path, from: &Path, to: &Path) -> Option<PathBuf> {
    let shared = path
        .components()
        .zip(from.components())
        .take_while(|(a, b)| a == b)
        .count();
    let beyond = from.components().count() - shared;
    let base = to.ancestors().nth(beyond)?;
    Some(base.join(path.components().skip(shared).collect::<PathBuf>()))
}

/// An absolute path, so that the run can be continued from any folder.
fn existing(path: &Path, option: &str) -> Result<PathBuf, Failure> {
    std::path::absolute(path)
        .ok()
        .filter(|path| path.exists())
        .ok_or_else(|| Failure::input(path, format!("there is no such file or folder ({option})")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_lists_pairs_by_names() {
        let text = "# two photos a line\na.jpg b.jpg\n\nmy photo.jpg, other.jpg\r\n";
        let [first, second] = [["a.jpg", "b.jpg"], ["my photo.jpg", "other.jpg"]];
        let listed = [first, second].map(|pair| pair.map(str::to_owned));
        assert_eq!(listed_pairs(text), Ok(PairChoice::Listed(listed.to_vec())));
        assert!(
            listed_pairs("a.jpg b.jpg c.jpg")
                .unwrap_err()
                .contains("line 1")
        );
        assert!(listed_pairs("a.jpg,").unwrap_err().contains("line 1"));
        assert!(listed_pairs("\u{feff}# by a text editor\na.jpg b.jpg").is_ok());
        assert!(listed_pairs("# nothing\n").unwrap_err().contains("no pair"));
    }

    #[test]
    fn what_stands_beside_a_moved_run_is_found_there() {
        let at = |path, from, to| relocated(Path::new(path), Path::new(from), Path::new(to));
        let found = at("/a/project/photos", "/a/project/run", "/b/moved/run");
        assert_eq!(found, Some("/b/moved/photos".into()));
        let found = at("/a/project/photos", "/a/project/out/run", "/b/out/run");
        assert_eq!(found, Some("/b/photos".into()));
        assert_eq!(at("/photos", "/a/b/c/run", "/run"), None);
    }
}
