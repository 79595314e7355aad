"""seatrial: measure a boat and its thrusters, excite them with designed inputs, and explain what was measured.

The names below are the Python interface. Each is imported at its first use, so that ``import seatrial`` is fast.

    import seatrial as st

    fit = st.fit(["run1.mcap", "run2.mcap"], validate=["run3.mcap"])
    print(fit.summary())
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
