"""The stripping rate: weights that give a stream the stripping times of another one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamkit.stream import Stream
from streamkit.units import GYR

BIN = 0.1 * GYR
"""Width of the bins in stripping time."""


def match_rate(stream: Stream, reference: Stream) -> Stream:
    """Weigh the unbound particles so that as many were stripped at each time as in the reference.

    The bound ones keep their weights, and the unbound ones their sum. Times at which the stream has lost no particle
    stay without.
    """
    begin = float(min(stream.orbit.t[0], reference.orbit.t[0]))
    edges = np.linspace(begin, 0.0, max(round(-begin / BIN), 1) + 1)
    bins, counts = [], []
    for each in (stream, reference):
        free = ~each.bound
        bins.append(np.clip(np.digitize(each.t_strip[free], edges) - 1, 0, len(edges) - 2))
        counts.append(np.bincount(bins[-1], each.weight[free], len(edges) - 1))
    own, wanted = counts
    factor = np.divide(wanted, own, out=np.zeros_like(own), where=own > 0)
    if not (factor * own).sum() > 0:
        return stream
    weight = stream.weight.copy()
    weight[~stream.bound] *= factor[bins[0]] * own.sum() / (factor * own).sum()
    return replace(stream, weight=weight)
