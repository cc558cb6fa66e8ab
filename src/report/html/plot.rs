//! Convergence of an iterative solver as an inline drawing.

use super::element::escape;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 220.0;
const MARGIN: f64 = 44.0;
/// Dashes tell the curves apart without colour.
const STYLES: [(&str, &str); 3] = [("#1f5fa8", ""), ("#a34700", "6 3"), ("#4a7a1c", "2 3")];

/// Curves over their index, on a logarithmic scale; empty when there is nothing positive to draw.
pub fn logarithmic(title: &str, curves: &[(&str, Vec<f64>)]) -> String {
    let usable = |value: &f64| value.is_finite() && *value > 0.0;
    let logs = curves
        .iter()
        .flat_map(|(_, values)| values.iter().filter(|v| usable(v)).map(|v| v.log10()));
    let (low, high) = logs.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    let length = curves.iter().map(|(_, values)| values.len()).max();
    let Some(length) = length.filter(|&length| length > 1 && low.is_finite()) else {
        return String::new();
    };
    let (low, high) = (low.floor(), high.ceil().max(low.floor() + 1.0));
    let x = |index: usize| MARGIN + (WIDTH - 2.0 * MARGIN) * index as f64 / (length - 1) as f64;
    let y = |log: f64| HEIGHT - MARGIN / 2.0 - (HEIGHT - MARGIN) * (log - low) / (high - low);
    let mut svg = format!(
        "<svg class=\"plot\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
        escape(title)
    );
    let mut decade = low;
    while decade <= high {
        svg += &format!(
            "<path class=\"grid\" d=\"M{MARGIN} {y:.1}H{:.1}\"/><text x=\"4\" y=\"{:.1}\">1e{decade}</text>",
            WIDTH - MARGIN,
            y(decade) + 4.0,
            y = y(decade)
        );
        decade += 1.0;
    }
    for (k, (name, values)) in curves.iter().enumerate() {
        let (color, dash) = STYLES[k % STYLES.len()];
        let points: Vec<String> = values
            .iter()
            .enumerate()
            .filter(|(_, value)| usable(value))
            .map(|(index, value)| format!("{:.1},{:.1}", x(index), y(value.log10())))
            .collect();
        svg += &format!(
            "<polyline fill=\"none\" stroke=\"{color}\" stroke-width=\"1.6\" \
             stroke-dasharray=\"{dash}\" points=\"{}\"/>\
             <text x=\"{:.1}\" y=\"14\" fill=\"{color}\">{}</text>",
            points.join(" "),
            MARGIN + 170.0 * k as f64,
            escape(name)
        );
    }
    svg + &format!(
        "<text x=\"{:.1}\" y=\"{:.1}\">iteration {length}</text></svg>",
        WIDTH - 100.0,
        HEIGHT - 4.0
    )
}

/// How many of `errors` lie within a size, up to their 98 % quantile; empty without errors.
pub fn cumulative(title: &str, unit: &str, mut errors: Vec<f64>) -> String {
    errors.retain(|e| e.is_finite());
    errors.sort_by(f64::total_cmp);
    let Some(&largest) = errors.get(errors.len() * 98 / 100).filter(|e| **e > 0.0) else {
        return String::new();
    };
    let x = |error: f64| MARGIN + (WIDTH - 2.0 * MARGIN) * error / largest;
    let y = |share: f64| HEIGHT - MARGIN / 2.0 - (HEIGHT - MARGIN) * share;
    let mut svg = format!(
        "<figure><svg class=\"plot\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
        escape(title)
    );
    for quarter in 0..=4 {
        let share = 0.25 * f64::from(quarter);
        svg += &format!(
            "<path class=\"grid\" d=\"M{MARGIN} {y:.1}H{:.1}\"/><text x=\"4\" y=\"{:.1}\">{:.0} %</text>\
             <text x=\"{:.1}\" y=\"{:.1}\">{:.3} {unit}</text>",
            WIDTH - MARGIN,
            y(share) + 4.0,
            100.0 * share,
            x(share * largest) - 14.0,
            HEIGHT - 4.0,
            share * largest,
            y = y(share)
        );
    }
    const NUM_STEPS: usize = 200;
    let points: Vec<String> = (0..=NUM_STEPS)
        .map(|k| {
            let error = largest * k as f64 / NUM_STEPS as f64;
            let within = errors.partition_point(|e| *e <= error) as f64 / errors.len() as f64;
            format!("{:.1},{:.1}", x(error), y(within))
        })
        .collect();
    svg + &format!(
        "<polyline fill=\"none\" stroke=\"{}\" stroke-width=\"1.6\" points=\"{}\"/></svg>\
         <figcaption>{}; half lie within {:.3} {unit}</figcaption></figure>",
        STYLES[0].0,
        points.join(" "),
        escape(title),
        errors[errors.len() / 2]
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_spans_its_decades_and_nothing_is_drawn_from_nothing() {
        let svg = logarithmic("energy", &[("energy", vec![100.0, 10.0, 0.5, f64::NAN])]);
        assert!(svg.contains("1e-1") && svg.contains("1e2"), "{svg}");
        assert!(!svg.contains("NaN"), "{svg}");
        assert_eq!(logarithmic("x", &[("x", vec![0.0, 0.0])]), "");
        assert_eq!(logarithmic("x", &[]), "");
    }
}
