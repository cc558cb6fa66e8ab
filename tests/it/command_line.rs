//! What is made from the definition of the command line, and where it is installed.

use crate::common;

use common::{arg, done, run};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

const SHELLS: [&str; 5] = ["bash", "elvish", "fish", "powershell", "zsh"];

/// Commands that `--help` lists, without `help` itself.
fn visible_commands() -> Vec<String> {
    let help = done(&["--help"]);
    let commands: Vec<String> = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| !line.is_empty())
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect();
    for known in ["demo", "reconstruct", "export", "completions", "man"] {
        assert!(commands.iter().any(|name| name == known), "{commands:?}");
    }
    commands
}

/// Whether a program can be started here; says so where it cannot.
fn is_there(program: &str, why: &str) -> bool {
    let found = Command::new(program).arg("--version").output().is_ok();
    if !found {
        println!("{program} is not there: {why} is not tried");
    }
    found
}

/// Runs another program, which must succeed.
#[track_caller]
fn succeeds(command: &mut Command) -> String {
    let output = command.output().expect("the program starts");
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && stderr.is_empty(), "{stderr}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn every_shell_completes_every_visible_command() {
    let commands = visible_commands();
    for shell in SHELLS {
        let script = done(&["completions", shell]);
        let words: BTreeSet<&str> = script
            .split(|c: char| !c.is_alphanumeric() && c != '-')
            .collect();
        for command in &commands {
            assert!(words.contains(command.as_str()), "{shell}: {command}");
        }
        assert!(
            !script.contains("decode-raw"),
            "{shell} tells what is hidden"
        );
        assert!(script.contains("sphere-radius"), "{shell}: options");
    }
    let (code, _, stderr) = run(&["completions", "cmd"]);
    assert_eq!(code, 2);
    assert!(
        SHELLS.iter().all(|shell| stderr.contains(shell)),
        "{stderr}"
    );
}

#[test]
fn shells_can_parse_their_scripts() {
    let folder = tempfile::tempdir().unwrap();
    for (shell, flags) in [
        ("bash", ["-n"].as_slice()),
        ("zsh", &["-n"]),
        ("fish", &["--no-execute"]),
    ] {
        if is_there(shell, "its script") {
            let script = folder.path().join(shell);
            std::fs::write(&script, done(&["completions", shell])).unwrap();
            succeeds(Command::new(shell).args(flags).arg(&script));
        }
    }
}

#[test]
fn bash_completes_commands_options_and_values() {
    if !is_there("bash", "completing in it") {
        return;
    }
    let script = done(&["completions", "bash"]);
    let completed = |words: &[&str]| {
        let asked = format!(
            "{script}\nCOMP_WORDS=({})\nCOMP_CWORD={}\n_rilievo rilievo '{}' '{}'\necho \"${{COMPREPLY[*]}}\"",
            words.join(" "),
            words.len() - 1,
            words[words.len() - 1],
            words[words.len() - 2],
        );
        let replies = succeeds(Command::new("bash").args(["--norc", "-c", &asked]));
        replies.trim().to_owned()
    };
    assert_eq!(completed(&["rilievo", "reco"]), "reconstruct");
    assert_eq!(completed(&["rilievo", "dec"]), "");
    assert_eq!(completed(&["rilievo", "fuse", "--water"]), "--watertight");
    assert_eq!(
        completed(&["rilievo", "reconstruct", "--model", "pa"]),
        "paper"
    );
}

/// Refuses what is no man page of a command.
#[track_caller]
fn assert_page(path: &Path) {
    let page = std::fs::read_to_string(path).expect("a page");
    let name = path.file_stem().expect("a name").to_string_lossy();
    // Preset strings of the generator come before the title.
    let first = page.lines().find(|line| !line.contains(".ds Aq"));
    let title = format!(
        ".TH {name} 1 \"\" \"rilievo {}\"",
        env!("CARGO_PKG_VERSION")
    );
    assert_eq!(first.unwrap_or_default().trim_end(), title);
    for section in [".SH NAME", ".SH SYNOPSIS", ".SH DESCRIPTION", ".SH OPTIONS"] {
        assert!(
            page.lines().any(|line| line == section),
            "{name}: {section}"
        );
    }
    if is_there("man", "reading pages") {
        let mut man = Command::new("man");
        man.args(["--warnings", "-E", "UTF-8", "-l"]).arg(path);
        let read = succeeds(man.env("MANWIDTH", "100").env("MANPAGER", "cat"));
        assert!(read.contains("SYNOPSIS"), "{name}: {read}");
    }
}

