"""What several tests share: the command line, a small photographed object, and its runs by both."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

import rilievo

PROGRAM = Path(os.environ.get("RILIEVO") or Path(__file__).parents[2] / "target/release/rilievo").absolute()


@pytest.fixture(scope="session")
def command_line():
    """Runs the program; gives what it prints on stdout."""
    if not PROGRAM.exists():
        pytest.skip(f"{PROGRAM} is not built; RILIEVO=PROGRAM names another one")

    def run(*arguments: object) -> str:
        done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture(scope="session")
def photographed(tmp_path_factory) -> Path:
    """A folder of four photos with masks, sphere and truth."""
    folder = tmp_path_factory.mktemp("synth") / "object"
    rilievo.synth(folder, views=4, size=(320, 240), seed=1)
    return folder


@pytest.fixture(scope="session")
def given(photographed) -> dict[str, object]:
    """Arguments of `rilievo.reconstruct` for it."""
    return dict(
        masks=photographed / "masks",
        sphere=photographed / "sphere.json",
        cameras=photographed / "intrinsics.json",
    )


@pytest.fixture(scope="session")
def run_of_command_line(command_line, photographed, given, tmp_path_factory) -> tuple[Path, str]:
    """The run directory that the command line makes, and the lines of its --json."""
    out = tmp_path_factory.mktemp("runs") / "command_line"
    options = [f"--{name}={value}" for name, value in given.items()]
    lines = command_line("reconstruct", photographed / "photos", "-o", out, "--json", *options)
    return out, lines


def files(root: Path) -> dict[str, bytes]:
    """Contents of a run directory, without those that hold times and places."""
    def told_apart(path: Path) -> bool:
        return path.name == "manifest.json" or path.name.startswith("report.") or path.name.endswith("run.json")

    found = {}
    for path in sorted(root.rglob("*")):
        if path.is_file() and not told_apart(path) and path.name != ".lock":
            found[str(path.relative_to(root))] = path.read_bytes()
    return found
