//! Relief by tiles against the whole level, and on photos that tell nothing of it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::environment::{self, LightScene};
use super::light;
use super::options::{Effort, PhotoOptions};
use super::relief_tiles::{CoarseLight, ViewAtLevel, keep_unresolved, sample_cores};
use super::rendered_tests::{
    World, depths, known_light, loaded, of_spheres, options, photographed,
};
use super::report::PhotoReport;
use super::schedule::IterationWeights;
use super::shading::{PixelLight, ShadingTerm};
use super::shape::FineShape;
use super::steps::PhotoStep;
use super::{run, step};
use crate::error::ShadingError;
use crate::surroundings::Surroundings;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::robust::median;
use rilievo_scene::{
    Alone, Checkpoint, CheckpointError, InMemoryPixels, LightKind, LightSource, Lighting,
    LightingCalibration, LinearImage, MemoryScratch, NormalMap, Recorder, Silent,
    SphericalHarmonics, StatePart, ViewIdx, ViewLighting,
};
use rilievo_stereo::level::ViewGrid;
use rilievo_stereo::stored::StoredSurface;
use rilievo_stereo::surfaces::{Reading, Surfaces};
use rilievo_stereo::window::Window;
use rilievo_stereo::{between_levels, spread, tile};
use rilievo_synthetic::{LightModel, Subject};
use std::collections::BTreeMap;
use std::io::Read;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex};

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0_f64);
    for value in values {
        sum += value * value;
        count += 1.0;
    }
    (sum / count.max(1.0)).sqrt()
}

/// Columns and rows of the photos.
const SIZE: (usize, usize) = (400, 300);

/// Distance of a pixel to the nearest border between two cores, pixels.
fn from_seam(view: &ViewGrid, cores: &[Window], p: usize) -> usize {
    let (x, y) = view.place(p);
    let near = |v: usize, from: usize| v.abs_diff(from).min((v + 1).abs_diff(from));
    let distances = cores
        .iter()
        .flat_map(|core| [near(x, core.x0), near(y, core.y0)]);
    distances.min().unwrap_or(usize::MAX)
}

/// A round over tiles moves the surface as a step over the whole level does, and no seam shows.
#[test]
fn tiles_move_the_surface_as_the_whole_level_does() {
    const CORE_PX: usize = 96;
    let (scene, photographs) = options(Subject::Bust, LightModel::Shadowed, (480, 360));
    let world = photographed(scene, &photographs, None);
    let scene = loaded(&world);
    let [fine, coarse] = [&scene.pyramid[0], &scene.pyramid[1]];
    let reduced: Vec<Vec<f64>> = depths(&world, &scene)
        .iter()
        .enumerate()
        .map(|(i, depth)| between_levels::reduce(&fine.views[i], &coarse.views[i], depth))
        .collect();
    let light_scene = LightScene {
        known: &known_light(&world.photos, &world.posed, LightKind::World, &[]),
        ground: None,
        num_rays: 64,
        team: &Alone,
    };
    let light = environment::visible(coarse, &reduced, coarse, &light_scene)
        .unwrap()
        .unwrap();
    let start: Vec<Vec<f64>> = (0..fine.views.len())
        .map(|i| {
            let known = vec![true; reduced[i].len()];
            let (coarse, fine) = (&coarse.views[i], &fine.views[i]);
            between_levels::continued(coarse, fine, (&reduced[i], &known)).0
        })
        .collect();
    let weights = IterationWeights::with_shading(2, light.residual()).finer(false, true, 1.0);
    let options = weights.of_step(fine.focal(), 0.02);
    let i = 1;
    let view = &fine.views[i];

    let surfaces = Surfaces::new(fine, &start, Reading::Cubic);
    let harmonics = light::finer(&coarse.views[i], view, &light.harmonics[i]);
    let pigment = light.pigment_of(i);
    let pigment = pigment.map(|values| spread::spread(&coarse.views[i], view, values));
    let of_pixels = PixelLight {
        harmonics: harmonics.into(),
        pigment: pigment.map(Into::into),
        trust: None,
        mean_tolerance: light.mean_tolerance * coarse.focal() / fine.focal(),
        openness_exponent: light.openness_exponent.unwrap_or(0.0),
    };
    let shading = weights.shading.unwrap();
    let term = ShadingTerm::new(fine, i, &start[i], &surfaces.rasters, &of_pixels, &shading);
    let solver = PlateSolver::iterative(&view.pixels);
    let whole = step::improve(&surfaces, i, &solver, &start[i], Some(&term), &options).unwrap();
    let mut whole: Vec<f64> = whole
        .depth
        .iter()
        .zip(&start[i])
        .map(|(a, b)| a - b)
        .collect();
    keep_unresolved(&view.pixels, fine.focal(), &mut whole);

    let surface = StoredSurface::new(&scene.stored, 0, &MemoryScratch).unwrap();
    for (i, depth) in start.iter().enumerate() {
        let pixels = &fine.views[i].pixels;
        surface.put(i, pixels, depth, None).unwrap();
    }
    let (shape, sharpness) = (FineShape { at: 0, surface }, [1.0; 4]);
    let mut of_view = ViewAtLevel {
        level: &scene.stored_level(&shape, &sharpness),
        index: i,
        reading: Reading::Cubic,
        light: &CoarseLight::new(coarse, 1, i, &light, light.own(i)),
        options: &options,
        shading,
    };
    let noise = of_view.chroma_noise(&sample_cores(view)).unwrap().unwrap();
    for (sampled, all) in noise.sigma.iter().zip(term.chroma_noise.sigma) {
        let expected = term.chroma_noise;
        assert!((sampled / all - 1.0).abs() < 0.15, "{noise:?} {expected:?}");
    }
    of_view.shading.chroma_noise = Some(term.chroma_noise);
    let cores = tile::cores(view, CORE_PX);
    assert!(cores.len() > 6, "{}", cores.len());
    let mut tiled = vec![0.0; whole.len()];
    for core in &cores {
        let step = of_view.step(core).unwrap();
        for (p, &place) in step.places.iter().enumerate() {
            let number = view.pixels.number[place as usize];
            tiled[number as usize] += f64::from(step.shares[p]) * step.increment[p];
        }
    }
    let inner = |p: &usize| !rilievo_stereo::surfaces::is_rim(view, *p);
    let miss = |p: usize| tiled[p] - whole[p];
    let (beside, away): (Vec<usize>, Vec<usize>) = (0..whole.len())
        .filter(inner)
        .partition(|&p| from_seam(view, &cores, p) < 4);
    let size = rms(whole.iter().copied());
    let [at_seams, elsewhere] = [&beside, &away].map(|list| rms(list.iter().map(|&p| miss(p))));
    println!("increments {size:.2e}, missed by {at_seams:.2e} at seams, {elsewhere:.2e} elsewhere");
    assert!(elsewhere < 0.1 * size, "{elsewhere} of {size}");
    assert!(
        at_seams < 1.5 * elsewhere + 0.01 * size,
        "{at_seams} {elsewhere}"
    );
}

