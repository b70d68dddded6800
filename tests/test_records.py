"""Records: pytrees that know unit, shape and sign; what constructors refuse and what passes untouched."""

import dataclasses
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import CycloidStage, InvoluteStage, RVErrors, catalogue
from rvjax.records import Record, promote
from rvjax.tolerances import Tolerance
from rvjax.units import deg, mm, um

RV_40E = catalogue.RV_40E


def test_counts_are_static_and_numbers_are_traced():
    leaves, structure = jax.tree.flatten(RV_40E.cycloid)
    assert RV_40E.cycloid.eccentricity in leaves
    assert 39 not in leaves  # disc_teeth
    assert structure != jax.tree.structure(RV_40E.cycloid.replace(disc_teeth=29, pin_count=30))
    compiled = jax.jit(lambda design: design.cycloid.eccentricity * design.cycloid.pin_count)
    assert float(compiled(RV_40E)) == pytest.approx(52 * mm)
    compiled(RV_40E.replace(cycloid=RV_40E.cycloid.replace(eccentricity=1.2 * mm)))
    assert compiled._cache_size() == 1


def test_records_are_arguments_and_results_of_programs_that_are_written():
    """Counts, texts and None come back as they were."""
    given = catalogue.RV_320E, RVErrors.for_design(catalogue.RV_320E), Tolerance.symmetric(3 * um)
    read = jax.export.deserialize(jax.export.export(jax.jit(lambda x: x))(given).serialize())
    found = read.call(given)
    assert jax.tree.structure(found) == jax.tree.structure(given)
    jax.tree.map(np.testing.assert_array_equal, found, given)


def test_docstring_tells_unit_shape_and_meaning_of_every_field():
    for cls in (RVErrors, CycloidStage, rvjax.SolveInfo):
        for f in dataclasses.fields(cls):
            line = next(line for line in cls.__doc__.splitlines() if line.strip().startswith(f.name + " "))
            assert f.metadata["unit"] in line and f.metadata["meaning"] in line


def test_python_numbers_stay_python_floats():
    errors = RVErrors(eccentricity=np.float64(1e-6), pin_radius=0)
    assert type(errors.eccentricity) is float and type(errors.pin_radius) is float
    assert promote(errors, jnp.float32(1.0))[0].eccentricity.dtype == jnp.float32
    assert promote(errors).eccentricity.dtype == jnp.float64


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: RV_40E.cycloid.replace(eccentricity=-1.3 * mm),
            ["CycloidStage.eccentricity", "-0.0013 m", "positive"],
        ),
        (lambda: RV_40E.cycloid.replace(eccentricity=2 * mm), ["1.25", "shortening coefficient K1", "0.002 m"]),
        (lambda: RV_40E.cycloid.replace(shortening=1.0), ["shortening", "between 0 and 1"]),
        (lambda: RV_40E.cycloid.replace(disc_teeth=39.5), ["disc_teeth", "39.5", "integer"]),
        (lambda: RV_40E.cranks.replace(count=1), ["count", "at least 2"]),
        (lambda: RV_40E.cranks.replace(circle_radius=jnp.ones(3)), ["circle_radius", "(3,)", "vmap"]),
        (lambda: RV_40E.replace(eccentricity=1 * mm), ["RVReducer", "no field 'eccentricity'"]),
        (lambda: RVErrors(bearing_clearance=-1 * um), ["bearing_clearance", "-1e-06 m", "zero or positive"]),
        (lambda: RVErrors(pin_radius="1 um"), ["pin_radius", "'1 um'", "number in m"]),
        (lambda: RVErrors(crank_eccentricity=np.zeros(2)), ["crank_eccentricity", "(2,)", "(discs, cranks)"]),
        (lambda: RVErrors(disc_bore=np.zeros((2, 2, 3))), ["disc_bore", "(discs, cranks, 2)"]),
        (
            lambda: RVErrors(crank_eccentricity=np.zeros((2, 2)), crank_phase=np.zeros(3)),
            ["crank_phase", "3 cranks", "crank_eccentricity has 2"],
        ),
        (lambda: RVErrors.for_design(RV_40E, carrier_bore=np.zeros((3, 2))), ["carrier_bore", "(3, 2)", "(2, 2)"]),
        (lambda: RVErrors.for_design(RV_40E, carrier_bores=0.0), ["no field 'carrier_bores'", "carrier_bore"]),
    ],
)
def test_bad_input_names_field_value_and_unit(make, words):
    with pytest.raises(ValueError, match=words[0].replace("(", r"\(").replace(")", r"\)")) as caught:
        make()
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_tracers_and_stacked_records_pass_untouched():
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[RV_40E.replace() for _ in range(3)])
    assert isinstance(stacked, Record) and stacked.cycloid.eccentricity.shape == (3,)
    batch = jax.vmap(lambda d, e: d.cycloid.replace(eccentricity=e).shortening_coefficient)
    np.testing.assert_allclose(batch(stacked, jnp.array([-1.0, 0.5, 3.0]) * mm), [-0.625, 0.3125, 1.875])
    slope = jax.grad(lambda e: RV_40E.cycloid.replace(eccentricity=e).shortening_coefficient)(1.3 * mm)
    assert float(slope) == pytest.approx(40 / (64 * mm))


