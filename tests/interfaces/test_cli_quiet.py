"""What a terminal shows: nothing of a library, and no line beyond its width. A job of the workflow.

Each command runs once, and again with kept programs.
"""

import os
import re
import subprocess
import sys

import pytest
from cli_study import GOOD

# Lost motion only, with a limit that no unit comes near: every yield is 1, which a logarithmic axis cannot show.
FLAT = re.sub(r"\[requirement\.(transmission_error|misfit)\](?s:.*?)\n\n", "", GOOD)
FLAT = FLAT.replace('output_torque = "412 N m" # assumed: rated torque\nangles = 64 ', "# ")
FLAT = FLAT.replace('"-1 arcmin"', '"-60 arcmin"').replace('"1 arcmin"\ntarget', '"60 arcmin"\ntarget')
FLAT = FLAT.replace("samples = 16384", "samples = 1024").replace("certificate_samples = 1_000_000", "#")
FLAT = re.sub(r"\[cost\.(crank|disc|carrier)_(?s:.*?)\n\n", "", FLAT)
FLAT += "certificate_samples = 4096\n"
CURVE = "angle [deg],error [arcsec]\n" + "".join(f"{k},{10 * (k % 9)}\n" for k in range(360))
UNIT = """
[design]
base = "rv-40e"
[conditions]
angles = 8
closure = "first_order"
[tolerances.crank_eccentricity]
half_width = "6.5 um"
[requirement.transmission_error]
upper = "60 arcmin"
[identify]
model = "four_bar"
orders = [40, 80]
noise = "2 arcsec"
nuisance = ["offset"]
"""
PARTS = "kind,id,disc_runout [um],pin_radius [um]\n" + "".join(
    f"flanks,f{k},{3 * k},\npins,p{k},,{k / 2 - 1}\n" for k in range(4)
)
COMMANDS = {
    "check": ["flat.toml"],
    "montecarlo": ["flat.toml", "--samples", "3000"],
    "allocate": ["flat.toml", "--fresh"],
    "compensate": ["flat.toml", "curve.csv"],
    "assemble": ["flat.toml", "parts.csv"],
    "identify": ["unit.toml", "--check"],
    "budget": ["unit.toml", "--samples", "16", "--torque", "10 N m"],
    "report": ["flat.toml"],
    "compare": ["results/flat", "results/flat"],
    "reproduce": [],
}
LOUD = ("check", "reproduce")  # without the option --quiet
RUN = """
import contextlib
import io
import os
import sys
import jax
import functools
from rvjax import cli, published
published.reproduce = functools.partial(published.reproduce, ("rv20e",))  # the others take a minute
class Terminal(io.StringIO):
    def isatty(self):
        return True

os.environ["COLUMNS"] = "80"
hits = []
jax.monitoring.register_event_listener(lambda event, **_: hits.append(event) if "cache_hits" in event else None)
for run in (1, 2):  # the second one with what the first one kept: programs and traced functions
    for command, arguments in {commands!r}.items():
        print("begin", run, command, file=sys.stderr, flush=True)
        with contextlib.redirect_stdout(Terminal()) as shown:
            code = cli.main([command, *arguments, *(["--quiet"] if command not in {loud!r} else [])])
        for line in shown.getvalue().split("\\n"):
            if len(line) > 80:
                print("too wide", command, line, file=sys.stderr)
        assert code == 0, (command, code)
    assert run == 1 or len(hits) > 5, hits
    hits.clear()
    jax.clear_caches()
"""


@pytest.mark.long
def test_nothing_of_a_library_reaches_the_terminal(tmp_path):
    """JAX leaves "1" in the environment of whatever a notebook or script starts, and here it is loaded before."""
    for name, text in {"flat.toml": FLAT, "unit.toml": UNIT, "curve.csv": CURVE, "parts.csv": PARTS}.items():
        (tmp_path / name).write_text(text)
    own = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "kept"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "TF_CPP_MIN_LOG_LEVEL": "1",
    }
    done = subprocess.run(
        [sys.executable, "-c", RUN.format(commands=COMMANDS, loud=LOUD)],
        cwd=tmp_path, env=os.environ | own, capture_output=True, text=True, timeout=590,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said = done.stderr.splitlines()
    assert sum(line.startswith("begin ") for line in said) == 2 * len(COMMANDS)
    assert [line for line in said if not line.startswith(("begin ", "rvjax: warning: ", "computing rv20e, "))] == []
