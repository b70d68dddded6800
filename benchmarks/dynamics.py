"""Speed sweep and harmonic balance of the RV-320E against dense NumPy, C and time integration.

Sweep: output-wheel rotation, planetary stage, 2000 speeds x 9 harmonics. C solves the same reduced problem (the
11-coordinate rotational block at the excited harmonics, matrices given) and the dense one; ours starts from the
design and includes its eigenproblem. Harmonic balance: 30 harmonics, all couplings, against the dense system of
39 x 61 unknowns and against integration in time until the transient is gone.
"""

import ctypes

from benchmarks import timing

timing.settings()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from rvjax import Damping, dynamics  # noqa: E402
from rvjax.catalogue import RV_320E  # noqa: E402
from rvjax.units import rpm  # noqa: E402
from tests.oracles.dynamics import Oracle  # noqa: E402

TORQUE, RATED = -3136.0, 1000 * rpm
SPEEDS = np.linspace(200, 4000, 2000) * rpm
HARMONICS = 9

C_SOURCE = r"""
#include <complex.h>
#include <string.h>
typedef double complex z;
/* |x_out| of (K (1 + i eta) - (l w)^2 M) x = b_l for speeds x harmonics, LU with row pivoting, n <= 64 */
void sweep(int n, const double *K, const double *m, const double *b, const int *order, int harmonics,
           const double *w, int speeds, double eta, int out, double *amplitude) {
  #pragma omp parallel for schedule(static)
  for (int s = 0; s < speeds; s++) for (int h = 0; h < harmonics; h++) {
    z A[64 * 64], x[64];
    double q = order[h] * w[s] * order[h] * w[s];
    for (int i = 0; i < n * n; i++) A[i] = K[i] + I * eta * K[i];
    for (int i = 0; i < n; i++) { A[i * n + i] -= q * m[i]; x[i] = b[2 * (h * n + i)] + I * b[2 * (h * n + i) + 1]; }
    for (int k = 0; k < n; k++) {
      int p = k; double best = 0;
      for (int i = k; i < n; i++) {
        double a = creal(A[i*n+k]) * creal(A[i*n+k]) + cimag(A[i*n+k]) * cimag(A[i*n+k]);
        if (a > best) { best = a; p = i; }
      }
      if (p != k) {
        for (int j = k; j < n; j++) { z t = A[k*n+j]; A[k*n+j] = A[p*n+j]; A[p*n+j] = t; }
        z t = x[k]; x[k] = x[p]; x[p] = t;
      }
      z inverse = conj(A[k*n+k]) / best;
      for (int i = k + 1; i < n; i++) {
        z f = A[i*n+k] * inverse;
        for (int j = k + 1; j < n; j++) A[i*n+j] -= f * A[k*n+j];
        x[i] -= f * x[k];
      }
    }
    for (int k = n - 1; k >= 0; k--) {
      for (int j = k + 1; j < n; j++) x[k] -= A[k*n+j] * x[j];
      x[k] /= A[k*n+k];
    }
    amplitude[s * harmonics + h] = cabs(x[out]);
  }
}
"""


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


def c_sweep(library, stiffness, mass, loads, orders, frequencies, eta, out):
    """A closure that runs the C sweep and returns |x_out| (speeds, harmonics)."""
    arrays = [np.ascontiguousarray(a, float) for a in (stiffness, mass, np.stack([loads.real, loads.imag], -1))]
    orders, frequencies = np.ascontiguousarray(orders, np.int32), np.ascontiguousarray(frequencies)
    result = np.empty((len(frequencies), len(orders)))

    def run():
        library.sweep(
            len(mass), *map(pointer, arrays), pointer(orders), len(orders), pointer(frequencies), len(frequencies),
            ctypes.c_double(eta), out, pointer(result),
        )  # fmt: skip
        return result

    return run


