//! The few pieces of HTML that the page is made of.

use maud::{Markup, html};

/// What stands for a value that is not there.
const ABSENT: &str = "–";

/// A column's name, and what it shows of a row's item.
pub type Column<'a, T> = (&'a str, &'a dyn Fn(&T) -> String);

/// A table with a caption, a row for each item; nothing without any.
pub fn table<'a, T: 'a>(
    caption: &str,
    items: impl IntoIterator<Item = &'a T>,
    columns: &[Column<'_, T>],
) -> Markup {
    let head: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    let items = items.into_iter();
    let rows = items.map(|item| columns.iter().map(|(_, cell)| cell(item)).collect());
    grid(caption, &head, &rows.collect::<Vec<_>>())
}

/// As [`table`], from cells, the first of a row its name.
pub fn grid(caption: &str, head: &[impl AsRef<str>], rows: &[Vec<String>]) -> Markup {
    html! {
        @if !rows.is_empty() {
            div.wide {
                table {
                    caption { (caption) }
                    thead { tr { @for cell in head { th scope="col" { (cell.as_ref()) } } } }
                    tbody {
                        @for row in rows {
                            tr {
                                @for (column, cell) in row.iter().enumerate() {
                                    @if column == 0 { th scope="row" { (cell) } }
                                    @else { td { (cell) } }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Names with what they stand for.
pub fn definitions<'a>(entries: impl IntoIterator<Item = (&'a str, String)>) -> Markup {
    html! { dl { @for (name, value) in entries { dt { (name) } dd { (value) } } } }
}

/// A section that can be folded away.
pub fn folded(title: &str, open: bool, content: &Markup) -> Markup {
    html! { details open[open] { summary { h3 { (title) } } (content) } }
}

/// A figure with one picture.
pub fn figure(picture: &str, alt: &str, caption: &Markup) -> Markup {
    html! {
        figure {
            img loading="lazy" src=(picture) alt=(alt);
            figcaption { (caption) }
        }
    }
}

/// A number with so many digits; a dash where there is none.
pub fn number(value: impl Into<Option<f64>>, digits: usize) -> String {
    match value.into().filter(|value| value.is_finite()) {
        Some(value) => format!("{value:.digits$}"),
        None => ABSENT.to_owned(),
    }
}

/// A share, in per cent.
pub fn percent(share: impl Into<Option<f64>>, digits: usize) -> String {
    match share.into().filter(|share| share.is_finite()) {
        Some(share) => format!("{:.digits$} %", 100.0 * share),
        None => ABSENT.to_owned(),
    }
}

/// A text; a dash where there is none.
pub fn text(value: Option<impl ToString>) -> String {
    value.map_or_else(|| ABSENT.to_owned(), |value| value.to_string())
}

/// An enum's name, as it stands in the report's JSON.
pub fn word(value: &impl serde::Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        Ok(serde_json::Value::Null) | Err(_) => ABSENT.to_owned(),
        Ok(other) => other.to_string(),
    }
}

/// A value as indented JSON.
pub fn json(value: &impl serde::Serialize) -> Markup {
    // What has no JSON form does not come here: options, inputs and reports were read from it.
    let text = serde_json::to_string_pretty(value).unwrap_or_default();
    html! { pre { (text) } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_cannot_break_the_page() {
        let name = "<b>\"a\" & 'b'.jpg";
        let html = table("x", [&name], &[("photo", &|n: &&str| n.to_string())]).into_string();
        assert!(
            html.contains("&lt;b&gt;&quot;a&quot; &amp; 'b'.jpg"),
            "{html}"
        );
        assert!(!html.contains("<b>"));
        let html = figure("data:,\"><b>", "\"<b>", &html! { "x" }).into_string();
        assert!(!html.contains("<b>"), "{html}");
    }

    #[test]
    fn what_is_absent_is_a_dash() {
        assert_eq!(number(0.125, 2), "0.12");
        assert_eq!(percent(Some(0.125), 1), "12.5 %");
        assert_eq!(number(None, 2), ABSENT);
        assert_eq!(number(f64::NAN, 2), ABSENT);
        assert_eq!(text(None::<&str>), ABSENT);
        assert_eq!(word(&rilievo_scene::LightKind::World), "world");
        assert_eq!(word(&None::<u8>), ABSENT);
    }
}
