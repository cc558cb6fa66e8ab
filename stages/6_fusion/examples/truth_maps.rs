//! Fuses the true depth and normal maps of a data set and measures cloud and mesh against the true
//! surface: what fusion alone costs.
//!
//! `truth_maps DATA [BIAS_MM NOISE_MM]`: `DATA/truth` holds `cameras.json`, `NAME_depth.exr`,
//! `NAME_normal.exr` and `mesh.ply`; every view gets a smooth bias and white noise of these sizes.

use nalgebra::{Point3, Vector3};
use rilievo_fusion::{Fused, FusionOptions, Inputs, run};
use rilievo_io::{read_cameras, read_depth, read_mesh_ply, read_normal};
use rilievo_scene::{
    MemoryScratch, PhotoSet, PointCloud, PosedViews, Raster, ShadedView, ShadedViews, Silent,
    ViewIdx,
};
use rilievo_synthetic::compare::{
    MeshDistance, Similarity, TrueSurface, TruthMaps, TruthView, compare_cloud,
};
use rilievo_synthetic::testing::{Random, posed_view};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

type Fallible<T> = Result<T, Box<dyn Error>>;

/// A smooth field of unit amplitude, another one for every view.
fn smooth(view: usize, x: f64, y: f64) -> f64 {
    let phase = 1.7 * view as f64;
    let waves = (x / 260.0 + phase).sin() * (y / 310.0 - 0.6 * phase).cos();
    [0.7, -0.7][view % 2] + 0.6 * waves
}

/// White noise of unit variance from integers.
fn white(view: usize, i: usize) -> f64 {
    Random((view as u64) << 40 | i as u64).normal()
}

fn main() -> Fallible<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let data = Path::new(arguments.first().ok_or("name a data set")?).join("truth");
    let size = |i: usize| {
        arguments
            .get(i)
            .and_then(|a| a.parse::<f64>().ok())
            .unwrap_or(0.0)
    };
    let (bias, noise) = (1e-3 * size(1), 1e-3 * size(2));
    let cameras = read_cameras(&data.join("cameras.json"))?;
    let mut posed = PosedViews::default();
    let mut shaded = ShadedViews::default();
    let mut truth = Vec::new();
    for (idx, camera) in cameras.cameras.into_iter().enumerate() {
        let file_name = camera.image.ok_or("image")?;
        let intrinsics = camera.intrinsics;
        let cam_from_world = camera.cam_from_world.ok_or("pose")?;
        let view = posed_view(idx, &file_name, intrinsics, cam_from_world);
        let name = view.name.clone();
        posed.views.push(view);
        let depth = read_depth(&data.join(format!("{name}_depth.exr")))?;
        let normal = read_normal(&data.join(format!("{name}_normal.exr")))?;
        let disturbed = Raster::from_fn(depth.width, depth.height, |x, y| {
            let z = *depth.at(x, y);
            if z <= 0.0 {
                return 0.0;
            }
            let i = y * depth.width + x;
            z + (bias * smooth(idx, x as f64, y as f64) + noise * white(idx, i)) as f32
        });
        shaded.views.push(ShadedView {
            view: ViewIdx(idx),
            name: name.clone(),
            depth: disturbed,
            normal: normal.clone(),
            confidence: None,
            rendered: None,
            albedo: None,
        });
        truth.push((
            cam_from_world,
            TruthView {
                name,
                intrinsics,
                maps: TruthMaps::Both(depth, normal),
            },
        ));
    }
    let surface = read_mesh_ply(&data.join("mesh.ply"))?;

    let start = Instant::now();
    let inputs = Inputs {
        photos: &PhotoSet::default(),
        posed: &posed,
        maps: &shaded,
        scratch: &MemoryScratch,
    };
    let mut cloud = PointCloud::default();
    let Fused { mesh, report, .. } = run(inputs, &mut cloud, &FusionOptions::default(), &Silent)?;
    println!("fused in {:.1} s", start.elapsed().as_secs_f64());
    println!("{}", serde_json::to_string_pretty(&report)?);
    let views: Vec<_> = truth.iter().map(|(pose, view)| (*pose, view)).collect();
    for threshold in [0.5e-3, 1e-3, 2e-3] {
        let compared = compare_cloud(
            &cloud.points,
            &TrueSurface {
                mesh: &surface,
                views: &views,
                threshold: Some(threshold),
            },
            &Similarity::identity("the truth's own cameras"),
        )
        .ok_or("nothing to compare")?;
        println!("cloud: {}", serde_json::to_string(&compared)?);
    }

    let distance = MeshDistance::new(&surface, 1e-3).ok_or("no surface")?;
    let vector = |v: [f32; 3]| Vector3::from(v.map(f64::from));
    let (mut angles, mut near) = (Vec::new(), Vec::new());
    for point in cloud.points.iter().step_by(7) {
        let (d, triangle) = distance.nearest(&Point3::from(vector(point.position)));
        let corners = surface.triangles[triangle];
        let [a, b, c] = corners.map(|v| vector(surface.vertices[v as usize]));
        // The normal of the true surface between the corners, by their areal weights.
        let face = (b - a).cross(&(c - a));
        let p = vector(point.position);
        let weights = [(b, c), (c, a), (a, b)]
            .map(|(u, v)| (u - p).cross(&(v - p)).dot(&face) / face.norm_squared());
        let normal = corners
            .iter()
            .zip(weights)
            .map(|(&v, w)| vector(surface.normals[v as usize]) * w)
            .sum::<Vector3<f64>>();
        angles.push(normal.angle(&vector(point.normal)).to_degrees());
        near.push(d);
    }
    angles.sort_by(f64::total_cmp);
    println!(
        "normals against the mesh: mean {:.2}, median {:.2} degrees",
        angles.iter().sum::<f64>() / angles.len() as f64,
        angles[angles.len() / 2]
    );
    let vertices = &mesh.vertices;
    let mean = vertices
        .iter()
        .map(|v| distance.nearest(&Point3::from(vector(*v))).0)
        .sum::<f64>()
        / vertices.len().max(1) as f64;
    println!("mesh: mean distance {:.4} mm", 1e3 * mean);
    let own = compare_cloud(
        &mesh
            .vertices
            .iter()
            .map(|&position| rilievo_scene::CloudPoint {
                position,
                normal: [0.0, 0.0, 1.0],
                color: [0; 3],
                confidence: 1.0,
                num_views: 1,
            })
            .collect::<Vec<_>>(),
        &TrueSurface {
            mesh: &surface,
            views: &views,
            threshold: Some(0.75e-3),
        },
        &Similarity::identity("the truth's own cameras"),
    );
    println!("mesh as points: {}", serde_json::to_string(&own)?);
    Ok(())
}
