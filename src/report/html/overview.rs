//! The first screen: what came out, whether to trust it, and why.

use super::element::{definitions, number, percent, text};
use super::picture::{Album, Window};
use crate::pipeline::{LightingInput, Request, SphereInput};
use crate::report::facts::{Facts, Stages};
use crate::store::RunDir;
use maud::{Markup, html};
use rilievo_io::{read_depth, read_normal};
use rilievo_scene::{Finding, PosedViews, StageId, Unit, Verdict};
use rilievo_shading::ShadingModel;

/// Bytes of the page that the first picture may take.
const PICTURE_BYTES: usize = 200_000;

/// The section.
pub fn section(
    run: &RunDir,
    facts: &Facts,
    findings: &[Finding],
    posed: Option<&PosedViews>,
) -> Markup {
    let verdict = Verdict::of(findings);
    let sentences: Vec<String> = findings.iter().map(Finding::sentence).collect();
    let picture = picture_of_result(run, posed);
    html! {
        header { h1 { "rilievo report" } }
        section.overview {
            @if let Some(picture) = picture {
                img.hero src=(picture) alt="Normals of the first reconstructed view";
            }
            div {
                h2 { "Verdict: " span class=(class(verdict)) { (verdict.words()) } }
                @if verdict == Verdict::Good {
                    p {
                        "Every photo that was used has a pose, the light explains what they show, and \
                         their surfaces lie on each other."
                    }
                }
                @if !findings.is_empty() {
                    ul { @for finding in findings { (reason(finding)) } }
                }
                (definitions(key_numbers(facts, posed)))
                // What agreement between views does not show.
                p.hint {
                    "The views are solved together and agree more closely than they are accurate. \
                     Errors that they share show in the standard deviations, and against a known shape ("
                    code { "rilievo evaluate" } ")."
                }
            }
        }
        (warnings(facts, &sentences))
    }
}

/// Class of the page's style.
fn class(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Good => "good",
        Verdict::Usable | Verdict::NotFinished => "usable",
        Verdict::NotToBeTrusted => "bad",
    }
}

/// Names that a finding's sentence lists; more are folded away.
const NUM_NAMED: usize = 3;

fn reason(finding: &Finding) -> Markup {
    let code = serde_json::json!(finding.code);
    html! {
        li {
            (finding.sentence()) " " code { (code["code"].as_str().unwrap_or_default()) }
            @if finding.subject.len() > NUM_NAMED {
                details { summary { "all " (finding.subject.len()) } (finding.subject.join(", ")) }
            }
        }
    }
}

fn picture_of_result(run: &RunDir, posed: Option<&PosedViews>) -> Option<String> {
    let dir = run.stage_dir(StageId::Shading);
    for view in posed.map_or(&[][..], |posed| &posed.views) {
        let normal = dir.join(format!("normal/{}.exr", view.name));
        let depth = dir.join(format!("depth/{}.exr", view.name));
        if normal.exists() && depth.exists() {
            // A damaged map is reported where the views are shown.
            let (Ok(depth), Ok(normal)) = (read_depth(&depth), read_normal(&normal)) else {
                continue;
            };
            return Some(Album::new(PICTURE_BYTES, 1).normals(&normal, Window::around(&depth)));
        }
    }
    None
}

