"""Result of a study: the allocation, sample units, shares and cost curve; stored with study and version."""

import dataclasses
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

import rvjax
from rvjax import tolerances
from rvjax.base.files import versions
from rvjax.base.progress import begin, progress_bar
from rvjax.commands import forecast
from rvjax.commands.allocate.full_model_check import Unlimited, Whole, check_units, whole_response
from rvjax.commands.budget.effects import curves_of
from rvjax.commands.forecast import CERTIFYING, PRICING, SAMPLING, SEARCHING, doubts_of_unit, shown_values, targets
from rvjax.population import Population, root_key
from rvjax.records import PyTree
from rvjax.render import numbered_folders
from rvjax.response import (  # chunks of the certificate's size: the response compiles once
    BLOCK,
    Response,
    numbers_of,
    parts,
    response_names,
    status_without_errors,
    unit_at_mid_points,
)
from rvjax.status import Status
from rvjax.study import Study, refuse
from rvjax.tolerances import (
    Allocation,
    Influence,
    Memo,
    Requirement,
    Run,
    Statistics,
    allocate,
    influences,
    least_yield,
    monte_carlo,
)

_Curves = Callable[[PyTree, int], tuple[np.ndarray, np.ndarray]]

SHOWN_UNITS = 24  # units with a plotted curve


@dataclass(frozen=True)
class Side:
    """One set of tolerances with its cost, shares and sample units.

    Attributes:
        tolerances: record with a Tolerance or None in each field.
        cost: of each field that has a cost.
        influence: {response: what each error does to it}; empty before the allocation.
        values: {response: values of sample units}, for histograms.
        angle: of the curves, rad (angles,).
        curves: what a person looks at, for sample units, SI (units, angles); empty without such a curve.
        failed: {status name: index of the first sample unit that failed so}.
        seed: of the sample units.
    """

    tolerances: PyTree
    cost: dict[str, float]
    influence: Mapping[str, Influence]
    values: Mapping[str, np.ndarray]
    angle: np.ndarray
    curves: np.ndarray
    failed: dict[str, int]
    seed: int

    @property
    def shares(self) -> dict[str, dict[str, float]]:
        """Shares {response: {field: part of the variance}}."""
        return {name: {field: x.value for field, x in found.shares.items()} for name, found in self.influence.items()}


@dataclass(frozen=True)
class Answer:
    """Result of `rvjax allocate` and `rvjax report`.

    Attributes:
        study: solved study.
        allocation: the cheapest tolerances and their certificate.
        certificate_before: statistics of the study's own tolerances, on the certificate's random numbers.
        before: the study's own tolerances.
        after: the allocated tolerances.
        cost_curve: (least yield of a requirement, cheapest cost), ascending; the certified allocation
            itself included if all targets are equal; empty if the study is infeasible, requires no share
            of units, or has losses.
        whole: allocated units on the whole reducer, or None where the study has no such outputs.
        unlimited: {output that a loaded study does not limit: what it is of the allocated units}.
    """

    study: Study
    allocation: Allocation
    certificate_before: Statistics
    before: Side
    after: Side
    cost_curve: list[tuple[float, float]]
    whole: Whole | None = None
    unlimited: Mapping[str, Unlimited] = dataclasses.field(default_factory=dict)


def answer(
    study: Study,
    *,
    progress: bool = False,
    memo: Memo | None = None,
    measure: bool = True,
    tell: Callable[[str], object] = str,
) -> Answer:
    """Allocate the tolerances of a study and collect what the report shows.

    Args:
        study: solved study.
        progress: show progress bars.
        memo: store of intermediate results, from which an interrupted run resumes.
        measure: measure the allocated units of a four-bar or lost-motion study on the whole reducer, and what a
            loaded study does not limit.
        tell: takes the warnings of the unit at the mid-points, a line each, before the search.
    """
    response = study.units
    begin(SEARCHING)
    with progress_bar(progress, None, "checked", "unit") as advance:  # compiles the gradients: the longest wait
        population = Population.of(study.tolerances)
        refuse(status_without_errors(response, population))
        values, status = unit_at_mid_points(response, population)
        advance(1)
    for line in doubts_of_unit(study, values, Status(status)):
        tell(line)
    aims = [] if study.losses else targets(study)
    allocation = allocate(
        response,
        study.tolerances,
        study.requirements,
        costs=study.costs,
        samples=study.samples,
        seed=study.seed,
        certificate_samples=study.certificate_samples,
        joint_target=study.joint_target,
        middles=study.middles,
        losses=study.losses,
        grades=any(getattr(study.tolerances, name).size is not None for name in study.fields),
        yields=aims,
        memo=memo,
        progress=progress,
    )
    certificate = allocation.certificate
    begin(CERTIFYING)
    before = Run(
        response, population, response_names(response, population), study.requirements,
        min(certificate.samples, forecast.effort_of(study).before or certificate.samples),
        certificate.seed, min(study.samples, BLOCK) if certificate.samples < BLOCK else BLOCK,
        keep=certificate.values is not None, progress=progress, memo=memo,
    ).statistics()  # fmt: skip
    begin(SAMPLING)
    curves = _curves(study, response, population)
    chunk = BLOCK if study.middles else min(study.samples, BLOCK)  # of the search
    found = influences(response, allocation.tolerances, seed=study.seed, chunk=chunk)
    own = _side(study, response, study.tolerances, before, curves, {})
    cheapest = _side(study, response, allocation.tolerances, certificate, curves, found)
    begin(PRICING)
    whole, unlimited = check_units(study, allocation.tolerances) if measure else (None, {})
    return Answer(
        study,
        allocation,
        before,
        own,
        cheapest,
        cost_curve=_cost_curve(study, allocation),
        whole=whole,
        unlimited=unlimited,
    )


