"""What a person and a machine read of an identification: text, JSON, and the results folder."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from rvjax.report.folders import as_csv
from rvjax.report.folders import as_json as json_file
from rvjax.report.text import plain, table, versions
from rvjax.study.bench import NUISANCES
from rvjax.study.identification import field_unit
from rvjax.study.identified import Identified
from rvjax.units import KNOWN, arcsec, readable

SHOWN = 0.3  # loadings below this share of the largest are not part of a combination in words
EQUAL = 0.1  # loadings that differ less count as one
MOST_ROWS = 60
SEEN = 1e-3  # resolution of the elements that a table of text lists


def field_of(element: str) -> str:
    """Field of an element: "crank_phase[1]" -> "crank_phase"."""
    return element.partition("[")[0]


def in_words(loadings: Mapping[str, float]) -> str:
    """A combination as a person writes it: "crank eccentricity [0,0] - [0,1] - [1,0] + [1,1]"."""
    largest = max(map(abs, loadings.values()))
    terms = {name: size for name, size in loadings.items() if abs(size) >= SHOWN * largest}
    alike = all(abs(abs(size) - largest) <= EQUAL * largest for size in terms.values())
    lead = 1.0 if next(iter(terms.values())) > 0 else -1.0
    said, field = "", ""
    for name, size in terms.items():
        own = field_of(name)
        place = name[len(own) :]
        factor = "" if alike else f"{abs(size) / largest:.2g} "
        shown = place if own == field and place else " ".join([own.replace("_", " "), place]).strip()
        sign = "-" if lead * size < 0 else "+"
        said += f" {sign} {factor}{shown}" if said else f"{factor}{shown}"
        field = own
    return said


def elements(structure: Mapping[str, Any]) -> dict[str, float]:
    """{element: number} of values with the structure of a prior."""
    found = {}
    for name in sorted(structure):
        values = np.asarray(structure[name], float)
        for place in np.ndindex(values.shape):
            found[name + (f"[{','.join(map(str, place))}]" if place else "")] = float(values[place])
    return found


def shown_unit(answer: Identified, field: str) -> tuple[str, float]:
    """Name and SI size of the unit in which a person reads a field."""
    if field in NUISANCES:
        return "arcsec", arcsec
    unit = field_unit(answer.study.design, field)
    return ("N/um", KNOWN["N/m"]["N/um"]) if unit == "N/m" else readable(unit)


def direction_lines(answer: Identified) -> list[str]:
    """What the data see, strongest first, in words."""
    lines = []
    for direction in answer.check.directions:
        left = 1 / math.sqrt(1 + direction.information)
        lines.append(f"{in_words(direction.loadings)}: to {100 * left:.3g} % of what the drawing leaves open")
    return lines


def verdict_line(answer: Identified) -> str:
    """How many elements the data identify, and how many combinations."""
    own = [name for name in answer.check.names if field_of(name) not in answer.problem.nuisance]
    counts = {
        kind: sum(answer.check.verdict[n] == kind for n in own) for kind in ("identified", "combination", "unseen")
    }
    many = f"{len(own)} elements: {counts['identified']} identified"
    return f"{many}, {counts['combination']} in combinations only, {counts['unseen']} unseen"


def headline(answer: Identified) -> str:
    """The verdict on the data in a line or two."""
    name = answer.study.name
    if answer.posterior is None and answer.batch is None:
        return f"Study {name}: what {_what(answer)} can tell apart"
    if answer.batch is not None:
        wrong = sum(status != "CONVERGED" for status in answer.batch.status)
        return f"Study {name}: {len(answer.problem.units)} units, {wrong} with another status than CONVERGED"
    found = answer.posterior
    assert found is not None
    lines = [f"Study {name}: {found.status}"]
    p, prior = found.fit.p_model, found.fit.p_prior
    cannot = "The model cannot explain the data: another reducer, a missing effect, or noise understated"
    lines.append(f"{'The model can explain the data' if found.adequate else cannot} (p = {p:.3g}).")
    if prior < 1e-3:
        lines.append(
            f"Parts of this drawing hardly make such a curve (p = {prior:.3g}): something is out of tolerance."
        )
    return "\n".join(lines)


def _what(answer: Identified) -> str:
    if answer.problem.kind != "curve":
        return "a loop" if answer.problem.kind == "loop" else "frequencies"
    runs = [run.text() for run in answer.problem.runs]
    return f"{len(runs)} run{'s' if len(runs) > 1 else ''} ({'; '.join(runs)})"


def element_rows(answer: Identified) -> tuple[list[str], list[list[str]]]:
    """Headers and rows of the table of elements, those that the data move most first."""
    check, found = answer.check, answer.posterior
    names = sorted(check.names, key=lambda name: -check.resolution[name])
    headers = ["element", "verdict", "known better by"]
    rows = [[name, str(check.verdict[name]), f"{100 * max(check.resolution[name], 0.0):.1f} %"] for name in names]
    if found is not None:
        headers += ["value", "95 % interval", "beyond limit"]
        value, lower, upper = (elements(x) for x in (found.value, found.lower, found.upper))
        for name, row in zip(names, rows):
            unit, size = shown_unit(answer, field_of(name))
            out = found.broken.get(name, 0.0)
            low, high = lower[name] / size, upper[name] / size
            least = 1e-4 * (high - low)  # a value that is 0 but for rounding
            shown = [f"{0.0 if abs(x) < least else x:.4g}" for x in (value[name] / size, low, high)]
            row += [f"{shown[0]} {unit}", f"{shown[1]} .. {shown[2]}"]
            row.append(f"{100 * out:.3g} %" if out >= 1e-4 else "-")
    return headers, rows


def unit_rows(answer: Identified) -> tuple[list[str], list[list[str]]]:
    """Headers and rows of the table of units of a batch: status, fit, and the elements that are identified."""
    batch = answer.batch
    assert batch is not None
    value, lower, upper = ({f: np.asarray(x[f]) for f in x} for x in (batch.value, batch.lower, batch.upper))
    own = [n for n in answer.check.names if answer.check.verdict[n] == "identified"]
    own = [n for n in own if field_of(n) not in answer.problem.nuisance][:6]
    headers = ["unit", "status", "p model", "p prior", *own]
    chances = [np.asarray(p) for p in (batch.fit.p_model, batch.fit.p_prior)]
    rows = []
    for k, unit in enumerate(answer.problem.units):
        row = [unit or "-", str(batch.status[k]), *(f"{p[k]:.3g}" for p in chances)]
        for name in own:
            field = field_of(name)
            shown, size = shown_unit(answer, field)
            at = tuple(int(i) for i in name[len(field) :].strip("[]").split(",") if i)
            middle, low, high = (float(x[field][(k, *at)]) / size for x in (value, lower, upper))
            row.append(f"{middle:.4g} [{low:.4g}, {high:.4g}] {shown}")
        rows.append(row)
    return headers, rows


def next_lines(answer: Identified, most: int = 3) -> list[str]:
    """What to measure next, best first."""
    return [f"{name}: {gain:.3g} nats" for name, gain in list((answer.gains or {}).items())[:most]]


def summary(answer: Identified) -> str:
    """The whole answer as text."""
    lines = [headline(answer), "", verdict_line(answer)]
    if answer.silent:
        fields = sorted({field_of(name) for name in answer.silent} - set(answer.problem.nuisance))
        lines.append(
            f"The data say nothing of {', '.join(fields)}: the drawing is all that is known of them."
        ) if fields else None
    lines += ["", "What the data see, strongest first:"]
    lines += [f"  only {line}" for line in direction_lines(answer)] or ["  nothing beyond the drawing"]
    if pairs := answer.check.inseparable:
        shown = [f"{a} and {b} ({r:+.3f})" for a, b, r in pairs[:5]]
        lines.append(f"Cannot be told apart: {', '.join(shown)}{', ..' if len(pairs) > 5 else ''}")
    headers, rows = element_rows(answer)
    seen = [row for row in rows if answer.check.resolution[row[0]] >= SEEN]
    lines += ["", table(headers, seen[:MOST_ROWS])]
    if len(rows) > len(seen[:MOST_ROWS]):
        lines.append(f"{len(rows) - len(seen[:MOST_ROWS])} more elements: as the drawing has them")
    if answer.batch is not None:
        lines += ["", table(*unit_rows(answer))]
    if answer.posterior is not None:
        found = answer.posterior
        lines += ["", "Who makes the curve (shares; negative: cancels others):"]
        lines += [f"  {group}: {_shares_text(fields)}" for group, fields in found.shares.items()]
        lines += ["", f"Largest residuals: {', '.join(map(str, found.fit.worst[:3]))}"]
        if found.status == "LAPLACE_DOUBTFUL":
            lines.append("The intervals are doubtful (a kink or a bound is near): run again with --sample.")
    if answer.draws is not None:
        fine = "agree" if answer.draws.trusted else "do NOT agree: another mode, or more draws are needed"
        lines.append(f"Sampled: chains {fine}, largest r_hat {np.max(answer.draws.r_hat):.4f}")
    if coming := next_lines(answer):
        lines += ["", "Measure next:", *(f"  {line}" for line in coming)]
    return "\n".join(lines)


def _shares_text(fields: Mapping[str, float]) -> str:
    seen = sorted((f for f in fields if abs(fields[f]) >= 0.005), key=lambda f: -abs(fields[f]))
    return ", ".join(f"{name.replace('_', ' ')} {100 * fields[name]:.0f} %" for name in seen) or "-"


def as_json(answer: Identified) -> dict[str, Any]:
    """Everything about an answer as JSON values, SI, with seed and versions."""
    check, found, batch = answer.check, answer.posterior, answer.batch
    said: dict[str, Any] = {
        "study": answer.study.name,
        "model": answer.problem.asked.model,
        "kind": answer.problem.kind,
    }
    if found is not None:
        said |= {"status": found.status, "adequate": answer.adequate}
    elif batch is not None:
        worst = next((str(s) for s in batch.status if s != "CONVERGED"), "CONVERGED")
        said |= {"status": worst, "adequate": answer.adequate}
    said |= {
        "verdict": check.verdict,
        "resolution": check.resolution,
        "directions": [{"information": d.information, "loadings": d.loadings} for d in check.directions],
        "inseparable": check.inseparable,
        "silent": answer.silent,
        "unit": {name: field_unit(answer.study.design, field_of(name)) for name in check.names},
    }
    if found is not None:
        said |= {key: elements(getattr(found, key)) for key in ("value", "lower", "upper")}
        said |= {"shares": found.shares, "broken": found.broken, "fit": _fit(found.fit)}
        said["laplace"] = found.laplace
        said["modes"] = [{"value": elements(mode.value), "weight": mode.weight} for mode in found.modes]
    if batch is not None:
        said["units"] = {unit: _unit(answer, k) for k, unit in enumerate(answer.problem.units)}
        said["shared"] = list(batch.shared_names)
    if answer.draws is not None:
        said["draws"] = {key: getattr(answer.draws, key) for key in ("trusted", "r_hat", "ess", "divergences")}
    best = next(iter(answer.gains or {}), None)
    said["next"] = None if best is None else {"chosen": best, "gains": answer.gains}
    said["noise"] = answer.problem.sd
    said["runs"] = [run.text() for run in answer.problem.runs]
    said["seed"] = answer.study.seed
    said["versions"] = versions()
    return plain(said)


def _fit(fit: Any, k: int | None = None) -> dict[str, Any]:
    keys = ("chi2_model", "dof_model", "p_model", "chi2_prior", "dof_prior", "p_prior", "p_total")
    said = {key: getattr(fit, key) if k is None else np.asarray(getattr(fit, key))[k] for key in keys}
    return said | ({"worst": list(fit.worst)} if k is None else {})


def _unit(answer: Identified, k: int) -> dict[str, Any]:
    batch = answer.batch
    assert batch is not None
    said: dict[str, Any] = {"status": str(batch.status[k]), "fit": _fit(batch.fit, k)}
    for key in ("value", "lower", "upper"):
        fields = getattr(batch, key)
        said[key] = elements({f: np.asarray(fields[f])[k] for f in fields})
    return said


def files(answer: Identified, data: Sequence[str], more: Iterable[tuple[str, bytes]]) -> Iterator[tuple[str, bytes]]:
    """Everything that goes into a results folder, by name."""
    from rvjax.report import identified_numbers  # reads the units of this module

    yield "study.toml", answer.study.text.encode()
    yield "summary.txt", (summary(answer) + "\n").encode()
    yield "result.json", json_file(as_json(answer) | {"data": list(data)})
    yield "elements.csv", as_csv(*identified_numbers.element_numbers(answer))
    if answer.batch is not None:
        yield "units.csv", as_csv(*identified_numbers.unit_numbers(answer))
    yield from more
