"""A reporter for tests that keeps its messages."""

from __future__ import annotations


class Kept:
    """Reporter that keeps the lines of progress, their details and the warnings in order."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.details: list[str] = []
        self.warnings: list[str] = []

    def progress(self, text: str, times: object = None) -> None:
        self.lines.append(text)

    def detail(self, text: str) -> None:
        self.details.append(text)

    def warning(self, text: str) -> None:
        self.warnings.append(text)
