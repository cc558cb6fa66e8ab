//! The first screen: what came out, whether to trust it, and why.

use super::element::{ABSENT, number, percent};
use super::picture::{Album, Window};
use crate::pipeline::{LightingInput, Request, SphereInput};
use crate::report::facts::{Facts, Stages};
use crate::report::verdict::{Judgement, Verdict};
use crate::store::RunDir;
use maud::{Markup, html};
use rilievo_io::{read_depth, read_normal};
use rilievo_scene::{PosedViews, StageId, Unit};
use rilievo_shading::ShadingModel;

/// Bytes of the page that the first picture may take.
const PICTURE_BYTES: usize = 200_000;

/// The section.
pub fn section(
    run: &RunDir,
    facts: &Facts,
    judgement: &Judgement,
    posed: Option<&PosedViews>,
) -> Markup {
    let Judgement { verdict, reasons } = judgement;
    let picture = picture_of_result(run, posed);
    html! {
        header { h1 { "rilievo report" } }
        section.overview {
            @if let Some(picture) = picture {
                img.hero src=(picture) alt="Normals of the first reconstructed view";
            }
            div {
                h2 { "Verdict: " span class=(verdict.class()) { (verdict.words()) } }
                @if *verdict == Verdict::Good {
                    p {
                        "Every photo that was used has a pose, the light explains what they show, and \
                         their surfaces lie on each other."
                    }
                }
                @if !reasons.is_empty() {
                    ul { @for reason in reasons { li { (reason) } } }
                }
                dl {
                    @for (name, value) in key_numbers(facts, posed) { dt { (name) } dd { (value) } }
                }
                // What agreement between views cannot tell.
                p.hint {
                    "The views are solved together and agree more closely than they are accurate. \
                     Errors that they share show in the standard deviations, and against a known shape ("
                    code { "rilievo evaluate" } ")."
                }
            }
        }
        (warnings(facts))
    }
}

fn picture_of_result(run: &RunDir, posed: Option<&PosedViews>) -> Option<String> {
    let dir = run.stage_dir(StageId::Shading);
    for view in posed.map_or(&[][..], |posed| &posed.views) {
        let normal = dir.join(format!("normal/{}.exr", view.name));
        let depth = dir.join(format!("depth/{}.exr", view.name));
        if normal.exists() && depth.exists() {
            // A damaged map is told of where the views are shown.
            let (Ok(depth), Ok(normal)) = (read_depth(&depth), read_normal(&normal)) else {
                continue;
            };
            return Some(Album::new(PICTURE_BYTES, 1).normals(&normal, Window::around(&depth)));
        }
    }
    None
}

