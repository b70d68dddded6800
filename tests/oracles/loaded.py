"""Equilibria of the independent model of the loaded reducer (`loaded_machine`): one case by SciPy, a batch by Newton.

`trust_exact` minimises one case, `minimise` a batch; both end in the same polish.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.optimize

from tests.oracles.loaded_machine import LAST_BEND, REAL, Case, Machine, flank_curvature, read


def newton_step(s: SimpleNamespace) -> Any:
    """H^-1 g, with H scaled to a diagonal of ones."""
    scale = 1 / np.sqrt(np.einsum("lnn->ln", s.hessian))
    H = s.hessian * scale[:, :, None] * scale[:, None, :]
    H = np.where(np.isfinite(H).all((1, 2))[:, None, None], H, np.eye(H.shape[1]))
    H += 1e-15 * np.eye(H.shape[1])  # stiffnesses of 1e16 to 1 leave nothing of a pivot
    return scale * np.linalg.solve(H, (scale * s.gradient.astype(float))[..., None])[..., 0]


def minimise(machine: Machine, q: Any = None, steps: int = 400) -> tuple[Any, Any]:
    """Positions of least energy of all cases, by Newton; four steps without a lower energy lead back to a line search.

    Returns:
        q (cases, n) in metres and the number of steps of each case (`steps`: not converged).
    """
    lanes = len(machine.load)
    final = np.zeros((lanes, machine.n), REAL) if q is None else np.array(q, REAL)
    taken = np.full(lanes, steps)
    active = np.arange(lanes)
    part, q = machine, final.copy()
    best, lowest, waiting = q.copy(), np.full(lanes, np.inf, REAL), np.zeros(lanes, int)
    for step in range(steps):
        s = part.state(q)
        done = np.abs(s.gradient).max(1) <= part.floor(s, q)
        final[active], taken[active[done]] = q, step
        lower = s.energy < lowest
        best[lower], lowest = q[lower], np.where(lower, s.energy, lowest)
        waiting = np.where(lower, 0, waiting + 1)
        keep = ~done & np.isfinite(s.gradient).all(1)
        if not keep.any():
            break
        if not keep.all():
            active, q, best, lowest, waiting = (x[keep] for x in (active, q, best, lowest, waiting))
            part, s = part.lanes(keep), SimpleNamespace(gradient=s.gradient[keep], hessian=s.hessian[keep])
        q = q - newton_step(s)
        back = np.flatnonzero(waiting >= 4)
        if len(back):
            few = part.lanes(back)
            begin = best[back]
            q[back] = line_minimum(few, begin, -newton_step(few.state(begin)))
            waiting[back] = 0
    return final, taken


def line_minimum(machine: Machine, q: Any, direction: Any) -> Any:
    """Nearly where the slope along a direction changes sign; it is monotone, so bisection finds it."""
    low, high = np.zeros(len(q), REAL), np.ones(len(q), REAL)

    def slope(t: Any) -> Any:
        return np.sum(machine.state(q + t[:, None] * direction, hessian=False).gradient * direction, 1)

    for _ in range(40):
        falling = slope(high) < 0
        if not falling.any():
            break
        low, high = np.where(falling, high, low), np.where(falling, 8 * high, high)
    for _ in range(30):  # what is left to find may be far below a full step
        falling = (low > 0) | (slope(high / 8) < 0)
        if falling.all():
            break
        high = np.where(falling, high, high / 8)
    low = np.maximum(low, high / 8)
    for _ in range(8):
        middle = (low + high) / 2
        falling = slope(middle) < 0
        low, high = np.where(falling, middle, low), np.where(falling, high, middle)
    return q + low[:, None] * direction


def trust_exact(machine: Machine, start: Any = None) -> Any:
    """Position of least energy of one case by SciPy's trust region; its accuracy is that of float64 energies."""
    at_zero = machine.state(np.zeros((1, machine.n), REAL))
    full = np.einsum("lmn,lm->n", machine.gear_rows**2, machine.mesh)
    full = full + np.einsum("lban,lb->n", machine.bearing_rows**2, machine.bearing) + machine.spring[0]
    scale = (1 / np.sqrt(full.astype(float))).astype(float)  # of a displacement, with everything shut
    unit = float(max(np.abs(scale * at_zero.gradient[0].astype(float)).max() ** 2, 1e-30))

    def at(z: Any, hessian: bool = True) -> SimpleNamespace:
        return machine.state((scale * z)[None].astype(REAL), hessian)

    found = scipy.optimize.minimize(
        lambda z: float(at(z, False).energy[0]) / unit,
        np.zeros(machine.n) if start is None else np.asarray(start, float) / scale,
        jac=lambda z: scale * at(z, False).gradient[0].astype(float) / unit,
        hess=lambda z: scale[:, None] * at(z).hessian[0] * scale / unit,
        method="trust-exact",
        options={
            "gtol": 1e-9 * np.sqrt(1 / unit),
            "maxiter": 3000,
            "initial_trust_radius": np.sqrt(unit),
            "max_trust_radius": 1e6 * np.sqrt(unit),
        },
    )
    return (scale * found.x)[None].astype(REAL)


