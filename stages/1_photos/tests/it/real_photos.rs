//! Stage 1 on the photographs in the shared folder beside the repository, where it is there.

use rilievo_io::{decode_photo, read_mask};
use rilievo_photos::{GivenMask, PhotosOptions, assemble, prepare};
use rilievo_scene::{FocalSource, Recorder};
use rilievo_synthetic::testing::shared_data;

#[test]
fn focal_length_of_a_compact_camera_from_exif() {
    let Some(folder) = shared_data("sceaux") else {
        return;
    };
    let decoded = decode_photo(&folder.join("100_7100.JPG")).unwrap();
    let done = prepare(decoded, None, None, &PhotosOptions::default()).unwrap();
    assert_eq!(done.facts.focal_source, FocalSource::Exif35mm);
    let found = done.facts.intrinsics.focal_px();
    // Calibrated focal length; EXIF rounds to whole millimetres of 35.
    assert!((found / 2905.88 - 1.0).abs() < 0.02, "{found}");
}

#[test]
fn the_same_scene_from_jpeg_and_from_16_bit() {
    let Some(folder) = shared_data("studio_smooth") else {
        return;
    };
    let options = PhotosOptions::default();
    let load = |name: &str| {
        let decoded = decode_photo(&folder.join(name)).unwrap();
        prepare(decoded, None, None, &options).unwrap()
    };
    let (jpeg, png) = (load("photos/IMG_0004.jpg"), load("linear/IMG_0004.png"));
    let focal = jpeg.facts.intrinsics.focal_px();
    assert!((focal / 1_200.0 - 1.0).abs() < 1e-6, "{focal}");
    assert_eq!(png.facts.focal_source, FocalSource::Guess);
    let (a, b) = (jpeg.pixels.load().unwrap(), png.pixels.load().unwrap());
    let mut differences: Vec<f32> = a
        .data
        .iter()
        .zip(&b.data)
        .filter(|(_, b)| **b > 0.05 && **b < 0.95)
        .map(|(a, b)| (a / b - 1.0).abs())
        .collect();
    differences.sort_by(f32::total_cmp);
    let median = differences[differences.len() / 2];
    assert!(median < 0.02, "{median}");
}

#[test]
fn a_whole_folder_with_masks() {
    let Some(folder) = shared_data("sokrates8") else {
        return;
    };
    let options = PhotosOptions::default();
    let photos = ["color000001", "color000024"]
        .map(|name| {
            let decoded = decode_photo(&folder.join(format!("photos/{name}.png"))).unwrap();
            let mask = read_mask(&folder.join(format!("masks/{name}.png"))).unwrap();
            prepare(decoded, Some(GivenMask::as_stored(mask)), None, &options).unwrap()
        })
        .to_vec();
    let told = Recorder::default();
    let (set, report) = assemble(photos, &options, &told).unwrap();
    assert_eq!(set.photos.len(), 2);
    assert_eq!(report.camera_groups.len(), 1);
    assert!(
        report
            .mean_mask_coverage
            .is_some_and(|c| (0.5..0.75).contains(&c)),
        "{report:?}"
    );
    assert!(
        told.warnings().iter().any(|w| w.contains("guessed")),
        "{:?}",
        told.warnings()
    );
}

#[test]
fn every_given_mask_passes() {
    let options = PhotosOptions::default();
    for set in [
        "studio_stone",
        "studio_smooth",
        "studio_stained",
        "studio_fine",
        "sokrates8",
    ] {
        let Some(folder) = shared_data(set) else {
            return;
        };
        for entry in std::fs::read_dir(folder.join("photos")).unwrap() {
            let path = entry.unwrap().path();
            let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
            let mask = read_mask(&folder.join(format!("masks/{stem}.png"))).unwrap();
            let coverage = mask.coverage();
            let decoded = decode_photo(&path).unwrap();
            let done = prepare(decoded, Some(GivenMask::as_stored(mask)), None, &options).unwrap();
            assert_eq!(
                done.facts.mask_coverage,
                Some(coverage),
                "{}",
                path.display()
            );
            // Nobody is told that such a mask is larger than the object, or smaller, or another photo's.
            let outline = done.facts.mask_outline;
            assert!(
                !outline.is_some_and(|outline| outline.is_apart()),
                "{}: {outline:?}",
                path.display()
            );
            let ratio = done.facts.mask_edge_ratio;
            assert!(
                ratio.is_some_and(|ratio| ratio > 1.4),
                "{}: {ratio:?}",
                path.display()
            );
        }
    }
}

#[test]
fn photos_given_as_masks_are_refused_and_most_masks_of_other_photos_told() {
    let options = PhotosOptions::default();
    let (mut num_pairs, mut num_told) = (0, 0);
    for set in ["studio_stone", "studio_smooth", "sokrates8"] {
        let Some(folder) = shared_data(set) else {
            return;
        };
        let mut paths: Vec<_> = std::fs::read_dir(folder.join("photos"))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        paths.sort();
        for (i, path) in paths.iter().enumerate() {
            let error = read_mask(path).unwrap_err().to_string();
            assert!(error.contains("is no mask"), "{error}");
            let other = &paths[(i + paths.len() / 2) % paths.len()];
            let stem = other.file_stem().unwrap().to_string_lossy().into_owned();
            let mask = read_mask(&folder.join(format!("masks/{stem}.png"))).unwrap();
            let decoded = decode_photo(path).unwrap();
            let done = prepare(decoded, Some(GivenMask::as_stored(mask)), None, &options).unwrap();
            num_pairs += 1;
            num_told += usize::from(done.facts.mask_edge_ratio.is_some_and(|r| r < 1.0));
        }
    }
    assert!(3 * num_told > 2 * num_pairs, "{num_told} of {num_pairs}");
}
