//! The shading problem from what is known of every view, wherever it was read: in files or in a caller's arrays.

use crate::config::StageOptions;
use crate::exit::Failure;
use crate::observe::Console;
use crate::pipeline::from_lighting;
use rilievo_scene::{
    DecodedPhoto, DepthMap, Intrinsics, Lighting, LinearImage, Mask, RigidTransform, StageId,
};
use rilievo_shading::paper::{DepthPrior, ShadingProblem, ShadingView, ViewLight};
use std::sync::Arc;

/// What is known of a view.
#[derive(Debug)]
pub struct ViewParts {
    /// Name for messages and files.
    pub name: String,
    /// The image as its file or array holds it: integers as a camera's files, floats linear with white at 1.
    pub photo: DecodedPhoto,
    /// The object; the whole frame by default.
    pub mask: Option<Mask>,
    /// Camera without distortion.
    pub intrinsics: Intrinsics,
    /// Pose, needed where matches tie the view to others.
    pub cam_from_world: Option<RigidTransform>,
    /// Lighting times mean albedo with where it is from; fitted on the prior or initial depth by default.
    pub lighting: Option<(Lighting, String)>,
    /// Start; 0 where there is no value.
    pub initial: Option<DepthMap>,
    /// Measured depth to stay near to; 0 where there is no value.
    pub prior: Option<DepthMap>,
}

/// Why a mask does not belong to an image of a size (columns, rows), if so.
pub fn mask_misfit(mask: &Mask, (width, height): (usize, usize)) -> Option<String> {
    ((mask.width, mask.height) != (width, height)).then(|| {
        format!(
            "the mask has {} x {} pixels, the image {width} x {height}",
            mask.width, mask.height
        )
    })
}

/// The problem, and where each view's lighting came from.
#[derive(Default)]
pub struct Described {
    pub problem: ShadingProblem,
    /// One entry per view.
    pub lighting: Vec<serde_json::Value>,
}

impl Described {
    /// Adds a view.
    ///
    /// # Errors
    /// Without lighting, when there is no shape to fit it on, or it cannot be fitted.
    pub fn add(
        &mut self,
        parts: ViewParts,
        prior_weight: f64,
        options: &StageOptions,
        console: &Console,
    ) -> anyhow::Result<()> {
        let (view, source) = shading_view(parts, prior_weight, options)?;
        console.note(&format!("  {}: lighting {source}", view.name));
        let used = serde_json::json!({"view": view.name, "lighting": source});
        self.lighting.push(used);
        self.problem.views.push(view);
        Ok(())
    }

    /// Warns where nothing ties several views together.
    pub fn tell_of_matches(&self, console: &Console) {
        if self.problem.matches.is_empty() && self.problem.views.len() > 1 {
            console.warn(
                StageId::Shading,
                "no matches tie the views together; each is solved alone",
            );
        }
    }
}

/// A view of the problem, and where its lighting came from.
fn shading_view(
    parts: ViewParts,
    prior_weight: f64,
    options: &StageOptions,
) -> anyhow::Result<(ShadingView, String)> {
    let measured_as_float = parts.photo.samples.bits() == 32;
    let (image, _) = rilievo_photos::linearize(&parts.photo, options.photos.encoding);
    // A float image may hold any value; integers end at white, where they are clipped.
    let clip_level = (!measured_as_float).then_some(options.photos.clip_fraction as f32);
    let whole = || Mask::filled(image.width, image.height, true);
    let mask = parts.mask.unwrap_or_else(whole);
    let (lighting, source) = match parts.lighting {
        Some(given) => given,
        None => {
            let shape = parts.prior.as_ref().or(parts.initial.as_ref());
            let shape = shape.ok_or_else(|| {
                Failure::Usage(format!(
                    "view {} has no lighting: give --lighting FILE[:NAME], or a shape to fit it on \
                     (--init or --prior DEPTH.exr)",
                    parts.name
                ))
            })?;
            fitted_lighting(&image, &mask, &parts.intrinsics, shape, clip_level)?
        }
    };
    let mut solved = ShadingView::new(
        parts.name,
        Arc::new(image),
        mask,
        parts.intrinsics,
        ViewLight::Uniform(lighting),
    );
    solved.clip_level = clip_level;
    solved.cam_from_world = parts.cam_from_world;
    solved.initial_depth = parts.initial;
    solved.prior = parts.prior.map(|depth| DepthPrior {
        depth,
        weight: prior_weight,
    });
    Ok((solved, source))
}

fn fitted_lighting(
    image: &LinearImage,
    mask: &Mask,
    intrinsics: &Intrinsics,
    shape: &DepthMap,
    clip_level: Option<f32>,
) -> anyhow::Result<(Lighting, String)> {
    let (lighting, fit) = rilievo_lighting::fit_on_shape(
        image,
        Some(&mask.packed()),
        intrinsics,
        shape,
        clip_level.unwrap_or(f32::INFINITY),
    )
    .map_err(from_lighting)?;
    let source = format!(
        "fitted on the given shape, residual {:.1} %",
        100.0 * fit.relative_rms()
    );
    Ok((lighting, source))
}
