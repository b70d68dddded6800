"""Error budget of a response without a curve, such as a bearing life: shares of its variance over units, and slopes."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from rvjax._ground.files import versions
from rvjax._ground.progress import progress_bar
from rvjax._jax.blocks import AT_ONCE
from rvjax.commands.budget.effects import FEWEST, LEVELS, MOST, by_level, of_load, parts_of
from rvjax.population import Population, drawn, root_key
from rvjax.render import Note, Number, Report, Table, Text
from rvjax.response import elements, gradients, parts
from rvjax.status import SUCCESS
from rvjax.study import Study
from rvjax.units import readable


@dataclass(frozen=True)
class ScalarBudget:
    """Shares of the variance of one response over units.

    Attributes:
        output: name of the response.
        mean: over the units, SI.
        sd: standard deviation over the units, SI.
        variance: {error: mean square change when this error is held}, unit squared.
        error: {error: standard error of its variance}.
        together: (share of the variance that errors have together, at most, its standard error).
        slope: {error: derivative to one of its elements, root mean square over elements and units}.
        part: {error: part of the reducer}.
        samples: units, of which `failed` are left out.
        failed: units without a value, or with a neighbour without one.
    """

    output: str
    mean: float
    sd: float
    variance: dict[str, float]
    error: dict[str, float]
    together: tuple[float, float]
    slope: dict[str, float]
    part: dict[str, str]
    samples: int
    failed: int

    def by(self, level: str) -> dict[str, float]:
        """Variances of the errors, or summed over those of a part or stage, the largest first.

        Args:
            level: "field", "part" or "stage".
        """
        return by_level(level, self.variance, self.part)


def scalar_budget(study: Study, output: str, *, samples: int = 256, seed: int | None = None) -> ScalarBudget:
    """The error budget of a response by total effects: each error of a unit is sampled again.

    Args:
        study: design, conditions and tolerances.
        output: required response of the study.
        samples: units; each is solved twice, and once for every error.
        seed: by default that of the study.

    Raises:
        ValueError: fewer than 16 samples or more than 65536, or none of the units has a value.
    """
    if not FEWEST <= samples <= MOST:
        raise ValueError(f"samples = {samples}: must be at least {FEWEST} and at most {MOST}")
    population = Population.of(study.tolerances)
    (part,) = (one for one in parts(study.response(), population) if output in one.names)
    row = part.names.index(output)
    key = root_key(study.seed if seed is None else seed)

    def draw(first: int, *, count: int) -> np.ndarray:
        return np.asarray(drawn(population, key, jnp.uint32(first), count=count))

    batches, block = -(-samples // AT_ONCE) * (2 + len(population.active)), min(AT_ONCE, samples)
    seen: list[np.ndarray] = []
    with progress_bar(False, batches, "solving", "batch") as advance:

        def solve(z: np.ndarray) -> np.ndarray:
            values, status = part.solve(population, z)
            advance(1)
            values = np.where(np.isin(status, SUCCESS), values[row], np.nan)
            seen.append(values)
            return np.stack([np.zeros_like(values), np.sqrt(2) * values], axis=1)  # a wave with this mean square

        found = of_load(solve, draw, population, samples)
    count = len(population.active) + 2
    own = np.concatenate(seen[::count])[:samples]
    z = draw(0, count=block)
    weights = np.zeros((len(part.names), block))
    weights[row] = 1.0
    slopes = gradients(
        part.response, population, np.asarray(elements(population, jnp.asarray(z))), weights, part.names
    )[1]
    squares = population.by_field(np.nanmean(np.where(np.isfinite(slopes), slopes, np.nan) ** 2, axis=1))
    return ScalarBudget(
        output=output,
        mean=float(np.nanmean(own)),
        sd=float(np.sqrt(found.total[1])),
        variance={name: float(value[1]) for name, value in found.variance.items()},
        error=found.error,
        together=found.together,
        slope={name: float(np.sqrt(np.mean(value))) for name, value in squares.items()},
        part=parts_of(study, population),
        samples=samples,
        failed=found.failed,
    )


def report_on_scalar(budget: ScalarBudget, study: Study) -> Report:
    """The report on the budget of a response.

    Args:
        budget: the error budget.
        study: that it belongs to.
    """
    output = study.output(budget.output)
    unit, size = output.shown
    whole = sum(budget.variance.values())
    rows = []
    for level in LEVELS:
        for name, square in budget.by(level).items():
            row: list[object] = [name, budget.part[name] if level == "field" else level, np.sqrt(square) / size]
            share = 100 * square / whole if whole > 0 else 0.0
            row += [share, 100 * budget.error[name] / whole if level == "field" and whole > 0 else None]
            if level == "field":
                error_unit, error_size = readable(study.unit(name))
                row.append(f"{budget.slope[name] * error_size / size:.4g} {unit}/{error_unit}")
            rows.append([*row, *([""] if level != "field" else [])])
    together, error = (100 * part for part in budget.together)
    excluded = f"; {budget.failed} failed and are excluded" if budget.failed else ""
    head = [
        f"Study {study.name}",
        f"Error budget: {budget.output}, {output.meaning}",
        f"{budget.samples} units{excluded}: mean {budget.mean / size:.4g} {unit}, "
        f"standard deviation {budget.sd / size:.4g} {unit}; "
        f"at most {together:.2g} +- {error:.1g} % of its square are interactions, not included in linear shares",
        "slope: derivative to one element of the error, root mean square over elements and units",
    ]
    columns = [Text("owner"), Text("of"), Number(f"sd {unit}", form=".3g"), Number("share %", form=".1f")]
    columns += [Number("+-", missing="", form=".1f"), Text("slope")]
    return Report(
        title=f"{study.name}: error budget of {budget.output}",
        content=(Note("\n".join(head)), Table("shares", columns, rows)),
        data={"study": study.name, "seed": study.seed, "versions": versions(), "unit": output.unit} | vars(budget),
        files={"study.toml": study.text.encode()},
    )
