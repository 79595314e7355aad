"""Tests of our decoders on captures of real devices that other programs have decoded too."""

from __future__ import annotations

import pytest

from tests.golden.__main__ import totals
from tests.golden.captures import results
from tests.golden.fuzz import fuzz, subjects
from tests.golden.gpsd import Fix, _difference, _is_late, compare, receiver_bytes
from tests.measured.data import measured

N_FUZZ = 400  # `python -m tests.golden.fuzz` does a million


@pytest.mark.measured
def test_fixes_and_headings_equal_the_output_of_gpsd() -> None:
    folder = measured("gpsd/daemon")
    found = [compare(path) for path in sorted(folder.glob("*.log"))]
    assert len(found) == 69
    assert sum(row.fixes for row in found) > 1600
    shares = totals(found)
    assert all(share.part >= 0.995 for share in shares.values())
    assert all(shares[name].comparable > 1550 for name in ("fixes", "speeds", "modes"))
    assert sum(row.speeds.by_sentence for row in found) < 0.07 * shares["speeds"].comparable
    # Fixes whose position in RMC or GLL differs from GGA of the same time
    by_sentence = {row.name: (row.by_sentence, row.late) for row in found if row.by_sentence > 1}
    assert by_sentence == {"ac12": (7, 0), "ac12_binary": (4, 1), "bundg_zeus_9": (103, 37)}
    # neo-m8n: gpsd reads 2015 instead of 2034. lea-4t: gpsd has not received the leap seconds yet.
    assert {row.name for row in found if row.misses} == {"neo-m8n", "ublox-lea-4t"}
    # The first GSA with dimensions in this capture comes after the fix.
    assert {row.name for row in found for s in (row.speeds, row.modes, row.headings) if s.differing} == {"garmin25lp"}
    attitudes = {row.name: row.headings.agreeing for row in found if row.headings.comparable}
    assert attitudes == {"hemi": 4, "pypilot": 7, "skytraq-PX1172RH_DS": 9}


@pytest.mark.measured
def test_all_other_captures_are_decoded_correctly() -> None:
    found = list(results(measured("gpsd").parent))
    assert [row.name for row in found if not row.right] == []
    assert len(found) == 9


def test_a_difference_from_gpsd_is_named() -> None:
    ours = [Fix(1000.0, 41.0, -8.0)]
    assert _difference(Fix(1000.0, 41.0, -8.0), 5e-10, ours) == ""
    assert _difference(Fix(1000.0, 41.000001, -8.0), 5e-10, ours) == "same time, below 1 m apart"
    assert _difference(Fix(1000.0, 41.1, -8.0), 5e-10, ours) == "same time, above 1 m apart"
    assert _difference(Fix(1001.0, 41.0, -8.0), 5e-10, ours) == "same place, 1.000 s apart"
    assert _difference(Fix(1000.0 + 1024 * 604800, 41.0, -8.0), 5e-10, ours) == "same place, another date"
    assert _difference(Fix(1001.0, 42.0, -8.0), 5e-10, ours) == "no sample of ours at this time"


def test_a_position_of_the_previous_epoch_is_late() -> None:
    ours = [Fix(1000.0 + k, 41.0 + 1e-5 * k, -8.0) for k in range(5)]
    assert _is_late(Fix(1003.0, 41.0 + 2e-5, -8.0), ours)
    assert not _is_late(Fix(1003.0, 41.0 + 2.9e-5, -8.0), ours)


@pytest.mark.measured
def test_the_header_of_a_capture_is_not_decoded() -> None:
    data = receiver_bytes(measured("gpsd/daemon/ublox-neo-m8u.log"))
    assert not data.startswith(b"#")
    assert b"\xb5\x62" in data[:5000]


@pytest.mark.parametrize("name", list(subjects()))
def test_a_decoder_survives_damaged_input(name: str) -> None:
    assert fuzz(subjects()[name], N_FUZZ, seed=2) > 0
