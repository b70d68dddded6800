"""A whole reducer: derivatives, statuses, what is refused.

Oracles: finite differences; one-sided limits and slopes in closed form; statuses by their definition.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from four_bar_reducers import READ, cast, changed, disc_couple, drawn, reducer, transmission_error

from rvjax import CrankStage, RVErrors, Status, catalogue, four_bar
from rvjax.units import mm, um


def test_torque_through_zero():
    """Without load clearance has no direction: a jump whose one-sided limits are opposite."""
    design, errors = catalogue.RV_40E, RVErrors(bearing_clearance=5 * um)

    def plain(torque, clearance):
        return transmission_error(
            design, errors.replace(bearing_clearance=clearance), crank_angle=np.pi / 2, output_torque=torque
        ).error

    both = jax.jit(jax.value_and_grad(plain, argnums=(0, 1)))

    def error(torque, clearance):
        return both(torque, clearance)[0]

    value, slopes = both(0.0, 5 * um)
    assert value == 0
    assert slopes[1] == 0
    np.testing.assert_allclose(slopes[0], -2 * disc_couple(design, 1.0) / (6e8 * (72 * mm) ** 2), rtol=1e-9)
    np.testing.assert_allclose(error(1e-9, 5 * um), -error(-1e-9, 5 * um), rtol=1e-2)
    assert abs(error(1e-9, 5 * um)) > 1e-4
    clearance_slope = both(412.0, 5 * um)[1][1]
    difference = (error(412.0, 6 * um) - error(412.0, 4 * um)) / (2 * um)
    np.testing.assert_allclose(clearance_slope, difference, rtol=1e-5)


def turn(design, errors):
    """Six figures of a loaded turn, and its status."""
    result = four_bar.revolution(design, errors, output_torque=412.0)
    parts = [result.maximum, result.minimum, result.largest_misfit, result.mean, result.error[5]]
    return jnp.stack([*parts, result.peak_to_peak]), result.info.status


def stand(design, errors):
    """Figures at one crank angle under load, and its status."""
    result = transmission_error(design, errors, crank_angle=0.8, output_torque=412.0)
    return jnp.concatenate([result.error[None], result.per_disc, result.misfit]), result.info.status


@functools.cache
def batches(figures):
    """Figures of a batch of units, and the derivatives of a weighted sum of them, compiled once."""
    plain = jax.vmap(figures, in_axes=(None, -1))

    def total(design, units, weights):
        values, status = plain(design, units)
        return jnp.sum(weights * jnp.where((status == 0)[:, None], values, 0)), (values, status)

    return jax.jit(plain), jax.jit(jax.grad(total, argnums=(0, 1), has_aux=True))


@pytest.mark.long  # test_derivatives.py has every output of studies by default
def test_derivatives_equal_differences():
    """Reverse mode, which is forward mode transposed, for random sums of figures along random directions."""
    design, rng = catalogue.RV_40E, np.random.default_rng(1)
    plain, gradient = batches(turn)
    units, weights = drawn(design, 9, units=6), rng.normal(size=(6, 6))
    (_, by_error), (values, status) = gradient(design, units, weights)
    assert set(np.asarray(status)) == {0}
    np.testing.assert_allclose(values, plain(design, units)[0], rtol=1e-12)
    blank = jax.tree.map(jnp.zeros_like, units)
    for name in RVErrors.__dataclass_fields__:
        found = np.asarray(getattr(by_error, name))
        if name not in READ:
            assert np.all(found == 0)
            continue
        direction = changed(blank, **{name: rng.normal(size=found.shape)})
        ends = [jax.tree.map(lambda x, d, s=s: x + s * 1e-9 * d, units, direction) for s in (1, -1)]
        above, below = (np.asarray(plain(design, end)[0]) for end in ends)
        expected = np.sum(weights * (above - below), axis=1) / 2e-9  # of each unit
        slope = np.sum((found * getattr(direction, name)).reshape(-1, 6), axis=0)
        np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-5 * np.abs(weights).max())


@pytest.mark.parametrize("cranks", [2, pytest.param(3, marks=pytest.mark.long)])
def test_zero_errors_are_exactly_zero_with_finite_derivatives(cranks):
    """At every crank angle; a random weight on each makes one lost derivative spoil the sum."""
    design, angles = reducer(cranks), np.linspace(0, 2 * np.pi, 25)

    def figures(errors, design=design, angles=angles):
        def one(angle):
            result = four_bar.transmission_error(design, errors, crank_angle=angle, closure="closed_form")
            return jnp.concatenate([result.per_disc, result.misfit])

        return jax.vmap(one)(jnp.asarray(angles))

    @jax.jit
    def pulled(errors, weights, figures=figures):
        value, pull = jax.vjp(figures, errors)
        return value, pull(weights)[0]

    zero = cast(RVErrors.for_design(design), np.float64)
    value, gradient = pulled(zero, np.random.default_rng(0).normal(size=(25, 4)))
    assert np.all(np.asarray(value) == 0)
    for leaf in jax.tree.leaves(gradient):
        assert np.all(np.isfinite(leaf))


@pytest.mark.long  # those of one linkage run by default, test_four_bar_derivatives.py
def test_second_derivatives_of_a_curve():
    design, errors = catalogue.RV_40E, drawn(catalogue.RV_40E, 10)

    def error(delta):
        return transmission_error(
            design, errors.replace(crank_eccentricity=delta), crank_angle=0.8, output_torque=412.0
        ).error

    delta = errors.crank_eccentricity
    second = np.asarray(jax.jit(jax.hessian(error))(delta)).reshape(4, 4)
    first = jax.jit(jax.grad(error))
    for j in range(4):
        step = 1e-7 * np.eye(4)[j].reshape(2, 2)
        difference = np.ravel((first(delta + step) - first(delta - step)) / 2e-7)
        np.testing.assert_allclose(second[j], difference, rtol=1e-5, atol=1e-2)


@pytest.mark.parametrize("figures", [stand, pytest.param(turn, marks=pytest.mark.long)])
def test_lost_units_leave_their_neighbours_alone(figures):
    design = catalogue.RV_40E
    units = drawn(design, 11, units=6)

    weights = np.repeat([1.0, 0.0], 3)[:, None]
    _, gradient = batches(figures)
    (shared, each), (values, status) = gradient(design, units, weights)
    assert set(np.asarray(status)) == {0}
    carrier = np.array(units.carrier_bore)
    carrier[0, 0, 3] = -80 * mm  # the carrier bores change places
    phase = np.array(units.crank_phase)
    phase[1, 4] = np.nan
    clearance = np.array(units.bearing_clearance)
    clearance[5] = np.inf
    lost = changed(units, carrier_bore=carrier, crank_phase=phase, bearing_clearance=clearance)
    (lost_shared, lost_each), (lost_values, lost_status) = gradient(design, lost, weights)
    assert [Status(int(s)).name for s in lost_status[3:]] == ["INVALID_GEOMETRY", "NONFINITE", "NONFINITE"]
    assert np.all(np.isnan(lost_values[3:]))
    assert np.array_equal(lost_values[:3], values[:3])
    for first, second in zip(jax.tree.leaves(shared), jax.tree.leaves(lost_shared)):
        np.testing.assert_allclose(second, first, rtol=1e-12)
    for first, second in zip(jax.tree.leaves(each), jax.tree.leaves(lost_each)):
        assert np.array_equal(second[..., :3], first[..., :3])
        assert np.all(np.asarray(second)[..., 3:] == 0)


def test_statuses():
    def status(design=catalogue.RV_40E, errors=None, **arguments):
        arguments = dict(crank_angle=1.0, output_torque=1.0) | arguments
        errors = RVErrors.for_design(catalogue.RV_40E, **errors or {})  # one shape, one program
        result = four_bar.transmission_error(design, errors, **arguments)
        assert np.isnan(result.error) == (int(result.info.status) not in (Status.CONVERGED, Status.CHANGE_POINT))
        return Status(int(result.info.status)).name

    assert status() == "CONVERGED"
    assert status(crank_angle=np.nan) == "NONFINITE"
    assert status(output_torque=np.inf) == "NONFINITE"
    assert status(errors=dict(eccentricity=np.nan)) == "NONFINITE"
    assert status(errors=dict(pin_radius=np.nan)) == "CONVERGED"  # not read by this model
    assert status(catalogue.RV_40E.replace(cranks=CrankStage(2, np.nan, 6e8))) == "NONFINITE"
    assert status(crank_angle=0.0, cranks="free", output_torque=0.0) == "CHANGE_POINT"
    assert (
        status(errors=dict(disc_bore=np.full((2, 2, 2), 1 * mm)), cranks="free", output_torque=0.0) == "NOT_ASSEMBLABLE"
    )
    steep = jax.tree.map(lambda leaf: leaf, catalogue.RV_40E)
    object.__setattr__(steep.cycloid, "shortening", 1.0)  # a batch is not checked
    assert status(steep) == "INVALID_GEOMETRY"


def test_impossible_arguments():
    for arguments, message in (
        (dict(closure="quadratic"), "closure"),
        (dict(branch="crossed"), "branch"),
        (dict(cranks="geared"), "gear_stiffness_ratio"),
    ):
        for function in (lambda **a: four_bar.transmission_error(**a, crank_angle=1.0), four_bar.revolution):
            with pytest.raises(ValueError, match=message):
                function(design=catalogue.RV_40E, errors=RVErrors(), **arguments)
    with pytest.raises(ValueError, match="3 cranks"):
        four_bar.transmission_error(reducer(3), RVErrors(), crank_angle=1.0, cranks="free")
    with pytest.raises(ValueError, match=r"RVErrors\.crank_phase"):
        four_bar.transmission_error(catalogue.RV_40E, RVErrors(crank_phase=np.zeros(3)), crank_angle=1.0)
    soft = reducer(stiffness=None)
    four_bar.transmission_error(soft, RVErrors(), crank_angle=1.0)
    for torque in (412.0, np.float64(1.0)):
        with pytest.raises(ValueError, match="bearing_stiffness"):
            four_bar.transmission_error(soft, RVErrors(), crank_angle=1.0, output_torque=torque)
    with pytest.raises(ValueError, match="bearing_stiffness"):
        jax.jit(lambda t: four_bar.revolution(soft, RVErrors(), output_torque=t))(0.0)
