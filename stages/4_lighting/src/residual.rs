//! How much of the spheres' pixels a lighting leaves unexplained.

use crate::side::Counted;
use rilievo_numerics::robust::{SIGMA_FROM_MAD, median};
use rilievo_scene::Lighting;

/// Relative residual of `(value, prediction)` pairs, over those within three deviations.
pub(crate) fn residual_of(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let (sizes, errors): (Vec<f64>, Vec<f64>) = pairs
        .map(|(value, predicted)| (value, (predicted - value).abs()))
        .unzip();
    let mut sorted = errors.clone();
    let limit = 3.0 * SIGMA_FROM_MAD * median(&mut sorted)?;
    let (mut error, mut size) = (0.0, 0.0);
    for (e, s) in errors.iter().zip(&sizes) {
        if *e <= limit {
            error += e * e;
            size += s * s;
        }
    }
    (size > 0.0).then(|| (error / size).sqrt())
}

/// Relative residual of a view's lighting on the spheres that it shows.
pub(crate) fn residual_in(view: &[Counted<'_>], lighting: &Lighting) -> Option<f64> {
    residual_of(view.iter().flat_map(|(patch, paint)| {
        patch.samples.readings.iter().flat_map(move |reading| {
            let channels = lighting.channels.iter().enumerate();
            let usable = channels.filter(|(channel, _)| reading.usable[*channel]);
            usable.map(move |(channel, light)| {
                let predicted = light.evaluate(&reading.normal) * paint[channel];
                (reading.values[channel], predicted)
            })
        })
    }))
}
