"""A whole reducer: derivatives, statuses, what is refused.

Oracles: finite differences; one-sided limits and slopes in closed form; statuses by their definition.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from four_bar_reducers import READ, changed, disc_couple, drawn, numbers, reducer, transmission_error

from rvjax import CrankStage, RVErrors, Status, catalogue, four_bar
from rvjax.units import mm, um


def turn(design, errors, torque, angle):
    """Six figures of a loaded turn, and its status."""
    result = four_bar.revolution(design, errors, output_torque=torque)
    parts = [result.maximum, result.minimum, result.largest_misfit, result.mean, result.error[5]]
    return jnp.stack([*parts, result.peak_to_peak]), result.info.status


def stand(design, errors, torque, angle):
    """Figures at one crank angle under load, and its status; test_four_bar_derivatives.py has Newton's root."""
    given = dict(crank_angle=angle, output_torque=torque, closure="closed_form")
    result = four_bar.transmission_error(design, errors, **given)
    return jnp.concatenate([result.error[None], result.per_disc, result.misfit]), result.info.status


LANES = 6


@functools.cache
def batches(figures):
    """Figures of a batch of units, and the derivatives of a weighted sum of them, compiled once."""
    plain = jax.vmap(figures, in_axes=(None, -1, 0, 0))

    def total(design, units, torque, angle, weights):
        values, status = plain(design, units, torque, angle)
        return jnp.sum(weights * jnp.where((status == 0)[:, None], values, 0)), (values, status)

    return jax.jit(plain), jax.jit(jax.grad(total, argnums=(0, 1, 2), has_aux=True))


def slopes(units, weights, torque=412.0, angle=0.8, figures=stand):
    """Derivatives of a batch of RV-40E to design, units and torque, with the figures and their statuses."""
    torque, angle = (np.broadcast_to(np.asarray(x, float), LANES) for x in (torque, angle))
    return jax.tree.map(np.asarray, batches(figures)[1](numbers(reducer()), units, torque, angle, weights))


def test_torque_through_zero():
    """Without load clearance has no direction: a jump whose one-sided limits are opposite."""
    design = reducer()
    torque, clearance = [0.0, 1e-9, -1e-9, 412.0, 412.0, 412.0], np.array([5, 5, 5, 5, 6, 4]) * um
    units = changed(
        drawn(design, 0, size=0.0, units=LANES), bearing_clearance=clearance, crank_phase=np.zeros((2, LANES))
    )
    (_, by_error, by_torque), (values, _) = slopes(units, np.eye(5)[[0] * LANES], torque, np.pi / 2)
    error, by_clearance = values[:, 0], by_error.bearing_clearance
    assert error[0] == 0
    assert by_clearance[0] == 0
    np.testing.assert_allclose(by_torque[0], -2 * disc_couple(design, 1.0) / (6e8 * (72 * mm) ** 2), rtol=1e-9)
    np.testing.assert_allclose(error[1], -error[2], rtol=1e-2)
    assert abs(error[1]) > 1e-4
    np.testing.assert_allclose(by_clearance[3], (error[4] - error[5]) / (2 * um), rtol=1e-5)


@pytest.mark.long  # test_derivatives.py has every output of studies by default
def test_derivatives_equal_differences():
    """Reverse mode, which is forward mode transposed, for random sums of figures along random directions."""
    design, rng = reducer(), np.random.default_rng(1)
    units, weights = drawn(design, 9, units=LANES), rng.normal(size=(LANES, 6))
    (_, by_error, _), (values, status) = slopes(units, weights, figures=turn)
    plain = functools.partial(batches(turn)[0], numbers(design))
    load, angle = np.full(LANES, 412.0), np.full(LANES, 0.8)
    assert set(status) == {0}
    np.testing.assert_allclose(values, plain(units, load, angle)[0], rtol=1e-12)
    blank = jax.tree.map(jnp.zeros_like, units)
    for name in (f.name for f in dataclasses.fields(RVErrors)):
        found = np.asarray(getattr(by_error, name))
        if name not in READ:
            assert np.all(found == 0)
            continue
        direction = changed(blank, **{name: rng.normal(size=found.shape)})
        ends = [jax.tree.map(lambda x, d, s=s: x + s * 1e-9 * d, units, direction) for s in (1, -1)]
        above, below = (np.asarray(plain(end, load, angle)[0]) for end in ends)
        expected = np.sum(weights * (above - below), axis=1) / 2e-9  # of each unit
        slope = np.sum((found * getattr(direction, name)).reshape(-1, 6), axis=0)
        np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-5 * np.abs(weights).max())


