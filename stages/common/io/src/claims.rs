//! What headers claim, checked before memory is asked for: a file of some bytes can claim that it
//! holds gigabytes, and a request for memory that fails ends the process.

/// More pixels than any camera or map has: a header that claims them is damaged.
pub(crate) const MAX_PIXELS: u64 = 1_000_000_000;

/// Most bytes that one byte of a file stands for where the compression is one of Deflate (1032),
/// LZW (some 1400) or of runs (less): an even image of that size is smaller than its file at any of
/// them.
pub(crate) const MAX_EXPANSION: u64 = 4096;

/// The same for wavelets of OpenEXR (PIZ), which store an even block of 32 rows in some 50 bytes.
pub(crate) const MAX_WAVELET_EXPANSION: u64 = 1 << 17;

/// Bytes of pixels that every file may hold, however small it is: its headers are part of it.
const FREE_BYTES: u64 = 1 << 20;

/// Refuses a size that a file of `file_len` bytes cannot hold, or that memory cannot; `width x
/// height` pixels take `bytes_per_px` each, and `copies` of all of them are in memory at once.
pub(crate) fn check(
    (width, height): (u64, u64),
    bytes_per_px: u64,
    copies: u64,
    file_len: usize,
    expansion: u64,
) -> Result<(), String> {
    let num_px = width.saturating_mul(height);
    if num_px > MAX_PIXELS {
        return Err(format!(
            "claims {width} x {height} pixels, more than any photo has"
        ));
    }
    let bytes = num_px.saturating_mul(bytes_per_px);
    if bytes > FREE_BYTES && bytes / expansion > file_len as u64 {
        return Err(format!(
            "claims {width} x {height} pixels, more than its {file_len} bytes can hold"
        ));
    }
    check_memory(bytes.saturating_mul(copies))
        .map_err(|reason| format!("has {width} x {height} pixels, which {reason}"))
}

/// Refuses what memory cannot hold.
pub(crate) fn check_memory(bytes: u64) -> Result<(), String> {
    let fits =
        usize::try_from(bytes).is_ok_and(|bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_ok());
    if fits {
        return Ok(());
    }
    let gigabytes = bytes as f64 * 1e-9;
    Err(format!(
        "need {gigabytes:.1} GB: there is not enough memory"
    ))
}
