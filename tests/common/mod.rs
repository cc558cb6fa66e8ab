//! What the tests of the whole program share: running it, and small photo folders.
#![allow(dead_code, reason = "every test binary uses its own part")]
#![allow(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use assert_cmd::Command;
use rilievo_io::write_photo_jpeg;
use rilievo_scene::LinearImage;
use std::path::{Path, PathBuf};

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

/// A path as an argument.
pub fn arg(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

/// A photo of noise: cheap, decodable, and like no other photo with another seed.
pub fn write_noise_photo(path: &Path, seed: u64) {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut image = LinearImage::filled(160, 120, 3, 0.0);
    for value in &mut image.data {
        // xorshift64: any sequence without structure will do.
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        *value = 0.05 + 0.8 * (state >> 40) as f32 / (1u64 << 24) as f32;
    }
    write_photo_jpeg(path, &image, 90).expect("a photo can be written");
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
        let (code, _, stderr) = run(&[
            "synth",
            arg(making.path()),
            "--views",
            "4",
            "--size",
            "480x360",
        ]);
        assert_eq!(code, 0, "{stderr}");
        // Another test may have been faster; its set is as good.
        let _ = std::fs::rename(making.path(), &set);
    }
    set
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
