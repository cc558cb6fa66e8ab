//! ICC profiles: how large one may be, and its tone curve `linear = f(stored)` (`gTRC`, `kTRC`).
//!
//! Source: ICC.1:2022, sections 10.6 (`curv`) and 10.18 (`para`). The three channels of every
//! working space in use share one curve, so the green one stands for all. Primaries are left as
//! they are: shading needs intensities that are proportional to light, not colours of a standard
//! observer.

/// More bytes than any colour profile has; those with printers' tables reach a few megabytes.
/// Without its profile a photo's values would be misread, so that a larger one is refused, not left
/// out.
pub(super) const MAX_PROFILE_BYTES: usize = 32 << 20;

/// Steps of the table that stands for a curve; between them it is interpolated linearly.
const TABLE_LEN: usize = 4096;

/// Largest difference at which a curve still counts as linear or as sRGB: a step of 8 bits.
const SAME_CURVE: f64 = 1.0 / 255.0;

/// Why a profile of more than [`MAX_PROFILE_BYTES`] is refused.
pub(super) fn profile_too_large() -> String {
    let megabytes = MAX_PROFILE_BYTES >> 20;
    format!("its colour profile holds more than {megabytes} MB; save it without, in sRGB or linear")
}

/// A profile's tone curve.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum ToneCurve {
    /// The identity.
    Linear,
    /// The sRGB curve.
    Srgb,
    /// Linear values at equal steps of the stored value.
    Other(Vec<f32>),
}

/// The curve of a profile; `None` where it has no plain one (look-up tables) or is damaged.
pub(super) fn tone_curve(profile: &[u8]) -> Option<ToneCurve> {
    let tag = find_tag(profile, b"gTRC").or_else(|| find_tag(profile, b"kTRC"))?;
    let curve = parse(tag)?;
    let table: Vec<f64> = (0..TABLE_LEN)
        .map(|i| curve.at(i as f64 / (TABLE_LEN - 1) as f64))
        .collect();
    let increasing = table.windows(2).all(|pair| pair[0] <= pair[1]);
    if !increasing || table.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let distance = |f: fn(f64) -> f64| {
        table.iter().enumerate().fold(0.0f64, |worst, (i, value)| {
            worst.max((f(i as f64 / (TABLE_LEN - 1) as f64) - value).abs())
        })
    };
    Some(if distance(|x| x) < SAME_CURVE {
        ToneCurve::Linear
    } else if distance(rilievo_scene::srgb::decode) < SAME_CURVE {
        ToneCurve::Srgb
    } else {
        ToneCurve::Other(table.into_iter().map(|value| value as f32).collect())
    })
}

/// The table of `linear = stored^gamma`.
pub(super) fn power_table(gamma: f64) -> Vec<f32> {
    (0..TABLE_LEN)
        .map(|i| (i as f64 / (TABLE_LEN - 1) as f64).powf(gamma) as f32)
        .collect()
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    let word = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_be_bytes(word.try_into().ok()?))
}

fn find_tag<'a>(profile: &'a [u8], name: &[u8; 4]) -> Option<&'a [u8]> {
    let num_tags = u32_at(profile, 128)?.min(1000) as usize;
    (0..num_tags).find_map(|i| {
        let entry = 132 + 12 * i;
        if profile.get(entry..entry + 4)? != name {
            return None;
        }
        let start = u32_at(profile, entry + 4)? as usize;
        let len = u32_at(profile, entry + 8)? as usize;
        profile.get(start..start.checked_add(len)?)
    })
}

enum Curve {
    /// `g a b c d e f` of function type 4 of `para`, of which the others are special cases:
    /// `(a x + b)^g + e` from `d` on, `c x + f` below.
    Parametric([f64; 7]),
    Sampled(Vec<f64>),
}

