//! The first screen: what came out, whether to trust it, and why.

use super::element::{escape, items, number, percent};
use super::picture::{self, Window};
use crate::store::RunDir;
use rilievo_io::read_normal;
use rilievo_scene::{PosedViews, StageId, Unit};
use serde_json::Value;

/// How far a result can be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Verdict {
    Good,
    Usable,
    NotFinished,
    NotToBeTrusted,
}

/// Reprojection error above which poses are doubtful, pixels: twice what keypoints allow.
const DOUBTFUL_REPROJECTION_PX: f64 = 1.0;
/// Light residual above which shading contradicts the photos: nine distant harmonics leave 10 to
/// 12 % on real objects, half-hidden light up to 20 %.
const DOUBTFUL_LIGHT: f64 = 0.2;
/// Distance between overlapping views, in pixel footprints, above which they form layers.
const DOUBTFUL_LAYERING_PX: f64 = 2.0;

/// What agreement between views cannot tell.
const SHARED_ERRORS: &str = "<p class=\"hint\">The views are solved together and agree more closely than \
     they are accurate. Errors that they share show in the standard deviations, and against a known \
     shape (<code>rilievo evaluate</code>).</p>";

/// The section.
///
/// # Errors
/// When a map cannot be read.
pub fn section(run: &RunDir, report: &Value, posed: Option<&PosedViews>) -> anyhow::Result<String> {
    let (verdict, reasons) = verdict(report);
    let words = match verdict {
        Verdict::Good => "good",
        Verdict::Usable => "usable, with care",
        Verdict::NotFinished => "not finished",
        Verdict::NotToBeTrusted => "not to be trusted",
    };
    let class = match verdict {
        Verdict::Good => "good",
        Verdict::Usable | Verdict::NotFinished => "usable",
        Verdict::NotToBeTrusted => "bad",
    };
    let mut html =
        String::from("<header><h1>rilievo report</h1></header><section class=\"overview\">");
    if let Some(picture) = picture_of_result(run, posed)? {
        html += &format!(
            "<img class=\"hero\" src=\"{picture}\" alt=\"Normals of the first reconstructed view\">"
        );
    }
    html += &format!("<div><h2>Verdict: <span class=\"{class}\">{words}</span></h2>");
    if verdict == Verdict::Good {
        html += "<p>Every photo that was used has a pose, the light explains what they show, and \
                 their surfaces lie on each other.</p>";
    }
    if !reasons.is_empty() {
        html += "<ul>";
        for reason in &reasons {
            html += &format!("<li>{}</li>", escape(reason));
        }
        html += "</ul>";
    }
    html += &key_numbers(report, posed);
    html += SHARED_ERRORS;
    html += "</div></section>";
    html += &warnings(report);
    Ok(html)
}

fn picture_of_result(run: &RunDir, posed: Option<&PosedViews>) -> anyhow::Result<Option<String>> {
    let dir = run.stage_dir(StageId::Shading);
    for view in posed.map_or(&[][..], |posed| &posed.views) {
        let normal = dir.join(format!("normal/{}.exr", view.name));
        let depth = dir.join(format!("depth/{}.exr", view.name));
        if normal.exists() && depth.exists() {
            let window = Window::around(&rilievo_io::read_depth(&depth)?);
            return Ok(Some(picture::normals(&read_normal(&normal)?, window)));
        }
    }
    Ok(None)
}

