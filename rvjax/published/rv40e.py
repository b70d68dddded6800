"""Published values of the web article on the original errors of the RV-40E's second stage (a four-bar linkage).

Its numbers follow only from the *crossed* root of its quadratic, in radians published as degrees, with a
crank spacing of 72 mm, at crank angle 90 deg: at zero error that root is 2 e / l = 0.0361, where a
parallelogram gives 0. `RIGHT` holds the open branch of the exact closure for the same errors.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import in_blocks
from rvjax.catalogue import RV_40E
from rvjax.errors import RVErrors
from rvjax.four_bar import LinkDeviations, solve_closure, transmission_error
from rvjax.records import PyTree, Scalar
from rvjax.units import arcmin, deg, mm, um

ECCENTRICITY = RV_40E.cycloid.eccentricity
SPACING = 2 * RV_40E.cranks.circle_radius
RIGHT_ANGLE = 90 * deg
BAND = 0.1 * mm  # the source varies every error by +-0.1 mm

# Effective elastic lengthening of both cranks, fitted to the published elastic ranges: the source gives neither
# bearing forces nor displacements, and no single stiffness gives all three.
ELASTIC_CRANK = 0.00453 * mm
ELASTIC_TABLE_2_3 = 0.029 * mm
ELASTIC_OUTPUT = 0.0929 * mm


def _coupler_angle(links: jax.Array, crank_angle: Scalar = RIGHT_ANGLE, **options: PyTree) -> jax.Array:
    """For deviations of crank 1, coupler, crank 3, frame and of a joint across the frame, (5,) m."""
    crank_1, coupler, crank_3, frame, across = links
    deviations = LinkDeviations(
        crank_1=crank_1, coupler=coupler, crank_3=crank_3, frame=frame, joint=(jnp.zeros_like(across), across)
    )
    chosen: dict[str, PyTree] = dict(cranks="free") | options
    return solve_closure(ECCENTRICITY, SPACING, deviations, crank_angle=crank_angle, **chosen).coupler_angle


SWEEP = np.linspace(-BAND, BAND, 2001)


@cache
def _kernel(**options: PyTree) -> Callable[..., jax.Array]:
    return jax.jit(jax.vmap(partial(_coupler_angle, **options)))


def printed(
    crank_1: Scalar = 0.0,
    coupler: Scalar = 0.0,
    crank_3: Scalar = 0.0,
    frame: Scalar = 0.0,
    crank_angle: Scalar = RIGHT_ANGLE,
    **options: PyTree,
) -> np.ndarray:
    """|coupler angle| in rad under the reading that gives the source's figures; arrays of errors in m."""
    options = dict(closure="quadratic", branch="crossed") | options
    lanes = np.stack(np.broadcast_arrays(*np.atleast_1d(crank_1, coupler, crank_3, frame, 0.0, crank_angle)), axis=1)
    return np.abs(in_blocks(_kernel(**options), len(SWEEP), lanes[:, :5], lanes[:, 5]))


right = partial(printed, closure="newton", branch="open")  # the parallelogram's own root, exact closure


def _range(values: np.ndarray) -> list[float]:
    return [values.min(), values.max()]


# Links that one error changes, and the elastic lengthening.
PARTS: dict[str, tuple[tuple[str, ...], float]] = {
    "crank": (("crank_1", "crank_3"), ELASTIC_CRANK),
    "cycloid_bore": (("coupler",), ELASTIC_CRANK),
    "output_bore": (("frame",), ELASTIC_OUTPUT),
}


def _lengthened(elastic: float, solve: Callable[..., np.ndarray], **errors: Scalar) -> np.ndarray:
    return solve(**errors | {crank: errors.get(crank, 0.0) + elastic for crank in ("crank_1", "crank_3")})


def _swept(part: str, elastic: bool = False, solve: Callable[..., np.ndarray] = printed) -> np.ndarray:
    links, lengthening = PARTS[part]
    return _lengthened(lengthening if elastic else 0.0, solve, **dict.fromkeys(links, SWEEP))


def _part_range(part: str, elastic: bool = False, solve: Callable[..., np.ndarray] = printed) -> list[float]:
    return _range(_swept(part, elastic, solve))


