//! A pixel of a view's cleaned map, as it lies in the [`rilievo_scene::PageStore`]: depth, normal,
//! confidence, colour and marks side by side, where asked for the albedo, and for a lens that
//! distorts the pixel's ray.

use rilievo_scene::PAGE_SIDE;

/// Bytes of a pixel: depth, normal, confidence, colour, marks; of an albedo, with one to spare; and
/// of a ray. A record's length says which of them it has.
const RECORD: usize = 24;
const ALBEDO: usize = 4;
const RAY: usize = 8;
/// Largest bytes of a page.
pub(crate) const PAGE_BYTES: usize = PAGE_SIDE * PAGE_SIDE * (RECORD + ALBEDO + RAY);
/// Marks of a pixel.
const MAKES_POINTS: u8 = 1;
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
    /// The surface's own colour, where it is stored.
    pub albedo: [u8; 3],
    /// Good enough to make points: not at the border of the map, not grazing. The others still
    /// confirm what another view sees better.
    pub makes_points: bool,
    /// Whether the pixel lies on a page that is kept: elsewhere its colour is not known.
    pub is_kept: bool,
    /// Normalised coordinates, of a lens that distorts.
    pub ray: [f32; 2],
}

impl Pixel {
    /// Bytes of a record with albedo and ray, where they are stored.
    pub fn record(with_albedo: bool, with_ray: bool) -> usize {
        RECORD + usize::from(with_albedo) * ALBEDO + usize::from(with_ray) * RAY
    }

    pub fn write(&self, out: &mut [u8]) {
        let [nx, ny, nz] = self.normal;
        let floats = [self.depth, nx, ny, nz, self.confidence];
        for (bytes, value) in out.as_chunks_mut().0.iter_mut().zip(floats) {
            *bytes = value.to_le_bytes();
        }
        out[20..23].copy_from_slice(&self.color);
        out[23] = IS_KEPT | (u8::from(self.makes_points) * MAKES_POINTS);
        let (albedo, ray) = extras(out.len());
        if let Some(at) = albedo {
            out[at..at + 3].copy_from_slice(&self.albedo);
        }
        if let Some(at) = ray {
            for (bytes, value) in out[at..].as_chunks_mut().0.iter_mut().zip(self.ray) {
                *bytes = value.to_le_bytes();
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
            makes_points: b[23] & MAKES_POINTS != 0,
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
