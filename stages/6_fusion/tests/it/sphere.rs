//! Fusion of an analytic sphere seen from an arc, in rungs.

// Helpers outside the test functions may fail as these may.
use nalgebra::{Point3, Vector3};
use rilievo_fusion::{FusionError, FusionOptions, FusionReport, Inputs, MeshFormat, run};
use rilievo_scene::{
    CloudPoint, ConfidenceMap, Intrinsics, LinearImage, MapSource, MemoryScratch, Mesh, NormalMap,
    Observer, PhotoSet, PixelError, PointCloud, PosedViews, Recorder, ShadedImages, ShadedView,
    ShadedViews, Silent,
};
use rilievo_synthetic::testing::{Impatient, Maps, Random, look_at, on_sphere, photo, posed_view};
use std::collections::{BTreeMap, BTreeSet};

const WIDTH: usize = 160;
const HEIGHT: usize = 120;
const FOCAL: f64 = 240.0;
const DISTANCE: f64 = 6.0;

/// A sphere of a radius around the origin, seen by cameras at azimuths in degrees.
fn views(azimuths_deg: &[f64], radius: f64) -> (PosedViews, ShadedViews) {
    let camera = Intrinsics::pinhole(WIDTH, HEIGHT, FOCAL, 79.5, 59.5);
    let mut posed = PosedViews::default();
    let mut shaded = ShadedViews::default();
    for (i, azimuth) in azimuths_deg.iter().enumerate() {
        let a = azimuth.to_radians();
        let center = Point3::new(a.sin(), -0.3, -a.cos()) * (DISTANCE * radius);
        let pose = look_at(center, Point3::origin(), -Vector3::y());
        let maps = Maps::of(&camera, |pixel| {
            on_sphere(&pose.translation, radius, &camera, pixel)
        });
        let name = format!("IMG_{i:04}");
        posed
            .views
            .push(posed_view(i, &format!("{name}.png"), camera, pose));
        shaded.views.push(maps.shaded(i, &name));
    }
    (posed, shaded)
}

const ARC: [f64; 5] = [-40.0, -20.0, 0.0, 20.0, 40.0];

/// Size of a pixel on the front of a sphere of radius 1.
fn footprint() -> f64 {
    DISTANCE / FOCAL
}

/// What fusion makes, all in memory.
#[derive(Debug, PartialEq)]
struct Fused {
    points: Vec<CloudPoint>,
    mesh: Mesh,
}

fn fuse_with(
    photos: &PhotoSet,
    (posed, shaded): (&PosedViews, &ShadedViews),
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<(Fused, FusionReport), FusionError> {
    let inputs = Inputs {
        photos,
        posed,
        maps: shaded,
        scratch: &MemoryScratch,
    };
    let mut cloud = PointCloud::default();
    let fused = run(inputs, &mut cloud, options, observer)?;
    let (points, mesh) = (cloud.points, fused.mesh);
    Ok((Fused { points, mesh }, fused.report))
}

fn fuse(
    posed: &PosedViews,
    shaded: &ShadedViews,
    options: &FusionOptions,
) -> Result<(Fused, FusionReport), FusionError> {
    fuse_with(&PhotoSet::default(), (posed, shaded), options, &Silent)
}

fn length(p: &[f32; 3]) -> f64 {
    Vector3::from(p.map(f64::from)).norm()
}

/// Distances of the cloud's points from a sphere, sorted.
fn errors(fused: &Fused, radius: f64) -> Vec<f64> {
    let mut errors: Vec<f64> = fused
        .points
        .iter()
        .map(|p| (length(&p.position) - radius).abs())
        .collect();
    errors.sort_by(f64::total_cmp);
    errors
}

/// Number of edges that only one triangle has.
fn num_open_edges(mesh: &Mesh) -> usize {
    let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
        }
    }
    edges.values().filter(|&&n| n != 0).count()
}

/// White noise between -1 and 1 from integers.
fn noise(view: usize, i: usize) -> f64 {
    2.0 * Random((view as u64) << 32 | i as u64).unit() - 1.0
}

