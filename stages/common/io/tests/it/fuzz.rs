//! Every parser of this crate on valid files that were damaged at random: bytes changed, pieces left
//! out, doubled and moved, numbers made extreme. Read or refused, never a panic.
//!
//! The short part makes some hundred files a parser; the long one (`--ignored`) goes on for a minute.
//! A failure names the parser and the number of the round, which repeats it.

// Helpers of the tests may fail as the tests do.
use rilievo_io::{self as io, CameraFormat};
use rilievo_scene::{CloudPoint, DepthMap, Intrinsics, Mesh, PointCloud, RigidTransform, Unit};
use rilievo_synthetic::testing::mat_file;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A parser with a valid file of its kind.
struct Target {
    name: &'static str,
    /// The file to damage, and the path to give the parser: the file, or the folder around it.
    file: PathBuf,
    given: PathBuf,
    read: fn(&Path),
}

/// xorshift64: any sequence without structure will do.
struct Random(u64);

impl Random {
    fn next(&mut self) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 20) as usize
    }

    fn below(&mut self, end: usize) -> usize {
        self.next() % end.max(1)
    }
}

fn damaged(whole: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    for _ in 0..=random.below(3) {
        let at = random.below(bytes.len());
        let length = random.below(24).min(bytes.len() - at);
        match random.below(7) {
            0 => bytes[at] ^= 1 << random.below(8),
            1 => bytes[at] = b"0-9.eE\"[]{},:x\n\xff\0"[random.below(17)],
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(at..at + length)),
            4 => {
                let piece = bytes[at..at + length].to_vec();
                let to = random.below(bytes.len());
                bytes.splice(to..to, piece);
            }
            5 => bytes[at..at + length.min(8)].fill([0x00, 0xFF, 0x7F, 0x80][random.below(4)]),
            _ => {
                let number: &[u8] =
                    [b"1e999".as_slice(), b"-0", b"NaN", b"18446744073709551615"][random.below(4)];
                bytes.splice(at..at, number.iter().copied());
            }
        }
        if bytes.is_empty() {
            break;
        }
    }
    bytes
}

fn cameras() -> io::CameraFile {
    let entry = |i: usize| io::CameraEntry {
        image: Some(format!("{i:08}.png")),
        intrinsics: Intrinsics::pinhole(16, 12, 20.0, 7.5, 5.5),
        cam_from_world: Some(RigidTransform::identity()),
    };
    io::CameraFile {
        unit: Unit::Metre,
        cameras: (0..2).map(entry).collect(),
        ..io::CameraFile::default()
    }
}

fn targets(folder: &Path) -> Vec<Target> {
    let mut targets = camera_targets(folder);
    targets.extend(text_and_photo_targets(folder));
    targets.extend(written_targets(folder));
    targets
}

/// One file that is read by its own path.
fn target(name: &'static str, file: PathBuf, read: fn(&Path)) -> Target {
    Target {
        name,
        given: file.clone(),
        file,
        read,
    }
}

const PHOTO: &[u8] = include_bytes!("../../src/photo/samples/halved.jpg");

fn camera_targets(folder: &Path) -> Vec<Target> {
    std::fs::create_dir_all(folder.join("images")).unwrap();
    for i in 0..2 {
        std::fs::write(folder.join(format!("images/{i:08}.png")), PHOTO).unwrap();
        std::fs::write(folder.join(format!("{i:08}.png")), PHOTO).unwrap();
    }
    fn import(path: &Path, format: CameraFormat) {
        drop(io::import_cameras(path, format, None));
    }
    use CameraFormat as F;
    type Exported = (&'static str, F, &'static str, &'static str, fn(&Path));
    let exported: [Exported; 11] = [
        ("cameras.json", F::CamerasJson, "cameras.json", "", |p| {
            drop(io::read_cameras(p))
        }),
        (
            "COLMAP cameras.txt",
            F::Colmap,
            "text",
            "cameras.txt",
            |p| import(p, F::Colmap),
        ),
        ("COLMAP images.txt", F::Colmap, "text", "images.txt", |p| {
            import(p, F::Colmap)
        }),
        (
            "COLMAP cameras.bin",
            F::ColmapBinary,
            "bin",
            "cameras.bin",
            |p| import(p, F::ColmapBinary),
        ),
        (
            "COLMAP images.bin",
            F::ColmapBinary,
            "bin",
            "images.bin",
            |p| import(p, F::ColmapBinary),
        ),
        (
            "transforms.json",
            F::Transforms,
            "transforms.json",
            "",
            |p| import(p, F::Transforms),
        ),
        ("Middlebury", F::Middlebury, "a_par.txt", "", |p| {
            import(p, F::Middlebury)
        }),
        ("Metashape", F::Metashape, "cameras.xml", "", |p| {
            import(p, F::Metashape)
        }),
        ("sfmData", F::SfmData, "cameras.sfm", "", |p| {
            import(p, F::SfmData)
        }),
        ("OpenMVS", F::OpenMvs, "scene.mvs", "", |p| {
            import(p, F::OpenMvs)
        }),
        ("npz", F::Npz, "cameras.npz", "", |p| import(p, F::Npz)),
    ];
    let mut targets = Vec::new();
    for (name, format, place, inside, read) in exported {
        let given = folder.join(place);
        io::export_cameras(&given, format, &cameras()).unwrap();
        let file = match inside {
            "" => given.clone(),
            inside => given.join(inside),
        };
        targets.push(Target {
            name,
            file,
            given,
            read,
        });
    }
    targets
}

fn text_and_photo_targets(folder: &Path) -> Vec<Target> {
    let progressive = include_bytes!("../../src/photo/samples/progressive.jpg");
    type Content = (&'static str, &'static [u8], fn(&Path));
    let contents: [Content; 6] = [
        (
            "sphere.json",
            br#"{"radius": 0.04, "views": {"b": {"ellipse": [1, 2, 5, 4, 90]}, "c": {"circle": [3, 4, 6]},
            "p": {"points": [[0,0],[1,0],[2,1],[1,2],[0,1]]}}, "center": [0.1, 0.2, 0.3]}"#,
            |p| drop(io::read_sphere_file(p)),
        ),
        (
            "lighting.json",
            br#"{"L1": [[1,2,3,4,5,6,7,8,9]], "L2": [[0,0,-1,0,0,0,0,0,1e3]]}"#,
            |p| drop(io::read_lighting(p, Some("L1"))),
        ),
        (
            "scene.json",
            br#"{"views": [{"name": "a", "image": "i.exr", "camera": "c.json", "init": "plane"}]}"#,
            |p| drop(io::read_scene(p)),
        ),
        ("matches.csv", b"x1,y1,x2,y2\n1,2,3.5,-4\n5,6,7,8\n", |p| {
            drop(io::read_matches_csv(p));
        }),
        ("photo.jpg", PHOTO, |p| drop(io::decode_photo(p))),
        ("progressive.jpg", progressive, |p| drop(io::decode_photo(p))),
    ];
    let write = |(name, content, read): Content| {
        let path = folder.join(name);
        std::fs::write(&path, content).unwrap();
        target(name, path, read)
    };
    contents.map(write).into()
}

