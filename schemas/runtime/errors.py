"""What a user can mend."""


class ConfigError(Exception):
    """A configuration or a file that cannot be used; `str()` names the fix. Exit code 78."""
