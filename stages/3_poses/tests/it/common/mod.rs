//! Synthetic photo sets: cameras around points, keypoints and matches without any image.

#![allow(dead_code)]
use nalgebra::{Matrix3, Point2, Point3, Rotation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rilievo_poses::PosesOptions;
use rilievo_scene::{
    FeatureMatches, Intrinsics, Keypoint, LinearImage, PairMatches, PhotoIdx, PhotoKeypoints,
    PhotoSet, PosedViews, RigidTransform,
};
use rilievo_synthetic::testing::{self, photo};

/// What a synthetic set is like.
#[derive(Clone)]
pub struct WorldOptions {
    pub num_views: usize,
    /// Angle that the ring of cameras spans, degrees.
    pub span_deg: f64,
    pub num_points: usize,
    pub noise_px: f64,
    /// Share of matches that are wrong.
    pub outlier_share: f64,
    /// Points on a plane instead of in a ball.
    pub planar: bool,
    /// Farthest neighbour in the ring that a view matches.
    pub reach: usize,
    pub seed: u64,
}

impl Default for WorldOptions {
    fn default() -> Self {
        Self {
            num_views: 6,
            span_deg: 90.0,
            num_points: 400,
            noise_px: 0.0,
            outlier_share: 0.0,
            planar: false,
            reach: usize::MAX,
            seed: 7,
        }
    }
}

/// A set with its truth.
pub struct World {
    pub photos: PhotoSet,
    pub matches: FeatureMatches,
    pub cam_from_world: Vec<RigidTransform>,
}

pub fn camera() -> Intrinsics {
    Intrinsics::pinhole(1200, 900, 1300.0, 599.5, 449.5)
}

/// A camera at `center` that looks at `target`.
pub fn look_at(center: Point3<f64>, target: Point3<f64>) -> RigidTransform {
    testing::look_at(center, target, Vector3::z())
}

pub fn world(options: &WorldOptions) -> World {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let full_turn = options.span_deg >= 360.0;
    let steps = if full_turn {
        options.num_views
    } else {
        options.num_views.max(2) - 1
    };
    let poses: Vec<RigidTransform> = (0..options.num_views)
        .map(|k| {
            let angle = (options.span_deg * k as f64 / steps as f64).to_radians();
            let height = 0.8 + 0.3 * (1.7 * k as f64).sin();
            let center = Point3::new(3.0 * angle.cos(), 3.0 * angle.sin(), height);
            look_at(center, Point3::new(0.0, 0.0, 0.0))
        })
        .collect();
    let points: Vec<Point3<f64>> = (0..options.num_points)
        .map(|_| {
            let mut p = Point3::new(
                rng.random_range(-0.8..0.8),
                rng.random_range(-0.8..0.8),
                rng.random_range(-0.6..0.6),
            );
            if options.planar {
                p.z = 0.0;
            }
            p
        })
        .collect();
    from_truth(options, poses, &points, &mut rng)
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

pub fn from_truth(
    options: &WorldOptions,
    poses: Vec<RigidTransform>,
    points: &[Point3<f64>],
    rng: &mut ChaCha8Rng,
) -> World {
    let camera = camera();
    let image = LinearImage::filled(camera.width, camera.height, 1, 0.5);
    let photos = (0..poses.len())
        .map(|k| photo(&format!("v{k:03}.png"), image.clone(), camera))
        .collect();
    // Keypoint k of every photo is point k: a permutation would only hide mistakes of the test.
    let lists = poses
        .iter()
        .map(|pose| PhotoKeypoints {
            keypoints: points
                .iter()
                .map(|p| {
                    let pixel = camera
                        .project(&pose.apply(p))
                        .unwrap_or(Point2::new(-1.0, -1.0));
                    Keypoint {
                        x: (pixel.x + options.noise_px * normal(rng)) as f32,
                        y: (pixel.y + options.noise_px * normal(rng)) as f32,
                        size_px: 3.0,
                        angle_rad: 0.0,
                        response: 1.0,
                        bright: true,
                        on_object: true,
                    }
                })
                .collect(),
            descriptors: Vec::new(),
        })
        .collect();
    let num = poses.len();
    let mut pairs = Vec::new();
    for i in 0..num {
        for j in i + 1..num {
            let apart = (j - i).min(if options.span_deg >= 360.0 {
                num - (j - i)
            } else {
                usize::MAX
            });
            if apart > options.reach {
                continue;
            }
            let relative = poses[j].compose(&poses[i].inverse());
            let direction = relative.translation.try_normalize(1e-12);
            let matches: Vec<[u32; 2]> = (0..points.len() as u32)
                .map(|k| {
                    if rng.random::<f64>() < options.outlier_share {
                        [k, rng.random_range(0..points.len() as u32)]
                    } else {
                        [k, k]
                    }
                })
                .collect();
            pairs.push(PairMatches {
                first: PhotoIdx(i),
                second: PhotoIdx(j),
                num_putative: matches.len(),
                standing: Vec::new(),
                matches,
                essential: direction.map(|t| t.cross_matrix() * relative.rotation_matrix()),
                homography_share: if options.planar || direction.is_none() {
                    1.0
                } else {
                    0.3
                },
            });
        }
    }
    World {
        photos: PhotoSet { photos },
        matches: FeatureMatches {
            photos: lists,
            pairs,
        },
        cam_from_world: poses,
    }
}

/// What a set of many views around an object is like.
#[derive(Clone)]
pub struct RingsOptions {
    pub num_views: usize,
    /// Keypoints of a photo, about.
    pub num_keypoints: usize,
    /// Photos that see a point, on average: those nearest to straight before it; more where the photos are so
    /// dense that more lie within `cone_deg` of that.
    pub track_length: f64,
    pub cone_deg: f64,
    pub noise_px: f64,
    /// Share of matches that are wrong, all near their epipolar line.
    pub outlier_share: f64,
    /// Share of the sightings that two photos have in common that are matched.
    pub matched_share: f64,
    pub seed: u64,
}

impl Default for RingsOptions {
    fn default() -> Self {
        Self {
            num_views: 32,
            num_keypoints: 400,
            track_length: 10.0,
            cone_deg: 20.0,
            noise_px: 0.5,
            outlier_share: 0.03,
            matched_share: 0.9,
            seed: 7,
        }
    }
}

/// Directions on rings about evenly spread over a band of heights.
fn ring_directions(num: usize) -> Vec<Vector3<f64>> {
    let (low, high) = (-0.35_f64, 0.85_f64);
    let num_rings = (num as f64 / 16.0).sqrt().round().max(1.0) as usize;
    (0..num)
        .map(|k| {
            let ring = k * num_rings / num;
            let first = (ring * num).div_ceil(num_rings);
            let next = ((ring + 1) * num).div_ceil(num_rings);
            let turn = std::f64::consts::TAU * (k - first) as f64 / (next - first) as f64;
            let z = low + (high - low) * (ring as f64 + 0.5) / num_rings as f64;
            let across = (1.0 - z * z).sqrt();
            Vector3::new(across * turn.cos(), across * turn.sin(), z)
        })
        .collect()
}

/// Many views on rings around an object, each of its points seen from about straight before it only, each view
/// matched with its nearest ones, as many as pair choice tries. No pixels: all photos share one grey image.
pub fn rings(options: &RingsOptions) -> World {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let num = options.num_views;
    let camera = camera();
    let directions = ring_directions(num);
    let poses: Vec<RigidTransform> = directions
        .iter()
        .map(|d| look_at(Point3::from(3.5 * d), Point3::origin()))
        .collect();
    // Cosine beyond which another view is not among the nearest.
    let nearness: Vec<f64> = directions
        .iter()
        .map(|d| {
            let mut cosines: Vec<f64> = directions.iter().map(|e| d.dot(e)).collect();
            cosines.sort_by(|a, b| b.total_cmp(a));
            cosines
                .get(1 + 12 * (num.max(2) as f64).log2() as usize)
                .copied()
                .unwrap_or(-1.0)
        })
        .collect();
    // The band of the rings has 0.6 of the sphere's area, and that of the points a little more.
    let cone = (1.0 - 2.0 * 0.6 * options.track_length / num as f64)
        .min(options.cone_deg.to_radians().cos())
        .max(0.3);
    let track_length = (1.0 - cone) / 1.2 * num as f64;
    let num_points = (options.num_keypoints as f64 * num as f64 / track_length).round() as usize;
    let is_near = |i: usize, j: usize| {
        let within = directions[i].dot(&directions[j]);
        within > nearness[i].min(nearness[j])
    };
    let grey = photo(
        "",
        LinearImage::filled(camera.width, camera.height, 1, 0.5),
        camera,
    );
    let mut lists = vec![PhotoKeypoints::default(); num];
    // Per photo: point of each keypoint.
    let mut point_of: Vec<Vec<usize>> = vec![Vec::new(); num];
    let mut shared = std::collections::BTreeMap::<(usize, usize), Vec<[u32; 2]>>::new();
    for point in 0..num_points {
        let z: f64 = rng.random_range(-0.45..0.95);
        let turn: f64 = rng.random_range(0.0..std::f64::consts::TAU);
        let across = (1.0 - z * z).sqrt();
        let d = Vector3::new(across * turn.cos(), across * turn.sin(), z);
        let bump = 0.08 * (7.0 * d.x).sin() + 0.08 * (5.0 * d.y + 4.0 * d.z).cos();
        let at = Point3::from((1.0 + bump) * d);
        let mut seen: Vec<(usize, u32)> = Vec::new();
        for k in 0..num {
            if directions[k].dot(&d) < cone {
                continue;
            }
            let Some(pixel) = camera.project(&poses[k].apply(&at)) else {
                continue;
            };
            seen.push((k, lists[k].keypoints.len() as u32));
            point_of[k].push(point);
            lists[k].keypoints.push(Keypoint {
                x: (pixel.x + options.noise_px * normal(&mut rng)) as f32,
                y: (pixel.y + options.noise_px * normal(&mut rng)) as f32,
                size_px: 3.0,
                angle_rad: 0.0,
                response: 1.0,
                bright: true,
                on_object: true,
            });
        }
        for (a, &(i, ki)) in seen.iter().enumerate() {
            for &(j, kj) in &seen[a + 1..] {
                if is_near(i, j) && rng.random::<f64>() < options.matched_share {
                    shared.entry((i, j)).or_default().push([ki, kj]);
                }
            }
        }
    }
    let mut pairs = Vec::new();
    for ((i, j), mut matches) in shared {
        if matches.len() < 20 {
            continue;
        }
        let relative = poses[j].compose(&poses[i].inverse());
        let essential =
            relative.translation.normalize().cross_matrix() * relative.rotation_matrix();
        let at = |photo: usize, k: u32| {
            let keypoint: &Keypoint = &lists[photo].keypoints[k as usize];
            camera.ray(&Point2::new(f64::from(keypoint.x), f64::from(keypoint.y)))
        };
        let num_others = lists[j].keypoints.len() as u32;
        for m in &mut matches {
            if rng.random::<f64>() < options.outlier_share {
                let line = essential * at(i, m[0]);
                let off = |k: &u32| (at(j, *k).dot(&line) / line.xy().norm()).abs();
                let others: Vec<u32> = (0..40).map(|_| rng.random_range(0..num_others)).collect();
                m[1] = others
                    .into_iter()
                    .min_by(|a, b| off(a).total_cmp(&off(b)))
                    .unwrap();
            }
        }
        pairs.push(PairMatches {
            first: PhotoIdx(i),
            second: PhotoIdx(j),
            num_putative: matches.len(),
            standing: Vec::new(),
            matches,
            essential: Some(essential),
            homography_share: 0.3,
        });
    }
    let photos = (0..num)
        .map(|k| rilievo_scene::Photo {
            file_name: format!("v{k:04}.png"),
            name: format!("v{k:04}"),
            ..grey.clone()
        })
        .collect();
    World {
        photos: PhotoSet { photos },
        matches: FeatureMatches {
            photos: lists,
            pairs,
        },
        cam_from_world: poses,
    }
}

/// Options for sets without images.
pub fn options() -> PosesOptions {
    PosesOptions {
        matches_only: true,
        ..PosesOptions::default()
    }
}

/// Largest errors of centres (share of the ring's radius) and rotations (degrees) after a
/// similarity from all centres.
pub fn pose_errors(posed: &PosedViews, truth: &[RigidTransform]) -> (f64, f64) {
    let pairs: Vec<(Point3<f64>, Point3<f64>, usize)> = posed
        .views
        .iter()
        .map(|v| {
            (
                v.cam_from_world.center_in_source(),
                truth[v.photo.0].center_in_source(),
                v.photo.0,
            )
        })
        .collect();
    let n = pairs.len() as f64;
    let mean_e = pairs.iter().map(|p| p.0.coords).sum::<Vector3<f64>>() / n;
    let mean_t = pairs.iter().map(|p| p.1.coords).sum::<Vector3<f64>>() / n;
    // Rotations fix the frame even where few centres would not.
    let mut sum = Matrix3::zeros();
    for view in &posed.views {
        let t = truth[view.photo.0].rotation_matrix();
        sum += t.transpose() * view.cam_from_world.rotation_matrix();
    }
    let svd = sum.svd(true, true);
    let r = svd.u.unwrap() * svd.v_t.unwrap();
    let (mut over, mut under) = (0.0, 0.0);
    for (e, t, _) in &pairs {
        let turned = r * (e.coords - mean_e);
        over += turned.dot(&(t.coords - mean_t));
        under += turned.norm_squared();
    }
    let scale = over / under;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r));
    let mut worst = (0.0_f64, 0.0_f64);
    for ((e, t, photo), view) in pairs.iter().zip(&posed.views) {
        let error = (r * (e.coords - mean_e) * scale + mean_t - t.coords).norm() / 3.0;
        let angle = (view.cam_from_world.rotation * rotation.inverse())
            .angle_to(&truth[*photo].rotation)
            .to_degrees();
        worst = (worst.0.max(error), worst.1.max(angle));
        assert!(error.is_finite() && angle.is_finite());
    }
    worst
}

/// Poses on an arc, and points in a ball.
pub fn arc(angles_deg: &[f64], num_points: usize) -> (Vec<RigidTransform>, Vec<Point3<f64>>) {
    let poses = angles_deg
        .iter()
        .map(|deg| {
            let a = deg.to_radians();
            let center = Point3::new(3.0 * a.cos(), 3.0 * a.sin(), 0.9);
            look_at(center, Point3::origin())
        })
        .collect();
    let points = (0..num_points)
        .map(|k| {
            let k = k as f64;
            Point3::new(
                0.7 * (k * 1.31).sin(),
                0.7 * (k * 0.71).cos(),
                0.5 * (k * 2.13).sin(),
            )
        })
        .collect();
    (poses, points)
}
