"""Workflow of `seatrial ident noise`: from logs of sensors at rest to noise.toml, result.json and report.html.

The format of noise.toml is described in docs/formats/noise.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomlkit

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.files import write_output
from seatrial.daq.log import open_log
from seatrial.daq.samples import Ahrs
from seatrial.ident.characterisation import NoiseFit, allan_deviation, band_spectrum, estimate_noise, welch
from seatrial.ident.data import Channel, LoadedLog, ahrs_channels, load_runs, silent_times
from seatrial.ident.report import write_report
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import (
    AllanCurve,
    ChannelNoise,
    NoiseResult,
    SpectrumBands,
    finite,
    provenance,
    write_result,
)
from seatrial.ident.validation import OUTLIER_SDS

FORMAT = "seatrial-noise 2"
WARNING = "Such numbers do not describe the noise, so do not put them into a filter."
SPIKES = "The numbers include these samples: record again without the cause."
STEPS = "The numbers are not those of the sensor's noise: record an output of finer resolution."
MOST_NAMED = 6  # rejected channels that the answer names
HUM = "Find what turns or hums at that frequency, or at one that is aliased to it, and record again without it."
DRIFT = "A steady or bounded drift is not a random walk: let the sensor warm up, or give a filter a state for it."
COLOUR = (
    "Use the raw output of a sensor that filters, stop its vibration, or pass its samples to a filter at a lower rate."
)


@dataclass(frozen=True)
class NoiseEstimate:
    """Noise estimate of one channel of one log.

    Attributes
    ----------
    log, name
        Name of the log and of the channel.
    label
        Name of the channel in texts, with the name of the log if there are several logs.
    channel
        Samples of the channel, with unwrapped angles and with times [s] from the first sample.
    fit
        Fitted model: white noise plus a random walk, with tests.
    """

    log: str
    name: str
    label: str
    channel: Channel
    fit: NoiseFit

    @property
    def reason(self) -> str:
        """Reason, as a part of a sentence, why the channel is not white noise plus a random walk.

        The text is empty if no departure from this model is large enough to matter.
        """
        return " and ".join(words for words, _ in self._departures())

    @property
    def remedy(self) -> str:
        """Advice to the user, a sentence, for a channel that is not white noise plus a random walk.

        If `reason` names two departures, the advice is that for the second. If `reason` is empty, the property raises
        IndexError.
        """
        return self._departures()[-1][1]

    @property
    def exceptions(self) -> list[tuple[str, str]]:
        """Spikes, jumps and coarse steps of the channel: pairs of a description and a sentence on its consequence.

        There is at most one pair for spikes, jumps and heavy tails, and one for steps that are coarse beside the noise.
        White noise plus a random walk does not describe them, but this noise model may be accepted nevertheless.
        """
        f, found = self.fit, []
        size = np.abs(f.innovations)
        beyond, k = int(np.sum(size > OUTLIER_SDS)), int(np.argmax(size))
        if beyond or f.heavy_tailed:
            tails = (
                f"{beyond} of {f.n} innovations beyond {OUTLIER_SDS:g} standard deviations"
                if beyond
                else (f"heavy tails (kurtosis {f.kurtosis:.2g})")
            )
            found += [(f"{tails}, the largest {size[k]:.2g} at {f.t[k]:.4g} s", SPIKES)]
        if f.coarse:
            step = f"{f.resolution:.2g} {self.channel.unit}".strip()
            found += [(f"steps of {step} from value to value, coarse compared with its noise", STEPS)]
        return found

    def _departures(self) -> list[tuple[str, str]]:
        """Return the departures of the channel from white noise plus a random walk, each as a text and an advice.

        A spectral line is returned alone if its share is more than half of the predictable share of the variance of the
        innovations. Otherwise the list has the autocorrelation of the innovations, and the frequency band in which the
        density of the innovations is too high or too low. Beside an autocorrelation, only a band from frequency zero is
        listed. Departures that are too small to matter are left out, so that the list may be empty. A spectral line
        with a smaller share is listed if nothing else matters.
        """
        predictable, line, band = self.fit.departures
        rate = 1.0 / self.fit.interval
        share = _percent(line.share)
        words = f"a spectral line at {line.frequency * rate:.3g} Hz has {share} of the variance of its innovations"
        if line.matters and line.share > predictable.share / 2:
            return [(words, HUM)]
        hum = [(words, HUM)] if line.matters else []
        found = []
        if predictable.matters:
            correlated = f"its innovations are correlated by {self.fit.largest_correlation:+.2f}"
            found += [(f"{correlated}, {_percent(predictable.share)} of their variance could be predicted", COLOUR)]
        if band.matters and (band.low == 0 or not found):
            span = f"{band.low * rate:.2g} to {band.high * rate:.2g} Hz"
            words = f"at {span} its power spectral density is {band.ratio:.2g} times that of the noise model"
            found += [(words, COLOUR if band.low else DRIFT)]
        return found or hum


def noise(logs: Sequence[Path], out: Path, *, signals: Sequence[str], command: str, reporter: Reporter) -> NoiseResult:
    """Estimate white noise and random walk of each channel in logs of sensors at rest, and write the results.

    The files are noise.toml, result.json and report.html in the folder ``out``.

    Parameters
    ----------
    logs : sequence of Path
        Logs of sensors at rest.
    out : Path
        Folder for the results; it is created if it does not exist.
    signals : sequence of str
        Names of the channels to estimate; empty: all channels of each log.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress.

    Returns
    -------
    NoiseResult
        Content of result.json. Channels that cannot be estimated are listed in its notes.

    Raises
    ------
    SeatrialError
        If no channel can be estimated, or if a log lacks one of the signals.
    """
    loaded = load_runs(logs, "estimation", cut=False)  # `estimate_noise` cuts each channel at its gaps
    notes: list[str] = []
    found: list[NoiseEstimate] = []
    for path, log in zip(logs, loaded, strict=True):
        chosen = _channels_to_estimate(path, log, signals)
        for name, channel in chosen.items():
            label = name if len(logs) == 1 else f"{log.run.name} {name}"
            reporter.progress(f"{label}: {channel.t.size} samples")
            try:
                fit = estimate_noise(channel, label)
            except ValueError as problem:
                notes.append(f"Left out: {problem}")
                continue
            if gaps := silent_times({name: channel}):
                notes.append(f"{label}: cut at {counted(len(gaps), 'gap')}; each part has its own unknown offset")
            found.append(NoiseEstimate(log.run.name, name, label, channel, fit))
    if not found:
        names = ", ".join(str(path) for path in logs)
        why = "; ".join(notes) or "no channel has two samples: record at least a minute at rest"
        raise SeatrialError(f"{names}: no channel whose noise could be estimated; {why}")
    made = provenance(loaded, command)
    result = NoiseResult(
        created=made.created,
        seatrial=made.seatrial,
        command=made.command,
        logs=made.logs,
        answer=_noise_answer(found),
        noise=tuple(_channel_noise(x) for x in found),
        notes=(*notes, *_noise_notes(found)),
    )
    out.mkdir(parents=True, exist_ok=True)
    save_noise(out / "noise.toml", found, result)
    write_result(result, out / "result.json")
    write_report(result, out / "report.html")
    return result


def _channels_to_estimate(path: Path, loaded: LoadedLog, signals: Sequence[str]) -> Mapping[str, Channel]:
    """Return the channels of a log by name, with all axes of its AHRS; only those in ``signals`` if it is not empty.

    The axes of the AHRS include those that ``loaded`` lacks, for example the vertical acceleration ``az``. Times [s]
    start at the first sample of each channel, and angles are unwrapped. Channels with fewer than two samples are left
    out. Raise SeatrialError if a channel in ``signals`` is missing. ``path``: file of the log; ``loaded``: the same log
    in memory.
    """
    everything = dict(loaded.run.channels)
    with open_log(path) as log:
        for source in log.sources(Ahrs):
            everything = ahrs_channels(log.table(Ahrs, source), source) | everything
    everything = {n: _with_unwrapped_angles(c) for n, c in everything.items() if c.t.size > 1}
    lost = [n for n in signals if n not in everything]
    if lost:
        raise SeatrialError(
            f"{path}: no signal {lost[0]!r}; the log has {', '.join(sorted(everything))}; give one of these to --signal"
        )
    return {n: everything[n] for n in signals} if signals else everything


def _with_unwrapped_angles(channel: Channel) -> Channel:
    """Return a channel with times [s] from its first sample and, if its unit is rad, with unwrapped values.

    Without this, a heading that crosses 180 degrees would have a step of 360 degrees.
    """
    value = np.unwrap(channel.value) if channel.unit == "rad" else channel.value
    return Channel(channel.t - channel.t[0], value, channel.unit, channel.source)


def _channel_noise(estimate: NoiseEstimate) -> ChannelNoise:
    """Return the row of the result for the noise of one channel, with its power spectral density.

    A standard error that is not finite, because no such noise was found, is None. Only then the row has a limit: the
    noise that would be found in 95 of 100 such records.
    """
    frequency, density = welch(estimate.channel)
    averaged = band_spectrum(frequency, density)
    f = estimate.fit
    return ChannelNoise(
        channel=estimate.label,
        unit=estimate.channel.unit,
        white=f.white,
        random_walk=f.walk,
        se_white=finite(f.white_error),
        se_random_walk=finite(f.walk_error),
        white_limit=None if np.isfinite(f.white_error) else f.white_limit,
        random_walk_limit=None if np.isfinite(f.walk_error) else f.walk_limit,
        accepted=not f.rejected,
        p=finite(f.ljung_box),
        predictable=finite(f.departures.share),
        reason=estimate.reason or None,
        frequency=frequency,
        psd=density,
        psd_model=f.psd(frequency),
        bands=SpectrumBands(**vars(averaged)),
        allan=_allan_curve(estimate),
    )


def _allan_curve(estimate: NoiseEstimate) -> AllanCurve | None:
    """Return the Allan deviation of a channel for the result, with the density of the fitted white noise.

    Return None if the channel is too short.
    """
    found = allan_deviation(estimate.channel)
    if found is None:
        return None
    return AllanCurve(density=estimate.fit.white * math.sqrt(estimate.fit.interval), **vars(found))


def _noise_answer(found: Sequence[NoiseEstimate]) -> str:
    """Return the answer of `seatrial ident noise`: how many channels are white noise plus a random walk.

    The answer names at most six channels that are not, and those with spikes, jumps or coarse steps. For a single
    channel it gives the reason.
    """
    bad = [x for x in found if x.fit.rejected]
    odd = [x for x in found if x.exceptions and not x.fit.rejected]
    but = f", but with {' and '.join(words for words, _ in odd[0].exceptions)}" if odd else ""
    if odd and len(found) > 1:
        but = f", but with spikes, jumps or coarse steps in {', '.join(x.label for x in odd)}"
    good = len(found) - len(bad)
    kind = "white noise plus a random walk"
    if not bad:
        return f"{'The channel is' if good == 1 else f'All {good} channels are'} {kind}{but}."
    if len(found) == 1:
        return f"The channel is not {kind}: {bad[0].reason}. {WARNING}"
    named = ", ".join(x.label for x in bad[:MOST_NAMED])
    more = f" and {len(bad) - MOST_NAMED} more" if len(bad) > MOST_NAMED else ""
    return f"{good} of {len(found)} channels are {kind}{but}. These are not: {named}{more}. {WARNING}"


def _percent(share: float) -> str:
    """Format a share (0 to 1) in per cent with two significant digits, for the sentences of the result."""
    return f"{100 * share:.2g} %"


def _noise_notes(found: Sequence[NoiseEstimate]) -> list[str]:
    """Return the notes of the result of `seatrial ident noise`.

    They are about channels that are not white noise plus a random walk, significant departures that are too small to
    matter, spikes, coarse steps, and problems of the estimates (``flags`` of the fits).
    """
    lines = [f"{x.label}: not white noise plus a random walk: {x.reason}. {x.remedy}" for x in found if x.fit.rejected]
    lines += [
        f"{x.label}: the innovations are not quite white, but no more than {_percent(x.fit.departures.share)} of their "
        "variance could be predicted and their density is nowhere wrong by a factor of two: the noise model is "
        "accepted, and no action is needed."
        for x in found
        if not x.fit.rejected and x.fit.departures.significant
    ]
    lines += [f"{x.label}: {words}. {means}" for x in found for words, means in x.exceptions]
    return lines + [f"{x.label}: {flag}" for x in found for flag in x.fit.flags]


def save_noise(path: Path, found: Sequence[NoiseEstimate], result: NoiseResult) -> None:
    """Write noise.toml, the part of the result that is made for other programs, for example filters.

    Parameters
    ----------
    path : Path
        File, which is replaced if it exists.
    found : sequence of NoiseEstimate
        Estimates of all channels, at least one. Numbers that are not finite are left out.
    result : NoiseResult
        Content of result.json, which gives the provenance.
    """
    document = tomlkit.document()
    document["format"] = FORMAT
    document["provenance"] = {
        "made_by": result.command,
        "created": result.created,
        "seatrial": result.seatrial,
        "logs": [f"{x.path} sha256:{x.sha256[:16]}" for x in result.logs],
    }
    tables = tomlkit.aot()
    for estimate in found:
        f = estimate.fit
        numbers = {
            "white": f.white,
            "white_se": f.white_error,
            "random_walk": f.walk,
            "random_walk_se": f.walk_error,
            "interval": f.interval,
            "p": f.ljung_box,
            "largest_correlation": f.largest_correlation,
            "predictable": f.departures.share,
            "white_limit": math.nan if np.isfinite(f.white_error) else f.white_limit,
            "random_walk_limit": math.nan if np.isfinite(f.walk_error) else f.walk_limit,
        }
        table = tomlkit.table()
        table.update({"log": estimate.log, "name": estimate.name, "unit": estimate.channel.unit, "n": f.n})
        table.update({k: float(f"{v:.7g}") for k, v in numbers.items() if np.isfinite(v)})
        table.update({"accepted": not f.rejected})
        if f.rejected:
            table.update({"reason": estimate.reason})
        tables.append(table)
    document["channel"] = tables
    write_output(path, tomlkit.dumps(document))
