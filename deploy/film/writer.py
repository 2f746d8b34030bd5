"""Pictures into a file: GIF by Pillow, WebP and MP4 by the ffmpeg that imageio-ffmpeg brings. Real-time speed."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.driving.road import HZ
from schemas.runtime.process import ConfigError

Picture = NDArray[np.uint8]
GIF = ".gif"
CODECS: dict[str, dict[str, Any]] = {
    ".webp": {
        "codec": "libwebp_anim",
        "pix_fmt_out": "bgra",
        "output_params": ["-loop", "0", "-lossless", "1", "-compression_level", "3"],
    },
    ".mp4": {},
}
"""How ffmpeg writes the others. Without loss a drawn WebP is smaller, too."""
SUFFIXES = (GIF, *CODECS)
GIF_COLOURS = 96
GIF_WIDTH = 720
"""A GIF is scaled down to this width: half a minute stays under 3 MB."""
GIF_MOST_S = 180.0
"""A GIF is made in memory, and nobody waits for a longer one."""


def write_film(path: Path, pictures: Iterable[Picture], hz: float = HZ) -> int:
    """Write pictures (height, width, 3), `hz` of them per second of driving; return how many.

    `path` appears when the film is whole. Raises `ConfigError` for an unknown suffix, a folder that cannot be written,
    a missing package, a GIF that grows too long, or a drive without a single picture.
    """
    checked(path)
    part = path.with_stem(f"{path.stem}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        count = _gif(part, pictures, hz) if path.suffix == GIF else _by_ffmpeg(part, pictures, hz)
        if not count:
            raise ConfigError(f"{path.name}: there is nothing to show")
        os.replace(part, path)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror or error}") from None
    finally:
        part.unlink(missing_ok=True)
    return count


def checked(path: Path) -> Path:
    """`path` itself. Raises `ConfigError` where its suffix is none that a film can have."""
    if path.suffix not in SUFFIXES:
        raise ConfigError(f"{path.name}: a film ends in {', '.join(SUFFIXES)}")
    return path


def _gif(path: Path, pictures: Iterable[Picture], hz: float) -> int:
    try:
        from PIL import Image
    except ImportError:
        raise ConfigError("a .gif needs pillow: pip install 'fastslow[view]'") from None
    packed: list[bytes] = []  # a hundredth of what they are unpacked
    size = (0, 0)
    for picture in pictures:
        frame = Image.fromarray(picture)
        size = (GIF_WIDTH, GIF_WIDTH * frame.height // frame.width)
        packed.append(zlib.compress(frame.resize(size).tobytes(), 1))
        if len(packed) > GIF_MOST_S * hz:
            raise ConfigError(f"a .gif lasts {GIF_MOST_S:.0f} s at most: film less, or write an .mp4 or .webp")
    if not packed:
        return 0
    frames = _with_one_palette(packed, size)
    next(frames).save(
        path,
        save_all=True,
        append_images=frames,
        duration=durations_ms(len(packed), hz),
        loop=0,
        optimize=True,
        disposal=1,
    )
    return len(packed)


def _with_one_palette(packed: list[bytes], size: tuple[int, int]) -> Iterator[Any]:
    """The frames in colours that they share: half are those of large areas, as they are. The other half covers the
    rest, rare ones among them: a car is small, and its colour means something."""
    from PIL import Image

    def frame(data: bytes) -> Any:
        return Image.frombytes("RGB", size, zlib.decompress(data))

    some = packed[:: max(len(packed) // 8, 1)]
    sheet = Image.new("RGB", (size[0], size[1] * len(some)))
    for k, data in enumerate(some):
        sheet.paste(frame(data), (0, k * size[1]))
    channels = np.asarray(sheet, np.int64).reshape(-1, 3)
    colours, counts = np.unique(channels @ np.array((1 << 16, 1 << 8, 1)), return_counts=True)
    common = colours[np.argsort(-counts)[: GIF_COLOURS // 2]].astype(np.int64)
    large = np.stack([common >> 16, common >> 8 & 255, common & 255], axis=1).ravel().tolist()
    rest = sheet.quantize(GIF_COLOURS // 2, method=Image.Quantize.MAXCOVERAGE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(large + rest)
    for data in packed:
        yield frame(data).quantize(palette=palette, dither=Image.Dither.NONE)


def durations_ms(count: int, hz: float) -> list[int]:
    """How long each picture of a GIF stays [ms]: it counts in hundredths of a second; rounding is spread evenly."""
    ends = [round(100.0 * (k + 1) / hz) * 10 for k in range(count)]
    return [end - start for start, end in zip([0, *ends], ends, strict=False)]


def _by_ffmpeg(path: Path, pictures: Iterable[Picture], hz: float) -> int:
    try:
        import imageio_ffmpeg
    except ImportError:
        raise ConfigError(
            f"a {path.suffix} needs imageio-ffmpeg: pip install 'fastslow[view]'; a .gif does not"
        ) from None
    count, writer = 0, None
    try:
        for picture in pictures:
            if writer is None:
                height, width = picture.shape[:2]
                writer = imageio_ffmpeg.write_frames(
                    str(path), (width, height), fps=hz, macro_block_size=2, **CODECS[path.suffix]
                )
                writer.send(None)
            writer.send(np.ascontiguousarray(picture))
            count += 1
    finally:
        if writer is not None:
            writer.close()
    return count
