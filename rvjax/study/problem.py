"""Problem that `rvjax.identify` solves, from a study and its measurements: model, prior, data, noise."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from rvjax import identify, models
from rvjax._jax.sizes import padded
from rvjax.measured import GRID, KINDS, Conditions, Judged, Loop, Measured, Run, Tones, checked, judge
from rvjax.outputs import Observation, torque_of
from rvjax.records import Design, PyTree
from rvjax.study.bench import (
    Curves,
    Midline,
    Model,
    Seen,
    curve_model,
    frequency_model,
    order_name,
    rated_torque,
    signed_torques,
)
from rvjax.study.identification import NUISANCES, Identification, planned_kind
from rvjax.study.kinds import kind_of, orders_of
from rvjax.study.study import Study, StudyError
from rvjax.tolerances import Tolerance

BESIDE = 20  # orders that no model names, for the floor
MEDIAN = np.sqrt(2 * np.log(2))  # of the Rayleigh-distributed amplitude of noise, sd 1 in real and imaginary part
UNMEASURED = 1e6  # rad: noise of a run without weight
PER_TORQUE = ("torques", "reading", "speeds")  # fields of curves
LEVELS = (0.1, 0.5, 1.0, 2.0)  # torques of candidates, of the largest one of the data, where the study names none


@dataclasses.dataclass(frozen=True)
class Problem:
    """Problem for `rvjax.identify`.

    Attributes:
        study: solved study.
        kind: "curve", "loop" or "frequencies".
        prior: flat dict of Tolerance.
        model: values -> observation.
        noise: of the observation, per real number.
        sd: one number of the same size, for what is not measured yet.
        nuisance: fields without interest.
        runs: torque and direction of each run of a curve.
        units: names; () without data.
        data: observation of each unit, in the order of `units`.
        items: what each unit measured.
        notes: how the files were read, where they have not the plain form.
    """

    study: Study
    kind: str
    prior: dict[str, Tolerance]
    model: Model
    noise: identify.Noise
    sd: float
    nuisance: tuple[str, ...]
    runs: tuple[Conditions, ...] = ()
    units: tuple[str, ...] = ()
    data: tuple[Seen, ...] = ()
    items: tuple[tuple[Run | Loop | Tones, ...], ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def identification(self) -> Identification:
        """The section [identify]."""
        return identification_of(self.study)

    def stacked(self) -> Seen:
        """The data with units on axis 0."""
        return {key: np.stack([data[key] for data in self.data]) for key in self.data[0]}


def _model(study: Study, given: Identification, runs: Sequence[Conditions]) -> Curves:
    active = tuple(given.prior(study.tolerances))
    return curve_model(given.model, study.design, study.conditions, runs, given.orders, given.nuisance, active)


def identification_of(study: Study) -> Identification:
    """Identification problem of a study.

    Raises:
        StudyError: it has no [identify].
    """
    if study.identification is None:
        able = models.kind(study.design).observed
        models_of = " or ".join(f'"{name}"' for name in able)
        needs = f"it needs at least model = {models_of}, orders and noise"
        cannot = f"no model of {kind_of(study.design).name} can be measured"
        raise StudyError(f"{study.name}: [identify] is missing; {needs if able else cannot}")
    return study.identification


def problem(study: Study, measured: Measured | None = None) -> Problem:
    """The problem of a study and its data; without data, of the runs that the study plans.

    Args:
        study: with [identify].
        measured: what a bench measured.

    Raises:
        ValueError: data of a kind that the model does not predict, runs that do not determine the orders, or
            a floor that nothing measures.
    """
    given = identification_of(study)
    observations = models.kind(study.design).observations(given.model)
    kind = measured.kind if measured else planned_kind(observations, given.orders)
    if measured and kind not in observations:
        takes = " or ".join(observations)
        raise ValueError(f"{measured.items[0].source}: holds {kind}; identify.model = {given.model!r} takes {takes}")
    if measured is None and given.noise is None:
        raise ValueError(f"{study.name}: identify.noise = 'floor': is read from data; give a number to check without")
    if kind == "curve" and not given.orders:
        raise ValueError(f"{study.name}: identify.orders is missing: orders of the output turn, such as [40, 80]")
    if alien := [name for name in given.nuisance if name in NUISANCES and name not in KINDS[kind].nuisances]:
        raise ValueError(f"{study.name}: identify.nuisance = {alien[0]!r}: is for curves; the data holds {kind}")
    made = {"curve": _curves, "loop": _loops, "frequencies": _frequencies}[kind](study, given, measured)
    return dataclasses.replace(made, notes=measured.notes) if measured else made


def _made(
    study: Study,
    kind: str,
    model: Model,
    sd: PyTree,
    key: str,
    units: tuple[str, ...],
    data: Sequence[Seen],
    items: tuple[tuple[Run | Loop | Tones, ...], ...],
    runs: tuple[Conditions, ...] = (),
) -> Problem:
    """The problem with its prior; `key` names the part of the observation whose noise is the usual one."""
    given = identification_of(study)
    usual, prior = float(given.noise or np.median(sd[key])), given.prior(study.tolerances)
    own = tuple(data), items
    return Problem(study, kind, prior, model, identify.Noise(sd), usual, given.nuisance, runs, units, *own)


def _observation(study: Study, given: Identification, kind: str) -> Observation:
    return models.kind(study.design).observations(given.model)[kind]


def _curves(study: Study, given: Identification, measured: Measured | None) -> Problem:
    wanted = sorted({*given.orders, *([1] if "mounting" in given.nuisance else [])})
    groups = [order_name(k) for k in wanted] + (["mean"] if "offset" in given.nuisance else [])
    data: list[Seen] = []
    sds: dict[str, np.ndarray] = {}
    units: tuple[str, ...] = ()
    items: tuple[tuple[Run, ...], ...] = ()
    if measured is None:
        runs = planned(study)
        model = _model(study, given, runs)
    else:
        beside = floor_orders(study.design, given.orders)
        units = tuple(measured.units)
        own = [_by_place([run for run in measured.runs if run.at.unit == name]) for name in units]
        places = list(dict.fromkeys(place for runs in own for place in runs))
        runs, items = tuple(place[0] for place in places), tuple(tuple(runs.values()) for runs in own)
        model = _model(study, given, runs)  # checks the orders before the data
        sds = {key: np.full((len(units), len(runs)), np.nan) for key in groups}
        for u, found in enumerate(own):
            seen: Seen = {key: np.full(len(runs), np.nan, float if key == "mean" else complex) for key in groups}
            for place, run in found.items():
                r = places.index(place)
                values, mean, floor = _fitted(run, wanted, beside, orders_of(study.design))
                for order, value in zip(wanted, values):
                    seen[order_name(order)][r] = value
                if "mean" in seen:
                    seen["mean"][r] = mean
                for key in groups:
                    sds[key][u, r] = given.noise or floor
            data.append(seen)
    if given.noise is not None:
        sd: PyTree = given.noise
    else:  # of each run; of several units the mean square, since one noise serves all
        sd = {key: np.sqrt(np.nanmean(values**2, axis=0)) for key, values in sds.items()}
    return _made(study, "curve", model, sd, groups[0], units, data, items, tuple(runs))


def _by_place(runs: Sequence[Run]) -> dict[tuple[Conditions, int], Run]:
    """Runs of one unit by conditions without the unit, and how often these came before."""
    found: dict[tuple[Conditions, int], Run] = {}
    for run in runs:
        place = dataclasses.replace(run.at, unit="")
        found[(place, sum(place == other for other, _ in found))] = run
    return found


def _fitted(
    run: Run, wanted: Sequence[int], beside: Sequence[int], parts: Mapping[str, float]
) -> tuple[list[complex], float, float]:
    """Orders of a run by least squares on its real angles, mean and noise floor; mean and order 1 are always fitted."""
    checked(run, max(wanted))
    judged = judge(run, parts)
    _check_alike(judged, wanted)
    every = sorted({1, *wanted, *beside})
    try:
        found = identify.orders(judged.angle, judged.error, every)
    except ValueError as error:
        raise ValueError(f"{run.source}: run {run.at.text()}: {error}") from None
    value = dict(zip(every, np.asarray(found.value)))
    floor = float(np.median(np.abs([value[k] for k in beside])) / MEDIAN)
    if not floor > 0:
        raise ValueError(
            f"{run.source}: run {run.at.text()}: its noise floor is 0 arcsec; give identify.noise a number"
        )
    return [value[k] for k in wanted], float(found.mean), floor


def _check_alike(judged: Judged, wanted: Sequence[int]) -> None:
    """Raise ValueError for an order that another order of the reducer looks like at the measured angles."""
    for order in wanted:
        for name, own in judged.hidden(order).items():
            alike = f"{judged.sampling.points} points: order {own:.5g} ({name}) looks like order {order}"
            need = f"measure {2 * max(own, order) + 1:.0f} points per revolution or more, or at uneven angles"
            raise ValueError(f"{judged.run.name}: {alike}; {need}")


def floor_orders(design: Design, orders: Sequence[int]) -> list[int]:
    """The orders nearest to those of a study that no part of the reducer causes."""
    top = max(orders) + 200
    several = [round(n * part) for part in orders_of(design).values() for n in range(1, int(top / part) + 1)]
    named = {0, 1, 2, 3, 4, *orders} | {m + side for m in several for side in (-1, 0, 1)}
    free = [k for k in range(5, top) if k not in named]
    return sorted(sorted(free, key=lambda k: (min(abs(k - order) for order in orders), k))[:BESIDE])


def planned(study: Study) -> tuple[Conditions, ...]:
    """The runs that a study plans: its torques in its directions; without torques that of its conditions, forward."""
    given = identification_of(study)
    if not given.torques:
        return (Conditions(torque=float(torque_of(study.conditions))),)
    return tuple(Conditions(torque=t, direction=d) for t in given.torques for d in given.directions)


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A run that could be measured next.

    Attributes:
        model: of the runs of the problem under other torques, one of them that of the candidate.
        noise: when the candidate alone is measured.
    """

    model: Model
    noise: identify.Noise


