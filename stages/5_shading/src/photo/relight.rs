//! The light on the current shape, and the ground that it shines on.

use super::course::Course;
use super::light::{self, Light, LightScene};
use super::report::LapReport;
use super::surround;
use crate::error::ShadingError;
use nalgebra::Point3;
use rilievo_photometry::visibility::Ground;
use rilievo_scene::{LightKind, PosedViews};
use std::time::Instant;

impl Course<'_> {
    /// The ground under the object, where sparse points show one.
    pub(crate) fn ground(
        &self,
        at: usize,
        depths: &[Vec<f64>],
        posed: &PosedViews,
    ) -> Option<Ground> {
        let level = &self.scene.pyramid[at];
        let points: Vec<Point3<f64>> = posed
            .points
            .iter()
            .map(|p| Point3::from(p.position))
            .collect();
        let mut object = Vec::new();
        for (view, depth) in level.views.iter().zip(depths) {
            for p in (0..view.pixels.len()).step_by(29) {
                let (x, y) = view.xy(p);
                object.push(view.camera.unproject(x, y, depth[p].exp()));
            }
        }
        surround::find_ground(&points, &object, &self.scene.small)
    }

    /// The light on the current shape: with visibility, or else distant.
    pub(crate) fn light(
        &mut self,
        at: usize,
        depths: &[Vec<f64>],
        posed: &PosedViews,
        kind: LightKind,
        ground: Option<&Ground>,
    ) -> Result<Option<Light>, ShadingError> {
        let began = Instant::now();
        self.tell("fitting light", 0, 1)?;
        let level = &self.scene.pyramid[at];
        let rays_at = self.scene.pyramid.get(at + 1).unwrap_or(level);
        let scene = LightScene {
            photos: &self.scene.small,
            sphere: posed.sphere.as_ref(),
            ground,
            num_rays: self.options.num_rays,
        };
        // A light fixed to the camera moves over the object: rays into one environment do not hold.
        let seen = if kind == LightKind::World && self.options.visibility {
            light::visible(level, depths, rays_at, &scene)
        } else {
            None
        };
        let used = seen.is_some();
        let light = seen.or_else(|| light::distant(level, depths, kind));
        self.report.shading = match (used, light.is_some()) {
            (true, _) => "light with visibility".to_owned(),
            (false, true) => "distant light".to_owned(),
            (false, false) => "no light could be fitted".to_owned(),
        };
        self.report.laps.push(LapReport {
            level: at,
            kind: format!(
                "light, residual {:.4}{}",
                light.as_ref().map_or(f64::NAN, Light::residual),
                if ground.is_some() { ", ground" } else { "" }
            ),
            seconds: began.elapsed().as_secs_f64(),
            ..LapReport::default()
        });
        Ok(light)
    }

    pub(crate) fn finer_light(&self, at: usize, light: &Light) -> Light {
        let (fine, coarse) = (&self.scene.pyramid[at], &self.scene.pyramid[at + 1]);
        Light {
            harmonics: (0..fine.views.len())
                .map(|i| light::spread(&coarse.views[i], &fine.views[i], &light.harmonics[i]))
                .collect(),
            residuals: light.residuals.clone(),
        }
    }
}
