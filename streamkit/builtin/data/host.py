"""Data that are no stream: a measured rotation curve, and priors on numbers derived from the host."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, field_validator

import streamkit as sk


class RotationCurve(sk.HostData):
    """Circular velocities in the plane at several radii, with an error common to all of them."""

    kind = "rotation_curve"
    example: ClassVar[dict[str, Any]] = {
        "table": {"R": [6.0, 10.0, 20.0], "v_c": [231.0, 228.0, 204.0], "error": [1.5, 1.0, 5.0]}
    }

    table: Annotated[sk.Table, sk.Columns(R="kpc", v_c="km/s", error="km/s").positive("R", "v_c", "error")] = Field(
        description="Cylindrical radii, circular velocities and their independent errors."
    )
    systematic: sk.Number = Field(
        default=0.0, ge=0, lt=1, description="Error of the scale of all velocities together, a fraction of them."
    )

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return the velocities and their whole errors in km/s."""
        v_c = self.table["v_c"]
        return v_c, np.hypot(self.table["error"], self.systematic * v_c)

    def covariance(self) -> sk.Array | None:
        """Return that of independent errors and a common one; None without the latter."""
        common = self.systematic * self.table["v_c"]
        return np.diag(self.table["error"] ** 2) + np.outer(common, common) if self.systematic else None

    def predict(self, host: sk.HostView) -> sk.Prediction:
        """Return the host's circular velocities."""
        radii = self.table["R"]
        return _exact([f"v_c({r:g} kpc)" for r in radii], host.circular_velocity(radii))

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return a table with independent Gaussian noise, and one of the scale that all velocities share."""
        mean = prediction.mean
        drawn = mean * (1 + self.systematic * rng.normal()) + self.table["error"] * rng.normal(size=len(mean))
        return {"table": self.table.to_dict() | {"v_c": drawn.tolist()}}

    def radii(self) -> dict[str, float]:
        """Return both ends of the curve."""
        radii = self.table["R"]
        return {"rotation curve, first": float(radii.min()), "rotation curve, last": float(radii.max())}


class _OneNumber(sk.HostData):
    """One positive number and its error, in the field that ``datum`` names."""

    datum: ClassVar[str]

    @field_validator("v_c", "mass", "q", check_fields=False)
    @classmethod
    def _is_positive(cls, datum: tuple[float, float]) -> tuple[float, float]:
        if not datum[0] > 0:
            raise ValueError(f"expected a positive number and its error, found {datum[0]:g}")
        return datum

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return the number and its error."""
        value, error = getattr(self, self.datum)
        return np.array([value]), np.array([error])

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return the number with Gaussian noise of its error."""
        error = float(getattr(self, self.datum)[1])
        return {self.datum: [float(rng.normal(prediction.mean[0], error)), error]}


class CircularVelocity(_OneNumber):
    """A circular velocity in the plane at one radius, such as that at the Sun."""

    kind = "circular_velocity"
    datum = "v_c"
    example: ClassVar[dict[str, Any]] = {"radius": 8.0, "v_c": ("229 km/s", "7 km/s")}

    radius: sk.Length = Field(description="Cylindrical radius.")
    v_c: sk.VelocityDatum = Field(description="Circular velocity and its error.")

    def predict(self, host: sk.HostView) -> sk.Prediction:
        """Return the host's."""
        return _exact(["v_c"], host.circular_velocity(np.array([self.radius])))

    def radii(self) -> dict[str, float]:
        """Return the radius."""
        return {"circular velocity": self.radius}


class EnclosedMass(_OneNumber):
    """A mass inside one radius."""

    kind = "enclosed_mass"
    datum = "mass"
    example: ClassVar[dict[str, Any]] = {"radius": 20.0, "mass": (2.5e11, 0.2e11)}

    radius: sk.Length = Field(description="Spherical radius.")
    mass: sk.MassDatum = Field(description="Mass inside it and its error.")

    def predict(self, host: sk.HostView) -> sk.Prediction:
        """Return the host's."""
        return _exact(["mass"], host.mass_inside(np.array([self.radius])))

    def radii(self) -> dict[str, float]:
        """Return the radius."""
        return {"enclosed mass": self.radius}


class Flattening(_OneNumber):
    """The flattening of the potential at one place, sqrt(z a_R / (R a_z)): its axis ratio, 1 for a sphere."""

    kind = "flattening"
    datum = "q"
    reference = "Bovy, Bahmanyar, Fritz & Kallivayalil 2016, ApJ 833, 31"
    example: ClassVar[dict[str, Any]] = {"radius": 12.5, "z": 6.7, "q": (0.95, 0.04)}

    radius: sk.Length = Field(description="Cylindrical radius of the place.")
    z: sk.Coordinate = Field(description="Height of the place above the plane; not 0.")
    q: sk.NumberDatum = Field(description="Flattening and its error.")

    @field_validator("z")
    @classmethod
    def _off_the_plane(cls, value: float) -> float:
        if value == 0:
            raise ValueError("in the plane the potential has no flattening; expected a height other than 0")
        return value

    def predict(self, host: sk.HostView) -> sk.Prediction:
        """Return the host's; none where a force points outwards."""
        return _exact(["q"], host.flattening(np.array([self.radius]), np.array([self.z])))

    def radii(self) -> dict[str, float]:
        """Return the distance of the place from the centre."""
        return {"flattening": float(np.hypot(self.radius, self.z))}


def _exact(names: list[str], values: sk.Array) -> sk.Prediction:
    """Return a prediction without noise; a reason where the host has no such number."""
    why_not = "" if np.isfinite(values).all() else "the host has no such number there"
    return sk.Prediction(tuple(names), np.where(np.isfinite(values), values, np.nan), np.zeros(len(values)), why_not)
