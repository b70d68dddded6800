"""Peak-to-peak transmission error of RV-40E units over one crank turn of 64 angles, phase-locked, unloaded.

A million newly sampled units run through `monte_carlo` in chunks. A chunk of units, alternating in one process,
runs through the library's bare kernel and through what one would write without it: C (gcc -O3 -march=native
-ffast-math; the same polynomial, and the extreme tangents, of all angles and, with the library's shortcut, of those
next to the crest), NumPy vectorised in chunks, and a
loop over `scipy.optimize.brentq` for each unit, angle and disc. The results are compared first. Run on one core
(`taskset -c 0`) for the ratio to C.
"""

import ctypes
import math
import resource
import time

import numpy as np

from benchmarks.timing import alternate, arguments, c_library, compiled, publish, settings

settings()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
from scipy.optimize import brentq  # noqa: E402

from rvjax import RVErrors, catalogue, four_bar  # noqa: E402
from rvjax.tolerances import Tolerance, for_design, monte_carlo  # noqa: E402
from rvjax.units import arcmin, arcsec, um  # noqa: E402

UNITS, CHUNK, ANGLES, LOOP_UNITS = 1_000_000, 32_768, 64, 4
E, R = 1.3e-3, 36e-3
TURN = 2 * np.pi / ANGLES * np.arange(ANGLES)

