//! Pose estimation on simulated tracks: rings of cameras around an object, every point seen by its
//! neighbours only; no photo is rendered and no anchors are sought.
//!
//! Printed per number of views: registered views, CPU seconds, wall seconds, peak memory, mean
//! reprojection error, and the largest errors of centres (share of the distance) and rotations
//! against the truth.

use crate::growth::exponent;
use crate::rings::{RingsOptions, options, pose_errors, rings};
use crate::{Failure, system};
use rilievo_poses::GivenPoses;
use rilievo_scene::{FocalSource, Silent};
use std::time::Instant;

#[derive(clap::Args)]
pub struct Arguments {
    /// Numbers of views
    #[arg(long, value_delimiter = ',', default_values_t = [32, 64, 128, 256, 512, 1000])]
    views: Vec<usize>,
    /// The focal length is a guess of EXIF's, 3 % off
    #[arg(long)]
    exif: bool,
    /// Starts from the true poses: what the observations allow
    #[arg(long)]
    from_truth: bool,
}

pub fn measure(arguments: &Arguments) -> Result<(), Failure> {
    println!(
        " views registered   CPU s  wall s  peak MiB  reprojection px  centre %  rotation deg"
    );
    let mut measured = Vec::new();
    for &num_views in &arguments.views {
        let mut world = rings(&RingsOptions {
            num_views,
            ..RingsOptions::default()
        });
        let mut chosen = options();
        for (photo, pose) in world.photos.photos.iter_mut().zip(&world.cam_from_world) {
            if arguments.exif {
                photo.intrinsics.fx *= 1.03;
                photo.intrinsics.fy *= 1.03;
                photo.focal_source = FocalSource::Exif35mm;
            }
            if arguments.from_truth {
                photo.given_cam_from_world = Some(*pose);
                chosen.given_poses = GivenPoses::Refine;
            }
        }
        system::forget_peak_memory();
        let (cpu, clock) = (system::cpu_seconds(), Instant::now());
        let outcome = rilievo_poses::run(&world.photos, &world.matches, None, &chosen, &Silent);
        let (posed, report) = match outcome {
            Ok(found) => found,
            Err(error) => {
                println!("{num_views:6} {error}");
                continue;
            }
        };
        let (cpu, wall) = (system::cpu_seconds() - cpu, clock.elapsed().as_secs_f64());
        let (center, rotation) = pose_errors(&posed, &world.cam_from_world);
        println!(
            "{num_views:6} {:10} {cpu:7.2} {wall:7.2} {:9.0} {:16.4} {:9.4} {rotation:13.4}",
            posed.views.len(),
            system::peak_memory().map_or(f64::NAN, |bytes| bytes as f64 / 1048576.0),
            report.mean_reprojection_error_px,
            // The cameras stand 3.5 from the middle, and errors are shares of 3.
            100.0 * center * 3.0 / 3.5,
        );
        measured.push((num_views, cpu));
    }
    measured.retain(|(num_views, _)| *num_views >= 128);
    if measured.len() >= 2 {
        let power = exponent(measured);
        println!("CPU time grows with the power {power:.2} of the number of views, from 128 on");
    }
    Ok(())
}
