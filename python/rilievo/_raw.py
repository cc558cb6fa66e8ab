"""Camera RAW files are decoded by a process of their own, with bounds on memory and time: a damaged one can ask for more
than there is, which would end this process."""

from __future__ import annotations

import sys

from . import _rilievo

# The native part alone, without the package and without site packages: little to start.
_CODE = """\
import sys
from importlib.util import module_from_spec, spec_from_file_location
spec = spec_from_file_location("_rilievo", sys.argv[1])
native = module_from_spec(spec)
spec.loader.exec_module(native)
native.decode_raw(sys.argv[2])
"""


def decode_in_a_child() -> None:
    """Has RAW files decoded by another interpreter; where Python does not know its own, by this process."""
    if sys.executable and _rilievo.__file__:
        _rilievo.decode_raw_with([sys.executable, "-I", "-S", "-c", _CODE, _rilievo.__file__])
