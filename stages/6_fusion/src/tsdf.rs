//! Signed distances of all views in sparse cells around the surface.
//!
//! At a voxel centre `v` each view contributes the distance of its surface from `v` along the
//! normal, `d = n·(v − Y)` with `Y` where the view's ray through `v` meets its surface, clamped to
//! the truncation `T`; nothing where `d < −T`, or where `v` lies more than `2 T` behind `Y` along
//! the ray (what lies behind the surface is unknown). The voxel keeps `D = Σ w d / Σ w`, `w = c cos²θ / a²`.
//!
//! Voxels come in blocks of 8³ that exist only near the surface; their number is known before they
//! are made, and the voxels are enlarged where it would exceed the memory allowed.
//!
//! Source: Curless and Levoy, "A volumetric method for building complex models from range images",
//! SIGGRAPH 1996, eqs. 1 and 2. Departure: distances along the normal instead of the ray, so that
//! views from different directions measure one quantity.

use crate::error::FusionError;
use crate::memory::max_num_blocks;
use crate::options::FusionOptions;
use crate::view::View;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_scene::{Observer, StageId};

/// Voxels along the edge of a block.
pub(crate) const SIDE: usize = 8;
/// Voxels of a block.
pub(crate) const VOLUME: usize = SIDE * SIDE * SIDE;
/// Distance of a voxel that no view says anything about.
pub(crate) const UNKNOWN: f32 = f32::MAX;
/// Bytes of a block's distances and key.
const BLOCK_BYTES: usize = VOLUME * 4 + 16;
/// Growth of the voxels when the memory does not suffice.
const COARSEN: f64 = 1.189_207_115_002_721;
/// A view tells how far the surface is up to this many truncations behind it along its ray. At
/// grazing incidence the distance along the normal stays small all the way out of the body's far
/// side, where its sign would be wrong and fold the mesh at the rim; at 1 cells at 75 degrees of
/// incidence and more miss a corner.
const MAX_BEHIND: f64 = 2.0;
/// Coordinates are kept to 21 bits each.
const KEY_OFFSET: i64 = 1 << 20;

/// Position of a block, in blocks.
pub(crate) type Key = [i32; 3];

/// Distances in blocks, sorted by key.
pub(crate) struct Volume {
    pub voxel: f64,
    pub origin: Point3<f64>,
    pub keys: Vec<Key>,
    /// One array of voxels per key, x fastest; in voxels, [`UNKNOWN`] where none.
    pub distances: Vec<[f32; VOLUME]>,
    /// Factor by which voxels are larger than asked for.
    pub coarsened_by: f64,
}

impl Volume {
    /// Distances of the block with a key.
    pub fn block(&self, key: &Key) -> Option<&[f32; VOLUME]> {
        let i = self.keys.binary_search(key).ok()?;
        Some(&self.distances[i])
    }

    /// Memory of the blocks, MiB.
    pub fn memory_mib(&self) -> f64 {
        (self.keys.len() * BLOCK_BYTES) as f64 / 1_048_576.0
    }
}

/// Largest depths in squares of a view's map, 0 where there is none: what lies well behind them the view says
/// nothing about.
struct Farthest {
    width: usize,
    height: usize,
    depths: Vec<f32>,
}

impl Farthest {
    /// Side of the squares, pixels: about what a block covers.
    const SIDE: usize = 8;

