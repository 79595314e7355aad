"""Provenance of a log: operator, computer, software versions and command line, as texts for its metadata.

Each segment of a log begins with these texts.
"""

from __future__ import annotations

import getpass
import platform
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("seatrial", "mcap", "numpy", "pyserial", "python-can", "zstandard")


@cache
def git_hash() -> str:
    """Return the git commit of the running source code, 40 hexadecimal digits, for the metadata of a log.

    The suffix `-dirty` marks uncommitted changes of files that git tracks. The result is "none" if the folder above
    `daq` is not the top of a git repository, and if git fails or takes more than 5 s. It is computed once for each
    process.
    """
    folder = Path(__file__).resolve().parents[1]
    if not (folder.parent / ".git").exists():
        return "none"
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        completed = subprocess.run(command, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return "none"
    return completed.stdout.strip()


def _version(package: str) -> str:
    """Return the version of an installed package, for the metadata of a log; "none" if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _operator() -> str:
    """Return the login name of the user who records a log; "unknown" if the system has none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "unknown"


# Names of the metadata of an imported log whose values are those of the import, not of the recording.
OF_IMPORT = {"operator": "imported_by", "host": "imported_on", "started": "imported_at"}


def collect_provenance(imported: bool = False) -> dict[str, str]:
    """Return the provenance (origin) of a log for its metadata, as texts by name.

    It consists of git commit ("git"), host, operating system ("platform"), Python version, operator, present time in
    UTC ("started"), command line of this process, and package versions ("version.numpy" and others; "none" if missing).
    If the log is imported, nobody knows who recorded it: operator, host and time have the names "imported_by",
    "imported_on" and "imported_at".
    """
    found = {
        "git": git_hash(),
        "host": platform.node(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "operator": _operator(),
        "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "command_line": " ".join(sys.argv),
        **{f"version.{package}": _version(package) for package in _PACKAGES},
    }
    return {OF_IMPORT.get(name, name): text for name, text in found.items()} if imported else found