#[test]
fn exact_maps_give_the_sphere_without_layers() {
    let (posed, shaded) = views(&ARC, 1.0);
    let (fused, report) = fuse(&posed, &shaded, &FusionOptions::default()).expect("fused");
    let errors = errors(&fused, 1.0);
    assert!(errors.len() > 5000, "{} points", errors.len());
    let worst = errors[errors.len() - 1] / footprint();
    assert!(worst < 0.05, "{worst} footprints");
    for p in &fused.points {
        let (at, n) = (Vector3::from(p.position), Vector3::from(p.normal));
        assert!(at.normalize().dot(&n) > 0.9999, "{p:?}");
        assert!(
            p.num_views >= 2 && (0.0..=1.0).contains(&p.confidence),
            "{p:?}"
        );
    }
    let rms = report.layering.rms / footprint();
    assert!(rms < 0.02, "{rms} footprints between views");

    let mesh = report.mesh.expect("a mesh was asked for");
    let off: Vec<f64> = fused
        .mesh
        .vertices
        .iter()
        .map(|v| (length(v) - 1.0).abs() / mesh.voxel)
        .collect();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    let worst = off.iter().copied().fold(0.0, f64::max);
    assert!(mean < 0.02 && worst < 0.25, "{mean}, {worst} cells");
}

#[test]
fn the_mesh_ends_in_one_clean_rim() {
    let (posed, shaded) = views(&ARC, 1.0);
    let (fused, report) = fuse(&posed, &shaded, &FusionOptions::default()).expect("fused");
    let mesh = report.mesh.expect("a mesh was asked for");
    let (mut inwards, mut area) = (0.0_f32, 0.0_f32);
    for t in &fused.mesh.triangles {
        let [a, b, c] = t.map(|v| Vector3::from(fused.mesh.vertices[v as usize]));
        let normal = (b - a).cross(&(c - a));
        area += normal.norm();
        if normal.dot(&(a + b + c)) < 0.0 {
            inwards += normal.norm();
        }
    }
    let share = inwards / area;
    assert!(share < 0.001, "{share} of the area faces inwards");
    // One boundary runs round what was seen, and nothing else is open.
    let open = mesh.boundary_length;
    assert!((2.0..14.0).contains(&open), "boundary of length {open}");
    assert_eq!(mesh.num_open_loops, 1);
}

#[test]
fn flat_places_are_coarser_within_a_tenth_of_a_pixel() {
    let (posed, shaded) = views(&ARC, 1.0);
    let with = |full: bool| {
        let options = FusionOptions {
            full,
            ..FusionOptions::default()
        };
        let (fused, report) = fuse(&posed, &shaded, &options).expect("fused");
        (fused.mesh, report.mesh.expect("a mesh"))
    };
    let ((_, all), (mesh, coarser)) = (with(true), with(false));
    assert_eq!(coarser.num_triangles_before, Some(all.num_triangles));
    assert!((all.num_triangles_before, all.simplified_by) == (None, 0.0));
    assert!(coarser.num_triangles * 4 < all.num_triangles, "{coarser:?}");
    let stated = coarser.simplified_by / footprint();
    assert!(stated > 0.02 && stated <= 0.1, "{stated} footprints");
    let off = mesh.triangles.iter().map(|t| {
        let [a, b, c] = t.map(|v| Vector3::from(mesh.vertices[v as usize].map(f64::from)));
        (((a + b + c) / 3.0).norm() - 1.0).abs() / footprint()
    });
    let mut off: Vec<f64> = off.collect();
    off.sort_by(f64::total_cmp);
    let p99 = off[off.len() * 99 / 100];
    assert!(p99 < 0.2, "{p99} footprints at 99 %");
    assert!((coarser.boundary_length / all.boundary_length - 1.0).abs() < 0.02);
}

/// Maps that hold no relief below so many pixels.
struct Blurred(ShadedViews, f64);

impl MapSource for Blurred {
    fn num_views(&self) -> usize {
        self.0.num_views()
    }

    fn load(&self, idx: usize) -> Result<ShadedView, PixelError> {
        self.0.load(idx)
    }

    fn images(&self, idx: usize) -> Result<ShadedImages, PixelError> {
        self.0.images(idx)
    }

