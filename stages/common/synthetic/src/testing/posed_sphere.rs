//! A small world that stages 4 to 6 can all work on: a unit sphere beside a smaller reference sphere, seen by
//! three cameras.

use super::photos::{PosedPhotos, photo, tinted_light, true_sphere};
use super::surfaces::{Maps, on_sphere, painted};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rilievo_scene::{
    Anchor, AnchorObservation, AnchorOrigin, Intrinsics, LightKind, LightSource,
    LightingCalibration, LocatedSphere, Photo, PhotoIdx, PhotoSet, PosedViews, RigidTransform,
    ShadedViews, SparsePoint, SphereLight, TrackElement, ViewIdx, ViewLighting,
};
use std::sync::Arc;

/// Columns and rows of a photo.
const SIZE: usize = 72;
const BALL_CENTER: [f64; 3] = [1.5, 0.3, 0.0];
const BALL_RADIUS: f64 = 0.35;

/// What the stages before would hand over.
pub struct SphereWorld {
    /// Stage 1.
    pub photos: PhotoSet,
    /// Stage 3.
    pub posed: PosedViews,
    /// Stage 4.
    pub lighting: LightingCalibration,
    /// Stage 5.
    pub shaded: ShadedViews,
}

fn camera() -> Intrinsics {
    let center = (SIZE as f64 - 1.0) / 2.0;
    Intrinsics::pinhole(SIZE, SIZE, 1.1 * SIZE as f64, center, center)
}

/// The unit sphere of `photos` and `shaded`, and the reference sphere beside it.
pub fn sphere_world() -> SphereWorld {
    let light = tinted_light([-0.15, -0.2, -0.45, 0.3, 0.03, -0.03, -0.03, -0.03, 0.02]);
    let mut lighting = LightingCalibration {
        source: LightSource::Sphere,
        kind: LightKind::Camera,
        environment_in_world: None,
        views: Vec::new(),
        spheres: vec![SphereLight {
            name: "the sphere".to_owned(),
            paint: Some(vec![1.0; 3]),
        }],
        samples: Vec::new(),
    };
    let mut shaded = ShadedViews::default();
    let mut made = PosedPhotos::default();
    for (index, angle) in [-0.3, 0.0, 0.3].into_iter().enumerate() {
        let pose = RigidTransform {
            rotation: UnitQuaternion::from_euler_angles(0.0, angle, 0.0),
            translation: Vector3::new(0.0, 0.0, 4.0),
        };
        let camera = camera();
        // Without the rim, where slopes grow without bound.
        let object =
            |pixel| on_sphere(&pose.translation, 1.0, &camera, pixel).filter(|(_, n)| n.z < -0.3);
        let center = pose.apply(&Point3::from(BALL_CENTER)).coords;
        let ball = |pixel| on_sphere(&center, BALL_RADIUS, &camera, pixel);
        let image = painted(&camera, 0.05, |pixel| {
            let (_, normal) = object(pixel).or_else(|| ball(pixel))?;
            let channel = |c: usize| light.channels[c].evaluate(&normal);
            Some([channel(0), channel(1), channel(2)])
        });
        let maps = Maps::of(&camera, object);
        let name = format!("v{index}");
        let photo = Photo {
            mask: Some(Arc::new(maps.mask.packed())),
            clip_level: 5.0,
            ..photo(&format!("{name}.png"), image, camera)
        };
        made.push(photo, pose);
        lighting.views.push(ViewLighting {
            view: ViewIdx(index),
            lighting: light.clone(),
            residual: Some(0.02),
            gain: vec![1.0; 3],
        });
        shaded.views.push(maps.shaded(index, &name));
    }
    hang_on_poses(&mut made.posed);
    SphereWorld {
        photos: made.photos,
        posed: made.posed,
        lighting,
        shaded,
    }
}

/// Sphere, points and anchors of posed views.
fn hang_on_poses(posed: &mut PosedViews) {
    posed.spheres.push(LocatedSphere {
        center_sigma: [1e-3; 3],
        seen_in: (0..posed.views.len()).map(|k| (PhotoIdx(k), 0.1)).collect(),
        ..true_sphere(BALL_CENTER, BALL_RADIUS)
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
