//! Reading pixels back from the [`Shelf`].
//!
//! A [`Reader`] holds the pages that it read last, up to a bound that has no effect on results; each thread
//! has its own. A [`Sampler`] holds none, for pixels far apart.

use crate::correction::Corrections;
use crate::error::FusionError;
use crate::shelf::{LARGEST_RECORD, NONE, PAGE_BYTES, PAGE_SIDE, Pages, Pixel, Shelf};
use crate::view::{Pixels, View};
use rilievo_scene::ScratchError;
use std::sync::{Mutex, PoisonError};

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
        // Written out: a map over an array copies every pixel once more, a sixth of all time.
        let at =
            |next: usize| Pixel::read(&bytes[(number + next) * pages.record..][..pages.record]);
        [at(0), at(1), at(PAGE_SIDE), at(PAGE_SIDE + 1)]
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
        let mut bytes = [0; 2 * LARGEST_RECORD];
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
