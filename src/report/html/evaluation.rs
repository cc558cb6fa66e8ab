//! Accuracy against the truth: error maps of every view and how the errors are distributed.

use super::element::{figure, folded};
use super::picture::{Album, Window};
use super::plot;
use super::views::bar;
use maud::{Markup, html};
use rilievo_scene::Raster;

/// Relative depth error that is shown as full brightness: one per cent.
const DEPTH_MAX: f32 = 0.01;
/// Angle between normals that is shown as full brightness, degrees.
const NORMAL_MAX_DEG: f32 = 30.0;

/// Views beyond this many have no maps in the page.
const MAX_NUM_VIEWS: usize = 40;
/// Bytes of the page that all maps may take.
const MAP_BYTES: usize = 900_000;

/// Errors of one view's pixels; negative where there is nothing to compare.
#[derive(Clone, Debug)]
pub struct ViewErrors {
    /// The view.
    pub name: String,
    /// Relative errors of depth, where the truth has depth.
    pub depth_rel: Option<Raster<f32>>,
    /// Angles between normals, degrees, where the truth has normals.
    pub normal_deg: Option<Raster<f32>>,
}

/// Values of all views that exist.
fn values<'a>(maps: impl Iterator<Item = &'a Raster<f32>>, factor: f64) -> Vec<f64> {
    maps.flat_map(|map| &map.data)
        .filter(|v| **v >= 0.0)
        .map(|&v| factor * f64::from(v))
        .collect()
}

/// The section: the table of numbers, distributions, and maps. `deviations` are the sizes of the
/// cloud's distances, and their unit.
pub fn section(table: &str, views: &[ViewErrors], deviations: (&[f64], &str)) -> Markup {
    let (sizes, length) = deviations;
    let depth = values(views.iter().filter_map(|v| v.depth_rel.as_ref()), 100.0);
    let normal = values(views.iter().filter_map(|v| v.normal_deg.as_ref()), 1.0);
    let curves = [
        (
            "Share of the pixels within a relative depth error",
            "%",
            depth,
        ),
        (
            "Share of the pixels within an angle between normals",
            "°",
            normal,
        ),
        (
            "Share of the cloud's points within a distance from the surface",
            length,
            sizes.to_vec(),
        ),
    ];
    let every = views.len().div_ceil(MAX_NUM_VIEWS).max(1);
    let album = Album::new(MAP_BYTES, 2 * views.len().div_ceil(every));
    html! {
        section id="accuracy" {
            h2 { "Accuracy against the truth" }
            pre { (table) }
            @for (title, unit, errors) in curves { (plot::cumulative(title, unit, errors)) }
            @for (index, view) in views.iter().step_by(every).enumerate() {
                (folded(&format!("Errors of {}", view.name), index == 0, &maps(&album, view)))
            }
        }
    }
}

fn maps(album: &Album, view: &ViewErrors) -> Markup {
    let error_map = |map: Option<&Raster<f32>>, max: f32, what: &str, most: &str| {
        let caption = html! { (what) "; grey was not compared" (bar("inferno", "0", most)) };
        let alt = format!("{what} of {}", view.name);
        let picture = |map| album.scalar(map, compared(map), max);
        map.map(|map| figure(&picture(map), &alt, &caption))
    };
    let depth_max = format!("{} % and more", 100.0 * DEPTH_MAX);
    let normal_max = format!("{NORMAL_MAX_DEG}° and more");
    let (depth, normal) = (view.depth_rel.as_ref(), view.normal_deg.as_ref());
    let maps = [
        error_map(depth, DEPTH_MAX, "Relative error of depth", &depth_max),
        error_map(normal, NORMAL_MAX_DEG, "Angle between normals", &normal_max),
    ];
    html! { div.pictures.errors { @for map in maps.into_iter().flatten() { (map) } } }
}

/// The part of a map where something is compared; all of it where nothing is.
fn compared(map: &Raster<f32>) -> Window {
    let is_compared = |&v: &f32| if v >= 0.0 { 1.0 } else { 0.0 };
    Window::around(&Raster {
        width: map.width,
        height: map.height,
        data: map.data.iter().map(is_compared).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_map_has_its_picture_and_legend() {
        let map = Raster::from_fn(30, 20, |x, _| if x < 10 { -1.0 } else { 0.002 });
        let view = ViewErrors {
            name: "<a>".into(),
            depth_rel: Some(map.clone()),
            normal_deg: Some(map),
        };
        let html = section("a < b", &[view], (&[0.1, 0.2], "mm")).into_string();
        assert_eq!(html.matches("<img").count(), 2);
        assert_eq!(html.matches("<svg").count(), 3);
        assert!(html.contains("a &lt; b") && html.contains("Errors of &lt;a&gt;"));
        assert!(!html.contains("<a>") && !html.contains("NaN"), "{html}");
    }
}
