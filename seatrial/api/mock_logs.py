"""Logs of the simulated boat for the Python interface, without devices and in less than real time."""

from __future__ import annotations

from pathlib import Path

from seatrial.api.arguments import named_arguments
from seatrial.api.logs import Log, PathLike, open_log
from seatrial.api.messages import errors_of_users
from seatrial.daq.errors import SeatrialError

START = 1_750_000_000.0  # run time [s since 1970] at which a simulated log begins
STAMP_LAG = 1e-3  # s from the time of a sample to its receipt


class _StandingClock:
    """Run clock that stands still, for a recorder whose samples have their own times."""

    speed = 1.0
    origin = (0.0, START)

    def now(self) -> float:
        """Return the start time of the log [s since 1970]."""
        return START


@named_arguments
def mock_log(
    path: PathLike, seconds: float = 120.0, boat: int = 1, mission: int = 1, effect: str = "", force: bool = False
) -> Log:
    """Simulate the mock boat on a random mission, and record its log as `seatrial mission run` does on the water.

    The boat has two thrusters with telemetry of the shafts, an AHRS and GNSS: the packaged rig ``boat.toml``.

    Parameters
    ----------
    path : path
        File of the log, NAME.mcap.
    seconds : float
        Duration of the mission [s], more than 10 s.
    boat : int
        Seed of the boat: its mass, damping and current.
    mission : int
        Seed of the mission and of the noise of the sensors.
    effect : str
        Hidden effect that the models do not have, such as ``mismatch`` or ``wind``; empty: none.
    force : bool
        Whether an existing file is replaced.

    Returns
    -------
    Log
        The log.

    Raises
    ------
    SeatrialError
        If there is no such effect, if the mission is too short, or if the file exists and ``force`` is False.

    Examples
    --------
    >>> log = st.mock_log("run1.mcap", seconds=60.0, boat=5, mission=1, effect="mismatch")
    >>> st.fit(log).answer
    """
    from importlib.resources import files

    from seatrial.bench.mission_generators import make_mission
    from seatrial.daq.config import dump_mission, parse_rig
    from seatrial.daq.files import require_new
    from seatrial.daq.log import Recorder
    from seatrial.daq.samples import NAN, Ahrs, Frame
    from seatrial.mocks.hidden_effects.catalogue import make_effect
    from seatrial.mocks.offline_simulation import simulate
    from seatrial.mocks.plant import draw_boat

    if not seconds > 10.0:
        raise SeatrialError(f"seconds={seconds:g}: a mission lasts more than 10 s, of which 10 s are at rest")
    try:
        hidden = [make_effect(effect, boat)] if effect else []
    except KeyError:
        raise SeatrialError(f"there is no hidden effect {effect!r}; `seatrial mock boat --help` lists them") from None
    out = Path(path)
    with errors_of_users():
        require_new(out, force, "path")
    out.unlink(missing_ok=True)
    plan = make_mission("mixed", seconds, mission)
    t, n = plan.setpoints()
    readings = simulate(draw_boat(boat, hidden), t, n, seconds, mission).readings
    text = files("seatrial.mocks").joinpath("rigs", "boat.toml").read_text(encoding="utf-8")
    attachments = {"mission.toml": dump_mission(plan).encode()}
    recorder = Recorder(out, rig=parse_rig(text, Path("boat.toml")), clock=_StandingClock(), attachments=attachments)
    try:
        for device, sample, at in readings:
            t_device = at if isinstance(sample, Ahrs) else NAN  # the AHRS alone sends the time of its own clock
            recorder.write(device, Frame(sample, START + at + STAMP_LAG, t_device), START + at)
    finally:
        recorder.close()
    return open_log(out)
