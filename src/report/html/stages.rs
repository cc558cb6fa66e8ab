//! What every stage found, in tables; settings, versions and hashes for those who repeat it.

use super::element::{Column, definitions, folded, grid, json, number, percent, table, text, word};
use super::plot;
use crate::cost::{Cost, Estimate};
use crate::pipeline::ShadingFacts;
use crate::report::facts::{Facts, Stage};
use maud::{Markup, html};
use rilievo_features::{FeaturesReport, PairReport, PhotoFeatures};
use rilievo_fusion::{FusionReport, ViewFusion};
use rilievo_lighting::{LightingReport, SphereLightReport, ViewLightReport};
use rilievo_photometry::surface_check::ViewSurfaceReport;
use rilievo_photos::{PhotoFacts, PhotosReport, RejectedPhoto};
use rilievo_poses::PosesReport;
use rilievo_scene::StageId;
use rilievo_shading::paper::IterationRecord;
use rilievo_shading::photo::{PhotoReport, PhotoViewReport};

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
            (definitions(this_run(facts)))
            (folded("What was asked for", false, &json(&facts.request)))
        }
    }
}

fn this_run(facts: &Facts) -> Vec<(&'static str, String)> {
    let memory = facts
        .peak_memory_bytes
        .map(|bytes| format!("{:.0} MB", 1e-6 * bytes as f64));
    let mut entries = vec![
        ("program", facts.program.to_owned()),
        ("threads", text(facts.threads)),
        ("peak memory", text(memory)),
    ];
    if let (Some(expected), Some(cost)) = (&facts.expected, &facts.cost) {
        entries.push(("cost, and what was expected", compared(expected, cost)));
    }
    entries.push(("citation", facts.citation.to_owned()));
    entries
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

fn section<R>(id: StageId, stage: Option<&Stage<R>>, tables: fn(&R) -> Markup) -> Markup {
    let Some(stage) = stage else {
        return Markup::default();
    };
    let manifest = &stage.manifest;
    let settings = html! {
        p { "fingerprint " code { (manifest.fingerprint) } }
        (json(&manifest.ingredients.options))
        (json(&manifest.ingredients.inputs))
    };
    let content = html! {
        (tables(&stage.report))
        (folded("Options, inputs and fingerprint", false, &settings))
    };
    folded(
        &format!("{id}, {} s", number(manifest.seconds, 1)),
        false,
        &content,
    )
}

fn photos(facts: &PhotosReport) -> Markup {
    let used: &[Column<'_, PhotoFacts>] = &[
        ("photo", &|p| p.file_name.clone()),
        ("size", &|p| format!("{} x {}", p.width, p.height)),
        ("focal", &|p| format!("{:.0} px", p.intrinsics.fx)),
        ("focal from", &|p| p.focal_note.clone()),
        ("encoding", &|p| word(&p.encoding)),
        ("mask", &|p| percent(p.mask_coverage, 1)),
        ("clipped on the object", &|p| {
            percent(p.clipped_share_on_object, 2)
        }),
        ("in the photo", &|p| percent(p.clipped_share, 2)),
        ("noise", &|p| number(p.noise_sigma, 4)),
    ];
    let rejected: &[Column<'_, RejectedPhoto>] = &[
        ("file", &|p| p.file.clone()),
        ("why", &|p| p.reason.clone()),
    ];
    html! {
        (table("Photos that are used", &facts.photos, used))
        (table("Photos that are not used", &facts.rejected, rejected))
    }
}

fn features(facts: &FeaturesReport) -> Markup {
    let columns: &[Column<'_, PhotoFeatures>] = &[
        ("photo", &|p| p.file_name.clone()),
        ("keypoints", &|p| p.num_keypoints.to_string()),
        ("on the object", &|p| p.num_on_object.to_string()),
        ("pairs matched", &|p| p.num_pairs.to_string()),
    ];
    html! {
        (table("Keypoints", &facts.photos, columns))
        @if facts.photos.len() <= MAX_MATRIX { (matrix(facts)) }
    }
}

/// Verified matches of all pairs.
fn matrix(facts: &FeaturesReport) -> Markup {
    let num_photos = facts.photos.len();
    let numbers = (1..=num_photos).map(|n| n.to_string());
    let head: Vec<String> = std::iter::once("verified matches".to_owned())
        .chain(numbers)
        .collect();
    let verified = |a: usize, b: usize| {
        let is_it = |pair: &&PairReport| (pair.first.0, pair.second.0) == (a.min(b), a.max(b));
        let found = facts.pairs.iter().find(is_it);
        found.map_or(String::new(), |pair| pair.num_verified.to_string())
    };
    let row = |(a, photo): (usize, &PhotoFeatures)| {
        let name = format!("{}  {}", a + 1, photo.file_name);
        std::iter::once(name)
            .chain((0..num_photos).map(|b| verified(a, b)))
            .collect()
    };
    let rows: Vec<Vec<String>> = facts.photos.iter().enumerate().map(row).collect();
    grid("Matches between photos", &head, &rows)
}

fn poses(facts: &PosesReport) -> Markup {
    let views: &[Column<'_, rilievo_poses::ViewReport>] = &[
        ("photo", &|v| v.file_name.clone()),
        ("points", &|v| v.num_points.to_string()),
        ("error, px", &|v| number(v.mean_error_px, 3)),
        ("rotation sigma, deg", &|v| number(v.rotation_sigma_deg, 4)),
        ("centre sigma", &|v| {
            text(
                v.center_sigma
                    .map(|sigma| facts.scale.unit.length(sigma, 3)),
            )
        }),
    ];
    let anchored = facts.anchors.iter().flat_map(|anchors| &anchors.views);
    let anchors = table(
        "Depth anchors",
        anchored,
        &[
            ("photo", &|v| v.file_name.clone()),
            ("anchors", &|v| v.num_anchors.to_string()),
            ("object within 20 px of one", &|v| percent(v.coverage, 0)),
            ("depth sigma", &|v| percent(v.median_sigma_ln_depth, 3)),
        ],
    );
    let first_pair = facts.initial_pair.as_ref();
    let first_pair = first_pair.map(|(first, second)| format!("{first}, {second}"));
    html! {
        (table("Poses", &facts.views, views))
        (anchors)
        p {
            "scale: " (word(&facts.scale.unit)) " (" (word(&facts.scale.source))
            "), relative standard deviation " (percent(facts.scale.relative_sigma, 2)) "; "
            (facts.num_points) " points seen " (number(facts.mean_track_length, 1))
            " times on average; first pair " (text(first_pair))
        }
        // Which way is up.
        @if let Some(vertical) = &facts.vertical {
            p {
                "upwards in the world: " (format!("{:?}", vertical.up_in_world))
                ", from the " (word(&vertical.source)) ", standard deviation "
                (number(vertical.sigma_deg, 2)) " deg"
            }
        }
        @if let Some(anchors) = &facts.anchors {
            p {
                (anchors.num_anchors) " anchors from " (anchors.num_patches) " patches: mean correlation "
                (number(anchors.mean_correlation, 3)) ", residual " (number(anchors.rms_residual, 4))
                " of ln intensity (RMS), deviations " (number(anchors.noise_factor, 1))
                " times those of independent residuals; all in "
                a href="3_poses/anchors.ply" { "anchors.ply" } " and "
                a href="3_poses/anchors.json" { "anchors.json" }
            }
        }
    }
}

fn lighting(facts: &LightingReport) -> Markup {
    let views: &[Column<'_, ViewLightReport>] = &[
        ("view", &|v| v.name.clone()),
        ("pixels", &|v| v.num_pixels.to_string()),
        ("residual", &|v| percent(v.relative_rms, 1)),
        ("clipped", &|v| percent(v.clipped_share, 1)),
        ("gain", &|v| ratios(&v.gain)),
        ("left out because", &left_out),
    ];
    let spheres: &[Column<'_, SphereLightReport>] = &[
        ("sphere", &|s| s.name.clone()),
        ("pixels", &|s| s.num_pixels.to_string()),
        ("photos", &|s| s.views.len().to_string()),
        ("compared with", &|s| text(s.compared_with.as_deref())),
        ("brightness over that one's", &|s| {
            ratios(&s.brightness_ratio)
        }),
        ("residual of its own light", &|s| percent(s.own_rms, 1)),
        ("of that one's light", &|s| percent(s.other_rms, 1)),
        ("directions apart, degrees", &|s| {
            number(s.direction_difference_deg, 1)
        }),
        ("left out", &|s| {
            if s.left_out { "yes" } else { "no" }.to_owned()
        }),
    ];
    // A single sphere is compared with none.
    let compared = facts
        .spheres
        .iter()
        .any(|sphere| sphere.compared_with.is_some());
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
            "; most light comes from " (text(direction))
        }
        (table("Lighting", &facts.views, views))
        @if compared { (table("Spheres", &facts.spheres, spheres)) }
    }
}