/// Without and with relief at the photos' own pixels: median error of the normals and their median departure from a
/// surround of nine pixels, degrees.
fn errors(world: &World) -> [[f64; 2]; 2] {
    let lighting = of_spheres(&world.photos, &world.posed, LightKind::World);
    [0, PhotoOptions::default().num_relief_rounds].map(|num_relief_rounds| {
        let options = PhotoOptions {
            max_fine_pixels: 8000,
            num_relief_rounds,
            effort: Effort {
                coarse_pixels: 8000,
                num_rays: 64,
                ..Effort::default()
            },
            ..PhotoOptions::default()
        };
        let (shaded, report) = run(
            &world.photos,
            &world.posed,
            &lighting,
            &options,
            Surroundings::in_memory(&Silent),
        )
        .unwrap();
        let is_shaped = report
            .steps
            .iter()
            .any(|step| step.step == PhotoStep::Relief);
        assert_eq!(is_shaped, num_relief_rounds > 0);
        let (mut angles, mut rough) = (Vec::new(), Vec::new());
        for (view, truth) in shaded.views().unwrap().views.iter().zip(&world.views) {
            for (x, y) in inner_pixels(&truth.normal) {
                let (Some(n), Some(t)) = (view.normal.normal(x, y), truth.normal.normal(x, y))
                else {
                    continue;
                };
                angles.push(n.dot(&t).clamp(-1.0, 1.0).acos().to_degrees());
                let around = || (x - 4..=x + 4).flat_map(|x| (y - 4..=y + 4).map(move |y| (x, y)));
                let mean = around().filter_map(|(x, y)| view.normal.normal(x, y));
                let mean = mean
                    .fold(nalgebra::Vector3::zeros(), |sum, n| sum + n)
                    .normalize();
                rough.push(n.dot(&mean).clamp(-1.0, 1.0).acos().to_degrees());
            }
        }
        [angles, rough].map(|mut list| median(&mut list).unwrap())
    })
}

/// Pixels with an object all around.
fn inner_pixels(normal: &NormalMap) -> Vec<(usize, usize)> {
    let is_inner = |x: usize, y: usize| {
        (x - 8..=x + 8).step_by(4).all(|x| {
            (y - 8..=y + 8)
                .step_by(4)
                .all(|y| normal.normal(x, y).is_some())
        })
    };
    (8..normal.height - 8)
        .step_by(2)
        .flat_map(|y| (8..normal.width - 8).step_by(2).map(move |x| (x, y)))
        .filter(|&(x, y)| is_inner(x, y))
        .collect()
}

