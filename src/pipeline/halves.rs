//! Stage 5 on two disjoint halves of a run's views, from the poses and the light of the run.

use super::context::Context;
use super::errors::from_shading;
use crate::exit::Failure;
use crate::store::FileScratch;
use rilievo_scene::{PosedViews, ShadedView, ShadedViews, ViewIdx};
use rilievo_shading::{ShadingError, Surroundings};

/// Views that a half needs to be shaped.
const MIN_VIEWS: usize = 2;

/// A half of the views, and what was found of it.
pub struct ShapedHalf {
    /// Its cameras.
    pub posed: PosedViews,
    /// Its maps.
    pub shaded: ShadedViews,
}

/// Shapes the views of even and of odd viewpoints, each half alone: in the order of the photos, so that both see the
/// object from all around where the photos were taken in turn, and neither a copy of what the other sees.
///
/// # Errors
/// When there are too few views, a half cannot be shaped, or the user asked to stop.
pub fn shaped_halves(context: &Context<'_>) -> anyhow::Result<[ShapedHalf; 2]> {
    let photos = super::photos::load(context)?;
    let posed = super::poses::load(context.run)?;
    let lighting = super::lighting::load(context)?;
    let num_views = posed.views.len();
    let viewpoints = posed.viewpoints();
    let mut first_views = viewpoints.clone();
    first_views.sort_unstable();
    first_views.dedup();
    if first_views.len() < 2 * MIN_VIEWS {
        return Err(Failure::NoResult(format!(
            "views from {} places cannot be shaped in two halves: it takes {} with a pose",
            first_views.len(),
            2 * MIN_VIEWS
        ))
        .into());
    }
    let scratch = FileScratch::new(&context.run.work_folder()?);
    let shaped = |first: usize| -> anyhow::Result<ShapedHalf> {
        let is_kept = |view: &ViewIdx| {
            let place = first_views.binary_search(&viewpoints[view.0]);
            place.is_ok_and(|place| place % 2 == first)
        };
        let kept: Vec<ViewIdx> = (0..num_views).map(ViewIdx).filter(is_kept).collect();
        let half = posed.of_views(&kept);
        let names: Vec<&str> = half.views.iter().map(|view| view.name.as_str()).collect();
        context
            .console
            .note(&format!("shaping {}", names.join(", ")));
        let (shaded, _) = rilievo_shading::run(
            &photos,
            &half,
            &lighting.of_views(num_views, &kept),
            &context.request.options.shading,
            Surroundings {
                scratch: &scratch,
                ..Surroundings::in_memory(context.console)
            },
        )
        .map_err(from_shading)?;
        let maps = |i| -> Result<ShadedView, ShadingError> {
            Ok(ShadedView {
                confidence: None,
                rendered: None,
                albedo: None,
                ..shaded.view(i)?
            })
        };
        let views = (0..shaded.num_views()).map(maps).collect::<Result<_, _>>();
        let shaded = ShadedViews {
            views: views.map_err(from_shading)?,
        };
        Ok(ShapedHalf {
            posed: half,
            shaded,
        })
    };
    Ok([shaped(0)?, shaped(1)?])
}
