"""The mesh-force model in C, Numba, NumPy and SciPy, each written as well as its language allows.

C, Numba and NumPy: geometry once, linear contacts by Newton on the set of loaded rollers, then Newton on all
loads and the windup together with the exact contact law, from the power series of the local inverse. C takes 32 cases
side by side, and reads and writes a row of cases for each roller. SciPy solves one case: brentq for the windup around
brentq for every roller.
"""

import math

import numba
import numpy as np
from scipy.optimize import brentq

SOURCE = r"""
#include <math.h>
#define N %(count)d
#define W 32  /* cases side by side */
#define EACH _Pragma("omp simd") for (int k = 0; k < W; k++)
static const double CO[N] = {%(cosines)s}, SI[N] = {%(sines)s};

/* (1 - sqrt(1 - x)) / x: by its root, or by seven terms, good to rounding below 0.01 */
static inline double rise(double x, int near)
{
    if (!near) return 1 / (1 + sqrt(1 - x));
    return 0.5 + x * (1 / 8. + x * (1 / 16. + x * (5 / 128. + x * (7 / 256. + x * (21 / 1024. + x * 33 / 2048)))));
}
/* Newton step of all loads: F + S tau, by the exact contact law about three terms of its inverse */
#define STEP(near) for (int i = 0; i < N; i++) EACH { \
    const double y = K[i][k] * fmax(tau[k] * a[i][k] + g[i][k], 0), b = fabs(rs[i][k]), n = rn[i][k], h = m[i][k]; \
    const double x = y * (1 - y * (A[i][k] - y * B[i][k])), v = n * x, w = b * x, k2 = (1 - h) * (1 - h) * im[i][k]; \
    const double D = x * (mc * rise(mc * x, near) + nc * rise(kc * x, near)) + b * w * rise(w, near) \
        + n * v * (h * rise(h * v, near) + (1 - h) * rise(k2 * v, near)); \
    const double slope = y > 0 ? K[i][k] * (1 - y * (2 * A[i][k] - 3 * y * B[i][k])) : 0; \
    F[i][k] = x + slope * (g[i][k] - D); \
    S[i][k] = slope * a[i][k]; \
    M[k] += a[i][k] * F[i][k]; \
    J[k] += a[i][k] * S[i][k]; \
}

void solve(long cases, const double *restrict design, const double *restrict dcam, const double *restrict decc,
           const double *restrict dradius, const double *restrict torque, const double *restrict angle,
           double *restrict cam, double *restrict cage, double *restrict gear, double *restrict windup,
           double *restrict peak)
{   /* cases: a multiple of W; a row of cases for each roller, also in the results.
       `peak`: the largest gear force of each case instead of all results; else NULL */
    const double R = design[0], r = design[1], l = design[2], e = design[3], E = design[4], nu = design[5];
    const double share = design[6], L = R + r, z = N - 1, ratio = e / L, mc = R / L, nc = 1 - mc, kc = nc * nc / mc;
    const double unit = M_PI * l * r * E / (8 * (1 - nu * nu));
    const double c2 = (mc * mc + nc * kc) / 8, c3 = (mc * mc * mc + nc * kc * kc) / 16;
#pragma omp parallel for schedule(static)
    for (long b = 0; b < cases; b += W) {
        double a[N][W], g[N][W], K[N][W], A[N][W], B[N][W], rs[N][W], rn[N][W], m[N][W], im[N][W], wide[N][W];
        double F[N][W], S[N][W], s0[W], c0[W], T[W], M[W], J[W], tau[W], most = 0;
        EACH s0[k] = sin(z * angle[b + k]);
        EACH c0[k] = cos(z * angle[b + k]);
        EACH { T[k] = share * torque[b + k] / (unit * e); M[k] = J[k] = 0; }
        for (int i = 0; i < N; i++) {
            const double *own = dradius + i * cases + b;
            EACH {
                const double sp = s0[k] * CO[i] - c0[k] * SI[i], cp = c0[k] * CO[i] + s0[k] * SI[i];
                const double sg = ratio * sp, cg = sqrt(1 - sg * sg), q = cg * cg + z * z * sg * sg, n = sqrt(q);
                const double Q = (e * cp + L * cg) * q * n, O = Q + r * (cg * q + z * z * ratio * cp);
                const double H = 1 + z * N * sg * sg, inverse = 1 / (Q * O * H);   /* the only division */
                const double h = O * O * H * inverse, ih = Q * Q * H * inverse, k2 = (1 - h) * (1 - h) * ih;
                const double d = fabs(N * sg), d3 = d * d * d, n3 = n * n * n, stiff = Q * O * inverse;
                const double bend = stiff * (c2 + (d3 + n3 * (h * h + (1 - h) * k2)) * 0.125);
                const double third = c3 + (d3 * d + n3 * n * (h * h * h + (1 - h) * k2 * k2)) * 0.0625;
                rn[i][k] = n;
                rs[i][k] = N * sg;
                m[i][k] = h;
                im[i][k] = ih;
                a[i][k] = sp * cg + cp * sg;
                g[i][k] = (dcam[b + k] + decc[b + k] * (cp * cg - sp * sg) + own[k] * (1 + d + n)) / r;
                K[i][k] = stiff;
                A[i][k] = bend;
                B[i][k] = 2 * bend * bend - stiff * third;
                wide[i][k] = fmax(fmax(1, kc), fmax(d, n * fmax(h, k2)));   /* of a square half-width over x */
                const double w = a[i][k] * T[k] > 0 ? a[i][k] * stiff : 0;
                M[k] += w * g[i][k];
                J[k] += w * a[i][k];
            }
        }
        EACH tau[k] = (T[k] - M[k]) / J[k];
        for (int step = 0; step < 50; step++) {   /* linear contacts: exact once the loaded set stays */
            double worst = 0;
            EACH { M[k] = -T[k]; J[k] = 0; }
            for (int i = 0; i < N; i++) EACH {
                const double y = tau[k] * a[i][k] + g[i][k], w = y > 0 ? a[i][k] * K[i][k] : 0;
                M[k] += w * y;
                J[k] += w * a[i][k];
            }
            for (int k = 0; k < W; k++) {
                const double change = M[k] / J[k];
                worst = fmax(worst, fabs(change / tau[k]));
                tau[k] -= change;
            }
            if (worst <= 1e-4) break;
        }
        EACH { M[k] = -T[k]; J[k] = 0; }
        for (int i = 0; i < N; i++)   /* one step with three terms of the inverse contact law */
            _Pragma("omp simd reduction(max:most)") for (int k = 0; k < W; k++) {
                const double y = K[i][k] * fmax(tau[k] * a[i][k] + g[i][k], 0);
                const double x = y * (1 - y * (A[i][k] - y * B[i][k]));
                const double slope = y > 0 ? K[i][k] * (1 - y * (2 * A[i][k] - 3 * y * B[i][k])) : 0;
                M[k] += a[i][k] * x;
                J[k] += a[i][k] * a[i][k] * slope;
                most = fmax(most, x * wide[i][k]);
            }
        EACH tau[k] -= M[k] / J[k];
        for (int step = 0; step < 10; step++) {   /* all loads and the windup together, exact contact law */
            double worst = 0;
            EACH { M[k] = -T[k]; J[k] = 0; }
            if (most < 0.009) STEP(1) else STEP(0)
            for (int k = 0; k < W; k++) {
                const double next = -M[k] / J[k];
                worst = fmax(worst, fabs((next - tau[k]) / next));
                tau[k] = next;
            }
            if (worst <= 1e-6) break;
        }
        if (peak) {
            EACH T[k] = 0;
            for (int i = 0; i < N; i++) EACH T[k] = fmax(T[k], (F[i][k] + S[i][k] * tau[k]) * rn[i][k]);
            EACH peak[b + k] = unit * T[k];
            continue;
        }
        EACH windup[b + k] = tau[k] * r / e;
        for (int i = 0; i < N; i++) EACH {
            const double u = unit * fmax(F[i][k] + S[i][k] * tau[k], 0);
            cam[i * cases + b + k] = u;
            cage[i * cases + b + k] = u * rs[i][k];
            gear[i * cases + b + k] = u * rn[i][k];
        }
    }
}
"""


