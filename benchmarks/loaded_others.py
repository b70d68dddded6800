"""The loaded RV-40E in C, Numba and NumPy, each written as well as its language allows; one algorithm for all.

C: lanes are units, one vector of them at a time; pins enter by nine sums a disc, discs are eliminated before carrier
and cranks; three logarithms a Hertz pin, by polynomial, one of them rough. Units that twelve Newton steps leave are
packed anew and go on with best points and line searches. Numba: one unit at a time, the same steps. NumPy: all units
together, the Hessian of the pins as one matrix product.
"""

import math

import numba
import numpy as np

# Errors of a unit, the rows of `x` (rows, units).
FIELDS = {
    "crank_eccentricity": (2, 2), "crank_phase": (2,), "disc_bore": (2, 2, 2), "carrier_bore": (2, 2),
    "bearing_clearance": (), "support_clearance": (), "base_tangent_upper": (), "pin_circle_radius": (),
    "equidistant_modification": (), "disc_centre": (2, 2), "pin_radii": (40,), "pin_offset": (40, 2),
}  # fmt: skip
OFFSETS = dict(zip(FIELDS, np.cumsum([0, *(int(np.prod(shape)) for shape in FIELDS.values())])))
COLUMNS = sum(int(np.prod(shape)) for shape in FIELDS.values())