fn key_numbers(facts: &Facts, posed: Option<&PosedViews>) -> [(&'static str, String); 14] {
    let stages = &facts.stages;
    let photos = stages.photos.as_ref().map(|stage| &stage.report);
    let poses = stages.poses.as_ref().map(|stage| &stage.report);
    let fusion = stages.fusion.as_ref().map(|stage| &stage.report);
    let metric = posed.is_some_and(|posed| posed.scale.unit == Unit::Metre);
    let length = |value: Option<f64>| match value {
        Some(value) if metric => format!("{:.3} mm", 1e3 * value),
        Some(value) => format!("{value:.2e} (no scale)"),
        None => ABSENT.to_owned(),
    };
    let count = |number: Option<usize>| number.map_or(ABSENT.to_owned(), |n| n.to_string());
    let anchors = poses.and_then(|poses| poses.anchors.as_ref());
    let mesh = fusion.and_then(|fusion| fusion.mesh.as_ref());
    [
        ("asked for", asked(&facts.request)),
        (
            "photos posed",
            format!(
                "{} of {}",
                poses.map_or(0, |poses| poses.views.len()),
                photos.map_or(0, |photos| photos.photos.len())
            ),
        ),
        ("size", stages.size().unwrap_or_else(|| ABSENT.to_owned())),
        (
            "a pixel covers",
            length(fusion.map(|fusion| fusion.layering.footprint)),
        ),
        (
            "mean reprojection error",
            format!(
                "{} px",
                number(poses.map(|poses| poses.mean_reprojection_error_px), 2)
            ),
        ),
        (
            "standard deviation of the size",
            percent(poses.and_then(|poses| poses.scale.relative_sigma), 2),
        ),
        ("depth anchors", count(anchors.map(|a| a.num_anchors))),
        (
            "standard deviation of an anchor's depth",
            anchor_sigma(stages, posed),
        ),
        ("surface that several photos confirm", confirmed(stages)),
        (
            "median distance between overlapping views",
            length(fusion.map(|fusion| fusion.layering.median)),
        ),
        (
            "points of the cloud",
            count(fusion.map(|fusion| fusion.num_points)),
        ),
        (
            "mesh triangles",
            mesh.map_or(ABSENT.to_owned(), |mesh| match mesh.num_triangles_before {
                Some(before) => format!(
                    "{} of {before}, which moved the surface by {}",
                    mesh.num_triangles,
                    length(Some(mesh.simplified_by))
                ),
                None => mesh.num_triangles.to_string(),
            }),
        ),
        (
            "mesh pieces, open edges",
            mesh.map_or(ABSENT.to_owned(), |mesh| {
                format!(
                    "{}, {} loops of {} in all; {} holes closed",
                    mesh.num_pieces,
                    mesh.num_open_loops,
                    length(Some(mesh.boundary_length)),
                    mesh.num_closed_holes
                )
            }),
        ),
        (
            "asset for renderers",
            fusion
                .and_then(|fusion| fusion.asset.as_ref())
                .map_or(ABSENT.to_owned(), |asset| {
                    format!(
                        "{} triangles, textures of {} x {} texels of {} ({}); {:.1} % of it no photo sees",
                        asset.num_triangles,
                        asset.texture_size[0],
                        asset.texture_size[1],
                        length(Some(asset.texel)),
                        asset.shows.sentence(),
                        100.0 * asset.unseen_share
                    )
                }),
        ),
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
fn anchor_sigma(stages: &Stages, posed: Option<&PosedViews>) -> String {
    let poses = stages.poses.as_ref();
    let anchors = poses.and_then(|poses| poses.report.anchors.as_ref());
    let sigmas = anchors.iter().flat_map(|anchors| &anchors.views);
    let Some(relative) = mean(sigmas.filter_map(|view| view.median_sigma_ln_depth)) else {
        return ABSENT.to_owned();
    };
    let share = format!("{:.3} % of the depth", 100.0 * relative);
    // A footprint is a depth over a focal length.
    let fusion = stages.fusion.as_ref();
    match (fusion, posed) {
        (Some(fusion), Some(posed)) if posed.scale.unit == Unit::Metre => {
            let focal_px = posed.views.first().map_or(0.0, |v| v.intrinsics.focal_px());
            let depth = fusion.report.layering.footprint * focal_px;
            format!("{:.2} mm, {share}", 1e3 * relative * depth)
        }
        _ => share,
    }
}

fn confirmed(stages: &Stages) -> String {
    let shading = stages.shading.as_ref();
    let photo = shading.and_then(|shading| shading.report.solver.photo.as_ref());
    match mean(
        photo
            .iter()
            .flat_map(|photo| &photo.views)
            .map(|view| view.confirmed),
    ) {
        Some(share) => format!("{:.0} %", 100.0 * share),
        None => ABSENT.to_owned(),
    }
}

fn warnings(facts: &Facts) -> Markup {
    let problems = &facts.outcome.problems;
    html! {
        @if !(facts.warnings.is_empty() && problems.is_empty()) {
            section {
                h2 { "What to know, and what to try" }
                ul {
                    @for problem in problems {
                        li { strong { (problem.file.display().to_string()) } ": " (problem.reason) }
                    }
                    @for warning in &facts.warnings {
                        li { code { (warning.stage.name()) } " " (warning.message) }
                    }
                }
            }
        }
    }
}
