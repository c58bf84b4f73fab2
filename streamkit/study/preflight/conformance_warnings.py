"""Failures of the quick half of the conformance tests, for the components of a run that are not built in."""

from __future__ import annotations

import contextlib
import io

import numpy as np

from streamkit.components import Component
from streamkit.runfile import StreamInputs
from streamkit.testing import quick_failures


def conformance_warnings(inputs: StreamInputs) -> list[str]:
    """Return a paragraph for each failure; what the components print meanwhile is dropped."""
    used: dict[str, Component] = {f"potential {name}": one for name, one in inputs.potentials.items()}
    used |= {f"body {name}": body.potential for name, body in inputs.bodies.items()}
    used |= {"progenitor": inputs.satellite, "stripping": inputs.stripping}
    failures = []
    for where, component in used.items():
        if not type(component).__module__.startswith("streamkit."):
            with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
                lines = quick_failures(component)
            failures += [f"{where.removeprefix('potential ')} ({component.kind}): {line}" for line in lines]
    head = "A component of this run fails a conformance test, and its streams may be wrong. "
    return [f"{head}{line}. All tests: streamkit.testing.check." for line in failures]
