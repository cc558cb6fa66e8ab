//! Random choices that are the same in every run.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Endless triples of numbers below `len` (which must not be 0), always the same for the same `len`.
pub fn triples(len: usize) -> impl Iterator<Item = [usize; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(len as u64);
    std::iter::repeat_with(move || [(); 3].map(|()| rng.random_range(0..len)))
}
