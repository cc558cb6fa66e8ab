//! Lighting without a sphere or a shape: fitted on the normals of the depth anchors.
//!
//! The anchors come from the photos' agreement alone, so light and shape are not circular. What
//! stays open: brightness and albedo share one factor; and as the normals are smoothed by their
//! neighbourhoods, the light comes out a little too weak in its variation. The fit is marked
//! uncalibrated.
//!
//! # Steps
//! 1. Normals at the anchors ([`crate::anchor_normals`]).
//! 2. Gains of the photos from the anchors themselves, for a light fixed in the world: a matte
//!    point has one brightness in all photos.
//! 3. Robust fit of one environment, or of one lighting per view.

use crate::anchor_normals::{AnchorReading, orient, seen_by};
use crate::cells::{CellMean, TwoWay, two_way};
use crate::environment::{in_view, ones};
use crate::error::LightingError;
use crate::error::warn;
use crate::kind;
use crate::pool::Pool;
use crate::report::{ChannelReport, KindCheck, LightingReport, ViewLightReport};
use nalgebra::{UnitQuaternion, Vector3};
use rilievo_photometry::harmonics::{LightingFit, Reading, dominant_direction};
use rilievo_photometry::samples::CLIP_SHARE;
use rilievo_scene::{
    LightKind, LightSource, LightingCalibration, Observer, PhotoSet, PosedViews, StageId, ViewIdx,
    ViewLighting,
};

/// Fewest anchors with a normal.
const MIN_ANCHORS: usize = 60;
/// How many times less scatter decides the kind of light. Less than on spheres: the object shades itself,
/// which scatters brightness under a light on the camera, and anchors under a light at rest leave noise
/// alone.
const CLEAR: f64 = 1.2;

/// Anchors of every view with normals and intensities.
pub(crate) fn anchor_samples(
    photos: &PhotoSet,
    posed: &PosedViews,
    observer: &dyn Observer,
) -> Result<Vec<Vec<AnchorReading>>, LightingError> {
    let oriented = orient(posed);
    let mut samples = Vec::with_capacity(posed.views.len());
    for (idx, view) in posed.views.iter().enumerate() {
        let flow = observer.progress(
            StageId::Lighting,
            "reading brightness at the anchors",
            (idx, posed.views.len()),
        );
        flow.ok_or(LightingError::Interrupted)?;
        let photo = &photos.photos[view.photo.0];
        let image = photo.linear()?;
        let limit = f64::from(photo.clip_level) * CLIP_SHARE;
        samples.push(seen_by(posed, &oriented, idx, &image, limit));
    }
    Ok(samples)
}

fn num_channels(samples: &[Vec<AnchorReading>]) -> Option<usize> {
    let first = samples.iter().flatten().next()?;
    Some(first.reading.values.len())
}

/// Compares what the views show of each anchor: `value` reads it, `None` where the reading does not count.
fn compare_anchors(
    samples: &[Vec<AnchorReading>],
    value: impl Fn(&Reading) -> Option<f64>,
) -> TwoWay {
    let mut means = Vec::new();
    for (view, seen) in samples.iter().enumerate() {
        for AnchorReading { anchor, reading } in seen {
            let value = value(reading).filter(|v| *v > 0.0 && v.is_finite());
            means.extend(value.map(|value| CellMean {
                view,
                cell: *anchor,
                value: value.ln(),
            }));
        }
    }
    two_way(samples.len(), &means)
}

/// Gain per view and channel from the anchors; 1 where a view shares too few with the others.
pub(crate) fn anchor_gains(samples: &[Vec<AnchorReading>], num_channels: usize) -> Vec<Vec<f64>> {
    let mut gains = vec![ones(num_channels); samples.len()];
    for channel in 0..num_channels {
        let fit = compare_anchors(samples, |reading| {
            reading.usable[channel].then(|| reading.values[channel])
        });
        for (gain, ln_gain) in gains.iter_mut().zip(&fit.ln_gain) {
            gain[channel] = ln_gain.exp();
        }
    }
    gains
}

