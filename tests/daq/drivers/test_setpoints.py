"""Tests of set-points: due times, repetition, and the effect of zero."""

from __future__ import annotations

import math

import pytest

from seatrial.daq.drivers.setpoints import REPEAT_S, ZERO_FOR_S, Due, Setpoints


def test_rows_are_due_at_their_time_and_repeated_in_between() -> None:
    setpoints = Setpoints()
    assert not setpoints.active
    assert setpoints.wait(0.0, 0.0, 1.0) == math.inf
    setpoints.append([(1.0, {1: 0.5, 2: 0.25}), (2.0, {1: 0.0, 2: 0.0})])
    assert setpoints.active
    assert setpoints.due(0.9, 10.0) == []
    assert setpoints.wait(0.9, 10.0, 20.0) == pytest.approx(0.1 / 20.0)
    assert setpoints.due(1.0, 10.1) == [Due(1, 0.5, True), Due(2, 0.25, True)]
    assert setpoints.wait(1.0, 10.1, 1.0) == pytest.approx(REPEAT_S)
    assert setpoints.due(1.0, 10.1 + 0.5 * REPEAT_S) == []
    assert setpoints.due(1.0, 10.1 + REPEAT_S) == [Due(1, 0.5, False), Due(2, 0.25, False)]
    assert setpoints.held == {1: 0.5, 2: 0.25}


def test_zero_is_repeated_for_a_limited_time() -> None:
    setpoints = Setpoints()
    setpoints.append([(1.0, {1: 0.5}), (2.0, {1: 0.0})])
    setpoints.due(1.0, 10.0)
    assert setpoints.due(2.0, 11.0) == [Due(1, 0.0, True)]
    assert not setpoints.active
    assert setpoints.due(2.0, 11.0 + REPEAT_S) != []


def test_zero_clears_the_schedule_at_once() -> None:
    setpoints = Setpoints()
    setpoints.append([(1.0, {1: 0.5, 2: -0.5}), (5.0, {1: 0.7})])
    setpoints.due(1.0, 10.0)
    setpoints.zero(10.0)
    assert not setpoints.active
    assert setpoints.pending == 0
    assert setpoints.wait(1.0, 10.0, 1.0) == 0.0
    assert setpoints.due(1.0, 10.0) == [Due(1, 0.0, True), Due(2, 0.0, True)]
    assert setpoints.due(9.0, 10.1) == [Due(1, 0.0, False), Due(2, 0.0, False)]
    assert setpoints.due(9.0, 10.0 + ZERO_FOR_S) == []
    assert setpoints.wait(9.0, 10.0 + ZERO_FOR_S, 1.0) == math.inf


def test_zero_is_settled_only_after_it_was_written_and_repeated() -> None:
    setpoints = Setpoints()
    assert setpoints.is_settled(10.0)
    setpoints.append([(1.0, {1: 0.5})])
    setpoints.due(1.0, 10.0)
    setpoints.written()
    setpoints.zero(10.0)
    late = 11.0 + ZERO_FOR_S
    assert not setpoints.is_settled(late)  # the thread of the port has not taken it yet
    setpoints.due(1.0, late)
    assert not setpoints.is_settled(late)  # the write blocks
    setpoints.written()
    assert not setpoints.is_settled(late)
    assert setpoints.is_settled(late + ZERO_FOR_S)


def test_zero_before_any_command_is_not_sent() -> None:
    setpoints = Setpoints()
    setpoints.append([(1.0, {1: 0.5})])
    setpoints.zero(0.0)
    assert setpoints.due(2.0, 1.0) == []


def test_of_several_late_rows_only_the_newest_is_sent() -> None:
    setpoints = Setpoints()
    setpoints.append([(1.0, {1: 0.1, 2: 0.9}), (2.0, {1: 0.2}), (3.0, {1: 0.3}), (9.0, {1: 0.4})])
    assert setpoints.due(5.0, 1.0) == [Due(1, 0.3, True), Due(2, 0.9, True)]
    assert setpoints.skipped == 2
    assert setpoints.pending == 1


def test_only_rows_replaced_by_a_later_row_count_as_skipped() -> None:
    setpoints = Setpoints()
    setpoints.append([(1.0, {1: 0.1}), (1.0, {1: 0.2}), (1.5, {2: 0.3})])  # of two rows at one time the later row holds
    assert setpoints.due(2.0, 0.0) == [Due(1, 0.2, True), Due(2, 0.3, True)]
    assert setpoints.skipped == 0
    setpoints.zero(1.0)
    setpoints.append([(3.0, {1: 0.4})])
    assert setpoints.due(3.0, 2.0) == [Due(1, 0.4, True), Due(2, 0.0, True)]  # zero is not a row of the plan
    assert setpoints.skipped == 0
    setpoints.append([(4.0, {1: 0.5, 2: 0.5}), (5.0, {1: 0.6}), (6.0, {1: 0.7})])
    assert setpoints.due(7.0, 3.0) == [Due(1, 0.7, True), Due(2, 0.5, True)]
    assert setpoints.skipped == 2


def test_rows_may_be_given_in_any_order() -> None:
    setpoints = Setpoints()
    setpoints.append([(3.0, {1: 0.3})])
    setpoints.append([(1.0, {1: 0.1}), (3.0, {1: 0.4})])
    assert setpoints.due(1.0, 0.0) == [Due(1, 0.1, True)]
    assert setpoints.due(3.0, 0.001) == [Due(1, 0.4, True)]
