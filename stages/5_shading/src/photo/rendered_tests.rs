//! Light, pigment, validation and outputs on rendered scenes with known truth.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::environment::{self, LightScene};
use super::known_light::KnownLight;
use super::light::Light;
use super::options::{Effort, PhotoOptions};
use super::report::PhotoReport;
use super::validation::validate;
use super::views::{self, Scene};
use super::{distant, shading};
use crate::surroundings::Surroundings;
use nalgebra::{Point2, Point3};
use rilievo_numerics::solver_set::SolverSet;
use rilievo_photometry::samples::read_spheres;
use rilievo_scene::{
    Alone, FocalSource, InMemoryPixels, LightKind, LightSource, LightingCalibration, LocatedSphere,
    MarkedSphere, MemoryScratch, Orientation, Photo, PhotoIdx, PhotoSet, PosedView, PosedViews,
    ShadedViews, Silent, SphereLight,
};
use rilievo_stereo::level::Level;
use rilievo_stereo::plate;
use rilievo_stereo::window::Window;
use rilievo_synthetic::{LightModel, RenderOptions, RenderedView, Renderer, SceneOptions, Subject};
use std::sync::Arc;

/// Brownish stains in space: relative albedo of a world point.
fn stain(p: &Point3<f64>) -> [f64; 3] {
    let wave = |a: f64, b: f64, c: f64| (60.0 * (a * p.x + b * p.y + c * p.z)).sin();
    let s = wave(1.0, 0.4, 0.6) + wave(-0.5, 0.8, 0.7) + wave(0.3, -0.7, 0.9);
    // Soft edges over about a centimetre.
    let depth = 0.35 * ((s - 0.6) / 0.5).clamp(0.0, 1.0);
    [0.6, 1.0, 1.4].map(|k| (1.0_f64 - depth).powf(k))
}

pub(super) struct World {
    pub views: Vec<RenderedView>,
    pub photos: PhotoSet,
    pub posed: PosedViews,
}

/// Relative albedo of a world point.
type Pigment = fn(&Point3<f64>) -> [f64; 3];

fn world(
    subject: Subject,
    light: LightModel,
    pigment: Option<Pigment>,
    size: (usize, usize),
) -> World {
    let (scene, options) = options(subject, light, size);
    photographed(scene, &options, pigment)
}

/// Options of scene and photographs: four views, fifty degrees.
pub(super) fn options(
    subject: Subject,
    light: LightModel,
    (width, height): (usize, usize),
) -> (SceneOptions, RenderOptions) {
    let scene = SceneOptions {
        seed: 5,
        subject,
        speckle: 0.01,
        mesh_spacing_m: 0.003,
        ..SceneOptions::default()
    };
    let photographs = RenderOptions {
        num_views: 4,
        width,
        height,
        arc_deg: 50.0,
        light,
        noise: 0.003,
        edge_samples: 2,
        ..RenderOptions::default()
    };
    (scene, photographs)
}

pub(super) fn photographed(
    scene: SceneOptions,
    options: &RenderOptions,
    pigment: Option<Pigment>,
) -> World {
    let scene = rilievo_synthetic::Scene::new(scene).unwrap();
    let renderer = Renderer::new(&scene, options).unwrap();
    let (mut photos, mut posed) = (PhotoSet::default(), PosedViews::default());
    let mut views = Vec::new();
    for i in 0..renderer.num_views() {
        let mut view = renderer.render(i).unwrap();
        if let Some(pigment) = pigment {
            let world_from_cam = view.cam_from_world.inverse();
            for y in 0..view.depth.height {
                for x in 0..view.depth.width {
                    let z = f64::from(*view.depth.at(x, y));
                    if z > 0.0 {
                        let pixel = Point2::new(x as f64, y as f64);
                        let a =
                            pigment(&world_from_cam.apply(&view.intrinsics.unproject(&pixel, z)));
                        for (v, a) in view.image.pixel_mut(x, y).iter_mut().zip(a) {
                            *v *= a as f32;
                        }
                    }
                }
            }
        }
        photos.photos.push(Photo {
            file_name: format!("{}.jpg", view.name),
            name: view.name.clone(),
            pixels: Arc::new(InMemoryPixels(Arc::new(view.image.clone()))),
            intrinsics: view.intrinsics,
            focal_source: FocalSource::CameraFile,
            camera_group: 0,
            orientation: Orientation::UPRIGHT,
            mask: Some(Arc::new(view.object_mask.packed())),
            clip_level: 0.99,
            given_cam_from_world: None,
        });
        posed.views.push(PosedView {
            photo: PhotoIdx(i),
            name: view.name.clone(),
            file_name: format!("{}.jpg", view.name),
            intrinsics: view.intrinsics,
            cam_from_world: view.cam_from_world,
        });
        views.push(view);
    }
    for sphere in &scene.spheres {
        posed.spheres.push(LocatedSphere {
            name: MarkedSphere::ONLY.to_owned(),
            center_in_world: sphere.center_in_world,
            radius: sphere.radius,
            center_sigma: [0.0; 3],
            seen_in: Vec::new(),
        });
    }
    World {
        views,
        photos,
        posed,
    }
}

