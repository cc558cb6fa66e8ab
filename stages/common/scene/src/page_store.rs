//! Rasters out of core: records of pixels in square pages, kept in a [`Room`].
//!
//! A raster is cut into pages of [`PAGE_SIDE`]² pixels, row by row. A page holds the records of its
//! pixels, row by row, each of the same number of bytes. Pages that are left out take no room and
//! read as zeros.

use crate::scratch::{Room, Scratch, ScratchError};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Pixels along the side of a page.
pub const PAGE_SIDE: usize = 32;
/// Slot of a page that is left out, or of one that a cache does not hold.
const NONE: u32 = u32::MAX;

/// The pages of any number of rasters.
#[derive(Debug)]
pub struct PageStore {
    room: Box<dyn Room>,
    /// First free byte of the room.
    end: u64,
    num_pages: usize,
}

/// Where the pages of one raster lie in a [`PageStore`].
#[derive(Clone, Debug)]
pub struct Pages {
    size: [usize; 2],
    columns: usize,
    /// Bytes of a pixel.
    record: usize,
    /// Place of each page among those that are kept, row by row; [`NONE`] for the others.
    slots: Vec<u32>,
    /// First byte of the raster's part of the room.
    start: u64,
    /// Number of pages of the rasters before.
    first: usize,
}

impl Pages {
    /// Columns and rows of the raster.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Columns and rows of pages.
    pub fn grid(&self) -> [usize; 2] {
        [self.columns, self.size[1].div_ceil(PAGE_SIDE)]
    }

    /// Pages that are kept, row by row.
    pub fn kept(&self) -> Vec<usize> {
        let is_kept = |page: &usize| self.slots[*page] != NONE;
        (0..self.slots.len()).filter(is_kept).collect()
    }

    /// Columns and rows of a page inside the raster.
    pub fn extent(&self, page: usize) -> [Range<usize>; 2] {
        extent(self.size, self.columns, page)
    }

    /// Page of a pixel, and the bytes of its record there.
    #[inline]
    pub fn locate(&self, x: usize, y: usize) -> (usize, Range<usize>) {
        let page = y / PAGE_SIDE * self.columns + x / PAGE_SIDE;
        let begin = (y % PAGE_SIDE * PAGE_SIDE + x % PAGE_SIDE) * self.record;
        (page, begin..begin + self.record)
    }

    /// Bytes of a page.
    fn bytes(&self) -> usize {
        PAGE_SIDE * PAGE_SIDE * self.record
    }

    /// First byte of a page, `None` where it is left out.
    fn place(&self, page: usize) -> Option<u64> {
        let slot = self.slots[page];
        (slot != NONE).then(|| self.start + u64::from(slot) * self.bytes() as u64)
    }
}

fn extent(size: [usize; 2], columns: usize, page: usize) -> [Range<usize>; 2] {
    let at = [page % columns, page / columns];
    [0, 1].map(|k| at[k] * PAGE_SIDE..((at[k] + 1) * PAGE_SIDE).min(size[k]))
}

impl PageStore {
    /// An empty store.
    ///
    /// # Errors
    /// When there is no room.
    pub fn new(scratch: &dyn Scratch) -> Result<Self, ScratchError> {
        Ok(Self {
            room: scratch.room()?,
            end: 0,
            num_pages: 0,
        })
    }

    /// Makes place for a raster of a size (columns, rows) with `record` bytes a pixel: for the
    /// pages whose columns and rows `keeps` wants. Their content is undefined until
    /// [`Self::write`].
    pub fn allocate(
        &mut self,
        size: [usize; 2],
        record: usize,
        keeps: impl Fn([Range<usize>; 2]) -> bool,
    ) -> Pages {
        let [columns, rows] = size.map(|n| n.div_ceil(PAGE_SIDE));
        let mut num_kept = 0;
        let mut slot = |page: usize| {
            if !keeps(extent(size, columns, page)) {
                return NONE;
            }
            num_kept += 1;
            num_kept - 1
        };
        let slots = (0..columns * rows).map(&mut slot).collect();
        let pages = Pages {
            size,
            columns,
            record,
            slots,
            start: self.end,
            first: self.num_pages,
        };
        self.end += u64::from(num_kept) * pages.bytes() as u64;
        self.num_pages += pages.slots.len();
        pages
    }

