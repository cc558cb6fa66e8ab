//! Views and surfaces out of core: kept in a [`Scratch`], read back whole or window by window.
//!
//! The fine levels of a large set's photos are many times what memory holds. What is done there is local, so a tile reads
//! the windows that it needs (`tile`), and what needs a whole view reads one view at a time.
//!
//! A view's room holds, level after level from the finest on, one byte a pixel of the crop (bit 0: masked, bit 1:
//! unclipped) and then three 32-bit floats a pixel. A surface's room holds one 64-bit log depth a pixel of the crop, 0
//! outside the mask, and then one byte a pixel: whether the depth is known. Numbers are little endian.

use crate::camera::Camera;
use crate::level::{LevelView, ViewGrid, dark_intensity};
use crate::window::Window;
use rilievo_numerics::plate_system::PixelNumbering;
use rilievo_scene::{LinearImage, Mask, Raster, Room, Scratch, ScratchError};
use std::io::{self, Read, Write};

const MASKED: u8 = 1;
const UNCLIPPED: u8 = 2;
/// Bytes of a pixel's three channels.
const IMAGE_BYTES: usize = 12;
/// Bytes of a log depth.
const DEPTH_BYTES: usize = 8;
/// Pixels that are read or written at once.
const CHUNK: usize = 1 << 16;

/// One view at all levels, out of core.
#[derive(Debug)]
pub struct StoredView {
    levels: Vec<Plane>,
    room: Box<dyn Room>,
    /// Exposure gain that images are divided by when they are read.
    pub gain: [f64; 3],
}

/// What is known of a view at one level without reading it.
#[derive(Clone, Debug)]
struct Plane {
    camera: Camera,
    cut_by_frame: bool,
    width: usize,
    height: usize,
    num_masked: usize,
    /// Mean intensities of the masked pixels, gain not divided out.
    mean: [f64; 3],
    /// Where the marks and the image begin in the room.
    marks_at: u64,
    image_at: u64,
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
    width: usize,
    height: usize,
    room: Box<dyn Room>,
}

impl StoredView {
    /// Stores a view and its halvings, down to the last of at least `min_pixels` masked pixels; the first in any case.
    ///
    /// # Errors
    /// When there is no space left.
    pub fn put(
        mut view: LevelView,
        min_pixels: usize,
        scratch: &dyn Scratch,
    ) -> Result<Self, ScratchError> {
        let room = scratch.room()?;
        let (mut levels, mut end) = (Vec::new(), 0);
        loop {
            let plane = Plane::put(&view, room.as_ref(), end)?;
            end = plane.image_at + (plane.width * plane.height * IMAGE_BYTES) as u64;
            levels.push(plane);
            view = view.halved();
            if view.pixels.len() < min_pixels {
                break;
            }
        }
        Ok(Self {
            levels,
            room,
            gain: [1.0; 3],
        })
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
        (self.levels[at].width, self.levels[at].height)
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
        let plane = &self.levels[at];
        let (mask, _) = self.marks(plane, &plane.all())?;
        Ok(ViewGrid::new(
            plane.camera.clone(),
            mask,
            plane.cut_by_frame,
        ))
    }

    /// The view at a level.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn view(&self, at: usize) -> Result<LevelView, ScratchError> {
        self.cut(at, &self.levels[at].all())
    }

    /// The part of the view inside a window, which must lie in it; what is dark is told by the whole view.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn cut(&self, at: usize, window: &Window) -> Result<LevelView, ScratchError> {
        let plane = &self.levels[at];
        let &Window {
            x0,
            y0,
            width,
            height,
        } = window;
        let (mask, usable) = self.marks(plane, window)?;
        let mut data = Vec::with_capacity(3 * width * height);
        let gain = self.gain.map(|g| g as f32);
        let image_at = plane.image_at;
        plane.rows(
            self.room.as_ref(),
            (image_at, IMAGE_BYTES),
            window,
            |bytes| {
                for pixel in bytes.chunks_exact(IMAGE_BYTES) {
                    for (c, channel) in pixel.chunks_exact(4).enumerate() {
                        data.push(f32::from_le_bytes(array(channel)) / gain[c]);
                    }
                }
            },
        )?;
        let image = LinearImage {
            width,
            height,
            channels: 3,
            data,
        };
        let camera = plane.camera.cropped(x0, y0, width, height);
        let grid = ViewGrid::new(camera, mask, plane.cut_by_frame);
        let mean = std::array::from_fn(|c| plane.mean[c] / self.gain[c]);
        Ok(LevelView {
            dark: dark_intensity(mean),
            ..LevelView::assemble(grid, image, usable)
        })
    }

    /// The mask and where no channel is clipped, inside a window.
    fn marks(&self, plane: &Plane, window: &Window) -> Result<(Mask, Raster<f32>), ScratchError> {
        let (width, height) = (window.width, window.height);
        let mut mask = Vec::with_capacity(width * height);
        let mut usable = Vec::with_capacity(width * height);
        plane.rows(self.room.as_ref(), (plane.marks_at, 1), window, |bytes| {
            mask.extend(bytes.iter().map(|&b| b & MASKED != 0));
            usable.extend(
                bytes
                    .iter()
                    .map(|&b| f32::from(u8::from(b & UNCLIPPED != 0))),
            );
        })?;
        let mask = Mask {
            width,
            height,
            data: mask,
        };
        let usable = Raster {
            width,
            height,
            data: usable,
        };
        Ok((mask, usable))
    }
}

