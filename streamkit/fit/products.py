"""The products of a run: tables and pictures, which can be written again from its samples at any time."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import QTable
from matplotlib.figure import Figure

from streamkit.components import ChainSampler
from streamkit.errors import ChainError, OutOfDomain, message_of
from streamkit.fit.directory.claim import LITERATURE, RECOVERY, stream_pictures
from streamkit.fit.directory.integrity import RUN_FILE
from streamkit.fit.directory.manifest import MANIFEST
from streamkit.fit.samples.members import has_members
from streamkit.fit.samples.predictions import predicted_intervals
from streamkit.fit.samples.results import Results, load_results
from streamkit.fit.samples.tables import printable
from streamkit.fit.show.corner import corner
from streamkit.fit.show.figures import WIDE, mass_profile, priors, radii, remark, rotation_curve, traces
from streamkit.fit.show.flattening import flattening, is_sphere
from streamkit.fit.show.literature import keys_of, read_literature
from streamkit.fit.show.members import members
from streamkit.fit.show.page import PAGE, page_text
from streamkit.fit.show.predictive import predictions
from streamkit.fit.show.recovery import DRAWN, RADII, recovery_figure, recovery_table, true_host
from streamkit.fit.show.sky import sky
from streamkit.fit.show.text import radii_to_show
from streamkit.report import COLUMN, UnwritableError, draw_stream, save, save_pictures, save_table
from streamkit.runfile import Spec
from streamkit.sample import CALLS, CHAIN, SAMPLES

# Radii in kpc of the table of masses: 5 to 200, with 50, 100, 150 and 200 among them.
PROFILE_RADII = np.arange(5.0, 201.0, 5.0)


def best_stream(results: Results, name: str, column: bool = False) -> Figure:
    """Draw the stream of this name at the best sample, also for one ``column`` of a journal."""
    try:
        best = results.best_observation
    except OutOfDomain as error:  # another machine's rounding may lose a stream at the edge
        raise ChainError(f"the stream of the best sample could not be made again: {error.reason}") from None
    inputs, note = results.spec.bind(results.best(), name), remark(results) if results.quick else ""
    intervals = predicted_intervals(results.draws, best, name)
    return draw_stream(best.streams[name], best.predictions[name], inputs, note, intervals, column)


TABLES: dict[str, Callable[[Results], QTable]] = {
    "summary.ecsv": Results.summary,
    "mass_profile.ecsv": lambda results: results.mass_profile(PROFILE_RADII),
    "diagnostics.ecsv": Results.diagnostics,
    "goodness.ecsv": Results.goodness,
    "predictions.ecsv": Results.predictions,
}
FLATTENING = "flattening.png"  # only for a host that is no sphere
# Only for several streams.
STREAMS, LEFT_OUT, SKY = "streams.ecsv", "left_out.ecsv", "sky.png"
MEMBERS = "members.ecsv", "members.png"  # only for single stars of stream and field


def tables_of(spec: Spec) -> dict[str, Callable[[Results], QTable]]:
    """Return the tables of a run of this spec."""
    several: dict[str, Callable[[Results], QTable]] = {STREAMS: Results.streams, LEFT_OUT: Results.left_out}
    stars = {MEMBERS[0]: Results.members} if has_members(spec) else {}
    return TABLES | (several if len(spec.streams) > 1 else {}) | stars


def figures_of(
    spec: Spec, published: QTable | None = None, column: bool = False
) -> dict[str, Callable[[Results], Figure]]:
    """Return the pictures of a run of this spec, with published values; also for one ``column`` of a journal."""
    profile: dict[str, Any] = {"literature": published, "wide": COLUMN if column else WIDE}
    figures: dict[str, Callable[[Results], Figure]] = {
        "corner.png": partial(corner, column=column),
        "mass_profile.png": partial(mass_profile, **profile),
        "predictions.png": partial(predictions, column=column),
        "priors.png": priors,
        "rotation_curve.png": partial(rotation_curve, **profile),
        "traces.png": traces,
    }
    if not is_sphere(spec):
        figures[FLATTENING] = partial(flattening, **profile)
    if len(spec.streams) > 1:
        figures[SKY] = sky
    if has_members(spec):
        figures[MEMBERS[1]] = members
    for file, name in stream_pictures(spec).items():
        figures[file] = partial(best_stream, name=name, column=column)
    return figures


def products_of(spec: Spec) -> tuple[str, ...]:
    """Return every file that a run of this spec writes into its output directory."""
    kept = (CHAIN,) if isinstance(spec.sampler, ChainSampler) else (SAMPLES, CALLS)
    return (RUN_FILE, MANIFEST, *kept, *tables_of(spec), *figures_of(spec), PAGE)


def pdfs_of(spec: Spec) -> tuple[str, ...]:
    """Return the PDFs that a report of this spec may write beside its pictures."""
    return tuple(str(Path(name).with_suffix(".pdf")) for name in (*figures_of(spec), RECOVERY[1]))


def write_products(
    run: Results | str | Path,
    truth: str | Path | None = None,
    literature: str | Path | None = None,
    pdf: bool = False,
    trust: bool = False,
    column: bool = False,
) -> Results:
    """Write every table and picture of a run and its page into its directory, and return its results.

    A picture or page that cannot be made is left out, with a warning in the log; `Results.failed` and the diagnostics
    have the reason.

    The run may be given by its directory, whose plugin files are run if ``trust`` allows it. ``truth`` is a TOML file
    whose ``[potential]`` is the true host of a mock: the recovery is written too. ``literature`` is a table of
    published values (`read_literature`) to show beside the run's own: it is kept in the directory, and shown by later
    reports. With ``pdf`` every picture is written as PDF too; an existing PDF is written again in any case. With
    ``column`` the pictures of a paper are drawn for one column of a journal: profiles, streams, predictions and the
    corner plot, which is as wide as two columns for many parameters.

    Raises ChainError if there is no readable run. Raises SpecError if the truth is not valid. Nothing has then been
    written. Raises ChainError if a product cannot be written, as on a full disk, after all other products have been
    written.
    """
    results = run if isinstance(run, Results) else load_results(run, trust=trust)
    where = results.directory
    if where is None:
        raise ChainError("these results are in memory only: a report needs a directory")
    published = _published(where, literature)
    tables, figures = tables_of(results.spec), figures_of(results.spec, published, column)
    wanted = [radii(results), np.array(radii_to_show(results))]
    if published is not None:
        wanted.append(np.asarray(published["radius"]))
        for quantity in ("M", "v_c"):
            wanted.append(radii(results, published[[name == quantity for name in published["quantity"]]]))
    if truth is not None:
        host = true_host(truth, results.spec)
        tables[RECOVERY[0]] = lambda results: recovery_table(results, host)
        figures[RECOVERY[1]] = lambda results: recovery_figure(results, host)
        wanted += [RADII, DRAWN]
    # All radii are cached. Those of the table come first: an array's length may change the last digit of its values.
    results.profiles(PROFILE_RADII)
    results.profiles(np.concatenate(wanted))
    results.failed = {}
    unwritten: list[str] = []
    writers: dict[str, Callable[[Path], None]] = {
        name: lambda path, draw=draw: save_pictures(path, draw(results), pdf)  # type: ignore[misc]
        for name, draw in figures.items()
    }
    # last: it shows the pictures
    writers[PAGE] = lambda path: save(path, lambda part: part.write_text(page_text(results, published), "utf-8"))
    for name, write in writers.items():
        try:
            write(where / name)
        except Exception as error:
            for old in (where / name, (where / name).with_suffix(".pdf")):
                old.unlink(missing_ok=True)  # an older one would belong to other samples
            if isinstance(error, UnwritableError):
                unwritten.append(str(error))
            else:
                results.failed[name] = f"{type(error).__name__}: {message_of(error)}"
    for name, make in tables.items():
        table = make(results)
        if results.failed:
            table.meta["products that failed"] = dict(results.failed)
        try:
            save_table(where / name, printable(table, None))
        except UnwritableError as error:
            unwritten.append(str(error))
    if results.failed:
        reasons = "; ".join(f"{name} ({reason})" for name, reason in results.failed.items())
        logging.getLogger("streamkit").warning("Some products could not be made, all else was: %s", reasons)
    if unwritten:
        raise ChainError(
            f"{unwritten[0]}{f', and {len(unwritten) - 1} more' if len(unwritten) > 1 else ''}. The samples are whole: "
            f"make room, and write the products with: streamkit report {where}"
        )
    return results


def published_with(directory: str | Path) -> dict[str, str]:
    """Return the references of published values that were shown beside a run, each with its key for BibTeX or ''."""
    kept = Path(directory) / LITERATURE
    return keys_of(read_literature(kept)) if kept.is_file() else {}


def _published(where: Path, literature: str | Path | None) -> QTable | None:
    """Return the published values given now, or with an earlier report."""
    kept = where / LITERATURE
    if literature is None:
        return read_literature(kept) if kept.exists() else None
    table = read_literature(literature)
    save_table(kept, table)
    return table
