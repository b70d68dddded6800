// The loaded RV-40E in C: the elements of a vector are units, one vector at a time; pins enter by nine sums a disc, discs are eliminated
// before carrier and cranks; three logarithms a Hertz pin, by polynomial, one of them rough. Units that twelve Newton steps
// leave are packed again and go on with best points and line searches. AT_... are the rows of the errors, defined by
// loaded_others.py.
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
    V equi = X(AT_equidistant_modification), circle = X(AT_pin_circle_radius), most = all(0);
    V zero = all(0);
    p->cl = vmax(X(AT_bearing_clearance), zero), p->cls = vmax(X(AT_support_clearance), zero);
    p->gear = X(AT_base_tangent_upper) / 4;
    for (int k = 0; k < D; k++) {
        V cx = X(AT_disc_centre + 2 * k), cy = X(AT_disc_centre + 2 * k + 1);
        for (int i = 0; i < 2; i++) {
            V d = X(AT_crank_eccentricity + 2 * k + i), f = s->e * X(AT_crank_phase + i);
            p->ax[k][i] = erx[i] * X(AT_disc_bore + 4 * k + 2 * i) - d * o->ux[k] + f * o->uy[k];
            p->ay[k][i] = ety[i] * X(AT_disc_bore + 4 * k + 2 * i + 1) - d * o->uy[k] - f * o->ux[k];
            most = vmax(most, vmax(vabs(p->ax[k][i]), vabs(p->ay[k][i])));
        }
        for (int j = 0; j < P; j++) {
            V g = X(AT_pin_radii + j) - equi - circle * o->w[k][j] - o->nx[k][j] * cx - o->ny[k][j] * cy;
            g += o->nr[k][j] * X(AT_pin_offset + 2 * j) + o->nt[k][j] * X(AT_pin_offset + 2 * j + 1);
            p->g[k][j] = g;
            most = vmax(most, vabs(g));
        }
    }
    for (int i = 0; i < 2; i++) {
        p->sx[i] = -erx[i] * X(AT_carrier_bore + 2 * i), p->sy[i] = -ety[i] * X(AT_carrier_bore + 2 * i + 1);
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
    for (int n = 0; n < 6; n++) r[1 + n] = G->c[n / 3][n % 3];
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
    for (int n = 0; n < 6; n++) step->c[n / 3][n % 3] = r[1 + n];
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
/* Newton from q; elements that `limit` steps leave stay 0 in the result. Finished elements do not move. */
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
        I found = ~back;   /* elements whose minimum lies beyond `low`; before, `high` shrinks */
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
        for (long f = 0; f < many; f += W) {   /* what is left, packed again */
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
                EACH(m) ((V *)&last[u / W])[m][u % W] = ((V *)&q)[m][l];
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