def _side(
    study: Study,
    response: Response,
    tolerances: object,
    certificate: Statistics,
    curves: _Curves,
    influence: Mapping[str, Influence],
) -> Side:
    kept = certificate
    if kept.values is None:  # more units than a histogram shows: some of its own
        count, seed = shown_values(study), study.seed + 2
        kept = monte_carlo(response, tolerances, samples=count, seed=seed, chunk=BLOCK, keep=True)
    angle, drawn = curves(tolerances, kept.seed)
    return Side(
        tolerances=tolerances,
        cost={name: float(cost(getattr(tolerances, name).half_width)) for name, cost in study.costs.items()},
        influence=influence,
        values=kept.values,
        angle=angle,
        curves=drawn,
        failed=kept.examples,
        seed=kept.seed,
    )


def _curves(study: Study, response: Response, population: Population) -> _Curves:
    """Angles (n,) and the curves of sample units (units, n) of some tolerances and a seed, by one program for all."""
    curve = study.curve
    if curve is None:
        return lambda tolerances, seed: (np.empty(0), np.empty((0, 0)))  # no model draws one
    turn = whole_response(study) if study.chooses_angles else None
    alike = turn is not None and turn.conditions is study.conditions
    every = cast(Response, turn) if alike else response  # at all angles
    drawing = [part for part in parts(every, population) if getattr(part.response, "curve", False)]
    if drawing and curve.angles is not None:  # a program of the outputs computes them, too
        angle = np.asarray(curve.angles(study.conditions))

        def solved_units(tolerances: object, seed: int) -> tuple[np.ndarray, np.ndarray]:
            population = Population.of(tolerances)
            return angle, drawing[0].curves(population, _shown(population, seed))

        return solved_units

    def drawn_units(tolerances: object, seed: int) -> tuple[np.ndarray, np.ndarray]:
        population = Population.of(tolerances)
        return curves_of(curve, study.design, study.conditions, population, _shown(population, seed))

    return drawn_units


def _shown(population: Population, seed: int) -> np.ndarray:
    """Random numbers of the units with a plotted curve."""
    return numbers_of(population, root_key(seed), np.arange(SHOWN_UNITS))


def _cost_curve(study: Study, found: Allocation) -> list[tuple[float, float]]:
    """Points (least yield of a requirement, cost), ascending, the allocation itself among them."""
    if not found.curve:
        return []
    points = list(found.curve)
    goals = {item.target for item in study.requirements.values() if isinstance(item, Requirement)}
    if len(goals) == 1 and study.joint_target is None:  # the allocation is a point of the curve
        points.append((least_yield(found.certificate), found.cost))
    return sorted(points)


def folder(study: Study, option: str | None) -> Path | None:
    """Find the latest results folder that holds the result of a study, or None.

    A study that names other files is always recomputed, because the files may have changed.

    Args:
        study: the question.
        option: folder of the command line; None for all under `results` with the name of the study.
    """
    if _names_files(study.tables):
        return None
    known = [Path(option)] if option is not None else numbered_folders(study.name)
    return next((place for place in reversed(known) if _holds(place, study)), None)


def memo(study: Study, place: Path) -> Memo | None:
    """Folder for intermediate results of an allocation; None if the study names other files."""
    if _names_files(study.tables):
        return None
    about = {"study": study.text, "flags": os.environ.get("XLA_FLAGS", "")}
    return Memo(place.with_name(place.name + ".part"), about | versions())


FILE = "answer.npz"
"""Stored part of a result: with the study, it determines all tables and plots."""


def stored(answer: Answer) -> bytes:
    """Write a result as the content of a file."""
    sides = {name: dict(vars(getattr(answer, name))) for name in ("before", "after")}
    found = {name: getattr(answer, name) for name in ("allocation", "certificate_before", "cost_curve")} | sides
    if answer.whole is not None:
        found["whole"] = dict(vars(answer.whole))
    found["unlimited"] = {name: dict(vars(one)) for name, one in answer.unlimited.items()}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, FILE)
        tolerances.save(found, path, study={"name": answer.study.name}, seed=answer.study.seed)
        return path.read_bytes()


def restored_from(study: Study) -> tuple[Path, Answer] | tuple[None, None]:
    """Find the latest results folder with the result of a study, and read the result; None without a folder."""
    place = folder(study, None)
    found = None if place is None else restored(study, place)
    return (None, None) if place is None or found is None else (place, found)


def restored(study: Study, place: Path) -> Answer | None:
    """Read the result of a study from its folder; None without the file, or with one of another rvjax."""
    try:
        found: dict[str, PyTree] = tolerances.load(place / FILE)
        found |= {name: Side(**found[name]) for name in ("before", "after")}
        found |= {"whole": Whole(**found["whole"])} if "whole" in found else {}
        found["unlimited"] = {name: Unlimited(**one) for name, one in found["unlimited"].items()}
        return Answer(study=study, **found)
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _holds(place: Path, study: Study) -> bool:
    try:
        if (place / "study.toml").read_text("utf-8") != study.text or not (place / "summary.txt").is_file():
            return False
        found = json.loads((place / "result.json").read_text("utf-8"))
        return bool(
            found["versions"]["rvjax"] == rvjax.__version__ and found["study"] == study.name and found["status"]
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # another folder, or a damaged one
        return False


def _names_files(tables: object) -> bool:
    if isinstance(tables, dict):
        return "file" in tables or any(map(_names_files, tables.values()))
    return isinstance(tables, list) and any(map(_names_files, tables))
