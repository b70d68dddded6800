"""Figures of a design without errors, against closed forms, the curve itself and an independent optimum."""

import json
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from rvjax import RVErrors, geometry, lost_motion
from rvjax.catalogue import CORR, RV_40E, RV_320E, ImplausibleDesign
from rvjax.designs import Contact, CrankStage, CycloidStage, InvoluteStage
from rvjax.geometry import contact_ratio, least_convex_radius
from rvjax.loaded.cases import MACHINE
from rvjax.loaded.geometry import Turn, flank_rounding, geometry as geometry_at, pin_depths
from rvjax.status import Status
from rvjax.units import MPa, mm

CASES = json.loads((Path(__file__).parent / "reference" / "codesign.json").read_text())["cases"]
FIGURES = [case for case in CASES if case["kind"] == "geometry"]
TORQUE = 206 * 2 * (40 + 10 / 26) / 39  # N m at the output for 206 N m on a disc of the RV-40E


def reducer(e, ring, pin, width, **contact):
    cycloid = CycloidStage(39, 40, 2, e, ring, pin)
    return RV_40E.replace(cycloid=cycloid, contact=Contact(206e9, 0.3, width), **contact)


READ = ("convex_radius", "crank_room", "envelope_volume", "pin_pressure", "mass")


@jax.jit
def read(lengths, torque):
    """Figures of a reducer of an eccentricity, a pin circle, pins, a width and a mass of its discs."""
    e, ring, pin, width, disc = lengths
    inertia = RV_320E.inertia.replace(disc_mass=disc)
    found = geometry.figures(reducer(e, ring, pin, width, inertia=inertia), torque)
    return jnp.stack([getattr(found, name) for name in READ])


slopes = jax.jit(jax.jacrev(read))


def seven(*numbers):
    """Figures of seven reducers, and of no other number, so that one program serves: numbers of all or of each."""
    rows = np.broadcast_arrays(*numbers, np.zeros(7))[:-1]
    return jax.vmap(lambda *row: geometry.figures(reducer(*row[:4]), row[4]))(*map(jnp.asarray, rows))


@pytest.mark.parametrize("case", FIGURES, ids=[case["id"] for case in FIGURES])
def test_figures_of_the_reference(case):
    given = case["given"]
    design = RV_40E.replace(
        involute=InvoluteStage.from_teeth(given["z1"], given["z2"], module=2 * mm),
        cycloid=CycloidStage(*(given[name] for name in ("zc", "zp", "nd", "e", "rp", "rr"))),
        cranks=CrankStage(2, given["R"]),
        contact=Contact(given["young_modulus"], given["poisson_ratio"], given["width"]),
    )
    found = geometry.figures(design, given["torque"])
    assert found.info.status == Status.CONVERGED
    for name, due in case["expected"].items():
        assert getattr(found, name) == pytest.approx(due, rel=1e-9), name


def test_pressure_and_crank_force_over_the_shortening():
    """Nominal design of an RV-40E: the lowest pressure lies at K1 = 0.637."""
    due = {0.5: 1034, 0.6: 1004, 0.637: 1001, 0.7: 1012, 0.75: 1040, 0.8125: 1127, 0.85: 1254}  # MPa
    e = [k1 * 64 * mm / 40 for k1 in due]
    found = seven(e, 64 * mm, 3.07 * mm, 10.411 * mm, TORQUE)
    np.testing.assert_allclose(found.pin_pressure / MPa, list(due.values()), atol=0.6)


