"""The base of potentials: the arguments of a force, its preparation, its expansion."""

from __future__ import annotations

import inspect
from abc import abstractmethod
from functools import cache
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import PrivateAttr

from streamkit import engine, expansion
from streamkit.components.changes import Changing
from streamkit.components.signature import HOST, add_evaluation, check_signature, prepared_arguments
from streamkit.components.total import Total
from streamkit.errors import StreamkitError
from streamkit.stream import Array
from streamkit.units import GYR


class Potential(Changing):
    """A gravitational potential, centred on the origin.

    The static methods `acceleration`, `potential` and `drag` are formulas: numba compiles them into the loops over
    particles, which call them for the host, the progenitor and bodies. They take and return floats, or arrays of one
    shape. They cannot raise, so a force outside its domain is NaN. `prepare` is called once for each set of
    parameters before them, and may raise `OutOfDomain`. With ``compiled = False`` the methods are Python functions of
    whole arrays, and may raise `OutOfDomain` too.
    """

    role: ClassVar[str] = "potential"

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Check the author's signatures where the class is written."""
        super().__pydantic_init_subclass__(**kwargs)
        if cls.__dict__.get("kind"):
            check_signature(cls, prepares=cls.prepare is not Potential.prepare)
            if not cls.compiled:
                add_evaluation(cls)

    compiled: ClassVar[bool] = True
    """False: `acceleration` is called with whole arrays through NumPy, for code that numba cannot compile."""
    evaluation: ClassVar[Literal["exact", "expansion"]] = "exact"
    """Default of the field ``expansion`` of a potential that is not compiled: an expansion, or the potential itself."""
    linear: ClassVar[str] = ""
    """The field that the force is proportional to. Where it alone changes, an expansion is not made anew."""
    vanishes: ClassVar[bool] = False
    """True for a perturbation, zero at some places: errors of its expansion are relative to its usual force."""

    is_spherical: ClassVar[bool] = False  # as a `Spherical` is

    # The methods that an author writes, and their arguments before the parameters. `Spherical` replaces them.
    _force_method: ClassVar[str] = "acceleration"
    _energy_method: ClassVar[str] = "potential"
    _place_arguments: ClassVar[tuple[str, ...]] = ("x", "y", "z", "t")

    _expanded: expansion.Expanded | None = PrivateAttr(None)
    _like: Potential | None = PrivateAttr(None)
    _place: str = PrivateAttr("")
    _others: tuple[Potential, ...] = PrivateAttr(())

    @staticmethod
    @abstractmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, *parameters: Any) -> Any:
        """Return ``(ax, ay, az)`` in (km/s)^2/kpc at position (kpc) and time t (kpc/(km/s)).

        The arguments after t are the fields, by name and in order, in engine units (kpc, km/s, Msun, radians). With a
        `prepare` they are its results and fields, by name.
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

        It is added to `acceleration`, has the same arguments after t, and is written and compiled in the same way. It
        acts on particles, the progenitor and bodies, with their velocity relative to the host's centre; ``growth``
        multiplies it too. It does not enter energies, masses and tidal radii. A host may have it; a body or a
        progenitor may not. Not every integrator supports it (`Integrator.drag`).
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
            (n,) fraction of the mass inside each radius, between 0 and 1.
        chance
            (n,) fraction of the particles at the radius that are slower, between 0 and 1.
        parameters
            The same as for `acceleration`.
        """
        raise NotImplementedError

    @classmethod
    def has_equilibrium(cls) -> bool:
        """Say whether the class defines `equilibrium`."""
        return cls.equilibrium is not Potential.equilibrium

    @staticmethod
    def prepare(*fields: Any) -> Any:
        """Compute once, for all positions, arguments of `acceleration` such as splines and expansions. Optional.

        The arguments are the needed fields by name: numbers and arrays in engine units, other values unchanged. The
        result is a mapping or a named tuple of numbers and arrays of up to three dimensions. `acceleration` gets those
        results, and those fields, that its arguments name. With ``compiled = False`` results may be any objects. Called
        once per instance, which is once for every set of parameters. May raise `OutOfDomain`.

        The argument ``host``, unless a field has this name, is a `HostView` of the other parts of the host today. Parts
        with this argument are not in the view, so that two such parts see the same host. Such a part cannot be a
        progenitor or a body. Without other parts, as in the conformance tests, the host has no mass.
        """
        raise NotImplementedError

    def known_times(self) -> Array | None:
        """Return the times (n,) in Gyr, increasing, from the first to the last of which the force is known. Optional.

        0 is today. A run whose look-back time begins earlier is refused. With ``compiled = False`` the expansion is
        made at these times, and is a cubic spline in between. None: the force is known at all times.
        """
        return None

    def known_order(self) -> int | None:
        """Return the largest order m of the harmonics of the azimuth: an expansion has no others. Optional."""
        return None

    _prepared: tuple[int, tuple[Any, ...]] = PrivateAttr((0, ()))

    def in_engine_units(self) -> tuple[Any, ...]:
        """Return the arguments of `acceleration` after t: the fields, or the results of `prepare` and fields."""
        if type(self).prepare is Potential.prepare:
            return super().in_engine_units()
        owner, values = self._prepared
        if owner != id(self):  # not yet, or copied from another instance
            fields = {name: getattr(self, name) for name in type(self).model_fields}
            fields |= dict(zip(self.measured(), super().in_engine_units(), strict=True))
            if self.asks_for_host():
                fields[HOST] = Total(self._others)
            values = prepared_arguments(type(self), fields)
            self._prepared = id(self), values
        return values

    def __getstate__(self) -> dict[Any, Any]:
        """Leave out prepared values and expansions: they may be large, and may not pickle."""
        state, made = super().__getstate__(), {"_prepared": (0, ()), "_expanded": None, "_like": None}
        return state | {"__pydantic_private__": (state["__pydantic_private__"] or {}) | made}

    @classmethod
    def force_arguments(cls) -> tuple[str, ...]:
        """Return the names of the arguments of the force that the author has written."""
        return tuple(inspect.signature(getattr(cls, cls._force_method)).parameters)

    @classmethod
    def has_energy(cls) -> bool:
        """Return whether the class defines `potential`."""
        return cls.potential is not Potential.potential

    @classmethod
    def has_drag(cls) -> bool:
        """Return whether the class defines `drag`."""
        return cls.drag is not Potential.drag

    @property
    def place(self) -> str:
        """The path in the run file, such as ``potential.halo``; empty without a run file."""
        return self._place

    def share_grid_of(self, other: Potential, place: str) -> None:
        """Use the nodes of another instance's expansion: with other nodes for other parameters ln p would have steps.

        Places are counted from the same point as those of the other one. ``place`` is the path in the run file, for
        messages.
        """
        self._like, self._place, self._origin = other, place, other._origin

    @classmethod
    @cache
    def asks_for_host(cls) -> bool:
        """Return whether `prepare` has the argument ``host``."""
        return HOST in inspect.signature(cls.prepare).parameters and HOST not in cls.model_fields

    def beside(self, others: tuple[Potential, ...]) -> Potential:
        """Return a copy whose `prepare` gets these parts of the host."""
        copy = self.model_copy()
        copy._others, copy._prepared, copy._expanded = others, (0, ()), None
        return copy

    def in_loop(self) -> engine.Force:
        """Return the force in the compiled loop: the potential itself, or its expansion."""
        expanded = self.expanded()
        return self if expanded is None else expanded.force

    def expanded(self) -> expansion.Expanded | None:
        """Return the expansion that replaces the potential, made on first use; None if there is none.

        Raises StreamkitError if it cannot be made, or misses its tolerance. Raises OutOfDomain if its nodes were chosen
        for other parameters and miss the tolerance at the present ones.
        """
        if self.compiled or self.expansion == "none":  # type: ignore[attr-defined]  # see `add_evaluation`
            return None
        if self._expanded is None:
            exact = engine.build_field([self], exact=True).acceleration
            form, tolerance = self.expansion, self.tolerance  # type: ignore[attr-defined]
            other = self._like
            model = None if other is None or other is self else other.expanded()
            times = self.known_times()
            times = None if times is None or len(times) < 2 else times * GYR
            if model is not None and other is not None and (factor := self._times(other)) is not None:
                self._expanded = model.scaled(factor)
            elif model is None:
                try:
                    self._expanded = expansion.expand(exact, form, tolerance, times, self.vanishes, self.known_order())
                except expansion.NoExpansion as error:
                    raise StreamkitError(f"{self._place or 'potential'} ({self.kind}): {error}") from None
            else:
                missed = f"the expansion of the potential {self.kind} misses its tolerance"
                self._expanded = expansion.expand_like(model, exact, tolerance, missed, times, self.vanishes)
        return self._expanded

    def _times(self, other: Potential) -> float | None:
        """Return its force over that of the same potential with another `linear` field; None if it is not the same."""
        ours, theirs = self.__dict__, other.__dict__
        pairs = ((value, theirs[name]) for name, value in ours.items() if name != self.linear)
        alike = all(a is b or (not isinstance(a, np.ndarray) and a == b) for a, b in pairs)
        known = alike and self.linear and theirs[self.linear] and self._others is other._others
        return float(ours[self.linear] / theirs[self.linear]) if known else None