# Tables 2 to 4: two errors, each -0.1, 0, +0.1 mm, the first one slowest; and the elastic lengthening.
TABLES: dict[str, tuple[str, str, float]] = {
    "table2": ("crank_1", "coupler", ELASTIC_TABLE_2_3),
    "table3": ("crank_1", "frame", ELASTIC_TABLE_2_3),
    "table4": ("coupler", "frame", ELASTIC_OUTPUT),
}


def _grid(table: str, points: int, elastic: bool, solve: Callable[..., np.ndarray] = printed) -> np.ndarray:
    first, second, lengthening = TABLES[table]
    steps = np.linspace(-BAND, BAND, points)
    errors = {first: np.repeat(steps, points), second: np.tile(steps, points)}
    return _lengthened(lengthening if elastic else 0.0, solve, **errors)


def _row(table: str, row: int, solve: Callable[..., np.ndarray] = printed) -> list[float]:
    return [_grid(table, 3, elastic, solve)[row - 1] for elastic in (False, True)]


def _margin(table: str) -> list[float]:
    return _range(_grid(table, 3, True) - _grid(table, 3, False))


def _quadratic_is_the_closure() -> bool:
    """Published a, b, c against |l1 + l2 - l4|^2 - l3^2, which differ by terms of third order in the angle only."""
    rng = np.random.default_rng(0)
    l1, l2, l3, l4 = np.array([[ECCENTRICITY], [SPACING], [ECCENTRICITY], [SPACING]]) + rng.uniform(
        -BAND, BAND, (4, 100)
    )
    crank, angle = rng.uniform(0, 2 * np.pi, 100), rng.uniform(-1e-3, 1e-3, 100)
    a = l2 * l4 - l1 * l2 * np.cos(crank)
    b = 2 * l1 * l2 * np.sin(crank)
    c = l1**2 + l2**2 + l4**2 - l3**2 - 2 * l1 * l4 * np.cos(crank) + 2 * l1 * l2 * np.cos(crank) - 2 * l2 * l4
    exact = np.abs(l1 * np.exp(1j * crank) + l2 * np.exp(1j * angle) - l4) ** 2 - l3**2
    rounding = 8 * np.finfo(float).eps
    return bool(np.all(np.abs(a * angle**2 + b * angle + c - exact) <= SPACING**2 * (np.abs(angle) ** 3 + rounding)))


def _largest_at_right_angle() -> bool:
    angles = np.arange(0, 181, 15) * deg
    return int(np.argmax(right(crank_3=10 * um, crank_angle=angles, cranks="phase_locked"))) == 6


def _equal_cranks_help() -> bool:
    angles = (right(crank_1=-20 * um, crank_3=-20 * um, cranks=cranks)[0] for cranks in ("free", "phase_locked"))
    return any(angle < right()[0] for angle in angles)  # the error-free linkage gives exactly 0


NAMES = ("crank_1", "coupler", "crank_3", "frame", "joint")


@cache
def _derivatives() -> dict[str, float]:
    """Derivatives of the coupler angle at zero error, open branch."""
    slopes = jax.jit(jax.grad(partial(_coupler_angle, closure="closed_form")))(jnp.zeros(5))
    return dict(zip(NAMES, map(float, slopes)))


@cache
def _of_the_reading() -> tuple[np.ndarray, np.ndarray]:
    """Gradient (5,) and second derivatives (5, 5) of the coupler angle at zero error, as the source solves it."""

    def gradient(links: jax.Array) -> tuple[jax.Array, jax.Array]:
        found = jax.grad(partial(_coupler_angle, closure="quadratic", branch="crossed"))(links)
        return found, found

    second, first = jax.jit(jax.jacfwd(gradient, has_aux=True))(jnp.zeros(5))
    return np.asarray(first), np.asarray(second)


def _ranking() -> bool:
    crank, coupler, _, frame, _ = np.abs(_of_the_reading()[0])
    return bool(crank > frame > coupler)


def _clearance_matters() -> bool:
    """Both joints move across the frame, in opposite senses."""
    return 2 * abs(_derivatives()["joint"]) > abs(_derivatives()["crank_1"])


def _loaded_clearance() -> bool:
    errors = RVErrors(bearing_clearance=5 * um)
    solved = transmission_error(RV_40E, errors, crank_angle=RIGHT_ANGLE, output_torque=412.0)
    return abs(float(solved.error)) > 5e-5


