//! What stands still in the frame, and photos that were taken from one place.

use crate::common;

use common::{arg, json_of, reconstruct_until, reconstructed_until, synthetic_set};
use rilievo_io::{decode_photo, read_mask, write_mask, write_photo_jpeg};
use rilievo_scene::{LinearImage, Mask};
use rilievo_synthetic::testing::{Random, linear_of};
use std::path::{Path, PathBuf};

/// The photos of the synthetic set with their masks and cameras, each repainted by its number.
struct Repainted {
    folder: tempfile::TempDir,
}

impl Repainted {
    fn new(paint: impl Fn(usize, &mut LinearImage, &Mask)) -> Self {
        let (set, folder) = (synthetic_set(), tempfile::tempdir().unwrap());
        for name in ["photos", "masks"] {
            std::fs::create_dir(folder.path().join(name)).unwrap();
        }
        let repainted = Self { folder };
        for k in 1..=4 {
            let mask = read_mask(&set.join(format!("masks/IMG_000{k}.png"))).unwrap();
            let sphere = read_mask(&set.join(format!("sphere_masks/IMG_000{k}.png"))).unwrap();
            let decoded = decode_photo(&set.join(format!("photos/IMG_000{k}.jpg"))).unwrap();
            let mut image = linear_of(&decoded);
            let mut either = mask.clone();
            for (shown, of_sphere) in either.data.iter_mut().zip(&sphere.data) {
                *shown |= of_sphere;
            }
            paint(k, &mut image, &either);
            repainted.put(&format!("IMG_000{k}"), &image, &mask, 95);
        }
        repainted
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn put(&self, name: &str, image: &LinearImage, mask: &Mask, quality: u8) {
        let photo = self.path(&format!("photos/{name}.jpg"));
        write_photo_jpeg(&photo, image, quality).unwrap();
        write_mask(&self.path(&format!("masks/{name}.png")), mask).unwrap();
    }

    fn arguments(&self, more: &[&str]) -> Vec<String> {
        let cameras = synthetic_set().join("intrinsics.json");
        let masks = self.path("masks");
        let all = ["--masks", arg(&masks), "--cameras", arg(&cameras)];
        all.iter().chain(more).map(|&a| a.to_owned()).collect()
    }

    /// Poses of the photos; the exit code and what was said.
    fn posed(&self) -> (i32, String) {
        let arguments = self.arguments(&["--sphere", "none"]);
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let run_dir = self.path("run");
        let (code, _, stderr) =
            reconstruct_until("poses", &self.path("photos"), &run_dir, &arguments);
        (code, stderr)
    }
}

/// Distances of the cameras from the first one over that of the last.
fn shape(cameras: &Path) -> Vec<f64> {
    let file = json_of(cameras);
    let center = |k: usize| -> Vec<f64> {
        let values = file["cameras"][k]["camera_center"].as_array().unwrap();
        values.iter().map(|v| v.as_f64().unwrap()).collect()
    };
    let apart = |a: usize, b: usize| -> f64 {
        let squares = center(a)
            .into_iter()
            .zip(center(b))
            .map(|(a, b)| (a - b).powi(2));
        squares.sum::<f64>().sqrt()
    };
    let pairs = [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]];
    pairs.map(|[a, b]| apart(a, b) / apart(0, 3)).to_vec()
}

#[track_caller]
fn assert_posed(repainted: &Repainted, tolerance: f64) {
    let (code, said) = repainted.posed();
    assert_eq!(code, 0, "{said}");
    assert!(said.contains("stand still in the frame"), "{said}");
    let found = shape(&repainted.path("run/3_poses/cameras.json"));
    let truth = shape(&synthetic_set().join("truth/cameras.json"));
    for (found_ratio, true_ratio) in found.iter().zip(&truth) {
        let error = (found_ratio / true_ratio - 1.0).abs();
        assert!(error < tolerance, "{found:?} against {truth:?}");
    }
}

