//! What must not matter: units, exposure, orientation, threads, and a far camera's projection.

use super::solved;
use super::surface::Surface;
use rilievo_scene::{DepthMap, Lighting, LinearImage, Mask, SphericalHarmonics};
use rilievo_shading::paper::{PaperOptions, Projection, ShadingView, ViewLight};
use std::sync::Arc;

#[test]
fn scales_of_scene_and_intensity_do_not_matter() {
    let base = Surface::new(96);
    let reference = solved(base.view(3), &PaperOptions::default());
    let larger = Surface {
        scale: 200.0,
        ..Surface::new(96)
    };
    let brighter = Surface {
        intensity: 7.0,
        ..Surface::new(96)
    };
    for (other, factor) in [(larger, 100.0), (brighter, 1.0)] {
        let solution = solved(other.view(3), &PaperOptions::default());
        let worst = reference.views[0]
            .depth
            .data
            .iter()
            .zip(&solution.views[0].depth.data)
            .map(|(a, b)| (a * factor - b).abs() / factor)
            .fold(0.0, f32::max);
        assert!(worst < 2e-3, "{worst} at factor {factor}");
    }
}

#[test]
fn a_quarter_turn_of_image_and_light_turns_the_result() {
    let surface = Surface::new(96);
    let view = surface.view(3);
    let size = surface.size;
    // New (x, y) shows old (y, size − 1 − x): the frame turns by 90°, n → (−n₂, n₁, n₃).
    let turn = |x: usize, y: usize| (y, size - 1 - x);
    let ViewLight::Uniform(light) = &view.lighting else {
        panic!("uniform by construction")
    };
    let turned_light = Lighting {
        channels: light
            .channels
            .iter()
            .map(|row| {
                let l = row.0;
                // l · h(n) with n₁ = m₂, n₂ = −m₁ for the turned normal m.
                SphericalHarmonics([-l[1], l[0], l[2], l[3], -l[4], -l[6], l[5], -l[7], l[8]])
            })
            .collect(),
    };
    let mut image = LinearImage::filled(size, size, 3, 0.0);
    for y in 0..size {
        for x in 0..size {
            let (u, v) = turn(x, y);
            image
                .pixel_mut(x, y)
                .copy_from_slice(view.image.pixel(u, v));
        }
    }
    let rough = surface.rough();
    let mut turned = ShadingView::new(
        "turned",
        Arc::new(image),
        Mask::from_fn(size, size, |x, y| {
            let (u, v) = turn(x, y);
            *view.mask.at(u, v)
        }),
        surface.camera(),
        ViewLight::Uniform(turned_light),
    );
    turned.initial_depth = Some(DepthMap::from_fn(size, size, |x, y| {
        let (u, v) = turn(x, y);
        *rough.at(u, v)
    }));
    let straight = solved(view, &PaperOptions::default());
    let turned = solved(turned, &PaperOptions::default());
    let mut worst = 0.0_f32;
    for y in 0..size {
        for x in 0..size {
            let (u, v) = turn(x, y);
            let difference = turned.views[0].depth.at(x, y) - straight.views[0].depth.at(u, v);
            worst = worst.max(difference.abs());
        }
    }
    assert!(worst < 5e-3, "{worst}");
}

#[test]
fn orthographic_and_perspective_agree_as_the_focal_length_grows() {
    let mut distances = Vec::new();
    for focal in [2.0, 50.0] {
        let surface = Surface {
            focal: focal * 192.0,
            ..Surface::new(192)
        };
        let perspective = solved(surface.view(3), &PaperOptions::default());
        let mut view = surface.view(3);
        // Parallel rays: magnification f/z₀ pixels per unit of depth.
        let magnification = surface.focal / surface.scale;
        view.intrinsics.fx = magnification;
        view.intrinsics.fy = magnification;
        let options = PaperOptions {
            projection: Projection::Orthographic,
            ..PaperOptions::default()
        };
        let orthographic = solved(view, &options);
        // Colours fix the normals in either projection: depth tells them apart, in units of the
        // relief, after the free offset. The median, since a few pixels may settle elsewhere.
        let mut ratios: Vec<f64> = perspective.views[0]
            .depth
            .data
            .iter()
            .zip(&orthographic.views[0].depth.data)
            .filter(|(z, _)| **z > 0.0)
            .map(|(a, b)| f64::from(a / b).ln() * surface.focal / surface.size as f64)
            .collect();
        let offset = rilievo_numerics::robust::median(&mut ratios).expect("pixels");
        let mut away: Vec<f64> = ratios.iter().map(|r| (r - offset).abs()).collect();
        distances.push(rilievo_numerics::robust::median(&mut away).expect("pixels"));
    }
    assert!(
        distances[1] < 0.01 && distances[1] < 0.5 * distances[0],
        "{distances:?}"
    );
}

#[test]
fn thread_count_does_not_change_a_bit() {
    let surface = Surface::new(160);
    let with = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool")
            .install(|| solved(surface.view(3), &PaperOptions::default()))
    };
    assert_eq!(with(1).views[0].depth.data, with(3).views[0].depth.data);
}
