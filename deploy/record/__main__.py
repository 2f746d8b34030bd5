"""`python -m deploy.record '{"bus": {...}, "path": "x.mcap"}'`: record everything that is said on the bus.

A process of its own, in the idle scheduling class. zenoh's threads keep their ordinary one, so that nothing is lost
while the recorder waits for its turn.
"""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from pathlib import Path

from deploy.record.container import McapFile, NotARecordingError
from deploy.record.recorder import FullError, Recorder, describe, prune
from schemas.runtime.bus import Arrivals, open_bus
from schemas.runtime.process import ConfigError, Heartbeat, NodeConfig, Stopped, load_config, log, run_node
from schemas.runtime.realtime import yield_to_others
from schemas.wire.messages import Event, EventKind
from schemas.wire.topics import EVENT, STATUS

NAME = "record"
PENDING = 8192
"""Messages that wait for the recorder: more than a minute's."""
NICE = 10
"""Of its session, against the others: a hundredth of a busy core is enough for it, and less would lose messages."""
PRUNE_EVERY_NS = 30 * 10**9


class RecordConfig(NodeConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `python -m deploy.record` takes."""

    path: str
    """The file; one that is there already is continued."""
    folder: str = ""
    """Where the folders of all runs are; "": nothing is pruned."""
    max_mb: float = 300.0
    """For all recordings in `folder` together, and for this one alone."""
    policy: str = "fastslow"
    """What drives, as `fast_node.policies.load.load_policy` takes it."""
    about: dict[str, str] = {}
    """Metadata: what the run was told."""

    def __post_init__(self) -> None:
        if self.max_mb <= 0:
            raise ValueError(f"max_mb must be above 0, not {self.max_mb}")


def main() -> None:
    config = load_config(RecordConfig, sys.argv[1:])
    max_bytes = round(config.max_mb * 1e6)
    try:
        file = McapFile(Path(config.path))
        recorder = Recorder(file, describe(config.about, config.policy), max_bytes)
    except (OSError, NotARecordingError, FullError) as error:
        raise ConfigError(f"cannot record to {config.path}: {error}") from None
    with open_bus(config.bus) as bus:
        arrivals = bus.subscribe_all(PENDING)
        scheduling = yield_to_others(NICE)
        for topic in (EVENT, STATUS):
            bus.announce(topic)
        with Heartbeat(bus, NAME, lambda: dict(recorder.metrics), stuck_s=60.0) as heart:
            log(NAME, "ready", path=config.path, scheduling=scheduling)
            try:
                record(recorder, arrivals, Path(config.folder) if config.folder else None, max_bytes)
            except (OSError, FullError) as error:
                with suppress(OSError):
                    file.finish()
                why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
                heart.state = "degraded"
                said = f"recording stopped: {why}; the run goes on"
                log(NAME, "stopped", said, path=config.path)
                now_ns = time.monotonic_ns()
                bus.publish(
                    EVENT, Event(epoch=0, stamp_ns=now_ns, kind=EventKind.FAULT, node=NAME, tick=-1, detail=said)
                )
            except Stopped:
                with suppress(OSError, FullError):
                    for arrival in arrivals.take():
                        recorder.arrived(arrival, time.monotonic_ns())
                with suppress(OSError):
                    file.finish()
                raise
            while True:  # a heart beats on, so that nobody takes the recorder for dead and starts it again
                arrivals.wait()


def record(recorder: Recorder, arrivals: Arrivals, folder: Path | None, max_bytes: int) -> None:
    """Until it fails or a signal comes; makes room among the runs in `folder` now and then."""
    prune_ns = 0
    while True:
        arrival = arrivals.wait()
        now_ns = time.monotonic_ns()
        recorder.arrived(arrival, now_ns)
        if folder is not None and now_ns - prune_ns > PRUNE_EVERY_NS:
            prune_ns = now_ns
            for old in prune(folder, max_bytes):
                log(NAME, "pruned", str(old))


if __name__ == "__main__":
    sys.exit(run_node(NAME, main))
