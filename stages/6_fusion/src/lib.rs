//! Stage 6: depth and normal maps of all views to one oriented point cloud and a mesh.
//!
//! In: posed views, their depth and normal maps, the photos (for colour). Out: the points of a
//! cloud, part by part, a [`Mesh`] and a [`FusionReport`].
//!
//! 1. `views`: maps are loaded one by one, checked, cut to the object and stored in pages
//!    (`pixel`); borders, depth edges and grazing surface are left out. All later steps read the
//!    pages that they need (`view`), of the views that may see the place (`reach`).
//! 2. `layering`: how far the views lie apart where they see one surface (`sight`).
//! 3. `points`, `judge`, `color`, `thin`: every piece of surface once, from the view that resolves
//!    it best, at the mean of the views that agree.
//! 4. `tsdf`, `surface`, `dress`: signed distances of all views, their zero set as a mesh;
//!    `manifold`, `rim`, `pieces`, `holes`: what is made of its edges and loose ends.
//! 5. [`asset`](rilievo_scene::Asset): a light mesh with textures, baked from the views.
//!
//! In memory are one view while it is loaded, then the pages that the threads work on (`memory`),
//! and in the end the mesh. The cloud is the same for any memory that suffices; mesh and asset are
//! coarser, and say so, where they would not fit.
//!
//! Lengths are measured in pixel footprints `z / f` throughout: the same options serve a coin and
//! a statue.

mod asset;
mod best;
mod color;
mod dress;
mod error;
mod findings;
mod holes;
mod judge;
mod layering;
mod manifold;
mod memory;
mod options;
mod pieces;
mod pixel;
mod points;
mod reach;
mod report;
mod rim;
mod sight;
mod simplify;
mod surface;
mod thin;
mod tsdf;
mod view;
mod views;

pub use error::FusionError;
pub use options::{ColorMode, FusionOptions, MeshFormat, RETIRED_KEYS};
pub use report::{AssetReport, FusionReport, Layering, MeshReport, ViewFusion};

use error::warn;
use points::CloudFacts;
use rilievo_scene::{
    Asset, CloudSink, MapSource, Mesh, Observer, PageCaches, PhotoSet, PosedViews, Scratch,
    StageId, Unit,
};
use views::LoadedViews;

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 13;

/// Smooth distance between views, in footprints, from which the layers show.
const VISIBLE_LAYERING_PX: f64 = 1.0;

/// Excess over the triangles asked for from which a warning says so.
const MISSED_TRIANGLES: f64 = 1.2;

/// What is fused.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// Photos for the colours; where some or all are missing, their views' points are grey.
    pub photos: &'a PhotoSet,
    /// Cameras and poses.
    pub posed: &'a PosedViews,
    /// Maps, loaded one view at a time; [`rilievo_scene::ShadedViews`] are such maps.
    pub maps: &'a dyn MapSource,
    /// Room for the maps and for what is made of them; [`rilievo_scene::MemoryScratch`] for small
    /// sets.
    pub scratch: &'a dyn Scratch,
}

/// The surface of all views.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fused {
    /// Empty where none was asked for.
    pub mesh: Mesh,
    /// Where one was asked for, and in the first process alone.
    pub asset: Option<Asset>,
    /// How it came out.
    pub report: FusionReport,
}

/// Pixels of the smallest relief from which the cloud is thinned to it: finer relief saves few points.
const MIN_RESOLVED_PX: f64 = 2.0;

