"""Cases that share no geometry, in one batch: units that full Newton steps leave, and designs of their own.

There a journal lies loose and barely touches, and contacts open and close in turns: found among 4096 units of the study
of a whole reducer at +-3 % of rated torque, all ended in MAX_STEPS before there was an interior point method. Oracle:
minima certified in 80-bit numbers, `tests.oracles.loaded`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_cases import NAMED, assert_same, at, errors_of, plain, solve, solve_many

from rvjax import Status, study
from rvjax.population.population import Population, root_key
from rvjax.tolerances import Tolerance
from rvjax.units import arcmin, um
from tests.oracles import loaded as oracle

QUESTION = study.load("rv-40e-whole", solve=False)
# As that study was when these units were found: more play, and bores of random direction.
DESIGN = QUESTION.design.replace(
    cycloid=QUESTION.design.cycloid.replace(equidistant_modification=2 * um),
    cranks=QUESTION.design.cranks.replace(bearing_stiffness=None),  # the loaded reducer reads neither
    bearings=None,
)
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

    @jax.jit
    def errors(numbers):
        return jax.vmap(population.errors, in_axes=1)(population.draw(root_key(0), numbers))

    return jax.device_get(errors(jnp.asarray(numbers, jnp.uint32))), QUARTER * quarters, LIGHT * signs


def in_full(errors):
    """Every error of a unit in its full shape."""

    def full(leaf, like):
        leaf = np.asarray(leaf, float)
        return np.broadcast_to(leaf.reshape(leaf.shape + (1,) * (np.ndim(like) - leaf.ndim)), np.shape(like))

    return jax.tree.map(full, errors, plain(errors_of({"errors": {}}, DESIGN)))


@pytest.mark.parametrize("law", ["hertz", pytest.param("linear", marks=pytest.mark.long)])
def test_loose_journals_are_found(law, thorough):
    """Tolerance: ten times what the rule to stop moves a result by at most, from the oracle's inverse Hessian.

    One by one: Newton's method ends in MAX_STEPS, and beyond the contact law; in the long profile next to each other,
    too."""
    errors, angles, torques = cases(law)
    lanes = len(angles)
    each = [(DESIGN, in_full(at(errors, n)), angles[n], torques[n]) for n in range(lanes)]
    alone = [solve(*case, **({} if law == "hertz" else dict(contact=law))) for case in each]
    found = jax.tree.map(lambda *leaves: np.stack(leaves), *alone)
    if law == "hertz" and thorough:
        np.testing.assert_allclose(solve_many(each).error, found.error, rtol=1e-8)
    assert np.all(found.info.status == Status.CONVERGED), found.info.status
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


@pytest.mark.long  # test_cycloidal_loaded.py has cases of their own geometry next to each other
def test_units_of_their_own_geometry_in_a_batch_are_their_cases():
    """Eccentricities of parts and designs, and crank circles, which no two units share."""
    random, lanes = np.random.default_rng(2), len(LOST["hertz"])
    case = NAMED["rv40: all errors, rated, hertz"]

    def made(share, radius):
        cycloid = DESIGN.cycloid.replace(eccentricity=DESIGN.cycloid.eccentricity * share)
        return plain(DESIGN.replace(cycloid=cycloid, cranks=DESIGN.cranks.replace(circle_radius=radius)))

    designs = [made(*pair) for pair in zip(random.uniform(0.96, 1.04, lanes), random.uniform(0.034, 0.038, lanes))]
    errors = [plain(errors_of(case, DESIGN, eccentricity=size)) for size in random.uniform(-6e-6, 6e-6, lanes)]
    angles, torques = random.uniform(0, 600, lanes), 412.0 * random.choice([-1, 1], lanes)
    found = solve_many(list(zip(designs, errors, angles, torques)))
    for n in range(lanes):
        assert_same(at(found, n), solve(designs[n], errors[n], angles[n], torques[n]), n)
