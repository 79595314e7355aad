"""Formats of an export by the programs that users name in place of a format.

The module imports nothing, so that the command line can use it before a command runs.
"""

PROGRAMS = {
    **dict.fromkeys(("simulink", "matlab", "modelica", "openmodelica", "fmi", "fmpy"), "fmu"),
    **dict.fromkeys(("cpp", "c++", "arduino"), "c"),
    **dict.fromkeys(("ros", "yaml"), "ros2"),
    **dict.fromkeys(("numpy", "py"), "python"),
    **dict.fromkeys(("gz", "sdf"), "gazebo"),
}
FMU = "FMI 2.0 co-simulation, for Simulink, OpenModelica and others"
MATLAB = "a linear model for MATLAB is `st.linearise(MODEL, SPEED).to_mat(FILE)` in Python"


def described_format(target: str, program: str = "") -> str:
    """Return a format in quotes, for an error message. Behind an FMU is its purpose, in brackets.

    With ``matlab`` as the program that the user named, the linear model for MATLAB is in the brackets, too.
    """
    if target != "fmu":
        return repr(target)
    return f"'fmu' ({FMU}{f'; {MATLAB}' if program == 'matlab' else ''})"


FORMATS_OF_PROGRAMS = {program: described_format(target, program) for program, target in PROGRAMS.items()}
