//! What every stage found, in tables; settings, versions and hashes for those who repeat it.

use super::element::{ABSENT, folded, json, number, percent, table, text, word};
use super::plot;
use crate::cost::{Cost, Estimate};
use crate::pipeline::ShadingFacts;
use crate::report::facts::{Facts, Made, Stage};
use maud::{Markup, html};
use rilievo_features::{FeaturesReport, PairReport};
use rilievo_fusion::FusionReport;
use rilievo_lighting::{LightingReport, SphereLightReport, ViewLightReport};
use rilievo_photos::PhotosReport;
use rilievo_poses::PosesReport;
use rilievo_scene::StageId;
use rilievo_shading::photo::PhotoReport;

/// Most photos of which a matrix of all pairs stays readable.
const MAX_MATRIX: usize = 40;

/// Sections of all stages that ran, and of the run as a whole.
pub fn sections(facts: &Facts) -> Markup {
    let stages = &facts.stages;
    html! {
        section {
            h2 { "Stages" }
            (section(StageId::Photos, stages.photos.as_ref(), photos))
            (section(StageId::Features, stages.features.as_ref(), features))
            (section(StageId::Poses, stages.poses.as_ref(), poses))
            (section(StageId::Lighting, stages.lighting.as_ref(), lighting))
            (section(StageId::Shading, stages.shading.as_ref(), shading))
            (section(StageId::Fusion, stages.fusion.as_ref(), fusion))
        }
        section {
            h2 { "This run" }
            dl {
                dt { "program" } dd { (facts.program) }
                dt { "threads" } dd { (facts.threads.map_or(ABSENT.to_owned(), |n| n.to_string())) }
                dt { "peak memory" } dd { (megabytes(facts.peak_memory_bytes)) }
                @if let (Some(expected), Some(cost)) = (&facts.expected, &facts.cost) {
                    dt { "cost, and what was expected" }
                    dd { (compared(expected, cost)) }
                }
                dt { "citation" } dd { (facts.citation) }
            }
            (folded("What was asked for", false, &json(&facts.request)))
        }
    }
}

/// What the run did cost beside what it was expected to.
fn compared(expected: &Estimate, cost: &Cost) -> String {
    let gigabytes = |bytes: f64| format!("{:.2} GB", 1e-9 * bytes);
    format!(
        "{:.0} CPU s ({:.0} to {:.0}), {} of memory ({}), {} on disk ({})",
        cost.cpu_seconds,
        expected.least_cpu_seconds,
        expected.cost.cpu_seconds,
        gigabytes(cost.peak_memory_bytes),
        gigabytes(expected.cost.peak_memory_bytes),
        gigabytes(cost.disk_bytes),
        gigabytes(expected.cost.disk_bytes),
    )
}

fn megabytes(bytes: Option<u64>) -> String {
    bytes.map_or(ABSENT.to_owned(), |bytes| {
        format!("{:.0} MB", bytes as f64 / 1e6)
    })
}

fn section<R>(id: StageId, stage: Option<&Stage<R>>, tables: fn(&R) -> Markup) -> Markup {
    let Some(stage) = stage else {
        return Markup::default();
    };
    let title = format!("{id}, {} s", number(stage.made.seconds(), 1));
    let content = html! { (tables(&stage.report)) (settings(&stage.made)) };
    folded(&title, false, &content)
}

fn settings(made: &Made) -> Markup {
    let ingredients = made.ingredients();
    let content = html! {
        p { "fingerprint " code { (made.fingerprint()) } }
        (json(&ingredients.options))
        (json(&ingredients.inputs))
    };
    folded("Options, inputs and fingerprint", false, &content)
}

fn photos(facts: &PhotosReport) -> Markup {
    let used: Vec<_> = facts
        .photos
        .iter()
        .map(|photo| {
            vec![
                photo.file_name.clone(),
                format!("{} x {}", photo.width, photo.height),
                format!("{:.0} px", photo.intrinsics.fx),
                photo.focal_note.clone(),
                word(&photo.encoding),
                percent(photo.mask_coverage, 1),
                percent(photo.clipped_share_on_object, 2),
                percent(photo.clipped_share, 2),
                number(photo.noise_sigma, 4),
            ]
        })
        .collect();
    let head = [
        "photo",
        "size",
        "focal",
        "focal from",
        "encoding",
        "mask",
        "clipped on the object",
        "in the photo",
        "noise",
    ];
    let rejected: Vec<_> = facts
        .rejected
        .iter()
        .map(|photo| vec![photo.file.clone(), photo.reason.clone()])
        .collect();
    html! {
        (table("Photos that are used", &head, &used))
        (table("Photos that are not used", &["file", "why"], &rejected))
    }
}

