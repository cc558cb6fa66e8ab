//! A small world that stages 4 to 6 can all work on: a unit sphere beside a smaller reference sphere, seen by
//! three cameras; included by path, since tests of several crates need it.

use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};
use rilievo_scene::{
    Anchor, AnchorObservation, AnchorOrigin, DepthMap, FocalSource, InMemoryPixels, Intrinsics,
    LightKind, LightSource, Lighting, LightingCalibration, LinearImage, LocatedSphere, Mask,
    NormalMap, Photo, PhotoIdx, PhotoSet, PosedView, PosedViews, RigidTransform, ShadedView,
    ShadedViews, SparsePoint, SphereLight, SphericalHarmonics, TrackElement, ViewIdx, ViewLighting,
};
use std::sync::Arc;

/// Columns and rows of a photo.
const SIZE: usize = 72;
const BALL_CENTER: [f64; 3] = [1.5, 0.3, 0.0];
const BALL_RADIUS: f64 = 0.35;

/// What the stages before would hand over.
pub struct World {
    pub photos: PhotoSet,
    pub posed: PosedViews,
    pub lighting: LightingCalibration,
    pub shaded: ShadedViews,
}

fn camera() -> Intrinsics {
    let center = (SIZE as f64 - 1.0) / 2.0;
    Intrinsics::pinhole(SIZE, SIZE, 1.1 * SIZE as f64, center, center)
}

/// Depth and normal, camera frame, of a sphere at a pixel.
fn hit(center: Vector3<f64>, radius: f64, pixel: [f64; 2]) -> Option<(f64, Vector3<f64>)> {
    let ray = camera().ray(&Point2::from(pixel));
    let (a, b) = (ray.norm_squared(), ray.dot(&center));
    let root = b * b - a * (center.norm_squared() - radius * radius);
    (root > 0.0).then(|| {
        let z = (b - root.sqrt()) / a;
        (z, (ray * z - center) / radius)
    })
}

pub fn world() -> World {
    let row = [-0.15, -0.2, -0.45, 0.3, 0.03, -0.03, -0.03, -0.03, 0.02];
    let light = Lighting {
        channels: [1.0, 0.9, 0.8]
            .map(|tint| SphericalHarmonics(row.map(|l| tint * l)))
            .to_vec(),
    };
    let mut world = World {
        photos: PhotoSet::default(),
        posed: PosedViews::default(),
        lighting: LightingCalibration {
            source: LightSource::Sphere,
            kind: LightKind::Camera,
            environment_in_world: None,
            views: Vec::new(),
            spheres: vec![SphereLight {
                name: "the sphere".to_owned(),
                paint: Some(vec![1.0; 3]),
            }],
            samples: Vec::new(),
        },
        shaded: ShadedViews::default(),
    };
    for (index, angle) in [-0.3, 0.0, 0.3].into_iter().enumerate() {
        let pose = RigidTransform {
            rotation: UnitQuaternion::from_euler_angles(0.0, angle, 0.0),
            translation: Vector3::new(0.0, 0.0, 4.0),
        };
        let ball = pose.apply(&Point3::from(BALL_CENTER)).coords;
        let object = |x: usize, y: usize| {
            hit(pose.translation, 1.0, [x as f64, y as f64]).filter(|(_, n)| n.z < -0.3)
        };
        let mut image = LinearImage::filled(SIZE, SIZE, 3, 0.05);
        for y in 0..SIZE {
            for x in 0..SIZE {
                let on_ball = || hit(ball, BALL_RADIUS, [x as f64, y as f64]);
                if let Some((_, normal)) = object(x, y).or_else(on_ball) {
                    for (value, row) in image.pixel_mut(x, y).iter_mut().zip(&light.channels) {
                        *value = row.evaluate(&normal) as f32;
                    }
                }
            }
        }
        let (name, file_name) = (format!("v{index}"), format!("v{index}.png"));
        world.photos.photos.push(Photo {
            file_name: file_name.clone(),
            name: name.clone(),
            pixels: Arc::new(InMemoryPixels(Arc::new(image))),
            intrinsics: camera(),
            focal_source: FocalSource::CameraFile,
            camera_group: 0,
            orientation: 1,
            mask: Some(Arc::new(Mask::from_fn(SIZE, SIZE, |x, y| {
                object(x, y).is_some()
            }))),
            clip_level: 5.0,
            given_cam_from_world: None,
        });
        world.posed.views.push(PosedView {
            photo: PhotoIdx(index),
            name: name.clone(),
            file_name,
            intrinsics: camera(),
            cam_from_world: pose,
        });
        world.lighting.views.push(ViewLighting {
            view: ViewIdx(index),
            lighting: light.clone(),
            residual: Some(0.02),
            gain: vec![1.0; 3],
        });
        world.shaded.views.push(ShadedView {
            view: ViewIdx(index),
            name,
            depth: DepthMap::from_fn(SIZE, SIZE, |x, y| object(x, y).map_or(0.0, |h| h.0 as f32)),
            normal: NormalMap::from_fn(SIZE, SIZE, |x, y| {
                object(x, y).map_or([0.0; 3], |h| h.1.map(|c| c as f32).into())
            }),
            confidence: None,
            rendered: None,
            albedo: None,
        });
    }
    hang_on_poses(&mut world.posed);
    world
}

/// Sphere, points and anchors of posed views.
fn hang_on_poses(posed: &mut PosedViews) {
    posed.spheres.push(LocatedSphere {
        name: "the sphere".to_owned(),
        center_in_world: BALL_CENTER,
        radius: BALL_RADIUS,
        center_sigma: [1e-3; 3],
        seen_in: (0..posed.views.len()).map(|k| (PhotoIdx(k), 0.1)).collect(),
    });
    for k in 0..60_usize {
        // On the front of the sphere, which all cameras see.
        let (x, y) = (0.05 * (k % 10) as f64 - 0.22, 0.07 * (k / 10) as f64 - 0.17);
        let position = Point3::new(x, y, -(1.0 - x * x - y * y).sqrt());
        let seen: Vec<(ViewIdx, [f64; 2], f64)> = (0..)
            .zip(&posed.views)
            .filter_map(|(view, posed)| {
                let in_cam = posed.cam_from_world.apply(&position);
                let pixel = posed.intrinsics.project(&in_cam)?;
                Some((ViewIdx(view), [pixel.x, pixel.y], in_cam.z))
            })
            .collect();
        posed.points.push(SparsePoint {
            position: position.into(),
            color: [128; 3],
            error_px: 0.2,
            track: seen
                .iter()
                .map(|&(view, pixel, _)| TrackElement {
                    view,
                    keypoint_idx: k as u32,
                    pixel,
                })
                .collect(),
        });
        posed.anchors.push(Anchor {
            position: position.into(),
            covariance: [1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8],
            origin: AnchorOrigin::Grown,
            observations: seen
                .iter()
                .map(|&(view, pixel, depth)| AnchorObservation {
                    view,
                    pixel,
                    depth,
                    sigma_ln_depth: 1e-4,
                })
                .collect(),
        });
    }
}
