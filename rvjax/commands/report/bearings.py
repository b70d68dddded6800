"""Section of the page on bearing life: which bearing fails first and why, life against torque, phases of the duty."""

from typing import TYPE_CHECKING

import numpy as np

from rvjax.commands.report.lives import LIVES, LOW, Lives
from rvjax.render import Content, Figure, Note, Number, Section, Share, Table, Text
from rvjax.study import Kind, Study, kind_of
from rvjax.units import rpm

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ORDERS_SHOWN = 6
ERRORS_SHOWN = 8
HOUR = 3600.0
SPREAD = {"rv": {4: 5.3, 6: 2.7, 8: 2.2, 12: 1.5, 24: 0.5}}
"""By kind and number of angles: standard deviation of the life of a unit in %, rv-40e-whole, against 960 angles."""
LIMITS = (
    "The model is plane: it has no tilt of crank or disc (1 mrad costs a quarter of the life), no moment load, no "
    "axial force and no edge load, so the lives are optimistic. Lives of different methods differ in level: at the "
    "loads of a reducer the exponents 10/3 and 4 differ by a factor of 3.5. Ratings of the bearings are assumed unless "
    "measured."
)


def bearing_section(lives: Lives, study: Study) -> Section:
    """Bearings, orders of the force, errors, torque and phases.

    Args:
        lives: of units with the allocated tolerances.
        study: solved study.
    """
    low, median = np.quantile(lives.life, (LOW, 0.5)) / HOUR
    failed = f" {lives.failed} further units have no life." if lives.failed else ""
    about = (
        f"Method {lives.method}. {100 * lives.reliability:g} % of the bearings reach the rated life of their unit "
        f"under the loads of that unit. Quantiles are over units: of {len(lives.life):,} sample units with the "
        f"tolerances after, half have a rated life above {median:,.0f} h, and {100 - 100 * LOW:g} % above "
        f"{low:,.0f} h.{failed}"
    )
    shown = [name for name in LIVES if name in study.requirements]
    limit = float(study.requirements[shown[0]].lower)
    parts: list[Content] = [Note(about), _figure(lives), _bearings(lives), _orders(lives), _errors(lives)]
    parts.append(_against_torque(lives, limit if np.isfinite(limit) and shown[0] == "life" else None))
    if len(lives.duty) > 1:
        parts += [_phase_figure(lives), _phases(lives)]
    return Section("Bearing life", (*parts, Note(f"{_angles(lives.samples, kind_of(study.design))} {LIMITS}")))


def _angles(samples: int, kind: Kind) -> str:
    """Error by the number of angles."""
    computed = f"Forces are computed at {samples} angles of a revolution of the output."
    if (measured := SPREAD.get(kind.word)) is None:
        return f"{computed} The effect of this number on the life of {kind.plural} is not measured."
    spread = measured[max(count for count in measured if count <= max(samples, min(measured)))]
    return (
        f"{computed} In the study rv-40e-whole so many "
        f"angles change the life of a unit by at most {spread:g} % (standard deviation over the units), and the mean "
        f"life by less than 0.1 %."
    )


def _size(title: str, unit: str, read_in: str, form: str = ",.0f") -> Number:
    return Number(title, form=form, unit=unit, read_in=read_in)


def _bearings(lives: Lives) -> Table:
    columns = [
        Text("bearing"),
        Share("fails first"),
        _size("life at the centre, h", "s", "h"),
        _size("median unit, h", "s", "h"),
        _size(f"{100 * LOW:g} % of the units, h", "s", "h"),
        _size("equivalent load, N", "N", "N"),
    ]
    low, median = np.quantile(lives.each, (LOW, 0.5), axis=0)
    rows = list(zip(lives.bearings, lives.first, lives.centre, median, low, np.median(lives.load, axis=0)))
    note = "At the centre: every error at the centre of its limits. The equivalent load is that of the median unit."
    return Table("bearing_lives", columns, rows, note=note)


def _largest_orders(lives: Lives) -> list[int]:
    """Places of the largest orders of the units."""
    return [int(k) for k in np.argsort(-np.nan_to_num(lives.force[:, 1]), kind="stable")[:ORDERS_SHOWN]]


def _meaning(order: int, lives: Lives) -> str:
    if order == 0:
        return "fixed in the carrier"
    if order == lives.crank:
        return "turns with the crank"
    return "pins and teeth" if order % lives.pins == 0 else "errors of the parts"


def _orders(lives: Lives) -> Table:
    columns = [
        Number("order", form=".0f"),
        Text("load", wraps=True),
        _size("at the centre, N", "N", "N"),
        _size("rms of the units, N", "N", "N"),
    ]
    rows = [[int(lives.orders[k]), _meaning(int(lives.orders[k]), lives), *lives.force[k]]
            for k in _largest_orders(lives)]  # fmt: skip
    torque = float(np.max(np.abs(lives.duty[:, 0])))
    bearing = lives.bearings[lives.weakest]
    caption = f"Force on the bearing of {bearing} under {torque:.4g} N m, by order of the output revolution"
    return Table("bearing_orders", columns, rows, caption=caption)


def _errors(lives: Lives) -> Table:
    columns = [
        Text("error"),
        _size("mean life, h", "s", "h", "+,.0f"),
        _size(f"life of {100 * LOW:g} % of the units, h", "s", "h", "+,.0f"),
    ]
    largest = sorted(lives.held.items(), key=lambda item: -item[1][0])[:ERRORS_SHOWN]
    rows = [[name.replace("_", " "), *change] for name, change in largest]
    return Table("bearing_errors", columns, rows, caption="Life gained if an error is at the centre of its limits")


def _phase_names(lives: Lives) -> list[str]:
    def motion(speed: float) -> str:
        return f"{speed / rpm:.3g} r/min" if speed else "at rest"

    return [f"{k}: {torque:.4g} N m, {motion(speed)}" for k, (torque, speed, _) in enumerate(lives.duty)]


def _phases(lives: Lives) -> Table:
    columns = [Text("phase"), Share("time"), Share("damage")]
    return Table("duty_phases", columns, list(zip(_phase_names(lives), _times(lives), lives.phases)))


def _times(lives: Lives) -> np.ndarray:
    return lives.duty[:, 2] / lives.duty[:, 2].sum()


def _figure(lives: Lives) -> Figure:
    def draw() -> "Axes":
        from rvjax import plotting

        rows = _largest_orders(lives)
        names = [f"{int(lives.orders[k])}, {_meaning(int(lives.orders[k]), lives)}" for k in rows]
        weakest = lives.bearings[lives.weakest]
        return plotting.first_failures(lives.bearings, lives.first, names, lives.force[rows], weakest=weakest).axes[0]

    first = int(np.argmax(lives.first))
    caption = f"Which bearing fails first: {lives.bearings[first]} with {100 * lives.first[first]:.0f} %; and its loads"
    return Figure("bearing_failures", caption, draw)


def _against_torque(lives: Lives, limit: float | None) -> Figure:
    def draw() -> "Axes":
        from rvjax import plotting

        speeds = tuple(lives.speed * factor for factor in (1 / 3, 1, 4))
        return plotting.life_against_torque(
            lives.torque, lives.of_torque, low=LOW, speeds=speeds, speed=lives.speed, limit=limit
        )

    return Figure("life_torque", "Life of all rated bearings of a unit against a constant torque", draw)


def _phase_figure(lives: Lives) -> Figure:
    def draw() -> "Axes":
        from rvjax import plotting

        return plotting.phase_shares(_phase_names(lives), _times(lives), lives.phases)

    return Figure("duty_phases", "Share of each phase of the duty in the time and in the damage", draw)
