//! Where errors of normals lie: rings inside the outline, depth edges, steep places, and the rest.
//!
//! Errors at an outline (photo pixels that mix object and background, a mask that is off by a
//! pixel, a surface that turns away) have other causes than those inside, and a mean over all
//! pixels hides both.

use super::edges::{depth_edges, widened};
use super::truth::TruthView;
use nalgebra::Point2;
use rilievo_scene::Raster;
use serde::Serialize;

/// The rings inside the outline by their outer limits in pixels, the widest first.
const RINGS_PX: [(Region, f32); 4] = [
    (Region::Outline6Px, 6.0),
    (Region::Outline3Px, 3.0),
    (Region::Outline2Px, 2.0),
    (Region::Outline1Px, 1.0),
];
/// Width of what counts as beside a depth edge, pixels.
const EDGE_PX: f32 = 8.0;
/// Tilt of the true normal against the line of sight from which a place is steep, degrees.
const STEEP_DEG: f64 = 60.0;

/// A part of the pixels; they share no pixel, and together hold all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// Up to one pixel inside the outline of what the truth knows, or the photo's end.
    #[serde(rename = "outline_1_px")]
    Outline1Px,
    /// From there to two pixels.
    #[serde(rename = "outline_2_px")]
    Outline2Px,
    /// From there to three pixels.
    #[serde(rename = "outline_3_px")]
    Outline3Px,
    /// From there to six pixels.
    #[serde(rename = "outline_6_px")]
    Outline6Px,
    /// Farther inside, up to eight pixels from a depth edge, on either side.
    #[serde(rename = "depth_edge_8_px")]
    DepthEdge8Px,
    /// Farther from both, tilted by more than 60 degrees against the line of sight.
    Steep,
    /// The rest.
    Inner,
}

impl Region {
    /// All of them, from the outline inwards.
    pub const ALL: [Self; 7] = [
        Self::Outline1Px,
        Self::Outline2Px,
        Self::Outline3Px,
        Self::Outline6Px,
        Self::DepthEdge8Px,
        Self::Steep,
        Self::Inner,
    ];

    /// What it is called in a table.
    pub fn label(self) -> &'static str {
        match self {
            Self::Outline1Px => "outline, to 1 px",
            Self::Outline2Px => "outline, 1 to 2 px",
            Self::Outline3Px => "outline, 2 to 3 px",
            Self::Outline6Px => "outline, 3 to 6 px",
            Self::DepthEdge8Px => "depth edges, to 8 px",
            Self::Steep => "inner, over 60 deg",
            Self::Inner => "inner",
        }
    }
}

/// Sums over a region's compared normals.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RegionSums {
    /// Compared normals.
    pub num_px: usize,
    /// Sum of their errors, degrees.
    pub sum_deg: f64,
}

/// The error of normals in a region.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RegionError {
    /// Which.
    pub region: Region,
    /// Its share of the compared normals.
    pub share: f64,
    /// Mean angle between normals there, degrees; `None` without any pixel.
    pub normal_mae_deg: Option<f64>,
    /// What it adds to the mean angle of all regions, degrees.
    pub adds_deg: f64,
}

/// Errors by region from their sums, in the order of [`Region::ALL`]; empty where nothing was
/// compared.
pub fn region_errors(sums: &[RegionSums; Region::ALL.len()]) -> Vec<RegionError> {
    let num: usize = sums.iter().map(|sums| sums.num_px).sum();
    if num == 0 {
        return Vec::new();
    }
    let region_error = |(region, sums): (Region, &RegionSums)| RegionError {
        region,
        share: sums.num_px as f64 / num as f64,
        normal_mae_deg: (sums.num_px > 0).then(|| sums.sum_deg / sums.num_px as f64),
        adds_deg: sums.sum_deg / num as f64,
    };
    Region::ALL
        .into_iter()
        .zip(sums)
        .map(region_error)
        .collect()
}

