//! The light on the current shape, and the ground that it shines on.

use super::distant;
use super::environment::{self, LightScene};
use super::known_light::KnownLight;
use super::light::Light;
use super::memory;
use super::report::LightFacts;
use super::schedule::IterationWeights;
use super::solver::Solver;
use super::steps::PhotoStep;
use super::surround;
use super::views::SolvedFrame;
use super::{albedo, hidden_light, validation};
use crate::error::ShadingError;
use nalgebra::Point3;
use rilievo_numerics::solver_set::SolverSet;
use rilievo_photometry::visibility::Ground;
use rilievo_scene::{LightKind, Lighting, LightingCalibration, PosedViews, ViewLighting};
use rilievo_stereo::spread;
use std::borrow::Cow;
use std::time::Instant;

impl Solver<'_> {
    /// The ground under the object, where sparse points show one.
    pub fn ground(&self, at: usize, depths: &[Vec<f64>], posed: &PosedViews) -> Option<Ground> {
        let level = self.scene.level(at);
        let points: Vec<Point3<f64>> = posed
            .points
            .iter()
            .map(|p| Point3::from(p.position))
            .collect();
        let object = surround::object_points(level, depths);
        surround::find_ground(&points, &object, &self.scene.small)
    }

    /// The light on the current shape: with visibility, or else distant.
    pub fn light(
        &mut self,
        at: usize,
        depths: &[Vec<f64>],
        posed: &PosedViews,
        lighting: &LightingCalibration,
        ground: Option<&Ground>,
    ) -> Result<Option<Light>, ShadingError> {
        let began = Instant::now();
        self.progress(PhotoStep::Light, 0, 1)?;
        let level = self.scene.level(at);
        let rays_at = self.scene.coarser(at);
        let kind = lighting.kind;
        let gains: Vec<[f64; 3]> = self.scene.frames.iter().map(|frame| frame.gain).collect();
        let known = KnownLight::new(lighting, &posed.spheres, &gains);
        let scene = LightScene {
            known: &known,
            ground,
            num_rays: self.options.effort.num_rays,
            team: self.observer().team(),
        };
        let seen = if self.options.visibility {
            environment::visible(level, depths, rays_at, &scene)?
        } else {
            None
        };
        let sees_shadows = seen.is_some();
        self.report.light_sees_shadows = sees_shadows;
        let light = seen.or_else(|| distant::fit(level, depths, kind));
        let is_lit = light.is_some();
        let shading = match (sees_shadows, is_lit) {
            (true, _) => "light with visibility",
            (false, true) => "distant light",
            (false, false) => "no light could be fitted",
        };
        self.report.shading = shading.to_owned();
        let is_known = !known.groups.is_empty();
        let notes = [
            (
                kind == LightKind::Camera,
                "the light moves with the camera: the photos show a point under different light, agree \
                 less, and tell nothing of their exposures, which are taken for equal",
            ),
            (
                is_lit && !is_known,
                "no sphere or given light could be used: the light is read from the object's own surface, so that a light over \
                 the whole object and its albedo cannot be told apart",
            ),
            (
                is_lit && is_known && !sees_shadows,
                "the distant light is fitted on the object alone: spheres and a given light are not used \
                 by it",
            ),
        ];
        for (_, note) in notes.into_iter().filter(|(applies, _)| *applies) {
            self.note(note);
        }
        let step = self.report.add_step(PhotoStep::Light, at, began);
        step.light = light.as_ref().map(|light| LightFacts {
            residual: light.residual(),
            openness_exponent: light.openness_exponent,
            distance: light.distance,
            has_ground: ground.is_some(),
        });
        Ok(light)
    }

    /// Lets photos that are left out judge shading, and sets the light's trust.
    pub fn validate(
        &mut self,
        at: usize,
        solvers: &SolverSet,
        depths: &[Vec<f64>],
        light: Option<&mut Light>,
        weights: &IterationWeights,
    ) -> Result<(), ShadingError> {
        let (Some(light), Some(shading)) = (light, weights.shading) else {
            return Ok(());
        };
        let began = Instant::now();
        self.progress(PhotoStep::Validation, 0, 1)?;
        let options = self.step_options(at, weights);
        let level = self.scene.level(at);
        let at_once = self.budget().at_once(memory::solve_bytes(level));
        let judged = validation::validate(
            level,
            solvers,
            depths,
            light,
            (&shading, &options),
            (self.observer().team(), at_once),
            |i, error| self.failed(i, error),
        )?;
        let Some(judged) = judged else {
            self.note(
                "no photo could be left out, so that shading is judged by the light's residual alone",
            );
            return Ok(());
        };
        for (view, trust) in self.report.views.iter_mut().zip(&judged.trust) {
            let n = trust.len().max(1) as f64;
            view.shading_trust = Some(trust.iter().map(|&t| f64::from(t)).sum::<f64>() / n);
            view.without_shading = Some(trust.iter().filter(|&&t| t < 0.1).count() as f64 / n);
        }
        light.trust = judged.trust;
        self.report.validation = Some(judged.report);
        self.report.add_step(PhotoStep::Validation, at, began);
        Ok(())
    }

    /// The light at the next finer level.
    pub fn finer_light(&self, at: usize, depths: &[Vec<f64>], mut light: Light) -> Light {
        let (fine, coarse) = (self.scene.level(at), self.scene.level(at + 1));
        light.mean_tolerance *= coarse.focal() / fine.focal();
        for (i, trust) in light.trust.iter_mut().enumerate() {
            let values: Vec<[f32; 1]> = trust.iter().map(|&t| [t]).collect();
            let finer = spread::spread(&coarse.views[i], &fine.views[i], &values);
            *trust = finer.iter().map(|t| t[0]).collect();
        }
        let scene = &self.scene;
        let harmonics = |light: &Light, i| scene.harmonics(light, i, at).into_owned();
        if light.pigment.take().is_some() {
            let of_view = |i| Cow::Owned(harmonics(&light, i));
            let pigment = albedo::estimate(fine, depths, &of_view, light.mean_tolerance);
            light.pigment = Some(pigment);
        }
        if light.openness_exponent.is_some() {
            let of_view = |i| Cow::Owned(harmonics(&light, i));
            let pigment = light.pigment.as_ref();
            let exponent = hidden_light::exponent(&fine.views, depths, &of_view, pigment);
            light.openness_exponent = Some(exponent);
        }
        light
    }

    /// The facts on the light that was used.
    pub fn report_light(&mut self, light: &Light) {
        for (view, residual) in self.report.views.iter_mut().zip(&light.residuals) {
            view.light_residual = Some(*residual);
        }
        self.report.pigment = light.pigment.as_ref().map(|p| p.explained);
        let frames = self.scene.frames.iter().zip(&light.in_the_open);
        self.report.light = frames
            .zip(&light.residuals)
            .map(|((frame, lighting), residual)| used(frame, lighting, *residual))
            .collect();
    }
}

/// A view's light with its photo's gain.
fn used(frame: &SolvedFrame, lighting: &Lighting, residual: f64) -> ViewLighting {
    let mut lighting = lighting.clone();
    for (channel, gain) in lighting.channels.iter_mut().zip(frame.gain) {
        channel.0.iter_mut().for_each(|l| *l *= gain);
    }
    ViewLighting {
        view: frame.view,
        lighting,
        residual: residual.is_finite().then_some(residual),
        gain: frame.gain.to_vec(),
    }
}
