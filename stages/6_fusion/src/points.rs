//! The cloud: every piece of surface once, from the view that resolves it best ([`Judge`]).
//!
//! The work goes page by page of each view, against the views that may see the page's surface;
//! points are handed on in the order of views, pages and pixels.

use crate::color::Palette;
use crate::error::FusionError;
use crate::judge::{Judge, PageShare};
use crate::layering::tolerance_px;
use crate::memory;
use crate::options::FusionOptions;
use crate::report::{Layering, ViewFusion};
use crate::sight::min_normal_cosine;
use crate::thin::Thinner;
use crate::views::LoadedViews;
use rilievo_scene::team::divided;
use rilievo_scene::{CloudPoint, CloudSink, Observer, PageCaches, Scratch, StageId};

/// Pages whose points are gathered between two words to the observer: few enough that their points
/// are small against all memory.
const PAGES_AT_ONCE: usize = 256;

/// The cloud in numbers.
#[derive(Clone, Debug, Default)]
pub(crate) struct CloudFacts {
    pub num_points: usize,
    /// Views that agree on each point, summed over all.
    pub num_views: usize,
    /// Points that another view covers, and those of them that lie apart.
    pub num_covered: usize,
    pub num_apart: usize,
    /// Bounding box, world frame.
    pub low: [f32; 3],
    pub high: [f32; 3],
}

/// Hands on points and counts them.
struct Counted<'a> {
    sink: &'a mut dyn CloudSink,
    facts: CloudFacts,
}

impl Counted<'_> {
    fn add(&mut self, points: &[CloudPoint]) -> Result<(), FusionError> {
        self.sink.add(points)?;
        let facts = &mut self.facts;
        facts.num_points += points.len();
        for point in points {
            facts.num_views += usize::from(point.num_views);
            for (k, &c) in point.position.iter().enumerate() {
                facts.low[k] = facts.low[k].min(c);
                facts.high[k] = facts.high[k].max(c);
            }
        }
        Ok(())
    }
}

/// Gathers the points of all views, in the order of views, pages and pixels.
pub(crate) fn gather(
    loaded: &LoadedViews,
    layering: &Layering,
    options: &FusionOptions,
    reports: &mut [ViewFusion],
    (scratch, sink): (&dyn Scratch, &mut dyn CloudSink),
    observer: &dyn Observer,
) -> Result<CloudFacts, FusionError> {
    let views = &loaded.views;
    let judge = Judge {
        palette: Palette::new(),
        tolerance_px: tolerance_px(layering.median, layering.footprint),
        // A single view has nobody to agree with.
        min_num_views: options.min_num_views.min(views.len()),
        min_normal_cosine: min_normal_cosine(),
    };
    let mut counted = Counted {
        sink,
        facts: CloudFacts {
            low: [f32::INFINITY; 3],
            high: [f32::NEG_INFINITY; 3],
            ..CloudFacts::default()
        },
    };
    let mut thinner = (options.spacing > 0.0)
        .then(|| Thinner::new(scratch, options))
        .transpose()?;
    let caches = PageCaches::new(&loaded.store, memory::num_pages(options));
    let (team, mut num_candidates) = (observer.team(), 0);
    for (view, report) in views.iter().zip(reports) {
        for pages in view.pages.kept().chunks(PAGES_AT_ONCE) {
            let flow =
                observer.progress(StageId::Fusion, "gathering points", (view.idx, views.len()));
            flow.ok_or(FusionError::Interrupted)?;
            let shares: Vec<PageShare> = divided(team, pages.len(), usize::MAX, |k| {
                Ok::<_, FusionError>(
                    caches.with(|pixels| judge.page(pixels, views, view, pages[k]))?,
                )
            })?;
            for share in shares {
                num_candidates += share.num_tried;
                report.num_inconsistent += share.num_inconsistent;
                report.num_points += share.points.len();
                counted.facts.num_covered += share.num_covered;
                counted.facts.num_apart += share.num_apart;
                match &mut thinner {
                    Some(thinner) => thinner.add(&share.points)?,
                    None => counted.add(&share.points)?,
                }
            }
        }
    }
    drop(caches);
    if let Some(thinner) = thinner {
        thinner.finish(&mut |points| counted.add(points))?;
    }
    if counted.facts.num_points == 0 {
        return Err(FusionError::NothingAgrees {
            num_candidates,
            min_num_views: judge.min_num_views,
            tolerance_px: judge.tolerance_px,
        });
    }
    Ok(counted.facts)
}
