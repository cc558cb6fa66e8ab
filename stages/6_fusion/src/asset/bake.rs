//! What the views see at the places of the texels.
//!
//! Triangles are worked on in groups that lie close together, each against the views that may see
//! it; their texels are then put into the textures in the order of the triangles.

use super::texture::{Texel, Textures};
use super::unwrap::Unwrapped;
use crate::color::Palette;
use crate::dress::mean_sight;
use crate::error::FusionError;
use crate::reach::Patch;
use crate::sight::Candidate;
use crate::view::View;
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use rilievo_scene::{Observer, PageCache, PageCaches, StageId};

/// Triangles of a group.
const GROUP: usize = 32;
/// Texels between two words to the observer, about: their results are small against the textures.
const TEXELS_AT_ONCE: f64 = 500_000.0;
/// Views that are looked at: more only repeat what these say.
const MAX_NUM_VIEWS: usize = 12;
/// Distance of a texel's place from the views' surface from which it is looked at again there,
/// pixel footprints.
const OFF_PX: f64 = 0.25;

pub(super) struct Baker<'a> {
    pub unwrapped: &'a Unwrapped,
    pub tangents: &'a [[f32; 4]],
    /// Share of the sky, of the vertices.
    pub occlusion: &'a [f32],
    pub views: &'a [View],
    /// Tolerance along the normal (world's unit), and the least cosine between normals, of views
    /// that see one surface.
    pub limits: (f64, f64),
}

