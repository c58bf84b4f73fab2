"""How the answer moved with the calls: stages of an emulated run, stored, resumed and drawn."""

import numpy as np
import pytest
from runfiles import FIT

import streamkit as sk
from streamkit.fit.show.figures import traces

EMULATED = FIT | {"sampler": {"kind": "emulator", "start_particles": 50, "starts": 1, "max_calls": 600}}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return sk.run(EMULATED, out=tmp_path_factory.mktemp("run") / "out", progress=False, products=False)


def test_the_last_stage_is_the_answer(run):
    history = run.weighted.attributes["history"]
    assert history["names"][:2] == list(run.names)
    last = history["stages"][-1]
    assert (last["calls"], last["small_calls"]) == (run.calls, run.search_calls)
    for name, interval in zip(run.names, last["intervals"], strict=False):
        np.testing.assert_allclose(interval, np.percentile(run[name], [16, 50, 84]))
    radius = float(history["names"][-1].removeprefix("M(<").split()[0])
    middle = run.mass_profile([radius])["M"][0].to_value("1e11 Msun")
    assert last["intervals"][-1][1] == pytest.approx(middle, rel=0.05)  # of 200 samples


def test_calls_grow_from_stage_to_stage_and_a_resumed_run_has_the_same(run):
    stages = run.weighted.attributes["history"]["stages"]
    assert (np.diff([stage["calls"] for stage in stages]) >= 0).all()
    again = sk.run(EMULATED, out=run.directory, progress=False, products=False, resume=True)
    assert again.weighted.attributes["history"]["stages"] == stages


def test_the_traces_of_an_emulated_run_are_its_history(run):
    figure = traces(run)
    assert figure._supxlabel.get_text() == "calls with all particles"
    assert figure.axes[2].get_ylabel().startswith("M(<")
    (line,) = {tuple(axes.lines[-1].get_xdata()) for axes in figure.axes[:1]}
    passed = [each["calls"] for each in run.weighted.attributes["history"]["stages"] if each["level"] == "fine"]
    assert list(line) == passed
