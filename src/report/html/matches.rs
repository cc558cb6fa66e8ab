//! Verified matches, drawn between every photo and the one that it shares most with.

use super::element::{escape, folded};
use crate::pipeline::{load_keypoints, load_pairs};
use crate::store::RunDir;
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
pub fn section(run: &RunDir, posed: &PosedViews, thumbs: &[Thumb]) -> anyhow::Result<String> {
    let pairs = load_pairs(run)?;
    let view_of = |photo| posed.views.iter().position(|view| view.photo == photo);
    let mut drawn: Vec<(usize, usize)> = Vec::new();
    let mut html = String::new();
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
        html += &folded(&names, index == 0, &figure);
    }
    Ok(if html.is_empty() {
        html
    } else {
        format!("<section><h2>Matches</h2>{html}</section>")
    })
}

fn drawing(
    names: &str,
    pair: &PairMatches,
    points: &[[[f64; 2]; 2]],
    left: &Thumb,
    right: &Thumb,
) -> String {
    let shift = left.width + GAP;
    let (width, height) = (shift + right.width, left.height.max(right.height));
    let every = points.len().div_ceil(MAX_NUM_LINES).max(1);
    let mut marks = String::new();
    for (k, [[px, py], [qx, qy]]) in points.iter().step_by(every).enumerate() {
        let (x1, y1) = (px / left.step, py / left.step);
        let (x2, y2) = (shift + qx / right.step, qy / right.step);
        // Neighbouring lines differ in hue, so that single ones can be followed.
        marks += &format!(
            "<g stroke=\"hsl({} 90% 55%)\"><path d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\"/>\
             <circle cx=\"{x1:.1}\" cy=\"{y1:.1}\" r=\"2\"/><circle cx=\"{x2:.1}\" cy=\"{y2:.1}\" \
             r=\"2\"/></g>",
            k * 47 % 360
        );
    }
    format!(
        "<figure><svg class=\"matches\" viewBox=\"0 0 {width:.0} {height:.0}\" role=\"img\" \
         aria-label=\"Matches between {name}\"><image href=\"{}\" width=\"{:.0}\" height=\"{:.0}\"/>\
         <image href=\"{}\" x=\"{shift:.0}\" width=\"{:.0}\" height=\"{:.0}\"/>{marks}</svg>\
         <figcaption>{} verified matches, from {} by likeness alone; every {every}. is drawn; a homography explains {:.0} % \
         of them</figcaption></figure>",
        left.picture,
        left.width,
        left.height,
        right.picture,
        right.width,
        right.height,
        pair.matches.len(),
        pair.num_putative,
        100.0 * pair.homography_share,
        name = escape(names),
    )
}