def test_the_largest_pressure_is_that_of_a_fine_search_over_a_pitch():
    """Plain NumPy: every pin at 4000 positions of the cranks."""
    e, ring, pin, width = 1.3 * mm, 64 * mm, 3 * mm, 12 * mm
    k1, disc = e * 40 / ring, 412 * 39 / (2 * (40 + 10 / 26))
    psi = np.linspace(0, 2 * np.pi / 40, 4000)[:, None] + 2 * np.pi * np.arange(40) / 40
    size = np.sqrt(1 + k1**2 - 2 * k1 * np.cos(psi))
    lever = e * 39 * np.maximum(np.sin(psi), 0) / size
    force = disc * lever / np.sum(lever**2, axis=1, keepdims=True)
    bend = (1 + 40 * k1**2 - 41 * k1 * np.cos(psi)) / (ring * size**3)
    square = force * 206e9 / (2 * np.pi * width * (1 - 0.09) * pin * (1 - pin * bend))
    found = geometry.figures(reducer(e, ring, pin, width), -412.0)
    assert found.pin_pressure == pytest.approx(np.sqrt(square.max()), rel=1e-7)


def test_the_least_volume_for_a_pressure():
    """Optimum of the nominal problem: 294,913.7 mm3 at K1 near 0.637, whatever the pin circle radius."""

    ring = 64 * mm
    each = np.array([[ring / 40, 0, 0], [0, 0, 0], [0, ring, 0], [0, 0, ring], [0, 0, 0]])  # lengths of x

    def at(x):
        return each @ x + np.array([0, ring, 0, 0, 1.0])

    def value(x):
        convex, _, volume, pressure, _ = np.asarray(read(at(x), TORQUE))
        return np.array(
            [volume * 1e3, 1 - pressure / 1e9, convex / (x[1] * ring) - 0.2, np.sin(np.pi / 40) / x[1] - 1.25]
        )

    def slope(x):
        found = np.asarray(slopes(at(x), TORQUE)) @ each
        convex = float(read(at(x), TORQUE)[0])
        own = np.array([0, 1, 0]) / x[1]
        bend = found[0] / (x[1] * ring) - own * convex / (x[1] * ring)
        return np.stack([found[2] * 1e3, -found[3] / 1e9, bend, -own * np.sin(np.pi / 40) / x[1]])

    found = optimize.minimize(
        lambda x: value(x)[0],
        [0.7, 0.045, 0.17],
        jac=lambda x: slope(x)[0],
        bounds=[(0.5, 0.85), (1.5 / 64, 0.08), (0.1, 0.24)],
        constraints={"type": "ineq", "fun": lambda x: value(x)[1:], "jac": lambda x: slope(x)[1:]},
        options={"ftol": 1e-12, "maxiter": 200},
    )
    assert found.success
    assert found.x[0] == pytest.approx(0.637, abs=0.01)
    assert found.fun * 1e6 == pytest.approx(294_913.7, rel=2e-3)


@pytest.mark.parametrize("pins", [12, 40])
@pytest.mark.parametrize("shortening", [0.3, 0.6923, 0.95])
def test_least_convex_radius_is_where_the_offset_flank_gets_its_cusp(pins, shortening):
    """Along the offset curve the way forward is (1 - rrp curvature) of that along the path: it turns back at a cusp."""
    t = np.linspace(0, 2 * np.pi / (pins - 1), 20001)
    path = np.exp(1j * t) - shortening / pins * np.exp(1j * pins * t)
    along = 1j * (np.exp(1j * t) - shortening * np.exp(1j * pins * t))
    least = float(jax.jit(least_convex_radius, static_argnames="pins")(shortening, pins=pins))
    for factor, turns in ((0.999, False), (1.001, True)):
        flank = path + 1j * along / np.abs(along) * factor * least
        forward = np.real(np.diff(flank) * np.conj(along[:-1] + along[1:]))
        assert (forward.min() < 0) == turns


def test_contact_ratio_of_standard_gears():
    """20 and 40 teeth, 20 deg: by hand, lengths in modules: tips 11 and 21, bases 9.3969 and 18.7939, centres 30."""
    stage = InvoluteStage.from_teeth(20, 40, module=2 * mm)
    by_hand = (np.sqrt(11**2 - 9.396926**2) + np.sqrt(21**2 - 18.793852**2) - 30 * np.sin(np.pi / 9)) / 2.952131
    assert jax.jit(contact_ratio)(stage) == pytest.approx(by_hand, rel=1e-6)


