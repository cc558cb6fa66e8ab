//! Stage 1 as a whole, on made photos and, where they are at hand, on real ones.

// Helpers of the tests may fail as the tests do.
use rilievo_photos::{
    GivenCamera, GivenMask, PhotosError, PhotosOptions, PhotosReport, PreparedPhoto, assemble,
    prepare,
};
use rilievo_scene::{
    DecodedPhoto, ExifFacts, FocalSource, Intrinsics, Mask, Orientation, PhotoSet, Raster,
    Recorder, Samples, Silent,
};

fn photo(file_name: &str, exif: ExifFacts) -> DecodedPhoto {
    let (width, height) = (64, 48);
    DecodedPhoto {
        file_name: file_name.to_owned(),
        width,
        height,
        channels: 3,
        samples: Samples::U8((0..width * height * 3).map(|i| (i % 251) as u8).collect()),
        linear_by_metadata: false,
        saturates_at_white: true,
        encoding_reason: "8 bit".to_owned(),
        profile_curve: None,
        alpha: None,
        exif,
    }
}

/// The set, its report, and what was warned of.
fn assembled(
    photos: Vec<PreparedPhoto>,
    options: &PhotosOptions,
) -> (PhotoSet, PhotosReport, Vec<String>) {
    let told = Recorder::default();
    let (set, report) = assemble(photos, options, &told).unwrap();
    (set, report, told.warnings())
}

fn prepared(file_name: &str, exif: ExifFacts) -> PreparedPhoto {
    prepare(
        photo(file_name, exif),
        None,
        None,
        &PhotosOptions::default(),
    )
    .unwrap()
}

fn disc() -> GivenMask {
    GivenMask::as_stored(Raster::from_fn(64, 48, |x, y| {
        (x as f64 - 30.0).hypot(y as f64 - 20.0) < 15.0
    }))
}

fn zoom(focal_mm: f64) -> ExifFacts {
    ExifFacts {
        focal_mm: Some(focal_mm),
        focal_35mm: Some(2.0 * focal_mm),
        model: Some("Model S".to_owned()),
        ..ExifFacts::default()
    }
}

#[test]
fn photos_are_ordered_and_share_cameras_by_body_and_zoom() {
    let photos = vec![
        prepared("c.jpg", zoom(20.0)),
        prepared("a.jpg", zoom(20.0)),
        prepared("b.jpg", zoom(35.0)),
    ];
    let (set, report, warnings) = assembled(photos, &PhotosOptions::default());
    let order: Vec<(&str, usize)> = set
        .photos
        .iter()
        .map(|photo| (photo.name.as_str(), photo.camera_group))
        .collect();
    assert_eq!(order, [("a", 0), ("b", 1), ("c", 0)]);
    assert_eq!(report.camera_groups[0].photos, ["a.jpg", "c.jpg"]);
    assert_eq!(report.photos.len(), 3);
    // Nothing is wrong but that they have no masks.
    let told: Vec<bool> = warnings
        .iter()
        .map(|w| w.contains("no photo has a mask"))
        .collect();
    assert_eq!(told, [true], "{:?}", warnings);
}

#[test]
fn photos_of_the_same_second_are_different_photos() {
    let exif = ExifFacts {
        date: Some("2024:01:02 03:04:05".to_owned()),
        serial: Some("77".to_owned()),
        ..zoom(20.0)
    };
    let photos = ["b.jpg", "a.jpg"].map(|name| prepared(name, exif.clone()));
    let (set, report, warnings) = assembled(photos.to_vec(), &PhotosOptions::default());
    assert_eq!(set.photos.len(), 2, "{:?}", warnings);
    assert_eq!(report.camera_groups.len(), 1);
}

