"""Numbers behind the sliders of the page: the surrogate beside the responses themselves, by fresh units."""

import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from live_study import FEW

import rvjax
from rvjax import tolerances
from rvjax.commands.forecast import OF_COSTLY, SHOWN_VALUES
from rvjax.commands.report import region, response_surface, sliders
from rvjax.response import derivatives
from rvjax.response.response import BLOCK

UNITS = 2 * BLOCK


def made(response, upper, **others):
    """What `surrogate` reads of an answer, for a response that knows no gear."""
    required = {name: tolerances.Requirement(upper=limit) for name, limit in ({"y": upper} | others).items()}
    options = dict(requirements=required, chunk=BLOCK)
    certificate = tolerances.monte_carlo(response, FIELDS, samples=4 * BLOCK, seed=1, **options)
    kept = tolerances.monte_carlo(response, FIELDS, samples=UNITS, seed=2, keep=True, **options)
    names = ["eccentricity", "pin_radius", "carrier_bore"]
    return SimpleNamespace(
        study=SimpleNamespace(
            requirements=required,
            units=response,
            fields=names,
            tolerances=FIELDS,
            seed=0,
            middles={},
            forms={},
        ),
        after=SimpleNamespace(tolerances=FIELDS, values=kept.values, seed=2),
        allocation=SimpleNamespace(certificate=certificate),
        certificate_before=certificate,
    )


FIELDS = tolerances.for_design(
    rvjax.catalogue.RV_40E,
    eccentricity=tolerances.Tolerance.symmetric(4e-6, distribution="uniform"),
    pin_radius=tolerances.Tolerance(-1e-6, 3e-6),
    carrier_bore=tolerances.Tolerance.symmetric(3e-6),
)
X = np.array([0.9, -0.7, 0.3, 1.0, -1.0, 0.5])


def linear(errors):
    return {"y": 3 * errors.pin_radius + 2 * errors.eccentricity + jnp.sum(errors.carrier_bore)}


def bent(errors):
    x, y, z = 1e6 * errors.pin_radius, 1e6 * errors.eccentricity, 1e6 * errors.carrier_bore[0, 0]
    return {"y": x + y + z + 0.2 * x * y + 0.1 * z * z - 0.1 * y * z}


@pytest.fixture(scope="module")
def of_linear():
    question = made(linear, 14e-6)
    return question, response_surface.surrogate(question, **FEW)


def direct(found, response):
    """Responses of the surrogate's own units at X, computed; the units are found again by their values."""
    moved = {}
    for p, step in zip(found.parameters, X):
        t = moved.get(p.field, getattr(FIELDS, p.field))
        way = step * p.reach
        if p.place:
            moved[p.field] = t.replace(lower=t.lower + way, upper=t.upper + way)
        else:
            moved[p.field] = t.with_half_width(t.half_width + way)

    def of(given, units):
        return np.asarray(jax.jit(jax.vmap(lambda i: response(tolerances.sample(given, i, seed=2))["y"]))(units))

    every = of(FIELDS, np.arange(UNITS))
    order = np.argsort(every)
    own = order[np.searchsorted(every[order], found.base["y"] - 1e-13 * np.abs(every).max())]
    np.testing.assert_allclose(every[own], found.base["y"], rtol=1e-9)
    return of(FIELDS.replace(**moved), own)


def test_a_linear_response_is_met_exactly(of_linear):
    """Fields of numbers and of elements: every slope is exact, every bend is rounding and left out."""
    _, found = of_linear
    assert set(found.columns["y"]) == {(k,) for k in range(6)}
    values = direct(found, linear)
    # differences of responses of 1e-5 at both ends: a few roundings of the largest
    np.testing.assert_allclose(found.values("y", X), values, atol=40 * np.finfo(float).eps * np.abs(values).max())


