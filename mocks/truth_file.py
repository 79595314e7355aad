"""Ground-truth file of a mock: its hidden effect and its true parameters, for comparison with a diagnosis."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from seatrial.mocks.plant import NONE, Bench, Boat

FORMAT = "seatrial-truth 1"


def ground_truth(world: Boat | Bench, run: int) -> dict[str, Any]:
    """Return the content of the ground-truth file of a boat or bench as a dict that JSON can hold.

    It has the keys "format", "plant" ("boat" or "bench"), "seed", "run", "effect" (name), "parameters" (of the effect,
    SI), "sentence" (description of the effect), "minor_effects" and "true_parameters" (of the plant, SI). Of several
    hidden effects that are not minor only the first is named. Without such an effect the name is "none".
    "minor_effects" lists the small imperfections of a realistic boat, each with "effect", "parameters" and "sentence";
    the list is empty for any other boat or bench.
    """
    effects = world.effects if isinstance(world, Boat) else ()
    minor = [e for e in effects if e.minor]
    none = replace(NONE, sentence="no large hidden effect") if minor else NONE
    effect = next((e for e in effects if not e.minor), none) if isinstance(world, Boat) else world.effect
    return {
        "format": FORMAT,
        "plant": "boat" if isinstance(world, Boat) else "bench",
        "seed": world.seed,
        "run": run,
        "effect": effect.name,
        "parameters": effect.parameters,
        "sentence": effect.sentence,
        "minor_effects": [{"effect": e.name, "parameters": e.parameters, "sentence": e.sentence} for e in minor],
        "true_parameters": world.truth(),
    }


def write_truth(path: Path, truth: Mapping[str, Any]) -> None:
    """Write the content ``truth`` of a ground-truth file to ``path`` as JSON. An existing file is replaced.

    Only the owner can read the file (mode 0600). The folder is made if it does not exist. The text is first written to
    the hidden file `.NAME.part` in the same folder, so a failed write leaves ``path`` unchanged. A failed write raises
    OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.part")
    partial.unlink(missing_ok=True)
    with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        json.dump(truth, file, indent=2)
        file.write("\n")
    partial.replace(path)