def test_the_mass_is_that_of_every_part_that_turns():
    """Of the RV-320E: one sun and one output, a planet for each crank, a disc for each phase."""
    parts, cranks, discs = RV_320E.inertia, RV_320E.cranks.count, RV_320E.cycloid.disc_count
    due = parts.sun_mass + parts.output_mass + cranks * (parts.planet_mass + parts.crank_mass) + discs * parts.disc_mass
    assert cranks > 1 and discs > 1
    assert geometry.figures(RV_320E).mass == pytest.approx(float(due), rel=1e-6)


def test_slopes_are_those_of_the_plain_value():
    at = np.array([1.3 * mm, 64 * mm, 3 * mm, 12 * mm, 1.0])
    found = np.asarray(slopes(at, 412.0))
    for k, step in enumerate(1e-5 * np.diag(at)):
        due = (np.asarray(read(at + step, 412.0)) - read(at - step, 412.0)) / (2e-5 * at[k])
        np.testing.assert_allclose(found[:, k], due, rtol=2e-5, atol=1e-9)


@pytest.mark.long
def test_float32_gives_the_same_to_its_rounding():
    design = reducer(1.3 * mm, 64 * mm, 3 * mm, 12 * mm)
    single = geometry.figures(jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), design), jnp.float32(412))
    for name in ("convex_radius", "pin_pressure", "contact_ratio"):
        assert getattr(single, name).dtype == jnp.float32
        assert getattr(single, name) == pytest.approx(float(getattr(geometry.figures(design, 412.0), name)), rel=1e-4)


def test_a_batch_gives_each_its_own_status():
    """An undercut flank keeps its figures; a design that cannot be has none, and harms no neighbour."""
    ring = np.array([64 * mm, 64 * mm, 50 * mm, np.nan, *[64 * mm] * 3])
    pin = np.array([3 * mm, 7 * mm, *[3 * mm] * 5])
    found = seven(1.3 * mm, ring, pin, 12 * mm, 412.0)
    due = [Status.CONVERGED, Status.UNDERCUT, Status.INVALID_GEOMETRY, Status.NONFINITE, *[Status.CONVERGED] * 3]
    assert found.info.status.tolist() == due
    assert np.isfinite(found.convex_radius).tolist() == [True, True, False, False, True, True, True]
    assert np.isfinite(found.pin_pressure).tolist() == [True, False, False, False, True, True, True]
    assert found.convex_radius[1] < 0

    def pressure(e):
        return geometry.figures(reducer(e, 64 * mm, 7 * mm, 12 * mm), 412.0).convex_radius

    assert np.isfinite(jax.jit(jax.grad(pressure))(1.3 * mm))


def test_no_torque_no_pressure_and_a_finite_slope():
    slope = jax.grad(lambda torque: geometry.figures(MACHINE, torque).pin_pressure)
    assert geometry.figures(MACHINE).pin_pressure == 0
    assert np.isfinite(jax.jit(slope)(0.0))


def test_what_a_design_lacks_is_none():
    found = geometry.figures(RV_40E, 412.0)
    assert found.pin_pressure is None and found.envelope_volume is None and found.mass is None
    assert found.envelope_diameter == pytest.approx(134 * mm)


def test_bad_input_is_one_line():
    with pytest.raises(ValueError, match="takes a design of kind RVReducer"):
        geometry.figures(CORR)
    with pytest.raises(ValueError, match="pin_count = 41: must be disc_teeth"):
        geometry.figures(RV_40E.replace(cycloid=RV_40E.cycloid.replace(pin_count=41)))


figures = jax.jit(geometry.figures)


def numbers(tree):
    """Every number as an array, so that one program serves."""
    return jax.tree.map(lambda x: np.asarray(x, float), tree)


AMPLITUDES = np.array([2e-6, -3e-6, 1.5e-6, -1e-6])