# Errors of a unit, in the order of the columns below: delta[disc][crank], psi[crank],
# disc bores [disc][crank][radial, tangential], carrier bores [crank][radial, tangential], eccentricity.
C_SOURCE = r"""
#include <math.h>
#define N 512
static void block(const double *restrict x, long stride, int angles, const double *cosine, const double *sine,
                  double *restrict out, int crest)
{   /* x[j * stride + u]: number j of unit u; N units at once, the angle loop outside; crest: angles next to it alone */
    const double R = 36e-3, E = 1.3e-3;
    double g[2][4][N], top[N], low[N];
    for (int k = 0; k < 2; k++)
        for (int u = 0; u < N; u++) {
#define X(j) x[(j) * stride + u]
            double r0 = X(6 + 4 * k), t0 = X(7 + 4 * k), r1 = X(8 + 4 * k), t1 = X(9 + 4 * k);
            double qx = 0.5 * (r1 + r0), qy = 0.5 * (t1 + t0), Qx = R + qx;   /* seats +-(Qx, qy) about their mean */
            double K0x = -X(14), K0y = -X(15), K1x = X(16), K1y = X(17), e = E + X(18);
            double h0 = 0.5 * X(4), h1 = 0.5 * X(5);
            double v0 = h0 * h0 * (2 - h0 * h0 * (2.0 / 3 - h0 * h0 * 4.0 / 45));   /* 1 - cos, |psi| small */
            double v1 = h1 * h1 * (2 - h1 * h1 * (2.0 / 3 - h1 * h1 * 4.0 / 45));
            double s0 = X(4) * (1 - X(4) * X(4) / 6 * (1 - X(4) * X(4) / 20));
            double s1 = X(5) * (1 - X(5) * X(5) / 6 * (1 - X(5) * X(5) / 20));
            double dA = X(2 * k + 1) * (1 - v1) - e * v1 - X(2 * k) * (1 - v0) + e * v0;
            double dB = (e + X(2 * k + 1)) * s1 - (e + X(2 * k)) * s0;
            double dx = K1x - K0x, dy = K1y - K0y;
            g[k][0][u] = 2 * R * R + R * (r0 + r1) + Qx * dx + qy * dy;
            g[k][1][u] = Qx * dy - qy * dx - R * (t0 + t1);
            g[k][2][u] = dA * Qx + dB * qy;
            g[k][3][u] = dB * Qx - dA * qy;
        }
    double rest[N], place[N];
    for (int u = 0; u < N; u++) { top[u] = -1e300; low[u] = 1e300; }
    for (int u = 0; u < N; u++) {   /* at least sum m |m-th harmonic| of the angles; see `first_wave` */
        double squares = 0, off = 0, unit = 1 / (2 * R * R);
        for (int k = 0; k < 2; k++) {
            double w = unit * unit * (g[k][2][u] * g[k][2][u] + g[k][3][u] * g[k][3][u]);
            double o = fabs(unit * g[k][0][u] - 1) + fabs(unit * g[k][1][u]);
            squares += w;
            off = fmax(off, fmax(o, sqrt(w)));
        }
        rest[u] = off < 1.0 / 64 ? 1.05 * squares : 1e300;
    }
    for (int u = 0; u < N; u++) {   /* (g0 + G0 z) (g1 - G1 z) = a0 + z (a1 + z a2), z = exp(i angle) */
        double a = g[0][0][u], b = g[0][1][u], A = g[0][2][u], B = g[0][3][u];
        double p = g[1][0][u], q = g[1][1][u], P = g[1][2][u], Q = g[1][3][u];
        g[0][0][u] = a * p - b * q;
        g[0][1][u] = a * q + b * p;
        g[0][2][u] = A * p - B * q - a * P + b * Q;
        g[0][3][u] = A * q + B * p - a * Q - b * P;
        g[1][0][u] = B * Q - A * P;
        g[1][1][u] = -A * Q - B * P;
    }
    int open = 0;
    if (crest) {
        double step = 6.283185307179586 / angles, reach = sin(step);
        int last = angles - 1;   /* angles a power of two */
        for (int u = 0; u < N; u++) {   /* first harmonic Im(a1 / a0 z) */
            double qx = g[0][2][u] * g[0][0][u] + g[0][3][u] * g[0][1][u];
            double qy = g[0][3][u] * g[0][0][u] - g[0][2][u] * g[0][1][u];
            double size = g[0][0][u] * g[0][0][u] + g[0][1][u] * g[0][1][u];
            double r = rest[u] * size;
            place[u] = floor(atan2(qx, qy) / step);
            rest[u] = r * r < (qx * qx + qy * qy) * reach * reach;
            open += rest[u] == 0;
        }
        for (int i = -1; i < 3; i++)
            for (int side = 0; side < 2; side++)
                for (int u = 0; u < N; u++) {
                    int j = ((int)place[u] + i + side * angles / 2) & last;
                    double c = cosine[j], s = sine[j];
                    double x = g[0][2][u] + (g[1][0][u] * c - g[1][1][u] * s);
                    double y = g[0][3][u] + (g[1][1][u] * c + g[1][0][u] * s);
                    double t = (g[0][1][u] + (y * c + x * s)) / (g[0][0][u] + (x * c - y * s));
                    top[u] = t > top[u] ? t : top[u];
                    low[u] = t < low[u] ? t : low[u];
                }
        if (open)
            for (int u = 0; u < N; u++)
                for (int j = 0; rest[u] == 0 && j < angles; j++) {
                    double c = cosine[j], s = sine[j];
                    double x = g[0][2][u] + (g[1][0][u] * c - g[1][1][u] * s);
                    double y = g[0][3][u] + (g[1][1][u] * c + g[1][0][u] * s);
                    double t = (g[0][1][u] + (y * c + x * s)) / (g[0][0][u] + (x * c - y * s));
                    top[u] = t > top[u] ? t : top[u];
                    low[u] = t < low[u] ? t : low[u];
                }
    }
    else for (int j = 0; j < angles; j++) {
        double c = cosine[j], s = sine[j];
        for (int u = 0; u < N; u++) {
            double x = g[0][2][u] + (g[1][0][u] * c - g[1][1][u] * s);
            double y = g[0][3][u] + (g[1][1][u] * c + g[1][0][u] * s);
            double t = (g[0][1][u] + (y * c + x * s)) / (g[0][0][u] + (x * c - y * s));
            top[u] = t > top[u] ? t : top[u];
            low[u] = t < low[u] ? t : low[u];
        }
    }
    for (int u = 0; u < N; u++) out[u] = 0.5 * (atan(top[u]) - atan(low[u]));
}
void peak_to_peak(const double *x, long units, int angles, const double *cosine, const double *sine, double *out)
{
    for (long u = 0; u < units; u += N) block(x + u, units, angles, cosine, sine, out + u, 0);
}
void beside_crest(const double *x, long units, int angles, const double *cosine, const double *sine, double *out)
{
    for (long u = 0; u < units; u += N) block(x + u, units, angles, cosine, sine, out + u, 1);
}
"""


