"""Formats of joint models by name."""

from collections.abc import Callable
from typing import NamedTuple

from rvjax.records import PyTree
from rvjax.running.formats.head import Header
from rvjax.running.formats.json_file import as_json
from rvjax.running.formats.mjcf import as_mjcf, remark
from rvjax.running.formats.modelica import as_modelica
from rvjax.running.formats.urdf import as_urdf


class Form(NamedTuple):
    """A format of a joint model."""

    ending: str  # of file names
    write: Callable[[PyTree, Header], str]
    inertias: bool  # whether it needs both inertias
    remark: Callable[[PyTree], str] = lambda _: ""  # a sentence on the file of a model


FORMATS = {
    "mjcf": Form(".xml", as_mjcf, True, remark),
    "modelica": Form(".mo", as_modelica, True),
    "urdf": Form(".urdf", as_urdf, False),
    "json": Form(".json", as_json, False),
}
