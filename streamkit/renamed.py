"""Former names of public attributes and methods: each works for one MINOR version, with a DeprecationWarning."""

from __future__ import annotations

import warnings
from typing import Any


class Renamed:
    """A former name of an attribute or method, as an attribute of its class: ``Seen.phi1 = Renamed("phi1", "lon")``.

    Reading it gives the attribute of the present name, with a DeprecationWarning that names it.

    Parameters
    ----------
    former, name
        The former and the present name of the attribute.
    """

    def __init__(self, former: str, name: str) -> None:
        self._former, self._name = former, name

    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is None:
            return self
        _warn(owner, self._former, self._name)
        return getattr(instance, self._name)


def adopt(cls: type, former: str, name: str) -> None:
    """Rename an attribute of a class from its former to its present name. For ``__init_subclass__`` of a base class."""
    if former in cls.__dict__:
        _warn(cls, former, name)
        setattr(cls, name, cls.__dict__[former])
        delattr(cls, former)


def _warn(owner: type, former: str, name: str) -> None:
    text = f"{owner.__name__}.{former} is now {name}: the next minor version has the latter name alone"
    warnings.warn(text, DeprecationWarning, stacklevel=3)
