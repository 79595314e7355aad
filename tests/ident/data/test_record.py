"""Rows for a model from channels: block means, holds, gaps, masks, an input's past, work done, and clear refusals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import (
    WORK_UNIT,
    Channel,
    Record,
    _block_edges,
    block_mean,
    build_record,
    held_lines,
    sample_and_hold,
)
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import HISTORY_STEP, Effect, Input, Model, Output, Sensor, State, plain_model
from seatrial.ident.results.answers import cut_records


def model(hold: str = "zero", feels: str = "") -> Model:
    """One input, an angle and a pair that arrives together; ``feels``: the output that has the input in it."""
    return plain_model(
        "cart",
        f=lambda x, u, p: {"s": u.w},
        h=lambda x, u, p: {n: u.w if n == feels else x.s for n in ("psi", "a", "b")},
        states=(State("s"),),
        inputs=(Input("w", "N", hold),),  # type: ignore[arg-type]
        sensors=(
            Sensor("compass", (Output("psi", "rad", "e", angle=True),)),
            Sensor("pair", (Output("a", "m", "e"), Output("b", "m", "e"))),
        ),
        parameters=(Parameter("e", 0.1),),
    )


def with_inputs(*names: str) -> Model:
    return model() + Effect("more", "more", {}, inputs=tuple(Input(n, "", "linear") for n in names))


def with_taps(*taps: int) -> Model:
    """With an input g, as it was so many steps ago each."""
    g = Input("g", "", "linear")
    return model() + Effect("more", "more", {}, inputs=tuple(g.delayed(k) for k in taps))


def channel(rate: float, seconds: float = 10.0, start: float = 0.0, f: object = np.sin) -> Channel:
    t = start + np.arange(0.0, seconds + 1e-9, 1 / rate)
    return Channel(t, np.asarray(f(t), float))  # type: ignore[operator]


def channels(rate: float = 50.0) -> dict[str, Channel]:
    return {
        "w": Channel(np.array([0.0, 2.04, 5.0, 10.0]), np.array([1.0, -2.0, 3.0, 3.0])),
        "psi": channel(rate, f=lambda t: 0.2 * t),
        "a": channel(4.0),
        "b": channel(4.0, f=np.cos),
    }


def test_a_fast_sensor_is_averaged_and_a_slow_one_keeps_its_times() -> None:
    record = build_record(model(), channels(), rate=10.0)
    psi, pair = record.y[:, 0], record.y[:, 1:]
    seen = np.isfinite(psi)
    assert seen.sum() == 100  # the sample at 10 s would begin a block of its own
    assert record.t[seen][0] == pytest.approx(0.04)  # of 0.00 to 0.08
    np.testing.assert_allclose(psi[seen], 0.2 * record.t[seen], atol=1e-9)  # mean value at the mean time
    whole = np.isfinite(pair).all(axis=1)
    np.testing.assert_array_equal(np.isfinite(pair).any(axis=1), whole)
    np.testing.assert_allclose(record.t[whole], np.arange(0, 10.01, 0.25), atol=1e-9)
    np.testing.assert_allclose(pair[whole], np.column_stack([np.sin(record.t[whole]), np.cos(record.t[whole])]))
    assert record.outputs == ("psi", "a", "b")


def test_of_a_fast_sensor_that_is_not_averaged_each_row_has_a_sample() -> None:
    """That next to the middle of its block; a block without samples has none, and a slow sensor keeps its times."""
    psi = channel(25.0, f=np.exp)
    gap = (psi.t > 3.0) & (psi.t < 4.0)
    at = channels() | {"psi": replace(psi, t=psi.t[~gap], value=psi.value[~gap])}
    sampled = replace(model(), sensors=tuple(replace(s, averaged=False) for s in model().sensors))
    record, mean = (build_record(m, at, rate=10.0) for m in (sampled, model()))
    seen = np.isfinite(record.y[:, 0])
    t = record.t[seen]
    np.testing.assert_array_equal(record.y[seen, 0], np.exp(t))
    assert np.isin(np.round(t, 6), np.round(at["psi"].t, 6)).all()
    assert seen.sum() == 91
    assert np.unique(np.floor(10 * t + 1e-9)).size == 91
    np.testing.assert_array_equal(record.y[np.isfinite(record.y[:, 1]), 1:], mean.y[np.isfinite(mean.y[:, 1]), 1:])


def test_the_noise_of_a_block_mean_is_smaller_by_the_root_of_its_size() -> None:
    noisy = channels() | {"psi": channel(200.0, f=lambda t: 0.1 * np.random.default_rng(1).normal(size=t.size))}
    record = build_record(model(), noisy, rate=10.0)
    psi = record.y[np.isfinite(record.y[:, 0]), 0]
    assert psi.std() == pytest.approx(0.1 / np.sqrt(20), rel=0.2)


def test_a_block_mean_of_an_angle_does_not_see_the_wrap() -> None:
    t = np.arange(0.0, 1.0, 0.01)
    turning = Channel(t, np.mod(3.0 + t + np.pi, 2 * np.pi) - np.pi)
    edges = np.array([0.0, 0.1, 0.2, 0.3, 2.0, 3.0])
    value, centre = block_mean(turning, edges, angle=True)
    np.testing.assert_allclose(value[:4], 3.0 + centre[:4])
    assert np.isnan(value[4])
    assert np.isnan(centre[4])
    holes = Channel(t, np.where(t < 0.1, np.nan, 1.0))
    assert np.isnan(block_mean(holes, edges)[0][0])
    assert block_mean(holes, edges)[0][1] == 1.0


@pytest.mark.parametrize("averaged", [True, False])
def test_a_gap_of_ten_years_is_refused_at_once(averaged: bool) -> None:
    """By its times; blocks and rows over the gap would be gigabytes."""
    given = {
        name: Channel(np.concatenate([c.t, c.t + 3.2e8]), np.tile(c.value, 2)) for name, c in channels(50.0).items()
    }
    boat = model()
    sensors = tuple(replace(sensor, averaged=averaged) for sensor in boat.sensors)
    with pytest.raises(ValueError, match=r"no sample from .* too long to bridge; choose a part"):
        build_record(replace(boat, sensors=sensors), given)


def test_a_short_gap_has_the_same_blocks_as_no_gap() -> None:
    """Edges that no sample is next to are left out, and no mean changes."""
    times = np.sort(np.random.default_rng(1).uniform(3.0, 60.0, 900))
    times = times[(times < 20.0) | (times > 45.0)]
    one = Channel(times, np.sin(times))
    all_edges, some = np.arange(3.0, 60.0 + 0.05, 0.1), _block_edges(times, 3.0, 60.0, 10.0)
    assert 300 < some.size < all_edges.size - 200
    for expected, found in zip(block_mean(one, all_edges), block_mean(one, some), strict=True):
        assert np.array_equal(expected[np.isfinite(expected)], found[np.isfinite(found)])


def test_rows_are_the_union_of_all_times_and_no_interval_is_long() -> None:
    sparse = channels() | {"psi": Channel(np.array([0.0, 3.0, 10.0]), np.zeros(3))}
    record = build_record(model(), sparse, rate=10.0, max_step=0.1)
    assert (np.diff(record.t) > 1e-6).all()
    assert np.diff(record.t).max() <= 1.1 * 0.1 + 1e-9
    for t in (0.0, 2.04, 3.0, 5.0, 7.25, 10.0):
        assert np.abs(record.t - t).min() < 1e-9
    assert np.isfinite(record.y[:, 0]).sum() == 3
    coarse = build_record(model(), sparse, rate=10.0, max_step=5.0)
    assert np.diff(coarse.t).max() == pytest.approx(0.25)
    assert record.h[-1] == 0.0
    np.testing.assert_allclose(np.cumsum(record.h)[:-1], record.t[1:])


def test_samples_that_do_not_keep_time_make_no_rows_without_any() -> None:
    """Every other interval of a sensor of ten a second is longer than a tenth, by its clock's jitter."""
    late = np.random.default_rng(4).uniform(0.0, 0.009, 101)
    t = np.arange(101) / 10 + late
    record = build_record(model(), channels() | {"psi": Channel(t, np.sin(t))}, rate=10.0, max_step=0.1)
    rows = record.t[~np.isfinite(record.y).any(axis=1)]
    np.testing.assert_allclose(rows, [2.04, 10.0 - record.meta["t0"]][: rows.size], atol=0.01)  # the input's alone