NONE = jax.tree.map(lambda _: None, RV_40E), jax.tree.map(lambda _: None, RVErrors.for_design(RV_40E))


def test_a_record_of_axes_works_as_a_dict_does():
    """`in_axes` and `out_axes` from None, whole numbers and copies of them, also of a design within a design."""
    errors, (none_of_design, none) = RVErrors.for_design(RV_40E), NONE
    axes = [dataclasses.replace(none, crank_eccentricity=0), none.replace(crank_eccentricity=0)]
    axes.append(RVErrors(**{f.name: None for f in dataclasses.fields(none)} | dict(crank_eccentricity=0)))
    three = jnp.arange(12.0).reshape(3, 2, 2)
    batch = jax.tree.map(lambda leaf: leaf, errors.replace(crank_eccentricity=three[0]))
    object.__setattr__(batch, "crank_eccentricity", three)
    for way in axes:
        assert type(way.crank_eccentricity) is int
        found = jax.vmap(lambda e: e.crank_eccentricity.sum() + e.bearing_clearance, in_axes=(way,))(batch)
        np.testing.assert_array_equal(found, [6.0, 22.0, 38.0])
    zeros = jax.tree.map(lambda _: 0, errors)  # no None: only the copied record shows what its numbers are
    stacked = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 3), errors)
    object.__setattr__(stacked, "crank_eccentricity", three.transpose(1, 0, 2))
    moved = zeros.replace(crank_eccentricity=1)
    np.testing.assert_array_equal(jax.vmap(lambda e: e.crank_eccentricity.sum(), (moved,))(stacked), [6.0, 22.0, 38.0])
    out = jax.vmap(lambda x: errors.replace(crank_eccentricity=x), out_axes=axes[0].replace(crank_eccentricity=2))
    assert out(three).crank_eccentricity.shape == (2, 2, 3)
    inner = dataclasses.replace(none_of_design.cycloid, eccentricity=0)
    design_axes = dataclasses.replace(none_of_design, cycloid=inner)
    sizes = jax.vmap(lambda size: RV_40E.replace(cycloid=RV_40E.cycloid.replace(eccentricity=size)), 0, design_axes)
    assert sizes(jnp.array([1.0, 1.2]) * mm).cycloid.eccentricity.shape == (2,)
    whole = dataclasses.replace(none_of_design, cycloid=0)  # a prefix: every number of the part
    parts = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 2), RV_40E.cycloid)
    batch_of_designs = jax.tree.map(lambda leaf: leaf, RV_40E)
    object.__setattr__(batch_of_designs, "cycloid", parts)
    assert jax.vmap(lambda d: d.cycloid.pin_radius, (whole,))(batch_of_designs).shape == (2,)


def test_a_record_of_flags_is_a_mask():
    flags = jax.tree.map(lambda _: False, RVErrors())
    mask = flags.replace(pin_radius=True)
    chosen = jax.tree.map(lambda keep, value: value if keep else 0.0, mask, RVErrors(pin_radius=1.0, eccentricity=2.0))
    assert (chosen.pin_radius, chosen.eccentricity) == (1.0, 0.0)


def test_numbers_among_axes_are_checked_as_ever():
    """One real number makes data of a record, with whole numbers beside it; text is no axis."""
    zeros = jax.tree.map(lambda _: 0, RVErrors())
    assert type(zeros.replace(pin_radius=1 * um).eccentricity) is float
    whole = RVErrors(**dict.fromkeys((f.name for f in dataclasses.fields(zeros)), 0))  # no copy: numbers of a part
    assert {type(leaf) for leaf in jax.tree.leaves(whole)} == {float}
    for changes in (dict(bearing_clearance=-1.0), dict(bearing_clearance="1 um")):
        with pytest.raises(ValueError, match=r"RVErrors\.bearing_clearance"):
            dataclasses.replace(NONE[1], **changes)
    with pytest.raises(ValueError, match=r"RVErrors\.bearing_clearance"):
        RVErrors(bearing_clearance=True)
    with pytest.raises(ValueError, match=r"CycloidStage\.eccentricity"):
        RV_40E.cycloid.replace(eccentricity=0)


