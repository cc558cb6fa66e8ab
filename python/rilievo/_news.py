"""What a command reports while it works: events for the caller, sentences for the log."""

from __future__ import annotations

import json
import logging
from typing import Any, Callable, Optional

Event = dict[str, Any]
Progress = Callable[[Event], object]

_log = logging.getLogger("rilievo")


def hearing(progress: Optional[Progress]) -> Callable[[str, str], None]:
    """What the native part calls with ``("event", JSON)``, ``("note", sentence)`` and ``("stopping", sentence)``."""
    if progress is not None and not callable(progress):
        raise TypeError(f"progress: it must be callable or None, not {type(progress).__name__}")

    def on_news(kind: str, text: str) -> None:
        if kind == "note":
            _log.info("%s", text)
            return
        if kind == "stopping":
            _log.warning("%s", text)
            return
        event = json.loads(text)
        if event.get("event") == "warning":
            _log.warning("%s: %s", event.get("stage"), event.get("message"))
        if progress is not None:
            progress(event)

    return on_news
