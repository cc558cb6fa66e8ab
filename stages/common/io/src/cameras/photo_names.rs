//! Parts of the names by which camera files know their photos.

/// A file name without folders.
pub(crate) fn last_part(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

/// A file name without folders and ending.
pub(crate) fn stem(name: &str) -> &str {
    let name = last_part(name);
    match name.rfind('.') {
        Some(dot) if dot > 0 => &name[..dot],
        _ => name,
    }
}
