"""seatrial: measure a boat and its thrusters, excite them with designed inputs, and explain what was measured.

The names below are the Python interface. Each is imported at its first use, so that ``import seatrial`` is fast.

    import seatrial as st

    fit = st.fit(["run1.mcap", "run2.mcap"], validate=["run3.mcap"])
    print(fit.summary())
"""

import lazy_loader

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Import a public name at its first use. The version is that of the installed package.

    The `UnknownAttribute` of an unknown name, which is an AttributeError, names the most similar public one.
    """
    if name == "__version__":
        from importlib.metadata import version  # imported here, because it takes a fifth of `import seatrial`

        return version("seatrial")
    try:
        return _attribute(name)
    except AttributeError:
        if name in __all__ or name.startswith("_"):
            raise
        # imported here, because only this error needs it
        from seatrial.daq.errors import UnknownAttribute, closest_name

        near = closest_name(name, __all__)
        hint = f"; did you mean {near!r}?" if near else f"; it has {', '.join(__all__)}"
        raise UnknownAttribute(f"module 'seatrial' has no attribute {name!r}{hint}", name=name, obj=None) from None
