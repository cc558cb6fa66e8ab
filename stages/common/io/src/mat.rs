//! MATLAB's MAT files of version 5 (`save -v7` and before): numeric arrays by name.
//!
//! After a header of 128 bytes come elements of a tag (kind, number of bytes) and data, filled up
//! to eight bytes; up to four bytes of data may stand in the tag itself. An array is an element of
//! elements: flags, dimensions, name, values by columns. Elements may be compressed (zlib). Arrays
//! of other classes (text, structures, sparse) are passed over.
//!
//! Source: MathWorks, MAT-File Format, chapter 1.

use crate::bytes::Bytes;
use crate::error::IoError;
use crate::files::read_regular;
use flate2::read::ZlibDecoder;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// Bytes of the file's header.
const HEADER: usize = 128;

/// Kinds of elements.
const INT8: u32 = 1;
const INT32: u32 = 5;
const UINT32: u32 = 6;
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;

/// Classes of arrays that hold numbers: double to unsigned integers of 64 bits.
const NUMERIC: std::ops::RangeInclusive<u32> = 6..=15;

/// No file of a photo's normals needs more, compressed or not; a damaged one may claim it, in one
/// array or in many.
const MAX_BYTES: u64 = 1 << 28;

/// Values that all of it can be.
const MAX_VALUES: usize = (MAX_BYTES / 4) as usize;

/// An array of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct MatArray {
    /// Rows, columns, and further sizes.
    pub dims: Vec<usize>,
    /// Values, the first index fastest.
    pub values: Vec<f64>,
}

impl MatArray {
    /// The `R x C` matrix that it is, by rows; `None` of another size or without finite values.
    pub fn matrix<const R: usize, const C: usize>(&self) -> Option<[[f64; C]; R]> {
        let fits = self.dims == [R, C] && self.values.iter().all(|v| v.is_finite());
        let at = |row: usize, column: usize| self.values[column * R + row];
        fits.then(|| std::array::from_fn(|r| std::array::from_fn(|c| at(r, c))))
    }
}

/// Reads the numeric arrays whose names are `wanted`.
///
/// # Errors
/// When the file cannot be read, is of another version, or is damaged.
pub fn read_mat(
    path: &Path,
    wanted: impl Fn(&str) -> bool,
) -> Result<BTreeMap<String, MatArray>, IoError> {
    let data = read_regular(path)?;
    if data.starts_with(b"MATLAB 7.3") || data.starts_with(b"\x89HDF") {
        return Err(
            IoError::input(path, "MAT files of version 7.3 (HDF5) cannot be read")
                .with_hint("save it in MATLAB with -v7"),
        );
    }
    match data.get(HEADER - 4..HEADER) {
        Some([0, 1, b'I', b'M']) => {}
        Some([1, 0, b'M', b'I']) => {
            return Err(IoError::input(path, "its numbers are big endian")
                .with_hint("load and save it once on a present-day machine"));
        }
        _ => return Err(IoError::input(path, "is no MAT file of version 5")),
    }
    let mut arrays = BTreeMap::new();
    let mut left = MAX_BYTES;
    let mut file = Bytes::new(path, &data);
    file.go_to(HEADER);
    while file.position() < data.len() {
        let (kind, piece) = element(&mut file)?;
        let inflated;
        let (kind, piece) = if kind == COMPRESSED {
            inflated = inflate(path, piece, &mut left)?;
            element(&mut Bytes::new(path, &inflated))?
        } else {
            (kind, piece)
        };
        if kind != MATRIX {
            continue;
        }
        if let Some((name, array)) = matrix(path, piece, &wanted)? {
            arrays.insert(name, array);
        }
    }
    Ok(arrays)
}