def source(count: int) -> str:
    """C source for `count` rollers."""
    angles = 2 * np.pi * np.arange(count) / count
    return SOURCE % {
        "count": count,
        "cosines": ", ".join(f"{v:.17g}" for v in np.cos(angles)),
        "sines": ", ".join(f"{v:.17g}" for v in np.sin(angles)),
    }


def in_numpy(design, cam_error, throw_error, radius_error, torque, angle):
    """A chunk of cases as arrays (cases, rollers); returns cam, cage, gear and windup."""
    cam, r, length, e, modulus, poisson, share = design
    n = radius_error.shape[1]
    z, link = n - 1, cam + r
    unit = np.pi * length * r * modulus / (8 * (1 - poisson**2))
    lead = z * angle[:, None] - 2 * np.pi * np.arange(n) / n
    sin_psi, cos_psi = np.sin(lead), np.cos(lead)
    sin_g = e / link * sin_psi
    cos_g = np.sqrt(1 - sin_g**2)
    square = cos_g**2 + z**2 * sin_g**2
    rn, rs = np.sqrt(square), n * sin_g
    m = 1 + r * (cos_g * square + z**2 * e / link * cos_psi) / ((e * cos_psi + link * cos_g) * square * rn)
    a = sin_psi * cos_g + cos_psi * sin_g
    g = cam_error[:, None] + throw_error[:, None] * (cos_psi * cos_g - sin_psi * sin_g)
    g = (g + radius_error * (1 + np.abs(rs) + rn)) / r
    stiffness = 1 / (1 + z * n * sin_g**2)
    goal = (share * torque / (unit * e))[:, None]
    touching = a * goal > 0
    tau = None
    for _ in range(12):
        if tau is not None:
            touching = tau * a + g > 0
        weight = np.where(touching, a * stiffness, 0)
        last, tau = tau, (goal - (weight * g).sum(1, keepdims=True)) / (weight * a).sum(1, keepdims=True)
        if last is not None and (np.abs(tau - last) <= 1e-12 * np.abs(tau)).all():
            break
    load = stiffness * np.maximum(tau * a + g, 0)
    terms = ((1.0, cam / link), (np.abs(rs), 1.0), (rn, m))
    for _ in range(3):
        depth = slope = 0.0
        for weight, radius in terms:
            v = weight * load
            here, there = np.sqrt(1 - radius * v), np.sqrt(1 - (1 - radius) ** 2 / radius * v)
            depth = depth + weight * v * (radius / (1 + here) + (1 - radius) / (1 + there))
            slope = slope + weight**2 / 2 * (radius / here + (1 - radius) / there)
        rate = np.where(tau * a + g > 0, 1 / slope, 0)
        base = load + rate * (g - depth)
        base = np.where(rate > 0, base, 0)
        tau = (goal - (a * base).sum(1, keepdims=True)) / (a**2 * rate).sum(1, keepdims=True)
        load = np.maximum(base + rate * a * tau, 0)
    force = unit * load
    return force, force * rs, force * rn, tau[:, 0] * r / e


