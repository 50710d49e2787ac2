"""Writes a film: a GIF, a video, a picture, or a picture for every step."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

from dosplan.report.film.drives import Take
from dosplan.report.film.film import Film
from dosplan.report.film.layers import SET_RAMP
from dosplan.report.palette import INK, KIND_COLOURS, WHITE
from dosplan.system.files import FileError, atomic_file, write_bytes
from dosplan.types import STEP_SECONDS

LAST_SECONDS: Final = 2.0
"""Time for which the last picture of a film is shown, s, so that the outcome can be read."""

_SHARP: Final = 2.0  # Pixels of pictures and videos for each pixel of a GIF.
_SAMPLES: Final = 6
_SHADES: Final = 8
_ALIKE: Final = 6  # Levels; colours that differ from a key colour by no more are replaced by it.
_SWATCH: Final = 40  # Pixels; the weight of a key colour among the colours of the pictures.


def write_gif(takes: Sequence[Take], title: str, out: Path) -> None:
    """Writes a GIF that plays in real time, one picture for each step.

    All pictures share one palette: that keeps colours steady, and the file small.

    Args:
        takes: What is shown.
        title: A line above it.
        out: The file.

    Raises:
        FileError: It cannot be written.
    """
    with atomic_file(out) as file:
        film = Film(takes, title)
        palette = _palette(film, takes)
        pictures = (
            Image.fromarray(film.picture(step)).quantize(palette=palette, dither=Image.Dither.NONE)
            for step in film.steps
        )
        milliseconds = [round(1e3 * STEP_SECONDS)] * len(film.steps)
        milliseconds[-1] = round(1e3 * LAST_SECONDS)
        next(pictures).save(
            file,
            "GIF",
            save_all=True,
            append_images=pictures,
            duration=milliseconds,
            loop=0,
            optimize=True,
            disposal=1,
        )


def write_video(takes: Sequence[Take], title: str, out: Path) -> None:
    """Writes an MP4 (H.264) that plays in real time.

    Args:
        takes: What is shown.
        title: A line above it.
        out: The file.

    Raises:
        FileError: There is no ffmpeg, or the file cannot be written.
    """
    try:
        import imageio_ffmpeg  # Of an optional dependency.

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        raise FileError(
            f"cannot write {out}: there is no ffmpeg; pip install 'dosplan[video]', or write a .gif"
        ) from None
    film = Film(takes, title, _SHARP)
    rate = round(1.0 / STEP_SECONDS)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        writer = imageio_ffmpeg.write_frames(
            str(path), film.size, fps=rate, macro_block_size=2, output_params=["-crf", "20"]
        )
        writer.send(None)
        for step in film.steps:
            writer.send(picture := np.ascontiguousarray(film.picture(step)))
        for _ in range(round(LAST_SECONDS * rate)):
            writer.send(picture)
        writer.close()
        write_bytes(out, path.read_bytes())


def write_picture(takes: Sequence[Take], title: str, out: Path, seconds: float | None) -> None:
    """Writes one picture, a PNG.

    Args:
        takes: What is shown.
        title: A line above it.
        out: The file.
        seconds: Its time since the start, s; that of the outcome if None.

    Raises:
        FileError: The film has no such time, or the file cannot be written.
    """
    film = Film(takes, title, _SHARP)
    step = film.moment
    if seconds is not None:
        lasts = (len(film.steps) - 1) * STEP_SECONDS
        if not 0.0 <= seconds <= lasts + 0.5 * STEP_SECONDS:
            raise FileError(f"there is no picture at {seconds:g} s: it lasts {lasts:.1f} s")
        step = film.steps[min(round(seconds / STEP_SECONDS), len(film.steps) - 1)]
    _write_png(film, step, out)


def write_pictures(takes: Sequence[Take], title: str, out: Path) -> int:
    """Writes a PNG for every step: ``NAME-000.png``, ``NAME-001.png``, ...

    Args:
        takes: What is shown.
        title: A line above it.
        out: ``NAME.png``, whose name is numbered.

    Returns:
        How many.

    Raises:
        FileError: A file cannot be written.
    """
    film = Film(takes, title, _SHARP)
    for number, step in enumerate(film.steps):
        _write_png(film, step, out.with_name(f"{out.stem}-{number:03d}{out.suffix}"))
    return len(film.steps)


def _write_png(film: Film, step: int, out: Path) -> None:
    with atomic_file(out) as file:
        Image.fromarray(film.picture(step)).save(file, "PNG")


def _palette(film: Film, takes: Sequence[Take]) -> Image.Image:
    """A palette for all pictures of a film, in which the colours that mean something are exact."""
    wanted = [*(take.colour for take in takes), *KIND_COLOURS.values(), INK, WHITE]
    ramp = SET_RAMP(np.linspace(0.0, 1.0, _SHADES))[:, :3]
    keys = np.concatenate([[to_rgb(colour) for colour in wanted], ramp])
    steps = np.linspace(film.steps[0], film.steps[-1], _SAMPLES).round().astype(int)
    pictures = [film.picture(int(step)) for step in np.unique([*steps, film.moment])]
    swatches = np.repeat(np.round(255.0 * keys).astype(np.uint8), _SWATCH, axis=0)
    swatches = np.tile(swatches, (1 + film.size[0] // len(swatches), 1))[: film.size[0]]
    rows = np.tile(swatches, (_SWATCH, 1, 1))
    everything = Image.fromarray(np.concatenate([*pictures, rows]))
    palette = everything.quantize(colors=255, method=Image.Quantize.MEDIANCUT, kmeans=2)
    entries = np.array(palette.getpalette()).reshape(-1, 3)
    for key in np.round(255.0 * keys):
        away = np.abs(entries - key).max(axis=-1)
        entries[away <= max(_ALIKE, away.min())] = key
    palette.putpalette(entries.ravel().tolist())
    return palette
