"""A small study with its answer and what follows its sliders, computed once for the tests of both."""

import functools
import json
import shutil
import subprocess
from importlib import resources

import pytest
from cli_study import one_start

from rvjax import study
from rvjax.commands.allocate.answer import Answer, answer
from rvjax.commands.report import response_surface
from rvjax.response.response import BLOCK

PLAY = """# the play of an RV-20E
[design]
base = "rv-20e"

[tolerances.disc_runout]
lower = "0 um"   # a magnitude
upper = "15 um"

[tolerances.pin_radius]
half_width = "4 um"
distribution = "uniform"

[tolerances.shift_modification]
half_width = "3 um"

[tolerances.pin_hole_clearance]
lower = "0 um"
upper = "5 um"
distribution = "lognormal"
log_sd = 0.2

[tolerances.bearing_clearance]
lower = "0 um"
upper = "5 um"

[cost.pin_radius]
scale = 1
reference = "4 um"
finest = "1 um"
coarsest = "20 um"

[cost.shift_modification]
model = "exponential"
scale = 2
decay = "3 um"
finest = "1 um"
coarsest = "20 um"

[middle.shift_modification]
lower = "-6 um"
upper = "6 um"
cost = 0.01
per = "1 um"

[requirement.lost_motion]
lower = "-1.5 arcmin"
upper = "1 arcmin"
target = 0.99

[run]
samples = 1024
certificate_samples = 32768
"""


FEW = dict(points=4, fresh=BLOCK)  # points and independent units that show as much, sooner


@functools.cache
def played() -> tuple[Answer, response_surface.Surrogate]:
    """The study's answer and response_surface."""
    with one_start(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("rvjax.commands.allocate.answer.targets", lambda _: [])  # no curve of costs
        found = answer(study.parse_study(PLAY, name="play"))
    assert found.allocation.feasible
    made = response_surface.surrogate(found, **FEW)
    assert made is not None
    return found, made


def in_node(program, *inputs):
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node on PATH: the arithmetic of the page is not run")
    code = (resources.files("rvjax.commands.report") / "live.js").read_text("utf-8")
    run = "const input = JSON.parse(require('fs').readFileSync(0, 'utf-8'));\n"
    command = [node, "-e", f"{code}\n{run}console.log(JSON.stringify((() => {{{program}}})()));"]
    done = subprocess.run(command, input=json.dumps(inputs), capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
