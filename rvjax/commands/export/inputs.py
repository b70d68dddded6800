"""Inputs of `rvjax export`."""

import dataclasses
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rvjax import commands, study
from rvjax.base.files import check_writable
from rvjax.commands.allocate import answer
from rvjax.geometry import DRAWINGS, PARTS
from rvjax.records import PyTree
from rvjax.running import FORMATS
from rvjax.study import StudyError
from rvjax.units import um

UNITS = 256
"""Random units of a statistic without --samples."""
STATISTICS = {"median": 0.5, "p99": 0.99}
ALL = "all"  # parts
JOINT = ("unit", "rated_torque", "damping", "input_inertia", "output_inertia", "samples", "curve")
OUTLINE = ("part", "disc", "chord", "result")  # the last one of sizes too
"""Options of one kind of file."""
SIZES = "sizes"
SOLVING = "joint model"  # phase


@dataclass(kw_only=True)
class ExportInputs(commands.Inputs):
    """Write the outlines of disc, ring and carrier for CAD and wire EDM (.dxf, .svg, .csv), the sizes for the drawing
    (.csv with --as sizes), or the joint model of the reducer for a simulator (.xml, .mo, .urdf, .json). Existing files
    are never overwritten.

    examples:
      rvjax export my-study.toml disc.dxf
      rvjax export my-study.toml parts.svg --part all --result results/my-study
      rvjax export my-study.toml sizes.csv --as sizes --result results/my-study
      rvjax export my-study.toml joint.xml
      rvjax export my-study.toml joint.mo --rated-torque "412 N m" --damping "50 N m s/rad"
      rvjax export my-study.toml joint.json --unit p99 --samples 1000
      rvjax export my-study.toml joint.urdf --unit unit-17.toml --curve error.csv

    Outlines have the sizes of the design, or of the mid-points of a result. DXF needs the extra cad. Sizes for the
    drawing have the tolerances of the study, or those of a result.

    A joint model has backlash, stiffness, friction and inertia; it needs [design.friction], [design.stiffness] and
    [design.contact]. Endings: .xml (MJCF), .mo (Modelica), .urdf, .json. A unit is "nominal" (no
    errors), a .toml file with the table [errors] of a measured unit, or a statistic of random units: with "median"
    or "p99" every number is the median, or the unfavourable 99 % quantile. MJCF and Modelica need both inertias.
    mjcf has the stiffness of the train; mjcf-soft has a constraint in its place, which allows a timestep of 1 ms.
    """

    source: str = commands.study_argument()
    file: Path = commands.argument("new file", "FILE", type=Path, ends="")
    form: str = commands.option(
        "format of the file (default: by its ending)",
        default="",
        choices=[*FORMATS, SIZES],
        flag="--as",
    )
    unit: str = commands.option(
        "nominal (default), median, p99, or a .toml file with the table [errors]", "UNIT", default="nominal"
    )
    rated_torque: float | None = commands.option(
        "torque of stiffness and losses, such as '412 N m' (default: conditions.rated_torque)",
        "TORQUE",
        unit="N m",
        sign="positive",
    )
    damping: float | None = commands.option(
        "damping of the elastic train at the output, such as '50 N m s/rad' (default: none)",
        "DAMPING",
        unit="N m s/rad",
        sign="nonnegative",
    )
    input_inertia: float | None = commands.option(
        "of input shaft and motor, such as '1e-4 kg m2' (default: from design.inertia)",
        "INERTIA",
        unit="kg m2",
        sign="positive",
    )
    output_inertia: float | None = commands.option(
        "of all that turns with the output (default: from design.inertia)", "INERTIA", unit="kg m2", sign="positive"
    )
    samples: int | None = commands.option(
        "random units of median and p99 (default: 256)", "N", type=commands.whole_number
    )
    curve: Path | None = commands.option(
        "write the transmission error over a turn of the output under the rated torque too (default: none)",
        "FILE.csv",
        type=Path,
        ends=".csv",
    )
    part: str = commands.option("part of the outline (default: disc)", default="disc", choices=[*PARTS, ALL])
    disc: int = commands.option("number of the disc, from 0 (default: 0)", "K", default=0, type=int)
    chord: float | None = commands.option(
        "largest distance of flank and line, such as '5 um' (default: 1 um)", "LENGTH", unit="m", sign="positive"
    )
    result: str | None = commands.option(
        "results folder of rvjax allocate or design: its design and mid-points, and for sizes its tolerances",
        "FOLDER",
    )
    quiet: bool = commands.quiet_option()

    def __post_init__(self) -> None:
        """Read the study and the unit, and check what a joint model needs.

        Raises:
            ValueError: one line that names the option or the key.
        """
        self.drawing = self.file.suffix in DRAWINGS and not self.form
        statistic = self.unit in STATISTICS
        endings = {form.ending: name for name, form in FORMATS.items() if not name.endswith("-soft")}
        self.form = self.form or endings.get(self.file.suffix, "")
        if not (self.form or self.drawing):
            ends = ", ".join((*endings, *DRAWINGS))
            raise ValueError(f"{self.file}: must end with one of {ends}, or give --as")
        if self.form == SIZES and self.file.suffix != ".csv":
            raise ValueError(f"{self.file}: must end with .csv; --as {SIZES} writes a table")
        for file in (self.file, self.curve):
            if file is not None and file.exists():
                raise ValueError(f"{file}: exists already; name a new file")
            if file is not None:
                check_writable(file)
        if self.curve == self.file:
            raise ValueError(f"--curve {self.curve}: must be another file than that of the joint model")
        what, others = self._others()
        for f in dataclasses.fields(self):
            if f.name in others and getattr(self, f.name) != f.default:
                raise ValueError(f"{commands.flag_of(f.name)}: {self.file} is {what}, which has no such option")
        self.chord = um if self.chord is None else self.chord
        if self.samples is not None and not statistic:
            raise ValueError(f"--samples {self.samples}: needs --unit {' or '.join(STATISTICS)}")
        if self.curve is not None and statistic:
            raise ValueError(
                f"--curve {self.curve}: --unit {self.unit} is no single unit; give nominal or a .toml file"
            )
        toleranced = statistic or (self.form == SIZES and self.result is None)
        needs = ("design", "tolerances") if toleranced else ("design",)
        self.study = study.load(self.source, solve=False, needs=needs)
        self.phases = (commands.READING, commands.WRITING)
        if self.drawing or self.form == SIZES:
            self.stored = None if self.result else answer.folder(self.study, None)
            return
        self.phases = (commands.READING, SOLVING, commands.WRITING)
        self.torque = self._checked()
        self.errors = None if statistic else _errors(self.unit, self.study.design)
        self.units = self.samples or UNITS

    def _others(self) -> tuple[str, tuple[str, ...]]:
        """The kind of file in words, and the options of other kinds."""
        if self.form == SIZES:
            return "a table of sizes", (*JOINT, *OUTLINE[:-1])
        return ("an outline", JOINT) if self.drawing else ("a joint model", OUTLINE)

    def _checked(self) -> float:
        """The rated torque; the design and the options allow a joint model."""
        name, design = self.study.name, self.study.design
        if not hasattr(design, "friction"):
            raise StudyError(f"{name}: {study.kind_of(design).name} has no model of its friction")
        if design.friction is None:
            raise StudyError(f"{name}: design.friction is missing: rvjax export needs it")
        torque = getattr(self.study.conditions, "rated_torque", None)
        torque = torque if self.rated_torque is None else self.rated_torque
        if torque is None:
            raise StudyError(f"{name}: conditions.rated_torque is missing; give it or --rated-torque")
        if torque <= 0:
            raise ValueError(f"conditions.rated_torque = {torque:g}: must be positive")
        if FORMATS[self.form].inertias and getattr(design, "inertia", None) is None:
            missing = f"{name}: design.inertia is missing: {self.form} needs both inertias"
            for key in ("input_inertia", "output_inertia"):
                if getattr(self, key) is None:
                    raise StudyError(f"{missing}; give {commands.flag_of(key)}")
        return torque


