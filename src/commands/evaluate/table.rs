//! An evaluation as a table for people.

use rilievo_scene::Unit;
use rilievo_synthetic::compare::{self, Evaluation, MapComparison, RegionError, ReliefBand};

/// The numbers as a table for people.
pub fn table(evaluation: &Evaluation) -> String {
    let unit = evaluation.unit;
    let length = |value: f64| unit.length(value, 3);
    let mut text = format!(
        "alignment: {} (scale {:.5}): {}\n",
        match evaluation.alignment {
            compare::Alignment::None => "none",
            compare::Alignment::Se3 => "se3",
            compare::Alignment::Sim3 => "sim3",
        },
        evaluation.scale,
        evaluation.alignment_reason
    );
    if let Some(poses) = &evaluation.poses {
        text += &format!(
            "poses: {} of {} cameras; centre error mean {}, max {}; rotation error mean \
             {:.4} deg, max {:.4} deg\n",
            poses.num_cameras,
            poses.num_cameras + poses.num_missing,
            length(poses.center_error_mean),
            length(poses.center_error_max),
            poses.rotation_error_mean_deg,
            poses.rotation_error_max_deg
        );
    }
    let width = evaluation
        .views
        .keys()
        .map(|name| name.chars().count())
        .fold("all".len(), usize::max);
    if !evaluation.views.is_empty() {
        text += &format!(
            "{:<width$}  complete   normals MAE  median   depth median      p90       RMSE\n",
            "view"
        );
    }
    for (name, view) in &evaluation.views {
        text += &row(name, view, width);
    }
    if let Some(all) = &evaluation.all {
        text += &row("all", all, width);
        text += &regions(&all.regions);
        text += &relief(&all.relief, unit);
    }
    if let Some(cloud) = &evaluation.cloud {
        text += &format!(
            "cloud: accuracy median {}; completeness {:.1} %, F {:.3} at {}\n",
            length(cloud.accuracy_median),
            100.0 * cloud.completeness,
            cloud.f_score,
            unit.length(cloud.threshold, 2)
        );
    }
    let appearance = &evaluation.appearance;
    if let (Some(angle), Some(rms)) = (appearance.light_direction_deg, appearance.light_rms_rel) {
        text += &format!(
            "light: direction {angle:.1} deg, irradiance {:.1} % up to one factor a view\n",
            100.0 * rms
        );
    }
    if let Some(rms) = appearance.albedo_rms_rel {
        text += &format!("albedo: {:.1} % up to one factor a channel\n", 100.0 * rms);
    }
    if let Some(rms) = appearance.rerender_rms_rel {
        text += &format!("re-rendered photos: {:.1} %\n", 100.0 * rms);
    }
    for mismatch in &evaluation.mismatches {
        text += &format!("warning: {mismatch}\n");
    }
    for (key, reason) in &evaluation.reasons {
        text += &format!("no {key}: {reason}\n");
    }
    text
}

/// Where the normals of all views err.
fn regions(regions: &[RegionError]) -> String {
    if regions.is_empty() {
        return String::new();
    }
    let mut text = "normals by region          share      MAE     adds\n".to_owned();
    for region in regions {
        let mean = region.normal_mae_deg;
        text += &format!(
            "{:>24}  {:>6}  {:>7}  {:>7}\n",
            region.region.label(),
            format!("{:.1} %", 100.0 * region.share),
            mean.map_or("-".to_owned(), |mean| format!("{mean:.2}")),
            format!("{:.2}", region.adds_deg)
        );
    }
    text
}

/// The relief of all views by wavelength.
fn relief(bands: &[ReliefBand], unit: Unit) -> String {
    if bands.is_empty() {
        return String::new();
    }
    let mut text = "relief by wavelength       true rms    corr    gain   corr^2\n".to_owned();
    let share = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.3}"));
    for band in bands {
        let size = band
            .wavelength
            .map_or(String::new(), |w| format!(" ({})", unit.length(w, 2)));
        text += &format!(
            "{:>24}  {:>9}  {:>6}  {:>6}   {:>6}\n",
            format!("{:.1} px{size}", band.wavelength_px),
            format!("{:.2} deg", band.true_rms_deg),
            share(band.correlation),
            share(band.gain),
            share(band.correlation.map(|c| c * c))
        );
    }
    text
}

fn row(name: &str, view: &MapComparison, width: usize) -> String {
    let cell = |value: Option<f64>, factor: f64, unit: &str, digits: usize| match value {
        Some(value) => format!("{:.digits$} {unit}", factor * value),
        None => "-".to_owned(),
    };
    format!(
        "{name:<width$}  {:>8}  {:>12}  {:>9}  {:>9}  {:>9}  {:>9}\n",
        cell(view.complete, 100.0, "%", 1),
        cell(view.normal_mae_deg, 1.0, "deg", 2),
        cell(view.normal_median_deg, 1.0, "deg", 2),
        cell(view.depth_median_rel, 100.0, "%", 3),
        cell(view.depth_p90_rel, 100.0, "%", 3),
        cell(view.depth_rms_rel, 100.0, "%", 3),
    )
}
