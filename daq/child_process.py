"""Command line and environment of child processes: Python modules of this program, and none of the working folder.

`python -m` puts the working folder first on the path of modules. A `socket.py` that lies there would then be executed
in the place of Python's own. Option -P keeps the folder off the path.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path


def module_command(module: str, *words: str) -> list[str]:
    """Return the command line that runs a module of this program with these arguments."""
    return [sys.executable, "-P", "-m", module, *words]


def module_environment() -> dict[str, str]:
    """Return the environment in which `module_command` finds this program from any working folder.

    Entries of PYTHONPATH that are empty or relative mean the working folder or a folder in it. They are left out.
    """
    here = str(Path(__file__).resolve().parent.parent)
    before = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    return {**os.environ, "PYTHONPATH": os.pathsep.join([here, *filter(os.path.isabs, before)])}