def candidates(problem: Problem) -> dict[str, Candidate]:
    """Runs that could be measured next, by their text; several of them share a model, and all of them its program."""
    given, model = problem.identification, problem.model
    if not isinstance(model, Curves):
        return {}
    largest = np.max(np.abs(signed_torques(problem.runs, problem.study.conditions)), initial=0.0)
    largest = largest or rated_torque(problem.study.conditions)
    torques = given.torques or tuple(float(f"{share * largest:.3g}") for share in LEVELS)
    chosen = list(dict.fromkeys(Conditions(torque=t, direction=d) for t in torques for d in given.directions))
    wide = _model(problem.study, given, [*problem.runs, *chosen])
    groups = [order_name(k) for k in given.orders]
    groups += [key for key, name in ((order_name(1), "mounting"), ("mean", "offset")) if name in problem.nuisance]
    places = wide.place[len(problem.runs) :]
    distinct, size, runs = list(dict.fromkeys(places)), len(model.torques), len(problem.runs)
    found = {}
    for first in range(0, len(distinct), size):
        several = distinct[first : first + size]
        index = padded(np.array(several), size)
        own = {name: value[index] for name in PER_TORQUE if (value := getattr(wide, name)) is not None}
        part = model.replace(**own, idle=wide.idle, least=wide.least)
        for run, place in zip(chosen, places):
            if place in several:
                sd = np.full(runs, UNMEASURED)
                sd[model.place.index(several.index(place))] = problem.sd
                found[run.text()] = Candidate(part, identify.Noise(dict.fromkeys(groups, sd)))
    return {run.text(): found[run.text()] for run in chosen}