fn verdict(report: &Value) -> (Verdict, Vec<String>) {
    let mut worst = Verdict::Good;
    let mut reasons = Vec::new();
    let mut note = |verdict: Verdict, reason: String| {
        worst = worst.max(verdict);
        reasons.push(reason);
    };
    if let Some(error) = report.pointer("/outcome/error").and_then(Value::as_str) {
        note(
            Verdict::NotToBeTrusted,
            format!("the run did not end: {error}"),
        );
    }
    let fusion = report.pointer("/stages/6_fusion");
    match fusion.map(|fusion| fusion.pointer("/state/state").and_then(Value::as_str)) {
        None => note(
            Verdict::NotFinished,
            "there is no point cloud and no mesh yet".to_owned(),
        ),
        Some(Some("stale")) => note(
            Verdict::NotFinished,
            "point cloud and mesh are stale: they were made from something else than what is \
             asked for now"
                .to_owned(),
        ),
        Some(_) => {}
    }
    let rejected = items(report, "/stages/1_photos/report/rejected").len();
    if rejected > 0 {
        note(
            Verdict::Usable,
            format!("{rejected} photo(s) could not be used"),
        );
    }
    let photos = items(report, "/stages/1_photos/report/photos").len();
    let posed = items(report, "/stages/3_poses/report/views").len();
    if report.pointer("/stages/3_poses").is_some() && posed < photos {
        let verdict = if 2 * posed < photos {
            Verdict::NotToBeTrusted
        } else {
            Verdict::Usable
        };
        note(
            verdict,
            format!("only {posed} of {photos} photos got a pose"),
        );
    }
    let poses = "/stages/3_poses/report/mean_reprojection_error_px";
    let error = report.pointer(poses).and_then(Value::as_f64);
    if let Some(error) = error.filter(|&error| error > DOUBTFUL_REPROJECTION_PX) {
        note(
            Verdict::Usable,
            format!("the mean reprojection error is {error:.2} px; good poses are below 1 px"),
        );
    }
    if report
        .pointer("/stages/4_lighting/report/uncalibrated")
        .and_then(Value::as_bool)
        == Some(true)
    {
        note(
            Verdict::Usable,
            "the light is uncalibrated: no sphere, file or shape was given".to_owned(),
        );
    }
    for view in items(report, "/stages/4_lighting/report/views") {
        let residual = view.pointer("/relative_rms").and_then(Value::as_f64);
        if let Some(residual) = residual.filter(|&residual| residual > DOUBTFUL_LIGHT) {
            let name = view.pointer("/name").and_then(Value::as_str).unwrap_or("");
            note(
                Verdict::Usable,
                format!(
                    "the light explains {name} only to {:.0} %",
                    100.0 * residual
                ),
            );
        }
    }
    let layering = report.pointer("/stages/6_fusion/report/layering_after");
    let value = |key: &str| layering.and_then(|l| l.get(key)).and_then(Value::as_f64);
    if let (Some(median), Some(footprint)) = (value("median"), value("footprint"))
        && footprint > 0.0
        && median > DOUBTFUL_LAYERING_PX * footprint
    {
        note(
            Verdict::NotToBeTrusted,
            format!(
                "overlapping views lie {:.1} pixel footprints apart: their surfaces form layers",
                median / footprint
            ),
        );
    }
    (worst, reasons)
}

fn key_numbers(report: &Value, posed: Option<&PosedViews>) -> String {
    let metric = posed.is_some_and(|posed| posed.scale.unit == Unit::Metre);
    let length = |path: &str| match report.pointer(path).and_then(Value::as_f64) {
        Some(value) if metric => format!("{:.3} mm", 1e3 * value),
        Some(value) => format!("{value:.2e} (no scale)"),
        None => "–".to_owned(),
    };
    let fusion = "/stages/6_fusion/report";
    let photos = items(report, "/stages/1_photos/report/photos").len();
    let views = items(report, "/stages/3_poses/report/views").len();
    let anchors = "/stages/3_poses/report/anchors/num_anchors";
    let rows = [
        ("asked for", asked(report)),
        ("photos posed", format!("{views} of {photos}")),
        (
            "mean reprojection error",
            format!(
                "{} px",
                number(
                    report,
                    "/stages/3_poses/report/mean_reprojection_error_px",
                    2
                )
            ),
        ),
        (
            "standard deviation of the size",
            percent(report, "/stages/3_poses/report/scale/relative_sigma", 2),
        ),
        ("depth anchors", number(report, anchors, 0)),
        (
            "standard deviation of an anchor's depth",
            anchor_sigma(report, posed),
        ),
        ("surface that several photos confirm", confirmed(report)),
        (
            "median distance between overlapping views",
            length(&format!("{fusion}/layering_after/median")),
        ),
        (
            "points of the cloud",
            number(report, &format!("{fusion}/num_points"), 0),
        ),
        (
            "mesh triangles",
            number(report, &format!("{fusion}/mesh/num_triangles"), 0),
        ),
    ];
    let mut html = String::from("<dl>");
    for (name, value) in rows {
        html += &format!("<dt>{}</dt><dd>{}</dd>", escape(name), escape(&value));
    }
    html + "</dl>"
}

