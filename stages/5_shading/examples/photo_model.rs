//! Runs the photo model on a folder with ground truth, cameras given, and prints its accuracy.
//!
//! `cargo run --release -p rilievo-shading --example photo_model -- FOLDER [OUT] [NAME...]`

use nalgebra::{Matrix3, Point3, Rotation3};
use rilievo_scene::{
    DepthMap, FocalSource, InMemoryPixels, Intrinsics, LightKind, LightSource, LightingCalibration,
    LinearImage, LocatedSphere, NormalMap, Photo, PhotoIdx, PhotoSet, PosedView, PosedViews,
    Raster, RigidTransform, ShadedViews, Silent, SparsePoint,
};
use rilievo_shading::photo::{self, PhotoOptions};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

struct Input {
    photos: PhotoSet,
    posed: PosedViews,
    truth: Vec<(DepthMap, Option<NormalMap>)>,
}

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    match value {
        serde_json::Value::Array(items) => items.iter().flat_map(numbers).collect(),
        other => other.as_f64().into_iter().collect(),
    }
}

fn linear(path: &Path) -> Result<LinearImage, Box<dyn Error>> {
    let image = image::open(path)?;
    let sixteen = matches!(
        image.color(),
        image::ColorType::Rgb16 | image::ColorType::L16
    );
    let rgb = image.to_rgb16();
    let data = rgb
        .as_raw()
        .iter()
        .map(|&v| {
            let v = f32::from(v) / 65535.0;
            if sixteen {
                v
            } else {
                rilievo_scene::srgb::decode(f64::from(v)) as f32
            }
        })
        .collect();
    Ok(LinearImage {
        width: rgb.width() as usize,
        height: rgb.height() as usize,
        channels: 3,
        data,
    })
}

fn find_file(folder: &Path, stem: &str) -> Option<PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .ok()?
        .flatten()
        .map(|e| e.path())
        .collect();
    files.sort();
    files
        .into_iter()
        .find(|p| p.file_stem().is_some_and(|s| s == stem))
}

fn load(folder: &Path, names: &[String]) -> Result<Input, Box<dyn Error>> {
    let cameras: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("truth/cameras.json"))?)?;
    let mut input = Input {
        photos: PhotoSet::default(),
        posed: PosedViews::default(),
        truth: Vec::new(),
    };
    for camera in cameras["cameras"].as_array().into_iter().flatten() {
        let file_name = camera["image"].as_str().unwrap_or_default().to_owned();
        let name = file_name
            .rsplit_once('.')
            .map_or(file_name.as_str(), |p| p.0)
            .to_owned();
        if !names.is_empty() && !names.contains(&name) {
            continue;
        }
        let path = find_file(
            &folder.join(std::env::var("PHOTO_DIR").unwrap_or_else(|_| "photos".to_owned())),
            &name,
        )
        .ok_or("photo missing")?;
        let image = linear(&path)?;
        let mask =
            rilievo_io::read_mask(&find_file(&folder.join("masks"), &name).ok_or("mask missing")?)?;
        let k = numbers(&camera["K"]);
        let mut intrinsics = Intrinsics::pinhole(image.width, image.height, k[0], k[2], k[5]);
        intrinsics.fy = k[4];
        let rotation = Matrix3::from_row_slice(&numbers(&camera["world_from_camera_rotation"]));
        let center = numbers(&camera["camera_center"]);
        let index = PhotoIdx(input.photos.photos.len());
        input.photos.photos.push(Photo {
            file_name: file_name.clone(),
            name: name.clone(),
            pixels: Arc::new(InMemoryPixels(Arc::new(image))),
            intrinsics,
            focal_source: FocalSource::CameraFile,
            camera_group: 0,
            orientation: 1,
            mask: Some(Arc::new(mask)),
            clip_level: 0.98,
            given_cam_from_world: None,
        });
        input.posed.views.push(PosedView {
            photo: index,
            name: name.clone(),
            file_name,
            intrinsics,
            cam_from_world: RigidTransform::from_world_pose(
                Rotation3::from_matrix_unchecked(rotation),
                Point3::new(center[0], center[1], center[2]),
            ),
        });
        let truth = folder.join("truth");
        input.truth.push((
            rilievo_io::read_depth(&truth.join(format!("{name}_depth.exr")))?,
            rilievo_io::read_normal(&truth.join(format!("{name}_normal.exr"))).ok(),
        ));
    }
    if let Some(radius) = cameras["sphere"]["radius"].as_f64() {
        let c = numbers(&cameras["sphere"]["center"]);
        input.posed.sphere = Some(LocatedSphere {
            center_in_world: [c[0], c[1], c[2]],
            radius,
            center_sigma: [0.0; 3],
            seen_in: (0..input.photos.photos.len())
                .map(|i| (PhotoIdx(i), 0.5))
                .collect(),
        });
        // The mat under the object, as sparse points of a pose run would show it.
        for i in 0..400 {
            let (a, b) = ((i % 20) as f64 / 19.0 - 0.5, (i / 20) as f64 / 19.0 - 0.5);
            input.posed.points.push(SparsePoint {
                position: [a, 0.0, b],
                color: [128; 3],
                error_px: 0.3,
                track: Vec::new(),
            });
        }
    }
    Ok(input)
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    rilievo_numerics::robust::quantile(values, share).unwrap_or(f64::NAN)
}

