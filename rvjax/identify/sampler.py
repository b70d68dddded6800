"""`sample`: the posterior without the normal approximation, by the No-U-Turn sampler (Hoffman and Gelman 2014).

Chains move in v, z = z^ + L v with L L' the covariance at the heaviest mode, where one step size fits all. They start
around the modes in turn, at twice the spread: from one mode all of them would stay there and agree perfectly. Chains in
different modes disagree; r_hat shows it.
"""

import dataclasses
import importlib

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax._jax.checks import checked
from rvjax.base import frames
from rvjax.identify.elements import mapped_values
from rvjax.identify.gauss_newton import half_square, mixed
from rvjax.identify.identification import Given, Model, Vector, counted, forward, residuals
from rvjax.identify.posterior import Posterior
from rvjax.identify.search import FAINT
from rvjax.population import root_key
from rvjax.records import PyTree
from rvjax.response import per_response

SPREAD = 2.0
"""Spread of the starts about a mode, in its standard deviations."""

R_HAT, ESS, DIVERGENT = 1.01, 400.0, 0.01
"""Most disagreement of chains, least effective draws, and largest share of divergent ones, of draws to be trusted."""


@dataclasses.dataclass(frozen=True, eq=False)
class Draws:
    """Values sampled from a posterior.

    Attributes:
        value: structure of the prior, leaves (chains, draws, ...), SI.
        r_hat: disagreement of the chains about each standard number, 1 for none (numbers,).
        ess: effective draws of each (numbers,).
        divergences: draws at which the integrator failed.
        trusted: r_hat below 1.01, ess above 400 and less than 1 % divergences.
        z: the standard numbers (chains, draws, numbers).
        posterior: that was sampled.
    """

    value: PyTree
    r_hat: np.ndarray
    ess: np.ndarray
    divergences: int
    trusted: bool
    z: np.ndarray = dataclasses.field(repr=False)
    posterior: Posterior = dataclasses.field(repr=False)

    def to_arviz(self) -> object:
        """The draws as ArviZ data (a package to be installed separately), by name of the field."""
        arviz = importlib.import_module("arviz")
        elements = self.posterior.problem.elements
        values = {name: np.asarray(leaf) for name, leaf in elements.beside("value", self.value).items()}
        if int(arviz.__version__.split(".")[0]) > 0:
            return arviz.from_dict({"posterior": values})
        return arviz.from_dict(posterior=values)


@checked
def sample(posterior: Posterior, *, chains: int = 4, warmup: int = 500, draws: int = 1000, seed: int = 0) -> Draws:
    """Sample a posterior; needs the extra `sampler`.

    Args:
        posterior: of `solve`.
        chains: at least as many as modes, that none is missed.
        warmup: steps of each chain that adapt it and are dropped.
        draws: of each chain.
        seed: of all of them.

    Raises:
        ValueError: an argument that does not fit, or a posterior without a mode.
        ImportError: blackjax is not installed.
    """
    for name, value, least in (("chains", chains, 1), ("warmup", warmup, 20), ("draws", draws, 4)):
        counted(name, value, least)
    if not posterior.peaks:
        raise ValueError(f"posterior: status {posterior.status}, it must have a mode")
    frames.needed("blackjax", "rvjax.identify.sample", "sampler")
    problem, peak = posterior.problem, posterior.peaks[0]
    key = root_key(seed)
    root = peak.spectrum.root
    inverse = peak.spectrum.right.T * np.sqrt(1 + peak.spectrum.eigenvalues)[:, None]
    heavy = [p for p, mode in zip(posterior.peaks, posterior.modes) if mode.weight > FAINT]
    about = [heavy[k % len(heavy)] for k in range(chains)]
    normal = np.asarray(jax.random.normal(jax.random.fold_in(key, 0), (chains, peak.z.size)))
    starts = np.stack([p.z + SPREAD * p.spectrum.root @ xi for p, xi in zip(about, normal)])
    # blackjax mixes dtypes and ranks, which a user's settings may forbid.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        v, divergent = run(
            problem.model,
            problem.device,
            jnp.asarray(posterior.data),
            jnp.asarray(peak.z),
            jnp.asarray(root),
            jnp.asarray((starts - peak.z) @ inverse.T),
            jax.random.split(jax.random.fold_in(key, 1), chains),
            warmup=warmup,
            draws=draws,
        )
    z = peak.z + np.asarray(v) @ root.T
    r_hat, ess = diagnose(z)
    divergences = int(np.asarray(divergent).sum())
    flat = mapped_values(problem.elements, z.reshape(-1, z.shape[-1]) @ problem.elements.mixing.T)
    trusted = r_hat.max() < R_HAT and ess.min() > ESS and divergences < DIVERGENT * chains * draws
    return Draws(
        value=problem.elements.structure(flat.reshape(chains, draws, -1)),
        r_hat=r_hat,
        ess=ess,
        divergences=divergences,
        trusted=bool(trusted),
        z=z,
        posterior=posterior,
    )


