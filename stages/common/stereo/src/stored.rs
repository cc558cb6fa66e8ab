//! Views and surfaces out of core: kept in a [`PageStore`], read back whole or window by window.
//!
//! The fine levels of a large set's photos are many times what memory holds. What is done there is
//! local, so a tile reads the windows that it needs (`tile`), and what needs a whole view reads one
//! view at a time.
//!
//! A view's store holds for every level, from the finest on, one byte a pixel of the crop (bit 0:
//! masked, bit 1: unclipped) and three 32-bit floats a pixel. A surface's store holds one 64-bit
//! log depth a pixel of the crop, 0 outside the mask, and one byte a pixel: whether the depth is
//! known. Numbers are little endian.

use crate::camera::Camera;
use crate::level::{LevelView, ViewGrid, dark_intensity};
use crate::window::Window;
use rilievo_numerics::plate_system::PixelNumbering;
use rilievo_scene::{
    LinearImage, Mask, PAGE_SIDE, PageStore, Pages, Raster, Scratch, ScratchError,
};
use std::io::{self, Read, Write};

const MASKED: u8 = 1;
const UNCLIPPED: u8 = 2;
/// Bytes of a pixel's three channels.
const IMAGE_BYTES: usize = 12;
/// Bytes of a log depth.
const DEPTH_BYTES: usize = 8;

/// One view at all levels, out of core.
#[derive(Debug)]
pub struct StoredView {
    levels: Vec<StoredImage>,
    store: PageStore,
    /// Exposure gain that images are divided by when they are read.
    pub gain: [f64; 3],
}

/// A view at one level, and what is known of it without reading it.
#[derive(Clone, Debug)]
struct StoredImage {
    camera: Camera,
    cut_by_frame: bool,
    num_masked: usize,
    /// Mean intensities of the masked pixels, gain not divided out.
    mean: [f64; 3],
    marks: Pages,
    channels: Pages,
}

/// One level of all views, out of core, and the surface there.
#[derive(Debug)]
pub struct StoredLevel<'a> {
    /// The views at all levels.
    pub views: &'a [StoredView],
    /// Number of the level, 0 is the finest.
    pub at: usize,
    /// For every view the views it is compared with, best first.
    pub sources: &'a [Vec<usize>],
    /// Sharpness of every view ([`LevelView::sharpness`]).
    pub sharpness: &'a [f64],
    /// Log depths of all views.
    pub surface: &'a StoredSurface,
}

/// Log depths of all views at one level, out of core.
#[derive(Debug)]
pub struct StoredSurface {
    /// Per view.
    maps: Vec<StoredDepth>,
}

/// Log depths of one view.
#[derive(Debug)]
struct StoredDepth {
    store: PageStore,
    depth: Pages,
    known: Pages,
}

impl StoredView {
    /// Stores a view and its halvings, down to the last of at least `min_pixels` masked pixels; the
    /// first in any case.
    ///
    /// # Errors
    /// When there is no space left.
    pub fn put(
        mut view: LevelView,
        min_pixels: usize,
        scratch: &dyn Scratch,
    ) -> Result<Self, ScratchError> {
        let mut stored = Self {
            levels: Vec::new(),
            store: PageStore::new(scratch)?,
            gain: [1.0; 3],
        };
        loop {
            let image = StoredImage::put(&view, &mut stored.store)?;
            stored.levels.push(image);
            view = view.halved();
            if view.pixels.len() < min_pixels {
                return Ok(stored);
            }
        }
    }

    /// Number of levels.
    pub fn num_levels(&self) -> usize {
        self.levels.len()
    }

    /// Masked pixels at a level.
    pub fn num_masked(&self, at: usize) -> usize {
        self.levels[at].num_masked
    }

    /// Columns and rows of the crop at a level.
    pub fn size(&self, at: usize) -> (usize, usize) {
        self.levels[at].marks.size().into()
    }

    /// Camera of the crop at a level.
    pub fn camera(&self, at: usize) -> &Camera {
        &self.levels[at].camera
    }