    fn resolved_px(&self) -> f64 {
        self.1
    }
}

#[test]
fn cells_are_no_finer_than_the_relief_that_the_maps_hold() {
    let (posed, shaded) = views(&ARC, 1.0);
    let maps = Blurred(shaded, 3.0);
    let fuse = |full: bool| {
        let inputs = Inputs {
            photos: &PhotoSet::default(),
            posed: &posed,
            maps: &maps,
            scratch: &MemoryScratch,
        };
        let options = FusionOptions {
            full,
            ..FusionOptions::default()
        };
        let mut cloud = PointCloud::default();
        let report = run(inputs, &mut cloud, &options, &Silent)
            .expect("fused")
            .report;
        (report, cloud)
    };
    let [(report, cloud), (full, all)] = [false, true].map(fuse);
    let full_voxel = full.mesh.expect("a mesh").voxel;
    let voxel = report.mesh.expect("a mesh").voxel;
    assert!((voxel / full_voxel - 3.0).abs() < 1e-9);
    // So are the points: one in a cube.
    assert_eq!(full.spacing, 0.0);
    assert!((report.spacing / voxel - 1.0).abs() < 1e-9);
    let cube = |at: [f32; 3]| at.map(|c| (f64::from(c) / report.spacing).floor() as i64);
    let cubes = |cloud: &PointCloud| {
        cloud
            .points
            .iter()
            .map(|p| cube(p.position))
            .collect::<BTreeSet<_>>()
    };
    assert_eq!(cubes(&cloud).len(), cloud.points.len());
    assert_eq!(cubes(&cloud), cubes(&all));
}

/// How many edges have other than two triangles which run through them against each other, equal
/// places being one vertex as other programs take them.
fn num_unpaired_edges(mesh: &Mesh) -> usize {
    let mut numbers: BTreeMap<[u32; 3], u32> = BTreeMap::new();
    let joined = mesh.vertices.iter().map(|v| {
        let next = numbers.len() as u32;
        *numbers.entry(v.map(f32::to_bits)).or_insert(next)
    });
    let joined: Vec<u32> = joined.collect();
    let mut edges: BTreeMap<(u32, u32), [u32; 2]> = BTreeMap::new();
    for t in mesh.triangles.iter().map(|t| t.map(|v| joined[v as usize])) {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            edges.entry((a.min(b), a.max(b))).or_default()[usize::from(a < b)] += 1;
        }
    }
    edges.values().filter(|&&n| n != [1, 1]).count()
}

#[test]
fn a_rough_mesh_is_watertight_also_when_it_is_made_light() {
    let (posed, mut shaded) = views(&ARC, 1.0);
    for (v, view) in shaded.views.iter_mut().enumerate() {
        for (i, z) in view.depth.data.iter_mut().enumerate() {
            let rough = 3.0 * footprint() * noise(v / 5, i);
            *z = match noise(v + 40, i) {
                n if n > 0.96 => 0.0,
                _ if *z > 0.0 => *z + rough as f32,
                _ => 0.0,
            };
        }
    }
    for (max_num_triangles, full) in [
        (0, true),
        (0, false),
        (5000, false),
        (1000, false),
        (200, false),
    ] {
        let options = FusionOptions {
            watertight: true,
            max_num_triangles,
            full,
            ..FusionOptions::default()
        };
        let told = Recorder::default();
        let result = fuse_with(&PhotoSet::default(), (&posed, &shaded), &options, &told);
        let (fused, report) = result.expect("fused");
        let num = num_unpaired_edges(&fused.mesh);
        assert_eq!(num, 0, "{max_num_triangles}: {:?}", report.mesh);
        assert!(!told.warnings().iter().any(|w| w.contains("watertight")));
    }
}

