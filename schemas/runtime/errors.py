"""What a user can mend."""

from __future__ import annotations

from schemas.wire.text import plain

SAID_CHARS = 1000


class ConfigError(Exception):
    """A configuration or a file that cannot be used; `str()` names the fix, on one line. Exit code 78."""

    def __init__(self, said: str) -> None:
        """said: may quote what the user gave, whatever is in it."""
        super().__init__(plain(said, SAID_CHARS))
