//! MAT files for tests, as MATLAB writes them.

use flate2::{Compression, write::ZlibEncoder};
use std::io::Write;

pub(crate) use rilievo_synthetic::testing::mat_file::{array, element, header};

pub(crate) fn compressed(whole: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(whole).unwrap();
    let packed = encoder.finish().unwrap();
    let mut bytes = super::COMPRESSED.to_le_bytes().to_vec();
    bytes.extend((packed.len() as u32).to_le_bytes());
    bytes.extend(packed);
    bytes
}
