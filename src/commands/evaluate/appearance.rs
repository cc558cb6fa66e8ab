//! Light, albedo and re-rendered photos of a run against what they should be.

use super::estimate::Estimate;
use super::truth::Truth;
use crate::exit::Failure;
use rilievo_scene::Raster;
use rilievo_synthetic::compare::{Evaluation, ImageErrors, compare_light};

/// Fills in the appearance, and why parts of it are missing.
pub(super) fn compare(
    estimate: &Estimate,
    truth: &Truth,
    evaluation: &mut Evaluation,
) -> Result<(), Failure> {
    let (found, actual) = (estimate.lighting()?, truth.lighting()?);
    let mut lights = Vec::new();
    let (mut albedos, mut images) = (ImageErrors::default(), ImageErrors::default());
    for name in &estimate.expected {
        if let (Some(found), Some(actual)) = (&found, &actual)
            && let (Some(found), Some(actual)) = (found.for_view(name), actual.for_view(name))
        {
            lights.extend(compare_light(found, actual));
        }
        let Some(depth) = estimate.depth(name)? else {
            continue;
        };
        let inside = Raster::from_fn(depth.width, depth.height, |x, y| *depth.at(x, y) > 0.0);
        if let (Some(found), Some(actual)) = (estimate.albedo(name)?, truth.albedo(name)?) {
            albedos.add(&found, &actual, &inside);
        }
        if let (Some(rendered), Some(photo)) = (estimate.rendered(name)?, estimate.photo(name)?) {
            images.add(&rendered, &photo, &inside);
        }
    }
    let mean = |value: &dyn Fn(usize) -> f64| {
        let sum = (0..lights.len()).map(value).sum::<f64>();
        (!lights.is_empty()).then(|| sum / lights.len() as f64)
    };
    let appearance = &mut evaluation.appearance;
    appearance.light_direction_deg = mean(&|i| lights[i].direction_deg);
    appearance.light_rms_rel = mean(&|i| lights[i].rms_rel);
    appearance.albedo_rms_rel = albedos.rms_rel_up_to_factor();
    appearance.rerender_rms_rel = images.rms_rel();
    let missing = [
        (
            "light",
            appearance.light_direction_deg,
            "result and truth do not both have a lighting.json for a view",
        ),
        (
            "albedo",
            appearance.albedo_rms_rel,
            "result and truth do not both have an albedo of a view",
        ),
        (
            "re-rendering",
            appearance.rerender_rms_rel,
            "there is no photo of a view with an image that the result explains",
        ),
    ];
    for (key, value, reason) in missing {
        if value.is_none() {
            evaluation.reasons.insert(key.to_owned(), reason.to_owned());
        }
    }
    Ok(())
}