/// Grain of about a centimetre.
fn grain(p: &Point3<f64>) -> [f64; 3] {
    let wave = |a: f64, b: f64, c: f64| (600.0 * (a * p.x + b * p.y + c * p.z)).sin();
    let s = wave(1.0, 0.4, 0.6) + wave(-0.5, 0.8, 0.7) + wave(0.3, -0.7, 0.9);
    [(0.04 * s).exp(); 3]
}

/// Brightens and darkens every photo in a pattern of its own, as gloss and bounce do.
fn disturb(world: &mut World) {
    for (i, photo) in world.photos.photos.iter_mut().enumerate() {
        let mut image = world.views[i].image.clone();
        let phase = i as f64;
        for y in 0..image.height {
            for x in 0..image.width {
                let (along, down) = (0.2 * x as f64 + 1.7 * phase, 0.17 * y as f64 + 2.3 * phase);
                let factor = (0.12 * (along.sin() + down.sin())).exp() as f32;
                for value in image.pixel_mut(x, y) {
                    *value *= factor;
                }
            }
        }
        photo.pixels = Arc::new(InMemoryPixels(Arc::new(image)));
    }
}

pub(super) fn loaded(world: &World) -> Scene {
    let options = PhotoOptions::default();
    views::load(&world.photos, &world.posed, &options, &MemoryScratch).unwrap()
}

/// True log depths at full resolution.
pub(super) fn depths(world: &World, scene: &Scene) -> Vec<Vec<f64>> {
    let level = &scene.pyramid[0];
    level
        .views
        .iter()
        .zip(&scene.frames)
        .zip(&world.views)
        .map(|((view, frame), truth)| {
            (0..view.pixels.len())
                .map(|p| {
                    let x = view.pixels.xs[p] as usize + frame.corner.0;
                    let y = view.pixels.ys[p] as usize + frame.corner.1;
                    f64::from(*truth.depth.at(x, y)).ln()
                })
                .collect()
        })
        .collect()
}

/// What the spheres tell, those in `rejected` left out.
pub(super) fn known_light(
    photos: &PhotoSet,
    posed: &PosedViews,
    kind: LightKind,
    rejected: &[usize],
) -> KnownLight {
    let mut lighting = of_spheres(photos, posed, kind);
    lighting.spheres = (0..posed.spheres.len())
        .map(|k| SphereLight {
            name: String::new(),
            paint: (!rejected.contains(&k)).then(|| vec![1.0; 3]),
        })
        .collect();
    let gains = vec![[1.0; 3]; posed.views.len()];
    KnownLight::new(&lighting, &posed.spheres, &gains)
}

/// The light as the spheres' samples alone.
pub(super) fn of_spheres(
    photos: &PhotoSet,
    posed: &PosedViews,
    kind: LightKind,
) -> LightingCalibration {
    LightingCalibration {
        source: LightSource::Sphere,
        kind,
        environment_in_world: None,
        views: Vec::new(),
        spheres: Vec::new(),
        samples: read_spheres(photos, posed).unwrap(),
    }
}

