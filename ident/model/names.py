"""Composed names: the one place that makes them. Nothing takes a name apart; what it is made of stands in types."""

from __future__ import annotations


def segment_name(name: str, segment: int | None) -> str:
    """``V_x@0``: a parameter that each segment of data has for itself; ``m_u``: one that all share (None)."""
    return name if segment is None else f"{name}@{segment}"


def tap_name(name: str, tap: int) -> str:
    """``n_left~3``: the input ``n_left`` that many steps ago; ``n_left`` itself for none."""
    return f"{name}~{tap}" if tap else name
