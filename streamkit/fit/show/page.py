"""The page of a run, ``report.html``: one file that needs no other and no network."""

from __future__ import annotations

import base64
import re
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import QTable

from streamkit.components import LEVELS, LiveStripping
from streamkit.errors import message_of
from streamkit.fit.directory.claim import stream_pictures
from streamkit.fit.directory.manifest import manifest
from streamkit.fit.judge.predictive import contraction, prior_fractions
from streamkit.fit.judge.verdicts import overall
from streamkit.fit.samples.draws import ENDED
from streamkit.fit.samples.results import Results
from streamkit.fit.show.figures import parameters_of, reach, remark
from streamkit.fit.show.literature import DENSITY, POTENTIAL, beside_literature, keys_of
from streamkit.fit.show.text import OF_A_STREAM, radii_to_show
from streamkit.observe import frame_of
from streamkit.report import cited, describe_live, number
from streamkit.runfile import ONLY

PAGE = "report.html"
TEMPLATE = "page.html.jinja"
WIDEST = 1700  # largest width in pixels of a picture in the page: two for each pixel of the widest column
NARROWER, FEW_STREAMS = 1100, 6  # the same for the pictures of more streams than the second number
COLOURS = 160  # colours of a picture in the page: drawings have few, and with a palette files are a third as large
PULLS = 0.05  # chance below which the page says that a stream disagrees with the others
# Pictures of the page that are separate products, besides the pictures of streams.
DRAWN = (
    "mass_profile.png", "rotation_curve.png", "flattening.png", "corner.png", "traces.png", "predictions.png",
    "priors.png", "sky.png", "members.png",
)  # fmt: skip
CLASSES = dict(zip(LEVELS, ("fine", "look", "not"), strict=True))
SIGNS = dict(zip(LEVELS, ("✓", "!", "✕"), strict=True))


