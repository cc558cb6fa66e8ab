//! A page opened in headless Chromium, and what it looks like from inside.

use std::path::{Path, PathBuf};
use std::process::Command;

/// What the browser tells.
pub struct Seen {
    /// Errors on the console.
    pub errors: Vec<String>,
    /// Pictures (`images`, `failed`, `withoutAlt`), tones in the viewer (`colors`), and whether the
    /// page is wider than the window (`wide`).
    pub facts: serde_json::Value,
}

const PROBE: &str = include_str!("probe.html");

fn chromium() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path)
        .flat_map(|folder| {
            ["chromium", "chromium-browser", "google-chrome"].map(|name| folder.join(name))
        })
        .find(|program| program.is_file())
}

/// Opens a page; `None` where there is no browser.
pub fn open(page: &Path) -> Option<Seen> {
    let program = chromium()?;
    let dir = tempfile::tempdir().expect("a folder can be made");
    let copy = dir.path().join("page.html");
    let html = std::fs::read_to_string(page).expect("the page can be read");
    std::fs::write(&copy, html + PROBE).expect("a file can be written");
    let output = Command::new(program)
        .args(["--headless=new", "--no-sandbox", "--disable-dev-shm-usage"])
        // A software renderer, so that WebGL works without a graphics card.
        .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
        .args(["--enable-logging=stderr", "--window-size=1280,900"])
        .args(["--virtual-time-budget=60000", "--dump-dom"])
        .arg(format!(
            "--user-data-dir={}",
            dir.path().join("user").display()
        ))
        .arg(format!("file://{}", copy.display()))
        .output()
        .expect("the browser starts");
    let dom = String::from_utf8_lossy(&output.stdout);
    let facts = dom
        .split_once("data-probe=\"")
        .and_then(|(_, rest)| rest.split_once('"'))
        .map(|(facts, _)| facts.replace("&quot;", "\""))
        .expect("the probe answered");
    let stderr = String::from_utf8_lossy(&output.stderr);
    let errors = stderr
        .lines()
        .filter(|line| line.contains("CONSOLE") && line.to_lowercase().contains("error"))
        .map(str::to_owned)
        .collect();
    Some(Seen {
        errors,
        facts: serde_json::from_str(&facts).expect("the probe answers in JSON"),
    })
}
