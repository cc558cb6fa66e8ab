"""A run directory, read back."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import Any, Iterator, Optional, Union

import numpy as np
import numpy.typing as npt

from . import _rilievo


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera, x right, y down, z forward; pixel centres at whole numbers.

    Attributes
    ----------
    K : (3, 3) float64
        Intrinsics, pixels.
    cam_from_world : (3, 4) float64, optional
        Pose ``[R | t]``: ``x_in_cam = R @ x_in_world + t``, in the world's unit.
    distortion : (5,) or (12,) float64, optional
        OpenCV's ``k1, k2, p1, p2, k3``; ``None`` for none. Wide lenses have behind them k4, the denominator's three
        coefficients, two of thin prisms, and 1 for a fisheye.
    size : (int, int), optional
        Width and height of the image, pixels.
    image : str, optional
        File name of the photo.
    """

    K: npt.NDArray[np.float64]
    cam_from_world: Optional[npt.NDArray[np.float64]] = None
    distortion: Optional[npt.NDArray[np.float64]] = None
    size: Optional[tuple[int, int]] = None
    image: Optional[str] = None

    @property
    def center(self) -> Optional[npt.NDArray[np.float64]]:
        """Camera centre in the world, (3,) float64; ``None`` without a pose."""
        if self.cam_from_world is None:
            return None
        pose = np.asarray(self.cam_from_world, dtype=np.float64)
        return -pose[:3, :3].T @ pose[:3, 3]


@dataclass(frozen=True, eq=False)
class Cloud:
    """An oriented, coloured point cloud in the run's world; unpacks to points, normals, colours.

    Attributes
    ----------
    points : (n, 3) float32, float64 where the cameras stand far from their world's origin
        Positions, in the run's unit.
    normals : (n, 3) float32
        Unit normals, outwards.
    colors : (n, 3) uint8
        sRGB.
    confidence : (n,) float32
        0 to 1.
    num_views : (n,) uint8
        Number of views that agree on the point.
    """

    points: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    colors: npt.NDArray[np.uint8]
    confidence: npt.NDArray[np.float32]
    num_views: npt.NDArray[np.uint8]

    def __iter__(self) -> Iterator[npt.NDArray[Any]]:
        return iter((self.points, self.normals, self.colors))

    def __len__(self) -> int:
        return len(self.points)


class Run:
    """A run directory, read when it is asked; nothing in it is changed.

    Parameters
    ----------
    path : path
        The run directory.

    Raises
    ------
    RunDirError
        When it is none or of another version; later, when a stage that is asked for has no result.
    """

    path: str

    def __init__(self, path: Union[str, bytes, os.PathLike[str], os.PathLike[bytes]]) -> None:
        self.path = os.fsdecode(path)
        self._results = _rilievo.open_run(self.path)

    def __repr__(self) -> str:
        return f"rilievo.Run({self.path!r})"

    @property
    def cameras(self) -> dict[str, Camera]:
        """Cameras with poses by the views' names, in the order of the photos; photos without a pose are absent."""
        cameras = {}
        for name, image, (fx, fy, cx, cy), distortion, size, pose in self._results.cameras():
            cameras[name] = Camera(
                K=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
                cam_from_world=np.array(pose),
                distortion=np.array(distortion) if any(distortion) else None,
                size=size,
                image=image,
            )
        return cameras

    @property
    def names(self) -> list[str]:
        """Names of the views: those of the photos that have a pose, without endings."""
        return [camera[0] for camera in self._results.cameras()]

    @property
    def unit(self) -> str:
        """Unit of all lengths: ``"metre"``, or ``"arbitrary"`` where nothing states the size."""
        return self._results.unit()

    def depth(self, name: str) -> npt.NDArray[np.float32]:
        """Depth of a view along the optical axis, (height, width) float32, in the run's unit; 0 where there is none."""
        return self._results.depth(name)

    def normal(self, name: str) -> npt.NDArray[np.float32]:
        """Unit normals of a view in the camera's frame, towards the camera (z < 0), (height, width, 3) float32; zero
        where there are none."""
        return self._results.normal(name)

    def albedo(self, name: str) -> npt.NDArray[np.float32]:
        """Albedo of a view, 1 is the mean, (height, width, 3) float32, of a grey photo (height, width)."""
        return self._results.albedo(name)

    def rendered(self, name: str) -> npt.NDArray[np.float32]:
        """The image that a view's shape explains, linear with white at 1, of the photo's shape, float32."""
        return self._results.rendered(name)

    def confidence(self, name: str) -> npt.NDArray[np.float32]:
        """How far each normal can be trusted, 0 to 1, (height, width) float32: 0.5 where an error of five degrees is
        expected."""
        return self._results.confidence(name)

    def cloud(self) -> Cloud:
        """The point cloud."""
        return Cloud(*self._results.cloud())

    @property
    def report(self) -> dict[str, Any]:
        """What ``report.json`` holds: verdict, warnings, findings of the stages."""
        report: dict[str, Any] = json.loads(self._results.report())
        return report
