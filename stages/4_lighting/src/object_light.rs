//! The object itself as a witness: does the sphere's light explain the object's brightness at the
//! depth anchors, whose normals owe nothing to shading?
//!
//! A sphere beside the object stands in its shadow and bounce light; what it shows is then wrong
//! for the object, worst in the views from the side that the object hides from the sphere. The
//! anchors show it before any shading is done.
//!
//! # Steps
//! 1. Normals and brightness at the anchors ([`crate::anchor_normals`]), photos' gains divided out.
//! 2. Per view, the relative residual of the light in use, after the one factor common to all
//!    views that an albedo other than the sphere's would cause.
//! 3. The same for a light fitted on the anchors, by cross-validation: fitted on one half of the
//!    anchors, judged on the other, so that a fit to their errors gains nothing.
//! 4. Where that is clearly better in the median over the views, the anchors' light replaces the
//!    sphere's; else only the common factor is applied. Both are reported.

use crate::anchor_normals::{AnchorReading, half};
use crate::environment::{in_view, scaled};
use crate::error::LightingError;
use crate::own_shape::{anchor_samples, pool};
use crate::report::{LightingReport, ObjectReport, ViewObjectReport};
use rilievo_numerics::robust::median;
use rilievo_photometry::harmonics::dominant_direction;
use rilievo_photometry::surface_check::WRONG_LIGHT_RATIO;
use rilievo_scene::{
    LightKind, LightSource, Lighting, LightingCalibration, Observer, PhotoSet, PosedViews,
};

/// Fewest sightings of oriented anchors that say anything of the light.
const MIN_SIGHTINGS: usize = 300;
/// Logarithm of a common factor below which it is left alone.
const SMALLEST_FACTOR: f64 = 0.03;
/// Share of the worst sightings that does not count: wrong anchors, specks.
const LEFT_OUT: f64 = 0.03;

/// Compares, and corrects.
pub(crate) fn confront(
    photos: &PhotoSet,
    posed: &PosedViews,
    calibration: &mut LightingCalibration,
    report: &mut LightingReport,
    observer: &dyn Observer,
) -> Result<(), LightingError> {
    if posed.anchors.len() < MIN_SIGHTINGS / 4 {
        return Ok(());
    }
    let samples = anchor_samples(photos, posed, observer)?;
    let sightings: usize = samples.iter().map(Vec::len).sum();
    if sightings < MIN_SIGHTINGS {
        return Ok(());
    }
    let gains: Vec<Vec<f64>> = calibration.views.iter().map(|v| v.gain.clone()).collect();
    let all: Vec<usize> = (0..posed.views.len()).collect();
    // The common factor, and the residuals that it leaves.
    let lightings = calibration.views.iter().map(|v| v.lighting.clone());
    let used: Vec<Lighting> = lightings.collect();
    let mut factors: Vec<f64> = samples
        .iter()
        .zip(&used)
        .filter_map(|(sample, light)| best_factor(sample, light))
        .collect();
    let factor = median(&mut factors).unwrap_or(1.0);
    let halves = [0, 1].map(|parity| {
        let half: Vec<_> = samples.iter().map(|s| half(s, parity)).collect();
        pool(posed, &half, &gains, &all).map(|fit| fit.lighting())
    });
    let [Ok(even), Ok(odd)] = halves else {
        return Ok(());
    };
    let mut views = Vec::with_capacity(samples.len());
    for (idx, view) in posed.views.iter().enumerate() {
        let with_factor = times(&used[idx], factor);
        let cross = [(0, &odd), (1, &even)].map(|(parity, other)| {
            let predicted = in_view(other, view, &gains[idx]);
            squares(&half(&samples[idx], parity), &predicted)
        });
        views.push(ViewObjectReport {
            name: view.name.clone(),
            num_anchors: samples[idx].len(),
            used_rms: relative(squares(&samples[idx], &used[idx])),
            used_rms_after_albedo: relative(squares(&samples[idx], &with_factor)),
            cross_validated_rms: relative(cross.concat()),
        });
    }
    let ratio = |v: &ViewObjectReport| Some(v.used_rms_after_albedo? / v.cross_validated_rms?);
    let mut ratios: Vec<f64> = views.iter().filter_map(ratio).collect();
    let worse = median(&mut ratios).unwrap_or(1.0);
    let replaced = calibration.kind == LightKind::World
        && calibration.source == LightSource::Sphere
        && worse > WRONG_LIGHT_RATIO;
    let scaled_by_factor = !replaced && factor.ln().abs() > SMALLEST_FACTOR;
    if replaced {
        let fit = pool(posed, &samples, &gains, &all)?;
        let environment = fit.lighting();
        for (idx, light) in calibration.views.iter_mut().enumerate() {
            light.lighting = in_view(&environment, &posed.views[idx], &gains[idx]);
            light.residual = views[idx].cross_validated_rms;
        }
        report.dominant_direction = dominant_direction(&environment).map(Into::into);
        calibration.environment_in_world = Some(environment);
    } else if scaled_by_factor {
        for light in &mut calibration.views {
            light.lighting = times(&light.lighting, factor);
        }
        if let Some(environment) = &mut calibration.environment_in_world {
            *environment = times(environment, factor);
        }
    }
    if replaced || scaled_by_factor {
        // The lighting contains the object's albedo from here on, not the sphere's.
        let paints = calibration
            .spheres
            .iter_mut()
            .filter_map(|s| s.paint.as_mut());
        paints.flatten().for_each(|paint| *paint /= factor);
    }
    report.object = Some(ObjectReport {
        views,
        albedo_factor: factor,
        factor_applied: scaled_by_factor,
        light_replaced: replaced,
    });
    Ok(())
}

/// A lighting times one factor for all channels.
fn times(lighting: &Lighting, factor: f64) -> Lighting {
    scaled(lighting.clone(), &vec![factor; lighting.channels.len()])
}

/// Median over the sightings of brightness over prediction.
fn best_factor(seen: &[AnchorReading], light: &Lighting) -> Option<f64> {
    let mut ratios = Vec::new();
    for AnchorReading { reading, .. } in seen {
        let channels = light.channels.iter();
        let predicted: f64 = channels.map(|l| l.evaluate(&reading.normal)).sum();
        let brightness = reading.brightness();
        if reading.is_whole() && predicted > 0.0 && brightness > 0.0 {
            ratios.push(brightness / predicted);
        }
    }
    // A handful of anchors would let one view's shadow speak for its albedo.
    if ratios.len() < 20 {
        return None;
    }
    median(&mut ratios)
}

/// Squared errors and squared values of all unclipped channels.
fn squares(seen: &[AnchorReading], light: &Lighting) -> Vec<(f64, f64)> {
    let mut pairs = Vec::new();
    for AnchorReading { reading, .. } in seen {
        for (channel, l) in light.channels.iter().enumerate() {
            if reading.usable[channel] {
                let value = reading.values[channel];
                let error = l.evaluate(&reading.normal) - value;
                pairs.push((error * error, value * value));
            }
        }
    }
    pairs
}

/// Relative root mean square without the worst few; `None` with too few sightings.
fn relative(mut pairs: Vec<(f64, f64)>) -> Option<f64> {
    if pairs.len() < 60 {
        return None;
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    pairs.truncate(((1.0 - LEFT_OUT) * pairs.len() as f64) as usize);
    let (error, size) = pairs
        .iter()
        .fold((0.0, 0.0), |sum, pair| (sum.0 + pair.0, sum.1 + pair.1));
    (size > 0.0).then(|| (error / size).sqrt())
}
