//! What a run will cost, told before it begins: CPU time, memory, disk.
//!
//! Costs are proportional to pixels of photos or of the object, or to photos and pairs. The factors were measured with
//! `benches/scale` and on photos of 18 megapixels (`benches/EXPERIMENTS.md`), and are scaled by how fast this machine
//! solves a small system against the one that they were measured on.

use super::inputs::{Inputs, PhotoInput};
use super::parallel::Resources;
use super::request::Request;
use crate::cost::{Cost, Estimate};
use crate::observe::Console;
use crate::system::cpu_seconds;
use rayon::prelude::*;
use rilievo_io::{photo_size, read_mask};
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::plate_system::{PixelNumbering, PlateSystem};
use rilievo_scene::Mask;
use rilievo_shading::photo::Sizes;

/// Photos without a mask are counted as if the object filled them; masks that are looked at for the object's share.
const MAX_NUM_MASKS: usize = 4;
/// Seconds that the calibration takes on the machine that the factors were measured on.
const REFERENCE_SECONDS: f64 = 0.013;

/// Pixels of a crop over those of the object in it.
const CROP_SHARE: f64 = 1.5;

/// What decides the cost.
#[derive(Clone, Copy, Debug)]
struct Work {
    photos: f64,
    /// Pixels of all photos.
    photo_px: f64,
    sizes: Sizes,
    /// Pixels of the object in all photos.
    object_px: f64,
    /// Pixels of the object in all photos at the finest level that is solved as a whole.
    whole_px: f64,
    /// The same at the level at which the surface is found.
    coarse_px: f64,
    pairs: f64,
}

/// What a request is expected to cost, told to the user; `None` where no photo tells its size.
pub fn expect(
    request: &Request,
    inputs: &Inputs,
    resources: Resources,
    console: &Console,
) -> Option<Estimate> {
    let work = Work::of(request, inputs)?;
    let expected = work.estimate(request, resources, slowness());
    let (cost, threads) = (&expected.cost, rayon::current_num_threads());
    let minutes = |seconds: f64| (seconds / threads.max(1) as f64 / 60.0).ceil();
    let (least, most) = (expected.least_cpu_seconds, cost.cpu_seconds);
    console.note(&format!(
        "expected: {} CPU s (about {} min on {threads} threads), {:.1} GB of memory, {:.1} GB on disk and {:.1} GB more while \
         it works",
        span(least, most),
        span(minutes(least), minutes(most)),
        1e-9 * cost.peak_memory_bytes,
        1e-9 * cost.disk_bytes,
        1e-9 * expected.working_disk_bytes,
    ));
    Some(expected)
}

/// "3 to 5", or "4" where both are the same.
fn span(least: f64, most: f64) -> String {
    let (least, most) = (format!("{least:.0}"), format!("{most:.0}"));
    if least == most {
        return most;
    }
    format!("{least} to {most}")
}

impl Work {
    fn of(request: &Request, inputs: &Inputs) -> Option<Self> {
        let size = |photo: &PhotoInput| photo_size(&photo.path).map(|(w, h)| (w * h) as f64);
        let sizes: Vec<f64> = inputs.photos.par_iter().filter_map(size).collect();
        if sizes.is_empty() {
            return None;
        }
        let photos = inputs.photos.len() as f64;
        // Photos whose header does not tell are like the others.
        let photo_px = sizes.iter().sum::<f64>() * photos / sizes.len() as f64;
        let object_px = object_share(inputs) * photo_px;
        let sizes = Sizes {
            num_views: inputs.photos.len(),
            crops: CROP_SHARE * object_px,
            masked: object_px,
            largest_frame: sizes.iter().copied().fold(0.0, f64::max),
        };
        let options = &request.options.shading.photo;
        let whole_px = sizes.whole_share(options) * object_px;
        let coarse_px = sizes.coarse_share(options) * object_px;
        let all_pairs = 0.5 * photos * (photos - 1.0);
        Some(Self {
            photos,
            photo_px,
            sizes,
            object_px,
            whole_px,
            coarse_px,
            pairs: if photos > 20.0 {
                all_pairs.min(6.0 * photos * photos.log2())
            } else {
                all_pairs
            },
        })
    }

