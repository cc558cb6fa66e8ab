"""The commands that work on files."""

from __future__ import annotations

import json
import os
from typing import Any, Iterable, Mapping, Optional, Union

from . import _rilievo
from ._errors import UsageError
from ._news import Progress, hearing
from ._run import Run

Path = Union[str, bytes, "os.PathLike[str]", "os.PathLike[bytes]"]
Photos = Union[Path, Iterable[Path]]


def reconstruct(
    photos: Photos,
    out: Path,
    *,
    masks: Optional[Path] = None,
    cameras: Optional[Path] = None,
    sphere: Optional[Path] = None,
    sphere_radius: Optional[float] = None,
    lighting: Optional[str] = None,
    config: Optional[Path] = None,
    from_stage: Optional[str] = None,
    until: Optional[str] = None,
    overwrite: bool = False,
    progress: Optional[Progress] = None,
    memory: Union[int, str, None] = None,
    threads: Optional[int] = None,
    **options: object,
) -> Run:
    """Photographs to depth maps, a point cloud and a mesh: ``rilievo reconstruct``.

    Writes the same bytes as the command line. What is valid in ``out`` already is kept, so that the same call goes on
    after an interrupt (Ctrl-C, or an exception in ``progress``), and one with another option redoes only what
    depends on it.

    Parameters
    ----------
    photos : path or iterable of paths
        A folder of photos, or files.
    out : path
        The run directory.
    masks : path, optional
        Folder of object masks, or ``"none"`` for the whole frame; without it masks are proposed.
    cameras : path, optional
        Known cameras: ``cameras.json``, a COLMAP model, or another program's file.
    sphere : path, optional
        The reference sphere's file, ``"auto"`` or ``"none"``.
    sphere_radius : float, optional
        Its radius, metres.
    lighting : str, optional
        Known lighting, ``"FILE"`` or ``"FILE:NAME"``.
    config : path, optional
        Options of the stages, a TOML file.
    from_stage, until : str, optional
        First stage to redo, last stage, as ``"5_shading"``, ``"5"`` or ``"shading"``.
    overwrite : bool
        Replaces the results of other photos in ``out``.
    progress : callable, optional
        Called in the calling thread with a dict for every event, as ``--json`` prints them. What it raises stops the
        run and is raised again here.
    memory : int (bytes) or str (``"4G"``), optional
        Memory to work in.
    threads : int, optional
        Number of threads, all cores by default; results do not depend on it.
    **options
        Every other option of ``rilievo help reconstruct``, with ``_`` for ``-``: ``model="paper"``,
        ``triangles=200000``, ``formats="glb"``, ``strict=True``. ``None`` and ``False`` say nothing.

    Returns
    -------
    Run
        The results.

    Raises
    ------
    UsageError, InputError, DataError, RunDirError, ReadWriteError, Error
        As the exit codes 2 to 6, and others.
    KeyboardInterrupt
        After Ctrl-C, when the work at hand has ended.
    """
    given: dict[str, object] = dict(
        masks=masks,
        cameras=cameras,
        sphere=sphere,
        sphere_radius=sphere_radius,
        lighting=lighting,
        config=config,
        until=until,
        overwrite=overwrite,
        memory=memory,
        threads=threads,
    )
    given["from"] = from_stage
    arguments = ["reconstruct", _option("output", _path("out", out)), *_options(given, options)]
    _rilievo.run_command([*arguments, "--", *_paths(photos)], hearing(progress))
    return Run(out)


