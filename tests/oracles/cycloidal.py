"""Independent model of a loaded single-stage cycloidal drive in plain NumPy: one convex energy, minimised by Newton.

Written from the equations alone, without rvjax. A case is a design (nested dictionaries of the records by field name),
errors by name, an input angle and the torque of the discs on the output. Unknowns: disc k (x, y, beta) from row 3 k on,
carrier rotation alpha, then the shaft's x, y if it has supports, then the carrier's x, y if it floats.
"""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.optimize

SHAPES = {
    "pin_offset": ("p", 2), "pin_radii": ("p",), "ring_centre": (2,), "disc_centre": ("d", 2), "disc_pitch": ("d", "z"),
    "disc_profile": ("d", 5, 2), "throw": ("d",), "eccentric_phase": ("d",), "hole_position": ("d", "n", 2),
    "hole_radius": ("d", "n"), "output_pin_offset": ("n", 2), "output_pin_radius": ("n",), "shaft_centre": (2,),
    "carrier_centre": (2,),
}  # fmt: skip
SCALARS = (
    "bearing_clearance", "support_clearance", "eccentricity", "pin_circle_radius", "pin_radius", "pin_hole_clearance",
    "equidistant_modification", "shift_modification",
)  # fmt: skip


def unit(angle: Any) -> Any:
    """Unit vectors (..., 2)."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def quarter(vector: Any) -> Any:
    """Vectors turned by 90 degrees."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)


