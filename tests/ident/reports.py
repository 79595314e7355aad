"""A reporter that keeps what it was told."""

from __future__ import annotations


class Kept:
    """Lines of progress and warnings, in order."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.warnings: list[str] = []

    def progress(self, text: str) -> None:
        self.lines.append(text)

    def warning(self, text: str) -> None:
        self.warnings.append(text)