/// What the run was given, in a line.
fn asked(report: &Value) -> String {
    let given = |key: &str| report.pointer(&format!("/request/{key}"));
    let mut parts = Vec::new();
    if given("masks").is_some_and(|masks| !masks.is_null()) {
        parts.push("object masks".to_owned());
    }
    if given("cameras").is_some_and(|cameras| !cameras.is_null()) {
        parts.push("given cameras".to_owned());
    }
    parts.push(match given("sphere") {
        Some(sphere) if sphere.get("file").is_some() => "marked sphere".to_owned(),
        Some(sphere) if sphere.get("auto").is_some() => "sphere to be found".to_owned(),
        _ => "no sphere".to_owned(),
    });
    parts.push(match given("lighting") {
        Some(light) if light.get("file").is_some() => "given light".to_owned(),
        Some(light) if light.get("shape").is_some() => "light from a known shape".to_owned(),
        _ => "light to be found".to_owned(),
    });
    if let Some(model) = given("options/shading/model").and_then(Value::as_str) {
        parts.push(format!("model \u{201c}{model}\u{201d}"));
    }
    parts.join(", ")
}

/// Mean of a number over the items of a list.
fn mean_of(report: &Value, list: &str, key: &str) -> Option<f64> {
    let values: Vec<f64> = items(report, list)
        .iter()
        .filter_map(|item| item.get(key)?.as_f64())
        .collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// What the matches alone say of the depth at one point.
fn anchor_sigma(report: &Value, posed: Option<&PosedViews>) -> String {
    let views = "/stages/3_poses/report/anchors/views";
    let Some(relative) = mean_of(report, views, "median_sigma_ln_depth") else {
        return "–".to_owned();
    };
    let share = format!("{:.3} % of the depth", 100.0 * relative);
    // A footprint is a depth over a focal length.
    let footprint = report
        .pointer("/stages/6_fusion/report/layering_after/footprint")
        .and_then(Value::as_f64);
    match (footprint, posed) {
        (Some(footprint), Some(posed)) if posed.scale.unit == Unit::Metre => {
            let focal_px = posed.views.first().map_or(0.0, |v| v.intrinsics.focal_px());
            format!("{:.2} mm, {share}", 1e3 * relative * footprint * focal_px)
        }
        _ => share,
    }
}

fn confirmed(report: &Value) -> String {
    match mean_of(report, "/stages/5_shading/report/photo/views", "confirmed") {
        Some(share) => format!("{:.0} %", 100.0 * share),
        None => "–".to_owned(),
    }
}

fn warnings(report: &Value) -> String {
    let warnings = items(report, "/warnings");
    let problems = items(report, "/outcome/problems");
    let rejected = items(report, "/stages/1_photos/report/rejected");
    if warnings.is_empty() && problems.is_empty() && rejected.is_empty() {
        return String::new();
    }
    let field =
        |value: &Value, key: &str| escape(value.get(key).and_then(Value::as_str).unwrap_or(""));
    let mut html = String::from("<section><h2>What to know, and what to try</h2><ul>");
    for problem in problems {
        html += &format!(
            "<li><strong>{}</strong>: {}</li>",
            field(problem, "file"),
            field(problem, "reason")
        );
    }
    for warning in warnings {
        html += &format!(
            "<li><code>{}</code> {}</li>",
            field(warning, "stage"),
            field(warning, "message")
        );
    }
    html + "</ul></section>"
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_verdict_follows_the_facts() {
        let good = json!({"stages": {
            "1_photos": {"report": {"photos": [{}, {}], "rejected": []}},
            "3_poses": {"report": {"views": [{}, {}], "mean_reprojection_error_px": 0.3}},
            "6_fusion": {"report": {"layering_after": {"median": 1e-4, "footprint": 2e-4}}},
        }});
        assert_eq!(verdict(&good), (Verdict::Good, Vec::new()));
        let mut layers = good.clone();
        layers["stages"]["6_fusion"]["report"]["layering_after"]["median"] = json!(1e-3);
        assert_eq!(verdict(&layers).0, Verdict::NotToBeTrusted);
        let mut one_lost = good.clone();
        one_lost["stages"]["3_poses"]["report"]["views"] = json!([{}]);
        assert_eq!(verdict(&one_lost).0, Verdict::Usable);
        let mut stale = good.clone();
        stale["stages"]["6_fusion"]["state"] = json!({"state": "stale", "reasons": []});
        assert_eq!(verdict(&stale).0, Verdict::NotFinished);
        let mut started = good.clone();
        started["stages"]
            .as_object_mut()
            .unwrap()
            .remove("6_fusion");
        assert_eq!(verdict(&started).0, Verdict::NotFinished);
        let failed = json!({"outcome": {"error": "no two photos match"}});
        assert_eq!(verdict(&failed).0, Verdict::NotToBeTrusted);
    }
}
