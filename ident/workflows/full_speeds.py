"""Comparison of the shaft speed at n = 1 on the bench and in the logs of a boat: a bench result holds for its own n."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from seatrial.daq.errors import first_names
from seatrial.ident.characterisation import load_curve
from seatrial.ident.data import LoadedLog
from seatrial.ident.estimation import load_model
from seatrial.ident.model import SHAFT_SPEED, Model, is_of_thruster
from seatrial.ident.results import ResultWarning

SAME_SPEED = 0.005  # relative difference of two full speeds that counts as rounding; the thrust differs by twice of it


def full_speed_warning(thruster: Path | None, model: Model, logs: Sequence[LoadedLog]) -> ResultWarning | None:
    """Return a warning if a shaft speed of the logs is not 1 at the speed at which that of the bench is 1.

    The thrust of the bench at n = 1 is then taken for that at another speed. The number of the log may be a guess from
    its largest shaft speed.

    Parameters
    ----------
    thruster : Path or None
        File of the bench test; None: no bench test.
    model : Model
        Model of the boat. Only shaft speeds that are its inputs are compared.
    logs : sequence of LoadedLog
        Logs of the fit.

    Returns
    -------
    ResultWarning or None
        None also if the number of the bench, or of all logs, is unknown (`full_speed_note`), and for a static thrust
        curve, which has no shaft speed.
    """
    bench, known, _ = _full_speeds(thruster, model, logs)
    other = {rpm: names for rpm, names in known.items() if bench is not None and abs(rpm / bench - 1.0) > SAME_SPEED}
    if bench is None or not other:
        return None
    listed = "; ".join(f"{rpm:.5g} rev/min ({first_names(names)})" for rpm, names in other.items())
    factors = ", ".join(f"{(bench / rpm) ** 2:.3g}" for rpm in other)
    text = (
        f"The bench result {thruster} has n = 1 at {bench:.5g} rev/min, but the logs have it at {listed}. Both must "
        "have the same speed at n = 1: otherwise the thrust of the bench is taken for that at another speed, so that "
        f"thrust, masses and damping are {factors} times their true values. Give the shaft speeds the scale "
        f"1 / {bench:.5g} in the import map (for a column in rev/min; or correct rpm_max in the rig file), and import "
        "the logs again."
    )
    return ResultWarning(code="full-speed-differs", text=text)


def full_speed_note(thruster: Path | None, model: Model, logs: Sequence[LoadedLog]) -> str:
    """Return a line that n must be 1 at the same speed on the bench and in the logs, if one of the numbers is unknown.

    The arguments are those of `full_speed_warning`. The line has the number that is known. It is empty if both numbers
    are known, or none.
    """
    bench, known, unknown = _full_speeds(thruster, model, logs)
    rule = "n must be 1 at the same shaft speed in both, as thrust and masses change with the square of it"
    if bench is not None and unknown:
        return (
            f"The bench result {thruster} has n = 1 at {bench:.5g} rev/min, and the logs do not say theirs "
            f"({first_names(unknown)}): {rule}. For a column in rev/min the scale in the import map is 1 / {bench:.5g}."
        )
    if thruster is not None and bench is None and known:
        listed = ", ".join(f"{rpm:.5g}" for rpm in known)
        return f"The logs have n = 1 at {listed} rev/min, and the bench result {thruster} does not say its own: {rule}."
    return ""


def _full_speeds(
    thruster: Path | None, model: Model, logs: Sequence[LoadedLog]
) -> tuple[float | None, dict[float, list[str]], list[str]]:
    """Return the shaft speed [rev/min] at n = 1 on the bench, and the shaft speeds of the logs.

    The second result has the names of the signals and logs by their speed at n = 1, and the third those of which it is
    unknown. Without a bench test of a shaft speed, or if the model has other inputs, all are empty.
    """
    names = dict.fromkeys(i.tap_of or i.name for i in model.inputs if is_of_thruster(i.tap_of or i.name, SHAFT_SPEED))
    if thruster is None or not names or load_curve(thruster) is not None:
        return None, {}, []
    known, unknown = dict[float, list[str]](), list[str]()
    for log in logs:
        for name in (n for n in names if n in log.run.channels):
            rpm = log.rpm_max.get(name)
            (unknown if rpm is None else known.setdefault(rpm, [])).append(f"{name} of {log.run.name}")
    return load_model(thruster).rpm_max, known, unknown