@pytest.mark.parametrize("dtype", [jnp.int32, jnp.int64, jnp.uint8])
@pytest.mark.parametrize("library", [np, jnp])
def test_whole_numbers_become_real(dtype, library):
    """Numbers, arrays and pairs, of NumPy and of JAX, traced too: each has a derivative."""
    one, four = library.ones((), dtype), library.ones((2, 2), dtype)
    slope = jax.grad(lambda e: e.crank_eccentricity.sum() * e.bearing_clearance)
    of = lambda x, y: slope(RVErrors(bearing_clearance=x, crank_eccentricity=y))  # noqa: E731
    for run in (of, jax.jit(of)):
        found = run(one, four)
        assert float(found.bearing_clearance) == 4.0
        np.testing.assert_array_equal(found.crank_eccentricity, 1.0)
    found = jax.vmap(lambda x: of(x, x))(library.arange(3, dtype=dtype))
    np.testing.assert_array_equal(found.bearing_clearance, [0.0, 1.0, 2.0])
    pair = rvjax.LinkDeviations(one, 0, 0, 0, joint=(one, 0)).joint
    assert all(jnp.issubdtype(jnp.result_type(number), jnp.floating) for number in pair)


@pytest.mark.parametrize("flag", [True, np.True_, np.array(True), jnp.array(True), jnp.ones((2, 2), bool)])
def test_a_flag_in_the_place_of_a_number_is_named(flag):
    name = "crank_eccentricity" if np.ndim(flag) else "bearing_clearance"
    with pytest.raises(ValueError, match=rf"RVErrors\.{name}.* must"):
        RVErrors(**{name: flag})
    if isinstance(flag, jax.Array):
        with pytest.raises(ValueError, match=rf"RVErrors\.{name}.* must"):
            jax.jit(lambda x: RVErrors(**{name: x}))(flag)


def test_for_design_fills_up_in_the_dtype_that_is_given():
    """float32 errors give float32 results: no default beside them is wider."""
    errors = RVErrors.for_design(RV_40E, disc_bore=np.zeros((2, 2, 2), np.float32), crank_phase=1e-3)
    arrays = [leaf for leaf in jax.tree.leaves(errors) if hasattr(leaf, "dtype")]
    assert len(arrays) > 3 and {leaf.dtype for leaf in arrays} == {np.dtype(np.float32)}
    assert RVErrors.for_design(RV_40E, crank_phase=1e-3).disc_bore.dtype == np.float64


def test_for_design_broadcasts_scalars_to_the_design():
    errors = RVErrors.for_design(RV_40E, crank_phase=1e-3, disc_bore=[[[1, 2], [3, 4]], [[5, 6], [7, 8]]])
    np.testing.assert_array_equal(errors.crank_phase, [1e-3, 1e-3])
    assert errors.disc_bore.shape == (2, 2, 2) and errors.crank_eccentricity.shape == (2, 2)
    assert errors.eccentricity == 0.0
    traced = jax.jit(lambda x: RVErrors.for_design(RV_40E, crank_eccentricity=x).crank_eccentricity)(2e-6)
    np.testing.assert_array_equal(traced, np.full((2, 2), 2e-6))


def test_a_stiffened_design_has_each_share_in_its_own_springs():
    shares = dict(sun_planet=0.1, disc_pin=-0.2, turning_arm=0.3, support=0.04)
    errors = RVErrors(**{f"{name}_stiffness": share for name, share in shares.items()})
    springs = {"sun_planet": "sun_planet_mesh", "disc_pin": "disc_pin_mesh"}
    springs |= {"turning_arm": "turning_arm_bearing", "support": "support_bearing"}
    nominal, found = vars(catalogue.RV_320E.stiffness), vars(errors.stiffened(catalogue.RV_320E).stiffness)
    own = {spring: 1 + shares[name] for name, spring in springs.items()}
    for name, value in nominal.items():
        assert found[name] == value * own.get(name, 1.0), name


def test_catalogue_holds_together():
    """Table values of the RV-40E against each other: gear geometry and crank spacing."""
    stage = InvoluteStage.from_teeth(10, 26, module=2 * mm, pressure_angle=20 * deg)
    for f in dataclasses.fields(stage):
        assert getattr(RV_40E.involute, f.name) == pytest.approx(getattr(stage, f.name), rel=1e-14)
    assert RV_40E.cranks.circle_radius == RV_40E.involute.centre_distance
    assert RV_40E.cycloid.shortening_coefficient == pytest.approx(0.8125)
    assert RV_40E.cycloid.pin_count == RV_40E.cycloid.disc_teeth + 1