    /// Writes a page, whose records `record` fills by column and row in the raster. Nothing where
    /// it is left out.
    ///
    /// # Errors
    /// When there is no space left.
    pub fn write(
        &self,
        pages: &Pages,
        page: usize,
        record: impl Fn(usize, usize, &mut [u8]),
    ) -> Result<(), ScratchError> {
        let Some(place) = pages.place(page) else {
            return Ok(());
        };
        let mut bytes = vec![0; pages.bytes()];
        let [across, down] = pages.extent(page);
        for y in down {
            for x in across.clone() {
                record(x, y, &mut bytes[pages.locate(x, y).1]);
            }
        }
        self.room.write_at(&bytes, place)
    }

    /// Hands on the records of a window (columns, rows) of a raster, row by row.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn read(
        &self,
        pages: &Pages,
        [across, down]: [Range<usize>; 2],
        mut take: impl FnMut(&[u8]),
    ) -> Result<(), ScratchError> {
        if across.is_empty() || down.is_empty() {
            return Ok(());
        }
        let begin = across.start / PAGE_SIDE;
        let count = across.end.div_ceil(PAGE_SIDE) - begin;
        let mut held = vec![0; count * pages.bytes()];
        let mut row = vec![0; across.len() * pages.record];
        let mut y = down.start;
        while y < down.end {
            let first = y / PAGE_SIDE * pages.columns + begin;
            for (k, bytes) in held.chunks_exact_mut(pages.bytes()).enumerate() {
                match pages.place(first + k) {
                    Some(place) => self.room.read_at(bytes, place)?,
                    None => bytes.fill(0),
                }
            }
            let end = down.end.min((y / PAGE_SIDE + 1) * PAGE_SIDE);
            while y < end {
                let mut rest = row.as_mut_slice();
                let mut x = across.start;
                while x < across.end {
                    let next = across.end.min((x / PAGE_SIDE + 1) * PAGE_SIDE);
                    let (page, at) = pages.locate(x, y);
                    let from = (page - first) * pages.bytes() + at.start;
                    let (part, more) = rest.split_at_mut((next - x) * pages.record);
                    part.copy_from_slice(&held[from..from + part.len()]);
                    rest = more;
                    x = next;
                }
                take(&row);
                y += 1;
            }
        }
        Ok(())
    }
}

/// Reads single records and keeps their pages, up to a bound that has no effect on what is read.
#[derive(Debug)]
pub struct PageCache<'a> {
    store: &'a PageStore,
    /// Frame of every page of every raster.
    frame_of: Vec<u32>,
    frames: Vec<Vec<u8>>,
    /// Page of each frame.
    owners: Vec<usize>,
    max_num_frames: usize,
    oldest: usize,
    failed: Option<ScratchError>,
}

impl<'a> PageCache<'a> {
    fn new(store: &'a PageStore, max_num_frames: usize) -> Self {
        Self {
            store,
            frame_of: vec![NONE; store.num_pages],
            frames: Vec::new(),
            owners: Vec::new(),
            max_num_frames: max_num_frames.max(1),
            oldest: 0,
            failed: None,
        }
    }

    /// Bytes of a page, `None` where it is left out. Zeros where it cannot be read;
    /// [`PageCaches::with`] returns the error.
    #[inline]
    pub fn page(&mut self, pages: &Pages, page: usize) -> Option<&[u8]> {
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
            self.frames.push(Vec::new());
            self.owners.push(0);
            self.frames.len() - 1
        } else {
            let frame = self.oldest;
            self.frame_of[self.owners[frame]] = NONE;
            self.oldest = (frame + 1) % self.max_num_frames;
            frame
        };
        self.owners[frame] = pages.first + page;
        self.frame_of[pages.first + page] = frame as u32;
        let bytes = &mut self.frames[frame];
        bytes.resize(pages.bytes(), 0);
        if let Err(error) = self.store.room.read_at(bytes, place) {
            bytes.fill(0);
            self.failed = Some(error);
        }
        &self.frames[frame]
    }
}

