//! From a view as given to arrays that the solver reads: checks, usable pixels, normalised rays.
//!
//! A pixel's shading term is left out (weight 0) where an intensity is not finite, a channel is
//! clipped, or all channels lie below the shadow level; such a pixel keeps its place in the
//! surface.

use super::options::{HarmonicOrder, PaperOptions, Projection};
use super::pixels::{Coefficients, Pixels};
use super::problem::{ShadingView, ViewLight};
use super::solution::ViewReport;
use crate::error::ShadingError;
use rilievo_numerics::corner_grid::CornerGrid;
use rilievo_numerics::robust::quantile;
use rilievo_scene::{LinearImage, Raster, SphericalHarmonics};

/// Projection of a view in the solver's units: unknown `y = f ln(z / z₀)`, or `f (z − z₀)` for
/// parallel rays, in pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Geometry {
    pub(crate) projection: Projection,
    pub(crate) focal: f64,
    pub(crate) reference_depth: f64,
    /// `fx / f` and `fy / f`.
    pub(crate) aspect: [f32; 2],
}

impl Geometry {
    /// The unknown at a depth.
    pub(crate) fn unknown(&self, depth: f64) -> f64 {
        match self.projection {
            Projection::Perspective => self.focal * (depth / self.reference_depth).ln(),
            Projection::Orthographic => self.focal * (depth - self.reference_depth),
        }
    }

    /// Standard deviation of the unknown from that of the logarithm of depth.
    pub(crate) fn sigma(&self, depth: f64, sigma_ln_depth: f64) -> f64 {
        match self.projection {
            Projection::Perspective => self.focal * sigma_ln_depth,
            Projection::Orthographic => self.focal * depth.abs() * sigma_ln_depth,
        }
    }

    /// The depth at an unknown.
    pub(crate) fn depth(&self, unknown: f64) -> f64 {
        match self.projection {
            Projection::Perspective => self.reference_depth * (unknown / self.focal).exp(),
            Projection::Orthographic => self.reference_depth + unknown / self.focal,
        }
    }
}

/// A view ready to be solved at full resolution.
#[derive(Clone, Debug)]
pub(crate) struct PreparedView {
    pub(crate) grid: CornerGrid,
    pub(crate) pixels: Pixels,
    pub(crate) geometry: Geometry,
    /// 99 % quantile of the intensities: the unit of noise and losses.
    pub(crate) white: f64,
    pub(crate) report: ViewReport,
}

fn size(width: usize, height: usize) -> String {
    format!("{width}x{height}")
}

fn check_sizes(view: &ShadingView) -> Result<(), ShadingError> {
    let image = &view.image;
    let check = |what: &'static str, width: usize, height: usize| {
        if (width, height) == (image.width, image.height) {
            Ok(())
        } else {
            Err(ShadingError::SizeMismatch {
                view: view.name.clone(),
                what,
                found: size(width, height),
                image: size(image.width, image.height),
            })
        }
    };
    check("the mask", view.mask.width, view.mask.height)?;
    check("the camera", view.intrinsics.width, view.intrinsics.height)?;
    if let Some(map) = &view.initial_depth {
        check("the initial depth", map.width, map.height)?;
    }
    if let Some(prior) = &view.prior {
        check("the depth prior", prior.depth.width, prior.depth.height)?;
    }
    if let Some(map) = &view.weights {
        check("the weight map", map.width, map.height)?;
    }
    if let Some(map) = &view.albedo {
        check("the albedo", map.width, map.height)?;
        if map.channels != image.channels {
            return Err(ShadingError::ChannelMismatch {
                view: view.name.clone(),
                lighting: map.channels,
                image: image.channels,
            });
        }
    }
    if let ViewLight::PerPixel(light) = &view.lighting {
        check("the per-pixel lighting", light.width, light.height)?;
    }
    Ok(())
}

fn check_lighting(view: &ShadingView) -> Result<(), ShadingError> {
    let image = view.image.channels;
    let channels = match &view.lighting {
        ViewLight::Uniform(lighting) => lighting.channels.len(),
        ViewLight::PerPixel(light) => light.channels,
    };
    if channels != image || !(image == 1 || image == 3) {
        return Err(ShadingError::ChannelMismatch {
            view: view.name.clone(),
            lighting: channels,
            image,
        });
    }
    if let ViewLight::Uniform(lighting) = &view.lighting {
        let rows = || lighting.channels.iter().map(|row| row.0);
        let reason = if rows().flatten().any(|l| !l.is_finite()) {
            Some("not finite")
        } else if rows().flatten().all(|l| l == 0.0) {
            Some("zero")
        } else if rows().all(|l| l.iter().enumerate().all(|(k, &l)| k == 3 || l == 0.0)) {
            Some("the same for every normal")
        } else {
            None
        };
        if let Some(reason) = reason {
            return Err(ShadingError::UninformativeLighting {
                view: view.name.clone(),
                reason,
            });
        }
    }
    Ok(())
}

fn check_camera(view: &ShadingView) -> Result<(), ShadingError> {
    let camera = &view.intrinsics;
    let finite = [camera.fx, camera.fy, camera.cx, camera.cy]
        .iter()
        .all(|v| v.is_finite());
    let reason = if !finite || camera.fx <= 0.0 || camera.fy <= 0.0 {
        Some(format!(
            "focal lengths {} and {} px must be positive and finite",
            camera.fx, camera.fy
        ))
    } else if !camera.distortion.is_none() {
        Some("lens distortion must be removed from the image before shading".to_owned())
    } else {
        None
    };
    match reason {
        Some(reason) => Err(ShadingError::BadCamera {
            view: view.name.clone(),
            reason,
        }),
        None => Ok(()),
    }
}