@per_response(static=("warmup", "draws"))
def run(
    model: Model,
    given: Given,
    y: jax.Array,
    centre: jax.Array,
    root: jax.Array,
    starts: jax.Array,
    keys: jax.Array,
    *,
    warmup: int,
    draws: int,
) -> tuple[jax.Array, jax.Array]:
    """v (chains, draws, n) and which of them diverged (chains, draws)."""
    import blackjax

    density = _density(lambda z: residuals(model, given, y, mixed(given.mixing, z)), given.dof)

    def logarithm(v: jax.Array) -> jax.Array:
        return density(centre + root @ v)

    def chain(key: jax.Array, start: jax.Array) -> tuple[jax.Array, jax.Array]:
        adapting, sampling = jax.random.split(key)
        adaptation = blackjax.window_adaptation(blackjax.nuts, logarithm)
        (state, parameters), _ = adaptation.run(adapting, start, num_steps=warmup)
        step = blackjax.nuts(logarithm, **parameters).step

        def advance(state: PyTree, key: jax.Array) -> tuple[object, tuple[jax.Array, jax.Array]]:
            state, info = step(key, state)
            return state, (state.position, info.is_divergent)

        positions: tuple[jax.Array, jax.Array] = jax.lax.scan(advance, state, jax.random.split(sampling, draws))[1]
        return positions

    return jax.vmap(chain)(keys, starts)


def _density(apart: Vector, dof: jax.Array | None) -> Vector:
    """Logarithm of the posterior's density over z, differentiable also where the model supports only tangents."""

    def phi(residual: jax.Array) -> jax.Array:
        return -half_square(residual, dof)

    @jax.custom_vjp
    def density(z: jax.Array) -> jax.Array:
        return both(z)[0]

    def both(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        try:
            value, slope = jax.value_and_grad(lambda z: phi(apart(z)))(z)
        except (TypeError, ValueError, NotImplementedError):
            residual, slopes = forward(apart, z)
            value, pull = jax.value_and_grad(phi)(residual)
            slope = pull @ slopes
        sound = jnp.isfinite(value) & jnp.all(jnp.isfinite(slope))
        return jnp.where(sound, value - jnp.sum(z**2) / 2, -jnp.inf), jnp.where(sound, slope - z, 0.0)

    density.defvjp(both, lambda slope, cotangent: (cotangent * slope,))
    return density


def diagnose(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split r_hat and effective draws of rank-normalised chains z (chains, draws, n).

    After Vehtari, Gelman, Simpson, Carpenter and Buerkner (2021, Bayesian Analysis 16, 667): ranks of the draws, and of
    their distances from the median, which shows chains that differ in spread alone.
    """
    half = z.shape[1] // 2
    split = np.concatenate([z[:, :half], z[:, -half:]])
    folded = np.abs(split - np.median(split, axis=(0, 1)))
    first, second = (_normalise(item) for item in (split, folded))
    return np.maximum(_r_hat(first), _r_hat(second)), _effective(first)


def _normalise(chains: np.ndarray) -> np.ndarray:
    from scipy import stats  # slow to import

    ranks = stats.rankdata(chains.reshape(-1, chains.shape[-1]), axis=0).reshape(chains.shape)
    return np.asarray(special.ndtri((ranks - 0.375) / (ranks.shape[0] * ranks.shape[1] + 0.25)))


def _r_hat(chains: np.ndarray) -> np.ndarray:
    n = chains.shape[1]
    within = chains.var(axis=1, ddof=1).mean(axis=0)
    between = n * chains.mean(axis=1).var(axis=0, ddof=1)
    return np.asarray(np.sqrt(((n - 1) / n * within + between / n) / within))


def _effective(chains: np.ndarray) -> np.ndarray:
    """Effective draws, with Geyer's (1992, Statistical Science 7, 473) initial monotone sums of autocorrelations."""
    count, n = chains.shape[:2]
    centred = chains - chains.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(centred, 2 * n, axis=1)) ** 2
    covariance = np.fft.irfft(spectrum, axis=1)[:, :n] / n
    within = (covariance[:, 0] * n / (n - 1)).mean(axis=0)
    total = within * (n - 1) / n + chains.mean(axis=1).var(axis=0, ddof=1)
    rho = 1 - (within - covariance.mean(axis=0)) / total
    rho[0] = 1.0
    pairs = rho[: n // 2 * 2].reshape(-1, 2, rho.shape[-1]).sum(axis=1)
    positive = np.cumprod(pairs > 0, axis=0)
    monotone = np.minimum.accumulate(pairs, axis=0) * positive
    return count * n / np.maximum(2 * monotone.sum(axis=0) - 1, 1 / np.log10(count * n))
