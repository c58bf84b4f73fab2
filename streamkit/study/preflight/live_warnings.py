"""Warnings about live progenitors, and about data that only these can be compared with."""

from __future__ import annotations

from streamkit.components import LiveStripping
from streamkit.runfile import Spec, StreamInputs


def live_warnings(spec: Spec, inputs: StreamInputs) -> list[str]:
    """Return the warnings about the stripping scheme beside the data, and about a start that slides."""
    prefix, scheme = spec.prefix(inputs.name), inputs.stripping
    if isinstance(scheme, LiveStripping):
        path = f"{prefix}progenitor.lookback"
        if scheme.passages is not None or path not in spec.names:
            return []
        return [
            f"{path} is free, and ln L of a live progenitor has a step where it passes an apocentre. Give "
            f"{prefix}stripping.passages, make a fit for each number of passages, and compare their ln L."
        ]
    return [
        f"The observable {name} ({observable.kind}) depends on the rate at which debris leaves. "
        f"{prefix}stripping.kind = '{scheme.kind}' assumes a rate: its densities differ from those of live satellites "
        "by factors of 2 to 7. Choose the kind 'restricted_nbody'."
        for name, observable in inputs.observables.items()
        if observable.wants_live
    ]
