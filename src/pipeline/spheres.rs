//! What the user says of the reference spheres: read, hashed, and looked at for slips of the unit.

use super::errors::from_io;
use super::request::SphereInput;
use crate::exit::Failure;
use crate::paths::text_of;
use crate::store::{hash_file, hash_json};
use rilievo_io::{SphereFile, SphereFileEntry, read_sphere_file};
use rilievo_scene::Unit;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// What was said of the reference spheres.
#[derive(Default)]
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
                let mut file = read_sphere_file(path).map_err(from_io)?;
                if let Some(radius) = radius {
                    let stated = file.replace_radius(*radius).map_err(from_io)?;
                    hashes.insert("sphere radius".into(), hash_json(radius));
                    if let Some(stated) = stated.filter(|stated| stated != radius) {
                        warnings.push(format!(
                            "--sphere-radius {radius} is used, not the radius {stated} of {}",
                            path.display()
                        ));
                    }
                }
                if file.unit == Unit::Metre {
                    let odd = |sphere: &SphereFileEntry| odd_radius(&sphere.name, sphere.radius);
                    warnings.extend(file.spheres.iter().filter_map(odd));
                }
                hashes.insert("sphere file".into(), hash_file(path).map_err(from_io)?);
                // By the paths that the file gives them: the whole may move.
                let folder = path.parent().unwrap_or(path);
                for named in &file.files {
                    let stated = named.strip_prefix(folder).unwrap_or(named);
                    let role = format!("sphere's {}", text_of(Some(stated.as_os_str())));
                    hashes.insert(role, hash_file(named).map_err(from_io)?);
                }
                inputs.file = Some(file);
            }
        }
        Ok(inputs)
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