    /// The pixels at a level.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn grid(&self, at: usize) -> Result<ViewGrid, ScratchError> {
        let image = &self.levels[at];
        let (mask, _) = self.marks(image, &whole(&image.marks))?;
        Ok(ViewGrid::new(
            image.camera.clone(),
            mask,
            image.cut_by_frame,
        ))
    }

    /// The view at a level.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn view(&self, at: usize) -> Result<LevelView, ScratchError> {
        self.cut(at, &whole(&self.levels[at].marks))
    }

    /// The part of the view inside a window, which must lie in it; the whole view decides what is
    /// dark.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn cut(&self, at: usize, window: &Window) -> Result<LevelView, ScratchError> {
        let stored = &self.levels[at];
        let &Window {
            x0,
            y0,
            width,
            height,
        } = window;
        let (mask, usable) = self.marks(stored, window)?;
        let mut data = Vec::with_capacity(3 * width * height);
        let gain = self.gain.map(|g| g as f32);
        self.store.read(&stored.channels, window.ranges(), |row| {
            for pixel in row.chunks_exact(IMAGE_BYTES) {
                for (c, channel) in pixel.as_chunks().0.iter().enumerate() {
                    data.push(f32::from_le_bytes(*channel) / gain[c]);
                }
            }
        })?;
        let image = LinearImage {
            width,
            height,
            channels: 3,
            data,
        };
        let camera = stored.camera.cropped(x0, y0, width, height);
        let grid = ViewGrid::new(camera, mask, stored.cut_by_frame);
        let mean = std::array::from_fn(|c| stored.mean[c] / self.gain[c]);
        Ok(LevelView {
            dark: dark_intensity(mean),
            ..LevelView::assemble(grid, image, usable)
        })
    }

    /// The mask and where no channel is clipped, inside a window.
    fn marks(
        &self,
        image: &StoredImage,
        window: &Window,
    ) -> Result<(Mask, Raster<f32>), ScratchError> {
        let (width, height) = (window.width, window.height);
        let mut marks = Vec::with_capacity(width * height);
        self.store.read(&image.marks, window.ranges(), |row| {
            marks.extend_from_slice(row);
        })?;
        let has = |mark: u8| marks.iter().map(move |byte| byte & mark != 0);
        let mask = Mask {
            width,
            height,
            data: has(MASKED).collect(),
        };
        let usable = Raster {
            width,
            height,
            data: has(UNCLIPPED).map(|is| f32::from(u8::from(is))).collect(),
        };
        Ok((mask, usable))
    }
}

impl StoredImage {
    fn put(view: &LevelView, store: &mut PageStore) -> Result<Self, ScratchError> {
        let size = [view.mask.width, view.mask.height];
        let image = Self {
            camera: view.camera.clone(),
            cut_by_frame: view.cut_by_frame,
            num_masked: view.pixels.len(),
            mean: view.mean_intensity(),
            marks: store.allocate(size, 1, |_| true),
            channels: store.allocate(size, IMAGE_BYTES, |_| true),
        };
        for page in image.marks.kept() {
            store.write(&image.marks, page, |x, y, out| {
                let unclipped = *view.usable.at(x, y) > 0.5;
                out[0] = u8::from(*view.mask.at(x, y)) * MASKED + u8::from(unclipped) * UNCLIPPED;
            })?;
            store.write(&image.channels, page, |x, y, out| {
                for (bytes, value) in out.as_chunks_mut().0.iter_mut().zip(view.image.pixel(x, y)) {
                    *bytes = value.to_le_bytes();
                }
            })?;
        }
        Ok(image)
    }
}

fn whole(pages: &Pages) -> Window {
    let [width, height] = pages.size();
    Window {
        x0: 0,
        y0: 0,
        width,
        height,
    }
}

impl StoredSurface {
    /// A surface whose views are of the sizes that `views` have at level `at`; depths are put in
    /// view by view.
    ///
    /// # Errors
    /// When there is no room.
    pub fn new(
        views: &[StoredView],
        at: usize,
        scratch: &dyn Scratch,
    ) -> Result<Self, ScratchError> {
        let map = |view: &StoredView| {
            let mut store = PageStore::new(scratch)?;
            let size = view.size(at).into();
            Ok(StoredDepth {
                depth: store.allocate(size, DEPTH_BYTES, |_| true),
                known: store.allocate(size, 1, |_| true),
                store,
            })
        };
        let maps = views.iter().map(map).collect::<Result<_, ScratchError>>()?;
        Ok(Self { maps })
    }

    /// Number of views.
    pub fn num_views(&self) -> usize {
        self.maps.len()
    }

