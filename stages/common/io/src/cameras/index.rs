//! Cameras by their photos' names, and equal cameras as one: look-ups whose cost does not grow with
//! the number of cameras.

use super::entry::{CameraEntry, CameraFile};
use super::photo_names::{last_part, stem};
use rilievo_scene::Intrinsics;
use std::collections::HashMap;

/// The cameras of a file by their photos' names.
#[derive(Debug)]
pub struct CameraIndex<'a> {
    cameras: &'a [CameraEntry],
    /// The first camera of each name; those of each name without folders, and of each without ending too.
    whole: HashMap<&'a str, usize>,
    last: HashMap<&'a str, Vec<usize>>,
    stem: HashMap<&'a str, Vec<usize>>,
}

impl CameraFile {
    /// The camera of a photo, named with or without its ending. The whole name is tried first, so
    /// that `x.jpg` and `x.png` keep their own; a lone entry without a name fits every photo. Folders before a name
    /// must not contradict those of the other; `None` also where cameras of two folders fit. For several photos,
    /// [`CameraFile::index`] is made once.
    pub fn find(&self, image: &str) -> Option<&CameraEntry> {
        self.index().find(image)
    }

    /// The cameras by their photos' names.
    pub fn index(&self) -> CameraIndex<'_> {
        CameraIndex::new(self)
    }
}

impl<'a> CameraIndex<'a> {
    pub(super) fn new(file: &'a CameraFile) -> Self {
        let mut index = Self {
            cameras: &file.cameras,
            whole: HashMap::new(),
            last: HashMap::new(),
            stem: HashMap::new(),
        };
        for (place, entry) in file.cameras.iter().enumerate() {
            if let Some(name) = entry.image.as_deref() {
                index.whole.entry(name).or_insert(place);
                index.last.entry(last_part(name)).or_default().push(place);
                index.stem.entry(stem(name)).or_default().push(place);
            }
        }
        index
    }

    /// As [`CameraFile::find`].
    pub fn find(&self, image: &str) -> Option<&'a CameraEntry> {
        let (last, stem) = (last_part(image), stem(image));
        let among = |list: Option<&Vec<usize>>| self.fitting(image, list.into_iter().flatten());
        let either = [self.last.get(stem), self.stem.get(last)];
        let place = self.whole.get(image).copied();
        let place = place
            .or_else(|| among(self.last.get(last)))
            .or_else(|| self.fitting(image, either.into_iter().flatten().flatten()))
            .or_else(|| among(self.stem.get(stem)));
        match (place, self.cameras) {
            (Some(place), cameras) => cameras.get(place),
            (None, [only]) if only.image.is_none() => Some(only),
            (None, _) => None,
        }
    }
}

impl CameraIndex<'_> {
    /// The first of some cameras whose folders fit those of a photo, unless another one's folders differ from its.
    fn fitting<'p>(&self, image: &str, places: impl Iterator<Item = &'p usize>) -> Option<usize> {
        let folders = |place: usize| folders_of(self.cameras[place].image.as_deref().unwrap_or(""));
        let own = folders_of(image);
        let fits = |other: &[&str]| own.ends_with(other) || other.ends_with(&own);
        let mut fitting: Vec<usize> = places
            .copied()
            .filter(|&place| fits(&folders(place)))
            .collect();
        fitting.sort_unstable();
        let first = *fitting.first()?;
        let alike = fitting
            .iter()
            .all(|&place| folders(place) == folders(first));
        alike.then_some(first)
    }
}

/// The folders before a name.
fn folders_of(name: &str) -> Vec<&str> {
    let mut parts: Vec<&str> = name
        .split(['/', '\\'])
        .filter(|part| *part != ".")
        .collect();
    parts.pop();
    parts
}

/// Intrinsics, equal ones once.
#[derive(Debug, Default)]
pub(crate) struct DistinctCameras {
    /// In the order in which they came.
    pub(crate) list: Vec<Intrinsics>,
    places: HashMap<[u64; 18], usize>,
}

impl DistinctCameras {
    /// The place of a camera in the list, which it joins when it is new.
    pub(crate) fn place(&mut self, camera: &Intrinsics) -> usize {
        let next = self.list.len();
        let place = *self.places.entry(camera.key()).or_insert(next);
        if place == next {
            self.list.push(*camera);
        }
        place
    }
}