impl Curve {
    fn power(g: f64) -> Self {
        Self::Parametric([g, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    fn at(&self, x: f64) -> f64 {
        match self {
            &Self::Parametric([g, a, b, c, d, e, f]) => {
                if x >= d {
                    (a * x + b).max(0.0).powf(g) + e
                } else {
                    c * x + f
                }
            }
            Self::Sampled(values) => {
                let position = x * (values.len() - 1) as f64;
                let low = (position.floor() as usize).min(values.len() - 2);
                let share = position - low as f64;
                values[low] * (1.0 - share) + values[low + 1] * share
            }
        }
    }
}

fn parse(tag: &[u8]) -> Option<Curve> {
    match tag.get(..4)? {
        b"curv" => {
            let count = u32_at(tag, 8)? as usize;
            let value = |i: usize| {
                let word = tag.get(12 + 2 * i..14 + 2 * i)?;
                Some(f64::from(u16::from_be_bytes(word.try_into().ok()?)))
            };
            match count {
                0 => Some(Curve::power(1.0)),
                1 => Some(Curve::power(value(0)? / 256.0)),
                _ if count > tag.len() => None,
                _ => (0..count)
                    .map(|i| value(i).map(|v| v / 65535.0))
                    .collect::<Option<Vec<_>>>()
                    .map(Curve::Sampled),
            }
        }
        b"para" => {
            let kind = u16::from_be_bytes(tag.get(8..10)?.try_into().ok()?);
            let p = |i: usize| Some(f64::from(u32_at(tag, 12 + 4 * i)? as i32) / 65536.0);
            let g = p(0)?;
            Some(match kind {
                0 => Curve::power(g),
                1 | 2 => {
                    let (a, b) = (p(1)?, p(2)?);
                    let e = if kind == 2 { p(3)? } else { 0.0 };
                    (a != 0.0).then_some(())?;
                    Curve::Parametric([g, a, b, 0.0, -b / a, e, e])
                }
                3 => Curve::Parametric([g, p(1)?, p(2)?, p(3)?, p(4)?, 0.0, 0.0]),
                4 => Curve::Parametric([g, p(1)?, p(2)?, p(3)?, p(4)?, p(5)?, p(6)?]),
                _ => return None,
            })
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn profile(tag: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes.extend(1u32.to_be_bytes());
        bytes.extend(b"gTRC");
        bytes.extend(144u32.to_be_bytes());
        bytes.extend((tag.len() as u32).to_be_bytes());
        bytes.extend(tag);
        bytes
    }

    fn curv(values: &[u16]) -> Vec<u8> {
        let mut tag = b"curv\0\0\0\0".to_vec();
        tag.extend((values.len() as u32).to_be_bytes());
        values.iter().for_each(|v| tag.extend(v.to_be_bytes()));
        profile(&tag)
    }

    fn para(kind: u16, values: &[f64]) -> Vec<u8> {
        let mut tag = b"para\0\0\0\0".to_vec();
        tag.extend(kind.to_be_bytes());
        tag.extend([0, 0]);
        values
            .iter()
            .for_each(|v| tag.extend(((v * 65536.0).round() as i32).to_be_bytes()));
        profile(&tag)
    }

    #[test]
    fn known_curves_are_recognised() {
        assert_eq!(tone_curve(&curv(&[])), Some(ToneCurve::Linear));
        assert_eq!(tone_curve(&curv(&[256])), Some(ToneCurve::Linear));
        assert_eq!(tone_curve(&curv(&[0, 65535])), Some(ToneCurve::Linear));
        assert_eq!(tone_curve(&para(0, &[1.0])), Some(ToneCurve::Linear));
        let table: Vec<u16> = (0..1024)
            .map(|i| (rilievo_scene::srgb::decode(f64::from(i) / 1023.0) * 65535.0).round() as u16)
            .collect();
        assert_eq!(tone_curve(&curv(&table)), Some(ToneCurve::Srgb));
        let parameters = [2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.04045];
        assert_eq!(tone_curve(&para(3, &parameters)), Some(ToneCurve::Srgb));
    }

    #[test]
    fn another_gamma_becomes_a_table() {
        let Some(ToneCurve::Other(table)) = tone_curve(&curv(&[461])) else {
            panic!("gamma 1.8 is neither linear nor sRGB");
        };
        let middle = table[2048];
        let expected = (2048.0f32 / 4095.0).powf(461.0 / 256.0);
        assert!((middle - expected).abs() < 1e-5, "{middle} {expected}");
    }

    #[test]
    fn no_part_of_a_profile_panics() {
        for whole in [
            curv(&[1, 2, 3]),
            para(4, &[2.4, 1.0, 0.0, 1.0, 0.1, 0.0, 0.0]),
        ] {
            for end in 0..whole.len() {
                let _ = tone_curve(&whole[..end]);
            }
        }
    }
}
