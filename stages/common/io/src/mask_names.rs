//! Which mask belongs to which photo, by their names.
//!
//! For a photo `x.jpg`, the first of these that exists, with any image ending in any case:
//! `x.jpg.png` (the photo's whole name), `x.png`, `x_mask.png`, `x-mask.png`, `x.mask.png`,
//! `x_masked.png`, `mask_x.png`, `x_alpha.png`. The most specific form comes first, so that
//! `x.jpg` and `x.png` in one folder keep their own masks.

use std::collections::{HashMap, HashSet};

/// Endings of mask files.
const MASK_ENDINGS: [&str; 6] = ["png", "tif", "tiff", "jpg", "jpeg", "exr"];

/// Parts `(before, after)` around the photo's name without ending.
const AFFIXES: [(&str, &str); 7] = [
    ("", ""),
    ("", "_mask"),
    ("", "-mask"),
    ("", ".mask"),
    ("", "_masked"),
    ("mask_", ""),
    ("", "_alpha"),
];

/// Name and ending of a file name; the ending is empty where there is none.
fn split(file_name: &str) -> (&str, &str) {
    match file_name.rfind('.') {
        Some(dot) if dot > 0 => (&file_name[..dot], &file_name[dot + 1..]),
        _ => (file_name, ""),
    }
}

fn last_part(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// What a photo would have to be called for a mask's file name to be its mask's: its whole name, or
/// its name without ending, with the place in the list of the module's documentation.
fn photos_of(mask_file_name: &str) -> impl Iterator<Item = (usize, &str)> {
    let (mask_name, ending) = split(mask_file_name);
    let is_image = MASK_ENDINGS
        .iter()
        .any(|known| known.eq_ignore_ascii_case(ending));
    let by_affix = AFFIXES.iter().enumerate().filter_map(move |(i, affix)| {
        let (before, after) = affix;
        let inner = mask_name.strip_prefix(before)?.strip_suffix(after)?;
        Some((i + 1, inner))
    });
    std::iter::once((0, mask_name))
        .chain(by_affix)
        .filter(move |_| is_image)
}

/// Mask files by the names of the photos that they fit; a look-up costs the same among any number.
#[derive(Debug)]
pub struct MaskNames {
    /// By place in the list and photo's name, in alphabetical order.
    masks: HashMap<(usize, String), Vec<String>>,
}

impl MaskNames {
    /// Files of masks; names may carry folders before them.
    pub fn new<'a>(mask_files: impl IntoIterator<Item = &'a String>) -> Self {
        let mut masks = HashMap::<_, Vec<String>>::new();
        for file in mask_files {
            for (place, photo) in photos_of(last_part(file)) {
                let key = (place, photo.to_owned());
                masks.entry(key).or_default().push(file.clone());
            }
        }
        masks.values_mut().for_each(|files| files.sort());
        Self { masks }
    }

    /// The mask of a photo.
    ///
    /// Names may carry folders before them (`a/x.jpg`, `masks/a/x.png`); of a photo whose name does, the mask is called
    /// by the same ones, by them joined to its name (`a_x.png`), or by none. Among equally good names of one without
    /// folders, a mask that lies in a folder of the name `within` wins, then the first in alphabetical order.
    pub fn find(&self, photo: &str, within: &str) -> Option<&str> {
        let (whole, own) = (last_part(photo), folders_of(photo));
        if own.is_empty() {
            return self.best(whole, &|folders| folders.last() == Some(&within), true);
        }
        let in_own = |folders: &[&str]| {
            folders.ends_with(&own) || !folders.is_empty() && own.ends_with(folders)
        };
        self.best(whole, &in_own, false)
            .or_else(|| self.best(&photo.replace('/', "_"), &|_| true, false))
            .or_else(|| self.best(whole, &|folders: &[&str]| folders.is_empty(), false))
    }

    /// The first mask of a file name that lies in folders which fit, else, where any will do, the first of all.
    fn best(&self, whole: &str, fits: &dyn Fn(&[&str]) -> bool, any: bool) -> Option<&str> {
        let (name, _) = split(whole);
        (0..=AFFIXES.len()).find_map(|place| {
            let key = (place, if place == 0 { whole } else { name }.to_owned());
            let files = self.masks.get(&key)?;
            let best = files.iter().find(|file| fits(&folders_of(file)));
            let best = best.or(files.first().filter(|_| any))?;
            Some(best.as_str())
        })
    }
}