    fn estimate(&self, request: &Request, resources: Resources, slowness: f64) -> Estimate {
        // CPU seconds of the reference machine: photos read and lit, keypoints, pairs, poses with anchors, levels that are
        // solved as a whole (at the coarse one light and shape take turns), points and mesh.
        let without_relief = 1.3e-7 * self.photo_px
            + 3.9e-7 * self.photo_px
            + 0.12 * self.pairs
            + 2.5e-7 * self.photo_px
            + self.photos
            + 3.2e-4 * self.coarse_px
            + 0.8e-4 * (self.whole_px - self.coarse_px)
            + 1.35e-5 * self.object_px;
        // Levels between the one that is solved as a whole and the photo's own, a third more than the last of them.
        let relief = 12e-6 * 4.0 / 3.0 * (self.object_px - self.whole_px).max(0.0);
        let given = resources.given.map_or(f64::INFINITY, |given| given as f64);
        let threads = rayon::current_num_threads();
        let shading = self.sizes.taken(&request.options.shading.photo, threads);
        let fusion = (request.options.fusion.memory_mib << 20) as f64;
        let detection = 45.0 * self.sizes.largest_frame * threads as f64;
        let needed = shading
            .max(detection)
            .max(fusion.min(0.2e9 + 26.0 * self.object_px));
        Estimate {
            cost: Cost {
                cpu_seconds: slowness * (without_relief + relief),
                peak_memory_bytes: needed.min(given),
                disk_bytes: self.disk_bytes(),
            },
            least_cpu_seconds: slowness * without_relief,
            working_disk_bytes: 45.0 * self.object_px,
        }
    }
}

impl Work {
    /// Photos, maps, what the report shows of each photo; and cloud and mesh, as large as the surface that is seen: photos
    /// that go on around the object add to it, those between them do not.
    fn disk_bytes(&self) -> f64 {
        const PHOTOS_AROUND: f64 = 14.0;
        let surface = (self.photos / PHOTOS_AROUND).sqrt().min(1.0) * self.object_px / self.photos;
        6.0 * self.photo_px + 45.0 * self.object_px + 4.5e6 * self.photos + 2200.0 * surface
    }
}

/// Share of the object in the photos, by some of the masks.
fn object_share(inputs: &Inputs) -> f64 {
    let masks: Vec<_> = inputs
        .photos
        .iter()
        .filter_map(|p| p.mask.as_ref())
        .collect();
    let step = masks.len().div_ceil(MAX_NUM_MASKS).max(1);
    let some: Vec<_> = masks.into_iter().step_by(step).collect();
    let shares: Vec<f64> = some
        .par_iter()
        .filter_map(|(path, _)| read_mask(path).ok())
        .map(|mask| {
            let masked = mask.data.iter().filter(|&&is| is).count();
            masked as f64 / mask.data.len().max(1) as f64
        })
        .collect();
    if shares.is_empty() {
        return 1.0;
    }
    shares.iter().sum::<f64>() / shares.len() as f64
}

/// How much longer this machine takes than the one that the factors were measured on: the best of a few small systems, by
/// CPU time, so that other programs at work do not count.
fn slowness() -> f64 {
    const SIDE: usize = 96;
    let numbering = PixelNumbering::new(&Mask::filled(SIDE, SIDE, true));
    let mut system = PlateSystem::new(numbering.len());
    for i in 0..numbering.len() {
        system.add_point(i, 1.0, i as f64);
    }
    let seconds = (0..5).map(|_| {
        let before = cpu_seconds();
        let solved = PlateSolver::direct(&numbering).and_then(|solver| solver.solve(&system));
        // A system of ones is always solved; what it gives is not looked at.
        drop(solved);
        cpu_seconds() - before
    });
    seconds.fold(f64::INFINITY, f64::min) / REFERENCE_SECONDS
}