def sweep() -> dict:
    """Speed sweep of the output rotation."""
    eta = 0.02
    design = RV_320E.replace(damping=Damping(loss_factor=eta))
    oracle = Oracle(design)
    w = np.array([oracle.frequency("planetary", n) for n in SPEEDS])
    rows, k, phase, a = oracle.stage("planetary", HARMONICS)
    orders = np.arange(1, HARMONICS + 1)
    loads = np.stack([-a[l - 1] * (np.exp(1j * l * phase) * (k * (rows @ oracle.mean(TORQUE)))) @ rows for l in orders])  # noqa: E741

    def one(design, speed):
        found = dynamics.response(
            design, sun_speed=speed, output_torque=TORQUE, harmonics=HARMONICS, outputs=("output.rotation",)
        )
        return jnp.abs(found.amplitude[:, 0])

    arguments = (jax.tree.map(jnp.asarray, design), jnp.asarray(SPEEDS))
    program, compiled = timing.compiled(jax.vmap(one, in_axes=(None, 0)), *arguments)

    def dense(frequencies=w):
        matrix = np.repeat((oracle.K * (1 + 1j * eta))[None], len(frequencies) * HARMONICS, axis=0)
        square = (frequencies[:, None] * orders).ravel() ** 2
        matrix[:, range(39), range(39)] -= square[:, None] * oracle.m
        rhs = np.tile(loads, (len(frequencies), 1))[..., None]
        return np.abs(np.linalg.solve(matrix, rhs)[:, -1, 0]).reshape(-1, HARMONICS)

    block = dynamics.blocks(design).rotational
    basis = dynamics.symmetry.sector(4, 3, "rotational")
    excited = np.array([4, 8])
    candidates = {"rvjax": lambda: program(*arguments), "NumPy dense": dense}
    library = timing.c_library(C_SOURCE)
    if library is not None:
        full = (oracle.K, oracle.m, loads, orders, w, eta, 38)
        reduced = (np.asarray(block.stiffness), np.asarray(block.mass), loads[excited - 1] @ basis, excited, w, eta, 10)
        candidates |= {"C dense": c_sweep(library, *full), "C reduced": c_sweep(library, *reduced)}
    expected = dense()
    scale = expected.max(axis=0)[excited - 1]
    for name, run in candidates.items():
        found = np.asarray(run())
        found = found if found.shape[1] == 2 else found[:, excited - 1]
        worst = np.max(np.abs(found - expected[:, excited - 1]) / scale)
        assert worst < 1e-8, (name, worst)
    seconds = timing.alternate(candidates, seconds=1.0)
    figures = {f"sweep {name} (ms)": 1e3 * value for name, value in seconds.items()}
    ours = seconds["rvjax"]
    figures |= {f"sweep {name} / rvjax": value / ours for name, value in seconds.items() if name != "rvjax"}
    return figures | {f"sweep {name}": value for name, value in compiled.items()}


def integrate(design, oracle, w, periods):
    """Output rotation over the last period by DOP853, from the mean deflection at rest."""
    from scipy.integrate import solve_ivp

    rows, k, phase, _ = oracle.stage("planetary", 1)
    variation, root = design.mesh_variation, np.sqrt(oracle.m)
    scaled = oracle.K / np.outer(root, root)
    values, vectors = np.linalg.eigh(scaled)
    modal, own = oracle.load(TORQUE) / root @ vectors, rows / root @ vectors
    drag = 2 * design.damping.modal_ratio * np.sqrt(values)
    high, low = (
        variation.planetary_swing * (1 - variation.planetary_duty),
        -variation.planetary_swing * variation.planetary_duty,
    )

    def slope(t, state):
        q, v = state[:39], state[39:]
        turn = np.mod(w * t + phase + np.pi, 2 * np.pi) - np.pi
        level = np.where(np.abs(turn) < np.pi * variation.planetary_duty, high, low)
        return np.concatenate([v, modal - values * q - drag * v - (level * k * (own @ q)) @ own])

    period = 2 * np.pi / w
    times = (periods - 1 + np.arange(64) / 64) * period
    start = np.concatenate([modal / values, np.zeros(39)])
    found = solve_ivp(slope, (0, times[-1]), start, "DOP853", times, rtol=1e-6, atol=1e-12, max_step=period / 50)
    return found.y[:39].T @ (vectors / root[:, None])[-1]


