"""Shape from shading on arrays: against known normals, and against the command line."""

from __future__ import annotations

import json
import threading
import time

import numpy as np
import pytest
from scenes import LIGHTING, angles_deg, bump, write_scene

import rilievo


@pytest.fixture(scope="module")
def scene():
    return bump()


def flat(scene):
    """A depth map without the bump, with a broad hint of it."""
    return 1.0 - 0.7 * (1.0 - scene.depth)


def test_known_normals_come_back(scene):
    depth, normals, rendered, report = rilievo.shade(
        scene.image, scene.mask, scene.K, LIGHTING, initial=flat(scene)
    )
    before = angles_deg(normals_of(flat(scene), scene.K), scene.normals, scene.mask).mean()
    after = angles_deg(normals, scene.normals, scene.mask).mean()
    assert before > 1.5 and after < 0.3 * before, (before, after)
    assert depth.shape == scene.mask.shape and depth.dtype == np.float32
    assert normals.shape == (*scene.mask.shape, 3) and normals.dtype == np.float32
    assert rendered.shape == scene.image.shape and rendered.dtype == np.float32
    assert (depth[~scene.mask] == 0).all() and (normals[~scene.mask] == 0).all()
    assert (normals[scene.mask][:, 2] < 0).all()
    assert np.abs(rendered - scene.image)[scene.mask].mean() < 2e-3
    assert report["report"]["views"][0]["num_pixels"] == scene.mask.sum()


def normals_of(depth, K):
    """Normals of a depth map by differences."""
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]]
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(depth)], axis=-1)
    points = depth[..., None] * rays
    n = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def test_a_prior_is_refined_and_light_fitted_on_it(scene):
    found = rilievo.shade(scene.image, scene.mask, scene.K, prior=scene.depth, initial="plane")
    assert angles_deg(found.normals, scene.normals, scene.mask).mean() < 1.0
    assert "fitted" in found.report["lighting"][0]["lighting"]
    assert found.confidence.shape == scene.mask.shape


def test_a_grey_image_takes_nine_numbers(scene):
    grey = np.ascontiguousarray(scene.image[..., 0])
    found = rilievo.shade(grey.astype(np.float32), None, scene.K.tolist(), LIGHTING[0], initial=scene.depth)
    assert found.rendered.shape == grey.shape
    assert angles_deg(found.normals, scene.normals, scene.mask).mean() < 0.5


def test_integers_are_taken_as_a_cameras_files(scene):
    linear = np.round(65535 * scene.image).astype(np.uint16)
    curve = np.where(
        scene.image <= 0.0031308, 12.92 * scene.image, 1.055 * np.power(scene.image, 1 / 2.4) - 0.055
    )
    stored = np.round(255 * curve).astype(np.uint8)
    for image in (linear, stored):
        found = rilievo.shade(image, scene.mask.astype(np.uint8), scene.K, LIGHTING, initial=scene.depth)
        assert angles_deg(found.normals, scene.normals, scene.mask).mean() < 0.5, image.dtype


def test_several_views_are_lists(scene):
    told = []
    pose = np.eye(4)
    found = rilievo.shade(
        [scene.image, scene.image],
        [scene.mask, None],
        [(scene.K, pose), rilievo.Camera(scene.K, pose[:3])],
        LIGHTING,
        initial=[scene.depth, flat(scene)],
        names=["left", "right"],
        progress=told.append,
    )
    assert [len(found.depth), len(found.normals), len(found.rendered), len(found.confidence)] == [2] * 4
    assert [view["name"] for view in found.report["report"]["views"]] == ["left", "right"]
    warnings = [event["message"] for event in told if event["event"] == "warning"]
    assert any("no matches" in warning for warning in warnings), told
    alone = rilievo.shade(scene.image, scene.mask, scene.K, LIGHTING, initial=scene.depth)
    assert (alone.depth == found.depth[0]).all()


def test_threads_do_not_change_the_result(scene):
    results = [
        rilievo.shade(scene.image, scene.mask, scene.K, LIGHTING, initial=flat(scene), threads=n) for n in (1, 3)
    ]
    assert (results[0].depth == results[1].depth).all()
    assert (results[0].normals == results[1].normals).all()


def test_the_command_line_finds_the_same(scene, command_line, tmp_path):
    arguments = write_scene(tmp_path, scene, flat(scene))
    command_line("shade", *arguments, "--order=2", "--area-weight=0.01", "-o", tmp_path / "out")
    theirs = json.loads((tmp_path / "out/report.json").read_text())
    ours = rilievo.shade(
        scene.image,
        scene.mask,
        scene.K,
        LIGHTING,
        initial=flat(scene),
        names=["image"],
        order=2,
        area_weight=0.01,
    ).report
    for report in (ours, theirs):
        for view in report["report"]["views"]:
            del view["seconds"]
    assert ours["options"] == theirs["options"]
    assert ours["report"] == theirs["report"]


def test_other_threads_of_python_go_on_meanwhile(scene):
    large = bump(480, 360, 600.0)
    turns, done = 0, threading.Event()

    def count():
        nonlocal turns
        while not done.is_set():
            turns += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    began = time.monotonic()
    rilievo.shade(large.image, large.mask, large.K, LIGHTING, initial=flat(large))
    seconds = time.monotonic() - began
    done.set()
    thread.join()
    assert turns > 20 * seconds, (turns, seconds)


def test_arrays_may_change_while_views_are_shaped(scene):
    image = scene.image.copy()

    def spoil(event):
        image[:] = np.nan

    found = rilievo.shade(image, scene.mask, scene.K, LIGHTING, initial=scene.depth, progress=spoil)
    undisturbed = rilievo.shade(scene.image, scene.mask, scene.K, LIGHTING, initial=scene.depth)
    assert (found.depth == undisturbed.depth).all()


def test_a_callback_that_raises_stops_the_work(scene):
    class Enough(Exception):
        pass

    def refuse(event):
        raise Enough

    with pytest.raises(Enough):
        rilievo.shade(scene.image, scene.mask, scene.K, LIGHTING, initial=flat(scene), progress=refuse)
