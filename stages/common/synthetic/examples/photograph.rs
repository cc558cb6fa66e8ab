//! Photographs the demo's scene into PPM files: `photograph OUT [SEED] [VIEWS] [WIDTH] [HEIGHT]`.

use rilievo_synthetic::{RenderOptions, Renderer, Scene, SceneOptions, Subject, to_srgb8};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = std::path::PathBuf::from(arguments.next().ok_or("name an output folder")?);
    let mut number = |default: u64| -> u64 {
        arguments
            .next()
            .and_then(|a| a.parse().ok())
            .unwrap_or(default)
    };
    let seed = number(1);
    let options = RenderOptions {
        num_views: number(6) as usize,
        width: number(640) as usize,
        height: number(480) as usize,
        ..RenderOptions::default()
    };
    let subject = match number(0) {
        1 => Subject::Stone,
        2 => Subject::Ellipsoid,
        _ => Subject::Bust,
    };
    let start = Instant::now();
    let scene = Scene::new(SceneOptions {
        seed,
        subject,
        ..SceneOptions::default()
    })?;
    let renderer = Renderer::new(&scene, &options)?;
    println!(
        "{} vertices, lit after {:.2} s",
        scene.mesh.vertices.len(),
        start.elapsed().as_secs_f64()
    );
    std::fs::create_dir_all(&out)?;
    for idx in 0..renderer.num_views() {
        let view = renderer.render(idx)?;
        let header = format!("P6\n{} {}\n255\n", options.width, options.height);
        let bytes = [header.as_bytes(), &to_srgb8(&view.image)].concat();
        std::fs::write(out.join(format!("{}.ppm", view.name)), bytes)?;
        println!(
            "{}: object {:.1} %, {:.2} s",
            view.name,
            100.0 * view.object_mask.coverage(),
            start.elapsed().as_secs_f64()
        );
    }
    Ok(())
}
