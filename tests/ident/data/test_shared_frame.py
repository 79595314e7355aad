"""Tests of the common origin of the logs of one command, so that a fixed point has one position in all logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest
import scipy.io

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.samples import Ahrs, Esc, Gnss
from seatrial.ident.data.loading import FrameOrigin, LoadedLog, load_all, load_run, share_frame
from seatrial.ident.data.record import LogSegment, make_record
from seatrial.ident.diagnosis.search import _untestable_candidates
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.fitted_model import FittedModel, fit_nominal_model, nominal_model
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.model_file import FittedData, load_model, save_model
from seatrial.ident.estimation.prior_knowledge import with_effects
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.answers import frames_assumed
from seatrial.ident.workflows.model_inputs import require_one_frame, saved_frame_warnings
from seatrial.mocks.sensors import LATITUDE, LONGITUDE, geodetic
from seatrial.mocks.world import Reading
from tests.ident.effects.independent_boat import Force, IndependentBoat, sail
from tests.ident.effects.test_weak_effects import line, model_of, spring
from tests.missions import RPM_MAX, write_log

pytestmark = pytest.mark.usefixtures("quick_compilation")

APART = (22.0, -17.0)  # Distance [m] north and east between the first fixes of two missions from one pier.
POINT = (8.0, -6.0)  # Position [m] of the anchor from the start of the first log.


def written(path: Path, segment: LogSegment, at: tuple[float, float] = (0.0, 0.0)) -> Path:
    """Write the segment as a log of the simulated rig. Its start is at the given place (m north, m east)."""
    c, readings = segment.channels, list[Reading]()
    for k, t in enumerate(c["psi"].t.tolist()):
        psi, r, ax, ay = (float(c[n].value[k]) for n in ("psi", "r", "ax", "ay"))
        readings.append(Reading("ahrs", Ahrs(psi, 0.0, 0.0, 0.0, 0.0, r, ax, ay, -9.81), t))
        for node, side in ((1, "left"), (2, "right")):
            readings.append(Reading("esc", Esc(node, rpm=RPM_MAX * float(c[f"n_{side}"].value[k])), t))
    for k, t in enumerate(c["x"].t.tolist()):
        x, y, vx, vy = (float(c[n].value[k]) for n in ("x", "y", "vx", "vy"))
        lat, lon = geodetic(x + at[0], y + at[1])
        readings.append(Reading("gnss", Gnss(t, lat, lon, vel_n=vx, vel_e=vy, fix=3), t))
    return write_log(path, "boat", sorted(readings, key=lambda reading: reading.t))


def two_logs(folder: Path, force: Callable[[float, float], Force], seconds: float) -> list[LoadedLog]:
    """Return two missions of one boat on one line. ``force(north, east)`` gives the force of a line anchored there."""
    paths = []
    for k, at in enumerate(((0.0, 0.0), APART)):
        fast = (POINT[0] - at[0], POINT[1] - at[1])  # The anchor relative to the start of this log.
        segment = sail(IndependentBoat(force=force(*fast)), seconds, 11 + k)
        paths.append(written(folder / f"mission{k}.mcap", segment, at))
    return load_all(paths, [])[0]


def fitted(logs: list[LoadedLog], effect: str) -> FittedModel:
    model = with_effects(model_of(IndependentBoat()), [effect])
    return fit_nominal_model(model, [log.run for log in logs], [])


@cache
def short() -> LogSegment:
    return replace(sail(IndependentBoat(), 30.0, 3), name="short")


def placed(tmp_path: Path, *places: tuple[float, float]) -> list[Path]:
    return [written(tmp_path / f"log{k}.mcap", short(), at) for k, at in enumerate(places)]


@pytest.mark.slow
@pytest.mark.parametrize("effect", [pytest.param(name, marks=pytest.mark.study) for name in ("tether", "mooring")])
def test_fixed_point_has_one_position_in_two_logs_from_one_pier(effect: str, tmp_path: Path) -> None:
    stiff = 0.9

    def force(north: float, east: float) -> Force:
        return line(0.08, north, east) if effect == "tether" else spring(stiff, 6.0, north, east)

    logs = two_logs(tmp_path, force, 150.0)
    fit = fitted(logs, effect).fit
    names = ("x_tether", "y_tether") if effect == "tether" else ("F_mx", "F_my")
    for name, metres in zip(names, POINT, strict=True):
        value, error = fit.estimate(name)
        truth = metres * (1.0 if effect == "tether" else stiff)
        assert value == pytest.approx(truth, abs=3 * error), name
        assert error < 2.0, name


def test_logs_of_one_command_use_the_first_fix_of_the_first_log(tmp_path: Path) -> None:
    paths = placed(tmp_path, (0.0, 0.0), APART, (5000.0, -3000.0))
    alone = [load_run(p, "estimation") for p in paths]
    estimation, validation = load_all(paths[:1], paths[1:])
    assert all(shared.origin == estimation[0].origin for shared in validation)
    assert np.array_equal(estimation[0].run.channels["x"].value, alone[0].run.channels["x"].value)
    for shared, own, at in zip(validation, alone[1:], (APART, (5000.0, -3000.0)), strict=True):
        moved = [float(shared.run.channels[n].value[0] - own.run.channels[n].value[0]) for n in ("x", "y")]
        assert moved == pytest.approx(at, abs=0.1 if at is APART else 2.0)  # The simulator has a flat earth.
        for n in ("x", "y"):  # The track has the same length.
            there, here = shared.run.channels[n].value, own.run.channels[n].value
            assert there - there[0] == pytest.approx(here - here[0], abs=1e-9)
            assert shared.own_channels[n].value == pytest.approx(here, abs=1e-9)
        assert shared.about["origin"] == msgspec.structs.asdict(estimation[0].origin)
    origin = estimation[0].origin
    assert origin is not None
    assert origin.log == "log0"
    assert (origin.latitude, origin.longitude) == pytest.approx((LATITUDE, LONGITUDE), abs=1e-5)


def test_part_of_a_log_without_fixes_has_the_common_origin_too(tmp_path: Path) -> None:
    """After a gap of the log, the receiver may have no fix any more."""
    (first,) = placed(tmp_path, (0.0, 0.0))
    again = replace(short(), channels={n: replace(c, t=c.t + 1000.0) for n, c in short().channels.items()})
    path, both = tmp_path / "cut.mcap", short().channels
    joined = {
        n: c if n in ("x", "y", "vx", "vy") else replace(c, t=np.r_[c.t, d.t], value=np.r_[c.value, d.value])
        for (n, c), d in zip(both.items(), again.channels.values(), strict=True)
    }
    written(path, replace(short(), channels=joined), APART)
    with pytest.warns(SeatrialWarning, match="the log is cut there"):
        _, (before, after) = load_all([first], [path])
    assert before.origin == after.origin
    assert before.shift == after.shift != (0.0, 0.0)
    assert "x" in before.own_channels
    assert "x" not in after.own_channels


def test_origin_at_another_place_does_not_change_a_fit(tmp_path: Path) -> None:
    """The state starts at the first position. Only a fixed point depends on the origin."""
    model, (path,) = nominal_model(horizontal_model()), placed(tmp_path, (0.0, 0.0))
    loaded = load_run(path, "estimation")
    assert loaded.origin is not None
    far = FrameOrigin(loaded.origin.latitude + 0.05, loaded.origin.longitude - 0.05, "another")
    values = np.array([p.value for p in model.parameters])
    here, there = (
        Likelihood(model).value_by_row(make_record(model, x.run, 10.0), values)
        for x in (loaded, *share_frame([loaded], far))
    )
    assert there.sum() == pytest.approx(here.sum(), rel=1e-9)
    assert there == pytest.approx(here, abs=1e-6)


def test_offsets_are_antisymmetric_and_cross_the_date_line() -> None:
    a, b = FrameOrigin(60.0, 179.99), FrameOrigin(60.05, -179.98)
    there, back = a.offset(b), b.offset(a)
    assert there == pytest.approx((5571.0, 1671.0), abs=5.0)
    assert there == pytest.approx([-z for z in back], abs=1e-6)


def test_distant_logs_keep_their_own_origins_and_reject_a_common_point(tmp_path: Path) -> None:
    logs, _ = load_all(placed(tmp_path, (0.0, 0.0), (11_000.0, 0.0)), [])
    assert [log.origin.log for log in logs if log.origin] == ["log0", "log1"]
    plain, moored = horizontal_model(), horizontal_model() + catalogue()["mooring"]
    require_one_frame(plain, logs)
    with pytest.raises(SeatrialError, match="more than 10 km from the first fix of log0, but mooring has one position"):
        require_one_frame(moored, logs)
    untested = _untestable_candidates(nominal_model(plain), catalogue(), [log.run for log in logs])
    assert sorted(u.effect.name for u in untested) == ["bank", "mooring", "shallow-water", "tether"]
    assert "fixed point over ground" in untested[0].reason
    assert not _untestable_candidates(nominal_model(plain), catalogue(), [logs[0].run])


def test_positions_without_latitude_and_longitude_are_assumed_in_one_frame_with_a_warning(tmp_path: Path) -> None:
    (path,) = placed(tmp_path, (0.0, 0.0))
    known = load_run(path, "estimation")
    unknown = replace(known, origin=None, run=replace(known.run, name="imported", meta={}))
    boat, alone = with_effects(model_of(IndependentBoat()), ["mooring"]), unknown.run
    assert frames_assumed(fit_nominal_model(boat, [alone], [])) == []  # A single log has one frame.
    assert frames_assumed(fit_nominal_model(boat, [known.run], [replace(known.run, name="later")])) == []
    (warning,) = frames_assumed(fit_nominal_model(boat, [known.run], [alone]))
    assert warning.code == "frame-assumed"
    assert "imported gives x and y without latitude and longitude" in warning.text
    assert not share_frame([unknown])[0].origin


def test_saved_model_keeps_the_origin_of_its_fixed_point(tmp_path: Path) -> None:
    logs, _ = load_all(placed(tmp_path, (0.0, 0.0), (40.0, 10.0), (30_000.0, 0.0)), [])
    moored = with_effects(model_of(IndependentBoat()), ["mooring"])
    fit = fit_nominal_model(moored, [logs[0].run], []).fit
    path, origin = tmp_path / "model.toml", logs[0].origin
    save_model(path, fit, data=FittedData(origin=origin), provenance={})
    saved = load_model(path)
    assert saved.origin == origin
    (later,) = share_frame([load_run(tmp_path / "log1.mcap", "navigated")], saved.origin)
    assert later.run.channels["x"].value[0] == pytest.approx(40.0, abs=0.2)
    assert saved_frame_warnings(saved.model, [later], saved.origin) == []
    (warning,) = saved_frame_warnings(saved.model, [later], None)
    assert (warning.code, "does not contain the origin" in warning.text) == ("frame-assumed", True)
    with pytest.raises(SeatrialError, match=r"log2\.mcap: the log begins more than 10 km"):
        saved_frame_warnings(saved.model, [load_run(tmp_path / "log2.mcap", "navigated")], saved.origin)
    plain = fit_nominal_model(model_of(IndependentBoat()), [logs[0].run], []).fit
    save_model(path, plain, data=FittedData(origin=origin), provenance={})
    assert load_model(path).origin is None  # No parameter depends on the origin.


def matlab_log(folder: Path, name: str, at: tuple[float, float], keys: str = "") -> Path:
    """Import a .mat with latitude and longitude, of a boat that moves east from the place ``at`` (m north, m east)."""
    t = 1.7e9 + np.arange(0.0, 20.0, 0.1)
    lat, lon = np.transpose([geodetic(at[0], at[1] + s) for s in t - t[0]])
    gnss = {"time": t, "lat": lat, "lon": lon}
    scipy.io.savemat(folder / f"{name}.mat", {"log": {"gnss": gnss, "cmd": {"time": t, "n": np.sin(t)}}})
    columns = 'topic = "log", fields = ["gnss.lat", "gnss.lon"]'
    map_file = folder / f"{name}.toml"
    map_file.write_text(
        'format = "seatrial-import 1"\ntime = { column = "gnss.time" }\nsignal = [\n'
        f'{{ name = "x", make = "north", {columns}{keys} }},\n{{ name = "y", make = "east", {columns}{keys} }},\n'
        '{ name = "n", topic = "log", field = "cmd.n", unit = "1", time = "cmd.time", role = "input" },\n]\n'
    )
    return import_files(map_file, [folder / f"{name}.mat"], out_dir=folder)[0]


def test_imported_positions_of_two_matlab_files_are_moved_to_one_origin(tmp_path: Path) -> None:
    paths = [matlab_log(tmp_path, f"run{k}", at) for k, at in enumerate(((0.0, 0.0), APART))]
    first, second = load_all(paths, [])[0]
    assert first.origin == second.origin == FrameOrigin(LATITUDE, LONGITUDE, "run0")
    assert (first.unplaced, second.unplaced) == (False, False)
    assert [float(first.run.channels[n].value[0]) for n in ("x", "y")] == [0.0, 0.0]
    assert [float(second.run.channels[n].value[0]) for n in ("x", "y")] == pytest.approx(APART, abs=0.1)
    assert second.run.meta["origin"] == first.origin  # A fit warns only of records without it.


def test_imported_positions_that_the_map_shifts_have_no_known_origin(tmp_path: Path) -> None:
    log = load_run(matlab_log(tmp_path, "run", (0.0, 0.0), ", offset = 3.0"), "estimation")
    assert log.unplaced