@numba.njit(parallel=True, fastmath=True)
def in_numba(design, cam_error, throw_error, radius_error, torque, angle, cos, sin, cam, cage, gear, windup):
    """As the C program; cos and sin of the roller angles are given."""
    radius, r, length, e, modulus, poisson, share = design
    n = cos.size
    z, link = n - 1.0, radius + r
    ratio, mc = e / link, radius / link
    nc = 1 - mc
    unit = math.pi * length * r * modulus / (8 * (1 - poisson * poisson))
    for k in numba.prange(torque.size):
        a, g, stiff = np.empty(n), np.empty(n), np.empty(n)
        rs, rn, m, u = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
        base, rate = np.empty(n), np.empty(n)
        s0, c0, goal = math.sin(z * angle[k]), math.cos(z * angle[k]), share * torque[k] / (unit * e)
        moment = slope = 0.0
        for i in range(n):
            sp, cp = s0 * cos[i] - c0 * sin[i], c0 * cos[i] + s0 * sin[i]
            sg = ratio * sp
            cg = math.sqrt(1 - sg * sg)
            q = cg * cg + z * z * sg * sg
            rn[i], rs[i] = math.sqrt(q), n * sg
            m[i] = 1 + r * (cg * q + z * z * ratio * cp) / ((e * cp + link * cg) * q * rn[i])
            a[i] = sp * cg + cp * sg
            own = radius_error[k, i] * (1 + abs(rs[i]) + rn[i])
            g[i] = (cam_error[k] + throw_error[k] * (cp * cg - sp * sg) + own) / r
            stiff[i] = 1 / (1 + z * n * sg * sg)
            w = a[i] * stiff[i] if a[i] * goal > 0 else 0.0
            moment += w * g[i]
            slope += w * a[i]
        tau = (goal - moment) / slope
        for _ in range(50):
            moment, slope = -goal, 0.0
            for i in range(n):
                y = tau * a[i] + g[i]
                w = a[i] * stiff[i] if y > 0 else 0.0
                moment += w * y
                slope += w * a[i]
            tau -= moment / slope
            if abs(moment) <= 1e-6 * abs(tau * slope):
                break
        for i in range(n):
            u[i] = stiff[i] * max(tau * a[i] + g[i], 0.0)
        for _ in range(10):
            moment, slope = -goal, 0.0
            for i in range(n):
                b, x, n1 = abs(rs[i]), u[i], 1 - m[i]
                v, w, k2 = rn[i] * x, b * x, n1 * n1 / m[i]
                q1, q2, q3 = math.sqrt(1 - mc * x), math.sqrt(1 - nc * nc / mc * x), math.sqrt(1 - w)
                q4, q5 = math.sqrt(1 - m[i] * v), math.sqrt(1 - k2 * v)
                depth = mc * x / (1 + q1) + nc * x / (1 + q2) + b * w / (1 + q3)
                depth += rn[i] * v * (m[i] / (1 + q4) + n1 / (1 + q5))
                steep = 0.5 * (mc / q1 + nc / q2 + b * b / q3 + rn[i] * rn[i] * (m[i] / q4 + n1 / q5))
                rate[i] = 1 / steep if tau * a[i] + g[i] > 0 else 0.0
                base[i] = x - rate[i] * (depth - g[i]) if rate[i] > 0 else 0.0
                moment += a[i] * base[i]
                slope += a[i] * a[i] * rate[i]
            tau = -moment / slope
            change = size = 0.0
            for i in range(n):
                v = max(base[i] + rate[i] * a[i] * tau, 0.0)
                change, size = max(change, abs(v - u[i])), max(size, v)
                u[i] = v
            if change <= 1e-6 * size:
                break
        windup[k] = tau * r / e
        for i in range(n):
            cam[k, i], cage[k, i], gear[k, i] = unit * u[i], unit * u[i] * rs[i], unit * u[i] * rn[i]


