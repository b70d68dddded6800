"""One linkage at one crank angle, phase-locked, closed form: coupler angle of a batch and its gradient.

In one process with the library, in turn: C (gcc -O3 -march=native -ffast-math, sine, cosine and inverse tangent
as branch-free polynomials, for library calls would not vectorise) and NumPy. The results are compared first. Run on
one core (`taskset -c 0`) for the ratio to C.
"""

import ctypes

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
static inline void turn(double x, double *s, double *c)
{
    double q = rint(x * 0.63661977236758134);
    double r = ((x - q * 0x1.921fb544p0) - q * 0x1.0b4611a4p-34) - q * 0x1.13198a2e03707p-65;
    double sn = r + r * sine(r * r), cn = 1 + cosine(r * r), k = q - 4 * floor(q / 4);
    int odd = k == 1 || k == 3;
    double a = odd ? cn : sn, b = odd ? sn : cn;
    *s = k >= 2 ? -a : a;
    *c = k == 1 || k == 2 ? -b : b;
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
void close_all(const double *restrict x, long n, double *restrict out)
{   /* x: rows d1, d2, d3, d4, psi, b4, gx, gy, crank angle */
    const double e = 1.3e-3, l = 72e-3;
    for (long i = 0; i < n; i++) {
        double s, c, hs, hc, fs, fc;
        turn(x[8 * n + i], &s, &c);
        turn(0.5 * x[4 * n + i], &hs, &hc);
        turn(0.5 * x[5 * n + i], &fs, &fc);
        double l4 = l + x[3 * n + i], w = 2 * (e + x[2 * n + i]) * hs, d = x[2 * n + i] - x[i];
        double along = x[3 * n + i] + x[6 * n + i] - 2 * l4 * fs * fs + d * c - w * (s * hc + c * hs);
        double across = 2 * l4 * fs * fc + x[7 * n + i] + d * s + w * (c * hc - s * hs);
        out[i] = direction(across, l + along);
    }
}
"""
)


def drawn(cases, seed=0):
    """Rows d1, d2, d3, d4, psi, b4, gx, gy, crank angle."""
    rng = np.random.default_rng(seed)
    spread = np.array([1e-5] * 4 + [1e-4, 1e-5] + [1e-5] * 2)
    return np.vstack([rng.normal(size=(8, cases)) * spread[:, None], rng.uniform(0, 2 * np.pi, cases)])


def coupler_angle(row):
    """One case."""
    d1, d2, d3, d4, psi, b4, gx, gy, angle = row
    deviations = LinkDeviations(d1, d2, d3, d4, psi, b4, (gx, gy))
    return four_bar.solve_closure(E, L, deviations, crank_angle=angle, closure="closed_form").coupler_angle


def library(rows):
    """A batch, the cases on the last axis."""
    return jax.vmap(coupler_angle, in_axes=([0] * 9,))(list(rows))


def mean(scales, rows):
    """Mean over the batch; each scale multiplies the deviations of its kind."""
    return jnp.mean(library([scale * row for scale, row in zip(scales, rows)]))


def vectorised(x):
    """NumPy."""
    d1, _, d3, d4, psi, b4, gx, gy, angle = x
    frame, crank = (L + d4) * np.exp(1j * b4) + gx + 1j * gy, np.exp(1j * angle)
    return np.angle(frame + (E + d3) * crank * np.exp(1j * psi) - (E + d1) * crank)


def main():
    path = arguments(__doc__.splitlines()[0]).json
    x = drawn(CASES)
    rows = [jnp.asarray(row) for row in x]
    run, notes = compiled(library, rows)
    scales = [jnp.ones(())] * 9
    primal, _ = compiled(mean, scales, rows)
    gradient, gradient_notes = compiled(jax.value_and_grad(mean), scales, rows)
    expected = np.asarray(run(rows))
    np.testing.assert_allclose(vectorised(x), expected, rtol=1e-9, atol=1e-15)
    candidates = {"library": lambda: run(rows), "numpy": lambda: vectorised(x)}
    reference = c_library(C_SOURCE)
    if reference is not None:
        out = np.empty(CASES)
        pointers = ctypes.c_void_p(x.ctypes.data), ctypes.c_long(CASES), ctypes.c_void_p(out.ctypes.data)
        reference.close_all(*pointers)
        np.testing.assert_allclose(out, expected, rtol=1e-12, atol=1e-18)
        candidates["C"] = lambda: reference.close_all(*pointers)
    best = alternate(candidates)
    both = alternate({"mean": lambda: primal(scales, rows), "gradient": lambda: gradient(scales, rows)})
    figures = {f"{name}_ns_per_case": 1e9 * seconds / CASES for name, seconds in best.items()}
    figures["numpy_over_library"] = best["numpy"] / best["library"]
    figures |= {"library_over_C": best["library"] / best["C"]} if "C" in best else {}
    figures |= {"gradient_over_mean": both["gradient"] / both["mean"], **notes}
    publish("four_bar_closure", figures | {f"gradient_{key}": value for key, value in gradient_notes.items()}, path)


if __name__ == "__main__":
    main()