impl Baker<'_> {
    /// Fills the textures.
    pub fn bake(
        &self,
        caches: &PageCaches<'_>,
        textures: &mut Textures,
        observer: &dyn Observer,
    ) -> Result<(), FusionError> {
        let num_triangles = self.unwrapped.mesh.triangles.len();
        let palette = Palette::new();
        let mut next = 0;
        while next < num_triangles {
            let done = (next, num_triangles);
            let flow = observer.progress(StageId::Fusion, "baking textures", done);
            flow.ok_or(FusionError::Interrupted)?;
            let (mut groups, mut num_texels) = (Vec::new(), 0.0);
            while next < num_triangles && num_texels < TEXELS_AT_ONCE {
                let group = next..num_triangles.min(next + GROUP);
                num_texels += group.clone().map(|t| self.num_texels(t)).sum::<f64>();
                next = group.end;
                groups.push(group);
            }
            let baked = groups
                .into_par_iter()
                .map(|group| caches.with(|pixels| self.group(pixels, group, &palette)))
                .collect::<Result<Vec<Vec<Texel>>, _>>()?;
            baked.iter().flatten().for_each(|texel| textures.put(texel));
        }
        Ok(())
    }

    /// Area of a triangle on the texture.
    fn num_texels(&self, triangle: usize) -> f64 {
        let [a, b, c] = self.on_texture(triangle);
        0.5 * twice_area(&a, &b, &c).abs()
    }

    /// Corners of a triangle on the texture, centres of texels at whole numbers.
    fn on_texture(&self, triangle: usize) -> [[f64; 2]; 3] {
        let (width, height) = self.unwrapped.size;
        self.unwrapped.mesh.triangles[triangle].map(|v| {
            let [u, v] = self.unwrapped.texture_coords[v as usize].map(f64::from);
            [u * width as f64 - 0.5, v * height as f64 - 0.5]
        })
    }

    fn group(
        &self,
        pixels: &mut PageCache<'_>,
        group: std::ops::Range<usize>,
        palette: &Palette,
    ) -> Vec<Texel> {
        let mesh = &self.unwrapped.mesh;
        let corners: Vec<(Point3<f64>, Vector3<f64>)> = mesh.triangles[group.clone()]
            .iter()
            .flatten()
            .map(|&v| {
                let [at, normal] = [&mesh.vertices, &mesh.normals].map(|of| of[v as usize]);
                (at.map(f64::from).into(), normal.map(f64::from).into())
            })
            .collect();
        let Some(patch) = Patch::around(&corners, self.limits.0) else {
            return Vec::new();
        };
        let mut near: Vec<&View> = self.views.iter().collect();
        near.retain(|view| patch.may_be_seen_by(view));
        if near.len() > MAX_NUM_VIEWS {
            let density: Vec<f64> = self.views.iter().map(|view| patch.density(view)).collect();
            // Ties go to the first view.
            near.sort_by(|a, b| {
                density[b.idx]
                    .total_cmp(&density[a.idx])
                    .then(a.idx.cmp(&b.idx))
            });
            near.truncate(MAX_NUM_VIEWS);
            near.sort_by_key(|view| view.idx);
        }
        let mut texels = Vec::new();
        for triangle in group {
            self.triangle(pixels, &near, triangle, palette, &mut texels);
        }
        texels
    }

    fn triangle(
        &self,
        pixels: &mut PageCache<'_>,
        near: &[&View],
        triangle: usize,
        palette: &Palette,
        texels: &mut Vec<Texel>,
    ) {
        let Unwrapped {
            mesh,
            size: (width, height),
            ..
        } = self.unwrapped;
        let corners = mesh.triangles[triangle].map(|v| v as usize);
        let on_texture = self.on_texture(triangle);
        let of = |values: &[[f32; 3]]| corners.map(|v| Vector3::from(values[v].map(f64::from)));
        let (places, normals) = (of(&mesh.vertices), of(&mesh.normals));
        let tangents = corners.map(|v| self.tangents[v].map(f64::from));
        let sign = tangents[0][3];
        let tangents = tangents.map(|[x, y, z, _]| Vector3::new(x, y, z));
        for_each_texel(&on_texture, (*width, *height), |(x, y), weights| {
            let mean = |of: &[Vector3<f64>; 3]| -> Vector3<f64> {
                of.iter().zip(weights).map(|(v, w)| v * w).sum()
            };
            let normal = mean(&normals);
            let open = corners.iter().zip(weights);
            let open: f64 = open.map(|(&v, w)| f64::from(self.occlusion[v]) * w).sum();
            let seen = self.look(pixels, near, mean(&places).into(), &normal, palette);
            // As a renderer does: tangent and normal interpolated, the bitangent by their product.
            let tangent = mean(&tangents);
            let bitangent = normal.cross(&tangent) * sign;
            let frame = Matrix3::from_columns(&[tangent, bitangent, normal]);
            let in_frame = seen.as_ref().and_then(|(seen, _)| {
                let direction = frame.try_inverse()? * seen;
                direction.try_normalize(1e-12)
            });
            texels.push(Texel {
                at: (y * width + x) as u32,
                normal: in_frame.map(|n| n.map(|c| c as f32).into()),
                albedo: seen.and_then(|(_, albedo)| albedo),
                open: open as f32,
            });
        });
    }

    /// The surface's normal and albedo at a place near it, as the views see them.
    fn look(
        &self,
        pixels: &mut PageCache<'_>,
        near: &[&View],
        place: Point3<f64>,
        normal: &Vector3<f64>,
        palette: &Palette,
    ) -> Option<(Vector3<f64>, Option<[f32; 3]>)> {
        let nearest = near
            .iter()
            .map(|view| view.footprint(view.pose.apply(&place).z));
        let footprint = nearest.fold(f64::INFINITY, f64::min);
        let mut candidate = Candidate {
            point: place,
            normal: normal.try_normalize(1e-12)?,
            footprint,
        };
        let look = |pixels: &mut PageCache<'_>, candidate: &Candidate| {
            mean_sight(
                pixels,
                near,
                candidate,
                self.limits,
                |pixels, view, weight, colors| {
                    let pixel = view.camera.project(&view.pose.apply(&candidate.point));
                    if let Some(pixel) = pixel.filter(|_| view.has_photo) {
                        let albedo = (weight * footprint * footprint, colors);
                        palette.add_albedo(pixels, view, [pixel.x, pixel.y], albedo);
                    }
                },
            )
        };
        let mut seen = look(pixels, &candidate)?;
        // The light mesh cuts corners: a view that sees it obliquely looks beside the place.
        if seen.distance.abs() > OFF_PX * footprint {
            candidate.point += candidate.normal * seen.distance;
            seen = look(pixels, &candidate).unwrap_or(seen);
        }
        Some((seen.normal.try_normalize(0.0)?, seen.colors.mean()))
    }
}

/// Texels whose centres lie in a triangle, with the weights of its corners there.
fn for_each_texel(
    [a, b, c]: &[[f64; 2]; 3],
    (width, height): (usize, usize),
    mut work: impl FnMut((usize, usize), [f64; 3]),
) {
    let area = twice_area(a, b, c);
    if area == 0.0 {
        return;
    }
    let range = |k: usize, size: usize| {
        let low = a[k].min(b[k]).min(c[k]).ceil().max(0.0) as usize;
        let high = a[k].max(b[k]).max(c[k]).floor();
        low..if high < 0.0 {
            low
        } else {
            (high as usize + 1).min(size)
        }
    };
    for y in range(1, height) {
        for x in range(0, width) {
            let p = [x as f64, y as f64];
            let parts = [
                twice_area(b, c, &p),
                twice_area(c, a, &p),
                twice_area(a, b, &p),
            ];
            let weights = parts.map(|w| w / area);
            if weights.iter().all(|&w| w >= 0.0) {
                work((x, y), weights);
            }
        }
    }
}

/// Twice the signed area of a triangle.
fn twice_area(p: &[f64; 2], q: &[f64; 2], r: &[f64; 2]) -> f64 {
    (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
}
