//! The asset of a sphere with waves that its normals alone tell, drawn again as a renderer does.

// Helpers outside the test functions may fail as these may.
use nalgebra::{Point2, Point3, Vector3};
use rilievo_fusion::{AssetReport, FusionOptions, Inputs, MeshFormat, run};
use rilievo_scene::{
    Asset, Intrinsics, LinearImage, MemoryScratch, PhotoSet, PointCloud, PosedViews, ShadedViews,
    Silent,
};
use rilievo_synthetic::testing::{Maps, look_at, on_sphere, photo, posed_view};

const SIDE: usize = 160;
const FOCAL: f64 = 240.0;
const DISTANCE: f64 = 6.0;

/// Normal of the waves at a place of the unit sphere.
fn waved(at: &Vector3<f64>) -> Vector3<f64> {
    let wave = Vector3::new((9.0 * at.y).sin(), (9.0 * at.z).sin(), (9.0 * at.x).sin());
    (at + 0.15 * wave).normalize()
}

/// Relative albedo at a place of the unit sphere.
fn albedo(at: &Vector3<f64>) -> [f64; 3] {
    [1.0 + 0.3 * at.x, 1.0, 1.0 - 0.3 * at.x]
}

fn world() -> (PhotoSet, PosedViews, ShadedViews) {
    let middle = 0.5 * (SIDE as f64 - 1.0);
    let camera = Intrinsics::pinhole(SIDE, SIDE, FOCAL, middle, middle);
    let mut all = (
        PhotoSet::default(),
        PosedViews::default(),
        ShadedViews::default(),
    );
    for k in 0..8 {
        let angle = std::f64::consts::TAU * k as f64 / 8.0;
        let height = if k % 2 == 0 { 0.5 } else { -0.5 };
        let center = Point3::new(angle.sin(), height, -angle.cos()) * (DISTANCE / 1.25_f64.sqrt());
        let pose = look_at(center, Point3::origin(), -Vector3::y());
        let to_world = pose.rotation.inverse();
        let place = |pixel: [f64; 2]| {
            let (depth, normal) = on_sphere(&pose.translation, 1.0, &camera, pixel)?;
            Some((depth, to_world * normal))
        };
        let maps = Maps::of(&camera, |pixel| {
            let (depth, at) = place(pixel)?;
            Some((depth, pose.rotation * waved(&at)))
        });
        // As stage 5 leaves it: nothing beside the object.
        let mut image = LinearImage::filled(SIDE, SIDE, 3, 0.0);
        for y in 0..SIDE {
            for x in 0..SIDE {
                if let Some((_, at)) = place([x as f64, y as f64]) {
                    let shown = albedo(&at).map(|a| a as f32);
                    image.pixel_mut(x, y).copy_from_slice(&shown);
                }
            }
        }
        let name = format!("IMG_{k}");
        let file_name = format!("{name}.png");
        let mut shaded = maps.shaded(k, &name);
        shaded.albedo = Some(image.clone());
        all.0.photos.push(photo(&file_name, image, camera));
        all.1.views.push(posed_view(k, &file_name, camera, pose));
        all.2.views.push(shaded);
    }
    all
}

fn asset_of(options: &FusionOptions) -> Option<(Asset, AssetReport)> {
    let (photos, posed, shaded) = world();
    let inputs = Inputs {
        photos: &photos,
        posed: &posed,
        maps: &shaded,
        scratch: &MemoryScratch,
    };
    let fused = run(inputs, &mut PointCloud::default(), options, &Silent).expect("fused");
    fused.asset.zip(fused.report.asset)
}

fn three(values: &[[f32; 3]], corners: [u32; 3], weights: [f64; 3]) -> Vector3<f64> {
    let parts = corners.iter().zip(weights);
    parts
        .map(|(&v, w)| Vector3::from(values[v as usize].map(f64::from)) * w)
        .sum()
}

