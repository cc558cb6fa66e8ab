use super::*;
use crate::mat::sample;
use crate::{write_mask, write_photo_deep};
use nalgebra::{Point3, Rotation3};
use rilievo_scene::Raster;

const SIZE: (usize, usize) = (6, 4);
const INTENSITIES: [[f64; 3]; 2] = [[2.0, 1.0, 0.5], [4.0, 4.0, 4.0]];

/// A view of one lamp from the upper right and one from the viewer, of a surface of known normals.
fn write_view(folder: &Path, compress: bool) {
    std::fs::create_dir_all(folder).unwrap();
    let (width, height) = SIZE;
    std::fs::write(folder.join("filenames.txt"), "001.png\r\n002.png\r\n").unwrap();
    std::fs::write(
        folder.join("light_directions.txt"),
        "0.3 0.4 0.866\n0 0 1\n",
    )
    .unwrap();
    let rows = INTENSITIES.map(|[r, g, b]| format!("{r} {g} {b}\n"));
    std::fs::write(folder.join("light_intensities.txt"), rows.concat()).unwrap();
    for (name, intensity) in ["001.png", "002.png"].iter().zip(INTENSITIES) {
        let mut image = LinearImage::filled(width, height, 3, 0.0);
        for (i, value) in image.data.iter_mut().enumerate() {
            *value = 0.2 * intensity[i % 3] as f32;
        }
        write_photo_deep(&folder.join(name), &image).unwrap();
    }
    let mask = Raster::from_fn(width, height, |x, _| x > 0);
    write_mask(&folder.join("mask.png"), &mask).unwrap();
    // By columns: x, y and z of every pixel, top rows first; leaning to the upper right.
    let plane = |value: f64| vec![value; width * height];
    let values = [plane(0.36), plane(0.48), plane(0.8)].concat();
    let dims = [height as i32, width as i32, 3];
    let array = sample::array("Normal_gt", &dims, &values);
    let array = if compress {
        sample::compressed(&array)
    } else {
        array
    };
    std::fs::write(
        folder.join("Normal_gt.mat"),
        [sample::header(), array].concat(),
    )
    .unwrap();
}

/// Rows of a matrix as MATLAB stores it, by columns.
fn by_columns(rows: &Matrix3<f64>) -> Vec<f64> {
    rows.as_slice().to_vec()
}

#[test]
fn one_view_has_lamps_and_normals_in_our_axes() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("ballPNG");
    write_view(&place, false);
    assert!(is_diligent(&place) && !is_diligent(folder.path()));
    let object = read_diligent(&place).unwrap();
    let [view] = object.views.as_slice() else {
        panic!("{object:?}");
    };
    assert_eq!(
        (view.name.as_str(), view.camera.is_none()),
        ("ballPNG", true)
    );
    let length = (0.3_f64 * 0.3 + 0.4 * 0.4 + 0.866 * 0.866).sqrt();
    let [x, y, z] = view.photos[0].towards_light.map(|v| v * length);
    // To the upper right of the viewer's side: x right, up is -y, towards the camera is -z.
    assert!(
        (x - 0.3).abs() + (y + 0.4).abs() + (z + 0.866).abs() < 1e-12,
        "{x} {y} {z}"
    );
    let normal = view.normal.as_ref().unwrap();
    assert_eq!(*normal.at(3, 2), [0.36, -0.48, -0.8]);
    assert_eq!(*normal.at(0, 2), [0.0; 3]);
    for photo in &view.photos {
        let image = read_diligent_photo(photo).unwrap();
        let worst = image
            .data
            .iter()
            .fold(0.0_f32, |w, v| w.max((v - 0.2).abs()));
        // Half a step of 16 bits over the weakest lamp.
        assert!(worst < 0.5 / 65_535.0 / 0.5 + 1e-7, "{worst}");
    }
}

#[test]
fn cameras_of_several_views_project_as_the_calibration_does() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("bearPNG");
    let k = Matrix3::new(3772.0, 0.0, 305.9, 0.0, 3759.0, 281.1, 0.0, 0.0, 1.0);
    let mut arrays = sample::compressed(&sample::array("KK", &[3, 3], &by_columns(&k)));
    let point = Point3::new(12.0, -7.0, 30.0);
    let mut expected = Vec::new();
    for view in 1..=2 {
        write_view(&place.join(format!("view_{view:02}")), true);
        let rotation = Rotation3::from_euler_angles(0.3 * f64::from(view), -0.4, 2.8).into_inner();
        let translation = Vector3::new(5.0, -3.0, 1500.0 + f64::from(view));
        arrays.extend(sample::array(
            &format!("Rc_{view}"),
            &[3, 3],
            &by_columns(&rotation),
        ));
        let name = format!("Tc_{view}");
        arrays.extend(sample::array(&name, &[3, 1], translation.as_slice()));
        let pixel = k * (rotation * point.coords + translation);
        expected.push((pixel.x / pixel.z, pixel.y / pixel.z));
    }
    std::fs::write(
        place.join("Calib_Results.mat"),
        [sample::header(), arrays].concat(),
    )
    .unwrap();
    let object = read_diligent(&place).unwrap();
    assert_eq!(object.views.len(), 2);
    let metres = Point3::from(point.coords * METRES_PER_MM);
    for (view, (u, v)) in object.views.iter().zip(expected) {
        let camera = view.camera.as_ref().unwrap();
        assert_eq!((camera.intrinsics.width, camera.intrinsics.height), SIZE);
        let seen = camera.cam_from_world.unwrap().apply(&metres);
        let pixel = camera.intrinsics.project(&seen).unwrap();
        let error = (pixel.x - u).hypot(pixel.y - v);
        assert!(error < 1e-6, "{}: {error} px", view.name);
    }
}

#[test]
fn what_is_missing_or_contradicts_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("catPNG");
    let refused = |file: &str, content: &[u8], part: &str| {
        write_view(&place, false);
        let path = place.join(file);
        std::fs::write(&path, content).unwrap();
        let error = read_diligent(&place).unwrap_err().to_string();
        assert!(error.contains(part), "{file}: {error}");
        std::fs::remove_file(path).unwrap();
    };
    refused("light_directions.txt", b"0 0 1\n", "1 light directions");
    refused("light_directions.txt", b"0 0 1\n0 0 0\n", "002.png");
    refused("light_intensities.txt", b"1 1 1\n1 x 1\n", "line 2");
    let small = sample::array("Normal_gt", &[2, 2, 3], &[0.0; 12]);
    refused(
        "Normal_gt.mat",
        &[sample::header(), small].concat(),
        "[2, 2, 3]",
    );
    let missing = sample::array("KK", &[3, 3], &[1.0; 9]);
    std::fs::create_dir_all(place.join("view_01")).unwrap();
    refused(
        "Calib_Results.mat",
        &[sample::header(), missing].concat(),
        "Rc_1",
    );
    write_view(&place, false);
    std::fs::remove_file(place.join("mask.png")).unwrap();
    let error = read_diligent(&place).unwrap_err().to_string();
    assert!(error.contains("mask.png"), "{error}");
}
