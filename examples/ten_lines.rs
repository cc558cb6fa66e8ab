//! Reads photos given as arguments and tells how much light each holds, through the libraries alone:
//! `cargo run --release --example ten_lines -- photos/*.jpg`

use rilievo_io::decode_photo;
use rilievo_photos::{Encoding, linearize};

fn main() -> Result<(), rilievo_io::IoError> {
    for path in std::env::args_os().skip(1) {
        let photo = decode_photo(path.as_ref())?;
        let (image, encoding) = linearize(&photo, Encoding::Auto);
        let mean = image.data.iter().sum::<f32>() / image.data.len().max(1) as f32;
        println!(
            "{}: mean {mean:.4} of white ({encoding:?})",
            photo.file_name
        );
    }
    Ok(())
}
