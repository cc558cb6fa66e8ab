//! `rilievo check PHOTOS`: the preflight alone, in seconds.

use super::reporting::reporting_found;
use crate::cli::CheckArgs;
use crate::config::{StageOptions, take_over};
use crate::cost::Estimate;
use crate::exit::Failure;
use crate::observe::Console;
use crate::pipeline::{Inputs, Request, Resources, SphereInput, check_photos, expect};
use rilievo_io::is_mark_of;
use rilievo_photos::PhotosReport;
use rilievo_scene::StageId;

/// Runs the command.
///
/// # Errors
/// [`Failure::Input`] with every file that cannot be used, after the good ones were reported on.
pub fn check(args: &CheckArgs) -> anyhow::Result<()> {
    reporting_found(&Console::new(args.work.json), |console| {
        let mut found = Found::default();
        let outcome = look(args, console, &mut found);
        let Found {
            report,
            warnings,
            expected,
        } = found;
        let facts =
            serde_json::json!({"report": report, "warnings": warnings, "expected": expected});
        (outcome, facts)
    })
}

/// What is known of the photos, whether all can be used or not.
#[derive(Default)]
struct Found {
    report: Option<PhotosReport>,
    warnings: Vec<String>,
    expected: Option<Estimate>,
}

fn look(args: &CheckArgs, console: &Console, found: &mut Found) -> anyhow::Result<()> {
    let mut options = StageOptions::read(args.config.config.as_deref())?;
    take_over(&mut options.photos.encoding, args.input.encoding.encoding);
    options.validate()?;
    let request = Request {
        recursive: args.input.recursive,
        masks: args.masks.clone(),
        cameras: args.input.cameras.clone(),
        sphere: SphereInput::from_args(&args.sphere)?,
        ..Request::of_photos(args.input.photos.clone(), options)
    };
    let inputs = Inputs::scan(&request)?;
    for problem in &inputs.skipped {
        console.note(&format!("  {problem}"));
    }
    let mut of_files = inputs.warnings.clone();
    of_files.extend(inputs.spheres.warnings.iter().cloned());
    of_files.extend(spheres(&inputs, console));
    for warning in &of_files {
        console.note(&format!("  warning: {warning}"));
    }
    found.warnings = of_files;
    let resources = Resources::new(&args.work);
    let (report, warnings, problems) = check_photos(&request, &inputs, resources, console)?;
    for line in report.table(&warnings).to_string().lines() {
        console.note(&format!("  {line}"));
    }
    let usable = report.photos.len();
    found.report = Some(report);
    found.warnings.extend(warnings);
    found.expected = expect(&request, &inputs, resources, StageId::Fusion, console);
    if problems.is_empty() {
        console.note(&format!("all {usable} photos can be used"));
        return Ok(());
    }
    console.note(&format!(
        "{usable} photos can be used, {} cannot",
        problems.len()
    ));
    Err(Failure::Input(problems).into())
}

/// Reports in how many of the photos each sphere is marked; returns what is wrong with that.
fn spheres(inputs: &Inputs, console: &Console) -> Vec<String> {
    let mut warnings = Vec::new();
    for sphere in inputs.spheres.file.iter().flat_map(|file| &file.spheres) {
        let is_there = |name: &&String| {
            let mut photos = inputs.photos.iter();
            photos.any(|photo| is_mark_of(name, &photo.file_name, &photo.name))
        };
        let marks = sphere.views.iter().map(|(photo, _)| photo);
        let (known, unknown): (Vec<_>, Vec<_>) = marks.partition(is_there);
        console.note(&format!(
            "  {}: radius {}, marked in {} of {} photos",
            sphere.name,
            sphere.radius,
            known.len(),
            inputs.photos.len()
        ));
        if let Some(photo) = unknown.first() {
            warnings.push(format!(
                "{} is marked in {photo}, which is not among the photos",
                sphere.name
            ));
        }
        if known.len() < 2 && sphere.center.is_none() {
            warnings.push(format!(
                "{} is marked in fewer than two of the photos: its place and the size cannot be told",
                sphere.name
            ));
        }
    }
    warnings
}
