//! Which pairs of photos are matched.
//!
//! Of a large set, first the neighbours in the order of names and the most similar photos. Similarity is the cosine
//! between signed square roots of the residuals of descriptors to the words of a small vocabulary (VLAD: Jégou et al.,
//! CVPR 2010). The vocabulary is a k-means over an even sample of all descriptors, started at evenly spaced samples: no
//! random numbers. Then, as often as something new is found, the pairs of photos that both match a third one well: what
//! similarity misses, the photos' graph supplies. Each photo is tried with a number of others that grows as the
//! logarithm of the set.

use crate::error::FeaturesError;
use crate::options::{FeaturesOptions, PairChoice};
use rayon::prelude::*;
use rilievo_scene::{PhotoKeypoints, PhotoSet};
use std::collections::{BTreeMap, BTreeSet};

/// A pair of photos, the smaller index first.
pub(crate) type Pair = (usize, usize);

/// Words of the vocabulary: enough to tell views of one object apart, few enough to be cheap.
const NUM_WORDS: usize = 32;
/// Descriptors that train the vocabulary.
const NUM_TRAINING: usize = 8000;
/// Descriptors of one photo that enter its signature.
const NUM_PER_PHOTO: usize = 1500;
/// Iterations of k-means.
const NUM_ITERATIONS: usize = 8;
/// Photos that each photo is tried with at most, over the binary logarithm of the number of photos.
const NUM_TRIED_PER_LOG: f64 = 12.0;

/// The pairs to begin with, in order.
///
/// # Errors
/// When pairs are listed and none is one of two of the photos.
pub(crate) fn first(
    photos: &PhotoSet,
    keypoints: &[PhotoKeypoints],
    options: &FeaturesOptions,
) -> Result<Vec<Pair>, FeaturesError> {
    let num = keypoints.len();
    let mut chosen: Vec<Pair> = match &options.pairs {
        PairChoice::Listed(names) => {
            let index_of: BTreeMap<&str, usize> = (photos.photos.iter().enumerate())
                .map(|(i, photo)| (photo.file_name.as_str(), i))
                .collect();
            let index = |name: &String| index_of.get(name.as_str()).copied();
            let found: Vec<Pair> = (names.iter())
                .filter_map(|[a, b]| Some(ordered(index(a)?, index(b)?)))
                .filter(|(a, b)| a != b)
                .collect();
            if found.is_empty() && num > 1 {
                return Err(FeaturesError::NoListedPair { num: names.len() });
            }
            found
        }
        PairChoice::Sequential => sequential(num, options).collect(),
        _ if is_exhaustive(num, options) => (0..num)
            .flat_map(|i| (i + 1..num).map(move |j| (i, j)))
            .collect(),
        _ => similar(keypoints, options)
            .into_iter()
            .chain(sequential(num, options))
            .collect(),
    };
    chosen.sort_unstable();
    chosen.dedup();
    Ok(chosen)
}

/// Names in the listed pairs that are no photo's, each once.
pub(crate) fn unknown_names<'a>(
    photos: &PhotoSet,
    options: &'a FeaturesOptions,
) -> BTreeSet<&'a str> {
    let PairChoice::Listed(names) = &options.pairs else {
        return BTreeSet::new();
    };
    let known: BTreeSet<&str> = (photos.photos.iter())
        .map(|photo| photo.file_name.as_str())
        .collect();
    let named = names.iter().flatten().map(String::as_str);
    named.filter(|name| !known.contains(name)).collect()
}

/// Whether all pairs are tried.
pub(crate) fn is_exhaustive(num_photos: usize, options: &FeaturesOptions) -> bool {
    match options.pairs {
        PairChoice::All => true,
        PairChoice::Auto => num_photos <= options.pair_limits.max_num_exhaustive_photos,
        PairChoice::Sequential | PairChoice::Listed(_) => false,
    }
}

/// Pairs of photos, not tried so far, that both match a third one: those with the most photos between them first, as
/// many as each photo is to be tried with.
///
/// `strong` are the pairs that match well, `tried` all that were looked at.
pub(crate) fn beyond(num_photos: usize, strong: &[Pair], tried: &BTreeSet<Pair>) -> Vec<Pair> {
    let mut partners = vec![Vec::new(); num_photos];
    for &(i, j) in strong {
        partners[i].push(j);
        partners[j].push(i);
    }
    let mut num_between: BTreeMap<Pair, usize> = BTreeMap::new();
    for list in &partners {
        for (k, &i) in list.iter().enumerate() {
            for &j in &list[k + 1..] {
                let pair = ordered(i, j);
                if !tried.contains(&pair) {
                    *num_between.entry(pair).or_default() += 1;
                }
            }
        }
    }
    let mut likely: Vec<(usize, Pair)> = num_between.into_iter().map(|(p, n)| (n, p)).collect();
    likely.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut num_tried = vec![0_usize; num_photos];
    for &(i, j) in tried {
        num_tried[i] += 1;
        num_tried[j] += 1;
    }
    let most = (NUM_TRIED_PER_LOG * (num_photos.max(2) as f64).log2()).ceil() as usize;
    let mut chosen = Vec::new();
    for (_, (i, j)) in likely {
        if num_tried[i] < most && num_tried[j] < most {
            num_tried[i] += 1;
            num_tried[j] += 1;
            chosen.push((i, j));
        }
    }
    chosen.sort_unstable();
    chosen
}

