"""One section of a run file: its class, the model that reads it, its values and its priors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cache, cached_property, partial
from typing import Annotated, Any, Generic, TypeVar

import numpy as np
from annotated_types import BaseMetadata
from pydantic import (
    BaseModel,
    BeforeValidator,
    Field,
    PlainSerializer,
    ValidationError,
    WrapValidator,
    create_model,
)  # fmt: skip

from streamkit.components import Component, Potential, Registry
from streamkit.errors import OutOfDomain, SpecError
from streamkit.fields import DataFile, Files, Table, array_of
from streamkit.runfile.knots import Knots, KnotsTable, without_knots
from streamkit.runfile.priors import PRIORS, Prior, PriorTable, parse, quantity
from streamkit.runfile.sentences import alternatives_joined, sentence, should
from streamkit.units import Unit, unit_of

M = TypeVar("M", bound=BaseModel)
_EDGE = 1e-6  # a prior may end on an open bound, such as 0 for a length: its inside is what must be allowed


@dataclass(frozen=True)
class Section(Generic[M]):
    """A validated section."""

    path: str  # its path in the run file: ``potential.halo``
    cls: type[M]
    given: dict[str, Any]  # the values from the run file of the fields without a prior
    priors: dict[str, Prior]  # by field, or ``v_c.0`` for the first entry of an array
    centre: M  # the instance with every free field at the centre of its prior
    # The values of fields with an array, a table or a file, as the run file has them.
    written: dict[str, Any] = dataclass_field(default_factory=dict)
    knots: dict[str, Knots] = dataclass_field(default_factory=dict)  # the numbers that change in time, by field

    def build(self, values: Mapping[str, float]) -> M:
        """Return the instance at ``values``, by the full name of each free field; `OutOfDomain` if one breaks it."""
        if not self.priors:
            return self.centre
        try:
            free = {name: values[full] for name, full in self._free}
            built = _at(self.cls, self.given, free, self.knots)
        except ValidationError as error:
            where = ".".join([self.path, *(str(part) for part in error.errors()[0]["loc"][:1])])
            raise OutOfDomain(f"{where} is outside its allowed range") from None
        if isinstance(built, Potential):
            built.share_grid_of(self.centre, self.path)  # type: ignore[arg-type]  # it is of the same class
        return built

    @cached_property
    def _free(self) -> list[tuple[str, str]]:
        return [(name, f"{self.path}.{name}") for name in self.priors]

    def entries(self) -> dict[str, Unit]:
        """Return the unit of every number in a list of an array field, as ``v_c.0``: each may have a prior."""
        lists = {name: value for name, value in self.written.items() if isinstance(value, list)}
        marks = {name: mark for name in lists if (mark := array_of(self.cls.model_fields[name])) is not None}
        entries = {f"{name}.{i}": mark.unit for name, mark in marks.items() for i in range(len(lists[name]))}
        return entries | {path: knots.unit for name, knots in self.knots.items() for path in knots.paths(name)}

    def defaults(self) -> dict[str, Any]:
        """Return the fields that have a default, as the resolved run file writes the default."""
        return section_model(self.cls).model_construct().model_dump(mode="json", exclude_none=True, warnings=False)

    def document(self) -> dict[str, Any]:
        """Return the section as the resolved run file holds it: every field, quantities as text."""
        values = {name: self.priors.get(name, getattr(self.centre, name)) for name in self.cls.model_fields}
        written = section_model(self.cls).model_construct(**values).model_dump(mode="json", exclude_none=True)
        # pairs such as a datum and its error keep the units they were given with
        lists = {name: value for name, value in self.given.items() if isinstance(value, list)}
        written |= self.written
        return written | {n: v for n, v in lists.items() if all(isinstance(item, str | int | float) for item in v)}


@cache
def section_model(cls: type[BaseModel], without: tuple[str, ...] = (), in_time: bool = False) -> type[BaseModel]:
    """Derive the model of a section in a run file: its physical numbers may be text or priors.

    The fields of the class itself, which the engine sees, are numbers. The model has the validators of the fields'
    types, and not those of the class. A section ``without`` some fields refuses them. The schema allows numbers that
    change ``in_time``.
    """
    fields: dict[str, Any] = {}
    for name, field in cls.model_fields.items():
        if name in without:
            continue
        unit, description = unit_of(field), field.description
        parts = [field.annotation, *field.metadata]
        if unit is None:
            parts.append(BeforeValidator(partial(_not_converted, field.annotation)))
        else:
            description = f"{description or ''} Unit: {unit.label}.".lstrip()
            bounds = (float, *(item for item in field.metadata if isinstance(item, BaseMetadata)), Field())
            text = Annotated[str, Field(examples=[unit.example])]
            form = Annotated[bounds] | text | PriorTable
            if in_time:
                form |= KnotsTable
            parts.append(WrapValidator(partial(_number_or_prior, unit), json_schema_input_type=form))
            parts.append(PlainSerializer(partial(_written, unit)))
        settings: Any = {"default": field.default, "default_factory": field.default_factory}
        fields[name] = Annotated[tuple(parts)], Field(description=description, **settings)
    summary = (cls.__doc__ or "").strip().partition("\n")[0]
    return create_model(cls.__name__, __config__=cls.model_config, __doc__=summary, **fields)


def _number_or_prior(unit: Unit, value: Any, number: Any) -> Any:
    return parse(value, unit) if isinstance(value, Mapping) else number(value)


def _written(unit: Unit, value: Any) -> Any:
    if isinstance(value, str):  # a word in place of the number
        return value
    return value.document(unit) if isinstance(value, Prior) else quantity(float(value), unit)


def _not_converted(kind: Any, value: Any) -> Any:
    """Refuse values that pydantic would convert: ``"10"`` to a number, 1 to true."""
    wanted = {bool: "true or false", int: "a whole number", float: "a number"}.get(kind)
    if isinstance(value, Mapping) and len(value) == 1 and next(iter(value)) in PRIORS:
        raise ValueError("takes no prior: only physical numbers do. Give a plain value.")
    if wanted and (not isinstance(value, int | float) or isinstance(value, bool) is not (kind is bool)):
        raise ValueError(f"found {value!r}, expected {wanted}, without quotes")
    return value


def read_section(
    path: str,
    cls: type[M],
    table: Mapping[str, Any],
    errors: list[str],
    called: str,
    more: tuple[str, ...] = (),
    files: Files | None = None,
    in_time: bool | None = None,
) -> Section[M] | None:
    """Validate the table of a section, without its ``kind``; on failure add a sentence per error and return None.

    In messages the class is ``called`` such as ``the potential 'tf'``, and ``more`` names other fields of the section.
    Data files are read through ``files``. Numbers may change ``in_time``: those of a potential, unless
    this says otherwise.
    """
    in_time = issubclass(cls, Potential) if in_time is None else in_time
    plain, knots = without_knots(path, cls, table, in_time, errors)
    plain, pulled = _without_priors(path, cls, plain, errors)
    try:
        read = section_model(cls).model_validate(plain, context=files)
    except ValidationError as error:
        errors.extend(sentence(path, cls, item, called, more) for item in alternatives_joined(cls, error.errors()))
        return None
    values = ((name, getattr(read, name)) for name in table)
    priors = {name: value for name, value in values if isinstance(value, Prior)}
    data = {name: value for name in table if isinstance(value := getattr(read, name), np.ndarray | Table | DataFile)}
    trial = {name: priors[name].centre if name in priors else data.get(name, value) for name, value in plain.items()}
    priors |= pulled
    outside = _outside(cls, trial, priors)
    for name, each in knots.items():
        for i, prior in each.priors.items():
            priors[f"{name}.values.{i}"] = prior
            outside |= {f"{name}.values.{i}": said for said in _outside(cls, trial, {name: prior}).values()}
    errors.extend(f"{path}.{name}: {problem}" for name, problem in outside.items())
    try:
        centre = _at(cls, trial, {}, knots)
    except ValidationError as error:
        new = (item for item in error.errors() if item["loc"][:1] not in {(name,) for name in outside})
        errors.extend(sentence(path, cls, item, called) for item in alternatives_joined(cls, new))
        return None
    except ValueError as error:
        errors.append(f"{path}.{error}")
        return None
    given = {  # numbers as read, so that build() does not parse text again
        name: trial[name] if unit_of(cls.model_fields[name]) is None else getattr(centre, name)
        for name in table
        if name not in priors
    }
    if isinstance(centre, Potential):
        centre.share_grid_of(centre, path)
    written = {name: _list_written(cls, name, table[name], pulled) for name in data}
    for name, each in knots.items():
        field, _, index = name.partition(".")
        if index:
            written[field][int(index)] = each.document()
        else:
            written[field] = each.document()
    return None if outside else Section(path, cls, given, priors, centre, written, knots)


def _at(cls: type[M], given: Mapping[str, Any], free: Mapping[str, float], knots: Mapping[str, Knots]) -> M:
    """Return the instance at values of the free fields; ValidationError if it is not allowed at one of the knots."""
    if not knots:
        return cls.model_validate(_filled(given, free))
    moved = {name: each.at(name, free) for name, each in knots.items()}
    fixed = _filled(given, {name: value for name, value in free.items() if name.partition(".values.")[0] not in knots})
    for t in sorted({t for each in moved.values() for t in each.times}):
        cls.model_validate(_filled(fixed, {name: each.at(t) for name, each in moved.items()}))
    built = cls.model_validate(_filled(fixed, {name: each.at(0.0) for name, each in moved.items()}))
    return built.changing(moved) if isinstance(built, Potential) else built


def _without_priors(
    path: str, cls: type[BaseModel], table: Mapping[str, Any], errors: list[str]
) -> tuple[dict[str, Any], dict[str, Prior]]:
    """Put the centres of priors into the lists of array fields; return the table, and the priors as ``v_c.0``."""
    plain, pulled = dict(table), {}
    for name, value in table.items():
        mark = array_of(cls.model_fields[name]) if name in cls.model_fields else None
        if mark is None or not isinstance(value, list) or not any(isinstance(item, Mapping) for item in value):
            continue
        plain[name] = list(value)
        for i, item in enumerate(value):
            if isinstance(item, Mapping):
                try:
                    pulled[f"{name}.{i}"] = parse(item, mark.unit)
                    plain[name][i] = pulled[f"{name}.{i}"].centre
                except ValueError as error:
                    errors.append(f"{path}.{name}.{i}: {error}")
                    plain[name][i] = 1.0
    return plain, pulled


def _list_written(cls: type[BaseModel], name: str, value: Any, pulled: Mapping[str, Prior]) -> Any:
    """Return an array for the resolved run file: as it was given, with priors in the field's unit."""
    mark = array_of(cls.model_fields[name])
    if mark is None or not isinstance(value, list):
        return value
    return [
        pulled[f"{name}.{i}"].document(mark.unit) if f"{name}.{i}" in pulled else item for i, item in enumerate(value)
    ]


