//! The light fitted at the true shape of rendered photographs: what it leaves is its own error.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::environment::{self, LightScene};
use super::options::PhotoOptions;
use super::rendered_tests::known_light;
use super::views::{self, Scene};
use super::{distant, shading, surround};
use nalgebra::{Matrix3, Point3, Rotation3};
use rilievo_scene::{
    Alone, DepthMap, FocalSource, InMemoryPixels, Intrinsics, LightKind, LinearImage,
    LocatedSphere, MarkedSphere, MemoryScratch, NormalMap, Orientation, Photo, PhotoIdx, PhotoSet,
    PosedView, PosedViews, RigidTransform,
};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        other => other.as_f64().into_iter().collect(),
    }
}

/// Photos divided by their true exposure, true cameras, and true depths.
struct Truth {
    photos: PhotoSet,
    scene: Scene,
    posed: PosedViews,
    depths: Vec<DepthMap>,
    normals: Vec<NormalMap>,
}

fn load(folder: &Path, names: &[&str]) -> Truth {
    let text = std::fs::read_to_string(folder.join("truth/cameras.json")).unwrap();
    let cameras: Value = serde_json::from_str(&text).unwrap();
    let gains = numbers(&cameras["exposure_gains"]);
    let (mut photos, mut posed) = (PhotoSet::default(), PosedViews::default());
    let (mut depths, mut normals) = (Vec::new(), Vec::new());
    for (number, camera) in cameras["cameras"].as_array().unwrap().iter().enumerate() {
        let file = camera["image"].as_str().unwrap();
        let name = file.rsplit_once('.').unwrap().0.to_owned();
        if !names.contains(&name.as_str()) {
            continue;
        }
        let rgb = image::open(folder.join("photos").join(file))
            .unwrap()
            .to_rgb8();
        let gain = gains.get(number).copied().unwrap_or(1.0) as f32;
        let image = LinearImage {
            width: rgb.width() as usize,
            height: rgb.height() as usize,
            channels: 3,
            data: rgb
                .as_raw()
                .iter()
                .map(|&v| {
                    let v = f32::from(v) / 255.0;
                    let linear = if v <= 0.04045 {
                        v / 12.92
                    } else {
                        ((v + 0.055) / 1.055).powf(2.4)
                    };
                    if v > 0.99 {
                        1.0
                    } else {
                        linear / gain.max(0.5) * 0.8
                    }
                })
                .collect(),
        };
        let k = numbers(&camera["K"]);
        let mut intrinsics = Intrinsics::pinhole(image.width, image.height, k[0], k[2], k[5]);
        intrinsics.fy = k[4];
        let rotation = Matrix3::from_row_slice(&numbers(&camera["world_from_camera_rotation"]));
        let center = numbers(&camera["camera_center"]);
        let mask =
            rilievo_io::read_mask(&folder.join("masks").join(format!("{name}.png"))).unwrap();
        let index = PhotoIdx(photos.photos.len());
        depths
            .push(rilievo_io::read_depth(&folder.join(format!("truth/{name}_depth.exr"))).unwrap());
        normals.push(
            rilievo_io::read_normal(&folder.join(format!("truth/{name}_normal.exr"))).unwrap(),
        );
        photos.photos.push(Photo {
            file_name: file.to_owned(),
            name: name.clone(),
            pixels: Arc::new(InMemoryPixels(Arc::new(image))),
            intrinsics,
            focal_source: FocalSource::CameraFile,
            camera_group: 0,
            orientation: Orientation::UPRIGHT,
            mask: Some(Arc::new(mask.packed())),
            clip_level: 0.98,
            given_cam_from_world: None,
        });
        posed.views.push(PosedView {
            photo: index,
            name,
            file_name: file.to_owned(),
            intrinsics,
            cam_from_world: RigidTransform::from_world_pose(
                Rotation3::from_matrix_unchecked(rotation),
                Point3::new(center[0], center[1], center[2]),
            ),
        });
    }
    let c = numbers(&cameras["sphere"]["center"]);
    posed.spheres.push(LocatedSphere {
        name: MarkedSphere::ONLY.to_owned(),
        center_in_world: [c[0], c[1], c[2]],
        radius: cameras["sphere"]["radius"].as_f64().unwrap(),
        center_sigma: [0.0; 3],
        seen_in: Vec::new(),
    });
    let scene = views::load(&photos, &posed, &PhotoOptions::default(), &MemoryScratch).unwrap();
    Truth {
        photos,
        scene,
        posed,
        depths,
        normals,
    }
}