SOURCE = r"""
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <immintrin.h>
#ifdef __AVX512F__
#define W 8
#else
#define W 4
#endif
typedef double V __attribute__((vector_size(8 * W)));
typedef long I __attribute__((vector_size(8 * W)));
#define P 40
#define D 2
#define Z 39
static inline V all(double x) { return (V){} + x; }
static inline V sel(I m, V a, V b) { return (V)(((I)a & m) | ((I)b & ~m)); }
static inline V vmax(V a, V b) { return sel(a > b, a, b); }
static inline V vmin(V a, V b) { return sel(a < b, a, b); }
static inline V vabs(V a) { return (V)((I)a & 0x7fffffffffffffffL); }
static inline V vsqrt(V a) {
#ifdef __AVX512F__
    return (V)_mm512_sqrt_pd((__m512d)a);
#elif defined(__AVX__)
    return (V)_mm256_sqrt_pd((__m256d)a);
#else
    V r; for (int l = 0; l < W; l++) r[l] = sqrt(a[l]); return r;
#endif
}
static inline int any(I m) {
#ifdef __AVX512DQ__
    return _mm512_movepi64_mask((__m512i)m);
#elif defined(__AVX__)
    return _mm256_movemask_pd((__m256d)m);
#else
    long r = 0; for (int l = 0; l < W; l++) r |= m[l]; return r != 0;
#endif
}
/* x = 2^k m with m in 0.7 .. 1.4 */
static inline V parts(V x, V *m)
{
    const long root = 0x3fe6a09e667f3bcdL;
    I b = (I)x + (0x3ff0000000000000L - root);
    I k = (I)((__typeof__((unsigned long __attribute__((vector_size(8 * W)))){}))b >> 52);
    *m = (V)((b & 0x000fffffffffffffL) + root);
    return (V)(k | 0x4330000000000000L) - (4503599627370496.0 + 1023.0);
}
static inline V vlog(V x)
{   /* 2 atanh((m - 1)/(m + 1)), |s| < .172: the next term is below 3e-17 */
    V m, k = parts(x, &m), s = (m - 1) / (m + 1), z = s * s;
    V p = all(1.0 / 19);
    for (int n = 17; n > 0; n -= 2) p = p * z + 1.0 / n;
    return k * 0.693147180559945309417 + 2 * s * p;
}
static inline V rough_log(V x)
{   /* to 1e-3: only where Newton begins */
    V m, k = parts(x, &m), s = (m - 1) / (m + 1);
    return k * 0.6931472 + s * (2 + 0.6667 * s * s);
}
typedef struct { double nx[D][P], ny[D][P], lv[D][P], w[D][P], A[D][P], nr[D][P], nt[D][P], ux[D], uy[D]; } Angle;
typedef struct {
    double e, rp, rr, R, rs, rb, sa, ca, ka, kh, km, k0, E, nu, L, kpin, cpin, torque, start; int hertz;
} Design;
typedef struct { V g[D][P], ax[D][2], ay[D][2], sx[2], sy[2], cl, cls, gear, size; } Pack;
typedef struct { V a, d[D][3], c[2][3]; } Q;   /* metres: angles times R, R and r_b */

static void geometry(const Design *s, double theta, Angle *o)
{
    const double pi = 3.14159265358979323846, i = 1 + 26.0 * P / 10, th = theta / i, K = s->e * P / s->rp;
    const double plain = log(2 * pi * s->L * s->E * s->rr * s->rr / (1 - s->nu * s->nu)) - 1 / (2 * (1 - s->nu));
    for (int k = 0; k < D; k++) {
        const double b = -P * th + 2 * pi * k / D;
        o->ux[k] = cos(b), o->uy[k] = sin(b);
        for (int j = 0; j < P; j++) {
            const double g = 2 * pi * j / P - th, psi = g - b, h = sin(psi / 2), q = (1 - K) * (1 - K) + 4 * K * h * h;
            const double S = sqrt(q), kc = (1 + P * K * K - K * (1 + P) * cos(psi)) / (s->rp * q * S);
            o->nx[k][j] = (K * o->ux[k] - cos(g)) / S, o->ny[k][j] = (K * o->uy[k] - sin(g)) / S;
            o->lv[k][j] = s->e * Z * sin(psi) / S / s->R;
            o->w[k][j] = (1 - K * cos(psi)) / S;
            o->nr[k][j] = o->nx[k][j] * cos(g) + o->ny[k][j] * sin(g);
            o->nt[k][j] = o->ny[k][j] * cos(g) - o->nx[k][j] * sin(g);
            o->A[k][j] = plain - log(s->rr * (1 - s->rr * kc));
        }
    }
}
static const double erx[2] = {-1, 1}, ety[2] = {-1, 1};   /* radial (erx, 0), tangential (0, ety) */

static inline V take(const double *x, long units, int column, const long *id)
{
    const double *c = x + column * units;
    V r;
    if (id[W - 1] == id[0] + W - 1) { memcpy(&r, c + id[0], sizeof r); return r; }
    for (int l = 0; l < W; l++) r[l] = c[id[l]];
    return r;
}
static void gaps(const Design *s, const Angle *o, const double *x, long units, const long *id, Pack *p)
{
#define X(j) take(x, units, (j), id)
    V equi = X(%(equidistant_modification)d), circle = X(%(pin_circle_radius)d), most = all(0);
    V zero = all(0);
    p->cl = vmax(X(%(bearing_clearance)d), zero), p->cls = vmax(X(%(support_clearance)d), zero);
    p->gear = X(%(base_tangent_upper)d) / 4;
    for (int k = 0; k < D; k++) {
        V cx = X(%(disc_centre)d + 2 * k), cy = X(%(disc_centre)d + 2 * k + 1);
        for (int i = 0; i < 2; i++) {
            V d = X(%(crank_eccentricity)d + 2 * k + i), f = s->e * X(%(crank_phase)d + i);
            p->ax[k][i] = erx[i] * X(%(disc_bore)d + 4 * k + 2 * i) - d * o->ux[k] + f * o->uy[k];
            p->ay[k][i] = ety[i] * X(%(disc_bore)d + 4 * k + 2 * i + 1) - d * o->uy[k] - f * o->ux[k];
            most = vmax(most, vmax(vabs(p->ax[k][i]), vabs(p->ay[k][i])));
        }
        for (int j = 0; j < P; j++) {
            V g = X(%(pin_radii)d + j) - equi - circle * o->w[k][j] - o->nx[k][j] * cx - o->ny[k][j] * cy;
            g += o->nr[k][j] * X(%(pin_offset)d + 2 * j) + o->nt[k][j] * X(%(pin_offset)d + 2 * j + 1);
            p->g[k][j] = g;
            most = vmax(most, vabs(g));
        }
    }
    for (int i = 0; i < 2; i++) {
        p->sx[i] = -erx[i] * X(%(carrier_bore)d + 2 * i), p->sy[i] = -ety[i] * X(%(carrier_bore)d + 2 * i + 1);
        most = vmax(most, vmax(vabs(p->sx[i]), vabs(p->sy[i])));
    }
    p->size = most;
}
/* Force along a bearing, its energy and its slopes xx, xy, yy. */
static inline void bearing(double k, V wx, V wy, V cl, int start, V *fx, V *fy, V *E, V *xx, V *xy, V *yy)
{
    if (start) { *fx = k * wx, *fy = k * wy, *xx = *yy = all(k), *xy = all(0); return; }
    V size = vsqrt(wx * wx + wy * wy), over = vmax(size - cl, all(0));
    I some = size > 0, open = (size <= cl) & (cl > 0);
    V inv = sel(some, 1 / sel(some, size, all(1)), all(0)), ring = over * inv, ux = wx * inv, uy = wy * inv;
    ring = sel(cl > 0, ring, all(1));
    V along = sel(open, all(0), all(1)) - ring;
    *fx = k * over * ux, *fy = k * over * uy, *E += k / 2 * over * over;
    *xx = k * (ring + along * ux * ux), *xy = k * along * ux * uy, *yy = k * (ring + along * uy * uy);
}
#define M(i, j) S[(i) * ((i) + 1) / 2 + (j)]
/* Gradient G and energy at q and, with `newton`, the step H^-1 G; `start`: the contacts a torque closes, linear. */
static inline __attribute__((always_inline)) void evaluate(
    const Design *s, const Angle *o, const Pack *p, const Q *q, int hertz, int newton, int start, Q *G, Q *step,
    V *energy, V *largest, double *pins, long stride)
{
    V E = all(0), top = all(fabs(s->torque / s->R)), zero = all(0), S[28], r[7];
    const double eb = s->e / s->rb;
    for (int n = 0; n < 28; n++) S[n] = zero;
    for (int n = 0; n < 7; n++) M(n, n) = all(s->k0);
    G->a = s->torque / s->R + s->k0 * q->a;
    E += s->torque / s->R * q->a + s->k0 / 2 * q->a * q->a;
    for (int i = 0; i < 2; i++)
        for (int n = 0; n < 3; n++) G->c[i][n] = s->k0 * q->c[i][n], E += s->k0 / 2 * q->c[i][n] * q->c[i][n];
    V Y[D][3][7], l21[D], l31[D], l32[D], i1[D], i2[D], i3[D];
    for (int k = 0; k < D; k++) {
        V x = q->d[k][0], y = q->d[k][1], b = q->d[k][2];
        V fx = zero, fy = zero, fb = zero, xx = all(s->k0), xy = zero, yy = all(s->k0), xb = zero, yb = zero;
        V bb = all(s->k0);
        for (int j = 0; j < P; j++) {
            const double nx = o->nx[k][j], ny = o->ny[k][j], lv = o->lv[k][j];
            V d = p->g[k][j] - nx * x - ny * y + lv * b, F, slope;
            if (start) {
                if (lv * s->torque >= 0) continue;
                slope = all(s->start), F = slope * d;
            } else {
                I on = d > 0;
                if (!any(on)) { if (pins) for (int l = 0; l < W; l++) pins[(k * P + j) * stride + l] = 0; continue; }
                if (hertz) {
                    /* y - ln y = t; from a guess to 1e-2, the rest by the series of ln(1 + z), z of the quotient */
                    V c = all(s->cpin), dd = sel(on, d, all(1e-9)), t = o->A[k][j] - vlog(dd / c);
                    t = vmax(t, all(1.02));
                    V y0 = t + rough_log(t) + 0.1, f = t + vlog(y0) - y0, z = f / (y0 - 1), u = y0;
                    for (int n = 0; n < 3; n++) {
                        V ln = z * (1 + z * (-0.5 + z * (1.0 / 3 + z * (-0.25 + z * (0.2 + z * (-1.0 / 6 + z / 7))))));
                        z += (f - (u * z - ln)) / (u - 1 / (1 + z));
                    }
                    V w = y0 + y0 * z;
                    F = dd / (c * w), slope = 1 / (c * (w - 1));
                    E += sel(on, s->cpin / 4 * F * F * (2 * w - 1), zero);
                } else {
                    F = s->kpin * d, slope = all(s->kpin);
                    E += sel(on, F * d / 2, zero);
                }
                F = sel(on, F, zero), slope = sel(on, slope, zero);
                top = vmax(top, F);
                if (pins) for (int l = 0; l < W; l++) pins[(k * P + j) * stride + l] = F[l];
            }
            fx -= nx * F, fy -= ny * F, fb += lv * F;
            if (newton) {
                V sx = nx * slope, sy = ny * slope, sl = lv * slope;
                xx += nx * sx, xy += ny * sx, yy += ny * sy, xb -= lv * sx, yb -= lv * sy, bb += lv * sl;
            }
        }
        fx += s->k0 * x, fy += s->k0 * y, fb += s->k0 * b;
        E += s->k0 / 2 * (x * x + y * y + b * b);
        V C[3][7];
        C[0][0] = C[1][0] = C[2][0] = zero;
        for (int i = 0; i < 2; i++) {
            const double pq = eb * o->uy[k], sq = -eb * o->ux[k], t = ety[i];
            V hx, hy, mxx, mxy, myy;
            V wx = p->ax[k][i] + x - q->c[i][0] + pq * q->c[i][2];
            V wy = p->ay[k][i] + y + t * b - q->c[i][1] + sq * q->c[i][2];
            bearing(s->ka, wx, wy, p->cl, start, &hx, &hy, &E, &mxx, &mxy, &myy);
            top = vmax(top, vmax(vabs(hx), vabs(hy)));
            fx += hx, fy += hy, fb += t * hy;
            G->c[i][0] -= hx, G->c[i][1] -= hy, G->c[i][2] += pq * hx + sq * hy;
            if (newton) {
                const int c = 1 + 3 * i;
                V qx = mxx * pq + mxy * sq, qy = mxy * pq + myy * sq;
                xx += mxx, xy += mxy, yy += myy, xb += t * mxy, yb += t * myy, bb += t * t * myy;
                C[0][c] = -mxx, C[0][c + 1] = -mxy, C[0][c + 2] = qx;
                C[1][c] = -mxy, C[1][c + 1] = -myy, C[1][c + 2] = qy;
                C[2][c] = -t * mxy, C[2][c + 1] = -t * myy, C[2][c + 2] = t * qy;
                M(c, c) += mxx, M(c + 1, c) += mxy, M(c + 1, c + 1) += myy;
                M(c + 2, c) -= qx, M(c + 2, c + 1) -= qy, M(c + 2, c + 2) += pq * qx + sq * qy;
            }
        }
        G->d[k][0] = fx, G->d[k][1] = fy, G->d[k][2] = fb;
        if (newton) {   /* L D L' of the disc; its couplings and gradient forward */
            i1[k] = 1 / xx, l21[k] = xy * i1[k], l31[k] = xb * i1[k];
            i2[k] = 1 / (yy - l21[k] * xy);
            V t = yb - l31[k] * xy;
            l32[k] = t * i2[k], i3[k] = 1 / (bb - l31[k] * xb - l32[k] * t);
            for (int n = 0; n < 7; n++) {
                V c0 = n ? C[0][n] : fx, c1 = n ? C[1][n] : fy, c2 = n ? C[2][n] : fb;   /* column 0: the gradient */
                c1 -= l21[k] * c0, c2 -= l31[k] * c0 + l32[k] * c1;
                Y[k][0][n] = c0, Y[k][1][n] = c1, Y[k][2][n] = c2;
            }
        }
    }
    for (int i = 0; i < 2; i++) {
        const int c = 1 + 3 * i;
        const double t = ety[i];
        V hx, hy, mxx, mxy, myy, x = q->c[i][0], y = q->c[i][1];
        bearing(s->kh, p->sx[i] + x, p->sy[i] + y - t * q->a, p->cls, start, &hx, &hy, &E, &mxx, &mxy, &myy);
        G->c[i][0] += hx, G->c[i][1] += hy, G->a -= t * hy;
        top = vmax(top, vmax(vabs(hx), vabs(hy)));
        M(c, c) += mxx, M(c + 1, c) += mxy, M(c + 1, c + 1) += myy;
        M(0, 0) += t * t * myy, M(c, 0) -= t * mxy, M(c + 1, 0) -= t * myy;
        for (int side = 1; side > -2; side -= 2) {
            const double dx = s->sa * erx[i], dy = side * s->ca * t;
            V d = p->gear - dx * x - dy * y + side * q->c[i][2];
            V k = start ? all(side * s->torque > 0 ? s->km : 0) : sel(d > 0, all(s->km), zero), F = k * d;
            top = vmax(top, F);
            E += F * d / 2;
            G->c[i][0] -= dx * F, G->c[i][1] -= dy * F, G->c[i][2] += side * F;
            M(c, c) += dx * dx * k, M(c + 1, c) += dx * dy * k, M(c + 1, c + 1) += dy * dy * k;
            M(c + 2, c) -= side * dx * k, M(c + 2, c + 1) -= side * dy * k, M(c + 2, c + 2) += k;
        }
    }
    *energy = E, *largest = top;
    if (!newton) return;
    r[0] = G->a;
    for (int n = 0; n < 6; n++) r[1 + n] = G->c[n / 3][n %% 3];
    for (int k = 0; k < D; k++) {
        for (int m = 1; m < 7; m++) {
            V a0 = Y[k][0][m] * i1[k], a1 = Y[k][1][m] * i2[k], a2 = Y[k][2][m] * i3[k];
            for (int n = 1; n <= m; n++) M(m, n) -= a0 * Y[k][0][n] + a1 * Y[k][1][n] + a2 * Y[k][2][n];
            r[m] -= a0 * Y[k][0][0] + a1 * Y[k][1][0] + a2 * Y[k][2][0];
        }
    }
    V inv[7];
    for (int j = 0; j < 7; j++) {   /* L D L' of carrier and cranks */
        inv[j] = 1 / M(j, j);
        for (int i = j + 1; i < 7; i++) {
            V l = M(i, j) * inv[j];
            for (int n = j + 1; n <= i; n++) M(i, n) -= l * M(n, j);
            r[i] -= l * r[j];
        }
    }
    for (int i = 6; i >= 0; i--) {
        V v = r[i];
        for (int n = i + 1; n < 7; n++) v -= M(n, i) * r[n];
        r[i] = v * inv[i];
    }
    step->a = r[0];
    for (int n = 0; n < 6; n++) step->c[n / 3][n %% 3] = r[1 + n];
    for (int k = 0; k < D; k++) {
        V c[3];
        for (int m = 0; m < 3; m++) {
            c[m] = Y[k][m][0];
            for (int n = 1; n < 7; n++) c[m] -= Y[k][m][n] * r[n];
        }
        V b = c[2] * i3[k], y = c[1] * i2[k] - l32[k] * b;
        step->d[k][2] = b, step->d[k][1] = y, step->d[k][0] = c[0] * i1[k] - l21[k] * y - l31[k] * b;
    }
}
#define EACH(n) for (int n = 0; n < 1 + 3 * D + 6; n++)
static inline V dot(const Q *a, const Q *b) { V r = all(0); EACH(n) r += ((V *)a)[n] * ((V *)b)[n]; return r; }
static inline I settled(const Design *s, const Pack *p, const Q *q, const Q *G, V top)
{
    V g = all(0), size = p->size;
    EACH(n) g = vmax(g, vabs(((V *)G)[n])), size = vmax(size, vabs(((V *)q)[n]));
    return g <= vmax(1e-13 * top, 4e-16 * s->kh * size);
}
/* Newton from q; lanes that `limit` steps leave stay 0 in the result. Lanes that are done stand still. */
static inline __attribute__((always_inline)) I newton(
    const Design *s, const Angle *o, const Pack *p, Q *q, int hertz, int limit, double *pins, long stride, I *steps)
{
    Q G, step;
    V E, top;
    I done = (I){};
    for (int n = 0; n <= limit; n++) {
        evaluate(s, o, p, q, hertz, 1, 0, &G, &step, &E, &top, pins, stride);
        done |= settled(s, p, q, &G, top);
        *steps -= ~done;
        if (!any(~done)) break;
        EACH(m) ((V *)q)[m] -= sel(done, all(0), ((V *)&step)[m]);
    }
    return done;
}
/* The same with best points: four steps without a lower energy lead back to a line search there. */
static __attribute__((noinline)) I watched(
    const Design *s, const Angle *o, const Pack *p, Q *q, int hertz, double *pins, long stride, I *steps)
{
    Q G, step, best = *q, at;
    V E, top, lowest = all(1e300);
    I done = (I){}, waits = (I){};
    for (int n = 0; n < 200; n++) {
        evaluate(s, o, p, q, hertz, 1, 0, &G, &step, &E, &top, pins, stride);
        done |= settled(s, p, q, &G, top);
        *steps -= ~done;
        if (!any(~done)) break;
        I lower = E < lowest + 1e-15 * (vabs(E) + vabs(s->torque / s->R * q->a));   /* its rounding */
        lowest = vmin(lowest, E);
        waits = (waits + 1) & ~lower;
        EACH(m) ((V *)&best)[m] = sel(lower, ((V *)q)[m], ((V *)&best)[m]);
        EACH(m) ((V *)q)[m] -= sel(done, all(0), ((V *)&step)[m]);
        I back = (waits >= 4) & ~done;
        if (!any(back)) continue;
        evaluate(s, o, p, &best, hertz, 1, 0, &G, &step, &E, &top, NULL, 0);
        V low = all(0), high = all(1);
        I found = ~back;   /* lanes whose minimum lies beyond `low`; before, `high` shrinks */
        for (int m = 0; m < 20; m++) {
            V t = sel(found, (low + high) / 2, high);
            EACH(k) ((V *)&at)[k] = ((V *)&best)[k] - t * ((V *)&step)[k];
            Q unused;
            evaluate(s, o, p, &at, hertz, 0, 0, &G, &unused, &E, &top, NULL, 0);
            I falling = dot(&G, &step) > 0, first = falling & ~found;
            low = sel(falling, t, low);
            high = sel(first, vmin(4 * t, all(1)), sel(falling, high, sel(found, t, t / 4)));
            found |= falling;
            if (!any(~found | (back & (high - low > 0.2 * low)))) break;
        }
        EACH(m) ((V *)q)[m] = sel(back, ((V *)&best)[m] - low * ((V *)&step)[m], ((V *)q)[m]);
        waits &= ~back;
    }
    return done;
}
static inline __attribute__((always_inline)) void block(
    const Design *s, long units, long angles, const Angle *o, const double *x, int hertz, int warm, int patience,
    double *error, double *pins, long *steps, long begin, long end)
{   /* error (angles, units); pins (angles, 80, units) */
    long *late = malloc((end - begin + W) * sizeof(long));
    Q *last = aligned_alloc(64, (end - begin) / W * sizeof(Q)), q, G;
    Pack p;
    V E, top;
    for (long a = 0; a < angles; a++) {
        long many = 0;
        for (long u = begin; u < end; u += W) {
            long id[W];
            I n = (I){};
            for (int l = 0; l < W; l++) id[l] = u + l;
            gaps(s, o + a, x, units, id, &p);
            if (a && warm) q = last[(u - begin) / W];
            else {
                memset(&q, 0, sizeof q);
                Q step;
                evaluate(s, o + a, &p, &q, hertz, 1, 1, &G, &step, &E, &top, NULL, 0);
                EACH(m) ((V *)&q)[m] = -((V *)&step)[m];
            }
            I done = newton(s, o + a, &p, &q, hertz, patience, pins + a * 80 * units + u, units, &n);
            last[(u - begin) / W] = q;
            for (int l = 0; l < W; l++) {
                error[a * units + u + l] = q.a[l] / s->R, steps[a * units + u + l] = n[l];
                if (!done[l]) late[many++] = u + l;
            }
        }
        for (long f = 0; f < many; f += W) {   /* what is left, packed anew */
            long id[W];
            double some[80 * W] __attribute__((aligned(64)));
            I n = (I){};
            Q step;
            for (int l = 0; l < W; l++) id[l] = late[f + l < many ? f + l : many - 1];
            gaps(s, o + a, x, units, id, &p);
            memset(&q, 0, sizeof q);
            evaluate(s, o + a, &p, &q, hertz, 1, 1, &G, &step, &E, &top, NULL, 0);
            EACH(m) ((V *)&q)[m] = -((V *)&step)[m];
            I done = watched(s, o + a, &p, &q, hertz, some, W, &n);
            for (int l = 0; l < W && f + l < many; l++) {
                long u = id[l] - begin;
                EACH(m) ((V *)&last[u / W])[m][u %% W] = ((V *)&q)[m][l];
                error[a * units + id[l]] = done[l] ? q.a[l] / s->R : NAN;
                steps[a * units + id[l]] += n[l];
                for (int j = 0; j < 80; j++) pins[(a * 80 + j) * units + id[l]] = some[j * W + l];
            }
        }
    }
    free(late), free(last);
}
void solve(long units, long angles, const double *theta, const double *x, const double *d, long hertz, long warm,
           long patience, double *error, double *pins, long *steps)
{   /* units: a multiple of 8 */
    Design s = {d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7], d[8], d[9], d[10], d[11], d[12], d[13], d[14], d[15],
                d[16], d[17], d[18], (int)hertz};
    Angle *o = malloc(angles * sizeof(Angle));
    for (long a = 0; a < angles; a++) geometry(&s, theta[a], o + a);
    const long part = 256;
#pragma omp parallel for schedule(dynamic)
    for (long b = 0; b < units; b += part) {
        const long e = b + part < units ? b + part : units;
        if (hertz) block(&s, units, angles, o, x, 1, warm, patience, error, pins, steps, b, e);
        else block(&s, units, angles, o, x, 0, warm, patience, error, pins, steps, b, e);
    }
    free(o);
}
"""


