"""Arguments that cannot be used are refused by name and shape; nothing ends the interpreter."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import LIGHTING, bump

import rilievo

SCENE = bump(40, 30, 60.0)
IMAGE, MASK, K, DEPTH = SCENE.image, SCENE.mask, SCENE.K, SCENE.depth


def with_value(array, value):
    changed = array.copy()
    changed[5, 5] = value
    return changed


def shade(**changed):
    given = dict(images=IMAGE, masks=MASK, cameras=K, lighting=LIGHTING, initial=DEPTH)
    return rilievo.shade(**{**given, **changed})


def test_the_undisturbed_arguments_serve():
    shade()


@pytest.mark.parametrize(
    "changed, name, told",
    [
        (dict(images=IMAGE[..., :2].copy()), "images", "(30, 40, 2)"),
        (dict(images=IMAGE[None].copy()), "images", "(1, 30, 40, 3)"),
        (dict(images=np.zeros((0, 4))), "images", "(0, 4)"),
        (dict(images=IMAGE[:, ::2]), "images", "contiguous"),
        (dict(images=np.asfortranarray(IMAGE)), "images", "contiguous"),
        (dict(images=with_value(IMAGE, np.nan)), "images", "3 of its values are not finite"),
        (dict(images=with_value(IMAGE, np.inf)), "images", "(30, 40, 3)"),
        (dict(masks=MASK.T.copy()), "masks", "(40, 30)"),
        (dict(masks=MASK[None].copy()), "masks", "(1, 30, 40)"),
        (dict(masks=np.zeros_like(MASK)), "masks", "inside"),
        (dict(masks=MASK[:, ::-1]), "masks", "contiguous"),
        (dict(initial=DEPTH[:-1].copy()), "initial", "(29, 40)"),
        (dict(initial=with_value(DEPTH, np.nan)), "initial", "not finite"),
        (dict(initial=with_value(DEPTH, -1.0)), "initial", "positive"),
        (dict(initial=np.zeros_like(DEPTH)), "initial", "none"),
        (dict(initial="somewhere"), "initial", "somewhere"),
        (dict(prior=DEPTH[:, 1:]), "prior", "(30, 39)"),
        (dict(prior=with_value(DEPTH, np.nan)), "prior", "not finite"),
        (dict(lighting=LIGHTING[:, :8]), "lighting", "(3, 8)"),
        (dict(lighting=LIGHTING[0]), "lighting", "3 channel"),
        (dict(lighting=np.full((3, 9), np.nan)), "lighting", "finite"),
        (dict(lighting=None, initial="plane"), "lighting", "needed"),
        (dict(cameras=K[:2]), "cameras", "(2, 3)"),
        (dict(cameras=np.full((3, 3), np.nan)), "cameras", "finite"),
        (dict(cameras=-K), "cameras", "focal"),
        (dict(cameras=K + np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0]])), "cameras", "cx"),
        (dict(cameras=(K, np.eye(3))), "cameras", "(3, 3)"),
        (dict(cameras=(K, 2 * np.eye(4))), "cameras", "rotation"),
        (dict(cameras=(K, np.full((3, 4), np.nan))), "cameras", "finite"),
        (dict(cameras=rilievo.Camera(K, size=(41, 30))), "cameras", "41 x 30"),
        (dict(cameras=rilievo.Camera(K, distortion=np.ones(5))), "cameras", "distortion"),
        (dict(matches=[(0, 1, np.zeros((3, 4)))]), "matches", "views"),
        (dict(matches=[(0, -1, np.zeros((3, 4)))]), "matches", "-1"),
        (dict(images=[IMAGE, IMAGE]), "masks", "array"),
        (dict(images=[IMAGE, IMAGE], masks=[MASK], initial=None), "masks", "1 for 2"),
        (dict(images=[]), "images", "none"),
        (dict(images=[IMAGE, with_value(IMAGE, np.nan)], masks=None, initial="plane"), "images[1]", "finite"),
        (dict(names=["a", "b"]), "names", "2 for 1"),
    ],
)
def test_what_does_not_fit_is_named(changed, name, told):
    with pytest.raises(rilievo.InputError) as caught:
        shade(**changed)
    assert isinstance(caught.value, ValueError) and caught.value.exit_code == 3
    assert name in str(caught.value) and told in str(caught.value), caught.value


@pytest.mark.parametrize(
    "changed, name",
    [
        (dict(images=IMAGE.astype(np.complex128)), "images"),
        (dict(images=IMAGE.astype(np.int64)), "images"),
        (dict(images=IMAGE.astype(">f4")), "images"),
        (dict(images=IMAGE.astype(object)), "images"),
        (dict(images="photo.jpg"), "images"),
        (dict(images=None), "images"),
        (dict(images=[IMAGE, "photo.jpg"], masks=None, initial="plane"), "images[1]"),
        (dict(masks=MASK.astype(np.float32)), "masks"),
        (dict(masks="mask.png"), "masks"),
        (dict(initial=DEPTH.astype(np.int32)), "initial"),
        (dict(prior=DEPTH.tolist()), "prior"),
        (dict(lighting="FILE"), "lighting"),
        (dict(cameras=None), "cameras"),
        (dict(cameras="camera.json"), "cameras"),
        (dict(matches=[np.zeros(4)]), "matches"),
    ],
)
def test_a_wrong_type_is_named(changed, name):
    with pytest.raises(rilievo.InputError) as caught:
        shade(**changed)
    assert isinstance(caught.value, TypeError)
    assert name in str(caught.value), caught.value


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2, 2), (5, 1)])
def test_tiny_images_are_shaped_or_refused(size):
    image, depth = np.full(size, 0.5), np.ones(size)
    try:
        found = rilievo.shade(image, None, np.diag([10.0, 10.0, 1.0]), LIGHTING[0], initial=depth)
        assert found.depth.shape == size
    except rilievo.Error as error:
        assert error.exit_code in (3, 4), error


def test_a_progress_that_cannot_be_called_is_refused():
    with pytest.raises(TypeError, match="progress"):
        shade(progress=3)
