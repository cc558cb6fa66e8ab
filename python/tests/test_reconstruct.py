"""Runs by the package are those of the command line, byte for byte, interrupted or not."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import files

import rilievo


@pytest.fixture(scope="module")
def interrupted(photographed, given, tmp_path_factory):
    """A run that Ctrl-C stopped in stage 5, and went on; the events of the first call and of the second."""
    out = tmp_path_factory.mktemp("runs") / "python"
    first, second = [], []
    asked = []

    def press_in_stage_5(event):
        first.append(event)
        if event["event"] in ("progress", "iteration") and event["stage"] == "5_shading" and not asked:
            asked.append(time.monotonic())
            # From another thread, as from a terminal: Python answers in its main thread.
            threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()

    with pytest.raises(KeyboardInterrupt):
        rilievo.reconstruct(photographed / "photos", out, **given, progress=press_in_stage_5)
    waited = time.monotonic() - asked[0]
    assert waited < 30, waited
    run = rilievo.reconstruct(photographed / "photos", out, **given, progress=second.append)
    return run, first, second


def test_a_run_goes_on_after_an_interrupt(interrupted):
    _, first, second = interrupted
    assert [event["exit_code"] for event in first if event["event"] == "finished"] in ([], [130])
    reused = [event["stage"] for event in second if event.get("reused")]
    assert reused == ["1_photos", "2_features", "3_poses", "4_lighting"]
    assert second[-1]["event"] == "finished" and second[-1]["exit_code"] == 0


def test_it_has_the_bytes_of_the_command_line(interrupted, run_of_command_line):
    ours, theirs = files(Path(interrupted[0].path)), files(run_of_command_line[0])
    assert sorted(ours) == sorted(theirs)
    assert [name for name in ours if ours[name] != theirs[name]] == []
    assert any(name.endswith("asset.glb") for name in ours)


def test_events_are_those_of_json(interrupted, run_of_command_line):
    lines = [json.loads(line) for line in run_of_command_line[1].splitlines()]
    _, _, second = interrupted
    theirs, ours = lines[-1], second[-1]
    assert theirs.keys() == ours.keys()
    assert theirs["verdict"] == ours["verdict"]
    kinds = {event["event"] for event in lines}
    assert {event["event"] for event in second} <= kinds
    fusion = [[event for event in told if event.get("stage") == "6_fusion"] for told in (lines, second)]
    steps = [[event["step"] for event in told if event["event"] == "progress"] for told in fusion]
    assert set(steps[0]) == set(steps[1]) != set()


def test_nothing_is_done_twice(interrupted, photographed, given):
    told = []
    run = rilievo.reconstruct(photographed / "photos", interrupted[0].path, **given, progress=told.append)
    assert sum(bool(event.get("reused")) for event in told) == 6
    assert run.names == interrupted[0].names


def test_results_are_read_back(interrupted, photographed):
    run = rilievo.Run(interrupted[0].path)
    assert run.names == [f"IMG_{i:04}" for i in range(1, 5)] == list(run.cameras)
    assert run.unit == "metre"
    camera = run.cameras["IMG_0002"]
    assert camera.size == (320, 240) and camera.image == "IMG_0002.jpg" and camera.distortion is None
    assert camera.K.shape == (3, 3) and camera.cam_from_world.shape == (3, 4)
    known = json.loads((Path(run.path) / "3_poses/cameras.json").read_text())["cameras"][1]
    assert np.allclose(camera.center, known["camera_center"]) and np.allclose(camera.K, known["K"])

    depth, normal = run.depth("IMG_0002"), run.normal("IMG_0002")
    assert depth.shape == (240, 320) and normal.shape == (240, 320, 3)
    inside = depth > 0
    assert inside.mean() > 0.02
    assert np.allclose(np.linalg.norm(normal[inside], axis=-1), 1, atol=1e-3)
    assert (normal[inside][:, 2] < 0).mean() > 0.95
    assert run.albedo("IMG_0002").shape == (240, 320, 3)
    assert run.rendered("IMG_0002").shape == (240, 320, 3)
    assert run.confidence("IMG_0002").shape == (240, 320)

    points, normals, colors = cloud = run.cloud()
    assert len(cloud) == len(points) > 1000
    assert points.shape == normals.shape == colors.shape and colors.dtype == np.uint8
    assert np.allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-3)
    assert run.report["verdict"]["level"] in ("good", "usable", "untrusted")

    for read in (run.depth, run.normal, run.albedo):
        with pytest.raises(rilievo.InputError, match="IMG_0001"):
            read("../../truth/IMG_0001")


def test_accuracy_is_that_of_the_command_line(interrupted, run_of_command_line, photographed, command_line):
    ours = rilievo.evaluate(interrupted[0], photographed / "truth")
    theirs = json.loads(command_line("evaluate", run_of_command_line[0], "--truth", photographed / "truth", "--json"))
    assert ours == theirs
    assert ours["all"]["normal_mae_deg"] < 15 and ours["views"].keys() == set(interrupted[0].names)
    with pytest.raises(rilievo.InputError):
        rilievo.evaluate(interrupted[0], photographed / "no truth")
    with pytest.raises(rilievo.UsageError):
        rilievo.evaluate(interrupted[0], photographed / "truth", align="well")


def test_a_callback_that_raises_stops_the_run_which_is_free_then(photographed, given, tmp_path):
    class Enough(Exception):
        pass

    in_use = []

    def stop_in_stage_2(event):
        if event.get("stage") == "2_features":
            with pytest.raises(rilievo.RunDirError) as caught:
                rilievo.reconstruct(photographed / "photos", tmp_path / "run", **given)
            in_use.append(str(caught.value))
            raise Enough

    with pytest.raises(Enough):
        rilievo.reconstruct(photographed / "photos", tmp_path / "run", **given, progress=stop_in_stage_2)
    assert len(in_use) == 1
    photos = sorted((photographed / "photos").iterdir())
    run = rilievo.reconstruct(photos, tmp_path / "run", **given, until="photos", threads=1, memory="1G")
    with pytest.raises(rilievo.RunDirError):
        run.names
    with pytest.raises(rilievo.RunDirError):
        run.cloud()


def test_synthetic_sets_and_camera_raw_are_those_of_the_command_line(command_line, tmp_path):
    rilievo.synth(tmp_path / "ours", views=2, size="160x120", seed=3, format="dng")
    command_line("synth", tmp_path / "theirs", "--views=2", "--size=160x120", "--seed=3", "--format=dng")
    ours, theirs = files(tmp_path / "ours"), files(tmp_path / "theirs")
    assert ours == theirs and any(name.endswith(".dng") for name in ours)

    photos, told = tmp_path / "ours/photos", []
    rilievo.reconstruct(photos, tmp_path / "run", masks="none", until="1", progress=told.append)
    options = ["--masks=none", "--until=1", "-o", tmp_path / "other"]
    command_line("reconstruct", photos, *options)
    assert files(tmp_path / "run/1_photos") == files(tmp_path / "other/1_photos") != {}

    # One that cannot be decoded is left out by name.
    (photos / "broken.dng").write_bytes(next(photos.glob("*.dng")).read_bytes()[:5000])
    rilievo.reconstruct(photos, tmp_path / "run", masks="none", until="1", progress=told.append)
    assert any("broken.dng" in event["message"] for event in told if event["event"] == "warning"), told
