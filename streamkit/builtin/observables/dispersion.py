"""Built-in observable: the dispersion of radial velocities along a stream."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

import streamkit as sk
from streamkit.builtin.observables.track.along import Arm, Kernel, Longitudes, datum_panel, gaps_along
from streamkit.builtin.observables.track.columns import middle_of, within
from streamkit.builtin.observables.track.lines import (
    ENOUGH,
    Lines,
    beyond_seam,
    debris_of,
    gather,
    is_enough,
    local_lines,
    too_few,
)
from streamkit.builtin.observables.track.panels import longitude_label


class Dispersion(sk.Observable):
    """The dispersion of radial velocities along a stream, at longitudes phi1.

    At each longitude a line is fitted to the velocities of the debris under a kernel; the dispersion is the standard
    deviation about it, so a gradient along the stream does not count. The data are dispersions of the stars themselves,
    without the errors of their velocities. Encounters with subhaloes heat a stream, and so do binaries and the
    progenitor: leave out its longitudes.
    """

    kind = "dispersion"
    reference = "Gialluca, Naidu & Bonaca 2021, ApJL 911, L32: the dispersion of GD-1"
    example: ClassVar[dict[str, Any]] = {
        "frame": {"pole": [192.86, 27.13], "origin": [266.4, -28.94]},
        "table": {"phi1": [-20.0, 0.0, 20.0], "dispersion": [9.0, 8.0, 9.0], "error": [1.0, 1.0, 1.0]},
        "kernel": 5.0,
    }

    frame: Longitudes
    table: Annotated[
        sk.Table,
        sk.Columns(phi1="deg", dispersion="km/s", error="km/s").between("dispersion", 0, np.inf).positive("error"),
    ] = Field(description="Dispersion of the radial velocities of the stars about each longitude, and its error.")
    kernel: Kernel = 2.0
    arm: Arm = "both"

    def sky_frame(self) -> sk.Frame:
        """Return the frame of phi1."""
        return self.frame

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return the dispersions and their errors (m,) in km/s."""
        return self.table["dispersion"], self.table["error"]

    def predict(self, stream: sk.Stream) -> sk.Prediction:
        """Return the dispersions; their variance is that of a standard deviation of so many particles.

        The details hold ln of the number of particles (m,) under the kernel at each longitude.
        """
        phi1 = self.table["phi1"]
        names = tuple(f"dispersion at {angle:g}" for angle in phi1.tolist())
        if not is_enough(stream, debris_of(stream, self.arm)):
            return too_few(names)
        lines = self._lines(stream, phi1)
        return sk.Prediction(names, lines.spread[0], lines.depth_variance, details={"ln_count": lines.ln_count})

    def _lines(self, stream: sk.Stream, at: sk.Array) -> Lines:
        chosen, seen = debris_of(stream, self.arm), stream.seen(self.frame)
        middle = middle_of(self.table["phi1"])
        longitude, at = (within(angle, middle) for angle in (seen.lon[chosen], at))
        margin = beyond_seam(at - middle, self.kernel)
        debris = gather(longitude, [seen.radial_velocity[chosen]], stream.weight[chosen], margin)
        return local_lines(debris, at, self.kernel, depth=0)

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return a table with Gaussian numbers by the errors, none of them negative."""
        drawn = np.maximum(rng.normal(prediction.mean, self.table["error"]), 0.0)
        return {"table": self.table.to_dict() | {"dispersion": drawn.tolist()}}

    def panels(self, stream: sk.Stream, prediction: sk.Prediction) -> tuple[sk.Panel, ...]:
        """Return a picture of the dispersions and of the model, with the residuals."""
        labels = longitude_label(self.frame, False), r"dispersion of $v_r$ [km s$^{-1}$]"
        places, data = stream.seen(self.frame).lon, (self.table["phi1"], *self.data())
        return (datum_panel(labels, places, data, prediction, lambda at: self._lines(stream, at).spread[0]),)

    def remarks(self, prediction: sk.Prediction) -> tuple[str, ...]:
        """Warn of data where the stream has no debris."""
        subject, phi1 = "dispersion: {} of {} data", self.table["phi1"]
        return gaps_along(subject, phi1, prediction, self.kernel, "ln_count", np.log(ENOUGH))
