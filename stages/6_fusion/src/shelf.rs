//! The views' cleaned maps, put aside in pages and read back where they are needed.
//!
//! A view's map is cut into pages of 32 × 32 pixels. Pages near any depth lie one after the other in a
//! [`Room`], pixel by pixel: depth, normal, confidence, colour and marks side by side, where asked for the albedo, and
//! for a lens that distorts the pixel's ray. All other pages are known to be empty and take no room.

use rayon::prelude::*;
use rilievo_scene::{Room, Scratch, ScratchError};

/// Pixels along the side of a page.
pub(crate) const PAGE_SIDE: usize = 32;
/// Bytes of a pixel: depth, normal, confidence, colour, marks; of an albedo, with one to spare; and of a ray. A record's
/// length tells which of them it has.
const RECORD: usize = 24;
const ALBEDO: usize = 4;
const RAY: usize = 8;
/// Largest bytes of a pixel, and of a page.
pub(crate) const LARGEST_RECORD: usize = RECORD + ALBEDO + RAY;
pub(crate) const PAGE_BYTES: usize = PAGE_SIDE * PAGE_SIDE * LARGEST_RECORD;
/// Pages up to so many pixels from a depth are kept, for their colours.
const COLOR_MARGIN: usize = 4;
pub(crate) const NONE: u32 = u32::MAX;
/// Marks of a pixel.
const GIVES: u8 = 1;
const IS_KEPT: u8 = 2;

/// A pixel of a view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Pixel {
    /// Depth, 0 where there is none, and on both sides of depth edges.
    pub depth: f32,
    /// Normal, camera frame.
    pub normal: [f32; 3],
    pub confidence: f32,
    pub color: [u8; 3],
    /// The surface's own colour, where it was put aside.
    pub albedo: [u8; 3],
    /// Good enough to give points: not at the border of the map, not grazing. The others still
    /// confirm what another view sees better.
    pub gives: bool,
    /// Whether the pixel lies on a page that is kept: elsewhere its colour is not known.
    pub is_kept: bool,
    /// Normalised coordinates, of a lens that distorts.
    pub ray: [f32; 2],
}

impl Pixel {
    fn write(&self, out: &mut [u8]) {
        let [nx, ny, nz] = self.normal;
        let floats = [self.depth, nx, ny, nz, self.confidence];
        for (bytes, value) in out.chunks_exact_mut(4).zip(floats) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        out[20..23].copy_from_slice(&self.color);
        out[23] = IS_KEPT | if self.gives { GIVES } else { 0 };
        let (albedo, ray) = extras(out.len());
        if let Some(at) = albedo {
            out[at..at + 3].copy_from_slice(&self.albedo);
        }
        if let Some(at) = ray {
            for (bytes, value) in out[at..].chunks_exact_mut(4).zip(self.ray) {
                bytes.copy_from_slice(&value.to_le_bytes());
            }
        }
    }

    #[inline]
    pub fn read(bytes: &[u8]) -> Self {
        let Some(b) = bytes.first_chunk::<RECORD>() else {
            return Self::default();
        };
        let float =
            |k: usize| f32::from_le_bytes([b[4 * k], b[4 * k + 1], b[4 * k + 2], b[4 * k + 3]]);
        let (albedo, ray) = extras(bytes.len());
        let ray = ray.and_then(|at| bytes[at..].first_chunk::<RAY>());
        Self {
            depth: float(0),
            normal: [float(1), float(2), float(3)],
            confidence: float(4),
            color: [b[20], b[21], b[22]],
            albedo: albedo.map_or([0; 3], |at| [bytes[at], bytes[at + 1], bytes[at + 2]]),
            gives: b[23] & GIVES != 0,
            is_kept: b[23] & IS_KEPT != 0,
            ray: ray.map_or([0.0; 2], |&[a, b, c, d, e, f, g, h]| {
                [[a, b, c, d], [e, f, g, h]].map(f32::from_le_bytes)
            }),
        }
    }
}

/// Where albedo and ray stand in a record of a length.
#[inline]
fn extras(length: usize) -> (Option<usize>, Option<usize>) {
    let albedo = (length % RAY == ALBEDO).then_some(RECORD);
    let ray = (length >= RECORD + RAY).then(|| length - RAY);
    (albedo, ray)
}

/// Where the pages of a view lie.
#[derive(Clone, Debug)]
pub(crate) struct Pages {
    pub columns: usize,
    /// Columns and rows of the map.
    size: [usize; 2],
    /// Place in the view's part of the room, in pages, row by row; [`NONE`] for empty pages.
    slots: Vec<u32>,
    /// First byte of the view's part.
    start: u64,
    /// Bytes of a pixel.
    pub record: usize,
    /// Number of pages of the views before.
    pub first: usize,
}