def page_text(results: Results, literature: QTable | None = None) -> str:
    """Return the page of a run as HTML, with published values of `read_literature`.

    Existing pictures in the directory of the run are used.
    """
    from jinja2 import Environment, PackageLoader

    outcomes = results.verdicts
    level, sentence = overall(outcomes)
    streams = results.spec.bind_all(results.best()).streams
    environment = Environment(
        loader=PackageLoader(__package__, "."), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals.update(css=CLASSES, sign=SIGNS)
    environment.filters.update(options=_unbroken, number=number, or_dash=_or_dash, place=_place)
    return environment.get_template(TEMPLATE).render(
        title=Path(str(results.spec.source)).name if results.directory is None else results.directory.resolve().name,
        remark=remark(results),
        note=results.draws.note(),
        level=level,
        sentence=sentence,
        verdicts=outcomes,
        counts={name: sum(v.level == name for v in outcomes) for name in LEVELS},
        by_subject={v.subject: v for v in outcomes},
        parameters=list(_parameters(results)),
        shown={results.names[k] for k in parameters_of(results)[0].tolist()},
        fits=results.streams(),
        left_out=[dict(zip(row.colnames, row, strict=True)) for row in results.left_out()],
        shared=[results.names[k] for k in results.spec.factors[0].shared.tolist()],
        judged=[row["without"] for row in results.left_out() if np.isfinite(row["p"])],
        pulling=[row["without"] for row in results.left_out() if row["chance"] < PULLS],
        masses=results.mass_profile(radii_to_show(results)),
        reach=reach(results),
        is_chain=results.weighted is None,
        trace_caption=results.draws.trace_caption,
        literature=[] if literature is None else beside_literature(results, literature),
        pictures=_pictures(results),
        streams=stream_pictures(results.spec),
        few=FEW_STREAMS,
        on_sky={name for name, inputs in streams.items() if frame_of(inputs.observables) is not None},
        goodness=results.goodness(),
        data=results.predictions(),
        reasons=Counter(results.reasons).most_common(),
        calls=max(results.calls, 1),
        run=_run(results),
        toml=results.spec.toml(),
        bibtex=cited(results.spec, {} if literature is None else keys_of(literature)),
    )


def _parameters(results: Results) -> Iterator[dict[str, Any]]:
    """Yield the row of each parameter in the summary, with further columns such as the prior."""
    spec = results.spec
    for row, unit, prior, x, n_eff in zip(
        results.summary(), spec.units, spec.priors, results.samples.T, results.draws.trusted_ess, strict=True
    ):
        more = {"prior": prior.text(unit), "contraction": contraction(prior_fractions(prior, x))}
        yield {**dict(zip(row.colnames, row, strict=True)), **more, "n_eff": n_eff}


def _place(row: Any) -> str:
    """Return the quantity and the position of a published value."""
    names = {"M": "M(<r)", "v_c": "v_c", POTENTIAL: "q of the potential", DENSITY: "q of the halo's density"}
    place = f"(R, z) = ({row['radius']:g}, {row['z']:g}) kpc" if np.isfinite(row["z"]) else f"{row['radius']:g} kpc"
    return f"{names[row['quantity']]}, {place}"


def _run(results: Results) -> dict[str, Any]:
    """Return the facts about the run for the table at the end of the page."""
    notes = {} if results.directory is None else manifest(results.directory)
    spec = results.spec
    return {
        "facts": {
            "run file": Path(str(spec.source)).name,
            "digest": spec.digest(),
            "seed": spec.seed,
            "sampler": spec.sampler.kind,
            "chain": results.draws.headline,
            "ended": ENDED.get(results.status, "not yet, or by an interruption"),
            "streams made": f"{results.calls} by the sampler, {results.search_calls} in the search for a start",
            **{name: text for name, text in results.facts.items() if not name.startswith(OF_A_STREAM)},
            **_live(results),
        },
        "components": [(path, cls.kind, supplier, cls.reference) for path, cls, supplier in spec.components()],
        "versions": notes.get("versions", {}),
    }


def _live(results: Results) -> dict[str, str]:
    """The assumptions of a fit of live progenitors: a fact for each of them."""
    facts = {}
    for name, stream in results.spec.sections.streams.items():
        if isinstance(scheme := stream.stripping.centre, LiveStripping):
            facts["progenitor" if name == ONLY else f"progenitor of {name}"] = describe_live(scheme)
    return facts


def _pictures(results: Results) -> dict[str, str]:
    """Return the pictures by name; one that fails is left out, with the reason in `Results.failed`."""
    shown_parameters, _, names, _ = parameters_of(results)
    makers = results.draws.pictures(names, shown_parameters)
    files = [Path(results.directory or "", name) for name in (*DRAWN, *stream_pictures(results.spec))]
    shown = [path for path in files if results.directory is not None and path.exists()]
    of_streams = stream_pictures(results.spec)
    widths = dict.fromkeys(of_streams, NARROWER if len(of_streams) > FEW_STREAMS else WIDEST)
    pictures = {path.name: embedded(path.read_bytes(), widths.get(path.name, WIDEST)) for path in shown}
    for name, make in makers.items():
        buffer = BytesIO()
        try:
            make().savefig(buffer, format="png", dpi=170)
        except Exception as error:
            results.failed[f"{PAGE}, {name}"] = f"{type(error).__name__}: {message_of(error)}"
        else:
            pictures[name] = embedded(buffer.getvalue())
    return pictures


def embedded(png: bytes, widest: int = WIDEST) -> str:
    """Return a picture as a data URL, no wider than the page needs, with a palette."""
    from PIL import Image

    try:
        with Image.open(BytesIO(png)) as image:
            white = Image.new("RGB", image.size, "white")
            white.paste(image, mask=image.getchannel("A") if image.mode == "RGBA" else None)
    except OSError:
        return ""
    if white.width > widest:
        white = white.resize((widest, round(white.height * widest / white.width)), Image.Resampling.LANCZOS)
    buffer = BytesIO()
    white.quantize(COLOURS).save(buffer, format="png", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _unbroken(text: str) -> str:
    """Return a sentence as HTML in which the options of commands are not broken over two lines."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"(--\w+)", r'<code class="option">\1</code>', str(escape(text))))  # noqa: S704  escaped


def _or_dash(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "-"
