//! Which pairs of photos are matched: all of a small set; of a large one the neighbours in file
//! order and the most similar photos.
//!
//! Similarity is the cosine between signed square roots of the residuals of descriptors to the
//! words of a small vocabulary (VLAD: Jégou et al., CVPR 2010). The vocabulary is a k-means over
//! an even sample of all descriptors, started at evenly spaced samples: no random numbers.

use crate::options::FeaturesOptions;
use rayon::prelude::*;
use rilievo_scene::PhotoKeypoints;

/// Words of the vocabulary: enough to tell views of one object apart, few enough to be cheap.
const NUM_WORDS: usize = 32;
/// Descriptors that train the vocabulary.
const NUM_TRAINING: usize = 8000;
/// Descriptors of one photo that enter its signature.
const NUM_PER_PHOTO: usize = 1500;
/// Iterations of k-means.
const NUM_ITERATIONS: usize = 8;

/// Pairs `(first, second)` with `first < second`, in order.
pub fn pairs(photos: &[PhotoKeypoints], options: &FeaturesOptions) -> Vec<(usize, usize)> {
    let num = photos.len();
    if num <= options.max_num_exhaustive_photos {
        return (0..num)
            .flat_map(|i| (i + 1..num).map(move |j| (i, j)))
            .collect();
    }
    let signatures = signatures(photos);
    let mut chosen: Vec<(usize, usize)> = (0..num)
        .into_par_iter()
        .flat_map_iter(|i| {
            let mut others: Vec<(f32, usize)> = (0..num)
                .filter(|&j| j != i)
                .map(|j| (dot(&signatures[i], &signatures[j]), j))
                .collect();
            others.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            let similar = others
                .into_iter()
                .take(options.num_similar_neighbors)
                .map(|(_, j)| j);
            // Around the end of the folder, but never to the photo itself.
            let num_next = options.num_sequential_neighbors.min(num - 1);
            let next = (1..=num_next).map(move |step| (i + step) % num);
            similar
                .chain(next)
                .map(|j| (i.min(j), i.max(j)))
                .collect::<Vec<_>>()
        })
        .collect();
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Every `step`-th of the descriptors so that about `wanted` remain.
fn sample(descriptors: &[u8], wanted: usize) -> impl Iterator<Item = &[u8]> {
    let num = descriptors.len() / 128;
    descriptors
        .chunks_exact(128)
        .step_by(num.div_ceil(wanted).max(1))
}

fn nearest_word(words: &[[f32; 128]], descriptor: &[u8]) -> usize {
    let mut best = (f32::INFINITY, 0);
    for (w, word) in words.iter().enumerate() {
        let distance: f32 = word
            .iter()
            .zip(descriptor)
            .map(|(a, &b)| (a - f32::from(b)).powi(2))
            .sum();
        if distance < best.0 {
            best = (distance, w);
        }
    }
    best.1
}

/// Unit signatures, one per photo.
fn signatures(photos: &[PhotoKeypoints]) -> Vec<Vec<f32>> {
    let per_photo = NUM_TRAINING.div_ceil(photos.len().max(1));
    let training: Vec<&[u8]> = photos
        .iter()
        .flat_map(|p| sample(&p.descriptors, per_photo))
        .collect();
    let step = (training.len() / NUM_WORDS).max(1);
    let mut words: Vec<[f32; 128]> = training
        .iter()
        .step_by(step)
        .take(NUM_WORDS)
        .map(|d| std::array::from_fn(|k| f32::from(d[k])))
        .collect();
    for _ in 0..NUM_ITERATIONS {
        let assigned: Vec<usize> = training
            .par_iter()
            .map(|d| nearest_word(&words, d))
            .collect();
        let mut sums = vec![([0.0_f32; 128], 0_usize); words.len()];
        for (descriptor, &w) in training.iter().zip(&assigned) {
            for (sum, &v) in sums[w].0.iter_mut().zip(*descriptor) {
                *sum += f32::from(v);
            }
            sums[w].1 += 1;
        }
        for (word, (sum, count)) in words.iter_mut().zip(&sums) {
            if *count > 0 {
                *word = std::array::from_fn(|k| sum[k] / *count as f32);
            }
        }
    }
    photos
        .par_iter()
        .map(|photo| {
            let mut vector = vec![0.0_f32; 128 * words.len()];
            for descriptor in sample(&photo.descriptors, NUM_PER_PHOTO) {
                let w = nearest_word(&words, descriptor);
                for k in 0..128 {
                    vector[w * 128 + k] += f32::from(descriptor[k]) - words[w][k];
                }
            }
            for v in &mut vector {
                *v = v.signum() * v.abs().sqrt();
            }
            let norm = dot(&vector, &vector).sqrt().max(f32::MIN_POSITIVE);
            vector.iter_mut().for_each(|v| *v /= norm);
            vector
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Photos of a ring: neighbours share most of their descriptors.
    fn ring(num: usize) -> Vec<PhotoKeypoints> {
        (0..num)
            .map(|photo| PhotoKeypoints {
                keypoints: Vec::new(),
                descriptors: (0..60)
                    .flat_map(|k| {
                        let word = (photo * 10 + k) % (num * 10);
                        (0..128).map(move |d| {
                            let hash = (word * 2_654_435_761 + d * 40_503) >> 7;
                            (hash % 97) as u8
                        })
                    })
                    .collect(),
            })
            .collect()
    }

    #[test]
    fn small_sets_are_exhaustive_and_large_ones_are_not() {
        let options = FeaturesOptions::default();
        assert_eq!(pairs(&ring(8), &options).len(), 28);
        let many = pairs(&ring(80), &options);
        assert!(many.len() < 80 * 21, "{}", many.len());
        assert!(many.windows(2).all(|w| w[0] < w[1]));
        // The ring is closed: first and last are neighbours.
        assert!(many.contains(&(0, 79)));
    }

    #[test]
    fn no_photo_is_matched_with_itself_where_all_are_neighbours() {
        let options = FeaturesOptions {
            max_num_exhaustive_photos: 1,
            ..FeaturesOptions::default()
        };
        let found = pairs(&ring(4), &options);
        assert_eq!(found, [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]);
    }
}