fn features(facts: &FeaturesReport) -> Markup {
    let rows: Vec<_> = facts
        .photos
        .iter()
        .map(|photo| {
            vec![
                photo.file_name.clone(),
                photo.num_keypoints.to_string(),
                photo.num_on_object.to_string(),
                photo.num_pairs.to_string(),
            ]
        })
        .collect();
    let head = ["photo", "keypoints", "on the object", "pairs matched"];
    html! {
        (table("Keypoints", &head, &rows))
        @if facts.photos.len() <= MAX_MATRIX { (matrix(facts)) }
    }
}

/// Verified matches of all pairs.
fn matrix(facts: &FeaturesReport) -> Markup {
    let num_photos = facts.photos.len();
    let mut head = vec!["verified matches".to_owned()];
    head.extend((1..=num_photos).map(|n| n.to_string()));
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    let verified = |a: usize, b: usize| {
        let is_it = |pair: &&PairReport| (pair.first.0, pair.second.0) == (a.min(b), a.max(b));
        let found = facts.pairs.iter().find(is_it);
        found.map_or(String::new(), |pair| pair.num_verified.to_string())
    };
    let rows: Vec<Vec<String>> = facts
        .photos
        .iter()
        .enumerate()
        .map(|(a, photo)| {
            let mut row = vec![format!("{}  {}", a + 1, photo.file_name)];
            row.extend((0..num_photos).map(|b| verified(a, b)));
            row
        })
        .collect();
    table("Matches between photos", &head, &rows)
}

