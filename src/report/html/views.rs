//! Every view as pictures: photo against re-rendered result, difference, normals, depth,
//! confidence; and the whole photo with sparse points and the outlines of the spheres.

use super::element::{figure, folded, number, percent, text};
use super::picture::{self, Album, Window};
use crate::pipeline::shown_albedo;
use crate::report::facts::{Facts, Stage, Stages};
use crate::store::{RunDir, own_file};
use maud::{Markup, html};
use nalgebra::{Point3, Vector3};
use rilievo_io::{read_channel, read_depth, read_linear, read_normal};
use rilievo_scene::{LinearImage, LocatedSphere, PosedView, PosedViews, Raster, StageId, Unit};
use std::path::Path;

/// Relative difference of photo and result that is shown as full brightness.
const DIFFERENCE_MAX: f32 = 0.25;

/// Views beyond this many have no pictures in the page: they would be too small to show anything.
const MAX_NUM_VIEWS: usize = 40;
/// Bytes of the page that all pictures of all views may take.
const PICTURE_BYTES: usize = 2_600_000;
/// Pictures of a view that has all.
const NUM_PICTURES: usize = 9;
/// Anchors and sparse points drawn in all photos together: a dot takes some fifteen bytes.
const NUM_DOTS: usize = 30_000;

/// The section with the views that have a dense shape, or at least a pose; of many some, evenly
/// chosen.
///
/// # Errors
/// When maps cannot be read.
pub fn section(run: &RunDir, facts: &Facts, posed: &PosedViews) -> anyhow::Result<Markup> {
    let num_views = posed.views.len();
    let every = num_views.div_ceil(MAX_NUM_VIEWS).max(1);
    let num_shown = num_views.div_ceil(every);
    let album = Album::new(PICTURE_BYTES, num_shown * NUM_PICTURES);
    let mut views = Vec::new();
    for (index, view) in posed.views.iter().enumerate().step_by(every) {
        let file = format!("linear/{}.exr", view.name);
        let mut photo = read_linear(&run.stage_dir(StageId::Photos).join(file))?;
        // The results explain the photo at the set's exposure.
        let gain = exposure_gain(&facts.stages, &view.file_name) as f32;
        photo.data.iter_mut().for_each(|value| *value *= gain);
        let page = Page {
            run,
            album,
            max_dots: NUM_DOTS / (2 * num_shown),
        };
        let content = page.one(&facts.stages, posed, index, &photo)?;
        views.push(folded(&view.file_name, index == 0, &content));
    }
    Ok(html! {
        section {
            h2 { "Views" }
            @if every > 1 {
                p {
                    "Every " (every) ". of " (num_views) " views is shown. The pictures of all lie in "
                    code { "5_shading/" } ", a folder a kind."
                }
            }
            @for view in views { (view) }
        }
    })
}

/// Factor that brought a photo to the set's exposure.
fn exposure_gain(stages: &Stages, file_name: &str) -> f64 {
    let Some(photos) = stages.photos.as_ref().map(|stage| &stage.report) else {
        return 1.0;
    };
    let index = photos.photos.iter().position(|p| p.file_name == file_name);
    let gain = index.and_then(|index| photos.exposure_gains.get(index));
    gain.copied().unwrap_or(1.0)
}

/// What pictures are made with.
struct Page<'a> {
    run: &'a RunDir,
    album: Album,
    max_dots: usize,
}

