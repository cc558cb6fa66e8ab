//! The code of `examples/python.md`, as a user copies it, on files of known content.
//!
//! Without `python3` or NumPy there is nothing to run it with, and the tests say so.

// Helpers of the tests may fail as the tests do.
use nalgebra::{Point2, Point3, Rotation3, Vector3};
use rilievo_io as io;
use rilievo_scene::{
    CloudPoint, DepthMap, Intrinsics, LightKind, LightSource, Lighting, LightingCalibration,
    LinearImage, Mesh, NormalMap, PhotoIdx, PointCloud, PosedView, PosedViews, RigidTransform,
    SphericalHarmonics, Unit, ViewIdx, ViewLighting,
};
use rilievo_synthetic::testing::not_tested;
use std::path::Path;
use std::process::Command;

/// Three blocks of sixteen rows, the last one not full.
const SIZE: (usize, usize) = (37, 41);

/// The guide's blocks of code.
fn blocks() -> Vec<&'static str> {
    let guide = include_str!("../../../../../examples/python.md");
    let quoted = guide.split("```").skip(1).step_by(2);
    let blocks: Vec<&str> = quoted.filter_map(|b| b.strip_prefix("python\n")).collect();
    assert!(blocks.len() >= 5, "{} blocks of Python", blocks.len());
    blocks
}

/// Runs a script in a folder, where there is something to run it with.
fn python(folder: &Path, script: &str) {
    let run = |script: &str| {
        let mut command = Command::new("python3");
        command.args(["-c", script]).current_dir(folder).output()
    };
    if !run("import numpy").is_ok_and(|output| output.status.success()) {
        not_tested("python3 with NumPy");
        return;
    }
    let output = run(script).unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
}

/// Numbers for NumPy's `fromfile`.
fn write_numbers(path: &Path, values: impl IntoIterator<Item = f64>) {
    let bytes: Vec<u8> = values.into_iter().flat_map(f64::to_le_bytes).collect();
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn the_reader_reads_every_kind_of_samples_and_blocks() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let (width, height) = SIZE;
    let mut image = LinearImage::filled(width, height, 3, 0.0);
    for (i, value) in image.data.iter_mut().enumerate() {
        *value = (i % 1024) as f32 / 1024.0;
    }
    io::write_linear_half(&at("half.exr"), &image).unwrap();
    io::write_linear(&at("piz.exr"), &image).unwrap();
    let depth = DepthMap::from_fn(width, height, |x, y| {
        1.0 + 0.125 * x as f32 + 0.5 * y as f32
    });
    io::write_depth(&at("float.exr"), &depth).unwrap();
    // Blocks that no compression makes smaller are stored as they are.
    let mut state = 1_u64;
    let noise = DepthMap::from_fn(width, height, |_, _| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        f32::from_bits((state >> 32) as u32 & 0xbf7f_ffff)
    });
    io::write_depth(&at("noise.exr"), &noise).unwrap();
    write_numbers(&at("noise.f64"), noise.data.iter().map(|&z| z.into()));
    // Integers, which other programs write: the bits of the floats, called so.
    let mut bytes = std::fs::read(at("float.exr")).unwrap();
    let kind = bytes.windows(6).position(|w| w == b"Z\0\x02\0\0\0");
    bytes[kind.expect("a channel of floats") + 2] = 0;
    std::fs::write(at("uint.exr"), bytes).unwrap();

    let reader = blocks()[0].split("\ndepth = ").next().unwrap_or_default();
    let checks = "
half = read_exr('half.exr')
values = np.stack([half[c] for c in 'RGB'], -1)
assert values.dtype == np.float16, values.dtype
assert (values.ravel().astype('f8') == np.arange(values.size) % 1024 / 1024).all()
y, x = np.mgrid[:41, :37]
depth = (1 + .125 * x + .5 * y).astype('f4')
assert (read_exr('float.exr')['Z'] == depth).all()
integers = read_exr('uint.exr')['Z']
assert integers.dtype == np.uint32, integers.dtype
assert (integers == depth.view('u4')).all()
assert (read_exr('noise.exr')['Z'].ravel() == np.fromfile('noise.f64')).all()
try:
    read_exr('piz.exr')
except AssertionError as error:
    assert 'piz.exr' in str(error) and 'OpenEXR' in str(error), error
else:
    raise SystemExit('a compression that it cannot read was read')
";
    python(dir.path(), &format!("{reader}\n{checks}"));
}

/// A tilted plane, cut to a disc: its maps.
fn plane(camera: &Intrinsics) -> (DepthMap, NormalMap) {
    let (width, height) = (camera.width, camera.height);
    let tilted = Vector3::new(0.2, -0.3, -1.0).normalize();
    let on_disc = |x: usize, y: usize| x.abs_diff(18).pow(2) + y.abs_diff(20).pow(2) < 200;
    let depth = DepthMap::from_fn(width, height, |x, y| {
        let ray = camera.ray(&Point2::new(x as f64, y as f64));
        let depth = (-0.5 / tilted.dot(&ray)) as f32;
        if on_disc(x, y) { depth } else { 0.0 }
    });
    let normal = NormalMap::from_fn(width, height, |x, y| {
        let normal = tilted.map(|c| c as f32).into();
        if on_disc(x, y) { normal } else { [0.0; 3] }
    });
    (depth, normal)
}

