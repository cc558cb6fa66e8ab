//! The object's mask in one photo.
//!
//! What the object looks like is learnt at its projected points, what everything else looks like where it cannot be and
//! where points of other things are seen. Between the two the graph cut decides. In a first [`sketch`] the object can be
//! no farther than [`REACH`] from its points, and the cut starts with the area that they cover closely; in the
//! [`outline`] what a fifth of the photos' sketches leave out cannot be the object's, and what nearly all of them have may
//! be, also beyond that reach.

use crate::consensus::{Consensus, Sketch, small_pixel};
use crate::cut::{Label, Models};
use crate::error::SegmentationError;
use crate::points::{ObjectPoints, project};
use crate::raster::{distance_from, regions};
use nalgebra::{Point2, Point3};
use opencv::core::Vec3b;
use rilievo_numerics::robust::quantile;
use rilievo_scene::srgb::encode_byte;
use rilievo_scene::{LinearImage, Mask, PosedView, Raster};

/// Longer side of the image that is cut first, and of the one on which the border is drawn again, pixels.
const SIDE_PX: [usize; 2] = [640, 1600];
/// Rounds of cutting and learning on either.
const ROUNDS: [i32; 2] = [3, 2];
/// Distance from the object's projected points beyond which nothing is the object's, as a share of its extent.
const REACH: f64 = 0.12;
/// Gaps between points up to which the area between them is rather the object's, as a share of its extent.
const GAP: f64 = 0.05;
/// Distance from a projected point within which the object's appearance is learnt, pixels of the small image; and around
/// a point of another thing.
const NEAR_OBJECT_PX: f32 = 3.0;
const NEAR_OTHER_PX: f32 = 2.0;
/// Fewest points of the object in the frame.
const MIN_NUM_POINTS: usize = 30;
/// Regions smaller than this share of the largest are dropped, holes smaller than this share of it filled.
const MIN_REGION: f64 = 0.01;
const MAX_HOLE: f64 = 0.0005;
/// Half width of the band in which the border is drawn again, pixels of the small image.
const BAND_PX: f32 = 3.0;
/// Share of the photos, or number, that may see a place off the object, so that it may be the object's, and so that it
/// rather is. Beside the object a place is off it in about a quarter of the photos of a ring.
const MAX_OFF_POSSIBLE: (f64, usize) = (0.2, 1);
const MAX_OFF_LIKELY: (f64, usize) = (0.15, 0);
/// Brightness of the photos' brightest hundredth when they are encoded in 8 bits.
const BRIGHT: f32 = 0.8;

/// The object in a photo.
#[derive(Clone, Debug)]
pub struct Outline {
    /// Its mask, of the photo's size.
    pub mask: Mask,
    /// The same on the small image.
    pub sketch: Sketch,
    /// Share of the object's points that project into the mask: all do, if it is whole.
    pub inside: f64,
    /// Share of the mask that lies near a projected point of the object.
    pub covered: f64,
}

/// What is known of a photo before anything is cut.
struct Prepared {
    reduction: usize,
    small: Raster<Vec3b>,
    /// Pixels of the photo with a point of the object.
    object_pixels: Vec<Point2<f64>>,
    /// The same on the small image.
    on_object: Mask,
    /// Distances on the small image from points of the object, from these and its feet, and from other things.
    from_own: Raster<f32>,
    from_object: Raster<f32>,
    from_others: Raster<f32>,
    /// Pixels of the object's extent on the small image.
    extent: f64,
}

