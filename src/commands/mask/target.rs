//! Where masks and the pictures to look at go.

use crate::exit::Failure;
use crate::store::create_folder;
use rilievo_io::{Preview, write_mask, write_preview_png};
use rilievo_scene::{LinearImage, Mask};
use std::path::{Path, PathBuf};

/// Longer side of the pictures to look at.
const OVERLAY_SIDE_PX: usize = 1600;

/// Brightness of what the mask leaves out, in the pictures.
const OUTSIDE: f32 = 0.25;

/// Linear red of the outline.
const OUTLINE: [f32; 3] = [1.0, 0.05, 0.02];

/// Where masks and the pictures to look at go.
pub struct Target {
    /// Folder of masks.
    pub masks: PathBuf,
    /// Folder of pictures to look at.
    pub overlays: PathBuf,
}

impl Target {
    /// The file of a photo's mask.
    pub fn mask(&self, name: &str) -> PathBuf {
        self.masks.join(format!("{name}.png"))
    }

    /// Writes a photo's mask and its picture.
    pub fn write(&self, name: &str, image: &LinearImage, mask: &Mask) -> Result<(), Failure> {
        // Made only now, so that nothing is left where no mask is found.
        for folder in [&self.masks, &self.overlays] {
            create_folder(folder)?;
        }
        write_mask(&self.mask(name), mask)?;
        let overlay = overlay(image, mask);
        let picture = self.overlays.join(format!("{name}.png"));
        write_preview_png(&picture, Preview::Linear(&overlay), OVERLAY_SIDE_PX)?;
        Ok(())
    }
}

/// `masks-overlays` beside `masks`: among the masks, the pictures would be taken for masks.
pub fn beside(masks: &Path, ending: &str) -> PathBuf {
    let mut name = masks.file_name().unwrap_or_default().to_os_string();
    name.push(ending);
    masks.with_file_name(name)
}

/// The photo in colours, darkened outside the mask, with its outline.
fn overlay(image: &LinearImage, mask: &Mask) -> LinearImage {
    let mut picture = LinearImage::filled(image.width, image.height, 3, 0.0);
    // As wide as a line of the picture that is shown.
    let reach = (image.width.max(image.height) / OVERLAY_SIDE_PX) as isize + 1;
    for y in 0..image.height {
        for x in 0..image.width {
            let inside = *mask.at(x, y);
            let (px, py) = (x as isize, y as isize);
            let on_outline = inside
                && [(reach, 0), (-reach, 0), (0, reach), (0, -reach)]
                    .iter()
                    .any(|(dx, dy)| !mask.contains(px + dx, py + dy));
            let light = if inside { 1.0 } else { OUTSIDE };
            let from = image.pixel(x, y);
            let to = picture.pixel_mut(x, y);
            for (channel, value) in to.iter_mut().enumerate() {
                *value = light * from[channel.min(image.channels - 1)];
            }
            if on_outline {
                to.copy_from_slice(&OUTLINE);
            }
        }
    }
    picture
}
