//! Measures anchors against true depth: `anchors DATA_SET [--views 3,4,5,6] [--linear]
//! [--options '{"mode": "guided"}'] [--truth-step METRES] [--dump FILE]
//! [--poses RUN/3_poses/posed_views.json]`, with the true poses or those of a run; photos and masks as the
//! data set holds them. `--truth-step`: depth of the truth is known to this step only.
//!
//! Printed per data set: anchors a view, share of the mask within 20 px of one, outliers (more than
//! 3 px in the nearest views or 1 % of depth), depth errors after one scale, and the ratio of the
//! 68th percentile of |error| to the predicted deviation in quintiles of the prediction.

use nalgebra::Point3;
use rilievo_io::{decode_photo, read_cameras, read_depth, read_mask};
use rilievo_poses::anchors::{AnchorOptions, find};
use rilievo_scene::{Photo, PhotoSet, PosedViews, Raster, Silent, ViewIdx};
use rilievo_synthetic::testing::{PosedPhotos, linear_of, photo};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;

type Failure = Box<dyn Error + Send + Sync>;

struct Truth {
    photos: PhotoSet,
    posed: PosedViews,
    depths: Vec<Raster<f32>>,
}

fn load(dir: &Path, wanted: &[usize], linear: bool) -> Result<Truth, Failure> {
    let cameras = read_cameras(&dir.join("truth/cameras.json"))?;
    let (mut taken, mut depths) = (PosedPhotos::default(), Vec::new());
    for camera in cameras.cameras {
        let file = camera.image.ok_or("no image")?;
        let name = file.rsplit_once('.').map_or(file.as_str(), |p| p.0);
        let digits: String = name.chars().filter(char::is_ascii_digit).collect();
        if !wanted.is_empty() && !wanted.contains(&digits.parse::<usize>()?) {
            continue;
        }
        let path = if linear {
            dir.join("linear").join(format!("{name}.png"))
        } else {
            dir.join("photos").join(&file)
        };
        let mask = read_mask(&dir.join("masks").join(format!("{name}.png")))?;
        let image = linear_of(&decode_photo(&path)?);
        let photo = Photo {
            mask: Some(Arc::new(mask.packed())),
            clip_level: 0.99,
            ..photo(&file, image, camera.intrinsics)
        };
        taken.push(photo, camera.cam_from_world.ok_or("no pose")?);
        let truth = dir.join("truth").join(format!("{name}_depth.exr"));
        depths.push(read_depth(&truth)?);
    }
    Ok(Truth {
        photos: taken.photos,
        posed: taken.posed,
        depths,
    })
}

/// Replaces the true poses by those of a run, matched by file name.
fn use_poses(truth: &mut Truth, run: &PosedViews) -> Result<(), Failure> {
    for view in &mut truth.posed.views {
        let found = run
            .views
            .iter()
            .find(|other| other.file_name == view.file_name)
            .ok_or_else(|| format!("no pose of {}", view.file_name))?;
        view.cam_from_world = found.cam_from_world;
        view.intrinsics = found.intrinsics;
    }
    if truth.posed.views.len() == run.views.len() {
        truth.posed.points = run.points.clone();
    }
    Ok(())
}

/// True depth at a sub-pixel position, bilinear away from depth edges.
fn true_depth(depth: &Raster<f32>, x: f64, y: f64) -> Option<f64> {
    let near = f64::from(*depth.get(x.round() as isize, y.round() as isize)?);
    if near <= 0.0 {
        return None;
    }
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let mut sum = 0.0;
    for (u, v, w) in [
        (0, 0, (1.0 - fx) * (1.0 - fy)),
        (1, 0, fx * (1.0 - fy)),
        (0, 1, (1.0 - fx) * fy),
        (1, 1, fx * fy),
    ] {
        let z = depth
            .get(x0 as isize + u, y0 as isize + v)
            .map_or(0.0, |&z| f64::from(z));
        if z <= 0.0 || (z / near - 1.0).abs() > 0.004 {
            return Some(near);
        }
        sum += w * z;
    }
    Some(sum)
}

fn percentile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values
        .get(((values.len().max(1) - 1) as f64 * share).round() as usize)
        .copied()
        .unwrap_or(f64::NAN)
}

/// User and system time of this process, seconds.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat
        .rsplit(')')
        .next()
        .unwrap_or("")
        .split_whitespace()
        .collect();
    let ticks = |k: usize| {
        fields
            .get(k)
            .and_then(|f| f.parse::<f64>().ok())
            .unwrap_or(0.0)
    };
    (ticks(11) + ticks(12)) / 100.0
}