/// The folders before a name.
fn folders_of(path: &str) -> Vec<&str> {
    let mut parts: Vec<&str> = path.split('/').collect();
    parts.pop();
    parts
}

/// Which of the files lying among photos are other photos' masks by their names (`x_mask.png` or
/// `x.jpg.png` beside `x.jpg`), and not photos themselves.
pub fn masks_among(files: &[String]) -> Vec<bool> {
    let whole: HashSet<&str> = files.iter().map(|file| last_part(file)).collect();
    let names: HashSet<&str> = whole.iter().map(|file| split(file).0).collect();
    let is_mask = |file: &String| {
        photos_of(last_part(file)).any(|(place, photo)| match place {
            0 => whole.contains(photo),
            // `x.png` beside `x.jpg` is two photos of one name, for the user to settle.
            1 => false,
            _ => names.contains(photo),
        })
    };
    files.iter().map(is_mask).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find_mask(photo: &str, files: &[String]) -> Option<String> {
        MaskNames::new(files).find(photo, "b").map(str::to_owned)
    }

    fn names(list: &[&str]) -> Vec<String> {
        list.iter().map(|&name| name.to_owned()).collect()
    }

    #[test]
    fn all_usual_names_are_found() {
        for mask in [
            "IMG_1.png",
            "IMG_1.jpg.png",
            "IMG_1_mask.png",
            "IMG_1-mask.PNG",
            "IMG_1.mask.png",
            "mask_IMG_1.tif",
            "masks/IMG_1.png",
        ] {
            let files = names(&["IMG_10.png", "IMG_11_mask.png", mask, "notes.txt"]);
            assert_eq!(
                find_mask("IMG_1.jpg", &files).as_deref(),
                Some(mask),
                "{mask}"
            );
        }
    }

    #[test]
    fn other_photos_masks_are_not_taken() {
        let files = names(&["IMG_10.png", "xIMG_1.png", "IMG_1.txt", "IMG_1_mask"]);
        assert_eq!(find_mask("IMG_1.jpg", &files).as_deref(), None);
        assert_eq!(
            find_mask("", &names(&[".png", "_mask.png"])).as_deref(),
            Some("_mask.png")
        );
    }

    #[test]
    fn the_most_specific_name_and_the_own_folder_win() {
        let files = names(&["x.png", "x.jpg.png", "x.png.png"]);
        assert_eq!(find_mask("x.jpg", &files).as_deref(), Some("x.jpg.png"));
        assert_eq!(find_mask("x.png", &files).as_deref(), Some("x.png.png"));
        let files = names(&["masks/a/x.png", "masks/b/x.png"]);
        assert_eq!(find_mask("x.jpg", &files).as_deref(), Some("masks/b/x.png"));
    }

    #[test]
    fn photos_of_subfolders_have_masks_of_the_same_path() {
        let all = ["100/x.png", "101/x_mask.png", "x.png", "102_x.png"];
        for (photo, mask) in [
            ("100/x.jpg", Some("100/x.png")),
            ("101/x.jpg", Some("101/x_mask.png")),
            ("102/x.jpg", Some("102_x.png")),
            ("a/100/x.jpg", Some("100/x.png")),
            ("103/x.jpg", Some("x.png")),
        ] {
            assert_eq!(find_mask(photo, &names(&all)).as_deref(), mask, "{photo}");
        }
        // Never that of another folder.
        assert_eq!(find_mask("103/x.jpg", &names(&all[..2])), None);
    }

    #[test]
    fn names_with_dots_spaces_and_other_scripts() {
        let files = names(&["büste 1.5m.png"]);
        assert_eq!(
            find_mask("büste 1.5m.JPG", &files).as_deref(),
            Some("büste 1.5m.png")
        );
    }

    #[test]
    fn masks_among_photos_are_told_apart() {
        let files = names(&[
            "a.jpg",
            "a_mask.png",
            "b.jpg",
            "b.jpg.png",
            "c.png",
            "c.jpg",
        ]);
        let found = masks_among(&files);
        let masks: Vec<&String> = files
            .iter()
            .zip(found)
            .filter_map(|(file, mask)| mask.then_some(file))
            .collect();
        assert_eq!(masks, ["a_mask.png", "b.jpg.png"]);
    }
}