def with_scipy(design, cam_error, throw_error, radius_error, torque, angle):
    """One case by nested brackets; returns the gear forces and the windup."""
    cam, r, length, e, modulus, poisson, share = design
    n = len(radius_error)
    z, link, compliance = n - 1, cam + r, 2 * (1 - poisson**2) / modulus
    rollers = []
    for i in range(n):
        psi = z * angle - 2 * math.pi * i / n
        g = math.asin(e / link * math.sin(psi))
        beta = math.atan(z * math.tan(g))
        s = e * math.cos(psi) + link * math.cos(g)
        rn, rs = math.cos(g) / math.cos(beta), n * abs(math.sin(g))
        kc = math.cos(g) / (s * rn) * (1 + z**2 * e / link * math.cos(psi) / (math.cos(g) * rn**2))
        gap = cam_error + throw_error * math.cos(psi + g) + radius_error[i] * (1 + rs + rn)
        sides = ((1.0, r * cam / link, -1 / cam), (rs, r, 0.0), (rn, r * (1 + r * kc), kc / (1 + r * kc)))
        rollers.append((e * math.sin(psi + g), gap, sides, rn))

    def force(depth, sides):
        def missing(f):
            total = -depth
            for weight, radius, bend in sides:
                b2 = 4 * weight * f * radius * compliance / (math.pi * length)
                total += weight * (b2 / (r + math.sqrt(r * r - b2)) - bend * b2 / (1 + math.sqrt(1 - bend * bend * b2)))
            return total

        return brentq(missing, 0.0, 1e5, xtol=1e-12, rtol=1e-15) if depth > 0 else 0.0

    def moment(tau):
        return sum(a * force(tau * a + gap, sides) for a, gap, sides, _ in rollers) - share * torque

    tau = brentq(moment, -5e-3, 5e-3, xtol=1e-18, rtol=1e-14)
    return [rn * force(tau * a + gap, sides) for a, gap, sides, rn in rollers], tau
