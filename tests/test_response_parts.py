"""Parts of a response of costly units: statistics, numbers by name, slopes from the state that a unit was solved to.

Oracles: the whole response; closed forms of a root and its derivatives.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import tolerances
from rvjax.population import Population
from rvjax.records import Record, record, text
from rvjax.response import Part, elements, gradients, status_without_errors, unit_at_mid_points
from rvjax.roots import solved
from rvjax.status import Status
from rvjax.tolerances import Outcome, Requirement, Tolerance

WAVES = {
    "x": Tolerance.symmetric(1.0, shape=(6,)),
    "y": Tolerance.symmetric(1.0, shape=(6,)),
    "z": Tolerance.symmetric(1.0),
}


class Costly:
    """A response that says its units are costly."""

    costly = True

    def __init__(self, function):
        self.function = function

    def __call__(self, errors):
        return self.function(errors)

    def __eq__(self, other):
        return type(other) is type(self) and self.function is other.function  # so that each is compiled once

    def __hash__(self):
        return hash(self.function)


def population(factor):
    return Population.of({n: t.with_half_width(factor) for n, t in WAVES.items()})


def test_statistics_and_the_unit_without_errors_come_from_the_same_parts():
    """Two parts, of which the second fails in some units: the statistics of the whole, and its worst status."""

    def second(e):
        bad = jnp.abs(e["z"]) > 0.8
        return Outcome({"b": e["y"][0]}, jnp.where(bad, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED)))

    class Two(Costly):
        def parts(self):
            return [Costly(lambda e: {"a": e["x"][0]}), Costly(second)]

    two = Two(lambda e: Outcome({"a": e["x"][0], "b": e["y"][0]}, second(e).status))
    options = dict(samples=3000, chunk=1000, seed=3, requirements={"a": Requirement(upper=0.5)})
    found, whole = (tolerances.monte_carlo(of, WAVES, **options) for of in (two, two.function))
    assert found.failures == whole.failures and found.failed > 0 and found.yield_ == whole.yield_
    np.testing.assert_allclose(found.mean["b"].value, whole.mean["b"].value, rtol=1e-12)
    assert status_without_errors(two, population(1.0)) == int(Status.CONVERGED)
    broken = Costly(lambda e: Outcome({"b": e["z"]}, jnp.int32(int(Status.SINGULAR))))
    assert status_without_errors(broken, population(1.0)) == int(Status.SINGULAR)


def test_the_unit_at_the_mid_points():
    """Of quick and of costly units; a vector has its mid-point at 0."""
    limits = {
        "x": Tolerance(1.0, 3.0),
        "y": Tolerance(-3.0, 1.0, shape=(2,)),
        "z": Tolerance(0.0, 2.0, distribution="rayleigh", shape=(2,)),
    }
    function = lambda e: {"sum": e["x"] + 10 * e["y"][1], "far": 100 + e["z"][0] + e["z"][1]}  # noqa: E731
    for response in (function, Costly(function)):
        assert unit_at_mid_points(response, Population.of(limits)) == ({"sum": -8.0, "far": 100.0}, 0)


@record
class Listed(Record):
    """A costly response that lists its outputs, with a curve of twelve numbers."""

    costly: ClassVar[bool] = True
    outputs: tuple[str, ...] = text("names of the values", default=("peak",))

    def __call__(self, errors):
        return Outcome({"peak": errors["z"]}, jnp.int32(0), curve=jnp.arange(12.0) * errors["x"][0])


def test_a_curve_stands_beside_the_outputs():
    z = np.random.default_rng(0).normal(size=(13, 5))
    part = Part(Listed(), population(1.0))
    assert part.names == ("peak",) and part.solve(population(3.0), z)[0].shape == (1, 5)
    np.testing.assert_allclose(part.curves(population(3.0), z), np.outer(z[0], np.arange(12)))


@jax.custom_jvp
def _at_root(a, root):
    """The root, with the derivative of x^2 = a."""
    return root


@_at_root.defjvp
def _(primals, tangents):
    return primals[1], tangents[0] / (2 * primals[1])


def rooted(e):
    """A root by iteration, which is marked as solved with its square, and a value that the square scales."""
    a = 2 + e["x"][0] * e["y"][1]
    newton = lambda state: (state[0] - (state[0] ** 2 - a) / (2 * state[0]), state[1] + 1)  # noqa: E731
    found = jax.lax.while_loop(lambda state: state[1] < 20, newton, (jnp.ones(()), jnp.int32(0)))[0]
    root, square = solved(jax.lax.stop_gradient((found, found**2)))
    return {"root": _at_root(a, root), "product": jnp.sin(e["x"][1]) * e["z"] * square}


def test_slopes_of_solved_units_come_from_their_state():
    """They are those of the whole function; at another state they are those of that state: nothing is solved again."""
    part, z = Part(Costly(rooted), population(1.0)), np.random.default_rng(0).normal(size=(13, 300))
    values, status, state = part.solve(population(1.2), z)
    own = np.asarray(elements(population(1.2), jnp.asarray(z)))
    errors = {"x": own[:6], "y": own[6:12], "z": own[12]}
    a = 2 + errors["x"][0] * errors["y"][1]
    assert not status.any() and part.names == ("product", "root")
    np.testing.assert_allclose(values[1], np.sqrt(a), rtol=1e-12)
    weights = np.random.default_rng(1).normal(size=(2, 300))
    due = np.zeros((13, 300))
    due[0], due[7] = (weights[1] * errors[n][k] / (2 * np.sqrt(a)) for n, k in (("y", 1), ("x", 0)))
    scaled = weights[0] * a
    due[1], due[12] = scaled * np.cos(errors["x"][1]) * errors["z"], scaled * np.sin(errors["x"][1])
    np.testing.assert_allclose(part.slopes_of_elements(population(1.2), own, state, weights), due, atol=1e-12)
    found, _, slopes = gradients(
        part.response, population(1.2), np.repeat(own, 2, axis=1), np.repeat(weights, 2, axis=1)
    )
    np.testing.assert_allclose(found[:, ::2], values, rtol=1e-15)
    np.testing.assert_allclose(slopes[:, 1::2], due, atol=1e-12)
    doubled = np.where(np.isclose(state, np.sqrt(a), rtol=1e-9), 2 * state, state)
    assert (doubled != state).sum() == 300
    due[0], due[7] = due[0] / 2, due[7] / 2
    np.testing.assert_allclose(part.slopes_of_elements(population(1.2), own, doubled, weights), due, atol=1e-12)
