"""The base of potentials: what a force is given, what is prepared for it once, and how it may change with time."""

from __future__ import annotations

import dis
import inspect
from abc import abstractmethod
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, PrivateAttr, field_validator
from pydantic.fields import FieldInfo

from streamkit import engine, expansion
from streamkit.components.bases import Component
from streamkit.components.total import Total
from streamkit.errors import PluginError, StreamkitError, blamed, nearest
from streamkit.fields import Columns, Table
from streamkit.stream import Array, read_only
from streamkit.units import GYR

DEEPEST = 3  # most dimensions of an array that compiled code gets


HOST = "host"  # what `prepare` calls the rest of the host
MOVING = "x", "y", "z", "vx", "vy", "vz", "t"  # the first arguments of `drag`


def _check_signature(cls: type[Potential]) -> None:
    where = f"{cls.__module__}.{cls.__name__}"
    if "growth" in inspect.get_annotations(cls):
        raise PluginError(f"{where}: the field 'growth' belongs to every potential: call yours something else")
    found = tuple(inspect.signature(cls.acceleration).parameters)
    own = [name for name in cls.model_fields if name != "growth"]
    fields = ["x", "y", "z", "t", *cls.measured()]
    if cls.prepare is Potential.prepare:
        if found != tuple(fields):
            raise PluginError(
                f"{where}.acceleration: the arguments must be ({', '.join(fields)}), "
                f"that is x, y, z, t and then the fields by name; found ({', '.join(found)})"
            )
        if odd := [name for name in own if name not in fields]:
            raise PluginError(
                f"{where}: every field of a potential must be a number with a unit or an array of them (Mass, Length, "
                f"LengthArray, ...), unless the class defines `prepare`, which gets all fields; {', '.join(odd)} is not"
            )
    else:
        for name in inspect.signature(cls.prepare).parameters:
            if name not in own and name != HOST:
                raise PluginError(
                    f"{where}.prepare: the arguments are fields by name; found {name!r}.{nearest(name, own)} "
                    f"Fields: {', '.join(own)}"
                )
        for method in (cls.acceleration, cls.potential) if cls.has_energy() else (cls.acceleration,):
            given = tuple(inspect.signature(method).parameters)
            if given[:4] != ("x", "y", "z", "t") or given != found:
                raise PluginError(
                    f"{where}: acceleration and potential must have the same arguments: x, y, z, t and then what "
                    f"`prepare` gives, or fields, by name; found ({', '.join(given)})"
                )
    if cls.has_drag():
        given, wanted = tuple(inspect.signature(cls.drag).parameters), (*MOVING, *found[4:])
        if given != wanted:
            raise PluginError(
                f"{where}.drag: the arguments must be ({', '.join(wanted)}), that is position, velocity, time and then "
                f"those of `acceleration`; found ({', '.join(given)})"
            )
    written: tuple[Any, ...] = (cls.acceleration, cls.drag)
    for method in written:
        if cls.compiled and any(step.opname == "RAISE_VARARGS" for step in dis.get_instructions(method)):
            raise PluginError(
                f"{where}.{method.__name__}: compiled code cannot raise or assert, the exception "
                "would be lost: return NaN where there is no force, bound the fields, or set `compiled = False`"
            )


EVALUATION = "expansion", "tolerance"  # fields that every potential has that is not compiled


def _add_evaluation(cls: type[Potential]) -> None:
    """Give a potential that is not compiled the fields of its evaluation, after the author's."""
    chosen = "auto" if cls.evaluation == "expansion" else "none"
    said = (
        "What the stream is made with: an expansion of the potential, spherical, axisymmetric, general, or auto, the "
        "simplest that its symmetries allow; none asks the potential itself, slowly."
    )
    limit = "Largest relative error of the acceleration by the expansion, from 0.1 to 500 kpc."
    fields: dict[str, tuple[Any, Any]] = {
        "expansion": (Literal["auto", "spherical", "axisymmetric", "general", "none"], Field(chosen, description=said)),
        "tolerance": (float, Field(1e-4, ge=1e-8, le=0.1, description=limit)),
    }
    for name, (annotation, default) in fields.items():
        if name in cls.model_fields:
            raise PluginError(f"{cls.__module__}.{cls.__name__}: no field of a potential may be called {name!r}")
        cls.__pydantic_fields__[name] = FieldInfo.from_annotated_attribute(annotation, default)
        cls.__annotations__[name] = annotation
    cls.model_rebuild(force=True)


