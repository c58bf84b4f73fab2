"""Built-in observables: the apocentres of the two arms and the differential precession."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator

import streamkit as sk
from streamkit.builtin.observables.apocentres.mean import fit_arm
from streamkit.builtin.observables.apocentres.ridge import fit_turning
from streamkit.builtin.observables.apocentres.track import COVERAGE, FEWEST, TOO_FEW, WINDOW, ArmFit
from streamkit.builtin.observables.apocentres.unwrap import unwrap_by_phase

NAMES = ("leading", "trailing", "precession")
ARMS = {"leading": 1, "trailing": -1}
# The arms that each datum is measured on.
NEEDS = {"leading": ("leading",), "trailing": ("trailing",), "precession": ("leading", "trailing")}
NOT_FITTED = ArmFit(np.nan, np.nan, (np.nan, np.nan), (np.empty(0), np.empty(0)), (np.empty(0), np.empty(0)))


class Apocentres(sk.Observable):
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

    leading: sk.LengthDatum | None = Field(
        default=None, description="Leading apocentre and its error, in kpc. Left out: not used."
    )
    trailing: sk.LengthDatum | None = Field(
        default=None, description="Trailing apocentre and its error, in kpc. Left out: not used."
    )
    precession: sk.AngleDatum | None = Field(
        default=None, description="Differential precession and its error, in degrees. Left out: not used."
    )
    recent_debris: Literal["literal", "epoch_aware", "turning"] = Field(
        default="turning",
        description="Which trailing debris is too recent to count. 'literal' (the paper): stripped since the "
        "progenitor's last apocentre. 'epoch_aware': stripped since its second-to-last apocentre, that is in the "
        "last completed stripping passage. 'turning' (the default): all debris counts, whenever it was stripped; where "
        "several branches have an apocentre, that of the lowest branch is measured. The rule uses positions alone.",
    )
    coverage: sk.Number = Field(
        default=COVERAGE,
        ge=0,
        lt=0.5,
        description="Least share of the fitted debris on either side of an apocentre: with less there is none.",
    )
    phase: Literal["winding", "chi"] = Field(
        default="winding",
        description="How arms and wraps are distinguished: by the angle swept, or by the paper's phase chi.",
    )

    @field_validator(*ARMS)
    @classmethod
    def _is_a_distance(cls, datum: tuple[float, float] | None) -> tuple[float, float] | None:
        if datum is not None and not datum[0] > 0:
            raise ValueError("expected an apocentre above 0 kpc")
        return datum

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return the observed (leading, trailing, precession) and errors, NaN where left out."""
        pairs = [getattr(self, name) or (np.nan, np.nan) for name in NAMES]
        values, errors = np.array(pairs).T
        return values, errors

    def quantities(self) -> dict[str, sk.IntArray]:
        """Return the row of each number."""
        return {name: np.array([row]) for row, name in enumerate(NAMES)}

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return the numbers in use with Gaussian noise of their errors."""
        values, errors = self.data()
        drawn = rng.normal(prediction.mean, np.nan_to_num(errors))
        return {
            name: [float(value), float(error)]
            for name, datum, value, error in zip(NAMES, values, drawn, errors, strict=True)
            if np.isfinite(datum)
        }

    def predict(self, stream: sk.Stream) -> sk.Prediction:
        """Measure both apocentres (kpc) and the precession (deg); NaN for what has no value and no datum."""
        fits, reasons = self._fits(stream)
        wanted = {arm for name, arms in NEEDS.items() if getattr(self, name) is not None for arm in arms} or set(ARMS)
        lost = [reason for arm, reason in reasons.items() if arm in wanted]
        if lost or not fits:
            return sk.Prediction(
                NAMES, np.full(3, np.nan), np.full(3, np.nan), why_not=(lost or list(reasons.values()))[0]
            )
        lead, trail = (fits.get(arm, NOT_FITTED) for arm in ARMS)
        mean = np.array([lead.radius, trail.radius, 360.0 - lead.angle + trail.angle])
        variance = np.array([lead.variance[0], trail.variance[0], lead.variance[1] + trail.variance[1]])
        return sk.Prediction(NAMES, mean, variance, details=_details(fits))

    def marks(self, prediction: sk.Prediction) -> tuple[sk.Mark, ...]:
        """Return track, fit and fitted apocentre of each arm, and the data at the angles of the model's apocentres.

        The data fix only the sum of the two angles, 360 deg - precession: the trailing one is set against the model's
        leading one, with the error of the precession.
        """
        marks, peaks, details = [], {}, prediction.details
        for arm in (arm for arm in ARMS if f"{arm}_peak" in details):
            peaks[arm] = details[f"{arm}_peak"]
            marks += [
                sk.Mark("track", details[f"{arm}_angle"], details[f"{arm}_track"], "smoothed track"),
                sk.Mark("fit", details[f"{arm}_fit_angle"], details[f"{arm}_fit"], "Gaussian fit"),
                sk.Mark("peak", peaks[arm][:1], peaks[arm][1:], "fitted apocentre"),
            ]
        for arm in (arm for arm in peaks if getattr(self, arm) is not None):
            (value, error), angle, spread = getattr(self, arm), peaks[arm][:1], 0.0
            if arm == "trailing" and self.precession is not None and "leading" in peaks:
                angle, spread = peaks["leading"][:1] - (360.0 - self.precession[0]), self.precession[1]
            marks.append(sk.Mark("datum", angle, np.array([value]), "data", spread, error))
        return tuple(marks)

    def remarks(self, prediction: sk.Prediction) -> tuple[str, ...]:
        """Warn of an arm that ends inside the window in which its apocentre is fitted."""
        warnings = []
        for arm in (arm for arm in ARMS if f"{arm}_peak" in prediction.details):
            angles = np.abs(prediction.details[f"{arm}_angle"])
            peak = abs(float(prediction.details[f"{arm}_peak"][0]))
            for reach, side in ((peak - angles.min(), "before"), (angles.max() - peak, "beyond")):
                if reach < WINDOW:
                    warnings.append(
                        f"The {arm} arm ends {max(reach, 0):.0f} deg {side} its apocentre, inside the window of "
                        f"{WINDOW:g} deg that is fitted: the apocentre is in part extrapolated."
                    )
        return tuple(warnings)

    def radii(self) -> dict[str, float]:
        """Return the measured apocentres."""
        return {f"{arm} apocentre": datum[0] for arm in ARMS if (datum := getattr(self, arm)) is not None}

    def _fits(self, stream: sk.Stream) -> tuple[dict[str, ArmFit], dict[str, str]]:
        """Return the fit of each arm that has an apocentre, and the reason why the others have none."""
        if len(stream) == 0 or stream.bound.all():
            return {}, dict.fromkeys(ARMS, "no particle has left the progenitor")
        angle = np.degrees(stream.winding)
        if self.phase == "chi":
            angle = unwrap_by_phase(angle, stream.chi, stream.bound)
        guides = {arm: self._guide(stream, arm) for arm in ARMS}
        reasons = {arm: guide for arm, guide in guides.items() if isinstance(guide, str)}
        fits: dict[str, ArmFit] = {}
        for arm, guide in guides.items():
            if isinstance(guide, str):
                continue
            member = ~stream.bound & (ARMS[arm] * angle > 0)
            chosen = member & self._early(stream) if arm == "trailing" else member
            fit_one = fit_turning if arm == "trailing" and self.recent_debris == "turning" else fit_arm
            fit = fit_one(angle[chosen], stream.r[chosen], stream.weight[chosen], guide, self.coverage)
            if isinstance(fit, str):
                cause = _why_few(angle, member, chosen, guide) if fit == TOO_FEW else ""
                reasons[arm] = f"{arm} arm: {fit}{cause}"
            else:
                fits[arm] = fit
        return fits, reasons

    def _guide(self, stream: sk.Stream, arm: str) -> float | str:
        """Angle in degrees of the progenitor's next (leading) or previous apocentre, or why there is none."""
        if stream.future is None:
            return "the progenitor is unbound or has no next apocentre"
        if arm == "leading":
            return _swept(stream.future, stream.future.apocentres()[0])
        past, needed = stream.orbit.apocentres(), 2 if self.recent_debris == "epoch_aware" else 1
        if len(past) < needed:
            several = "s" * (needed > 1)
            return f"the look-back time covers fewer than {needed} apocentre{several} of the progenitor"
        return -_swept(stream.orbit, past[-1])

    def _early(self, stream: sk.Stream) -> sk.BoolArray:
        """(n,) True for particles stripped early enough to count in the trailing arm."""
        if self.recent_debris == "turning":
            return np.ones(len(stream), dtype=bool)
        cut = stream.orbit.apocentres()[-1 if self.recent_debris == "literal" else -2]
        return np.asarray(stream.t_strip < cut)