/// Log depths and normals of all views at a level: means over the truth's pixels next to each.
fn shape(truth: &Truth, at: usize) -> (Vec<Vec<f64>>, Vec<Vec<[f64; 3]>>) {
    let level = truth.scene.level(at);
    let scale = f64::from(1 << at);
    level
        .views
        .iter()
        .enumerate()
        .map(|(i, view)| {
            let frame = &truth.scene.frames[i];
            (0..view.pixels.len())
                .map(|p| {
                    let (x, y) = view.xy(p);
                    let full = |v: f64, corner: usize| ((v + 0.5) * scale - 0.5) + corner as f64;
                    let (x, y) = (full(x, frame.corner.0), full(y, frame.corner.1));
                    let mut found: Vec<(f64, f64, [f32; 3])> = Vec::new();
                    for dy in -3..=3_isize {
                        for dx in -3..=3_isize {
                            let (u, v) = (x.floor() as isize + dx, y.floor() as isize + dy);
                            if let Some(&z) = truth.depths[i].get(u, v)
                                && z > 0.0
                            {
                                let far = (u as f64 - x).hypot(v as f64 - y);
                                let n = *truth.normals[i].at(u as usize, v as usize);
                                found.push((far, f64::from(z), n));
                            }
                        }
                    }
                    found.sort_by(|a, b| a.0.total_cmp(&b.0));
                    let near = &found[..found.len().min(4)];
                    let depth = near.iter().map(|f| f.1).sum::<f64>() / near.len().max(1) as f64;
                    let mut n = nalgebra::Vector3::zeros();
                    for f in near {
                        n += nalgebra::Vector3::from(f.2.map(f64::from));
                    }
                    let n = n.normalize();
                    (depth.ln(), [n.x, n.y, n.z])
                })
                .unzip()
        })
        .unzip()
}

/// Relative RMS and median of the residual at the true shape, by nine harmonics and by rays.
fn residuals(truth: &Truth, num_rays: usize) -> [[f64; 2]; 2] {
    let at = truth.scene.coarse;
    let level = truth.scene.level(at);
    let rays_at = truth.scene.coarser(at);
    let (depths, normals) = shape(truth, at);
    let (coarse, rough) = shape(truth, (at + 1).min(truth.scene.num_levels() - 1));
    let points: Vec<Point3<f64>> = (0..400)
        .map(|i| {
            Point3::new(
                (i % 20) as f64 / 19.0 - 0.5,
                0.0,
                (i / 20) as f64 / 19.0 - 0.5,
            )
        })
        .collect();
    let object = surround::object_points(level, &depths);
    let ground = surround::find_ground(&points, &object, &truth.scene.small);
    let scene = LightScene {
        known: &known_light(&truth.photos, &truth.posed, LightKind::World, &[]),
        ground: ground.as_ref(),
        num_rays,
        team: &Alone,
    };
    let nine = distant::fit(level, &depths, LightKind::World).unwrap();
    let rays = environment::visible_on(
        level,
        (&depths, &normals),
        rays_at,
        (&coarse, &rough),
        &scene,
    )
    .unwrap()
    .unwrap();
    [nine, rays].map(|light| {
        if let Some(p) = &light.pigment {
            println!(
                "    pigment explains {:.3}, belief {:.3}",
                p.explained, p.belief
            );
        }
        let (mut miss, mut all, mut relative) = (0.0, 0.0, Vec::new());
        for (i, view) in level.views.iter().enumerate() {
            let normals = &normals[i];
            for p in (0..view.pixels.len()).filter(|&p| view.is_usable(p)) {
                let s = shading::render(&light.harmonics[i][p], normals[p]);
                let known = light.pigment_of(i).map_or([1.0; 3], |a| a[p]);
                let own = view.intensity(p);
                let grey = |v: [f64; 3]| v.iter().sum::<f64>() / 3.0;
                let (a, b) = (
                    grey([0, 1, 2].map(|c| s[c] * f64::from(known[c]))),
                    grey(own.map(f64::from)),
                );
                miss += (a - b).powi(2);
                all += b * b;
                relative.push((a / b.max(1e-4) - 1.0).abs());
            }
        }
        let median = rilievo_numerics::robust::median(&mut relative).unwrap();
        [(miss / all).sqrt(), median]
    })
}

#[test]
fn rays_leave_less_than_nine_harmonics() {
    let right = ["IMG_0003", "IMG_0004", "IMG_0005", "IMG_0006"];
    for (set, names, limit) in [
        ("studio_stone", &right, [0.056, 0.039]),
        ("studio_smooth", &right, [0.052, 0.029]),
    ] {
        let Some(folder) = rilievo_synthetic::testing::shared_data(set) else {
            continue;
        };
        let truth = load(&folder, names);
        let [nine, rays] = residuals(&truth, PhotoOptions::default().effort.num_rays);
        println!("{set}: nine harmonics {nine:.4?}, rays {rays:.4?}, at most {limit:?}");
        assert!(
            rays[0] < limit[0] && rays[1] < limit[1] && rays[0] < 0.8 * nine[0],
            "{set}: rays leave {rays:?}, nine harmonics {nine:?}"
        );
    }
}