#[test]
fn smooth_offsets_between_views_show_below_noise() {
    for noise_px in [0.0, 0.1] {
        let (posed, mut shaded) = views(&ARC, 1.0);
        for (v, view) in shaded.views.iter_mut().enumerate() {
            for (i, z) in view.depth.data.iter_mut().enumerate() {
                let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
                let wave = (x / 40.0 + v as f64).sin() * (y / 50.0 - v as f64).cos();
                let bias = 0.6 * (0.5 * if v % 2 == 0 { 1.0 } else { -1.0 } + wave);
                let offset = footprint() * (bias + noise_px * 1.7 * noise(v, i));
                *z = if *z > 0.0 { *z + offset as f32 } else { 0.0 };
            }
        }
        let options = FusionOptions {
            mesh: false,
            ..FusionOptions::default()
        };
        let (_, report) = fuse(&posed, &shaded, &options).expect("fused");
        let layering = report.layering;
        assert!(
            layering.smooth_rms > 0.2 * footprint(),
            "noise {noise_px}: {layering:?}"
        );
    }
}

#[test]
fn outliers_do_not_reach_the_cloud() {
    let (posed, mut shaded) = views(&ARC, 1.0);
    for (v, view) in shaded.views.iter_mut().enumerate() {
        for (i, z) in view.depth.data.iter_mut().enumerate() {
            if *z > 0.0 && noise(v + 10, i) > 0.9 {
                *z += (0.5 * noise(v + 20, i)) as f32;
            }
        }
    }
    let (fused, report) = fuse(&posed, &shaded, &FusionOptions::default()).expect("fused");
    let errors = errors(&fused, 1.0);
    let p99 = errors[errors.len() * 99 / 100] / footprint();
    assert!(p99 < 0.5, "{p99} footprints at 99 %");
    assert!(errors.len() > 3000, "{}", errors.len());
    let dropped: usize = report
        .views
        .iter()
        .map(|v| v.num_inconsistent + v.num_border)
        .sum();
    assert!(dropped > 1000, "{dropped}");
}

#[test]
fn lengths_are_footprints_so_that_the_unit_does_not_matter() {
    let counts: Vec<(usize, usize)> = [0.01, 1.0, 1000.0]
        .iter()
        .map(|&radius| {
            let (posed, shaded) = views(&ARC, radius);
            // What is left of flat places depends on rounding.
            let options = FusionOptions {
                full: true,
                ..FusionOptions::default()
            };
            let (fused, _) = fuse(&posed, &shaded, &options).expect("fused");
            (fused.points.len(), fused.mesh.triangles.len())
        })
        .collect();
    for count in &counts {
        let relative = |a: usize, b: usize| (a as f64 / b as f64 - 1.0).abs();
        assert!(
            relative(count.0, counts[1].0) < 0.01 && relative(count.1, counts[1].1) < 0.01,
            "{counts:?}"
        );
    }
}

#[test]
fn one_thread_and_three_give_the_same_bytes() {
    let (posed, shaded) = views(&ARC, 1.0);
    let result = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads")
            .install(|| fuse(&posed, &shaded, &FusionOptions::default()).expect("fused"))
    };
    assert_eq!(result(1), result(3));
}

#[test]
fn spacing_thins_watertight_closes_and_memory_bounds() {
    let (posed, shaded) = views(&ARC, 1.0);
    let full = fuse(&posed, &shaded, &FusionOptions::default()).expect("fused");
    let options = FusionOptions {
        spacing: 4.0 * footprint(),
        watertight: true,
        memory_mib: 16,
        voxel_px: 0.5,
        ..FusionOptions::default()
    };
    let (thin, report) = fuse(&posed, &shaded, &options).expect("fused");
    assert!(
        thin.points.len() * 5 < full.0.points.len(),
        "{} of {}",
        thin.points.len(),
        full.0.points.len()
    );
    assert_eq!(num_open_edges(&thin.mesh), 0);
    let mesh = report.mesh.expect("a mesh was asked for");
    assert!(mesh.memory_mib <= 16.0, "{mesh:?}");
}

#[test]
fn a_spacing_that_leaves_nothing_is_told() {
    let (posed, shaded) = views(&ARC, 1.0);
    let told = |spacing: f64| {
        let options = FusionOptions {
            spacing,
            mesh: false,
            ..FusionOptions::default()
        };
        let told = Recorder::default();
        fuse_with(&PhotoSet::default(), (&posed, &shaded), &options, &told).expect("fused");
        told.warnings().iter().any(|w| w.contains("a spacing of"))
    };
    assert!(!told(4.0 * footprint()));
    // Millimetres where metres are meant.
    assert!(told(4.0e3 * footprint()));
}