/// An inflated element, within the bytes that are left to the file.
fn inflate(path: &Path, piece: &[u8], left: &mut u64) -> Result<Vec<u8>, IoError> {
    let mut whole = Vec::new();
    let mut decoder = ZlibDecoder::new(piece).take(*left + 1);
    decoder
        .read_to_end(&mut whole)
        .map_err(|error| IoError::input(path, format!("a compressed array is damaged: {error}")))?;
    *left = left.checked_sub(whole.len() as u64).ok_or_else(|| {
        let megabytes = MAX_BYTES >> 20;
        IoError::input(
            path,
            format!("its compressed arrays hold more than {megabytes} MB"),
        )
    })?;
    Ok(whole)
}

/// Kind and data of the next element; what fills it up is passed over.
fn element<'a>(bytes: &mut Bytes<'a>) -> Result<(u32, &'a [u8]), IoError> {
    let first = bytes.u32()?;
    if first >> 16 != 0 {
        let length = (first >> 16) as usize;
        if length > 4 {
            return Err(bytes.refuse(format!("a small element of {length} bytes")));
        }
        return Ok((first & 0xFFFF, &bytes.piece(4)?[..length]));
    }
    let length = bytes.u32()? as usize;
    let piece = bytes.piece(length)?;
    if first != COMPRESSED {
        // The last element may lack its filling; then the position is past the end, as it should.
        bytes.go_to(bytes.position() + (8 - length % 8) % 8);
    }
    Ok((first, piece))
}

/// Name and values of an array; `None` where it is not wanted or not of numbers.
fn matrix(
    path: &Path,
    piece: &[u8],
    wanted: &impl Fn(&str) -> bool,
) -> Result<Option<(String, MatArray)>, IoError> {
    let mut bytes = Bytes::new(path, piece);
    let refuse = |reason: String| IoError::input(path, reason);
    let (UINT32, [class, ..]) = element(&mut bytes)? else {
        return Err(refuse("an array has no flags".to_owned()));
    };
    let (INT32, sizes) = element(&mut bytes)? else {
        return Err(refuse("an array has no dimensions".to_owned()));
    };
    let dims: Vec<usize> = numbers(INT32, sizes)
        .unwrap_or_default()
        .iter()
        .map(|&size| size as usize)
        .collect();
    let (INT8, name) = element(&mut bytes)? else {
        return Err(refuse("an array has no name".to_owned()));
    };
    let name = String::from_utf8_lossy(name).into_owned();
    if !NUMERIC.contains(&u32::from(*class)) || !wanted(&name) {
        return Ok(None);
    }
    let (kind, stored) = element(&mut bytes)?;
    let expected = dims
        .iter()
        .try_fold(1_usize, |n, &size| n.checked_mul(size))
        .filter(|&num| num <= MAX_VALUES)
        .ok_or_else(|| refuse(format!("{name} claims {dims:?} values")))?;
    // A value is stored in one to eight bytes.
    if !(expected..=8 * expected).contains(&stored.len()) {
        let found = stored.len();
        return Err(refuse(format!("{name} has {found} bytes for {dims:?}")));
    }
    let values = numbers(kind, stored)
        .ok_or_else(|| refuse(format!("{name} holds values of unknown kind {kind}")))?;
    if expected != values.len() {
        let found = values.len();
        return Err(refuse(format!("{name} has {found} values for {dims:?}")));
    }
    Ok(Some((name, MatArray { dims, values })))
}

/// Values as stored, little endian; small ones may be stored in fewer bits than their class has.
fn numbers(kind: u32, stored: &[u8]) -> Option<Vec<f64>> {
    fn of<const N: usize>(stored: &[u8], value: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        let (pieces, _) = stored.as_chunks::<N>();
        pieces.iter().map(|&piece| value(piece)).collect()
    }
    Some(match kind {
        INT8 => of(stored, |b| f64::from(i8::from_le_bytes(b))),
        2 => of(stored, |b| f64::from(u8::from_le_bytes(b))),
        3 => of(stored, |b| f64::from(i16::from_le_bytes(b))),
        4 => of(stored, |b| f64::from(u16::from_le_bytes(b))),
        INT32 => of(stored, |b| f64::from(i32::from_le_bytes(b))),
        UINT32 => of(stored, |b| f64::from(u32::from_le_bytes(b))),
        7 => of(stored, |b| f64::from(f32::from_le_bytes(b))),
        9 => of(stored, f64::from_le_bytes),
        12 => of(stored, |b| i64::from_le_bytes(b) as f64),
        13 => of(stored, |b| u64::from_le_bytes(b) as f64),
        _ => return None,
    })
}

