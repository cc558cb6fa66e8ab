//! The stage as a whole on painted planes: what it finds does not depend on threads or on the order
//! of the photos.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use nalgebra::Matrix3;
use rand::{Rng, SeedableRng};
use rilievo_features::{
    FeaturesError, FeaturesOptions, PairChoice, PairLimits, detect, match_photos,
};
use rilievo_scene::{
    FeatureMatches, FocalSource, Intrinsics, LinearImage, PairMatches, Photo, PhotoSet, Recorder,
};
use rilievo_synthetic::testing;
use std::collections::BTreeSet;

const WIDTH: usize = 320;
const HEIGHT: usize = 240;

/// Bright and dark blobs of many widths on a plane: `(x, y, σ, height)`.
fn painting() -> Vec<[f64; 4]> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    (0..500)
        .map(|_| {
            let sign = if rng.random_range(0..2) == 0 {
                1.0
            } else {
                -1.0
            };
            [
                rng.random_range(-20.0..400.0),
                rng.random_range(-20.0..300.0),
                rng.random_range(1.5..6.0),
                sign * rng.random_range(0.05..0.2),
            ]
        })
        .collect()
}

/// A photo of the painting: `painting_from_pixel` is a homography.
fn photo(name: &str, painting: &[[f64; 4]], painting_from_pixel: &Matrix3<f64>) -> Photo {
    let mut image = LinearImage::filled(WIDTH, HEIGHT, 1, 0.4);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let p = painting_from_pixel * nalgebra::Vector3::new(x as f64, y as f64, 1.0);
            let (u, v) = (p.x / p.z, p.y / p.z);
            let value: f64 = painting
                .iter()
                .map(|&[bx, by, sigma, height]| {
                    let r2 = ((u - bx).powi(2) + (v - by).powi(2)) / (sigma * sigma);
                    if r2 < 20.0 {
                        height * (-0.5 * r2).exp()
                    } else {
                        0.0
                    }
                })
                .sum();
            image.pixel_mut(x, y)[0] += value as f32;
        }
    }
    let camera = Intrinsics::pinhole(WIDTH, HEIGHT, 400.0, 159.5, 119.5);
    Photo {
        focal_source: FocalSource::Guess,
        ..testing::photo(&format!("{name}.png"), image, camera)
    }
}

fn photos() -> Vec<Photo> {
    let painting = painting();
    [
        (
            "a",
            Matrix3::new(1.0, 0.0, 30.0, 0.0, 1.0, 25.0, 0.0, 0.0, 1.0),
        ),
        (
            "b",
            Matrix3::new(0.97, 0.06, 45.0, -0.05, 1.02, 30.0, 1.5e-4, 0.0, 1.0),
        ),
        (
            "c",
            Matrix3::new(1.05, -0.08, 38.0, 0.07, 0.98, 15.0, 0.0, 2.0e-4, 1.0),
        ),
    ]
    .iter()
    .map(|(name, warp)| photo(name, &painting, warp))
    .collect()
}

fn matched(photos: Vec<Photo>) -> FeatureMatches {
    matched_and_told(photos).0
}

/// The matches, and what was warned of.
fn matched_and_told(photos: Vec<Photo>) -> (FeatureMatches, Vec<String>) {
    let set = PhotoSet { photos };
    let options = FeaturesOptions::default();
    let keypoints = set
        .photos
        .iter()
        .map(|photo| detect(photo, &options).unwrap())
        .collect();
    let told = Recorder::default();
    let (found, _) = match_photos(&set, keypoints, &options, &told).unwrap();
    (found, told.warnings())
}

/// The matches as pixels, those of the other photo first with `swap`.
fn pixels(found: &FeatureMatches, pair: &PairMatches, swap: bool) -> BTreeSet<[u32; 4]> {
    let at = |photo: usize, keypoint: u32| {
        let k = &found.photos[photo].keypoints[keypoint as usize];
        [k.x.to_bits(), k.y.to_bits()]
    };
    pair.matches
        .iter()
        .map(|m| {
            let (mut a, mut b) = (at(pair.first.0, m[0]), at(pair.second.0, m[1]));
            if swap {
                std::mem::swap(&mut a, &mut b);
            }
            [a[0], a[1], b[0], b[1]]
        })
        .collect()
}

