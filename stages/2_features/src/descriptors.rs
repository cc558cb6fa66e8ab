//! RootSIFT: `d ← √(d / Σd)` makes the Euclidean distance of descriptors the Hellinger distance of
//! their histograms (Arandjelović and Zisserman, CVPR 2012), quantised to a byte.

/// Factor to bytes; the unit vector's entries rarely exceed one half.
const QUANTISATION: f32 = 512.0;

/// Quantised RootSIFT of one SIFT descriptor.
pub(crate) fn root_sift(descriptor: &[f32]) -> impl Iterator<Item = u8> + '_ {
    let sum: f32 = descriptor.iter().sum::<f32>().max(f32::MIN_POSITIVE);
    descriptor.iter().map(move |v| {
        (QUANTISATION * (v.max(0.0) / sum).sqrt())
            .round()
            .min(255.0) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn has_unit_length_before_quantisation_and_ignores_the_input_scale() {
        let sift: Vec<f32> = (0..128).map(|k| ((k * 37) % 100) as f32).collect();
        let doubled: Vec<f32> = sift.iter().map(|v| 2.0 * v).collect();
        let a: Vec<u8> = root_sift(&sift).collect();
        assert_eq!(a, root_sift(&doubled).collect::<Vec<u8>>());
        let norm = a.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>().sqrt();
        assert!((norm - 512.0).abs() < 3.0, "{norm}");
    }
}
