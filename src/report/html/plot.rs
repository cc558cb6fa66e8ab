//! Convergence of an iterative solver, distributions of errors, and values by wavelength, as inline
//! drawings.

use maud::{Markup, html};

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 220.0;
const MARGIN: f64 = 44.0;
/// Dashes tell the curves apart without colour.
const STYLES: [(&str, &str); 3] = [("#1f5fa8", ""), ("#a34700", "6 3"), ("#4a7a1c", "2 3")];

/// An empty drawing with its title.
fn drawing(title: &str, content: &Markup) -> Markup {
    let window = format!("0 0 {WIDTH} {HEIGHT}");
    html! { svg.plot viewBox=(window) role="img" aria-label=(title) { (content) } }
}

/// A horizontal line with its value.
fn grid_line(y: f64, label: &str) -> Markup {
    let end = WIDTH - MARGIN;
    html! {
        path.grid d=(format!("M{MARGIN} {y:.1}H{end:.1}")) {}
        text x="4" y=(format!("{:.1}", y + 4.0)) { (label) }
    }
}

fn curve(style: (&str, &str), points: &[String]) -> Markup {
    html! {
        polyline fill="none" stroke=(style.0) stroke-width="1.6" stroke-dasharray=(style.1)
            points=(points.join(" ")) {}
    }
}

/// Curves over their index, on a logarithmic scale; empty when there is nothing positive to draw.
pub fn logarithmic(title: &str, curves: &[(&str, Vec<f64>)]) -> Markup {
    let usable = |value: &f64| value.is_finite() && *value > 0.0;
    let logs = curves
        .iter()
        .flat_map(|(_, values)| values.iter().filter(|v| usable(v)).map(|v| v.log10()));
    let (low, high) = logs.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    let length = curves.iter().map(|(_, values)| values.len()).max();
    let Some(length) = length.filter(|&length| length > 1 && low.is_finite()) else {
        return Markup::default();
    };
    let (low, high) = (low.floor(), high.ceil().max(low.floor() + 1.0));
    let x = |index: usize| MARGIN + (WIDTH - 2.0 * MARGIN) * index as f64 / (length - 1) as f64;
    let y = |log: f64| HEIGHT - MARGIN / 2.0 - (HEIGHT - MARGIN) * (log - low) / (high - low);
    let decades = (low as i32)..=(high as i32);
    let points = |values: &[f64]| -> Vec<String> {
        let known = values.iter().enumerate().filter(|(_, value)| usable(value));
        known
            .map(|(index, value)| format!("{:.1},{:.1}", x(index), y(value.log10())))
            .collect()
    };
    drawing(
        title,
        &html! {
            @for decade in decades { (grid_line(y(f64::from(decade)), &format!("1e{decade}"))) }
            @for (k, (name, values)) in curves.iter().enumerate() {
                @let style = STYLES[k % STYLES.len()];
                (curve(style, &points(values)))
                text x=(format!("{:.1}", MARGIN + 170.0 * k as f64)) y="14" fill=(style.0) { (name) }
            }
            text x=(WIDTH - 100.0) y=(HEIGHT - 4.0) { "iteration " (length) }
        },
    )
}

/// How many of `errors` lie within a size, up to their 98 % quantile; empty without errors.
pub fn cumulative(title: &str, unit: &str, mut errors: Vec<f64>) -> Markup {
    errors.retain(|e| e.is_finite());
    errors.sort_by(f64::total_cmp);
    let Some(&largest) = errors.get(errors.len() * 98 / 100).filter(|e| **e > 0.0) else {
        return Markup::default();
    };
    let x = |error: f64| MARGIN + (WIDTH - 2.0 * MARGIN) * error / largest;
    let y = |share: f64| HEIGHT - MARGIN / 2.0 - (HEIGHT - MARGIN) * share;
    const NUM_STEPS: usize = 200;
    let points: Vec<String> = (0..=NUM_STEPS)
        .map(|k| {
            let error = largest * k as f64 / NUM_STEPS as f64;
            let within = errors.partition_point(|e| *e <= error) as f64 / errors.len() as f64;
            format!("{:.1},{:.1}", x(error), y(within))
        })
        .collect();
    let plot = html! {
        @for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
            (grid_line(y(share), &format!("{:.0} %", 100.0 * share)))
            text x=(format!("{:.1}", x(share * largest) - 14.0)) y=(HEIGHT - 4.0) {
                (format!("{:.3} {unit}", share * largest))
            }
        }
        (curve(STYLES[0], &points))
    };
    html! {
        figure {
            (drawing(title, &plot))
            figcaption {
                (title) "; half lie within " (format!("{:.3} {unit}", errors[errors.len() / 2]))
            }
        }
    }
}

/// Values of 0 to 1 over wavelengths, in growing order, each an octave or more from the next;
/// `threshold` is drawn as a line. Empty with fewer than two.
pub fn by_wavelength(title: &str, values: &[(f64, f64)], threshold: f64) -> Markup {
    let (Some((low, _)), Some((high, _)), true) = (values.first(), values.last(), values.len() > 1)
    else {
        return Markup::default();
    };
    let x = |wavelength: f64| {
        MARGIN + (WIDTH - 2.0 * MARGIN) * (wavelength / low).ln() / (high / low).ln()
    };
    let y = |value: f64| HEIGHT - MARGIN / 2.0 - (HEIGHT - MARGIN) * value.clamp(0.0, 1.0);
    let points: Vec<String> = values
        .iter()
        .map(|&(wavelength, value)| format!("{:.1},{:.1}", x(wavelength), y(value)))
        .collect();
    let plot = html! {
        @for value in [0.0, threshold, 1.0] { (grid_line(y(value), &format!("{value}"))) }
        @for &(wavelength, _) in values {
            text x=(format!("{:.1}", x(wavelength) - 14.0)) y=(HEIGHT - 4.0) {
                (format!("{wavelength:.1}"))
            }
        }
        (curve(STYLES[0], &points))
    };
    html! { figure { (drawing(title, &plot)) figcaption { (title) } } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_spans_its_decades_and_nothing_is_drawn_from_nothing() {
        let svg = logarithmic("energy", &[("energy", vec![100.0, 10.0, 0.5, f64::NAN])]);
        let svg = svg.into_string();
        assert!(svg.contains("1e-1") && svg.contains("1e2"), "{svg}");
        assert!(!svg.contains("NaN"), "{svg}");
        let nothing = logarithmic("x", &[("x", vec![0.0, 0.0])]);
        assert_eq!(nothing.into_string(), "");
        assert_eq!(logarithmic("x", &[]).into_string(), "");
    }
}