/// A texture between its texels, 0 to 1.
fn sampled(texture: &rilievo_scene::Raster<[u16; 3]>, [u, v]: [f64; 2]) -> Vector3<f64> {
    let (x, y) = (
        u * texture.width as f64 - 0.5,
        v * texture.height as f64 - 0.5,
    );
    let (x0, y0) = (x.floor(), y.floor());
    let at = |dx: f64, dy: f64| {
        let clamp = |c: f64, size: usize| c.clamp(0.0, size as f64 - 1.0) as usize;
        let texel = texture.at(
            clamp(x0 + dx, texture.width),
            clamp(y0 + dy, texture.height),
        );
        Vector3::from(texel.map(|c| f64::from(c) / 65535.0))
    };
    let (fx, fy) = (x - x0, y - y0);
    let row = |dy: f64| at(0.0, dy) * (1.0 - fx) + at(1.0, dy) * fx;
    row(0.0) * (1.0 - fy) + row(1.0) * fy
}

/// What a renderer draws at a place of a triangle: place, normal, and base colour.
fn drawn(asset: &Asset, triangle: usize, weights: [f64; 3]) -> [Vector3<f64>; 3] {
    let corners = asset.mesh.triangles[triangle];
    let normal = three(&asset.mesh.normals, corners, weights);
    let tangents: Vec<[f32; 3]> = asset
        .tangents
        .iter()
        .map(|&[x, y, z, _]| [x, y, z])
        .collect();
    let tangent = three(&tangents, corners, weights);
    let bitangent = normal.cross(&tangent) * f64::from(asset.tangents[corners[0] as usize][3]);
    let mut coords = [0.0; 2];
    for (&v, w) in corners.iter().zip(weights) {
        let [u, v] = asset.texture_coords[v as usize].map(f64::from);
        coords = [coords[0] + u * w, coords[1] + v * w];
    }
    let map = sampled(&asset.normal, coords) * 2.0 - Vector3::repeat(1.0);
    let normal = tangent * map.x + bitangent * map.y + normal * map.z;
    [
        three(&asset.mesh.vertices, corners, weights),
        normal.normalize(),
        sampled(&asset.base_color, coords),
    ]
}

fn light() -> FusionOptions {
    FusionOptions {
        asset_faces: 1500,
        ..FusionOptions::default()
    }
}

