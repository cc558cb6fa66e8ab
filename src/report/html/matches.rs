//! Verified matches, drawn between every photo and the one that it shares most with.

use super::element::folded;
use crate::pipeline::{load_keypoints, load_pairs};
use crate::store::RunDir;
use maud::{Markup, html};
use rilievo_scene::{PairMatches, PosedViews};

/// Lines beyond this many hide the photos.
const MAX_NUM_LINES: usize = 150;
/// Width of a photo in the drawing, and the space between the two.
const WIDTH: f64 = 480.0;
const GAP: f64 = 8.0;
/// Neighbouring lines differ in hue, so that single ones can be followed.
const NUM_HUES: usize = 6;

/// A photo whose picture stands in the page.
pub struct Shown {
    /// The view.
    pub view: usize,
    /// Name of the picture's element, as wide as a frame of 1000 units on the longer side allows.
    pub picture: String,
    /// Columns of the photo.
    pub width: f64,
    /// Its rows.
    pub height: f64,
}

impl Shown {
    /// Units of the drawing per pixel of the photo.
    fn scale(&self) -> f64 {
        WIDTH / self.width
    }

    /// Factor of the picture, whose longer side has 1000 units.
    fn factor(&self) -> f64 {
        self.scale() * self.width.max(self.height) / 1000.0
    }
}

/// The section: each shown photo with the one of the others that it shares most with.
///
/// # Errors
/// When keypoints or matches cannot be read.
pub fn section(run: &RunDir, posed: &PosedViews, shown: &[Shown]) -> anyhow::Result<Markup> {
    let pairs = load_pairs(run)?;
    let shown_of = |photo| {
        shown
            .iter()
            .position(|s| posed.views[s.view].photo == photo)
    };
    let mut drawn: Vec<(usize, usize)> = Vec::new();
    let mut drawings = Vec::new();
    for (index, photo) in shown.iter().enumerate() {
        let view = &posed.views[photo.view];
        let best = pairs
            .iter()
            .filter(|pair| pair.first == view.photo || pair.second == view.photo)
            .filter_map(|pair| Some((pair, shown_of(pair.first)?, shown_of(pair.second)?)))
            .max_by_key(|(pair, ..)| pair.matches.len());
        let Some((pair, a, b)) = best.filter(|(_, a, b)| !drawn.contains(&(*a, *b))) else {
            continue;
        };
        drawn.push((a, b));
        let [left, right] = [&shown[a], &shown[b]];
        let views = [left, right].map(|photo| &posed.views[photo.view]);
        let keypoints = [
            load_keypoints(run, &views[0].name)?,
            load_keypoints(run, &views[1].name)?,
        ];
        let points: Vec<[[f64; 2]; 2]> = pair
            .matches
            .iter()
            .filter_map(|&[i, j]| {
                let p = keypoints[0].keypoints.get(i as usize)?;
                let q = keypoints[1].keypoints.get(j as usize)?;
                Some([[p.x, p.y].map(f64::from), [q.x, q.y].map(f64::from)])
            })
            .collect();
        let names = format!("{} and {}", views[0].file_name, views[1].file_name);
        let figure = drawing(&names, pair, &points, left, right);
        drawings.push(folded(&names, index == 0, &figure));
    }
    Ok(html! {
        @if !drawings.is_empty() {
            section { h2 { "Matches" } @for drawing in drawings { (drawing) } }
        }
    })
}

fn drawing(
    names: &str,
    pair: &PairMatches,
    points: &[[[f64; 2]; 2]],
    left: &Shown,
    right: &Shown,
) -> Markup {
    let shift = WIDTH + GAP;
    let height = (left.height * left.scale()).max(right.height * right.scale());
    let every = points.len().div_ceil(MAX_NUM_LINES).max(1);
    let mut lines = vec![String::new(); NUM_HUES];
    for (k, [[px, py], [qx, qy]]) in points.iter().step_by(every).enumerate() {
        let (x1, y1) = (px * left.scale(), py * left.scale());
        let (x2, y2) = (shift + qx * right.scale(), qy * right.scale());
        lines[k % NUM_HUES] += &format!("M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}");
    }
    let place = |x: f64, photo: &Shown| format!("translate({x:.0}) scale({:.5})", photo.factor());
    html! {
        figure {
            svg.matches viewBox=(format!("0 0 {:.0} {height:.0}", shift + WIDTH)) role="img"
                aria-label=(format!("Matches between {names}")) {
                use href=(format!("#{}", left.picture)) transform=(place(0.0, left)) {}
                use href=(format!("#{}", right.picture)) transform=(place(shift, right)) {}
                @for (k, lines) in lines.iter().enumerate() {
                    path stroke=(format!("hsl({} 90% 55%)", k * 360 / NUM_HUES)) d=(lines) {}
                }
            }
            figcaption {
                (pair.matches.len()) " verified matches, from " (pair.num_putative)
                " by likeness alone; every " (every) ". is drawn; a homography explains "
                (format!("{:.0}", 100.0 * pair.homography_share)) " % of them"
            }
        }
    }
}
