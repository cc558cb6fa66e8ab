//! How far two masks are the same.

use rilievo_scene::Mask;

/// Pixels of both over pixels of either, of masks of one size.
pub fn overlap(a: &Mask, b: &Mask) -> f64 {
    let count = |is: fn(bool, bool) -> bool| {
        let pairs = a.data.iter().zip(&b.data);
        pairs.filter(|(a, b)| is(**a, **b)).count() as f64
    };
    count(|a, b| a && b) / count(|a, b| a || b).max(1.0)
}
