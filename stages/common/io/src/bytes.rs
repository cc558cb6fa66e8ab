//! Binary files with little-endian numbers: every read is checked against the end, and every
//! refusal names the file and the place.

use crate::error::IoError;
use std::path::Path;

/// Bytes with a position; every read is checked against the end.
pub(crate) struct Bytes<'a> {
    file: &'a Path,
    data: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    pub(crate) fn new(file: &'a Path, data: &'a [u8]) -> Self {
        Self { file, data, at: 0 }
    }

    pub(crate) fn take<const N: usize>(&mut self) -> Result<[u8; N], IoError> {
        let piece = self
            .data
            .get(self.at..self.at.saturating_add(N))
            .and_then(|piece| <[u8; N]>::try_from(piece).ok())
            .ok_or_else(|| {
                IoError::input(
                    self.file,
                    format!("ends too early, after {} bytes", self.data.len()),
                )
            })?;
        self.at += N;
        Ok(piece)
    }

    pub(crate) fn refuse(&self, reason: impl std::fmt::Display) -> IoError {
        IoError::input(self.file, format!("at byte {}: {reason}", self.at))
    }

    pub(crate) fn u8(&mut self) -> Result<u8, IoError> {
        Ok(self.take::<1>()?[0])
    }

    pub(crate) fn u32(&mut self) -> Result<u32, IoError> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    pub(crate) fn u64(&mut self) -> Result<u64, IoError> {
        Ok(u64::from_le_bytes(self.take()?))
    }

    pub(crate) fn number(&mut self) -> Result<f64, IoError> {
        let value = f64::from_le_bytes(self.take()?);
        if value.is_finite() {
            Ok(value)
        } else {
            Err(self.refuse(format!("{value} is not a finite number")))
        }
    }

    pub(crate) fn numbers<const N: usize>(&mut self) -> Result<[f64; N], IoError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.number()?;
        }
        Ok(values)
    }

    pub(crate) fn size(&mut self) -> Result<usize, IoError> {
        let value = self.u64()?;
        usize::try_from(value).map_err(|_| self.refuse(format!("{value} is too large")))
    }

    pub(crate) fn name(&mut self) -> Result<String, IoError> {
        let mut bytes = Vec::new();
        loop {
            match self.u8()? {
                0 => break,
                byte => bytes.push(byte),
            }
        }
        String::from_utf8(bytes).map_err(|_| self.refuse("the image's name is no text"))
    }

    pub(crate) fn u16(&mut self) -> Result<u16, IoError> {
        Ok(u16::from_le_bytes(self.take()?))
    }

    /// Goes on at a place, which may be past the end: the next read is refused then.
    pub(crate) fn go_to(&mut self, at: usize) {
        self.at = at;
    }

    /// Bytes before the next one.
    pub(crate) fn position(&self) -> usize {
        self.at
    }

    /// The next bytes.
    pub(crate) fn piece(&mut self, length: usize) -> Result<&'a [u8], IoError> {
        let end = self.at.checked_add(length);
        let piece = end
            .and_then(|end| self.data.get(self.at..end))
            .ok_or_else(|| self.refuse(format!("{length} bytes go past the end")))?;
        self.at += length;
        Ok(piece)
    }

    /// A text after its length in bytes (64 bits).
    pub(crate) fn text(&mut self) -> Result<String, IoError> {
        let length = self.size()?;
        let piece = self.piece(length)?;
        String::from_utf8(piece.to_vec()).map_err(|_| self.refuse("a text is none"))
    }
}

/// Appends numbers, little endian.
pub(crate) fn put<'a>(data: &mut Vec<u8>, values: impl IntoIterator<Item = &'a f64>) {
    for value in values {
        data.extend(value.to_le_bytes());
    }
}
