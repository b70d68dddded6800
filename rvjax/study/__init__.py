"""Studies: a question about one design, in Python or as a TOML file."""

from rvjax.study.design import BASES
from rvjax.study.facts import facts_of
from rvjax.study.measured import Conditions, Run
from rvjax.study.measured import read as read_measured
from rvjax.study.plausible import KNOWN_DESIGNS, RATED, TORQUE, numbers, shown
from rvjax.study.question import Study, StudyError
from rvjax.study.read import EMBEDDED, embedded_names, load, parse_study
from rvjax.study.values import choice, integer, known, naming, quantity, subtable

__all__ = [
    "BASES",
    "EMBEDDED",
    "KNOWN_DESIGNS",
    "RATED",
    "TORQUE",
    "Conditions",
    "Run",
    "Study",
    "StudyError",
    "choice",
    "embedded_names",
    "facts_of",
    "integer",
    "known",
    "load",
    "naming",
    "numbers",
    "parse_study",
    "quantity",
    "read_measured",
    "shown",
    "subtable",
]