#[test]
fn bright_and_dark_blobs_match_where_the_photos_show_the_same() {
    let found = matched(photos());
    assert_eq!(found.pairs.len(), 3);
    for pair in &found.pairs {
        let bright = |photo: usize, k: u32| found.photos[photo].keypoints[k as usize].bright;
        let num_bright = pair
            .matches
            .iter()
            .filter(|m| bright(pair.first.0, m[0]))
            .count();
        for m in &pair.matches {
            assert_eq!(bright(pair.first.0, m[0]), bright(pair.second.0, m[1]));
        }
        let num = pair.matches.len();
        assert!(num >= 100, "{num} matches");
        assert!(
            num_bright * 4 > num && num_bright * 4 < 3 * num,
            "{num_bright} of {num}"
        );
    }
}

#[test]
fn each_photo_that_cannot_be_posed_is_warned_of_once() {
    let mut set = photos();
    set.push(photo("flat", &[], &Matrix3::identity()));
    let elsewhere: Vec<[f64; 4]> = painting()
        .into_iter()
        .map(|[x, y, sigma, height]| [y, 320.0 - 0.9 * x, 0.8 * sigma, -height])
        .collect();
    set.push(photo("other", &elsewhere, &Matrix3::identity()));
    let (_, warnings) = matched_and_told(set);
    let [flat, other] = &warnings[..] else {
        panic!("{warnings:?}");
    };
    assert!(flat.starts_with("flat.png: only 0 keypoints"), "{flat}");
    assert!(other.starts_with("other.png: matches no"), "{other}");
}

/// What is matched of these pairs, and the warnings.
fn matched_of(pairs: PairChoice) -> Result<(Vec<[usize; 2]>, Vec<String>), FeaturesError> {
    let set = PhotoSet { photos: photos() };
    let options = FeaturesOptions {
        pairs,
        pair_limits: PairLimits {
            max_num_exhaustive_photos: 0,
            num_sequential_neighbors: 1,
            num_similar_neighbors: 1,
        },
        ..FeaturesOptions::default()
    };
    let keypoints = set.photos.iter().map(|p| detect(p, &options).unwrap());
    let told = Recorder::default();
    let (found, _) = match_photos(&set, keypoints.collect(), &options, &told)?;
    let pairs = found.pairs.iter().map(|p| [p.first.0, p.second.0]);
    Ok((pairs.collect(), told.warnings()))
}

#[test]
fn listed_pairs_alone_are_matched_and_unknown_names_told() {
    let listed = |names: &[[&str; 2]]| {
        PairChoice::Listed(names.iter().map(|pair| pair.map(str::to_owned)).collect())
    };
    let (pairs, warnings) = matched_of(listed(&[["c.png", "a.png"], ["b.png", "d.png"]])).unwrap();
    assert_eq!(pairs, [[0, 2]]);
    assert!(warnings.iter().any(|w| w.contains("d.png")), "{warnings:?}");
    let error = matched_of(listed(&[["a.png", "d.png"], ["b.png", "b.png"]])).unwrap_err();
    assert!(
        matches!(error, FeaturesError::NoListedPair { num: 2 }),
        "{error}"
    );
}

#[test]
fn likely_pairs_lead_to_all_that_match() {
    let all = [[0, 1], [0, 2], [1, 2]];
    for pairs in [PairChoice::All, PairChoice::Auto] {
        assert_eq!(matched_of(pairs).unwrap().0, all);
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_match() {
    let with = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| matched(photos()))
    };
    assert!(with(1) == with(2));
}

#[test]
fn the_order_of_the_photos_hardly_changes_the_matches() {
    let forward = matched(photos());
    let backward = matched(photos().into_iter().rev().collect());
    assert_eq!(forward.pairs.len(), backward.pairs.len());
    for pair in &forward.pairs {
        let other = backward
            .pairs
            .iter()
            .find(|p| p.first.0 == 2 - pair.second.0 && p.second.0 == 2 - pair.first.0)
            .unwrap();
        let (a, b) = (
            pixels(&forward, pair, false),
            pixels(&backward, other, true),
        );
        let common = a.intersection(&b).count();
        // Samples are drawn in the order of the matches: borderline ones may fall either way.
        let share = common as f64 / a.len().max(b.len()) as f64;
        assert!(share >= 0.97, "{common} of {} and {}", a.len(), b.len());
    }
}
