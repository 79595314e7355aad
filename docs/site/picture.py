"""The picture of a report in README.md and on the first page: what `seatrial demo` wrote, as a browser shows it.

    seatrial demo --seed 1 --speed 6 --out build/demo
    python docs/site/picture.py build/demo/diagnosis/report.html

Needs Chromium; writes docs/pictures/report.png.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PICTURE = Path(__file__).parents[1] / "pictures" / "report.png"
SIZE = "1100,1040"  # CSS pixels: the answer, the errors before and after, and the effect
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def main(report: str) -> None:
    """Photograph the top of a report."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"none of {', '.join(BROWSERS)} is installed")
    with tempfile.TemporaryDirectory() as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}"]
        options += ["--virtual-time-budget=20000", f"--window-size={SIZE}", f"--screenshot={PICTURE}"]
        subprocess.run([browser, *options, Path(report).resolve().as_uri()], check=True, capture_output=True)
    print(PICTURE)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
