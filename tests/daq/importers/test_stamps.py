"""Tests of message times from stamps and receipt times: which clock failed, and the resulting time of each message."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt
import pytest

from seatrial.daq.importers.stamps import EstimatedTimes, MessageTimes, message_times

Array = npt.NDArray[np.float64]
T0, SECONDS = 1.7e9, 120.0
RATES = {"/imu": 25.0, "/fix": 5.0, "/vel": 5.0}
START = 10.0  # time of the simulation at the start [s]


def true_times(hz: float) -> Array:
    return np.arange(0.0, SECONDS, 1.0 / hz)


def delays(n: int, seed: int) -> Array:
    """Return usual transport delays [s]: some ms, and sometimes some tens of ms."""
    return np.asarray(np.random.default_rng(seed).exponential(0.008, n) + 0.002)


class Bag:
    """Messages of stamped topics and of a command without stamps.

    ``clock`` converts true times to stamps, and ``recorder`` converts true times to receipt times [s since T0].
    """

    def __init__(self, clock=lambda t: t, recorder=lambda t: t, topics=tuple(RATES)) -> None:  # type: ignore[no-untyped-def]
        self.true = {name: true_times(RATES[name]) for name in topics} | {"/cmd": true_times(10.0)}
        self.found: dict[str, MessageTimes] = {}
        for k, (name, t) in enumerate(self.true.items()):
            stamp = T0 + clock(t) if name != "/cmd" else np.full(t.size, np.nan)
            self.found[name] = MessageTimes(T0 + recorder(t + delays(t.size, k)), stamp)

    def move(self, name: str, which: npt.NDArray[np.bool_], by: float) -> None:
        self.found[name].stamp[which] += by

    def times(self) -> dict[str, EstimatedTimes]:
        return message_times(self.found)

    def errors(self, found: dict[str, EstimatedTimes]) -> dict[str, float]:
        """Return the largest error of each topic after removal of a common shift [s]."""
        first = next(iter(self.true))
        shift = np.nanmedian(found[first].t - self.true[first])
        return {name: float(np.nanmax(np.abs(found[name].t - shift - t))) for name, t in self.true.items()}


def lost(found: dict[str, EstimatedTimes], name: str) -> int:
    return int(np.sum(~np.isfinite(found[name].t)))


def test_stamps_of_the_recorders_clock_are_kept() -> None:
    bag = Bag()
    found = bag.times()
    for name in RATES:
        np.testing.assert_array_equal(found[name].t, T0 + bag.true[name])
    np.testing.assert_array_equal(found["/cmd"].t, bag.found["/cmd"].receipt)
    assert not any(signal.remark for signal in found.values())


@pytest.mark.parametrize("rate", [0.2, 0.5, 0.8, 0.98, 1.0, 2.0])
def test_commands_follow_a_simulation_at_any_rate(rate: float) -> None:
    bag = Bag(lambda t: START + t - T0, lambda t: t / rate)
    found = bag.times()
    assert max(bag.errors(found).values()) < 0.06
    assert min(signal.t.min() for signal in found.values()) == pytest.approx(T0, abs=0.1)
    assert "another clock" in found["/imu"].remark
    assert ("times the rate" in found["/imu"].remark) == (rate != 1.0)
    assert "corrected by the stamps of the other topics" in found["/cmd"].remark


def test_commands_follow_a_simulation_that_slows_down_and_stops() -> None:
    wall = np.array([0.0, 40.0, 140.0, 160.0, 210.0])
    simulated = np.array([0.0, 40.0, 80.0, 80.0, 130.0])
    bag = Bag(lambda t: START + t - T0, lambda t: np.interp(t, simulated + 1e-9 * np.arange(5), wall))
    assert max(bag.errors(bag.times()).values()) < 0.15


@pytest.mark.parametrize("by", [4.29, -1.0, 3600.0, -1.7e9 + 60.0])
@pytest.mark.parametrize("every", [1, 5])
def test_wrong_stamps_are_left_out(by: float, every: int) -> None:
    bag = Bag()
    wrong = {name: (bag.true[name] > 70.0) & (np.arange(bag.true[name].size) % every == 0) for name in ("/fix", "/vel")}
    for name, which in wrong.items():
        bag.move(name, which, by)
    found = bag.times()
    for name, which in wrong.items():
        np.testing.assert_array_equal(np.isnan(found[name].t), which, err_msg=name)
        assert f"{which.sum()} of {which.size} stamps are wrong, by {by:+.2f} s" in found[name].remark
        np.testing.assert_array_equal(found[name].t[~which], T0 + bag.true[name][~which])
    assert (lost(found, "/imu"), lost(found, "/cmd")) == (0, 0)
    assert max(bag.errors(found).values()) < 0.1


def test_wrong_stamps_without_another_sensor_do_not_move_the_commands() -> None:
    bag = Bag(topics=("/fix", "/vel"))
    for name in ("/fix", "/vel"):
        bag.move(name, bag.true[name] > 55.0, 4.29)
    found = bag.times()
    assert lost(found, "/fix") == pytest.approx(64 * 5, abs=6)
    assert max(bag.errors(found).values()) < 0.1


def test_a_late_message_keeps_its_stamp() -> None:
    """A queue delays one topic by 3 s. Its stamps continue as before, and its receipt times do not."""
    bag = Bag()
    receipt = bag.found["/fix"].receipt
    late = (receipt > T0 + 50.0) & (receipt < T0 + 53.0)
    receipt[late] = T0 + 53.0 + 1e-3 * np.arange(late.sum())
    found = bag.times()
    np.testing.assert_array_equal(found["/fix"].t, T0 + bag.true["/fix"])
    assert not any(signal.remark for signal in found.values())


@pytest.mark.parametrize("by", [3.0, 3600.0])
def test_a_step_of_the_recorders_clock_is_taken_out_of_the_commands(by: float) -> None:
    bag = Bag(recorder=lambda t: t + by * (t > 60.0))
    found = bag.times()
    assert max(bag.errors(found).values()) < 0.1
    assert not any(lost(found, name) for name in found)
    assert "corrected by the stamps of the other topics" in found["/cmd"].remark


@pytest.mark.parametrize("by", [-4.0, -30.0])
@pytest.mark.parametrize("topics", [tuple(RATES), ("/fix",)])
def test_only_ambiguous_messages_of_a_recorder_that_was_set_back_are_omitted(
    by: float, topics: tuple[str, ...]
) -> None:
    bag = Bag(recorder=lambda t: t + by * (t > 60.0), topics=topics)
    for name, signal in bag.found.items():  # the times as a reader of the bag receives them
        order = np.argsort(signal.receipt, kind="stable")
        bag.found[name], bag.true[name] = (
            MessageTimes(signal.receipt[order], signal.stamp[order]),
            bag.true[name][order],
        )
    found = bag.times()
    assert max(bag.errors(found).values()) < 0.1
    assert not any(lost(found, name) for name in topics)
    assert lost(found, "/cmd") == pytest.approx(2 * 10 * -by, abs=6)


def test_a_step_of_only_two_topics_is_also_a_step_of_the_recorder() -> None:
    bag = Bag(recorder=lambda t: t + 3.0 * (t > 60.0), topics=("/fix",))
    found = bag.times()
    assert max(bag.errors(found).values()) < 0.1
    assert not lost(found, "/fix")


def test_a_simulation_that_was_set_back_keeps_its_longer_part() -> None:
    bag = Bag(lambda t: START + np.where(t < 50.0, t, t - 50.0) - T0)
    found = bag.times()
    assert lost(found, "/imu") == pytest.approx(50 * 25, abs=15)
    assert re.search(r"1250 of 3000 stamps are wrong, by \+(50\.0|49\.9)\d s", found["/imu"].remark)
    assert max(bag.errors(found)[name] for name in RATES) < 0.1


def test_messages_before_the_clock_have_no_time() -> None:
    bag = Bag(lambda t: START + t - T0, lambda t: START + t - T0)
    for times in bag.found.values():
        early = times.receipt < START + 2.0
        times.receipt[early] = 0.0
        times.stamp[early & np.isfinite(times.stamp)] = 0.0
    found = bag.times()
    assert lost(found, "/imu") == pytest.approx(50, abs=2)
    assert lost(found, "/cmd") == pytest.approx(20, abs=2)
    assert "without a time" in found["/cmd"].remark


@pytest.mark.parametrize("rate", [1.0, 1.02])
def test_a_device_with_another_clock_is_moved_to_the_others(rate: float) -> None:
    """The stamps count from the start of the device, at a slightly different rate."""
    bag = Bag()
    bag.found["/fix"] = MessageTimes(bag.found["/fix"].receipt, 500.0 + rate * bag.true["/fix"])
    found = bag.times()
    assert max(bag.errors(found).values()) < 0.1
    assert "another clock" in found["/fix"].remark
    assert not found["/imu"].remark


def test_a_constant_stamp_is_ignored() -> None:
    bag = Bag()
    bag.found["/fix"].stamp[:] = T0
    found = bag.times()
    np.testing.assert_array_equal(found["/fix"].t, bag.found["/fix"].receipt)


def test_headers_that_are_never_filled_are_ignored() -> None:
    bag = Bag()
    for times in bag.found.values():
        times.stamp[:] = 0.0
    found = bag.times()
    for name, times in bag.found.items():
        np.testing.assert_array_equal(found[name].t, times.receipt)