def test_a_zero_hold_switches_at_its_own_times_and_a_linear_one_runs_between() -> None:
    record = build_record(model(), channels() | {"psi": channel(5.0)})  # nothing is averaged
    switch = int(np.argmin(np.abs(record.t - 2.04)))
    assert record.t[switch] == pytest.approx(2.04)
    assert (record.u[switch - 1, 0], record.u_next[switch - 1, 0], record.u[switch, 0]) == (1.0, 1.0, -2.0)
    np.testing.assert_array_equal(record.u, record.u_next)
    w = channels()["w"]
    linear = build_record(model("linear"), channels() | {"psi": channel(5.0)})
    np.testing.assert_allclose(linear.u[:, 0], np.interp(linear.t, w.t, w.value), atol=1e-12)
    corner = int(np.searchsorted(linear.t, 2.04)) - 1
    smooth = np.delete(np.arange(linear.n_rows - 1), corner)
    np.testing.assert_allclose(linear.u_next[smooth], linear.u[smooth + 1], atol=1e-9)


def impulse(record: Record) -> float:
    """Of the first input, as a Runge-Kutta step integrates its line."""
    return float(np.sum(record.h * (record.u[:, 0] + record.u_next[:, 0]) / 2))


def test_no_impulse_of_a_linear_input_is_lost_between_the_rows() -> None:
    rng = np.random.default_rng(3)
    for psi in (5.0, 50.0):  # nothing averaged, and averaged
        value = np.pad(rng.normal(size=401), 50)
        given = channels() | {"w": Channel(np.arange(0.0, 10.001, 0.02), value), "psi": channel(psi)}
        assert impulse(build_record(model("linear", "psi"), given)) == pytest.approx(0.02 * value.sum(), abs=1e-6)


