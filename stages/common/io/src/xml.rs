//! What an XML text must not claim before it is parsed.
//!
//! The parser's time grows with the square of a tag's attributes and with the depth of namespaces,
//! and it reserves memory by the number of tags: all are bounded here first, in one pass.

/// Bytes of a file; ten thousand cameras take about ten million.
const MAX_BYTES: usize = 64 << 20;
/// Tags, closing ones included.
const MAX_TAGS: usize = 2_000_000;
/// Deepest nesting; camera files have about ten levels.
const MAX_DEPTH: usize = 64;
/// Equality signs in a tag: its attributes, and those in their values.
const MAX_ATTRIBUTES: usize = 64;
/// Declarations of namespaces in all.
const MAX_NAMESPACES: usize = 64;

/// Whether a text may be given to the parser; the reason where it may not.
pub(crate) fn check(text: &str) -> Result<(), String> {
    if text.len() > MAX_BYTES {
        return Err(format!("is larger than {} MiB", MAX_BYTES >> 20));
    }
    if text.matches("xmlns").count() > MAX_NAMESPACES {
        return Err(format!("declares more than {MAX_NAMESPACES} namespaces"));
    }
    let (mut rest, mut depth, mut num_tags) = (text, 0_usize, 0_usize);
    while let Some(start) = rest.find('<') {
        rest = &rest[start..];
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        if let Some((_, end)) = skipped.iter().find(|(begin, _)| rest.starts_with(begin)) {
            // What does not end is the parser's to refuse.
            let Some(after) = rest.find(end) else {
                return Ok(());
            };
            rest = &rest[after + end.len()..];
            continue;
        }
        let Some(length) = tag_length(rest) else {
            return Ok(());
        };
        let tag = &rest[..length];
        if tag.matches('=').count() > MAX_ATTRIBUTES {
            return Err(format!(
                "has a tag with more than {MAX_ATTRIBUTES} attributes"
            ));
        }
        num_tags += 1;
        if num_tags > MAX_TAGS {
            return Err(format!("has more than {MAX_TAGS} tags"));
        }
        if tag.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !tag.ends_with("/>") && !tag.starts_with("<!") {
            depth += 1;
            if depth > MAX_DEPTH {
                return Err(format!("is nested deeper than {MAX_DEPTH} elements"));
            }
        }
        rest = &rest[length..];
    }
    Ok(())
}

/// Bytes of the tag at the start, its `>` included; one inside quotes does not end it.
fn tag_length(text: &str) -> Option<usize> {
    let mut quote = None;
    for (at, byte) in text.bytes().enumerate() {
        match (quote, byte) {
            (None, b'>') => return Some(at + 1),
            (None, b'"' | b'\'') => quote = Some(byte),
            (Some(open), close) if open == close => quote = None,
            _ => {}
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usual_files_pass_and_quotes_and_comments_hide_brackets() {
        let text = r#"<?xml version="1.0"?><!-- <a><a> --><a b="x>y"><c/><![CDATA[<d><d>]]></a>"#;
        assert_eq!(check(text), Ok(()));
        assert_eq!(check(&"<a></a>".repeat(1000)), Ok(()));
    }

    #[test]
    fn depth_attributes_namespaces_and_tags_are_bounded() {
        let cases = [
            ("<a>".repeat(65), "nested deeper"),
            (format!("<a {}/>", "b='' ".repeat(65)), "attributes"),
            ("<a xmlns:a='b'/>".repeat(65), "namespaces"),
            ("<a/>".repeat(MAX_TAGS + 1), "tags"),
        ];
        for (text, reason) in cases {
            let refused = check(&text).unwrap_err();
            assert!(refused.contains(reason), "{refused}");
        }
    }
}
