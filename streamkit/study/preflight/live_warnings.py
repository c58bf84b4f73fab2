"""Warnings about live progenitors, and about data that only these can be compared with."""

from __future__ import annotations

from streamkit.components import LiveStripping
from streamkit.runfile import Spec, StreamInputs
from streamkit.stream import Stream

FEW = 300.0  # equal particles that those of a live progenitor should be worth


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


def weight_warnings(spec: Spec, inputs: StreamInputs, stream: Stream) -> list[str]:
    """Return a warning where few particles stand for most stars of a live progenitor, or of its debris."""
    if not isinstance(inputs.stripping, LiveStripping):
        return []
    for which, weight in (("those that have left it", stream.weight[~stream.bound]), ("all of them", stream.weight)):
        if not weight.any():
            continue
        worth = weight.sum() ** 2 / (weight**2).sum()  # Kish 1965
        if worth < min(FEW, 0.5 * len(weight)):
            return [
                f"Few particles of the progenitor stand for most of its stars: by their weights, {which} "
                f"({len(weight)}) are worth {worth:.0f} equal ones, and have the noise of so few. Raise "
                f"{spec.prefix(inputs.name)}stripping.particles."
            ]
    return []
