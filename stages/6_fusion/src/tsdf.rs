//! Signed distances of all views in sparse cells around the surface.
//!
//! At a voxel centre `v` each view contributes the distance of its surface from `v` along the
//! normal, `d = n·(v − Y)` with `Y` where the view's ray through `v` meets its surface, clamped to
//! the truncation `T`; nothing where `d < −T`, or where `v` lies more than `2 T` behind `Y` along
//! the ray (what lies behind the surface is unknown). The voxel keeps `D = Σ w d / Σ w`, `w = c
//! cos²θ / a²`.
//!
//! Voxels come in blocks of 8³ that exist only near the surface; their number is known before they
//! are made, and the voxels are enlarged where the mesh would exceed the memory allowed. The blocks
//! are stored as they are filled, in Morton order, so that neighbours in the order see the same
//! pages.
//!
//! Source: Curless and Levoy, "A volumetric method for building complex models from range images",
//! SIGGRAPH 1996, eqs. 1 and 2. Departure: distances along the normal instead of the ray, so that
//! views from different directions measure one quantity.

use crate::best::best;
use crate::error::FusionError;
use crate::judge::weight;
use crate::memory;
use crate::options::FusionOptions;
use crate::reach::Ball;
use crate::view::View;
use crate::views::{LoadedViews, min_grazing_cosine};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rilievo_scene::team::divided;
use rilievo_scene::{Observer, PageCache, PageCaches, Room, Scratch, ScratchError, StageId};

/// Voxels along the edge of a block.
pub(crate) const SIDE: usize = 8;
/// Voxels of a block.
pub(crate) const VOLUME: usize = SIDE * SIDE * SIDE;
/// Distance of a voxel that no view says anything about.
pub(crate) const UNKNOWN: f32 = f32::MAX;
/// Bytes of a block's distances.
const BLOCK_BYTES: usize = VOLUME * 4;
/// Blocks that are worked on between two words to the observer.
pub(crate) const BLOCKS_AT_ONCE: usize = 4096;
/// Distance from the surface over which views are averaged, voxels. It exceeds the noise of the
/// depths; larger values close narrow grooves.
const TRUNCATION_VOXELS: f64 = 4.0;
/// Pages whose blocks are found before they are put among the others.
const PAGES_AT_ONCE: usize = 4096;
/// Growth of the voxels when the memory does not suffice.
const COARSEN: f64 = 1.189_207_115_002_721;
/// A view measures the distance of the surface up to this many truncations behind it along its ray.
/// At grazing incidence the distance along the normal stays small all the way out of the body's far
/// side, where its sign would be wrong and fold the mesh at the rim; at 1 cells at 75 degrees of
/// incidence and more miss a corner.
const MAX_BEHIND: f64 = 2.0;
/// Coordinates are kept to 21 bits each.
const KEY_OFFSET: i64 = 1 << 20;
/// Blocks are counted up to this multiple of what is allowed, to estimate how much larger voxels
/// must be.
const MAX_EXCESS: usize = 8;

/// Position of a block, in blocks.
pub(crate) type Key = [i32; 3];

/// Distances in blocks, out of core.
pub(crate) struct Volume {
    pub voxel: f64,
    /// Distance over which views are averaged, world's unit.
    pub truncation: f64,
    /// Cosine of incidence below which a view is too oblique to shape the mesh.
    pub min_cosine: f64,
    pub origin: Point3<f64>,
    /// Codes of the blocks, in ascending order.
    codes: Vec<u64>,
    /// One array of voxels per code, x fastest; in voxels, [`UNKNOWN`] where none.
    room: Box<dyn Room>,
    /// Factor by which voxels are larger than asked for.
    pub coarsened_by: f64,
}

impl Volume {
    pub fn num_blocks(&self) -> usize {
        self.codes.len()
    }

    pub fn key(&self, idx: usize) -> Key {
        decode(self.codes[idx])
    }

    /// Index of the block with a key.
    pub fn find(&self, key: Key) -> Option<usize> {
        self.codes.binary_search(&encode(key.map(i64::from))).ok()
    }

