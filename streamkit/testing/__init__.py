"""Conformance tests for plugin authors.

>>> from streamkit.testing import check
>>> from streamkit.builtin.potentials.closed_forms import Plummer
>>> check(Plummer)

``streamkit.testing.reference`` holds the slow, obvious oracle that integrators are compared with.
"""

from __future__ import annotations

from typing import Any

from streamkit import Component, HostData, Integrator, LiveStripping, Observable, Potential, Sampler, Stripping
from streamkit.testing import (
    common,
    dimensions,
    host_data,
    integrators,
    live,
    observables,
    potentials,
    samplers,
    stored_runs,
    stripping,
    use,
)
from streamkit.testing.common import Check, failures, title
from streamkit.testing.contained import in_a_process, killed
from streamkit.testing.quick import quick_failures

__all__ = ["check", "checks", "killed", "quick_failures"]

COMMON = (*common.COMMON, use.keeps_no_state, use.prints_nothing)


def check(cls: type[Component], **options: Any) -> None:
    """Build ``cls(**cls.example)`` and run every check of its role, in a process of their own where there is fork.

    Of a potential it prints M(<r) and v_c at a few radii: look whether they are what you meant (``pytest -s``).

    Parameters
    ----------
    cls
        A component class: potential, stripping scheme, integrator, observable, data on the host or sampler.
    **options
        ``negative_density=True`` for a potential that is meant to have one somewhere;
        ``accuracy=1e-8`` for an integrator without a field ``step``: the relative error it may make over a
        good part of a radial period (default 1e-5);
        ``slow=True`` for what is meant for single streams, not for fits.

    Raises AssertionError: One error with a line for each check that failed.
    """
    todo = checks(cls, **options)
    name = f"{cls.__module__}.{cls.__name__}"
    try:
        component = cls(**cls.example)
    except Exception as error:  # an example that does not validate is the first thing to report
        raise AssertionError(f"{name}: {cls.__name__}(**{cls.__name__}.example) raised {error}") from error
    lines = in_a_process(lambda: failures(component, todo))
    if isinstance(component, Potential) and not lines:
        print(f"{name} with {component!r}\n{dimensions.profile(component)}")  # noqa: T201  for the author's eye
    if lines:
        head = f"{name} ({cls.role} {cls.kind!r}) fails {len(lines)} of {len(todo)} checks:"
        raise AssertionError("\n  ".join([head, *lines]))


def checks(
    cls: type[Component], *, negative_density: bool = False, accuracy: float = 1e-5, slow: bool = False
) -> tuple[Check, ...]:
    """Return the checks that `check` runs on a class. Each takes the example component."""
    by_role: dict[type[Component], tuple[Check, ...]] = {
        Potential: COMMON + potentials.checks(negative_density),
        Stripping: COMMON + stripping.CHECKS,
        LiveStripping: COMMON + live.CHECKS,
        Integrator: COMMON + integrators.checks(accuracy),
        Observable: COMMON + observables.CHECKS,
        HostData: COMMON + host_data.CHECKS,
        Sampler: (*samplers.CHECKS, stored_runs.survives_its_files),
    }
    for role, of_role in by_role.items():
        if issubclass(cls, role):
            return tuple(check for check in of_role if not (slow and title(check).endswith("is fast")))
    raise AssertionError(
        f"{cls!r} is no potential, stripping scheme, integrator, observable, host data or sampler class"
    )
