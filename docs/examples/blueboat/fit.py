"""Fit of a result.json in per cent on the validation runs: 100 (1 - error / spread) of the simulation."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any


def percent(row: dict[str, Any], key: str) -> float | None:
    """Return the fit in per cent: 100 without an error, 0 for an error as large as the spread of the measurements.

    None is returned if the result has no error under ``key``.
    """
    return None if row[key] is None else 100.0 * (1.0 - row[key] / row["spread"])


def main() -> None:
    """Print the fit of surge, sway and yaw rate, before and after a diagnosis."""
    path = Path(sys.argv[1])
    rows = json.loads(path.read_text(encoding="utf-8"))["errors"]["validation"]["simulation"]
    for name in ("u", "v", "r"):
        before, after = percent(rows[name], "before"), percent(rows[name], "after")
        text = f"{after:6.1f} %" if before is None else f"{before:6.1f} % before, {after:6.1f} % after"
        print(f"{path.parent.name:<10} {name}  {text}")


if __name__ == "__main__":
    main()
