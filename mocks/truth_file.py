"""Ground-truth file of a mock: its hidden effect and its true parameters, for comparison with a diagnosis."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from seatrial.mocks.plant import NONE, Bench, Boat

FORMAT = "seatrial-truth 1"


def ground_truth(world: Boat | Bench, run: int) -> dict[str, Any]:
    """Return the content of the file: the first hidden effect with its description, and all true parameters (SI)."""
    effects = world.effects if isinstance(world, Boat) else (world.effect,)
    effect = effects[0] if effects else NONE
    return {
        "format": FORMAT,
        "plant": "boat" if isinstance(world, Boat) else "bench",
        "seed": world.seed,
        "run": run,
        "effect": effect.name,
        "parameters": effect.parameters,
        "sentence": effect.sentence,
        "true_parameters": world.truth(),
    }


def write_truth(path: Path, truth: Mapping[str, Any]) -> None:
    """Write the file. Only its owner can read it (mode 0600). A failed write leaves no partial file at ``path``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.unlink(missing_ok=True)
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        json.dump(truth, file, indent=2)
        file.write("\n")
    part.replace(path)
