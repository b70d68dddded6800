"""Arguments of an allocation that chooses more than half-widths, and what follows from them."""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from rvjax._jax.blocks import PULLED
from rvjax.population import Estimate, Population, deviate_of
from rvjax.response import Response, is_costly
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.batch.monte_carlo import Run
from rvjax.tolerances.loss import QuadraticLoss
from rvjax.tolerances.optimum.conlin import total_cost
from rvjax.tolerances.optimum.cost import Cost
from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.followed import followable
from rvjax.tolerances.optimum.margins import Margins
from rvjax.tolerances.optimum.nominal import NominalOutputs
from rvjax.tolerances.optimum.variable import Middle, Variable
from rvjax.tolerances.requirements.factors import CUSHION
from rvjax.tolerances.requirements.limits import Limits

_COSTLY = 2  # times fewer units where they are costly


@dataclasses.dataclass(frozen=True)
class Problem:
    """Arguments of `allocate`, checked.

    Attributes:
        response: of the errors of one unit, and of the values of `variables` if there are any.
        population: of the units, at the start.
        requirements: by name of the response.
        priced: costs by field.
        middles: by field.
        variables: by name.
        objective: {output: price per unit}.
        losses: {output: its loss, of which the mean counts}.
        joint_target: share of units that meet all limits, or None.
        samples: units to learn from, at most.
        seed: of these.
        max_steps: vectors of decisions tried by a search, at most.
        run: of the certificates.
        memo: of long computations.
        advance: of a progress bar.
    """

    response: Response
    population: Population
    requirements: dict[str, Limits]
    priced: dict[str, Cost]
    middles: Mapping[str, Middle]
    variables: Mapping[str, Variable]
    objective: Mapping[str, float]
    losses: Mapping[str, QuadraticLoss]
    joint_target: float | None
    samples: int
    seed: int
    max_steps: int
    run: Run
    memo: Memo | None
    advance: Callable[[int], object]

    @property
    def costly(self) -> bool:
        """True if units are."""
        return is_costly(self.response)

    def decisions(self) -> Decisions:
        """Vector of decisions."""
        return Decisions(self.population, self.priced, self.middles, self.variables)

    def of_widths(self, decisions: Decisions) -> bool:
        """True if its units are costly, its limits are on shares and half-widths are its only decisions."""
        alone = decisions.size == len(decisions.fields) and not self.objective
        return alone and not self.losses and followable(self.response, self.requirements)

    def start_cost(self, decisions: Decisions) -> float:
        """Cost of the given tolerances, mid-points and numbers, with the objective."""
        given = decisions.vector(self.given, {name: item.first for name, item in self.variables.items()})
        outputs, _ = NominalOutputs(self.response, tuple(sorted(self.objective))).at(decisions.population(given))
        widths = float(total_cost(tuple(self.priced.values()), np.asarray(self.given))) if self.priced else 0.0
        rest = decisions.cost(given) - decisions.widths_cost(given)
        return widths + rest + sum(price * outputs[name] for name, price in self.objective.items())

    @staticmethod
    def whole_of(cost: float, losses: Mapping[str, Estimate]) -> Estimate:
        """Cost with mean losses; their intervals add up."""
        items = losses.values()
        sums = (sum(getattr(item, key) for item in items) for key in ("value", "error", "lower", "upper"))
        value, error, lower, upper = sums
        return Estimate(cost + value, error, cost + lower, cost + upper)

    @property
    def given(self) -> np.ndarray:
        """Half-widths (j,) of the given tolerances that have a cost."""
        return np.array([float(self.population.active[name].half_width) for name in self.priced])

    def start(self, decisions: Decisions) -> np.ndarray:
        """Start of the vector of decisions."""
        return decisions.vector(self.given, {name: item.first for name, item in self.variables.items()})

    def margins(self, decisions: Decisions, most: int, *, aimed: bool = True, sloped: int = PULLED) -> Margins:
        """Constraints on a sample of at most so many units, with targets that a certificate should confirm.

        Of followed units `sloped` of each response have gradients.
        """
        count = min(self.samples, most // _COSTLY if self.costly else most)
        limited = self._aimed() if aimed else self.requirements
        return Margins(
            self.response, decisions, limited, dict(self.objective), self.joint_target, count, self.seed, self.memo,
            self.losses, PULLED if self.costly else self.samples, sloped,
        )  # fmt: skip

    def _aimed(self) -> dict[str, Limits]:
        """Requirements with targets beyond what a certificate may see by chance."""
        n, confidence = self.run.samples, self.run.confidence
        z = deviate_of(confidence) + CUSHION
        return {name: item.aimed_beyond(n, z, confidence) for name, item in self.requirements.items()}