#[test]
fn what_a_fisheye_shows_beyond_its_pinhole_is_told() {
    let mut intrinsics = Intrinsics::pinhole(64, 48, 30.0, 31.5, 23.5);
    intrinsics.distortion.fisheye = true;
    let camera = Some(GivenCamera {
        intrinsics,
        cam_from_world: None,
    });
    let options = PhotosOptions::default();
    // All but a corner: rays from 47 degrees on are beyond, along x from column 57.
    let mask = Mask::from_fn(64, 48, |x, y| x + y > 8);
    let mask = Some(GivenMask::as_stored(mask));
    let done = prepare(photo("a.jpg", zoom(20.0)), mask, camera, &options).unwrap();
    let beyond = done.facts.beyond_pinhole;
    assert!((0.2..0.6).contains(&beyond), "{beyond}");
    let (_, _, warnings) = assembled(vec![done], &options);
    assert!(
        warnings
            .iter()
            .any(|w| w.contains("outside the straightened photo")),
        "{warnings:?}"
    );
}

#[test]
fn a_given_camera_is_kept_bit_for_bit() {
    let mut intrinsics = Intrinsics::pinhole(64, 48, 71.123_456_789, 31.4, 23.7);
    intrinsics.distortion.k1 = -0.1;
    let camera = GivenCamera {
        intrinsics,
        cam_from_world: None,
    };
    let options = PhotosOptions::default();
    let done = prepare(
        photo("a.jpg", zoom(20.0)),
        Some(disc()),
        Some(camera),
        &options,
    )
    .unwrap();
    assert_eq!(done.facts.intrinsics, intrinsics);
    assert_eq!(done.facts.focal_source, FocalSource::CameraFile);
    assert_eq!(done.facts.beyond_pinhole, 0.0);
    assert!(
        done.facts
            .mask_coverage
            .is_some_and(|c| (0.15..0.3).contains(&c))
    );

    let camera = GivenCamera {
        intrinsics: Intrinsics::pinhole(48, 64, 71.0, 23.5, 31.5),
        cam_from_world: None,
    };
    let error = prepare(photo("a.jpg", zoom(20.0)), None, Some(camera), &options).unwrap_err();
    assert!(matches!(error, PhotosError::CameraSize { .. }), "{error}");

    for (fx, fy) in [(1e300, 71.0), (71.0, 1e-300), (3.0, 3.0)] {
        let camera = GivenCamera {
            intrinsics: Intrinsics {
                fx,
                fy,
                ..intrinsics
            },
            cam_from_world: None,
        };
        let error = prepare(photo("a.jpg", zoom(20.0)), None, Some(camera), &options).unwrap_err();
        assert!(matches!(error, PhotosError::CameraFocal { .. }), "{error}");
        let message = error.to_string();
        assert!(
            message.len() < 200 && message.contains("a.jpg"),
            "{message}"
        );
    }
}

#[test]
fn orientation_is_noted_and_changes_nothing() {
    let plain = prepared("a.jpg", ExifFacts::default());
    let plain_pixels = plain.pixels.load().unwrap();
    for orientation in 1..=8 {
        let turned = prepared(
            "a.jpg",
            ExifFacts {
                orientation: Some(orientation),
                ..ExifFacts::default()
            },
        );
        assert_eq!(turned.facts.orientation.number(), orientation);
        assert_eq!(turned.facts.intrinsics, plain.facts.intrinsics);
        assert_eq!(turned.pixels.load().unwrap(), plain_pixels);
    }
}