def positive(case: Case) -> Any:
    """Mark cases whose lengths, moduli and stiffnesses can be those of a reducer."""
    e = case.cycloid.eccentricity + case.errors.eccentricity
    parts = [e, case.cycloid.pin_circle_radius, case.cycloid.pin_radius]
    parts += [case.cranks.circle_radius, case.involute.sun_base_radius, case.involute.planet_base_radius]
    parts += [np.cos(case.involute.pressure_angle), case.contact.young_modulus, case.contact.face_width]
    names = (
        "turning_arm_bearing",
        "support_bearing",
        "sun_planet_mesh",
        "planet_crank_bending",
        "planet_crank_torsion",
    )
    parts += [getattr(case.stiffness, name).reshape(len(e), -1).min(1) for name in names]
    parts += [1 - e * case.zp / case.cycloid.pin_circle_radius, 1 - case.contact.poisson_ratio**2]
    contact = case.contact
    parts += [x.reshape(len(e), -1).min(1) for x in (contact.pin_stiffness, contact.pin_support) if x is not None]
    held = [getattr(case.stiffness, name) for name in ("output_support", "sun_support", "sun_torsion")]
    return np.all([part > 0 for part in parts], axis=0) & np.all([spring >= 0 for spring in held], axis=0)


def undercut(case: Case) -> Any:
    """rr max kc over the flank; undercut from 1 on. The curvature has one maximum in S^2."""
    k1 = (case.cycloid.eccentricity + case.errors.eccentricity) * case.zp / case.cycloid.pin_circle_radius
    top = 3 * (case.zp - 1) * (1 - k1**2) / REAL(case.zp + 1)
    square = np.clip(top, (1 - k1) ** 2, (1 + k1) ** 2)
    return case.cycloid.pin_radius * flank_curvature(case, square)


def finite(case: Case) -> Any:
    """Mark cases whose numbers are all finite."""
    good = np.isfinite(case.theta) & np.isfinite(case.torque)
    for part in (case.involute, case.cycloid, case.cranks, case.stiffness, case.contact, case.errors):
        for value in vars(part).values():
            if value is not None:
                good &= np.isfinite(value.reshape(len(good), -1)).all(1)
    return good


def results(machine: Machine, q: Any, steps: Any) -> dict[str, Any]:
    """Results of `rvjax.loaded.equilibrium` in float64 with the batch axis first, and their allowed errors.

    `residual` is the largest gradient over the largest force, in 80-bit numbers; `slack` the distance in metres to
    the equilibrium that this leaves (a Newton step). `error_allowed` and `force_allowed` are what a gradient of 1e-13
    of the largest force, or of the rounding of a gap in float64 times the largest stiffness, moves error and forces by
    at most: the rows of |H^-1| added up.
    """
    case, s = machine.case, machine.state(q)
    lanes, nd, c, zp = len(q), case.nd, case.c, case.zp
    step = newton_step(s)
    diagonal = 1 / np.sqrt(np.einsum("lnn->ln", s.hessian))
    scaled = s.hessian * diagonal[:, :, None] * diagonal[:, None, :]
    scaled = np.where(np.isfinite(scaled).all((1, 2))[:, None, None], scaled, np.eye(machine.n))
    inverse = np.linalg.inv(scaled + 1e-15 * np.eye(machine.n)) * diagonal[:, :, None] * diagonal[:, None, :]  # m/N
    stop = 1e-13 * s.largest + 4e-16 * machine.stiffest * machine.size(q)
    R = machine.length[:, 0]
    gear = s.flanks[:, :c] - s.flanks[:, c:]
    pins = s.pins.reshape(lanes, nd, zp)
    return {
        "error": (q[:, 0] / R).astype(float),
        "pins": pins.astype(float),
        "pressure": np.sqrt(s.pins * machine.pressure_factor).reshape(lanes, nd, zp).astype(float),
        "disc_bearing": -s.bearings[:, : nd * c].reshape(lanes, nd, c, 2).astype(float),
        "support_bearing": s.bearings[:, nd * c :].astype(float),
        "gear": gear.astype(float),
        "input_torque": (machine.sun_radius * gear.sum(1)).astype(float),
        "disc_torque": -(machine.lever * pins).sum(2).astype(float),
        "stiffness": (R**2 / inverse[:, 0, 0]).astype(float),
        "residual": (np.abs(s.gradient).max(1) / np.where(s.largest > 0, s.largest, 1)).astype(float),
        "slack": np.abs(step).max(1).astype(float),
        "error_allowed": (stop * np.abs(inverse[:, 0]).sum(1) / R).astype(float),
        "force_allowed": (stop * machine.stiffest * np.abs(inverse).sum(2).max(1)).astype(float),
        "bend": s.y.min(1).astype(float),
        "largest": s.largest.astype(float),
        "loaded": (s.pins.max(1) > machine.k0 * machine.pin_radius),
        "steps": steps,
    }


