//! The views' cleaned maps, put aside in pages and read back where they are needed.
//!
//! A view's map is cut into pages of 32 × 32 pixels. Pages near any depth lie one after the other in a
//! [`Room`], pixel by pixel: depth, normal, confidence, colour and marks side by side, and for a lens
//! that distorts the pixel's ray. All other pages are known to be empty and take no room.
//!
//! A [`Reader`] holds the pages that it read last, up to a bound that has no effect on results; each thread
//! has its own. A [`Sampler`] holds none, for pixels far apart.

use crate::error::FusionError;
use crate::reconcile::Corrections;
use crate::view::{Pixels, View};
use rayon::prelude::*;
use rilievo_scene::{Room, Scratch, ScratchError};
use std::sync::{Mutex, PoisonError};

/// Pixels along the side of a page.
pub(crate) const PAGE_SIDE: usize = 32;
/// Bytes of a pixel: depth, normal, confidence, colour, marks; and with a ray.
const RECORD: usize = 24;
const RECORD_WITH_RAY: usize = RECORD + 8;
/// Largest bytes of a page.
pub(crate) const PAGE_BYTES: usize = PAGE_SIDE * PAGE_SIDE * RECORD_WITH_RAY;
/// Pages up to so many pixels from a depth are kept, for their colours.
const COLOR_MARGIN: usize = 4;
const NONE: u32 = u32::MAX;
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
        for (bytes, value) in out[RECORD..].chunks_exact_mut(4).zip(self.ray) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
    }

    #[inline]
    fn read(bytes: &[u8]) -> Self {
        let float = |k: usize| {
            let four = bytes.get(4 * k..4 * k + 4).and_then(|b| b.try_into().ok());
            f32::from_le_bytes(four.unwrap_or_default())
        };
        Self {
            depth: float(0),
            normal: [float(1), float(2), float(3)],
            confidence: float(4),
            color: [bytes[20], bytes[21], bytes[22]],
            gives: bytes[23] & GIVES != 0,
            is_kept: bytes[23] & IS_KEPT != 0,
            ray: [float(6), float(7)],
        }
    }
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
    record: usize,
    /// Number of pages of the views before.
    first: usize,
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

    fn bytes(&self) -> usize {
        PAGE_SIDE * PAGE_SIDE * self.record
    }

    /// Place of a page, `None` where it is empty.
    fn place(&self, page: usize) -> Option<u64> {
        let slot = self.slots[page];
        (slot != NONE).then(|| self.start + u64::from(slot) * self.bytes() as u64)
    }

    /// Page of a pixel, and its number there.
    #[inline]
    fn locate(&self, x: usize, y: usize) -> (usize, usize) {
        let page = y / PAGE_SIDE * self.columns + x / PAGE_SIDE;
        (page, y % PAGE_SIDE * PAGE_SIDE + x % PAGE_SIDE)
    }
}

/// The pages of all views.
#[derive(Debug)]
pub(crate) struct Shelf {
    room: Box<dyn Room>,
    end: u64,
    num_pages: usize,
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

    /// Puts a map of a size aside, whose pixels `pixel` tells.
    pub fn put(
        &mut self,
        [width, height]: [usize; 2],
        with_rays: bool,
        pixel: &(impl Fn(usize, usize) -> Pixel + Sync),
    ) -> Result<Pages, ScratchError> {
        let [columns, rows] = [width, height].map(|n| n.div_ceil(PAGE_SIDE));
        let mut pages = Pages {
            columns,
            size: [width, height],
            slots: vec![NONE; columns * rows],
            start: self.end,
            record: if with_rays { RECORD_WITH_RAY } else { RECORD },
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

/// Reads pixels and keeps their pages, the oldest of which make place for new ones.
#[derive(Debug)]
pub(crate) struct Reader<'a> {
    shelf: &'a Shelf,
    /// Frame of every page of every view.
    frame_of: Vec<u32>,
    frames: Vec<Vec<u8>>,
    /// Page of each frame.
    owners: Vec<usize>,
    max_num_frames: usize,
    next: usize,
    failed: Option<ScratchError>,
}

impl<'a> Reader<'a> {
    fn new(shelf: &'a Shelf, max_num_frames: usize) -> Self {
        Self {
            shelf,
            frame_of: vec![NONE; shelf.num_pages],
            frames: Vec::new(),
            owners: Vec::new(),
            max_num_frames: max_num_frames.max(1),
            next: 0,
            failed: None,
        }
    }

    #[inline]
    fn frame(&mut self, pages: &Pages, page: usize) -> Option<&[u8]> {
        let frame = self.frame_of[pages.first + page];
        if frame != NONE {
            return Some(&self.frames[frame as usize]);
        }
        let place = pages.place(page)?;
        Some(self.load(pages, page, place))
    }

    #[cold]
    fn load(&mut self, pages: &Pages, page: usize, place: u64) -> &[u8] {
        let frame = if self.frames.len() < self.max_num_frames {
            self.frames.push(vec![0; PAGE_BYTES]);
            self.owners.push(0);
            self.frames.len() - 1
        } else {
            let frame = self.next;
            self.frame_of[self.owners[frame]] = NONE;
            self.next = (frame + 1) % self.max_num_frames;
            frame
        };
        self.owners[frame] = pages.first + page;
        self.frame_of[pages.first + page] = frame as u32;
        let bytes = &mut self.frames[frame][..pages.bytes()];
        if let Err(error) = self.shelf.room.read_at(bytes, place) {
            bytes.fill(0);
            self.failed = Some(error);
        }
        &self.frames[frame]
    }
}

impl Pixels for Reader<'_> {
    #[inline]
    fn pixel(&mut self, view: &View, x: usize, y: usize) -> Pixel {
        let pages = &view.pages;
        let (page, number) = pages.locate(x, y);
        let bytes = self.frame(pages, page);
        bytes.map_or_else(Pixel::default, |bytes| {
            Pixel::read(&bytes[number * pages.record..][..pages.record])
        })
    }

    #[inline]
    fn square(&mut self, view: &View, x: usize, y: usize) -> [Pixel; 4] {
        if x % PAGE_SIDE + 1 == PAGE_SIDE || y % PAGE_SIDE + 1 == PAGE_SIDE {
            return [(0, 0), (1, 0), (0, 1), (1, 1)]
                .map(|(dx, dy)| self.pixel(view, x + dx, y + dy));
        }
        let pages = &view.pages;
        let (page, number) = pages.locate(x, y);
        let Some(bytes) = self.frame(pages, page) else {
            return [Pixel::default(); 4];
        };
        [0, 1, PAGE_SIDE, PAGE_SIDE + 1]
            .map(|next| Pixel::read(&bytes[(number + next) * pages.record..][..pages.record]))
    }
}

/// A reader for each thread.
#[derive(Debug)]
pub(crate) struct Readers<'a>(Vec<Mutex<Reader<'a>>>);