fn by_rays(scene: &Scene, world: &World, depths: &[Vec<f64>]) -> Light {
    let level = &scene.pyramid[0];
    let rays_at = scene.pyramid.get(1).unwrap_or(level);
    let light_scene = LightScene {
        known: &known_light(&world.photos, &world.posed, LightKind::World, &[]),
        ground: None,
        num_rays: 128,
        team: &Alone,
    };
    environment::visible(level, depths, rays_at, &light_scene)
        .unwrap()
        .unwrap()
}

/// Median relative difference between light times pigment and the photos, away from the border.
pub(super) fn miss(level: &Level, depths: &[Vec<f64>], light: &Light) -> f64 {
    let mut all = Vec::new();
    for (i, view) in level.views.iter().enumerate() {
        let normals = plate::normals(view, &depths[i]);
        for p in (0..view.pixels.len()).step_by(3) {
            if rilievo_stereo::surfaces::is_rim(view, p) {
                continue;
            }
            let s = shading::render(&light.harmonics[i][p], normals[p]);
            let known = light.pigment_of(i).map_or([1.0; 3], |a| a[p]);
            let own = view.intensity(p);
            let (a, b) = (s[1] * f64::from(known[1]), f64::from(own[1]));
            all.push((a / b.max(1e-3) - 1.0).abs());
        }
    }
    rilievo_numerics::robust::median(&mut all).unwrap()
}

#[test]
fn light_is_recovered_with_and_without_shadow() {
    let size = (320, 240);
    let open = world(Subject::Bust, LightModel::Harmonics, None, size);
    let scene = loaded(&open);
    let truth = depths(&open, &scene);
    let nine = distant::fit(&scene.pyramid[0], &truth, LightKind::World).unwrap();
    let open_miss = miss(&scene.pyramid[0], &truth, &nine);
    let shadowed = world(Subject::Bust, LightModel::Bounce, None, size);
    let scene = loaded(&shadowed);
    let truth = depths(&shadowed, &scene);
    let level = &scene.pyramid[0];
    let nine = miss(
        level,
        &truth,
        &distant::fit(level, &truth, LightKind::World).unwrap(),
    );
    let rays = miss(level, &truth, &by_rays(&scene, &shadowed, &truth));
    println!("nine harmonics without shadow {open_miss:.4}, with {nine:.4}; rays {rays:.4}");
    assert!(open_miss < 0.02, "without shadow {open_miss}");
    assert!(
        rays < 0.75 * nine && rays < 0.04,
        "rays {rays}, nine harmonics {nine}"
    );
}

#[test]
fn photos_left_out_end_shading_under_a_wrong_light() {
    let world = world(Subject::Stone, LightModel::Bounce, None, (320, 240));
    let scene = loaded(&world);
    let level = &scene.pyramid[0];
    let truth = depths(&world, &scene);
    let right = by_rays(&scene, &world, &truth);
    // The same light from the other side.
    let mut wrong = right.clone();
    for pixel in wrong.harmonics.iter_mut().flatten() {
        for channel in pixel.iter_mut() {
            channel[0] = -channel[0];
            channel[1] = -channel[1];
        }
    }
    let solvers = SolverSet::direct(level.views.len(), true);
    let weights = super::schedule::IterationWeights::with_shading(2, 0.03);
    let options = weights.of_step(level.focal(), 0.01);
    let trust = |light: &Light| {
        let judged = validate(
            level,
            &solvers,
            &truth,
            light,
            (&weights.shading.unwrap(), &options),
            (&Alone, usize::MAX),
            |view, error| panic!("view {view}: {error}"),
        )
        .unwrap()
        .unwrap();
        let all: Vec<f32> = judged.trust.concat();
        let mean = all.iter().sum::<f32>() / all.len() as f32;
        println!("trust {mean:.3}, {:?}", judged.report);
        mean
    };
    let (right, wrong) = (trust(&right), trust(&wrong));
    assert!(right > 0.7, "trust in the right light {right}");
    assert!(wrong < 0.1, "trust in the wrong light {wrong}");
}

