"""Screenshot of a report for README.md and the first page of the documentation.

The report is written by `seatrial demo`:

    seatrial demo --seed 1 --speed 6 --out build/demo
    python docs/site/picture.py build/demo/diagnosis/report.html

The script needs Chromium and writes docs/pictures/report.png.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PICTURE = Path(__file__).parents[1] / "pictures" / "report.png"
SIZE = "1100,1040"  # CSS pixels; the picture shows the answer, the errors before and after, and the effect
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def main(report: str) -> None:
    """Write the screenshot of the top of a report."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"no browser found: install one of {', '.join(BROWSERS)}")
    with tempfile.TemporaryDirectory() as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}"]
        options += ["--virtual-time-budget=20000", f"--window-size={SIZE}", f"--screenshot={PICTURE}"]
        subprocess.run([browser, *options, Path(report).resolve().as_uri()], check=True, capture_output=True)
    print(PICTURE)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