/// Fuses the views: hands the cloud's points to `cloud`, and returns mesh and asset. After an error
/// the cloud is not complete.
///
/// # Errors
/// See [`FusionError`].
pub fn run(
    inputs: Inputs<'_>,
    cloud: &mut dyn CloudSink,
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<Fused, FusionError> {
    let Inputs {
        photos,
        posed,
        maps,
        scratch,
    } = inputs;
    options.validate()?;
    let options = &FusionOptions {
        voxel_px: match options.full {
            true => options.voxel_px,
            false => options.voxel_px.max(maps.resolved_px()),
        },
        ..options.clone()
    };
    photos.check()?;
    posed.check()?;
    memory::refuse_too_little(posed, options)?;
    let next = |idx: usize| {
        let done = (idx, maps.num_views());
        let flow = observer.progress(StageId::Fusion, "loading maps", done);
        flow.ok_or(FusionError::Interrupted)
    };
    let (loaded, mut views) = views::prepare(photos, posed, maps, scratch, options, next)?;
    let asked_spacing = options.spacing;
    let is_coarser = !options.full && maps.resolved_px() >= MIN_RESOLVED_PX;
    let options = &FusionOptions {
        spacing: match options.spacing {
            0.0 if is_coarser => maps.resolved_px() * loaded.median_footprint,
            asked => asked,
        },
        ..options.clone()
    };
    let caches = PageCaches::new(&loaded.store, memory::num_pages(options));
    let layering = layering::measure(&loaded, &caches)?;
    drop(caches);
    warn_of_views(&loaded, &layering, options, observer)?;
    let facts = points::gather(
        &loaded,
        &layering,
        options,
        &mut views,
        (scratch, cloud),
        observer,
    )?;
    if let Some(message) = coarse(&facts, posed.scale.unit, asked_spacing) {
        warn(observer, message)?;
    }
    let (mesh, mesh_report) = if options.mesh {
        shape(&loaded, scratch, options, observer)?.unzip()
    } else {
        (None, None)
    };
    let mesh = mesh.unwrap_or_default();
    let (asset, asset_report) = match &mesh_report {
        Some(of_mesh)
            if options.makes_asset() && of_mesh.num_triangles > 0 && observer.team().is_first() =>
        {
            let made = asset::make((&mesh, of_mesh), &loaded, options, observer)?;
            if made.is_none() {
                let message = "no asset: the mesh cannot be laid out on its textures; try a larger --texture or fewer --faces";
                warn(observer, message.to_owned())?;
            }
            made.unzip()
        }
        _ => (None, None),
    };
    let report = FusionReport {
        num_points: facts.num_points,
        spacing: options.spacing,
        mean_num_views: facts.num_views as f64 / facts.num_points as f64,
        num_covered: facts.num_covered,
        share_apart: (facts.num_covered > 0)
            .then(|| facts.num_apart as f64 / facts.num_covered as f64),
        layering,
        views,
        mesh: mesh_report,
        asset: asset_report,
    };
    Ok(Fused {
        mesh,
        asset,
        report,
    })
}

/// Warns of views that are too few, that lie apart, or that have no photo.
fn warn_of_views(
    loaded: &LoadedViews,
    layering: &Layering,
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<(), FusionError> {
    let num_views = loaded.views.len();
    if num_views < options.min_num_views {
        let message = format!("only {num_views} view has depth: nothing confirms its points");
        warn(observer, message)?;
    }
    if layering.smooth_rms > VISIBLE_LAYERING_PX * layering.footprint {
        let message = format!(
            "the views' surfaces lie {:.2} pixel footprints apart on average, more than fusion \
             can mend: look at the poses",
            layering.smooth_rms / layering.footprint
        );
        warn(observer, message)?;
    }
    let num_missing = loaded.views.iter().filter(|v| !v.has_photo).count();
    if num_missing > 0 {
        let message = format!(
            "{num_missing} of {num_views} views have no photo: their share of the colours is missing"
        );
        warn(observer, message)?;
    }
    Ok(())
}

/// The mesh, unless no surface is near any cell.
fn shape(
    loaded: &LoadedViews,
    scratch: &dyn Scratch,
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<Option<(Mesh, MeshReport)>, FusionError> {
    let caches = PageCaches::new(&loaded.store, memory::num_pages(options));
    let Some(volume) = tsdf::integrate(loaded, &caches, scratch, options, observer)? else {
        return Ok(None);
    };
    let (mesh, report) = surface::extract(volume, loaded, caches, scratch, options, observer)?;
    if report.coarsened_by > 1.0 {
        let message = format!(
            "the mesh's cells are {:.2} times larger than asked for, to stay within {} MiB; \
             raise the memory for more detail",
            report.coarsened_by, options.memory_mib
        );
        warn(observer, message)?;
    }
    let asked = options.max_num_triangles;
    if asked > 0 && report.num_triangles as f64 > MISSED_TRIANGLES * asked as f64 {
        let message = format!(
            "the mesh has {} triangles where about {asked} were asked for: its pieces and holes need them",
            report.num_triangles
        );
        warn(observer, message)?;
    }
    if options.watertight && report.num_open_loops > 0 {
        let message = format!(
            "the mesh is not watertight: {} loops stay open; try another number of triangles",
            report.num_open_loops
        );
        warn(observer, message)?;
    }
    Ok(Some((mesh, report)))
}

/// Share of the cloud's extent from which the asked spacing is likely in another unit: some hundred
/// points are left then.
const COARSE_SPACING_SHARE: f64 = 0.1;

/// The warning of a spacing that leaves next to nothing of the surface.
fn coarse(facts: &CloudFacts, unit: Unit, spacing: f64) -> Option<String> {
    let sides = [0, 1, 2].map(|k| (f64::from(facts.high[k]) - f64::from(facts.low[k])).max(0.0));
    let extent = sides[0].hypot(sides[1]).hypot(sides[2]);
    let words = unit.words();
    (spacing > COARSE_SPACING_SHARE * extent).then(|| {
        format!(
            "a spacing of {spacing} {words} leaves {} points of a cloud that is {extent:.3} {words} across: it \
             is stated in {}",
            facts.num_points,
            if unit == Unit::Metre {
                "metres"
            } else {
                "the cameras' unit"
            }
        )
    })
}