def source() -> str:
    """C source with the places of the errors."""
    return SOURCE % OFFSETS


def numbers(design, torque, contact):
    """Numbers of a design (two cranks, two discs, 40 pins) in the order of the C program."""
    cy, st, g, con = design["cycloid"], design["stiffness"], design["involute"], design["contact"]
    rb, base = g["planet_base_radius"], con["young_modulus"] / (1 - con["poisson_ratio"] ** 2)
    mesh = 1 / (1 / st["sun_planet_mesh"] + 1 / st["planet_crank_bending"] + rb**2 / st["planet_crank_torsion"])
    k_pin = 4 * np.cos(cy["force_angle"]) ** 2 * st["disc_pin_mesh"] / 40
    c_pin = 2 / (np.pi * base * con["face_width"])
    # mean slope of a loaded pin: that of the mean load, y = 10 to 12
    force = max(abs(torque) / (2 * 39 * cy["eccentricity"] * 10), 1e-3)
    y = np.log(2 * np.pi * con["face_width"] * base * cy["pin_radius"]) - np.log(force)
    start = k_pin if contact == "linear" else 1 / (c_pin * (y - 1))
    return np.array([
        cy["eccentricity"], cy["pin_circle_radius"], cy["pin_radius"], design["cranks"]["circle_radius"],
        g["sun_base_radius"], rb, np.sin(g["pressure_angle"]), np.cos(g["pressure_angle"]),
        st["turning_arm_bearing"], st["support_bearing"], mesh, 1e-8 * st["turning_arm_bearing"],
        con["young_modulus"], con["poisson_ratio"], con["face_width"], k_pin, c_pin, torque, start,
    ])  # fmt: skip