/// Paints coloured blocks of random places and sizes where `here` allows, the same ones for every photo.
fn paint_blocks(
    image: &mut LinearImage,
    num: usize,
    size: u32,
    here: impl Fn(usize, usize) -> bool,
) {
    let mut random = Random(11);
    for _ in 0..num {
        let mut below = |n: usize| (random.unit() * n as f64) as usize;
        let (x0, y0) = (below(image.width), below(image.height));
        let (width, height) = (2 + below(size as usize), 2 + below(size as usize));
        let color = [0; 3].map(|_| 0.02 + 0.1 * below(8) as f32);
        for y in y0..(y0 + height).min(image.height) {
            for x in (x0..(x0 + width).min(image.width)).filter(|&x| here(x, y)) {
                image.pixel_mut(x, y).copy_from_slice(&color);
            }
        }
    }
}

#[test]
fn a_caption_that_stands_still_in_every_photo_is_left_out() {
    let captioned = Repainted::new(|_, image, _| {
        let is_caption = |_, y: usize| y >= 318;
        for y in 318..image.height {
            for x in 0..image.width {
                image.pixel_mut(x, y).fill(0.9);
            }
        }
        paint_blocks(image, 2500, 8, is_caption);
        paint_blocks(image, 2500, 5, |x, y| x > 300 && (6..24).contains(&y));
    });
    // The poses of the photos without it are as far from the truth.
    assert_posed(&captioned, 0.01);
}

#[test]
fn an_object_that_turns_before_a_background_that_does_not_is_posed_by_its_own_matches() {
    let turned = Repainted::new(|_, image, object| {
        paint_blocks(image, 6000, 14, |x, y| !object.at(x, y));
    });
    // Of some ten matches a pair at 480 pixels.
    assert_posed(&turned, 0.05);
}

#[test]
fn where_only_the_background_matches_the_error_says_what_to_do() {
    let flat = Repainted::new(|_, image, object| {
        paint_blocks(image, 6000, 14, |x, y| !object.at(x, y));
        for y in 0..image.height {
            for x in (0..image.width).filter(|&x| *object.at(x, y)) {
                image.pixel_mut(x, y).fill(0.4);
            }
        }
    });
    let (code, said) = flat.posed();
    assert_eq!(code, 4, "{said}");
    assert!(said.contains("features.region = \"object\""), "{said}");
}

#[test]
fn copies_confirm_nothing() {
    let twice = Repainted::new(|_, _, _| {});
    for name in ["photos", "masks"] {
        for k in [1, 4] {
            let file = twice.path(&format!("{name}/IMG_000{k}"));
            let _ = std::fs::remove_file(file.with_extension("jpg"));
            let _ = std::fs::remove_file(file.with_extension("png"));
        }
    }
    let verdict = |run_dir: &Path| json_of(&run_dir.join("report.json"))["verdict"].clone();
    let until_poses = |run_dir: &Path| {
        let masks = twice.path("masks");
        let more = ["--masks", arg(&masks), "--sphere", "none"];
        reconstructed_until("poses", &twice.path("photos"), run_dir, &more)
    };
    let two = twice.path("two");
    until_poses(&two);
    for k in [2, 3] {
        let decoded = decode_photo(&twice.path(&format!("photos/IMG_000{k}.jpg"))).unwrap();
        let mask = read_mask(&twice.path(&format!("masks/IMG_000{k}.png"))).unwrap();
        twice.put(&format!("copy_{k}"), &linear_of(&decoded), &mask, 80);
    }
    let four = twice.path("four");
    let said = until_poses(&four);
    assert!(
        said.contains("2 of 4 photos were taken from the same place"),
        "{said}"
    );
    assert!(
        said.contains("IMG_0002.jpg") && said.contains("copy_2.jpg"),
        "{said}"
    );
    let of_two = verdict(&two);
    assert!(
        of_two.to_string().contains("two photos confirm each other"),
        "{of_two}"
    );
    assert_eq!(of_two, verdict(&four));
}