    fn new(view: &View) -> Self {
        let width = view.depth.width.div_ceil(Self::SIDE);
        let height = view.depth.height.div_ceil(Self::SIDE);
        let depths = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let from = [i % width, i / width].map(|k| k * Self::SIDE);
                let rows = from[1]..(from[1] + Self::SIDE).min(view.depth.height);
                let columns = from[0]..(from[0] + Self::SIDE).min(view.depth.width);
                rows.flat_map(|y| columns.clone().map(move |x| *view.depth.at(x, y)))
                    .fold(0.0, f32::max)
            })
            .collect();
        Self {
            width,
            height,
            depths,
        }
    }

    /// Whether the view may say something about the block with its first corner there and an edge, given how far behind
    /// its surface it speaks.
    fn reaches(&self, view: &View, corner: &Point3<f64>, edge: f64, behind: f64) -> bool {
        // A lens that distorts enlarges a block by less than this.
        const ENLARGED: f64 = 1.5;
        // The surface lies between pixels, and by so many footprints behind all of them.
        const MARGIN_PX: f64 = 2.0;
        const BEYOND_PX: f64 = 4.0;
        let half = Vector3::repeat(0.5 * edge);
        let (radius, in_cam) = (half.norm(), view.pose.apply(&(corner + half)));
        let near = in_cam.z - radius;
        if in_cam.z + radius <= 0.0 {
            return false;
        }
        let Some(pixel) = view.camera.project(&in_cam).filter(|_| near > 0.0) else {
            return true;
        };
        let slope = (in_cam.coords / in_cam.z).norm_squared();
        let reach = ENLARGED * slope * view.camera.focal_px() * radius / near + MARGIN_PX;
        let squares = |at: f64, count: usize| {
            let square = |at: f64| (at / Self::SIDE as f64).floor();
            let [low, end] =
                [square(at - reach), square(at + reach) + 1.0].map(|k| k.clamp(0.0, count as f64));
            low as usize..end as usize
        };
        let columns = squares(pixel.x, self.width);
        let farthest = squares(pixel.y, self.height)
            .flat_map(|y| &self.depths[y * self.width..][columns.clone()])
            .fold(0.0, |far, &z| f32::max(far, z));
        let farthest = f64::from(farthest) * (1.0 + BEYOND_PX / view.camera.focal_px());
        farthest > 0.0 && near - farthest <= behind
    }
}

/// Median pixel footprint of the surface in all views.
fn median_footprint(views: &[View]) -> f64 {
    let mut footprints: Vec<f64> = views
        .iter()
        .flat_map(|v| {
            v.depth
                .data
                .iter()
                .step_by(7)
                .filter(|&&z| z > 0.0)
                .map(|&z| v.footprint(z.into()))
        })
        .collect();
    median(&mut footprints).unwrap_or(0.0)
}

