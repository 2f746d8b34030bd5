"""The cockpit's configuration."""

from __future__ import annotations

import ipaddress

from schemas.runtime.process import NodeConfig


class CockpitConfig(NodeConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `python -m deploy.cockpit` takes."""

    host: str = "127.0.0.1"
    """Where the page is served. Beyond loopback the page is read-only: to look, not to speak or steer."""
    port: int = 8000
    """A free one is taken where this one is held; 0: any free one."""
    polite: bool = True
    """Run only when nobody else wants the core."""

    def __post_init__(self) -> None:
        try:
            ipaddress.ip_address(self.host)
        except ValueError:
            raise ValueError(f"host {self.host!r} is not an IP address") from None
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port {self.port} is not within 0..65535")

    @property
    def writable(self) -> bool:
        """Whether a page may speak to the car and steer the simulator: on loopback only."""
        return ipaddress.ip_address(self.host).is_loopback