impl Plane {
    /// Writes a view from byte `marks_at` on.
    fn put(view: &LevelView, room: &dyn Room, marks_at: u64) -> Result<Self, ScratchError> {
        let (width, height) = (view.mask.width, view.mask.height);
        let image_at = marks_at + (width * height) as u64;
        let marks: Vec<u8> = view
            .mask
            .data
            .iter()
            .zip(&view.usable.data)
            .map(|(&is, &usable)| {
                (if is { MASKED } else { 0 }) | (if usable > 0.5 { UNCLIPPED } else { 0 })
            })
            .collect();
        room.write_at(&marks, marks_at)?;
        let mut bytes = Vec::with_capacity(CHUNK * IMAGE_BYTES);
        let mut place = image_at;
        for chunk in view.image.data.chunks(3 * CHUNK) {
            bytes.clear();
            bytes.extend(chunk.iter().flat_map(|v| v.to_le_bytes()));
            room.write_at(&bytes, place)?;
            place += bytes.len() as u64;
        }
        Ok(Self {
            camera: view.camera.clone(),
            cut_by_frame: view.cut_by_frame,
            width,
            height,
            num_masked: view.pixels.len(),
            mean: view.mean_intensity(),
            marks_at,
            image_at,
        })
    }

    fn all(&self) -> Window {
        Window {
            x0: 0,
            y0: 0,
            width: self.width,
            height: self.height,
        }
    }

    /// Reads the rows of a window, `bytes_each` a pixel, from a raster that begins at byte `begin`.
    fn rows(
        &self,
        room: &dyn Room,
        raster: (u64, usize),
        window: &Window,
        take: impl FnMut(&[u8]),
    ) -> Result<(), ScratchError> {
        rows(room, raster, self.width, window, take)
    }
}

/// Reads the rows of a window of a raster that begins at byte `begin` and has `stride` pixels a row, `bytes_each` a
/// pixel.
fn rows(
    room: &dyn Room,
    (begin, bytes_each): (u64, usize),
    stride: usize,
    window: &Window,
    mut take: impl FnMut(&[u8]),
) -> Result<(), ScratchError> {
    // Rows that follow each other without a gap are read together.
    let at_once = if window.width == stride {
        (CHUNK / stride.max(1)).max(1)
    } else {
        1
    };
    let mut bytes = vec![0; window.width * at_once * bytes_each];
    for y in (window.y0..window.y0 + window.height).step_by(at_once) {
        let count = at_once.min(window.y0 + window.height - y);
        let part = &mut bytes[..window.width * count * bytes_each];
        room.read_at(part, begin + ((y * stride + window.x0) * bytes_each) as u64)?;
        take(part);
    }
    Ok(())
}

fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    std::array::from_fn(|k| bytes[k])
}

impl StoredSurface {
    /// A surface whose views are of the sizes that `views` have at level `at`; depths are put in view by view.
    ///
    /// # Errors
    /// When there is no room.
    pub fn new(
        views: &[StoredView],
        at: usize,
        scratch: &dyn Scratch,
    ) -> Result<Self, ScratchError> {
        let maps = views
            .iter()
            .map(|view| {
                let (width, height) = view.size(at);
                Ok(StoredDepth {
                    width,
                    height,
                    room: scratch.room()?,
                })
            })
            .collect::<Result<_, ScratchError>>()?;
        Ok(Self { maps })
    }