/// The region of every pixel that the truth knows; of others it means nothing.
///
/// Without true depth there are no depth edges.
pub(super) fn regions(truth: &TruthView) -> Raster<Region> {
    let (width, height) = truth.maps.size();
    let outside = Raster::from_fn(width, height, |x, y| !truth.maps.is_known(x, y));
    let innermost = |x: usize, y: usize| {
        let ray = truth.intrinsics.ray(&Point2::new(x as f64, y as f64));
        let ray = ray.normalize();
        let normal = truth.maps.normal().and_then(|map| map.normal(x, y));
        let is_steep =
            normal.is_some_and(|n| -n.dot(&ray) < n.norm() * STEEP_DEG.to_radians().cos());
        if is_steep {
            Region::Steep
        } else {
            Region::Inner
        }
    };
    let mut regions = Raster::from_fn(width, height, innermost);
    let mut mark = |near: Raster<bool>, with: Region| {
        for (region, near) in regions.data.iter_mut().zip(near.data) {
            if near {
                *region = with;
            }
        }
    };
    if let Some(depth) = truth.maps.depth() {
        mark(
            widened(&depth_edges(depth), EDGE_PX, false),
            Region::DepthEdge8Px,
        );
    }
    // The last mark holds.
    for (ring, limit) in RINGS_PX {
        mark(widened(&outside, limit, true), ring);
    }
    regions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::{TruthMaps, compare_maps};
    use rilievo_scene::{DepthMap, Intrinsics, NormalMap};

    const SIZE: usize = 60;

    /// A square that fills the frame but for a margin of ten pixels, its right part behind a step
    /// of depth.
    fn truth() -> TruthView {
        let known = |x: usize, y: usize| (10..50).contains(&x) && (10..50).contains(&y);
        let depth = DepthMap::from_fn(SIZE, SIZE, |x, y| match (known(x, y), x < 30) {
            (false, _) => 0.0,
            (true, true) => 1.0,
            (true, false) => 1.5,
        });
        let normal = NormalMap::from_fn(SIZE, SIZE, |x, y| match (known(x, y), y < 30) {
            (false, _) => [0.0; 3],
            (true, true) => [0.0, 0.0, -1.0],
            (true, false) => [0.0, -0.96, -0.28],
        });
        TruthView {
            name: "IMG_0001".into(),
            intrinsics: Intrinsics::pinhole(SIZE, SIZE, 800.0, 29.5, 29.5),
            maps: TruthMaps::Both(depth, normal),
        }
    }

    #[test]
    fn rings_edges_and_steep_places_hold_the_pixels_that_lie_there() {
        let regions = regions(&truth());
        let at = |x: usize, y: usize| *regions.at(x, y);
        assert_eq!(at(10, 20), Region::Outline1Px);
        assert_eq!(at(11, 20), Region::Outline2Px);
        assert_eq!(at(12, 20), Region::Outline3Px);
        assert_eq!(at(13, 20), Region::Outline6Px);
        assert_eq!(at(15, 20), Region::Outline6Px);
        assert_eq!(at(16, 20), Region::Inner);
        assert_eq!(at(20, 20), Region::Inner);
        // The edge lies between columns 29 and 30.
        assert_eq!(at(21, 20), Region::DepthEdge8Px);
        assert_eq!(at(38, 20), Region::DepthEdge8Px);
        assert_eq!(at(39, 20), Region::Inner);
        assert_eq!(at(20, 40), Region::Steep);
        // Beyond the frame there is no edge.
        let whole = TruthView {
            maps: TruthMaps::Depth(DepthMap::filled(SIZE, SIZE, 1.0)),
            ..truth()
        };
        let regions = super::regions(&whole);
        assert_eq!(*regions.at(0, 30), Region::Outline1Px);
        assert_eq!(*regions.at(7, 30), Region::Inner);
    }

    #[test]
    fn an_error_is_told_where_it_lies_and_the_regions_add_up() {
        let truth = truth();
        let TruthMaps::Both(depth, normal) = &truth.maps else {
            panic!("both are given");
        };
        let exact = compare_maps(&truth, Some(depth), Some(normal), 1.0).expect("sizes agree");
        assert!(exact.summary().regions.iter().all(|r| r.adds_deg < 1e-3));

        // Turned by 90 degrees in the outermost column alone.
        let mut turned = normal.clone();
        for y in 10..50 {
            *turned.at_mut(10, y) = [1.0, 0.0, 0.0];
        }
        let errors = compare_maps(&truth, Some(depth), Some(&turned), 1.0).expect("sizes agree");
        let summary = errors.summary();
        let adds: f64 = summary.regions.iter().map(|r| r.adds_deg).sum();
        let mean = summary.normal_mae_deg.expect("normals are compared");
        assert!((adds - mean).abs() < 1e-9, "{adds} {mean}");
        let shares: f64 = summary.regions.iter().map(|r| r.share).sum();
        assert!((shares - 1.0).abs() < 1e-12, "{shares}");
        for region in &summary.regions {
            let is_hit = region.region == Region::Outline1Px;
            assert_eq!(region.adds_deg > 0.5, is_hit, "{region:?}");
            assert!(is_hit || region.adds_deg < 1e-3, "{region:?}");
        }
        // 40 of the ring's 4 * 40 - 4 pixels.
        let ring = summary.regions[0].normal_mae_deg.expect("pixels lie there");
        assert!((ring - 90.0 * 40.0 / 156.0).abs() < 1e-3, "{ring}");
    }

    #[test]
    fn without_anything_compared_there_are_no_regions() {
        assert_eq!(region_errors(&[RegionSums::default(); 7]), Vec::new());
    }
}
