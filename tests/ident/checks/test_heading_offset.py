"""Tests of the angle of the heading against the motion of the boat, and of its comparison between logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.samples import Ahrs
from seatrial.ident.checks import device_faults
from seatrial.ident.checks.heading_offset import HeadingAngle, compare_headings, heading_angle
from seatrial.ident.checks.log_checks import LogChecks
from seatrial.ident.data import Channel
from seatrial.ident.data.loading import load_run
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.workflows.check import check_first
from tests.ident.checks.test_latency import ATTITUDE, SHAFTS, VELOCITY, log
from tests.missions import boat_with, channels_of, sail, write_log

POSITION = ("x", "y")


def turned(c: dict[str, Channel], degrees: float) -> dict[str, Channel]:
    """Return the signals of a log whose heading sensor is turned clockwise."""
    return c | {"psi": Channel(c["psi"].t, c["psi"].value + np.radians(degrees))}


@pytest.mark.parametrize("motion", [POSITION, VELOCITY])
@pytest.mark.parametrize("degrees", [12.0, -5.0])
def test_angle_of_a_turned_sensor_is_found(motion: tuple[str, ...], degrees: float) -> None:
    for seed in (1, 2, 3, 4):
        as_built, found = (heading_angle(turned(log(ATTITUDE, motion, SHAFTS, seed=seed), d)) for d in (0.0, degrees))
        assert as_built is not None
        assert found is not None
        assert as_built.se < 3.5
        assert abs(as_built.angle) < 3.0 * as_built.se
        assert found.angle - as_built.angle == pytest.approx(degrees, abs=1.0)


def test_a_current_and_a_late_receiver_are_no_angle() -> None:
    c = log(ATTITUDE, POSITION, SHAFTS, late=POSITION, by=0.5)
    drift = {n: Channel(c[n].t, c[n].value + speed * c[n].t) for n, speed in (("x", 0.25), ("y", -0.15))}
    found = heading_angle(c | drift)
    assert found is not None
    assert abs(found.angle) < max(4.0 * found.se, 1.0)


def test_a_log_on_one_heading_has_a_large_error_and_claims_nothing() -> None:
    """An angle and a current abeam look the same on a single heading."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 150.0, 0.1)
    speed = 1.0 + 0.02 * np.sin(0.3 * t)

    def straight(abeam: float) -> dict[str, Channel]:
        y = abeam * t + 0.02 * rng.standard_normal(t.size)
        x = np.cumsum(speed) * 0.1 + 0.02 * rng.standard_normal(t.size)
        return {"psi": Channel(t, 0.02 * rng.standard_normal(t.size)), "x": Channel(t, x), "y": Channel(t, y)}

    logs = [("a", heading_angle(straight(0.0))), ("b", heading_angle(straight(0.2)))]
    assert compare_headings(logs) == []


def test_signals_that_do_not_show_the_angle_give_none() -> None:
    c = log(ATTITUDE, POSITION, SHAFTS)
    assert heading_angle({n: x for n, x in c.items() if n != "psi"}) is None
    assert heading_angle({n: x for n, x in c.items() if n not in POSITION}) is None
    slow = {n: Channel(c[n].t[::10], c[n].value[::10]) for n in POSITION}
    assert heading_angle(c | slow) is None
    resting = {n: Channel(c[n].t, 0.0 * c[n].value) for n in POSITION}
    assert heading_angle(c | resting) is None


def test_the_log_that_differs_from_the_others_is_named_with_all_angles() -> None:
    angles = [("a", 0.1), ("b", 11.5), ("c", 12.2), ("d", 11.4)]
    ((name, finding),) = compare_headings([(n, HeadingAngle(angle, 0.5)) for n, angle in angles])
    assert (name, finding.level, finding.code) == ("a", "warning", "heading-offset-differs")
    assert (
        "a 0.1 ± 0.5 deg, b 11.5 ± 0.5 deg, c 12.2 ± 0.5 deg, d 11.4 ± 0.5 deg (clockwise, ± one standard error)"
        in finding.text
    )
    assert "--effect mount --per-log psi_mount" in finding.advice
    # Of two logs, the second differs from the first.
    ((name, _),) = compare_headings([("a", HeadingAngle(0.0, 0.5)), ("b", None), ("c", HeadingAngle(-6.0, 0.5))])
    assert name == "c"


@pytest.mark.parametrize(("difference", "se", "n"), [(2.9, 0.1, 0), (3.2, 0.1, 1), (5.0, 1.0, 0), (6.0, 1.0, 1)])
def test_difference_must_be_large_and_significant(difference: float, se: float, n: int) -> None:
    logs = [("a", HeadingAngle(1.0, se)), ("b", HeadingAngle(1.0 + difference, se))]
    assert len(compare_headings(logs)) == n


@pytest.mark.parametrize(
    ("effect", "seed"),
    [
        (None, 3),
        ("wind", 5),
        ("current-drift", 3),
        ("thrust-angle", 5),
        ("yaw-bias", 3),
        ("lever-arm", 5),
        ("mount", 3),
    ],
)
def test_equal_boats_have_equal_angles(effect: str | None, seed: int) -> None:
    boat = boat_with(effect, seed)
    angles = [heading_angle(channels_of(sail(boat, 150.0, 10 * seed + run, run)[0])) for run in (1, 2, 3)]
    assert None not in angles  # a log without an angle would be equal to all others
    assert compare_headings([(str(k), angle) for k, angle in enumerate(angles)]) == []


def test_check_and_fit_warn_of_a_sensor_that_was_turned_between_logs(tmp_path: Path) -> None:
    paths = []
    for run, degrees in ((1, 0.0), (2, 10.0), (3, 0.0)):
        recording, _ = sail(boat_with(None, 3), 200.0, 100 + run, run)
        readings = [
            r._replace(sample=replace(r.sample, yaw=r.sample.yaw + np.radians(degrees)))
            if isinstance(r.sample, Ahrs)
            else r
            for r in recording.readings
        ]
        paths.append(write_log(tmp_path / f"run{run}.mcap", "boat", readings))
    checks = LogChecks()
    for path in paths:
        checks.check(path)
    ((name, finding), *_) = checks.differences()
    assert (name, finding.code) == ("run2", "heading-offset-differs")
    assert "run1 " in finding.text
    loaded = [load_run(path, "estimation", device_faults=device_faults) for path in paths]
    checked, _ = check_first(loaded, [], horizontal_model("shaft"), False)
    codes = [[f["code"] for f in log.about["findings"]] for log in checked]
    assert ["heading-offset-differs" in c for c in codes] == [False, True, False]
