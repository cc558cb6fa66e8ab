//! The spheres beside the object, in the views that show enough of them.

use crate::error::LightingError;
use crate::report::{LightingReport, SphereLightReport, ViewLightReport};
use nalgebra::UnitQuaternion;
use rilievo_photometry::samples::{Coverage, Shot, SphereSamples};
use rilievo_photometry::sphere::SphereInCamera;
use rilievo_scene::{
    LocatedSphere, Observer, PhotoSet, PosedView, PosedViews, SphereLight, StageId,
};

/// One sphere in one view.
pub(crate) struct Patch {
    /// The view, as a position in [`Side::views`].
    pub view: usize,
    /// The sphere, as an index into the posed spheres.
    pub sphere: usize,
    /// Its pixels.
    pub samples: SphereSamples,
}

/// All patches.
#[derive(Default)]
pub(crate) struct Side {
    /// Indices of the views that show a sphere.
    pub views: Vec<usize>,
    /// Their rotations.
    pub world_from_cam: Vec<UnitQuaternion<f64>>,
    /// Every sphere in every view that shows enough of it.
    pub patches: Vec<Patch>,
    /// Per sphere and channel, its albedo over that of the reference sphere; `None`
    /// for a sphere that does not count.
    pub paint: Vec<Option<Vec<f64>>>,
}

/// A patch that counts, with its sphere's albedo.
pub(crate) type Counted<'a> = (&'a Patch, &'a [f64]);

impl Side {
    pub fn num_channels(&self) -> usize {
        let mut first = self.patches.iter().flat_map(|p| p.samples.readings.first());
        first.next().map_or(1, |reading| reading.values.len())
    }

    /// Patches of the spheres that count.
    pub fn counted(&self) -> impl Iterator<Item = Counted<'_>> {
        self.patches
            .iter()
            .filter_map(|patch| Some((patch, self.paint[patch.sphere].as_deref()?)))
    }

    /// How every sphere stands to the light.
    pub fn verdicts(&self, posed: &PosedViews) -> Vec<SphereLight> {
        let spheres = posed.spheres.iter().zip(&self.paint);
        spheres
            .map(|(sphere, paint)| SphereLight {
                name: sphere.name.clone(),
                paint: paint.clone(),
            })
            .collect()
    }

    /// Those of one view, by its index among all.
    pub fn counted_in(&self, view: usize) -> Vec<Counted<'_>> {
        self.counted()
            .filter(|(patch, _)| self.views[patch.view] == view)
            .collect()
    }
}

/// Reads the spheres in all views, and begins the report.
pub(crate) fn collect(
    photos: &PhotoSet,
    posed: &PosedViews,
    min_num_pixels: usize,
    observer: &dyn Observer,
    report: &mut LightingReport,
) -> Result<Side, LightingError> {
    let mut side = Side::default();
    report.spheres = posed
        .spheres
        .iter()
        .map(|sphere| SphereLightReport {
            name: sphere.name.clone(),
            ..SphereLightReport::default()
        })
        .collect();
    for (idx, view) in posed.views.iter().enumerate() {
        let flow = observer.progress(
            StageId::Lighting,
            "reading the sphere",
            (idx, posed.views.len()),
        );
        flow.ok_or(LightingError::Interrupted)?;
        let facts = one_view(
            photos,
            posed,
            (idx, view),
            min_num_pixels,
            (&mut side, report),
        )?;
        report.views.push(facts);
    }
    side.paint = vec![Some(vec![1.0; side.num_channels()]); posed.spheres.len()];
    Ok(side)
}

/// Adds the patches of a view that are large enough; the facts say why others are not.
fn one_view(
    photos: &PhotoSet,
    posed: &PosedViews,
    (idx, view): (usize, &PosedView),
    min_num_pixels: usize,
    (side, report): (&mut Side, &mut LightingReport),
) -> Result<ViewLightReport, LightingError> {
    let mut facts = ViewLightReport::named(&view.name);
    let mut reasons = Vec::new();
    let mut coverage = Coverage::default();
    let in_camera = SphereInCamera::all_seen(posed, view);
    let photo = &photos.photos[view.photo.0];
    let mut loaded = None;
    let mut position = None;
    for (k, sphere) in posed.spheres.iter().enumerate() {
        if let Some(reason) = unseen(sphere, &in_camera[k], view) {
            reasons.push(reason);
            continue;
        }
        let image = match &mut loaded {
            Some(image) => image,
            none => none.insert(photo.linear()?),
        };
        let shot = Shot::new(photo, image, view);
        let samples = shot.samples(&in_camera[k], &in_camera);
        let num_pixels = samples.num_usable();
        facts.num_pixels += num_pixels;
        facts.radius_px = Some(facts.radius_px.unwrap_or(0.0).max(samples.radius_px));
        coverage.add(samples.coverage);
        if num_pixels < min_num_pixels {
            reasons.push(format!(
                "{num_pixels} usable pixels of {} ({:.0} % hidden, {:.0} % clipped)",
                sphere.name,
                100.0 * samples.coverage.hidden_share(),
                100.0 * samples.coverage.clipped_share()
            ));
            continue;
        }
        report.spheres[k].num_pixels += num_pixels;
        report.spheres[k].views.push(view.name.clone());
        let position = *position.get_or_insert_with(|| {
            side.views.push(idx);
            side.world_from_cam
                .push(view.cam_from_world.rotation.inverse());
            side.views.len() - 1
        });
        side.patches.push(Patch {
            view: position,
            sphere: k,
            samples,
        });
    }
    facts.clipped_share = coverage.clipped_share();
    facts.hidden_share = coverage.hidden_share();
    if position.is_some() {
        facts.unused_spheres = reasons;
    } else if !reasons.is_empty() {
        facts.left_out = Some(reasons.join("; "));
    }
    Ok(facts)
}

/// Why a view says nothing of a sphere.
fn unseen(sphere: &LocatedSphere, in_camera: &SphereInCamera, view: &PosedView) -> Option<String> {
    if in_camera.cone().is_none() {
        return Some(format!("{} lies behind the camera", sphere.name));
    }
    // Where the outline was looked for and not found, something hides the sphere.
    let hidden =
        !sphere.seen_in.is_empty() && sphere.seen_in.iter().all(|(photo, _)| *photo != view.photo);
    hidden.then(|| format!("the outline of {} is not seen in it", sphere.name))
}
