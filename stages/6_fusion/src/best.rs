//! Which views shape a block of the volume where many see it.
//!
//! Beyond a dozen views of one wall another one adds cost and next to no accuracy. A view is left
//! out where [`ENOUGH`] others see the same wall better, judged where its rays through the block's
//! middle and corners meet it.

use crate::judge::weight;
use crate::sight::Candidate;
use crate::view::View;
use nalgebra::{Point3, Vector3};
use rilievo_scene::PageCache;

/// Views of one wall that are enough.
const ENOUGH: usize = 12;
/// Least cosine between the normals of one wall.
const SAME_WALL_COSINE: f64 = 0.5;

/// A view's surface along its ray through a place.
struct Sighting {
    weight: f64,
    point: Point3<f64>,
    normal: Vector3<f64>,
}

/// Those of the views near the block with its first corner there that shape it, in their order: all
/// but those that are left out at the block's middle and at all of its corners where they have
/// surface that is not more oblique than `min_cosine`. Views whose surfaces lie within `truncation`
/// of each other (world's unit) along the normal see the same wall.
pub(crate) fn best<'a>(
    pixels: &mut PageCache<'_>,
    near: Vec<&'a View>,
    (corner, edge): (&Point3<f64>, f64),
    (truncation, min_cosine): (f64, f64),
) -> Vec<&'a View> {
    if near.len() <= ENOUGH {
        return near;
    }
    // A view that has surface nowhere here stays: it may have some in between.
    let (mut is_needed, mut is_asked) = (vec![false; near.len()], vec![false; near.len()]);
    let corners = (0..8).map(|k| [k & 1, k >> 1 & 1, k >> 2].map(f64::from));
    for share in corners.chain([[0.5; 3]]) {
        let place = corner + Vector3::from(share) * edge;
        let mut sight = |view: &&View| {
            let in_cam = view.pose.apply(&place);
            let surface = (in_cam.z > 0.0).then(|| view.along(pixels, &in_cam))??;
            let ray = in_cam.coords / in_cam.z;
            let cosine = -surface.normal.dot(&ray) / ray.norm();
            let seen = Candidate::of(view, &ray, &surface);
            (cosine >= min_cosine).then(|| Sighting {
                weight: weight(surface.confidence, cosine, seen.footprint),
                point: seen.point,
                normal: seen.normal,
            })
        };
        let sightings: Vec<Option<Sighting>> = near.iter().map(&mut sight).collect();
        for (k, own) in sightings.iter().enumerate() {
            let Some(own) = own else { continue };
            let is_better = |other: &&Sighting| {
                other.weight > own.weight
                    && own.normal.dot(&other.normal) >= SAME_WALL_COSINE
                    && own.normal.dot(&(other.point - own.point)).abs() <= truncation
            };
            is_asked[k] = true;
            is_needed[k] |= sightings.iter().flatten().filter(is_better).count() < ENOUGH;
        }
    }
    let chosen = near.into_iter().zip(is_needed.iter().zip(is_asked));
    let stays = chosen.filter(|(_, (needed, asked))| **needed || !asked);
    stays.map(|(view, _)| view).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::LoadedViews;
    use crate::views::testing::load;
    use nalgebra::Point2;
    use rilievo_scene::{Intrinsics, PageCaches, PosedViews, ShadedViews};
    use rilievo_synthetic::testing::{Maps, look_at, posed_view};

    const THICKNESS: f64 = 0.02;

    /// A plate across the z axis, seen from `num` places on an arc before it and as many behind it.
    fn plate(num: usize) -> LoadedViews {
        let camera = Intrinsics::pinhole(64, 48, 90.0, 31.5, 23.5);
        let (mut posed, mut shaded) = (PosedViews::default(), ShadedViews::default());
        for v in 0..2 * num {
            let side = if v < num { -1.0 } else { 1.0 };
            let angle = (v % num) as f64 / num as f64 * 1.2 - 0.55;
            let center = Point3::new(2.0 * angle.sin(), 0.0, side * 2.0 * angle.cos());
            let pose = look_at(center, Point3::origin(), -Vector3::y());
            let normal = pose.rotation * (Vector3::z() * side);
            let offset = normal.dot(&pose.translation) + 0.5 * THICKNESS;
            let maps = Maps::of(&camera, |[x, y]| {
                let depth = offset / normal.dot(&camera.ray(&Point2::new(x, y)));
                Some((depth, normal))
            });
            let name = format!("IMG_{v}");
            posed.views.push(posed_view(v, &name, camera, pose));
            shaded.views.push(maps.shaded(v, &name));
        }
        load(&posed, &shaded)
    }

    /// Indices of the views that shape the middle.
    fn chosen(loaded: &LoadedViews) -> Vec<usize> {
        let caches = PageCaches::new(&loaded.store, 64);
        let found = caches.with(|pixels| {
            let near = loaded.views.iter().collect();
            let corner = Point3::new(-0.01, -0.01, -0.01);
            let chosen = best(pixels, near, (&corner, 0.02), (0.1, 0.1));
            chosen.iter().map(|view| view.idx).collect()
        });
        found.expect("room in memory")
    }

    #[test]
    fn few_views_all_shape() {
        let loaded = plate(ENOUGH / 2);
        assert_eq!(chosen(&loaded), (0..ENOUGH).collect::<Vec<_>>());
    }

    #[test]
    fn the_best_of_many_shape_and_each_side_of_a_thin_wall_has_its_own() {
        let num = 3 * ENOUGH;
        let chosen = chosen(&plate(num));
        for side in 0..2 {
            let of_side: Vec<usize> = chosen.iter().copied().filter(|v| v / num == side).collect();
            assert_eq!(of_side.len(), ENOUGH, "{chosen:?}");
            // The most frontal ones: the middle of the arc is at 55 parts of 120.
            let middle = side * num + num * 55 / 120;
            let mut apart = of_side.iter().map(|v| v.abs_diff(middle));
            assert!(apart.all(|n| n <= ENOUGH / 2 + 1), "{of_side:?}");
        }
    }
}
