//! The outline as data: where the object ends in the photo, its surface turns away from the camera.
//!
//! At an occluding contour of a smooth surface the normal stands at right angles to the line of
//! sight, and in the photo it points across the outline (Barrow, Tenenbaum, "Interpreting line
//! drawings as three-dimensional surfaces", 1981; Ikeuchi, Horn, "Numerical shape from shading and
//! occluding boundaries", 1981). With the slope `s` across the outline, away from the object, its
//! outermost pixels have the residual `(τ₀ − atan s) / σ` as long as their surface has turned away
//! by less than `τ₀`. A mask also ends at sharp edges, where the object stands on something, and
//! where another thing hides it: the residual's weight is divided by `(1 + m)²`, `m` the other
//! views that see the pixel, and is small against theirs. It leads where no other term holds the
//! shape: in highlights that are clipped, and in what one photo alone sees. Without it the surface
//! would go on flat there.

use rilievo_numerics::plate_system::PlateSystem;
use rilievo_stereo::level::ViewGrid;
use rilievo_stereo::plate;

/// Tilt that outermost pixels are pulled to, degrees: that of the difference to the next pixel inside, from half a pixel
/// to one and a half within the outline of a ball of 25 pixels' radius. For 10 pixels it is 65°, for 60 it is 80°.
const TILT_DEG: f64 = 75.0;
/// Standard deviation of that tilt where no other view sees the pixel, radians.
const SIGMA: f64 = 0.15;
/// Radius of the disc whose part outside the mask points outward, pixels.
const DISC_PX: i32 = 3;

/// Adds the term for the increment of `depth`; `num_visible` counts the other views that see each pixel.
///
/// It is linearised along the chord to the slope that is asked for: the tangent would overshoot where the surface leans far
/// towards the camera, and pulls a flat surface, as beside a sharp edge, three times as hard.
pub(crate) fn add_terms(
    view: &ViewGrid,
    depth: &[f64],
    num_visible: &[u8],
    system: &mut PlateSystem,
) {
    let tilt = TILT_DEG.to_radians();
    for pixel in (0..view.pixels.len()).filter(|&pixel| view.is_on_outline(pixel)) {
        let Some([x, y]) = outward(view, pixel) else {
            continue;
        };
        let (along_x, along_y) = plate::slopes(view, pixel, depth);
        let slope = x * along_x.of(depth) + y * along_y.of(depth);
        let residual = tilt - slope.atan();
        // Nearer to it the chord's quotient is rounding.
        if residual <= 1e-6 {
            continue;
        }
        let wanted = tilt.tan() - slope;
        let sigma = SIGMA * (1.0 + f64::from(num_visible[pixel]));
        let weight = (residual / (wanted * sigma)).powi(2);
        system.add_pair(
            &view.pixels,
            [&along_x, &along_y],
            [weight * x * x, weight * x * y, weight * y * y],
            [weight * wanted * x, weight * wanted * y],
        );
    }
}

/// The way out of the mask at a pixel on its outline, a unit vector: from the pixel to the middle of what a disc around
/// it holds outside. `None` where that is the pixel itself, as in a line of single pixels.
fn outward(view: &ViewGrid, pixel: usize) -> Option<[f64; 2]> {
    let (column, row) = (view.pixels.xs[pixel] as i32, view.pixels.ys[pixel] as i32);
    let (mut x, mut y) = (0, 0);
    for dy in -DISC_PX..=DISC_PX {
        for dx in -DISC_PX..=DISC_PX {
            let is_in_disc = dx * dx + dy * dy <= DISC_PX * DISC_PX;
            if is_in_disc && view.is_outside(column + dx, row + dy) {
                x += dx;
                y += dy;
            }
        }
    }
    let length = f64::from(x).hypot(f64::from(y));
    (length > 0.0).then(|| [f64::from(x) / length, f64::from(y) / length])
}
