//! What every stage found, in tables; settings, versions and hashes for those who repeat it.

use super::element::{escape, folded, items, number, percent, table, text};
use super::plot;
use rilievo_scene::StageId;
use serde_json::Value;

/// Sections of all stages that ran, and of the run as a whole.
pub fn sections(report: &Value) -> String {
    let mut html = String::from("<section><h2>Stages</h2>");
    for stage in StageId::ALL {
        let Some(entry) = report.pointer(&format!("/stages/{stage}")) else {
            continue;
        };
        let facts = entry.get("report").unwrap_or(&Value::Null);
        let tables = match stage {
            StageId::Photos => photos(facts),
            StageId::Features => features(facts),
            StageId::Poses => poses(facts),
            StageId::Lighting => lighting(facts),
            StageId::Shading => shading(facts),
            StageId::Fusion => fusion(facts),
        };
        let title = format!("{stage}, {} s", number(entry, "/seconds", 1));
        html += &folded(&title, false, &(tables + &settings(entry)));
    }
    html += "</section><section><h2>This run</h2><dl>";
    for (name, value) in [
        ("program", text(report, "/program")),
        ("threads", text(report, "/threads")),
        ("peak memory", peak_memory(report)),
        ("citation", text(report, "/citation")),
    ] {
        html += &format!("<dt>{name}</dt><dd>{}</dd>", escape(&value));
    }
    let request = report.get("request").unwrap_or(&Value::Null);
    html += "</dl>";
    html += &folded(
        "What was asked for",
        false,
        &format!("<pre>{}</pre>", escape(&format!("{request:#}"))),
    );
    html + "</section>"
}

fn peak_memory(report: &Value) -> String {
    match report.pointer("/peak_memory_bytes").and_then(Value::as_f64) {
        Some(bytes) => format!("{:.0} MB", bytes / 1e6),
        None => "–".to_owned(),
    }
}

fn settings(entry: &Value) -> String {
    let options = entry.get("options").unwrap_or(&Value::Null);
    let inputs = entry.get("inputs").unwrap_or(&Value::Null);
    folded(
        "Options, inputs and fingerprint",
        false,
        &format!(
            "<p>fingerprint <code>{}</code>, seed {}</p><pre>{}</pre><pre>{}</pre>",
            escape(&text(entry, "/fingerprint")),
            text(entry, "/seed"),
            escape(&format!("{options:#}")),
            escape(&format!("{inputs:#}"))
        ),
    )
}

fn photos(facts: &Value) -> String {
    let row = |photo: &Value| {
        vec![
            text(photo, "/file_name"),
            format!("{} x {}", text(photo, "/width"), text(photo, "/height")),
            format!("{} px", number(photo, "/intrinsics/fx", 0)),
            text(photo, "/focal_note"),
            text(photo, "/encoding"),
            percent(photo, "/mask_coverage", 1),
            percent(photo, "/clipped_share", 2),
            number(photo, "/noise_sigma", 4),
        ]
    };
    let head = [
        "photo",
        "size",
        "focal",
        "focal from",
        "encoding",
        "mask",
        "clipped",
        "noise",
    ];
    let usable: Vec<_> = items(facts, "/photos").iter().map(row).collect();
    let rejected: Vec<_> = items(facts, "/rejected")
        .iter()
        .map(|photo| vec![text(photo, "/file"), text(photo, "/reason")])
        .collect();
    table("Photos that are used", &head, &usable)
        + &table("Photos that are not used", &["file", "why"], &rejected)
}

fn features(facts: &Value) -> String {
    let photos = items(facts, "/photos");
    let rows: Vec<_> = photos
        .iter()
        .map(|photo| {
            vec![
                text(photo, "/file_name"),
                text(photo, "/num_keypoints"),
                text(photo, "/num_on_object"),
                text(photo, "/num_pairs"),
            ]
        })
        .collect();
    let mut html = table(
        "Keypoints",
        &["photo", "keypoints", "on the object", "pairs matched"],
        &rows,
    );
    let pairs = items(facts, "/pairs");
    // A matrix of all pairs stays readable up to a few dozen photos.
    if photos.len() <= 40 {
        let mut head = vec!["verified matches".to_owned()];
        head.extend((1..=photos.len()).map(|n| n.to_string()));
        let head: Vec<&str> = head.iter().map(String::as_str).collect();
        let rows: Vec<Vec<String>> = photos
            .iter()
            .enumerate()
            .map(|(a, photo)| {
                let mut row = vec![format!("{}  {}", a + 1, text(photo, "/file_name"))];
                row.extend((0..photos.len()).map(|b| verified(pairs, a, b)));
                row
            })
            .collect();
        html += &table("Matches between photos", &head, &rows);
    }
    html
}

fn verified(pairs: &[Value], a: usize, b: usize) -> String {
    let (first, second) = (a.min(b) as u64, a.max(b) as u64);
    let found = pairs.iter().find(|pair| {
        pair.get("first").and_then(Value::as_u64) == Some(first)
            && pair.get("second").and_then(Value::as_u64) == Some(second)
    });
    found.map_or(String::new(), |pair| text(pair, "/num_verified"))
}

