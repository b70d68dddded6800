"""Rest position of the coupler of a four-bar linkage, for free, phase-locked and geared cranks.

Every function takes finite numbers of a possible geometry; `linkage` checks them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import roots
from rvjax._jax.elementary import LARGEST_ANGLE, arctan2, sin_cos
from rvjax.records import Array, PyTree, Scalar
from rvjax.status import Check, SolveInfo, Status, at_once, first_failure


class Crank(NamedTuple):
    """Direction of a crank; kept as cosine and sine so that a batch shares them."""

    cosine: PyTree
    sine: PyTree
    finite: Array | np.bool = np.True_

    def turned(self, cosine: Scalar, sine: Scalar) -> "Crank":
        """Turned counter-clockwise by an angle given by its cosine and sine."""
        return Crank(self.cosine * cosine - self.sine * sine, self.sine * cosine + self.cosine * sine, self.finite)


def crank_direction(angle: jax.Array) -> Crank:
    """The direction of `angle`; an angle not finite, or too large to have one, is marked and replaced by zero."""
    finite = jnp.abs(angle) < LARGEST_ANGLE
    sine, cosine = sin_cos(jnp.where(finite, angle, 0))
    return Crank(cosine, sine, finite)


class Links(NamedTuple):
    """A linkage: nominal lengths e and l, deviations, the direction of crank 1, the frame vector."""

    e: jax.Array
    l: jax.Array  # noqa: E741  (the field's symbol)
    d1: jax.Array
    d2: jax.Array
    d3: jax.Array
    psi: jax.Array  # crank 3 minus crank 1
    b4: jax.Array
    gy: jax.Array
    cosine: jax.Array
    sine: jax.Array
    dx: jax.Array  # frame vector d4, b4 and joint included: (l + dx, dy)
    dy: jax.Array
    axial: jax.Array  # d4 + gx, of which dx consists to first order
    size: jax.Array  # of all lengths whose sums and differences are formed, spacing excepted


class Resting(NamedTuple):
    """Coupler, or disc in the frame of the carrier, at rest; NaN where there is none, `info` gives the reason."""

    angle: jax.Array
    misfit: jax.Array
    info: SolveInfo


def _at_rest(
    angle: Array,
    misfit: Array,
    info: SolveInfo,
    *checks: Check,
    nowhere: Array | np.bool = np.False_,
    shown: Array | bool = True,
) -> Resting:
    """Result of a solve under its status: NONFINITE where no root was found or numbers overflow.

    `nowhere` is true where the geometry allows no angle, `shown` where numbers are kept nevertheless.
    """
    unsolved, failed = info.status == Status.MAX_STEPS, info.status != Status.CONVERGED
    missing = ~(jnp.isfinite(angle) & ~failed | unsolved)
    status = first_failure((missing & ~nowhere, Status.NONFINITE), (unsolved & ~nowhere, Status.MAX_STEPS), *checks)
    angle, misfit = (jnp.where(~failed & shown, value, jnp.nan) for value in (angle, misfit))
    return Resting(angle, misfit, info.replace(status=status))


class View(NamedTuple):
    """The linkage seen along its frame vector."""

    length: jax.Array  # of the frame vector, L
    cosine: jax.Array  # of crank 1
    sine: jax.Array
    excess: jax.Array  # l2' - L


def view(links: Links) -> View:
    """Turn crank 1 into the frame of the effective frame vector; no angle is formed."""
    l, dx, dy = links.l, links.dx, links.dy  # noqa: E741
    length = jnp.sqrt((l + dx) ** 2 + dy**2)
    cosine = (links.cosine * (l + dx) + links.sine * dy) / length
    sine = (links.sine * (l + dx) - links.cosine * dy) / length
    eps = float(jnp.finfo(sine.dtype).eps)
    sine = jnp.where(jnp.abs(sine) <= 8 * eps, jnp.abs(sine), sine)  # rounding must not choose a dead point's sign
    return View(length, cosine, sine, links.d2 - (2 * l * dx + dx**2 + dy**2) / (length + l))


def gap(links: Links, seen: View) -> jax.Array:
    """Length that free cranks lack to be assembled (> 0), from the triangle of pin 1, coupler and crank 3."""
    l1, l3 = links.e + links.d1, links.e + links.d3
    along, across = seen.length - l1 * seen.cosine, l1 * seen.sine
    reach = jnp.sqrt(along**2 + across**2)
    return jnp.abs(seen.excess + l1 * seen.cosine - across**2 / (reach + along)) - l3


def free(links: Links, seen: View, *, closure: str, branch: str) -> Resting:
    """Crank 3 follows: a (2 - 2 cos x) + b sin x + c = 0, (S1) with the angle of crank 3 eliminated."""
    e, d1, d2, d3 = links.e, links.d1, links.d2, links.d3
    l1, l2, l3, h = e + d1, links.l + d2, e + d3, seen.excess
    a = 1 - l1 * seen.cosine / seen.length  # all three divided by l2' L
    b = 2 * l1 * seen.sine / seen.length
    c = ((d1 - d3) * (2 * e + d1 + d3) + 2 * l1 * h * seen.cosine + h**2) / (l2 * seen.length)
    d = b**2 - 4 * a * c - c**2
    # Lengths are known to a rounding of l2' and L, which on the scale of the cranks is a wider band.
    eps = float(jnp.finfo(d.dtype).eps)
    band = 8 * eps * (seen.length + l2) / (l1 + l3) * (b**2 + jnp.abs(4 * a * c) + c**2)
    too_short = gap(links, seen) > 32 * eps * links.size  # more accurate for tiny cranks
    open_chain = (d < -band) | too_short  # the links are too short to meet
    change_point = jnp.abs(seen.sine) < (1e-6 if eps < 1e-10 else 1e-3)  # crank 1 in line with the frame
    fold = (jnp.abs(d) <= band) & ~too_short  # the two branches meet
    found_wrong = ((open_chain, Status.NOT_ASSEMBLABLE), (change_point, Status.CHANGE_POINT), (fold, Status.SINGULAR))
    misfit = jnp.zeros_like(a)
    if closure == "first_order":
        angle = _free_first_order(links, change_point)
        return _at_rest(angle, misfit, at_once(angle), *found_wrong, nowhere=open_chain | change_point)
    x, info = _free_root(a, b, c, d, fold, closure=closure, branch=branch)
    angle = arctan2(links.dy, links.l + links.dx) + x
    return _at_rest(angle, misfit, info, *found_wrong, nowhere=open_chain, shown=~open_chain)


def _free_first_order(links: Links, change_point: jax.Array) -> jax.Array:
    d1, d2, d3, cosine, sine = links.d1, links.d2, links.d3, links.cosine, links.sine
    gx_d4 = links.axial
    numerator = (d3 - d1) + (gx_d4 - d2) * cosine + links.gy * sine
    angle = links.b4 + numerator / (links.l * jnp.where(change_point, 1, sine))
    return jnp.where(change_point, jnp.where(numerator == 0, links.b4, jnp.nan), angle)


def _free_root(
    a: Array, b: Array, c: Array, d: Array, fold: Array, *, closure: str, branch: str
) -> tuple[jax.Array, SolveInfo]:
    """Root x of the open or crossed branch; at a fold both branches meet at -atan2(b, 2 a)."""
    s = jnp.where(b < 0, -1, 1).astype(b.dtype)
    if closure == "closed_form":
        root = _root(jnp.where(fold, 0, d))
        if branch == "open":
            return 2 * arctan2(-s * c, _nonzero(jnp.abs(b) + root)), at_once(a)
        return 2 * arctan2(-(b + s * root), 4 * a + c), at_once(a)
    sum_ = b + s * _root(b**2 - 4 * a * c)
    quadratic = -2 * c / _nonzero(sum_) if branch == "open" else -sum_ / (2 * a)  # (S2)
    if closure == "quadratic":
        return quadratic, at_once(a)
    # F falls and rises monotonically between the fold angle and its opposite points.
    middle = -arctan2(b, 2 * a)
    side = s if branch == "open" else -s
    start = jax.lax.stop_gradient(quadratic)
    solution = roots.bracketed(_free_residual, (a, b, c), middle, middle + side * jnp.pi, start=start)
    status = jnp.where(fold & (solution.info.status == Status.NO_BRACKET), int(Status.CONVERGED), solution.info.status)
    return jnp.where(fold, middle, solution.value), SolveInfo(status, solution.info.steps, solution.info.residual)


def _free_residual(x: Array, params: tuple[jax.Array, ...]) -> jax.Array:
    a, b, c = params
    half_sine, half_cosine = sin_cos(x / 2)
    return 2 * half_sine * (2 * a * half_sine + b * half_cosine) + c  # (S1)


def _root(x: jax.Array) -> jax.Array:
    """Square root, zero with zero derivative where x <= 0."""
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1)), 0)


def _nonzero(x: jax.Array) -> jax.Array:
    """Return a denominator whose numerator is zero too where it vanishes."""
    return jnp.where(x == 0, 1, x)


def locked(links: Links, *, closure: str) -> Resting:
    """Both cranks geared rigidly: two equal bearings share the misfit, the coupler points along X, Y."""
    x, y = _offset(links, links.psi)
    misfit = stretch(links.l, x, y) - links.d2
    if closure == "first_order":
        angle = _locked_first_order(links, links.psi)
        return _at_rest(angle, misfit, at_once(angle))
    angle, info = direction_angle(links.l + x, y, links.l, closure=closure)
    return _at_rest(angle, misfit, info)


def _offset(links: Links, psi: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Vector from pin 1 to pin 3 less (l, 0)."""
    half_sine, half_cosine = sin_cos(psi / 2)
    w, difference = 2 * (links.e + links.d3) * half_sine, links.d3 - links.d1
    x = links.dx + difference * links.cosine - w * (links.sine * half_cosine + links.cosine * half_sine)
    y = links.dy + difference * links.sine + w * (links.cosine * half_cosine - links.sine * half_sine)
    return x, y