impl Prepared {
    fn new(
        points: &ObjectPoints,
        index: usize,
        view: &PosedView,
        image: &LinearImage,
    ) -> Result<Self, SegmentationError> {
        let reduction = image.width.max(image.height).div_ceil(SIDE_PX[0]);
        let small = reduced(image, reduction);
        let size = (small.width, small.height);
        let onto = |pixels: &[Point2<f64>]| onto_reduced(pixels, reduction, size);
        let projected = |points: &[Point3<f64>]| -> Vec<Point2<f64>> {
            points.iter().filter_map(|p| project(view, p)).collect()
        };
        let object_pixels = projected(&points.object);
        if object_pixels.len() < MIN_NUM_POINTS {
            return Err(not_in(view));
        }
        let mut standing = object_pixels.clone();
        standing.extend(projected(&points.feet));
        let mut others = points.other_pixels[index].clone();
        others.extend(projected(&points.beside));
        let on_object = onto(&object_pixels);
        Ok(Self {
            extent: extent(&object_pixels) / reduction as f64,
            from_own: distance_from(&on_object)?,
            from_object: distance_from(&onto(&standing))?,
            from_others: distance_from(&onto(&others))?,
            on_object,
            object_pixels,
            small,
            reduction,
        })
    }

    fn gap(&self) -> f32 {
        (GAP * self.extent) as f32
    }

    /// Labels of the small image, where a pixel that is neither sure is rather the object's if `perhaps` says so.
    fn labels(
        &self,
        is_possible: impl Fn(usize, usize) -> bool,
        perhaps: impl Fn(usize, usize) -> bool,
    ) -> Raster<u8> {
        let label = |x: usize, y: usize| {
            if *self.from_others.at(x, y) <= NEAR_OTHER_PX || !is_possible(x, y) {
                Label::Other
            } else if *self.on_object.at(x, y) {
                Label::Object
            } else if perhaps(x, y) {
                Label::PerhapsObject
            } else {
                Label::PerhapsOther
            }
        };
        Raster::from_fn(self.small.width, self.small.height, |x, y| {
            label(x, y) as u8
        })
    }

    /// The cut with models that are learnt from what is sure and from the object's points' surroundings.
    fn cut(
        &self,
        labels: &Raster<u8>,
        view: &PosedView,
    ) -> Result<(Mask, Models), SegmentationError> {
        let (mut pixels, mut is_object) = (Vec::new(), Vec::new());
        for y in 0..self.small.height {
            for x in 0..self.small.width {
                let other = *labels.at(x, y) == Label::Other as u8;
                if other || *self.from_own.at(x, y) <= NEAR_OBJECT_PX {
                    pixels.push(*self.small.at(x, y));
                    is_object.push(!other);
                }
            }
        }
        if !is_object.contains(&false) || !is_object.contains(&true) {
            return Err(not_in(view));
        }
        let mut models = Models::learn(&pixels, &is_object)?;
        let cut = models.cut(&self.small, labels, ROUNDS[0])?;
        Ok((tidied(&cut, &self.on_object)?, models))
    }
}

fn not_in(view: &PosedView) -> SegmentationError {
    SegmentationError::NotInPhoto {
        photo: view.file_name.clone(),
    }
}

/// A first cut of one photo by itself; `index` is the view's number.
///
/// # Errors
/// [`SegmentationError::NotInPhoto`], [`SegmentationError::OpenCv`].
pub fn sketch(
    points: &ObjectPoints,
    index: usize,
    view: &PosedView,
    image: &LinearImage,
) -> Result<Sketch, SegmentationError> {
    let prepared = Prepared::new(points, index, view, image)?;
    let (reach, gap) = ((REACH * prepared.extent) as f32, prepared.gap());
    let (width, height) = (prepared.small.width, prepared.small.height);
    let not_close = Mask::from_fn(width, height, |x, y| *prepared.from_object.at(x, y) > gap);
    let inwards = distance_from(&not_close)?;
    let labels = prepared.labels(
        |x, y| *prepared.from_object.at(x, y) <= reach,
        |x, y| *inwards.at(x, y) > 0.9 * gap,
    );
    let (mask, _) = prepared.cut(&labels, view)?;
    Ok(Sketch {
        mask,
        reduction: prepared.reduction,
    })
}