#[test]
fn any_memory_that_suffices_gives_the_same_bytes_and_less_is_named() {
    // More views than a thread may hold the pages of.
    let repeated: Vec<f64> = ARC.iter().copied().cycle().take(8 * ARC.len()).collect();
    let (posed, shaded) = views(&repeated, 1.0);
    let with = |memory_mib: usize| {
        let options = FusionOptions {
            memory_mib,
            voxel_px: 2.0,
            // An asset has as many triangles and texels as the memory holds.
            formats: vec![MeshFormat::Ply],
            ..FusionOptions::default()
        };
        fuse(&posed, &shaded, &options).expect("fused")
    };
    let (small, large) = (with(FusionOptions::MIN_MEMORY_MIB), with(4096));
    assert_eq!(small.1, large.1);
    assert!(small.0 == large.0, "another result in less memory");

    let (mut posed, mut shaded) = views(&ARC, 1.0);
    for view in &mut posed.views {
        view.intrinsics = Intrinsics::pinhole(1000, 1000, FOCAL, 500.0, 500.0);
    }
    shaded.views.clear();
    let options = FusionOptions {
        memory_mib: FusionOptions::MIN_MEMORY_MIB,
        ..FusionOptions::default()
    };
    let error = fuse(&posed, &shaded, &options).err();
    assert!(
        matches!(
            error,
            Some(FusionError::OutOfMemory { given_mib: 16, needed_mib }) if needed_mib > 16
        ),
        "{error:?}"
    );
}

#[test]
fn a_double_wall_shows_in_the_share_of_points_apart() {
    let share = |apart_px: f64| {
        let (posed, mut shaded) = views(&[-30.0, -20.0, -10.0, 10.0, 20.0, 30.0], 1.0);
        for view in shaded.views.iter_mut().skip(3) {
            let offset = (apart_px * footprint()) as f32;
            let depths = view.depth.data.iter_mut().filter(|z| **z > 0.0);
            depths.for_each(|z| *z += offset);
        }
        let options = FusionOptions {
            mesh: false,
            ..FusionOptions::default()
        };
        let (_, report) = fuse(&posed, &shaded, &options).expect("fused");
        assert!(report.num_covered > report.num_points / 2, "{report:?}");
        report.share_apart.expect("views cover each other")
    };
    assert_eq!(share(0.0), 0.0);
    // At the sides a view sees mostly those that agree with it: not all points have the other wall's views in the
    // majority.
    let double = share(8.0);
    assert!(double > 0.3, "{double}");
}

#[test]
fn a_lens_that_distorts_gives_the_same_sphere() {
    let (mut posed, mut shaded) = views(&ARC, 1.0);
    let mut camera = posed.views[0].intrinsics;
    camera.distortion.k1 = -0.1;
    for (view, maps) in posed.views.iter_mut().zip(&mut shaded.views) {
        view.intrinsics = camera;
        let center = view.cam_from_world.translation;
        *maps = Maps::of(&camera, |pixel| on_sphere(&center, 1.0, &camera, pixel))
            .shaded(maps.view.0, &maps.name);
    }
    let (fused, _) = fuse(&posed, &shaded, &FusionOptions::default()).expect("fused");
    let errors = errors(&fused, 1.0);
    let worst = errors[errors.len() - 1] / footprint();
    assert!(errors.len() > 5000 && worst < 0.05, "{worst} footprints");
}