pub(crate) fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    stated: Option<LightKind>,
    observer: &dyn Observer,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    let samples = anchor_samples(photos, posed, observer)?;
    let available = samples.iter().map(Vec::len).sum::<usize>();
    if available < MIN_ANCHORS {
        return Err(LightingError::TooFewAnchors {
            available,
            needed: MIN_ANCHORS,
        });
    }
    let num_channels = num_channels(&samples).unwrap_or(1);
    let kind_check = check_kind(posed, &samples, stated);
    let kind = kind::settled(stated, kind_check.as_ref());
    let mut report = LightingReport {
        source: LightSource::OwnShape,
        kind,
        kind_check,
        uncalibrated: true,
        ..LightingReport::default()
    };
    let message = "the light is uncalibrated: fitted on the photos' own rough shape; brightness and albedo \
         share one unknown factor, and where the shape is uncertain bumps and hollows may swap; \
         put a matte sphere beside the object to be sure";
    warn(observer, message.to_owned())?;
    let gains = if kind == LightKind::World {
        anchor_gains(&samples, num_channels)
    } else {
        vec![ones(num_channels); samples.len()]
    };
    report.gains_applied = gains.iter().flatten().any(|g| (g - 1.0).abs() > 0.0);
    for (view, (sample, gain)) in posed.views.iter().zip(samples.iter().zip(&gains)) {
        report.views.push(ViewLightReport {
            num_pixels: sample.len(),
            gain: gain.clone(),
            ..ViewLightReport::named(&view.name)
        });
    }
    let everything: Vec<usize> = (0..samples.len()).collect();
    let pooled = pool(posed, &samples, &gains, &everything)?;
    report.channels = pooled.channels.iter().map(ChannelReport::from).collect();
    let environment = pooled.lighting();
    report.dominant_direction = dominant_direction(&environment).map(Into::into);
    let mut views = Vec::with_capacity(samples.len());
    for (idx, view) in posed.views.iter().enumerate() {
        // A light fixed to the camera: each view's own fit where its anchors allow.
        let own = (kind == LightKind::Camera)
            .then(|| pool(posed, &samples, &gains, &[idx]).ok())
            .flatten();
        let in_world = own
            .as_ref()
            .map_or(environment.clone(), LightingFit::lighting);
        let lighting = in_view(&in_world, view, &gains[idx]);
        let residual = own.as_ref().unwrap_or(&pooled).relative_rms();
        report.views[idx].relative_rms = Some(residual);
        views.push(ViewLighting {
            view: ViewIdx(idx),
            lighting,
            residual: Some(residual),
            gain: gains[idx].clone(),
        });
    }
    let calibration = LightingCalibration {
        source: LightSource::OwnShape,
        kind,
        environment_in_world: (kind == LightKind::World).then_some(environment),
        views,
        spheres: Vec::new(),
        samples: Vec::new(),
    };
    Ok((calibration, report))
}

/// What the light is fixed to: under a light at rest a matte anchor has one brightness in all photos,
/// under one on the camera what one lighting in the camera's frame gives its normal there. Either may
/// differ by a gain a photo.
fn check_kind(
    posed: &PosedViews,
    samples: &[Vec<AnchorReading>],
    stated: Option<LightKind>,
) -> Option<KindCheck> {
    let num_channels = num_channels(samples)?;
    let everything: Vec<usize> = (0..samples.len()).collect();
    let gains = vec![ones(num_channels); samples.len()];
    let as_seen = |_: usize| UnitQuaternion::identity();
    let on_camera = pool_in(samples, &gains, &everything, as_seen)
        .ok()?
        .lighting();
    let scatter = |predicted: &dyn Fn(&Vector3<f64>) -> f64| {
        compare_anchors(samples, |reading| {
            let ratio = || reading.brightness() / predicted(&reading.normal);
            reading.is_whole().then(ratio)
        })
    };
    let at_rest = scatter(&|_| 1.0);
    let moving = scatter(&|n| on_camera.channels.iter().map(|l| l.evaluate(n)).sum());
    if at_rest.num_shared < MIN_ANCHORS || moving.num_shared < MIN_ANCHORS {
        return None;
    }
    Some(kind::judge(
        &kind::world_from_cam(posed),
        stated,
        CLEAR,
        (at_rest.scatter, moving.scatter),
    ))
}

/// Robust fit over the anchors of some views, in the world frame.
pub(crate) fn pool(
    posed: &PosedViews,
    samples: &[Vec<AnchorReading>],
    gains: &[Vec<f64>],
    views: &[usize],
) -> Result<LightingFit, LightingError> {
    pool_in(samples, gains, views, |view| {
        posed.views[view].cam_from_world.rotation.inverse()
    })
}

/// [`pool`], in the frame to which `turn` takes each view's normals.
fn pool_in(
    samples: &[Vec<AnchorReading>],
    gains: &[Vec<f64>],
    views: &[usize],
    turn: impl Fn(usize) -> UnitQuaternion<f64>,
) -> Result<LightingFit, LightingError> {
    let mut pool = Pool::default();
    for &view in views {
        let turn = turn(view);
        for seen in &samples[view] {
            pool.push(seen.reading.turned(&turn, &gains[view]));
        }
    }
    pool.fit("the program's own shape")
}
