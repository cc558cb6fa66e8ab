//! What a run will cost, told before it begins: CPU time, memory, disk.
//!
//! Costs are proportional to pixels of photos or of the object, or to photos and pairs. The factors were measured with
//! `benches/scale` and on photos of 18 megapixels (`benches/EXPERIMENTS.md`), and are scaled by how fast this machine
//! solves a small system against the one that they were measured on.

use super::inputs::{Inputs, PhotoInput};
use super::parallel::Resources;
use super::request::Request;
use crate::cost::{Cost, Estimate};
use crate::observe::{Console, ExpectedStep};
use crate::system::cpu_seconds;
use rayon::prelude::*;
use rilievo_fusion::{FusionOptions, MeshFormat};
use rilievo_io::{photo_size, read_mask};
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::plate_system::{PixelNumbering, PlateSystem};
use rilievo_scene::{Mask, StageId};
use rilievo_shading::photo::{self, PhotoStep, Sizes};

/// Masks that are looked at for the object's share.
const MAX_NUM_MASKS: usize = 4;
/// Seconds that the calibration takes on the machine that the factors were measured on.
const REFERENCE_SECONDS: f64 = 0.013;

/// What follows the stages, as its progress is told.
pub const REPORT: &str = "report";
pub const WRITING: &str = "writing the report";

/// Steps that one thread does for the most part.
const ON_ONE_THREAD: [&str; 6] = [
    "loading maps",
    "joining the surface",
    "making a light mesh",
    "laying the surface out",
    "filling the textures' gaps",
    WRITING,
];

/// Share of the photos that the object takes where no mask tells it yet.
const TYPICAL_SHARE: f64 = 0.25;

/// Pixels of a crop over those of the object in it.
const CROP_SHARE: f64 = 1.5;

/// What decides the cost.
#[derive(Clone, Debug)]
struct Work {
    photos: f64,
    /// Pixels of all photos.
    photo_px: f64,
    sizes: Sizes,
    /// Pixels of the object in all photos.
    object_px: f64,
    /// The steps of stage 5's photo model.
    shading: Vec<photo::ExpectedStep>,
    pairs: f64,
    /// Triangles of the asset, 0 where none is made.
    asset_faces: f64,
    /// Bytes of cloud and mesh for a pixel of the surface.
    surface_bytes: f64,
}

/// What a request is expected to cost, told to the user with the forecast that it will take up to a stage; `None` where
/// no photo tells its size.
pub fn expect(
    request: &Request,
    inputs: &Inputs,
    resources: Resources,
    until: StageId,
    console: &Console,
) -> Option<Estimate> {
    let work = Work::of(request, inputs, 1.0)?;
    let slowness = slowness();
    let expected = work.estimate(request, resources, slowness);
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
    console.expect(in_time(work.steps(), until, slowness), 0.0);
    Some(expected)
}

/// The forecast of a run that proposes masks for itself after the poses, and begins again with them.
pub fn expect_with_masks(request: &Request, inputs: &Inputs, until: StageId, console: &Console) {
    let slowness = slowness();
    let steps_with = |object_share, until| {
        let work = Work::of(request, inputs, object_share);
        work.map_or(Vec::new(), |work| in_time(work.steps(), until, slowness))
    };
    let later = steps_with(TYPICAL_SHARE, until);
    let later = later.iter().filter(|step| !step.is_optional);
    let later = later.map(|step| step.seconds).sum();
    console.expect(steps_with(1.0, StageId::Poses), later);
}

