//! The textures while they are filled.

use rilievo_scene::Raster;
use rilievo_scene::asset::FULL;
use std::collections::VecDeque;

/// A normal along the mesh's.
const FLAT: [u16; 3] = [FULL / 2 + 1, FULL / 2 + 1, FULL];
/// Texels around the charts that repeat their normals: renderers look no farther.
const GROWN: u32 = 16;

/// What is baked into a texel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texel {
    /// Its number, row by row.
    pub at: u32,
    /// Along tangent, bitangent and normal; flat where no view sees the place.
    pub normal: Option<[f32; 3]>,
    /// Linear albedo, where a view shows it.
    pub albedo: Option<[f32; 3]>,
    /// Share of the sky.
    pub open: f32,
}

/// Base colour, normals and occlusion.
pub(super) struct Textures {
    base_color: Raster<[u16; 3]>,
    normal: Raster<[u16; 3]>,
    occlusion: Raster<u8>,
    is_covered: Vec<bool>,
    is_seen: Vec<bool>,
    is_colored: Vec<bool>,
}

impl Textures {
    pub fn new((width, height): (usize, usize)) -> Self {
        Self {
            base_color: Raster::filled(width, height, [FULL / 2; 3]),
            normal: Raster::filled(width, height, FLAT),
            occlusion: Raster::filled(width, height, 255),
            is_covered: vec![false; width * height],
            is_seen: vec![false; width * height],
            is_colored: vec![false; width * height],
        }
    }

    pub fn put(&mut self, texel: &Texel) {
        let at = texel.at as usize;
        self.is_covered[at] = true;
        self.occlusion.data[at] = (255.0 * texel.open).round() as u8;
        if let Some(normal) = texel.normal {
            self.is_seen[at] = true;
            self.normal.data[at] = normal.map(|c| unit(0.5 * (c + 1.0)));
        }
        if let Some(albedo) = texel.albedo {
            self.is_colored[at] = true;
            self.base_color.data[at] = albedo.map(unit);
        }
    }

    pub fn num_covered(&self) -> usize {
        self.is_covered.iter().filter(|is| **is).count()
    }

    pub fn num_seen(&self) -> usize {
        self.is_seen.iter().filter(|is| **is).count()
    }

    /// Base colour, normals and occlusion, with what is missing filled from the nearest texels.
    pub fn finish(mut self) -> (Raster<[u16; 3]>, Raster<[u16; 3]>, Raster<u8>) {
        grow(&mut self.base_color, &self.is_colored, u32::MAX);
        grow(&mut self.normal, &self.is_covered, GROWN);
        grow(&mut self.occlusion, &self.is_covered, u32::MAX);
        (self.base_color, self.normal, self.occlusion)
    }
}

fn unit(share: f32) -> u16 {
    (share.clamp(0.0, 1.0) * f32::from(FULL)).round() as u16
}

/// Repeats known texels in those around them, up to `reach` steps away.
fn grow<T: Copy>(texture: &mut Raster<T>, is_known: &[bool], reach: u32) {
    let (width, height) = (texture.width, texture.height);
    let mut steps: Vec<u32> = is_known
        .iter()
        .map(|&is| if is { 0 } else { u32::MAX })
        .collect();
    // Those that lie beside an unknown one alone: of a large texture few do.
    let is_open = |k: usize| {
        let (x, y) = (k % width, k / width);
        is_known[k]
            && (x > 0 && !is_known[k - 1]
                || x + 1 < width && !is_known[k + 1]
                || y > 0 && !is_known[k - width]
                || y + 1 < height && !is_known[k + width])
    };
    let mut open: VecDeque<u32> = (0..steps.len())
        .filter(|&k| is_open(k))
        .map(|k| k as u32)
        .collect();
    while let Some(k) = open.pop_front().map(|k| k as usize) {
        if steps[k] >= reach {
            continue;
        }
        let (x, y) = (k % width, k / width);
        let beside = [
            (x > 0).then(|| k - 1),
            (x + 1 < width).then(|| k + 1),
            (y > 0).then(|| k - width),
            (y + 1 < height).then(|| k + width),
        ];
        for next in beside.into_iter().flatten() {
            if steps[next] == u32::MAX {
                steps[next] = steps[k] + 1;
                texture.data[next] = texture.data[k];
                open.push_back(next as u32);
            }
        }
    }
}
