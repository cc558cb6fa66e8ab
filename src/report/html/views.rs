//! Every view as pictures: photo against re-rendered result, difference, normals, depth,
//! confidence; and the whole photo with sparse points and the outlines of the spheres.

use super::element::{escape, folded, items, number, percent};
use super::matches::{self, Thumb};
use super::picture::{self, MAX_SIDE, Window};
use crate::pipeline::shown_albedo;
use crate::store::RunDir;
use nalgebra::{Point3, Vector3};
use rilievo_io::{read_channel, read_depth, read_linear, read_normal};
use rilievo_scene::{LinearImage, LocatedSphere, PosedView, PosedViews, Raster, StageId, Unit};
use serde_json::Value;
use std::path::Path;

/// Longer side of the photos between which matches are drawn, pixels.
const THUMB_SIDE: usize = 480;
/// Relative difference of photo and result that is shown as full brightness.
const DIFFERENCE_MAX: f32 = 0.25;

/// The section with all views that have a dense shape, or at least a pose.
///
/// # Errors
/// When maps cannot be read.
pub fn section(run: &RunDir, report: &Value, posed: &PosedViews) -> anyhow::Result<String> {
    let mut html = String::from("<section><h2>Views</h2>");
    let mut thumbs = Vec::new();
    for (index, view) in posed.views.iter().enumerate() {
        let mut photo = read_linear(
            &run.stage_dir(StageId::Photos)
                .join(format!("linear/{}.exr", view.name)),
        )?;
        // The results explain the photo at the set's exposure.
        let gain = exposure_gain(report, &view.file_name) as f32;
        photo.data.iter_mut().for_each(|value| *value *= gain);
        let content = one(run, report, posed, index, &photo)?;
        html += &folded(&view.file_name, index == 0, &content);
        thumbs.push(thumb(&photo)?);
    }
    html += "</section>";
    Ok(html + &matches::section(run, posed, &thumbs)?)
}

/// Factor that brought a photo to the set's exposure.
fn exposure_gain(report: &Value, file_name: &str) -> f64 {
    let is_it = |photo: &Value| photo["file_name"] == file_name;
    items(report, "/stages/1_photos/report/photos")
        .iter()
        .position(is_it)
        .and_then(|i| {
            items(report, "/stages/1_photos/report/exposure_gains")
                .get(i)?
                .as_f64()
        })
        .unwrap_or(1.0)
}

fn one(
    run: &RunDir,
    report: &Value,
    posed: &PosedViews,
    index: usize,
    photo: &LinearImage,
) -> anyhow::Result<String> {
    let view = &posed.views[index];
    let mut html = facts(report, view);
    let maps = run.stage_dir(StageId::Shading);
    if maps.join(format!("depth/{}.exr", view.name)).exists() {
        html += &dense(&maps, view, posed.scale.unit, photo)?;
    }
    html += &overlay(posed, index, view, photo)?;
    html += &sphere(run, &view.name);
    Ok(html)
}

/// The photo, small enough to stand in the page a second time.
fn thumb(photo: &LinearImage) -> anyhow::Result<Thumb> {
    let step = photo.width.max(photo.height).div_ceil(THUMB_SIDE);
    Ok(Thumb {
        picture: picture::photo_at(photo, Window::whole(photo.width, photo.height), 1.0, step)?,
        width: (photo.width / step) as f64,
        height: (photo.height / step) as f64,
        step: step as f64,
    })
}

