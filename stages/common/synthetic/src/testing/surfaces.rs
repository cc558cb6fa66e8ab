//! Surfaces without a mesh: what a camera sees of them, as maps, photos and anchors.

use nalgebra::{Point2, Vector3};
use rilievo_scene::{
    Anchor, AnchorObservation, AnchorOrigin, DepthMap, Intrinsics, LinearImage, Mask, NormalMap,
    PosedViews, Raster, ShadedView, ViewIdx,
};

/// Depth and normal (camera frame) where a pixel's ray enters a sphere, whose centre is given in the
/// camera frame.
pub fn on_sphere(
    center: &Vector3<f64>,
    radius: f64,
    camera: &Intrinsics,
    [x, y]: [f64; 2],
) -> Option<(f64, Vector3<f64>)> {
    let ray = camera.ray(&Point2::new(x, y));
    let (a, b) = (ray.norm_squared(), ray.dot(center));
    let root = b * b - a * (center.norm_squared() - radius * radius);
    (root > 0.0).then(|| {
        let depth = (b - root.sqrt()) / a;
        (depth, (ray * depth - center) / radius)
    })
}

/// Depth and normals of every pixel that meets a surface, and which do.
#[derive(Clone, Debug, PartialEq)]
pub struct Maps {
    /// Depth, 0 elsewhere.
    pub depth: DepthMap,
    /// Normals, camera frame; zero elsewhere.
    pub normal: NormalMap,
    /// Where the surface is.
    pub mask: Mask,
}

impl Maps {
    /// What `surface` tells of every pixel: depth and normal.
    pub fn of(
        camera: &Intrinsics,
        surface: impl Fn([f64; 2]) -> Option<(f64, Vector3<f64>)>,
    ) -> Self {
        let (width, height) = (camera.width, camera.height);
        let seen = Raster::from_fn(width, height, |x, y| surface([x as f64, y as f64]));
        Self {
            depth: map(&seen, |hit| hit.map_or(0.0, |(depth, _)| depth as f32)),
            normal: map(&seen, |hit| {
                hit.map_or([0.0; 3], |(_, n)| n.map(|c| c as f32).into())
            }),
            mask: map(&seen, |hit| hit.is_some()),
        }
    }

    /// The maps as if stage 5 had found them.
    pub fn shaded(self, view: usize, name: &str) -> ShadedView {
        ShadedView {
            view: ViewIdx(view),
            name: name.to_owned(),
            depth: self.depth,
            normal: self.normal,
            confidence: None,
            rendered: None,
            albedo: None,
        }
    }
}

fn map<T: Copy, U>(raster: &Raster<T>, value: impl Fn(T) -> U) -> Raster<U> {
    Raster {
        width: raster.width,
        height: raster.height,
        data: raster.data.iter().map(|&v| value(v)).collect(),
    }
}

/// A photo of a background in which pixels are painted where `colour` knows one.
pub fn painted<const CHANNELS: usize>(
    camera: &Intrinsics,
    background: f32,
    colour: impl Fn([f64; 2]) -> Option<[f64; CHANNELS]>,
) -> LinearImage {
    let mut image = LinearImage::filled(camera.width, camera.height, CHANNELS, background);
    for y in 0..camera.height {
        for x in 0..camera.width {
            if let Some(colour) = colour([x as f64, y as f64]) {
                for (value, channel) in image.pixel_mut(x, y).iter_mut().zip(colour) {
                    *value = channel as f32;
                }
            }
        }
    }
    image
}

/// Anchors on a grid of every view's pixels, seen by all views that see the surface there: the depth
/// of a map times the next of `factors`, and the surface is seen where the logarithm of the depth is
/// at most `tolerance` off.
pub fn anchors_on_grid(
    posed: &PosedViews,
    depths: &[DepthMap],
    step: usize,
    tolerance: f64,
    mut factors: impl FnMut() -> f64,
) -> Vec<Anchor> {
    let mut anchors = Vec::new();
    for (view, depth) in posed.views.iter().zip(depths) {
        for y in (0..depth.height).step_by(step) {
            for x in (0..depth.width).step_by(step) {
                let z = f64::from(*depth.at(x, y));
                if z <= 0.0 {
                    continue;
                }
                let pixel = Point2::new(x as f64, y as f64);
                let in_camera = view.intrinsics.unproject(&pixel, z * factors());
                let point = view.cam_from_world.inverse().apply(&in_camera);
                let seen = posed.views.iter().zip(depths).enumerate();
                let observations: Vec<AnchorObservation> = seen
                    .filter_map(|(idx, (view, depth))| {
                        let in_camera = view.cam_from_world.apply(&point);
                        let at = view.intrinsics.project(&in_camera)?;
                        let there = depth.get(at.x.round() as isize, at.y.round() as isize)?;
                        let off = (f64::from(*there) / in_camera.z).ln().abs();
                        (off < tolerance).then_some(AnchorObservation {
                            view: ViewIdx(idx),
                            pixel: at.into(),
                            depth: in_camera.z,
                            sigma_ln_depth: 1e-3,
                        })
                    })
                    .collect();
                if observations.len() >= 2 {
                    anchors.push(Anchor {
                        position: point.into(),
                        covariance: [1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8],
                        origin: AnchorOrigin::Grown,
                        observations,
                    });
                }
            }
        }
    }
    anchors
}