impl Page<'_> {
    fn one(
        &self,
        stages: &Stages,
        posed: &PosedViews,
        index: usize,
        photo: &LinearImage,
    ) -> anyhow::Result<Markup> {
        let view = &posed.views[index];
        let maps = self.run.stage_dir(StageId::Shading);
        let dense = if maps.join(format!("depth/{}.exr", view.name)).exists() {
            self.dense(&maps, view, posed.scale.unit, photo)?
        } else {
            Markup::default()
        };
        let overlay = self.overlay(posed, index, photo);
        let sphere = self.sphere(&view.name);
        Ok(html! { (numbers(stages, view)) (dense) (overlay) (sphere) })
    }

    /// Photo, result and maps of the object.
    fn dense(
        &self,
        maps: &Path,
        view: &PosedView,
        unit: Unit,
        photo: &LinearImage,
    ) -> anyhow::Result<Markup> {
        let file = |kind: &str| maps.join(kind).join(format!("{}.exr", view.name));
        let depth = read_depth(&file("depth"))?;
        let window = Window::around(&depth);
        let exposure = picture::exposure(photo, &depth);
        let (album, name) = (&self.album, &view.name);
        let observed = album.photo(photo, window, exposure);
        let show = |picture: &str, kind: &str, what: &str, legend: &str, scale: Markup| {
            let caption = html! { (what) ": " (legend) (scale) };
            let whole = format!("{}/{kind}/{name}.png", StageId::Shading);
            let link = maps.join(kind).join(format!("{name}.png")).exists();
            let figure = figure(picture, &format!("{what} of {name}"), &caption);
            html! { @if link { a.whole href=(whole) { (figure) } } @else { (figure) } }
        };
        let mut pictures = Vec::new();
        let mut comparison = Markup::default();
        let nothing = Markup::default;
        if file("rendered").exists() {
            let rendered = read_linear(&file("rendered"))?;
            comparison = compared(name, &observed, &album.photo(&rendered, window, exposure));
            let difference = relative_difference(photo, &rendered, &depth);
            let most = format!("{:.0} % and more", 100.0 * DIFFERENCE_MAX);
            let picture = album.scalar(&difference, window, DIFFERENCE_MAX);
            let legend = "where photo and result disagree";
            let scale = bar("inferno", "0", &most);
            pictures.push(show(
                &picture,
                "rendered",
                "Relative difference",
                legend,
                scale,
            ));
        } else {
            pictures.push(show(&observed, "", "Photo", "cut to the object", nothing()));
        }
        let picture = album.normals(&read_normal(&file("normal"))?, window);
        let legend = "red: to the right, green: up, blue: to the camera";
        pictures.push(show(&picture, "normal", "Normals", legend, nothing()));
        let picture = album.depth(&depth, window);
        let (legend, scale) = ("along the optical axis", depth_legend(&depth, unit));
        pictures.push(show(&picture, "depth", "Depth", legend, scale));
        if file("albedo").exists() {
            let albedo = shown_albedo(&read_linear(&file("albedo"))?);
            let picture = album.photo(&albedo, window, 1.0);
            let legend = "relative to the mean, which is a middle grey";
            pictures.push(show(&picture, "albedo", "Albedo", legend, nothing()));
        }
        if file("confidence").exists() {
            let confidence = read_channel(&file("confidence"), "C")?;
            let picture = album.scalar(&confidence, window, 1.0);
            let legend = "how well the photos determine a pixel";
            let scale = bar("inferno", "0", "1: well");
            pictures.push(show(&picture, "confidence", "Confidence", legend, scale));
        }
        Ok(html! { (comparison) div.pictures { @for picture in pictures { (picture) } } })
    }

    /// The whole photo with sparse points and the spheres' outlines.
    fn overlay(&self, posed: &PosedViews, index: usize, photo: &LinearImage) -> Markup {
        let view = &posed.views[index];
        // Drawn in a frame of a thousand units, where a tenth is exact enough.
        let unit = photo.width.max(photo.height) as f64 / 1000.0;
        let at = |value: f64| format!("{:.1}", value / unit);
        let sightings = posed.points.iter().flat_map(|point| &point.track);
        let points = sightings.filter(|s| s.view.0 == index).map(|s| s.pixel);
        let seen = posed.anchors.iter().flat_map(|anchor| &anchor.observations);
        let anchors = seen.filter(|o| o.view.0 == index).map(|o| o.pixel);
        let (num_points, points) = self.dots(points.collect(), &at);
        let (num_anchors, anchors) = self.dots(anchors.collect(), &at);
        let outlines: Vec<String> = posed
            .spheres
            .iter()
            .filter_map(|sphere| outline(sphere, view))
            .map(|outline| {
                let corners = outline
                    .iter()
                    .map(|[x, y]| format!("{},{}", at(*x), at(*y)));
                corners.collect::<Vec<_>>().join(" ")
            })
            .collect();
        let of_spheres = match outlines.len() {
            0 => String::new(),
            1 => "; outline of the reference sphere where it should be".to_owned(),
            n => format!("; outlines of {n} reference spheres where they should be"),
        };
        let (width, height) = (at(photo.width as f64), at(photo.height as f64));
        let whole = Window::whole(photo.width, photo.height);
        let picture = self.album.photo(photo, whole, 1.0);
        html! {
            figure.overlay {
                svg viewBox=(format!("0 0 {width} {height}")) role="img"
                    aria-label=(format!("Photo {}", view.name)) {
                    image href=(picture) width=(width) height=(height) {}
                    path.anchors d=(anchors) {}
                    path.points d=(points) {}
                    @for outline in &outlines { polygon points=(outline) {} }
                }
                figcaption {
                    (num_anchors) " depth anchors (green), " (num_points) " sparse points (yellow)"
                    (of_spheres)
                }
            }
        }
    }

    /// The sphere as stage 4 saw it, where there is a picture of that.
    fn sphere(&self, name: &str) -> Markup {
        let file = format!("overlay/{name}.png");
        let path = self.run.stage_dir(StageId::Lighting).join(&file);
        let bytes = own_file(&path).ok().flatten();
        let Some(picture) = bytes.and_then(|bytes| self.album.file(&bytes)) else {
            return Markup::default();
        };
        html! {
            figure {
                a href=(format!("{}/{file}", StageId::Lighting)) {
                    img loading="lazy" src=(picture) alt=(format!("Sphere in {name}"));
                }
                figcaption {
                    "Reference sphere: fitted outline; re-rendered under the light; pixels left out \
                     (magenta: clipped, blue: more than 10 % off the light, grey: margin or hidden)"
                }
            }
        }
    }

    /// The number of places, and a path of dots at so many of them as the page bears: a tenth of
    /// the size of circles.
    fn dots(&self, places: Vec<[f64; 2]>, at: &impl Fn(f64) -> String) -> (usize, String) {
        let every = places.len().div_ceil(self.max_dots.max(1)).max(1);
        let drawn = places.iter().step_by(every);
        let dots = drawn.map(|[x, y]| format!("M{} {}h0", at(*x), at(*y)));
        (places.len(), dots.collect())
    }
}