    /// First corner of a block.
    pub fn corner(&self, idx: usize) -> Point3<f64> {
        let edge = SIDE as f64 * self.voxel;
        self.origin + Vector3::from(self.key(idx).map(|k| f64::from(k) * edge))
    }

    /// Views that shape a block, of those that may say something about it.
    pub fn best<'a>(
        &self,
        pixels: &mut PageCache<'_>,
        views: &'a [View],
        idx: usize,
    ) -> Vec<&'a View> {
        let (corner, edge) = (self.corner(idx), SIDE as f64 * self.voxel);
        let ball = Ball::of_cube(&corner, edge);
        let behind = MAX_BEHIND * self.truncation;
        let near = views.iter().filter(|v| ball.is_reached_by(v, behind));
        let limits = (self.truncation, self.min_cosine);
        best(pixels, near.collect(), (&corner, edge), limits)
    }

    /// Distances of a block.
    pub fn read(&self, idx: usize) -> Result<[f32; VOLUME], ScratchError> {
        let mut bytes = [0; BLOCK_BYTES];
        self.room.read_at(&mut bytes, (idx * BLOCK_BYTES) as u64)?;
        let mut distances = [UNKNOWN; VOLUME];
        for (distance, four) in distances.iter_mut().zip(bytes.as_chunks::<4>().0) {
            *distance = f32::from_le_bytes(*four);
        }
        Ok(distances)
    }

    fn write(&self, idx: usize, distances: &[f32]) -> Result<(), ScratchError> {
        let mut bytes = [0; BLOCK_BYTES];
        for (four, distance) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(distances) {
            *four = distance.to_le_bytes();
        }
        self.room.write_at(&bytes, (idx * BLOCK_BYTES) as u64)
    }

    /// Memory of the stored distances, MiB.
    pub fn memory_mib(&self) -> f64 {
        (self.codes.len() * BLOCK_BYTES) as f64 / 1_048_576.0
    }
}

