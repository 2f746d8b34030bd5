"""`make test`: the real-time tests one after the other, and beside them all others, two at a time.

The real-time tests mostly wait, and what they need, they need at once. So the others get what is left of the machine
until these are over: a tenth where both want it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from deploy.run.launch import Launched, launch, temporary_folder

PYTEST = (sys.executable, "-m", "pytest")
NICE = 10
NO_TESTS = 5
"""pytest's exit code where the arguments name none of its tests."""


def weigh(others: Launched, nice: int) -> None:
    """Give all processes of the others this niceness, and their session among the sessions, if it is granted."""
    try:
        os.setpriority(os.PRIO_PGRP, others.pid, nice)
        Path(f"/proc/{others.pid}/autogroup").write_text(str(nice), encoding="ascii")
    except OSError:  # they are over; or no autogroups, as on macOS; or only the superuser may raise it again
        pass


def follow(others: Launched) -> None:
    """Print what they have said and go on saying, until they end."""
    with others.log.open("rb") as log:
        while others.exit_code() is None or log.peek(1):
            sys.stdout.buffer.write(log.read())
            sys.stdout.flush()
            time.sleep(0.1)


def main(arguments: Sequence[str]) -> int:
    """The exit code of the first part that failed; 0 if none did. arguments: pytest's, of both parts."""
    with temporary_folder() as folder:
        said = folder / "said"
        split = ("-n", "2", "--dist", "loadfile", "--realtime=without")
        others = launch("pytest", [*PYTEST, *split, *arguments], said, env=os.environ)
        try:
            weigh(others, min(19, os.nice(0) + NICE))
            code = subprocess.run([*PYTEST, "--realtime=alone", *arguments]).returncode
            weigh(others, os.nice(0))  # as this process
            follow(others)
        finally:
            others.end()
    codes = {code, others.popen.returncode} - {NO_TESTS}
    return max(map(abs, codes), default=0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
