"""Whether to believe a run: chains whose faults are known, and numbers with known distributions."""

from dataclasses import replace

import numpy as np
import pytest

from streamkit.components import DO_NOT, FINE, LOOK
from streamkit.fit.judge import chain as chain_verdicts
from streamkit.fit.judge import verdicts as rules
from streamkit.fit.judge.chain import chance, drift, rank_scores, ranks
from streamkit.fit.judge.predictive import Predictive, contraction, prior_fractions
from streamkit.runfile import LogUniform, Normal, TruncatedNormal, Uniform

NAMES = ("potential.v0", "potential.alpha")


def independent(seed=0, steps=2000, walkers=8, d=2):
    return np.random.default_rng(seed).standard_normal((steps, walkers, d))


def autoregressive(phi, steps=6000, walkers=8, d=2, seed=1):
    """A chain whose autocorrelation time is (1 + phi) / (1 - phi)."""
    normals = np.random.default_rng(seed).standard_normal((steps, walkers, d))
    chain = np.empty_like(normals)
    chain[0] = normals[0]
    for i in range(1, steps):
        chain[i] = phi * chain[i - 1] + np.sqrt(1 - phi**2) * normals[i]
    return chain


def test_drift_and_ranks_of_stationary_chains_are_standard_normal():
    """With the autocorrelation time known, the scores of a correlated chain too."""
    phi = 0.8
    tau = np.full(40, (1 + phi) / (1 - phi))
    chain = autoregressive(phi, steps=3000, walkers=10, d=40)
    assert drift(chain, tau).std() == pytest.approx(1, abs=0.35)
    scores = rank_scores(chain, tau)
    assert scores.shape == (10, 40)
    assert scores.std() == pytest.approx(1, abs=0.1)
    assert chance(scores) > 0.01


def test_ranks_are_even_between_0_and_1():
    found = ranks(independent(steps=5, walkers=2))
    np.testing.assert_allclose(np.sort(found[..., 0].ravel()), (np.arange(10) + 0.5) / 10)


def test_the_chance_of_the_largest_of_many_scores():
    assert chance(np.array([1.959964])) == pytest.approx(0.05, rel=1e-5)
    assert chance(np.array([0.0, 1.959964, np.nan])) == pytest.approx(1 - 0.95**2, rel=1e-5)
    assert np.isnan(chance(np.array([np.nan])))


def test_a_chain_that_drifts_is_seen():
    chain = independent()
    assert chain_verdicts.drift_verdict(NAMES, drift(chain, np.ones(2))).level == FINE
    chain[..., 1] += np.linspace(0, 1, len(chain))[:, None]
    found = chain_verdicts.drift_verdict(NAMES, drift(chain, np.ones(2)))
    assert found.level == DO_NOT
    assert "potential.alpha" in found.sentence


def test_a_walker_apart_is_seen_in_the_ranks():
    chain = independent()
    assert chain_verdicts.ranks_verdict(rank_scores(chain, np.ones(2))).level == FINE
    chain[:, 3, 0] += 0.5
    found = chain_verdicts.ranks_verdict(rank_scores(chain, np.ones(2)))
    assert found.level == LOOK
    assert "walker 3" in found.sentence


@pytest.mark.parametrize(
    ("verdict", "levels"),
    [
        (
            lambda x: chain_verdicts.length_verdict(x, True),
            {60: FINE, 50: FINE, 49: LOOK, 10: LOOK, 9: DO_NOT, np.nan: DO_NOT},
        ),
        (lambda x: chain_verdicts.length_verdict(x, False), {60: LOOK, 9: DO_NOT}),
        (lambda x: chain_verdicts.r_hat_verdict(NAMES, np.array([1.0, x])), {1.01: FINE, 1.05: LOOK, 1.2: DO_NOT}),
        (lambda x: chain_verdicts.samples_verdict(NAMES, np.array([900.0, x])), {400: FINE, 399: LOOK, 99: DO_NOT}),
        (lambda x: chain_verdicts.stuck_verdict(x, 32), {0: FINE, 1: LOOK, 5: LOOK, 6: DO_NOT}),
        (chain_verdicts.acceptance_verdict, {0.4: FINE, 0.15: FINE, 0.14: LOOK, 0.009: DO_NOT}),
        (lambda x: rules.reasons_verdict({"outside the prior": 90, "too short": x}, 100), {10: FINE, 11: LOOK}),
    ],
)  # fmt: skip
def test_the_thresholds(verdict, levels):
    for value, level in levels.items():
        assert verdict(value).level == level, value


def test_an_unknown_number_is_said_and_not_trusted():
    for found in (
        chain_verdicts.length_verdict(np.nan, False),
        chain_verdicts.r_hat_verdict(NAMES, np.full(2, np.nan)),
        chain_verdicts.samples_verdict(NAMES, np.full(2, np.nan)),
        chain_verdicts.drift_verdict(NAMES, np.full(2, np.nan)),
    ):
        assert found.level == DO_NOT
        assert "unknown" in found.value