/// The object in one photo, given what all photos' sketches say together, where they are enough.
///
/// # Errors
/// As of [`sketch`].
pub fn outline(
    points: &ObjectPoints,
    index: usize,
    view: &PosedView,
    image: &LinearImage,
    (own, consensus): (&Sketch, Option<&Consensus>),
) -> Result<Outline, SegmentationError> {
    let prepared = Prepared::new(points, index, view, image)?;
    let (possible, likely) = match consensus {
        Some(consensus) => consensus
            .seen_by(view, own, [MAX_OFF_POSSIBLE, MAX_OFF_LIKELY])?
            .into(),
        None => (
            Mask::filled(prepared.small.width, prepared.small.height, true),
            own.mask.clone(),
        ),
    };
    let reach = (REACH * prepared.extent) as f32;
    // Beyond the reach of its points the sketch could not look; there nearly all others have to agree.
    let is_near = |x: usize, y: usize| *prepared.from_object.at(x, y) <= reach;
    let labels = prepared.labels(
        |x, y| *likely.at(x, y) || *possible.at(x, y) && is_near(x, y),
        |x, y| *own.mask.at(x, y) || *likely.at(x, y) && !is_near(x, y),
    );
    let (cut, mut models) = prepared.cut(&labels, view)?;
    let reduction = prepared.reduction;
    let fine = image.width.max(image.height).div_ceil(SIDE_PX[1]);
    let mask = if fine < reduction {
        let drawn = drawn_again(
            (&cut, &prepared.on_object),
            reduction,
            image,
            fine,
            &mut models,
        )?;
        enlarged(&drawn, fine, image)
    } else {
        enlarged(&cut, reduction, image)
    };
    if mask.count() == 0 {
        return Err(not_in(view));
    }
    let inside = prepared.object_pixels.iter().filter(|p| {
        let (x, y) = (p.x.round() as isize, p.y.round() as isize);
        mask.contains(x, y)
    });
    let is_near = |k: usize| prepared.from_own.data[k] <= reach;
    let near = (0..cut.data.len()).filter(|&k| cut.data[k] && is_near(k));
    Ok(Outline {
        inside: inside.count() as f64 / prepared.object_pixels.len() as f64,
        covered: near.count() as f64 / cut.count().max(1) as f64,
        mask,
        sketch: Sketch {
            mask: cut,
            reduction,
        },
    })
}

/// The longer side of the points' rectangle, outliers left out, pixels.
fn extent(pixels: &[Point2<f64>]) -> f64 {
    let side = |k: usize| {
        let mut values: Vec<f64> = pixels.iter().map(|p| p[k]).collect();
        let low = quantile(&mut values, 0.01).unwrap_or(0.0);
        quantile(&mut values, 0.99).unwrap_or(0.0) - low
    };
    side(0).max(side(1))
}

/// Pixels of a photo, set on its reduced image.
fn onto_reduced(pixels: &[Point2<f64>], reduction: usize, size: (usize, usize)) -> Mask {
    let mut mask = Mask::filled(size.0, size.1, false);
    for p in pixels {
        if let Some((x, y)) = small_pixel(p, reduction, size) {
            *mask.at_mut(x, y) = true;
        }
    }
    mask
}

/// The photo in 8 bits, means over squares of `reduction` pixels, those at the right and lower edge over what there is.
fn reduced(image: &LinearImage, reduction: usize) -> Raster<Vec3b> {
    let (width, height) = (
        image.width.div_ceil(reduction),
        image.height.div_ceil(reduction),
    );
    let mean = |x: usize, y: usize| {
        let columns = x * reduction..((x + 1) * reduction).min(image.width);
        let rows = y * reduction..((y + 1) * reduction).min(image.height);
        let num = (columns.len() * rows.len()) as f32;
        let mut sum = [0.0_f32; 3];
        for row in rows {
            for column in columns.clone() {
                let pixel = image.pixel(column, row);
                for (channel, sum) in sum.iter_mut().enumerate() {
                    *sum += pixel[channel.min(image.channels - 1)];
                }
            }
        }
        sum.map(|v| v / num)
    };
    let means = Raster::from_fn(width, height, mean);
    let mut brightest: Vec<f64> = means
        .data
        .iter()
        .map(|p| f64::from(p[0].max(p[1]).max(p[2])))
        .collect();
    let bright = quantile(&mut brightest, 0.99).unwrap_or(1.0).max(1e-6) as f32;
    let gain = BRIGHT / bright;
    Raster {
        width,
        height,
        data: means
            .data
            .iter()
            .map(|p| Vec3b::from(p.map(|v| encode_byte(gain * v))))
            .collect(),
    }
}