/// Camera centres by photo.
fn centers(run_dir: &Path) -> std::collections::BTreeMap<String, [f64; 3]> {
    let file = json_of(&run_dir.join("3_poses/cameras.json"));
    let cameras = file["cameras"].as_array().unwrap().iter();
    let center = |camera: &serde_json::Value| {
        let name = camera["image"].as_str().unwrap().to_owned();
        let at = [0, 1, 2].map(|k| camera["camera_center"][k].as_f64().unwrap());
        (name, at)
    };
    cameras.map(center).collect()
}

/// Farthest that a camera of the first run lies from the same one of the second.
fn farthest(first: &Path, second: &Path) -> f64 {
    let second = centers(second);
    let apart = |(name, at): (String, [f64; 3])| {
        let squares = at.iter().zip(second[&name]).map(|(a, b)| (a - b).powi(2));
        squares.sum::<f64>().sqrt()
    };
    centers(first).into_iter().map(apart).fold(0.0, f64::max)
}

#[test]
fn a_photo_added_to_a_run_leaves_the_world_where_it_was() {
    let set = Repainted::new(|_, _, _| {});
    let sphere = synthetic_set().join("sphere.json");
    let until_poses = |run_dir: &Path, more: &[&str]| {
        let arguments = set.arguments(&["--sphere", arg(&sphere)]);
        let arguments = arguments
            .iter()
            .map(String::as_str)
            .chain(more.iter().copied());
        let arguments: Vec<&str> = arguments.collect();
        reconstructed_until("poses", &set.path("photos"), run_dir, &arguments)
    };
    let fourth = set.path("photos/IMG_0004.jpg");
    std::fs::rename(&fourth, set.path("fourth.jpg")).unwrap();
    let (three, four) = (set.path("three"), set.path("four"));
    until_poses(&three, &[]);
    let copied = set.path("kept");
    until_poses(&copied, &[]);
    std::fs::rename(set.path("fourth.jpg"), &fourth).unwrap();
    until_poses(&four, &[]);
    let said = until_poses(&copied, &[]);
    assert!(
        said.contains("of the result before is kept: 3 cameras"),
        "{said}"
    );
    // What the photo more changes the poses by; metres.
    let (kept, new) = (farthest(&three, &copied), farthest(&three, &four));
    assert!(
        kept < 1e-3 && kept < new,
        "{kept} with the frame, {new} without"
    );
    let said = until_poses(&four, &["--frame-of", arg(&three)]);
    assert!(said.contains("of --frame-of is kept"), "{said}");
    assert!(farthest(&copied, &four) < 1e-9);
}

#[test]
fn a_mirrored_photo_leaves_the_others_as_they_are() {
    let set = Repainted::new(|_, _, _| {});
    let (three, four) = (set.path("three"), set.path("four"));
    let until_poses = |run_dir: &Path| {
        let arguments = set.arguments(&["--sphere", "none"]);
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        reconstructed_until("poses", &set.path("photos"), run_dir, &arguments)
    };
    let photo = set.path("photos/IMG_0004.jpg");
    let mut image = linear_of(&decode_photo(&photo).unwrap());
    let mut mask = read_mask(&set.path("masks/IMG_0004.png")).unwrap();
    std::fs::remove_file(&photo).unwrap();
    until_poses(&three);
    let (width, channels) = (image.width, image.channels);
    for row in image.data.chunks_mut(width * channels) {
        row.reverse();
        row.chunks_mut(channels).for_each(<[f32]>::reverse);
    }
    mask.data.chunks_mut(width).for_each(<[bool]>::reverse);
    set.put("IMG_0004", &image, &mask, 95);
    let said = until_poses(&four);
    assert!(said.contains("IMG_0004.jpg: "), "{said}");
    let num_anchors = |run_dir: &Path| {
        let table = json_of(&run_dir.join("3_poses/anchors.json"));
        table["anchors"].as_array().unwrap().len()
    };
    assert_eq!(centers(&three), centers(&four));
    assert_eq!(num_anchors(&three), num_anchors(&four));
    assert!(num_anchors(&four) > 50);
}