def turned(vector: Any, angle: float) -> Any:
    """A vector turned by an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ vector


@dataclass
class Drive:
    """Directions and gaps of one angle, as the equations name them."""

    design: dict[str, Any]
    errors: SimpleNamespace
    e: float
    ratio: float
    share: float  # torque of the carrier over that of the output
    b: Any  # (d,) eccentrics
    a: Any  # (n,) output pins
    normal: Any  # (d, p, 2)
    lever: Any  # (d, p)
    curvature: Any  # (d, p) of the flank
    pin_gap: Any  # (d, p)
    hole_gap: Any  # (d, n)
    centre_gap: Any  # (d, 2)


def drive(design: dict[str, Any], given: dict[str, Any], angle: float) -> Drive:
    """Geometry and gaps at an input angle."""
    cycloid, output, ring_out = design["cycloid"], design["output"], design["member"] == "ring"
    zc, zp, nd, n = cycloid["disc_teeth"], cycloid["pin_count"], cycloid["disc_count"], output["count"]
    sizes = {"p": zp, "d": nd, "z": zc, "n": n}
    errors = SimpleNamespace(**{name: float(given.get(name, 0.0)) for name in SCALARS})
    for name, shape in SHAPES.items():
        full = tuple(sizes[axis] if isinstance(axis, str) else axis for axis in shape)
        setattr(errors, name, np.broadcast_to(np.asarray(given.get(name, 0.0), float), full))
    e, rp = cycloid["eccentricity"] + errors.eccentricity, cycloid["pin_circle_radius"]
    th = -angle / (zp if ring_out else zc)
    k, j, m = np.arange(nd), np.arange(zp), np.arange(n)
    b, g, a = -zp * th + 2 * np.pi * k / nd, 2 * np.pi * j / zp - th, 2 * np.pi * m / n
    psi = 2 * np.pi * j[None] / zp + zc * th - 2 * np.pi * k[:, None] / nd  # g - b, less whole turns
    k1 = e * zp / rp
    size = np.sqrt(1 + k1**2 - 2 * k1 * np.cos(psi))
    normal = (k1 * unit(b)[:, None] - unit(g)[None]) / size[..., None]
    lever = e * zc * np.sin(psi) / size
    laps = np.floor((zc * th) / (2 * np.pi) + j[None] / zp - k[:, None] / nd)
    tooth = np.mod(j[None] - laps, zc).astype(int)

    play = cycloid.get("equidistant_modification", 0) + errors.equidistant_modification
    play += -errors.pin_radius + errors.pin_hole_clearance / 2
    shift = cycloid.get("shift_modification", 0) + errors.shift_modification - errors.pin_circle_radius
    offset = errors.pin_offset[:, :1] * unit(g) + errors.pin_offset[:, 1:] * quarter(unit(g))
    offset = offset + turned(errors.ring_centre, -th)
    pin = -play + shift * (1 - k1 * np.cos(psi)) / size + errors.pin_radii[None]
    pin = pin + np.sum(normal * (offset[None] - errors.disc_centre[:, None]), axis=-1)
    pin = pin + np.take_along_axis(errors.disc_pitch, tooth, axis=1) * zp / (zc * rp) * lever
    f = np.arange(5)
    waves = np.stack([np.cos(f * psi[..., None]), np.sin(f * psi[..., None])], axis=-1)
    pin = pin + np.sum(waves * errors.disc_profile[:, None], axis=(-2, -1))

    held = errors.hole_position[..., :1] * unit(a) + errors.hole_position[..., 1:] * quarter(unit(a))
    carried = errors.output_pin_offset[:, :1] * unit(a) + errors.output_pin_offset[:, 1:] * quarter(unit(a))
    away = held - (carried + errors.carrier_centre)[None]
    clearance = output["hole_clearance"] / 2 + errors.hole_radius - errors.output_pin_radius[None]
    hole = np.einsum("kx,kmx->km", unit(b), away) - clearance + errors.eccentricity

    centre = errors.shaft_centre if ring_out else turned(errors.shaft_centre, -th)
    ahead = e * errors.eccentric_phase[:, None] * quarter(unit(b))
    gap = -(errors.throw[:, None] * unit(b) + ahead + centre)
    bend = (1 + zp * k1**2 - k1 * (1 + zp) * np.cos(psi)) / (rp * size**3)
    ratio, share = (zp, -zc / zp) if ring_out else (-zc, 1.0)
    return Drive(design, errors, e, ratio, share, b, a, normal, lever, bend, pin, hole, gap)


@dataclass
class Contacts:
    """Contacts of one kind: depth = gap + rows q."""

    rows: Any  # (c, unknowns)
    gap: Any  # (c,)
    model: str
    compliance: Any  # (c,) c, k or C
    level: Any  # (c,) A
    radius: Any  # (c,) R*
    pin: float  # radius of the pin

    def at(self, q: Any) -> tuple[Any, Any, float]:
        """Force and slope of every contact, energy of all."""
        depth = self.gap + self.rows @ q
        d, c = np.maximum(depth, 0), self.compliance
        if self.model == "linear":
            return c * d, np.where(depth > 0, c, 0.0), float(np.sum(c * d * d) / 2)
        if self.model == "palmgren":
            force = (d / c) ** (10 / 9)
            slope = np.where(depth > 0, 10 / 9 * force / np.where(d > 0, d, 1), 0)
            return force, slope, float(np.sum(9 / 19 * force * d))
        most = 0.9 * c * np.exp(self.level - 1)  # beyond it a straight line, in trial steps only
        inside = np.where(depth > 0, np.minimum(d, most), most)
        t = self.level - np.log(inside / c)
        y = t + np.log(t) + 0.1
        for _ in range(60):
            y = y - (y - np.log(y) - t) * y / (y - 1)
        force, slope = inside / (c * y), 1 / (c * (y - 1))
        energy, beyond = c * force**2 * (2 * y - 1) / 4, np.maximum(d - most, 0)
        energy = energy + force * beyond + slope * beyond**2 / 2
        force = force + slope * beyond
        force, slope, energy = (np.where(depth > 0, x, 0.0) for x in (force, slope, energy))
        return force, slope, float(np.sum(energy))


@dataclass
class Machine:
    """The energy of one case."""

    drive: Drive
    groups: tuple[Contacts, Contacts]  # pins, holes
    bearing_rows: Any  # (m, 2, unknowns)
    bearing_gap: Any  # (m, 2)
    bearing: Any  # (m,)
    clearance: Any  # (m,)
    springs: Any  # (unknowns,) supports and centring
    load: float  # torque of the carrier

    @property
    def turn(self) -> int:
        """Row of alpha."""
        return 3 * len(self.drive.b)

    def held(self, q: Any) -> tuple[Any, Any, float]:
        """Forces (m, 2) and stiffness (m, 2, 2) of the bearings, and their energy."""
        w = self.bearing_gap + self.bearing_rows @ q
        length = np.linalg.norm(w, axis=1)
        force, stiff, energy = np.zeros_like(w), np.zeros((*w.shape, 2)), 0.0
        for i, (k, c, size) in enumerate(zip(self.bearing, self.clearance, length)):
            if size >= c and (size > 0 or c == 0):
                along = w[i] / size if size > 0 else np.zeros(2)
                slack = c / size if size > 0 else 0.0
                force[i] = k * (size - c) * along
                stiff[i] = k * ((1 - slack) * np.eye(2) + slack * np.outer(along, along))
                energy += k / 2 * (size - c) ** 2
        return force, stiff, energy

    def state(self, q: Any) -> tuple[float, Any, Any]:
        """Energy, gradient and second derivatives."""
        energy = float(np.sum(self.springs * q * q) / 2 + self.load * q[self.turn])
        gradient, hessian = self.springs * q, np.diag(self.springs)
        gradient[self.turn] += self.load
        for group in self.groups:
            force, slope, own = group.at(q)
            energy += own
            gradient = gradient + group.rows.T @ force
            hessian = hessian + (group.rows * slope[:, None]).T @ group.rows
        force, stiff, own = self.held(q)
        gradient = gradient + np.einsum("mxn,mx->n", self.bearing_rows, force)
        hessian = hessian + np.einsum("mxn,mxy,myl->nl", self.bearing_rows, stiff, self.bearing_rows)
        return energy + own, gradient, hessian


def machine(
    design: dict[str, Any], errors: dict[str, Any], angle: float, torque: float, contact: str = "hertz",
    carrier: str = "fixed",
) -> Machine:  # fmt: skip
    """The energy of a case."""
    at = drive(design, errors, angle)
    springs, output, elastic = design["stiffness"], design["output"], design["contact"]
    nd, n, p = len(at.b), len(at.a), at.lever.shape[1]
    held = springs.get("shaft_support") is not None
    floats = carrier == "floating"
    alpha = 3 * nd
    shaft, frame = alpha + 1, alpha + 1 + 2 * held
    unknowns = frame + 2 * floats
    pins, holes = np.zeros((nd, p, unknowns)), np.zeros((nd, n, unknowns))
    rows = np.zeros((nd + held, 2, unknowns))
    for k, b in enumerate(at.b):
        u, own = unit(b), slice(3 * k, 3 * k + 2)
        pins[k, :, own], pins[k, :, 3 * k + 2] = -at.normal[k], at.lever[k]
        holes[k, :, own] = u
        holes[k, :, 3 * k + 2] = output["circle_radius"] * np.sin(b - at.a)
        holes[k, :, alpha] = -holes[k, :, 3 * k + 2]
        rows[k, :, own] = np.eye(2)
        if held:
            rows[k, :, shaft : shaft + 2] = -np.eye(2)
        if floats:
            holes[k, :, frame : frame + 2] = -u
    gap, bearing = at.centre_gap, np.broadcast_to(np.asarray(springs["eccentric_bearing"], float), (nd,))
    clearance = np.full(nd, max(at.errors.bearing_clearance, 0.0))
    mean = float(np.mean(bearing))
    if held:
        rows[nd, :, shaft : shaft + 2] = np.eye(2)
        gap, bearing = np.vstack([gap, np.zeros((1, 2))]), np.append(bearing, springs["shaft_support"])
        clearance = np.append(clearance, max(at.errors.support_clearance, 0.0))
    weight = np.ones(unknowns)
    weight[[*range(2, alpha, 3), alpha]] = output["circle_radius"] ** 2
    weight *= 1e-8 * mean
    if floats:
        weight[frame:] += springs["output_support"]

    rr, rw = design["cycloid"]["pin_radius"], output["pin_radius"]
    hole = rw + design["cycloid"]["eccentricity"] + output["hole_clearance"] / 2
    pin_radius = (rr * (1 - rr * at.curvature)).ravel()
    hole_radius = np.full(nd * n, 1 / (1 / rw - 1 / hole))
    groups = []
    for body, depth, radius, r, own in (
        (pins, at.pin_gap, pin_radius, rr, elastic), (holes, at.hole_gap, hole_radius, rw, output),
    ):  # fmt: skip
        groups.append(contacts(contact, body.reshape(-1, unknowns), depth, radius, r, elastic, own))
    return Machine(at, (groups[0], groups[1]), rows, gap, bearing, clearance, weight, torque * at.share)


def contacts(
    contact: str, rows: Any, gap: Any, radius: Any, pin: float, elastic: dict[str, Any], own: dict[str, Any]
) -> Contacts:
    """Contacts with the coefficients of their model; `own` has stiffness and support of the pins concerned."""
    s1, s2, width = *compliances(elastic), elastic["face_width"]
    support = None if own.get("pin_support") is None else np.broadcast_to(own["pin_support"], gap.shape).ravel()
    level = np.zeros(gap.size)
    if contact == "linear":
        soft = 0 if support is None else 1 / support
        c = 1 / (1 / own["pin_stiffness"] + soft) + level
    elif contact == "palmgren":
        c = 3.81 * ((s1 + s2) / np.pi) ** 0.9 / width**0.8 + level
    else:
        c = (s1 + s2) / (np.pi * width) + level
        nu = elastic["poisson_ratio"]
        level = np.log(4 * np.pi * width * pin**2 / ((s1 + s2) * radius)) - (s2 + s1 * nu / (1 - nu)) / (s1 + s2)
        level = level + (0 if support is None else 1 / (c * support))
    return Contacts(rows, gap.ravel(), contact, c, level, radius, pin)


def compliances(elastic: dict[str, Any]) -> tuple[float, float]:
    """(1 - nu^2)/E of discs and pins."""
    s1 = (1 - elastic["poisson_ratio"] ** 2) / elastic["young_modulus"]
    if elastic.get("pin_young_modulus") is None:
        return s1, s1
    return s1, (1 - elastic["pin_poisson_ratio"] ** 2) / elastic["pin_young_modulus"]


def step(hessian: Any, gradient: Any) -> Any:
    """H^-1 g, with H scaled to a diagonal of ones."""
    scale = 1 / np.sqrt(np.diag(hessian))
    return scale * np.linalg.solve(hessian * scale[:, None] * scale, scale * gradient)


def minimise(m: Machine, start: Any = None, steps: int = 2000) -> tuple[Any, bool]:
    """Position of least energy by full Newton steps; four without a lower energy lead to a search on the line."""
    q = np.zeros(m.springs.size) if start is None else np.array(start, float)
    best, lowest, waiting, calm = q, np.inf, 0, 0
    for _ in range(steps):
        energy, gradient, hessian = m.state(q)
        scale = 1 / np.sqrt(np.diag(hessian))
        force = max(float(group.at(q)[0].max()) for group in m.groups)
        noise = 4e-16 * max(float(g.compliance.max()) if g.model == "linear" else 1e9 for g in m.groups) * 1e-4
        if np.abs(scale * gradient).max() <= scale.max() * max(1e-13 * force, noise, 1e-300):
            calm += 1
            if calm == 3:
                return q, True
        if energy < lowest:
            best, lowest, waiting = q, energy, 0
        else:
            waiting += 1
        if waiting >= 4 and not calm:
            _, gradient, hessian = m.state(best)
            way = -step(hessian, gradient)
            q, waiting = best + _along(m, best, way) * way, 0
        else:
            q = q - step(hessian, gradient)
    return best, False


def _along(m: Machine, q: Any, way: Any) -> float:
    """Share of a step at which the slope of the energy changes its sign."""
    slope = lambda t: float(m.state(q + t * way)[1] @ way)  # noqa: E731
    far = 1.0
    while slope(far) < 0 and far < 1e12:
        far *= 4
    return float(scipy.optimize.brentq(slope, 0, far, xtol=1e-15 * far, rtol=1e-12)) if slope(far) > 0 else far


def equilibrium(
    design: dict[str, Any], errors: dict[str, Any], *, input_angle: float, output_torque: float,
    contact: str = "hertz", carrier: str = "fixed",
) -> dict[str, Any]:  # fmt: skip
    """Results of a case by the names of `rvjax.loaded.Loaded`."""
    m = machine(design, errors, input_angle, output_torque, contact, carrier)
    q, found = minimise(m)
    at, nd = m.drive, len(m.drive.b)
    pins, holes = (group.at(q)[0].reshape(nd, -1) for group in m.groups)
    u = unit(at.b)
    disc_bearing = -m.held(q)[0][:nd]
    s1, s2 = compliances(design["contact"])
    square = np.pi * design["contact"]["face_width"] * (s1 + s2)
    unit_load = np.zeros(q.size)
    unit_load[m.turn] = 1.0
    loaded = max(pins.max(), holes.max()) > 1e-8 * float(np.mean(m.bearing[:nd])) * design["cycloid"]["pin_radius"]
    return {
        "status": "MAX_STEPS" if not found else "CONVERGED" if loaded or output_torque else "UNLOADED",
        "error": at.share * q[m.turn],
        "pins": pins,
        "output_pins": holes,
        "pressure": np.sqrt(pins / (square * m.groups[0].radius.reshape(pins.shape))),
        "output_pressure": np.sqrt(holes / (square * m.groups[1].radius.reshape(holes.shape))),
        "disc_bearing": disc_bearing[:, None],
        "support_bearing": -disc_bearing.sum(0)[None],
        "output_bearing": (holes.sum(1)[:, None] * u).sum(0),
        "input_torque": float(np.sum(at.e * quarter(u) * disc_bearing)),
        "disc_torque": -np.sum(at.lever * pins, axis=1),
        "stiffness": 1 / step(m.state(q)[2], unit_load)[m.turn] / at.share**2,
        "position": q,
    }


def fit(design: dict[str, Any], errors: dict[str, Any], angle: float) -> float:
    """Largest least clearance of all pins and holes without load, m: a linear programme over alpha and every beta."""
    return fit_of(drive(design, errors, angle))


def fit_of(at: Drive) -> float:
    """Largest least clearance of directions and gaps, m."""
    nd, u = len(at.b), unit(at.b)
    t = -at.centre_gap
    pins = at.pin_gap - np.einsum("kjx,kx->kj", at.normal, t)
    holes = at.hole_gap + np.einsum("kx,kx->k", u, t)[:, None]
    arm = at.design["output"]["circle_radius"] * np.sin(at.b[:, None] - at.a[None])
    rows, limits = [], []  # s + depth of the unknowns <= -depth of the gaps; lengths in um, angles in urad
    for k in range(nd):
        for lever, gap, whole in ((at.lever, pins, 0.0), (arm, holes, -1.0)):
            for one, depth in zip(lever[k], gap[k]):
                row = np.zeros(nd + 2)
                row[0], row[1], row[2 + k] = 1.0, whole * one, one
                rows.append(row)
                limits.append(-depth * 1e6)
    found = scipy.optimize.linprog([-1.0, *[0.0] * (nd + 1)], A_ub=rows, b_ub=limits, bounds=[(None, None)] * (nd + 2))
    return float(-found.fun) * 1e-6
