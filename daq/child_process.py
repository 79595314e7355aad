"""Command line and environment of child processes, in which no module of the working folder is imported.

`python -m` puts the working folder first on the module path. A file `socket.py` in that folder would then replace
Python's own module. The option -P keeps the folder off the path.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module of seatrial as a program, with the Python interpreter of this process.

    Parameters
    ----------
    module : str
        Full name of the module, such as "seatrial.daq.acquisition.watchdog".
    arguments : str
        Command-line arguments for the module.

    Returns
    -------
    list of str
        Program and arguments, for `subprocess.Popen`. Modules in the working folder are not imported (option -P).
    """
    return [sys.executable, "-P", "-m", module, *arguments]


def module_environment() -> dict[str, str]:
    """Return environment variables for a child process that runs a `module_command` from any working folder.

    They are those of this process, with the folder that contains the package seatrial first in PYTHONPATH. Empty and
    relative entries of PYTHONPATH are left out, because they refer to the working folder.
    """
    # Not the folder of `daq`: in an installation it is in the package, and its modules would become top-level names.
    here = str(Path(sys.modules[__name__.partition(".")[0]].__path__[0]).resolve().parent)
    before = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    return {**os.environ, "PYTHONPATH": os.pathsep.join([here, *filter(os.path.isabs, before)])}
