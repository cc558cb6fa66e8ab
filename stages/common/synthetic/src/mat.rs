//! The printed mat and the table under it: what gives the cameras their poses.
//!
//! Three layers of cells of falling size, each with one shape of its own (disc, ring, square, bar,
//! triangle), printed over each other; shapes are drawn by their signed distances, softened over
//! the footprint of a pixel, so that no view shows staircases.

use crate::environment::Rgb;
use crate::noise::{gradient_noise, hash, unit};
use nalgebra::Vector3;

/// A mat around the origin of the plane `z = 0`, metres.
#[derive(Clone, Debug)]
pub(crate) struct Mat {
    seed: u32,
    half_width: f64,
    half_depth: f64,
    /// Edges of the cells of the three layers.
    cells: [f64; 3],
}

const PAPER: [f64; 3] = [0.64, 0.63, 0.60];
const TABLE: [f64; 3] = [0.115, 0.095, 0.08];
/// Share of the cells that carry a shape.
const FILL: [f64; 3] = [0.75, 0.8, 0.75];

impl Mat {
    pub(crate) fn new(seed: u64, half_width: f64, half_depth: f64) -> Self {
        Self {
            seed: seed as u32 ^ (seed >> 32) as u32 ^ 0x6d61_7400,
            half_width,
            half_depth,
            cells: [0.17, 0.075, 0.034].map(|share| share * half_width),
        }
    }

    /// Mean albedo, for light that it sends back.
    pub(crate) fn mean_albedo() -> Rgb {
        Rgb::from(PAPER) * 0.78
    }

    /// Albedo of the lightest part.
    pub(crate) fn paper() -> Rgb {
        Rgb::from(PAPER)
    }

    /// Albedo at `(x, y)`, averaged over about `footprint` metres.
    pub(crate) fn albedo(&self, x: f64, y: f64, footprint: f64) -> Rgb {
        let inside = (self.half_width - x.abs()).min(self.half_depth - y.abs());
        let coverage = |distance: f64| (0.5 - distance / footprint.max(1e-6)).clamp(0.0, 1.0);
        let on_mat = coverage(-inside);
        let table = || {
            let grain = gradient_noise(&Vector3::new(x / 0.012, y / 0.25, 0.0), self.seed ^ 5)
                + gradient_noise(&Vector3::new(x / 0.1, y / 0.3, 3.0), self.seed ^ 6);
            Rgb::from(TABLE) * (1.0 + 0.16 * grain)
        };
        if on_mat <= 0.0 {
            return table();
        }
        let mut color = Rgb::from(PAPER);
        // A plain margin frames the print.
        if inside > 0.03 * self.half_width {
            for layer in 0..3 {
                let (ink, share) = self.print(layer, x, y, &coverage);
                color += (ink - color) * share;
            }
        }
        if on_mat < 1.0 {
            color = color * on_mat + table() * (1.0 - on_mat);
        }
        color
    }

    fn print(&self, layer: usize, x: f64, y: f64, coverage: &dyn Fn(f64) -> f64) -> (Rgb, f64) {
        let size = self.cells[layer];
        // Layers are shifted and turned against each other, so that no grid shows through.
        let turn = [0.0, 0.5, 1.1][layer] + unit([self.seed, layer as u32, 7, 7]);
        let (sin, cos) = turn.sin_cos();
        let (u, v) = ((cos * x - sin * y) / size, (sin * x + cos * y) / size);
        let (i, j) = (u.floor(), v.floor());
        let cell = [i as i64 as u32, j as i64 as u32, layer as u32];
        let number = |item: u32| unit([cell[0], cell[1], cell[2] ^ self.seed, item]);
        if number(0) > FILL[layer] {
            return (Rgb::zeros(), 0.0);
        }
        // The shape stays inside its cell, wherever it is turned to.
        let radius = 0.16 + 0.20 * number(1);
        let room = 0.5 - radius;
        let (du, dv) = (
            u - i - 0.5 - room * (2.0 * number(2) - 1.0),
            v - j - 0.5 - room * (2.0 * number(3) - 1.0),
        );
        let (sin, cos) = (std::f64::consts::TAU * number(4)).sin_cos();
        let (p, q) = (cos * du - sin * dv, sin * du + cos * dv);
        let distance = match hash([cell[0], cell[1], cell[2] ^ self.seed, 5]) % 5 {
            0 => p.hypot(q) - radius,
            1 => (p.hypot(q) - 0.75 * radius).abs() - 0.25 * radius,
            2 => p.abs().max(q.abs()) - 0.68 * radius,
            3 => (p.abs() - 0.95 * radius).max(q.abs() - 0.28 * radius),
            _ => (0.866 * p.abs() + 0.5 * q).max(-q) - 0.5 * radius,
        };
        let tone = 0.05 + 0.33 * number(6) * number(6);
        let tint = Rgb::new(
            1.0 + 0.5 * (number(8) - 0.5),
            1.0 + 0.3 * (number(9) - 0.5),
            1.0 + 0.5 * (number(10) - 0.5),
        );
        (tint * tone, coverage(distance * size))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_print_is_dark_on_light_and_softens_with_distance() {
        let mat = Mat::new(1, 0.4, 0.3);
        let spread = |footprint: f64| {
            let values: Vec<f64> = (0..4000)
                .map(|i| {
                    let (x, y) = (unit([i, 0, 1, 1]) - 0.5, unit([i, 1, 1, 1]) - 0.5);
                    mat.albedo(0.7 * x, 0.5 * y, footprint).y
                })
                .collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
            (mean, (square / values.len() as f64).sqrt())
        };
        let (mean, sharp) = spread(1e-4);
        let (_, soft) = spread(0.05);
        assert!((mean - Mat::mean_albedo().y).abs() < 0.02, "{mean}");
        assert!(sharp > 0.15 && soft < 0.8 * sharp, "{sharp} {soft}");
    }
}