def curve_of(cycloid):
    """Curvature of the ground flank by differences: the offset of wheel centres on the shifted pin circle."""
    e, ring, teeth, pins = cycloid.eccentricity, cycloid.pin_circle_radius, cycloid.disc_teeth, cycloid.pin_count
    ring, wheel = ring + cycloid.shift_modification, cycloid.pin_radius + cycloid.equidistant_modification

    def flank(psi):
        t = psi / teeth
        along = 1j * (np.exp(1j * t) - e * pins / ring * np.exp(1j * pins * t))
        material = sum(a * np.cos(f * psi) for f, a in enumerate(cycloid.profile_modification, start=1))
        path = ring * np.exp(1j * t) - e * np.exp(1j * pins * t)
        return path + 1j * along / np.abs(along) * (wheel - material)

    psi, h = np.linspace(0.01, np.pi - 0.01, 4001), 1e-3
    first = (flank(psi + h) - flank(psi - h)) / (2 * h)
    second = (flank(psi + h) - 2 * flank(psi) + flank(psi - h)) / h**2
    return psi, np.imag(np.conj(first) * second) / np.abs(first) ** 3


@pytest.mark.parametrize(
    ("equidistant", "shift", "amplitude"), [(30e-6, 0, 0), (0, -50e-6, 0), (-20e-6, 40e-6, 0.3e-6)]
)
def test_the_curvature_of_a_modified_flank_is_that_of_the_curve_itself(equidistant, shift, amplitude):
    """Least convex radius and pressure follow equidistant and shift modification and harmonics."""
    design = reducer(1.3 * mm, 64 * mm, 3 * mm, 12 * mm)
    cycloid = design.cycloid.replace(
        equidistant_modification=equidistant, shift_modification=shift, profile_modification=amplitude * np.ones(4)
    )
    whole = design.cycloid.replace(profile_modification=np.zeros(4))
    found, plain = (figures(numbers(design.replace(cycloid=flank)), 412.0) for flank in (cycloid, whole))
    psi, bend = curve_of(cycloid)
    assert found.convex_radius == pytest.approx(1 / bend.max(), rel=2e-4)
    assert abs(float(found.convex_radius - plain.convex_radius)) > 10e-6
    # p^2 goes with 1/R*, R* = 1/(1/rr + curvature), forces are those of the rigid nominal discs
    _, nominal = curve_of(whole)
    k1, places = 0.8125, 2 * np.pi * np.arange(40) / 40
    angles = psi[:, None] + places
    lever = np.maximum(np.sin(angles), 0) / np.sqrt(1 + k1**2 - 2 * k1 * np.cos(angles))
    force = lever[:, 0] / np.sum(lever**2, axis=1)
    due = np.sqrt(np.max(force * (1 / 3e-3 + bend)) / np.max(force * (1 / 3e-3 + nominal)))
    assert found.pin_pressure / plain.pin_pressure == pytest.approx(due, rel=2e-4)


def test_harmonics_that_are_too_steep_give_a_warning_and_their_slope():
    """The slope of the material along the flank, by differences of the curve; the models are of first order in it."""
    cycloid = RV_40E.cycloid.replace(profile_modification=np.array([0.0, 2e-6, 0.0, 0.0]))
    psi = np.linspace(0, np.pi, 20001)
    t = psi / 39
    path = 64e-3 * np.exp(1j * t) - 1.3e-3 * np.exp(40j * t)
    along = 1j * (np.exp(1j * t) - 0.8125 * np.exp(40j * t))
    way = np.abs(np.diff(path + 1j * along / np.abs(along) * 3e-3))
    due = np.max(np.abs(np.diff(2e-6 * np.cos(2 * psi))) / way)
    with pytest.warns(ImplausibleDesign, match="slope of the flank 0.0.*up to a slope of 0.005"):
        found = geometry.figures(RV_40E.replace(cycloid=cycloid))
    assert found.flank_slope == pytest.approx(due, rel=1e-3) and due > 0.005
    assert geometry.figures(RV_40E).flank_slope == 0.0


