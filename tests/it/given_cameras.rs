//! Cameras that others give: far from their world's origin, in units of their own, or in none.

use crate::common;

use common::{arg, done, json_of, run, synthetic_set};
use nalgebra::Point3;
use rilievo_io::{
    CameraFile, CameraFormat, export_cameras, import_cameras, read_cameras, read_cloud_ply,
    read_mesh_ply, write_cameras,
};
use rilievo_scene::{Mesh, RigidTransform, Unit};
use rilievo_synthetic::compare::MeshDistance;
use std::path::{Path, PathBuf};

/// The true cameras of the shared set.
fn true_cameras() -> CameraFile {
    read_cameras(&synthetic_set().join("truth/cameras.json")).expect("cameras")
}

/// Cameras in metres in another unit, `per_metre` of which are a metre, and moved in that.
fn changed(mut cameras: CameraFile, unit: Unit, per_metre: f64, offset: [f64; 3]) -> CameraFile {
    cameras.unit = unit;
    for pose in (cameras.cameras.iter_mut()).filter_map(|c| c.cam_from_world.as_mut()) {
        pose.translation *= per_metre;
        *pose = pose.with_origin_at(offset.map(|v| -v));
    }
    cameras
}

/// Reconstructs a set with cameras; the run, and what was said.
fn reconstructed(set: &Path, run_dir: &Path, cameras: &Path, more: &[&str]) -> (PathBuf, String) {
    let [photos, masks] = ["photos", "masks"].map(|part| set.join(part));
    let mut arguments = vec!["reconstruct", arg(&photos), "-o", arg(run_dir)];
    arguments.extend(["--masks", arg(&masks), "--cameras", arg(cameras)]);
    arguments.extend(more);
    let (code, stdout, stderr) = run(&arguments);
    assert_eq!(code, 0, "{}: {stderr}", run_dir.display());
    (run_dir.to_path_buf(), stdout + &stderr)
}

const POSES_ONLY: [&str; 2] = ["--until", "3_poses"];

fn centers(cameras: &CameraFile) -> Vec<[f64; 3]> {
    let poses = cameras.cameras.iter().filter_map(|c| c.cam_from_world);
    poses.map(|pose| pose.center_in_source().into()).collect()
}

