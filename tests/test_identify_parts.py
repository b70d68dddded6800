"""Identification by parts of a model: their mean is the observation, the first one leads, all of them decide."""

import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import identify
from rvjax.identify.gauss_newton import damped_step
from rvjax.identify.search import phi_about, phi_at
from rvjax.loaded import outputs
from rvjax.loaded.cases import MACHINE
from rvjax.loaded.observation import CURVE
from rvjax.records import Array, Record, field, record
from tests.identify_models import Noise, unit

PRIOR = {"a": unit(3.0), "b": unit(3.0)}


@record
class Halves(Record):
    """A bent curve of two errors; each part is off to its own side by `apart` times one of them."""

    apart: Array = field("-", "of the parts from their mean")
    side: Array = field("-", "of a part; 0 for all of them", default=0.0)

    def __call__(self, values):
        a, b = values["a"], values["b"]
        mean = jnp.stack([2 * a + 0.2 * a**2, a + b, 0.5 * b - 0.1 * a * b])
        return mean + self.side * self.apart * jnp.stack([b, a * b, a])

    def split(self):
        return self, [{"side": 1.0}, {"side": -1.0}]


def whole(values):
    return Halves(0.0)(values)


@pytest.mark.parametrize("apart", [0.02, 0.6])
def test_all_parts_decide(apart):
    """As the model without parts, which other programs evaluate: the same mode, weights and shares to rounding of the
    steps (1e-9 standard deviations); draws of Laplace's method by one part as far as it is like the rest."""
    data = np.array([1.5, 0.4, -0.3])
    due = identify.solve(whole, PRIOR, data, noise=Noise(0.3), starts=4, draws=256)
    found = identify.solve(Halves(apart), PRIOR, data, noise=Noise(0.3), starts=4, draws=256)
    np.testing.assert_allclose(found.u, due.u, atol=1e-8)
    np.testing.assert_allclose(found.u_covariance, due.u_covariance, atol=1e-8)
    assert found.evidence == pytest.approx(due.evidence, abs=1e-8) and found.status == due.status
    assert found.shares["all"] == pytest.approx(due.shares["all"], abs=1e-7)
    assert found.laplace.ess == pytest.approx(due.laplace.ess, rel=0.05)


def test_a_part_corrected_about_the_mode():
    """The linear part of what others add is exact: 0.01 from the mode the error is of second order in that distance."""
    data = np.array([1.5, 0.4, -0.3])
    found = identify.solve(Halves(0.3), PRIOR, data, noise=Noise(0.3), starts=1, draws=64)
    points = found.peaks[0].z + 0.01 * np.random.default_rng(0).standard_normal((20, 2))
    phi, error = phi_about(found.problem, data, points, found.peaks[0], 64)
    exact = phi_at(found.problem, data, points, 64)
    np.testing.assert_allclose(phi, exact, atol=2e-4)
    assert 0 < error <= np.abs(phi - exact).max()


def test_a_saddle_of_all_parts_is_left():
    """x^2 has a saddle at its middle; the first part leads there too."""

    @record
    class Square(Record):
        side: Array = field("-", "of a part", default=0.0)

        def __call__(self, values):
            return jnp.stack([(1 + 0.05 * self.side) * values["x"] ** 2])

        def split(self):
            return self, [{"side": 1.0}, {"side": -1.0}]

    found = identify.solve(Square(), {"x": unit(3.0)}, np.array([1.0]), noise=Noise(0.3), starts=1, draws=64)
    assert found.status == "MULTIMODAL" and len(found.modes) == 2
    assert sorted(mode.value["x"] for mode in found.modes) == pytest.approx([-0.97, 0.97], abs=0.02)


def test_a_step_with_fewer_data_than_numbers():
    """The normal equations, (I + J'J + mu I) step = -(z + J'r), and its length sqrt(-g'step)."""
    rng = np.random.default_rng(0)
    z, residual, slopes = (rng.standard_normal(shape) for shape in ((2, 9), (2, 3), (2, 3, 9)))
    damping = np.array([0.0, 0.7])
    step, length = damped_step(z, residual, slopes, damping)
    gradient = z + np.einsum("kmn,km->kn", slopes, residual)
    square = (1 + damping)[:, None, None] * np.eye(9) + np.swapaxes(slopes, 1, 2) @ slopes
    due = -np.linalg.solve(square, gradient[..., None])[..., 0]
    np.testing.assert_allclose(step, due, rtol=1e-10)
    np.testing.assert_allclose(length, np.sqrt(-(gradient * due).sum(axis=1)), rtol=1e-10)


def test_a_gain_on_top_of_another_measurement():
    """ln det of both less that of the one that is measured in any case."""
    slopes = {"before": (2.0, 1.0), "next": (1.0, -1.0)}
    models = {name: lambda v, g=g: jnp.stack([g[0] * v["a"] + g[1] * v["b"]]) for name, g in slopes.items()}
    found = identify.rank_measurements(PRIOR, models, noise=Noise(0.5), already="before")
    rows = np.array(list(slopes.values())) / 0.5
    nats = [np.linalg.slogdet(np.eye(2) + g.T @ g)[1] / 2 for g in (rows, rows[:1])]
    assert found.gains == pytest.approx({"next": nats[0] - nats[1]}, rel=1e-10)
    with pytest.raises(ValueError, match="already = 'other'"):
        identify.rank_measurements(PRIOR, models, noise=Noise(0.5), already="other")


def test_parts_of_a_turn_take_no_order_of_the_pins_for_another():
    """40 pins: a fifth of 320 angles takes orders for others that are 8 or more away from multiples of 40; of 328
    angles no part of at most five does."""
    given = outputs.LoadedConditions(samples=24)
    assert CURVE.parts(MACHINE, given, (40, 80), False) == 5
    assert CURVE.parts(MACHINE, given, (40, 80), True) == 1
    assert CURVE.parts(MACHINE, given, (82,), False) == 1
