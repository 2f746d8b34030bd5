"""The certificates by which a car is reached from other hosts, tried before anything starts."""

from __future__ import annotations

import ssl
from contextlib import suppress
from pathlib import Path

from schemas.runtime.bus_settings import Tls
from schemas.runtime.errors import ConfigError
from schemas.runtime.files import read_bounded
from schemas.wire.text import plain

MOST_BYTES = 1_000_000
"""Of a file; the bundle of all public authorities has a quarter of that."""


def certificates(cert: str | None, key: str | None, ca: str | None, *, listens: bool) -> Tls | None:
    """The files, as absolute paths; None where there is none. The key is beside the certificate, as NAME.key beside
    NAME.pem, and the authority's is ca.pem beside it, unless given.

    listens: whether they are shown to who calls, or to whom one calls. Raises `ConfigError`, one line, for what cannot
    be read, or does not belong together: with these, zenoh would start, and nobody could reach anybody.
    """
    if cert is None:
        if key or ca:
            raise ConfigError("--key and --ca need --cert")
        return None
    here = Path(cert)
    files = (here, Path(key) if key else here.with_suffix(".key"), Path(ca) if ca else here.parent / "ca.pem")
    for option, file in zip(("--cert", "--key", "--ca"), files, strict=True):
        try:
            text = read_bounded(file, MOST_BYTES)
        except ConfigError as error:
            raise ConfigError(f"{option}: {error}") from None
        if b"-----BEGIN" not in text:
            raise ConfigError(f"{_name(file)} is no PEM file: give another one with {option}")
    _try_them(*files, listens=listens)
    return Tls(cert=str(files[0].absolute()), key=str(files[1].absolute()), ca=str(files[2].absolute()))


def _try_them(cert: Path, key: Path, ca: Path, *, listens: bool) -> None:
    """Have one end show the certificate to another that asks for one of the authority. Raises `ConfigError`."""
    server, client = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.check_hostname = False
    for end in (server, client):
        try:
            end.load_cert_chain(cert, key, password="")  # or OpenSSL would ask the terminal for one
        except (ssl.SSLError, ValueError):
            what = f"{_name(key)} is no key without a password of the certificate {_name(cert)}"
            raise ConfigError(f"{what}: give another --key or --cert") from None
        try:
            end.load_verify_locations(ca)
        except ssl.SSLError:
            raise ConfigError(f"{_name(ca)} is no certificate of an authority: give another one with --ca") from None
        end.verify_mode = ssl.CERT_REQUIRED if (end is client) is listens else ssl.CERT_NONE
    try:
        _shake_hands(server, client)
    except ssl.SSLCertVerificationError as error:
        raise ConfigError(
            f"{_name(cert)} is not good for {'--listen' if listens else '--connect'} with the authority {_name(ca)}"
            f" ({error.verify_message}): give another --cert or --ca"
        ) from None


def _shake_hands(server: ssl.SSLContext, client: ssl.SSLContext) -> None:
    """In memory, until nobody has more to say."""
    there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = (client.wrap_bio(back, there), server.wrap_bio(there, back, server_side=True))
    for _ in range(3):
        for end in ends:
            with suppress(ssl.SSLWantReadError):
                end.do_handshake()


def _name(file: Path) -> str:
    return plain(str(file), 300)
