"""How the answer of a run moves with its calls: parameters and a mass at each stage of the sampling."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from streamkit.components import FINE, LEVELS
from streamkit.model import Host
from streamkit.observe import radii_of
from streamkit.runfile import Spec
from streamkit.sample import Weighted

MOST = 200  # samples whose masses are computed


class AnswerHistory:
    """The stages of one run so far. A resumed run passes through all of them again, and its calls cost nothing."""

    def __init__(self, spec: Spec) -> None:
        self._spec = spec
        self._stages: list[dict[str, Any]] = []

    @cached_property
    def _radius(self) -> float:
        """The radius of the mass in kpc; a chain, which has no stages, does not need it."""
        return measured_radius(self._spec)

    def after(self, weighted: Weighted, asked: tuple[int, int]) -> dict[str, Any]:
        """Return the history with the stage of these samples, after so many calls with all particles and with few.

        Keys: names (q,), and stages, each with calls, small_calls, the worst level of the sampler's own checks, and
        intervals (q, 3): low end, median and high end of the central 68 %.
        """
        drawn = weighted.points[weighted.drawn(self._spec.seed)]
        radius = np.array([self._radius])
        hosts = (Host(self._spec.host(theta)) for theta in drawn[:MOST])
        columns = [*drawn.T, np.array([host.mass_inside(radius)[0] / 1e11 for host in hosts])]
        level = max((each.level for each in weighted.verdicts), key=LEVELS.index, default=FINE)
        self._stages.append({
            "calls": asked[0],
            "small_calls": asked[1],
            "level": level,
            "intervals": [np.percentile(column, [16, 50, 84]).tolist() for column in columns],
        })
        mass = f"M(<{self._radius:g} kpc) [1e11 Msun]"
        return {"names": [*self._spec.names, mass], "stages": list(self._stages)}


WITHOUT_RADII = 20.0  # kpc, where no datum has a radius


def measured_radius(spec: Spec) -> float:
    """Return the largest radius of the data in kpc, or that of a progenitor where none is known, with two digits."""
    bound = spec.bind_all()
    measured = [radii_of(inputs.observables) for inputs in bound.streams.values()] + [radii_of(bound.data)]
    radii = [radius for each in measured for radius in each.values()]
    radii = radii or [float(np.sqrt(inputs.q @ inputs.q)) for inputs in bound.streams.values()]
    return float(f"{max(radii, default=WITHOUT_RADII):.2g}")