#[cfg(test)]
pub(crate) mod sample;

#[cfg(test)]
mod tests {
    use super::*;

    fn written(folder: &tempfile::TempDir, parts: &[Vec<u8>]) -> std::path::PathBuf {
        let path = folder.path().join("a.mat");
        std::fs::write(&path, [sample::header(), parts.concat()].concat()).unwrap();
        path
    }

    #[test]
    fn arrays_are_read_by_name_compressed_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let plain = sample::array("K", &[2, 3], &[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        let cube: Vec<f64> = (0..24).map(f64::from).collect();
        let packed = sample::compressed(&sample::array("N", &[2, 3, 4], &cube));
        let other = sample::array("unwanted", &[1, 1], &[7.0]);
        let path = written(&folder, &[plain, packed, other]);
        let arrays = read_mat(&path, |name| name != "unwanted").unwrap();
        assert_eq!(arrays.len(), 2);
        let k = arrays["K"].matrix::<2, 3>();
        assert_eq!(k, Some([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
        assert_eq!(arrays["K"].matrix::<3, 2>(), None);
        assert_eq!(
            (arrays["N"].dims.clone(), &arrays["N"].values),
            (vec![2, 3, 4], &cube)
        );
    }

    /// `scipy.io.savemat` of the row 7, -3 as small elements of one byte each value.
    #[test]
    fn small_elements_and_short_integers_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let small = |kind: u32, data: &[u8]| {
            let mut bytes = (kind | (data.len() as u32) << 16).to_le_bytes().to_vec();
            bytes.extend(data);
            bytes.resize(8, 0);
            bytes
        };
        let dims: Vec<u8> = [1_i32, 2].iter().flat_map(|d| d.to_le_bytes()).collect();
        let parts = [
            sample::element(UINT32, &[6, 0, 0, 0, 0, 0, 0, 0]),
            sample::element(INT32, &dims),
            small(INT8, b"row"),
            small(INT8, &[7, 0xFD]),
        ];
        let path = written(&folder, &[sample::element(MATRIX, &parts.concat())]);
        let arrays = read_mat(&path, |_| true).unwrap();
        assert_eq!(arrays["row"].values, [7.0, -3.0]);
    }

    #[test]
    fn other_versions_and_damage_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mat");
        let refused = |bytes: &[u8], part: &str| {
            std::fs::write(&path, bytes).unwrap();
            let error = read_mat(&path, |_| true).unwrap_err().to_string();
            assert!(error.contains("a.mat") && error.contains(part), "{error}");
        };
        refused(b"MATLAB 7.3 MAT-file", "-v7");
        refused(b"text", "no MAT file");
        let mut big = sample::header();
        big[124..].copy_from_slice(&[1, 0, b'M', b'I']);
        refused(&big, "big endian");
        let whole = sample::array("K", &[2, 2], &[0.0; 4]);
        refused(
            &[sample::header(), whole[..40].to_vec()].concat(),
            "past the end",
        );
        let wrong = sample::array("K", &[2, 3], &[0.0; 4]);
        refused(&[sample::header(), wrong].concat(), "4 values");
        let mut packed = sample::compressed(&whole);
        packed[12] ^= 0x55;
        refused(&[sample::header(), packed].concat(), "compressed");
        // A hundred times three megabytes of zeros.
        let zeros = sample::compressed(&sample::element(2, &vec![0; 3 << 20]));
        let many: Vec<u8> = [sample::header(), zeros.repeat(100)].concat();
        assert!(many.len() < 1 << 20, "{} bytes", many.len());
        refused(&many, "more than 256 MB");
    }
}
