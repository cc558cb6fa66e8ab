//! Nine distant harmonics for all pixels, fitted robustly on the current normals: of all views
//! together when the light is fixed in the world, of each view when it is fixed to the camera.

use super::light::{self, FIT_PIXELS, Light, rotation};
use nalgebra::Vector3;
use rilievo_photometry::harmonics::{fit_robust, rotate};
use rilievo_scene::{LightKind, Lighting, SphericalHarmonics};
use rilievo_stereo::level::Level;

/// Nine distant harmonics on the current shape.
pub(crate) fn fit(level: &Level, depths: &[Vec<f64>], kind: LightKind) -> Option<Light> {
    let normals = light::normals(level, depths);
    let groups: Vec<Vec<usize>> = match kind {
        LightKind::World => vec![(0..level.views.len()).collect()],
        LightKind::Camera => (0..level.views.len()).map(|i| vec![i]).collect(),
    };
    let mut harmonics = vec![Vec::new(); level.views.len()];
    let mut in_the_open = vec![Lighting::default(); level.views.len()];
    for group in groups {
        let (mut n, mut weights) = (Vec::new(), Vec::new());
        let mut values: [Vec<f64>; 3] = Default::default();
        for &i in &group {
            let view = &level.views[i];
            let step = (view.pixels.len() / FIT_PIXELS).max(1);
            for p in (0..view.pixels.len()).step_by(step) {
                if !view.shows_surface(p) {
                    continue;
                }
                let rgb = view.intensity(p).map(f64::from);
                n.push(view.camera.rotation.tr_mul(&Vector3::from(normals[i][p])));
                let mean = ((rgb[0] + rgb[1] + rgb[2]) / 3.0).max(1e-4);
                weights.push(1.0 / (mean * mean));
                for c in 0..3 {
                    values[c].push(rgb[c]);
                }
            }
        }
        let fitted = values.iter().map(|v| fit_robust(&n, v, Some(&weights)));
        let channels = fitted.map(|fit| Some(fit.ok()?.coefficients));
        let channels: Option<Vec<SphericalHarmonics>> = channels.collect();
        let world = Lighting {
            channels: channels?,
        };
        for &i in &group {
            let own = rotate(&world, &rotation(&level.views[i]));
            let pixel = [0, 1, 2].map(|c| own.channels[c].0.map(|v| v as f32));
            harmonics[i] = vec![pixel; level.views[i].pixels.len()];
            in_the_open[i] = own;
        }
    }
    let light = Light::new((level, &normals), harmonics, in_the_open, kind);
    Some(light.with_pigment(level, depths, &normals))
}
