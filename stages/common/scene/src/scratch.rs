//! Room beside the memory for what a stage works on: a large set's images and maps are put there and read back in
//! parts, so that the memory in use does not grow with their number.

use std::fmt::Debug;
use std::io;
use std::sync::{PoisonError, RwLock};

/// Why something could not be put aside or read back.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("working data could not be put aside: {reason}")]
pub struct ScratchError {
    /// What went wrong, and where.
    pub reason: String,
}

impl From<io::Error> for ScratchError {
    fn from(error: io::Error) -> Self {
        Self {
            reason: error.to_string(),
        }
    }
}

/// Bytes at numbered places, readable and writable by many threads at once where they do not overlap.
pub trait Room: Send + Sync + Debug {
    /// Writes bytes from a place on; the room grows as needed.
    ///
    /// # Errors
    /// When there is no space left.
    fn write_at(&self, bytes: &[u8], place: u64) -> Result<(), ScratchError>;

    /// Fills `bytes` from a place on; bytes that were never written are an error.
    ///
    /// # Errors
    /// When they cannot be read.
    fn read_at(&self, bytes: &mut [u8], place: u64) -> Result<(), ScratchError>;
}

/// Gives room, which is free again when it is dropped.
pub trait Scratch: Sync {
    /// A new, empty room.
    ///
    /// # Errors
    /// When there is none to be had.
    fn room(&self) -> Result<Box<dyn Room>, ScratchError>;
}

/// Room in memory, for small sets and for callers without files.
#[derive(Clone, Copy, Debug, Default)]
pub struct MemoryScratch;

impl Scratch for MemoryScratch {
    fn room(&self) -> Result<Box<dyn Room>, ScratchError> {
        Ok(Box::new(MemoryRoom::default()))
    }
}

#[derive(Debug, Default)]
struct MemoryRoom(RwLock<Vec<u8>>);

impl Room for MemoryRoom {
    fn write_at(&self, bytes: &[u8], place: u64) -> Result<(), ScratchError> {
        let mut all = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let (from, to) = (place as usize, place as usize + bytes.len());
        if all.len() < to {
            all.resize(to, 0);
        }
        all[from..to].copy_from_slice(bytes);
        Ok(())
    }

    fn read_at(&self, bytes: &mut [u8], place: u64) -> Result<(), ScratchError> {
        let all = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let (from, to) = (place as usize, place as usize + bytes.len());
        let found = all.get(from..to).ok_or_else(|| ScratchError {
            reason: format!("bytes {from} to {to} were never written"),
        })?;
        bytes.copy_from_slice(found);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back_from_their_place_and_others_are_refused() -> Result<(), ScratchError> {
        let room = MemoryScratch.room()?;
        room.write_at(&[7, 8, 9], 4)?;
        room.write_at(&[1, 2], 0)?;
        let mut found = [0; 4];
        room.read_at(&mut found, 3)?;
        assert_eq!(found, [0, 7, 8, 9]);
        assert!(room.read_at(&mut found, 4).is_err());
        Ok(())
    }
}
