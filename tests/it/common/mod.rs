//! What the tests of the whole program share: running it, and small photo folders.
#![allow(dead_code, reason = "every test binary uses its own part")]
use rilievo_io::write_photo_jpeg;
use rilievo_scene::LinearImage;
use rilievo_synthetic::testing::Random;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// The program, without anything inherited that could change its output.
pub fn rilievo() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rilievo"));
    command.env_remove("RUST_BACKTRACE");
    command
}

/// Runs the program; its exit code, stdout and stderr.
pub fn run(arguments: &[&str]) -> (i32, String, String) {
    let output = rilievo()
        .args(arguments)
        .output()
        .expect("the program starts");
    (
        output.status.code().unwrap_or(-1),
        String::from_utf8_lossy(&output.stdout).into_owned(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

/// Reconstructs up to a stage.
pub fn reconstruct_until(
    stage: &str,
    photos: &Path,
    run_dir: &Path,
    more: &[&str],
) -> (i32, String, String) {
    let mut arguments = vec![
        "reconstruct",
        arg(photos),
        "-o",
        arg(run_dir),
        "--until",
        stage,
    ];
    arguments.extend(more);
    run(&arguments)
}

/// Runs the program, which must succeed; its stdout.
#[track_caller]
pub fn done(arguments: &[&str]) -> String {
    let (code, stdout, stderr) = run(arguments);
    assert_eq!(code, 0, "{stderr}");
    stdout
}

/// Reconstructs up to a stage, which must succeed; what stderr says.
#[track_caller]
pub fn reconstructed_until(stage: &str, photos: &Path, run_dir: &Path, more: &[&str]) -> String {
    let (code, _, stderr) = reconstruct_until(stage, photos, run_dir, more);
    assert_eq!(code, 0, "{stderr}");
    stderr
}

/// A JSON file.
pub fn json_of(path: &Path) -> Value {
    let text = std::fs::read(path).expect("a file");
    serde_json::from_slice(&text).expect("JSON")
}

/// A path as an argument.
pub fn arg(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

/// A photo of noise: cheap, decodable, and like no other photo with another seed.
pub fn write_noise_photo(path: &Path, seed: u64) {
    let mut random = Random(seed);
    let mut image = LinearImage::filled(160, 120, 3, 0.0);
    for value in &mut image.data {
        *value = 0.05 + 0.8 * random.unit() as f32;
    }
    write_photo_jpeg(path, &image, 90).expect("a photo can be written");
}

/// A JPEG file with EXIF: orientation and focal length in 35 mm equivalents (CIPA DC-008: the tags
/// 0x0112 in the first directory, 0xA405 in the one that 0x8769 points to).
pub fn with_exif(jpeg: &[u8], orientation: u16, focal_35mm: u16) -> Vec<u8> {
    with_tags(jpeg, orientation, focal_35mm, None)
}

/// The same with an exposure time (a fraction, seconds) at f/8 and ISO 100.
pub fn with_exposure(jpeg: &[u8], time: [u32; 2]) -> Vec<u8> {
    with_tags(jpeg, 1, 50, Some(time))
}

fn with_tags(jpeg: &[u8], orientation: u16, focal_35mm: u16, time: Option<[u32; 2]>) -> Vec<u8> {
    const SHORT: u16 = 3;
    const LONG: u16 = 4;
    const RATIONAL: u16 = 5;
    let entry = |tag: u16, kind: u16, value: u32| {
        let mut bytes = Vec::new();
        bytes.extend(tag.to_le_bytes());
        bytes.extend(kind.to_le_bytes());
        bytes.extend(1u32.to_le_bytes());
        bytes.extend(value.to_le_bytes());
        bytes
    };
    let directory = |entries: &[Vec<u8>]| {
        let mut bytes = (entries.len() as u16).to_le_bytes().to_vec();
        bytes.extend(entries.concat());
        bytes.extend(0u32.to_le_bytes());
        bytes
    };
    let size_of = |num_entries: u32| 2 + 12 * num_entries + 4;
    let mut tiff = b"II*\0\x08\0\0\0".to_vec();
    let second = 8 + size_of(2);
    tiff.extend(directory(&[
        entry(0x0112, SHORT, u32::from(orientation)),
        entry(0x8769, LONG, second),
    ]));
    let focal = entry(0xA405, SHORT, u32::from(focal_35mm));
    match time {
        None => tiff.extend(directory(&[focal])),
        Some(time) => {
            // Rational numbers stand behind the directory.
            let behind = second + size_of(4);
            tiff.extend(directory(&[
                entry(0x829A, RATIONAL, behind),
                entry(0x829D, RATIONAL, behind + 8),
                entry(0x8827, SHORT, 100),
                focal,
            ]));
            tiff.extend([time, [8, 1]].concat().iter().flat_map(|n| n.to_le_bytes()));
        }
    }
    let mut bytes = jpeg[..2].to_vec();
    bytes.extend([0xFF, 0xE1]);
    bytes.extend(((tiff.len() + 8) as u16).to_be_bytes());
    bytes.extend(b"Exif\0\0");
    bytes.extend(&tiff);
    bytes.extend(&jpeg[2..]);
    bytes
}

/// A file system of so many KiB; `None` where this process may not mount one.
pub struct SmallDisk {
    /// Where it is mounted.
    pub path: PathBuf,
    _dir: tempfile::TempDir,
}

impl SmallDisk {
    pub fn new(size_kib: u32) -> Option<Self> {
        let dir = tempfile::tempdir().ok()?;
        let path = dir.path().join("disk");
        std::fs::create_dir(&path).ok()?;
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size_kib}k"), "tmpfs"])
            .arg(&path)
            .output()
            .is_ok_and(|output| output.status.success());
        mounted.then_some(Self { path, _dir: dir })
    }

    /// Makes it larger.
    pub fn grow(&self, size_kib: u32) {
        let status = Command::new("mount")
            .args(["-o", &format!("remount,size={size_kib}k")])
            .arg(&self.path)
            .status();
        assert!(status.is_ok_and(|status| status.success()));
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.path).status();
    }
}

/// A folder with `count` photos of noise.
pub fn noise_photos(folder: &Path, count: usize) -> PathBuf {
    let photos = folder.join("photos");
    std::fs::create_dir_all(&photos).expect("a folder can be made");
    for index in 0..count {
        write_noise_photo(&photos.join(format!("p{index}.jpg")), index as u64 + 1);
    }
    photos
}

/// A folder that goes with its guard, `count` photos of noise in it, and the place of their run.
pub fn noise_run(count: usize) -> (tempfile::TempDir, PathBuf, PathBuf) {
    let dir = tempfile::tempdir().expect("a folder");
    let photos = noise_photos(dir.path(), count);
    let run_dir = dir.path().join("run");
    (dir, photos, run_dir)
}

/// The synthetic set of the tests, made once per build of the program: photos, masks, sphere,
/// truth.
pub fn synthetic_set() -> PathBuf {
    let program = std::fs::metadata(env!("CARGO_BIN_EXE_rilievo")).expect("the program is built");
    let built = program
        .modified()
        .ok()
        .and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok())
        .map_or(0, |since| since.as_millis());
    let root = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let set = root.join(format!("set-{built}"));
    if !set.join("truth/mesh.ply").exists() {
        for old in std::fs::read_dir(root).into_iter().flatten().flatten() {
            if old.file_name().to_string_lossy().starts_with("set-") {
                let _ = std::fs::remove_dir_all(old.path());
            }
        }
        let making = tempfile::tempdir_in(root).expect("a folder can be made");
        let folder = arg(making.path());
        done(&["synth", folder, "--views", "4", "--size", "480x360"]);
        // Another test may have been faster; its set is as good.
        let _ = std::fs::rename(making.path(), &set);
    }
    set
}

/// A folder of this build's tests, without what an earlier build left in it.
pub fn fresh_folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

/// A set of three small photos.
pub fn small_set() -> &'static Path {
    static SET: OnceLock<PathBuf> = OnceLock::new();
    SET.get_or_init(|| {
        let set = fresh_folder("small-set");
        done(&["synth", arg(&set), "--views", "3", "--size", "240x180"]);
        // Every kind of step: a level that is solved as a whole, and relief at the photos' own pixels.
        std::fs::write(
            set.join("config.toml"),
            "[shading.photo]\nmax_fine_pixels = 4000\n",
        )
        .expect("a config file can be written");
        set
    })
}