/// A posed view with its depth, normals, light, cloud and mesh, where a run has them. What the guide's
/// code shall make of them lies in files of numbers.
fn write_run(folder: &Path) {
    let at = |file: &str| {
        let path = folder.join("run").join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    };
    let camera = Intrinsics::pinhole(SIZE.0, SIZE.1, 50.0, 17.25, 21.5);
    let (depth, normal) = plane(&camera);
    io::write_depth(&at("5_shading/depth/IMG_0001.exr"), &depth).unwrap();
    io::write_normal(&at("5_shading/normal/IMG_0001.exr"), &normal).unwrap();

    let cam_from_world = RigidTransform::from_world_pose(
        Rotation3::from_euler_angles(0.3, -0.5, 0.7),
        Point3::new(0.1, -0.2, 0.3),
    );
    let views = PosedViews {
        views: vec![PosedView {
            photo: PhotoIdx(0),
            name: "IMG_0001".to_owned(),
            file_name: "IMG_0001.jpg".to_owned(),
            intrinsics: camera,
            cam_from_world,
        }],
        ..PosedViews::default()
    };
    let cameras = io::CameraFile::from_posed_views(&views);
    io::write_cameras(&at("3_poses/cameras.json"), &cameras).unwrap();
    let world_from_cam = cam_from_world.inverse();
    let pixels = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
    let points = pixels.clone().filter(|&(x, y)| *depth.at(x, y) > 0.0);
    let points = points.flat_map(|(x, y)| {
        let pixel = Point2::new(x as f64, y as f64);
        let in_cam = camera.unproject(&pixel, f64::from(*depth.at(x, y)));
        <[f64; 3]>::from(world_from_cam.apply(&in_cam).coords)
    });
    write_numbers(&folder.join("points.f64"), points);

    let row = |seed: f64| SphericalHarmonics(std::array::from_fn(|i| (seed + i as f64).sin()));
    let lighting = Lighting {
        channels: vec![row(0.1), row(0.2), row(0.3)],
    };
    let calibration = LightingCalibration {
        source: LightSource::Given,
        kind: LightKind::World,
        environment_in_world: None,
        views: vec![ViewLighting {
            view: ViewIdx(0),
            lighting: lighting.clone(),
            residual: None,
            gain: vec![1.0; 3],
        }],
        spheres: Vec::new(),
        samples: Vec::new(),
    };
    io::write_lighting(&at("4_lighting/lighting.json"), &calibration, &views).unwrap();
    let image = lighting.channels.iter().flat_map(|row| {
        pixels.clone().map(|(x, y)| match *depth.at(x, y) > 0.0 {
            true => row.evaluate(&Vector3::from(*normal.at(x, y)).map(f64::from)),
            false => 0.0,
        })
    });
    write_numbers(&folder.join("image.f64"), image);

    let position = |i: usize| [i as f32, 0.5 * i as f32, -0.25];
    let point = |i: usize| CloudPoint {
        position: position(i),
        normal: [0.0, 0.6, -0.8],
        color: [10, 20, 30 + i as u8],
        confidence: 0.5,
        num_views: 2,
    };
    let cloud = PointCloud {
        points: (0..5).map(point).collect(),
    };
    io::write_cloud_ply(&at("6_fusion/cloud.ply"), &cloud, Unit::Metre).unwrap();
    let mesh = Mesh {
        vertices: (0..4).map(position).collect(),
        normals: vec![[0.0, 0.6, -0.8]; 4],
        colors: vec![[1, 2, 3]; 4],
        triangles: vec![[0, 1, 2], [2, 1, 3]],
    };
    io::write_mesh_ply(&at("6_fusion/mesh.ply"), &mesh, Unit::Metre).unwrap();
}

#[test]
fn the_whole_guide_makes_points_and_pictures_of_a_runs_files() {
    let dir = tempfile::tempdir().unwrap();
    write_run(dir.path());
    let checks = "
expected = np.fromfile('points.f64').reshape(-1, 3)
assert points.shape == expected.shape and len(points) > 500, (points.shape, expected.shape)
worst = abs(points - expected).max()
assert worst < 1e-12, worst
expected = np.fromfile('image.f64').reshape(image.shape)
worst = abs(image - expected).max()
assert worst < 1e-6 and image.shape == (3, 41, 37), (worst, image.shape)
assert (xyz == [[i, .5 * i, -.25] for i in range(5)]).all(), xyz
assert (cloud['blue'] == 30 + np.arange(5)).all() and (cloud['views'] == 2).all(), cloud
assert len(mesh) == 4 and (mesh['red'] == 1).all() and (mesh['y'] == .5 * np.arange(4)).all(), mesh
assert faces.tolist() == [[0, 1, 2], [2, 1, 3]], faces
";
    python(dir.path(), &format!("{}\n{checks}", blocks().concat()));
}
