"""The loaded RV-40E in Numba: one unit at a time, the steps of `loaded.c`."""

import math

import numba
import numpy as np

from benchmarks.loaded_others import FIELDS, OFFSETS, geometry


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