/// A plain ellipsoid with speckle and noise: what tells nothing of shape makes no relief.
#[test]
fn noise_is_no_relief() {
    let (mut scene, mut photographs) = options(Subject::Ellipsoid, LightModel::Shadowed, SIZE);
    (scene.relief, scene.speckle) = (0.0, 0.02);
    photographs.noise = 0.02;
    let [without, with] = errors(&photographed(scene, &photographs, None));
    println!("without {without:?}, with {with:?}");
    assert!(with[0] < 1.05 * without[0], "normals {without:?} {with:?}");
    assert!(
        with[1] < 1.25 * without[1],
        "roughness {without:?} {with:?}"
    );
}

/// A carved bust: its relief is found in sharp photos, and none is made up in blurred ones.
#[test]
fn a_blurred_photo_gains_no_relief() {
    let (mut scene, photographs) = options(Subject::Bust, LightModel::Shadowed, SIZE);
    scene.speckle = 0.02;
    let mut world = photographed(scene, &photographs, None);
    let [without, with] = errors(&world);
    println!("sharp: without {without:?}, with {with:?}");
    assert!(with[0] < 0.8 * without[0], "normals {without:?} {with:?}");
    for (photo, view) in world.photos.photos.iter_mut().zip(&world.views) {
        photo.pixels = Arc::new(InMemoryPixels(Arc::new(blurred(&view.image))));
    }
    let [without, with] = errors(&world);
    println!("blurred: without {without:?}, with {with:?}");
    assert!(with[0] < 1.05 * without[0], "normals {without:?} {with:?}");
    // What relief the blur has left may be found.
    assert!(with[1] < 1.1 * without[1], "roughness {without:?} {with:?}");
}

/// One thread with as little memory as the run can do with, so that solvers are made anew each time and views and tiles
/// come one by one, against two threads and any memory.
#[test]
fn neither_threads_nor_memory_change_the_relief() {
    let (scene, photographs) = options(Subject::Stone, LightModel::Shadowed, (240, 180));
    let world = photographed(scene, &photographs, None);
    let lighting = of_spheres(&world.photos, &world.posed, LightKind::World);
    let mut options = PhotoOptions {
        max_fine_pixels: 3000,
        num_outer_iterations: 1,
        effort: Effort {
            coarse_pixels: 3000,
            num_rays: 32,
            ..Effort::default()
        },
        ..PhotoOptions::default()
    };
    let solve = |options: &PhotoOptions| {
        let around = Surroundings::in_memory(&Silent);
        run(&world.photos, &world.posed, &lighting, options, around)
    };
    options.memory = Some(1);
    let needed = match solve(&options) {
        Err(ShadingError::OutOfMemory { needed_mib, .. }) => needed_mib << 20,
        other => panic!("{other:?}"),
    };
    let [one, two] = [(1, Some(needed)), (2, None)].map(|(num_threads, memory)| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads);
        let options = PhotoOptions {
            memory,
            ..options.clone()
        };
        pool.build().unwrap().install(|| solve(&options).unwrap())
    });
    let levels = one
        .1
        .steps
        .iter()
        .filter(|step| step.step == PhotoStep::Relief);
    assert!(levels.count() > 0, "no relief");
    assert!(
        one.0.views().unwrap() == two.0.views().unwrap(),
        "results differ"
    );
}

/// A state in memory; only some of the writes succeed.
#[derive(Default)]
struct Memory {
    parts: Mutex<BTreeMap<String, Vec<u8>>>,
    num_left: AtomicUsize,
}

impl Checkpoint for Memory {
    fn read(&self, part: &str) -> Option<Box<dyn Read>> {
        let content = self.parts.lock().unwrap().get(part)?.clone();
        Some(Box::new(std::io::Cursor::new(content)))
    }