/// A cache for each thread.
#[derive(Debug)]
pub struct PageCaches<'a>(Vec<Mutex<PageCache<'a>>>);

impl<'a> PageCaches<'a> {
    /// Caches that keep so many pages each.
    pub fn new(store: &'a PageStore, max_num_frames: usize) -> Self {
        let num = rayon::current_num_threads().max(1);
        let cache = || Mutex::new(PageCache::new(store, max_num_frames));
        Self((0..num).map(|_| cache()).collect())
    }

    /// Does a piece of work with the thread's cache.
    ///
    /// # Errors
    /// When a page could not be read.
    pub fn with<T>(&self, work: impl FnOnce(&mut PageCache<'a>) -> T) -> Result<T, ScratchError> {
        let thread = rayon::current_thread_index().unwrap_or(0) % self.0.len();
        let mut cache = self.0[thread]
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let result = work(&mut cache);
        cache.failed.take().map_or(Ok(result), Err)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scratch::MemoryScratch;

    /// Two rasters; of the second, pages that begin in odd columns of pages are left out.
    fn filled() -> Result<(PageStore, [Pages; 2]), ScratchError> {
        let mut store = PageStore::new(&MemoryScratch)?;
        let pages = [
            store.allocate([70, 45], 3, |_| true),
            store.allocate([100, 33], 2, |[across, _]| across.start % 64 == 0),
        ];
        for (k, pages) in pages.iter().enumerate() {
            for page in pages.kept() {
                store.write(pages, page, |x, y, out| {
                    out.copy_from_slice(&record(k, x, y))
                })?;
            }
        }
        Ok((store, pages))
    }

    fn record(raster: usize, x: usize, y: usize) -> Vec<u8> {
        [[x, y, 7], [x ^ y, x, 0]][raster][..3 - raster]
            .iter()
            .map(|&v| v as u8)
            .collect()
    }

    #[test]
    fn windows_come_back_row_by_row_and_pages_left_out_as_zeros() -> Result<(), ScratchError> {
        let (store, pages) = filled()?;
        assert_eq!(pages[0].kept().len(), 6);
        assert_eq!(pages[1].kept(), [0, 2, 4, 6]);
        for (k, pages) in pages.iter().enumerate() {
            for window in [[0..pages.size()[0], 0..33], [5..66, 31..33], [33..34, 2..3]] {
                let mut rows = Vec::new();
                store.read(pages, window.clone(), |row| rows.push(row.to_vec()))?;
                let [across, down] = window;
                let expected = down.map(|y| {
                    let is_kept = |x: usize| k == 0 || (x / PAGE_SIDE).is_multiple_of(2);
                    let of = |x: usize| record(k, x, y).into_iter().map(move |b| (x, b));
                    let bytes = across.clone().flat_map(of);
                    bytes.map(|(x, b)| if is_kept(x) { b } else { 0 }).collect()
                });
                assert_eq!(rows, expected.collect::<Vec<Vec<u8>>>());
            }
        }
        Ok(())
    }

    #[test]
    fn a_cache_of_any_size_reads_the_same() -> Result<(), ScratchError> {
        let (store, pages) = filled()?;
        for num in [1, 2, 100] {
            PageCaches::new(&store, num).with(|cache| {
                for i in 0..45 * 70 {
                    let (x, y) = (i % 70, i / 70);
                    let (page, at) = pages[0].locate(x, y);
                    let found = cache.page(&pages[0], page).map(|bytes| bytes[at].to_vec());
                    assert_eq!(found, Some(record(0, x, y)));
                    let (page, at) = pages[1].locate(x, y % 33);
                    let found = cache.page(&pages[1], page).map(|bytes| bytes[at].to_vec());
                    let is_kept = (x / PAGE_SIDE).is_multiple_of(2);
                    assert_eq!(found, is_kept.then(|| record(1, x, y % 33)));
                }
            })?;
        }
        Ok(())
    }
}