def _errors(unit: str, design: PyTree) -> PyTree:
    """Errors of the unit without errors, or of a measured one.

    Raises:
        ValueError: the file names no errors of such a design.
    """
    record = design.error_record
    if unit == "nominal":
        return record.for_design(design)
    if not unit.endswith(".toml"):
        raise ValueError(f"--unit {unit}: must be nominal, {', '.join(STATISTICS)}, or a .toml file with [errors]")
    try:
        tables = tomllib.loads(Path(unit).read_text("utf-8-sig"))
    except FileNotFoundError:
        raise FileNotFoundError(f"--unit {unit}: no such file") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ValueError(f"--unit {unit}: not valid TOML ({error})") from None
    study.known(tables, ("errors",), "")
    if not (given := study.subtable(tables, "errors")):
        raise ValueError(f"--unit {unit}: [errors] is missing or empty")
    fields = {f.name: f.metadata for f in dataclasses.fields(record)}
    study.known(given, fields, "errors")
    values = {}
    for name, value in given.items():
        where = f"errors.{name}"
        numbers = study.quantities(value, fields[name]["unit"], where)
        try:
            values[name] = np.asarray(numbers, float)
        except ValueError:
            raise ValueError(f"{where}: lists of different length") from None
    return record.for_design(design, **values)