#[test]
fn masks_drawn_upright_are_turned_back_to_the_stored_frame() {
    // A bright object, alike under no turn, before a dark ground.
    let inside = |x: f64, y: f64| (8.0..30.0).contains(&x) && y > 5.0 && y < 40.0 - x;
    for (width, height) in [(96, 60), (80, 80)] {
        let stored = Mask::from_fn(width, height, |x, y| inside(x as f64, y as f64));
        let values = stored.data.iter();
        let decoded = |orientation| DecodedPhoto {
            width,
            height,
            samples: Samples::U8(
                values
                    .clone()
                    .enumerate()
                    .flat_map(|(i, &inside)| {
                        let grain = (i * 7 % 11) as u8;
                        [grain + if inside { 180 } else { 20 }; 3]
                    })
                    .collect(),
            ),
            ..photo(
                "a.jpg",
                ExifFacts {
                    orientation: Some(orientation),
                    ..ExifFacts::default()
                },
            )
        };
        for number in 1..=8 {
            let orientation = Orientation::of_exif(number).unwrap();
            let size = orientation.upright_size((width, height));
            let upright = Mask::from_fn(size.0, size.1, |x, y| {
                let at = orientation.to_stored([x as f64, y as f64], (width, height));
                inside(at[0], at[1])
            });
            for (given, was_upright) in [(&stored, false), (&upright, number != 1)] {
                let options = PhotosOptions::default();
                let mask = GivenMask {
                    mask: given.clone(),
                    may_be_upright: true,
                };
                let prepared = prepare(decoded(number), Some(mask), None, &options).unwrap();
                let found = prepared.mask.as_ref().unwrap().unpacked();
                assert!(
                    found == stored,
                    "{number}, {width} x {height}, {was_upright}"
                );
                assert_eq!(prepared.facts.mask_was_upright, was_upright, "{number}");
            }
        }
        // Upright by another turn than EXIF's.
        if width != height {
            let lying = Mask::from_fn(height, width, |x, y| inside(y as f64, x as f64));
            let mask = GivenMask {
                mask: lying,
                may_be_upright: true,
            };
            let refused = prepare(decoded(1), Some(mask), None, &PhotosOptions::default());
            assert!(matches!(refused, Err(PhotosError::MaskSize { .. })));
        }
    }
}

#[test]
fn a_mask_is_not_turned_onto_edges_that_are_no_outline() {
    // The object is hardly brighter than what is behind it; half turned, its border crosses a bright stripe.
    let (width, height) = (96, 60);
    let inside = |x: f64, y: f64| (x - 30.0).hypot(y - 28.0) < 16.0;
    let mask = Mask::from_fn(width, height, |x, y| inside(x as f64, y as f64));
    let value = |x: usize, y: usize| -> u8 {
        let stripe = (78..82).contains(&x);
        let grain = ((x * 7 + y * 13) % 11) as u8;
        match (stripe, inside(x as f64, y as f64)) {
            (true, _) => 150,
            (false, true) => 104 + grain,
            (false, false) => 100 + grain,
        }
    };
    let decoded = DecodedPhoto {
        width,
        height,
        samples: Samples::U8(
            (0..height)
                .flat_map(|y| (0..width).flat_map(move |x| [value(x, y); 3]))
                .collect(),
        ),
        ..photo(
            "a.jpg",
            ExifFacts {
                orientation: Some(3),
                ..ExifFacts::default()
            },
        )
    };
    for may_be_upright in [true, false] {
        let given = GivenMask {
            mask: mask.clone(),
            may_be_upright,
        };
        let options = PhotosOptions::default();
        let prepared = prepare(decoded.clone(), Some(given), None, &options).unwrap();
        assert!(!prepared.facts.mask_was_upright);
        assert!(prepared.mask.unwrap().unpacked() == mask);
    }
}

#[test]
fn facts_survive_json() {
    let facts = prepared("ä b.jpg", zoom(20.0)).facts;
    let text = serde_json::to_string(&facts).unwrap();
    assert_eq!(
        serde_json::from_str::<rilievo_photos::PhotoFacts>(&text).unwrap(),
        facts
    );
}