def equilibrium(design: Any, errors: Any, **options: Any) -> dict[str, Any]:
    """One case: SciPy's trust region from the ideal position, polished; `status` by name, NaN if it requires this."""
    case = read(design, errors, **options)
    name = "NONFINITE" if not finite(case)[0] else "INVALID_GEOMETRY" if not positive(case)[0] else ""
    if not name and undercut(case)[0] >= 1:
        name = "UNDERCUT"
    if name:
        return {"status": name}
    machine = Machine(case)
    q, steps = minimise(machine, trust_exact(machine))
    found = {key: value[0] for key, value in results(machine, q, steps).items()}
    if found["bend"] <= LAST_BEND:
        return {"status": "CONTACT_OVERLOAD"}
    assert found["residual"] < 1e-12 or steps[0] < 400, "the oracle did not converge"
    found["q"] = q[0] / machine.length[0]
    found["status"] = "UNLOADED" if case.torque[0] == 0 and not found["loaded"] else "CONVERGED"
    return found


def equilibria(design: Any, errors: Any, lanes: int, steps: int = 400, **options: Any) -> dict[str, Any]:
    """Results of a batch, batch axis first; impossible cases are excluded (`usable`)."""
    case = read(design, errors, lanes=lanes, **options)
    with np.errstate(all="ignore"):
        usable = finite(case) & positive(case)
        usable &= np.where(usable, undercut(case), 1) < 1
        machine = Machine(case).lanes(usable)
        found = results(machine, *minimise(machine, steps=steps))
    whole = {name: np.full((lanes, *value.shape[1:]), np.nan) for name, value in found.items()}
    for name, value in found.items():
        whole[name][usable] = value
    return whole | {"usable": usable}


def slope(design: Any, errors: Any, change: Any, **options: Any) -> float:
    """d error / d parameter: -lam . d grad / d parameter at fixed q, by differences in 80-bit numbers.

    Args:
        design: the reducer.
        errors: of its parts.
        change: function (step) -> (design, errors, options) with the parameter moved by step times its size.
        options: of the equilibrium.
    """
    machine = Machine(read(design, errors, **options))
    q, _ = minimise(machine, trust_exact(machine))
    s = machine.state(q)
    lam = np.linalg.solve(s.hessian[0], np.eye(machine.n)[0])
    angles = q / machine.length

    def virtual(step: float) -> Any:
        moved = Machine(read(*change(step)[:2], **{**options, **change(step)[2]}))
        # The gradient to the angles and places themselves: their lengths may be what is changed.
        return moved.state(angles * moved.length).gradient[0] * moved.length[0]

    h = 1e-7
    # 1e-7 of the parameter: truncation 1e-14 of the second derivative, rounding 1e-19 / 1e-7 of the gradient
    moved = (virtual(h) - virtual(-h)) / (2 * h) / machine.length[0]
    return float(-(lam * moved).sum() / machine.length[0, 0])


def gradient_at(design: Any, errors: Any, q: Any, **options: Any) -> tuple[float, Any, float]:
    """Energy, gradient and largest force at a position of one case, in 80-bit numbers: the check of any solution.

    Args:
        design: the reducer.
        errors: of its parts.
        q: carrier rotation; (x, y, beta) of every disc; (x, y, rho) of every crank; carrier centre and sun if floating.
        options: of the equilibrium.
    """
    machine = Machine(read(design, errors, **options))
    s = machine.state(np.asarray(q, REAL)[None] * machine.length, hessian=False)
    return float(s.energy[0]), s.gradient[0] * machine.length[0], float(s.largest[0])
