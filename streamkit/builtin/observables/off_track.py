"""Built-in observable: the share of stars beside the track of a stream, as in a spur."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

import streamkit as sk
from streamkit.builtin.observables.track.along import FRAME, Arm, Kernel, datum_panel, gaps_along
from streamkit.builtin.observables.track.columns import middle_of, within
from streamkit.builtin.observables.track.lines import (
    beyond_seam,
    debris_of,
    gather,
    is_enough,
    kernels,
    lines_at,
    too_few,
)
from streamkit.builtin.observables.track.panels import longitude_label

PASSES = 3  # fits of the track; each leaves out the particles that the one before found beside it


class OffTrack(sk.Observable):
    """The share of a stream's stars that lie beside its track, at longitudes phi1: the spur of an encounter.

    The track is the mean phi2 of the debris under a kernel, fitted without the stars beside it. A star is beside it if
    its phi2 is more than ``beyond`` off. The data are shares of the stream's stars, without the field.
    """

    kind = "off_track"
    reference = "Bonaca, Hogg, Price-Whelan & Conroy 2019, ApJ 880, 38: the spur of GD-1"
    example: ClassVar[dict[str, Any]] = {
        "frame": {"pole": [192.86, 27.13], "origin": [266.4, -28.94]},
        "table": {"phi1": [-20.0, 0.0, 20.0], "share": [0.2, 0.2, 0.2], "error": [0.1, 0.1, 0.1]},
        "beyond": 2.0,
        "kernel": 5.0,
    }

    frame: sk.Frame = Field(description=FRAME.format("phi1 and phi2"))
    table: Annotated[sk.Table, sk.Columns(phi1="deg", share="", error="").between("share", 0, 1).positive("error")] = (
        Field(description="Share of the stream's stars about each longitude that lie beside the track, and its error.")
    )
    beyond: sk.Angle = Field(gt=0, le=45, description="Distance from the track beyond which a star is beside it.")
    side: Literal["above", "below", "both"] = Field(
        default="both", description="Whether stars above the track count (larger phi2), below it, or both."
    )
    kernel: Kernel = 2.0
    arm: Arm = "both"

    def sky_frame(self) -> sk.Frame:
        """Return the frame of phi1."""
        return self.frame

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return the shares and their errors (m,)."""
        return self.table["share"], self.table["error"]

    def predict(self, stream: sk.Stream) -> sk.Prediction:
        """Return the shares; their variance is the binomial one of so many particles.

        The details hold the number of particles (m,) under the kernel at each longitude.
        """
        phi1 = self.table["phi1"]
        names = tuple(f"share off the track at {angle:g}" for angle in phi1.tolist())
        if not is_enough(stream, debris_of(stream, self.arm)):
            return too_few(names)
        share, variance, number = self._shares(stream, phi1)
        return sk.Prediction(names, share, variance, details={"particles": number})

    def _shares(self, stream: sk.Stream, at: sk.Array) -> tuple[sk.Array, sk.Array, sk.Array]:
        """(m,) Share, variance and number of particles at longitudes (m,)."""
        chosen, seen = debris_of(stream, self.arm), stream.seen(self.frame)
        middle = middle_of(self.table["phi1"])
        longitude, at = (within(angle, middle) - middle for angle in (seen.lon[chosen], at))
        beside = self._beside(longitude, seen.lat[chosen], stream.weight[chosen])
        near = kernels(np.subtract.outer(at, longitude) / self.kernel) * stream.weight[chosen]
        number = near.sum(axis=1)
        share = near @ beside / number
        # Agresti & Coull: two more stars of each kind, or the variance of a share of 0 or 1 would be zero
        effective = number**2 / (near**2).sum(axis=1)
        middle_share = (share * effective + 2.0) / (effective + 4.0)
        return share, middle_share * (1.0 - middle_share) / (effective + 4.0), number

    def _beside(self, longitude: sk.Array, latitude: sk.Array, weight: sk.Array) -> sk.Array:
        """(n,) 1 for particles beside the track, 0 for the others."""
        off, kept = np.zeros_like(latitude), np.ones(len(latitude), dtype=bool)
        margin = beyond_seam(longitude, self.kernel)
        for _ in range(PASSES):
            debris = gather(longitude[kept], [latitude[kept]], weight[kept], margin)
            off = latitude - lines_at(debris, longitude, self.kernel).value[0]
            near = np.abs(off) <= self.beyond
            kept = near if near.any() else kept
        signed = {"above": off, "below": -off, "both": np.abs(off)}[self.side]
        return np.asarray(signed > self.beyond, dtype=float)

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return a table with Gaussian numbers by the errors, between 0 and 1."""
        drawn = np.clip(rng.normal(prediction.mean, self.table["error"]), 0.0, 1.0)
        return {"table": self.table.to_dict() | {"share": drawn.tolist()}}

    def panels(self, stream: sk.Stream, prediction: sk.Prediction) -> tuple[sk.Panel, ...]:
        """Return a picture of the shares and of the model, with the residuals."""
        labels, places = (longitude_label(self.frame, False), "share off the track"), stream.seen(self.frame).lon
        data = self.table["phi1"], *self.data()
        return (datum_panel(labels, places, data, prediction, lambda at: self._shares(stream, at)[0]),)

    def remarks(self, prediction: sk.Prediction) -> tuple[str, ...]:
        """Warn of data where the stream has no debris."""
        return gaps_along("off_track: {} of {} data", self.table["phi1"], prediction, self.kernel)
