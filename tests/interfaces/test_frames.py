"""Results as tables: every number of a record arrives once, at its place, with its unit. Oracle: the record itself."""

import dataclasses
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import cli, four_bar
from rvjax.base import frames
from rvjax.catalogue import RV_40E
from rvjax.tolerances import Allocation, Requirement, Tolerance, measured, monte_carlo, sobol_indices

STACK = {"a": Tolerance.symmetric(1.0), "b": Tolerance.symmetric(2.0)}


def total(e):
    return e["a"] + e["b"]


def both(e):
    return {"sum": e["a"] + e["b"], "difference": e["a"] - e["b"]}


@pytest.fixture(scope="module", autouse=True)
def pandas():
    """Imported when its first test runs: as many lines as SciPy, which every worker would read while it collects."""
    return pytest.importorskip("pandas")


@pytest.fixture(scope="module")
def units():
    """Three crank turns of eight angles, as a batch has them, of numbers that are all different."""
    rng = np.random.default_rng(0)
    axes = {"angles": 8, "discs": 2, "orders": 4}

    def some(f):
        return jnp.asarray(rng.normal(size=[axes[name] for name in f.metadata["shape"]]))

    def turn():
        numbers = {f.name: some(f) for f in dataclasses.fields(four_bar.Revolution) if f.name != "info"}
        return four_bar.Revolution(**numbers, info=rvjax.SolveInfo(jnp.asarray(0), jnp.asarray(3), jnp.asarray(0.0)))

    return jax.tree.map(lambda *leaves: jnp.stack(leaves), turn(), turn(), turn())


def test_a_frame_has_one_row_for_each_unit(units):
    found = units.to_pandas(("unit",))
    assert found.index.name == "unit" and len(found) == 3
    np.testing.assert_array_equal(found["peak_to_peak"], units.peak_to_peak)
    np.testing.assert_array_equal(found["misfit[5,1]"], units.misfit[:, 5, 1])
    np.testing.assert_array_equal(found["info_status"], [0, 0, 0])
    assert found.attrs["units"]["misfit[5,1]"] == "m" and found.attrs["units"]["peak_to_peak"] == "rad"
    numbers = sum(leaf[0].size for leaf in jax.tree.leaves(units))
    assert len(found.columns) == numbers  # each once


def test_a_frame_along_the_angle_has_the_curves(units):
    found = units.to_pandas(("unit",), along="angle")
    assert found.index.names == ["unit", "angle"] and list(found) == ["crank_angle", "error", "misfit[0]", "misfit[1]"]
    np.testing.assert_array_equal(found.loc[(2, 3), "misfit[1]"], units.misfit[2, 3, 1])
    one = jax.tree.map(lambda leaf: leaf[1], units).to_pandas(along="angle")
    np.testing.assert_array_equal(one["error"], units.error[1])
    assert len(one) == 8 and one.index.name == "angle"


def test_axes_must_be_named(units):
    with pytest.raises(ValueError, match=r"Revolution.crank_angle: shape \(3, 8\) .* batch=\('unit',\)"):
        units.to_pandas()
    with pytest.raises(ValueError, match="along = 'pin': Revolution has the axes angle, disc, order"):
        units.to_pandas(("unit",), along="pin")


def test_designs_and_errors_are_records_too():
    found = RV_40E.to_pandas()
    assert found.loc[0, "cycloid_pin_radius"] == RV_40E.cycloid.pin_radius
    assert found.attrs["units"]["cycloid_pin_radius"] == "m" and "inertia_sun_mass" not in found


def test_a_data_set_names_its_axes(units):
    pytest.importorskip("xarray")
    found = units.to_xarray(("unit",))
    assert dict(found.sizes) == {"unit": 3, "angle": 8, "disc": 2, "order": 4}
    assert found.misfit.dims == ("unit", "angle", "disc")
    np.testing.assert_array_equal(found.misfit.isel(unit=2, disc=1), units.misfit[2, :, 1])
    assert found.misfit.attrs == {"units": "m", "long_name": "of each disc"}
    assert found.attrs["record"] == "Revolution" and found.info_status.dims == ("unit",)


