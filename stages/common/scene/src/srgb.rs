//! The sRGB transfer curve, `linear = f(stored)`: a line near black, a power of 2.4 above.
//!
//! Source: IEC 61966-2-1, with the exact junction at 0.04045.

/// Linear intensity of a value encoded as sRGB; odd around zero, so that noise stays unbiased.
pub fn decode(stored: f64) -> f64 {
    let size = stored.abs();
    let linear = if size <= 0.040_45 {
        size / 12.92
    } else {
        ((size + 0.055) / 1.055).powf(2.4)
    };
    linear.copysign(stored)
}

/// sRGB value of a linear intensity; the inverse of [`decode`].
pub fn encode(linear: f64) -> f64 {
    let size = linear.abs();
    let stored = if size <= 0.040_45 / 12.92 {
        size * 12.92
    } else {
        1.055 * size.powf(1.0 / 2.4) - 0.055
    };
    stored.copysign(linear)
}

/// The byte that stores a linear intensity, clipped to 0..1.
pub fn encode_byte(linear: f32) -> u8 {
    (255.0 * encode(f64::from(linear.clamp(0.0, 1.0)))).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_inverts_decoding_and_bytes_come_back() {
        for k in -100..=100 {
            let linear = f64::from(k) / 100.0;
            let back = decode(encode(linear));
            assert!(
                (back - linear).abs() < 1e-14,
                "{linear} came back as {back}"
            );
        }
        assert_eq!(decode(1.0), 1.0);
        assert!((decode(0.5) - 0.214_041_140_482_232_55).abs() < 1e-15);
        let jump = decode(0.040_450_000_1) - decode(0.040_45);
        assert!(jump.abs() < 1e-7, "{jump}");
        for byte in 0..=255u8 {
            assert_eq!(encode_byte(decode(f64::from(byte) / 255.0) as f32), byte);
        }
    }
}
