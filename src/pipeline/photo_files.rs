//! The photo files of folders and arguments, in the order of their names.

use super::request::Request;
use crate::exit::{Failure, Problem};
use crate::paths::text_of;
use rilievo_io::{is_photo_name, masks_among};
use rilievo_scene::first_and_more;
use std::path::{Path, PathBuf};

/// A photo's file.
pub struct PhotoFile {
    pub path: PathBuf,
    /// Its file name, of one in a subfolder its path below the folder that was given, with `/`.
    pub name: String,
}

/// The photo files of a request, and what was passed over.
///
/// # Errors
/// An argument that is not there, and a folder without photos.
pub fn photo_files(request: &Request) -> Result<(Vec<PhotoFile>, Vec<Problem>), Failure> {
    let mut search = Search {
        recursive: request.recursive,
        masks: request
            .masks
            .as_deref()
            .and_then(|path| path.canonicalize().ok()),
        files: Vec::new(),
        skipped: Vec::new(),
    };
    for argument in &request.photos {
        if !argument.is_dir() {
            if !argument.exists() {
                return Err(Failure::input(argument, "there is no such file or folder"));
            }
            search.add(argument.clone(), "");
            continue;
        }
        let before = search.files.len();
        let unread = search.folder(argument, "").map_err(|error| {
            Failure::ReadOrWrite(format!("cannot read {}: {error}", argument.display()))
        })?;
        let unread = unread.sentence();
        if search.files.len() == before {
            let inside = unread.map_or(String::new(), |unread| format!("; {unread}"));
            return Err(Failure::input(
                argument,
                format!(
                    "the folder holds no photo (JPEG, PNG, TIFF, OpenEXR or camera RAW){inside}"
                ),
            ));
        }
        search.skipped.extend(unread.map(|reason| Problem {
            file: argument.clone(),
            reason,
        }));
    }
    let Search {
        mut files,
        mut skipped,
        ..
    } = search;
    files.sort_by(|a, b| a.path.cmp(&b.path));
    files.dedup_by(|a, b| a.path == b.path);
    skipped.sort_by(|a, b| a.file.cmp(&b.file));
    skipped.dedup();
    Ok((files, skipped))
}

/// Photos in subfolders that are not read.
#[derive(Default)]
struct Unread {
    num_photos: usize,
    folders: Vec<String>,
}

impl Unread {
    fn sentence(&self) -> Option<String> {
        let names = first_and_more(self.folders.iter().map(String::as_str))?;
        let many =
            |num: usize, one: &str| format!("{num} {one}{}", if num == 1 { "" } else { "s" });
        Some(format!(
            "{} in {} not read ({names}): --recursive reads them",
            many(self.num_photos, "photo"),
            many(self.folders.len(), "subfolder")
        ))
    }
}

struct Search {
    recursive: bool,
    /// The folder of masks, which holds no photos.
    masks: Option<PathBuf>,
    files: Vec<PhotoFile>,
    skipped: Vec<Problem>,
}

impl Search {
    fn add(&mut self, path: PathBuf, prefix: &str) {
        let name = format!("{prefix}{}", text_of(path.file_name()));
        self.files.push(PhotoFile { path, name });
    }

    fn skip(&mut self, path: &Path, reason: &str) {
        let reason = format!("{reason}; passed over");
        let file = path.to_path_buf();
        self.skipped.push(Problem { file, reason });
    }

    /// Finds the photos of a folder, which a prefix of names stands for, and those inside it.
    fn folder(&mut self, folder: &Path, prefix: &str) -> std::io::Result<Unread> {
        let (mut found, mut folders) = (Vec::new(), Vec::new());
        for entry in std::fs::read_dir(folder)? {
            let path = entry?.path();
            if text_of(path.file_name()).starts_with('.') {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else if is_photo_name(&path) {
                found.push(path);
            } else {
                self.skip(&path, "is no photo by its name");
            }
        }
        let names: Vec<String> = found.iter().map(|path| text_of(path.file_name())).collect();
        for (path, is_mask) in found.into_iter().zip(masks_among(&names)) {
            if is_mask {
                self.skip(&path, "is a mask by its name, not a photo");
            } else {
                self.add(path, prefix);
            }
        }
        folders.retain(|path| !self.is_made(path));
        folders.sort();
        let mut unread = Unread::default();
        for path in folders {
            let name = text_of(path.file_name());
            let below = format!("{prefix}{name}/");
            if !self.recursive {
                let mut inside = Self {
                    recursive: true,
                    masks: self.masks.clone(),
                    files: Vec::new(),
                    skipped: Vec::new(),
                };
                // What cannot be read is not counted.
                let _ = inside.folder(&path, &below);
                if !inside.files.is_empty() {
                    unread.num_photos += inside.files.len();
                    unread.folders.push(name);
                }
            } else if path.is_symlink() {
                self.skip(&path, "is a link to a folder");
            } else if let Err(error) = self.folder(&path, &below) {
                self.skip(&path, &format!("cannot be read: {error}"));
            }
        }
        Ok(unread)
    }

    /// Whether a folder holds masks or what this program made, and no photos.
    fn is_made(&self, folder: &Path) -> bool {
        let name = text_of(folder.file_name()).to_lowercase();
        let is_masks = self.masks.is_some() && folder.canonicalize().ok() == self.masks;
        let is_run = folder.join("run.json").is_file();
        is_masks || is_run || name == "masks" || name.ends_with("-overlays")
    }
}
