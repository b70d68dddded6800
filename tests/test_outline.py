"""Outlines of discs, rings and carriers.

Oracles: the path of the pin centres and its parallel line, evaluated here with complex numbers; the closed form of the
enclosed area; pins that touch flanks without modifications at the ideal position; differences.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.special import ellipe

from rvjax import CycloidalErrors, catalogue, geometry, mesh_force
from rvjax.designs import RollerBearing
from rvjax.errors import CamRollerErrors
from rvjax.plotting.drawings import flank
from rvjax.units import mm, um

DESIGNS = {
    name: getattr(catalogue, name) for name in ("CYCLOIDAL_15", "CYCLOIDAL_17", "CYCLOIDAL_29", "RV_20E", "RV_40E")
}
FINE = 1e-8
QUICK = ("CYCLOIDAL_17", "RV_20E")  # one of each kind; the size of a design decides the programs
EACH = [
    pytest.param(design, id=name, marks=[] if name in QUICK else [pytest.mark.long]) for name, design in DESIGNS.items()
]
THREE = catalogue.CYCLOIDAL_29.replace(cycloid=catalogue.CYCLOIDAL_29.cycloid.replace(disc_count=3))


def numbers(design):
    """Pin circle and offset of the flank, eccentricity, pins."""
    c = design.cycloid
    offset = c.pin_radius + c.equidistant_modification
    return c.pin_circle_radius + c.shift_modification, offset, c.eccentricity, c.pin_count


def path(design, t):
    """Pin centres and unit normals into the disc, complex."""
    circle, _, e, pins = numbers(design)
    along = 1j * (circle * np.exp(1j * t) - e * pins * np.exp(1j * pins * t))
    return circle * np.exp(1j * t) - e * np.exp(1j * pins * t), 1j * along / np.abs(along)


def plane(points):
    return np.asarray(points) @ [1, 1j]


def pairs(z):
    return np.stack([z.real, z.imag], axis=1)


@pytest.mark.parametrize("design", EACH)
def test_points_lie_on_the_parallel_line_as_dense_as_the_chord_says(design):
    found, offset = geometry.outline(design, chord=2 * um), numbers(design)[1]
    t = np.linspace(0, 2 * np.pi, 400_001)[:-1]
    centres, normals = path(design, t)
    distance, nearest = KDTree(pairs(centres)).query(found.flank)
    assert np.abs(distance - offset).max() < 1e-9
    flank = plane(found.flank)
    inwards = np.exp(1j * np.asarray(found.normal))
    assert np.abs((flank - offset * inwards) - path(design, t)[0][nearest]).max() < 1e-6  # steps of t
    true = centres + offset * normals
    place = np.searchsorted(np.sort(nearest), np.arange(len(t)), side="right") - 1  # point before
    assert np.all(np.diff(nearest) > 0)  # once round, counter-clockwise
    begin, end = flank[place], np.roll(flank, -1)[place]
    off = np.abs(((true - begin) * np.conj(end - begin)).imag) / np.abs(end - begin)
    assert 1e-6 < off.max() < 2.02e-6  # no more points than needed
    radius = np.abs(flank)
    assert np.sum((radius > np.roll(radius, 1)) & (radius >= np.roll(radius, -1))) == design.cycloid.disc_teeth


@pytest.mark.parametrize("design", EACH)
def test_the_area_is_that_of_the_closed_form(design):
    """pi (R^2 + zp e^2) less offset times length, and pi offset^2; arcs over their chords have k s^3/12."""
    circle, offset, e, pins = numbers(design)
    k = e * pins / circle
    length = 4 * circle * (1 + k) * ellipe(4 * k / (1 + k) ** 2)
    due = np.pi * (circle**2 + pins * e**2) - offset * length + np.pi * offset**2
    found = geometry.outline(design, chord=FINE)
    z, bend = plane(found.flank), np.asarray(found.curvature)
    chords = np.abs(np.roll(z, -1) - z)
    area = (np.conj(z) * np.roll(z, -1)).imag.sum() / 2
    area += ((bend + np.roll(bend, -1)) / 2 * chords**3 / 12).sum()
    assert area == pytest.approx(due, rel=1e-8)


@pytest.mark.parametrize("design", [*EACH, pytest.param(THREE, id="three discs")])
def test_all_pins_touch_flanks_without_modifications(design):
    """Every disc on its eccentric, its holes where the carrier is: only then is the phase of its flank right."""
    c = design.cycloid.replace(equidistant_modification=0.0, shift_modification=0.0, profile_modification=None)
    design = design.replace(cycloid=c)
    pins = c.pin_circle_radius * np.exp(2j * np.pi * np.arange(c.pin_count) / c.pin_count)
    for disc in range(c.disc_count):
        found = geometry.outline(design, disc=disc, chord=FINE)
        flank = plane(found.flank)
        tangent = np.roll(flank, -1) - np.roll(flank, 1)
        assert np.abs(np.exp(1j * np.asarray(found.normal)) - 1j * tangent / np.abs(tangent)).max() < 3e-3
        flank = flank + c.eccentricity * np.exp(2j * np.pi * disc / c.disc_count)
        distance, _ = KDTree(pairs(flank)).query(pairs(pins))
        np.testing.assert_allclose(distance, c.pin_radius, atol=1e-7)


@pytest.mark.parametrize(
    ("design", "name"),
    [
        pytest.param(DESIGNS[design], name, id=f"{kind}-{name}", marks=marks)
        for design, kind, quick in (("CYCLOIDAL_17", "drive", "eccentricity"), ("RV_20E", "RV", "pin_radius"))
        for name in ("eccentricity", "pin_circle_radius", "pin_radius")
        for marks in [[] if name == quick else [pytest.mark.long]]
    ],
)
def test_derivatives_of_the_flank(design, name):
    value, step = getattr(design.cycloid, name), 1e-8

    def flank(x):
        return geometry.outline(design.replace(cycloid=design.cycloid.replace(**{name: x})), chord=20 * um).flank

    due = (np.asarray(flank(value + step)) - np.asarray(flank(value - step))) / (2 * step)
    np.testing.assert_allclose(jax.jacfwd(flank)(value), due, atol=1e-6 * np.abs(due).max())


@pytest.mark.long  # of points of the flank; test_geometry.py has its curvature
def test_a_profile_modification_is_material():
    """a_0 cos(f psi) moves the flank towards the pin; curvature against `flank.modified`, of first order."""
    design = DESIGNS["CYCLOIDAL_17"]
    waves = np.array([0.0, 3 * um, 0.0, 0.0])
    other = design.replace(cycloid=design.cycloid.replace(profile_modification=waves))
    one = geometry.outline(other)
    (_, offset, _, _), t = numbers(design), np.linspace(0, 2 * np.pi, 400_001)
    distance, nearest = KDTree(pairs(path(design, t)[0])).query(one.flank)
    lobe = design.cycloid.disc_teeth * t[nearest]
    np.testing.assert_allclose(distance, offset - 3 * um * np.cos(2 * lobe), atol=2e-8)


def test_circles_of_a_drive():
    design = DESIGNS["CYCLOIDAL_17"]
    out, e = design.output, design.cycloid.eccentricity
    disc, ring, carrier = (geometry.outline(design, part=part) for part in ("disc", "ring", "carrier"))
    assert not len(ring.flank) and not len(carrier.flank)
    for one, name, count, circle, radius in (
        (disc, "hole", out.count, out.circle_radius, out.pin_radius + e + out.hole_clearance / 2),
        (carrier, "output pin", out.count, out.circle_radius, out.pin_radius),
        (ring, "pin", design.cycloid.pin_count, design.cycloid.pin_circle_radius, design.cycloid.pin_radius),
    ):
        own = [c for c in one.circles if c.name.startswith(f"{name} ") and c.name[-1].isdigit()]
        due = circle * np.exp(2j * np.pi * np.arange(count) / count)
        np.testing.assert_allclose([c.x + 1j * c.y for c in own], due, atol=1e-15)
        np.testing.assert_allclose([c.radius for c in own], radius, rtol=1e-14)
    arm = design.bearings.arm
    assert disc.circles[-1].name == "bore"
    assert disc.circles[-1].radius == pytest.approx((arm.pitch_diameter + arm.roller_diameter) / 2)
    bare = geometry.outline(design.replace(bearings=None))
    assert bare.unknown == ("bore of the eccentric bearing",) and len(bare.circles) == out.count


def test_circles_of_a_reducer():
    """Crank 0 lies on the negative x axis (docs/models/loaded.md)."""
    design = catalogue.RV_20E
    arm, support = RollerBearing(12, 4 * mm, 8 * mm, 20 * mm), RollerBearing(12, 3 * mm, 8 * mm, 22 * mm)
    design = design.replace(bearings=design.bearings.replace(arm=arm, support=support))
    for part, radius in (("disc", 12 * mm), ("carrier", 12.5 * mm)):
        found = geometry.outline(design, part=part)
        count = design.cranks.count
        due = design.cranks.circle_radius * np.exp(1j * (np.pi + 2 * np.pi * np.arange(count) / count))
        np.testing.assert_allclose([c.x + 1j * c.y for c in found.circles], due, atol=1e-15)
        assert [float(c.radius) for c in found.circles] == pytest.approx([radius] * count)
    assert "bores of the cranks" in geometry.outline(design.replace(bearings=None)).unknown


def test_sizes_of_a_unit():
    """A larger pin is a size of the ring alone: the flank was ground for the nominal one."""
    design = DESIGNS["CYCLOIDAL_17"]
    sizes = dict(equidistant_modification=4 * um, pin_radius=3 * um, hole_radius=5 * um, output_pin_radius=-2 * um)
    errors = CycloidalErrors(**sizes, pin_circle_radius=7 * um)
    plain, made = ({part: geometry.outline(design, part=part, errors=e) for part in ("disc", "ring", "carrier")}
                   for e in (None, errors))  # fmt: skip
    t = np.linspace(0, 2 * np.pi, 400_001)
    distance, _ = KDTree(pairs(path(design, t)[0])).query(made["disc"].flank)
    np.testing.assert_allclose(distance, numbers(design)[1] + 4 * um, atol=1e-9)
    for part, first, larger in (
        ("disc", 0, 5 * um),
        ("ring", 0, 3 * um),
        ("ring", -1, 7 * um),
        ("carrier", 0, -2 * um),
    ):
        one, other = (float(side[part].circles[first].radius) for side in (made, plain))
        assert one - other == pytest.approx(larger, rel=1e-9)
    moved = dict(eccentricity=6 * um, shift_modification=-8 * um)
    stage = design.cycloid
    due = stage.replace(**{name: getattr(stage, name) + by for name, by in moved.items()})
    one = geometry.outline(design, errors=CycloidalErrors(**moved))
    np.testing.assert_allclose(one.flank, geometry.outline(design.replace(cycloid=due)).flank, rtol=0, atol=1e-15)
    x = made["ring"].circles[0].x - plain["ring"].circles[0].x
    assert float(x) == pytest.approx(7 * um, rel=1e-9)


@pytest.mark.long
def test_single_precision_and_pictures():
    """The dtype is that of the design; a picture has the same flank, of an undercut design too."""
    design = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), DESIGNS["CYCLOIDAL_17"])
    one, due = (geometry.outline(d, points=16) for d in (design, DESIGNS["CYCLOIDAL_17"]))
    assert {leaf.dtype for leaf in (one.flank, one.normal, one.curvature)} == {np.dtype(np.float32)}
    circle, _, e, pins = numbers(design)
    rounding = np.finfo(np.float32).eps * 2 * np.pi * (circle + pins * e)  # of t and zp t
    np.testing.assert_allclose(one.flank, due.flank, rtol=0, atol=rounding)
    design = DESIGNS["CYCLOIDAL_17"]
    distance, _ = KDTree(pairs(path(design, np.linspace(0, 2 * np.pi, 400_001))[0])).query(flank(design))
    np.testing.assert_allclose(distance, design.cycloid.pin_radius, atol=1e-9)
    assert np.isfinite(flank(design.replace(cycloid=design.cycloid.replace(pin_radius=8.5 * mm)))).all()


def test_points_for_jit_and_vmap():
    """A given number on each tooth, equally spaced along the path of the pin centres; of many designs at once."""
    cycloid = DESIGNS["CYCLOIDAL_17"].cycloid

    def made(e):
        design = DESIGNS["CYCLOIDAL_17"].replace(cycloid=cycloid.replace(eccentricity=e))
        return geometry.outline(design, points=16)

    many = jax.jit(jax.vmap(made))(np.array([1.0, 1.6]) * mm)
    assert many.flank.shape == (2, 17 * 16, 2)
    np.testing.assert_allclose(many.flank[1], made(1.6 * mm).flank, rtol=0, atol=1e-16)
    t = 2 * np.pi / (17 * 16) * np.arange(17 * 16)
    centres, normals = path(DESIGNS["CYCLOIDAL_17"].replace(cycloid=cycloid.replace(eccentricity=1.6 * mm)), t)
    np.testing.assert_allclose(
        plane(many.flank[1]), centres + numbers(DESIGNS["CYCLOIDAL_17"])[1] * normals, atol=1e-15
    )


def roller_centres(design, angle):
    """Distances of roller centres from the axis on rays at angles from the y axis: cam and rollers as two links."""
    z, e, link = design.gear_teeth, design.eccentricity, design.cam_radius + design.roller_radius
    distance = e * np.cos(z * angle) + np.sqrt(link**2 - (e * np.sin(z * angle)) ** 2)
    return distance * 1j * np.exp(-1j * angle)


@pytest.mark.parametrize("chord", [20 * um, pytest.param(2 * um, marks=pytest.mark.long)])
def test_the_inner_gear_of_a_roller_stage_is_parallel_to_the_path_of_its_rollers(chord):
    """Counter-clockwise, with a tooth space on the y axis; normals into the material outside; convex tips."""
    design = catalogue.CORR
    found, r = geometry.outline(design, part="ring", chord=chord), design.roller_radius
    t = np.linspace(0, 2 * np.pi, 400_001)[:-1]
    centres = roller_centres(design, -t)
    distance, nearest = KDTree(pairs(centres)).query(found.flank)
    assert np.abs(distance - r).max() < 1e-9
    flank, into = plane(found.flank), np.exp(1j * np.asarray(found.normal))
    assert np.abs(flank - r * into - centres[nearest]).max() < 2e-6  # steps of t
    assert np.all(np.diff(nearest) > 0) and (flank * np.conj(into)).real.min() > 0
    assert flank[0] == pytest.approx(1j * (design.cam_radius + 2 * r + design.eccentricity), abs=1e-12)
    radius = np.abs(flank)
    assert np.sum((radius < np.roll(radius, 1)) & (radius <= np.roll(radius, -1))) == design.gear_teeth
    bend = np.asarray(found.curvature)
    assert bend[np.argmin(radius)] > 0 > bend[np.argmax(radius)]
    chords, turned = np.roll(flank, -1) - flank, np.asarray(found.normal)
    turn = (np.roll(turned, -1) - turned + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(-turn / np.abs(chords), (bend + np.roll(bend, -1)) / 2, atol=0.05 * np.abs(bend).max())
    along = np.roll(centres, -1) - np.roll(centres, 1)
    true = centres - 1j * r * along / np.abs(along)  # the parallel line itself
    place = np.searchsorted(nearest, np.arange(len(t)), side="right") - 1  # point before
    begin, end = flank[place], np.roll(flank, -1)[place]
    off = np.abs(((true - begin) * np.conj(end - begin)).imag) / np.abs(end - begin)
    assert 0.5 * chord < off.max() < 1.01 * chord  # no more points than needed


def test_the_other_parts_of_a_roller_stage():
    errors = CamRollerErrors(cam_radius=3 * um)
    cam = geometry.outline(catalogue.CORR, errors=errors)
    assert [(c.name, c.x, c.y) for c in cam.circles] == [("cam", 0, 0)] and len(cam.flank) == 0
    assert cam.circles[0].radius == pytest.approx(catalogue.CORR.cam_radius + 3 * um, abs=1e-15)
    cage = geometry.outline(catalogue.CORR, part="carrier")
    assert not cage.circles and cage.unknown == ("slots of the rollers", "outside of the cage")
    ring = geometry.outline(catalogue.CORR, part="ring", errors=errors, points=8)
    assert not ring.circles and len(ring.flank) == 8 * catalogue.CORR.gear_teeth

    def longest(e):
        design = catalogue.CORR.replace(eccentricity=e)
        return geometry.outline(design, part="ring", points=8).flank[0, 1]

    assert jax.grad(longest)(catalogue.CORR.eccentricity) == pytest.approx(1)


def test_bad_input():
    design = DESIGNS["CYCLOIDAL_17"]
    sharp = design.replace(cycloid=design.cycloid.replace(pin_radius=8.5 * mm))
    thick = catalogue.CORR.replace(roller_radius=1.01 * float(mesh_force.largest_roller_radius(catalogue.CORR)))
    wide = design.replace(output=design.output.replace(pin_radius=15 * mm))
    for call, words in (
        (lambda: geometry.outline(sharp), r"cut into the flank of the discs \(undercut\)"),
        (lambda: geometry.outline(wide), "OutputPins.pin_radius: holes of radius .* overlap from"),
        (lambda: geometry.outline(design, part="shaft"), "part = 'shaft'"),
        (lambda: geometry.outline(design, disc=2), "disc = 2: must lie between 0 and 1"),
        (lambda: geometry.outline(design.cycloid), "geometry.outline: takes a design of kind"),
        (lambda: geometry.outline(catalogue.CORR, disc=1), "disc = 1: must lie between 0 and 0"),
        (lambda: geometry.outline(thick, part="ring"), "roller_radius = .*: undercut of the inner gear from .* on"),
        (lambda: geometry.outline(design, chord=0.0), "chord = 0 m: must be positive"),
        (lambda: geometry.outline(design, points=0), "points = 0: a tooth needs at least 3"),
        (lambda: geometry.outline(design, chord=1e-16), "chord = 1e-16 m: too small"),
        (lambda: jax.jit(lambda d: geometry.outline(d).flank)(design), "jit or vmap traces needs `points`"),
    ):
        with pytest.raises(ValueError, match=words):
            call()
