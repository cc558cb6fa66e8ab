//! Tests of [`crate::stored`].

use crate::level::{LevelView, ViewGrid, flat_view};
use crate::stored::{StoredSurface, StoredView};
use crate::window::Window;
use rilievo_scene::{Mask, MemoryScratch, Raster, ScratchError};

fn speckled() -> LevelView {
    let mut view = flat_view(61, 43, 100.0);
    for (k, value) in view.image.data.iter_mut().enumerate() {
        *value = 0.2 + 0.1 * (k as f32 * 0.7).sin();
    }
    let mask = Mask::from_fn(61, 43, |x, y| (x + 2 * y) % 17 != 0 && x > 3);
    let usable = Raster::from_fn(61, 43, |x, _| f32::from(u8::from(x < 50)));
    let grid = ViewGrid::new(view.camera.clone(), mask, true);
    LevelView {
        grid,
        usable,
        grey: view.image.to_grey(),
        ..view
    }
}

#[test]
fn a_view_comes_back_at_every_level_and_by_windows() -> Result<(), ScratchError> {
    let view = speckled();
    let stored = StoredView::put(view.clone(), 50, &MemoryScratch)?;
    assert!(stored.num_levels() > 1, "{}", stored.num_levels());
    let mut expected = view;
    for at in 0..stored.num_levels() {
        let found = stored.view(at)?;
        assert_eq!(found.image, expected.image);
        assert_eq!(found.usable, expected.usable);
        assert_eq!(found.mask, expected.mask);
        assert_eq!(stored.grid(at)?.pixels.xs, expected.pixels.xs);
        assert_eq!(stored.num_masked(at), expected.pixels.len());
        assert!(found.cut_by_frame);
        expected = expected.halved();
    }
    let whole = stored.view(0)?;
    let window = Window {
        x0: 7,
        y0: 5,
        width: 31,
        height: 20,
    };
    let part = stored.cut(0, &window)?;
    assert_eq!(part.mask, window.cut(&whole.mask));
    assert_eq!(part.image.pixel(3, 4), whole.image.pixel(10, 9));
    assert_eq!(part.dark, whole.dark);
    Ok(())
}

#[test]
fn images_are_divided_by_the_gain() -> Result<(), ScratchError> {
    let mut view = speckled();
    let mut stored = StoredView::put(view.clone(), 50, &MemoryScratch)?;
    stored.gain = [0.5, 1.0, 2.0];
    view.divide_by_gain(stored.gain);
    let found = stored.view(0)?;
    assert_eq!(found.image, view.image);
    assert!((found.dark / view.dark - 1.0).abs() < 1e-5);
    Ok(())
}

#[test]
fn depths_come_back_whole_by_windows_and_from_a_file() -> Result<(), ScratchError> {
    let views = [StoredView::put(speckled(), 50, &MemoryScratch)?];
    let surface = StoredSurface::new(&views, 0, &MemoryScratch)?;
    let pixels = views[0].grid(0)?.pixels;
    let depth: Vec<f64> = (0..pixels.len()).map(|p| 0.1 + p as f64).collect();
    let known: Vec<bool> = (0..pixels.len()).map(|p| p % 3 != 0).collect();
    surface.put(0, &pixels, &depth, Some(&known))?;
    assert_eq!(surface.get(0, &pixels)?, depth);
    assert_eq!(surface.known(0, &pixels)?, known);
    let window = Window {
        x0: 7,
        y0: 5,
        width: 31,
        height: 20,
    };
    let part = views[0].cut(0, &window)?;
    for (p, value) in surface.cut(0, &window, &part.pixels)?.iter().enumerate() {
        let (x, y) = (
            part.pixels.xs[p] as usize + 7,
            part.pixels.ys[p] as usize + 5,
        );
        assert_eq!(*value, depth[pixels.number[y * 61 + x] as usize]);
    }
    let mut file = Vec::new();
    let copy = StoredSurface::new(&views, 0, &MemoryScratch)?;
    assert!(surface.save(0, &mut file).is_ok());
    assert!(copy.restore(0, &mut &file[..file.len() - 1]).is_err());
    assert!(copy.restore(0, &mut &file[..]).is_ok());
    assert_eq!(copy.get(0, &pixels)?, depth);
    assert_eq!(copy.known(0, &pixels)?, known);
    Ok(())
}
