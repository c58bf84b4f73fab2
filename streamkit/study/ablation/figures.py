"""The paper's figures of phase space: bow-tie, configuration and velocity space, velocities on leaving r_t.

Every function takes portraits by title (`streamkit.comparison.Portrait`: a stream, its run file bound, and what the
observable says of it) and returns a figure: of the variants of an ablation, or of a fit and an N-body snapshot. The
first one is what the others are compared with.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from streamkit.model import standard_normals
from streamkit.report import ACROSS, ARM_STYLE, finish, label_all, panel_grid, typical_reach
from streamkit.stream import Array, Stream, orbital_plane
from streamkit.study.ablation.measures import Portrait
from streamkit.study.ablation.panels import Portraits, some


def bow_tie(portraits: Portraits) -> Figure:
    """Draw energy against angular momentum, minus the progenitor's, coloured by the phase along the stream.

    Each cell has the median winding of its particles (Gibbons+ 2014, figure 3). The line is where 95 % of the first
    stream are. Streams whose host has no potential energy are left out.
    """
    shown = {title: p for title, p in portraits.items() if p.integrals[0] is not None and (~p.stream.bound).any()}
    figure, panels = panel_grid(len(shown), 3.1, 3.1, share=True)
    free = {title: ~p.stream.bound for title, p in shown.items()}
    x, y, turn = (
        typical_reach(float(np.percentile(np.abs(np.asarray(values)), percent)) for values in columns)
        for columns, percent in (
            ([p.integrals[1][free[t]] / 1e3 for t, p in shown.items()], 99.5),
            ([np.asarray(p.integrals[0])[free[t]] / 1e4 for t, p in shown.items()], 99.5),
            ([np.degrees(p.stream.winding[free[t]]) for t, p in shown.items()], 97),
        )
    )
    extent = (-x, x, -y, y)
    image, outline = None, None
    for axes, (title, portrait) in zip(panels, shown.items(), strict=False):
        energy, momentum = portrait.integrals
        assert energy is not None  # noqa: S101  those without were left out above
        chosen = free[title]
        image = axes.hexbin(
            momentum[chosen] / 1e3, energy[chosen] / 1e4, C=np.degrees(portrait.stream.winding[chosen]),
            reduce_C_function=np.median, gridsize=70, extent=extent, cmap="turbo", vmin=-turn, vmax=turn, lw=0.1,
        )  # fmt: skip
        if outline is None:
            outline = _outline(momentum[chosen] / 1e3, energy[chosen] / 1e4, extent)
        else:
            axes.contour(*outline, colors="black", linewidths=0.9)
        axes.plot(0, 0, marker="*", ms=11, color="black", mec="white", ls="none")
        axes.set(xlim=extent[:2], ylim=extent[2:])
        axes.set_title(title, fontsize=9)
        finish(axes)
    label_all(
        figure, r"$L - L_{\rm p}\ \,[10^3\,{\rm kpc\,km\,s}^{-1}]$", r"$E - E_{\rm p}\ \,[10^4\,({\rm km\,s}^{-1})^2]$"
    )
    if image is not None:
        figure.colorbar(image, ax=panels, label="angle along the stream [deg]  (leading > 0)", pad=0.01, shrink=0.9)
    return figure


def _outline(x: Array, y: Array, extent: tuple[float, float, float, float]) -> tuple[Array, Array, Array, list[float]]:
    """Return what draws the contour around the densest 95 % of the points: x, y, density and level."""
    from scipy.ndimage import gaussian_filter

    count, x_edges, y_edges = np.histogram2d(x, y, 80, (extent[:2], extent[2:]))
    smooth = gaussian_filter(count, 1.2)
    ordered = np.sort(smooth.ravel())[::-1]
    level = float(ordered[np.searchsorted(np.cumsum(ordered), 0.95 * ordered.sum())])
    return 0.5 * (x_edges[1:] + x_edges[:-1]), 0.5 * (y_edges[1:] + y_edges[:-1]), smooth.T, [level]


def phase_space(portraits: Portraits) -> Figure:
    """Draw configuration space above velocity space, both in the progenitor's orbital plane, coloured by arm."""
    n = max(len(portraits), 1)
    across, blocks = min(n, ACROSS), -(-n // ACROSS)
    figure = Figure(figsize=(3.1 * across + 0.6, 6.6 * blocks), layout="constrained")
    panels: Any = figure.subplots(2 * blocks, across, squeeze=False)
    for axes in panels.flat:
        axes.set_visible(False)
    for row, (what, axis, unit) in enumerate((("q", ("x'", "y'"), "kpc"), ("v", ("v_x'", "v_y'"), r"km\,s^{-1}"))):
        reach = typical_reach(_reach(portrait.stream, what) for portrait in portraits.values())
        for i, (title, portrait) in enumerate(portraits.items()):
            axes, stream = panels[2 * (i // ACROSS) + row, i % ACROSS], portrait.stream
            basis = orbital_plane(stream.orbit)
            x, y = basis @ getattr(stream, what)
            for arm in (1, -1):
                chosen = some(stream, stream.arm == arm)
                name, colour = ARM_STYLE[arm]
                axes.scatter(x[chosen], y[chosen], s=1.2, color=colour, alpha=0.55, lw=0, rasterized=True, label=name)
            axes.plot(
                *(basis @ getattr(stream.orbit, what)[:, -1]), marker="*", ms=11, color="black", mec="white", ls="none"
            )
            axes.plot(0, 0, marker="+", ms=9, mew=1.4, color="black", ls="none")
            axes.set(visible=True, aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
            axes.set_xlabel(rf"${axis[0]}\ \,[{{\rm {unit}}}]$", fontsize=11)
            if i % ACROSS == 0:
                axes.set_ylabel(rf"${axis[1]}\ \,[{{\rm {unit}}}]$", fontsize=11)
            if row == 0:
                axes.set_title(title, fontsize=10)
            finish(axes)
    if portraits:
        panels[0, 0].legend(fontsize=8, frameon=False, loc="upper left", handletextpad=0.1, markerscale=5)
    return figure


def _reach(stream: Stream, what: str) -> float:
    """Return how far a picture must reach in positions ("q") or velocities ("v")."""
    if stream.bound.all():
        return 1.0
    return 1.05 * float(
        np.percentile(np.abs(orbital_plane(stream.orbit) @ getattr(stream, what)[:, ~stream.bound]), 99.7)
    )


def crossings(portraits: Portraits) -> Figure:
    """Draw the trailing debris' velocities at the last crossing of r_t, against the ones it was released with.

    In the frame that moves with the progenitor (Gibbons+ 2014, figure 4): radial, along the motion, out of the plane.
    The black line is the distribution that the scheme draws from: mLCS's Gaussian. Snapshots hold no crossings.
    """
    shown = {t: p for t, p in portraits.items() if np.isfinite(p.stream.dv_strip).all() and (p.stream.arm < 0).any()}
    n = max(len(shown), 1)
    figure = Figure(figsize=(9.6, 1.9 * n + 0.7), layout="constrained")
    panels: Any = figure.subplots(n, 3, squeeze=False, sharex=True)
    components = (r"\Delta v_r", r"\Delta v_t", r"\Delta v_{\rm oop}")
    reach = max(
        (float(np.percentile(np.abs(p.stream.dv_strip[:, p.stream.arm < 0]), 99)) for p in shown.values()), default=1.0
    )
    bins = np.linspace(-reach, reach, 51)
    for row, (title, portrait) in zip(panels, shown.items(), strict=False):
        chosen = portrait.stream.arm < 0
        drawn = _released(portrait)[:, chosen]
        weight = portrait.stream.weight[chosen]
        for axes, crossing, start in zip(row, portrait.stream.dv_strip[:, chosen], drawn, strict=True):
            axes.hist(
                crossing,
                bins,
                weights=weight,
                density=True,
                color=ARM_STYLE[-1][1],
                alpha=0.55,
                label="at the last crossing",
            )
            if np.std(start) > 0.02 * reach:
                axes.hist(
                    start,
                    bins,
                    weights=weight,
                    density=True,
                    histtype="step",
                    color="black",
                    lw=1.2,
                    label="as released",
                )
            else:  # no dispersion: a line
                axes.axvline(float(np.mean(start)), color="black", lw=1.2, label="as released")
            axes.axvline(0, color="black", lw=0.6, ls=":")
            finish(axes)
            axes.tick_params(which="both", left=False, right=False, labelleft=False)
        row[0].set_ylabel(title.replace(", ", ",\n"), fontsize=9)
    for axes, component in zip(panels[-1], components, strict=True):
        axes.set_xlabel(rf"${component}\ \,[{{\rm km\,s}}^{{-1}}]$", fontsize=12)
    panels[0, 0].set_xlim(-reach, reach)
    if shown:
        figure.legend(
            *panels[0, 0].get_legend_handles_labels(), fontsize=9, frameon=False, ncols=2, loc="outside upper center"
        )
    return figure


def _released(portrait: Portrait) -> Array:
    """(3, n) Velocities at release relative to the progenitor, in its frame."""
    setup, stream = portrait.setup, portrait.stream
    there = stream.orbit.at(stream.t_release)
    normals = standard_normals(setup.stripping, setup.seed)
    release = setup.stripping.release(there, stream.tail, setup.mass * there.mass_left, normals)
    return np.asarray(np.einsum("fcn,cn->fn", np.stack(there.frame), release.v - there.v))