def _not_additive() -> bool:
    together = right(coupler=-BAND, frame=BAND)[0]
    alone = right(coupler=-BAND)[0] + right(frame=BAND)[0]
    return bool(abs(together - alone) > 0.1 * alone)


def _saddle() -> bool:
    """Over coupler and frame."""
    return bool(np.linalg.det(_of_the_reading()[1][np.ix_([1, 3], [1, 3])]) < 0)


def _frame_maximum_inside() -> bool:
    values = _swept("output_bore")
    return bool(values[-1] < values[0] < values.max() and -0.05 * mm < SWEEP[np.argmax(values)] < -0.04 * mm)


COMPUTED: dict[str, Callable[[], Any]] = {
    **{f"rv40e.{part}.rigid_range": partial(_part_range, part) for part in PARTS},
    **{f"rv40e.{part}.elastic_range": partial(_part_range, part, True) for part in PARTS},
    **{f"rv40e.{table}.row{row}": partial(_row, table, row) for table in TABLES for row in range(1, 10)},
    "rv40e.table4.rigid_range": lambda: _range(_grid("table4", 11, False)),
    "rv40e.table4.elastic_range": lambda: _range(_grid("table4", 11, True)),
    "rv40e.table2.elastic_margin": partial(_margin, "table2"),
    "rv40e.table3.elastic_margin": partial(_margin, "table3"),
    "rv40e.zero_error.rigid": lambda: printed()[0],
    "rv40e.zero_error.elastic": lambda: 3 * list(_lengthened(ELASTIC_TABLE_2_3, printed)),
    "rv40e.model.parallelogram": lambda: bool(np.all(right(crank_angle=np.arange(5, 360, 7.0) * deg) == 0)),
    "rv40e.intro.one_arcmin": lambda: 0.0361 * deg / arcmin,
    "rv40e.model.coefficients": _quadratic_is_the_closure,
    "rv40e.model.small_angle": lambda: (
        abs(right(crank_1=BAND, closure="quadratic") / right(crank_1=BAND) - 1)[0] < 1e-6
    ),
    "rv40e.model.critical_angle": _largest_at_right_angle,
    "rv40e.crank.elastic_larger": lambda: np.all(_swept("crank", True) > _swept("crank")),
    "rv40e.crank.minimum_negative": lambda: SWEEP[np.argmin(_swept("crank"))] < 0,
    "rv40e.crank.guideline": _equal_cranks_help,
    "rv40e.cycloid_bore.falls_both_sides": lambda: max(printed(coupler=np.array([-BAND, BAND]))) < printed()[0],
    "rv40e.cycloid_bore.tolerance_loose": lambda: (
        abs(_derivatives()["coupler"]) < 1e-12 * abs(_derivatives()["crank_1"])
    ),
    "rv40e.output_bore.positive_better": _frame_maximum_inside,
    "rv40e.output_bore.guideline": lambda: bool(right(frame=20 * um)[0] < right()[0]),
    "rv40e.composite.not_additive": _not_additive,
    "rv40e.table2.surface": lambda: bool(np.diff(printed(coupler=np.array([-BAND, 0.0, BAND])), 2)[0] < 0),
    "rv40e.table2.minimum": lambda: bool(np.argmin(_grid("table2", 3, False)) < 3),
    "rv40e.table3.minimum": lambda: bool(np.argmin(_grid("table3", 3, False)) == 2),
    "rv40e.table4.minimum": lambda: bool(np.argmin(_grid("table4", 3, False)) == 2),
    "rv40e.table4.saddle": _saddle,
    "rv40e.clearance.amplifies": _loaded_clearance,
    "rv40e.sensitivity.ranking": _ranking,
    "rv40e.sensitivity.clearance": _clearance_matters,
    "rv40e.assembly.misalignment": lambda: 100 * abs(printed(crank_angle=RIGHT_ANGLE + 0.01)[0] / printed()[0] - 1),
}

RIGHT: dict[str, Callable[[], Any]] = {
    **{f"rv40e.{part}.rigid_range": partial(_part_range, part, solve=right) for part in PARTS},
    **{f"rv40e.{table}.row{row}": partial(_row, table, row, right) for table in TABLES for row in range(1, 10)},
    "rv40e.table4.rigid_range": lambda: _range(_grid("table4", 11, False, right)),
    "rv40e.zero_error.rigid": lambda: right()[0],
}
