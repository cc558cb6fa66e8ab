//! Stage 6: depth and normal maps of all views to one oriented point cloud and a mesh.
//!
//! In: posed views, their depth and normal maps, the photos (for colour). Out: a [`FusedCloud`] and
//! a [`FusionReport`].
//!
//! 1. `view`, `views`, `memory`: maps are loaded one by one, checked, cut to the object and halved where the
//!    memory does not suffice; borders, depth edges and grazing surface are left out.
//! 2. `pairs`, `reconcile`: how far the views lie apart, and a joint robust adjustment of the
//!    smooth part of it.
//! 3. `points`, `color`: every piece of surface once, from the view that resolves it best, at
//!    the mean of the views that agree.
//! 4. `tsdf`, `surface`, `rim`, `holes`: signed distances of all views, their zero set as a mesh.
//!
//! Lengths are measured in pixel footprints `z / f` throughout: the same options serve a coin and
//! a statue.

mod color;
mod error;
mod holes;
mod memory;
mod options;
mod pairs;
mod points;
mod reconcile;
mod report;
mod rim;
mod surface;
mod tsdf;
mod view;
mod views;

pub use error::FusionError;
pub use options::{ColorMode, FusionOptions};
pub use report::{FusionReport, Layering, MeshReport, ViewFusion};

use color::ColorSource;
use rilievo_scene::{
    CloudPoint, FusedCloud, MapSource, Mesh, Observer, PhotoSet, PointCloud, PosedViews, StageId,
    Unit,
};

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 5;

/// Views that each view is compared with for offsets: more only repeat what these say.
const NUM_NEIGHBOURS: usize = 4;
/// Smooth distance between views, in footprints, from which the layers show.
const VISIBLE_LAYERING_PX: f64 = 1.0;

/// Fuses the views. `photos` may lack some or all photos of the views: their points are grey then.
/// `maps` are loaded one view at a time; [`rilievo_scene::ShadedViews`] are such maps.
///
/// # Errors
/// See [`FusionError`].
pub fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    maps: &dyn MapSource,
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<(FusedCloud, FusionReport), FusionError> {
    options.validate()?;
    photos.check()?;
    posed.check()?;
    let mut report = FusionReport::default();
    let warn = |message: String| {
        let flow = observer.warn(StageId::Fusion, message);
        flow.ok_or(FusionError::Interrupted)
    };

    let (mut views, mut view_reports) = views::prepare(posed, maps, options)?;
    let num_halvings = views.first().map_or(0, |v| v.num_halvings);
    report.maps_reduced_by = 1 << num_halvings;
    if num_halvings > 0 {
        let message = format!(
            "the maps are fused at 1/{} of their resolution, to stay within {} MiB; raise the memory \
             for more detail",
            report.maps_reduced_by, options.memory_mib
        );
        warn(message)?;
    }
    if views.len() < options.min_num_views {
        let message = format!(
            "only {} view has depth: nothing confirms its points",
            views.len()
        );
        warn(message)?;
    }

    let neighbours = pairs::neighbours(&views, NUM_NEIGHBOURS);
    let outcome = reconcile::reconcile(&mut views, &neighbours, options, observer)?;
    report.layering_before = outcome.before;
    report.layering_after = outcome.after;
    report.reconcile_iterations = outcome.num_iterations;
    for (view, rms) in view_reports.iter_mut().zip(outcome.correction_rms) {
        view.correction_rms = rms;
    }
    if outcome.after.smooth_rms > VISIBLE_LAYERING_PX * outcome.after.footprint {
        let message = format!(
            "the views' surfaces lie {:.2} pixel footprints apart on average, more than fusion \
             can mend: look at the poses",
            outcome.after.smooth_rms / outcome.after.footprint
        );
        warn(message)?;
    }

    let colors = ColorSource::new(photos, posed, maps, &views, options)?;
    if colors.num_missing() > 0 {
        let message = format!(
            "{} of {} views have no photo: their share of the colours is missing",
            colors.num_missing(),
            views.len()
        );
        warn(message)?;
    }
    let points = points::gather(
        &views,
        &colors,
        &outcome.after,
        options,
        &mut view_reports,
        observer,
    )?;
    drop(colors);
    if let Some(message) = coarse(&points, posed.scale.unit, options) {
        warn(message)?;
    }
    report.num_points = points.len();
    report.mean_num_views =
        points.iter().map(|p| f64::from(p.num_views)).sum::<f64>() / points.len() as f64;
    report.views = view_reports;

    let mut mesh = Mesh::default();
    let volume = if options.mesh {
        tsdf::integrate(&views, options, observer)?
    } else {
        None
    };
    // What the mesh takes from here on, the views no longer need.
    drop(views);
    if let Some(volume) = volume {
        let (extracted, mesh_report) = surface::extract(&volume, &points, options, observer)?;
        mesh = extracted;
        if mesh_report.coarsened_by > 1.0 {
            let message = format!(
                "the mesh's cells are {:.2} times larger than asked for, to stay within {} MiB; \
                 raise the memory for more detail",
                mesh_report.coarsened_by, options.memory_mib
            );
            warn(message)?;
        }
        report.mesh = Some(mesh_report);
    }
    let fused = FusedCloud {
        cloud: PointCloud { points },
        mesh,
    };
    Ok((fused, report))
}

/// Share of the cloud's extent from which the asked spacing is likely in another unit: some hundred
/// points are left then.
const COARSE_SPACING_SHARE: f64 = 0.1;

/// What to say of a spacing that leaves next to nothing of the surface.
fn coarse(points: &[CloudPoint], unit: Unit, options: &FusionOptions) -> Option<String> {
    let side = |axis: usize| {
        let values = points.iter().map(|p| f64::from(p.position[axis]));
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        (high - low).max(0.0)
    };
    let extent = side(0).hypot(side(1)).hypot(side(2));
    let unit = match unit {
        Unit::Metre => "m",
        Unit::Arbitrary => "units",
    };
    (options.spacing > COARSE_SPACING_SHARE * extent).then(|| {
        format!(
            "a spacing of {} {unit} leaves {} points of a cloud that is {extent:.3} {unit} across: it \
             is stated in {}",
            options.spacing,
            points.len(),
            if unit == "m" {
                "metres"
            } else {
                "the cameras' unit"
            }
        )
    })
}