/// Photo and re-rendered result over each other, with a slider between them.
fn compared(name: &str, observed: &str, rendered: &str) -> Markup {
    html! {
        figure.compare {
            div.pair {
                img src=(observed) alt=(format!("Photo {name}, cut to the object"));
                img.over src=(rendered) alt="The same, re-rendered from the result";
            }
            label {
                "photo "
                input type="range" min="0" max="100" value="50"
                    aria-label="Share of the picture that shows the re-rendered result";
                " re-rendered"
            }
            figcaption { "The photo, and the image that the result explains" }
        }
    }
}

fn depth_legend(depth: &Raster<f32>, unit: Unit) -> Markup {
    let known = depth.data.iter().filter(|&&z| z > 0.0);
    let (low, high) = known.fold((f32::INFINITY, 0.0_f32), |(low, high), &z| {
        (low.min(z), high.max(z))
    });
    let unit = unit.words();
    bar(
        "viridis",
        &format!("far: {high:.4} {unit}"),
        &format!("near: {low:.4} {unit}"),
    )
}

/// A colour scale with the values at its ends.
pub fn bar(colors: &str, low: &str, high: &str) -> Markup {
    html! {
        span.scale {
            span { (low) }
            span class=(format!("bar {colors}")) {}
            span { (high) }
        }
    }
}

/// `|rendered − photo| / photo`, over the mean of the channels; −1 outside the object.
fn relative_difference(
    photo: &LinearImage,
    rendered: &LinearImage,
    depth: &Raster<f32>,
) -> Raster<f32> {
    let (photo, rendered) = (photo.to_grey(), rendered.to_grey());
    Raster::from_fn(depth.width, depth.height, |x, y| {
        let same = photo.same_size(depth) && rendered.same_size(depth);
        if !same || *depth.at(x, y) <= 0.0 {
            return -1.0;
        }
        let observed = *photo.at(x, y);
        (rendered.at(x, y) - observed).abs() / observed.max(1e-3)
    })
}