    fn keep(&self, parts: &[StatePart<'_>]) -> Result<(), CheckpointError> {
        let takes = |left: usize| left.checked_sub(1);
        if self.num_left.fetch_update(Relaxed, Relaxed, takes).is_err() {
            let reason = "full".to_owned();
            return Err(CheckpointError { reason });
        }
        for part in parts {
            let mut content = Vec::new();
            (part.write)(&mut content).unwrap();
            let mut kept = self.parts.lock().unwrap();
            kept.insert(part.name.to_owned(), content);
        }
        Ok(())
    }
}

/// Stopped after any state that was kept, in outer iterations, between levels and within relief, a run goes on from
/// there and ends with the bytes of an undisturbed one; a state that cannot be read is none.
#[test]
fn a_stopped_run_goes_on_to_the_same_bytes() {
    let (scene, photographs) = options(Subject::Stone, LightModel::Shadowed, (240, 180));
    let world = photographed(scene, &photographs, None);
    let lighting = of_spheres(&world.photos, &world.posed, LightKind::World);
    let options = PhotoOptions {
        max_fine_pixels: 3000,
        num_outer_iterations: 2,
        effort: Effort {
            coarse_pixels: 1000,
            // Half the resolution first.
            noisy_search_px: 0.0,
            num_half_iterations: 1,
            max_more_iterations: 0,
            num_rays: 32,
            ..Effort::default()
        },
        ..PhotoOptions::default()
    };
    let solve = |memory: &Memory, num_writes: usize| {
        memory.num_left.store(num_writes, Relaxed);
        let (photos, posed) = (&world.photos, &world.posed);
        let around = Surroundings {
            checkpoint: memory,
            ..Surroundings::in_memory(&Silent)
        };
        let solved = run(photos, posed, &lighting, &options, around);
        solved.map(|(shaped, report)| (shaped.views().unwrap(), report))
    };
    let kinds = |report: &PhotoReport| -> Vec<(usize, PhotoStep)> {
        let steps = report.steps.iter();
        steps.map(|s| (s.level, s.step)).collect()
    };
    let memory = Memory::default();
    let (whole, report) = solve(&memory, 1000).unwrap();
    let num_states = 1000 - memory.num_left.load(Relaxed);
    assert!(num_states >= 6, "{num_states} states");
    for of in [
        PhotoStep::LightAndShape,
        PhotoStep::Finer,
        PhotoStep::Relief,
    ] {
        assert!(kinds(&report).iter().any(|(_, step)| *step == of), "{of:?}");
    }
    for num_writes in 1..num_states {
        let memory = Memory::default();
        let stopped = solve(&memory, num_writes);
        assert!(
            matches!(stopped, Err(ShadingError::Checkpoint(_))),
            "{num_writes}"
        );
        let (resumed, again) = solve(&memory, 1000).unwrap();
        assert!(resumed == whole, "after {num_writes} states");
        assert_eq!(kinds(&again), kinds(&report), "after {num_writes} states");
        let num_more = 1000 - memory.num_left.load(Relaxed);
        assert_eq!(num_writes + num_more, num_states);
    }
    let memory = Memory::default();
    assert!(solve(&memory, num_states - 1).is_err());
    for content in memory.parts.lock().unwrap().values_mut() {
        content.truncate(content.len() / 2);
    }
    assert!(solve(&memory, 1000).unwrap().0 == whole, "after damage");
}

/// A light from behind, which no visible surface shows, used all the same: the warning is told before the first state is
/// kept, and again when the run goes on.
#[test]
fn what_a_stopped_run_warned_of_is_told_again() {
    let (scene, photographs) = options(Subject::Stone, LightModel::Shadowed, (240, 180));
    let world = photographed(scene, &photographs, None);
    let behind = SphericalHarmonics([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let lighting = LightingCalibration {
        source: LightSource::Given,
        views: (0..world.posed.views.len())
            .map(|i| ViewLighting {
                view: ViewIdx(i),
                lighting: Lighting {
                    channels: vec![behind; 3],
                },
                residual: None,
                gain: vec![1.0; 3],
            })
            .collect(),
        ..of_spheres(&world.photos, &world.posed, LightKind::World)
    };
    let options = PhotoOptions {
        num_outer_iterations: 1,
        num_relief_rounds: 0,
        trust_lighting: true,
        effort: Effort {
            coarse_pixels: 3000,
            max_more_iterations: 0,
            num_rays: 32,
            ..Effort::default()
        },
        ..PhotoOptions::default()
    };
    let memory = Memory::default();
    let warnings = |num_writes: usize| {
        memory.num_left.store(num_writes, Relaxed);
        let told = Recorder::default();
        let (photos, posed) = (&world.photos, &world.posed);
        let around = Surroundings {
            checkpoint: &memory,
            ..Surroundings::in_memory(&told)
        };
        let ended = run(photos, posed, &lighting, &options, around).is_ok();
        assert_eq!(ended, num_writes > 1);
        told.warnings()
    };
    let first = warnings(1);
    assert!(first.iter().any(|w| w.contains("contradicts")), "{first:?}");
    assert_eq!(warnings(1000), first);
}

/// Means of 7×7 pixels, twice.
fn blurred(image: &LinearImage) -> LinearImage {
    let mut out = image.clone();
    for _ in 0..2 {
        let from = out.clone();
        for y in 3..image.height - 3 {
            for x in 3..image.width - 3 {
                let mut sum = [0.0; 3];
                for (x, y) in (x - 3..=x + 3).flat_map(|x| (y - 3..=y + 3).map(move |y| (x, y))) {
                    for (s, v) in sum.iter_mut().zip(from.pixel(x, y)) {
                        *s += v / 49.0;
                    }
                }
                out.pixel_mut(x, y).copy_from_slice(&sum);
            }
        }
    }
    out
}
