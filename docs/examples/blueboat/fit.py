"""The fit in per cent of a result.json on the runs that no fit has seen: 100 (1 - error / spread), simulated."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any


def percent(row: dict[str, Any], key: str) -> float | None:
    """100 for no error, 0 for one as large as the spread of what was measured."""
    return None if row[key] is None else 100.0 * (1.0 - row[key] / row["spread"])


def main() -> None:
    path = Path(sys.argv[1])
    rows = json.loads(path.read_text(encoding="utf-8"))["errors"]["validation"]["simulation"]
    for name in ("u", "v", "r"):
        before, after = percent(rows[name], "before"), percent(rows[name], "after")
        said = f"{after:6.1f} %" if before is None else f"{before:6.1f} % before, {after:6.1f} % after"
        print(f"{path.parent.name:<10} {name}  {said}")


if __name__ == "__main__":
    main()