/// The regions with points of the object, without specks and pinholes.
fn tidied(cut: &Mask, on_object: &Mask) -> Result<Mask, SegmentationError> {
    let (number, num_regions) = regions(cut)?;
    let mut area = vec![0_usize; num_regions];
    let mut has_points = vec![false; num_regions];
    for (k, &region) in number.data.iter().enumerate() {
        area[region as usize] += 1;
        has_points[region as usize] |= on_object.data[k];
    }
    let largest = area.iter().skip(1).copied().max().unwrap_or(0) as f64;
    let is_kept = |region: i32| {
        let region = region as usize;
        region > 0 && has_points[region] && area[region] as f64 >= MIN_REGION * largest
    };
    let kept = Mask {
        width: cut.width,
        height: cut.height,
        data: number.data.iter().map(|&region| is_kept(region)).collect(),
    };
    let (number, num_regions) = regions(&kept.clone().inverted())?;
    let mut area = vec![0_usize; num_regions];
    number
        .data
        .iter()
        .for_each(|&region| area[region as usize] += 1);
    let is_pinhole =
        |region: i32| region > 0 && (area[region as usize] as f64) < MAX_HOLE * largest;
    Ok(Mask::from_fn(kept.width, kept.height, |x, y| {
        *kept.at(x, y) || is_pinhole(*number.at(x, y))
    }))
}

/// The border drawn again on a larger image, in a band around where it was.
fn drawn_again(
    (cut, on_object): (&Mask, &Mask),
    reduction: usize,
    image: &LinearImage,
    fine: usize,
    models: &mut Models,
) -> Result<Mask, SegmentationError> {
    let larger = reduced(image, fine);
    let (inwards, outwards) = (distance_from(&cut.clone().inverted())?, distance_from(cut)?);
    let labels = Raster::from_fn(larger.width, larger.height, |x, y| {
        let of = |v: usize| (v * fine + fine / 2) / reduction;
        let (sx, sy) = (of(x).min(cut.width - 1), of(y).min(cut.height - 1));
        let label = match (*inwards.at(sx, sy), *outwards.at(sx, sy)) {
            (depth, _) if depth > BAND_PX => Label::Object,
            // What is thinner than the band is held by its points.
            (depth, _) if depth > 0.0 && *on_object.at(sx, sy) => Label::Object,
            (_, off) if off > BAND_PX => Label::Other,
            (depth, _) if depth > 0.0 => Label::PerhapsObject,
            _ => Label::PerhapsOther,
        };
        label as u8
    });
    let drawn = models.cut(&larger, &labels, ROUNDS[1])?;
    // Regions with sure pixels of the object are as they were; specks in the band are not.
    let sure = Mask::from_fn(larger.width, larger.height, |x, y| {
        *labels.at(x, y) == Label::Object as u8
    });
    tidied(&drawn, &sure)
}

/// A mask of the photo's size, its border between the reduced pixels' centres by bilinear interpolation.
fn enlarged(mask: &Mask, reduction: usize, image: &LinearImage) -> Mask {
    let at = |x: isize, y: isize| {
        let x = x.clamp(0, mask.width as isize - 1) as usize;
        let y = y.clamp(0, mask.height as isize - 1) as usize;
        f64::from(u8::from(*mask.at(x, y)))
    };
    let place = |v: usize| {
        let place = (v as f64 + 0.5) / reduction as f64 - 0.5;
        (place.floor() as isize, place - place.floor())
    };
    Mask::from_fn(image.width, image.height, |x, y| {
        let ((x0, fx), (y0, fy)) = (place(x), place(y));
        let upper = at(x0, y0) * (1.0 - fx) + at(x0 + 1, y0) * fx;
        let lower = at(x0, y0 + 1) * (1.0 - fx) + at(x0 + 1, y0 + 1) * fx;
        upper * (1.0 - fy) + lower * fy >= 0.5
    })
}
