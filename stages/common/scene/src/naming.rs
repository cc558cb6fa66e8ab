//! Names in messages.

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

#[cfg(test)]
mod tests {
    use super::*;

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