def _loops(study: Study, given: Identification, measured: Measured | None) -> Problem:
    units: tuple[str, ...] = ()
    items: tuple[tuple[Loop, ...], ...] = ()
    data: list[Seen] = []
    if measured is None:
        most = max([*given.torques, abs(float(torque_of(study.conditions))), rated_torque(study.conditions)])
        if not most > 0:
            missing = "the largest torque of a loop, such as 412 N m"
            raise ValueError(f"{study.name}: identify.torques is missing: {missing}")
        torque = np.linspace(-most, most, GRID)
        sd: PyTree = given.noise
    else:
        loops = [item for item in measured.items if isinstance(item, Loop)]
        units = tuple(loop.at.unit for loop in loops)
        if len(set(units)) < len(units):
            where = f"{loops[-1].source}: unit {units[-1]!r}"
            raise ValueError(f"{where} has several loops; identify them one after the other")
        torque, items = loops[0].torque, tuple((loop,) for loop in loops)
        low, high = max(loop.torque[0] for loop in loops), min(loop.torque[-1] for loop in loops)
        torque = np.linspace(low, high, GRID) if len(loops) > 1 else torque
        midline, width, sds = (
            [np.interp(torque, loop.torque, getattr(loop, name)) for loop in loops]
            for name in ("midline", "width", "sd")
        )
        data = [{"angle": y, "width": w} for y, w in zip(midline, width)]
        sd = given.noise or np.sqrt(np.mean(np.square(sds), axis=0))
    if "drag" in given.nuisance:  # a width is a difference of branches, a midline half of their sum
        sd = {"angle": sd, "width": 2 * sd}
    else:
        sd, data = {"angle": sd}, [{"angle": seen["angle"]} for seen in data]
    bench = tuple(name for name in given.nuisance if name in NUISANCES)
    model = Midline(study.design, -torque, _observation(study, given, "loop"), study.conditions, bench)
    return _made(study, "loop", model, sd, "angle", units, data, items)


