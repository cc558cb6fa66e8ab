//! Which photo to register next.
//!
//! A photo's score is the number of occupied cells of grids of 2, 4, … 32 cells a side over the known
//! points that it sees, a cell of the finer grid counting more: many and well spread points give a sure
//! pose (Schönberger and Frahm, CVPR 2016, section 4.2). Scores are kept until a point of the photo comes
//! or goes, which concerns the neighbours of the photo just registered only.

use crate::matched::MatchedPhotos;
use crate::model::Model;

/// Points that a photo must see to be registered, and a pair to begin: few agree by chance.
pub(crate) const MIN_NUM_VISIBLE_POINTS: usize = 15;

/// What was last known of a photo.
#[derive(Clone, Copy)]
struct Rank {
    score: usize,
    num_visible: usize,
}

/// Scores of the photos without a pose.
pub(crate) struct Ranking {
    /// `None` where points came or went since.
    ranks: Vec<Option<Rank>>,
}

impl Ranking {
    /// Nothing is known of any photo yet.
    pub fn new(num_photos: usize) -> Self {
        Self {
            ranks: vec![None; num_photos],
        }
    }

    /// Forgets the scores of the photos that see points that came or went.
    pub fn renew(&mut self, matched: &MatchedPhotos<'_>, changed_tracks: &[usize]) {
        for &track in changed_tracks {
            for sighting in &matched.tracks[track] {
                self.ranks[sighting.photo] = None;
            }
        }
    }

    /// Photos to try next, best first; those that failed only where they see a tenth more points now.
    pub fn next_views(
        &mut self,
        matched: &MatchedPhotos<'_>,
        model: &Model,
        available: &[bool],
        failed: &[(usize, usize, usize)],
    ) -> Vec<usize> {
        let mut scored: Vec<(usize, usize)> = Vec::new();
        for (photo, &is_available) in available.iter().enumerate() {
            if !is_available || model.poses[photo].is_some() {
                continue;
            }
            let rank = self.ranks[photo].get_or_insert_with(|| rank(matched, model, photo));
            let num = rank.num_visible;
            let tried = failed
                .iter()
                .any(|&(p, seen, _)| p == photo && num <= seen + seen / 10);
            if num >= MIN_NUM_VISIBLE_POINTS && !tried {
                scored.push((rank.score, photo));
            }
        }
        scored.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
        scored.into_iter().map(|(_, photo)| photo).collect()
    }
}

fn rank(matched: &MatchedPhotos<'_>, model: &Model, photo: usize) -> Rank {
    let (pixels, _) = model.visible_points(matched, photo);
    let camera = &matched.photos.photos[photo].intrinsics;
    let mut score = 0;
    for level in 1..=5 {
        let cells = 1_usize << level;
        let mut occupied = vec![false; cells * cells];
        for p in &pixels {
            let cell = |v: f64, size: usize| {
                ((v / size as f64 * cells as f64).max(0.0) as usize).min(cells - 1)
            };
            occupied[cell(p.y, camera.height) * cells + cell(p.x, camera.width)] = true;
        }
        score += cells * occupied.iter().filter(|&&o| o).count();
    }
    Rank {
        score,
        num_visible: pixels.len(),
    }
}
