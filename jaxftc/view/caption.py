"""What is written on a picture: time, what is wrong, and for each joint the fault it has and what was said of it."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jaxftc.types import KINDS, Verdict
from jaxftc.view.replay import HEALTHY, STATES, Replay
from jaxftc.view.scene import COLOURS, GHOST

LEFT = 0.34  # share of the width that the table takes
INK, PALE = (34, 34, 40), (118, 122, 130)


class Caption:
    """Writes on pictures of one size and one replay."""

    def __init__(self, replay: Replay, height: int, *, ghost: bool) -> None:
        """For pictures ``height`` pixels high; ``ghost`` says whether the legend has the ghost."""
        self._replay, self._truth, self._states, self._ghost = replay, replay.truth, replay.states, ghost
        self._size = max(9.0, height / 30)
        self._font, self._large = (ImageFont.load_default(k * self._size) for k in (1.0, 1.5))
        self._names = [name if len(name) <= 10 else name[:9] + "." for name in replay.joints]
        widths = [max(self._font.getlength(word) for word in words) for words in (self._names, KINDS)]
        self._columns = np.cumsum([2.1 * self._size, *(width + self._size for width in widths)]).tolist()  # pixels

    def write(self, pixels: np.ndarray, tick: int, off: float) -> Image.Image:
        """The picture [height, width, 3] with its caption; ``off`` is the tool's distance from the reference in m."""
        image = Image.fromarray(pixels)
        draw, s = ImageDraw.Draw(image), self._size
        now = Verdict(np.bitwise_or.reduce(self._truth[tick]))
        draw.text((s, 0.6 * s), f"{self._replay.t[tick]:.3f} s", INK, self._large)
        draw.text((s, 2.6 * s), f"fault now: {now.label if now else 'none'}", INK, self._font)
        draw.text((s, 3.9 * s), f"tool off reference: {1e3 * off:.1f} mm", INK, self._font)
        y = 6.0 * s
        for x, word in zip(self._columns, ("", "fault", "verdict"), strict=True):
            draw.text((x, y), word, PALE, self._font)
        for j, name in enumerate(self._names):
            y += 1.35 * s
            words = (name, *(Verdict(v[tick, j]).label for v in (self._truth, self._replay.verdict)))
            self._mark(draw, s, y, int(self._states[tick, j]))
            for x, word in zip(self._columns, words, strict=True):
                quiet = word == Verdict.NORMAL.label
                draw.text((x, y), "-" if quiet else word, PALE if quiet else INK, self._font)
        self._legend(draw, image.height)
        return image

    def _legend(self, draw: ImageDraw.ImageDraw, height: int) -> None:
        s, y = self._size, height - 1.9 * self._size
        entries = [(state, STATES[state]) for state in COLOURS]
        x = s
        for state, word in entries:
            self._mark(draw, x, y, state)
            draw.text((x + 1.1 * s, y), word, INK, self._font)
            x += 2.2 * s + draw.textlength(word, self._font)
        if self._ghost:
            shade = tuple(round(255 * (c * GHOST[3] + 1 - GHOST[3])) for c in GHOST[:3])
            draw.rectangle((x, y + 0.2 * s, x + 0.75 * s, y + 0.95 * s), shade)
            draw.text((x + 1.1 * s, y), "ghost: reference", INK, self._font)

    def _mark(self, draw: ImageDraw.ImageDraw, x: float, y: float, state: int) -> None:
        if state != HEALTHY:
            colour = tuple(round(255 * c) for c in COLOURS[state][:3])
            draw.rectangle((x, y + 0.2 * self._size, x + 0.75 * self._size, y + 0.95 * self._size), colour)
