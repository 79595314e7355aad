"""Delayed inputs: names of the delayed copies of an input, and interpolation between the copies.

A model is evaluated row by row, without access to earlier rows. A delay that is a parameter therefore needs copies of
the input, each delayed by a multiple of a step. The model interpolates the copies at the delay by cubic convolution
(`delay_weights`, `weighted_sum`), so that its derivative by the delay is continuous. Only the effect ``gnss-latency``
interpolates linearly. There are three kinds of copies. They differ in what a step of the input does to the rows of a
record, and in their step. They cannot be merged without a change of the estimates:

- ``NAME~k`` (`seatrial.ident.model.structure.Input.delayed`): the value ``k`` steps of `HISTORY_STEP` ago, for effects
  that delay a measured shaft speed or a given thrust (``delay``, ``telemetry-age``, ``gnss-latency``). With steps of
  0.05 s it is also used for the commands of ``horizontal:command``. `seatrial.ident.data.record.build_record` computes
  the copy from the signal. A change of the copy starts no row; between rows, a straight line of the same mean and first
  moment replaces the copy. Use this kind for any new delay.
- ``NAME~kxSTEPs``, for example ``n_left~3x0.05s``: the same kind of copy in a Nomoto model. The step is part of the
  name, because an effect may add ``NAME~k`` with steps of `HISTORY_STEP` to the same model.
- ``NAME_k``, for example ``n_cmd_3`` (`seatrial.ident.models.thruster.delayed_channels`): a channel of its own, for the
  thruster on the bench. Every change of every copy starts a row, so that a step of the command stays a step. This is
  exact for the fast sensors of a bench, and would need too many rows on a boat.

Three other concepts are no delayed inputs. A first-order lag is a state
(`seatrial.ident.models.horizontal.first_order`). A late sensor is an output that is extrapolated backwards with its
rates (``gnss-latency``, ``filter-lag``, `seatrial.ident.models.nomoto.output`). The delay of a shaft behind its command
in a log check or in the restored sign of a shaft speed is a grid search
(`seatrial.ident.numerics.fit_first_order_lag`) and needs no derivative.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from seatrial.ident.model.signal_id import SignalId

HISTORY_STEP = 0.1  # s between the copies ``NAME~k`` of an input


@lru_cache(maxsize=4096)  # an effect asks for forty names in each evaluation of a model
def tap_name(name: str, tap: int, step: float | None = None) -> str:
    """Return the name of a delayed copy of an input, for example ``n_left~3``, or ``n_left~3x0.05s`` with a ``step``.

    Parameters
    ----------
    name : str
        Name of the input, without a tap. Without ``step``, a tap that the name has is replaced.
    tap : int
        Delay of the copy in steps; negative (``n_left~-1``) for a copy of later values. 0: the result is ``name``
        itself.
    step : float or None
        Length of a step [s], if it is to be part of the name. None: the name contains only ``tap``.
    """
    if not tap:
        return name
    return str(SignalId.parse(name)._replace(tap=tap)) if step is None else f"{name}~{tap}x{step:g}s"


def delay_weights(position: Any, n: int) -> list[Any]:
    """Return the weights of n equidistant samples for interpolation by cubic convolution (Keys 1981).

    Parameters
    ----------
    position : float or symbol
        Position of the interpolated value in sample intervals, from 0 (first sample) to n - 1 (last sample). One sample
        more at each end is extrapolated linearly. Weights for a position outside this range are wrong (their sum is not
        one), without an error.
    n : int
        Number of samples, at least two.

    Returns
    -------
    list
        n weights. At an integer position, the weight of that sample is one and all others are zero.
    """
    if isinstance(position, float):  # at most four weights of a number are not zero
        weights = [0.0 if abs(position - k) >= 2.0 else _keys(abs(position - k)) for k in range(n)]
    else:
        weights = [_keys(abs(position - k)) for k in range(n)]
    before, after = _keys(position + 1.0), _keys(float(n) - position)
    weights[0], weights[1] = weights[0] + 2.0 * before, weights[1] - before
    weights[-1], weights[-2] = weights[-1] + 2.0 * after, weights[-2] - after
    return weights


def _keys(s: Any) -> Any:
    """Return the kernel of cubic convolution at the distance ``s`` >= 0, in sample intervals (Keys 1981, eq. 15).

    The kernel is 1 at zero, and 0 at one and from two intervals on.
    """
    near = 1.0 + s * s * (1.5 * s - 2.5)
    far = 2.0 + s * (-4.0 + s * (2.5 - 0.5 * s))
    return (s < 1.0) * near + (s >= 1.0) * (s < 2.0) * far


def weighted_sum(weights: Iterable[Any], values: Iterable[Any]) -> Any:
    """Return the sum of each weight times its value; 0 without values.

    A value whose weight is the number 0.0 does not count, even if it is NaN. Raise ValueError if the numbers of weights
    and values differ.
    """
    pairs = zip(weights, values, strict=True)
    # Most weights of an interpolation are zero. For arrays of values, the products would take most of the time.
    return sum(w * value for w, value in pairs if not (isinstance(w, float) and w == 0.0))
