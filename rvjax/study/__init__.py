"""Studies: a question about one design, in Python or as a TOML file."""

from rvjax.study.budget import Budget, error_budget
from rvjax.study.question import Study, StudyError
from rvjax.study.read import embedded_names, load, parse_study

__all__ = ["Budget", "Study", "StudyError", "embedded_names", "error_budget", "load", "parse_study"]
