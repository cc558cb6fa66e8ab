//! What the outlines of all photos say together of places in space.
//!
//! Whatever belongs to the object lies within its outline in every photo that has it in its frame. A place that most
//! photos see off the object is not the object's, whatever a single photo took it for; and what one photo left out,
//! though the others have it, is looked at again.

use crate::error::SegmentationError;
use crate::points::{ObjectPoints, project};
use crate::raster::distance_from;
use nalgebra::{Point2, Point3, Vector3};
use rilievo_scene::{Mask, PosedView};

/// Cells along the longest side of the box around the object's points, which is this much larger on every side.
const NUM_CELLS: usize = 80;
const MARGIN: f64 = 0.2;
/// Fewest photos that can outvote one.
const MIN_NUM_PHOTOS: usize = 3;
/// Share of the photos that may see a place off the object which belongs to it all the same, of a mask that is to be
/// believed.
const MAX_OFF_BELIEVED: f64 = 0.1;

/// The object in a photo as it was cut at first, on a small image.
#[derive(Clone, Debug)]
pub struct Sketch {
    /// The mask.
    pub mask: Mask,
    /// Pixels of the photo per pixel of the mask.
    pub reduction: usize,
}

impl Sketch {
    /// Its pixel that shows a place; `None` outside the frame.
    fn pixel_of(&self, view: &PosedView, place: &Point3<f64>) -> Option<(usize, usize)> {
        let size = (self.mask.width, self.mask.height);
        small_pixel(&project(view, place)?, self.reduction, size)
    }
}

/// In how many photos' frames a place is, and in how many of them off the object.
#[derive(Clone, Copy, Debug, Default)]
struct Votes {
    seen: usize,
    off: usize,
}

/// The photos' votes on the cells of a box around the object.
#[derive(Debug)]
pub struct Consensus {
    cells: Vec<Point3<f64>>,
    side: f64,
    middle: Point3<f64>,
    votes: Vec<Votes>,
}

impl Consensus {
    /// The cells of a box around points, on which nobody has voted; `None` where the points have no extent.
    fn around(points: &[Point3<f64>]) -> Option<Self> {
        let first = points.first()?;
        let (mut low, mut high) = (first.coords, first.coords);
        for p in points {
            low = low.inf(&p.coords);
            high = high.sup(&p.coords);
        }
        let margin = Vector3::repeat(MARGIN * (high - low).max());
        (low, high) = (low - margin, high + margin);
        let side = (high - low).max() / NUM_CELLS as f64;
        if !(side > 0.0 && side.is_finite()) {
            return None;
        }
        let num = (high - low).map(|v| (v / side).ceil().max(1.0) as usize);
        let mut cells = Vec::with_capacity(num.x * num.y * num.z);
        for z in 0..num.z {
            for y in 0..num.y {
                for x in 0..num.x {
                    let at = [x, y, z].map(|v| (v as f64 + 0.5) * side);
                    cells.push(Point3::from(low + Vector3::from(at)));
                }
            }
        }
        Some(Self {
            votes: vec![Votes::default(); cells.len()],
            cells,
            side,
            middle: Point3::from(0.5 * (low + high)),
        })
    }

    /// From the sketches of views; `None` with too few of them to outvote one.
    ///
    /// # Errors
    /// [`SegmentationError::OpenCv`].
    pub fn of(
        points: &ObjectPoints,
        views: &[PosedView],
        sketches: &[Option<Sketch>],
    ) -> Result<Option<Self>, SegmentationError> {
        let num = sketches.iter().flatten().count();
        let cells = Self::around(&points.object).filter(|_| num >= MIN_NUM_PHOTOS);
        let Some(mut consensus) = cells else {
            return Ok(None);
        };
        for (view, sketch) in views.iter().zip(sketches) {
            let Some(sketch) = sketch else { continue };
            let near = consensus.widened(view, sketch)?;
            for (cell, votes) in consensus.cells.iter().zip(&mut consensus.votes) {
                if let Some((x, y)) = sketch.pixel_of(view, cell) {
                    votes.seen += 1;
                    votes.off += usize::from(!*near.at(x, y));
                }
            }
        }
        Ok(Some(consensus))
    }

