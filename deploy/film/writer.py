"""Pictures into a file: GIF and WebP by Pillow, MP4 by the ffmpeg that imageio-ffmpeg brings. Real-time speed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.driving.road import HZ
from schemas.runtime.process import ConfigError

Picture = NDArray[np.uint8]
SUFFIXES = (".gif", ".webp", ".mp4")
GIF_COLOURS = 96
GIF_WIDTH = 720
"""A GIF is scaled down to this width: half a minute stays under 3 MB."""


def write_film(path: Path, pictures: Iterable[Picture], hz: float = HZ) -> int:
    """Write pictures (height, width, 3), `hz` of them per second of driving; return how many.

    Raises `ConfigError` for an unknown suffix, a missing package, or a drive without a single picture.
    """
    checked(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    count = _mp4(path, pictures, hz) if path.suffix == ".mp4" else _animation(path, pictures, hz)
    if not count:
        raise ConfigError(f"{path.name}: there is nothing to show")
    return count


def checked(path: Path) -> Path:
    """`path` itself. Raises `ConfigError` where its suffix is none that a film can have."""
    if path.suffix not in SUFFIXES:
        raise ConfigError(f"{path.name}: a film ends in {', '.join(SUFFIXES)}")
    return path


def _animation(path: Path, pictures: Iterable[Picture], hz: float) -> int:
    try:
        from PIL import Image
    except ImportError:
        raise ConfigError("films need pillow: pip install 'fastslow[view]'") from None
    frames = [Image.fromarray(picture) for picture in pictures]
    if not frames:
        return 0
    if path.suffix == ".gif":
        frames = _with_one_palette([f.resize((GIF_WIDTH, GIF_WIDTH * f.height // f.width)) for f in frames])
    more: dict[str, Any] = {"optimize": True, "disposal": 1} if path.suffix == ".gif" else {"quality": 70, "method": 3}
    frames[0].save(
        path,
        save_all=True,
        append_images=frames[1:],
        duration=durations_ms(len(frames), hz, path.suffix),
        loop=0,
        **more,
    )
    return len(frames)


def _with_one_palette(frames: list[Any]) -> list[Any]:
    """The frames in colours that they share, rare ones among them: a car is small, and its colour means something."""
    from PIL import Image

    some = frames[:: max(len(frames) // 8, 1)]
    sheet = Image.new("RGB", (some[0].width, some[0].height * len(some)))
    for k, frame in enumerate(some):
        sheet.paste(frame, (0, k * frame.height))
    palette = sheet.quantize(GIF_COLOURS, method=Image.Quantize.MAXCOVERAGE)
    return [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]


def durations_ms(count: int, hz: float, suffix: str) -> list[int]:
    """How long each picture stays [ms]: a GIF counts in hundredths of a second, so the rounding is spread evenly."""
    grid = 10 if suffix == ".gif" else 1
    ends = [round(1000.0 * (k + 1) / hz / grid) * grid for k in range(count)]
    return [end - start for start, end in zip([0, *ends], ends, strict=False)]


def _mp4(path: Path, pictures: Iterable[Picture], hz: float) -> int:
    try:
        import imageio_ffmpeg
    except ImportError:
        raise ConfigError("an .mp4 needs imageio-ffmpeg: pip install 'fastslow[view]'; .gif and .webp do not") from None
    count, writer = 0, None
    for picture in pictures:
        if writer is None:
            height, width = picture.shape[:2]
            writer = imageio_ffmpeg.write_frames(str(path), (width, height), fps=hz, macro_block_size=2)
            writer.send(None)
        writer.send(np.ascontiguousarray(picture))
        count += 1
    if writer is not None:
        writer.close()
    return count
