"""Correction of an error: stored orders, their gains, and the residual.

Numbers of one unit on the host; only `Correction.output` and `.input` work inside jit.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from rvjax._jax.checks import checked, numbers
from rvjax._jax.sizes import CURVES
from rvjax.records import PyTree, Scalar
from rvjax.tolerances import Estimate


@dataclasses.dataclass(frozen=True, eq=False)
class Correction:
    """Correction that is added at the output angle.

    Attributes:
        order: stored orders per output turn, ascending (s,).
        value: stored complex amplitudes, gain applied, rad (s,).
        gain: share of the given amplitude that is stored (s,).
        saved: mean square that storing an order takes off the error, for every given order, rad^2 (k,).
        ratio: input turns per output turn.
        before_rms: of the error without correction, rad.
        residual_rms: expected with it, rad.
        given_order: all orders, as given (k,).
        given_value: their complex amplitudes, rad (k,).
        sd: standard deviation of their real and imaginary parts, rad (k,).
        angle_sd: standard deviation of the table's zero, rad of the output.
    """

    order: np.ndarray
    value: np.ndarray
    gain: np.ndarray
    saved: np.ndarray
    ratio: float
    before_rms: float
    residual_rms: float
    given_order: np.ndarray
    given_value: np.ndarray
    sd: np.ndarray
    angle_sd: float

    def output(self, angle: Scalar) -> PyTree:
        """-Re sum value exp(i k angle), rad at the output.

        Args:
            angle: of the output, rad, any shape; of JAX inside jit.
        """
        library: PyTree = jnp if isinstance(angle, jax.Array) else np
        dtype = jnp.result_type(float, angle) if isinstance(angle, jax.Array) else np.dtype(float)
        turned = library.asarray(angle, dtype)[..., None] * library.asarray(self.order, dtype)
        cosine, sine = (library.asarray(part, dtype) for part in (self.value.real, self.value.imag))
        value = library.sum(sine * library.sin(turned) - cosine * library.cos(turned), axis=-1)
        return value if isinstance(angle, jax.Array) or np.ndim(value) else float(value)

    def input(self, angle: Scalar) -> PyTree:
        """Return the same at the input, rad: ratio * output(angle).

        Args:
            angle: of the output, rad, any shape.
        """
        return self.ratio * self.output(angle)

    @property
    def stored(self) -> np.ndarray:
        """Stored amplitudes of all given orders, 0 where none is stored (k,)."""
        kept = dict(zip(self.order.tolist(), self.value))
        return np.array([kept.get(order, 0.0) for order in self.given_order.tolist()], complex)


@dataclasses.dataclass(frozen=True, eq=False)
class Residual:
    """Residual of a curve.

    Attributes:
        order: ascending (k,).
        value: complex amplitudes, rad (k,).
        rms: rad.
    """

    order: np.ndarray
    value: np.ndarray
    rms: float


@dataclasses.dataclass(frozen=True)
class Left:
    """Expected residual of a correction, with intervals.

    Attributes:
        rms: of the curve that stays, rad.
        peak_to_peak: of the curve that stays, rad.
    """

    rms: Estimate
    peak_to_peak: Estimate


@checked
def correction(
    order: ArrayLike,
    value: PyTree,
    *,
    ratio: float,
    sd: ArrayLike = 0.0,
    angle_sd: float = 0.0,
    count: int | None = None,
    shrink: bool = True,
) -> Correction:
    """Choose the orders to store.

    The zero of a table is known to `angle_sd`, so that order k is turned by a normal angle of k angle_sd, the mean
    cosine of which is c = exp(-(k angle_sd)^2/2). Stored with a gain g, an order v saves |v|^2 (2 g c - g^2)/2.

    Args:
        order: whole numbers per output turn, each once, at least 1 (k,).
        value: complex amplitudes v, rad (k,); or what has `value` and `sd`, as identified orders do.
        ratio: input turns per output turn, signed.
        sd: standard deviation of real and imaginary parts, rad, one number or (k,).
        angle_sd: standard deviation of the table's zero, rad of the output: index mark, encoder, delay.
        count: store at most this many orders, those that save most; None: all that save.
        shrink: store with the gain c, which always saves; else with gain 1, and only what then saves.

    Raises:
        ValueError: lengths differ, an order twice, below 1 or no whole number, a value that is not finite, a negative
            standard deviation, a ratio of 0, or a negative count.
    """
    if not isinstance(value, np.ndarray | list | tuple) and hasattr(value, "value"):
        sd = value.sd if np.ndim(sd) == 0 and sd == 0.0 else sd
        value = value.value
    orders, values = _curve(order, value)
    sds = numbers("sd", sd)
    if sds.ndim and sds.shape != values.shape:
        raise ValueError(f"sd: {sds.size} numbers in rad for {values.size} orders")
    sds = np.broadcast_to(sds, values.shape)
    if not (np.isfinite(sds) & (sds >= 0)).all():
        raise ValueError(f"sd = {np.min(sds):.6g} rad: must be finite, zero or positive")
    if not (math.isfinite(angle_sd) and angle_sd >= 0):
        raise ValueError(f"angle_sd = {angle_sd!r} rad: must be finite, zero or positive")
    if not (math.isfinite(ratio) and ratio != 0):
        raise ValueError(f"ratio = {ratio!r}: must be finite and not 0")
    gain = kept_cosine(orders, angle_sd) if shrink else np.ones(len(orders))
    saved = saved_by(values, gain * values, orders, angle_sd)
    best = np.argsort(-saved, kind="stable")[: len(saved) if count is None else count]
    chosen = best[saved[best] > 0]
    stored = np.zeros(len(values), complex)
    stored[chosen] = (gain * values)[chosen]
    return rated(orders, values, stored, sds, float(angle_sd), float(ratio), chosen[np.argsort(orders[chosen])], saved)


def kept_cosine(order: np.ndarray, angle_sd: float) -> np.ndarray:
    """c = E cos eps of orders whose phase is uncertain by k angle_sd.

    Args:
        order: per output turn (k,).
        angle_sd: rad of the output.
    """
    return np.exp(-((order * angle_sd) ** 2) / 2)


def saved_by(value: np.ndarray, stored: np.ndarray, order: np.ndarray, angle_sd: float) -> np.ndarray:
    """|v|^2/2 - E |v - w exp(i eps)|^2/2 = c Re(conj(v) w) - |w|^2/2; with w = g v it is |v|^2 (2 g c - g^2)/2.

    Args:
        value: v, of the error, rad (k,).
        stored: w, rad (k,).
        order: per output turn (k,).
        angle_sd: of the table's zero, rad of the output.
    """
    return kept_cosine(order, angle_sd) * (value.conj() * stored).real - np.abs(stored) ** 2 / 2


def rated(
    order: np.ndarray,
    value: np.ndarray,
    stored: np.ndarray,
    sd: np.ndarray,
    angle_sd: float,
    ratio: float,
    chosen: np.ndarray,
    saved: np.ndarray,
) -> Correction:
    """Make a correction with its savings and residual.

    Args:
        order: all orders (k,).
        value: of the error, rad (k,).
        stored: of the table, rad (k,).
        sd: of real and imaginary parts of `value`, rad (k,).
        angle_sd: of the zero, rad of the output.
        ratio: input turns per output turn.
        chosen: places of the stored orders, in ascending order (s,).
        saved: by storing each order, rad^2 (k,).
    """
    before = float(np.sum(np.abs(value) ** 2 / 2 + sd**2))
    size = np.abs(value[chosen])
    gain = np.divide(np.abs(stored[chosen]), size, out=np.ones(len(chosen)), where=size > 0)
    return Correction(
        order=order[chosen],
        value=stored[chosen],
        gain=gain,
        saved=saved,
        ratio=ratio,
        before_rms=math.sqrt(before),
        residual_rms=math.sqrt(max(0.0, before - float(np.sum(saved[chosen])))),
        given_order=order,
        given_value=value,
        sd=sd,
        angle_sd=angle_sd,
    )


def _curve(order: ArrayLike, value: object) -> tuple[np.ndarray, np.ndarray]:
    """Orders as integers and values as complex numbers, in the order given."""
    orders, values = numbers("order", order), numbers("value", value, complex)
    if orders.ndim != 1 or orders.shape != values.shape:
        raise ValueError(f"value: {values.size} numbers in rad for {orders.size} orders")
    whole = orders.astype(np.int64) if np.isfinite(orders).all() else np.zeros(orders.shape, np.int64)
    for given, own in zip(orders, whole):
        if given != own or own < 1:
            raise ValueError(f"order = {given:g}: must be a whole number per output turn, at least 1")
    kinds, times = np.unique(whole, return_counts=True)
    if (times > 1).any():
        raise ValueError(f"order = {kinds[times > 1][0]}: duplicate")
    if not np.isfinite(values).all():
        place = int(np.argmin(np.isfinite(values)))
        raise ValueError(f"value = {values[place]} rad of order {whole[place]}: must be finite")
    return whole, values


@checked
def residual(correction: Correction, order: ArrayLike, value: object, *, shift: float = 0.0) -> Residual:
    """Compute the residual of a curve if the table is turned by `shift`: v_k - stored_k exp(i k shift).

    Args:
        correction: made from another curve, or from this one.
        order: of the curve, each once (k,).
        value: its complex amplitudes, rad (k,).
        shift: of the table against the output, rad.

    Raises:
        ValueError: as for `correction`.
    """
    orders, values = _curve(order, value)
    if not math.isfinite(shift):
        raise ValueError(f"shift = {shift!r} rad: must be finite")
    both = np.union1d(orders, correction.order)
    left = np.zeros(len(both), complex)
    left[np.searchsorted(both, orders)] = values
    left[np.searchsorted(both, correction.order)] -= correction.value * np.exp(1j * correction.order * shift)
    return Residual(both, left, float(np.sqrt(np.sum(np.abs(left) ** 2) / 2)))


@checked
def phase_residual(order: ArrayLike, shift: Scalar) -> np.ndarray:
    """Compute the share of an order's amplitude that remains if its exact correction is turned: 2 |sin(order shift/2)|.

    Above 60 degrees of phase it exceeds 1: the correction makes the error worse.

    Args:
        order: per output turn.
        shift: rad of the output.
    """
    return 2 * np.abs(np.sin(numbers("order", order) * shift / 2))


@checked
def predicted(correction: Correction, *, draws: int = 4096, seed: int = 0, confidence: float = 0.95) -> Left:
    """Predict the residual when the unit is measured again, with intervals.

    Draws the amplitudes about the given ones and one common turn of the table; the peak to peak is no sum over the
    orders, so that there is no closed form for it.

    Args:
        correction: of one curve.
        draws: of amplitudes and zero.
        seed: of the random numbers.
        confidence: of the intervals.

    Raises:
        ValueError: fewer than two draws, or a confidence that is no share.
    """
    if draws < 2:
        raise ValueError(f"draws = {draws!r}: must be at least 2")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence!r}: must lie between 0 and 1")
    rng = np.random.default_rng(seed)
    order = correction.given_order
    noise = rng.standard_normal((draws, 2, len(order)))
    truth = correction.given_value + correction.sd * (noise[:, 0] + 1j * noise[:, 1])
    shift = correction.angle_sd * rng.standard_normal(draws)
    left = truth - correction.stored * np.exp(1j * shift[:, None] * order)
    points = 8 * (int(order.max(initial=1)) + 1)  # eight to a wave of the highest order: 2 % of a peak at most
    waves = np.exp(2j * np.pi * np.outer(order, np.arange(points)) / points)
    rms = np.sqrt(np.sum(np.abs(left) ** 2, axis=1) / 2)
    peaks = [np.ptp((left[k : k + CURVES] @ waves).real, axis=1) for k in range(0, draws, CURVES)]

    def estimate(size: np.ndarray) -> Estimate:
        lower, upper = np.quantile(size, [(1 - confidence) / 2, (1 + confidence) / 2])
        return Estimate(float(size.mean()), float(size.std(ddof=1)), float(lower), float(upper))

    return Left(estimate(rms), estimate(np.concatenate(peaks)))
