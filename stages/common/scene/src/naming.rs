//! Names in messages, and of files.

/// Names that are listed; the rest is counted.
const MAX_NUM_LISTED: usize = 3;

/// The first three of some names, and how many more there are: a list of five hundred is not read.
/// `None` without any.
pub fn first_and_more<'a>(names: impl IntoIterator<Item = &'a str>) -> Option<String> {
    let names: Vec<&str> = names.into_iter().collect();
    let (listed, more) = names.split_at(names.len().min(MAX_NUM_LISTED));
    match more.len() {
        0 => (!listed.is_empty()).then(|| listed.join(", ")),
        n => Some(format!("{} and {n} more", listed.join(", "))),
    }
}

/// What a photo's results are called: its file name without ending, folders before it joined by `_`, so that all results
/// of a kind lie in one folder.
pub fn artifact_name(file_name: &str) -> String {
    let name = file_name.replace('/', "_");
    let begins = name.len() - file_name.rsplit('/').next().map_or(0, str::len);
    match name.rfind('.') {
        Some(dot) if dot > begins => name[..dot].to_owned(),
        _ => name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_called_by_folder_and_name() {
        for (file, name) in [
            ("a.b.jpg", "a.b"),
            ("100CANON/IMG_1.JPG", "100CANON_IMG_1"),
            ("a.b/c/d", "a.b_c_d"),
            ("a/.jpg", "a_.jpg"),
            (".jpg", ".jpg"),
        ] {
            assert_eq!(artifact_name(file), name);
        }
    }

    #[test]
    fn the_others_are_counted() {
        assert_eq!(first_and_more([]), None);
        assert_eq!(first_and_more(["a"]).as_deref(), Some("a"));
        assert_eq!(first_and_more(["a", "b"]).as_deref(), Some("a, b"));
        assert_eq!(
            first_and_more(["a", "b", "c", "d", "e"]).as_deref(),
            Some("a, b, c and 2 more")
        );
    }
}
