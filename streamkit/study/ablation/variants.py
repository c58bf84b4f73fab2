"""The grid of an ablation: every combination of the values of some fields, validated as in the file."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from streamkit.components import Component
from streamkit.errors import SpecError
from streamkit.runfile import Spec


@dataclass(frozen=True)
class Variant:
    """One point of the grid: its label, the fields it changes, and the run file with them."""

    label: str
    values: dict[str, Any]
    spec: Spec


def variants_of(spec: Spec, vary: Mapping[str, Sequence[Any]]) -> list[Variant]:
    """Return every combination of the values, validated as in the file.

    A kind other than the run file's starts from its own defaults; fields that all kinds of a section share (particles,
    progenitor_gravity ...) keep their values. A `SpecError` names a field that does not exist or a value that is not
    allowed, in any of the variants.
    """
    if not vary:
        raise SpecError(f"{spec.source}: nothing is varied: name a field and its values")
    last = {path: path.rpartition(".")[2] for path in vary}
    labels = {path: name if list(last.values()).count(name) == 1 else path for path, name in last.items()}
    variants = []
    for point in itertools.product(*vary.values()):
        values = dict(zip(vary, point, strict=True))
        label = ", ".join(_label(labels[path], value) for path, value in values.items())
        try:
            variants.append(Variant(label, values, varied(spec, values)))
        except SpecError as error:
            raise SpecError(f"variant {label!r}: {error}") from None
    return variants


def varied(spec: Spec, values: Mapping[str, Any]) -> Spec:
    """Return the spec with other values; a new kind drops the fields that only kinds of the old one's sort have."""
    reset: dict[str, Any] = {}
    for path, cls, _ in spec.components():
        if not issubclass(cls, Component) or values.get(f"{path}.kind", cls.kind) == cls.kind:
            continue
        base = next(each for each in cls.__mro__[1:] if issubclass(each, Component) and "kind" not in each.__dict__)
        for name, info in cls.model_fields.items():
            if name not in base.model_fields and not info.is_required():
                reset[f"{path}.{name}"] = info.get_default(call_default_factory=True)
    return (spec.with_values(reset) if reset else spec).with_values(values)


def _label(name: str, value: Any) -> str:
    """Return a short label of a change: ``mlcs``, ``without progenitor gravity``, ``sigma = 10 km/s``."""
    if isinstance(value, bool):
        return f"{'with' if value else 'without'} {name.replace('_', ' ')}"
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if name == "kind" else f"{name} = {text}"