fn poses(facts: &Value) -> String {
    let rows: Vec<_> = items(facts, "/views")
        .iter()
        .map(|view| {
            vec![
                text(view, "/file_name"),
                text(view, "/num_points"),
                number(view, "/mean_error_px", 3),
                number(view, "/rotation_sigma_deg", 4),
                number(view, "/center_sigma", 6),
            ]
        })
        .collect();
    let anchors: Vec<_> = items(facts, "/anchors/views")
        .iter()
        .map(|view| {
            vec![
                text(view, "/file_name"),
                text(view, "/num_anchors"),
                percent(view, "/coverage", 0),
                percent(view, "/median_sigma_ln_depth", 3),
            ]
        })
        .collect();
    let head = [
        "photo",
        "points",
        "error, px",
        "rotation sigma, deg",
        "centre sigma, world's unit",
    ];
    table("Poses", &head, &rows)
        + &table(
            "Depth anchors",
            &[
                "photo",
                "anchors",
                "object within 20 px of one",
                "depth sigma",
            ],
            &anchors,
        )
        + &format!(
            "<p>scale: {} ({}), relative standard deviation {}; {} points seen {} times on average; \
             first pair {}</p>{}",
            escape(&text(facts, "/scale/unit")),
            escape(&text(facts, "/scale/source")),
            percent(facts, "/scale/relative_sigma", 2),
            text(facts, "/num_points"),
            number(facts, "/mean_track_length", 1),
            escape(&text(facts, "/initial_pair")),
            vertical_and_residuals(facts),
        )
}

/// Which way is up, and how well the anchors' patches agree.
fn vertical_and_residuals(facts: &Value) -> String {
    let mut html = String::new();
    if facts.pointer("/vertical").is_some_and(|v| !v.is_null()) {
        html += &format!(
            "<p>upwards in the world: {}, told from the {}, standard deviation {} deg</p>",
            escape(&text(facts, "/vertical/up_in_world")),
            escape(&text(facts, "/vertical/source")),
            number(facts, "/vertical/sigma_deg", 2),
        );
    }
    if facts.pointer("/anchors").is_some_and(|v| !v.is_null()) {
        html += &format!(
            "<p>{} anchors ({}) from {} patches: mean correlation {}, residual {} of ln intensity \
             (RMS), deviations {} times those of independent residuals; all in \
             <a href=\"3_poses/anchors.ply\">anchors.ply</a> and \
             <a href=\"3_poses/anchors.json\">anchors.json</a></p>",
            text(facts, "/anchors/num_anchors"),
            escape(&text(facts, "/anchors/mode")),
            text(facts, "/anchors/num_patches"),
            number(facts, "/anchors/mean_correlation", 3),
            number(facts, "/anchors/rms_residual", 4),
            number(facts, "/anchors/noise_factor", 1),
        );
    }
    html
}

fn lighting(facts: &Value) -> String {
    let rows: Vec<_> = items(facts, "/views")
        .iter()
        .map(|view| {
            vec![
                text(view, "/name"),
                text(view, "/num_pixels"),
                percent(view, "/relative_rms", 1),
                percent(view, "/clipped_share", 1),
                text(view, "/gain"),
                left_out(view),
            ]
        })
        .collect();
    let head = [
        "view",
        "pixels",
        "residual",
        "clipped",
        "gain",
        "left out because",
    ];
    let uncalibrated = facts.pointer("/uncalibrated") == Some(&Value::Bool(true));
    let mark = if uncalibrated {
        "<p><strong>Uncalibrated</strong>: there was no sphere, file or shape. The light is fitted on \
         the photos' own rough shape; brightness and albedo share one unknown factor, and where the \
         shape is uncertain bumps and hollows may swap.</p>"
    } else {
        ""
    };
    format!(
        "{mark}<p>light from: {}; fixed to: {}; most light comes from {}</p>",
        escape(&text(facts, "/source")),
        escape(&text(facts, "/kind")),
        escape(&text(facts, "/dominant_direction"))
    ) + &table("Lighting", &head, &rows)
        + &spheres(facts)
}

/// Why a view took no part, or a sphere of several in it.
fn left_out(view: &Value) -> String {
    let of_spheres: Vec<&str> = items(view, "/unused_spheres")
        .iter()
        .filter_map(Value::as_str)
        .collect();
    if of_spheres.is_empty() {
        return text(view, "/left_out");
    }
    of_spheres.join("; ")
}

/// How several spheres agree on one light.
fn spheres(facts: &Value) -> String {
    let spheres = items(facts, "/spheres");
    let is_compared = |sphere: &Value| sphere["compared_with"].is_string();
    if !spheres.iter().any(is_compared) {
        return String::new();
    }
    let rows: Vec<_> = spheres
        .iter()
        .map(|sphere| {
            vec![
                text(sphere, "/name"),
                text(sphere, "/num_pixels"),
                items(sphere, "/views").len().to_string(),
                text(sphere, "/compared_with"),
                ratios(sphere, "/brightness_ratio"),
                percent(sphere, "/own_rms", 1),
                percent(sphere, "/other_rms", 1),
                number(sphere, "/direction_difference_deg", 1),
                yes_or_no(sphere, "/left_out"),
            ]
        })
        .collect();
    let head = [
        "sphere",
        "pixels",
        "photos",
        "compared with",
        "brightness over that one's",
        "residual of its own light",
        "of that one's light",
        "directions apart, degrees",
        "left out",
    ];
    table("Spheres", &head, &rows)
}

