"""Probability that the name of an effect is right, measured on boats whose effects are known.

The studies of docs/realistic-boats.md and docs/real-boats.md count how often an effect that a diagnosis named was in
the boat. The counts of both are added, as the boats are simulated by plants of different authors. They hold for boats
with such sensors and small imperfections, and for missions of that kind.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class NameRecord:
    """How often names with the same attribution were right in the study.

    Attributes
    ----------
    named
        Number of effects with this attribution.
    right
        Number of these effects that were in the boat.
    """

    named: int
    right: int

    @property
    def probability(self) -> float:
        """Probability that the next name with this attribution is right.

        Laplace's rule of succession estimates it as (right + 1) / (named + 2).
        """
        return (self.right + 1) / (self.named + 2)


# Counts of docs/data/realistic-boats.jsonl and docs/data/real-boats.jsonl (tests/recovery/test_realistic_page.py).
NAME_RECORDS: Mapping[str, NameRecord] = {"identified": NameRecord(193, 193), "ambiguous": NameRecord(37, 27)}