    /// Where places appear in a view that at most a share of the photos, or a number of them, see off the object, on the
    /// sketch's image; for each of several such bounds.
    ///
    /// # Errors
    /// [`SegmentationError::OpenCv`].
    pub fn seen_by<const N: usize>(
        &self,
        view: &PosedView,
        sketch: &Sketch,
        max_off: [(f64, usize); N],
    ) -> Result<[Mask; N], SegmentationError> {
        self.projected(view, sketch, |votes, _| {
            max_off.map(|(share, num)| {
                let allowed = num.max((share * votes.seen as f64) as usize);
                votes.seen >= MIN_NUM_PHOTOS && votes.off <= allowed
            })
        })
    }

    /// Share of a view's mask that lies within the outlines of the others, where there are enough
    /// of them; `None` where there are nowhere. `sketch` is the one that voted.
    ///
    /// # Errors
    /// [`SegmentationError::OpenCv`].
    pub fn agreement(
        &self,
        view: &PosedView,
        sketch: &Sketch,
    ) -> Result<Option<f64>, SegmentationError> {
        let near = self.widened(view, sketch)?;
        let [in_box, is_seen, others] = self.projected(view, sketch, |votes, (x, y)| {
            let is_seen = votes.seen >= MIN_NUM_PHOTOS;
            let off = votes.off - usize::from(!*near.at(x, y));
            let is_within = off as f64 <= MAX_OFF_BELIEVED * (votes.seen - 1) as f64;
            [true, is_seen, is_seen && is_within]
        })?;
        // Off the box around the object nothing is the object's, whoever sees it.
        let counts = |k: &usize| is_seen.data[*k] || !in_box.data[*k];
        let own = (0..sketch.mask.data.len()).filter(|&k| sketch.mask.data[k]);
        let own = own.filter(counts);
        let (num, within) = own.fold((0, 0), |(num, within), k| {
            (num + 1, within + usize::from(others.data[k]))
        });
        Ok((num > 0).then(|| within as f64 / f64::from(num)))
    }

    /// Cells that fulfil each of several conditions, on a view's small image, each cell as wide as it appears.
    fn projected<const N: usize>(
        &self,
        view: &PosedView,
        sketch: &Sketch,
        are: impl Fn(Votes, (usize, usize)) -> [bool; N],
    ) -> Result<[Mask; N], SegmentationError> {
        let (width, height) = (sketch.mask.width, sketch.mask.height);
        let mut masks = [(); N].map(|()| Mask::filled(width, height, false));
        for (cell, &votes) in self.cells.iter().zip(&self.votes) {
            if let Some((x, y)) = sketch.pixel_of(view, cell) {
                for (mask, is) in masks.iter_mut().zip(are(votes, (x, y))) {
                    *mask.at_mut(x, y) |= is;
                }
            }
        }
        for mask in &mut masks {
            *mask = self.spread(view, sketch, mask)?;
        }
        Ok(masks)
    }

    /// A sketch's mask, wider by half a cell: what is thinner than a cell has no cell's centre in it.
    fn widened(&self, view: &PosedView, sketch: &Sketch) -> Result<Mask, SegmentationError> {
        self.spread(view, sketch, &sketch.mask)
    }

    fn spread(
        &self,
        view: &PosedView,
        sketch: &Sketch,
        mask: &Mask,
    ) -> Result<Mask, SegmentationError> {
        // A camera inside the box sees cells of any size; those of its middle's distance stand for all.
        let depth = (view.cam_from_world.apply(&self.middle)).coords.norm();
        let cell_px = view.intrinsics.focal_px() * self.side / depth.max(self.side);
        // From a cell's centre to its corners.
        let radius = (0.87 * cell_px / sketch.reduction as f64) as f32;
        let distance = distance_from(mask)?;
        Ok(Mask::from_fn(mask.width, mask.height, |x, y| {
            *distance.at(x, y) <= radius
        }))
    }
}

/// The pixel of a reduced image under one of the photo; `None` outside.
pub(crate) fn small_pixel(
    pixel: &Point2<f64>,
    reduction: usize,
    (width, height): (usize, usize),
) -> Option<(usize, usize)> {
    let [x, y] = [pixel.x, pixel.y].map(|v| ((v + 0.5) / reduction as f64).max(0.0) as usize);
    (x < width && y < height).then_some((x, y))
}