def drawn(units, seed=0):
    """Columns (19, units) in SI, normal with the spread of a usual tolerance."""
    rng = np.random.default_rng(seed)
    spread = np.array([3e-6] * 4 + [1e-4] * 2 + [3e-6] * 12 + [3e-6])
    return rng.normal(size=(19, units)) * spread[:, None]


def as_errors(x):
    """The columns as RVErrors with the units on the last axis."""
    blank = jax.tree.map(lambda _: jnp.zeros(x.shape[1]), RVErrors())
    leaves, tree = jax.tree.flatten_with_path(blank)
    shapes = dict(
        crank_eccentricity=x[:4].reshape(2, 2, -1),
        crank_phase=x[4:6],
        disc_bore=x[6:14].reshape(2, 2, 2, -1),
        carrier_bore=x[14:18].reshape(2, 2, -1),
        eccentricity=x[18],
    )
    return tree.unflatten([jnp.asarray(shapes.get(path[0].name, leaf)) for path, leaf in leaves])


def library(errors):
    """Peak to peak of a batch."""
    return jax.vmap(lambda e: four_bar.revolution(catalogue.RV_40E, e, angles=ANGLES).peak_to_peak, in_axes=-1)(errors)


def mean(tolerances, errors):
    """Mean over the batch; each tolerance scales the errors of its field."""
    return jnp.mean(library(jax.tree.map(lambda t, e: t * e, tolerances, errors)))


def vectorised(x, chunk=2048):
    """NumPy: linkage vectors (units, angles) and one arctan2 each."""
    out = np.empty(x.shape[1])
    for first in range(0, x.shape[1], chunk):
        part = x[:, first : first + chunk, None]
        error = 0.0
        for k, base in enumerate((0.0, np.pi)):
            b, e, psi = TURN + base, E + part[18], part[4:6]
            d, bore = part[2 * k : 2 * k + 2], part[6 + 4 * k : 10 + 4 * k]
            w = e * 2 * np.sin(psi / 2)
            move_x = [d[i] * np.cos(b + psi[i]) - w[i] * np.sin(b + psi[i] / 2) for i in (0, 1)]
            move_y = [d[i] * np.sin(b + psi[i]) + w[i] * np.cos(b + psi[i] / 2) for i in (0, 1)]
            px = part[14] + part[16] + move_x[1] - move_x[0]
            py = part[15] + part[17] + move_y[1] - move_y[0]
            qx, qy = bore[0] + bore[2], bore[1] + bore[3]
            error = error - 0.5 * (np.arctan2(py, 2 * R + px) - np.arctan2(qy, 2 * R + qx))
        out[first : first + chunk] = error.max(axis=1) - error.min(axis=1)
    return out


def root_loop(x):
    """SciPy: brentq on the exact least-squares condition for each unit, angle and disc."""
    out = []
    for column in x.T:
        errors = []
        for b1 in TURN:
            total = 0.0
            for k in (0, 1):
                b, e = b1 + math.pi * k, E + column[18]
                r0, t0, r1, t1 = column[6 + 4 * k : 10 + 4 * k]
                pins = [
                    complex(sign * (R + column[14 + 2 * i]), sign * column[15 + 2 * i])
                    + (e + column[2 * k + i]) * complex(math.cos(b + column[4 + i]), math.sin(b + column[4 + i]))
                    for i, sign in ((0, -1), (1, 1))
                ]
                pin, bore = pins[1] - pins[0], complex(2 * R + r0 + r1, t0 + t1)
                s, c = (bore.conjugate() * pin).imag, (bore.conjugate() * pin).real
                total -= brentq(lambda a, s=s, c=c: c * math.sin(a) - s * math.cos(a), -1.5, 1.5, xtol=1e-16) / 2
            errors.append(total)
        out.append(max(errors) - min(errors))
    return np.array(out)