@pytest.mark.long  # test_report_live.py measures what is left out of a model
def test_a_quadratic_response_is_met_to_what_is_left_out():
    """Half-widths and places enter a product of errors bilinearly: bends between all; each column left out moves the
    response by less than 0.2 % of its spread (root mean square), of the 21 at most."""
    found = response_surface.surrogate(made(bent, 6.0), **FEW)
    assert any(key[0] != key[-1] for key in found.columns["y"])
    values = direct(found, bent)
    miss = np.sqrt(np.mean((found.values("y", X) - values) ** 2))
    assert miss < 21 * region.FELT * values.std()
    assert miss < 0.1 * np.sqrt(np.mean((found.base["y"] - values) ** 2))  # and the sliders do move it


def test_weights_give_the_figures_of_the_certificate(of_linear):
    question, found = of_linear
    certificate = question.allocation.certificate
    here = found.figures("y", np.zeros(6), question.study.requirements["y"])
    assert here["mean"] == pytest.approx(certificate.mean["y"].value, abs=1e-9 * here["sd"])
    assert here["sd"] == pytest.approx(certificate.sd["y"].value, rel=1e-9)
    assert here["yield"] == pytest.approx(certificate.yield_["y"].value, abs=1e-12)
    assert found.weights.min() > 0
    # Elsewhere: fresh units and a thinned sample, of which half is drawn evenly: five standard errors of both.
    for check in found.checks:
        ours, true = check.figures["y"]["yield"]
        assert (
            abs(ours - true) < 5 * np.sqrt(true * (1 - true) * (1 / FEW["fresh"] + 2 / response_surface.UNITS)) + 1e-4
        )
    assert len(found.checks) == FEW["points"] + 1


def test_the_thinned_sample_keeps_the_tails():
    """Horvitz and Thompson: the share beyond a point is unbiased, its variance sum (1 - chance)/chance over those."""
    values = np.random.default_rng(0).normal(size=(2, SHOWN_VALUES))
    chance = response_surface._chances(values, response_surface.UNITS)
    assert chance.sum() == pytest.approx(response_surface.UNITS, rel=1e-9)
    for row in values:
        assert chance[np.argsort(row)[[*range(20), *range(-20, 0)]]].min() == 1.0
        beyond = row > np.quantile(row, 0.9973)
        spread = np.sqrt(np.sum((1 - chance[beyond]) / chance[beyond]))
        assert spread < 0.5 * np.sqrt(beyond.sum() / response_surface.UNITS * SHOWN_VALUES)  # half of plain thinning's
        kept = [
            response_surface._thinned(chance, response_surface.UNITS, np.random.default_rng(seed)) for seed in range(10)
        ]
        guesses = np.array([np.sum(beyond[k] / chance[k]) for k in kept])
        assert len(set(kept[0])) == response_surface.UNITS
        assert abs(guesses.mean() - beyond.sum()) < 5 * spread / np.sqrt(len(guesses))
        assert np.abs(guesses - beyond.sum()).max() < 5 * spread


def test_units_that_fail_in_the_region_leave_finite_columns():
    def failing(errors):
        y = linear(errors)["y"]
        return {"y": jnp.where(y > 15e-6, jnp.nan, y)}

    question = made(failing, 12e-6)
    found = response_surface.surrogate(question, **FEW)
    assert all(np.isfinite(c).all() for c in found.columns["y"].values())
    failed = question.allocation.certificate.failed / question.allocation.certificate.samples
    assert found.failed == failed > 0
    here = found.figures("y", np.zeros(6), question.study.requirements["y"])
    assert here["yield"] == pytest.approx(question.allocation.certificate.yield_["y"].value, abs=1e-12)
    nothing = SimpleNamespace(**vars(question) | {"after": SimpleNamespace(
        tolerances=question.after.tolerances, values={"y": np.full(UNITS, np.nan)}, seed=2)})  # fmt: skip
    assert response_surface.surrogate(nothing) is None


def costly_linear(errors):
    return linear(errors)


def costly_bent(errors):
    """A sum of errors and the square of one of them."""
    x, y, z = 1e6 * errors.pin_radius, 1e6 * errors.eccentricity, 1e6 * errors.carrier_bore[0, 0]
    return {"y": x + z + y + 0.1 * z * z}


costly_linear.costly = costly_bent.costly = True  # type: ignore[attr-defined]


