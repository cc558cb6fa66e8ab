//! Which views can say something about a piece of space, so that nothing is compared with the
//! others.

use crate::sight::MIN_FACING;
use crate::view::{BlockMaxDepth, View};
use nalgebra::{Point3, Vector3};

/// A lens that distorts enlarges a piece of space by less than this.
const ENLARGED: f64 = 1.5;
/// The surface lies between pixels, and by so many footprints behind all of them.
const MARGIN_PX: f64 = 2.0;
const BEYOND_PX: f64 = 4.0;

/// A ball in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ball {
    pub center: Point3<f64>,
    pub radius: f64,
}

impl Ball {
    /// Around a cube with its first corner there.
    pub fn of_cube(corner: &Point3<f64>, edge: f64) -> Self {
        let half = Vector3::repeat(0.5 * edge);
        Self {
            center: corner + half,
            radius: half.norm(),
        }
    }

    /// Whether a view may have surface on its rays through the ball, and no more than `behind`
    /// before it.
    pub fn is_reached_by(&self, view: &View, behind: f64) -> bool {
        let in_cam = view.pose.apply(&self.center);
        let near = in_cam.z - self.radius;
        if in_cam.z + self.radius <= 0.0 {
            return false;
        }
        let Some(pixel) = view.camera.project(&in_cam).filter(|_| near > 0.0) else {
            return true;
        };
        let slope = (in_cam.coords / in_cam.z).norm_squared();
        let reach = ENLARGED * slope * view.camera.focal_px() * self.radius / near + MARGIN_PX;
        let BlockMaxDepth { columns, depths } = &view.max_depth;
        let squares = |at: f64, count: usize| {
            let square = |at: f64| (at / BlockMaxDepth::SIDE as f64).floor();
            let [low, end] =
                [square(at - reach), square(at + reach) + 1.0].map(|k| k.clamp(0.0, count as f64));
            low as usize..end as usize
        };
        let across = squares(pixel.x, *columns);
        let farthest = squares(pixel.y, depths.len() / (*columns).max(1))
            .flat_map(|y| &depths[y * columns..][across.clone()])
            .fold(0.0, |far, &z| f32::max(far, z));
        let farthest = f64::from(farthest) * (1.0 + BEYOND_PX / view.camera.focal_px());
        farthest > 0.0 && near - farthest <= behind
    }
}

/// A piece of surface: where it lies, and the cone of its normals.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch {
    ball: Ball,
    axis: Vector3<f64>,
    /// Half the cone's opening, radians.
    opening: f64,
}

impl Patch {
    /// Around points with unit normals, grown by `margin` (world's unit); `None` of nothing.
    pub fn around(points: &[(Point3<f64>, Vector3<f64>)], margin: f64) -> Option<Self> {
        let num = points.len() as f64;
        let center = points.iter().map(|p| p.0.coords).sum::<Vector3<f64>>() / num;
        let radius = points.iter().map(|p| (p.0.coords - center).norm());
        let axis = points.iter().map(|p| p.1).sum::<Vector3<f64>>();
        let axis = axis.try_normalize(1e-6 * num);
        let opening = |axis: Vector3<f64>| points.iter().map(move |p| p.1.angle(&axis));
        (!points.is_empty()).then(|| Self {
            ball: Ball {
                center: center.into(),
                radius: radius.fold(0.0, f64::max) + margin,
            },
            axis: axis.unwrap_or_else(Vector3::z),
            opening: axis.map_or(std::f64::consts::PI, |a| opening(a).fold(0.0, f64::max)),
        })
    }

    /// Pixels of a view per area of the patch's middle, 0 where the view sees it from behind.
    pub fn density(&self, view: &View) -> f64 {
        let ray = self.ball.center - view.center;
        let depth = view.pose.apply(&self.ball.center).z;
        let cosine = -self.axis.dot(&ray) / ray.norm();
        cosine.max(0.0) / view.footprint(depth).powi(2)
    }

    /// Size that no pixel of a view on the patch falls below, world's unit.
    pub fn least_footprint(&self, view: &View) -> f64 {
        let depth = view.pose.apply(&self.ball.center).z - self.ball.radius;
        view.footprint(depth.max(0.0))
    }

    /// Whether a view may see a point of the patch from its front.
    pub fn may_be_seen_by(&self, view: &View) -> bool {
        let ray = self.ball.center - view.center;
        let spread = (self.ball.radius / ray.norm()).min(1.0).asin();
        let widest = ray.angle(&self.axis) + self.opening + spread;
        // Normals along the ray are turned away.
        let is_turned_away = widest < std::f64::consts::FRAC_PI_2 + MIN_FACING.asin();
        !is_turned_away && self.ball.is_reached_by(view, f64::INFINITY)
    }
}