/// Photo, result and maps of the object.
fn dense(maps: &Path, view: &PosedView, unit: Unit, photo: &LinearImage) -> anyhow::Result<String> {
    let file = |kind: &str| maps.join(kind).join(format!("{}.exr", view.name));
    let depth = read_depth(&file("depth"))?;
    let window = Window::around(&depth);
    let exposure = picture::exposure(photo, &depth);
    let name = escape(&view.name);
    let mut html = String::new();
    let mut pictures = Vec::new();
    let observed = picture::photo(photo, window, exposure)?;
    if file("rendered").exists() {
        let rendered = read_linear(&file("rendered"))?;
        html += &format!(
            "<figure class=\"compare\"><div class=\"pair\">\
             <img src=\"{observed}\" alt=\"Photo {name}, cut to the object\">\
             <img class=\"over\" src=\"{}\" alt=\"The same, re-rendered from the result\"></div>\
             <label>photo <input type=\"range\" min=\"0\" max=\"100\" value=\"50\" \
             aria-label=\"Share of the picture that shows the re-rendered result\"> re-rendered</label>\
             <figcaption>The photo, and the image that the result explains</figcaption></figure>",
            picture::photo(&rendered, window, exposure)?
        );
        let difference = relative_difference(photo, &rendered, &depth);
        pictures.push((
            picture::scalar(&difference, window, DIFFERENCE_MAX),
            "Relative difference".to_owned(),
            "where photo and result disagree".to_owned(),
            bar(
                "inferno",
                "0",
                &format!("{:.0} % and more", 100.0 * DIFFERENCE_MAX),
            ),
        ));
    } else {
        pictures.push((
            observed,
            "Photo".to_owned(),
            "cut to the object".to_owned(),
            String::new(),
        ));
    }
    let normal = read_normal(&file("normal"))?;
    pictures.push((
        picture::normals(&normal, window),
        "Normals".to_owned(),
        "red: to the right, green: up, blue: to the camera".to_owned(),
        String::new(),
    ));
    pictures.push((
        picture::depth(&depth, window),
        "Depth".to_owned(),
        "along the optical axis".to_owned(),
        depth_legend(&depth, unit),
    ));
    if file("albedo").exists() {
        let albedo = shown_albedo(&read_linear(&file("albedo"))?);
        pictures.push((
            picture::photo(&albedo, window, 1.0)?,
            "Albedo".to_owned(),
            "relative to the mean, which is a middle grey".to_owned(),
            String::new(),
        ));
    }
    if file("confidence").exists() {
        let confidence = read_channel(&file("confidence"), "C")?;
        pictures.push((
            picture::scalar(&confidence, window, 1.0),
            "Confidence".to_owned(),
            "how well the photos determine a pixel".to_owned(),
            bar("inferno", "0", "1: well"),
        ));
    }
    html += "<div class=\"pictures\">";
    for (picture, what, legend, bar) in pictures {
        html += &format!(
            "<figure><img loading=\"lazy\" src=\"{picture}\" alt=\"{} of {name}\">\
             <figcaption>{}: {}{bar}</figcaption></figure>",
            escape(&what),
            escape(&what),
            escape(&legend)
        );
    }
    Ok(html + "</div>")
}

fn depth_legend(depth: &Raster<f32>, unit: Unit) -> String {
    let (low, high) = depth
        .data
        .iter()
        .filter(|&&z| z > 0.0)
        .fold((f32::INFINITY, 0.0_f32), |(low, high), &z| {
            (low.min(z), high.max(z))
        });
    let unit = match unit {
        Unit::Metre => " m",
        Unit::Arbitrary => "",
    };
    bar(
        "viridis",
        &format!("far: {high:.4}{unit}"),
        &format!("near: {low:.4}{unit}"),
    )
}