def geometry(design, theta):
    """Of one angle: normals (2, 40, 2), levers over R, shift factors, A of the Hertz law, and eccentric directions."""
    e, rp, rr, R = design[:4]
    modulus, width = design[12] / (1 - design[13] ** 2), design[14]
    th, pins, pi = theta / 105, 40, np.pi
    b = -pins * th + pi * np.arange(2)
    g = 2 * pi * np.arange(pins) / pins - th
    psi, k1 = g - b[:, None], e * pins / rp
    square = (1 - k1) ** 2 + 4 * k1 * np.sin(psi / 2) ** 2
    S = np.sqrt(square)
    along, ring = np.stack([np.cos(b), np.sin(b)], -1), np.stack([np.cos(g), np.sin(g)], -1)
    normal = (k1 * along[:, None] - ring) / S[..., None]
    bend = (1 + pins * k1**2 - k1 * (1 + pins) * np.cos(psi)) / (rp * square * S)
    a = np.log(2 * pi * width * modulus * rr**2 / (rr * (1 - rr * bend))) - 1 / (2 * (1 - design[13]))
    return normal, e * 39 * np.sin(psi) / S / R, (1 - k1 * np.cos(psi)) / S, a, along, ring


def in_numpy(design, theta, x, contact, steps=60):
    """All units together at one angle: error (units,) and pins (units, 80). Rows of all springs, full Hessians."""
    e, _, _, R, _, rb, sine, cosine, ka, kh, km, k0, _, _, _, k_pin, c_pin, torque, start = design
    normal, lever, shift, a_law, along, ring = geometry(design, theta)
    units, part = (
        x.shape[1],
        {n: x[o : o + int(np.prod(s))].reshape(*s, -1) for (n, s), o in zip(FIELDS.items(), OFFSETS.values())},
    )
    pin_rows, arm_rows = np.zeros((2, 40, 13)), np.zeros((6, 2, 13))
    gaps, arm_gaps = np.zeros((2, 40, units)), np.zeros((6, 2, units))
    tangent = np.stack([-ring[:, 1], ring[:, 0]], -1)
    offset = ring.T[:, :, None] * part["pin_offset"][:, 0] + tangent.T[:, :, None] * part["pin_offset"][:, 1]
    radial, turned = np.array([-1.0, 1.0]), np.array([-1.0, 1.0])
    for k in range(2):
        at = 1 + 3 * k
        pin_rows[k, :, at : at + 2], pin_rows[k, :, at + 2] = -normal[k], lever[k]
        gaps[k] = part["pin_radii"] - part["equidistant_modification"] - shift[k][:, None] * part["pin_circle_radius"]
        gaps[k] += np.einsum("ja,aju->ju", normal[k], offset - part["disc_centre"][k][:, None])
        across = np.array([-along[k, 1], along[k, 0]])
        for i in range(2):
            row, crank = arm_rows[2 * k + i], 7 + 3 * i
            row[0, at] = row[1, at + 1] = 1
            row[1, at + 2] = turned[i]
            row[0, crank] = row[1, crank + 1] = -1
            row[:, crank + 2] = -e / rb * across
            bore = part["disc_bore"][k, i] * np.array([[radial[i]], [turned[i]]])
            away = part["crank_eccentricity"][k, i] * along[k][:, None]
            arm_gaps[2 * k + i] = bore - away - e * part["crank_phase"][i] * across[:, None]
    gear_rows = np.zeros((4, 13))
    for i in range(2):
        row = arm_rows[4 + i]
        row[0, 7 + 3 * i] = row[1, 8 + 3 * i] = 1
        row[1, 0] = -turned[i]
        arm_gaps[4 + i] = -part["carrier_bore"][i] * np.array([[radial[i]], [turned[i]]])
        for side in (0, 1):
            sign = 1 - 2 * side
            gear_rows[2 * side + i, 7 + 3 * i : 10 + 3 * i] = -sine * radial[i], -sign * cosine * turned[i], sign
    pin_rows, gaps, a_law = pin_rows.reshape(80, 13), gaps.reshape(80, units).T, a_law.reshape(80)
    arm_gaps, gear_gap = np.moveaxis(arm_gaps, 2, 0), (part["base_tangent_upper"] / 4)[:, None]
    loose = [
        np.repeat(np.maximum(part[n], 0)[:, None], m, 1)
        for n, m in (("bearing_clearance", 4), ("support_clearance", 2))
    ]
    loose, k_arm = np.concatenate(loose, 1), np.array([ka] * 4 + [kh] * 2)
    products = (pin_rows[:, :, None] * pin_rows[:, None, :]).reshape(80, 169)
    gear_products = (gear_rows[:, :, None] * gear_rows[:, None, :]).reshape(4, 169)
    load = np.zeros(13)
    load[0] = torque / R

    def state(q, some, hessian=True):
        d = q @ pin_rows.T + gaps[some]
        on = d > 0
        if contact == "linear":
            force, slope, energy = k_pin * d, k_pin, k_pin / 2 * d * d
        else:
            t = a_law - np.log(np.where(on, d, 1e-9) / c_pin)
            t = np.maximum(t, 1.02)
            y = t + np.log(t) + 0.1
            for _ in range(3):
                y -= (y - np.log(y) - t) * y / (y - 1)
            force, slope = d / (c_pin * y), 1 / (c_pin * (y - 1))
            energy = c_pin / 4 * force**2 * (2 * y - 1)
        force, slope = np.where(on, force, 0), np.where(on, slope, 0)
        flank = q @ gear_rows.T + gear_gap[some]
        mesh = km * (flank > 0)
        w = np.einsum("uc,bac->uba", q, arm_rows) + arm_gaps[some]
        size = np.sqrt((w * w).sum(-1))
        over, safe = np.maximum(size - loose[some], 0), np.where(size > 0, size, 1)
        reaction = (k_arm * over / safe)[..., None] * w
        gradient = load + k0 * q + force @ pin_rows + (mesh * flank) @ gear_rows
        gradient += np.einsum("uba,bac->uc", reaction, arm_rows)
        total = np.where(on, energy, 0).sum(1) + (mesh * flank**2).sum(1) / 2 + (k_arm * over**2).sum(1) / 2
        total += k0 / 2 * (q * q).sum(1) + q @ load
        top = np.maximum(np.maximum(force.max(1), abs(torque / R)), np.abs(reaction).max((1, 2)))
        if not hessian:
            return total, gradient, None, top, force
        H = (slope @ products + mesh @ gear_products).reshape(-1, 13, 13) + k0 * np.eye(13)
        u = w / safe[..., None]
        around = np.where(loose[some] > 0, over / safe, 1)
        block = u[..., :, None] * u[..., None, :]
        block = ((over > 0) | (loose[some] == 0))[..., None, None] * block + around[..., None, None] * (
            np.eye(2) - block
        )
        half = np.einsum("ubac,bcn->uban", k_arm[:, None, None] * block, arm_rows)
        H += np.einsum("bam,uban->umn", arm_rows, half, optimize=True)
        return total, gradient, H, top, force

    lit = (lever.reshape(80) * torque < 0) * start
    H = (pin_rows.T * lit) @ pin_rows + km * (gear_rows.T * np.repeat([torque > 0, torque < 0], 2)) @ gear_rows
    H = H + np.einsum("bam,b,ban->mn", arm_rows, k_arm, arm_rows) + k0 * np.eye(13)
    first = load + (gaps * lit) @ pin_rows + km * gear_gap * gear_rows[[0, 1] if torque > 0 else [2, 3]].sum(0)
    first = first + np.einsum("uba,b,bac->uc", arm_gaps, k_arm, arm_rows)
    q = -np.linalg.solve(H, first.T).T
    found, pins, some = q.copy(), np.zeros((units, 80)), np.arange(units)
    best, lowest, waits = q.copy(), np.full(units, np.inf), np.zeros(units, int)
    for _ in range(steps):
        energy, gradient, H, top, force = state(q, some)
        span = np.maximum(np.abs(q).max(1), np.abs(gaps[some]).max(1))
        done = np.abs(gradient).max(1) <= np.maximum(1e-13 * top, 4e-16 * kh * span)
        found[some], pins[some] = q, force
        lower = energy < lowest
        best[lower], lowest, waits = q[lower], np.minimum(lowest, energy), np.where(lower, 0, waits + 1)
        keep = ~done
        if not keep.any():
            break
        q = q[keep] - np.linalg.solve(H[keep], gradient[keep][..., None])[..., 0]
        some, best, lowest, waits = some[keep], best[keep], lowest[keep], waits[keep]
        back = np.flatnonzero(waits >= 4)
        if len(back):
            begin, own = best[back], some[back]
            _, gradient, H, _, _ = state(begin, own)
            away = -np.linalg.solve(H, gradient[..., None])[..., 0]
            low, high = np.zeros(len(back)), np.ones(len(back))
            for n in range(14):
                t = (low + high) / 2 if n else high
                slope = (state(begin + t[:, None] * away, own, False)[1] * away).sum(1)
                low, high = np.where(slope < 0, t, low), np.where(slope < 0, high, t)
            q[back], waits[back] = begin + np.where(low > 0, low, high)[:, None] * away, 0
    return found[:, 0] / R, pins


