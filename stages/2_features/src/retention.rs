//! Keeps keypoints evenly over the photo: rank them within grid cells by response, and take all
//! first ranks, then all second ranks, until the budget is used.

use rilievo_scene::Keypoint;

/// Indices (ascending) of at most `budget` keypoints, spread over cells of the given size.
pub(crate) fn spread_over_grid(keypoints: &[Keypoint], cell_px: f32, budget: usize) -> Vec<usize> {
    if keypoints.len() <= budget {
        return (0..keypoints.len()).collect();
    }
    let cell = |k: &Keypoint| ((k.y / cell_px) as i32, (k.x / cell_px) as i32);
    let mut by_cell: Vec<usize> = (0..keypoints.len()).collect();
    by_cell.sort_by(|&a, &b| {
        let (ka, kb) = (&keypoints[a], &keypoints[b]);
        cell(ka)
            .cmp(&cell(kb))
            .then(kb.response.total_cmp(&ka.response))
            .then(a.cmp(&b))
    });
    let mut ranked = Vec::with_capacity(by_cell.len());
    let mut rank = 0_usize;
    for (position, &index) in by_cell.iter().enumerate() {
        let starts_cell =
            position == 0 || cell(&keypoints[by_cell[position - 1]]) != cell(&keypoints[index]);
        rank = if starts_cell { 0 } else { rank + 1 };
        ranked.push((rank, index));
    }
    ranked.sort_by(|a, b| {
        a.0.cmp(&b.0)
            .then(keypoints[b.1].response.total_cmp(&keypoints[a.1].response))
            .then(a.1.cmp(&b.1))
    });
    let mut kept: Vec<usize> = ranked
        .iter()
        .take(budget)
        .map(|&(_, index)| index)
        .collect();
    kept.sort_unstable();
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_busy_corner_does_not_take_the_whole_budget() {
        let at = |x: f32, response: f32| Keypoint {
            x,
            y: 0.0,
            size_px: 2.0,
            angle_rad: 0.0,
            response,
            bright: true,
            on_object: false,
        };
        let mut keypoints: Vec<Keypoint> = (0..100)
            .map(|k| at(k as f32 * 0.01, 1.0 + k as f32))
            .collect();
        keypoints.extend((1..10).map(|k| at(10.5 * k as f32, 0.1)));
        let kept = spread_over_grid(&keypoints, 10.0, 20);
        assert_eq!(kept.len(), 20);
        assert!((100..109).all(|k| kept.contains(&k)), "{kept:?}");
        assert!(kept.contains(&99) && !kept.contains(&0), "{kept:?}");
    }
}
