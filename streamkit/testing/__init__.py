"""Conformance tests for plugin authors.

>>> from streamkit.testing import check
>>> from streamkit.builtin.potentials import Plummer
>>> check(Plummer)

``streamkit.testing.reference`` holds the slow, obvious oracle that integrators are compared with.
"""

from __future__ import annotations

from typing import Any

from streamkit import Component, Integrator, Observable, Potential, Stripping
from streamkit.testing import integrators, observables, potentials, stripping
from streamkit.testing.common import COMMON, Check, failures

__all__ = ["check", "checks"]


def check(cls: type[Component], **options: Any) -> None:
    """Build ``cls(**cls.example)`` and run every check of its role.

    Parameters
    ----------
    cls
        A component class: potential, stripping scheme, integrator or observable.
    **options
        ``negative_density=True`` for a potential that is meant to have one somewhere;
        ``accuracy=1e-8`` for an integrator without a field ``step``: the relative error it may make over a
        good part of a radial period (1e-5 unless told).

    Raises AssertionError: One error with a line for each check that failed.
    """
    todo = checks(cls, **options)
    name = f"{cls.__module__}.{cls.__name__}"
    try:
        component = cls(**cls.example)
    except Exception as error:  # an example that does not validate is the first thing to report
        raise AssertionError(f"{name}: {cls.__name__}(**{cls.__name__}.example) raised {error}") from error
    lines = failures(component, todo)
    if lines:
        head = f"{name} ({cls.role} {cls.kind!r}) fails {len(lines)} of {len(todo)} checks:"
        raise AssertionError("\n  ".join([head, *lines]))


def checks(cls: type[Component], *, negative_density: bool = False, accuracy: float = 1e-5) -> tuple[Check, ...]:
    """Return the checks that `check` runs on a class. Each takes the example component."""
    if issubclass(cls, Potential):
        return COMMON + potentials.checks(negative_density)
    if issubclass(cls, Stripping):
        return COMMON + stripping.CHECKS
    if issubclass(cls, Integrator):
        return COMMON + integrators.checks(accuracy)
    if issubclass(cls, Observable):
        return COMMON + observables.CHECKS
    raise AssertionError(f"{cls!r} is no potential, stripping scheme, integrator or observable class")
