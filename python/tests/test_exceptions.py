"""Exceptions tell what the exit codes tell."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import bump

import rilievo


def raises(kind, code, call, *told):
    with pytest.raises(kind) as caught:
        call()
    assert isinstance(caught.value, rilievo.Error)
    assert caught.value.exit_code == code
    for part in told:
        assert part in str(caught.value), caught.value
    return caught.value


def test_wrong_usage_is_2(tmp_path):
    def reconstruct(**options):
        return lambda: rilievo.reconstruct(tmp_path, tmp_path / "run", **options)

    raises(rilievo.UsageError, 2, reconstruct(nonsense=1), "--nonsense")
    raises(rilievo.UsageError, 2, reconstruct(threads=0), "--threads")
    raises(rilievo.UsageError, 2, reconstruct(memory="much"), "--memory")
    raises(rilievo.UsageError, 2, reconstruct(until="7"), "--until")
    raises(rilievo.UsageError, 2, reconstruct(output="elsewhere"), "output")
    raises(rilievo.UsageError, 2, lambda: rilievo.reconstruct([], tmp_path / "run"), "photos")
    raises(rilievo.UsageError, 2, lambda: rilievo.synth(tmp_path / "set", size="wide"), "--size")
    raises(rilievo.UsageError, 2, lambda: rilievo.synth(tmp_path / "set", views=0), "num_views")


def test_input_that_cannot_be_used_is_3(tmp_path):
    error = raises(
        rilievo.InputError, 3, lambda: rilievo.reconstruct(tmp_path / "none", tmp_path / "run"), "none"
    )
    assert isinstance(error, ValueError)
    (path, reason), *_ = error.problems
    assert path.endswith("none") and reason


def test_data_that_allow_no_result_are_4():
    scene, ambient = bump(40, 30, 60.0), np.zeros((3, 9))
    ambient[:, 3] = 1
    call = lambda: rilievo.shade(scene.image, None, scene.K, ambient, initial=scene.depth)  # noqa: E731
    raises(rilievo.DataError, 4, call)


def test_a_folder_of_something_else_is_5(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    raises(rilievo.RunDirError, 5, lambda: rilievo.synth(tmp_path), "not empty")
    raises(rilievo.RunDirError, 5, lambda: rilievo.Run(tmp_path))
    raises(rilievo.RunDirError, 5, lambda: rilievo.Run(tmp_path / "none"))


def test_a_place_that_cannot_be_written_is_6(tmp_path):
    (tmp_path / "file").write_text("")
    error = raises(rilievo.ReadWriteError, 6, lambda: rilievo.synth(tmp_path / "file/set", views=2))
    assert isinstance(error, OSError)


def test_what_is_no_path_is_a_type_error(tmp_path):
    for call in (
        lambda: rilievo.reconstruct(3, tmp_path / "run"),
        lambda: rilievo.reconstruct([3], tmp_path / "run"),
        lambda: rilievo.reconstruct(tmp_path, None),
        lambda: rilievo.synth(None),
        lambda: rilievo.Run(3),
        lambda: rilievo.evaluate(None, tmp_path),
    ):
        with pytest.raises(TypeError):
            call()


def test_a_name_that_begins_with_a_dash_is_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    raises(rilievo.InputError, 3, lambda: rilievo.reconstruct("--help", "run"), "--help")