def _why_few(angle: sk.Array, member: sk.BoolArray, chosen: sk.BoolArray, guide: float) -> str:
    """Return why there are too few particles near the apocentre, and what to change."""
    in_window = np.abs(angle - guide) < WINDOW
    if (member & in_window).sum() >= FEWEST > (chosen & in_window).sum():
        return ", the rest is too recent for the rule of observable.recent_debris"
    if member.sum() >= FEWEST and (np.abs(angle[member]) > abs(guide)).mean() < COVERAGE:
        return ", which the arm does not reach: raise progenitor.lookback, or let the progenitor lose more"
    return ": raise stripping.particles"


def _swept(orbit: sk.Orbit, t: float) -> float:
    """Angle in degrees that the orbit sweeps between time t and today (t = 0 is one of its ends)."""
    inside = orbit.t >= t if t < 0 else orbit.t <= t
    q = np.concatenate([orbit.at(np.array([t])).q, orbit.q[:, inside]], axis=1)
    if t > 0:
        q = np.concatenate([orbit.q[:, inside], orbit.at(np.array([t])).q], axis=1)
    unit = q / np.sqrt((q**2).sum(axis=0))
    cosine = np.clip((unit[:, 1:] * unit[:, :-1]).sum(axis=0), -1.0, 1.0)
    return float(np.degrees(np.arccos(cosine).sum()))


def _details(fits: dict[str, ArmFit]) -> dict[str, sk.Array]:
    details: dict[str, sk.Array] = {}
    for arm, fit in fits.items():
        details[f"{arm}_angle"], details[f"{arm}_track"] = fit.track
        details[f"{arm}_fit_angle"], details[f"{arm}_fit"] = fit.curve
        details[f"{arm}_peak"] = np.array([fit.angle, fit.radius])
    return details
