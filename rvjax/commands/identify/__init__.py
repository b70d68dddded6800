"""`rvjax identify`: errors of the parts of a unit from bench measurements."""

import dataclasses
import shlex
from dataclasses import dataclass

import numpy as np

from rvjax import identify, study
from rvjax.base.files import versions
from rvjax.commands import READING, WRITING, Inputs, argument, encoding_option, quiet_option, results_option, switch
from rvjax.commands.cells import findings_data
from rvjax.commands.identify.identified import (
    FITTING,
    RANKING,
    SEEING,
    Identified as Identified,
    answer as answer,
    check as check,
    field_of,
)
from rvjax.commands.identify.tables import content, figures, orders_of_parts
from rvjax.commands.identify.words import (
    Combination,
    combinations as combinations,
    elements as elements,
    head_of,
    headline as headline,
    in_words as in_words,
    next_lines as next_lines,
    rounded as rounded,
    verdict_line as verdict_line,
)
from rvjax.render import Report, leading_comment, results_folder
from rvjax.study import field_unit, identification_of, read_measured
from rvjax.units import arcsec


@dataclass(kw_only=True)
class IdentifyInputs(Inputs):
    """Compute the errors of the parts from bench data of one unit or several: most probable values with 95 % intervals,
    identifiable errors, a test of the model, violated limits, and the next measurement.

    examples:
      rvjax identify my-study.toml bench.csv
      rvjax identify my-study.toml --check            what a bench can identify, before the measurement
      rvjax identify my-study.toml a.csv b.csv --json > unit.json

    The study has a section [identify]. A data file is CSV with headers "name [unit]": angle, error, torque,
    direction, temperature, unit of a curve; torque, angle of a loop; frequency, sd. The folder contains report.html,
    summary.txt, elements.csv, result.json (SI units, seed, versions), study.toml and plots. exit code 1: the model
    cannot explain the data (REJECTED), or there is no solution.
    """

    source: str = argument("a study file (.toml) with [identify]", "STUDY")
    data: list[str] = argument("bench data; optional with --check", "DATA.csv", nargs="*")
    check: bool = switch("print only the identifiability, without values")
    sample: bool = switch("sample the posterior too (extra sampler)")
    json: bool = switch("the same as --format json")
    encoding: str | None = encoding_option()
    results: str | None = results_option("STUDY")
    quiet: bool = quiet_option()

    def __post_init__(self) -> None:
        """Read the study and the bench data."""
        self.study = study.load(self.source, solve=False, needs=("design", "tolerances"))
        identification_of(self.study)  # raises an error before the data is read
        self.measured = read_measured(self.data, self.study.columns, encoding=self.encoding) if self.data else None
        if self.measured is None and not self.check:
            raise ValueError("no data: name at least one CSV file, or use --check for the identifiability")
        self.folder = None if self.check else results_folder(self.results, self.study.name)
        self.phases = (READING, SEEING, RANKING) if self.check else (READING, SEEING, FITTING, RANKING, WRITING)


def compute(inputs: IdentifyInputs) -> Identified:
    """Identify what the data can distinguish, and most probable values if there are data."""
    if inputs.check or inputs.measured is None:
        return check(inputs.study, inputs.measured)
    return answer(inputs.study, inputs.measured, draws=inputs.sample)