/// Arguments that reconstruct the small set.
pub fn small_arguments(run: &Path) -> Vec<String> {
    let set = small_set();
    let mut arguments = reconstruct_arguments(set, run);
    arguments.extend([
        "--config".to_owned(),
        arg(&set.join("config.toml")).to_owned(),
    ]);
    arguments
}

/// Arguments that reconstruct a synthetic set.
pub fn reconstruct_arguments(set: &Path, run: &Path) -> Vec<String> {
    [
        "reconstruct",
        arg(&set.join("photos")),
        "--masks",
        arg(&set.join("masks")),
        "--cameras",
        arg(&set.join("intrinsics.json")),
        "--sphere",
        arg(&set.join("sphere.json")),
        "-o",
        arg(run),
    ]
    .map(str::to_owned)
    .to_vec()
}

/// Bytes of every result of a run: all files but the manifests and reports, which hold timings.
pub fn results(run: &Path) -> Vec<(String, Vec<u8>)> {
    fn collect(folder: &Path, prefix: &str, into: &mut Vec<(String, Vec<u8>)>) {
        for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let path = entry.path();
            if path.is_dir() {
                collect(&path, &format!("{prefix}{name}/"), into);
            } else if name != "manifest.json" {
                into.push((
                    format!("{prefix}{name}"),
                    std::fs::read(&path).expect("a file"),
                ));
            }
        }
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(run).expect("a run").flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with(|first: char| first.is_ascii_digit()) {
            collect(&entry.path(), &format!("{name}/"), &mut files);
        }
    }
    files.sort();
    files
}

/// Names of the files in which two runs differ.
pub fn differences(a: &Path, b: &Path) -> Vec<String> {
    let (a, b) = (results(a), results(b));
    let names = |files: &[(String, Vec<u8>)]| -> Vec<String> {
        files.iter().map(|(name, _)| name.clone()).collect()
    };
    if names(&a) != names(&b) {
        return vec![format!("files {:?} and {:?}", names(&a), names(&b))];
    }
    a.iter()
        .zip(&b)
        .filter(|((_, x), (_, y))| x != y)
        .map(|((name, _), _)| name.clone())
        .collect()
}
