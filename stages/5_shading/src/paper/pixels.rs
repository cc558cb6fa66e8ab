//! Pixels of one view on one level, as arrays that the θ-step reads in order.

use super::model::Facet;
use rilievo_numerics::corner_grid::CornerGrid;

/// Pixels that the θ-step treats together; arrays are padded to a multiple of it.
pub(crate) const LANES: usize = 16;

/// Slopes of all pixels along x and along y, of padded length.
pub(crate) type Slopes = [Vec<f32>; 2];

/// Coefficients of the harmonics.
#[derive(Clone, Debug)]
pub(crate) enum Coefficients {
    /// One row per channel for all pixels.
    Uniform(Vec<[f32; 9]>),
    /// `channels * 9` arrays of padded length, coefficient by coefficient.
    PerPixel(Vec<f32>),
}

/// Structure of arrays over the mask, in the compact order of a [`CornerGrid`].
#[derive(Clone, Debug)]
pub(crate) struct Pixels {
    /// 1 or 3.
    pub(crate) channels: usize,
    /// Length of every array, a multiple of [`LANES`].
    pub(crate) padded: usize,
    /// Pixels of the mask.
    pub(crate) len: usize,
    /// `X` of every pixel's ray.
    pub(crate) ray_x: Vec<f32>,
    /// `Y` of every pixel's ray.
    pub(crate) ray_y: Vec<f32>,
    /// `channels` arrays of intensities.
    pub(crate) intensity: Vec<f32>,
    /// Weight of the shading term, 0 where the intensity cannot be used.
    pub(crate) weight: Vec<f32>,
    /// Lighting times albedo.
    pub(crate) light: Coefficients,
}

impl Pixels {
    /// Coefficients of a channel at a pixel.
    #[inline]
    pub(crate) fn light(&self, channel: usize, k: usize) -> [f32; 9] {
        match &self.light {
            Coefficients::Uniform(rows) => rows[channel],
            Coefficients::PerPixel(values) => {
                std::array::from_fn(|j| values[(channel * 9 + j) * self.padded + k])
            }
        }
    }

    /// Geometry of a pixel at given slopes.
    #[inline]
    pub(crate) fn facet(&self, k: usize, slopes: [f32; 2]) -> Facet {
        Facet::new([self.ray_x[k], self.ray_y[k]], slopes)
    }

    /// What the model misses of a pixel's intensities, channel by channel.
    #[inline]
    pub(crate) fn residuals(&self, k: usize, slopes: [f32; 2]) -> impl Iterator<Item = f32> + '_ {
        let facet = self.facet(k, slopes);
        (0..self.channels)
            .map(move |c| facet.shade(&self.light(c, k)).0 - self.intensity[c * self.padded + k])
    }

    /// `JᵀJ` of the shading Jacobian over the channels (upper triangle).
    #[inline]
    pub(crate) fn normal_matrix(&self, k: usize, facet: &Facet) -> [f32; 3] {
        (0..self.channels).fold([0.0; 3], |[a, b, d], c| {
            let (_, [jp, jq]) = facet.shade(&self.light(c, k));
            [a + jp * jp, b + jp * jq, d + jq * jq]
        })
    }

    /// Length of arrays for a number of pixels.
    pub(crate) fn padded_len(len: usize) -> usize {
        len.next_multiple_of(LANES)
    }

    /// Half the resolution: weighted means of the up to four pixels under each coarse one.
    /// `parents[k]` is the coarse index of fine pixel `k`; a coarse pixel whose intensities differ
    /// by more than `unlike` loses weight.
    pub(crate) fn coarsen(&self, parents: &[u32], coarse_len: usize, unlike: f32) -> Self {
        let padded = Self::padded_len(coarse_len);
        let mut count = vec![0.0_f32; padded];
        let mut weight = vec![0.0_f32; padded];
        for (k, &parent) in parents.iter().enumerate() {
            count[parent as usize] += 1.0;
            weight[parent as usize] += self.weight[k];
        }
        let mean = |values: &[f32], weighted: bool| {
            let mut sum = vec![0.0_f32; padded];
            for (k, &parent) in parents.iter().enumerate() {
                let w = if weighted { self.weight[k] } else { 1.0 };
                sum[parent as usize] += w * values[k];
            }
            let by = if weighted { &weight } else { &count };
            for (sum, by) in sum.iter_mut().zip(by) {
                *sum = if *by > 0.0 { *sum / by } else { 0.0 };
            }
            sum
        };
        let channel =
            |values: &[f32], c: usize| values[c * self.padded..(c + 1) * self.padded].to_vec();
        let intensity: Vec<f32> = (0..self.channels)
            .flat_map(|c| mean(&channel(&self.intensity, c), true))
            .collect();
        let light = match &self.light {
            Coefficients::Uniform(rows) => Coefficients::Uniform(rows.clone()),
            Coefficients::PerPixel(values) => Coefficients::PerPixel(
                (0..self.channels * 9)
                    .flat_map(|j| mean(&channel(values, j), false))
                    .collect(),
            ),
        };
        let spread = self.spread(parents, &intensity, padded);
        let ray_x = mean(&self.ray_x, false);
        let ray_y = mean(&self.ray_y, false);
        for ((weight, count), spread) in weight.iter_mut().zip(&count).zip(&spread) {
            let alike = 1.0 / (1.0 + spread / (unlike * unlike));
            *weight = if *count > 0.0 {
                *weight / 4.0 * alike
            } else {
                0.0
            };
        }
        Self {
            channels: self.channels,
            padded,
            len: coarse_len,
            ray_x,
            ray_y,
            intensity,
            weight,
            light,
        }
    }

    /// Mean squared deviation of intensities from those of the coarse pixel, over channels.
    fn spread(&self, parents: &[u32], coarse: &[f32], coarse_padded: usize) -> Vec<f32> {
        let mut sum = vec![0.0_f32; coarse_padded];
        let mut total = vec![1e-12_f32; coarse_padded];
        for (k, &parent) in parents.iter().enumerate() {
            let parent = parent as usize;
            for c in 0..self.channels {
                let away = self.intensity[c * self.padded + k] - coarse[c * coarse_padded + parent];
                sum[parent] += self.weight[k] * away * away;
                total[parent] += self.weight[k];
            }
        }
        for (sum, total) in sum.iter_mut().zip(&total) {
            *sum /= total;
        }
        sum
    }
}

/// For every pixel of a fine grid, the index of the coarse pixel that covers it.
pub(crate) fn parents(fine: &CornerGrid, coarse: &CornerGrid) -> Vec<u32> {
    let mut index = vec![0_u32; coarse.width * coarse.height];
    for (k, (x, y)) in coarse.pixels().enumerate() {
        index[(y - coarse.origin_y) * coarse.width + x - coarse.origin_x] = k as u32;
    }
    fine.pixels()
        .map(|(x, y)| index[(y / 2 - coarse.origin_y) * coarse.width + x / 2 - coarse.origin_x])
        .collect()
}
