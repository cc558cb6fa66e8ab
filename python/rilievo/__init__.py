"""Photographs of a plain, matte object to an accurate, finely detailed 3D model, by shading.

Lengths are metres where a sphere or given cameras say so (`Run.unit`); cameras look along z, x right, y down; depth is along
the optical axis, 0 where there is none; normals are in the camera's frame, towards the camera; pixel centres are at
whole numbers; intensities are linear with white at 1.

Sentences for people go to the logger ``rilievo``. Python's lock is released while a command works.
"""

from . import _rilievo
from ._commands import evaluate, reconstruct, synth
from ._errors import DataError, Error, InputError, InputTypeError, ReadWriteError, RunDirError, UsageError
from ._raw import decode_in_a_child
from ._run import Camera, Cloud, Run
from ._shade import Shaded, shade

__version__: str = _rilievo.__version__

__all__ = [
    "Camera",
    "Cloud",
    "DataError",
    "Error",
    "InputError",
    "InputTypeError",
    "ReadWriteError",
    "Run",
    "RunDirError",
    "Shaded",
    "UsageError",
    "evaluate",
    "reconstruct",
    "shade",
    "synth",
]

decode_in_a_child()