fn largest_difference(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

fn positions(mesh: &Mesh) -> Vec<[f64; 3]> {
    mesh.vertices.iter().map(|v| v.map(f64::from)).collect()
}

/// A small set of its own: whole runs.
fn small_set(folder: &Path) -> PathBuf {
    let set = folder.join("set");
    done(&[
        "synth",
        arg(&set),
        "--views",
        "3",
        "--size",
        "240x180",
        "--seed",
        "5",
    ]);
    set
}

/// The truth of a set in a world that was moved, its surface in double precision.
fn moved_truth(set: &Path, offset: [f64; 3], to: &Path) {
    let truth = set.join("truth");
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(&truth).unwrap().flatten() {
        if entry.path().is_file() {
            std::fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
    }
    let cameras = read_cameras(&truth.join("cameras.json")).unwrap();
    let far = changed(cameras, Unit::Metre, 1.0, offset);
    write_cameras(&to.join("cameras.json"), &far).unwrap();
    let surface = read_mesh_ply(&truth.join("mesh.ply")).unwrap();
    write_double_ply(&to.join("mesh.ply"), &surface, offset);
}

fn evaluated(run_dir: &Path, truth: &Path) -> serde_json::Value {
    let command = ["evaluate", arg(run_dir), "--truth", arg(truth), "--json"];
    serde_json::from_str(&done(&command)).unwrap()
}

/// Size of the object, metres, at least.
const SIZE: f64 = 0.1;

fn offset_of(folder: &Path) -> [f64; 3] {
    serde_json::from_value(json_of(&folder.join("offset.json"))["offset"].clone()).unwrap()
}

/// Sorted distances of the vertices of a mesh that stands at an offset from the surface of the one at the origin, and
/// the other way.
fn distances(far: &Path, near: &Path, offset: [f64; 3]) -> Vec<f64> {
    let [mut far_mesh, near_mesh] =
        [far, near].map(|f| read_mesh_ply(&f.join("mesh.ply")).unwrap());
    let stated = offset_of(far);
    for v in far_mesh.vertices.iter_mut() {
        for k in 0..3 {
            v[k] = (f64::from(v[k]) + (stated[k] - offset[k])) as f32;
        }
    }
    let mut distances = Vec::new();
    for [mesh, other] in [[&far_mesh, &near_mesh], [&near_mesh, &far_mesh]] {
        let surface = MeshDistance::new(other, 1e-3).unwrap();
        let vertices = positions(mesh).into_iter().map(Point3::from);
        distances.extend(vertices.map(|v| surface.nearest(&v).0));
    }
    distances.sort_by(f64::total_cmp);
    distances
}

#[test]
fn a_fused_surface_far_from_the_origin_has_the_shape_of_one_at_it() {
    let dir = tempfile::tempdir().unwrap();
    let set = small_set(dir.path());
    let fused = |maps: &Path, name: &str| {
        let out = dir.path().join(name);
        done(&[
            "fuse",
            arg(maps),
            "-o",
            arg(&out),
            "--full",
            "--formats",
            "obj",
        ]);
        out
    };
    let near = fused(&set.join("truth"), "near");
    assert!(!near.join("offset.json").exists());
    for offset in [
        [3200.0, 7800.0, 120.0],
        [1e4; 3],
        [1e6, 5.1e6, 200.0],
        [1e8; 3],
    ] {
        let name = format!("at {}", offset[0]);
        let truth = dir.path().join(format!("truth {name}"));
        moved_truth(&set, offset, &truth);
        let far = fused(&truth, &name);
        let largest = distances(&far, &near, offset).pop().unwrap();
        assert!(largest < 1e-5 * SIZE, "{offset:?}: {largest}");
        let text = std::fs::read_to_string(far.join("mesh.obj")).unwrap();
        assert!(
            text.lines()
                .take(3)
                .any(|line| line.starts_with("# offset "))
        );
    }
}

#[test]
fn a_run_far_from_the_origin_has_the_shape_of_one_at_it() {
    run_far_from_the_origin(&[[1e8; 3]]);
}

#[test]
#[ignore = "slow: four whole runs"]
fn runs_at_many_distances_have_the_shape_of_one_at_the_origin() {
    run_far_from_the_origin(&[
        [3200.0, 7800.0, 120.0],
        [1e4, 0.0, -1e4],
        [1e6, 5.1e6, 200.0],
    ]);
}

fn run_far_from_the_origin(offsets: &[[f64; 3]]) {
    let dir = tempfile::tempdir().unwrap();
    let set = small_set(dir.path());
    let truth = set.join("truth");
    let sphere = set.join("sphere.json");
    let with_sphere = ["--full", "--sphere", arg(&sphere)];
    let (near, _) = reconstructed(
        &set,
        &dir.path().join("near"),
        &truth.join("cameras.json"),
        &with_sphere,
    );
    let near_numbers = evaluated(&near, &truth);
    for &offset in offsets {
        let name = format!("at {}", offset[0]);
        let far_truth = dir.path().join(format!("truth {name}"));
        moved_truth(&set, offset, &far_truth);
        let cameras = far_truth.join("cameras.json");
        let (far, _) = reconstructed(&set, &dir.path().join(&name), &cameras, &with_sphere);
        // What one photo alone sees at a limb hangs on the last bit of the cameras, the rest does not.
        let distances = distances(&far.join("6_fusion"), &near.join("6_fusion"), offset);
        let at = |share: f64| distances[(share * distances.len() as f64) as usize] / SIZE;
        assert!(at(0.5) < 5e-4 && at(0.9) < 5e-3, "{} {}", at(0.5), at(0.9));
        let [x, y, z] = offset_of(&far.join("6_fusion"));
        for file in [
            "6_fusion/mesh.ply",
            "6_fusion/cloud.ply",
            "3_poses/anchors.ply",
        ] {
            let bytes = std::fs::read(far.join(file)).unwrap();
            let header = String::from_utf8_lossy(&bytes[..bytes.len().min(400)]).into_owned();
            let comment = format!("comment offset {x} {y} {z} ");
            assert!(header.contains(&comment), "{file}: {header}");
        }
        // What other programs get stands in the world.
        let given = centers(&read_cameras(&cameras).unwrap());
        let out = dir.path().join(format!("{name}.json"));
        done(&["export", arg(&far), "--format", "cameras", "-o", arg(&out)]);
        let sparse = far.join("3_poses/sparse");
        for file in [&far.join("3_poses/cameras.json"), &out, &sparse] {
            let back = centers(&read_cameras(file).unwrap());
            let difference = largest_difference(&back, &given);
            assert!(
                difference < 2e-7,
                "{name}, {}: {difference}",
                file.display()
            );
        }
        let points = |run_dir: &Path, offset: [f64; 3]| -> Vec<[f64; 3]> {
            let model = rilievo_io::colmap::read_model(&run_dir.join("3_poses/sparse")).unwrap();
            let points = model.points.iter();
            points
                .map(|p| [0, 1, 2].map(|k| p.position[k] - offset[k]))
                .collect()
        };
        let difference = largest_difference(&points(&far, offset), &points(&near, [0.0; 3]));
        assert!(difference < 1e-5 * SIZE, "{name}: {difference}");
        let numbers = evaluated(&far, &far_truth);
        assert_eq!(numbers["alignment"], "none", "{numbers}");
        for (part, key) in [
            ("cloud", "accuracy_median"),
            ("cloud", "f_score"),
            ("all", "depth_median_rel"),
        ] {
            let [far, near] = [&numbers, &near_numbers].map(|n| n[part][key].as_f64().unwrap());
            assert!(
                (far / near - 1.0).abs() < 0.03,
                "{name}: {key} {far} instead of {near}"
            );
        }
        // Beside a truth elsewhere the frames are told apart.
        let apart = evaluated(&far, &truth);
        assert_eq!(apart["alignment"], "sim3", "{apart}");
        let accuracy = apart["cloud"]["accuracy_median"].as_f64().unwrap();
        assert!(accuracy < 1e-3, "{accuracy}");
        // From the run's own cameras, and from a later stage, it is the same world.
        let again = dir.path().join(format!("{name} again"));
        let own = far.join("3_poses/cameras.json");
        let (again, _) = reconstructed(&set, &again, &own, &["--until", "3_poses"]);
        let key = |run_dir: &Path| {
            json_of(&run_dir.join("3_poses/cameras.json"))["surface_offset"].clone()
        };
        assert_eq!(key(&again), key(&far));
        // Cameras elsewhere make the poses anew, though local numbers may be the same.
        let elsewhere = dir.path().join("elsewhere");
        moved_truth(&set, offset.map(|v| v + 1e5), &elsewhere);
        let cameras = elsewhere.join("cameras.json");
        reconstructed(&set, &far, &cameras, &["--until", "3_poses"]);
        let moved = centers(&read_cameras(&far.join("3_poses/cameras.json")).unwrap());
        assert!(moved[0][0] > given[0][0] + 9e4, "{moved:?}");
    }
}

/// A mesh in double precision, as other programs write far ones.
fn write_double_ply(path: &Path, mesh: &Mesh, offset: [f64; 3]) {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
         property double z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for vertex in positions(mesh) {
        for (v, by) in vertex.iter().zip(offset) {
            bytes.extend((v + by).to_le_bytes());
        }
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|i| i.to_le_bytes()));
    }
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn every_importer_brings_far_cameras_near() {
    let dir = tempfile::tempdir().unwrap();
    let offset = [600_000.0, 5_100_000.0, 200.0];
    let far = changed(true_cameras(), Unit::Arbitrary, 1.0, offset);
    let near: Vec<RigidTransform> = true_cameras()
        .cameras
        .iter()
        .filter_map(|c| c.cam_from_world)
        .collect();
    for format in CameraFormat::ALL {
        let path = dir.path().join(match format {
            CameraFormat::Middlebury => "far_par.txt".to_owned(),
            CameraFormat::Transforms => "transforms.json".to_owned(),
            CameraFormat::Npz => "cameras_sphere.npz".to_owned(),
            format => format!("far {}", format.name()),
        });
        export_cameras(&path, format, &far).unwrap();
        let photos = synthetic_set().join("photos");
        let mut back = import_cameras(&path, format, Some(&photos)).unwrap();
        // No format but those of Metashape and our own names a unit.
        assert!(back.unit == Unit::Arbitrary, "{}", format.name());
        let world = back.localize([0.0; 3]);
        let found = back.cameras.iter().filter_map(|c| c.cam_from_world);
        for (found, near) in found.zip(&near) {
            let center = found.center_in_source();
            let wanted = near.center_in_source();
            let error = (0..3).map(|k| center[k] + world.offset[k] - offset[k] - wanted[k]);
            let error = error.map(f64::abs).fold(0.0, f64::max);
            assert!(error < 2e-7, "{}: {error}", format.name());
            assert!(center.coords.amax() < 32.0, "{}: {center}", format.name());
        }
    }
}

#[test]
fn units_of_length_become_metres_and_come_back() {
    let dir = tempfile::tempdir().unwrap();
    let plain = centers(&true_cameras());
    for (unit, per_metre) in [
        ("millimetre", 1000.0),
        ("centimetre", 100.0),
        ("inch", 1.0 / 0.0254),
        ("foot", 1.0 / 0.3048),
        ("metre", 1.0),
    ] {
        let kind = Unit::of_name(unit).unwrap();
        let given = changed(true_cameras(), kind, per_metre, [0.0; 3]);
        let cameras = dir.path().join(format!("{unit}.json"));
        write_cameras(&cameras, &given).unwrap();
        let (run_dir, _) = reconstructed(
            &synthetic_set(),
            &dir.path().join(unit),
            &cameras,
            &["--until", "3_poses"],
        );
        let of_run = read_cameras(&run_dir.join("3_poses/cameras.json")).unwrap();
        assert_eq!(of_run.unit, Unit::Metre, "{unit}");
        let difference = largest_difference(&centers(&of_run), &plain);
        assert!(difference < 1e-12, "{unit}: {difference}");
        let out = dir.path().join(format!("{unit} out.json"));
        done(&[
            "export",
            arg(&run_dir),
            "--format",
            "cameras",
            "-o",
            arg(&out),
        ]);
        let back = read_cameras(&out).unwrap();
        assert_eq!(back.unit, kind);
        let difference = largest_difference(&centers(&back), &centers(&given));
        assert!(difference < 1e-9 * per_metre, "{unit}: {difference}");
        let imported = dir.path().join(format!("{unit} in.json"));
        done(&["import", arg(&cameras), "-o", arg(&imported)]);
        assert_eq!(read_cameras(&imported).unwrap().unit, kind);
    }
}

#[test]
fn cameras_without_a_unit_claim_none_and_a_sphere_gives_them_one() {
    let dir = tempfile::tempdir().unwrap();
    let set = synthetic_set();
    let plain_cameras = read_cameras(&set.join("truth/cameras.json")).unwrap();
    // As of structure from motion: any size, and far from the origin too.
    let given = changed(
        plain_cameras.clone(),
        Unit::Arbitrary,
        37.0,
        [5000.0, 0.0, 0.0],
    );
    let model = dir.path().join("model");
    export_cameras(&model, CameraFormat::Colmap, &given).unwrap();
    let (run_dir, said) = reconstructed(&set, &dir.path().join("run"), &model, &[]);
    assert!(!said.contains(" mm"), "{said}");
    let page = std::fs::read_to_string(run_dir.join("report.html")).unwrap();
    assert!(page.contains("of the cameras&#39; units") || page.contains("of the cameras' units"));
    for file in ["6_fusion/mesh.ply", "6_fusion/cloud.ply"] {
        let bytes = std::fs::read(run_dir.join(file)).unwrap();
        let header = String::from_utf8_lossy(&bytes[..bytes.len().min(300)]).into_owned();
        assert!(header.contains("comment unit arbitrary"), "{header}");
    }
    let unit = |run_dir: &Path| json_of(&run_dir.join("3_poses/cameras.json"))["unit"].clone();
    assert_eq!(unit(&run_dir), "arbitrary");
    let report = json_of(&run_dir.join("report.json"));
    assert_eq!(
        report["stages"]["3_poses"]["report"]["scale"]["unit"],
        "arbitrary"
    );
    let truth = set.join("truth");
    let table = done(&["evaluate", arg(&run_dir), "--truth", arg(&truth)]);
    assert!(table.contains("sim3"), "{table}");

    let sphere = set.join("sphere.json");
    let with_sphere = [&POSES_ONLY[..], &["--sphere", arg(&sphere)]].concat();
    let (metric, said) = reconstructed(&set, &dir.path().join("metric"), &model, &with_sphere);
    assert!(said.contains("no unit of length"), "{said}");
    assert_eq!(unit(&metric), "metre");
    // Sizes are the true ones, in the given axes.
    let cameras = read_cameras(&metric.join("3_poses/cameras.json")).unwrap();
    let (found, plain) = (centers(&cameras), centers(&plain_cameras));
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        let length = |c: &[[f64; 3]]| {
            (0..3)
                .map(|k| (c[a][k] - c[b][k]).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        let ratio = length(&found) / length(&plain);
        assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
    }
    let distance = ["--known-distance", "IMG_0001.jpg,IMG_0003.jpg,0.5"];
    let known = [&["--until", "3_poses"][..], &distance].concat();
    let (known, _) = reconstructed(&set, &dir.path().join("known"), &model, &known);
    assert_eq!(unit(&known), "metre");

    // A centre alone in an unknown unit, beside a radius in metres, is no sphere.
    let center = dir.path().join("center.json");
    std::fs::write(&center, r#"{"radius": 0.03, "center": [5000, 0, 0]}"#).unwrap();
    let photos = set.join("photos");
    let out = dir.path().join("center");
    let (code, _, stderr) = run(&[
        "reconstruct",
        arg(&photos),
        "-o",
        arg(&out),
        "--cameras",
        arg(&model),
        "--sphere",
        arg(&center),
        "--until",
        "3_poses",
    ]);
    assert!(
        code == 0 && stderr.contains("which they do not name"),
        "{code}: {stderr}"
    );
}

#[test]
fn maps_in_a_far_world_of_millimetres_are_fused_in_metres_near_the_object() {
    let dir = tempfile::tempdir().unwrap();
    let truth = synthetic_set().join("truth");
    let maps = dir.path().join("maps");
    std::fs::create_dir_all(&maps).unwrap();
    for camera in &true_cameras().cameras {
        let image = camera.image.clone().unwrap();
        let name = image.split('.').next().unwrap().to_owned();
        let mut depth = rilievo_io::read_depth(&truth.join(format!("{name}_depth.exr"))).unwrap();
        depth.data.iter_mut().for_each(|z| *z *= 1000.0);
        rilievo_io::write_depth(&maps.join(format!("{name}_depth.exr")), &depth).unwrap();
        let normal = format!("{name}_normal.exr");
        std::fs::copy(truth.join(&normal), maps.join(&normal)).unwrap();
    }
    let fused = |cameras: &CameraFile, maps: &Path, name: &str| {
        write_cameras(&maps.join("cameras.json"), cameras).unwrap();
        let out = dir.path().join(name);
        done(&["fuse", arg(maps), "-o", arg(&out), "--formats", "ply"]);
        out
    };
    let far = fused(
        &changed(true_cameras(), Unit::Millimetre, 1000.0, [6e8, 5e9, 0.0]),
        &maps,
        "far",
    );
    let offset = json_of(&far.join("offset.json"));
    assert_eq!(offset["unit"], "metre");
    let stated: [f64; 3] = serde_json::from_value(offset["offset"].clone()).unwrap();
    let near = dir.path().join("near");
    done(&["fuse", arg(&truth), "-o", arg(&near), "--formats", "ply"]);
    let [far, near] = [far, near].map(|out| read_cloud_ply(&out.join("cloud.ply")).unwrap());
    let middle = |cloud: &rilievo_scene::PointCloud, k: usize| -> f64 {
        let sum: f64 = cloud.points.iter().map(|p| f64::from(p.position[k])).sum();
        sum / cloud.points.len() as f64
    };
    for k in 0..3 {
        let difference = middle(&far, k) + stated[k] - [6e5, 5e6, 0.0][k] - middle(&near, k);
        assert!(difference.abs() < 1e-4, "{difference}");
    }
}

#[test]
fn cameras_of_other_photos_do_not_say_where_the_object_is() {
    let dir = tempfile::tempdir().unwrap();
    let far = [600_000.0, 5_100_000.0, 200.0];
    let mut given = changed(true_cameras(), Unit::Metre, 1.0, far);
    // A survey of the whole site, of which the photos show one object.
    for k in 0..40 {
        let mut entry = given.cameras[0].clone();
        entry.image = Some(format!("SITE_{k}.jpg"));
        let pose = entry.cam_from_world.as_mut().unwrap();
        *pose = pose.with_origin_at([-1000.0 - 50.0 * f64::from(k), 3000.0, 0.0]);
        given.cameras.push(entry);
    }
    let cameras = dir.path().join("cameras.json");
    write_cameras(&cameras, &given).unwrap();
    let run_dir = dir.path().join("run");
    let (run_dir, _) = reconstructed(&synthetic_set(), &run_dir, &cameras, &POSES_ONLY);
    let of_run = json_of(&run_dir.join("3_poses/cameras.json"));
    let offset: [f64; 3] = serde_json::from_value(of_run["surface_offset"].clone()).unwrap();
    for k in 0..3 {
        assert!((offset[k] - far[k]).abs() < 10.0, "{offset:?}");
    }
}