#[test]
fn photos_that_cannot_be_used_are_named() {
    let options = PhotosOptions::default();
    let mut small = photo("small.jpg", ExifFacts::default());
    (small.width, small.height) = (1, 1);
    small.samples = Samples::U8(vec![1, 2, 3]);
    let error = prepare(small, None, None, &options)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("small.jpg") && error.contains("1 x 1"),
        "{error}"
    );

    let mut blank = photo("blank.jpg", ExifFacts::default());
    blank.samples = Samples::U8(vec![7; 64 * 48 * 3]);
    let error = prepare(blank, None, None, &options).unwrap_err();
    assert!(matches!(error, PhotosError::Blank { .. }), "{error}");

    // Each empty picture with its own reason.
    for (samples, reason, not) in [
        (Samples::U8(vec![0; 64 * 48 * 3]), "lens cap", "overexposed"),
        (
            Samples::U8(vec![255; 64 * 48 * 3]),
            "overexposed",
            "lens cap",
        ),
        (
            Samples::F32(vec![f32::NAN; 64 * 48 * 3]),
            "finite numbers",
            "lens cap",
        ),
        (
            Samples::F32(
                (0..64 * 48 * 3)
                    .map(|i| if i == 9 { 3e38 } else { 0.5 })
                    .collect(),
            ),
            "3e38",
            "lens cap",
        ),
    ] {
        let mut empty = photo("empty.tif", ExifFacts::default());
        empty.linear_by_metadata = matches!(samples, Samples::F32(_));
        empty.samples = samples;
        let error = prepare(empty, None, None, &options)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("empty.tif") && error.contains(reason) && !error.contains(not),
            "{error}"
        );
    }

    let mut short = photo("short.jpg", ExifFacts::default());
    short.samples = Samples::U8(vec![7; 10]);
    assert!(matches!(
        prepare(short, None, None, &options),
        Err(PhotosError::Samples { found: 10, .. })
    ));

    let mut float = photo("nan.exr", ExifFacts::default());
    let mut samples: Vec<f32> = (0..64 * 48 * 3).map(|i| i as f32 * 1e-4).collect();
    samples[5] = f32::NAN;
    samples[100] = f32::INFINITY;
    float.samples = Samples::F32(samples);
    float.linear_by_metadata = true;
    let done = prepare(float, None, None, &options).unwrap();
    assert_eq!(done.facts.num_invalid_px, 2);
    assert!(
        done.pixels
            .load()
            .unwrap()
            .data
            .iter()
            .all(|v| v.is_finite())
    );
}

#[test]
fn a_set_with_two_equal_names_or_no_photo_is_refused() {
    let options = PhotosOptions::default();
    let twins = vec![prepared("a.jpg", zoom(20.0)), prepared("a.png", zoom(20.0))];
    let error = assemble(twins, &options, &Silent).unwrap_err();
    assert!(
        matches!(error, PhotosError::DuplicateName { .. }),
        "{error}"
    );
    assert_eq!(
        assemble(Vec::new(), &options, &Silent).unwrap_err(),
        PhotosError::NoPhotos
    );
}

#[test]
fn options_out_of_range_are_refused_by_name() {
    let options = PhotosOptions {
        clip_fraction: f64::NAN,
        ..PhotosOptions::default()
    };
    let error = options.validate().unwrap_err().to_string();
    assert!(error.contains("clip_fraction"), "{error}");
}

#[test]
fn exposure_that_varies_is_told() {
    let with = |time: f64| ExifFacts {
        exposure_time_s: Some(time),
        f_number: Some(8.0),
        iso: Some(100.0),
        ..zoom(20.0)
    };
    let photos = vec![prepared("a.jpg", with(0.01)), prepared("b.jpg", with(0.02))];
    let (_, report, warnings) = assembled(photos, &PhotosOptions::default());
    let spread = report.exposure_spread_ev;
    assert!(
        spread.is_some_and(|s| (s - 1.0).abs() < 1e-12),
        "{spread:?}"
    );
    assert!(
        warnings.iter().any(|w| w.contains("exposure")),
        "{:?}",
        warnings
    );
}

/// Photos of one scene at exposures of 1, 2 and 4, and what is left of the difference.
fn bracketed(options: &PhotosOptions) -> (Vec<f32>, Vec<f32>, PhotosReport, Vec<String>) {
    let photos = [0.01, 0.02, 0.04].into_iter().enumerate();
    let photos = photos.map(|(i, time)| {
        let exif = ExifFacts {
            exposure_time_s: Some(time),
            f_number: Some(8.0),
            iso: Some(100.0),
            ..zoom(20.0)
        };
        let mut photo = at_level(&format!("{i}.jpg"), time / 0.01 * 0.2, exif);
        photo.facts.clip_level = 1.0;
        photo
    });
    let (set, report, warnings) = assembled(photos.collect(), options);
    let first = |p: &rilievo_scene::Photo| p.pixels.load().unwrap().data[200];
    (
        set.photos.iter().map(first).collect(),
        set.photos.iter().map(|p| p.clip_level).collect(),
        report,
        warnings,
    )
}

