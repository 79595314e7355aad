"""Prediction errors 10 s ahead on the validation run, for three models.

    python compare.py DIAGNOSIS/result.json TRUTH/result.json

The models are the standard model, the same model with the effects of the diagnosis, and the model with the equations of
the simulator. The script prints the RMS error of each channel, and the geometric mean of the ratios over all channels,
as in the reports.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np


def ahead(path: str) -> dict[str, dict[str, Any]]:
    """Return the prediction errors over the horizon on the validation run, by channel."""
    found: dict[str, dict[str, Any]] = json.loads(Path(path).read_text(encoding="utf-8"))["errors"]["validation"]
    return found["horizon"]


def main() -> None:
    """Print the table of errors."""
    found, true = (ahead(path) for path in sys.argv[1:])
    print(f"{'10 s ahead':<12}{'standard':>10}{'found':>10}{'true':>10}   found/true")
    ratios = []
    for name, row in found.items():
        before, after, by_truth = row["before"], row["after"], true[name]["after"]
        ratios.append(after / by_truth)
        scale, unit = (
            (np.degrees(1.0), row["unit"].replace("rad", "deg")) if "rad" in row["unit"] else (1.0, row["unit"])
        )
        print(f"{name + ' ' + unit:<12}" + "".join(f"{scale * x:10.3f}" for x in (before, after, by_truth)), end="")
        print(f"   {ratios[-1]:8.3f}")
    print(f"all channels, geometric mean of found/true: {np.exp(np.mean(np.log(ratios))):.3f}")


if __name__ == "__main__":
    main()