#[test]
fn stains_become_albedo_and_no_relief() {
    let world = world(Subject::Stone, LightModel::Bounce, Some(stain), (400, 300));
    let lighting = of_spheres(&world.photos, &world.posed, LightKind::World);
    let (shaded, report) = super::run(
        &world.photos,
        &world.posed,
        &lighting,
        &PhotoOptions::default(),
        Surroundings::in_memory(&Silent),
    )
    .unwrap();
    let (mut inside, mut outside) = (Vec::new(), Vec::new());
    let (mut ranked, mut pairs, mut differences) = (Vec::new(), Vec::new(), Vec::new());
    for (truth, view) in world.views.iter().zip(&shaded.views().unwrap().views) {
        let (albedo, rendered) = (
            view.albedo.as_ref().unwrap(),
            view.rendered.as_ref().unwrap(),
        );
        let confidence = view.confidence.as_ref().unwrap();
        let world_from_cam = truth.cam_from_world.inverse();
        for y in 0..truth.depth.height {
            for x in 0..truth.depth.width {
                let z = f64::from(*truth.depth.at(x, y));
                let (Some(a), Some(b)) = (truth.normal.normal(x, y), view.normal.normal(x, y))
                else {
                    continue;
                };
                let error = a.dot(&b).clamp(-1.0, 1.0).acos().to_degrees();
                let pixel = Point2::new(x as f64, y as f64);
                let p = world_from_cam.apply(&truth.intrinsics.unproject(&pixel, z));
                let known = stain(&p);
                if known[1] < 0.85 {
                    inside.push(error);
                } else {
                    outside.push(error);
                }
                let c = *confidence.at(x, y);
                assert!((0.0..=1.0).contains(&c), "confidence {c}");
                ranked.push((c, error));
                pairs.push((f64::from(albedo.pixel(x, y)[1]).ln(), known[1].ln()));
                let observed = truth.image.pixel(x, y)[1];
                differences.push(f64::from((rendered.pixel(x, y)[1] / observed - 1.0).abs()));
            }
        }
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (stained, clean) = (mean(&inside), mean(&outside));
    let correlation = correlation(&pairs);
    let difference = rilievo_numerics::robust::median(&mut differences).unwrap();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let quarter = ranked.len() / 4;
    let of = |part: &[(f32, f64)]| part.iter().map(|r| r.1).sum::<f64>() / part.len() as f64;
    let (worst, best) = (of(&ranked[..quarter]), of(&ranked[3 * quarter..]));
    println!(
        "normals {stained:.2} deg in stains, {clean:.2} elsewhere; albedo correlates {correlation:.3}; \
         rendered differs {difference:.4}; least confident quarter {worst:.2} deg, most {best:.2}; \
         pigment {:?}, {:?}",
        report.pigment, report.validation
    );
    assert!(
        stained < 1.25 * clean,
        "{stained} in stains, {clean} elsewhere"
    );
    assert!(correlation > 0.8, "albedo correlates {correlation}");
    assert!(difference < 0.032, "rendered differs by {difference}");
    assert!(worst > 1.5 * best, "least confident {worst}, most {best}");
}

/// Mean angle of the normals, degrees, and median relative depth error against the truth.
fn accuracy(world: &World, shaded: &ShadedViews) -> (f64, f64) {
    let (mean, ratio, _) = accuracy_where(world, shaded, |_| true);
    (mean, ratio)
}

/// The same of pixels that show what `counts` accepts, and their number.
fn accuracy_where(
    world: &World,
    shaded: &ShadedViews,
    counts: impl Fn(&[f32]) -> bool,
) -> (f64, f64, usize) {
    let (mut angles, mut ratios) = (Vec::new(), Vec::new());
    for (truth, view) in world.views.iter().zip(&shaded.views) {
        for y in 0..truth.depth.height {
            for x in 0..truth.depth.width {
                let z = f64::from(*truth.depth.at(x, y));
                let (Some(a), Some(b)) = (truth.normal.normal(x, y), view.normal.normal(x, y))
                else {
                    continue;
                };
                if !counts(truth.image.pixel(x, y)) {
                    continue;
                }
                angles.push(a.dot(&b).clamp(-1.0, 1.0).acos().to_degrees());
                ratios.push((f64::from(*view.depth.at(x, y)) / z - 1.0).abs());
            }
        }
    }
    let mean = angles.iter().sum::<f64>() / angles.len() as f64;
    let ratio = rilievo_numerics::robust::median(&mut ratios).unwrap();
    (mean, ratio, angles.len())
}

fn solved(world: &World) -> ShadedViews {
    solved_by(world, &PhotoOptions::default()).0
}

fn solved_by(world: &World, options: &PhotoOptions) -> (ShadedViews, PhotoReport) {
    let lighting = of_spheres(&world.photos, &world.posed, LightKind::World);
    let (shaped, report) = super::run(
        &world.photos,
        &world.posed,
        &lighting,
        options,
        Surroundings::in_memory(&Silent),
    )
    .unwrap();
    (shaped.views().unwrap(), report)
}

/// Photos that end inside the object: two fifths of it are beyond the left end of every other one, and beyond the upper end
/// of the rest.
fn cut_off(world: &mut World) {
    let photos = world.photos.photos.iter_mut().zip(&mut world.posed.views);
    for (i, ((photo, posed), view)) in photos.zip(&mut world.views).enumerate() {
        let object = Window::around(&view.object_mask, 0).unwrap();
        let (x0, y0) = if i % 2 == 0 {
            (object.x0 + 2 * object.width / 5, 0)
        } else {
            (0, object.y0 + 2 * object.height / 5)
        };
        let (width, height) = (view.image.width - x0, view.image.height - y0);
        view.image = view.image.cropped(x0, y0, width, height);
        view.object_mask = view.object_mask.cropped(x0, y0, width, height);
        view.depth = view.depth.cropped(x0, y0, width, height);
        view.normal = view.normal.cropped(x0, y0, width, height);
        view.intrinsics = view.intrinsics.cropped(x0, y0, width, height);
        posed.intrinsics = view.intrinsics;
        photo.intrinsics = view.intrinsics;
        photo.pixels = Arc::new(InMemoryPixels(Arc::new(view.image.clone())));
        photo.mask = Some(Arc::new(view.object_mask.packed()));
    }
}

#[test]
fn an_object_that_the_frames_cut_is_found() {
    let mut world = world(Subject::Stone, LightModel::Bounce, None, (320, 240));
    cut_off(&mut world);
    let (angle, depth) = accuracy(&world, &solved(&world));
    println!("cut off: {angle:.2} deg, depth {depth:.5}");
    // Whole photos give 4.6 degrees; depths that other photos' frames seem to forbid give 11.6.
    assert!(angle < 9.0 && depth < 0.001, "{angle} deg, {depth}");
}

#[test]
fn own_scenes_are_found_and_a_missing_view_changes_little() {
    let size = (240, 180);
    let bounce = world(Subject::Stone, LightModel::Bounce, None, size);
    let all = solved(&bounce);
    let scenes = [
        ("stone", LightModel::Shadowed, Subject::Stone, 9.0, 0.001),
        (
            "ellipsoid",
            LightModel::Bounce,
            Subject::Ellipsoid,
            6.0,
            0.001,
        ),
        ("bust", LightModel::Harmonics, Subject::Bust, 14.0, 0.0015),
    ];
    let (angle, depth) = accuracy(&bounce, &all);
    println!("stone with bounce: {angle:.2} deg, depth {depth:.5}");
    assert!(angle < 9.0 && depth < 0.001, "{angle} deg, {depth}");
    for (name, light, subject, max_angle, max_depth) in scenes {
        let scene = world(subject, light, None, size);
        let (angle, depth) = accuracy(&scene, &solved(&scene));
        println!("{name}: {angle:.2} deg, depth {depth:.5}");
        assert!(
            angle < max_angle && depth < max_depth,
            "{name}: {angle} deg, {depth}"
        );
    }
    // The third view, drawn by lot.
    let mut fewer = World {
        views: bounce.views.clone(),
        photos: bounce.photos.clone(),
        posed: bounce.posed.clone(),
    };
    fewer.views.remove(2);
    fewer.posed.views.remove(2);
    let without = solved(&fewer);
    let mut changes = Vec::new();
    for (i, view) in without.views.iter().enumerate() {
        let before = &all.views[if i < 2 { i } else { i + 1 }].depth;
        for (a, b) in view.depth.data.iter().zip(&before.data) {
            if *a > 0.0 && *b > 0.0 {
                changes.push(f64::from((a / b - 1.0).abs()));
            }
        }
    }
    let change = rilievo_numerics::robust::median(&mut changes).unwrap();
    let (fewer_angle, _) = accuracy(&fewer, &without);
    println!("without the third view: depth changes by {change:.5}, {fewer_angle:.2} deg");
    assert!(change < 0.0005, "depth changes by {change}");
    assert!(
        fewer_angle < 1.15 * angle,
        "{fewer_angle} deg with three views, {angle} with four"
    );
}

/// Brightens every photo until `share` of the object is clipped in all channels.
fn clip(world: &mut World, share: f64) {
    for (photo, view) in world.photos.photos.iter_mut().zip(&mut world.views) {
        let places = (0..view.depth.width * view.depth.height)
            .map(|k| (k % view.depth.width, k / view.depth.width))
            .filter(|&(x, y)| *view.depth.at(x, y) > 0.0);
        let darkest = |(x, y)| view.image.pixel(x, y).iter().copied().fold(1.0, f32::min);
        let mut darkest: Vec<f32> = places.map(darkest).collect();
        darkest.sort_by(f32::total_cmp);
        let white = darkest[((1.0 - share) * darkest.len() as f64) as usize];
        for value in &mut view.image.data {
            *value = (*value / white).min(1.0);
        }
        photo.pixels = Arc::new(InMemoryPixels(Arc::new(view.image.clone())));
    }
}

#[test]
fn a_clipped_surface_goes_on_smoothly() {
    let mut scene = world(
        Subject::Ellipsoid,
        LightModel::Shadowed,
        Some(grain),
        (240, 180),
    );
    clip(&mut scene, 0.25);
    let options = PhotoOptions {
        num_outer_iterations: 0,
        ..PhotoOptions::default()
    };
    let (found, _) = solved_by(&scene, &options);
    let is_clipped = |pixel: &[f32]| pixel.iter().all(|&v| v >= 1.0);
    let (mean, _, num_clipped) = accuracy_where(&scene, &found, is_clipped);
    println!("{num_clipped} clipped pixels, {mean:.2} deg");
    assert!(num_clipped > 1000, "{num_clipped} clipped pixels");
    assert!(mean < 15.0, "{mean} deg");
}

#[test]
fn a_finer_search_holds_photos_that_disagree() {
    let mut scene = world(
        Subject::Stone,
        LightModel::Shadowed,
        Some(grain),
        (240, 180),
    );
    let with = PhotoOptions {
        num_outer_iterations: 0,
        effort: Effort {
            coarse_pixels: 4000,
            ..Effort::default()
        },
        ..PhotoOptions::default()
    };
    let without = PhotoOptions {
        effort: Effort {
            finer_search: false,
            ..with.effort.clone()
        },
        ..with.clone()
    };
    let (_, report) = solved_by(&scene, &with);
    assert_eq!(
        report.finer_search_scatter_px, None,
        "{}",
        report.disagreement
    );
    disturb(&mut scene);
    let (found, report) = solved_by(&scene, &with);
    let (plain, plain_report) = solved_by(&scene, &without);
    assert!(report.disagreement > 0.055, "{}", report.disagreement);
    assert_eq!(plain_report.finer_search_scatter_px, None);
    let scatter = report.finer_search_scatter_px.unwrap();
    assert!(scatter > 0.0 && scatter < 1.0, "{scatter} px");
    let ((angle, depth), (plain_angle, plain_depth)) =
        (accuracy(&scene, &found), accuracy(&scene, &plain));
    println!(
        "{angle:.2} deg, depth {depth:.5}; without {plain_angle:.2} deg, {plain_depth:.5}; \
         disagreement {:.3}, scatter {scatter:.2} px",
        report.disagreement
    );
    assert!(depth < 0.8 * plain_depth, "{depth}, without {plain_depth}");
    assert!(angle < plain_angle, "{angle} deg, without {plain_angle}");
}

fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let n = pairs.len() as f64;
    let (ma, mb) = (
        pairs.iter().map(|p| p.0).sum::<f64>() / n,
        pairs.iter().map(|p| p.1).sum::<f64>() / n,
    );
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in pairs {
        ab += (a - ma) * (b - mb);
        aa += (a - ma).powi(2);
        bb += (b - mb).powi(2);
    }
    ab / (aa * bb).sqrt()
}