#[test]
fn colours_come_from_the_photos_and_low_confidence_widens() {
    let (posed, mut shaded) = views(&ARC, 1.0);
    for view in &mut shaded.views {
        view.confidence = Some(ConfidenceMap::filled(WIDTH, HEIGHT, 0.5));
    }
    let mut photos = PhotoSet::default();
    for view in &posed.views {
        let mut image = LinearImage::filled(WIDTH, HEIGHT, 3, 0.0);
        for pixel in image.data.chunks_exact_mut(3) {
            pixel.copy_from_slice(&[0.216, 0.0, 1.0]);
        }
        photos
            .photos
            .push(photo(&view.file_name, image, view.intrinsics));
    }
    let told = Recorder::default();
    let result = fuse_with(&photos, (&posed, &shaded), &FusionOptions::default(), &told);
    let (fused, _) = result.expect("fused");
    assert!(told.warnings().is_empty(), "{:?}", told.warnings());
    assert!(fused.points.iter().all(|p| p.color == [128, 0, 255]));
    assert!(fused.mesh.colors.iter().all(|c| *c == [128, 0, 255]));
    assert!(fused.points.iter().all(|p| p.confidence <= 0.5));
}

#[test]
fn one_view_alone_is_fused_with_a_warning() {
    let (posed, shaded) = views(&ARC[..1], 1.0);
    let (options, told) = (FusionOptions::default(), Recorder::default());
    let result = fuse_with(&PhotoSet::default(), (&posed, &shaded), &options, &told);
    let (fused, _) = result.expect("fused");
    assert!(fused.points.len() > 2000, "{}", fused.points.len());
    assert!(!fused.mesh.triangles.is_empty());
    let warnings = told.warnings();
    assert!(
        warnings.iter().any(|w| w.contains("only 1 view")),
        "{warnings:?}"
    );
}

#[test]
fn what_cannot_be_fused_is_named() {
    let options = FusionOptions::default();
    // Back to back: nothing overlaps.
    let (posed, shaded) = views(&[0.0, 180.0], 1.0);
    let error = fuse(&posed, &shaded, &options).err();
    assert!(
        matches!(error, Some(FusionError::NothingAgrees { .. })),
        "{error:?}"
    );

    let (posed, mut shaded) = views(&ARC, 1.0);
    for view in &mut shaded.views {
        view.depth.data.fill(f32::NAN);
    }
    let error = fuse(&posed, &shaded, &options).err();
    assert!(
        matches!(error, Some(FusionError::NoDepth { num_views: 5 })),
        "{error:?}"
    );

    let (posed, mut shaded) = views(&ARC, 1.0);
    shaded.views[2].normal = NormalMap::filled(3, 3, [0.0; 3]);
    let error = fuse(&posed, &shaded, &options).err();
    assert!(
        matches!(&error, Some(FusionError::SizeMismatch { view, got: (3, 3), .. }) if view == "IMG_0002"),
        "{error:?}"
    );

    let (mut posed, shaded) = views(&ARC, 1.0);
    posed.views.truncate(3);
    let error = fuse(&posed, &shaded, &options).err();
    assert!(
        matches!(error, Some(FusionError::NoCamera { view_idx: 3, .. })),
        "{error:?}"
    );

    let (posed, shaded) = views(&ARC, 1.0);
    let broken = FusionOptions {
        voxel_px: f64::NAN,
        ..FusionOptions::default()
    };
    let error = fuse(&posed, &shaded, &broken).err();
    assert!(
        matches!(
            &error,
            Some(FusionError::InvalidOption(e)) if e.key == "voxel_px"
        ),
        "{error:?}"
    );

    let error = fuse_with(
        &PhotoSet::default(),
        (&posed, &shaded),
        &options,
        &Impatient,
    )
    .err();
    assert!(matches!(error, Some(FusionError::Interrupted)), "{error:?}");
}

#[test]
fn invalid_pixels_are_counted_and_left_out() {
    let (posed, mut shaded) = views(&ARC, 1.0);
    let center = HEIGHT / 2 * WIDTH + WIDTH / 2;
    shaded.views[0].depth.data[center] = f32::NAN;
    shaded.views[0].depth.data[center + 1] = -1.0;
    shaded.views[0].normal.data[center + 2] = [f32::INFINITY, 0.0, 0.0];
    let (fused, report) = fuse(&posed, &shaded, &FusionOptions::default()).expect("fused");
    assert_eq!(report.views[0].num_invalid, 3);
    assert!(
        fused
            .points
            .iter()
            .all(|p| p.position.iter().all(|c| c.is_finite()))
    );
}
