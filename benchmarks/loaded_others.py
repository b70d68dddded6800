"""The loaded RV-40E in C and NumPy, each written as well as its language allows; one algorithm for all.

C: `loaded.c`. NumPy: all units together, the Hessian of the pins as one matrix product. Numba: `loaded_numba.py`.
"""

from pathlib import Path

import numpy as np

# Errors of a unit, the rows of `x` (rows, units).
FIELDS = {
    "crank_eccentricity": (2, 2), "crank_phase": (2,), "disc_bore": (2, 2, 2), "carrier_bore": (2, 2),
    "bearing_clearance": (), "support_clearance": (), "base_tangent_upper": (), "pin_circle_radius": (),
    "equidistant_modification": (), "disc_centre": (2, 2), "pin_radii": (40,), "pin_offset": (40, 2),
}  # fmt: skip
OFFSETS = dict(zip(FIELDS, np.cumsum([0, *(int(np.prod(shape)) for shape in FIELDS.values())])))
COLUMNS = sum(int(np.prod(shape)) for shape in FIELDS.values())


def source() -> str:
    """C source with the places of the errors."""
    places = "".join(f"#define AT_{name} {int(offset)}\n" for name, offset in OFFSETS.items())
    return places + Path(__file__).with_name("loaded.c").read_text("utf-8")


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
    """Of one angle: normals (2, 40, 2), levers over R, shift factors, A of the Hertz contact law, directions."""
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
