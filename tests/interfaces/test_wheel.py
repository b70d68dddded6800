"""The wheel holds every file that the package needs, and nothing else; built here, without a network."""

import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.long
def test_the_wheel_holds_every_file_of_the_package(tmp_path):
    from hatchling.builders.wheel import WheelBuilder

    builder = WheelBuilder(str(ROOT))
    (path,) = builder.build(directory=str(tmp_path), versions=["standard"])
    names = zipfile.ZipFile(path).namelist()
    found = {name for name in names if ".dist-info/" not in name}
    there = {
        str(file.relative_to(ROOT))
        for file in (ROOT / "rvjax").rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    assert found == there
    assert {".py", ".toml", ".json", ".css", ".js", ".j2", ".typed"} == {Path(name).suffix for name in found}
    assert "rvjax/py.typed" in found  # the annotations count for users
    (entry,) = (name for name in names if name.endswith("entry_points.txt"))
    assert "rvjax = rvjax.cli:main" in zipfile.ZipFile(path).read(entry).decode()
    assert any(name.endswith("licenses/LICENSE") for name in names)
