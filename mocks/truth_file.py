"""The sealed file: what a mock did, for the moment when somebody wants to know."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mocks.plant import NONE, Bench, Boat

FORMAT = "seatrial-sealed 1"


def ground_truth(world: Boat | Bench, run: int) -> dict[str, Any]:
    """What the file says: the effect, its parameters and a sentence on it, and the true parameters (SI)."""
    effects = world.effects if isinstance(world, Boat) else (world.effect,)
    told = effects[0] if effects else NONE
    return {
        "format": FORMAT,
        "plant": "boat" if isinstance(world, Boat) else "bench",
        "seed": world.seed,
        "run": run,
        "effect": told.name,
        "parameters": told.parameters,
        "sentence": told.sentence,
        "true_parameters": world.truth(),
    }


def write_truth(path: Path, told: Mapping[str, Any]) -> None:
    """Write the file, for its owner's eyes only (mode 0600), whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.unlink(missing_ok=True)
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        json.dump(told, file, indent=2)
        file.write("\n")
    part.replace(path)
