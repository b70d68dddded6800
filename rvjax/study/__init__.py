"""Studies: a question about one design, in Python or as a TOML file."""

from rvjax.study.answer import CERTIFYING, PRICING, SAMPLING, SEARCHING, Answer, Side, shown_values, solved_units
from rvjax.study.bench import NUISANCES, order_name
from rvjax.study.bench import part_orders as part_orders
from rvjax.study.design import BASES
from rvjax.study.facts import facts_of
from rvjax.study.identification import field_unit
from rvjax.study.measured import Conditions, Loop, Measured, Run
from rvjax.study.measured import read as read_measured
from rvjax.study.plausible import KNOWN_DESIGNS, RATED, TORQUE, numbers, shown
from rvjax.study.problem import Problem, Wide
from rvjax.study.problem import asked_of as identification_of
from rvjax.study.problem import problem as inverse_problem
from rvjax.study.problem import wide as with_candidates
from rvjax.study.question import Study, StudyError
from rvjax.study.read import EMBEDDED, embedded_names, load, parse_study
from rvjax.study.rewrite import template as study_template
from rvjax.study.values import choice, integer, known, naming, quantity, subtable

__all__ = [
    "Answer",
    "BASES",
    "CERTIFYING",
    "Conditions",
    "EMBEDDED",
    "KNOWN_DESIGNS",
    "Loop",
    "Measured",
    "NUISANCES",
    "PRICING",
    "Problem",
    "RATED",
    "Run",
    "SAMPLING",
    "SEARCHING",
    "Side",
    "Study",
    "StudyError",
    "TORQUE",
    "Wide",
    "choice",
    "embedded_names",
    "facts_of",
    "field_unit",
    "identification_of",
    "integer",
    "inverse_problem",
    "known",
    "load",
    "naming",
    "numbers",
    "order_name",
    "parse_study",
    "quantity",
    "read_measured",
    "shown",
    "shown_values",
    "solved_units",
    "study_template",
    "subtable",
    "with_candidates",
]