class Potential(Component):
    """A gravitational potential, centred on the origin."""

    role: ClassVar[str] = "potential"

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Check the author's signatures where the class is written."""
        super().__pydantic_init_subclass__(**kwargs)
        if cls.__dict__.get("kind"):
            _check_signature(cls)
            if not cls.compiled:
                _add_evaluation(cls)

    compiled: ClassVar[bool] = True
    """False: `acceleration` is called with whole arrays through NumPy, for bodies that numba cannot take."""
    evaluation: ClassVar[Literal["exact", "expansion"]] = "exact"
    """What is made of a potential that is not compiled, unless the run file says otherwise with ``expansion``."""

    _expanded: expansion.Expanded | None = PrivateAttr(None)
    _like: Potential | None = PrivateAttr(None)
    _place: str = PrivateAttr("")
    _others: tuple[Potential, ...] = PrivateAttr(())

    @staticmethod
    @abstractmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, *parameters: Any) -> Any:
        """Return ``(ax, ay, az)`` in (km/s)^2/kpc at position (kpc) and time t (kpc/(km/s)).

        The arguments after t are the fields, by name and in order, in engine units (kpc, km/s, Msun, radians); with a
        `prepare`, what it gives and fields, by name.
        Elementwise: floats in, floats out; arrays of one shape in, arrays of that shape out. Write ``log``,
        ``exp`` and ``power`` with the functions that streamkit exports: they compile to vector code.
        """

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, *parameters: Any) -> Any:
        """Return the potential in (km/s)^2 for the same arguments. Optional: energies need it."""
        raise StreamkitError("this potential gives no potential energy: define `potential` beside `acceleration`")

    @staticmethod
    def drag(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, t: Any, *parameters: Any) -> Any:
        """Return ``(ax, ay, az)`` in (km/s)^2/kpc that depends on the velocity (km/s) too: friction. Optional.

        Added to `acceleration`, with the same arguments after t, and written and compiled as it is. Particles, the
        progenitor and bodies feel it at their velocity from the host's centre; ``growth`` multiplies it too. It does
        not count in energies, masses and tidal radii. A host may have it, a body or a progenitor may not; and not every
        integrator knows it (`Integrator.drag`).
        """
        return 0.0, 0.0, 0.0

    @staticmethod
    def equilibrium(share: Array, chance: Array, *parameters: Any) -> tuple[Array, Array]:
        """Return radii in kpc and speeds in km/s of particles of a sphere in isotropic equilibrium. Optional.

        A stripping scheme that follows a live progenitor asks for it, and uses Eddington's formula where a potential
        does not define it.

        Parameters
        ----------
        share
            (n,) share of the mass that is inside each radius, between 0 and 1.
        chance
            (n,) share of the particles there that are slower, between 0 and 1.
        parameters
            As those of `acceleration`.
        """
        raise NotImplementedError

    @classmethod
    def has_equilibrium(cls) -> bool:
        """Say whether the class defines `equilibrium`."""
        return cls.equilibrium is not Potential.equilibrium

    @staticmethod
    def prepare(*fields: Any) -> Any:
        """Return what `acceleration` needs and is computed once for all positions: splines, expansions. Optional.

        The arguments are fields by name, those that are needed: numbers and arrays in engine units, others as they
        are. The result is a mapping or a named tuple of numbers and arrays of up to three dimensions; `acceleration`
        gets those that it names, beside the fields that it names. With ``compiled = False`` it may hold any object.
        Called once per instance, so once for every set of parameters. May raise `OutOfDomain`.

        The argument ``host``, unless a field has this name, is a `HostView` of the other parts of the host today: of
        those that do not ask for it themselves, so that two that ask see the same. A part that asks may be no
        progenitor and no body. Alone, as in the conformance tests, it finds a host without mass.
        """
        raise NotImplementedError

    growth: Annotated[Table, Columns(t="Gyr", factor="").increasing("t")] | None = Field(
        default=None,
        repr=False,
        description="Factor on the force as a table of time (t = 0 is today, where it must be 1): linear between the "
        "rows, constant before the first and after the last. The parameters are those of today.",
    )
    _prepared: tuple[int, tuple[Any, ...]] = PrivateAttr((0, ()))

    @field_validator("growth")
    @classmethod
    def _as_it_is_today(cls, growth: Table | None) -> Table | None:
        if growth is not None:
            if abs(now := float(np.interp(0.0, growth["t"], growth["factor"])) - 1.0) > 1e-9:
                raise ValueError(f"the factor today (t = 0) is {now + 1.0:g}, expected 1: divide all factors by it")
            if (low := float(growth["factor"].min())) < 0:
                raise ValueError(f"found the factor {low:g}, expected zero or more")
        return growth

    def growth_table(self) -> tuple[Array, Array] | None:
        """Return times (n,) in engine units and the factors (n,) on the force; None if it does not change."""
        return None if self.growth is None else (self.growth["t"] * GYR, self.growth["factor"])

    def in_engine_units(self) -> tuple[Any, ...]:
        """Return the arguments of `acceleration` after t: the fields, or what `prepare` makes of them."""
        if type(self).prepare is Potential.prepare:
            return super().in_engine_units()
        owner, values = self._prepared
        if owner != id(self):  # not yet, or copied from another instance
            values = _prepare(self)
            self._prepared = id(self), values
        return values

    def __getstate__(self) -> dict[Any, Any]:
        """Leave out what was prepared or expanded: it may be large, and need not pickle."""
        state, made = super().__getstate__(), {"_prepared": (0, ()), "_expanded": None, "_like": None}
        return state | {"__pydantic_private__": (state["__pydantic_private__"] or {}) | made}

    @classmethod
    def has_energy(cls) -> bool:
        """Say whether the class defines `potential`."""
        return cls.potential is not Potential.potential

    @classmethod
    def has_drag(cls) -> bool:
        """Say whether the class defines `drag`."""
        return cls.drag is not Potential.drag

    @property
    def place(self) -> str:
        """Where it stands in the run file: ``potential.halo``; empty if it comes from none."""
        return self._place

    def share_grid_of(self, other: Potential, place: str) -> None:
        """Take the nodes of an expansion from another instance of the class, so that ln p has no steps.

        ``place`` is the path in the run file, for messages.
        """
        self._like, self._place = other, place

    @classmethod
    @cache
    def asks_for_host(cls) -> bool:
        """Say whether `prepare` wants the other parts of the host."""
        return HOST in inspect.signature(cls.prepare).parameters and HOST not in cls.model_fields

    def beside(self, others: tuple[Potential, ...]) -> Potential:
        """Return a copy whose `prepare` gets these parts of the host."""
        copy = self.model_copy()
        copy._others, copy._prepared, copy._expanded = others, (0, ()), None
        return copy

    def in_loop(self) -> engine.Force:
        """Return what stands for the potential in the compiled loop: itself, or an expansion."""
        found = self.expanded()
        return self if found is None else found.force

    def expanded(self) -> expansion.Expanded | None:
        """Return the expansion that the stream is made with, made on first use; None if there is none.

        Raises StreamkitError if it cannot be made, or misses its tolerance; OutOfDomain if it was made for other
        parameters and misses the tolerance at these.
        """
        if self.compiled or self.expansion == "none":  # type: ignore[attr-defined]  # see `_add_evaluation`
            return None
        if self._expanded is None:
            exact = engine.build_field([self], exact=True).acceleration
            form, tolerance = self.expansion, self.tolerance  # type: ignore[attr-defined]
            other = self._like
            model = None if other is None or other is self else other.expanded()
            if model is None:
                try:
                    self._expanded = expansion.expand(exact, form, tolerance)
                except expansion.NoExpansion as error:
                    raise StreamkitError(f"{self._place or 'potential'} ({self.kind}): {error}") from None
            else:
                missed = f"the expansion of the potential {self.kind} misses its tolerance"
                self._expanded = expansion.expand_like(model, exact, tolerance, missed)
        return self._expanded