/// The steps up to a stage, with seconds on this machine's threads.
fn in_time(steps: Vec<ExpectedStep>, until: StageId, slowness: f64) -> Vec<ExpectedStep> {
    let threads = |step: &ExpectedStep| match ON_ONE_THREAD.contains(&step.step) {
        true => 1.0,
        false => rayon::current_num_threads().max(1) as f64,
    };
    let of_stage = |step: &ExpectedStep| {
        StageId::ALL
            .into_iter()
            .find(|stage| stage.name() == step.of)
    };
    let steps = steps.into_iter();
    steps
        .filter(|step| of_stage(step).is_none_or(|stage| stage <= until))
        .map(|step| ExpectedStep {
            seconds: slowness * step.seconds / threads(&step),
            ..step
        })
        .collect()
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
    /// The object takes a share of photos that have no masks.
    fn of(request: &Request, inputs: &Inputs, unmasked_share: f64) -> Option<Self> {
        let size = |photo: &PhotoInput| photo_size(&photo.path).map(|(w, h)| (w * h) as f64);
        let sizes: Vec<f64> = inputs.photos.par_iter().filter_map(size).collect();
        if sizes.is_empty() {
            return None;
        }
        let photos = inputs.photos.len() as f64;
        // Photos whose header does not tell are like the others.
        let photo_px = sizes.iter().sum::<f64>() * photos / sizes.len() as f64;
        let object_px = object_share(inputs).unwrap_or(unmasked_share) * photo_px;
        let sizes = Sizes {
            num_views: inputs.photos.len(),
            crops: CROP_SHARE * object_px,
            masked: object_px,
            largest_frame: sizes.iter().copied().fold(0.0, f64::max),
        };
        let all_pairs = 0.5 * photos * (photos - 1.0);
        Some(Self {
            photos,
            photo_px,
            shading: photo::forecast(&sizes, &request.options.shading.photo),
            sizes,
            object_px,
            pairs: if photos > 20.0 {
                all_pairs.min(6.0 * photos * photos.log2())
            } else {
                all_pairs
            },
            surface_bytes: surface_bytes(&request.options.fusion),
            asset_faces: match request.options.fusion.makes_asset() {
                true => request.options.fusion.asset_faces as f64,
                false => 0.0,
            },
        })
    }

    fn estimate(&self, request: &Request, resources: Resources, slowness: f64) -> Estimate {
        let seconds = |is_counted: &dyn Fn(&ExpectedStep) -> bool| {
            let steps = self.steps().into_iter();
            slowness * steps.filter(is_counted).map(|p| p.seconds).sum::<f64>()
        };
        let is_needed =
            |step: &ExpectedStep| !step.is_optional && step.step != PhotoStep::Relief.message();
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
                cpu_seconds: seconds(&|_| true),
                peak_memory_bytes: needed.min(given),
                disk_bytes: self.disk_bytes(),
            },
            least_cpu_seconds: seconds(&is_needed),
            working_disk_bytes: 45.0 * self.object_px,
        }
    }

    /// The steps of a run, with CPU seconds of the reference machine.
    fn steps(&self) -> Vec<ExpectedStep> {
        let (n, photo_px, object_px) = (self.photos, self.photo_px, self.object_px);
        let of = |of: StageId, step, seconds| ExpectedStep {
            of: of.name(),
            step,
            seconds,
            is_optional: false,
        };
        let mut steps = vec![
            of(StageId::Photos, "reading photos", 6.5e-8 * photo_px),
            of(
                StageId::Features,
                "detecting keypoints",
                0.55 * n + 1.2e-7 * photo_px,
            ),
            of(StageId::Features, "matching pairs", 0.12 * self.pairs),
            of(
                StageId::Poses,
                "registering photos",
                0.5 * n + 1.9e-7 * photo_px,
            ),
            of(StageId::Poses, "growing anchors", 0.2 * n),
            of(StageId::Lighting, "reading the sphere", 0.15 * n),
            of(
                StageId::Lighting,
                "reading brightness at the anchors",
                0.05 * n + 3e-8 * photo_px,
            ),
        ];
        steps.extend(self.shading.iter().map(|expected| ExpectedStep {
            is_optional: expected.is_optional,
            ..of(
                StageId::Shading,
                expected.step.message(),
                expected.cpu_seconds,
            )
        }));
        steps.extend([
            of(
                StageId::Shading,
                "writing maps, comparing them with the photos",
                6e-7 * photo_px + 3e-6 * object_px,
            ),
            of(StageId::Fusion, "loading maps", 2.2e-6 * object_px),
            of(StageId::Fusion, "gathering points", 2.3e-6 * object_px),
            of(
                StageId::Fusion,
                "averaging signed distances",
                5.3e-6 * object_px,
            ),
            of(
                StageId::Fusion,
                "extracting the surface",
                1.4e-6 * object_px,
            ),
            of(StageId::Fusion, "joining the surface", 2.3e-6 * object_px),
        ]);
        if self.asset_faces > 0.0 {
            steps.extend([
                of(StageId::Fusion, "making a light mesh", 1.2e-6 * object_px),
                of(
                    StageId::Fusion,
                    "laying the surface out",
                    2.6e-5 * self.asset_faces,
                ),
                of(
                    StageId::Fusion,
                    "finding what the sky reaches",
                    2.9e-5 * self.asset_faces,
                ),
                of(StageId::Fusion, "baking textures", 2.1e-6 * object_px),
                of(
                    StageId::Fusion,
                    "filling the textures' gaps",
                    2.3e-6 * object_px,
                ),
            ]);
        }
        steps.push(ExpectedStep {
            of: REPORT,
            step: WRITING,
            seconds: 0.3 * n + 2.4e-7 * photo_px,
            is_optional: false,
        });
        steps
    }

    /// Photos, maps, what the report shows of each photo; and cloud and mesh, as large as the surface that is seen:
    /// photos that go on around the object add to it, those between them do not.
    fn disk_bytes(&self) -> f64 {
        const PHOTOS_AROUND: f64 = 14.0;
        let surface = (self.photos / PHOTOS_AROUND).sqrt().min(1.0) * self.object_px / self.photos;
        6.0 * self.photo_px
            + 45.0 * self.object_px
            + 4.5e6 * self.photos
            + self.surface_bytes * surface
            + 200.0 * self.asset_faces
    }
}

/// Bytes of cloud and mesh for a pixel of the surface that is seen.
fn surface_bytes(options: &FusionOptions) -> f64 {
    let has = |format| f64::from(u8::from(options.formats.contains(&format)));
    let mesh = 345.0 + 1140.0 * has(MeshFormat::Obj) + 365.0 * has(MeshFormat::Glb);
    // What is left of the demo's triangles where flat places are coarser.
    let share = if options.full { 1.0 } else { 0.15 };
    440.0 + share * mesh
}

/// Share of the object in the photos, by some of the masks; `None` where there are none.
fn object_share(inputs: &Inputs) -> Option<f64> {
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
    (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / shares.len() as f64)
}

/// How much longer this machine takes than the one that the factors were measured on: the best of a few small systems,
/// by CPU time, so that other programs at work do not count.
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