@pytest.mark.parametrize("hold", ["linear", "average", "zero"])
def test_an_input_is_averaged_as_the_fast_sensors_are(hold: str) -> None:
    """What one filter does to a force and to the acceleration that follows it, the boat does not see."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 10.001, 0.002)
    force = np.repeat(rng.uniform(-1.0, 1.0, 150), 35)[: t.size]  # of steps every 0.07 s, seen by a sensor at 500 Hz
    given = channels() | {"psi": Channel(t, force), "w": Channel(t[::35], force[::35])}
    if hold == "linear":
        given["w"] = Channel(t, force)
    record = build_record(model(hold, "psi"), given)
    seen = np.isfinite(record.y[:, 0]) & (record.t > 0.1) & (record.t < 9.9)
    np.testing.assert_allclose(record.u[seen, 0], record.y[seen, 0], atol=0.04)
    raw = replace(model(hold, "psi"), inputs=(Input("w", "N", hold, prefilter=False),))  # type: ignore[arg-type]
    # nor where what feels the input is not averaged, though something else is, or nothing feels it
    for other in (raw, model(hold, "a"), model(hold)):
        sharp = build_record(other, given)
        seen = np.isfinite(sharp.y[:, 0])
        assert np.abs(sharp.u[seen, 0] - sharp.y[seen, 0]).max() > 0.5


def test_what_an_input_was_before_the_part_does_not_matter() -> None:
    """Not even where nothing is known of it."""
    for hold in ("linear", "zero"):
        known = channels() | {"w": channel(50.0)}
        value = known["w"].value.copy()
        value[3] = np.nan
        unknown = known | {"w": Channel(known["w"].t, value)}
        rows = [build_record(model(hold, "psi"), given, t_from=2.0) for given in (known, unknown)]
        np.testing.assert_array_equal(rows[0].u, rows[1].u)


def test_a_copy_that_the_data_have_is_theirs() -> None:
    copies = replace(with_taps(0, 2), name="copies")
    given = channels() | {"g~2": channel(50.0, f=lambda t: np.full(t.size, 7.0)), "g": channel(50.0)}
    record = build_record(copies, given)
    assert (record.u[:, list(record.inputs).index("g~2")] == 7.0).all()


def test_a_command_that_is_repeated_is_no_row() -> None:
    t = np.arange(0.0, 10.0, 0.02)
    repeated = channels() | {"w": Channel(t, np.where(t < 2.04, 1.0, np.where(t < 5.0, -2.0, 3.0)))}
    for psi in (5.0, 50.0):  # as it is, and averaged
        slow = {"psi": channel(psi)}
        record, sparse = (build_record(model(feels="psi"), given | slow) for given in (repeated, channels()))
        assert record.n_rows <= sparse.n_rows + 1
        assert sparse.n_rows < 0.4 * t.size
        same = slice(0, sparse.n_rows - 3)
        np.testing.assert_allclose(record.u[same], sparse.u[same], atol=1e-12)


def test_a_hold_between_rows_is_the_line_of_its_mean_and_first_moment() -> None:
    rng = np.random.default_rng(1)
    held = Channel(np.sort(rng.uniform(-0.5, 10.0, 300)), rng.normal(size=300))
    t = np.append(np.arange(0.0, 10.0, 0.1), 10.5)
    start, end = held_lines(held, t)
    fine = np.arange(0.0, 10.5, 1e-5) + 0.5e-5
    value, row = sample_and_hold(held, fine), np.searchsorted(t, fine) - 1
    h, since = np.diff(t), fine - t[row]
    mean, moment = (np.bincount(row, x) * 1e-5 for x in (value, value * since))
    np.testing.assert_allclose((start + end)[:-1] / 2 * h, mean, atol=1e-4)
    np.testing.assert_allclose((start / 2 + (end - start) / 3)[:-1] * h**2, moment, atol=1e-5)
    still = Channel(np.array([-1.0, 20.0]), np.array([0.3, 0.7]))
    np.testing.assert_allclose(held_lines(still, t), 0.3, atol=1e-12)


def test_a_delayed_copy_is_averaged_as_its_signal_is() -> None:
    own = replace(with_taps(0), inputs=(Input("g", "", "linear", prefilter=False),))
    late = Effect("late", "late", {}, inputs=(Input("g", "", "linear").delayed(1), Input("h")))
    assert [i.prefilter for i in (own + late).inputs] == [False, False, True]


def test_a_delayed_copy_is_held_as_its_signal_is() -> None:
    """Whatever an effect says of its copies: between them a held command would begin to rise too early."""
    zero = replace(with_taps(0), inputs=(Input("g", "", "zero"),))
    taps = Effect("late", "late", {}, inputs=tuple(Input("g", "", "linear").delayed(k) for k in (1, 2)))
    assert [i.hold for i in (zero + taps).inputs] == ["zero", "average", "average"]
    assert [i.hold for i in (with_taps(0) + taps).inputs[-2:]] == ["linear", "linear"]


def test_a_switch_a_hair_after_a_sample_is_not_late() -> None:
    """Times that were equal differ by rounding (seconds since 1970 have steps of 0.24 us); they are one row."""
    given = channels() | {"w": Channel(np.array([0.0, 2.0 + 5e-8, 10.0]), np.array([1.0, -2.0, 3.0]))}
    given |= {"a": channel(10.0), "b": channel(10.0), "psi": channel(5.0)}
    record = build_record(model(), given)
    row = int(np.argmin(np.abs(record.t - 2.0)))
    assert record.t[row] == pytest.approx(2.0, abs=1e-6)
    assert record.u[row, 0] == -2.0


def test_sample_and_hold_takes_the_first_value_before_the_first_sample() -> None:
    c = Channel(np.array([1.0, 2.0, 2.0, 3.0]), np.array([5.0, 6.0, 7.0, 8.0]))
    np.testing.assert_array_equal(sample_and_hold(c, np.array([0.0, 1.0, 1.99, 2.0, 2.5, 9.0])), [5, 5, 5, 7, 7, 8])


def test_only_the_common_time_is_used_unless_a_part_is_asked_for() -> None:
    late = channels() | {"a": channel(4.0, 6.0, 1.5), "b": channel(4.0, 6.0, 1.5)}
    record = build_record(model(), late)
    assert record.meta["t0"] == 1.5
    assert record.duration == pytest.approx(6.0)
    assert record.t[0] == 0.0
    assert record.u[0, 0] == pytest.approx(1.0)
    part = build_record(model(), late, t_from=3.0, t_to=5.0, name="part", meta={"why": "asked"})
    assert (part.name, part.meta["why"], part.meta["t0"]) == ("part", "asked", 3.0)
    assert part.duration == pytest.approx(2.0)
    assert part.u[0, 0] == pytest.approx(-2.0)


@pytest.mark.parametrize(
    ("at", "end"),
    [
        ([0.0, 2.0, 6.0], 10.0),  # written where it changes: held on
        ([0.0, 2.0, 2.5], 2.5),  # never held for so long before
        (np.arange(0.0, 5.0, 0.1), 4.9),  # written all the time: its source has died
    ],
)
def test_a_command_that_is_written_where_it_changes_is_held_to_the_end(at: Sequence[float], end: float) -> None:
    w = Channel(np.array(at), np.ones(len(at)))
    record = build_record(model(), channels() | {"w": w}, rate=10.0)
    assert record.t[-1] == pytest.approx(end)
    if end < 10.0:
        name, lost = record.meta["cut"]
        assert (name, lost) == ("w", pytest.approx(10.0 - end))
        (said,) = cut_records([record])
        assert (said.code, "w ends" in said.text) == ("record-cut", True)
    else:
        assert "cut" not in record.meta


def test_an_inputs_past_is_the_input_so_many_steps_ago() -> None:
    wide = with_taps(0, 1, 7)
    ramp = channels() | {"g": channel(50.0, f=lambda t: 2.0 * t)}
    record = build_record(wide, ramp)
    names = list(record.inputs)
    now, one, seven = (record.u[:, names.index(n)] for n in ("g", "g~1", "g~7"))
    later = record.t > 7 * HISTORY_STEP
    np.testing.assert_allclose(now[later] - one[later], 2.0 * HISTORY_STEP, atol=1e-9)
    np.testing.assert_allclose(now[later] - seven[later], 14.0 * HISTORY_STEP, atol=1e-9)
    assert seven[0] == now[0]  # before the first sample there is only that
    assert record.duration == pytest.approx(10.0)  # the past costs no data


def test_time_and_work_are_inputs_of_their_own() -> None:
    wide = with_inputs("t", "n_left", "n_right", "work")
    shafts = {"n_left": channel(25.0, f=lambda t: np.full(t.size, 0.5)), "n_right": channel(25.0, f=lambda t: -t / 10)}
    record = build_record(wide, channels() | shafts, t_from=2.0)
    t, work = (record.u[:, list(record.inputs).index(n)] for n in ("t", "work"))
    np.testing.assert_allclose(t, record.t)
    at = record.t + 2.0  # work counts from the start of the log: a battery does not know what is fitted
    np.testing.assert_allclose(work, (0.125 * at + at**4 / 4000) / WORK_UNIT, atol=1e-5)


def test_a_missing_sensor_is_left_out_and_said() -> None:
    record = build_record(model(), {n: c for n, c in channels().items() if n != "b"})
    assert record.meta["missing"] == ("pair",)
    assert not np.isfinite(record.y[:, 1:]).any()
    assert np.isfinite(record.y[:, 0]).any()


@pytest.mark.parametrize(
    ("drop", "change", "says"),
    [
        (("w",), {}, "run 7: no signal for the input 'w' of model cart; the log has a, b, psi"),
        (("psi", "a"), {}, "run 7: none of the sensors of model cart is in the log: compass, pair"),
        ((), {"w": channel(1.0, 10.0, 20.0)}, "run 7: inputs and sensors overlap for only -10.00 s"),
        (
            (),
            {"b": channel(4.0, 9.0, 0.1)},
            "run 7: a and b are read together as the sensor pair, and no row has them at the same time: give them the "
            "same time stamps",
        ),
    ],
)
def test_what_cannot_be_made_is_one_clear_line(drop: tuple[str, ...], change: dict[str, Channel], says: str) -> None:
    given = {n: c for n, c in channels().items() if n not in drop} | change
    with pytest.raises(ValueError, match="run 7") as problem:
        build_record(model(), given, name="run 7")
    assert str(problem.value) == says


def test_a_record_serves_other_models_and_parts() -> None:
    wide = with_taps(0, 3)
    record = build_record(wide, channels() | {"g": channel(50.0)})
    own = record.for_model(model())
    assert (own.inputs, own.outputs) == (("w",), ("psi", "a", "b"))
    np.testing.assert_array_equal(own.u[:, 0], record.u[:, 0])
    assert np.shares_memory(own.u, record.u)  # a search keeps records for dozens of models
    assert own.y is record.y
    fewer = replace(model(), sensors=model().sensors[1:])
    np.testing.assert_array_equal(record.for_model(fewer).y, record.y[:, 1:])
    with pytest.raises(ValueError, match="no signal for the input 'g' of model cart"):
        own.for_model(wide)
    part = record.part(2.0, 4.0)
    assert part.name == "record[2:4]"
    assert (part.t[0] >= 2.0, part.t[-1] < 4.0, part.n_rows) == (True, True, part.y.shape[0])
    assert isinstance(part, Record)


def test_a_row_of_a_sensor_has_all_its_outputs_of_one_time() -> None:
    """An import drops NaN signal by signal: what is left of two outputs has different times."""
    found = channels()
    for name, lost in (("a", 10), ("b", 20)):
        c = found[name]
        found[name] = Channel(np.delete(c.t, lost), np.delete(c.value, lost))
    record = build_record(model(), found, rate=10.0)
    pair = record.y[:, 1:]
    whole = np.isfinite(pair).all(axis=1)
    np.testing.assert_array_equal(np.isfinite(pair).any(axis=1), whole)
    t = record.t[whole]
    np.testing.assert_allclose(t, np.delete(np.arange(0, 10.01, 0.25), [10, 20]), atol=1e-9)
    np.testing.assert_allclose(pair[whole], np.column_stack([np.sin(t), np.cos(t)]))