fn written_targets(folder: &Path) -> Vec<Target> {
    let mut targets = Vec::new();
    let mut add = |name: &'static str, read: fn(&Path), write: &dyn Fn(&Path)| {
        let path = folder.join(name);
        write(&path);
        targets.push(target(name, path, read));
    };
    let point = CloudPoint {
        position: [1.0, 2.0, 3.0],
        normal: [0.0, 0.0, 1.0],
        color: [1, 2, 3],
        confidence: 0.5,
        num_views: 2,
    };
    let cloud = PointCloud {
        points: vec![point; 5],
    };
    let mesh = Mesh {
        vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2]],
        ..Mesh::default()
    };
    let arrays = [
        mat_file::header(),
        mat_file::array("row", &[1, 2], &[1.5, 2.5]),
    ]
    .concat();
    add("cloud.ply", |p| drop(io::read_cloud_ply(p)), &|path| {
        io::write_cloud_ply(path, &cloud, Unit::Metre).unwrap();
    });
    add("mesh.ply", |p| drop(io::read_mesh_ply(p)), &|path| {
        io::write_mesh_ply(path, &mesh, Unit::Metre).unwrap();
    });
    add("arrays.mat", |p| drop(io::read_mat(p, |_| true)), &|path| {
        std::fs::write(path, &arrays).unwrap();
    });
    add("depth.exr", |p| drop(io::read_depth(p)), &|path| {
        io::write_depth(path, &DepthMap::filled(9, 7, 0.5)).unwrap();
    });
    #[cfg(feature = "raw")]
    add("photo.dng", |p| drop(io::decode_photo(p)), &|path| {
        let photo = rilievo_scene::LinearImage::filled(16, 12, 3, 0.5);
        let exif = rilievo_scene::ExifFacts::default();
        io::write_photo_dng(path, &photo, [1.0; 3], &exif).unwrap();
    });
    targets
}

/// Damages a target's file in the way of a round's number, and reads it.
fn round(target: &Target, whole: &[u8], number: u64) {
    let mut random = Random(number.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
    std::fs::write(&target.file, damaged(whole, &mut random)).unwrap();
    let outcome = std::panic::catch_unwind(|| (target.read)(&target.given));
    assert!(
        outcome.is_ok(),
        "{} panicked in round {number}",
        target.name
    );
}

#[test]
fn damaged_files_are_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    for target in targets(folder.path()) {
        let whole = std::fs::read(&target.file).unwrap();
        (0..150).for_each(|number| round(&target, &whole, number));
        std::fs::write(&target.file, &whole).unwrap();
    }
}

#[test]
#[ignore = "takes a minute"]
fn damaged_files_are_read_or_refused_for_a_minute() {
    let folder = tempfile::tempdir().unwrap();
    let mut targets = targets(folder.path());
    // Its library can end the process that it works in, sooner or later.
    targets.retain(|target| target.name != "photo.dng");
    let share = Duration::from_secs(60) / targets.len() as u32;
    for target in targets {
        let whole = std::fs::read(&target.file).unwrap();
        let began = Instant::now();
        let mut number = 1_000;
        while began.elapsed() < share {
            round(&target, &whole, number);
            number += 1;
        }
        eprintln!("{}: {} files", target.name, number - 1_000);
        std::fs::write(&target.file, &whole).unwrap();
    }
}