def test_zero_errors_are_exactly_zero_with_finite_derivatives():
    """At every crank angle; a random weight on each makes one lost derivative spoil the sum."""
    units = jax.tree.map(np.zeros_like, drawn(reducer(), 0, units=LANES))
    for angles in np.linspace(0, 2 * np.pi, 4 * LANES + 1)[:-1].reshape(-1, LANES):
        found, (values, _) = slopes(units, np.random.default_rng(0).normal(size=(LANES, 5)), 0.0, angles)
        assert np.all(values == 0)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(found))


@pytest.mark.long  # a further number of cranks, without load
@pytest.mark.parametrize("cranks", [2, 3])
def test_zero_errors_of_unloaded_reducers(cranks):
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

    value, gradient = pulled(numbers(RVErrors.for_design(design)), np.random.default_rng(0).normal(size=(25, 4)))
    assert np.all(np.asarray(value) == 0)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))


@pytest.mark.long  # those of one linkage run by default, test_four_bar_derivatives.py
def test_second_derivatives_of_a_curve():
    design, errors = reducer(), drawn(reducer(), 10)

    def error(delta):
        moved = errors.replace(crank_eccentricity=delta)
        return four_bar.transmission_error(design, moved, crank_angle=0.8, output_torque=412.0).error

    delta = errors.crank_eccentricity
    second = np.asarray(jax.jit(jax.hessian(error))(delta)).reshape(4, 4)
    first = jax.jit(jax.grad(error))
    for j in range(4):
        step = 1e-7 * np.eye(4)[j].reshape(2, 2)
        difference = np.ravel((first(delta + step) - first(delta - step)) / 2e-7)
        np.testing.assert_allclose(second[j], difference, rtol=1e-5, atol=1e-2)


@pytest.mark.parametrize("figures", [stand, pytest.param(turn, marks=pytest.mark.long)])
def test_lost_units_leave_their_neighbours_alone(figures):
    units, weights = drawn(reducer(), 11, units=LANES), np.repeat([1.0, 0.0], 3)[:, None]
    weights = weights * np.ones(5 if figures is stand else 6)
    (shared, each, _), (values, status) = slopes(units, weights, figures=figures)
    assert set(status) == {0}
    carrier = np.array(units.carrier_bore)
    carrier[0, 0, 3] = -80 * mm  # the carrier bores change places
    phase = np.array(units.crank_phase)
    phase[1, 4] = np.nan
    clearance = np.array(units.bearing_clearance)
    clearance[5] = np.inf
    lost = changed(units, carrier_bore=carrier, crank_phase=phase, bearing_clearance=clearance)
    (lost_shared, lost_each, _), (lost_values, lost_status) = slopes(lost, weights, figures=figures)
    assert [Status(int(s)).name for s in lost_status[3:]] == ["INVALID_GEOMETRY", "NONFINITE", "NONFINITE"]
    assert np.all(np.isnan(lost_values[3:]))
    assert np.array_equal(lost_values[:3], values[:3])
    for first, second in zip(jax.tree.leaves(shared), jax.tree.leaves(lost_shared)):
        np.testing.assert_allclose(second, first, rtol=1e-12)
    for first, second in zip(jax.tree.leaves(each), jax.tree.leaves(lost_each)):
        assert np.array_equal(second[..., :3], first[..., :3])
        assert np.all(np.asarray(second)[..., 3:] == 0)


def test_statuses():
    plain = reducer()

    def status(design=plain, errors=None, angle=1.0, **arguments):
        errors = RVErrors.for_design(plain, **errors or {})
        arguments = dict(output_torque=1.0) | arguments
        result = transmission_error(design, errors, crank_angle=angle, branch="open", **arguments)
        assert np.isnan(result.error) == (int(result.info.status) not in (Status.CONVERGED, Status.CHANGE_POINT))
        return Status(int(result.info.status)).name

    locked = dict(cranks="phase_locked", closure="newton")
    assert status(**locked) == "CONVERGED"
    assert status(angle=np.nan, **locked) == "NONFINITE"
    assert status(output_torque=np.inf, **locked) == "NONFINITE"
    assert status(errors=dict(eccentricity=np.nan), **locked) == "NONFINITE"
    assert status(errors=dict(pin_radius=np.nan), **locked) == "CONVERGED"  # not read by this model
    assert status(plain.replace(cranks=CrankStage(2, np.nan, 6e8)), **locked) == "NONFINITE"
    steep = jax.tree.map(lambda leaf: leaf, plain)
    object.__setattr__(steep.cycloid, "eccentricity", 64 * mm / 40)  # K1 = 1: a batch is not checked
    assert status(steep, **locked) == "INVALID_GEOMETRY"
    plain = reducer(2, 1, teeth=(14, 42, 29, 30))  # of the reference, so that one program serves
    free = dict(cranks="free", closure="closed_form", output_torque=0.0)
    assert status(plain, angle=0.0, **free) == "CHANGE_POINT"
    assert status(plain, errors=dict(disc_bore=np.full((1, 2, 2), 1 * mm)), **free) == "NOT_ASSEMBLABLE"


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
