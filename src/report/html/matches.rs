//! Verified matches, drawn between every photo and the one that it shares most with.

use super::element::folded;
use crate::pipeline::{load_keypoints, load_pairs};
use crate::store::RunDir;
use maud::{Markup, html};
use rilievo_scene::{PairMatches, PosedViews};

/// Lines beyond this many hide the photos.
const MAX_NUM_LINES: usize = 150;
/// Space between the two photos, pixels of the drawing.
const GAP: f64 = 8.0;

/// A photo as it stands in the page.
pub struct Thumb {
    /// Data URL of the picture.
    pub picture: String,
    /// Its columns.
    pub width: f64,
    /// Its rows.
    pub height: f64,
    /// Pixels of the photo per pixel of the picture.
    pub step: f64,
}

/// The section; `thumbs` are those of the posed views.
///
/// # Errors
/// When keypoints or matches cannot be read.
pub fn section(run: &RunDir, posed: &PosedViews, thumbs: &[Thumb]) -> anyhow::Result<Markup> {
    let pairs = load_pairs(run)?;
    let view_of = |photo| posed.views.iter().position(|view| view.photo == photo);
    let mut drawn: Vec<(usize, usize)> = Vec::new();
    let mut drawings = Vec::new();
    for (index, view) in posed.views.iter().enumerate() {
        let best = pairs
            .iter()
            .filter(|pair| pair.first == view.photo || pair.second == view.photo)
            .filter_map(|pair| Some((pair, view_of(pair.first)?, view_of(pair.second)?)))
            .max_by_key(|(pair, ..)| pair.matches.len());
        let Some((pair, a, b)) = best.filter(|(_, a, b)| !drawn.contains(&(*a, *b))) else {
            continue;
        };
        drawn.push((a, b));
        let keypoints = [
            load_keypoints(run, &posed.views[a].name)?,
            load_keypoints(run, &posed.views[b].name)?,
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
        let names = format!(
            "{} and {}",
            posed.views[a].file_name, posed.views[b].file_name
        );
        let figure = drawing(&names, pair, &points, &thumbs[a], &thumbs[b]);
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
    left: &Thumb,
    right: &Thumb,
) -> Markup {
    let shift = left.width + GAP;
    let window = format!(
        "0 0 {:.0} {:.0}",
        shift + right.width,
        left.height.max(right.height)
    );
    let every = points.len().div_ceil(MAX_NUM_LINES).max(1);
    let lines = points.iter().step_by(every).enumerate();
    let whole = |length: f64| format!("{length:.0}");
    html! {
        figure {
            svg.matches viewBox=(window) role="img" aria-label=(format!("Matches between {names}")) {
                image href=(left.picture) width=(whole(left.width)) height=(whole(left.height)) {}
                image href=(right.picture) x=(whole(shift)) width=(whole(right.width))
                    height=(whole(right.height)) {}
                @for (k, [[px, py], [qx, qy]]) in lines {
                    @let (x1, y1) = (px / left.step, py / left.step);
                    @let (x2, y2) = (shift + qx / right.step, qy / right.step);
                    // Neighbouring lines differ in hue, so that single ones can be followed.
                    g stroke=(format!("hsl({} 90% 55%)", k * 47 % 360)) {
                        path d=(format!("M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}")) {}
                        circle cx=(format!("{x1:.1}")) cy=(format!("{y1:.1}")) r="2" {}
                        circle cx=(format!("{x2:.1}")) cy=(format!("{y2:.1}")) r="2" {}
                    }
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
