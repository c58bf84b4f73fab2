"""A fit as plain values, for programs: the content of `describe_results`."""

from __future__ import annotations

from typing import Any

import numpy as np

from streamkit.report import table_record
from streamkit.study.fit.results import Results
from streamkit.study.fit.text import PRINTED_RADII
from streamkit.study.fit.verdicts import overall, verdicts


def results_record(results: Results) -> dict[str, Any]:
    """Return the verdict on a run, its parameters, the masses, and the counts of its calls.

    Keys: directory, digest, status, quick, converged, note, verdict ("fine", "look here" or "do not use"), steps,
    walkers, burn_in, acceptance, calls, search_calls, rejected (by reason), stuck (numbers of walkers), r_hat (the
    largest), effective_samples (the least), goodness, parameters and mass_profile (``rows``, and ``units`` by column).
    A sampler that weighs its samples has weighted_samples, ln_evidence and ln_evidence_error in place of steps,
    walkers, burn_in.
    """
    return {
        "directory": None if results.directory is None else str(results.directory),
        "digest": results.spec.digest(),
        "status": results.status,
        "quick": results.quick,
        "converged": results.converged,
        "note": results.note(),
        "verdict": overall(verdicts(results))[0],
        **results.draws.record(),
        "acceptance": results.acceptance,
        "calls": results.calls,
        "search_calls": results.search_calls,
        "rejected": results.reasons,
        "stuck": results.stuck,
        "r_hat": float(np.max(results.r_hat)),
        "effective_samples": float(np.min(results.ess)),
        "goodness": table_record(results.goodness()),
        "parameters": table_record(results.summary()),
        "mass_profile": table_record(results.mass_profile(PRINTED_RADII)),
    }
