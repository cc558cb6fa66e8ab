//! Stage 6: depth and normal maps of all views to one oriented point cloud and a mesh.
//!
//! In: posed views, their depth and normal maps, the photos (for colour). Out: the points of a cloud, part by
//! part, a [`Mesh`] and a [`FusionReport`].
//!
//! 1. `views`, `shelf`: maps are loaded one by one, checked, cut to the object and put aside in pages; borders,
//!    depth edges and grazing surface are left out. All later steps read the pages that they need (`view`,
//!    `reader`), of the views that may see the place (`reach`).
//! 2. `pairs`, `reconcile`, `correction`, `settle`: how far the views lie apart, and a joint robust adjustment of the
//!    smooth part of it.
//! 3. `points`, `judge`, `color`, `thin`: every piece of surface once, from the view that resolves it best, at
//!    the mean of the views that agree.
//! 4. `tsdf`, `surface`, `dress`: signed distances of all views, their zero set as a mesh; `manifold`, `rim`, `pieces`,
//!    `holes`: what is made of its edges and loose ends.
//! 5. [`asset`](rilievo_scene::Asset): a light mesh with textures, baked from the views.
//!
//! In memory are one view while it is loaded, then the pages that the threads work on (`memory`), and in the
//! end the mesh. The cloud is the same for any memory that suffices; mesh and asset are coarser, and say so, where they would
//! not fit.
//!
//! Lengths are measured in pixel footprints `z / f` throughout: the same options serve a coin and
//! a statue.

mod asset;
mod best;
mod color;
mod correction;
mod dress;
mod error;
mod findings;
mod holes;
mod judge;
mod manifold;
mod memory;
mod options;
mod pairs;
mod pieces;
mod points;
mod reach;
mod reader;
mod reconcile;
mod report;
mod rim;
mod settle;
mod shelf;
mod simplify;
mod surface;
mod thin;
mod tsdf;
mod view;
mod views;

pub use error::FusionError;
pub use options::{ColorMode, FusionOptions, MeshFormat, RETIRED_KEYS};
pub use report::{AssetReport, FusionReport, Layering, MeshReport, ViewFusion};

use points::CloudFacts;
use reader::Readers;
use rilievo_scene::{
    Asset, CloudSink, MapSource, Mesh, Observer, PhotoSet, PosedViews, Scratch, StageId, Unit,
};
use views::Stock;

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 9;

/// Views that each view is compared with for offsets: more only repeat what these say.
const NUM_NEIGHBOURS: usize = 4;
/// Smooth distance between views, in footprints, from which the layers show.
const VISIBLE_LAYERING_PX: f64 = 1.0;

/// How many times as many triangles as asked for are told.
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
    /// Room for the maps and for what is made of them; [`rilievo_scene::MemoryScratch`] for small sets.
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

