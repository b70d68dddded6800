"""Section of the page on friction: losses by place, efficiency against torque and speed, coefficients."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from rvjax import models
from rvjax.commands.report.losses import OUTPUTS, UnitLosses, quantiles
from rvjax.render import Content, Figure, Note, Number, Section, Share, Table, Text, Titled
from rvjax.running import SHARES
from rvjax.study import Study, comments, is_assumed, shown
from rvjax.units import rpm

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIRST_ORDER = 0.33  # error of the loss torque over L^2 and the torque, docs/models/running.md
LARGE = 0.25  # L from which on first order is too coarse
FAR = 0.5  # L up to which the error is known, docs/models/running.md
USUAL = {
    "ring_pins": "0.03 to 0.10",
    "output_pins": "0.03 to 0.10",
    "arm_bearings": "0.002 to 0.0025 (needles) times bore/pitch diameter",
    "support_bearings": "0.0011 to 0.0018 (cylindrical, tapered) times bore/pitch diameter",
    "gear_meshes": "0.005 to 0.015",
}


def friction_section(losses: UnitLosses, study: Study) -> Section:
    """Shares, efficiency, coefficients, and what is not modelled.

    Args:
        losses: of units with the allocated tolerances.
        study: solved study.
    """
    name = next(name for name in OUTPUTS if name in study.requirements)
    unknown = models.kind(study.design).described[name].unknown
    parts: list[Content] = [Note(_about(losses)), _places(losses)]
    if losses.given:
        parts += [Note("\n".join(_order(losses))), _figure(losses), _efficiencies(losses)]
    parts += [_coefficients(study), Note(f"Not modelled: {unknown}.")]
    return Section("Friction and efficiency", tuple(parts))


def _about(losses: UnitLosses) -> str:
    units = len(losses.viscous) - 1
    failed = f" {losses.failed} further units have no value." if losses.failed else ""
    return (
        f"Losses of {units:,} sample units with the tolerances after, means over {losses.samples} angles of a turn of "
        f"the output.{failed} Torques are those at the output."
    )


def _state(losses: UnitLosses) -> str:
    """Torque and speed of the conditions."""
    torque = f"{losses.given:.4g} N m"
    return f"{torque}, {losses.speed / rpm:.4g} r/min" if losses.speed else f"{torque}, at rest"


def _places(losses: UnitLosses) -> Table:
    """Loss torque by place, of the unit at the centre and of the mean unit."""
    largest = sorted(losses.under.items(), key=lambda item: -float(np.mean(item[1][1:])))
    found = {name: each for name, each in largest if np.any(each)}
    total = sum(found.values(), np.zeros(len(losses.viscous)))
    mean = float(np.mean(total[1:]))
    rows = []
    for name, each in (found | {"sum": total}).items():
        own = float(np.mean(each[1:]))
        rows.append([name.replace("_", " "), float(each[0]), own, own / mean if mean else None])
    columns = [
        Text("place"),
        Number("errors at the centre, N m", unit="N m"),
        Number("mean of the units, N m", unit="N m"),
        Share("share"),
    ]
    caption = f"Loss torque by place, {_state(losses)}"
    note = "At the centre: every error at the centre of its limits. Share: of the mean of the units."
    return Table("loss_places", columns, rows, caption=caption, note=note, total=True)


def _order(losses: UnitLosses) -> Iterator[str]:
    """Error of first order, and a warning where it is large."""
    part = np.median(losses.proportion[1:], axis=0)
    at, torque = float(part[losses.at]), losses.torque
    efficiency = float(np.median(losses.efficiency[len(losses.speeds) // 2, 1:, losses.at]))
    error = 100 * efficiency**2 * FIRST_ORDER * at**2
    yield (
        f"Efficiencies are of first order in the friction. The error is {FIRST_ORDER:g} L² of the torque, with L = "
        f"loss torque without drag over torque; the true efficiency is lower. At {torque[losses.at]:.4g} N m "
        f"L = {at:.2g} in the median unit: {error:.2g} percentage points."
    )
    if np.any(part > LARGE):
        most = float(np.max(torque[part > LARGE]))
        yield (
            f"warning: L is above {LARGE:g} at {most:.4g} N m and below (median unit); the error of the loss there is "
            f"more than {100 * FIRST_ORDER * LARGE**2:.1g} % of the torque"
        )


def _efficiencies(losses: UnitLosses) -> Table:
    """Efficiency at each torque and speed, and L."""
    low, median, high = quantiles(losses.efficiency)
    part = np.median(losses.proportion[1:], axis=0)
    columns = [Number("torque, N m", unit="N m"), *(Text(_speed(speed)) for speed in losses.speeds)]
    columns += [Number("L", form=".2g"), Number("first-order error, % of the torque", form=".2g")]
    rows = [
        [
            float(torque),
            *(f"{100 * median[s, k]:.1f} [{100 * low[s, k]:.1f}, {100 * high[s, k]:.1f}]" for s in range(len(low))),
            float(part[k]),
            float(100 * FIRST_ORDER * part[k] ** 2) if part[k] <= FAR else None,
        ]
        for k, torque in enumerate(losses.torque)
    ]
    caption = "Efficiency in %: median of the units [1 %, 99 % of the units]"
    note = f"L of the median unit. Above {FAR:g} first order does not hold."
    return Table("efficiencies", columns, rows, caption=caption, note=note)


def _speed(speed: float) -> str:
    return f"{abs(speed) / rpm:.4g} r/min" if speed else "at rest"


def _coefficients(study: Study) -> Table:
    """Every coefficient with its source."""
    said = {path.partition(".")[2]: word for path, word in comments(study.text).items() if path.startswith("friction.")}
    rows = []
    for number in study.numbers:
        part, _, name = number.path.partition(".")
        if part != "friction":
            continue
        source = said.get(name, "")
        if number.origin == "default":
            source = "default"
        elif not source or is_assumed(source) or number.assumed:
            usual = f" (usual: {USUAL[name]}, assumed)" if name in USUAL else ""
            source = (source if source and is_assumed(source) else "assumed") + usual
        value = f"{float(number.value):.4g}" if number.unit == "-" else shown(number.value, number.unit)
        rows.append([Titled(name.replace("_", " "), number.meaning), value, _spread(study, name), source])
    columns = [Text("coefficient"), Text("value"), Text("spread of units"), Text("source", wraps=True)]
    return Table("friction", columns, rows, caption="Friction of the study")


def _spread(study: Study, name: str) -> str:
    """Limits of the share by which a coefficient differs between units."""
    tolerance = getattr(study.tolerances, SHARES.get(name, ""), None)
    if tolerance is None:
        return "all equal"
    return f"{100 * float(tolerance.lower):+.3g} to {100 * float(tolerance.upper):+.3g} %"


def _figure(losses: UnitLosses) -> Figure:
    def draw() -> "Axes":
        from rvjax import plotting

        return plotting.running.efficiency_against_torque(
            losses.torque, quantiles(losses.efficiency), speeds=np.abs(losses.speeds), rated=losses.at
        )

    return Figure("efficiency_torque", "Efficiency of the units against torque and speed", draw)