def million_units():
    """Statistics of newly sampled units, chunk by chunk: time and the growth of the process's memory."""
    tolerances = for_design(
        catalogue.RV_40E,
        crank_eccentricity=Tolerance.symmetric(6.5 * um),
        crank_phase=Tolerance.symmetric(5 * arcmin),
        disc_bore=Tolerance.symmetric(6.5 * um),
        carrier_bore=Tolerance.symmetric(6.5 * um),
    )

    def peak_to_peak(errors):
        return four_bar.revolution(catalogue.RV_40E, errors, angles=ANGLES).peak_to_peak

    figures = {}
    for units in (CHUNK, UNITS // 4, UNITS):  # the first compiles
        start = time.perf_counter()
        found = monte_carlo(peak_to_peak, tolerances, samples=units, seed=1, chunk=CHUNK)
        figures[f"seconds_{units}_units"] = time.perf_counter() - start
        figures[f"peak_memory_MB_after_{units}_units"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    figures["mean_peak_to_peak_arcsec"] = found.mean.value / arcsec
    figures["mean_standard_error_arcsec"] = found.mean.error / arcsec
    return figures


def main():
    path = arguments(__doc__.splitlines()[0]).json
    x = drawn(CHUNK)
    errors = as_errors(x)
    run, notes = compiled(library, errors)
    tolerances = jax.tree.map(lambda _: jnp.ones(()), RVErrors())
    primal, _ = compiled(mean, tolerances, errors)
    gradient, gradient_notes = compiled(jax.value_and_grad(mean), tolerances, errors)
    candidates = {"library": lambda: run(errors), "numpy": lambda: vectorised(x[:, :2048])}
    expected = np.asarray(run(errors))
    np.testing.assert_allclose(vectorised(x[:, :2048]), expected[:2048], rtol=1e-9)
    np.testing.assert_allclose(root_loop(x[:, :LOOP_UNITS]), expected[:LOOP_UNITS], rtol=1e-8)
    library_c = c_library(C_SOURCE)
    if library_c is not None:
        out, cosine, sine = np.empty(CHUNK), np.cos(TURN), np.sin(TURN)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (x, cosine, sine, out)]

        for name, program in {"C": library_c.peak_to_peak, "C_beside_crest": library_c.beside_crest}.items():

            def in_c(program=program):
                program(pointers[0], ctypes.c_long(CHUNK), ANGLES, *pointers[1:])

            in_c()
            np.testing.assert_allclose(out, expected, rtol=1e-9)
            candidates[name] = in_c
    best = alternate(candidates)
    both = alternate({"mean": lambda: primal(tolerances, errors), "gradient": lambda: gradient(tolerances, errors)})
    start = time.perf_counter()
    root_loop(x[:, :LOOP_UNITS])
    loop = (time.perf_counter() - start) / LOOP_UNITS
    million = million_units()
    ns = {"library": best["library"] / CHUNK, "numpy": best["numpy"] / 2048, "scipy": loop}
    ns |= {name: best[name] / CHUNK for name in ("C", "C_beside_crest") if name in best}
    figures = {f"{name}_ns_per_unit": 1e9 * value for name, value in ns.items()}
    figures |= {f"{name}_over_library": value / ns["library"] for name, value in ns.items() if name != "library"}
    figures |= {f"library_over_{name}": ns["library"] / ns[name] for name in ("C", "C_beside_crest") if name in ns}
    figures |= {
        "gradient_over_mean": both["gradient"] / both["mean"],
        **million,
        "units_per_chunk": CHUNK,
        "angles": ANGLES,
        **notes,
        **{f"gradient_{key}": value for key, value in gradient_notes.items()},
    }
    publish("four_bar", figures, path)


if __name__ == "__main__":
    main()