impl<'a> Readers<'a> {
    /// Readers that keep so many pages each.
    pub fn new(shelf: &'a Shelf, max_num_frames: usize) -> Self {
        let num = rayon::current_num_threads().max(1);
        let reader = || Mutex::new(Reader::new(shelf, max_num_frames));
        Self((0..num).map(|_| reader()).collect())
    }

    /// Does a piece of work with the thread's reader.
    pub fn with<T>(&self, work: impl FnOnce(&mut Reader<'a>) -> T) -> Result<T, FusionError> {
        let thread = rayon::current_thread_index().unwrap_or(0) % self.0.len();
        let mut reader = self.0[thread]
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let result = work(&mut reader);
        match reader.failed.take() {
            Some(error) => Err(error.into()),
            None => Ok(result),
        }
    }
}

/// Reads single pixels, with depths as corrections make them.
#[derive(Debug)]
pub(crate) struct Sampler<'a> {
    shelf: &'a Shelf,
    corrections: Option<&'a Corrections>,
    failed: Option<ScratchError>,
}

impl<'a> Sampler<'a> {
    /// Reads from a shelf.
    pub fn new(shelf: &'a Shelf, corrections: Option<&'a Corrections>) -> Self {
        Self {
            shelf,
            corrections,
            failed: None,
        }
    }

    /// What was read, unless something could not be.
    pub fn finish<T>(self, read: T) -> Result<T, ScratchError> {
        self.failed.map_or(Ok(read), Err)
    }

    /// `num` pixels of one row of a page.
    fn read<const NUM: usize>(&mut self, view: &View, x: usize, y: usize) -> [Pixel; NUM] {
        let pages = &view.pages;
        let (page, number) = pages.locate(x, y);
        let Some(place) = pages.place(page) else {
            return [Pixel::default(); NUM];
        };
        let mut bytes = [0; 2 * RECORD_WITH_RAY];
        let bytes = &mut bytes[..NUM * pages.record];
        let place = place + (number * pages.record) as u64;
        if let Err(error) = self.shelf.room.read_at(bytes, place) {
            bytes.fill(0);
            self.failed = Some(error);
        }
        std::array::from_fn(|k| {
            let mut pixel = Pixel::read(&bytes[k * pages.record..][..pages.record]);
            if let Some(corrections) = self.corrections {
                pixel.depth = corrections.corrected(view.idx, x + k, y, pixel.depth);
            }
            pixel
        })
    }
}

impl Pixels for Sampler<'_> {
    fn pixel(&mut self, view: &View, x: usize, y: usize) -> Pixel {
        let [pixel] = self.read(view, x, y);
        pixel
    }

    fn square(&mut self, view: &View, x: usize, y: usize) -> [Pixel; 4] {
        if x % PAGE_SIDE + 1 == PAGE_SIDE {
            return [(0, 0), (1, 0), (0, 1), (1, 1)]
                .map(|(dx, dy)| self.pixel(view, x + dx, y + dy));
        }
        let [[a, b], [c, d]] = [0, 1].map(|dy| self.read(view, x, y + dy));
        [a, b, c, d]
    }
}
