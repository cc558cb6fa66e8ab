//! What fusion alone costs: the true depth and normal maps of a data set, each view with a smooth
//! bias and white noise, fused, and cloud and mesh measured against the true surface.

use crate::Failure;
use crate::data_set::Set;
use crate::growth::{mean, quantile};
use nalgebra::{Point3, Vector3};
use rilievo_fusion::{Fused, FusionOptions, Inputs, run};
use rilievo_io::read_mesh_ply;
use rilievo_scene::{MemoryScratch, PhotoSet, PointCloud, Silent};
use rilievo_synthetic::compare::{
    MeshDistance, Similarity, TrueSurface, TruthMaps, TruthView, compare_cloud,
};
use rilievo_synthetic::testing::Random;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// A data set
    set: PathBuf,
    /// Amplitude of the bias
    #[arg(default_value_t = 0.0)]
    bias_mm: f64,
    /// Deviation of the noise
    #[arg(default_value_t = 0.0)]
    noise_mm: f64,
}

/// A smooth field of unit amplitude, another one for every view.
fn smooth(view: usize, x: f64, y: f64) -> f64 {
    let phase = 1.7 * view as f64;
    let waves = (x / 260.0 + phase).sin() * (y / 310.0 - 0.6 * phase).cos();
    [0.7, -0.7][view % 2] + 0.6 * waves
}

pub fn measure(arguments: &Arguments) -> Result<(), Failure> {
    let set = Set::load(&arguments.set, false, &[])?;
    let surface = read_mesh_ply(&arguments.set.join("truth/mesh.ply"))?;
    let mut shaded = set.true_shape()?;
    let mut truth = Vec::new();
    for (idx, (posed, view)) in set.posed.views.iter().zip(&mut shaded.views).enumerate() {
        let view_truth = TruthView {
            name: view.name.clone(),
            intrinsics: posed.intrinsics,
            maps: TruthMaps::Both(view.depth.clone(), view.normal.clone()),
        };
        truth.push((posed.cam_from_world, view_truth));
        let width = view.depth.width;
        for (i, z) in view
            .depth
            .data
            .iter_mut()
            .enumerate()
            .filter(|(_, z)| **z > 0.0)
        {
            let bias = smooth(idx, (i % width) as f64, (i / width) as f64);
            let noise = Random((idx as u64) << 40 | i as u64).normal();
            *z += (1e-3 * (arguments.bias_mm * bias + arguments.noise_mm * noise)) as f32;
        }
    }
    let start = std::time::Instant::now();
    let inputs = Inputs {
        photos: &PhotoSet::default(),
        posed: &set.posed,
        maps: &shaded,
        scratch: &MemoryScratch,
    };
    let mut cloud = PointCloud::default();
    let Fused { mesh, report, .. } = run(inputs, &mut cloud, &FusionOptions::default(), &Silent)?;
    println!("fused in {:.1} s", start.elapsed().as_secs_f64());
    println!("{}", serde_json::to_string_pretty(&report)?);

    let views: Vec<_> = truth.iter().map(|(pose, view)| (*pose, view)).collect();
    for threshold in [0.5e-3, 1e-3, 2e-3] {
        let surface = TrueSurface {
            mesh: &surface,
            views: &views,
            threshold: Some(threshold),
        };
        let same = Similarity::identity("the truth's own cameras");
        let compared = compare_cloud(&cloud.points, &surface, &same).ok_or("nothing to compare")?;
        println!("cloud: {}", serde_json::to_string(&compared)?);
    }
    let distance = MeshDistance::new(&surface, 1e-3).ok_or("no surface")?;
    let vector = |v: [f32; 3]| Vector3::from(v.map(f64::from));
    let angle = |point: &rilievo_scene::CloudPoint| {
        let p = vector(point.position);
        let (_, triangle) = distance.nearest(&Point3::from(p));
        let corners = surface.triangles[triangle];
        let [a, b, c] = corners.map(|v| vector(surface.vertices[v as usize]));
        // The normal of the true surface between the corners, by their areal weights.
        let face = (b - a).cross(&(c - a));
        let weights = [(b, c), (c, a), (a, b)]
            .map(|(u, v)| (u - p).cross(&(v - p)).dot(&face) / face.norm_squared());
        let normals = corners.map(|v| vector(surface.normals[v as usize]));
        let normal: Vector3<f64> = normals.iter().zip(weights).map(|(n, w)| n * w).sum();
        normal.angle(&vector(point.normal)).to_degrees()
    };
    let mut angles: Vec<f64> = cloud.points.iter().step_by(7).map(angle).collect();
    println!(
        "normals against the mesh: mean {:.2}, median {:.2} degrees",
        mean(&angles),
        quantile(&mut angles, 0.5)
    );
    let off = |v: &[f32; 3]| distance.nearest(&Point3::from(vector(*v))).0;
    let distances: Vec<f64> = mesh.vertices.iter().map(off).collect();
    println!("mesh: mean distance {:.4} mm", 1e3 * mean(&distances));
    Ok(())
}
