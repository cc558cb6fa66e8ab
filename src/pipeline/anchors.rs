//! Depth anchors as files for other programs: `anchors.ply` and the table `anchors.json`.

use super::artifacts;
use crate::store::StageWriter;
use rilievo_scene::{Anchor, AnchorObservation, AnchorOrigin, PosedViews, Unit};
use serde::Serialize;

/// The table. Observations are rows of numbers, since there are tens of thousands.
#[derive(Serialize)]
struct Table<'a> {
    unit: Unit,
    frame: String,
    /// To be added to positions for those of the world.
    #[serde(skip_serializing_if = "Option::is_none")]
    offset: Option<[f64; 3]>,
    views: Vec<&'a str>,
    columns: Columns,
    anchors: Vec<Row<'a>>,
}

/// What the numbers of a row are.
#[derive(Serialize)]
struct Columns {
    covariance: [&'static str; 6],
    observations: [&'static str; 5],
}

#[derive(Serialize)]
struct Row<'a> {
    position: &'a [f64; 3],
    covariance: &'a [f64; 6],
    origin: AnchorOrigin,
    observations: Vec<(usize, f64, f64, f64, f64)>,
}

/// Writes both files.
pub fn write(writer: &StageWriter, views: &PosedViews) -> anyhow::Result<()> {
    artifacts::write_json(writer, "anchors.json", &table(views))?;
    Ok(artifacts::write(writer, "anchors.ply", &ply(views))?)
}

fn table(views: &PosedViews) -> Table<'_> {
    let observation =
        |o: &AnchorObservation| (o.view.0, o.pixel[0], o.pixel[1], o.depth, o.sigma_ln_depth);
    Table {
        unit: views.scale.unit,
        frame: views.frame.of_file(),
        offset: views.coordinates().offset(),
        views: views.views.iter().map(|v| v.file_name.as_str()).collect(),
        columns: Columns {
            covariance: ["xx", "xy", "xz", "yy", "yz", "zz"],
            observations: ["view", "x_px", "y_px", "depth", "sigma_ln_depth"],
        },
        anchors: views
            .anchors
            .iter()
            .map(|anchor| Row {
                position: &anchor.position,
                covariance: &anchor.covariance,
                origin: anchor.origin,
                observations: anchor.observations.iter().map(observation).collect(),
            })
            .collect(),
    }
}

/// Standard deviation along the most uncertain axis is at most the root of the trace; that is what
/// a viewer can colour by.
fn sigma(anchor: &Anchor) -> f64 {
    let [xx, _, _, yy, _, zz] = anchor.covariance;
    (xx + yy + zz).max(0.0).sqrt()
}

fn ply(views: &PosedViews) -> Vec<u8> {
    let comments = views.coordinates().comments();
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\ncomment {}\ncomment sigma: root of the covariance's trace\n\
         element vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property float sigma\nproperty uchar views\nend_header\n",
        comments.join("\ncomment "),
        views.anchors.len()
    )
    .into_bytes();
    for anchor in &views.anchors {
        for v in anchor.position {
            bytes.extend((v as f32).to_le_bytes());
        }
        bytes.extend((sigma(anchor) as f32).to_le_bytes());
        bytes.push(anchor.observations.len().min(255) as u8);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::ViewIdx;

    fn one_anchor() -> PosedViews {
        PosedViews {
            anchors: vec![Anchor {
                position: [1.0, 2.0, 3.0],
                covariance: [4e-6, 0.0, 0.0, 4e-6, 0.0, 1e-6],
                origin: AnchorOrigin::Grown,
                observations: vec![AnchorObservation {
                    view: ViewIdx(1),
                    pixel: [10.5, 20.25],
                    depth: 0.5,
                    sigma_ln_depth: 1e-4,
                }],
            }],
            ..PosedViews::default()
        }
    }

    #[test]
    fn the_point_cloud_has_a_row_of_17_bytes_per_anchor() {
        let bytes = ply(&one_anchor());
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.contains("comment unit arbitrary") && text.contains("vertex 1\n"));
        let body = &bytes[text.find("end_header\n").unwrap() + 11..];
        assert_eq!(body.len(), 17);
        assert_eq!(body[..4], 1.0_f32.to_le_bytes());
        assert_eq!(body[12..16], 0.003_f32.to_le_bytes());
        assert_eq!(body[16], 1);
    }

    #[test]
    fn the_table_holds_views_pixels_and_covariance() {
        let views = one_anchor();
        let json = serde_json::to_value(table(&views)).unwrap();
        let anchor = &json["anchors"][0];
        assert_eq!(anchor["observations"][0][0], 1);
        assert_eq!(anchor["observations"][0][2], 20.25);
        assert_eq!(anchor["covariance"].as_array().map(Vec::len), Some(6));
        assert_eq!(json["columns"]["observations"][3], "depth");
    }
}