@numba.njit(parallel=True, fastmath=True, cache=False)
def numba_units(design, normal, lever, a_law, gaps, arm_x, arm_y, seat_x, seat_y, loose, gear, eb, hertz, error, pins):
    """Units in parallel, Newton from the linear start; a unit that 30 steps leave is NaN (none at rated torque).

    Design as in the C program; normal (2, 40, 2), lever and a_law (2, 40) of the angle; eb (2, 2) is e u(b) / r_b. The
    units come first: gaps (units, 2, 40), arm_x and arm_y (units, 2, 2), seat_x, seat_y and loose (units, 2).
    """
    R, sine, cosine, ka, kh, km, k0 = design[3], design[6], design[7], design[8], design[9], design[10], design[11]
    k_pin, c_pin, torque, start = design[15], design[16], design[17], design[18]
    sign = np.array([-1.0, 1.0])
    for unit in numba.prange(error.size):
        q, g, H = np.zeros(13), np.empty(13), np.empty((13, 13))
        error[unit] = np.nan
        for step in range(31):
            g[:] = k0 * q
            g[0] += torque / R
            H[:] = 0.0
            for n in range(13):
                H[n, n] = k0
            top, size = abs(torque / R), 0.0
            for k in range(2):
                at = 1 + 3 * k
                fx = fy = fb = xx = xy = yy = xb = yb = bb = 0.0
                for j in range(40):
                    nx, ny, lv = normal[k, j, 0], normal[k, j, 1], lever[k, j]
                    d = gaps[unit, k, j] - nx * q[at] - ny * q[at + 1] + lv * q[at + 2]
                    force = slope = 0.0
                    if step == 0:
                        slope = start if lv * torque < 0 else 0.0
                        force = slope * d
                    elif d > 0:
                        if hertz:
                            t = max(a_law[k, j] - math.log(d / c_pin), 1.02)
                            y = t + math.log(t) + 0.1
                            for _ in range(3):
                                y -= (y - math.log(y) - t) * y / (y - 1)
                            force, slope = d / (c_pin * y), 1 / (c_pin * (y - 1))
                        else:
                            force, slope = k_pin * d, k_pin
                        top = max(top, force)
                    if step > 0:
                        pins[unit, 40 * k + j] = force
                    size = max(size, abs(gaps[unit, k, j]))
                    fx -= nx * force
                    fy -= ny * force
                    fb += lv * force
                    sx, sy = nx * slope, ny * slope
                    xx += nx * sx
                    xy += ny * sx
                    yy += ny * sy
                    xb -= lv * sx
                    yb -= lv * sy
                    bb += lv * lv * slope
                g[at] += fx
                g[at + 1] += fy
                g[at + 2] += fb
                H[at, at] += xx
                H[at + 1, at] += xy
                H[at + 1, at + 1] += yy
                H[at + 2, at] += xb
                H[at + 2, at + 1] += yb
                H[at + 2, at + 2] += bb
            for b in range(6):
                seat = b >= 4
                i = b - 4 if seat else b % 2
                k, crank = b // 2, 7 + 3 * i
                at = 1 + 3 * k
                if seat:
                    wx, wy = seat_x[unit, i] + q[crank], seat_y[unit, i] + q[crank + 1] - sign[i] * q[0]
                else:
                    wx = arm_x[unit, k, i] + q[at] - q[crank] + eb[k, 1] * q[crank + 2]
                    wy = arm_y[unit, k, i] + q[at + 1] + sign[i] * q[at + 2] - q[crank + 1] - eb[k, 0] * q[crank + 2]
                stiff, play = (kh, loose[unit, 1]) if seat else (ka, loose[unit, 0])
                if step == 0:
                    play = 0.0
                length = math.sqrt(wx * wx + wy * wy)
                over = max(length - play, 0.0)
                ux, uy = (wx / length, wy / length) if length > 0 else (1.0, 0.0)
                ring = 1.0 if play == 0 else (over / length if length > 0 else 0.0)
                along = (1.0 if over > 0 or play == 0 else 0.0) - ring
                fx, fy = stiff * over * ux, stiff * over * uy
                mxx, mxy, myy = (
                    stiff * (ring + along * ux * ux),
                    stiff * along * ux * uy,
                    stiff * (ring + along * uy * uy),
                )
                top = max(top, stiff * over)
                if seat:
                    g[0] -= sign[i] * fy
                    g[crank] += fx
                    g[crank + 1] += fy
                    H[0, 0] += myy
                    H[crank, 0] -= sign[i] * mxy
                    H[crank + 1, 0] -= sign[i] * myy
                    H[crank, crank] += mxx
                    H[crank + 1, crank] += mxy
                    H[crank + 1, crank + 1] += myy
                    continue
                px, py = eb[k, 1], -eb[k, 0]
                hx, hy = mxx * px + mxy * py, mxy * px + myy * py
                g[at] += fx
                g[at + 1] += fy
                g[at + 2] += sign[i] * fy
                g[crank] -= fx
                g[crank + 1] -= fy
                g[crank + 2] += px * fx + py * fy
                H[at, at] += mxx
                H[at + 1, at] += mxy
                H[at + 1, at + 1] += myy
                H[at + 2, at] += sign[i] * mxy
                H[at + 2, at + 1] += sign[i] * myy
                H[at + 2, at + 2] += myy
                H[crank, at] -= mxx
                H[crank, at + 1] -= mxy
                H[crank, at + 2] -= sign[i] * mxy
                H[crank + 1, at] -= mxy
                H[crank + 1, at + 1] -= myy
                H[crank + 1, at + 2] -= sign[i] * myy
                H[crank + 2, at] += hx
                H[crank + 2, at + 1] += hy
                H[crank + 2, at + 2] += sign[i] * hy
                H[crank, crank] += mxx
                H[crank + 1, crank] += mxy
                H[crank + 1, crank + 1] += myy
                H[crank + 2, crank] -= hx
                H[crank + 2, crank + 1] -= hy
                H[crank + 2, crank + 2] += px * hx + py * hy
            for i in range(2):
                crank = 7 + 3 * i
                for side in (1.0, -1.0):
                    dx, dy = sine * sign[i], side * cosine * sign[i]
                    d = gear[unit] - dx * q[crank] - dy * q[crank + 1] + side * q[crank + 2]
                    on = side * torque > 0 if step == 0 else d > 0
                    slope = km if on else 0.0
                    force = slope * d
                    g[crank] -= dx * force
                    g[crank + 1] -= dy * force
                    g[crank + 2] += side * force
                    H[crank, crank] += dx * dx * slope
                    H[crank + 1, crank] += dx * dy * slope
                    H[crank + 1, crank + 1] += dy * dy * slope
                    H[crank + 2, crank] -= side * dx * slope
                    H[crank + 2, crank + 1] -= side * dy * slope
                    H[crank + 2, crank + 2] += slope
            worst = 0.0
            for n in range(13):
                worst, size = max(worst, abs(g[n])), max(size, abs(q[n]))
            if step > 0 and worst <= max(1e-13 * top, 4e-16 * kh * size):
                error[unit] = q[0] / R
                break
            for j in range(13):  # L D L', the lower half in place
                for i in range(j + 1, 13):
                    factor = H[i, j] / H[j, j]
                    if factor != 0.0:
                        for n in range(i, 13):
                            H[n, i] -= factor * H[n, j]
                        g[i] -= factor * g[j]
            for i in range(12, -1, -1):
                total = g[i]
                for n in range(i + 1, 13):
                    total -= H[n, i] * g[n]
                g[i] = total / H[i, i]
            for n in range(13):
                q[n] -= g[n]