/// Why a view took no part, or a sphere of several in it.
fn left_out(view: &ViewLightReport) -> String {
    if view.unused_spheres.is_empty() {
        return text(view.left_out.as_deref());
    }
    view.unused_spheres.join("; ")
}

/// Numbers, one per channel or axis.
fn ratios(values: &[f64]) -> String {
    let numbers: Vec<String> = values.iter().map(|&value| number(value, 2)).collect();
    text((!numbers.is_empty()).then(|| numbers.join(", ")))
}

fn shading(facts: &ShadingFacts) -> Markup {
    let light: &[Column<'_, ViewSurfaceReport>] = &[
        ("view", &|v| v.name.clone()),
        ("re-rendered", &|v| percent(v.used_rms, 1)),
        ("after the best gain", &|v| {
            percent(v.used_rms_after_gain, 1)
        }),
        ("with the best distant light", &|v| {
            percent(v.refitted_rms, 1)
        }),
    ];
    let convergence = facts.solver.paper.views.iter().map(|view| {
        let column = |of: fn(&IterationRecord) -> f64| view.iterations.iter().map(of).collect();
        plot::logarithmic(
            &format!("Convergence of {}", view.name),
            &[
                ("energy", column(|record| record.energy)),
                ("primal residual", column(|record| record.primal_residual)),
                ("dual residual", column(|record| record.dual_residual)),
            ],
        )
    });
    html! {
        (table("Photos and light, differences on the result", &facts.light_on_surface.views, light))
        @if let Some(photo) = &facts.solver.photo { (trust(photo)) }
        @for plot in convergence { (plot) }
        p { "The whole report of the solver is in " a href="report.json" { "report.json" } "." }
    }
}

