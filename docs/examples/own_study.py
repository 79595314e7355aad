"""User-defined study: `seatrial ident study docs/examples/own_study.py:calm --out study` (docs/how-to/study.md)."""

import numpy as np

from seatrial.ident.estimation import SampledInputs
from seatrial.ident.models import surge_model
from seatrial.ident.studies import Case

t = np.arange(0.0, 200.0, 0.1)
thrust = 40.0 * np.sign(np.sin(2 * np.pi * t / 25))[:, None]  # N, forward and reverse
calm = Case("calm", surge_model().with_values({"d_u": 6.0}), SampledInputs.held(t, thrust), every={"position": 2})