fn ordered(i: usize, j: usize) -> Pair {
    (i.min(j), i.max(j))
}

/// Each photo with those that follow it, around the end, but never with itself.
fn sequential(num: usize, options: &FeaturesOptions) -> impl Iterator<Item = Pair> {
    let num_next = options
        .pair_limits
        .num_sequential_neighbors
        .min(num.saturating_sub(1));
    (0..num).flat_map(move |i| (1..=num_next).map(move |step| ordered(i, (i + step) % num)))
}

/// Each photo with those most similar to it.
fn similar(photos: &[PhotoKeypoints], options: &FeaturesOptions) -> Vec<Pair> {
    let signatures = signatures(photos);
    (0..photos.len())
        .into_par_iter()
        .flat_map_iter(|i| {
            let mut others: Vec<(f32, usize)> = (0..photos.len())
                .filter(|&j| j != i)
                .map(|j| (dot(&signatures[i], &signatures[j]), j))
                .collect();
            others.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            let similar = others
                .into_iter()
                .take(options.pair_limits.num_similar_neighbors);
            similar.map(move |(_, j)| ordered(i, j))
        })
        .collect()
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
    use crate::options::PairLimits;

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

    fn pairs(photos: &[PhotoKeypoints], options: &FeaturesOptions) -> Vec<Pair> {
        first(&PhotoSet::default(), photos, options).unwrap()
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
        let all = FeaturesOptions {
            pairs: PairChoice::All,
            ..options
        };
        assert_eq!(pairs(&ring(80), &all).len(), 80 * 79 / 2);
    }

    #[test]
    fn no_photo_is_matched_with_itself_where_all_are_neighbours() {
        for pairs_of in [PairChoice::Auto, PairChoice::Sequential] {
            let options = FeaturesOptions {
                pairs: pairs_of,
                pair_limits: PairLimits {
                    max_num_exhaustive_photos: 1,
                    ..PairLimits::default()
                },
                ..FeaturesOptions::default()
            };
            let found = pairs(&ring(4), &options);
            assert_eq!(found, [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]);
        }
    }

    #[test]
    fn photos_that_match_a_third_one_are_tried_with_each_other() {
        let tried = BTreeSet::from([(0, 1), (1, 2), (2, 3), (3, 4)]);
        let strong = [(0, 1), (1, 2), (2, 3)];
        assert_eq!(beyond(5, &strong, &tried), [(0, 2), (1, 3)]);
        // Nothing twice, and nothing of photos that match too little.
        assert_eq!(beyond(5, &[(3, 4)], &tried), []);
    }

    #[test]
    fn the_pairs_of_a_ring_grow_no_faster_than_n_log_n() {
        // Photos match well with the eight on either side.
        let options = FeaturesOptions::default();
        let counts = [64, 128, 256, 512].map(|num| {
            let mut tried: BTreeSet<Pair> = pairs(&ring(num), &options).into_iter().collect();
            loop {
                let is_strong = |&&(i, j): &&Pair| (j - i).min(num - (j - i)) <= 8;
                let strong: Vec<Pair> = tried.iter().filter(is_strong).copied().collect();
                let more = beyond(num, &strong, &tried);
                if more.is_empty() {
                    break;
                }
                tried.extend(more);
            }
            // The neighbours are all among them.
            for i in 0..num {
                assert!((1..=8).all(|step| tried.contains(&ordered(i, (i + step) % num))));
            }
            tried.len() as f64 / (num as f64 * (num as f64).log2())
        });
        assert!(counts.windows(2).all(|c| c[1] <= 1.05 * c[0]), "{counts:?}");
        println!("pairs over n log2 n: {counts:?}");
    }

    #[test]
    fn the_number_of_tries_grows_as_the_logarithm_of_the_set() {
        // All photos match the first one, so that all pairs are likely.
        let num = 400;
        let strong: Vec<Pair> = (1..num).map(|j| (0, j)).collect();
        let tried = strong.iter().copied().collect();
        let found = beyond(num, &strong, &tried);
        let most = NUM_TRIED_PER_LOG * (num as f64).log2();
        assert!((found.len() as f64) < 0.5 * most * num as f64 + num as f64);
        assert!(found.len() > 10 * num);
    }
}
