"""One linkage at one crank angle, closed form, phase-locked or free cranks: coupler angle of a batch, its gradient.

In one process with the library, in turn: C (gcc -O3 -march=native -ffast-math, 64 cases side by side; sine, cosine
and inverse tangent as branch-free polynomials, for library calls would not vectorise) and NumPy. The results are
compared first. Run on one core (`taskset -c 0`) for the ratio to C.
"""

import ctypes
import functools

import numpy as np

from benchmarks.timing import alternate, arguments, c_library, compiled, publish, settings

settings()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

from rvjax import LinkDeviations, four_bar  # noqa: E402
from rvjax._jax.elementary import _ARCTAN, _COSINE, _SINE  # noqa: E402

CASES = 65_536
E, L = 1.3e-3, 72e-3


def _horner(name, coefficients):
    """C function: the sum of coefficients[n] x^(n + 1)."""
    body = "0"
    for coefficient in reversed(coefficients):
        body = f"x * ({coefficient!r} + {body})"
    return f"static inline double {name}(double x) {{ return {body}; }}\n"


C_SOURCE = (
    "#include <math.h>\n"
    + _horner("sine", _SINE)
    + _horner("cosine", _COSINE)
    + _horner("angle", _ARCTAN)
    + r"""
#define W 64  /* cases side by side */
#define EACH _Pragma("omp simd") for (int k = 0; k < W; k++)
/* x less a multiple of pi / 2, and which: 0 to 3 */
static inline double rest(double x, double *quarter)
{
    double q = rint(x * 0.63661977236758134);
    *quarter = q - 4 * floor(q * 0.25);
    return ((x - q * 0x1.921fb544p0) - q * 0x1.0b4611a4p-34) - q * 0x1.13198a2e03707p-65;
}
static inline void turn(double x, double *s, double *c)
{
    double k, r = rest(x, &k), z = r * r, sn = r + r * sine(z), cn = 1 + cosine(z);
    int odd = k == 1 || k == 3;
    double a = odd ? cn : sn, b = odd ? sn : cn;
    *s = k >= 2 ? -a : a;
    *c = k == 1 || k == 2 ? -b : b;
}
/* sine and 1 - cosine: by its half, or at once if it is small */
static inline void tilt(double x, double *s, double *v, int small)
{
    if (small) {
        *s = x + x * sine(x * x);
        *v = -cosine(x * x);
        return;
    }
    double k, r = rest(0.5 * x, &k), z = r * r, sn = r + r * sine(z), cn = 1 + cosine(z);
    int odd = k == 1 || k == 3;
    double both = 2 * sn * cn, h = odd ? cn : sn;
    *s = odd ? -both : both;
    *v = 2 * h * h;
}
static inline int calm(const double *x)
{
    double most = 0;
    for (int k = 0; k < W; k++) most = fabs(x[k]) > most ? fabs(x[k]) : most;
    return most < 0.7853;
}
static inline void tilts(const double *restrict x, double *restrict s, double *restrict v)
{
    if (calm(x)) { EACH tilt(x[k], s + k, v + k, 1); }
    else { EACH tilt(x[k], s + k, v + k, 0); }
}
static inline double direction(double y, double x)
{
    double w = fabs(x), h = fabs(y), small = w < h ? w : h, large = w < h ? h : w;
    int beyond = small > 0.41421356237309505 * large;
    double t = (beyond ? small - large : small) / (beyond ? small + large : large);
    double a = t + t * angle(t * t);
    a = beyond ? a + 0.78539816339744831 : a;
    a = h > w ? 1.5707963267948966 - a : a;
    a = x < 0 ? 3.1415926535897931 - a : a;
    return y < 0 ? -a : a;
}
void locked(const double *restrict x, long n, double *restrict out)
{   /* x: rows d1, d2, d3, d4, psi, b4, gx, gy, crank angle; n: a multiple of W */
    const double e = 1.3e-3, l = 72e-3;
    for (long b = 0; b < n; b += W) {
        double s[W], c[W], ps[W], pv[W], fs[W], fv[W], X[W], Y[W];
        EACH turn(x[8 * n + b + k], s + k, c + k);
        tilts(x + 4 * n + b, ps, pv);
        tilts(x + 5 * n + b, fs, fv);
        EACH {
            const double *y = x + b + k;
            const double d1 = y[0], d3 = y[2 * n], l4 = l + y[3 * n], d = d3 - d1, l3 = e + d3;
            X[k] = l + (y[3 * n] + y[6 * n] - l4 * fv[k] + d * c[k] - l3 * (s[k] * ps[k] + c[k] * pv[k]));
            Y[k] = l4 * fs[k] + y[7 * n] + d * s[k] + l3 * (c[k] * ps[k] - s[k] * pv[k]);
        }
        EACH out[b + k] = direction(Y[k], X[k]);
    }
}
void followed(const double *restrict x, long n, double *restrict out)
{
    const double e = 1.3e-3, l = 72e-3;
    for (long b = 0; b < n; b += W) {
        double s[W], c[W], fs[W], fv[W], X[W], Y[W];
        EACH turn(x[8 * n + b + k], s + k, c + k);
        tilts(x + 5 * n + b, fs, fv);
        EACH {
            const double *y = x + b + k;
            const double d1 = y[0], d2 = y[n], d3 = y[2 * n], l4 = l + y[3 * n], l1 = e + d1, l2 = l + d2;
            const double dx = y[3 * n] + y[6 * n] - l4 * fv[k], dy = l4 * fs[k] + y[7 * n], lx = l + dx;
            const double L = sqrt(lx * lx + dy * dy), along = (c[k] * lx + s[k] * dy) / L;
            const double across = (s[k] * lx - c[k] * dy) / L;
            const double h = d2 - (2 * l * dx + dx * dx + dy * dy) / (L + l);
            const double A = l2 * (L - l1 * along), B = 2 * l1 * l2 * across;
            const double C = (d1 - d3) * (2 * e + d1 + d3) + h * (2 * l1 * along + h), D = B * B - C * (4 * A + C);
            const double q = fabs(B) + sqrt(fmax(D, 0)), m = B < 0 ? C : -C, qq = q * q - m * m, qm = 2 * q * m;
            X[k] = lx * qq - dy * qm;   /* the frame, turned twice by the angle of (q, m) */
            Y[k] = dy * qq + lx * qm;
        }
        EACH out[b + k] = direction(Y[k], X[k]);
    }
}
"""
)


