//! Lighting on a known shape: normals by differences of the depth, then the robust fit.
//!
//! # Equations
//! Points `X(x, y) = z(x, y) · ray(x, y)` of neighbouring pixels; the normal is the normalised
//! cross product of the tangents `∂X/∂x` and `∂X/∂y`, turned towards the camera. Central
//! differences where both neighbours exist, one-sided ones at a border. Steps of more than
//! [`MAX_SLOPE`] (relative change of depth per pixel times the focal length) are depth edges: no
//! tangent crosses them.

use crate::error::LightingError;
use crate::error::warn;
use crate::kind;
use crate::pool::Pool;
use crate::report::{ChannelReport, LightingReport, ViewLightReport};
use nalgebra::{Point2, Vector3};
use rilievo_photometry::harmonics::{LightingFit, Reading};
use rilievo_photometry::samples::{CLIP_SHARE, surface_pixels};
use rilievo_photometry::surface_check::MAX_SAMPLES;
use rilievo_scene::{
    DepthMap, Intrinsics, LightSource, Lighting, LightingCalibration, LinearImage, NormalMap,
    Observer, PackedMask, PhotoSet, PosedViews, Raster, StageId, ViewIdx, ViewLighting,
};

/// Depth steps beyond this slope (relative depth per pixel, in units of 1/focal length) are edges, not
/// surface: 83 degrees.
const MAX_SLOPE: f64 = 8.0;

/// Fits the lighting of one image on a known depth.
///
/// `mask` limits the pixels; `clip_level` is the linear value from which a channel is clipped.
///
/// # Errors
/// [`LightingError::ShapeSize`], [`LightingError::Fit`].
pub fn fit_on_shape(
    image: &LinearImage,
    mask: Option<&PackedMask>,
    intrinsics: &Intrinsics,
    depth: &DepthMap,
    clip_level: f32,
) -> Result<(Lighting, LightingFit), LightingError> {
    let normals = normals_on(image, "the image", intrinsics, depth)?;
    let fit = pool(image, mask, &normals, clip_level).fit("a shape")?;
    Ok((fit.lighting(), fit))
}

/// Normals of a depth map that must have the image's size; `name` is what messages call the image.
fn normals_on(
    image: &LinearImage,
    name: &str,
    intrinsics: &Intrinsics,
    depth: &DepthMap,
) -> Result<NormalMap, LightingError> {
    if (depth.width, depth.height) != (image.width, image.height) {
        return Err(LightingError::ShapeSize {
            name: name.to_owned(),
            width: depth.width,
            height: depth.height,
            photo_width: image.width,
            photo_height: image.height,
        });
    }
    Ok(normals_of_depth(depth, intrinsics, MAX_SLOPE))
}

/// Normals (camera frame) and intensities of a surface's pixels.
fn pool(
    image: &LinearImage,
    mask: Option<&PackedMask>,
    normals: &NormalMap,
    clip_level: f32,
) -> Pool {
    let limit = f64::from(clip_level) * CLIP_SHARE;
    let mut pool = Pool::default();
    for (x, y, normal) in surface_pixels(image, mask, normals, MAX_SAMPLES) {
        pool.push(Reading::of_pixel(normal, image.pixel(x, y), limit));
    }
    pool
}

