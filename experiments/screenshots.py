"""The page of a result: its size, the time that writing and opening it takes, and its picture for the README.

Question: how large is `view.html` on the scenes of data/ and on 10,000 vertices, how soon does a browser show it, and does the
browser complain?

    python experiments/screenshots.py                                      half a minute
    python experiments/screenshots.py --pictures experiments/pictures      the same, and page.png, the pavilion's page
    python experiments/screenshots.py --size small                         the tent alone, some seconds

`opened, s`: from the request to the end of the page's load event, in headless Chromium with a software renderer, so that a
graphics card is faster. Without selenium, chromium and chromedriver those columns stay empty. Exit status 1 if a page is 10 MB or
larger, or the browser logs a word.

Finding: 0.7 to 0.9 MB on the scenes of data/, 0.6 of them the library; 2.3 MB with 10,000 vertices and 9 steps. Written in 0.02 s
(0.2 s with 10,000 vertices), opened in one to two seconds by software alone; the browser says nothing.
"""

import argparse
import io
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image
from price import bumps
from rows import print_table, write_rows

import relax

DATA = Path(__file__).parent.parent / "data"
SCENES = {"small": ("tent",), "full": ("tent", "five-masts", "scalloped", "tent-noisy", "bumps", "pavilion", "terrain")}
SIDE = 100  # of the largest page
LARGEST = 10.0  # MB
PICTURE, CHOSEN = "pavilion", 329  # the scene in page.png, and the vertex whose figures it shows
DRAWN = "setTimeout(() => requestAnimationFrame(() => requestAnimationFrame(arguments[0])), 50)"  # comes back after a picture
# a software renderer, since a test machine has no graphics card; root may not use the sandbox
OPTIONS = """--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --disable-dev-shm-usage
--hide-scrollbars --window-size=1200,720"""


@contextmanager
def browser() -> Iterator[Any]:
    """A headless Chromium, or None where something of it is missing."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    try:
        from selenium import webdriver
    except ImportError:
        webdriver = None
    if not (chromium and driver and webdriver):
        yield None
        return
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for option in OPTIONS.split():
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    window = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        window.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride", {"width": 1200, "height": 720, "deviceScaleFactor": 1, "mobile": False}
        )
        yield window
    finally:
        window.quit()


def measure(name: str, problem: relax.Problem, folder: Path, window: Any) -> dict[str, object]:
    """One row; the page lies in `folder` afterwards, and is open in the window."""
    design = relax.solve(problem)
    design.trace.stationarity  # noqa: B018 - judged once, not by the page
    path = folder / f"{name}.html"
    began = time.perf_counter()
    relax.draw_page(design, path)
    written = time.perf_counter() - began
    opened, words = None, None
    if window:
        window.get(path.as_uri())
        opened = window.execute_script("return performance.getEntriesByType('navigation')[0].loadEventEnd / 1000")
        window.execute_async_script(DRAWN)
        words = len(window.get_log("browser"))
    return {
        "scene": name,
        "vertices": problem.scene.mesh.vertices,
        "steps": len(design.trace.notes),
        "supports": len(design.supports),
        "MB": path.stat().st_size / 1e6,
        "written, s": written,
        "opened, s": opened,
        "complaints": words,
    }


def measured(size: str, pictures: Path | None) -> list[dict[str, object]]:
    """All rows; the pavilion's page as it stands in the window goes to `pictures`."""
    rows = []
    with tempfile.TemporaryDirectory() as folder, browser() as window:
        for name in SCENES[size]:
            rows.append(measure(name, relax.Problem(relax.load_scene(DATA / f"{name}.toml")), Path(folder), window))
            if pictures and window and name == PICTURE:
                window.execute_script(f"location.hash = 'vertex={CHOSEN}'")
                shoot(window, pictures / "page.png")
        if size == "full":
            rows.append(measure(f"bumps, {SIDE} x {SIDE}", bumps(SIDE), Path(folder), window))
    return rows


def shoot(window: Any, path: Path) -> None:
    """The window as a PNG of 256 colours, a third of the size of one with all of them."""
    window.execute_async_script(DRAWN)
    with Image.open(io.BytesIO(window.get_screenshot_as_png())) as image:
        image.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=list(SCENES), default="full")
    parser.add_argument("--output", type=Path, help="a CSV file for the rows")
    parser.add_argument("--pictures", type=Path, help="a folder for page.png")
    chosen = parser.parse_args()
    rows = measured(chosen.size, chosen.pictures)
    print_table(rows)
    if chosen.output:
        write_rows(chosen.output, rows)
    return 1 if any(row["MB"] >= LARGEST or row["complaints"] for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
