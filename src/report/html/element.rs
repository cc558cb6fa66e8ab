//! The few pieces of HTML that the page is made of.

use serde_json::Value;

/// Text that is safe inside an element or an attribute.
pub fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            other => safe.push(other),
        }
    }
    safe
}

/// A table with a caption; cells are escaped.
pub fn table(caption: &str, head: &[&str], rows: &[Vec<String>]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut html = format!(
        "<div class=\"wide\"><table><caption>{}</caption><thead><tr>",
        escape(caption)
    );
    for cell in head {
        html += &format!("<th scope=\"col\">{}</th>", escape(cell));
    }
    html += "</tr></thead><tbody>";
    for row in rows {
        html += "<tr>";
        for (column, cell) in row.iter().enumerate() {
            html += &if column == 0 {
                format!("<th scope=\"row\">{}</th>", escape(cell))
            } else {
                format!("<td>{}</td>", escape(cell))
            };
        }
        html += "</tr>";
    }
    html + "</tbody></table></div>"
}

/// A section that can be folded away.
pub fn folded(title: &str, open: bool, content: &str) -> String {
    let open = if open { " open" } else { "" };
    format!(
        "<details{open}><summary><h3>{}</h3></summary>{content}</details>",
        escape(title)
    )
}

/// Number at a path of the report, with so many digits; a dash where there is none.
pub fn number(value: &Value, path: &str, digits: usize) -> String {
    match value.pointer(path).and_then(Value::as_f64) {
        Some(number) => format!("{number:.digits$}"),
        None => "–".to_owned(),
    }
}

/// Share at a path, in per cent.
pub fn percent(value: &Value, path: &str, digits: usize) -> String {
    match value.pointer(path).and_then(Value::as_f64) {
        Some(share) => format!("{:.digits$} %", 100.0 * share),
        None => "–".to_owned(),
    }
}

/// Text at a path; numbers and lists as their JSON.
pub fn text(value: &Value, path: &str) -> String {
    match value.pointer(path) {
        None | Some(Value::Null) => "–".to_owned(),
        Some(Value::String(text)) => text.clone(),
        Some(other) => other.to_string(),
    }
}

/// Items of a list at a path.
pub fn items<'a>(value: &'a Value, path: &str) -> &'a [Value] {
    value
        .pointer(path)
        .and_then(Value::as_array)
        .map_or(&[], Vec::as_slice)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_cannot_break_the_page() {
        let rows = vec![vec!["<b>\"a\" & 'b'.jpg".to_owned(), "1".to_owned()]];
        let html = table("x", &["photo", "n"], &rows);
        assert!(html.contains("&lt;b&gt;&quot;a&quot; &amp; &#39;b&#39;.jpg"));
        assert!(!html.contains("<b>"));
    }

    #[test]
    fn what_is_absent_is_a_dash() {
        let value = serde_json::json!({"a": 0.125, "b": null});
        assert_eq!(number(&value, "/a", 2), "0.12");
        assert_eq!(percent(&value, "/a", 1), "12.5 %");
        assert_eq!(number(&value, "/b", 2), "–");
        assert_eq!(text(&value, "/c"), "–");
    }
}