/// Fuses the views: hands the cloud's points to `cloud`, and returns mesh and asset. After an error the cloud is not
/// complete.
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
    photos.check()?;
    posed.check()?;
    memory::refuse_too_little(posed, options)?;
    let mut report = FusionReport::default();
    let warn = |message: String| {
        let flow = observer.warn(StageId::Fusion, message);
        flow.ok_or(FusionError::Interrupted)
    };

    let next = |idx: usize| {
        let told = (idx, maps.num_views());
        let flow = observer.progress(StageId::Fusion, "loading maps", told);
        flow.ok_or(FusionError::Interrupted)
    };
    let (mut stock, mut view_reports) =
        views::prepare(photos, posed, maps, scratch, options, next)?;
    let num_views = stock.views.len();
    if num_views < options.min_num_views {
        let message = format!("only {num_views} view has depth: nothing confirms its points");
        warn(message)?;
    }

    let neighbours = pairs::neighbours(&stock.views, NUM_NEIGHBOURS);
    let outcome = reconcile::reconcile(&stock, &neighbours, options, observer)?;
    let settled = settle::settle(&mut stock, outcome.corrections.as_ref())?;
    report.layering_before = outcome.before;
    report.layering_after = outcome.after;
    report.reconcile_iterations = outcome.num_iterations;
    for (view, rms) in view_reports.iter_mut().zip(settled.correction_rms) {
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

    let num_missing = stock.views.iter().filter(|v| !v.has_photo).count();
    if num_missing > 0 {
        let message = format!(
            "{num_missing} of {num_views} views have no photo: their share of the colours is missing"
        );
        warn(message)?;
    }
    let facts = points::gather(
        &stock,
        &outcome.after,
        options,
        &mut view_reports,
        (scratch, cloud),
        observer,
    )?;
    if let Some(message) = coarse(&facts, posed.scale.unit, options) {
        warn(message)?;
    }
    report.num_points = facts.num_points;
    report.mean_num_views = facts.num_views as f64 / facts.num_points as f64;
    report.num_covered = facts.num_covered;
    report.share_apart =
        (facts.num_covered > 0).then(|| facts.num_apart as f64 / facts.num_covered as f64);
    report.views = view_reports;

    let mut mesh = Mesh::default();
    if options.mesh {
        let footprint = settled.median_footprint;
        if let Some((made, mesh_report)) = shape(&stock, footprint, scratch, options, observer)? {
            mesh = made;
            if mesh_report.coarsened_by > 1.0 {
                let message = format!(
                    "the mesh's cells are {:.2} times larger than asked for, to stay within {} MiB; \
                     raise the memory for more detail",
                    mesh_report.coarsened_by, options.memory_mib
                );
                warn(message)?;
            }
            let asked = options.max_num_triangles;
            if asked > 0 && mesh_report.num_triangles as f64 > MISSED_TRIANGLES * asked as f64 {
                let message = format!(
                    "the mesh has {} triangles where about {asked} were asked for: its pieces and holes need them",
                    mesh_report.num_triangles
                );
                warn(message)?;
            }
            report.mesh = Some(mesh_report);
        }
    }
    let mut asset = None;
    if let Some(mesh_report) = (report.mesh.as_ref()).filter(|mesh| {
        options.makes_asset() && mesh.num_triangles > 0 && observer.team().is_first()
    }) {
        let footprint = settled.median_footprint;
        match asset::make((&mesh, mesh_report), &stock, footprint, options, observer)? {
            Some((made, asset_report)) => {
                asset = Some(made);
                report.asset = Some(asset_report);
            }
            None => {
                let message = "no asset: the mesh cannot be laid out on its textures; try a larger --texture or fewer --faces";
                warn(message.to_owned())?;
            }
        }
    }
    Ok(Fused {
        mesh,
        asset,
        report,
    })
}

/// The mesh, unless no surface is near any cell.
fn shape(
    stock: &Stock,
    footprint: f64,
    scratch: &dyn Scratch,
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<Option<(Mesh, MeshReport)>, FusionError> {
    let readers = Readers::new(&stock.shelf, memory::num_pages(options));
    let volume = tsdf::integrate(stock, &readers, footprint, scratch, options, observer)?;
    volume
        .map(|volume| surface::extract(volume, stock, readers, scratch, options, observer))
        .transpose()
}

/// Share of the cloud's extent from which the asked spacing is likely in another unit: some hundred
/// points are left then.
const COARSE_SPACING_SHARE: f64 = 0.1;

/// What to say of a spacing that leaves next to nothing of the surface.
fn coarse(facts: &CloudFacts, unit: Unit, options: &FusionOptions) -> Option<String> {
    let sides = [0, 1, 2].map(|k| (f64::from(facts.high[k]) - f64::from(facts.low[k])).max(0.0));
    let extent = sides[0].hypot(sides[1]).hypot(sides[2]);
    let unit = match unit {
        Unit::Metre => "m",
        Unit::Arbitrary => "units",
    };
    (options.spacing > COARSE_SPACING_SHARE * extent).then(|| {
        format!(
            "a spacing of {} {unit} leaves {} points of a cloud that is {extent:.3} {unit} across: it \
             is stated in {}",
            options.spacing,
            facts.num_points,
            if unit == "m" {
                "metres"
            } else {
                "the cameras' unit"
            }
        )
    })
}