def in_numba(design, theta, x, contact):
    """One angle: error (units,) and pins (units, 80)."""
    normal, lever, shift, a_law, along, ring = geometry(design, theta)
    e, rb = design[0], design[5]
    units, part = (
        x.shape[1],
        {n: x[o : o + int(np.prod(s))].reshape(*s, -1) for (n, s), o in zip(FIELDS.items(), OFFSETS.values())},
    )
    tangent = np.stack([-ring[:, 1], ring[:, 0]], -1)
    gaps = np.empty((units, 2, 40))
    arm_x, arm_y = np.empty((2, 2, 2, units))
    for k in range(2):
        row = part["pin_radii"] - part["equidistant_modification"] - shift[k][:, None] * part["pin_circle_radius"]
        row = row + (normal[k] * ring).sum(1)[:, None] * part["pin_offset"][:, 0]
        row += (normal[k] * tangent).sum(1)[:, None] * part["pin_offset"][:, 1]
        gaps[:, k] = (row - normal[k] @ part["disc_centre"][k]).T
        for i, sign in enumerate((-1, 1)):
            delta, phase, bore = part["crank_eccentricity"][k, i], e * part["crank_phase"][i], part["disc_bore"][k, i]
            arm_x[k, i] = sign * bore[0] - delta * along[k, 0] + phase * along[k, 1]
            arm_y[k, i] = sign * bore[1] - delta * along[k, 1] - phase * along[k, 0]
    seat = -part["carrier_bore"] * np.array([-1, 1])[:, None, None]
    loose = np.maximum(np.stack([part["bearing_clearance"], part["support_clearance"]], -1), 0)
    error, pins = np.empty(units), np.zeros((units, 80))
    moved = [np.ascontiguousarray(np.moveaxis(v, -1, 0)) for v in (arm_x, arm_y, seat[:, 0], seat[:, 1])]
    numba_units(design, normal, lever, a_law, gaps, *moved, loose, part["base_tangent_upper"] / 4, e / rb * along,
                contact == "hertz", error, pins)  # fmt: skip
    return error, pins
