//! Stage 3: `cameras.json`, `sparse/*.txt` (COLMAP), `anchors.ply` and `anchors.json`,
//! `posed_views.json` (everything).

use super::artifacts::{checked_names, read_json, write_json};
use super::context::Context;
use super::errors::from_poses;
use super::request::SphereInput;
use crate::exit::Failure;
use crate::store::{RunDir, StageWriter};
use nalgebra::Vector3;
use rilievo_io::{CameraFile, SpheresInSet, decode_photo, write_cameras, write_colmap_text};
use rilievo_poses::ReferenceFrame;
use rilievo_scene::{
    LinearImage, Observer, PhotoSet, PosedViews, ScaleSource, SphereRequest, StageId,
    first_and_more,
};

const POSED_VIEWS: &str = "posed_views.json";

/// Finds poses, points, scale and anchors.
///
/// # Errors
/// When the photos do not determine them, or the user asked to stop.
pub fn run(context: &Context<'_>, writer: &StageWriter) -> anyhow::Result<serde_json::Value> {
    let photos = super::photos::load(context)?;
    let matches = super::features::load(context, &photos.photos)?;
    let spheres = sphere_request(context, &photos)?.map(|spheres| {
        if let Some(text) = of_marks(&spheres) {
            context.console.warn(StageId::Poses, text);
        }
        (spheres.request, spheres.absent)
    });
    let (sphere, unused) = spheres.unzip();
    let unused = unused.unwrap_or_default();
    for warning in &context.inputs.spheres.warnings {
        context.console.warn(StageId::Poses, warning);
    }
    if !unused.is_empty() {
        context.console.warn(
            StageId::Poses,
            format!(
                "the sphere is marked in photos that are not used: {}",
                first_and_more(unused.iter().map(String::as_str)).unwrap_or_default()
            ),
        );
    }
    let mut options = context.request.options.poses.clone();
    options.memory = Some(context.resources.memory);
    options.given_world = context.inputs.given_world;
    let asked_for = context.inputs.frame_of.clone();
    options.reference = asked_for.or_else(|| earlier_frame(context.run));
    let (mut views, report) = rilievo_poses::run(
        &photos,
        &matches,
        sphere.as_ref(),
        &options,
        context.console,
    )
    .map_err(from_poses)?;
    let unit = context.inputs.given_unit;
    let is_of_given = views.scale.source == ScaleSource::GivenPoses
        && unit != views.scale.unit
        && unit.metres().is_some();
    views.given_unit = is_of_given.then_some(unit);
    if let Some(why) = &mut views.no_sphere
        && !unused.is_empty()
    {
        *why += &format!(
            " (the sphere file names photos that are not used: {})",
            first_and_more(unused.iter().map(String::as_str)).unwrap_or_default()
        );
    }
    context.console.note(&format!(
        "  {} of {} photos posed, {} points, reprojection error {:.2} px, {} anchors",
        views.views.len(),
        photos.photos.len(),
        views.points.len(),
        report.mean_reprojection_error_px,
        views.anchors.len(),
    ));

    if !context.console.team().is_first() {
        return Ok(serde_json::Value::Null);
    }
    write_cameras(
        &writer.path("cameras.json")?,
        &CameraFile::from_posed_views(&views),
    )
    .map_err(Failure::from)?;
    let sparse = writer.path("sparse/cameras.txt")?;
    write_colmap_text(sparse.parent().unwrap_or(writer.dir()), &views).map_err(Failure::from)?;
    super::anchors::write(writer, &views)?;
    write_json(writer, POSED_VIEWS, &views)?;
    Ok(serde_json::to_value(report)?)
}

/// Poses of a committed stage 3.
pub fn load(run: &RunDir) -> anyhow::Result<PosedViews> {
    let views: PosedViews = read_json(run, StageId::Poses, POSED_VIEWS)?;
    let names = views.views.iter();
    let names = names.flat_map(|view| [view.name.as_str(), view.file_name.as_str()]);
    checked_names(run, StageId::Poses, POSED_VIEWS, names)?;
    Ok(views)
}

/// The frame of the poses that the run has already; `None` where there are none that can be read.
fn earlier_frame(run: &RunDir) -> Option<ReferenceFrame> {
    let manifest = run.manifest(StageId::Poses).ok()??;
    let views = load(run).ok()?;
    let posed = views.views.iter();
    let posed = posed.map(|view| (view.file_name.clone(), view.cam_from_world));
    Some(ReferenceFrame {
        cameras: posed.collect(),
        world: views.coordinates(),
        knows_object: manifest.report["knows_object"].as_bool().unwrap_or(true),
        is_asked: false,
    })
}

/// What the user said of the reference spheres, for a set of photos.
///
/// # Errors
/// When the sphere file does not fit the photos, or a calibration photo cannot be read.
pub fn sphere_request(
    context: &Context<'_>,
    photos: &PhotoSet,
) -> Result<Option<SpheresInSet>, Failure> {
    if let SphereInput::Auto { radius } = context.request.sphere {
        let request = SphereRequest {
            search_radius: Some(radius),
            light: None,
            ..SphereRequest::default()
        };
        return Ok(Some(SpheresInSet {
            request,
            ..SpheresInSet::default()
        }));
    }
    let Some(file) = &context.inputs.spheres.file else {
        return Ok(None);
    };
    let images = file
        .calibration
        .iter()
        .map(|calibration| calibration_image(context, &calibration.image))
        .collect::<Result<Vec<_>, _>>()?;
    let mut spheres = file.to_request(photos, images)?;
    // Centres are stated in the frame and unit of the given cameras.
    let offset = Vector3::from(context.inputs.given_world.offset);
    let metres = context.inputs.given_unit.metres().unwrap_or(1.0);
    for center in (spheres.request.spheres.iter_mut()).filter_map(|s| s.center_in_world.as_mut()) {
        *center = *center * metres - offset;
    }
    Ok(Some(spheres))
}

/// What to warn of about the frame of marks.
fn of_marks(spheres: &SpheresInSet) -> Option<String> {
    if let Some(names) = first_and_more(spheres.upright.iter().map(String::as_str)) {
        return Some(format!(
            "{names}: the sphere is marked in the photo as EXIF turns it; the mark was turned back to the pixels as \
             stored"
        ));
    }
    let text = "EXIF turns some photos, and the sphere's marks fit them turned or not: they were taken in pixels as \
                stored";
    spheres.may_be_upright.then(|| text.to_owned())
}

fn calibration_image(
    context: &Context<'_>,
    path: &std::path::Path,
) -> Result<LinearImage, Failure> {
    let decoded = decode_photo(path)?;
    let encoding = context.request.options.photos.encoding;
    Ok(rilievo_photos::linearize(&decoded, encoding).0)
}
