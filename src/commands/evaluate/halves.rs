//! `rilievo evaluate RUN --halves`: what relief a run resolves, found from its photos alone.

use crate::commands::stored::{check_upstream, stored_request};
use crate::observe::Console;
use crate::pipeline::{Context, Inputs, Plan, Resources, ShapedHalf, shaped_halves};
use crate::report;
use crate::store::RunDir;
use rilievo_scene::{StageId, Unit};
use rilievo_synthetic::compare::{
    Half, HalvesComparison, RESOLVED_CORRELATION, Resolved, compare_halves,
};
use std::path::Path;

/// Shapes both halves, compares them, and puts what they agree on into the run's report.
///
/// # Errors
/// When what stage 5 reads is not valid, there are too few views, or a half cannot be shaped.
pub(super) fn evaluate(root: &Path, json: bool) -> anyhow::Result<()> {
    // Progress goes to stderr: stdout carries the one result.
    let console = Console::new(false);
    let run = RunDir::open(root)?;
    let request = stored_request(&run)?;
    let inputs = Inputs::scan(&request)?;
    let plan = Plan::new(&request, &inputs);
    check_upstream(&run, &plan, StageId::Shading)?;
    let halves = shaped_halves(&Context {
        run: &run,
        request: &request,
        inputs: &inputs,
        resources: Resources::default(),
        console: &console,
    })?;
    let unit = halves[0].posed.scale.unit;
    let [first, second] = halves.each_ref().map(|half| Half {
        posed: &half.posed,
        shaded: &half.shaded,
    });
    let found = compare_halves(&first, &second);
    let names = halves.each_ref().map(names);
    let text = table(&names, &found, unit);
    if json {
        let mut value = serde_json::to_value(&found)?;
        value["halves"] = serde_json::json!(names);
        value["unit"] = unit.name().into();
        say!("{}", serde_json::to_string_pretty(&value)?)?;
    } else {
        say!("{}", text.trim_end())?;
    }
    if report::add_halves(root, &text, &found)? {
        tell!("the curve is in {}", root.join("report.html").display());
    }
    Ok(())
}

fn names(half: &ShapedHalf) -> Vec<&str> {
    let views = half.posed.views.iter();
    views.map(|view| view.name.as_str()).collect()
}

/// The numbers as a table for people.
fn table(names: &[Vec<&str>; 2], found: &HalvesComparison, unit: Unit) -> String {
    let mut text = format!(
        "halves: {} | {}\nrelief by wavelength            rms   corr of halves\n",
        names[0].join(", "),
        names[1].join(", ")
    );
    for band in &found.relief {
        text += &format!(
            "{:>24}  {:>9}   {:>14}\n",
            size(band.wavelength_px, band.wavelength, unit, true),
            format!("{:.2} deg", band.rms_deg),
            band.correlation
                .map_or("-".to_owned(), |c| format!("{c:.3}"))
        );
    }
    text += &match found.resolved {
        Resolved::DownTo {
            wavelength_px,
            wavelength,
        } => format!(
            "resolved relief: {}\n",
            size(wavelength_px, wavelength, unit, false)
        ),
        Resolved::AllBands {
            wavelength_px,
            wavelength,
        } => format!(
            "resolved relief: {} and finer\n",
            size(wavelength_px, wavelength, unit, false)
        ),
        Resolved::None if found.relief.is_empty() => {
            "resolved relief: unknown, the halves do not see the same places\n".to_owned()
        }
        Resolved::None => "resolved relief: none\n".to_owned(),
    };
    text + &format!(
        "This is the wavelength down to which the normals of the halves, each shaped alone, correlate by \
         {RESOLVED_CORRELATION} and more.\nWhat both take for relief alike, as pigment or an error of the light, \
         counts as relief: with the truth the result\ncorrelates less. Half of the photos resolve less than all.\n"
    )
}

/// A wavelength in pixels and in the world's unit.
fn size(px: f64, length: Option<f64>, unit: Unit, px_first: bool) -> String {
    match length.map(|length| unit.length(length, 2)) {
        Some(length) if px_first => format!("{px:.1} px ({length})"),
        Some(length) => format!("{length} ({px:.1} px)"),
        None => format!("{px:.1} px"),
    }
}
