"""The products of a forecast: tables of the bounds and of what one more datum gives, the same as text, a picture."""

from __future__ import annotations

from astropy import units as u
from astropy.table import Column, QTable

from streamkit.report import columns, number, paragraph
from streamkit.study.grid import Products
from streamkit_forecast.figure import forecast_figure
from streamkit_forecast.one_more import Gain
from streamkit_forecast.quantities import Quantity
from streamkit_forecast.runner import FEWEST, PRIORS, Bound, Forecast

PRODUCTS = ("forecast.ecsv", "one_more.ecsv", "forecast.png", "forecast.toml")
MUCH = 0.1  # relative error of a bound above which more seeds are worth their time


def forecast_products(found: Forecast, target: Quantity) -> Products:
    """Return the files and the text of a forecast; ``target`` is the quantity of the picture."""
    tables = {"forecast.ecsv": bounds_table(found)}
    if found.gains:
        tables["one_more.ecsv"] = gains_table(found)
    return Products(
        found.spec, "forecast.toml", describe(found, target), tables,
        {"forecast.png": lambda: forecast_figure(found, target)}, header={"place": found.parameters},
    )  # fmt: skip


def bounds_table(found: Forecast) -> QTable:
    """Return one row per quantity and set of data: the value, the bound of its standard deviation, and its error."""
    pairs = [(bound, i) for i in range(len(found.quantities)) for bound in found.bounds]
    of = [found.quantities[i] for _, i in pairs]
    table = QTable({"quantity": [each.name for each in of], "data": [bound.data for bound, _ in pairs]})
    table["value"] = [each.value for each in of]
    table["sd"] = Column([bound.sd[i] for bound, i in pairs], description="bound of the standard deviation")
    table["sd_error"] = Column([bound.error[i] for bound, i in pairs], description="its error by the slopes' noise")
    table["unit"] = [each.unit or "1" for each in of]
    return table


def gains_table(found: Forecast) -> QTable:
    """Return one row per stream, column and longitude: the standard deviation of each quantity with one more datum."""
    rows = [(gain, i) for gain in found.gains for i in range(len(gain.phi1))]
    table = QTable({"stream": [gain.source for gain, _ in rows], "column": [gain.column for gain, _ in rows]})
    table["phi1"] = [gain.phi1[i] for gain, i in rows] * u.deg
    table["error"] = Column([gain.error for gain, _ in rows], description="error of the datum")
    table["error_unit"] = [gain.unit for gain, _ in rows]
    for q, quantity in enumerate(found.quantities):
        table[quantity.name] = [gain.sd[i, q] for gain, i in rows] * u.Unit(quantity.unit)
        table[quantity.name].info.description = "bound of its standard deviation with this datum beside all others"
    return table


def describe(found: Forecast, target: Quantity) -> str:
    """Return the tables as text for a terminal."""
    names = [f"{each.name} [{each.unit}]" if each.unit else each.name for each in found.quantities]
    rows = [["", "value", *(bound.data for bound in found.bounds)]]
    for i, (name, quantity) in enumerate(zip(names, found.quantities, strict=True)):
        rows.append([name, number(quantity.value), *(_cell(bound, i) for bound in found.bounds)])
    upright = [list(row) for row in zip(*rows, strict=True)]
    wide = max(map(len, found.quantities and names)) * len(names) > 90 and len(found.bounds) < len(names)
    text = [
        "Standard deviations that the data allow at best (Cramer-Rao), by data:",
        columns(rows if wide else upright),
    ]
    text.append(paragraph(_remark(found)))
    if found.gains:
        text.append(f"One more datum, and the standard deviation of {target.name} with it: the best places")
        text.append(columns(_best(found, target)))
    return "\n".join(text)


def _cell(bound: Bound, i: int) -> str:
    return f"{bound.sd[i]:.3g}"


def _remark(found: Forecast) -> str:
    """Say how far the noise of the particles moves the bounds: those of the last data, and the worst of all."""
    if found.seeds < FEWEST:
        return "With fewer than three seeds the error of these numbers is not known."
    shares = {bound.data: float((bound.error / bound.sd).max()) for bound in found.bounds if bound.data != PRIORS}
    last, worst = list(shares)[-1], max(shares, key=shares.__getitem__)
    text = f"The noise of the particles leaves an error of {shares[last]:.0%} of a number at most, by {last}"
    if worst != last:
        text += f"; of {shares[worst]:.0%}, by {worst}"
    return f"{text}. More --seeds make it smaller." if shares[worst] > MUCH else f"{text}."


def _best(found: Forecast, target: Quantity) -> list[list[str]]:
    which = found.quantities.index(target)
    rows = [["stream", "column", "error", "phi1 [deg]", f"sd [{target.unit or '1'}]", "of now"]]
    now = target.sd(found.covariance())
    for gain in sorted(found.gains, key=lambda each: float(each.sd[:, which].min())):
        rows.append(_row(gain, which, now))
    return rows


def _row(gain: Gain, which: int, now: float) -> list[str]:
    at = int(gain.sd[:, which].argmin())
    sd = float(gain.sd[at, which])
    return [
        gain.source,
        gain.column,
        f"{gain.error:.3g} {gain.unit}",
        f"{gain.phi1[at]:g}",
        f"{sd:.3g}",
        f"{sd / now:.0%}",
    ]
