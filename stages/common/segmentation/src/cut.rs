//! The library's graph cut between two models of colour.

use opencv::core::{self, Mat, Rect, Vec3b};
use opencv::imgproc;
use opencv::prelude::*;
use rilievo_scene::{Mask, Raster};

/// What is known of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Label {
    /// Certainly not the object.
    Other = imgproc::GC_BGD as u8,
    /// Certainly the object.
    Object = imgproc::GC_FGD as u8,
    /// Rather not the object.
    PerhapsOther = imgproc::GC_PR_BGD as u8,
    /// Rather the object.
    PerhapsObject = imgproc::GC_PR_FGD as u8,
}

/// Distributions of colour, of the object and of everything else: five Gaussians each.
pub(crate) struct Models {
    other: Mat,
    object: Mat,
}

impl Models {
    /// From pixels that are known to be either. There must be some of both.
    pub fn learn(pixels: &[Vec3b], is_object: &[bool]) -> opencv::Result<Self> {
        let labels = is_object.iter().map(|&is| match is {
            true => Label::Object as u8,
            false => Label::Other as u8,
        });
        let mut models = Self {
            other: Mat::default(),
            object: Mat::default(),
        };
        let image = Raster {
            width: pixels.len(),
            height: 1,
            data: pixels.to_vec(),
        };
        let labels = Raster {
            width: pixels.len(),
            height: 1,
            data: labels.collect(),
        };
        models.run(&image, &labels, 1, imgproc::GC_INIT_WITH_MASK)?;
        Ok(models)
    }

    /// Cuts an image where the models differ and the image has edges; the models learn from the result, `rounds` times.
    pub fn cut(
        &mut self,
        image: &Raster<Vec3b>,
        labels: &Raster<u8>,
        rounds: i32,
    ) -> opencv::Result<Mask> {
        let first = self.run(image, labels, 1, imgproc::GC_EVAL_FREEZE_MODEL)?;
        let last = self.run(image, &first, rounds, imgproc::GC_EVAL)?;
        let is_object = |&l: &u8| l == Label::Object as u8 || l == Label::PerhapsObject as u8;
        Ok(Mask {
            width: image.width,
            height: image.height,
            data: last.data.iter().map(is_object).collect(),
        })
    }

    fn run(
        &mut self,
        image: &Raster<Vec3b>,
        labels: &Raster<u8>,
        rounds: i32,
        mode: i32,
    ) -> opencv::Result<Raster<u8>> {
        let [width, height] = [image.width as i32, image.height as i32];
        let pixels = Mat::new_rows_cols_with_data(height, width, &image.data[..])?;
        let mut mask =
            Mat::new_rows_cols_with_data(height, width, &labels.data[..])?.try_clone()?;
        // The library draws the starts of its clusters from a generator of the thread.
        core::set_rng_seed(1)?;
        let everywhere = Rect::new(0, 0, width, height);
        let (other, object) = (&mut self.other, &mut self.object);
        imgproc::grab_cut(&pixels, &mut mask, everywhere, other, object, rounds, mode)?;
        Ok(Raster {
            width: image.width,
            height: image.height,
            data: mask.data_typed::<u8>()?.to_vec(),
        })
    }
}
