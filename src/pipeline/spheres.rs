//! What the user says of the reference spheres: read, hashed, and looked at for slips of the unit.

use super::request::SphereInput;
use crate::exit::{Failure, Problem};
use crate::paths::text_of;
use crate::store::{hash_file, hash_json};
use rilievo_io::{SphereFile, SphereFileEntry, read_sphere_file};
use rilievo_photometry::sphere::{check_marked_points, outline_of_mark};
use rilievo_scene::{SphereMark, Unit};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// What was said of the reference spheres.
#[derive(Clone, Debug, Default)]
pub struct SphereInputs {
    /// The sphere file, with the radius that is used.
    pub file: Option<SphereFile>,
    /// Content hashes of its files, by role.
    pub hashes: BTreeMap<String, String>,
    /// What is odd about it.
    pub warnings: Vec<String>,
}

impl SphereInputs {
    /// Reads what a request says.
    ///
    /// # Errors
    /// When a file cannot be read or holds a value that cannot be used.
    pub fn scan(sphere: &SphereInput) -> Result<Self, Failure> {
        let mut inputs = Self::default();
        let Self {
            hashes, warnings, ..
        } = &mut inputs;
        match sphere {
            SphereInput::None => {}
            SphereInput::Auto { radius } => {
                hashes.insert("sphere search".into(), hash_json(radius));
                warnings.extend(odd_radius("the sphere", *radius));
            }
            SphereInput::File { path, radius } => {
                let mut file = read_sphere_file(path)?;
                if let Some(radius) = radius {
                    let stated = file.replace_radius(*radius)?;
                    hashes.insert("sphere radius".into(), hash_json(radius));
                    if let Some(stated) = stated.filter(|stated| stated != radius) {
                        warnings.push(format!(
                            "--sphere-radius {radius} is used, not the radius {stated} of {}",
                            path.display()
                        ));
                    }
                }
                check_points(&file)?;
                for (mask, reason) in &file.left_out {
                    warnings.push(format!(
                        "{}: {reason}: it is left out, the other marks go on",
                        mask.display()
                    ));
                }
                if file.unit == Unit::Metre {
                    let odd = |sphere: &SphereFileEntry| odd_radius(&sphere.name, sphere.radius);
                    warnings.extend(file.spheres.iter().filter_map(odd));
                }
                hashes.insert("sphere file".into(), hash_file(path)?);
                // By the paths that the file names: the whole may move.
                let folder = path.parent().unwrap_or(path);
                for named in &file.files {
                    let stated = named.strip_prefix(folder).unwrap_or(named);
                    let role = format!("sphere's {}", text_of(Some(stated.as_os_str())));
                    hashes.insert(role, hash_file(named)?);
                }
                inputs.file = Some(file);
            }
        }
        Ok(inputs)
    }
}

/// Refuses points that determine no outline: no other photo can make up for what a hand marked wrong.
fn check_points(file: &SphereFile) -> Result<(), Failure> {
    let beside = file.spheres.iter().flat_map(|sphere| {
        let views = sphere.views.iter();
        views.map(|(photo, mark)| {
            let of = format!(
                "{} in {photo} ({}views.{photo}.points)",
                sphere.name, sphere.key
            );
            (of, mark)
        })
    });
    let calibration = file.calibration.iter().enumerate();
    let calibration = calibration.filter_map(|(k, c)| {
        let mark = c.mark.as_ref()?;
        Some((format!("the sphere of calibration[{k}]"), mark))
    });
    let problems: Vec<Problem> = beside
        .chain(calibration)
        .filter(|(_, mark)| matches!(mark, SphereMark::Points(_)))
        .filter_map(|(of, mark)| {
            let error = check_marked_points(&outline_of_mark(mark)).err()?;
            Some(Problem {
                file: file.path.clone(),
                reason: format!("{of}: {error}"),
            })
        })
        .collect();
    if problems.is_empty() {
        Ok(())
    } else {
        Err(Failure::Input(problems))
    }
}

/// Radii of spheres that can stand beside an object on a table, metres.
const USUAL_RADII_M: RangeInclusive<f64> = 0.001..=1.0;

/// What to ask of a radius that is likely in another unit.
fn odd_radius(sphere: &str, radius: f64) -> Option<String> {
    (!USUAL_RADII_M.contains(&radius)).then(|| {
        format!("the radius of {sphere} is stated as {radius} m: is that number in metres?")
    })
}
