//! Measures how time and memory of pose estimation grow with the number of photos: `many_views [--views 32,64,128]
//! [--track-length 10] [--cone 20] [--keypoints 400] [--outliers 0.03] [--exif] [--from-truth] [--steps]`, on tracks that are simulated (rings
//! of cameras around an object, every point seen by its neighbours only); no photo is rendered and no anchors are sought.
//!
//! Printed per number of views: registered views, user seconds, wall seconds, peak memory, mean reprojection error,
//! and the largest errors of centres (share of the distance) and rotations against the truth; then the exponent that
//! the user time of the last sets grows with. `--exif`: the focal length is a guess of EXIF's, 3 % off. `--steps`:
//! the adjustments too. `--from-truth`: adjusted from the true poses, which shows what the observations allow.

#![allow(clippy::unwrap_used)]

#[path = "../tests/it/common/mod.rs"]
mod common;

use common::{RingsOptions, options, pose_errors, rings};
use rilievo_poses::GivenPoses;
use rilievo_scene::{FocalSource, Silent};
use std::collections::BTreeMap;
use std::time::Instant;

/// User seconds of this process so far.
fn user_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = stat.rsplit(')').next().unwrap_or("");
    let ticks = after.split_whitespace().nth(11);
    ticks
        .and_then(|t| t.parse::<f64>().ok())
        .unwrap_or(f64::NAN)
        / 100.0
}

/// Largest resident memory since the last reset, MiB.
fn peak_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM:"));
    let kib = line.and_then(|l| l.split_whitespace().nth(1)?.parse::<f64>().ok());
    kib.unwrap_or(f64::NAN) / 1024.0
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |flag: &str| {
        let at = args.iter().position(|a| a == flag)?;
        args.get(at + 1).cloned()
    };
    let number = |flag: &str, default: f64| value(flag).map_or(default, |v| v.parse().unwrap());
    let has = |flag: &str| args.iter().any(|a| a == flag);
    let counts = value("--views").unwrap_or("32,64,128,256,512,1000".into());
    println!(
        " views registered  user s  wall s  peak MiB  reprojection px  centre %  rotation deg"
    );
    let mut measured: Vec<(f64, f64)> = Vec::new();
    for num_views in counts.split(',').map(|n| n.parse::<usize>().unwrap()) {
        let mut world = rings(&RingsOptions {
            num_views,
            num_keypoints: number("--keypoints", 400.0) as usize,
            track_length: number("--track-length", 10.0),
            cone_deg: number("--cone", 20.0),
            outlier_share: number("--outliers", 0.03),
            ..RingsOptions::default()
        });
        if has("--exif") {
            for photo in &mut world.photos.photos {
                photo.intrinsics.fx *= 1.03;
                photo.intrinsics.fy *= 1.03;
                photo.focal_source = FocalSource::Exif35mm;
            }
        }
        let mut chosen = options();
        if has("--from-truth") {
            for (photo, pose) in world.photos.photos.iter_mut().zip(&world.cam_from_world) {
                photo.given_cam_from_world = Some(*pose);
            }
            chosen.given_poses = GivenPoses::Refine;
        }
        // The kernel forgets the peak.
        let _ = std::fs::write("/proc/self/clear_refs", "5");
        let (user, clock) = (user_seconds(), Instant::now());
        let outcome = rilievo_poses::run(&world.photos, &world.matches, None, &chosen, &Silent);
        let (posed, report) = match outcome {
            Ok(found) => found,
            Err(error) => {
                println!("{num_views:6} {error}");
                continue;
            }
        };
        let (user, wall) = (user_seconds() - user, clock.elapsed().as_secs_f64());
        let (center, rotation) = pose_errors(&posed, &world.cam_from_world);
        println!(
            "{num_views:6} {:10} {user:7.2} {wall:7.2} {:9.0} {:16.4} {:9.4} {rotation:13.4}",
            posed.views.len(),
            peak_mib(),
            report.mean_reprojection_error_px,
            // The cameras stand 3.5 from the middle, and errors are shares of 3.
            100.0 * center * 3.0 / 3.5,
        );
        if has("--steps") {
            let mut steps: BTreeMap<&str, (usize, usize, usize)> = BTreeMap::new();
            for adjustment in &report.adjustments {
                let sum = steps.entry(&adjustment.step).or_default();
                sum.0 += 1;
                sum.1 += adjustment.solve.iterations.len();
                sum.2 += adjustment.num_observations;
            }
            for (step, (number, iterations, observations)) in steps {
                println!(
                    "       {step}: {number}, {iterations} iterations, {observations} observations in all"
                );
            }
        }
        measured.push((num_views as f64, user));
    }
    let last: Vec<(f64, f64)> = measured
        .iter()
        .filter(|m| m.0 >= 128.0 && m.1 > 0.0)
        .map(|m| (m.0.ln(), m.1.ln()))
        .collect();
    if last.len() >= 2 {
        let n = last.len() as f64;
        let mean = |f: &dyn Fn(&(f64, f64)) -> f64| last.iter().map(f).sum::<f64>() / n;
        let (x, y) = (mean(&|m| m.0), mean(&|m| m.1));
        let slope = mean(&|m| (m.0 - x) * (m.1 - y)) / mean(&|m| (m.0 - x).powi(2));
        println!("user time grows with the power {slope:.2} of the number of views, from 128 on");
    }
}
