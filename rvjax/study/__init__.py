"""Studies: design, tolerances, costs and requirements, in Python or as a TOML file."""

from rvjax.catalogue import (
    BASES,
    fields_of as fields_of,
    fields_of_kind as fields_of_kind,
    numbers,
    shown,
    walk as walk,
)
from rvjax.measured import Loop, Measured, Run, read as read_measured
from rvjax.study.bench import order_name
from rvjax.study.design import (
    comments as comments,
    given_numbers as given_numbers,
    given_paths as given_paths,
    is_assumed as is_assumed,
)
from rvjax.study.identification import NUISANCES, field_unit, part_orders as part_orders
from rvjax.study.kinds import (
    KINDS as KINDS,
    Assumed as Assumed,
    Drawing as Drawing,
    Kind as Kind,
    Known as Known,
    Law as Law,
    Start as Start,
    changed as scaled,
    facts_of,
    kind_of as kind_of,
    number_at as number_at,
    orders_of as orders_of,
    outside as outside,
    variable_tables as variable_tables,
)
from rvjax.study.problem import (
    Problem,
    candidates,
    identification_of,
    problem as inverse_problem,
)
from rvjax.study.reader import EMBEDDED, embedded_names, load, parse_study, template as study_template
from rvjax.study.response import (
    Response as Response,
    outcome_of as outcome_of,
    refuse as refuse,
)
from rvjax.study.sizes import COARSE as COARSE, Size, sizes_of
from rvjax.study.study import Study, StudyError
from rvjax.study.tolerances import mid_points as mid_points, scalars as scalars, stated_by as stated_by
from rvjax.study.values import (
    Metadata as Metadata,
    choice,
    in_unit as in_unit,
    integer,
    is_replaced as is_replaced,
    known,
    naming,
    quantities as quantities,
    quantity,
    subtable,
)

__all__ = ["BASES", "EMBEDDED", "Loop", "Measured", "NUISANCES", "Problem"]
__all__ += ["Run", "Study", "StudyError", "choice", "embedded_names", "field_unit"]
__all__ += ["identification_of", "integer", "inverse_problem", "facts_of", "known", "load", "naming", "numbers"]
__all__ += ["order_name", "parse_study", "quantity", "scaled", "read_measured", "shown", "study_template", "subtable"]
__all__ += ["Size", "candidates", "sizes_of"]
