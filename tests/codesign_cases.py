"""Reference problems of design and tolerances together, as responses of the library."""

import functools
import json
import math
from pathlib import Path
from unittest import mock

import jax.numpy as jnp

from rvjax import study
from rvjax.tolerances import CpkAtLeast, Middle, Nominal, ReciprocalPower, Requirement, Tolerance, Variable, allocate
from rvjax.tolerances.allocation import search
from tests.oracles.responses import Lever

CASES = {
    case["id"]: case
    for case in json.loads((Path(__file__).parent / "reference" / "codesign.json").read_text())["cases"]
}
PROGRAMMES = [name for name, case in CASES.items() if case["given"].get("family") in ("sums", "larger", "flank")]

one_start = functools.partial(mock.patch.object, search, "starts", lambda decisions, x, low, high: [x])
"""Context of a search for one valley, from the given start: three quarters of the time are the other starts."""

# The lever of most tests.
PARTS = {name: Tolerance.symmetric(0.1, size=0.02) for name in "ab"}
COST = ReciprocalPower(reference=1.0, finest=0.05, coarsest=5.0)
NEED = {"y": Requirement(lower=-1.0, upper=1.0)}
LEVER, LENGTH = Lever(), Variable(0.4, 3.0, 2.0)
OPTIONS = dict(costs=dict.fromkeys("ab", COST), certificate_samples=20_000, samples=2048)


@one_start()
def levered(response=LEVER, variables=None, requirements=None, **changes):
    """An allocation of the lever, or of what differs from it."""
    return allocate(
        response, PARTS, requirements or NEED, variables=variables or {"length": LENGTH}, **(OPTIONS | changes)
    )


def total(terms, values):
    """Sum of c prod d^p."""
    return sum(c * math.prod(values[name] ** power for name, power in powers.items()) for c, powers in terms)


def sums(given, errors, values):
    """Responses that are linear in the errors, with coefficients of the numbers."""
    found = {}
    for name, output in given["outputs"].items():
        if "nominal" in output:
            pieces = output["nominal"] if "largest_of" not in output else None
            found[name] = total(pieces, values) + 0.0 * sum(errors.values())
        elif "largest_of" in output:
            found[name] = functools.reduce(jnp.maximum, [total(terms, values) for terms in output["largest_of"]])
        else:
            slopes = sum(total(terms, values) * errors[field] for field, terms in output["errors"].items())
            if "swell" in output:
                swell = output["swell"]
                phase = 2 * jnp.pi * (values[swell["of"]] - swell["at"]) / swell["period"]
                slopes = slopes * (1 + swell["height"] * (1 - jnp.cos(phase)))
            found[name] = total(output.get("mean", []), values) + slopes
    for name, several in given.get("larger", {}).items():
        found[name] = functools.reduce(jnp.maximum, [found[each] for each in several])
    return found


def convex_radius(zp, short, ring):
    """Least radius of curvature of the convex part of the path of pin centres."""
    root = jnp.sqrt(27 * (zp - 1) * jnp.maximum(1 - short**2, 1e-12) / (zp + 1) ** 3)
    return ring * jnp.where(short >= (zp - 2) / (2 * zp - 1), root, (1 + short) ** 2 / (1 + zp * short))


def flank(given, errors, values):
    """Lost motion of a cycloid flank."""
    known = given["constants"] | values
    short = known["e"] * known["zp"] / known["R"]
    s = jnp.sqrt(1 - short**2)
    play = s * errors["ring"] - errors["pin"] + errors["profile"] + values.get("offset", 0.0)
    return {
        "lost_motion": 2 * play / (known["e"] * known["zc"]) + 2 * errors["bearing"] / known["a0"],
        "convex_radius": convex_radius(known["zp"], short, known["R"]) - known["rr"],
        "diameter": 2 * (known["R"] + known["rr"]),
    }


def response_of(given):
    """The response (errors, values) of a problem."""
    family = {"sums": sums, "larger": sums, "flank": flank}[given["family"]]
    return functools.partial(family, given)


def variable(item):
    """A number with its own cost weight * value^power."""
    cost = (lambda value: item["weight"] * value ** item["power"]) if item["weight"] else None
    among = {"among": item["among"]} if "among" in item else {}
    return Variable(item["lower"], item["upper"], item["start"], cost=cost, **among)


def requirement(item):
    """A requirement of its kind."""
    limits = {key: item[key] for key in ("lower", "upper") if key in item}
    if item["kind"] == "nominal":
        return Nominal(**limits)
    if item["kind"] == "cpk":
        return CpkAtLeast(cpk=item["cpk"], **limits)
    return Requirement(target=item["target"], **limits)


def arguments(given):
    """Arguments of `allocate`."""
    tolerances = {}
    for name, item in given["fields"].items():
        middle, half, cp = item.get("middle", 0.0), item["half_width"], item.get("cp", 1.0)
        tolerances[name] = Tolerance(middle - half, middle + half, cp=cp)
    return dict(
        response=response_of(given),
        tolerances=tolerances,
        requirements={name: requirement(item) for name, item in given["requirements"].items()},
        costs={name: ReciprocalPower(**item) for name, item in given["costs"].items()},
        variables={name: variable(item) for name, item in given["variables"].items()},
        middles={name: Middle(**item) for name, item in given.get("middles", {}).items()},
        objective=given.get("objective"),
    )


def reference_study(certificate_samples):
    """The mechanical problem of the reference as a study file, lengths in m.

    Its limit of the transmission error has a fifth of the cost; 16 angles see 0.6 % less of it on average, that is
    0.1 % of the cost.
    """
    given = CASES["rv-0"]["given"]
    torque = f'output_torque = "{given["constants"]["torque"]} N m"'
    lines = [f'[design]\nbase = "rv-40e"\n[conditions]\n{torque}\nangles = 16']
    for name, field in given["fields"].items():
        middle, half = field.get("middle", 0.0), field["half_width"]
        lines.append(f'[tolerances.{name}]\nlower = "{middle - half} m"\nupper = "{middle + half} m"')
    for name, cost in given["costs"].items():
        lines.append(f"[cost.{name}]\nscale = {cost['scale']}\npower = {cost['power']}")
        lines += [f'{key} = "{cost[key]} m"' for key in ("reference", "finest", "coarsest")]
    for name, item in given["variables"].items():
        lines += [f'[variable."{name}"]', *(f'{key} = "{item[key]} m"' for key in ("lower", "upper", "start"))]
    for name, item in given["requirements"].items():
        nominal = "nominal_" if item["kind"] == "nominal" else ""
        unit = "m" if nominal else "rad"
        lines += [f"[requirement.{name}]", *([] if nominal else [f"target = {item['target']}"])]
        lines += [f'{nominal}{key} = "{item[key]} {unit}"' for key in ("lower", "upper") if key in item]
    for name, price in given["objective"].items():
        lines.append(f'[objective]\n{name} = {{price = {price}, per = "1 m"}}')
    text = "\n".join([*lines, f"[run]\ncertificate_samples = {certificate_samples}"])
    return study.parse_study(text, name="x", solve=False)
