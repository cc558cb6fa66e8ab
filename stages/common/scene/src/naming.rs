//! Names in messages.

/// The first of some names, and how many more there are: a list of five hundred is not read. `None` without any.
pub fn first_and_more<'a>(names: impl IntoIterator<Item = &'a str>) -> Option<String> {
    let mut names = names.into_iter();
    let first = names.next()?;
    Some(match names.count() {
        0 => first.to_owned(),
        n => format!("{first} and {n} more"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_others_are_counted() {
        assert_eq!(first_and_more([]), None);
        assert_eq!(first_and_more(["a"]).as_deref(), Some("a"));
        assert_eq!(
            first_and_more(["a", "b", "c"]).as_deref(),
            Some("a and 2 more")
        );
    }
}
