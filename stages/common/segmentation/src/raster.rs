//! Distances and regions of masks, by the library.

use opencv::core::{self, Mat};
use opencv::imgproc;
use opencv::prelude::*;
use rilievo_scene::{Mask, Raster};

/// Distance of every pixel from the nearest one that is set, pixels; all far away where none is.
pub(crate) fn distance_from(set: &Mask) -> opencv::Result<Raster<f32>> {
    let far = (set.width + set.height) as f32;
    if set.count() == 0 {
        return Ok(Raster::filled(set.width, set.height, far));
    }
    let zero_where_set: Vec<u8> = set.data.iter().map(|&is| u8::from(!is)).collect();
    let [width, height] = [set.width as i32, set.height as i32];
    let source = Mat::new_rows_cols_with_data(height, width, &zero_where_set[..])?;
    let mut distance = Mat::default();
    imgproc::distance_transform(
        &source,
        &mut distance,
        imgproc::DIST_L2,
        imgproc::DIST_MASK_5,
        core::CV_32F,
    )?;
    Ok(Raster {
        width: set.width,
        height: set.height,
        data: distance.data_typed::<f32>()?.to_vec(),
    })
}

/// Number of the connected region of every pixel, 0 where the mask is not set; and how many there are.
pub(crate) fn regions(mask: &Mask) -> opencv::Result<(Raster<i32>, usize)> {
    let set: Vec<u8> = mask.data.iter().map(|&is| u8::from(is)).collect();
    let [width, height] = [mask.width as i32, mask.height as i32];
    let source = Mat::new_rows_cols_with_data(height, width, &set[..])?;
    let mut labels = Mat::default();
    let num = imgproc::connected_components(&source, &mut labels, 4, core::CV_32S)?;
    let raster = Raster {
        width: mask.width,
        height: mask.height,
        data: labels.data_typed::<i32>()?.to_vec(),
    };
    Ok((raster, num as usize))
}
