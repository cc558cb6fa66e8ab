//! Which mask belongs to which photo, by their names.
//!
//! For a photo `x.jpg`, the first of these that exists, with any image ending in any case:
//! `x.jpg.png` (the photo's whole name), `x.png`, `x_mask.png`, `x-mask.png`, `x.mask.png`,
//! `x_masked.png`, `mask_x.png`, `x_alpha.png`. The most specific form comes first, so that
//! `x.jpg` and `x.png` in one folder keep their own masks.

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

/// How well a mask's name fits a photo's: the place in the list of the module's documentation.
fn rank(photo_file_name: &str, mask_file_name: &str) -> Option<usize> {
    let (mask_name, ending) = split(mask_file_name);
    if !MASK_ENDINGS
        .iter()
        .any(|known| known.eq_ignore_ascii_case(ending))
    {
        return None;
    }
    if mask_name == photo_file_name {
        return Some(0);
    }
    let (photo_name, _) = split(photo_file_name);
    AFFIXES.iter().enumerate().find_map(|(i, (before, after))| {
        let inner = mask_name.strip_prefix(before)?.strip_suffix(after)?;
        (inner == photo_name).then_some(i + 1)
    })
}

/// The mask among `mask_files` that belongs to a photo.
///
/// Names may carry folders before them (`a/x.jpg`, `masks/a/x.png`). Among equally good names one
/// whose last folder is the photo's wins, then the first in alphabetical order.
pub fn find_mask<'a>(photo: &str, mask_files: &'a [String]) -> Option<&'a str> {
    let photo_name = last_part(photo);
    let parent = |path: &str| -> Option<String> {
        let mut parts = path.rsplit('/');
        parts.next();
        parts.next().map(str::to_owned)
    };
    let photo_parent = parent(photo);
    mask_files
        .iter()
        .filter_map(|mask| {
            let rank = rank(photo_name, last_part(mask))?;
            let elsewhere = photo_parent.is_some() && parent(mask) != photo_parent;
            Some((rank, elsewhere, mask.as_str()))
        })
        .min()
        .map(|(_, _, mask)| mask)
}

/// A name under which a mask of a photo would be found, for messages.
pub fn expected_mask_name(photo: &str) -> String {
    format!("{}.png", split(last_part(photo)).0)
}

/// Whether a file lying among photos is another photo's mask by its name (`x_mask.png` or
/// `x.jpg.png` beside `x.jpg`), and not a photo itself.
pub fn is_mask_among(file: &str, files: &[String]) -> bool {
    let name = last_part(file);
    files.iter().any(|other| {
        // Rank 1 (`x.png` beside `x.jpg`) is two photos of one name, for the user to settle.
        other != file && rank(last_part(other), name).is_some_and(|rank| rank != 1)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

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
            assert_eq!(find_mask("IMG_1.jpg", &files), Some(mask), "{mask}");
        }
    }

    #[test]
    fn other_photos_masks_are_not_taken() {
        let files = names(&["IMG_10.png", "xIMG_1.png", "IMG_1.txt", "IMG_1_mask"]);
        assert_eq!(find_mask("IMG_1.jpg", &files), None);
        assert_eq!(
            find_mask("", &names(&[".png", "_mask.png"])),
            None.or(Some("_mask.png"))
        );
    }

    #[test]
    fn the_most_specific_name_and_the_own_folder_win() {
        let files = names(&["x.png", "x.jpg.png", "x.png.png"]);
        assert_eq!(find_mask("x.jpg", &files), Some("x.jpg.png"));
        assert_eq!(find_mask("x.png", &files), Some("x.png.png"));
        let files = names(&["masks/a/x.png", "masks/b/x.png"]);
        assert_eq!(find_mask("photos/b/x.jpg", &files), Some("masks/b/x.png"));
    }

    #[test]
    fn names_with_dots_spaces_and_other_scripts() {
        let files = names(&["büste 1.5m.png"]);
        assert_eq!(find_mask("büste 1.5m.JPG", &files), Some("büste 1.5m.png"));
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
        let masks: Vec<&String> = files.iter().filter(|f| is_mask_among(f, &files)).collect();
        assert_eq!(masks, ["a_mask.png", "b.jpg.png"]);
    }
}
