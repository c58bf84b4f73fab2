"""Built-in observable: single stars of a stream and of the field, with the probability of each to be a member."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

import streamkit as sk
from streamkit.builtin.observables.stars import knots as grid
from streamkit.builtin.observables.stars.catalogue import DENSITY, STARS, WINDOW, Catalogue, catalogue_of
from streamkit.builtin.observables.stars.field import with_field
from streamkit.builtin.observables.stars.mixture import ln_likelihood, membership, residuals
from streamkit.builtin.observables.stars.model import Model, Part, Settings
from streamkit.builtin.observables.stars.rough_track import RoughTrack, rough_track_of
from streamkit.builtin.observables.track.along import FRAME, Arm
from streamkit.builtin.observables.track.columns import COLUMNS, LIMITS, Name, within
from streamkit.builtin.observables.track.lines import (
    Lines,
    beyond_seam,
    debris_of,
    gather,
    is_enough,
    is_gap,
    lines_at,
    ln_coverage,
    too_few,
    warning_of_gaps,
)
from streamkit.builtin.observables.track.members import members_of
from streamkit.builtin.observables.track.panels import column_label, column_panel, fine_grid, longitude_label

Fraction = Annotated[sk.Number, Field(ge=0, le=1)]
LIKELY = 0.5  # probability from which a star counts as a member
SPREAD = "_spread"
COCOON_OF = "cocoon_"
COCOON = "Dispersion of the cocoon, added in squares to that of the stream."


class Stars(sk.Observable):
    """Stars of a catalogue, of which a fraction is of the stream: ln L = sum of ln[f S + (1 - f) B].

    S is the density of the stream at a star's phi1 in the columns that the star has: a Gaussian about the local lines
    of the debris, with their spread, an extra dispersion and the errors of the star. It is predicted at `knots` along
    the window. B is the density of the field there: a column of the table,
    or a mixture of Gaussians that is fitted to the stars. f is the chance of a star at this phi1 to be
    of the stream. Its mean over the stars is `fraction`; how it varies along phi1, `along` says. The likelihood is
    conditional on phi1: a survey that is less complete at some phi1 does no harm. Without a field (`fraction` = 1) the
    likelihood is that of the members of `track`. Bound particles are left out: leave out the stars of a progenitor.
    """

    kind = "stars"
    likelihood_details = ("ln_coverage", "ln_density")
    reference = "Koposov et al. 2019, MNRAS 485, 4726: stream and field along knots, here with a dynamical model"
    example: ClassVar[dict[str, Any]] = {
        "frame": {"pole": [192.86, 27.13], "origin": [266.4, -28.94]},
        "window": {"phi1": [-40.0, 40.0]},
        "stars": {
            "ra": [232.84, 243.6, 251.41, 258.71, 263.84, 268.71, 272.78, 277.06, 280.51, 284.35],
            "dec": [-55.99, -51.14, -45.05, -39.12, -32.28, -25.51, -18.45, -11.59, -4.35, 2.68],
            "distance": [20.0, 20.4, 21.0, 21.2, 21.0, 21.9, 22.4, 22.1, 22.0, 22.5],
            "distance_error": [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0],
        },
        "kernel": 5.0,
        "knots": 6,
    }

    frame: sk.Frame = Field(description=FRAME.format("phi1, phi2"))
    stars: Annotated[sk.Table, STARS] = Field(
        description="The stars in ICRS: ra, dec, and the known ones of distance, distance_modulus, pm_ra_cosdec, "
        "pm_dec and radial_velocity, each with NAME_error; pm_correlation is that of the errors of the proper motions. "
        "Values may be missing. `background_density` is the density of field stars in the columns that a star has, at "
        "its phi1: its integral over the window is 1, in the units of the columns in the frame. `colour_ratio` is the "
        "density of the stream's stars at its colours and magnitudes over that of the field's."
    )
    window: Annotated[sk.Table, WINDOW] = Field(
        description="The ends of phi1, and of other columns that the stars were cut at: { phi1 = [-60, 0], phi2 = "
        "[-3, 3] }. A star outside is an error."
    )
    background_gaussians: int = Field(
        default=0,
        ge=0,
        le=50,
        description="Number of Gaussians of a density of the field that is fitted to the stars, once and without the "
        "model; 0 for the column `background_density`.",
    )
    fraction: Fraction = Field(default=1.0, description="Fraction of the stars that are of the stream.")
    along: Literal["stars", "model", "uniform"] = Field(
        default="stars",
        description="How the chance of a star to be of the stream varies along phi1: as a rough track through the "
        "stars has it; as the density of the debris over that of the field; or not at all.",
    )
    compared: tuple[Name, ...] | None = Field(
        default=None, description="The columns that are compared; all that the stars have if left out."
    )
    knots: int = Field(
        default=20, ge=grid.FEWEST, le=grid.MOST, description="Number of longitudes at which the stream is predicted."
    )
    kernel: sk.Angle = Field(default=2.0, gt=0, le=45, description="Standard deviation of the kernel in phi1.")
    arm: Arm = "both"
    phi2_dispersion: sk.Angle = Field(default=0.0, ge=0, description="Extra dispersion of phi2 in the stream.")
    distance_dispersion: sk.Coordinate = Field(default=0.0, ge=0, description="Extra dispersion of the distance.")
    distance_modulus_dispersion: sk.Number = Field(default=0.0, ge=0, description="Extra dispersion of the modulus.")
    pm_phi1_cosphi2_dispersion: sk.ProperMotion = Field(default=0.0, ge=0, description="Extra dispersion of it.")
    pm_phi2_dispersion: sk.ProperMotion = Field(default=0.0, ge=0, description="Extra dispersion of it.")
    radial_velocity_dispersion: sk.Velocity = Field(default=0.0, ge=0, description="Extra dispersion of it.")

    cocoon_fraction: Fraction = Field(
        default=0.0,
        description="Fraction of the stream's stars that are of a cocoon: a wider stream on the same track.",
    )
    cocoon_phi2_dispersion: sk.Angle = Field(default=0.0, ge=0, description=COCOON)
    cocoon_distance_dispersion: sk.Coordinate = Field(default=0.0, ge=0, description=COCOON)
    cocoon_distance_modulus_dispersion: sk.Number = Field(default=0.0, ge=0, description=COCOON)
    cocoon_pm_phi1_cosphi2_dispersion: sk.ProperMotion = Field(default=0.0, ge=0, description=COCOON)
    cocoon_pm_phi2_dispersion: sk.ProperMotion = Field(default=0.0, ge=0, description=COCOON)
    cocoon_radial_velocity_dispersion: sk.Velocity = Field(default=0.0, ge=0, description=COCOON)

    @model_validator(mode="after")
    def _complete(self) -> Stars:
        column = DENSITY in self.stars
        if column and self.background_gaussians:
            raise ValueError(
                f"background_gaussians = {self.background_gaussians}, and the stars have a column {DENSITY}: the "
                "density of the field is given twice; leave out either"
            )
        if self.catalogue.ln_background is None and self.fraction < 1:  # the stars are read and checked here
            raise ValueError(
                f"fraction = {self.fraction:g}: stars of the field need its density. Give the stars a column "
                f"{DENSITY}, or fit one with background_gaussians = 6, or leave out fraction if all are of the stream"
            )
        wide = [name for name in COLUMNS if np.any(getattr(self, f"{COCOON_OF}{name}_dispersion"))]
        if bool(wide) != bool(self.cocoon_fraction):
            raise ValueError(
                f"a cocoon has a cocoon_fraction above 0 and a dispersion, such as {COCOON_OF}phi2_dispersion; found "
                f"cocoon_fraction = {self.cocoon_fraction:g} and {', '.join(wide) or 'no dispersion'}"
            )
        return self

    @cached_property
    def catalogue(self) -> Catalogue:
        """The stars in the frame, with the density of the field."""
        matrix = tuple(tuple(row) for row in sk.sky_matrix(self.frame).tolist())
        stars = catalogue_of(self.stars, matrix, self.window, self.compared, self.knots)
        if not self.background_gaussians:
            return stars
        return with_field(stars, self.window, self.background_gaussians, float(self.kernel))

    @cached_property
    def rough(self) -> RoughTrack:
        """The track through the stars without a model."""
        return rough_track_of(self.catalogue, float(self.kernel))

    def sky_frame(self) -> sk.Frame:
        """Return the frame of phi1 and phi2."""
        return self.frame

    @property
    def names(self) -> tuple[str, ...]:
        """A name for every number at a knot."""
        return tuple(f"{name} at {phi1:g}" for name in self.quantities() for phi1 in self.catalogue.knots.phi1.tolist())

    def quantities(self) -> dict[str, sk.IntArray]:
        """Return the rows of each column at the knots, and of its spread."""
        of = [name + what for name in self.catalogue.columns for what in ("", SPREAD)]
        return {name: np.arange(i * self.knots, (i + 1) * self.knots) for i, name in enumerate(of)}

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return the rough track through the stars at the knots, and its spread, with errors.

        The likelihood does not compare with it: `ln_likelihood` compares with each star.
        """
        rough = self.rough
        value, error = np.stack([rough.mean, rough.spread], axis=1), np.stack([rough.mean_error, rough.spread_error], 1)
        return value.ravel(), error.ravel()

    def predict(self, stream: sk.Stream) -> sk.Prediction:
        """Return the lines of the debris at the knots and its spread about them.

        The details hold at the knots, (K,) each: ln of the chance of any debris, and ln of the density of the debris
        along phi1 over its mean.
        """
        if not is_enough(stream, debris_of(stream, self.arm)):
            return too_few(self.names)
        lines = self.lines(stream, self.catalogue.knots.phi1)
        # a spread is about as certain as a mean is, but for a factor of 2 in the variance
        mean = np.stack([lines.value, lines.spread], axis=1)
        variance = np.stack([lines.variance, 0.5 * lines.variance], axis=1)
        ln_density = lines.ln_count - np.logaddexp.reduce(lines.ln_count) + np.log(self.knots)
        details = {"ln_coverage": ln_coverage(lines.ln_count), "ln_density": ln_density}
        return sk.Prediction(self.names, mean.ravel(), variance.ravel(), details=details)

    def lines(self, stream: sk.Stream, at: sk.Array) -> Lines:
        """Fit the lines of all columns at longitudes (m,) in degrees."""
        seen, chosen = stream.seen(self.frame), debris_of(stream, self.arm)
        middle = self._middle
        longitude, at = (within(angle, middle) for angle in (seen.lon, at))
        away = np.flatnonzero(chosen)
        columns = [COLUMNS[name].of(seen)[away] for name in self.catalogue.columns]
        debris = gather(longitude[away], columns, stream.weight[away], beyond_seam(at - middle, float(self.kernel)))
        return lines_at(debris, at, float(self.kernel))

    @property
    def _middle(self) -> float:
        return 0.5 * float(self.window["phi1"].sum())

    def likelihood_fields(self) -> tuple[str, ...]:
        """Return the fractions and the dispersions."""
        dispersions = (f"{of}{name}_dispersion" for name in COLUMNS for of in ("", COCOON_OF))
        return ("fraction", "cocoon_fraction", *dispersions)

    def ln_likelihood(self, prediction: sk.Prediction, add_noise: bool) -> float | sk.Array:
        """Return the ln likelihood of the stars; see `streamkit.builtin.observables.stars.mixture`."""
        total = ln_likelihood(self.catalogue, self._model(prediction, add_noise), self._settings)
        return float(total[0]) if prediction.mean.ndim == 1 else total

    def residuals(self, prediction: sk.Prediction, add_noise: bool) -> sk.Array:
        """Return the normal scores of all numbers at the knots: what the stars near a knot say of it."""
        scores = residuals(self.catalogue, self._model(prediction, add_noise), self._settings)
        return np.stack(scores, axis=1).ravel()

    def membership(self, prediction: sk.Prediction) -> sk.Array:
        """(N,) Return the probability of each star to be of the stream, the cocoon included."""
        return np.asarray(self.membership_of_parts(prediction).sum(axis=0))

    def membership_of_parts(self, prediction: sk.Prediction) -> sk.Array:
        """(1, N) or (2, N) Return the probability of each star to be of the thin stream, and of its cocoon."""
        return membership(self.catalogue, self._model(prediction, False), self._settings)[:, :, 0]

    def places(self) -> dict[str, tuple[sk.Array, str]]:
        """Return ra, dec, phi1 and the compared columns of the stars, (N,) each with its unit."""
        given = {name: (self.stars[name], "deg") for name in ("ra", "dec")} | {"phi1": (self.catalogue.phi1, "deg")}
        return given | {name: (column, COLUMNS[name].unit) for name, column in self.catalogue.values.items()}

    def over_stars(self, prediction: sk.Prediction) -> dict[str, tuple[str, sk.Array, sk.Array, sk.Array]]:
        """Return by column its label, the knots (K,), and the mean and the width (K,) of the thin stream there."""
        mean, spread = self._parts(prediction.mean)
        there = np.where(is_gap(prediction.details["ln_coverage"]), np.nan, 1.0)
        thin, knots = self._settings.parts[0].dispersions, self.catalogue.knots.phi1
        found = {}
        for c, name in enumerate(self.catalogue.columns):
            width = np.hypot(spread[c, :, 0], float(thin[name]))
            found[name] = column_label(name, False), knots, there * mean[c, :, 0], there * width
        return found

    @property
    def _settings(self) -> Settings:
        """The numbers of the fields; fields of n points are (n, 1)."""
        names = self.catalogue.columns
        of_all = {name: np.transpose(getattr(self, f"{name}_dispersion")) for name in names}
        wide = {name: np.transpose(getattr(self, f"{COCOON_OF}{name}_dispersion")) for name in names}
        cocoon = np.transpose(self.cocoon_fraction)
        parts = [Part(1 - cocoon, of_all)]
        if np.any(cocoon):
            parts.append(Part(cocoon, {name: np.hypot(of_all[name], wide[name]) for name in names}))
        return Settings(np.transpose(self.fraction), parts)

    def _model(self, prediction: sk.Prediction, add_noise: bool) -> Model:
        """Return the prediction at one or n points as arrays (C, K, n)."""
        mean, spread = self._parts(prediction.mean)
        of_mean, of_spread = self._parts(prediction.variance) if add_noise else (None, None)
        coverage, density = (np.atleast_2d(prediction.details[name]).T for name in self.likelihood_details)
        return Model(mean, np.maximum(spread, 0.0), of_mean, of_spread, coverage, self._ln_odds(density))

    def _parts(self, numbers: sk.Array) -> tuple[sk.Array, sk.Array]:
        """(C, K, n) each: numbers (m,) or (n, m) of the means, and of the spreads."""
        parts = np.atleast_2d(numbers).T.reshape(len(self.catalogue.columns), 2, self.knots, -1)
        return parts[:, 0], parts[:, 1]

    def _ln_odds(self, ln_density: sk.Array) -> sk.Array:
        """(K, n) ln of the odds of a star at a knot to be of the stream, over those of all stars."""
        if self.catalogue.ln_background is None or self.along == "uniform":
            return np.zeros_like(ln_density)
        if self.along == "stars":
            return self.rough.ln_odds[:, None] + np.zeros_like(ln_density)
        return np.asarray(ln_density - self.rough.ln_field[:, None])

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return stars drawn about the prediction; not where some are of the field, whose density is a column."""
        if self.catalogue.ln_background is not None or self.cocoon_fraction:
            raise sk.StreamkitError(
                "the observable stars makes mock data only where all stars are of one stream, without field and "
                "cocoon: the density of the field is known at the given stars alone"
            )
        stars, thin = self.catalogue, self._settings.parts[0]
        model = self._model(prediction, False)
        members = members_of(self.stars, sk.sky_matrix(self.frame))
        drawn = {}
        for c, name in enumerate(stars.columns):
            rows = members.rows(name)
            spread = np.hypot(stars.knots.linear @ model.spread[c, :, 0], float(thin.dispersions[name]))
            width = np.sqrt(spread**2 + stars.variances[name])[rows]
            drawn[name] = rng.normal((stars.knots.cubic @ model.mean[c, :, 0])[rows], width)
            drawn[name] = LIMITS.get(name, np.asarray)(drawn[name])
        return {"stars": members.redrawn(drawn)}

    def panels(self, stream: sk.Stream, prediction: sk.Prediction) -> tuple[sk.Panel, ...]:
        """Return a picture for every column: debris, fitted lines, the rough track and the scores at the knots."""
        seen, stars = stream.seen(self.frame), self.catalogue
        at = fine_grid(stars.knots.phi1)
        lines = self.lines(stream, at) if is_enough(stream, debris_of(stream, self.arm)) else None
        score = np.full(len(self.names), np.nan)
        if not prediction.why_not:
            score = self.residuals(prediction, False)
        values, errors = self.data()
        panels = []
        for c, name in enumerate(stars.columns):
            rows = self.quantities()[name]
            line = None
            if lines is not None:
                line = at, np.where(is_gap(ln_coverage(lines.ln_count)), np.nan, lines.value[c])
            data = sk.PanelData(rows, stars.knots.phi1, values[rows], errors[rows], score[rows])
            labels = longitude_label(self.frame, False), column_label(name, False)
            particles = within(seen.lon, self._middle), COLUMNS[name].of(seen)
            panels.append(column_panel(*labels, particles, data, line))
        return tuple(panels)

    def remarks(self, prediction: sk.Prediction) -> tuple[str, ...]:
        """Warn of knots without debris, and of a stream to which no star belongs."""
        if prediction.why_not:
            return ()
        found = []
        empty = self.catalogue.knots.phi1[is_gap(prediction.details["ln_coverage"])]
        if len(empty):
            found.append(warning_of_gaps(f"stars: {len(empty)} of {self.knots} knots", empty, float(self.kernel)))
        if self.catalogue.ln_background is not None:
            members = int((self.membership(prediction) > LIKELY).sum())
            if not members:
                found.append(
                    f"stars: none of {len(self.catalogue)} stars is likely to be of this stream. By themselves about "
                    f"{self.rough.fraction * len(self.catalogue):.0f} of them lie along a track."
                )
        return tuple(found)
