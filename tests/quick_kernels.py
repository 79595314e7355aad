"""Environment of child processes that compile kernels quickly, as the fixture `quick_compilation` does in this one."""

from __future__ import annotations

import os
from pathlib import Path

# Python imports the module of this name at its start. Other commands than fits do not load the compiler.
_START = """
import sys
if "ident" in sys.orig_argv or {every}:
    from seatrial.ident.engine import jit
    quick = jit.quick_compilation(0)
    quick.__enter__()
"""


def quick_environment(folder: Path, every: bool = False) -> dict[str, str]:
    """Return environment variables with which `seatrial ident` compiles kernels quickly, with less optimisation.

    A module for it is written into the new folder ``folder``. ``every``: every other Python program does so, too.
    """
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(_START.format(every=every), encoding="utf-8")
    paths = [str(folder), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