def report(inputs: IdentifyInputs, found: Identified) -> Report:
    """The report on an identification.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    study, drawn = inputs.study, {figure.name: figure for figure in figures(found)}
    mark = {None: "", True: "✔ " if found.converged else "⚠ ", False: "✘ "}[found.adequate]
    title, *more = headline(found).split("\n")
    command = " ".join(["rvjax identify", *(shlex.quote(name) for name in (inputs.source, *inputs.data))])
    return Report(
        title=f"{study.name}: cause of this curve",
        content=tuple(content(found, drawn)),
        status=f"{mark}{title}",
        ok=found.adequate is not False,
        data=_data(found) | {"data": inputs.data},
        files={"study.toml": study.text.encode()},
        page="",
        facts={
            "heading": f"{study.name}: cause of this curve",
            "intro": leading_comment(study.text),
            "said": " ".join([*more, f"{verdict_line(found)}."]),
            "boxes": _boxes(found),
            "origin": {"command": command, "seed": str(study.seed)},
            "study": study.text,
        },
    )


def _boxes(found: Identified) -> list[tuple[str, str, str]]:
    boxes = []
    if found.posterior is not None:
        fit = found.posterior.fit
        boxes = [
            ("can a part cause this?", f"p = {fit.p_model:.3g}", f"chi² {fit.chi2_model:.4g} of {fit.dof_model:g}"),
            ("a part of this drawing?", f"p = {fit.p_prior:.3g}", f"chi² {fit.chi2_prior:.4g} of {fit.dof_prior:g}"),
        ]
    boxes.append(("information", f"{found.check.information:.3g} nats", f"{len(found.check.directions)} directions"))
    if alone := orders_of_parts(found):
        boxes.append(("orders of parts only", ", ".join(map(str, alone)), "the housing cannot make them"))
    if found.problem.kind == "curve":
        boxes.append(("noise", f"{found.problem.sd / arcsec:.3g} arcsec", "of a real number"))
    return boxes


def _data(found: Identified) -> dict[str, object]:
    """Everything about an identification as JSON values, SI."""
    check, posterior, batch = found.check, found.posterior, found.batch
    said: dict[str, object] = {
        "study": found.study.name,
        "model": found.problem.identification.model,
        "kind": found.problem.kind,
    }
    if posterior is not None:
        said |= {"status": posterior.status, "adequate": found.adequate}
    elif batch is not None:
        worst = next((str(s) for s in batch.status if s != "CONVERGED"), "CONVERGED")
        said |= {"status": worst, "adequate": found.adequate}
    said |= {
        "verdict": check.verdict,
        "resolution": check.resolution,
        "directions": [_direction(*pair) for pair in zip(check.directions, combinations(found))],
        "inseparable": check.inseparable,
        "silent": found.silent,
        "part_orders": orders_of_parts(found),
        "unit": {name: field_unit(found.study.design, field_of(name)) for name in check.names},
    }
    if posterior is not None:
        said |= {key: elements(getattr(posterior, key)) for key in ("value", "lower", "upper")}
        said |= {"shares": posterior.shares, "broken": posterior.broken, "fit": _fit(posterior.fit)}
        said["laplace"] = posterior.laplace
        said["head"] = (head := head_of(posterior)) and dataclasses.asdict(head)
        said["modes"] = [{"value": elements(mode.value), "weight": mode.weight} for mode in posterior.modes]
    if batch is not None:
        said["units"] = {unit: _of_unit(batch, k) for k, unit in enumerate(found.problem.units)}
        said["shared"] = list(batch.shared_names)
    if found.draws is not None:
        said["draws"] = {key: getattr(found.draws, key) for key in ("trusted", "r_hat", "ess", "divergences")}
    best = next(iter(found.gains or {}), None)
    said["next"] = None if best is None else {"chosen": best, "gains": found.gains}
    said["measurement"] = {name: findings_data(several) for name, several in found.findings.items()}
    said |= {"noise": found.problem.sd, "runs": [run.text() for run in found.problem.runs]}
    said |= {"notes": list(found.problem.notes)} if found.problem.notes else {}
    return said | {"seed": found.study.seed, "versions": versions()}


def _direction(own: identify.Direction, named: Combination) -> dict[str, object]:
    said: dict[str, object] = {"information": own.information, "loadings": own.loadings}
    value, numbers = named.value, ("value", "lower", "upper", "unit")
    return said | {"terms": named.terms, "rest": named.rest} | {key: getattr(value, key, None) for key in numbers}


def _fit(fit: identify.Fit, k: int | None = None) -> dict[str, object]:
    keys = ("chi2_model", "dof_model", "p_model", "chi2_prior", "dof_prior", "p_prior", "p_total")
    said = {key: getattr(fit, key) if k is None else np.asarray(getattr(fit, key))[k] for key in keys}
    return said | ({"worst": list(fit.worst)} if k is None else {})


def _of_unit(batch: identify.Batch, k: int) -> dict[str, object]:
    said: dict[str, object] = {"status": str(batch.status[k]), "fit": _fit(batch.fit, k)}
    for key in ("value", "lower", "upper"):
        said[key] = elements({field: np.asarray(values)[k] for field, values in getattr(batch, key).items()})
    return said