/// A colour scale with the values at its ends.
fn bar(colors: &str, low: &str, high: &str) -> String {
    format!(
        "<span class=\"scale\"><span>{}</span><span class=\"bar {colors}\"></span><span>{}</span></span>",
        escape(low),
        escape(high)
    )
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

fn facts(report: &Value, view: &PosedView) -> String {
    let find = |path: &str, key: &str, value: &str| {
        let found = items(report, path)
            .iter()
            .find(|item| item.get(key).and_then(Value::as_str) == Some(value));
        found.cloned().unwrap_or(Value::Null)
    };
    let photo = find(
        "/stages/1_photos/report/photos",
        "file_name",
        &view.file_name,
    );
    let features = find(
        "/stages/2_features/report/photos",
        "file_name",
        &view.file_name,
    );
    let pose = find("/stages/3_poses/report/views", "file_name", &view.file_name);
    let light = find("/stages/4_lighting/report/views", "name", &view.name);
    let fused = find("/stages/6_fusion/report/views", "name", &view.name);
    let rows = [
        ("mask", percent(&photo, "/mask_coverage", 1)),
        ("clipped", percent(&photo, "/clipped_share", 2)),
        (
            "keypoints on the object",
            number(&features, "/num_on_object", 0),
        ),
        ("points seen", number(&pose, "/num_points", 0)),
        (
            "reprojection error",
            format!("{} px", number(&pose, "/mean_error_px", 2)),
        ),
        ("light residual", percent(&light, "/relative_rms", 1)),
        (
            "points given to the cloud",
            number(&fused, "/num_points", 0),
        ),
    ];
    let mut html = String::from("<dl class=\"facts\">");
    for (name, value) in rows {
        html += &format!("<div><dt>{name}</dt><dd>{}</dd></div>", escape(&value));
    }
    html + "</dl>"
}

/// The whole photo with sparse points and the spheres' outlines.
fn overlay(
    posed: &PosedViews,
    index: usize,
    view: &PosedView,
    photo: &LinearImage,
) -> anyhow::Result<String> {
    let window = Window::whole(photo.width, photo.height);
    let step = photo.width.max(photo.height).div_ceil(MAX_SIDE) as f64;
    let mut marks = String::new();
    let mut count = 0;
    for point in &posed.points {
        for sighting in point.track.iter().filter(|s| s.view.0 == index) {
            count += 1;
            let [x, y] = sighting.pixel;
            marks += &format!(
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2\"/>",
                x / step,
                y / step
            );
        }
    }
    // A path of dots: a tenth of the size of circles, and there are thousands.
    let mut dots = String::new();
    let mut num_anchors = 0;
    for anchor in &posed.anchors {
        for seen in anchor.observations.iter().filter(|o| o.view.0 == index) {
            num_anchors += 1;
            dots += &format!("M{:.1} {:.1}h0", seen.pixel[0] / step, seen.pixel[1] / step);
        }
    }
    marks = format!("<path d=\"{dots}\"/>{marks}");
    let mut caption =
        format!("{num_anchors} depth anchors (green), {count} sparse points (yellow)");
    let outlines: Vec<_> = posed
        .spheres
        .iter()
        .filter_map(|s| outline(s, view))
        .collect();
    for outline in &outlines {
        let points: Vec<String> = outline
            .iter()
            .map(|[x, y]| format!("{:.1},{:.1}", x / step, y / step))
            .collect();
        marks += &format!("<polygon points=\"{}\"/>", points.join(" "));
    }
    match outlines.len() {
        0 => {}
        1 => caption += "; outline of the reference sphere where it should be",
        n => caption += &format!("; outlines of {n} reference spheres where they should be"),
    }
    let (width, height) = (photo.width as f64 / step, photo.height as f64 / step);
    Ok(format!(
        "<figure class=\"overlay\"><div><img loading=\"lazy\" src=\"{}\" alt=\"Photo {}\">\
         <svg viewBox=\"0 0 {width:.0} {height:.0}\" aria-hidden=\"true\">{marks}</svg></div>\
         <figcaption>{caption}</figcaption></figure>",
        picture::photo(photo, window, 1.0)?,
        escape(&view.name)
    ))
}

/// The sphere as stage 4 saw it, where there is a picture of that.
fn sphere(run: &RunDir, name: &str) -> String {
    let file = format!("overlay/{name}.png");
    let Ok(bytes) = std::fs::read(run.stage_dir(StageId::Lighting).join(&file)) else {
        return String::new();
    };
    let (stage, file) = (StageId::Lighting, escape(&file));
    format!(
        "<figure><a href=\"{stage}/{file}\"><img loading=\"lazy\" src=\"data:image/png;base64,{}\" \
         alt=\"Sphere in {}\"></a><figcaption>Reference sphere: fitted outline; re-rendered under \
         the light; pixels left out (magenta: clipped, blue: more than 10 % off the light, grey: \
         margin or hidden)</figcaption></figure>",
        picture::base64(&bytes),
        escape(name)
    )
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
