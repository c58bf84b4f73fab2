"""The abstract bases. A component is one final pydantic class whose fields are its parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.special import ndtr

from streamkit.errors import PluginError, StreamkitError
from streamkit.fields import array_unit
from streamkit.stream import Array, Frame, IntArray, Mark, Orbit, Panel, Prediction, Release, Stream
from streamkit.units import GYR, Duration, Number, PositiveNumber, Unit, unit_of

if TYPE_CHECKING:  # the engine brings numba, which naming a component does not need
    from streamkit.engine import Field as ForceField


class Component(BaseModel, ABC):
    """Something a run file can name by its ``kind``. Its fields are its parameters, with units.

    streamkit makes one instance for a section of the run file, and one for each set of parameters if a field has a
    prior. An instance does not change, keeps no state between calls, draws no random numbers except from its arguments,
    and is pickled on its way to worker processes. Methods take and return the engine units kpc, km/s, Msun and
    kpc/(km/s), unless a docstring names other ones. A method may raise `OutOfDomain` if there is no stream at these
    parameters: ln p is then -inf. After any other exception the command ends with a `ComponentError`, which names the
    component and the parameters. The docstrings of the methods give the shapes of arrays.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    role: ClassVar[str]
    """The section of the run file: potential, stripping, integrator, observable, data or sampler. The bases set it."""
    kind: ClassVar[str]
    """What a run file calls it; unique within its role."""
    example: ClassVar[dict[str, Any]] = {}
    """Values for the fields without defaults: shown in listings, used by the conformance tests."""
    reference: ClassVar[str] = ""
    """The paper it follows."""
    bibtex: ClassVar[str] = ""
    """Its BibTeX entries, for `streamkit cite`; without them `reference` is printed as a note."""

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Refuse a class that derives from a component: components are final."""
        super().__pydantic_init_subclass__(**kwargs)
        for base in cls.__mro__[1:]:
            if issubclass(base, Component) and base.__dict__.get("kind"):
                raise PluginError(
                    f"{cls.__name__} derives from the component {base.__name__}: components are final. "
                    f"Derive from {base.role.capitalize()} and hold a {base.__name__} instead."
                )

    @classmethod
    def for_section(cls, section: Mapping[str, Any]) -> type[Self]:
        """Return the class that reads a section of the run file: this one, or one of its kind with other fields.

        Components whose fields depend on the section override it, such as a component with the potentials of another
        package. They return a class made for the section, with the same kind. The same section gives the same class.

        Parameters
        ----------
        section
            The keys and values in the run file, without the kind.

        Raises ValueError: With a sentence, for a section that no class can read.
        """
        return cls

    def __eq__(self, other: object) -> bool:
        """Return whether two components have the same class and equal values; arrays are compared by their numbers."""
        if type(self) is not type(other):
            return NotImplemented
        pairs = ((getattr(self, name), getattr(other, name)) for name in type(self).model_fields)
        return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else bool(a == b) for a, b in pairs)

    def __hash__(self) -> int:
        values = (getattr(self, name) for name in type(self).model_fields)
        return hash((type(self), *(v.tobytes() if isinstance(v, np.ndarray) else v for v in values)))

    def in_engine_units(self) -> tuple[Any, ...]:
        """Return the values of the numeric fields in engine units, numbers and arrays, in the order of declaration."""
        fields = ((getattr(self, name), unit.to_internal) for name, unit in self.measured().items())
        return tuple(value if factor == 1.0 or value is None else value * factor for value, factor in fields)

    @classmethod
    def measured(cls) -> dict[str, Unit]:
        """Return the units of the fields that are numbers, or arrays of them."""
        return _measured(cls)

    @classmethod
    def parameters(cls) -> dict[str, Unit]:
        """Return the fields that are physical numbers, and may thus have a prior, with their units."""
        return {name: unit for name, field in cls.model_fields.items() if (unit := unit_of(field)) is not None}


@cache  # a call of a model asks a dozen times
def _measured(cls: type[Component]) -> dict[str, Unit]:
    units = {name: unit_of(field) or array_unit(field) for name, field in cls.model_fields.items()}
    return {name: unit for name, unit in units.items() if unit is not None}


class StrippingScheme(Component):
    """The common part of all stripping schemes: time, position and velocity at which particles leave the progenitor.

    A scheme derives from `Stripping` or from `LiveStripping`. A `Stripping` releases the particles from the progenitor
    one after the other. A `LiveStripping` fills the progenitor with particles at the look-back time and follows all of
    them. Use this class for annotations only.
    """

    role: ClassVar[str] = "stripping"
    draws: ClassVar[int]
    """Number of random numbers for each particle."""

    particles: int = Field(default=10000, ge=2, le=10**7, description="Number of particles, both tails together.")
    quasi_random: bool = Field(
        default=True,
        description="Draw the normals from a scrambled Sobol sequence per tail (half the noise), or independently.",
    )


class Stripping(StrippingScheme):
    """A scheme that releases particles from the progenitor, with standard normals as its random numbers.

    For each stream the model calls `times`, then `release` once for all n particles. It then follows the particles
    itself. Both methods get the progenitor's orbit in kpc, km/s and kpc/(km/s), and may raise `OutOfDomain`. Every such
    scheme has the fields below.
    """

    progenitor_gravity: bool = Field(
        default=True, description="Whether the particles feel the progenitor after their release."
    )
    release_times: Literal["uniform", "pericentre"] = Field(
        default="uniform",
        description="Equal time steps (Gibbons+ 2014), or bursts at the pericentres on top of a uniform rate.",
    )
    burst_width: Duration = Field(default=0.1, description="Standard deviation in time of a pericentre burst.")
    burst_fraction: PositiveNumber = Field(
        default=0.7, le=1, description="Fraction of the particles released in the pericentre bursts."
    )
    mass_loss: Number = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="Fraction of its mass that the progenitor loses from the look-back time to today, in step with the "
        "release of particles. Its tidal radius and its gravity follow.",
    )

    @abstractmethod
    def release(self, orbit: Orbit, tail: IntArray, mass: float | Array, normals: Array) -> Release:
        """Place the particles.

        Parameters
        ----------
        orbit
            The progenitor at the n release times, with tidal radii.
        tail
            (n,) -1 for the inner Lagrange point (leading), +1 for the outer one (trailing).
        mass
            Mass of the progenitor in Msun, a number or (n,) at the release times.
        normals
            (draws, n) standard normals that belong to the particles: the only random numbers of the scheme.

        All arrays are read-only.
        """

    def times(self, orbit: Orbit) -> Array:
        """(particles,) Increasing release times; two particles, one per Lagrange point, share each.

        Gibbons+ 2014, section 3.2: equal steps from the look-back time to today.
        """
        n = (self.particles + 1) // 2
        u = np.arange(n) / n
        if self.release_times == "uniform":
            t = orbit.t[0] * (1.0 - u)
        else:
            t = np.interp(u, self._cumulative(orbit), orbit.t)
        return np.repeat(t, 2)[: self.particles]

    def _cumulative(self, orbit: Orbit) -> Array:
        """(T,) Fraction released by each time of the track: uniform plus Gaussian bursts at the pericentres."""
        uniform = (orbit.t - orbit.t[0]) / (orbit.t[-1] - orbit.t[0])
        peri = orbit.pericentres()
        if len(peri) == 0:
            return np.asarray(uniform)
        steps = ndtr((orbit.t[:, None] - peri) / (self.burst_width * GYR)).sum(axis=1)
        steps = (steps - steps[0]) / (steps[-1] - steps[0])
        return np.asarray((1 - self.burst_fraction) * uniform + self.burst_fraction * steps)


class Integrator(Component):
    """Advances particles over one block of time. The model releases them and keeps their records.

    The model calls `advance` for each block, in order, with the particles that have been released by its end. A force
    that fails, or that raises `OutOfDomain`, does so within the calls of the field: let these exceptions pass.
    """

    role: ClassVar[str] = "integrator"
    order: ClassVar[int]
    """Order of convergence: measured by the conformance tests."""
    longest_block: ClassVar[float] = 0.05
    """Upper limit of a block in Gyr."""
    resolves_passages: ClassVar[bool] = False
    """Whether it resolves a body that flies past a particle in one block, as `adaptive_step` does."""
    drag: ClassVar[bool] = False
    """Whether it honours forces that depend on velocity (`Potential.drag`): `split_step` and `adaptive_step` do, and
    `field.acceleration(t, q, v)` has them."""

    @abstractmethod
    def advance(self, field: ForceField, q: Array, v: Array, t0: Array, t1: float) -> None:
        """Advance q, v (3, n), in place, from their own times t0 (n,), never decreasing, to t1.

        Particles are independent: the path of one must not depend on the others.
        """

    def steps(self, duration: float) -> dict[str, float]:
        """Return the number of steps of a particle over a duration in Gyr, by the field that decides it.

        A run file with more than 10 million steps is refused. By default the deciding field is ``step``, in Gyr, if
        there is one.
        """
        step = getattr(self, "step", None)
        return {"step": duration / step} if isinstance(step, float) and step > 0 else {}


class Measurement(Component):
    """Data, and how a prediction is compared with them: the common part of `Observable` and `HostData`.

    streamkit calls `data` once, or for each set of parameters if a field has a prior. It compares each prediction with
    the data by a Gaussian likelihood, or by `ln_likelihood`. Values, errors and predictions are (m,), in the units that
    the measurement chooses. The optional methods serve the pages, tables and checks of a fit.
    """

    likelihood_details: ClassVar[tuple[str, ...] | None] = None
    """The details of a prediction that an overridden `ln_likelihood` reads; () for none.

    An observable that declares them allows a sampler to emulate its predictions and to call `ln_likelihood` for n
    points at once. Mean, variance and details then have one more axis in front, (n, m). Fields with a prior are arrays
    (n, 1). The result is (n,), as NumPy gives it where sums are over the last axis. None means that nothing is
    declared. An observable without an `ln_likelihood` need not declare anything."""

    @abstractmethod
    def data(self) -> tuple[Array, Array]:
        """Return the observed values and their standard errors, (m,) each, NaN where there is no datum.

        A prediction may be NaN where there is no datum, and nowhere else. Called once if no field has a prior, else
        for every set of parameters.
        """

    def quantities(self) -> dict[str, IntArray]:
        """Return the rows of `data` that belong to each measured quantity, by its name. Optional.

        A quantity has one unit, such as a column of a table. Each row belongs to one quantity. By default all data are
        one quantity with the name of the kind. `check` and the tables of a fit judge each quantity by itself.
        """
        return {self.kind: np.arange(len(self.data()[0]))}

    def scatter(self, prediction: Prediction) -> Array:
        """Return the standard deviations (m,) of the data about a prediction: their errors by default. Optional.

        A likelihood with a further term overrides it: an extra dispersion, or for single stars the spread of the
        debris. The noise of the model is not part of it. Tables give deviations in units of it.
        """
        return np.asarray(self.data()[1], dtype=float)

    def covariance(self) -> Array | None:
        """Return the covariance (m, m) of the data, or None where their errors are independent. Optional.

        Its diagonal is the square of the errors of `data`; rows and columns without a datum are not used.
        """
        return None

    def ln_likelihood(self, prediction: Prediction, add_noise: bool) -> float | Array | None:
        """Return the natural log of the probability density of the data, or None for a Gaussian. Optional.

        Parameters
        ----------
        prediction
            The result of `predict`; it has a value.
        add_noise
            Whether to add the prediction's own variance to that of the data.
        """
        return None

    def ln_likelihoods(self, prediction: Prediction, add_noise: bool) -> Array | None:
        """Return the ln likelihood (m,) of each datum if `ln_likelihood` is overridden; None where it has no terms.

        Their sum is that of `ln_likelihood`, whose arguments these are. Leave-one-out comparisons read them. Optional.
        """
        return None

    def residuals(self, prediction: Prediction, add_noise: bool) -> Array | None:
        """Return the residual (m,) of each datum if `ln_likelihood` is overridden; None where there are none. Optional.

        A residual is standard normal if the prediction is right: data minus model in standard deviations, or the normal
        score of the datum in its predicted distribution (Dunn & Smyth 1996). The goodness of fit of a run is judged by
        the residuals. For a Gaussian likelihood streamkit computes them.

        Parameters
        ----------
        prediction, add_noise
            As for `ln_likelihood`.
        """
        return None

    def likelihood_fields(self) -> tuple[str, ...]:
        """Return the fields that `ln_likelihood` alone reads: `predict` and `data` do not depend on them. Optional."""
        return ()

    def mock(self, prediction: Prediction, rng: np.random.Generator) -> dict[str, Any]:
        """Draw mock data about the prediction; return their fields as a run file writes them. Optional.

        The noise is that of the data, drawn from ``rng``; `streamkit calibrate` needs it.
        """
        raise StreamkitError(f"the {self.role} {self.kind} makes no mock data: define `mock`")

    def radii(self) -> dict[str, float]:
        """Return the Galactocentric radii in kpc of the data, by name; figures of profiles mark them. Optional."""
        return {}


class Observable(Measurement):
    """A measurement of a stream as a survey would make it, and the data it is compared with.

    streamkit calls `predict` for each stream, and compares the result with `data`. `predict` should return a prediction
    with a ``why_not`` where a stream lacks the measured feature; it may raise `OutOfDomain`, which also gives ln p =
    -inf. The optional methods `marks`, `panels`, `sky_frame` and `remarks` serve pictures, tables and warnings.
    """

    role: ClassVar[str] = "observable"
    wants_live: ClassVar[bool] = False
    """Whether the data depend on the rate at which debris leaves: `check` then warns of a scheme that assumes one."""

    @abstractmethod
    def predict(self, stream: Stream) -> Prediction:
        """Return the prediction (m,) for a stream; with a ``why_not`` for a stream without the measured feature."""

    def marks(self, prediction: Prediction) -> tuple[Mark, ...]:
        """Return the marks of the measurement and of the data in a picture of the unwrapped stream. Optional."""
        return ()

    def panels(self, stream: Stream, prediction: Prediction) -> tuple[Panel, ...]:
        """Return pictures of the stream on the sky, in place of the unwrapped stream. Optional."""
        return ()

    def sky_frame(self) -> Frame:
        """Return the frame on the sky that the data are given in, for tables of particles. Optional."""
        return None

    def remarks(self, prediction: Prediction) -> tuple[str, ...]:
        """Return warnings about the measurement, one sentence each; `check` and `stream` print them. Optional."""
        return ()