def test_every_public_name_is_there():
    for name in rvjax.__all__:
        assert getattr(rvjax, name) is not None, name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        rvjax.nothing  # noqa: B018
    assert set(dir(rvjax)) <= {*rvjax.__all__, "__version__"}
    results = ("SolveInfo", "TransmissionError", "LostMotion", "Block", "Root")
    assert len(dir(rvjax)) <= 40 and not set(results) & set(dir(rvjax)) and set(results) <= set(rvjax.__all__)


def test_import_changes_no_setting_touches_no_device_and_is_quick():
    import subprocess
    import sys

    code = (
        "import sys, jax, rvjax, rvjax.four_bar, rvjax.tolerances\n"
        "from jax._src import xla_bridge\n"
        "assert not jax.config.jax_enable_x64 and not xla_bridge._backends\n"
        "import rvjax.cli, rvjax.commands.check\n"
        "assert not {'scipy.stats', 'matplotlib', 'pandas'} & {*sys.modules}\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_forgotten_float64_is_said_once():
    """In a process of its own, by whatever makes the errors; float32 on purpose is silent."""
    code = """if True:
    import warnings, numpy, rvjax
    from rvjax import RVErrors, catalogue
    from rvjax._jax import checks
    made = (
        lambda: RVErrors.for_design(catalogue.RV_40E, crank_phase=1e-4),
        lambda: rvjax.lost_motion.geometric(catalogue.RV_20E, RVErrors(bearing_clearance=1e-6)),
        lambda: RVErrors().replace(disc_centre=numpy.full((2, 2), 1e-6)),
        lambda: rvjax.CamRollerErrors(eccentricity=1e-6),
    )
    for make in made:
        checks._reminded.clear()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            RVErrors.for_design(catalogue.RV_40E, crank_phase=numpy.float32(1e-4))
            RVErrors(disc_bore=numpy.zeros((2, 2, 2), numpy.float32), bearing_clearance=1e-6)
            RVErrors()
            assert not caught
            make()
            make()
        (one,) = caught
        assert "rvjax.enable_x64()" in str(one.message)
    """
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


SOLVED = rvjax.SolveInfo(0, 3, 1e-17)


def test_a_record_reads_as_one_short_line_with_units():
    arcsec = deg / 3600
    found = rvjax.TransmissionError(12.4 * arcsec, jnp.array([-30.0, 90.0]) * arcsec, np.array([0.002, np.nan]), SOLVED)
    fields = ("error=12.4 arcsec", "per_disc=(2,) -0.5 .. 1.5 arcmin", "misfit=(2,) 2 mm, 1 nan", f"info={SOLVED!r}")
    assert repr(found) == f"TransmissionError({', '.join(fields)})"
    assert repr(SOLVED) == "SolveInfo(CONVERGED, steps=3, residual=1e-17)"
    stacked = jax.vmap(lambda s: rvjax.SolveInfo(s))(jnp.array([4, 0, 0, 77]))
    stacked = stacked.replace(steps=0, residual=0.0)
    assert repr(stacked).startswith("SolveInfo(2 CONVERGED, 1 SINGULAR, 1 77,")
    assert repr(catalogue.CORR).startswith("CamRollerReducer(gear_teeth=25, cam_radius=")
    assert " mm, " in repr(catalogue.CORR) and " GPa, " in repr(catalogue.CORR)
    assert "inertia=" not in repr(catalogue.RV_40E)  # what is None is left out, and so is what is 0 by default
    assert repr(rvjax.RVErrors(pin_radius=-2e-6)) == "RVErrors(pin_radius=-2 um)"
    assert max(len(repr(d)) for d in (catalogue.RV_40E, catalogue.RV_320E)) < 2000


def test_a_record_of_anything_can_be_read():
    """Tracers as JAX writes them; nothing raises, for a debugger asks at any moment."""
    seen = []

    def look(angle):
        seen.append(repr(rvjax.SolveInfo(0, 1, angle)))
        return angle

    jax.vmap(jax.jit(look))(jnp.arange(2.0))
    assert "residual=" in seen[0] and "float64[" in seen[0].replace("f64[", "float64[")
    gone = jnp.ones(3)
    gone.delete()
    odd = [jax.random.key(0), gone, object(), None, "x", np.zeros(0), jnp.ones(2, jnp.bfloat16), 1 + 2j, np.array(True)]
    odd += [jnp.array([1j, np.nan]), np.array([np.inf, -1.0]), jax.ShapeDtypeStruct((2,), float), np.full(2, np.nan)]
    for value in odd:
        assert repr(jax.tree.map(lambda _, v=value: v, rvjax.SolveInfo(0, 1, 0.0))).startswith("SolveInfo(")