def _frequencies(study: Study, given: Identification, measured: Measured | None) -> Problem:
    observation = _observation(study, given, "frequencies")
    start = {name: np.broadcast_to(float(t.middle), t.shape) for name, t in given.prior(study.tolerances).items()}
    units: tuple[str, ...] = ()
    items: tuple[tuple[Tones, ...], ...] = ()
    data: list[Seen] = []
    if measured is None:
        nominal = np.asarray(observation.predict(study.design, study.design.error_record(), study.conditions)[0])
        frequency = nominal[nominal > 0]
        sd: PyTree = given.noise
    else:
        tones = [item for item in measured.items if isinstance(item, Tones)]
        units = tuple(tone.at.unit for tone in tones)
        counts = {len(tone.frequency) for tone in tones}
        if len(counts) > 1 or len(set(units)) < len(units):
            raise ValueError(f"{tones[-1].source}: every unit needs the same number of frequencies, at one temperature")
        frequency, items = np.mean([tone.frequency for tone in tones], axis=0), tuple((tone,) for tone in tones)
        data = [{"frequency": tone.frequency} for tone in tones]
        own = np.sqrt(np.mean([tone.sd**2 for tone in tones], axis=0))
        if given.noise is None and np.any(np.isnan(own)):
            raise ValueError(
                f"{tones[0].source}: no column 'sd [Hz]' for identify.noise = 'floor'; add it or give a number"
            )
        sd = {"frequency": np.where(np.isnan(own), given.noise, own)} if not np.all(np.isnan(own)) else given.noise
    try:
        model = frequency_model(observation, study.design, study.conditions, frequency, start)
    except ValueError as error:
        source = measured.items[0].source if measured else study.name
        raise ValueError(f"{source}: {error}") from None
    return _made(study, "frequencies", model, sd, "frequency", units, data, items)