#[test]
fn exposures_that_exif_tells_are_evened_out() {
    let (values, clip, report, warnings) = bracketed(&PhotosOptions::default());
    for (i, value) in values.iter().enumerate() {
        let error = (value / values[1] - 1.0).abs();
        assert!(error < 1e-5, "{i}: {values:?}");
    }
    // A pixel that was clipped at the short exposure is so at its new level.
    assert!((clip[0] / clip[1] - 2.0).abs() < 1e-5, "{clip:?}");
    assert_eq!(report.exposure_gains, [2.0, 1.0, 0.5]);
    assert!(report.level_spread_ev.abs() < 1e-5, "{report:?}");
    assert!(
        warnings.iter().any(|w| w.contains("evened out")),
        "{:?}",
        warnings
    );
    // Where EXIF is not to be trusted, the photos stay as they are.
    let (values, _, report, _) = bracketed(&PhotosOptions {
        normalize_exposure: false,
        ..PhotosOptions::default()
    });
    assert!((values[2] / values[0] - 4.0).abs() < 1e-4, "{values:?}");
    assert!(report.exposure_gains.is_empty());
}

/// A prepared photo of another brightness.
fn at_level(file_name: &str, scale: f64, exif: ExifFacts) -> PreparedPhoto {
    let mut decoded = photo(file_name, exif);
    let samples = (0..decoded.width * decoded.height * 3).map(|i| (i % 251) as f64 / 250.0 * scale);
    decoded.samples = Samples::F32(samples.map(|v| v as f32).collect());
    decoded.linear_by_metadata = true;
    prepare(decoded, None, None, &PhotosOptions::default()).unwrap()
}

#[test]
fn levels_that_no_fixed_exposure_explains_are_refused_unless_exif_tells_or_they_are_forced() {
    let mut options = PhotosOptions::default();
    let set = |exif: &ExifFacts| {
        vec![
            at_level("dark.exr", 0.01, exif.clone()),
            at_level("bright.exr", 0.9, exif.clone()),
        ]
    };
    let error = assemble(set(&zoom(20.0)), &options, &Silent)
        .unwrap_err()
        .to_string();
    for expected in ["dark.exr", "bright.exr", "6.5 EV", "max_level_spread_ev"] {
        assert!(error.contains(expected), "{error}");
    }
    let told = ExifFacts {
        exposure_time_s: Some(0.01),
        f_number: Some(8.0),
        iso: Some(100.0),
        ..zoom(20.0)
    };
    assert!(assemble(set(&told), &options, &Silent).is_ok());
    options.max_level_spread_ev = 10.0;
    assert!(assemble(set(&zoom(20.0)), &options, &Silent).is_ok());
}

#[test]
fn a_blurred_photo_among_sharp_ones_is_told() {
    let mut photos: Vec<PreparedPhoto> = ["a.jpg", "b.jpg", "c.jpg"]
        .map(|name| prepared(name, zoom(20.0)))
        .to_vec();
    let mut blurred = photo("d.jpg", zoom(20.0));
    let smooth = |i: usize| (100.0 + 80.0 * (i as f64 / 900.0).sin()) as u8;
    blurred.samples = Samples::U8((0..blurred.samples.len()).map(smooth).collect());
    photos.push(prepare(blurred, None, None, &PhotosOptions::default()).unwrap());
    let (_, _, warnings) = assembled(photos, &PhotosOptions::default());
    let told = warnings.iter().find(|w| w.contains("sharp"));
    assert!(
        told.is_some_and(|w| w.starts_with("d.jpg")),
        "{:?}",
        warnings
    );
}

#[test]
fn the_table_names_every_photo_and_what_is_wrong() {
    let options = PhotosOptions::default();
    let turned = ExifFacts {
        orientation: Some(6),
        ..ExifFacts::default()
    };
    let with_mask = prepare(photo("b.jpg", zoom(20.0)), Some(disc()), None, &options).unwrap();
    let photos = vec![prepared("a long name.jpg", turned), with_mask];
    let (_, report, warnings) = assembled(photos, &options);
    let table = report.table(&warnings).to_string();
    for expected in [
        "a long name.jpg",
        "64 x 48",
        "orientation 6",
        "masks: 1/2",
        "warning: ",
    ] {
        assert!(table.contains(expected), "{table}");
    }
}
