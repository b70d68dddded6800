"""Independent NumPy model of the loaded reducer: all springs as rows of dense matrices, in 80-bit numbers.

Nothing here is shared with rvjax. Every contact, gear flank and bearing is a row (a pair of rows) of displacements, the
energy a sum over the rows; its gradient in 80-bit numbers gives the distance of any position from the equilibrium.
Records of rvjax and plain dicts are read alike; numbers may have a leading batch axis.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np

REAL = np.longdouble
PI = REAL("3.14159265358979323846264338327950288")
LAST_BEND = 1.02  # y below which the Hertz contact law continues as a straight line; y = 1 is overload

# Fields that are read, with their shapes: d discs, c cranks, p pins, t disc teeth.
STAGES = {
    "involute": {"sun_base_radius": "", "planet_base_radius": "", "pressure_angle": ""},
    "cycloid": {
        "eccentricity": "", "pin_circle_radius": "", "pin_radius": "",
        "equidistant_modification": "", "shift_modification": "", "force_angle": "",
    },
    "cranks": {"circle_radius": ""},
    "stiffness": {
        "turning_arm_bearing": "dc", "support_bearing": "c", "sun_planet_mesh": "c", "planet_crank_bending": "c",
        "planet_crank_torsion": "c", "sun_support": "", "sun_torsion": "", "disc_pin_mesh": "d", "output_support": "",
    },
    "contact": {"young_modulus": "", "poisson_ratio": "", "face_width": "", "pin_stiffness": "", "pin_support": "p"},
}  # fmt: skip
ERRORS = {
    "crank_eccentricity": "dc", "crank_phase": "c", "disc_bore": "dc2", "carrier_bore": "c2", "bearing_clearance": "",
    "support_clearance": "", "eccentricity": "", "pin_circle_radius": "", "pin_radius": "", "pin_hole_clearance": "",
    "equidistant_modification": "", "shift_modification": "", "base_tangent_upper": "", "base_tangent_lower": "",
    "pin_offset": "p2", "pin_radii": "p", "ring_centre": "2", "disc_centre": "d2", "disc_pitch": "dt",
    "disc_profile": "d52", "sun_runout": "2", "planet_runout": "c2",
}  # fmt: skip


def item(record: Any, name: str, default: Any = None) -> Any:
    """A field of a record or an entry of a dict."""
    return record.get(name, default) if isinstance(record, dict) else getattr(record, name, default)


class Case(SimpleNamespace):
    """All numbers of a batch of cases, each with the batch axis first, in one floating type."""


def read(
    design: Any, errors: Any, *, input_angle: Any, output_torque: Any, contact: str = "hertz", carrier: str = "fixed",
    sun: str = "fixed", lanes: int | None = None,
) -> Case:  # fmt: skip
    """Numbers of one case (`lanes` None) or of a batch whose numbers have the batch axis first."""
    gears, cycloid = item(design, "involute"), item(design, "cycloid")
    case = Case(
        z1=item(gears, "sun_teeth"), z2=item(gears, "planet_teeth"), zc=item(cycloid, "disc_teeth"),
        zp=item(cycloid, "pin_count"), nd=item(cycloid, "disc_count"), c=item(item(design, "cranks"), "count"),
        law=contact, carrier=carrier, sun=sun,
    )  # fmt: skip
    if case.zp != case.zc + 1:
        raise ValueError("one pin more than teeth")
    sizes = {"d": case.nd, "c": case.c, "p": case.zp, "t": case.zc, "2": 2, "5": 5}

    def number(value: Any, axes: str) -> Any:
        shape = tuple(sizes[axis] for axis in axes)
        value = np.asarray(value, REAL)
        if lanes is not None and value.ndim and value.shape[0] == lanes:
            value = value.reshape(lanes, *(1,) * (len(shape) + 1 - value.ndim), *value.shape[1:])
        return np.array(np.broadcast_to(value, (lanes or 1, *shape)))

    for stage, fields in STAGES.items():
        part = item(design, stage)
        read_part = {}
        for name, axes in fields.items():
            value = item(part, name)
            if value is None and name == "force_angle":
                value = PI / 6
            if value is None and name in ("equidistant_modification", "shift_modification", "output_support"):
                value = 0
            read_part[name] = None if value is None else number(value, axes)
        setattr(case, stage, SimpleNamespace(**read_part))
    case.errors = SimpleNamespace(**{n: number(item(errors, n, 0) or 0 if np.ndim(item(errors, n, 0)) == 0
                                               else item(errors, n), axes) for n, axes in ERRORS.items()})  # fmt: skip
    case.theta, case.torque = number(input_angle, ""), number(output_torque, "")
    return case


def u(angle: Any) -> Any:
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def J(vector: Any) -> Any:
    """A quarter turn counter-clockwise."""
    return np.stack([-vector[..., 1], vector[..., 0]], -1)


def flank_curvature(case: Case, square: Any) -> Any:
    """Curvature kc of the flank's pin-centre curve at S^2, > 0 convex."""
    cycloid, (zp, e) = case.cycloid, (case.zp, case.cycloid.eccentricity + case.errors.eccentricity)
    k1 = (e * zp / cycloid.pin_circle_radius).reshape(-1, *(1,) * (square.ndim - 1))
    rp = cycloid.pin_circle_radius.reshape(k1.shape)
    cosine = (1 + k1**2 - square) / (2 * k1)
    return (1 + zp * k1**2 - k1 * (1 + zp) * cosine) / (rp * square * np.sqrt(square))