def _prepare(potential: Potential) -> tuple[Any, ...]:
    """Return the arguments of `acceleration` after t of a class with `prepare`."""
    cls = type(potential)
    fields = {name: getattr(potential, name) for name in cls.model_fields}
    fields |= dict(zip(cls.measured(), Component.in_engine_units(potential), strict=True))
    if cls.asks_for_host():
        fields[HOST] = Total(potential._others)
    with blamed(f"potential {cls.kind}"):
        found = cls.prepare(**{name: fields[name] for name in inspect.signature(cls.prepare).parameters})
    prepared = found._asdict() if hasattr(found, "_asdict") else found
    where = f"{cls.__module__}.{cls.__name__}"
    if not isinstance(prepared, Mapping):
        raise PluginError(f"{where}.prepare: found {prepared!r}, expected a mapping or a named tuple")
    known = fields | dict(prepared)
    values = []
    for name in list(inspect.signature(cls.acceleration).parameters)[4:]:
        if name not in known:
            raise PluginError(
                f"{where}.acceleration: the argument {name!r} is no field, and `prepare` does not give it."
                f"{nearest(name, known)} It gives {', '.join(prepared) or 'nothing'}."
            )
        values.append(_plain(known[name], f"{where}.prepare: {name!r}") if cls.compiled else known[name])
    return tuple(values)


def _plain(value: Any, what: str) -> float | Array:
    """Return a number, or an array that nobody changes."""
    try:
        array = np.ascontiguousarray(value, dtype=float) if np.ndim(value) else float(value)
    except (TypeError, ValueError):
        raise PluginError(
            f"{what}: found {value!r}, expected a number or an array; or set `compiled = False`"
        ) from None
    if np.ndim(array) > DEEPEST:
        raise PluginError(f"{what}: found an array of {np.ndim(array)} dimensions, at most {DEEPEST} are possible")
    return read_only(array) if np.ndim(array) else array