def test_the_rounding_of_a_waved_flank_is_that_of_the_curve_itself():
    """Flank points from path and normal, its curvature by differences: rr^2 (1/rr + curvature)."""
    e, ring, pin = 1.3 * mm, 64 * mm, 3 * mm
    k1, teeth = e * 40 / ring, 39
    psi = np.linspace(0.02, np.pi - 0.02, 60)

    def flank(psi):
        """Disc frame, t = psi / zc; the normal from the pin centre into the disc."""
        t = psi / teeth
        path = ring * np.exp(1j * t) - e * np.exp(1j * 40 * t)
        along = 1j * (np.exp(1j * t) - k1 * np.exp(1j * 40 * t))
        material = sum(a * np.cos(f * psi) for f, a in enumerate(AMPLITUDES, start=1))
        return path + 1j * along / np.abs(along) * (pin - material)

    h = 1e-3
    first = (flank(psi + h) - flank(psi - h)) / (2 * h)
    second = (flank(psi + h) - 2 * flank(psi) + flank(psi - h)) / h**2
    bend = np.imag(np.conj(first) * second) / np.abs(first) ** 3
    cycloid = CycloidStage(39, 40, 2, e, ring, pin, profile_modification=AMPLITUDES)

    @jax.jit
    def rounding(cycloid):
        place = SimpleNamespace(lobe=Turn(jnp.cos(psi), jnp.sin(psi)), shortening=jnp.asarray(k1))
        place.size = jnp.sqrt(1 + k1**2 - 2 * k1 * place.lobe.cosine)
        return flank_rounding(cycloid, place)

    found, plain = (np.asarray(rounding(c)) for c in (cycloid, cycloid.replace(profile_modification=None)))
    np.testing.assert_allclose(found, pin + pin**2 * bend, rtol=2e-3)
    assert np.max(np.abs(found / plain - 1)) > 0.02  # the waves count


def test_a_profile_modification_is_material_of_every_disc():
    """The depth of every pin is that of a disc profile error of the same terms."""
    waves = np.zeros((5, 2))
    waves[1:, 0] = AMPLITUDES
    designed = MACHINE.replace(cycloid=MACHINE.cycloid.replace(profile_modification=AMPLITUDES))
    errors = [RVErrors(disc_profile=waves[None] * np.ones((2, 1, 1))), RVErrors(disc_profile=np.zeros((2, 5, 2)))]

    @jax.jit
    def pins(design, own):
        e = jnp.asarray(MACHINE.cycloid.eccentricity)
        return pin_depths(design.cycloid, own, geometry_at(MACHINE.cycloid, e, jnp.asarray(0.3 / MACHINE.ratio)))

    due, found = (pins(d, own) for d, own in zip((MACHINE, designed), errors))
    np.testing.assert_allclose(found, due, rtol=1e-12, atol=1e-18)
    assert np.max(np.abs(due)) > 5e-6


def test_a_profile_modification_takes_lost_motion_where_the_pins_touch():
    """The least of (D S - m)/(e zc sin psi) over the flank, for a modification small against the backlash."""
    e, ring, play = 1.3 * mm, 64 * mm, 100e-6
    k1, small = e * 40 / ring, 1e-3 * AMPLITUDES
    psi = np.linspace(0.3, 2.8, 200_001)
    size = np.sqrt(1 + k1**2 - 2 * k1 * np.cos(psi))
    material = sum(a * np.cos(f * psi) for f, a in enumerate(small, start=1))
    least = [np.min((play - m) * size / (e * 39 * np.sin(psi))) for m in (0, material)]
    cycloid = RV_40E.cycloid.replace(equidistant_modification=play)
    designs = (RV_40E.replace(cycloid=cycloid.replace(profile_modification=a)) for a in (None, small))
    found = [float(lost_motion.geometric(design, RVErrors()).total) for design in designs]
    assert found[1] - found[0] == pytest.approx(2 * (least[1] - least[0]), rel=1e-3)
    with pytest.raises(ValueError, match="profile_modification is read by"):
        lost_motion.geometric(RV_40E.replace(cycloid=cycloid.replace(profile_modification=small)), RVErrors(),
                              profile="contact")  # fmt: skip
