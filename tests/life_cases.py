"""Reference cases of the bearing life as designs, errors and duties; few programs compile."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from loaded_cases import design_of, errors_of, newton_alone, number, plain

from rvjax import Bearings, RollerBearing, life

CASES = json.loads((Path(__file__).parent / "reference" / "life.json").read_text())["cases"]
NAMED = {case["name"]: case for case in CASES}
EXAMPLE = RollerBearing(14, 5e-3, 10e-3, 32e-3)
BASIC = "rv40: all errors, four phases, basic"  # its program serves most tests of the machine
PLAN = NAMED[BASIC]["options"]


def bearings_of(case):
    """Bearings of a case."""
    given = dict(case["design"]["bearings"])
    parts = {name: RollerBearing(**given.pop(name)) for name in ("arm", "support") if given.get(name)}
    return Bearings(**parts, **{name: number(value) for name, value in given.items()})


def unit_of(case):
    """Design and errors of a case, in the shapes and types of all others."""
    design = design_of({"design": {k: v for k, v in case["design"].items() if k != "bearings"}})
    return plain((design.replace(bearings=bearings_of(case)), errors_of(case, design)))


def duty_of(case, **changes):
    """Duty of a case, with columns replaced."""
    return life.Duty(**{name: np.asarray(values, float) for name, values in (case["duty"] | changes).items()})


def rate(design, errors, duty, **changes):
    """A rating with the options of `BASIC`."""
    return life.rating(design, errors, duty, **(PLAN | changes))


@jax.jit
@newton_alone()
def _slopes(given):
    def one(given):
        *unit, reliability = given
        found = rate(*unit, reliability=reliability)
        return jnp.log(found.life), found

    return jax.grad(one, has_aux=True)(given)


def rate_with_slopes(design, errors, duty, reliability=0.9):
    """A rating with the options of `BASIC`, and the slopes of the logarithm of its life to every number."""
    slopes, found = jax.device_get(_slopes(plain((design, errors, duty, reliability))))
    return found, slopes


def rate_together(*given, **changes):
    """The rating by the program of the slopes: one serves both."""
    return rate_with_slopes(*given, **changes)[0]