def _filled(given: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """Return the fields with other values, those of an array's entries by names such as ``v_c.0``."""
    filled = dict(given)
    for name, value in values.items():
        field, _, index = name.partition(".")
        if index:
            if filled[field] is given[field]:
                filled[field] = np.array(given[field])
            filled[field][int(index)] = value
        else:
            filled[field] = value
    return filled


def _outside(cls: type[BaseModel], trial: dict[str, Any], priors: dict[str, Prior]) -> dict[str, str]:
    """Return a sentence for every prior whose range breaks the constraint of its field."""
    ends = {name: _ends(prior) for name, prior in priors.items()}
    problems: dict[str, str] = {}
    for side in (0, 1):
        try:
            cls.model_validate(_filled(trial, {name: both[side] for name, both in ends.items()}))
        except ValidationError as error:
            for item in error.errors():
                name = str(item["loc"][0]) if item["loc"] else ""
                if name in priors:
                    shown = priors[name].text((unit_of(cls.model_fields[name]) or Unit("")).name)
                    problem = f"the prior {shown} reaches outside the field's range: a value {should(item['msg'])}"
                    problems.setdefault(name, problem)
                elif any(key.startswith(f"{name}.") for key in priors if name):
                    problems.setdefault(name, f"a prior reaches outside the field's range: {should(item['msg'])}")
    return problems


def _ends(prior: Prior) -> tuple[float, float]:
    """Return the ends of a prior's range, from just inside; the centre where there is none."""
    low, high = prior.support
    inset = _EDGE * (high - low)
    if math.isfinite(inset):
        return low + inset, high - inset
    return low if math.isfinite(low) else prior.centre, high if math.isfinite(high) else prior.centre


def at_default(section: Section[Any]) -> list[str]:
    """Return the fields that have the default of the present kind: the new kind has other defaults."""
    document = section.document()
    return [name for name, value in section.defaults().items() if document.get(name) == value]


def lacked(section: Section[Any], values: Mapping[str, Any], registry: Registry) -> list[str]:
    """Return the fields that the run file sets and that the kind in ``values`` lacks; none if no such kind exists."""
    kind = values.get(f"{section.path}.kind")
    if kind is None or not issubclass(section.cls, Component):
        return []
    prefix = f"{section.path}."
    given = {path.removeprefix(prefix): value for path, value in values.items() if path.startswith(prefix)}
    try:
        new = registry.find(section.cls.role, kind, f"{section.path}.kind")
        new = new.for_section({name: value for name, value in given.items() if name != "kind"})
    except (SpecError, ValueError):
        return []
    default = at_default(section)
    return [
        name
        for name in section.document()
        if name not in new.model_fields and name not in given and name not in default
    ]