def seen(mean, noise=0.0, add_noise=False, n=4000):
    """Predictions of two data, 0 +- 1 each: ``mean`` with a spread of 0.1, and the variance of the model's noise."""
    rng = np.random.default_rng(3)
    mean = np.asarray(mean) + 0.1 * rng.standard_normal((n, 2))
    return Predictive(("near", "far"), np.zeros(2), np.ones(2), mean, np.full((n, 2), noise**2), add_noise)


@pytest.mark.parametrize(
    ("noise", "add", "level"),
    [(0.3, False, FINE), (0.5, False, LOOK), (1.1, False, DO_NOT), (0.9, True, FINE), (1.1, True, LOOK)],
)
def test_noise_matters_more_where_it_is_left_out(noise, add, level):
    found = rules.noise_verdict(seen([0.0, 0.0], noise, add))
    assert (found.level, found.value) == (level, f"{noise:.2f}")


def test_noise_and_deviations_count_in_the_scatter_of_the_likelihood():
    """A star's position has an error of nothing beside the debris that it is one of."""
    stars = replace(seen([0.2, 0.0], 0.03), errors=np.full(2, 0.001), scatter=np.full(2, 0.1))
    assert stars.deviations == pytest.approx([-2, 0], abs=0.1)
    assert rules.noise_verdict(stars).value == "0.30"


@pytest.mark.parametrize("prior", [Uniform(-3, 5), LogUniform(1e8, 1e9), Normal(3, 0.5)])
def test_a_posterior_that_is_the_prior_says_so(prior):
    u = prior_fractions(prior, prior.sample(np.random.default_rng(5), 20000))
    np.testing.assert_allclose(np.percentile(u, [5, 50, 95]), [0.05, 0.5, 0.95], atol=0.015)
    assert contraction(u) == pytest.approx(1, abs=0.02)
    found = rules.prior_verdict(NAMES, [u, np.full(100, 0.5)], [prior.support] * 2)
    assert found.level == FINE
    assert "do not constrain potential.v0:" in found.sentence


def test_a_posterior_that_leans_on_the_end_of_its_prior_is_seen():
    u = 1 - np.random.default_rng(6).exponential(0.05, 5000).clip(0, 1)
    found = rules.prior_verdict(NAMES, [np.full(5000, 0.5), u], [(0.0, 1.0)] * 2)
    assert found.level == LOOK
    assert "potential.alpha reaches the prior's end" in found.sentence


@pytest.mark.parametrize(("prior", "reaches"), [
    (Normal(3, 0.5), False), (TruncatedNormal(3, 0.5, -np.inf, 4.2), True), (TruncatedNormal(3, 0.5, 1, np.inf), False),
])  # fmt: skip
def test_a_normal_prior_has_no_end_to_lean_on(prior, reaches):
    u = 1 - np.random.default_rng(6).exponential(0.02, 5000).clip(0, 1)
    found = rules.prior_verdict(NAMES[:1], [u], [prior.support])
    assert ("reaches the prior's end" in found.sentence) == reaches


def test_the_worst_decides():
    fine, look = chain_verdicts.acceptance_verdict(0.3), chain_verdicts.stuck_verdict(1, 32)
    assert rules.overall([fine])[0] == FINE
    assert rules.overall([fine, look])[0] == LOOK
    level, sentence = rules.overall([fine, look, rules.quick_verdict()])
    assert level == DO_NOT
    assert "kind of run" in sentence
    assert "stuck" not in sentence


def test_a_short_chain_has_no_drift():
    assert np.isnan(drift(independent(steps=5), np.ones(2))).all()


@pytest.mark.parametrize(("offset", "level"), [(1.5, FINE), (-2.6, LOOK)])
def test_a_parameter_that_leaves_its_measurement_is_named(offset, level):
    """The median of a normal posterior lies ``offset`` standard deviations of the prior from the prior's mean."""
    x = np.random.default_rng(3).standard_normal((4000, 2)) * 0.1 + [offset, 0.2]
    samples = x * [0.04, 1.0] + [0.3, 0.0]
    priors = [Normal(0.3, 0.04), Uniform(-9, 9)]
    found = rules.measured_verdict(("progenitor.pm_dec", "b"), priors, samples)
    assert found.level == level
    assert "progenitor.pm_dec" in found.sentence
    assert found.value == f"{offset:+.1f} sigma"


def test_a_progenitor_that_has_dissolved_is_named():
    assert rules.bound_verdict({"stream": 0.4}).level == FINE
    found = rules.bound_verdict({"gd1": 0.4, "pal5": 0.002})
    assert found.level == LOOK
    assert found.sentence.startswith("The progenitor of pal5 has dissolved")