/// Where shading took part, and what photos that were left out said of it.
fn trust(facts: &PhotoReport) -> Markup {
    let columns: &[Column<'_, PhotoViewReport>] = &[
        ("view", &|v| v.name.clone()),
        ("exposure gain (green)", &|v| number(v.gain[1], 3)),
        ("disagreement with other photos", &|v| {
            percent(v.disagreement, 1)
        }),
        ("seen in this photo alone", &|v| percent(v.seen_alone, 1)),
        ("light misses the photo by", &|v| {
            percent(v.light_residual, 1)
        }),
        ("trust in shading", &|v| percent(v.shading_trust, 0)),
        ("where shading takes no part", &|v| {
            percent(v.without_shading, 1)
        }),
        ("specks as solved", &|v| percent(v.specks[0], 3)),
        ("specks in the result", &|v| percent(v.specks[1], 3)),
    ];
    html! {
        p {
            (facts.shading)
            @if let Some(distance) = facts.light_distance() {
                "; explained best by light from about " (number(distance, 3))
                " (world's unit) away, which makes one light serve all places and is no measurement of the room"
            }
        }
        @if let Some(validation) = &facts.validation {
            @let [without, with] = validation.squared_residual;
            p {
                "Photos that were left out: squared difference " (number(without, 6))
                " without shading, " (number(with, 6)) " with it, "
                (number(validation.significance, 1)) " standard deviations in its favour."
            }
        }
        @for note in &facts.notes { p { (note) } }
        (table("Agreement and shading", &facts.views, columns))
    }
}

fn fusion(facts: &FusionReport) -> Markup {
    let columns: &[Column<'_, ViewFusion>] = &[
        ("view", &|v| v.name.clone()),
        ("depths", &|v| v.num_depths.to_string()),
        ("at borders", &|v| v.num_border.to_string()),
        ("oblique", &|v| v.num_grazing.to_string()),
        ("inconsistent", &|v| v.num_inconsistent.to_string()),
        ("points given", &|v| v.num_points.to_string()),
    ];
    html! {
        (table("Fusion", &facts.views, columns))
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
