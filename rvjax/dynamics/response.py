"""Steady response to the periodic mesh stiffness of one stage, per mesh harmonic, and its sensitivities.

A sensitivity is the derivative of one amplitude to every number of a design, through the solves; `with_deviations`
changes such numbers by shares of themselves, for tolerances and what-if questions.
"""

from collections.abc import Mapping, Sequence
from functools import partial

import jax
import jax.numpy as jnp

from rvjax.base.words import choose
from rvjax.catalogue import checked
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped, admitted, lump
from rvjax.dynamics.excitation import OUTPUTS, STAGES, mesh_frequency, output_indices
from rvjax.dynamics.harmonic_balance import solve_cyclic, solve_first_order, solve_mesh
from rvjax.dynamics.static import Torques, balancing_torque
from rvjax.dynamics.symmetry import is_symmetric
from rvjax.records import Array, Design, PyTree, Record, Scalar, field, promote, record, text
from rvjax.status import SolveInfo, Status, converged

METHODS = ("first_order", "harmonic_balance")


@record
class Response(Record):
    """Periodic response q(t) = mean + Re sum_l amplitude_l e^{i l w t}, w the angular mesh frequency."""

    frequency: Array = field("Hz", "of each harmonic", shape=("harmonics",))
    amplitude: Array = field("m, rad", "complex amplitude of each harmonic and output", shape=("harmonics", "outputs"))
    mean: Array = field("m, rad", "mean deflection of each output", shape=("outputs",))
    resonance_distance: Array = field(
        "-",
        "of each harmonic: min |l w / w_r - 1| over the modes that it excites and the outputs show; inf without any",
        shape=("harmonics",),
    )
    outputs: tuple[str, ...] = text("names of the outputs, from System.labels")
    form: str = text(
        "equations that were solved: first_order or cyclic, by symmetry; first_order_whole or mesh, on the whole model"
    )
    info: SolveInfo = field("-", "residual of the solves; CONVERGED, SINGULAR, ...", kind="record")


@checked
def response(
    design: RVReducer | Lumped,
    *,
    sun_speed: Scalar,
    output_torque: Scalar,
    stage: str = "planetary",
    harmonics: int = 9,
    method: str = "first_order",
    outputs: Sequence[str] | None = None,
    sun_torque: Scalar | None = None,
) -> Response:
    """Steady response to the mesh stiffness variation of one stage under constant load.

    The first-order solution (Eqs. 5 to 9 of Yang et al. 2018) applies the stiffness variation to the mean
    deflection only; harmonic balance keeps its product with the vibration. By symmetry each harmonic excites one
    kind of motion: what `outputs` cannot show is not solved, and is exactly zero. One disc, or members given one by
    one, leave no symmetry, and the whole model is solved; `form` names the equations.

    Args:
        design: a reducer with inertia, stiffness and mesh variation, or its lumped parameters.
        sun_speed: () rad/s, of either sign.
        output_torque: external torque on the output, () N m; negative opposes a positive rotation.
        stage: whose meshes vary: "planetary" or "cycloid".
        harmonics: of the mesh frequency, H; harmonic balance drops all above.
        method: "first_order" or "harmonic_balance".
        outputs: names from `assemble(design).labels`; by default output.x, output.y, output.rotation.
        sun_torque: external torque on the sun, () N m; by default the one that balances `output_torque`.

    Returns:
        Response. SINGULAR where no spring carries the torque, or undamped with a harmonic on a mode to
        rounding; NaN for INVALID_GEOMETRY (radii or masses not positive, pins along the radius) and NONFINITE.

    Raises:
        ValueError: unknown stage, method or output, harmonics below 1, or as `rvjax.dynamics.lump`.
    """
    lumped, outputs = _checked(design, stage, outputs)
    choose("method", method, METHODS)
    if harmonics < 1:
        raise ValueError(f"harmonics = {harmonics}: must be at least 1")
    return _response(lumped, sun_speed, output_torque, sun_torque, stage, harmonics, method, outputs, False)


@checked
def constant_forcing(
    design: RVReducer | Lumped,
    *,
    sun_speed: Scalar,
    output_torque: Scalar,
    stage: str = "planetary",
    harmonics: int = 9,
    outputs: Sequence[str] | None = None,
) -> Response:
    """First-order response whose derivatives leave out those of the forcing, as Eq. 14 of Yang et al. 2018 does.

    Its value is that of `response`. Its derivatives are right for inertias and, while only one of the central
    parts is held against rotation, for stiffnesses; for geometry and angles they are not.

    Args:
        design: as in `response`.
        sun_speed: as in `response`.
        output_torque: as in `response`.
        stage: as in `response`.
        harmonics: as in `response`.
        outputs: as in `response`.
    """
    lumped, outputs = _checked(design, stage, outputs)
    return _response(lumped, sun_speed, output_torque, None, stage, harmonics, "first_order", outputs, True)


def _checked(design: RVReducer | Lumped, stage: str, outputs: Sequence[str] | None) -> tuple[Lumped, tuple[str, ...]]:
    lumped, outputs = lump(design), OUTPUTS if outputs is None else tuple(outputs)
    choose("stage", stage, STAGES)
    output_indices(lumped, outputs)
    return lumped, outputs