    /// Number of views.
    pub fn num_views(&self) -> usize {
        self.maps.len()
    }

    /// Stores the log depths of a view's masked pixels, and where they are known if that has changed.
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
        let value = |&number: &u32| depth.get(number as usize).copied().unwrap_or(0.0);
        write(
            map.room.as_ref(),
            0,
            pixels.number.iter().map(|n| value(n).to_le_bytes()),
        )?;
        if let Some(known) = known {
            let mark = |&number: &u32| [u8::from(known.get(number as usize) == Some(&true))];
            write(
                map.room.as_ref(),
                map.known_at(),
                pixels.number.iter().map(mark),
            )?;
        }
        Ok(())
    }

    /// Log depths of a view's masked pixels.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn get(&self, index: usize, pixels: &PixelNumbering) -> Result<Vec<f64>, ScratchError> {
        let map = &self.maps[index];
        let all = Window {
            x0: 0,
            y0: 0,
            width: map.width,
            height: map.height,
        };
        self.cut(index, &all, pixels)
    }

    /// Where the log depths of a view's masked pixels are known.
    ///
    /// # Errors
    /// When that cannot be read.
    pub fn known(&self, index: usize, pixels: &PixelNumbering) -> Result<Vec<bool>, ScratchError> {
        let map = &self.maps[index];
        let mut marks = vec![0; map.width * map.height];
        map.room.read_at(&mut marks, map.known_at())?;
        let places = pixels.xs.iter().zip(&pixels.ys);
        Ok(places
            .map(|(&x, &y)| marks[y as usize * map.width + x as usize] != 0)
            .collect())
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
        let mut depth = Vec::with_capacity(pixels.len());
        let mut numbers = pixels.number.iter();
        rows(
            map.room.as_ref(),
            (0, DEPTH_BYTES),
            map.width,
            window,
            |bytes| {
                for value in bytes.chunks_exact(DEPTH_BYTES) {
                    // Masked pixels are numbered row by row.
                    if numbers.next().is_some_and(|&n| n as usize == depth.len()) {
                        depth.push(f64::from_le_bytes(array(value)));
                    }
                }
            },
        )?;
        Ok(depth)
    }

    /// Writes all that is stored of a view, for [`Self::restore`].
    ///
    /// # Errors
    /// When it cannot be read or written.
    pub fn save(&self, index: usize, to: &mut dyn Write) -> io::Result<()> {
        let map = &self.maps[index];
        let mut bytes = vec![0; CHUNK * DEPTH_BYTES];
        let mut place = 0;
        while place < map.len() {
            let count = bytes.len().min((map.len() - place) as usize);
            map.room
                .read_at(&mut bytes[..count], place)
                .map_err(io::Error::other)?;
            to.write_all(&bytes[..count])?;
            place += count as u64;
        }
        Ok(())
    }

    /// Stores what [`Self::save`] wrote.
    ///
    /// # Errors
    /// When it is too short, or cannot be stored.
    pub fn restore(&self, index: usize, from: &mut dyn Read) -> io::Result<()> {
        let map = &self.maps[index];
        let mut bytes = vec![0; CHUNK * DEPTH_BYTES];
        let mut place = 0;
        while place < map.len() {
            let count = bytes.len().min((map.len() - place) as usize);
            from.read_exact(&mut bytes[..count])?;
            map.room
                .write_at(&bytes[..count], place)
                .map_err(io::Error::other)?;
            place += count as u64;
        }
        Ok(())
    }
}

impl StoredDepth {
    fn known_at(&self) -> u64 {
        (self.width * self.height * DEPTH_BYTES) as u64
    }

    fn len(&self) -> u64 {
        self.known_at() + (self.width * self.height) as u64
    }
}

