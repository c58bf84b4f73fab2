"""One section of a run file: its class, its values and priors, and its errors as sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from streamkit.errors import OutOfDomain
from streamkit.spec.priors import KINDS, Prior, parse, quantity
from streamkit.spec.sentences import sentence, should, unknown_field
from streamkit.units import Unit, unit_of

M = TypeVar("M", bound=BaseModel)
_EDGE = 1e-6  # a prior may end on an open bound, such as 0 for a length: its inside is what must be allowed


@dataclass(frozen=True)
class Section(Generic[M]):
    """A validated section.

    Attributes
    ----------
    path
        Where it stands in the run file: ``potential.halo``.
    cls
        The class that validates it.
    given
        The values from the run file of the fields without a prior.
    priors
        The priors of the other ones.
    centre
        The instance with every free field at the centre of its prior.
    """

    path: str
    cls: type[M]
    given: dict[str, Any]
    priors: dict[str, Prior]
    centre: M

    def build(self, values: Mapping[str, float]) -> M:
        """Return the instance at ``values``, by the full name of each free field.

        Raises
        ------
        OutOfDomain
            If a value breaks the field's own constraint.
        """
        if not self.priors:
            return self.centre
        try:
            return self.cls.model_validate(self.given | {name: values[full] for name, full in self._free})
        except ValidationError as error:
            where = ".".join([self.path, *(str(part) for part in error.errors()[0]["loc"][:1])])
            raise OutOfDomain(f"{where} is outside its allowed range") from None

    @cached_property
    def _free(self) -> list[tuple[str, str]]:
        return [(name, f"{self.path}.{name}") for name in self.priors]

    def parameters(self) -> dict[str, Unit]:
        """Return the units of the fields that may have a prior."""
        return {name: unit for name, field in self.cls.model_fields.items() if (unit := unit_of(field)) is not None}

    def defaults(self) -> dict[str, Any]:
        """Return the fields that have a default, as the resolved run file writes the default."""
        fields = ((n, f) for n, f in self.cls.model_fields.items() if not f.is_required())
        values = ((name, field, field.get_default(call_default_factory=True)) for name, field in fields)
        return {n: _written(v, unit_of(f)) for n, f, v in values if v is not None}

    def document(self) -> dict[str, Any]:
        """Return the section as the resolved run file holds it: every field, quantities as text."""
        out: dict[str, Any] = {}
        for name, field in self.cls.model_fields.items():
            given = self.given.get(name)
            if name in self.priors:
                out[name] = self.priors[name].document(unit_of(field) or Unit(""))
            elif isinstance(given, list) and all(isinstance(item, str | int | float) for item in given):
                out[name] = given  # pairs such as a datum and its error keep the units they were given with
            elif (value := getattr(self.centre, name)) is not None:
                out[name] = _written(value, unit_of(field))
        return out


def _written(value: Any, unit: Unit | None) -> Any:
    """Write a validated value in the run file's terms."""
    if unit is not None:
        return quantity(float(value), unit)
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_none=True)
    return list(value) if isinstance(value, list | tuple) else value


def read_section(
    path: str, cls: type[M], table: Mapping[str, Any], errors: list[str], called: str = ""
) -> Section[M] | None:
    """Validate the table of a section; on failure append one sentence per error and return None.

    Parameters
    ----------
    path
        Where the section stands in the run file.
    cls
        The class to validate with.
    table
        The section without its ``kind``.
    errors
        Grows by one sentence per error.
    called
        What messages call the class: ``the potential 'tf'``.
    """
    before = len(errors)
    given: dict[str, Any] = {}
    priors: dict[str, Prior] = {}
    broken: set[str] = set()
    for name, value in table.items():
        where, field = f"{path}.{name}", cls.model_fields.get(name)
        if field is None:
            errors.append(unknown_field(where, name, cls, called))
            continue
        try:
            prior = _prior(field, value)
        except ValueError as error:
            errors.append(f"{where}: {error}")
            broken.add(name)
            continue
        if prior is None:
            given[name] = value
        else:
            priors[name] = prior
    trial = given | {name: prior.centre for name, prior in priors.items()}
    for name, prior in priors.items():
        if problem := _outside(cls, trial, name, prior):
            errors.append(f"{path}.{name}: {problem}")
            broken.add(name)
    try:
        centre = cls.model_validate(trial)
    except ValidationError as error:
        items = [item for item in error.errors() if not (item["loc"] and item["loc"][0] in broken)]
        errors.extend(sentence(path, cls, item) for item in items if item["type"] != "extra_forbidden")
        return None
    if len(errors) > before:
        return None
    numbers = {name: getattr(centre, name) for name in given if unit_of(cls.model_fields[name]) is not None}
    return Section(path, cls, given | numbers, priors, centre)  # so that build() does not parse text again


def _prior(field: FieldInfo, value: Any) -> Prior | None:
    """Return the prior that stands for a value, if one does; refuse values that pydantic would bend."""
    unit = unit_of(field)
    if isinstance(value, Mapping):
        if unit is not None:
            return parse(value, unit)
        if len(value) == 1 and next(iter(value)) in KINDS:
            raise ValueError("takes no prior: only physical numbers do. Give a plain value.")
    elif unit is None and field.annotation in (bool, int, float):
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if field.annotation is bool and not isinstance(value, bool):
            raise ValueError(f"found {value!r}, expected true or false, without quotes")
        if field.annotation is not bool and not number:
            what = "a whole number" if field.annotation is int else "a number"
            raise ValueError(f"found {value!r}, expected {what}, without quotes")
    return None


def _outside(cls: type[BaseModel], trial: dict[str, Any], name: str, prior: Prior) -> str:
    """Return a sentence if some of the prior's range breaks the field's own constraint."""
    low, high = prior.support
    inset = _EDGE * (high - low)
    ends = [low + inset, high - inset] if math.isfinite(inset) else list(filter(math.isfinite, (low, high)))
    for value in (*ends, prior.centre):
        try:
            cls.model_validate(trial | {name: value})
        except ValidationError as error:
            for item in error.errors():
                if item["loc"][:1] == (name,):
                    unit = unit_of(cls.model_fields[name])
                    return (
                        f"the prior {prior.text(unit.name if unit else '')} reaches outside the field's "
                        f"range: a value {should(item['msg'])}"
                    )
    return ""