def balance() -> dict:
    """Harmonic balance and how its error falls with the number of harmonics."""
    design = RV_320E.replace(damping=Damping(modal_ratio=0.02))
    oracle, count = Oracle(design), 30
    w = oracle.frequency("planetary", RATED)
    outputs = ("output.x", "output.rotation", "sun.rotation")

    def ours(harmonics, method="harmonic_balance"):
        def run(design):
            found = dynamics.response(
                design, sun_speed=RATED, output_torque=TORQUE, harmonics=harmonics, method=method, outputs=outputs
            )
            return found.mean, found.amplitude

        return timing.compiled(run, arguments)[0]

    arguments = jax.tree.map(jnp.asarray, design)
    time = np.arange(64) / 64

    def curve(mean, amplitude):
        waves = np.exp(2j * np.pi * np.outer(time, np.arange(1, len(amplitude) + 1)))
        return np.asarray(mean) + (waves @ np.asarray(amplitude)).real

    exact = dynamics.periodic(design, sun_speed=RATED, output_torque=TORQUE, outputs=outputs)
    exact_curve = np.asarray(exact.deflection)
    moving = exact_curve - np.asarray(dynamics.static(design, output_torque=TORQUE).deflection)[[36, 38, 2]]
    size = np.sqrt(np.mean(moving**2, axis=0))

    program = ours(count)
    full = oracle.harmonic_balance("planetary", w, count, TORQUE)[count + 1 :, [36, 38, 2]] * 2
    found = np.asarray(program(arguments)[1])
    worst = np.max(np.abs(found - full) / np.abs(full).max(axis=0))
    assert worst < 1e-9, worst
    integrated = integrate(design, oracle, w, 40)
    figures = {
        "balance H=30 against dense, worst": float(worst),
        "integration against exact, rms of output.rotation": float(
            np.sqrt(np.mean((integrated - exact_curve[:, 1]) ** 2)) / size[1]
        ),
    }
    candidates = {
        "rvjax balance H=30": lambda: program(arguments),
        "rvjax exact periodic": lambda: (
            dynamics.periodic(design, sun_speed=RATED, output_torque=TORQUE, outputs=outputs).deflection
        ),
        "dense balance H=30": lambda: oracle.harmonic_balance("planetary", w, count, TORQUE),
        "time integration": lambda: integrate(design, oracle, w, 40),
    }
    seconds = timing.alternate(candidates, seconds=1.0, rounds=3)
    figures |= {f"{name} (ms)": 1e3 * value for name, value in seconds.items()}
    base = seconds["rvjax balance H=30"]
    figures |= {
        f"{name} / rvjax balance": value / base
        for name, value in seconds.items()
        if "balance H" not in name or "dense" in name
    }

    levels = [("first_order", h) for h in (1, 3, 9, 30, 60)] + [("harmonic_balance", h) for h in (9, 30, 60, 120, 250)]
    print(f"{'level':24s}" + "".join(f"{name:>18s}" for name in outputs) + f"{'ms':>10s}")
    for method, harmonics in levels:
        run = ours(harmonics, method)
        error = np.sqrt(np.mean((curve(*run(arguments)) - exact_curve) ** 2, axis=0)) / size
        spent = timing.alternate({"run": lambda run=run: run(arguments)}, seconds=0.2, rounds=5)["run"]
        print(f"{method + ' ' + str(harmonics):24s}" + "".join(f"{e:18.2e}" for e in error) + f"{1e3 * spent:10.2f}")
        figures |= {f"rms error {method} {harmonics} {name}": float(e) for name, e in zip(outputs, error)}
        figures[f"time {method} {harmonics} (ms)"] = 1e3 * spent
    return figures


def main() -> None:
    """Run both benchmarks."""
    options = timing.arguments(__doc__)
    timing.publish("dynamics", sweep() | balance(), options.json)


if __name__ == "__main__":
    main()
