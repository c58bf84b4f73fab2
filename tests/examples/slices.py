import numpy as np

from streamkit import ChainSampler, Ensemble, hookimpl


class Slices(ChainSampler):
    """Slice sampling along differences of walkers: every step moves all of them, and nothing is tuned."""

    kind = "slices"
    reference = "Karamanis & Beutler 2021, Statistics and Computing 31, 61"
    example = {"walkers": 16, "steps": 2000}

    def walk(self, target, ensemble):
        """Move the two halves of the ensemble in turn."""
        random = ensemble.generator()
        points, lnp = ensemble.points.copy(), ensemble.ln_probability.copy()
        while True:
            halves = np.array_split(random.permutation(len(points)), 2)
            for active, others in (halves, halves[::-1]):
                pairs = np.array([random.choice(others, 2, replace=False) for _ in active])
                along = 2 * (points[pairs[:, 0]] - points[pairs[:, 1]])
                points[active], lnp[active] = self.slice(target, random, points[active], lnp[active], along)
            yield Ensemble(points.copy(), lnp.copy(), np.ones(len(points), dtype=bool), random.bit_generator.state)

    def slice(self, target, random, points, lnp, along):
        """Return new points on the lines through points (n, d) with directions along (n, d), and ln posterior there."""

        def above(where, t):  # of the slice, at the place t of each line; ln posterior there
            there = points[where] + t[:, None] * along[where]
            value = target.ln_prior(there) + target.evaluate(there)
            return value > height[where], value

        height = lnp - random.standard_exponential(len(points))
        low = -random.random(len(points))
        ends = [low, low + 1]
        for end, step in zip(ends, (-1, 1), strict=True):  # step out until both ends are below the slice
            open_ = np.arange(len(points))
            while len(open_):
                open_ = open_[above(open_, end[open_])[0]]
                end[open_] += step
        new, new_lnp, todo = points.copy(), lnp.copy(), np.arange(len(points))
        while len(todo):  # draw between the ends, which move to the points that are refused
            t = random.uniform(ends[0][todo], ends[1][todo])
            taken, value = above(todo, t)
            new[todo[taken]] = points[todo[taken]] + t[taken, None] * along[todo[taken]]
            new_lnp[todo[taken]] = value[taken]
            todo, t = todo[~taken], t[~taken]
            for end, side in zip(ends, (t < 0, t >= 0), strict=True):
                end[todo[side]] = t[side]
        return new, new_lnp


@hookimpl
def streamkit_components():
    return [Slices]