def drawn(cases, seed=0):
    """Rows d1, d2, d3, d4, psi, b4, gx, gy, crank angle."""
    rng = np.random.default_rng(seed)
    spread = np.array([1e-5] * 4 + [1e-4, 1e-5] + [1e-5] * 2)
    return np.vstack([rng.normal(size=(8, cases)) * spread[:, None], rng.uniform(0, 2 * np.pi, cases)])


def coupler_angles(rows, cranks):
    """A batch, the cases on the last axis."""

    def one(d1, d2, d3, d4, psi, b4, gx, gy, angle):
        deviations = LinkDeviations(d1, d2, d3, d4, psi, b4, (gx, gy))
        return four_bar.solve_closure(E, L, deviations, crank_angle=angle, cranks=cranks, closure="closed_form")

    return jax.vmap(lambda *row: one(*row).coupler_angle)(*rows)


def mean(scales, rows, cranks):
    """Mean over the batch; each scale multiplies the deviations of its kind."""
    return jnp.mean(coupler_angles([scale * row for scale, row in zip(scales, rows)], cranks))


def vectorised(x):
    """NumPy, phase-locked."""
    d1, _, d3, d4, psi, b4, gx, gy, angle = x
    frame, crank = (L + d4) * np.exp(1j * b4) + gx + 1j * gy, np.exp(1j * angle)
    return np.angle(frame + (E + d3) * crank * np.exp(1j * psi) - (E + d1) * crank)


def main():
    path = arguments(__doc__.splitlines()[0]).json
    figures, reference = {}, c_library(C_SOURCE)
    for cranks, prefix, function in (("phase_locked", "", "locked"), ("free", "free_", "followed")):
        x = drawn(CASES)
        if cranks == "free":  # clear of both dead points, where some linkages cannot be assembled
            x[8] = np.where(x[8] < np.pi, 0.4, 0.4 + np.pi) + (x[8] % np.pi) * (1 - 0.8 / np.pi)
        rows = [jnp.asarray(row) for row in x]
        run, notes = compiled(lambda rows, cranks=cranks: coupler_angles(rows, cranks), rows)
        scales = [jnp.ones(())] * 9
        whole = functools.partial(mean, cranks=cranks)
        primal, _ = compiled(whole, scales, rows)
        gradient, gradient_notes = compiled(jax.value_and_grad(whole), scales, rows)
        expected = np.asarray(run(rows))
        candidates = {"library": functools.partial(run, rows)}
        if cranks == "phase_locked":
            np.testing.assert_allclose(vectorised(x), expected, rtol=1e-9, atol=1e-15)
            candidates["numpy"] = functools.partial(vectorised, x)
        if reference is not None:
            out = np.empty(CASES)
            pointers = ctypes.c_void_p(x.ctypes.data), ctypes.c_long(CASES), ctypes.c_void_p(out.ctypes.data)
            candidates["C"] = functools.partial(reference[function], *pointers)
            candidates["C"]()
            np.testing.assert_allclose(out, expected, rtol=1e-12, atol=1e-17)
        best = alternate(candidates)
        both = alternate(
            {"mean": functools.partial(primal, scales, rows), "gradient": functools.partial(gradient, scales, rows)}
        )
        found = {f"{name}_ns_per_case": 1e9 * seconds / CASES for name, seconds in best.items()}
        found |= {"numpy_over_library": best["numpy"] / best["library"]} if "numpy" in best else {}
        found |= {"library_over_C": best["library"] / best["C"]} if "C" in best else {}
        found |= {"gradient_over_mean": both["gradient"] / both["mean"], **notes}
        found |= {f"gradient_{key}": value for key, value in gradient_notes.items()}
        figures |= {prefix + name: value for name, value in found.items()}
    publish("four_bar_closure", figures, path)


if __name__ == "__main__":
    main()