/// Fuses the depth maps; `None` when no block is near any surface.
pub(crate) fn integrate(
    views: &[View],
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<Option<Volume>, FusionError> {
    let wanted = options.voxel_px * median_footprint(views);
    if wanted.is_nan() || wanted <= 0.0 {
        return Ok(None);
    }
    let origin = views
        .iter()
        .find_map(|v| {
            let i = v.depth.data.iter().position(|&z| z > 0.0)?;
            let (x, y) = (i % v.depth.width, i / v.depth.width);
            Some(v.point_to_world(&(v.ray(x, y) * f64::from(v.depth.data[i]))))
        })
        .unwrap_or_else(Point3::origin);
    let max_num_blocks = max_num_blocks(views, options);
    let mut coarsened_by = 1.0;
    let keys = loop {
        let voxel = wanted * coarsened_by;
        match block_keys(views, voxel, &origin, options, max_num_blocks) {
            Some(keys) => break keys,
            None => coarsened_by *= COARSEN,
        }
    };
    if keys.is_empty() {
        return Ok(None);
    }
    let mut volume = Volume {
        voxel: wanted * coarsened_by,
        origin,
        keys,
        distances: Vec::new(),
        coarsened_by,
    };
    let truncation = options.truncation_voxels * volume.voxel;
    let min_cosine = options.max_grazing_deg.to_radians().cos();
    let edge = SIDE as f64 * volume.voxel;
    let farthest: Vec<Farthest> = views.iter().map(Farthest::new).collect();
    // Batches let the observer speak between them.
    const BATCH: usize = 4096;
    for (batch, keys) in volume.keys.chunks(BATCH).enumerate() {
        let flow = observer.progress(
            StageId::Fusion,
            "averaging signed distances",
            (batch * BATCH, volume.keys.len()),
        );
        flow.ok_or(FusionError::Interrupted)?;
        let blocks: Vec<[f32; VOLUME]> = keys
            .par_iter()
            .map(|key| {
                let corner = origin + Vector3::from(key.map(|k| f64::from(k) * edge));
                let behind = MAX_BEHIND * truncation;
                let seen_by: Vec<&View> = views
                    .iter()
                    .zip(&farthest)
                    .filter(|(view, farthest)| farthest.reaches(view, &corner, edge, behind))
                    .map(|(view, _)| view)
                    .collect();
                fill(&seen_by, &corner, volume.voxel, truncation, min_cosine)
            })
            .collect();
        volume.distances.extend(blocks);
    }
    Ok(Some(volume))
}

fn pack(key: [i64; 3]) -> u64 {
    key.iter().fold(0, |packed, &k| {
        packed << 21 | (k + KEY_OFFSET) as u64 & 0x1f_ffff
    })
}

fn unpack(packed: u64) -> Key {
    [42, 21, 0].map(|shift| ((packed >> shift & 0x1f_ffff) as i64 - KEY_OFFSET) as i32)
}

/// Blocks within the truncation of any surface; `None` when there are more than allowed.
fn block_keys(
    views: &[View],
    voxel: f64,
    origin: &Point3<f64>,
    options: &FusionOptions,
    max_num_blocks: usize,
) -> Option<Vec<Key>> {
    let edge = voxel * SIDE as f64;
    let reach = options.truncation_voxels * voxel;
    let mut all: Vec<u64> = Vec::new();
    for view in views {
        let mut found: Vec<u64> = (0..view.depth.height)
            .into_par_iter()
            .flat_map_iter(|y| {
                let mut row = Vec::new();
                for x in 0..view.depth.width {
                    let Some(surface) = view.at(x, y).filter(|_| *view.gives.at(x, y)) else {
                        continue;
                    };
                    let at = view.point_to_world(&(view.ray(x, y) * surface.depth)) - origin;
                    let normal = view.to_world(&surface.normal);
                    // The band is thin along the normal, and a voxel wide across it.
                    let half = normal.map(|c| c.abs() * reach) + Vector3::repeat(voxel);
                    let low = ((at - half) / edge).map(|c| c.floor() as i64);
                    let high = ((at + half) / edge).map(|c| c.floor() as i64);
                    for i in low.x..=high.x {
                        for j in low.y..=high.y {
                            for k in low.z..=high.z {
                                let key = pack([i, j, k]);
                                if row.last() != Some(&key) {
                                    row.push(key);
                                }
                            }
                        }
                    }
                }
                row.sort_unstable();
                row.dedup();
                row
            })
            .collect();
        all.append(&mut found);
        all.sort_unstable();
        all.dedup();
        if all.len() > max_num_blocks {
            return None;
        }
    }
    Some(all.into_iter().map(unpack).collect())
}

/// Distances of the block with its first corner there, of the views that reach it.
fn fill(
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
            let Some(surface) = view.along(&in_cam) else {
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
            let weight = surface.confidence * (cosine * cosine).max(1e-4) / (footprint * footprint);
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
    use crate::views::prepare;
    use rilievo_synthetic::testing::sphere_world;

    #[test]
    fn views_that_do_not_reach_a_block_have_nothing_to_say_of_it() {
        let world = sphere_world();
        let options = FusionOptions::default();
        let (views, _) = prepare(&world.posed, &world.shaded, &options).expect("sound maps");
        let voxel = 0.2 * median_footprint(&views);
        let (edge, truncation) = (SIDE as f64 * voxel, options.truncation_voxels * voxel);
        let min_cosine = options.max_grazing_deg.to_radians().cos();
        // The sphere and what lies around and behind it.
        let near = block_keys(&views, voxel, &Point3::origin(), &options, usize::MAX)
            .expect("memory without bounds");
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
        for view in &views {
            let farthest = Farthest::new(view);
            for key in &keys {
                let corner = Point3::from(key.map(|k| f64::from(k) * edge));
                if farthest.reaches(view, &corner, edge, MAX_BEHIND * truncation) {
                    num_seen += 1;
                    continue;
                }
                num_left_out += 1;
                let said = fill(&[view], &corner, voxel, truncation, min_cosine);
                assert!(
                    said.iter().all(|&d| d == UNKNOWN),
                    "{} {key:?}",
                    view.posed_idx
                );
            }
        }
        assert!(
            num_seen > 100 && num_left_out > 100,
            "{num_left_out} {num_seen}"
        );
    }

    #[test]
    fn keys_survive_packing_in_order() {
        let keys = [[-5, 3, 0], [-5, 3, 1], [0, 0, 0], [7, -1_000_000, 12]];
        let mut packed: Vec<u64> = keys.iter().map(|k| pack(k.map(i64::from))).collect();
        for (key, packed) in keys.iter().zip(&packed) {
            assert_eq!(unpack(*packed), *key);
        }
        packed.sort_unstable();
        let unpacked: Vec<Key> = packed.into_iter().map(unpack).collect();
        assert!(unpacked.is_sorted());
    }
}
