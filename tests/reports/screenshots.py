"""Pictures of pages in the documentation: ``python -m tests.reports.screenshots`` writes them into docs/images."""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from tests.browser import LEFT_OUT, Browser, find_browser
from tests.documents import blocks, console

ROOT = Path(__file__).resolve().parents[2]
FIELD = ["examples/field/sensors.geojson", "--uavs", "2", "--station", "46.1012,7.2210", "--radio", "802.15.4"]
# A rehearsal may find two policies that fly alike, by the load of the machine.
FIELD += ["--policy", "local-greedy-parts"]
# Picture -> page, slot, and how the window is: width, height, dark, phone.
PAGES = {
    "replay": ("docs/gallery/paper.html", 160, (1400, 1000, False, False)),
    "replay-phone": ("docs/gallery/hundred-devices.html", 160, (390, 844, True, True)),
}
DAY = (2281, (1200, 900, False, False))  # of docs/how-to/operate.md
OWN_FIELD = (60, (1200, 760, False, False))


def take(browser: Browser, page: Path, slot: int, window: tuple[int, int, bool, bool], picture: Path) -> None:
    """Write what a page shows in a slot."""
    width, height, dark, phone = window
    browser.open(page, width, height, dark=dark, still=True, phone=phone, dense=2)
    browser.value(f"replay.seek({slot})")
    browser.screenshot(picture)
    Image.open(picture).convert("RGB").quantize(256).save(picture, optimize=True)  # a third of the size


def fly_a_day(place: Path) -> Path:
    """Follow docs/how-to/operate.md up to the flight; returns its page."""
    page = ROOT / "docs" / "how-to" / "operate.md"
    imported, _, flown, *_ = (line.partition("#")[0].split()[1:] for line in console(page))
    command = [sys.executable, "-m", "uavaou", *imported[:-1], str(place / "day-field")]
    subprocess.run(command, cwd=ROOT / "examples" / "field", check=True)
    with open(place / "day-field" / "scenario.yaml", "a", encoding="utf-8") as file:
        file.write(blocks(page, "yaml")[0])
    told = ["day-field/scenario.yaml" if word == "field/scenario.yaml" else word for word in flown]
    subprocess.run([sys.executable, "-m", "uavaou", *told, "--quiet"], cwd=place, check=True)
    return place / "day" / "mission-10000.html"


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
        day = fly_a_day(Path(place))
        take(browser, day, *DAY, images / "a-day.png")
        take(browser, out / "mission-10000.html", *OWN_FIELD, images / "own-field.png")
        browser.close()


if __name__ == "__main__":
    main()
