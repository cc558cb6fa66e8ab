"""Shape from shading on arrays."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import Any, Iterator, Optional, Sequence, Union

import numpy as np
import numpy.typing as npt

from . import _rilievo
from ._commands import _options
from ._errors import InputError, InputTypeError
from ._news import Progress, hearing
from ._run import Camera

Array = npt.NDArray[Any]
CameraLike = Union[Camera, npt.ArrayLike, tuple[npt.ArrayLike, npt.ArrayLike]]


@dataclass(frozen=True, eq=False)
class Shaded:
    """What `shade` finds; unpacks to depth, normals, rendered image, report.

    For one view each is an array, for several a list of arrays in the views' order.

    Attributes
    ----------
    depth : (height, width) float32
        Along the optical axis, in the unit of the initial or prior depth; 0 outside the mask.
    normals : (height, width, 3) float32
        Unit normals in the camera's frame, towards the camera (z < 0); zero outside the mask.
    rendered : float32, shape of the image
        The image that the shape explains, linear.
    report : dict
        What ``rilievo shade`` writes to ``report.json``.
    confidence : (height, width) float32, or None
        How well data determine each pixel, 0 to 1.
    """

    depth: Any
    normals: Any
    rendered: Any
    report: dict[str, Any]
    confidence: Any = None

    def __iter__(self) -> Iterator[Any]:
        return iter((self.depth, self.normals, self.rendered, self.report))


def shade(
    images: Union[Array, Sequence[Array]],
    masks: Union[Array, Sequence[Optional[Array]], None] = None,
    cameras: Union[CameraLike, Sequence[CameraLike], None] = None,
    lighting: Union[npt.ArrayLike, Sequence[npt.ArrayLike], None] = None,
    *,
    initial: Union[Array, Sequence[Optional[Array]], str, None] = None,
    prior: Union[Array, Sequence[Optional[Array]], None] = None,
    prior_weight: Optional[float] = None,
    matches: Sequence[tuple[int, int, Array]] = (),
    names: Optional[Sequence[str]] = None,
    splitting: Optional[str] = None,
    order: Optional[int] = None,
    projection: Optional[str] = None,
    area_weight: Optional[float] = None,
    encoding: Optional[str] = None,
    config: Union[str, os.PathLike[str], None] = None,
    threads: Optional[int] = None,
    progress: Optional[Progress] = None,
) -> Shaded:
    """Shape from shading of one view, or of several coupled by matches: ``rilievo shade`` on arrays.

    An array for ``images`` is one view; a list or a tuple is several, and then every other argument is a list of the
    same length, or one value for all views where it says so. Arrays of pixels must lie row by row without gaps
    (`numpy.ascontiguousarray`) and hold finite values.

    Parameters
    ----------
    images : (height, width) or (height, width, 3)
        float32 and float64 are linear intensities; uint16 is linear, uint8 sRGB, unless ``encoding`` says otherwise.
    masks : (height, width) bool or uint8, optional
        The object, where not 0; the whole frame by default.
    cameras : (3, 3), or `Camera`, or (K, pose)
        Intrinsics K in pixels, pixel centres at whole numbers, without distortion; a pose is ``cam_from_world``, (3, 4)
        or (4, 4), and needed only with ``matches``. A single (3, 3) array serves all views.
    lighting : (9,) for grey images, or (channels, 9), optional
        Coefficients of the harmonics ``n1 n2 n3 1 n1n2 n1n3 n2n3 n1^2-n2^2 3n3^2-1`` of the normal in the camera's frame, times
        the mean albedo. A single array serves all views. Fitted on ``prior`` or ``initial`` by default.
    initial : (height, width) float32 or float64, or ``"plane"``, optional
        Depth to start from, 0 where there is none. ``"anchors"`` starts from the matches.
    prior : (height, width) float32 or float64, optional
        Measured depth to stay near to, 0 where there is none.
    prior_weight : float, optional
        Weight of squared differences of log depths against squared intensities, 500 by default.
    matches : sequence of (i, j, (n, 4) array)
        Of views i and j, from 0: ``x_i, y_i, x_j, y_j`` in pixels.
    names : sequence of str, optional
        Names of the views in messages and the report.
    splitting : str, optional
        ``"full"`` (default), ``"paper"`` or ``"fixed-point"``.
    order : int, optional
        Order of the harmonics, 1 or 2 (default).
    projection : str, optional
        ``"perspective"`` (default) or ``"orthographic"``.
    area_weight : float, optional
        Weight of the surface's area, 0 by default.
    encoding : str, optional
        ``"auto"``, ``"linear"`` or ``"srgb"``.
    config : path, optional
        Options, a TOML file with tables ``photos``, ``shading`` and ``lighting``.
    threads : int, optional
        Number of threads, all cores by default; results do not depend on it.
    progress : callable, optional
        As in `reconstruct`.

    Returns
    -------
    Shaded

    Raises
    ------
    InputError
        An array that does not fit, by its argument's name and shape; also a `ValueError`.
    InputTypeError
        A wrong dtype; also a `TypeError`.
    DataError
        The data do not determine a surface.
    """
    single = isinstance(images, np.ndarray)
    views = [images] if single else _sequence("images", images)
    if not views:
        raise InputError("images: there is none")
    count = len(views)
    start = None
    if isinstance(initial, str):
        if initial not in ("plane", "anchors"):
            raise InputError(f"initial: it is an array, 'plane' or 'anchors', not {initial!r}")
        start, initial = initial, None
    elif initial is not None:
        # A word that the command line takes for a file: the start is given.
        start = "given"
    if cameras is None:
        raise InputTypeError("cameras: they are needed, a (3, 3) array of intrinsics at least")
    list_of = {
        "masks": _per_view("masks", masks, count, single),
        "initial": _per_view("initial", initial, count, single),
        "prior": _per_view("prior", prior, count, single),
        "lighting": _for_all("lighting", lighting, count, single, 2),
        "cameras": _for_all("cameras", cameras, count, single, 2),
    }
    labels = _names(names, count)
    native = []
    for i in range(count):
        place = "" if single else f"[{i}]"
        camera, pose = _camera(list_of["cameras"][i], views[i], place)
        light = list_of["lighting"][i]
        native.append(
            _View(
                name=labels[i],
                place=place,
                image=views[i],
                mask=list_of["masks"][i],
                camera=camera,
                pose=pose,
                lighting=None if light is None else _light(light, place),
                initial=list_of["initial"][i],
                prior=list_of["prior"][i],
            )
        )
    options = dict(
        init=start,
        prior_weight=prior_weight,
        splitting=splitting,
        order=order,
        projection=projection,
        area_weight=area_weight,
        encoding=encoding,
        config=config,
        threads=threads,
    )
    tied = [_match(k, match) for k, match in enumerate(matches)]
    shaded, report = _rilievo.shade(native, tied, _options(options, {}), hearing(progress))
    depth, normals, rendered, confidence = (list(maps) for maps in zip(*shaded))
    if single:
        return Shaded(depth[0], normals[0], rendered[0], json.loads(report), confidence[0])
    found = None if confidence[0] is None else confidence
    return Shaded(depth, normals, rendered, json.loads(report), found)


@dataclass(frozen=True)
class _View:
    """A view as the native part reads it."""

    name: str
    place: str
    image: Any
    mask: Any
    camera: list[float]
    pose: Optional[list[list[float]]]
    lighting: Optional[Array]
    initial: Any
    prior: Any


def _sequence(name: str, value: Any) -> list[Any]:
    if isinstance(value, (list, tuple)):
        return list(value)
    raise InputTypeError(f"{name}: it must be an array or a list of arrays, not {type(value).__name__}")


def _of_length(name: str, value: Any, count: int) -> list[Any]:
    values = _sequence(name, value)
    if len(values) != count:
        raise InputError(f"{name}: there are {len(values)} for {count} images")
    return values


def _per_view(name: str, value: Any, count: int, single: bool) -> list[Any]:
    """One value for each view."""
    if value is None:
        return [None] * count
    if single:
        return [value]
    return _of_length(name, value, count)


def _for_all(name: str, value: Any, count: int, single: bool, ndim: int) -> list[Any]:
    """One value for each view, or one for all."""
    if single or value is None or isinstance(value, Camera):
        return [value] * count
    if isinstance(value, np.ndarray):
        return [value] * count if value.ndim <= ndim else _of_length(name, list(value), count)
    return _of_length(name, value, count)


def _names(names: Optional[Sequence[str]], count: int) -> list[str]:
    if names is None:
        return ["image"] if count == 1 else [f"view{i + 1}" for i in range(count)]
    named = [str(name) for name in _of_length("names", [names] if isinstance(names, str) else list(names), count)]
    if len(set(named)) != count:
        raise InputError("names: they must differ")
    return named


def _numbers(name: str, value: Any) -> Array:
    try:
        return np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputTypeError(f"{name}: its values are no numbers in rows of one length ({error})") from None


def _light(value: Any, place: str) -> Array:
    light = np.atleast_2d(_numbers(f"lighting{place}", value))
    if light.ndim != 2 or light.shape[1] != 9:
        raise InputError(f"lighting{place}: it must have the shape (9,) or (channels, 9), not {np.shape(value)}")
    return light


def _camera(camera: Any, image: Any, place: str) -> tuple[list[float], Optional[list[list[float]]]]:
    name = f"cameras{place}"
    pose, distortion, size = None, None, None
    if isinstance(camera, Camera):
        camera, pose, distortion, size = camera.K, camera.cam_from_world, camera.distortion, camera.size
    elif isinstance(camera, tuple) and len(camera) == 2:
        camera, pose = camera
    matrix = _numbers(name, camera)
    if matrix.shape != (3, 3):
        raise InputError(f"{name}: K must have the shape (3, 3), not {matrix.shape}")
    (fx, skew, cx), (zero, fy, cy), last = matrix.tolist()
    if not np.isfinite(matrix).all() or fx <= 0 or fy <= 0:
        raise InputError(f"{name}: K must be finite, with positive focal lengths, not {matrix.tolist()}")
    if skew != 0 or zero != 0 or last != [0.0, 0.0, 1.0]:
        raise InputError(f"{name}: K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], not {matrix.tolist()}")
    if distortion is not None and np.any(distortion):
        raise InputError(f"{name}: lens distortion must be removed from the image before shading")
    shape = getattr(image, "shape", ())
    if size is not None and tuple(size) != tuple(shape[1::-1]):
        raise InputError(f"{name}: it is a camera of {size[0]} x {size[1]} pixels, the image has the shape {shape}")
    if pose is None:
        return [fx, fy, cx, cy], None
    rows = _numbers(f"{name}: cam_from_world", pose)
    if rows.shape not in ((3, 4), (4, 4)):
        raise InputError(f"{name}: cam_from_world must have the shape (3, 4) or (4, 4), not {rows.shape}")
    return [fx, fy, cx, cy], rows[:3].tolist()


def _match(k: int, match: Any) -> tuple[int, int, Any]:
    try:
        first, second, pixels = match
        first, second = int(first), int(second)
    except (TypeError, ValueError):
        raise InputTypeError(f"matches[{k}]: it must be (i, j, array of shape (n, 4))") from None
    if first < 0 or second < 0:
        raise InputError(f"matches[{k}]: views are counted from 0, not {first} and {second}")
    return first, second, _numbers(f"matches[{k}]", pixels)
