"""The quick half of the conformance tests, for the components of a run: seconds in all, and nothing is compiled."""

from __future__ import annotations

import time

from streamkit import Component, LiveStripping, OutOfDomain, Potential, Stripping
from streamkit.testing import dimensions, live, potentials, stripping, use
from streamkit.testing.common import Check, failures

POTENTIAL: tuple[Check, ...] = (
    potentials.arrays_in_arrays_out,
    use.keeps_no_state,
    potentials.pulls_inwards,
    potentials.is_curl_free,
    potentials.energy_matches_force,
    dimensions.mass_agrees_with_force,
    dimensions.has_dimensions,
    dimensions.time_is_not_converted_twice,
)
STRIPPING: tuple[Check, ...] = (
    use.keeps_no_state,
    stripping.release_has_the_right_shape,
    stripping.uses_its_draws,
    stripping.tails_lie_on_their_sides,
)
LIVE: tuple[Check, ...] = (use.keeps_no_state, *live.CHECKS)
BUDGET = 1.5  # seconds after which no further check begins


def quick_failures(component: Component) -> list[str]:
    """Return a line for each failure of the quick checks of a component with its fields as they are.

    Only potentials and stripping schemes have such checks: trial streams show the faults of other components. A force
    without a value at some position passes.
    """
    of_role = {Potential: POTENTIAL, Stripping: STRIPPING, LiveStripping: LIVE}
    todo = next((checks for base, checks in of_role.items() if isinstance(component, base)), ())
    lines: list[str] = []
    begin = time.perf_counter()
    for check in todo:
        if time.perf_counter() - begin < BUDGET:
            lines += failures(component, [check], passes=(OutOfDomain,))
    return lines
