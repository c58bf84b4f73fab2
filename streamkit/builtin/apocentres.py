"""Built-in observables: the apocentres of the two arms and the differential precession."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from streamkit import AngleDatum, Array, BoolArray, LengthDatum, Number, Observable, Orbit, Prediction, Stream
from streamkit.builtin.apocentre_mean import fit_arm
from streamkit.builtin.apocentre_ridge import fit_turning
from streamkit.builtin.apocentre_track import COVERAGE, ArmFit
from streamkit.builtin.unwrap import unwrap_by_phase

NAMES = ("leading", "trailing", "precession")


class Apocentres(Observable):
    """Leading and trailing apocentre radius, and the differential precession between them.

    Each arm's track r(angle) has its first maximum near the progenitor's own next (leading) or previous (trailing)
    apocentre; a Gaussian in angle fitted within 40 degrees of it gives radius and angle. There is none where too
    little of the fitted debris is on either side of it (`coverage`). Debris of several stripping passages overlaps at
    the trailing one: `recent_debris` says what is done about it. The precession is 360 deg - (m_L + |m_T|), angles at
    the Galactic centre in the progenitor's orbital plane.
    """

    kind = "apocentres"
    reference = "Gibbons, Belokurov & Evans 2014, MNRAS 445, 3788, section 3.4"
    example: ClassVar[dict[str, Any]] = {
        "leading": ("47.8 kpc", "0.5 kpc"),
        "trailing": ("102.5 kpc", "2.5 kpc"),
        "precession": ("93.2 deg", "3.5 deg"),
    }

    leading: LengthDatum | None = Field(
        default=None, description="Leading apocentre and its error, in kpc. Left out: not used."
    )
    trailing: LengthDatum | None = Field(
        default=None, description="Trailing apocentre and its error, in kpc. Left out: not used."
    )
    precession: AngleDatum | None = Field(
        default=None, description="Differential precession and its error, in degrees. Left out: not used."
    )
    recent_debris: Literal["literal", "epoch_aware", "turning"] = Field(
        default="turning",
        description="Which trailing debris is too recent to count. 'literal' (the paper): stripped since the "
        "progenitor's last apocentre. 'epoch_aware': stripped since its second-to-last apocentre, that is in the "
        "last completed stripping passage. 'turning' (the default): what passes by the branch that turns round, "
        "whenever stripped: it asks nothing of a star but its place.",
    )
    coverage: Number = Field(
        default=COVERAGE,
        ge=0,
        lt=0.5,
        description="Least share of the fitted debris on either side of an apocentre: with less there is none.",
    )
    phase: Literal["winding", "chi"] = Field(
        default="winding",
        description="How arms and wraps are told apart: by the angle swept, or by the paper's phase chi.",
    )

    def data(self) -> tuple[Array, Array]:
        """Return the observed (leading, trailing, precession) and errors, NaN where left out."""
        pairs = [getattr(self, name) or (np.nan, np.nan) for name in NAMES]
        values, errors = np.array(pairs).T
        return values, errors

    def predict(self, stream: Stream) -> Prediction:
        """Measure both apocentres (kpc) and the precession (deg)."""
        try:
            fits = self._fits(stream)
        except _NoValue as none:
            return Prediction(NAMES, np.full(3, np.nan), np.full(3, np.nan), why_not=str(none))
        lead, trail = fits["leading"], fits["trailing"]
        mean = np.array([lead.radius, trail.radius, 360.0 - lead.angle + trail.angle])
        variance = np.array([lead.variance[0], trail.variance[0], lead.variance[1] + trail.variance[1]])
        return Prediction(NAMES, mean, variance, details=_details(fits))

    def _fits(self, stream: Stream) -> dict[str, ArmFit]:
        if len(stream) == 0 or stream.bound.all():
            raise _NoValue("no particle has left the progenitor")
        guide_lead, guide_trail = self._guides(stream)
        angle = np.degrees(stream.winding)
        if self.phase == "chi":
            angle = unwrap_by_phase(angle, stream.chi, stream.bound)
        fits = {}
        fit_trailing = fit_turning if self.recent_debris == "turning" else fit_arm
        for arm, fitted, guide, chosen in (
            ("leading", fit_arm, guide_lead, ~stream.bound & (angle > 0)),
            ("trailing", fit_trailing, guide_trail, self._trailing(stream, angle)),
        ):
            fit = fitted(angle[chosen], stream.r[chosen], stream.weight[chosen], guide, self.coverage)
            if isinstance(fit, str):
                raise _NoValue(f"{arm} arm: {fit}")
            fits[arm] = fit
        return fits

    def _guides(self, stream: Stream) -> tuple[float, float]:
        """Angles in degrees of the progenitor's next and previous apocentre, seen from the Galactic centre."""
        if stream.future is None:
            raise _NoValue("the progenitor is unbound or has no next apocentre")
        past = stream.orbit.apocentres()
        needed = 2 if self.recent_debris == "epoch_aware" else 1
        if len(past) < needed:
            raise _NoValue(
                f"the look-back time covers fewer than {needed} apocentre{'s' * (needed > 1)} of the progenitor"
            )
        return _swept(stream.future, stream.future.apocentres()[0]), -_swept(stream.orbit, past[-1])

    def _trailing(self, stream: Stream, angle: Array) -> BoolArray:
        """Trailing particles stripped early enough."""
        trailing = np.asarray(~stream.bound & (angle < 0))
        if self.recent_debris == "turning":
            return trailing
        cut = stream.orbit.apocentres()[-1 if self.recent_debris == "literal" else -2]
        return np.asarray(trailing & (stream.t_strip < cut))


class _NoValue(Exception):  # noqa: N818  a reason on its way to Prediction.why_not
    """There is no value, and this is why."""


def _swept(orbit: Orbit, t: float) -> float:
    """Angle in degrees that the orbit sweeps between time t and today (t = 0 is one of its ends)."""
    inside = orbit.t >= t if t < 0 else orbit.t <= t
    q = np.concatenate([orbit.at(np.array([t])).q, orbit.q[:, inside]], axis=1)
    if t > 0:
        q = np.concatenate([orbit.q[:, inside], orbit.at(np.array([t])).q], axis=1)
    unit = q / np.sqrt((q**2).sum(axis=0))
    cosine = np.clip((unit[:, 1:] * unit[:, :-1]).sum(axis=0), -1.0, 1.0)
    return float(np.degrees(np.arccos(cosine).sum()))


def _details(fits: dict[str, ArmFit]) -> dict[str, Array]:
    details: dict[str, Array] = {}
    for arm, fit in fits.items():
        details[f"{arm}_angle"], details[f"{arm}_track"] = fit.track
        details[f"{arm}_fit_angle"], details[f"{arm}_fit"] = fit.curve
        details[f"{arm}_peak"] = np.array([fit.angle, fit.radius])
    return details