#[test]
fn every_visible_command_has_a_man_page() {
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man1");
    let told = done(&["man", "-o", arg(&pages)]);
    let mut expected: BTreeSet<String> = visible_commands()
        .iter()
        .map(|command| format!("rilievo-{command}.1"))
        .collect();
    expected.insert("rilievo.1".to_owned());
    let number = format!("{} man pages", expected.len());
    assert!(told.starts_with(&number), "{told}");
    let there: BTreeSet<String> = std::fs::read_dir(&pages)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    assert_eq!(there, expected);
    for name in &there {
        assert_page(&pages.join(name));
    }

    // The main page alone, as it is in the folder.
    let main = pages.join("rilievo.1");
    let page = std::fs::read_to_string(&main).unwrap();
    assert_eq!(done(&["man"]), page);
    for name in there.iter().filter(|name| *name != "rilievo.1") {
        let command = name.trim_end_matches(".1").replace('-', "\\-");
        assert!(page.contains(&format!("{command}(1)")), "{name}");
    }

    // A page of other text is kept unless it may go; all others were there already.
    std::fs::write(&main, "mine").unwrap();
    let (code, _, stderr) = run(&["man", "-o", arg(&pages)]);
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("--overwrite"), "{stderr}");
    done(&["man", "-o", arg(&pages), "--overwrite"]);
    assert_eq!(std::fs::read_to_string(&main).unwrap(), page);
}

#[test]
fn the_version_is_one_line_and_tells_the_features() {
    let start = format!("rilievo {}", env!("CARGO_PKG_VERSION"));
    let (short, long) = (done(&["-V"]), done(&["--version"]));
    for line in [&short, &long] {
        assert!(line.starts_with(&start), "{line}");
        assert_eq!(line.trim_end_matches('\n').lines().count(), 1, "{line}");
    }
    let features: Vec<&str> = [
        ("mpi", cfg!(feature = "mpi")),
        ("raw", cfg!(feature = "raw")),
    ]
    .iter()
    .filter_map(|(name, is_there)| is_there.then_some(*name))
    .collect();
    let features = if features.is_empty() {
        "no optional features".to_owned()
    } else {
        format!("features: {}", features.join(", "))
    };
    assert!(long.ends_with(&format!("{features})\n")), "{long}");
    assert!(!short.contains("features"), "{short}");
}

#[test]
fn the_install_script_puts_everything_in_its_place() {
    for tool in ["sh", "install", "mktemp"] {
        // Dash, as `sh`, knows no --version: what counts is that it starts.
        if !is_there(tool, "installing") {
            return;
        }
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join(".ci/install");
    let folder = tempfile::tempdir().unwrap();
    let install = |prefix: Option<&str>, program: &str| {
        let mut command = Command::new("sh");
        command.arg(&script).arg(program);
        command.env("DESTDIR", folder.path()).env_remove("PREFIX");
        if let Some(prefix) = prefix {
            command.env("PREFIX", prefix);
        }
        command
    };
    let program = env!("CARGO_BIN_EXE_rilievo");
    for (prefix, place) in [
        (None, "usr/local"),
        (Some("/opt/rilievo 1"), "opt/rilievo 1"),
    ] {
        let told = succeeds(&mut install(prefix, program));
        let place = folder.path().join(place);
        let mut expected = vec![
            "bin/rilievo".to_owned(),
            "share/bash-completion/completions/rilievo".to_owned(),
            "share/zsh/site-functions/_rilievo".to_owned(),
            "share/fish/vendor_completions.d/rilievo.fish".to_owned(),
            "share/elvish/lib/rilievo.elv".to_owned(),
            "share/man/man1/rilievo.1".to_owned(),
        ];
        for command in visible_commands() {
            expected.push(format!("share/man/man1/rilievo-{command}.1"));
        }
        assert_eq!(told.lines().count(), expected.len(), "{told}");
        for file in &expected {
            let path = place.join(file);
            assert!(path.metadata().is_ok_and(|m| m.len() > 0), "{file}");
            assert!(told.lines().any(|line| line == arg(&path)), "{told}");
        }
        let installed = succeeds(Command::new(place.join("bin/rilievo")).arg("--version"));
        assert_eq!(installed, done(&["--version"]));
        let bash = std::fs::read_to_string(place.join(&expected[1])).unwrap();
        assert_eq!(bash, done(&["completions", "bash"]));
    }

    for (prefix, program, why) in [
        (Some("relative"), program, "absolute"),
        (None, "/no/such/program", "cargo build --release"),
    ] {
        let output = install(prefix, program).output().unwrap();
        assert!(!output.status.success());
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(stderr.contains(why), "{stderr}");
    }
}