fn poses(facts: &PosesReport) -> Markup {
    let rows: Vec<_> = facts
        .views
        .iter()
        .map(|view| {
            vec![
                view.file_name.clone(),
                view.num_points.to_string(),
                number(view.mean_error_px, 3),
                number(view.rotation_sigma_deg, 4),
                number(view.center_sigma, 6),
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
    let first_pair = facts.initial_pair.as_ref();
    let first_pair = first_pair.map(|(first, second)| format!("{first}, {second}"));
    html! {
        (table("Poses", &head, &rows))
        (anchors(facts))
        p {
            "scale: " (word(&facts.scale.unit)) " (" (word(&facts.scale.source))
            "), relative standard deviation " (percent(facts.scale.relative_sigma, 2)) "; "
            (facts.num_points) " points seen " (number(facts.mean_track_length, 1))
            " times on average; first pair " (text(first_pair.as_deref()))
        }
        // Which way is up.
        @if let Some(vertical) = &facts.vertical {
            p {
                "upwards in the world: " (format!("{:?}", vertical.up_in_world))
                ", told from the " (word(&vertical.source)) ", standard deviation "
                (number(vertical.sigma_deg, 2)) " deg"
            }
        }
        @if let Some(anchors) = &facts.anchors {
            p {
                (anchors.num_anchors) " anchors (" (word(&anchors.mode)) ") from "
                (anchors.num_patches) " patches: mean correlation "
                (number(anchors.mean_correlation, 3)) ", residual " (number(anchors.rms_residual, 4))
                " of ln intensity (RMS), deviations " (number(anchors.noise_factor, 1))
                " times those of independent residuals; all in "
                a href="3_poses/anchors.ply" { "anchors.ply" } " and "
                a href="3_poses/anchors.json" { "anchors.json" }
            }
        }
    }
}

fn anchors(facts: &PosesReport) -> Markup {
    let views = facts.anchors.iter().flat_map(|anchors| &anchors.views);
    let rows: Vec<_> = views
        .map(|view| {
            vec![
                view.file_name.clone(),
                view.num_anchors.to_string(),
                percent(view.coverage, 0),
                percent(view.median_sigma_ln_depth, 3),
            ]
        })
        .collect();
    let head = [
        "photo",
        "anchors",
        "object within 20 px of one",
        "depth sigma",
    ];
    table("Depth anchors", &head, &rows)
}

fn lighting(facts: &LightingReport) -> Markup {
    let rows: Vec<_> = facts
        .views
        .iter()
        .map(|view| {
            vec![
                view.name.clone(),
                view.num_pixels.to_string(),
                percent(view.relative_rms, 1),
                percent(view.clipped_share, 1),
                ratios(&view.gain),
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
    let direction = facts.dominant_direction.map(|d| ratios(&d));
    html! {
        @if facts.uncalibrated {
            p {
                strong { "Uncalibrated" }
                ": there was no sphere, file or shape. The light is fitted on the photos' own rough \
                 shape; brightness and albedo share one unknown factor, and where the shape is \
                 uncertain bumps and hollows may swap."
            }
        }
        @if facts.object.as_ref().is_some_and(|object| object.light_replaced) {
            p {
                "The sphere's light does not explain the object: the sphere stands in the object's shadow \
                 or in light that the object reflects. The light fitted on the object's own depth anchors \
                 takes its place."
            }
        }
        p {
            "light from: " (word(&facts.source)) "; fixed to: " (word(&facts.kind))
            "; most light comes from " (text(direction.as_deref()))
        }
        (table("Lighting", &head, &rows))
        (spheres(&facts.spheres))
    }
}

/// Why a view took no part, or a sphere of several in it.
fn left_out(view: &ViewLightReport) -> String {
    if view.unused_spheres.is_empty() {
        return text(view.left_out.as_deref());
    }
    view.unused_spheres.join("; ")
}

/// How several spheres agree on one light.
fn spheres(spheres: &[SphereLightReport]) -> Markup {
    if spheres.iter().all(|sphere| sphere.compared_with.is_none()) {
        return Markup::default();
    }
    let rows: Vec<_> = spheres
        .iter()
        .map(|sphere| {
            vec![
                sphere.name.clone(),
                sphere.num_pixels.to_string(),
                sphere.views.len().to_string(),
                text(sphere.compared_with.as_deref()),
                ratios(&sphere.brightness_ratio),
                percent(sphere.own_rms, 1),
                percent(sphere.other_rms, 1),
                number(sphere.direction_difference_deg, 1),
                if sphere.left_out { "yes" } else { "no" }.to_owned(),
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

/// Numbers, one per channel or axis.
fn ratios(values: &[f64]) -> String {
    let numbers: Vec<String> = values.iter().map(|&value| number(value, 2)).collect();
    if numbers.is_empty() {
        return ABSENT.to_owned();
    }
    numbers.join(", ")
}

fn shading(facts: &ShadingFacts) -> Markup {
    let light: Vec<_> = facts
        .light_on_surface
        .views
        .iter()
        .map(|view| {
            vec![
                view.name.clone(),
                percent(view.used_rms, 1),
                percent(view.used_rms_after_gain, 1),
                percent(view.refitted_rms, 1),
            ]
        })
        .collect();
    let head = [
        "view",
        "re-rendered",
        "after the best gain",
        "with the best distant light",
    ];
    let convergence: Vec<Markup> = facts
        .solver
        .paper
        .views
        .iter()
        .map(|view| {
            let records = &view.iterations;
            let column = |of: fn(&rilievo_shading::paper::IterationRecord) -> f64| -> Vec<f64> {
                records.iter().map(of).collect()
            };
            plot::logarithmic(
                &format!("Convergence of {}", view.name),
                &[
                    ("energy", column(|record| record.energy)),
                    ("primal residual", column(|record| record.primal_residual)),
                    ("dual residual", column(|record| record.dual_residual)),
                ],
            )
        })
        .collect();
    html! {
        (table("Photos and light, differences on the result", &head, &light))
        @if let Some(photo) = &facts.solver.photo { (trust(photo)) }
        @for plot in convergence { (plot) }
        p { "Everything that the solver tells stands in " a href="report.json" { "report.json" } "." }
    }
}

/// Where shading took part, and what photos that were left out said of it.
fn trust(facts: &PhotoReport) -> Markup {
    let rows: Vec<_> = facts
        .views
        .iter()
        .map(|view| {
            vec![
                view.name.clone(),
                number(view.gain[1], 3),
                percent(view.disagreement, 1),
                percent(view.seen_alone, 1),
                percent(view.light_residual, 1),
                percent(view.shading_trust, 0),
                percent(view.without_shading, 1),
                percent(view.specks[0], 3),
                percent(view.specks[1], 3),
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
        "specks as solved",
        "specks in the result",
    ];
    html! {
        p { (facts.shading) }
        @if let Some(validation) = &facts.validation {
            @let [without, with] = validation.squared_residual;
            p {
                "Photos that were left out: squared difference " (number(without, 6))
                " without shading, " (number(with, 6)) " with it, "
                (number(validation.significance, 1)) " standard deviations in its favour."
            }
        }
        @for note in &facts.notes { p { (note) } }
        (table("Agreement and shading", &head, &rows))
    }
}

fn fusion(facts: &FusionReport) -> Markup {
    let rows: Vec<_> = facts
        .views
        .iter()
        .map(|view| {
            let counts = [
                view.num_depths,
                view.num_border,
                view.num_grazing,
                view.num_inconsistent,
                view.num_points,
            ];
            let counts = counts.iter().map(ToString::to_string);
            std::iter::once(view.name.clone()).chain(counts).collect()
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
    html! {
        (table("Fusion", &head, &rows))
        p {
            "distance between overlapping views (RMS, world's unit): "
            (number(facts.layering.rms, 6)) "; a pixel covers "
            (number(facts.layering.footprint, 6))
        }
        @if let Some(share) = facts.share_apart {
            p {
                "points more than three pixel footprints from the surfaces of most views that cover them (two walls in the \
                 place of one): " (number(100.0 * share, 2)) " % of " (facts.num_covered) " points that another view covers"
            }
        }
    }
}