def test_a_costly_linear_response_is_met_by_the_derivatives_alone():
    found = response_surface.surrogate(made(costly_linear, 14e-6), **FEW)
    assert len(found.weights) == OF_COSTLY.surrogate and found.compared == "own"
    assert set(found.columns["y"]) == {(k,) for k in range(6)}
    values = direct(found, linear)
    np.testing.assert_allclose(found.values("y", X), values, atol=1e-9 * np.abs(values).max())
    assert found.error("yield") < 1e-6 and found.error("mean") < 1e-6 and len(found.checks) == FEW["points"]


def test_costly_units_are_solved_once_for_all_outputs(monkeypatch):
    """At x = 0 and at three places for the surrogate of two outputs, and some of them at each point of the checks."""
    solved, solve = [], derivatives.solve
    counted = lambda r, p, count, e: solved.append(count) or solve(r, p, count, e)  # noqa: E731
    monkeypatch.setattr(sys.modules["rvjax.response.parts"], "solve", counted)
    both = lambda errors: costly_bent(errors) | {"z": linear(errors)["y"]}  # noqa: E731
    both.costly = True
    given = made(both, 6.0, z=14e-6)
    solved.clear()
    found = response_surface.surrogate(given, **FEW)
    assert solved == [OF_COSTLY.surrogate] * (2 + region.PLACES) + [response_surface.COMPARED] * FEW["points"]
    alone = response_surface.surrogate(made(costly_linear, 14e-6), **FEW)
    for k, parameter in enumerate(found.parameters):
        if parameter.place:  # the derivatives of two outputs stay apart
            assert found.columns["z"][k,].mean() == pytest.approx(alone.columns["y"][k,].mean(), rel=1e-6)


def test_bends_that_all_units_share_are_found_at_random_places():
    """z = m + h u has the square m^2 + 2 m h u + h^2 u^2: the first is a bend of the mid-point that all units share."""
    found = response_surface.surrogate(made(costly_bent, 6.0), **FEW)
    (place,) = (k for k, p in enumerate(found.parameters) if p.field == "carrier_bore" and p.place)
    reach = 1e6 * found.parameters[place].reach
    # The products 2 m h u act as noise on it, of which 768 units at three places leave a twentieth
    assert found.columns["y"][place, place].mean() == pytest.approx(0.1 * reach**2, rel=0.15)
    assert found.error("mean") < 0.05 and found.error("yield") < 0.02


def test_a_failed_unit_does_not_change_the_regression_of_the_others():
    rng = np.random.default_rng(2)
    rise, places = rng.standard_normal((2, 400)), [rng.uniform(-1, 1, (2, 400)) for _ in range(2)]
    base = rng.standard_normal(400)
    changes = [(rise * x).sum(0) + 0.3 * x[0] ** 2 for x in places]
    base[7], changes[0][7], changes[1][7], changes[1][9] = np.nan, np.nan, np.nan, np.inf
    found = region._regressed(base, rise, places, changes)
    np.testing.assert_allclose(found[0, 0], 0.3, atol=2e-3)
    np.testing.assert_allclose(found[1,], rise[1], atol=1e-2)


@pytest.mark.parametrize(
    ("mean", "sd", "said"),
    [
        (0.012, 0.0, "mean 1.2 % of a standard deviation, standard deviation 0 %"),
        (1.234, 3e-5, "mean 120 % of a standard deviation, standard deviation below 0.01 %; the estimate is poor"),
        (np.nan, 0.3, "mean an unknown part of a standard deviation, standard deviation 30 %; the estimate is poor"),
    ],
)
def test_the_error_of_the_sliders_is_said_in_plain_numbers(mean, sd, said):
    figures = {"yield": (0.9, 0.9), "mean": (mean, 0.0), "sd": (1 + sd, 1.0)}
    check = response_surface.Check("a point", {"y": figures})
    found = response_surface.Surrogate((), np.ones(1), {}, {}, 0.0, checks=(check,))
    assert sliders.error_text(found).startswith(f"largest errors at 1 points: yield 0 % of the units, {said}")
