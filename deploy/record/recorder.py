"""The recorder: what arrives on the bus, stamped, goes into the run's file; older runs make room for it."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import platform
import time
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from deploy.record.channels import CHANNELS, Translator
from deploy.record.container import McapFile
from deploy.record.reader import METADATA
from deploy.run.processes import RECORDING
from fast_node.mask.vocabulary import VERSION as MASK_VERSION
from fast_node.policies.load import files_of
from schemas.runtime.bus import Arrival
from schemas.runtime.clock import NS
from schemas.runtime.process import revision
from schemas.wire.messages import SCHEMA_VERSION, Message

CHUNK_NS = NS
"""A chunk a second: what a killed recorder loses at most."""


class FullError(Exception):
    """The recording has become as large as it may."""


class Recorder:
    """Puts messages into a file. What fails with `OSError` or `FullError` ends the recording; the file stays good."""

    def __init__(self, file: McapFile, about: dict[str, str], max_bytes: int) -> None:
        """`about`: metadata of a new file; of one that is continued its own, and its clock, count."""
        self._file, self._max_bytes = file, max_bytes
        if METADATA not in file.metadata:
            offset = time.time_ns() - time.monotonic_ns()
            file.add_metadata(METADATA, {**about, "clock_offset_ns": str(offset)})
        self._offset_ns = int(file.metadata[METADATA]["clock_offset_ns"])
        self._channels = {name: file.channel(*channel) for name, channel in CHANNELS.items()}
        self._translator = Translator(self._offset_ns)
        self._cut_ns = 0
        self._log_ns = 0
        self.metrics = {"messages": 0.0, "refused": 0.0, "mb": 0.0, "cpu_s": 0.0}

    def arrived(self, arrival: Arrival, now_ns: int) -> None:
        """Keep what came, and was seen by us at `now_ns` of CLOCK_MONOTONIC."""
        message = self._translator.message(arrival, now_ns)
        if message is None:
            self.metrics["refused"] += 1
        else:
            self._keep(arrival.topic, message, self._log_time(arrival.routed_ns, message.stamp_ns, now_ns))
        if now_ns - self._cut_ns >= CHUNK_NS:
            self._cut_ns = now_ns
            self._file.cut()
            self.metrics["mb"] = self._file.size / 1e6
            self.metrics["cpu_s"] = time.process_time()
            if self._file.size > self._max_bytes:
                raise FullError(f"it has reached {self._max_bytes / 1e6:.0f} MB")

    def _log_time(self, routed_ns: int, stamp_ns: int, now_ns: int) -> int:
        """When it passed the router, who is prompt and whose clock may be set; not when the idle class let us see it.

        In any case not before it was sent, not after we saw it, and never going back.
        """
        arrived_ns = max(routed_ns - self._offset_ns, stamp_ns) if routed_ns else now_ns
        self._log_ns = max(self._log_ns, min(arrived_ns, now_ns) + self._offset_ns)
        return self._log_ns

    def _keep(self, topic: str, message: Message, log_time: int) -> None:
        sent_ns = self._translator.sent_ns(message)
        for channel, data in self._translator.parts(topic, message):
            self._file.add(self._channels[channel], log_time, sent_ns, data)
        self.metrics["messages"] += 1


def describe(about: dict[str, str], policy: str) -> dict[str, str]:
    """The metadata of a run: what it was told, and what it ran with. `policy`: as `load_policy` takes it."""
    try:
        ours = version("fastslow")
    except PackageNotFoundError:
        ours = "not installed"
    return {
        **about,
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "fastslow": ours,
        "protocol": SCHEMA_VERSION,
        "mask": MASK_VERSION,
        "policy": policy,
        "policy_sha256": digest_of(policy),
        "revision": revision() or "",
        "python": platform.python_version(),
        "platform": platform.platform(),
    }


def digest_of(policy: str) -> str:
    """SHA-256 of the files that a policy is read from, one after the other; "" for a policy that has none."""
    files = files_of(policy)
    try:
        return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest() if files else ""
    except OSError:
        return ""


def prune(folder: Path, max_bytes: int) -> list[Path]:
    """Remove the recordings of the oldest runs in `folder` until all take at most `max_bytes`; returns which.

    One that is being written is left alone.
    """
    found = sorted(
        (stat.st_mtime, stat.st_size, path) for path in folder.glob(f"*/{RECORDING}") if (stat := path.stat())
    )
    total, removed = sum(size for _, size, _ in found), []
    for _, size, path in found:
        if total <= max_bytes:
            break
        with contextlib.suppress(OSError), path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
            total -= size
            removed.append(path)
    return removed