def synth(
    out: Path,
    *,
    views: Optional[int] = None,
    size: Union[str, tuple[int, int], None] = None,
    seed: Optional[int] = None,
    format: Optional[str] = None,
    mesh: Optional[Path] = None,
    near: Optional[float] = None,
    gloss: Optional[float] = None,
    config: Optional[Path] = None,
    progress: Optional[Progress] = None,
) -> None:
    """A synthetic photo folder with ground truth: ``rilievo synth``.

    Writes ``photos/``, ``masks/``, ``sphere.json``, ``intrinsics.json`` and ``truth/`` into ``out``.

    Parameters
    ----------
    out : path
        Folder to write; an earlier set in it is replaced, anything else is refused.
    views : int, optional
        Number of photos, 6 by default.
    size : (int, int) or str, optional
        Width and height of the photos in pixels, ``(640, 480)`` or ``"640x480"``, which is the default.
    seed : int, optional
        Another seed is another object.
    format : str, optional
        ``"jpeg"`` (default), ``"tiff"``, ``"png"``, ``"exr"`` or ``"dng"``.
    mesh : path, optional
        A mesh (PLY, z up) to photograph instead of a made object.
    near : float, optional
        Windows and lamps this far from the middle of the object, metres; endlessly far by default.
    gloss : float, optional
        Sheen of the object, 0 (matte, the default) to 1 (glazed).
    config : path, optional
        Options of scene and photographs, a TOML file.
    progress : callable, optional
        As in `reconstruct`.
    """
    if isinstance(size, tuple):
        size = "x".join(str(side) for side in size)
    given = dict(
        views=views,
        size=size,
        seed=seed,
        format=format,
        mesh=mesh,
        near=near,
        gloss=gloss,
        config=config,
    )
    _rilievo.run_command(["synth", *_options(given, {}), "--", _path("out", out)], hearing(progress))


def evaluate(
    run: Union[Path, Run],
    truth: Path,
    *,
    align: str = "auto",
    progress: Optional[Progress] = None,
) -> dict[str, Any]:
    """Accuracy of a run against ground truth: ``rilievo evaluate``.

    Parameters
    ----------
    run : path or Run
        The run directory, or a folder of ``rilievo shade``.
    truth : path
        Folder with ``cameras.json``, ``NAME_depth.exr``, ``NAME_normal.exr``, ``mesh.ply``; a part will do.
    align : str
        How the frames are brought together: ``"auto"``, ``"none"``, ``"se3"`` or ``"sim3"``.
    progress : callable, optional
        As in `reconstruct`.

    Returns
    -------
    dict
        What ``--json`` prints: ``alignment``, ``scale``, ``poses``, ``views``, ``all``, ``cloud``; angles in degrees,
        lengths in the truth's unit, shares from 0 to 1, ``None`` for what cannot be computed. The run's report shows
        it too.
    """
    path = run.path if isinstance(run, Run) else run
    given = dict(truth=truth, align=align)
    arguments = ["evaluate", *_options(given, {}), "--", _path("run", path)]
    found: dict[str, Any] = json.loads(_rilievo.evaluate(arguments, hearing(progress)))
    return found


def _path(name: str, value: Any) -> str:
    try:
        return os.fsdecode(value)
    except TypeError:
        raise TypeError(f"{name}: it must be a path, not {type(value).__name__}") from None


def _paths(photos: Photos) -> list[str]:
    if isinstance(photos, (str, bytes, os.PathLike)):
        photos = [photos]
    paths = [_path("photos", photo) for photo in photos]
    if not paths:
        raise UsageError("photos: there is none")
    return paths


def _option(name: str, value: object) -> str:
    if isinstance(value, (bytes, os.PathLike)):
        value = os.fsdecode(value)
    return f"--{name.replace('_', '-')}={value}"


def _options(given: Mapping[str, object], further: Mapping[str, object]) -> list[str]:
    """Arguments of the command line; a name that it does not know is refused there."""
    arguments = []
    for name, value in [*given.items(), *further.items()]:
        if value is None or value is False:
            continue
        if name in ("output", "json", "help"):
            raise UsageError(f"{name} is no argument here")
        if value is True:
            arguments.append(f"--{name.replace('_', '-')}")
        elif isinstance(value, (list, tuple)):
            arguments.append(_option(name, ",".join(str(part) for part in value)))
        else:
            arguments.append(_option(name, value))
    return arguments