/// Fuses the depth maps at voxels of the median footprint times `voxel_px` or larger; `None` when
/// no block is near any surface.
pub(crate) fn integrate(
    loaded: &LoadedViews,
    caches: &PageCaches<'_>,
    scratch: &dyn Scratch,
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<Option<Volume>, FusionError> {
    let wanted = options.voxel_px * loaded.median_footprint;
    if wanted.is_nan() || wanted <= 0.0 {
        return Ok(None);
    }
    let views = &loaded.views;
    let first = views.iter().find_map(|view| Some((view, view.first_px?)));
    let Some((view, [x, y])) = first else {
        return Ok(None);
    };
    let origin = caches.with(|pixels| {
        let pixel = view.pixel(pixels, x, y);
        view.point_to_world(&(view.ray(x, y, &pixel) * f64::from(pixel.depth)))
    })?;
    let max_num_blocks = memory::max_num_blocks(options);
    let mut coarsened_by = 1.0;
    let codes = loop {
        let voxel = wanted * coarsened_by;
        let most = MAX_EXCESS.saturating_mul(max_num_blocks);
        let codes = block_codes(views, caches, voxel, &origin, most)?;
        if codes.len() <= max_num_blocks {
            break codes;
        }
        // A surface's blocks fall with the square of their edge.
        let excess = codes.len() as f64 / max_num_blocks as f64;
        let steps = (0.5 * excess.ln() / COARSEN.ln()).floor().max(1.0);
        coarsened_by *= COARSEN.powf(steps);
    };
    if codes.is_empty() {
        return Ok(None);
    }
    let voxel = wanted * coarsened_by;
    let volume = Volume {
        voxel,
        truncation: TRUNCATION_VOXELS * voxel,
        min_cosine: min_grazing_cosine(),
        origin,
        codes,
        room: scratch.room()?,
        coarsened_by,
    };
    let num_blocks = volume.num_blocks();
    for first in (0..num_blocks).step_by(BLOCKS_AT_ONCE) {
        let flow = observer.progress(
            StageId::Fusion,
            "averaging signed distances",
            (first, num_blocks),
        );
        flow.ok_or(FusionError::Interrupted)?;
        let count = BLOCKS_AT_ONCE.min(num_blocks - first);
        let filled = divided(observer.team(), count, usize::MAX, |k| {
            let distances = caches.with(|pixels| {
                let best = volume.best(pixels, views, first + k);
                let corner = volume.corner(first + k);
                fill(
                    pixels,
                    &best,
                    &corner,
                    voxel,
                    volume.truncation,
                    volume.min_cosine,
                )
            })?;
            Ok::<_, FusionError>(distances.to_vec())
        })?;
        for (k, distances) in filled.iter().enumerate() {
            volume.write(first + k, distances)?;
        }
    }
    Ok(Some(volume))
}

/// Every third bit of 63, from the lowest on, holds a bit of `c`.
fn spread(c: u64) -> u64 {
    (0..21).fold(0, |code, bit| code | (c >> bit & 1) << (3 * bit))
}

fn gather(code: u64) -> u64 {
    (0..21).fold(0, |c, bit| c | (code >> (3 * bit) & 1) << bit)
}

/// Morton code of a block: the bits of its coordinates in turn, so that neighbours have codes near
/// each other.
fn encode(key: [i64; 3]) -> u64 {
    let [x, y, z] = key.map(|k| spread((k + KEY_OFFSET) as u64 & 0x1f_ffff));
    x | y << 1 | z << 2
}

fn decode(code: u64) -> Key {
    [0, 1, 2].map(|axis| (gather(code >> axis) as i64 - KEY_OFFSET) as i32)
}

/// Codes of the blocks within the truncation of any surface, in order; where there are more than
/// `most`, some of them and more than `most`.
fn block_codes(
    views: &[View],
    caches: &PageCaches<'_>,
    voxel: f64,
    origin: &Point3<f64>,
    most: usize,
) -> Result<Vec<u64>, FusionError> {
    let edge = voxel * SIDE as f64;
    let reach = TRUNCATION_VOXELS * voxel;
    let of_page = |pixels: &mut PageCache<'_>, view: &View, page: usize| {
        let mut found: Vec<[i64; 3]> = Vec::new();
        let [across, down] = view.pages.extent(page);
        for y in down {
            for x in across.clone() {
                let pixel = view.pixel(pixels, x, y);
                let Some(surface) = pixel.surface().filter(|s| s.makes_points) else {
                    continue;
                };
                let at = view.point_to_world(&(view.ray(x, y, &pixel) * surface.depth)) - origin;
                let normal = view.to_world(&surface.normal);
                // The band is thin along the normal, and a voxel wide across it.
                let half = normal.map(|c| c.abs() * reach) + Vector3::repeat(voxel);
                let low = ((at - half) / edge).map(|c| c.floor() as i64);
                let high = ((at + half) / edge).map(|c| c.floor() as i64);
                for i in low.x..=high.x {
                    for j in low.y..=high.y {
                        for k in low.z..=high.z {
                            if found.last() != Some(&[i, j, k]) {
                                found.push([i, j, k]);
                            }
                        }
                    }
                }
            }
            // A row's blocks are mostly those of the row before.
            found.sort_unstable();
            found.dedup();
        }
        found.into_iter().map(encode).collect::<Vec<u64>>()
    };
    let mut all: Vec<u64> = Vec::new();
    for view in views {
        for pages in view.pages.kept().chunks(PAGES_AT_ONCE) {
            let found: Vec<Vec<u64>> = pages
                .par_iter()
                .map(|&page| caches.with(|pixels| of_page(pixels, view, page)))
                .collect::<Result<_, _>>()?;
            all.extend(found.into_iter().flatten());
            all.par_sort_unstable();
            all.dedup();
            if all.len() > most {
                return Ok(all);
            }
        }
    }
    Ok(all)
}

