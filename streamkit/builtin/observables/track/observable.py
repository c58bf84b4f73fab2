"""Built-in observable: the track of a stream on the sky, against binned means or member stars."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

import streamkit as sk
from streamkit.builtin.observables.track.along import FRAME, Arm
from streamkit.builtin.observables.track.columns import (
    ALIKE,
    COLUMNS,
    DEPTH,
    EXTRA,
    Name,
    Outliers,
    check_extra_errors,
    check_turn,
    column_of,
    extra_error_of,
    middle_of,
    names_of,
    one_column,
    radii_of,
    within,
)  # fmt: skip
from streamkit.builtin.observables.track.draws import new_values
from streamkit.builtin.observables.track.extra_error import ExtraError, squares_of
from streamkit.builtin.observables.track.likelihood import Side, background_of, ln_of_each, ln_sum, residual_of_each
from streamkit.builtin.observables.track.lines import (
    ENOUGH,
    Lines,
    beyond_seam,
    debris_of,
    gather,
    is_enough,
    lines_at,
    ln_coverage,
    share_near,
    too_few,
)
from streamkit.builtin.observables.track.members import MEMBERS, MOTIONS, Members, members_of, which_columns
from streamkit.builtin.observables.track.panels import column_label, column_panel, fine_grid, longitude_label
from streamkit.builtin.observables.track.remarks import remark_of_debris, remarks_of
from streamkit.builtin.observables.track.shared_table import TABLE, check_sources, data_of, redrawn

BROADEST = 45.0  # largest kernel in degrees: an eighth of a turn


class Track(sk.Observable):
    """A stream's track on the sky: latitude, distance, proper motions and velocity at longitudes phi1.

    Each column has its own longitudes, or several columns are in one `table`; a column without values is not compared.
    At a datum's longitude a local line is fitted to the debris with a Gaussian kernel in phi1. Means are compared with
    the line, and member stars (`stars`) with the line and the spread of the debris about it. `members` are such stars
    in ICRS: their proper motions, with the covariances, are rotated into the frame. The density of a datum has the
    factor 1 - exp(-n), the probability of at least one particle under the kernel where n are expected. The factor is 1
    among debris; away from debris ln p falls by the distance to the nearest debris in units of the kernel. Bound
    particles are left out. With `unwrapped` the longitudes do not jump at whole turns. Several data at one longitude
    are independent, but for an extra error. A dispersion is an error of each datum by itself, an extra error one of the
    whole track: of the model, or of a smooth curve through stars. Both add to the squared errors, and may have priors.
    """

    kind = "track"
    likelihood_details = ("spread", "ln_coverage")
    reference = "Erkal et al. 2019, MNRAS 487, 2685: local lines, here with a kernel for their window"
    example: ClassVar[dict[str, Any]] = {
        "frame": {"pole": [192.86, 27.13], "origin": [266.4, -28.94]},
        "distance": {"phi1": [-30.0, 20.0], "distance": [20.0, 22.0], "error": [1.0, 1.0]},
        "radial_velocity": {"phi1": [-10.0], "radial_velocity": [10.0], "error": [2.0]},
    }

    frame: sk.Frame = Field(description=FRAME.format("phi1, phi2"))
    phi2: Annotated[sk.Table, one_column(phi2="deg").between("phi2", -90, 90)] | None = Field(
        default=None, description="Latitudes."
    )
    distance: Annotated[sk.Table, one_column(distance="kpc").positive("distance")] | None = Field(
        default=None, description="Heliocentric distances."
    )
    distance_modulus: Annotated[sk.Table, one_column(distance_modulus="mag")] | None = Field(
        default=None, description="Distance moduli."
    )
    distance_depth: Annotated[sk.Table, one_column(depth="kpc")] | None = Field(
        default=None, description="Standard deviations of the distance of the debris at a longitude."
    )
    pm_phi1_cosphi2: Annotated[sk.Table, one_column(pm_phi1_cosphi2="mas/yr")] | None = Field(
        default=None, description="Proper motions in phi1, times cos phi2; not corrected for the Sun's."
    )
    pm_phi2: Annotated[sk.Table, one_column(pm_phi2="mas/yr")] | None = Field(
        default=None, description="Proper motions in phi2; not corrected for the Sun's."
    )
    radial_velocity: Annotated[sk.Table, one_column(radial_velocity="km/s")] | None = Field(
        default=None, description="Line-of-sight velocities."
    )
    table: Annotated[sk.Table, TABLE] | None = Field(
        default=None,
        description="One table of several of the columns above: phi1, and each column with NAME_error. Values may be "
        "missing.",
    )
    members: Annotated[sk.Table, MEMBERS] | None = Field(
        default=None,
        description="Member stars in ICRS: ra, dec, and the known ones of distance, distance_modulus, pm_ra_cosdec, "
        "pm_dec and radial_velocity, each with NAME_error; pm_correlation is the correlation of the errors of the "
        "proper motions. Values may be missing. Positions are taken as exact.",
    )
    compared: tuple[Name, ...] | None = Field(
        default=None,
        description="The columns of `table` and `members` that are compared; all columns if left out.",
    )
    velocity_frame: Literal["heliocentric", "gsr"] = Field(
        default="heliocentric", description="Whether the velocities are heliocentric, or corrected for the Sun's."
    )
    gsr_sun: sk.VelocityArray | None = Field(
        default=None,
        description="With 'gsr': the Sun's velocity (towards the centre, along the rotation, to the north pole) that "
        "the table was corrected with. Left out: that of [sun].",
    )
    stars: tuple[Name, ...] = Field(
        default=(), description="The columns whose data are single member stars; the others hold means."
    )
    kernel: sk.Angle = Field(default=2.0, gt=0, le=BROADEST, description="Standard deviation of the kernel in phi1.")
    unwrapped: bool = Field(
        default=False,
        description="Whether phi1 continues beyond whole turns along the stream, from the progenitor in (-180, 180]. "
        "The wraps of a long stream are then distinguished by the angle that their debris has swept.",
    )
    arm: Arm = "both"
    phi2_dispersion: sk.Angle = Field(default=0.0, ge=0, description="Extra dispersion of phi2, added to its errors.")
    distance_dispersion: sk.Coordinate = Field(default=0.0, ge=0, description="Extra dispersion of the distance.")
    distance_modulus_dispersion: sk.Number = Field(default=0.0, ge=0, description="Extra dispersion of the modulus.")
    pm_phi1_cosphi2_dispersion: sk.ProperMotion = Field(default=0.0, ge=0, description="Extra dispersion of its data.")
    pm_phi2_dispersion: sk.ProperMotion = Field(default=0.0, ge=0, description="Extra dispersion of its data.")
    radial_velocity_dispersion: sk.Velocity = Field(default=0.0, ge=0, description="Extra dispersion of the velocity.")
    phi2_extra_error: Annotated[sk.Angle, EXTRA] = 0.0
    distance_extra_error: Annotated[sk.Coordinate, EXTRA] = 0.0
    distance_modulus_extra_error: Annotated[sk.Number, EXTRA] = 0.0
    pm_phi1_cosphi2_extra_error: Annotated[sk.ProperMotion, EXTRA] = 0.0
    pm_phi2_extra_error: Annotated[sk.ProperMotion, EXTRA] = 0.0
    radial_velocity_extra_error: Annotated[sk.Velocity, EXTRA] = 0.0
    extra_error_length: Annotated[sk.Angle, ALIKE] = 0.0
    phi2_outliers: Outliers = 0.0
    distance_outliers: Outliers = 0.0
    distance_modulus_outliers: Outliers = 0.0
    pm_phi1_cosphi2_outliers: Outliers = 0.0
    pm_phi2_outliers: Outliers = 0.0
    radial_velocity_outliers: Outliers = 0.0

    @field_validator("stars")
    @classmethod
    def _have_tables(cls, value: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        table = info.data.get("table") or ()
        given = [name for name in COLUMNS if info.data.get(name) is not None or name in table]
        if missing := [name for name in value if name not in given]:
            raise ValueError(f"there is no table of {missing[0]!r}; there is {', '.join(given) or 'none'}")
        return value

    @model_validator(mode="after")
    def _complete(self) -> Track:
        own = [name for name in (*COLUMNS, DEPTH) if getattr(self, name) is not None]
        check_sources(own, self.table, self._of_table, self.members, self._of_members, self.compared)
        if self.members is not None and self.unwrapped:
            raise ValueError("ra and dec do not determine the wrap of a star; give tables with phi1, and `stars`")
        if not self.given:
            raise ValueError(
                f"there are no data: expected table or members, or at least one table of {', '.join((*COLUMNS, DEPTH))}"
            )
        check_turn(self.given, self.unwrapped)
        check_extra_errors(self, self._pair)
        if any(np.any(extra_error_of(self, name)) for name in self.given):
            _ = self._squares  # copies with other extra errors keep it
        if self.gsr_sun is not None and (len(self.gsr_sun) != 3 or self.velocity_frame != "gsr"):
            raise ValueError('gsr_sun takes three velocities, and velocity_frame = "gsr"')
        return self

    @cached_property
    def _of_table(self) -> dict[str, tuple[sk.Array, sk.Array, sk.Array]]:
        """Longitudes, values and errors, (k,) each, of the columns of `table` that are compared."""
        parts = {} if self.table is None else data_of(self.table)
        return {name: part for name, part in parts.items() if self.compared is None or name in self.compared}

    @cached_property
    def _stars(self) -> Members | None:
        return None if self.members is None else members_of(self.members, self.frame)

    @cached_property
    def _of_members(self) -> tuple[str, ...]:
        """The columns of the members that are compared."""
        compared = self.compared and [name for name in self.compared if name not in self._of_table]
        return () if self._stars is None else which_columns(self._stars, compared)

    @cached_property
    def given(self) -> dict[str, tuple[sk.Array, sk.Array, sk.Array]]:
        """The data by field: longitudes, values and errors, (k,) each."""
        parts = {}
        for name in (*COLUMNS, DEPTH):
            if (table := getattr(self, name)) is not None:
                parts[name] = table["phi1"], table["depth" if name == DEPTH else name], table["error"]
            elif name in self._of_table:
                parts[name] = self._of_table[name]
            elif self._stars is not None and name in self._of_members:
                parts[name] = self._stars.column(name)
        return parts

    @cached_property
    def names(self) -> tuple[str, ...]:
        """A name for every datum."""
        return names_of(self.given)

    @cached_property
    def _places(self) -> tuple[sk.Array, dict[str, sk.IntArray]]:
        """The different longitudes (u,) of all data, and for each field which of them its data have."""
        parts = [phi1 for phi1, _, _ in self.given.values()]
        different, which = np.unique(np.concatenate(parts), return_inverse=True)
        ends = np.cumsum([len(part) for part in parts])[:-1]
        return different, dict(zip(self.given, np.split(which, ends), strict=True))

    def sky_frame(self) -> sk.Frame:
        """Return the frame of phi1 and phi2."""
        return self.frame

    def data(self) -> tuple[sk.Array, sk.Array]:
        """Return the values and errors of all data, column after column; extra dispersions are not in the errors."""
        return tuple(np.concatenate([part[i] for part in self.given.values()]) for i in (1, 2))  # type: ignore[return-value]

    def quantities(self) -> dict[str, sk.IntArray]:
        """Return the rows of each column, by the name of its field."""
        ends = np.cumsum([len(phi1) for phi1, _, _ in self.given.values()])
        return dict(zip(self.given, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))

    def predict(self, stream: sk.Stream) -> sk.Prediction:
        """Fit the line at every longitude.

        The details hold the spread (m,) and `ln_coverage` (m,) at every datum, and the share of debris `near` them.
        """
        different, which = self._places
        chosen = debris_of(stream, self.arm)
        if not is_enough(stream, chosen):
            return too_few(self.names)
        lines, of = self.lines(stream, different)
        parts = [self.part_of(name, lines, of.index(column_of(name)), which[name]) for name in self.given]
        mean, variance, spread, count = (np.concatenate(part) for part in zip(*parts, strict=True))
        near = share_near(different, lines.ln_count, self.kernel, stream.weight[chosen].sum())
        details = {"spread": spread, "ln_coverage": ln_coverage(count), "near": np.array(near)}
        return sk.Prediction(self.names, mean, variance, details=details)

    def lines(self, stream: sk.Stream, at: sk.Array) -> tuple[Lines, list[str]]:
        """Fit the lines at longitudes (m,) in degrees, of all columns that data are compared with; and their names."""
        chosen = debris_of(stream, self.arm)
        longitude, columns = self.of_particles(stream)
        margin = 0.0
        if not self.unwrapped:
            middle = middle_of(self._places[0])
            longitude, at = (within(angle, middle) for angle in (longitude, at))
            margin = beyond_seam(at - middle, self.kernel)
        away = np.flatnonzero(chosen)
        debris = gather(longitude[away], [column[away] for column in columns.values()], stream.weight[away], margin)
        of = list(columns)
        depth = of.index("distance") if DEPTH in self.given else -1
        return lines_at(debris, at, self.kernel, depth), of

    def part_of(self, name: str, lines: Lines, row: int, which: sk.IntArray) -> tuple[sk.Array, ...]:
        """Mean, variance, spread and ln of the count of one field, at some of the lines."""
        count = lines.ln_count[which]
        if name != DEPTH:
            return lines.value[row, which], lines.variance[row, which], lines.spread[row, which], count
        spread = np.hypot(lines.spread[row, which], self.distance_dispersion)
        return spread, lines.depth_variance[which], np.zeros(len(which)), count

    def of_particles(self, stream: sk.Stream) -> tuple[sk.Array, dict[str, sk.Array]]:
        """Return the longitude (n,) of the particles, and the columns (n,) that data are compared with, by name."""
        seen = stream.seen(self.frame)
        if self.velocity_frame == "gsr":
            velocity = seen.radial_velocity_gsr
            if self.gsr_sun is not None:
                velocity = seen.radial_velocity + stream.toward(self.gsr_sun)
            seen = seen._replace(radial_velocity=velocity)
        longitude = stream.unwrapped_longitude(self.frame) if self.unwrapped else seen.lon
        wanted = {column_of(name) for name in self.given}
        return longitude, {name: column.of(seen) for name, column in COLUMNS.items() if name in wanted}

    def likelihood_fields(self) -> tuple[str, ...]:
        """Return the dispersions, extra errors and fractions of outliers; the depth takes the distance's dispersion."""
        dispersions = (f"{name}_dispersion" for name in COLUMNS if name != "distance" or DEPTH not in self.given)
        others = (f"{name}_{what}" for name in COLUMNS for what in ("extra_error", "outliers"))
        return (*dispersions, *others, "extra_error_length")

    def ln_likelihood(self, prediction: sk.Prediction, add_noise: bool) -> sk.Array:
        """(...) Return the sum of `ln_mixture` over columns: Gaussians about the lines, extra dispersions, outliers.

        The two proper motions of a member are one pair, with their covariance. All data of a column with an extra error
        have one joint Gaussian.
        """
        return ln_sum(self._compared(prediction, add_noise), self._pair, self._pair_covariance)

    def ln_likelihoods(self, prediction: sk.Prediction, add_noise: bool) -> sk.Array:
        """Return the terms of `ln_likelihood`; the second proper motion of a member is conditional on the first."""
        return ln_of_each(self._compared(prediction, add_noise), self._pair, self._pair_covariance)

    def residuals(self, prediction: sk.Prediction, add_noise: bool) -> sk.Array:
        """Return the normal score of each datum in `ln_likelihood`, with an extra error given the data before it."""
        return residual_of_each(self._compared(prediction, add_noise), self._pair, self._pair_covariance)

    def scatter(self, prediction: sk.Prediction) -> sk.Array:
        """Return the root of `scatter2` for all data, with the extra errors."""
        rows, spread = self.quantities(), prediction.details["spread"]
        parts = [self.scatter2(name, error, spread[rows[name]]) + extra_error_of(self, name) ** 2
                 for name, (_, _, error) in self.given.items()]  # fmt: skip
        return np.sqrt(np.concatenate(parts))

    def _compared(self, prediction: sk.Prediction, add_noise: bool) -> Iterator[tuple[str, Side]]:
        """Return the data of each column beside the stream, by its name."""
        start = 0
        for name, (phi1, value, error) in self.given.items():
            part = np.s_[..., start : (start := start + len(phi1))]
            variance = self.scatter2(name, error, prediction.details["spread"][part])
            if add_noise:
                variance = variance + prediction.variance[part]
            outliers = 0.0 if name == DEPTH else getattr(self, f"{name}_outliers")
            coverage = prediction.details["ln_coverage"][part]
            size, background = extra_error_of(self, name), background_of(value, error, outliers)
            extra = ExtraError(self._squares[name], size, self.extra_error_length) if np.any(size) else None
            yield name, Side(value, variance, prediction.mean[part], coverage, outliers, background, extra)

    @cached_property
    def _squares(self) -> dict[str, sk.Array]:
        """Squared differences (k, k) of the longitudes of each column."""
        middle = middle_of(self._places[0])
        return {name: squares_of(phi1 if self.unwrapped else within(phi1, middle))
                for name, (phi1, _, _) in self.given.items()}  # fmt: skip

    @cached_property
    def _pair(self) -> tuple[str, ...]:
        """The names of the proper motions, if both come from members."""
        return MOTIONS if set(MOTIONS) <= set(self._of_members) else ()

    @property
    def _pair_covariance(self) -> sk.Array | None:
        return self._stars.covariance[self._stars.rows(MOTIONS[0])] if self._stars is not None and self._pair else None

    def scatter2(self, name: str, error: sk.Array, spread: sk.Array) -> sk.Array:
        """(..., k) Variances of one field's data about the lines: errors, extra dispersion and, for stars, spread."""
        variance = error**2 + (0.0 if name == DEPTH else getattr(self, f"{name}_dispersion")) ** 2
        return variance + spread**2 if name in self.stars or name in self._of_members else variance

    def mock(self, prediction: sk.Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Return tables with Gaussian noise: errors, extra dispersion, for stars the spread; a fraction of outliers."""
        sides = dict(self._compared(prediction, add_noise=False))
        drawn = new_values(sides, self._pair, self._pair_covariance, rng)
        tables: dict[str, Any] = {}
        for name, (phi1, _, error) in self.given.items():
            if name not in self._of_table and name not in self._of_members:
                table = {"phi1": phi1, "depth" if name == DEPTH else name: drawn[name], "error": error}
                tables[name] = {key: column.tolist() for key, column in table.items()}
        if self.table is not None:
            tables["table"] = redrawn(self.table, {name: drawn[name] for name in self._of_table})
        if self._stars is not None:
            tables["members"] = self._stars.redrawn({name: drawn[name] for name in self._of_members})
        return tables

    def panels(self, stream: sk.Stream, prediction: sk.Prediction) -> tuple[sk.Panel, ...]:
        """Return a picture for every column: debris, fitted lines, data and residuals against longitude."""
        longitude, columns = self.of_particles(stream)
        curves = self._curves(stream)
        panels, start = [], 0
        for name, (phi1, value, error) in self.given.items():
            part = slice(start, start := start + len(phi1))
            pull = np.full(len(phi1), np.nan)
            if not prediction.why_not:
                pull = (value - prediction.mean[part]) / self.scatter(prediction)[part]
            x = longitude if self.unwrapped else within(longitude, float(phi1.mean()))
            y = np.full(len(longitude), np.nan) if name == DEPTH else columns[name]
            labels = longitude_label(self.frame, self.unwrapped), column_label(name, self.velocity_frame == "gsr")
            data = sk.PanelData(np.arange(part.start, part.stop), phi1, value, error, pull)
            panels.append(column_panel(*labels, (x, y), data, curves.get(name)))
        return tuple(panels)

    def _curves(self, stream: sk.Stream) -> dict[str, tuple[sk.Array, sk.Array]]:
        """Return the line of each field on a fine grid, NaN off the debris; no lines without enough debris."""
        if not is_enough(stream, debris_of(stream, self.arm)):
            return {}
        grid = fine_grid(np.concatenate([phi1 for phi1, _, _ in self.given.values()]))
        lines, of = self.lines(stream, grid)
        there, every = lines.ln_count > np.log(ENOUGH), np.arange(len(grid))
        parts = {name: self.part_of(name, lines, of.index(column_of(name)), every)[0] for name in self.given}
        return {name: (grid, np.where(there, part, np.nan)) for name, part in parts.items()}

    def remarks(self, prediction: sk.Prediction) -> tuple[str, ...]:
        """Warn of data where there is no debris, of debris where there are no data, and of longitudes in radians."""
        if prediction.why_not:
            return ()
        remarks = remarks_of(self.given, self.quantities(), prediction.details["ln_coverage"], self.kernel)
        return remarks + remark_of_debris(float(prediction.details["near"]), len(self._places[0]))

    def radii(self) -> dict[str, float]:
        """Return the least and the greatest Galactocentric radius of the distances, seen from 8 kpc at phi2 = 0."""
        return radii_of(self.given, sk.sky_matrix(self.frame))
