"""A replay as a file that plays anywhere: H.264 in mp4, a small gif, or one picture as png."""

from __future__ import annotations

import importlib.util
import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from jaxftc.io.files import atomic_path
from jaxftc.view.replay import Replay, check_speed

if TYPE_CHECKING:
    from PIL.Image import Image

    from jaxftc.view.scene import Scene

PILLOW = ("PIL", "Pillow")
NEEDS = {".mp4": (("av", "PyAV"), PILLOW), ".gif": (PILLOW,), ".png": (PILLOW,)}  # modules that each kind of file needs
SIZES = (64, 4096)  # pixels, smallest and largest side
MOST_FRAMES = {".mp4": 36_000, ".gif": 600}  # frames of a gif are all kept until their common palette is known
GIF_COLOURS = 128


def check(path: Path, width: int, height: int, fps: float) -> None:
    """Refuse a file that could not be written, before anything is drawn.

    Raises:
        ValueError: suffix, size or rate are not possible, the folder is not there, or the extra ``view`` is not installed.
    """
    kind = path.suffix.lower()
    if kind not in NEEDS:
        raise ValueError(f"a video must be a .mp4, .gif or .png file, got {path}")
    if not path.parent.is_dir() or path.is_dir():
        raise ValueError(f"cannot write {path}: {'it is a folder' if path.is_dir() else f'no folder {path.parent}'}")
    for name, side in (("width", width), ("height", height)):
        if not SIZES[0] <= side <= SIZES[1]:
            raise ValueError(f"{name} must lie in {SIZES[0]} to {SIZES[1]} pixels, got {side}")
        if kind == ".mp4" and side % 2:
            raise ValueError(f"{name} of an mp4 must be even, got {side}; H.264 halves the colours' size")
    fastest = 50 if kind == ".gif" else 240
    if not 1 <= fps <= fastest:
        raise ValueError(f"fps must lie in 1 to {fastest} for {kind}, got {fps:g}")
    missing = [name for module, name in NEEDS[kind] if importlib.util.find_spec(module) is None]
    if missing:
        raise ValueError(f"writing {kind} needs {' and '.join(missing)}; pip install 'jaxftc[view]'")


def ticks(replay: Replay, kind: str, speed: float, fps: float) -> np.ndarray:
    """Tick of every frame of a ``.mp4`` or ``.gif`` with ``speed`` seconds of the run in a second of ``fps`` frames.

    Raises:
        ValueError: the speed is not a positive number, or gives a film that nobody would watch.
    """
    check_speed(speed)
    count = (replay.t[-1] - replay.t[0]) * fps / speed + 1
    if count > MOST_FRAMES[kind]:
        raise ValueError(
            f"speed {speed:g} and fps {fps:g} give {count:.0f} frames, more than the {MOST_FRAMES[kind]} of a {kind}; "
            "raise the speed"
        )
    return replay.tick(replay.t[0] + np.arange(int(count)) * speed / fps)


def shoot(
    scene: Scene, which: np.ndarray, width: int, height: int, *, ghost: bool = True, progress: bool = False
) -> Iterator[Image]:
    """The pictures, with captions, of the ticks ``which``; with ``progress`` a bar on stderr."""
    from jaxftc.view.caption import LEFT, Caption
    from jaxftc.view.offscreen import Canvas

    caption = Caption(scene.replay, height, ghost=ghost)
    with Canvas(scene, width, height, left=LEFT, ghost=ghost) as canvas:
        for tick in tqdm(which, unit=" frames", leave=False, disable=None if progress else True):
            scene.show(int(tick))
            yield caption.write(canvas.draw(), int(tick), scene.tool_off())


def write(path: Path, frames: Iterable[Image], fps: float) -> None:
    """Write the file whole or not at all; of a png the only frame."""
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".mp4":
            _mp4(temporary, frames, fps)
        elif path.suffix.lower() == ".gif":
            _gif(temporary, frames, fps)
        else:
            (frame,) = frames
            frame.save(temporary, format="PNG", optimize=True)


def _mp4(path: Path, frames: Iterable[Image], fps: float) -> None:
    """H.264 in yuv420p with the index in front: what every browser plays, and starts playing at once."""
    from fractions import Fraction

    import av

    frames = iter(frames)
    first = next(frames)
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000), options={"crf": "20"})
        stream.width, stream.height, stream.pix_fmt = *first.size, "yuv420p"
        for frame in itertools.chain([first], frames):
            container.mux(stream.encode(av.VideoFrame.from_image(frame)))
        container.mux(stream.encode())


def _gif(path: Path, frames: Iterable[Image], fps: float) -> None:
    """One palette for all frames, no dithering, and only what changes from frame to frame; it plays for ever.

    A gif counts hundredths of a second: frames last one more or less, so that the film keeps its length.
    """
    from PIL import Image

    from jaxftc.view.scene import COLOURS

    pictures = list(frames)
    thumbs = [np.asarray(picture)[::4, ::4].reshape(-1, 3) for picture in pictures]  # a colour may be in few frames only
    palette = Image.fromarray(np.concatenate(thumbs)[None]).quantize(GIF_COLOURS)
    lit = (1.0, 0.9, 0.8, 0.7, 0.6)  # in the legend and in the light; states are too rare to be among those
    states = [round(255 * share * part) for colour in COLOURS.values() for share in lit for part in colour[:3]]
    palette.putpalette((palette.getpalette() or [])[: 3 * GIF_COLOURS] + states)
    first, *others = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    ends = np.round(100 / fps * np.arange(1, len(pictures) + 1))
    durations = [int(10 * step) for step in np.diff(ends, prepend=0)]  # ms
    first.save(path, format="GIF", save_all=True, append_images=others, duration=durations, loop=0, optimize=False)
