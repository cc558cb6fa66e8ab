//! The part of XML that camera files use: elements, attributes, text, comments and entities.
//!
//! No namespaces, document types or processing instructions are interpreted; they are skipped.

/// Deepest nesting that is followed; camera files have about ten levels.
const MAX_DEPTH: usize = 64;

/// Bytes between `&` and `;` at most; the longest are numbers.
const MAX_ENTITY_LEN: usize = 12;

/// An element.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Element {
    pub name: String,
    pub attributes: Vec<(String, String)>,
    /// The text directly inside, pieces joined.
    pub text: String,
    pub children: Vec<Element>,
}

impl Element {
    pub fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes
            .iter()
            .find(|(known, _)| known == name)
            .map(|(_, value)| value.as_str())
    }

    /// The first child of a name.
    pub fn child(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|child| child.name == name)
    }

    /// All elements of a name below this one, at any depth, in order.
    pub fn descendants(&self, name: &str) -> Vec<&Element> {
        let mut found = Vec::new();
        for child in &self.children {
            if child.name == name {
                found.push(child);
            }
            found.extend(child.descendants(name));
        }
        found
    }
}

/// Parses a document; the reason with its line where it is none.
pub(crate) fn parse(text: &str) -> Result<Element, String> {
    let mut parser = Parser { text, at: 0 };
    let mut open: Vec<Element> = vec![Element::default()];
    loop {
        let piece = parser.until('<');
        if let Some(element) = open.last_mut() {
            let piece = decode(piece);
            if !element.text.is_empty() && !piece.trim().is_empty() {
                element.text.push(' ');
            }
            element.text.push_str(piece.trim());
        }
        if parser.rest().is_empty() {
            break;
        }
        if parser.skip_prefix("<!--") {
            parser.past("-->")?;
        } else if parser.skip_prefix("<?") {
            parser.past("?>")?;
        } else if parser.skip_prefix("<!") {
            parser.past(">")?;
        } else if parser.skip_prefix("</") {
            let name = parser.past(">")?.trim();
            let closed = open.pop().filter(|element| element.name == name);
            match (closed, open.last_mut()) {
                (Some(element), Some(parent)) => parent.children.push(element),
                _ => return Err(parser.refuse(&format!("</{name}> closes nothing"))),
            }
        } else {
            parser.at += 1;
            let (element, empty) = parser.tag()?;
            if open.len() > MAX_DEPTH {
                return Err(parser.refuse("too deeply nested"));
            }
            if !empty {
                open.push(element);
            } else if let Some(parent) = open.last_mut() {
                parent.children.push(element);
            }
        }
    }
    match (open.pop(), open.pop()) {
        (Some(mut root), None) if root.children.len() == 1 => Ok(root.children.swap_remove(0)),
        (Some(_), None) => Err("not an XML document with one element".to_owned()),
        (Some(element), _) => Err(parser.refuse(&format!("<{}> is not closed", element.name))),
        (None, _) => Err("not an XML document".to_owned()),
    }
}

struct Parser<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Parser<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn refuse(&self, reason: &str) -> String {
        let line = 1 + self.text[..self.at].matches('\n').count();
        format!("broken XML at line {line}: {reason}")
    }

    /// The text up to a character, which stays.
    fn until(&mut self, end: char) -> &'a str {
        let rest = self.rest();
        let piece = &rest[..rest.find(end).unwrap_or(rest.len())];
        self.at += piece.len();
        piece
    }

    fn skip_prefix(&mut self, prefix: &str) -> bool {
        let found = self.rest().starts_with(prefix);
        if found {
            self.at += prefix.len();
        }
        found
    }

    /// The text up to a mark, which is passed.
    fn past(&mut self, mark: &str) -> Result<&'a str, String> {
        let rest = self.rest();
        let len = rest
            .find(mark)
            .ok_or_else(|| self.refuse(&format!("{mark} is missing")))?;
        self.at += len + mark.len();
        Ok(&rest[..len])
    }

    fn skip_space(&mut self) {
        let rest = self.rest();
        self.at += rest.len() - rest.trim_start().len();
    }

    fn name(&mut self) -> &'a str {
        let rest = self.rest();
        let is_end = |c: char| c.is_whitespace() || matches!(c, '=' | '/' | '>' | '<');
        let name = &rest[..rest.find(is_end).unwrap_or(rest.len())];
        self.at += name.len();
        name
    }

    /// An opening tag after its `<`, and whether it closes itself.
    fn tag(&mut self) -> Result<(Element, bool), String> {
        let mut element = Element {
            name: self.name().to_owned(),
            ..Element::default()
        };
        if element.name.is_empty() {
            return Err(self.refuse("a tag has no name"));
        }
        loop {
            self.skip_space();
            if self.skip_prefix("/>") {
                return Ok((element, true));
            }
            if self.skip_prefix(">") {
                return Ok((element, false));
            }
            let name = self.name();
            self.skip_space();
            if name.is_empty() || !self.skip_prefix("=") {
                return Err(self.refuse(&format!("<{}> has a broken attribute", element.name)));
            }
            self.skip_space();
            let value = if self.skip_prefix("\"") {
                self.past("\"")?
            } else if self.skip_prefix("'") {
                self.past("'")?
            } else {
                return Err(self.refuse(&format!("attribute {name} has no quotes")));
            };
            element.attributes.push((name.to_owned(), decode(value)));
        }
    }
}

