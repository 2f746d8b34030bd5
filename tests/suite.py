"""`make test`: the real-time tests one after the other, and beside them all others, two at a time.

The real-time tests mostly wait, and what they need, they need at once. So the others get what is left of the machine
until these are over: a tenth where both want it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from deploy.run.launch import Launched, launch, temporary_folder

PYTEST = (sys.executable, "-m", "pytest")
NICE = 10
NO_TESTS = 5
"""pytest's exit code where the arguments name none of its tests."""


def weigh(others: Launched, more: int) -> None:
    """Make all processes of the others so much nicer than this one, and their session than its, if it is granted."""
    own = Path("/proc/self/autogroup")
    try:
        os.setpriority(os.PRIO_PGRP, others.pid, min(19, os.nice(0) + more))
        group = min(19, int(own.read_text(encoding="ascii").rpartition(" ")[2]) + more)
        Path(f"/proc/{others.pid}/autogroup").write_text(str(group), encoding="ascii")
    except (OSError, ValueError):  # they are over; or no autogroups, as on macOS; or only the superuser may go back
        pass


def follow(others: Launched) -> None:
    """Print what they have said and go on saying, until they end."""
    with others.log.open("rb") as log:
        while True:
            with suppress(subprocess.TimeoutExpired):
                others.popen.wait(1.0)
            sys.stdout.buffer.write(log.read())
            sys.stdout.flush()
            if others.popen.returncode is not None:
                return


def main(arguments: Sequence[str]) -> int:
    """The larger exit code of the two parts; 0 if both passed. arguments: pytest's, of both."""
    with temporary_folder() as folder:
        said = folder / "said"
        split = ("-n", "2", "--dist", "loadfile", "--realtime=without")
        others = launch("pytest", [*PYTEST, *split, *arguments], said, env=os.environ)
        weigh(others, NICE)
        alone = subprocess.Popen([*PYTEST, "--realtime=alone", *arguments])

        def stop(*_: object) -> None:
            alone.send_signal(signal.SIGINT)
            raise KeyboardInterrupt

        signal.signal(signal.SIGTERM, stop)
        try:
            code = alone.wait()
            weigh(others, 0)
            follow(others)
        except KeyboardInterrupt:  # the terminal has told it, too
            alone.wait()
            return 128 + signal.SIGINT
        finally:
            others.end()
    codes = {code, others.popen.returncode} - {NO_TESTS}
    return max(map(abs, codes), default=0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
