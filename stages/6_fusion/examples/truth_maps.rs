//! Fuses the true depth and normal maps of a data set and measures cloud and mesh against the true
//! surface: what fusion alone costs.
//!
//! `truth_maps DATA [BIAS_MM NOISE_MM]`: `DATA/truth` holds `cameras.json`, `NAME_depth.exr`,
//! `NAME_normal.exr` and `mesh.ply`; every view gets a smooth bias and white noise of these sizes.

use exr::prelude::{ReadChannels, ReadLayers, read};
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use rilievo_fusion::{FusionOptions, run};
use rilievo_scene::{
    Intrinsics, Mesh, NormalMap, PhotoIdx, PhotoSet, PosedView, PosedViews, Raster, RigidTransform,
    ShadedView, ShadedViews, Silent, ViewIdx,
};
use rilievo_synthetic::compare::{
    MeshDistance, Similarity, TrueSurface, TruthMaps, TruthView, compare_cloud,
};
use serde_json::Value;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

type Fallible<T> = Result<T, Box<dyn Error>>;

/// One channel of an EXR file.
fn channel(path: &Path, name: &str) -> Fallible<Raster<f32>> {
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)?;
    let layer = &image.layer_data;
    let found = layer
        .channel_data
        .list
        .iter()
        .find(|c| c.name.to_string() == name)
        .ok_or_else(|| format!("{} has no channel {name}", path.display()))?;
    let data = found.sample_data.values_as_f32().collect::<Vec<f32>>();
    Raster::from_vec(layer.size.width(), layer.size.height(), data).ok_or_else(|| "size".into())
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// Vertices, normals and triangles of a binary PLY whose vertices are floats only.
fn read_ply(path: &Path) -> Fallible<Mesh> {
    let bytes = std::fs::read(path)?;
    let end = b"end_header\n";
    let start = bytes
        .windows(end.len())
        .position(|w| w == end)
        .ok_or("no header")?
        + end.len();
    let header = std::str::from_utf8(&bytes[..start])?;
    let count = |element: &str| -> Fallible<usize> {
        let line = header
            .lines()
            .find_map(|l| l.strip_prefix(&format!("element {element} ")))
            .ok_or("no such element")?;
        Ok(line.trim().parse()?)
    };
    let floats = header
        .lines()
        .filter(|l| l.starts_with("property float "))
        .count();
    let at = |offset: usize| -> [u8; 4] {
        [
            bytes[offset],
            bytes[offset + 1],
            bytes[offset + 2],
            bytes[offset + 3],
        ]
    };
    let mut mesh = Mesh::default();
    for v in 0..count("vertex")? {
        let value = |k: usize| f32::from_le_bytes(at(start + 4 * (v * floats + k)));
        mesh.vertices.push([value(0), value(1), value(2)]);
        if floats >= 6 {
            mesh.normals.push([value(3), value(4), value(5)]);
        }
    }
    let faces = start + 4 * floats * mesh.vertices.len();
    for f in 0..count("face")? {
        let corner = |k: usize| u32::from_le_bytes(at(faces + 13 * f + 1 + 4 * k));
        mesh.triangles.push([corner(0), corner(1), corner(2)]);
    }
    Ok(mesh)
}

/// A smooth field of unit amplitude, another one for every view.
fn smooth(view: usize, x: f64, y: f64) -> f64 {
    let phase = 1.7 * view as f64;
    let waves = (x / 260.0 + phase).sin() * (y / 310.0 - 0.6 * phase).cos();
    [0.7, -0.7][view % 2] + 0.6 * waves
}

/// White noise of unit variance from integers.
fn white(view: usize, i: usize) -> f64 {
    let mut h = (view as u64) << 40 | i as u64;
    let mut uniform = || {
        h = h.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = h;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ z >> 31) as f64 / u64::MAX as f64
    };
    // Twelve uniform numbers have unit variance and are near enough to normal.
    (0..12).map(|_| uniform()).sum::<f64>() - 6.0
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
    let cameras: Value = serde_json::from_slice(&std::fs::read(data.join("cameras.json"))?)?;
    let mut posed = PosedViews::default();
    let mut shaded = ShadedViews::default();
    let mut truth = Vec::new();
    for (idx, camera) in cameras["cameras"]
        .as_array()
        .into_iter()
        .flatten()
        .enumerate()
    {
        let file_name = camera["image"].as_str().ok_or("image")?.to_owned();
        let name = file_name.split('.').next().unwrap_or_default().to_owned();
        let k = |i: usize, j: usize| number(&camera["K"][i][j]);
        let depth = channel(&data.join(format!("{name}_depth.exr")), "Z")?;
        let intrinsics = Intrinsics {
            fy: k(1, 1),
            ..Intrinsics::pinhole(depth.width, depth.height, k(0, 0), k(0, 2), k(1, 2))
        };
        let rotation = Matrix3::from_fn(|i, j| number(&camera["world_from_camera_rotation"][i][j]));
        let center = Point3::from(Vector3::from_fn(|i, _| number(&camera["camera_center"][i])));
        let cam_from_world =
            RigidTransform::from_world_pose(Rotation3::from_matrix(&rotation), center);
        let path = data.join(format!("{name}_normal.exr"));
        let axes = [
            channel(&path, "N.X")?,
            channel(&path, "N.Y")?,
            channel(&path, "N.Z")?,
        ];
        let normal = NormalMap::from_fn(depth.width, depth.height, |x, y| {
            std::array::from_fn(|c| *axes[c].at(x, y))
        });
        let disturbed = Raster::from_fn(depth.width, depth.height, |x, y| {
            let z = *depth.at(x, y);
            if z <= 0.0 {
                return 0.0;
            }
            let i = y * depth.width + x;
            z + (bias * smooth(idx, x as f64, y as f64) + noise * white(idx, i)) as f32
        });
        posed.views.push(PosedView {
            photo: PhotoIdx(idx),
            name: name.clone(),
            file_name,
            intrinsics,
            cam_from_world,
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
    let surface = read_ply(&data.join("mesh.ply"))?;

    let start = Instant::now();
    let (fused, report) = run(
        &PhotoSet::default(),
        &posed,
        &shaded,
        &FusionOptions::default(),
        &Silent,
    )?;
    println!("fused in {:.1} s", start.elapsed().as_secs_f64());
    println!("{}", serde_json::to_string_pretty(&report)?);
    let views: Vec<_> = truth.iter().map(|(pose, view)| (*pose, view)).collect();
    for threshold in [0.5e-3, 1e-3, 2e-3] {
        let compared = compare_cloud(
            &fused.cloud.points,
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
    for point in fused.cloud.points.iter().step_by(7) {
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
    let vertices = &fused.mesh.vertices;
    let mean = vertices
        .iter()
        .map(|v| distance.nearest(&Point3::from(vector(*v))).0)
        .sum::<f64>()
        / vertices.len().max(1) as f64;
    println!("mesh: mean distance {:.4} mm", 1e3 * mean);
    let own = compare_cloud(
        &fused
            .mesh
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