#[test]
fn a_light_sphere_is_drawn_with_the_waves_and_colours_of_the_full_one() {
    let (asset, report) = asset_of(&light()).expect("an asset");
    let mesh = &asset.mesh;
    assert!((800..=1500).contains(&mesh.triangles.len()), "{report:?}");
    assert_eq!(mesh.vertices.len(), asset.tangents.len());
    assert_eq!(mesh.vertices.len(), asset.texture_coords.len());
    assert!(
        report.used_share > 0.45 && report.unseen_share < 0.1,
        "{report:?}"
    );
    assert!(!report.is_bounded, "{report:?}");
    let (mut angles, mut colors, mut flat) = (Vec::new(), Vec::new(), Vec::new());
    for triangle in 0..mesh.triangles.len() {
        for weights in [[0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6]] {
            let [place, normal, color] = drawn(&asset, triangle, weights);
            let at = place.normalize();
            // The poles, which no camera faces, are left out.
            if at.y.abs() > 0.7 {
                continue;
            }
            angles.push(normal.angle(&waved(&at)).to_degrees());
            flat.push(at.angle(&waved(&at)).to_degrees());
            let expected = Vector3::from(albedo(&at)) * 0.5;
            colors.push((color - expected).norm() / expected.norm());
        }
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    assert!(mean(&flat) > 5.0, "the waves are {}", mean(&flat));
    assert!(mean(&angles) < 0.6, "{}", mean(&angles));
    assert!(mean(&colors) < 0.01, "{}", mean(&colors));
    let worst = colors.iter().copied().fold(0.0, f64::max);
    assert!(worst < 0.06, "{worst}");
    // A convex object hides the sky from none of its places.
    let mut open: Vec<u8> = asset.occlusion.data.clone();
    open.sort_unstable();
    assert!(open[open.len() / 20] > 240, "{}", open[open.len() / 20]);
}

#[test]
fn charts_do_not_overlap_and_tangents_follow_the_texture() {
    let (asset, _) = asset_of(&light()).expect("an asset");
    let (width, height) = (asset.normal.width, asset.normal.height);
    let mut owners = vec![0_u8; width * height];
    for t in &asset.mesh.triangles {
        let [a, b, c] = t.map(|v| {
            let [u, v] = asset.texture_coords[v as usize].map(f64::from);
            assert!((0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v));
            Point2::new(u * width as f64 - 0.5, v * height as f64 - 0.5)
        });
        let twice = |p: &Point2<f64>, q: &Point2<f64>, r: &Point2<f64>| (q - p).perp(&(r - p));
        let area = twice(&a, &b, &c);
        let range =
            |low: f64, high: f64| low.ceil().max(0.0) as usize..=high.floor().max(0.0) as usize;
        for y in range(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y)) {
            for x in range(a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x)) {
                let p = Point2::new(x as f64, y as f64);
                let inside = [twice(&b, &c, &p), twice(&c, &a, &p), twice(&a, &b, &p)];
                // Well inside: neighbours share their edges.
                if inside.iter().all(|w| w / area > 0.02) {
                    owners[y * width + x] += 1;
                }
            }
        }
        // The direction in which u grows, and in which v falls.
        let at = |k: usize| Vector3::from(asset.mesh.vertices[t[k] as usize].map(f64::from));
        let (e1, e2) = (at(1) - at(0), at(2) - at(0));
        let (d1, d2) = (b - a, c - a);
        if d1.perp(&d2).abs() < 0.5 {
            continue;
        }
        let right = (e1 * d2.y - e2 * d1.y) / d1.perp(&d2);
        let down = (e2 * d1.x - e1 * d2.x) / d1.perp(&d2);
        for &v in t {
            let [x, y, z, sign] = asset.tangents[v as usize].map(f64::from);
            let tangent = Vector3::new(x, y, z);
            let normal = Vector3::from(asset.mesh.normals[v as usize].map(f64::from));
            assert!((tangent.norm() - 1.0).abs() < 1e-3 && tangent.dot(&normal).abs() < 1e-3);
            // A tangent lies across its vertex's normal, from which a triangle at the rim turns away by up to 75 degrees.
            let across = |d: Vector3<f64>| d - normal * normal.dot(&d);
            let (right, down) = (across(right), across(down));
            assert!(
                tangent.dot(&right) > 0.5 * right.norm(),
                "{tangent} {right}"
            );
            let up = normal.cross(&tangent) * sign;
            assert!(up.dot(&-down) > 0.5 * down.norm(), "{up} {down}");
        }
    }
    assert!(owners.iter().all(|&num| num <= 1), "charts overlap");
}

#[test]
fn textures_are_bounded_and_an_asset_is_made_where_asked_for_alone() {
    // A mesh that was made light before is looked for as far away as it was moved.
    let lighter = FusionOptions {
        max_num_triangles: 300,
        ..FusionOptions::default()
    };
    let (_, report) = asset_of(&lighter).expect("an asset");
    assert!(report.unseen_share < 0.1, "{report:?}");
    let small = FusionOptions {
        asset_texture: 128,
        ..light()
    };
    let (asset, report) = asset_of(&small).expect("an asset");
    assert!(asset.normal.width <= 128 && asset.normal.height <= 128 && report.is_bounded);
    let without = FusionOptions {
        formats: vec![MeshFormat::Glb],
        ..FusionOptions::default()
    };
    assert!(asset_of(&without).is_none());
    let no_mesh = FusionOptions {
        mesh: false,
        ..FusionOptions::default()
    };
    assert!(asset_of(&no_mesh).is_none());
}
