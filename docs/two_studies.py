"""The two studies of the RV-40E side by side: tables and figures from stored results of `benchmarks`."""

import numpy as np

from benchmarks.tables import stored, table
from rvjax import plotting, study
from rvjax.commands.budget import Budget
from rvjax.commands.cells import limits_of
from rvjax.plotting.style import AFTER, BEFORE

JUDGED = {
    "optimum of the four-bar, its errors alone": "optimum of rv-40e, the errors of the four-bar alone",
    "optimum of the four-bar": "optimum of rv-40e, all errors",
    "optimum of the four-bar, with its flanks": "the same with the flanks of rv-40e",
    "tolerances of rv-40e-whole": "tolerances of rv-40e-whole",
    "optimum without limits on forces": "optimum of rv-40e-whole without limits on life and forces",
    "optimum of the whole reducer": "optimum of rv-40e-whole",
}
"""Sets of tolerances evaluated on the whole reducer, and their names in the docs."""
FORCES = ("life", "turn_pin_pressure", "arm_bearing_force")


def yields():
    kept = stored("two_studies")
    shown = ["loaded_transmission_error", "second_transmission_error", "bench_lost_motion", "misfit"]
    rows = []
    for name, text in JUDGED.items():
        found = kept[name]
        yields = ("{:.1f} [{:.1f}, {:.1f}]".format(*(100 * x for x in found["yield"][n])) for n in shown)
        joint = "{:.1f}".format(100 * found["yield"]["accuracy"][0])
        cost = "-" if name.endswith("alone") else f"{found['cost']:.1f}"
        rows.append((text, *yields, joint, cost))
    heads = ["tolerances", "412 N m", "12.4 N m", "lost motion", "misfit", "all but 12.4 N m", "cost"]
    return table(heads, rows)


def forces():
    """Life and forces of the two optima of the loaded reducer and of its initial tolerances."""
    kept = stored("two_studies")
    rows = []
    for name in ("tolerances of rv-40e-whole", "optimum without limits on forces", "optimum of the whole reducer"):
        found = kept[name]
        far, shares = found["99 % quantile"], found["yield"]
        reach = ["{:.1f} [{:.1f}, {:.1f}]".format(*(100 * x for x in shares[n])) for n in FORCES]
        sizes = [f"{far['life']:.0f}", f"{far['turn_pin_pressure']:.0f}", f"{far['pin_force']:.1f}"]
        sizes += [f"{far['arm_bearing_force']:.1f}", "{:.1f}".format(100 * shares["all of rv-40e-whole"][0])]
        rows.append((JUDGED[name], *reach, *sizes, f"{found['cost']:.1f}"))
    heads = ["tolerances", "6000 h, %", "2800 MPa, %", "8.8 kN, %", "life of 1 %, h", "pressure, MPa", "pins, kN"]
    return table([*heads, "arm bearings, kN", "all six, %", "cost"], rows)


def models():
    kept = stored("two_studies")
    errors = {"412 N m": "loaded_transmission_error", "12.4 N m": "second_transmission_error"}
    rows = []
    for name in ("optimum of the four-bar, its errors alone", "optimum of the four-bar"):
        found = kept[name]
        quantile, above = found["99 % quantile"], {n: 100 * (1 - y[0]) for n, y in found["yield"].items()}
        rows.append(
            (
                JUDGED[name],
                "four-bar",
                f"{above['transmission_error']:.2f}",
                f"{quantile['transmission_error']:.2f}",
                "1",
            )
        )
        rows += [
            ("", load, f"{above[n]:.1f}", f"{quantile[n]:.2f}", f"{found['correlation with the four-bar'][load]:.2f}")
            for load, n in errors.items()
        ]
    heads = ["tolerances", "model", "units above 1 arcmin, %", "99 % quantile, arcmin", "correlation with the four-bar"]
    return table(heads, rows)


def tolerances():
    kept = stored("two_studies")
    limits = [kept[f"result {name}"]["limits"] for name in ("of rv-40e", "without limits on forces", "of rv-40e-whole")]
    start = study.load("rv-40e-whole", solve=False)
    four = study.load("rv-40e", solve=False)
    rows = []
    for name in dict.fromkeys([*four.costs, *start.costs]):
        cells = []
        for asked, sets in ((four, limits[:1]), (start, limits[1:])):
            before = getattr(asked.tolerances, name)
            after = [before.replace(**dict(zip(("lower", "upper"), x[name]))) if name in x else before for x in sets]
            cells += [limits_of(asked, name, one).text() if one else "-" for one in (before, *after)]
        rows.append((f"`{name}`", *cells))
    heads = ["error", "rv-40e", "its optimum", "rv-40e-whole", "without limits on forces", "its optimum"]
    return table(heads, rows)


def picture(axes):
    kept = stored("two_studies")
    responses = {
        "four-bar": "transmission_error",
        "412 N m": "loaded_transmission_error",
        "12.4 N m": "second_transmission_error",
    }
    names = [name for name in JUDGED if not name.endswith(("with its flanks", "on forces"))]
    for k, (model, response) in enumerate(responses.items()):
        at = np.arange(len(names)) + 0.22 * (k - 1)
        value, lower, upper = np.array([kept[name]["yield"][response] for name in names]).T
        above = 100 * (1 - value)
        reach = np.abs(np.array([100 * (1 - upper), 100 * (1 - lower)]) - above)
        axes.errorbar(above, at, xerr=reach, fmt="osD"[k], color=(AFTER, BEFORE, "0.2")[k], capsize=3, label=model)
    axes.axvline(0.27, color="0.5", linestyle=":")
    axes.axvline(1, color="0.5", linestyle="--")
    axes.set_xscale("log")
    axes.set_xlim(0.005, 100)
    axes.set_yticks(range(len(names)), [JUDGED[name].replace(", ", ",\n") for name in names])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("units above 1 arcmin (%); dotted: 0.27, dashed: 1")
    axes.set_title("Transmission error: four-bar model and whole reducer")
    axes.legend(loc="upper left")
    return axes


def budget(_):
    kept = stored("two_studies")["budget of rv-40e-whole"]

    def arrays(value):
        return {key: arrays(item) for key, item in value.items()} if isinstance(value, dict) else np.asarray(value)

    waves = {key: arrays(kept[key]) for key in ("orders", "variance", "total", "alike")}
    return plotting.error_budget(Budget(**(kept | waves)))
