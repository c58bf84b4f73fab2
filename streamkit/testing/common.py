"""Checks of every component, and the form in which a check reports a failure."""

from __future__ import annotations

import pickle
import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from pydantic import ValidationError

from streamkit import Component, Sampler

C = TypeVar("C", bound=Component)
# A check takes the example component; it raises AssertionError with one line that says what is wrong.
Check = Callable[[Any], None]


def require(condition: object, message: str) -> None:
    """Raise AssertionError with the message unless the condition holds."""
    if not condition:
        raise AssertionError(message)


def example_of(cls: type[C], **changes: Any) -> C:
    """Build ``Class(**Class.example)`` with some fields changed."""
    return cls(**{**cls.example, **changes})


def title(check: Check) -> str:
    """Return the name of a check as a report shows it."""
    return check.__name__.replace("_", " ")


def failures(component: Component, checks: Sequence[Check], passes: tuple[type[Exception], ...] = ()) -> list[str]:
    """Run the checks on an example component; return one line for each that fails. Exceptions of ``passes`` pass."""
    lines = []
    for check in checks:
        try:
            check(component)
        except passes:
            continue
        except AssertionError as error:
            lines.append(f"{title(check)}: {error}")
        except Exception as error:  # whatever an author's code raises belongs in the report beside the rest
            message = " ".join(str(error).split())  # a compiler's message has many lines
            lines.append(f"{title(check)}: raised {type(error).__name__}: {message[:500]}")
    return lines


def names_itself(component: Component) -> None:
    """Check that the kind is a lower-case identifier and that the class has a docstring of its own."""
    cls = type(component)
    require(
        re.fullmatch(r"[a-z][a-z0-9_]*", cls.kind),
        f"kind must be lower-case letters, digits and underscores, found {cls.kind!r}",
    )
    require((cls.__dict__.get("__doc__") or "").strip(), f"{cls.__name__} has no docstring")


def fields_are_described(component: Component) -> None:
    """Check that each field has a description, and each float a unit, except for those of a sampler."""
    cls = type(component)
    silent = [name for name, field in cls.model_fields.items() if not field.description]
    require(not silent, f"no description: {', '.join(silent)} (write Field(description=...))")
    numbers = {*cls.parameters(), "tolerance"}  # of an expansion: every potential has it that is not compiled
    bare = [n for n, f in cls.model_fields.items() if f.annotation is float and n not in numbers]
    require(
        not bare or isinstance(component, Sampler),
        f"plain float: {', '.join(bare)} (declare it as Mass, Length, Speed, Number, ...)",
    )


def survives_json(component: Component) -> None:
    """Check that it is the same after a trip through JSON."""
    again = type(component).model_validate_json(component.model_dump_json())
    require(again == component, f"{component!r} came back as {again!r}")


def survives_pickle(component: Component) -> None:
    """Check that it is the same after pickling: worker processes need that."""
    again = pickle.loads(pickle.dumps(component))  # noqa: S301  our own bytes
    require(again == component, f"{component!r} came back as {again!r}")


def rejects_unknown_fields(component: Component) -> None:
    """Check that a misspelled field is an error."""
    try:
        example_of(type(component), no_such_field=1.0)
    except ValidationError:
        return
    raise AssertionError("an unknown field is accepted: keep model_config's extra='forbid'")


def is_frozen(component: Component) -> None:
    """Check that its fields cannot be set."""
    for name in type(component).model_fields:
        value = getattr(component, name)
        try:
            setattr(component, name, value)
        except ValidationError:
            continue
        raise AssertionError(f"the field {name} can be set: keep model_config's frozen=True")


COMMON: tuple[Check, ...] = (
    names_itself,
    fields_are_described,
    survives_json,
    survives_pickle,
    rejects_unknown_fields,
    is_frozen,
)
