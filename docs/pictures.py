"""The pictures of README and docs, from real runs: ``python docs/pictures.py`` writes arm.gif, residuals.png, tuning.png.

Takes some minutes, a Chromium on the PATH, and ``pip install -e '.[test]'``. The performance chart has its own command,
``python -m benchmarks.chart``.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from jaxftc.io.files import atomic_path

DOCS = Path(__file__).parent
ARM = ["--speed", "0.2", "--fps", "12", "--width", "480", "--height", "360"]
COLOURS = 32  # of a picture's palette: lines on white


def main() -> None:
    """Run the commands in a folder of their own, and take the figures from the pages that they write."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run("simulate", "--engine", "chain", "--scenario", "both", "--out", folder / "run")
        with atomic_path(DOCS / "arm.gif") as gif:
            film = folder / "arm.gif"
            run("view", folder / "run", "--video", film, *ARM)
            shutil.copyfile(film, gif)
        run("demo", "--engine", "chain", "--out", folder / "demo")
        run("tune", "--seed", "0", "--held-out-seed", "1000", "--out", folder / "tune")
        photograph(folder / "demo" / "report.html", "#figure-14 .canvas", DOCS / "residuals.png")
        photograph(folder / "tune" / "report.html", "figure:first-of-type .canvas", DOCS / "tuning.png")


def run(*words: object) -> None:
    """One command of jaxftc; its output goes to the terminal."""
    subprocess.run(["jaxftc", *map(str, words)], check=True)


def photograph(page: Path, element: str, picture: Path) -> None:
    """Save what a page shows of an element, at twice its size and with few colours."""
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with sync_playwright() as play, atomic_path(picture) as temporary:
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 820, "height": 900}, device_scale_factor=2)
        tab.goto(page.resolve().as_uri())
        tab.wait_for_function("document.documentElement.dataset.drawn")
        tab.locator(element).screenshot(path=temporary, type="png")
        browser.close()
        with Image.open(temporary) as image:
            image.convert("RGB").quantize(COLOURS).save(temporary, format="PNG", optimize=True)


if __name__ == "__main__":
    main()
