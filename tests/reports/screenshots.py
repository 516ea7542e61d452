"""Pictures of pages in the documentation: ``python -m tests.reports.screenshots`` writes them into docs/images."""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from tests.browser import LEFT_OUT, Browser, find_browser

ROOT = Path(__file__).resolve().parents[2]
FIELD = ["examples/field/sensors.geojson", "--uavs", "2", "--station", "46.1012,7.2210", "--radio", "802.15.4"]
# Picture -> page, slot, and how the window is: width, height, dark, phone.
PAGES = {
    "replay": ("docs/gallery/paper.html", 160, (1400, 1000, False, False)),
    "replay-phone": ("docs/gallery/hundred-devices.html", 160, (390, 844, True, True)),
}
OWN_FIELD = (60, (1200, 760, False, False))


def take(browser: Browser, page: Path, slot: int, window: tuple[int, int, bool, bool], picture: Path) -> None:
    """Write what a page shows in a slot."""
    width, height, dark, phone = window
    browser.open(page, width, height, dark=dark, still=True, phone=phone, dense=2)
    browser.value(f"replay.seek({slot})")
    browser.screenshot(picture)
    Image.open(picture).convert("RGB").quantize(256).save(picture, optimize=True)  # a third of the size


def main() -> None:
    """Take all pictures."""
    executable = find_browser()
    if executable is None:
        sys.exit(LEFT_OUT)
    images = ROOT / "docs" / "images"
    with TemporaryDirectory() as place:
        out = Path(place) / "field"
        command = [sys.executable, "-m", "uavaou", "fly", *FIELD, "--quiet", "--out", str(out)]
        subprocess.run(command, cwd=ROOT, check=True)
        browser = Browser(executable, Path(place) / "profile")
        for name, (page, slot, window) in PAGES.items():
            take(browser, ROOT / page, slot, window, images / f"{name}.png")
        take(browser, out / "mission-10000.html", *OWN_FIELD, images / "own-field.png")
        browser.close()


if __name__ == "__main__":
    main()