impl Pages {
    /// Pages that are kept, row by row.
    pub fn kept(&self) -> Vec<usize> {
        let slots = self.slots.iter().enumerate();
        slots
            .filter(|(_, slot)| **slot != NONE)
            .map(|(page, _)| page)
            .collect()
    }

    /// Columns and rows of a page inside the map.
    pub fn extent(&self, page: usize) -> [std::ops::Range<usize>; 2] {
        let at = [page % self.columns, page / self.columns];
        [0, 1].map(|k| at[k] * PAGE_SIDE..((at[k] + 1) * PAGE_SIDE).min(self.size[k]))
    }

    /// Bytes of a page.
    pub fn bytes(&self) -> usize {
        PAGE_SIDE * PAGE_SIDE * self.record
    }

    /// Place of a page, `None` where it is empty.
    pub fn place(&self, page: usize) -> Option<u64> {
        let slot = self.slots[page];
        (slot != NONE).then(|| self.start + u64::from(slot) * self.bytes() as u64)
    }

    /// Page of a pixel, and its number there.
    #[inline]
    pub fn locate(&self, x: usize, y: usize) -> (usize, usize) {
        let page = y / PAGE_SIDE * self.columns + x / PAGE_SIDE;
        (page, y % PAGE_SIDE * PAGE_SIDE + x % PAGE_SIDE)
    }
}

/// The pages of all views.
#[derive(Debug)]
pub(crate) struct Shelf {
    pub room: Box<dyn Room>,
    end: u64,
    pub num_pages: usize,
}

impl Shelf {
    /// An empty shelf.
    pub fn new(scratch: &dyn Scratch) -> Result<Self, ScratchError> {
        Ok(Self {
            room: scratch.room()?,
            end: 0,
            num_pages: 0,
        })
    }

    /// Puts a map of a size aside, whose pixels `pixel` tells, with albedo and rays if these are to be kept.
    pub fn put(
        &mut self,
        [width, height]: [usize; 2],
        (with_albedo, with_rays): (bool, bool),
        pixel: &(impl Fn(usize, usize) -> Pixel + Sync),
    ) -> Result<Pages, ScratchError> {
        let [columns, rows] = [width, height].map(|n| n.div_ceil(PAGE_SIDE));
        let mut pages = Pages {
            columns,
            size: [width, height],
            slots: vec![NONE; columns * rows],
            start: self.end,
            record: RECORD + usize::from(with_albedo) * ALBEDO + usize::from(with_rays) * RAY,
            first: self.num_pages,
        };
        let holds_depth: Vec<bool> = (0..columns * rows)
            .into_par_iter()
            .map(|page| {
                let [across, down] = pages.extent(page);
                let grown = |range: std::ops::Range<usize>, end: usize| {
                    range.start.saturating_sub(COLOR_MARGIN)..(range.end + COLOR_MARGIN).min(end)
                };
                let across = grown(across, width);
                grown(down, height).any(|y| across.clone().any(|x| pixel(x, y).depth > 0.0))
            })
            .collect();
        let kept = holds_depth.iter().zip(&mut pages.slots);
        for (slot, (_, place)) in kept.filter(|(holds, _)| **holds).enumerate() {
            *place = slot as u32;
        }
        let numbers = pages.kept();
        numbers.par_iter().try_for_each(|&page| {
            let mut bytes = vec![0; pages.bytes()];
            let [across, down] = pages.extent(page);
            for y in down {
                for x in across.clone() {
                    let at = pages.locate(x, y).1 * pages.record;
                    pixel(x, y).write(&mut bytes[at..at + pages.record]);
                }
            }
            let place = pages.place(page).unwrap_or(self.end);
            self.room.write_at(&bytes, place)
        })?;
        self.end += (numbers.len() * pages.bytes()) as u64;
        self.num_pages += pages.slots.len();
        Ok(pages)
    }

    /// Goes through a page pixel by pixel; where `change` alters a depth, the page is put back.
    pub fn visit(
        &self,
        pages: &Pages,
        page: usize,
        mut change: impl FnMut(usize, usize, &Pixel) -> f32,
    ) -> Result<(), ScratchError> {
        let Some(place) = pages.place(page) else {
            return Ok(());
        };
        let mut bytes = vec![0; pages.bytes()];
        self.room.read_at(&mut bytes, place)?;
        let mut is_changed = false;
        let [across, down] = pages.extent(page);
        for y in down {
            for x in across.clone() {
                let at = pages.locate(x, y).1 * pages.record;
                let pixel = Pixel::read(&bytes[at..at + pages.record]);
                let depth = change(x, y, &pixel);
                if depth != pixel.depth {
                    bytes[at..at + 4].copy_from_slice(&depth.to_le_bytes());
                    is_changed = true;
                }
            }
        }
        if is_changed {
            self.room.write_at(&bytes, place)?;
        }
        Ok(())
    }
}
