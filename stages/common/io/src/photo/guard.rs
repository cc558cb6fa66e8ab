//! Decoders' panics as refusals.
//!
//! The decoders' own checks are good, but they read whatever people's disks hold: a defect in one
//! of them must cost one photo, not the run.

use crate::error::IoError;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

thread_local! {
    /// Decoders at work in this thread.
    static DEPTH: Cell<usize> = const { Cell::new(0) };
}

/// Whether this thread runs a decoder whose panic will be caught and returned as a refusal of its
/// file. A program's panic hook asks it, to print nothing then.
pub fn decoder_is_guarded() -> bool {
    DEPTH.get() > 0
}

struct Guard;

impl Drop for Guard {
    fn drop(&mut self) {
        DEPTH.set(DEPTH.get() - 1);
    }
}

/// What a decoder returns; a panic in it is a refusal.
pub(crate) fn guarded<T>(
    path: &Path,
    decode: impl FnOnce() -> Result<T, IoError>,
) -> Result<T, IoError> {
    DEPTH.set(DEPTH.get() + 1);
    let guard = Guard;
    // What a decoder leaves behind half done, nobody looks at: it borrows the file's bytes alone.
    let decoded = catch_unwind(AssertUnwindSafe(decode));
    drop(guard);
    decoded.unwrap_or_else(|_| {
        let reason = "the file is damaged (its decoder failed)";
        Err(IoError::input(path, reason))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_a_refusal_and_known_as_one_while_it_happens() {
        let mut seen = false;
        let error = guarded(Path::new("a.jpg"), || -> Result<(), IoError> {
            seen = decoder_is_guarded();
            panic!("of a decoder")
        })
        .unwrap_err();
        assert!(seen && !decoder_is_guarded());
        assert!(error.to_string().starts_with("a.jpg: "), "{error}");
    }
}