    /// Stores the log depths of a view's masked pixels, and where they are known if that has
    /// changed.
    ///
    /// # Errors
    /// When there is no space left.
    pub fn put(
        &self,
        index: usize,
        pixels: &PixelNumbering,
        depth: &[f64],
        known: Option<&[bool]>,
    ) -> Result<(), ScratchError> {
        let map = &self.maps[index];
        let width = map.depth.size()[0];
        let number = |x: usize, y: usize| pixels.number[y * width + x] as usize;
        for page in map.depth.kept() {
            map.store.write(&map.depth, page, |x, y, out| {
                let value = depth.get(number(x, y)).copied().unwrap_or(0.0);
                out.copy_from_slice(&value.to_le_bytes());
            })?;
            if let Some(known) = known {
                map.store.write(&map.known, page, |x, y, out| {
                    out[0] = u8::from(known.get(number(x, y)) == Some(&true));
                })?;
            }
        }
        Ok(())
    }

    /// Log depths of a view's masked pixels.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn get(&self, index: usize, pixels: &PixelNumbering) -> Result<Vec<f64>, ScratchError> {
        self.cut(index, &whole(&self.maps[index].depth), pixels)
    }

    /// Where the log depths of a view's masked pixels are known.
    ///
    /// # Errors
    /// When that cannot be read.
    pub fn known(&self, index: usize, pixels: &PixelNumbering) -> Result<Vec<bool>, ScratchError> {
        let map = &self.maps[index];
        let window = whole(&map.known);
        masked(&map.store, &map.known, &window, pixels, |&[mark]| mark != 0)
    }

    /// Log depths of the masked pixels of a window of a view; `pixels` are the window's own.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn cut(
        &self,
        index: usize,
        window: &Window,
        pixels: &PixelNumbering,
    ) -> Result<Vec<f64>, ScratchError> {
        let map = &self.maps[index];
        let value = |bytes: &[u8; DEPTH_BYTES]| f64::from_le_bytes(*bytes);
        masked(&map.store, &map.depth, window, pixels, value)
    }

    /// Writes all that is stored of a view, for [`Self::restore`]: depths, then where they are
    /// known, row by row.
    ///
    /// # Errors
    /// When it cannot be read or written.
    pub fn save(&self, index: usize, to: &mut dyn Write) -> io::Result<()> {
        let map = &self.maps[index];
        for pages in [&map.depth, &map.known] {
            let mut written = Ok(());
            let read = map.store.read(pages, whole(pages).ranges(), |row| {
                if written.is_ok() {
                    written = to.write_all(row);
                }
            });
            read.map_err(io::Error::other)?;
            written?;
        }
        Ok(())
    }

    /// Stores what [`Self::save`] wrote.
    ///
    /// # Errors
    /// When it is too short, or cannot be stored.
    pub fn restore(&self, index: usize, from: &mut dyn Read) -> io::Result<()> {
        let map = &self.maps[index];
        for (pages, record) in [(&map.depth, DEPTH_BYTES), (&map.known, 1)] {
            let [width, height] = pages.size();
            let columns = pages.grid()[0];
            for first in (0..height).step_by(PAGE_SIDE) {
                let num_rows = PAGE_SIDE.min(height - first);
                let mut bytes = vec![0; num_rows * width * record];
                from.read_exact(&mut bytes)?;
                for page in first / PAGE_SIDE * columns..(first / PAGE_SIDE + 1) * columns {
                    let written = map.store.write(pages, page, |x, y, out| {
                        let at = ((y - first) * width + x) * record;
                        out.copy_from_slice(&bytes[at..at + record]);
                    });
                    written.map_err(io::Error::other)?;
                }
            }
        }
        Ok(())
    }
}

/// The values of the masked pixels of a window, each of its `N` bytes.
fn masked<const N: usize, T>(
    store: &PageStore,
    pages: &Pages,
    window: &Window,
    pixels: &PixelNumbering,
    value: impl Fn(&[u8; N]) -> T,
) -> Result<Vec<T>, ScratchError> {
    let mut values = Vec::with_capacity(pixels.len());
    let mut numbers = pixels.number.iter();
    store.read(pages, window.ranges(), |row| {
        for bytes in row.as_chunks().0 {
            // Masked pixels are numbered row by row.
            if numbers.next().is_some_and(|&n| n as usize == values.len()) {
                values.push(value(bytes));
            }
        }
    })?;
    Ok(values)
}

impl StoredLevel<'_> {
    /// Typical focal length, pixels ([`crate::level::Level::focal`]).
    pub fn focal(&self) -> f64 {
        let views = self.views.iter();
        let sum: f64 = views.map(|view| view.camera(self.at).focal()).sum();
        sum / self.views.len().max(1) as f64
    }

    /// A window of a view, with its sharpness.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn cut(&self, index: usize, window: &Window) -> Result<LevelView, ScratchError> {
        Ok(LevelView {
            sharpness: self.sharpness[index],
            ..self.views[index].cut(self.at, window)?
        })
    }
}