class Machine:
    """Rows, gaps and contact laws of a batch; positions q are (cases, n) in metres: angles times `length`."""

    def __init__(self, case: Case) -> None:
        with np.errstate(all="ignore"):
            self._build(case)

    def _build(self, case: Case) -> None:
        self.case = case
        g, cy, st, er = case.involute, case.cycloid, case.stiffness, case.errors
        nd, c, zp, zc, lanes = case.nd, case.c, case.zp, case.zc, len(case.theta)
        e = cy.eccentricity + er.eccentricity
        rp, rr, R = cy.pin_circle_radius, cy.pin_radius, case.cranks.circle_radius
        r_s, r_b, al = g.sun_base_radius, g.planet_base_radius, g.pressure_angle
        self.ratio = 1 + REAL(case.z2 * zp) / case.z1
        th = case.theta / self.ratio

        # --- unknowns: carrier rotation; discs; cranks; carrier centre; sun
        self.disc = [1 + 3 * k for k in range(nd)]
        self.crank = [1 + 3 * nd + 3 * i for i in range(c)]
        n = 1 + 3 * nd + 3 * c
        self.carrier_at = n if case.carrier == "floating" else None
        n += 2 * (case.carrier == "floating")
        self.sun_at = n if case.sun == "floating" else None
        n += 3 * (case.sun == "floating")
        self.n = n
        length = np.ones((lanes, n), REAL)
        length[:, 0] = R
        for k in self.disc:
            length[:, k + 2] = R
        for i in self.crank:
            length[:, i + 2] = r_b
        if self.sun_at is not None:
            length[:, self.sun_at + 2] = r_s
        self.length, self.sun_radius, self.pin_radius = length, r_s, rr

        # --- directions in the frame of the ideal carrier
        a = PI + 2 * PI * np.arange(c, dtype=REAL) / c
        er_i, et_i = u(a), J(u(a))
        b = -zp * th[:, None] + 2 * PI * np.arange(nd, dtype=REAL) / nd  # (cases, nd)
        gj = 2 * PI * np.arange(zp, dtype=REAL) / zp - th[:, None]  # (cases, zp)
        psi = gj[:, None, :] - b[:, :, None]
        k1 = (e * zp / rp)[:, None, None]
        square = (1 - k1) ** 2 + 4 * k1 * np.sin(psi / 2) ** 2
        S = np.sqrt(square)
        normal = (k1[..., None] * u(b)[:, :, None, :] - u(gj)[:, None, :, :]) / S[..., None]
        lever = e[:, None, None] * zc * np.sin(psi) / S
        self.lever = lever

        # --- pins
        def in_frame(vector: Any, angle: Any) -> Any:
            """A vector (cases, 2) turned by an angle."""
            return vector[:, :1] * u(angle) + vector[:, 1:] * J(u(angle))

        rows = np.zeros((lanes, nd, zp, n), REAL)
        for k, at in enumerate(self.disc):
            rows[:, k, :, at : at + 2] = -normal[:, k]
            rows[:, k, :, at + 2] = lever[:, k]
        D = cy.equidistant_modification + er.equidistant_modification - er.pin_radius + er.pin_hole_clearance / 2
        dd = cy.shift_modification + er.shift_modification - er.pin_circle_radius
        offset = er.pin_offset[..., :1] * u(gj) + er.pin_offset[..., 1:] * J(u(gj))
        offset = offset + in_frame(er.ring_centre, -th)[:, None, :]
        gap = -D[:, None, None] + dd[:, None, None] * (1 - k1 * np.cos(psi)) / S + er.pin_radii[:, None, :]
        gap = gap + np.sum(normal * (offset[:, None] - er.disc_centre[:, :, None, :]), -1)
        tooth = np.arange(zp) - np.floor(np.where(np.isfinite(psi), psi, 0) / (2 * PI)).astype(np.int64)
        pitch = np.take_along_axis(er.disc_pitch, tooth % zc, axis=2)
        gap = gap + pitch * lever * zp / (zc * rp[:, None, None])
        for f in range(5):
            gap = gap + er.disc_profile[:, :, None, f, 0] * np.cos(f * psi)
            gap = gap + er.disc_profile[:, :, None, f, 1] * np.sin(f * psi)
        self.pin_rows, self.pin_gaps = rows.reshape(lanes, nd * zp, n), gap.reshape(lanes, nd * zp)

        # --- gear flanks, driving first
        flanks, flank_gaps = np.zeros((lanes, 2, c, n), REAL), np.zeros((lanes, 2, c), REAL)
        sun_runout = in_frame(er.sun_runout, case.theta - th)
        turned = a - zp * th[:, None]
        planet_runout = er.planet_runout[..., :1] * u(turned) + er.planet_runout[..., 1:] * J(u(turned))
        for side, sign in enumerate((1, -1)):
            dr = np.sin(al)[:, None, None] * er_i + sign * np.cos(al)[:, None, None] * et_i
            flank_gaps[:, side] = ((er.base_tangent_upper + er.base_tangent_lower) / 4)[:, None]
            flank_gaps[:, side] += np.sum(dr * (sun_runout[:, None] - planet_runout), -1)
            for i, at in enumerate(self.crank):
                flanks[:, side, i, at : at + 2] = -dr[:, i]
                flanks[:, side, i, at + 2] = sign * r_b
                if self.sun_at is not None:
                    flanks[:, side, i, self.sun_at : self.sun_at + 2] = dr[:, i]
                    flanks[:, side, i, self.sun_at + 2] = sign * r_s
        self.gear_rows, self.gear_gaps = flanks.reshape(lanes, 2 * c, n), flank_gaps.reshape(lanes, 2 * c)
        mesh = 1 / st.sun_planet_mesh + 1 / st.planet_crank_bending + r_b[:, None] ** 2 / st.planet_crank_torsion
        self.mesh = np.concatenate([1 / mesh, 1 / mesh], 1)

        # --- bearings: discs on cranks, then cranks in the carrier
        arms, arm_gaps = np.zeros((lanes, nd, c, 2, n), REAL), np.zeros((lanes, nd, c, 2), REAL)
        seats, seat_gaps = np.zeros((lanes, c, 2, n), REAL), np.zeros((lanes, c, 2), REAL)
        for i, at in enumerate(self.crank):
            for k, disc in enumerate(self.disc):
                across = J(u(b[:, k]))
                for axis in (0, 1):
                    arms[:, k, i, axis, disc + axis] = 1
                    arms[:, k, i, axis, at + axis] = -1
                arms[:, k, i, :, disc + 2] = R[:, None] * et_i[i]
                arms[:, k, i, :, at + 2] = -e[:, None] * across
                arm_gaps[:, k, i] = er.disc_bore[:, k, i, :1] * er_i[i] + er.disc_bore[:, k, i, 1:] * et_i[i]
                arm_gaps[:, k, i] -= er.crank_eccentricity[:, k, i, None] * u(b[:, k])
                arm_gaps[:, k, i] -= (e * er.crank_phase[:, i])[:, None] * across
            for axis in (0, 1):
                seats[:, i, axis, at + axis] = 1
                if self.carrier_at is not None:
                    seats[:, i, axis, self.carrier_at + axis] = -1
            seats[:, i, :, 0] = -R[:, None] * et_i[i]
            seat_gaps[:, i] = -er.carrier_bore[:, i, :1] * er_i[i] - er.carrier_bore[:, i, 1:] * et_i[i]
        self.bearing_rows = np.concatenate([arms.reshape(lanes, nd * c, 2, n), seats], 1)
        self.bearing_gaps = np.concatenate([arm_gaps.reshape(lanes, nd * c, 2), seat_gaps], 1)
        self.bearing = np.concatenate([st.turning_arm_bearing.reshape(lanes, nd * c), st.support_bearing], 1)
        loose = [np.maximum(x, 0)[:, None] for x in (er.bearing_clearance, er.support_clearance)]
        self.clearance = np.concatenate([np.repeat(loose[0], nd * c, 1), np.repeat(loose[1], c, 1)], 1)

        # --- springs to the frame: centring, shafts and supports of what floats
        self.k0 = REAL("1e-8") * st.turning_arm_bearing.mean((1, 2))
        self.spring = np.repeat(self.k0[:, None], n, 1)
        if self.carrier_at is not None:
            self.spring[:, self.carrier_at : self.carrier_at + 2] += st.output_support[:, None]
        if self.sun_at is not None:
            self.spring[:, self.sun_at : self.sun_at + 2] += st.sun_support[:, None]
            self.spring[:, self.sun_at + 2] += st.sun_torsion / r_s**2
        for name in ("pin_rows", "gear_rows"):
            setattr(self, name, getattr(self, name) / length[:, None, :])
        self.bearing_rows = self.bearing_rows / length[:, None, None, :]
        self.load = np.zeros((lanes, n), REAL)
        self.load[:, 0] = case.torque / R

        # --- the contact law of a pin
        contact = case.contact
        modulus = contact.young_modulus / (1 - contact.poisson_ratio**2)
        self.bend = rr[:, None] * (1 - rr[:, None] * flank_curvature(case, square).reshape(lanes, -1))  # R*
        width = contact.face_width
        self.pressure_factor = (modulus / (2 * PI * width))[:, None] / self.bend
        if case.law == "hertz":
            self.c_pin = (2 / (PI * modulus * width))[:, None]
            self.a_pin = np.log(2 * PI * width * modulus * rr**2)[:, None] - np.log(self.bend)
            self.a_pin = self.a_pin - (1 / (2 * (1 - contact.poisson_ratio)))[:, None]
            if contact.pin_support is not None:
                self.a_pin = self.a_pin + 1 / (self.c_pin * np.tile(contact.pin_support, nd))
        elif case.law == "linear":
            k = contact.pin_stiffness
            self.k_pin = (4 * np.cos(cy.force_angle) ** 2 * st.disc_pin_mesh.mean(1) / zp if k is None else k)[:, None]
            if contact.pin_support is not None:
                soft = 1 / np.tile(contact.pin_support, nd)
                mean = soft.mean(1, keepdims=True) if k is None else 0  # a mesh stiffness includes it
                self.k_pin = 1 / (1 / self.k_pin + soft - mean)
        else:
            self.c_pin = (
                REAL("3.81") * (2 / (PI * modulus)) ** REAL("0.9") / width ** REAL("0.8")
            )[:, None]  # fmt: skip

    def lanes(self, chosen: Any) -> "Machine":
        """Select some of the cases."""
        part = object.__new__(Machine)
        for name, value in vars(self).items():
            whole = isinstance(value, np.ndarray) and name not in ("disc", "crank") and len(value) == len(self.load)
            setattr(part, name, value[chosen] if whole else value)
        return part

    def pin_law(self, d: Any) -> tuple[Any, Any, Any, Any]:
        """Force, slope, energy of every pin, and y (infinite where there is none: no overload)."""
        on = d > 0
        x = np.where(on, d, 1)
        if self.case.law == "linear":
            force, slope = self.k_pin * x, self.k_pin + 0 * x
            energy, y = force * x / 2, np.full_like(x, np.inf)
        elif self.case.law == "palmgren":
            force = (x / self.c_pin) ** (REAL(10) / 9)
            slope, energy, y = 10 * force / (9 * x), 9 * force * x / 19, np.full_like(x, np.inf)
        else:
            c, t_last = self.c_pin, LAST_BEND - np.log(REAL(LAST_BEND))
            t = self.a_pin - np.log(x / c)
            straight = t < t_last
            tt = np.maximum(t, t_last)
            y = tt + np.log(tt) + REAL("0.1")
            for _ in range(9):
                y = y - (y - np.log(y) - tt) * y / (y - 1)
            last = np.where(straight, c * np.exp(self.a_pin - t_last), x)  # where the straight line begins
            force = last / (c * y)
            slope = 1 / (c * (y - 1))
            energy = c * force**2 * (2 * y - 1) / 4
            over = x - last
            energy = energy + over * (force + slope * over / 2)
            force = force + slope * over
            y = np.where(t <= 1, 1, y)
        return tuple(np.where(on, v, z) for v, z in ((force, 0), (slope, 0), (energy, 0), (y, np.inf)))

    def state(self, q: Any, hessian: bool = True) -> SimpleNamespace:
        """Energy, gradient (N, as q is in metres), and Hessian of positions (cases, n), with all forces."""
        s = SimpleNamespace()
        d = np.einsum("lmn,ln->lm", self.pin_rows, q) + self.pin_gaps
        s.depth = d
        s.pins, pin_slope, pin_energy, s.y = self.pin_law(d)
        flank = np.einsum("lmn,ln->lm", self.gear_rows, q) + self.gear_gaps
        s.flanks = self.mesh * np.maximum(flank, 0)
        w = np.einsum("lban,ln->lba", self.bearing_rows, q) + self.bearing_gaps
        size = np.sqrt(np.sum(w * w, -1))
        over = np.maximum(size - self.clearance, 0)
        safe = np.where(size > 0, size, 1)
        s.bearings = (self.bearing * over / safe)[..., None] * w
        s.energy = pin_energy.sum(1) + (self.mesh * np.maximum(flank, 0) ** 2).sum(1) / 2
        s.energy = s.energy + (self.bearing * over**2).sum(1) / 2 + (self.spring * q * q).sum(1) / 2
        s.energy = s.energy + (self.load * q).sum(1)
        s.gradient = self.load + self.spring * q + np.einsum("lmn,lm->ln", self.pin_rows, s.pins)
        s.gradient = s.gradient + np.einsum("lmn,lm->ln", self.gear_rows, s.flanks)
        s.gradient = s.gradient + np.einsum("lban,lba->ln", self.bearing_rows, s.bearings)
        s.largest = np.maximum(
            np.abs(s.pins).max(1), np.maximum(np.abs(s.flanks).max(1), np.abs(s.bearings).max((1, 2)))
        )
        s.largest = np.maximum(s.largest, np.abs(self.load[:, 0]))
        if hessian:
            rows = [self.pin_rows.astype(float), self.gear_rows.astype(float)]
            weight = [pin_slope.astype(float), (self.mesh * (flank > 0)).astype(float)]
            H = sum(np.matmul((r * v[..., None]).swapaxes(1, 2), r) for r, v in zip(rows, weight))
            along = np.where(size[..., None] > 0, w / safe[..., None], np.array([1, 0], REAL))
            ring = np.where(over > 0, over / safe, np.where(self.clearance > 0, 0, 1))
            closed = (over > 0) | (self.clearance == 0)
            block = along[..., :, None] * along[..., None, :]
            block = closed[..., None, None] * block + ring[..., None, None] * (np.eye(2) - block)
            block = (self.bearing[..., None, None] * block).astype(float)
            pair = self.bearing_rows.astype(float)
            H = H + np.einsum("lban,lbac,lbcm->lnm", pair, block, pair, optimize=True)
            s.hessian = H + self.spring.astype(float)[:, :, None] * np.eye(self.n)
        return s

    def size(self, q: Any) -> Any:
        """Largest gap or displacement."""
        size = np.maximum(np.abs(q).max(1), np.maximum(np.abs(self.pin_gaps).max(1), np.abs(self.gear_gaps).max(1)))
        return np.maximum(size, np.abs(self.bearing_gaps).max((1, 2)))

    @property
    def stiffest(self) -> Any:
        """Largest stiffness of a bearing or gear."""
        return np.maximum(self.bearing.max(1), self.mesh.max(1))

    def floor(self, s: SimpleNamespace, q: Any) -> Any:
        """Gradient that 80-bit rounding may leave."""
        return 1e-16 * s.largest + 1e-18 * self.stiffest * self.size(q)