/// Distances of the block with its first corner there, of the views that shape it.
fn fill(
    pixels: &mut PageCache<'_>,
    views: &[&View],
    corner: &Point3<f64>,
    voxel: f64,
    truncation: f64,
    min_cosine: f64,
) -> [f32; VOLUME] {
    let mut sums = [(0.0_f64, 0.0_f64); VOLUME];
    for view in views {
        for (i, sum) in sums.iter_mut().enumerate() {
            let at = [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)];
            let position = corner + Vector3::from(at.map(|c| (c as f64 + 0.5) * voxel));
            let in_cam = view.pose.apply(&position);
            if in_cam.z <= 0.0 {
                continue;
            }
            let Some(surface) = view.along(pixels, &in_cam) else {
                continue;
            };
            let ray = in_cam.coords / in_cam.z;
            let slope = -surface.normal.dot(&ray);
            let distance = (surface.depth - in_cam.z) * slope;
            if distance < -truncation {
                continue;
            }
            let cosine = slope / ray.norm();
            // Too oblique to give points is too oblique to shape the mesh; and behind its surface a
            // view knows only what is near, for the ray leaves a curved body again.
            let behind = (in_cam.z - surface.depth) * ray.norm();
            if cosine < min_cosine || behind > MAX_BEHIND * truncation {
                continue;
            }
            let footprint = view.footprint(surface.depth);
            let weight = weight(surface.confidence, cosine, footprint);
            sum.0 += weight * distance.min(truncation);
            sum.1 += weight;
        }
    }
    let mut distances = [UNKNOWN; VOLUME];
    for (distance, (sum, weight)) in distances.iter_mut().zip(&sums) {
        if *weight > 0.0 {
            *distance = (sum / weight / voxel) as f32;
        }
    }
    distances
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::testing::load;
    use rilievo_synthetic::testing::sphere_world;

    #[test]
    fn views_that_do_not_reach_a_block_have_nothing_to_say_of_it() {
        let world = sphere_world();
        let loaded = load(&world.posed, &world.shaded);
        let caches = PageCaches::new(&loaded.store, 64);
        let voxel = 0.2 * loaded.median_footprint;
        let (edge, truncation) = (SIDE as f64 * voxel, TRUNCATION_VOXELS * voxel);
        let min_cosine = min_grazing_cosine();
        // The sphere and what lies around and behind it.
        let origin = Point3::origin();
        let near = block_codes(&loaded.views, &caches, voxel, &origin, usize::MAX);
        let near: Vec<Key> = near
            .expect("room in memory")
            .into_iter()
            .map(decode)
            .collect();
        let range = |i: usize| {
            let (low, high) = near.iter().fold((i32::MAX, i32::MIN), |(low, high), key| {
                (low.min(key[i]), high.max(key[i]))
            });
            (low - 8..high + 8).step_by(3)
        };
        let keys: Vec<Key> = range(0)
            .flat_map(|x| range(1).flat_map(move |y| range(2).map(move |z| [x, y, z])))
            .collect();
        let (mut num_left_out, mut num_seen) = (0, 0);
        for view in &loaded.views {
            for key in &keys {
                let corner = Point3::from(key.map(|k| f64::from(k) * edge));
                if Ball::of_cube(&corner, edge).is_reached_by(view, MAX_BEHIND * truncation) {
                    num_seen += 1;
                    continue;
                }
                num_left_out += 1;
                let said = caches
                    .with(|pixels| fill(pixels, &[view], &corner, voxel, truncation, min_cosine));
                let said = said.expect("room in memory");
                assert!(said.iter().all(|&d| d == UNKNOWN), "{} {key:?}", view.idx);
            }
        }
        assert!(
            num_seen > 100 && num_left_out > 100,
            "{num_left_out} {num_seen}"
        );
    }

    #[test]
    fn keys_survive_their_codes() {
        for key in [
            [-5, 3, 0],
            [0, 0, 0],
            [7, -1_000_000, 12],
            [1_048_575, 1, -1],
        ] {
            assert_eq!(decode(encode(key.map(i64::from))), key);
        }
        // The cells of a cube of two come before any other.
        let codes = |far: i64| encode([far & 1, far >> 1 & 1, far >> 2 & 1]);
        assert!((0..8).all(|n| codes(n) < encode([2, 0, 0])));
    }
}
