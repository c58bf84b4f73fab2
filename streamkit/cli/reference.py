"""The command ``streamkit reference``."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

import click

from streamkit import components, report, runfile
from streamkit.cli.completion import kinds_of, sections
from streamkit.errors import StreamkitError

KEYS = ("version", "seed", "plugins", "streams")  # the keys above the sections
OF_STREAMS = ("stream", "stream_defaults")  # sections whose own sections are described by their names


@click.command()
@click.argument("section", required=False, shell_complete=sections)
@click.argument("kind", required=False, shell_complete=kinds_of("section"))
def reference(section: str | None, kind: str | None) -> None:
    """Describe the fields of a run file: unit, default, allowed values.

    Without SECTION, list the keys and sections. SECTION lists its fields and kinds; SECTION KIND describes one
    installed component, such as 'potential nfw' or 'progenitor plummer'.
    """
    registry, fields = components.load_registry(), runfile.RunFile.model_fields
    if section is None or section in KEYS:
        rows = [(f"[{name}]", field.description or "") for name, field in fields.items() if name not in KEYS]
        more = (
            "Ask for 'streamkit reference SECTION' for its fields, and for 'SECTION KIND' where it has a kind. A "
            'physical number is a number in the field\'s unit, a quantity such as "8 kpc", or a prior: '
            f"{', '.join(map(runfile.usage, runfile.PRIORS.values()))}."
        )
        parts = [f"keys\n{report.field_table(runfile.RunFile, KEYS, 'key')}"]
        parts += [f"sections\n{report.columns(rows)}", report.paragraph(more)] if section is None else []
        click.echo("\n\n".join(parts))
        return
    report.check_name(registry, "reference", section, list(fields))
    parts = [f"[{section}]\n{report.paragraph(fields[section].description or '', '  ')}"]
    plain: Any = {"sun": runfile.Sun, "likelihood": runfile.Likelihood, "engine": runfile.Engine}.get(section)
    if plain is not None:
        if kind is not None:
            raise StreamkitError(f"reference: the section [{section}] has no kinds, found {kind!r}")
        parts.append(report.field_table(plain, plain.model_fields, "field"))
    elif section in OF_STREAMS:
        parts.append("'streamkit reference' describes progenitor, stripping and observable.")
    elif section == "progenitor":
        parts += _placed(registry, kind, runfile.WAYS, ["lookback", "friction", "reflex"])
    elif section == "body":
        parts += _placed(registry, kind, runfile.BODY_WAYS, ["friction", "reflex"])
        table = report.field_table(runfile.Encounter, runfile.Encounter.model_fields, "field of encounter")
        text = " ".join((inspect.getdoc(runfile.Encounter) or "").split())
        parts += [f"encounter, in place of a place today, friction and reflex\n{report.paragraph(text, '  ')}\n{table}"]
        table = report.field_table(runfile.BodyTable, ["table", "mass_factor"], "field")
        text = " ".join((inspect.getdoc(runfile.BodyTable) or "").split())
        text += " Its encounter may have stream and frame; beside places today it may have friction and reflex."
        parts += [f"table, in place of the numbers of one body\n{report.paragraph(text, '  ')}\n{table}"]
    else:
        default = runfile.DEFAULT_KIND.get(section)
        parts += [f"kind may be left out: it is then {default!r}."] if default else []
        parts.append(report.listing(registry, section, kind, "reference"))
        if section == "potential" and kind is None:
            parts.append(
                report.paragraph(
                    f'preset = "NAME" in [potential] stands for the named potentials of a published model: '
                    f"{', '.join(registry.presets)}. A [potential.NAME] of your own beside it changes or adds one."
                )
            )
    click.echo("\n\n".join(parts))


def _placed(registry: components.Registry, kind: str | None, ways: Sequence[Any], more: list[str]) -> list[str]:
    """The potential of a progenitor or a body, its place today in one of several ways, and what more there is."""
    able = [k for k, entry in sorted(registry.entries["potential"].items()) if "mass" in entry.cls.parameters()]
    if kind is None:
        kinds = report.paragraph(", ".join(able), "  ")
        parts = [f"kind: one of the potentials with a mass, or another whose force gives a total mass\n{kinds}"]
    else:
        parts = [report.listing(registry, "potential", kind, "reference")]
        if kind not in able:
            parts.append("It has no field 'mass' in Msun: its force must give a total mass.")
    taken = registry.entries["potential"][kind].cls.model_fields.keys() if kind else set()
    for way in ways:
        if not taken & way.model_fields.keys():
            parts.append(f"place today: {way.title}\n{report.field_table(way, way.fields(), 'field')}")
    return [*parts, f"in every case\n{report.field_table(ways[0], more, 'field')}"]
