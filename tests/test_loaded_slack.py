"""Units that full Newton steps leave: a journal lies loose and barely touches, and contacts open and close in turns.

Found among 4096 units of the study of a whole reducer at +-3 % of rated torque; all ended in MAX_STEPS before there was
an interior point method. Oracle: minima certified in 80-bit numbers, `oracles.loaded`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from oracles import loaded as oracle
from rvjax import Status, loaded, study
from rvjax.tolerances import Tolerance
from rvjax.tolerances.population.population import Population, root_key
from rvjax.units import arcmin, um

QUESTION = study.load("rv-40e-whole", solve=False)
# As that study was when these units were found: more play, and bores of random direction.
DESIGN = QUESTION.design.replace(cycloid=QUESTION.design.cycloid.replace(equidistant_modification=2 * um))
BORE = dict(lower=0.0, upper=6.5 * um, distribution="rayleigh")
TOLERANCES = QUESTION.tolerances.replace(
    crank_phase=Tolerance.symmetric(2 * arcmin, shape=(2,)),
    disc_bore=Tolerance(**BORE, shape=(2, 2, 2)),
    carrier_bore=Tolerance(**BORE, shape=(2, 2)),
    bearing_clearance=Tolerance(0.0, 4 * um),
    pin_radius=None,
)
LIGHT = 0.03 * 412.0
QUARTER = 2 * np.pi * 105 / 40 / 4  # of the sun, a quarter of a crank turn: the angles of the bench
LOST = {  # unit, quarters, sign of the torque; unit 0 was never lost and stands beside them
    "hertz": ((612, 2, 1), (1131, 0, -1), (51, 1, 1), (3984, 1, 1), (3574, 1, -1), (3956, 3, 1), (0, 2, 1)),
    "linear": ((1585, 0, -1), (562, 3, 1), (786, 3, 1), (2491, 3, 1), (0, 2, 1)),
}


def cases(law):
    """Errors, input angles and torques of the units that were lost, units first."""
    numbers, quarters, signs = np.transpose(LOST[law])
    population = Population.of(TOLERANCES)
    z = population.draw(root_key(0), jnp.asarray(numbers, jnp.uint32))
    errors = jax.vmap(population.errors, in_axes=1)(z)
    return errors, jnp.asarray(QUARTER * quarters), jnp.asarray(LIGHT * signs)


@pytest.mark.parametrize("law", ["hertz", pytest.param("linear", marks=pytest.mark.long)])
def test_loose_journals_are_found(law):
    """Tolerance: ten times what the rule to stop moves a result by at most, from the oracle's inverse Hessian."""
    errors, angles, torques = cases(law)

    def solve(errors, angle, torque):
        return loaded.equilibrium(DESIGN, errors, input_angle=angle, output_torque=torque, contact=law)

    found = jax.tree.map(np.asarray, jax.jit(jax.vmap(solve))(errors, angles, torques))
    assert np.all(found.info.status == Status.CONVERGED), found.info.status
    lanes = len(angles)
    parts = {name: np.asarray(value) for name, value in vars(errors).items() if np.ndim(value)}
    due = oracle.equilibria(
        DESIGN, parts, lanes, input_angle=np.asarray(angles), output_torque=np.asarray(torques), contact=law
    )
    known = due["residual"] < 1e-14
    assert known.sum() >= lanes - 1
    off = np.abs(found.error - due["error"]) - 10 * due["error_allowed"]
    assert np.all(off[known] <= 1e-11 * np.abs(due["error"][known]))
    apart = np.abs(found.pins - due["pins"]).reshape(lanes, -1).max(1) - 10 * due["force_allowed"]
    assert np.all(apart[known] <= 1e-9 * due["largest"][known])
