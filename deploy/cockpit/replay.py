"""`fastslow replay FILE`: a recording in the same page, with a playhead."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from deploy.cockpit.__main__ import address, listen, serve
from deploy.cockpit.config import CockpitConfig
from deploy.cockpit.sources import RecordingSource
from deploy.record.reader import open_recording
from schemas.runtime.process import CONFIG, OK, ConfigError


def replay(path: Path, *, host: str = "127.0.0.1", port: int = 8000, speed: float = 1.0) -> int:
    """Serve the recording in `path` until a signal; the exit code."""
    try:
        source = RecordingSource(open_recording(path))
        source.speed = speed
        listener = listen(host, port)
    except (OSError, ConfigError) as error:
        print(f"fastslow: {path}: {error}", file=sys.stderr)
        return CONFIG
    print(f"fastslow: {path} is shown at {address(listener)} (Ctrl-C ends it)", flush=True)
    asyncio.run(serve(source, listener, writable=CockpitConfig(host=host).writable))
    return OK