/// Numbers at a path, one per channel.
fn ratios(facts: &Value, path: &str) -> String {
    let channels = items(facts, path).iter();
    let numbers: Vec<String> = channels.map(|ratio| number(ratio, "", 2)).collect();
    if numbers.is_empty() {
        return "–".to_owned();
    }
    numbers.join(", ")
}

fn yes_or_no(facts: &Value, path: &str) -> String {
    let word = facts.pointer(path).and_then(Value::as_bool);
    word.map_or("–", |is| if is { "yes" } else { "no" })
        .to_owned()
}

fn shading(facts: &Value) -> String {
    let light: Vec<_> = items(facts, "/light_on_surface/views")
        .iter()
        .map(|view| {
            vec![
                text(view, "/name"),
                percent(view, "/used_rms", 1),
                percent(view, "/used_rms_after_gain", 1),
                percent(view, "/refitted_rms", 1),
            ]
        })
        .collect();
    let head = [
        "view",
        "re-rendered with the light of stage 4",
        "after the best gain",
        "with the best distant light",
    ];
    let mut html = table("Photos and light, differences on the result", &head, &light);
    html += &trust(facts);
    for view in items(facts, "/views") {
        let series = |key: &str| -> Vec<f64> {
            items(view, "/iterations")
                .iter()
                .filter_map(|record| record.get(key)?.as_f64())
                .collect()
        };
        let name = text(view, "/name");
        html += &plot::logarithmic(
            &format!("Convergence of {name}"),
            &[
                ("energy", series("energy")),
                ("primal residual", series("primal_residual")),
                ("dual residual", series("dual_residual")),
            ],
        );
    }
    // What the solver tells depends on the model that was asked for; show all of it.
    html + &folded(
        "Everything that the solver tells",
        false,
        &format!(
            "<pre>{}</pre>",
            escape(&format!("{:#}", without_iterations(facts)))
        ),
    )
}

/// Where shading took part, and what photos that were left out said of it.
fn trust(facts: &Value) -> String {
    let views = items(facts, "/photo/views");
    if views.is_empty() {
        return String::new();
    }
    let rows: Vec<_> = views
        .iter()
        .map(|view| {
            vec![
                text(view, "/name"),
                number(view, "/gain/1", 3),
                percent(view, "/disagreement", 1),
                percent(view, "/seen_alone", 1),
                percent(view, "/light_residual", 1),
                percent(view, "/shading_trust", 0),
                percent(view, "/without_shading", 1),
            ]
        })
        .collect();
    let head = [
        "view",
        "exposure gain (green)",
        "disagreement with other photos",
        "seen in this photo alone",
        "light misses the photo by",
        "trust in shading",
        "where shading takes no part",
    ];
    let mut html = format!("<p>{}</p>", escape(&text(facts, "/photo/shading")));
    if facts.pointer("/photo/validation/significance").is_some() {
        html += &format!(
            "<p>Photos that were left out: squared difference {} without shading, {} with it, \
             {} standard deviations in its favour.</p>",
            number(facts, "/photo/validation/squared_residual/0", 6),
            number(facts, "/photo/validation/squared_residual/1", 6),
            number(facts, "/photo/validation/significance", 1),
        );
    }
    for note in items(facts, "/photo/notes") {
        html += &format!("<p>{}</p>", escape(note.as_str().unwrap_or_default()));
    }
    html + &table("Agreement and shading", &head, &rows)
}

fn without_iterations(facts: &Value) -> Value {
    let mut facts = facts.clone();
    if let Some(views) = facts.get_mut("views").and_then(Value::as_array_mut) {
        for view in views {
            if let Some(view) = view.as_object_mut() {
                view.remove("iterations");
            }
        }
    }
    facts
}

fn fusion(facts: &Value) -> String {
    let rows: Vec<_> = items(facts, "/views")
        .iter()
        .map(|view| {
            vec![
                text(view, "/name"),
                text(view, "/num_depths"),
                text(view, "/num_border"),
                text(view, "/num_grazing"),
                text(view, "/num_inconsistent"),
                text(view, "/num_points"),
            ]
        })
        .collect();
    let head = [
        "view",
        "depths",
        "at borders",
        "oblique",
        "inconsistent",
        "points given",
    ];
    table("Fusion", &head, &rows)
        + &format!(
            "<p>distance between overlapping views (RMS, world's unit): {} before reconciling, {} \
             after; a pixel covers {}</p>",
            number(facts, "/layering_before/rms", 6),
            number(facts, "/layering_after/rms", 6),
            number(facts, "/layering_after/footprint", 6),
        )
}