/// Normals of planes fitted to the points of a window, for references without normals of their own.
fn plane_normals(depth: &DepthMap, k: &Intrinsics, half: isize) -> Raster<[f32; 3]> {
    use rayon::prelude::*;
    let rows: Vec<Vec<[f32; 3]>> = (0..depth.height as isize)
        .into_par_iter()
        .map(|y| {
            (0..depth.width as isize)
                .map(|x| {
                    if *depth.at(x as usize, y as usize) <= 0.0 {
                        return [0.0; 3];
                    }
                    let (mut sum, mut square, mut count) =
                        (nalgebra::Vector3::zeros(), Matrix3::zeros(), 0.0);
                    for dy in -half..=half {
                        for dx in -half..=half {
                            if let Some(&z) = depth.get(x + dx, y + dy)
                                && z > 0.0
                            {
                                let p = nalgebra::Vector3::new(
                                    ((x + dx) as f64 - k.cx) / k.fx,
                                    ((y + dy) as f64 - k.cy) / k.fy,
                                    1.0,
                                ) * f64::from(z);
                                sum += p;
                                square += p * p.transpose();
                                count += 1.0;
                            }
                        }
                    }
                    if count < ((2 * half + 1) * (2 * half + 1)) as f64 * 0.7 {
                        return [0.0; 3];
                    }
                    let mean = sum / count;
                    let eigen = (square / count - mean * mean.transpose()).symmetric_eigen();
                    let n = eigen
                        .eigenvectors
                        .column(eigen.eigenvalues.imin())
                        .into_owned();
                    let n = if n.dot(&mean) > 0.0 { -n } else { n };
                    [n.x as f32, n.y as f32, n.z as f32]
                })
                .collect()
        })
        .collect();
    Raster {
        width: depth.width,
        height: depth.height,
        data: rows.concat(),
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = PathBuf::from(arguments.first().ok_or("give a folder")?);
    let out = arguments.get(1).map(PathBuf::from);
    let names = arguments.get(2..).unwrap_or_default();
    let input = load(&folder, names)?;
    let lighting = LightingCalibration {
        source: LightSource::OwnShape,
        kind: LightKind::World,
        environment_in_world: None,
        views: Vec::new(),
    };
    let options = match std::env::var("PHOTO_OPTIONS") {
        Ok(json) => serde_json::from_str(&json)?,
        Err(_) => PhotoOptions::default(),
    };
    let began = std::time::Instant::now();
    let probe = |step: &str, shaded: &ShadedViews| {
        if let Ok(summary) = evaluate(&input, shaded, None) {
            println!("    {step:24} {summary}");
        }
    };
    let (shaded, report) = if std::env::var("PROBE").is_ok() {
        photo::run_probed(
            &input.photos,
            &input.posed,
            &lighting,
            &options,
            &Silent,
            &probe,
        )?
    } else {
        photo::run(&input.photos, &input.posed, &lighting, &options, &Silent)?
    };
    let wall = began.elapsed().as_secs_f64();
    for lap in &report.laps {
        println!(
            "  level {} {:28} rounds {} change {:.3} sigma_s {:.4} match {:.4}  {:.1} s",
            lap.level,
            lap.kind,
            lap.num_rounds,
            lap.last_change,
            lap.sigma_shading,
            lap.match_residual,
            lap.seconds
        );
    }
    println!(
        "  disagreement {:.4}, sigma_match {:.4}; {}; {:?}",
        report.disagreement, report.sigma_match, report.shading, report.notes
    );
    for (view, facts) in shaded.views.iter().zip(&report.views) {
        println!(
            "  {:14} gain {:.3} {:.3} {:.3} disagree {:.3} confirmed {:.3} alone {:.3} light {:.4}",
            view.name,
            facts.gain[0],
            facts.gain[1],
            facts.gain[2],
            facts.disagreement,
            facts.confirmed,
            facts.seen_alone,
            facts.light_residual.unwrap_or(f64::NAN)
        );
    }
    let summary = evaluate(&input, &shaded, out.as_deref())?;
    println!("ALL {summary}  wall {wall:.1} s");
    Ok(())
}

/// Errors over the whole truth mask: a pixel without a normal counts as 90°.
fn evaluate(
    input: &Input,
    shaded: &ShadedViews,
    out: Option<&Path>,
) -> Result<String, Box<dyn Error>> {
    let (mut angles, mut ratios, mut missing) = (Vec::new(), Vec::new(), 0usize);
    let (mut rim, mut inner) = (Vec::new(), Vec::new());
    let mut means = String::new();
    for (i, view) in shaded.views.iter().enumerate() {
        let (depth, normal) = &input.truth[i];
        let k = &input.posed.views[i].intrinsics;
        let planes = normal.is_none().then(|| {
            (
                plane_normals(depth, k, 10),
                plane_normals(&view.depth, k, 10),
            )
        });
        let (reference, estimate) = match (normal, &planes) {
            (Some(n), _) => (n, &view.normal),
            (None, Some((a, b))) => (a, b),
            (None, None) => continue,
        };
        let mut error = Raster::filled(depth.width, depth.height, -1.0_f32);
        let mut own = Vec::new();
        let band = near_edges(depth, k.fx);
        for p in 0..depth.data.len() {
            if depth.data[p] <= 0.0 {
                continue;
            }
            if view.depth.data[p] > 0.0 {
                ratios.push(f64::from(view.depth.data[p] / depth.data[p]));
            } else {
                missing += 1;
            }
            let (a, b) = (reference.data[p], estimate.data[p]);
            if a == [0.0; 3] || (b == [0.0; 3] && planes.is_some()) {
                continue;
            }
            let dot: f64 = (0..3).map(|c| f64::from(a[c]) * f64::from(b[c])).sum();
            let angle = if b == [0.0; 3] {
                90.0
            } else {
                dot.clamp(-1.0, 1.0).acos().to_degrees()
            };
            error.data[p] = angle as f32;
            own.push(angle);
            if b != [0.0; 3] {
                if band.data[p] {
                    rim.push(angle)
                } else {
                    inner.push(angle)
                }
            }
        }
        let mean = own.iter().sum::<f64>() / own.len().max(1) as f64;
        means += &format!(" {mean:.2}");
        angles.extend(own);
        if let Some(out) = out {
            std::fs::create_dir_all(out)?;
            picture(out, &view.name, &error, &view.normal, &view.depth, depth)?;
        }
    }
    let scale = quantile(&mut ratios, 0.5);
    let mut errors: Vec<f64> = ratios
        .iter()
        .map(|r| 100.0 * (r / scale - 1.0).abs())
        .collect();
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    Ok(format!(
        "normals {:.2} / {:.2} deg (rim {:.2}, inner {:.2})  depth {:.3} / {:.3} %  complete {:.4} |{means}",
        mean(&angles),
        quantile(&mut angles, 0.5),
        mean(&rim),
        mean(&inner),
        quantile(&mut errors, 0.5),
        quantile(&mut errors, 0.9),
        1.0 - missing as f64 / (missing + ratios.len()) as f64,
    ))
}

/// Pixels within five of the mask's border or of a depth edge.
fn near_edges(depth: &DepthMap, focal: f64) -> Raster<bool> {
    let edge = |x: isize, y: isize| {
        let Some(&z) = depth.get(x, y) else {
            return true;
        };
        [(1, 0), (0, 1)]
            .iter()
            .any(|&(dx, dy)| match depth.get(x + dx, y + dy) {
                Some(&other) if other > 0.0 && z > 0.0 => {
                    (f64::from(other / z) - 1.0).abs() * focal > 6.0
                }
                _ => true,
            })
    };
    let edges = Raster::from_fn(depth.width, depth.height, |x, y| {
        edge(x as isize, y as isize)
    });
    let wide = Raster::from_fn(depth.width, depth.height, |x, y| {
        (x.saturating_sub(5)..=(x + 5).min(depth.width - 1)).any(|a| *edges.at(a, y))
    });
    Raster::from_fn(depth.width, depth.height, |x, y| {
        (y.saturating_sub(5)..=(y + 5).min(depth.height - 1)).any(|b| *wide.at(x, b))
    })
}

/// Normal error (0 to 30° from black to white) beside the normals and the relative depth error.
fn picture(
    out: &Path,
    name: &str,
    error: &Raster<f32>,
    normal: &NormalMap,
    depth: &DepthMap,
    truth: &DepthMap,
) -> Result<(), Box<dyn Error>> {
    let (w, h) = (error.width, error.height);
    let mut rgb = image::RgbImage::new(3 * w as u32, h as u32);
    for y in 0..h {
        for x in 0..w {
            let e = *error.at(x, y);
            let grey = if e < 0.0 {
                90
            } else {
                (e * 8.5).min(255.0) as u8
            };
            rgb.put_pixel(
                x as u32,
                y as u32,
                image::Rgb([grey, grey, if e < 0.0 { 140 } else { grey }]),
            );
            let n = *normal.at(x, y);
            let colour = [n[0], -n[1], -n[2]].map(|v| ((v * 0.5 + 0.5) * 255.0) as u8);
            rgb.put_pixel((x + w) as u32, y as u32, image::Rgb(colour));
            let d = if *truth.at(x, y) > 0.0 {
                (128.0 + 2e4 * (*depth.at(x, y) / *truth.at(x, y) - 1.0)).clamp(0.0, 255.0) as u8
            } else {
                0
            };
            rgb.put_pixel((x + 2 * w) as u32, y as u32, image::Rgb([d; 3]));
        }
    }
    rgb.save(out.join(format!("{name}.png")))?;
    Ok(())
}