@partial(jax.jit, static_argnums=(4, 5, 6, 7, 8))
def _response(
    lumped: Lumped,
    sun_speed: Array,
    output_torque: Array,
    sun_torque: Array | None,
    stage: str,
    harmonics: int,
    method: str,
    outputs: tuple[str, ...],
    freeze_forcing: bool,
) -> Response:
    lumped, (sun_speed, output_torque, sun_torque), gate = admitted(lumped, sun_speed, output_torque, sun_torque)
    sun_torque = balancing_torque(lumped, output_torque) if sun_torque is None else sun_torque
    torques = Torques(sun_torque, output_torque)
    indices = output_indices(lumped, outputs)
    w = mesh_frequency(lumped, sun_speed, stage)
    if method == "first_order":
        form = "first_order" if is_symmetric(lumped) else "first_order_whole"
        solved = solve_first_order(lumped, w, torques, stage, harmonics, indices, freeze_forcing)
    elif lumped.alike and lumped.cranks >= 3 and (lumped.discs >= 3 or stage == "cycloid"):
        form = "cyclic"
        solved = solve_cyclic(lumped, w, torques, stage, harmonics, indices)
    else:
        form = "mesh"
        solved = solve_mesh(lumped, w, torques, stage, harmonics, indices)
    amplitude = jnp.where(w < 0, solved.amplitude.conj(), solved.amplitude)  # time reversed
    overflow = ~(jnp.all(jnp.isfinite(amplitude)) & jnp.all(jnp.isfinite(solved.mean)))
    frequency = jnp.arange(1, harmonics + 1, dtype=w.dtype) * jnp.abs(w) / (2 * jnp.pi)
    (frequency, amplitude, mean, distance), info = gate.close(
        (frequency, amplitude, solved.mean, solved.distance),
        (overflow, Status.NONFINITE),
        (solved.singular, Status.SINGULAR),
        info=converged(solved.residual),
    )
    return Response(frequency, amplitude, mean, distance, outputs, form, info)


def with_deviations(design: RVReducer | Lumped, deviations: Mapping[str, PyTree]) -> PyTree:
    """Return a design some of whose numbers deviate by a share of themselves: x (1 + deviation).

    The names serve as names of tolerances: `monte_carlo(lambda d: f(with_deviations(design, d)),
    {"stiffness.disc_pin_mesh": Tolerance.symmetric(0.1)}, ...)`.

    Args:
        design: a reducer, or its lumped parameters.
        deviations: {field: deviation}, fields such as "stiffness.disc_pin_mesh" or "inertia.planet_mass"; a scalar
            for all members alike, or an array of the shape of the field, one for each member.

    Raises:
        ValueError: a name that is no number of this design.
    """
    for name, deviation in deviations.items():
        design = _replaced(design, name.split("."), name, deviation)
    return design


def _replaced(part: PyTree, path: list[str], name: str, deviation: Scalar) -> PyTree:
    value = getattr(part, path[0], None) if isinstance(part, Record) else None
    if len(path) > 1 and isinstance(value, Record):
        return part.replace(**{path[0]: _replaced(value, path[1:], name, deviation)})
    numbers = jax.tree_util.tree_flatten_with_path(part)[0] if isinstance(part, Record) else []
    names = [key[0].name for key, _ in numbers if len(key) == 1]
    if len(path) > 1 or path[0] not in names:
        raise ValueError(f"deviations: {name!r} is no number of this design; {type(part).__name__} has {names}")
    # A float stays one: its dtype then follows the other numbers.
    value, deviation = (x if isinstance(x, float) else jnp.asarray(x) for x in (value, deviation))
    return part.replace(**{path[0]: value * (1 + deviation)})


FORMULAS = {"total": response, "constant_forcing": constant_forcing}


@checked
def log_sensitivities(
    design: RVReducer | Lumped,
    *,
    sun_speed: Scalar,
    output_torque: Scalar,
    stage: str = "planetary",
    harmonics: int = 9,
    outputs: Sequence[str] = OUTPUTS,
    formula: str = "total",
) -> dict[str, jax.Array]:
    """Relative change of each first-order amplitude B for a relative change of each number: (xi / B) dB/dxi.

    Args:
        design: a reducer, whose eccentricity moves the rolling radius of the discs along, or its lumped
            parameters, where the two vary apart.
        sun_speed: () rad/s.
        output_torque: external torque on the output, () N m.
        stage: whose meshes vary: "planetary" or "cycloid".
        harmonics: of the mesh frequency, H.
        outputs: k names from `assemble(design).labels`.
        formula: "total", or "constant_forcing" as Eq. 14 of Yang et al. 2018.

    Returns:
        {field: (H, k) complex}, fields such as "stiffness.sun_support"; the real part is the relative change of
        |B|. Zero for an output that a harmonic does not excite. A field that holds an array adds its axes.

    Raises:
        ValueError: unknown formula, or as `response`.
    """
    choose("formula", formula, FORMULAS)
    return _log_sensitivities(design, sun_speed, output_torque, stage, harmonics, tuple(outputs), formula)


@partial(jax.jit, static_argnums=(3, 4, 5, 6))
def _log_sensitivities(
    design: Design,
    sun_speed: Array,
    output_torque: Array,
    stage: str,
    harmonics: int,
    outputs: tuple[str, ...],
    formula: str,
) -> dict[str, jax.Array]:
    design = promote(design)
    conditions = dict(sun_speed=sun_speed, output_torque=output_torque)

    def amplitude(changed: PyTree) -> tuple[jax.Array, jax.Array]:
        sensitivities = FORMULAS[formula](
            changed, **conditions, stage=stage, harmonics=harmonics, outputs=outputs
        ).amplitude
        return sensitivities, sensitivities

    slopes, value = jax.jacfwd(amplitude, has_aux=True)(design)
    divisor = jnp.where(value == 0, 1, value)
    paths, _ = jax.tree.flatten_with_path(slopes)
    sensitivities = {}
    for (path, slope), number in zip(paths, jax.tree.leaves(design)):
        factor = jnp.broadcast_to(number, slope.shape).astype(value.dtype)
        beside = jnp.expand_dims(divisor, range(2, slope.ndim))
        sensitivities[jax.tree_util.keystr(path, simple=True, separator=".")] = factor * slope / beside
    return sensitivities