/// The entry of a view among those of a stage.
fn of_view<R, T>(
    stage: Option<&Stage<R>>,
    entries: fn(&R) -> &[T],
    is_it: impl Fn(&T) -> bool,
) -> Option<&T> {
    entries(&stage?.report).iter().find(|entry| is_it(entry))
}

/// What the stages found of a view.
fn numbers(stages: &Stages, view: &PosedView) -> Markup {
    let (name, file_name) = (&view.name, &view.file_name);
    let photo = of_view(
        stages.photos.as_ref(),
        |r| &r.photos,
        |p| p.file_name == *file_name,
    );
    let features = of_view(
        stages.features.as_ref(),
        |r| &r.photos,
        |p| p.file_name == *file_name,
    );
    let pose = of_view(
        stages.poses.as_ref(),
        |r| &r.views,
        |v| v.file_name == *file_name,
    );
    let light = of_view(stages.lighting.as_ref(), |r| &r.views, |v| v.name == *name);
    let fused = of_view(stages.fusion.as_ref(), |r| &r.views, |v| v.name == *name);
    let error_px = number(pose.map(|v| v.mean_error_px), 2);
    let rows = [
        ("mask", percent(photo.and_then(|p| p.mask_coverage), 1)),
        (
            "clipped on the object",
            percent(photo.and_then(|p| p.clipped_share_on_object), 2),
        ),
        (
            "clipped in the photo",
            percent(photo.map(|p| p.clipped_share), 2),
        ),
        (
            "keypoints on the object",
            text(features.map(|p| p.num_on_object)),
        ),
        ("points seen", text(pose.map(|v| v.num_points))),
        ("reprojection error", format!("{error_px} px")),
        (
            "light residual",
            percent(light.and_then(|v| v.relative_rms), 1),
        ),
        (
            "points given to the cloud",
            text(fused.map(|v| v.num_points)),
        ),
    ];
    html! {
        dl.facts { @for (name, value) in rows { div { dt { (name) } dd { (value) } } } }
    }
}

/// Pixels of the sphere's outline: the circle in which the cone of tangent rays touches it,
/// projected. `None` where the camera stands inside the sphere or sees it from behind.
fn outline(sphere: &LocatedSphere, view: &PosedView) -> Option<Vec<[f64; 2]>> {
    let center = view
        .cam_from_world
        .apply(&Point3::from(sphere.center_in_world))
        .coords;
    let distance = center.norm();
    let ratio = sphere.radius / distance;
    if ratio.is_nan() || ratio >= 1.0 {
        return None;
    }
    let axis = center / distance;
    let across = axis.cross(&Vector3::y()).try_normalize(1e-9)?;
    let up = axis.cross(&across);
    let middle = center * (1.0 - ratio * ratio);
    let radius = sphere.radius * (1.0 - ratio * ratio).sqrt();
    (0..72)
        .map(|k| {
            let angle = f64::from(k) * std::f64::consts::TAU / 72.0;
            let point = middle + radius * (across * angle.cos() + up * angle.sin());
            let pixel = view.intrinsics.project(&Point3::from(point))?;
            Some([pixel.x, pixel.y])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::{Intrinsics, PhotoIdx, RigidTransform};

    #[test]
    fn the_outline_of_a_sphere_ahead_is_the_tangent_circle() {
        let view = PosedView {
            photo: PhotoIdx(0),
            name: "a".into(),
            file_name: "a.jpg".into(),
            intrinsics: Intrinsics::pinhole(200, 200, 100.0, 100.0, 100.0),
            cam_from_world: RigidTransform::identity(),
        };
        let sphere = LocatedSphere {
            name: String::new(),
            center_in_world: [0.0, 0.0, 2.0],
            radius: 1.0,
            center_sigma: [0.0; 3],
            seen_in: Vec::new(),
        };
        let outline = outline(&sphere, &view).unwrap();
        // tan of the cone's half angle asin(1/2) is 1/√3.
        for [x, y] in outline {
            let radius = ((x - 100.0).powi(2) + (y - 100.0).powi(2)).sqrt();
            assert!((radius - 100.0 / 3f64.sqrt()).abs() < 1e-9, "{radius}");
        }
    }
}