struct Sample {
    view: usize,
    pixel: [f64; 2],
    ratio: Option<f64>,
    sigma: f64,
    px: f64,
}

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |flag: &str| {
        args.iter()
            .position(|a| a == flag)
            .and_then(|at| args.get(at + 1))
            .cloned()
    };
    let dir = args.first().ok_or("which data set?")?;
    let wanted: Vec<usize> = value("--views")
        .unwrap_or_default()
        .split(',')
        .filter_map(|v| v.parse().ok())
        .collect();
    let linear = args.iter().any(|a| a == "--linear");
    let mut truth = load(Path::new(dir), &wanted, linear)?;
    if let Some(path) = value("--poses") {
        use_poses(
            &mut truth,
            &serde_json::from_str(&std::fs::read_to_string(path)?)?,
        )?;
    }
    let options: AnchorOptions = serde_json::from_str(&value("--options").unwrap_or("{}".into()))?;
    let step: f64 = value("--truth-step").map_or(Ok(0.0), |v| v.parse())?;
    let before = cpu_seconds();
    let clock = std::time::Instant::now();
    let (anchors, report) = find(&truth.photos, &truth.posed, &options, None, &Silent)?;
    let cpu = cpu_seconds() - before;
    let wall = clock.elapsed().as_secs_f64();
    let views = &truth.posed.views;
    let mut ratios: Vec<f64> = anchors
        .iter()
        .flat_map(|anchor| &anchor.observations)
        .filter_map(|o| {
            Some(o.depth / true_depth(&truth.depths[o.view.0], o.pixel[0], o.pixel[1])?)
        })
        .collect();
    let scale = percentile(&mut ratios, 0.5);
    let mut samples = Vec::new();
    for anchor in &anchors {
        for o in &anchor.observations {
            let ViewIdx(v) = o.view;
            let z = true_depth(&truth.depths[v], o.pixel[0], o.pixel[1]);
            let at = |depth: f64| {
                let pixel = nalgebra::Point2::new(o.pixel[0], o.pixel[1]);
                let p = views[v].intrinsics.unproject(&pixel, depth);
                views[v].cam_from_world.inverse().apply(&p)
            };
            let mut px = f64::INFINITY;
            if let Some(z) = z {
                // Median over the three nearest views of the distance between true and found pixel.
                let (found, right) = (at(o.depth), at(z * scale));
                let own = views[v].cam_from_world.center_in_source();
                let mut near: Vec<(f64, f64)> = (0..views.len())
                    .filter(|&j| j != v)
                    .filter_map(|j| {
                        let center = views[j].cam_from_world.center_in_source();
                        let angle = (own - right).angle(&(center - right));
                        let project = |p: &Point3<f64>| {
                            views[j]
                                .intrinsics
                                .project(&views[j].cam_from_world.apply(p))
                        };
                        Some((angle, (project(&found)? - project(&right)?).norm()))
                    })
                    .collect();
                near.sort_by(|a, b| a.0.total_cmp(&b.0));
                near.truncate(3);
                let mut errors: Vec<f64> = near.iter().map(|n| n.1).collect();
                px = percentile(&mut errors, 0.5);
            }
            samples.push(Sample {
                view: v,
                pixel: o.pixel,
                ratio: z.map(|z| o.depth / z),
                sigma: z.map_or(o.sigma_ln_depth, |z| {
                    o.sigma_ln_depth.hypot(step / 12.0_f64.sqrt() / z)
                }),
                px,
            });
        }
    }
    let (mut num_bad, mut errors, mut scores) = (0, Vec::new(), Vec::new());
    for s in &samples {
        let error = s.ratio.map_or(f64::INFINITY, |r| r / scale - 1.0);
        if error.abs() > 0.01 || s.px > 3.0 {
            num_bad += 1;
        } else {
            errors.push(error.abs());
            scores.push((s.sigma, error.abs()));
        }
    }
    let coverage: Vec<f64> = report.views.iter().filter_map(|v| v.coverage).collect();
    let counts: Vec<usize> = (0..views.len())
        .map(|v| samples.iter().filter(|s| s.view == v).count())
        .collect();
    let mpx = truth.depths.iter().map(|d| d.data.len()).sum::<usize>() as f64 / 1e6;
    let median = percentile(&mut errors, 0.5);
    let p90 = percentile(&mut errors, 0.9);
    scores.sort_by(|a, b| a.0.total_cmp(&b.0));
    let quintiles: Vec<String> = scores
        .chunks(scores.len().div_ceil(5).max(1))
        .map(|chunk| {
            let mut z: Vec<f64> = chunk.iter().map(|s| s.1 / s.0).collect();
            format!("{:.2}", percentile(&mut z, 0.6827))
        })
        .collect();
    println!(
        "{}: {} anchors (noise factor {:.1}), per view {:.0} {counts:?}, coverage {:.3}, outliers {:.2} %, depth {:.4}/{:.4} %, scale {:.5}, error/sigma [{}], cpu {cpu:.2} s = {:.2} s/Mpx/view, wall {wall:.2} s",
        dir.rsplit('/').next().unwrap_or(dir),
        anchors.len(),
        report.noise_factor.unwrap_or(f64::NAN),
        samples.len() as f64 / views.len() as f64,
        coverage.iter().sum::<f64>() / coverage.len().max(1) as f64,
        100.0 * f64::from(num_bad) / samples.len().max(1) as f64,
        100.0 * median,
        100.0 * p90,
        scale,
        quintiles.join(" "),
        cpu / mpx,
    );
    if let Some(path) = value("--dump") {
        let mut text = String::new();
        for s in &samples {
            text += &format!(
                "{} {} {} {} {} {}\n",
                s.view,
                s.pixel[0],
                s.pixel[1],
                s.ratio.map_or(9.0, |r| r / scale - 1.0),
                s.sigma,
                s.px
            );
        }
        std::fs::write(path, text)?;
    }
    Ok(())
}