def test_names_of_elements_and_of_axes_that_are_also_fields():
    """The spectrum of the dynamic error: `order` is a field and an axis, `outputs` names the elements of another."""
    pytest.importorskip("xarray")
    numbers = dict(order=jnp.arange(3.0), frequency=jnp.ones(3), amplitude=jnp.full((3, 1), 1j))
    numbers |= dict(static=jnp.zeros((3, 1)), peak_to_peak=jnp.zeros(1), outputs=("output.rotation",))
    one = rvjax.DynamicError(**numbers, info=rvjax.SolveInfo(0))
    found = one.to_xarray()
    assert found.amplitude.sel(order=2.0, output="output.rotation") == 1j
    many = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 2), one).to_xarray(("unit",))
    assert many.order_value.dims == ("unit", "order") and many.order_value.attrs["units"] == "-"


def test_statistics():
    found = monte_carlo(both, STACK, samples=1000, seed=0, requirements={"sum": Requirement(upper=1.0)})
    table = found.to_pandas()
    assert set(table.index) == {"sum", "difference"}
    assert table.loc["sum", "mean"] == found.mean["sum"].value and table.loc["sum", "sd_upper"] == found.sd["sum"].upper
    assert table.loc["difference", "quantile_0.5_lower"] == found.quantiles[0.5]["difference"].lower
    assert table.loc["sum", "yield_error"] == found.yield_["sum"].error and np.isnan(table.loc["difference", "yield"])
    plain = monte_carlo(total, STACK, samples=1000, seed=0).to_pandas()
    assert plain.loc["response", "maximum"] == found.maximum["sum"]


def test_sobol_indices():
    found = sobol_indices(both, STACK, samples=64, seed=0)
    table = found.to_pandas()
    assert table.index.names == ["field", "response"] and len(table) == 4
    assert table.loc[("b", "difference"), "total_lower"] == found.total["difference"]["b"].lower
    plain = sobol_indices(total, STACK, samples=64, seed=0)
    assert plain.to_pandas().loc[("a", "response"), "first"] == plain.first["a"].value


def test_an_allocation():
    found = Allocation(**dict.fromkeys(f.name for f in dataclasses.fields(Allocation)))
    found = dataclasses.replace(
        found, tolerances=STACK, half_widths={"b": 2.0}, costs={"b": 7.0}, grades={"b": "IT6"}
    )  # "a" has no cost
    assert found.to_pandas().reset_index().to_dict("records") == [
        {"field": "b", "lower": -2.0, "upper": 2.0, "half_width": 2.0, "cost": 7.0, "grade": "IT6"}
    ]


@pytest.mark.parametrize(("method", "package"), [("to_pandas", "pandas"), ("to_xarray", "xarray")])
def test_a_package_that_is_missing_is_named_with_the_extra(monkeypatch, method, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"{method} needs {package}: pip install 'rvjax\[tables\]'"):
        getattr(rvjax.SolveInfo(0), method)()


def test_only_a_package_that_is_missing_is_told_as_bad_input(monkeypatch, tmp_path):
    """An import that fails inside rvjax, or inside a package that is installed, is a defect and says where it is."""

    def broken(*_):
        raise ImportError("cannot import name 'gone' from 'rvjax.report'")

    monkeypatch.setattr("rvjax.commands.check.compute", broken)
    with pytest.raises(ImportError, match="cannot import name 'gone'"):
        cli.main(["check", "corr"])
    (tmp_path / "broken_package.py").write_text("import no_such_package\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="no_such_package"):
        frames.needed("broken_package", "to_pandas")


def test_measured_parts(tmp_path):
    (tmp_path / "lot.csv").write_text("part;pin_radius [um];bore [um]\nA;1.0;12\nB;2.5;8\nC;-0.5;\n")
    columns = {"pin_radius": "pin_radius", "disc_bore[0,1,0]": "bore"}
    found = measured(tmp_path / "lot.csv", columns, design=RV_40E, limits={"pin_radius": (-2e-6, 5e-6)})
    frame = found.to_pandas()
    assert frame.loc["pin_radius", "cpk_lower"] == found.columns["pin_radius"].cpk.lower
    assert frame.loc["disc_bore[0,1,0]", "n"] == 2