def stretch(l: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:  # noqa: E741
    """hypot(l + x, y) - l without cancellation."""
    return (2 * l * x + x**2 + y**2) / (jnp.sqrt((l + x) ** 2 + y**2) + l)


def _locked_first_order(links: Links, psi: jax.Array) -> jax.Array:
    turned = (links.d3 - links.d1) * links.sine + links.e * psi * links.cosine + links.gy
    return links.b4 + turned / links.l


def direction_angle(x: jax.Array, y: jax.Array, size: jax.Array, *, closure: str) -> tuple[jax.Array, SolveInfo]:
    """Angle of the vector (x, y): by atan2, or as the root of x sin b = y cos b in its quadrant pair.

    The residual of the root counts in units of `size`, the nominal length.
    """
    if closure == "closed_form":
        return arctan2(y, x), at_once(x)
    x, y = x / size, y / size
    centre = jnp.where(x > 0, 0, jnp.where(y < 0, -jnp.pi / 2, jnp.pi / 2)).astype(x.dtype)
    quarter = jnp.asarray(jnp.pi / 2, x.dtype)
    start = jax.lax.stop_gradient(jnp.where(x > 0, y / jnp.where(x > 0, x, 1), centre))
    solution = roots.bracketed(_direction_residual, (x, y), centre - quarter, centre + quarter, start=start)
    return solution.value, solution.info


def _direction_residual(b: Array, params: tuple[jax.Array, ...]) -> jax.Array:
    x, y = params
    sine, cosine = sin_cos(b)
    return x * sine - y * cosine


def geared(links: Links, ratio: jax.Array, *, closure: str) -> Resting:
    """Gears of finite stiffness: crank 3 lags by delta so that m^2/2 + ratio e^2 delta^2/2 is least."""
    e, cosine, sine = links.e, links.cosine, links.sine
    m = links.axial - links.d2 + (links.d3 - links.d1) * cosine - e * links.psi * sine  # first order
    slip = sine * m / (e * (sine**2 + ratio))
    info = at_once(slip)
    if closure == "newton":
        # |m| grows by at most l3' a radian, so beyond `bound` the gears outweigh the bearings.
        stiff = ratio * e**2
        l3 = jnp.abs(e + links.d3)
        widest = jnp.abs(_misfit(links, jnp.zeros_like(slip))) + 2 * l3
        bound = jax.lax.stop_gradient(1.01 * widest * l3 / stiff) + jnp.abs(jax.lax.stop_gradient(slip))
        solution = roots.bracketed(_slip_residual, (links, ratio), -bound, bound, start=jax.lax.stop_gradient(slip))
        solved, info = solution.info.status == Status.CONVERGED, solution.info
        slip = jnp.where(solved, solution.value, slip)  # derivatives stay finite; the status reports the failure
    x, y = _offset(links, links.psi + slip)
    misfit = stretch(links.l, x, y) - links.d2
    if closure == "first_order":
        return _at_rest(_locked_first_order(links, links.psi + slip), misfit, info)
    return _at_rest(arctan2(y, links.l + x), misfit, info)


def _misfit(links: Links, slip: jax.Array) -> jax.Array:
    return stretch(links.l, *_offset(links, links.psi + slip)) - links.d2


def _slip_residual(slip: Array, params: tuple[Links, jax.Array]) -> jax.Array:
    """Derivative of the energy with respect to the lag of crank 3, divided by e^2."""
    links, ratio = params
    m, slope = jax.jvp(lambda s: _misfit(links, s), (slip,), (jnp.ones_like(slip),))
    return m * slope / links.e**2 + ratio * slip