/// Normals of a depth map by differences.
fn normals_of_depth(depth: &DepthMap, intrinsics: &Intrinsics, max_slope: f64) -> NormalMap {
    let at = |x: isize, y: isize| -> Option<(f64, Vector3<f64>)> {
        let z = f64::from(*depth.get(x, y)?);
        (z > 0.0).then(|| (z, intrinsics.ray(&Point2::new(x as f64, y as f64)) * z))
    };
    let limit = max_slope / intrinsics.focal_px();
    let tangent = |x: isize, y: isize, dx: isize, dy: isize| -> Option<Vector3<f64>> {
        let (z, here) = at(x, y)?;
        let joined = |other: Option<(f64, Vector3<f64>)>| {
            other.filter(|(z2, _)| (z2 / z).ln().abs() <= limit)
        };
        let after = joined(at(x + dx, y + dy)).map(|(_, p)| p);
        let before = joined(at(x - dx, y - dy)).map(|(_, p)| p);
        match (before, after) {
            (Some(b), Some(a)) => Some((a - b) * 0.5),
            (None, Some(a)) => Some(a - here),
            (Some(b), None) => Some(here - b),
            (None, None) => None,
        }
    };
    Raster::from_fn(depth.width, depth.height, |x, y| {
        let (x, y) = (x as isize, y as isize);
        let normal = (|| {
            let (_, here) = at(x, y)?;
            let along_x = tangent(x, y, 1, 0)?;
            let along_y = tangent(x, y, 0, 1)?;
            let n = along_y.cross(&along_x).try_normalize(0.0)?;
            Some(if n.dot(&here) < 0.0 { n } else { -n })
        })();
        normal.map_or([0.0; 3], |n| [n.x as f32, n.y as f32, n.z as f32])
    })
}

/// One lighting per view with a shape; a view without takes the lighting of none.
///
/// What the light is fixed to is nowhere stated: brightness on the shape decides ([`kind::check_on_shape`]), and where
/// it cannot, the light is taken to rest, as it does when a camera is walked around an object.
pub(crate) fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    shapes: &[(ViewIdx, DepthMap)],
    observer: &dyn Observer,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let mut views = Vec::new();
    let mut report = LightingReport {
        source: LightSource::Shape,
        ..LightingReport::default()
    };
    let mut worst: Option<LightingFit> = None;
    let mut brightness = vec![Vec::new(); posed.views.len()];
    for (idx, view) in posed.views.iter().enumerate() {
        let flow = observer.progress(
            StageId::Lighting,
            "fitting light on the shape",
            (idx, posed.views.len()),
        );
        flow.ok_or(LightingError::Interrupted)?;
        let mut facts = ViewLightReport::named(&view.name);
        let Some((_, depth)) = shapes.iter().find(|(shape, _)| shape.0 == idx) else {
            facts.left_out = Some("no shape given".to_owned());
            let message = format!(
                "{}: no shape was given, so it has no lighting and is not shaded",
                view.name
            );
            warn(observer, message)?;
            report.views.push(facts);
            continue;
        };
        let photo = &photos.photos[view.photo.0];
        let image = photo.linear()?;
        let normals = normals_on(&image, &view.name, &view.intrinsics, depth)?;
        let mask = photo.mask.as_deref();
        let pool = pool(&image, mask, &normals, photo.clip_level);
        brightness[idx] = pool.brightness();
        let fit = match pool.fit(&view.name) {
            Ok(fit) => fit,
            Err(LightingError::Fit { source, .. }) => {
                facts.left_out = Some(source.to_string());
                warn(observer, format!("{}: {source}", view.name))?;
                report.views.push(facts);
                continue;
            }
            Err(error) => return Err(error),
        };
        let counts = fit.channels.iter().map(|c| c.num_samples);
        facts.num_pixels = counts.max().unwrap_or(0);
        facts.relative_rms = Some(fit.relative_rms());
        let lighting = fit.lighting();
        facts.gain = vec![1.0; lighting.channels.len()];
        views.push(ViewLighting {
            view: ViewIdx(idx),
            residual: facts.relative_rms,
            gain: facts.gain.clone(),
            lighting,
        });
        report.views.push(facts);
        if worst
            .as_ref()
            .is_none_or(|w| w.relative_rms() < fit.relative_rms())
        {
            worst = Some(fit);
        }
    }
    let Some(worst) = worst else {
        return Err(LightingError::NoShape);
    };
    report.channels = worst.channels.iter().map(ChannelReport::from).collect();
    report.kind_check = kind::check_on_shape(&kind::world_from_cam(posed), &brightness);
    report.kind = kind::settled(None, report.kind_check.as_ref());
    let calibration = LightingCalibration {
        source: LightSource::Shape,
        kind: report.kind,
        environment_in_world: None,
        views,
        spheres: Vec::new(),
        samples: Vec::new(),
    };
    Ok((calibration, report))
}
