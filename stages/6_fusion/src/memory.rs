//! How the memory allowed is spent.
//!
//! Of `M` bytes the mesh has at most [`MESH_SHARE`], and the pages that threads hold
//! [`PAGES_SHARE`]; the rest is for what is small against them. One view is loaded before all that,
//! for which `M` must suffice; nothing else grows with the number or the size of the views but by a
//! hundredth of a byte a pixel.

use crate::error::FusionError;
use crate::options::FusionOptions;
use crate::pixel::PAGE_BYTES;
use rilievo_scene::PosedViews;

/// Bytes of a photo's pixel while its view is loaded, the rest of the process with it: a map's
/// file, its channels and its values, or what is left of the maps and the photo. Measured are 57 at
/// 4 megapixels, and 41 without exposure and confidence.
const LOAD_BYTES: usize = 56;
/// Bytes of a block of the volume with the surface in it: on average 30 vertices and 60 triangles
/// of 54 bytes a vertex, and half as much again while loose pieces are dropped.
const BLOCK_BYTES: usize = 2_400;
/// Further bytes while a mesh is made lighter: about 100 a triangle.
const SIMPLIFY_BYTES: usize = 6_000;
/// Bytes of a texel: 13 of all textures together, and 50 while they are encoded.
const TEXEL_BYTES: usize = 64;
/// Bytes of a triangle of the asset while it is laid out. Measured are 900.
const FACE_BYTES: usize = 1500;
/// Bytes of a triangle while a mesh is made light: its corners, vertex and normal, and what the
/// quadrics take.
const LIGHTENED_BYTES: usize = 160;
/// Share of the memory that the mesh has.
const MESH_SHARE: f64 = 0.6;
/// Share of the memory for pages that threads hold.
const PAGES_SHARE: f64 = 0.25;
/// Pages that a thread holds at most: what a few dozen views show of a piece of surface.
const MAX_NUM_PAGES: usize = 2048;
/// Share of the memory for what is thinned at once.
const THINNING_SHARE: f64 = 0.25;

fn share(options: &FusionOptions, share: f64) -> usize {
    (share * options.memory_mib.saturating_mul(1 << 20) as f64) as usize
}

/// Refuses memory that a single view does not fit into.
pub(crate) fn refuse_too_little(
    posed: &PosedViews,
    options: &FusionOptions,
) -> Result<(), FusionError> {
    let pixels = posed
        .views
        .iter()
        .map(|v| v.intrinsics.width.saturating_mul(v.intrinsics.height));
    let needed = pixels.max().unwrap_or(0).saturating_mul(LOAD_BYTES);
    if needed <= share(options, 1.0) {
        return Ok(());
    }
    Err(FusionError::OutOfMemory {
        given_mib: options.memory_mib,
        needed_mib: needed.div_ceil(1 << 20),
    })
}

/// Pages that each thread may hold.
pub(crate) fn num_pages(options: &FusionOptions) -> usize {
    let threads = rayon::current_num_threads().max(1);
    (share(options, PAGES_SHARE) / threads / PAGE_BYTES).clamp(1, MAX_NUM_PAGES)
}

/// Blocks of the volume whose mesh the memory holds.
pub(crate) fn max_num_blocks(options: &FusionOptions) -> usize {
    let simplify = usize::from(options.max_num_triangles > 0) * SIMPLIFY_BYTES;
    (share(options, MESH_SHARE) / (BLOCK_BYTES + simplify)).max(1)
}

/// Triangles that the asset has at most, and from which on a mesh is thinned before it is made
/// light.
pub(crate) fn asset_triangles(options: &FusionOptions) -> (usize, usize) {
    let faces = share(options, MESH_SHARE) / FACE_BYTES;
    let lightened = share(options, MESH_SHARE) / LIGHTENED_BYTES;
    (options.asset_faces.min(faces).max(100), lightened.max(1000))
}

/// Largest side of textures that is allowed, and of those that the memory holds: powers of two.
pub(crate) fn texture_sides(options: &FusionOptions) -> (usize, usize) {
    let held = (share(options, MESH_SHARE) / TEXEL_BYTES).isqrt();
    let power_below = |side: usize| 1 << side.max(64).ilog2();
    let allowed = power_below(options.asset_texture);
    (allowed, power_below(held).min(allowed))
}

/// Points that may be sorted at once, of so many bytes each.
pub(crate) fn max_num_sorted(options: &FusionOptions, bytes: usize) -> usize {
    (share(options, THINNING_SHARE) / bytes).max(1)
}