/// Writes values one after the other from byte `place` on.
fn write<const N: usize>(
    room: &dyn Room,
    mut place: u64,
    values: impl Iterator<Item = [u8; N]>,
) -> Result<(), ScratchError> {
    let mut bytes = Vec::with_capacity(CHUNK * N);
    let mut flush = |bytes: &mut Vec<u8>| {
        let written = room.write_at(bytes, place);
        place += bytes.len() as u64;
        bytes.clear();
        written
    };
    for value in values {
        bytes.extend_from_slice(&value);
        if bytes.len() >= CHUNK * N {
            flush(&mut bytes)?;
        }
    }
    flush(&mut bytes)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;
    use rilievo_scene::MemoryScratch;

    fn speckled() -> LevelView {
        let mut view = flat_view(61, 43, 100.0);
        for (k, value) in view.image.data.iter_mut().enumerate() {
            *value = 0.2 + 0.1 * (k as f32 * 0.7).sin();
        }
        let mask = Mask::from_fn(61, 43, |x, y| (x + 2 * y) % 17 != 0 && x > 3);
        let usable = Raster::from_fn(61, 43, |x, _| f32::from(u8::from(x < 50)));
        let grid = ViewGrid::new(view.camera.clone(), mask, true);
        LevelView {
            grid,
            usable,
            grey: view.image.to_grey(),
            ..view
        }
    }

    #[test]
    fn a_view_comes_back_at_every_level_and_by_windows() -> Result<(), ScratchError> {
        let view = speckled();
        let stored = StoredView::put(view.clone(), 50, &MemoryScratch)?;
        assert!(stored.num_levels() > 1, "{}", stored.num_levels());
        let mut expected = view;
        for at in 0..stored.num_levels() {
            let found = stored.view(at)?;
            assert_eq!(found.image, expected.image);
            assert_eq!(found.usable, expected.usable);
            assert_eq!(found.mask, expected.mask);
            assert_eq!(stored.grid(at)?.pixels.xs, expected.pixels.xs);
            assert_eq!(stored.num_masked(at), expected.pixels.len());
            assert!(found.cut_by_frame);
            expected = expected.halved();
        }
        let whole = stored.view(0)?;
        let window = Window {
            x0: 7,
            y0: 5,
            width: 31,
            height: 20,
        };
        let part = stored.cut(0, &window)?;
        assert_eq!(part.mask, window.cut(&whole.mask));
        assert_eq!(part.image.pixel(3, 4), whole.image.pixel(10, 9));
        assert_eq!(part.dark, whole.dark);
        Ok(())
    }

    #[test]
    fn images_are_divided_by_the_gain() -> Result<(), ScratchError> {
        let mut view = speckled();
        let mut stored = StoredView::put(view.clone(), 50, &MemoryScratch)?;
        stored.gain = [0.5, 1.0, 2.0];
        view.divide_by_gain(stored.gain);
        let found = stored.view(0)?;
        assert_eq!(found.image, view.image);
        assert!((found.dark / view.dark - 1.0).abs() < 1e-5);
        Ok(())
    }

    #[test]
    fn depths_come_back_whole_by_windows_and_from_a_file() -> Result<(), ScratchError> {
        let views = [StoredView::put(speckled(), 50, &MemoryScratch)?];
        let surface = StoredSurface::new(&views, 0, &MemoryScratch)?;
        let pixels = views[0].grid(0)?.pixels;
        let depth: Vec<f64> = (0..pixels.len()).map(|p| 0.1 + p as f64).collect();
        let known: Vec<bool> = (0..pixels.len()).map(|p| p % 3 != 0).collect();
        surface.put(0, &pixels, &depth, Some(&known))?;
        assert_eq!(surface.get(0, &pixels)?, depth);
        assert_eq!(surface.known(0, &pixels)?, known);
        let window = Window {
            x0: 7,
            y0: 5,
            width: 31,
            height: 20,
        };
        let part = views[0].cut(0, &window)?;
        for (p, value) in surface.cut(0, &window, &part.pixels)?.iter().enumerate() {
            let (x, y) = (
                part.pixels.xs[p] as usize + 7,
                part.pixels.ys[p] as usize + 5,
            );
            assert_eq!(*value, depth[pixels.number[y * 61 + x] as usize]);
        }
        let mut file = Vec::new();
        let copy = StoredSurface::new(&views, 0, &MemoryScratch)?;
        assert!(surface.save(0, &mut file).is_ok());
        assert!(copy.restore(0, &mut &file[..file.len() - 1]).is_err());
        assert!(copy.restore(0, &mut &file[..]).is_ok());
        assert_eq!(copy.get(0, &pixels)?, depth);
        assert_eq!(copy.known(0, &pixels)?, known);
        Ok(())
    }
}