/// The numbers by which a result is known, with their names.
fn key_numbers(facts: &Facts, posed: Option<&PosedViews>) -> [(&'static str, String); 14] {
    let stages = &facts.stages;
    let photos = stages.photos.as_ref().map(|stage| &stage.report);
    let poses = stages.poses.as_ref().map(|stage| &stage.report);
    let fusion = stages.fusion.as_ref().map(|stage| &stage.report);
    let unit = posed.map_or(Unit::Arbitrary, |posed| posed.scale.unit);
    let length = |value: f64| unit.length(value, 3);
    let anchors = poses.and_then(|poses| poses.anchors.as_ref());
    let mesh = fusion.and_then(|fusion| fusion.mesh.as_ref());
    let asset = fusion.and_then(|fusion| fusion.asset.as_ref());
    let num_posed = poses.map_or(0, |poses| poses.views.len());
    let num_photos = photos.map_or(0, |photos| photos.photos.len());
    let error_px = number(poses.map(|poses| poses.mean_reprojection_error_px), 2);
    let size_sigma = poses.and_then(|poses| poses.scale.relative_sigma);
    let triangles = mesh.map(|mesh| {
        let (num, moved) = (mesh.num_triangles, length(mesh.simplified_by));
        match mesh.num_triangles_before {
            Some(before) => format!("{num} of {before}, which moved the surface by {moved}"),
            None => num.to_string(),
        }
    });
    let pieces = mesh.map(|mesh| {
        let (pieces, loops, length) = (
            mesh.num_pieces,
            mesh.num_open_loops,
            length(mesh.boundary_length),
        );
        let closed = mesh.num_closed_holes;
        format!("{pieces}, {loops} loops of {length} in all; {closed} holes closed")
    });
    let asset = asset.map(|asset| {
        let ([width, height], texel) = (asset.texture_size, length(asset.texel));
        format!(
            "{} triangles, textures of {width} x {height} texels of {texel} ({}); {:.1} % of it no photo sees",
            asset.num_triangles,
            asset.shows.sentence(),
            100.0 * asset.unseen_share
        )
    });
    let layering = fusion.map(|fusion| fusion.layering);
    [
        ("asked for", asked(&facts.request)),
        ("photos posed", format!("{num_posed} of {num_photos}")),
        ("size", text(stages.size())),
        (
            "a pixel covers",
            text(layering.map(|l| length(l.footprint))),
        ),
        ("mean reprojection error", format!("{error_px} px")),
        ("standard deviation of the size", percent(size_sigma, 2)),
        ("depth anchors", text(anchors.map(|a| a.num_anchors))),
        (
            "standard deviation of an anchor's depth",
            text(anchor_sigma(stages, posed)),
        ),
        (
            "surface that several photos confirm",
            percent(confirmed(stages), 0),
        ),
        (
            "median distance between overlapping views",
            text(layering.map(|l| length(l.median))),
        ),
        (
            "points of the cloud",
            text(fusion.map(|fusion| fusion.num_points)),
        ),
        ("mesh triangles", text(triangles)),
        ("mesh pieces, open edges", text(pieces)),
        ("asset for renderers", text(asset)),
    ]
}

/// What the run was given, in a line.
fn asked(request: &Request) -> String {
    let mut parts = Vec::new();
    if request.masks.is_some() {
        parts.push("object masks");
    }
    if request.cameras.is_some() {
        parts.push("given cameras");
    }
    parts.push(match request.sphere {
        SphereInput::File { .. } => "marked sphere",
        SphereInput::Auto { .. } => "sphere to be found",
        SphereInput::None => "no sphere",
    });
    parts.push(match request.lighting {
        LightingInput::File { .. } => "given light",
        LightingInput::Shape { .. } => "light from a known shape",
        LightingInput::Found => "light to be found",
    });
    parts.push(match request.options.shading.model {
        ShadingModel::Photo => "model “photo”",
        ShadingModel::Paper => "model “paper”",
    });
    parts.join(", ")
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// What the matches alone say of the depth at one point.
fn anchor_sigma(stages: &Stages, posed: Option<&PosedViews>) -> Option<String> {
    let anchors = stages.poses.as_ref()?.report.anchors.as_ref()?;
    let sigmas = anchors.views.iter();
    let relative = mean(sigmas.filter_map(|view| view.median_sigma_ln_depth))?;
    let share = format!("{:.3} % of the depth", 100.0 * relative);
    // A footprint is a depth over a focal length.
    let fusion = stages.fusion.as_ref();
    Some(match (fusion, posed) {
        (Some(fusion), Some(posed)) if posed.scale.unit == Unit::Metre => {
            let focal_px = posed.views.first().map_or(0.0, |v| v.intrinsics.focal_px());
            let depth = fusion.report.layering.footprint * focal_px;
            format!("{:.2} mm, {share}", 1e3 * relative * depth)
        }
        _ => share,
    })
}

/// Mean over the views of the shares that other views confirm.
fn confirmed(stages: &Stages) -> Option<f64> {
    let photo = stages.shading.as_ref()?.report.solver.photo.as_ref()?;
    mean(photo.views.iter().map(|view| view.confirmed))
}

/// Files that cannot be used, and the warnings that are no finding's.
fn warnings(facts: &Facts, sentences: &[String]) -> Markup {
    let problems = &facts.outcome.problems;
    let warnings = facts.warnings.iter();
    let warnings = warnings.filter(|warning| !sentences.contains(&warning.message));
    let warnings: Vec<_> = warnings.collect();
    html! {
        @if !(warnings.is_empty() && problems.is_empty()) {
            section {
                h2 { "What to know, and what to try" }
                ul {
                    @for problem in problems {
                        li { strong { (problem.file.display().to_string()) } ": " (problem.reason) }
                    }
                    @for warning in warnings {
                        li { code { (warning.stage.name()) } " " (warning.message) }
                    }
                }
            }
        }
    }
}
