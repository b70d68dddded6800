"""The joint model of one unit of a study, or a statistic of the joint models of random units."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import rvjax
from rvjax import running
from rvjax._jax.programs import QUICK
from rvjax.base import progress
from rvjax.commands.export.inputs import STATISTICS, Inputs
from rvjax.commands.speak import READING, WRITING
from rvjax.population import Population, drawn, root_key
from rvjax.records import PyTree, Record, field, record, text
from rvjax.response import per_response
from rvjax.running import Header
from rvjax.status import MEANING, SUCCESS, Status
from rvjax.study import StudyError, naming

SOLVING = "joint model"
LOW = ("stiffness", "mu_dif")
"""Numbers of which the low values are unfavourable."""


@record
class _Joined(Record):
    """The joint model of one unit."""

    design: PyTree = field("-", "the reducer", kind="record")
    ways: tuple[tuple[str, Any], ...] = text("arguments of the joint model")

    def __call__(self, errors: PyTree) -> running.Joint:
        return running.joint(errors.stiffened(self.design), errors, **dict(self.ways))


@per_response(options=QUICK)
def _of_unit(unit: _Joined, errors: PyTree) -> running.Joint:
    return unit(errors)


@per_response(options=QUICK)
def _of_units(unit: _Joined, population: Population, z: jax.Array) -> running.Joint:
    """Joint models of the units with random numbers z (numbers, units)."""
    return jax.vmap(lambda z: unit(population.errors(z)), in_axes=-1)(z)


def phases(inputs: Inputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return (READING, SOLVING, WRITING)


def compute(inputs: Inputs) -> tuple[running.Joint, Header]:
    """The joint model, and its origin.

    Raises:
        StudyError: a unit that cannot be solved, in one line.
    """
    progress.begin(SOLVING)
    study, given = inputs.study, inputs.study.conditions
    ways = dict(
        rated_torque=inputs.rated_torque,
        damping=inputs.damping,
        input_angle=given.input_angle,
        samples=given.running_samples,
        contact=given.pin_contact,
        carrier=given.carrier,
        sun=getattr(given, "sun", "fixed"),
    )
    unit = _Joined(study.design, tuple(ways.items()))
    with naming(study.name):
        if inputs.errors is None:
            found, said = _statistic(unit, inputs)
        else:
            found, said = _of_unit(unit, inputs.errors), inputs.unit
            if (status := Status(int(found.info.status))) not in SUCCESS:
                raise StudyError(f"unit {inputs.unit}: cannot be solved: {status.name} ({MEANING[status]})")
    if inputs.rotor_inertia is not None:
        found = found.replace(rotor_inertia=inputs.rotor_inertia * found.ratio**2)
    if inputs.output_inertia is not None:
        found = found.replace(output_inertia=inputs.output_inertia)
    return found, Header(study.name, said, rvjax.__version__)


def _statistic(unit: _Joined, inputs: Inputs) -> tuple[running.Joint, str]:
    """Each number at its median or its unfavourable quantile; a unit that fails counts as unfavourable in each."""
    study, count, share = inputs.study, inputs.units, STATISTICS[inputs.unit]
    population = Population.of(study.tolerances)
    z = drawn(population, root_key(study.seed), jnp.uint32(0), count=count)
    found = jax.device_get(_of_units(unit, population, z))
    good = np.isin(found.info.status, [int(status) for status in SUCCESS])
    if np.ceil(share * (count - 1)) >= good.sum():
        raise StudyError(f"unit {inputs.unit}: {count - good.sum()} of {count} units cannot be solved")

    def quantile(name: str, values: PyTree) -> np.float64:
        values = np.broadcast_to(np.asarray(values, float), count)
        sign = -1 if name in LOW else 1
        return np.float64(sign * np.quantile(np.where(good, sign * values, np.inf), share))

    numbers = {name: getattr(found, name) for name in running.units(found)}
    settled = {name: quantile(name, value) for name, value in numbers.items() if value is not None}
    info = jax.tree.map(lambda x: x[0], found.info)
    what = "median" if inputs.unit == "median" else "unfavourable 99 % quantile"
    said = f"{inputs.unit}, no single unit: each number is the {what} of {count} random units, seed {study.seed}"
    said += f"; {count - good.sum()} of them cannot be solved and count as unfavourable" if not good.all() else ""
    return found.replace(info=info, **settled), said