/// Share of clipped or dark pixels is counted once per pixel, in this order of causes.
struct Usable<'a> {
    image: &'a LinearImage,
    weights: Option<&'a Raster<f32>>,
    clip: f32,
    shadow: f32,
}

impl Usable<'_> {
    fn weight(&self, x: usize, y: usize, report: &mut ViewReport) -> f32 {
        let values = self.image.pixel(x, y);
        let given = self.weights.map_or(1.0, |map| *map.at(x, y));
        if values.iter().any(|v| !v.is_finite()) || !given.is_finite() {
            report.num_not_finite += 1;
            0.0
        } else if values.iter().any(|&v| v >= self.clip) {
            report.num_saturated += 1;
            0.0
        } else if self.shadow > 0.0 && values.iter().all(|&v| v <= self.shadow) {
            report.num_shadowed += 1;
            0.0
        } else {
            given.max(0.0)
        }
    }
}

/// The error of a view without a pixel in its mask.
pub(crate) fn empty_mask(view: &ShadingView) -> ShadingError {
    ShadingError::EmptyMask {
        view: view.name.clone(),
        num_masked: 0,
        advice: "check the mask (--masks): white is the object",
    }
}

/// Lighting times albedo, of the harmonics up to `options.order`.
fn light(view: &ShadingView, grid: &CornerGrid, options: &PaperOptions) -> Coefficients {
    let num_used = match options.order {
        HarmonicOrder::First => 4,
        HarmonicOrder::Second => 9,
    };
    if let (ViewLight::Uniform(lighting), None) = (&view.lighting, &view.albedo) {
        let used = |row: &SphericalHarmonics| {
            std::array::from_fn(|j| if j < num_used { row.0[j] as f32 } else { 0.0 })
        };
        return Coefficients::Uniform(lighting.channels.iter().map(used).collect());
    }
    let channels = view.image.channels;
    let padded = Pixels::padded_len(grid.num_cells);
    let mut values = vec![0.0; padded * channels * 9];
    for (k, (x, y)) in grid.pixels().enumerate() {
        for c in 0..channels {
            let albedo = view.albedo.as_ref().map_or(1.0, |map| map.pixel(x, y)[c]);
            for j in 0..num_used {
                let l = match &view.lighting {
                    ViewLight::Uniform(lighting) => lighting.channels[c].0[j] as f32,
                    ViewLight::PerPixel(light) => {
                        light.coefficients[((y * light.width + x) * channels + c) * 9 + j]
                    }
                };
                let value = albedo * l;
                values[(c * 9 + j) * padded + k] = if value.is_finite() { value } else { 0.0 };
            }
        }
    }
    Coefficients::PerPixel(values)
}

/// Checks a view and gathers its pixels.
pub(crate) fn prepare(
    view: &ShadingView,
    options: &PaperOptions,
    reference_depth: f64,
) -> Result<PreparedView, ShadingError> {
    check_sizes(view)?;
    check_lighting(view)?;
    check_camera(view)?;
    let grid = CornerGrid::new(&view.mask).ok_or_else(|| empty_mask(view))?;
    let image = view.image.as_ref();
    let channels = image.channels;
    let len = grid.num_cells;
    let padded = Pixels::padded_len(len);
    let mut samples: Vec<f64> = grid
        .pixels()
        .step_by(1 + len / 20_000)
        .flat_map(|(x, y)| image.pixel(x, y).iter().map(|&v| f64::from(v)))
        .filter(|v| v.is_finite())
        .collect();
    let white = quantile(&mut samples, 0.99).map(f64::abs);
    let white = white.filter(|&v| v > 0.0).unwrap_or(1.0);

    let camera = &view.intrinsics;
    let mut report = ViewReport {
        name: view.name.clone(),
        num_pixels: len,
        ..ViewReport::default()
    };
    let usable = Usable {
        image,
        weights: view.weights.as_ref(),
        clip: view.clip_level.unwrap_or(f32::INFINITY),
        shadow: (options.shadow_level * white) as f32,
    };
    let mut pixels = Pixels {
        channels,
        padded,
        len,
        ray_x: vec![0.0; padded],
        ray_y: vec![0.0; padded],
        intensity: vec![0.0; padded * channels],
        weight: vec![0.0; padded],
        light: light(view, &grid, options),
    };
    for (k, (x, y)) in grid.pixels().enumerate() {
        if options.projection == Projection::Perspective {
            pixels.ray_x[k] = ((x as f64 - camera.cx) / camera.fx) as f32;
            pixels.ray_y[k] = ((y as f64 - camera.cy) / camera.fy) as f32;
        }
        pixels.weight[k] = usable.weight(x, y, &mut report);
        if pixels.weight[k] > 0.0 {
            for (c, &value) in image.pixel(x, y).iter().enumerate() {
                pixels.intensity[c * padded + k] = value;
            }
        }
    }
    if pixels.weight.iter().all(|&w| w == 0.0) {
        return Err(ShadingError::EmptyMask {
            view: view.name.clone(),
            num_masked: len,
            advice: "all its pixels are clipped, dark or not finite",
        });
    }
    let focal = camera.focal_px();
    Ok(PreparedView {
        grid,
        pixels,
        geometry: Geometry {
            projection: options.projection,
            focal,
            reference_depth,
            aspect: [(camera.fx / focal) as f32, (camera.fy / focal) as f32],
        },
        white,
        report,
    })
}