const ENTITIES: [(&str, char); 5] = [
    ("lt", '<'),
    ("gt", '>'),
    ("quot", '"'),
    ("apos", '\''),
    ("amp", '&'),
];

/// The character of `&name;`, `&#N;` or `&#xN;`.
fn character(name: &str) -> Option<char> {
    match name.strip_prefix('#') {
        None => ENTITIES
            .iter()
            .find(|(known, _)| *known == name)
            .map(|&(_, character)| character),
        Some(number) => {
            let code = match number.strip_prefix(['x', 'X']) {
                Some(digits) => u32::from_str_radix(digits, 16),
                None => number.parse(),
            };
            char::from_u32(code.ok()?)
        }
    }
}

fn decode(text: &str) -> String {
    let mut decoded = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('&') {
        decoded.push_str(&rest[..at]);
        rest = &rest[at..];
        let end = rest.find(';').filter(|&end| end <= MAX_ENTITY_LEN);
        match end.and_then(|end| Some((character(&rest[1..end])?, end))) {
            Some((character, end)) => {
                decoded.push(character);
                rest = &rest[end + 1..];
            }
            // What is no entity stands for itself.
            None => {
                decoded.push('&');
                rest = &rest[1..];
            }
        }
    }
    decoded.push_str(rest);
    decoded
}

/// Text that may stand in an attribute or between tags. White space but the plain one is written as
/// its number, since readers make a space of it otherwise.
pub(crate) fn encode(text: &str) -> String {
    let mut encoded = String::with_capacity(text.len());
    for c in text.chars() {
        match ENTITIES.iter().find(|(_, character)| *character == c) {
            Some((name, _)) => {
                encoded.push('&');
                encoded.push_str(name);
                encoded.push(';');
            }
            None if matches!(c, '\t' | '\n' | '\r') => {
                encoded.push_str(&format!("&#{};", u32::from(c)));
            }
            None => encoded.push(c),
        }
    }
    encoded
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "<?xml version=\"1.0\"?>\n<!-- <no> -->\n<a x='1' y = \"b &lt; c\">\n\
        <b/><c><b z=\"ä\">1 2\n3</b></c> t&amp;lt; </a>\n";

    #[test]
    fn a_document_becomes_a_tree() {
        let root = parse(TEXT).unwrap();
        assert_eq!(root.name, "a");
        assert_eq!(root.attribute("y"), Some("b < c"));
        assert_eq!(root.text, "t&lt;");
        let all = root.descendants("b");
        assert_eq!(all.len(), 2);
        assert_eq!(all[1].text, "1 2\n3");
        assert_eq!(
            root.child("c").unwrap().children[0].attribute("z"),
            Some("ä")
        );
        for text in ["<\"&'ä>&lt;", "a\nb\tc\r", "&", "&#65", "a & b; c"] {
            assert_eq!(decode(&encode(text)), text);
        }
        assert_eq!(encode("a\nb"), "a&#10;b");
        assert_eq!(decode("&#65;&#x42;&#xZ;&none;&;"), "AB&#xZ;&none;&;");
    }

    #[test]
    fn broken_documents_are_refused_and_never_panic() {
        let whole = TEXT.trim_end();
        for end in (0..whole.len()).filter(|&end| whole.is_char_boundary(end)) {
            assert!(parse(&whole[..end]).is_err(), "{end}");
        }
        for text in [
            "",
            "text",
            "<a></b>",
            "<a b></a>",
            "<a/><b/>",
            "</a>",
            "<a x=1/>",
            "< >",
        ] {
            assert!(parse(text).is_err(), "{text}");
        }
        assert!(parse(&"<a>".repeat(100_000)).is_err());
    }
}
