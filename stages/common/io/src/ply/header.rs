//! The header: format, elements and their properties.

/// Type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Whether colours of this type run from 0 to 1 instead of 0 to 255.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// A property of an element.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Property {
    pub name: String,
    /// Type of the length, for a list.
    pub list: Option<Scalar>,
    pub scalar: Scalar,
}

/// An element.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Element {
    pub name: String,
    pub count: usize,
    pub properties: Vec<Property>,
}

/// How the body is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A header and where it ends.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Header {
    pub format: Format,
    pub elements: Vec<Element>,
    pub body_at: usize,
    /// What a comment says is to be added to positions for those of the world.
    pub offset: [f64; 3],
}

impl Header {
    /// Parses the header; the reason where it is none.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        if !bytes.starts_with(b"ply") {
            return Err("not a PLY file".to_owned());
        }
        let mut format = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut at = 0;
        let mut number = 0;
        let mut offset = [0.0; 3];
        loop {
            let rest = bytes.get(at..).unwrap_or_default();
            let len = rest
                .iter()
                .position(|&byte| byte == b'\n')
                .ok_or("the header has no end_header")?;
            let line = std::str::from_utf8(&rest[..len])
                .map(str::trim)
                .or_else(|_| {
                    // Comments may be written in any encoding.
                    if rest.starts_with(b"comment") || rest.starts_with(b"obj_info") {
                        Ok("comment")
                    } else {
                        Err(format!("line {} of the header is no text", number + 1))
                    }
                })?;
            at += len + 1;
            number += 1;
            let words: Vec<&str> = line.split_whitespace().collect();
            let wrong = || format!("line {number} of the header: \"{line}\"");
            match words[..] {
                ["ply"] if number == 1 => {}
                ["format", name, "1.0"] => {
                    format = Some(match name {
                        "ascii" => Format::Ascii,
                        "binary_little_endian" => Format::LittleEndian,
                        "binary_big_endian" => Format::BigEndian,
                        _ => return Err(wrong()),
                    });
                }
                ["comment", "offset", x, y, z, ..] => {
                    // Other programs' comments may begin so too.
                    if let [Ok(x), Ok(y), Ok(z)] = [x, y, z].map(str::parse::<f64>)
                        && [x, y, z].iter().all(|v| v.is_finite())
                    {
                        offset = [x, y, z];
                    }
                }
                ["comment" | "obj_info", ..] | [] => {}
                ["element", name, count] => elements.push(Element {
                    name: name.to_owned(),
                    count: count.parse().map_err(|_| wrong())?,
                    properties: Vec::new(),
                }),
                ["property", ref property @ ..] => {
                    let (list, scalar, name) = match *property {
                        ["list", length, scalar, name] => (Some(length), scalar, name),
                        [scalar, name] => (None, scalar, name),
                        _ => return Err(wrong()),
                    };
                    let of = |name| Scalar::from_name(name).ok_or_else(wrong);
                    let element = elements.last_mut().ok_or_else(wrong)?;
                    element.properties.push(Property {
                        name: name.to_owned(),
                        list: list.map(of).transpose()?,
                        scalar: of(scalar)?,
                    });
                }
                ["end_header"] => break,
                _ => return Err(wrong()),
            }
        }
        Ok(Self {
            format: format.ok_or("the header has no format")?,
            elements,
            body_at: at,
            offset,
        })
    }
}
